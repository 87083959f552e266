"""Data of the report, from its runs: rows by section and engine, trends, and sentences that a user can act on."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from itertools import pairwise
from typing import Any

import numpy as np

from tensegrity_mj.basics.files import table_beside
from tensegrity_mj.basics.units import quantity
from tensegrity_mj.dynamics.target import target_nodes
from tensegrity_mj.engines.reports import DECAY_WARNING
from tensegrity_mj.model.actuation import Mode
from tensegrity_mj.model.scene import Scene
from tensegrity_mj.studies.plain import value_at
from tensegrity_mj.studies.validation import judging
from tensegrity_mj.studies.validation.judging import OUTCOMES, Data, summary, title
from tensegrity_mj.studies.validation.sections import SECTIONS, Case, Setup
from tensegrity_mj.studies.workers import DONE

SAME = 1e-9  # part of the structure's size: nodes that are not farther apart are at the same place
TREND = 0.01  # part by which a quantity must change to have a trend

TABLE = table_beside(__file__)
STATEMENTS = TABLE["statements"]  # of §5.6


def findings(setup: Setup, pairs: Sequence[tuple[Case, Mapping[str, Any]]]) -> Data:
    """The sections of the report from each case and its outcome."""
    nominal = {case.point["engine"]: outcome for case, outcome in pairs if case.section == "nominal"}
    # What counts as there: 5 % of the way, or twice what a nominal run has left, if that has come so near itself.
    near = judging.CONVERGED * way(setup.scene, setup.duration)
    ended = [one["values"] for one in nominal.values() if one["status"] == DONE]
    finals = [values["error"]["final"] for values in ended if values.get("error")]
    tolerance = max([near, *(2 * final for final in finals if final <= near)])
    found: Data = {"tolerance": tolerance, "nominal": _nominal(setup, nominal, tolerance)}
    for section in SECTIONS:
        chosen = [pair for pair in pairs if pair[0].section == section]
        if section == "nominal" or not chosen:
            continue
        found[section] = {}
        for engine in setup.engines:
            own = [(case, outcome) for case, outcome in chosen if case.point["engine"] == engine]
            beside = found["nominal"]["engines"][engine]
            rows = [row(setup, case, outcome, tolerance, beside) for case, outcome in own]
            part: Data = {"rows": rows}
            if section == "sampling":
                part |= _sampling(rows, [outcome for _, outcome in own], tolerance)
            elif section == "gains":
                part["trends"] = trends(rows)
            elif section == "starts":
                part["fractions"] = _fractions(rows)
            found[section][engine] = part | {"word": judging.word_of(section, part, beside)}
    if "starts" in found and len(setup.engines) > 1:
        found["starts_that_differ"] = _differing(found["starts"])
    sentences = summary(setup, found)
    found["summary"] = [sentence for _, sentence in sentences]
    found["summary_sections"] = [section for section, _ in sentences]
    return found


def row(
    setup: Setup, case: Case, outcome: Mapping[str, Any], tolerance: float, nominal: Mapping[str, Any] | None = None
) -> Data:
    """One run in a table: what it was, how it ended, what it is judged by, and its main numbers."""
    values = _values(outcome)
    ended, verdict = judging.judged(values, tolerance, setup.duration, nominal)
    base: Data = {"label": case.label, **case.facts, "outcome": ended, "judgement": asdict(verdict)}
    base |= {"end_time": values["end_time"], "message": values["message"]}
    # None for each that the run has not: one that diverged has none.
    base |= {name: value_at(values, keys) for name, keys in TABLE["numbers"].items()}
    return base | ({"decay_error": None} if value_at(values, ("lyapunov", "promised_rate")) is None else {})


def _values(outcome: Mapping[str, Any]) -> Mapping[str, Any]:
    """The measures of a run; of one that failed, why."""
    if outcome["status"] == DONE:
        return dict(outcome["values"])
    return {"status": "failed", "message": f"{outcome['error']}: {outcome['reason']}", "end_time": None}


def way(scene: Scene, duration: float) -> float:
    """The largest distance [m] of a node at the start from its target at the end; the structure's size if it is 0."""
    size = float(np.max(np.ptp(scene.nodes0, axis=0)))
    if scene.target is None:
        return size
    aims = target_nodes(scene.structure, scene.target, np.array([duration]))[0]
    largest = float(np.max(np.linalg.norm(scene.nodes0 - aims, axis=-1)))
    return largest if largest > SAME * size else size


def _nominal(setup: Setup, nominal: Mapping[str, Mapping[str, Any]], tolerance: float) -> Data:
    found: Data = {}
    samples = {}
    for engine, outcome in nominal.items():
        values = dict(_values(outcome))
        samples[engine] = values.pop("kept", None)
        series = {key: item for key, item in (samples[engine] or {}).items() if key != "nodes"}
        ended, _ = judging.judged(values, tolerance, setup.duration)
        found[engine] = {"outcome": ended, **values} | ({} if ended == "failed" else {"series": series})
    engines = [engine for engine in found if samples.get(engine)]
    differences = [
        {"engines": [a, b], "node_error": node_error(samples[a], samples[b])}
        for number, a in enumerate(engines)
        for b in engines[number + 1 :]
    ]
    for engine, one in found.items():
        others = _disagreements(engine, found, differences, tolerance)
        one["judgement"] = asdict(judging.judged(one, tolerance, setup.duration, None, others)[1])
    return {"engines": found, "differences": differences}


def _disagreements(engine: str, found: Data, differences: Sequence[Data], tolerance: float) -> list[str]:
    """Other engines in which the nominal run ends in another way, or farther away than what counts as there."""
    own = found[engine]["outcome"]
    others = [
        f"{title(name)}: {one['outcome']}"
        for name, one in found.items()
        if one["outcome"] not in (own, *judging.UNKNOWN)
    ]
    for one in differences:
        if engine in one["engines"] and not (one["node_error"] or 0.0) <= tolerance:
            other = next(name for name in one["engines"] if name != engine)
            others.append(
                f"{title(other)} is {quantity(one['node_error'], 'm', 2)} away, more than {quantity(tolerance, 'm', 2)}"
            )
    return others


def node_error(first: Mapping[str, Any] | None, second: Mapping[str, Any] | None) -> float | None:
    """The largest distance of a node in two runs at the times that both kept [m]."""
    if first is None or second is None:
        return None
    count = min(len(first["times"]), len(second["times"]))
    if not count:
        return None
    a, b = np.array(first["nodes"][:count]), np.array(second["nodes"][:count])
    return float(np.max(np.linalg.norm(a - b, axis=-1), initial=0.0))


def _sampling(rows: list[Data], outcomes: Sequence[Mapping[str, Any]], tolerance: float) -> Data:
    """Compute node errors against the continuous run, or without one, the finest period of the same mode.

    The run that the others are held against has none.
    """
    samples = [outcome.get("values", {}).get("kept") for outcome in outcomes]
    continuous = next((i for i, one in enumerate(rows) if one["mode"] == Mode.CONTINUOUS.value), None)
    for number, one in enumerate(rows):
        at = continuous
        if at is None:
            alike = [i for i, other in enumerate(rows) if other["mode"] == one["mode"] and samples[i]]
            at = min(alike, key=lambda i: rows[i]["period"], default=None)
        one["reference"] = at == number
        one["node_error"] = None if at is None or at == number else node_error(samples[number], samples[at])
    for one in rows:
        one["judgement"] = asdict(judging.sampled(one, tolerance))
    return {"reference": "continuous" if continuous is not None else "the finest period of the mode"}


def trends(rows: Sequence[Data]) -> list[Data]:
    """Test the thesis' statements on gains (§5.6): yes, no, mixed, none (nothing changes by more than 1 %)."""
    found = []
    for gain, measured, sign, words in STATEMENTS:
        own = [one for one in rows if one["gain"] == gain and one["outcome"] not in judging.NO_MEASURE]
        own.sort(key=lambda one: one["factor"])
        values, factors = ([one[key] for one in own] for key in (measured, "factor"))
        if len(values) > 1:
            verdict = trend(values, sign, unsettled=measured.startswith("settling"))
            found.append(
                {
                    "gain": gain,
                    "quantity": measured,
                    "statement": words,
                    "shows": verdict,
                    "factors": factors,
                    "values": values,
                }
            )
    return found


def trend(values: Sequence[float | None], sign: int, unsettled: bool = False) -> str:
    """Return whether values change in the direction of the sign; None for "never settled" is larger than any."""
    numbers = [math.inf if value is None and unsettled else value for value in values]
    if any(number is None for number in numbers):
        return "unknown"
    steps = [_step(float(a), float(b)) for a, b in pairwise(numbers)]  # type: ignore[arg-type]
    ups, downs = steps.count(sign), steps.count(-sign)
    if not ups and not downs:
        return "none"
    return "mixed" if ups and downs else "yes" if ups else "no"


def _step(a: float, b: float) -> int:
    if a == b or abs(b - a) <= TREND * max(abs(a), abs(b)) < math.inf:
        return 0
    return 1 if b > a else -1


def _fractions(rows: Sequence[Data]) -> list[Data]:
    """Count how the starts of each law, or of each amplitude, ended."""
    key = "law" if rows and "law" in rows[0] else "amplitude"
    found = []
    for group in dict.fromkeys(one[key] for one in rows):
        own = [one for one in rows if one[key] == group]
        counts = Counter(one["outcome"] for one in own)
        outcomes = {name: counts[name] for name in OUTCOMES if counts[name]}
        known = [one for one in own if one["outcome"] not in judging.UNKNOWN]
        part = sum(counts[name] for name in judging.REACHED) / len(known) if known else None
        fraction = {key: group, "starts": len(own), "judged": len(known), "converged": part}
        found.append(fraction | {"kept": _kept(known), "outcomes": outcomes})
    return found


def _kept(rows: Sequence[Data]) -> float | None:
    """The part of the runs that converge and whose V follows its promise all the way; None where none is promised.

    Steps of fixed length may pass a singularity that the law cannot: V leaves its promise there.
    """
    if all(one["decay_error"] is None for one in rows):
        return None
    return sum(one["outcome"] in judging.REACHED and not left_promise(one) for one in rows) / len(rows)


def left_promise(one: Data) -> bool:
    """Return whether V of a row differs from its predicted decay by more than 1 %."""
    return (one["decay_error"] or 0.0) > DECAY_WARNING


def _differing(starts: Mapping[str, Any]) -> list[Data]:
    """Return the starts that end differently in two engines."""
    engines = list(starts)
    found = []
    for parts in zip(*(starts[engine]["rows"] for engine in engines), strict=True):
        outcomes = {engine: one["outcome"] for engine, one in zip(engines, parts, strict=True)}
        if len(set(outcomes.values())) > 1:
            found.append({"label": parts[0]["label"], "outcomes": outcomes})
    return found
