"""The findings of a static study, a line each, its verdict, and both as plain values."""

from __future__ import annotations

import enum
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.basics.jsontext import plain, plain_values
from tensegrity_mj.basics.units import power_of, quantity, unit_with
from tensegrity_mj.errors import InfeasibleError
from tensegrity_mj.model.scene import Scene
from tensegrity_mj.pictures.findings import Finding, Judgement, Mark
from tensegrity_mj.statics.equilibrium import Balance
from tensegrity_mj.statics.lightest import Sizing
from tensegrity_mj.statics.listing import SHOWN, by_member, counted, listed, statistics
from tensegrity_mj.statics.model import Rods, StaticModel
from tensegrity_mj.statics.modes import Modes
from tensegrity_mj.statics.path import Response
from tensegrity_mj.statics.prestress import Prestressability
from tensegrity_mj.statics.state import StaticState, standalone_scene
from tensegrity_mj.statics.stiffening import Verdict
from tensegrity_mj.statics.strength import MemberCheck, TrajectoryCheck

if TYPE_CHECKING:
    from tensegrity_mj.statics.engines import EngineCheck


class Search(enum.Enum):
    """Methods of finding an equilibrium."""

    NEWTON = "newton"
    RELAXATION = "relaxation"  # dynamic, with kinetic damping
    BOTH = "both"  # Newton's, and the other to compare with


@dataclass(frozen=True, eq=False)
class StaticResult:
    """Data of a `StaticStudy`, whose documentation explains the fields; it words, draws and saves them."""

    model: StaticModel
    search: Search
    start: Balance
    state: StaticState | None
    failure: str = ""
    other: StaticState | None = None
    modes: Modes | None = None
    prestressability: Prestressability | None = None
    members: MemberCheck | None = None
    response: Response | None = None
    engine: EngineCheck | None = None
    sizing: Sizing | None = None
    run: TrajectoryCheck | None = None
    notes: tuple[str, ...] = ()

    @property
    def moved(self) -> float:
        """[m]: how far the node that moved most is from the scene's start; NaN without an equilibrium."""
        if self.state is None:
            return float("nan")
        return float(np.linalg.norm(self.state.nodes - self.model.scene.nodes0, axis=1).max(initial=0.0))

    @property
    def difference(self) -> float:
        """[m]: the largest difference of a member's length between the two searches; NaN unless both were made."""
        if self.state is None or self.other is None:
            return float("nan")
        pairs = ((self.state.lengths, self.other.lengths), (self.state.rod_lengths, self.other.rod_lengths))
        return max(float(np.abs(a - b).max(initial=0.0)) for a, b in pairs)

    def scene(self) -> Scene:
        """The scene that starts in the equilibrium, with further loads as its own and without broken strings.

        Raises:
            InfeasibleError: where there is no equilibrium.
        """
        if self.state is None:
            raise InfeasibleError(self.failure)
        return standalone_scene(self.state)

    @property
    def status(self) -> str:
        """ "ok" or "infeasible"."""
        return "infeasible" if self.state is None else "ok"


METHODS = {Search.NEWTON: "Newton's method", Search.RELAXATION: "dynamic relaxation", Search.BOTH: "Newton's method"}
FORMAT = 1  # of statics.json


def judgement(study: StaticResult) -> Judgement:
    """The verdict and the findings of a study."""
    return Judgement(verdict(study), findings(study))


def findings(study: StaticResult) -> list[Finding]:
    """Return all findings, a line each: text, page and JSON are made of these."""
    without = ", without the further loads" if np.any(study.model.loads) else ""
    found = [
        Finding(None, study.model.scene.name, "scene"),
        Finding(None, f"{study.start.describe()}; at the scene's start{without}", "unbalanced force"),
    ]
    if study.state is None:
        found.append(Finding(Mark.BAD, f"none: {study.failure}", "equilibrium"))
    else:
        found += _found(study, study.state)
    if study.sizing is not None:
        found += _under("lightest members", study.sizing.describe())
    if study.run is not None:
        found += _under("members over the run", study.run.describe(), study.run.mark)
    return found + [Finding(Mark.LIMITED, note, "" if row else "note") for row, note in enumerate(study.notes)]


def _under(name: str, texts: Sequence[str], *marks: Mark | None) -> list[Finding]:
    """Lines under one name, the first of them with marks."""
    every = [*marks, *[None] * (len(texts) - len(marks))]
    return [
        Finding(mark, text, "" if row else name) for row, (mark, text) in enumerate(zip(every, texts, strict=False))
    ]


def verdict(study: StaticResult) -> str:
    """The sentence about the equilibrium: stable or not, and by how much the nodes moved."""
    name, state = study.model.scene.name, study.state
    if state is None:
        return f"No equilibrium of {name} was found: {study.failure}."
    kind = "in stable equilibrium" if state.is_stable else "in equilibrium, but not in a stable one"
    return f"{name} is {kind}; its nodes are up to {quantity(study.moved, 'm', 2)} from where they start."


def _found(study: StaticResult, state: StaticState) -> list[Finding]:
    model = study.model
    rods = "elastic" if np.any(model.compliance > 0) else "rigid"
    how = f"path of {counted(len(study.response.path.states), 'point')}" if study.response else ""
    how = how or f"{METHODS[study.search]}, {counted(state.iterations, 'step')}"
    loose = "not stable: at least one motion meets no resistance"
    is_loose = state.lowest_stiffness >= -1e-9 * model.scale[1]
    kind = "stable" if state.is_stable else loose if is_loose else "unstable"
    at = f" at parameter {state.parameter:g}" if study.response is not None else ""
    left = f"at most {quantity(state.residual, 'N', 5)} are left on a coordinate"
    sizes = f"{_sizes(model.scene.nodes0)} at the scene's start, {_sizes(state.nodes)} in equilibrium"
    found = [
        Finding(
            Mark.GOOD if state.is_stable else Mark.LIMITED, f"{kind}{at}; {rods} rods; {how}; {left}", "equilibrium"
        ),
        Finding(None, _moved(study, state), "moved"),
        Finding(None, sizes, "extent x, y, z"),
        Finding(None, _total(state.loads), "loads"),
        Finding(None, _total(reactions(state), model.structure.node_names), "reactions"),
    ]
    if study.other is not None:
        steps = study.other.iterations
        differ = f"lengths of members differ by {quantity(study.difference, 'm', 2)} at most"
        found.append(Finding(None, f"{counted(steps, 'step')}; {differ}", "by relaxation"))
    for name, values, unit in (
        ("tensions", state.settled(state.tensions)[model.whole], "N"),
        ("rod forces", state.settled(state.rod_forces), "N"),
        ("rod stresses", _stresses(study), "Pa"),
    ):
        if len(values):
            found.append(Finding(None, spread(values, unit), name))
        if name == "rod forces" and (chosen := state.determinacy.describe()):
            found.append(Finding(Mark.LIMITED, chosen))
    slack = slack_strings(state)
    if model.structure.strings:
        mark = Mark.LIMITED if slack else Mark.GOOD
        found.append(Finding(mark, f"{len(slack)}: {listed(slack)}" if slack else "none", "slack strings"))
    if (can := study.prestressability) is not None:
        *lines, stable, super_stable = can.describe()
        found += [
            *_under("prestress", lines),
            Finding(Mark.GOOD if can.prestress_stable is Verdict.YES else Mark.LIMITED, stable),
            # No defect where it is not: what is prestress stable stands.
            Finding(Mark.GOOD if can.super_stable is Verdict.YES else None, super_stable),
        ]
    if np.isfinite(state.lowest_stiffness):
        found.append(
            Finding(
                None, f"{quantity(state.lowest_stiffness, 'N/m', 5)} (rigid-body motions excluded)", "lowest stiffness"
            )
        )
    if study.modes is not None and len(study.modes.squares):
        found += _under("frequencies", [f"{listed(_frequencies(study.modes), 12)} Hz", *study.modes.describe()])
    if study.members is not None:
        found += _under("members", _members(study.members), study.members.mark)
    if study.response is not None:
        found += _along(study.response)
    if study.engine is not None:
        found.append(Finding(None, study.engine.describe(), "by an engine"))
        found += [Finding(Mark.LIMITED, f"it warns: {warning}") for warning in study.engine.warnings]
    return found


def _along(response: Response) -> list[Finding]:
    path = response.path
    last, most = path.parameters[-1], response.largest_parameter
    text = f"{path.end.value}; the parameter is {last:.6g} there, and {most:.6g} at most"
    found = [Finding(None, text, "path")]
    for curve in response.curves[:SHOWN]:
        force, moved = (
            quantity(float(row[-1]), unit, 5) for row, unit in ((curve.force, "N"), (curve.displacement, "m"))
        )
        end = f"{force}, its node {moved} along it" if curve.is_load else f"{moved}, pushed with {force} along its way"
        found.append(Finding(None, f"{curve.name}: {end}", "at its end"))
    for critical in path.criticals[:SHOWN]:
        change = critical.unstable_after - critical.unstable_before
        motions = f"{counted(abs(change), 'motion')} {'becomes' if abs(change) == 1 else 'become'}"
        stable = "unstable" if change > 0 else "stable again"
        text = f"{motions} {stable} at parameter {critical.parameter:.6g}: {critical.kind.value}"
        found.append(Finding(Mark.LIMITED, text, "critical"))
    events = [
        f"'{event.string}' is {'slack' if event.slack else 'taut'} from parameter {event.parameter:.4g}"
        for event in response.slack_events
    ]
    if events:
        found.append(Finding(Mark.LIMITED, listed(events), "events"))
    first = response.first_violation
    if first is not None:
        text = f"from parameter {first.time:.4g}: '{first.member}' by {first.criterion.value}"
        found.append(Finding(Mark.BAD, text, "beyond a limit"))
    return found


def spread(values: Array, unit: str) -> str:
    """The least, the median and the largest, in one unit."""
    power = power_of(float(np.abs(values).max()), unit, 5)
    found = statistics(np.asarray(values) / 10.0**power)
    return ", ".join(f"{key} {found[key]:.5g}" for key in found) + f" {unit_with(power, unit)}"


def _total(forces: Array, names: Sequence[str] = ()) -> str:
    """The sum of forces (N, 3), and on how many nodes; with names, the largest of them."""
    sizes = np.linalg.norm(forces, axis=1)
    if not np.any(sizes):
        return "none"
    least = 1e-9 * float(sizes.sum())  # of forces that cancel, round-off is left
    total = np.where(np.abs(forces.sum(axis=0)) > least, forces.sum(axis=0), 0.0)
    power = power_of(max(float(np.abs(total).max()), float(sizes.max())), "N", 5)
    total = total / 10.0**power
    text = f"({', '.join(f'{part:.5g}' for part in total)}) {unit_with(power, 'N')} in all, on "
    text += counted(int(np.sum(sizes > least)), "node")
    return text + (
        f"; the largest {quantity(float(sizes.max()), 'N', 5)} on '{names[int(sizes.argmax())]}'" if names else ""
    )


def to_dict(study: StaticResult) -> dict[str, Any]:
    """Return plain values, for JSON."""
    from tensegrity_mj.simulation import versions

    model, state = study.model, study.state
    structure = model.structure
    return {
        "format": FORMAT,
        "scene": {"name": model.scene.name, "source": model.scene.source},
        "setup": {
            "rods": (Rods.ELASTIC if np.any(model.compliance > 0) else Rods.RIGID).value,
            "method": study.search.value,
            "gravity": list(model.scene.gravity),
            "loads": _by_node(model, model.loads),
            "holds": [vars(hold) for hold in model.holds],
            "broken": [s.name for s, k in zip(structure.strings, model.whole, strict=True) if not k],
            "path": study.response is not None,
        },
        "start": {
            "unbalanced": study.start.unbalanced,
            "node": study.start.node,
            "equilibrium": study.start.is_equilibrium,
            "extent": np.ptp(model.scene.nodes0, axis=0).tolist(),
        },
        "failure": study.failure,
        "equilibrium": None if state is None else _state(study, state),
        "relaxation": None
        if study.other is None
        else {"steps": study.other.iterations, "residual": study.other.residual, "difference": study.difference},
        "prestress": plain(study.prestressability),
        **plain_values(study, "modes", "members"),
        "path": plain(study.response),
        **plain_values(study, "engine", "sizing", "run", "notes"),
        **judgement(study).to_dict(),
        "versions": versions(),
    }


def _state(study: StaticResult, state: StaticState) -> dict[str, Any]:
    structure = study.model.structure
    strings = {"rest_length": study.model.rest_lengths, "length": state.lengths, "tension": state.tensions}
    strings["force_density"] = state.force_densities
    rods: dict[str, Iterable[Any]] = {"length": state.rod_lengths, "force": state.rod_forces}
    rods["determined"] = [rod.name not in state.determinacy.chosen for rod in structure.rods]
    return {
        "parameter": state.parameter,
        "residual": state.residual,
        "steps": state.iterations,
        "stable": state.is_stable,
        "lowest_stiffness": state.lowest_stiffness,
        "moved": study.moved,
        "extent": np.ptp(state.nodes, axis=0).tolist(),
        "nodes": dict(zip(structure.node_names, state.nodes.tolist(), strict=True)),
        "strings": by_member(structure.strings, strings),
        "rods": by_member(structure.rods, rods),
        "determinacy": plain_values(state.determinacy, "states", "chosen", "reactions", "is_clear"),
        "loads": _by_node(study.model, state.loads),
        "reactions": _by_node(study.model, reactions(state)),
        "tensions": statistics(state.tensions[study.model.whole]),
        "rod_forces": statistics(state.rod_forces),
        "rod_stresses": statistics(_stresses(study)),
        "slack": slack_strings(state),
    }


def _by_node(model: StaticModel, forces: Array) -> dict[str, Any]:
    names = model.structure.node_names
    return {name: force.tolist() for name, force in zip(names, forces, strict=True) if np.any(force)}


def slack_strings(state: StaticState) -> list[str]:
    """Names of those without tension, or at the edge of it (`StaticState.at_edge`); what is broken is not slack."""
    model = state.model
    pairs = zip(model.structure.strings, state.slack | state.at_edge, model.whole, strict=True)
    return [string.name for string, slack, whole in pairs if slack and whole]


def reactions(state: StaticState) -> Array:
    """(N, 3): of what is held, without what round-off may have made."""
    held = np.unique(state.model.boundary.rows.indices // 3)
    out = np.zeros_like(state.reactions)
    out[held] = state.settled(state.reactions[held])
    return out


def _stresses(study: StaticResult) -> Array:
    if study.members is None:
        return np.zeros(0)
    stresses: Array = study.members.loads.stresses[0]
    known: Array = stresses[np.flatnonzero(np.isfinite(stresses))]
    return known


def _members(check: MemberCheck) -> tuple[str, ...]:
    """Describe members without slack strings, which have their own line; if all are unchecked, say only that."""
    lines = check.describe()[:-1] if check.slack else check.describe()
    return lines if check.worst is not None else lines[:1]


def _frequencies(modes: Modes) -> list[str]:
    """Return frequencies in Hz as text; of modes that grow, the rate."""
    pairs = zip(modes.frequencies.tolist(), modes.growth.tolist(), strict=True)
    return [f"unstable ({growth:.5g} 1/s)" if growth > 0 else f"{frequency:.5g}" for frequency, growth in pairs]


def _moved(study: StaticResult, state: StaticState) -> str:
    """Return how far the nodes moved, and which moved most."""
    if study.moved <= 1e-12 * state.model.scale[0]:
        return "none: the scene already starts in equilibrium"
    node = int(np.linalg.norm(state.nodes - study.model.scene.nodes0, axis=1).argmax())
    name = study.model.structure.node_names[node]
    return f"by up to {quantity(study.moved, 'm', 5)} (node '{name}') from the scene's start"


def _sizes(nodes: Array) -> str:
    return " x ".join(f"{float(size):.5g}" for size in np.ptp(nodes, axis=0)) + " m"
