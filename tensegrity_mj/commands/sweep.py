"""Simulate a scene many times: over values of any parameter, or random draws. Goes on where it was stopped."""

from __future__ import annotations

import argparse
import json
import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tensegrity_mj import controllers, studies
from tensegrity_mj.basics.texts import aligned
from tensegrity_mj.commands.common import Outcome, table
from tensegrity_mj.errors import OptionError

if TYPE_CHECKING:
    from tensegrity_mj.studies.sweep import Row

MOST_LINES = 40


def execute(options: argparse.Namespace) -> Outcome:
    """Run the sweep, or go on with it, and report the results."""
    vary = [_vary(text, "--vary") for text in options.vary]
    zipped = [[_vary(text, "--zip") for text in group] for group in options.zip]
    own = [(f"law.{name}", value) for name, value in options.law_option or ()]
    own += [("law", "none")] if options.law == "none" else []
    draws, fixed = [_draw(text) for text in options.draw], dict([*map(_set, options.set), *own])
    if len(fixed) < len(options.set) + len(own):
        raise OptionError("--set, --law-option: a parameter is given twice; give each parameter once")
    if options.cluster is not None and options.backend is not None:
        raise OptionError("--backend and --cluster: give one of them")
    place = "cluster" if options.cluster is not None else (options.backend or "processes").replace("-", " ")
    workers = studies.Workers(options.workers, studies.Backend(place), options.cluster)

    from tensegrity_mj.studies.page import judgement_of
    from tensegrity_mj.studies.sweep import USUAL, check_measures, counts, rows_of

    measures = check_measures(options.measures.split(",") if options.measures is not None else USUAL)
    sweep = studies.Sweep(
        options.scene,
        axes=[*vary, *(studies.Together(group) for group in zipped)],
        draws=draws,
        samples=1 if options.samples is None else options.samples,
        seed=options.seed,
        fixed=fixed,
        law=options.law or controllers.SCENE_LAW,
        keep_trajectories=options.keep_trajectories,
    )
    study = sweep.run(options.out, workers=workers, progress=True)
    page = None
    if options.out is not None:
        page = studies.write_sweep_page(Path(options.out) / "index.html", sweep, study, measures)
    rows = rows_of(study)
    data = {
        "status": "completed",
        "scene": sweep.scene.name,  # type: ignore[union-attr]
        "points": len(rows),
        "computed": study.computed,
        "ended": counts(rows),
        "folder": options.out,
        "result": None if options.out is None else Path(options.out) / "result.json",
        "page": page,
        "outcomes": study.to_dict()["points"],
    }
    text = describe(data, rows, sweep.parameters, measures)
    return Outcome(data, text, judgement=judgement_of(sweep, study, measures))


def describe(data: dict[str, Any], rows: Sequence[Row], parameters: Sequence[str], measures: Sequence[str]) -> str:
    from tensegrity_mj.studies.sweep import parameter_label, shown

    heads = ["", *map(parameter_label, parameters), "status", *(name.replace("_", " ") for name in measures)]
    lines = [heads]
    for number, row in enumerate(rows[:MOST_LINES]):
        cells = [shown(row.values.get(name)) if row.values else "-" for name in measures]
        lines.append([str(number), *(shown(row.parameters[name]) for name in parameters), row.status, *cells])
    text = aligned(lines)
    if len(rows) > MOST_LINES:
        text.append(f"... and {len(rows) - MOST_LINES} more points")
    reasons = dict.fromkeys(row.reason for row in rows if row.reason)
    text += [f"why not completed, or in doubt: {reason}" for reason in list(reasons)[:5]]
    facts = [("points", ", ".join(f"{count} {status}" for status, count in data["ended"].items()))]
    facts.append(("computed now", str(data["computed"])))
    facts += [(name, str(data[name])) for name in ("result", "page") if data[name]]
    return "\n".join([*text, "", table(facts)])


# Values --------------------------------------------------------------------------------------------------------


def _assignment(text: str, option: str) -> tuple[str, str]:
    path, sign, value = text.partition("=")
    if not sign or not path.strip() or not value.strip():
        raise OptionError(f"{option} {text}: write PATH=VALUE, for example law.decay_rate=0.5")
    return path.strip(), value.strip()


def _set(text: str) -> tuple[str, Any]:
    path, value = _assignment(text, "--set")
    return path, value_of(value)


def _vary(text: str, option: str) -> studies.Vary:
    path, values = _assignment(text, option)
    return studies.Vary(path, values_of(values, f"{option} {text}"))


def _draw(text: str) -> studies.Draw:
    path, given = _assignment(text, "--draw")
    scaled = given.startswith("*")
    name, _, rest = given.removeprefix("*").partition(":")
    two = {"uniform": "Uniform", "loguniform": "LogUniform", "normal": "Normal"}
    if name == "choice" and rest:
        return studies.Draw(path, studies.Choice([value_of(item) for item in split(rest)]), scaled)
    numbers = rest.split(":")
    if name not in two or len(numbers) != 2:
        raise OptionError(
            f"--draw {text}: allowed after = are uniform:LOW:HIGH, loguniform:LOW:HIGH, normal:MEAN:DEVIATION and "
            "choice:A,B,C, with * before them for factors"
        )
    first, second = (_number(number, f"--draw {text}: number") for number in numbers)
    return studies.Draw(path, getattr(studies, two[name])(first, second), scaled)


def values_of(text: str, what: str) -> list[Any]:
    """Return the values of --vary: a list with commas, or a range; raise OptionError for a range that is none."""
    scaled = text.startswith("*")
    kind, _, rest = text.removeprefix("*").partition(":")
    if kind not in ("linear", "log"):
        return [value_of(item) for item in split(text)]
    parts = rest.split(":")
    if len(parts) != 3 or not parts[2].isdigit() or int(parts[2]) < 2:
        raise OptionError(f"{what}: write {kind}:FROM:TO:COUNT with a count of at least 2")
    first, last = (_number(part, f"{what}: end") for part in parts[:2])
    if kind == "log" and not (first > 0 and last > 0):
        raise OptionError(f"{what}: both ends of a logarithmic range must be > 0")
    count = int(parts[2])
    steps = [number / (count - 1) for number in range(count - 1)]
    found = [first + (last - first) * step if kind == "linear" else first * (last / first) ** step for step in steps]
    found.append(last)
    return [value_of(f"*{value!r}") for value in found] if scaled else found


def _number(text: str, what: str) -> float:
    from tensegrity_mj.basics.checks import finite

    return finite(what, value_of(text))


def value_of(text: str) -> Any:
    """One value: *factor, a number, JSON, or a word."""
    from tensegrity_mj.studies.parameter_values import decoded

    text = text.strip()
    if text.startswith("*"):
        return decoded(text)
    try:
        value = json.loads(text, parse_constant=str)
    except ValueError:
        value = text
    if isinstance(value, str):
        try:
            number = float(text)
        except ValueError:
            return value
        return number if math.isfinite(number) else text
    return value


def split(text: str) -> list[str]:
    """The parts between commas that stand outside brackets and quotes."""
    parts, depth, quoted = [""], 0, False
    for letter in text:
        quoted ^= letter == '"'
        depth += (letter in "[{") - (letter in "]}") if not quoted else 0
        if letter == "," and depth == 0 and not quoted:
            parts.append("")
        else:
            parts[-1] += letter
    return parts
