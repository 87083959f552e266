"""Text, page and --json of a command say the same: the verdict, and every finding with its mark, of one list."""

from __future__ import annotations

import html
import itertools
import re
from pathlib import Path
from typing import Any

import pytest
from panels import check_one_prefix, check_panels, unit_of

import evidence.commands
import tensegrity_mj as tmj
import tensegrity_mj.commands
from tensegrity_mj.cli import build_parser
from tensegrity_mj.commands.common import Outcome
from tensegrity_mj.commands.parser import prepare
from tensegrity_mj.pictures import page as page_module
from tensegrity_mj.pictures.figure import print_png
from tensegrity_mj.pictures.findings import Finding, Judgement, Mark

COMMANDS = {
    "statics": "statics truss_arm --load t4=0,0,-20 --path --points 10",
    "sweep": "sweep pinned_rod --vary scene.duration=0.1,0.2 --workers 1",
    "validate": "validate pinned_rod --only delay --engines dae --quick --duration 0.2 --workers 1 --timestep 5e-3 "
    "--control-period 5e-3",
    "tradeoff": "tradeoff tbar --engines mujoco --families RK4 --steps 0.01 --duration 0.5 --repeats 1",
    "stability": "stability cross --engines rk4 ode",
    "identify": "identify FOLDER/scene.toml --data FOLDER/run.nc --engine dae --sigma 1e-3 --members b "
    "--parameter structure.strings[s].stiffness=28:1:90",
    "audit stability": "audit stability tbar --engines discrete",
    "audit drift": "audit drift pinned_rod --steps 1000 --workers 1 --methods ode",
    "audit extremes": "audit extremes --runs 2 --kinds bad_law --workers 1",
    "audit promise": "audit promise --runs 1 --seed 3 --workers 1",
}


def answered(words: str, folder: Path) -> Outcome:
    options = build_parser().parse_args([*words.replace("FOLDER", str(folder)).split(), "--out", str(folder / "out")])
    prepare(options)
    outcome: Outcome = options.execute(options)
    return outcome


def shown(page: str) -> tuple[str, list[tuple[str, str]]]:
    """The verdict at the opening of a page, and its findings with their marks."""
    (verdict,) = re.findall(r'<p class="verdict">(.*?)</p>', page, re.DOTALL)
    pairs = re.findall(r'<div class="mark [\w-]+">([\w ]+)</div><div>(.*?)</div>', page, re.DOTALL)
    return html.unescape(verdict), [(mark, html.unescape(text)) for mark, text in pairs]


def told(found: list[dict[str, Any]]) -> list[tuple[str, str]]:
    """The judged findings of --json, each with the name that it is under."""
    pairs, name = [], ""
    for one in found:
        name = one["name"] or name
        if one["mark"]:
            pairs.append((one["mark"], f"{name[:1].upper()}{name[1:]}: {one['text']}" if name else one["text"]))
    return pairs


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """With a mass that hangs from a string, and its run."""
    structure = tmj.Structure(
        "hung",
        {"a": (0.0, 0.0, 0.0), "b": (0.0, 0.0, -1.0)},
        (),
        (tmj.model.String("s", ("a", "b"), 30.0, 0.1, rest_length=0.7),),
        fixed_nodes=("a",),
        point_masses=(tmj.model.PointMass("b", 1.0),),
    )
    scene = tmj.Scene(structure, duration=0.5)
    tmj.save_scene(scene, tmp_path / "scene.toml")
    tmj.simulate(scene, engine="dae", output_interval=0.05).save(tmp_path / "run.nc")
    return tmp_path


@pytest.mark.parametrize("command", COMMANDS)
def test_text_page_and_json_of_a_command_are_one_list(
    command: str, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    units: set[str] = set()

    def drawn(figure: Any, *rest: Any) -> None:
        units.update(check_panels(figure))
        print_png(figure, *rest)

    monkeypatch.setattr(page_module, "print_png", drawn)
    outcome = answered(COMMANDS[command], folder)
    assert units or command not in ("statics",)
    answer, (page,) = outcome.answer, sorted((folder / "out").rglob("*.html"))
    judged = answer["scenes"][0] if command == "tradeoff" else answer
    text = page.read_text(encoding="utf-8")
    verdict, findings = shown(text)
    units |= {unit_of(html.unescape(head)) for head in re.findall(r"<th>([^<]*\])</th>", text)}
    check_one_prefix(units)
    assert verdict
    assert verdict == judged["verdict"]
    assert sorted(findings) == sorted(told(judged["findings"]))
    lines = [" ".join(line.split()) for line in outcome.words.splitlines()]
    assert verdict in lines
    for one in judged["findings"]:
        assert " ".join(f"{one['mark'] or ''} {one['name']} {one['text']}".split()) in lines


def test_every_command_with_a_page_is_compared() -> None:
    """But for `demo`, whose page is of two runs and a film, and `reproduce`, whose page is the ledger."""
    homes = (Path(module.__file__).parent for module in (tensegrity_mj.commands, evidence.commands))
    modules = itertools.chain.from_iterable(home.rglob("*.py") for home in homes)
    pages = [
        one for one in modules if re.search(r"PAGE|\.html|_page\(|tradeoff\(|\.save\(folder\)", one.read_text("utf-8"))
    ]
    names = {one.stem if one.parent.stem == "commands" else f"{one.parent.stem} {one.stem}" for one in pages}
    assert names - set(COMMANDS) == {"demo", "run", "view", "render"}  # a run in 3-D has no findings
    assert set(COMMANDS) <= names | {"audit drift"}


def test_the_statics_page_shows_what_the_text_says(folder: Path) -> None:
    """Loads that a rod's wall carries twice, wind, and strings that cannot stiffen: each line of it is judged once."""
    scene = tmj.load_scene("truss_arm").with_(
        resistance=tmj.Resistance(drag=tmj.model.Drag(1.2), wind=(0.0, 30.0, 0.0))
    )
    study = tmj.statics.analyse(scene, loads={"t4": (0, 0, -20)})
    text = study.save_page(folder / "s.html").read_text(encoding="utf-8")
    page = html.unescape(text)
    assert "has a part in it; docs" not in page
    assert "wind: applied as constant loads" in page
    assert study.prestressability is not None
    stable = study.prestressability.prestress_stable.value
    (line,) = [sentence for _, sentence in shown(text)[1] if "prestress stable: " in sentence]
    assert f"prestress stable: {stable}" in line
    assert "loads and reactions" in page
    data = study.to_dict()["equilibrium"]
    # Loads and reactions are in balance but for what is left on each of 10 nodes, the round-off of 20 numbers of up to
    # 1e2 N, and what counts as round-off of the reactions: 100 ε times 8 times the largest forces, 3e2 N together.
    for axis in range(3):
        pushes = [force[axis] for key in ("loads", "reactions") for force in data[key].values()]
        assert max(map(abs, pushes)) < 1e2
        assert abs(sum(pushes)) <= 10 * data["residual"] + 2.3e-16 * (20 * 20 * 1e2 + 10 * 100 * 8 * 3e2)
    assert min(force[2] for force in data["loads"].values()) < -20


def test_facts_have_no_mark_and_are_left_out_of_the_opening_alone() -> None:
    judgement = Judgement(
        "So.", [Finding(None, "10 N", "load"), Finding(Mark.BAD, "it breaks"), Finding(Mark.GOOD, "")]
    )
    assert judgement.lines() == ["So.", "     load  10 N", "bad        it breaks"]
    assert [one["mark"] for one in judgement.to_dict()["findings"]] == [None, "bad"]
    assert shown("".join(judgement.html())) == ("So.", [("bad", "Load: it breaks")])
