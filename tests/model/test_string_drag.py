"""Drag of water on strings: closed forms of what it slows and what it holds aside, in both engines."""

from __future__ import annotations

import re
from typing import Any

import numpy as np
import pytest

import tensegrity_mj as tmj
from tensegrity_mj.cli import main
from tensegrity_mj.commands.scenes import describe
from tensegrity_mj.errors import InfeasibleError, SceneError
from tensegrity_mj.library.fish_farm import fish_net
from tensegrity_mj.model.elements.water import water_forces

RHO, D, C = 1025.0, 0.02, 1.2
ENGINES = [tmj.DAE(rtol=1e-12, atol=1e-13), tmj.MuJoCo(1e-3)]
both = pytest.mark.parametrize("engine", ENGINES, ids=["DAE", "MuJoCo"])


def water(**more: Any) -> tmj.Water:
    return tmj.Water(density=RHO, drag=C, string_diameter=D, **more)


def drifting(paths: list[tuple[str, ...]], names: str, **more: Any) -> tmj.Scene:
    """Masses of 2 kg in a row along x, 1 m apart and 5 m deep, on strings that nothing stretches, at 3 m/s along y."""
    nodes = {name: (float(k), 0.0, -5.0) for k, name in enumerate(names)}
    strings = tuple(tmj.String(f"s{k}", path, 50.0, rest_length=len(path) - 1.0) for k, path in enumerate(paths))
    masses = tuple(tmj.PointMass(name, 2.0) for name in names)
    structure = tmj.Structure("row", nodes, (), strings, point_masses=masses)
    speeds = np.tile([0.0, 3.0, 0.0], (len(names), 1))
    return tmj.Scene(structure, initial_velocities=speeds, water=water(**more), duration=1.0)


@pytest.mark.third_means("water.immerse of strings", by="u₀/(1 + K u₀ t) against the water")
@both
@pytest.mark.parametrize("current", [0.0, 1.0])
def test_a_string_between_two_masses_slows_them(engine: Any, current: float) -> None:
    """M u̇ = -½ (½ ρ C d ℓ) u² of either, u against the water, so that u = u₀/(1 + K u₀ t), K = ½ (½ ρ C d ℓ)/M.

    RK4's error of (K u₀ h)⁴ is below 1e-8 by far, and so is the DAE's.
    """
    scene = drifting([("a", "b")], "ab", current=(0.0, current, 0.0))
    run = tmj.simulate(scene, None, engine)
    K, start = 0.5 * 0.5 * RHO * C * D / 2.0, 3.0 - current
    expected = current + start / (1 + K * start * run.time)
    assert expected[-1] < 0.5 * (3 + current)
    np.testing.assert_allclose(run.velocities[:, :, 1], np.outer(expected, [1, 1]), atol=1e-8)
    # What slows them is work of the water.
    lost = 2.0 * (run.velocities[:, 0, 1] ** 2 - 9.0)
    np.testing.assert_allclose(run.external_work, lost, atol=1e-6)


@both
def test_a_string_over_a_pulley_takes_drag_on_each_piece(engine: Any) -> None:
    """The mass in the middle has two halves of 1 m each, at first: its acceleration is twice that of the ends."""
    run = tmj.simulate(drifting([("a", "b", "c")], "abc"), None, engine, duration=0.002, output_interval=0.001)
    slowed = (run.velocities[1, :, 1] - 3.0) / 1e-3
    first = -0.5 * 0.5 * RHO * C * D * 9.0 / 2.0
    np.testing.assert_allclose(slowed, [first, 2 * first, first], rtol=2e-2)  # u falls by 1.4 % and 2 % within the step


@pytest.mark.third_means("water.immerse of strings", by="drag of the stretched length")
@both
def test_drag_grows_with_the_length_of_a_string(engine: Any) -> None:
    """A string of 1 m, held at 3 m in a current of 2 m/s, pulls its holders with the drag of 3 m.

    One of them is a mass of 1e6 kg, which nothing else moves along y.
    """
    nodes = {"a": (0.0, 0.0, -5.0), "b": (3.0, 0.0, -5.0)}
    string = tmj.String("s", ("a", "b"), 50.0, rest_length=1.0)
    structure = tmj.Structure("held", nodes, (), (string,), ("a",), (tmj.PointMass("b", 1e6),))
    scene = tmj.Scene(structure, water=water(current=(0.0, 2.0, 0.0)), duration=0.1)
    run = tmj.simulate(scene, None, engine)
    force = 0.5 * 0.5 * RHO * C * D * 3.0 * 4.0
    assert run.velocities[-1, 1, 1] * 1e6 / 0.1 == pytest.approx(force, rel=1e-5)  # u falls by 7e-6 of 2 m/s


def test_a_dry_string_takes_none_and_one_half_under_takes_half() -> None:
    nodes = {"a": (0.0, 0.0, -1.0), "b": (0.0, 0.0, 1.0)}
    for shift, part in ((0.0, 0.5), (5.0, 0.0), (-5.0, 1.0)):
        placed = {name: (x, y, z + shift) for name, (x, y, z) in nodes.items()}
        string, mass = tmj.String("s", ("a", "b"), 1.0), tmj.PointMass("b", 1.0)
        structure = tmj.Structure("s", placed, (), (string,), ("a",), (mass,))
        scene = tmj.Scene(structure, water=water(current=(2.0, 0.0, 0.0)))
        forces, _ = water_forces(scene, 0.0, scene.nodes0, scene.velocities0)
        whole = 0.5 * RHO * C * D * 2.0 * 4.0
        # The surface cuts a vertical string within 1e-6 of its radius: LEAST_COSINE.
        np.testing.assert_allclose(forces.sum(axis=0), [part * whole, 0.0, 0.0], atol=1e-6 * whole)


def test_what_does_not_fit_is_refused() -> None:
    structure = drifting([("a", "b")], "ab").structure
    with pytest.raises(SceneError, match="has no rod, and water loads rods, and strings by their string_diameter"):
        tmj.Scene(structure, water=tmj.Water())
    with pytest.raises(SceneError, match="strings that break would go on taking drag"):
        tmj.Scene(structure, water=water(), breaks=(tmj.model.Break("s0", 0.1),))


def test_water_without_rods_has_no_words_of_rods(capsys: pytest.CaptureFixture[str]) -> None:
    scene = drifting([("a", "b")], "ab").with_(gravity=(0.0, 0.0, -9.81))
    found = describe(scene)
    assert found["water"].endswith("drag 1.2 across, strings 0.02 m thick, 5 segments a string, chosen")
    assert "a callback for forces of water: the scene has water" in found["needs"]["reasons"]
    assert not any("the others refuse the scene" in reason for reason in found["needs"]["reasons"])
    with pytest.raises(InfeasibleError, match="nothing holds it") as caught:
        tmj.statics.analyse(scene, modes=1)
    assert "buoyancy" not in str(caught.value)
    net = fish_net(rows=1, columns=2)
    assert "frequencies leave the mass that water adds out" not in tmj.statics.analyse(net, modes=1).notes
    assert "added mass" not in " ".join(tmj.stable_step(scene, tmj.MuJoCo()).notes)
    assert main(["run", "fish_net", "--duration", "0.02"]) == 0
    said = capsys.readouterr().out
    assert re.search(r"^water +5 segments a string, chosen", said, re.MULTILINE)
    assert "rods" not in said
    assert "5 segments a rod or string" in describe(tmj.load_scene("moored_chain").with_(water=water()))["water"]
