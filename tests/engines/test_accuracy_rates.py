"""The fastest rates of strings, against the eigenvalues of rods' own mechanics."""

import numpy as np
import pytest

import tensegrity_mj as tmj
from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.engines.accuracy.rates import string_rates
from tensegrity_mj.model.structure import Structure


def mobility(structure: Structure, nodes: Array) -> Array:
    """M⁻¹ (3N, 3N) of free uniform rods: a force f at an end moves the middle by f / m, and turns by I⁻¹ r × f."""
    out = np.zeros((nodes.size, nodes.size))
    for (i, j), mass, length in zip(structure.rod_nodes, structure.rod_masses, structure.rod_lengths, strict=True):
        middle = 0.5 * (nodes[i] + nodes[j])
        for force_at in (i, j):
            for axis in range(3):
                force = np.eye(3)[axis]
                turning = np.cross(nodes[force_at] - middle, force) / (mass * length**2 / 12)
                for node in (i, j):
                    moved = force / mass + np.cross(turning, nodes[node] - middle)
                    out[3 * node : 3 * node + 3, 3 * force_at + axis] = moved
    return out


def slopes(structure: Structure, nodes: Array) -> Array:
    """∂L/∂q (M, 3N) by central differences of 1e-6 m, of an error of 1e-10 at most."""
    steps = 1e-6 * np.eye(nodes.size).reshape(-1, *nodes.shape)
    ahead, back = (np.array([structure.string_lengths(nodes + s * one) for one in steps]) for s in (1, -1))
    return (ahead - back).T / 2e-6


@pytest.mark.parametrize(("name", "digits"), [("prism", 1e-8), ("six_bar_push", 1e-8), ("tower", 0.1)])
def test_rates_of_strings_are_eigenvalues(name: str, digits: float) -> None:
    """Of 100 strings or fewer as exact as the differences; of more by the power method, from below, to some percent."""
    structure = tmj.load_scene(name).structure
    nodes = structure.positions
    L, mobile = slopes(structure, nodes), mobility(structure, nodes)
    turn, decay = string_rates(structure, nodes)
    for found, weights in ((turn**2, structure.stiffness), (decay, structure.damping)):
        wanted = float(np.linalg.eigvals(mobile @ L.T @ (weights[:, None] * L)).real.max())
        assert wanted * (1 - digits) <= found <= wanted * (1 + 1e-8)


def test_rates_follow_bodies() -> None:
    """Strings between bodies, with the bodies' own mobility, as exact as differences."""
    structure = tmj.load_scene("spine").structure
    nodes = structure.positions
    L, mobile = slopes(structure, nodes), np.zeros((nodes.size, nodes.size))
    for frame in structure.moving_frames:
        flat = (3 * frame.rows[:, None] + np.arange(3)).ravel()
        mobile[np.ix_(flat, flat)] = frame.mobility(nodes)
    wanted = np.linalg.eigvals(mobile @ L.T @ (structure.stiffness[:, None] * L)).real.max()
    assert string_rates(structure, nodes)[0] ** 2 == pytest.approx(wanted, rel=1e-8)


def test_rates_do_not_depend_on_damping_in_proportion() -> None:
    """The rate of dampers in proportion to stiffness is found from it, and that of others by itself: nearly alike."""
    structure = tmj.load_scene("six_bar_push").structure
    alike = structure.with_strings(damping=1e-3 * structure.stiffness)
    other = structure.with_strings(damping=1e-3 * structure.stiffness * (1 + 1e-9 * np.arange(len(structure.strings))))
    first, second = (string_rates(one, structure.positions)[1] for one in (alike, other))
    assert first == pytest.approx(second, rel=1e-9 * len(structure.strings))
