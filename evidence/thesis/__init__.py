"""The ledger: what the thesis states in chapters 3 to 7 and appendix C, next to what the engines give.

`experiments`, `series` and `beams` say what is run, the TOML files of `tables/` what the thesis states (a row each),
`measures*` how it is measured, `panels`, `drawing` and `figures*` how its figures are drawn again. `runs` computes and
keeps the runs, `ledger` judges, `page` and `reproduction` write the results. A `disturbance` is an error that rows are
to notice: `pages.sensitivity` finds which do. `pages.reproduction` writes docs/reproduction.md.
"""

from typing import TYPE_CHECKING

from tensegrity_mj.basics.faces import face

if TYPE_CHECKING:
    from evidence.thesis.reproduction import Reproduction as Reproduction
    from evidence.thesis.reproduction import reproduce as reproduce
else:
    __getattr__, __dir__ = face(__name__)
