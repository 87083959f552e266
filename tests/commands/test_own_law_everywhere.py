"""A law of one's own, path.py:name or module:name, in every command that has laws; and what is wrong with one."""

from __future__ import annotations

import json
import textwrap
from importlib.metadata import EntryPoint
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import tensegrity_mj as tmj
from tensegrity_mj.cli import main
from tensegrity_mj.controllers import LAWS, from_scene
from tensegrity_mj.errors import FormatError, OptionError, SceneError

LAWS_PY = '''
from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

import numpy as np


class Way(Enum):
    IN = "in"
    OUT = "out"


def hold(time, nodes, velocities, level: float = 0.1, *, way: Way = Way.IN):
    """The same force density in every string."""
    return np.full(3, level if way is Way.IN else 2 * level)


def made(scene, level: float, count: int = 1):
    """Makes a law with an option that it needs."""
    return lambda time, nodes, velocities: np.full(len(scene.structure.strings), count * level)


@dataclass
class Brake:
    """A dataclass, whose annotations are texts."""

    scene: object
    gain: float = 0.5
    floor: float = 0.05

    def __call__(self, time, nodes, velocities):
        structure = self.scene.structure
        return self.floor * np.arange(1.0, 4.0) + self.gain * np.maximum(0.0, structure.string_rates(nodes, velocities))


def any_option(scene, **options):
    return lambda time, nodes, velocities: np.full(3, options["level"])


held = Brake(None)
number = 3


def broken(scene):
    return 1 / 0


def nothing(scene):
    pass


class Jumps:
    discontinuous = "it jumps"

    def __call__(self, time, nodes, velocities):
        return np.full(3, 0.1 if time < 0.1 else 0.2)
'''


@pytest.fixture
def laws(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A file of laws in a folder that is the current one and where modules are found."""
    path = tmp_path / "own_laws.py"
    path.write_text(LAWS_PY, encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    return path


def answer(capsys: pytest.CaptureFixture[str], words: str, code: int = 0) -> Any:
    capsys.readouterr()
    assert main([*words.split(), "--json"]) == code
    return json.loads(capsys.readouterr().out)


SHORT = "--duration 0.05"


@pytest.mark.usefixtures("laws")
@pytest.mark.parametrize("place", ["own_laws.py", "own_laws"])
def test_run_and_compare(place: str, capsys: pytest.CaptureFixture[str]) -> None:
    for law, u in (
        (f"{place}:hold", 0.1),
        (f"{place}:hold --law-option level=0.3", 0.3),
        (f"{place}:hold --law-option level=0.3 --law-option way=out", 0.6),
        (f"{place}:made --law-option level=1 --law-option count=2", 2.0),
        (f"{place}:any_option --law-option level=0.25", 0.25),
    ):
        found = answer(capsys, f"run pinned_rod --law {law} {SHORT}")
        assert found["max_force_density"] == pytest.approx(u, rel=1e-12)
    # The first order of what both engines' integrators leave of a smooth motion of 0.05 s is below 1e-8.
    found = answer(capsys, f"compare pinned_rod --law {place}:Brake --law-option gain=0.2 {SHORT}")
    assert found["max_node_error"] < 1e-8
    assert found["max_force_density_error"] < 1e-6


@pytest.mark.usefixtures("laws")
def test_the_run_says_which_options_a_function_had(tmp_path: Path) -> None:
    assert main(f"run pinned_rod --law own_laws.py:hold --law-option level=0.3 {SHORT} --out r.nc".split()) == 0
    assert tmj.Trajectory.load("r.nc").provenance["controller"] == {"law": "hold", "options": {"level": 0.3}}


@pytest.mark.usefixtures("laws")
def test_linearize(capsys: pytest.CaptureFixture[str]) -> None:
    found = answer(capsys, "linearize pinned_rod --law own_laws.py:Brake --law-option gain=0.2 --inputs force-density")
    scene = tmj.load_scene("pinned_rod")
    # By hand: u = floor + gain max(0, dL/dt). At rest the gain is at its kink, and the closed loop the mean of both
    # sides: ∂u/∂ẋ = gain/2 ∂(dL/dt)/∂ẋ, and dL/dt = ∂L/∂x ẋ at rest, whose slopes are those of lengths.
    model = tmj.linearize(scene, inputs=tmj.Command.FORCE_DENSITY)
    structure, n, h = scene.structure, len(model.coordinates), 1e-6
    from tensegrity_mj.linearization.chart import Chart

    chart = Chart(structure, scene.nodes0)
    slopes = np.array(
        [
            (
                structure.string_lengths(chart.state(h * unit, 0 * unit)[0])
                - structure.string_lengths(chart.state(-h * unit, 0 * unit)[0])
            )
            / (2 * h)
            for unit in np.eye(n)
        ]
    ).T
    gain = np.array(found["gain"])
    # Central differences of lengths of about 1 m: ε/h = 2e-10, and h²/6 of third derivatives of about 1.
    np.testing.assert_allclose(gain[:, n:], 0.1 * slopes, atol=1e-9)
    np.testing.assert_allclose(gain[:, :n], 0, atol=1e-9)


@pytest.mark.usefixtures("laws")
def test_stability(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    scene = tmj.save_scene(tmj.load_scene("pinned_rod").with_(duration=0.02), tmp_path / "scene.toml")

    def limit(law: str) -> float:
        return answer(capsys, f"stability {scene} --engines euler {law}")["start"]["engines"]["euler"]["start"]["limit"]

    # A damper c = gain·L of a string acts against a mass: semi-implicit Euler is stable to h = 2/(c/m) in the limit of
    # much damping, and so ten times the gain has a tenth of the limit.
    weak, strong = (limit(f"--law own_laws.py:Brake --law-option gain={gain}") for gain in (100.0, 1000.0))
    assert weak / strong == pytest.approx(10, rel=0.05)
    assert limit("--law none") == limit("--open-loop")


@pytest.mark.workers
@pytest.mark.usefixtures("laws")
def test_sweep_in_worker_processes_knows_a_changed_law(
    laws: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = "sweep pinned_rod --law own_laws.py:hold --vary law.level=0.1,0.2 --set scene.duration=0.05 --workers 2"
    found = answer(capsys, f"{words} --out {tmp_path / 'study'}")
    assert [one["outcome"]["values"]["max_force_density"] for one in found["outcomes"]] == pytest.approx([0.1, 0.2])
    assert answer(capsys, f"{words} --out {tmp_path / 'study'}")["computed"] == 0
    laws.write_text(LAWS_PY.replace("np.full(3, level if", "np.full(3, 2 * level if"), encoding="utf-8")
    message = answer(capsys, f"{words} --out {tmp_path / 'study'}", 2)["error"]
    assert "another study" in message
    assert "law" in message
    found = answer(capsys, f"{words} --out {tmp_path / 'other'}")
    assert [one["outcome"]["values"]["max_force_density"] for one in found["outcomes"]] == pytest.approx([0.2, 0.4])


@pytest.mark.usefixtures("laws")
def test_sweep_over_laws_and_factors_of_defaults(capsys: pytest.CaptureFixture[str]) -> None:
    short = "--set scene.duration=0.05 --backend this-process"
    found = answer(capsys, f"sweep pinned_rod --vary law=own_laws.py:hold,own_laws:Brake,lyapunov,none {short}")
    assert found["outcomes"][0]["point"]["parameters"]["law"] == "own_laws.py:hold"
    peaks = [one["outcome"]["values"]["max_force_density"] for one in found["outcomes"]]
    assert peaks[0] == pytest.approx(0.1)
    assert len(set(peaks)) == 4
    found = answer(capsys, f"sweep pinned_rod --law own_laws.py:hold --vary law.level=*2,*3 {short}")
    assert [one["outcome"]["values"]["max_force_density"] for one in found["outcomes"]] == pytest.approx([0.2, 0.3])
    found = answer(capsys, f"sweep pinned_rod --law own_laws.py:hold --law-option way=out {short}")
    assert found["outcomes"][0]["outcome"]["values"]["max_force_density"] == pytest.approx(0.2)


@pytest.mark.usefixtures("laws")
def test_tradeoff_and_validate(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    law = "--law own_laws.py:Brake --law-option floor=0.1"
    words = f"tradeoff pinned_rod {law} --loops closed --engines mujoco --families RK4 --actuations continuous"
    (study,) = answer(capsys, f"{words} --steps 0.01 --repeats 1 --duration 0.5")["scenes"]
    assert study["law"]["from"] == "own_laws.py:Brake"
    assert study["law"]["options"] == {"floor": 0.1}
    assert len(study["law"]["sha256"]) == 64
    words = f"validate pinned_rod {law} --only mass --quick --engines mujoco {SHORT} --timestep 5e-3 --workers 2"
    report = answer(capsys, words)
    assert report["law"]["options"] == {"floor": 0.1}
    # From rest the tip moves u f(x) t²/2 to the first order, and so the distance from the target changes by u c.
    scene = tmj.load_scene("pinned_rod")
    aim = [0.0, 0.816496580927726, 0.5773502691896257]
    start = np.linalg.norm(scene.nodes0[scene.structure.node_index["n1"]] - aim)
    twice = answer(capsys, words.replace("floor=0.1", "floor=0.2"))
    once, more = (one["nominal"]["engines"]["mujoco"]["error"]["final"] - start for one in (report, twice))
    assert more / once == pytest.approx(2, rel=0.01)


# What is wrong ---------------------------------------------------------------------------------------------------

WRONG = {
    "own_laws.py:hold --law-option levle=1": r"no option 'levle' \(did you mean 'level'\?\); allowed: level, way",
    "own_laws.py:hold --law-option level=high": "law own_laws.py:hold: level = 'high'; it must be a finite number",
    "own_laws.py:hold --law-option way=outt": r"way = 'outt' \(did you mean 'out'\?\); it must be one of Way.IN,",
    "own_laws.py:made": "option 'level' is missing; it needs a value",
    "own_laws.py:made --law-option level=1 --law-option count=1.5": "count = 1.5; it must be an integer",
    "own_laws.py:held --law-option gain=1": "there is no option 'gain': it takes none, which is an object",
    "own_laws.py:nothing": "law own_laws.py:nothing: it made None; it must return a law",
    "own_laws.py:broken": r"it fails where it is made: ZeroDivisionError: division by zero \(own_laws.py, line \d+\)",
    "own_laws.py:number": "law own_laws.py:number = 3: it must be a function",
    "own_laws.py:holt": r"there is no law 'holt' \(did you mean 'hold'\?\); allowed: Way, hold, made",
    "own_laws.py": r"name the law in that file, too: own_laws.py:name",
    "own_lows.py:hold": r"there is no file own_lows.py \(did you mean 'own_laws.py'\?\)",
    "own_laws.py:": "write module:name or path.py:name",
    "no_such_module:hold": "module 'no_such_module' cannot be imported",
    "bad.py:hold": r"the file fails: SyntaxError",
    "raises.py:hold": r"the file fails: KeyError: 'x' \(raises.py, line 2\)",
    "exits.py:hold": r"the file fails: SystemExit: 0 \(exits.py, line 1\)",
    "quits.py:hold": r"a law, or what else the command runs, exits: SystemExit: 0",
    "quits.py:Made": r"it fails where it is made: SystemExit: 0 \(quits.py, line 6\)",
    "own_laws.py:hold --law-option level=1 --law-option level=2": "--law-option level: it is given twice; give each",
    "binary.py:hold": "cannot be read",
    "lyapunof": r"unknown law 'lyapunof' \(did you mean 'lyapunov'\?\); allowed: .* and path.py:name",
    "none --law-option level=1": "--law-option needs a control law, and --law none was given",
}


@pytest.mark.usefixtures("laws")
@pytest.mark.parametrize("words", WRONG)
def test_what_is_wrong_is_one_line(words: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "bad.py").write_text("def hold(:\n", encoding="utf-8")
    (tmp_path / "raises.py").write_text("\n{}['x']\n", encoding="utf-8")
    (tmp_path / "exits.py").write_text("raise SystemExit(0)\n", encoding="utf-8")
    quits = "def hold(time, nodes, velocities):\n    raise SystemExit(0)\n\nclass Made:\n"
    quits += "    def __init__(self, scene):\n        raise SystemExit(0)\n"
    (tmp_path / "quits.py").write_text(quits, encoding="utf-8")
    (tmp_path / "binary.py").write_bytes(b"\xff\xfe\x00")
    assert main(f"run pinned_rod --law {words} {SHORT}".split()) == 2
    err = capsys.readouterr().err
    assert err.count("\n") == 1
    with pytest.raises(OptionError, match=WRONG[words]):
        raise OptionError(err.strip())


@pytest.mark.usefixtures("laws")
@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("sweep pinned_rod --law own_laws.py:holt", "there is no law 'holt' (did you mean 'hold'?)"),
        ("sweep pinned_rod --law own_laws.py:hold --vary law.levle=1", "no option 'levle' (did you mean 'level'?)"),
        ("sweep pinned_rod --vary law=own_laws.py:holt", "there is no law 'holt' (did you mean 'hold'?)"),
        *(
            (f"{one} pinned_rod --law own_laws.py:hold --law-option level=1 --law-option level=2", "it is given twice")
            for one in ("tradeoff", "validate", "linearize")
        ),
        ("sweep pinned_rod --law-option a=1 --set law.a=2", "a parameter is given twice"),
        ("stability pinned_rod --open-loop --law own_laws.py:hold", "--law is of the closed loop, and --open-loop"),
        ("stability pinned_rod --law own_laws.py:Jumps", "--law own_laws.py:Jumps: it jumps"),
        ("linearize pinned_rod --law-option a=1", "--law-option needs --law, or --closed-loop"),
        ("linearize pinned_rod --closed-loop --law none", "--closed-loop: scene 'pinned_rod' names no control law"),
        (
            "tradeoff pinned_rod --law own_laws.py:hold --law-option levle=1",
            "no option 'levle' (did you mean 'level'?)",
        ),
        (
            "validate pinned_rod --law own_laws.py:hold --law-option levle=1",
            "no option 'levle' (did you mean 'level'?)",
        ),
        ("run tbar --law-option level=1", "--law-option needs a control law, and scene 'tbar' has none: add --law"),
    ],
)
def test_what_is_wrong_in_other_commands(words: str, message: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(words.split()) == 2
    err = capsys.readouterr().err
    assert message in err
    assert err.count("\n") == 1


# Scene files -----------------------------------------------------------------------------------------------------


@pytest.fixture
def package(laws: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """An installed package with a law and a family, and with entry points that cannot be loaded."""
    (laws.parent / "own_families.py").write_text(
        textwrap.dedent(
            """
            import tensegrity_mj as tmj
            from tensegrity_mj.library.cross import cross

            def two_rods(duration: float = 3.0, plain=None):
                return cross().with_(duration=duration)

            def no_scene():
                return 3
            """
        ),
        encoding="utf-8",
    )
    points = {
        "tensegrity_mj.laws": {"brake": "own_laws:Brake", "lost": "own_laws:gone"},
        "tensegrity_mj.families": {"two_rods": "own_families:two_rods", "no_scene": "own_families:no_scene"},
    }

    def found(group: str) -> list[EntryPoint]:
        return [EntryPoint(name, value, group) for name, value in points.get(group, {}).items()]

    monkeypatch.setattr("importlib.metadata.entry_points", found)


@pytest.mark.usefixtures("package")
def test_a_scene_names_an_installed_law(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    scene = tmj.load_scene("pinned_rod").with_(control=tmj.model.ControlSpec("brake", {"floor": 0.2}))
    path = tmj.save_scene(scene, tmp_path / "scene.toml")
    assert tmj.load_scene(path).control == scene.control
    assert from_scene(scene).floor == 0.2
    assert from_scene(scene, gain=2).gain == 2.0
    assert [*LAWS][-2:] == ["brake", "lost"]
    found = answer(capsys, f"sweep {path} --vary law.floor=0.3,*2 --set scene.duration=0.05 --backend this-process")
    assert [one["outcome"]["values"]["max_force_density"] for one in found["outcomes"]] == pytest.approx(
        [0.9, 1.2], rel=0.2
    )
    for words, message in {
        f"run {path} --law brak": "unknown law 'brak' (did you mean 'brake'?); allowed: feedback_linearization, ",
        f"run {path} --law-option gian=1": "law brake: there is no option 'gian' (did you mean 'gain'?)",
        f"run {path} --law lost": "entry point 'lost' of 'tensegrity_mj.laws': own_laws:gone cannot be loaded "
        "(AttributeError",
    }.items():
        assert main([*words.split(), *SHORT.split()]) == 2
        assert message in capsys.readouterr().err


@pytest.mark.usefixtures("package")
def test_the_study_of_a_scene_with_an_installed_law_knows_its_source() -> None:
    scene = tmj.load_scene("pinned_rod").with_(control=tmj.model.ControlSpec("brake", {}))
    assert len(tmj.studies.Sweep(scene).common()["law"]["sha256"]) == 64
    assert tmj.studies.Sweep("pinned_rod").common()["law"] is None


@pytest.mark.usefixtures("laws")
@pytest.mark.parametrize("law", ["own_laws.py:hold", "own_laws:hold", "/etc/own_laws.py"])
def test_no_scene_file_names_a_path(law: str, tmp_path: Path) -> None:
    text = tmj.model.text.scene_to_toml(tmj.load_scene("pinned_rod")).replace('law = "lyapunov"', f'law = "{law}"')
    (tmp_path / "scene.toml").write_text(text, encoding="utf-8")
    with pytest.raises(SceneError, match=r"control.*a scene names a law by its name alone.*--law.*entry point"):
        tmj.load_scene(tmp_path / "scene.toml")


@pytest.mark.usefixtures("package")
def test_an_installed_family_is_called_by_commands_and_scene_files(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert tmj.load_scene("two_rods(duration=2)").duration == 2.0
    assert tmj.load_scene("two_rods(plain=[1, 'a'])").duration == 3.0
    found = answer(capsys, "sweep two_rods() --vary family.duration=0.01,0.02 --set law=none --backend this-process")
    assert [one["outcome"]["status"] for one in found["outcomes"]] == ["done", "done"]
    for text in ("two_rods()", "cross()"):
        path = tmp_path / "scene.toml"
        path.write_text(f'format = 1\nname = "mine"\nstructure = "{text}"\n\n[scene]\nduration = 1.0\n')
        scene = tmj.load_scene(path)
        assert scene.structure == tmj.load_scene("cross()").structure
        assert (scene.name, scene.duration, scene.target) == ("mine", 1.0, None)
    for text, message in {
        "two_rod()": r"unknown family 'two_rod' \(did you mean 'two_rods'\?\)",
        "two_rods(duration='long')": "duration = 'long'; it must be a finite number",
        "no_scene()": "no_scene: this family made 3; it must make a Scene",
    }.items():
        with pytest.raises(FormatError, match=message):
            tmj.load_scene(text)
