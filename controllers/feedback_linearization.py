"""Feedback linearization with optimal allocation: chapter 4 of the thesis, for any class 1 structure.

The coordinates are minimal, q = (z, β) of every rod (§2.3): the point at σ along the directions E that its support
leaves it, and one angle in a plane or (θ, φ) in space. The law demands

    ë = -K_p e - K_d ė,   e = q - q_d,   K_p = ω_o²,  K_d = 2 ζ ω_o,      (4.6)-(4.8)

which is linear in the force densities, A u = d (4.9), and takes of all that do so the u of least cost (4.10)-(4.13).
(In the printed (4.9) the sign of M⁻¹ g on the right is wrong.)
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.basics.checks import real_array, state_of
from tensegrity_mj.basics.hints import hints_of
from tensegrity_mj.controllers.allocation_options import Allocation, Sum
from tensegrity_mj.controllers.error_equation import Known, error_equation
from tensegrity_mj.controllers.known import KnownWater, ModelLaw, PackedEffects, described
from tensegrity_mj.controllers.optimal_allocation import Allocator, Equation
from tensegrity_mj.controllers.table import NamedLaw
from tensegrity_mj.dynamics.native.law import Command, NativeLaw, Report, check_made_for, native_law
from tensegrity_mj.dynamics.records import StructureRecords
from tensegrity_mj.dynamics.target import pack_target
from tensegrity_mj.errors import InfeasibleError, OptionError
from tensegrity_mj.model.structure import Structure
from tensegrity_mj.model.target import Target

LARGEST = 1e9  # of ω_o [rad/s] and ζ: gains beyond would leave nothing of the rest of an equation


@dataclass(frozen=True, eq=False)
class FeedbackLinearization(ModelLaw):
    """The law of chapter 4.

    Attributes:
        ...: those of `ModelLaw`, such as its structure and its target.
        natural_frequency: ω_o [rad/s] > 0, a number or one for each of `coordinates`.
        damping: ζ >= 0 of the error dynamics, likewise.
        allocation: of the force densities.
        report: after each call, see `Report`.

    Raises:
        OptionError, SceneError: for options that are out of range, or a bad target.
    """

    natural_frequency: ArrayLike = 1.0
    damping: ArrayLike = 1.0
    allocation: Allocation = field(default_factory=Allocation)

    arrays = "tensegrity_mj.engines.jax.linearizing_law:linearizing_law"

    def __post_init__(self) -> None:
        super().__post_init__()
        frequency = real_array("natural_frequency", self.natural_frequency, (len(self.coordinates),), "rad/s")
        damping = real_array("damping", self.damping, (len(self.coordinates),))
        if not np.all((frequency > 0) & (frequency <= LARGEST)):
            raise OptionError(
                f"natural_frequency = {self.natural_frequency!r}; every value must be > 0 and <= {LARGEST:g} rad/s"
            )
        if not np.all((damping >= 0) & (damping <= LARGEST)):
            raise OptionError(f"damping = {self.damping!r}; every value must be >= 0 and <= {LARGEST:g}")
        Allocator(self.allocation, self.structure, self.coordinates)

    @cached_property
    def coordinates(self) -> list[Equation]:
        """q, in its order: every rod's z and angles, then every point mass' z; with the units of q̈."""
        found = []
        for rod in self.structure.rods:
            found += [Equation(f"{axis} of rod '{rod.name}'", "m/s²") for axis in _axes(rod.support.translation_basis)]
            planar = rod.support.plane is not None
            found += [Equation(f"{angle} of rod '{rod.name}'", "rad/s²") for angle in ("θ" if planar else "θφ")]
        for point in self.structure.lone_masses:
            found += [Equation(f"{axis} of node '{point.node}'", "m/s²") for axis in _axes(point.translation_basis)]
        return found

    @property
    def allocator(self) -> Allocator:
        """Solver for the force densities, with checked options."""
        return self._own.allocator

    @property
    def discontinuous(self) -> str:
        """Reason why the law cannot run continuously; "" where it can."""
        return self.allocation.discontinuous

    @property
    def report(self) -> Array:
        """Report (5,) of the last call, see `Report`."""
        return self._own.report

    def native(self, structure: Structure) -> NativeLaw:
        """The law as engines call it, fresh for each run: no run begins where another ended."""
        check_made_for(self.structure, structure)
        law = native_law(_Evaluation(self), structure)
        return replace(law, gravity=self.gravity, known=tuple(self.known), stateless=False)

    def __call__(self, time: float, nodes: Array, velocities: Array) -> Array:
        """u (M,) [N/m] at one state.

        Raises:
            InfeasibleError: where no admissible u exists, with the constraint at fault; or where a rod's angles are
                singular.
        """
        time, nodes, velocities = state_of(time, nodes, velocities, len(self.structure.nodes))
        try:
            return self._own(time, nodes, velocities)
        except InfeasibleError as error:
            raise InfeasibleError(f"t = {time:.6g} s: {error}") from None

    def error(self, time: float, nodes: Array, velocities: Array) -> tuple[Array, Array]:
        """e and ė (n,) of (4.6) at one state, in the order of `coordinates`."""
        _, _, e = self.equation(time, nodes, velocities)
        return e[0], e[1]

    def equation(self, time: float, nodes: Array, velocities: Array) -> tuple[Array, Array, Array]:
        """A (n, M), d (n,) of (4.9) as A u = d, and (e, ė) (2, n) at one state.

        Raises:
            InfeasibleError: where a rod in space points along z, so that its θ is singular.
        """
        return self._own.equation(*state_of(time, nodes, velocities, len(self.structure.nodes)))

    @cached_property
    def _own(self) -> _Evaluation:
        return _Evaluation(self)

    def describe(self) -> dict[str, Any]:
        """Plain values for the provenance of a run."""
        return {
            "law": "feedback_linearization",
            "natural_frequency": np.asarray(self.natural_frequency, float).tolist(),
            "damping": np.asarray(self.damping, float).tolist(),
            "allocation": self.allocation.describe(self.structure),
            **described(self.known),
        }


class _Evaluation:
    """The law in one run; between calls it keeps the start of its searches, and the u that it may hold."""

    command = Command.FORCE_DENSITY

    def __init__(self, law: FeedbackLinearization) -> None:
        structure, target = law.structure, law.target
        assert isinstance(target, Target)
        self.discontinuous = law.discontinuous
        self.describe: Callable[[], dict[str, Any]] = law.describe
        self.report = np.full(len(Report), np.nan)
        self.allocator = Allocator(law.allocation, structure, law.coordinates)
        n = len(law.coordinates)
        frequency = np.broadcast_to(np.asarray(law.natural_frequency, float), (n,))
        gains = np.array([frequency**2, 2 * np.asarray(law.damping, float) * frequency])  # (4.8)
        records = StructureRecords.of(structure)
        self.effects, self.target = PackedEffects(law.model), pack_target(target)
        self.known = Known(
            records.rods,
            records.points,
            np.array(structure.paths.nodes),
            np.array(structure.paths.ranges),
            self.target.address,
            np.array(law.gravity, float),
            self.effects.address,
            gains,
        )
        self.structure, self.size = structure, (n, len(structure.strings))

    def equation(self, time: float, nodes: Array, velocities: Array) -> tuple[Array, Array, Array]:
        n, M = self.size
        A, d, e = np.empty((n, M)), np.empty(n), np.empty((2, n))
        rod = error_equation(
            float(time),
            np.ascontiguousarray(nodes, float),
            np.ascontiguousarray(velocities, float),
            self.known,
            A,
            d,
            e,
        )
        if rod < -1:
            raise self.effects.failure.pop()
        if rod >= 0:
            raise InfeasibleError(
                f"rod '{self.structure.rods[rod].name}', or its target, points along z: its angle θ is singular "
                "there; keep φ away from 0 and π, or choose a law in non-minimal coordinates"
            )
        return A, d, e

    def __call__(self, time: float, nodes: Array, velocities: Array) -> Array:
        self.report[:] = np.nan
        A, d, _ = self.equation(time, nodes, velocities)
        u, violation = self.allocator.solve(A, d, nodes)
        self.report[Report.ALLOCATION_RESIDUAL] = violation
        return u


def _axes(basis: Array) -> list[str]:
    """Names of the columns of E: the world's axes where they are such."""
    names = []
    for number, column in enumerate(basis.T):
        along = [axis for axis, unit in zip("xyz", np.eye(3), strict=True) if np.array_equal(column, unit)]
        names.append(along[0] if along else f"z{number + 1}")
    return names


def from_options(
    structure: Structure,
    target: Target | Array,
    *,
    gravity: tuple[float, float, float] = (0.0, 0.0, 0.0),
    known: Sequence[Any] = (),
    natural_frequency: ArrayLike = 1.0,
    damping: ArrayLike = 1.0,
    sums: Sequence[Sequence[Any]] = (),
    **allocation: Any,
) -> FeedbackLinearization:
    """The law from options as a scene file holds them: `sums` as pairs [names or "all", minimum].

    Raises:
        OptionError, SceneError: as the law, and for sums of another form.
    """
    try:
        pairs = [(None if chosen == "all" else chosen, minimum) for chosen, minimum in sums]
    except (TypeError, ValueError):
        raise OptionError(f'sums = {sums!r}; it must be a list of pairs [["name", ...] or "all", minimum]') from None
    rows = []
    for number, (chosen, minimum) in enumerate(pairs):
        try:
            rows.append(Sum(minimum, chosen))
        except OptionError as error:
            raise OptionError(f"sums[{number}]: {error}") from None
    options = Allocation(sums=tuple(rows), **allocation)
    return FeedbackLinearization(structure, target, natural_frequency, damping, options, gravity=gravity, known=known)


LAW = NamedLaw(from_options, {**hints_of(Allocation), "water": KnownWater})
