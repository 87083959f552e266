"""Tasks for learning, which `tensegrity_mj.learning.gymnasium` and `tensegrity_mj.learning.dm_control` play."""

from typing import TYPE_CHECKING

from tensegrity_mj.basics.faces import face

if TYPE_CHECKING:
    from tensegrity_mj.learning.tasks.definition import Goal as Goal
    from tensegrity_mj.learning.tasks.definition import RandomStart as RandomStart
    from tensegrity_mj.learning.tasks.definition import State as State
    from tensegrity_mj.learning.tasks.definition import Task as Task
    from tensegrity_mj.learning.tasks.robots import gait as gait
    from tensegrity_mj.learning.tasks.robots import task_of as task_of
    from tensegrity_mj.learning.tasks.world import World as World
    from tensegrity_mj.learning.tasks.world import measured_error as measured_error
else:
    __getattr__, __dir__ = face(__name__)
