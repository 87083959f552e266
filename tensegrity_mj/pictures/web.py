"""A run or a scene as one web page that shows it in 3-D: to turn, to play, to read names and tensions from.

The page (`web.html`) holds all that it needs, plotly's JavaScript among it, and loads nothing: its content policy
forbids it. It draws from one piece of JSON: who is tied to what, and where nodes are and how strings pull at evenly
spaced times, between which it interpolates linearly.
"""

from __future__ import annotations

import base64
import importlib.resources
import math
import os
from dataclasses import dataclass
from html import escape
from pathlib import Path
from string import Template
from typing import Any

import numpy as np

from tensegrity_mj.basics import dependencies, files, jsontext, units
from tensegrity_mj.basics.arrays import Array, rotation_to
from tensegrity_mj.errors import printable
from tensegrity_mj.model.rods import mass_places
from tensegrity_mj.model.scene import Scene
from tensegrity_mj.pictures import painter, palette, surface
from tensegrity_mj.pictures.camera import clearest
from tensegrity_mj.pictures.motion import Motion, support_places
from tensegrity_mj.pictures.stage import BLOWN_UP, DEEP, FAR
from tensegrity_mj.runs.trajectory import Trajectory

MOST_BYTES = 8_000_000  # of a page, of which plotly's JavaScript is 5 MB
RATE, LEAST, MOST = 60.0, 200, 2000  # frames a second of simulated time, and how few and how many they may be
NAME_LETTERS = 80
SQUARE = ((0, 1, 2), (0, 2, 3))  # triangles of its corners
MOST_ACROSS = 80  # points of uneven ground
MARGIN = 0.06  # of what is seen, around it
ASPECT = 1.5  # width over height that the first view is made for
HALF_VIEW = math.tan(math.radians(45.0) / 2.0)  # plotly's camera, vertically


@dataclass(frozen=True)
class WebPage:
    """A page in 3-D, which a notebook shows.

    Attributes:
        text: the HTML.
        frames: number of times at which positions are in it.
        interval: between them [s]; 0 where there is one.
    """

    text: str
    frames: int
    interval: float

    def save(self, path: str | os.PathLike[str]) -> Path:
        """Write the page, whole or not at all; returns its path, which ends in .html.

        Raises:
            OptionError: a path that cannot be written.
        """
        return files.write_text(files.checked(path, (".html", ".htm"), "page"), self.text)

    def describe(self) -> str:
        """Say how many frames were chosen, and how large the page is."""
        frames = f"{self.frames} frames, one each {self.interval:.3g} s" if self.frames > 1 else "1 frame"
        return f"{frames}, {len(self.text.encode()) / 1e6:.1f} MB"

    def framed(self, height: int = 560) -> str:
        """HTML that shows the page within another, `height` [px] tall and kept apart from it."""
        style = f"width:100%;height:{height}px;border:0"
        frame = f'<iframe sandbox="allow-scripts" title="3-D" style="{style}"'
        return f'{frame} srcdoc="{escape(self.text)}"></iframe>'

    def _repr_html_(self) -> str:
        return self.framed()


def make_web_page(source: Trajectory | Scene) -> WebPage:
    """The page of a run, or of a scene at its start.

    Rods are tubes; taut strings have the colour of their tension [N], slack ones hang as arcs of their own length; the
    pointer reads names and tensions. Target, supports, point masses, floor and the water's moving surface are there
    where the scene has them. Axes are equal. Of a run, the page has up to `RATE` frames a second, as many as fit into
    `MOST_BYTES`, and two at least.

    Raises:
        OptionError: a run without a sample that can be drawn.
        MissingPackageError: plotly is not installed.
    """
    plotly = plotly_script()
    motion = Motion.of(source)
    times = _times(motion, MOST_BYTES - len(plotly.encode()) - 2**18)
    frame = importlib.resources.files("tensegrity_mj.pictures").joinpath("web.html").read_text(encoding="utf-8")
    texts = {name: escape(printable(getattr(motion, name))) for name in ("title", "label", "note")}
    # No text of the JSON can end the element of HTML that it stands in.
    run = jsontext.to_json(_data(motion, times)).replace("<", "\\u003c")
    text = Template(frame).substitute(texts, plotly=plotly, run=run)
    return WebPage(text, len(times), float(times[-1] - times[0]) / max(len(times) - 1, 1))


def plotly_script() -> str:
    """plotly's JavaScript; raise MissingPackageError with the command that installs plotly."""
    wanted, what = dependencies.of_extra("web"), "the page in 3-D (pictures and videos do without)"
    dependencies.optional("plotly", what, wanted)  # the package first, by its name
    return str(dependencies.optional("plotly.offline", what, wanted).get_plotlyjs())


def _times(motion: Motion, room: int) -> Array:
    """Times [s] of the frames, as many as are wanted, or as `room` bytes hold."""
    count, structure = len(motion.time), motion.structure
    if count == 1:
        return motion.time
    numbers = 1 + 3 * len(structure.nodes) * (1 if motion.target is None else 2) + 2 * len(structure.strings)
    wanted = math.ceil(min(max(RATE * (motion.end - motion.start), LEAST), MOST, 4 * (count - 1))) + 1
    return np.linspace(motion.start, motion.end, max(2, min(wanted, 3 * room // (16 * numbers))))


def _data(motion: Motion, times: Array) -> dict[str, Any]:
    """Return the data that the page draws; rods, strings, supports and masses name nodes by their rows."""
    structure = motion.structure
    nodes, aims = motion.positions(times), motion.target_positions(times)
    among = [np.interp(times, motion.time, one) for one in np.hstack([motion.tensions, motion.rest_lengths]).T]
    tensions, rest = np.split(np.array(among).reshape(-1, len(times)).T, 2, axis=1)
    box = _Box.of(motion, nodes, aims)
    paths = structure.paths
    held = support_places(structure)
    edges = [body.name for body, frame in zip(structure.bodies, structure.frames, strict=True) for _ in frame.edges]
    sizes = painter.Sizes.of(structure, box.extent)
    scale = palette.TensionScale.of(motion.tensions)
    ticks, power = np.linspace(0.0, scale.end, 5), units.power_of(scale.end, "N")
    slack = np.any(motion.rest_lengths > structure.string_lengths(motion.nodes) * (1.0 + painter.SLACKNESS))
    masses = mass_places(structure)
    drawn = {
        "nodes": True,
        "rods": structure.rods or structure.bodies,
        "strings": structure.strings,
        "slack": slack,
        "masses": masses,
        "supports": held,
        "target": aims is not None and structure.rods,
        "floor": motion.floor is not None,
        "water": box.wet,
    }
    return {
        "drawn": [name for name, there in drawn.items() if there],
        "names": {
            "nodes": _names(structure.node_names),
            "rods": _names([*(rod.name for rod in structure.rods), *edges]),
            "strings": _names(string.name for string in structure.strings),
            "supports": _names(name for *_, name in held),
            "masses": _names(words for *_, words in masses),
        },
        "time": _packed(times),
        "digits": 2 if times[-1] - times[0] >= 2.0 else 4,
        "nodes": _packed(nodes),
        "tensions": _packed(tensions),
        "rest": _packed(rest),
        "target": None if aims is None else _packed(aims),
        "rods": [[*map(int, pair), radius] for pair, radius in zip(structure.rod_nodes, sizes.rod, strict=True)]
        + [[*map(int, pair), painter.EDGE * sizes.string] for pair in structure.body_edges],
        "strings": [[*map(int, pair), int(row)] for pair, row in zip(paths.nodes, paths.strings, strict=True)],
        "breaks": motion.break_times,  # infinite, that is never, becomes null
        "supports": [[i, j, sigma] for i, j, sigma, *_ in held],
        "masses": [place for *place, _ in masses],
        # (W, 5) [m], [rad/s], [1/m], [rad], [rad]
        "sea": np.stack([getattr(motion.sea, name) for name in OF_WAVES], axis=1) if box.wet else None,
        "floor": None if motion.floor is None else _floor(motion.floor, motion, box),
        "down": motion.down,
        "center": box.center,
        "half": box.half,
        "follow": box.follow,
        "eye": _eye(motion, box.half),
        "ticks": ticks,
        "tick_texts": [f"{tick / 10.0**power:.3g}" for tick in ticks],
        "unit": units.unit_with(power, "N"),
        "scale": [[n / 8, _css(palette.tension_colors(n / 8))] for n in range(9)],
        "colors": {name: _css(color) for name, color in _COLORS.items()},
    }


OF_WAVES = ("amplitude", "frequency", "number", "direction", "phase")
_COLORS = {
    "node": palette.FAINT_TEXT,
    "rod": palette.ROD,
    "slack": palette.SLACK,
    "mass": palette.POINT_MASS,
    "support": palette.SUPPORT,
    "target": palette.TARGET,
    "floor": palette.FLOOR,
    "water": palette.WATER,
    "grid": palette.mixed(palette.GRID, palette.GUIDE, 0.2),
    "text": palette.TEXT,
    "background": palette.BACKGROUND,
}


@dataclass(frozen=True)
class _Box:
    """Box of what the page shows.

    Attributes:
        center, half: its middle, and half its size along the axes, (3,) [m].
        follow: whether it goes with a structure that travels far.
        extent: extent of the structure [m].
        wet: whether the water's surface is near.
    """

    center: Array
    half: Array
    follow: bool
    extent: float
    wet: bool

    @classmethod
    def of(cls, motion: Motion, nodes: Array, aims: Array | None) -> _Box:
        """Make the box for nodes, and those of the target, (F, N, 3) [m]; as `framing` frames them."""
        extents = np.linalg.norm(np.ptp(nodes, axis=1), axis=1)
        seen = nodes[extents <= BLOWN_UP * max(extents[0], 1e-12)] if motion.diverged else nodes
        extent = max(float(np.linalg.norm(np.ptp(seen, axis=1), axis=1).max()), 1e-9)
        points, middles = seen.reshape(-1, 3), seen.mean(axis=1, keepdims=True)
        follow = float(np.linalg.norm(np.ptp(points, axis=0))) > FAR * extent
        lowest, highest = points[:, 2].min(), points[:, 2].max()
        wet = motion.sea is not None and -(DEEP + 1.0) * extent < lowest and highest > 0.0 - DEEP * extent
        if follow:
            points = (seen - middles).reshape(-1, 3)
        else:
            if aims is not None:
                near = np.linalg.norm(aims - middles[0], axis=-1) <= FAR * extent
                points = np.concatenate([points, aims[near]])
            if motion.floor is not None:
                points = np.concatenate([points, [_foot(points.mean(axis=0), motion.floor)]])
            if wet and motion.sea is not None:
                crest = float(np.sum(motion.sea.amplitude))
                points = np.concatenate([points, points[:1] * [1, 1, 0] + np.outer([-crest, crest], [0, 0, 1])])
        low, high = points.min(axis=0), points.max(axis=0)
        most = max(float(np.max(high - low)), 1e-9)
        half = np.maximum(0.5 * (high - low) + MARGIN * most, 0.08 * most)
        return cls(0.5 * (low + high), np.full(3, half.max()) if follow else half, follow, extent, wet)


def _foot(point: Array, floor: tuple[Array, Array]) -> Array:
    """The point of the floor below another one (3,) [m]."""
    return point - (point - floor[0]) @ floor[1] * floor[1]


def _floor(floor: tuple[Array, Array], motion: Motion, box: _Box) -> dict[str, Any]:
    """Points (P, 3) [m] of a square of the floor under all that the run passes through, and its triangles (F, 3)."""
    points = motion.nodes.reshape(-1, 3)
    reach = 1.5 * box.extent + (float(np.linalg.norm(np.ptp(points, axis=0))) if box.follow else 0.0)
    side, across, _ = reach * rotation_to(floor[1]).T
    middle = _foot(points.mean(axis=0) if box.follow else box.center, floor)
    if motion.terrain is None:
        return {
            "points": middle + np.array([-side - across, side - across, side + across, across - side]),
            "faces": SQUARE,
        }
    x, y, z = motion.terrain.points
    rows, columns = (
        np.flatnonzero(abs(marks - at) <= reach)[:: 1 + int(2 * reach / (marks[1] - marks[0])) // MOST_ACROSS]
        for marks, at in ((x, middle[0]), (y, middle[1]))
    )
    places = np.meshgrid(x[rows], y[columns], indexing="ij")
    points = np.stack([*places, z[np.ix_(rows, columns)] + floor[0][2]], axis=-1).reshape(-1, 3)
    return {"points": points, "faces": surface.quads(np.arange(len(points)).reshape(len(rows), len(columns)))}


def _eye(motion: Motion, half: Array) -> Array:
    """Return the place of plotly's camera (3,), from the box's middle and in twice its largest half: it sees all of it.

    It looks as in films: over water from the side, square on planar motion, else from where members cover each other
    least.
    """
    nodes = motion.nodes[:: max(1, len(motion.nodes) // 50)]
    camera = clearest(nodes.reshape(-1, 3), motion.corners(), motion.sea)
    corners = np.array(np.meshgrid(*[[-0.5, 0.5]] * 3)).reshape(3, -1).T * half / np.max(half)
    right, up, forward = camera.axes @ corners.T
    depth = np.maximum(np.abs(right) / (ASPECT * HALF_VIEW), np.abs(up) / HALF_VIEW) - forward
    return -1.05 * float(np.max(depth)) * camera.axes[2]


def _packed(values: Array) -> str:
    """Numbers in single precision, little-endian, in base 64."""
    return base64.b64encode(np.ascontiguousarray(values, "<f4").tobytes()).decode("ascii")


def _names(texts: Any) -> list[str]:
    """Names as plotly shows them, which reads some HTML in texts."""
    shown = [printable(text) for text in texts]
    return [escape(one if len(one) <= NAME_LETTERS else f"{one[: NAME_LETTERS - 1]}…", quote=False) for one in shown]


def _css(color: Any) -> str:
    return "rgb({},{},{})".format(*(round(255 * float(part)) for part in color))
