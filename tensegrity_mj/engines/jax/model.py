"""A scene, its law and its actuation as pure functions of parameters: rates, steps, what is observed; and runs of them.

A run is made by fixed steps of classical Runge-Kutta by scan, or by diffrax' Dopri8 with controlled errors. Either is
made in pieces, each of which begins with a state at an instant and gives the state at its end.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from itertools import chain
from typing import Any, NamedTuple

import diffrax
import jax
import jax.numpy as jnp
import numpy as np

from tensegrity_mj.basics.arrays import Array, IntArray
from tensegrity_mj.dynamics.native.law import Report
from tensegrity_mj.engines.driving import Grid
from tensegrity_mj.engines.jax.arrays import ArrayEffect, ArrayLaw, Arrays, lifted, times
from tensegrity_mj.engines.jax.settings import JAX, Derivatives
from tensegrity_mj.engines.jax.strings import Strings
from tensegrity_mj.engines.jax.system import Mobility, System
from tensegrity_mj.model.actuation import Actuation, Mode
from tensegrity_mj.model.scene import Scene

# The works [J] that are integrated or counted along with the motion; and VOID, above zero where a law had no command.
STORED, LOST, EXTERNAL, WINCH, VOID = range(5)
WORKS = 5
TO_THE_END, GAVE_UP, UNDEFINED = range(3)  # how a piece ended: UNDEFINED where rates are not finite
SHORTEST = 1e-30  # s, far below round-off of times: to such steps Dopri8 comes where it can go no further
Split = Callable[[int], Iterable[int]]  # how many rows in which pieces


class State(NamedTuple):
    """State that is integrated: s and ṡ of `System`, and the works [J] (5, ...)."""

    places: Any
    rates: Any
    works: Any


class Held(NamedTuple):
    """Values held from sample to sample: rest lengths or force densities (M, ...), and the law's report (5, ...)."""

    command: Any
    report: Any


class Observed(NamedTuple):
    """Record of an instant; of a run, with times first.

    Attributes:
        time: [s].
        nodes, velocities: (N, 3, ...) [m], [m/s].
        lengths, rest_lengths: of the strings (M, ...) [m].
        elastic_tensions, tensions: (M, ...) [N].
        rod_force_densities: (R, ...) [N/m] of rigid rods, negative in compression; NaN of elastic ones.
        constraint_forces: (C, ...) [N].
        works: (5, ...) [J]: Σ ∫ T_elastic dL, what is lost, given from outside, given by winches at jumps of L0; > 0
            where the law has, or had, no command.
        report: (5, ...) of the law.
    """

    time: Any
    nodes: Any
    velocities: Any
    lengths: Any
    rest_lengths: Any
    elastic_tensions: Any
    tensions: Any
    rod_force_densities: Any
    constraint_forces: Any
    works: Any
    report: Any


class Prepared(NamedTuple):
    """Parameters, and the mobility W that follows from them where it does not change within a run."""

    parameters: Arrays
    mobility: Mobility | None


class Model:
    """A scene under a law, as functions of parameters.

    Attributes:
        parameters: the scene's own: `rest_lengths`, `stiffness`, `damping` (M,) of the strings, `rod_masses` (R,),
            `point_masses` (P,), `gravity` (3,), `nodes` and `velocities` (N, 3) of the start, `effects`, a list of
            mappings in the order of `scene.effects`, and `law`. Nodes and velocities may have a batch last, as may
            what is per string.
        sampled: whether the law is sampled.
        whole: (M,) ones, of strings none of which is broken.
        rates: of the state alone, with the arguments of `evaluate`.
    """

    def __init__(
        self, scene: Scene, effects: list[ArrayEffect], law: ArrayLaw | None, actuation: Actuation, window: float
    ) -> None:
        self.scene, self.structure, self.law, self.effects = scene, scene.structure, law, effects
        self.system, self.strings = System(scene), Strings(scene.structure, window)
        self.mode = actuation.mode if law is not None else None
        self.moves = self.mode in (Mode.CONTINUOUS, Mode.HOLD_FORCE_DENSITY)  # rest lengths, within a step
        self.sampled = self.mode in (Mode.HOLD_FORCE_DENSITY, Mode.HOLD_REST_LENGTH)
        self.whole = np.ones(len(self.structure.strings))
        # Traced once for all stages of a step.
        self.rates: Callable[..., State] = jax.jit(lambda *given: self.evaluate(*given)[0])
        self.limits = {name: self.structure.limits(name) for name in ("max_force_density", "min_rest_length")}
        self.limited = any(np.isfinite(values).any() for values in self.limits.values())
        self.reach = self.structure.limits("winch_speed") * (actuation.period or np.inf)
        self.parameters: dict[str, Any] = {
            **self.system.parameters(),
            **self.own_parameters(scene),
            "effects": [dict(effect.parameters) for effect in effects],
            "law": {} if law is None else law.parameters,
        }

    def own_parameters(self, scene: Scene) -> dict[str, Any]:
        """Parameters in which scenes that share a model may differ: their starts, and the numbers of their strings."""
        start = {"nodes": np.array(scene.nodes0), "velocities": np.array(scene.velocities0)}
        return self.strings.parameters(scene.structure) | start

    def prepare(self, parameters: Arrays) -> Prepared:
        """Compute what does not change within a run."""
        return Prepared(parameters, None if self.system.wet else self.system.mobility(parameters))

    def start(self, at: Prepared) -> tuple[State, Held]:
        """The state at the start, and what is held from there."""
        nodes, velocities = (jnp.asarray(at.parameters[name]) for name in ("nodes", "velocities"))
        begin = float(self.scene.start_time)
        places, rates = self.system.state(nodes, velocities, begin)
        batch = nodes.shape[2:]
        state = State(places, rates, jnp.zeros((WORKS, *batch)))
        rest = jnp.broadcast_to(lifted(at.parameters["rest_lengths"], state.works), (len(self.whole), *batch))
        held = Held(rest, jnp.full((len(Report), *batch), np.nan))
        return (state, held) if not self.sampled else self.sample(at, begin, state, held, self.whole, first=True)

    def _command(self, at: Prepared, t: Any, x: Any, v: Any, lengths: Any) -> tuple[Any, Any]:
        """The law's command (M, ...) within its limits, and its report."""
        assert self.law is not None
        p = at.parameters
        command, report = self.law.command(p["law"], t, x, v)
        if self.limited:
            most, least = (lifted(self.limits[name], lengths) for name in ("max_force_density", "min_rest_length"))
            # Of no limit no bound is found: its derivative by the lengths would be 0 · ∞.
            has_most, has_least = jnp.isfinite(most), jnp.isfinite(least)
            if self.law.returns_lengths:
                shortest = self.strings.rest_lengths(p, lengths, jnp.where(has_most, most, 0.0))
                command = jnp.maximum(jnp.maximum(command, least), jnp.where(has_most, shortest, -jnp.inf))
            else:
                largest = lifted(p["stiffness"], lengths) * (1 - jnp.where(has_least, least, 0.0) / lengths)
                command = jnp.minimum(jnp.minimum(command, most), jnp.where(has_least, largest, jnp.inf))
        return command, jnp.broadcast_to(lifted(report, lengths), (len(Report), *lengths.shape[1:]))

    def _as_lengths(self, at: Prepared, lengths: Any, command: Any) -> Any:
        """A command as rest lengths (M, ...)."""
        assert self.law is not None
        return command if self.law.returns_lengths else self.strings.rest_lengths(at.parameters, lengths, command)

    def _rest(self, at: Prepared, t: Any, x: Any, v: Any, lengths: Any, held: Held) -> tuple[Any, Any]:
        """Rest lengths (M, ...) now, and the report of the law."""
        if self.mode is Mode.CONTINUOUS:
            command, report = self._command(at, t, x, v, lengths)
            return self._as_lengths(at, lengths, command), report
        if self.mode is Mode.HOLD_FORCE_DENSITY:
            return self.strings.rest_lengths(at.parameters, lengths, held.command), held.report
        return held.command, held.report

    def sample(
        self, at: Prepared, t: Any, state: State, held: Held, whole: Any, first: bool = False
    ) -> tuple[State, Held]:
        """Renew what is held; the winches' work at the jump of the rest lengths is counted."""
        x, v, _ = self._nodes(t, state)
        lengths = self.strings.measure(x, v)[0]
        before = held.command if first else self._rest(at, t, x, v, lengths, held)[0]
        command, report = self._command(at, t, x, v, lengths)
        rest = self._as_lengths(at, lengths, command)
        if self.mode is Mode.HOLD_REST_LENGTH:
            reach = lifted(self.reach, rest)
            command = rest = jnp.clip(rest, before - reach, before + reach)
        elif self.law is not None and self.law.returns_lengths:
            command = self.strings.densities(at.parameters, lengths, rest)
        held = Held(command, report)
        if first:
            return state, held
        old, new = (self.strings.energy(at.parameters, lengths, one, whole).sum(axis=0) for one in (before, rest))
        return state._replace(works=state.works.at[WINCH].add(new - old)), held

    def _nodes(self, t: Any, state: State) -> tuple[Any, Any, tuple[Any, ...]]:
        """Return x and v (N, 3, ...), and y, ẏ and what is prescribed."""
        prescribed = self.system.prescribed(t)
        y = self.system.vectors(state.places, prescribed[0])
        rates = self.system.vectors(state.rates, prescribed[1])
        return self.system.nodes(y, prescribed[0]), self.system.nodes(rates, prescribed[1]), (y, rates, prescribed)

    def acting(self, at: Prepared, t: Any, x: Any, v: Any) -> tuple[Any, Any, Any]:
        """Forces of the elements (N, 3, ...), and the powers that are lost and given (...) [W]."""
        total, lost, given = jnp.zeros_like(x), jnp.zeros(x.shape[2:]), jnp.zeros(x.shape[2:])
        for effect, p in zip(self.effects, at.parameters["effects"], strict=True):
            if effect.energy is not None:
                energy: Callable[..., Any] = effect.energy
                total = total - jax.grad(lambda x, f=energy, p=p: jnp.sum(f(p, t, x)))(x)
            forces: Any = 0.0
            if effect.dissipation is not None:
                potential: Callable[..., Any] = effect.dissipation
                forces = forces - jax.grad(lambda v, f=potential, p=p: jnp.sum(f(p, t, x, v)))(v)
            if effect.force is not None:
                forces = forces + effect.force(p, t, x, v)
            power = jnp.sum(forces * v, axis=(0, 1))
            total = total + forces
            if effect.gives:
                given = given + power
                continue
            driven = 0.0 if effect.given is None else effect.given(p, t, x, v)
            lost, given = lost + driven - power, given + driven
        return total, lost, given

    def mobility(self, at: Prepared, t: Any, x: Any) -> Mobility:
        """The mobility at nodes x."""
        if at.mobility is not None:
            return at.mobility
        pairs = zip(self.effects, at.parameters["effects"], strict=True)
        alphas = sum(one.alpha(q, t, x) for one, q in pairs if one.alpha is not None)
        return self.system.mobility(at.parameters, self.system.added(alphas, x))

    def evaluate(self, at: Prepared, t: Any, state: State, held: Held, whole: Any) -> tuple[State, Observed, Any]:
        """The state's rates, what is observed of it, and the accelerations of the nodes (N, 3, ...)."""
        x, v, (y, rates, prescribed) = self._nodes(t, state)
        p, system = at.parameters, self.system
        lengths, speeds, units = self.strings.measure(x, v)
        rest, report = self._rest(at, t, x, v, lengths, held)
        elastic, tensions = self.strings.tighten(p, lengths, speeds, rest, whole, self.moves)
        acting, lost, given = self.acting(at, t, x, v)
        forces = self.strings.pull(units, tensions) + acting
        mobility = self.mobility(at, t, x)
        weight = lifted(jnp.outer(mobility.mass @ system.shifted, p["gravity"]), forces)
        outer = times(system.maps.T, forces) + weight
        moved = prescribed[2]
        found, mu, reactions = system.accelerate(mobility, y, rates, outer, moved)
        accelerations = system.nodes(found, moved)
        if mobility.added is not None:
            given = given + jnp.sum(mobility.answer(found) * rates, axis=(0, 1))
        if not system.still:  # what moves supports and fixed nodes gives their reactions' work
            given = given + jnp.sum(reactions * lifted(prescribed[1].vectors, y), axis=(0, 1))
            given = given - jnp.sum(forces * lifted(prescribed[1].nodes, x), axis=(0, 1))
        stored = jnp.sum(elastic * speeds, axis=0)
        lost = lost + jnp.sum((tensions - elastic) * speeds, axis=0)
        failed = jnp.all(jnp.isfinite(lengths), axis=0) & ~jnp.all(jnp.isfinite(rest), axis=0)
        void = jnp.where(failed | (report[Report.FEASIBILITY_MARGIN] <= 0), 1.0, 0.0)
        powers = jnp.stack([stored, lost, given, jnp.zeros_like(stored), void])
        densities = jnp.full((len(self.structure.rods), *mu.shape[1:]), np.nan)
        densities = densities.at[system.rigid].set(mu[: len(system.rigid)])
        held_by = times(system.of_constraints, reactions.reshape(-1, *reactions.shape[2:]))
        time, works = jnp.asarray(t, float), state.works.at[VOID].add(void)
        observed = Observed(time, x, v, lengths, rest, elastic, tensions, densities, held_by, works, report)
        changes = State(system.reduced(rates, prescribed[1]), system.reduced(found, moved), powers)
        return changes, observed, accelerations

    def step(self, at: Prepared, t: Any, h: float, state: State, held: Held, whole: Any) -> State:
        """Make one step of classical Runge-Kutta, then project the state onto the constraints."""
        add: Callable[..., Any] = lambda x, k, f: jax.tree.map(lambda a, b: a + f * b, x, k)  # noqa: E731
        one = self.rates(at, t, state, held, whole)
        two = self.rates(at, t + 0.5 * h, add(state, one, 0.5 * h), held, whole)
        three = self.rates(at, t + 0.5 * h, add(state, two, 0.5 * h), held, whole)
        four = self.rates(at, t + h, add(state, three, h), held, whole)
        mean = jax.tree.map(lambda a, b, c, d: (a + 2 * (b + c) + d) / 6, one, two, three, four)
        return self.projected(at, t + h, add(state, mean, h))

    def projected(self, at: Prepared, t: Any, state: State) -> State:
        """Project the state onto the constraints: rod lengths and rigid bodies."""
        if not len(self.system.pairs):
            return state
        _, _, (y, rates, (place, rate, _)) = self._nodes(t, state)
        mobility = at.mobility or self.system.mobility(at.parameters)
        y, rates = self.system.projected(mobility, y, rates)
        return state._replace(places=self.system.reduced(y, place), rates=self.system.reduced(rates, rate))

    def lose(self, at: Prepared, t: Any, state: State, held: Held, whole: Any, left: Any) -> State:
        """Count as lost the energy of the strings that break: those of `whole` (M,) that are not `left`."""
        x, v, _ = self._nodes(t, state)
        lengths = self.strings.measure(x, v)[0]
        rest = self._rest(at, t, x, v, lengths, held)[0]
        gone = self.strings.energy(at.parameters, lengths, rest, whole - left).sum(axis=0)
        return state._replace(works=state.works.at[LOST].add(gone).at[STORED].add(-gone))


class Piece(NamedTuple):
    """A part of a run.

    Attributes:
        kind: what its compiled function depends on.
        given: the arguments of that function in addition to the state.
        recorded: which of its rows are recorded, that of its start being the first.
        end: [s].
    """

    kind: tuple[int, ...]
    given: Any
    recorded: Any
    end: float


class Advanced(NamedTuple):
    """Result of a piece: the state at its end, what is observed from its start on, steps, and how it ended."""

    state: State
    held: Held
    rows: Observed
    steps: Any
    ended: Any


class FixedSteps:
    """Steps of classical Runge-Kutta on a grid, on which strings break at times (M,), ∞ for never."""

    stages = 4

    def __init__(self, grid: Grid, breaks: Array) -> None:
        self.grid, self.times, self.stride = grid, grid.times, grid.stride
        within = breaks <= self.times[-1] * (1 + 1e-12)
        # The number of the step at whose start each string breaks.
        steps = np.round(np.where(within, breaks, 0.0) / grid.step)
        self.breaks: IntArray | None = np.where(within, steps, 2**53).astype(np.int64) if within.any() else None

    def pieces(self, split: Split) -> Iterator[Piece]:
        """Yield pieces of as many rows as `split` says; a shorter last row is a piece of its own."""
        rows, rest = divmod(self.grid.count, self.grid.stride)
        first = begin = self.grid.first
        for kind in chain(((size, self.grid.stride) for size in split(rows)), [(1, rest)] * (rest > 0)):
            end = first + kind[0] * kind[1]
            yield Piece(kind, first, slice(int(first > begin), None), end * self.grid.step)
            first = end

    def advance(
        self, kind: tuple[int, ...], model: Model, at: Prepared, state: State, held: Held, first: Any
    ) -> Advanced:
        """Take the rows and steps of a piece of this kind, from step `first` on.

        Derivatives backwards keep the state of every step, and take each again: what a step has in between is
        some hundred small arrays, which take longer to keep than to find again.
        """
        (rows, stride), h, ratio = kind, self.grid.step, self.grid.ratio

        def whole_at(number: Any) -> Any:
            return model.whole if self.breaks is None else (self.breaks > number).astype(float)

        @jax.checkpoint
        def take(carry: tuple[State, Held], number: Any) -> tuple[tuple[State, Held], None]:
            state, held = carry
            t, whole = (number + 1) * h, whole_at(number + 1)
            state = model.step(at, number * h, h, state, held, whole_at(number))
            if self.breaks is not None:
                state = model.lose(at, t, state, held, whole_at(number), whole)
            if ratio:
                again = lambda pair: model.sample(at, t, pair[0], pair[1], whole)  # noqa: E731
                state, held = jax.lax.cond((number + 1) % ratio == 0, again, lambda pair: pair, (state, held))
            return (state, held), None

        def row(carry: tuple[State, Held], number: Any) -> tuple[tuple[State, Held], tuple[State, Held]]:
            carry, _ = jax.lax.scan(take, carry, number + jnp.arange(stride))
            return carry, carry

        @jax.checkpoint
        def observe(moment: tuple[Any, State, Held]) -> Observed:
            number, state, held = moment
            return model.evaluate(at, number * h, state, held, whole_at(number))[1]

        numbers = first + stride * jnp.arange(rows + 1)
        last, later = jax.lax.scan(row, (state, held), numbers[:-1])
        observed = jax.lax.map(observe, (numbers, *_after((state, held), later)))
        return Advanced(last[0], last[1], observed, rows * stride, TO_THE_END)


class ControlledSteps:
    """Steps of Dopri8 from `begin` on, recorded at times (T,), anew where strings break, at times (M,), ∞ for never."""

    stages, stride = 13, 1  # steps a row, as far as they are known

    def __init__(self, begin: float, times: Array, breaks: Array, engine: JAX) -> None:
        near = times[np.argmin(np.abs(times - breaks[:, None]), axis=1)]
        # The very float of a recorded time where they coincide, so that no sliver of a step lies between.
        self.breaks = np.where(np.abs(near - breaks) <= 1e-12 * near, near, breaks)
        self.begin, self.times, self.engine = begin, times, engine

    def pieces(self, split: Split) -> Iterator[Piece]:
        """Yield pieces of as many of the times as `split` says; where strings break, a new one begins."""
        start, before = self.begin, self.breaks > self.begin
        ends = np.unique([*self.breaks[before & (self.breaks <= self.times[-1])], self.times[-1]])
        if ends[-1] in self.breaks:  # what breaks at the end is recorded as broken
            ends = np.append(ends, np.nextafter(ends[-1], np.inf))
        for end in ends:
            inside = self.times[(self.times > start) & (self.times < end)]
            marks, whole, first = np.array([start, *inside, end]), self.breaks > start, 0
            for size in split(len(marks) - 1):
                own = marks[first : first + size + 1]
                # Where strings break, it is the piece behind that is recorded.
                low, high = np.searchsorted(self.times, own[[0, -1]])
                recorded = (
                    np.isin(own, self.times[low : high + 1])
                    & ((own > own[0]) | (first == 0))
                    & ((own < end) | (end == ends[-1]))
                )
                given = own, before.astype(float), whole.astype(float)
                yield Piece((len(own),), given, np.flatnonzero(recorded), float(own[-1]))
                first, before = first + size, whole
            start = end

    def advance(
        self, kind: tuple[int, ...], model: Model, at: Prepared, state: State, held: Held, given: Any
    ) -> Advanced:
        """Integrate from the first of the times to the others; strings that break there lose their energy before."""
        (times, before, whole), own = given, self.engine

        def rates(t: Any, y: State, given: tuple[Prepared, Held, Any]) -> State:
            at, held, whole = given
            return model.rates(at, t, y, held, whole)

        def observe(moment: tuple[Any, State]) -> Observed:
            return model.evaluate(at, *moment, held, whole)[1]

        state = model.lose(at, times[0], state, held, before, whole)
        longest = 0.25 * own.spread or None
        controller = diffrax.PIDController(own.rtol, own.atol, dtmin=SHORTEST, dtmax=longest, force_dtmin=False)
        forward = own.derivatives is Derivatives.FORWARD
        solution = diffrax.diffeqsolve(
            diffrax.ODETerm(rates),
            diffrax.Dopri8(),
            t0=times[0],
            t1=times[-1],
            dt0=None,
            y0=state,
            args=(at, held, whole),
            saveat=diffrax.SaveAt(ts=times[1:]),
            stepsize_controller=controller,
            max_steps=own.max_steps,
            adjoint=diffrax.ForwardMode() if forward else diffrax.RecursiveCheckpointAdjoint(),
            throw=False,
        )
        results, result = diffrax.RESULTS, solution.result
        failed = jnp.where(result == results.dt_min_reached, UNDEFINED, GAVE_UP)
        ended = jnp.where(result == results.successful, TO_THE_END, failed)
        rows = jax.lax.map(observe, (times, _after(state, solution.ys)))
        last = jax.tree.map(lambda x: x[-1], solution.ys)
        return Advanced(last, held, rows, solution.stats["num_steps"], ended)


def _after(first: Any, later: Any) -> Any:
    """Join arrays of the first instant and of the others."""
    return jax.tree.map(lambda one, more: jnp.concatenate([jnp.asarray(one)[None], more]), first, later)
