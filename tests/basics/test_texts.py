"""Texts that come from files: as names of files, in messages. Figures are in test_plots_of_any_text.py."""

from __future__ import annotations

import os
import pickle
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tensegrity_mj.basics import texts
from tensegrity_mj.basics.texts import MOST_BYTES, file_name
from tensegrity_mj.errors import (
    MOST_LETTERS,
    DivergenceError,
    FormatError,
    TensegrityError,
    printable,
    printable_message,
)

fair = settings(derandomize=True, max_examples=150, deadline=None)
HOSTILE = st.sampled_from(
    ["/", "\\", "..", ".", "\0", "\n", "\x1b[31m", "~", "$HOME", "con", "NUL", "-", " ", "é", "x" * 90]
)
any_text = st.text(max_size=80) | st.lists(HOSTILE, max_size=6).map("".join)


@pytest.mark.parametrize(
    "name", ["prism", "my scene", "tbar_2", "a.b-c", "日本", "tower(stages=10)", "déjà", "x" * MOST_BYTES]
)
def test_harmless_names_stay_as_they_are(name: str) -> None:
    assert file_name(name) == name


@fair
@given(any_text)
def test_any_text_gives_one_name_inside_its_folder(text: str) -> None:
    folder = Path("/somewhere/out")
    name = file_name(text)
    path = folder / f"{name}-mujoco.nc"
    assert path.parent == folder
    assert Path(os.path.normpath(path)).parent == folder
    assert Path(os.path.normpath(folder / name)).parent == folder  # as a folder of its own, too
    assert name.isprintable()
    assert name[0] not in ".- "
    assert len(name.encode()) <= MOST_BYTES
    assert not set(name) & set('/\\:*?"<>|\0')
    assert file_name(name) == name


@fair
@given(any_text, any_text)
def test_texts_that_differ_give_names_that_differ(one: str, other: str) -> None:
    # But for texts made to: a name that has another's mark. 32 bits of a hash are none against an adversary.
    assert (file_name(one) == file_name(other)) == (one == other) or file_name(one) in (one, other)


@pytest.mark.parametrize("device", ["con", "NUL", "aux.txt", "Com1", "LPT9.tar.gz", "prn "])
def test_names_of_devices_are_changed(device: str) -> None:
    assert file_name(device).startswith("_")


def test_names_that_differ_in_what_is_replaced_differ() -> None:
    found = {file_name(name) for name in ("a/b", "a\\b", "a:b", "a_b", "a\nb", "../a/b", "", ".", "..")}
    assert len(found) == 9


def test_control_characters_are_written_out() -> None:
    assert printable("\x1b[31mred\x07\x9b\u202e\n") == "\\x1b[31mred\\x07\\x9b\\u202e\\n"
    assert printable("two\nlines\t", keep="\n") == "two\nlines\\t"
    assert printable("σ = 0.5, ‖b‖², 日本") == "σ = 0.5, ‖b‖², 日本"


@pytest.mark.parametrize("kind", [FormatError, TensegrityError, lambda text: DivergenceError(text, 0.5)])
def test_every_error_is_a_line_of_printable_characters_and_not_long(kind: object) -> None:
    assert callable(kind)
    error = kind("file.toml: \x1b[2J\nkey " + "x" * 10**6 + ": use another")
    shown = str(error)
    assert shown.isprintable()
    assert len(shown) <= MOST_LETTERS
    assert shown.startswith("file.toml: \\x1b[2J\\nkey xxx")
    assert shown.endswith("xxx: use another")


@fair
@given(st.text(max_size=2000))
def test_messages_of_messages_are_the_same(text: str) -> None:
    once = printable_message(text)
    assert len(once) <= MOST_LETTERS
    assert printable_message(once) == once
    assert str(FormatError(str(FormatError(text)))) == once


def test_errors_travel_between_processes() -> None:
    error = pickle.loads(pickle.dumps(FormatError("a\x07b")))
    assert str(error) == "a\\x07b"


def test_text_for_figures_has_no_formula_and_stays_visible() -> None:
    assert texts.figure_text("cost $\\frac{$") == "cost \\$\\frac{\\$"
    assert not texts.figure_text("_hidden").startswith("_")
    assert len(texts.figure_text("y" * 10**5)) == 120
