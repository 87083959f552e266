"""Scenes from MJCF: capsules and cylinders as rods, spatial tendons through sites as strings.

MuJoCo compiles the file (`mjcf_text`), and the scene is read from the model at its keyframe "home" or "start", or where
it is built. Bodies that hang on each other by a ball or hinge joint at a rod's end, and rods that a `connect` holds
together, share a node. A string's numbers are those of an affine actuator on its tendon, as files of this package have
them, or of the tendon's own spring and damper.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.errors import FormatError
from tensegrity_mj.exchange.importing import ALL, Draft, ImportOptions
from tensegrity_mj.exchange.mjcf_text import compiled
from tensegrity_mj.model.elements.contact import Contact
from tensegrity_mj.model.members import Rod, RodMass, String, Support, null_space_basis
from tensegrity_mj.model.rods import centers_and_moments
from tensegrity_mj.model.strings import StringLaw

DRIVEN = 1e6  # a slide whose armature is this many times all masses is driven, not free: see engines/mujoco/mjcf
ROUND = (mujoco.mjtGeom.mjGEOM_CAPSULE, mujoco.mjtGeom.mjGEOM_CYLINDER)
FREE, BALL, SLIDE, HINGE = (int(getattr(mujoco.mjtJoint, f"mjJNT_{one}")) for one in ("FREE", "BALL", "SLIDE", "HINGE"))


@dataclass
class Bar:
    """A rod of the model: its body, its capsule, and the names of its nodes."""

    body: int
    geom: int
    ends: Array
    radius: float
    mass: float
    nodes: list[str]

    @property
    def length(self) -> float:
        return float(np.linalg.norm(self.ends[1] - self.ends[0]))


def read(path: Path, options: ImportOptions) -> Draft:
    """The draft of an MJCF file.

    Raises:
        FormatError: for a model that is not made of such rods and strings; the message names the body.
    """
    model, notes = compiled(path)
    return _Reader(path, model, notes, options).draft()


class _Reader:
    def __init__(self, path: Path, model: mujoco.MjModel, notes: list[str], options: ImportOptions) -> None:
        self.path, self.model, self.data, self.options = path, model, mujoco.MjData(model), options
        keys = {model.key(row).name: row for row in range(model.nkey)}
        key = next((keys[name] for name in ("home", "start") if name in keys), None)
        if key is not None:
            mujoco.mj_resetDataKeyframe(model, self.data, key)
        mujoco.mj_forward(model, self.data)
        self.out = Draft(self._model_name(), f"MJCF, {path.name}", notes=notes)
        self.bars: dict[int, Bar] = {}
        self.points: dict[int, str] = {}  # body of a point mass -> its node
        self.same: dict[str, str] = {}  # name of an end -> the name that stands for it

    def _model_name(self) -> str:
        name = self.model.names[: self.model.names.index(b"\0")].decode(errors="replace")
        return name if name not in ("", "MuJoCo Model") else self.path.stem

    def draft(self) -> Draft:
        model, out = self.model, self.out
        roots = [body for body in range(1, model.nbody) if model.body_weldid[body] == body]
        for body in roots:
            self._add_body(body)
        for body, bar in self.bars.items():
            self._join(body, bar)
        self._close()
        self._name_nodes()
        for body, bar in self.bars.items():
            support = self._support(body, bar)
            name = self._named("geom", bar.geom) or self._named("body", body) or f"rod{len(out.rods) + 1}"
            mass, masses = self._masses(body, bar)
            nodes = (self._of(bar.nodes[0]), self._of(bar.nodes[1]))
            out.rods.append(Rod(name, nodes, mass, bar.radius, support, masses=masses))
        strings_of(model, self.data, self._node_of_site, self.options, out)
        self._world()
        return out

    def _named(self, kind: str, number: int) -> str:
        return str(getattr(self.model, kind)(number).name)

    def _of(self, name: str) -> str:
        while self.same.get(name, name) != name:
            name = self.same[name]
        return name

    def _wrong(self, body: int, what: str) -> FormatError:
        return FormatError(f"{self.path}: body '{self._named('body', body) or body}': {what}")

    def _members(self, body: int) -> list[int]:
        """The bodies that are welded into one."""
        return [int(one) for one in np.flatnonzero(self.model.body_weldid == body)]

    def _joints(self, body: int) -> list[int]:
        start, count = int(self.model.body_jntadr[body]), int(self.model.body_jntnum[body])
        return list(range(start, start + count))

    def _add_body(self, body: int) -> None:
        """A rod, or a point mass, of a body and what is welded to it."""
        model, data = self.model, self.data
        members = self._members(body)
        found: list[tuple[int, Array]] = []
        for geom in np.flatnonzero(np.isin(model.geom_bodyid, members) & np.isin(model.geom_type, ROUND)).tolist():
            half = data.geom_xmat[geom].reshape(3, 3)[:, 2] * model.geom_size[geom, 1]
            # The axis of a geom that was written by its ends points from the second to the first.
            ends = np.array([data.geom_xpos[geom] + half, data.geom_xpos[geom] - half])
            if all(np.abs(other - ends).max() > NEAR * np.ptp(ends, axis=0).max() for _, other in found):
                found.append((geom, ends))
        mass = float(model.body_mass[members].sum())
        if len(found) > 1:
            raise self._wrong(
                body, f"{len(found)} capsules or cylinders; a rigid body of several rods has no equivalent here"
            )
        if not found:
            self._add_point(body, mass)
            return
        geom, ends = found[0]
        self.bars[body] = Bar(body, geom, ends, float(model.geom_size[geom, 0]), mass, [f"{body}:0", f"{body}:1"])

    def _masses(self, body: int, bar: Bar) -> tuple[float, tuple[RodMass, ...]]:
        """Mass of a rod itself, and what it carries; a note where it cannot have the body's inertia."""
        along, place = bar.ends[1] - bar.ends[0], self.data.xipos[body] - bar.ends[0]
        center = float(place @ along) / bar.length**2
        largest, aside = float(self.model.body_inertia[body].max()), float(np.linalg.norm(place - center * along))
        found = rod_of_body(bar.mass, bar.length, center, largest) if aside <= NEAR * bar.length else None
        if found is None:
            self.out.notes.append(
                f"body '{self._named('body', body)}' has its centre {np.linalg.norm(place - 0.5 * along):.3g} m off "
                f"the middle and a moment of inertia of {largest:.4g} kg m²; its rod is thin and uniform, of "
                f"{bar.mass * bar.length**2 / 12:.4g} kg m²"
            )
        return found or (bar.mass, ())

    def _add_point(self, body: int, mass: float) -> None:
        model = self.model
        sites = np.flatnonzero(np.isin(model.site_bodyid, self._members(body))).tolist()
        joints = self._joints(body)
        kinds = [int(model.jnt_type[joint]) for joint in joints]
        name = f"{body}:point"
        driven = [joint for joint in joints if self._is_driven(joint)]
        if not sites or not joints or (FREE not in kinds and kinds.count(SLIDE) - len(driven) < 2 and not driven):
            if sites:
                raise self._wrong(
                    body, "neither a rod (one capsule or cylinder) nor a point mass (that is free or slides)"
                )
            self.out.notes.append(f"body '{self._named('body', body)}' carries no site, and is left out")
            return
        self.points[body] = name
        self.out.nodes[name] = self.data.site_xpos[sites[0]].tolist()
        free = [joint for joint in joints if joint not in driven]
        if not free:
            self.out.held[name] = ALL
            return
        self.out.masses[name] = mass
        if kinds.count(SLIDE) == 2 and FREE not in kinds:
            normal = np.cross(*(self.data.xaxis[joint] for joint in free))
            axis = "xyz"[int(np.argmax(np.abs(normal)))]
            self.out.held[name] = frozenset(axis)
            if np.abs(normal).max() < 1 - NEAR:
                self.out.notes.append(
                    f"body '{self._named('body', body)}' slides in an oblique plane; here across {axis}"
                )

    def _is_driven(self, joint: int) -> bool:
        dof = int(self.model.jnt_dofadr[joint])
        return bool(self.model.dof_armature[dof] > DRIVEN * self.model.body_mass.sum())

    def _end_at(self, body: int, place: Array, what: str) -> str:
        bar = self.bars[body]
        gaps = np.linalg.norm(bar.ends - place, axis=1)
        if gaps.min() > NEAR * bar.length:
            raise self._wrong(body, f"{what} is {gaps.min():.3g} m from its nearer end; rods join at their ends")
        return bar.nodes[int(np.argmin(gaps))]

    def _join(self, body: int, bar: Bar) -> None:
        """Join a rod that hangs on another to it, at its joint."""
        parent = int(self.model.body_weldid[self.model.body_parentid[body]])
        if parent == 0:
            return
        if parent not in self.bars:
            raise self._wrong(body, "it hangs on a body that is no rod")
        for joint in self._joints(body):
            if int(self.model.jnt_type[joint]) not in (BALL, HINGE):
                raise self._wrong(body, "it slides on another rod; only ball and hinge joints at ends are taken")
            place = self.data.xanchor[joint]
            ends = [self._end_at(one, place, "a joint") for one in (parent, body)]
            self.same[self._of(ends[1])] = self._of(ends[0])

    def _close(self) -> None:
        """Join rods where equality constraints hold them together, or hold them where they hold them to the world."""
        model, data = self.model, self.data
        for row in range(model.neq):
            name = self._named("equality", row) or str(row)
            if int(model.eq_type[row]) != int(mujoco.mjtEq.mjEQ_CONNECT) or not model.eq_active0[row]:
                self.out.notes.append(f"equality '{name}' is no active connect, and is left out")
                continue
            ids = (int(model.eq_obj1id[row]), int(model.eq_obj2id[row]))
            if int(model.eq_objtype[row]) == int(mujoco.mjtObj.mjOBJ_SITE):
                bodies = [int(model.site_bodyid[one]) for one in ids]
                places = [data.site_xpos[one] for one in ids]
            else:
                bodies = list(ids)
                anchor = data.xpos[ids[0]] + data.xmat[ids[0]].reshape(3, 3) @ model.eq_data[row, :3]
                places = [anchor, anchor]
            ends = [
                self._of(self._end_at(int(model.body_weldid[body]), place, f"equality '{name}'"))
                for body, place in zip(bodies, places, strict=True)
                if model.body_weldid[body] in self.bars
            ]
            if len(ends) == 2:
                self.same[ends[1]] = ends[0]
            elif ends:
                self.out.held[ends[0]] = ALL

    def _name_nodes(self) -> None:
        """Name the nodes by their sites, the shortest name first, and place them where the first rod has them."""
        model, out = self.model, self.out
        places = {name: at for bar in self.bars.values() for name, at in zip(bar.nodes, bar.ends, strict=True)}
        names: dict[str, list[str]] = {self._of(name): [] for name in (*places, *self.points.values())}
        for site in range(model.nsite):
            node = self._node_of_site(site)
            if node in names and self._named("site", site):
                names[node].append(self._named("site", site))
        taken: set[str] = set()
        for number, (node, found) in enumerate(names.items()):
            name = next((one for one in sorted(found, key=len) if one not in taken), f"node{number + 1}")
            taken.add(name)
            at = out.nodes.pop(node, None)
            out.nodes[name] = places[node].tolist() if at is None else at
            self.same |= {node: name, name: name}
            if node in out.held:
                out.held[name] = out.held.pop(node)
            if node in out.masses:
                out.masses[name] = out.masses.pop(node)

    def _node_of_site(self, site: int) -> str | None:
        """The node where a site stands, or None; a site that is fixed in the world becomes a fixed node by this."""
        model, data = self.model, self.data
        body = int(model.body_weldid[model.site_bodyid[site]])
        if body in self.points:
            return self._of(self.points[body])
        place = data.site_xpos[site]
        if body in self.bars:
            bar = self.bars[body]
            gaps = np.linalg.norm(bar.ends - place, axis=1)
            # Ends of strings are often drawn on the surface of a rod, or at the tip of its cap.
            if gaps.min() > max(2.0 * bar.radius, NEAR * bar.length):
                return None
            return self._of(bar.nodes[int(np.argmin(gaps))])
        if body:
            return None
        name = self._named("site", site) or f"site{site}"
        if name not in self.out.nodes:
            self.out.nodes[name] = place.tolist()
            self.out.held[name] = ALL
        return name

    def _support(self, body: int, bar: Bar) -> Support:
        """Return the support by which the joints of a rod's body hold it."""
        model, data = self.model, self.data
        kinds: dict[int, list[int]] = {FREE: [], BALL: [], SLIDE: [], HINGE: []}
        for joint in self._joints(body):
            kinds[int(model.jnt_type[joint])].append(joint)
        driven = [joint for joint in kinds[SLIDE] if self._is_driven(joint)]
        slides = np.array([data.xaxis[joint] for joint in kinds[SLIDE] if joint not in driven]).reshape(-1, 3)
        turns = kinds[BALL] + kinds[HINGE]
        plane = tuple(_clean(data.xaxis[kinds[HINGE][0]])) if len(turns) == 1 and kinds[HINGE] else None
        if int(model.body_weldid[model.body_parentid[body]]) or kinds[FREE]:
            return Support.free(plane=plane)
        if not turns:
            if len(slides):
                raise self._wrong(body, "it slides without turning; a rod here turns about its support")
            for node in bar.nodes:
                self.out.held[self._of(node)] = ALL
            return Support.free()
        along = bar.ends[1] - bar.ends[0]
        anchor = data.xanchor[turns[0]] - bar.ends[0]
        sigma = float(anchor @ along / (along @ along))
        if np.linalg.norm(anchor - sigma * along) > NEAR * bar.length or not -NEAR <= sigma <= 1 + NEAR:
            raise self._wrong(body, "its joint is off its axis, or beyond its ends")
        sigma = next((float(whole) for whole in (0, 1) if abs(sigma - whole) < NEAR), sigma)
        if len(turns) > 1:
            self.out.notes.append(
                f"body '{self._named('body', body)}' turns by {len(turns)} joints; here by a ball joint"
            )
        return self._held(slides, sigma, plane)

    def _held(self, slides: Array, sigma: float, plane: Sequence[float] | None) -> Support:
        """The support of a point that slides along axes (n, 3) alone."""
        if not len(slides):
            return Support.pinned(sigma, plane)
        rows = null_space_basis(slides).T
        if plane is not None:
            rows = np.array([row for row in rows if abs(row @ np.array(plane)) < 1 - NEAR]).reshape(-1, 3)
        held = [_clean(row) for row in rows]
        return Support.constrained(held, sigma, plane=plane) if held else Support.free(sigma, plane)

    def _world(self) -> None:
        model, out = self.model, self.out
        flags = int(model.opt.disableflags)
        if not flags & mujoco.mjtDisableBit.mjDSBL_GRAVITY:
            out.settings["gravity"] = tuple(model.opt.gravity.tolist())
        out.velocities = self._velocities()
        out.settings |= {} if flags & mujoco.mjtDisableBit.mjDSBL_CONTACT else self._contact()
        own = [dof for dof in range(model.nv) if model.dof_damping[dof] or model.dof_frictionloss[dof]]
        for found, what in (
            (own or model.jnt_stiffness.any(), "springs, dampers and friction of joints"),
            (model.jnt_limited.any(), "limits of joints"),
            (model.opt.viscosity > 0 or model.opt.density > 0, "the fluid of its options"),
        ):
            if found:
                out.notes.append(f"{what} are left out")

    def _velocities(self) -> dict[str, Any]:
        model = self.model
        driven = [joint for joint in range(model.njnt) if model.jnt_type[joint] == SLIDE and self._is_driven(joint)]
        if driven:
            bodies = dict.fromkeys(self._named("body", int(model.jnt_bodyid[joint])) for joint in driven)
            self.out.notes.append(
                f"what drives {', '.join(bodies)} is left out: their supports stand still, and all starts at rest"
            )
        if driven or not self.data.qvel.any():
            return {}
        found: dict[str, Any] = {}
        jacobian = np.zeros((3, model.nv))
        places = [(self.data.xpos[body], body, node) for body, node in self.points.items()]
        for bar in self.bars.values():
            places += [(at, bar.body, node) for node, at in zip(bar.nodes, bar.ends, strict=True)]
        for place, body, node in places:
            mujoco.mj_jac(model, self.data, jacobian, None, place, body)
            found.setdefault(self._of(node), (jacobian @ self.data.qvel).tolist())
        return found

    def _contact(self) -> dict[str, Any]:
        """Contact of rods with a plane and with each other, where their geoms may touch."""
        model = self.model
        rods = [bar.geom for bar in self.bars.values()]

        def touch(one: int, other: int) -> bool:
            bits = model.geom_contype[one] & model.geom_conaffinity[other]
            return bool(bits | (model.geom_contype[other] & model.geom_conaffinity[one]))

        planes = np.flatnonzero(model.geom_type == mujoco.mjtGeom.mjGEOM_PLANE).tolist()
        floor = next((plane for plane in planes if any(touch(plane, rod) for rod in rods)), None)
        between = bool(rods) and touch(rods[0], rods[0])
        if floor is None and not (between and len(rods) > 1):
            return {}
        geom = rods[0] if floor is None else floor
        first, second = model.geom_solref[geom].tolist()
        impedance = tuple(model.geom_solimp[geom].tolist())
        if first > 0:  # a time and a damping ratio: MuJoCo's "Solver parameters"
            first, second = -1 / (impedance[1] * first * second) ** 2, -2 / (impedance[1] * first)
        friction = max(float(model.geom_friction[one, 0]) for one in (geom, rods[0]))
        if model.geom_condim[[geom, rods[0]]].max() < 3:
            friction = 0.0
        place: dict[str, Any] = {}
        if floor is not None:
            normal = self.data.geom_xmat[floor].reshape(3, 3)[:, 2]
            place = {"floor": float(normal @ self.data.geom_xpos[floor]), "normal": tuple((normal + 0.0).tolist())}
        options = {**place, "rods": between, "friction": friction, "stiffness": -first}
        found, usual = Contact(**options, damping=-second, impedance=impedance), Contact(**options)
        return {"contact": usual if usual.spring == found.spring else found}


def _clean(direction: Array) -> list[float]:
    """A direction without the round-off of what is along axes, and of length one."""
    whole = np.where(np.abs(direction) < 1e-12, 0.0, direction)
    return [float(x) for x in whole / np.linalg.norm(whole)]


NEAR = 1e-6  # of a rod's length: what is so near to its end, or its middle, is there
THIN = 0.01  # of a thin uniform rod's moment of inertia: one that differs by less is such a rod's
MOST_HALVINGS = 20


def rod_of_body(mass: float, length: float, center: float, moment: float) -> tuple[float, tuple[RodMass, ...]] | None:
    """The mass [kg] of the rod itself, and what it carries; None where no mass on a rod makes it such a body.

    The rod is the heaviest of half, a quarter, ... of the mass with which the rest of the inertia is one of a mass.

    Args:
        mass: mass of the body [kg].
        length: [m].
        center: centre of mass, from 0 at the first end to 1 at the second.
        moment: moment of inertia across the rod, about the centre of mass [kg m²].
    """
    _, thin = centers_and_moments(mass, length)
    if abs(center - 0.5) <= NEAR and abs(moment - thin) <= THIN * thin:
        return mass, ()
    own = mass
    for _ in range(MOST_HALVINGS):
        own /= 2
        rest = mass - own
        at = (center * mass - 0.5 * own) / rest
        _, without = centers_and_moments(own, length, (rest, rest * at, rest * at**2))
        if 0.0 <= at <= 1.0 and moment >= without:
            return own, (RodMass(at, rest, moment - without),)
    return None


NodeOf = Callable[[int], str | None]
SITE = int(mujoco.mjtWrap.mjWRAP_SITE)


def strings_of(model: mujoco.MjModel, data: mujoco.MjData, node_of: NodeOf, options: ImportOptions, out: Draft) -> None:
    """Add a string for each tendon through sites at nodes, two or more; note what else there is."""
    pulls = _pulls(model, data, out)
    unclipped = False
    for tendon in range(model.ntendon):
        name = model.tendon(tendon).name or f"tendon{tendon + 1}"
        start, count = int(model.tendon_adr[tendon]), int(model.tendon_num[tendon])
        if (model.wrap_type[start : start + count] != SITE).any():
            out.notes.append(f"tendon '{name}' does not run straight from one site to another, and is left out")
            continue
        sites = model.wrap_objid[start : start + count].tolist()
        nodes = [node_of(site) for site in sites]
        if None in nodes:
            site = model.site(sites[nodes.index(None)]).name
            out.notes.append(f"tendon '{name}' ends at site '{site}', which is at no end of a rod; it is left out")
            continue
        path = tuple(node or "" for node in nodes)
        _note_distance(data, sites, path, name, out)
        k, pull, c, free = pulls.get(tendon, (0.0, 0.0, 0.0, False))
        spring = float(model.tendon_stiffness[tendon])
        slack, rest = model.tendon_lengthspring[tendon].tolist()
        if spring > 0:
            k, pull, c = k + spring, pull + spring * rest, c + float(model.tendon_damping[tendon])
            if slack > 0:
                out.notes.append(f"tendon '{name}' pushes where it is shorter than {slack:.4g} m; strings never push")
            if model.tendon_damping[tendon] > 0:
                out.notes.append(
                    f"the damper of tendon '{name}' acts where it is slack, too; that of a string does not"
                )
        elif tendon not in pulls and options.stiffness is not None:
            k, pull, c = options.stiffness, options.stiffness * float(data.ten_length[tendon]), options.damping or 0.0
        if k == 0 and pull < 0:
            out.strings.append(String(name, path, 0.0, c, tension=-pull))
            continue
        if k <= 0 or pull <= 0:
            what = (
                f"no stiffness, such as of --stiffness ({k:g} N/m)" if k <= 0 else f"a rest length of {pull / k:.3g} m"
            )
            out.notes.append(f"tendon '{name}' has {what}, and is left out")
            continue
        if model.tendon_limited[tendon]:
            out.notes.append(f"the limits of the length of tendon '{name}' are left out")
        unclipped = unclipped or free
        out.strings.append(String(name, path, k, c, rest_length=pull / k))
    if unclipped:
        out.settings["string_law"] = StringLaw.UNCLIPPED


def _pulls(model: mujoco.MjModel, data: mujoco.MjData, out: Draft) -> dict[int, tuple[float, float, float, bool]]:
    """Tendon -> stiffness k, k L0, damping and whether it may push, of its affine actuators: -f = k L - k L0 + c L̇."""
    found: dict[int, tuple[float, float, float, bool]] = {}
    for row in range(model.nu):
        name, tendon = model.actuator(row).name or str(row), int(model.actuator_trnid[row, 0])
        gear, bias = float(model.actuator_gear[row, 0]), model.actuator_biasprm[row]
        affine = int(model.actuator_biastype[row]) == int(mujoco.mjtBias.mjBIAS_AFFINE)
        affine &= bool(bias[1] < 0 or (bias[1] == 0 and gear * bias[0] < 0))  # a spring, or a constant force
        if int(model.actuator_trntype[row]) != int(mujoco.mjtTrn.mjTRN_TENDON) or not affine or tendon in found:
            out.notes.append(f"actuator '{name}' is no spring along a tendon, and is left out")
            continue
        k, c = -gear * gear * float(bias[1]), -gear * gear * float(bias[2])
        pull = gear * float(bias[0] + model.actuator_gainprm[row, 0] * data.ctrl[row])
        limited = bool(model.actuator_forcelimited[row]) and gear * float(model.actuator_forcerange[row, 1]) <= 0
        found[tendon] = (k, pull, max(c, 0.0), c > 0 and not limited)
        low = float(model.actuator_forcerange[row, 0])
        if model.actuator_forcelimited[row] and low > -1e29:
            out.notes.append(f"the largest force of actuator '{name}', {-low:g} N, is left out")
    return found


def _note_distance(data: mujoco.MjData, sites: list[int], nodes: tuple[str, ...], name: str, out: Draft) -> None:
    for site, node in zip(sites, nodes, strict=True):
        gap = float(np.linalg.norm(data.site_xpos[site] - np.asarray(out.nodes[node])))
        if gap > 1e-6:
            out.notes.append(f"tendon '{name}' ends {gap:.3g} m from node '{node}', where its string ends here")
