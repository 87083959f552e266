"""The calls at the top of the package, where texts become objects, once: inside there are objects alone.

    tmj.simulate("prism", "lyapunov", "dae", on_infeasible="passive", integrator="rk4", timestep=1e-3)

A scene is given by what `load_scene` takes, a law by what `controllers.from_scene` takes (a name, path.py:name or
module:name; the scene's options hold) or "none", an engine by its name and its options ("mujoco" where there are
options alone; `integrator` is the `method` of DAE and ODE), an enum by the text of its value. What a function does and
raises stands in the room that it comes from; the signatures here add the texts.
"""

from __future__ import annotations

import inspect
import os
from collections.abc import Callable, Iterable, Sequence
from contextlib import AbstractContextManager
from typing import TYPE_CHECKING, Any, TypeVar

from numpy.typing import ArrayLike

from tensegrity_mj import controllers, simulation
from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.basics.checks import choice_from
from tensegrity_mj.basics.texts import unknown
from tensegrity_mj.controllers.scenes import SCENE_LAW
from tensegrity_mj.dynamics.native.law import Command
from tensegrity_mj.engines.request import AcceleratingEngine
from tensegrity_mj.engines.table import make_engine, option_names
from tensegrity_mj.errors import OptionError
from tensegrity_mj.library.named import load_scene
from tensegrity_mj.linearization import linearizing
from tensegrity_mj.linearization.model import Linearization
from tensegrity_mj.model.actuation import Actuation, Mode, OnInfeasible
from tensegrity_mj.model.scene import Scene
from tensegrity_mj.runs.trajectory import Trajectory
from tensegrity_mj.simulation import ensemble
from tensegrity_mj.vibration import stable_step as stable_steps

if TYPE_CHECKING:
    from tensegrity_mj.studies.identification.fitting import FitOptions
    from tensegrity_mj.studies.identification.result import Identification
    from tensegrity_mj.studies.identification.unknowns import Parameter

Call = TypeVar("Call", bound=Callable[..., Any])
AnyScene = Scene | str | os.PathLike[str]
AnyLaw = controllers.scenes.AnyLaw | str


def _with_text_of(inside: object) -> Callable[[Call], Call]:
    """Give a call the docstring of the function inside."""

    def documented(call: Call) -> Call:
        texts = "Scenes, laws, engines and enums may be texts, with options of the engine by their names"
        call.__doc__ = f"{inspect.getdoc(inside)}\n\n{texts}: see `{__name__}`."
        return call

    return documented


def _objects(call: str, given: dict[str, Any]) -> dict[str, Any]:
    """Turn the texts among a call's arguments into objects; scenes first, which laws are made for."""
    options, own = given.pop("engine_options"), list(given)
    if options or isinstance(given["engine"], str):
        given["engine"] = _engine(call, own, given["engine"], options)
    if "scene" in given:
        given["scene"] = _scene(given["scene"])
    elif isinstance(given["scenes"], (list, tuple)):
        given["scenes"] = [_scene(one) for one in given["scenes"]]
    for law in ("law", "controller"):
        if isinstance(given.get(law), str):
            given[law] = _law(given["scene"], given[law])
    laws = given.get("controllers")
    if isinstance(laws, str) or (isinstance(laws, (list, tuple)) and len(laws) == len(given["scenes"])):
        each = [laws] * len(given["scenes"]) if isinstance(laws, str) else laws
        given["controllers"] = [_law(scene, law) for scene, law in zip(given["scenes"], each, strict=True)]
    for name, kind in {"on_infeasible": OnInfeasible, "inputs": Command}.items():
        if isinstance(given.get(name), str):
            given[name] = choice_from(name, kind, given[name])
    if isinstance(given.get("actuation"), str):
        mode = choice_from("actuation", Mode, given["actuation"])
        if mode is not Mode.CONTINUOUS:
            use = f"tmj.Actuation.{mode.name.lower()}(period)"
            raise OptionError(f"actuation = {given['actuation']!r}: it needs the time between samples: use {use}")
        given["actuation"] = Actuation(mode)
    return given


def _law(scene: Scene, law: Any) -> Any:
    if not isinstance(law, str):
        return law
    return None if law == "none" else controllers.from_scene(getattr(scene, "scene", scene), law)


def _engine(call: str, own: list[str], engine: Any, options: dict[str, Any]) -> Any:
    """The engine of a name with these options, of a call whose other parameters are `own`."""
    if engine is not None and not isinstance(engine, str):
        raise OptionError(
            f"{call}: {', '.join(options)}: the engine has been made with its options; leave these out, or give the "
            f'engine by its name, as engine="dae"'
        )
    has = option_names(name := "mujoco" if engine is None else engine)
    if "integrator" in options and "method" in has:
        if "method" in options:
            raise OptionError(f"{call}: integrator and method are one option of engine {name}; leave one of them out")
        options = {"method" if key == "integrator" else key: value for key, value in options.items()}
    for key in options:
        if key not in has:
            what = f"argument of {call}, nor option of engine {name},"
            raise TypeError(f"{call}(): {unknown(key, [*own, *has], what)}")
    return make_engine(name, options)


def _scene(given: Any) -> Any:
    return load_scene(given) if isinstance(given, (str, os.PathLike)) else given


@_with_text_of(simulation.simulate)
def simulate(
    scene: AnyScene | Trajectory,
    controller: AnyLaw = SCENE_LAW,
    engine: simulation.Engine | str | None = None,
    *,
    duration: float | None = None,
    actuation: Actuation | str | None = None,
    on_infeasible: OnInfeasible | str = OnInfeasible.STOP,
    output_interval: float | None = None,
    progress: bool = False,
    **engine_options: Any,
) -> Trajectory:
    return simulation.simulate(**_objects("simulate", locals()))


@_with_text_of(simulation.accelerations)
def accelerations(
    scene: AnyScene,
    controller: AnyLaw = SCENE_LAW,
    engine: AcceleratingEngine | str | None = None,
    *,
    nodes: ArrayLike | None = None,
    velocities: ArrayLike | None = None,
    time: float | None = None,
    rest_lengths: ArrayLike | None = None,
    **engine_options: Any,
) -> Array:
    return simulation.accelerations(**_objects("accelerations", locals()))


@_with_text_of(linearizing.linearize)
def linearize(
    scene: AnyScene,
    engine: AcceleratingEngine | str | None = None,
    *,
    nodes: ArrayLike | None = None,
    velocities: ArrayLike | None = None,
    rest_lengths: ArrayLike | None = None,
    law: AnyLaw = None,
    time: float | None = None,
    inputs: Command | str = Command.REST_LENGTH,
    **engine_options: Any,
) -> Linearization:
    return linearizing.linearize(**_objects("linearize", locals()))


@_with_text_of(stable_steps.stable_step)
def stable_step(
    scene: AnyScene,
    engine: Any,
    *,
    law: AnyLaw = SCENE_LAW,
    actuation: Actuation | str | None = None,
    nodes: ArrayLike | None = None,
    velocities: ArrayLike | None = None,
    rest_lengths: ArrayLike | None = None,
    time: float | None = None,
    run: Trajectory | None = None,
    **engine_options: Any,
) -> stable_steps.StableStep:
    return stable_steps.stable_step(**_objects("stable_step", locals()))


@_with_text_of(ensemble.simulate_many)
def simulate_many(
    scenes: Sequence[AnyScene],
    controllers: AnyLaw | Sequence[AnyLaw] = SCENE_LAW,
    engine: Any = None,
    *,
    duration: float | None = None,
    actuation: Actuation | str | None = None,
    on_infeasible: OnInfeasible | str = OnInfeasible.STOP,
    output_interval: float | None = None,
    threads: int = 0,
    progress: bool = False,
    **engine_options: Any,
) -> ensemble.Ensemble:
    return ensemble.simulate_many(**_objects("simulate_many", locals()))


def identify(
    scene: AnyScene,
    measurements: Any,
    parameters: Iterable[Parameter | str],
    engine: Any = None,
    *,
    law: AnyLaw = SCENE_LAW,
    options: FitOptions | None = None,
    folder: str | os.PathLike[str] | None = None,
    progress: bool = False,
    **engine_options: Any,
) -> Identification:
    """Find parameters of a scene by which its runs are as they were measured: see `tensegrity_mj.studies.identify`."""
    given = _objects("identify", locals())
    from tensegrity_mj.studies.identification.result import identify as inside

    return inside(**given)


@_with_text_of(ensemble.law_in)
def law_in(
    scene: AnyScene,
    law: AnyLaw = SCENE_LAW,
    engine: Any = None,
    *,
    on_infeasible: OnInfeasible | str = OnInfeasible.STOP,
    **engine_options: Any,
) -> AbstractContextManager[Any]:
    return ensemble.law_in(**_objects("law_in", locals()))
