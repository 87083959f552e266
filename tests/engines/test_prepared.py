"""What is remembered of a scene between runs changes nothing of them."""

from __future__ import annotations

import warnings
from contextlib import suppress
from dataclasses import replace
from typing import Any

import mujoco
import numpy as np
import pytest

import tensegrity_mj as tmj
from tensegrity_mj.dynamics import records
from tensegrity_mj.dynamics.native.law import Law
from tensegrity_mj.dynamics.native.plant import Plant
from tensegrity_mj.engines.mujoco import prepared as preparing
from tensegrity_mj.engines.mujoco.contact import hold_spins
from tensegrity_mj.engines.mujoco.mjcf import scene_to_mjcf
from tensegrity_mj.engines.mujoco.prepared import prepared
from tensegrity_mj.engines.reference.dae import Solver
from tensegrity_mj.engines.request import request_for
from tensegrity_mj.errors import DivergenceError, StabilityWarning
from tensegrity_mj.model import Contact, Motion, scene_checks
from tensegrity_mj.model.actuation import Actuation, OnInfeasible
from tensegrity_mj.model.members import PointMass, Support
from tensegrity_mj.model.strings import StringLaw
from tensegrity_mj.model.text.sources import scene_names
from tensegrity_mj.vibration import step_warnings


def test_a_model_is_the_callers_own() -> None:
    scene, engine = tmj.load_scene("prism"), tmj.MuJoCo(1e-3)
    model = engine.model(scene)
    model.opt.gravity[:] = -5.0
    model.actuator_gainprm[:] = 0.0
    again = engine.model(scene)
    assert not again.opt.gravity.any()
    assert again.actuator_gainprm.any()


def test_steps_and_integrators_have_models_of_their_own() -> None:
    scene = tmj.load_scene("prism")
    for step, integrator in ((1e-3, tmj.Integrator.RK4), (2e-3, tmj.Integrator.RK4), (1e-3, tmj.Integrator.EULER)):
        engine = tmj.MuJoCo(step, integrator)
        fresh = prepared(tmj.load_scene("prism"), step, engine.word).model
        for model in (engine.model(scene), engine.model(scene)):
            assert model.opt.timestep == step
            assert model.opt.integrator == fresh.opt.integrator


def bits(model: mujoco.MjModel) -> bytes:
    """All of a model, as MuJoCo saves it."""
    buffer = np.zeros(mujoco.mj_sizeModel(model), np.uint8)
    mujoco.mj_saveModel(model, None, buffer)
    return buffer.tobytes()


def compiled(scene: tmj.Scene, engine: tmj.MuJoCo) -> mujoco.MjModel:
    """The model of a scene's own text, whose rods contact may hold."""
    model = mujoco.MjModel.from_xml_string(scene_to_mjcf(scene, engine.timestep, engine.word))
    hold_spins(model, scene)
    return model


def with_other_strings(scene: tmj.Scene, law: StringLaw) -> tmj.Scene:
    """The scene with other stiffnesses, dampings (every other string's is zero) and rest lengths."""
    structure, part = scene.structure, 1.0 + 0.1 * np.arange(len(scene.structure.strings))
    damping = np.where(np.arange(len(part)) % 2, 0.01 * structure.stiffness, 0.0)
    changed = structure.with_strings(
        stiffness=part * structure.stiffness, damping=damping, rest_length=structure.rest_lengths / part
    )
    return scene.with_(structure=replace(changed, string_law=law))


@pytest.fixture
def compilations(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Names of the scenes that MuJoCo compiles from now on, with no layout known before."""
    made: list[str] = []

    def counted(scene: tmj.Scene) -> str:
        made.append(scene.name)
        return scene_to_mjcf(scene)

    monkeypatch.setattr(preparing, "_layouts", {})
    monkeypatch.setattr(preparing.mjcf, "scene_to_mjcf", counted)
    return made


# A constant force has no rest length; a string with mass whose parts change one by one is none any more, and its points
# do not start with the support that moves.
@pytest.mark.parametrize("name", [name for name in scene_names() if name not in ("arrester", "massive_string")])
def test_numbers_of_strings_are_set_as_the_compiler_sets_them(name: str, compilations: list[str]) -> None:
    scene = tmj.load_scene(name)
    first = scene_names().index(name)  # each integrator with each law, over the scenes
    steps, integrators = (1e-3, 3e-4, 2e-3, 1e-4, 5e-3), list(tmj.Integrator)
    for k, one in enumerate((scene, *(with_other_strings(scene, law) for law in StringLaw)), first):
        engine = tmj.MuJoCo(steps[k % 5], integrators[k % 5])
        assert bits(engine.model(one)) == bits(compiled(one, engine))
    assert compilations == [scene.name]


def test_what_else_a_model_depends_on_is_compiled_anew(compilations: list[str]) -> None:
    scene, engine = tmj.load_scene("pinned_rod"), tmj.MuJoCo(1e-3)
    structure = scene.structure
    rod, string = structure.rods[0], structure.strings[0]
    free = replace(structure, rods=(replace(rod, support=Support.free()), *structure.rods[1:]))
    still = scene.with_(structure=free, target=None, control=None)
    moved = np.zeros_like(scene.nodes0)
    moved[structure.rod_nodes[0]] = 0.1
    longer = tuple(np.array(structure.nodes["n1"]) * (1 + 1e-10))
    heavy = replace(structure, nodes={**structure.nodes, "p": (2.0, 2.0, 2.0)}, point_masses=(PointMass("p", 1.0),))
    changes: list[tmj.Scene] = [
        scene.with_(name="another"),
        scene.with_(gravity=(0.0, 0.0, -1.0)),
        scene.with_(contact=Contact(floor=-10.0)),
        scene.with_(motions=(Motion.data(rod.name, (0.0, 1.0), ((0.0, 0.0, 0.0), (0.1, 0.0, 0.0))),)),  # from rest
        still,
        still.with_(initial_nodes=scene.nodes0 + moved),
        still.with_(initial_velocities=moved),
        # Of another length, within what may be: the start is where it was.
        still.with_(structure=replace(free, nodes={**structure.nodes, "n1": longer}), initial_nodes=scene.nodes0),
        scene.with_(structure=replace(structure, rods=(replace(rod, mass=2 * rod.mass), *structure.rods[1:]))),
        scene.with_(structure=replace(structure, rods=(replace(rod, radius=2 * rod.radius), *structure.rods[1:]))),
        still.with_(structure=replace(free, nodes={**structure.nodes, "n2": (1.3, 0.0, 0.0)})),
        still.with_(structure=heavy),
        still.with_(structure=replace(heavy, point_masses=(PointMass("p", 2.0),))),
        scene.with_(structure=replace(structure, strings=(replace(string, name="S"), *structure.strings[1:]))),
        scene.with_(
            structure=replace(structure, strings=(replace(string, nodes=string.nodes[::-1]), *structure.strings[1:]))
        ),
    ]
    for number, one in enumerate(changes, start=1):
        engine.model(scene)
        engine.model(scene.with_(duration=1.0 + number))  # of the same layout
        assert bits(engine.model(one)) == bits(compiled(one, engine)), number
        assert len(compilations) == number + 1


@pytest.mark.parametrize("name", ["prism", "truss_arm", "tower_waves"])
def test_a_second_run_of_a_scene_is_the_first_one_bit_for_bit(name: str) -> None:
    """Limits of forces, which a run moves where strings are damped, and the data of contacts and motions included."""
    scene, fresh = tmj.load_scene(name), tmj.load_scene(name)
    scene, fresh = (
        one.with_(structure=replace(one.structure, string_law=StringLaw.UNCLIPPED), breaks=()) for one in (scene, fresh)
    )
    engine = tmj.MuJoCo(1e-3)
    tmj.simulate(scene, None, engine, duration=0.05)
    second, first = (tmj.simulate(one, None, engine, duration=0.1) for one in (scene, fresh))
    assert np.array_equal(second.nodes, first.nodes)
    assert np.array_equal(second.tensions, first.tensions)


def report_of(scene: tmj.Scene, law: Law | None, engine: tmj.MuJoCo) -> dict[str, Any]:
    """What the check before a run found, whatever became of the run."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", StabilityWarning)
        try:
            run: Any = tmj.simulate(scene, law, engine, duration=engine.timestep)
        except DivergenceError as error:
            run = error.trajectory
    report: dict[str, Any] = run.reports["stability"]
    return report


def test_the_check_before_a_run_knows_laws_and_engines_apart() -> None:
    scene = tmj.load_scene("prism")
    slow, fast = (tmj.controllers.Lyapunov(scene.structure, scene.target, decay_rate=rate) for rate in (1.0, 500.0))
    short, long = tmj.MuJoCo(0.0001, tmj.Integrator.EULER), tmj.MuJoCo(0.01, tmj.Integrator.EULER)
    requested = [(slow, long), (fast, long), (fast, short), (slow, long), (fast, long)]
    found = [report_of(scene, law, engine) for law, engine in requested]
    # Euler's limit is below 2/δ, 0.004 s for δ = 500/s, and above 0.01 s for 1/s, where the strings' own is 0.3 s.
    assert [one["exceeded"] for one in found] == [False, True, False, False, True]
    assert found[1] == found[4]
    found[4]["notes"].append("a remark of somebody's")
    assert report_of(scene, fast, long) == found[1]  # reports are copies


PACKING = {
    "MuJoCo": tmj.MuJoCo(1e-3),
    "MuJoCo, located": tmj.MuJoCo(1e-3, locate_slack=True),
    "MuJoCo, Euler": tmj.MuJoCo(1e-3, tmj.Integrator.EULER),
    "DAE": tmj.DAE(method=tmj.Method.RK4, timestep=1e-3),
    "DAE, full": tmj.DAE(method=tmj.Method.RK4, timestep=1e-3, solver=Solver.FULL),
    "DAE, adaptive": tmj.DAE(),
    "ODE": tmj.ODE(method=tmj.Method.RK4, timestep=1e-3),
}


@pytest.mark.parametrize("engine", PACKING.values(), ids=PACKING)
def test_one_plant_is_packed_a_run_and_the_check_of_the_step_leaves_it_as_it_was(
    engine: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its law is evaluated by the check in a continuous loop and for what winches hold, and no bit of the run moves."""
    scene = tmj.load_scene("prism").with_(duration=5e-3)
    packed, pack = [], Plant.__init__

    def count(self: Plant, *given: Any) -> None:
        packed.append(self)
        pack(self, *given)

    monkeypatch.setattr(Plant, "__init__", count)
    for actuation in (Actuation.continuous(), Actuation.hold_force_density(1e-3)):
        law = tmj.controllers.from_scene(scene)
        run = tmj.simulate(scene, law, engine, actuation=actuation)
        assert len(packed) == 1
        if engine.stepping.scheme is not None:
            assert run.reports["stability"]["checked"]
        bare = engine.run(request_for(scene, law, None, actuation, OnInfeasible.STOP, None, False))
        packed.clear()
        for name in ("nodes", "velocities", "rest_lengths", "tensions", "lyapunov", "winch_work"):
            assert np.array_equal(getattr(run, name), getattr(bare, name)), name


def test_the_warning_comes_each_time() -> None:
    scene = tmj.load_scene("prism")
    law = tmj.controllers.Lyapunov(scene.structure, scene.target, decay_rate=500.0)
    for _ in range(2):
        with pytest.warns(StabilityWarning, match="beyond the largest stable one"), suppress(DivergenceError):
            tmj.simulate(scene, law, tmj.MuJoCo(0.01, tmj.Integrator.EULER), duration=0.01)


def test_the_check_is_made_once_for_what_stays_and_each_time_for_what_may_change(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    made = []

    def count(*arguments: Any) -> tuple[dict[str, Any], str]:
        made.append(arguments)
        return {}, ""

    monkeypatch.setattr(step_warnings, "_before_run", count)
    scene = tmj.load_scene("prism")
    law = tmj.controllers.Lyapunov(scene.structure, scene.target)
    for _ in range(3):
        for step in (1e-3, 2e-3):
            tmj.simulate(scene, law, tmj.MuJoCo(step), duration=2e-3)
    assert len(made) == 2
    loaded = scene.with_(loads=lambda time: np.zeros((len(scene.structure.nodes), 3)))
    for _ in range(3):
        tmj.simulate(loaded, law, tmj.MuJoCo(1e-3), duration=2e-3)
    assert len(made) == 5


def test_a_run_gives_its_model_and_data_to_the_next_one_of_the_layout() -> None:
    scene, engine = tmj.load_scene("prism"), tmj.MuJoCo(1e-3)
    first = tmj.simulate(scene, None, engine, duration=0.05)
    lent = preparing._spare["last"]
    assert engine.model(scene) is not lent.model
    other = with_other_strings(scene, StringLaw.UNCLIPPED)
    changed = tmj.simulate(other, None, tmj.MuJoCo(5e-4, tmj.Integrator.EULER), duration=0.02)
    assert preparing._spare["last"] is lent
    again = tmj.simulate(scene, None, engine, duration=0.05)
    assert np.array_equal(first.nodes, again.nodes)
    assert not np.array_equal(first.nodes[-1], changed.nodes[-1])
    tmj.simulate(tmj.load_scene("pinned_rod"), None, engine, duration=0.01)
    assert preparing._spare["last"] is not lent


@pytest.mark.parametrize("engine", [tmj.MuJoCo(1e-3), tmj.DAE(method="rk4", timestep=1e-3)], ids=str)
def test_a_run_of_a_fresh_scene_makes_no_part_twice(engine: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    made: dict[str, int] = {"rod_records": 0, "_deviations": 0}

    def counted(module: Any, name: str) -> None:
        of_module = getattr(module, name)

        def count(*arguments: Any) -> Any:
            made[name] += 1
            return of_module(*arguments)

        monkeypatch.setattr(module, name, count)

    scene = tmj.load_scene("prism")
    counted(records, "rod_records")
    counted(scene_checks, "_deviations")
    tmj.simulate(scene, engine=engine, duration=2e-3)
    # Law and engine share the records; the scene has checked its start and its target, and reference nodes fit anyway.
    assert made == {"rod_records": 1, "_deviations": 0}
