"""`linearize`: the three engines against each other, against closed forms, and against another code's frequencies."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import truth
from hanging_chain import linear_model
from numpy.typing import NDArray

import tensegrity_mj as tmj
from evidence.random_structures import random_configuration, random_scene, random_structure
from tensegrity_mj.cli import main
from tensegrity_mj.library.cable import Excitation, cable
from tensegrity_mj.linearization import Linearization, linearizing
from tensegrity_mj.linearization.chart import Chart
from tensegrity_mj.model.members import PointMass, Rod, String, Support
from tensegrity_mj.model.scene import Scene
from tensegrity_mj.model.strings import StringLaw
from tensegrity_mj.model.structure import Structure

Array = NDArray[np.float64]
ENGINES = {"dae": tmj.DAE(), "ode": tmj.ODE(), "mujoco": tmj.MuJoCo()}
# The project's bound between engines. Each has 5e-14 of k from its differences, times condition numbers of M below 1e3
# (MuJoCo's round-off of 1e-10 in accelerations, tests/engines/test_engines_agree.py, over h = 0.02 would be 5e-9).
AGREEMENT = 1e-6
ROUND_OFF = 1e-9  # what all of them do reach, see above


def linearized(scene: Scene, **options: Any) -> dict[str, Linearization]:
    return {name: tmj.linearize(scene, engine, **options) for name, engine in ENGINES.items()}


def assert_equal(models: dict[str, Linearization], bound: float = ROUND_OFF) -> float:
    """A, B, C and the residual of all engines, relative to the largest entry of each."""
    assert bound <= AGREEMENT
    worst = 0.0
    reference = models["dae"]
    for name, model in models.items():
        for what in ("A", "B", "C", "residual"):
            ours, theirs = getattr(model, what), getattr(reference, what)
            assert ours.shape == theirs.shape
            scale = max(float(np.abs(theirs).max(initial=0.0)), 1.0)
            error = float(np.abs(ours - theirs).max(initial=0.0)) / scale
            assert error <= bound, (name, what, error)
            worst = max(worst, error)
    return worst


@pytest.mark.parametrize("name", ["pinned_rod", "prism", "tbar"])
@pytest.mark.parametrize("inputs", list(tmj.Command))
def test_engines_agree_on_the_shipped_scenes(name: str, inputs: tmj.Command) -> None:
    scene = tmj.load_scene(name)
    models = linearized(scene, inputs=inputs)
    worst = assert_equal(models)
    print(f"{name}, {inputs.value}: A, B, C differ by {worst:.1e}")
    model = models["dae"]
    n = len(model.coordinates)
    assert model.A.shape == (2 * n, 2 * n)
    assert model.B.shape == (2 * n, len(scene.structure.strings))
    assert np.array_equal(model.A[:n], np.eye(2 * n)[n:])
    assert np.abs(model.B[n:]).max() > 0
    # In a run on its way, with tension in the strings: nothing is special there.
    law = tmj.controllers.from_scene(scene) if scene.control is not None else None
    run = tmj.simulate(scene, law, tmj.DAE(), duration=0.5)
    assert_equal(
        linearized(
            scene,
            nodes=run.nodes[-1],
            velocities=run.velocities[-1],
            rest_lengths=run.rest_lengths[-1],
            time=0.5,
            inputs=inputs,
        )
    )


@pytest.mark.parametrize("planar", [False, True], ids=["space", "plane"])
@pytest.mark.parametrize("seed", range(4))
def test_engines_agree_on_random_structures(seed: int, planar: bool) -> None:
    """Every support, point masses, dampers, slack strings, gravity, loads, motion, both string laws."""
    rng = np.random.default_rng([seed, planar])
    structure = random_structure(
        rng,
        rods=1 + seed % 3,
        support=("free", "pinned", "constrained"),
        planar=planar,
        own_planes=0.3,
        point_masses=seed % 3,
        stretch=(-0.2, 0.4),
        damping=(0.0, 3.0),
        law=list(StringLaw)[seed % 2],
    )
    scene = random_scene(rng, structure, displaced=0.3, moving=2.0, gravity=True, loads=2)
    models = linearized(scene, time=0.3, inputs=list(tmj.Command)[seed // 2 % 2])
    print(f"A, B, C differ by {assert_equal(models):.1e}")
    assert np.array_equal(models["dae"].velocities, scene.velocities0)
    slack = scene.structure.string_lengths(scene.nodes0) < scene.structure.rest_lengths
    assert not models["dae"].B[:, slack].any()


def test_the_model_is_the_derivative_of_the_motion() -> None:
    """x of two runs from either side of the state: an integration, not a difference of forces."""
    rng = np.random.default_rng(3)
    structure = random_structure(rng, rods=2, point_masses=1, stretch=(0.3, 0.5), damping=(0.1, 0.5))
    scene = random_scene(rng, structure, moving=0.5, gravity=True)
    model = tmj.linearize(scene, tmj.ODE())
    chart = Chart(structure, scene.nodes0)
    n = chart.size
    _, rate0 = chart.coordinates(scene.nodes0, scene.velocities0)
    size, duration = 1e-4, 1e-4

    def moved(x: Array, duration: float) -> Array:
        nodes, velocities = chart.state(x[:n], rate0 + x[n:])
        start = scene.with_(initial_nodes=nodes, initial_velocities=velocities)
        run = tmj.simulate(start, None, tmj.DAE(tmj.Method.RK4, timestep=duration), duration=duration)
        return model.deviation(run.nodes[-1], run.velocities[-1])

    for unit in np.eye(2 * n):
        slopes = []
        for t in (duration, 0.5 * duration):
            change = (moved(size * unit, t) - moved(-size * unit, t)) / (2 * size)
            slopes.append((change - unit) / t)
        # Of A, 400 at most: with motions of 20 rad/s the next term is A (20 t)² / 6 = 3e-4; the round-off of positions
        # of about 1 m is eps / (size t) = 2e-8; size² times third derivatives of 1e4 are 1e-4.
        assert np.abs(2 * slopes[1] - slopes[0] - model.A @ unit).max() < 1e-3
    assert 100 < np.abs(model.A).max() < 500


def spring_mass(k: float = 12.0, c: float = 0.6, mass: float = 1.5, taut: bool = True) -> Scene:
    """A point mass between two fixed nodes along x, each string 1 m long with a rest length of 0.5 m (or 1 m)."""
    structure = Structure(
        "pair",
        {"left": (0, 0, 0), "mass": (1, 0, 0), "right": (2, 0, 0)},
        strings=tuple(
            String(name, pair, k, c, rest_length=0.5 if taut else 1.0)
            for name, pair in (("s1", ("left", "mass")), ("s2", ("mass", "right")))
        ),
        fixed_nodes=("left", "right"),
        point_masses=(PointMass("mass", mass),),
    )
    return Scene(structure)


@pytest.mark.parametrize("engine", ENGINES)
def test_closed_forms_of_a_mass_between_two_strings(engine: str) -> None:
    k, c, mass = 12.0, 0.6, 1.5
    model = tmj.linearize(spring_mass(k, c, mass), ENGINES[engine])
    across = k * (1 - 0.5)  # tension over length: 6 N/m
    expected = np.zeros((6, 6))
    expected[:3, 3:] = np.eye(3)
    expected[3:, :3] = -2 / mass * np.diag([k, across, across])
    expected[3, 3] = -2 * c / mass
    # Derivatives of order twelve: 5e-14 of k.
    assert np.abs(model.A - expected).max() < 1e-11
    assert np.abs(model.B[3:] - [[k / mass, -k / mass], [0, 0], [0, 0]]).max() < 1e-11
    assert model.is_equilibrium
    assert model.coordinates == ("point mass mass: z1", "point mass mass: z2", "point mass mass: z3")
    by_density = tmj.linearize(spring_mass(k, c, mass), ENGINES[engine], inputs=tmj.Command.FORCE_DENSITY)
    expected[3:, :3] = -2 / mass * across * np.eye(3)  # u held: a string of no rest length
    assert np.abs(by_density.A - expected).max() < 1e-11
    assert np.abs(by_density.B[3] - [-1 / mass, 1 / mass]).max() < 1e-11
    square, damping = 2 * k / mass, 2 * c / mass
    omega = [np.sqrt(2 * across / mass)] * 2 + [np.sqrt(square)]
    assert model.frequencies == pytest.approx(np.array(omega) / (2 * np.pi), rel=1e-9)
    assert model.damping_ratios == pytest.approx([0, 0, damping / (2 * np.sqrt(square))], abs=1e-9)
    # The fastest mode moves the mass along x alone.
    assert np.abs(np.abs(model.modes[:, -1]) - np.eye(9)[3]).max() < 1e-9


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("plane", [None, (0.0, 1.0, 0.0)], ids=["space", "plane"])
def test_closed_forms_of_pendulums(engine: str, plane: tuple[float, float, float] | None) -> None:
    """A rod pinned at its top, and one balanced on its foot: ω² = ±3 g / 2 ℓ. Turned away from the ODE's pole."""
    tilt = np.array([0.6, 0.0, 0.8])
    for sign in (1, -1):
        down = -tilt * sign
        structure = Structure(
            "pendulum",
            {"a": (0, 0, 0), "b": tuple(2 * down)},
            rods=(Rod("rod", ("a", "b"), 3.0, support=Support.pinned(0.0, plane=plane)),),
        )
        scene = Scene(structure, gravity=tuple(-9.81 * tilt))
        model = tmj.linearize(scene, ENGINES[engine])
        n = 2 if plane is None else 1
        square = 1.5 * 9.81 / 2
        assert np.abs(model.A[n:, :n] + sign * square * np.eye(n)).max() < 1e-11
        assert np.abs(model.residual).max() < 1e-13
        expected = np.sqrt(square)
        if sign > 0:
            assert model.frequencies == pytest.approx([expected / (2 * np.pi)] * n, rel=1e-12)
        else:
            assert model.eigenvalues.real.max() == pytest.approx(expected, rel=1e-12)
        # y = C x: the lower end moves by ℓ δ_b across the rod.
        assert np.abs(np.linalg.norm(model.C[3:6, :n], axis=0) - 2.0).max() < 1e-12
        assert np.abs(down @ model.C[3:6]).max() < 1e-12


@pytest.mark.parametrize("count", [13, 25])
def test_long_chains_swing_as_their_closed_form_says(count: int) -> None:
    """(3.13) and (3.14), from the lowest frequency to the highest, in both planes.

    A rod that much hangs on is analytic in a far shorter distance than its length, and differences over that of single
    rods are 2e-4 off for 40. Those that settle have 1e-12 of the largest entry of A, some ω_K², in each, so that ω_i²
    is known to 1e-12 ω_K² √K, of the norm of K such entries.
    """
    scene = cable(count, excitation=Excitation.NONE)
    expected = np.sort(linear_model(scene).frequencies)
    found = np.sort(tmj.linearize(scene, tmj.DAE()).frequencies).reshape(count, 2)
    bound = 0.5e-12 * np.sqrt(count) * (expected[-1] / expected) ** 2
    assert np.all(np.abs(found / expected[:, None] - 1) <= bound[:, None])


@pytest.mark.parametrize("engine", ENGINES)
def test_natural_frequencies_are_those_of_another_code(engine: str) -> None:
    """tnsgrt's steel prism: its softest mode is held by a prestress of 1e-7 of the stiffness (test_frequencies.py)."""
    data = truth.load("tnsgrt_prism_default")
    strings = int(data["n_strings"])
    structure = Structure.from_arrays(
        data["nodes"].T,
        data["members"].T[strings:],
        data["members"].T[:strings],
        rod_mass=data["mass"][strings:],
        stiffness=data["member_stiffness"][:strings],
        force_density=data["force_density"][:strings],
    )
    expected = np.sort(data["freq_hz_rigid_thin_bars_massless_strings"])[6:]
    model = tmj.linearize(Scene(structure), ENGINES[engine])
    assert model.is_equilibrium
    assert model.frequencies.shape == expected.shape
    error = np.abs(model.frequencies / expected - 1)
    print(f"{engine}: largest relative error of {len(expected)} frequencies: {error.max():.1e}")
    # 5e-14 of the stiffest ω², 2e7 times the softest: 1e-6 in ω², half of that in f.
    assert np.all(error <= 1e-6)


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("name", ["prism", "pinned_rod"])
def test_the_closed_loop_follows_the_law(engine: str, name: str) -> None:
    """A of the closed loop against differences of the accelerations under the law itself."""
    scene = tmj.load_scene(name)
    law = tmj.controllers.from_scene(scene)
    start = tmj.simulate(scene, law, tmj.DAE(), duration=0.3)
    model = tmj.linearize(
        scene, ENGINES[engine], nodes=start.nodes[-1], velocities=start.velocities[-1], law=law, time=0.3
    )
    assert model.warnings == ()
    assert model.rest_lengths == pytest.approx(start.rest_lengths[-1], rel=1e-12)
    chart = Chart(scene.structure, model.nodes)
    n = chart.size
    from tensegrity_mj.dynamics.native.law import native_law
    from tensegrity_mj.engines.request import Request

    moved = scene.with_(initial_nodes=model.nodes, initial_velocities=model.velocities)
    request = Request(
        moved,
        native_law(law, scene.structure),
        tmj.Actuation.continuous(),
        tmj.OnInfeasible.STOP,
        1.0,
        None,
        progress=False,
    )
    field = ENGINES[engine].accelerations(request)
    _, rate0 = chart.coordinates(model.nodes, model.velocities)

    def acceleration(x: Array) -> Array:
        nodes, velocities = chart.state(x[:n], rate0 + x[n:])
        return chart.accelerations(x[:n], rate0 + x[n:], field(0.3, nodes, velocities)[1])

    h = 1e-5
    columns = [(acceleration(h * e) - acceleration(-h * e)) / (2 * h) for e in np.eye(2 * n)]
    # h² times third derivatives of about 1e2, and 1e-14 / h: 1e-8.
    assert np.abs(model.A[n:] - np.column_stack(columns)).max() < 1e-7
    open_loop = tmj.linearize(
        scene,
        ENGINES[engine],
        nodes=model.nodes,
        velocities=model.velocities,
        rest_lengths=model.rest_lengths,
        time=0.3,
    )
    assert model.gain is not None
    assert np.abs(model.A - open_loop.A - open_loop.B @ model.gain).max() < 1e-12
    assert np.abs(model.A - open_loop.A).max() > 1e-2


def test_strings_at_the_edge_of_slackness_are_reported() -> None:
    for engine in ENGINES.values():
        model = tmj.linearize(spring_mass(taut=False), engine)
        assert len(model.warnings) == 1
        assert "s1, s2" in model.warnings[0]
        assert "taut side" in model.warnings[0]
        # The taut side: both strings pull.
        assert model.A[3, 0] == pytest.approx(-2 * 12.0 / 1.5, rel=1e-11)
    assert tmj.linearize(spring_mass(), tmj.DAE()).warnings == ()


def test_a_kink_of_the_law_is_reported() -> None:
    scene = spring_mass()

    def law(time: float, nodes: Array, velocities: Array) -> Array:
        return np.array([1.0, 1.0 + max(0.0, nodes[1, 0] - 1.0)])

    model = tmj.linearize(scene, tmj.DAE(), law=law)
    assert len(model.warnings) == 1
    assert "kink" in model.warnings[0]
    assert "s2" in model.warnings[0]
    assert "s1" not in model.warnings[0]


@pytest.mark.parametrize("seed", range(5))
def test_the_chart_and_its_derivatives(seed: int) -> None:
    """δ(state(δ)) = δ by velocities, and δ̈ of nodes that move by a known δ(t)."""
    rng = np.random.default_rng(seed)
    structure = random_structure(rng, rods=3, own_planes=0.4, point_masses=1)
    nodes = random_configuration(rng, structure, 0.3)
    chart = Chart(structure, nodes)
    a, b, c = (rng.uniform(-0.3, 0.3, chart.size) for _ in range(3))

    def delta(t: float) -> Array:
        return a + b * t + 0.5 * c * t * t

    zero = np.zeros(chart.size)
    assert np.abs(chart.state(zero, zero)[0] - nodes).max() < 1e-14
    back = chart.coordinates(*chart.state(a, b))
    assert np.abs(back[0] - a).max() < 1e-14
    assert np.abs(back[1] - b).max() < 1e-14
    h = 1e-3
    rate = (chart.state(delta(h), zero)[0] - chart.state(delta(-h), zero)[0]) / (2 * h)
    # h² times third derivatives of at most 1: 1e-6 / 6; below for four-point second differences h⁴ / 90 and eps / h².
    assert np.abs(rate - chart.state(a, b)[1]).max() < 1e-6
    at = {k: chart.state(delta(k * h), zero)[0] for k in range(-2, 3)}
    second = (-at[2] + 16 * at[1] - 30 * at[0] + 16 * at[-1] - at[-2]) / (12 * h * h)
    assert np.abs(chart.accelerations(a, b, second) - c).max() < 1e-8


@pytest.mark.parametrize("engine", ENGINES)
def test_a_broken_string_is_left_out_from_its_time_on(engine: str) -> None:
    scene = tmj.load_scene("tbar")
    name = scene.structure.strings[1].name
    broken = scene.with_(breaks=(tmj.model.Break(name, 0.5),))
    whole = tmj.linearize(scene, ENGINES[engine])
    before, after = (tmj.linearize(broken, ENGINES[engine], time=t) for t in (0.49, 0.5))
    # The same as a string that is long enough to be slack.
    longer = np.where(np.arange(len(scene.structure.strings)) == 1, 100.0, scene.structure.rest_lengths)
    slack = tmj.linearize(scene, ENGINES[engine], rest_lengths=longer)
    for key in ("A", "B", "residual"):
        np.testing.assert_array_equal(getattr(before, key), getattr(whole, key))
        np.testing.assert_allclose(getattr(after, key), getattr(slack, key), rtol=0, atol=1e-9)
    assert np.abs(after.A - whole.A).max() > 1.0
    assert not after.B[:, 1].any()
    assert not any("broken" in warning for warning in before.warnings)
    assert f"strings {name} have broken" in after.warnings[0]


def test_bad_requests_are_refused() -> None:
    scene = tmj.load_scene("prism")
    law = tmj.controllers.from_scene(scene)
    nodes = np.array(scene.nodes0)
    nodes[1] *= 1.1
    upright = Structure("r", {"a": (0, 0, 0), "b": (0, 0, 1)}, rods=(Rod("mast", ("a", "b"), 1.0),))
    for arguments, kind, words in (
        ({"scene": 3}, tmj.errors.OptionError, "load_scene"),
        ({"scene": scene, "engine": "odd"}, tmj.errors.OptionError, "ODE"),
        ({"scene": scene, "inputs": "u"}, tmj.errors.OptionError, "Command.REST_LENGTH"),
        ({"scene": scene, "time": float("nan")}, tmj.errors.OptionError, "time"),
        ({"scene": scene, "rest_lengths": [1.0, 2.0]}, tmj.errors.OptionError, "rest_lengths"),
        ({"scene": scene, "rest_lengths": 1.0, "law": law}, tmj.errors.OptionError, "leave one"),
        ({"scene": scene, "nodes": nodes}, tmj.errors.SceneError, "rod"),
        ({"scene": Scene(upright), "engine": tmj.ODE()}, tmj.errors.OptionError, "'mast'.*DAE"),
        ({"scene": scene, "law": tmj.controllers.from_scene(scene, norm=1)}, tmj.errors.OptionError, "sampled"),
    ):
        with pytest.raises(kind, match=words):
            linearizing.linearize(**{"engine": tmj.DAE(), **arguments})  # type: ignore[arg-type]

    def lost(time: float, nodes: Array, velocities: Array) -> Array:
        raise tmj.errors.InfeasibleError("nothing admissible")

    with pytest.raises(tmj.errors.InfeasibleError, match="nothing admissible"):
        tmj.linearize(scene, tmj.DAE(), law=lost)


def test_the_command_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    arrays, text = tmp_path / "model.npz", tmp_path / "model.json"
    assert main(["linearize", "pinned_rod", "--engine", "ode", "--closed-loop", "--out", str(arrays), "--json"]) == 0
    answer = json.loads(capsys.readouterr().out)
    scene = tmj.load_scene("pinned_rod")
    model = tmj.linearize(scene, tmj.ODE(), law=tmj.controllers.from_scene(scene))
    assert np.array_equal(answer["A"], model.A)
    with np.load(arrays) as file:
        for name in ("A", "B", "C", "gain", "residual"):
            assert np.array_equal(file[name], getattr(model, name))
        assert file["coordinates"].tolist() == list(model.coordinates)
    assert main(["linearize", "prism", "--engine", "dae", "--out", str(text)]) == 0
    shown = capsys.readouterr().out
    assert "mode 9" in shown
    assert "edge of slackness" in shown
    assert json.loads(text.read_text())["frequencies"] == pytest.approx(
        tmj.linearize(tmj.load_scene("prism"), tmj.DAE()).frequencies
    )
    run = tmj.simulate(scene, tmj.controllers.from_scene(scene), tmj.DAE(), duration=1.0)
    path = run.save(tmp_path / "run.nc")
    assert main(["linearize", "pinned_rod", "--state", str(path), "--time", "0.5", "--json"]) == 0
    answer = json.loads(capsys.readouterr().out)
    assert answer["time"] == pytest.approx(0.5)
    assert np.array_equal(answer["positions"], run.nodes[50])
    for wrong in (
        ["linearize", "tbar", "--closed-loop"],
        ["linearize", "prism", "--state", str(path)],
        ["linearize", "prism", "--time", "1"],
        ["linearize", "prism", "--out", "model.csv"],
    ):
        assert main(wrong) == 2


def test_a_model_shows_itself_in_five_lines() -> None:
    lines = repr(tmj.linearize(tmj.load_scene("tbar"), tmj.DAE())).splitlines()
    assert lines[0] == "linear  model of tbar, 4 numbers of the state, without a law"
    assert lines[2].startswith("state   at t = 0 s, no equilibrium: accelerations up to ")
    assert lines[3] == "inputs  4 (rest length)"
    assert [line.split()[0] for line in lines] == ["linear", "engine", "state", "inputs", "notes"]
    assert all(len(line) < 200 for line in lines)
