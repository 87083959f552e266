"""Linear models of a scene about a state, from each engine's own equations; `linearize` derives how accurate they are.

chart        coordinates that all engines share
linearizing  the derivatives: steps and weights; strings stay taut or slack; a law's rest lengths; states of elements
model        the matrices, and what follows from them
"""

from typing import TYPE_CHECKING

from tensegrity_mj.basics.faces import face

if TYPE_CHECKING:
    from tensegrity_mj.linearization.linearizing import linearize as linearize
    from tensegrity_mj.linearization.model import Linearization as Linearization
else:
    __getattr__, __dir__ = face(__name__)
