"""The face of a package: the names that a user meets there, each imported when it is first used.

    if TYPE_CHECKING:
        from tensegrity_mj.model.scene import Scene as Scene
    else:
        __getattr__, __dir__ = face(__name__)

So a name stands once, as the import that type checkers and editors read, and importing the package costs next to
nothing.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Callable
from functools import cache
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any


def face(
    package: str, before: Callable[[], object] | None = None
) -> tuple[Callable[[str], Any], Callable[[], list[str]]]:
    """`__getattr__` and `__dir__` of a package with the names that it imports under `if TYPE_CHECKING`.

    `before` is called before any of them is imported. `__all__` and `dir` have these names, and those that the package
    imports at once by the same form, `import name as name`.
    """

    @cache
    def homes() -> dict[str, str]:
        source = Path(str(sys.modules[package].__file__)).read_text(encoding="utf-8")
        return {name: home for home, name in re.findall(r"^ *from (\S+) import (\w+) as \2$", source, re.MULTILINE)}

    def get(name: str) -> Any:
        if name == "__all__":
            return listed()
        if name.startswith("__") or name not in homes():
            raise AttributeError(_unknown(package, name, listed), name=name, obj=sys.modules[package])
        if before is not None:
            before()
        home = homes()[name]
        # A module of the package, or a name of one.
        value = import_module(f"{package}.{name}") if home == package else getattr(import_module(home), name)
        setattr(sys.modules[package], name, value)
        return value

    def listed() -> list[str]:
        return sorted(homes())

    return get, listed


def _unknown(package: str, name: str, listed: Callable[[], list[str]]) -> str:
    message = f"module '{package}' has no attribute '{name}'"
    if name.startswith("__"):  # Python looks for many such names, and reads no message
        return message
    if find_spec(f"{package}.{name}"):  # and here before it imports a module, which no search may slow down
        return f"{message} yet; import {package}.{name}"
    if home := _elsewhere(package, name):
        return f"{message}; it is {home}.{name}"
    from tensegrity_mj.basics.texts import closest

    return f"{message}{closest(name, listed())}; it has {', '.join(listed())}"


def _elsewhere(package: str, name: str) -> str:
    """The room or module inside a package that lists or defines a name, or ""; nothing is imported."""
    has = re.compile(rf"^(class {name}\b|def {name}\(|    from [\w.]+ import {name} as {name}$)", re.MULTILINE)
    for folder in map(Path, [] if name.startswith("_") else sys.modules[package].__path__):
        for source in sorted([*folder.glob("*.py"), *folder.glob("*/__init__.py")]):
            if has.search(source.read_text(encoding="utf-8")):
                return f"{package}.{source.stem if source.parent == folder else source.parent.name}"
    return ""
