"""Compiling takes most of the time of these tests, also in one process; before JAX is imported."""

from quick_xla import compile_quickly

compile_quickly()
