"""Files and command lines made by chance: each is right, or refused with a clear message, and none hangs or crashes.

`fuzzing` makes the cases, each from its number, and says what right is. One process tries them; a case that takes more
than 10 s of the processor, or two minutes of waiting, or all memory, ends that process and fails: a guard against
hanging, not a test of speed. To see one again: python tests/helpers/fuzzing.py NUMBER
"""

from __future__ import annotations

import json
import queue
import subprocess
import sys
import threading
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

import fuzz_cases
import fuzzing
import pytest

WAIT = 120.0  # s without an answer
START = 900.0  # s for the first answer: what is compiled once


def tried(numbers: Sequence[int]) -> list[dict[str, str]]:
    """What came of each case."""
    left, found = list(numbers), []
    while left:
        answers = _served(left)
        found += answers
        if len(answers) == len(left):
            break
        stopped = left[len(answers)]
        if not answers and found and found[-1]["outcome"] == "stopped" and found[-1]["why"] == "at the start":
            pytest.fail("the process that tries cases does not start")
        why = "the process ended, or gave no answer: it hung, crashed or filled memory"
        found.append({"number": str(stopped), "kind": fuzz_cases.kind_of(stopped), "outcome": "stopped", "why": why})
        left = left[len(answers) + 1 :]
    return found


def _served(numbers: Sequence[int]) -> list[dict[str, str]]:
    """The answers of one process, until it ends."""
    lines: queue.Queue[str] = queue.Queue()
    with subprocess.Popen(
        [sys.executable, str(Path(__file__).parents[1] / "helpers" / "fuzzing.py"), "--serve"],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    ) as process:
        assert process.stdin is not None
        assert process.stdout is not None
        reader = threading.Thread(target=_read, args=(process.stdout, lines), daemon=True)
        reader.start()
        process.stdin.write("".join(f"{number}\n" for number in numbers))
        process.stdin.close()
        answers: list[dict[str, str]] = []
        try:
            while line := lines.get(timeout=WAIT if answers else START):
                answers.append(json.loads(line))
        except queue.Empty:
            pass
        process.kill()
    return answers


def _read(pipe: object, lines: queue.Queue[str]) -> None:
    for line in pipe:  # type: ignore[attr-defined]
        lines.put(line)
    lines.put("")


def check(numbers: Sequence[int]) -> None:
    found = tried(numbers)
    wrong = [one for one in found if one["outcome"] not in ("accepted", "refused")]
    reported = "\n\n".join(
        f"case {one['number']} ({one['kind']}), {one['outcome']}: {one['why']}" for one in wrong[:20]
    )
    counts = Counter((one["kind"], one["outcome"]) for one in found)
    print("\n".join(f"{kind:12s}{outcome:12s}{count}" for (kind, outcome), count in sorted(counts.items())))
    assert not wrong, f"{len(wrong)} of {len(found)} cases are neither right nor refused:\n{reported}"
    # Neither everything is broken nor nothing: the grammar does what it is for.
    assert len(found) < 100 or 0.1 < sum(one["outcome"] == "accepted" for one in found) / len(found) < 0.9


def test_some_files_and_commands() -> None:
    check(range(60))


@pytest.mark.study
@pytest.mark.timeout(6 * 3600)
def test_ten_thousand_files_and_commands() -> None:
    check(range(1000, 11_000))


def test_cases_come_from_their_numbers_alone() -> None:
    import random

    for number in range(40):
        for make in (fuzz_cases.scene_bytes, fuzz_cases.text_bytes):
            assert make(random.Random(number)) == make(random.Random(number))


def test_what_must_not_happen_is_seen(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Each check fails on what it is there for."""
    from tensegrity_mj.errors import FormatError
    from tensegrity_mj.library import named

    fuzz_cases.base_run(tmp_path)  # with the functions as they are

    def answer(work: object) -> tuple[str, str]:
        with monkeypatch.context() as patch:
            patch.setattr(named, "load_scene", work)
            return fuzzing.attempt(0, tmp_path)

    def crashes(path: Path) -> None:
        raise KeyError("x")

    def shows(path: Path) -> None:
        error = FormatError("x")
        error.args = ("\x1b[31m",)
        raise error

    def writes(path: Path) -> None:
        (path.parent.parent / "stray").write_text("x")
        raise FormatError("x")

    def leaves(path: Path) -> None:
        (path.parent / ".new-abc.part.nc").write_text("x")
        raise FormatError("x")

    for work, word in (
        (crashes, "KeyError"),
        (shows, "cannot be shown"),
        (writes, "outside its folder"),
        (leaves, "left"),
    ):
        outcome, why = answer(work)
        assert (outcome, word in why) == ("failed", True), why


def test_a_process_that_ends_is_a_case_that_failed(monkeypatch: pytest.MonkeyPatch) -> None:
    calls = []

    def served(numbers: Sequence[int]) -> list[dict[str, str]]:
        calls.append(list(numbers))
        right = {"number": "1", "kind": "scene", "outcome": "refused", "why": ""}
        return [right] if len(calls) == 1 else [right] * len(numbers)

    monkeypatch.setattr(sys.modules[__name__], "_served", served)
    outcomes = [one["outcome"] for one in tried([1, 2, 3])]
    assert outcomes == ["refused", "stopped", "refused"]
    assert calls == [[1, 2, 3], [3]]
    calls.clear()
    with pytest.raises(AssertionError, match="1 of 3 cases"):
        check([1, 2, 3])
