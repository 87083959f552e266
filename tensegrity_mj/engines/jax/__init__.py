"""The differentiable engine: members, elements and laws as plain array functions, independent of the other two.

Nothing here imports MuJoCo or the compiled functions of the other engines. Arrays are in 64 bits, batches are last:
positions and velocities (N, 3, ...) instead of (..., N, 3).

Importing it raises `tensegrity_mj.errors.MissingPackageError` where JAX or diffrax is missing, sets JAX to 64 bits, and
has it keep what it compiles for other processes.
"""

import os
from pathlib import Path

from tensegrity_mj.basics.dependencies import of_extra, optional

jax, _ = (optional(package, "the engine JAX", of_extra("jax")) for package in ("jax", "diffrax"))
jax.config.update("jax_enable_x64", True)  # before any array is made: rods of 32 bits lose their lengths
if jax.config.jax_compilation_cache_dir is None:
    home = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "tensegrity-mj" / "jax"
    jax.config.update("jax_compilation_cache_dir", str(home))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.2)
