"""`tensegrity-mj statics` and `statics.analyse`: every option, what is written, and what is refused."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command_words import choices_of

import tensegrity_mj as tmj
from tensegrity_mj.cli import main
from tensegrity_mj.commands import statics as command
from tensegrity_mj.statics import lightest as sizes
from tensegrity_mj.statics.study import DATA, PAGE, Search

LOAD = ["--load", "t4=0,0,-20"]  # enough for three diagonals of the arm to become slack


def ask(capsys: pytest.CaptureFixture[str], *arguments: object, code: int = 0) -> dict[str, Any]:
    """The JSON object on stdout."""
    assert main(["statics", *map(str, arguments), "--json"]) == code
    answer: dict[str, Any] = json.loads(capsys.readouterr().out)
    return answer


@pytest.fixture
def strong(tmp_path: Path) -> Path:
    """The arm with sections and strengths."""
    scene = tmj.load_scene("truss_arm")
    structure = scene.structure.with_sections(tmj.model.Section.tube(5e-3, 1e-3, 70e9, 2e8)).with_strings(strength=30.0)
    return tmj.save_scene(scene.with_(structure=structure), tmp_path / "strong.toml")


def test_the_words_of_the_command_are_those_of_the_library() -> None:
    assert {search.value for search in Search} == set(choices_of("statics", "--method"))
    assert {rods.value for rods in tmj.statics.Rods} == set(choices_of("statics", "--rods"))
    known = {name.lower() for name, value in vars(sizes).items() if isinstance(value, sizes.Material)}
    assert known == set(command.MATERIALS)


def test_the_prism_is_where_it_is(capsys: pytest.CaptureFixture[str]) -> None:
    data = ask(capsys, "prism", "--modes", "4")
    assert data["status"] == "ok"
    assert data["start"]["equilibrium"]
    found = data["equilibrium"]
    assert found["stable"]
    assert found["moved"] < 1e-12  # the start is given to round-off
    assert found["slack"] == ["s2", "s7", "s10"]
    assert len(data["modes"]["frequencies"]) == 4
    assert data["prestress"]["prestress_stable"] == "yes"
    assert data["members"]["worst"] is None
    assert {"control", "edge"} <= {word for note in data["notes"] for word in note.split()}
    # Every string's numbers obey T = u L.
    for string in found["strings"].values():
        assert string["tension"] == pytest.approx(string["force_density"] * string["length"])
    # Vertical rod: the forces at its upper, free end balance; the reactions hold what the scene pushes (nothing).
    assert np.allclose(np.sum(list(found["reactions"].values()), axis=0), 0.0, atol=1e-12)


def test_round_off_is_neither_tension_nor_prestress(capsys: pytest.CaptureFixture[str]) -> None:
    """Its strings are as long as their rest lengths: one of them has a tension of 1e-16 N."""
    assert main(["statics", "pinned_rod_mirror"]) == 0
    text = capsys.readouterr().out
    assert re.search(r"tensions +min 0, median 0, max 0 N", text)
    assert re.search(r"slack strings +3: s1, s2, s3", text)
    assert not re.search("stiffens|own forces", text)
    assert re.search(r"moved +none: the scene already starts", text)
    assert "3 strings and 1 rod on 3 free coordinates" in text


def test_what_is_unstable_has_a_rate_and_no_frequency(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    structure = tmj.Structure(
        "column",
        {"a": (0.0, 0.0, 0.0), "b": (0.0, 0.0, 1.0), "c": (0.0, 0.0, 2.0)},
        (tmj.Rod("low", ("a", "b"), 1.0, support=tmj.Support.pinned(0.0)), tmj.Rod("high", ("b", "c"), 1.0)),
        (),
    )
    scene = tmj.Scene(structure, resistance=tmj.Resistance(bending=tmj.model.Bending(3.0)))
    file = tmj.save_scene(scene, tmp_path / "column.toml")
    assert main(["statics", str(file), "--hold", "c:xy", "--load", "c=0,0,-10", "--path"]) == 0
    text = capsys.readouterr().out
    assert "nan" not in text.lower()
    assert re.search(r"frequencies +unstable \([0-9.]+ 1/s\), unstable", text)
    assert re.search(r"critical +2 motions become unstable at parameter 0.6: bifurcation", text)  # 2 κ = 6 N of 10
    assert "leave the joints' bending stiffness out" in text
    # Without a load there is no force in it that could stiffen a mechanism, or drive it on.
    assert main(["statics", str(file)]) == 0
    assert "own forces" not in capsys.readouterr().out


def test_a_path_ends_where_one_step_ends(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    data = ask(capsys, "truss_arm", *LOAD, "--path", "--points", "10", "--out", tmp_path / "arm")
    alone = ask(capsys, "truss_arm", *LOAD)
    # Both are equilibria to round-off of forces over a stiffness of 13 N/m or more.
    for name, place in data["equilibrium"]["nodes"].items():
        assert place == pytest.approx(alone["equilibrium"]["nodes"][name], abs=1e-9)
    path = data["path"]
    assert path["parameters"][0] == 0
    assert path["parameters"][-1] == pytest.approx(1, abs=1e-12)
    (curve,) = path["curves"]
    assert curve["force"][-1] == pytest.approx(20)
    assert min(np.diff(curve["displacement"])) > 0
    assert [event["string"] for event in path["slack_events"]] == ["rising2", "rising3", "rising4"]
    # What is written is what was answered, and pictures: where it stands, its members, its path, its modes.
    written = json.loads((tmp_path / "arm" / DATA).read_text(encoding="utf-8"))
    assert written == {key: data[key] for key in written}
    page = (tmp_path / "arm" / PAGE).read_text(encoding="utf-8")
    assert page.count("data:image/png") == 4
    for words in ("reached the end", "&#x27;rising2&#x27; is slack", "falling3", "Natural modes"):
        assert words in page
    assert not list((tmp_path / "arm").glob(".new*"))


def test_strings_become_slack_where_the_path_says(capsys: pytest.CaptureFixture[str]) -> None:
    event = ask(capsys, "truss_arm", *LOAD, "--path")["path"]["slack_events"][0]
    # Between two of 100 points the margin is straight to a part of (1/100)² of its change: well within 1 %.
    for factor, slack in ((0.99, False), (1.01, True)):
        found = ask(capsys, "truss_arm", *LOAD, "--load-factor", factor * event["parameter"])
        assert (event["string"] in found["equilibrium"]["slack"]) is slack


def test_the_force_of_a_hold_moves_as_far(capsys: pytest.CaptureFixture[str]) -> None:
    held = ask(capsys, "truss_arm", "--hold", "t4:z=0,0,-0.2", "--path", "--points", "10")
    force = held["equilibrium"]["reactions"]["t4"]
    assert force[0] == pytest.approx(0, abs=1e-9)
    assert force[1] == pytest.approx(0, abs=1e-9)
    assert held["path"]["curves"][0]["force"][-1] == pytest.approx(-force[2])
    loaded = ask(capsys, "truss_arm", "--load", f"t4=0,0,{force[2]!r}")
    assert loaded["equilibrium"]["nodes"]["t4"] == pytest.approx(held["equilibrium"]["nodes"]["t4"], abs=1e-8)
    # Holds move from where the scene starts, at a height of 0.25 m.
    assert held["equilibrium"]["nodes"]["t4"][2] == pytest.approx(0.05, abs=1e-12)


def test_the_saved_scene_starts_in_equilibrium(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    file = tmp_path / "there.toml"
    options = (*LOAD, "--broken", "rising3", "--rest-length", "falling2=0.3", "--save-scene", file)
    data = ask(capsys, "truss_arm", *options)
    assert not data["start"]["equilibrium"]
    assert data["equilibrium"]["moved"] > 0.01
    assert "rising3" not in data["equilibrium"]["slack"]
    again = ask(capsys, file)
    assert again["start"]["equilibrium"]
    assert again["equilibrium"]["moved"] < 1e-9
    assert "rising3" not in again["equilibrium"]["strings"]
    assert again["equilibrium"]["strings"]["falling2"]["rest_length"] == 0.3
    assert again["equilibrium"]["strings"]["falling4"]["tension"] == pytest.approx(
        data["equilibrium"]["strings"]["falling4"]["tension"]
    )
    # And stays there: nothing moves in an engine that knows nothing of statics.
    run = tmj.simulate(tmj.load_scene(file), None, tmj.DAE(), duration=0.2)
    assert np.abs(run.nodes - run.nodes[0]).max() < 1e-8


@pytest.mark.parametrize("engine", ["mujoco", "dae"])
def test_both_methods_and_an_engine_agree(engine: str, capsys: pytest.CaptureFixture[str]) -> None:
    data = ask(capsys, "truss_arm", *LOAD, "--broken", "rising4", "--method", "both", "--check-engine", engine)
    assert data["relaxation"]["difference"] < 1e-8
    assert data["engine"]["same"]
    assert data["engine"]["distance"] < 1e-8
    # Central differences: 1e-10 of the largest ω², which is 30 times the smallest here.
    assert data["engine"]["frequency_error"] < 1e-7
    assert data["engine"]["frequencies"] == pytest.approx(data["modes"]["frequencies"])


def test_relaxation_alone(capsys: pytest.CaptureFixture[str]) -> None:
    data = ask(capsys, "truss_arm", "--method", "relaxation")
    assert data["setup"]["method"] == "relaxation"
    assert data["relaxation"] is None
    assert data["equilibrium"]["steps"] > 20  # Newton's method takes four


def test_members(strong: Path, capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    data = ask(capsys, strong, *LOAD, "--rods", "elastic", "--path", "--points", "10")
    assert data["setup"]["rods"] == "elastic"
    rod = data["equilibrium"]["rods"]["lower1"]
    area = tmj.model.Section.tube(5e-3, 1e-3, 70e9).area
    # ΔL = N ℓ / E A, to the length's round-off.
    assert (rod["length"] / 0.25 - 1) * 70e9 * area == pytest.approx(rod["force"], abs=1e-16 / 0.25 * 70e9 * area * 8)
    violations = data["members"]["violations"]
    assert {one["criterion"] for one in violations} == {"strength"}
    assert all(one["force"] > 30 for one in violations)
    assert not data["members"]["ok"]
    assert 0 < data["path"]["first_violation"]["parameter"] < 1
    run = tmj.simulate(tmj.load_scene(strong), None, tmj.DAE(), duration=0.1)
    run.save(tmp_path / "run.nc")
    checked = ask(capsys, "truss_arm", "--run", tmp_path / "run.nc")["run"]
    # Limits are those of the scene that was named, which has none.
    assert checked["worst"] is None
    checked = ask(capsys, strong, "--run", tmp_path / "run.nc", "--out", tmp_path / "out")["run"]
    assert checked["worst"]["force"] == pytest.approx(run.tensions.max())
    assert checked["worst"]["limit"] == 30
    assert "Members over the run" in (tmp_path / "out" / PAGE).read_text(encoding="utf-8")


def test_prestress_of_a_cross(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    scene = tmj.load_scene("cross")
    loose = ask(capsys, "cross")
    assert not loose["equilibrium"]["stable"]
    file = tmj.save_scene(
        scene.with_(structure=scene.structure.with_strings(rest_length=0.3), control=None, target=None),
        tmp_path / "cross.toml",
    )
    tight = ask(capsys, file)
    assert tight["equilibrium"]["stable"]
    assert tight["equilibrium"]["slack"] == []
    assert tight["equilibrium"]["rod_forces"]["max"] < 0
    assert tight["prestress"]["own_prestress"]
    assert tight["modes"]["frequencies"][0] > 0


def test_the_lightest_members(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    file = tmp_path / "light.toml"
    sizing = ("--size", "steel,uhmwpe", "--least-radius", 1e-4, "--save-sized", file)
    data = ask(capsys, "truss_arm", *LOAD, *sizing, "--out", tmp_path / "out")
    scene = tmj.load_scene("truss_arm")
    loads = np.zeros((len(scene.structure.nodes), 3))
    loads[scene.structure.node_index["t4"], 2] = -20.0
    found = tmj.statics.minimal_mass(
        scene.structure,
        loads,
        rods=sizes.STEEL,
        strings=sizes.UHMWPE,
        gravity=scene.gravity,
        least_radius=1e-4,
    )
    assert data["sizing"]["mass"] == pytest.approx(found.mass, rel=1e-6)
    sized = tmj.load_scene(file).structure
    assert sized.rod_masses.sum() == pytest.approx(found.rod_masses.sum(), rel=1e-6)
    assert all(rod.section is not None for rod in sized.rods)
    assert "Lightest members" in (tmp_path / "out" / PAGE).read_text(encoding="utf-8")


def test_without_an_equilibrium_what_else_was_requested_is_answered(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def none(*_: object, **__: object) -> None:
        raise tmj.errors.InfeasibleError("there is none")

    monkeypatch.setattr("tensegrity_mj.statics.study.find_equilibrium", none)
    fallen = ask(capsys, "truss_arm", *LOAD, "--size", "steel,uhmwpe", "--least-radius", 1e-4, code=3)
    assert fallen["status"] == "infeasible"
    assert fallen["equilibrium"] is None
    assert fallen["failure"]
    assert fallen["sizing"]["mass"] > 0


def test_what_falls_has_no_equilibrium(capsys: pytest.CaptureFixture[str]) -> None:
    answer = ask(capsys, "prism_drop", code=3)
    assert answer["status"] == "infeasible"
    assert "nothing holds it" in answer["error"]
    assert ask(capsys, "prism_drop", "--no-gravity")["equilibrium"]["stable"]


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["nowhere"], "nowhere"),
        (["prism", "--load", "n1"], "NODE=X,Y,Z"),
        (["prism", "--load", "n1=1,2"], "three numbers"),
        (["prism", "--load", "n1=1,2,nan"], "finite"),
        (["prism", "--load", "n99=0,0,1"], "there is no node 'n99'"),
        (["prism", "--load-factor", "2"], "needs --load"),
        (["prism", "--hold", "n1:xw"], "NODES"),
        (["prism", "--hold", "n1:"], "NODES"),
        (["prism", "--hold", "n99"], "there is no node 'n99'"),
        (["truss_arm", "--hold", "t4:z=0.1,0,0"], "not along its directions"),
        (["truss_arm", "--hold", "b0=0,0,0.1"], "contradict a support"),
        (["prism", "--points", "5"], "needs --path"),
        (["prism", "--path"], "the loads of the scene itself stay constant"),
        (["truss_arm", *LOAD, "--path", "--method", "both"], "followed by Newton's method"),
        (["prism", "--broken", "s99"], "no string 's99'"),
        (["prism", "--rest-length", "s99=0.3"], "no string 's99'"),
        (["prism", "--rest-length", "s1=-0.3"], "must be > 0"),
        (["prism", "--rods", "elastic"], "has no section"),
        (["prism", "--modes", "0"], "whole number"),
        (["prism", "--size", "wood"], "aluminium"),
        (["prism", "--least-radius", "1e-3"], "needs --size"),
        (["truss_arm", "--broken", "rising2", "--size", "steel"], "broken"),
        (["truss_arm", "--hold", "t4", "--check-engine", "dae"], "it has no holds"),
        (["prism", "--mode-video", "13", "m.mp4"], "from 1 to the 12"),
        (["prism", "--mode-video", "1", "m.avi"], ".mp4"),
        (["prism", "--save-scene", "prism.json"], ".toml"),
        (["prism", "--run", "nowhere.nc"], "nowhere.nc"),
    ],
)
def test_bad_input_is_refused_in_words(arguments: list[str], words: str, capsys: pytest.CaptureFixture[str]) -> None:
    answer = ask(capsys, *arguments, code=2)
    assert words in answer["error"]
    assert "Traceback" not in answer["error"]


def test_a_file_is_no_folder(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    assert main(["statics", "prism", "--out", str(tmp_path / "file")]) == 2


def test_a_run_of_another_scene_is_refused(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    tmj.simulate(tmj.load_scene("tbar"), None, tmj.DAE(), duration=0.01).save(tmp_path / "tbar.nc")
    assert "are others" in ask(capsys, "prism", "--run", tmp_path / "tbar.nc", code=2)["error"]


def test_a_mode_is_filmed_a_period_in_two_seconds(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    seen: dict[str, Any] = {}

    def render(motion: Any, path: Path, **options: Any) -> Path:
        seen.update(motion=motion, path=path, **options)
        return path

    monkeypatch.setattr("tensegrity_mj.pictures.render", render)
    monkeypatch.setattr(command.experiment, "require_off_screen_opengl", lambda: None)
    assert main(["statics", "truss_arm", "--mode-video", "2", str(tmp_path / "m.mp4")]) == 0
    frequency = tmj.statics.natural_modes(tmj.statics.find_equilibrium(tmj.load_scene("truss_arm"))).frequencies[1]
    assert seen["path"] == tmp_path / "m.mp4"
    assert seen["speed"] == pytest.approx(1 / frequency / 2)
    assert seen["motion"].time[-1] == pytest.approx(2 / frequency)


def test_an_interrupt_leaves_no_half_file(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    def interrupted(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("tensegrity_mj.statics.page.modes_figure", interrupted)
    answer = ask(capsys, "prism", "--out", tmp_path / "out", "--save-scene", tmp_path / "s.toml", code=130)
    assert answer["status"] == "interrupted"
    assert [path.name for path in (tmp_path / "out").iterdir()] == [DATA]
    json.loads((tmp_path / "out" / DATA).read_text(encoding="utf-8"))
    assert not (tmp_path / "s.toml").exists()


def test_python_users_get_the_same(capsys: pytest.CaptureFixture[str]) -> None:
    study = tmj.statics.analyse(tmj.load_scene("truss_arm"), loads={"t4": (0.0, 0.0, -20.0)})
    data = ask(capsys, "truss_arm", *LOAD)
    assert study.state is not None
    assert data["equilibrium"]["moved"] == study.moved
    assert data["equilibrium"]["nodes"]["t4"] == study.state.nodes[study.model.structure.node_index["t4"]].tolist()
    text = dict(study.describe())
    assert "stable" in text["equilibrium"]
    assert "t4" in text["moved"] or "b4" in text["moved"]


def test_buckling_shows_on_the_page(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    # A rod stands on a ball joint between four stays without tension: k x² of two of them against its weight and load.
    structure = tmj.Structure.from_arrays(
        nodes=[[0, 0, 0], [0, 0, 1], [1, 0, 1], [-1, 0, 1], [0, 1, 1], [0, -1, 1]],
        rods=[[0, 1]],
        strings=[[1, 2], [1, 3], [1, 4], [1, 5]],
        rod_mass=1.0,
        stiffness=[50.0, 50.0, 80.0, 80.0],
        rest_length=0.9,
        supports=[tmj.Support.pinned()],
        fixed_nodes=[2, 3, 4, 5],
    )
    file = tmj.save_scene(tmj.Scene(structure, name="mast"), tmp_path / "mast.toml")
    top = structure.node_names[1]
    data = ask(capsys, file, "--load", f"{top}=0,0,-200", "--path", "--points", "50", "--out", tmp_path / "out")
    first = data["path"]["criticals"][0]
    # Straight: 2 · 50 N/m along x from the stays along it and 2 · 80 · 0.1 / 1 from those across, -P / ℓ from the load:
    # it buckles at P = 116 N, along x. Located to 1e-9 of a step.
    assert first["parameter"] * 200 == pytest.approx(116.0, rel=1e-6)
    assert first["kind"] == "bifurcation"
    assert abs(first["mode"][1][0]) == pytest.approx(1)
    assert (tmp_path / "out" / PAGE).read_text(encoding="utf-8").count("data:image/png") == 5
