"""What a scene takes of memory in MuJoCo: the buffers of model and data, the same on every run."""

from __future__ import annotations

import mujoco


def buffer_bytes(model: mujoco.MjModel) -> int:
    """Bytes of a compiled model's buffer and of one data object's: its arrays and its arena, which it takes whole."""
    data = mujoco.MjData(model)
    return int(model.nbuffer) + int(data.nbuffer) + int(data.narena)
