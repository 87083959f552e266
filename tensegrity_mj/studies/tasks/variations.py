"""Domain randomisation: a task's scene with other parameters in each episode, by the sweep's paths and draws."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from tensegrity_mj.basics import kinds
from tensegrity_mj.basics.checks import checked, sequence_of
from tensegrity_mj.basics.texts import unknown
from tensegrity_mj.engines.table import engine_settings
from tensegrity_mj.errors import OptionError
from tensegrity_mj.model.scene import Scene
from tensegrity_mj.studies.axes import Draw
from tensegrity_mj.studies.parameter_values import decoded, number_from
from tensegrity_mj.studies.parameters import Draft
from tensegrity_mj.studies.scene_parameters import single_draws
from tensegrity_mj.studies.tasks.definition import Task

# What else may vary, by its field: control periods until a command is taken up, and standard deviations of measured
# nodes and their velocities [m], [m/s], as of `controllers.Delayed` and `Noisy`.
LOOP = {"delay": "delay", "noise.position": "position_noise", "noise.velocity": "velocity_noise"}

SETTINGS = kinds.mapping(kinds.text(), kinds.Kind(lambda one: one), "a mapping of paths to values", "parameter")


@dataclass(frozen=True)
class Variation:
    """One episode's scene and loop (see LOOP)."""

    scene: Scene
    delay: int = 0
    position_noise: float = 0.0
    velocity_noise: float = 0.0


class Variations:
    """Parameters that are fixed, and those that are drawn anew for each episode.

    Args:
        task: to begin with.
        parameters: path -> value: structure..., scene... and engine... as in a sweep, and those of LOOP.
        draws: of the same, but for the engine's.

    Raises:
        OptionError: for paths that name nothing here, values that they cannot have, and parameters given twice.
    """

    def __init__(self, task: Task, parameters: Mapping[str, Any] | None, draws: Sequence[Draw]) -> None:
        scene, settings = task.scene, checked("parameters", {} if parameters is None else parameters, SETTINGS)
        draws = sequence_of("draws", draws)
        for draw in draws:
            if not isinstance(draw, Draw):
                raise OptionError(f"draws holds {draw!r}; use Draw(parameter, distribution)")
        self.draws = single_draws(scene, draws)
        given = [*settings, *(draw.parameter for draw in self.draws)]
        for number, path in enumerate(given):
            roots = ("structure", "scene", "engine")[: 3 if number < len(settings) else 2]
            if path not in LOOP and str(path).partition(".")[0] not in roots:
                known = (*(f"{root}...." for root in roots), *LOOP)
                raise OptionError(f"parameter {path!r}: {unknown(str(path), known, 'parameter of an environment')}")
            if given.count(path) > 1:
                raise OptionError(f"{path}: it is given twice; give each parameter once")
        of_engine = {path: settings.pop(path) for path in list(settings) if path.startswith("engine")}
        name, options = engine_settings(task.engine)
        self.engine: Any = Draft(scene, engine=name, engine_options=options).apply(of_engine).make_engine()
        self.base = Variation(scene)
        self.base = self._made(settings)

    def draw(self, generator: np.random.Generator) -> Variation:
        """What the next episode is made of."""
        if not self.draws:
            return self.base
        return self._made({draw.parameter: draw.sample(generator) for draw in self.draws})

    def _made(self, settings: Mapping[str, Any]) -> Variation:
        varied, of_scene = self.base, dict(settings)
        for path in LOOP.keys() & settings.keys():
            value = number_from(path, decoded(of_scene.pop(path)), getattr(varied, LOOP[path]))
            if value < 0 or (path == "delay" and value != round(value)):
                need = "a whole number of control periods >= 0" if path == "delay" else "a number >= 0"
                raise OptionError(f"{path} = {value:g}; it must be {need}")
            varied = replace(varied, **{LOOP[path]: type(getattr(varied, LOOP[path]))(value)})
        return replace(varied, scene=Draft(varied.scene).apply(of_scene).scene) if of_scene else varied
