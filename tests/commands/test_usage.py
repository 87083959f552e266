"""Groups of commands, errors of usage in one line with what was meant, and completion in the shell."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from tensegrity_mj.cli import GROUPS, main
from tensegrity_mj.commands.parser import commands_of_others, words_of

ALL = {**GROUPS, **commands_of_others()}

# Answers that the issue gives, or that follow from difflib's ratio (2 M / T over the letters that match, at least 0.6).
MEANT = {
    "runn": "runn: there is no such command; did you mean run?",
    "benchmark --quick": "benchmark: there is no such command; did you mean audit speed?",
    "extremes --runs 3": "extremes: there is no such command; did you mean audit extremes?",
    "promise": "promise: there is no such command; did you mean audit promise?",
    "run prism --tim 1": "run: --tim: there is no such option; did you mean --timestep?",
    "drift prism": "drift: there is no such command; did you mean audit drift?",
    "audit extrems": "audit: extrems: there is no such command; did you mean audit extremes?",
    "--versoin": "--versoin: there is no such option; did you mean --version?",
    "run --engien dae": "run: --engien: there is no such option; did you mean --engine?",
    "run --engien=dae": "run: --engien: there is no such option; did you mean --engine?",
    "run prism -engine dae": "run: -engine: there is no such option; did you mean --engine?",
    "audit drift prism --stepss 9": "audit drift: --stepss: there is no such option; did you mean --steps?",
    "run prism --engine dea": "run: --engine: 'dea': allowed: mujoco, dae, ode, jax; did you mean dae?",
    "run prism --engine mujoko": "run: --engine: 'mujoko': allowed: mujoco, dae, ode, jax; did you mean mujoco?",
    "run prism --integrator rk5": "run: --integrator: 'rk5': allowed: euler, implicitfast, implicit, rk4, discrete; "
    "did you mean rk4?",
    "tradeoff prism --engines dae odd": "tradeoff: --engines: 'odd': allowed: mujoco, dae, ode, jax; did you mean ode?",
}
# Where nothing is near, the answer says what is allowed or where to look.
ELSE = {
    "": f"name a command: {', '.join(name for group in ALL.values() for name in group)}",
    "audit": "audit: name a command: extremes, promise, stability, drift, speed, step",
    "run": "run: SCENE: missing; see tensegrity-mj run --help",
    "run prism tower": "run: tower: more than it takes; see tensegrity-mj run --help",
    # 'gravity' and 'drift' share three letters of twelve in this order (.5), which is not near.
    "run prism --gravity 1": "run: --gravity: there is no such option; see tensegrity-mj run --help",
    "export prism --zzz": "export: --zzz: there is no such option; see tensegrity-mj export --help",
    "run prism --timestep -1": "run: --timestep: -1: it must be > 0",
    "run prism --engine": "run: --engine: expected one argument",
}


@pytest.mark.parametrize(("words", "answer"), [*MEANT.items(), *ELSE.items()])
def test_bad_usage_is_answered_in_one_line(words: str, answer: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(words.split()) == 2
    captured = capsys.readouterr()
    assert captured.err == f"tensegrity-mj: {answer}\n"
    assert captured.out == ""


@pytest.mark.parametrize(
    ("words", "meant"),
    [
        ("run prsm", "prism"),
        ("run towr(stages=3)", "tower"),
        ("run prism --law lyapunow", "lyapunov"),
        ("validate prism --law lyapunow", "lyapunov"),
        ("sweep prism --vary engine.integrator=rk5 --out x", "rk4"),
        ("sweep prism --vary engine=dea --out x", "dae"),
        ("sweep prism --vary engine.timestp=1 --out x", "timestep"),
    ],
)
def test_scenes_families_and_laws_that_were_probably_meant(
    words: str, meant: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(words.split()) == 2
    err = capsys.readouterr().err
    assert "did you mean" in err
    assert meant in err.partition("did you mean")[2][: len(meant) + 3]
    assert err.count("\n") == 1


def test_a_step_that_is_too_large_is_warned_of_in_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    main("run truss_arm --timestep 0.05 --duration 0.1".split())
    lines = [line for line in capsys.readouterr().err.splitlines() if "beyond the largest stable one" in line]
    assert len(lines) == 1
    assert lines[0].startswith("warning: the step of 0.05 s is beyond")


def test_help_shows_the_groups_with_one_line_each(capsys: pytest.CaptureFixture[str]) -> None:
    for words, groups in (([], ALL), (["audit"], {"commands": ALL["tensegrity-mj-evidence"]["audit"].COMMANDS})):
        with pytest.raises(SystemExit) as end:
            main([*words, "--help"])
        assert end.value.code == 0
        lines = capsys.readouterr().out.splitlines()
        for title, commands in groups.items():
            first = lines.index(f"{title}:") + 1
            shown = [line.split(maxsplit=1) for line in lines[first : first + len(commands)]]
            assert shown == [[name, words_of(module)["help"]] for name, module in commands.items()]


# Completion --------------------------------------------------------------------------------------------------------


def completed(line: str, folder: Path) -> list[str]:
    """What argcomplete answers the shell for a command line with the cursor at its end."""
    answer = folder / "answer"
    variables = {
        "_ARGCOMPLETE": "1",
        "_ARGCOMPLETE_IFS": "\n",
        "_ARGCOMPLETE_STDOUT_FILENAME": str(answer),
        "COMP_LINE": f"tensegrity-mj {line}",
        "COMP_POINT": str(len(f"tensegrity-mj {line}".encode())),
    }
    where = folder / "here"
    where.mkdir(exist_ok=True)
    for name in ("a.nc", "my.toml", "other.txt"):
        (where / name).touch()
    (where / "folder").mkdir(exist_ok=True)
    subprocess.run(
        [sys.executable, "-m", "tensegrity_mj"], env=os.environ | variables, cwd=where, check=True, timeout=120
    )
    return [word.rstrip() for word in answer.read_text().split("\n")]


@pytest.mark.parametrize(
    ("line", "has", "lacks"),
    [
        ("", ["run", "audit", "demo"], ["drift"]),
        ("audit ", ["extremes", "promise", "drift", "speed"], ["run"]),
        ("run prism --in", ["--integrator"], ["--engine"]),
        ("run prism --engine ", ["mujoco", "dae", "ode"], ["a.nc"]),
        ("run p", ["prism", "pinned_rod"], ["tower"]),
        ("run ./", ["./my.toml", "./folder/"], ["./a.nc", "./other.txt"]),
        ("compare prism --reference o", ["ode"], ["dae"]),
        ("view ./", ["./my.toml", "./a.nc"], ["./other.txt"]),
        ("render ", ["a.nc", "folder/"], ["my.toml", "other.txt"]),
        ("audit drift prism --methods ", ["rk4", "euler"], ["prism"]),
        ("stability prism --out ", ["folder/"], ["a.nc"]),
        ("run prism --timestep ", [], ["a.nc", "other.txt"]),
    ],
)
def test_the_shell_completes_what_fits(line: str, has: list[str], lacks: list[str], tmp_path: Path) -> None:
    words = completed(line, tmp_path)
    assert set(has) <= set(words)
    assert not set(lacks) & set(words)


@pytest.mark.parametrize("shell", ["bash", "zsh"])
def test_the_line_of_the_docs_works(shell: str) -> None:
    if shutil.which(shell) is None:
        pytest.skip(f"there is no {shell} here")
    line = 'eval "$(register-python-argcomplete tensegrity-mj)"'
    assert line in (Path(__file__).resolve().parents[2] / "docs/command-line.md").read_text(encoding="utf-8")
    ask = {
        "bash": 'COMP_LINE="tensegrity-mj audit dr" COMP_POINT=22 COMP_TYPE=9; complete -p tensegrity-mj\n'
        "COMP_WORDS=(tensegrity-mj audit dr) COMP_CWORD=2; _python_argcomplete tensegrity-mj dr audit\n"
        'echo "${COMPREPLY[@]}"',
        "zsh": 'echo "${_comps[tensegrity-mj]}"',
    }[shell]
    start = "autoload -U compinit; compinit -u -D\n" if shell == "zsh" else ""
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    script = [shell, "-c", f"{start}{line}\n{ask}"]
    child = subprocess.run(script, env=os.environ | {"PATH": path}, capture_output=True, text=True, timeout=60)
    assert child.returncode == 0, child.stderr
    assert "_python_argcomplete" in child.stdout
    if shell == "bash":
        assert child.stdout.split()[-1] == "drift"
