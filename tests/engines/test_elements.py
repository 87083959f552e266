"""Elements: the one interface of what acts on nodes, with those of the package and the tests' own.

A spring to the ground (`ground_spring`), a magnet and a brake take ten lines each; the package knows nothing of them.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
from compiled_spring import CompiledSpring
from ground_spring import GroundSpring, tethered
from linked_scenes import hanging_chain
from soft_scenes import soft_pair

import tensegrity_mj as tmj
from tensegrity_mj.basics import fields
from tensegrity_mj.model import Element, Work, register
from tensegrity_mj.studies.parameter_values import Scaled, Vary
from tensegrity_mj.studies.scene_parameters import changed_scene
from tensegrity_mj.studies.sweep import Sweep
from tensegrity_mj.studies.workers import Backend, Workers


@dataclass(frozen=True)
class Magnet(Element):
    """A magnet at a place, which pulls a node by m / r⁴, or pushes it where m < 0; energy -m / (3 r³)."""

    node: str
    moment: float
    place: tuple[float, float, float]
    work = Work.STORED

    def act(self, scene: Any, time: float, nodes: Any, velocities: Any) -> Any:
        forces, row = np.zeros_like(nodes), scene.structure.node_index[self.node]
        span = np.array(self.place) - nodes[row]
        forces[row] = self.moment * span / np.linalg.norm(span) ** 5
        return forces

    def energy(self, scene: Any, nodes: Any) -> float:
        span = np.array(self.place) - nodes[scene.structure.node_index[self.node]]
        return -self.moment / (3 * float(np.linalg.norm(span)) ** 3)


@dataclass(frozen=True)
class Brake(Element):
    """A damper on every node, in a wind."""

    damping: float
    wind: float = 0.0
    work = Work.LOST

    def act(self, scene: Any, time: float, nodes: Any, velocities: Any) -> Any:
        return -self.damping * (velocities - np.array([self.wind, 0.0, 0.0]))

    def given(self, scene: Any, time: float, nodes: Any, velocities: Any) -> float:
        return float(self.act(scene, time, nodes, velocities)[:, 0].sum()) * self.wind


OWN = (GroundSpring("a", 12.0, (0.1, -0.2, 0.3)), Magnet("b", -0.02, (0.9, 0.7, 0.1)), Brake(0.05, 0.3))
COMPILED = (CompiledSpring("a", 12.0, (0.1, -0.2, 0.3)), *OWN[1:])  # the spring of OWN by a compiled function
ENGINES = {
    "mujoco": tmj.MuJoCo(1e-3),
    "dae": tmj.DAE(rtol=1e-11, atol=1e-13),
    "ode": tmj.ODE(rtol=1e-11, atol=1e-13),
}


@pytest.mark.parametrize("name", ENGINES)
def test_elements_of_ones_own_run_in_every_engine_and_their_ledger_closes(name: str) -> None:
    scene = tethered(OWN, gravity=(0.0, 0.0, -2.0))
    run = tmj.simulate(scene, engine=ENGINES[name], duration=0.8)
    # Of RK4 at 1 ms with rates below 20 /s: (r h)^4 r T / 120 = 2e-8 of energies of a joule at most.
    assert run.energy_residual < 2e-8
    assert np.ptp(run.element_energy) > 1e-2
    assert abs(run.external_work[-1]) > 1e-3
    assert run.dissipation[-1] > 1e-3
    reference = tmj.simulate(scene, engine=ENGINES["dae"], duration=0.8)
    assert tmj.compare(run, reference).max_node_error < 2e-8
    without = tmj.simulate(scene.with_(elements=()), engine=ENGINES["dae"], duration=0.8)
    assert tmj.compare(run, without).max_node_error > 1e-2
    # λ of the rod, where MuJoCo finds it from recorded states and the others from their equations.
    assert np.abs(run.multipliers - reference.multipliers).max() < 1e-6 * np.abs(reference.multipliers).max()


@pytest.mark.parametrize("name", ENGINES)
def test_an_element_with_a_compiled_function_is_the_one_in_python(name: str) -> None:
    CompiledSpring.packed.clear()
    runs = [tmj.simulate(tethered(elements), engine=ENGINES[name], duration=0.4) for elements in (COMPILED, OWN)]
    assert CompiledSpring.packed
    assert set(CompiledSpring.packed) == {COMPILED[0]}
    # The same formula, maybe with fused products: 2e-16 of 12 N/m and 0.5 m a stage, and an error-controlled method may
    # then take other steps within its tolerance of 1e-11.
    assert tmj.compare(*runs).max_node_error < 1e-10
    assert np.abs(runs[0].element_energy - runs[1].element_energy).max() < 1e-9
    without = tmj.simulate(tethered(OWN[1:]), engine=ENGINES[name], duration=0.4)
    assert tmj.compare(runs[0], without).max_node_error > 1e-2


def test_a_value_class_is_checked_as_an_element() -> None:
    with pytest.raises(tmj.errors.SceneError, match=r"CompiledSpring: stiffness = -1.0.*> 0 N/m"):
        CompiledSpring("a", -1.0)


def test_what_an_element_refuses_of_a_scene_is_refused_with_the_scene() -> None:
    class Tall(GroundSpring):
        def check(self, scene: tmj.Scene) -> None:
            if len(scene.structure.strings) < 3:
                raise tmj.errors.SceneError("a spring like this needs three strings")

    with pytest.raises(tmj.errors.SceneError, match="needs three strings"):
        tethered((Tall("a", 1.0),))


def oscillator(**scene: Any) -> tmj.Scene:
    """A rod of 2 kg pulled at both ends by springs of no length: its centre is an oscillator of ω² = 2 k / m = 9."""
    nodes = {"a": (0.2, -0.5, 0.0), "b": (0.2, 0.5, 0.0)}
    structure = tmj.Structure("rod", nodes, (tmj.Rod("r", ("a", "b"), 2.0),))
    springs = (GroundSpring("a", 9.0, (0.0, -0.5, 0.0)), GroundSpring("b", 9.0, (0.0, 0.5, 0.0)))
    return tmj.Scene(structure, elements=springs, **scene)


def test_a_spring_to_the_ground_moves_a_mass_as_an_oscillator() -> None:
    for engine in ENGINES.values():
        run = tmj.simulate(oscillator(), engine=engine, duration=2.0)
        # (ω h)^4 ω T / 120 of RK4 at 1 ms, ω = 3: 4e-12 of 0.2 m; the DAE's and the ODE's tolerance grows to 1e-10.
        assert np.abs(run.nodes[:, :, 0] - 0.2 * np.cos(3 * run.time)[:, None]).max() < 1e-10


@pytest.mark.parametrize("integrator", [tmj.Integrator.EULER, tmj.Integrator.IMPLICIT])
def test_an_integrator_of_one_stage_counts_the_work_of_forces_held_over_a_step(integrator: tmj.Integrator) -> None:
    # The brake's loss and the wind's work, each of a force held over a step and the mean of the speeds at its ends, are
    # exactly what the motion loses: with springs and strings left out, the balance closes to round-off at any step.
    nodes = {"a": (0.0, 0.0, 0.0), "b": (0.8, 0.1, 0.2)}
    structure = tmj.Structure("rod", nodes, (tmj.Rod("r", ("a", "b"), 0.7),))
    scene = tmj.Scene(structure, initial_velocities=np.tile([0.1, 0.4, -0.2], (2, 1)), elements=(Brake(0.5, 0.3),))
    run = tmj.simulate(scene, engine=tmj.MuJoCo(0.02, integrator), duration=1.0)
    assert run.energy_residual < 1e-15
    assert run.dissipation[-1] > 1e-2


def waved(**changes: Any) -> tmj.Scene:
    """A rod that floats in waves and wind, tied to a place, with the test's own elements."""
    nodes = {"a": (0.0, 0.0, 0.2), "b": (1.0, 0.3, -0.9), "p": (-0.6, 0.0, 0.4)}
    string = tmj.String("s", ("p", "a"), 400.0, 0.0, 0.5)
    structure = tmj.Structure("waved", nodes, (tmj.Rod("r", ("a", "b"), 30.0, radius=0.1),), (string,), ("p",))
    given: dict[str, Any] = {
        "gravity": (0.0, 0.0, -9.81),
        "water": tmj.Water(
            waves=(tmj.model.Wave(0.1, 3.0), tmj.model.Wave(0.05, 1.0, direction=1.0)), current=(0.2, 0.0, 0.0)
        ),
        "resistance": tmj.model.Resistance(2.0, None, tmj.model.Drag(1.0, 0.1), (1.0, 0.5, 0.0)),
        "loads": (tmj.model.Load("b", (3.0, 0.0, 1.0), 4.0),),
        "elements": (GroundSpring("b", 12.0, (0.9, -0.2, 0.3)),),
    }
    return tmj.Scene(structure, **(given | changes))


@pytest.mark.third_means("elements.lend_room", by="runs of `simulate`, whose elements have no lent room")
def test_a_law_in_mujocos_own_loops_has_the_same_water_and_wind() -> None:
    scene, engine = waved(), tmj.MuJoCo(1e-3)

    def law(time: float, nodes: Any, velocities: Any) -> Any:
        return np.array([5.0 + time])

    alone = tmj.simulate(scene, law, engine, duration=0.2)
    with tmj.law_in(scene, law, engine) as model:
        data = mujoco.MjData(model)
        mujoco.mj_step(model, data, 200)
    mujoco.mj_kinematics(model, data)
    sites = [model.site(name).id for name in scene.structure.nodes]
    # The same compiled code, at times that MjData.time adds up where `simulate` multiplies: 200 times 1e-17 s.
    assert np.abs(data.site_xpos[sites] - alone.nodes[-1]).max() < 1e-13
    still = tmj.simulate(waved(water=None), law, engine, duration=0.2)
    assert tmj.compare(alone, still).max_node_error > 1e-3


def test_many_simulations_at_once_have_the_water_of_single_ones() -> None:
    calm = waved(water=tmj.Water())
    scenes, engine = [waved(), calm, waved(elements=())], tmj.MuJoCo(1e-3)
    together = tmj.simulate_many(scenes, None, engine, duration=0.2, threads=2)
    for found, scene in zip(together, scenes, strict=True):
        alone = tmj.simulate(scene, None, engine, duration=0.2)
        assert np.array_equal(found.nodes, alone.nodes)
        assert np.array_equal(found.external_work, alone.external_work)
        assert np.array_equal(found.dissipation, alone.dissipation)


def scenes_with_energy() -> list[tuple[str, tmj.Scene]]:
    bent = tmj.model.Resistance(bending=tmj.model.Bending(3.0, 0.1))
    chain = hanging_chain([0.3, 0.5, 0.4], [1.0, 1.0, 1.0]).with_(resistance=bent)
    return [("bent", chain), ("elastic rods", soft_pair()), ("own", tethered(OWN)), ("compiled", tethered(COMPILED))]


@pytest.mark.parametrize(("name", "scene"), scenes_with_energy())
def test_the_force_of_every_element_is_the_gradient_of_its_energy(name: str, scene: tmj.Scene) -> None:
    rng, h = np.random.default_rng(7), 1e-5
    nodes = scene.nodes0 + 0.01 * rng.normal(size=scene.nodes0.shape)
    stored = [element for element in scene.effects if element.work is Work.STORED]
    assert stored
    for element in stored:
        forces = element.act(scene, 0.0, nodes, np.zeros_like(nodes))
        for _ in range(3):
            way = rng.normal(size=nodes.shape)
            change = float(element.energy(scene, nodes + h * way) - element.energy(scene, nodes - h * way)) / (2 * h)
            # Differences leave out h² of a third derivative and 2e-16 / h of the energy, which is below 10 J and 1 m.
            scale = float(np.linalg.norm(forces) * np.linalg.norm(way)) + abs(float(element.energy(scene, nodes)))
            assert abs(change + float(np.sum(forces * way))) < 1e-6 * scale


def test_linear_models_of_all_engines_have_ones_own_elements() -> None:
    scene = tethered(OWN, gravity=(0.0, 0.0, -2.0))
    models = [tmj.linearize(scene, engine) for engine in ENGINES.values()]
    without = tmj.linearize(scene.with_(elements=()), ENGINES["dae"])
    scale = np.abs(models[1].A).max()
    for model in models:
        # Narrow differences, as a magnet is not known to be smooth: round-off of 4e-12 of k and 1e-10 s of a, h² less.
        assert np.abs(model.A - models[1].A).max() < 1e-8 * scale
        assert np.abs(model.A - without.A).max() > 1e-2 * scale


def test_a_linear_model_has_the_frequency_of_springs_to_the_ground() -> None:
    scene = oscillator()
    for engine in ENGINES.values():
        values = np.linalg.eigvals(tmj.linearize(scene, engine).A)
        # The centre moves with ω² = 2 k / m in three directions; the rod turns with k ℓ²/2 over m ℓ²/12 in two.
        found = np.sort(values.imag[values.imag > 0])
        assert found == pytest.approx(np.sort([3.0] * 3 + [np.sqrt(6 * 9.0 / 2.0)] * 2), abs=1e-9)


def test_the_largest_stable_step_is_that_of_springs_to_the_ground() -> None:
    # RK4 is stable up to 2 √2 / ω (its limit on the imaginary axis), ω² = 6 k / m of the turning rod.
    found = tmj.stable_step(oscillator(), tmj.DAE(method=tmj.Method.RK4, timestep=1e-3))
    assert found.limit == pytest.approx(2 * np.sqrt(2) / np.sqrt(27.0), rel=1e-8)


def test_statics_finds_where_springs_to_the_ground_hold_a_weight() -> None:
    # Each spring carries half the weight: both ends sink by m g / (2 k) = 2 · 3 / 18.
    scene = oscillator(gravity=(0.0, 0.0, -3.0))
    state = tmj.statics.find_equilibrium(scene)
    assert state.nodes - scene.nodes0 == pytest.approx(np.tile([-0.2, 0.0, -6.0 / 18.0], (2, 1)), abs=1e-12)
    for engine in ENGINES.values():
        assert tmj.statics.engine_equilibrium(scene, engine).nodes == pytest.approx(state.nodes, abs=1e-9)


def test_linear_models_in_waves_and_wind_are_those_of_both_engines() -> None:
    scene = waved()
    reference = tmj.linearize(scene, ENGINES["dae"], time=0.3)
    found = tmj.linearize(scene, ENGINES["mujoco"], time=0.3)
    # As above; of k = 400 N/m on a rod of 30 kg.
    assert np.abs(found.A - reference.A).max() < 1e-8 * np.abs(reference.A).max()
    dry = tmj.linearize(scene.with_(water=None), ENGINES["dae"], time=0.3)
    assert np.abs(reference.A - dry.A).max() > 1e-2 * np.abs(dry.A).max()


def test_engines_find_where_a_rod_floats() -> None:
    # A level rod half under water displaces half of its volume: m = ρ π r² ℓ / 2. Springs keep it from drifting.
    length = np.hypot(1.0, 0.01)
    mass = 1000.0 * np.pi * 0.1**2 / 2 * length
    nodes = {"a": (0.0, 0.0, 0.05), "b": (1.0, 0.0, 0.06)}
    structure = tmj.Structure("level", nodes, (tmj.Rod("r", ("a", "b"), mass, radius=0.1),))
    springs = (GroundSpring("a", 5.0), GroundSpring("b", 5.0, (1.0, 0.0, 0.0)))
    scene = tmj.Scene(structure, gravity=(0.0, 0.0, -9.81), water=tmj.Water(density=1000.0), elements=springs)
    for engine in (ENGINES["dae"], ENGINES["mujoco"]):
        found = tmj.statics.engine_equilibrium(scene, engine)
        assert found.nodes == pytest.approx(np.array([[0.5 - length / 2, 0, 0], [0.5 + length / 2, 0, 0]]), abs=1e-7)


@pytest.fixture
def known(monkeypatch: pytest.MonkeyPatch) -> None:
    """The test's elements, by names for files."""
    monkeypatch.setattr(fields, "_KINDS", dict(fields._KINDS))
    kinds = {"ground-spring": GroundSpring, "magnet": Magnet, "brake": Brake, "compiled": CompiledSpring}
    for name, kind in kinds.items():
        register(name, kind)


def test_files_hold_elements_by_the_names_that_a_call_has_given_them(known: None, tmp_path: Path) -> None:
    scene = tethered(OWN)
    path = tmp_path / "tethered.toml"
    tmj.save_scene(scene, path)
    text = path.read_text()
    assert "elements" in text
    assert 'kind = "ground-spring"' in text
    assert tmj.load_scene(path) == scene
    tmj.save_scene(tethered(COMPILED), path)
    assert tmj.load_scene(path) == tethered(COMPILED)
    run = tmj.simulate(scene, engine=ENGINES["dae"], duration=0.1)
    again = tmj.Trajectory.load(run.save(tmp_path / "run.nc"))
    assert np.array_equal(again.element_energy, run.element_energy)
    for wrong, message in (
        (text.replace('"magnet"', '"magnt"'), r"elements\[1\].* kind = 'magnt' .*it must be .*\"magnet\""),
        (text.replace("moment", "monent"), "unknown key 'monent'"),
        (text.replace("moment = -0.02", 'moment = "strong"'), "it must be a number"),
        (text.replace('"magnet"', "magnet"), "TOML"),
    ):
        assert wrong != text
        path.write_text(wrong)
        with pytest.raises(tmj.TensegrityError, match=message):
            tmj.load_scene(path)


def test_a_file_runs_no_code_and_names_no_class(tmp_path: Path) -> None:
    with pytest.raises(tmj.errors.SceneError, match=r"elements\[0\] is a GroundSpring.*register\(name, GroundSpring\)"):
        tmj.save_scene(tethered(OWN), tmp_path / "tethered.toml")


def test_a_sweep_changes_fields_of_elements_and_of_water(known: None, tmp_path: Path) -> None:
    path = tmp_path / "tethered.toml"
    tmj.save_scene(tethered(OWN), path)
    name, wind, engine = "scene.elements[ground-spring].stiffness", "scene.elements[2].wind", ENGINES["dae"]
    axes = [Vary(name, (12.0, 24.0)), Vary(wind, (0.0, 0.3))]
    fixed = {"scene.duration": 0.1}
    study = Sweep(path, axes, fixed=fixed, engine=engine).run(workers=Workers(backend=Backend.THIS_PROCESS))
    assert len(study.points) == 4
    for point, outcome in zip(study.points, study.outcomes, strict=True):
        stiffness, speed = (point["parameters"][path] for path in (name, wind))
        own = (GroundSpring("a", stiffness, OWN[0].place), OWN[1], Brake(0.05, speed))
        alone = tmj.simulate(tethered(own), engine=engine, duration=0.1)
        assert outcome["values"]["max_tension"] == alone.tensions.max()
    for wrong, message in (
        ("scene.elements[grund-spring].stiffness", "did you mean 'ground-spring'"),
        ("scene.elements.size", "no part of a member of elements"),
        ("scene.elements[0].stifness", "did you mean 'stiffness'"),
        ("scene.water.density", "has no water"),
    ):
        with pytest.raises(tmj.errors.OptionError, match=message):
            changed(tethered(OWN), wrong, 1.0)
    wet = changed(waved(), "scene.water.current.x", 0.7)
    assert wet.water is not None
    assert wet.water.current == (0.7, 0.0, 0.0)
    assert changed(waved(), "scene.water.density", Scaled(2.0)).water.density == 2050.0
    spring = changed(tethered(OWN), "scene.elements[0].place.z", 0.9).elements[0]
    assert spring == GroundSpring("a", 12.0, (0.1, -0.2, 0.9))


def changed(scene: tmj.Scene, path: str, value: Any) -> Any:
    return changed_scene(scene, "scene", path.removeprefix("scene."), path, value)
