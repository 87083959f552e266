"""The commands of `tensegrity-mj`, one a file: each has `HELP`, `configure(parser)` and `execute(options)`.

These modules are imported to build the parser, so they import heavy libraries only inside functions.
"""
