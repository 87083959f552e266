"""Say which OpenGL, ffmpeg and versions work on this machine, and how to mend what does not."""

from __future__ import annotations

import argparse
import os
import platform
import subprocess
import sys
from dataclasses import asdict, dataclass, replace
from importlib import metadata
from typing import TYPE_CHECKING

from tensegrity_mj.basics import dependencies
from tensegrity_mj.basics.files import table_beside
from tensegrity_mj.commands.common import ExitCode, Outcome

if TYPE_CHECKING:
    from packaging.requirements import Requirement


def execute(options: argparse.Namespace) -> Outcome:
    """Run every check."""
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


TABLE = table_beside(__file__)
CHECKS, EXTRAS = TABLE["checks"], TABLE["extras"]
PROBE_TIMEOUT = 60.0  # s; a cold start of MuJoCo on a slow disk takes a few


@dataclass(frozen=True)
class Check:
    """One finding.

    Attributes:
        name: what was looked at.
        works: whether it does.
        found: the version or device found, or what went wrong.
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
        probed("jax"),
        *check_extras(),
        probed("compiler"),
        probed("cache"),
        check_opengl(),
        probed("ffmpeg"),
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
    return [check_package(item) for item in here]


def check_package(item: Requirement) -> Check:
    """One package: whether it is installed in a version that is required, such as "mujoco>=4.0,<5"."""
    if found := dependencies.unmet(item):
        remedy = f'python -m pip install "{item.name}{item.specifier}"'
        return Check(item.name, False, found, "everything", remedy=remedy)
    version = metadata.version(item.name)
    if gone := dependencies.half_removed(item):
        remedy = f"python -m pip install --force-reinstall --no-deps {' '.join(dict.fromkeys([*gone, item.name]))}"
        return Check(item.name, False, f"{version}, without files of {', '.join(gone)}", "everything", remedy=remedy)
    return Check(item.name, True, version, "everything")


def check_extras() -> list[Check]:
    """Check that the packages of each extra of `EXTRAS` are installed."""
    found = []
    for extra, needed_for in EXTRAS.items():
        items = dependencies.requirements_of(extra)
        absent = [f"{item.name}: {why}" for item in items if (why := dependencies.unmet(item))]
        here = ", ".join(absent or [f"{item.name} {metadata.version(item.name)}" for item in items])
        remedy = f"python -m pip install {dependencies.of_extra(extra)}" if absent or not items else ""
        found.append(Check(f"extra {extra}", not remedy, here or "unknown", needed_for, required=False, remedy=remedy))
    return found


def check_dm_control() -> Check:
    """Check that `tensegrity_mj.learning.dm_control` works: dm-control, its needs, and a step with this MuJoCo."""
    missing = dependencies.missing_for_dm_control()
    if not missing:
        return probed("dm_control")
    name, needed_for = CHECKS["dm_control"]["name"], CHECKS["dm_control"]["needed_for"]
    found = f"not installed: {', '.join(missing)}"
    return Check(name, False, found, needed_for, required=False, remedy=dependencies.how_to_install(missing))


def check_opengl() -> Check:
    """Check which OpenGL the renderer finds and opens (see `opengl.choose_backend`)."""
    check, chosen = probed("opengl"), os.environ.get("MUJOCO_GL")
    if not chosen:
        return check
    remedy = f"unset MUJOCO_GL, which allows no other kind than {chosen}; then, {check.remedy}"
    return replace(check, found=f"{check.found} (MUJOCO_GL={chosen})", remedy="" if check.works else remedy)


def check_display() -> Check:
    """Check for a display for MuJoCo's interactive viewer."""
    names = ("WAYLAND_DISPLAY", "DISPLAY")
    found = next((f"{name}={os.environ[name]}" for name in names if os.environ.get(name)), "")
    found = found if sys.platform == "linux" else sys.platform
    remedy = "" if found else "run where there is a desktop (or ssh -X); files and videos need none"
    missing = "neither DISPLAY nor WAYLAND_DISPLAY is set"
    return Check("display", bool(found), found or missing, "view, run --view", required=False, remedy=remedy)


def probed(key: str) -> Check:
    """Run the probe of a row of `CHECKS`, and return what it finds."""
    row = CHECKS[key]
    works, found = _run_probe(row["probe"])
    remedy = f"python -m pip install {dependencies.of_extra(row['extra'])}" if "extra" in row else row["remedy"]
    remedy = "" if works else remedy
    return Check(row["name"], works, found, row["needed_for"], row.get("required", True), remedy)


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
