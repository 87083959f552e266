"""A robot of a fleet as MuJoCo draws it: pixels, or a window."""

from __future__ import annotations

import copy
import os
import sys
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from tensegrity_mj.pictures.opengl import Canvas
from tensegrity_mj.studies.tasks.world import World

SIZE = (640, 480)  # px
ELEVATION, AZIMUTH, DISTANCE = -15.0, 120.0, 3.0  # degrees, degrees, sizes of the robot
GEOMS = 10_000


class Viewer:
    """Draws a world's robots, the camera on the robot's centre; `close` it.

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
        """(480, 640, 3) of a robot."""
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
