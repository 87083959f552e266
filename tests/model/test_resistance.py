"""Viscous forces, drag and bending of joints: forces, motion in closed form, energy, and every engine alike."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
from linked_scenes import hanging_chain, random_tree
from scipy.integrate import quad

import tensegrity_mj as tmj
from tensegrity_mj.commands.scenes import describe
from tensegrity_mj.dynamics.native.elements import let_act
from tensegrity_mj.dynamics.native.law import native_law
from tensegrity_mj.dynamics.native.plant import Plant
from tensegrity_mj.library.cable import cable
from tensegrity_mj.model.actuation import Actuation, OnInfeasible
from tensegrity_mj.model.elements.resistance import bending_energy, resisting_forces
from tensegrity_mj.model.text.reading import scene_from_toml
from tensegrity_mj.model.text.writing import scene_to_toml

Y = (0.0, 1.0, 0.0)
ALL = tmj.Resistance(0.3, tmj.model.Bending(2.0, 0.1), tmj.model.Drag(1.1, 0.2, 30.0), (1.0, 2.0, -0.5))
FINE = tmj.DAE(rtol=1e-12, atol=1e-13)


def single_rod(length=0.8, mass=0.5, radius=0.02, support=None, direction=(1.0, 0.0, 0.0), **scene):
    """One rod from the origin along a direction."""
    end = length * np.array(direction) / np.linalg.norm(direction)
    rod = tmj.Rod("rod", ("a", "b"), mass, radius, support or tmj.Support.free())
    structure = tmj.Structure("one", {"a": (0.0, 0.0, 0.0), "b": tuple(end.tolist())}, (rod,))
    return tmj.Scene(structure, **scene)


def compiled(scene, nodes=None, velocities=None):
    """Nodal forces and the powers of wind and dissipation, from what every engine calls."""
    plant = Plant(scene, native_law(None, scene.structure), Actuation.continuous(), OnInfeasible.STOP)
    if nodes is not None:
        plant["nodes"][:], plant["velocities"][:] = nodes, velocities
    given, lost = let_act(plant.address, 0.0)
    return plant["forces"].copy(), given, lost


def test_compiled_forces_are_those_of_numpy_and_their_power_is_wind_less_dissipation_less_bending():
    rng = np.random.default_rng(3)
    for planar in (False, True):
        scene = random_tree(rng, 6, planar).with_(resistance=ALL)
        nodes, velocities = scene.nodes0, rng.normal(size=scene.nodes0.shape)
        forces, given, lost = compiled(scene, nodes, velocities)
        expected = resisting_forces(scene, nodes, velocities)
        # Sums of some 20 terms each: a few ulp of the largest.
        assert np.abs(forces - expected).max() <= 1e-14 * np.abs(expected).max()
        # Energy of bending is quadratic in the nodes: a central difference is exact up to round-off, 1e-16 E / 1e-3.
        h = 1e-3
        rate = (bending_energy(scene, nodes + h * velocities) - bending_energy(scene, nodes - h * velocities)) / (2 * h)
        assert np.sum(forces * velocities) == pytest.approx(given - lost - rate, abs=1e-11 * abs(lost))
        assert lost > 0


def test_forces_of_bending_are_the_gradient_of_its_energy_and_push_and_turn_nothing_as_a_whole():
    rng = np.random.default_rng(4)
    bending = tmj.model.Bending(3.0, 0.0, (("r0", "r1"), ("r3", "r2")))
    chain = hanging_chain([0.3, 0.5, 0.4, 0.2], [1.0, 1.0, 1.0, 1.0])
    scene = chain.with_(resistance=tmj.Resistance(bending=bending))
    nodes = chain.nodes0 + 0.3 * rng.normal(size=chain.nodes0.shape)
    forces, _, lost = compiled(scene, nodes, np.zeros_like(nodes))
    gradient = np.zeros_like(nodes)
    for index in np.ndindex(nodes.shape):
        step = np.zeros_like(nodes)
        step[index] = 1e-3
        gradient[index] = (bending_energy(scene, nodes + step) - bending_energy(scene, nodes - step)) / 2e-3
    assert np.abs(forces + gradient).max() <= 1e-11 * np.abs(forces).max()  # as above: exact for a quadratic
    assert lost == 0.0
    assert np.abs(forces.sum(axis=0)).max() <= 1e-14 * np.abs(forces).max()
    # Couples of e on d_a and on -d_b add up to κ e × e = 0, whatever the rods' lengths.
    assert np.abs(np.cross(nodes, forces).sum(axis=0)).max() <= 1e-13 * np.abs(forces).max()
    # Joint r1-r2 is not among the pairs: bent alone, it stores nothing.
    bent = chain.nodes0.copy()
    bent[3:] += np.outer(chain.nodes0[2, 2] - chain.nodes0[3:, 2], [1.0, 0.0, 0.0])
    assert bending_energy(scene, bent) == pytest.approx(0.0, abs=1e-28)
    assert bending_energy(scene.with_(resistance=ALL), bent) > 0.1


def test_joints_of_three_rods_resist_bending_only_where_they_are_named():
    places = {
        "o": (0.0, 0.0, 0.0),
        "x": (1.0, 0.0, 0.0),
        "y": (0.0, 1.0, 0.0),
        "z": (0.0, 0.0, 1.0),
        "end": (0.0, 0.5, 1.0),
    }
    ends = (("o", "x"), ("y", "o"), ("o", "z"), ("end", "z"))
    rods = tuple(tmj.Rod(f"r{k}", pair, 1.0) for k, pair in enumerate(ends))
    star = tmj.Scene(tmj.Structure("star", places, rods))
    nodes, right_angle = star.nodes0, 2.0 * (1 - np.cos(np.pi / 2))
    everywhere = star.with_(resistance=tmj.Resistance(bending=tmj.model.Bending(2.0)))
    assert bending_energy(everywhere, nodes) == pytest.approx(right_angle, rel=1e-14)  # of r2 and r3 alone
    named = star.with_(resistance=tmj.Resistance(bending=tmj.model.Bending(2.0, 0.0, (("r0", "r1"), ("r2", "r1")))))
    assert bending_energy(named, nodes) == pytest.approx(2 * right_angle, rel=1e-14)


def test_energy_of_bending_is_that_of_the_angle_and_drag_of_wind_on_a_held_rod_is_closed_form():
    phi = 0.7
    scene = hanging_chain([0.4, 0.25], [1.0, 1.0]).with_(resistance=ALL)
    nodes = scene.nodes0.copy()
    nodes[2] = nodes[1] + 0.25 * np.array([np.sin(phi), 0.0, -np.cos(phi)])
    assert bending_energy(scene, nodes) == pytest.approx(2.0 * (1 - np.cos(phi)), rel=1e-14)
    assert bending_energy(scene, nodes) == pytest.approx(0.5 * 2.0 * phi**2, rel=phi**2 / 12)

    wind, radius, length = np.array([3.0, -1.0, 2.0]), 0.02, 0.8
    drag = tmj.model.Drag(1.3, 0.4, 1.9)
    blown = tmj.Resistance(0.0, None, drag, wind)
    held = single_rod(length, radius=radius, direction=(1.0, 1.0, 0.0), resistance=blown)
    along = np.array([1.0, 1.0, 0.0]) / np.sqrt(2)
    slip = wind @ along
    across = wind - slip * along
    area = 0.5 * 1.9 * 2 * radius * length
    whole = area * 1.3 * np.linalg.norm(across) * across + area * np.pi * 0.4 * abs(slip) * slip * along
    forces, given, lost = compiled(held)
    assert np.abs(forces - whole / 2).max() <= 1e-14  # half at each end, of forces of 0.1 N
    assert (given, lost) == pytest.approx((whole @ wind, whole @ wind), rel=1e-14)  # at rest all of it heats the air
    thick = held.with_(resistance=tmj.Resistance(0.0, None, tmj.model.Drag(1.3, 0.4, 1.9, 0.08), wind))
    assert np.abs(compiled(thick)[0] - whole).max() <= 1e-14  # twice the diameter


def test_drag_of_a_turning_rod_is_exact_in_a_plane_and_within_its_bound_in_space():
    rng = np.random.default_rng(5)
    length, factor = 0.8, 0.5 * 1.225 * 1.2 * 0.04
    scene = single_rod(length, resistance=tmj.Resistance(drag=tmj.model.Drag()))
    for center in (-0.4, 0.0, 0.3, 0.5, 1.0, 1.2):  # along the rod: where it stands still
        speeds = 2.0 * length * (np.array([0.0, 1.0]) - center)
        forces, _, lost = compiled(scene, scene.nodes0, np.outer(speeds, Y))

        def density(s, center=center):
            u = 2.0 * length * (s - center)
            return -factor * length * abs(u) * u

        inside = [center] if 0 < center < 1 else None
        expected = [quad(lambda s, n=n: density(s) * abs(1 - n - s), 0, 1, points=inside)[0] for n in (0, 1)]
        assert np.abs(forces[:, 1] - expected).max() <= 1e-13 * np.abs(expected).max()
        assert lost == pytest.approx(-forces[:, 1] @ speeds, rel=1e-14)
    worst = 0.0
    for _ in range(40):
        velocities = rng.normal(size=(2, 3)) * [0.0, 1.0, rng.choice([0.02, 0.1, 1.0])]
        forces, _, _ = compiled(scene, scene.nodes0, velocities)

        def along(s, n, axis, v=velocities):
            u = (1 - s) * v[0] + s * v[1]
            return -factor * length * np.linalg.norm(u) * u[axis] * abs(1 - n - s)

        ends = velocities[:, 1]
        near = [ends[0] / (ends[0] - ends[1])] if ends[0] * ends[1] < 0 else None
        exact = [[quad(along, 0, 1, (n, x), points=near, epsrel=1e-10)[0] for x in range(3)] for n in (0, 1)]
        worst = max(worst, np.abs(forces - exact).max() / np.abs(exact).max())
    assert 1e-9 < worst <= 5e-5  # the bound of the module's text; five points with no split give 1e-3


@pytest.mark.parametrize("engine", [FINE, tmj.ODE(rtol=1e-12, atol=1e-13), tmj.MuJoCo(timestep=2e-3)])
def test_every_rigid_motion_of_a_free_rod_dies_out_at_the_same_rate_under_viscous_forces(engine):
    # Force per length and mass per length are in one proportion, so that v falls as exp(-c ℓ t / m) everywhere; forces
    # lumped at the ends would stop a spin three times as fast.
    velocities = np.array([[0.1, 0.5, -0.2], [0.1, -0.4, 0.7]])
    scene = single_rod(resistance=tmj.Resistance(viscous=0.5), initial_velocities=velocities)
    run = tmj.simulate(scene, engine=engine, duration=2.0)
    kept = np.exp(-2 * 0.5 * 0.8 / 0.5 * run.time)
    # RK4: some (1.6 h)⁴ / 120 = 9e-13 a step of the rate's part, and (ω h)⁴ of the spin's, 4e-12.
    assert np.abs(run.kinetic_energy - run.kinetic_energy[0] * kept).max() <= 1e-10 * run.kinetic_energy[0]
    assert run.dissipation[-1] == pytest.approx(run.kinetic_energy[0] - run.kinetic_energy[-1], rel=1e-10)
    assert run.external_work[-1] == 0.0


def test_a_viscous_pendulum_swings_as_the_damped_oscillator():
    c, m, length, g, tilt = 0.4, 0.5, 0.8, 9.81, 1e-4
    support = tmj.Support.pinned(0.0, Y)
    scene = single_rod(
        length, m, support=support, direction=(np.sin(tilt), 0.0, -np.cos(tilt)), gravity=(0.0, 0.0, -g),
        resistance=tmj.Resistance(viscous=c),
    )  # fmt: skip
    run = tmj.simulate(scene, engine=FINE, duration=5.0)
    # (m ℓ²/3) θ̈ + (c ℓ³/3) θ̇ + (m g ℓ/2) θ = 0
    rate = 0.5 * c * length / m
    omega = np.sqrt(1.5 * g / length - rate**2)
    wave = np.cos(omega * run.time) + rate / omega * np.sin(omega * run.time)
    expected = length * np.sin(tilt) * np.exp(-rate * run.time) * wave
    # θ - sin θ slows it by θ²/16 = 6e-10, 1.3e-8 of a radian of phase after 5 s.
    assert np.abs(run.nodes[:, 1, 0] - expected).max() <= 2e-8 * length * tilt
    assert run.energy_residual <= 1e-13


@pytest.mark.parametrize(
    ("direction", "coefficient"), [((1.0, 0.0, 0.0), 1.2), ((0.0, 0.0, 1.0), 0.3 * np.pi)], ids=["flat", "upright"]
)
def test_a_falling_rod_comes_to_its_terminal_velocity(direction, coefficient):
    g, m, length, diameter, density = 9.81, 0.05, 0.8, 0.04, 1.225
    drag = tmj.model.Drag(1.2, 0.3, density)
    scene = single_rod(
        length, m, direction=direction, gravity=(0.0, 0.0, -g), resistance=tmj.Resistance(drag=drag)
    )  # fmt: skip
    run = tmj.simulate(scene, engine=FINE, duration=4.0)
    terminal = np.sqrt(2 * m * g / (density * coefficient * diameter * length))
    fallen = -(terminal**2 / g) * np.log(np.cosh(g * run.time / terminal))
    assert np.abs(run.nodes[:, 0, 2] - fallen).max() <= 1e-9  # of 15 m, integrated to 1e-12
    assert run.velocities[-1, 0, 2] == pytest.approx(-terminal * np.tanh(g * 4.0 / terminal), rel=1e-11)
    assert run.dissipation[-1] == pytest.approx(-m * g * fallen[-1] - run.kinetic_energy[-1], rel=1e-10)


def test_two_rods_with_a_stiff_joint_swing_as_their_two_angles_do():
    (l1, l2), (m1, m2), g, kappa, gamma, c = (0.4, 0.3), (0.7, 0.5), 9.81, 2.5, 0.03, 0.2
    chain = hanging_chain([l1, l2], [m1, m2], planar=True)
    scene = chain.with_(resistance=tmj.Resistance(c, tmj.model.Bending(kappa, gamma)))

    def inertia(a, b):
        """Of the angles, for masses (or viscous coefficients times lengths) a, b of the rods."""
        return np.array([[a * l1**2 / 3 + b * l1**2, b * l1 * l2 / 2], [b * l1 * l2 / 2, b * l2**2 / 3]])

    bend = np.array([[1.0, -1.0], [-1.0, 1.0]])
    mass, stiffness = inertia(m1, m2), kappa * bend + np.diag([(m1 / 2 + m2) * g * l1, m2 * g * l2 / 2])
    damper = gamma * bend + inertia(c * l1, c * l2)
    zero, one = np.zeros((2, 2)), np.eye(2)
    state = np.block([[zero, one], [-np.linalg.solve(mass, stiffness), -np.linalg.solve(mass, damper)]])
    expected = np.sort_complex(np.linalg.eigvals(state))
    for engine in (FINE, tmj.MuJoCo(timestep=1e-3)):
        found = np.sort_complex(np.linalg.eigvals(tmj.linearize(scene, engine).A))
        # Differences of the sixth order over steps of 1e-3 of the size or so: 1e-13 / 1e-3.
        assert np.abs(found - expected).max() <= 1e-8 * np.abs(expected).max()


def test_multipliers_and_one_stage_integrators_know_it():
    scene = random_tree(np.random.default_rng(1), 5, False).with_(resistance=ALL)
    reference = tmj.simulate(scene, engine=FINE, duration=0.5)
    exchanged = reference.dissipation[-1]
    assert exchanged > 10
    assert np.ptp(reference.bending_energy) > 0.1
    fine = tmj.simulate(scene, engine=tmj.MuJoCo(timestep=1e-3), duration=0.5)
    # λ of the one is the engine's own, and of the other found afterwards from forces by NumPy.
    assert np.abs(fine.multipliers - reference.multipliers).max() <= 1e-7 * np.abs(reference.multipliers).max()
    for integrator in (tmj.Integrator.EULER, tmj.Integrator.IMPLICIT):
        first, second = (
            tmj.simulate(scene, engine=tmj.MuJoCo(timestep=h, integrator=integrator), duration=0.5)
            for h in (1e-3, 5e-4)
        )
        assert second.energy_residual <= 1e-2 * exchanged
        assert second.energy_residual <= 0.6 * first.energy_residual  # of the first order


def test_one_step_of_a_held_force_is_counted_at_both_its_ends():
    # Constant wind on a rod so heavy that its speed hardly changes: the wind's work over one step is F w h.
    drag = tmj.model.Drag(1.2, 0.0, 1000.0)
    scene = single_rod(mass=1e6, resistance=tmj.Resistance(drag=drag, wind=(0.0, 2.0, 0.0)))
    engine = tmj.MuJoCo(timestep=0.01, integrator=tmj.Integrator.EULER)
    run = tmj.simulate(scene, engine=engine, duration=0.05, output_interval=0.01)
    power = 0.5 * 1000.0 * 1.2 * 0.04 * 0.8 * 2.0**3
    assert np.abs(run.external_work - power * run.time).max() <= 1e-5 * power * 0.05  # v / w = 4e-7 / 2 at the end


@pytest.mark.third_means("elements.let_act", "elements.held_powers", by="energy of 0.94^n")
@pytest.mark.parametrize("integrator", [tmj.Integrator.EULER, tmj.Integrator.IMPLICIT, tmj.Integrator.DISCRETE])
def test_one_step_methods_are_stable_and_exact_in_energy_up_to_the_limit_of_the_docs_and_reported_beyond(integrator):
    # u' = u - h c ℓ u / m: the factor is -1 at h = 2 m / (c ℓ). The work of a held force is exact by the
    # speeds at both ends of a step.
    h, limit = 0.01, 2 * 0.5 / (0.8 * 0.01)
    velocities = np.array([[0.1, 0.5, -0.2], [0.1, 0.5, -0.2]])
    engine = tmj.MuJoCo(timestep=h, integrator=integrator)

    def run(c):
        scene = single_rod(resistance=tmj.Resistance(viscous=c), initial_velocities=velocities)
        return tmj.simulate(scene, engine=engine, duration=3.0)

    found = run(0.97 * limit)
    assert found.kinetic_energy[-1] == pytest.approx(found.kinetic_energy[0] * 0.94**600, rel=1e-9)
    assert found.energy_residual <= 1e-13 * found.dissipation[-1]
    expected = pytest.warns(tmj.errors.StabilityWarning, match=f"beyond the largest stable one, {h / 1.03:.4g} s")
    with expected, pytest.raises(tmj.errors.DivergenceError, match="energy came from nowhere"):
        run(1.03 * limit)


def test_single_rods_are_the_same_in_the_ode_in_ensembles_and_under_moved_supports():
    plain = tmj.Resistance(0.2, None, tmj.model.Drag(1.1, 0.3, 40.0), (0.3, 0.0, 0.1))
    motion = tmj.model.Motion.circular("rod", 0.05, 1.3, (0.0, 0.0, 1.0))
    scene = single_rod(
        support=tmj.Support.pinned(0.0), direction=(1.0, 0.0, -1.0), gravity=(0.0, 0.0, -9.81), motions=(motion,),
        resistance=plain,
    )  # fmt: skip
    reference = tmj.simulate(scene, engine=FINE, duration=1.0)
    assert reference.energy_residual <= 1e-9
    run = tmj.simulate(scene, engine=tmj.MuJoCo(timestep=1e-3), duration=1.0)
    assert tmj.compare(run, reference).max_node_error <= 1e-8
    assert run.energy_residual <= 1e-6
    assert np.abs(run.multipliers - reference.multipliers).max() <= 1e-6 * np.abs(reference.multipliers).max()
    other = tmj.simulate(scene, engine=tmj.ODE(rtol=1e-12, atol=1e-13), duration=1.0)
    assert tmj.compare(other, reference).max_node_error <= 1e-9
    still = scene.with_(motions=(), initial_velocities=None)
    scenes = [still, still.with_(resistance=tmj.Resistance(0.5))]
    for found, one in zip(
        tmj.simulate_many(scenes, engine=tmj.MuJoCo(timestep=1e-3), duration=0.3), scenes, strict=True
    ):
        alone = tmj.simulate(one, engine=tmj.MuJoCo(timestep=1e-3), duration=0.3)
        assert np.array_equal(found.nodes, alone.nodes)
        assert np.array_equal(found.dissipation, alone.dissipation)


def test_a_law_in_mujocos_own_loop_meets_it_too():
    scene = tmj.load_scene("prism").with_(resistance=tmj.Resistance(5.0, None, tmj.model.Drag(1.0, 0.0, 1000.0)))
    engine = tmj.MuJoCo(timestep=1e-3)

    def law(time, nodes, velocities):
        return np.full(len(scene.structure.strings), 30.0)

    alone = tmj.simulate(scene, law, engine, duration=0.1)
    with tmj.law_in(scene, law, engine) as model:
        data = mujoco.MjData(model)
        mujoco.mj_step(model, data, 100)
    mujoco.mj_kinematics(model, data)
    sites = [model.site(name).id for name in scene.structure.nodes]
    assert np.array_equal(data.site_xpos[sites], alone.nodes[-1])  # the same compiled code
    without = tmj.simulate(scene.with_(resistance=None), law, engine, duration=0.1)
    assert tmj.compare(alone, without).max_node_error > 1e-6


def test_a_scene_without_resistance_has_no_trace_of_it():
    scene = single_rod()
    plant = Plant(scene, native_law(None, scene.structure), Actuation.continuous(), OnInfeasible.STOP)
    assert plant["element_count"] == 0
    assert not tmj.simulate(scene, engine=FINE, duration=0.1).bending_energy.any()


def test_files_keep_it_and_trajectories_of_files_know_their_energy(tmp_path):
    chain = hanging_chain([0.4, 0.25], [1.0, 1.0])
    named = tmj.Resistance(
        0.1, tmj.model.Bending(1.5, 0.0, (("r1", "r0"),)), tmj.model.Drag(diameter=0.1), (0.1, 1 / 3, 0.0)
    )
    for resistance in (ALL, named, tmj.Resistance(viscous=2.0), tmj.Resistance(drag=tmj.model.Drag())):
        scene = chain.with_(resistance=resistance)
        assert scene_from_toml(scene_to_toml(scene)) == scene
    assert "resistance" not in scene_to_toml(chain)
    run = tmj.simulate(chain.with_(resistance=ALL), engine=FINE, duration=0.2)
    again = tmj.Trajectory.load(run.save(tmp_path / "run.nc"))
    assert run.bending_energy[-1] > 1e-6
    assert np.array_equal(again.bending_energy, run.bending_energy)
    assert again.energy_residual == run.energy_residual
    text = scene_to_toml(chain.with_(resistance=named))
    for wrong, message in (
        (text.replace("pairs", "pair"), "unknown key 'pair'"),
        (text.replace('"r1", "r0"', '"r1"'), "list of pairs of rods"),
        (text.replace("viscous = 0.1", "viscous = [0.1]"), "it must be a number"),
    ):
        assert wrong != text
        with pytest.raises(tmj.errors.FormatError, match=message):
            scene_from_toml(wrong)


@pytest.mark.parametrize(
    ("resistance", "message"),
    [
        (lambda: 3.0, "use Resistance"),
        (lambda: tmj.Resistance(), "neither viscous forces nor bending nor drag"),
        (lambda: tmj.Resistance(viscous=-1.0), "resistance: viscous = -1.0; it must be >= 0 N s/m²"),
        (lambda: tmj.Resistance(viscous=float("nan")), "viscous = nan"),
        (lambda: tmj.Resistance(1.0, wind=(0.0, 1.0)), "resistance: wind = .* three finite numbers"),
        (lambda: tmj.Resistance(bending=tmj.model.Bending(1.0), wind=(0.0, 1.0, 0.0)), "leave wind out"),
        (lambda: tmj.Resistance(bending=2.0), "use Bending"),
        (lambda: tmj.Resistance(bending=tmj.model.Bending(-1.0)), "bending: stiffness = -1.0; it must be >= 0 N m"),
        (lambda: tmj.Resistance(bending=tmj.model.Bending(1.0, "x")), "bending: damping = 'x'"),
        (
            lambda: tmj.Resistance(bending=tmj.model.Bending(1.0, 0.0, (("r0", "r9"),))),
            "unknown rod 'r9'; the rods are 'r0', 'r1', 'r2'",
        ),
        (
            lambda: tmj.Resistance(bending=tmj.model.Bending(1.0, 0.0, (("r0", "r2"),))),
            "two that share exactly one node",
        ),
        (
            lambda: tmj.Resistance(bending=tmj.model.Bending(1.0, 0.0, (("r0", "r0"),))),
            "two that share exactly one node",
        ),
        (lambda: tmj.Resistance(bending=tmj.model.Bending(1.0, 0.0, (("r0",),))), "it must name two rods"),
        (lambda: tmj.Resistance(bending=tmj.model.Bending(1.0, 0.0, 5)), "it must be a sequence"),
        (lambda: tmj.Resistance(bending=tmj.model.Bending(1.0, 0.0, (("r0", "r1"), ("r1", "r0")))), "are named twice"),
        (lambda: tmj.Resistance(bending=tmj.model.Bending(1.0, 0.0, ())), "name the two rods of each joint"),
        (lambda: tmj.Resistance(drag=1.2), "use Drag"),
        (lambda: tmj.Resistance(drag=tmj.model.Drag(-1.0)), "drag: normal = -1.0"),
        (lambda: tmj.Resistance(drag=tmj.model.Drag(tangential=-1.0)), "drag: tangential = -1.0"),
        (lambda: tmj.Resistance(drag=tmj.model.Drag(density=0.0)), "drag: density = 0.0; it must be > 0 kg/m³"),
        (lambda: tmj.Resistance(drag=tmj.model.Drag(diameter=0.0)), "drag: diameter = 0.0; it must be > 0 m, or None"),
    ],
)
def test_what_makes_no_sense_is_refused_in_words(resistance, message):
    chain = hanging_chain([0.4, 0.25, 0.3], [1.0, 1.0, 1.0])
    with pytest.raises(tmj.errors.SceneError, match=message):
        chain.with_(resistance=resistance())


def test_the_cable_takes_it_and_who_cannot_says_so():
    scene = cable(viscous=0.01, bending_stiffness=1e-4, bending_damping=1e-5, drag=1.1, duration=0.2)
    assert scene.resistance == tmj.Resistance(0.01, tmj.model.Bending(1e-4, 1e-5), tmj.model.Drag(1.1))
    assert cable().resistance is None
    with pytest.raises(tmj.errors.OptionError, match="viscous = -1"):
        cable(viscous=-1)
    run = tmj.simulate(scene, engine=FINE, duration=0.2)
    other = tmj.simulate(scene, engine=tmj.MuJoCo(timestep=1e-3), duration=0.2)
    assert tmj.compare(run, other).max_node_error <= 1e-7
    found = describe(scene)
    assert found["motions"] == {"rod1": "0.05 m at 0.5 Hz"}
    assert found["resistance"] == (
        "viscous, 0.01 N s/m²; drag, C = 1.1 across, 1.225 kg/m³; "
        "bending of joints of two rods, 0.0001 N m and 1e-05 N m s"
    )
    assert any("resists motion" in reason for reason in found["needs"]["reasons"])
