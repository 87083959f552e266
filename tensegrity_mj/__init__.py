"""tensegrity_mj: a MuJoCo testbed for tensegrity structures, checked by an independent DAE reference model.

SI units, radians; the world frame is right-handed with z up. Each name is imported when it is first used. Further names
are where they belong: `model`, `controllers`, `engines`, `runs`, `statics`, `studies`, `pictures`, `errors`, and by an
import of their own `dm_control`, `library`, `vibration`.
"""

from typing import TYPE_CHECKING

from tensegrity_mj.basics import notebook_pictures
from tensegrity_mj.basics.faces import face

if TYPE_CHECKING:
    from tensegrity_mj import controllers as controllers
    from tensegrity_mj import engines as engines
    from tensegrity_mj import errors as errors
    from tensegrity_mj import model as model
    from tensegrity_mj import pictures as pictures
    from tensegrity_mj import runs as runs
    from tensegrity_mj import statics as statics
    from tensegrity_mj import studies as studies
    from tensegrity_mj.calls import accelerations as accelerations
    from tensegrity_mj.calls import identify as identify
    from tensegrity_mj.calls import law_in as law_in
    from tensegrity_mj.calls import linearize as linearize
    from tensegrity_mj.calls import simulate as simulate
    from tensegrity_mj.calls import simulate_many as simulate_many
    from tensegrity_mj.calls import stable_step as stable_step
    from tensegrity_mj.dynamics.native.law import Command as Command
    from tensegrity_mj.engines.jax.settings import JAX as JAX
    from tensegrity_mj.engines.mujoco.settings import Integrator as Integrator
    from tensegrity_mj.engines.mujoco.settings import MuJoCo as MuJoCo
    from tensegrity_mj.engines.reference.dae import DAE as DAE
    from tensegrity_mj.engines.reference.method import Method as Method
    from tensegrity_mj.engines.reference.ode import ODE as ODE
    from tensegrity_mj.errors import TensegrityError as TensegrityError
    from tensegrity_mj.library.named import load_scene as load_scene
    from tensegrity_mj.model.actuation import Actuation as Actuation
    from tensegrity_mj.model.actuation import OnInfeasible as OnInfeasible
    from tensegrity_mj.model.elements.resistance import Resistance as Resistance
    from tensegrity_mj.model.elements.water import Water as Water
    from tensegrity_mj.model.members import PointMass as PointMass
    from tensegrity_mj.model.members import Rod as Rod
    from tensegrity_mj.model.members import String as String
    from tensegrity_mj.model.members import Support as Support
    from tensegrity_mj.model.scene import Scene as Scene
    from tensegrity_mj.model.structure import Structure as Structure
    from tensegrity_mj.model.target import Target as Target
    from tensegrity_mj.model.text.writing import save_scene as save_scene
    from tensegrity_mj.pictures.video import render as render
    from tensegrity_mj.runs.clearances import clearance as clearance
    from tensegrity_mj.runs.comparison import compare as compare
    from tensegrity_mj.runs.trajectory import Status as Status
    from tensegrity_mj.runs.trajectory import Trajectory as Trajectory
else:
    __getattr__, __dir__ = face(__name__)


def _draw(item: "Scene | Trajectory") -> bytes | None:
    from tensegrity_mj.model.scene import Scene
    from tensegrity_mj.pictures import plots, video

    return video.png_of(item) if isinstance(item, Scene) else plots.png_of(item)


notebook_pictures.draw = _draw
