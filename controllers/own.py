"""User-defined laws, named by "path.py:name", "module:name" or an entry point of `tensegrity_mj.laws`.

The name may be of the law itself, a function (time, nodes, velocities, ...) or a callable object; or of its maker,
a class, or a function with one or two required arguments, the first of which is the scene. Further arguments of a
function or a class are options of the law, of the types in their annotations.
"""

from __future__ import annotations

import functools
import hashlib
import importlib
import inspect
import json
import sys
import traceback
import types
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from tensegrity_mj.basics.hints import fitted, hints_of
from tensegrity_mj.basics.texts import closest, unknown, value_text
from tensegrity_mj.errors import OptionError, TensegrityError

Spec = dict[str, Any]  # a law as plain values: see `specs`
_MODULE = "tensegrity_mj_law_"  # what modules made of a file's text are called, before their digest
_LAW = "a function (time, nodes, velocities) -> u, or an object that is called so"


@dataclass(frozen=True)
class OwnLaw:
    """A user-defined law, or the function or class that makes it.

    Attributes:
        title: its name in messages.
        found: the object found under its name.
    """

    title: str
    found: Any

    def __post_init__(self) -> None:
        if not callable(self.found):
            raise OptionError(
                f"law {self.title} = {value_text(self.found)}: it must be {_LAW}; or a function or class of the scene "
                "that makes one"
            )

    @cached_property
    def _parameters(self) -> list[inspect.Parameter]:
        try:
            return list(inspect.signature(self.found).parameters.values())
        except (TypeError, ValueError):  # of compiled code
            return []

    @cached_property
    def _needed(self) -> int:
        """Number of positional arguments without a default."""
        places = (inspect.Parameter.POSITIONAL_ONLY, inspect.Parameter.POSITIONAL_OR_KEYWORD)
        return sum(one.kind in places and one.default is one.empty for one in self._parameters)

    @property
    def makes(self) -> bool:
        """True where calling it makes the law; false where it is the law."""
        return isinstance(self.found, type) or (self._needed in (1, 2) and not hasattr(self.found, "native"))

    @cached_property
    def options(self) -> dict[str, inspect.Parameter]:
        """The arguments that are options of the law, by name."""
        own = min(self._needed, 1) if self.makes else 3
        if not self.makes and not inspect.isfunction(self.found):
            return {}  # an object, which has been made with its options
        named = (inspect.Parameter.POSITIONAL_OR_KEYWORD, inspect.Parameter.KEYWORD_ONLY)
        return {one.name: one for one in self._parameters[own:] if one.kind in named}

    @property
    def takes_any(self) -> bool:
        """True where it takes options of any name."""
        return any(one.kind is one.VAR_KEYWORD for one in self._parameters)

    def usual(self) -> dict[str, Any]:
        """The defaults of its options, by name."""
        return {name: one.default for name, one in self.options.items() if one.default is not one.empty}

    def check(self, option: str) -> None:
        """Raise OptionError unless it has an option of that name."""
        if option not in self.options and not self.takes_any:
            if self.options:
                raise OptionError(f"law {self.title}: {unknown(option, self.options, 'option')}")
            made = "" if inspect.isfunction(self.found) or self.makes else ", which is an object that has been made"
            raise OptionError(f"law {self.title}: there is no option '{option}': it takes none{made}; leave it out")

    def make(self, scene: Any, options: Mapping[str, Any]) -> Any:
        """The law for a scene.

        Raises:
            OptionError: for options that it does not have or that are of another type, one that is missing, and where
                it fails or makes no law.
            TensegrityError: what it raises itself.
        """
        values = self._read(options)
        if not self.makes:
            return self.found if not values else _with_options(self.found, values)
        try:
            law = self.found(*[scene][: self._needed], **values)
        except TensegrityError:
            raise
        except (Exception, SystemExit) as error:
            raise OptionError(f"law {self.title}: it fails where it is made: {_failure(error)}") from error
        if isinstance(law, type) or not callable(law):
            raise OptionError(f"law {self.title}: it made {value_text(law)}; it must return a law: {_LAW}")
        return law

    def _read(self, options: Mapping[str, Any]) -> dict[str, Any]:
        values = {}
        for name, value in options.items():
            self.check(name)
            values[name] = fitted(f"law {self.title}: {name}", value, self._hints.get(name))
        for name, one in self.options.items():
            if one.default is one.empty and name not in values:
                raise OptionError(f"law {self.title}: option '{name}' is missing; it needs a value")
        return values

    @cached_property
    def _hints(self) -> dict[str, Any]:
        return hints_of(self.found)


def is_own(text: str) -> bool:
    """Return whether a text names a user-defined law, in a file or a module."""
    return ":" in text or text.endswith(".py")


def named(text: str) -> Spec:
    """Describe a user-defined law by plain values, from "module:name" or "path.py:name".

    For a file, its text is one of them: workers run the text that was read, and a changed file is another law.

    Raises:
        OptionError: if it is no such text, or there is no such file or module.
    """
    place, colon, name = text.rpartition(":")
    if text.endswith(".py") and not text.endswith(":.py"):
        raise OptionError(f"law {text}: name the law in that file, too: {text}:name")
    if not colon or not place or not name.isidentifier():
        raise OptionError(f"law = {text!r}: write module:name or path.py:name for a law of your own")
    if not place.endswith(".py"):
        module = imported(place)
        return {"kind": "module", "module": place, "name": name, "options": {}, **digest_of(module)}
    path = Path(place)
    if not path.is_file():
        folder = path.parent
        near = closest(path.name, [one.name for one in folder.glob("*.py")]) if folder.is_dir() else ""
        raise OptionError(f"law {text}: there is no file {path.name}{near} in {folder.resolve()}; give its path")
    try:
        source = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise OptionError(f"law {text}: the file cannot be read ({error}); it must be a text in UTF-8") from error
    return {
        "kind": "file",
        "file": path.name,
        "folder": str(path.resolve().parent),
        "source": source,
        "sha256": hashlib.sha256(source.encode()).hexdigest(),
        "name": name,
        "options": {},
    }


def found(spec: Mapping[str, Any]) -> OwnLaw:
    """Import the law that `named` has named.

    Raises:
        OptionError: if its file fails, its module cannot be imported, or it has no such name.
    """
    module = _of_text(spec) if spec["kind"] == "file" else imported(spec["module"])
    name, title = spec["name"], title_of(spec)
    if not hasattr(module, name):
        own = [key for key, one in vars(module).items() if callable(one) and one.__module__ == module.__name__]
        raise OptionError(f"law {title}: {unknown(name, own, 'law') if own else 'there is no law in it'}")
    return OwnLaw(title, getattr(module, name))


def title_of(spec: Mapping[str, Any]) -> str:
    """Return the law's name for messages."""
    return f"{spec.get('file') or spec.get('module')}:{spec['name']}"


def imported(name: str) -> types.ModuleType:
    """A module by its name, or OptionError."""
    try:
        return importlib.import_module(name)
    except Exception as error:
        raise OptionError(
            f"law: module '{name}' cannot be imported ({type(error).__name__}: {error}); install it, or write "
            "path.py:name"
        ) from error


def digest_of(module: types.ModuleType) -> dict[str, str]:
    """The digest of a module's source, by which a study knows that a law has changed; nothing where it has none."""
    path = Path(getattr(module, "__file__", None) or "")
    return {"sha256": hashlib.sha256(path.read_bytes()).hexdigest()} if path.is_file() else {}


def is_of_text(module: str) -> bool:
    """Return whether a module was made from a file's text, so that no other process can import it."""
    return module.startswith(_MODULE)


def _of_text(spec: Mapping[str, Any]) -> types.ModuleType:
    """The module that a file's text makes; its folder can be imported from, as for a script."""
    called = _MODULE + spec["sha256"]
    if called not in sys.modules:
        module = types.ModuleType(called)
        module.__file__ = str(Path(spec["folder"]) / spec["file"])
        if spec["folder"] not in sys.path:
            sys.path.append(spec["folder"])
        sys.modules[called] = module  # dataclasses look for their module there
        try:
            exec(compile(spec["source"], module.__file__, "exec"), module.__dict__)
        except (Exception, SystemExit) as error:
            del sys.modules[called]
            raise OptionError(f"law {title_of(spec)}: the file fails: {_failure(error)}") from error
    return sys.modules[called]


def _failure(error: Exception | SystemExit) -> str:
    """An exception with the line of the user's code that raised it."""
    if isinstance(error, SyntaxError):
        return f"{type(error).__name__}: {error}"
    place = traceback.extract_tb(error.__traceback__)[-1]
    return f"{type(error).__name__}: {error} ({Path(place.filename).name}, line {place.lineno})"


def _with_options(law: Any, values: dict[str, Any]) -> Any:
    """A function with its options, which says so in the provenance of a run."""
    bound: Any = functools.update_wrapper(functools.partial(law, **values), law)
    if not hasattr(law, "describe"):
        shown = json.loads(json.dumps(values, default=lambda value: getattr(value, "value", str(value))))
        bound.describe = lambda: {"law": law.__name__, "options": shown}
    return bound
