"""A static study in words and as plain values."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.basics.jsontext import plain, plain_values
from tensegrity_mj.model.members import Rod, String
from tensegrity_mj.statics.model import Rods

if TYPE_CHECKING:
    from tensegrity_mj.statics.modes import Modes
    from tensegrity_mj.statics.response import Response
    from tensegrity_mj.statics.state import StaticState
    from tensegrity_mj.statics.strength import MemberCheck
    from tensegrity_mj.statics.study import StaticStudy

METHODS = {"newton": "Newton's method", "relaxation": "dynamic relaxation", "both": "Newton's method"}  # by `Search`
SHOWN = 8  # names or numbers that a line lists


def counted(count: int, noun: str) -> str:
    """ "1 state", "2 states"."""
    return f"{count} {noun}{'' if count == 1 else 's'}"


def describe(study: StaticStudy) -> list[tuple[str, str]]:
    """Names and what there is to say, a line each."""
    scene = study.model.scene
    rows = [("scene", scene.name)]
    without = ", without the further loads" if np.any(study.model.loads) else ""
    rows.append(("unbalanced force", f"{study.start.describe()}; at the scene's start{without}"))
    state = study.state
    if state is None:
        rows.append(("equilibrium", f"none: {study.failure}"))
    else:
        rows += _found(study, state)
    for name, texts in (
        ("lightest members", () if study.sizing is None else study.sizing.describe()),
        ("members over the run", () if study.run is None else study.run.describe()),
        ("note", study.notes),
    ):
        rows += [(name if not row else "", text) for row, text in enumerate(texts)]
    return rows


def _found(study: StaticStudy, state: StaticState) -> list[tuple[str, str]]:
    model = study.model
    rods = "elastic" if np.any(model.compliance > 0) else "rigid"
    how = f"path of {counted(len(study.response.path.states), 'point')}" if study.response else ""
    how = how or f"{METHODS[study.search.value]}, {counted(state.iterations, 'step')}"
    loose = "not held: some motion costs no energy"
    is_loose = state.lowest_stiffness >= -1e-9 * model.scale[1]
    kind = "stable" if state.is_stable else loose if is_loose else "unstable"
    at = f" at parameter {state.parameter:g}" if study.response is not None else ""
    rows = [
        (
            "equilibrium",
            f"{kind}{at}; {rods} rods; {how}; at most {_number(state.residual, 'N')} are left on a coordinate",
        ),
        ("moved", _moved(study, state)),
        ("extent x, y, z", f"{_sizes(model.scene.nodes0)} at the scene's start, {_sizes(state.nodes)} in equilibrium"),
    ]
    if study.other is not None:
        steps = study.other.iterations
        differ = f"lengths of members differ by {study.difference:.2g} m at most"
        rows.append(("by relaxation", f"{counted(steps, 'step')}; {differ}"))
    for name, values, unit in (
        ("tensions", state.settled(state.tensions)[model.whole], "N"),
        ("rod forces", state.settled(state.rod_forces), "N"),
        ("rod stresses", _stresses(study), "Pa"),
    ):
        if len(values):
            spread = statistics(values)
            rows.append((name, ", ".join(f"{key} {_number(spread[key], '')}" for key in spread) + f" {unit}"))
    slack = slack_strings(state)
    if model.structure.strings:
        rows.append(("slack strings", f"{len(slack)}: {listed(slack)}" if slack else "none"))
    if study.prestressability is not None:
        rows += [("prestress" if not row else "", line) for row, line in enumerate(study.prestressability.describe())]
    if np.isfinite(state.lowest_stiffness):
        lowest = _number(state.lowest_stiffness, "N/m")
        rows.append(("lowest stiffness", f"{lowest}, of all motions of the nodes but those of the whole at no energy"))
    if study.modes is not None and len(study.modes.squares):
        rows.append(("frequencies", listed(_frequencies(study.modes), 12) + " Hz"))
        rows += [("", line) for line in study.modes.describe()]
    if study.members is not None:
        rows += [("members" if not row else "", line) for row, line in enumerate(_members(study.members))]
    if study.response is not None:
        rows += _along(study.response)
    if study.engine is not None:
        rows.append(("by an engine", study.engine.describe()))
        rows += [("", f"it warns: {warning}") for warning in study.engine.warnings]
    return rows


def _along(response: Response) -> list[tuple[str, str]]:
    path = response.path
    last, most = path.parameters[-1], response.largest_parameter
    rows = [("path", f"{path.end.value}; the parameter is {last:.6g} there, and {most:.6g} at most")]
    for curve in response.curves[:SHOWN]:
        force, moved = _number(float(curve.force[-1]), "N"), _number(float(curve.displacement[-1]), "m")
        end = f"{force}, its node {moved} along it" if curve.is_load else f"{moved}, pushed with {force} along its way"
        rows.append(("at its end", f"{curve.name}: {end}"))
    for critical in path.criticals[:SHOWN]:
        change = critical.unstable_after - critical.unstable_before
        motions = f"{counted(abs(change), 'motion')} {'becomes' if abs(change) == 1 else 'become'}"
        stable = "unstable" if change > 0 else "stable again"
        rows.append(("critical", f"{motions} {stable} at parameter {critical.parameter:.6g}: {critical.kind.value}"))
    for event in response.slack_events[:SHOWN]:
        now = "slack" if event.slack else "taut"
        rows.append(("event", f"'{event.string}' is {now} from parameter {event.parameter:.4g}"))
    if len(response.slack_events) > SHOWN:
        rows.append(("", f"and {len(response.slack_events) - SHOWN} more"))
    first = response.first_violation
    if first is not None:
        rows.append(("beyond a limit", f"from parameter {first.time:.4g}: '{first.member}' by {first.criterion.value}"))
    return rows


def to_dict(study: StaticStudy) -> dict[str, Any]:
    """Everything as plain values."""
    from tensegrity_mj.simulation import versions

    model, state = study.model, study.state
    structure = model.structure
    names = structure.node_names
    data: dict[str, Any] = {
        "format": FORMAT,
        "scene": {"name": model.scene.name, "source": model.scene.source},
        "setup": {
            "rods": (Rods.ELASTIC if np.any(model.compliance > 0) else Rods.RIGID).value,
            "method": study.search.value,
            "gravity": list(model.scene.gravity),
            "loads": {name: force.tolist() for name, force in zip(names, model.loads, strict=True) if np.any(force)},
            "holds": [vars(hold) for hold in model.holds],
            "broken": [s.name for s, k in zip(structure.strings, model.whole, strict=True) if not k],
            "path": study.response is not None,
        },
        "start": {
            "unbalanced": study.start.unbalanced,
            "node": study.start.node,
            "equilibrium": study.start.is_equilibrium,
            "extent": extent(model.scene.nodes0).tolist(),
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
        "versions": versions(),
    }
    return data


def _state(study: StaticStudy, state: StaticState) -> dict[str, Any]:
    structure = study.model.structure
    strings = {"rest_length": study.model.rest_lengths, "length": state.lengths, "tension": state.tensions}
    strings["force_density"] = state.force_densities
    return {
        "parameter": state.parameter,
        "residual": state.residual,
        "steps": state.iterations,
        "stable": state.is_stable,
        "lowest_stiffness": state.lowest_stiffness,
        "moved": study.moved,
        "extent": extent(state.nodes).tolist(),
        "nodes": dict(zip(structure.node_names, state.nodes.tolist(), strict=True)),
        "strings": by_member(structure.strings, strings),
        "rods": by_member(structure.rods, {"length": state.rod_lengths, "force": state.rod_forces}),
        "reactions": {
            name: force.tolist()
            for name, force in zip(structure.node_names, _reactions(state), strict=True)
            if np.any(force)
        },
        "tensions": statistics(state.tensions[study.model.whole]),
        "rod_forces": statistics(state.rod_forces),
        "rod_stresses": statistics(_stresses(study)),
        "slack": slack_strings(state),
    }


def by_member(members: Sequence[Rod] | Sequence[String], columns: Mapping[str, Iterable[Any]]) -> Any:
    """Of every member, what columns have of it by name, as plain values; None for numbers that are not finite."""
    return {
        member.name: {key: _known(plain(x)) for key, x in zip(columns, row, strict=True)}
        for member, *row in zip(members, *columns.values(), strict=True)
    }


def _known(value: Any) -> Any:
    return None if isinstance(value, float) and not np.isfinite(value) else value


def extent(nodes: Array) -> Array:
    """(3,) [m] from the least to the largest coordinate."""
    return np.asarray(nodes.max(axis=0) - nodes.min(axis=0))


def statistics(values: Array) -> dict[str, float]:
    """The least, the median and the largest; nothing of nothing."""
    if not len(values):
        return {}
    return {"min": float(values.min()), "median": float(np.median(values)), "max": float(values.max())}


def slack_strings(state: StaticState) -> list[str]:
    """Names of those without tension, or at the edge of it (`StaticState.at_edge`); what is broken is not slack."""
    model = state.model
    pairs = zip(model.structure.strings, state.slack | state.at_edge, model.whole, strict=True)
    return [string.name for string, slack, whole in pairs if slack and whole]


def _reactions(state: StaticState) -> Array:
    """(N, 3): of what is held; the rest is round-off."""
    held = np.unique(state.model.boundary.rows.indices // 3)
    out = np.zeros_like(state.reactions)
    out[held] = state.reactions[held]
    return out


def _stresses(study: StaticStudy) -> Array:
    if study.members is None:
        return np.zeros(0)
    stresses: Array = study.members.loads.stresses[0]
    known: Array = stresses[np.flatnonzero(np.isfinite(stresses))]
    return known


def _members(check: MemberCheck) -> tuple[str, ...]:
    """Without the slack strings, which have a line of their own, and what is unchecked where that is everything."""
    lines = check.describe()[:-1] if check.slack else check.describe()
    return lines if check.worst is not None else lines[:1]


def _frequencies(modes: Modes) -> list[str]:
    """In Hz; of what grows, its rate."""
    pairs = zip(modes.frequencies.tolist(), modes.growth.tolist(), strict=True)
    return [f"unstable ({growth:.5g} 1/s)" if growth > 0 else f"{frequency:.5g}" for frequency, growth in pairs]


def _moved(study: StaticStudy, state: StaticState) -> str:
    """How far, and the node that moved most."""
    if study.moved <= 1e-12 * state.model.scale[0]:
        return "nowhere: the scene starts there"
    node = int(np.linalg.norm(state.nodes - study.model.scene.nodes0, axis=1).argmax())
    return (
        f"by up to {_number(study.moved, 'm')} (node '{study.model.structure.node_names[node]}') from the scene's start"
    )


def _sizes(nodes: Array) -> str:
    return " x ".join(f"{float(size):.5g}" for size in extent(nodes)) + " m"


def listed(names: Iterable[str], most: int = SHOWN) -> str:
    """The names, so many at most."""
    every = list(names)
    return ", ".join(every[:most]) + (f", ... ({len(every)} in all)" if len(every) > most else "")


def _number(value: float, unit: str) -> str:
    return "-" if np.isnan(value) else f"{value:.5g} {unit}".rstrip()


FORMAT = 1
