"""Linear models of a scene about a state, from each engine's own equations, all in the same coordinates.

    ẋ = A x + B v + e,   y = C x,   x = (δ, δ̇, s)

The chart δ is built from the state alone, so that engines can be compared number by number. It has, in the order of the
structure: for each rod the translations z - z₀ along its support's `translation_basis`, then the central projection of
b onto the tangent plane at b₀,

    b = (b₀ + T δ_b) / ‖b₀ + T δ_b‖,     δ_b = Tᵀ b / (b₀ᵀ b),

with T = `null_space_basis(b₀)` (3, 2) in space, and in a plane the one unit vector that b₀ turns to when the angle of
the minimal model grows; for each point mass the translations along its `translation_basis`. Straight lines through
δ = 0 are great circles of b. So δ_b is the angle turned, up to its third power, and A at an equilibrium is that of any
such chart.

v are changes of the rest lengths [m], or of the force densities [N/m], from those at the state; y are the node
positions' changes (3N,) [m], nodes one after another; s are the changes of the elements' states, where these have any,
from those of the start. e is the residual ẋ at the state; it is zero at an equilibrium.

How the derivatives are taken. An engine's accelerations are affine in the strings' tensions T, and tensions have the
only kinks. So each string that is taut at the state is kept taut, by an offset of its tension that is far above all
changes of it and is subtracted again,

    a(T) = a(T + c) - (a(T + 3c) - a(T + c)) / 2,

and each slack one is kept slack. What is left is smooth in δ and quadratic in δ̇, and affine in v. Central differences
in δ̇ and v are then exact. In δ, 2 n points with the step h have a truncation error of (n!)² (h/R)^(2n) and a round-off
of 4 ε R / h, relative to k, where R is the distance within which a tension is analytic: the shortest string or rod.
n = 6 and h = 0.022 R make 7e-15 and 4e-14 of them. Engines differ by their round-off alone. Where joints close loops h
is shorter (`LOOP_STEP`), and engines agree to 1e-8. Where much hangs on a rod, R is far shorter than any length: h is
halved as long as n = 5 shows that it is too long (`settled`).

Elements whose forces have kinks (drag where a rod stands still in a fluid, the surface of water), or of which it is not
known, take narrow differences instead, h times `NARROW` in δ and `NARROW_RATE` in δ̇: their round-off is 4e-12
relative to k, and 1e-10 s of the accelerations. At a kink itself a model is the mean of its sides.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.basics.checks import finite, instance, member, real_array
from tensegrity_mj.basics.kinds import SMALLEST
from tensegrity_mj.controllers.scenes import AnyLaw, law_for
from tensegrity_mj.dynamics.native.actuation import set_rest_lengths
from tensegrity_mj.dynamics.native.law import NO_SOLUTION, Command, native_law
from tensegrity_mj.dynamics.native.plant import Plant
from tensegrity_mj.dynamics.native.strings import measure_strings
from tensegrity_mj.engines.request import AcceleratingEngine, Accelerations, Request
from tensegrity_mj.engines.requirements import require
from tensegrity_mj.engines.table import checked_engine
from tensegrity_mj.errors import InfeasibleError, OptionError
from tensegrity_mj.linearization.chart import Chart, chart_of
from tensegrity_mj.linearization.model import Linearization
from tensegrity_mj.model.actuation import Actuation, OnInfeasible
from tensegrity_mj.model.elements.contact import overlaps
from tensegrity_mj.model.elements.element import Element, acted, rated, split_states, state_names, states_at_start
from tensegrity_mj.model.members import PRESTRESS
from tensegrity_mj.model.scene import Scene
from tensegrity_mj.model.strings import force_density, on_taut_side
from tensegrity_mj.model.structure import Structure


def linearize(
    scene: Scene,
    engine: AcceleratingEngine | None = None,
    *,
    nodes: ArrayLike | None = None,
    velocities: ArrayLike | None = None,
    rest_lengths: ArrayLike | None = None,
    law: AnyLaw = None,
    time: float | None = None,
    inputs: Command = Command.REST_LENGTH,
) -> Linearization:
    """Linearize a scene about a state, with an engine's own equations.

    Args:
        scene: structure, gravity, loads, elements with the states that they start with, and the strings that have
            broken by `time`. Nothing must touch at the state: contact has no linear model, and the model is that of the
            scene without it.
        engine: `MuJoCo(...)` (default), `DAE(...)` or `ODE(...)`; only its equations count, not its steps.
        nodes, velocities: (N, 3) the state; the scene's start by default. Velocities may be nonzero: then the model is
            that of the motion's next moment.
        rest_lengths: (M,) [m]; the structure's by default, or what `law` sets at the state.
        law: closes the loop continuously: A is then A + B ∂v/∂x. None, the default, for the model of the plant alone;
            SCENE_LAW for the scene's own law.
        time: [s], at which loads and the law are evaluated, and strings have broken or not yet; by default the start.
        inputs: what B's columns change. With force densities u, A is that at constant u, too.

    Raises:
        OptionError: for options out of range, where the engine's coordinates cannot hold the state, and where something
            touches.
        SceneError: for a state that stretches a rod or breaks a support, and where supports move: the model would
            depend on time. Leave motions out with scene.with_(motions=()).
        InfeasibleError, ControllerError: if the law has no solution at the state, or fails there.
    """
    instance("scene", scene, Scene, "use a Scene, or load_scene(name or path)")
    engine = checked_engine(engine, "accelerations")
    law = law_for(scene, law)
    member("inputs", inputs, Command)
    time = float(scene.start_time) if time is None else finite("time", time, " [s]")
    require(None, scene, "linearize")
    structure, contact = scene.structure, scene.contact
    broken = scene.break_times <= time
    scene = scene.with_(
        initial_nodes=scene.nodes0 if nodes is None else nodes,
        initial_velocities=scene.velocities0 if velocities is None else velocities,
        breaks=(),
        contact=None,
    )
    touching = [] if contact is None else overlaps(structure, contact, scene.nodes0)
    if touching:
        raise OptionError(
            f"linearize: {touching[0]}: contact has no linear model; choose a state where nothing touches, or leave "
            "contact out (scene.with_(contact=None))"
        )
    chart = chart_of(structure, scene.nodes0)
    _, rate0 = chart.coordinates(scene.nodes0, scene.velocities0)
    reach = reach_of(structure, scene.nodes0)
    loop = None if law is None else SetRestLengths(scene, law, time)
    if rest_lengths is not None and law is not None:
        raise OptionError("rest_lengths and law: the law sets the rest lengths; leave one of them out")
    if rest_lengths is not None:
        rest = real_array("rest_lengths", rest_lengths, (len(structure.strings),), "m").copy()
    else:
        rest = np.array(structure.rest_lengths) if loop is None else loop(scene.nodes0, scene.velocities0)
    strings = StringStates(structure, scene, rest, broken, inputs, PAIRS * STEP * reach, reach)
    elements = ElementStates(scene if strings.linear is structure else scene.with_(structure=strings.linear))
    field: Accelerations = engine.accelerations(Request(elements.scene, native_law(None, structure)))

    def motion(delta: Array, rate: Array, change: Array, states: Array = elements.start) -> tuple[Array, Array]:
        """Node positions (3N,) and (δ̈, ṡ) (n + S,) at δ, δ̇, a change of the inputs, and states of elements."""
        elements.become(states)
        here, speeds = chart.state(delta, rate)
        lengths = structure.string_lengths(here)
        placed, once = field(time, here, speeds, strings.rest_lengths(lengths, change, 1.0))
        if np.any(strings.taut):
            thrice = field(time, here, speeds, strings.rest_lengths(lengths, change, 3.0))[1]
            once = once - 0.5 * (thrice - once)
        changes = elements.rates(time, here, speeds)
        return placed.ravel(), np.concatenate([chart.accelerations(delta, rate, once), changes])

    n, M = chart.size, len(structure.strings)
    none, zero, total = np.zeros(n), np.zeros(M), 2 * n + len(elements.start)
    A, B, C = np.zeros((total, total)), np.zeros((total, M)), np.zeros((3 * len(structure.nodes), total))
    A[:n, n : 2 * n] = np.eye(n)
    smooth = all(element.smooth for element in scene.effects)
    step = STEP * (LOOP_STEP if chart.has_loops else 1.0) * (1.0 if smooth else NARROW)
    turn = 1.0 if smooth else NARROW_RATE
    for k in range(n):
        unit = np.eye(n)[k]
        h = step * reach / chart.lever(k)
        slope = settled(lambda x, u=unit: np.concatenate(motion(x * u, rate0, zero)), h)  # type: ignore[misc]
        C[:, k], A[n:, k] = np.split(slope, [len(C)])
        ahead, behind = motion(none, rate0 + turn * unit, zero), motion(none, rate0 - turn * unit, zero)
        A[n:, n + k] = (ahead[1] - behind[1]) / (2 * turn)
    for m in np.flatnonzero(strings.taut):
        h = strings.input_step[m]
        change = h * np.eye(M)[m]
        B[n:, m] = (motion(none, rate0, change)[1] - motion(none, rate0, -change)[1]) / (2 * h)
    if len(elements.start):
        A[n:, 2 * n :] = elements.slopes(lambda states: motion(none, rate0, zero, states)[1])
    residual = np.concatenate([rate0, motion(none, rate0, zero)[1]])
    gain, remarks = None, strings.losses() + (strings.remarks() if loop is None else [])
    if loop is not None:
        gain, kinks = loop.derivative(chart, rate0, reach, inputs)
        gain = np.pad(gain, ((0, 0), (0, len(elements.start))))  # laws do not account for elements
        remarks += kinks
        A = A + B @ gain
    if len(elements.start) and nodes is not None:
        remarks.append("states of elements are those of the scene's start, with the nodes given")
    return Linearization(
        engine=str(engine),
        scene=scene,
        time=time,
        nodes=np.array(scene.nodes0),
        velocities=np.array(scene.velocities0),
        rest_lengths=rest,
        inputs=inputs,
        A=A,
        B=B,
        C=C,
        residual=residual,
        gain=gain,
        coordinates=chart.names,
        states=state_names(scene),
        warnings=tuple(remarks),
    )


STATE_STEP = 1e-5  # of a state, and of 1 in its unit where it is smaller: of twelve differences, 6e-5 are the outermost


@dataclass(frozen=True, eq=False)
class _AtState(Element):
    """Element that acts at a state which others change."""

    element: Element
    state: Array

    def act(self, scene: Scene, time: float, nodes: Array, velocities: Array) -> Array:
        """See `Element`."""
        return acted(self.element, scene, time, nodes, velocities, self.state)


class ElementStates:
    """The states of a scene's elements (S,) as variables of a linear model, of which no engine knows.

    An engine is given the scene with elements that act as those do at the states of the moment. How the states change
    is what the elements themselves say.

    Attributes:
        start: those about which the model is.
        scene: the same to an engine, whose elements have no states.
    """

    def __init__(self, scene: Scene) -> None:
        self.start = states_at_start(scene.elements, scene)
        self._now, self._elements = self.start.copy(), scene.elements
        pairs = zip(scene.elements, split_states(scene.elements, scene, self._now), strict=True)
        self.scene = scene
        if len(self.start):
            self.scene = scene.with_(elements=[_AtState(element, *own) if own else element for element, own in pairs])

    def become(self, states: Array) -> None:
        """Have the elements of `scene` act at these states (S,)."""
        self._now[:] = states

    def rates(self, time: float, nodes: Array, velocities: Array) -> Array:
        """Rates (S,) of the states as they are now, at a time [s], positions and velocities (N, 3)."""
        parts = zip(self._elements, split_states(self._elements, self.scene, self._now), strict=True)
        found = [rated(element, self.scene, time, nodes, velocities, *own) for element, own in parts if own]
        return np.concatenate([np.zeros(0), *found])

    def slopes(self, function: Callable[[Array], Array]) -> Array:
        """Derivatives (m, S) of a function (m,) of the states, at the start, by central differences."""
        steps = STATE_STEP * np.maximum(1.0, np.abs(self.start))
        ways = np.eye(len(steps))
        columns = [
            central(lambda part, way=way: function(self.start + part * way), h)  # type: ignore[misc]
            for way, h in zip(ways, steps, strict=True)
        ]
        return np.column_stack(columns)


class StringStates:
    """Strings that pull at the state, and the rest lengths that keep them taut, and the others slack.

    Attributes:
        taut: (M,) bool.
        input_step: (M,) of an input, [m] or [N/m].
    """

    def __init__(
        self,
        structure: Structure,
        scene: Scene,
        rest: Array,
        broken: NDArray[np.bool_],
        inputs: Command,
        move: float,
        reach: float,
    ) -> None:
        self.structure, self.rest, self.broken, self.inputs = structure, rest, broken, inputs
        lengths = structure.string_lengths(scene.nodes0)
        if np.any(lengths == 0):
            name = structure.strings[int(np.argmin(lengths))].name
            raise OptionError(f"string '{name}' has no length at this state, and so no direction: linearize elsewhere")
        rates = structure.string_rates(scene.nodes0, scene.velocities0)
        stretch = lengths - rest
        taut, self.at_edge = on_taut_side(lengths, rest, scene.nodes0, broken)
        self.k, self.pull, self.free = self._tangents(lengths, rest)
        elastic = self.pull if self.curved else structure.stiffness * stretch
        dampers = structure.damping * rates
        # A clipped string whose damper pushes more than it pulls carries nothing, and goes on so.
        self.taut = taut & ~(structure.clipped & ~self.at_edge & (elastic + dampers <= 0))
        self.u = elastic / lengths
        self.input_step = (
            np.full(len(rest), STEP * reach)
            if inputs is Command.REST_LENGTH
            else STEP * np.where(structure.curves.constant, self.u, structure.stiffness)
        )
        # Above all that nodes that move by `move`, inputs, and dampers at unit rates of δ can make of a tension.
        self.offset = (
            (np.abs(self.pull) + self.k * 4 * move if self.curved else self.k * (np.abs(stretch) + 4 * move))
            + 2 * self.input_step * (self.k if inputs is Command.REST_LENGTH else lengths)
            + 2 * structure.damping * (np.abs(rates) + 2 * float(structure.rod_lengths.max(initial=1.0)))
        )

    def rest_lengths(self, lengths: Array, change: Array, offsets: float) -> Array:
        """Rest lengths (M,) [m] for the tension at these lengths and inputs plus a number of offsets."""
        if self.inputs is Command.REST_LENGTH:
            elastic = self.k * (lengths - self.free - change)
        else:
            elastic = (self.u + change) * lengths
        if self.curved:
            elastic = np.where(self.structure.curves.constant | (self.k == 0), self.pull, elastic)
        k = self.linear.stiffness
        return np.where(self.taut, lengths - (elastic + offsets * self.offset) / k, 3 * lengths)

    def _tangents(self, lengths: Array, rest: Array) -> tuple[Array, Array, Array]:
        """Slopes [N/m] and elastic tensions [N] (M,) at the state, and where tangents of that slope are at zero [m]."""
        curves = self.structure.curves
        if not self.curved:
            return curves.stiffness, curves.stiffness * (lengths - rest), rest
        stretch = lengths - rest
        k, pull = curves.slope(np.maximum(stretch, SMALLEST)), curves.tension(stretch)
        one = np.array([string.is_linear for string in self.structure.strings], bool)
        return k, pull, np.where(one, rest, lengths - pull / np.where(k > 0, k, np.inf))

    @property
    def curved(self) -> bool:
        """True where any string has more than its stiffness."""
        return not self.structure.curves.linear

    @cached_property
    def linear(self) -> Structure:
        """The structure, with linear strings that engines give any tension by their rest lengths."""
        if not self.curved:
            return self.structure
        none = dict.fromkeys(PRESTRESS)
        strings = [
            one if one.is_linear else replace(one, stiffness=one.stiffness or 1.0, curve=(), yields=False, **none)  # type: ignore[arg-type]
            for one in self.structure.strings
        ]
        return replace(self.structure, strings=tuple(strings))

    def remarks(self) -> list[str]:
        """Remarks about strings at the edge of slackness, and about those that yield."""
        remarks = []
        if names := self._named(self.at_edge):
            remarks.append(
                f"strings {names} are at the edge of slackness (their length is their rest length): the model "
                "is that of the taut side; it has a kink there"
            )
        if names := self._named(self.structure.curves.yields & self.taut):
            remarks.append(f"strings {names} yield: the model has them unload and reload, with their first slope")
        return remarks

    def losses(self) -> list[str]:
        """Remarks about broken strings."""
        names = self._named(self.broken)
        return [f"strings {names} have broken by this time: the model is that of the others"] if names else []

    def _named(self, chosen: NDArray[np.bool_]) -> str:
        return ", ".join(s.name for s, one in zip(self.structure.strings, chosen, strict=True) if one)


# A law's derivative: steps tried, relative to R. Where its kinks are near, only short ones are right.
LAW_STEPS = (1e-2, 1e-3, 1e-4, 1e-5, 1e-6)
KINK = 1e-3  # of the largest derivative: what the two sides may differ by


class SetRestLengths:
    """The rest lengths that a law sets, as a function of the state."""

    def __init__(self, scene: Scene, law: Any, time: float) -> None:
        native = native_law(law, scene.structure)
        if native.discontinuous:
            raise OptionError(native.discontinuous)
        self.scene, self.time = scene, time
        self.plant = Plant(scene, native, Actuation.continuous(), OnInfeasible.STOP)

    def __call__(self, nodes: Array, velocities: Array) -> Array:
        """Rest lengths (M,) [m] that the law sets at a state.

        Raises:
            InfeasibleError, ControllerError: what the law says there.
        """
        plant = self.plant
        plant["nodes"][:], plant["velocities"][:] = nodes, velocities
        measure_strings(plant.address)
        status = int(set_rest_lengths(plant.address, self.time))
        plant.raise_if_failed(max(status, plant["status"]), self.time)
        if status == NO_SOLUTION:
            raise InfeasibleError(plant.infeasible_message(self.time))
        return np.array(plant["rest"])

    def derivative(self, chart: Chart, rate0: Array, reach: float, inputs: Command) -> tuple[Array, list[str]]:
        """Derivative ∂v/∂x (M, 2n) by central differences, and remarks about kinks.

        For each column that step is taken whose result differs least from that of the next shorter one.
        """
        structure = self.scene.structure
        n = chart.size

        def value(x: Array) -> Array:
            nodes, velocities = chart.state(x[:n], rate0 + x[n:])
            rest = self(nodes, velocities)
            if inputs is Command.REST_LENGTH:
                return rest
            lengths = structure.string_lengths(nodes)
            if not structure.curves.linear:
                return force_density(structure.curves, lengths, rest)
            return structure.stiffness * (1 - rest / lengths)

        here = value(np.zeros(2 * n))
        gain = np.zeros((len(structure.strings), 2 * n))
        gaps = np.zeros_like(gain)
        for k in range(2 * n):
            unit = np.eye(2 * n)[k]
            scale = reach / chart.lever(k % n)
            tried = [central(lambda x, u=unit: value(x * u), h * scale) for h in LAW_STEPS]  # type: ignore[misc]
            changes = [float(np.abs(a - b).max(initial=0.0)) for a, b in itertools.pairwise(tried)]
            gain[:, k] = tried[int(np.argmin(changes)) + 1 if changes[0] > min(changes) else 0]
            h = LAW_STEPS[-1] * scale
            ahead, behind = value(h * unit) - here, here - value(-h * unit)
            gaps[:, k] = (ahead - behind) / h
        rows = np.abs(gaps).max(axis=1, initial=0.0) > KINK * np.abs(gain).max(initial=0.0)
        if not rows.any():
            return gain, []
        names = ", ".join(s.name for s, kink in zip(structure.strings, rows, strict=True) if kink)
        return gain, [f"the law has a kink at this state in strings {names}: the closed loop is the mean of its sides"]


PAIRS = 6


def _weights(pairs: int) -> Array:
    """Weights w of f'(0) h = Σ w (f(k h) - f(-k h)), k = 1 to n: of order 2 n (Lagrange's), zero above n."""
    found = np.zeros(PAIRS)
    for k in range(1, pairs + 1):
        w = math.factorial(pairs) ** 2 / (k * math.factorial(pairs - k) * math.factorial(pairs + k))
        found[k - 1] = -((-1) ** k) * w
    return found


WEIGHTS, FEWER = _weights(PAIRS), _weights(PAIRS - 1)
STEP = 0.022  # of R
# Of that, where rods close loops: what closes them is a root of equations, analytic in a shorter distance. The lowest
# ω² of `net` is 118 with the whole step, and 67.30030945 with this part of it and with a quarter of this.
LOOP_STEP = 0.15
# A function that is analytic within R of the state has f'(0) by n pairs to (n!)² (h/R)^2n of itself: 4e-13 by five of
# them for h = 0.022 R, and 7e-15 by six. SETTLED of five is 1e-12 of six.
SETTLED = 2.4e-11
# Where forces may have kinks near by: of STEP; and of 1 m/s or 1 rad/s, for differences in rates.
NARROW, NARROW_RATE = 0.01, 1e-6


def central(function: Callable[[float], Array], h: float) -> Array:
    """Derivative f'(0) by the points of WEIGHTS."""
    return _both(function, h)[0]


def settled(function: Callable[[float], Array], h: float) -> Array:
    """Derivative f'(0) by the points of WEIGHTS; the step is halved while one pair fewer shows that it is too long.

    In long chains of rods it may be: a rod that much hangs on is analytic in a far shorter distance than its length.
    """
    found, error = _both(function, h)
    while error > SETTLED * np.abs(found).max(initial=0.0):
        h /= 2
        finer, less = _both(function, h)
        if less > error / 8:  # round-off, or a kink: truncation falls to a thousandth
            break
        found, error = finer, less
    return found


def _both(function: Callable[[float], Array], h: float) -> tuple[Array, float]:
    """Derivative f'(0) by all pairs, and the largest difference from that of one pair fewer."""
    found = fewer = np.zeros(())
    for p, (weight, other) in enumerate(zip(WEIGHTS, FEWER, strict=True), start=1):
        change = function(p * h) - function(-p * h)
        found, fewer = found + weight / h * change, fewer + other / h * change
    return found, float(np.abs(found - fewer).max(initial=0.0))


def reach_of(structure: Structure, nodes: Array) -> float:
    """R [m]: the shortest of strings and rods, the distance in which directions change."""
    lengths = np.concatenate([structure.string_lengths(nodes), structure.rod_lengths])
    return float(lengths.min()) if len(lengths) else 1.0
