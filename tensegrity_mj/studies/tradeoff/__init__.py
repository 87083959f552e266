"""Speed against accuracy: the work-precision diagram of a scene."""

from typing import TYPE_CHECKING

import tensegrity_mj.engines.mujoco  # noqa: F401  (refuses an environment in which MuJoCo cannot be imported)
from tensegrity_mj.basics.faces import face

if TYPE_CHECKING:
    from tensegrity_mj.studies.tradeoff.experiments import TradeoffOptions as TradeoffOptions
    from tensegrity_mj.studies.tradeoff.study import Tradeoff as Tradeoff
    from tensegrity_mj.studies.tradeoff.study import tradeoff as tradeoff
else:
    __getattr__, __dir__ = face(__name__)
