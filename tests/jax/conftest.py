"""Compiling takes most of the time of these tests, and is faster where it optimizes less; before JAX is imported."""

import os

os.environ.setdefault("XLA_FLAGS", "--xla_backend_optimization_level=0")
