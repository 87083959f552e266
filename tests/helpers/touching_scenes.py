"""Lone rods at random states in contact with a floor, and accelerations that an engine has there."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

import tensegrity_mj as tmj
from tensegrity_mj.dynamics.native.law import native_law
from tensegrity_mj.engines.request import Request
from tensegrity_mj.model import Contact
from tensegrity_mj.model.actuation import Actuation, OnInfeasible

Array = NDArray[np.float64]
State = tuple[tmj.Scene, Array, Array]


def random_contact(rng: np.random.Generator, **more: Any) -> Contact:
    """A floor of any slope, friction and hardness; d stays below .95, as by default."""
    normal = rng.normal(size=3)
    impedance = (rng.uniform(0.01, 0.5), rng.uniform(0.5, 0.95), 10 ** rng.uniform(-4, -2.3), rng.uniform(0.2, 0.8))
    return Contact(
        floor=rng.uniform(-1, 1),
        normal=(normal[0], normal[1], normal[2]),
        friction=float(rng.choice([0, 0.05, 0.3, 0.6, 1.0, 3.0])),
        stiffness=10 ** rng.uniform(3, 6),
        damping=10 ** rng.uniform(1, 3.3),
        impedance=(*impedance, float(rng.choice([1.0, 2.0, 3.5]))),
        **more,
    )


def touching_rod(rng: np.random.Generator, ends: int, **more: Any) -> State:
    """A rod that touches the floor with so many ends: scene, nodes and velocities (2, 3)."""
    contact, length, radius = random_contact(rng, **more), rng.uniform(0.6, 1.2), rng.uniform(0.003, 0.01)
    assert contact.floor is not None
    assert contact.impedance is not None
    up, width = contact.up, contact.impedance[2]
    depths = rng.uniform(0, 3, 2) * width
    if ends == 1:
        depths[1] = -rng.uniform(0.01, 0.9) * length
    lean = float(np.clip((depths[0] - depths[1]) / length, -0.95, 0.95))
    across = np.cross(up, rng.normal(size=3))
    b = np.sqrt(1 - lean**2) * across / np.linalg.norm(across) + lean * up
    first = up * (contact.floor + radius - depths[0]) + np.cross(up, rng.normal(size=3))
    nodes = np.array([first, first + length * b])
    masses = [tmj.model.RodMass(rng.uniform(0, 1), rng.uniform(0.1, 1.0))] if rng.random() < 0.3 else []
    support = tmj.Support.free(rng.uniform(0, 1))
    rod = tmj.Rod("rod", ("a", "b"), 10 ** rng.uniform(-1, 1), radius, support, masses=tuple(masses))
    turn = np.cross(b, rng.normal(size=3)) * 10 ** rng.uniform(-3, 1)
    velocity = rng.normal(size=3) * 10 ** rng.uniform(-3, 0.7)
    gravity = rng.normal(size=3) * 10
    scene = tmj.Scene(
        tmj.Structure("rod", {"a": tuple(nodes[0]), "b": tuple(nodes[1])}, (rod,)),
        gravity=(gravity[0], gravity[1], gravity[2]),
        contact=contact,
        initial_nodes=nodes + 5 * up,
    )
    return scene, nodes, np.array([velocity, velocity + length * np.cross(turn, b)])


def touching_robot(scene: tmj.Scene, rng: np.random.Generator) -> State:
    """A scene's structure turned at random, its lowest node a little inside the floor, moving at random."""
    contact = scene.contact
    assert contact is not None
    assert contact.floor is not None
    turned = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    nodes = (scene.nodes0 - scene.nodes0.mean(axis=0)) @ turned.T
    depth = rng.uniform(0, 3) * contact.impedance[2] if contact.impedance else 1e-3
    nodes += (contact.floor + scene.structure.rods[0].radius - depth - (nodes @ contact.up).min()) * contact.up
    velocities = rng.normal(size=3) + np.cross(rng.normal(size=3), nodes - nodes.mean(axis=0))
    return scene.with_(contact=replace(contact, friction=float(rng.choice([0, 0.1, 0.6, 1.5])))), nodes, velocities


def held_rod(rng: np.random.Generator) -> State:
    """A rod that is pinned at its upper end, or turns in the xz plane, or both; the lower end touches."""
    length, planar, pinned = rng.uniform(0.6, 1.2), bool(rng.random() < 0.7), bool(rng.random() < 0.7)
    b = np.array([rng.normal(), 0.0 if planar else rng.normal(), -rng.uniform(0.05, 1)])
    b /= np.linalg.norm(b)
    plane = (0.0, 1.0, 0.0) if planar else None
    support = tmj.Support.pinned(0.0, plane) if pinned else tmj.Support.free(0.5, plane)
    rod = tmj.Rod("rod", ("a", "b"), rng.uniform(0.1, 3), rng.uniform(0.003, 0.01), support)
    contact = Contact(
        floor=length * b[2] - rod.radius + rng.uniform(0, 1e-3), friction=float(rng.choice([0, 0.3, 1.0]))
    )
    level = {"a": (0.0, 0.0, 0.0), "b": (length, 0.0, 0.0)}
    scene = tmj.Scene(tmj.Structure("rod", level, (rod,)), gravity=(0, 0, -9.81), contact=contact)
    turn = np.array([0, rng.normal(), 0]) if planar else np.cross(b, rng.normal(size=3))
    velocity = np.zeros(3) if pinned else rng.normal(size=3) * (1, float(not planar), 1)
    return scene, np.array([np.zeros(3), length * b]), np.array([velocity, velocity + np.cross(turn, length * b)])


def pile(rng: np.random.Generator) -> State:
    """Two to four rods that cross each other near the origin, a node of the lowest in the floor."""
    names, rods, nodes, velocities = {}, [], [], []
    for k in range(int(rng.integers(2, 5))):
        length, b = rng.uniform(0.6, 1.2), rng.normal(size=3) * (1, 1, 0.3)
        b /= np.linalg.norm(b)
        ends = rng.normal(size=3) * 0.02 + np.outer(np.array([-1, 1]) * rng.uniform(0.2, 0.8, 2) * length, b)
        names |= {
            f"{end}{k}": tuple(place + np.array([0, 0, 10 * k + 10])) for end, place in zip("ab", ends, strict=True)
        }
        rods.append(tmj.Rod(f"r{k}", (f"a{k}", f"b{k}"), rng.uniform(0.1, 2), rng.uniform(0.013, 0.02)))
        nodes += list(ends)
        velocity, turn = rng.normal(size=(2, 3))
        velocities += [velocity, velocity + np.cross(np.cross(b, turn), ends[1] - ends[0])]
    floor = min(place[2] for place in nodes) + 0.012
    friction, spin = float(rng.choice([0, 0.1, 0.6, 1.5])), str(rng.choice(["held", "free"]))
    contact = Contact(floor=floor, rods=True, friction=friction, spin=spin)
    scene = tmj.Scene(tmj.Structure("pile", names, rods), gravity=(0, 0, -9.81), contact=contact)
    return scene, np.array(nodes), np.array(velocities)


def logs(rng: np.random.Generator) -> State:
    """Two rods side by side or end to end, parallel or nearly so, wherever one begins along the other."""
    lengths, radii = rng.uniform(0.3, 1.0, 2), rng.uniform(0.013, 0.02, 2)
    b, n = np.linalg.qr(rng.normal(size=(3, 2)))[0].T
    apart = rng.choice([0.0, 1.0]) * (radii.sum() - 1e-3) * n
    start = rng.uniform(-1, 1) * lengths[0] * b if apart.any() else (lengths[0] + radii.sum() - 1e-3) * b
    turned = b + float(rng.choice([0, 1e-6, 9e-5])) * np.cross(b, n)
    turned *= rng.choice([-1, 1]) / np.linalg.norm(turned)
    nodes = np.array([0 * b, lengths[0] * b, start + apart, start + apart + lengths[1] * turned])
    if nodes[3] @ b < nodes[2] @ b and not apart.any():
        nodes[2:] = nodes[:1:-1] + lengths[1] * b
    names = {"a0": (0, 0, 0), "b0": (lengths[0], 0, 0), "a1": (0, 0, 9), "b1": (lengths[1], 0, 9)}
    rods = [tmj.Rod(f"r{k}", (f"a{k}", f"b{k}"), rng.uniform(0.1, 2), radii[k]) for k in range(2)]
    contact = Contact(rods=True, friction=float(rng.choice([0, 0.6])), spin=str(rng.choice(["held", "free"])))
    scene = tmj.Scene(tmj.Structure("logs", names, rods), gravity=(0, 0, -9.81), contact=contact)
    return scene, nodes, np.repeat(rng.normal(size=(2, 3)), 2, axis=0)


def reaction(scene: tmj.Scene, engine: Any, nodes: Array, velocities: Array) -> Array:
    """(N, 3) [m/s²], at a state that no scene may begin with: it may be deep inside the floor."""
    law = native_law(None, scene.structure)
    request = Request(scene, law, Actuation.continuous(), OnInfeasible.STOP, 1.0, None, False)
    return np.asarray(engine.accelerations(request)(0.0, nodes, velocities)[1])
