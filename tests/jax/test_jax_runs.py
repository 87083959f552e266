"""Runs of the differentiable engine against the DAE's: motion, ledger of energy, breaks, order, many at once."""

from __future__ import annotations

import signal
import sys
from contextlib import nullcontext
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from features import FEATURES
from linked_scenes import hung

import tensegrity_mj as tmj
from tensegrity_mj.dynamics.native.law import Command
from tensegrity_mj.engines.request import request_for
from tensegrity_mj.errors import ControllerError, DerivativeWarning, DivergenceError, OptionError

jax = pytest.importorskip("jax")
pytest.importorskip("diffrax")

DURATION, INTERVAL = 0.4, 0.02  # s
REFERENCE = tmj.DAE(rtol=1e-12, atol=1e-13)
FINE = tmj.JAX(rtol=1e-12, atol=1e-13)
# Both engines' own tolerances, of motions of 1 m and energies of 10 J: some ten times rtol each.
FLOOR, ENERGY_FLOOR = 4e-11, 4e-10
RUN: dict[str, Any] = {"duration": DURATION, "output_interval": INTERVAL}
REFUSED = ("contact", "strings that yield", "states of elements")
# What answers accelerations, where supports prescribe some of them.
WET = "masses on rods, water, moved supports"
SCENES = {name: feature.scene for name, feature in FEATURES.items() if name not in REFUSED}
SCENES[WET] = lambda: SCENES["masses on rods, moved supports"]().with_(water=SCENES["masses on rods, water"]().water)
# Each is compiled for seconds. Right-hand sides of all are compared elsewhere, breaks and paths below: these have all
# kinds of ledgers.
SOME = ("bodies", WET, "elastic rods, resistance", "constraints, moved")
ALL = [pytest.param(name, marks=() if name in SOME else pytest.mark.study) for name in SCENES]


@pytest.mark.parametrize("name", ALL)
def test_motion_and_ledger_are_those_of_the_dae(name: str) -> None:
    scene = SCENES[name]()
    # There a kink lies within one of the DAE's long steps, which no tolerance sees: 1e-11 to 8e-11 m, by the processor.
    # Short ones leave less: at half the step its places move by 2e-13 m.
    reference = tmj.DAE(method="rk4", timestep=1e-4) if name == WET else REFERENCE
    found, expected = tmj.simulate(scene, None, FINE, **RUN), tmj.simulate(scene, None, reference, **RUN)
    print(f"{name}: {tmj.compare(found, expected).max_node_error} m, {found.energy_residual} J")
    assert tmj.compare(found, expected).max_node_error < FLOOR
    assert found.energy_residual < ENERGY_FLOOR
    for term in ("external_work", "dissipation", "winch_work", "string_energy", "kinetic_energy"):
        np.testing.assert_allclose(getattr(found, term), getattr(expected, term), atol=ENERGY_FLOOR)
    scale = float(np.abs(expected.rod_forces).max(initial=1.0))
    np.testing.assert_allclose(found.rod_forces, expected.rod_forces, atol=1e-7 * scale)
    np.testing.assert_allclose(found.constraint_forces, expected.constraint_forces, atol=1e-7 * scale)
    np.testing.assert_allclose(found.tensions, expected.tensions, atol=1e-7 * scale)


@pytest.mark.parametrize(
    ("name", "duration"),
    [("prism", 1.0), *(pytest.param(*one, marks=pytest.mark.study) for one in (("tower", 0.5), ("cable", 1.0)))],
)
def test_trajectories_of_shipped_scenes_are_those_of_the_dae(name: str, duration: float) -> None:
    """Both engines' errors are some ten times rtol = 1e-12 of a metre or so: within 1e-11 m of each other."""
    scene = tmj.load_scene(name)
    law = tmj.controllers.from_scene(scene) if scene.control else None
    run: dict[str, Any] = {"duration": duration, "output_interval": duration / 20}
    found, expected = (tmj.simulate(scene, law, engine, **run) for engine in (FINE, REFERENCE))
    error = tmj.compare(found, expected).max_node_error
    print(f"{name}: {error:.1e} m")
    assert error < 1e-11
    assert np.abs(expected.nodes - expected.nodes[0]).max() > 1e-3  # in motion


def test_fixed_steps_have_the_fourth_order() -> None:
    """Where supports move and across a string's break: the error is the sum of both."""
    scene = FEATURES["moved supports"].scene().with_(breaks=FEATURES["breaks"].scene().breaks)
    reference = tmj.simulate(scene, None, REFERENCE, **RUN)
    coarse, fine = (
        tmj.compare(tmj.simulate(scene, None, tmj.JAX(method="rk4", timestep=h), **RUN), reference).max_node_error
        for h in (2e-3, 1e-3)
    )
    # As in test_features.py: the next term of the error is within half an order.
    assert fine <= max(coarse / 2**3.5, FLOOR)
    assert coarse < 1e-2


def test_many_at_once_are_what_one_is() -> None:
    """The same operations on longer arrays, but for the order of sums: round-off, grown by 400 steps."""
    scene = hung()
    factors = (1.0, 0.9, 1.1)
    scenes = [
        scene.with_(structure=scene.structure.with_strings(rest_length=f * scene.structure.rest_lengths, damping=f))
        for f in factors
    ]
    engine = tmj.JAX(method="rk4", timestep=1e-3)
    together = tmj.simulate_many(scenes, None, engine, **RUN)
    for one, run in zip(scenes, together, strict=True):
        alone = tmj.simulate(one, None, engine, **RUN)
        np.testing.assert_allclose(run.nodes, alone.nodes, atol=1e-12)
        np.testing.assert_allclose(run.dissipation, alone.dissipation, atol=1e-11)
        assert run.energy_residual == pytest.approx(alone.energy_residual, abs=1e-11)
    assert np.abs(together.nodes[0] - together.nodes[1]).max() > 1e-3


def test_many_are_one_block_where_the_device_is_no_cpu(monkeypatch: pytest.MonkeyPatch) -> None:
    """Threads are for the cores of a CPU."""
    engine, blocks = tmj.JAX(method="rk4", timestep=1e-3), []
    requests = [request_for(hanging(), None, 0.1, None, tmj.OnInfeasible.STOP, None, False)] * 4
    for device in ("cpu", "gpu"):
        monkeypatch.setattr(jax, "default_backend", lambda device=device: device)
        blocks.append(engine.ensemble(requests, 2).blocks)
    assert blocks == [2, 1]


def test_many_differ_in_starts_and_strings_alone() -> None:
    scene, engine = hung(), tmj.JAX(method="rk4", timestep=1e-3)
    with pytest.raises(OptionError, match="gravity differ"):
        tmj.simulate_many([scene, scene.with_(gravity=(0, 0, -1))], None, engine, **RUN)
    with pytest.raises(OptionError, match=r"Method\.RK4"):
        tmj.simulate_many([scene], None, tmj.JAX(), **RUN)


def test_a_run_beyond_its_stable_step_diverges_with_the_time_and_what_was_recorded() -> None:
    structure = hung().structure.with_strings(stiffness=1e9, rest_length=0.1)
    with (
        pytest.warns(tmj.errors.StabilityWarning),
        pytest.raises(DivergenceError, match=r"reduce the time step \(h = 0.01 s\)") as error,
    ):
        tmj.simulate(hung().with_(structure=structure), None, tmj.JAX(method="rk4", timestep=1e-2), duration=0.5)
    assert isinstance(error.value.trajectory, tmj.Trajectory)


def test_strings_that_break_at_the_start_within_at_the_end_and_never(recwarn: pytest.WarningsRecorder) -> None:
    """The last one's time is nearer to the last step's than half a step."""
    scene = hung()
    names = [string.name for string in scene.structure.strings]
    breaks = tuple(tmj.model.Break(*at) for at in zip(names, (0.0, 0.02, 0.033, 0.06, 0.0603), strict=False))
    scene, run = scene.with_(breaks=breaks), {"duration": 0.06, "output_interval": 0.02}
    expected = tmj.simulate(scene, None, REFERENCE, **run)
    # Of fixed steps: their error over this run, of which test_fixed_steps_have_the_fourth_order shows the order.
    for engine, floor in ((FINE, ENERGY_FLOOR), (tmj.JAX(method="rk4", timestep=1e-3), 1e-6)):
        found = tmj.simulate(scene, None, engine, **run)
        for term in ("nodes", "dissipation", "string_energy", "external_work"):
            np.testing.assert_allclose(getattr(found, term), getattr(expected, term), atol=floor)
        np.testing.assert_array_equal(found.tensions[:, :5] == 0, expected.tensions[:, :5] == 0)
        assert found.energy_residual < floor
    assert not [one for one in recwarn if one.category is DerivativeWarning]  # for its dampers: it takes no derivative


def hanging(**string: Any) -> tmj.Scene:
    """A mass of 1 kg on a string: for what the members have no part in, and quick to compile."""
    nodes = {"a": (0.0, 0.0, 1.0), "b": (0.0, 0.0, 0.0)}
    strings = (tmj.String("s", ("a", "b"), **({"stiffness": 50.0, "damping": 1.0, "rest_length": 0.9} | string)),)
    structure = tmj.Structure("hanging", nodes, (), strings, ("a",), point_masses=(tmj.PointMass("b", 1.0),))
    return tmj.Scene(structure)


FIXED = tmj.JAX(method="rk4", timestep=1e-3)
WINDING = tmj.engines.ArrayPolicy(
    lambda p, t, x, v: p["rest"] * (1 - t), {"rest": np.array([0.9])}, Command.REST_LENGTH
)
SHORT = {"duration": 0.05, "output_interval": 0.02}  # with a shorter last row, for which another program is compiled
EVEN = {"duration": 0.04, "output_interval": 0.02}


@pytest.mark.parametrize("hold", [tmj.Actuation.hold_rest_length, tmj.Actuation.hold_force_density])
def test_held_commands_of_one_run_of_many_and_of_a_function(hold: Any) -> None:
    """All are the same operations, but for the order of sums: round-off; and samples are those of the DAE."""
    held, scenes = hold(0.01), [hanging(), hanging(damping=2.0)]
    together = tmj.simulate_many(scenes, WINDING, FIXED, actuation=held, **SHORT)
    alone = tmj.simulate(scenes[1], WINDING, FIXED, actuation=held, **SHORT)
    program = FIXED.model(scenes[1], WINDING, actuation=held, **SHORT)
    function = jax.jit(program.run)(program.parameters)
    expected = tmj.simulate(scenes[1], WINDING, tmj.DAE(method="rk4", timestep=1e-3), actuation=held, **SHORT)
    np.testing.assert_array_equal(alone.time, [0.0, 0.02, 0.04, 0.05])
    for name in ("nodes", "rest_lengths", "tensions"):
        for found in (together[1], function, expected):
            np.testing.assert_allclose(getattr(found, name), getattr(alone, name), rtol=1e-13, atol=1e-13)
    for found in (together[1], expected):
        np.testing.assert_allclose(found.winch_work, alone.winch_work, atol=1e-13)


def test_many_with_constant_forces_of_their_own() -> None:
    """Parabolas, which four stages of Runge-Kutta have to round-off."""
    scenes = [hanging(stiffness=0.0, damping=0.0, rest_length=None, tension=pull) for pull in (8.0, 12.0)]
    together = tmj.simulate_many(scenes, None, FIXED, duration=0.1)
    for run, pull in zip(together, (8.0, 12.0), strict=True):
        np.testing.assert_allclose(run.nodes[:, 1, 2], pull / 2 * run.time**2, atol=1e-15)
    with pytest.raises(OptionError, match="its strings"):
        tmj.simulate_many([scenes[0], hanging(damping=0.0)], None, FIXED, duration=0.1)


def test_what_it_cannot_hold_is_refused() -> None:
    held = tmj.Actuation.hold_rest_length(0.01)
    with pytest.raises(OptionError, match=r"actuation 'hold rest length': .* Method\.RK4"):
        tmj.simulate(hanging(), WINDING, tmj.JAX(), actuation=held, **SHORT)
    with pytest.raises(OptionError, match=r"Method\.RK4"):
        tmj.JAX().model(hanging(), WINDING, actuation=held, **SHORT)
    with pytest.raises(OptionError, match=r"PASSIVE: .* JAX stops"):
        tmj.simulate(hanging(), WINDING, tmj.JAX(), on_infeasible=tmj.OnInfeasible.PASSIVE, **SHORT)
    with pytest.raises(OptionError, match=r"would record 1e\+12 samples"):
        tmj.simulate(hanging(), None, tmj.JAX(), duration=1e9, output_interval=1e-3)


class Failing:
    """A law without a solution, or with what is no number, from a time on."""

    arrays = "law_of_a_test:failing"

    def __init__(self, since: float, margin: float) -> None:
        self.since, self.margin = since, margin

    def __call__(self, time: float, nodes: Any, velocities: Any) -> Any:
        return np.array([10.0])


@pytest.mark.parametrize("engine", [FIXED, tmj.JAX(rtol=1e-6, atol=1e-8)])
@pytest.mark.parametrize("since", [0.0, 0.03])
def test_laws_that_fail_and_runs_that_do(engine: tmj.JAX, since: float, monkeypatch: pytest.MonkeyPatch) -> None:
    from tensegrity_mj.engines.jax.arrays import ArrayLaw

    def failing(law: Failing, structure: Any) -> ArrayLaw:
        def command(p: Any, t: Any, x: Any, v: Any) -> Any:
            fails = jax.numpy.asarray(t) >= law.since
            report = jax.numpy.full(5, np.nan).at[0].set(jax.numpy.where(fails, -law.margin, law.margin))
            return jax.numpy.where(fails, jax.numpy.nan, jax.numpy.full(1, 10.0)), report

        return ArrayLaw({}, command)

    home: Any = ModuleType("law_of_a_test")
    home.failing = failing
    monkeypatch.setitem(sys.modules, "law_of_a_test", home)
    end = 0.02 if since else 0.0
    run = tmj.simulate(hanging(), Failing(since, 1.0), engine, **EVEN)
    assert run.status is tmj.Status.INFEASIBLE
    assert run.time[-1] == end
    assert run.message.startswith(f"the law has no admissible solution after t = {end:.6g} s")
    with pytest.raises(ControllerError, match=f"not finite after t = {end:.6g} s"):
        tmj.simulate(hanging(), Failing(since, np.nan), engine, **EVEN)


def test_steps_that_are_not_enough_are_no_fault_of_the_law() -> None:
    with pytest.raises(DivergenceError, match="raise max_steps") as error:
        tmj.simulate(hanging(), WINDING, tmj.JAX(max_steps=2), duration=2.0)
    assert isinstance(error.value.trajectory, tmj.Trajectory)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"stifness": np.ones(1)}, r"no parameter 'stifness' \(did you mean 'stiffness'\?\)"),
        ({"stiffness": np.ones(2)}, r"parameters\['stiffness'\] has shape \(2,\); it must be \(1,\)$"),
        ({"gravity": "down"}, r"parameters\['gravity'\]: "),
        ({"law": {}}, r"parameters\['law'\]: .*rest"),
        ({"law": {"rest": np.ones((1, 3))}}, r"\['law'\]\['rest'\] has shape \(1, 3\); it must be \(1,\)$"),
        (
            {"nodes": np.zeros((2, 3, 2)), "law": {"rest": np.ones((1, 3))}},
            r"has shape \(1, 3\); it must be \(1,\) or \(1, 2\)",
        ),
    ],
)
def test_parameters_of_other_names_or_shapes_are_refused(given: dict[str, Any], message: str) -> None:
    program = FIXED.model(hanging(), WINDING, **SHORT)
    with pytest.raises(OptionError, match=message):
        program.run({**program.parameters, **given})
    few = {name: one for name, one in program.parameters.items() if name != "gravity"}
    with pytest.raises(OptionError, match="'gravity' is missing"):
        program.run(few)
    with pytest.raises(OptionError, match="use a dict"):
        program.run([1.0])


@pytest.mark.parametrize(
    ("engine", "arguments", "message"),
    [
        (FIXED, {"scene": "prism"}, "scene = 'prism'; use a Scene"),
        (FIXED, {"controller": "lyapunov"}, "controller = 'lyapunov'; use a law"),
        (FIXED, {"controller": Exception}, "use a law"),
        (FIXED, {"actuation": "continuous"}, r"actuation = 'continuous'; use Actuation\."),
        (FIXED, {"output_interval": 0}, "output_interval = 0; it must be"),
        (FIXED, {"output_interval": -0.01}, "output_interval = -0.01; it must be"),
        (FIXED, {"times": [0.0, 0.1]}, "times: RK4 records at multiples of output_interval"),
        (tmj.JAX(window=0.0), {"times": ["a", "b"]}, r"times = \['a', 'b'\]"),
        (tmj.JAX(window=0.0), {"times": [0.1, 0.0]}, "two or more must rise"),
        (tmj.JAX(window=0.0), {"times": [0.0, 0.1], "duration": 1.0}, "leave these out"),
    ],
)
def test_what_a_model_is_made_of_is_checked_as_that_of_a_run(engine: Any, arguments: Any, message: str) -> None:
    with pytest.raises(OptionError, match=message):
        engine.model(**{"scene": hanging(), **arguments})


def test_long_runs_have_short_pieces_by_their_steps(monkeypatch: pytest.MonkeyPatch) -> None:
    """Rows of 1500 steps each: pieces of 1000 steps or so have one of them, where their number gives five."""
    from tensegrity_mj.engines.jax import program as programs
    from tensegrity_mj.engines.jax.model import Observed

    made, reached = programs.compiled, []

    def compiled(function: Any, *arguments: Any) -> Any:
        if len(arguments) == 1:  # what a run begins with
            return made(function, *arguments)
        rows = Observed(*np.zeros((11, len(arguments[-1][0]), 1)))
        return lambda at, state, held, given: (state, held, rows, 1500 * (len(rows.time) - 1), 0)

    program = tmj.JAX(window=0.0).model(hanging(), duration=80.0, output_interval=1.0)
    monkeypatch.setattr(programs, "compiled", compiled)
    monkeypatch.setattr(programs, "progress", lambda *_: nullcontext(reached.append))
    assert len(program.rows("")[0].time) == 81
    np.testing.assert_array_equal(np.diff([0.0, *reached]), [5.0] + [1.0] * 75)
    assert list(programs.pieces(100, [64])) == [5] * 20
    assert max(programs.pieces(1_000_000, [64])) <= 64


def test_ctrl_c_while_a_run_is_compiled_is_heard_before_it_runs(monkeypatch: pytest.MonkeyPatch) -> None:
    from tensegrity_mj.engines.jax import program as programs

    made, ran = programs.compiled, []

    def compiled(function: Any, *arguments: Any) -> Any:
        found = made(function, *arguments)
        if len(arguments) == 1:  # what a run begins with
            return found
        signal.raise_signal(signal.SIGINT)
        return lambda *given: ran.append(given)

    monkeypatch.setattr(programs, "compiled", compiled)
    with pytest.raises(KeyboardInterrupt):
        tmj.simulate(hanging(), None, FIXED, **SHORT)
    assert not ran


def test_who_waits_for_a_run_reads_why_beside_the_bar(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    from tensegrity_mj.engines.jax import program as programs

    monkeypatch.setattr(programs, "QUIET", 0.0)
    tmj.simulate(hanging(), None, FIXED, **EVEN)
    assert capsys.readouterr().err.startswith("tensegrity-mj: JAX prepares this run; programs of fixed steps are kept")


@pytest.mark.parametrize("engine", [FINE, tmj.JAX(method="rk4", timestep=2e-3)], ids=["dopri8", "rk4"])  # type: ignore[arg-type]
def test_runs_begin_later(engine: tmj.JAX) -> None:
    """From the state that a run has at 0.1 s, its rest: supports go on, strings are broken by then or break later.

    Both runs keep their tolerance; those of RK4 round alike but for coordinates of the new start: far below it.
    """
    scene = SCENES["paths, moved supports"]()
    names = [string.name for string in scene.structure.strings]
    scene = scene.with_(breaks=(tmj.model.Break(names[0], 0.04), tmj.model.Break(names[1], 0.16)))
    whole = tmj.simulate(scene, None, engine, duration=0.2, output_interval=INTERVAL)
    row = int(np.argmin(np.abs(whole.time - 0.1)))
    state = {"initial_nodes": whole.nodes[row], "initial_velocities": whole.velocities[row]}
    late = scene.with_(start_time=0.1, duration=0.1, **state)
    second = tmj.simulate(late, None, engine, output_interval=INTERVAL)
    np.testing.assert_allclose(second.time, whole.time[row:], rtol=0, atol=1e-15)
    assert np.abs(second.nodes - whole.nodes[row:]).max() < FLOOR
    np.testing.assert_allclose(second.tensions, whole.tensions[row:], rtol=0, atol=1e-7)
    assert not second.tensions[:, 0].any()
    assert second.tensions[0, 1] > 0 == second.tensions[-1, 1]
    assert np.abs(second.energy_balance).max() < max(ENERGY_FLOOR, 2 * whole.energy_residual)
    # And of one state at that time.
    one, other = (tmj.accelerations(late, None, which) for which in (engine, "dae"))
    np.testing.assert_allclose(one, other, rtol=0, atol=1e-9 * np.abs(other).max())
