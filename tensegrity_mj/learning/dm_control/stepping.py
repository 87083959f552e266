"""A dm_control Physics that keeps a scene's strings and forces true to it from step to step."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np
from dm_control.mujoco import Physics
from dm_control.rl.control import PhysicsError
from numpy.typing import ArrayLike

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.dynamics.native.law import Command
from tensegrity_mj.engines.mujoco.mjcf_tree import initial_velocities
from tensegrity_mj.errors import ControllerError, DivergenceError
from tensegrity_mj.learning.dm_control.readings import HeldForces, StringActuators, point_velocities
from tensegrity_mj.model.scene import Scene
from tensegrity_mj.runs.energy import BEYOND


class PhysicsDivergence(DivergenceError, PhysicsError):  # type: ignore[misc]
    """Divergence of a step, as our error and as dm_control's PhysicsError: a value became infinite or NaN."""


class ScenePhysics(Physics):  # type: ignore[misc]
    """A dm_control Physics of a scene; make it with `physics(scene)`.

    Attributes:
        scene: what it is a model of.
        command: what its actuators take: changes of rest lengths, or force densities.
    """

    scene: Scene
    command: Command

    @classmethod
    def of_scene(cls, scene: Scene, command: Command, text: str) -> ScenePhysics:
        """Make the Physics of a scene from the MJCF text of `models.model`."""
        result: ScenePhysics = cls.from_xml_string(text)
        result._equip(scene, command)
        result.reset()
        return result

    def _equip(self, scene: Scene, command: Command) -> None:
        self.scene, self.command = scene, command
        self.string_actuators, self.forces = StringActuators(scene, command, self.timestep()), HeldForces(scene)
        model = self.model.ptr
        self._sites = np.array([model.site(name).id for name in scene.structure.node_names], np.int64)
        self._bodies = np.asarray(model.site_bodyid[self._sites])
        self._size = len(scene.structure.strings)

    # Reading

    def nodes(self) -> Array:
        """Node positions (N, 3) [m]."""
        return np.array(self.data.ptr.site_xpos[self._sites])

    def velocities(self) -> Array:
        """Node velocities (N, 3) [m/s]."""
        return point_velocities(self.model.ptr, self.data.ptr, self._bodies, self.data.ptr.site_xpos[self._sites])

    def string_lengths(self) -> Array:
        """String lengths ‖s‖ (M,) [m]."""
        return np.array(self.data.ptr.ten_length)

    def rest_lengths(self) -> Array:
        """Rest lengths L0 (M,) [m]."""
        return self.string_actuators.rest_lengths(self._ctrl(), self.string_lengths())

    def force_densities(self) -> Array:
        """Force densities u (M,) [N/m]."""
        return self.string_actuators.force_densities(self._ctrl(), self.string_lengths(), self.time())

    def tensions(self) -> Array:
        """Tensions T (M,) [N] at this very state (MuJoCo's actuator_force is that of the last stage)."""
        rates = np.array(self.data.ptr.ten_velocity)
        return self.string_actuators.tensions(self._ctrl(), self.string_lengths(), rates, self.time())

    def _ctrl(self) -> Array:
        return np.array(self.data.ptr.ctrl[: self._size])

    # Acting

    def set_control(self, control: ArrayLike) -> None:
        """Controls (M,) of the strings as MuJoCo has them: changes of rest lengths [m], or force densities [N/m].

        Raises:
            ControllerError: for another shape, or a value that is not finite.
        """
        self.data.ptr.ctrl[: self._size] = self._checked("control", control)

    def set_command(self, command: ArrayLike, period: float | None = None) -> None:
        """Rest lengths (M,) [m], or force densities [N/m], held until the next command.

        Kept within the limits of the strings; within that of the winches' speed if the `period` [s] to the next command
        is given.

        Raises:
            ControllerError: for another shape, or a value that is not finite.
        """
        values, lengths = self._checked(self.command.value, command), self.string_lengths()
        values = self.string_actuators.limited(values, self._ctrl(), lengths, period)
        self.set_control(self.string_actuators.controls(values))

    def _checked(self, what: str, value: ArrayLike) -> Array:
        names = [string.name for string in self.scene.structure.strings]
        return checked_command(what, value, names)

    # Stepping

    def step(self, nstep: int = 1) -> None:
        """Advance by so many time steps.

        Raises:
            PhysicsDivergence: where a value becomes infinite or NaN.
            OptionError, ElementError: where the scene's load function or an element fails.
        """
        if self.string_actuators.needs_limits or len(self.forces):
            for _ in range(nstep):
                self._renew()
                self._advance(1)
        else:
            self._advance(nstep)

    def _renew(self) -> None:
        """Renew forces on nodes, breaks and damping of slack strings, once a step; a callback would at each stage."""
        model, data = self.model.ptr, self.data.ptr
        if self.string_actuators.needs_limits:
            limits = self.string_actuators.force_limits(data.ctrl[: self._size], data.ten_length, data.time)
            model.actuator_forcerange[: self._size] = limits
        if len(self.forces):
            middle = model.opt.integrator == mujoco.mjtIntegrator.mjINT_RK4
            state = self.nodes(), self.velocities()
            data.ctrl[self._size :] = self.forces.controls(data.time, model.opt.timestep, middle, *state)

    def _advance(self, nstep: int) -> None:
        try:
            super().step(nstep)
        except PhysicsError as error:
            self._diverged(" ".join(str(error).split()), error)
        data = self.data.ptr
        if not (np.all(np.abs(data.qpos) < BEYOND) and np.all(np.abs(data.qvel) < BEYOND)):
            self._diverged(f"positions or velocities are beyond {BEYOND:g} m or m/s", None)

    def _diverged(self, cause: str, error: Exception | None) -> None:
        time, h = float(self.data.time), float(self.model.opt.timestep)
        raise PhysicsDivergence(
            f"diverged by t = {time:.6g} s: {cause}; reduce the time step (h = {h:g} s), or give milder actions; "
            "reset() begins anew",
            time,
        ) from error

    # Starting

    def reset(self, keyframe_id: int | None = None) -> None:
        """Go back to the scene's start, with the structure as designed."""
        super().reset(keyframe_id)
        self.data.ptr.qvel[:] = initial_velocities(self.scene)
        self.settle()

    def settle(self) -> None:
        """Take up a start: the lengths there, and the structure as designed."""
        self.forward()  # for the lengths
        self.data.ptr.ctrl[: self._size] = self.string_actuators.designed(self.string_lengths())
        self.after_reset()

    def after_reset(self) -> None:
        """Compute derived quantities as dm_control does, but with the strings, whose controls act from the start."""
        self.forward()

    # Copies

    def copy(self, share_model: bool = False) -> ScenePhysics:
        """A copy in the same state."""
        result: ScenePhysics = super().copy(share_model)
        result._equip(self.scene, self.command)
        return result

    def __getstate__(self) -> Any:
        return super().__getstate__(), self.scene, self.command

    def __setstate__(self, state: Any) -> None:
        data, scene, command = state
        super().__setstate__(data)
        self._equip(scene, command)


def checked_command(what: str, value: ArrayLike, names: list[str]) -> Array:
    """Return the value as finite floats, one a string; raise ControllerError that names the string at fault."""
    try:
        array = np.asarray(value)
        if np.iscomplexobj(array):
            raise ValueError
        array = array.astype(float)
    except (TypeError, ValueError):
        raise ControllerError(f"{what} = {value!r}; it must be {len(names)} real numbers, one a string") from None
    if array.shape != (len(names),):
        raise ControllerError(f"{what} has shape {array.shape}; it must be ({len(names)},), a value a string")
    if not np.all(np.isfinite(array)):
        number = int(np.argmin(np.isfinite(array)))
        raise ControllerError(f"{what} of string '{names[number]}' = {array[number]}; it must be finite")
    return array
