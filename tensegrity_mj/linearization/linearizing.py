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
is shorter (`differences.LOOP_STEP`), and engines agree to 1e-8. Where much hangs on a rod, R is far shorter than any
length: h is halved as long as n = 5 shows that it is too long (`differences.settled`).

Elements whose forces have kinks (drag where a rod stands still in a fluid, the surface of water), or of which it is not
known, take narrow differences instead, h times `differences.NARROW` in δ and `differences.NARROW_RATE` in δ̇: their
round-off is 4e-12 relative to k, and 1e-10 s of the accelerations. At a kink itself a model is the mean of its sides.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.basics.checks import finite, instance, member, real_array
from tensegrity_mj.controllers.scenes import AnyLaw, law_for
from tensegrity_mj.dynamics.native.law import Command, native_law
from tensegrity_mj.engines.request import AcceleratingEngine, Accelerations, Request
from tensegrity_mj.engines.requirements import require
from tensegrity_mj.engines.table import checked_engine
from tensegrity_mj.errors import OptionError
from tensegrity_mj.linearization.chart import chart_of
from tensegrity_mj.linearization.differences import LOOP_STEP, NARROW, NARROW_RATE, PAIRS, STEP, reach_of, settled
from tensegrity_mj.linearization.element_states import ElementStates
from tensegrity_mj.linearization.model import Linearization
from tensegrity_mj.linearization.strings import KeptStrings, SetRestLengths
from tensegrity_mj.model.elements.contact import overlaps
from tensegrity_mj.model.elements.element import state_names
from tensegrity_mj.model.scene import Scene


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
    strings = KeptStrings(structure, scene, rest, broken, inputs, PAIRS * STEP * reach, reach)
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
