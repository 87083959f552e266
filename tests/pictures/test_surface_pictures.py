"""Pictures of water: its surface is where the sea is at the frame's time, and what is under it shows through."""

from __future__ import annotations

import math
from dataclasses import replace

import mujoco
import numpy as np
import pytest
from analytic_runs import cone_run, cone_scene, planar_scene, run_of

from tensegrity_mj.engines.mujoco.settings import MuJoCo
from tensegrity_mj.errors import MissingLibraryError
from tensegrity_mj.model.elements.water import Water
from tensegrity_mj.model.elements.waves import Sea, Wave
from tensegrity_mj.model.scene import Scene
from tensegrity_mj.pictures import opengl, palette
from tensegrity_mj.pictures.camera import AFLOAT, Camera, broadside
from tensegrity_mj.pictures.motion import Motion
from tensegrity_mj.pictures.painter import make_model
from tensegrity_mj.pictures.stage import Stage
from tensegrity_mj.pictures.surface import MOST_POINTS, Surface
from tensegrity_mj.pictures.video import frames, render_frame
from tensegrity_mj.pictures.view import Layout, View
from tensegrity_mj.runs.trajectory import Trajectory

SIZE = (640, 360)
G = 9.81
TIMES = np.linspace(0.0, 2.0, 5)
BACKGROUND = np.array(palette.to_bytes(palette.BACKGROUND), int)
# Two components, obliquely, in water that is neither deep nor shallow for them.
CROSSED = Water(waves=(Wave(0.1, 2.0, direction=0.5, phase=0.3), Wave(0.04, 1.1, direction=-1.0)), depth=0.4)
ALONG = Water(waves=(Wave(0.25, 4.0),))
STILL = Water()


def opengl_reason() -> str:
    try:
        opengl.choose_backend()
    except MissingLibraryError as error:
        return str(error)
    return ""


needs_opengl = pytest.mark.skipif(bool(opengl_reason()), reason=opengl_reason() or "OpenGL works")


def wet(water: Water = ALONG) -> Scene:
    """A rod along x on the still surface and one along z, from -1 to 0.8 m, in a ring of four strings."""
    return planar_scene((0, 1, 0)).with_(gravity=(0.0, 0.0, -G), water=water)


def still_run(scene: Scene, drift: float = 0.0) -> Trajectory:
    """Of a structure that stands still, or drifts along x [m/s], in waves that move."""
    nodes = np.repeat(scene.nodes0[None], len(TIMES), axis=0)
    nodes[..., 0] += drift * TIMES[:, None]
    velocities = np.zeros_like(nodes)
    velocities[..., 0] = drift
    return run_of(scene, TIMES, nodes, velocities, np.full((len(TIMES), len(scene.structure.strings)), 0.1))


def stage_of(source: Trajectory | Scene, **options) -> Stage:
    options = {"size": SIZE, "text": False, "traces": False} | options
    return Stage(Motion.of(source), None, Layout.OVERLAY, View(**options))


def drawn_surface(stage: Stage) -> np.ndarray:
    """(I, J, 3): the vertices of the surface in what the renderer was given for the last frame."""
    scene, surface = stage._painters[0].scene, stage._surface
    first, count = int(scene.skinvertadr[0]), len(surface.x) * len(surface.y)
    return np.array(scene.skinvert[3 * first : 3 * (first + count)], float).reshape(len(surface.x), len(surface.y), 3)


def elevation_by_hand(water: Water, time: float, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    depth = math.inf if water.depth is None else water.depth
    height = np.zeros_like(x)
    for wave in water.waves:
        k = 2 * math.pi / wave.wavelength
        along = x * math.cos(wave.direction) + y * math.sin(wave.direction)
        height += wave.amplitude * np.sin(math.sqrt(G * k * math.tanh(k * depth)) * time + wave.phase - k * along)
    return height


def column_row(stage: Stage, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Columns and rows [px], fractions of them too, of points (..., 3) [m] in a stage without text."""
    width, height = stage.view.size
    seen = stage.framing.camera.project(points)
    return 0.5 * (width + height * seen[..., 0]), 0.5 * height * (1.0 - seen[..., 1])


def at(image: np.ndarray, stage: Stage, point) -> np.ndarray:
    column, row = column_row(stage, np.asarray(point, float))
    return image[int(row), int(column)].astype(int)


# ------------------------------------------------------------------------------------------ the block


def sea_of(water: Water) -> Sea:
    return Sea.of(water.waves, G, water.depth)


def block(water: Water, nodes: np.ndarray | None = None, cell: float = 0.2) -> Surface:
    nodes = wet(water).nodes0 if nodes is None else nodes
    return Surface.enclosing(nodes, (float(nodes[:, 2].min()), float(nodes[:, 2].max())), cell, [sea_of(water)])


@pytest.mark.parametrize("water", [CROSSED, ALONG, STILL])
def test_the_block_holds_the_structure_and_its_pieces_are_short(water):
    surface, nodes = block(water), wet(water).nodes0
    extent = np.linalg.norm(np.ptp(nodes, axis=0))
    for line, k in ((surface.x, 0), (surface.y, 1)):
        assert line[0] <= nodes[:, k].min() - 0.15 * extent
        assert line[-1] >= nodes[:, k].max() + 0.15 * extent
        assert np.allclose(line[:: surface.every] / 0.2, np.round(line[:: surface.every] / 0.2), atol=1e-9)
        assert np.allclose(np.diff(line), 0.2 / surface.every, atol=1e-12)
    for wave in water.waves:
        assert 0.2 / surface.every <= wave.wavelength / 20 * (1 + 1e-9)
    assert surface.bottom < -surface.crest


def test_short_waves_cost_no_more_than_the_most():
    surface = block(Water(waves=(Wave(1e-4, 1e-3), Wave(0.1, 3.0))))
    # Too small to count: as without.
    assert surface.every == block(Water(waves=(Wave(0.1, 3.0),))).every
    surface = block(Water(waves=(Wave(0.01, 1e-9),)))
    cells = [(len(line) - 1) // surface.every for line in (surface.x, surface.y)]
    assert len(surface.x) * len(surface.y) > 0.25 * MOST_POINTS
    assert np.prod(cells) * surface.every**2 <= MOST_POINTS


def test_the_bottom_is_shown_where_it_is_near():
    assert block(STILL).shallow is False
    assert block(replace(STILL, depth=3.0)).shallow is False
    near = block(replace(STILL, depth=1.5))
    assert (near.shallow, near.bottom) == (True, -1.5)


def test_triangles_look_the_way_of_their_normals():
    surface = block(CROSSED).lined(0.01, Camera(125.0, -18.0))
    meshes = surface.meshes(surface.points(sea_of(CROSSED), 0.7, np.zeros(2)))
    assert [len(vertices) for vertices, _ in meshes] == [faces.max() + 1 for faces in surface.faces]
    for (vertices, normals), faces, sides in zip(meshes, surface.faces, (2, 1, 2), strict=True):
        assert np.allclose(np.linalg.norm(normals, axis=1), 1.0)
        assert np.array_equal(np.unique(faces), np.arange(len(vertices)))
        corners = vertices[faces]
        area = 0.5 * np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        outward = np.sum(area * normals[faces].mean(axis=1), axis=1)
        half = len(faces) // sides
        if sides == 2:
            assert np.array_equal(faces[:half], faces[half:, ::-1])
        if sides == 1 or len(vertices) == surface.x.size * surface.y.size:
            assert outward[:half].min() > 0.0
    # The upper side, the walls and a flat lower side enclose the volume by the divergence theorem, 1/3 Σ x·A; without
    # the lower side, whose part is -z A = -bottom times its area, over 3.
    upper, walls = surface.faces[0][: len(surface.faces[0]) // 2], surface.faces[1]
    flux = 0.0
    for (vertices, _), faces in zip(meshes[:2], (upper, walls), strict=True):
        corners = vertices[faces]
        flux += np.sum(np.cross(corners[:, 1], corners[:, 2]) * corners[:, 0]) / 6.0
    ground = np.ptp(surface.x) * np.ptp(surface.y)
    points = surface.points(sea_of(CROSSED), 0.7, np.zeros(2))
    # Of two triangles a cell: each has a third of its corners' heights; the two on the diagonal count twice.
    z = points[..., 2] - surface.bottom
    cell = (surface.x[1] - surface.x[0]) * (surface.y[1] - surface.y[0])
    prisms = cell / 6.0 * np.sum(2 * z[:-1, :-1] + z[1:, :-1] + 2 * z[1:, 1:] + z[:-1, 1:])
    assert flux - surface.bottom * ground / 3.0 == pytest.approx(prisms, rel=1e-12)


def test_normals_are_those_of_the_sea():
    # Central differences of a sine err by (k h)²/6 of the slope, 20 pieces a wave: 1.6 %; at the edges, one-sided, by
    # k h / 2 of the largest slope. Slopes are at most A k.
    water = Water(waves=(Wave(0.1, 2.0, direction=0.5),))
    surface, k = block(water), math.pi
    points = surface.points(sea_of(water), 0.4, np.zeros(2))
    normals = surface.meshes(points)[0][1].reshape(points.shape)[1:-1, 1:-1]
    x, y = points[1:-1, 1:-1, 0], points[1:-1, 1:-1, 1]
    theta = math.sqrt(G * k) * 0.4 - k * (x * math.cos(0.5) + y * math.sin(0.5))
    for axis, part in ((0, math.cos(0.5)), (1, math.sin(0.5))):
        slope = -0.1 * k * part * np.cos(theta)
        assert np.abs(-normals[..., axis] / normals[..., 2] - slope).max() < 0.1 * k * (2 * math.pi / 20) ** 2 / 6


# ------------------------------------------------------------------------------------------ in the picture


@needs_opengl
@pytest.mark.parametrize("water", [CROSSED, ALONG, STILL])
@pytest.mark.parametrize("time", [0.0, 0.83, 2.0])
def test_vertices_are_at_the_seas_elevation_at_the_frames_time(water, time):
    with stage_of(still_run(wet(water))) as stage:
        stage.frame(time)
        points = drawn_surface(stage)
        # The renderer has single precision, 6e-8 of places below 4 m: 2.4e-7, times slopes below 0.6, and of heights.
        assert np.abs(points[..., 2] - elevation_by_hand(water, time, points[..., 0], points[..., 1])).max() < 5e-7
        if water.waves:
            assert np.ptp(points[..., 2]) > water.waves[0].amplitude


@needs_opengl
def test_the_block_goes_with_a_structure_that_travels():
    drift = 20.0
    with stage_of(still_run(wet(CROSSED), drift)) as stage:
        assert stage.framing.follow
        for time in (0.0, 0.9, 2.0):
            stage.frame(time)
            points = drawn_surface(stage)
            moved = wet().nodes0[:, 0] + drift * time
            assert points[..., 0].min() < moved.min() - 0.2
            assert points[..., 0].max() > moved.max() + 0.2
            # Single precision at 40 m: 2e-6, times slopes below 0.6.
            expected = elevation_by_hand(CROSSED, time, points[..., 0], points[..., 1])
            assert np.abs(points[..., 2] - expected).max() < 2e-6
            piece = stage.framing.cell / stage._surface.every
            assert np.abs(points[:, 0, 0] / piece - np.round(points[:, 0, 0] / piece)).max() < 1e-4


@needs_opengl
@pytest.mark.parametrize("time", [0.0, 0.4, 1.1])
def test_water_is_below_the_line_and_air_above(time):
    # Seen from the side, the outline is that of the near or of the far edge, whichever looks higher.
    # It drifts, which makes the block long.
    with stage_of(still_run(wet(), 2.0), elevation=0.0, azimuth=90.0) as stage:
        assert not stage.framing.follow
        image = stage.frame(time).astype(int)
        points, seen = stage._surface.points(stage._seas[0], time, np.zeros(2)), 0
        for row in np.linspace(1, len(points) - 2, 25).astype(int):
            if -1.5 < points[row, 0, 0] - 2.0 * time < 1.3:  # the structure may be in front
                continue
            middle, _ = column_row(stage, points[row, 0])
            columns, rows = column_row(stage, points[:, [0, -1]])
            if not columns[0, 1] < middle < columns[-1, 1]:  # the far edge does not reach so far
                continue
            column, seen = int(middle), seen + 1
            heights = [np.interp(middle, columns[:, j], rows[:, j]) for j in (0, 1)]
            above, below = int(min(heights)) - 4, int(max(heights)) + 5
            assert np.abs(image[above, column] - BACKGROUND).max() <= 3
            red, _, blue = image[below, column]
            assert blue - red > 15
        assert seen >= 6


@needs_opengl
def test_only_waves_move():
    waves, calm = (
        [render_frame(still_run(wet(water)), time, size=SIZE, traces=False, text=False) for time in (0.0, 0.5, 1.3)]
        for water in (ALONG, STILL)
    )
    for image in waves[1:]:
        assert np.mean(np.any(image != waves[0], axis=2)) > 0.02
    for image in calm[1:]:
        assert np.array_equal(image, calm[0])


@needs_opengl
def test_a_video_is_of_these_frames():
    run = still_run(wet())
    for time, image in zip((0.0, 1.0, 2.0), frames(run, size=SIZE, fps=1.0), strict=True):
        assert np.array_equal(image, render_frame(run, time, size=SIZE))


@needs_opengl
@pytest.mark.parametrize("elevation", [-30.0, 0.0, 25.0])
def test_what_is_under_water_shows_through_it_and_is_tinted(elevation):
    scene = wet(STILL)
    pair = scene.nodes0[scene.structure.rod_nodes[1]]
    low, high = pair[np.argsort(pair[:, 2])]
    dry = scene.with_(water=None)
    options = {"azimuth": 90.0, "elevation": elevation, "target": False}
    with stage_of(dry, **options) as bare, stage_of(scene, **options) as stage:
        without, image = bare.frame(0.0).copy(), stage.frame(0.0).copy()
        # The upper one is so low that it is seen through the surface from below.
        under, over = (low + share * (high - low) for share in (0.1, 1.15 / 1.8))
        tint = at(image, stage, under) - at(without, bare, under)
        # Bluer than in air, and yet much darker than the water beside it.
        assert tint[2] - tint[0] > 10
        assert at(image, stage, under + np.array([0.25, 0.0, 0.0])).sum() - at(image, stage, under).sum() > 100
        air = at(image, stage, over) - at(without, bare, over)
        if elevation <= 0.0:
            assert np.abs(air).max() < 12  # seen in front of, or above, the surface: its own colour
        else:
            assert air[2] - air[0] > 10  # seen through the surface, from below


@needs_opengl
def test_all_of_the_water_is_in_the_picture():
    for image in [render_frame(still_run(wet()), t, size=SIZE, text=False) for t in TIMES]:
        edge = np.concatenate([image[0], image[-1], image[:, 0], image[:, -1]])
        assert np.abs(edge.astype(int) - BACKGROUND).max() <= 1


@needs_opengl
def test_two_runs_each_have_their_own_sea():
    run, calm, dry = (still_run(wet().with_(water=water)) for water in (ALONG, STILL, None))
    options = {"size": SIZE, "text": False, "traces": False}
    both = render_frame(run, 0.5, other=calm, layout=Layout.SIDE_BY_SIDE, **options)
    assert not np.array_equal(both[:, :320], both[:, 320:])
    half = render_frame(run, 0.5, other=dry, layout=Layout.SIDE_BY_SIDE, **options).astype(int)
    tinted = half[..., 2] - half[..., 0] > 20
    assert tinted[:, :320].sum() > 5000
    # Strings without water may be blue, too; they are thin.
    assert tinted[:, 320:].sum() < 1000
    with Stage(Motion.of(dry), Motion.of(run), Layout.OVERLAY, View(SIZE)) as stage:
        stage.frame(0.5)
        points = drawn_surface(stage)
        assert np.abs(points[..., 2] - elevation_by_hand(ALONG, 0.5, points[..., 0], points[..., 1])).max() < 5e-7


@needs_opengl
def test_far_from_the_surface_the_structure_still_fills_the_picture():
    for height in (-1000.0, 1000.0):
        nodes = wet().nodes0 + np.array([0.0, 0.0, height])
        structure = wet().structure
        scene = wet().with_(initial_nodes=nodes)
        with stage_of(scene) as stage:
            image = stage.frame(0.0)
            rows = column_row(stage, nodes)[1]
            assert np.ptp(rows) > 0.25 * SIZE[1]
            middle = nodes[structure.rod_nodes[0]].mean(axis=0)
            assert at(image, stage, middle).max() < 170


# ------------------------------------------------------------------------------------------ the camera


def test_what_floats_is_seen_from_the_side():
    long = np.array([[x, y, z] for x in (-3.0, 4.0) for y in (-0.5, 0.5) for z in (-1.0, 1.0)])
    round_ = np.array([[x, y, 0.0] for x in (-1.0, 1.0) for y in (-1.0, 1.0)])

    def right(points: np.ndarray, *waves: float) -> np.ndarray:
        azimuth = broadside(points, waves)
        assert azimuth is not None
        return Camera(azimuth, AFLOAT).axes[0][:2]

    assert np.allclose(right(long), [1, 0], atol=1e-9)
    assert np.allclose(right(long, 0.4), [1, 0], atol=1e-9)
    assert np.allclose(right(long, math.pi - 0.4), [-1, 0], atol=1e-9)
    assert np.allclose(right(long[:, [1, 0, 2]]), [0, 1], atol=1e-9)
    # Abeam: the wave comes towards the viewer or goes away, and the long axis lies across all the same.
    assert np.allclose(right(long, math.pi / 2), [1, 0], atol=1e-9)
    # Not long: with the highest wave, to 2.5 degrees.
    assert right(round_, 2.2, 0.0) @ [math.cos(2.2), math.sin(2.2)] > math.cos(math.radians(2.5))
    tilted = long @ np.array([[1.0, 0.02, 0.0], [-0.02, 1.0, 0.0], [0.0, 0.0, 1.0]])
    assert np.allclose(right(tilted), [1, 0], atol=1e-9)
    assert broadside(round_, ()) is None
    assert broadside(np.zeros((3, 3)), ()) is None


@needs_opengl
def test_angles_that_were_requested_are_kept_over_water():
    with stage_of(wet(), azimuth=12.0, elevation=-34.0, distance=9.0) as stage:
        assert (stage.framing.camera.azimuth, stage.framing.camera.elevation, stage.framing.camera.distance) == (
            12.0,
            -34.0,
            9.0,
        )
    with stage_of(wet()) as stage:
        assert (stage.framing.camera.azimuth, stage.framing.camera.elevation) == (pytest.approx(90.0), AFLOAT)


# ------------------------------------------------------------------------------------------ only where there is water


@needs_opengl
def test_dry_pictures_have_no_part_of_it():
    assert make_model().nskin == 0
    with stage_of(cone_run()) as stage:
        stage.frame(1.0)
        assert stage._surface is None
        kinds = {geom.type for geom in stage._painters[0].scene.geoms[: stage._painters[0].scene.ngeom]}
        assert mujoco.mjtGeom.mjGEOM_SKIN.value not in kinds
    with stage_of(cone_scene().with_(gravity=(0.0, 0.0, -G), water=CROSSED)) as stage:
        assert stage._surface is not None


def test_the_simulated_model_has_no_surface():
    model = MuJoCo().model(wet())
    assert (model.nskin, model.nhfield, model.nflex) == (0, 0, 0)
