"""Mistakes of users: command lines, scene files, calls in Python. Each answer is a line with item, value and remedy.

What a row has after the mistake are the words that its answer must contain: what is wrong, what it is, and what is
allowed or to be done.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import tensegrity_mj as tmj
from tensegrity_mj.cli import main
from tensegrity_mj.model.text.reading import scene_from_toml

ROOT = Path(__file__).resolve().parents[2]

# Command lines, in a folder with `text.nc`, which is no trajectory, `empty.toml`, `bytes.toml` and the folder `folder`.
COMMANDS: dict[str, tuple[str, ...]] = {
    "help": ("help", "did you mean --help?"),
    "prism": ("prism", "did you mean run prism?"),
    "run Prism": ("unknown scene 'Prism'", "did you mean 'prism'?", "path of a .toml file"),
    "run models/prism": ("models/prism", "no such file"),
    "run empty.toml": ("empty.toml", "'format' is missing", "starts with: format = 1"),
    "run bytes.toml": ("bytes.toml", "not a text in UTF-8", "byte 0"),
    "run folder": ("unknown scene 'folder'", "prism"),
    "run tower(stage=3)": ("tower", "unknown argument 'stage'", "did you mean 'stages'?"),
    "run tower(stages=0)": ("tower: stages = 0", "an integer >= 1"),
    "run tower(stages=two)": ("stages = two", "write a number, a text in quotes"),
    "run towers(stages=3)": ("unknown family 'towers'", "did you mean 'tower'?"),
    "run prism --duration 1s": ("--duration: '1s' is no number", "without a unit"),
    "run prism --duration nan": ("--duration: nan", "it must be finite"),
    "run prism --duration 1e99": ("1e+99 s", "more steps than can be counted", "make the first smaller"),
    "run prism --timestep 1,5": ("--timestep: '1,5' is no number", "such as 0.5"),
    "run prism --accuracy 1": ("accuracy = 1.0", "from 1e-10 to 0.01 m"),
    "run prism --accuracy 1e-6 --timestep 1e-3": ("--timestep is chosen by --accuracy", "give one or the other"),
    "run prism --law-option decay": ("--law-option: 'decay'", "write NAME=VALUE, for example"),
    "run prism --law-option decay_rte=2": ("has no option 'decay_rte'", "did you mean 'decay_rate'?"),
    "run prism --out p.npz": ("--out p.npz", "must end in .nc"),
    "run prism --out nowhere/p.nc": ("--out nowhere/p.nc", "there is no folder", "create it first"),
    "run prism --json=1": ("--json: '1'", "it takes no value; leave it out"),
    "run prism --output-interval 20 --duration 1": ("output_interval = 20.0 s", "longer than the run of 1.0 s"),
    "run net --engine ode": ("ODE: rods 'x0_0' and 'y0_0' share node 'n0_0'", "use MuJoCo or DAE"),
    "run prism_drop --engine ode": ("ODE: scene 'prism_drop' has contact", "use MuJoCo or DAE, or leave it out"),
    "run prism --replay text.nc": (
        "text.nc",
        "not a readable trajectory",
        "name a file that `run --out` or `save` wrote",
    ),
    "compare prism tower": ("compare prism tower", "give one scene, or two"),
    "compare text.nc text.nc": ("text.nc", "a run compared with itself shows nothing"),
    "render text.nc --out p.mp4 --size 1280": ("--size: '1280'", "for example 1280x720"),
    "export prism": ("--out: missing", "export --help"),
    "statics prism --load n99=0,0,1": ("loads: there is no node 'n99'", "allowed: O, n1"),
    "statics truss_arm --load t4=0,0": ("--load: '0,0'", "write three numbers, for example t4=0,0,-20"),
    "linearize prism --out p.txt": ("--out p.txt", "must end in .npz"),
    "clearance text.nc": ("text.nc", "not a readable trajectory"),
    "sweep prism --vary law.decay_rte=1,2 --out s": ("'decay_rte'", "did you mean 'decay_rate'?"),
    "sweep prism --vary law.decay_rate= --out s": ("--vary law.decay_rate=", "write PATH=VALUE"),
    "sweep prism --vary rods=1:2 --out s": ("no kind of parameter 'rods'", "allowed: family, structure"),
    "identify prism --data text.nc --parameter structure.strings.stiffness": ("text.nc", "not a readable trajectory"),
    "identify prism --data x.csv": ("--parameter: missing", "identify --help"),
    "validate tbar --out s": ("scene 'tbar' names no control law", "choose one of"),
    "reproduce 9.9": ("figure '9.9'", "5.4"),
    "demo --scene tbar": ("scene 'tbar' has no control law", "choose one that has"),
}

# The scene of docs/format.md with one thing changed: (what, into what), and the words.
FILES: dict[tuple[str, str], tuple[str, ...]] = {
    ("format = 1 ", 'format = "1" '): ("format = '1' (a text)", "reads format = 1"),
    ("format = 1 ", "format = 2 "): ("format = 2", "reads format = 1"),
    ('name = "hanging_rod"', "name = 7"): ("name = 7 (an integer)", "a text in quotes"),
    ("foot = [0, 0, 0]", "foot = [0, 0]"): ("nodes: foot = [0, 0]", "three numbers [x, y, z]"),
    ("foot = [0, 0, 0]", 'foot = [0, 0, "0"]'): ("foot = [0, 0, '0']", "three numbers [x, y, z]"),
    ("foot = [0, 0, 0]", "foot = [0, 0, nan]"): ("node 'foot'", "nan", "three finite numbers [m]"),
    ("tip = [1, 0, 0]", "tip = [0, 0, 0]"): ("rod 'rod' has length 0 m", "must be longer than zero"),
    ("tip = [1, 0, 0]", "tip = [1, 0 0]"): ("not valid TOML", "line 7", "nodes.tip = [1, 0 0]", "docs/format.md"),
    ("mass = 2.0", "mass = 2,0"): ("not valid TOML", "line 15", "'mass = 2,0'", "docs/format.md"),
    ("right = [1, 1, 1]", "left = [1, 1, 1]"): ("not valid TOML", "nodes.left = [1, 1, 1]"),
    ('["foot", "tip"]', '["foot", "tp"]'): ("rod 'rod'", "unknown node 'tp'", "did you mean 'tip'?"),
    ('["foot", "tip"]', '["foot", "foot"]'): ("rod 'rod'", "node 'foot'", "two different nodes"),
    ('["foot", "tip"]', '["foot"]'): ("rods[0] 'rod'", "nodes = ['foot']", "two names in quotes"),
    ('["foot", "tip"]', '["foot", "left"]'): ("fixed node 'left'", "rod 'rod'", "pin the rod there"),
    ("mass = 2.0", "mass = 0"): ("rods[0] 'rod': mass = 0.0", "> 0 kg"),
    ("mass = 2.0", 'mass = "2 kg"'): ("mass = '2 kg' (a text)", "a number"),
    ("mass = 2.0", "mass = true"): ("mass = true (a truth value)", "a number"),
    ("mass = 2.0\n", ""): ("rods[0] 'rod': 'mass' is missing", "a number"),
    ("mass = 2.0", "mas = 2.0"): ("unknown key 'mas'", "did you mean 'mass'?"),
    ('"pinned"', '"pined"'): ("support: kind = 'pined'", '"pinned"', "did you mean 'pinned'?"),
    ('"pinned"', '"pinned", sigma = 1.5'): ("support: sigma = 1.5", "within [0, 1]"),
    ('["left", "right"]', '["left", "rigth"]'): ("fixed_nodes", "'rigth'", "did you mean 'right'?"),
    ('["left", "right"]', '"left"'): ("fixed_nodes = 'left'", "a list of names in quotes"),
    ('["left", "right"]', '["left"]'): ("node 'right'", "would have no mass", "add it to fixed_nodes"),
    ('"s2"', '"s1"'): ("string 's1' is defined twice", "names must be unique"),
    ("stiffness = 50.0", "stiffness = 0.0"): ("strings[0] 's1': stiffness = 0.0", "> 0 N/m"),
    ("stiffness = 50.0", "stiffnes = 50.0"): ("unknown key 'stiffnes'", "did you mean 'stiffness'?"),
    ("force_density = 5.0", "force_density = -5.0"): ("'s1': force_density = -5.0", ">= 0 N/m"),
    ("force_density = 5.0", "force_density = 5.0\nrest_length = 1.0"): ("rest_length and force_density", "at most one"),
    ("gravity = [0, 0, -9.81]", "gravity = 9.81"): ("gravity = 9.81", "three numbers [x, y, z]"),
    ("gravity = [0", "gravty = [0"): ("unknown key 'gravty'", "did you mean 'gravity'?"),
    ("duration = 3.0", "duration = 0"): ("duration = 0.0", "> 0 s"),
    ("tip = [0, 0.5, 0]", "tip = [0.5, 0, 0]"): ("rod 'rod' would lengthen at 0.5 m/s", "must be equal along it"),
    ("tip = [0, 0.5, 0]", "tpi = [0, 0.5, 0]"): ("unknown node 'tpi'", "did you mean 'tip'?"),
    ("[scene]", "[scen]"): ("unknown key 'scen'", "did you mean 'scene'?"),
    ("[[structure.rods]]", "[structure.rods]"): ("structure: rods = ", "(a table)", "each under [[structure.rods]]"),
    ("duration = 3.0", "contact = { floor = 5.0 }"): ("rod 'rod' at node 'tip'", "inside the floor", "start higher"),
    ("duration = 3.0", "contact = { flor = 0.0 }"): ("unknown key 'flor'", "did you mean 'floor'?"),
    ("duration = 3.0", 'loads = [{ node = "tipp", force = [0, 0, 1] }]'): ("loads[0]", "'tipp'", "did you mean 'tip'?"),
    ("duration = 3.0", 'breaks = [{ string = "s3", time = 1.0 }]'): ("breaks[0]", "unknown string 's3'", "'s1', 's2'"),
    ("duration = 3.0", "water = { density = -1.0 }"): ("water: density = -1.0", "> 0 kg/m³"),
}


def prism() -> tmj.Scene:
    return tmj.load_scene("prism")


# Calls, of which each raises a TensegrityError.
CALLS: dict[str, tuple[Callable[[], Any], tuple[str, ...]]] = {
    "a class in place of an engine": (lambda: tmj.simulate(prism(), None, tmj.DAE), ("engine = ", "DAE(...)")),  # type: ignore[arg-type]
    "a step of zero": (lambda: tmj.MuJoCo(timestep=0.0), ("timestep = 0.0", "> 0 s")),
    "a step as text": (lambda: tmj.MuJoCo(timestep="1 ms"), ("timestep = '1 ms'", "> 0 s")),  # type: ignore[arg-type]
    "an integrator that is none": (lambda: tmj.MuJoCo(integrator="rk5"), ("integrator", "'rk5'", "rk4")),  # type: ignore[arg-type]
    "a duration below zero": (lambda: tmj.simulate(prism(), duration=-1.0), ("duration", "-1.0", "> 0")),
    "a law of wrong size": (
        lambda: tmj.simulate(prism(), lambda t, n, v: np.zeros(3), duration=0.01),
        ("3", "12"),
    ),
    "a class in place of a law": (
        lambda: tmj.simulate(prism(), np.ndarray),
        ("controller = ", "an object, not a class"),
    ),
    "a law that is a number": (lambda: tmj.simulate(prism(), 3.0), ("controller = 3.0", "must be a function")),  # type: ignore[arg-type]
    "a rod on one node": (lambda: tmj.Rod("r", ("a",), 1.0, 0.01), ("r", "nodes", "two")),  # type: ignore[arg-type]
    "a massless rod": (lambda: tmj.Rod("r", ("a", "b"), 0.0, 0.01), ("r", "mass = 0.0", "> 0 kg")),
    "a rod that is not there": (
        lambda: tmj.Structure("s", {"a": (0, 0, 0)}, rods=(tmj.Rod("r", ("a", "b"), 1.0),)),
        ("rod 'r'", "unknown node 'b'", "the nodes are 'a'"),
    ),
    "a control period of zero": (lambda: tmj.Actuation.hold_rest_length(0.0), ("period", "0.0", "> 0 s")),
    "a law of a scene without one": (lambda: tmj.controllers.from_scene(tmj.load_scene("tbar")), ("tbar", "control")),
    "a run of another structure": (
        lambda: tmj.compare(tmj.simulate(prism(), None, duration=0.01), tmj.simulate("tbar", duration=0.01)),
        ("prism", "tbar"),
    ),
    "a film of another kind": (
        lambda: tmj.render(tmj.simulate(prism(), None, duration=0.01), "film.avi"),
        ("film.avi", "must end in .mp4"),
    ),
    "a scene that is a number": (lambda: tmj.load_scene(3), ("3", "path")),  # type: ignore[arg-type]
    "a file that is not there": (lambda: tmj.Trajectory.load("none.nc"), ("none.nc", "no such file")),
}


def check(message: str, words: tuple[str, ...]) -> None:
    """One line of readable length, with the words."""
    assert "\n" not in message
    assert len(message) <= 620
    assert "Traceback" not in message
    for word in words:
        assert word in message, message


@pytest.fixture
def _folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "text.nc").write_text("no netcdf")
    (tmp_path / "empty.toml").write_text("")
    (tmp_path / "bytes.toml").write_bytes(b"\xff\xfe\x00")
    (tmp_path / "folder").mkdir()


@pytest.mark.usefixtures("_folder")
@pytest.mark.parametrize("line", COMMANDS)
def test_command_lines(line: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(line.split()) == 2
    captured = capsys.readouterr()
    said = [one for one in captured.err.splitlines() if not re.match("tensegrity-mj: compiling |warning: ", one)]
    assert len(said) == 1
    assert said[0].startswith("tensegrity-mj: ")
    assert captured.out == ""
    check(said[0], COMMANDS[line])


@pytest.mark.parametrize("change", FILES, ids=lambda change: f"{change[0]} to {change[1]}".replace("\n", " "))
def test_scene_files(change: tuple[str, str]) -> None:
    found = re.search(r"```toml\n(format = 1.*?)```", (ROOT / "docs/format.md").read_text(encoding="utf-8"), re.DOTALL)
    assert found
    text = found[1]
    assert change[0] in text
    scene_from_toml(text)
    with pytest.raises(tmj.TensegrityError) as error:
        scene_from_toml(text.replace(*change, 1), where="my.toml")
    assert str(error.value).startswith("my.toml: ")
    check(str(error.value), FILES[change])


@pytest.mark.parametrize("what", CALLS)
def test_calls(what: str) -> None:
    call, words = CALLS[what]
    with pytest.raises(tmj.TensegrityError) as error:
        call()
    check(str(error.value), words)


def test_there_are_enough_of_them() -> None:
    assert len(COMMANDS) + len(FILES) + len(CALLS) >= 76
