"""What happens to a structure from outside during a scene: loads, breaks, and the law that a file names."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from tensegrity_mj.model.members import Vector

LoadFunction = Callable[[float], ArrayLike]


OptionValue = float | int | bool | str | list[Any]  # what a controller's option may be in a scene file


@dataclass(frozen=True)
class Load:
    """A force on one node, f(t) = force · cos(ω t + phase) [N] in the world frame; constant where ω = phase = 0.

    Attributes:
        node: the node's name.
        force: amplitude [N].
        angular_frequency: ω [rad/s].
        phase: [rad]; -π/2 makes it force · sin(ω t).
    """

    node: str
    force: Vector
    angular_frequency: float = 0.0
    phase: float = 0.0


@dataclass(frozen=True)
class Break:
    """A string that breaks at a time [s] and carries nothing from then on; no law is told."""

    string: str
    time: float


@dataclass(frozen=True)
class ControlSpec:
    """The control law that a scene is run with by default: a name from `controllers` and its options.

    Options are numbers, texts, truth values, or (nested) lists of them; tuples and arrays become lists.
    """

    law: str
    options: Mapping[str, OptionValue] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if isinstance(self.options, Mapping):  # else check_scene says so
            object.__setattr__(self, "options", {key: _plain_option(x) for key, x in self.options.items()})


def _plain_load(load: Load) -> Load:
    x, y, z = (float(v) for v in load.force)
    return Load(str(load.node), (x, y, z), float(load.angular_frequency), float(load.phase))


def _plain_option(value: Any) -> Any:
    if isinstance(value, (np.ndarray, np.generic)):
        return value.tolist()
    if isinstance(value, (list, tuple)):
        return [_plain_option(item) for item in value]
    return value
