"""Law, engine and actuation from the options of `run` and `compare`."""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Iterable, Sequence
from typing import Any

from tensegrity_mj import controllers, model, runs, simulation
from tensegrity_mj.basics.seconds import Rounded
from tensegrity_mj.commands.common import SHARED, refuse, seconds, whole
from tensegrity_mj.controllers.table import LAWS
from tensegrity_mj.engines.table import ENGINES, make_engine, option_names
from tensegrity_mj.errors import OptionError

NORMS = {"1": 1.0, "2": 2.0, "inf": math.inf}

CHOSEN_BY_ACCURACY = ("timestep", "integrator", "method", "rtol", "atol", "locate-slack")
# The options of engines, and of those that some engines alone have, what the others have instead.
ENGINE_OPTIONS = {row["name"].removeprefix("--"): row["instead"] for row in SHARED["engine"] if "instead" in row}
LAW_OPTIONS = ("norm", "decay-rate", "law-option", "on-infeasible")
ACTUATION_OPTIONS = ("actuation", "control-period")


def check_control(options: argparse.Namespace) -> None:
    """Refuse control options that contradict each other, with an OptionError that says why."""
    held = (options.actuation or "continuous") != "continuous"
    if held and options.control_period is None:
        raise OptionError(f"--actuation {options.actuation} needs --control-period, the time between samples [s]")
    if not held:
        refuse(options, ("control-period",), "needs --actuation hold-force-density or hold-rest-length")


def law_of(options: argparse.Namespace, scene: model.Scene) -> Any:
    """The scene's law or the one chosen, with the options given; None for an open loop.

    Raises:
        OptionError: law options for a scene without a law, or a law without a target.
    """
    overrides = law_options_of(options)
    if (norm := getattr(options, "norm", None)) is not None:
        overrides["norm"] = NORMS[norm]
    if (rate := getattr(options, "decay_rate", None)) is not None:
        overrides["decay_rate"] = rate
    names = [name for name in LAW_OPTIONS if hasattr(options, name.replace("-", "_"))]
    if options.law == "none":
        refuse(options, names, "needs a control law, and --law none was given")
        return None
    if scene.control is None and options.law is None:
        refuse(options, names, f"needs a control law, and scene '{scene.name}' has none: add --law {' or '.join(LAWS)}")
        return None
    return controllers.from_scene(scene, options.law, **overrides)


def law_options_of(options: argparse.Namespace) -> dict[str, Any]:
    """Return the values of --law-option by their names; raise OptionError for a name that is given twice."""
    names = [name for name, _ in options.law_option or ()]
    if twice := [name for name in names if names.count(name) > 1]:
        raise OptionError(f"--law-option {twice[0]}: it is given twice; give each option once")
    return dict(options.law_option or ())


class Steps(int):
    """Number of steps of a run, in place of their size."""


def step(text: str) -> Steps | Rounded:
    """argparse type: a step [s], a number or a quotient, or "4800 steps"."""
    count, word, rest = text.partition("step")
    return Steps(whole(count.strip(), 10**12)) if word and rest in ("", "s") else seconds(text)


def law_option(text: str) -> tuple[str, Any]:
    """argparse type: NAME=VALUE, the value in TOML or, where it is none, a text."""
    import tomllib

    name, equals, value = (part.strip() for part in text.partition("="))
    if not equals or not name.isidentifier() or not value:
        raise argparse.ArgumentTypeError(f"{text!r}: write NAME=VALUE, for example onto=target")
    try:
        return name, tomllib.loads(f"value = {value}")["value"]
    except tomllib.TOMLDecodeError:
        return name, value


def actuation_of(options: argparse.Namespace) -> model.Actuation:
    """Make the actuation: what is held between control samples."""
    held = options.actuation
    return model.Actuation.continuous() if held is None else model.Actuation(held, options.control_period)


def simulated(
    options: argparse.Namespace,
    scene: model.Scene | runs.Trajectory,
    law: Any,
    engine: Any,
    actuation: model.Actuation | None,
    duration: float | None = None,
    output_interval: float | None = None,
) -> runs.Trajectory:
    """Simulate with a progress bar; its warnings get their causes."""
    from tensegrity_mj.vibration.step_warnings import explain_warnings

    run = simulation.simulate(
        scene,
        law,
        engine,
        duration=duration,
        actuation=actuation,
        on_infeasible=model.OnInfeasible(options.on_infeasible or "stop"),
        output_interval=output_interval,
        progress=True,
    )
    explain_warnings(run, engine, law, actuation)
    remark = run.reports.get("cheaper")
    for text in (*run.reports.get("taken", ()), *([remark] if remark else [])):
        print(f"note: {text}", file=sys.stderr)
    return run


def engine_of(
    name: str, options: argparse.Namespace, duration: float | None = None, *, with_timestep: bool = True
) -> Any:
    """The engine of this name with those of the options given that are its own, defaults elsewhere.

    Without `with_timestep`, one that may choose its steps leaves out those of fixed steps. A number of steps is of the
    duration [s].

    Raises:
        OptionError: naming an option that contradicts another.
    """
    if isinstance(options.timestep, Steps):
        if duration is None:
            raise OptionError(f"--timestep {options.timestep} steps: it means nothing here; give the step [s]")
        options.timestep = float(duration) / options.timestep
    if options.accuracy is not None:
        refuse(options, CHOSEN_BY_ACCURACY, "is chosen by --accuracy; give one or the other")
    own = option_names(name)
    if "method" in own and options.method == "rk4":
        refuse(options, ("rtol", "atol"), "belongs to the error-controlled methods; rk4 has --timestep")
    fixed = () if with_timestep or not ENGINES[name].fixed_step else ("timestep", "locate_slack")
    given = {option.replace("-", "_"): value for option, value in _given(options, ENGINE_OPTIONS).items()}
    return make_engine(
        name, {option: value for option, value in given.items() if option in own and option not in fixed}
    )


def refuse_options_of_other_engines(options: argparse.Namespace, used: Sequence[str]) -> None:
    """Refuse options that no engine in use has, with an OptionError that names the engines that have them."""
    for option in _given(options, ENGINE_OPTIONS):
        own = option.replace("-", "_")
        if not any(own in option_names(name) for name in used):
            owners = [name for name in ENGINES if own in option_names(name)]
            instead = ENGINE_OPTIONS[option] or f"{' and '.join(used)} cannot take it"
            refuse(options, (option,), f"belongs to --engine {' or '.join(owners)}; {instead}")


def require_off_screen_opengl() -> None:
    """Raise MissingLibraryError, before a long simulation, where its video cannot be drawn."""
    from tensegrity_mj.commands.doctor import check_opengl, probed
    from tensegrity_mj.errors import MissingLibraryError

    for check in (check_opengl(), probed("ffmpeg")):
        if not check.works:
            raise MissingLibraryError(
                f"video needs {check.name}, which does not work here ({check.found}): {check.remedy}"
            )


def _given(options: argparse.Namespace, names: Iterable[str]) -> dict[str, Any]:
    values = {name: getattr(options, name.replace("-", "_")) for name in names}
    return {name: value for name, value in values.items() if value is not None}
