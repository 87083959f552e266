"""The commands of `tensegrity-mj`, one a file: each has `execute(options)`, and its help in a TOML file next to it.

A folder, such as `audit`, holds commands of two words: it has `COMMANDS`. `cli` lists all by groups, `arguments` reads
the TOML files, `parser` makes one parser of all, `completion` answers the shell, `common`, `experiment` and
`shared.toml` hold what several share.
These modules are imported to build the parser, so they import heavy libraries only inside functions.
"""
