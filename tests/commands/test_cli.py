"""The command line: what it prints where, its exit codes, and that bad input is refused before anything runs."""

from __future__ import annotations

import argparse
import contextlib
import json
import math
import os
import re
import shlex
import signal
import stat
import subprocess
import sys
import termios
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command_words import choices_of

import tensegrity_mj as tmj
from tensegrity_mj import errors
from tensegrity_mj.basics.jsontext import to_json
from tensegrity_mj.cli import GROUPS, build_parser, main
from tensegrity_mj.commands import common, experiment, scenes
from tensegrity_mj.commands.common import ExitCode, Outcome
from tensegrity_mj.commands.doctor import Check
from tensegrity_mj.commands.parser import commands_of_others, words_of
from tensegrity_mj.pictures.page import write_report

COMMANDS = {
    " ".join(filter(None, (name, inner))): command
    for group in [*GROUPS.values(), *commands_of_others().values()]
    for name, module in group.items()
    for inner, command in getattr(module, "COMMANDS", {"": module}).items()
}
Answer = tuple[int, dict[str, Any], str]


def ask(capsys: pytest.CaptureFixture[str], *arguments: object) -> Answer:
    """Exit code, the JSON object on stdout (it must be the only thing there), and stderr."""
    code = main([*map(str, arguments), "--json"])
    captured = capsys.readouterr()
    lines = captured.out.splitlines()
    assert len(lines) == 1, captured.out
    return code, json.loads(lines[0], parse_constant=lambda name: pytest.fail(f"{name} is no JSON")), captured.err


def shell(*arguments: str, **options: Any) -> subprocess.CompletedProcess[str]:
    """The command in a process of its own."""
    return subprocess.run(
        [sys.executable, "-m", "tensegrity_mj", *arguments], capture_output=True, text=True, timeout=300, **options
    )


@pytest.fixture
def no_simulation(monkeypatch: pytest.MonkeyPatch) -> None:
    """Make any simulation a failure: what is refused must be refused before."""

    def refuse(*args: object, **kwargs: object) -> None:
        pytest.fail("it was simulated although the input is bad")

    monkeypatch.setattr("tensegrity_mj.simulation.simulate", refuse)


# Help and parsing ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_explains_itself(command: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as end:
        main([*command.split(), "--help"])
    text = capsys.readouterr().out
    assert end.value.code == 0
    assert "example" in text
    assert f"tensegrity-mj {command}" in text.partition("example")[2]
    assert "--json" in text
    assert "exit codes:" in text


@pytest.mark.parametrize("command", COMMANDS)
def test_every_example_parses(command: str) -> None:
    examples = words_of(COMMANDS[command])["examples"]
    calls = [line.partition(" > ")[0] for line in examples.splitlines() if "tensegrity-mj " in line]
    lines = [shlex.split(call, comments=True) for call in calls]
    assert lines
    for words in lines:
        assert build_parser().parse_args(words[1:]).command == command


def test_the_page_of_the_command_line_has_every_command_and_each_parses() -> None:
    text = (Path(__file__).resolve().parents[2] / "docs" / "command-line.md").read_text(encoding="utf-8")
    lines = [line.partition("#")[0].split() for line in text.splitlines() if line.startswith("tensegrity-mj ")]
    named = [" ".join(words[1 : 3 if words[1] == "audit" else 2]) for words in lines]
    assert set(named) == set(COMMANDS)
    assert list(dict.fromkeys(named)) == list(COMMANDS)  # in the order of --help
    assert all(f"| {code:d} |" in text for code in ExitCode)
    for words, command in zip(lines, named, strict=True):
        assert build_parser().parse_args(words[1:]).command == command


def test_help_and_parsing_load_no_heavy_library() -> None:
    # This, and not a clock, is what keeps --help fast.
    code = (
        "import sys\n"
        "from tensegrity_mj.cli import build_parser\n"
        "build_parser().format_help()\n"
        "heavy = {'numpy', 'scipy', 'numba', 'mujoco', 'matplotlib', 'h5netcdf', 'mediapy', 'dm_control'}\n"
        "sys.exit(' '.join(sorted(heavy & set(sys.modules))) or 0)\n"
    )
    child = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert child.returncode == 0, child.stderr


def test_a_package_that_is_there_and_cannot_be_imported_is_named(tmp_path: Path) -> None:
    (tmp_path / "mujoco").mkdir()
    (tmp_path / "mujoco" / "__init__.py").write_text("raise ImportError('no core')", encoding="utf-8")
    for backend in ("", "egl"):
        child = subprocess.run(
            [sys.executable, "-m", "tensegrity_mj", "run", "prism"],
            capture_output=True,
            text=True,
            env={**os.environ, "PYTHONPATH": str(tmp_path), "MUJOCO_GL": backend},
        )
        assert child.returncode == 5
        assert "cannot be imported" in child.stderr
        assert "no core" in child.stderr
        assert "tensegrity-mj doctor" in child.stderr
        assert "Traceback" not in child.stderr


def test_choices_are_the_values_of_the_enums() -> None:
    for option, kind in (
        ("--integrator", tmj.Integrator),
        ("--method", tmj.Method),
        ("--drift", tmj.engines.Drift),
        ("--on-infeasible", tmj.OnInfeasible),
    ):
        others = {"dopri8"} if option == "--method" else set()  # of JAX alone
        assert set(choices_of("run", option)) == {item.value for item in kind} | others
    assert choices_of("run", "--norm") == list(experiment.NORMS)
    layouts = choices_of("render", "--layout")
    assert {name.replace("-", "_").upper() for name in layouts} == {item.name for item in tmj.pictures.Layout}


def test_version(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--version"]) == 0
    assert capsys.readouterr().out.strip().count(".") == 2


@pytest.mark.parametrize(
    "arguments",
    [
        [],
        ["no-such-command"],
        ["run"],
        ["run", "prism", "--no-such-option"],
        ["run", "prism", "--engine", "bullet"],
        ["run", "prism", "--timestep", "0"],
        ["run", "prism", "--timestep", "-1e-3"],
        ["run", "prism", "--timestep", "nan"],
        ["run", "prism", "--duration", "inf"],
        ["run", "prism", "--duration", "soon"],
        ["run", "prism", "--norm", "3"],
        ["run", "prism", "--dur", "1"],  # no abbreviations: they break when an option is added
        ["render", "a.nc"],
        ["render", "a.nc", "--out", "a.mp4", "--size", "1280"],
        ["render", "a.nc", "--out", "a.mp4", "--size", "1281x720"],
        ["render", "a.nc", "--out", "a.mp4", "--size", "99999x720"],
        ["export", "prism"],
        ["compare"],
    ],
)
@pytest.mark.usefixtures("no_simulation")
def test_bad_usage_gives_2_and_an_answer(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    code, answer, err = ask(capsys, *arguments)
    assert code == 2
    assert answer["status"] == "error"
    assert answer["error"]
    assert answer["error"] in err
    assert err == f"tensegrity-mj: {answer['error']}\n"  # one line, without the usage


# Exit codes ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("error", "code", "status"),
    [
        (errors.StructureError("x"), 2, "error"),
        (errors.SceneError("x"), 2, "error"),
        (errors.FormatError("x"), 2, "error"),
        (errors.OptionError("x"), 2, "error"),
        (errors.ControllerError("x"), 2, "error"),
        (errors.InfeasibleError("x"), 3, "infeasible"),
        (errors.DivergenceError("x", 0.5), 4, "diverged"),
        (errors.MissingLibraryError("x"), 5, "error"),
        (ModuleNotFoundError("No module named 'h5netcdf'", name="h5netcdf"), 5, "error"),
        (KeyboardInterrupt(), 130, "interrupted"),
    ],
    ids=lambda value: type(value).__name__ if isinstance(value, BaseException) else str(value),
)
def test_exit_codes(
    error: BaseException, code: int, status: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(options: argparse.Namespace) -> Outcome:
        raise error

    monkeypatch.setattr(scenes, "execute", fail)
    got, answer, err = ask(capsys, "scenes")
    assert got == code
    assert answer["status"] == status
    assert answer["error"] in err
    assert "Traceback" not in err
    assert str(code) in common.EXIT_CODES


@pytest.mark.parametrize("error", [ZeroDivisionError("a mistake of ours"), ModuleNotFoundError(name="tensegrity_mj.x")])
def test_our_own_mistakes_stay_tracebacks(error: Exception, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(options: argparse.Namespace) -> Outcome:
        raise error

    monkeypatch.setattr(scenes, "execute", fail)
    with pytest.raises(type(error)):
        main(["scenes"])


@pytest.mark.parametrize(
    ("error", "code"),
    [
        (ZeroDivisionError("a mistake of ours"), 1),
        (ModuleNotFoundError("No module", name="tensegrity_mj.x"), 1),
        (MemoryError("no room"), 1),
        (PermissionError(13, "Permission denied", "some/file"), 2),
    ],
    ids=lambda value: type(value).__name__ if isinstance(value, BaseException) else str(value),
)
def test_json_answers_whatever_happens(
    error: Exception, code: int, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(options: argparse.Namespace) -> Outcome:
        raise error

    monkeypatch.setattr(scenes, "execute", fail)
    got, answer, err = ask(capsys, "scenes")
    assert (got, answer["status"]) == (code, "error")
    assert str(error) in answer["error"]
    assert ("Traceback" in err) == (code == 1)


def test_every_status_has_a_code() -> None:
    codes = {status.value: common.code_of_status(status) for status in tmj.Status}
    assert codes == {"completed": 0, "infeasible": 3, "diverged": 4, "singular": 6}


# What goes where -------------------------------------------------------------------------------------------


def test_json_is_strict() -> None:
    data = {
        "nan": math.nan,
        "infinite": [math.inf, np.float64("nan")],
        "numpy": np.array([[1, 2], [3, 4]]),
        "number": np.float32(0.5),
        "enum": ExitCode.DIVERGED,
        "path": Path("a b.nc"),
        "none": None,
        "truth": np.bool_(True),
    }
    assert json.loads(to_json(data)) == {
        "nan": None,
        "infinite": [None, None],
        "numpy": [[1, 2], [3, 4]],
        "number": 0.5,
        "enum": 4,
        "path": "a b.nc",
        "none": None,
        "truth": True,
    }


def test_nothing_but_the_answer_reaches_stdout() -> None:
    # A library that prints, from Python and below it, must not spoil the JSON.
    code = (
        "import os, sys\n"
        "from tensegrity_mj import cli\n"
        "from tensegrity_mj.commands import scenes\n"
        "from tensegrity_mj.commands.common import Outcome\n"
        "def noisy(options):\n"
        "    print('from Python')\n"
        "    os.write(1, b'from below\\n')\n"
        "    os.system('echo from a child')\n"
        "    return Outcome({'status': 'ok'})\n"
        "scenes.execute = noisy\n"
        "sys.exit(cli.main(['scenes', '--json']))\n"
    )
    child = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert child.returncode == 0, child.stderr
    assert child.stdout == '{"status": "ok"}\n'
    for source in ("Python", "below", "a child"):
        assert f"from {source}" in child.stderr


def test_a_reader_that_goes_away_is_no_error() -> None:
    read, write = os.pipe()
    os.close(read)
    with os.fdopen(write, "w") as out:
        child = subprocess.run(
            [sys.executable, "-m", "tensegrity_mj", "scenes"], stdout=out, stderr=subprocess.PIPE, text=True
        )
    assert child.returncode == 0
    assert child.stderr == ""


# Output files ----------------------------------------------------------------------------------------------


@pytest.mark.usefixtures("no_simulation")
@pytest.mark.parametrize(
    ("where", "words"), [(">/dev/full", "scenes --json"), (">&-", "scenes prism"), (">/dev/full", "--version")]
)
def test_an_answer_that_cannot_be_printed_is_one_message(where: str, words: str) -> None:
    command = f"{shlex.quote(sys.executable)} -m tensegrity_mj {words}"
    done = subprocess.run(["sh", "-c", f"{command} {where}"], capture_output=True, text=True)
    assert done.returncode == 2
    assert re.fullmatch(
        r"tensegrity-mj: the answer cannot be printed on stdout \(.*\); the work is done.*\n", done.stderr
    )


def test_outputs_are_checked_before_the_simulation(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "folder.nc").mkdir()
    (tmp_path / "file").write_text("")
    os.mkfifo(tmp_path / "pipe.nc")
    cases = [
        ("--out", tmp_path / "missing" / "p.nc", "there is no folder"),
        ("--out", tmp_path / "file" / "p.nc", "there is no folder"),
        ("--out", tmp_path / "folder.nc", "that is a folder"),
        ("--out", tmp_path / "pipe.nc", "no regular file"),
        ("--out", tmp_path / "p.txt", "must end in .nc"),
        ("--video", tmp_path / "missing" / "p.mp4", "there is no folder"),
        ("--video", tmp_path / "p.avi", "must end in .mp4"),
        ("--plot", tmp_path / "p.nc", "must end in .png"),
    ]
    for option, path, complaint in cases:
        code, answer, _ = ask(capsys, "run", "prism", option, path)
        assert code == 2
        assert answer["error"].startswith(f"{option} {path}: ")
        assert complaint in answer["error"]
    for option, path in (("--out", "missing/"), ("--out", "missing/prefix"), ("--plot", "missing/p.png")):
        assert ask(capsys, "compare", "prism", option, f"{tmp_path}/{path}")[0] == 2
    assert ask(capsys, "render", "a.nc", "--out", tmp_path / "missing" / "a.mp4")[0] == 2
    assert ask(capsys, "export", "prism", "--out", tmp_path / "prism.obj")[0] == 2
    assert sorted(path.name for path in tmp_path.iterdir()) == ["file", "folder.nc", "pipe.nc"]


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write anywhere")
@pytest.mark.usefixtures("no_simulation")
def test_unwritable_folders_and_files_are_found_before(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "old.nc").write_text("")
    (tmp_path / "old.nc").chmod(stat.S_IRUSR)
    code, answer, _ = ask(capsys, "run", "prism", "--out", tmp_path / "old.nc")
    assert code == 2
    assert "read-only" in answer["error"]
    tmp_path.chmod(stat.S_IRUSR | stat.S_IXUSR)
    code, answer, _ = ask(capsys, "run", "prism", "--out", tmp_path / "new.nc")
    tmp_path.chmod(stat.S_IRWXU)
    assert code == 2
    assert "may not write" in answer["error"]


@pytest.mark.skipif(not Path("/proc/self").is_dir(), reason="needs a folder that takes no new files")
@pytest.mark.usefixtures("no_simulation")
def test_folders_that_take_no_files_are_found_before(capsys: pytest.CaptureFixture[str]) -> None:
    code, answer, _ = ask(capsys, "run", "prism", "--out", "/proc/x.nc")
    assert code == 2
    assert answer["error"].startswith("--out /proc/x.nc: ")


@pytest.mark.usefixtures("no_simulation")
def test_a_replay_cannot_overwrite_its_source(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    source = tmp_path / "a.nc"
    source.write_text("precious")
    code, answer, _ = ask(capsys, "run", "prism", "--replay", source, "--out", tmp_path / "." / "a.nc")
    assert code == 2
    assert "--replay and --out" in answer["error"]
    assert source.read_text() == "precious"


# Options that do not go together ---------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        ("run prism --engine dae --integrator rk4", "--integrator"),
        ("run prism --method radau", "--method"),
        ("run prism --engine mujoco --rtol 1e-9", "--rtol"),
        ("run prism --atol 1e-9", "--atol"),
        ("run prism --drift normalize", "--drift"),
        ("run prism --engine dae --timestep 1e-3", "timestep"),
        ("run prism --engine dae --method rk4 --timestep 1e-3 --rtol 1e-9", "rtol"),
        ("run prism --law none --norm 2", "--norm"),
        ("run prism --law none --on-infeasible passive", "--on-infeasible"),
        ("run prism --control-period 1e-3", "--control-period"),
        ("run prism --actuation continuous --control-period 1e-3", "--control-period"),
        ("run prism --actuation hold-rest-length", "--control-period"),
        ("run prism --actuation hold-rest-length --control-period 1.5e-3 --timestep 1e-3", "period"),
        ("run prism --norm 1", "1-norm"),
        ("run prism --replay-quantity rest-length", "--replay-quantity"),
        ("run prism --replay a.nc --law lyapunov", "--law"),
        ("run prism --replay a.nc --norm 2", "--norm"),
        ("run prism --replay a.nc", "a.nc: no such file"),
        ("run tbar --norm 2", "--norm"),
        ("run tbar --law lyapunov", "target"),
        ("run nonsense", "nonsense"),
        ("run ./nowhere.toml", "nowhere.toml"),
        ("compare prism tbar", "one scene, or two .nc or .csv files"),
        ("compare a.nc", "give two files, not 1"),
        ("compare a.nc b.nc c.nc", "give two files, not 3"),
        ("compare a.nc b.nc --timestep 1e-3", "--timestep"),
        ("compare a.nc b.nc --norm 2", "--norm"),
        ("compare a.nc b.nc --out both", "--out"),
        ("render a.nc b.nc c.nc --out d.mp4", "one or two files"),
        ("render a.nc --out d.mp4 --layout overlay", "--layout"),
        ("render a.nc --out d.mp4", "a.nc: no such file"),
        ("render a.nc --out d.mp4 --dpi 300", "--dpi needs --still"),
        ("render a.nc --out d.mp4 --still 1.5", "must end in .png"),
        ("render a.nc --out d.png --still 1.5 --fps 20", "--fps belongs to a film"),
        ("run prism --paper page", "--paper needs --plot"),
        ("scenes nonsense", "nonsense"),
        ("export nonsense --out a.xml", "nonsense"),
    ],
)
def test_options_that_contradict_each_other_are_refused(
    arguments: str, named: str, capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    code, answer, err = ask(capsys, *arguments.split())
    assert code == 2, err
    assert named in answer["error"]
    assert "Traceback" not in err
    assert not list(tmp_path.iterdir())


@pytest.mark.usefixtures("no_simulation")
def test_view_without_a_display_says_so_before_the_simulation(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys, "platform", "linux")
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    code, answer, _ = ask(capsys, "run", "prism", "--view")
    assert code == 5
    assert "display" in answer["error"]


@pytest.mark.usefixtures("no_simulation")
def test_video_without_opengl_says_so_before_the_simulation(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("MUJOCO_GL", "disabled")
    code, answer, _ = ask(capsys, "run", "prism", "--video", tmp_path / "p.mp4")
    assert code == 5
    assert "OpenGL" in answer["error"]
    assert "apt-get install" in answer["error"]


# Commands on real scenes -----------------------------------------------------------------------------------


def test_scenes_lists_what_is_shipped(capsys: pytest.CaptureFixture[str]) -> None:
    code, answer, _ = ask(capsys, "scenes")
    assert code == 0
    found = {scene["name"]: scene for scene in answer["scenes"]}
    assert {"pinned_rod", "prism", "tbar"} <= set(found)
    assert (found["prism"]["rods"], found["prism"]["strings"]) == (3, 12)
    assert (found["pinned_rod"]["rods"], found["pinned_rod"]["strings"]) == (1, 3)
    assert "5.5" in found["prism"]["source"]
    assert all(scene["description"] and scene["group"] != "Others" for scene in found.values())
    assert len({scene["description"] for scene in found.values()}) == len(found)
    assert main(["scenes", "--sources"]) == 0
    assert capsys.readouterr().out.count("  from ") == len(found)
    assert main(["scenes"]) == 0
    text = capsys.readouterr().out
    assert all(name in text for name in found)
    # A rod, a string with mass as one, bodies.
    counted = {"pinned_rod": "1 rod, 3 strings", "massive_string": "1 string", "spine": "24 strings, 4 bodies"}
    for name, words in counted.items():
        assert re.search(rf"^  {name} +{words}  ", text, re.MULTILINE)
    assert (found["massive_string"]["strings"], found["spine"]["bodies"]) == (1, 4)


@pytest.mark.parametrize(("name", "rows"), [("spine", {"bodies": "4"}), ("massive_string", {"strings": "1"})])
def test_scenes_counts_what_was_given(name: str, rows: dict[str, str], capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["scenes", name]) == 0
    text = capsys.readouterr().out
    for title, count in rows.items():
        assert re.search(rf"^{title} +{count}$", text, re.MULTILINE)
    assert "where free rods also spin" not in text
    assert "rods:" not in text


def test_scenes_describes_one(capsys: pytest.CaptureFixture[str]) -> None:
    code, prism, _ = ask(capsys, "scenes", "prism")
    assert code == 0
    # Thesis §5.5: three rods of 5 coordinates less the six constraints that take away rigid motion.
    assert prism["degrees_of_freedom"] == 9
    assert prism["rigid_motions"] == 0
    assert len(prism["nodes"]) == 6
    assert [rod["length"] for rod in prism["rods"]] == pytest.approx([1.0] * 3, abs=1e-12)
    assert prism["control"]["law"] == "lyapunov"
    code, rod, _ = ask(capsys, "scenes", "pinned_rod")
    assert rod["degrees_of_freedom"] == 2
    assert rod["rods"][0]["support"] == "pinned at σ = 0"
    code, tbar, _ = ask(capsys, "scenes", "tbar")
    assert tbar["control"] is None
    assert tbar["unbalanced_force"] >= 0.0
    assert isinstance(tbar["can_be_prestressed"], bool)
    assert main(["scenes", "prism"]) == 0
    assert "degrees of freedom" in capsys.readouterr().out


CONTRACT = {
    "status",
    "final_error",
    "max_force_density",
    "min_feasibility_margin",
    "energy_residual",
    "real_time_factor",
    "out",
    "video",
}


@pytest.mark.parametrize("engine", ["mujoco --timestep 1e-2", "dae --rtol 1e-8"])
def test_run_keeps_its_contract(engine: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "p q.nc"
    out.write_text("an old file that is replaced")
    code, answer, err = ask(capsys, "run", "prism", "--engine", *engine.split(), "--duration", "0.1", "--out", out)
    assert code == 0, err
    assert set(answer) >= CONTRACT
    assert answer["status"] == "completed"
    assert answer["out"] == str(out)
    assert answer["video"] is None
    saved = tmj.Trajectory.load(out)
    assert answer["final_error"] == saved.target_error()[-1] > 0
    assert answer["max_force_density"] == saved.max_force_density > 0
    assert answer["min_feasibility_margin"] == saved.min_feasibility_margin > 0
    assert answer["energy_residual"] == saved.energy_residual
    assert answer["real_time_factor"] > 0
    assert answer["duration"] == pytest.approx(0.1, abs=1e-12)
    assert answer["samples"] == len(saved.time)


def test_run_without_a_law_has_no_margin(capsys: pytest.CaptureFixture[str]) -> None:
    code, answer, _ = ask(capsys, "run", "tbar", "--duration", "0.05")
    assert code == 0
    assert answer["min_feasibility_margin"] is None  # NaN is no JSON
    assert answer["final_error"] is None


def test_run_for_people(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["run", "prism", "--duration", "0.05", "--timestep", "1e-2"]) == 0
    text = capsys.readouterr().out
    assert "completed" in text
    assert "energy residual" in text


def test_options_reach_the_simulation(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    requested: dict[str, Any] = {}

    def record(scene: object, law: object, engine: object, **options: object) -> None:
        requested.update(options, scene=scene, law=law, engine=engine)
        raise errors.OptionError("recorded")

    monkeypatch.setattr("tensegrity_mj.simulation.simulate", record)
    words = (
        "run prism --engine dae --method rk4 --timestep 2e-3 --drift baumgarte --duration 3 --norm inf "
        "--decay-rate 0.7 --actuation hold-force-density --control-period 4e-3 --on-infeasible passive"
    )
    assert ask(capsys, *words.split())[1]["error"] == "recorded"
    assert requested["engine"] == tmj.DAE(method=tmj.Method.RK4, timestep=2e-3, drift=tmj.engines.Drift.BAUMGARTE)
    assert requested["duration"] == 3.0
    assert requested["actuation"] == tmj.Actuation.hold_force_density(4e-3)
    assert requested["on_infeasible"] is tmj.OnInfeasible.PASSIVE
    assert requested["law"].norm == math.inf
    assert requested["law"].decay_rate == 0.7
    assert ask(capsys, *"run prism --integrator implicit --timestep 3e-3 --law none".split())[1]["error"] == "recorded"
    assert requested["engine"] == tmj.MuJoCo(timestep=3e-3, integrator=tmj.Integrator.IMPLICIT)
    assert requested["law"] is None
    assert requested["duration"] is None
    words = "run prism --actuation hold-rest-length --control-period 5e-3 --output-interval 1e-2"
    assert ask(capsys, *words.split())[1]["error"] == "recorded"
    assert requested["actuation"] == tmj.Actuation.hold_rest_length(5e-3)
    assert requested["output_interval"] == 1e-2


def test_a_diverged_run_gives_4_and_keeps_what_it_has(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "d.nc"
    # A step far beyond the stability limit of the stiffened T-bar.
    scene = tmj.load_scene("tbar")
    stiff = scene.with_(structure=scene.structure.with_strings(stiffness=1e9, rest_length=0.5))
    tmj.save_scene(stiff, tmp_path / "stiff.toml")
    words = ("run", tmp_path / "stiff.toml", "--timestep", "1e-2", "--duration", "5", "--out", out)
    code, answer, err = ask(capsys, *words)
    assert code == 4
    assert answer["status"] == "diverged"
    assert "Traceback" not in err
    if answer.get("out"):
        assert tmj.Trajectory.load(out).status is tmj.Status.DIVERGED


def test_a_run_that_diverges_where_it_begins_gives_4(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "d.nc"
    words = ("run", "pinned_rod", "--duration", "0.2", "--decay-rate", "1e100", "--out", out)
    code, answer, err = ask(capsys, *words, "--plot", tmp_path / "d.png")
    assert code == 4, err
    assert (answer["status"], answer["samples"], answer["duration"]) == ("diverged", 0, 0.0)
    assert answer["final_error"] is None
    assert answer["plot"] is None  # there is nothing to draw
    assert len(tmj.Trajectory.load(out).time) == 0
    assert main([*map(str, words)]) == 4
    assert "diverged" in capsys.readouterr().out


def test_an_infeasible_run_gives_3(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    # The rod lies in the plane of its strings' anchors, at rest, and is to stand upright: no string pulls it out of
    # the plane (thesis §5.4), so that V cannot fall.
    scene = tmj.load_scene("pinned_rod")
    flat, upright = scene.nodes0.copy(), scene.nodes0.copy()
    row = scene.structure.node_index["n1"]
    flat[row], upright[row] = (1.0, 0.0, 0.0), (0.0, 0.0, 1.0)
    tmj.save_scene(scene.with_(initial_nodes=flat, target=tmj.Target.set_point(upright)), tmp_path / "flat.toml")
    for engine in ("mujoco", "dae"):
        code, answer, _ = ask(capsys, "run", tmp_path / "flat.toml", "--engine", engine, "--duration", "1")
        assert code == 3
        assert answer["status"] == "infeasible"
        assert answer["duration"] == 0.0
        assert answer["min_feasibility_margin"] <= 0
        assert answer["message"]
    code, answer, _ = ask(capsys, "run", tmp_path / "flat.toml", "--on-infeasible", "passive", "--duration", "0.1")
    assert (code, answer["status"]) == (0, "completed")
    code, answer, _ = ask(capsys, "compare", tmp_path / "flat.toml", "--duration", "1")
    assert (code, answer["status"]) == (3, "infeasible")


def test_replay_repeats_a_run(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    first, second = tmp_path / "a.nc", tmp_path / "b.nc"
    assert ask(capsys, *"run prism --duration 0.2 --timestep 1e-3 --out".split(), first)[0] == 0
    for quantity in ("rest-length", "force-density"):
        words = ("run", "prism", "--duration", "0.2", "--timestep", "1e-3", "--replay", first, "--out", second)
        code, answer, err = ask(capsys, *words, "--replay-quantity", quantity)
        assert code == 0, err
        code, answer, _ = ask(capsys, "compare", first, second)
        # The command is recorded 100 times a second and interpolated: far better than 1e-4 of a rod, but not exact.
        assert 0 <= answer["max_node_error"] < 1e-4


def test_compare_keeps_its_contract(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ("compare", "prism", "--timestep", "1e-2", "--duration", "0.2", "--tolerance", "1e-30", "--out")
    code, answer, err = ask(capsys, *words, f"{tmp_path}/")
    assert code == 0, err
    assert {"max_node_error", "rms_node_error", "max_tension_error", "first_exceeded"} <= set(answer)
    # Different formulations cannot agree to the last bit; RK4 at 1e-2 is good to 1e-4 m (measured: 4e-5 after 5 s).
    assert 0 < answer["rms_node_error"] <= answer["max_node_error"] < 1e-4
    assert answer["out"] == {"mujoco": f"{tmp_path}/mujoco.nc", "dae": f"{tmp_path}/dae.nc"}
    assert any(time is not None for time in answer["first_exceeded"].values())
    code, again, _ = ask(capsys, "compare", tmp_path / "mujoco.nc", tmp_path / "dae.nc")
    assert code == 0
    assert again["max_node_error"] == answer["max_node_error"]
    assert main(["compare", str(tmp_path / "mujoco.nc"), str(tmp_path / "dae.nc")]) == 0
    text = capsys.readouterr().out
    assert text.startswith("MuJoCo and the DAE agree to ")
    assert "largest node error" in text
    assert text.count("allowed") == 2  # of the distance of nodes, and of that from the target
    words = ("compare", tmp_path / "mujoco.nc", tmp_path / "dae.nc", "--tolerance", "N=1e-30", "--tolerance", "1")
    code, strict, _ = ask(capsys, *words)
    assert main([str(word) for word in words]) == 0
    text = capsys.readouterr().out
    assert text.startswith("MuJoCo and the DAE agree to ")
    assert "(allowed 1 m)" in text.splitlines()[0]
    assert re.search(r"\nbad +the largest tension error is .* N \(allowed 1e-30 N, exceeded from .* on\)\n", text)
    assert all(one["text"] in text for one in strict["findings"])
    page = write_report(
        tmp_path / "both.html",
        runs := [tmj.Trajectory.load(tmp_path / f"{name}.nc") for name in ("mujoco", "dae")],
        comparison=tmj.compare(*runs, 1.0, tolerances={"N": 1e-30}),
    ).read_text(encoding="utf-8")
    assert all(page.count(one["text"]) == 1 for one in strict["findings"])
    assert "beyond it" not in page
    assert strict["tolerances"]["tension_error"] == strict["tolerances"]["rod_force_error"] == 1e-30
    assert strict["tolerances"]["node_error"] == strict["tolerance"] == 1.0
    assert strict["first_exceeded"]["tension_error"] is not None
    assert strict["first_exceeded"]["node_error"] is None
    assert ask(capsys, "compare", tmp_path / "mujoco.nc", tmp_path / "dae.nc", "--tolerance", "kN=1")[0] == 2


def test_compare_writes_beside_a_prefix(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ("compare", "prism", "--timestep", "1e-2", "--duration", "0.05", "--out", tmp_path / "case")
    assert ask(capsys, *words)[0] == 0
    assert sorted(path.name for path in tmp_path.iterdir()) == ["case-dae.nc", "case-mujoco.nc"]


def test_comparing_different_structures_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for scene in ("prism", "pinned_rod"):
        words = ("run", scene, "--duration", "0.05", "--timestep", "1e-2", "--out", tmp_path / f"{scene}.nc")
        assert ask(capsys, *words)[0] == 0
    assert ask(capsys, "compare", tmp_path / "prism.nc", tmp_path / "pinned_rod.nc")[0] == 2
    (tmp_path / "broken.nc").write_bytes(b"not NetCDF")
    assert ask(capsys, "compare", tmp_path / "prism.nc", tmp_path / "broken.nc")[0] == 2


def test_export_writes_what_mujoco_and_we_can_read(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    import mujoco

    assert ask(capsys, "export", "prism", "--out", tmp_path / "p.xml")[0] == 0
    assert mujoco.MjModel.from_xml_path(str(tmp_path / "p.xml")).ntendon == 12
    assert ask(capsys, "export", "prism", "--out", tmp_path / "p.toml")[0] == 0
    assert tmj.load_scene(tmp_path / "p.toml") == tmj.load_scene("prism")


def test_doctor_answers(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    from tensegrity_mj.commands import doctor

    good = Check("this", True, "here", "everything")
    bad = Check("that", False, "not here", "video", remedy="get it")
    optional = Check("other", False, "not here", "the viewer", required=False, remedy="or not")
    for checks, code, status in (([good, optional], 0, "ok"), ([good, bad], 5, "missing")):
        monkeypatch.setattr(doctor, "examine", lambda checks=checks: checks)
        got, answer, _ = ask(capsys, "doctor")
        assert (got, answer["status"]) == (code, status)
        assert [check["name"] for check in answer["checks"]] == [check.name for check in checks]
        assert main(["doctor"]) == code
        text = capsys.readouterr().out
        assert all(check.remedy in text for check in checks)


@pytest.fixture
def short_prism(tmp_path: Path) -> Path:
    """The prism for a tenth of a second."""
    return tmj.save_scene(tmj.load_scene("prism").with_(duration=0.1, name="short"), tmp_path / "short.toml")


DEMO_FILES = {
    "report.html",
    "short-dae.nc",
    "short-differences.png",
    "short-mujoco.nc",
    "short-paths.png",
    "short-runs.png",
    "short.json",
}


@pytest.mark.slow
def test_demo_makes_everything(short_prism: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    from tensegrity_mj.commands.doctor import check_opengl

    out = tmp_path / "a new" / "folder"
    code, answer, err = ask(capsys, "demo", "--scene", short_prism, "--out", out)
    assert code == 0, err
    expected = DEMO_FILES | ({"short.mp4"} if check_opengl().works else set())
    assert {path.name for path in out.iterdir()} == expected
    assert {Path(path).name for path in answer["files"].values()} == expected
    assert [row["timestep"] for row in answer["agreement"]] == [5e-3, 2e-3, 1e-3, 5e-4]
    assert json.loads((out / "short.json").read_text())["agreement"] == answer["agreement"]
    # Taut strings and 0.1 s: RK4's error is below 1e-9 m at every one of these steps.
    assert 0 < answer["max_node_error"] < 1e-9


@pytest.mark.slow
def test_demo_runs_without_opengl(
    short_prism: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "results"
    out.mkdir()
    (out / "short.mp4").write_text("of an earlier run, with other numbers")
    monkeypatch.setenv("MUJOCO_GL", "disabled")
    code, answer, _ = ask(capsys, "demo", "--scene", short_prism, "--out", out)
    assert code == 0
    assert {path.name for path in out.iterdir()} == DEMO_FILES
    assert "OpenGL" in answer["no_video"]
    assert "OpenGL" in (out / "report.html").read_text()


@pytest.mark.usefixtures("no_simulation")
def test_demo_refuses_before_it_works(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "file").write_text("")
    code, answer, _ = ask(capsys, "demo", "--out", tmp_path / "file")
    assert code == 2
    assert "no folder can be made there" in answer["error"]
    code, answer, _ = ask(capsys, "demo", "--scene", "tbar", "--out", tmp_path / "out")
    assert code == 2
    assert "no control law" in answer["error"]
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


def test_observed_orders() -> None:
    from tensegrity_mj.commands.demo import observed_orders

    table = [{"timestep": h, "max_node_error": 3.0 * h**4} for h in (0.1, 0.05, 0.01)]
    first, *others = observed_orders(table)
    assert first is None
    assert others == pytest.approx([4.0, 4.0], rel=1e-12)


def test_options_reach_the_renderer(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    run = tmp_path / "p.nc"
    assert ask(capsys, *"run prism --timestep 1e-2 --duration 0.1 --out".split(), run)[0] == 0
    requested: dict[str, Any] = {}
    monkeypatch.setattr("tensegrity_mj.pictures.render", lambda *args, **options: requested.update(options))
    monkeypatch.setattr(experiment, "require_off_screen_opengl", lambda: None)
    words = ("render", run, run, "--out", tmp_path / "v.mp4", "--size", "640x360", "--fps", "25", "--speed", "0.5")
    assert ask(capsys, *words, "--layout", "side-by-side")[0] == 0
    assert requested["layout"] is tmj.pictures.Layout.SIDE_BY_SIDE
    assert (requested["size"], requested["fps"], requested["speed"]) == ((640, 360), 25.0, 0.5)
    assert requested["other"] is not None
    assert ask(capsys, *words)[0] == 0
    assert requested["layout"] is tmj.pictures.Layout.OVERLAY
    requested.clear()
    words = ("run", "prism", "--timestep", "1e-2", "--duration", "0.1", "--video", tmp_path / "v.mp4", "--thickness")
    assert ask(capsys, *words, "--fps", "20")[0] == 0
    assert requested == {"progress": True, "fps": 20.0, "thickness": True}


@pytest.mark.slow
def test_render_makes_a_video(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    from tensegrity_mj.commands.doctor import check_opengl

    if not (check := check_opengl()).works:
        pytest.skip(f"no OpenGL here: {check.found}")
    words = ("compare", "prism", "--timestep", "1e-2", "--duration", "0.2", "--out", f"{tmp_path}/")
    assert ask(capsys, *words)[0] == 0
    words = ("render", tmp_path / "mujoco.nc", tmp_path / "dae.nc", "--out", tmp_path / "both.mp4", "--size", "320x240")
    code, answer, err = ask(capsys, *words, "--layout", "side-by-side")
    assert code == 0, err
    assert answer["size"] == [320, 240]
    assert (tmp_path / "both.mp4").read_bytes()[4:8] == b"ftyp"
    assert "video" not in err  # no bar of progress where stderr is no terminal


@pytest.mark.slow
def test_ctrl_c_leaves_no_half_file(tmp_path: Path) -> None:
    out = tmp_path / "p.nc"
    command = "run prism --timestep 1e-5 --duration 1000 --json --out".split()
    terminal, end = os.openpty()  # progress is shown on terminals only, and as wide as they are
    termios.tcsetwinsize(end, (24, 120))
    child = subprocess.Popen(
        [sys.executable, "-m", "tensegrity_mj", *command, str(out)], stdout=subprocess.PIPE, stderr=end
    )
    os.close(end)
    stderr = b""
    while b"MuJoCo" not in stderr:  # its progress bar: it simulates, and would do so for hours
        stderr += os.read(terminal, 1000)
    child.send_signal(signal.SIGINT)
    stdout, _ = child.communicate(timeout=60)
    with contextlib.suppress(OSError):  # how a terminal says that its other end is closed
        while more := os.read(terminal, 1000):
            stderr += more
    os.close(terminal)
    assert child.returncode == 130, stderr.decode()
    assert json.loads(stdout)["status"] == "interrupted"
    assert b"Traceback" not in stderr
    assert not list(tmp_path.iterdir())


def test_the_module_runs_as_a_program() -> None:
    child = shell("scenes", "--json")
    assert child.returncode == 0, child.stderr
    assert json.loads(child.stdout)["status"] == "ok"


def test_run_says_on_stderr_what_is_doubtful(capsys: pytest.CaptureFixture[str]) -> None:
    words = ("run", "prism", "--integrator", "euler", "--timestep", "0.02", "--duration", "2")
    code, answer, err = ask(capsys, *words)
    assert code == 0
    assert "warning: the energy balance is off" in err
    assert answer["reports"]["warnings"]
