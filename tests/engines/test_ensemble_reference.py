"""Many simulations at once in the DAE and the ODE: each has the bits of a single run, whatever ends the others."""

from __future__ import annotations

import signal
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import pytest
from ending_laws import explosive, unsolvable, wrong
from maxwell import Maxwell
from thrown_mass import hung

import tensegrity_mj as tmj
from tensegrity_mj.controllers import Delayed, Lyapunov
from tensegrity_mj.engines.reference.method import Method
from tensegrity_mj.errors import ControllerError, DivergenceError
from tensegrity_mj.model import Break, Load, Motion

H = 1e-3
RK4 = {"method": Method.RK4, "timestep": H}
ENGINES: dict[str, Any] = {
    "DAE": tmj.DAE(**RK4),
    "DAE located": tmj.DAE(**RK4, locate_slack=True),
    "DAE DOP853": tmj.DAE(rtol=1e-6, atol=1e-8),
    "DAE Radau": tmj.DAE(Method.RADAU, rtol=1e-3, atol=1e-5),
    "ODE": tmj.ODE(**RK4),
    "ODE DOP853": tmj.ODE(rtol=1e-6, atol=1e-8),
}
FIXED, CONTROLLED = ENGINES["DAE"], ENGINES["DAE DOP853"]
EVERYTHING = (
    *("time", "nodes", "velocities", "rest_lengths", "tensions", "multipliers", "winch_work", "external_work"),
    *("dissipation", "lyapunov", "element_states"),
)


def check_each_alone(scenes: list[tmj.Scene], laws: Any, engine: Any, threads: int = 2, **options: Any) -> Any:
    """Runs among many are the single runs, to the last bit."""
    runs = tmj.simulate_many(scenes, laws, engine, threads=threads, **options)
    given = laws if isinstance(laws, list) else [laws] * len(scenes)
    costs = []
    for number, (run, scene, law) in enumerate(zip(runs, scenes, given, strict=True)):
        alone = tmj.simulate(scene, law, engine, **options)
        assert run.status is alone.status
        for name in EVERYTHING:
            assert np.array_equal(getattr(run, name), getattr(alone, name), equal_nan=True), (number, name)
        assert np.array_equal(
            runs.nodes[number, np.isin(runs.time, alone.time)], alone.nodes[np.isin(alone.time, runs.time)]
        )
        costs.append(alone.cost)
        assert {key: value for key, value in run.cost.items() if "time" not in key} == {
            key: value for key, value in alone.cost.items() if "time" not in key
        }
    for what in ("steps", "evaluations"):
        assert runs.cost[what] == sum(cost[what] for cost in costs)
    return runs


@pytest.fixture(scope="module")
def starts(prism: tmj.Scene, law: Any) -> list[tmj.Scene]:
    """The prism from states along its way, moving."""
    run = tmj.simulate(prism, law, FIXED, duration=0.5)
    return [prism.with_(initial_nodes=run.nodes[k], initial_velocities=run.velocities[k]) for k in (0, 20, 35, 49)]


@pytest.mark.parametrize("engine", ENGINES.values(), ids=ENGINES)
def test_a_run_among_many_is_the_single_run_to_the_last_bit(starts, law, engine) -> None:
    moved = tmj.Target.path([0.0, 3.0], [starts[3].nodes0, starts[0].target.nodes[0]])  # type: ignore[union-attr]
    laws = [law, None, Lyapunov(starts[0].structure, moved), law]
    for threads in (1, 2):
        check_each_alone(starts, laws, engine, threads, duration=0.05)


@pytest.mark.parametrize("engine", [FIXED, CONTROLLED, ENGINES["ODE"]], ids=str)
@pytest.mark.parametrize("hold", [tmj.Actuation.hold_force_density, tmj.Actuation.hold_rest_length])
def test_samples_of_each_run_are_its_own(prism, starts, law, engine, hold) -> None:
    """Also of laws that keep something from call to call."""
    check_each_alone(starts, Delayed(law, 2, 0.01), engine, duration=0.1, actuation=hold(0.01))
    cross = tmj.load_scene("cross")  # its law starts each search from its last answer
    check_each_alone([cross] * 2, tmj.controllers.from_scene(cross), engine, duration=0.05, actuation=hold(0.01))


@pytest.mark.parametrize("engine", [FIXED, ENGINES["DAE located"], CONTROLLED, ENGINES["ODE"]], ids=str)
def test_all_that_a_scene_may_have_is_in_its_run_alone(engine) -> None:
    """Strings that yield, break, and push by their dampers; loads, moved supports, states of elements, later starts."""
    pushed = partial(hung, string_law="unclipped")
    scenes = [
        pushed(),
        pushed(yields=False),
        pushed(breaks=(Break("s", 0.02), Break("y", 0.08))),
        pushed(loads=lambda t: np.array([[0, 0, 0], [0, 0, 0], [np.cos(9 * t), 0, 0]])),
        pushed(loads=(Load("p", (3.0, 0.0, 1.0), 40.0),)),
        pushed(motions=(Motion.in_line("left", amplitude=0.05, direction=(1, 0, 0), frequency=3.0),)),
        pushed(start_time=0.05),
        pushed(elements=(Maxwell("p", 50.0, 5.0),)),
    ]
    for threads in (1, 2):
        # The output times of all are those of the first run.
        check_each_alone(scenes[:6] + scenes[7:], None, engine, threads, duration=0.1)
        check_each_alone([scenes[6]] * 2, None, engine, threads, duration=0.1)


@pytest.mark.parametrize("engine", [FIXED, CONTROLLED], ids=str)
def test_a_law_in_python_is_called_for_each(prism, engine) -> None:
    def held(time: float, nodes: Any, velocities: Any) -> Any:
        return np.full(12, 0.1 + 0.05 * np.sin(9 * time) + 0.01 * velocities[0, 2])

    scenes = [prism, prism.with_(breaks=(Break(prism.structure.strings[3].name, 0.02),)), prism]
    check_each_alone(scenes, held, engine, duration=0.05)


def test_other_models_of_the_dae_have_scratch_of_their_own() -> None:
    """Rods that share nodes, closed loops among them, and structures as one system."""
    for name, solver in (("spine", "joints"), ("ladder", "joints"), ("ladder", "general"), ("dbar", "full")):
        scene = tmj.load_scene(name)
        heavy = scene.with_(gravity=(0.0, 1.0, -9.0))
        check_each_alone([scene, heavy, scene], None, tmj.DAE(**RK4, solver=solver), duration=0.02)


@pytest.mark.parametrize("engine", [FIXED, CONTROLLED], ids=str)
def test_one_that_ends_early_stops_no_other(prism, law, engine) -> None:
    def failing(time: float, nodes: Any, velocities: Any) -> Any:
        raise ValueError("oh")

    laws = [law, explosive, wrong, unsolvable, failing, law]
    engine = replace(engine, max_steps=300)
    runs = tmj.simulate_many([prism] * 6, laws, engine, duration=0.2, threads=2)
    done = tmj.Status.COMPLETED
    assert runs.status == (done, tmj.Status.DIVERGED, None, tmj.Status.INFEASIBLE, None, done)
    alone = tmj.simulate(prism, law, engine, duration=0.2)
    for number in (0, 5):
        assert np.array_equal(runs.nodes[number], alone.nodes)
        assert runs.message(number) == ""
    for number, error in ((1, DivergenceError), (2, ControllerError), (4, ControllerError)):
        with pytest.raises(error) as single:
            tmj.simulate(prism, laws[number], engine, duration=0.2)
        with pytest.raises(error) as among:
            _ = runs[number]
        assert str(among.value) == str(single.value) == runs.message(number)
        assert np.isnan(runs.nodes[number, -1]).all()
    stopped = tmj.simulate(prism, unsolvable, engine, duration=0.2)
    assert runs.message(3) == stopped.message
    assert np.array_equal(runs[3].nodes, stopped.nodes)
    assert np.array_equal(np.isnan(runs.nodes[3]).any(axis=(1, 2)), runs.time > stopped.time[-1])


def test_a_law_without_a_solution_stops_or_holds_its_run_alone() -> None:
    """A rod in the plane of its strings' anchors cannot be lifted out of it (§5.4): a law that calls no Python."""
    scene = tmj.load_scene("pinned_rod")
    flat, up = np.array(scene.nodes0), np.array(scene.target.nodes[0])  # type: ignore[union-attr]
    flat[1], up[1] = (0.0, -1.0, 0.0), (0.0, 0.0, 1.0)
    law, lifting = tmj.controllers.from_scene(scene), Lyapunov(scene.structure, up, decay_rate=0.15)
    scenes, laws = [scene, scene.with_(initial_nodes=flat), scene], [law, lifting, law]
    for choice, status in ((tmj.OnInfeasible.STOP, "infeasible"), (tmj.OnInfeasible.PASSIVE, "completed")):
        runs = check_each_alone(scenes, laws, FIXED, duration=0.05, on_infeasible=choice)
        assert [one.value for one in runs.status] == ["completed", status, "completed"]


def test_a_pole_ends_its_run_alone() -> None:
    """The first rod swings up to the z axis, where the angles of the ODE end."""
    rod = tmj.Rod("r", ("o", "p"), 1.0, support=tmj.Support.pinned(0.0))
    structure = tmj.Structure("pendulum", {"o": (0.0, 0.0, 0.0), "p": (0.6, 0.0, 0.8)}, (rod,), (), fixed_nodes=())
    rising = np.array([[0.0, 0.0, 0.0], [-8.0, 0.0, 6.0]])
    scenes = [tmj.Scene(structure, initial_velocities=v, duration=0.2) for v in (rising, -rising, 0.1 * rising)]
    for engine in (ENGINES["ODE"], ENGINES["ODE DOP853"]):
        runs = tmj.simulate_many(scenes, None, engine, threads=2)
        singular, done = tmj.Status.SINGULAR, tmj.Status.COMPLETED
        assert runs.status == (singular, done, done)
        check_each_alone(scenes, None, engine)


def test_an_interrupt_ends_all(prism, law) -> None:
    def interrupting(time: float, nodes: Any, velocities: Any) -> Any:
        if time > 0.01:
            signal.raise_signal(signal.SIGINT)
        return np.full(12, 0.1)

    for engine in (FIXED, CONTROLLED):
        with pytest.raises(KeyboardInterrupt):
            tmj.simulate_many([prism] * 4, [law, interrupting, law, law], engine, duration=0.05, threads=2)
        assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
        check_each_alone([prism] * 2, law, engine, duration=0.02)


def test_too_many_rows_of_all_are_refused(prism) -> None:
    with pytest.raises(tmj.errors.OptionError, match="GiB are recorded"):
        tmj.simulate_many([prism] * 2000, None, FIXED, duration=5.0, output_interval=H)


def test_a_law_in_mujocos_loops_is_not_for_them(prism, law) -> None:
    with (
        pytest.raises(tmj.errors.OptionError, match=r"law_in closes the loop inside MuJoCo: use MuJoCo\(\.\.\.\)"),
        tmj.law_in(prism, law, FIXED),
    ):
        pass
