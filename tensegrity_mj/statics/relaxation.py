"""Equilibrium by dynamic relaxation with kinetic damping: the thesis' way of form-finding (§7.2.3).

Fictitious masses move under the forces in steps of one unit of time, on the lengths of the rods. Where the kinetic
energy has just passed a peak everything is put back by half a step, stopped, and let go again (Barnes 1999). It needs
nothing but forces, and so is a check on Newton's method, which is some ten times faster.
"""

from __future__ import annotations

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import splu

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.basics.checks import positive, whole
from tensegrity_mj.basics.progress import bar
from tensegrity_mj.errors import InfeasibleError
from tensegrity_mj.model.scene import Scene
from tensegrity_mj.model.structure import Structure
from tensegrity_mj.statics import linear_systems
from tensegrity_mj.statics.body_motions import require_held
from tensegrity_mj.statics.equilibrium import placed
from tensegrity_mj.statics.model import StaticModel
from tensegrity_mj.statics.rounding import round_off
from tensegrity_mj.statics.state import StaticState

# Steps of one unit are stable for masses above a quarter of the stiffness; so much more, for it grows on the way.
SAFETY = 1.6
LONGEST_MOVE = 0.1  # of the mean member, of any node in one step


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
    energy, longest = 0.0, LONGEST_MOVE * model.scale[0]
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
