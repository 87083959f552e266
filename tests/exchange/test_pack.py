"""The benchmark pack as a folder: each scene in three formats that are the same structure, and its reference."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

import tensegrity_mj as tmj
from tensegrity_mj.cli import main
from tensegrity_mj.errors import OptionError
from tensegrity_mj.exchange import import_scene, save_pack
from tensegrity_mj.model.text.sources import pack_names
from tensegrity_mj.model.text.writing import scene_to_toml
from tensegrity_mj.runs import read_table, reference_of

EPS = np.finfo(float).eps


@pytest.fixture(scope="module")
def pack(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("pack")
    save_pack(folder)
    return folder


@pytest.mark.parametrize("name", pack_names())
def test_every_format_is_the_same_structure(name: str, pack: Path) -> None:
    folder, scene = pack / name.removeprefix("pack/"), tmj.load_scene(name)
    assert scene.name == folder.name
    assert (folder / "scene.toml").read_text(encoding="utf-8") == scene_to_toml(scene)
    for file in ("nodes.csv", "members.csv", "scene.xml"):
        back = import_scene(folder / file).scene
        rows = [back.structure.node_index[node] for node in scene.structure.node_names]
        # MJCF has frames within frames: a few roundings of the size for each.
        size = 64 * EPS * float(np.abs(scene.nodes0).max() + 1.0) if file == "scene.xml" else 0.0
        np.testing.assert_allclose(back.nodes0[rows], scene.nodes0, rtol=0, atol=size)
        np.testing.assert_allclose(back.velocities0[rows], scene.velocities0, rtol=0, atol=size)
        np.testing.assert_array_equal(back.structure.stiffness, scene.structure.stiffness)
        np.testing.assert_array_equal(back.structure.damping, scene.structure.damping)
        np.testing.assert_allclose(back.structure.rest_lengths, scene.structure.rest_lengths, rtol=4 * EPS)
        assert {one.name: (one.nodes, one.mass) for one in back.structure.rods} == {
            one.name: (one.nodes, one.mass) for one in scene.structure.rods
        }
    np.testing.assert_array_equal(read_table(folder / "reference.csv").positions, reference_of(name).positions)


def test_the_pack_is_small_and_says_what_the_tables_leave_out(
    pack: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["export", "pack", "--out", str(tmp_path / "new" / "pack"), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert len(found["files"]) == 1 + 5 * len(pack_names())
    for path in map(Path, found["files"]):
        assert path.read_bytes() == (pack / path.relative_to(tmp_path / "new" / "pack")).read_bytes()
    assert main(["export", "pack", "--out", str(tmp_path / "new" / "pack")]) == 0  # its own it writes anew
    capsys.readouterr()
    assert sum(path.stat().st_size for path in pack.rglob("*.csv")) < 400_000
    readme = (pack / "README.md").read_text(encoding="utf-8")
    absent = {row.split(" | ")[0][2:]: row.split(" | ")[3] for row in readme.splitlines() if row.startswith("| ")}
    assert {absent.pop(name) for name in ("free", "pinned", "class_k", "slack", "damped", "bounce")} == {"-"}
    for name, words in (("closed_loop", ("target", "control")), ("contact", ("contact",)), ("water", ("water",))):
        assert absent[name] == "; ".join(f"the scene's {word} is left out" for word in words)


def test_the_files_of_others_are_not_replaced(tmp_path: Path) -> None:
    (tmp_path / "README.md").write_text("mine")
    with pytest.raises(
        OptionError, match="holds other files, which the pack's might replace: name a folder that is new"
    ):
        save_pack(tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["README.md"]
    assert (tmp_path / "README.md").read_text() == "mine"


def test_options_of_single_scenes_mean_nothing_for_the_pack(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["export", "pack", "--out", str(tmp_path), "--scale", "2"]) == 2
    assert "--scale means nothing for the pack" in capsys.readouterr().err
    (tmp_path / "file").touch()
    assert main(["export", "pack", "--out", str(tmp_path / "file")]) == 2
    assert "no folder can be made there" in capsys.readouterr().err
