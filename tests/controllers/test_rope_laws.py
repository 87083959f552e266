"""A law commands a string with mass as one string, and knows nothing of its mass."""

from __future__ import annotations

import itertools
import re
from dataclasses import replace

import numpy as np
import pytest
from rope_scenes import mast, weightless

import tensegrity_mj as tmj
from tensegrity_mj.controllers import Replay, from_scene
from tensegrity_mj.dynamics.native.law import Command
from tensegrity_mj.errors import OptionError
from tensegrity_mj.model import Actuation

RK4 = {
    "mujoco": lambda step: tmj.MuJoCo(timestep=step),
    "dae": lambda step: tmj.DAE(method=tmj.Method.RK4, timestep=step),
}


def bent() -> tmj.Scene:
    """The mast, its rope bent, which also has a string over a pulley before it."""
    scene = mast(segments=3)
    structure = scene.structure
    s0, s1, s2 = structure.given.strings
    scene = scene.with_(structure=replace(structure, strings=(replace(s0, nodes=("tip", "c", "b")), s1, s2)))
    start = np.array(scene.nodes0)
    start[5:] += [[0.0, 0.1, -0.2], [0.1, -0.1, 0.0], [0.0, 0.05, 0.1]]
    return scene.with_(initial_nodes=start)


@pytest.mark.third_means("law.spread", by="shares of L - u L/k by hand, of a bent rope beside a pulley")
@pytest.mark.parametrize("engine", RK4)
@pytest.mark.parametrize("command", Command)
def test_a_command_is_spread_by_shares(command: Command, engine: str) -> None:
    """L0 = L - T/k with T = u L and L of the whole, and its shares of 1/6, 1/3, 1/3 and 1/6; all at the start."""
    scene = bent()
    u, asked = np.array([20.0, 50.0, 30.0]), []

    def law(time, nodes, velocities):  # type: ignore[no-untyped-def]
        asked.append((nodes, velocities))
        return u if command is Command.FORCE_DENSITY else np.array([2.0, 0.75, 1.0])

    law.command = command  # type: ignore[attr-defined]
    run = tmj.simulate(scene, law, RK4[engine](1e-3), duration=0.002, output_interval=0.001)
    assert {(nodes.shape, velocities.shape) for nodes, velocities in asked} == {((5, 3), (5, 3))}
    at = {name: np.array(place) for name, place in zip(scene.structure.node_names, scene.nodes0, strict=True)}

    def long(*path: str) -> float:
        return sum(float(np.linalg.norm(at[b] - at[a])) for a, b in itertools.pairwise(path))

    lengths = [long("tip", "c", "b"), long("tip", "s1.1", "s1.2", "s1.3", "a"), long("tip", "c")]
    k = np.array([300.0, 400.0, 300.0])
    rest = np.array([2.0, 0.75, 1.0]) if command is Command.REST_LENGTH else lengths - u * lengths / k
    spread = [rest[0], *(rest[1] * np.array([1, 2, 2, 1]) / 6), rest[2]]
    np.testing.assert_allclose(run.rest_lengths[0], spread, rtol=1e-14)
    assert run.rest_length("s1")[0] == pytest.approx(rest[1], rel=1e-14)


@pytest.mark.parametrize(
    "mode", [Actuation.continuous(), Actuation.hold_rest_length(0.01), Actuation.hold_force_density(0.01)]
)
def test_engines_agree_under_a_law(mode: Actuation) -> None:
    """RK4 of order 4 in both: what they differ by is some of its error, and falls as it, to round-off of 1e-13 m."""
    scene = heavy("prism", 0.02)
    law = from_scene(scene)
    gaps = []
    for step in (1e-3, 5e-4):
        one, other = (
            tmj.simulate(scene, law, make(step), actuation=mode, duration=0.5, output_interval=0.01)
            for make in RK4.values()
        )
        gaps.append(tmj.compare(one, other).max_node_error)
        assert one.energy_residual < 1e-8
    print(gaps)
    assert gaps[1] < 1e-9


def heavy(name: str, part: float, segments: int = 2) -> tmj.Scene:
    """A scene whose strings have this part of the rods' mass."""
    scene = tmj.load_scene(name)
    structure = scene.structure
    mass = part * structure.rod_masses.sum() / len(structure.strings)
    strings = tuple(replace(string, mass=mass, segments=segments) for string in structure.strings)
    return scene.with_(structure=replace(structure, strings=strings))


def test_a_rope_without_mass_to_speak_of_is_a_string_under_a_law() -> None:
    """What 0.02 % of the rods' mass changes is 0.02 % of the way or so, some 2e-5 m, and a tenth of that a tenth."""
    light = tmj.load_scene("prism")
    exact = tmj.simulate(light, from_scene(light), tmj.DAE(), duration=1.0, output_interval=0.1)
    gaps = []
    for part in (2e-3, 2e-4):
        scene = heavy("prism", part, 1)
        run = tmj.simulate(scene, from_scene(scene), tmj.DAE(), duration=1.0, output_interval=0.1)
        gaps.append(float(np.abs(run.nodes[:, :6] - exact.nodes).max()))
        assert run.target_error().shape == run.time.shape
    assert gaps[0] < 1e-3
    assert 5 < gaps[0] / gaps[1] < 20


def test_laws_of_ones_own_are_made_for_the_structure_or_its_massless_one() -> None:
    scene = mast()
    runs = [
        tmj.simulate(scene, tmj.controllers.CompiledLaw(_hold, of, [30.0]), tmj.DAE(), duration=0.02)
        for of in (scene.structure, scene.structure.massless)
    ]
    np.testing.assert_array_equal(runs[0].nodes, runs[1].nodes)
    other = replace(scene.structure, strings=scene.structure.given.strings[:2])
    with pytest.raises(OptionError, match="other nodes or strings"):
        tmj.simulate(scene, tmj.controllers.CompiledLaw(_hold, other, [30.0]), tmj.DAE(), duration=0.02)
    with pytest.raises(tmj.errors.ControllerError, match=re.escape("it must return (3,), a value a string")):
        tmj.simulate(scene, lambda time, nodes, velocities: np.ones(7), tmj.DAE(), duration=0.02)


def _hold(time, nodes, velocities, string_nodes, parameters, command):  # type: ignore[no-untyped-def]
    command[:] = parameters[0]
    return True


@pytest.mark.parametrize("command", Command)
def test_a_run_is_replayed(command: Command) -> None:
    """From sample to sample a cubic spline through smooth values: its error is the least that is seen."""
    scene = heavy("prism", 0.05)
    engine = tmj.DAE(rtol=1e-11, atol=1e-13)
    run = tmj.simulate(scene, from_scene(scene), engine, duration=0.3, output_interval=0.01)
    replay = Replay.of_run(run, command)
    assert replay.values.shape[1] == 12
    again = tmj.simulate(scene, replay, engine, duration=0.3, output_interval=0.01)
    assert tmj.compare(again, run).max_node_error < 1e-7


@pytest.mark.slow
@pytest.mark.parametrize(("part", "damped", "gap", "V"), [(0.01, 0.1, 1.94e-3, 0.00723), (0.1, 0.1, 11.7e-3, 0.0127)])
def test_what_massless_strings_leave_out(part: float, damped: float, gap: float, V: float) -> None:
    """The table of docs/ropes.md: its digits, to 5 %, what the last of them leaves open."""
    run, light = (prism(part, damped, mass) for mass in (True, False))
    assert np.linalg.norm(run.nodes[:, :6] - light.nodes, axis=-1).max() == pytest.approx(gap, rel=0.05)
    assert run.lyapunov[-1] / run.lyapunov[0] == pytest.approx(V, rel=0.05)


@pytest.mark.slow
def test_a_law_drives_waves_along_strings_that_nothing_damps() -> None:
    """V falls to 1 % or so and then grows; of the massless strings it is e^(-5), 0.0067."""
    V = prism(0.01, 0.0, True).lyapunov
    assert V[-1] > 3 * V.min()


def prism(part: float, damped: float, mass: bool) -> tmj.Trajectory:
    """Its strings have this part of the rods' mass in 4 segments, and c = 2 ζ/π √(k m): that of their lowest wave."""
    scene = heavy("prism", part, 4)
    damping = [2 * damped / np.pi * np.sqrt(one.stiffness * one.mass) for one in scene.structure.given.strings]
    scene = scene.with_(structure=scene.structure.with_strings(damping=damping))
    scene = scene if mass else weightless(scene)
    return tmj.simulate(scene, from_scene(scene), tmj.MuJoCo(timestep=1e-3), duration=5.0, output_interval=0.1)
