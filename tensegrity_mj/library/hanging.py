"""How chains and nets of rods hang: the nodes at which their weight is lowest, to round-off."""

from __future__ import annotations

import numpy as np

from tensegrity_mj.basics.checks import positive
from tensegrity_mj.errors import InfeasibleError
from tensegrity_mj.model.scene import Scene
from tensegrity_mj.model.structure import Structure
from tensegrity_mj.statics.equilibrium import find_equilibrium
from tensegrity_mj.statics.model import StaticModel

SPRINGS = (0.0, 1e-2, 1e-4)  # what stands in for rods at first: by which part they stretch under the whole weight
PUSHED = 1e-9  # of the weight: a rod that is compressed by less is not


def hung(structure: Structure, length: float, gravity: float) -> Structure:
    """The structure where its rods, each of that length [m], hang from its supports under gravity [m/s²] along -z.

    Its nodes are a first guess, between which rods may have other lengths. Where the rods come to no rest from there,
    or to one in which some are compressed, it starts again from where springs in place of the rods hang. Where every
    rod pulls, the equilibrium is a stable one, however it was found.

    Raises:
        OptionError: for gravity that is not > 0.
        InfeasibleError: where no equilibrium is found: held nodes too far from each other, for one.
    """
    weight = positive("gravity", gravity, "m/s²") * float(structure.rod_masses.sum())
    model = StaticModel.of(Scene(structure, gravity=(0.0, 0.0, -gravity)))
    model = model.with_(rod_lengths=np.full(len(structure.rods), length))
    found = None
    for part in SPRINGS:
        try:
            springs = model.with_(compliance=part * model.rod_lengths / weight)
            start = find_equilibrium(springs, stable=False).nodes if part else model.start
            found = find_equilibrium(model.with_(start=start), stable=False)
        except InfeasibleError:
            continue
        if found.rod_forces.min() >= -PUSHED * weight:
            break
    if found is None:
        raise InfeasibleError(
            f"the rods of '{structure.name}' hang in no equilibrium that could be found: held nodes may be too far "
            "from each other, or the first guess too far from where it hangs"
        )
    return structure.placed(found.nodes)
