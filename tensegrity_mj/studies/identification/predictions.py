"""Predictions of the measurements by a run with other parameters, and their derivatives: by an engine that
differentiates, or by central differences of any other."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any, ClassVar

import numpy as np

from tensegrity_mj.basics import interrupts
from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.basics.checks import warn_caller
from tensegrity_mj.engines.table import engine_settings
from tensegrity_mj.errors import DivergenceError, IdentificationWarning, OptionError
from tensegrity_mj.model.actuation import Actuation
from tensegrity_mj.model.scene import Scene
from tensegrity_mj.runs.comparison import resampled
from tensegrity_mj.runs.judgement import doubts
from tensegrity_mj.runs.trajectory import Status, Trajectory
from tensegrity_mj.simulation import simulate
from tensegrity_mj.studies import parameter_values, scene_parameters
from tensegrity_mj.studies.identification.measurements import Observation
from tensegrity_mj.studies.identification.unknowns import Unknowns
from tensegrity_mj.studies.parameters import NominalWinches
from tensegrity_mj.studies.store import Store

STEP = 1e-4  # of a parameter's size: differences are wrong by 1e-8 by their step, and by 1e-6 where runs are by 1e-10
FINEST = 1e-3  # s between samples of an engine that chooses its steps, where times of measurements are not regular
# Fields of structures that are arrays of the differentiable engine; of a scene, fields that change these.
DIFFERENTIATED = {
    "strings": ("stiffness", "damping", "rest_length", "tension", "force_density"),
    "rods": ("mass", "stiffness", "damping"),
    "point_masses": ("mass",),
}
CONSTANT = (*scene_parameters.MEMBERS, "nodes", "string_law", "duration")  # of which it has nothing else
NOT_DIFFERENTIATED = "JAX has no derivative by it; use another engine, as MuJoCo()"


@dataclass(eq=False)
class Predictions:
    """Predictions (n,) of parameters (P,), and their Jacobian (n, P) by central differences, by runs of any engine.

    Attributes:
        unknowns, observation: the parameters, and what is seen of a run.
        engine, law, actuation: as of `simulate`; the law stays as it is.
        noise: singular values of the Jacobian that are below so much of the largest are none.
    """

    unknowns: Unknowns
    observation: Observation
    engine: Any
    law: Any = None
    actuation: Actuation | None = None

    noise: ClassVar[float] = 1e-5

    def at(self, values: Array) -> tuple[Any, Any]:
        """The scene and the law; where the parameters are the plant's, the law believes in the scene that was given."""
        draft = self.unknowns.at(values)
        if draft.plant is None or self.law is None:
            return draft.plant or draft.scene, self.law
        return draft.plant, NominalWinches.between(self.law, draft.scene.structure, draft.plant.structure)

    def predict(self, values: Array) -> Array:
        """Simulate once, and return the predicted measurements.

        Raises:
            TensegrityError: as `simulate`; DivergenceError, too, for a run that ended before the last measurement.
        """
        run = self._run(values)
        if run.status is not Status.COMPLETED:
            raise DivergenceError(f"the run ends before the last measurement: {run.message}", float(run.time[-1]), run)
        self._check_slack(run.scene, run.tensions)
        found, structure = resampled(run, self.observation.times).values, run.scene.structure
        return self.observation.seen(found["nodes"], structure.string_lengths(found["nodes"]), found["tensions"])

    def doubts(self, values: Array) -> list[str]:
        """All that speaks against the run with these values."""
        return doubts(self._run(values))

    def _run(self, values: Array) -> Trajectory:
        (scene, law), (duration, interval) = self.at(values), self._grid
        return simulate(scene, law, self.engine, duration=duration, actuation=self.actuation, output_interval=interval)

    def jacobian(self, values: Array) -> Array:
        """Two runs a parameter."""
        return self._differences(self.predict, values)

    @cached_property
    def _grid(self) -> tuple[float, float]:
        """Duration and output interval [s]: samples at the measurements where these are regular, else fine ones.

        Between samples `resampled` interpolates. Measurements a moment apart, by two clocks, make no finer ones.
        """
        times, step = self.observation.times, getattr(self.engine, "timestep", None)
        fine = step or min(FINEST, times[-1] / len(times))
        gap = float(np.diff(times[times > 0], prepend=0.0).min())
        ratios = np.array([*(times / gap), *([gap / step] if step else [])])
        regular = gap > 0.1 * fine and np.all(np.abs(ratios - np.round(ratios)) < 1e-6)
        interval = gap if regular else fine
        return float(np.ceil(times[-1] / interval - 1e-6)) * interval, interval

    _slack_is_checked = False

    def _check_slack(self, scene: Scene, tensions: Array) -> None:
        """Warn, of the first run, of damped strings that come taut in it (T, M), where derivatives miss their jumps.

        The instant at which a string comes taut moves with the parameters, and its damper's force jumps there. Fixed
        steps begin it at the next one, and JAX without a window holds it where it is.
        """
        if self._slack_is_checked:
            return
        self._slack_is_checked, pulls = True, tensions != 0
        jumps = np.flatnonzero(pulls.any(axis=0) & ~pulls.all(axis=0) & (scene.structure.damping > 0))
        fixed = getattr(self.engine, "timestep", None) is not None and not getattr(self.engine, "locate_slack", False)
        if len(jumps) and getattr(self.engine, "spread", 0.0 if fixed else 1.0) == 0.0:
            name, engine = scene.structure.strings[jumps[0]].name, type(self.engine).__name__
            warn_caller(
                f"string '{name}' has a damper and comes taut: derivatives by {engine} miss its jump, and estimates "
                "are biased; use DAE(), MuJoCo(locate_slack=True) or JAX(window=2e-3)",
                IdentificationWarning,
            )

    def _differences(self, function: Callable[[Array], Array], values: Array, pattern: Array | None = None) -> Array:
        """Central differences (n, P) of a function of parameters (P,); at a bound, one-sided.

        Args:
            pattern: (n, P) ones where the function changes with a parameter, else zeros: where no two change the same,
                all are changed at once.
        """
        places, unknowns = np.arange(len(values)), self.unknowns
        apart = pattern is not None and pattern.sum(axis=1).max() <= 1
        found, step = [], STEP * unknowns.sizes
        for group in [places] if apart else places[:, None]:
            steps = np.where(np.isin(places, group), step, 0.0)
            low, high = (np.clip(values + one, unknowns.low, unknowns.high) for one in (-steps, steps))
            change = function(high) - function(low)
            found += [change * (1.0 if pattern is None else pattern[:, one]) / (high[one] - low[one]) for one in group]
        return np.stack(found, axis=1)


@dataclass(eq=False)
class Differentiated(Predictions):
    """Predictions of the engine that differentiates runs by arrays of numbers.

    What parameters make of these arrays, products and quotients of a few numbers, is differentiated by differences.
    """

    noise = 1e-7

    def __post_init__(self) -> None:
        import jax
        import jax.numpy as jnp
        from jax.flatten_util import ravel_pytree

        from tensegrity_mj.engines.jax.program import compiled
        from tensegrity_mj.engines.jax.settings import Derivatives, Method

        unknowns, observation = self.unknowns, self.observation
        # `_check_slack` warns where it is due: `model` is not to warn of every damper.
        engine = replace(self.engine, derivatives=Derivatives.FORWARD, window=self.engine.spread)
        options: dict[str, Any] = {"actuation": self.actuation}
        if engine.method is Method.RK4:
            options["duration"], options["output_interval"] = self._grid
        else:
            options["times"] = np.union1d(0.0, observation.times)  # of which one that is measured, and alone, is none
        for path in unknowns.paths:
            parts = parameter_values.parts_of(path.partition(".")[2], path)
            kind, last = parts[0].partition("[")[0], parts[-1]
            if last not in DIFFERENTIATED.get(kind, () if kind in CONSTANT else (last,)):
                raise OptionError(f"{path}: {NOT_DIFFERENTIATED}")
        program = engine.model(*self.at(unknowns.start), **options)
        _, restored = ravel_pytree(program.parameters)
        row = np.clip(np.searchsorted(program.times, observation.times, "right") - 1, 0, len(program.times) - 2)
        width = program.times[row + 1] - program.times[row]
        part = (observation.times - program.times[row]) / width

        def seen(arrays: Any) -> Any:
            """Resample a run as `resampled` does: nodes by Hermite's polynomials, tensions by straight lines."""
            run = program.run(restored(arrays))
            x, v, pulls = (jnp.moveaxis(one, 0, -1) for one in (run.nodes, run.velocities, run.tensions))
            x = (
                x[..., row]
                + part**2 * (3 - 2 * part) * (x[..., row + 1] - x[..., row])
                + width * part * (1 - part) * ((1 - part) * v[..., row] - part * v[..., row + 1])
            )
            lengths = program.model.strings.measure(x, x)[0]
            tensions = pulls[..., row] + part * (pulls[..., row + 1] - pulls[..., row])
            return observation.seen(*(jnp.moveaxis(one, -1, 0) for one in (x, lengths, tensions))), run.tensions

        def along(arrays: Any, changes: Any) -> Any:
            one = partial(jax.jvp, seen, (arrays,), has_aux=True)
            return jax.vmap(lambda change: one((change,)), out_axes=(None, 0, None))(changes)

        def arrays(values: Array) -> Array:
            return np.asarray(ravel_pytree(engine.model(*self.at(values), **options).parameters)[0])

        self._arrays, self._compile = arrays, partial(compiled, along)
        self._along: Callable[..., Any] | None = None
        self._last: tuple[Array, Array, Array] | None = None  # values, predictions, Jacobian
        # Not at the start, where a change may happen to be zero, as that of a slack string's rest length by stiffness.
        beside = np.clip(unknowns.start + 10 * STEP * unknowns.sizes, unknowns.low, unknowns.high)
        self._pattern = (self._differences(arrays, beside) != 0).astype(float)
        for path, changes in zip(unknowns.paths, self._pattern.T, strict=True):
            if not changes.any():
                raise OptionError(f"{path}: {NOT_DIFFERENTIATED}")

    def predict(self, values: Array) -> Array:
        """Simulate once; raise TensegrityError for values that a scene cannot have."""
        return self._at(values)[1]

    def jacobian(self, values: Array) -> Array:
        """All parameters at once."""
        return self._at(values)[2]

    def doubts(self, values: Array) -> list[str]:
        """Return no doubts: these runs are arrays, which have no reports."""
        return []

    def _at(self, values: Array) -> tuple[Array, Array, Array]:
        """Both by one compiled function: to compile a second one takes as long as many runs."""
        if self._last is None or not np.array_equal(self._last[0], values):
            with interrupts.deferred():  # one that is raised while a thread of XLA compiles ends in its memory
                given = self._arrays(values), self._differences(self._arrays, values, self._pattern).T
                self._along = self._along or self._compile(*given)
                found, slopes, tensions = map(np.asarray, self._along(*given))
            self._check_slack(self.at(values)[0], tensions)
            self._last = values.copy(), found, slopes.T
        return self._last


def predictions_of(unknowns: Unknowns, observation: Observation, engine: Any, *how: Any) -> Predictions:
    kind = Differentiated if engine_settings(engine)[0] == "jax" else Predictions
    return kind(unknowns, observation, engine, *how)


class StoredPredictions:
    """Predictions of which those that a study's folder has are read there, and all others are kept."""

    def __init__(self, of: Predictions, store: Store) -> None:
        self.noise = of.noise

        def stored(what: str, values: Array) -> Array:
            point = {what: values.tolist()}
            return np.array(store.once(point, lambda: {"found": getattr(of, what)(values)})["found"])

        self.predict: Callable[[Array], Array] = partial(stored, "predict")
        self.jacobian: Callable[[Array], Array] = partial(stored, "jacobian")
        self.doubts: Callable[[Array], list[str]] = lambda values: stored("doubts", values).tolist()
