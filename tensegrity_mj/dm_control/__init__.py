"""Scenes for what is built on dm_control: a Physics, a PyMJCF element, a composer Entity, an Environment.

    physics = tensegrity_mj.dm_control.physics(scene)
    root = tensegrity_mj.dm_control.element(scene)
    robot = tensegrity_mj.dm_control.TensegrityEntity(scene)
    env = tensegrity_mj.dm_control.environment(scene, Command.FORCE_DENSITY, control_timestep=0.01)

See docs/dm_control.md. None of it installs a callback in MuJoCo: any number of them live side by side.

Importing it raises `tensegrity_mj.errors.MissingPackageError` where dm-control, or a package that it needs, is missing.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from tensegrity_mj.basics.dependencies import require_dm_control

require_dm_control()

from tensegrity_mj.dm_control.elements import adopt_options, element  # noqa: E402 - after the check
from tensegrity_mj.dm_control.environments import environment  # noqa: E402
from tensegrity_mj.dm_control.episodes import RandomStart  # noqa: E402
from tensegrity_mj.dm_control.models import physics  # noqa: E402
from tensegrity_mj.dm_control.repairing import repair  # noqa: E402

if TYPE_CHECKING:
    from tensegrity_mj.dm_control.entities import TensegrityEntity as TensegrityEntity
    from tensegrity_mj.dm_control.stepping import PhysicsDivergence as PhysicsDivergence
    from tensegrity_mj.dm_control.stepping import ScenePhysics as ScenePhysics
    from tensegrity_mj.dm_control.tasks import TensegrityTask as TensegrityTask

# These subclass dm_control's own classes; importing them imports dm_control.
_HOME = {
    "TensegrityEntity": "entities",
    "PhysicsDivergence": "stepping",
    "ScenePhysics": "stepping",
    "TensegrityTask": "tasks",
}

__all__ = ["RandomStart", "adopt_options", "element", "environment", "physics", "repair", *_HOME]


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module '{__name__}' has no attribute '{name}'; it has {', '.join(sorted(__all__))}")
    from importlib import import_module

    repair()
    value = getattr(import_module(f"{__name__}.{_HOME[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(__all__)
