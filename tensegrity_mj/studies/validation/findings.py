"""From the runs to the report's data: rows by section and engine, trends, and sentences that a user can act on."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from itertools import pairwise
from typing import Any

import numpy as np

from tensegrity_mj.actuation import Mode
from tensegrity_mj.dynamics.target import target_nodes
from tensegrity_mj.engines.reports import DECAY_WARNING
from tensegrity_mj.scene import Scene
from tensegrity_mj.studies.attempt import DONE
from tensegrity_mj.studies.validation.sections import SECTIONS, Case, Setup

Data = dict[str, Any]

CONVERGED = 0.05  # part of the way to the target that may be left
MIRRORED = -0.98  # cos of the angle between a rod and its target
SAME = 1e-9  # part of the structure's size: nodes that are not farther apart are at the same place
STANDING = 0.05  # part of the way to the target that the fastest node would go in another duration
TREND = 0.01  # part by which a quantity must change to have a trend
STOPPED = ("infeasible", "singular", "diverged")
TOLERATED = ("mass", "stiffness", "noise", "delay", "breaks", "gravity")
GOOD = ("converged", "completed")  # the latter where there is no target
OUTCOMES = ("converged", "off target", "still moving", "mirrored", *STOPPED, "failed", "completed")

# What §5.6 says of gains: (gain, quantity, sign of its change as the gain grows, in words).
STATEMENTS = (
    ("Z", "settling_10", 1, "slower with larger Z"),
    ("Z", "peak_force_density", 1, "larger controls with larger Z (peak)"),
    ("Z", "rms_force_density", 1, "larger controls with larger Z (root mean square)"),
    ("Y", "peak_force_density", -1, "larger controls with smaller Y (peak)"),
    ("Y", "rms_force_density", -1, "larger controls with smaller Y (root mean square)"),
    ("Y", "settling_10", 1, "may become slower with larger Y"),
)


TITLES = {"mujoco": "MuJoCo", "dae": "DAE", "ode": "ODE"}


def title(engine: str) -> str:
    """An engine's name for people."""
    return TITLES.get(engine, engine)


def findings(setup: Setup, pairs: Sequence[tuple[Case, Mapping[str, Any]]]) -> Data:
    """The sections of the report from each case and its outcome."""
    nominal = {case.point["engine"]: outcome for case, outcome in pairs if case.section == "nominal"}
    tolerance = _tolerance(setup, nominal.values())
    found: Data = {"tolerance": tolerance, "nominal": _nominal(setup, nominal, tolerance)}
    for section in SECTIONS:
        chosen = [pair for pair in pairs if pair[0].section == section]
        if section == "nominal" or not chosen:
            continue
        found[section] = {}
        for engine in setup.engines:
            own = [(case, outcome) for case, outcome in chosen if case.point["engine"] == engine]
            rows = [row(setup, case, outcome, tolerance) for case, outcome in own]
            part: Data = {"rows": rows}
            if section == "sampling":
                part |= _sampling(rows, [outcome for _, outcome in own])
            elif section == "gains":
                part["trends"] = trends(rows)
            elif section == "starts":
                part["fractions"] = _fractions(rows)
            found[section][engine] = part
    if "starts" in found and len(setup.engines) > 1:
        found["starts_that_differ"] = _differing(found["starts"])
    found["summary"] = summary(setup, found)
    return found


def row(setup: Setup, case: Case, outcome: Mapping[str, Any], tolerance: float) -> Data:
    """One run in a table: what it was, how it ended, and its main numbers."""
    base: Data = {"label": case.label, **case.facts}
    if outcome["status"] != DONE:
        reason = f"{outcome['error']}: {outcome['reason']}"
        return base | {"outcome": "failed", "end_time": None, "message": reason, **dict.fromkeys(_NUMBERS)}
    values = outcome["values"]
    base |= {
        "outcome": judged(values, tolerance, setup.duration),
        "end_time": values["end_time"],
        "message": values["message"],
    }
    return base | _numbers(values)


_NUMBERS = (
    "final_error",
    "settling_10",
    "settling_2",
    "peak_force_density",
    "peak_tension",
    "peak_compression",
    "rms_force_density",
    "switching_rate",
    "smallest_margin",
    "winch_done",
    "decay_error",
)


def _numbers(values: Mapping[str, Any]) -> Data:
    if "peaks" not in values:  # diverged
        return dict.fromkeys(_NUMBERS)
    error, peaks, margin, V = (values[key] or {} for key in ("error", "peaks", "margin", "lyapunov"))

    def peak(name: str) -> float | None:
        return None if peaks[name] is None else peaks[name]["value"]

    numbers = (
        error.get("final"),
        error.get("settling_10"),
        error.get("settling_2"),
        peak("force_density"),
        peak("tension"),
        peak("compression"),
        peaks["rms_force_density"],
        values["switching"]["rate"],
        margin.get("smallest"),
        values["winch"]["done"],
        V.get("decay_error") if V.get("promised_rate") is not None else None,
    )
    return dict(zip(_NUMBERS, numbers, strict=True))


def judged(values: Mapping[str, Any], tolerance: float, duration: float) -> str:
    """How a run came out, one of `OUTCOMES`.

    Args:
        values: of `measures.of_run`, or of a run that diverged.
        tolerance: distance from the target that counts as there [m].
        duration: of the run [s].
    """
    if values["status"] != "completed":
        return str(values["status"])
    if values["error"] is None:
        return "completed"
    if values["error"]["final"] <= tolerance:
        return "converged"
    standing = values["arrival"]["speed"] * duration <= STANDING / CONVERGED * tolerance
    if standing and min(values["arrival"]["alignment"], default=1.0) < MIRRORED:
        return "mirrored"
    return "off target" if standing else "still moving"


def _tolerance(setup: Setup, nominal: Iterable[Mapping[str, Any]]) -> float:
    """Distance from the target [m] that counts as there: 5 % of the way, or twice what a nominal run has left, if that
    has come so near itself."""
    near = CONVERGED * way(setup.scene, setup.duration)
    finals = [
        one["values"]["error"]["final"] for one in nominal if one["status"] == DONE and one["values"].get("error")
    ]
    return max([near, *(2 * final for final in finals if final <= near)])


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
    kept = {}
    for engine, outcome in nominal.items():
        if outcome["status"] != DONE:
            found[engine] = {"outcome": "failed", "message": f"{outcome['error']}: {outcome['reason']}"}
            continue
        values = dict(outcome["values"])
        kept[engine] = values.pop("kept", None)
        series = {key: item for key, item in (kept[engine] or {}).items() if key != "nodes"}
        found[engine] = {"outcome": judged(values, tolerance, setup.duration), **values, "series": series}
    engines = [engine for engine in found if kept.get(engine)]
    return {
        "engines": found,
        "differences": [
            {"engines": [a, b], "node_error": node_error(kept[a], kept[b])}
            for number, a in enumerate(engines)
            for b in engines[number + 1 :]
        ],
    }


def node_error(first: Mapping[str, Any] | None, second: Mapping[str, Any] | None) -> float | None:
    """The largest distance of a node in two runs at the times that both kept [m]."""
    if first is None or second is None:
        return None
    count = min(len(first["times"]), len(second["times"]))
    if not count:
        return None
    a, b = np.array(first["nodes"][:count]), np.array(second["nodes"][:count])
    return float(np.max(np.linalg.norm(a - b, axis=-1), initial=0.0))


def _sampling(rows: list[Data], outcomes: Sequence[Mapping[str, Any]]) -> Data:
    """Node errors against the continuous run, or, without one, against the finest period of the same mode."""
    kept = [outcome.get("values", {}).get("kept") for outcome in outcomes]
    continuous = next((kept[i] for i, one in enumerate(rows) if one["mode"] == Mode.CONTINUOUS.value), None)
    for number, one in enumerate(rows):
        reference = continuous
        if reference is None:
            alike = [i for i, other in enumerate(rows) if other["mode"] == one["mode"] and kept[i]]
            reference = kept[min(alike, key=lambda i: rows[i]["period"])] if alike else None
        one["node_error"] = node_error(kept[number], reference)
    return {"reference": "continuous" if continuous is not None else "the finest period of the mode"}


def trends(rows: Sequence[Data]) -> list[Data]:
    """Whether what §5.6 says of gains shows: yes, no, mixed, none (nothing changes by more than 1 %)."""
    found = []
    for gain, quantity, sign, words in STATEMENTS:
        own = [one for one in rows if one["gain"] == gain and one["outcome"] not in (*STOPPED, "failed")]
        own.sort(key=lambda one: one["factor"])
        values, factors = ([one[key] for one in own] for key in (quantity, "factor"))
        if len(values) > 1:
            verdict = trend(values, sign, unsettled=quantity.startswith("settling"))
            found.append(
                {
                    "gain": gain,
                    "quantity": quantity,
                    "statement": words,
                    "shows": verdict,
                    "factors": factors,
                    "values": values,
                }
            )
    return found


def trend(values: Sequence[float | None], sign: int, unsettled: bool = False) -> str:
    """Whether values change in the direction of the sign; None, where it means "never settled", is larger than any."""
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
    """How many starts of each law, or of each amplitude, came out how."""
    key = "law" if rows and "law" in rows[0] else "amplitude"
    found = []
    for group in dict.fromkeys(one[key] for one in rows):
        own = [one for one in rows if one[key] == group]
        counts = Counter(one["outcome"] for one in own)
        outcomes = {name: counts[name] for name in OUTCOMES if counts[name]}
        part = sum(counts[name] for name in GOOD) / len(own)
        found.append({key: group, "starts": len(own), "converged": part, "kept": _kept(own), "outcomes": outcomes})
    return found


def _kept(rows: Sequence[Data]) -> float | None:
    """The part of the runs that converge and whose V follows its promise all the way; None where none is promised.

    Steps of fixed length may pass a singularity that the law cannot: V leaves its promise there.
    """
    if all(one["decay_error"] is None for one in rows):
        return None
    return sum(one["outcome"] in GOOD and not left_promise(one) for one in rows) / len(rows)


def left_promise(one: Data) -> bool:
    """Whether V of a row leaves its promise by more than 1 %."""
    return (one["decay_error"] or 0.0) > DECAY_WARNING


def _differing(starts: Mapping[str, Any]) -> list[Data]:
    """Starts that come out differently in two engines."""
    engines = list(starts)
    found = []
    for parts in zip(*(starts[engine]["rows"] for engine in engines), strict=True):
        outcomes = {engine: one["outcome"] for engine, one in zip(engines, parts, strict=True)}
        if len(set(outcomes.values())) > 1:
            found.append({"label": parts[0]["label"], "outcomes": outcomes})
    return found


# ------------------------------------------------------------------------------------------------------- sentences


def summary(setup: Setup, found: Data) -> list[str]:
    """What the report comes to, in sentences; of the first engine, and where another one differs."""
    engine = setup.engines[0]
    sentences = [_nominal_sentence(setup, found, engine), *_winch_sentences(found, engine)]
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
    # What is off can only be blamed where the run converges without it.
    outcome = found["nominal"]["engines"][engine]["outcome"]
    unjudged = [] if outcome in GOOD else [section for section in TOLERATED if section in found]
    sentences.append(_unjudged_sentence(unjudged, outcome))
    for section, maker in makers.items():
        if section in found and section not in unjudged:
            mine = maker(setup, section, found[section][engine])
            others = [name for name in setup.engines[1:] if maker(setup, section, found[section][name]) != mine]
            sentences += mine
            if others and section not in ("sampling", "starts"):
                listed = " and ".join(title(name) for name in others)
                sentences.append(f"{section.capitalize()} in {listed}: not quite the same, see the tables.")
    if setup.scene.contact is not None:
        sentences.append("MuJoCo alone has contact: no other engine confirms what is said here.")
    if found.get("starts_that_differ"):
        count = len(found["starts_that_differ"])
        sentences.append(f"{count} of the starts {'comes' if count == 1 else 'come'} out differently in other engines.")
    return [sentence for sentence in sentences if sentence]


def _nominal_sentence(setup: Setup, found: Data, engine: str) -> str:
    values = found["nominal"]["engines"][engine]
    if values["outcome"] == "failed":
        return f"The nominal run fails: {values['message']}."
    text = f"Nominal, {title(engine)}: {values['outcome']} after {values['end_time']:g} s"
    if values["outcome"] in STOPPED:
        return f"{text}: {values['message']}."
    error, V = values["error"], values["lyapunov"]
    if error is not None:
        text += f", {error['final']:.2g} m from the target"
    if V is not None and V["promised_rate"] is not None:
        text += f"; V falls at {V['fitted_rate']:.6g} /s, promised {V['promised_rate']:g} /s"
        if V["decay_error"] is not None:
            text += f" (largest error {V['decay_error']:.1g})"
    for one in found["nominal"]["differences"]:
        if engine in one["engines"] and one["node_error"] is not None:
            other = next(name for name in one["engines"] if name != engine)
            text += f"; {title(other)} differs by {one['node_error']:.1e} m"
    return text + "."


def _unjudged_sentence(unjudged: Sequence[str], outcome: str) -> str:
    if not unjudged:
        return ""
    more = ", or with more time (--duration)" if outcome == "still moving" else ""
    return (
        f"What the law tolerates of {' and '.join(unjudged)} cannot be told where it does not converge without: see "
        f"the tables, and test it where it does{more}."
    )


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
        text = f"The largest force density is {u['value']:.3g} N/m ({u['of']} at {u['time']:g} s)"
        if rod is not None and rod["value"] > 0:
            text += f", the largest compression {rod['value']:.3g} N ({rod['of']} at {rod['time']:g} s)"
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
    if winch["peak"] is not None:
        sentences.append(
            f"The winches do {winch['done']:.3g} J and get {winch['recovered']:.3g} J back; the power of a single "
            f"one, done or got back, is up to {winch['peak']['value']:.3g} W ({winch['peak']['of']} at "
            f"{winch['peak']['time']:g} s)."
        )
    return sentences


def _sampling_sentences(setup: Setup, section: str, part: Data) -> list[str]:
    sentences = []
    # What sampling costs is told of runs that end as the law at every stage does, well or not.
    without = {one["outcome"] for one in part["rows"] if one["mode"] == Mode.CONTINUOUS.value}
    fine = {*GOOD, *without} - {*STOPPED, "failed"}
    for mode in (Mode.HOLD_FORCE_DENSITY.value, Mode.HOLD_REST_LENGTH.value):
        own = [one for one in part["rows"] if one["mode"] == mode]
        bad = [one for one in own if one["outcome"] not in fine]
        good = [one for one in own if one["outcome"] in fine and one["node_error"] is not None]
        near = min(good, key=lambda one: abs(math.log(one["period"] / setup.period)), default=None)
        if near is not None:
            against = "" if part["reference"] == "continuous" else " against the finest period"
            sentences.append(f"{mode} at {1e3 * near['period']:g} ms costs {near['node_error']:.2g} m{against}")
        if bad:
            what = f"{mode} does not do at {', '.join(_milliseconds(one) for one in bad)}"
            sentences.append(f"{what} ({_outcomes(bad)})")
    return [f"{text[0].upper()}{text[1:]}." for text in sentences]


def _milliseconds(one: Data) -> str:
    return f"{1e3 * one['period']:g} ms"


def _gain_sentences(setup: Setup, section: str, part: Data) -> list[str]:
    words = {"yes": "shows", "no": "does not show: it is the other way round", "mixed": "shows in part only"}
    words |= {"none": "does not show: nothing changes", "unknown": "cannot be told"}
    return [f"§5.6, {one['statement']}: {words[one['shows']]}." for one in part["trends"]]


def _plant_sentences(setup: Setup, section: str, part: Data) -> list[str]:
    what = "masses" if section == "mass" else "stiffnesses"
    bad = [one for one in part["rows"] if one["outcome"] not in GOOD]
    if not bad:
        errors = [one["final_error"] for one in part["rows"] if one["final_error"] is not None]
        worst = f" (final error up to {max(errors):.2g} m)" if errors else ""
        return [f"Converges with {what} off by up to 20 %{worst}."] if part["rows"] else []
    return [f"Does not tolerate {what} off by 20 %: {_listed(bad)}."]


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
    good = _first_good(own)
    if good is None:
        first = f"{own[0]['samples']} × {1e3 * setup.period:g} ms ({_outcomes(own[:1])})"
        return [f"Does not tolerate a delay of {first}."]
    more = " (more was not tried)" if good is own[-1] else f" ({_outcomes([own[own.index(good) + 1]])} with more)"
    samples = "1 sample" if good["samples"] == 1 else f"{good['samples']} samples"
    return [f"Tolerates a delay of up to {samples} of {1e3 * setup.period:g} ms{more}."]


def _break_sentences(setup: Setup, section: str, part: Data) -> list[str]:
    if not part["rows"]:
        return []
    bad = [one for one in part["rows"] if one["outcome"] not in GOOD]
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
    for told, words in ((False, "unknown to the law"), (True, "known to it")):
        own = [one for one in part["rows"] if one["known_to_the_law"] is told]
        if own:
            good = [one for one in own if one["outcome"] in GOOD]
            bad = [one for one in own if one["outcome"] not in GOOD]
            fine = f"converges with {_names(_g(one) for one in good)}" if good else ""
            ill = f"not with {_names(f'{_g(one)} ({_ended(one)})' for one in bad)}" if bad else ""
            sentences.append(f"Gravity {words}: {'; '.join(text for text in (fine, ill) if text)}.")
    return sentences


def _g(one: Data) -> str:
    return f"{np.linalg.norm(one['gravity']):g} m/s²"


def _start_sentences(setup: Setup, section: str, part: Data) -> list[str]:
    key = "law" if "law" in part["fractions"][0] else "amplitude"
    names = [one[key] if key == "law" else f"amplitude {one[key]:g}" for one in part["fractions"]]
    parts = [f"{one['converged']:.0%}{_promise(one)}" for one in part["fractions"]]
    listed = "; ".join(f"{name}: {text}" for name, text in zip(names, parts, strict=True))
    sentences = [f"Of {part['fractions'][0]['starts']} random starts each, there converge: {listed}."]
    if any(_promise(one) for one in part["fractions"]):
        # On the pinned rod error-controlled runs stop there, but for a few that need shorter steps only.
        held = f"fixed steps of {1e3 * setup.timestep:g} ms" if setup.continuous else "held controls"
        sentences.append(
            f"Where V leaves its promise, {held} passed a singularity of the law, or were too long for it: do not "
            "count on these starts."
        )
    return sentences


def _promise(one: Data) -> str:
    return "" if one["kept"] in (None, one["converged"]) else f" ({one['kept']:.0%} with V as promised all the way)"


def _tolerated(own: Sequence[Data], amounts: Sequence[str], what: str) -> str:
    """Up to which amount, one a row and growing, runs converge."""
    if not own:
        return ""
    good = _first_good(own)
    if good is None:
        return f"Does not tolerate {what} of {amounts[0]} ({_outcomes(own[:1])})."
    last = own.index(good)
    more = " (more was not tried)" if good is own[-1] else f" ({_outcomes([own[last + 1]])} with more)"
    return f"Tolerates {what} of up to {amounts[last]}{more}."


def _first_good(own: Sequence[Data]) -> Data | None:
    """The last row before the first that does not converge."""
    best = None
    for one in own:
        if one["outcome"] not in GOOD:
            break
        best = one
    return best


def _listed(rows: Sequence[Data]) -> str:
    return "; ".join(f"{one['label']}: {_ended(one)}" for one in rows)


def _ended(one: Data) -> str:
    if one["outcome"] in STOPPED:
        return f"{one['outcome']} at {one['end_time']:.3g} s"
    return str(one["outcome"])


def _outcomes(rows: Sequence[Data]) -> str:
    return _names(dict.fromkeys(_ended(one) if len(rows) == 1 else one["outcome"] for one in rows))


def _names(names: Iterable[str]) -> str:
    *some, last = names
    return f"{', '.join(some)} or {last}" if some else last
