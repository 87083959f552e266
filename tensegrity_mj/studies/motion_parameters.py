"""Changes of what moves a scene's supports, by the names of its parts."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from tensegrity_mj.basics.checks import check_known, finite
from tensegrity_mj.basics.texts import unknown
from tensegrity_mj.errors import OptionError
from tensegrity_mj.model.members import Vector
from tensegrity_mj.model.motion import Motion
from tensegrity_mj.model.scene import Scene
from tensegrity_mj.studies.parameter_values import Scaled, axis_of, no_more, number_from, vector_from

OF_MOTION = ("amplitude", "frequency", "angular_frequency", "phase")
# Amplitudes of one size, such as those of a circle, differ by round-off.
SAME = 1e-12


def with_motions(scene: Scene, which: str | None, others: Sequence[str], path: str, value: Any) -> Scene:
    """The scene with one motion changed, or all, as a path names them.

    Raises:
        OptionError: if it names nothing, or for a value of the wrong kind.
    """
    if not scene.motions:
        raise OptionError(f"{path}: scene '{scene.name}' has no motions of supports")
    supports = [motion.support for motion in scene.motions]
    if which is not None and which not in supports:
        raise OptionError(f"{path}: {unknown(which, supports, 'support with a motion')}")
    name = others[0] if others else ""
    check_known(path, name, OF_MOTION, "part of a motion")
    if name != "amplitude":
        no_more(None, others[1:], path)
    for motion in scene.motions:
        if which in (None, motion.support) and motion.function is not None:
            raise OptionError(f"{path}: the motion of '{motion.support}' is a function, which has no parts to change")
    axis = axis_of(others[1:], path)

    def changed(motion: Motion) -> Motion:
        if which not in (None, motion.support):
            return motion
        if name == "amplitude":
            return _with_amplitude(path, axis, value, motion)
        if name == "phase":
            return _with_phase(path, value, motion)
        return _with_frequency(path, 2 * math.pi if name == "frequency" else 1.0, value, motion)

    return scene.with_(motions=tuple(changed(motion) for motion in scene.motions))


def _with_amplitude(path: str, axis: int | None, value: Any, motion: Motion) -> Motion:
    """A factor is of all that the motion makes, data too; a number is the length of all amplitudes, or a component."""
    rows = [item.amplitude for item in motion.harmonics]
    if not isinstance(value, Scaled):
        _no_data(path, motion)
        if axis is not None:
            _one(path, motion, "components of amplitudes", [row[axis] for row in rows])
        elif isinstance(value, Sequence):
            _one(path, motion, "amplitudes", rows)
        else:
            new = finite(path, value)
            now = _one(path, motion, "lengths of amplitudes", [math.hypot(*row) for row in rows])
            if now == 0:
                raise OptionError(
                    f"{path} = {value!r}: an amplitude of zero has no direction; give a list of three numbers"
                )
            value = Scaled(new / now)
    data = {
        key: tuple(vector_from(path, value, axis, row) for row in getattr(motion, key))
        for key in ("displacements", "velocities", "accelerations")
    }
    return _with(motion, "amplitude", [vector_from(path, value, axis, row) for row in rows], **data)


def _with_frequency(path: str, unit: float, value: Any, motion: Motion) -> Motion:
    """A factor is one of the pace of all that the motion makes, data too; what stands still goes on standing."""
    omegas = [item.angular_frequency for item in motion.harmonics]
    moving = [omega for omega in omegas if omega]
    if not isinstance(value, Scaled):
        _no_data(path, motion)
        new = unit * finite(path, value)
        if moving:
            _one(path, motion, "frequencies", moving)
        return _with(motion, "angular_frequency", [new if omega or not moving else omega for omega in omegas])
    pace = value.factor
    if motion.times and pace <= 0:
        raise OptionError(f"{path} = {value}: the motion of '{motion.support}' has data; their pace must be > 0")
    return _with(
        motion,
        "angular_frequency",
        [omega * pace if omega else omega for omega in omegas],
        times=tuple(time / pace for time in motion.times),
        velocities=tuple(_times(pace, row) for row in motion.velocities),
        accelerations=tuple(_times(pace**2, row) for row in motion.accelerations),
    )


def _with_phase(path: str, value: Any, motion: Motion) -> Motion:
    """Harmonics that stand still keep their place."""
    moving = [item.phase for item in motion.harmonics if item.angular_frequency]
    _no_data(path, motion)
    if not moving:
        raise OptionError(f"{path}: nothing of the motion of '{motion.support}' has a frequency")
    now = _one(path, motion, "phases", moving)
    new = number_from(path, value, now)
    return _with(motion, "phase", [new if h.angular_frequency else h.phase for h in motion.harmonics])


def _with(motion: Motion, name: str, values: Sequence[Any], **changed: Any) -> Motion:
    """The motion with these values of a part of its harmonics, and what else is changed."""
    harmonics = (replace(h, **{name: value}) for h, value in zip(motion.harmonics, values, strict=True))
    return replace(motion, harmonics=tuple(harmonics), **changed)


def _no_data(path: str, motion: Motion) -> None:
    if motion.times:
        raise OptionError(
            f"{path}: the motion of '{motion.support}' has data; scale their amplitude or frequency by a factor such "
            "as *0.5"
        )


def _one(path: str, motion: Motion, what: str, values: Sequence[Any]) -> Any:
    """The value that all have."""
    first = values[0]
    for other in values[1:]:
        pairs = zip(first, other, strict=True) if isinstance(first, tuple) else [(first, other)]
        if any(abs(a - b) > SAME * max(abs(a), abs(b)) for a, b in pairs):
            raise OptionError(
                f"{path}: the motion of '{motion.support}' has harmonics of different {what}, which one value cannot "
                "stand for; scale them by a factor such as *0.5, or change the scene"
            )
    return first


def _times(factor: float, row: Vector) -> Vector:
    x, y, z = row
    return (factor * x, factor * y, factor * z)
