"""Speed against accuracy: the work-precision diagram of a scene."""

import tensegrity_mj.engines.mujoco  # noqa: F401  (refuses an environment in which MuJoCo cannot be imported)
