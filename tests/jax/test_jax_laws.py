"""Laws as array functions: those of the package against their compiled form, derivatives, batches, policies."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

jax = pytest.importorskip("jax")
pytest.importorskip("diffrax")

import jax.numpy as jnp  # noqa: E402
from engine_accelerations import mujoco_accelerations_at  # noqa: E402
from pulley_scenes import ringed  # noqa: E402
from random_laws import random_law  # noqa: E402
from rope_scenes import mast  # noqa: E402

import tensegrity_mj as tmj  # noqa: E402
from evidence.random_structures import random_configuration, random_scene, random_structure  # noqa: E402
from tensegrity_mj.controllers import Lyapunov, Onto, Program, Projection, Replay, from_scene  # noqa: E402
from tensegrity_mj.controllers.allocation import least_norm as compiled_least_norm  # noqa: E402
from tensegrity_mj.dynamics.native.law import Command, Report  # noqa: E402
from tensegrity_mj.dynamics.target import target_nodes  # noqa: E402
from tensegrity_mj.engines.jax.laws import ArrayPolicy, array_law  # noqa: E402
from tensegrity_mj.engines.jax.thesis_laws import least_norm, least_squares  # noqa: E402
from tensegrity_mj.errors import OptionError  # noqa: E402
from tensegrity_mj.model.target import chebyshev_points  # noqa: E402

EPS = np.finfo(float).eps
MARGIN, V = Report.FEASIBILITY_MARGIN, Report.LYAPUNOV


def random_case(seed, mode="lyapunov", **more):
    """A law, a structure of all kinds of rods, and a state in motion."""
    rng = np.random.default_rng(seed)
    structure = random_structure(rng, rods=3, strings=9, point_masses=1, own_planes=0.3)
    scene = random_scene(rng, structure, displaced=0.3, moving=0.7, gravity=True)
    law = random_law(rng, structure, scene.gravity, path=seed % 2 == 1)
    options = {name: getattr(law, name) for name in ("decay_rate", "translation", "rotation", "gravity")}
    options |= {"minimum_force_density": law.minimum_force_density} | more
    if mode == "lyapunov":
        return scene, Lyapunov(structure, law.target, **options)
    roots = {rod.name: rng.normal(size=(3, 2)) for rod in structure.rods}
    stiffness = {name: root @ root.T for name, root in roots.items()}
    return scene, Projection(structure, law.target, onto=Onto(mode), stiffness=stiffness, **options)


def assert_agrees(law, states, structure=None):
    """u and report of both; each is right for arguments off by some roundings, and no more than 64 of them.

    A number is a sum of products of which none has more than 64 factors and terms, so that it is that of nodes,
    velocities and parameters off by 64 eps of each: its error is the sum over them of derivative times value, in both.
    """
    own = array_law(law, structure or law.structure)

    def both(t, x, v):
        u, report = own.command(own.parameters, t, x, v)
        return 2 * (jnp.concatenate([u, report[:4]]),)

    evaluate = jax.jit(jax.jacfwd(both, (1, 2), has_aux=True))  # in one program, as each takes a second to compile
    seen = 0
    for t, x, v in states:
        u, report = law.reported(t, x, v)
        slopes, found = jax.tree.map(np.asarray, evaluate(t, x, v))
        by_x, by_v = (np.abs(one) for one in slopes)
        room = np.einsum("kna,na->k", by_x, np.abs(x) + 1.0) + np.einsum("kna,na->k", by_v, np.abs(v) + 1.0)
        expected = np.concatenate([u, report[:4]])
        assert (found[len(u)] > 0) == (report[MARGIN] > 0)
        finite = np.isfinite(expected)
        np.testing.assert_array_equal(found[~finite], expected[~finite])
        error = np.abs(found - expected)[finite]
        assert np.all(error <= 2 * 64 * EPS * (room + np.abs(expected))[finite]), error
        seen += report[MARGIN] > 0
    return seen


@pytest.mark.parametrize(
    ("seed", "mode", "more"),
    [
        (0, "lyapunov", {"minimum_force_density": 0.0}),
        (1, "current", {}),
        (2, "target", {"maximum_force_density": 20.0}),
        (3, "target", {"norm": 1, "maximum_force_density": 5.0}),
        (4, "lyapunov", {"norm": math.inf, "maximum_force_density": [5.0, np.inf, 1.0] * 3}),
        (5, "current", {"norm": math.inf, "minimum_force_density": 0.0}),
        (7, "lyapunov", {"norm": 1}),
    ],
    ids=str,
)
def test_laws_of_chapters_5_and_6(seed, mode, more):
    scene, law = random_case(seed, mode, **more)
    near = law.target.nodes[-1] + 0.0
    states = [(t, scene.nodes0, scene.velocities0) for t in (-0.1, 0.0, 0.7, 1.0, 1.9, 2.5, 3.0)]
    states += [(3.0, near, 1e-3 * scene.velocities0)]
    assert assert_agrees(law, states)


@pytest.mark.parametrize("name", ["prism", "pinned_rod", "pinned_rod_mirror"])
def test_shipped_scenes(name):
    scene = tmj.load_scene(name)
    run = tmj.simulate(scene, from_scene(scene), tmj.DAE(), duration=3.0, output_interval=0.5)
    states = list(zip(run.time, run.nodes, run.velocities, strict=True))
    assert assert_agrees(from_scene(scene), states) == len(states)


def test_what_is_known_of():
    """Water, whose added mass rods answer forces with, a load and viscous forces."""
    scene = tmj.load_scene("shape_control")
    known = (scene.water, tmj.model.Load("n1", (1.0, -2.0, 0.5), 3.0), tmj.model.Resistance(viscous=0.5))
    law = Lyapunov(scene.structure, scene.target, gravity=scene.gravity, known=known, minimum_force_density=20.0)
    run = tmj.simulate(scene, from_scene(scene), tmj.DAE(), duration=1.0, output_interval=0.5)
    rows = list(zip(run.time, run.nodes, run.velocities, strict=True))[1:]  # not at rest at the target
    states = [(t, x, s * v) for t, x, v in rows for s in (-1.0, 1.0)]
    assert assert_agrees(law, states)


def test_rods_through_the_surface_whose_added_mass_is_not_symmetric():
    """Hermite's weights give a wet part's load to other ends than those by which it is moved."""
    rng = np.random.default_rng(0)
    structure = random_structure(rng, rods=3, strings=9, point_masses=1, own_planes=0.3)
    nodes = {name: (x, y, z + 0.6) for name, (x, y, z) in structure.nodes.items()}
    rods = tuple(replace(rod, radius=0.05) for rod in structure.rods)
    structure = replace(structure, nodes=nodes, rods=rods)
    scene = random_scene(rng, structure, displaced=0.3, moving=0.7, gravity=True)
    target = random_law(rng, structure, scene.gravity, path=False).target
    water = tmj.model.Water(weights="hermite")
    law = Lyapunov(structure, target, gravity=(0.0, 0.0, -9.81), known=(water,), minimum_force_density=1.0)
    assert 0.1 < np.mean(scene.nodes0[:, 2] > 0) < 0.9
    assert assert_agrees(law, [(0.0, scene.nodes0, scene.velocities0)])


def test_ceilings_of_the_state_and_strings_over_pulleys():
    scene = ringed()
    structure = scene.structure.with_strings(min_rest_length=0.05)
    target = tmj.Target.set_point(scene.structure.moved((0.05, -0.02, 0.1), (0.0, 0.1, 0.2)).positions)
    law = Projection(structure, target, stiffness=1.0, minimum_force_density=5.0)
    assert law.limits.of_state
    assert assert_agrees(law, [(0.0, scene.nodes0, s * scene.velocities0) for s in (-0.3, -0.1, 0.1, 0.3)])


def test_a_curve():
    """Positions of its nodes are those of `target_nodes`, to the roundings of a polynomial with terms of that size."""
    rng = np.random.default_rng(4)
    structure = random_structure(rng, rods=2, strings=6, point_masses=1, support="free")
    first = random_configuration(rng, structure, 0.1)
    parameters = chebyshev_points(0.0, 1.0, 12)
    shapes = [structure.moved((0.3 * s, 0.2 * s**2, 0.0), (0.0, 0.0, s)).positions.copy() for s in parameters]
    still = [structure.node_index[name] for name in structure.fixed_nodes]
    for shape in shapes:
        shape[still] = structure.positions[still]
    target = tmj.Target.curve([0.5, 1.0, 2.0], [0.1, 0.4, 0.9], parameters, shapes, [0.3, 0.1, 0.2])
    law = Lyapunov(structure, target, minimum_force_density=0.01)
    moments = np.array([0.0, 0.5, 0.8, 1.0, 1.5, 2.0, 3.0])
    states = [(t, first, 0.1 * rng.normal(size=first.shape)) for t in moments]
    assert assert_agrees(law, states)
    assert target_nodes(structure, target, moments).std(axis=0).max() > 0.05


def test_v_falls_as_promised_under_mujocos_own_accelerations():
    """V̇ = -δ V: along x + h v + h² a/2, v + h a, which is the motion to second order, by differences of order 4."""
    scene = tmj.load_scene("prism")
    law = from_scene(scene)
    own = array_law(law, scene.structure)
    command = jax.jit(lambda t, x, v: own.command(own.parameters, t, x, v))
    run = tmj.simulate(scene, law, tmj.DAE(), duration=1.0, output_interval=0.5)
    for t, x, v in zip(run.time, run.nodes, run.velocities, strict=True):
        u, report = command(t, x, v)
        a = mujoco_accelerations_at(scene, x, v, np.asarray(u))
        h = 1e-3
        values = [
            float(command(t + s, x + s * v + 0.5 * s**2 * a, v + s * a)[1][V]) for s in h * np.array([-2, -1, 1, 2])
        ]
        rate = (values[0] - 8 * values[1] + 8 * values[2] - values[3]) / (12 * h)
        now = float(report[V])
        # Truncation h⁴ V⁽⁵⁾/30 with V⁽⁵⁾ of 100 V: 3e-12 V. Round-off: eps V/h = 2e-13 V, and of x, eps x (∂V/∂x)/h.
        assert abs(rate + law.decay_rate * now) <= 1e-10 * now + 1e-12


def test_derivatives_by_parameters():
    """Against differences of order 4, whose error is at most what halving h changes; round-off 1e-13 of y over h."""
    scene, law = random_case(1, "current")
    own = array_law(law, law.structure)
    weights = np.random.default_rng(0).normal(size=9)

    @jax.jit
    def result(p):
        u, report = own.command(p, 0.7, scene.nodes0, scene.velocities0)
        return u @ weights + report[V]

    rng = np.random.default_rng(1)
    leaves, tree = jax.tree_util.tree_flatten(own.parameters)
    slopes = jax.tree_util.tree_leaves(jax.jit(jax.grad(result))(own.parameters))
    value = abs(float(result(own.parameters)))
    for number, (leaf, slope) in enumerate(zip(leaves, slopes, strict=True)):
        way = rng.normal(size=np.shape(leaf))
        h = 2e-4 * float(np.abs(leaf).max())
        if h == 0:
            continue

        def moved(s, number=number, way=way):
            changed = [leaf + s * way if n == number else leaf for n, leaf in enumerate(leaves)]
            return float(result(jax.tree_util.tree_unflatten(tree, changed)))

        wide, narrow = ((moved(-2 * d) - 8 * moved(-d) + 8 * moved(d) - moved(2 * d)) / (12 * d) for d in (h, h / 2))
        found = float(np.sum(np.asarray(slope) * way))
        room = abs(wide - narrow) + 1e-13 * value / h
        assert room <= 1e-6 * (abs(found) + value)
        assert abs(found - narrow) <= room, (number, found, narrow)


def test_no_derivative_is_nan_at_the_target():
    scene = tmj.load_scene("prism")
    law = from_scene(scene, minimum_force_density=0.1)
    own = array_law(law, scene.structure)
    x = law.target.nodes[0]

    @jax.jit
    def result(p, x, v):
        return own.command(p, 0.0, x, v)[0].sum()

    for slope in jax.tree_util.tree_leaves(jax.jit(jax.grad(result, (0, 1, 2)))(own.parameters, x, 0 * x)):
        assert np.all(np.isfinite(slope))


def test_batches_are_single_ones():
    """But for the order of sums; parameters may have batches, too."""
    scene, law = random_case(1, "current", norm=math.inf, maximum_force_density=3.0)
    own = array_law(law, law.structure)
    factors = np.array([1.0, 1.1, 1.2])
    x, v = np.repeat(scene.nodes0[..., None], 3, axis=2), scene.velocities0[..., None] * np.array([0.5, 1.0, -0.7])
    p = jax.tree_util.tree_map(lambda leaf: np.asarray(leaf)[..., None] * factors, own.parameters)
    command = jax.jit(own.command)
    batches = command(p, 0.7, x, v), command(own.parameters, 0.7, x, v)
    for number, factor in enumerate(factors):
        scaled = jax.tree_util.tree_map(lambda leaf, f=factor: np.asarray(leaf) * f, own.parameters)
        for batch, parameters in zip(batches, (scaled, own.parameters), strict=True):
            alone = command(parameters, 0.7, x[..., number], v[..., number])
            for many, few in zip(batch, alone, strict=True):
                np.testing.assert_allclose(many[..., number], few, rtol=1e-11)


@pytest.mark.parametrize("norm", [1.0, 2.0, math.inf])
def test_allocation(norm):
    """Against the compiled form, over ties, nothing to do, and no way to do it; in one batch."""
    rng = np.random.default_rng(5)
    M, B = 7, 400
    v = np.round(rng.normal(size=(M, B)), 1)
    alpha = rng.choice([-3.0, -0.5, 0.0, 0.7, 20.0], B)
    floor = rng.choice([0.0, 0.2, 0.5], (M, B))
    capped = np.array([True, False, True, True, False, True, True])
    ceiling = floor + rng.choice([0.0, 0.5, 3.0, 30.0], (M, B))
    ceiling[0, :3] -= 1.0
    together = jax.jit(lambda *given: least_norm(*given, capped, norm))
    u, margin = map(np.asarray, together(v, alpha, floor, np.where(capped[:, None], ceiling, 0.0)))
    scarce = 0
    for b in range(B):
        out = np.zeros(M)
        most = np.where(capped, ceiling[:, b], np.inf)
        expected = compiled_least_norm(v[:, b].copy(), alpha[b], floor[:, b].copy(), most, norm, out)
        # Sums of seven terms of one size, divided by w of 0.1 or more: 1e-14 of α and of v ū over 0.1.
        size = 10 * (abs(alpha[b]) + np.abs(v[:, b]) @ floor[:, b]) + 1
        rest = abs(alpha[b] - v[:, b] @ floor[:, b])
        if rest < 1e-12 * size:  # round-off decides whether anything is left to do
            continue
        np.testing.assert_allclose(u[:, b], out, rtol=0, atol=1e-13 * size, err_msg=str(b))
        if np.isfinite(expected):
            assert abs(margin[b] - expected) <= 1e-13 * size / rest * (1 + abs(expected))
        else:
            assert margin[b] == expected
        scarce += not expected > 0
    assert 0 < scarce < B // 2


def test_least_squares_without_bounds():
    v, alpha = np.array([[1.0, 1.0], [-2.0, -2.0], [0.5, 0.0]]), np.array([0.5, -2.0])
    u, margin = least_squares(v, alpha)
    np.testing.assert_allclose(u, [[0.4, 0.0], [0.0, 1.0], [0.2, 0.0]], rtol=1e-15)
    np.testing.assert_allclose(margin, [2.0, 1.0], rtol=1e-15)
    assert not np.any(least_squares(-np.abs(v), np.ones(2))[0])


def test_programs_and_recordings():
    scene = tmj.load_scene("six_bar_roll")
    program = from_scene(scene)
    assert isinstance(program, Program)
    times = np.array([0.0, 0.5, 0.6, 1.5, 2.0])
    values = np.random.default_rng(0).uniform(0.5, 1, (5, len(scene.structure.strings)))
    laws = (program, Replay(times, values), Replay(times, values, Command.FORCE_DENSITY, held=True))
    for law in laws:
        own = array_law(law, scene.structure)
        assert own.returns_lengths == (law.command is Command.REST_LENGTH)
        evaluate = jax.jit(own.command)
        for t in (-1.0, 0.0, 0.55, 0.6, 0.6 - 1e-13, 1.2, 2.0, 20.0):
            u, report = evaluate(own.parameters, t, scene.nodes0, scene.velocities0)
            # A cubic of its coefficients, which are of the values' size on pieces of 0.1 s: 1/0.1³ of their round-off.
            np.testing.assert_allclose(u, law(t, scene.nodes0, scene.velocities0), rtol=1e3 * EPS)
            assert np.all(np.isnan(report))
        batch = np.repeat(scene.nodes0[..., None], 2, axis=2)
        assert evaluate(own.parameters, 0.3, batch, batch)[0].shape == (24, 2)


@pytest.mark.parametrize("command", Command)
def test_commands_of_ropes_are_spread(command):
    scene = mast(segments=3)
    ask = np.array([20.0, 50.0, 30.0]) if command is Command.FORCE_DENSITY else np.array([1.0, 0.75, 1.0])
    law = ArrayPolicy(lambda p, t, x, v: p * (1 + 0.1 * jnp.sin(x[1, 0] + v[1, 1])), ask, command)
    run = tmj.simulate(scene, law, tmj.DAE(), duration=0.05, output_interval=0.01)
    own = array_law(law, scene.structure)
    assert own.returns_lengths
    command = jax.jit(own.command)
    for t, x, v, expected in zip(run.time, run.nodes, run.velocities, run.rest_lengths, strict=True):
        found, _ = command(own.parameters, t, x, v)
        np.testing.assert_allclose(found, expected, rtol=16 * EPS)
    x = np.stack([run.nodes[0], run.nodes[-1]], axis=-1)
    np.testing.assert_allclose(command(own.parameters, 0.0, x, 0 * x)[0].shape, (len(scene.structure.strings), 2))


def test_a_policy_is_a_law_of_every_engine():
    scene = tmj.load_scene("prism")

    def push(p, t, x, v):
        return p["level"] + p["gain"] * jnp.tanh(x[:, 2].sum() + jnp.sin(t)) * jnp.ones(12)

    law = ArrayPolicy(push, {"level": 0.5, "gain": np.float64(0.1)})
    assert law.describe() == {"law": "push", "parameters": 2}
    x, v = scene.nodes0, scene.velocities0
    expected = 0.5 + 0.1 * np.tanh(x[:, 2].sum() + np.sin(0.3)) * np.ones(12)
    np.testing.assert_allclose(law(0.3, x, v), expected, rtol=4 * EPS)
    runs = [tmj.simulate(scene, law, engine, duration=0.1) for engine in (tmj.MuJoCo(timestep=1e-3), tmj.DAE())]
    assert tmj.compare(*runs).max_node_error < 1e-6
    own = array_law(law, scene.structure)
    u, report = jax.jit(own.command)(own.parameters, 0.3, np.stack([x, x], axis=-1), np.stack([v, v], axis=-1))
    np.testing.assert_allclose(u, np.stack([expected, expected], axis=-1), rtol=4 * EPS)
    assert report.shape == (5, 2)


def test_what_is_no_array_law_is_refused():
    scene = tmj.load_scene("prism")

    def plain(time, nodes, velocities):
        return np.ones(12)

    with pytest.raises(OptionError, match=r"law plain has no array function: state it .* as engines.ArrayPolicy"):
        array_law(plain, scene.structure)
    plain.arrays = "nowhere:at_all"
    with pytest.raises(OptionError, match=r"arrays = 'nowhere:at_all' cannot be imported"):
        array_law(plain, scene.structure)
    few = ArrayPolicy(lambda p, t, x, v: jnp.ones(3), {})
    with pytest.raises(OptionError, match=r"law <lambda>: it returned shape \(3,\); it must return \(12,\)"):
        array_law(few, scene.structure)
    ones = jnp.ones(12)
    for function, parameters in (
        (lambda p, t, x, v: ones if t > 0 else 2 * ones, {}),
        (lambda p, t, x, v: float(x[0, 0]) * ones, {}),
        (lambda p, t, x: ones, {}),
        (lambda p, t, x, v: p["gain"] * ones, {}),
        (lambda p, t, x, v: p["gain"] * ones, {"gain": "much"}),
    ):
        with pytest.raises(OptionError, match="law <lambda>: it failed within JAX: "):
            array_law(ArrayPolicy(function, parameters), scene.structure)
    listed = array_law(ArrayPolicy(lambda p, t, x, v: [t] * 12, {}), scene.structure)
    np.testing.assert_array_equal(listed.command({}, 0.5, scene.nodes0, scene.velocities0)[0], np.full(12, 0.5))
    law = from_scene(tmj.load_scene("pinned_rod"))
    with pytest.raises(OptionError, match="other nodes or strings"):
        array_law(law, scene.structure)


def test_structures_without_rods_have_laws() -> None:
    """A point mass on four strings: no rod's equation, and the same command to round-off."""
    nodes = [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [0.3, 0.3, 0.3]]
    numbers = {"rod_mass": 1.0, "stiffness": 100.0, "rest_length": 0.3}
    structure = tmj.Structure.from_arrays(
        nodes, [], [(n, 4) for n in range(4)], **numbers, fixed_nodes=range(4), point_masses={4: 1.0}
    )
    target = structure.positions.copy()
    target[4] = [0.25, 0.25, 0.3]
    law = Lyapunov(structure, target)
    arrays = array_law(law, structure)
    state = structure.positions, np.zeros((5, 3))
    u = jax.jit(arrays.command)(arrays.parameters, 0.0, *state)[0]
    np.testing.assert_allclose(u, law(0.0, *state), rtol=64 * EPS * 4, atol=0)
