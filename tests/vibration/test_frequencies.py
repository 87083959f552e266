"""The natural frequencies of a prestressed prism, linearized from both models, against an independent assembly.

tnsgrt's default prism: steel strings of 1e7 N/m that carry 1 N. Its softest mode (0.18 Hz) is held by the prestress
alone, 1e-7 of the stiffest, so a relative accuracy of 1e-6 there takes 1e-13 of the whole: no first difference of
forces gives that. What does:
- strings that pull and push (T = k (L - L0)). The linearization at a taut string is the same, and steps may be far
  longer than the 1e-7 m by which these strings are stretched;
- central differences of order 2 n. With step h along a unit tangent the truncation is (n!)² h^(2n) / R^(2n+1) of the
  stiffness, R = 1 m being the distance over which a string's length is analytic, and the round-off 4 eps / h. For
  n = 12, h = 0.05 these are 1e-14 and 2e-14 of the largest eigenvalue, 2e7 times the smallest: 6e-7 in ω², 3e-7 in f.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import mujoco
import numpy as np
import pytest
import scipy.linalg
import truth
from members import Members
from numpy.typing import NDArray

from tensegrity_mj.dynamics.kernels import accelerations
from tensegrity_mj.dynamics.records import StructureRecords
from tensegrity_mj.engines.mujoco.settings import MuJoCo
from tensegrity_mj.model import rods
from tensegrity_mj.model.members import null_space_basis
from tensegrity_mj.model.scene import Scene
from tensegrity_mj.model.structure import Structure

Array = NDArray[np.float64]

HALF_POINTS = 12
STEP = 0.05
RIGID = 6  # motions of the free prism as a whole
TOLERANCE = 1e-6


@pytest.fixture(scope="module")
def prism() -> tuple[Structure, Array]:
    """The structure, and its natural frequencies [Hz] without those of the rigid motions."""
    data = truth.load("tnsgrt_prism_default")
    strings = int(data["n_strings"])
    structure = Structure.from_arrays(
        data["nodes"].T,
        data["members"].T[strings:],
        data["members"].T[:strings],
        rod_mass=data["mass"][strings:],
        stiffness=data["member_stiffness"][:strings],
        force_density=data["force_density"][:strings],
    )
    return structure, np.sort(data["freq_hz_rigid_thin_bars_massless_strings"])[RIGID:]


def derivative(function: Callable[[float], Array]) -> Array:
    """f'(0) by the central difference over 2 n points, of order 2 n (Lagrange's weights)."""
    total: Array = np.zeros(1)
    n = HALF_POINTS
    for k in range(1, n + 1):
        weight = -((-1) ** k) * math.factorial(n) ** 2 / (k * math.factorial(n - k) * math.factorial(n + k))
        total = total + weight / STEP * (function(k * STEP) - function(-k * STEP))
    return total


def frequencies(squares: Array) -> Array:
    """Natural frequencies [Hz] from ω², without those of the rigid motions."""
    squares = np.sort(squares)
    # Rigid motions: zero to the accuracy that the softest mode needs.
    assert np.all(np.abs(squares[:RIGID]) < TOLERANCE * squares[RIGID])
    return np.sqrt(squares[RIGID:]) / (2 * np.pi)


def linear_tensions(structure: Structure, nodes: Array) -> Array:
    return structure.stiffness * (structure.string_lengths(nodes) - structure.rest_lengths)


def test_frequencies_of_the_thesis_model(prism: tuple[Structure, Array]) -> None:
    structure, expected = prism
    records = StructureRecords.of(structure)
    phi, y = records.affine_map
    q0 = records.coordinates(structure.positions)
    # The tangent space of ‖b‖ = 1, three translations and two turns a rod, as columns; q = (r, b) of each rod.
    tangent = np.zeros((records.nq, 5 * len(structure.rods)))
    for a, rod in enumerate(records.rods):
        at = int(rod["q"])
        tangent[at : at + 3, 5 * a : 5 * a + 3] = np.eye(3)
        tangent[at + 3 : at + 6, 5 * a + 3 : 5 * a + 5] = null_space_basis(q0[None, at + 3 : at + 6])

    def acceleration(direction: Array, distance: float) -> Array:
        """q̈ at rest, this far along the straight lines of r and the great circles of b."""
        q = q0 + distance * direction
        for rod in records.rods:
            b = slice(int(rod["q"]) + 3, int(rod["q"]) + 6)
            turn = direction[b]  # a unit vector or zero
            if turn.any():
                q[b] = np.cos(distance) * q0[b] + np.sin(distance) * turn
        nodes = (phi @ q + y).reshape(-1, 3)
        forces = rods.string_forces(structure, nodes, linear_tensions(structure, nodes))
        out = np.zeros(records.nq)
        multipliers = np.zeros(len(structure.rods))
        members = Members(records.rods, records.points, np.zeros(3), forces, multipliers)
        accelerations(members, q, np.zeros(records.nq), out)
        return out

    # At an equilibrium the tangent's own change does not count: q̈ is zero there.
    columns = [tangent.T @ derivative(lambda x, d=direction: acceleration(d, x)) for direction in tangent.T]
    found = np.linalg.eigvals(-np.column_stack(columns))
    assert np.abs(found.imag).max() < TOLERANCE * np.sort(found.real)[RIGID]
    error = np.abs(frequencies(found.real) / expected - 1)
    print(f"DAE: largest relative error of {len(expected)} frequencies: {error.max():.2e}")
    assert np.all(error <= TOLERANCE)


def test_frequencies_of_the_mujoco_model(prism: tuple[Structure, Array]) -> None:
    structure, expected = prism
    model = MuJoCo().model(Scene(structure))
    model.actuator_forcelimited[:] = 0  # strings that push, too
    data = mujoco.MjData(model)
    rest = data.qpos.copy()
    # A free joint has three translations and three turns in the rod's frame, whose z is the rod's axis: the spin
    # about it (last) moves no string.
    used = np.arange(model.nv).reshape(-1, 6)[:, :5].ravel()

    def force(direction: Array, distance: float) -> Array:
        data.qpos[:] = rest
        mujoco.mj_integratePos(model, data.qpos, direction, distance)
        mujoco.mj_forward(model, data)
        return data.qfrc_smooth[used].copy()

    stiffness = -np.column_stack([derivative(lambda x, d=d: force(d, x)) for d in np.eye(model.nv)[used]])
    data.qpos[:] = rest
    mujoco.mj_forward(model, data)
    mass = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, mass)
    inertia = mass[np.ix_(used, used)]
    assert not mass[used][:, np.setdiff1d(np.arange(model.nv), used)].any()
    # An equilibrium's stiffness is symmetric: what is not is error.
    asymmetry = np.abs(stiffness - stiffness.T).max() / np.abs(stiffness).max()
    found = scipy.linalg.eigh(0.5 * (stiffness + stiffness.T), inertia, eigvals_only=True)
    error = np.abs(frequencies(found) / expected - 1)
    print(f"MuJoCo: largest relative error of {len(expected)} frequencies: {error.max():.2e}")
    assert asymmetry <= 1e-13  # the 3e-14 above, on either side of the diagonal
    assert np.all(error <= TOLERANCE)
