"""Cache of results made from objects that never change, kept as long as the object lives."""

from __future__ import annotations

import functools
import weakref
from collections.abc import Callable, Hashable
from typing import Any, TypeVar

T = TypeVar("T")
MOST = 4  # values an owner: those made last


class Remembered:
    """Values by owner and key. Owners are distinguished by identity: they need no hash, but must not change."""

    def __init__(self) -> None:
        self._entries: dict[int, tuple[weakref.ref[Any], dict[Hashable, Any]]] = {}

    def get(self, owner: Any, key: Hashable, make: Callable[[], Any]) -> Any:
        """The value of a key, made where it is not remembered; what `make` raises is raised, and nothing kept."""
        number = id(owner)
        entry = self._entries.get(number)
        if entry is None or entry[0]() is not owner:
            entry = weakref.ref(owner, lambda _: self._entries.pop(number, None)), {}
            self._entries[number] = entry
        values = entry[1]
        found = values.get(key, values)  # itself where there is none; other threads may take values out at any time
        if found is values:
            found = make()
            while len(values) >= MOST:
                values.pop(next(iter(list(values))), None)
            values[key] = found
        return found

    def __len__(self) -> int:
        return len(self._entries)


def once(make: Callable[[Any], T]) -> Callable[[Any], T]:
    """Decorate a function of an object that never changes: it is called once for each, and its value is shared."""
    values = Remembered()

    @functools.wraps(make)
    def value_of(owner: Any) -> T:
        found: T = values.get(owner, None, lambda: make(owner))
        return found

    return value_of
