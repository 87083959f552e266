"""Elements with a state: integrated with the equations in every engine, recorded, and counted in the ledger."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import h5netcdf
import numpy as np
import pytest
from ground_spring import GroundSpring
from linked_scenes import hanging_chain
from maxwell import CompiledMaxwell, Maxwell, SlowBrake, Thruster
from scipy.linalg import expm

import tensegrity_mj as tmj
from tensegrity_mj.basics import fields
from tensegrity_mj.commands.scenes import statics
from tensegrity_mj.model import register

MASS, SPRING, STIFFNESS, DAMPING = 2.0, 18.0, 40.0, 8.0  # kg, N/m to the ground; N/m and N s/m in series beside it
START, SPEED, ELONGATION = np.array([0.2, -0.1, 0.3]), np.array([0.1, 0.0, -0.2]), (0.05, 0.0, 0.1)
# Of (x, v, s) along each axis: the standard linear solid with a mass.
SYSTEM = np.array(
    [
        [0.0, 1.0, 0.0],
        [-(SPRING + STIFFNESS) / MASS, 0.0, STIFFNESS / MASS],
        [STIFFNESS / DAMPING, 0.0, -STIFFNESS / DAMPING],
    ]
)
RATE = float(np.abs(np.linalg.eigvals(SYSTEM)).max())  # 5.2 /s, the largest of its modes
DURATION = 1.6


def solid(kind: type[Maxwell] = Maxwell) -> tmj.Scene:
    """A mass on a spring to the ground with a Maxwell element beside it."""
    structure = tmj.Structure("solid", {"a": tuple(START)}, point_masses=(tmj.model.PointMass("a", MASS),))
    elements = (GroundSpring("a", SPRING), kind("a", STIFFNESS, DAMPING, start=ELONGATION))
    return tmj.Scene(structure, initial_velocities=SPEED[None], elements=elements)


def truth(times: Any) -> Any:
    """(T, 3, 3): x, v and s along each axis, by the exponential of the matrix."""
    start = np.array([START, SPEED, ELONGATION])
    return np.array([expm(SYSTEM * t) @ start for t in times])


def error(run: tmj.Trajectory) -> float:
    """The largest of nodes, velocities and states."""
    found = np.stack([run.nodes[:, 0], run.velocities[:, 0], run.element_states], axis=1)
    return float(np.abs(found - truth(run.time)).max())


def fixed(name: str, step: float, **options: Any) -> Any:
    """An engine with steps of RK4."""
    if name == "mujoco":
        return tmj.MuJoCo(step, **options)
    return {"dae": tmj.DAE, "ode": tmj.ODE}[name](method=tmj.Method.RK4, timestep=step, **options)


NAMES = ("mujoco", "dae", "ode")
CONTROLLED = [
    tmj.DAE(rtol=1e-11, atol=1e-13),
    tmj.ODE(rtol=1e-11, atol=1e-13),
    tmj.DAE(method=tmj.Method.RADAU, rtol=1e-9, atol=1e-11),
]


@pytest.mark.parametrize("kind", [Maxwell, CompiledMaxwell])
@pytest.mark.parametrize("engine", CONTROLLED, ids=str)
def test_methods_with_error_control_follow_the_standard_linear_solid(engine: Any, kind: type[Maxwell]) -> None:
    run = tmj.simulate(solid(kind), engine=engine, duration=DURATION)
    # Errors of each step within rtol of numbers below 1.3 add up over some 100 steps or fewer.
    assert error(run) < 130 * engine.rtol
    assert run.energy_residual < 130 * engine.rtol
    assert run.dissipation[-1] > 0.1
    assert run.element_state_names == tuple(f"elements[1] {kind.__name__}: s{k}" for k in (1, 2, 3))


@pytest.mark.third_means(
    "elements.let_act with states",
    "elements.held_powers with states",
    by="the exponential of a standard linear solid's matrix",
)
@pytest.mark.parametrize("name", NAMES)
def test_rk4_keeps_its_order_with_states_and_closes_the_ledger(name: str) -> None:
    runs = [tmj.simulate(solid(), engine=fixed(name, h), duration=DURATION, output_interval=0.04) for h in (0.04, 0.02)]
    errors = [error(run) for run in runs]
    # RK4 errs by (r h)^4 r T / 120 of numbers below 1.3 at most, by less for modes that decay; the next term is
    # r h / 6 = 0.03 of it, far within half an order.
    assert errors[0] < 1.3 * (RATE * 0.04) ** 4 * RATE * DURATION / 120
    assert 2**3.5 < errors[0] / errors[1] < 2**4.5
    residuals = [run.energy_residual for run in runs]
    assert residuals[1] < residuals[0] / 2**3.5
    assert residuals[0] < errors[0] * 100  # J: energies are (K + k) / 2 and more of squares below 1.3


@pytest.mark.third_means("elements.let_act with states", by="the exponential of a standard linear solid's matrix")
@pytest.mark.parametrize("integrator", [one for one in tmj.Integrator if one is not tmj.Integrator.RK4])
def test_integrators_of_one_stage_keep_their_order_with_states(integrator: tmj.Integrator) -> None:
    runs = [
        tmj.simulate(solid(), engine=tmj.MuJoCo(h, integrator), duration=DURATION, output_interval=0.04)
        for h in (4e-3, 2e-3)
    ]
    errors, residuals = [error(run) for run in runs], [run.energy_residual for run in runs]
    # Of first order: z / 2 = r h / 2 a radian, over r T of them; the next term is z of it.
    assert errors[0] < 1.3 * (RATE * 4e-3) / 2 * RATE * DURATION
    assert 2**0.5 < errors[0] / errors[1] < 2**1.5
    assert residuals[1] < residuals[0] / 2**0.5


def test_a_second_run_starts_with_the_states_of_the_start() -> None:
    scene = jumper()
    for engine in (*(fixed(name, 0.01, locate_slack=True) for name in NAMES), tmj.MuJoCo(0.01, tmj.Integrator.EULER)):
        first, second = (tmj.simulate(scene, engine=engine, duration=0.2) for _ in range(2))
        assert np.array_equal(first.element_states, second.element_states)
        assert np.array_equal(first.nodes, second.nodes)


def test_a_compiled_element_is_the_one_in_python() -> None:
    for name in NAMES:
        runs = [
            tmj.simulate(solid(kind), engine=fixed(name, 0.01), duration=0.4) for kind in (Maxwell, CompiledMaxwell)
        ]
        # The same formulas, in another order of products: some 2e-16 a stage.
        assert np.abs(runs[0].nodes - runs[1].nodes).max() < 1e-13
        assert np.abs(runs[0].element_states - runs[1].element_states).max() < 1e-13
        assert np.abs(runs[0].dissipation - runs[1].dissipation).max() < 1e-12


@pytest.mark.parametrize("method", [tmj.Method.RADAU])
def test_an_implicit_method_knows_the_slopes_of_the_states(method: tmj.Method) -> None:
    # A dashpot that gives way within 5 µs: explicit steps of 1.6 s would be 1e5 and more.
    scene = solid().with_(elements=(GroundSpring("a", SPRING), Maxwell("a", STIFFNESS, 2e-4)))
    run = tmj.simulate(scene, engine=tmj.DAE(method=method, rtol=1e-6, atol=1e-8), duration=DURATION)
    # The spring of the element pulls c v = 2e-4 N m/s at most: the motion is that of the spring to the ground, which
    # it damps by c T / 2 m = 8e-5 and loads with k x m / c for microseconds at the start.
    free = START * np.cos(3 * run.time)[:, None] + SPEED / 3 * np.sin(3 * run.time)[:, None]
    assert np.abs(run.nodes[:, 0] - free).max() < 3e-4
    assert run.cost["evaluations"] < 5000


def jumper() -> tmj.Scene:
    """A mass that jumps on a string, with all kinds of elements that have a state."""
    nodes = {"p": (0.0, 0.0, 0.0), "a": (0.1, 0.05, -0.6)}
    structure = tmj.Structure(
        "jumper",
        nodes,
        strings=(tmj.String("s", ("p", "a"), 150.0, rest_length=0.5),),
        fixed_nodes=("p",),
        point_masses=(tmj.model.PointMass("a", 1.0),),
    )
    elements = (
        Maxwell("a", 30.0, 6.0, (0.1, 0.0, -0.5)),
        Thruster("a", 2.0, 0.1),
        GroundSpring("a", 3.0),
        SlowBrake("a", 0.4, 0.05),
    )
    velocities = np.array([[0.0, 0.0, 0.0], [0.0, 0.2, -1.0]])
    return tmj.Scene(structure, initial_velocities=velocities, gravity=(0.0, 0.0, -9.81), elements=elements)


@pytest.mark.parametrize("name", NAMES)
def test_steps_that_are_split_where_a_string_goes_slack_keep_their_order(name: str) -> None:
    scene = jumper()
    reference = tmj.simulate(scene, engine=tmj.DAE(rtol=1e-12, atol=1e-13), duration=0.8, output_interval=0.02)
    assert np.sum(np.diff((reference.tensions[:, 0] > 0).astype(int)) != 0) >= 2  # it goes slack, and taut
    errors, residuals = [], []
    for h in (0.005, 0.00125):
        run = tmj.simulate(scene, engine=fixed(name, h, locate_slack=True), duration=0.8, output_interval=0.02)
        gap = np.abs(run.element_states - reference.element_states).max()
        errors.append(max(tmj.compare(run, reference).max_node_error, float(gap)))
        residuals.append(run.energy_residual)
    # The next term of the error is h/τ = 0.1 of the leading one for the shortest lag: within half an order.
    assert errors[1] < errors[0] / 2 ** (2 * 3.5)
    assert residuals[1] < residuals[0] / 2 ** (2 * 3.5)
    plain = tmj.simulate(scene, engine=fixed(name, 0.00125), duration=0.8, output_interval=0.02)
    assert np.abs(plain.element_states - reference.element_states).max() > 10 * errors[1]


@pytest.mark.parametrize("rods", [1, 3])
def test_forces_of_rods_have_the_states_of_their_time(rods: int) -> None:
    chain = hanging_chain([0.3, 0.5, 0.4][:rods], [1.0, 1.0, 1.0][:rods])
    last = chain.structure.node_names[-1]
    place = tuple(float(x) for x in chain.nodes0[-1] + np.array([0.1, 0.05, 0.0]))
    scene = chain.with_(elements=(Maxwell(last, 300.0, 20.0, place),))
    runs = [tmj.simulate(scene, engine=engine, duration=0.3) for engine in (tmj.MuJoCo(1e-3), tmj.DAE())]
    assert np.ptp(runs[1].element_states) > 1e-2
    # λ from recorded states, which agree to some 1e-8, against the DAE's own.
    assert np.abs(runs[0].multipliers - runs[1].multipliers).max() < 1e-6 * np.abs(runs[1].multipliers).max()


def test_an_accuracy_holds_with_states() -> None:
    for engine in (tmj.MuJoCo(accuracy=1e-6), tmj.DAE(accuracy=1e-6)):
        run = tmj.simulate(solid(), engine=engine, duration=DURATION)
        assert np.abs(run.nodes[:, 0] - truth(run.time)[:, 0]).max() < 1e-6


def test_many_simulations_at_once_have_states_of_their_own() -> None:
    scenes = [jumper(), jumper().with_(elements=(replace(jumper().elements[0], damping=1.0),)), jumper()]
    together = tmj.simulate_many(scenes, None, tmj.MuJoCo(1e-3), duration=0.1, threads=2)
    for found, scene in zip(together, scenes, strict=True):
        alone = tmj.simulate(scene, None, tmj.MuJoCo(1e-3), duration=0.1)
        assert np.array_equal(found.element_states, alone.element_states)
        assert np.array_equal(found.nodes, alone.nodes)
        assert np.array_equal(found.dissipation, alone.dissipation)


@pytest.fixture
def known(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(fields, "_KINDS", dict(fields._KINDS))
    for name, kind in {"spring": GroundSpring, "maxwell": Maxwell}.items():
        register(name, kind)


def test_files_keep_the_states_by_their_names(known: None, tmp_path: Path) -> None:
    run = tmj.simulate(solid(), engine=tmj.DAE(), duration=0.2)
    path = run.save(tmp_path / "run.nc")
    again = tmj.Trajectory.load(path)
    assert np.array_equal(again.element_states, run.element_states)
    assert np.array_equal(again.energy_balance, run.energy_balance)
    assert again.element_state_names == run.element_state_names
    assert np.array_equal(run.until(3).element_states, run.element_states[:3])
    with h5netcdf.File(path) as file:
        assert file.variables["element_states"].dimensions == ("time", "element_state")
        assert file.variables["element_states"].attrs["names"] == ", ".join(run.element_state_names)
    plain = tmj.simulate(solid().with_(elements=()), engine=tmj.DAE(), duration=0.2)
    with h5netcdf.File(plain.save(tmp_path / "plain.nc")) as file:
        assert "element_states" not in file.variables


@pytest.mark.parametrize("engine", [tmj.MuJoCo(), tmj.DAE(), tmj.ODE()], ids=str)
def test_a_linear_model_has_the_relaxation_of_the_standard_linear_solid(engine: Any) -> None:
    model = tmj.linearize(solid(), engine)
    # m λ³ + (m k/c) λ² + (K + k) λ + K k/c = 0 along each axis.
    relaxing = MASS * STIFFNESS / DAMPING
    roots = np.roots([MASS, relaxing, SPRING + STIFFNESS, SPRING * STIFFNESS / DAMPING])
    expected, found = (
        values[np.lexsort((values.real.round(6), values.imag.round(6)))]
        for values in (np.repeat(roots, 3), model.eigenvalues)
    )
    # Differences of functions that are linear, over 1e-5 in the states: round-off of 1e-16 of 1 over that; roots that
    # are three times the same keep it, as A is one matrix along each axis.
    assert np.abs(found - expected).max() < 1e-9
    assert model.A.shape == (9, 9)
    assert model.states == tuple(f"elements[1] Maxwell: s{k}" for k in (1, 2, 3))
    order = [3 * part + axis for axis in range(3) for part in range(3)]
    assert np.abs(model.A[np.ix_(order, order)] - np.kron(np.eye(3), SYSTEM)).max() < 1e-9
    assert model.residual == pytest.approx((SYSTEM @ np.array([START, SPEED, ELONGATION])).ravel(), abs=1e-9)
    assert model.to_dict()["states"] == list(model.states)
    moved = model.deviation(START[None] + 0.1, SPEED[None], np.array(ELONGATION) + 0.3)
    assert moved == pytest.approx([0.1] * 3 + [0.0] * 3 + [0.3] * 3, abs=1e-15)
    assert model.deviation(START[None], SPEED[None]) == pytest.approx(np.zeros(9), abs=1e-15)


def test_linear_models_with_strings_and_all_kinds_of_states_are_those_of_all_engines() -> None:
    models = [tmj.linearize(jumper(), engine, time=0.3) for engine in (tmj.DAE(), tmj.MuJoCo(), tmj.ODE())]
    assert models[0].A.shape == (6 + 7, 6 + 7)
    for model in models:
        # Narrow differences, as a brake is not known to be smooth: 4e-12 of k and 1e-10 s of accelerations.
        assert np.abs(model.A - models[0].A).max() < 1e-8 * np.abs(models[0].A).max()
    thrust, seen = models[0].A[3, 9], models[0].A[9, 9]
    assert (thrust, seen) == pytest.approx((1.0, -10.0), rel=1e-8)  # 1 / m of its state, -1 / lag


def test_stable_steps_say_that_states_have_rates_of_their_own() -> None:
    found = tmj.stable_step(solid(), tmj.DAE(method=tmj.Method.RK4, timestep=1e-3))
    # With the dashpot still, the mass is on both springs; RK4 goes to 2 √2 / ω.
    assert found.limit == pytest.approx(2 * np.sqrt(2) / np.sqrt((SPRING + STIFFNESS) / MASS), rel=1e-8)
    assert any("states of elements (Maxwell) stay as they are" in note for note in found.notes)


def test_what_has_no_states_refuses_them() -> None:
    scene = solid()
    for use, call in {
        "statics": lambda: tmj.statics.find_equilibrium(scene),
        "engine_equilibrium": lambda: tmj.statics.engine_equilibrium(scene, tmj.DAE()),
    }.items():
        with pytest.raises(tmj.errors.SceneError, match=rf"{use}: Maxwell has a state .* not solved for; replace"):
            call()

    def law(time: float, nodes: Any, velocities: Any) -> Any:
        return np.zeros(1)

    with (
        pytest.raises(tmj.errors.OptionError, match=r"law_in: Maxwell has a state .* integrates it; use simulate_many"),
        tmj.law_in(jumper(), law),
    ):
        pass


def test_dm_control_refuses_states() -> None:
    dm_control = pytest.importorskip("tensegrity_mj.learning.dm_control", exc_type=tmj.errors.MissingPackageError)
    with pytest.raises(tmj.errors.SceneError, match=r"dm_control models: Maxwell has a state .*; use simulate"):
        dm_control.TensegrityEntity(jumper())


def test_a_step_that_is_too_long_for_a_state_is_a_divergence() -> None:
    # k h / c = 10 of the dashpot alone, where RK4 goes to 2.785 and Euler to 2.
    scene = solid().with_(elements=(GroundSpring("a", SPRING), Maxwell("a", STIFFNESS, 0.02)))
    for engine in (tmj.MuJoCo(5e-3), tmj.MuJoCo(5e-3, tmj.Integrator.EULER), fixed("dae", 5e-3)):
        with pytest.raises(tmj.errors.DivergenceError, match=r"energy came from nowhere.*reduce the time step"):
            tmj.simulate(scene, engine=engine, duration=0.5)


def test_a_scene_is_described_with_the_states_that_it_starts_with() -> None:
    # Both springs pull with k times where the mass, or the mass less the dashpot, is.
    pull = -SPRING * START - STIFFNESS * (START - np.array(ELONGATION))
    assert statics(solid())["unbalanced_force"] == pytest.approx(float(np.linalg.norm(pull)), rel=1e-12)


@dataclass(frozen=True)
class Odd(Maxwell):
    """One whose state or rates are wrong."""

    node: str = "a"
    stiffness: float = 1.0
    damping: float = 1.0
    first: Any = (0.0,)
    change: Any = (0.0,)

    def act(self, scene: Any, time: float, nodes: Any, velocities: Any, state: Any) -> Any:  # type: ignore[override]
        return np.zeros_like(nodes)

    def state0(self, scene: Any) -> Any:
        return np.array(self.first)

    def rates(self, scene: Any, time: float, nodes: Any, velocities: Any, state: Any) -> Any:
        return np.array(self.change) if time < 0.05 else np.array([np.nan])


class WithoutRates(GroundSpring):
    """A state that nothing changes."""

    def state0(self, scene: Any) -> Any:
        return np.zeros(1)


def test_states_that_are_none_are_refused_with_their_element() -> None:
    bare = solid().with_(elements=())
    for element, message in (
        (Odd(first=()), r"elements\[0\] \(Odd\) failed at t = 0: .*its state0 is .*one finite number or more"),
        (Odd(first=(np.inf,)), "its state0 is"),
        (Odd(first=((0.0,),)), "its state0 is"),
        (Odd(change=(0.0, 1.0)), r"its rates have shape \(2,\); they must be finite \(1,\)"),
        (WithoutRates("a", 1.0), "has both state0.*and rates.*: add the one"),
    ):
        with pytest.raises(tmj.errors.SceneError, match=message):
            bare.with_(elements=(element,))
    for engine in (tmj.MuJoCo(1e-2), tmj.DAE()):
        with pytest.raises(tmj.errors.ElementError, match=r"element Odd failed near t = 0\.0\d+ s: .*its rates"):
            tmj.simulate(bare.with_(elements=(Odd(),)), engine=engine, duration=0.2)
