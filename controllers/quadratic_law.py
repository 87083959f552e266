"""Common base of the laws of chapters 5 and 6: their options, and their compiled form.

`quadratic_terms` has the equations.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import cached_property
from typing import Annotated, Any

import numpy as np
from numpy.typing import ArrayLike

from tensegrity_mj.basics import kinds
from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.basics.checks import checked, real_array, state_of
from tensegrity_mj.basics.hints import hints_of, typed
from tensegrity_mj.basics.kinds import Kind, Wrong
from tensegrity_mj.basics.remembered import Remembered
from tensegrity_mj.controllers import quadratic_terms as shared
from tensegrity_mj.controllers.allocation import (
    StringLimits,
    feasibility_margin,
    least_norm,
    least_squares,
    write_ceilings,
)
from tensegrity_mj.controllers.known import ModelLaw, PackedEffects, described
from tensegrity_mj.controllers.quadratic_terms import Known, quadratic_terms
from tensegrity_mj.dynamics.native.compiling import c_function
from tensegrity_mj.dynamics.native.lanes import WIDTHS, all_of, any_of, room_like, select
from tensegrity_mj.dynamics.native.law import FAILED, NO_SOLUTION, SOLVED, LaneLaw, NativeLaw, Report, check_made_for
from tensegrity_mj.dynamics.native.pointers import (
    LAW_SIGNATURE,
    STACK_LIMIT,
    address_of,
    floats,
    inlined,
)
from tensegrity_mj.dynamics.native.views import Table
from tensegrity_mj.dynamics.records import StructureRecords
from tensegrity_mj.dynamics.target import pack_target, standing_targets
from tensegrity_mj.errors import InfeasibleError, OptionError
from tensegrity_mj.model.rigidity import equilibrium_force_densities
from tensegrity_mj.model.structure import Structure
from tensegrity_mj.model.target import Target

UNBOUNDED, FIXED, OF_STATE = 0, 1, 2  # thresholds and ceilings: none at all, constant, or ceilings of the state

# The report's places, as plain numbers for compiled code.
MARGIN, V_ALL, V_ERROR, V_VELOCITY = (
    int(Report.FEASIBILITY_MARGIN),
    int(Report.LYAPUNOV),
    int(Report.LYAPUNOV_ERROR),
    int(Report.LYAPUNOV_VELOCITY),
)

DISCONTINUOUS = (
    "the law that minimizes the {name} switches strings discontinuously, so an integrator's stages would see different "
    "laws: run it sampled (hold force density or hold rest length)"
)


@inlined
def _room(nodes: int, strings: int, effects: int) -> int:
    return (9 if effects != 0 else 3) * nodes + 2 * strings


@inlined
def _evaluate(t: float, nodes_at: int, velocities_at: int, own: Any, command_at: int, report_at: int, room: int) -> int:
    """The law; `own` is its `Known`, `room` the address of scratch, `_room` numbers."""
    count, size = own.node_count, own.string_count
    u, report = floats(command_at, (size,)), floats(report_at, (4,))
    nodes, velocities = floats(nodes_at, (count, 3)), floats(velocities_at, (count, 3))
    influence = floats(room, (count, 3))
    f, ceiling = floats(room + 24 * count, (size,)), floats(room + 24 * count + 8 * size, (size,))
    pushed = floats(room + (24 * count + 16 * size if own.effects else 0), (2 * count, 3))
    status, V_error, V_velocity, beta = quadratic_terms(t, nodes, velocities, own, influence, pushed, f)
    if status != SOLVED:
        return FAILED
    V = V_error + V_velocity
    alpha = beta + own.decay_rate * V
    if own.bounds == UNBOUNDED and own.norm == 2.0:
        margin = least_squares(f, alpha, u)
    else:
        limits = own.limits
        if own.bounds == OF_STATE:
            write_ceilings(nodes, own.segments, own.ranges, limits, ceiling)
        else:
            for m in range(size):
                ceiling[m] = limits[0, m]
        margin = least_norm(f, alpha, own.floor, ceiling, own.norm, u)
    report[MARGIN], report[V_ALL], report[V_ERROR], report[V_VELOCITY] = margin, V, V_error, V_velocity
    solved = margin > 0.0
    if not any_of(solved):
        return NO_SOLUTION
    if not all_of(solved):
        for m in range(size):
            u[m] = select(solved, u[m], np.nan)
    return SOLVED


@c_function(LAW_SIGNATURE, "the law of chapters 5 and 6")
def _law(t, nodes_at, velocities_at, context, command_at, report_at):  # type: ignore[no-untyped-def]
    own = Known(context)
    room = room_like(command_at, own.scratch, _room(own.node_count, own.string_count, own.effects))
    return _evaluate(t, nodes_at, velocities_at, own, command_at, report_at, room)


@inlined
def _terms_at(t: float, nodes: Any, velocities: Any, context: int, influence: Any, pushed: Any, f: Any) -> Any:
    return quadratic_terms(t, nodes, velocities, Known(context), influence, pushed, f)


def _norm(value: Any) -> float:
    """A norm of u, for which a file has "inf"."""
    norm = math.inf if isinstance(value, str) and value == "inf" else value
    if isinstance(norm, bool) or not np.isscalar(norm) or norm not in (1, 2, math.inf):
        raise Wrong(f" = {value!r}; allowed: 1, 2, math.inf")
    return norm  # type: ignore[return-value]


@dataclass(frozen=True, eq=False)
class QuadraticLaw(ModelLaw):
    """A law that makes a quadratic V fall as V̇ = -δ V, with the explicit minima of Lemma 5.1.

    Attributes:
        ...: those of `ModelLaw`, such as its structure and its target.
        decay_rate: δ [1/s] > 0 of V̇ = -δ V.
        norm: 1, 2 or math.inf. 1 and ∞ give discontinuous laws, which run sampled only.
        translation, rotation: gains of every rod, or a mapping rod name -> Gains (others keep the default).
        minimum_force_density: ū [N/m] >= 0, scalar or (M,): the residual prestress at the end of §5.3.
        maximum_force_density: [N/m], scalar or (M,), inf for none.
        respect_limits: keep within the strings' `max_force_density` and `min_rest_length` too.

    Raises:
        OptionError, SceneError: for gains that are not positive definite, δ <= 0, another norm, a bad target, a ceiling
            below its threshold.
    """

    decay_rate: Annotated[float, kinds.positive("1/s")] = 1.0
    norm: Annotated[float, Kind(_norm)] = 2
    translation: shared.GainsOfRods = field(default_factory=shared.Gains)
    rotation: shared.GainsOfRods = field(default_factory=shared.Gains)
    minimum_force_density: ArrayLike = 0.0
    maximum_force_density: ArrayLike = np.inf
    respect_limits: bool = True

    arrays = "tensegrity_mj.engines.jax.thesis_laws:quadratic_law"

    def __post_init__(self) -> None:
        super().__post_init__()
        for name, kind in _KINDS.items():
            object.__setattr__(self, name, checked(name, getattr(self, name), kind))
        if np.any(self.floor < 0):
            raise OptionError(f"minimum_force_density = {self.minimum_force_density!r}; every value must be >= 0 N/m")
        for string, low, high in zip(self.structure.strings, self.floor, self.limits.max_force_density, strict=True):
            if high < low:
                raise OptionError(
                    f"string '{string.name}': the law's minimum_force_density {low:g} N/m is above the largest force "
                    f"density {high:g} N/m that it may have; lower the one or raise the other"
                )
        _ = self.gains

    @property
    def projected_onto(self) -> shared.Onto | None:
        """Plane that the errors of b are projected onto; None for no projection."""
        return None

    @cached_property
    def gains(self) -> np.ndarray[Any, Any]:
        """X, Y, Z and K of every rod and point mass, as records of dtype `quadratic_terms.GAINS`."""
        return shared.gain_records(self.structure, self.translation, self.rotation)

    @cached_property
    def floor(self) -> Array:
        """ū (M,) [N/m]."""
        return np.array(
            real_array("minimum_force_density", self.minimum_force_density, (len(self.structure.strings),), "N/m")
        )

    @cached_property
    def limits(self) -> StringLimits:
        """The ceilings of the strings' force densities."""
        return StringLimits.of(self.structure, self.maximum_force_density, bool(self.respect_limits))

    @property
    def discontinuous(self) -> str:
        """Reason why the law cannot run continuously; empty for norm 2."""
        names = {1.0: "1-norm", math.inf: "∞-norm"}
        return DISCONTINUOUS.format(name=names[self.norm]) if self.norm in names else ""

    @cached_property
    def _known(self) -> dict[str, Any]:
        """Return the fields of a `Known`, without its scratch."""
        assert isinstance(self.target, Target)
        own, records, target = self.structure, StructureRecords.of(self.structure), pack_target(self.target)
        rods, points = records.rods, records.points
        limited = bool(np.any(self.floor > 0)) or bool(np.any(np.isfinite(self.limits.max_force_density)))
        return {
            "node_count": len(own.nodes),
            "rods": rods,
            "points": points,
            "gains": shared.world_gains(self.gains, [*rods, *points]),
            "kind": shared.PROJECTIONS[self.projected_onto],
            "segments": own.paths.nodes,
            "ranges": own.paths.ranges,
            "target": target,
            "standing": standing_targets(rods, points, target),
            "gravity": self.gravity,
            "effects": self._effects.address,
            "bounds": OF_STATE if self.limits.of_state else FIXED if limited else UNBOUNDED,
            "floor": self.floor,
            "limits": self.limits.packed,
            "decay_rate": self.decay_rate,
            "norm": self.norm,
        }

    @cached_property
    def _effects(self) -> PackedEffects:
        return PackedEffects(self.model)

    @cached_property
    def _compiled(self) -> NativeLaw:
        return self._compile()

    def _compile(self) -> NativeLaw:
        own = self.structure
        # Scratch lies on the stack, which each thread has, or is the law's own where it is too large for that.
        room = _room.py_func(len(own.nodes), len(own.strings), self._effects.address)
        scratch = np.empty(room if room > STACK_LIMIT else 0)
        known = shared.pack_known(**self._known, scratch=address_of(scratch) if len(scratch) else 0)
        return NativeLaw(
            address=_law.address,
            context=known.address,
            keep=(self, known, scratch),
            discontinuous=self.discontinuous,
            gravity=self.gravity,
            known=tuple(self.known),
            failure=self._effects.failure if self._effects.in_python else None,
            decay_rate=self.decay_rate,
            lanes=self._in_lanes(known, room),
            stateless=len(scratch) == 0,
        )

    def _in_lanes(self, known: Table, room: int) -> LaneLaw | None:
        """The law for several runs, where it is plain; its targets differ where they stand still."""
        plain = known["bounds"] == UNBOUNDED and known["norm"] == 2.0 and not known["effects"]
        if not plain or room * max(WIDTHS) > STACK_LIMIT:
            return None

        def kind() -> Any:
            aim, gains = known.arrays["target"], known["gains"]
            scalars = tuple((gains[name][:, 2] != 0.0).tobytes() for name in ("scalars_z", "scalars_b"))
            moves = (aim["nodes"].tobytes(), aim["quintics"].tobytes(), aim["shapes"].tobytes())
            return known.alike(("target",)), scalars, aim["times"].tobytes(), moves if aim["count"] > 1 else ()

        return LaneLaw(_law, known, kind)

    def native(self, structure: Structure) -> NativeLaw:
        """The compiled law, for a plant with the same nodes and strings.

        Raises:
            OptionError: for any other.
        """
        check_made_for(self.structure, structure)
        self._effects.failure.clear()
        return self._compiled if self._compiled.stateless else self._compile()

    def reported(self, time: float, nodes: Array, velocities: Array) -> tuple[Array, Array]:
        """u (M,) [N/m] and the report (see `Report`) at one state."""
        law = self._compiled
        time, nodes, velocities = state_of(time, nodes, velocities, len(self.structure.nodes))
        u, report = np.zeros(len(self.structure.strings)), np.full(len(Report), np.nan)
        places = (address_of(nodes), address_of(velocities), law.context, address_of(u), address_of(report))
        if _law.ctypes(time, *places) == FAILED:
            raise self._effects.failure.pop()
        return u, report

    def __call__(self, time: float, nodes: Array, velocities: Array) -> Array:
        """u (M,) [N/m] at one state.

        Raises:
            InfeasibleError: where no admissible u exists, with the margin.
        """
        u, report = self.reported(time, nodes, velocities)
        margin = report[Report.FEASIBILITY_MARGIN]
        if margin > 0:
            return u
        text = f"no admissible u at t = {time:.6g} s: feasibility margin max(v/α) = {margin:.3g} <= 0 (5.18)"
        if margin == -np.inf:
            low = int(np.argmin(self.limits.ceilings(nodes) - self.floor))
            text += f"; string '{self.structure.strings[low].name}' is too short to keep its minimum_force_density"
        else:
            terms = self.terms(time, nodes, velocities)
            alpha = terms.beta + self.decay_rate * (terms.V_error + terms.V_velocity)
            if feasibility_margin(terms.f, alpha, self.floor, np.full(len(u), np.inf)) > 0:
                text += "; without the ceilings of the strings there would be one"
        raise InfeasibleError(text)

    def evaluate(self, time: float, nodes: Array, velocities: Array) -> tuple[Array, float, float]:
        """u (M,) [N/m], the feasibility margin max(v/α) and V at one state."""
        u, report = self.reported(time, nodes, velocities)
        return u, float(report[Report.FEASIBILITY_MARGIN]), float(report[Report.LYAPUNOV])

    def terms(self, time: float, nodes: Array, velocities: Array) -> shared.Terms:
        """The parts of V, and β and f of V̇ = β - fᵀu, at one state."""
        count = len(self.structure.nodes)
        influence, pushed, f = np.empty((count, 3)), np.empty((2 * count, 3)), np.empty(len(self.structure.strings))
        state = state_of(time, nodes, velocities, count)
        status, error, velocity, beta = _terms_at(*state, self._compiled.context, influence, pushed, f)
        if status != SOLVED:
            raise self._effects.failure.pop()
        return shared.Terms(error, velocity, beta, f)

    def target_equilibrium(self) -> dict[str, Any]:
        """Report if the (last) target is an equilibrium, as the theorems assume: residual [N], u [N/m], modes."""
        assert isinstance(self.target, Target)
        structure, nodes, gravity = self.structure, self.target.nodes[-1], self.gravity
        u, residual, modes = _equilibria.get(
            structure, (nodes.tobytes(), gravity), lambda: equilibrium_force_densities(structure, nodes, gravity)
        )
        return {"residual": residual, "force_densities": u.tolist(), "self_stress_modes": modes}

    def describe(self) -> dict[str, Any]:
        """Plain values for the provenance of a run."""
        highest = self.limits.max_force_density
        return {
            "decay_rate": self.decay_rate,
            "norm": "inf" if self.norm == math.inf else int(self.norm),
            "minimum_force_density": self.floor.tolist(),
            "maximum_force_density": [u if math.isfinite(u) else None for u in highest.tolist()],
            "keeps_min_rest_length": self.limits.of_state,
            "target_equilibrium": self.target_equilibrium(),
            **described(self.known),
        }


_PLAIN = ("decay_rate", "norm", "translation", "rotation", "respect_limits")
_KINDS = {name: typed(hint) for name, hint in hints_of(QuadraticLaw).items() if name in _PLAIN}
_equilibria = Remembered()  # by structure, of target nodes and gravity
