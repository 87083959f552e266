"""Additional requirements of parts of the package, those that are not installed, and entry points of what is.

Most of the former is of `tensegrity_mj.learning.dm_control`. Below Python 3.13 pip installs dm-control with this
package. From 3.13 on it cannot: dm-control requires labmaze, which has no wheel there, and which nothing but
`dm_control.locomotion` imports. There dm-control is installed without its dependencies, and all of these but labmaze,
the extra `dm-control-needs` of pyproject.toml, in addition.
"""

from __future__ import annotations

import csv
import sys
from importlib import import_module, metadata
from importlib.metadata import EntryPoint
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tensegrity_mj.errors import MissingPackageError, OptionError

if TYPE_CHECKING:
    from packaging.requirements import Requirement

EXTRA = "dm-control-needs"
EVIDENCE_MISSING = (
    "comes with tensegrity-mj-evidence: in a checkout, install it with python -m pip install --editable evidence"
)
# Imports whose distributions have other names, hyphens apart.
IMPORTED_AS = {"OpenGL": "PyOpenGL", "PIL": "pillow", "absl": "absl-py", "google": "protobuf"}
IMPORTED_AS |= {"mujoco.mjx": "mujoco-mjx", "tree": "dm-tree", "yaml": "pyyaml"}


def distribution_of(module: str) -> str:
    """Return the name by which pip installs the package of a module, as "pyyaml" for "yaml"."""
    top, inner, _ = f"{module}..".split(".", 2)
    return IMPORTED_AS.get(f"{top}.{inner}") or IMPORTED_AS.get(top, top.replace("_", "-"))


def optional(package: str, what: str, wanted: str = "") -> Any:
    """Import a package that only one call needs; `wanted` is what to install, by default its distribution.

    Raises:
        MissingPackageError: naming that call and the command that installs the package.
    """
    try:
        return import_module(package)
    except ImportError as error:
        raise MissingPackageError(
            f"{what} needs {package}, which cannot be imported ({error}); install it: python -m pip install "
            f"{wanted or distribution_of(package)}"
        ) from None


def _requirements() -> list[Requirement]:
    """Requirements of this package, as its metadata has them; dm-control alone where it is used from its sources."""
    from packaging.requirements import Requirement

    try:
        lines = metadata.requires("tensegrity-mj") or []
    except metadata.PackageNotFoundError:
        lines = ["dm-control"]
    return [Requirement(line) for line in lines]


def requirements_of(extra: str) -> list[Requirement]:
    """The requirements of an extra of this package, as its metadata has them; none where it is not installed."""
    return [item for item in _requirements() if item.marker and f'extra == "{extra}"' in str(item.marker)]


def of_extra(extra: str) -> str:
    """Arguments of `pip install` that bring an extra: its requirements by name, as no index has this package.

    They are the same in a checkout and for an installed package.
    """
    return _quoted([str(item).partition(";")[0].strip() for item in requirements_of(extra)]) or f"'.[{extra}]'"


def unmet(item: Requirement) -> str:
    """Return the reason why no installed package meets a requirement, or ""."""
    try:
        version = metadata.version(item.name)
    except metadata.PackageNotFoundError:
        return "not installed"
    return "" if item.specifier.contains(version, prereleases=True) else f"{version}, needed: {item.specifier}"


def half_removed(item: Requirement) -> list[str]:
    """Distributions whose files are not all there: of an installed requirement, and of what it requires itself.

    pip leaves MuJoCo so where it brings one of 3.x to 4.0, and calls it installed (findings/mujoco_upgrade_by_pip.sh).
    """
    from packaging.requirements import Requirement

    needs = [Requirement(line) for line in metadata.requires(item.name) or []]
    names = [item.name, *(need.name for need in needs if need.marker is None or need.marker.evaluate({"extra": ""}))]
    return [name for name in names if not _is_whole(name)]


def _is_whole(name: str) -> bool:
    try:
        found = metadata.distribution(name)
    except metadata.PackageNotFoundError:
        return False
    # Not `files`: from Python 3.12 on, and before it with importlib_metadata imported, it lists no file that is gone.
    files = [row[0] for row in csv.reader((found.read_text("RECORD") or "").splitlines()) if row]
    return all(Path(str(found.locate_file(file))).exists() for file in files if not file.endswith(".pyc"))


def requirements_of_dm_control() -> list[Requirement]:
    """dm-control and what it needs here, as pyproject.toml names them; dm-control comes last."""
    return [*requirements_of(EXTRA), *(item for item in _requirements() if item.name == "dm-control")]


def missing_for_dm_control() -> list[str]:
    """Requirements of `tensegrity_mj.learning.dm_control`, such as "dm-env", that no installed package meets."""
    return [f"{item.name}{item.specifier}" for item in requirements_of_dm_control() if unmet(item)]


def how_to_install(missing: list[str], python: tuple[int, int] = sys.version_info[:2]) -> str:
    """The commands that install what `missing_for_dm_control` names, in a Python of this version."""
    alone = [name for name in missing if name.startswith("dm-control") and python >= (3, 13)]
    others = [name for name in missing if name not in alone]
    commands = [f"python -m pip install {_quoted(others)}"] if others else []
    if alone:  # with its dependencies pip would look for labmaze
        commands.append(f"python -m pip install --no-deps {_quoted(alone)}")
    return " && ".join(commands)


def require_dm_control() -> None:
    """Check that `tensegrity_mj.learning.dm_control` can work.

    Raises:
        MissingPackageError: naming the packages that are not installed, and the commands that install them.
    """
    missing = missing_for_dm_control()
    if not missing:
        return
    raise MissingPackageError(
        f"tensegrity_mj.learning.dm_control needs packages that are not installed: {', '.join(missing)}; install them: "
        f"{how_to_install(missing)} (all else of tensegrity_mj works without them; docs/dm_control.md has the reason)"
    )


def _quoted(names: list[str]) -> str:
    return " ".join(f'"{name}"' for name in names)


def installed(group: str) -> dict[str, EntryPoint]:
    """The entry points of installed packages by their names, in the group `tensegrity_mj.` + elements, laws, ...

    Nothing is imported. Files name these by their names alone, so that a file runs no code that its reader has not
    installed.
    """
    from importlib.metadata import entry_points

    return {point.name: point for point in entry_points(group=f"tensegrity_mj.{group}")}


def load(point: EntryPoint) -> Any:
    """Import the object that an entry point names.

    Raises:
        OptionError: if its package cannot be imported, or has no such name.
    """
    try:
        return point.load()
    except Exception as error:
        owner = f" of package '{point.dist.name}'" if point.dist is not None else ""
        raise OptionError(
            f"entry point '{point.name}' of '{point.group}'{owner}: {point.value} cannot be loaded "
            f"({type(error).__name__}: {error}); repair the package that has it, or remove it"
        ) from error
