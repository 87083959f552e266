"""Pictures and videos: what is drawn is where it should be, at the right time, and files are whole or absent."""

from __future__ import annotations

import math
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from analytic_runs import RATE, TILT, cone_motion, cone_run, cone_scene, planar_scene, run_of, two_masses
from PIL import Image as PillowImage

import tensegrity_mj as tmj
from tensegrity_mj.engines.reference.dae import DAE
from tensegrity_mj.errors import MissingLibraryError, OptionError
from tensegrity_mj.model.elements.contact import floor_gaps
from tensegrity_mj.model.elements.terrain import Heights
from tensegrity_mj.model.events import Break
from tensegrity_mj.model.scene import Scene
from tensegrity_mj.model.structure import Structure
from tensegrity_mj.model.target import Target
from tensegrity_mj.pictures import opengl, palette
from tensegrity_mj.pictures.camera import FIELD_OF_VIEW, NEAREST, Camera, clearest, corners_of, fit
from tensegrity_mj.pictures.labels import Labels
from tensegrity_mj.pictures.motion import MAX_PIECES, Motion, Traces, simplify
from tensegrity_mj.pictures.painter import Painter, geoms_needed, make_model, slack_arcs
from tensegrity_mj.pictures.shade import patches
from tensegrity_mj.pictures.shrink import behind, shrink
from tensegrity_mj.pictures.stage import Framing, Stage
from tensegrity_mj.pictures.video import frame_times, frames, picture, render, render_frame, still
from tensegrity_mj.pictures.view import Layout, Quality, View
from tensegrity_mj.runs.trajectory import Status, Trajectory
from tensegrity_mj.simulation import simulate

BACKGROUND = np.array(palette.to_bytes(palette.BACKGROUND), int)
SMALL = (320, 240)


def opengl_reason() -> str:
    try:
        opengl.choose_backend()
    except MissingLibraryError as error:
        return str(error)
    return ""


needs_opengl = pytest.mark.skipif(bool(opengl_reason()), reason=opengl_reason() or "OpenGL works")


def distance_from(image: np.ndarray, color: tuple[float, float, float]) -> np.ndarray:
    """(H, W): the largest difference from a colour over red, green and blue, 0 to 255."""
    return np.abs(image.astype(int) - np.array(palette.to_bytes(color))).max(axis=2)


# ------------------------------------------------------------------------------------------ between the samples


def test_positions_are_exact_for_cubic_motion():
    # A cubic is its own Hermite interpolant: round-off only, about 10 operations on numbers below 30.
    scene = two_masses()
    times = np.array([0.0, 0.7, 1.0, 2.5])
    coefficients = np.random.default_rng(1).normal(size=(4, 2, 3))

    def path(t):
        return sum(c * t[:, None, None] ** k for k, c in enumerate(coefficients))

    def rate(t):
        return sum(k * c * t[:, None, None] ** (k - 1) for k, c in enumerate(coefficients) if k)

    motion = Motion.of(run_of(scene, times, path(times), rate(times), np.zeros((4, 1))))
    between = np.linspace(0.0, 2.5, 57)
    assert np.abs(motion.positions(between) - path(between)).max() < 1e-12


def test_positions_between_samples_of_a_circle_keep_the_hermite_bound():
    # The bound h⁴/384 max|d⁴x/dt⁴| of cubic Hermite interpolation; linear interpolation errs by h²/8 max|d²x/dt²|.
    step = 0.1
    times = np.arange(0.0, 2.0 + step / 2, step)
    between = np.linspace(0.0, 2.0, 333)
    error = np.abs(Motion.of(cone_run(times)).positions(between) - cone_motion(between)[0]).max()
    bound = step**4 / 384 * RATE**4 * math.sin(TILT)
    assert 0.3 * bound < error < bound * (1 + 1e-6) + 1e-15


def test_motion_stops_at_the_first_sample_that_is_not_finite():
    run = cone_run()
    nodes = run.nodes.copy()
    nodes[7, 1, 0] = np.nan
    motion = Motion.of(replace(run, nodes=nodes))
    assert len(motion.time) == 7
    assert motion.end == run.time[6]
    assert "not finite" in motion.note
    with pytest.raises(OptionError, match="cone"):
        Motion.of(replace(run, nodes=np.full_like(nodes, np.nan)))
    with pytest.raises(OptionError, match="no sample"):
        Motion.of(run.until(0))


def test_how_a_run_ended_is_reported():
    assert Motion.of(replace(cone_run(), status=Status.INFEASIBLE)).note == "infeasible at t = 2 s"


# ------------------------------------------------------------------------------------------ slack strings


@pytest.mark.parametrize("ratio", [1.0001, 1.01, 1.2, 2.0, 5.0, 40.0])
@pytest.mark.parametrize("chord", [(1.0, 0.0, 0.0), (0.3, -0.4, 1.2), (0.0, 0.0, -2.0)])
def test_an_arc_is_as_long_as_its_string(ratio, chord):
    # The pieces turn by equal angles, at most π/n each; a chord of an arc that turns by φ is shorter by about φ²/24.
    pieces = 400
    end = np.array([chord])
    length = ratio * np.linalg.norm(chord)
    down = np.array([0.0, 0.0, -1.0])
    points = slack_arcs(np.zeros((1, 3)), end, np.array([length]), down, np.array([[1.0, 0.0, 0.0]]), pieces)[0]
    drawn = np.linalg.norm(np.diff(points, axis=0), axis=1).sum()
    assert drawn == pytest.approx(length, rel=(math.pi / pieces) ** 2 / 24 + 1e-9)
    assert np.allclose(points[[0, -1]], [[0, 0, 0], chord], atol=1e-12)


def test_an_arc_hangs_down_and_a_taut_string_is_straight():
    start, end = np.zeros((2, 3)), np.array([[1.0, 0.0, 0.0], [1.0, 0.0, 0.0]])
    outward = np.array([[0.0, 1.0, 0.0], [0.0, 1.0, 0.0]])
    hanging, taut = slack_arcs(start, end, np.array([1.5, 0.9]), np.array([0.0, 0.0, -1.0]), outward, 12)
    assert hanging[6, 2] < -0.4
    assert abs(hanging[6, 1]) < 0.1
    assert np.abs(taut[:, 1:]).max() < 1e-12


def test_a_slack_string_between_ends_that_meet_is_a_loop():
    points = slack_arcs(np.zeros((1, 3)), np.zeros((1, 3)), np.ones(1), np.array([0.0, 0.0, -1.0]), np.ones((1, 3)), 50)
    assert np.isfinite(points).all()
    # Down and up again: half the length deep, but for 1/1000 that its ends are taken apart by.
    assert np.ptp(points[0], axis=0).max() == pytest.approx(0.5, abs=2e-3)


# ------------------------------------------------------------------------------------------ camera


@pytest.mark.parametrize("seed", range(6))
def test_the_camera_just_sees_everything(seed):
    random = np.random.default_rng(seed)
    points = random.normal(size=(30, 3)) * random.uniform(0.1, 3.0, 3) + random.normal(size=3)
    radius, aspect = random.uniform(0.01, 0.3), random.uniform(0.4, 2.5)
    camera = fit(Camera(random.uniform(0, 360), random.uniform(-80, 80)), points, radius, aspect)
    right, up, forward = camera.axes @ (points - camera.position).T
    tall = math.tan(math.radians(FIELD_OF_VIEW / 2))
    gaps = []
    for across, tangent in ((right, aspect * tall), (up, tall)):
        for sign in (1, -1):
            # Distance of each ball's surface from the side of the view.
            gaps.append((tangent * forward - sign * across) / math.hypot(1, tangent) - radius)
    assert np.min(gaps) > -1e-9
    # As near as can be: in one direction it touches both sides.
    touching = [np.min(gap) for gap in gaps]
    assert min(max(touching[:2]), max(touching[2:])) < 1e-9


def test_the_camera_means_the_same_to_mujoco():
    camera = Camera(70.0, -25.0, (0.3, -0.2, 0.9), 2.5)
    painter = Painter(make_model(), 10, 1.0)
    painter.look_from(camera, 1.0, FIELD_OF_VIEW)
    seen = painter.scene.camera[0]
    # MuJoCo stores single precision and sets two eyes 0.068 m apart.
    both = 0.5 * (np.array(painter.scene.camera[0].pos) + np.array(painter.scene.camera[1].pos))
    assert np.allclose(both, camera.position, atol=1e-5)
    assert np.allclose(seen.forward, camera.axes[2], atol=1e-6)
    assert np.allclose(seen.up, camera.axes[1], atol=1e-6)


@pytest.mark.parametrize("normal", [(0, 1, 0), (1, 0, 0), (0, 0, 1), (1, 2, 0), (1, 1, 1), (-2, 1, 0.5)])
def test_planar_structures_are_seen_square_on(normal):
    points = planar_scene(normal).structure.positions
    camera = clearest(points, np.zeros((1, 0, 2, 3)), None)
    assert abs(camera.axes[2] @ (np.array(normal) / np.linalg.norm(normal))) == pytest.approx(1.0, abs=1e-9)
    assert camera.elevation <= 1e-9
    if normal == (0, 1, 0):
        assert np.allclose(camera.axes[0], [1, 0, 0], atol=1e-9)


def test_the_azimuth_keeps_members_apart():
    # Two members that meet at the origin, in the vertical plane at 35 degrees from x: seen from within that plane they
    # cover each other, square on they do not. Square on is azimuth 125 or 305; candidates are 15 degrees apart.
    inside = np.array([math.cos(math.radians(35)), math.sin(math.radians(35)), 0.0])
    for turn in (0.0, 40.0, 77.0):
        c, s = math.cos(math.radians(turn)), math.sin(math.radians(turn))
        turned = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]) @ inside
        nodes = np.array([[[0.0, 0.0, 0.0], turned, turned + np.array([0, 0, 1.0]), [0.3, -0.8, 0.4]]])
        corners = corners_of(np.array([[0, 1], [2, 0]]), nodes)
        assert np.array_equal(corners, nodes[:, [[1, 2]]])
        off = (clearest(nodes[0], corners, None).azimuth - (125.0 + turn)) % 180.0
        assert min(off, 180.0 - off) <= 45.0
    assert corners_of(np.array([[0, 1], [2, 3]]), nodes).shape == (1, 0, 2, 3)


def test_angles_that_were_requested_are_kept():
    camera = clearest(cone_scene().structure.positions, np.zeros((1, 0, 2, 3)), None, 12.0, -34.0)
    assert (camera.azimuth, camera.elevation) == (12.0, -34.0)


# ------------------------------------------------------------------------------------------ parts


def test_simplified_paths_stay_within_the_tolerance():
    t = np.linspace(0.0, 6.0, 2000)
    helix = np.column_stack([np.cos(t), np.sin(t), 0.3 * t])
    kept = simplify(helix, 1e-3)
    rebuilt = np.column_stack([np.interp(t, t[kept], helix[kept, k]) for k in range(3)])
    # Interpolation in t is not the nearest point of the chord: along the path it may be off a little more.
    assert np.linalg.norm(rebuilt - helix, axis=1).max() < 2e-3
    # A piece of length s bulges by s²/8 times the curvature 1/1.09: 67 pieces of 0.093 would do, for 6.26 in all.
    # Splitting at the middle stops at lengths between that and its half.
    assert len(kept) - 1 <= 2 * 67
    assert simplify(np.linspace([0, 0, 0], [1, 2, 3], 50), 1e-9).tolist() == [0, 49]


def test_traces_end_when_the_motion_got_there():
    motion = Motion.of(cone_run())
    traces = Traces.of(motion, np.array([1]), 1e-3)
    assert np.all(np.diff(traces.times) > 0)
    for end, time in zip(traces.ends, traces.times, strict=True):
        assert np.allclose(end, motion.positions(np.array(time))[1], atol=1e-12)


def test_the_tension_scale_ends_at_a_round_number_and_does_not_follow_a_peak():
    assert palette.TensionScale.of(np.array([0.0, 0.147])) == palette.TensionScale(0.15)
    assert palette.TensionScale.of(np.zeros(5)).end == 1.0
    peak = palette.TensionScale.of(np.append(np.full(1000, 0.4), 90.0))
    assert peak == palette.TensionScale(0.4, exceeded=True)
    low, high = palette.tension_colors([0.0, 1.0])
    assert np.abs(low - high).max() > 0.5
    assert np.array_equal(palette.tension_colors([7.0]), [high])


BACKDROP = (248, 249, 250)


def drawn(height: int, width: int) -> np.ndarray:
    """Pixels of any colour that cover all that is behind them."""
    pixels = np.random.default_rng(height).integers(0, 256, (height, width, 4), dtype=np.uint8)
    pixels[..., 3] = 255
    return pixels


def test_shrinking_by_two_thirds_shares_the_middle():
    source = drawn(18, 12)
    result = np.empty((12, 8, 3), np.uint8)
    shrink(source, 1.5, result, behind(BACKDROP, 0.4))
    # Every pixel twice in each direction, then blocks of 3 x 3: each takes its share of the pixels it covers.
    fine = np.repeat(np.repeat(source[::-1, :, :3].astype(int), 2, axis=0), 2, axis=1)
    sums = fine.reshape(12, 3, 8, 3, 3).sum(axis=(1, 3))
    assert np.array_equal(result, (sums + 4) // 9)


@pytest.mark.parametrize("factor", [1, 2, 3])
def test_shrinking_averages_blocks_and_turns_the_picture(factor):
    source = drawn(12 * factor, 10 * factor)
    # Some places that nothing covers, alone and in whole blocks, are those of the background.
    empty = np.random.default_rng(factor).random(source.shape[:2]) < 0.3
    empty[: 4 * factor, 2 * factor : 7 * factor] = True
    source[empty] = 0
    seen = np.where(empty[..., None], BACKDROP, source[..., :3])
    frame = np.zeros((20, 30, 3), np.uint8)
    shrink(source, factor, frame[4:16, 7:17], behind(BACKDROP, 0.4))
    blocks = seen[::-1].reshape(12, factor, 10, factor, 3).sum(axis=(1, 3), dtype=int)
    assert np.array_equal(frame[4:16, 7:17], (blocks + factor**2 // 2) // factor**2)
    frame[4:16, 7:17] = 0
    assert not frame.any()


@pytest.mark.parametrize("factor", [1, 1.5, 2, 3])
@pytest.mark.parametrize("alpha", [0.25, 0.41, 0.6])
@pytest.mark.parametrize("layers", [1, 2, 3, 6])
def test_translucent_layers_let_the_background_through_as_if_it_had_been_there(factor, alpha, layers):
    # OpenGL blends all four numbers, c and A, into alpha c + (1 - alpha) what was there, and alpha² + (1 - alpha) A.
    color = np.array([40.0, 110.0, 230.0])
    for below, opacity in ((np.zeros(3), 0.0), (np.array([90.0, 20.0, 10.0]), 1.0)):
        direct = np.array(BACKDROP) if opacity == 0.0 else below
        for _ in range(layers):
            below, direct = (alpha * color + (1 - alpha) * one for one in (below, direct))
            opacity = alpha**2 + (1 - alpha) * opacity
        pixel = np.round([*below, 255.0 * opacity]).astype(np.uint8)
        source = np.tile(pixel, (int(6 * factor), int(6 * factor), 1))
        result = np.empty((6, 6, 3), np.uint8)
        shrink(source, factor, result, behind(BACKDROP, alpha))
        # A is rounded by 1/2, which moves the background's share of up to 250 by 250/255 1/(2 alpha); colours and the
        # sum are rounded by 1/2 each, and so is the share.
        assert np.abs(result.astype(float) - direct).max() <= 250.0 / 255.0 / (2.0 * alpha) + 1.5


def test_what_has_a_plate_behind_it_lets_nothing_through():
    table = behind(BACKDROP, 0.0)
    assert np.array_equal(table[0], BACKDROP)
    assert not table[1:].any()


# ------------------------------------------------------------------------------------------ frames


def stage_of(run: Trajectory | Scene, **options) -> Stage:
    return Stage(Motion.of(run), None, Layout.OVERLAY, View(text=False, **options))


def pixel(stage: Stage, point) -> tuple[int, int]:
    """Column and row of a point [m] in a stage without text."""
    width, height = stage.view.size
    x, y = stage.framing.camera.project(np.asarray(point, float))
    return int(0.5 * width + 0.5 * height * x), int(0.5 * height - 0.5 * height * y)


@needs_opengl
@pytest.mark.parametrize("size", [(640, 360), (300, 300), (200, 480)])
@pytest.mark.parametrize("time", [0.0, 0.35, 0.85, 1.25, 1.65])
def test_a_rod_is_drawn_where_it_is(size, time):
    # Times between samples, too: half a second apart, a tip that was drawn at a sample would be off by 20 pixels.
    run = cone_run(np.linspace(0.0, 2.0, 5))
    tip = cone_motion(np.array([time]))[0][0, 1]
    with stage_of(run, size=size, traces=False, target=False) as stage:
        image = stage.frame(time)
        for share in (0.3, 0.6, 0.95):
            column, row = pixel(stage, share * tip)
            assert distance_from(image, palette.ROD)[row, column] < 90
            assert np.abs(image[row, column].astype(int) - BACKGROUND).max() > 80
        # And nowhere else: beside it, closer than it moves within 0.05 s, there is none of its colour.
        along = np.array(pixel(stage, 0.8 * tip)) - np.array(pixel(stage, 0.4 * tip))
        across = np.array([-along[1], along[0]]) / np.linalg.norm(along)
        meter = 0.5 * size[1] / (stage.framing.camera.distance * math.tan(math.radians(FIELD_OF_VIEW / 2)))
        for side in (1, -1):
            place = np.array(pixel(stage, 0.7 * tip)) + side * across * (
                1.2 * stage.framing.sizes[0].rod[0] * meter + 2
            )
            column, row = np.round(place).astype(int)
            assert distance_from(image, palette.ROD)[row, column] > 50
        beyond = pixel(stage, 1.12 * tip)
        assert np.abs(image[beyond[1], beyond[0]].astype(int) - BACKGROUND).max() < 40  # at most a grid line


@needs_opengl
@pytest.mark.parametrize("size", [(640, 360), (240, 480)])
def test_nothing_ever_touches_the_edge(size):
    for image in frames(cone_run(), size=size, fps=4, target=True):
        edge = np.concatenate([image[0], image[-1], image[:, 0], image[:, -1]])
        assert np.abs(edge.astype(int) - BACKGROUND).max() <= 1


@needs_opengl
def test_the_target_is_in_the_picture():
    scene = planar_scene((0, 1, 0))
    aim = scene.structure.positions + np.array([4.0, 0.0, 0.0])
    with stage_of(scene.with_(target=Target.set_point(aim)), size=(400, 300)) as stage:
        column, row = pixel(stage, 0.5 * (aim[0] + aim[2]))
        assert 5 < column < 395
        assert 5 < row < 295
        image = stage.frame(0.0)[row, column].astype(int)
        assert image[1] - image[0] > 40


@needs_opengl
def test_the_structure_fills_the_picture():
    # The other half of framing: in one direction, what is drawn reaches within a tenth of the picture of both edges.
    image = render_frame(cone_run(), text=False, size=(640, 360))
    drawn = np.abs(image.astype(int) - BACKGROUND).max(axis=2) > 8
    rows, columns = np.flatnonzero(drawn.any(axis=1)), np.flatnonzero(drawn.any(axis=0))
    assert (rows[0] < 36 and rows[-1] > 324) or (columns[0] < 64 and columns[-1] > 576)


@needs_opengl
def test_a_structure_that_travels_far_is_followed():
    scene = planar_scene((0, 1, 0))
    times = np.linspace(0.0, 3.0, 31)
    nodes = scene.structure.positions[None] + np.outer(times, [20.0, 0.0, 5.0])[:, None]
    run = run_of(scene, times, nodes, np.broadcast_to([20.0, 0.0, 5.0], nodes.shape), np.zeros((31, 4)))
    counts = []
    for image in frames(run, size=SMALL, fps=2, traces=False):
        counts.append(int((distance_from(image, palette.ROD) < 60).sum()))
    # Two rods of half the picture's height, some 4 pixels wide, in every frame: not the speck that 60 m would leave.
    assert min(counts) > 300
    assert max(counts) < 1.3 * min(counts)


@needs_opengl
def test_strings_show_their_tension_and_slack():
    scene = Scene(Structure.from_arrays(
        [[0, 0, 0], [2, 0, 0], [0, 0, 1], [2, 0, 1]], [[0, 2], [1, 3]], [[0, 1], [2, 3]],
        rod_mass=1.0, stiffness=10.0, rest_length=[1.0, 2.5],
    ))  # fmt: skip
    with stage_of(scene, size=(640, 360), quality=Quality.FINE) as stage:
        image = stage.frame(0.0)
        column, row = pixel(stage, [1.3, 0, 0])
        # The taut one: at the end of the scale, shaded.
        assert distance_from(image, tuple(palette.tension_colors(1.0)))[row, column] < 60
        # The slack one: nothing on its chord, and an arc below. Parabola of arc length 2.5 over 2: depth 0.66.
        column, row = pixel(stage, [1.0, 0, 1.0])
        assert np.abs(image[row, column].astype(int) - BACKGROUND).max() < 3
        lows = [pixel(stage, [1.0, 0, 1.0 - depth]) for depth in np.linspace(0.60, 0.72, 25)]
        assert min(distance_from(image, palette.SLACK)[r, c] for c, r in lows) < 60


@needs_opengl
def test_a_broken_string_is_drawn_no_more():
    scene = Scene(Structure.from_arrays(
        [[0, 0, 0], [2, 0, 0], [0, 0, 1], [2, 0, 1]], [[0, 2], [1, 3]], [[0, 1], [2, 3]],
        rod_mass=1.0, stiffness=10.0, rest_length=1.0,
    ), breaks=(Break("s2", 0.02),))  # fmt: skip
    run = simulate(scene, None, DAE(), duration=0.03)
    with stage_of(run, size=(640, 360), quality=Quality.FINE) as stage:
        for time, there in ((0.01, True), (0.02, False), (0.03, False)):
            image = stage.frame(time)
            middle, lower = (
                run.nodes[round(time / 0.01)][2:].mean(axis=0),
                run.nodes[round(time / 0.01)][:2].mean(axis=0),
            )
            for place, drawn in ((middle, there), (lower, True)):
                column, row = pixel(stage, place)
                assert (np.abs(image[row, column].astype(int) - BACKGROUND).max() > 30) == drawn


@needs_opengl
def test_the_target_shows_only_if_wanted():
    run = cone_run()

    def green(image):
        return int(((image[..., 1].astype(int) - image[..., 0]) > 40).sum())

    assert green(render_frame(run, 0.5, text=False, size=SMALL, traces=False)) > 100
    assert green(render_frame(run, 0.5, text=False, size=SMALL, traces=False, target=False)) == 0


@needs_opengl
def test_traces_grow():
    def traced(time):
        with_traces, bare = (
            render_frame(cone_run(), time, text=False, size=(640, 360), target=False, traces=traces)
            for traces in (True, False)
        )
        return int(np.any(with_traces != bare, axis=2).sum())

    assert traced(0.0) == 0
    assert traced(1.9) > traced(0.5) + 50 > 100


@needs_opengl
def test_long_traces_lose_their_oldest_part_and_frames_do_not_depend_on_history():
    times = np.linspace(0.0, 200.0, 4001)
    nodes, velocities = cone_motion(times)
    nodes[:, 1] *= 1.0 + 0.3 * np.sin(0.37 * times)[:, None]  # not a rod any more; the picture does not mind
    velocities[:] = 0.0
    run = run_of(cone_scene(), times, nodes, velocities, np.full((len(times), 3), 0.1))
    with stage_of(run, size=SMALL) as stage:
        assert len(stage._traces[0].times) > MAX_PIECES
        for time in (3.0, 50.0, 200.0):
            late = stage.frame(time).copy()
        early = stage.frame(3.0).copy()
    assert np.array_equal(early, render_frame(run, 3.0, size=SMALL, text=False))
    # Traces of the same colour: drawn in another order where they cross, they may differ in single pixels.
    assert np.mean(np.any(late != render_frame(run, 200.0, size=SMALL, text=False), axis=2)) < 1e-3


@needs_opengl
def test_another_run_is_a_ghost_or_stands_beside():
    run, other = cone_run(engine="formula A"), cone_run(engine="formula B")
    nodes = other.nodes.copy()
    nodes[:, 1, :2] *= -1.0
    other = replace(other, nodes=nodes, velocities=-other.velocities)
    alone = render_frame(run, 1.0, size=(640, 360), text=False, target=False, traces=False).astype(int)
    overlaid = render_frame(run, 1.0, other=other, size=(640, 360), text=False, target=False, traces=False).astype(int)
    ghost = (overlaid[..., 2] - overlaid[..., 0]) > 60
    assert ghost.sum() > ((alone[..., 2] - alone[..., 0]) > 60).sum() + 300
    twice = render_frame(run, 1.0, other=run, layout=Layout.SIDE_BY_SIDE, size=(640, 360), text=False)
    assert np.array_equal(twice[:, :320], twice[:, 320:])
    apart = render_frame(run, 1.0, other=other, layout=Layout.SIDE_BY_SIDE, size=(640, 360), text=False)
    assert not np.array_equal(apart[:, :320], apart[:, 320:])


@needs_opengl
def test_a_ghost_at_the_same_place_leaves_the_run_visible():
    # Agreement to round-off is the usual case: the solid run keeps its colours, the ghost is a rim around it.
    run = cone_run()
    plain = render_frame(run, 1.0, size=(640, 360), text=False, target=False, traces=False)
    both = render_frame(run, 1.0, other=run, size=(640, 360), text=False, target=False, traces=False)
    rod = distance_from(plain, palette.ROD) < 25
    assert rod.sum() > 300
    assert np.mean(distance_from(both, palette.ROD)[rod] < 25) > 0.9
    assert np.any(plain != both, axis=2).sum() > 300


@needs_opengl
def test_the_clock_is_all_that_text_changes():
    scene = cone_scene()
    times = np.linspace(0.0, 2.0, 3)
    still = np.broadcast_to(scene.structure.positions, (3, 5, 3))
    run = run_of(scene, times, still, np.zeros((3, 5, 3)), np.full((3, 3), 0.1), engine="still")
    first, later = (image for image in frames(run, size=(640, 360), fps=0.5))
    changed = np.any(first != later, axis=2)
    rows, columns = np.flatnonzero(changed.any(axis=1)), np.flatnonzero(changed.any(axis=0))
    assert changed.any()
    assert rows[-1] < 36
    assert columns[0] > 480


def test_the_clock_leaves_nothing_of_a_wider_time():
    labels = Labels(640, 360, 1, 1)
    used, fresh = np.array(labels.blank()), np.array(labels.blank())
    used[200:, 300] = fresh[200:, 300] = 7
    labels.clock(used, "t = 10.00 s")
    labels.clock(used, "t = 9.00 s")
    Labels(640, 360, 1, 1).clock(fresh, "t = 9.00 s")
    assert np.array_equal(used, fresh)
    assert fresh[:100].min() < 100


# ------------------------------------------------------------------------------ floors, shadows, cameras that move


def fallen_run(shift=(0.0, 0.0, 0.4)) -> Trajectory:
    """The dropped prism, that comes down from `shift` [m] in the first tenth of its time and then lies on its floor."""
    scene = tmj.load_scene("prism_drop")
    lying = scene.nodes0 - (floor_gaps(scene.structure, scene.contact, scene.nodes0).min() - 1e-4) * np.array([0, 0, 1])
    times = np.linspace(0.0, 2.0, 41)
    share = np.clip(1.0 - times / 0.2, 0.0, 1.0)[:, None, None]
    nodes = lying + share * np.array(shift)
    return run_of(scene, times, nodes, np.zeros_like(nodes), np.full((41, 12), 5.0))


def test_shadows_lie_on_the_floor_under_their_members_and_darken_as_these_come_near():
    run = fallen_run()
    scene = run.scene
    floor = (np.zeros(3), np.array([0.0, 0.0, 1.0]))
    radii = np.full(3, 0.01)
    high, low = (list(patches(floor, scene.structure, nodes, radii, 0.002, 0.5)) for nodes in run.nodes[[0, -1]])
    for shown, nodes in ((high, run.nodes[0]), (low, run.nodes[-1])):
        assert len(shown) <= geoms_needed(scene.structure)
        for patch in shown:
            assert patch.middle[2] == pytest.approx(0.0, abs=1e-15)
            assert 0.0 <= patch.darkness <= 1.0
            assert np.linalg.det(patch.axes) == pytest.approx(1.0)
        box = np.array([patch.middle[:2] for patch in shown])
        assert np.all(box >= nodes[:, :2].min(axis=0) - 1e-12)
        assert np.all(box <= nodes[:, :2].max(axis=0) + 1e-12)
    assert max(p.darkness for p in low) > 1.5 * max(p.darkness for p in high)
    touching = [patch for patch in low if patch.round]
    assert len(touching) == 6  # a broad and a narrow one under each of the three ends that stand on the floor
    assert not any(patch.round for patch in high)


@needs_opengl
def test_a_landed_structure_has_shadows_on_its_floor():
    run = fallen_run()
    with stage_of(run, size=(640, 360), traces=False) as stage:
        image = stage.frame(2.0).copy()
        camera = stage.framing.path.at(2.0) if stage.framing.path else stage.framing.camera
        nodes = run.nodes[-1]
        i, j = run.scene.structure.rod_nodes[0]
        # Halfway up a rod, straight down on the floor: not the floor's colour, but darker.
        place = 0.5 * (nodes[i] + nodes[j]) * [1.0, 1.0, 0.0]
        x, y = camera.project(place)
        shade = image[int(180 - 180 * y), int(320 + 180 * x)].astype(int)
        assert shade.sum() < 3 * 255 * np.mean(palette.FLOOR) - 40


@needs_opengl
def test_uneven_ground_is_drawn_at_its_height():
    """A mound beside the structure hides the backdrop as far up as it stands, and no further."""
    scene = tmj.load_scene("prism_drop")
    mound = Heights(heights=[[0.0, 0.0, 0.5, 0.5, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]] * 9, spacing=0.3)
    hilly = scene.with_(contact=replace(scene.contact, terrain=mound))
    with stage_of(hilly, size=(640, 360), azimuth=90.0, elevation=-10.0, distance=3.0) as stage:
        image = stage.frame(0.0).astype(int)
        low, high = (image[pixel(stage, (-0.6, 0.0, z))[::-1]] for z in (0.4, 0.9))
    backdrop = palette.to_bytes(palette.BACKGROUND)
    assert np.abs(low - backdrop).max() > 40
    assert np.abs(high - backdrop).max() < 5


def test_a_camera_that_moves_never_loses_what_it_shows_and_comes_nearer():
    run = fallen_run((0.9, 0.0, 0.4))
    framing = Framing([Motion.of(run)], [None], View(), 16 / 9)
    path = framing.path
    assert path is not None
    assert path.at(2.0).distance == pytest.approx(NEAREST * framing.camera.distance)
    assert path.at(0.0).distance > path.at(2.0).distance
    for time in path.times:
        seen = path.at(time).project(run.nodes[np.argmin(np.abs(run.time - time))])
        assert np.all(np.abs(seen) <= [16 / 9, 1.0])
    # Smoothly: from one of its hundred instants to the next it moves by no more than a few percent of its distance.
    places = np.array([path.at(time).position for time in path.times])
    assert np.linalg.norm(np.diff(places, axis=0), axis=1).max() < 0.05 * framing.camera.distance


def test_a_camera_stands_still_where_that_shows_as_much():
    assert Framing([Motion.of(cone_run())], [None], View(), 16 / 9).path is None
    assert Framing([Motion.of(fallen_run())], [None], View(distance=3.0), 16 / 9).path is None


@needs_opengl
def test_strings_may_be_as_thick_as_they_pull():
    run = cone_run()
    tensions = np.broadcast_to([1.0, 1.0, 1e-3], run.tensions.shape)
    counts = []
    for thickness in (False, True):
        image = render_frame(
            replace(run, tensions=tensions), 0.0, size=(640, 360), text=False, thickness=thickness, traces=False
        )
        strong, weak = palette.tension_colors([1.0, 1e-3])
        counts.append([int((distance_from(image, tuple(c)) < 60).sum()) for c in (strong, weak)])
    assert counts[1][0] > 1.8 * counts[0][0]  # three times the thickness, less what they cover of one another
    assert counts[1][1] < 0.8 * counts[0][1]


@needs_opengl
def test_a_still_is_transparent_cut_to_what_shows_and_knows_its_dots(tmp_path: Path):
    run = cone_run()
    path = still(run, tmp_path / "still.png", 1.0, dpi=150, size=(640, 360))
    with PillowImage.open(path) as opened:
        assert opened.info["dpi"] == pytest.approx((150, 150), abs=0.1)
        pixels = np.asarray(opened)
    assert pixels.shape[2] == 4
    assert pixels.shape[0] < 360
    opacity = pixels[..., 3]
    assert set(np.unique(opacity)) >= {0, 255}
    assert opacity[0].any()
    assert opacity[:, 0].any()
    # On the pictures' background it is the picture.
    with stage_of(run, size=(640, 360), traces=False, quality=Quality.BEST) as stage:
        color, share = stage.cut_out(1.0)[..., :3] / 255.0, stage.cut_out(1.0)[..., 3:] / 255.0
        on = 255.0 * (color * share + np.array(palette.BACKGROUND) * (1.0 - share))
        assert np.abs(on - stage.frame(1.0)).max() <= 3.0  # each of the three is rounded once or twice


@pytest.mark.parametrize(
    ("options", "message"),
    [({"dpi": 900.0}, "at most 4096"), ({"dpi": -1.0}, "dpi"), ({"time": 9.0}, "lasts from")],
)
@needs_opengl
def test_stills_that_cannot_be_are_refused(tmp_path: Path, options, message):
    with pytest.raises(OptionError, match=message):
        still(cone_run(), tmp_path / "still.png", **options)
    assert not list(tmp_path.iterdir())


@needs_opengl
@pytest.mark.parametrize(("ending", "start"), [(".gif", b"GIF89a"), (".webm", b"\x1aE\xdf\xa3"), (".mp4", b"\0\0\0")])
def test_films_are_of_the_kind_that_their_ending_says(tmp_path: Path, ending, start):
    path = render(cone_run(), tmp_path / f"film{ending}", size=(64, 64), fps=5)
    assert path.read_bytes().startswith(start)
    if ending == ".gif":
        with PillowImage.open(path) as film:
            assert film.n_frames == 11


def test_a_gif_has_at_most_fifty_frames_a_second(tmp_path: Path):
    with pytest.raises(OptionError, match="at most 50"):
        render(cone_run(), tmp_path / "film.gif", fps=60)


@needs_opengl
def test_pictures_can_be_drawn_in_turn():
    one, other = cone_run(), cone_run(scene=cone_scene("another"))
    first, second = frames(one, size=SMALL, fps=2), frames(other, size=(160, 120), fps=2)
    mixed = [(next(first).copy(), next(second).copy()) for _ in range(3)]
    apart = list(zip(frames(one, size=SMALL, fps=2), frames(other, size=(160, 120), fps=2), strict=True))[:3]
    for (a, b), (c, d) in zip(mixed, apart, strict=True):
        assert np.array_equal(a, c)
        assert np.array_equal(b, d)


@needs_opengl
@pytest.mark.parametrize("make", [two_masses, lambda: planar_scene((0, 0, 1)), lambda: planar_scene((1, 2, 3))])
def test_every_kind_of_structure_can_be_drawn(make):
    image = render_frame(make(), size=SMALL, text=False)
    assert (np.abs(image.astype(int) - BACKGROUND).max(axis=2) > 60).sum() > 100


@needs_opengl
def test_a_diverged_run_still_shows_its_start():
    run = cone_run()
    nodes = run.nodes.copy()
    nodes[15:, 1] *= 1e7 ** np.linspace(0.1, 1.0, 6)[:, None]
    run = replace(run, nodes=nodes, status=Status.DIVERGED)

    def drawn(run):
        image = render_frame(run, 0.5, size=SMALL, text=False, target=False, traces=False)
        return (distance_from(image, palette.ROD) < 60).sum()

    # At most 2.5 times as much is framed as the start needs: an area of 1/6.25, and a little less at this resolution.
    assert drawn(run) > drawn(cone_run()) / 10
    assert render_frame(run, size=SMALL).shape == (240, 320, 3)


# ------------------------------------------------------------------------------------------ files


@needs_opengl
def test_a_video_has_every_frame(tmp_path: Path):
    import imageio_ffmpeg

    target = render(cone_run(), tmp_path / "film.mp4", size=SMALL, fps=10, speed=2.0)
    count, seconds = imageio_ffmpeg.count_frames_and_secs(str(target))
    # 2 s at double speed are 1 s of video: frames at 0, 0.2, ..., 2.0 s.
    assert count == 11
    assert seconds == pytest.approx(1.1, abs=0.06)
    assert [p.name for p in tmp_path.iterdir()] == ["film.mp4"]


@needs_opengl
def test_a_video_shows_what_the_frames_show(tmp_path: Path):
    import imageio_ffmpeg

    run = cone_run()
    target = render(run, tmp_path / "film.mp4", size=SMALL, fps=4)
    reader = imageio_ffmpeg.read_frames(str(target))
    next(reader)
    films = [np.frombuffer(data, np.uint8).reshape(240, 320, 3) for data in reader]
    for film, frame in zip(films, frames(run, size=SMALL, fps=4), strict=True):
        # Compression blurs edges; on the average, a frame is within 2 of 255, and 10 frames apart it is not.
        assert np.abs(film.astype(int) - frame).mean() < 2.0


@needs_opengl
@pytest.mark.parametrize("error", [KeyboardInterrupt, ValueError])
def test_an_interrupted_video_leaves_the_old_file_and_nothing_else(tmp_path: Path, monkeypatch, error):
    import mediapy

    target = tmp_path / "film.mp4"
    target.write_bytes(b"old")
    draw, close, closed = Stage.frame, mediapy.VideoWriter.close, []

    def broken_off(self):
        closed.append(self)
        close(self)
        raise RuntimeError("ffmpeg was interrupted too")  # as it is by Ctrl-C; the first reason is the one to report

    monkeypatch.setattr(mediapy.VideoWriter, "close", broken_off)

    def interrupted(self, time):
        if time > 0.5:
            raise error
        return draw(self, time)

    monkeypatch.setattr(Stage, "frame", interrupted)
    with pytest.raises(error):
        render(cone_run(), target, size=SMALL)
    assert target.read_bytes() == b"old"
    assert [p.name for p in tmp_path.iterdir()] == ["film.mp4"]
    assert len(closed) == 1


@needs_opengl
def test_an_ffmpeg_that_fails_is_an_error_of_ours(tmp_path: Path, monkeypatch):
    broken = tmp_path / "ffmpeg"
    broken.write_text("#!/bin/sh\necho no such codec >&2\nexit 1\n")
    broken.chmod(0o755)
    monkeypatch.setenv("IMAGEIO_FFMPEG_EXE", str(broken))
    monkeypatch.setattr("tensegrity_mj.pictures.video.ffmpeg_program", lambda: str(broken))
    with pytest.raises(OptionError, match="could not write"):
        render(cone_run(), tmp_path / "film.mp4", size=SMALL)
    assert not (tmp_path / "film.mp4").exists()


@needs_opengl
def test_a_picture_is_a_png(tmp_path: Path):
    from PIL import Image

    target = picture(cone_scene(), tmp_path / "cone.png", size=(400, 300), quality=Quality.FAST)
    with Image.open(target) as image:
        assert image.size == (400, 300)
        assert np.array_equal(np.asarray(image), render_frame(cone_scene(), size=(400, 300), quality=Quality.FAST))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"size": (0, 720)}, "size"),
        ({"size": (641, 360)}, "even"),
        ({"size": (640.0, 360)}, "whole"),
        ({"size": (10000, 360)}, "4096"),
        ({"size": 640}, "size"),
        ({"fps": 0}, "fps"),
        ({"fps": math.nan}, "fps"),
        ({"speed": -1.0}, "speed"),
        ({"speed": 1e-9}, "frames"),
        ({"azimuth": math.inf}, "azimuth"),
        ({"elevation": 91.0}, "elevation"),
        ({"distance": 0.0}, "distance"),
        ({"layout": "overlay"}, "layout"),
        ({"quality": "good"}, "quality"),
        ({"other": "a run"}, "Trajectory"),
    ],
)
def test_bad_options_are_refused(tmp_path: Path, options, message):
    if message in ("azimuth", "elevation", "layout") and opengl_reason():
        pytest.skip("found after OpenGL is")
    with pytest.raises(OptionError, match=message):
        render(cone_run(), tmp_path / "film.mp4", **options)
    assert not list(tmp_path.iterdir())


def test_bad_paths_are_refused(tmp_path: Path):
    for name, message in (("film.avi", "mp4"), ("film", "mp4"), ("nowhere/film.mp4", "no folder")):
        with pytest.raises(OptionError, match=message):
            render(cone_run(), tmp_path / name)
    (tmp_path / "folder.mp4").mkdir()
    with pytest.raises(OptionError, match="folder"):
        render(cone_run(), tmp_path / "folder.mp4")
    with pytest.raises(OptionError, match="png"):
        picture(cone_scene(), tmp_path / "picture.jpg")


def test_empty_runs_are_refused(tmp_path: Path):
    with pytest.raises(OptionError, match="no sample"):
        render(cone_run().until(0), tmp_path / "film.mp4")


@needs_opengl
def test_a_time_outside_the_run_is_refused():
    with pytest.raises(OptionError, match="lasts from 0 to 2 s"):
        render_frame(cone_run(), 2.5)


def test_frame_times_are_exact_and_reach_the_end():
    times = frame_times(0.0, 10.0, 30.0, 1.0)
    assert len(times) == 301
    assert times[-1] == pytest.approx(10.0, abs=1e-12)
    assert np.array_equal(frame_times(1.0, 1.0, 30.0, 1.0), [1.0])
    assert frame_times(0.0, 1.0, 8.0, 0.5).tolist() == [k / 16 for k in range(17)]


# ------------------------------------------------------------------------------------------ OpenGL


@pytest.fixture
def bare_machine(monkeypatch):
    """As on a machine without display and libraries."""
    for name in ("MUJOCO_GL", "DISPLAY", "WAYLAND_DISPLAY", "PYOPENGL_PLATFORM"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr(opengl, "_loadable", lambda *names: None)
    count_devices = opengl.egl_devices
    count_devices.cache_clear()
    yield monkeypatch
    count_devices.cache_clear()


@pytest.mark.skipif(sys.platform != "linux", reason="the choice is simple elsewhere")
def test_without_opengl_the_error_names_the_packages(bare_machine, tmp_path: Path):
    for chosen in ("", "egl", "osmesa"):
        bare_machine.setenv("MUJOCO_GL", chosen)
        with pytest.raises(MissingLibraryError, match="libegl1 libegl-mesa0 libgl1-mesa-dri libopengl0") as caught:
            render(cone_run(), tmp_path / "film.mp4")
        assert "libosmesa6" in str(caught.value)
    assert not list(tmp_path.iterdir())


def test_the_environment_may_choose_the_opengl(bare_machine):
    bare_machine.setenv("MUJOCO_GL", "off")
    with pytest.raises(MissingLibraryError, match="switches off"):
        opengl.choose_backend()
    bare_machine.setenv("MUJOCO_GL", "paper")
    with pytest.raises(OptionError, match="paper"):
        opengl.choose_backend()
    bare_machine.setenv("MUJOCO_GL", "glfw")
    assert opengl.choose_backend() == "glfw"


@pytest.mark.skipif(sys.platform != "linux", reason="the choice is simple elsewhere")
def test_egl_is_preferred_to_osmesa_and_needs_no_display(bare_machine):
    bare_machine.setattr(opengl, "egl_devices", lambda: 1)
    assert opengl.choose_backend() == "egl"
    bare_machine.setattr(opengl, "egl_devices", lambda: 0)
    bare_machine.setattr(opengl, "has_osmesa", lambda: True)
    assert opengl.choose_backend() == "osmesa"
