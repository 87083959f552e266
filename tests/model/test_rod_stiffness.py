"""What elastic rods are as members: their checks, files, statics, small motions, limits of engines, and buckling."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from soft_scenes import LENGTH, MASS, K, bar, rigid, soft_chain, soft_pair

import tensegrity_mj as tmj
from evidence.extremes.pace import pace
from tensegrity_mj.dynamics.native.law import native_law
from tensegrity_mj.engines.accuracy.rates import rates_at_start
from tensegrity_mj.engines.request import Request
from tensegrity_mj.errors import StructureError, TensegrityError
from tensegrity_mj.exchange.importing import import_scene
from tensegrity_mj.exchange.menagerie import save_menagerie
from tensegrity_mj.exchange.tables import save_csv
from tensegrity_mj.model import Section
from tensegrity_mj.statics import find_equilibrium, natural_modes
from tensegrity_mj.studies.scene_parameters import changed_scene
from tensegrity_mj.studies.validation import judging, task

ENGINES = {"mujoco": tmj.MuJoCo(1e-3), "dae": tmj.DAE()}
TUBE = Section.tube(0.01, 0.002, 2e9)


def test_what_is_wrong_is_named() -> None:
    with pytest.raises(StructureError, match=r"rod 'r': stiffness = 0.0; it must be > 0 N/m, or absent"):
        tmj.Rod("r", ("a", "b"), 1.0, stiffness=0.0)
    with pytest.raises(StructureError, match=r"rod 'r': damping = 2.0, but the rod is rigid: give it a stiffness"):
        tmj.Rod("r", ("a", "b"), 1.0, damping=2.0)
    with pytest.raises(StructureError, match=r"rod 'r': rest_length = 2.0, but the rod is rigid"):
        tmj.Rod("r", ("a", "b"), 1.0, rest_length=2.0)
    with pytest.raises(StructureError, match=r"rod 'r': masses: one has an inertia, but the rod is elastic"):
        tmj.Rod("r", ("a", "b"), 1.0, stiffness=2.0, masses=(tmj.model.RodMass(0.5, 1.0, 0.1),))
    with pytest.raises(StructureError, match=r"rod 'bar' has no section: give it one"):
        bar().structure.with_elastic_rods()


def test_a_section_gives_its_rod_ea_over_l() -> None:
    structure = rigid(bar()).structure.with_sections(TUBE)
    found = structure.with_elastic_rods(damping=3.0).rods[0]
    assert found.stiffness == pytest.approx(TUBE.axial_stiffness / LENGTH, rel=1e-15)
    assert found.damping == 3.0


def test_an_elastic_rod_starts_with_any_length_and_speed_along_itself() -> None:
    scene = bar(stretch=0.3).with_(initial_velocities=np.array([[0.0, 0.0, 0.0], [0.48, 0.6, 0.64]]))
    assert scene.structure.rod_lengths == pytest.approx([LENGTH])
    with pytest.raises(tmj.TensegrityError, match=r"would be 1\.55 m long"):
        rigid(scene.with_(initial_velocities=None))
    with pytest.raises(tmj.TensegrityError, match="would lengthen at 1 m/s"):
        rigid(scene.with_(initial_nodes=None))


def test_a_string_may_run_along_an_elastic_rod() -> None:
    structure = bar().structure
    together = replace(structure, strings=(tmj.String("s", ("a", "b"), 100.0, rest_length=1.0),))
    run = tmj.simulate(tmj.Scene(together), engine=ENGINES["dae"], duration=0.01)
    assert run.tensions[0] == pytest.approx([100.0 * (LENGTH - 1.0)])
    with pytest.raises(StructureError, match="string 's' runs along rod 'bar'"):
        replace(rigid(bar()).structure, strings=together.strings)


def test_files_and_tables_keep_elastic_rods(tmp_path: Path) -> None:
    scene = soft_pair()
    rods = (replace(scene.structure.rods[0], rest_length=0.9), *scene.structure.rods[1:])
    scene = scene.with_(structure=replace(scene.structure, rods=rods))
    tmj.save_scene(scene, tmp_path / "soft.toml")
    assert tmj.load_scene(tmp_path / "soft.toml").structure == scene.structure
    save_csv(scene, tmp_path / "soft_nodes.csv")
    again = import_scene(tmp_path / "soft_nodes.csv").scene.structure.rods
    for key in ("stiffness", "damping", "rest_length"):
        assert [getattr(rod, key) for rod in again] == [getattr(rod, key) for rod in rods]
    moved = changed_scene(scene, "structure", "rods.stiffness", "structure.rods.stiffness", 512.0)
    assert [rod.stiffness for rod in moved.structure.rods] == [512.0, 512.0]


@pytest.mark.parametrize("own", [True, False])
def test_its_mjcf_stands_by_itself(own: bool, tmp_path: Path) -> None:
    """Without the package: the accelerations of the model at its start, its strings at their designed lengths."""
    import mujoco

    scene, path = soft_pair(), tmp_path / "soft.xml"
    if own:
        from tensegrity_mj.engines.mujoco.mjcf import save_mjcf

        save_mjcf(scene, path)
    else:
        save_menagerie(scene, path)
    model = mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(model)
    for _ in range(100):
        mujoco.mj_step(model, data)
    run = tmj.simulate(scene, None, tmj.MuJoCo(1e-3), duration=0.1)
    sites = [model.site(name).id for name in scene.structure.node_names]
    np.testing.assert_allclose(data.site_xpos[sites], run.nodes[-1], atol=1e-6)  # after 0.1 s, where those fall 5 cm


REFUSED: dict[str, tuple[tmj.Scene, Any, str]] = {
    "ode": (
        bar(),
        tmj.ODE(),
        "ODE: rod 'bar' is elastic: its angles are those of rods of constant length; use MuJoCo or",
    ),
    "joined": (
        soft_chain(),
        tmj.MuJoCo(1e-3),
        "share node 'a': bodies that share a node form a tree, .* use DAE",
    ),
    "between": (
        bar(tmj.Support.pinned(0.5)),
        tmj.MuJoCo(1e-3),
        "elastic rod 'bar' is held between its ends: .* use DAE, or",
    ),
    "contact": (
        bar().with_(contact=tmj.model.Contact(floor=-5.0)),
        tmj.MuJoCo(1e-3),
        "has contact: the bodies of contact",
    ),
    "water": (
        bar().with_(water=tmj.Water()),
        tmj.MuJoCo(1e-3),
        "water adds mass to rods: added mass is that of rods of",
    ),
    "water, dae": (bar().with_(water=tmj.Water()), tmj.DAE(), "water adds mass to rods: added mass is that of rods of"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_engines_cannot_do_is_refused_with_the_reason(name: str) -> None:
    scene, engine, message = REFUSED[name]
    with pytest.raises(TensegrityError, match=message):
        tmj.simulate(scene, None, engine, duration=0.1)


def test_the_dae_has_a_rod_held_between_its_ends() -> None:
    """In the middle: its halves stretch alike, and hang as they did."""
    run = tmj.simulate(bar(tmj.Support.pinned(0.5), stretch=0.1), None, tmj.DAE(), duration=0.2)
    assert run.nodes.mean(axis=1) == pytest.approx(np.broadcast_to(run.nodes[0].mean(axis=0), (len(run.time), 3)))
    assert run.energy_residual < 1e-9


def test_laws_of_the_thesis_refuse_elastic_rods() -> None:
    scene = tmj.load_scene("prism")
    soft = replace(scene.structure, rods=tuple(replace(rod, stiffness=1e4) for rod in scene.structure.rods))
    with pytest.raises(
        StructureError, match=r"laws of chapters 4 to 6 .* for rods of constant length; here rod 'rod1'"
    ):
        tmj.simulate(scene.with_(structure=soft), "lyapunov", duration=0.1)


def soft_prism() -> tmj.Scene:
    """The prism with soft rods and taut strings, without dampers."""
    scene = tmj.load_scene("prism").with_(control=None, target=None)
    strings = scene.structure.with_strings(stiffness=40.0, rest_length=0.9 * scene.structure.rest_lengths)
    return scene.with_(structure=replace(strings, rods=tuple(replace(rod, stiffness=300.0) for rod in strings.rods)))


def test_statics_and_both_engines_have_the_same_equilibrium_and_the_same_modes() -> None:
    """Neither shares an equation with another: a search by forces, and accelerations; eigenvalues to 1e-9 of all."""
    state = find_equilibrium(soft_prism())
    strain = state.rod_lengths / state.model.rod_lengths - 1
    assert np.all(strain < -0.005)
    assert state.rod_forces == pytest.approx(300.0 * (state.rod_lengths - state.model.rod_lengths), rel=1e-10)
    there, modes = state.scene(), natural_modes(state)
    assert there.structure.rod_lengths == pytest.approx(state.model.rod_lengths)
    squares = np.sort((2 * np.pi * modes.frequencies) ** 2)
    for engine in ENGINES.values():
        linear = tmj.linearize(there, engine)
        n = len(linear.coordinates)
        assert n == 12
        assert np.abs(linear.residual).max() < 1e-8
        found = np.sort(-np.linalg.eigvals(linear.A[n:, :n]).real)
        np.testing.assert_allclose(found, squares, atol=1e-9 * squares[-1])
        limit = tmj.stable_step(there, tmj.DAE(method=tmj.Method.RK4, timestep=1e-3)).limit
        assert limit == pytest.approx(math.sqrt(8 / squares[-1]), rel=1e-9)


def test_linear_models_of_rods_that_share_nodes_agree_with_small_motions() -> None:
    """Without weight, where the state is at rest: the stiffest of both is the same but for its damping."""
    scene = soft_chain(closed=True).with_(gravity=(0.0, 0.0, 0.0))
    rods = tuple(replace(rod, damping=0.0, rest_length=None) for rod in scene.structure.rods)
    scene = scene.with_(structure=replace(scene.structure, rods=rods))
    values = np.abs(np.linalg.eigvals(tmj.linearize(scene, tmj.DAE()).A))
    found = tmj.stable_step(scene, tmj.DAE(method=tmj.Method.RK4, timestep=1e-3))
    assert found.omega == pytest.approx(values.max(), rel=1e-8)


def test_rough_rates_have_the_axial_mode() -> None:
    """Those by which accuracy and the audit of extremes begin: ω² = 12 k/m, and 12 c/m; with a mass m on an end
    μ = m/3 - (m/2)²/2m of it moves, and the stiffest of two springs in a chain is no less than either.
    """
    scene = bar(damping=2.0)
    rates, rough = rates_at_start(Request(scene, native_law(None, scene.structure), duration=1.0)), pace(scene)
    for omega, decay in ((rates.turn, rates.decay), (rough.vibration, rough.decay)):
        assert omega == pytest.approx(math.sqrt(12 * K / MASS), rel=1e-12)
        assert decay == pytest.approx(12 * 2.0 / MASS, rel=1e-12)
    laden = scene.with_(structure=replace(scene.structure, point_masses=(tmj.PointMass("b", MASS),)))
    moving = MASS / 3 - (MASS / 2) ** 2 / (2 * MASS)
    assert pace(laden).vibration == pytest.approx(math.sqrt(K / moving), rel=1e-12)
    assert tmj.stable_step(laden, tmj.MuJoCo(1e-3)).omega == pytest.approx(math.sqrt(K / moving), rel=1e-12)


STEPS = {
    # ω h of the closed forms in `vibration.integrators`, ζ = 0.3.
    "euler": 2 * (math.sqrt(1.09) - 0.3),
    "implicit": 2 * (math.sqrt(1.09) + 0.3),
    "implicitfast": 2 * (math.sqrt(1.09) + 0.3),
    "discrete": math.inf,
}


@pytest.mark.parametrize("integrator", STEPS)
def test_the_largest_stable_step_is_that_of_the_axial_mode(integrator: str) -> None:
    import mujoco

    omega, damping = math.sqrt(12 * K / MASS), 0.3 * math.sqrt(K * MASS / 3)
    found = tmj.stable_step(bar(damping=damping), tmj.MuJoCo(1e-3, integrator=integrator))  # type: ignore[arg-type]
    assert found.omega == pytest.approx(omega, rel=1e-12)
    assert found.limit == pytest.approx(STEPS[integrator] / omega, rel=1e-9)
    # MuJoCo's own steps grow beyond it, and not below it.
    for part, stays in ((0.98, True), (1.02, False)) if math.isfinite(found.limit) else ((100.0, True),):
        step = part * (found.limit if math.isfinite(found.limit) else 1 / omega)
        model = tmj.MuJoCo(step, integrator=integrator).model(bar(stretch=1e-3, damping=damping))  # type: ignore[arg-type]
        data, stretch = mujoco.MjData(model), []
        for _ in range(200):
            mujoco.mj_step(model, data)
            stretch.append(abs(float(np.linalg.norm(data.qpos[3:] + bar().nodes0[1] * (1 + 1e-3 / LENGTH))) - LENGTH))
        assert (max(stretch[-5:]) < max(stretch[:5])) == stays


@pytest.mark.parametrize("elastic", [True, False])
def test_a_rod_that_is_pushed_with_more_than_eulers_load_is_reported(elastic: bool) -> None:
    """A bar stands on its foot under a load that grows as 1 - cos: it passes π² E I / L² when the closed form says."""
    section = Section.solid(0.004, 2e9)
    down = {"direction": (0.0, 0.0, 1.0), "stiffness": 5e6, "damping": 2e3}
    scene = bar(tmj.Support.pinned(0, plane=(0, 1, 0)), **down)  # type: ignore[arg-type]
    scene = scene if elastic else rigid(scene)
    structure = scene.structure.with_sections(section)
    euler = math.pi**2 * 2e9 * math.pi / 4 * 0.004**4 / LENGTH**2
    push = (0.0, 0.0, -2 * euler)
    loads = (tmj.model.Load("b", push), tmj.model.Load("b", (0.0, 0.0, 2 * euler), 20.0))
    run = tmj.simulate(
        scene.with_(structure=structure, loads=loads), None, tmj.DAE(), duration=0.1, output_interval=1e-3
    )
    when = math.acos(1 - 1 / 2) / 20.0  # 2 P (1 - cos 20 t) = P
    found = run.reports["buckling"]["bar"]
    assert found["time"] == pytest.approx(when, abs=2e-3)
    assert found["euler_load"] == pytest.approx(euler, rel=1e-4)
    assert found["push"] > found["euler_load"]
    assert any(
        "rod 'bar' is pushed with more than Euler's load of its section" in text for text in run.reports["warnings"]
    )
    values = task.of_run(run)
    said = " ".join(judging._winch_sentences({"nominal": {"engines": {"dae": values}}}, "dae"))
    assert "Rod bar is pushed with more than Euler's load of the section, first at 0.0" in said
    # A sudden load pushes an elastic bar with twice itself at most.
    below = scene.with_(structure=structure, loads=(tmj.model.Load("b", (0.0, 0.0, -0.4 * euler)),))
    assert tmj.simulate(below, None, tmj.DAE(), duration=0.1).reports["buckling"] == {}
