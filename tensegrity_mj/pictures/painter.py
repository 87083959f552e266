"""One structure as geoms of a MuJoCo scene, from node positions alone: any engine's run.

A massless slack string has no shape of its own. A parabola in the plane of the chord and "down" is close to the
catenary that a reader expects, hangs without gravity too, and becomes the straight string without a jump as the slack
vanishes.
"""

from __future__ import annotations

import enum
import itertools
import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tensegrity_mj.basics.arrays import Array, norm, rotations_to
from tensegrity_mj.model.elements.terrain import Terrain
from tensegrity_mj.model.rods import mass_places
from tensegrity_mj.model.structure import Structure
from tensegrity_mj.pictures import palette
from tensegrity_mj.pictures.camera import FIELD_OF_VIEW, Camera
from tensegrity_mj.pictures.motion import MAX_PIECES, Motion, Pose, Traces, supported_points
from tensegrity_mj.pictures.shade import MOST_STRINGS, PIECES, Patch
from tensegrity_mj.pictures.surface import Surface

SLACK_SEGMENTS = 12
FIELD_BEYOND = 20.0  # times the reach of a picture: how far uneven ground is drawn
TRANSLUCENT = 0.41  # opacity of all members that are; one for all, see `shrink.behind`
TRACE = 1.6  # px
SLACKNESS = 1e-6  # of its length: below, a slack string looks straight anyway


class Look(enum.Enum):
    """Styles in which a structure is drawn."""

    SOLID = "solid"
    GHOST = "ghost"  # translucent
    TARGET = "target"  # translucent, without strings

    @property
    def width(self) -> float:
        """Thickness of members relative to solid ones; translucent ones stand out around a solid at the same place."""
        return 1.0 if self is Look.SOLID else 1.5

    @property
    def rgba(self) -> NDArray[np.float32]:
        """Colour of rods, and of all members of a ghost."""
        color, alpha = {
            Look.SOLID: (palette.ROD, 1.0),
            Look.GHOST: (palette.GHOST, TRANSLUCENT),
            Look.TARGET: (palette.TARGET, TRANSLUCENT),
        }[self]
        return _rgba(color, alpha)


EDGE = 2.5  # times as thick as strings: edges of bodies


@dataclass(frozen=True)
class Sizes:
    """Radii [m] at which members show, at any scale of the structure."""

    rod: NDArray[np.float64]
    string: float
    support: float
    point_mass: float

    @classmethod
    def of(cls, structure: Structure, extent: float) -> Sizes:
        """Return radii in a picture that is `extent` [m] wide: those of real rods, unless they would hardly show."""
        lengths = structure.rod_lengths
        typical = float(np.median(lengths)) if len(lengths) else extent
        least = max(min(0.0125 * typical, 0.01 * extent), 0.0022 * extent)
        rods = np.maximum(np.array([rod.radius for rod in structure.rods], float), least)
        return cls(
            rod=np.minimum(rods, 0.25 * np.maximum(lengths, least)),
            string=max(min(0.0042 * typical, 0.0034 * extent), 0.0011 * extent),
            support=max(1.5 * least, 1.4 * float(np.max(rods, initial=0.0))),
            point_mass=2.4 * least,
        )


# An almost empty model: it lends MuJoCo's renderer its lights and its settings. Drawn without multisampling, shadow,
# reflection and sky, which cost most of the time in software OpenGL; frames are smoothed by drawing them larger.
_MODEL = f"""
<mujoco>
  <statistic center="0 0 0" extent="1"/>
  <visual>
    <global fovy="{FIELD_OF_VIEW}"/>
    <quality shadowsize="0" offsamples="0" numslices="14" numstacks="7" numquads="1"/>
    <headlight ambient="0.42 0.42 0.42" diffuse="0.38 0.38 0.38" specular="0.06 0.06 0.06"/>
  </visual>
  <worldbody>
    <light type="directional" dir="-0.3 0.35 -1" diffuse="0.34 0.34 0.34" ambient="0 0 0"
           specular="0.1 0.1 0.1" castshadow="false"/>
  </worldbody>
</mujoco>
"""


def make_model(surface: Surface | None = None, terrain: Terrain | None = None, cell: float = 1.0) -> Any:
    """The MjModel that pictures are drawn with; with water, it lends the renderer a skin for each of its meshes.

    On a terrain there are lines a `cell` [m] apart.
    """
    import mujoco

    specification = mujoco.MjSpec.from_string(_MODEL)
    if terrain is not None:
        add_terrain(specification, terrain)
        texture = specification.add_texture(name="lines", type=mujoco.mjtTexture.mjTEXTURE_2D, width=256, height=256)
        texture.builtin, texture.mark = mujoco.mjtBuiltin.mjBUILTIN_FLAT, mujoco.mjtMark.mjMARK_EDGE
        texture.rgb1, texture.markrgb = [1.0, 1.0, 1.0], [0.8, 0.8, 0.8]
        lined = specification.add_material(name="lined", texuniform=True, texrepeat=[2.0 / cell, 2.0 / cell])
        lined.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = "lines"
    for faces in () if surface is None else surface.faces:
        count = int(faces.max()) + 1
        # Where vertices are is said for each frame; here the triangles count, and that there is a bone.
        skin = specification.add_skin()
        skin.vert, skin.face = np.zeros(3 * count).tolist(), faces.ravel().tolist()
        skin.bodyname, skin.bindpos, skin.bindquat = ["world"], [0.0, 0.0, 0.0], [1.0, 0.0, 0.0, 0.0]
        skin.vertid, skin.vertweight = [list(range(count))], [[1.0] * count]
    return specification.compile()


def add_terrain(specification: Any, terrain: Terrain) -> None:
    """Add the height field of a terrain to a model's assets, its only one."""
    _, sizes, shares = terrain.height_field()
    rows, columns = shares.shape
    specification.add_hfield(name="terrain", nrow=rows, ncol=columns, size=sizes, userdata=shares.ravel().tolist())


class Painter:
    """Fills one MjvScene. Static parts first, then traces as they grow, then what moves, anew for each frame.

    MuJoCo keeps the geoms of a scene between frames as long as its model has none of its own, so that only what changed
    is written again.

    Args:
        model: from `make_model`.
        capacity: largest number of geoms of a scene of its own.
        pixel_scale: pixels drawn for a pixel of width of a line.
        scene: to fill in its place, such as a viewer's; what it has no room for is left out.
    """

    def __init__(self, model: Any, capacity: int = 0, pixel_scale: float = 1.0, scene: Any = None) -> None:
        import mujoco

        self._mujoco = mujoco
        self._model = model
        self._data = mujoco.MjData(model)
        mujoco.mj_forward(model, self._data)
        self.scene = mujoco.MjvScene(model, maxgeom=capacity) if scene is None else scene
        if scene is None:
            self.scene.flags[:] = 0
            self.scene.flags[mujoco.mjtRndFlag.mjRND_CULL_FACE.value] = 1
        self._geoms = self.scene.geoms
        self._option = mujoco.MjvOption()
        self._option.flags[mujoco.mjtVisFlag.mjVIS_SKIN.value] = 0  # they are drawn here, where there are any
        self._perturb = mujoco.MjvPerturb()
        self._view = mujoco.MjvCamera()
        self._pixel_scale = pixel_scale
        self._count = 0
        self._fixed = 0
        self._zero = np.zeros(3)
        self._identity = np.eye(3).ravel()

    def look_from(self, camera: Camera, reach: float, field_of_view: float) -> None:
        """Place the camera; everything within `reach` [m] of the point looked at is drawn, at least. Forgets no geom.

        `field_of_view` [degrees] is the vertical one of the part of the picture that is drawn.
        """
        distance = camera.distance
        extent = max(reach, 1e-9)
        self._model.stat.extent = extent
        self._model.vis.global_.fovy = field_of_view
        # Ground goes on around what is looked at.
        beyond = 1.0 if self._model.nhfield == 0 else FIELD_BEYOND
        self._model.vis.map.znear = max(0.05, (distance - beyond * reach) / extent)
        self._model.vis.map.zfar = (distance + 3.0 * beyond * reach) / extent
        self._view.lookat[:] = camera.look_at
        self._view.distance = distance
        self._view.azimuth = camera.azimuth
        self._view.elevation = camera.elevation
        everything = self._mujoco.mjtCatBit.mjCAT_ALL.value
        self._mujoco.mjv_updateScene(
            self._model, self._data, self._option, self._perturb, self._view, everything, self.scene
        )
        self.scene.ngeom = self._count

    def keep(self) -> None:
        """Keep what is drawn so far; traces come next, then what each frame draws anew."""
        self._fixed = self._count

    def reset(self) -> None:
        """Forget everything."""
        self._count = self._fixed = 0

    def finish(self) -> Any:
        """The MjvScene with everything drawn so far."""
        self.scene.ngeom = self._count
        return self.scene

    def background(self, camera: Camera, reach: float, backdrop: palette.Color) -> None:
        """A plate behind everything, in one colour, as the first geom; for pictures with water, see `shrink.behind`."""
        # Emission outshines the lights a thousand times, so that the colour is the same everywhere.
        color = np.array([*(c / 1000.0 for c in backdrop), 1.0], np.float32)
        right, up, forward = camera.axes
        depth = camera.distance + 2.0 * reach
        half = 3.0 * depth * math.tan(math.radians(FIELD_OF_VIEW) / 2.0)
        geom = self._geoms[0]
        self._count = max(1, self._count)
        frame = np.column_stack([right, up, -forward]).ravel()
        size = np.array([4.0 * half, half, 1.0])
        self._mujoco.mjv_initGeom(geom, self._kind("PLANE"), size, camera.position + depth * forward, frame, color)
        geom.emission, geom.specular = 1000.0, 0.0

    def grid(self, low: Array, high: Array, cell: float, shade: palette.Color) -> None:
        """Lines a `cell` [m] apart in the horizontal rectangle between the corners `low` and `high` (3,)."""
        color = _rgba(shade, 1.0)
        for a in (0, 1):
            for x in np.arange(round((high[a] - low[a]) / cell) + 1) * cell + low[a]:
                start, end = low.copy(), high.copy()
                start[a] = end[a] = x
                self.line(start, end, color, 1.1)

    def plate(self, low: Array, high: Array, frame: Array) -> None:
        """A floor: a thin plate between two corners (3,) [m] of its upper face, whose axes are the columns of `frame`.

        It lies a little below, so that lines on the floor show.
        """
        across = 0.5 * frame.T @ (high - low)
        thickness = plate_thickness(low, high)
        size = (abs(across[0]), abs(across[1]), thickness)
        middle = 0.5 * (low + high) - 2.0 * thickness * frame[:, 2]
        geom = self._put("BOX", size, middle, frame, _rgba(palette.FLOOR, 1.0))
        geom.emission, geom.specular = 0.12, 0.0

    def terrain(self, floor: tuple[Array, Array], terrain: Terrain) -> None:
        """Uneven ground on a floor, for a model made with the same `terrain`."""
        middle, sizes, _ = terrain.height_field()
        geom = self._put("HFIELD", sizes[:3], floor[0] + middle, self._identity, _rgba(palette.FLOOR, 1.0))
        geom.dataid, geom.matid, geom.emission, geom.specular = 0, 0, 0.0, 0.0

    def shadows(self, floor: tuple[Array, Array], thickness: float, dark: Iterable[Patch]) -> None:
        """Flat shadows just above a floor's plate of that thickness [m], darker ones over paler ones."""
        for patch in dark:
            color = _rgba(palette.mixed(palette.FLOOR, palette.SHADE, patch.darkness), 1.0)
            place = patch.middle - (0.7 - 0.6 * patch.darkness) * thickness * floor[1]
            # These two have the fewest faces of what is flat.
            kind, tall = ("ELLIPSOID", 0.05 * thickness) if patch.round else ("PLANE", 1.0)
            geom = self._put(kind, (*patch.half, tall), place, patch.axes, color)
            geom.emission, geom.specular = 0.12, 0.0

    def water(self, surface: Surface, points: Array) -> None:
        """The water whose surface has the vertices (I, J, 3) [m], for a model made with the same `surface`."""
        # Drawn twice each, see MuJoCo's order of translucent geoms: in effect, opacity is 1 - (1 - alpha)².
        looks = ((palette.WATER, 0.26, 0.3), (palette.WATER, 0.14, 0.2), (palette.WATER_LINE, 0.35, 0.5))
        for row, (mesh, (color, alpha, emission)) in enumerate(zip(surface.meshes(points), looks, strict=True)):
            first = 3 * self.scene.skinvertadr[row]
            for target, values in zip((self.scene.skinvert, self.scene.skinnormal), mesh, strict=True):
                target[first : first + values.size] = values.ravel()
            # A skin is in world coordinates: the place counts only for the order in which geoms are drawn.
            middle = points[0, 0] + 0.5 * (points[-1, -1] - points[0, 0])
            geom = self._put("SKIN", self._zero, middle, self._identity, _rgba(color, alpha))
            geom.objid, geom.emission, geom.specular = row, emission, 0.0

    def supports(self, structure: Structure, nodes: Array, sizes: Sizes) -> None:
        """Dark cubes at fixed nodes and pinned points of rods; light ones where a rod is guided in some directions."""
        for position, held in supported_points(structure, nodes):
            color = palette.SUPPORT if held == 3 else palette.GUIDE
            half = sizes.support * (1.0 if held == 3 else 0.8)
            self._put("BOX", (half, half, half), position, self._identity, _rgba(color, 1.0))

    def traces(self, traces: Traces, first: int, last: int, colors: NDArray[np.float32]) -> None:
        """Add pieces first..last-1 to those drawn; of a film's many, the oldest make room for the newest."""
        for i in range(max(first, last - MAX_PIECES), last):
            slot = self._fixed + i % MAX_PIECES
            width = TRACE * self._pixel_scale
            self._connect(self._geoms[slot], "LINE", traces.starts[i], traces.ends[i], width, colors[traces.nodes[i]])
        self._count = self._fixed + min(last, MAX_PIECES)

    def line(self, start: Array, end: Array, color: NDArray[np.float32], pixels: float = TRACE) -> None:
        """A thin line such as a trace's."""
        self._connect(self._next(), "LINE", start, end, pixels * self._pixel_scale, color)

    def structure(
        self,
        motion: Motion,
        pose: Pose,
        sizes: Sizes,
        tension: palette.TensionScale,
        look: Look = Look.SOLID,
        thickness: bool = False,
    ) -> None:
        """All members at one instant; with `thickness`, strings are as thick as they pull."""
        structure, nodes = motion.structure, pose.nodes
        color = look.rgba
        for (i, j), radius in zip(structure.rod_nodes, sizes.rod, strict=True):
            self._capsule(nodes[i], nodes[j], look.width * radius, color, look)
        for i, j in structure.body_edges:
            shade = _rgba(palette.POINT_MASS, 1.0) if look is Look.SOLID else color
            self._capsule(nodes[i], nodes[j], EDGE * look.width * sizes.string, shade, look)
        for i, j, s, _ in mass_places(structure):
            shade = _rgba(palette.POINT_MASS, 1.0) if look is Look.SOLID else color
            place, radius = (1 - s) * nodes[i] + s * nodes[j], look.width * sizes.point_mass
            ball = self._put("SPHERE", (radius, radius, radius), place, self._identity, shade)
            if look is not Look.SOLID:
                self._inside_out(ball)
        if look is not Look.TARGET:
            radii = np.full(len(pose.tensions), look.width * sizes.string)
            if thickness:
                # Areas in proportion to tension, from a third of the usual thickness to three times.
                radii *= 0.33 + 2.67 * np.sqrt(np.clip(pose.tensions / tension.end, 0.0, 1.0))
            self._strings(motion, pose, radii, tension, look)

    def _strings(self, motion: Motion, pose: Pose, radii: Array, tension: palette.TensionScale, look: Look) -> None:
        """Taut strings straight, in the colour of their tension; slack ones as arcs of their length; no broken ones."""
        paths = motion.structure.paths
        if len(paths.nodes) == 0:
            return
        nodes, lengths = pose.nodes, motion.structure.string_lengths(pose.nodes)
        slack = (pose.rest_lengths > lengths * (1.0 + SLACKNESS)) & ~pose.broken
        rgba = np.ones((len(slack), 4), np.float32)
        rgba[:, :3] = tension.colors(pose.tensions)
        loose = _rgba(palette.SLACK, 1.0)
        if look is not Look.SOLID:
            rgba[:] = loose[:] = look.rgba
        taut = ~slack & ~pose.broken
        for (i, j), row in zip(paths.nodes, paths.strings, strict=True):
            if taut[row]:
                self._capsule(nodes[i], nodes[j], radii[row], rgba[row], look, 0.1)
        rows = paths.strings[slack[paths.strings]]
        for row, points in zip(rows, slack_curves(motion, pose, slack) if slack.any() else (), strict=True):
            for start, end in itertools.pairwise(points):
                self._capsule(start, end, 0.75 * radii[row], loose, look, 0.1)

    def _next(self) -> Any:
        geom = self._geoms[min(self._count, len(self._geoms) - 1)]
        self._count = min(self._count + 1, len(self._geoms))
        return geom

    def _capsule(
        self, start: Array, end: Array, radius: float, rgba: NDArray[np.float32], look: Look, emission: float = 0.0
    ) -> None:
        geom = self._next()
        self._connect(geom, "CAPSULE", start, end, radius, rgba)
        geom.specular = 0.25
        geom.emission = emission
        if look is not Look.SOLID:
            self._inside_out(geom)

    def _inside_out(self, geom: Any) -> None:
        """Show only the faces that look away: a solid member at the same place keeps its colour, and gets a rim."""
        # A mirrored frame turns outer faces into inner ones, and the renderer drops those that look away.
        frame = geom.mat
        frame[:, 0] = -frame[:, 0]
        geom.mat = frame
        geom.emission, geom.specular = 0.8, 0.0

    def _connect(self, geom: Any, kind: str, start: Array, end: Array, width: float, rgba: NDArray[np.float32]) -> None:
        number = self._kind(kind)
        self._mujoco.mjv_initGeom(geom, number, self._zero, self._zero, self._identity, rgba)
        self._mujoco.mjv_connector(geom, number, width, start, end)

    def _put(self, kind: str, size: Any, place: Array, axes: Array, rgba: NDArray[np.float32]) -> Any:
        """The next geom, of that size at that place, its axes the columns (3, 3)."""
        geom = self._next()
        self._mujoco.mjv_initGeom(geom, self._kind(kind), np.asarray(size, float), place, axes.ravel(), rgba)
        return geom

    def _kind(self, name: str) -> int:
        return int(getattr(self._mujoco.mjtGeom, f"mjGEOM_{name}").value)


def plate_thickness(low: Array, high: Array) -> float:
    """Return half the thickness [m] of a floor's plate between two corners (3,) [m]; it hardly shows."""
    return 1e-3 * float(np.linalg.norm(high - low))


def geoms_needed(structure: Structure) -> int:
    """Most geoms that a structure can take: every string slack, and shadows of all."""
    members = len(structure.rods) + len(mass_places(structure)) + SLACK_SEGMENTS * len(structure.paths.nodes)
    shadows = 2 * ((PIECES + 2) * len(structure.rods) + min(len(structure.paths.nodes), MOST_STRINGS))
    members += len(structure.body_edges)
    return members + len(structure.rods) + len(structure.fixed_nodes) + shadows


def slack_curves(motion: Motion, pose: Pose, slack: NDArray[np.bool_]) -> Array:
    """Points (S, pieces + 1, 3) [m] along the segments of slack strings, each with its share of the string's length."""
    paths = motion.structure.paths
    loose = slack[paths.strings]
    pairs, strings = paths.nodes[loose], paths.strings[loose]
    start, end = pose.nodes[pairs[:, 0]], pose.nodes[pairs[:, 1]]
    rest = pose.rest_lengths[strings] / paths.shares(norm(paths.spans(pose.nodes)))[loose]
    outward = 0.5 * (start + end) - pose.nodes.mean(axis=0)
    return slack_arcs(start, end, rest, motion.down, outward, SLACK_SEGMENTS)


def _rgba(color: palette.Color, alpha: float) -> NDArray[np.float32]:
    return np.array([*color, alpha], np.float32)


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
