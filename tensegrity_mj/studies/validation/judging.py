"""Outcomes of a report's runs, and the bounds by which each of them is judged."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from tensegrity_mj.runs import judgement
from tensegrity_mj.runs.judgement import BAD, GOOD, LIMITED, RESTS, STILL, UNJUDGED, Verdict, judge, unjudged
from tensegrity_mj.studies.validation.sections import UNDER_TEST

Data = dict[str, Any]

CONVERGED = 0.05  # part of the way to the target that may be left
MIRRORED = -0.98  # cos of the angle between a rod and its target
STANDING = 0.05  # part of the way to the target that the fastest node would go in another duration
REACHED = ("converged", "at rest")  # the latter where there is no target
STOPPED = ("infeasible", "singular", "diverged")
NO_MEASURE = (*STOPPED, "failed", "grows")  # nothing can be held against such a run
UNKNOWN = ("completed", "refused", "singular")  # nothing is judged of these: no target, no run, no fault of the law
OUTCOMES = (*REACHED, "off target", "elsewhere", "still moving", "mirrored", "grows", *STOPPED, "failed", *UNKNOWN[:2])
TOLERATED = ("mass", "stiffness", "noise", "delay", "breaks", "gravity")


def judged(
    values: Mapping[str, Any],
    tolerance: float,
    duration: float,
    nominal: Mapping[str, Any] | None = None,
    more: Sequence[str] = (),
) -> tuple[str, Verdict]:
    """Return the outcome of a run, one of `OUTCOMES`, and its verdict.

    Args:
        values: of `measures.of_run`, or of a run that diverged.
        tolerance: distance from the target that counts as there [m].
        duration: of the run [s].
        nominal: the nominal run in the same engine, which others are held against where there is no target.
        more: further doubts.
    """
    status = str(values["status"])
    if status in UNKNOWN[1:]:
        return status, unjudged(f"{status}: {values['message']}")
    if status != "completed":
        return status, Verdict(BAD, reason=f"{status}: {values['message']}")
    if values["growth"]:
        return "grows", Verdict(BAD, reason=judgement.in_short(values["growth"]))
    doubts = [*values["doubts"], *more]
    if values["error"] is None:
        return _without_target(values, tolerance, nominal, doubts)
    found = judge("the distance from the target at the end is", values["error"]["final"], tolerance, "m", doubts)
    if found.word != BAD:
        why = "the law never moves a winch, so that it has no part in where the run ends"
        return "converged", found if values["acts"] else unjudged(why)
    if not values["arrival"]["speed"] * duration <= STANDING / CONVERGED * tolerance:
        return "still moving", found if nominal is not None else replace(found, word=LIMITED)
    return "mirrored" if min(values["arrival"]["alignment"], default=1.0) < MIRRORED else "off target", found


def _without_target(
    values: Mapping[str, Any], tolerance: float, nominal: Mapping[str, Any] | None, doubts: Sequence[str]
) -> tuple[str, Verdict]:
    """Judge by rest; a run with something off, by where the nominal one rests."""
    rest, still = values["rest"], values["rest"]["moved"] <= STILL
    bound = RESTS * rest["largest_speed"]
    slow = judge("the fastest node in the last quarter has", rest["last_speed"], bound, "m/s", doubts)
    if nominal is None:
        why = "nothing moves" if still else "the run does not come to rest" if slow.word == BAD else ""
        why = why or ("" if values["acts"] else "the law never moves a winch")
        return ("completed", unjudged(f"the scene has no target, and {why}")) if why else ("at rest", slow)
    if nominal["outcome"] != "at rest":
        return "completed", unjudged("there is no target, and the nominal run does not come to rest by the law")
    if slow.word == BAD and not still:
        return "still moving", slow
    apart = float(np.linalg.norm(np.subtract(values["end"], nominal["end"]), axis=-1).max(initial=0.0))
    found = judge("the distance from where the nominal run rests is", apart, tolerance, "m", doubts)
    return "elsewhere" if found.word == BAD else "at rest", found


def sampled(one: Data, tolerance: float) -> Verdict:
    """Judge a sampled run by how far its row is from the run that it is held against."""
    own = Verdict(**one["judgement"])
    if one["outcome"] in NO_MEASURE:
        return own
    if one["node_error"] is None:
        return unjudged("there is nothing to compare it with")
    doubts = [own.reason] if own.word == LIMITED and one["outcome"] in REACHED else []
    return judge("the largest node error is", one["node_error"], tolerance, "m", doubts)


def reached(nominal: Mapping[str, Any]) -> bool:
    """Return whether a nominal run does what it is meant to, so that its changes can be blamed for another's end."""
    return nominal["outcome"] in REACHED and nominal["judgement"]["word"] in (GOOD, LIMITED)


def word_of(section: str, part: Mapping[str, Any], nominal: Mapping[str, Any]) -> str:
    """Return the verdict on a section in one engine; of random starts, those of the law under test count."""
    unknown = section in TOLERATED and not reached(nominal)
    if unknown or (section in ("sampling", "gains") and nominal["outcome"] in NO_MEASURE):
        return UNJUDGED
    if section == "gains" and part["trends"]:
        return judgement.combined(GOOD if one["shows"] == "yes" else BAD for one in part["trends"])
    rows = [one for one in part["rows"] if UNDER_TEST in one.get("law", UNDER_TEST)]
    return judgement.combined(one["judgement"]["word"] for one in rows if not one.get("reference"))
