"""The differentiable engine: members, elements and laws as plain array functions, independent of the other two.

Nothing here imports MuJoCo or the compiled functions of the other engines. Arrays are in 64 bits, batches are last:
positions and velocities (N, 3, ...) instead of (..., N, 3).
"""
