"""Compiled code that all engines share around their own dynamics: strings, the law, actuation and elements.

The parts live in arrays owned by a `Plant`; compiled code reaches them through one table of sizes and addresses,
so that an engine passes a single integer.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from tensegrity_mj.dynamics.native.actuation import winch_work
from tensegrity_mj.dynamics.native.curves import spent_since
from tensegrity_mj.dynamics.native.elements import PackedElements
from tensegrity_mj.dynamics.native.law import FAILED, NOT_FINITE, Command, NativeLaw, Report
from tensegrity_mj.dynamics.native.motion import PackedMotions
from tensegrity_mj.dynamics.native.plant_view import (
    CONTINUOUS,
    HOLD_FORCE_DENSITY,
    HOLD_REST_LENGTH,
    NO_LAW,
    PLANT,
    REPORT_SIZE,
    RESOLUTION_SIZE,
    WATCHED_SIZE,
    PlantView,
)
from tensegrity_mj.dynamics.native.pointers import address, borrowing, copy, floats
from tensegrity_mj.dynamics.native.views import Fields, Table
from tensegrity_mj.errors import ControllerError
from tensegrity_mj.model.actuation import Actuation, Mode, OnInfeasible
from tensegrity_mj.model.capabilities import require_rest_lengths
from tensegrity_mj.model.elements.element import Element
from tensegrity_mj.model.scene import Scene
from tensegrity_mj.model.structure import Structure

_MODES = {
    Mode.CONTINUOUS: CONTINUOUS,
    Mode.HOLD_FORCE_DENSITY: HOLD_FORCE_DENSITY,
    Mode.HOLD_REST_LENGTH: HOLD_REST_LENGTH,
}


@borrowing
def write_row(table: int, stored: float, lost: float, external: float, row: Any) -> None:
    """Nodes, velocities, L0, elastic tensions, tensions, winch work, dissipation, external work, the elements' states,
    the law's report."""
    plant = PlantView(table)
    N, M, states = plant.node_count, plant.string_count, plant.element_states[0]
    copy(floats(address(plant.nodes), 3 * N), row)
    copy(floats(address(plant.velocities), 3 * N), row[3 * N :])
    at = 6 * N
    copy(plant.rest, row[at:])
    copy(plant.elastic, row[at + M :])
    copy(plant.tensions, row[at + 2 * M :])
    at += 3 * M
    row[at] = winch_work(table, stored)
    row[at + 1], row[at + 2] = lost + plant.winch[2], external
    if plant.yielding:
        row[at + 1] += spent_since(table)
    copy(states, row[at + 3 :])
    copy(plant.report, row[at + 3 + len(states) :])


def _packed_curves(structure: Structure) -> dict[str, Any]:
    """The fields of a plant that have the strings' tension curves."""
    curves, M = structure.curves, len(structure.strings)
    there = np.isfinite(curves.starts)
    counts = there.sum(axis=1)
    ends = np.cumsum(counts)
    columns = (curves.starts, curves.tensions, curves.slopes, curves.energies)
    return {
        "curved": not curves.linear,
        "pieces": np.stack([column[there] for column in columns], axis=1),
        "piece_ranges": np.stack([ends - counts, ends], axis=1).astype(np.int64),
        "yielding": bool(curves.yields.any()),
        "yields": curves.yields.astype(np.int64),
        "permanent": np.zeros(M),
        "last_stretch": np.zeros((M, 4)),
    }


class Plant(Table):
    """Table of one run's strings, law, actuation and elements, with the arrays behind it; its fields by their names.

    Attributes:
        elements: what else acts on the nodes.
        motions: of the supports.
    """

    def __init__(
        self,
        scene: Scene,
        law: NativeLaw,
        actuation: Actuation,
        on_infeasible: OnInfeasible,
        fields: Fields = PLANT,
        effects: Sequence[Element] | None = None,
    ) -> None:
        """`fields`: `PLANT`, and those of an engine behind them, which it sets; `effects`: in place of the scene's."""
        super().__init__("plant", fields)
        structure = scene.structure
        if law.address:
            require_rest_lengths(structure)
        N, M, m = len(structure.nodes), len(structure.strings), len(scene.motions)
        self.scene, self.law, self.motions = scene, law, PackedMotions(scene.motions)
        self.set(
            rod_count=len(structure.rods),
            nodes=np.array(scene.nodes0),
            velocities=np.array(scene.velocities0),
            forces=np.zeros((N, 3)),
            segments=np.array(structure.paths.nodes),
            ranges=np.array(structure.paths.ranges),
            segment_lengths=np.zeros(len(structure.paths.nodes)),
            stiffness=np.array(structure.stiffness),
            compliance=1.0 / np.where(structure.stiffness > 0, structure.stiffness, np.inf),
            damping=np.array(structure.damping),
            damped=bool(np.any(structure.damping > 0)),
            clipped=structure.clipped.astype(np.int64),
            **_packed_curves(structure),
            breaking=len(scene.breaks),
            break_times=np.array(scene.break_times),
            broken=np.zeros(M, np.int64),
            mode=_MODES[actuation.mode] if law.address else NO_LAW,
            law=law.address,
            law_context=law.context,
            returns_lengths=law.command is Command.REST_LENGTH,
            passive=on_infeasible is OnInfeasible.PASSIVE,
            report=np.full(REPORT_SIZE, np.nan),
            winch=np.zeros(3),
            motions=self.motions.address,
            moved=np.zeros((m, 3, 3)),
            watched=np.zeros((M, WATCHED_SIZE)),
            resolution=np.zeros((N, RESOLUTION_SIZE)),
            **{name: np.array(structure.rest_lengths) for name in ("rest", "held", "memory")},
            **{name: np.zeros(M) for name in ("command", "lengths", "rates", "tensions", "elastic", "sampled_lengths")},
        )
        self._set_limits(structure, actuation)
        self.elements = PackedElements(scene, self, scene.effects if effects is None else effects)
        self["row_width"] = 6 * N + 3 * M + 3 + self.elements.states.shape[1] + REPORT_SIZE

    def _set_limits(self, structure: Structure, actuation: Actuation) -> None:
        # A winch that holds rest lengths from sample to sample moves them once a period.
        reach = structure.limits("winch_speed") * (actuation.period or np.inf)
        limits = {name: structure.limits(name) for name in ("max_force_density", "min_rest_length")}
        self.set(**limits, winch_reach=reach)
        self["limited"] = any(np.any(np.isfinite(values)) for values in (*limits.values(), reach))

    def raise_if_failed(self, status: int, time: float) -> None:
        """Raise what a law or an element did wrong.

        Raises:
            ControllerError: with the time, and the exception or the offending value.
            ElementError: with the element that failed; OptionError, SceneError: what a function of loads or of a
                support's motion did wrong.
        """
        if self.motions.failure:
            raise self.motions.failure[0]
        self.elements.raise_if_failed(time)
        command = self["command"]
        if status == FAILED:
            cause = self.law.failure[0] if self.law.failure else None
            if cause is not None and not isinstance(cause, Exception):
                raise cause  # KeyboardInterrupt within a Python law
            detail = f"{type(cause).__name__}: {cause}" if cause is not None else "no reason given"
            raise ControllerError(
                f"the law failed near t = {time:.6g} s: {detail}; it must return {len(command)} finite "
                "numbers at every state, or raise InfeasibleError"
            ) from cause
        if status == NOT_FINITE:
            number = int(np.argmin(np.isfinite(command)))
            name = self.scene.structure.strings[number].name
            raise ControllerError(
                f"the law returned {command[number]} for string '{name}' near t = {time:.6g} s; "
                "it must return a finite number for every string"
            )

    def infeasible_message(self, time: float) -> str:
        """Return the message of a run that an infeasible law has stopped."""
        text = f"the law has no admissible solution at t = {time:.6g} s"
        margin = float(self["report"][Report.FEASIBILITY_MARGIN])
        if self.law.reason:
            text += f": {self.law.reason[0]}"
        elif not np.isnan(margin):
            # Where the moment is located, the last margin is the smallest positive one.
            text += f": its margin max(v/α) (5.18) is {margin:.3g}" if margin <= 0 else ": its margin falls to 0 (5.18)"
        return text + "; change the target or the options of the law, or choose OnInfeasible.PASSIVE"
