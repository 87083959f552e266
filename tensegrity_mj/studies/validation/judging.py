"""Outcomes of a report's runs, the bounds by which each of them is judged, and the findings in sentences."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from tensegrity_mj.basics.units import quantity
from tensegrity_mj.engines.table import ENGINES
from tensegrity_mj.model.actuation import Mode
from tensegrity_mj.runs import judgement
from tensegrity_mj.runs.judgement import BAD, GOOD, LIMITED, RESTS, STILL, UNJUDGED, Verdict, in_short, judge, unjudged
from tensegrity_mj.studies.validation.sections import SECTIONS, UNDER_TEST, Setup

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


def title(engine: str) -> str:
    return ENGINES[engine].title


def summary(setup: Setup, found: Data) -> list[tuple[str, str]]:
    """Summarise the report in sentences with their sections; of the first engine, and where another one differs."""
    engine = setup.engines[0]
    nominal = [_nominal_sentence(setup, found, engine), *_winch_sentences(found, engine)]
    sentences = [("nominal", sentence) for sentence in nominal]
    makers = {
        "sampling": _sampling_sentences,
        "gains": _gain_sentences,
        "mass": _plant_sentences,
        "stiffness": _plant_sentences,
        "noise": _noise_sentences,
        "delay": _delay_sentences,
        "breaks": _break_sentences,
        "gravity": _gravity_sentences,
        "starts": _start_sentences,
    }
    # What is off can only be blamed where the run does what it should without it.
    one = found["nominal"]["engines"][engine]
    for section, maker in makers.items():
        if section in found and found[section][engine]["word"] == UNJUDGED:
            sentences.append((section, _unjudged_sentence(section, found[section][engine], one)))
        elif section in found:
            mine = maker(setup, section, _judged(section, found[section][engine]))
            others = [
                name
                for name in setup.engines[1:]
                if maker(setup, section, _judged(section, found[section][name])) != mine
            ]
            sentences += [(section, sentence) for sentence in (*mine, *_doubts(found[section][engine]))]
            if others and section not in ("sampling", "starts"):
                listed = " and ".join(title(name) for name in others)
                text = f"{section.capitalize()} in {listed}: not quite the same, see the tables."
                sentences.append((section, text))
    if setup.scene.contact is not None and len(setup.engines) == 1:
        sentences.append(("nominal", "MuJoCo alone has contact: no other engine confirms what is said here."))
    if found.get("starts_that_differ"):
        count = len(found["starts_that_differ"])
        text = f"{count} of the starts {'ends' if count == 1 else 'end'} differently in other engines."
        sentences.append(("starts", text))
    return [(section, sentence) for section, sentence in sentences if sentence]


def _nominal_sentence(setup: Setup, found: Data, engine: str) -> str:
    values = found["nominal"]["engines"][engine]
    if values["outcome"] == "failed":
        return f"The nominal run fails: {values['message']}."
    text = f"Nominal, {title(engine)}: {values['outcome']} after {values['end_time']:g} s"
    if values["outcome"] in STOPPED:
        return f"{text}: {values['message']}."
    error, V = values["error"], values["lyapunov"]
    if error is not None:
        text += f", {quantity(error['final'], 'm', 2)} from the target"
    if V is not None and V["promised_rate"] is not None:
        fitted = "at no rate that can be fitted" if V["fitted_rate"] is None else f"at {V['fitted_rate']:.6g} /s"
        text += f"; V falls {fitted}, promised {V['promised_rate']:g} /s"
        if V["decay_error"] is not None:
            text += f" (largest error {V['decay_error']:.1g})"
    for one in found["nominal"]["differences"]:
        if engine in one["engines"] and one["node_error"] is not None:
            other = next(name for name in one["engines"] if name != engine)
            text += f"; {title(other)} differs by {quantity(one['node_error'], 'm', 2)}"
    text_of = Verdict(**values["judgement"]).text
    return f"{text}. {text_of[:1].upper()}{text_of[1:]}."


def _unjudged_sentence(section: str, part: Data, nominal: Data) -> str:
    """Say why a section is not judged."""
    head = f"{SECTIONS[section][:1].upper()}{SECTIONS[section][1:]}: not judged"
    if section in TOLERATED and not reached(nominal):
        more = "; give it more time (--duration)" if nominal["outcome"] == "still moving" else ""
        why = f"the law misses its goal even undisturbed ({nominal['outcome']}){more}"
        why = "the nominal run is not" if nominal["judgement"]["word"] == UNJUDGED else why
        return f"{head}, because {why}. The table has the runs."
    if nominal["outcome"] in NO_MEASURE:
        return (
            f"{head}, because there is no nominal run to compare with ({nominal['outcome']}). The table has the runs."
        )
    reasons = dict.fromkeys(one["judgement"]["reason"] for one in part["rows"] if one["judgement"]["reason"])
    return f"{head}, because {in_short(list(reasons)) or 'there is no run of it'}."


def _judged(section: str, part: Data) -> Data:
    """The part without runs that are not judged; sections that count them have all."""
    if section in ("sampling", "gains", "starts"):
        return part
    return part | {"rows": [one for one in part["rows"] if one["outcome"] not in UNKNOWN]}


def _doubts(part: Data) -> list[str]:
    """Say which runs do what they should and are doubtful all the same, and which are not judged."""
    doubtful = [one for one in part["rows"] if one["judgement"]["word"] == LIMITED and one["outcome"] in REACHED]
    unknown = [one for one in part["rows"] if one["judgement"]["word"] == UNJUDGED and not one.get("reference")]
    found = []
    for rows, words in ((doubtful, "do so with a doubt"), (unknown, "are not judged")):
        if rows:
            first = f"{rows[0]['label']}: {rows[0]['judgement']['reason']}"
            found.append(f"{len(rows)} of {len(part['rows'])} runs {words}; the first, {first}.")
    return found


def law_name(law: Data) -> str:
    return str((law["description"] or {}).get("law", law["from"]))


def verdict(data: Mapping[str, Any]) -> str:
    """Say whether the law does what it is meant to, and how much of what was tried it bears."""
    engine, one = next(iter(data["nominal"]["engines"].items()))
    name, where = law_name(data["law"]), f"{data['scene']['name']} in {title(engine)}"
    found, error = Verdict(**one["judgement"]), one.get("error")
    if one["outcome"] == "still moving" and error:
        left = quantity(error["final"], "m", 2)
        return f"{name} on {where} is still moving after {quantity(one['end_time'], 's')}, {left} from its target."
    if found.word == UNJUDGED:
        return f"{name} on {where} is not judged: {found.reason}."
    if found.word == BAD:
        reason = found.reason if found.value is None else f"{one['outcome']}; {found.text.removeprefix('bad: ')}"
        return f"{name} does not do what it is meant to on {where}: {reason}."
    if error:
        was_there = error["initial"] <= (found.bound or 0.0)
        text = f"{name} {f'keeps {where} at' if was_there else f'brings {where} to'} its target"
        text += f", to {quantity(error['final'], 'm', 2)}"
    else:
        text = f"{name} brings {where} to rest"
    text += f", with a doubt: {found.reason}" if found.word == LIMITED else ""
    verdicts = [data[section][engine]["word"] for section in SECTIONS if section in data and section != "nominal"]
    counts = [f"{word} in {verdicts.count(word)}" for word in (GOOD, LIMITED, BAD, UNJUDGED) if word in verdicts]
    return f"{text}; of {len(verdicts)} tests it is {', '.join(counts)}." if verdicts else f"{text}."


def _winch_sentences(found: Data, engine: str) -> list[str]:
    values = found["nominal"]["engines"][engine]
    if "winch" not in values:
        return []
    sentences = []
    margin, peaks, winch = values["margin"], values["peaks"], values["winch"]
    if margin is not None and margin["smallest"] is not None:
        sentences.append(f"The smallest feasibility margin is {margin['smallest']:.3g}, at {margin['time']:g} s.")
    u, rod = peaks["force_density"], peaks["compression"]
    if u is not None:
        text = f"The largest force density is {quantity(u['value'], 'N/m')} ({u['of']} at {u['time']:g} s)"
        if rod is not None and rod["value"] > 0:
            text += f", the largest compression {quantity(rod['value'], 'N')} ({rod['of']} at {rod['time']:g} s)"
        sentences.append(text + ".")
    below = values["rest_lengths"]
    if below and below["samples"]:
        sentences.append(
            f"Rest lengths of {', '.join(below['strings'])} are <= 0, first at {below['first_time']:g} s: no string "
            "can do that; take stiffer strings."
        )
    for name, limit in values["limits"].items():
        if limit["strings"]:
            sentences.append(f"{name} is reached by {', '.join(limit['strings'])}.")
    if bent := values.get("buckling"):
        first = min(one["time"] for one in bent.values())
        pushed = f"{'Rods' if len(bent) > 1 else 'Rod'} {', '.join(bent)} {'are' if len(bent) > 1 else 'is'} pushed"
        sentences.append(
            f"{pushed} with more than Euler's load of the section, first at {first:g} s, and would buckle."
        )
    if winch["peak"] is not None:
        peak, done, back = winch["peak"], *(quantity(winch[key], "J") for key in ("done", "recovered"))
        sentences.append(
            f"The winches spend {done} and recover {back}; the peak power of one winch is "
            f"{quantity(peak['value'], 'W')} ({peak['of']} at {peak['time']:g} s)."
        )
    return sentences


def _sampling_sentences(setup: Setup, section: str, part: Data) -> list[str]:
    sentences = []
    # What sampling costs is stated of runs that end as the law at every stage does, well or not.
    without = {one["outcome"] for one in part["rows"] if one["mode"] == Mode.CONTINUOUS.value}
    fine = {*REACHED, *without} - {*NO_MEASURE}
    for mode in (Mode.HOLD_FORCE_DENSITY.value, Mode.HOLD_REST_LENGTH.value):
        own = [one for one in part["rows"] if one["mode"] == mode]
        bad = [one for one in own if one["outcome"] not in fine]
        good = [one for one in own if one["outcome"] in fine and one["node_error"] is not None]
        near = min(good, key=lambda one: abs(math.log(one["period"] / setup.period)), default=None)
        if near is not None:
            against = "" if part["reference"] == "continuous" else " against the finest period"
            sentences.append(
                f"{mode} at {1e3 * near['period']:g} ms costs {quantity(near['node_error'], 'm', 2)}{against}"
            )
        if bad:
            periods = ", ".join(f"{1e3 * one['period']:g} ms" for one in bad)
            sentences.append(f"{mode} fails at {periods} ({_outcomes(bad)})")
    return [f"{text[0].upper()}{text[1:]}." for text in sentences]


def _gain_sentences(setup: Setup, section: str, part: Data) -> list[str]:
    results = {"yes": "shows", "no": "does not show: it is the other way round", "mixed": "shows in part only"}
    results |= {"none": "does not show: nothing changes", "unknown": "cannot be judged"}
    return [f"§5.6, {one['statement']}: {results[one['shows']]}." for one in part["trends"]]


def _plant_sentences(setup: Setup, section: str, part: Data) -> list[str]:
    what = "masses" if section == "mass" else "stiffnesses"
    bad = [one for one in part["rows"] if one["outcome"] not in REACHED]
    if not bad:
        errors = [one["final_error"] for one in part["rows"] if one["final_error"] is not None]
        worst = f" (final error up to {quantity(max(errors), 'm', 2)})" if errors else ""
        return [f"Converges with {what} off by up to 20 %{worst}."] if part["rows"] else []
    listed = "; ".join(f"{one['label']}: {_ended(one)}" for one in bad)
    return [f"Does not tolerate {what} off by 20 %: {listed}."]


def _noise_sentences(setup: Setup, section: str, part: Data) -> list[str]:
    columns = (("position_std", "m", "positions"), ("velocity_std", "m/s", "velocities"))
    sentences = []
    for chosen in (columns[:1], columns[1:], columns):
        keys = {key for key, _, _ in chosen}
        own = [one for one in part["rows"] if {key for key, _, _ in columns if one[key]} == keys]
        own.sort(key=lambda one: [one[key] for key, _, _ in columns])
        amounts = [" and ".join(f"{one[key]:g} {unit}" for key, unit, _ in chosen) for one in own]
        both = " together" if len(chosen) > 1 else ""
        text = _tolerated(own, amounts, f"noise of {' and '.join(what for _, _, what in chosen)}{both}")
        sentences += [text] if text else []
    return sentences


def _delay_sentences(setup: Setup, section: str, part: Data) -> list[str]:
    own = sorted(part["rows"], key=lambda one: one["samples"])
    counts = ["1 sample" if one["samples"] == 1 else f"{one['samples']} samples" for one in own]
    return [_tolerated(own, [f"{count} of {1e3 * setup.period:g} ms" for count in counts], "a delay")]


def _break_sentences(setup: Setup, section: str, part: Data) -> list[str]:
    if not part["rows"]:
        return []
    bad = [one for one in part["rows"] if one["outcome"] not in REACHED]
    time = part["rows"][0]["time"]
    if not bad:
        return [f"Converges whichever of the {len(part['rows'])} strings tried breaks at {time:g} s."]
    groups = dict.fromkeys(one["outcome"] for one in bad)
    listed = [
        f"{group} when {_names(one['string'] for one in bad if one['outcome'] == group)} breaks" for group in groups
    ]
    text = "; ".join(listed)
    return [f"{text[0].upper()}{text[1:]} at {time:g} s ({len(bad)} of {len(part['rows'])} strings tried)."]


def _gravity_sentences(setup: Setup, section: str, part: Data) -> list[str]:
    sentences = []
    for known, words in ((False, "unknown to the law"), (True, "known to it")):
        own = [one for one in part["rows"] if one["known_to_the_law"] is known]
        if own:
            good = [one for one in own if one["outcome"] in REACHED]
            bad = [one for one in own if one["outcome"] not in REACHED]
            fine = f"converges with {_names(_g(one) for one in good)}" if good else ""
            ill = f"not with {_names(f'{_g(one)} ({_ended(one)})' for one in bad)}" if bad else ""
            sentences.append(f"Gravity {words}: {'; '.join(text for text in (fine, ill) if text)}.")
    return sentences


def _g(one: Data) -> str:
    return f"{np.linalg.norm(one['gravity']):g} m/s²"


def _start_sentences(setup: Setup, section: str, part: Data) -> list[str]:
    key = "law" if "law" in part["fractions"][0] else "amplitude"
    heads = {"law": "{}", "amplitude": "amplitude {:g}"}
    listed = "; ".join(f"{heads[key].format(one[key])}: {_share(one)}" for one in part["fractions"])
    sentences = [f"Random starts that converge, of {part['fractions'][0]['starts']} each: {listed}."]
    if any(_promise(one) for one in part["fractions"]):
        # On the pinned rod error-controlled runs stop there, but for a few that need shorter steps only.
        held = f"fixed steps of {1e3 * setup.timestep:g} ms" if setup.continuous else "held controls"
        sentences.append(
            f"Where V leaves its promise, {held} passed a singularity of the law, or were too long for it: do not "
            "count on these starts."
        )
    return sentences


def _share(one: Data) -> str:
    """The part that converges of the starts that are judged, and how many are not."""
    left = one["starts"] - one.get("judged", one["starts"])
    if one["converged"] is None:
        return "none is judged"
    return f"{100 * one['converged']:.0f} %{_promise(one)}" + (f" ({left} not judged)" if left else "")


def _promise(one: Data) -> str:
    return (
        ""
        if one["kept"] in (None, one["converged"])
        else f" ({100 * one['kept']:.0f} % with V as promised all the way)"
    )


def _tolerated(own: Sequence[Data], amounts: Sequence[str], what: str) -> str:
    """Up to which amount, one a row and growing, runs converge."""
    if not own:
        return ""
    good = next((place for place, one in enumerate(own) if one["outcome"] not in REACHED), len(own))  # the first ones
    if not good:
        return f"Does not tolerate {what} of {amounts[0]} ({_outcomes(own[:1])})."
    more = f" ({_outcomes([own[good]])} with more)" if good < len(own) else " (more was not tried)"
    return f"Tolerates {what} of up to {amounts[good - 1]}{more}."


def _ended(one: Data) -> str:
    if one["outcome"] in STOPPED:
        return f"{one['outcome']} at {one['end_time']:.3g} s"
    return str(one["outcome"])


def _outcomes(rows: Sequence[Data]) -> str:
    return _names(dict.fromkeys(_ended(one) if len(rows) == 1 else one["outcome"] for one in rows))


def _names(names: Iterable[str]) -> str:
    *some, last = names
    return f"{', '.join(some)} or {last}" if some else last
