"""A task as a Gymnasium environment: of one robot, and of many in one process. Both are the same robots."""

from __future__ import annotations

import copy
import os
import sys
from collections.abc import Sequence
from typing import Any

import gymnasium
import mujoco
import numpy as np
from gymnasium.spaces import Box
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import ArrayLike, NDArray

from tensegrity_mj.basics.checks import check_known
from tensegrity_mj.learning.tasks.definition import Task
from tensegrity_mj.learning.tasks.world import LARGEST, World
from tensegrity_mj.pictures.opengl import Canvas

RENDER_MODES = ("human", "rgb_array")
METADATA: dict[str, Any] = {"render_modes": list(RENDER_MODES)}  # what gymnasium.make reads of a class
Array32 = NDArray[np.float32]
Info = dict[str, Any]


class TensegrityEnv(gymnasium.Env[Array32, Array32]):
    """One robot: a `TensegrityVectorEnv` of one, which goes on after the end of an episode until it is reset.

    Args:
        task: the name of a task, or a `tensegrity_mj.learning.tasks.Task`.
        render_mode: "rgb_array", or "human": a window that is renewed at each step.
        max_episode_steps: after which an episode is truncated; the task's by default, -1 for no end.
        options: `action`, `parameters`, `draws`: see `tensegrity_mj.learning.tasks.World`.

    Attributes:
        world, observation_slices: as of `TensegrityVectorEnv`.

    Raises:
        OptionError, StructureError, SceneError: for options that are out of range.
        ControllerError: on `step`, for an action that is no number for each string.
    """

    metadata: Info = METADATA

    def __init__(
        self, task: str | Task, render_mode: str | None = None, max_episode_steps: int | None = None, **options: Any
    ) -> None:
        self._one = one = TensegrityVectorEnv(
            1, task, max_episode_steps, render_mode, AutoresetMode.DISABLED, **options
        )
        self.world, self.observation_slices = one.world, one.observation_slices
        self.render_mode, self.metadata = render_mode, one.metadata
        self.action_space, self.observation_space = one.single_action_space, one.single_observation_space

    def reset(self, *, seed: int | None = None, options: Info | None = None) -> tuple[Array32, Info]:
        """Begin an episode. There are no options."""
        super().reset(seed=seed)
        return self._one.begin([0], [self.np_random])[0], {}

    def step(self, action: ArrayLike) -> tuple[Array32, float, bool, bool, Info]:
        """A control period. The terms of the reward are in `info`."""
        seen, reward, terminated, truncated, info = self._one.step(np.asarray(action)[None])
        found = {name: part[0].item() for name, part in info.items() if not name.startswith("_")}
        return seen[0], float(reward[0]), bool(terminated[0]), bool(truncated[0]), found

    def render(self) -> Any:
        """Picture (480, 640, 3) uint8 with "rgb_array"."""
        pictures = self._one.render()
        return None if pictures is None else pictures[0]

    def close(self) -> None:
        """Close the window."""
        self._one.close_extras()


class TensegrityVectorEnv(VectorEnv[Array32, Array32, Any]):
    """Many robots in this process, stepped on threads: the same as that many `TensegrityEnv`s, to the bit.

    Args:
        num_envs: number of robots.
        max_episode_steps: as of `TensegrityEnv`.
        autoreset_mode: see `gymnasium.vector.AutoresetMode`.
        task, render_mode: as of `TensegrityEnv`; "human" shows the first robot.
        options: `action`, `parameters`, `draws`, `threads`: see `tensegrity_mj.learning.tasks.World`.

    Attributes:
        world: the robots.
        observation_slices: where each part of an observation stands, by its name.

    Raises:
        OptionError, StructureError, SceneError, ControllerError: as `TensegrityEnv`.
    """

    metadata: Info = METADATA

    def __init__(
        self,
        num_envs: int,
        task: str | Task,
        max_episode_steps: int | None = None,
        render_mode: str | None = None,
        autoreset_mode: str | AutoresetMode = AutoresetMode.NEXT_STEP,
        **options: Any,
    ) -> None:
        if render_mode is not None:
            check_known("render_mode", render_mode, RENDER_MODES, "mode")
        self.world = world = World(task, num_envs, max_episode_steps=max_episode_steps, **options)
        self.render_mode, self.observation_slices = render_mode, world.slices
        self.single_action_space = Box(-1.0, 1.0, (len(world.task.low),), np.float32)
        self.single_observation_space = Box(-LARGEST, LARGEST, (world.size,), np.float32)
        self.num_envs = world.count
        self.action_space = batch_space(self.single_action_space, num_envs)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        if not isinstance(autoreset_mode, AutoresetMode):
            check_known("autoreset_mode", autoreset_mode, [mode.value for mode in AutoresetMode], "mode")
        self._mode = AutoresetMode(autoreset_mode)
        self.metadata = METADATA | {
            "render_fps": round(1.0 / world.task.period),
            "measured_error": dict(world.task.measured_error),
            "drawn": list(world.drawn),
            "autoreset_mode": self._mode,
        }
        self._viewer: Viewer | None = None
        self._all = np.arange(self.num_envs)
        self._ended = np.zeros(self.num_envs, bool)
        self._generators: list[Any] = [None] * self.num_envs

    def reset(self, *, seed: Any = None, options: Info | None = None) -> tuple[Array32, Info]:
        """Begin episodes. Robot i has the seed seed + i, or its own of a list.

        `options={"reset_mask": (n,) of bool}` begins those alone, and gives zeros for the others.

        Raises:
            ValueError: for a list of another length.
        """
        seeds = list(seed) if np.ndim(seed) else [None if seed is None else seed + i for i in range(self.num_envs)]
        if len(seeds) != self.num_envs:
            raise ValueError(f"seed: {len(seeds)} of them for {self.num_envs} robots; give one, or one each")
        mask = np.asarray((options or {}).get("reset_mask", np.ones(self.num_envs, bool)), bool)
        for number, one in enumerate(seeds):
            if one is not None or self._generators[number] is None:
                self._generators[number] = np.random.default_rng(one)
        observation = np.zeros((self.num_envs, self.world.size), np.float32)
        observation[mask] = self.begin(self._all[mask])
        return observation, {}

    def step(self, actions: ArrayLike) -> tuple[Array32, Any, Any, Any, Info]:
        """A control period of those that are in an episode; what has ended begins anew, as the mode says."""
        anew = self._ended.copy() if self._mode is AutoresetMode.NEXT_STEP else np.zeros(self.num_envs, bool)
        go = ~anew
        observation = np.zeros((self.num_envs, self.world.size), np.float32)
        reward, (diverged, truncated) = np.zeros(self.num_envs), np.zeros((2, self.num_envs), bool)
        out = self.world.step(self._all[go], np.asarray(actions)[go])
        observation[go], reward[go] = out.observation, out.reward
        diverged[go], truncated[go] = out.diverged, out.truncated
        observation[anew] = self.begin(self._all[anew])
        self._show()
        info: Info = {}  # terms of the reward (n,), and of which robots they are
        for name, term in (*out.terms.items(), ("diverged", out.diverged)):
            info[name] = np.zeros(self.num_envs, term.dtype)
            info[name][go], info[f"_{name}"] = term, go.copy()
        self._ended = diverged | truncated
        ended = self._ended.copy()
        if self._mode is AutoresetMode.SAME_STEP and ended.any():
            final = {name: part.copy() for name, part in info.items()}
            info |= {"final_obs": observation.copy(), "final_info": final}
            info |= {"_final_obs": ended, "_final_info": ended.copy()}
            observation[ended] = self.begin(self._all[ended])
        return observation, reward, diverged, truncated, info

    def render(self) -> Any:
        """Pictures (480, 640, 3) uint8 of each robot with "rgb_array"."""
        self._viewer = self._viewer or Viewer(self.world)
        if self.render_mode == "rgb_array":
            return tuple(self._viewer.pixels(number) for number in range(self.num_envs))
        return self._viewer.show() if self.render_mode == "human" else None

    def close_extras(self, **kwargs: Any) -> None:
        """Close the window."""
        if self._viewer is not None:
            self._viewer.close()
        self._viewer = None

    def begin(self, ids: ArrayLike, generators: Sequence[Any] | None = None) -> Any:
        """Begin an episode of these robots, with their own generators or others; their observations."""
        numbers = np.asarray(ids, np.int64)
        for number, generator in zip(numbers, generators or (), strict=False):
            self._generators[number] = generator
        self._ended[numbers] = False
        seen = self.world.start(numbers, [self._generators[number] for number in numbers])
        self._show()
        return seen

    def _show(self) -> None:
        if self.render_mode == "human":
            self.render()


def unlimited(**options: Any) -> TensegrityEnv:
    """A `TensegrityEnv` as `gymnasium.make` makes it by name, whose wrapper `TimeLimit` counts the steps."""
    return TensegrityEnv(max_episode_steps=-1, **options)


SIZE = (640, 480)  # px
ELEVATION, AZIMUTH, DISTANCE = -15.0, 120.0, 3.0  # degrees, degrees, sizes of the robot
GEOMS = 10_000


class Viewer:
    """Viewer of a world's robots, the camera on the robot's centre; `close` it.

    Raises:
        MissingLibraryError: where there is no OpenGL.
    """

    def __init__(self, world: World) -> None:
        self._world, model = world, copy.copy(world.fleet.model)
        model.vis.quality.offsamples = 0  # pixels of a multisampled buffer cannot be read; they are drawn twice as fine
        self._size = float(np.ptp(world.task.scene.nodes0, axis=0).max())
        self._camera = mujoco.MjvCamera()
        self._camera.distance, self._camera.elevation, self._camera.azimuth = DISTANCE * self._size, ELEVATION, AZIMUTH
        self._model, self._data = model, mujoco.MjData(model)
        self._canvas: Canvas | None = None
        self._window: Any = None

    def pixels(self, number: int = 0) -> NDArray[np.uint8]:
        """Picture (480, 640, 3) of a robot."""
        if self._canvas is None:
            self._canvas = Canvas(self._model, 2 * SIZE[0], 2 * SIZE[1])
            self._scene = mujoco.MjvScene(self._model, GEOMS)
        self._look_at(number)
        option, everything = mujoco.MjvOption(), mujoco.mjtCatBit.mjCAT_ALL.value
        mujoco.mjv_updateScene(self._model, self._data, option, None, self._camera, everything, self._scene)
        fine = self._canvas.draw(self._scene, 2 * SIZE[0], 2 * SIZE[1])[::-1, :, :3]
        return fine.reshape(SIZE[1], 2, SIZE[0], 2, 3).mean(axis=(1, 3)).astype(np.uint8)

    def show(self, number: int = 0) -> None:
        """A robot in MuJoCo's window; where there is no display, a line to stderr the first time, and no window."""
        displays = any(os.environ.get(name) for name in ("DISPLAY", "WAYLAND_DISPLAY"))
        if self._window is None and sys.platform == "linux" and not displays:
            print("render_mode = 'human': this machine has no display; nothing is shown", file=sys.stderr)
            self._window = False
        if self._window is False:
            return
        self._look_at(number)
        if self._window is None:
            import mujoco.viewer

            self._window = mujoco.viewer.launch_passive(
                self._model, self._data, show_left_ui=False, show_right_ui=False
            )
            self._window.cam.distance, self._window.cam.elevation = self._camera.distance, ELEVATION
        self._window.cam.lookat[:] = self._camera.lookat
        self._window.sync()

    def close(self) -> None:
        """Free the window and OpenGL."""
        if self._canvas is not None:
            self._canvas.__exit__(None, None, None)
        if self._window:
            self._window.close()
        self._canvas = self._window = None

    def _look_at(self, number: int) -> None:
        self._data.qpos[:] = self._world.fleet.batch.qpos[number]
        mujoco.mj_forward(self._model, self._data)
        self._camera.lookat[:] = self._world.state().nodes[number].mean(axis=0)
