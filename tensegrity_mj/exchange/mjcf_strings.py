"""Strings from the tendons of a MuJoCo model, and from the actuators that pull them."""

from __future__ import annotations

from collections.abc import Callable

import mujoco
import numpy as np

from tensegrity_mj.exchange.draft import Draft
from tensegrity_mj.exchange.options import ImportOptions
from tensegrity_mj.model.members import RodMass, String
from tensegrity_mj.model.rods import centers_and_moments
from tensegrity_mj.model.strings import StringLaw

NEAR = 1e-6  # of a rod's length: what is so near to its end, or its middle, is there
THIN = 0.01  # of a thin uniform rod's moment of inertia: one that differs by less is such a rod's
MOST_HALVINGS = 20


def rod_of_body(mass: float, length: float, center: float, moment: float) -> tuple[float, tuple[RodMass, ...]] | None:
    """The mass [kg] of the rod itself, and what it carries; None where no mass on a rod makes it such a body.

    The rod is the heaviest of half, a quarter, ... of the mass with which the rest of the inertia is one of a mass.

    Args:
        mass: of the body [kg].
        length: [m].
        center: of mass, from 0 at the first end to 1 at the second.
        moment: of inertia across the rod, about the centre of mass [kg m²].
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
