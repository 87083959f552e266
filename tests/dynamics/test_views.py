"""Tables of named fields, and views of them in compiled code."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from tensegrity_mj.dynamics.native.compiling import njit
from tensegrity_mj.dynamics.native.views import Table, changing_view, fields_of, view_of

Fixed, pack_fixed = view_of("TestFixed", steps="state", factor="real", rows=("f8", "count", 2))
FIELDS = fields_of(steps="state", factor="real", rows=("f8", "count", 2))
Changing = changing_view("TestChanging", FIELDS)


def table() -> Table:
    made = Table("test", FIELDS)
    made.set(rows=np.arange(6.0).reshape(3, 2), count=3, steps=2, factor=0.5)  # the size first, whatever the order
    return made


@njit
def advance(address: int) -> float:
    own = Changing(address)
    total = 0.0
    for k in range(own.count):
        total += own.factor * own.rows[k, 1]
    own.steps += 1
    own.factor = total
    return total


@njit
def advance_fixed(address: int) -> float:
    own = Fixed(address)
    own.steps += 1
    own.factor *= 2.0
    return own.rows[own.count - 1, 1]


@njit
def elsewhere(address: int, other: Any) -> float:
    own = Changing(address)
    before = own.rows[0, 0]
    own.rows = other
    return before + 10.0 * own.rows[0, 0]


def test_compiled_code_reads_fields_and_writes_states_and_reals() -> None:
    made = table()
    assert advance(made.address) == 0.5 * (1 + 3 + 5)
    assert (made["count"], made["steps"], made["factor"]) == (3, 3, 4.5)
    fixed = pack_fixed(count=3, steps=0, factor=1.5, rows=np.arange(6).reshape(3, 2))
    assert advance_fixed(fixed.address) == 5.0
    assert (fixed["steps"], fixed["factor"]) == (1, 3.0)


def test_sizes_are_those_of_the_arrays_unless_given_and_then_must_agree() -> None:
    packed = pack_fixed(steps=0, factor=1.5, rows=np.arange(8).reshape(4, 2))
    assert packed["count"] == 4
    assert advance_fixed(packed.address) == 7.0
    with pytest.raises(AssertionError, match=r"rows is float64 \(4, 2\), not float64 \(3, 2\)"):
        pack_fixed(count=3, steps=0, factor=1.5, rows=np.arange(8).reshape(4, 2))
    with pytest.raises(AssertionError, match="given"):
        pack_fixed(steps=0, rows=np.arange(8).reshape(4, 2))


def test_a_size_stands_in_front_of_its_first_array_and_fields_behind_others_leave_these_where_they_are() -> None:
    more = fields_of(FIELDS, other="size", places=("f8", "node_count", "count"), of=("i8", "node_count"))
    assert [name for name, _ in FIELDS] == ["steps", "factor", "count", "rows"]
    assert more[:4] == FIELDS
    assert [name for name, _ in more[4:]] == ["other", "node_count", "places", "of"]


def test_an_address_may_be_given_as_what_is_there() -> None:
    made, within, numbers = Table("test", fields_of(table="size", room="state")), table(), np.arange(3.0)
    made.set(table=within, room=numbers)
    assert made["table"] == within.address
    assert made["room"] == numbers.ctypes.data
    assert made.arrays["table"] is within  # kept alive
    assert made.arrays["room"] is numbers


def test_an_array_of_a_changing_view_is_found_where_it_was_put_last() -> None:
    made, other = table(), np.full((3, 2), 7.0)
    assert elsewhere(made.address, other) == 70.0
    made["rows"] = np.full((3, 2), 2.0)
    assert elsewhere(made.address, other) == 72.0
    assert np.array_equal(made["rows"], np.full((3, 2), 2.0))


@pytest.mark.parametrize("rows", [np.zeros((2, 2)), np.zeros((3, 2), int), np.zeros(6), np.zeros((2, 3)).T])
def test_an_array_of_another_kind_is_no_field(rows: Any) -> None:
    with pytest.raises(AssertionError):
        table()["rows"] = rows


def test_a_field_that_there_is_not_is_an_error() -> None:
    with pytest.raises(KeyError):
        table()["rate"] = 1.0
    with pytest.raises(AssertionError, match="given"):
        pack_fixed(count=3)
