"""A camera that moves and zooms smoothly with what it shows, and never loses it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.pictures.camera import Camera, fit

WINDOW = 0.12  # of the film: how long before and after something the camera makes room for it
# Parts of the distance of a still camera: a motion that comes no nearer is not worth it, and none comes nearer still,
# as a picture that is full to its edges takes long to draw.
NEAREST = 0.75


@dataclass(frozen=True, eq=False)
class CameraPath:
    """Cameras of one direction at times (K,) [s]: what they look at (K, 3) [m], from how far (K,) [m]."""

    direction: Camera
    times: Array
    look_at: Array
    distance: Array

    @classmethod
    def of(cls, still: Camera, times: Array, points: Array, margin: float, aspect: float) -> CameraPath | None:
        """The path for what is at points (K, P, 3) [m] at equally spaced times (K,) [s]; None where it gains little.

        At each time a camera is fitted to all that is there within the window around it; the path is the mean of
        these cameras over that window. Where a point shows is bounded by inequalities that are linear in the camera's
        place (`fit`), so that a mean of cameras which all see a point sees it too.
        """
        reach = max(1, round(WINDOW * (len(times) - 1)))
        last = len(times) - 1
        cameras = [
            fit(still, points[max(0, k - reach) : k + reach + 1].reshape(-1, 3), margin, aspect)
            for k in range(len(times))
        ]
        look_at, distance = np.array([c.look_at for c in cameras]), np.array([c.distance for c in cameras])
        if distance.min() > NEAREST * still.distance:
            return None
        distance = np.maximum(distance, NEAREST * still.distance)
        # Twice over half the window: a triangle of weights, whose path has no corners.
        near = np.clip(np.arange(last + 1)[:, None] + np.arange(-(reach // 2), reach // 2 + 1), 0, last)
        for _ in range(2):
            look_at, distance = look_at[near].mean(axis=1), distance[near].mean(axis=1)
        return cls(still, times, look_at, distance)

    def at(self, time: float) -> Camera:
        """The camera at a time [s]."""
        x, y, z, distance = (float(np.interp(time, self.times, values)) for values in (*self.look_at.T, self.distance))
        return replace(self.direction, look_at=(x, y, z), distance=distance)
