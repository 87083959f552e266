"""Elements, the central notion of this package: physical effects that act on nodes.

Loads, wind, drag, bending of joints and water are elements, and so is any subclass of `Element`, in Python:

    @dataclass(frozen=True)
    class GroundSpring(Element):
        node: str
        stiffness: float
        work = Work.STORED

        def act(self, scene, time, nodes, velocities):
            forces, row = np.zeros_like(nodes), scene.structure.node_index[self.node]
            forces[row] = -self.stiffness * nodes[row]
            return forces

        def energy(self, scene, nodes):
            return 0.5 * self.stiffness * np.sum(nodes[scene.structure.node_index[self.node]] ** 2)

    scene = scene.with_(elements=(GroundSpring("a", 100.0),))

One that remembers, such as a dashpot in series with a spring, has a state: `state0`, and `rates`, which engines
integrate with the equations of motion. `act`, `given` and `energy` then take the state, too, as their last argument.

Engines, the balance of energy, linear models, stable steps and statics know elements by this interface alone. One that
is to be as fast as those of the package also names a compiled function (docs/elements.md).
"""

from __future__ import annotations

import enum
from collections.abc import Callable, Iterator, Sequence
from importlib import import_module
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.errors import ElementError, SceneError

if TYPE_CHECKING:
    from tensegrity_mj.model.scene import Scene


class Work(enum.Enum):
    """Place of the work of an element's forces in the balance of energy."""

    GIVEN = "given"  # to the external work: forces that something outside drives
    LOST = "lost"  # to the dissipation, but for what surroundings that move give (`Element.given`)
    STORED = "stored"  # to the element's own energy, of which the forces are minus the gradient


class Element:
    """A physical effect that acts on nodes; a subclass is a frozen value, such as a frozen dataclass.

    Attributes:
        work: see `Work`.
        smooth: whether its forces are analytic in positions and quadratic at most in velocities, so that linear models
            may take wide differences of them. Where they have kinks, or it is not known, narrow ones are taken.
        adds_mass: whether it answers the accelerations of rods, too; for compiled elements (`alpha`).
        symmetric: whether α_12 = α_21 of what it adds.
        vectorized: whether `act`, `given` and `energy` take positions (..., N, 3) at times (...).
        compiled: "module:function", of a function (element, scene) -> `NativeElement`, imported when an engine first
            needs it; "" for none, and `act` is called.
        arrays: "module:function", of a function (element, scene) -> `engines.jax.arrays.ArrayEffect`, imported when the
            differentiable engine needs it; "" for none, and that engine refuses the element.
        label: its name in messages; by default that of its class.
        has_state: whether it has `state0`; found by itself.
        loses: of a compiled STORED element without a state, whether it adds what it loses to its effect's `given`.
    """

    work: ClassVar[Work] = Work.GIVEN
    smooth: ClassVar[bool] = False
    adds_mass: ClassVar[bool] = False
    symmetric: ClassVar[bool] = True
    vectorized: ClassVar[bool] = False
    compiled: ClassVar[str] = ""
    arrays: ClassVar[str] = ""
    label: ClassVar[str] = ""
    has_state: ClassVar[bool] = False
    loses: ClassVar[bool] = False

    def __init_subclass__(cls, **options: object) -> None:
        super().__init_subclass__(**options)
        cls.label = vars(cls).get("label") or cls.__name__
        cls.has_state = cls.state0 is not Element.state0

    def check(self, scene: Scene) -> None:
        """Raise SceneError unless it fits a scene; called when the scene is made."""

    def act(self, scene: Scene, time: float, nodes: Array, velocities: Array) -> Array:
        """Forces (N, 3) [N] on the nodes at a time [s], positions [m] and velocities [m/s] (N, 3)."""
        raise NotImplementedError

    def given(self, scene: Scene, time: float, nodes: Array, velocities: Array) -> float:
        """Power [W] that the moving surroundings of a LOST element give. Depends on the forces alone."""
        return 0.0

    def energy(self, scene: Scene, nodes: Array) -> float:
        """Energy [J] that a STORED element holds at positions (N, 3) [m]."""
        return 0.0

    def state0(self, scene: Scene) -> Array:
        """State (S,) at the start, for an element with a state, in units of its own."""
        raise NotImplementedError

    def rates(self, scene: Scene, time: float, nodes: Array, velocities: Array, state: Array) -> Array:
        """Time derivative (S,) of the state (S,), for an element with a state."""
        raise NotImplementedError

    def lost(self, scene: Scene, time: float, nodes: Array, velocities: Array, state: Array) -> float:
        """Power [W] that a STORED element with a state loses, -dE/dt - F·v = -∂E/∂state · rates."""
        return 0.0

    def adds_mass_to(self, scene: Scene) -> bool:
        """Return whether `alpha` of a scene's rods is more than zero anywhere, so that engines must include it."""
        return self.adds_mass and bool(scene.structure.rods)

    def alpha(self, scene: Scene, time: float, nodes: Array) -> Array:
        """Added mass α (..., R, 2, 2) [kg]: each rod's nodes also feel -Σ_j α_ij P a_j, P projecting across the rod."""
        return np.zeros((*nodes.shape[:-2], len(scene.structure.rods), 2, 2))


def named_function(element: Element, attribute: str) -> Callable[..., Any]:
    """The function that an element's `compiled` or `arrays` names.

    Raises:
        ElementError: where it cannot be imported.
    """
    place = getattr(element, attribute)
    module, _, name = place.partition(":")
    try:
        found: Callable[..., Any] = getattr(import_module(module), name)
    except (ImportError, AttributeError, ValueError) as error:
        raise ElementError(
            f"element {element.label}: {attribute} = {place!r} cannot be imported ({error}); it must be "
            "'module:function', or '' for an element that has none"
        ) from error
    return found


def states_at_start(elements: Sequence[Element], scene: Scene) -> Array:
    """The states of elements (S,) at the start, one element's after another's."""
    return np.concatenate([np.zeros(0), *(element.state0(scene) for element in elements if element.has_state)])


def state_names(scene: Scene) -> tuple[str, ...]:
    """(S,) a name for each number of the states of a scene's elements, such as "elements[0] Maxwell: s1"."""
    return tuple(
        f"elements[{number}] {element.label}: s{k + 1}"
        for number, element in enumerate(scene.elements)
        if element.has_state
        for k in range(len(element.state0(scene)))
    )


def split_states(
    elements: Sequence[Element], scene: Scene, states: Array | None, shape: tuple[int, ...] = ()
) -> Iterator[tuple[Array, ...]]:
    """Split all states (*shape, S), the start's by default, into the arguments of each element: its own, or none."""
    if states is None:
        start = states_at_start(elements, scene)
        states = np.broadcast_to(start, (*shape, len(start)))
    at = 0
    for element in elements:
        size = len(element.state0(scene)) if element.has_state else 0
        yield (states[..., at : at + size],) if element.has_state else ()
        at += size


def forces_of(
    elements: Sequence[Element],
    scene: Scene,
    time: Array | float,
    nodes: Array,
    velocities: Array,
    states: Array | None = None,
) -> Array:
    """Forces (..., N, 3) [N] of elements of a scene at times (...), positions and velocities (..., N, 3).

    What answers accelerations is not among them. States (..., S) are those of the start by default.
    """
    out = np.zeros(nodes.shape)
    if not elements:
        return out
    times = np.broadcast_to(np.asarray(time, float), nodes.shape[:-2])
    for element, own in zip(elements, split_states(elements, scene, states, times.shape), strict=True):
        if element.vectorized:
            out += element.act(scene, times, nodes, velocities, *own)  # type: ignore[arg-type]
            continue
        for place in np.ndindex(times.shape):
            here = [part[place] for part in own]
            out[place] += acted(element, scene, float(times[place]), nodes[place], velocities[place], *here)
    return out


def acted(element: Element, scene: Scene, time: float, nodes: Array, velocities: Array, *state: Array) -> Array:
    """Return an element's forces (N, 3) by `act`; ValueError where they are no finite array of that shape."""
    return as_forces(element.act(scene, time, nodes, velocities, *state), nodes.shape)


def rated(element: Element, scene: Scene, time: float, nodes: Array, velocities: Array, state: Array) -> Array:
    """Return an element's rates (S,) by `rates`; ValueError where they are no finite array of the state's shape."""
    found = np.asarray(element.rates(scene, time, nodes, velocities, state), float)
    if found.shape != state.shape or not np.all(np.isfinite(found)):
        raise ValueError(f"its rates have shape {found.shape}; they must be finite {state.shape}, as its state0")
    return found


def as_forces(returned: ArrayLike, shape: tuple[int, ...]) -> Array:
    """Return forces that a function gave as an array; ValueError where it is no finite one of that shape."""
    forces = np.asarray(returned, float)
    if forces.shape != shape or not np.all(np.isfinite(forces)):
        raise ValueError(f"it returned shape {forces.shape}; it must return finite {shape} [N]")
    return forces


def energy_of(elements: Sequence[Element], scene: Scene, nodes: Array, states: Array | None = None) -> Array:
    """Energy stored in elements [J], (...), at positions (..., N, 3) and states (..., S), the start's by default."""
    out = np.zeros(nodes.shape[:-2])
    for element, own in zip(elements, split_states(elements, scene, states, out.shape), strict=True):
        if element.work is not Work.STORED:
            continue
        if element.vectorized:
            out += element.energy(scene, nodes, *own)
            continue
        for place in np.ndindex(out.shape):
            out[place] += float(element.energy(scene, nodes[place], *(part[place] for part in own)))
    return out


def slopes_of(
    elements: Sequence[Element], scene: Scene, time: float, nodes: Array, velocities: Array
) -> tuple[Array, Array]:
    """K = -∂F/∂x [N/m] and D = -∂F/∂v [N s/m], (3N, 3N), of elements at positions and velocities (N, 3).

    By central differences of `act`, over 1e-5 of the shortest member and over 1e-5 m/s: relative errors of 1e-10 of
    forces that are smooth so near.
    """
    size, structure = nodes.size, scene.structure
    lengths = [*structure.string_lengths(nodes), *structure.rod_lengths]
    steps = (1e-5 * (min(lengths) if lengths else 1.0), 1e-5)
    found = []
    for which, h in enumerate(steps):
        out, state = np.zeros((size, size)), [nodes, velocities]
        for k in range(size) if elements else ():
            change = np.zeros(size)
            change[k] = h
            sides = []
            for sign in (1.0, -1.0):
                moved = list(state)
                moved[which] = state[which] + sign * change.reshape(nodes.shape)
                sides.append(forces_of(elements, scene, time, moved[0], moved[1]).ravel())
            out[:, k] = (sides[1] - sides[0]) / (2 * h)
        found.append(out)
    return found[0], found[1]


def check_elements(scene: Scene) -> None:
    """Raise SceneError unless the elements of others in a scene are such, and fit it."""
    for number, element in enumerate(scene.elements):
        what = f"elements[{number}]"
        if type(element).act is Element.act:
            raise SceneError(f"{what} ({element.label}) has no act(scene, time, nodes, velocities): give it one")
        if not isinstance(element.work, Work):
            raise SceneError(f"{what} ({element.label}): work = {element.work!r}; it must be a member of Work")
        if (element.work is Work.STORED) == (type(element).energy is Element.energy):
            raise SceneError(
                f"{what} ({element.label}): work = {element.work}; an element that stores its work has energy(scene, "
                "nodes), and no other has: add the one or change the other"
            )
        if element.adds_mass and not element.compiled:
            raise SceneError(
                f"{what} ({element.label}) adds mass, which takes a compiled function: name it in `compiled`, or leave "
                "adds_mass out"
            )
        if element.has_state == (type(element).rates is Element.rates):
            raise SceneError(
                f"{what} ({element.label}): an element with a state has both state0(scene) and rates(scene, time, "
                "nodes, velocities, state): add the one or leave out the other"
            )
        element.check(scene)
        try:
            state = [_state_at_start(element, scene)] if element.has_state else []
            acted(element, scene, float(scene.start_time), scene.nodes0, scene.velocities0, *state)
            if state:
                rated(element, scene, float(scene.start_time), scene.nodes0, scene.velocities0, *state)
        except SceneError:
            raise
        except Exception as error:
            at = f"t = {scene.start_time:g}"
            raise SceneError(f"{what} ({element.label}) failed at {at}: {type(error).__name__}: {error}") from error


def _state_at_start(element: Element, scene: Scene) -> Array:
    """Return the state of `state0`; ValueError where it is no finite array (S,) of one number or more."""
    state = np.asarray(element.state0(scene), float)
    if state.ndim != 1 or not state.size or not np.all(np.isfinite(state)):
        raise ValueError(f"its state0 is {state.tolist()}; it must be an array (S,) of one finite number or more")
    return state
