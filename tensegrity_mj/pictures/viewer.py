"""A run in MuJoCo's interactive viewer: replayed in real time, over and over, until the window is closed.

Drawn from node positions alone, as the videos are, so that any engine's run can be shown.
"""

from __future__ import annotations

import os
import sys
import threading
import time
import warnings
from typing import Any

import numpy as np
from numpy.typing import NDArray

import tensegrity_mj.engines.mujoco  # noqa: F401  (refuses an environment in which MuJoCo cannot be imported)
from tensegrity_mj.errors import MissingLibraryError
from tensegrity_mj.runs.trajectory import Trajectory

FRAME = 1.0 / 60.0  # s
PAUSE = 1.0  # s at the end, before it starts again
CLOSING_TIME = 10.0  # s that a window may take to close

ROD = np.array([0.25, 0.27, 0.31, 1.0], np.float32)
TAUT = np.array([0.80, 0.20, 0.15, 1.0], np.float32)
SLACK = np.array([0.60, 0.60, 0.60, 0.6], np.float32)


def require_display() -> None:
    """Make sure that a window can be opened.

    Raises:
        MissingLibraryError: if there is no display, or a plain Python on macOS, where MuJoCo's viewer needs its own.
    """
    if sys.platform == "linux" and not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        raise MissingLibraryError(
            "the viewer needs a display, and neither DISPLAY nor WAYLAND_DISPLAY is set: "
            "run on a desktop (or ssh -X), or make a video instead"
        )
    if sys.platform == "linux":
        _open_glfw()
    if sys.platform == "darwin" and "mjpython" not in os.path.basename(sys.executable):
        raise MissingLibraryError("on macOS MuJoCo's viewer needs mjpython: mjpython -m tensegrity_mj run ... --view")


def _open_glfw() -> None:
    """MuJoCo's viewer ends the whole process where this fails, so that it must be tried before."""
    import glfw

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # it becomes the error below
        opened = glfw.init()
    if not opened:
        reason = glfw.get_error()[1] or "no reason given"
        reason = reason.decode() if isinstance(reason, bytes) else reason
        raise MissingLibraryError(f"the viewer cannot open a window ({reason}): check DISPLAY, or make a video instead")


def view(run: Trajectory) -> None:
    """Show the run until the window is closed.

    Raises:
        MissingLibraryError: if no window can be opened.
    """
    require_display()
    import mujoco
    import mujoco.viewer

    model = _empty_model(run)
    before = set(threading.enumerate())
    try:
        window = mujoco.viewer.launch_passive(model, mujoco.MjData(model), show_left_ui=False, show_right_ui=False)
    except RuntimeError as error:
        raise MissingLibraryError(f"MuJoCo's viewer cannot open a window: {error}") from error
    try:
        _show(window, run)
    finally:
        window.close()
        # Its thread still draws: Python must not end, and take the window system away, before it has.
        for thread in set(threading.enumerate()) - before:
            thread.join(CLOSING_TIME)


def _show(window: Any, run: Trajectory) -> None:
    """Replay the run in an open window."""
    _point_camera(window.cam, run)
    string_width = 0.002 * _extent(run)[1]
    began = time.monotonic()
    while window.is_running():
        now = (time.monotonic() - began) % (float(run.time[-1] - run.time[0]) + PAUSE)
        row = min(int(np.searchsorted(run.time - run.time[0], now)), len(run.time) - 1)
        with window.lock():
            _draw(window.user_scn, run, row, string_width)
        window.sync()
        time.sleep(FRAME)


def _empty_model(run: Trajectory) -> Any:
    import mujoco

    center, size = _extent(run)
    text = " ".join(f"{x:.9g}" for x in center)
    return mujoco.MjModel.from_xml_string(
        f'<mujoco><statistic center="{text}" extent="{size:.9g}"/>'
        '<visual><headlight ambient="0.5 0.5 0.5" diffuse="0.5 0.5 0.5"/></visual>'
        '<asset><texture type="skybox" builtin="gradient" rgb1="0.95 0.96 0.98" rgb2="0.72 0.77 0.83" '
        f'width="64" height="384"/></asset>{_floor(run)}</mujoco>'
    )


def _floor(run: Trajectory) -> str:
    """The scene's floor as MJCF, or nothing."""
    contact = run.scene.contact
    if contact is None or contact.floor is None:
        return ""
    place, up = (" ".join(f"{x:.9g}" for x in v) for v in (contact.floor * contact.up, contact.up))
    return f'<worldbody><geom type="plane" pos="{place}" zaxis="{up}" size="0 0 1" rgba="0.8 0.82 0.84 1"/></worldbody>'


def _point_camera(camera: Any, run: Trajectory) -> None:
    center, size = _extent(run)
    camera.lookat[:] = center
    camera.distance = 1.8 * size
    camera.azimuth, camera.elevation = 130.0, -20.0


def _extent(run: Trajectory) -> tuple[NDArray[np.float64], float]:
    """Centre and diagonal [m] of all that the run passes through."""
    points = run.nodes.reshape(-1, 3)
    low, high = points.min(axis=0), points.max(axis=0)
    return (low + high) / 2, float(np.linalg.norm(high - low))


def _draw(scene: Any, run: Trajectory, row: int, string_width: float) -> None:
    """Put rods and strings at one sample into the viewer's own list of shapes."""
    import mujoco

    structure, nodes = run.scene.structure, run.nodes[row]
    members = [
        (mujoco.mjtGeom.mjGEOM_CAPSULE, pair, rod.radius, ROD)
        for pair, rod in zip(structure.rod_nodes, structure.rods, strict=True)
    ] + [
        (mujoco.mjtGeom.mjGEOM_CYLINDER, pair, string_width, TAUT if tension > 0 else SLACK)
        for pair, tension in zip(structure.string_nodes, run.tensions[row], strict=True)
    ]
    scene.ngeom = min(len(members), scene.maxgeom)
    for geom, (kind, (i, j), width, color) in zip(scene.geoms, members, strict=False):
        mujoco.mjv_initGeom(geom, kind, np.zeros(3), np.zeros(3), np.eye(3).ravel(), color)
        mujoco.mjv_connector(geom, kind, width, nodes[i], nodes[j])
