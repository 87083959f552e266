"""Framing of a film's motions: the camera that sees all of them, and the extents of water, grid and floor."""

from __future__ import annotations

import numpy as np

from tensegrity_mj.basics.arrays import Array, rotation_to
from tensegrity_mj.model.elements.waves import Sea
from tensegrity_mj.pictures import painter, palette, surface
from tensegrity_mj.pictures.camera import Camera, CameraPath, clearest, fit
from tensegrity_mj.pictures.motion import Motion
from tensegrity_mj.pictures.view import View

SAMPLES = 200  # instants of a run that the camera is fitted to
SHADOW = 0.25  # cells of a floor around what stands on it
KEYS = 101  # instants at which a camera that moves is fitted
LEVEL = 0.9999  # cosine of the angle within which a floor is horizontal
FAR = 4.0  # times a structure's own extent: a run that travels farther is followed by the camera
BLOWN_UP = 2.5  # times its extent at the start: what a diverging structure grows to beyond that is not framed
DEEP = 1.0  # times the extent: water is framed as far above and below the structure
SUNK = 4.0  # times the extent: as far it is drawn at all


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
        self.sizes = [painter.Sizes.of(m.structure, extent) for m in self.motions]
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
        self.surface: surface.Surface | None = None
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
        self.surface = surface.Surface.enclosing(nodes, world, self.cell, seas)
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
            curves = np.stack([painter.slack_curves(motion, pose, ever).reshape(-1, 3) for pose in poses])
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
