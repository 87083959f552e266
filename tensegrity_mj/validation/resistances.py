"""What makes a scene's resistance valid."""

from __future__ import annotations

from typing import Any

import numpy as np

from tensegrity_mj.errors import SceneError
from tensegrity_mj.resistance import Bending, Drag, Resistance, bending_joints, shared_node
from tensegrity_mj.structure import Structure
from tensegrity_mj.validation.members import names_of
from tensegrity_mj.validation.values import check_number, check_vector, sequence_of


def check_resistance(structure: Structure, resistance: Any) -> None:
    """Raise SceneError unless a resistance fits a structure."""
    if not isinstance(resistance, Resistance):
        raise SceneError(f"resistance = {resistance!r}; use Resistance(viscous=..., bending=..., drag=...), or None")
    _at_least_zero("viscous", resistance.viscous, "N s/m²")
    check_vector("resistance: wind", resistance.wind, SceneError, "m/s")
    if resistance.bending is not None:
        _check_bending(structure, resistance.bending)
    if resistance.drag is not None:
        _check_drag(structure, resistance.drag)
    if resistance.viscous == 0 and resistance.bending is None and resistance.drag is None:
        raise SceneError(
            "resistance: it has neither viscous forces nor bending nor drag: give one, or leave resistance out"
        )
    if np.any(np.array(resistance.wind, float)) and resistance.viscous == 0 and resistance.drag is None:
        raise SceneError(
            "resistance: there is wind, but neither viscous forces nor drag that could feel it: give one, or leave "
            "wind out"
        )


def _check_bending(structure: Structure, bending: Any) -> None:
    if not isinstance(bending, Bending):
        raise SceneError(f"resistance: bending = {bending!r}; use Bending(stiffness, damping), or None")
    _at_least_zero("bending: stiffness", bending.stiffness, "N m")
    _at_least_zero("bending: damping", bending.damping, "N m s")
    if bending.pairs is not None:
        _check_pairs(structure, bending.pairs)
    if not bending_joints(structure, bending):
        raise SceneError(
            f"resistance: bending: structure '{structure.name}' has no joint of exactly two rods, and no pairs are "
            "named: name the two rods of each joint that resists, or leave bending out"
        )


def _check_pairs(structure: Structure, pairs: Any) -> None:
    rods = {rod.name: row for row, rod in enumerate(structure.rods)}
    seen: set[frozenset[str]] = set()
    for number, pair in enumerate(sequence_of("resistance: bending: pairs", pairs, SceneError)):
        what = f"resistance: bending: pairs[{number}]"
        names = sequence_of(what, pair, SceneError)
        if len(names) != 2 or not all(isinstance(name, str) for name in names):
            raise SceneError(f"{what} = {pair!r}; it must name two rods")
        for name in names:
            if name not in rods:
                raise SceneError(f"{what}: unknown rod '{name}'; the rods are {names_of(rods)}")
        if names[0] == names[1] or shared_node(structure, rods[names[0]], rods[names[1]]) is None:
            raise SceneError(f"{what}: rods '{names[0]}' and '{names[1]}' must be two that share exactly one node")
        if frozenset(names) in seen:
            raise SceneError(f"{what}: rods '{names[0]}' and '{names[1]}' are named twice; name each pair once")
        seen.add(frozenset(names))


def _check_drag(structure: Structure, drag: Any) -> None:
    if not isinstance(drag, Drag):
        raise SceneError(f"resistance: drag = {drag!r}; use Drag(normal, tangential, density, diameter), or None")
    _at_least_zero("drag: normal", drag.normal)
    _at_least_zero("drag: tangential", drag.tangential)
    _positive("density", drag.density, "> 0 kg/m³")
    if drag.diameter is not None:
        _positive("diameter", drag.diameter, "> 0 m, or None for twice each rod's radius")


def _positive(what: str, value: Any, allowed: str) -> None:
    check_number(f"resistance: drag: {what}", value, allowed, lambda x: x > 0, SceneError)


def _at_least_zero(what: str, value: Any, unit: str = "") -> None:
    check_number(f"resistance: {what}", value, f">= 0 {unit}".rstrip(), lambda x: x >= 0, SceneError)
