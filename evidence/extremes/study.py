"""The study of extremes: many runs, and what they come to as data, a page and sentences."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Unpack

from evidence.extremes.kinds import Kind
from evidence.extremes.task import run_extreme
from evidence.extremes.verdicts import Verdict
from tensegrity_mj.basics.checks import whole
from tensegrity_mj.basics.texts import aligned
from tensegrity_mj.errors import OptionError
from tensegrity_mj.pictures.findings import Finding, Judgement, Mark
from tensegrity_mj.pictures.page import Section, Table
from tensegrity_mj.studies.many import RunOptions, run_study
from tensegrity_mj.studies.report import Page, Report, runs_in

FORMAT = 1
PAGE = "extremes.html"  # what a folder holds
EXPENSIVE = (Kind.LONG, Kind.LARGE)
ONE_IN = 250  # of the expensive kinds
# Limits that must hold, as parts of all runs.
LEAST_RIGHT, MOST_FALSE_REFUSALS = 0.6, 0.05
MEANINGS = {
    Verdict.UNDETECTED: "Completed without a warning and wrong, a traceback, NaN, or a message that does not help.",
    Verdict.UNJUDGED: "Completed without a warning; no reference is accurate enough to judge by.",
    Verdict.WARNED: "Completed, and the run says that it is not to be trusted: by a warning, or because its error "
    "estimate does not settle or is larger than 5 % of the way that the nodes went.",
    Verdict.STOPPED: "Stopped on the way, with time, cause and remedy.",
    Verdict.REFUSED: "Refused before the first step, with cause and remedy.",
}
COLUMNS = {
    "number": "run",
    "kind": "kind",
    "engine": "engine",
    "step": "step [s]",
    "tolerance": "tolerance",
    "facts": "drawn",
    "bound": "own bound [m]",
    "error": "error [m]",
    "cause": "cause",
}


@dataclass(frozen=True, eq=False)
class Extremes(Report):
    """A finished study; evidence/docs/extremes.md explains the keys of its `data`."""

    NAME = "extremes"

    @property
    def passed(self) -> bool:
        """True where nothing is undetected, enough is right, and little is refused without need."""
        return bool(self.data["passed"])

    @property
    def text(self) -> str:
        """The table, for a terminal."""
        table = [list(self.data["table"][0]), *(list(row.values()) for row in self.data["table"])]
        return "\n".join(aligned(table, numbers=True))

    @property
    def judgement(self) -> Judgement:
        """Judgement of how many runs were wrong without a warning, refused without need, and hidden."""
        data, total = self.data, self.data["table"][-1]
        wrong = total["undetected"]
        headline = (
            f"{wrong or 'None'} of {total['runs']} extreme runs {'was' if wrong < 2 else 'were'} wrong without a "
            f"warning; {total['right']} were right."
        )
        marks = (
            Mark.BAD if wrong else Mark.GOOD if data["passed"] else Mark.LIMITED,
            Mark.LIMITED if total["refused without need"] else Mark.GOOD,
            Mark.LIMITED if total["hidden"] else Mark.GOOD,
        )
        return Judgement(headline, tuple(map(Finding, marks, data["summary"])))

    def page(self) -> Page:
        """Make the page of outcomes, by kind and by engine, with every run that is not right."""
        data, setup = self.data, self.data["setup"]
        tables = [_counts("By kind", data["table"]), _counts("By engine", data["by_engine"])]
        sections = [Section("What came of them", (), tables)]
        for verdict, meaning in MEANINGS.items():
            found = [one for one in data["results"] if one["verdict"] == verdict.value]
            sections.append(Section(f"{verdict.value}: {len(found)}", [meaning], [_runs(found)] if found else []))
        how = " MuJoCo stepped by hand with its autoreset on (the test of the test)." if setup["autoreset"] else ""
        introduction = f"Runs at the extremes, drawn at random with seed {setup['seed']}, each judged.{how}"
        return Page(f"{setup['runs']} extreme runs", introduction, self.judgement, sections)


def mixture(runs: int, kinds: Sequence[Kind]) -> list[Kind]:
    """The kind of each run: the expensive ones few and first, all others in turn."""
    few = [kind for kind in kinds if kind in EXPENSIVE]
    others = [kind for kind in kinds if kind not in EXPENSIVE]
    if not others:
        return [few[n % len(few)] for n in range(runs)]
    first = [kind for kind in few for _ in range(runs // ONE_IN)]
    return first + [others[n % len(others)] for n in range(runs - len(first))]


def extremes(
    runs: int = 1000,
    seed: int = 0,
    *,
    kinds: Sequence[Kind] | None = None,
    autoreset: bool = False,
    folder: str | os.PathLike[str] | None = None,
    **how: Unpack[RunOptions],
) -> Extremes:
    """Draw extreme runs at random, make them and judge each.

    Args:
        runs: how many.
        seed: of everything drawn; run `n` depends on the seed, on n and on its kind alone.
        kinds: of `Kind`; all by default.
        autoreset: the test of the test: MuJoCo is stepped as by a script of one's own, with its autoreset on.
        folder: where extremes.json, extremes.html and finished runs are kept, so that the same call goes on.
        how: workers and progress, see `run_many`.

    Raises:
        OptionError: for options out of range.
    """
    runs, seed = whole("runs", runs, 1), whole("seed", seed, 0)
    chosen = list(dict.fromkeys(Kind if kinds is None else kinds))
    if not chosen:
        raise OptionError(f"kinds: name at least one of {', '.join(kind.name.lower() for kind in Kind)}")
    points = [{"number": number, "kind": kind.name} for number, kind in enumerate(mixture(runs, chosen))]
    common = {"seed": seed, "autoreset": autoreset}
    study = run_study(run_extreme, points, runs_in(folder), "extreme runs", how, common)
    results = [{**point, **row} for point, row in zip(points, study.rows(_lost), strict=True)]
    data = {
        "format": FORMAT,
        "setup": {"runs": runs, **common, "kinds": [kind.name.lower() for kind in chosen]},
        "versions": study.identity["versions"],
        **conclusions(results, chosen),
        "results": results,
    }
    return Extremes(data, seconds=study.seconds).kept(folder)


def _lost(outcome: dict[str, Any]) -> dict[str, Any]:
    """Return the outcome of a task that failed, or whose process died: a failure that nobody detected."""
    cause = f"the study's own task failed: {outcome['error']}: {outcome['reason']}"
    return {"engine": "none", "facts": {}, "verdict": Verdict.UNDETECTED.value, "cause": cause}


def conclusions(results: Sequence[dict[str, Any]], kinds: Sequence[Kind]) -> dict[str, Any]:
    """The table by kind, the sums, sentences, and whether what must hold does."""
    table = [_row(kind.value, [one for one in results if one["kind"] == kind.name]) for kind in kinds]
    engines = sorted({one["engine"] for one in results})
    by_engine = [_row(engine, [one for one in results if one["engine"] == engine]) for engine in engines]
    total = _row("all", results)
    runs = len(results)
    false, right = total["refused without need"], total["right"]
    passed = total["undetected"] == 0 and right >= LEAST_RIGHT * runs and false <= MOST_FALSE_REFUSALS * runs
    summary = [
        f"{runs} runs: {right} right ({right / runs:.1%}; at least {LEAST_RIGHT:.0%} wanted), "
        f"{total['undetected']} wrong without a warning (0 wanted), {total['unjudged']} without a reference.",
        f"{total['warned']} warned of, {total['stopped']} stopped, {total['refused']} refused; {false} "
        f"({false / runs:.1%}; at most {MOST_FALSE_REFUSALS:.0%} wanted) of these although a tight DAE completes them.",
        f"Without an estimate of the error {total['hidden']} runs would have been plainly wrong without a warning.",
    ]
    return {"table": [*table, total], "by_engine": by_engine, "summary": summary, "passed": passed}


def _row(name: str, results: Sequence[dict[str, Any]]) -> dict[str, Any]:
    counts = Counter(one["verdict"] for one in results)
    return {
        "name": name,
        "runs": len(results),
        **{verdict.value: counts[verdict.value] for verdict in Verdict},
        "by the estimate alone": sum(bool(one.get("said by the estimate alone")) for one in results),
        "refused without need": sum(bool(one.get("false refusal")) for one in results),
        "hidden": sum(bool(one.get("hidden without the estimate")) for one in results),
    }


def _counts(title: str, rows: Sequence[dict[str, Any]]) -> Table:
    first, *others = rows[0]
    return Table.of(title, {first: "", **{head: head for head in others}}, rows, folded=len(rows) > 8)


def _runs(found: Sequence[dict[str, Any]]) -> Table:
    runs = [{**one, "kind": Kind[one["kind"]].value} for one in found]
    return Table.of("Each of them", COLUMNS, runs, folded=len(found) > 20)
