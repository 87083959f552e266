"""Beams held in waves from their side: what holds them, what loads them, linear theory, both engines, amplitudes."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from ledger_lines import lines_of
from scipy.linalg import eigh

import tensegrity_mj as tmj
from evidence.families.in_waves import BeamEnd, BeamWeight, beam_in_waves, held_in_waves
from evidence.families.towers import tower_length
from evidence.pages import reproduction
from evidence.thesis.appendix_c import beam_wave_tasks, measures_c
from evidence.thesis.appendix_c.beams import BY_PRESTRESS, HEIGHTS, STUDIES, BeamRun, wave_label
from evidence.thesis.catalog import FIGURES, STATEMENTS
from evidence.thesis.experiments import EngineName
from evidence.thesis.ledger import Verdict
from evidence.thesis.lookup import measured
from evidence.thesis.reproduction import reproduce
from tensegrity_mj.engines.reference.method import Method
from tensegrity_mj.engines.request import request_for
from tensegrity_mj.errors import OptionError
from tensegrity_mj.library.cross import cross
from tensegrity_mj.library.tower import tower
from tensegrity_mj.model.actuation import OnInfeasible
from tensegrity_mj.model.elements.water import sea_of
from tensegrity_mj.model.elements.waves import Wave
from tensegrity_mj.statics import find_equilibrium
from tensegrity_mj.statics.modes import mass_matrix

PRINTED, DOUBLED = "beam-waves", "beam-waves-doubled"
TWICE = tuple(2 * height for height in HEIGHTS)

G, RHO, ADDED, INERTIA, SEGMENTS = 9.81, 1025.0, 0.7, 1.6, 2
DEPTH, WAVELENGTH, CHI, PHASE = 2.0, 6.0, 1.2, 0.4
ALL_ENDS = list(BeamEnd)
DOC = Path(__file__).resolve().parents[1] / "docs" / "reproduction.md"


@cache
def short_tower() -> tmj.Scene:
    """Three stages of heavy tubes, soft and strongly prestressed: its slowest motions are as slow as the waves."""
    return tower(3, stiffness=3e3, tension=4e2, alternating=True, inner_diameter=0.04)


def held(
    amplitude: float, end: BeamEnd = BeamEnd.GUIDED, weight: BeamWeight = BeamWeight.CARRIED, **water: Any
) -> tmj.Scene:
    waves = (Wave(amplitude, WAVELENGTH, direction=CHI, phase=PHASE),) if amplitude else ()
    chosen = {"drag": 0.0, "added_mass": ADDED, "inertia": INERTIA, "segments": SEGMENTS, "waves": waves} | water
    return held_in_waves(short_tower(), tmj.Water(density=RHO, **chosen), DEPTH, end, weight)


def accelerations(scene: tmj.Scene, engine: Any) -> np.ndarray:
    request = request_for(scene, None, None, None, OnInfeasible.STOP, None, False)
    return np.asarray(engine.accelerations(request)(0.0, scene.nodes0, scene.velocities0)[1])


# ----------------------------------------------------------------------------------------------------- what holds it


@pytest.mark.parametrize(
    ("end", "free"),
    [(BeamEnd.GUIDED, (0, 1, 1)), (BeamEnd.GUIDED_ALONG_WAVES, (0, 1, 0)), (BeamEnd.CLAMPED, (0, 0, 0)),
     (BeamEnd.FREE, (1, 1, 1))],
)  # fmt: skip
def test_the_base_stands_and_the_top_moves_as_it_may(end: BeamEnd, free: tuple[int, ...]) -> None:
    """Hold nodes in a high wave for half a second: they keep their places to the drift of constraints, 1e-9 m."""
    scene = held(0.5, end, drag=1.0)
    run = tmj.simulate(scene, None, tmj.DAE(), duration=0.5)
    base, top = (np.abs(run.nodes[:, rows] - scene.nodes0[rows]).max(axis=(0, 1)) for rows in (range(3), range(-3, 0)))
    assert base.max() < 1e-9
    assert [bool(value > 1e-4) for value in top] == [bool(one) for one in free]
    assert np.all(top[np.array(free) == 0] < 1e-9)


def test_a_carried_beam_rests_straight_and_a_hanging_one_where_it_hangs() -> None:
    """Nothing moves in still water. Forces of 5e3 N are found to 1e-9 of themselves; rods weigh 20 kg: 1e-6 m/s²."""
    for weight in BeamWeight:
        for end in ALL_ENDS:
            scene = held(0.0, end, weight)
            for engine in (tmj.DAE(), tmj.MuJoCo()):
                assert np.abs(accelerations(scene, engine)).max() < 1e-6, (weight, end)
            sag = (scene.nodes0 - scene.structure.positions)[:, 2].min()
            assert sag == 0.0 if weight is BeamWeight.CARRIED else sag < -1e-3
    # Unlike one that nothing carries and that is straight.
    hanging = held(0.0, weight=BeamWeight.HANGING).with_(initial_nodes=None)
    assert np.abs(accelerations(hanging, tmj.DAE())).max() > 0.1


def test_what_a_beam_of_figure_c8_is() -> None:
    scene = beam_in_waves("TB2", 3.0)
    assert scene.water is not None
    (wave,) = scene.water.waves
    assert (wave.amplitude, wave.wavelength) == (1.5, pytest.approx(21.0))
    water = scene.water
    assert (water.drag, water.tangential_drag, water.inertia, water.added_mass) == (1.0, 0.1, 1.5, 0.5)
    assert scene.nodes0.reshape(-1, 3, 3).mean(axis=(0, 1))[2] == pytest.approx(-4.0, abs=1e-9)
    assert tower_length(scene.structure.positions) == pytest.approx(0.851 * 30, rel=1e-3)
    # From its side: crests along the whole beam at once, and no motion of water along it.
    sea, t = sea_of(scene), np.linspace(0, 3, 7)
    assert np.ptp(sea.elevation(t[:, None], np.linspace(0, 26, 5), 0.3), axis=1).max() < 1e-12
    assert np.abs(sea.velocity(t, scene.nodes0[:1])[..., 0]).max() < 1e-12
    assert np.abs(sea.velocity(t, scene.nodes0[:1])[..., 1]).max() > 0.1
    # Steel of 7850 kg/m³ in tubes of 100 x 10.95 mm, closed: 24.05 kg/m weigh 16 kg/m in water, 127.3 m of them 20 kN.
    area, circle = math.pi * (0.05**2 - 0.03905**2), math.pi * 0.05**2
    net = 90 * math.sqrt(2) * G * (7850 * area - 1025 * circle)
    assert sum(load.force[2] for load in scene.loads) == pytest.approx(net, rel=1e-9)  # type: ignore[union-attr]
    assert net == pytest.approx(20e3, rel=0.01)


def test_it_is_called_by_name() -> None:
    made = tmj.load_scene("beam_in_waves('TB4', 1.5, end='clamped', segments=2)")
    assert made == beam_in_waves("TB4", 1.5, end=BeamEnd.CLAMPED, segments=2)


@pytest.mark.parametrize(
    ("build", "words"),
    [
        (lambda: beam_in_waves("TB8"), "allowed: TB1, TB2"),
        (lambda: beam_in_waves("TB1", 0.0), r"wave_height = 0.0"),
        (lambda: beam_in_waves("TB1", steepness=-1.0), "steepness = -1.0"),
        (lambda: held_in_waves(short_tower(), tmj.Water(), 0.0), "submergence = 0.0"),
        (lambda: held_in_waves(short_tower(), tmj.Water(), 2.0, "guided"), "end"),  # type: ignore[arg-type]
        (lambda: held_in_waves(short_tower(), tmj.Water(), 2.0, weight=True), "weight"),  # type: ignore[arg-type]
        (lambda: held_in_waves(cross(), tmj.Water(), 2.0), "no tower of two stages or more"),
        (lambda: held_in_waves(tower(1), tmj.Water(), 2.0), "no tower of two stages or more"),
    ],
)
def test_what_cannot_be_is_refused(build: Any, words: str) -> None:
    with pytest.raises(OptionError, match=words):
        build()


# ------------------------------------------------------------------------------------------------------ linear theory


def linear_motion(scene: tmj.Scene, amplitude: float, times: np.ndarray) -> np.ndarray:
    """(T, N, 3) [m] of small motions from rest, in closed form for each mode.

    On motions T that supports and rods admit, (M + A) δ̈ + K δ = Re F e^{iωt}: A of added mass and F of the water's
    acceleration in deep water, both here summed rod by rod, with what is across a rod and the lever rule for its ends.
    A mode of frequency w that is at rest at first does Re f/(w² - ω²) (e^{iωt} - cos wt - i ω/w sin wt).
    """
    state = find_equilibrium(scene.with_(water=None, gravity=(0, 0, 0), loads=()))
    Z = state.model.boundary.Z
    T, K = state.linearized.tangent_basis(), state.stiffness()
    M = mass_matrix(scene.structure).toarray()
    k = 2 * math.pi / WAVELENGTH
    omega = math.sqrt(G * k)
    F = np.zeros(M.shape[0], complex)
    for rod, (i, j) in zip(scene.structure.rods, scene.structure.rod_nodes, strict=True):
        first, second = state.nodes[i], state.nodes[j]
        span = second - first
        P = np.eye(3) - np.outer(span, span) / (span @ span)
        displaced = RHO * math.pi * rod.radius**2 * np.linalg.norm(span) / SEGMENTS
        for part in range(SEGMENTS):
            s = (part + 0.5) / SEGMENTS
            x, y, z = first + s * span
            # Velocity ω A e^{kz} (cos χ sin θ, sin χ sin θ, cos θ): sin θ = Re -i e^{iθ}, and a = iω v.
            turn = np.exp(1j * (PHASE - k * (x * math.cos(CHI) + y * math.sin(CHI))))
            a = (
                1j
                * omega**2
                * amplitude
                * math.exp(k * z)
                * turn
                * np.array([-1j * math.cos(CHI), -1j * math.sin(CHI), 1])
            )
            levers = {i: 1 - s, j: s}
            for node, lever in levers.items():
                F[3 * node : 3 * node + 3] += lever * INERTIA * displaced * (P @ a)
                for other, ratio in levers.items():
                    block = np.ix_(range(3 * node, 3 * node + 3), range(3 * other, 3 * other + 3))
                    M[block] += lever * ratio * ADDED * displaced * P
    moves = Z @ T
    squares, shapes = eigh(K, moves.T @ M @ moves)
    w, f, t = np.sqrt(squares), shapes.T @ (moves.T @ F), times[:, None]
    swing = np.exp(1j * omega * t) - np.cos(w * t) - 1j * omega / w * np.sin(w * t)
    motion = np.real(f / (squares - omega**2) * swing) @ (moves @ shapes).T
    return np.asarray(motion.reshape(len(times), -1, 3))


def simulated_motion(amplitude: float, end: BeamEnd, engine: Any) -> tuple[np.ndarray, np.ndarray]:
    """Times (T,) and half the difference (T, N, 3) of the motions in a wave and in its mirror image in time and level.

    What is of even order in the amplitude is gone from it.
    """
    scene = held(amplitude, end)
    assert scene.water is not None
    other = replace(scene.water, waves=(replace(scene.water.waves[0], phase=PHASE + math.pi),))
    runs = [
        tmj.simulate(one, None, engine, duration=4.0, output_interval=0.1) for one in (scene, scene.with_(water=other))
    ]
    return runs[0].time, 0.5 * (runs[0].nodes - runs[1].nodes)


@pytest.mark.parametrize("end", [BeamEnd.GUIDED, BeamEnd.CLAMPED])
def test_small_waves_move_it_as_linear_theory_says(end: BeamEnd) -> None:
    """Without drag, two wave periods and more: the third order is left, an eighth of it at half the amplitude.

    Strains of strings by the motion and k A, of 1e-3 at the smaller wave, bound the third order by their square, 1e-6,
    times the count of swings that a shift of frequency has to gather, some tens: 1e-4. A wrong added mass, inertia
    coefficient or support shows in the first digits.
    """
    small, large = 0.02, 0.04
    left = []
    for amplitude in (small, large):
        times, motion = simulated_motion(amplitude, end, tmj.DAE())
        expected = linear_motion(held(amplitude, end), amplitude, times)
        left.append(float(np.abs(motion - expected).max() / np.abs(expected).max()))
    assert left[0] < 1e-4
    assert left[1] / left[0] == pytest.approx(4.0, rel=0.05)  # relative to the motion, which is twice as large


def test_both_engines_agree_in_a_high_wave() -> None:
    """Drag, tangential drag and slack strings included: two runs with RK4 at half the step, and both engines.

    The DAE's two runs differ by what steps leave; MuJoCo solves the same equations with the same steps, so it differs
    from the DAE by no more than that.
    """
    scene = held(0.8, drag=1.0, tangential_drag=0.1)
    step = 5e-3
    fine, coarse = (
        tmj.simulate(scene, None, tmj.DAE(method=Method.RK4, timestep=h), duration=2.0, output_interval=0.02)
        for h in (step / 2, step)
    )
    other = tmj.simulate(scene, None, tmj.MuJoCo(timestep=step / 2), duration=2.0, output_interval=0.02)
    steps = np.abs(fine.nodes - coarse.nodes).max()
    assert 0 < steps < 1e-5
    assert np.abs(other.nodes - fine.nodes).max() < steps
    assert np.abs(fine.nodes - fine.nodes[0]).max() > 0.02


# -------------------------------------------------------------------------------------------------------- amplitudes


def test_amplitudes_are_half_of_the_swing_of_stages() -> None:
    """A made-up motion: stage s swings by (s + 1) cm along the waves and half of it upwards, about a mean of 0.3 m."""
    scene = held(0.1, segments=1)
    omega = float(sea_of(scene).frequency[0])
    time = np.arange(0.0, 90.0, 0.01)
    stage = np.repeat([0.01, 0.02, 0.03], 6)
    nodes = np.tile(scene.structure.positions, (len(time), 1, 1))
    nodes[..., 1] += 0.3 + stage * np.cos(omega * time)[:, None]
    nodes[..., 2] += 0.5 * stage * np.sin(3 * omega * time)[:, None]
    tensions = np.ones((len(time), len(scene.structure.strings)))
    tensions[-1, :4] = 0.0
    run: Any = SimpleNamespace(
        scene=scene, time=time, nodes=nodes, tensions=tensions, status=SimpleNamespace(value="completed")
    )
    found = beam_wave_tasks.measured(run)
    # Samples are within 0.005 s of a crest: (ω 0.005)²/2 = 1.5e-4 of it are missed, of three times ω 1.3e-3.
    np.testing.assert_allclose(found["along"], [0.01, 0.02, 0.03, 0.03], rtol=2e-4)
    np.testing.assert_allclose(found["up"], [0.005, 0.01, 0.015, 0.015], rtol=1.5e-3)
    # The last samples do not end with a whole period: one sample in 2900.
    np.testing.assert_allclose(found["at_wave_frequency"], [0.01, 0.02, 0.03, 0.03], rtol=1e-3)
    np.testing.assert_allclose(np.array(found["mean"])[:, 0], 0.3, atol=1e-4)
    assert found["settling"] < 1e-4
    assert found["slack"] == 4


@cache
def natural(end: str) -> dict[str, Any]:
    return beam_wave_tasks.modes({"beam": {"which": "TB1", "end": end}})


def test_added_mass_slows_the_beams() -> None:
    """Check long bending motions, which are transverse to all rods but by their inclination.

    A rod of direction b has C_a m_w of added mass across itself: 0.5 x 8.05 kg/m in addition to 24.05 kg/m, times
    the part of the motion across the rods, between half of it and all.
    """
    for end in ("guided", "clamped"):
        found = natural(end)
        ratio = (np.array(found["in_air"][:2]) / found["in_water"][:2]) ** 2
        most = 0.5 * RHO * math.pi * 0.05**2 / (7850 * math.pi * (0.05**2 - 0.03905**2))
        assert np.all((ratio > 1 + 0.5 * most) & (ratio < 1 + most))
        assert found["in_water"][0] == pytest.approx(found["in_water"][1], rel=1e-6)  # in both directions


def test_the_matrix_of_added_mass_is_what_the_water_answers() -> None:
    """Accelerations by the engine, of a beam that is pulled in water and in air: M + A against M, on free motions.

    (M + A) a = f with rods rigid: virtual work of f - (M + A) a on every admissible motion is zero, to round-off of
    forces of 5e3 N.
    """
    scene = held(0.0, BeamEnd.GUIDED)
    node = scene.structure.node_names[-1]
    pulled = scene.with_(loads=(*scene.loads, tmj.model.Load(node, (0.0, 700.0, -300.0))))  # type: ignore[misc]
    a = accelerations(pulled, tmj.DAE()).ravel()
    state = find_equilibrium(scene.with_(water=None, gravity=(0, 0, 0), loads=()))
    moves = state.motions()
    f = np.zeros(a.size)
    f[-3:] = (0.0, 700.0, -300.0)
    added = beam_wave_tasks.added_mass_matrix(scene)
    left = moves.T @ (f - (mass_matrix(scene.structure) + added) @ a)
    assert np.abs(left).max() < 1e-6
    assert np.abs(moves.T @ (added @ a)).max() > 10.0  # what would be left without it


@pytest.mark.study
def test_figure_c8_is_what_the_doc_says(tmp_path: Path) -> None:
    """Some seventy runs of beams: minutes."""
    engines = (EngineName.STATICS, EngineName.MUJOCO, EngineName.DAE)
    made = reproduce(["C.8"], tmp_path, engines=engines)
    assert [one.statement.id for one in made.rows if one.verdict is Verdict.UNEXPLAINED] == []
    written = lines_of(DOC.read_text(encoding="utf-8"))
    for one in made.rows:
        assert written[one.statement.id] == reproduction.markdown_row(one, engines)
    assert made.files["C.8"].read_bytes().startswith(b"\x89PNG")


# ------------------------------------------------------------------------------------------- rows of made-up amplitudes


def run_of(heights: tuple[float, ...], swing: Any) -> BeamRun:
    values = {
        wave_label(beam, height): {"along": [0.1 * swing(number, height), swing(number, height)]}
        for number, beam in enumerate(BY_PRESTRESS)
        for height in heights
    }
    return BeamRun("", "", values)


def test_rows_judge_what_the_sentences_say() -> None:
    like_the_figure = run_of((2.0, 4.0, 6.0), lambda n, height: height - 0.1 * n * (height - 4.0))
    assert measures_c.swings_grow(like_the_figure, (2.0, 4.0, 6.0))
    assert not measures_c.swings_grow(like_the_figure, (6.0, 4.0))
    assert [measures_c.falls(like_the_figure, height) for height in (2.0, 4.0, 6.0)] == [False, False, True]
    (row,) = (one for one in STATEMENTS if one.id == "C.8-axis")
    assert measured(row, {row.needs[0]: like_the_figure}) == 6.0
    made = BeamRun("", "", {"x": {"in_water": [9.0, 9.0, math.sqrt(2 * math.pi * G / 21.0)]}})
    assert measures_c.resonant_height(made, "x", 1) == pytest.approx(3.0)  # a wave of 21 m is 3 m high


def test_figure_c8_is_drawn_from_both_readings() -> None:
    printed, doubled = (run_of(heights, lambda n, h: h) for heights in (HEIGHTS, TWICE))
    confirmed = BeamRun("", "", {label: doubled.values[label] for label in STUDIES[DOUBLED].of_mujoco})
    all_runs = {EngineName.DAE: {PRINTED: printed, DOUBLED: doubled}, EngineName.MUJOCO: {DOUBLED: confirmed}}
    (figure,) = (one for one in FIGURES if one.number == "C.8")
    left, right = figure.draw(all_runs).axes
    assert len(left.get_lines()) == 4
    assert len(right.get_lines()) == 8
    assert [len(line.get_xdata()) for line in right.get_lines()[1::2]] == [1, 0, 0, 1]
    assert "MPa" in left.get_legend().get_texts()[0].get_text()
