"""The calls at the top of the package, where texts become objects, once: inside there are objects alone.

    tmj.simulate("prism", "lyapunov", "dae", on_infeasible="passive")

A scene is given by what `load_scene` takes, a law by what `controllers.from_scene` takes (a name, path.py:name or
module:name; the scene's options hold), an engine by its name with its defaults, an enum by the text of its value. What
a function does and raises stands in the room that it comes from; the signatures here add the texts.
"""

from __future__ import annotations

import functools
import inspect
import os
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from typing import Any, ParamSpec, TypeVar

from numpy.typing import ArrayLike

from tensegrity_mj import controllers, simulation
from tensegrity_mj.basics.checks import choice_from
from tensegrity_mj.dynamics.native.law import Command, Law
from tensegrity_mj.engines.table import make_engine
from tensegrity_mj.errors import OptionError
from tensegrity_mj.library.load import load_scene
from tensegrity_mj.linearization import linearizing
from tensegrity_mj.linearization.model import Linearization
from tensegrity_mj.model.actuation import Actuation, Mode, OnInfeasible
from tensegrity_mj.model.scene import Scene
from tensegrity_mj.runs.trajectory import Trajectory
from tensegrity_mj.studies import ensemble
from tensegrity_mj.vibration import stable_step as stable_steps

P = ParamSpec("P")
R = TypeVar("R")
AnyScene = Scene | str | os.PathLike[str]
AnyLaw = Law | Callable[..., ArrayLike] | str | None


def with_texts(function: Callable[..., Any]) -> Callable[[Callable[P, R]], Callable[P, R]]:
    """Make a call of a signature: its texts become objects, by the names of its parameters, and `function` gets them.

    What is left out has the default that `function` has for it.
    """

    def decorate(signature: Callable[P, R]) -> Callable[P, R]:
        parameters = inspect.signature(signature)

        @functools.wraps(signature)
        def call(*args: P.args, **options: P.kwargs) -> R:
            try:
                given = parameters.bind(*args, **options).arguments
            except TypeError as error:
                takes = f"it takes {', '.join(parameters.parameters)}"
                raise TypeError(f"{signature.__name__}() {error}; {takes}") from None
            return function(**_objects(given))

        call.__doc__ = f"{inspect.getdoc(function)}\n\nScenes, laws, engines and enums may be texts: see `{__name__}`."
        return call

    return decorate


def _objects(given: dict[str, Any]) -> dict[str, Any]:
    """Arguments with the objects that their texts stand for; scenes first, which laws are made for."""
    if "scene" in given:
        given["scene"] = _scene(given["scene"])
    elif isinstance(given["scenes"], (list, tuple)):
        given["scenes"] = [_scene(one) for one in given["scenes"]]
    for law in ("law", "controller"):
        if isinstance(given.get(law), str):
            given[law] = controllers.from_scene(given["scene"], given[law])
    laws = given.get("controllers")
    if isinstance(laws, str) or (isinstance(laws, (list, tuple)) and len(laws) == len(given["scenes"])):
        each = [laws] * len(given["scenes"]) if isinstance(laws, str) else laws
        given["controllers"] = [
            controllers.from_scene(scene, law) if isinstance(law, str) else law
            for scene, law in zip(given["scenes"], each, strict=True)
        ]
    if isinstance(given.get("engine"), str):
        given["engine"] = make_engine(given["engine"], {})
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


def _scene(given: Any) -> Any:
    return load_scene(given) if isinstance(given, (str, os.PathLike)) else given


@with_texts(simulation.simulate)
def simulate(
    scene: AnyScene,
    controller: AnyLaw = None,
    engine: simulation.Engine | str | None = None,
    *,
    duration: float | None = None,
    actuation: Actuation | str | None = None,
    on_infeasible: OnInfeasible | str = OnInfeasible.STOP,
    output_interval: float | None = None,
    progress: bool = False,
) -> Trajectory:
    raise NotImplementedError


@with_texts(linearizing.linearize)
def linearize(
    scene: AnyScene,
    engine: linearizing.LinearizableEngine | str | None = None,
    *,
    nodes: ArrayLike | None = None,
    velocities: ArrayLike | None = None,
    rest_lengths: ArrayLike | None = None,
    law: AnyLaw = None,
    time: float = 0.0,
    inputs: Command | str = Command.REST_LENGTH,
) -> Linearization:
    raise NotImplementedError


@with_texts(stable_steps.stable_step)
def stable_step(
    scene: AnyScene,
    engine: Any,
    *,
    law: AnyLaw = None,
    actuation: Actuation | str | None = None,
    nodes: ArrayLike | None = None,
    velocities: ArrayLike | None = None,
    rest_lengths: ArrayLike | None = None,
    time: float = 0.0,
    run: Trajectory | None = None,
) -> stable_steps.StableStep:
    raise NotImplementedError


@with_texts(ensemble.simulate_many)
def simulate_many(
    scenes: Sequence[AnyScene],
    controllers: AnyLaw | Sequence[AnyLaw] = None,
    engine: Any = None,
    *,
    duration: float | None = None,
    actuation: Actuation | str | None = None,
    on_infeasible: OnInfeasible | str = OnInfeasible.STOP,
    output_interval: float | None = None,
    threads: int = 0,
    progress: bool = False,
) -> ensemble.Ensemble:
    raise NotImplementedError


@with_texts(ensemble.law_in)
def law_in(
    scene: AnyScene, law: AnyLaw, engine: Any = None, *, on_infeasible: OnInfeasible | str = OnInfeasible.STOP
) -> AbstractContextManager[Any]:
    raise NotImplementedError
