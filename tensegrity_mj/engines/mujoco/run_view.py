"""The table of a run in MuJoCo: what the control callback reads and writes, by names, behind what every plant has."""

from __future__ import annotations

from typing import Any

import numpy as np

from tensegrity_mj.dynamics.native.views import Table, changing_view, fields_of, view_of
from tensegrity_mj.engines.driving import STEPPED

SLIDE = np.dtype(
    [
        ("motion", "i8"),
        ("place", "i8"),  # in qpos
        ("dof", "i8"),
        ("drive", "f8"),  # its armature [kg]
        ("axis", "f8", (3,)),
        ("offset", "f8"),  # along the axis, of d where qpos is 0
        ("weight", "f8"),  # M g·e of the tree
        ("rate", "f8"),  # ḋ of the stage whose constraint forces are not yet known
    ],
    align=True,
)

RUN = fields_of(
    STEPPED,
    data="size",  # address of the MjData
    # Its arrays as MuJoCo names them.
    site_xpos=("f8", "site_count", 3),
    cvel=("f8", "body_count", 6),
    subtree_com=("f8", "body_count", 3),
    xipos=("f8", "body_count", 3),
    xfrc_applied=("f8", "body_count", 6),
    qpos=("f8", "nq"),
    qvel=("f8", "nv"),
    qacc=("f8", "nv"),
    qfrc_applied=("f8", "nv"),
    qfrc_constraint=("f8", "nv"),
    qfrc_bias=("f8", "nv"),
    qfrc_passive=("f8", "nv"),
    cdof=("f8", "nv", 6),
    cdof_dot=("f8", "nv", 6),
    M=("f8", "entries"),
    ctrl=("f8", "string_count"),
    actuator_force=("f8", "string_count"),
    force_range=("f8", "string_count", 2),  # of the model
    # Where nodes are, and what strings' controls count from.
    node_sites=("i8", "node_count"),
    node_bodies=("i8", "node_count"),
    node_roots=("i8", "node_count"),
    designed=("f8", "string_count"),
    # The course of the run.
    stages="size",
    counters=("i8", 6),  # `Counters`
    work=("f8", 3),  # integrals: elastic string work, dissipation, external work
    part="state",  # of a step that is split, of which `step` is one part: 1, and when the part begins
    begins="real",  # [s]
    answered="state",  # where rest lengths of this very state are known already: 1 + what the law answered
    powers=("f8", 3),  # [W] of the last stage whose work was counted
    slides=("f8", "rod_count", 11),  # of a rod: translational coordinates, how many, first dof, and axes
    writes_state="size",  # whether rows have qpos and qvel
    # Contact (`contact`).
    touches="size",  # whether there is any
    stage_rates=("f8", "nv"),
    spinning=("i8", "spin_count", 3),  # body and nodes of each rod that may spin about its axis
    spin_inertia=("f8", "spin_count"),
    # Moved supports (`motion`).
    driven=(SLIDE, "driven_count"),
    driven_masses=("f8", "driven_count", "node_count"),
    driven_nodes=("f8", "driven_count", "node_count"),
    driven_segments=("f8", "driven_count", "segment_count"),
    resets="size",  # whether slides and constraints are put where they belong at the start of each step
    constrained="size",  # whether constraints do work: those of contact, and any that pull at supports
    awaits_constraints="state",
    # Added mass and linear constraints (`implicit_forces`).
    implicit="size",  # address of an `ImplicitForces`, or 0
    constraint_count="size",
    implicit_room="state",  # address of scratch, which begins with the constraints' forces
)
USERDATA_SIZE = 2  # of a model whose simulations have runs: a token, and the number of the simulation
RunView = changing_view("Run", RUN)
_ARRAYS = [name for name, field in RUN if not isinstance(field, str)]
OF_DATA = tuple(_ARRAYS[_ARRAYS.index("site_xpos") : _ARRAYS.index("force_range")])  # fields that are arrays of MjData
ALIASES = {"lengths": "ten_length", "rates": "ten_velocity"}  # those that have another name there


def bound(model: Any, data: Any, nodes: tuple[Any, Any, Any], slides: Any) -> Table:
    """Make the part of the table that all runs of an MjModel in an MjData share: its arrays, nodes and rods.

    Site, body and root of each node (N,), and (R, 11) of each rod.
    """
    table, (sites, bodies, roots) = Table("run", RUN), nodes
    table.set(**{name: getattr(data, name) for name in OF_DATA})
    table.set(**{name: getattr(data, of)[: model.nu] for name, of in ALIASES.items()})  # strings are the first tendons
    table.set(data=data._address, force_range=model.actuator_forcerange, slides=slides)
    table.set(node_sites=sites, node_bodies=bodies, node_roots=roots)
    return table


Counters, _ = view_of(
    "Counters", **dict.fromkeys(("stage", "step", "next_row", "waiting", "ended", "end_step"), "state")
)
STAGE, STEP, NEXT_ROW, WAITING, ENDED, END_STEP = range(6)  # the same in Python, and when `ended` is none of the law's:
RUNNING, FINISHED, LOST, LOST_CONTROL = -1, -2, -3, -4
