"""What may act on a structure, one thing at a time: a scene with it, and the same without."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from body_scenes import slung
from linked_scenes import everything_moves, hung
from loaded_rods import loaded
from maxwell import Maxwell
from pulley_scenes import threaded
from rope_scenes import weighted, weightless
from soft_scenes import laden_pair, rigid, soft_pair

import tensegrity_mj as tmj

RESISTANCE = tmj.Resistance(0.3, tmj.model.Bending(2.0, 0.1), tmj.model.Drag(1.1, 0.2, 30.0), (1.0, 2.0, -0.5))
IN_AIR = tmj.Resistance(0.3, None, tmj.model.Drag(1.1, 0.2, 30.0), (1.0, 2.0, -0.5))


def moved() -> tmj.Scene:
    pivot, _, node = everything_moves(planar=False).motions
    return hung().with_(motions=(pivot, node))


def shaken() -> tmj.Scene:
    """By a record of noise whose times are those of steps."""
    record = np.random.default_rng(3).normal(0.0, 3.0, (20, 3))
    return tmj.model.Ground(0.02 * np.arange(1, 21), record).shake(hung())


def shaken_pair(scene: tmj.Scene) -> tmj.Scene:
    """Whose pinned rod's support goes to and fro."""
    return scene.with_(motions=(tmj.model.Motion.in_line("r1", 0.05, 9.0, (1.0, 0.5, 0.3)),))


def in_water(
    depth: float = 3.0,
    weights: tmj.model.Weights = tmj.model.Weights.RIGID,
    sea: tmj.model.IrregularSea | None = None,
) -> tmj.Scene:
    """Two rods in a sea of waves of 0.6 m, joined by taut strings: at 3 m below the surface they stay under water."""
    places = {"a": (0, 0, 0.0), "b": (1, 0, -0.2), "c": (0.2, 1, -0.5), "d": (1.1, 1.2, -0.1)}
    nodes = {name: (x, y, z - depth) for name, (x, y, z) in places.items()}
    rods = (tmj.Rod("r1", ("a", "b"), 2.0, 0.03, tmj.Support.pinned()), tmj.Rod("r2", ("c", "d"), 3.0, 0.03))
    ends = (("a", "c"), ("b", "d"), ("a", "d"), ("b", "c"))
    strings = tuple(tmj.String(f"s{n}", pair, 60.0, 2.0, rest_length=0.1) for n, pair in enumerate(ends))
    waves = (tmj.model.Wave(0.4, 9.0, direction=0.3), tmj.model.Wave(0.2, 5.0, direction=1.5, phase=0.7))
    water = tmj.Water(1025.0, None, waves, (0.3, -0.2, 0.0), 1.2, 0.1, 0.7, segments=5, weights=weights, sea=sea)
    structure = tmj.Structure("wet", nodes, rods, strings)
    return tmj.Scene(structure, gravity=(0, 0, -9.81), water=water)


def in_air(scene: tmj.Scene) -> tmj.Scene:
    return scene.with_(water=None)


def pushed() -> tmj.Scene:
    return hung().with_(loads=(tmj.model.Load("n3", (0.5, 1.0, 2.0), 9.0), tmj.model.Load("n2", (0.0, -1.0, 0.0))))


def dashed() -> tmj.Scene:
    """With a spring and a dashpot in series, from below a node that swings."""
    scene = hung()
    x, y, z = scene.nodes0[scene.structure.node_index["n3"]]
    return scene.with_(elements=(Maxwell("n3", 60.0, 8.0, (float(x), float(y) + 0.1, float(z) - 0.2)),))


def lightened(structure: tmj.Structure) -> tmj.Structure:
    """With bodies of half the mass and moments."""
    return replace(structure, bodies=tuple(body.times(0.5) for body in structure.bodies))


def railed(scene: tmj.Scene, first: str, second: str, *motions: tmj.model.Motion) -> tmj.Scene:
    """With a weighted mean of two nodes that keeps its place along a direction, or moves along it."""
    rail = tmj.model.Constraint("rail", {first: 0.7, second: 0.5}, (0.2, 0.1, 1.0))
    return scene.with_(structure=replace(scene.structure, constraints=(rail,)), motions=(*scene.motions, *motions))


def without_rail(scene: tmj.Scene) -> tmj.Scene:
    motions = tuple(motion for motion in scene.motions if motion.support != "rail")
    return scene.with_(structure=replace(scene.structure, constraints=()), motions=motions)


def without_path(scene: tmj.Scene) -> tmj.Scene:
    """Without its last string."""
    return scene.with_(structure=replace(scene.structure, strings=scene.structure.strings[:-1]))


def unloaded(scene: tmj.Scene) -> tmj.Scene:
    """Without the masses on rods, and on their nodes."""
    rods = tuple(replace(rod, masses=()) for rod in scene.structure.rods)
    return scene.with_(structure=replace(scene.structure, rods=rods, point_masses=scene.structure.lone_masses))


def curved(points: Callable[[float], tuple[tuple[float, float], ...]], **more: Any) -> tmj.Scene:
    """With other strings: tensions by stretches as a function of k, which a motion that stays taut has one piece of."""
    structure = hung().structure
    strings = (replace(one, stiffness=None, curve=points(one.stiffness), **more) for one in structure.strings)
    return hung().with_(structure=replace(structure, strings=tuple(strings)))


def pulled() -> tmj.Scene:
    """With a constant force of 8 N instead of its first string."""
    structure = hung().structure
    first = replace(structure.strings[0], stiffness=0.0, tension=8.0, rest_length=None, force_density=None)
    return hung().with_(structure=replace(structure, strings=(first, *structure.strings[1:])))


@dataclass(frozen=True)
class Feature:
    """One thing that acts.

    Attributes:
        scene: with it.
        without: the same scene without it.
        order: of RK4's error. A step ends where a string breaks, and a rod comes out of the water bit by bit; a
            contact's force begins and ends within a step, which costs the order.
        in_dae: whether the DAE is its reference; else MuJoCo with an eighth of the step is. Contact is of order 1, and
            has tests of its own in the DAE (test_contact_dae.py).
        steps: [s], the second half of the first.
    """

    scene: Callable[[], tmj.Scene]
    without: Callable[[tmj.Scene], tmj.Scene]
    order: int = 4
    in_dae: bool = True
    steps: tuple[float, float] = (2e-3, 1e-3)


FEATURES = {
    "dampers": Feature(hung, lambda scene: scene.with_(structure=scene.structure.with_strings(damping=0.0))),
    "paths": Feature(threaded, without_path),
    "paths, moved supports": Feature(lambda: threaded(moved()), without_path),
    "paths, water": Feature(lambda: threaded(in_water(), ("a", "c", "b", "d")), without_path),
    "bodies": Feature(slung, lambda scene: scene.with_(structure=lightened(scene.structure))),
    "masses on rods": Feature(lambda: loaded(hung()), unloaded),
    "masses on rods, moved supports": Feature(lambda: loaded(moved()), unloaded),
    # Of this seed no string falls slack, where RK4 falls to its first order.
    "masses on rods, water": Feature(lambda: loaded(in_water(), seed=2), unloaded),
    "damping of point masses": Feature(lambda: loaded(hung(), damping=0.7), lambda _: loaded(hung())),
    "elastic rods": Feature(soft_pair, rigid),
    "elastic rods, moved supports": Feature(lambda: shaken_pair(soft_pair()), rigid),
    "elastic rods with masses": Feature(laden_pair, lambda _: soft_pair()),
    "elastic rods, resistance": Feature(lambda: soft_pair().with_(resistance=IN_AIR), rigid),
    "loads": Feature(pushed, lambda scene: scene.with_(loads=())),
    "tension curves": Feature(lambda: curved(lambda k: ((1e-3, 1e-3 * k), (2e-3, 4e-3 * k))), lambda _: hung()),
    # Memory is that of steps, where a string turns within one: not located, an error of the third order.
    "strings that yield": Feature(
        lambda: curved(lambda k: ((1e-3, 1e-3 * k), (2e-3, 1.5e-3 * k)), yields=True), lambda _: hung(), 3
    ),
    "constant forces": Feature(pulled, lambda _: hung()),
    "strings with mass": Feature(weighted, weightless),
    "moved supports": Feature(moved, lambda scene: scene.with_(motions=())),
    "ground": Feature(shaken, lambda scene: scene.with_(motions=())),
    "constraints": Feature(lambda: railed(hung(), "n3", "n5"), without_rail),
    "constraints, moved": Feature(
        lambda: railed(moved(), "n3", "n5", tmj.model.Motion.in_line("rail", 0.03, 1.5, (0.5, 0.0, 1.0))), without_rail
    ),
    "constraints, water": Feature(lambda: railed(in_water(), "b", "c"), without_rail),
    "breaks": Feature(lambda: hung().with_(breaks=(tmj.model.Break("s1", 0.2),)), lambda scene: scene.with_(breaks=())),
    "resistance": Feature(lambda: hung().with_(resistance=RESISTANCE), lambda _: hung()),
    "states of elements": Feature(dashed, lambda scene: scene.with_(elements=())),
    "water": Feature(in_water, in_air),
    "water, Hermite": Feature(lambda: in_water(weights=tmj.model.Weights.HERMITE), in_air),
    # Of this seed, the water stands still against no segment, where |u| u bends and RK4 falls to its third order.
    "irregular sea": Feature(
        lambda: in_water(sea=tmj.model.IrregularSea("jonswap", 0.8, 3.0, seed=2, components=12)), lambda _: in_water()
    ),
    "drag on strings": Feature(
        lambda: in_water().with_(water=replace(in_water().water, string_diameter=0.1)), lambda _: in_water()
    ),
    "surface": Feature(lambda: in_water(depth=0.2), in_air),
    "contact": Feature(
        lambda: tmj.load_scene("prism_drop"), lambda scene: scene.with_(contact=None), 1, False, (5e-4, 2.5e-4)
    ),
}
