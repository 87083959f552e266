"""Rods that contact turns about their own axes, or that it holds; and what follows from a contact's stiffness."""

from __future__ import annotations

import copy
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import mujoco
import numpy as np
import pytest

import tensegrity_mj as tmj
from tensegrity_mj.engines.mujoco import contact as holding
from tensegrity_mj.engines.mujoco.contact import spins
from tensegrity_mj.engines.mujoco.mjcf import scene_to_mjcf
from tensegrity_mj.errors import SceneError
from tensegrity_mj.model import Contact, Section
from tensegrity_mj.model.rods import axial_moment

G, MASS, LENGTH, RADIUS = 9.81, 0.7, 0.6, 0.02
both = pytest.mark.parametrize(
    "engine", [tmj.MuJoCo, lambda step: tmj.DAE(method="rk4", timestep=step)], ids=["mujoco", "dae"]
)


def rolling_rod(spin: str, name: str = "rod") -> tmj.Scene:
    """A tilted rod that lands on one end and slides across its own axis, which friction turns."""
    ends = {"a": (0, 0, 0.021), "b": (0.5, 0.1, 0.021 + np.sqrt(LENGTH**2 - 0.26))}
    rod = tmj.Rod("rod", ("a", "b"), MASS, RADIUS)
    return tmj.Scene(
        tmj.Structure("rod", ends, (rod,)), name, gravity=(0, 0, -G), contact=Contact(floor=0.0, spin=spin),
        initial_velocities=[(-0.1, 0.5, -0.3)] * 2, duration=0.1,
    )  # fmt: skip


def test_a_couple_about_its_axis_does_nothing_to_a_held_rod() -> None:
    """Mobility of a thin rod, J ω̇ = τ for a couple across the axis; along it, τ/A with the armature A.

    As differences from the accelerations without the couple, some 1e3 rad/s², whose round-off is 1e-13.
    """
    scene = rolling_rod("held")
    model = tmj.MuJoCo(1e-4).model(scene)
    data, moment = mujoco.MjData(model), MASS * LENGTH**2 / 12
    axis = np.diff(scene.nodes0, axis=0)[0] / LENGTH
    mujoco.mj_forward(model, data)
    still = data.qacc.copy()
    across = np.cross(axis, [0.0, 0.0, 1.0])
    for couple in (axis, across):
        data.xfrc_applied[1, 3:] = couple
        mujoco.mj_forward(model, data)
        turn = data.xmat[1].reshape(3, 3) @ (data.qacc - still)[3:]
        armature = holding.HOLDING * moment + axial_moment(scene.structure.rods[0])
        expected = couple / (armature if couple is axis else moment)
        np.testing.assert_allclose(turn, expected, rtol=0, atol=1e-12 * np.linalg.norm(expected) + 1e-13)


def test_what_is_left_of_spin_falls_with_the_armature(monkeypatch: pytest.MonkeyPatch) -> None:
    """A model without spin is the limit: spin rates and the change of nodes are of the first order in 1/A."""
    ends, rates = [], []
    for number, factor in enumerate((1e4, 1e6, 1e8)):
        monkeypatch.setattr(holding, "HOLDING", factor)
        scene = rolling_rod("held", f"rod {number}")  # of another layout, compiled anew
        run = tmj.simulate(scene, None, tmj.MuJoCo(1e-4))
        model = tmj.MuJoCo(1e-4).model(scene)
        data, (dof,) = mujoco.MjData(model), spins(scene.structure, model)
        data.qvel[:3] = scene.velocities0[0]
        mujoco.mj_step(model, data, 1000)
        ends.append(run.nodes[-1])
        rates.append(abs(float(data.qvel[dof])))
    assert rates[0] > 1e-6
    # The next order is 1/A itself, at most 1e-2 of these ratios.
    assert rates[0] / rates[1] == pytest.approx(100, rel=1e-2)
    assert rates[1] / rates[2] == pytest.approx(100, rel=1e-2)
    first, second = (float(np.abs(one - ends[2]).max()) for one in ends[:2])
    assert 50 < first / second < 200
    free = tmj.simulate(rolling_rod("free"), None, tmj.MuJoCo(1e-4))
    assert np.abs(free.nodes[-1] - ends[2]).max() > 1e3 * first


@both
def test_a_held_rod_lies_across_a_slope_on_which_a_free_one_rolls(engine: Callable[[float], Any]) -> None:
    """With tan α < μ: what is held sticks, and what is free rolls with 2/3 g sin α (`test_contact_on_terrain`)."""
    speeds = {}
    for spin in ("held", "free"):
        structure = tmj.Structure("log", {"a": (0, 0, RADIUS), "b": (0, LENGTH, RADIUS)}, (
            tmj.Rod("log", ("a", "b"), MASS, RADIUS),
        ))  # fmt: skip
        scene = tmj.Scene(
            structure, gravity=(G * np.sin(0.2), 0, -G * np.cos(0.2)), contact=Contact(floor=0.0, spin=spin)
        )
        run = tmj.simulate(scene, None, engine(5e-4), duration=0.5)
        speeds[spin] = float(run.velocities[-1, 0, 0])
    # Creep: v b/R on the masses of both ends, as `test_contact` has it; here below a millimetre a second.
    assert 0 < speeds["held"] < 1e-3
    assert speeds["free"] == pytest.approx(2 / 3 * G * np.sin(0.2) * 0.5, rel=0.01)


def test_a_section_has_the_axial_inertia_of_its_tube() -> None:
    """m (R² + r²)/2 of a tube, m R²/2 of a solid bar and without a section."""
    rod = tmj.Rod("rod", ("a", "b"), MASS, RADIUS)
    assert axial_moment(rod) == pytest.approx(0.5 * MASS * RADIUS**2, rel=1e-15)
    solid, tube = Section.solid(0.03, 1e9), Section.tube(0.03, 0.01, 1e9)
    assert axial_moment(replace(rod, section=solid)) == pytest.approx(0.5 * MASS * 0.03**2, rel=1e-14)
    assert axial_moment(replace(rod, section=tube)) == pytest.approx(0.5 * MASS * (0.03**2 + 0.02**2), rel=1e-14)
    scene = rolling_rod("free")
    thick = replace(scene.structure, rods=(replace(scene.structure.rods[0], section=tube),))
    model = tmj.MuJoCo().model(scene.with_(structure=thick))
    assert model.body_inertia[1, 2] == pytest.approx(0.5 * MASS * (0.03**2 + 0.02**2), rel=1e-14)
    assert not model.dof_armature.any()


def test_the_file_says_that_its_rods_turn_and_every_model_here_holds_them() -> None:
    from tensegrity_mj.learning.dm_control import physics

    held, free = rolling_rod("held"), rolling_rod("free")
    said = "By itself this model lets rods turn about their own axes"
    assert said in scene_to_mjcf(held)
    assert said not in scene_to_mjcf(free)
    bare = mujoco.MjModel.from_xml_string(scene_to_mjcf(held))
    assert not bare.dof_armature.any()
    for model in (tmj.MuJoCo().model(held), physics(held).model.ptr):
        (dof,) = spins(held.structure, model)
        assert model.dof_armature[dof] == pytest.approx(holding.HOLDING * MASS * LENGTH**2 / 12, rel=1e-12)
        assert np.count_nonzero(model.dof_armature) == 1
        assert model.stat.meaninertia == bare.stat.meaninertia


def test_rods_that_share_nodes_are_not_held() -> None:
    """Refused where friction would turn them, in words that help; taken where they are free, or nothing turns them."""
    nodes = {"a": (0, 0, 0.2), "b": (0.5, 0, 0.2), "c": (0.9, 0, 0.4)}
    structure = tmj.Structure("two", nodes, (tmj.Rod("r1", ("a", "b"), 1.0), tmj.Rod("r2", ("b", "c"), 1.0)))
    for contact in (Contact(floor=0.0, spin="free"), Contact(floor=0.0, friction=0.0)):
        tmj.simulate(tmj.Scene(structure, contact=contact), engine=tmj.MuJoCo(1e-3), duration=0.01)
    with pytest.raises(SceneError, match=r"'r1' and 'r2' share node 'b', .* spin = 'free'"):
        tmj.simulate(tmj.Scene(structure, contact=Contact(floor=0.0)), engine=tmj.MuJoCo(1e-3), duration=0.01)
    with pytest.raises(SceneError, match=r"spin = 'fre'.*did you mean 'free'.*held, free"):
        Contact(floor=0.0, spin="fre")


def test_damping_and_width_follow_the_stiffness() -> None:
    """Unless they are given: critical damping and 0.2 m/s / √stiffness."""
    assert Contact(floor=0.0).spring == (1.6e5, 800.0, (0.01, 0.95, 5e-4, 0.5, 2.0))
    assert Contact(floor=0.0, stiffness=1e4).spring == (1e4, 200.0, (0.01, 0.95, 2e-3, 0.5, 2.0))
    own = Contact(floor=0.0, damping=30.0, impedance=(0.9, 0.9, 1e-3, 0.5, 2.0))
    assert replace(own, stiffness=1e4).spring == (1e4, 30.0, (0.9, 0.9, 1e-3, 0.5, 2.0))


@both
def test_landings_on_floors_of_any_stiffness_are_alike(engine: Callable[[float], Any]) -> None:
    """Without weight, the law of stiffness k in time t is that of 16 k in t/4 at a quarter of the depth.

    Steps as well: so the same numbers but for round-off, 1e-16 of each of 4,000 steps, if widths shrink, too.
    """
    found = []
    for stiffness, step in ((1e4, 4e-6), (1.6e5, 1e-6)):
        structure = tmj.Structure("point", {"a": (0, 0, 0)}, point_masses=(tmj.PointMass("a", 1.0),))
        contact = Contact(floor=-100 * step, friction=0.0, stiffness=stiffness)
        scene = tmj.Scene(structure, contact=contact, initial_velocities=[(0, 0, -1.0)])
        run = tmj.simulate(scene, None, engine(step), duration=4000 * step, output_interval=100 * step)
        found.append((run.nodes[:, 0, 2] / step, run.velocities[:, 0, 2]))
    np.testing.assert_allclose(found[0][0], found[1][0], rtol=1e-6)
    np.testing.assert_allclose(found[0][1], found[1][1], rtol=0, atol=1e-6)


def test_the_solver_stops_at_round_off() -> None:
    """Accelerations in contact against those of a solver that never stops.

    What it can know is the round-off of the equations, of contacts at depths of 1e-4 of a metre, 1e-16/1e-4, by the
    d/(1 - d) of up to 20 that stiffens them: 1e-10 with a margin of 5. A tolerance of 1e-22 leaves 5e-8.
    """
    scene = tmj.load_scene("six_bar_push")
    model = tmj.MuJoCo(1e-3).model(scene)
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    touching = 0
    for _ in range(60):
        mujoco.mj_step(model, data, 10)
        found = []
        for tolerance in (model.opt.tolerance, 0.0):
            other = mujoco.MjData(model)
            other.qpos[:], other.qvel[:] = data.qpos, data.qvel
            exact = copy.copy(model)
            exact.opt.tolerance = tolerance
            mujoco.mj_forward(exact, other)
            found.append(other.qacc.copy())
        touching += data.ncon
        np.testing.assert_allclose(found[0], found[1], rtol=0, atol=1e-10 * np.abs(found[1]).max())
    assert touching > 60
