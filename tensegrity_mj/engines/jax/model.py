"""A scene, its law and its actuation as pure functions of parameters: rates, steps, what is observed."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from tensegrity_mj.dynamics.native.law import Report
from tensegrity_mj.engines.jax.arrays import ArrayEffect, ArrayLaw, Arrays, lifted, times
from tensegrity_mj.engines.jax.strings import Strings
from tensegrity_mj.engines.jax.system import Mobility, System
from tensegrity_mj.model.actuation import Actuation, Mode
from tensegrity_mj.model.scene import Scene

# The works [J] that are integrated or counted along with the motion; and VOID, above zero where a law had no command.
STORED, LOST, EXTERNAL, WINCH, VOID = range(5)
WORKS = 5


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
