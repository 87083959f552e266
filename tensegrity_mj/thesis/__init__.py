"""The ledger: what the thesis states in chapters 3 to 7 and appendix C, beside what the engines give.

`experiments`, `series` and `beams` say what is run, the TOML files of `tables/` what the thesis states (a row each),
`measures*` how it is measured, `figures*` how its figures are drawn again. `runs` computes and keeps the runs, `ledger`
judges, `page` and `reproduce` write the results; `disturbance` and `sensitivity` find which errors the rows notice.
"""
