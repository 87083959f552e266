"""The evidence for tensegrity_mj: what it is checked against and how fast it is, measured and written as pages.

`thesis` lists what the thesis states next to what the engines give; `extremes`, `promise` and `drift` are the
audits; `cable` studies a hanging cable; `speed` measures; `pages` writes the pages of evidence/docs anew.
"""
