#!/usr/bin/env bash
# diffrax: a jitted diffeqsolve that saves at traced times is never kept by JAX's compilation cache on disk, with throw=False too. A check of
# the times (they must increase) stays in the program as a host callback, and JAX keeps no program with one: each process compiles anew.
# With EQX_ON_ERROR=off the check is left out, and the program is kept.
set -euo pipefail
folder="$(mktemp -d)"
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/python" -m pip install --quiet jax==0.10.2 diffrax==0.7.2 equinox==0.13.8 numpy==2.4.6
cd "$folder"
cat >decay.py <<'PYTHON'
import sys
from importlib.metadata import version
from pathlib import Path

import diffrax
import jax
import jax.numpy as jnp

jax.config.update("jax_compilation_cache_dir", sys.argv[1])
jax.config.update("jax_persistent_cache_min_compile_time_secs", 0)
jax.config.update("jax_persistent_cache_min_entry_size_bytes", -1)


@jax.jit
def solve_at(times):
    term, steps = diffrax.ODETerm(lambda t, y, args: -y), diffrax.PIDController(rtol=1e-6, atol=1e-6)
    saved = diffrax.SaveAt(ts=times)
    found = diffrax.diffeqsolve(
        term, diffrax.Dopri8(), 0.0, 1.0, 0.1, jnp.ones(1), saveat=saved, stepsize_controller=steps, throw=False
    )
    return found.ys


print(f"exp(-1) = {float(solve_at(jnp.linspace(0.0, 1.0, 5))[-1, 0]):.6f}", end=", ")
kept = [path.name for path in Path(sys.argv[1]).glob("*solve_at*")]
print(*(f"{name} {version(name)}" for name in ("jax", "diffrax", "equinox")), f"kept: {len(kept) > 0}")
assert bool(kept) is (sys.argv[2] == "kept"), kept
PYTHON
"$folder/venv/bin/python" decay.py "$folder/checked" absent
EQX_ON_ERROR=off "$folder/venv/bin/python" decay.py "$folder/unchecked" kept
