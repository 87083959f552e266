"""What makes a scene's water valid."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from tensegrity_mj.errors import SceneError
from tensegrity_mj.validation.values import check_number, check_vector, sequence_of
from tensegrity_mj.water import Water, Weights
from tensegrity_mj.water_segments import MOST_SEGMENTS
from tensegrity_mj.waves import AboveLevel, Wave

if TYPE_CHECKING:
    from tensegrity_mj.scene import Scene


def check_water(scene: Scene) -> None:
    """Raise SceneError unless a scene's water fits its structure and its gravity."""
    water, structure = scene.water, scene.structure
    if not isinstance(water, Water):
        raise SceneError(f"water = {water!r}; use Water(density, depth, waves, ...), or None")
    if not structure.rods:
        raise SceneError(f"water: structure '{structure.name}' has no rod, and water loads rods alone: leave water out")
    for name, unit in (("density", "kg/m³"), ("viscosity", "m²/s")):
        _positive(name, getattr(water, name), f"> 0 {unit}")
    if water.depth is not None:
        _positive("depth", water.depth, "> 0 m, or None for deep water")
    if water.diameter is not None:
        _positive("diameter", water.diameter, "> 0 m, or None for twice each rod's radius")
    for name in ("drag", "tangential_drag", "added_mass"):
        _at_least_zero(name, getattr(water, name))
    if water.inertia is not None:
        _at_least_zero("inertia", water.inertia, ", or None for 1 + added_mass")
    count = water.segments
    whole = isinstance(count, (int, np.integer)) and not isinstance(count, bool)
    if count is not None and (not whole or not 1 <= count <= MOST_SEGMENTS):
        raise SceneError(
            f"water: segments = {count!r}; it must be an integer from 1 to {MOST_SEGMENTS}, or None for as many as the "
            "waves need"
        )
    for name, kind in (("weights", Weights), ("above", AboveLevel)):
        if not isinstance(getattr(water, name), kind):
            members = ", ".join(str(member) for member in kind)
            raise SceneError(f"water: {name} = {getattr(water, name)!r}; it must be one of {members}")
    check_vector("water: current", water.current, SceneError, "m/s")
    x, y, z = (float(g) for g in scene.gravity)
    if x or y or z > 0:
        raise SceneError(
            f"water: gravity = {scene.gravity!r}; the still surface is z = 0, so that gravity must be (0, 0, -g) with "
            "g >= 0: turn the scene"
        )
    for number, wave in enumerate(sequence_of("water: waves", water.waves, SceneError)):
        _check_wave(number, wave)
    if water.waves and z == 0:
        raise SceneError("water: there are waves without gravity, which makes them: give the scene gravity (0, 0, -g)")


def _check_wave(number: int, wave: Any) -> None:
    what = f"water: waves[{number}]"
    if not isinstance(wave, Wave):
        raise SceneError(f"{what} = {wave!r}; use Wave(amplitude, wavelength=... or angular_frequency=...)")
    check_number(f"{what}: amplitude", wave.amplitude, ">= 0 m", lambda x: x >= 0, SceneError)
    if (wave.wavelength is None) == (wave.angular_frequency is None):
        raise SceneError(
            f"{what}: wavelength = {wave.wavelength!r}, angular_frequency = {wave.angular_frequency!r}; give one of "
            "the two, the depth and gravity decide the other"
        )
    for name, unit in (("wavelength", "m"), ("angular_frequency", "rad/s")):
        value = getattr(wave, name)
        if value is not None:
            check_number(f"{what}: {name}", value, f"> 0 {unit}", lambda x: x > 0, SceneError)
    for name in ("direction", "phase"):
        check_number(f"{what}: {name}", getattr(wave, name), "finite [rad]", lambda x: True, SceneError)


def _positive(name: str, value: Any, allowed: str) -> None:
    check_number(f"water: {name}", value, allowed, lambda x: x > 0, SceneError)


def _at_least_zero(name: str, value: Any, more: str = "") -> None:
    check_number(f"water: {name}", value, f">= 0{more}", lambda x: x >= 0, SceneError)
