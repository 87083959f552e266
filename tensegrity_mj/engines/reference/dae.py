"""The reference engine: the thesis' differential-algebraic equations (chapters 2 and 3) in non-minimal coordinates.

State: q = (z, b) of every rod that hangs on no other and b of those that do, q̇, and the work integrals of the energy
ledger, integrated with it. As one system all vectors are in world components, with rows for what holds and joins
rods: `Solver.FULL` has r and b of the same rods, `Solver.GENERAL` of every rod.
MuJoCo takes no part.
"""

from __future__ import annotations

import enum
from dataclasses import replace
from typing import TypeAlias

from tensegrity_mj.basics.fields import field, value
from tensegrity_mj.basics.kinds import choice, positive
from tensegrity_mj.dynamics.assembly import AssemblyRecords, needs_assembly, note_redundancy
from tensegrity_mj.dynamics.joint_forces import plan_joints
from tensegrity_mj.dynamics.linked import LinkedRecords
from tensegrity_mj.dynamics.native.plant import Plant
from tensegrity_mj.dynamics.native.views import Fields
from tensegrity_mj.dynamics.records import StructureRecords
from tensegrity_mj.engines.reference import dae_kernels as dae
from tensegrity_mj.engines.reference.engine import ReferenceEngine
from tensegrity_mj.engines.reference.equations import RODS
from tensegrity_mj.engines.reference.floor import axial_moments, contact_columns, packed
from tensegrity_mj.engines.reference.integration import Equations, IntegratedRun
from tensegrity_mj.engines.reference.method import Method
from tensegrity_mj.engines.request import Request
from tensegrity_mj.engines.requirements import require
from tensegrity_mj.engines.table import ENGINES
from tensegrity_mj.errors import OptionError
from tensegrity_mj.model.scene import Scene
from tensegrity_mj.model.structure import Structure
from tensegrity_mj.vibration.stepping import Stepping

# Of rods that hang together, for `Solver.JOINTS`: forces of joints lose as many digits, and a pivot of 1e-12 is none.
LARGEST_MASS_RATIO = 1e10
EXTRA = 2  # behind λ where there are closures: the largest gap [m] and its rate [m/s]


class Drift(enum.Enum):
    """The treatments of constraint drift of §3.2.6."""

    MONITOR = "monitor"  # report it
    NORMALIZE = "normalize"  # (3.23)-(3.24) after each step, and closed loops closed
    BAUMGARTE = "baumgarte"  # (3.25)-(3.26) in the equations, for lengths and closed loops


class Solver(enum.Enum):
    """Solvers for the accelerations of rods that share nodes; all solve the same equations."""

    JOINTS = "joints"  # forces of the joints, in a time proportional to the number of rods of a chain or a tree
    FULL = "full"  # (3.17): one matrix of all coordinates, multipliers, supports and closures
    # Any structure as one system: vectors of all members, and rows for every joint and support; bodies and linear
    # constraints on nodes make it this one, unless it is FULL.
    GENERAL = "general"


@value("DAE", OptionError)
class DAE(ReferenceEngine):
    """Options of the reference engine.

    Attributes:
        method, rtol, atol, timestep, max_steps, accuracy, locate_slack: see `ReferenceEngine`.
        drift: see `Drift`; the drift is reported in any case. By default NORMALIZE with fixed steps, where it
            costs a few per cent and keeps long runs sound, and MONITOR with an error-controlled method.
        solver: see `Solver`.
        baumgarte_frequency, baumgarte_damping: ω [rad/s] and ζ of k_p = ω², k_d = 2 ζ ω.
    """

    descriptor = ENGINES["dae"]

    drift: Drift = field(choice(Drift), default=None, none="None")  # never None once made
    solver: Solver = field(choice(Solver), default=Solver.JOINTS)
    baumgarte_frequency: float = field(positive("rad/s"), default=10.0)
    baumgarte_damping: float = field(positive(), default=1.0)

    def __attrs_post_init__(self) -> None:
        super().__attrs_post_init__()
        if self.drift is None:
            object.__setattr__(self, "drift", Drift.NORMALIZE if self.method is Method.RK4 else Drift.MONITOR)

    def __str__(self) -> str:
        solver = "" if self.solver is Solver.JOINTS else f", solver: {self.solver.value}"
        return f"DAE {self._described()}, drift: {self.drift.value}{solver}"

    @property
    def stepping(self) -> Stepping:
        """Integrator, step and constraint stabilization, for the stability of small motions."""
        if self.drift is not Drift.BAUMGARTE:
            return super().stepping
        # s² + k_d s + k_p = 0 of the stabilized constraints.
        omega, zeta = self.baumgarte_frequency, self.baumgarte_damping
        root = complex(zeta * zeta - 1) ** 0.5
        constraints = (omega * (-zeta + root), omega * (-zeta - root))
        return replace(super().stepping, constraints=constraints)

    def working_bytes(self, scene: Scene) -> int:
        """Bytes of state, stages and matrices."""
        structure = scene.structure
        if self.as_one(scene):
            return self._bytes(6 * len(structure.rods) + 3 * len(structure.lone_masses) + 12 * len(structure.bodies))
        return self._bytes(LinkedRecords.of(structure).nq)

    def as_one(self, scene: Scene) -> bool:
        """Return whether a structure is one system: so are elastic rods in water; rods alone keep their lengths."""
        wet = scene.structure.elastic.any() and any(one.adds_mass for one in scene.effects)
        return bool(wet) or self.solver in (Solver.FULL, Solver.GENERAL) or needs_assembly(scene.structure)

    def prepared(self, request: Request) -> IntegratedRun:
        """See `ReferenceEngine`."""
        require(self, request.scene)
        plant, records, equations = self._model(request)
        if self.drift is Drift.BAUMGARTE:
            omega, zeta = self.baumgarte_frequency, self.baumgarte_damping
            plant.set(kp=omega**2, kd=2 * zeta * omega)
        if self.drift is not Drift.NORMALIZE:
            equations = replace(equations, project=None)
        return IntegratedRun(self, request, plant, records, equations)

    def _model(self, request: Request) -> _Model:
        """The equations for a structure and its supports."""
        structure = request.scene.structure
        if self.as_one(request.scene):
            return _assembled(request, self.solver is Solver.FULL)
        alone = structure.class_number <= 1 and not request.scene.motions
        return _rods_alone(request) if alone else _rods_linked(request)


# A plant with what the compiled functions of a model read, its records, and these functions.
_Model: TypeAlias = tuple[Plant, StructureRecords | LinkedRecords | AssemblyRecords, Equations]


def _plant(request: Request, fields: Fields) -> Plant:
    return Plant(request.scene, request.law, request.actuation, request.on_infeasible, fields)


def _rods_alone(request: Request) -> _Model:
    """Class 1, supports at rest: each rod's equations by themselves."""
    records, contact = StructureRecords.of(request.scene.structure), request.scene.contact
    plant = _plant(request, RODS if contact is None else dae.TOUCHING)
    plant.set(rods=records.rods, points=records.points)
    if contact is not None:
        plant.set(floor=packed(contact, records.structure, records.nq))
        if axial_moments(contact, records.structure).any():
            records = replace(records, nq=records.nq + len(records.rods))
        extra = contact_columns(records.structure)
        accelerate = dae.crowded_accelerate if contact.rods else dae.touching_accelerate
        return plant, records, Equations(dae.dae_place, accelerate, dae.dae_normalize, extra=extra)
    equations = Equations(
        place=dae.dae_place,
        accelerate=dae.dae_accelerate,
        project=dae.dae_normalize,
        lanes=True,
    )
    return plant, records, equations


def _check_masses(structure: Structure) -> None:
    """Raise OptionError where the masses of rods that hang together are too far apart for forces of joints."""
    for cluster in structure.clusters:
        rows = sorted(cluster, key=lambda row: structure.rod_masses[row])
        light, heavy = (structure.rods[row].name for row in (rows[0], rows[-1]))
        least, most = structure.rod_masses[[rows[0], rows[-1]]]
        if most > LARGEST_MASS_RATIO * least:
            raise OptionError(
                f"DAE: rods '{light}' of {least:g} kg and '{heavy}' of {most:g} kg hang together; "
                f"Solver.JOINTS allows masses to be {LARGEST_MASS_RATIO:g} times each other: use solver=Solver.FULL"
            )


def _rods_linked(request: Request) -> _Model:
    """Rods that share nodes, moved supports."""
    scene, plant = request.scene, _plant(request, dae.LINKED)
    records = LinkedRecords.of(scene.structure, scene.motions, plant["moved"])
    closures = len(records.forest.closures)
    plant.set(linked=records.table, joints=plan_joints(records), closure_count=closures)
    _check_masses(scene.structure)
    equations = Equations(
        place=dae.linked_place,
        accelerate=dae.linked_accelerate,
        project=dae.linked_project,
        extra=EXTRA if closures else 0,
    )
    return plant, records, equations


def _assembled(request: Request, hung: bool) -> _Model:
    """Any structure as one system, where rods have places of their own, or are hung on others."""
    scene, plant = request.scene, _plant(request, dae.ASSEMBLED)
    records = AssemblyRecords.of(scene.structure, scene.motions, plant["moved"], hung)
    note_redundancy(records.table, records.state(scene.nodes0, scene.velocities0)[0])
    constraints = len(scene.structure.constraints)
    plant.set(assembly=records.table, constraint_count=constraints)
    equations = Equations(
        place=dae.assembled_place,
        accelerate=dae.assembled_accelerate,
        project=dae.assembled_project,
        extra=EXTRA + constraints,
    )
    return plant, records, equations
