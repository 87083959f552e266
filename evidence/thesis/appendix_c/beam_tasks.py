"""Computations on the beams of appendix C and the tower of §7.2.3: tasks of `run_many`, plain values in and out.

A beam is named by its row of Table C.2, with a star where its springs are what the rest of the table needs: "TB6*".
A point may have a "disturbance", plain as `disturbance_of` takes it.
Its rods are elastic, as in the thesis' finite elements, but for MuJoCo, whose rods are rigid. Its form is found free;
then the three nodes of its base are held, and those of its top are moved together: along the beam (x) or across it
(y, z).
"""

from __future__ import annotations

import functools
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evidence.families.thesis_towers import APPENDIX_STAGES, appendix_beam, chapter7_tower
from evidence.families.towers import base_nodes, middle_nodes, top_nodes, tower_length
from evidence.thesis.disturbance import disturbance_of, disturbed
from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.library.tower import form_find
from tensegrity_mj.model.events import Load
from tensegrity_mj.model.scene import Scene
from tensegrity_mj.statics.boundary import Hold
from tensegrity_mj.statics.equilibrium import balance, find_equilibrium
from tensegrity_mj.statics.model import Rods, StaticModel
from tensegrity_mj.statics.path import Path, follow
from tensegrity_mj.statics.path_steps import Kind
from tensegrity_mj.statics.state import StaticState

BASE, TOP = tuple(base_nodes()), tuple(top_nodes(APPENDIX_STAGES))
MIDDLE = middle_nodes(APPENDIX_STAGES)
# m: the ends of the thesis' axes
STRETCH, SHORTENING, SIDEWAYS = 1.6, 3.5, 8.0
POINTS = {"tension": 16, "compression": 28, "lateral": 20, "imperfect": 40}
# N, across the beam, on the six nodes in its middle together: a hundredth of what buckles it
IMPERFECTION = 100.0
LONGEST = 1.2  # the arc of a path that has buckled, of a straight one


def scene_of(point: dict[str, Any]) -> Scene:
    """The beam of a point, form-found with rigid rods, and then with the error that the point has."""
    beam = point["beam"]
    scene = appendix_beam(beam.rstrip("*"), corrected=beam.endswith("*"))
    return disturbed(scene, disturbance_of(point.get("disturbance")))


def standing(point: dict[str, Any]) -> StaticState:
    """Find the beam's free equilibrium with elastic rods."""
    return _standing(point["beam"], tuple(point.get("disturbance") or ()))


@functools.cache
def _standing(beam: str, disturbance: tuple[Any, ...]) -> StaticState:
    scene = scene_of({"beam": beam, "disturbance": disturbance or None})
    return find_equilibrium(StaticModel.of(scene, rods=Rods.ELASTIC))


def section_area(state: StaticState) -> float:
    """A [m²] of the rods."""
    section = state.model.structure.rods[0].section
    assert section is not None
    return section.area


# ----------------------------------------------------------------------------------------------------- at zero load


def found(point: dict[str, Any]) -> dict[str, Any]:
    """The form, its prestress, and its stiffness [N/m] against the top's motion (3, 3) at zero load."""
    state = standing(point)
    structure = state.model.structure
    before = appendix_beam(point["beam"].rstrip("*"), corrected=point["beam"].endswith("*"), form_found=False)
    along = state.nodes[:, 0] - state.nodes[:3, 0].mean()
    levels = along.reshape(APPENDIX_STAGES, 2, 3).mean(axis=2)  # b and t of every stage
    return {
        "length": tower_length(state.nodes),
        "stresses": (-state.rod_forces / section_area(state)).tolist(),
        "least_tension": float(state.tensions.min()),
        "overlap": float(np.mean(levels[:-1, 1] - levels[1:, 0])),
        "before": before.nodes0.tolist(),
        "nodes": state.nodes.tolist(),
        "rods": structure.rod_nodes.tolist(),
        "strings": structure.string_nodes.tolist(),
        "stiffness": _guided(structure.node_index, state.motions(), state.stiffness()).tolist(),
    }


def _places(index: dict[str, int], names: Sequence[str]) -> NDArray[np.int64]:
    return np.array([3 * index[name] + k for name in names for k in range(3)])


def confirmed(point: dict[str, Any]) -> dict[str, Any]:
    """Compute the stiffness by MuJoCo's own equations, from central differences of its forces; rods are rigid."""
    from tensegrity_mj.engines.mujoco.settings import MuJoCo
    from tensegrity_mj.linearization.chart import Chart
    from tensegrity_mj.statics.engines import AtRest
    from tensegrity_mj.statics.modes import mass_matrix

    scene = scene_of(point)
    structure, nodes = scene.structure, scene.nodes0
    engine, chart = AtRest(scene, MuJoCo()), Chart(structure, nodes)
    n, rest = chart.size, np.zeros(chart.size)
    moves = np.array([chart.state(rest, unit)[1].ravel() for unit in np.eye(n)]).T  # (3N, n)
    M = moves.T @ (mass_matrix(structure) @ moves)
    K = -M @ engine.slopes(chart)
    # A step of Newton's method, across the six motions of the whole, that nothing resists.
    values, vectors = np.linalg.eigh(0.5 * (K + K.T))
    held = np.abs(values) > 1e-6 * values.max()
    force = M @ engine.accelerations(chart, rest)
    step = vectors[:, held] @ ((vectors[:, held].T @ force) / values[held])
    there = chart.state(step, rest)[0]
    return {
        "length": tower_length(there),
        "move": float(np.abs(there - nodes).max()),
        "neutral": int(np.sum(~held)),
        "stiffness": _guided(structure.node_index, moves, K).tolist(),
    }


def _guided(index: dict[str, int], moves: Array, K: Array) -> Array:
    """(3, 3): the force on the top for its displacement, the base held, all other nodes where they balance.

    K is of coordinates (n,) that move the nodes by `moves` (3N, n).
    """
    held = moves[np.concatenate([_places(index, BASE), _places(index, TOP)])]
    count, n = held.shape
    wanted = np.vstack([np.zeros((9, 3)), np.tile(np.eye(3), (3, 1))])
    matrix = np.block([[0.5 * (K + K.T), held.T], [held, np.zeros((count, count))]])
    way = np.linalg.solve(matrix, np.vstack([np.zeros((n, 3)), wanted]))[:n]
    return np.asarray(way.T @ K @ way)


# ------------------------------------------------------------------------------------------------------------ paths


def tension(point: dict[str, Any]) -> dict[str, Any]:
    """The top pulled along the beam."""
    return _path_values(_moved(standing(point), (STRETCH, 0.0, 0.0), "tension"), 0, STRETCH)


def compression(point: dict[str, Any]) -> dict[str, Any]:
    """The top pushed along the perfect beam, which stays straight beyond where it becomes unstable."""
    path = _moved(standing(point), (-SHORTENING, 0.0, 0.0), "compression")
    first = next((one for one in path.criticals if one.unstable_after > one.unstable_before), None)
    kind = None if first is None else first.kind.value
    at = None if first is None else first.parameter * SHORTENING
    together = 0 if first is None else first.unstable_after - first.unstable_before
    return {**_path_values(path, 0, -SHORTENING), "unstable_from": at, "kind": kind, "modes": together}


def imperfect(point: dict[str, Any]) -> dict[str, Any]:
    """Follow the beam with a small load across its middle, as far as it goes after it has buckled."""
    state = standing(point)
    scene = state.model.scene.with_(loads=tuple(Load(key, (0.0, 0.0, IMPERFECTION / len(MIDDLE))) for key in MIDDLE))
    held = StaticModel.of(scene, rods=Rods.ELASTIC, nodes=state.nodes, holds=(Hold(BASE), Hold(TOP)))
    path = _moved(find_equilibrium(held), (-SHORTENING, 0.0, 0.0), "imperfect", LONGEST)
    values = _path_values(path, 0, -SHORTENING)
    rows = [state.model.structure.node_index[key] for key in MIDDLE]
    bent = path.nodes[:, rows].mean(axis=1) - path.nodes[0, rows].mean(axis=0)
    limits = [one.parameter * SHORTENING for one in path.criticals if one.kind is Kind.LIMIT]
    return {**values, "bent": np.linalg.norm(bent[:, 1:], axis=1).tolist(), "limits": limits, "end": path.end.value}


def lateral(point: dict[str, Any]) -> dict[str, Any]:
    """The top moved across the beam, without turning."""
    way = point["axis"]
    displacement = tuple(SIDEWAYS if k == way else 0.0 for k in range(3))
    return _path_values(_moved(standing(point), displacement, "lateral"), way, SIDEWAYS)


def _moved(state: StaticState, displacement: Sequence[float], what: str, longest: float = 3.0) -> Path:
    x, y, z = displacement
    return follow(state, holds=(Hold(BASE), Hold(TOP, None, (x, y, z))), points=POINTS[what], longest=longest)


def _path_values(path: Path, axis: int, displacement: float) -> dict[str, Any]:
    """Deformation w [m], force F [N], stiffness dF/dw [N/m], stress [Pa] and strings along a path.

    `least` is k (L - L0) [N] of the string that has least of it: below zero where it is slack.
    """
    forward = np.where(path.parameter_rates == 0, np.nan, 1.0)
    rates = np.array(path.reaction_rate(TOP)[:, axis]) * forward / displacement
    model, stress = path.model, np.abs(path.rod_forces).max(axis=1) / section_area(path.states[0])
    return {
        "w": (path.parameters * abs(displacement)).tolist(),
        "F": (path.reaction(TOP)[:, axis] * np.sign(displacement)).tolist(),
        "K": rates.tolist(),
        "turned": (path.parameter_rates <= 0).tolist(),
        "stress": stress.tolist(),
        "slack": [int(state.slack.sum()) for state in path.states],
        "least": [float(np.min(model.curves.stiffness * (one.lengths - model.rest_lengths))) for one in path.states],
        "unstable": path.unstable.tolist(),
    }


# ------------------------------------------------------------------------------------------------------- chapter 7


def tower(point: dict[str, Any]) -> dict[str, Any]:
    """The tower of §7.2.3 before and after form-finding, with rigid rods as in that chapter."""
    tower = chapter7_tower(point["stiffness"], point["measure"], topology=point["topology"], form_found=False)
    before = disturbed(tower, disturbance_of(point.get("disturbance")))
    state = find_equilibrium(before)
    structure = before.structure
    # Before, no forces along the rods balance the strings: what the best ones leave.
    model = StaticModel.of(before)
    pull, left = model.gradient(before.nodes0.ravel()), balance(model).left
    return {
        "rods_count": len(structure.rods),
        "strings_count": len(structure.strings),
        "before": before.nodes0.tolist(),
        "nodes": form_find(before).nodes0.tolist(),
        "rods": structure.rod_nodes.tolist(),
        "strings": structure.string_nodes.tolist(),
        "unbalanced_before": float(np.abs(left).max() / np.abs(pull).max()),
        "unbalanced_after": float(state.residual / np.abs(state.tensions).max()),
        "rod_forces": state.rod_forces.tolist(),
        "least_tension": float(state.tensions.min()),
    }
