"""MuJoCo's interactive viewer: on a model that it steps, and on a run, which it plays, until the window is closed.

A run is drawn from node positions alone, as the videos are, so that any engine's can be shown.
"""

from __future__ import annotations

import os
import sys
import threading
import time
import warnings
from typing import Any

import numpy as np

import tensegrity_mj.engines.mujoco  # noqa: F401  (refuses an environment in which MuJoCo cannot be imported)
from tensegrity_mj.basics.arrays import Array, rotation_to
from tensegrity_mj.engines.mujoco.mjcf_tree import quaternion
from tensegrity_mj.errors import MissingLibraryError
from tensegrity_mj.pictures import palette
from tensegrity_mj.pictures.motion import Motion
from tensegrity_mj.pictures.painter import Look, Painter, Sizes, add_terrain
from tensegrity_mj.runs.trajectory import Trajectory

FRAME = 1.0 / 60.0  # s
PAUSE = 1.0  # s at the end, before it starts again
CLOSING_TIME = 10.0  # s that a window may take to close

STEPS = 500  # of an arrow key, over the run
KEYS = "space: pause   - =: speed   arrows: step   L: loop   backspace: to the start"
KEYS_CORNER = 2  # MuJoCo's mjGRID_BOTTOMLEFT, which need not be imported for it
INSTEAD = (
    "or see it without a window: `tensegrity-mj view ... --web` writes a page for any browser, `run --video` and "
    "`render` write videos"
)


def require_display() -> None:
    """Make sure that a window can be opened.

    Raises:
        MissingLibraryError: if there is no display, or a plain Python on macOS, where MuJoCo's viewer needs its own.
    """
    if sys.platform == "linux" and not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        raise MissingLibraryError(
            "the viewer needs a display, and neither DISPLAY nor WAYLAND_DISPLAY is set: run on a desktop (or ssh -X), "
            f"{INSTEAD}"
        )
    if sys.platform == "linux":  # MuJoCo's viewer ends the whole process where this fails, so that it is tried before
        import glfw

        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # it becomes the error below
            opened = glfw.init()
        if not opened:
            reason = glfw.get_error()[1] or "no reason given"
            reason = reason.decode() if isinstance(reason, bytes) else reason
            raise MissingLibraryError(f"the viewer cannot open a window ({reason}): check DISPLAY, {INSTEAD}")
    if sys.platform == "darwin" and "mjpython" not in os.path.basename(sys.executable):
        raise MissingLibraryError("on macOS MuJoCo's viewer needs mjpython: mjpython -m tensegrity_mj view ...")


def play(run: Trajectory, speed: float = 1.0, *, thickness: bool = False) -> None:
    """Play the run, over and over, until the window is closed; `KEYS` pause it and change its speed.

    Args:
        run: a run of any engine.
        speed: simulated seconds a second at the beginning.
        thickness: whether strings are as thick as they pull.

    Raises:
        OptionError: if the run has no sample that can be drawn.
        MissingLibraryError: if no window can be opened.
    """
    motion = Motion.of(run)
    require_display()
    import mujoco
    import mujoco.viewer

    points = motion.nodes.reshape(-1, 3)
    low, high = points.min(axis=0), points.max(axis=0)
    middle, size = 0.5 * (low + high), float(np.linalg.norm(high - low))  # [m] of all that the run passes through
    model, player = _empty_model(motion, middle, size), Player(motion.start, motion.end, speed)
    before = set(threading.enumerate())
    try:
        window = mujoco.viewer.launch_passive(
            model, mujoco.MjData(model), key_callback=player.press, show_left_ui=False, show_right_ui=False
        )
    except RuntimeError as error:
        raise MissingLibraryError(f"MuJoCo's viewer cannot open a window: {error}") from error
    try:
        window.cam.lookat[:] = middle
        window.cam.distance, window.cam.azimuth, window.cam.elevation = 1.8 * size, 130.0, -20.0
        painter = Painter(model, scene=window.user_scn)
        _show(window, painter, motion, Sizes.of(motion.structure, size), player, thickness)
    finally:
        window.close()
        # Its thread still draws: Python must not end, and take the window system away, before it has.
        for thread in set(threading.enumerate()) - before:
            thread.join(CLOSING_TIME)


def view_model(model: Any) -> None:
    """Open MuJoCo's own viewer on an MjModel, which it steps, until the window is closed.

    It starts with the velocities of the model's first keyframe, where there is one. A law that is installed acts.

    Raises:
        MissingLibraryError: if no window can be opened.
    """
    require_display()
    import mujoco
    import mujoco.viewer

    data = mujoco.MjData(model)
    if model.nkey:
        mujoco.mj_resetDataKeyframe(model, data, 0)
    try:
        mujoco.viewer.launch(model, data)
    except RuntimeError as error:
        raise MissingLibraryError(f"MuJoCo's viewer cannot open a window: {error}") from error


class Player:
    """Clock of the viewer: the time that is shown goes on by itself, and keys change it (`KEYS`).

    Args:
        start, end: times at which the run starts and ends [s].
        speed: simulated seconds a second.
    """

    def __init__(self, start: float, end: float, speed: float = 1.0) -> None:
        self.start, self.end, self.speed = start, end, speed
        self.time, self.paused, self.loops = start, False, True

    def press(self, key: int) -> None:
        """Do what a key means, by GLFW's number of it."""
        step = (self.end - self.start) / STEPS
        match key:
            case 32:  # space
                self.paused = not self.paused
            case 262 | 263:  # right, left
                self.paused = True
                self.time = min(max(self.time + (step if key == 262 else -step), self.start), self.end)
            case 45 | 61:  # minus, equal
                self.speed *= 0.5 if key == 45 else 2.0
            case 259:  # backspace
                self.time = self.start
            case 76:  # L
                self.loops = not self.loops

    def go_on(self, seconds: float) -> float:
        """The moment to show [s], so many seconds of the clock after the last one."""
        if not self.paused:
            self.time += self.speed * seconds
        if self.time > self.end + PAUSE * self.speed:
            self.time = self.start if self.loops else self.end
        return min(self.time, self.end)

    @property
    def caption(self) -> str:
        """Text in the window's corner."""
        state = "paused" if self.paused else f"{self.speed:g} x" + ("" if self.loops else ", once")
        return f"{min(self.time, self.end):.3f} of {self.end:g} s, {state}"


def _show(window: Any, painter: Painter, motion: Motion, sizes: Sizes, player: Player, thickness: bool) -> None:
    """Replay the run in an open window, drawn as in films: into the viewer's own list of shapes."""
    scale = palette.TensionScale.of(motion.tensions)
    before = time.monotonic()
    while window.is_running():
        now = time.monotonic()
        moment = player.go_on(now - before)
        pose = motion.pose(moment)
        aim = motion.aim(pose, moment)
        before = now
        with window.lock():
            painter.reset()
            painter.structure(motion, pose, sizes, scale, thickness=thickness)
            painter.supports(motion.structure, pose.nodes, sizes)
            if aim is not None:
                painter.structure(motion, aim, sizes, scale, Look.TARGET)
            painter.finish()
        window.set_texts([(None, None, player.caption, ""), (None, KEYS_CORNER, KEYS, "")])
        window.sync()
        time.sleep(FRAME)


def _empty_model(motion: Motion, middle: Array, size: float) -> Any:
    import mujoco

    text = " ".join(f"{x:.9g}" for x in middle)
    specification = mujoco.MjSpec.from_string(
        f'<mujoco><statistic center="{text}" extent="{size:.9g}"/>'
        '<visual><headlight ambient="0.5 0.5 0.5" diffuse="0.5 0.5 0.5"/></visual>'
        '<asset><texture type="skybox" builtin="gradient" rgb1="0.95 0.96 0.98" rgb2="0.72 0.77 0.83" '
        'width="64" height="384"/></asset></mujoco>'
    )
    if motion.floor is not None:
        look: dict[str, Any] = {"rgba": [0.8, 0.82, 0.84, 1]}
        level = motion.floor[0].copy()
        if motion.terrain is not None:
            add_terrain(specification, motion.terrain)
            kind, middle = mujoco.mjtGeom.mjGEOM_HFIELD, level + motion.terrain.height_field()[0]
            specification.worldbody.add_geom(type=kind, hfieldname="terrain", pos=middle, **look)
            level[2] += motion.terrain.lowest
        place = {"pos": level, "quat": quaternion(rotation_to(motion.floor[1]))}
        specification.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_PLANE, size=[0, 0, 1], **place, **look)
    return specification.compile()
