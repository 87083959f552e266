"""Say which OpenGL, ffmpeg and versions work on this machine, and how to mend what does not."""

from __future__ import annotations

import argparse
import os
import platform
import subprocess
import sys
from dataclasses import dataclass
from importlib import metadata

from tensegrity_mj.commands.common import ExitCode, Outcome


def execute(options: argparse.Namespace) -> Outcome:
    """Run every check."""
    from dataclasses import asdict

    checks = examine()
    healthy = all(check.works for check in checks if check.required)
    width = max(len(check.name) for check in checks)
    lines = []
    for check in checks:
        mark = "ok" if check.works else ("MISSING" if check.required else "absent")
        lines.append(f"{mark:<8}{check.name:<{width}}  {check.found}")
        if not check.works:
            lines.append(f"{'':<{width + 10}}needed for {check.needed_for}; {check.remedy}")
    lines.append("Everything needed works." if healthy else "Something needed is missing: see above.")
    data = {"status": "ok" if healthy else "missing", "checks": [asdict(check) for check in checks]}
    return Outcome(data, "\n".join(lines), ExitCode.SUCCESS if healthy else ExitCode.MISSING_LIBRARY)


# Mesa's software renderer is in a package of its own, which libegl-mesa0 does not require everywhere.
OPENGL_PACKAGES = "libegl1 libegl-mesa0 libgl1-mesa-dri libopengl0"


PROBE_TIMEOUT = 60.0  # s; a cold start of MuJoCo on a slow disk takes a few


# Opens OpenGL as the renderer does, then reads its name.
_OPENGL_PROBE = """
import importlib
from tensegrity_mj.errors import TensegrityError
from tensegrity_mj.pictures.opengl import Canvas, choose_backend
try:
    choose_backend()  # MuJoCo cannot be imported where MUJOCO_GL means nothing
    import mujoco
    with Canvas(mujoco.MjModel.from_xml_string("<mujoco/>"), 64, 64) as canvas:
        kind = canvas.backend
except TensegrityError as error:
    raise SystemExit(str(error).replace("\\n", " "))
context = importlib.import_module(f"mujoco.{kind}").GLContext(64, 64)
context.make_current()
from OpenGL import GL
print(f"{kind}: {(GL.glGetString(GL.GL_RENDERER) or b'unnamed').decode()}")
"""


# Imports all that the adapter imports of dm_control, and makes a step.
_DM_CONTROL_PROBE = """
from importlib import metadata
from tensegrity_mj.dm_control import TensegrityEntity, TensegrityTask, physics
from dm_control.mujoco import Physics
Physics.from_xml_string("<mujoco/>").step()
print(f"{metadata.version('dm-control')}, steps a model")
"""


# Compiles a function anew and runs it.
_COMPILER_PROBE = """
import numba
assert numba.njit(lambda x: 2 * x)(21) == 42
print(f"numba {numba.__version__} compiles")
"""


# A process of its own, as a start is: where the cache writes depends on the environment.
_CACHE_PROBE = """
from tensegrity_mj.dynamics.native.kept import cache_folder
print(cache_folder())
"""


@dataclass(frozen=True)
class Check:
    """One finding.

    Attributes:
        name: what was looked at.
        works: whether it does.
        found: what is there, or what went wrong.
        needed_for: what this machine cannot do without it.
        required: whether `doctor` fails where it does not work.
        remedy: how to mend it; empty where it works.
    """

    name: str
    works: bool
    found: str
    needed_for: str
    required: bool = True
    remedy: str = ""


def examine() -> list[Check]:
    """Every check, in the order in which they matter."""
    return [
        check_python(),
        *check_packages(),
        check_dm_control(),
        check_compiler(),
        check_numba_cache(),
        check_opengl(),
        check_ffmpeg(),
        check_display(),
    ]


def check_python() -> Check:
    """Python's version; the package needs 3.11."""
    works = sys.version_info >= (3, 11)
    found = f"{platform.python_version()} ({platform.platform()})"
    return Check("python", works, found, "everything", remedy="" if works else "install Python 3.11 or newer")


def check_packages() -> list[Check]:
    """The versions of the packages that pyproject.toml requires, as installed."""
    from packaging.requirements import Requirement

    try:
        wanted = [Requirement(line) for line in metadata.requires("tensegrity-mj") or []]
    except metadata.PackageNotFoundError:
        remedy = "in the checkout: python -m pip install --editable ."
        return [Check("tensegrity-mj", False, "not installed", "everything", remedy=remedy)]
    # Nothing but its adapter needs dm-control, which pip cannot install everywhere: it has a check of its own.
    wanted = [item for item in wanted if item.name != "dm-control"]
    here = [item for item in wanted if item.marker is None or item.marker.evaluate({"extra": ""})]
    return [check_package(item.name, str(item.specifier)) for item in here]


def check_package(name: str, specifier: str) -> Check:
    """One package: whether it is installed in a version that fits the specifier, such as ">=4.0,<5"."""
    from packaging.specifiers import SpecifierSet

    try:
        version = metadata.version(name)
    except metadata.PackageNotFoundError:
        remedy = f'python -m pip install "{name}{specifier}"'
        return Check(name, False, "not installed", "everything", remedy=remedy)
    if not SpecifierSet(specifier).contains(version, prereleases=True):
        remedy = f'python -m pip install "{name}{specifier}"'
        return Check(name, False, f"{version}, needed: {specifier}", "everything", remedy=remedy)
    return Check(name, True, version, "everything")


def check_dm_control() -> Check:
    """Whether `tensegrity_mj.dm_control` works: dm-control, what it needs, and a step beside this MuJoCo."""
    from tensegrity_mj.basics.dependencies import how_to_install, missing_for_dm_control

    name, needed_for = "dm-control", "tensegrity_mj.dm_control, and nothing else"
    missing = missing_for_dm_control()
    if missing:
        found = f"not installed: {', '.join(missing)}"
        return Check(name, False, found, needed_for, required=False, remedy=how_to_install(missing))
    works, found = _run_probe(_DM_CONTROL_PROBE)
    remedy = "python -m pip install --force-reinstall --no-deps dm-control; if MUJOCO_GL is set, unset it"
    return Check(name, works, found, needed_for, required=False, remedy="" if works else remedy)


def check_compiler() -> Check:
    """Whether numba compiles and runs a function on this processor."""
    works, found = _run_probe(_COMPILER_PROBE)
    remedy = "" if works else "reinstall numba and llvmlite: python -m pip install --force-reinstall numba"
    return Check("compiled laws", works, found, "everything", remedy=remedy)


def check_numba_cache() -> Check:
    """Whether compiled functions can be kept between runs; without it every start compiles again."""
    works, found = _run_probe(_CACHE_PROBE)
    remedy = "" if works else "set NUMBA_CACHE_DIR to a folder that you may write in"
    return Check("numba cache", works, found, "a fast start", required=False, remedy=remedy)


def check_opengl() -> Check:
    """Which OpenGL the renderer finds and opens (see `opengl.choose_backend`)."""
    works, found = _run_probe(_OPENGL_PROBE)
    chosen = os.environ.get("MUJOCO_GL")
    if chosen:
        found = f"{found} (MUJOCO_GL={chosen})"
    remedy = f"on Debian or Ubuntu: apt-get install {OPENGL_PACKAGES}"
    if chosen:
        remedy = f"unset MUJOCO_GL, which allows no other kind than {chosen}; then, {remedy}"
    return Check("off-screen OpenGL", works, found, "video", remedy="" if works else remedy)


def check_ffmpeg() -> Check:
    """Whether there is an ffmpeg that writes H.264."""
    remedy = "python -m pip install --force-reinstall imageio-ffmpeg"
    try:
        import imageio_ffmpeg

        program = imageio_ffmpeg.get_ffmpeg_exe()
        answer = subprocess.run(
            [program, "-hide_banner", "-encoders"], capture_output=True, text=True, timeout=PROBE_TIMEOUT, check=True
        )
    except (ImportError, OSError, RuntimeError, subprocess.SubprocessError) as error:
        return Check("ffmpeg", False, f"{type(error).__name__}: {error}", "video", remedy=remedy)
    if "264" not in answer.stdout:
        remedy = "set IMAGEIO_FFMPEG_EXE to an ffmpeg with H.264, or unset it to use the one that comes along"
        return Check("ffmpeg", False, f"{program} has no encoder for H.264", "video", remedy=remedy)
    return Check("ffmpeg", True, program, "video")


def check_display() -> Check:
    """Whether there is a display for MuJoCo's interactive viewer."""
    remedy = "run where there is a desktop (or ssh -X); files and videos need none"
    if sys.platform != "linux":
        return Check("display", True, sys.platform, "run --view", required=False)
    for name in ("WAYLAND_DISPLAY", "DISPLAY"):
        if os.environ.get(name):
            return Check("display", True, f"{name}={os.environ[name]}", "run --view", required=False)
    found = "neither DISPLAY nor WAYLAND_DISPLAY is set"
    return Check("display", False, found, "run --view", required=False, remedy=remedy)


def _run_probe(code: str) -> tuple[bool, str]:
    """Run Python code in a child process: whether it succeeded, and its last line."""
    try:
        child = subprocess.run(
            [sys.executable, "-c", code],
            capture_output=True,
            text=True,
            timeout=PROBE_TIMEOUT,
            stdin=subprocess.DEVNULL,
        )
    except subprocess.TimeoutExpired:
        return False, f"no answer within {PROBE_TIMEOUT:.0f} s"
    lines = (child.stdout if child.returncode == 0 else child.stderr).strip().splitlines()
    return child.returncode == 0, lines[-1].strip() if lines else f"ended with code {child.returncode}"
