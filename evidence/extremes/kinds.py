"""The kinds of extreme runs: for each a function that draws a scene, and what drives it, at random.

    experiment = Kind.STIFF.draw(np.random.default_rng([0, 7]))

Parameters that span orders of magnitude are drawn evenly in their logarithm. A scene that cannot be built raises, as it
would for a user: that is a result too.
"""

from __future__ import annotations

import enum
import math
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from evidence.extremes import draws, laws
from evidence.extremes.experiment import COLLAPSE, Experiment, Rng, direction, maybe_driven, ordinary
from evidence.random_linked import log_uniform, random_velocities
from evidence.random_structures import random_configuration, random_scene, random_structure
from tensegrity_mj.basics.arrays import unit
from tensegrity_mj.model.actuation import Mode, OnInfeasible
from tensegrity_mj.model.members import PointMass, Rod, String, Support
from tensegrity_mj.model.scene import Scene
from tensegrity_mj.model.structure import Structure
from tensegrity_mj.model.target import Target


def _scene(rng: Rng, structure: Structure, speed: float = 0.0) -> Scene:
    """Draw a scene, mostly in motion, sometimes displaced, under gravity or loads."""
    return random_scene(
        rng,
        structure,
        displaced=float(rng.choice([0.0, 0.05])) * (not structure.constraints),  # which a displacement would not keep
        moving=speed or log_uniform(rng, 0.01, 3.0),
        gravity=bool(rng.integers(2)),
        loads=int(rng.integers(3)),
    )


def _with_member(add: Callable[[Rng], draws.Drawn], rng: Rng) -> Experiment:
    structure, facts = add(rng)
    return maybe_driven(rng, _scene(rng, structure), facts)


def _stiff(rng: Rng) -> Experiment:
    top = log_uniform(rng, 1e4, 1e9)
    low = top if rng.uniform() < 0.5 else 1e2  # all alike, or soft and stiff together
    strain = log_uniform(rng, 1e-6, 0.1)
    ratio = float(rng.choice([0.0, log_uniform(rng, 1e-3, 1.0)]))
    structure = ordinary(rng, stiffness=(low, top), stretch=(-strain, strain))
    structure = structure.with_strings(damping=2 * ratio * np.sqrt(structure.stiffness))  # of a mass of 1 kg
    return maybe_driven(rng, _scene(rng, structure), {"k": top, "strain": strain, "damping ratio": ratio})


def _slack(rng: Rng) -> Experiment:
    structure = ordinary(rng, stretch=(-0.5, -0.01), stiffness=(10.0, log_uniform(rng, 11.0, 1e4)))
    return Experiment(_scene(rng, structure), facts={"law": "none"})


def _no_prestress(rng: Rng) -> Experiment:
    structure = ordinary(rng, stretch=(0.0, 0.0), stiffness=(10.0, log_uniform(rng, 11.0, 1e5)))
    speed = log_uniform(rng, 1e-6, 1.0)
    scene = random_scene(rng, structure, moving=speed, gravity=bool(rng.integers(2)))
    return Experiment(scene, facts={"speed": speed})


def _negative_rest(rng: Rng) -> Experiment:
    structure = ordinary(rng)
    most = log_uniform(rng, 1.01, 30.0)
    u = structure.stiffness * rng.uniform(1.0, most, len(structure.strings))
    facts = {"least L0/L": 1 - float(np.max(u / structure.stiffness))}
    scene = _scene(rng, structure)
    largest = float(u.max(initial=0.0))
    return Experiment(scene, lambda duration: laws.Waving(u), force_density=largest, cycles=COLLAPSE, facts=facts)


def _vanishing(rng: Rng) -> Experiment:
    distance = log_uniform(rng, 1e-14, 1e-2)
    rest = float(rng.choice([0.5 * distance, 1e-6 * distance, 2 * distance, 0.1]))
    facts: dict[str, Any] = {"length": distance, "rest length": rest}
    if rng.uniform() < 0.5:
        structure = ordinary(rng, planar=False)
        near = structure.positions[structure.node_index[structure.rods[0].nodes[0]]]
        place = near + distance * direction(rng)
        structure = replace(
            structure,
            nodes={**structure.nodes, "tiny": tuple(place.tolist())},
            strings=(*structure.strings, String("tiny", (structure.rods[0].nodes[0], "tiny"), 20.0, rest_length=rest)),
            point_masses=(*structure.point_masses, PointMass("tiny", 0.5)),
        )
        scene = random_scene(rng, structure, moving=float(rng.choice([0.0, 0.1])), gravity=bool(rng.integers(2)))
        return Experiment(scene, facts=facts | {"how": "from the start"}, cycles=(1.0, 10.0))
    # A mass that flies at an anchor and passes it at that distance, or meets it.
    offset = float(rng.choice([0.0, distance]))
    structure = Structure(
        "passing",
        {"anchor": (0.0, 0.0, 0.0), "mass": (1.0, offset, 0.0)},
        strings=(String("string", ("anchor", "mass"), 20.0, rest_length=float(rng.choice([1e-6, 0.3, 0.01]))),),
        fixed_nodes=("anchor",),
        point_masses=(PointMass("mass", 1.0),),
    )
    return Experiment(
        Scene(structure, initial_velocities=np.array([[0, 0, 0], [-1.0, 0, 0]])),
        facts=facts | {"how": "passing by", "offset": offset, "rest length": structure.strings[0].rest_length},
        cycles=(1.0, 3.0),
    )


def _pole(rng: Rng) -> Experiment:
    structure = ordinary(rng, planar=False, support=["free", "pinned"])
    nodes = {name: np.array(position) for name, position in structure.nodes.items()}
    tilt = float(rng.choice([0.0, log_uniform(rng, 1e-9, 0.3)]))
    turn, sign = float(rng.uniform(0, 2 * math.pi)), float(rng.choice([-1.0, 1.0]))
    for rod, length in zip(structure.rods, structure.rod_lengths, strict=True):
        if rod is structure.rods[0] or rng.uniform() < 0.5:
            b = np.array([math.sin(tilt) * math.cos(turn), math.sin(tilt) * math.sin(turn), sign * math.cos(tilt)])
            nodes[rod.nodes[1]] = nodes[rod.nodes[0]] + length * b
    structure = replace(structure, nodes={name: tuple(place.tolist()) for name, place in nodes.items()})
    scene = _scene(rng, structure, speed=float(rng.choice([0.1, 3.0])))
    return replace(maybe_driven(rng, scene, {"tilt": tilt}), cycles=(1.0, 10.0))


def _degenerate(rng: Rng) -> Experiment:
    aside = float(rng.choice([0.0, log_uniform(rng, 1e-12, 1e-2)]))
    facts: dict[str, Any] = {"speed out of the plane or line": aside}
    if rng.uniform() < 0.5:
        flat = ordinary(rng, planar=True)
        velocities = random_velocities(rng, flat, flat.positions, 1.0)
        structure = replace(flat, rods=tuple(replace(rod, support=_spatial(rod.support)) for rod in flat.rods))
        facts["shape"] = "planar"
    else:
        structure = _collinear(rng)
        line = np.array(
            structure.rods[0].support.directions or [unit(structure.positions[-1] - structure.positions[0])]
        )[-1]
        velocities = np.zeros((len(structure.nodes), 3))
        for pair in structure.rod_nodes:
            velocities[pair] = rng.uniform(-1, 1) * line
        facts["shape"] = "collinear"
    velocities = velocities + random_velocities(rng, structure, structure.positions, aside)
    scene = Scene(structure, initial_velocities=velocities)
    return Experiment(scene, facts=facts, cycles=(1.0, 5.0))


def _spatial(support: Support) -> Support:
    """Return the support without a plane to turn in, and free to leave it."""
    return Support(support.sigma, support.directions, None, None)


def _collinear(rng: Rng) -> Structure:
    """Rods one behind the other between two anchors, all on one line, with strings from each to the next."""
    count = int(rng.integers(1, 5))
    line = np.eye(3)[2] if rng.uniform() < 0.2 else direction(rng)
    gaps = rng.uniform(0.3, 1.0, 2 * count + 1)
    at = np.concatenate([[0.0], np.cumsum(gaps)])
    names = ["left", *(f"{end}{r}" for r in range(count) for end in "ab"), "right"]
    strings = tuple(
        String(f"s{r}", (names[2 * r], names[2 * r + 1]), float(rng.uniform(10, 50)), rest_length=0.8 * gaps[2 * r])
        for r in range(count + 1)
    )
    return Structure(
        "collinear",
        {name: tuple((x * line).tolist()) for name, x in zip(names, at, strict=True)},
        rods=tuple(Rod(f"rod{r}", (f"a{r}", f"b{r}"), float(rng.uniform(0.5, 2.0))) for r in range(count)),
        strings=strings,
        fixed_nodes=("left", "right"),
    )


def _contrast(rng: Rng) -> Experiment:
    count = int(rng.integers(2, 5))
    lengths = [log_uniform(rng, 1e-3, 1e3) for _ in range(count)]
    masses = [log_uniform(rng, 1e-3, 1e3) for _ in range(count)]
    lengths[0], lengths[1] = 1e-3, 1e3
    masses = [float(x) for x in rng.permutation([1e-3, 1e3, *masses[2:]])]
    nodes: dict[str, tuple[float, float, float]] = {"anchor": (0.0, 0.0, 0.0)}
    rods = []
    for number, (length, mass) in enumerate(zip(lengths, masses, strict=True)):
        first = rng.uniform(-1, 1, 3) * max(1.0, 0.1 * length)
        second = first + length * direction(rng)
        nodes[f"a{number}"], nodes[f"b{number}"] = tuple(first.tolist()), tuple(second.tolist())
        support = Support.pinned(0.0) if rng.uniform() < 0.3 else Support.free()
        rods.append(Rod(f"rod{number}", (f"a{number}", f"b{number}"), mass, 0.01 * length, support))
    names = list(nodes)
    pairs = [(i, j) for a, i in enumerate(names) for j in names[a + 1 :] if i[1:] != j[1:]]  # none along a rod
    cords = []
    for number, pair in enumerate(rng.choice(len(pairs), 2 * count, replace=False)):
        i, j = pairs[int(pair)]
        span = float(np.linalg.norm(np.subtract(nodes[i], nodes[j])))
        rest = span * (1 - float(rng.uniform(-0.05, 0.3)))
        cords.append(String(f"s{number}", (i, j), log_uniform(rng, 1.0, 1e4), rest_length=rest))
    structure = Structure("contrast", nodes, tuple(rods), tuple(cords), fixed_nodes=("anchor",))
    scene = Scene(structure, initial_velocities=random_velocities(rng, structure, structure.positions, 0.01))
    return Experiment(scene, facts={"lengths": lengths, "masses": masses})


def _bad_law(rng: Rng) -> Experiment:
    structure = ordinary(rng, strings=4, fixed_nodes=2)
    mistake = str(rng.choice(list(laws.MISTAKES)))
    begins = float(rng.choice([0.0, rng.uniform(0.05, 0.95)]))
    u = rng.uniform(0.5, 5.0, len(structure.strings))
    mode = Mode(str(rng.choice([mode.value for mode in Mode])))
    return Experiment(
        _scene(rng, structure),
        lambda duration: laws.GoesWrong(u, mistake, begins * duration),
        mode,
        force_density=5.0,
        facts={"mistake": mistake, "from": begins, "actuation": mode.value},
    )


def _wild_law(rng: Rng) -> Experiment:
    structure = ordinary(rng, strings=int(rng.integers(3, 9)))
    size = log_uniform(rng, 1e2, 1e8)
    u = size * rng.uniform(0.5, 1.0, len(structure.strings))
    scene = _scene(rng, structure)
    if rng.uniform() < 0.5:
        facts = {"u": size, "how": "constant"}
        return Experiment(scene, lambda duration: laws.Waving(u), force_density=size, cycles=COLLAPSE, facts=facts)
    low = float(rng.choice([0.0, -1.0, 0.5]))
    mode = Mode(str(rng.choice([Mode.HOLD_FORCE_DENSITY.value, Mode.HOLD_REST_LENGTH.value])))
    # A held rest length keeps the string's own stiffness, which then pulls with k (L - L0), L0 = L (1 - u/k).
    return Experiment(
        scene,
        lambda duration: laws.Alternating(u, low, duration / 20),
        mode,
        force_density=size,
        cycles=COLLAPSE,
        facts={"u": size, "how": "alternating", "low": low, "actuation": mode.value},
    )


def _infeasible(rng: Rng) -> Experiment:
    from tensegrity_mj.controllers.lyapunov import Lyapunov
    from tensegrity_mj.library.named import load_scene

    which = str(rng.choice(["prism", "pinned_rod", "random"]))
    if which == "random":
        structure = ordinary(rng, rods=int(rng.integers(1, 3)), strings=6, planar=False, support="free", fixed_nodes=2)
        scene = random_scene(rng, structure, moving=0.1)
    else:
        scene = load_scene(which)
    away = log_uniform(rng, 0.01, 2.0)
    target = Target.set_point(random_configuration(rng, scene.structure, away))
    decay = log_uniform(rng, 0.1, 10.0)
    # A law without a solution, or near that, commands the u that it needs to keep its promise, however large.
    scene = scene.with_(target=target)
    law = Lyapunov(scene.structure, target, decay_rate=decay, maximum_force_density=100.0)
    passive = bool(rng.integers(2))
    return Experiment(
        scene,
        lambda duration: law,
        on_infeasible=OnInfeasible.PASSIVE if passive else OnInfeasible.STOP,
        rate=100.0 + 10 * decay,
        facts={"structure": which, "target away": away, "decay rate": decay, "passive": passive},
    )


def _past_limit(rng: Rng) -> Experiment:
    structure = ordinary(rng, stiffness=(10.0, log_uniform(rng, 11.0, 1e5)), damping=(0.0, float(rng.integers(2))))
    excess = log_uniform(rng, 0.5, 100.0)
    return Experiment(_scene(rng, structure), excess=excess, engines=FIXED_STEP, facts={"step over limit": excess})


def _member_past_limit(rng: Rng) -> Experiment:
    light = (draws.threaded, draws.massive, draws.elastic, draws.curved, draws.body, draws.constrained)
    structure, facts = (*light, draws.carried)[int(rng.integers(7))](rng)
    excess = log_uniform(rng, 0.5, 100.0)
    facts |= {"step over limit": excess}
    return Experiment(_scene(rng, structure), excess=excess, engines=FIXED_STEP, facts=facts)


def _spin(rng: Rng) -> Experiment:
    rods, tied = int(rng.integers(1, 6)), bool(rng.integers(2))
    structure = random_structure(
        rng, rods=rods, support="free", fixed_nodes=0, strings=None if tied and rods > 1 else 0, stretch=(-0.3, 0.1)
    )
    spin = log_uniform(rng, 0.1, 1e3)
    scene = random_scene(rng, structure, moving=spin, gravity=bool(rng.integers(2)))
    return Experiment(scene, facts={"spin": spin, "strings": len(structure.strings)}, cycles=(1.0, 10.0))


def _large(rng: Rng) -> Experiment:
    structure = random_structure(rng, rods=500, support=["free", "pinned"], strings=1500, stretch=(0.05, 0.1))
    scene = random_scene(rng, structure, moving=0.1)
    return Experiment(scene, cycles=(0.2, 0.5), engines=("rk4", "euler", "dae rk4"), facts={"rods": 500})


def _long(rng: Rng) -> Experiment:
    # Well tied and in small motion: what is tried is the number of steps, not how far chaos takes an error.
    structure = random_structure(rng, rods=1, planar=True, support="pinned", fixed_nodes=3, strings=3)
    structure = structure.with_strings(rest_length=0.5 * structure.string_lengths(structure.positions))
    scene = random_scene(rng, structure, moving=0.1)
    return Experiment(scene, steps=10**6, engines=("rk4", "euler", "dae rk4", "ode rk4"), facts={"steps": 10**6})


FIXED_STEP = ("euler", "implicitfast", "implicit", "rk4", "discrete", "dae rk4", "ode rk4")


class Kind(enum.Enum):
    """Kinds of extreme runs, in words, each with the function that draws an experiment of the kind.

    Drawing raises TensegrityError where what was drawn is no valid structure or scene.
    """

    draw: Callable[[Rng], Experiment]

    def __new__(cls, words: str, draw: Callable[[Rng], Experiment]) -> Kind:
        """A member whose value is the words."""
        one = object.__new__(cls)
        one._value_, one.draw = words, draw
        return one

    STIFF = ("stiff strings, k to 1e9 N/m", _stiff)
    SLACK = ("all strings slack", _slack)
    NO_PRESTRESS = ("zero prestress", _no_prestress)
    NEGATIVE_REST = ("rest lengths <= 0", _negative_rest)
    VANISHING = ("a string of vanishing length", _vanishing)
    POLE = ("rods at the poles of the ODE", _pole)
    DEGENERATE = ("collinear or planar in space", _degenerate)
    CONTRAST = ("rods of 1e-3 to 1e3 m and kg together", _contrast)
    BAD_LAW = ("a law that returns nonsense", _bad_law)
    WILD_LAW = ("huge or alternating u", _wild_law)
    INFEASIBLE = ("infeasible targets", _infeasible)
    PAST_LIMIT = ("steps near and past the stability limit", _past_limit)
    SPIN = ("free flight with spin", _spin)
    THREADED = ("strings over pulleys", partial(_with_member, draws.threaded))
    MASSIVE = ("strings with mass", partial(_with_member, draws.massive))
    JOINED = ("rods that share nodes: trees and loops", draws.joined)
    MOVED = ("supports that move", draws.moved)
    RESISTED = ("fluid, bending joints and wind", draws.resisted)
    CONTACT = ("landings on a floor", draws.contact)
    ELASTIC = ("elastic rods", partial(_with_member, draws.elastic))
    CURVED = ("tension curves, yields and constant forces", partial(_with_member, draws.curved))
    BODY = ("rigid bodies", partial(_with_member, draws.body))
    CONSTRAINED = ("linear constraints on nodes", partial(_with_member, draws.constrained))
    CARRIED = ("masses on rods and dampers on nodes", partial(_with_member, draws.carried))
    MEMBER_PAST_LIMIT = ("steps near and past the limit, of all these members", _member_past_limit)
    LARGE = ("500 rods", _large)
    LONG = ("1e6 steps", _long)
