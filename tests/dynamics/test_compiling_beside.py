"""Two processes compile each function once, and whatever happens to the second, the first goes on."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from tensegrity_mj.commands.demo import COMPILED_BESIDE
from tensegrity_mj.dynamics.native import beside, compiling

SOURCE = """
import os, sys, time
from tensegrity_mj.dynamics.native.compiling import c_function
if sys.argv[0] == "-c" and "SLEEP" in os.environ:
    time.sleep(60)
@c_function("float64(float64)")
def twice(x):
    return 2.0 * x
@c_function("float64(float64)")
def thrice(x):
    return 3.0 * x
@c_function("float64(float64)")
def squared(x):
    return x * x
"""
HOLD = """
import sys, time
from tensegrity_mj.dynamics.native import beside
import functions_beside
beside._locks.append(int(sys.argv[1]))
with beside.taken(functions_beside.twice):
    print("taken", flush=True)
    time.sleep(float(sys.argv[2]))
    functions_beside.twice.address
"""
NAMES = ["functions_beside:twice", "functions_beside:thrice", "functions_beside:squared"]


@pytest.fixture
def functions(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Any]:
    """A module of three C functions, of which none is kept, in a process that has two cores."""
    (tmp_path / "functions_beside.py").write_text(SOURCE)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "cache"))
    monkeypatch.setattr(os, "sched_getaffinity", lambda process: {0, 1}, raising=False)
    known = list(compiling.c_functions)
    import functions_beside  # type: ignore[import-not-found]

    yield functions_beside
    compiling.c_functions[:] = known
    del sys.modules["functions_beside"]


def values(functions: Any) -> tuple[float, ...]:
    return functions.twice(5.0), functions.thrice(5.0), functions.squared(5.0)


def hits(functions: Any) -> tuple[int, ...]:
    return functions.twice.cache_hits, functions.thrice.cache_hits, functions.squared.cache_hits


def test_the_second_process_compiles_what_the_first_has_not_taken(functions: Any, tmp_path: Path) -> None:
    with beside.second_process(NAMES) as second, beside.taken(functions.twice):
        assert second.wait(60) == 0
    assert values(functions) == (10.0, 15.0, 25.0)
    assert hits(functions) == (0, 1, 1)
    assert len(list((tmp_path / "cache").rglob("*.nbc"))) == 3
    with beside.second_process(NAMES) as second:
        assert second is None  # all are kept


@pytest.mark.parametrize("killed", [False, True], ids=["kept", "killed"])
def test_what_the_other_process_has_taken_is_waited_for(
    functions: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, killed: bool
) -> None:
    locks = os.memfd_create("functions")
    monkeypatch.setattr(beside, "_locks", [locks])
    command = [sys.executable, "-c", HOLD, str(locks), "60" if killed else ".5"]
    environment = os.environ | {"PYTHONPATH": str(tmp_path)}
    with subprocess.Popen(command, env=environment, pass_fds=[locks], stdout=subprocess.PIPE, text=True) as other:
        assert other.stdout is not None
        assert other.stdout.readline() == "taken\n"
        with beside.taken(functions.twice, wait=False) as free:
            assert not free
        if killed:
            other.kill()
        assert functions.twice(5.0) == 10.0
    os.close(locks)
    assert functions.twice.cache_hits == (0 if killed else 1)


@pytest.mark.parametrize("executable", ["/bin/false", "/no/such/python", None])
def test_without_a_second_process_all_is_compiled_here(
    functions: Any, monkeypatch: pytest.MonkeyPatch, executable: str | None
) -> None:
    monkeypatch.setattr(sys, "executable", executable)
    with beside.second_process(NAMES) as second:
        assert (second is None) == (executable != "/bin/false")
        assert values(functions) == (10.0, 15.0, 25.0)
    assert hits(functions) == (0, 0, 0)


def test_the_second_process_ends_with_the_first(functions: Any, tmp_path: Path) -> None:
    script = f"""
import os, sys
sys.argv[0], os.sched_getaffinity = "", lambda process: {{0, 1}}
from tensegrity_mj.dynamics.native import beside
with beside.second_process({NAMES}, heard=True) as second:
    assert second.poll() is None
    os._exit(7)
"""
    environment = os.environ | {"PYTHONPATH": str(tmp_path), "SLEEP": ""}
    # The second process holds this pipe open, for a minute if it lives on.
    done = subprocess.run([sys.executable, "-c", script], env=environment, stderr=subprocess.PIPE, timeout=50)
    assert done.returncode == 7, done.stderr


def test_one_core_has_one_process(functions: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "sched_getaffinity", lambda process: {0})
    with beside.second_process(NAMES) as second:
        assert second is None


def test_the_demo_names_compiled_functions() -> None:
    assert {type(function) for function in beside._named(COMPILED_BESIDE)} == {compiling.CFunction}
