"""A law of the user's, in Python and compiled: the same answers, the same runs."""

from __future__ import annotations

from time import sleep
from typing import Any

import mujoco
import numba
import numpy as np
import pytest

import tensegrity_mj as tmj


def damp(time, nodes, velocities, string_nodes, parameters, command):  # type: ignore[no-untyped-def]
    for m in range(len(string_nodes)):
        i, j = string_nodes[m, 0], string_nodes[m, 1]
        square, dot = 0.0, 0.0
        for x in range(3):
            s = nodes[j, x] - nodes[i, x]
            square += s * s
            dot += s * (velocities[j, x] - velocities[i, x])
        command[m] = parameters[0] * (1.0 + np.sin(time)) + parameters[1] * dot / np.sqrt(square)
    return time < parameters[2]


PARAMETERS = (0.05, 0.5, 0.35)


@pytest.fixture(scope="module")
def law(prism: tmj.Scene) -> tmj.controllers.CompiledLaw:
    return tmj.controllers.CompiledLaw(damp, prism.structure, PARAMETERS)


def in_python(structure: tmj.Structure) -> Any:
    def plain(time: float, nodes: Any, velocities: Any) -> Any:
        return 0.05 * (1.0 + np.sin(time)) + 0.5 * structure.string_rates(nodes, velocities)

    return plain


def test_it_answers_as_the_same_law_in_python(prism, law) -> None:
    rng = np.random.default_rng(4)
    plain = in_python(prism.structure)
    for _ in range(5):
        nodes, velocities = prism.nodes0 + 0.1 * rng.normal(size=(6, 3)), rng.normal(size=(6, 3))
        # A dozen operations on numbers of order 1.
        assert law(0.2, nodes, velocities) == pytest.approx(plain(0.2, nodes, velocities), rel=0, abs=1e-14)
    with pytest.raises(tmj.errors.InfeasibleError, match=r"0\.35"):
        law(0.35, prism.nodes0, prism.velocities0)


@pytest.mark.parametrize("engine", [tmj.MuJoCo(), tmj.DAE(rtol=1e-9), tmj.ODE(rtol=1e-9)], ids=["mujoco", "dae", "ode"])
def test_every_engine_runs_it_as_the_python_law(prism, law, engine) -> None:
    run = tmj.simulate(prism, law, engine, duration=0.3)
    slow = tmj.simulate(prism, in_python(prism.structure), engine, duration=0.3)
    # The same steps, numbers that differ by round-off: 300 steps of 1e-16, and what the motion makes of it.
    assert np.abs(run.nodes - slow.nodes).max() < 1e-12
    assert np.ptp(run.force_densities, axis=0).min() > 1e-3  # it did something
    assert "law_time" not in run.cost
    assert run.provenance["controller"] == {"law": "damp", "compiled": True, "parameters": list(PARAMETERS)}


@pytest.mark.parametrize(
    "engine",
    [tmj.MuJoCo(), tmj.DAE(rtol=1e-6), tmj.ODE(method=tmj.Method.RK4, timestep=1e-3)],
    ids=["mujoco", "dae", "ode"],
)
def test_the_time_of_a_law_is_a_part_of_the_time_of_its_run(prism, engine) -> None:
    """However slow the machine is: what is called before the run's clock starts, here long, does not count."""
    calls = []

    def law(time: float, nodes: Any, velocities: Any) -> Any:
        if not calls:
            sleep(1.0)
        calls.append(time)
        return np.full(12, 0.1)

    run = tmj.simulate(prism, law, engine, duration=0.02)
    assert 0 < run.cost["law_calls"] <= len(calls)
    assert 0 < run.cost["law_time"] < run.cost["wall_time"]


def test_a_command_left_unwritten_is_no_answer(prism) -> None:
    def idle(time, nodes, velocities, string_nodes, parameters, command):  # type: ignore[no-untyped-def]
        return True

    with pytest.raises(tmj.errors.ControllerError, match="nan"):
        tmj.simulate(prism, tmj.controllers.CompiledLaw(idle, prism.structure), tmj.MuJoCo(), duration=0.1)


def test_a_report_that_is_none_is_an_error(prism) -> None:
    class Wrong:
        report = "good"

        def __call__(self, time: float, nodes: Any, velocities: Any) -> Any:
            return np.full(12, 0.1)

    with pytest.raises(tmj.errors.ControllerError, match="good"):
        tmj.simulate(prism, Wrong(), tmj.MuJoCo(), duration=0.1)


def test_false_is_no_solution(prism, law) -> None:
    run = tmj.simulate(prism, law, tmj.MuJoCo(), duration=0.5)
    assert run.status is tmj.Status.INFEASIBLE
    assert run.time[-1] == pytest.approx(0.35)


def test_it_runs_on_threads(prism, law) -> None:
    alone = tmj.simulate(prism, law, tmj.MuJoCo(), duration=0.2)
    for run in tmj.simulate_many([prism] * 3, law, tmj.MuJoCo(), duration=0.2, threads=2):
        assert np.array_equal(run.nodes, alone.nodes)
    with tmj.law_in(prism, law) as model:
        data = mujoco.MjData(model)
        mujoco.mj_step(model, data, 10)
    assert data.ctrl.any()


def test_rest_lengths_and_a_function_that_numba_compiled_already(prism) -> None:
    @numba.njit
    def hold(time, nodes, velocities, string_nodes, parameters, command):  # type: ignore[no-untyped-def]
        for m in range(len(command)):
            command[m] = parameters[m]
        return True

    lengths = 0.98 * prism.structure.rest_lengths
    law = tmj.controllers.CompiledLaw(hold, prism.structure, lengths, tmj.Command.REST_LENGTH)
    run = tmj.simulate(prism, law, tmj.MuJoCo(), duration=0.05)
    assert np.array_equal(run.rest_lengths, np.tile(lengths, (len(run.time), 1)))


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"function": 3}, ("function = 3",)),
        ({"function": lambda a: a}, ("numba cannot compile", "string_nodes")),
        ({"structure": "prism"}, ("scene.structure",)),
        ({"parameters": [np.nan]}, ("parameters", "finite")),
        ({"parameters": "abc"}, ("parameters", "finite")),
        ({"command": "u"}, ("command",)),
    ],
)
def test_bad_options_are_refused(prism, options, words) -> None:
    with pytest.raises(tmj.errors.OptionError) as caught:
        tmj.controllers.CompiledLaw(
            **({"function": damp, "structure": prism.structure, "parameters": PARAMETERS} | options)
        )
    assert all(word in str(caught.value) for word in words), str(caught.value)


def test_another_structure_is_refused(law) -> None:
    with pytest.raises(tmj.errors.OptionError, match="other nodes or strings"):
        tmj.simulate(tmj.load_scene("pinned_rod"), law, tmj.MuJoCo(), duration=0.1)
