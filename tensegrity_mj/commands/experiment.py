"""From the options of `run` and `compare` to a law, an engine and an actuation."""

from __future__ import annotations

import argparse
import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from tensegrity_mj.commands.common import positive, refuse
from tensegrity_mj.errors import OptionError

if TYPE_CHECKING:
    from tensegrity_mj import DAE, Actuation, MuJoCo
    from tensegrity_mj.scene import Scene

# The values of the enums of the same names: written here so that --help need not import them (tested to agree).
INTEGRATORS = ("euler", "implicitfast", "implicit", "rk4", "discrete")
METHODS = ("dop853", "radau", "rk4")
DRIFTS = ("monitor", "normalize", "baumgarte")
INFEASIBLE_CHOICES = ("stop", "passive")

ACTUATIONS = ("continuous", "hold-force-density", "hold-rest-length")
NORMS = {"1": 1.0, "2": 2.0, "inf": math.inf}

MUJOCO_OPTIONS = ("integrator",)
DAE_OPTIONS = ("method", "rtol", "atol", "drift")
LAW_OPTIONS = ("norm", "decay-rate", "on-infeasible")
ACTUATION_OPTIONS = ("actuation", "control-period")


def add_engine_options(parser: argparse._ArgumentGroup) -> None:
    """The options of both engines."""
    parser.add_argument("--timestep", type=positive, metavar="S", help="fixed step [s] of MuJoCo, or of the DAE's rk4")
    parser.add_argument("--integrator", choices=INTEGRATORS, help="MuJoCo's integrator (rk4)")
    parser.add_argument("--method", choices=METHODS, help="the DAE's method (dop853)")
    parser.add_argument("--rtol", type=positive, help="relative tolerance of the DAE's dop853 and radau")
    parser.add_argument("--atol", type=positive, help="absolute tolerance of the DAE's dop853 and radau")
    parser.add_argument(
        "--drift", choices=DRIFTS, help="what the DAE does about the drift of its constraints (monitor)"
    )
    parser.add_argument(
        "--output-interval", type=positive, metavar="S", help="between recorded samples [s] (about 0.01)"
    )


def add_control_options(parser: argparse._ArgumentGroup) -> None:
    """The options of laws and actuation."""
    parser.add_argument("--law", choices=("lyapunov", "none"), help="the control law (the scene's)")
    parser.add_argument(
        "--norm", choices=tuple(NORMS), help="norm of u that the Lyapunov law keeps least (the scene's)"
    )
    parser.add_argument("--decay-rate", type=positive, metavar="1/S", help="decay rate δ of the Lyapunov law [1/s]")
    parser.add_argument("--on-infeasible", choices=INFEASIBLE_CHOICES, help="without an admissible u: (stop)")
    parser.add_argument("--actuation", choices=ACTUATIONS, help="what is held between control samples (continuous)")
    parser.add_argument("--control-period", type=positive, metavar="S", help="time between control samples [s]")


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
    from tensegrity_mj import controllers

    overrides: dict[str, Any] = {}
    if options.norm is not None:
        overrides["norm"] = NORMS[options.norm]
    if options.decay_rate is not None:
        overrides["decay_rate"] = options.decay_rate
    if options.law == "none":
        return None
    if scene.control is not None and options.law in (None, scene.control.law):
        return controllers.from_scene(scene, **overrides)
    if options.law is None:
        refuse(options, LAW_OPTIONS, f"needs a control law, and scene '{scene.name}' has none: add --law lyapunov")
        return None
    if scene.target is None:
        raise OptionError(
            f"--law {options.law} needs a target, and scene '{scene.name}' has none: add one to the scene"
        )
    return controllers.Lyapunov(scene.structure, scene.target, gravity=scene.gravity, **overrides)


def actuation_of(options: argparse.Namespace) -> Actuation:
    """What is held between control samples."""
    from tensegrity_mj import Actuation

    match options.actuation:
        case "hold-force-density":
            return Actuation.hold_force_density(options.control_period)
        case "hold-rest-length":
            return Actuation.hold_rest_length(options.control_period)
    return Actuation.continuous()


def mujoco_of(options: argparse.Namespace) -> MuJoCo:
    """The MuJoCo engine with the options given, defaults elsewhere."""
    from tensegrity_mj import Integrator, MuJoCo

    chosen = _given(options, ("timestep",))
    if options.integrator is not None:
        chosen["integrator"] = Integrator(options.integrator)
    return MuJoCo(**chosen)


def dae_of(options: argparse.Namespace, *, with_timestep: bool = True) -> DAE:
    """The DAE engine with the options given, defaults elsewhere."""
    from tensegrity_mj import DAE, Drift, Method

    chosen = _given(options, ("rtol", "atol", *(("timestep",) if with_timestep else ())))
    if options.method is not None:
        chosen["method"] = Method(options.method)
    if options.method == "rk4":
        refuse(options, ("rtol", "atol"), "belongs to the error-controlled methods; rk4 has --timestep")
    if options.drift is not None:
        chosen["drift"] = Drift(options.drift)
    return DAE(**chosen)


def require_off_screen_opengl() -> None:
    """Find out before a long simulation that its video cannot be drawn.

    Raises:
        MissingLibraryError: with what is missing and how to get it.
    """
    from tensegrity_mj.doctor import check_ffmpeg, check_opengl
    from tensegrity_mj.errors import MissingLibraryError

    for check in (check_opengl(), check_ffmpeg()):
        if not check.works:
            raise MissingLibraryError(
                f"video needs {check.name}, which does not work here ({check.found}): {check.remedy}"
            )


def _given(options: argparse.Namespace, names: Sequence[str]) -> dict[str, Any]:
    return {name: getattr(options, name) for name in names if getattr(options, name) is not None}
