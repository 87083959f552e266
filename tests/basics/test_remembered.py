"""Values remembered by the object that they were made of."""

from __future__ import annotations

import gc
from typing import Any

import pytest

from tensegrity_mj.basics.remembered import MOST, Remembered, once


class Owner:
    """Without a hash, as scenes are."""

    __hash__ = None  # type: ignore[assignment]

    def __eq__(self, other: object) -> bool:
        return True


def test_a_value_is_made_once_an_owner_and_key() -> None:
    kept, made = Remembered(), list[Any]()
    first, second = Owner(), Owner()  # equal, and not the same

    def make(value: str) -> str:
        made.append(value)
        return value

    for _ in range(2):
        assert kept.get(first, "a", lambda: make("first a")) == "first a"
        assert kept.get(first, "b", lambda: make("first b")) == "first b"
        assert kept.get(second, "a", lambda: make("second a")) == "second a"
    assert made == ["first a", "first b", "second a"]


def test_it_is_forgotten_with_its_owner_and_beyond_a_few_keys() -> None:
    kept = Remembered()
    owner = Owner()
    for key in range(MOST + 1):
        kept.get(owner, key, lambda: "old")
    assert kept.get(owner, MOST, lambda: "new") == "old"
    assert kept.get(owner, 0, lambda: "new") == "new"  # the first one made way
    assert len(kept) == 1
    del owner
    gc.collect()
    assert len(kept) == 0


def test_what_fails_is_not_remembered() -> None:
    kept, owner = Remembered(), Owner()
    with pytest.raises(ZeroDivisionError):
        kept.get(owner, 0, lambda: 1 / 0)
    assert kept.get(owner, 0, lambda: 1.0) == 1.0


def test_a_function_is_called_once_for_each_object() -> None:
    made: list[Owner] = []

    @once
    def count(owner: Owner) -> int:
        made.append(owner)
        return len(made)

    first, second = Owner(), Owner()
    assert [count(one) for one in (first, second, first, second)] == [1, 2, 1, 2]
