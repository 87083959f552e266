"""One film's worth of picture: the camera that sees all its motions, painters, text; frames of it at any time."""

from __future__ import annotations

import contextlib
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tensegrity_mj.basics.arrays import Array, rotation_to
from tensegrity_mj.basics.units import quantity
from tensegrity_mj.errors import OptionError
from tensegrity_mj.model.elements.waves import Sea
from tensegrity_mj.pictures import labels, opengl, palette
from tensegrity_mj.pictures.camera import FIELD_OF_VIEW, Camera, CameraPath, clearest, fit
from tensegrity_mj.pictures.motion import MAX_PIECES, Motion, Pose, Traces, moving_rows, supported_points
from tensegrity_mj.pictures.painter import (
    TRANSLUCENT,
    Look,
    Painter,
    Sizes,
    geoms_needed,
    make_model,
    plate_thickness,
    slack_curves,
)
from tensegrity_mj.pictures.shade import patches
from tensegrity_mj.pictures.surface import Surface
from tensegrity_mj.pictures.view import Layout, Quality, View

Image = NDArray[np.uint8]

TRACE_TOLERANCE = 0.6  # px
LINE = 1.5  # px; of lines on water
MAX_GRID_LINES = 40  # a cell is at least 1/15 of the extent
HALF_VIEW = math.tan(math.radians(FIELD_OF_VIEW) / 2.0)  # of the distance: what half a picture's height spans

SAMPLES = 200  # instants of a run that the camera is fitted to
SHADOW = 0.25  # cells of a floor around what stands on it
KEYS = 101  # instants at which a camera that moves is fitted
LEVEL = 0.9999  # cosine of the angle within which a floor is horizontal
FAR = 4.0  # times a structure's own extent: a run that travels farther is followed by the camera
BLOWN_UP = 2.5  # times its extent at the start: what a diverging structure grows to beyond that is not framed
DEEP = 1.0  # times the extent: water is framed as far above and below the structure
SUNK = 4.0  # times the extent: as far it is drawn at all


@dataclass(frozen=True)
class _Port:
    """A rectangle of the frame [px] that is drawn by OpenGL, and the columns that belong to it."""

    left: int
    top: int
    width: int
    height: int
    columns: tuple[int, int]


class Stage(contextlib.ExitStack):
    """Draws frames of one motion, or of two in one of the layouts; a context manager.

    Raises:
        OptionError: for options that cannot be drawn.
        MissingLibraryError: without OpenGL.
    """

    def __init__(self, motion: Motion, other: Motion | None, layout: Layout, view: View) -> None:
        if not isinstance(layout, Layout):
            raise OptionError(f"layout={layout!r}: it must be Layout.OVERLAY or Layout.SIDE_BY_SIDE")
        super().__init__()
        opengl.choose_backend()  # before any work, and before MuJoCo is imported
        self.motions = [motion] if other is None else [motion, other]
        self.view = view
        self._backdrop: palette.Color = palette.BACKGROUND
        self._split = other is not None and layout is Layout.SIDE_BY_SIDE
        seas = [m.sea for m in self.motions]  # a ghost over a run is in the run's own sea, or brings its
        self._seas = seas if self._split else [next((sea for sea in seas if sea is not None), None)]
        self._ghost = other if not self._split else None
        self.start = min(m.start for m in self.motions)
        self.end = max(m.end for m in self.motions)

        width, height = view.size
        columns = 2 if self._split else 1
        lines = 1 if self._split or other is None else 2
        if not any(m.label or m.note for m in self.motions):
            lines = 0
        self._labels = labels.Labels(width, height, columns, lines)
        self._text = view.text and self._labels.readable
        header, footer = (self._labels.header, self._labels.footer) if self._text else (0, 0)
        wish = {Quality.FAST: 1.0, Quality.FINE: 1.5 if columns == 2 else 2.0, Quality.BEST: 3.0}[view.quality]
        most = min(wish, opengl.MAX_BUFFER / max(width, height))
        self._factor = max(f for f in (1.0, 1.5, 2.0, 3.0) if f == 1.0 or f <= most)

        self.framing = Framing(self.motions, self._seas, view, (width // columns) / (height - header - footer))
        self._surface = self.framing.surface
        self._ports = self._plan_ports(width // columns, columns, header, height - header - footer)
        self._scale = palette.TensionScale.of(np.concatenate([m.tensions.ravel() for m in self.motions]))
        self._draw_surroundings()
        try:
            self._open()
        except BaseException:
            self.close()
            raise

    def moment(self, time: float | None) -> float:
        """A time [s] of the film, its end for None; raise OptionError outside the film."""
        moment = self.end if time is None else float(time)
        slack = 1e-9 * max(1.0, abs(self.start), abs(self.end))
        if not self.start - slack <= moment <= self.end + slack:
            raise OptionError(f"time={moment} s: the run lasts from {self.start:g} to {self.end:g} s")
        return moment

    def frame(self, time: float) -> Image:
        """The picture (H, W, 3) at `time` [s], which is clipped to the run; it is overwritten by the next call."""
        from tensegrity_mj.pictures.shrink import behind, shrink

        # Water has opacities of its own, and so a plate behind everything.
        background = behind(palette.to_bytes(self._backdrop), TRANSLUCENT if self._surface is None else 0.0)
        moment = min(max(time, self.start), self.end)
        for index, port in enumerate(self._ports):
            scene = self._compose(index, moment)
            pixels = self._canvas.draw(scene, *self._drawn_size(port))
            part = self._frame[port.top : port.top + port.height, port.left : port.left + port.width]
            shrink(pixels, self._factor, part, background)
        if self._text and len(self.motions[0].time) > 1:
            self._labels.clock(self._frame, self._clock_text(moment))
        return self._frame

    def cut_out(self, time: float) -> Image:
        """The picture (H, W, 4) at `time` [s] without text and background, as far as it is transparent.

        Drawn on white and on black, a pixel is w = c + (1 - a) and b = c, with c its colour times its opacity a.
        """
        on = []
        for self._backdrop in ((1.0, 1.0, 1.0), (0.0, 0.0, 0.0)):
            self._frame[:] = palette.to_bytes(self._backdrop)
            on.append(self.frame(time).astype(np.float64))
        self._backdrop = palette.BACKGROUND
        white, black = on
        opacity = np.clip(255.0 - (white - black).mean(axis=2, keepdims=True), 0.0, 255.0)
        color = np.clip(255.0 * black / np.maximum(opacity, 1.0), 0.0, 255.0)
        return np.round(np.concatenate([color, opacity], axis=2)).astype(np.uint8)

    def _plan_ports(self, column: int, columns: int, top: int, height: int) -> list[_Port]:
        """Plan the part of each column that can show something: only this is drawn, the rest stays as it is."""
        height = max(height, 1)
        wide, tall = column, height
        if self.view.distance is None and not self.framing.follow and self.framing.terrain is None:
            spread = self.framing.spread()
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
        """Draw what no frame changes: title, names, legend."""
        picture = self._labels.blank()
        if self._text:
            first = self.motions[0]
            titles = list(dict.fromkeys(m.title for m in self.motions))
            moving = len(first.time) > 1
            self._labels.title(picture, " / ".join(titles), self._clock_text(self.end) if moving else "")
            scale = self._scale if any(m.structure.strings for m in self.motions) else None
            self._labels.legend(picture, scale, self._legend(), self.framing.camera)
            names = [(m.label, palette.ROD, m.note) for m in self.motions]
            if self._ghost is not None:
                pale = palette.mixed(palette.GHOST, palette.BACKGROUND, 0.5)
                names[1] = (f"{self._ghost.label} (ghost)", pale, self._ghost.note)
            if self._split:
                for name, port in zip(names, self._ports, strict=True):
                    self._labels.names(picture, [name], *port.columns)
            else:
                self._labels.names(picture, names, 0, self.view.size[0])
        self._frame: Image = np.array(picture)

    def _legend(self) -> list[str]:
        """Return the words that the footer explains."""
        held = [h for m in self.motions for _, h in supported_points(m.structure, m.nodes[0])]
        slack = any(np.any(m.rest_lengths > m.structure.string_lengths(m.nodes) * (1.0 + 1e-6)) for m in self.motions)
        there = {
            "slack string": slack,
            "target": self.view.target and any(m.target is not None for m in self.motions),
            "fixed": 3 in held,
            "guided": any(h < 3 for h in held),
            "water": self._surface is not None,
            f"grid {quantity(self.framing.cell, 'm')}": self.framing.has_grid
            or self._surface is not None
            or self.framing.terrain is not None,
        }
        return [words for words, drawn in there.items() if drawn]

    def _clock_text(self, time: float) -> str:
        # Show enough decimals to distinguish two frames of a film at 30 a second.
        span = self.end - self.start
        digits = 2 if span <= 0.0 else min(6, max(2, math.ceil(-math.log10(span / 30.0)) + 1))
        return f"t = {time:.{digits}f} s"

    def _drawn_size(self, port: _Port) -> tuple[int, int]:
        return round(self._factor * port.width), round(self._factor * port.height)

    def _open(self) -> None:
        """OpenGL, painters, and everything that stays from frame to frame."""
        path = self.framing.path
        nearest = self.framing.camera.distance if path is None else float(path.distance.min())
        pixel = 2.0 * nearest * HALF_VIEW / self.view.size[1]
        if self._surface is not None:
            self._surface = self._surface.lined(LINE * pixel, self.framing.camera)
        model = make_model(self._surface, self.framing.terrain, self.framing.cell)
        port = self._ports[0]
        canvas = opengl.Canvas(model, *self._drawn_size(port))
        self._canvas = self.enter_context(canvas)
        needed = 2 * sum(geoms_needed(m.structure) for m in self.motions)
        capacity = needed + MAX_GRID_LINES + 2 * MAX_PIECES + 200
        self._painters, self._traces, self._drawn, self._colors = [], [], [], []
        for index in range(len(self._ports)):
            motion = self.motions[index]
            self._painters.append(Painter(model, capacity, self._factor * max(1.0, self.view.size[1] / 720.0)))
            rows = moving_rows(motion, 2.0 * pixel) if self.view.traces and len(motion.time) > 1 else np.zeros(0, int)
            self._traces.append(Traces.of(motion, rows, TRACE_TOLERANCE * pixel))
            self._drawn.append(-1)
            structure, colors = motion.structure, np.ones((len(motion.structure.nodes), 4), np.float32)
            colors[:, :3] = palette.mixed(palette.POINT_MASS, palette.BACKGROUND, 0.2)
            for number, pair in enumerate(structure.rod_nodes):  # in the thesis' order, lightened
                colors[pair, :3] = palette.mixed(palette.color_of(number), palette.BACKGROUND, 0.25)
            self._colors.append(colors)

    # ----------------------------------------------------------------------------------------------- drawing

    def _compose(self, index: int, time: float) -> object:
        """The MjvScene of one port at a time [s]."""
        painter, motion, traces = self._painters[index], self.motions[index], self._traces[index]
        pose = motion.pose(time)
        camera = self.framing.camera
        if self.framing.follow:
            camera = camera.moved(pose.nodes.mean(axis=0))
        elif self.framing.path is not None:
            camera = self.framing.path.at(time)
        painter.look_from(camera, self.framing.reach, self._field_of_view)
        done = int(np.searchsorted(traces.times, time, side="right"))
        if self._drawn[index] < 0 or self.framing.follow or done < self._drawn[index]:
            painter.reset()
            self._draw_fixed(painter, motion, camera)
            painter.keep()
            self._drawn[index] = 0
        if self._surface is not None:
            painter.background(camera, self.framing.reach, self._backdrop)
        painter.traces(traces, self._drawn[index], done, self._colors[index])
        self._drawn[index] = done
        for row, (times, points) in traces.corners.items():
            last = points[max(0, int(np.searchsorted(times, time, side="right")) - 1)]
            painter.line(last, pose.nodes[row], self._colors[index][row])
        self._draw_moving(painter, index, pose, time)
        return painter.finish()

    def _draw_fixed(self, painter: Painter, motion: Motion, camera: Camera) -> None:
        if self._surface is not None:
            painter.background(camera, self.framing.reach, self._backdrop)
        shift = np.zeros(3)
        if self.framing.follow:
            moved = np.array(camera.look_at) - np.array(self.framing.camera.look_at)
            # A grid goes with what is seen, a floor stays at its height.
            shift[:] = *self._whole_cells(moved), moved[2] if self.framing.plate is None else 0.0
        if self.framing.plate is not None:
            low, high, frame = self.framing.plate
            shift = shift - (shift @ frame[:, 2]) * frame[:, 2]
            painter.plate(low + shift, high + shift, frame)
        if self.framing.terrain is not None and motion.floor is not None:
            painter.terrain(motion.floor, self.framing.terrain)
        if self.framing.has_grid:
            shade = palette.GRID if self.framing.plate is None else palette.FLOOR_LINE
            painter.grid(self.framing.grid_low + shift, self.framing.grid_high + shift, self.framing.cell, shade)

    def _draw_moving(self, painter: Painter, index: int, pose: Pose, time: float) -> None:
        motion, sizes = self.motions[index], self.framing.sizes[index]
        painter.supports(motion.structure, pose.nodes, sizes)
        sea = self._seas[index]
        if self._surface is not None and sea is not None:
            # It goes with a structure that the camera follows.
            moved = self._whole_cells(pose.nodes.mean(axis=0)) if self.framing.follow else np.zeros(2)
            painter.water(self._surface, self._surface.points(sea, time, moved))
        if self.framing.plate is not None and motion.floor is not None:
            low, high, _ = self.framing.plate
            extent = float(np.linalg.norm(high - low))
            dark = patches(motion.floor, motion.structure, pose.nodes, sizes.rod, sizes.string, extent)
            painter.shadows(motion.floor, plate_thickness(low, high), dark)
        painter.structure(motion, pose, sizes, self._scale, thickness=self.view.thickness)
        if self._ghost is not None:
            painter.structure(self._ghost, self._ghost.pose(time), self.framing.sizes[1], self._scale, Look.GHOST)
        aim = motion.aim(pose, time) if self.view.target else None
        if aim is not None:
            painter.structure(motion, aim, sizes, self._scale, Look.TARGET)

    def _whole_cells(self, shift: Array) -> Array:
        return np.asarray(np.round(shift[:2] / self.framing.cell) * self.framing.cell)


class Framing:
    """The camera that sees every sample of every run, and what is planned with it.

    Attributes:
        camera: where it stands, or where it stands relative to what it follows.
        follow: whether it follows a structure that travels far.
        path: way of a camera that moves and zooms with a structure that travels less far, or None.
        points: (P, 3) [m] what it is to see.
        reach: [m] how far from its look-at point anything is.
        sizes: sizes of the members in the picture, one for each motion.
        cell: [m] of the grid.
        surface: the surface of the water, or None.
        has_grid: whether there is a horizontal grid, from `grid_low` to `grid_high`.
        plate: two corners and the axes of the floor's plate, or None.
        terrain: what is drawn in place of a plate and a grid, or None.

    Args:
        motions: one or two.
        seas: waves in each picture, or None.
        view: what the caller chose.
        aspect: width over height.
    """

    def __init__(self, motions: list[Motion], seas: list[Sea | None], view: View, aspect: float) -> None:
        self.motions, self.seas, self.view = motions, seas, view
        self.terrain = next((motion.terrain for motion in motions if motion.terrain is not None), None)
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
        self.follow = float(np.linalg.norm(np.ptp(nodes, axis=0))) > FAR * size
        if self.follow:
            nodes = np.concatenate([(paths - middle).reshape(-1, 3) for paths, middle in clouds])
            hanging = np.concatenate([(points - middle).reshape(-1, 3) for points, middle in arcs])
        else:
            nodes = np.concatenate([nodes, *self._target_clouds(size)])
            hanging = np.concatenate([points.reshape(-1, 3) for points, _ in arcs])
        extent = max(float(np.linalg.norm(np.ptp(nodes, axis=0))), 1e-9)
        self.sizes = [Sizes.of(m.structure, extent) for m in self.motions]
        margin = max(max(float(np.max(s.rod, initial=0.0)), 1.8 * s.support, s.point_mass) for s in self.sizes)
        sea = next((sea for sea in self.seas if sea is not None), None)
        camera = clearest(nodes, self.motions[0].corners(), sea, view.azimuth, view.elevation)
        if self.view.distance is not None:
            camera = Camera(camera.azimuth, camera.elevation, distance=self.view.distance)
        self.cell = palette.round_up(extent / 15.0, (1.0, 2.0, 5.0))
        wet, sunk = self._plan_water(nodes, clouds, extent)
        self._plan_grid(np.concatenate([nodes, wet]), extent, camera)
        self.points = np.concatenate([nodes, hanging, wet, self._grid_corners()])
        self.camera = fit(camera, self.points, 1.4 * margin, aspect, keep_distance=self.view.distance is not None)
        # Points that are too deep or too high to be framed are drawn as far as they show.
        self.points = np.concatenate([self.points, sunk])
        self.path = self._plan_path(1.4 * margin, aspect)
        middles = np.array([self.camera.look_at]) if self.path is None else self.path.look_at
        farthest = max(float(np.max(np.linalg.norm(self.points - middle, axis=1))) for middle in middles)
        self.reach = farthest + 4.0 * margin

    def spread(self) -> Array:
        """(2,): how far to the side and up anything comes in the picture, in halves of its height."""
        cameras = [self.camera] if self.path is None else [self.path.at(time) for time in self.path.times]
        return np.max([np.max(np.abs(camera.project(self.points)), axis=0) for camera in cameras], axis=0)

    def _plan_path(self, margin: float, aspect: float) -> CameraPath | None:
        """The way of a camera that goes with the structure and keeps its floor in view; None to stand still."""
        start, end = min(m.start for m in self.motions), max(m.end for m in self.motions)
        still = self.follow or self.surface is not None or self.view.distance is not None
        if still or end <= start or any(m.diverged for m in self.motions):
            return None
        times = np.linspace(start, end, KEYS)
        seen = []
        for motion in self.motions:
            nodes = motion.positions(times)
            targets = motion.target_positions(times)
            seen += [nodes, self._arcs(motion, times, nodes)]
            seen += [] if targets is None or not self.view.target else [targets]
        corners = self._grid_corners()
        seen.append(np.broadcast_to(corners, (KEYS, *corners.shape)))
        return CameraPath.of(self.camera, times, np.concatenate(seen, axis=1), margin, aspect)

    def _plan_water(self, nodes: Array, clouds: list[tuple[Array, Array]], extent: float) -> tuple[Array, Array]:
        """Place the water; return its corners (8, 3) [m], or none, as far as they are framed, and as far as drawn."""
        self.surface: Surface | None = None
        seas = [sea for sea in self.seas if sea is not None]
        if not seas:
            return np.zeros((0, 3)), np.zeros((0, 3))
        low, high = float(nodes[:, 2].min()), float(nodes[:, 2].max())
        # The camera that follows goes up and down with the structure, the water does not.
        middles = np.concatenate([middle[:, 0, 2] for _, middle in clouds]) if self.follow else np.zeros(1)
        world = low, high
        if self.follow:
            every = np.concatenate([paths[..., 2].ravel() for paths, _ in clouds])
            world = float(every.min()), float(every.max())
        self.surface = Surface.enclosing(nodes, world, self.cell, seas)
        lowest = self.surface.bottom - float(middles.max())
        highest = self.surface.crest - float(middles.min())
        framed, drawn = (
            self.surface.corners(max(lowest, low - far * extent), min(max(highest, low), high + far * extent))
            for far in (DEEP, SUNK)
        )
        return framed, drawn

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
        if floor is None and self.surface is not None and self.surface.shallow:
            floor = np.array([0.0, 0.0, self.surface.bottom]), np.array([0.0, 0.0, 1.0])
        level = floor is None or floor[1][2] > LEVEL
        # Deep water has its grid on the surface.
        self.has_grid = camera.elevation < -2.0 and level and (self.surface is None or floor is not None)
        self.has_grid &= self.terrain is None
        low, high = points.min(axis=0), points.max(axis=0)
        low[2] = low[2] - 1.05 * max(s.support for s in self.sizes) if floor is None else floor[0][2]
        # Whole cells that hold everything; a line a cell is drawn, so that their number is bounded by the extent.
        room = 1e-6 if floor is None or self.surface is not None else -SHADOW
        self.grid_low = np.array([*np.floor(low[:2] / self.cell + room) * self.cell, low[2]])
        self.grid_high = np.array([*np.ceil(high[:2] / self.cell - room) * self.cell, low[2]])
        flat = self.grid_low[:2] == self.grid_high[:2]
        self.grid_low[:2] -= self.cell * flat
        self.grid_high[:2] += self.cell * flat
        self._plan_floor(points, floor, camera)

    def _plan_floor(self, points: Array, floor: tuple[Array, Array] | None, camera: Camera) -> None:
        """Place the floor's plate under all points, and under the grid; none where it is seen from below."""
        self.plate: tuple[Array, Array, Array] | None = None
        if floor is None or self.terrain is not None or camera.axes[2] @ floor[1] > -0.03:
            return
        if self.has_grid:
            self.plate = (self.grid_low, self.grid_high, np.eye(3))
            return
        frame = rotation_to(floor[1])
        seen = (points - floor[0]) @ frame
        low, high = seen.min(axis=0), seen.max(axis=0)
        low[:2], high[:2], low[2], high[2] = low[:2] - self.cell, high[:2] + self.cell, 0.0, 0.0
        self.plate = (floor[0] + frame @ low, floor[0] + frame @ high, frame)

    def _grid_corners(self) -> Array:
        if self.has_grid:
            low, high, frame = self.grid_low, self.grid_high, np.eye(3)
        elif self.plate is not None:
            low, high, frame = self.plate
        else:
            return np.zeros((0, 3))
        across = (high - low) @ frame
        sides = [low + across[0] * frame[:, 0], low + across[1] * frame[:, 1]]
        return np.array([low, high, *sides])
