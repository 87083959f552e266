"""The study as one self-contained HTML page, made of its data alone."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Any

from tensegrity_mj.basics.texts import shortened
from tensegrity_mj.basics.units import quantity
from tensegrity_mj.pictures.findings import Finding, Judgement, Mark
from tensegrity_mj.pictures.page import Picture, Section, Table
from tensegrity_mj.runs.judgement import in_short, judge
from tensegrity_mj.studies.report import Page
from tensegrity_mj.studies.tradeoff import advising
from tensegrity_mj.studies.tradeoff.figure import Cost, diagram, has_diagram
from tensegrity_mj.studies.tradeoff.reference import SURE

Data = Mapping[str, Any]

COLUMNS = {
    "family": "engine",
    "knob": "step or tolerance",
    "error": "largest error [m]",
    "final_error": "error at the end [m]",
    "wall_time": "wall time [s]",
    "real_time_factor": "x real time",
    "steps": "steps",
    "evaluations": "right-hand sides",
    "megabytes": "memory [MB]",
    "remark": "remark",
}
USUAL = 1e-6  # m, the accuracy that the verdict is about
MOST_LETTERS = 160  # of a reason


def page_of(data: Data) -> Page:
    """The page of a study's data."""
    scene = data["scene"]
    members = ", ".join(f"{kind}: {scene[kind]}" for kind in ("rods", "bodies", "strings") if scene.get(kind))
    introduction = (
        f"{scene['name']} ({members}). Errors are the largest distance of a node from where the reference has it, at "
        "the recorded times: of the same experiment, solved tightly. What holding a control does to the motion is the "
        "modelling floor, the distance of a held experiment's reference from the continuous law's. Wall times are the "
        "smallest of several runs on one machine, without compiling and loading."
    )
    title = f"Speed against accuracy: {scene['name']}"
    return Page(title, introduction, judgement_of(data), _sections(data))


def judgement_of(data: Data) -> Judgement:
    """The fastest setting, and how sure each reference is."""
    return Judgement(_verdict(data), tuple(_findings(data)))


def _verdict(data: Data) -> str:
    """What is fastest for a usual accuracy of the first experiment that has advice."""
    for _, timing in advising.with_timing(data):
        advice = [one for one in timing["advice"] if one["text"]]
        if advice:
            one = min(advice, key=lambda one: abs(math.log(one["tolerance"] / USUAL)))
            best = advising.advice_alone(one)
            return f"For errors of at most {quantity(one['tolerance'], 'm')} here: {best}."
    return f"No setting of {data['scene']['name']} is advised: see each experiment."


def _findings(data: Data) -> Iterator[Finding]:
    """How sure each experiment's reference is, and what holding a control costs."""
    for experiment, timing in advising.with_timing(data):
        reference, title = experiment["reference"], experiment["title"]
        head = title[:1].upper() + title[1:]
        if reference["engine"] is None:
            yield Finding(Mark.BAD, f"{head}: no reference ({reference['reason']}).")
            continue
        second, allowed = reference["second_formulation"], SURE * (reference["motion"] or 0.0)
        error = math.inf if reference["own_error"] is None else reference["own_error"]
        own = f", known to {quantity(error, 'm', 2)} (allowed {quantity(allowed, 'm', 2)})"
        confirmed = "no second formulation confirms it" if second is None else f"{second['engine']} confirms it"
        if error > allowed:
            confirmed = "too little to measure errors against"
        found = judge(
            "own error", error, allowed, "m", [*([confirmed] if second is None else []), *reference["doubts"]]
        )
        doubt = f"; it is in doubt: {in_short(reference['doubts'])}" if reference["doubts"] else ""
        yield Finding(Mark(found.word), f"{head}{own}: {confirmed}{doubt}.")
        if timing["floor"] is not None:
            yield Finding(Mark.UNJUDGED, f"{timing['floor'][:1].upper()}{timing['floor'][1:]}.")


def _sections(data: Data) -> Iterator[Section]:
    if has_diagram(data):
        pictures = [
            Picture(diagram(data, Cost.WALL_TIME), "Error against wall time"),
            Picture(diagram(data, Cost.RIGHT_HAND_SIDES), "Error against right-hand sides: the same on any machine"),
        ]
        yield Section("Work and precision", (), pictures)
    yield Section("What to use", (), list(_advice(data)))
    for experiment, timing in advising.with_timing(data):
        run = f"{experiment['duration']:g} s, recorded each {experiment['interval']:g} s."
        parts = [Table("Reference", ("", ""), _reference(experiment))]
        if experiment["reference"]["engine"] is not None:
            title = f"All {len(experiment['points'])} settings"
            parts.append(Table.of(title, COLUMNS, rows(experiment, timing), folded=True))
        text = [run, *advising.remarks(experiment, data["scene"].get("duration", experiment["duration"]))]
        yield Section(experiment["title"][:1].upper() + experiment["title"][1:], text, parts)
    versions = [[name, value] for name, value in data["versions"].items()]
    options = [[name.replace("_", " "), value] for name, value in data["options"].items()]
    yield Section(
        "How it was run",
        (),
        [Table("Options", ("", ""), options, folded=True), Table("Versions", ("", ""), versions, folded=True)],
    )


def _advice(data: Data) -> Iterator[Table]:
    floors = []
    for experiment, timing in advising.with_timing(data):
        if timing["floor"] is not None:
            floors.append((experiment["title"], timing["floor"].partition(": ")[2]))
            continue
        facts = advising.advice_rows(experiment, timing)
        title = experiment["title"][:1].upper() + experiment["title"][1:]
        yield Table(title, advising.ADVICE, facts, "" if facts else advising.why_none(experiment))
    if floors:
        yield Table("Held controls", ("", "what no smaller step cures, and what is fine enough"), floors)


def _reference(experiment: Data) -> list[tuple[str, object]]:
    reference, floor = experiment["reference"], experiment["modelling_floor"]
    facts: list[tuple[str, object]] = [("reference", reference["engine"] or f"none: {reference['reason']}")]
    if reference["engine"] is not None:
        looser, second = reference["looser"], reference["second_formulation"]
        facts += [
            ("largest motion of a node [m]", reference["motion"]),
            ("its own error, at most about [m]", reference["own_error"]),
            (f"difference from {looser['engine']} [m]", looser["difference"]),
        ]
        if second is None:
            facts.append(("second formulation", "none that can do this"))
        else:
            facts.append((f"difference from {second['engine']} [m]", second["difference"]))
    if floor is not None:
        distance = floor["reason"] if floor["distance"] is None else floor["distance"]
        facts.append(("modelling floor: distance from the continuous law's motion [m]", distance))
        facts.append(("the same at the end [m]", floor["final_distance"]))
    return facts


def rows(experiment: Data, timing: Data) -> list[Data]:
    """The table of all settings; a family that is refused for one reason throughout is one row."""
    found: list[Data] = []
    for one, clocked in zip(experiment["points"], timing["points"], strict=True):
        if one["status"] == "refused":
            row: Data = {"family": one["family"], "knob": "", "remark": remark(one)}
            if row not in found:
                found.append(row)
            continue
        wall = clocked["wall_time"] if one["error"] is not None else None
        memory = None if one["memory"] is None else one["memory"] / 1e6
        found.append({**one, **clocked, "wall_time": wall, "megabytes": memory, "remark": remark(one)})
    return found


def remark(point: Data) -> str:
    """What a point's numbers alone do not show."""
    if point["error"] is None:
        return f"{point['status']}: {shortened(point['reason'], MOST_LETTERS)}"
    notes = ["at the reference's floor"] if point["at_reference_floor"] else []
    if not point["repeatable"]:
        notes.append("not the same at each run")
    return ", ".join(notes)
