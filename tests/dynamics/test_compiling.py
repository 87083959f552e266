"""Compiled functions are kept between runs, and never outlive what they were made of."""

from __future__ import annotations

import ast
import ctypes
import os
import re
import subprocess
import sys
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from forking import Forks, forks

from tensegrity_mj.dynamics.native import digests
from tensegrity_mj.dynamics.native.strings import add_string_forces

ROOT = Path(__file__).resolve().parents[2]

Answers = Callable[..., tuple[float, ...]]

FILES = {
    "caller.py": """
from callee import twice
import numbers_of
from tensegrity_mj.dynamics.native.compiling import c_function, compiled, njit

@njit
def answer(x, table):
    return twice(x) + numbers_of.PLAIN + table[0].second

@c_function("float64(float64)")
def by_address(x):
    return twice(x)
""",
    "callee.py": """
from deeper import scaled
from tensegrity_mj.dynamics.native.compiling import njit

@njit
def twice(x):
    return 2.0 * scaled(x)
""",
    "deeper.py": """
from numbers_of import FACTOR
from tensegrity_mj.dynamics.native.compiling import njit

@njit
def scaled(x):
    return FACTOR * x
""",
    "numbers_of.py": """
import numpy as np
FACTOR = 10.0
PLAIN = 0.25
RECORD = np.dtype([("first", float), ("second", float)])
""",
    "evaluate.py": """
import numpy as np
from caller import answer, by_address
from numbers_of import RECORD
table = np.zeros(1, RECORD)
table["second"] = 0.5
first, second = answer(1.0, table), by_address.ctypes(1.0)
print(first, second, sum(answer.dispatcher.stats.cache_hits.values()), by_address.cache_hits)
""",
}


# Half of the time of a process is to import numba and to compile a first function.
IMPORTED = """
import numba
import tensegrity_mj as tmj
from tensegrity_mj.dynamics.native import compiling
tmj.controllers.CompiledLaw, tmj.load_scene("prism"), numba.njit(lambda x: x + 1.0)(1.0)
"""


@pytest.fixture(scope="module")
def processes() -> Iterator[Forks]:
    with forks(IMPORTED, without=("NUMBA_", "XDG_")) as found:
        yield found


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Four files of compiled functions, and a script that calls them."""
    for name, content in FILES.items():
        (tmp_path / name).write_text(content)
    return tmp_path


@pytest.fixture
def answers(processes: Forks) -> Answers:
    """Numbers that evaluate.py of a folder prints in a process of its own."""
    return lambda folder, **environment: tuple(
        map(float, processes.run(folder, "evaluate.py", **environment)[0].split())
    )


def edit(path: Path, old: str, new: str) -> None:
    text = path.read_text()
    assert text.count(old) == 1
    path.write_text(text.replace(old, new))


def test_a_change_of_what_is_called_reaches_the_caller(folder: Path, answers: Answers) -> None:
    """Whatever a caller takes from other files; and what changes nothing costs no compiling."""
    assert answers(folder) == (20.75, 20.0, 0, 0)
    edit(folder / "callee.py", "2.0 * scaled", "3.0 * scaled")
    assert answers(folder) == (30.75, 30.0, 0, 0)
    edit(folder / "deeper.py", "FACTOR * x", "FACTOR * x + 1.0")
    assert answers(folder) == (33.75, 33.0, 0, 0)
    edit(folder / "numbers_of.py", "FACTOR = 10.0", "FACTOR = 20.0")
    assert answers(folder) == (63.75, 63.0, 0, 0)
    edit(folder / "numbers_of.py", "PLAIN = 0.25", "PLAIN = 0.125")
    assert answers(folder) == (63.625, 63.0, 0, 1)  # the C function does not use it
    edit(folder / "callee.py", "import njit", "import compiled\n\nnjit = compiled(fastmath=True)")
    assert answers(folder) == (63.625, 63.0, 0, 0)
    edit(folder / "callee.py", "return", "# a remark\n\n    return")
    (folder / "deeper.py").write_text("# another\n" + (folder / "deeper.py").read_text())
    assert answers(folder) == (63.625, 63.0, 1, 1)
    # What is replaced is removed. What others call has no machine code: a file for each of the two that are called.
    assert len(list((folder / "__pycache__").glob("*.nb*"))) == 2


def test_a_changed_record_is_another_signature(folder: Path, answers: Answers) -> None:
    answers(folder)
    edit(folder / "numbers_of.py", '("first", float), ("second", float)', '("second", float), ("first", float)')
    assert answers(folder) == (20.75, 20.0, 0, 1)


def test_an_entry_with_wrong_bytes_is_compiled_again(folder: Path, answers: Answers) -> None:
    """Whichever part of it a bad disk has cut off or overwritten: such machine code would end the process."""

    def cut(content: bytes, number: int) -> bytes:
        return content[:100]

    def overwritten(content: bytes, number: int, first: int) -> bytes:
        part = (number + first - 1) % 7 + 1  # of eight
        begin, end = part * len(content) // 8, (part + 1) * len(content) // 8
        return content[:begin] + bytes(one ^ 0x55 for one in content[begin:end]) + content[end:]

    answers(folder)
    for change in (cut, partial(overwritten, first=1), partial(overwritten, first=5)):
        paths = sorted((folder / "__pycache__").glob("*.nbc"))
        assert len(paths) == 2
        for number, path in enumerate(paths):
            path.write_bytes(change(path.read_bytes(), number))
        assert answers(folder) == (20.75, 20.0, 0, 0), change
    assert answers(folder) == (20.75, 20.0, 1, 1)


def test_without_a_writable_folder_beside_the_source_the_users_cache_serves(folder: Path, answers: Answers) -> None:
    # A file where the folder should be: nobody can make one, whatever his rights are.
    (folder / "__pycache__").write_text("")
    home = {"HOME": str(folder / "home")}
    assert answers(folder, **home) == (20.75, 20.0, 0, 0)
    assert answers(folder, **home) == (20.75, 20.0, 1, 1)
    assert len(list((folder / "home").rglob("*.nbc"))) == 2


def test_without_any_writable_folder_everything_runs_with_one_warning(folder: Path, processes: Forks) -> None:
    (folder / "__pycache__").write_text("")
    out, err = processes.run(folder, "evaluate.py", HOME=os.devnull)
    assert out.split() == ["20.75", "20.0", "0", "0"]
    assert err.count("RuntimeWarning") == 1
    assert re.search(r"compiled functions cannot be kept: neither .* NUMBA_CACHE_DIR to a folder", err)


def test_a_folder_that_fills_up_while_running_is_a_warning_too(folder: Path, processes: Forks) -> None:
    (folder / "full.py").write_text(
        "import resource\nresource.setrlimit(resource.RLIMIT_FSIZE, (1000, 1000))\nimport evaluate\n"
    )
    out, err = processes.run(folder, "full.py")
    assert out.split() == ["20.75", "20.0", "0", "0"]
    assert err.count("RuntimeWarning") == 1
    assert "File too large" in err
    assert not list((folder / "__pycache__").glob("*.nb*"))


def test_processes_that_save_at_the_same_time_do_not_mix_signatures(tmp_path: Path) -> None:
    """numba's common index, read before another process writes it, gives two signatures one file."""

    from tensegrity_mj.dynamics.native.numba_cache import Files

    def function(x: Any) -> Any:
        return x

    first, second = (Files(function, {}, (tmp_path,)) for _ in range(2))
    keys = [((sig,), ("cpu",), ("code", "closure")) for sig in ("float64", "int64")]
    first.save(keys[0], "for floats")
    second.save(keys[1], "for integers")
    for files in (first, second):
        assert [files.load(key) for key in keys] == ["for floats", "for integers"]


def test_a_law_of_the_users_is_compiled_anew_when_what_it_calls_changes(tmp_path: Path, answers: Answers) -> None:
    (tmp_path / "gains.py").write_text(
        "import numba\n\n@numba.njit(cache=True)\ndef gain(m):\n    return 0.25 * (m + 1)\n"
    )
    (tmp_path / "own.py").write_text(
        "import numba\nfrom gains import gain\n\n@numba.njit(cache=True)\n"
        "def law(time, nodes, velocities, string_nodes, parameters, command):\n"
        "    for m in range(len(command)):\n        command[m] = gain(m)\n    return True\n"
    )
    (tmp_path / "evaluate.py").write_text(
        "import tensegrity_mj as tmj\nfrom own import law\nscene = tmj.load_scene('prism')\n"
        "made = tmj.controllers.CompiledLaw(law, scene.structure)\n"
        "print(made(0.0, scene.nodes0, scene.velocities0)[1], sum(law.stats.cache_hits.values()))\n"
    )
    assert answers(tmp_path) == (0.5, 0)
    assert answers(tmp_path) == (0.5, 1)
    edit(tmp_path / "gains.py", "0.25", "0.5")
    assert answers(tmp_path) == (1.0, 0)


# What our own functions use ---------------------------------------------------------------------------------------


def test_every_engine_knows_the_string_law_and_its_constants() -> None:
    from tensegrity_mj.engines.mujoco import callback as mujoco_callback
    from tensegrity_mj.engines.reference import equations

    for function in (equations.rates_of_state, mujoco_callback.control_stage):
        used = {digests.python_function(one) for one in digests.used_by(function)}
        assert add_string_forces.py_func in used, function
        assert digests.digest(function) is not None


@pytest.mark.parametrize(
    "value",
    [1.5, -0.0, np.nan, "text", (1, (2.0, None)), frozenset("abcdef"), np.arange(5.0), np.dtype([("x", "f8", 3)])],
    ids=["float", "negative zero", "nan", "text", "tuple", "set", "array", "dtype"],
)
def test_constants_have_one_text(value: Any) -> None:
    code = compile("f(x)", "", "eval")
    assert digests.text_of(value, set(code.co_names), []) == digests.text_of(value, set(), [])
    others = [1.25, 0.0, np.inf, "Text", (1, (2.0, 0)), frozenset("abcdeg"), np.arange(5), np.dtype([("x", "f4", 3)])]
    assert digests.text_of(value, set(), []) not in {digests.text_of(other, set(), []) for other in others}


def test_what_has_no_text_is_not_kept() -> None:
    held = object()

    def function() -> Any:
        return held

    assert digests.digest(function) is None


def test_every_compiled_function_of_ours_is_kept_so() -> None:
    """`cache=True` is numba's own cache, which does not know what a function calls.

    And `fastmath` lets a processor fuse steps, so that bits depend on it.
    """
    sources = [path for folder in ("tensegrity_mj", "controllers") for path in (ROOT / folder).rglob("*.py")]
    assert len(sources) > 300
    texts = {path: path.read_text(encoding="utf-8") for path in sources}
    for path in (path for path, text in texts.items() if re.search(r"\b(cache|fastmath)\b", text)):
        for node in ast.walk(ast.parse(texts[path])):
            if isinstance(node, ast.Call):
                asked = {keyword.arg for keyword in node.keywords}
                assert not asked & {"cache", "fastmath"}, f"{path}:{node.lineno}"


START = """
import sys
import tensegrity_mj as tmj
for name, rate in {requested}:
    scene = tmj.load_scene(name)
    law = rate and tmj.controllers.Lyapunov(scene.structure, scene.target, decay_rate=rate)
    tmj.simulate(scene, law, tmj.MuJoCo(1e-3), duration=0.01)
print(sorted({{"numba", "scipy.optimize", "matplotlib", "tqdm", "h5py"}} & set(sys.modules)))
"""


def test_another_structure_or_other_parameters_of_a_law_compile_nothing() -> None:
    """What the first process compiles, the second finds: a run imports neither numba nor what takes long to import.

    Water and loads are functions of their own, which the first scene that has some compiles.
    """
    first = [("prism", 0.5), ("tower_waves", None), ("net", None)]
    for requested in (first, [("prism", 0.25), ("pinned_rod", 0.5), ("net", None), ("shape_control", None)]):
        run = [sys.executable, "-W", "ignore", "-c", START.format(requested=requested)]
        done = subprocess.run(run, check=True, capture_output=True, text=True)
    assert done.stdout.strip() == "[]"


RUN = """
import hashlib, warnings
warnings.simplefilter("ignore")
import tensegrity_mj as tmj
for name, engine in {runs}:
    scene = tmj.load_scene(name)
    law = tmj.controllers.from_scene(scene) if scene.control else None
    run = tmj.simulate(scene, law, engine, duration=0.1)
    print(hashlib.sha256(run.nodes.tobytes() + run.tensions.tobytes() + run.lyapunov.tobytes()).hexdigest())
"""


RUNS = '("prism", tmj.MuJoCo(1e-3)), ("prism", tmj.DAE()), ("tower_waves", tmj.MuJoCo(1e-3))'

# Products that are added up, which a processor may fuse; an ulp of y, which never repeats itself, soon is all of it.
CHAIN = """
import math
import sys
from tensegrity_mj.dynamics.native.compiling import c_function
from tensegrity_mj.dynamics.native.vectors import cross, dot, over

@c_function("float64(float64)")
def chain(x):
    a, total, y = (x, 1.0 - x, 0.3 + x), 0.0, x
    for n in range(1, 100):
        a = cross(a, (0.7, x * n, 1.0 / n))
        a = over(a, math.sqrt(dot(a, a)))
        total = 0.9 * total + a[0] * a[1] + math.sin(n * x) * math.exp(-x)
        y = 3.9 * (y - y * y)
    return total + y

if __name__ == "__main__":
    print(*(chain.ctypes(0.05 * n).hex() for n in range(1, 20)))
"""


@pytest.mark.parametrize("whole", [False, pytest.param(True, marks=pytest.mark.study)], ids=["chain", "runs"])
def test_code_for_any_processor_gives_the_bits_of_code_for_this_one(whole: bool, tmp_path: Path) -> None:
    """What a wheel ships is compiled for any processor, where only arithmetic without fused steps is allowed.

    All is compiled by one function with the same options, so that one of a few operations shows it of all.
    """
    script = tmp_path / "chain.py"
    script.write_text(RUN.replace("{runs}", f"[{RUNS}]") if whole else CHAIN)
    own = {name: value for name, value in os.environ.items() if not name.startswith("NUMBA_CPU")}
    found = [
        subprocess.run([sys.executable, script], env=env, check=True, capture_output=True, text=True).stdout.split()
        for env in (own, own | {"NUMBA_CPU_NAME": "generic", "NUMBA_CPU_FEATURES": ""})
    ]
    assert len(found[0]) == (RUNS.count("tmj.") if whole else 19)
    assert found[0] == found[1]


def test_what_is_shipped_is_used_whichever_compiler_is_installed(tmp_path: Path) -> None:
    """And where it is made of anything else than the function is now, it is not."""
    from tensegrity_mj.dynamics.native import compiling, kept

    @compiling.c_function("float64(float64)")
    def twice(x: float) -> float:
        return 2.0 * x

    @compiling.c_function("float64(float64)")
    def thrice(x: float) -> float:
        return 3.0 * x

    compiling.c_functions.remove(twice)
    compiling.c_functions.remove(thrice)
    twice.ship(tmp_path)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(kept, "SHIPPED", tmp_path)
        patch.setattr(kept, "folders", lambda source: ())
        patch.setattr(kept, "made_by", lambda: "another compiler")
        code = kept.kept_code(twice.py_func, twice.signature, {"error_model": "numpy"})
        assert code is not None
        function = ctypes.CFUNCTYPE(ctypes.c_double, ctypes.c_double)(code.load())
        assert function(21.0) == 42.0
        assert kept.kept_code(thrice.py_func, thrice.signature, {"error_model": "numpy"}) is None
        patch.setattr(kept, "SHIPPED", tmp_path / "none")
        assert kept.kept_code(twice.py_func, twice.signature, {"error_model": "numpy"}) is None
