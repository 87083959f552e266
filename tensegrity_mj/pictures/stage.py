"""One film's worth of picture: camera, painters, text; frames of it at any time."""

from __future__ import annotations

import contextlib
import enum
import math
from dataclasses import dataclass, replace
from types import TracebackType

import numpy as np
from numpy.typing import NDArray

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.engines.mujoco.mjcf_frames import rotation_to
from tensegrity_mj.errors import OptionError
from tensegrity_mj.model.elements.waves import Sea
from tensegrity_mj.pictures import palette
from tensegrity_mj.pictures.camera import AFLOAT, FIELD_OF_VIEW, Camera, broadside, corners_of, direction, fit
from tensegrity_mj.pictures.labels import Labels, Legend, Name
from tensegrity_mj.pictures.motion import Motion, Pose
from tensegrity_mj.pictures.opengl import MAX_BUFFER, MAX_SIZE, Canvas, choose_backend
from tensegrity_mj.pictures.painter import (
    Look,
    Painter,
    Sizes,
    geoms_needed,
    make_model,
    slack_curves,
    supported_points,
)
from tensegrity_mj.pictures.surface import Surface
from tensegrity_mj.pictures.traces import MAX_PIECES, Traces, moving_rows

Image = NDArray[np.uint8]

MIN_SIZE = 16  # px
SAMPLES = 200  # instants of a run that the camera is fitted to
LEVEL = 0.9999  # cosine of the angle within which a floor is horizontal
FAR = 4.0  # times a structure's own extent: a run that travels farther is followed by the camera
BLOWN_UP = 2.5  # times its extent at the start: what a diverging structure grows to beyond that is not framed
TRACE_TOLERANCE = 0.4  # px
LINE = 1.5  # px; of lines on water
DEEP = 1.0  # times the extent: water is framed as far above and below the structure
SUNK = 4.0  # times the extent: as far it is drawn at all
MAX_GRID_LINES = 40  # a cell is at least 1/15 of the extent
HALF_VIEW = math.tan(math.radians(FIELD_OF_VIEW) / 2.0)  # of the distance: what half a picture's height spans


class Layout(enum.Enum):
    """How two runs are shown."""

    OVERLAY = "overlay"
    SIDE_BY_SIDE = "side-by-side"


class Quality(enum.Enum):
    """How edges are smoothed: frames are drawn larger and averaged down.

    FAST not at all; FINE 2 times (3/2 times for two runs side by side, which fill the frame); BEST 3 times, for stills.
    """

    FAST = "fast"
    FINE = "fine"
    BEST = "best"


@dataclass(frozen=True)
class View:
    """What the caller chose of the picture; all angles in degrees, None to have it chosen.

    Attributes:
        size: width and height [px].
        traces, target: whether these are drawn.
        azimuth, elevation: of the camera, in MuJoCo's sense (azimuth 90 looks along +y, elevation -90 down).
        distance: of the camera from the middle of what it sees [m].
        quality: of edges.
        text: whether title, time and legend are drawn.
    """

    size: tuple[int, int] = (1280, 720)
    traces: bool = True
    target: bool = True
    azimuth: float | None = None
    elevation: float | None = None
    distance: float | None = None
    quality: Quality = Quality.FINE
    text: bool = True

    def __post_init__(self) -> None:
        check_size(self.size)
        if self.distance is not None and not (math.isfinite(self.distance) and self.distance > 0.0):
            raise OptionError(f"distance={self.distance}: it must be a finite length > 0 [m], or None")
        if not isinstance(self.quality, Quality):
            raise OptionError(f"quality={self.quality!r}: it must be a Quality: {', '.join(str(q) for q in Quality)}")


def check_size(size: tuple[int, int]) -> None:
    """Raise OptionError unless the size is two whole numbers of pixels in the range that can be drawn."""
    whole = isinstance(size, (tuple, list)) and len(size) == 2
    whole = whole and all(isinstance(v, (int, np.integer)) and not isinstance(v, bool) for v in size)
    if not whole or not all(MIN_SIZE <= v <= MAX_SIZE for v in size):
        raise OptionError(
            f"size={size!r}: it must be (width, height), whole numbers of pixels from {MIN_SIZE} to {MAX_SIZE}"
        )


@dataclass(frozen=True)
class _Port:
    """A rectangle of the frame [px] that is drawn by OpenGL, and the columns that belong to it."""

    left: int
    top: int
    width: int
    height: int
    columns: tuple[int, int]


class Stage:
    """Draws frames of one motion, or of two in one of the layouts; a context manager.

    Raises:
        OptionError: for options that cannot be drawn.
        MissingLibraryError: without OpenGL.
    """

    def __init__(self, motion: Motion, other: Motion | None, layout: Layout, view: View) -> None:
        if not isinstance(layout, Layout):
            raise OptionError(f"layout={layout!r}: it must be Layout.OVERLAY or Layout.SIDE_BY_SIDE")
        choose_backend()  # before any work, and before MuJoCo is imported
        self.motions = [motion] if other is None else [motion, other]
        self.view = view
        self._split = other is not None and layout is Layout.SIDE_BY_SIDE
        self._seas = self._seas_shown()
        self._ghost = other if not self._split else None
        self.start = min(m.start for m in self.motions)
        self.end = max(m.end for m in self.motions)
        self._stack = contextlib.ExitStack()

        width, height = view.size
        columns = 2 if self._split else 1
        lines = 1 if self._split or other is None else 2
        if not any(m.label or m.note for m in self.motions):
            lines = 0
        self._labels = Labels(width, height, columns, lines)
        header, footer = (self._labels.header, self._labels.footer) if view.text else (0, 0)
        wish = {Quality.FAST: 1.0, Quality.FINE: 1.5 if columns == 2 else 2.0, Quality.BEST: 3.0}[view.quality]
        self._factor = max(
            f for f in (1.0, 1.5, 2.0, 3.0) if f == 1.0 or f <= min(wish, MAX_BUFFER / max(width, height))
        )

        self._plan_camera((width // columns) / (height - header - footer))
        self._ports = self._plan_ports(width // columns, columns, header, height - header - footer)
        self._scale = palette.TensionScale.of(np.concatenate([m.tensions.ravel() for m in self.motions]))
        self._draw_surroundings()
        try:
            self._open()
        except BaseException:
            self._stack.close()
            raise

    def __enter__(self) -> Stage:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self._stack.close()

    def frame(self, time: float) -> Image:
        """The picture (H, W, 3) at `time` [s], which is clipped to the run; it is overwritten by the next call."""
        from tensegrity_mj.pictures.shrink import shrink

        moment = min(max(time, self.start), self.end)
        for index, port in enumerate(self._ports):
            scene = self._compose(index, moment)
            pixels = self._canvas.draw(scene, *self._drawn_size(port))
            part = self._frame[port.top : port.top + port.height, port.left : port.left + port.width]
            shrink(pixels, self._factor, part)
        if self.view.text and len(self.motions[0].time) > 1:
            self._labels.clock(self._frame, self._clock_text(moment))
        return self._frame

    # ---------------------------------------------------------------------------------------------- planning

    def _plan_camera(self, aspect: float) -> None:
        """Find the camera that sees every sample of every run, and the sizes of members in its picture."""
        clouds, arcs, own = [], [], []
        for motion in self.motions:
            times = np.linspace(motion.start, motion.end, min(SAMPLES, 4 * len(motion.time)))
            paths = motion.positions(times)
            extents = np.linalg.norm(np.ptp(paths, axis=1), axis=1)
            usable = extents <= (BLOWN_UP * max(extents[0], 1e-12) if motion.diverged else np.inf)
            paths, times = paths[usable], times[usable]
            own.append(float(np.max(extents[usable])))
            middle = paths.mean(axis=1, keepdims=True)
            clouds.append((paths, middle))
            arcs.append((self._arcs(motion, times, paths), middle))
        size = max(*own, 1e-9)
        nodes = np.concatenate([paths.reshape(-1, 3) for paths, _ in clouds])
        self._follow = float(np.linalg.norm(np.ptp(nodes, axis=0))) > FAR * size
        if self._follow:
            nodes = np.concatenate([(paths - middle).reshape(-1, 3) for paths, middle in clouds])
            hanging = np.concatenate([(points - middle).reshape(-1, 3) for points, middle in arcs])
        else:
            nodes = np.concatenate([nodes, *self._target_clouds(size)])
            hanging = np.concatenate([points.reshape(-1, 3) for points, _ in arcs])
        extent = max(float(np.linalg.norm(np.ptp(nodes, axis=0))), 1e-9)
        self._sizes = [Sizes.of(m.structure, extent) for m in self.motions]
        margin = max(max(float(np.max(s.rod, initial=0.0)), 1.8 * s.support, s.point_mass) for s in self._sizes)
        camera = self._direction(nodes)
        if self.view.distance is not None:
            camera = Camera(camera.azimuth, camera.elevation, distance=self.view.distance)
        self._cell = palette.round_up(extent / 15.0, (1.0, 2.0, 5.0))
        wet, sunk = self._plan_water(nodes, clouds, extent)
        self._plan_grid(np.concatenate([nodes, wet]), extent, camera)
        self._points = np.concatenate([nodes, hanging, wet, self._grid_corners()])
        self._camera = fit(camera, self._points, 1.4 * margin, aspect, keep_distance=self.view.distance is not None)
        # What is too deep or too high to be framed is drawn as far as it shows.
        self._points = np.concatenate([self._points, sunk])
        middle = np.array(self._camera.look_at)
        self._reach = float(np.max(np.linalg.norm(self._points - middle, axis=1))) + 4.0 * margin

    def _seas_shown(self) -> list[Sea | None]:
        """Of each motion's picture; a ghost over a run is in the run's own sea, or brings its."""
        seas = [motion.sea for motion in self.motions]
        return seas if self._split else [next((sea for sea in seas if sea is not None), None)]

    def _direction(self, nodes: Array) -> Camera:
        """Of the camera, which sees waves pass from the side."""
        azimuth, elevation = self.view.azimuth, self.view.elevation
        sea = next((sea for sea in self._seas if sea is not None), None)
        if sea is not None:
            highest = sea.direction[np.argsort(-sea.amplitude, kind="stable")]
            azimuth = broadside(nodes, tuple(highest.tolist())) if azimuth is None else azimuth
            elevation = AFLOAT if elevation is None else elevation
        return direction(nodes, self._corners(), azimuth, elevation)

    def _plan_water(self, nodes: Array, clouds: list[tuple[Array, Array]], extent: float) -> tuple[Array, Array]:
        """Where the water lies; its corners (8, 3) [m], or none, as far as they are framed, and as far as drawn."""
        self._surface: Surface | None = None
        seas = [sea for sea in self._seas if sea is not None]
        if not seas:
            return np.zeros((0, 3)), np.zeros((0, 3))
        low, high = float(nodes[:, 2].min()), float(nodes[:, 2].max())
        # The camera that follows goes up and down with the structure, the water does not.
        middles = np.concatenate([middle[:, 0, 2] for _, middle in clouds]) if self._follow else np.zeros(1)
        world = low, high
        if self._follow:
            every = np.concatenate([paths[..., 2].ravel() for paths, _ in clouds])
            world = float(every.min()), float(every.max())
        self._surface = Surface.around(nodes, world, self._cell, seas)
        lowest = self._surface.bottom - float(middles.max())
        highest = self._surface.crest - float(middles.min())
        framed, drawn = (
            self._surface.corners(max(lowest, low - far * extent), min(max(highest, low), high + far * extent))
            for far in (DEEP, SUNK)
        )
        return framed, drawn

    def _corners(self) -> Array:
        """Where members of the first structure meet, at a few instants; of very many, every so many."""
        motion = self.motions[0]
        pairs = np.concatenate([motion.structure.rod_nodes, motion.structure.string_nodes])
        nodes = motion.positions(np.linspace(motion.start, motion.end, 1 if len(motion.time) == 1 else 7))
        return corners_of(pairs[:: 1 + len(pairs) // 150], nodes)

    def _arcs(self, motion: Motion, times: Array, paths: Array) -> Array:
        """Points (T, P, 3) of the strings that are slack at some time, for nodes (T, N, 3) at times (T,)."""
        ever = np.any(motion.rest_lengths > motion.structure.string_lengths(motion.nodes), axis=0)
        curves = np.zeros((len(times), 0, 3))
        if ever.any():
            poses = (motion.pose(time) for time in times)
            curves = np.stack([slack_curves(motion, pose, ever).reshape(-1, 3) for pose in poses])
        # A string that is far longer than the structure is wide would leave that tiny: it may leave the picture.
        middle, extent = paths.mean(axis=1, keepdims=True), np.linalg.norm(np.ptp(paths, axis=1), axis=1)
        near = np.linalg.norm(curves - middle, axis=2) <= 1.5 * extent[:, None]
        return np.where(near[..., None], curves, middle)

    def _target_clouds(self, size: float) -> list[Array]:
        clouds = []
        for motion in self.motions:
            targets = motion.target_positions(np.linspace(motion.start, motion.end, SAMPLES))
            if targets is None or not self.view.target:
                continue
            # A target far away is what a run aims at, not what it must show.
            near = np.linalg.norm(targets - motion.nodes[0].mean(axis=0), axis=-1) <= FAR * size
            clouds.append(targets[near])
        return clouds

    def _plan_grid(self, points: Array, extent: float, camera: Camera) -> None:
        """A horizontal grid that everything stands on, for scale and depth; none where it would be seen edge-on."""
        floor = next((m.floor for m in self.motions if m.floor is not None), None)
        if floor is None and self._surface is not None and self._surface.shallow:
            floor = np.array([0.0, 0.0, self._surface.bottom]), np.array([0.0, 0.0, 1.0])
        level = floor is None or floor[1][2] > LEVEL
        # Deep water has its grid on the surface.
        self._has_grid = camera.elevation < -2.0 and level and (self._surface is None or floor is not None)
        low, high = points.min(axis=0), points.max(axis=0)
        low[2] = low[2] - 1.05 * max(s.support for s in self._sizes) if floor is None else floor[0][2]
        # Whole cells that hold everything; a line a cell is drawn, so that their number is bounded by the extent.
        self._grid_low = np.array([*np.floor(low[:2] / self._cell + 1e-6) * self._cell, low[2]])
        self._grid_high = np.array([*np.ceil(high[:2] / self._cell - 1e-6) * self._cell, low[2]])
        flat = self._grid_low[:2] == self._grid_high[:2]
        self._grid_low[:2] -= self._cell * flat
        self._grid_high[:2] += self._cell * flat
        self._plan_floor(points, floor, camera)

    def _plan_floor(self, points: Array, floor: tuple[Array, Array] | None, camera: Camera) -> None:
        """Where the floor's plate lies: under all points, and under the grid; none where it is seen from below."""
        self._plate: tuple[Array, Array, Array] | None = None
        if floor is None or camera.axes[2] @ floor[1] > -0.03:
            return
        if self._has_grid:
            self._plate = (self._grid_low, self._grid_high, np.eye(3))
            return
        frame = rotation_to(floor[1])
        seen = (points - floor[0]) @ frame
        low, high = seen.min(axis=0), seen.max(axis=0)
        low[:2], high[:2], low[2], high[2] = low[:2] - self._cell, high[:2] + self._cell, 0.0, 0.0
        self._plate = (floor[0] + frame @ low, floor[0] + frame @ high, frame)

    def _grid_corners(self) -> Array:
        if self._has_grid:
            low, high, frame = self._grid_low, self._grid_high, np.eye(3)
        elif self._plate is not None:
            low, high, frame = self._plate
        else:
            return np.zeros((0, 3))
        across = (high - low) @ frame
        sides = [low + across[0] * frame[:, 0], low + across[1] * frame[:, 1]]
        return np.array([low, high, *sides])

    def _plan_ports(self, column: int, columns: int, top: int, height: int) -> list[_Port]:
        """Only as large a part of each column as can show something is drawn: the rest stays as it is."""
        height = max(height, 1)
        wide, tall = column, height
        if self.view.distance is None and not self._follow:
            spread = np.max(np.abs(self._camera.project(self._points)), axis=0)
            # In units of half the height, with room for the thickness of members.
            wide = min(column, math.ceil((1.08 * spread[0] + 0.06) * height))
            tall = min(height, math.ceil((1.08 * spread[1] + 0.06) * height))
        # Even numbers can be drawn 3/2 times as large.
        wide, tall = max(2, wide - wide % 2), max(2, tall - tall % 2)
        self._field_of_view = 2.0 * math.degrees(math.atan(HALF_VIEW * tall / height))
        left, down = (column - wide) // 2, (height - tall) // 2
        return [
            _Port(i * column + left, top + down, wide, tall, (i * column, (i + 1) * column)) for i in range(columns)
        ]

    # --------------------------------------------------------------------------------------------- preparing

    def _draw_surroundings(self) -> None:
        """Everything that no frame changes: title, names, legend."""
        picture = self._labels.blank()
        if self.view.text:
            first = self.motions[0]
            titles = list(dict.fromkeys(m.title for m in self.motions))
            moving = len(first.time) > 1
            self._labels.title(picture, " / ".join(titles), self._clock_text(self.end) if moving else "")
            self._labels.legend(picture, self._legend(), self._camera)
            names = [Name(m.label, palette.ROD, note=m.note) for m in self.motions]
            if self._ghost is not None:
                names[1] = Name(f"{self._ghost.label} (ghost)", palette.GHOST, True, self._ghost.note)
            if self._split:
                for name, port in zip(names, self._ports, strict=True):
                    self._labels.names(picture, [name], *port.columns, 0)
            else:
                self._labels.names(picture, names, 0, self.view.size[0], 0)
        self._frame: Image = np.array(picture)

    def _legend(self) -> Legend:
        held = [h for m in self.motions for _, h in supported_points(m.structure, m.nodes[0])]
        slack = any(np.any(m.rest_lengths > m.structure.string_lengths(m.nodes) * (1.0 + 1e-6)) for m in self.motions)
        return Legend(
            tension=self._scale if any(m.structure.strings for m in self.motions) else None,
            slack=slack,
            target=self.view.target and any(m.target is not None for m in self.motions),
            fixed=3 in held,
            guided=any(h < 3 for h in held),
            grid=self._cell if self._has_grid or self._surface is not None else None,
            water=self._surface is not None,
        )

    def _clock_text(self, time: float) -> str:
        # As many decimals as tell two frames of a film apart at 30 a second.
        span = self.end - self.start
        digits = 2 if span <= 0.0 else min(6, max(2, math.ceil(-math.log10(span / 30.0)) + 1))
        return f"t = {time:.{digits}f} s"

    def _drawn_size(self, port: _Port) -> tuple[int, int]:
        return round(self._factor * port.width), round(self._factor * port.height)

    def _open(self) -> None:
        """OpenGL, painters, and everything that stays from frame to frame."""
        pixel = 2.0 * self._camera.distance * HALF_VIEW / self.view.size[1]
        if self._surface is not None:
            self._surface = self._surface.lined(LINE * pixel, self._camera)
        model = make_model(self._surface)
        port = self._ports[0]
        canvas = Canvas(model, *self._drawn_size(port))
        self._canvas = self._stack.enter_context(canvas)
        needed = 2 * sum(geoms_needed(m.structure) for m in self.motions)
        capacity = needed + MAX_GRID_LINES + 2 * MAX_PIECES + 200
        self._painters, self._traces, self._drawn, self._colors = [], [], [], []
        for index in range(len(self._ports)):
            motion = self.motions[index]
            self._painters.append(Painter(model, capacity, self._factor * max(1.0, self.view.size[1] / 720.0)))
            rows = moving_rows(motion, 2.0 * pixel) if self.view.traces and len(motion.time) > 1 else np.zeros(0, int)
            self._traces.append(Traces.of(motion, rows, TRACE_TOLERANCE * pixel))
            self._drawn.append(-1)
            self._colors.append(_trace_colors(motion))

    # ----------------------------------------------------------------------------------------------- drawing

    def _compose(self, index: int, time: float) -> object:
        """The MjvScene of one port at a time [s]."""
        painter, motion, traces = self._painters[index], self.motions[index], self._traces[index]
        pose = motion.pose(time)
        camera = self._camera
        if self._follow:
            camera = camera.moved(self._middle(pose.nodes[None])[0])
        painter.look_from(camera, self._reach, self._field_of_view)
        done = int(np.searchsorted(traces.times, time, side="right"))
        if self._drawn[index] < 0 or self._follow or done < self._drawn[index]:
            painter.reset()
            self._draw_fixed(painter, motion, camera)
            painter.keep()
            self._drawn[index] = 0
        painter.traces(traces, self._drawn[index], done, self._colors[index])
        self._drawn[index] = done
        for row, (times, points) in traces.corners.items():
            last = points[max(0, int(np.searchsorted(times, time, side="right")) - 1)]
            painter.line(last, pose.nodes[row], self._colors[index][row])
        self._draw_moving(painter, index, pose, time)
        return painter.finish()

    def _draw_fixed(self, painter: Painter, motion: Motion, camera: Camera) -> None:
        painter.background(camera, self._reach)
        shift = np.zeros(3)
        if self._follow:
            moved = np.array(camera.look_at) - np.array(self._camera.look_at)
            # A grid goes with what is seen, a floor stays at its height.
            shift[:] = *self._whole_cells(moved), moved[2] if self._plate is None else 0.0
        if self._plate is not None:
            low, high, frame = self._plate
            shift = shift - (shift @ frame[:, 2]) * frame[:, 2]
            painter.plate(low + shift, high + shift, frame)
        if self._has_grid:
            painter.grid(self._grid_low + shift, self._grid_high + shift, self._cell)

    def _draw_moving(self, painter: Painter, index: int, pose: Pose, time: float) -> None:
        motion, sizes = self.motions[index], self._sizes[index]
        painter.supports(motion.structure, pose.nodes, sizes)
        sea = self._seas[index]
        if self._surface is not None and sea is not None:
            painter.water(self._surface, self._surface.points(sea, time, self._cells_moved(pose)))
        painter.structure(motion, pose, sizes, self._scale)
        if self._ghost is not None:
            painter.structure(self._ghost, self._ghost.pose(time), self._sizes[1], self._scale, Look.GHOST)
        if self.view.target:
            targets = motion.target_positions(np.array([time]))
            if targets is not None:
                aim = replace(pose, nodes=targets[0])
                painter.structure(motion, aim, sizes, self._scale, Look.TARGET)

    def _cells_moved(self, pose: Pose) -> Array:
        """How far (2,) [m] the water goes with a structure that the camera follows."""
        return self._whole_cells(self._middle(pose.nodes[None])[0]) if self._follow else np.zeros(2)

    def _whole_cells(self, shift: Array) -> Array:
        return np.asarray(np.round(shift[:2] / self._cell) * self._cell)

    @staticmethod
    def _middle(nodes: Array) -> Array:
        """What the camera follows: the mean (T, 3) of points (T, P, 3)."""
        return nodes.mean(axis=1)


def _trace_colors(motion: Motion) -> NDArray[np.float32]:
    """A colour (N, 4) a node: its rod's in the thesis' order, lightened."""
    structure = motion.structure
    colors = np.ones((len(structure.nodes), 4), np.float32)
    colors[:, :3] = palette.mixed(palette.POINT_MASS, palette.BACKGROUND, 0.2)
    for number, pair in enumerate(structure.rod_nodes):
        colors[pair, :3] = palette.mixed(palette.CYCLE[number % len(palette.CYCLE)], palette.BACKGROUND, 0.25)
    return colors
