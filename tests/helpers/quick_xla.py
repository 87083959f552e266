"""XLA compiles what a test runs once: unoptimized, by the plain emitter, in one part; in 0.15 to 0.4 of the time."""

from __future__ import annotations

import importlib.util
import mmap
import os
from pathlib import Path

FLAGS = {
    "xla_backend_optimization_level": "0",
    "xla_cpu_use_fusion_emitters": "false",
    "xla_cpu_parallel_codegen_split_count": "1",  # each part takes time of its own
}


def compile_quickly() -> None:
    """Set the flags that this XLA has, as it ends the process at others; before JAX is imported."""
    found = importlib.util.find_spec("jaxlib")
    for path in Path(found.origin).parent.glob("libjax_common*") if found and found.origin else ():
        with path.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as library:
            known = [f"--{name}={value}" for name, value in FLAGS.items() if library.find(name.encode()) >= 0]
        os.environ.setdefault("XLA_FLAGS", " ".join(known))
