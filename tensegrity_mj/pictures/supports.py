"""Places at which pictures show that a structure is held."""

from __future__ import annotations

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.model.structure import Structure


def supported_points(structure: Structure, nodes: Array) -> list[tuple[Array, int]]:
    """Return the points [m] where the structure is held, each with its number of held directions (1 to 3)."""
    places = support_places(structure)
    return [((1.0 - sigma) * nodes[i] + sigma * nodes[j], held) for i, j, sigma, held, _ in places]


def support_places(structure: Structure) -> list[tuple[int, int, float, int, str]]:
    """Rows of two nodes, σ of the held point between them, in how many directions it is held, and what holds it.

    Linear constraints of one or two nodes are among them.
    """
    rows = structure.node_index
    places = [(rows[name], rows[name], 0.0, 3, name) for name in structure.fixed_nodes]
    for rod, (i, j) in zip(structure.rods, structure.rod_nodes.tolist(), strict=True):
        if held := len(rod.support.directions):
            places.append((i, j, rod.support.sigma, held, f"support of {rod.name}"))
    for one in structure.constraints:
        (first, *_), (last, weight), total = one.nodes, list(one.nodes.items())[-1], sum(one.nodes.values())
        if len(one.nodes) <= 2 and total:
            places.append((rows[first], rows[last], weight / total, 1, one.name))
    return places
