"""Seeded random runs at the extremes, each judged: right, refused, stopped, warned of, or wrong without a warning."""

import tensegrity_mj.engines.mujoco  # noqa: F401  (refuses an environment in which MuJoCo cannot be imported)
