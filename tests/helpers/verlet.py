"""An engine as docs/developing/models.md makes one: point masses on strings, by velocity Verlet, in NumPy."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Any

import numpy as np

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.basics.checks import positive
from tensegrity_mj.dynamics.native.law import Report
from tensegrity_mj.engines.driving import Grid, progress
from tensegrity_mj.engines.request import Accelerations, Request
from tensegrity_mj.engines.requirements import require
from tensegrity_mj.errors import DivergenceError, OptionError
from tensegrity_mj.model import rods, strings
from tensegrity_mj.model.capabilities import BREAKS, CONTACT, ELEMENTS, MOVED_SUPPORTS, Descriptor, Limit, Trait
from tensegrity_mj.model.scene import Scene
from tensegrity_mj.runs.trajectory import Trajectory
from tensegrity_mj.vibration.stepping import Stepping


@dataclass(frozen=True)
class Verlet:
    """Structures without rods, open loop, by the method of Störmer and Verlet: order 2, symplectic without dampers.

    Attributes:
        timestep: [s].
    """

    timestep: float = 1e-3
    descriptor = Descriptor(
        "Verlet",
        "verlet:Verlet",
        limits=tuple(
            Limit(Trait(find), "it moves point masses on strings alone", f"leave {what} out")
            for what, find in {
                "rods": lambda scene: "the structure has rods" if scene.structure.rods else "",
                "breaks": BREAKS.find,
                "moved supports": MOVED_SUPPORTS.find,
                "contact": CONTACT.find,
                "elements beside loads": ELEMENTS.find,
            }.items()
        ),
    )

    def __post_init__(self) -> None:
        object.__setattr__(self, "timestep", positive("Verlet: timestep", self.timestep, "s"))

    stepping = Stepping()  # its stable step is not known to `vibration`

    def accelerations(self, request: Request) -> Accelerations:
        """Accelerations of the nodes at one state."""
        model = _Masses(request)

        def found(t: float, nodes: Array, velocities: Array, rest: Array | None = None) -> tuple[Array, Array]:
            return nodes, model(t, nodes, velocities, rest)

        return found

    def working_bytes(self, scene: Scene) -> int:
        """Bytes of positions, velocities and accelerations."""
        return 3 * scene.nodes0.nbytes

    def run(self, request: Request) -> Trajectory:
        """Simulate a request."""
        scene, structure = request.scene, request.scene.structure
        model, grid, h = _Masses(request), Grid.of(request, self.timestep), self.timestep
        nodes, velocities = scene.nodes0.copy(), scene.velocities0.copy()
        rest = structure.rest_lengths
        kept, start = [], time.perf_counter()
        work, acceleration = np.zeros(2), model(0.0, nodes, velocities)  # of loads, and lost
        with progress(request, "Verlet") as show:
            for step in range(grid.count + 1):
                if step % grid.stride == 0 or step == grid.count:
                    kept.append((nodes, velocities, *work))
                    show(step * h)
                if step == grid.count:
                    break
                before = model.powers(step * h, nodes, velocities)
                velocities = velocities + 0.5 * h * acceleration
                nodes = nodes + h * velocities
                acceleration = model((step + 1) * h, nodes, velocities)
                velocities = velocities + 0.5 * h * acceleration
                work = work + 0.5 * h * (before + model.powers((step + 1) * h, nodes, velocities))
                if not np.isfinite(nodes).all():
                    raise DivergenceError(f"Verlet diverged at t = {(step + 1) * h:g} s: take a smaller step", step * h)
        seconds = time.perf_counter() - start
        x, v, external, lost = (np.array(column) for column in zip(*kept, strict=True))
        lengths = structure.string_lengths(x)
        elastic = strings.elastic_tension(structure.stiffness, lengths, rest)
        none = np.full(len(x), np.nan)
        reported: dict[str, Any] = {report.name.lower(): none for report in Report}
        return Trajectory(
            scene=scene,
            time=grid.times,
            nodes=x,
            velocities=v,
            force_densities=elastic / lengths,
            rest_lengths=np.tile(rest, (len(x), 1)),
            tensions=model.tensions(x, v),
            multipliers=np.zeros((len(x), 0)),
            rod_force_densities=np.zeros((len(x), 0)),
            kinetic_energy=rods.kinetic_energy(structure, v),
            gravity_energy=rods.gravity_energy(structure, x, np.array(scene.gravity)),
            string_energy=strings.energy(structure.stiffness, lengths, rest).sum(axis=1),
            winch_work=np.zeros(len(x)),
            external_work=external,
            dissipation=lost,
            **reported,
            engine=f"Verlet, h = {h:g} s",
            cost={"wall_time": seconds, "steps": grid.count, "evaluations": grid.count + 1},
        )


class _Masses:
    """Newton's law for the point masses of a request."""

    def __init__(self, request: Request) -> None:
        self.scene, self.structure = request.scene, request.scene.structure
        if request.law.address:
            raise OptionError("Verlet simulates no law; use MuJoCo, the DAE or the ODE")
        require(Verlet(), self.scene)
        index = self.structure.node_index
        self.rows = [index[point.node] for point in self.structure.point_masses]
        self.masses = np.array([point.mass for point in self.structure.point_masses])

    def __call__(self, t: float, nodes: Array, velocities: Array, rest: Array | None = None) -> Array:
        """Accelerations (N, 3) [m/s²], zero at what is fixed."""
        pulls = self.tensions(nodes, velocities, rest)
        forces = rods.string_forces(self.structure, nodes, pulls) + self.scene.nodal_forces(t)
        found = np.zeros_like(nodes)
        found[self.rows] = forces[self.rows] / self.masses[:, None] + np.array(self.scene.gravity)
        return found

    def tensions(self, nodes: Array, velocities: Array, rest: Array | None = None) -> Array:
        """Tensions (..., M) [N] by the one string law."""
        own = self.structure
        lengths, rates = own.string_lengths(nodes), own.string_rates(nodes, velocities)
        at = own.rest_lengths if rest is None else rest
        return strings.tension(own.stiffness, own.damping, lengths, rates, at, own.string_law)

    def powers(self, t: float, nodes: Array, velocities: Array) -> Array:
        """What loads give and dampers take [W]."""
        own, loads = self.structure, self.scene.nodal_forces(t)
        lengths, rates = own.string_lengths(nodes), own.string_rates(nodes, velocities)
        elastic = strings.elastic_tension(own.stiffness, lengths, own.rest_lengths)
        return np.array([np.sum(loads * velocities), np.sum((self.tensions(nodes, velocities) - elastic) * rates)])
