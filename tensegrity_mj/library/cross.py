"""The planar tensegrity cross of the thesis' section 4.6.1 and appendix B.1: two rods, four strings."""

from __future__ import annotations

import numpy as np

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.basics.checks import finite, positive, real_array
from tensegrity_mj.model.events import ControlSpec
from tensegrity_mj.model.members import Rod, String, Support
from tensegrity_mj.model.scene import Scene
from tensegrity_mj.model.structure import Structure
from tensegrity_mj.model.target import Target

PLANE = (0.0, 1.0, 0.0)  # the thesis' x and y are x and z here
SLIDER = Support.constrained([[1.0, 0.0, 0.0]], sigma=0.0, plane=PLANE)
HINGE = Support.pinned(0.0, plane=PLANE)

THESIS = "A. S. Wroldsen, Modelling and Control of Tensegrity Structures, NTNU 2007:190"


def cross_nodes(y1: float, theta1: float, theta2: float, rod_length: float = float(np.sqrt(2.0))) -> Array:
    """Node positions (4, 3) [m] of q = (y₁ [m], θ₁, θ₂ [rad]), (B.4)."""
    return np.array(
        [
            [0.0, 0.0, y1],
            [0.0, 0.0, 0.0],
            [rod_length * np.cos(theta1), 0.0, y1 + rod_length * np.sin(theta1)],
            [rod_length * np.cos(theta2), 0.0, rod_length * np.sin(theta2)],
        ]
    )


def cross(
    start: tuple[float, float, float] = (1.33, -np.radians(70.0), np.radians(70.0)),
    end: tuple[float, float, float] = (0.48, -np.radians(20.0), np.radians(20.0)),
    rod_length: float = float(np.sqrt(2.0)),
    rod_mass: float = 5.0,
    stiffness: float = 100.0,
    minimum_sum: float = 1.2,
    duration: float = 10.0,
    name: str = "cross",
) -> Scene:
    """Two rods that cross: the foot of one slides on the vertical line x = 0, the other's is a hinge at the origin.

    The four strings go round: left, lower, right, upper. The target takes q = (y₁, θ₁, θ₂) from `start` to `end`, from
    rest to rest by one quintic, under feedback linearization.

    Args:
        start, end: q [m, rad, rad].
        rod_length, rod_mass: ℓ [m] and m [kg] of both.
        stiffness: stiffness of each string [N/m].
        minimum_sum: u_sum [N/m] of all strings, (4.13).
        duration: duration of the motion and of the scene [s].

    Raises:
        OptionError, StructureError, SceneError: for parameters that make no such scene.
    """
    for what, value, unit in (("rod_length", rod_length, "m"), ("duration", duration, "s")):
        positive(f"cross: {what}", value, unit)
    finite("cross: minimum_sum", minimum_sum, " [N/m]")
    y1, theta1, theta2 = (float(x) for x in real_array("cross: start", start, (3,), "m, rad, rad", scalar=False))
    first = cross_nodes(y1, theta1, theta2, rod_length)
    y1, theta1, theta2 = (float(x) for x in real_array("cross: end", end, (3,), "m, rad, rad", scalar=False))
    last = cross_nodes(y1, theta1, theta2, rod_length)
    names = ["n1", "n2", "n3", "n4"]
    structure = Structure(
        name=name,
        nodes=dict(zip(names, first.tolist(), strict=True)),
        rods=(
            Rod("rod1", ("n1", "n3"), rod_mass, 0.02, SLIDER),
            Rod("rod2", ("n2", "n4"), rod_mass, 0.02, HINGE),
        ),
        strings=tuple(
            String(title, nodes, stiffness)
            for title, nodes in (
                ("left", ("n1", "n2")),
                ("lower", ("n2", "n3")),
                ("right", ("n3", "n4")),
                ("upper", ("n4", "n1")),
            )
        ),
    )
    return Scene(
        structure,
        name=name,
        source=f"{THESIS}, section 4.6.1 and appendix B.1, pages 95-98",
        target=Target.path([0.0, duration], [first, last]),
        control=ControlSpec("feedback_linearization", {"sums": [["all", minimum_sum]]}),
        duration=duration,
    )
