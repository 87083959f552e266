"""Simulation of a scene under a law: `single` makes one run, `ensemble` many at once."""

from typing import TYPE_CHECKING

from tensegrity_mj.basics.faces import face

if TYPE_CHECKING:
    from tensegrity_mj.simulation.ensemble import Ensemble as Ensemble
    from tensegrity_mj.simulation.ensemble import law_in as law_in
    from tensegrity_mj.simulation.ensemble import simulate_many as simulate_many
    from tensegrity_mj.simulation.single import Engine as Engine
    from tensegrity_mj.simulation.single import accelerations as accelerations
    from tensegrity_mj.simulation.single import simulate as simulate
    from tensegrity_mj.simulation.single import simulate_as_far as simulate_as_far
    from tensegrity_mj.simulation.single import versions as versions
else:
    __getattr__, __dir__ = face(__name__)
