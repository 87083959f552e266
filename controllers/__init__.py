"""The thesis' control laws, one a file: state in, string force densities out."""

from typing import TYPE_CHECKING

from tensegrity_mj.basics.faces import face

if TYPE_CHECKING:
    from tensegrity_mj.controllers.degraded import Delayed as Delayed
    from tensegrity_mj.controllers.degraded import Noisy as Noisy
    from tensegrity_mj.controllers.feedback_linearization import FeedbackLinearization as FeedbackLinearization
    from tensegrity_mj.controllers.known import KnownWater as KnownWater
    from tensegrity_mj.controllers.lyapunov import Lyapunov as Lyapunov
    from tensegrity_mj.controllers.optimal_allocation import Allocation as Allocation
    from tensegrity_mj.controllers.optimal_allocation import Sum as Sum
    from tensegrity_mj.controllers.optimal_allocation import WhenInfeasible as WhenInfeasible
    from tensegrity_mj.controllers.program import Program as Program
    from tensegrity_mj.controllers.projection import Projection as Projection
    from tensegrity_mj.controllers.quadratic_terms import Gains as Gains
    from tensegrity_mj.controllers.quadratic_terms import Onto as Onto
    from tensegrity_mj.controllers.replay import Replay as Replay
    from tensegrity_mj.controllers.scenes import SCENE_LAW as SCENE_LAW
    from tensegrity_mj.controllers.scenes import from_scene as from_scene
    from tensegrity_mj.controllers.table import LAWS as LAWS
    from tensegrity_mj.dynamics.native.compiled_law import CompiledLaw as CompiledLaw
else:
    __getattr__, __dir__ = face(__name__)
