"""The shape that a slack string is drawn in: an arc between its ends that is as long as the string.

A massless slack string has no shape of its own. A parabola in the plane of the chord and "down" is close to the
catenary that a reader expects, hangs without gravity too, and becomes the straight string without a jump as the slack
vanishes.
"""

from __future__ import annotations

import numpy as np

from tensegrity_mj.basics.arrays import Array, rotations_to

MAX_RATIO = 1e3  # of string to chord; beyond, the chord makes no difference


def parabola_slope(ratio: Array) -> Array:
    """Slope w >= 0 at the ends of the parabola whose arc is `ratio` >= 1 times its chord, elementwise.

    Arc length over chord of y = w x (1 - x), x in [0, 1]:  S(w) = √(1 + w²)/2 + asinh(w)/(2 w). S is increasing and
    convex, so Newton's method from above converges without overshoot; w = 2 ratio lies above, because S(w) > w/2.
    """
    target = np.clip(np.asarray(ratio, float), 1.0, MAX_RATIO)
    w = 2.0 * target
    for _ in range(60):
        root = np.sqrt(1.0 + w**2)
        # Near w = 0 both expressions are of the form 0/0: S = 1 + w²/6 - ..., dS/dw = w/3 - ...
        small = w < 1e-4
        safe = np.where(small, 1.0, w)
        value = np.where(small, 1.0 + w**2 / 6.0, 0.5 * root + np.arcsinh(safe) / (2.0 * safe))
        slope = np.where(small, w / 3.0, 0.5 * root / safe - np.arcsinh(safe) / (2.0 * safe**2))
        change = np.where(slope > 0.0, (value - target) / np.where(slope > 0.0, slope, 1.0), w)
        w = np.maximum(0.0, w - change)
        if np.all(np.abs(change) <= 1e-12 * (1.0 + w)):
            break
    return np.where(target > 1.0, w, 0.0)


def slack_arcs(start: Array, end: Array, rest_lengths: Array, down: Array, outward: Array, segments: int) -> Array:
    """Points (M, segments + 1, 3) [m] along slack strings, ends included.

    Args:
        start, end: (M, 3) the strings' ends.
        rest_lengths: (M,) their lengths; a string that is not longer than its chord is drawn straight.
        down: (3,) unit vector that they hang along.
        outward: (M, 3) where a string hangs whose chord runs along `down`: away from the structure's middle.
        segments: number of straight pieces.
    """
    chord = end - start
    lengths = np.linalg.norm(chord, axis=1)
    # Ends that (almost) meet: a loop of the right length.
    safe = np.maximum(lengths, np.maximum(rest_lengths / MAX_RATIO, 1e-300))
    along = chord / safe[:, None]
    # A little of `outward` at all times keeps the direction continuous as a chord turns through the vertical.
    wish = down + 0.05 * outward / np.maximum(np.linalg.norm(outward, axis=1), 1e-300)[:, None]
    across = wish - np.sum(wish * along, axis=1)[:, None] * along
    norms = np.linalg.norm(across, axis=1)
    across = np.where(norms[:, None] > 1e-9, across, rotations_to(along)[:, :, 0])
    across /= np.maximum(np.linalg.norm(across, axis=1), 1e-300)[:, None]
    w = parabola_slope(rest_lengths / safe)
    # Equal steps of the slope's angle put more points where the curve bends.
    angle = np.linspace(-1.0, 1.0, segments + 1) * np.arctan(w)[:, None]
    x = 0.5 * (1.0 + np.where(w[:, None] > 1e-6, np.tan(angle) / np.maximum(w[:, None], 1e-300), 0.0))
    x = np.where(w[:, None] > 1e-6, x, np.linspace(0.0, 1.0, segments + 1))
    depth = safe[:, None] * w[:, None] * x * (1.0 - x)
    return start[:, None] + chord[:, None] * x[..., None] + across[:, None] * depth[..., None]
