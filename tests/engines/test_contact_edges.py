"""Contact at its edges, in both engines: points, what supports hold, too many at a time, floors too hard for a step."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from contact_law import impedance

import tensegrity_mj as tmj
from tensegrity_mj.engines.reference.floor import CROWD
from tensegrity_mj.errors import DivergenceError, StructureError
from tensegrity_mj.model import Contact

G = 9.81
STEP = 1e-4


def test_point_masses_touch_with_their_points_as_in_mujoco() -> None:
    """On a tilted floor, one of them in a plane: by the same steps of the same coordinates, so to round-off, which
    contacts enlarge. At rest it is as deep as (1 - d) d₁² g = stiffness d² r has it."""
    nodes = {"p": (0, 0, 0.05), "q": (0.1, 0.1, 0.2), "lone": (1.0, 0, 1e-4)}
    masses = (tmj.PointMass("p", 1.0), tmj.PointMass("q", 2.0, plane=(0, 1, 0)), tmj.PointMass("lone", 0.3))
    string = tmj.String("s", ("p", "q"), stiffness=100.0, rest_length=0.1)
    structure = tmj.Structure("points", nodes, (), (string,), point_masses=masses)
    for normal in ((0, 0, 1), (0.1, 0.2, 1)):
        contact = Contact(floor=0.0, normal=normal)
        scene = tmj.Scene(structure, gravity=(0, 0, -G), contact=contact)
        engines = (tmj.DAE(method="rk4", timestep=STEP), tmj.MuJoCo(STEP))
        ours, theirs = (tmj.simulate(scene, None, engine, duration=0.3) for engine in engines)
        assert max(ours.reports["contact"]["touching"]) >= 2
        np.testing.assert_allclose(ours.nodes, theirs.nodes, rtol=0, atol=1e-12)
        if normal == (0, 0, 1):
            depth = -theirs.nodes[-1, 2, 2]
            d, d1 = impedance(contact, depth), contact.spring.impedance[1]
            assert (1 - d) * d1**2 * G == pytest.approx(contact.stiffness * d**2 * depth, rel=1e-6)


def held_scene(kind: str) -> tmj.Scene:
    """What supports hold at or below a floor, of the normal (0.6, 0, 0.8)."""
    up, along = np.array([0.6, 0, 0.8]), np.array([0.8, 0, -0.6])
    supports = {"pin": tmj.Support.pinned(0.0), "height": tmj.Support(0.0, (up,)), "plane": tmj.Support.free(0.5, up)}
    nodes, contact = {"a": -0.02 * up, "b": -0.02 * up + along}, Contact(floor=0.0, normal=up)
    if kind == "point":
        structure = tmj.Structure(kind, {"a": -0.02 * up, "b": along}, (), point_masses=(
            tmj.PointMass("a", 1.0, plane=tuple(up)), tmj.PointMass("b", 1.0)))  # fmt: skip
        return tmj.Scene(structure, gravity=tuple(-G * up), contact=contact, initial_velocities=[along, along])
    if kind != "plane":
        nodes["b"] = -0.02 * up + np.sqrt(0.5) * (along + up)
    rod = tmj.Rod("rod", ("a", "b"), 1.0, 0.01, supports[kind])
    velocities = None if kind == "pin" else [0.3 * along, 0.3 * along]
    structure = tmj.Structure(kind, {name: tuple(place) for name, place in nodes.items()}, (rod,))
    return tmj.Scene(structure, gravity=tuple(-G * up), contact=contact, initial_velocities=velocities)


@pytest.mark.parametrize("kind", ["pin", "height", "plane", "point"])
def test_what_supports_hold_touches_no_floor(kind: str) -> None:
    """A contact that cannot move it would press with 1e15 N in MuJoCo, and its friction hold it for good."""
    scene = held_scene(kind)
    engines = (tmj.DAE(method="rk4", timestep=STEP), tmj.MuJoCo(STEP))
    ours, theirs = (tmj.simulate(scene, None, engine, duration=0.5) for engine in engines)
    np.testing.assert_allclose(ours.nodes, theirs.nodes, rtol=0, atol=1e-9)
    touching = ours.reports["contact"]["touching"]
    assert touching == theirs.reports["contact"]["touching"]
    assert max(touching) == (0 if kind == "plane" else 1)
    assert theirs.reports["contact"]["largest_normal_force"] < 1e4
    if kind in ("plane", "point"):  # it goes on as it was
        v = scene.velocities0[0]
        np.testing.assert_allclose(theirs.nodes[-1, 0], scene.nodes0[0] + 0.5 * v, rtol=0, atol=1e-12)


@pytest.mark.parametrize(
    ("engine", "words"),
    [
        (tmj.DAE(), r"use Method.RADAU for stiff strings, make contacts softer \(stiffness = 1e\+12 /s²\), loosen"),
        (tmj.DAE(method="radau"), r"resolves; make contacts softer \(stiffness = 1e\+12 /s²\), loosen the tol"),
        (tmj.DAE(method="rk4", timestep=STEP), r"0.0001 s\), make contacts softer \(stiffness = 1e\+12 /s²\), or use"),
        (tmj.MuJoCo(STEP), r"0.0001 s\), make contacts softer \(stiffness = 1e\+12 /s²\), or trade"),
    ],
    ids=str,
)
@pytest.mark.filterwarnings("ignore::tensegrity_mj.errors.StabilityWarning")
def test_a_run_that_ends_on_a_floor_too_hard_for_it_says_so(engine: Any, words: str) -> None:
    """Nor is a method told to use itself."""
    hard = tmj.load_scene("prism_drop").with_(contact=Contact(floor=0.0, stiffness=1e12))
    with pytest.raises(DivergenceError, match=words):
        tmj.simulate(hard, None, engine, duration=0.4)


@pytest.mark.filterwarnings("ignore::tensegrity_mj.errors.StabilityWarning")
def test_more_contacts_than_are_solved_together_are_named() -> None:
    """Logs side by side on the floor, two contacts each."""
    count = CROWD // 2 + 5
    nodes = {f"{end}{k}": (x, 0.021 * k, 0.0099) for k in range(count) for end, x in (("a", 0.0), ("b", 1.0))}
    rods = [tmj.Rod(f"r{k}", (f"a{k}", f"b{k}"), 1.0, 0.01) for k in range(count)]
    scene = tmj.Scene(tmj.Structure("logs", nodes, rods), gravity=(0, 0, -G), contact=Contact(floor=0.0, rods=True))
    run = tmj.simulate(scene, None, tmj.DAE(method="rk4", timestep=1e-3), duration=1e-3)
    (words,) = run.reports["warnings"]
    assert "states more than 400 contacts touched, and those beyond 400 were left out: use MuJoCo" in words


def test_a_rod_as_thick_as_long_is_refused_for_its_thickness() -> None:
    """MuJoCo's bodies turn about no axis with more than both other moments of inertia; the DAE's rods do."""
    rod = tmj.Rod("log", ("a", "b"), 1.0, 5.0)
    contact = Contact(floor=0.0, spin="free")
    scene = tmj.Scene(tmj.Structure("log", {"a": (0, 0, 5.1), "b": (0, 1, 5.1)}, (rod,)), contact=contact)
    with pytest.raises(StructureError, match="a rod is thicker for its length than MuJoCo lets turn about its axis"):
        tmj.simulate(scene, None, tmj.MuJoCo(STEP), duration=0.01)
    tmj.simulate(scene, None, tmj.DAE(), duration=0.01)


@pytest.mark.filterwarnings("ignore::tensegrity_mj.errors.StabilityWarning")
def test_a_rod_that_comes_through_the_end_of_another_is_pushed_out() -> None:
    """At 30 m/s along its axis, that of the other rod: both are 0 apart, and have no normal of theirs."""
    nodes = {"a": (0, 0, 0), "b": (1, 0, 0), "c": (1.03, 0, 0), "d": (2.03, 0, 0)}
    rods = (tmj.Rod("one", ("a", "b"), 1.0, 0.01), tmj.Rod("other", ("c", "d"), 1.0, 0.01))
    velocities = [(30.0, 0, 0)] * 2 + [(0, 0, 0)] * 2
    scene = tmj.Scene(tmj.Structure("rods", nodes, rods), contact=Contact(rods=True), initial_velocities=velocities)
    run = tmj.simulate(scene, None, tmj.DAE(method="rk4", timestep=STEP), duration=0.02)
    assert np.isfinite(run.nodes).all()
    momentum = 0.25 * 2 * run.velocities[-1].sum(axis=0)  # of thin rods half of each is that of each end
    np.testing.assert_allclose(momentum, (30.0, 0, 0), rtol=0, atol=1e-9)
