"""Print what the packages that this one requires take on disk (docs/install.md), or what extras add.

.venv/bin/python scripts/weigh.py            # the package itself
.venv/bin/python scripts/weigh.py web data   # what these extras add
"""

from __future__ import annotations

import sys
from importlib import metadata

from packaging.requirements import Requirement


def needed(name: str, extras: set[str], seen: dict[str, set[str]]) -> None:
    """Add a distribution and what it requires, directly or not."""
    key = name.lower().replace("_", "-").replace(".", "-")
    if extras <= seen.get(key, set()) and key in seen:
        return
    seen[key] = seen.get(key, set()) | extras
    try:
        lines = metadata.requires(name) or []
    except metadata.PackageNotFoundError:
        return
    for line in lines:
        item = Requirement(line)
        if item.marker is None or any(item.marker.evaluate({"extra": extra}) for extra in {"", *extras}):
            needed(item.name, set(item.extras), seen)


def size(name: str) -> int:
    """Bytes of a distribution's files, 0 where it is not installed."""
    try:
        files = metadata.files(name) or []
    except metadata.PackageNotFoundError:
        return 0
    return sum(path.stat().st_size for file in files if (path := file.locate()).is_file())


def main(extras: list[str]) -> None:
    """Print the table, the largest first, and the sum."""
    core: dict[str, set[str]] = {}
    needed("tensegrity-mj", set(), core)
    found = core
    if extras:
        found = {}
        needed("tensegrity-mj", set(extras), found)
        found = {name: more for name, more in found.items() if name not in core}
    sizes = {name: size(name) / 1e6 for name in found if name != "tensegrity-mj"}
    for name, most in sorted(sizes.items(), key=lambda item: -item[1]):
        print(f"{name:24} {most:7.1f} MB" if most else f"{name:24} not installed")
    print(f"{len(sizes)} packages, {sum(sizes.values()):.0f} MB")


if __name__ == "__main__":
    main(sys.argv[1:])
