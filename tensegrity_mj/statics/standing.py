"""A structure that stands on a floor: its equilibrium without friction, and how a string shortened makes it tip.

A floor that only pushes upwards holds the height of the nodes of its base. What it carries there is in balance with the
weight, so that the share of a corner falls to zero where the centre of mass comes to be above the opposite edge: there
it tips. (Friction adds forces along the floor, which deform the structure a little, but none that hold it up.)
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.basics.checks import names_from
from tensegrity_mj.errors import InfeasibleError
from tensegrity_mj.model.rods import centre_of_mass
from tensegrity_mj.model.scene import Scene
from tensegrity_mj.runs.standing import edge_margins
from tensegrity_mj.statics.boundary import Hold
from tensegrity_mj.statics.equilibrium import find_equilibrium
from tensegrity_mj.statics.model import StaticModel
from tensegrity_mj.statics.state import StaticState

FRACTIONS = (0.85, 0.7, 0.55, 0.42, 0.3)  # of a rest length, at which it is looked for
CLOSE = 1e-6  # of a fraction, to which it is found


@dataclass(frozen=True)
class Tipping:
    """A string that, shortened to this fraction of its rest length, brings the centre of mass above an edge."""

    string: str
    fraction: float
    state: StaticState


def stand(
    scene: Scene, base: Sequence[str], rest_lengths: Array | None = None, nodes: Array | None = None
) -> StaticState:
    """The equilibrium of a scene on three nodes, whose heights a floor without friction holds as they are at the start.

    Args:
        base: names of three nodes.
        rest_lengths: (M,) [m], other than the structure's.
        nodes: (N, 3) [m] where to start.

    Raises:
        InfeasibleError: where there is none.
    """
    up = -np.array(scene.gravity) if np.any(scene.gravity) else np.array([0.0, 0.0, 1.0])
    hold = Hold(tuple(base), (tuple(up.tolist()),))
    return find_equilibrium(StaticModel.of(scene, holds=(hold,), rest_lengths=rest_lengths, nodes=nodes))


def margins(state: StaticState, base: Sequence[str]) -> Array:
    """(3,) [m]: how far the centre of mass is inside the edges of the base, the first from its node 0 to 1."""
    structure = state.model.structure
    up = -np.array(state.model.scene.gravity)
    corners = state.nodes[[structure.node_index[name] for name in base]]
    return edge_margins(corners, centre_of_mass(structure, state.nodes), up / np.linalg.norm(up))


def tipping(scene: Scene, base: Sequence[str], edge: int, strings: Sequence[str] | None = None) -> Tipping | None:
    """The string that has to be shortened least so that the scene tips over an edge of its base, or None.

    Each string alone is shortened down to 0.3 of its rest length; at the point of tipping the others' margins are
    positive.

    Args:
        edge: number of the edge of the base, 0 from its first node to the second.
        strings: names of those that are tried; all by default.
    """
    names = [string.name for string in scene.structure.strings]
    tried = names_from("tipping: strings", strings, names)
    at_rest = stand(scene, base)
    best: Tipping | None = None
    for string in _by_effect(scene, base, edge, [names.index(name) for name in tried], at_rest):
        found = _tipped(scene, base, edge, string, at_rest, 0.0 if best is None else best.fraction)
        best = best if found is None else found
    return best


def _shortened(scene: Scene, base: Sequence[str], string: int, fraction: float, before: StaticState) -> StaticState:
    lengths = np.array(scene.structure.rest_lengths)
    lengths[string] *= fraction
    return stand(scene, base, lengths, before.nodes)


def _by_effect(scene: Scene, base: Sequence[str], edge: int, strings: Sequence[int], at_rest: StaticState) -> list[int]:
    """The strings, first those that bring the centre of mass nearest to the edge when they are pulled in a little."""
    if len(strings) < 2:
        return list(strings)
    found = []
    for number in strings:
        left = margins(_shortened(scene, base, number, FRACTIONS[0], at_rest), base)
        found.append(left[edge] if len(left) else np.inf)
    return [strings[k] for k in np.argsort(found, kind="stable")]


def _tipped(
    scene: Scene, base: Sequence[str], edge: int, string: int, at_rest: StaticState, least: float
) -> Tipping | None:
    """Find where the centre of mass is above the edge: a root in the first interval with one; None below `least`."""
    from scipy.optimize import brentq

    before, high = at_rest, 1.0
    for low in FRACTIONS:
        if high <= least:
            return None
        try:
            state = _shortened(scene, base, string, low, before)
        except InfeasibleError:
            return None
        distances = margins(state, base)
        if len(distances) != 3 or np.min(np.delete(distances, edge)) <= 0:
            return None
        if distances[edge] <= 0:
            break
        before, high = state, low
    else:
        return None

    def margin(fraction: float) -> float:
        return float(margins(_shortened(scene, base, string, fraction, before), base)[edge])

    fraction = float(brentq(margin, low, high, xtol=CLOSE))
    if fraction <= least:
        return None
    return Tipping(scene.structure.strings[string].name, fraction, _shortened(scene, base, string, fraction, before))
