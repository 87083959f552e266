"""Prescribed motions of supports: where the point that holds a rod, or a fixed node, is at each time.

A motion is a displacement d(t) [m] from the place that the structure gives the support, with its first and second
derivatives: a sum of harmonics, data between which quintics run, or a function of time.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.basics.checks import checked
from tensegrity_mj.basics.fields import field, refused, value
from tensegrity_mj.basics.kinds import LARGEST, direction, finite, parts, printable_name, rows, vector
from tensegrity_mj.basics.texts import value_text
from tensegrity_mj.errors import SceneError
from tensegrity_mj.model.members import Vector, null_space_basis

MotionFunction = Callable[[float], ArrayLike]
DATA = rows(3, "rows of three numbers, one a time")


@value("harmonic", whole=True)
class Harmonic:
    """A displacement amplitude · sin(ω t + phase) [m]; constant where ω = 0.

    Attributes:
        amplitude: [m], a vector in the world frame.
        angular_frequency: ω [rad/s].
        phase: [rad].
    """

    amplitude: Vector = field(vector("m"))
    angular_frequency: float = field(finite("rad/s"), default=0.0)
    phase: float = field(finite("rad"), default=0.0)

    def __attrs_post_init__(self) -> None:
        if not max(map(abs, self.amplitude)) * self.angular_frequency**2 <= LARGEST:
            raise refused(
                self,
                f"amplitude {list(self.amplitude)} m at {self.angular_frequency:g} rad/s has no finite acceleration; "
                "make both smaller",
            )


@value("motion of {support!r}")
class Motion:
    """The motion of one support. Use the constructors `in_line`, `circular`, `data` and `by_function`.

    Harmonics and data add up; a function stands alone. Data are displacements at increasing times, joined by quintics.
    With velocities and accelerations these are met at each time. Without them the quintics are those of the spline
    with four continuous derivatives that is at rest, without velocity and acceleration, at its first and its last time.
    Before the first time and after the last the data stand still.

    Attributes:
        support: name of a rod, whose point at σ of its support moves, or of a fixed node.
        harmonics: that add up.
        times: (T,) of the data [s], increasing.
        displacements: (T, 3) [m] at these times.
        velocities: (T, 3) [m/s] at these times, or () for those of the spline.
        accelerations: (T, 3) [m/s²] at these times, or (); given where velocities are.
        function: t [s] -> (3, 3): displacement [m], velocity [m/s] and acceleration [m/s²].

    Raises:
        SceneError: for harmonics or data that are no numbers, or do not fit each other.
    """

    support: str = field(printable_name("the name of a rod or of a fixed node"))
    harmonics: tuple[Harmonic, ...] = field(parts(Harmonic), default=())
    times: tuple[float, ...] = field(rows(), default=())
    displacements: tuple[Vector, ...] = field(DATA, default=())
    velocities: tuple[Vector, ...] = field(DATA, default=())
    accelerations: tuple[Vector, ...] = field(DATA, default=())
    function: MotionFunction | None = field(None, default=None)

    @classmethod
    def in_line(cls, support: str, amplitude: float, frequency: float, direction: ArrayLike) -> Motion:
        """amplitude [m] · sin(2π · frequency [Hz] · t) along a direction of any length.

        Raises:
            SceneError: for numbers that are not finite, or a direction of no length.
        """
        size, omega, unit = _of_circle(support, amplitude, frequency, direction)
        return cls(support, (Harmonic(_vector(size * unit), omega),))

    @classmethod
    def circular(cls, support: str, amplitude: float, frequency: float, normal: ArrayLike = (0.0, 0.0, 1.0)) -> Motion:
        """A circle of radius `amplitude` [m] about a normal, turning with it by the right hand, `frequency` [Hz].

        The circle passes through the support's own place at t = 0: d = a [(cos ωt - 1) e₁ + sin ωt e₂], e₁ and e₂
        across the normal, world axes where those are across it.

        Raises:
            SceneError: for numbers that are not finite, or a normal of no length.
        """
        size, omega, unit = _of_circle(support, amplitude, frequency, normal)
        first = null_space_basis(unit[None])[:, 0]
        second = np.cross(unit, first)
        quarter = float(np.pi / 2)  # whose sine is 1 exactly
        across, along = _vector(size * first), _vector(size * second)
        back = _vector(-size * first)
        return cls(support, (Harmonic(across, omega, quarter), Harmonic(back, 0.0, quarter), Harmonic(along, omega)))

    @classmethod
    def data(
        cls,
        support: str,
        times: ArrayLike,
        displacements: ArrayLike,
        velocities: ArrayLike | None = None,
        accelerations: ArrayLike | None = None,
    ) -> Motion:
        """Through displacements (T, 3) [m] at times (T,) [s]; see the class for what lies between and around.

        Raises:
            SceneError: for arrays that are not of these shapes, or times that do not increase.
        """
        no_rates = () if velocities is None else velocities, () if accelerations is None else accelerations
        return cls(support, (), times, displacements, *no_rates)  # type: ignore[arg-type]

    @classmethod
    def by_function(cls, support: str, function: MotionFunction) -> Motion:
        """A function t -> (3, 3): displacement [m], velocity [m/s], acceleration [m/s²]. No file can hold it."""
        return cls(support, function=function)

    def __attrs_post_init__(self) -> None:
        if self.function is not None and not callable(self.function):
            raise refused(self, f"function = {self.function!r}; it must be a function t -> (3, 3)")
        data = self.times or self.displacements or self.velocities or self.accelerations
        if self.function is not None and (self.harmonics or data):
            raise refused(self, "a function stands alone: leave its harmonics and data out, or add them to it")
        if self.function is None and not self.harmonics and not data:
            raise refused(self, "nothing says how it moves; give harmonics, data or a function")
        self._check_data()

    def _check_data(self) -> None:
        count = len(self.times)
        if np.any(np.diff(self.times) <= 0):
            raise refused(self, f"its times must increase; they are {value_text(self.times)}")
        if count == 1:
            raise refused(self, "one time alone makes no motion; give two or more")
        if bool(self.velocities) != bool(self.accelerations):
            raise refused(self, "velocities and accelerations are given together, or neither of them")
        for name in ("displacements", "velocities", "accelerations"):
            size = len(getattr(self, name))
            if size != count and (size or name == "displacements"):
                raise refused(self, f"{count} times and {size} {name}; there must be one a time")
        with np.errstate(all="ignore"):
            if count and not np.all(np.abs(self.pieces) <= LARGEST):
                raise refused(self, "its times lie too close to each other, or its data are too large")

    def at(self, time: float) -> Array:
        """Displacement [m], velocity [m/s] and acceleration [m/s²] at a time [s]: (3, 3).

        Raises:
            SceneError: where a function fails, or gives anything but nine finite numbers.
        """
        if self.function is not None:
            return self._called(time)
        total = np.zeros((3, 3))
        for item in self.harmonics:
            omega, angle = item.angular_frequency, item.angular_frequency * time + item.phase
            sine, cosine = np.sin(angle), np.cos(angle)
            total += np.outer([sine, omega * cosine, -(omega**2) * sine], item.amplitude)
        if self.times:
            total += self._of_data(time)
        return total

    def sampled(self, times: ArrayLike) -> Motion:
        """Return the motion as data at the given times (T,) [s], with velocity and acceleration, which a file can hold.

        Raises:
            SceneError: for times that do not increase, and where a function fails.
        """
        instants = checked(f"motion of '{self.support}': times", times, rows(), SceneError)
        found = np.array([self.at(time) for time in instants]).reshape(-1, 3, 3)
        return Motion.data(self.support, instants, found[:, 0], found[:, 1], found[:, 2])

    def _called(self, time: float) -> Array:
        assert self.function is not None
        where = f"motion of '{self.support}': the function"
        try:
            value = np.array(self.function(time), float)
        except Exception as error:
            raise SceneError(f"{where} failed at t = {time:.6g} s: {type(error).__name__}: {error}") from error
        if value.shape != (3, 3) or not np.all(np.isfinite(value)):
            gave = f"shape {value.shape}" if value.shape != (3, 3) else f"{value.tolist()}"
            raise SceneError(
                f"{where} gave {gave} at t = {time:.6g} s; it must give finite (3, 3): displacement, velocity, "
                "acceleration"
            )
        return value

    def _of_data(self, time: float) -> Array:
        if not self.times[0] <= time <= self.times[-1]:
            last = self.displacements[-1 if time > self.times[0] else 0]
            return np.array([last, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)])
        k = min(int(np.searchsorted(self.times, time, side="right")) - 1, len(self.times) - 2)
        powers = (time - self.times[k]) ** np.arange(6)
        rows = []
        c = self.pieces[k]
        for _ in range(3):
            rows.append(powers[: len(c)] @ c)
            c = np.arange(1, len(c))[:, None] * c[1:]
        return np.array(rows)

    @cached_property
    def pieces(self) -> Array:
        """(T - 1, 6, 3) coefficients of the data's quintics in t - times[k], lowest power first."""
        if not self.times:
            return np.zeros((0, 6, 3))
        spans = np.diff(self.times)
        if self.velocities:
            states = np.stack([self.displacements, self.velocities, self.accelerations], axis=1)
        else:
            states = _spline_states(np.array(self.times), np.array(self.displacements))
        scales = spans[:, None] ** np.arange(6)
        ends = np.concatenate([states[:-1] * scales[:, :3, None], states[1:] * scales[:, :3, None]], axis=1)
        return np.asarray(np.einsum("ij,kjx->kix", HERMITE, ends) / scales[:, :, None])

    @property
    def jump(self) -> str:
        """Speeds of the data at their first and last time, as text, where they are not at rest there; otherwise ""."""
        if not self.velocities:
            return ""
        first, last = (float(np.linalg.norm(row)) for row in (self.velocities[0], self.velocities[-1]))
        parts = [f"{first:.3g} m/s at its first time {self.times[0]:g} s"] if first else []
        parts += [f"{last:.3g} m/s at its last time {self.times[-1]:g} s"] if last else []
        return " and ".join(parts)


def _hermite() -> Array:
    """(6, 6): coefficients of the quintic on [0, 1] from d, d', d'' at 0 and at 1."""
    at = [[float(j == k) * (1.0, 1.0, 2.0)[k] for j in range(6)] for k in range(3)]
    at += [[1.0] * 6, [float(j) for j in range(6)], [float(j * (j - 1)) for j in range(6)]]
    return np.round(np.linalg.inv(np.array(at)) * 2) / 2  # all are multiples of 1/2


HERMITE = _hermite()


def _spline_states(times: Array, displacements: Array) -> Array:
    """d, ḋ, d̈ (T, 3, 3) at the data's times of the quintic spline that is at rest at both ends; or NaN."""
    from scipy.interpolate import make_interp_spline

    states, at_rest = np.zeros((len(displacements), 3, 3)), [(1, np.zeros(3)), (2, np.zeros(3))]
    states[:, 0] = displacements
    try:
        spline = make_interp_spline(times, displacements, k=5, bc_type=(at_rest, at_rest))
    except (ValueError, np.linalg.LinAlgError):  # of times so near to each other that there is none
        return states * np.nan
    for order in (1, 2):
        states[1:-1, order] = spline(times[1:-1], order)
    return states


def _of_circle(support: str, amplitude: float, frequency: float, way: ArrayLike) -> tuple[float, float, Array]:
    """A size [m], an angular frequency [rad/s] and a unit vector."""
    what = f"motion of '{support}'"
    row = np.array(checked(f"{what}: direction", way, direction(), SceneError))
    size = checked(f"{what}: amplitude", amplitude, finite("m"), SceneError)
    turns = checked(f"{what}: frequency", frequency, finite("Hz"), SceneError)
    return size, 2 * np.pi * turns, row / np.linalg.norm(row)


def _vector(row: Array) -> Vector:
    x, y, z = row.tolist()
    return x, y, z
