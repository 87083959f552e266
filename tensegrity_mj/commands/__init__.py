"""The commands of `tensegrity-mj`, one a file: each has `HELP`, `EXAMPLES`, `configure(parser)` and `execute(options)`.

A folder, such as `audit`, holds commands of two words: it has `HELP` and `COMMANDS`. `cli` lists all by groups,
`parser` makes one parser of them, `completion` answers the shell, `common` and `experiment` hold what several share.
These modules are imported to build the parser, so they import heavy libraries only inside functions.
"""
