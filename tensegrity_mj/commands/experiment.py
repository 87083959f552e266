"""From the options of `run` and `compare` to a law, an engine and an actuation."""

from __future__ import annotations

import argparse
import math
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Any

from tensegrity_mj.commands.common import positive, refuse
from tensegrity_mj.controllers.table import LAWS
from tensegrity_mj.engines.table import ENGINES, make_engine, option_names
from tensegrity_mj.errors import OptionError

if TYPE_CHECKING:
    from tensegrity_mj.model.actuation import Actuation
    from tensegrity_mj.model.scene import Scene

# The values of the enums of the same names: written here so that --help need not import them (tested to agree).
INTEGRATORS = ("euler", "implicitfast", "implicit", "rk4", "discrete")
METHODS = ("dop853", "radau", "rk4")
DRIFTS = ("monitor", "normalize", "baumgarte")
INFEASIBLE_CHOICES = ("stop", "passive")

ACTUATIONS = ("continuous", "hold-force-density", "hold-rest-length")
NORMS = {"1": 1.0, "2": 2.0, "inf": math.inf}

CHOSEN_BY_ACCURACY = ("timestep", "integrator", "method", "rtol", "atol", "locate-slack")
# The options of engines, and of those that some engines alone have, what the others have instead.
ENGINE_OPTIONS = {
    "timestep": "",
    "accuracy": "",
    "locate-slack": "",
    "integrator": "DAE and ODE have --method",
    "method": "MuJoCo has --integrator and --timestep",
    "rtol": "MuJoCo has --integrator and --timestep",
    "atol": "MuJoCo has --integrator and --timestep",
    "drift": "the others have no constraint that drifts",
}
LAW_OPTIONS = ("norm", "decay-rate", "law-option", "on-infeasible")
ACTUATION_OPTIONS = ("actuation", "control-period")


def add_engine_options(parser: argparse._ArgumentGroup) -> None:
    """The options of all engines."""
    parser.add_argument(
        "--accuracy",
        type=positive,
        metavar="M",
        help="largest node error over the run [m], 1e-10 to 1e-2: chooses integrator and step, and verifies them",
    )
    parser.add_argument("--timestep", type=positive, metavar="S", help="fixed step [s] of MuJoCo, or of --method rk4")
    parser.add_argument("--integrator", choices=INTEGRATORS, help="MuJoCo's integrator (rk4)")
    parser.add_argument("--method", choices=METHODS, help="the method of DAE and ODE (dop853)")
    parser.add_argument("--rtol", type=positive, help="relative tolerance of dop853 and radau")
    parser.add_argument("--atol", type=positive, help="absolute tolerance of dop853 and radau")
    parser.add_argument(
        "--locate-slack",
        action="store_const",
        const=True,
        help="split the steps of rk4 where strings go slack or taut, so that it keeps its order there",
    )
    parser.add_argument(
        "--drift", choices=DRIFTS, help="what the DAE does about the drift of its constraints (monitor)"
    )
    parser.add_argument(
        "--output-interval", type=positive, metavar="S", help="between recorded samples [s] (about 0.01)"
    )


def add_control_options(parser: argparse._ArgumentGroup) -> None:
    """The options of laws and actuation."""
    parser.add_argument("--law", choices=(*LAWS, "none"), help="the control law (the scene's)")
    parser.add_argument("--norm", choices=tuple(NORMS), help="norm of u that the law keeps least (the scene's)")
    parser.add_argument("--decay-rate", type=positive, metavar="1/S", help="decay rate δ of the law [1/s]")
    parser.add_argument(
        "--law-option",
        action="append",
        type=law_option,
        metavar="NAME=VALUE",
        help="any other option of the law, written as in a scene file: onto=target, rotation={Z=2.0}; may be repeated",
    )
    parser.add_argument("--on-infeasible", choices=INFEASIBLE_CHOICES, help="without an admissible u: (stop)")
    parser.add_argument("--actuation", choices=ACTUATIONS, help="what is held between control samples (continuous)")
    parser.add_argument("--control-period", type=positive, metavar="S", help="time between control samples [s]")


def check_accuracy(options: argparse.Namespace) -> None:
    """Refuse what --accuracy chooses, beside it.

    Raises:
        OptionError: naming the option.
    """
    if options.accuracy is not None:
        refuse(options, CHOSEN_BY_ACCURACY, "is chosen by --accuracy; give one or the other")


def check_control(options: argparse.Namespace) -> None:
    """Refuse control options that contradict each other.

    Raises:
        OptionError: naming the option and why.
    """
    if options.law == "none":
        refuse(options, LAW_OPTIONS, "needs a control law, and --law none was given")
    held = (options.actuation or "continuous") != "continuous"
    if held and options.control_period is None:
        raise OptionError(f"--actuation {options.actuation} needs --control-period, the time between samples [s]")
    if not held:
        refuse(options, ("control-period",), "needs --actuation hold-force-density or hold-rest-length")


def law_of(options: argparse.Namespace, scene: Scene) -> Any:
    """The scene's law or the one asked for, with the options given; None for an open loop.

    Raises:
        OptionError: law options for a scene without a law, or a law without a target.
    """
    from tensegrity_mj.controllers.scenes import from_scene

    overrides: dict[str, Any] = dict(options.law_option or ())
    if options.norm is not None:
        overrides["norm"] = NORMS[options.norm]
    if options.decay_rate is not None:
        overrides["decay_rate"] = options.decay_rate
    if options.law == "none":
        return None
    if scene.control is None and options.law is None:
        refuse(
            options,
            LAW_OPTIONS,
            f"needs a control law, and scene '{scene.name}' has none: add --law {' or '.join(LAWS)}",
        )
        return None
    return from_scene(scene, options.law, **overrides)


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


def actuation_of(options: argparse.Namespace) -> Actuation:
    """What is held between control samples."""
    from tensegrity_mj.model.actuation import Actuation

    match options.actuation:
        case "hold-force-density":
            return Actuation.hold_force_density(options.control_period)
        case "hold-rest-length":
            return Actuation.hold_rest_length(options.control_period)
    return Actuation.continuous()


def engine_of(name: str, options: argparse.Namespace, *, with_timestep: bool = True) -> Any:
    """The engine of this name with those of the options given that are its own, defaults elsewhere.

    Without `with_timestep`, one that may choose its steps leaves out those of fixed steps.
    """
    check_accuracy(options)
    own = option_names(name)
    if "method" in own and options.method == "rk4":
        refuse(options, ("rtol", "atol"), "belongs to the error-controlled methods; rk4 has --timestep")
    fixed = () if with_timestep or not ENGINES[name].fixed_step else ("timestep", "locate_slack")
    given = {option.replace("-", "_"): value for option, value in _given(options, ENGINE_OPTIONS).items()}
    return make_engine(
        name, {option: value for option, value in given.items() if option in own and option not in fixed}
    )


def refuse_options_of_other_engines(options: argparse.Namespace, used: Sequence[str]) -> None:
    """Refuse options that none of the engines in use has.

    Raises:
        OptionError: naming the option and the engines that have it.
    """
    for option in _given(options, ENGINE_OPTIONS):
        own = option.replace("-", "_")
        if not any(own in option_names(name) for name in used):
            owners = [name for name in ENGINES if own in option_names(name)]
            instead = ENGINE_OPTIONS[option] or f"{' and '.join(used)} cannot take it"
            refuse(options, (option,), f"belongs to --engine {' or '.join(owners)}; {instead}")


def require_off_screen_opengl() -> None:
    """Find out before a long simulation that its video cannot be drawn.

    Raises:
        MissingLibraryError: with what is missing and how to get it.
    """
    from tensegrity_mj.commands.doctor import check_ffmpeg, check_opengl
    from tensegrity_mj.errors import MissingLibraryError

    for check in (check_opengl(), check_ffmpeg()):
        if not check.works:
            raise MissingLibraryError(
                f"video needs {check.name}, which does not work here ({check.found}): {check.remedy}"
            )


def _given(options: argparse.Namespace, names: Iterable[str]) -> dict[str, Any]:
    values = {name: getattr(options, name.replace("-", "_")) for name in names}
    return {name: value for name, value in values.items() if value is not None}
