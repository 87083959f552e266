"""Repairs of dm_control for a MuJoCo that is newer than the one it was made for, or a machine without a display."""

from __future__ import annotations

import os
import sys
import warnings
from collections.abc import Iterator
from contextlib import contextmanager

from tensegrity_mj.errors import MissingLibraryError


def repair() -> list[str]:
    """Make dm_control work with a newer MuJoCo that dropped fields; return their names, none if there is no need.

    dm_control (1.0.50) carries a table of MuJoCo's array fields, made for MuJoCo 3.17, and reads every one of them when
    it builds a Physics. MuJoCo 4.0 has no longer all of them; names that are not there are struck from the table.

    The first import of dm_control settles its OpenGL, and PyOpenGL's for the whole process. Where there is no display
    and MUJOCO_GL is not set, that is the one that the renderer here would take, not a window system's.

    Raises:
        MissingLibraryError: where dm_control cannot be imported, with the reason.
    """
    import mujoco

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # dm_control looks for a display when imported
        try:
            with _off_screen():
                from dm_control.mujoco.wrapper.mjbindings import sizes
        except (ImportError, AttributeError) as error:  # AttributeError: PyOpenGL, where it finds no library
            raise MissingLibraryError(
                f"dm_control cannot be imported: {type(error).__name__}: {error}; `tensegrity-mj doctor` checks what "
                "it needs, and MUJOCO_GL chooses its OpenGL"
            ) from error
    gone = []
    for table, kind in (("mjmodel", mujoco.MjModel), ("mjdata", mujoco.MjData)):
        fields = sizes.array_sizes[table]
        for name in [name for name in fields if not hasattr(kind, name)]:
            del fields[name]
            gone.append(name)
    return gone


@contextmanager
def _off_screen() -> Iterator[None]:
    """MUJOCO_GL as `choose_backend` has it while dm_control is imported, where nothing else chooses."""
    from tensegrity_mj.pictures.opengl import choose_backend

    chosen = any(os.environ.get(name) for name in ("MUJOCO_GL", "DISPLAY", "WAYLAND_DISPLAY"))
    if chosen or sys.platform != "linux" or "dm_control._render" in sys.modules:
        yield
        return
    try:
        os.environ["MUJOCO_GL"] = choose_backend()
    except MissingLibraryError:  # dm_control works without pictures
        yield
        return
    try:
        yield
    finally:
        del os.environ["MUJOCO_GL"]
