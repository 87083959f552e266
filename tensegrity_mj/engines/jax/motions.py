"""Displacements of moved supports."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from tensegrity_mj.model.scene import Scene


def displacements(scene: Scene) -> Callable[[Any], Any]:
    raise NotImplementedError
