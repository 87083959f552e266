"""Draws of structures with members other than rigid rods and light strings between two nodes."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np

from tensegrity_mj.library.random_structures import log_uniform, random_rotation
from tensegrity_mj.model.bodies import Body
from tensegrity_mj.model.constraints import Constraint
from tensegrity_mj.model.members import PointMass, RodMass, String
from tensegrity_mj.model.rods import lumped_masses
from tensegrity_mj.model.structure import Structure
from tensegrity_mj.studies.extremes.experiment import Rng, direction, ordinary

Drawn = tuple[Structure, dict[str, Any]]  # and facts, for people


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
