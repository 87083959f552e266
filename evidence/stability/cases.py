"""The structures that the study looks at: random taut ones, and a base structure with one property varied."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from evidence.random_linked import log_uniform, random_linked_structure
from evidence.random_taut import random_taut_structure
from tensegrity_mj.errors import OptionError, TensegrityError
from tensegrity_mj.model.elements.resistance import resisting_forces
from tensegrity_mj.model.events import Load
from tensegrity_mj.model.rods import lumped_masses, string_forces
from tensegrity_mj.model.scene import Scene
from tensegrity_mj.model.structure import Structure
from tensegrity_mj.model.text.reading import structure_from_toml
from tensegrity_mj.model.text.writing import structure_to_toml
from tensegrity_mj.statics.equilibrium import balance
from tensegrity_mj.statics.model import StaticModel
from tensegrity_mj.statics.self_stress import prestress
from tensegrity_mj.vibration.bodies import Bodies

# Base structure: a string's stiffness [N/m], and the elongation u/k of the string that is pulled most.
STIFFNESS = 1000.0
PRESTRAIN = 0.02
EVEN = f"with strings of {STIFFNESS:g} N/m that are stretched by up to {100 * PRESTRAIN:.0f} %, without dampers"
TENSION = 10.0  # [N/m] the largest u while stiffness is varied
LOOSE = -0.05  # u/k of a slack string
SUBSTITUTE_SEED = 1

# Axis: (label, values of the study, values of a quick one).
AXES: dict[str, tuple[str, tuple[float, ...], tuple[float, ...]]] = {
    "stiffness": ("string stiffness k [N/m]", tuple(10.0**x for x in range(2, 10)), (1e2, 1e5, 1e9)),
    "damping": ("damping ratio ζ", (0.0, 0.01, 0.03, 0.1, 0.3, 1.0, 3.0, 10.0), (0.0, 0.3, 10.0)),
    "mass_ratio": ("mass of the first rod over the others'", tuple(10.0**x for x in range(-4, 5)), (1e-4, 1.0, 1e4)),
    "prestress": ("prestress, largest u/k", (0.0, 1e-6, 1e-4, 1e-3, 1e-2, 0.1, 0.5, 0.9), (0.0, 1e-4, 0.5)),
    "slenderness": ("height over its own", (0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0), (0.2, 1.0, 5.0)),
    "rods": ("rods", (1, 2, 5, 10, 20, 50, 100, 200, 500), (1, 5, 20)),
}


def scene_at_rest(scene: Scene, maps: bool = False) -> tuple[Scene, str]:
    """A scene that stands still, for limits to be measured at, and what was done for that.

    Of class 1 it is `base_structure` where there are rods and light linear strings alone, where maps vary the strings,
    and where it is not stable as it is. Other structures stay as they are with their gravity: where they are not in
    equilibrium when their supports are still, dead loads on the nodes hold them.
    """
    structure = scene.structure
    light = all(string.is_linear and len(string.nodes) == 2 for string in structure.strings) and not structure.ropes
    rigid = not (structure.elastic.any() or structure.bodies or structure.constraints)
    as_it_is = None if maps or (light and rigid) else _held(scene)
    if structure.class_number < 2 and structure.strings and (as_it_is is None or not is_firm(as_it_is[0])):
        base, text = base_structure(scene)
        return Scene(base), text
    return as_it_is or _held(scene)


def _held(scene: Scene) -> tuple[Scene, str]:
    """A scene as it is, at rest, in equilibrium by dead loads where need be, and what was done for that."""
    structure = scene.structure
    lengths = structure.string_lengths(structure.positions)
    edge = np.abs(lengths - structure.rest_lengths) <= 1e-9 * lengths
    text = f"{structure.name} as it is, its supports still"
    if edge.any():
        structure = structure.with_strings(
            rest_length=np.where(edge, (1 - PRESTRAIN) * lengths, structure.rest_lengths)
        )
        text += f", {int(edge.sum())} strings without tension stretched by {100 * PRESTRAIN:.0f} %"
    resistance = None if scene.resistance is None else replace(scene.resistance, wind=(0.0, 0.0, 0.0))
    still = Scene(structure, name=scene.name, gravity=scene.gravity, resistance=resistance)
    if balance(StaticModel.of(still)).is_equilibrium:
        return still, text
    tensions = structure.curves.tension(lengths - structure.rest_lengths)
    pushes = string_forces(structure, structure.positions, tensions)
    pushes = pushes + lumped_masses(structure)[:, None] * np.array(scene.gravity)
    pushes = pushes + resisting_forces(still, structure.positions, np.zeros_like(structure.positions))
    loads = tuple(Load(name, tuple(-row)) for name, row in zip(structure.nodes, pushes, strict=True) if row.any())
    return still.with_(loads=loads), text + ", dead loads in balance with its weight and its strings"


def base_structure(scene: Scene) -> tuple[Structure, str]:
    """The scene's structure prestressed at its reference nodes, without dampers, and what was done to it.

    Strings that carry nothing there are left slack. Where nothing can stress it stably, a random taut structure stands
    in for it.
    """
    structure = scene.structure
    plain = structure.with_strings(stiffness=STIFFNESS, damping=0.0, force_density=0.0)
    loose = structure.string_lengths(structure.positions) <= structure.rest_lengths * (1 + 1e-9)
    names = [s.name for s, one in zip(structure.strings, loose, strict=True) if one]
    reason = "its equilibrium is not stable"
    for slack in ([], names):
        try:
            u = prestress(plain, level=1.0, slack=slack)
        except TensegrityError as error:
            reason = str(error)
            continue
        if not u.any():  # nothing but zero is in balance
            continue
        u = u * (PRESTRAIN * STIFFNESS / u.max())  # below the stiffness, for any self-stress
        tight = _at_prestrain(_with_densities(plain, np.where(u > 0, u, LOOSE * STIFFNESS)), PRESTRAIN)
        if is_firm(Scene(tight)):
            left = f" (strings {', '.join(slack)} slack)" if slack else ""
            return tight, f"{structure.name} in its own self-stress{left}, {EVEN}"
        reason = "its equilibrium is not stable"
    rng = np.random.default_rng(SUBSTITUTE_SEED)
    planar = all(rod.support.plane is not None for rod in structure.rods)
    count = max(1, min(6, len(structure.rods)))
    found = random_taut_structure(rng, rods=count, planar=planar, prestrain=(PRESTRAIN, PRESTRAIN))
    # One stiffness for all: u then differs from string to string.
    u = _densities(found)
    plain = found.with_strings(stiffness=STIFFNESS, force_density=0.0)
    even = _with_densities(plain, u * (PRESTRAIN * STIFFNESS / u.max()))
    return _at_prestrain(even, PRESTRAIN), (
        f"a random taut structure of {count} rod{'s' * (count > 1)} (seed {SUBSTITUTE_SEED}), {EVEN}, in place of "
        f"{structure.name}, which cannot be prestressed as it is: {reason}"
    )


def is_firm(scene: Scene) -> bool:
    """Return whether all motions but those of the whole are held at rest: no stiffness below -1e-9 of the largest."""
    from tensegrity_mj.vibration.small_motions import vibration

    still = np.zeros_like(scene.nodes0)
    model = vibration(scene, scene.nodes0, still, scene.structure.rest_lengths)
    matrix = model.material + model.geometric
    matrix = matrix if isinstance(matrix, np.ndarray) else matrix.toarray()
    values = np.linalg.eigvalsh(matrix)
    return bool(values[0] > -1e-9 * values[-1])


def varied(base: Structure, axis: str, value: float) -> Structure:
    """The base with one property set; OptionError for an unknown axis, and for one of rods where there are none."""
    u, k = _densities(base), base.stiffness
    match axis:
        case "stiffness":
            # The tensions stay, with u = 10 N/m at most.
            tension = u * (TENSION / u.max())
            return _with_densities(base.with_strings(stiffness=value), np.where(u > 0, tension, LOOSE * value))
        case "damping":
            mass = 0.25 * float((base.rod_masses if base.rods else Bodies.of(base).mass).mean())
            return base.with_strings(damping=2 * value * np.sqrt(k * mass))
        case "mass_ratio":
            if not base.rods:
                raise OptionError(f"axis = {axis!r} varies the mass of a rod, and structure '{base.name}' has none")
            first, *others = base.rods
            mass = value * (others[0].mass if others else first.mass)
            return replace(base, rods=(replace(first, mass=mass), *others))
        case "prestress":
            return _at_prestrain(base, value)
        case "slenderness":
            # Along z, or the longer axis of its plane; u stays: an affine map keeps every self-stress.
            nodes = np.array(base.positions)
            planar = all(rod.support.plane is not None for rod in base.rods)
            nodes[:, int(np.argmax(np.ptp(nodes, axis=0))) if planar else 2] *= value
            rods = tuple(replace(rod, support=replace(rod.support, values=None)) for rod in base.rods)
            return _with_densities(replace(base.with_strings(rest_length=None), rods=rods).placed(nodes), u)
    raise OptionError(f"axis = {axis!r}; allowed: {', '.join(AXES)}")


def structure_of(point: Mapping[str, Any]) -> Structure:
    if point["kind"] == "random":
        return random_taut_structure(
            np.random.default_rng(point["seed"]),
            rods=point["rods"],
            planar=point["planar"],
            mass_ratio=point["mass_ratio"],
            stiffness=point["stiffness"],
            prestrain=tuple(point["prestrain"]),
            damping_ratio=(0.0, point["damping_ratio"]),
        )
    if point["axis"] == "rods":
        count = int(point["value"])
        return random_taut_structure(np.random.default_rng(count), rods=count, stiffness=STIFFNESS)
    return varied(structure_from_toml(point["base"]), point["axis"], point["value"])


def joined_scene(point: Mapping[str, Any]) -> Scene:
    """A random structure whose rods share nodes, at rest, held by dead loads where its strings do not: of a point."""
    rng = np.random.default_rng(point["seed"])
    structure = random_linked_structure(
        rng,
        rods=point["rods"],
        loops=point["loops"],
        planar=point["planar"],
        pinned=point["pinned"],
        strings=2 * point["rods"],
        stretch=tuple(point["prestrain"]),
        stiffness=(0.5 * point["stiffness"], 2 * point["stiffness"]),
    )
    # As in random taut structures: c = 2 ζ √(k m) of a mean rod's quarter.
    mass = 0.25 * float(structure.rod_masses.mean())
    ratios = point["damping_ratio"] * rng.uniform(0, 1, len(structure.strings))
    return scene_at_rest(Scene(structure.with_strings(damping=2 * ratios * np.sqrt(structure.stiffness * mass))))[0]


def joined_points(count: int, seed: int, most_rods: int = 12) -> list[dict[str, Any]]:
    """Points of random trees and loops, drawn as those of `random_points`."""
    return [
        {
            "kind": "joined",
            "seed": int(rng.integers(2**31)),
            "rods": int(rng.integers(2, most_rods + 1)),
            "loops": int(rng.choice([0, 0, 1, 2])),
            "planar": bool(rng.uniform() < 0.5),
            "pinned": bool(rng.uniform() < 0.7),
            "stiffness": log_uniform(rng, 1e2, 1e6),
            "prestrain": [1e-3, log_uniform(rng, 1e-2, 0.3)],
            "damping_ratio": float(rng.choice([0.0, log_uniform(rng, 1e-2, 3.0)])),
        }
        for rng in (np.random.default_rng([seed, number, 1]) for number in range(count))
    ]


def random_points(count: int, seed: int, most_rods: int = 30) -> list[dict[str, Any]]:
    """Points of random taut structures: sizes, masses, stiffness, prestress and damping drawn over decades."""
    return [
        {
            "kind": "random",
            "seed": int(rng.integers(2**31)),
            "rods": int(log_uniform(rng, 1.0, most_rods + 1)),
            "planar": bool(rng.uniform() < 0.5),
            "mass_ratio": log_uniform(rng, 1.0, 1e4),
            "stiffness": log_uniform(rng, 1e2, 1e7),
            "prestrain": [1e-4, log_uniform(rng, 1e-3, 0.5)],
            "damping_ratio": float(rng.choice([0.0, log_uniform(rng, 1e-2, 10.0)])),
        }
        for rng in (np.random.default_rng([seed, number]) for number in range(count))
    ]


def map_points(base: Structure, axes: tuple[str, ...], quick: bool, most_rods: int) -> list[dict[str, Any]]:
    text = structure_to_toml(base)
    places = [(axis, value) for axis in axes for value in (AXES[axis][2] if quick else AXES[axis][1])]
    return [
        {"kind": "map", "axis": axis, "value": float(value), "base": "" if axis == "rods" else text}
        for axis, value in places
        if axis != "rods" or value <= most_rods
    ]


def _densities(structure: Structure) -> Any:
    """u (M,) at the reference nodes."""
    return structure.stiffness * (1 - structure.rest_lengths / structure.string_lengths(structure.positions))


def _with_densities(structure: Structure, u: Any) -> Structure:
    """Return the structure with these u (M,) [N/m] at the reference nodes; negative ones are slack."""
    lengths = structure.string_lengths(structure.positions)
    return structure.with_strings(rest_length=lengths * (1 - u / structure.stiffness))


def _at_prestrain(structure: Structure, level: float) -> Structure:
    """Scale the tensions so that the largest u/k is the level; slack strings stay as they are."""
    u = _densities(structure)
    worst = float(np.max(u / structure.stiffness))
    return _with_densities(structure, np.where(u > 0, u * (level / worst), u))
