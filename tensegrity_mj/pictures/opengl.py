"""Off-screen OpenGL for pictures: choose one that works here, open it, draw a MuJoCo scene into an array.

MuJoCo binds one kind of OpenGL when it is first imported (MUJOCO_GL, or a window system's where that is unset, which
fails on a machine without a display). The engine may have been imported long before a picture is wanted, so
this module takes the context class that it needs from MuJoCo by itself and leaves MuJoCo's choice alone.
"""

from __future__ import annotations

import contextlib
import ctypes
import ctypes.util
import functools
import importlib
import os
import sys
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tensegrity_mj.errors import MissingLibraryError, OptionError

DEBIAN_PACKAGES = "libegl1 libegl-mesa0 libgl1-mesa-dri libopengl0"
DEBIAN_PACKAGES_OSMESA = "libosmesa6"
REMEDY = (
    f"on Debian or Ubuntu, install the packages {DEBIAN_PACKAGES} (EGL, which needs no display), "
    f"or {DEBIAN_PACKAGES_OSMESA} (OSMesa); everything but pictures and videos works without"
)
MAX_SIZE = 4096  # px; a frame's largest side
MAX_BUFFER = 8192  # px; what every OpenGL of the last ten years can hold

_OFF = ("disable", "disabled", "off", "false", "0")
# Values that MuJoCo itself takes here: it cannot be imported with another one.
_WINDOW = ("glfw", "enable", "enabled", "on", "true", "1", {"linux": "glx", "win32": "wgl"}.get(sys.platform, "glfw"))

Image = NDArray[np.uint8]


def choose_backend() -> str:
    """Choose the OpenGL to draw with: "egl", "osmesa", "glfw" or "cgl".

    MUJOCO_GL decides where it is set. Elsewhere EGL is taken if it finds a device (a graphics card or Mesa's software
    renderer; it needs no display), then OSMesa, then a window system's, if there is a display.

    Raises:
        MissingLibraryError: if there is none; the message names which Debian packages bring one.
        OptionError: if MUJOCO_GL has a value that means nothing here.
    """
    chosen = os.environ.get("MUJOCO_GL", "").strip().lower()
    if chosen in _OFF:
        raise MissingLibraryError(
            f"pictures need OpenGL, which MUJOCO_GL={chosen} switches off: unset MUJOCO_GL, or set it to egl or osmesa"
        )
    if (chosen == "egl" and egl_devices() == 0) or (chosen == "osmesa" and not has_osmesa()):
        # Found out here: MuJoCo itself cannot even be imported then.
        raise MissingLibraryError(f"pictures need OpenGL, and MUJOCO_GL={chosen} finds none: {REMEDY}")
    if chosen in ("egl", "osmesa", "cgl"):
        return chosen
    if chosen in _WINDOW:
        return "glfw"
    if chosen:
        raise OptionError(f"MUJOCO_GL={chosen}: allowed are egl, osmesa and glfw; unset it to have one chosen")
    if sys.platform == "darwin":
        return "cgl"
    if sys.platform != "linux":
        return "glfw"
    # PyOpenGL can speak one kind in a process; PYOPENGL_PLATFORM names it, once any is in use.
    bound = os.environ.get("PYOPENGL_PLATFORM", "").lower()
    if bound in ("", "egl") and egl_devices() > 0:
        return "egl"
    if bound in ("", "osmesa") and has_osmesa():
        return "osmesa"
    if os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"):
        return "glfw"
    raise MissingLibraryError(f"pictures need OpenGL, and this machine has none: {REMEDY}")


def has_osmesa() -> bool:
    """Return whether OSMesa is installed."""
    return _loadable("OSMesa", "libOSMesa.so.8", "libOSMesa.so.6") is not None


@functools.cache
def egl_devices() -> int:
    """Number of EGL devices that can draw without a display; 0 where EGL or a library that it needs is missing."""
    egl = _loadable("EGL", "libEGL.so.1")
    if egl is None or _loadable("OpenGL", "libOpenGL.so.0", "libGL.so.1") is None:
        return 0
    try:
        egl.eglGetProcAddress.restype = ctypes.c_void_p
        egl.eglGetProcAddress.argtypes = [ctypes.c_char_p]
        address = egl.eglGetProcAddress(b"eglQueryDevicesEXT")
        if not address:
            return 0
        prototype = ctypes.CFUNCTYPE(
            ctypes.c_uint, ctypes.c_int, ctypes.POINTER(ctypes.c_void_p), ctypes.POINTER(ctypes.c_int)
        )
        count = ctypes.c_int(0)
        return count.value if prototype(address)(0, None, ctypes.byref(count)) else 0
    except (AttributeError, OSError, ctypes.ArgumentError):
        return 0


class Canvas(contextlib.ExitStack):
    """An off-screen drawing area for one model; a context manager.

    Its OpenGL context is current only while it draws: several can be in use at a time, beside a viewer's.

    Args:
        model: the MjModel whose visual settings apply.
        width, height: size of the buffer [px].

    Raises:
        MissingLibraryError: if OpenGL cannot be opened; the message says why and what to install.
    """

    def __init__(self, model: Any, width: int, height: int) -> None:
        import mujoco

        super().__init__()
        self._mujoco = mujoco
        self._pixels: Image = np.empty((0, 0, 4), np.uint8)
        model.vis.global_.offwidth = width
        model.vis.global_.offheight = height
        self.backend = choose_backend()
        try:
            self._opengl = importlib.import_module(f"mujoco.{self.backend}").GLContext(width, height)
            self.callback(self._opengl.free)
            with self._opengl.as_current():
                self._context = mujoco.MjrContext(model, mujoco.mjtFontScale.mjFONTSCALE_100.value)
                mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN.value, self._context)
            self.callback(self._free)
        except Exception as error:  # a driver or a binding may throw anything: ImportError, GLError, AttributeError
            self.close()
            raise MissingLibraryError(
                f"OpenGL ({self.backend}) cannot be opened ({type(error).__name__}: {error}): {REMEDY}"
            ) from error

    def draw(self, scene: Any, width: int, height: int) -> Image:
        """Draw the MjvScene; returns pixels (height, width, 4), bottom row first, valid until the next call.

        The fourth byte is what OpenGL blends of opacities, 0 where nothing was drawn. The buffer holds all four: read
        without the fourth, as MuJoCo does, they take five times as long.
        """
        from OpenGL.raw.GL.VERSION.GL_1_0 import GL_RGBA, GL_UNSIGNED_BYTE, glReadPixels

        if self._pixels.shape != (height, width, 4):
            self._pixels = np.empty((height, width, 4), np.uint8)
        with self._opengl.as_current():
            self._mujoco.mjr_render(self._mujoco.MjrRect(0, 0, width, height), scene, self._context)
            glReadPixels(0, 0, width, height, GL_RGBA, GL_UNSIGNED_BYTE, ctypes.c_void_p(self._pixels.ctypes.data))
        return self._pixels

    def _free(self) -> None:
        with self._opengl.as_current():
            self._context.free()


def _loadable(name: str, *files: str) -> ctypes.CDLL | None:
    """The shared library, if the loader finds it under one of its names."""
    for candidate in files:
        with contextlib.suppress(OSError):
            return ctypes.CDLL(candidate)
    found = ctypes.util.find_library(name)  # slow: it runs the compiler and the linker
    if found:
        with contextlib.suppress(OSError):
            return ctypes.CDLL(found)
    return None
