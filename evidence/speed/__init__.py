"""Speed as ratios, side by side in one run: `benchmark` is `tensegrity-mj audit speed`, the others are scripts."""

import tensegrity_mj.engines.mujoco  # noqa: F401  (refuses an environment in which MuJoCo cannot be imported)
