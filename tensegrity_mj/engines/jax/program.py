"""A run, or many, as an array function of its parameters, and as a trajectory."""

from __future__ import annotations

import os
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from copy import copy
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import ArrayLike

from tensegrity_mj.basics import interrupts
from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.basics.checks import check_known, instance, real_array, shape_of, warn_caller
from tensegrity_mj.basics.texts import value_text
from tensegrity_mj.controllers.scenes import law_for
from tensegrity_mj.dynamics.native.law import NativeLaw, Report
from tensegrity_mj.engines.driving import Grid, Stopwatch, output_times, progress
from tensegrity_mj.engines.jax.effects import array_effects
from tensegrity_mj.engines.jax.laws import array_law
from tensegrity_mj.engines.jax.model import (
    EXTERNAL,
    LOST,
    STORED,
    TO_THE_END,
    UNDEFINED,
    VOID,
    WINCH,
    WORKS,
    ControlledSteps,
    FixedSteps,
    Held,
    Model,
    Observed,
    Prepared,
    State,
)
from tensegrity_mj.engines.jax.settings import JAX, Method
from tensegrity_mj.engines.recording import Account, check_rows, make_trajectory
from tensegrity_mj.engines.request import Request, request_for, settled
from tensegrity_mj.engines.requirements import require
from tensegrity_mj.errors import ControllerError, DerivativeWarning, DivergenceError, OptionError
from tensegrity_mj.model import capabilities, rods
from tensegrity_mj.model.actuation import Actuation, Mode, OnInfeasible
from tensegrity_mj.model.scene import Scene
from tensegrity_mj.runs.energy import check_energy
from tensegrity_mj.runs.trajectory import Status, Trajectory

VERSIONS = {one.__name__: one.__version__ for one in (jax, diffrax)}  # which decide the numbers


def trajectory_of(
    engine: JAX, request: Request, rows: Observed, cost: dict[str, float], ended: int = TO_THE_END
) -> Trajectory:
    """The trajectory of a run's rows, (T, ...) each, with what it cost, and how it `ended`.

    Raises:
        ControllerError: where the law returned something that is not finite.
        DivergenceError: with what was recorded before, where the run did not come to its end.
    """
    structure = request.scene.structure
    good = np.all(np.isfinite(rows.nodes), axis=(1, 2)) & np.all(np.isfinite(rows.velocities), axis=(1, 2))
    count = len(good) if good.all() else int(np.argmin(good))
    void = np.flatnonzero((rows.works[:, VOID] > 0) & np.isfinite(rows.works[:, VOID]))
    first_void = int(void[0]) if len(void) else count
    status, message = Status.COMPLETED, ""
    if request.law.own is not None and (len(void) > 0 or ended == UNDEFINED) and first_void <= count:
        count = max(1, first_void)
        after = f"after t = {rows.time[count - 1]:.6g} s (known at recorded times)"
        if np.all(np.isnan(rows.report[: count + 1, Report.FEASIBILITY_MARGIN])):
            raise ControllerError(f"the law returned a value that is not finite {after}; it must be for every string")
        status = Status.INFEASIBLE
        message = (
            f"the law has no admissible solution {after}; "
            "change the target or the options of the law, or take another engine with OnInfeasible.PASSIVE"
        )
    rows = Observed(*(np.asarray(one)[:count] for one in rows))
    T, elastic = len(rows.time), rows.elastic_tensions
    energy = np.sum(structure.curves.stored(rows.lengths - rows.rest_lengths, elastic), axis=1)
    winch = np.zeros(T)
    if request.actuation.mode is Mode.HOLD_REST_LENGTH:
        winch = rows.works[:, WINCH]
    elif request.law.own is not None:  # by parts, -∫ T dL0 = Δ(energy) - ∫ T dL
        winch = energy - energy[:1] - rows.works[:, STORED]
    columns = [
        rows.nodes.reshape(T, -1),
        rows.velocities.reshape(T, -1),
        rows.rest_lengths,
        elastic,
        rows.tensions,
        winch[:, None],
        rows.works[:, [LOST, EXTERNAL]],
        rows.report,
    ]
    multipliers = rows.rod_force_densities * structure.rod_lengths**2 / rods.inertia_of_rods(structure)[1]
    options = {name: getattr(one, "value", one) for name, one in vars(engine).items()}

    def made(how: Status, text: str) -> Trajectory:
        account = Account(how, text, cost, {"name": "JAX", "versions": VERSIONS, **options}, {}, rows.constraint_forces)
        return make_trajectory(request, engine, None, rows.time, np.concatenate(columns, axis=1), multipliers, account)

    remedy = (
        f"reduce the time step (h = {engine.timestep:g} s)"
        if engine.timestep is not None
        else "loosen the tolerances, raise max_steps, or choose Method.RK4"
    )
    if status is Status.COMPLETED and (ended != TO_THE_END or count < len(good)):
        partial = made(Status.DIVERGED, "diverged")
        check_energy(partial, remedy)
        time = float(rows.time[-1]) if T else 0.0
        raise DivergenceError(f"diverged after t = {time:.6g} s; {remedy}", time, partial)
    run = made(status, message)
    check_energy(run, remedy)
    return run


PIECES = 16  # of a run at least, between which Ctrl-C is heard
MOST_ROWS, MOST_STEPS = 64, 1000  # of a piece: a second or less, where DOPRI8's steps do not shrink within
QUIET = 2.0  # s of compiling without a word
FORWARD = 'DOPRI8 differentiates backwards (jax.grad, jax.jacrev) unless it is made with derivatives="forward"'


class Program:
    """Run as a function of its parameters, made by `JAX.model`: `parameters`, `times` (T,) [s], and `run`.

    Attributes:
        parameters: of the scene and its law as they are; see `Model`.
        times: (T,) [s] at which runs are recorded.
        model, steps: what is integrated, and how.
        kinds: pieces that are compiled.
    """

    def __init__(self, engine: JAX, request: Request, times: Array | None = None) -> None:
        scene, self.engine, self.request = request.scene, engine, request
        require(engine, scene)
        own, law = request.law.own, None
        if own is not None:
            capabilities.require_rest_lengths(scene.structure)
            if request.on_infeasible is OnInfeasible.PASSIVE:
                raise OptionError(
                    "on_infeasible = OnInfeasible.PASSIVE: where a law has no solution, the engine JAX stops: use "
                    "OnInfeasible.STOP, or another engine"
                )
            law = array_law(own, scene.structure)
        self.model = Model(scene, array_effects(scene), law, request.actuation, engine.spread)
        self.parameters = self.model.parameters
        self.steps: FixedSteps | ControlledSteps
        if engine.timestep is not None:
            self.steps = FixedSteps(Grid.of(request, engine.timestep), scene.break_times)
        elif request.sampled:
            raise OptionError(
                f"actuation '{request.actuation.mode.value}': the law is sampled at steps of JAX's Method.RK4: use it, "
                "with a timestep that divides the control period"
            )
        else:
            times = output_times(request) if times is None else times
            self.steps = ControlledSteps(request.begin, times, scene.break_times, engine)
        self.times = self.steps.times
        self.kinds: dict[tuple[int, ...], Callable[..., Any]] = {}
        self._compiling = threading.Lock()

    def run(self, parameters: Any) -> Observed:
        """A run, with times first, as a function to be compiled and differentiated: (T, N, 3) nodes and so on.

        Rods and bodies are made as long and as rigid as they are at the first step, where `nodes` are not. Rows are NaN
        from where DOPRI8 gave up (`max_steps`).

        Args:
            parameters: like `self.parameters`; where `nodes` have a batch last, others may have the same.

        Raises:
            OptionError: for parameters of other names or shapes, where DOPRI8 is differentiated the other way than
                `derivatives` says.
        """
        at = self.model.prepare(alike(parameters, self.parameters))
        state, held = self.model.start(at)
        parts = []
        for piece in self.steps.pieces(lambda rows: [rows]):
            try:
                found = self.steps.advance(piece.kind, self.model, at, state, held, piece.given)
            except TypeError as error:
                if "custom_vjp" not in str(error):
                    raise
                raise OptionError(f"{FORWARD}: {error}") from error
            state, held, ended, recorded = found.state, found.held, found.ended, piece.recorded
            parts.append(
                jax.tree.map(lambda x, k=recorded, end=ended: jnp.where(end == TO_THE_END, x[k], jnp.nan), found.rows)
            )
        return jax.tree.map(lambda *x: jnp.concatenate(x), *parts)

    def accelerations(self) -> Callable[..., tuple[Array, Array]]:
        """See `Accelerations`."""
        model, p = self.model, self.parameters

        @jax.jit
        def found(t: Any, nodes: Any, velocities: Any, rest: Any) -> tuple[Any, Any]:
            at = model.prepare({**p, "rest_lengths": rest})
            places, rates = model.system.state(nodes, velocities, t)
            state = State(places, rates, jnp.zeros(WORKS))
            whole = (self.request.scene.break_times > t).astype(float)
            _, observed, accelerations = model.evaluate(at, t, state, Held(rest, jnp.zeros(5)), whole)
            return observed.nodes, accelerations

        def at(t: float, nodes: Array, velocities: Array, rest_lengths: Array | None = None) -> tuple[Array, Array]:
            rest = p["rest_lengths"] if rest_lengths is None else rest_lengths
            places, accelerations = found(float(t), nodes, velocities, rest)
            return np.array(places), np.array(accelerations)

        return at

    def trajectory(self) -> Trajectory:
        """The run of the parameters as they are, in pieces."""
        return trajectory_of(self.engine, self.request, *self.rows(str(self.engine)))

    def rows(self, label: str) -> tuple[Observed, dict[str, float], int]:
        """The rows of the parameters as they are, what they cost, and how they ended; in pieces, with progress."""
        model, take = self.model, self.steps.advance

        def begin(model: Model, p: Any) -> tuple[Prepared, State, Held, Any]:
            at = model.prepare(p)
            state, held = model.start(at)
            if self.model.law is None:  # there is always a command
                return at, state, held, None
            t, whole = self.request.begin, (self.request.scene.break_times > self.request.begin).astype(float)
            return at, state, held, jax.tree.map(lambda x: x[None], model.evaluate(at, t, state, held, whole)[1])

        at, state, held, row = compiled(partial(begin, model), self.parameters)(self.parameters)
        parts: list[Any] = []
        watch, steps, ended = Stopwatch(), 0, TO_THE_END
        # Where the law has no command at the start, strings are as they are.
        if row is not None and np.all(row.works[0, VOID] > 0):
            lawless = Model(self.request.scene, model.effects, None, self.request.actuation, 0.0)
            still = compiled(partial(begin, lawless), self.parameters)(self.parameters)[-1]
            parts.append(still._replace(works=row.works, report=row.report))
        most = [max(1, min(MOST_ROWS, MOST_STEPS // self.steps.stride))]
        with progress(self.request, label) as show:
            for piece in () if parts else self.steps.pieces(partial(pieces, most=most)):
                before = time.perf_counter()
                with self._compiling:
                    if piece.kind not in self.kinds:
                        made = compiled(partial(take, piece.kind, model), at, state, held, piece.given)
                        self.kinds[piece.kind] = made
                interrupts.raise_if_requested()
                watch.start += time.perf_counter() - before
                state, held, rows, more, how = self.kinds[piece.kind](at, state, held, piece.given)
                steps, ended = steps + int(more), int(how)
                if more > 2 * MOST_STEPS:  # by steps and not by seconds, which would make results depend on these
                    most[0] = max(1, (len(rows.time) - 1) * MOST_STEPS // int(more))
                parts.append(jax.tree.map(lambda x, k=piece.recorded: np.asarray(x)[k], rows))
                show(piece.end)
                interrupts.raise_if_requested()
                if ended != TO_THE_END or not np.any(np.isfinite(rows.nodes[-1])):
                    break
        cost = {"wall_time": watch.seconds, "steps": steps, "evaluations": self.steps.stages * steps}
        return jax.tree.map(lambda *x: np.concatenate(x), *parts), cost, ended


def program_of(
    engine: JAX,
    scene: Scene,
    controller: Any,
    duration: float | None,
    actuation: Actuation | None,
    output_interval: float | None,
    times: ArrayLike | None,
) -> Program:
    """Make the program of a run; see `JAX.model`."""
    instance("scene", scene, Scene, "use a Scene, or load_scene(name or path)")
    require(engine, scene)
    controller = law_for(scene, controller)
    if controller is not None and (isinstance(controller, type) or not callable(controller)):
        raise OptionError(f"controller = {value_text(controller)}; use a law, as controllers.from_scene(scene, name)")
    found = None
    if times is not None:
        begin = float(scene.start_time)
        found = _instants(engine, times, duration, output_interval, begin)
        duration = float(found[-1]) - begin
    options = duration, actuation, OnInfeasible.STOP, output_interval, False
    request = request_for(scene, controller, *options, lambda law, _: NativeLaw(0, 0, (), own=law))
    engine, request, _ = settled(engine, request)
    structure = scene.structure
    damped = np.flatnonzero((structure.damping > 0) & ~structure.curves.constant)
    if len(damped) and engine.method is Method.DOPRI8 and engine.window is None:
        warn_caller(
            f"string '{structure.strings[damped[0]].name}' has a damper: where it comes taut in a run, derivatives "
            "by DOPRI8 miss its jump; use window=2e-3 [s], or window=0 where no damped string comes taut",
            DerivativeWarning,
        )
    return Program(engine, request, found)


def _instants(engine: JAX, times: ArrayLike, duration: float | None, interval: float | None, begin: float) -> Array:
    """Check `times` (T,) of `model`."""
    if engine.method is Method.RK4:
        raise OptionError("times: RK4 records at multiples of output_interval; use that, or Method.DOPRI8")
    if duration is not None or interval is not None:
        raise OptionError("times: they have duration and output_interval in them; leave these out")
    found = real_array("times", times, shape_of(times) or (2,), "s", scalar=False)
    if found.ndim != 1 or len(found) < 2 or found[0] < begin or np.any(np.diff(found) <= 0):
        raise OptionError(f"times = {value_text(times)}; two or more must rise from {begin:g} s or later")
    return found


def alike(given: Any, own: Any) -> Any:
    """Parameters of a run as arrays, if they have the names and shapes of a program's own.

    Raises:
        OptionError: naming the one that has not.
    """
    instance("parameters", given, dict, "use a dict as the program's own, {**program.parameters, ...}")
    for name in given:
        check_known("parameters", name, own, "parameter")
    if missing := [name for name in own if name not in given]:
        raise OptionError(f"parameters: '{missing[0]}' is missing; use {{**program.parameters, ...}}")
    batch, found = jnp.shape(given["nodes"])[2:], {}
    for name, expected in own.items():
        leaves, tree = jax.tree_util.tree_flatten_with_path(expected)
        try:
            values = [jnp.asarray(one) for one in tree.flatten_up_to(given[name])]
        except (TypeError, ValueError) as error:
            raise OptionError(f"parameters['{name}']: {error}") from error
        for (path, leaf), value in zip(leaves, values, strict=True):
            if value.shape not in (shape := np.shape(leaf), (*shape, *batch)):
                place, more = jax.tree_util.keystr(path), f" or {(*shape, *batch)}" if batch else ""
                raise OptionError(f"parameters['{name}']{place} has shape {value.shape}; it must be {shape}{more}")
        found[name] = tree.unflatten(values)
    return found


def pieces(rows: int, most: list[int]) -> Iterator[int]:
    """Rows in pieces of at most `most[0]` each, twenty or so of a short run, of one size where a divisor is near."""
    least = max(PIECES, -(-rows // most[0]))
    count = next((n for n in range(least, 2 * least) if rows % n == 0), min(rows, least))
    size = -(-rows // count)
    while rows:
        size = min(size, most[0], rows)
        yield size
        rows -= size


def compiled(function: Callable[..., Any], *arguments: Any) -> Callable[..., Any]:
    """Compile a function for arguments like these; if it takes long, print why."""
    from tqdm import tqdm  # which writes next to its bars

    words = "tensegrity-mj: JAX prepares this run; programs of fixed steps are kept for the next process"
    timer = threading.Timer(QUIET, lambda: tqdm.write(words, file=sys.stderr))
    timer.start()
    try:
        return jax.jit(function).lower(*arguments).compile()
    finally:
        timer.cancel()


# What runs may differ in, as well as their starts, and what they may not.
OF_STRINGS = ("stiffness", "damping", "rest_length", "force_density", "tension")
SAME = ("gravity", "loads", "breaks", "motions", "resistance", "water", "elements")


class JAXEnsemble:
    """Runs of scenes that differ in their starts and in their strings' numbers.

    Attributes:
        options: the engine.
        members: when `run` is done, a run each, which `conclude`s with its trajectory or its error.
        times: (T,) [s] of their rows.
        seconds: wall time of the integration of all.
        steps: of all runs together.
        blocks: how many threads have a part of the runs each: XLA computes a small array on one core.
    """

    def __init__(self, options: JAX, requests: Sequence[Request], threads: int) -> None:
        if options.timestep is None:
            raise OptionError("simulate_many: engine JAX: the steps of many are fixed: use Method.RK4 and a timestep")
        self.options, self.requests, first = options, requests, requests[0]
        for number, request in enumerate(requests):
            if request.law.own is not first.law.own:
                raise OptionError(f"simulate_many: controllers[{number}] is another law than the first; JAX runs one")
            _check_alike(number, request.scene, first.scene)
        self.program, self.grid = Program(options, first), Grid.of(first, options.timestep)
        own = [self.program.model.own_parameters(request.scene) for request in requests]
        self.batched = tuple(own[0])
        self.program.parameters |= {name: np.stack([one[name] for one in own], axis=-1) for name in self.batched}
        width = self.program.parameters["nodes"].size // len(requests) * 2
        check_rows(float(len(requests)) * len(self.program.times), width)
        self.members: list[_Member] = []
        self.times, self.seconds, self.steps = self.grid.times, 0.0, 0
        alone = jax.default_backend() != "cpu"  # a GPU takes them all at once
        wanted = range(min(1 if alone else threads or os.cpu_count() or 1, len(requests)), 0, -1)
        self.blocks = next(count for count in wanted if len(requests) % count == 0)  # of one size, on a thread each

    def run(self) -> None:
        """Simulate all runs; a run that fails raises nothing here."""
        size, label = len(self.requests) // self.blocks, f"{self.options}, {len(self.requests)} runs"

        def block(number: int) -> tuple[Observed, dict[str, float], int]:
            own = copy(self.program)
            mine = slice(number * size, (number + 1) * size)
            own.parameters = {**own.parameters, **{name: own.parameters[name][..., mine] for name in self.batched}}
            own.request = replace(own.request, progress=own.request.progress and number == 0)
            return own.rows(label)

        with ThreadPoolExecutor(self.blocks) as pool:
            for number, (rows, cost, _) in enumerate(pool.map(block, range(self.blocks))):
                self.seconds = max(self.seconds, cost["wall_time"])
                for place, request in enumerate(self.requests[number * size : (number + 1) * size]):
                    own = Observed(*(one if one.ndim == 1 else one[..., place] for one in rows))
                    self.members.append(_Member(self.options, request, self.grid, own, cost))
                self.steps += size * int(cost["steps"])

    @property
    def cost(self) -> dict[str, float]:
        """Wall time [s], steps and evaluations of all runs together."""
        evaluations = self.steps * self.program.steps.stages
        return {"wall_time": self.seconds, "steps": self.steps, "evaluations": evaluations}


@dataclass(frozen=True)
class _Member:
    """One of the runs; of its end, rows of NaN say all."""

    options: JAX
    request: Request
    grid: Grid
    observed: Observed
    cost: dict[str, float]
    ended_early: float | None = None

    @property
    def rows(self) -> Array:
        """Positions and velocities (T, 6N), NaN after its end."""
        T = len(self.observed.time)
        found = np.full((len(self.grid.times), 2 * self.observed.nodes[0].size), np.nan)
        found[:T] = np.stack([self.observed.nodes, self.observed.velocities], axis=1).reshape(T, -1)
        return found

    def conclude(self, seconds: float) -> Trajectory:
        """Return its trajectory; it raises what `JAX.run` would."""
        return trajectory_of(self.options, self.request, self.observed, self.cost | {"wall_time": seconds})


def _check_alike(number: int, scene: Scene, first: Scene) -> None:
    """Raise OptionError where a scene differs from the first in more than its start and its strings' numbers."""
    if scene is first:
        return
    differs = [name for name in SAME if getattr(scene, name) != getattr(first, name)]
    one, other = scene.structure, first.structure
    if one is not other:
        pairs = list(zip(one.strings, other.strings, strict=True))
        strings = tuple(replace(b, **{key: getattr(a, key) for key in OF_STRINGS}) for a, b in pairs)
        if strings != one.strings or any(a.is_constant != b.is_constant for a, b in pairs):
            differs.append("strings (in more than stiffness, damping and how they are taut)")
        elif replace(one, strings=other.strings) != other:
            differs.append("structure")
    if differs:
        raise OptionError(
            f"scenes[{number}] ('{scene.name}'): its {differs[0]} differ from the first scene's; JAX runs many that "
            "differ in their starts and in stiffness, damping and rest lengths of strings: use MuJoCo, or run_many"
        )
