"""Scenes for what is built on dm_control: a Physics, a PyMJCF element, a composer Entity, an Environment.

    physics = tensegrity_mj.learning.dm_control.physics(scene)
    root = tensegrity_mj.learning.dm_control.element(scene)
    robot = tensegrity_mj.learning.dm_control.TensegrityEntity(scene)
    env = tensegrity_mj.learning.dm_control.environment(scene, Command.FORCE_DENSITY, control_timestep=0.01)

See docs/dm_control.md. None of it installs a callback in MuJoCo: any number of them live side by side.

Importing it raises `tensegrity_mj.errors.MissingPackageError` where dm-control, or a package that it needs, is missing.
"""

from typing import TYPE_CHECKING

from tensegrity_mj.basics.dependencies import require_dm_control
from tensegrity_mj.basics.faces import face

require_dm_control()

from tensegrity_mj.learning.dm_control.environments import environment as environment  # noqa: E402 - after the check
from tensegrity_mj.learning.dm_control.environments import physics as physics  # noqa: E402
from tensegrity_mj.learning.dm_control.environments import task_environment as task_environment  # noqa: E402
from tensegrity_mj.learning.dm_control.models import adopt_options as adopt_options  # noqa: E402
from tensegrity_mj.learning.dm_control.models import element as element  # noqa: E402
from tensegrity_mj.learning.dm_control.repairing import repair as repair  # noqa: E402
from tensegrity_mj.learning.tasks.definition import RandomStart as RandomStart  # noqa: E402

if TYPE_CHECKING:  # these subclass dm_control's own classes, which are repaired before they are imported
    from tensegrity_mj.learning.dm_control.stepping import PhysicsDivergence as PhysicsDivergence
    from tensegrity_mj.learning.dm_control.stepping import ScenePhysics as ScenePhysics
    from tensegrity_mj.learning.dm_control.stepping import TensegrityEntity as TensegrityEntity
    from tensegrity_mj.learning.dm_control.tasks import TensegrityTask as TensegrityTask
else:
    __getattr__, __dir__ = face(__name__, before=repair)
