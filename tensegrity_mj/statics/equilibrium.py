"""Equilibrium by Newton's method on the energy, kept on the lengths of the rods.

Each step solves

    [ Zᵀ K Z + μ   Zᵀ Cᵀ ] [ s  ]   [ -Zᵀ (∇Π + Cᵀ N)  ]
    [ C Z         -ℓ/EA  ] [ δN ] = [ ℓ + N ℓ/EA - L   ]

and is then brought back to L = ℓ + (N + δN) ℓ/EA. μ (Levenberg and Marquardt) grows until the energy falls as the
quadratic model says, so that saddles are left and slack strings do no harm; it vanishes at the end, where Newton's own
steps converge quadratically. A state that is found unstable is left along its softest motion.

`relax` is dynamic relaxation with kinetic damping, the thesis' way of form-finding (§7.2.3). Fictitious masses move
under the forces in steps of one unit of time, on the lengths of the rods. Where the kinetic energy has just passed a
peak everything is put back by half a step, stopped, and let go again (Barnes 1999). It needs nothing but forces, and so
is a check on Newton's method, which is some ten times faster.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import splu

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.basics.checks import positive, whole
from tensegrity_mj.basics.progress import bar
from tensegrity_mj.errors import InfeasibleError, OptionError
from tensegrity_mj.model.scene import Scene
from tensegrity_mj.model.structure import Structure
from tensegrity_mj.statics import linear_systems
from tensegrity_mj.statics.model import EPS, StaticModel, round_off
from tensegrity_mj.statics.state import StaticState
from tensegrity_mj.statics.turning import Turning, nearest

FIRST_REGULARIZATION = 1e-3  # of the stiffest string
LEAST_REGULARIZATION = 1e-12
MOST_REGULARIZATION = 1e8
LONGEST_MOVE = 0.3  # of the mean member, by which a step may change a member other than by turning it
ESCAPES = 12  # unstable states that are left before it gives up
SPENT = 1e-10  # of rods' forces: what is left of them where no step is better, near places where rods are in a line
STRAIGHT = 100.0  # rods' forces, of strings' and loads', that only a singular place explains
KICK = 1e-2  # of the mean member, along the softest motion


def find_equilibrium(
    scene: StaticModel | Scene | Structure, *, parameter: float = 1.0, iterations: int = 1000, stable: bool = True
) -> StaticState:
    """The equilibrium that the energy falls to from the start.

    Args:
        scene: a `StaticModel`, or what `StaticModel.of` takes: rigid rods, no further loads. Contact and breaks of
            the scene are left out; water and wind push as they do at the start, at rest.
        parameter: what further loads and holds' displacements are multiplied by.
        iterations: at most.
        stable: leave an equilibrium that is none of least energy (a start may be one, by symmetry), and go on.

    Raises:
        InfeasibleError: where there is no equilibrium: nothing holds the loads, or nothing converges; it says which.
        OptionError: for arguments that do not fit.
    """
    model = scene if isinstance(scene, StaticModel) else StaticModel.of(scene)
    limit = whole("iterations", iterations, 1)
    if not np.isfinite(parameter):
        raise OptionError(f"parameter = {parameter!r}; it must be a finite number")
    require_held(model, parameter)
    x = placed(model, parameter)
    used = 0
    for _ in range(ESCAPES):
        x, forces, taken = _descend(model, x, parameter, limit - used)
        used += taken
        x = nearest(model, x, parameter, forces)
        state = StaticState(model, x.reshape(-1, 3).copy(), forces, parameter, used)
        if not stable:
            return state
        values, motions = state.softest(1)
        if not len(values) or values[0] > -1e-9 * model.scale[1]:
            return state
        x = _kicked(model, state, motions[:, 0])
    raise InfeasibleError(
        f"'{model.scene.name}': {ESCAPES} unstable states were left one after another and no stable one found; start "
        "elsewhere (nodes=...), or request any equilibrium (stable=False)"
    )


FEET = 1e-3  # of the extent: nodes within it of the lowest are feet


def require_held(model: StaticModel, parameter: float) -> None:
    """Raise InfeasibleError where weights and loads push the whole along a straight line that nothing holds."""
    resisted = (model.element_stiffness(model.start.ravel()) / model.scale[1],) if model.elements else ()
    free = model.boundary.straight_ways(*resisted)
    external = model.external(parameter)
    force = free @ (free.T @ external.reshape(-1, 3).sum(axis=0))
    if np.linalg.norm(force) <= 1e-9 * np.abs(external).sum():
        return
    scene = model.scene
    remedy = "take gravity out (gravity = (0, 0, 0), --no-gravity) to see it as it falls freely"
    if scene.water is not None and scene.structure.rods:
        remedy = (
            "buoyancy is that of the start, wherever it would float, so take gravity out, and buoyancy with it "
            "(gravity = (0, 0, 0), --no-gravity)"
        )
    floor = "" if scene.contact is None else _standing(model)
    raise InfeasibleError(
        f"'{scene.name}': what acts on it pushes the whole with ({force[0]:.6g}, {force[1]:.6g}, {force[2]:.6g}) N, "
        f"and nothing holds it in that direction: there is no equilibrium; {remedy}, or hold nodes (holds, --hold) to "
        f"see it stand{floor}"
    )


def _standing(model: StaticModel) -> str:
    """Explain how to replace the contact that statics leaves out by a floor: by the heights of the lowest nodes."""
    contact, names, nodes = model.scene.contact, model.structure.node_names, model.start
    if contact is None or contact.floor is None or contact.terrain is not None:
        return "; statics leaves the scene's contact out"
    heights = nodes @ contact.up
    least = max(FEET * float(np.ptp(nodes, axis=0).max()), float(np.sort(heights)[:3].max() - heights.min()))
    feet = [name for name, height in zip(names, heights - heights.min(), strict=True) if height <= least]
    first = ", ".join(f'"{name}"' for name in feet[:3])
    held = f"--hold {','.join(feet)}:z" if abs(contact.up[2]) > 1 - 1e-9 else ""
    held = f"{held}, in Python " if held else ""
    return (
        f"; statics leaves the scene's contact out: on a floor without friction it stands by the heights of its feet, "
        f"{held}tmj.statics.stand(scene, [{first}])"
    )


def placed(model: StaticModel, parameter: float) -> Array:
    """The start (3N,), with holds moved to where the parameter wants them and rods brought to their lengths."""
    x = model.start.ravel() + parameter * model.boundary.moved
    found = linear_systems.projected(model, x, model.rod_lengths)
    if found is None and np.any(model.compliance > 0):
        # Holds may stretch elastic rods.
        lengths = np.where(model.compliance > 0, model.rods(x).lengths, model.rod_lengths)
        found = linear_systems.projected(model, x, lengths)
    if found is None:
        gap = np.abs(model.rods(x).lengths / model.rod_lengths - 1) if len(model.rod_lengths) else np.zeros(1)
        worst = int(gap.argmax())
        raise InfeasibleError(
            f"'{model.scene.name}': rod '{model.structure.rods[worst].name}' is off its length by a part of "
            f"{gap[worst]:.3g} at the start, and no place nearby gives all rods theirs within supports and holds; "
            "start elsewhere, or move holds in smaller steps (`follow`)"
        )
    return found


def _descend(model: StaticModel, x: Array, parameter: float, limit: int) -> tuple[Array, Array, int]:
    """x, rod forces and the number of steps: down the energy to where no force is left."""
    Z, (length, stiffest) = model.boundary.Z, model.scale
    elastic = model.compliance > 0
    mu = FIRST_REGULARIZATION * stiffest
    compliance = model.compliance + linear_systems.proximal(model) * ~elastic
    energy = model.energy(x, parameter) + model.rod_energy(x)
    gradient = model.gradient(x, parameter)
    forces = linear_systems.rod_forces(model, x, gradient)
    farthest = max(float(np.ptp(model.start, axis=0).max()), length)
    turning: Turning | None = None
    for taken in range(limit):
        C = sparse.csr_array(model.rod_slopes(x) @ Z)
        left = Z.T @ gradient + C.T @ forces
        size = float(np.abs(left).max(initial=0.0))
        rough = round_off(model, x, parameter, forces)
        if size <= rough:
            return x, forces, taken
        spent = max(1e4 * rough, SPENT * float(np.abs(forces).max(initial=0.0)))
        H = sparse.csr_array(Z.T @ model.hessian(x, forces) @ Z)
        gap = model.rod_lengths - model.rods(x).lengths
        # Motions that no stiffness resists would go far for a force of round-off: steps go across them.
        neutral = linear_systems.across(Z.T @ linear_systems.neutral_motions(model, x, parameter, forces))
        turning = turning or Turning(model)
        tried = 0
        right = np.concatenate([-left, np.where(elastic, 0.0, gap), np.zeros(neutral.shape[0])])
        while True:
            tried += 1
            if mu > MOST_REGULARIZATION * stiffest:
                if size <= spent:  # no step lowers an energy whose digits are spent
                    return x, forces, taken
                raise _stuck(model, taken, size, x, forces, parameter)
            matrix = linear_systems.saddle_matrix(
                H + mu * sparse.eye_array(H.shape[0]),
                sparse.csr_array(sparse.vstack([C, neutral])),
                np.concatenate([compliance, np.zeros(neutral.shape[0])]),
            )
            found = linear_systems.solve(matrix, right)
            if found is None:
                mu *= 4.0
                continue
            s, change = found[: len(left)], found[len(left) : len(left) + len(forces)]
            move = Z @ s
            stretch = (C @ s)[elastic]
            slope = float(left @ s)
            predicted = slope + 0.5 * float(s @ (H @ s)) + 0.5 * float(np.sum(stretch**2 / model.compliance[elastic]))
            if not (predicted < 0 and np.abs(move).max(initial=0.0) <= farthest):
                mu *= 4.0
                continue
            move, longest = turning.move(x, move)
            if not longest <= LONGEST_MOVE * length:
                mu *= 4.0
                continue
            target = model.rod_lengths + model.compliance * (forces + change)
            there = linear_systems.projected(model, x + move, np.where(target > 0, target, model.rod_lengths))
            if there is None:
                mu *= 4.0
                continue
            energy_there = model.energy(there, parameter) + model.rod_energy(there)
            gradient_there = model.gradient(there, parameter)
            forces_there = linear_systems.rod_forces(model, there, gradient_there)
            digits = 30 * _energy_round_off(model, x, forces, parameter)
            if abs(predicted) <= digits:
                # The energy has no digits left to judge by; forces have.
                C_there = model.rod_slopes(there) @ Z
                now = float(np.abs(Z.T @ gradient_there + C_there.T @ forces_there).max(initial=0.0))
                good, ratio = now < size, 1.0
                if not good and size <= spent:
                    return x, forces, taken
            else:
                ratio = (energy_there - energy) / predicted
                good = ratio > 1e-3
            if good:
                x, energy, gradient, forces = there, energy_there, gradient_there, forces_there
                # What has just been found too little is not tried again at once.
                less = 6.0 if tried == 1 else 2.0 if tried == 2 else 1.0
                mu = (
                    max(mu / less, LEAST_REGULARIZATION * stiffest)
                    if ratio > 0.6
                    else mu * (1.0 if ratio > 0.2 else 2.0)
                )
                break
            mu *= 4.0
    raise _stuck(model, limit, size, x, forces, parameter)


def _energy_round_off(model: StaticModel, x: Array, forces: Array, parameter: float) -> float:
    """[J]: lengths have errors of EPS, which forces multiply."""
    lengths = model.lengths(x)
    strings = float(model.tensions(lengths) @ lengths) + float(np.abs(forces) @ model.rod_lengths)
    return EPS * (strings + float(np.abs(model.external(parameter)) @ np.abs(x - model.start.ravel())))


def _kicked(model: StaticModel, state: StaticState, motion: Array) -> Array:
    """Move a state some way along a motion, to the side where the energy is lower."""
    length = model.scale[0]
    step = KICK * length / float(np.abs(motion).max())
    tried = []
    for sign in (1.0, -1.0):
        x = linear_systems.projected(model, state.x + sign * step * motion, state.bar_lengths)
        if x is not None:
            tried.append((model.energy(x, state.parameter) + model.rod_energy(x), -sign, x))
    if not tried:
        raise InfeasibleError(
            f"'{model.scene.name}': an unstable state was found, and rods leave no way along its softest motion; "
            "request any equilibrium (stable=False)"
        )
    return min(tried, key=lambda one: one[:2])[2]


def _stuck(model: StaticModel, taken: int, size: float, x: Array, forces: Array, parameter: float) -> InfeasibleError:
    what = f"'{model.scene.name}': no equilibrium after {taken} steps: {size:.3g} N are left. "
    pulls = float(model.tensions(model.lengths(x)).max(initial=0.0))
    pulls += float(np.abs(model.external(parameter)).max(initial=0.0))
    if len(forces) and np.abs(forces).max() > STRAIGHT * pulls:
        worst = int(np.abs(forces).argmax())
        return InfeasibleError(
            f"{what}Rod '{model.structure.rods[worst].name}' carries {forces[worst]:.3g} N, far more than strings and "
            f"loads of at most {pulls:.3g} N: rods that pull themselves straight between held points have forces "
            "without bound. Give the rods sections and use Rods.ELASTIC, or hold fewer nodes"
        )
    return InfeasibleError(
        f"{what}Is anything held by slack strings alone, or does the structure fall without end? Give it supports or "
        "tension, more iterations, or a start (nodes=...) that is nearer"
    )


# Steps of one unit are stable for masses above a quarter of the stiffness; so much more, for it grows on the way.
SAFETY = 1.6
LONGEST_STEP = 0.1  # the same, in one step of relaxation


def relax(
    scene: StaticModel | Scene | Structure,
    *,
    parameter: float = 1.0,
    tolerance: float = 1e-12,
    iterations: int = 200_000,
    progress: bool = False,
) -> StaticState:
    """The equilibrium that fictitious masses come to rest at.

    Args:
        scene: as for `find_equilibrium`.
        parameter: what further loads and holds' displacements are multiplied by.
        tolerance: part of the largest force in a member or load below which forces that are left count as none; not
            below what round-off leaves.
        iterations: steps at most.
        progress: show a bar of how many digits of the forces that were left at first have gone.

    Raises:
        InfeasibleError: where nothing holds the loads, or it does not come to rest within so many steps.
        OptionError: for arguments out of range.
    """
    model = scene if isinstance(scene, StaticModel) else StaticModel.of(scene)
    part, limit = positive("tolerance", tolerance), whole("iterations", iterations, 1)
    require_held(model, parameter)
    x = placed(model, parameter)
    target = np.array(model.rod_lengths)
    Z = model.boundary.Z
    forces = linear_systems.rod_forces(model, x, model.gradient(x, parameter))
    masses = _masses(model, x, forces, parameter)
    velocity = np.zeros(Z.shape[1])
    energy, longest = 0.0, LONGEST_STEP * model.scale[0]
    first, size = 0.0, np.inf
    form = "{l_bar}{bar}| {n:.1f} digits [{elapsed}]"
    shown = bar(progress, f"relaxing {model.scene.name}", total=12, unit="digit", bar_format=form)
    try:
        for taken in range(limit):
            gradient = model.gradient(x, parameter)
            C = sparse.csr_array(model.rod_slopes(x) @ Z)
            reduced, light = Z.T @ gradient, sparse.csr_array(C @ sparse.diags_array(1.0 / masses))
            # So little that redundant rods leave no singular matrix.
            ridge = linear_systems.RIDGE * (float((light * C).sum(axis=1).max(initial=0.0)) or 1.0)
            normal = splu(sparse.csc_array(light @ C.T + ridge * sparse.eye_array(C.shape[0], format="csr")))
            forces = -normal.solve(light @ reduced)
            left = reduced + C.T @ forces
            forces -= normal.solve(light @ left)  # refined: normal equations lose digits
            left = reduced + C.T @ forces
            size, rough = float(np.abs(left).max(initial=0.0)), round_off(model, x, parameter, forces)
            lengthened = target - (model.rod_lengths + model.compliance * forces)
            settled = float(np.abs(lengthened).max(initial=0.0)) <= 1e-13 * model.scale[0]
            if size <= max(part * _largest(model, x, forces, parameter), 4 * rough) and settled:
                return StaticState(
                    model, x.reshape(-1, 3).copy(), linear_systems.rod_forces(model, x, gradient), parameter, taken
                )
            first = max(first, size)
            if taken % 50 == 0:
                shown.n = round(max(0.0, float(np.log10(first / size))), 1)
                shown.refresh()
            before = velocity
            velocity = velocity - light.T @ normal.solve(C @ velocity) - left / masses
            fastest = float(np.abs(velocity).max(initial=0.0))
            if fastest > longest:
                velocity *= longest / fastest
            now = 0.5 * float(velocity @ (masses * velocity))
            step = velocity
            if now < energy:
                # The peak was about half a step ago.
                step, velocity, energy = -0.5 * before, np.zeros_like(velocity), 0.0
                masses = _masses(model, x, forces, parameter)
                target = model.rod_lengths + model.compliance * forces
            else:
                energy = now
            there = linear_systems.projected(model, x + Z @ step, target)
            if there is None:
                raise _restless(model, taken, size)
            x = there
    finally:
        shown.close()
    raise _restless(model, limit, size)


def _masses(model: StaticModel, x: Array, forces: Array, parameter: float) -> Array:
    """(q,): above a quarter of what strings, and rods by their forces, resist a coordinate with (Gershgorin)."""
    Z = model.boundary.Z
    # Every string counts as taut: those that are slack may become so.
    taut = model.with_(rest_lengths=np.minimum(model.rest_lengths, model.lengths(x) * (1 - 1e-9)))
    K = Z.T @ taut.hessian(x, np.abs(forces)) @ Z
    rows = np.asarray(np.abs(sparse.csr_array(K)).sum(axis=1)).ravel()
    load = float(np.abs(model.external(parameter)).max(initial=0.0)) / model.scale[0]
    return SAFETY * np.maximum(0.25 * rows, max(1e-6 * float(rows.max(initial=0.0)), load, 1e-300))


def _largest(model: StaticModel, x: Array, forces: Array, parameter: float) -> float:
    tension = model.tensions(model.lengths(x))
    parts = (tension, np.abs(forces), np.abs(model.external(parameter)))
    return max(float(part.max(initial=0.0)) for part in parts)


def _restless(model: StaticModel, taken: int, size: float) -> InfeasibleError:
    return InfeasibleError(
        f"'{model.scene.name}': not at rest after {taken} steps of dynamic relaxation: {size:.3g} N are left; allow "
        "more iterations, use find_equilibrium, or start nearer (nodes=...)"
    )


BALANCED = 1e-9  # of the largest force in a member or load: less than that is left in equilibrium


@dataclass(frozen=True, eq=False)
class Balance:
    """Distance of a structure from equilibrium: the forces on its nodes that neither rods nor supports can balance.

    Of the forces on the nodes (strings, weights, a rod's half at either end, and all that acts there), axial forces of
    the rods and reactions of supports and holds take away as much as they can. What is left, r, is the least there is
    in the sum of its squares: the part of the forces along motions that keep rods' lengths and supports. The unbalanced
    force is the largest magnitude of it on a node,

        max_n ‖r_n‖₂        r = -Z Zᵀ (∇Π + Cᵀ N),   N: those that leave the least

    which is zero in equilibrium, and the same in any system of coordinates. Elastic rods carry what their lengths say.

    Attributes:
        left: r (N, 3) [N].
        node: the name of the node with the largest of it.
        is_equilibrium: whether that is none, within round-off and `BALANCED` of the largest force.
    """

    left: Array
    node: str
    is_equilibrium: bool

    @property
    def unbalanced(self) -> float:
        """[N] its largest magnitude on a node."""
        return float(np.linalg.norm(self.left, axis=1).max(initial=0.0))

    def describe(self) -> str:
        """Return a description, as text."""
        size = f"{self.unbalanced:.5g} N"
        if self.is_equilibrium:
            return f"{size}, round-off: an equilibrium" if self.unbalanced > 0 else "none: an equilibrium"
        return f"{size} on node '{self.node}', the largest that neither rods nor supports can balance"


def balance(model: StaticModel) -> Balance:
    """Return the balance of a model at its start, without what the parameter of a path multiplies."""
    x, Z = model.start.ravel(), model.boundary.Z
    gradient = model.gradient(x, 0.0)
    forces = linear_systems.rod_forces(model, x, gradient)
    left = -(Z @ (Z.T @ (gradient + model.rod_pulls(x, forces)))).reshape(-1, 3)
    parts = (model.tensions(model.lengths(x)), forces, model.external(0.0), model.element_forces(x))
    largest = max(float(np.abs(part).max(initial=0.0)) for part in parts)
    sizes = np.linalg.norm(left, axis=1)
    threshold = max(BALANCED * largest, round_off(model, x, 0.0, forces))
    worst = model.structure.node_names[int(sizes.argmax())] if len(sizes) else ""
    return Balance(left, worst, bool(sizes.max(initial=0.0) <= threshold))


def unheld_gravity(scene: Scene) -> Array:
    """(3,) [m/s²]: the part of gravity along straight lines on which no support holds the structure; zero for none.

    Contact and water hold only where the structure touches them, and are left out.
    """
    gravity = np.array(scene.gravity)
    free = StaticModel.of(scene).boundary.straight_ways()
    falls = free @ (free.T @ gravity)
    return falls if np.linalg.norm(falls) > 1e-9 * np.linalg.norm(gravity) else np.zeros(3)
