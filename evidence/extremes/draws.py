"""Draws of structures: members of all kinds, joints, moved supports, what resists motion, landings on a floor."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np

from evidence.extremes.experiment import COLLAPSE, Experiment, Rng, direction, maybe_driven, ordinary
from evidence.random_linked import log_uniform, random_linked_structure, random_velocities
from evidence.random_structures import random_rotation, random_structure
from tensegrity_mj.model.bodies import Body
from tensegrity_mj.model.constraints import Constraint
from tensegrity_mj.model.elements.contact import Contact
from tensegrity_mj.model.elements.resistance import Bending, Drag, Resistance
from tensegrity_mj.model.events import Load
from tensegrity_mj.model.forest import spanning_forest
from tensegrity_mj.model.members import PointMass, RodMass, String, null_space_basis
from tensegrity_mj.model.motion import Motion
from tensegrity_mj.model.rods import lumped_masses
from tensegrity_mj.model.scene import Scene
from tensegrity_mj.model.strings import elastic_tension
from tensegrity_mj.model.structure import Structure


def _linked(rng: Rng, **changes: Any) -> Structure:
    options: dict[str, Any] = {
        "rods": int(rng.integers(2, 6)),
        "loops": int(rng.choice([0, 1, 2])),
        "planar": bool(rng.integers(2)),
        "pinned": bool(rng.uniform() < 0.75),
        "strings": int(rng.integers(1, 6)),
        "stretch": (-0.1, 0.4),
        "stiffness": (10.0, log_uniform(rng, 11.0, 1e5)),
        "damping": (0.0, float(rng.integers(2))),
    }
    return random_linked_structure(rng, **options | changes)


def _hanging_rate(structure: Structure, pull: float) -> float:
    """A bound on how fast rods swing [1/s] that hang on each other and feel so much weight [m/s²]: ω² = 12 T / (m ℓ).

    T is at most the weight of all and what all strings pull; m and ℓ are the least.
    """
    masses, lengths = structure.rod_masses, structure.rod_lengths
    strings = elastic_tension(
        structure.stiffness, structure.string_lengths(structure.positions), structure.rest_lengths
    )
    tension = pull * float(masses.sum()) + float(np.sum(strings))
    return math.sqrt(12 * tension / float((masses * lengths).min()))


def _facts(structure: Structure) -> dict[str, Any]:
    loops = len(spanning_forest(structure).closures)
    return {"rods": len(structure.rods), "loops": loops, "k": float(structure.stiffness.max(initial=0.0))}


def joined(rng: Rng) -> Experiment:
    """A tree of two to five rods, with up to two more that close loops."""
    structure = _linked(rng)
    gravity = rng.uniform() < 0.7
    scene = Scene(
        structure,
        gravity=tuple((9.81 * direction(rng)).tolist()) if gravity else (0.0, 0.0, 0.0),
        initial_velocities=random_velocities(rng, structure, structure.positions, log_uniform(rng, 0.01, 3.0)),
        loads=_push(rng, structure),
    )
    driven = maybe_driven(rng, scene, _facts(structure))
    rate = _hanging_rate(structure, 9.81 if gravity else 0.0)
    return replace(driven, rate=rate, cycles=COLLAPSE)


def _push(rng: Rng, structure: Structure) -> tuple[Load, ...]:
    """A load on some node, sometimes."""
    count = int(rng.integers(2))
    return tuple(
        Load(str(rng.choice(structure.node_names)), tuple(rng.normal(size=3)), float(rng.uniform(0, 5)), 0.3)
        for _ in range(count)
    )


def moved(rng: Rng) -> Experiment:
    """Pinned rods and fixed nodes that are moved to and fro or round, of rods that share nodes or not."""
    linked = bool(rng.integers(2))
    if linked:
        structure = _linked(rng, pinned=True)
    else:
        structure = ordinary(rng, support=["pinned", "free"], fixed_nodes=int(rng.integers(1, 3)))
    held = [rod.name for rod in structure.rods if len(rod.support.directions)]
    plane = next((rod.support.plane for rod in structure.rods if rod.support.plane is not None), None)
    basis = np.eye(3) if plane is None else null_space_basis(np.array([plane]))
    motions: list[Motion] = []
    fastest = 0.0
    for name in [*held, *structure.fixed_nodes]:
        if motions and rng.uniform() < 0.5:
            continue
        size, beat = log_uniform(rng, 1e-4, 0.2), log_uniform(rng, 0.1, 20.0)
        size = min(size, 50.0 / (2 * math.pi * beat) ** 2)  # at most some 5 g
        fastest = max(fastest, size * (2 * math.pi * beat) ** 2)
        if rng.uniform() < 0.5:
            motions.append(Motion.in_line(name, size, beat, basis @ rng.normal(size=basis.shape[1])))
        else:
            normal = plane if plane is not None else tuple(rng.normal(size=3).tolist())
            motions.append(Motion.circular(name, size, beat, normal))
    gravity = bool(rng.integers(2))
    scene = Scene(
        structure,
        gravity=tuple((9.81 * (basis @ direction(rng, basis.shape[1]))).tolist()) if gravity else (0.0, 0.0, 0.0),
        motions=tuple(motions),
    )
    beats = [float(np.max([h.angular_frequency for h in motion.harmonics])) for motion in motions]
    rate = max(beats) + (_hanging_rate(structure, 9.81 * gravity + fastest) if linked else 0.0)
    facts = {"motions": len(motions), "joined": linked, "acceleration": fastest}
    return Experiment(scene, rate=rate, cycles=COLLAPSE, facts=facts)


def resisted(rng: Rng) -> Experiment:
    """Viscous fluid, drag, wind and joints that resist bending, each or together."""
    linked = bool(rng.integers(2))
    structure = _linked(rng) if linked else ordinary(rng)
    viscous = float(rng.choice([0.0, log_uniform(rng, 1e-3, 10.0)]))
    bending = None
    if linked and rng.uniform() < 0.7:
        bending = Bending(log_uniform(rng, 1e-3, 100.0), float(rng.choice([0.0, log_uniform(rng, 1e-4, 1.0)])))
    drag = None
    if bending is None or rng.uniform() < 0.5:
        drag = Drag(density=log_uniform(rng, 1.0, 1000.0), tangential=float(rng.choice([0.0, 0.1])), diameter=0.02)
    felt = viscous > 0 or drag is not None
    wind = tuple((float(rng.choice([0.0, 2.0])) * felt * direction(rng)).tolist())
    speed = log_uniform(rng, 0.01, 3.0)
    scene = Scene(
        structure,
        gravity=(0.0, 0.0, -9.81) if rng.uniform() < 0.5 else (0.0, 0.0, 0.0),
        initial_velocities=random_velocities(rng, structure, structure.positions, speed),
        resistance=Resistance(viscous, bending, drag, wind),
    )
    # For a rod alone: a fluid's decay, 12 of it in turning about its middle, and a joint's moment over m ℓ² / 12.
    masses, lengths = structure.rod_masses, structure.rod_lengths
    faster = speed + float(np.linalg.norm(wind))
    by_length = viscous + (0.0 if drag is None else 0.5 * drag.density * drag.normal * 0.02 * faster)
    rate = float((by_length * lengths / masses).max()) * 4
    if bending is not None:
        inertia = float((masses * lengths**2).min()) / 12
        rate += 2 * math.sqrt(bending.stiffness / inertia) + 4 * bending.damping / inertia
    if linked:
        rate += _hanging_rate(structure, 9.81)
    facts: dict[str, Any] = {"joined": linked, "viscous": viscous}
    facts["bending"] = None if bending is None else bending.stiffness
    facts["density"] = None if drag is None else drag.density
    return Experiment(scene, rate=rate, cycles=COLLAPSE, facts=facts)


def contact(rng: Rng) -> Experiment:
    """One to three rods, tied to each other, that fall on a floor within a cycle; rods may touch each other, too."""
    structure = random_structure(rng, rods=int(rng.integers(1, 4)), support="free", fixed_nodes=0, stretch=(0.0, 0.2))
    stiffness, ratio = log_uniform(rng, 1e3, 1e6), log_uniform(rng, 0.1, 3.0)
    damping = 2 * ratio * math.sqrt(stiffness)
    rate = math.sqrt(stiffness) * (ratio + math.sqrt(abs(ratio**2 - 1)) if ratio > 1 else 1.0)
    speed = log_uniform(rng, 0.05, 2.0)
    width = log_uniform(rng, 0.1, 2.0) * speed / math.sqrt(stiffness)  # of the depth that it comes to
    lowest = min(
        structure.positions[pair, 2].min() - rod.radius
        for rod, pair in zip(structure.rods, structure.rod_nodes, strict=True)
    )
    touch = Contact(
        floor=float(lowest) - speed * float(rng.uniform(0.2, 1.0)) * 2 * math.pi / rate,
        rods=bool(rng.integers(2)) and len(structure.rods) > 1,
        friction=float(rng.choice([0.0, 0.3, 1.0])),
        stiffness=stiffness,
        damping=damping,
        impedance=(float(rng.choice([0.01, 0.1])), 0.95, max(1e-6, width), 0.5, 2.0),
    )
    velocities = np.zeros((len(structure.nodes), 3))
    for pair in structure.rod_nodes:
        velocities[pair, 2] = -speed
    scene = Scene(structure, gravity=(0.0, 0.0, -9.81), initial_velocities=velocities, contact=touch)
    return Experiment(
        scene,
        rate=2 * rate,
        cycles=(2.0, 6.0),
        facts={"stiffness": stiffness, "damping ratio": ratio, "speed": speed},
    )


Drawn = tuple[Structure, dict[str, Any]]  # and facts, as text


def threaded(rng: Rng) -> Drawn:
    """A string over three to eight nodes, stretched or slack."""
    structure = ordinary(rng, stiffness=(10.0, log_uniform(rng, 11.0, 1e5)))
    names = list(structure.nodes)
    # No node twice in a row: a draw of another one each time.
    path = [int(rng.integers(len(names)))]
    for _ in range(int(rng.integers(2, 7))):
        path.append((path[-1] + int(rng.integers(1, len(names)))) % len(names))
    length = float(np.linalg.norm(np.diff(structure.positions[path], axis=0), axis=1).sum())
    k, taut = log_uniform(rng, 10.0, 1e5), rng.uniform(-0.3, 0.3)
    string = String("threaded", tuple(names[i] for i in path), k, rest_length=length * (1 - taut))
    structure = replace(structure, strings=(*structure.strings, string))
    return structure, {"nodes": len(path), "k": k, "stretch": taut}


def massive(rng: Rng) -> Drawn:
    """A string with mass."""
    structure = ordinary(rng)
    row, segments = int(rng.integers(len(structure.strings))), int(rng.integers(1, 9))
    string = structure.strings[row]
    mass = log_uniform(rng, 1e-3, 1.0) * float(lumped_masses(structure).sum())
    heavy = replace(string, mass=mass, segments=segments)
    strings = (*structure.strings[:row], heavy, *structure.strings[row + 1 :])
    return replace(structure, strings=strings), {"mass": mass, "segments": segments, "k": string.stiffness}


def elastic(rng: Rng) -> Drawn:
    """Elastic rods, the last one rigid at times, that begin pressed together or drawn out."""
    structure = ordinary(rng, sigma=float(rng.integers(2)))  # MuJoCo holds them at their ends alone
    k, strain = log_uniform(rng, 1e2, 1e8), log_uniform(rng, 1e-6, 0.1)
    ratio = float(rng.choice([0.0, log_uniform(rng, 1e-3, 3.0)]))
    rods = list(structure.rods)
    for row in range(max(1, len(rods) - int(rng.integers(2)))):
        rest = float(structure.rod_lengths[row] * (1 + strain * rng.uniform(-1, 1)))
        damping = 2 * ratio * math.sqrt(k * rods[row].mass / 12)
        rods[row] = replace(rods[row], stiffness=k, damping=damping, rest_length=rest)
    return replace(structure, rods=tuple(rods)), {"k": k, "strain": strain, "damping ratio": ratio}


def curved(rng: Rng) -> Drawn:
    """Strings that stiffen or give way up to a thousandfold, or yield; some pull with a constant force."""
    structure = ordinary(rng, damping=(0.0, float(rng.integers(2))))
    strings, kinds = [], rng.choice(["stiffens", "gives way", "yields", "constant"], len(structure.strings)).tolist()
    for string, kind, rest in zip(structure.strings, kinds, structure.rest_lengths.tolist(), strict=True):
        k, bend, ratio = string.stiffness, rest * log_uniform(rng, 1e-3, 0.3), log_uniform(rng, 1e-3, 1.0)
        how: dict[str, Any] = {"stiffness": 0.0, "tension": k * bend}
        if kind != "constant":
            slope = k / ratio if kind == "stiffens" else k * ratio
            curve = ((bend, k * bend), (2 * bend, (k + slope) * bend))
            how = {"curve": curve, "yields": kind == "yields", "rest_length": rest}
        strings.append(String(string.name, string.nodes, damping=string.damping, **how))
    return replace(structure, strings=tuple(strings)), {"strings": kinds}


def body(rng: Rng) -> Drawn:
    """A body of 1e-3 to 1e3 kg, at times a needle or a plate, tied by its four to six nodes."""
    structure, size, mass = ordinary(rng), log_uniform(rng, 0.03, 1.0), log_uniform(rng, 1e-3, 1e3)
    names = [f"c{k}" for k in range(int(rng.integers(4, 7)))]
    places = rng.uniform(-2, 2, 3) + size * np.vstack([np.zeros(3), np.eye(3), rng.normal(size=(len(names) - 4, 3))])
    turn, radii = random_rotation(rng), [size * log_uniform(rng, 0.03, 1.0) for _ in range(3)]
    spread = mass * (turn * np.square(radii)) @ turn.T  # ∫ ξ ξᵀ dm
    moments = np.trace(spread) * np.eye(3) - spread
    inertia = (*np.diag(moments).tolist(), *moments[np.triu_indices(3, 1)].tolist())
    k, strings = log_uniform(rng, 10.0, 1e5), list(structure.strings)
    for name, place in zip(names, places, strict=True):
        other = str(rng.choice(structure.node_names))
        rest = float(np.linalg.norm(place - structure.nodes[other]) * rng.uniform(0.6, 1.1))
        strings.append(String(f"to {name}", (name, other), k, rest_length=rest))
    nodes = {**structure.nodes, **dict(zip(names, places.tolist(), strict=True))}
    bodies = (Body("body", tuple(names), mass, inertia),)
    return replace(structure, nodes=nodes, strings=tuple(strings), bodies=bodies), {"mass": mass, "size": size, "k": k}


def constrained(rng: Rng) -> Drawn:
    """One to three linear constraints, each on one or two ends of rods, with weights up to a thousandfold apart."""
    structure, constraints = ordinary(rng, rods=int(rng.integers(2, 5))), []
    ends = [node for rod in structure.rods for node in rod.nodes]
    for number in range(int(rng.integers(1, 4))):
        nodes = rng.choice(ends, int(rng.integers(1, 3)), replace=False).tolist()
        weights = {node: float(rng.choice([-1.0, 1.0])) * log_uniform(rng, 0.03, 30.0) for node in nodes}
        constraints.append(Constraint(f"held{number}", weights, tuple(direction(rng).tolist())))
    return replace(structure, constraints=tuple(constraints)), {"constraints": len(constraints)}


def carried(rng: Rng) -> Drawn:
    """Rods that carry 1e-3 to 1e3 of their mass, with inertia or without, and nodes with dampers."""
    structure, ratio = ordinary(rng, point_masses=int(rng.integers(2))), log_uniform(rng, 1e-3, 1e3)
    rods, points = [], [replace(point, damping=log_uniform(rng, 1e-3, 1e2)) for point in structure.point_masses]
    for rod, length in zip(structure.rods, structure.rod_lengths.tolist(), strict=True):
        mass, gyration = ratio * rod.mass, float(rng.choice([0.0, log_uniform(rng, 1e-3, 1.0)])) * length
        rods.append(replace(rod, masses=(RodMass(float(rng.uniform()), mass, mass * gyration**2),)))
        if rng.uniform() < 0.5:
            points.append(PointMass(str(rng.choice(rod.nodes)), mass, damping=mass * log_uniform(rng, 1e-3, 1e2)))
    return replace(structure, rods=tuple(rods), point_masses=tuple(points)), {"mass ratio": ratio}
