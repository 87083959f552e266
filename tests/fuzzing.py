"""Cases for the fuzz test, each made from its number alone, and the process that tries them.

python tests/fuzzing.py NUMBER ...     tries some and prints what came of each
python tests/fuzzing.py --serve        numbers on stdin, a line of JSON each on stdout (what test_fuzz.py starts)

A case is a scene file, a trajectory file or a command line that was valid and then was broken, or perhaps was not.
It is right where it is refused by a `TensegrityError` (a command: exit code 2 to 6) whose message can be shown, or
where it is accepted and what comes of it is sound: numbers are finite, the file that is written is read back equal.
"""

from __future__ import annotations

import argparse
import contextlib
import copy
import io
import json
import os
import random
import resource
import shutil
import signal
import sys
import tempfile
import tomllib
import traceback
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

CPU_SECONDS = 10  # of a case; counted in the processor's time, so that a busy machine ends none
MEMORY = 6 * 2**30  # bytes of data of the process: a case that fills memory fails here
MODELS = ("pinned_rod", "prism", "prism_drop", "cross", "tbar", "cable", "truss_arm")
KEPT = 20  # cases that a report of failures shows

TEXTS = [
    "", " ", "a", "../x", "/x", "..", "a\\b", "\x1b[31m", "a\nb", "\x00", "\u202e", "é", "日本", "🙂", "$x$",
    "\\frac{$", "_x", "%s", "{}", "NaN", "con", "x" * 300, "x" * 20_000, "</mujoco>", "<!--", "--", "'", '"', "O",
    "n1", "rod", "s1", "lyapunov", "feedback_linearization", "path.py:law", "/dev/zero", "scene.toml", "hostile.toml",
]  # fmt: skip
NUMBERS: list[Any] = [
    0, -0.0, 1, -1, 2, 0.5, 1e-3, 1e3, 1e6, 1e-6, 1e-9, 1e9, 1e-17, 1e17, 1e-99, 1e99, 1e-100, 1e100, 1e-101, 1e101,
    1e-161, 1e-308, 5e-324, 1e306, 1.7976931348623157e308, float("nan"), float("inf"), float("-inf"), 10**18, -(10**18),
    10**400, 2**63, 1 - 1e-16, 1 + 1e-9, 3.141592653589793,
]  # fmt: skip
OTHERS: list[Any] = [
    True, False, [], {}, [[]], [{}], [1], ["a"], {"a": 1}, [0, 0, 0], [0, 0, 1], [1e200, 0, 0], ["O", "n1"],
]  # fmt: skip
PARTS: list[Any] = [
    {"floor": 0.0},
    {"rods": True},
    {"waves": [{"amplitude": 0.1, "wavelength": 5.0}]},
    {"density": 1000.0, "current": [0.5, 0, 0]},
    {"viscous": 0.5},
    {"bending": {"stiffness": 1.0}},
    {"drag": {"normal": 1.2}},
    [{"node": "n1", "force": [0.0, 0.0, 1.0]}],
    [{"string": "s1", "time": 0.005}],
    [{"support": "O", "harmonics": [{"amplitude": [0.1, 0, 0], "angular_frequency": 3.0}]}],
    {"nodes": {"n1": [0.0, 0.8, 0.6]}},
    [0.0, 0.0, -9.81],
]
SCENE_KEYS = "gravity contact water resistance loads breaks motions target duration".split()
PIECES = [b'"', b"'", b"[", b"]", b"{", b"}", b"=", b".", b"#", b"\n", b'"""', b"\\", b"\x00", b"\xff"]
BOMBS = ["a." * 30_000 + "a = 1\n", "[" * 5000, "{a=" * 3000, "9" * 10_000, '"\\' * 20_000]
KINDS = ("scene", "scene", "scene", "text", "scene", "trajectory", "scene", "command", "text", "command")
DURATIONS = ["0.01", "0.02", "0.05", "-1", "0", "nan", "inf", "1e-320", "1e-9", "x", "1e400"]
STEPS = ["1e-3", "1e-2", "0.005", "0.3", "-1", "0", "nan", "1e-320", "1e99", "x"]
# Commands that take long where nothing is wrong: something always is.
LONG = ("benchmark", "tradeoff", "promise", "validate", "stability", "reproduce", "extremes", "drift", "demo", "render")
BAD = ["nan", "-1", "x", "", "1e400", "1e-320", "\x1b[31m", "9" * 5000, "--", "0x10", "1_0e999"]


class Failure(Exception):
    """What a case must not do."""


def kind_of(number: int) -> str:
    """What a case is made of."""
    return KINDS[number % len(KINDS)]


# Making cases -------------------------------------------------------------------------------------------------------


def model_text(name: str) -> str:
    return (Path(__file__).resolve().parent.parent / "models" / name / "scene.toml").read_text(encoding="utf-8")


def nasty(rng: random.Random) -> Any:
    """A value that nobody expects."""
    if rng.random() < 0.1:
        value: Any = 1
        for _ in range(rng.choice([3, 20, 100])):
            value = [value] if rng.random() < 0.7 else {"a": value}
        return value
    return copy.deepcopy(rng.choice([rng.choice(TEXTS), rng.choice(NUMBERS), rng.choice(OTHERS)]))


def places(data: Any) -> list[tuple[Any, Any]]:
    """Every (container, key or index) inside."""
    found = []
    todo = [data]
    while todo:
        one = todo.pop()
        for key in one if isinstance(one, dict) else range(len(one)):
            found.append((one, key))
            if isinstance(one[key], (dict, list)):
                todo.append(one[key])
    return found


def mutated(rng: random.Random, data: dict[str, Any]) -> None:
    """Change one thing in a table of a scene."""
    inside = places(data)
    if not inside:
        return
    one, key = rng.choice(inside)
    if rng.random() < 0.5:  # the top and its tables are chosen as often as the many numbers of nodes
        tables = [place for place in inside if isinstance(place[0], dict) and len(place[0]) < 20]
        one, key = rng.choice(tables or inside)
    value = one[key]
    way = rng.randrange(10)
    if way == 0:
        del one[key]
    elif way == 1 and isinstance(one, dict):
        one[rng.choice([*TEXTS, str(key)[:-1], str(key) + "s", str(key).upper()])] = one.pop(key)
    elif way == 2 and isinstance(one, dict):
        one[rng.choice(TEXTS)] = nasty(rng)
    elif way == 3 and isinstance(value, (int, float)):
        one[key] = value * 10.0 ** rng.choice([-320, -200, -100, -50, -16, -9, -3, 3, 9, 16, 50, 100, 200, 300])
    elif way == 4 and isinstance(value, (int, float)):
        one[key] = rng.choice([-value, value + 1e-12, value + 1e-6, int(value) if abs(value) < 1e9 else 0, str(value)])
    elif way == 5:
        other, place = rng.choice(inside)
        one[key] = copy.deepcopy(other[place])
    elif way == 6 and isinstance(value, list) and value:
        value.append(copy.deepcopy(rng.choice(value)))
    elif way == 7 and isinstance(value, str):
        renamed(data, value, rng.choice(TEXTS))
    elif way == 8:
        scene = data.setdefault("scene", {})
        if isinstance(scene, dict):
            scene[rng.choice(SCENE_KEYS)] = copy.deepcopy(rng.choice([nasty(rng), *PARTS]))
    else:
        one[key] = nasty(rng)


def renamed(data: Any, old: str, new: str) -> None:
    """Another name wherever a name stands."""
    for one, key in places(data):
        if one[key] == old:
            one[key] = new
        if isinstance(one, dict) and key == old:
            one[new] = one.pop(key)


def scene_bytes(rng: random.Random) -> bytes:
    """A scene file with some things changed."""
    import tomli_w

    data = tomllib.loads(model_text(rng.choice(MODELS)))
    for _ in range(rng.choice([0, 1, 1, 1, 2, 2, 3, 6])):
        mutated(rng, data)
    try:
        text = tomli_w.dumps(data)
    except (TypeError, ValueError, RecursionError):
        text = repr(data)
    return text.encode("utf-8", "surrogatepass")


def text_bytes(rng: random.Random) -> bytes:
    """A scene file with letters or lines changed."""
    content = bytearray(model_text(rng.choice(MODELS)).encode())
    for _ in range(rng.choice([1, 1, 1, 2, 5])):
        at = rng.randrange(len(content) + 1)
        way = rng.randrange(8)
        if way == 0:
            content[at : at + 1] = bytes([rng.randrange(256)])
        elif way == 1:
            del content[at : at + rng.choice([1, 3, 30])]
        elif way == 2:
            content[at:at] = rng.choice(PIECES)
        elif way == 3:
            lines = content.split(b"\n")
            lines.insert(rng.randrange(len(lines)), rng.choice(lines))
            content = bytearray(b"\n".join(lines))
        elif way == 4:
            content[at:at] = rng.choice(TEXTS).encode()
        elif way == 5:
            content[at:at] = rng.choice(BOMBS).encode()
        elif way == 6:
            del content[at:]
        else:
            content[at:at] = repr(rng.choice(NUMBERS)).encode()
    return bytes(content)


# Trying them ---------------------------------------------------------------------------------------------------------


def check_message(text: str) -> None:
    """Raise Failure unless a message can be shown to a person, and says something."""
    from tensegrity_mj.texts import MOST_LETTERS

    if not text or not text.isprintable() or len(text) > MOST_LETTERS or "Traceback" in text:
        raise Failure(f"a message that cannot be shown: {text!r:.300}")


def refused_or(work: Callable[[], Any]) -> Any:
    """What the work returns; None where it is refused."""
    from tensegrity_mj.errors import TensegrityError

    try:
        return work()
    except TensegrityError as error:
        check_message(str(error))
        return None


def check_scene(scene: Any) -> None:
    """Raise Failure unless a scene that was accepted is sound."""
    import numpy as np

    from tensegrity_mj.textformat import scene_from_toml, scene_to_toml

    structure = scene.structure
    arrays = (scene.nodes0, scene.velocities0, structure.positions, structure.rest_lengths, structure.rod_lengths)
    if not all(np.all(np.isfinite(array)) for array in arrays):
        raise Failure("an accepted scene has numbers that are not finite")
    if scene_from_toml(scene_to_toml(scene)) != scene:
        raise Failure("an accepted scene is not read back equal")


def check_run(rng: random.Random, scene: Any) -> None:
    """Raise Failure unless a short run ends, and completed ones have finite numbers."""
    import numpy as np

    import tensegrity_mj as tmj

    engine: Any = rng.choice([tmj.MuJoCo(), tmj.MuJoCo(1e-2), tmj.DAE(max_steps=300), tmj.ODE(max_steps=300)])
    law = None
    if rng.random() < 0.5 and scene.control is not None:
        law = refused_or(lambda: tmj.controllers.from_scene(scene))
    run = refused_or(lambda: tmj.simulate(scene, law, engine, duration=0.02))
    if run is not None and run.status is tmj.Status.COMPLETED and not np.all(np.isfinite(run.nodes)):
        raise Failure(f"a completed run of {run.engine} has nodes that are not finite")
    if run is not None:
        for text in run.reports.get("warnings", []):
            check_message(str(text)[:500])


def try_scene(rng: random.Random, folder: Path, content: bytes) -> str:
    from tensegrity_mj.textformat import load_scene

    path = folder / "hostile.toml"
    path.write_bytes(content)
    scene = refused_or(lambda: load_scene(path))
    if scene is None:
        return "refused"
    check_scene(scene)
    if rng.random() < 0.3 and len(scene.structure.rods) < 30:
        check_run(rng, scene)
    return "accepted"


def base_run(root: Path) -> Path:
    """A small run, made once for this process."""
    import tensegrity_mj as tmj

    path = root / "base.nc"
    if not path.exists():
        tmj.simulate(tmj.load_scene("pinned_rod"), None, tmj.DAE(), duration=0.05).save(path)
    return path


def try_trajectory(rng: random.Random, folder: Path) -> str:
    import numpy as np

    from tensegrity_mj import Trajectory

    path = folder / "hostile.nc"
    shutil.copy(base_run(folder.parents[2]), path)
    if rng.random() < 0.2:
        content = bytearray(path.read_bytes())
        del content[rng.randrange(len(content)) :]
        path.write_bytes(content)
    else:
        break_file(rng, path)
    run = refused_or(lambda: Trajectory.load(path))
    if run is None:
        return "refused"
    check_scene(run.scene)
    if not np.all(np.isfinite(run.nodes)) and run.status.value == "completed":
        raise Failure("an accepted trajectory that completed has nodes that are not finite")
    uses = [
        ["compare", str(path), str(base_run(folder.parents[2])), *rng.choice([[], ["--plot", "plot.svg"]])],
        ["clearance", str(path)],
        ["run", "pinned_rod", "--replay", str(path), "--control-period", "0.01", "--duration", "0.02"],
        ["statics", "pinned_rod", "--run", str(path)],
    ]
    try_command([*rng.choice(uses), *rng.choice([[], ["--json"]])])
    return "accepted"


def break_file(rng: random.Random, path: Path) -> None:
    """Change attributes and variables of a trajectory's file."""
    import h5py
    import numpy as np

    with h5py.File(path, "a") as file:
        for _ in range(rng.choice([0, 1, 1, 2, 4])):
            if rng.random() < 0.4:
                break_words(rng, file)
                continue
            name = rng.choice(sorted(file))
            attribute = rng.choice(sorted(file.attrs) or ["format"])
            way = rng.randrange(8)
            if way == 0 and name in file:
                del file[name]
            elif way == 1:
                file.attrs.pop(attribute, None)
            elif way == 2:
                value = rng.choice(
                    [rng.choice(TEXTS).replace("\0", ""), 3, 2.5, [1, 2], b"\xff\xfe", "{}", "[]", "null", "diverged"]
                )
                file.attrs[attribute] = value
            elif way == 3:
                file.attrs["scene"] = scene_bytes(rng).decode("utf-8", "replace").replace("\0", "")[:60_000]
            elif way == 4 and name in file and 0 < file[name].size < 10**6:
                values = np.array(file[name])
                if values.dtype.kind == "f":
                    values.flat[rng.randrange(values.size)] = rng.choice([np.nan, np.inf, -1.0, 1e300, 0.0])
                    file[name][...] = values
            elif way == 5 and name in file and 0 < file[name].size < 10**6:
                values = np.array(file[name])
                file[name][...] = values[::-1]
            elif way == 6 and name in file:
                shape, kind = rng.choice([(), (0,), (1,), (3, 3), (2, 2, 2)]), rng.choice(["f8", "i4", "S5", "f2"])
                del file[name]
                file.create_dataset(name, shape, kind)
            elif way == 7:
                # Declared, and never written: a file of a few bytes with petabytes of numbers.
                del file[name]
                file.create_dataset(name, (10**15,), "f8", chunks=(1024,))


def break_words(rng: random.Random, file: Any) -> None:
    """Change what a trajectory's file says of its run, which is JSON."""
    attribute = rng.choice(["reports", "provenance", "cost"])
    words = json.loads(str(file.attrs.get(attribute, "{}")) or "{}")
    if not isinstance(words, dict):
        return
    words[rng.choice(["accuracy", "warnings", "stability", "controller", "versions", "wall_time", "drift", *words])] = (
        rng.choice([nasty(rng), {"met": nasty(rng)}, [nasty(rng)], {"law": nasty(rng), "decay_rate": nasty(rng)}])
    )
    with contextlib.suppress(ValueError):  # an integer that Python does not write
        text = json.dumps(words, ensure_ascii=rng.random() < 0.5)
        file.attrs[attribute] = text.replace("\0", "").encode("utf-8", "replace").decode()[:60_000]


def try_command(arguments: list[str]) -> str:
    """A command line; its exit code must be one of those with a meaning."""
    from tensegrity_mj.cli import main

    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        try:
            code = main(arguments)
        except SystemExit as stop:  # of --help
            code = int(stop.code or 0)
    if code not in (0, 2, 3, 4, 5, 6):
        raise Failure(f"{arguments!r:.300}: exit code {code}; {err.getvalue()[-300:]!r}")
    for text in (out.getvalue(), err.getvalue()):
        bad = {letter for letter in text if not letter.isprintable()} - {"\n", "\r", "\t"}
        if bad or "Traceback" in text:
            raise Failure(f"{arguments!r:.300}: what it printed has {sorted(bad)!r}: {text[:300]!r}")
    if code and not err.getvalue() and not out.getvalue():
        raise Failure(f"{arguments!r:.300}: exit code {code} without a word")
    return "accepted" if code == 0 else "refused"


def command_line(rng: random.Random, folder: Path) -> list[str]:
    """A command with options of its own, some of them as they should be."""
    from tensegrity_mj.cli import build_parser

    parsers = next(one for one in build_parser()._actions if isinstance(one, argparse._SubParsersAction)).choices
    name = rng.choice(
        [*parsers, "run", "run", "compare", "scenes", "statics", "linearize", "sweep", "export", "nonsense"]
    )
    if name not in parsers:
        return [name, *rng.sample(TEXTS[:20], 2)]
    scene = folder / "hostile.toml"
    scene.write_bytes(scene_bytes(rng) if rng.random() < 0.3 else model_text(rng.choice(MODELS[:5])).encode())
    inputs = [str(scene), str(scene), "pinned_rod", "prism", rng.choice(TEXTS).replace("\0", ""), "tower(stages=2)"]
    if name in ("compare", "clearance", "run"):
        inputs += [str(base_run(folder.parents[2]))] * 2
    options = [
        one for one in parsers[name]._actions if one.option_strings and one.dest not in ("help", "view", "cluster")
    ]
    words = [name]
    for option in options:
        if option.dest == "backend":
            words += ["--backend", "this-process"]
        elif option.dest == "no_timing" or (option.dest == "json" and rng.random() < 0.3):
            words.append(option.option_strings[0])
        elif rng.random() < min(0.3, 2.0 / len(options)):
            words += option_words(rng, option, name in LONG, folder)
    if "--duration" not in words and any(option.dest == "duration" for option in options):
        words += ["--duration", "0.02"]
    for action in parsers[name]._actions:
        if not action.option_strings:
            count = {None: 1, "?": rng.randrange(2), "*": rng.randrange(2), "+": rng.choice([1, 1, 2])}[action.nargs]
            words[1:1] = [rng.choice(inputs) for _ in range(count)]
    if name in LONG:
        words.append("--no-such-option")
    return words


def option_words(rng: random.Random, option: Any, only_bad: bool, folder: Path) -> list[str]:
    """An option and what follows it."""
    flag = option.option_strings[0]
    if option.nargs == 0:
        return [flag]
    if only_bad or rng.random() < 0.1:
        return [flag, rng.choice(BAD)]
    if option.choices:
        return [flag, rng.choice([*map(str, option.choices), "x"])]
    known = {
        "duration": DURATIONS,
        "timestep": STEPS,
        "output_interval": STEPS,
        "control_period": ["1e-3", "0.01", "-1", "nan", "1e-9"],
        "accuracy": ["1e-3", "1e-5", "-1", "1e-30"],
        "rtol": ["1e-3", "1e-6", "1e-30", "2"],
        "atol": ["1e-3", "1e-6", "1e-30", "2"],
        "points": ["1", "5", "0", "-1", "x"],
        "modes": ["0", "3", "100", "x"],
        "samples": ["1", "2", "0", "-1"],
        "seed": ["0", "-1", "x", "1"],
        "workers": ["1", "0", "-1", "x"],
        "vary": ["strings.s1.stiffness=1,2", "x", "=", "control=1", "engine.timestep=1e-3", "a=1:2:10000000000"],
        "zip": ["strings.s1.stiffness=1,2", "x=1", "="],
        "draw": ["rods.*.mass=*normal(1,0.1)", "x", "mass=uniform(0,1)", "rods.*.mass=uniform(nan,1)"],
        "set": ["engine.timestep=1e-2", "scene.duration=0.01", "x=[[[[", "law=none", "{}"],
        "load": ["n1=0,0,1", "x=1", "n1=nan,0,0", "n1=1e300,0,0", "="],
        "hold": ["n1:xy", "n1:q", "x", "n1:xyz=1,0,0"],
        "rest_length": ["s1=1", "s1=-1", "s1=nan", "x"],
        "law_option": ["decay_rate=1", "x=1", "norm=[[[[[[", "="],
        "out": ["out", "out.nc", "out.json", "out.toml", "out.xml", "../out.nc", "/dev/full", "/proc/x.nc", "out.html"],
        "plot": ["plot.png", "plot.pdf", "plot.xyz", "no/plot.png"],
        "save_scene": ["saved.toml", "x"],
        "save_sized": ["sized.toml", "x"],
    }  # fmt: skip
    value = rng.choice(known.get(option.dest, [*BAD, *TEXTS[:12]])).replace("\0", "")
    if option.dest == "out" and value.startswith("../"):
        value = str(folder / "out.nc")  # what the user names may be anywhere, and here it must not be
    return [flag, value]


def attempt(number: int, root: Path) -> tuple[str, str]:
    """What came of a case: "accepted", "refused" or "failed", and why it failed."""
    rng = random.Random(f"fuzz {number}")
    kind = kind_of(number)
    folder = root / "cases" / "case" / "work"
    shutil.rmtree(root / "cases", ignore_errors=True)
    folder.mkdir(parents=True)
    there, wanted = os.getcwd(), {folder.parent, base_run(root)}
    os.chdir(folder)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            if kind == "scene":
                outcome = try_scene(rng, folder, scene_bytes(rng))
            elif kind == "text":
                outcome = try_scene(rng, folder, text_bytes(rng))
            elif kind == "trajectory":
                outcome = try_trajectory(rng, folder)
            else:
                outcome = try_command(command_line(rng, folder))
        found = {*(root / "cases").iterdir(), *root.iterdir()} - {root / "cases"}
        stray = [*(found - wanted), *(one for one in folder.parent.iterdir() if one != folder)]
        if stray:
            raise Failure(f"it wrote {stray[0]} outside its folder")
        if left := list(folder.rglob(".new-*")):
            raise Failure(f"it left {left[0].name}")
    except BaseException as error:
        if isinstance(error, KeyboardInterrupt):
            raise
        told = str(error) if isinstance(error, Failure) else "".join(traceback.format_exception(error))[-3000:]
        return "failed", told
    finally:
        os.chdir(there)
    return outcome, ""


def warm() -> None:
    """Compile and import what is so once, which is no case's time."""
    import tensegrity_mj as tmj

    wet = tmj.load_scene("prism").with_(gravity=(0.0, 0.0, -9.81), water=tmj.Water())
    scenes = [*map(tmj.load_scene, MODELS), tmj.load_scene("net"), wet]
    for scene in scenes:
        law = tmj.controllers.from_scene(scene) if scene.control is not None else None
        for engine in (tmj.MuJoCo(), tmj.DAE(), tmj.ODE(), tmj.DAE(method=tmj.Method.RK4, timestep=1e-3)):
            for own in (None, law):
                with warnings.catch_warnings(), contextlib.suppress(tmj.TensegrityError):
                    warnings.simplefilter("ignore")
                    tmj.simulate(scene, own, engine, duration=0.002)


def serve(numbers: Any, answer: Callable[[str], object]) -> None:
    """Try cases by their numbers, and answer each with a line of JSON. One that takes too long ends the process."""
    resource.setrlimit(resource.RLIMIT_DATA, (MEMORY, MEMORY))
    with tempfile.TemporaryDirectory() as place:
        warm()
        attempt(0, Path(place))
        for line in numbers:
            number = int(line)
            signal.setitimer(signal.ITIMER_PROF, CPU_SECONDS)  # SIGPROF ends the process, in compiled code too
            outcome, why = attempt(number, Path(place))
            signal.setitimer(signal.ITIMER_PROF, 0)
            answer(json.dumps({"number": number, "kind": kind_of(number), "outcome": outcome, "why": why}))


if __name__ == "__main__":
    sys.setrecursionlimit(1000)
    if sys.argv[1:] == ["--serve"]:
        # Answers have a pipe of their own: what commands print goes to their test.
        pipe = os.fdopen(os.dup(1), "w", buffering=1)
        null = os.open(os.devnull, os.O_WRONLY)
        os.dup2(null, 1)
        os.dup2(null, 2)
        serve(sys.stdin, lambda text: print(text, file=pipe))
    else:
        with tempfile.TemporaryDirectory() as place:
            for text in sys.argv[1:]:
                print(text, kind_of(int(text)), *attempt(int(text), Path(place)))
