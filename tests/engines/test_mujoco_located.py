"""MuJoCo's RK4 that splits its steps where strings go slack or taut: closed forms, the DAE, what it leaves alone."""

from __future__ import annotations

import json
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from caught_mass import GRAVITY, REST, STIFFNESS, bob, bob_at
from linked_scenes import everything_moves

import tensegrity_mj as tmj
from evidence.random_structures import random_scene, random_structure
from tensegrity_mj.cli import main
from tensegrity_mj.dynamics.native.law import native_law
from tensegrity_mj.engines.mujoco.run import LocatedRun, MuJoCoRun
from tensegrity_mj.engines.mujoco.run_view import STAGE, STEP
from tensegrity_mj.engines.request import Request
from tensegrity_mj.model.strings import StringLaw
from tensegrity_mj.runs.convergence import has_kinks, node_difference


def located(step: float) -> tmj.MuJoCo:
    return tmj.MuJoCo(step, locate_slack=True)


def random_rods(seed: int, **changes: Any) -> tmj.Scene:
    """Three rods whose strings go slack and taut many times in half a second."""
    rng = np.random.default_rng(seed)
    structure = random_structure(
        rng,
        rods=3,
        strings=8,
        stiffness=(100.0, 300.0),
        damping=(0.0, 2.0),
        stretch=(-0.1, 0.2),
        fixed_nodes=1,
        **changes,
    )
    return random_scene(rng, structure, moving=0.8, gravity=True, duration=0.5)


@pytest.mark.parametrize("damping", [0.0, 0.8])
def test_its_order_is_four_where_strings_go_slack(damping: float) -> None:
    """As the same test of the DAE, whose tolerances are derived there."""
    scene, errors = bob(damping), {}
    for step in (0.02, 0.005):
        run = tmj.simulate(scene, None, located(step), output_interval=0.1)
        assert has_kinks(run)
        errors[step] = np.max(np.abs(run.nodes[:, 1, 0] - bob_at(run.time, damping)))
        every = tmj.simulate(scene, None, located(step), output_interval=step)  # of split steps, too
        pull = STIFFNESS * (every.nodes[:, 1, 0] - REST)
        pull = np.where(pull > 0, np.maximum(pull + damping * every.velocities[:, 1, 0], 0.0), 0.0)
        assert np.max(np.abs(every.tensions[:, 0] - pull)) < 1e-12
    assert 4**4 / 4 < errors[0.02] / errors[0.005] < 4**4 * 4
    plain = tmj.simulate(scene, None, tmj.MuJoCo(0.005), output_interval=0.1)
    assert errors[0.005] < 0.02 * np.max(np.abs(plain.nodes[:, 1, 0] - bob_at(plain.time, damping)))


@pytest.mark.parametrize("damping", [0.0, 0.8])
def test_a_mass_moves_as_the_located_dae_has_it(damping: float) -> None:
    """For one mass both integrate the same equation in the same coordinate, and find instants by the same cubics.

    Their stages round differently, by 1e-16 of 1 m; where an instant is some 1e-16 m / (1 m/s) off, all after it is
    by as much. A part ε of the step, in the choice of which they might differ by round-off, is not: that would show as
    k v ε h² / m, some 1e-8 m.
    """
    scene = bob(damping)
    ours = tmj.simulate(scene, None, located(0.005), output_interval=0.1)
    dae = tmj.DAE(method=tmj.Method.RK4, timestep=0.005, locate_slack=True)
    assert node_difference(ours, tmj.simulate(scene, None, dae, output_interval=0.1)) < 1e-9


@pytest.mark.parametrize("law", [StringLaw.CLIPPED, StringLaw.UNCLIPPED])
def test_rods_in_space_agree_with_a_tight_dae(law: StringLaw) -> None:
    """Where steps are halved the error falls by 2^4, by 2^3 at least where they are coarse; else by 2 or 4."""
    scene = random_rods(5, law=law)
    truth = tmj.simulate(scene, None, tmj.DAE(rtol=1e-11, atol=1e-13), output_interval=0.05)
    assert has_kinks(truth)

    def error(engine: tmj.MuJoCo) -> float:
        return node_difference(tmj.simulate(scene, None, engine, output_interval=0.05), truth)

    coarse, fine = error(located(0.002)), error(located(0.001))
    plain = error(tmj.MuJoCo(0.001))
    assert coarse / fine > 8
    assert fine < 0.02 * plain


def test_the_energy_ledger_closes_over_slack_events() -> None:
    """The works are integrated over the same parts of steps, see the same test of the DAE."""

    def residual(step: float, engine: Any) -> float:
        return tmj.simulate(bob(), None, engine(step)).energy_residual

    coarse, fine = residual(0.02, located), residual(0.005, located)
    assert coarse / fine > 4**4 / 4
    assert fine < 0.02 * residual(0.005, tmj.MuJoCo)


@pytest.mark.parametrize("moved", [False, True])
def test_works_of_loads_dampers_and_supports(moved: bool) -> None:
    """Each integral has the order of the motion: 4 ms split against 0.25 ms plain, and against 4 ms plain.

    A plain step over a kink errs by k v² h² / 12 or less: 6e-5 J of 4 ms, 2e-7 J of 0.25 ms, a change. The power of a
    damper has a kink where its string loses its stretch, which is not looked for, see the ledger of the DAE.
    """
    scene = bob(0.8, duration=1.0)
    if moved:
        structure = scene.structure
        rod = tmj.Rod("rod", ("held", "tip"), 0.4, support=tmj.Support.pinned(0.0))
        structure = tmj.Structure(
            "shaken",
            dict(structure.nodes) | {"held": (0.2, 0.3, 0.0), "tip": (0.2, 0.3, 0.4)},
            (rod,),
            (*structure.strings, tmj.String("tie", ("tip", "bob"), 30.0, rest_length=0.6)),
            fixed_nodes=("anchor",),
            point_masses=structure.point_masses,
        )
        motion = tmj.model.Motion.in_line("rod", 0.1, 2.0, (1.0, 0.0, 0.0))
        scene = tmj.Scene(structure, gravity=(GRAVITY, 0.0, 0.0), duration=1.0, motions=(motion,))
    else:
        scene = scene.with_(loads=(tmj.model.Load("bob", (2.0, 0.0, 0.0), angular_frequency=7.0),))
    true, split, plain = (
        tmj.simulate(scene, None, engine, output_interval=0.1)
        for engine in (tmj.MuJoCo(0.00025), located(0.004), tmj.MuJoCo(0.004))
    )
    assert has_kinks(true)
    for name in ("external_work", "dissipation"):
        reference = getattr(true, name)
        assert np.max(np.abs(reference)) > 0.01
        error = np.max(np.abs(getattr(split, name) - reference))
        assert error < 5e-5
        assert error < 0.3 * np.max(np.abs(getattr(plain, name) - reference)), name


def test_works_where_supports_of_a_loop_move() -> None:
    """What the joint that closes the loop does to the supports counts for the parts of steps, too.

    Against plain steps of 0.1 ms, which miss kinks by (1/50)² of what those of 5 ms do: both are off by what the
    loop's soft joint leaves, which a plain step of 5 ms exceeds tenfold.
    """
    scene = everything_moves(planar=True).with_(duration=0.5)
    structure = scene.structure
    rest = 0.99 * structure.string_lengths(scene.nodes0)
    scene = scene.with_(structure=structure.with_strings(rest_length=rest, damping=0.5))
    true, split, plain = (
        tmj.simulate(scene, None, engine, output_interval=0.05)
        for engine in (tmj.MuJoCo(1e-4), located(0.005), tmj.MuJoCo(0.005))
    )
    assert has_kinks(true)
    for name in ("external_work", "dissipation"):
        found, without = (np.max(np.abs(getattr(run, name) - getattr(true, name))) for run in (split, plain))
        assert found < 0.1 * without, name


@pytest.mark.parametrize(
    ("closed", "actuation"),
    [
        (False, tmj.Actuation.continuous()),
        (True, tmj.Actuation.continuous()),
        (True, tmj.Actuation.hold_force_density(0.02)),
        (True, tmj.Actuation.hold_rest_length(0.005)),
    ],
)
def test_smooth_motion_is_bit_for_bit_the_plain_one(closed: bool, actuation: tmj.Actuation) -> None:
    scene = tmj.load_scene("prism")
    law = tmj.controllers.from_scene(scene) if closed else None
    plain, split = (
        tmj.simulate(scene, law, engine, actuation=actuation, duration=0.2)
        for engine in (tmj.MuJoCo(0.005), located(0.005))
    )
    assert not has_kinks(plain)
    for name in ("nodes", "velocities", "rest_lengths", "tensions", "winch_work", "multipliers"):
        assert np.array_equal(getattr(plain, name), getattr(split, name)), name
    assert plain.cost["evaluations"] == split.cost["evaluations"]


def test_a_law_is_evaluated_once_a_stage() -> None:
    """Its answer for the end of a step serves at the start of the next."""
    scene = tmj.load_scene("pinned_rod").with_(duration=0.1)
    own = tmj.controllers.from_scene(scene)
    requested = []
    for engine in (tmj.MuJoCo(0.01), located(0.01)):
        times: list[float] = []

        def law(time: float, nodes: Any, velocities: Any, times: list[float] = times) -> Any:
            times.append(time)
            return own(time, nodes, velocities)

        tmj.simulate(scene, law, engine)
        requested.append(times)
    assert requested[0] == requested[1]


@pytest.mark.parametrize(
    "actuation",
    [tmj.Actuation.continuous(), tmj.Actuation.hold_force_density(0.01), tmj.Actuation.hold_rest_length(0.01)],
    ids=["law at every stage", "force densities held", "rest lengths held"],
)
def test_strings_that_a_law_lets_go(actuation: tmj.Actuation) -> None:
    """As the same test of the DAE. Held force densities leave an undamped string nothing to change between samples."""
    scene = tmj.load_scene("prism").with_(duration=2.0)
    law = tmj.controllers.from_scene(scene)
    reference = tmj.simulate(scene, law, tmj.DAE(rtol=1e-12, atol=1e-14), actuation=actuation, output_interval=0.01)
    assert has_kinks(reference)
    plain, split = (
        node_difference(tmj.simulate(scene, law, engine, actuation=actuation, output_interval=0.01), reference)
        for engine in (tmj.MuJoCo(0.005), located(0.005))
    )
    assert split <= plain if actuation.mode is tmj.Actuation.hold_force_density(1.0).mode else split < 0.1 * plain


def test_breaks_are_kept() -> None:
    """A string that breaks while it pulls does not pull again, at whatever length: the mass falls freely."""
    scene = bob().with_(breaks=(tmj.model.Break("string", 0.5),))
    run = tmj.simulate(scene, None, located(0.02), output_interval=0.02)
    after = run.time >= 0.5
    assert np.any(run.tensions[~after] > 0)
    assert not np.any(run.tensions[after])
    # RK4 has a constant acceleration exactly; 75 steps round at some m/s.
    assert np.allclose(np.diff(run.velocities[after, 1, 0]), GRAVITY * 0.02, atol=1e-13)


def test_the_part_of_a_step_is_a_step_of_its_length() -> None:
    """Trials start from the kept state and forces, and loads know the time within a step.

    What is kept of a split step, positions and works, is to round-off that of a plain run of one step of that length.
    """
    scene = random_rods(5)
    structure = scene.structure
    lengths = structure.string_lengths(scene.nodes0)
    rates = structure.string_rates(scene.nodes0, scene.velocities0)
    opening = int(np.argmax(rates))
    rest = np.array(structure.rest_lengths)
    rest[opening] = lengths[opening] + 0.004 * rates[opening]  # it comes taut after some 4 ms
    structure = structure.with_strings(rest_length=rest)
    loads = (tmj.model.Load("a1", (30.0, 0.0, 0.0), angular_frequency=400.0),)
    scene = scene.with_(structure=structure, loads=loads)
    law = native_law(None, structure)
    request = Request(scene, law, tmj.Actuation.continuous(), tmj.OnInfeasible.STOP, 0.01, None, False)
    run = LocatedRun(located(0.01), request)
    kept: list[tuple[float, np.ndarray, np.ndarray, np.ndarray]] = []
    search = run._try_parts

    def noted(t: float, h: float) -> None:
        search(t, h)
        kept.append((run._search["high"] * h, run.data.qpos.copy(), run.data.qvel.copy(), run.plant["work"].copy()))

    run._try_parts = noted  # type: ignore[method-assign]
    run.run()
    ((step, qpos, qvel, work),) = kept
    assert 0.001 < step < 0.009
    plain = MuJoCoRun(tmj.MuJoCo(step), replace(request, duration=step))
    plain.run()
    assert np.max(np.abs(qpos - plain.data.qpos)) < 1e-14
    assert np.max(np.abs(work)) > 1e-3
    assert np.max(np.abs(work - plain.plant["work"])) < 1e-14
    assert run.model.opt.timestep == 0.01
    assert run.data.time == 0.01
    # And so is the rest of it, from there: a load that is later by the part.
    later = scene.with_(loads=tuple(replace(load, phase=400.0 * step) for load in loads))
    left = 0.01 - step
    rest_of_it = MuJoCoRun(tmj.MuJoCo(left), replace(request, scene=later, duration=left))
    rest_of_it.data.qpos[:], rest_of_it.data.qvel[:] = qpos, qvel
    rest_of_it.run()
    assert np.max(np.abs(run.data.qpos - rest_of_it.data.qpos)) < 1e-14
    assert np.max(np.abs(run.data.qvel - rest_of_it.data.qvel)) < 1e-12
    both = work + rest_of_it.plant["work"]
    assert np.max(np.abs(run.plant["work"] - both)) < 1e-14


def test_a_search_that_finds_nothing_leaves_the_step_as_it_was() -> None:
    # Without dampers: strings whose force would jump stay as they are until they are let change.
    scene = random_rods(5).with_(duration=0.1)
    scene = scene.with_(structure=scene.structure.with_strings(damping=0.0))
    law = native_law(None, scene.structure)
    request = Request(scene, law, tmj.Actuation.continuous(), tmj.OnInfeasible.STOP, 0.1, None, False)
    run = LocatedRun(located(0.01), request)
    search, searched = run._try_parts, []

    def in_vain(t: float, h: float) -> None:
        search(t, h)
        searched.append(run._search["tried"])
        run._search["tried"] = 0

    run._try_parts = in_vain  # type: ignore[method-assign]
    found, plain = run.run(), MuJoCoRun(tmj.MuJoCo(0.01), request).run()
    assert any(searched)
    for name in ("nodes", "velocities", "tensions", "multipliers", "external_work", "dissipation"):
        assert np.array_equal(getattr(found, name), getattr(plain, name)), name
    assert found.cost["evaluations"] > plain.cost["evaluations"]


def test_the_accuracy_uses_it_and_reports_so() -> None:
    scene = bob(0.8)
    run = tmj.simulate(scene, None, tmj.MuJoCo(accuracy=1e-7))
    chosen = run.reports["accuracy"]["chosen"]
    assert chosen["method"] == "rk4"
    assert chosen["locate_slack"] is True
    assert np.max(np.abs(run.nodes[:, 1, 0] - bob_at(run.time, 0.8))) <= 1e-7
    same = tmj.simulate(scene, None, located(chosen["timestep"]), output_interval=float(run.time[1]))
    assert np.array_equal(same.nodes, run.nodes)
    # Errors fall by an order of 3 at least: without splits it would be 1.
    finer = tmj.simulate(scene, None, located(chosen["timestep"] / 2), output_interval=float(run.time[1]))
    before, last = (np.max(np.abs(one.nodes[:, 1, 0] - bob_at(one.time, 0.8))) for one in (run, finer))
    assert last < before / 2**3
    assert same.provenance["engine"]["locate_slack"] is True
    assert "slack located" in str(located(0.01))


def test_a_law_that_fails_in_a_search_stops_the_run() -> None:
    """With the rows that there were: none of a part of a step."""
    scene = tmj.load_scene("prism").with_(duration=2.0)
    own = tmj.controllers.from_scene(scene)
    whole = tmj.simulate(scene, own, located(0.005), output_interval=0.005)
    pulls = whole.tensions > 0
    first = int(np.argmax((pulls[1:] != pulls[:-1]).any(axis=1)))  # its step has the first change
    after = float(whole.time[first])
    calls = {"count": 0}

    def law(time: float, nodes: Any, velocities: Any) -> Any:
        if time > after + 1e-9:
            calls["count"] += 1
            if calls["count"] > 4:  # three stages, and the end
                raise RuntimeError("no more")
        return own(time, nodes, velocities)

    with pytest.raises(tmj.errors.ControllerError, match="no more"):
        tmj.simulate(scene, law, located(0.005), output_interval=0.005)


def test_a_law_that_fails_where_a_part_begins_has_no_row_there() -> None:
    scene = tmj.load_scene("prism").with_(duration=2.0)
    own = tmj.controllers.from_scene(scene)
    runs: list[LocatedRun] = []

    def law(time: float, nodes: Any, velocities: Any) -> Any:
        plant, counters = runs[0].plant, runs[0].counters
        if plant["part"] and counters[STAGE] == 0 and counters[STEP] == round(time / 0.005 - 0.5):
            raise RuntimeError("no more")
        return own(time, nodes, velocities)

    native = native_law(law, scene.structure)
    request = Request(scene, native, tmj.Actuation.continuous(), tmj.OnInfeasible.STOP, 2.0, None, False)
    runs.append(LocatedRun(located(0.005), request))
    with pytest.raises(tmj.errors.ControllerError, match="no more"):
        runs[0].run()
    assert runs[0].counters[STEP] > 0
    assert np.array_equal(runs[0].times, runs[0].grid.times)


def test_it_belongs_to_rk4_without_contact_and_to_single_runs() -> None:
    for integrator in (tmj.Integrator.EULER, tmj.Integrator.DISCRETE):
        with pytest.raises(tmj.errors.OptionError, match=f"locate_slack = True with {integrator.name}"):
            tmj.MuJoCo(1e-3, integrator, locate_slack=True)
    with pytest.raises(tmj.errors.OptionError, match="locate_slack = 'yes'"):
        tmj.MuJoCo(1e-3, locate_slack="yes")  # type: ignore[arg-type]
    with pytest.raises(tmj.errors.OptionError, match="locate_slack = True with accuracy"):
        tmj.MuJoCo(accuracy=1e-3, locate_slack=True)
    with pytest.raises(tmj.errors.OptionError, match="MuJoCo with locate_slack = True: scene 'prism_drop' has contact"):
        tmj.simulate(tmj.load_scene("prism_drop"), None, located(1e-3), duration=0.01)
    with pytest.raises(tmj.errors.OptionError, match="simulate_many: locate_slack"):
        tmj.simulate_many([bob()], None, located(1e-3))
    scene = tmj.load_scene("prism")
    with (
        pytest.raises(tmj.errors.OptionError, match="law_in: locate_slack"),
        tmj.law_in(scene, tmj.controllers.from_scene(scene), located(1e-3)),
    ):
        pass


def test_the_command_line_has_it(capsys: pytest.CaptureFixture[str]) -> None:
    for engine in ("mujoco", "dae --method rk4", "ode --method rk4"):
        arguments = f"run tbar --engine {engine} --timestep 0.01 --locate-slack --duration 0.05 --json"
        assert main(arguments.split()) == 0
        assert "slack located" in json.loads(capsys.readouterr().out)["engine"]
    for arguments in (
        "--integrator euler --locate-slack",
        "--engine dae --locate-slack",
        "--accuracy 1e-3 --locate-slack",
    ):
        assert main(["run", "tbar", *arguments.split()]) == 2
        assert "locate" in capsys.readouterr().err
