"""How right contact is: bounce, rest, slide and tip against closed forms; no number here is an engine's own."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import brentq

import tensegrity_mj as tmj
from tensegrity_mj.library.prism import prism
from tensegrity_mj.library.six_bar import icosahedron
from tensegrity_mj.model import Contact
from tensegrity_mj.model.rods import centre_of_mass
from tensegrity_mj.runs.standing import standing

G = 9.81
FREQUENCY = 400.0  # √stiffness [rad/s], of the default stiffness
CONSTANT = (0.95, 0.95, 2e-3, 0.5, 2.0)  # an impedance that is the same at every depth


# MuJoCo at a step, the DAE by error control.
both = pytest.mark.parametrize("engine", [tmj.MuJoCo, lambda step: tmj.DAE()], ids=["mujoco", "dae"])


def restitution(ratio: float) -> float:
    """Of a damped spring that pushes only: exp(-ζ/√(1 - ζ²) (π - 2 arcsin ζ)), or its like for ζ > 1."""
    if ratio < 1:
        root = np.sqrt(1 - ratio**2)
        return float(np.exp(-ratio / root * (np.pi - 2 * np.arcsin(ratio))))
    root = np.sqrt(ratio**2 - 1)
    return float(np.exp(-ratio / root * np.log((ratio + root) / (ratio - root))))


@pytest.mark.parametrize("ratio", [0.05, 0.3, 0.7, 1.5])
@pytest.mark.parametrize("speed", [0.3, 3.0])
def test_a_rod_bounces_with_the_restitution_of_a_damped_spring(ratio: float, speed: float) -> None:
    """With a constant impedance the law is that of a damped spring on the mass that it feels: r̈ + 2 ζ ω ṙ + ω² r = 0.

    It pushes only, so that it ends where r̈ = 0. Without weight all speeds bounce alike. At touch the acceleration jumps
    by 2 ζ ω v, which a step of h = 2e-6 s over it gets wrong by up to 2 ζ ω h v = 8e-4 ζ v; the end is smooth.
    """
    structure = tmj.Structure(
        "rod",
        nodes={"a": (0, 0, 0.021), "b": (0, 0, 0.621)},
        rods=(tmj.Rod("rod", ("a", "b"), 0.7, 0.02, tmj.Support.free(0.5, plane=(0, 1, 0))),),
        strings=(),
    )
    contact = Contact(floor=0.0, friction=0.0, damping=2 * ratio * FREQUENCY, impedance=CONSTANT)
    scene = tmj.Scene(structure, contact=contact, initial_velocities=[(0, 0, -speed)] * 2)
    until = round(1e-3 / speed + 0.03, 4)
    run = tmj.simulate(scene, None, tmj.MuJoCo(2e-6), duration=until, output_interval=until)
    assert -run.velocities[-1, 0, 2] / run.velocities[0, 0, 2] == pytest.approx(restitution(ratio), abs=8e-4 * ratio)
    lost = 0.5 * 0.7 * speed**2 * (1 - restitution(ratio) ** 2)
    assert -run.external_work[-1] == pytest.approx(lost, abs=0.7 * speed**2 * 8e-4 * ratio)


def unbalanced(depth: float, contact: Contact) -> float:
    """What is left [m/s²] of stiffness d² r = g d₁² (1 - d), which holds where a lone body rests."""
    d0, d1, width, middle, power = contact.spring.impedance
    x = min(depth / width, 1.0)
    share = middle * (x / middle) ** power if x <= middle else 1 - (1 - middle) * ((1 - x) / (1 - middle)) ** power
    d = d0 + (d1 - d0) * share
    return float(contact.stiffness * d**2 * depth / d1**2 - G * (1 - d))


@both
def test_what_rests_sinks_in_as_the_law_says(engine: Callable[[float], Any]) -> None:
    """At rest stiffness d² r = g d₁² (1 - d): 0.90 mm by default, whatever the mass.

    What is left of the motion decays with 200 /s or faster: by e^-200 in a second. The point is a ball of a nanometre.
    """
    for stiffness, mass in ((4e4, 0.5), (4e4, 50.0), (1e6, 0.5)):
        contact = Contact(floor=0.0, stiffness=stiffness, damping=2 * np.sqrt(stiffness))
        structure = tmj.Structure("point", {"a": (0, 0, 0)}, (), (), point_masses=(tmj.model.PointMass("a", mass),))
        scene = tmj.Scene(structure, gravity=(0, 0, -G), contact=contact)
        run = tmj.simulate(scene, None, engine(2e-4), duration=1.0)
        assert -run.nodes[-1, 0, 2] == pytest.approx(
            brentq(unbalanced, 1e-9, 1.0, args=(contact,), xtol=1e-14), abs=2e-9
        )
        assert run.reports["contact"]["final_forces"]["a"][2] == pytest.approx(mass * G, rel=1e-9)


def lean(along: NDArray[np.float64], tangent: float) -> tuple[float, float, float]:
    """Gravity [m/s²] as on a slope of this tangent, down along a horizontal unit vector."""
    angle = np.arctan(tangent)
    pull = G * (np.sin(angle) * np.asarray(along) - np.cos(angle) * np.array([0, 0, 1.0]))
    return float(pull[0]), float(pull[1]), float(pull[2])


@both
def test_a_robot_slides_where_the_slope_is_steeper_than_its_friction(engine: Callable[[float], Any]) -> None:
    """On three feet: at half of tan α = μ it creeps, at 1.02 of it, it slides with g (sin α - μ cos α).

    Normal forces add up to the weight across the slope, but for what it rises while it gets faster, 2.3e-4 m/s², a part
    of .4 % of the small difference of two larger numbers, .056 m/s²; it swings as it starts, which averages out to a
    percent. Creep: friction sticks as a damper, and turns rods about their axes (docs/contact.md).
    """
    slides = {}
    for share in (0.5, 1.02):
        scene = icosahedron(friction=0.3, stiffness=1e4, damping=20.0)
        scene = scene.with_(gravity=lean(np.array([1.0, 0, 0]), share * 0.3))
        run = tmj.simulate(scene, None, engine(2.5e-4), duration=1.5, output_interval=0.01)
        slides[share] = run.time, centre_of_mass(scene.structure, run.velocities)[:, 0]
    time, speed = slides[0.5]
    assert np.abs(speed[time > 1]).max() < 2e-3
    time, speed = slides[1.02]
    angle = np.arctan(1.02 * 0.3)
    found = np.polyfit(time[time > 0.7], speed[time > 0.7], 1)[0]
    assert found == pytest.approx(G * (np.sin(angle) - 0.3 * np.cos(angle)), rel=0.02)


@both
def test_a_prism_tips_where_its_centre_of_mass_is_above_an_edge(engine: Callable[[float], Any]) -> None:
    """On a slope of tan α = d/h, d the distance of the centre of mass from the edge and h its height above the floor.

    Strings of 10 kN/m give by m g/(k R) = 0.3 % of the size, and feet sink in by 0.9 mm of 158: .99 and 1.01 differ.
    """
    scene = prism(3, stiffness=1e4, friction=3.0)
    structure, nodes = scene.structure, scene.nodes0
    first, second, centre = nodes[0], nodes[1], centre_of_mass(structure, nodes)
    outward = np.cross(second - first, [0, 0, 1.0]) / np.linalg.norm(second - first)
    outward *= np.sign(outward @ (first - centre))
    tangent = float(outward @ (first - centre)) / centre[2]
    for share, feet in ((0.99, 3), (1.01, 2)):
        leaning = scene.with_(gravity=lean(outward, share * tangent))
        run = tmj.simulate(leaning, None, engine(5e-4), duration=0.8, output_interval=0.02)
        base = standing(run).bases[-1]
        assert {"r1a", "r2a"} <= set(base)
        assert ("r3a" in base) == (feet == 3)


@both
def test_feet_of_a_robot_that_stands_unevenly_carry_what_balances_it(engine: Callable[[float], Any]) -> None:
    """Without friction: the forces add up to the weight, and their middle is where the centre of mass is.

    One string of the base is shorter by a third, and no two feet carry alike. It swings out with its strings' damping:
    what is left after 6 s moves by 1e-7 m/s, and accelerates by less than 1e-5 m/s².
    """
    scene = icosahedron(friction=0.0)
    lengths = np.array(scene.structure.rest_lengths)
    lengths[[string.name for string in scene.structure.strings].index("r1a_r4a")] *= 0.7
    scene = scene.with_(structure=scene.structure.with_strings(rest_length=lengths))
    run = tmj.simulate(scene, None, engine(5e-4), duration=6.0)
    forces, nodes = run.reports["contact"]["final_forces"], run.nodes[-1]
    pushes = {name: force[2] for name, force in forces.items()}
    assert len(pushes) == 3
    assert max(pushes.values()) > 1.5 * min(pushes.values())
    total = sum(pushes.values())
    assert total == pytest.approx(6 * 0.2 * G, rel=1e-5)
    places = [nodes[scene.structure.node_index[name]] * push for name, push in pushes.items()]
    middle = np.sum(places, axis=0) / total
    np.testing.assert_allclose(middle[:2], centre_of_mass(scene.structure, nodes)[:2], rtol=0, atol=1e-5)
