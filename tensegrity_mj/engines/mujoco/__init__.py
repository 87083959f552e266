"""MuJoCo as an engine. An environment that cannot import it is refused here, before any module of this room."""

from __future__ import annotations

import os

from tensegrity_mj.errors import MissingLibraryError, OptionError


def _check_import() -> None:
    """Import MuJoCo where MUJOCO_GL is set: it binds that kind of OpenGL at once, although only pictures need any.

    Raises:
        OptionError: if MUJOCO_GL has a value that MuJoCo does not know.
        MissingLibraryError: if that kind of OpenGL is not installed.
    """
    chosen = os.environ.get("MUJOCO_GL", "").strip()
    if not chosen:
        return
    try:
        import mujoco  # noqa: F401
    except RuntimeError as error:
        raise OptionError(
            f"MUJOCO_GL={chosen}: MuJoCo cannot be imported ({error}); allowed are egl, osmesa, glfw, and off; unset "
            "it to have one chosen"
        ) from error
    except Exception as error:  # PyOpenGL without the library: ImportError, AttributeError, OSError
        raise MissingLibraryError(
            f"MUJOCO_GL={chosen}: MuJoCo cannot be imported ({type(error).__name__}: {error}); tensegrity-mj doctor "
            "says whether MuJoCo is whole; if so, this kind of OpenGL does not work here: unset it, or install that"
        ) from error


_check_import()
