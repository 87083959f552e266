"""Linear models of a scene about a state, from each engine's own equations; `linearize` derives how accurate they are.

chart        coordinates that all engines share
strings      keeps taut strings taut, and slack ones slack
differences  how far from the state, and with what weights
law          a law's rest lengths and force densities as inputs
model        the matrices, and what follows from them
"""

from typing import TYPE_CHECKING

from tensegrity_mj.basics.faces import face

if TYPE_CHECKING:
    from tensegrity_mj.linearization.linearizing import linearize as linearize
    from tensegrity_mj.linearization.model import Linearization as Linearization
else:
    __getattr__, __dir__ = face(__name__)
