"""dm_control beside a MuJoCo that is newer than the one it was made for."""

from __future__ import annotations

import warnings

from tensegrity_mj.errors import MissingLibraryError


def repair() -> list[str]:
    """Make dm_control work beside a newer MuJoCo that dropped fields; returns the names, none where nothing is amiss.

    dm_control (1.0.50) carries a table of MuJoCo's array fields, made for MuJoCo 3.17, and reads every one of them when
    it builds a Physics. MuJoCo 4.0 has no longer all of them; names that are not there are struck from the table.

    Raises:
        MissingLibraryError: where dm_control cannot be imported, with the reason.
    """
    import mujoco

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # dm_control looks for a display when imported
        try:
            from dm_control.mujoco.wrapper.mjbindings import sizes
        except (
            ImportError,
            AttributeError,
            RuntimeError,
        ) as error:  # what dm_control and PyOpenGL raise without OpenGL
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
