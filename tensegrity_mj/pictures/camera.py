"""A camera that frames what is to be seen by itself, exactly, in closed form; and one that moves and never loses it."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.model.elements.waves import Sea

FIELD_OF_VIEW = 30.0  # degrees, vertical; narrow, so that parallel members look parallel
AZIMUTH, ELEVATION = 125.0, -18.0  # degrees, in MuJoCo's sense; the azimuth is only the first that is considered
TURN = 15.0  # degrees between azimuths that are considered
AFLOAT = -10.0  # degrees: the elevation over water, low enough to see how high waves are
BROADSIDE_TURN = 5.0  # degrees between azimuths over water
SLENDER = 2.0  # length over width from which a structure in water is seen from the side
FLAT = 1e-3  # thickness over extent below which a motion counts as planar


@dataclass(frozen=True)
class Camera:
    """A view in MuJoCo's terms: it looks from `distance` [m] at `look_at` [m]; angles in degrees.

    The view's direction is (cos a cos e, sin a cos e, sin e) for azimuth a and elevation e; z points up in the picture.
    """

    azimuth: float
    elevation: float
    look_at: tuple[float, float, float] = (0.0, 0.0, 0.0)
    distance: float = 1.0

    @property
    def axes(self) -> Array:
        """Rows (3, 3): unit vectors to the right, up and forward."""
        a, e = math.radians(self.azimuth), math.radians(self.elevation)
        forward = np.array([math.cos(a) * math.cos(e), math.sin(a) * math.cos(e), math.sin(e)])
        right = np.array([math.sin(a), -math.cos(a), 0.0])
        return np.array([right, np.cross(right, forward), forward])

    @property
    def position(self) -> Array:
        """Place of the camera (3,) [m]."""
        return np.array(self.look_at) - self.distance * self.axes[2]

    def project(self, points: Array) -> Array:
        """(..., 2): right and up, as a fraction of half the picture's height, of points (..., 3)."""
        relative = (np.asarray(points, float) - self.position) @ self.axes.T
        tangent = math.tan(math.radians(FIELD_OF_VIEW) / 2.0)
        return relative[..., :2] / (tangent * np.maximum(relative[..., 2:], 1e-12))

    def moved(self, shift: Array) -> Camera:
        """Return the camera with the same view of something that is `shift` (3,) [m] away."""
        x, y, z = (float(a + b) for a, b in zip(self.look_at, shift, strict=True))
        return replace(self, look_at=(x, y, z))


def fit(camera: Camera, points: Array, margin: Array | float, aspect: float, *, keep_distance: bool = False) -> Camera:
    """The camera with the same direction that just sees balls of radius `margin` [m] about points (P, 3), centred.

    With half-angle tangents (t_h, t_v), the camera at c sees p when |right·(p - c)| <= t_h forward·(p - c), and
    likewise upwards. Each bound is linear in c, so the nearest admissible forward·c is a minimum over points, and
    the other two coordinates follow by centring between the bounds.
    """
    right, up, forward = camera.axes @ np.asarray(points, float).T
    radius = np.broadcast_to(np.asarray(margin, float), right.shape)
    vertical = math.tan(math.radians(FIELD_OF_VIEW) / 2.0)
    bounds = []
    for across, tangent in ((right, vertical * aspect), (up, vertical)):
        # A ball's silhouette stands out by radius / cos(half angle) across the view.
        swell = radius * math.hypot(1.0, tangent)
        high = float(np.max(across + swell - tangent * forward))
        low = float(np.max(-across + swell - tangent * forward))
        bounds.append((high, low, tangent))
    depth = min(-(high + low) / (2.0 * tangent) for high, low, tangent in bounds)
    middle = float(np.mean([np.max(forward), np.min(forward)]))
    distance = camera.distance if keep_distance else max(middle - depth, 1e-9)
    coordinates = np.array([(bounds[0][0] - bounds[0][1]) / 2.0, (bounds[1][0] - bounds[1][1]) / 2.0, middle])
    x, y, z = (float(v) for v in coordinates @ camera.axes)
    return replace(camera, look_at=(x, y, z), distance=distance)


def broadside(points: Array, waves: tuple[float, ...]) -> float | None:
    """The azimuth [degrees] from which what floats is seen from the side, with waves that pass from left to right.

    Across its long axis, where it is at least twice as long as wide, seen from above; else across the highest wave.

    Args:
        points: (P, 3) everywhere that it is [m].
        waves: directions that waves travel in, the highest first [rad].

    Returns:
        None where it is not long, and there are no waves.
    """
    centred = points[:, :2] - points[:, :2].mean(axis=0)
    size, axes = np.linalg.eigh(centred.T @ centred)
    travel = np.array([math.cos(waves[0]), math.sin(waves[0])]) if waves else np.zeros(2)
    right: Array = axes[:, 1] if size[1] >= SLENDER**2 * size[0] and size[1] > 0.0 else travel
    if not right.any():
        return None
    # Where a wave comes from abeam, or there is none: +x to the right, or +y.
    sign = next((float(v) for v in (right @ travel, *right) if abs(v) > 1e-6), 1.0)
    right = right * math.copysign(1.0, sign)
    azimuth = math.degrees(math.atan2(right[0], -right[1]))
    # Round angles: what lies all but along an axis is seen square on its water, too.
    return BROADSIDE_TURN * round(azimuth / BROADSIDE_TURN) % 360.0


def clearest(
    points: Array, corners: Array, sea: Sea | None, azimuth: float | None = None, elevation: float | None = None
) -> Camera:
    """The direction to look in: as given; else over water low from the side, waves passing from left to right.

    Where there is neither, square on planar motion, and on all other obliquely from above.

    Args:
        points: (P, 3) everything that will be seen [m].
        corners: (T, C, 2, 3) vectors [m] along two members that meet, at some instants, as `corners_of` gives them.
        sea: whose waves there are, or None.
        azimuth, elevation: [degrees], or None to have them chosen.
    """
    if sea is not None:
        highest = sea.direction[np.argsort(-sea.amplitude, kind="stable")]
        azimuth = broadside(points, tuple(highest.tolist())) if azimuth is None else azimuth
        elevation = AFLOAT if elevation is None else elevation
    flat = _square_on(points)
    tilt = elevation if elevation is not None else flat[1] if flat else ELEVATION
    if azimuth is not None:
        return Camera(azimuth, tilt)
    return Camera(flat[0] if flat else _clearest_azimuth(corners, tilt), tilt)


def corners_of(pairs: NDArray[np.int64], nodes: Array) -> Array:
    """Vectors (T, C, 2, 3) along every two members (M, 2) that share a node, away from it, for nodes (T, N, 3)."""
    meeting = [
        (node, sum(a) - node, sum(b) - node)
        for a, b in itertools.combinations(pairs.tolist(), 2)
        for node in set(a) & set(b)
    ]
    rows = np.array(meeting, np.int64).reshape(-1, 3)
    return np.stack([nodes[:, rows[:, k]] - nodes[:, rows[:, 0]] for k in (1, 2)], axis=2)


def _clearest_azimuth(corners: Array, elevation: float) -> float:
    """The azimuth from which members that meet are seen well apart and not end-on.

    Judged by the triangles between them: their area in the picture, relative to that of a right angle seen square on;
    the value that 5 % stay below, on the average over time. Of nearly equal azimuths, the nearest to `AZIMUTH`.
    """
    if corners.size == 0:
        return AZIMUTH
    steps = np.arange(round(360.0 / TURN))
    candidates = (AZIMUTH + TURN * np.where(steps % 2, (steps + 1) // 2, -(steps // 2))) % 360.0
    area = np.maximum(np.prod(np.linalg.norm(corners, axis=-1), axis=-1), 1e-300)
    scores = []
    for azimuth in candidates:
        seen = corners @ Camera(azimuth, elevation).axes[:2].T
        first, second = seen[:, :, 0], seen[:, :, 1]
        cross = first[..., 0] * second[..., 1] - first[..., 1] * second[..., 0]
        scores.append(float(np.mean(np.quantile(np.abs(cross) / area, 0.05, axis=1))))
    return float(candidates[int(np.argmax(np.array(scores) >= 0.9 * max(scores)))])


def _square_on(points: Array) -> tuple[float, float] | None:
    """Azimuth and elevation of the view square on a plane that holds all points; None where there is no one plane."""
    centred = points - points.mean(axis=0)
    _, singular, vectors = np.linalg.svd(centred, full_matrices=False) if len(points) > 2 else (None, np.zeros(3), None)
    if vectors is None or singular[2] > FLAT * singular[0] or singular[1] <= FLAT * singular[0]:
        return None
    normal = vectors[2]
    if abs(normal[2]) > 0.999:
        return 90.0, -90.0  # a horizontal plane from above: x to the right, y up
    # Choose the plane's upper side, or where it stands upright, the one that shows +x (else +y) to the right.
    right = np.array([normal[1], -normal[0]])
    if abs(normal[2]) > 1e-3:
        forward = normal if normal[2] < 0.0 else -normal
    else:
        forward = normal if (right[0] if abs(right[0]) > 1e-6 else right[1]) > 0.0 else -normal
    azimuth = math.degrees(math.atan2(forward[1], forward[0])) % 360.0
    return azimuth, math.degrees(math.asin(max(-1.0, min(1.0, float(forward[2])))))


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
