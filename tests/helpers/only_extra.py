"""An environment for a process that sees the package, what it requires, and one of its extras, and nothing else."""

from __future__ import annotations

import os
import re
from importlib.metadata import PackageNotFoundError, packages_distributions, requires
from pathlib import Path

from packaging.requirements import Requirement

# Run by Python at its start: whatever was installed for other reasons is not there.
SITE = """
import gc, importlib.abc, sys

gc.set_threshold(100_000, 20, 20)  # of a site's pages a fifth of the time is a search for garbage

HIDDEN = {hidden!r}

class Hide(importlib.abc.MetaPathFinder):
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in HIDDEN:
            raise ModuleNotFoundError(f"No module named {{name!r}}", name=name)

sys.meta_path.insert(0, Hide())
"""


def only_extra(folder: Path, extra: str) -> dict[str, str]:
    """The environment of a process that imports only what `pip install tensegrity-mj[extra]` would bring.

    Args:
        folder: an empty folder, for the hook that hides the rest.
        extra: one of the extras of pyproject.toml.
    """
    kept = _closure("tensegrity-mj", extra) | {"tensegrity-mj-evidence"}  # which scripts/setup.sh installs beside it
    hidden = {
        module for module, homes in packages_distributions().items() if not any(_normal(home) in kept for home in homes)
    }
    (folder / "sitecustomize.py").write_text(SITE.format(hidden=hidden), encoding="utf-8")
    paths = [str(folder), *filter(None, [os.environ.get("PYTHONPATH")])]
    return {**os.environ, "PYTHONPATH": os.pathsep.join(paths)}


def _normal(name: str) -> str:
    return re.sub(r"[-_.]+", "-", name).lower()


def _closure(name: str, extra: str = "") -> set[str]:
    """The distributions that are installed with one, itself included."""
    found: set[str] = set()
    todo = [(_normal(name), extra)]
    while todo:
        one = todo.pop()
        if one in found:
            continue
        found.add(one)
        try:
            listed = requires(one[0]) or []
        except PackageNotFoundError:  # required elsewhere only, or optional here
            continue
        for requirement in map(Requirement, listed):
            if requirement.marker is None or requirement.marker.evaluate({"extra": one[1]}):
                todo += [(_normal(requirement.name), part) for part in ("", *requirement.extras)]
    return {distribution for distribution, _ in found}
