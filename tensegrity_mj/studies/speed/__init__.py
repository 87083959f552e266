"""How fast runs are: the law and the ledger against bare MuJoCo, and what a scene requires of a step."""

import tensegrity_mj.engines.mujoco  # noqa: F401  (refuses an environment in which MuJoCo cannot be imported)
