"""Many simulations at once, and a law inside MuJoCo's own loops, against single runs."""

from __future__ import annotations

import threading
from dataclasses import replace
from typing import Any

import mujoco
import numpy as np
import pytest
from ending_laws import explosive, unsolvable, wrong
from mujoco import rollout
from mujoco.batch import Batch

import tensegrity_mj as tmj
from tensegrity_mj.controllers import Delayed, Lyapunov
from tensegrity_mj.dynamics.native import pointers
from tensegrity_mj.dynamics.native.law import native_law
from tensegrity_mj.dynamics.native.plant import Plant
from tensegrity_mj.engines.mujoco import many as mujoco_layout
from tensegrity_mj.engines.mujoco import many as mujoco_many
from tensegrity_mj.engines.mujoco import run_view
from tensegrity_mj.engines.mujoco.install import installed
from tensegrity_mj.engines.mujoco.mjcf import scene_to_mjcf
from tensegrity_mj.errors import StabilityWarning
from tensegrity_mj.model.actuation import Actuation, OnInfeasible

STEP = 1e-3
RK4, EULER = tmj.MuJoCo(STEP), tmj.MuJoCo(STEP, tmj.Integrator.EULER)


@pytest.fixture(scope="module")
def starts(prism: tmj.Scene, law: Any) -> list[tmj.Scene]:
    """The prism from states along its way, moving."""
    run = tmj.simulate(prism, law, RK4, duration=1.0)
    return [prism.with_(initial_nodes=run.nodes[k], initial_velocities=run.velocities[k]) for k in (0, 20, 45, 70, 99)]


EVERYTHING = ("nodes", "velocities", "rest_lengths", "tensions", "multipliers", "winch_work", "dissipation", "lyapunov")


@pytest.mark.parametrize("engine", [RK4, EULER], ids=["rk4", "euler"])
@pytest.mark.parametrize(
    "actuation",
    [tmj.Actuation.continuous(), tmj.Actuation.hold_force_density(0.01), tmj.Actuation.hold_rest_length(0.01)],
    ids=["continuous", "force_density", "rest_length"],
)
def test_a_run_among_many_is_the_single_run_to_the_last_bit(prism, law, engine, actuation) -> None:
    # The same compiled code sees the same numbers: the ledger, tensions and multipliers of the last row included.
    alone = tmj.simulate(prism, law, engine, duration=0.3, actuation=actuation)
    for threads in (1, 2):
        runs = tmj.simulate_many([prism] * 3, law, engine, duration=0.3, actuation=actuation, threads=threads)
        assert runs.status == (tmj.Status.COMPLETED,) * 3
        for run in runs:
            for name in EVERYTHING:
                assert np.array_equal(getattr(run, name), getattr(alone, name)), (threads, name)
            assert np.array_equal(runs.nodes[1], alone.nodes)


def test_different_starts_and_targets_agree_with_single_runs(prism, starts) -> None:
    moved = tmj.Target.path([0.0, 3.0], [starts[4].nodes0, prism.target.nodes[0]])
    laws = [Lyapunov(prism.structure, prism.target, decay_rate=1.0 + 0.1 * k) for k in range(4)]
    laws.append(Lyapunov(prism.structure, moved))
    runs = tmj.simulate_many(starts, laws, RK4, duration=0.5, threads=2)
    assert len({run.nodes[-1].tobytes() for run in runs}) == len(starts)
    for run, scene, one in zip(runs, starts, laws, strict=True):
        alone = tmj.simulate(scene, one, RK4, duration=0.5)
        # Joints count from another reference: round-off of 1e-16 m a step over 500 steps, which this motion amplifies
        # at most tenfold.
        assert np.abs(run.nodes - alone.nodes).max() < 500 * 10 * 2.2e-16
        assert run.energy_residual == pytest.approx(alone.energy_residual, abs=1e-12)
        # From accelerations at each row, the last included, which no other simulation's may stand in for.
        assert np.abs(run.multipliers - alone.multipliers).max() < 500 * 10 * 2.2e-16


def test_the_number_of_threads_changes_nothing(starts, law) -> None:
    one, two = (tmj.simulate_many(starts, law, RK4, duration=0.2, threads=threads) for threads in (1, 2))
    assert np.array_equal(one.nodes, two.nodes)
    assert np.array_equal(one.velocities, two.velocities)


def test_loads_breaks_limits_and_python_laws_are_those_of_a_single_run(prism) -> None:
    string = prism.structure.strings[3].name
    node = prism.structure.rods[1].nodes[1]
    scene = prism.with_(breaks=(tmj.model.Break(string, 0.05),), loads=(tmj.model.Load(node, (0.1, 0.0, -0.2), 5.0),))

    def held(time: float, nodes: Any, velocities: Any) -> Any:
        return np.full(12, 0.1 + 0.05 * np.sin(9 * time))

    other = prism.with_(loads=lambda t: np.full((6, 3), 0.01 * np.cos(t)))
    runs = tmj.simulate_many([scene, other, prism], held, EULER, duration=0.2, threads=2)
    for run, one in zip(runs, (scene, other, prism), strict=True):
        alone = tmj.simulate(one, held, EULER, duration=0.2)
        for name in ("nodes", "tensions", "external_work", "dissipation"):
            assert np.array_equal(getattr(run, name), getattr(alone, name)), name
        assert run.cost["law_calls"] == alone.cost["law_calls"] >= 201


def test_scenes_of_other_numbers_have_models_of_their_own(prism, law) -> None:
    structure = prism.structure
    rods = [replace(rod, mass=(1.0 + 0.1 * k) * rod.mass) for k, rod in enumerate(structure.rods)]
    strings = [replace(s, stiffness=1.2 * s.stiffness, damping=0.1) for s in structure.strings]
    heavy = prism.with_(structure=replace(structure, rods=rods), gravity=(0.0, 0.5, -9.81))
    stiff = prism.with_(structure=replace(structure, strings=strings))
    scenes = [prism, heavy, stiff, prism]
    runs = tmj.simulate_many(scenes, [law, None, law, law], RK4, duration=0.2, threads=2)
    for run, scene, one in zip(runs, scenes, [law, None, law, law], strict=True):
        alone = tmj.simulate(scene, one, RK4, duration=0.2)
        for name in (*EVERYTHING[:-1], "external_work"):
            assert np.array_equal(getattr(run, name), getattr(alone, name)), name
    assert len({run.nodes[-1].tobytes() for run in runs}) == 3


def test_a_law_with_a_memory_gets_a_fresh_one_a_run(prism, law) -> None:
    delayed = Delayed(law, 2, 0.01)
    actuation = tmj.Actuation.hold_force_density(0.01)
    alone = tmj.simulate(prism, delayed, RK4, duration=0.2, actuation=actuation)
    for run in tmj.simulate_many([prism] * 3, delayed, RK4, duration=0.2, actuation=actuation, threads=2):
        assert np.array_equal(run.nodes, alone.nodes)
    scene = tmj.load_scene("cross")  # its law starts each search from its last answer
    linearizing = tmj.controllers.from_scene(scene)
    alone = tmj.simulate(scene, linearizing, RK4, duration=0.1, actuation=actuation)
    for run in tmj.simulate_many([scene] * 2, linearizing, RK4, duration=0.1, actuation=actuation, threads=2):
        assert np.array_equal(run.nodes, alone.nodes)


def test_one_that_ends_early_is_distinguished_and_stops_no_other(prism, law) -> None:
    laws = [law, explosive, wrong, unsolvable, law]
    runs = tmj.simulate_many([prism] * 5, laws, RK4, duration=0.2, threads=2)
    done = tmj.Status.COMPLETED
    assert runs.status == (done, tmj.Status.DIVERGED, None, tmj.Status.INFEASIBLE, done)
    alone = tmj.simulate(prism, law, RK4, duration=0.2)
    assert np.array_equal(runs[0].nodes, alone.nodes)
    assert np.array_equal(runs.nodes[4], alone.nodes)
    # What a single run says, it says here.
    for number, error in ((1, tmj.errors.DivergenceError), (2, tmj.errors.ControllerError)):
        with pytest.raises(error) as single:
            tmj.simulate(prism, laws[number], RK4, duration=0.2)
        with pytest.raises(error) as among:
            _ = runs[number]
        assert str(among.value) == str(single.value) == runs.message(number)
        assert np.isnan(runs.nodes[number, -1]).all()
        assert np.isfinite(runs.nodes[number, 0]).all()
    assert runs.message(3) == tmj.simulate(prism, unsolvable, RK4, duration=0.2).message
    assert runs[3].time[-1] == pytest.approx(0.1)
    assert runs.message(0) == ""


def test_a_step_past_the_limit_is_found_for_that_simulation_alone(prism, starts) -> None:
    # Strings a hundred thousand times as stiff: ω of the order of 1e3 1/s, and h ω far above RK4's 2.8 at 50 ms. MuJoCo
    # raises no error, and Batch.status stays 0.
    strings = [replace(s, stiffness=1e5 * s.stiffness) for s in prism.structure.strings]
    stiff = prism.with_(structure=replace(prism.structure, strings=strings), control=None)
    moving = stiff.with_(initial_nodes=starts[2].nodes0, initial_velocities=starts[2].velocities0)
    slack = np.full(12, 5.0)  # rest lengths with which no string acts

    class Slack:
        command = tmj.Command.REST_LENGTH

        def __call__(self, time: float, nodes: Any, velocities: Any) -> Any:
            return slack

    engine = tmj.MuJoCo(0.05)
    with pytest.warns(StabilityWarning):
        runs = tmj.simulate_many([moving, moving, moving], [None, Slack(), None], engine, duration=2.0, threads=2)
    with pytest.warns(StabilityWarning), pytest.raises(tmj.errors.DivergenceError) as single:
        tmj.simulate(moving, None, engine, duration=2.0)
    assert runs.status == (tmj.Status.DIVERGED, tmj.Status.COMPLETED, tmj.Status.DIVERGED)
    assert runs.message(0) == str(single.value)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"scenes": []}, ("at least one",)),
        ({"scenes": ["prism"]}, ("scenes[0]", "Scene")),
        ({"other": "pinned_rod"}, ("scenes[1]", "nodes", "run_many")),
        ({"turned": True}, ("scenes[1]", "strings", "run_many")),
        ({"engine": tmj.DAE(accuracy=1e-4)}, ("accuracy", "timestep")),
        ({"threads": -1}, ("threads", "-1")),
        ({"threads": 1.5}, ("threads", "1.5")),
        ({"controllers": [None]}, ("1 laws", "2 scenes")),
    ],
)
def test_what_cannot_be_is_refused(prism, arguments, words) -> None:
    given = dict(arguments)
    scenes = [prism, prism]
    if "other" in given:
        scenes = [prism, tmj.load_scene(given.pop("other"))]
    if given.pop("turned", False):
        turned = replace(prism.structure, strings=prism.structure.strings[::-1])
        scenes = [prism, prism.with_(structure=turned, control=None)]
    scenes = given.pop("scenes", scenes)
    with pytest.raises(tmj.errors.OptionError) as caught:
        tmj.studies.simulate_many(scenes, **given)  # inside, where a text is no scene
    assert all(word in str(caught.value) for word in words), str(caught.value)


def reached(model: mujoco.MjModel, scene: tmj.Scene, data: mujoco.MjData) -> Any:
    mujoco.mj_kinematics(model, data)
    return data.site_xpos[[model.site(name).id for name in scene.structure.nodes]]


@pytest.mark.parametrize("engine", [RK4, EULER], ids=["rk4", "euler"])
def test_a_law_in_mj_step_rollout_and_batch_is_that_of_simulate(prism, law, engine) -> None:
    alone = tmj.simulate(prism, law, engine, duration=0.25)
    with tmj.law_in(prism, law, engine) as model:
        data = mujoco.MjData(model)
        mujoco.mj_step(model, data, 250)
        # Time is summed there, n h here: the law does not depend on it.
        assert np.array_equal(reached(model, prism, data), alone.nodes[-1])
        full = mujoco.mjtState.mjSTATE_FULLPHYSICS.value
        states = np.zeros((2, mujoco.mj_stateSize(model, full)))
        mujoco.mj_getState(model, mujoco.MjData(model), states[0], full)
        mujoco.mj_getState(model, data, states[1], full)
        for threads in (1, 2):
            batch = Batch(model, 5, threads)
            places = batch.bind("qpos")
            batch.step(nstep=250)
            assert np.array_equal(places, np.tile(data.qpos, (5, 1)))
            found, _ = rollout.rollout(
                model, [mujoco.MjData(model) for _ in range(threads)], np.tile(states[0], (5, 1)), nstep=250
            )
            assert np.array_equal(found[:, -1], np.tile(states[1], (5, 1)))
    free = mujoco.MjData(model)
    mujoco.mj_step(model, free, 250)
    assert np.abs(free.qpos - data.qpos).max() > 1e-3  # without the law it goes elsewhere


def test_the_law_is_reentrant(prism, law, starts) -> None:
    """Threads that call one context at once get what a single one gets."""
    states = [(np.array(s.nodes0), np.array(s.velocities0)) for s in starts]
    expected = [law(0.0, *state) for state in states]
    wrong: list[int] = []

    def call(number: int) -> None:
        for _ in range(2000):
            if not np.array_equal(law.evaluate(0.0, *states[number])[0], expected[number]):
                wrong.append(number)

    threads = [threading.Thread(target=call, args=(n,)) for n in range(len(states))]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert not wrong


def test_other_models_are_left_alone_while_a_law_is_in(prism, law) -> None:
    rod = tmj.load_scene("pinned_rod")
    ball = "<mujoco><worldbody><body><freejoint/><geom size='.1'/></body></worldbody></mujoco>"
    model = RK4.model(rod)
    before = mujoco.MjData(model)
    mujoco.mj_step(model, before, 20)
    with tmj.law_in(prism, law, RK4):
        for other in (mujoco.MjModel.from_xml_string(ball), RK4.model(rod), RK4.model(tmj.load_scene("planar_beam"))):
            data = mujoco.MjData(other)
            mujoco.mj_step(other, data, 20)
            assert not data.ctrl.any()
            if other.nq == model.nq:
                assert np.array_equal(data.qpos, before.qpos)
        with pytest.raises(tmj.errors.OptionError, match="under way"):
            tmj.simulate(prism, law, RK4, duration=0.1)
    assert mujoco.get_mjcb_control() is None


def test_a_model_of_the_same_shape_with_other_strings_is_distinguished(prism, law) -> None:
    """Its signature is the same; the law's rest lengths would be another spring's."""
    structure = prism.structure
    stiff = replace(structure, strings=[replace(s, stiffness=2 * s.stiffness) for s in structure.strings])
    damped = replace(structure, strings=[replace(s, damping=1.0) for s in structure.strings])
    turned = replace(structure, strings=structure.strings[::-1])
    longer = replace(structure, strings=[*structure.strings[:-1], replace(structure.strings[-1], force_density=0.06)])
    for other in (stiff, damped, turned, longer):
        model = RK4.model(prism.with_(structure=other, control=None))
        data = mujoco.MjData(model)
        assert RK4.model(prism).signature == model.signature
        with pytest.raises(tmj.errors.OptionError, match="other strings"), tmj.law_in(prism, law, RK4):
            mujoco.mj_step(model, data, 3)
        assert not data.ctrl.any()
    # One number at a time: stiffness as gain and as spring, rest length, damping, an end.
    for name, place, change in (
        ("actuator_gainprm", (3, 0), 2.0),
        ("actuator_biasprm", (11, 0), 0.1),
        ("actuator_biasprm", (0, 1), -2.0),
        ("actuator_biasprm", (5, 2), -1.0),
        ("wrap_objid", (0,), 1),
    ):
        model = RK4.model(prism)
        getattr(model, name)[place] += change
        data = mujoco.MjData(model)
        with pytest.raises(tmj.errors.OptionError, match="other strings"), tmj.law_in(prism, law, RK4):
            mujoco.mj_forward(model, data)
        assert not data.ctrl.any()
    with tmj.law_in(prism, law, RK4) as model:
        model.body_mass *= 1.1
        data = mujoco.MjData(model)
        mujoco.mj_step(model, data, 3)
    assert data.ctrl.any()


def test_a_model_of_the_same_sizes_and_strings_with_other_joints_is_left_alone(prism, law) -> None:
    """Its signature alone shows it."""
    own = RK4.model(prism)
    spec = mujoco.MjSpec.from_string(scene_to_mjcf(prism, RK4.timestep, RK4.word))
    spec.delete(spec.joints[-1])
    other = spec.compile()
    sizes = ("nu", "nsite", "nbody", "nuserdata")
    assert [getattr(other, name) for name in sizes] == [getattr(own, name) for name in sizes]
    assert np.array_equal(other.wrap_objid, own.wrap_objid)
    assert other.signature != own.signature
    data = mujoco.MjData(other)
    with tmj.law_in(prism, law, RK4):
        mujoco.mj_step(other, data, 3)
    assert not data.ctrl.any()


def test_positions_are_nan_from_where_the_energy_balance_knows_of_a_divergence() -> None:
    scene = tmj.load_scene("prism_drop").with_(contact=None)
    with pytest.warns(StabilityWarning):
        runs = tmj.simulate_many([scene], None, tmj.MuJoCo(1e-2, tmj.Integrator.EULER), duration=2.0)
    with pytest.raises(tmj.errors.DivergenceError, match="energy") as caught:
        _ = runs[0]
    gone = np.isnan(runs.nodes[0]).any(axis=(1, 2))
    assert np.array_equal(gone, runs.time > caught.value.time)
    assert 0 < gone.sum() < len(gone)


def test_a_law_that_steps_what_it_controls_is_stopped(prism) -> None:
    found: list[Any] = []

    def predicting(time: float, nodes: Any, velocities: Any) -> Any:
        mujoco.mj_step(found[0], mujoco.MjData(found[0]))
        return np.full(12, 0.1)

    found.append(RK4.model(prism))
    with pytest.raises(tmj.errors.ControllerError, match="within itself"), tmj.law_in(prism, predicting, RK4):
        mujoco.mj_step(found[0], mujoco.MjData(found[0]))


def test_userdata_that_is_not_ours_is_no_address(prism, law) -> None:
    """With the callback of many runs in, data of the same model without our token are left alone."""
    from tensegrity_mj.engines.mujoco.ensemble import TOKEN, MuJoCoEnsemble
    from tensegrity_mj.engines.request import request_for

    request = request_for(prism, law, 0.1, None, tmj.OnInfeasible.STOP, None, False)
    ensemble = MuJoCoEnsemble(RK4, [request], 1)
    with installed(ensemble.guide, mujoco_many.many_runs):
        data = mujoco.MjData(ensemble.model)
        for userdata in ((0.0, 0.0), (TOKEN, 1.0), (TOKEN, -1.0), (np.nan, np.nan)):
            data.userdata[:] = userdata
            mujoco.mj_step(ensemble.model, data, 3)
        assert not data.ctrl.any()
        assert not ensemble.counters[0, run_view.STEP]
        data.userdata[:] = TOKEN, 0.0
        mujoco.mj_step(ensemble.model, data, 3)
        assert data.ctrl.any()
        assert ensemble.counters[0, run_view.STEP] == 3


def test_laws_that_cannot_stand_alone_are_refused(prism, law) -> None:
    cross = tmj.load_scene("cross")
    for scene, one, word in (
        (cross, tmj.controllers.from_scene(cross), "keeps something"),
        (prism, Delayed(law, 1, 0.01), "sampl"),
        (prism, Lyapunov(prism.structure, prism.target, norm=1), "sampled"),
        (prism.with_(breaks=(tmj.model.Break("s1", 0.1),)), law, "break"),
        (prism, None, "no law to install"),
    ):
        with pytest.raises(tmj.errors.OptionError, match=word), tmj.law_in(scene, one, RK4):
            pass


def test_a_law_in_that_fails_says_so_at_the_end(prism) -> None:
    def failing(time: float, nodes: Any, velocities: Any) -> Any:
        raise ValueError("oh")

    def empty(time: float, nodes: Any, velocities: Any) -> Any:
        raise tmj.errors.InfeasibleError("none")

    def step() -> None:
        mujoco.mj_step(model, mujoco.MjData(model), 2)

    with pytest.raises(tmj.errors.ControllerError, match="oh"), tmj.law_in(prism, failing, RK4) as model:
        step()
    with pytest.raises(tmj.errors.InfeasibleError), tmj.law_in(prism, empty, RK4) as model:
        step()
    with tmj.law_in(prism, empty, RK4, on_infeasible=tmj.OnInfeasible.PASSIVE) as model:
        step()

    def endless(time: float, nodes: Any, velocities: Any) -> Any:
        return np.full(12, np.inf)

    with pytest.raises(tmj.errors.ControllerError, match="not finite"), tmj.law_in(prism, endless, RK4) as model:
        step()
    assert mujoco.get_mjcb_control() is None


def test_a_layout_that_is_not_as_declared_is_an_error_and_no_crash(prism, monkeypatch) -> None:
    model = RK4.model(prism)
    data = mujoco.MjData(model)
    mujoco_layout.check_layout(model, data, ("ctrl", "cvel", "site_xpos"))
    right = mujoco_layout.offset
    for structure, field in (("mjData", "cvel"), ("mjData", "time"), ("mjModel", "nsite"), ("mjModel", "signature")):

        def shifted(a: str, b: str, structure: str = structure, field: str = field) -> int:
            return right(a, b) + (8 if (a, b) == (structure, field) else 0)

        monkeypatch.setattr(mujoco_layout, "offset", shifted)
        with pytest.raises(tmj.errors.MissingLibraryError, match=f"{structure}.{field}"):
            mujoco_layout.check_layout(model, data, ("ctrl", "cvel", "site_xpos"))


def test_scratch_beyond_the_stack_is_on_the_heap() -> None:
    """A structure whose law needs more scratch than a stack should hold gives what its parts give alone."""
    copies = 800
    part = tmj.load_scene("pinned_rod")
    N, M = len(part.structure.nodes), len(part.structure.strings)
    dry = Plant(part, native_law(None, part.structure), Actuation.continuous(), OnInfeasible.STOP, run_view.RUN)
    dry["force_range"] = np.zeros((M, 2))
    assert copies * (3 * N + 2 * M) > pointers.STACK_LIMIT > mujoco_many.law_room(dry)
    nodes: dict[str, Any] = {}
    rods, strings, fixed = [], [], []
    for k in range(copies):
        nodes |= {f"{name}-{k}": at for name, at in zip(part.structure.node_names, part.nodes0, strict=True)}
        rods += [
            replace(r, name=f"{r.name}-{k}", nodes=tuple(f"{n}-{k}" for n in r.nodes)) for r in part.structure.rods
        ]
        strings += [
            replace(s, name=f"{s.name}-{k}", nodes=tuple(f"{n}-{k}" for n in s.nodes)) for s in part.structure.strings
        ]
        fixed += [f"{name}-{k}" for name in part.structure.fixed_nodes]
    whole = tmj.Structure(name="many", nodes=nodes, rods=rods, strings=strings, fixed_nodes=fixed)
    at = np.tile(part.nodes0, (copies, 1))
    one = tmj.controllers.from_scene(part)
    many = Lyapunov(whole, np.tile(part.target.nodes[0], (copies, 1)), decay_rate=one.decay_rate)
    small, large = one.terms(0.0, part.nodes0, part.velocities0), many.terms(0.0, at, np.zeros_like(at))
    assert large.V_error == pytest.approx(copies * small.V_error, rel=1e-12)  # a sum of so many
    assert np.array_equal(large.f, np.tile(small.f, copies))
    # u = α f/Σf² over the f of α's sign: both α and the sum grow with the number of copies.
    u = many.evaluate(0.0, at, np.zeros_like(at))[0]
    assert u == pytest.approx(np.tile(one(0.0, part.nodes0, part.velocities0), copies), rel=1e-12, abs=1e-15)
