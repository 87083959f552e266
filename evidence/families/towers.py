"""Parts of towers that the thesis' families and measures share: ends, lengths, starts that are held and let go."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import fields
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from tensegrity_mj.library.tower import Tower, tower
from tensegrity_mj.model.events import Load
from tensegrity_mj.model.scene import Scene
from tensegrity_mj.statics import find_equilibrium


def tower_like(family: Any, **more: Any) -> Scene:
    """The tower with what another family has in fields of the same names, and with more."""
    return tower(**shared_fields(Tower, family) | more)


def shared_fields(kind: type, family: Any) -> dict[str, Any]:
    """Return the values of a family's fields that a class has, too, by their names."""
    names = {one.name for one in fields(kind)} & {one.name for one in fields(family)}
    return {name: getattr(family, name) for name in names}


def released(scene: Scene, loads: Iterable[Load]) -> Scene:
    """The scene that starts at rest where constant loads hold it in equilibrium; they let go at t = 0.

    Raises:
        InfeasibleError: if nothing balances the loads.
    """
    return scene.with_(initial_nodes=find_equilibrium(scene.with_(loads=tuple(loads))).nodes)


def tower_length(nodes: ArrayLike) -> float:
    """[m] between the centres of the base and of the top, for the nodes (N, 3) of a tower."""
    places = np.asarray(nodes, float)
    return float(np.linalg.norm(places[-3:].mean(axis=0) - places[:3].mean(axis=0)))


def base_nodes() -> list[str]:
    """Names of the three nodes at the free side of the first stage."""
    return _corners("b", 1)


def top_nodes(stages: int) -> list[str]:
    """Names of the three nodes at the free side of the last of N stages."""
    return _corners("t", stages)


def middle_nodes(stages: int) -> list[str]:
    """Names of six nodes about the middle of N stages: of the stage that is there, or of the two that meet there."""
    return _corners("b", stages // 2 + 1) + _corners("t", (stages + 1) // 2)


def _corners(kind: str, stage: int) -> list[str]:
    return [f"{kind}{stage}_{corner}" for corner in (1, 2, 3)]
