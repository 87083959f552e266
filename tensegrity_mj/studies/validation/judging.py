"""How runs of a report came out, and what each of them is judged by."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from tensegrity_mj.runs.judgement import (
    BAD,
    GOOD,
    LIMITED,
    RESTS,
    STILL,
    UNJUDGED,
    Verdict,
    combined,
    in_short,
    judge,
    unjudged,
)
from tensegrity_mj.studies.validation.sections import UNDER_TEST

Data = dict[str, Any]

CONVERGED = 0.05  # part of the way to the target that may be left
MIRRORED = -0.98  # cos of the angle between a rod and its target
STANDING = 0.05  # part of the way to the target that the fastest node would go in another duration
REACHED = ("converged", "at rest")  # the latter where there is no target
STOPPED = ("infeasible", "singular", "diverged")
UNKNOWN = ("completed", "refused", "singular")  # nothing is judged of these: no target, no run, no fault of the law
OUTCOMES = (*REACHED, "off target", "elsewhere", "still moving", "mirrored", "grows", *STOPPED, "failed", *UNKNOWN[:2])
TOLERATED = ("mass", "stiffness", "noise", "delay", "breaks", "gravity")


def judged(
    values: Mapping[str, Any], tolerance: float, duration: float, nominal: Mapping[str, Any] | None = None
) -> str:
    """How a run came out, one of `OUTCOMES`.

    Args:
        values: of `measures.of_run`, or of a run that diverged.
        tolerance: distance from the target that counts as there [m].
        duration: of the run [s].
        nominal: the nominal run in the same engine, which others are held against where there is no target.
    """
    if values["status"] != "completed":
        return str(values["status"])
    if values.get("growth"):
        return "grows"
    if values["error"] is None:
        return _without_target(values, tolerance, nominal)
    if values["error"]["final"] <= tolerance:
        return "converged"
    standing = values["arrival"]["speed"] * duration <= STANDING / CONVERGED * tolerance
    if standing and min(values["arrival"]["alignment"], default=1.0) < MIRRORED:
        return "mirrored"
    return "off target" if standing else "still moving"


def _without_target(values: Mapping[str, Any], tolerance: float, nominal: Mapping[str, Any] | None) -> str:
    rest = values.get("rest")
    if rest is None or (nominal is not None and nominal["outcome"] != "at rest"):
        return "completed"
    slow = rest["last_speed"] <= RESTS * rest["largest_speed"]
    if nominal is None:
        return "at rest" if slow and rest["moved"] > STILL and values["acts"] else "completed"
    if not (slow or rest["moved"] <= STILL):
        return "still moving"
    return "at rest" if _apart(values, nominal) <= tolerance else "elsewhere"


def _apart(values: Mapping[str, Any], nominal: Mapping[str, Any]) -> float:
    """The largest distance of a node at the end from its place at the end of the nominal run [m]."""
    return float(np.linalg.norm(np.subtract(values["end"], nominal["end"]), axis=-1).max(initial=0.0))


def judgement(
    values: Mapping[str, Any],
    outcome: str,
    tolerance: float,
    nominal: Mapping[str, Any] | None = None,
    more: Sequence[str] = (),
) -> Verdict:
    """What a run is judged by; `more` are further doubts, other arguments are those of `judged`."""
    if outcome in ("refused", "singular"):
        return unjudged(f"{outcome}: {values['message']}")
    if outcome in (*STOPPED, "failed"):
        return Verdict(BAD, reason=f"{outcome}: {values['message']}")
    if outcome == "grows":
        return Verdict(BAD, reason=in_short(values["growth"]))
    doubts = [*values["doubts"], *more]
    if values["error"] is None:
        return _judgement_without_target(values, outcome, tolerance, nominal, doubts)
    if outcome == "converged" and not values["acts"]:
        return unjudged("the law never moves a winch, so that it has no part in where the run ends")
    found = judge("the distance from the target at the end is", values["error"]["final"], tolerance, "m", doubts)
    return replace(found, word=LIMITED) if outcome == "still moving" else found


def _judgement_without_target(
    values: Mapping[str, Any], outcome: str, tolerance: float, nominal: Mapping[str, Any] | None, doubts: Sequence[str]
) -> Verdict:
    rest = values["rest"]
    if outcome == "completed" and nominal is not None:
        return unjudged("there is no target, and the nominal run does not come to rest by the law")
    if outcome == "completed":
        slow = rest["last_speed"] <= RESTS * rest["largest_speed"]
        why = "nothing moves" if rest["moved"] <= STILL else "the law never moves a winch" if slow else ""
        return unjudged(f"the scene has no target, and {why or 'the run does not come to rest'}")
    if nominal is None or outcome == "still moving":
        bound = RESTS * rest["largest_speed"]
        found = judge("the fastest node in the last quarter has", rest["last_speed"], bound, "m/s", doubts)
        return replace(found, word=LIMITED) if outcome == "still moving" else found
    return judge("the distance from where the nominal run rests is", _apart(values, nominal), tolerance, "m", doubts)


def sampled(one: Data, tolerance: float) -> Verdict:
    """What sampling is judged by: how far a row of a sampled run is from the run that it is held against."""
    own = Verdict(**one["judgement"])
    if one["outcome"] in (*STOPPED, "failed", "grows"):
        return own
    if one["node_error"] is None:
        return unjudged("there is nothing to compare it with")
    doubts = [own.reason] if own.word == LIMITED and one["outcome"] in REACHED else []
    return judge("the largest node error is", one["node_error"], tolerance, "m", doubts)


def reached(nominal: Mapping[str, Any]) -> bool:
    """Whether a nominal run does what it is meant to, so that what is off in another can be blamed for its end."""
    return nominal["outcome"] in REACHED and nominal["judgement"]["word"] in (GOOD, LIMITED)


def word_of(section: str, part: Mapping[str, Any], nominal: Mapping[str, Any]) -> str:
    """What a section comes to in one engine; of random starts those of the law under test count."""
    if section in TOLERATED and not reached(nominal):
        return UNJUDGED
    if section in ("sampling", "gains") and nominal["outcome"] in (*STOPPED, "failed", "grows"):
        return UNJUDGED
    if section == "gains" and part["trends"]:
        return combined(GOOD if one["shows"] == "yes" else BAD for one in part["trends"])
    rows = [one for one in part["rows"] if UNDER_TEST in one.get("law", UNDER_TEST)]
    return combined(one["judgement"]["word"] for one in rows if not one.get("reference"))
