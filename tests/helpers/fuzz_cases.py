"""Makes the cases of the fuzz test: valid scene files, trajectory files and command lines that are then broken."""

from __future__ import annotations

import contextlib
import copy
import json
import random
import tomllib
from pathlib import Path
from typing import Any

MODELS = ("pinned_rod", "prism", "prism_drop", "cross", "tbar", "cable", "truss_arm")
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
LONG = ("tradeoff", "validate", "stability", "reproduce", "demo", "render")  # and all of `audit`
BAD = ["nan", "-1", "x", "", "1e400", "1e-320", "\x1b[31m", "9" * 5000, "--", "0x10", "1_0e999"]


def kind_of(number: int) -> str:
    """What a case is made of."""
    return KINDS[number % len(KINDS)]


# Making cases -------------------------------------------------------------------------------------------------------


def model_text(name: str) -> str:
    return (Path(__file__).resolve().parents[2] / "models" / name / "scene.toml").read_text(encoding="utf-8")


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


def base_run(root: Path) -> Path:
    """A small run, made once for this process."""
    import tensegrity_mj as tmj

    path = root / "base.nc"
    if not path.exists():
        tmj.simulate(tmj.load_scene("pinned_rod"), None, tmj.DAE(), duration=0.05).save(path)
    return path


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
    try:
        words = json.loads(str(file.attrs.get(attribute, "{}")))
    except ValueError:  # it has been broken before
        return
    if not isinstance(words, dict):
        return
    words[rng.choice(["accuracy", "warnings", "stability", "controller", "versions", "wall_time", "drift", *words])] = (
        rng.choice([nasty(rng), {"met": nasty(rng)}, [nasty(rng)], {"law": nasty(rng), "decay_rate": nasty(rng)}])
    )
    with contextlib.suppress(ValueError):  # an integer that Python does not write
        text = json.dumps(words, ensure_ascii=rng.random() < 0.5)
        file.attrs[attribute] = text.replace("\0", "").encode("utf-8", "replace").decode()[:60_000]


def command_line(rng: random.Random, folder: Path) -> list[str]:
    """A command with options of its own, some of them as they should be."""
    from tensegrity_mj.cli import build_parser

    commands = build_parser().commands.values()
    parsers = {one.words: one for command in commands for one in (command.commands.values() or [command])}
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
    long = name in LONG or name.startswith("audit ")
    words = [name]
    for option in options:
        if option.dest == "backend":
            words += ["--backend", "this-process"]
        elif option.dest == "json" and rng.random() < 0.3:
            words.append(option.option_strings[0])
        elif rng.random() < min(0.3, 2.0 / len(options)):
            words += option_words(rng, option, long, folder)
    if "--duration" not in words and any(option.dest == "duration" for option in options):
        words += ["--duration", "0.02"]
    for action in parsers[name]._actions:
        if not action.option_strings:
            count = {None: 1, "?": rng.randrange(2), "*": rng.randrange(2), "+": rng.choice([1, 1, 2])}[action.nargs]
            words[1:1] = [rng.choice(inputs) for _ in range(count)]
    if long:
        words.append("--no-such-option")
    return [*name.split(), *words[1:]]


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
