"""MJCF for older releases of MuJoCo and other readers: words that they know, the same physics, and what is lost."""

from __future__ import annotations

import json
import xml.etree.ElementTree as ET
from pathlib import Path

import mujoco
import numpy as np
import pytest

import tensegrity_mj as tmj
from tensegrity_mj.cli import main
from tensegrity_mj.engines.mujoco.mjcf import scene_to_mjcf
from tensegrity_mj.engines.mujoco.mjcf_versions import FEATURES, oldest
from tensegrity_mj.errors import OptionError
from tensegrity_mj.exchange import import_scene, save_mjcf_for
from tensegrity_mj.model import Contact, Heights
from tensegrity_mj.model.text.sources import pack_names, scene_names

EPS = np.finfo(float).eps
SCENES = [*scene_names(), *pack_names()]

# The words with which MuJoCo 2.3.0 was seen to load every shipped scene.
FIRST = {
    "actuator": "",
    "body": "name pos quat",
    "compiler": "angle autolimits balanceinertia boundmass",
    "connect": "anchor body1 body2 name solimp solref",
    "equality": "",
    "flag": "constraint contact gravity",
    "freejoint": "name",
    "general": "biasprm biastype forcelimited forcerange gainprm name tendon",
    "geom": "conaffinity condim contype friction fromto name pos quat rgba size solimp solref type",
    "inertial": "diaginertia mass pos quat",
    "joint": "armature axis name type",
    "key": "name qvel",
    "keyframe": "",
    "light": "dir directional pos",
    "mujoco": "model",
    "option": "cone gravity impratio integrator timestep tolerance",
    "site": "name pos rgba site size",
    "spatial": "name rgba width",
    "statistic": "center extent",
    "tendon": "",
    "worldbody": "",
}


def written(scene: tmj.Scene, folder: Path, reader: str | None) -> tuple[ET.Element, list[str]]:
    files, notes = save_mjcf_for(scene, folder / "model.xml", reader)
    return ET.parse(files[0]).getroot(), notes


def elastic() -> tmj.Scene:
    rod = tmj.Rod("r", ("a", "b"), 1.0, support=tmj.Support.pinned(), stiffness=900.0)
    return tmj.Scene(tmj.Structure("elastic", {"a": (0, 0, 0), "b": (0, 0, 1)}, [rod]))


def uneven() -> tmj.Scene:
    heights = Heights(heights=[[0.0, 0.1], [0.1, 0.0]], spacing=1.0)  # type: ignore[arg-type]
    return tmj.load_scene("six_bar_drop").with_(contact=Contact(floor=-2.0, terrain=heights))


def places(root: ET.Element) -> dict[str, np.ndarray]:
    """Sites after 20 steps of the installed MuJoCo."""
    model = mujoco.MjModel.from_xml_string(ET.tostring(root, encoding="unicode"))
    data = mujoco.MjData(model)
    if model.nkey:
        mujoco.mj_resetDataKeyframe(model, data, 0)
    for _ in range(20):
        mujoco.mj_step(model, data)
    mujoco.mj_kinematics(model, data)
    return {model.site(row).name: np.array(data.site_xpos[row]) for row in range(model.nsite)}


@pytest.mark.parametrize("name", SCENES)
def test_a_file_has_only_words_that_its_reader_knows(name: str, tmp_path: Path) -> None:
    scene = tmj.load_scene(name)
    plain, none = written(scene, tmp_path, None)
    newer = {(word["at"], word["key"]) for word in FEATURES} | {("connect", "site2")}
    said = {(one.tag, key) for one in plain.iter() for key in one.attrib}
    unknown = said - newer - {(tag, key) for tag, keys in FIRST.items() for key in keys.split()}
    assert not unknown  # a new word of the generator: see in which MuJoCo it came, and give it a row of WORDS
    root, notes = written(scene, tmp_path, "2.3.0")
    for element in root.iter():
        assert set(element.attrib) <= set(FIRST[element.tag].split())
    assert oldest(root) == "2.3.0"
    exact = any("diagexact" in flag.attrib for flag in plain.iter("flag"))
    turning = any(one.tag == "freejoint" or one.get("type") == "ball" for one in plain.iter())
    found = " ".join(notes)
    assert ("the flag diagexact is left out, which MuJoCo 2.3.0 does not know: contacts" in found) == exact
    assert "the flag autoreset is left out" in found
    assert ("RK4 of MuJoCo 2.3.0 is of order 2 on ball and free joints" in found) == turning
    assert not any("left out" in note or "order" in note for note in none)
    assert oldest(plain) == ("3.9.0" if exact else "3.2.1")
    gravity = {flag.get("gravity") for flag in plain.iter("flag")}
    assert gravity == ({None} if np.any(scene.gravity) else {"disable"})


@pytest.mark.parametrize("name", SCENES)
def test_drake_gets_the_same_machine_in_words_that_it_knows(name: str, tmp_path: Path) -> None:
    scene = tmj.load_scene(name)
    if scene.motions:
        with pytest.raises(OptionError, match="Drake does not know supports that move: this scene cannot be written"):
            written(scene, tmp_path, "drake")
        return
    root, notes = written(scene, tmp_path, "drake")
    assert "its user adds strings" in notes[-1]
    assert not list(root.iter("freejoint"))
    assert root.find("worldbody/site") is None
    for connect in root.iter("connect"):
        assert {"body1", "anchor"} <= set(connect.attrib)
        assert not {"site1", "site2"} & set(connect.attrib)
    # Parts of a body that has several joints are called by its name and a number there.
    names = [body.get("name", "") for body in root.iter("body")]
    split = [f"{body.get('name')}{k}" for body in root.iter("body") for k in range(len(body.findall("joint")) - 1)]
    assert len({*names, *split}) == len(names) + len(split)
    # Two bodies are joined at places that differ by a rounding of the size, where sites are by none: a gap g, which is
    # pulled by g / τ², τ being 4 steps (`mjcf.CONNECT_STEPS`). In 20 steps that moves by (20/4)²/2 g; and as much again
    # for the rounding of each of 20 steps.
    size = float(np.abs(scene.nodes0).max()) + 1.0
    expected, found = places(ET.fromstring(scene_to_mjcf(scene))), places(root)
    for node in scene.structure.node_names:
        np.testing.assert_allclose(found[node], expected[node], rtol=0, atol=64 * EPS * size * (5**2 / 2 + 20))
    if not scene.structure.bodies:  # and it comes back
        back = import_scene(tmp_path / "model.xml").scene
        assert {rod.name for rod in back.structure.rods} == {rod.name for rod in scene.structure.rods}


def test_what_cannot_be_said_is_refused(tmp_path: Path) -> None:
    for scene, reader, message in (
        (
            elastic(),
            "3.3.0",
            "MuJoCo 3.3.0 does not know the mass of elastic rods; MuJoCo 3.3.1 does: this scene cannot",
        ),
        (elastic(), "drake", "Drake does not know the mass of elastic rods: this scene cannot be written for it"),
        (uneven(), "3.1", "MuJoCo 3.1 does not know terrain; MuJoCo 3.1.2 does"),
        (uneven(), "drake", "Drake does not know terrain"),
        (tmj.load_scene("prism"), "2.2.2", "no file is written for one older than 2.3.0"),
        (tmj.load_scene("prism"), "mojoco", "'mojoco': write menagerie, warp, drake or the version of a MuJoCo"),
    ):
        with pytest.raises(OptionError, match=message):
            save_mjcf_for(scene, tmp_path / "model.xml", reader)
    assert not list(tmp_path.iterdir())
    root, notes = written(elastic(), tmp_path, "3.3.1")
    assert (oldest(root), notes) == ("3.3.1", [])


@pytest.mark.parametrize(
    ("scene", "reader", "expected"),
    [
        ("prism", [], "3.2.1"),
        ("dbar", [], "3.9.0"),
        ("prism", ["--for", "3.2"], "2.3.0"),
        ("dbar", ["--for", "3.4"], "3.3.0"),
        ("dbar", ["--for", "5.0"], "3.9.0"),
        ("dbar", ["--for", "menagerie"], "3.9.0"),
        ("dbar", ["--for", "warp"], "3.3.0"),
    ],
)
def test_the_oldest_release_stands_in_the_file_and_is_said(
    scene: str, reader: list[str], expected: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "model.xml"
    assert main(["export", scene, "--out", str(file), *reader, "--json"]) == 0
    said = capsys.readouterr()
    assert json.loads(said.out)["oldest_mujoco"] == expected
    assert f"loads in MuJoCo {expected} and newer\n" in said.err
    text = file.read_text(encoding="utf-8")
    assert text.count("<!-- Loads in MuJoCo") == 1
    assert f"<!-- Loads in MuJoCo {expected} and newer." in text
    turning = "Before 4.0 RK4 is of order 2 on its ball and free joints." in text
    assert turning == (scene == "prism")  # the D-bar moves in a plane


def test_ctrl_is_what_is_added_to_the_rest_length(tmp_path: Path) -> None:
    """And of a string of constant force, what is taken off the force."""
    for name in ("prism", "arrester"):
        scene = tmj.load_scene(name)
        model = mujoco.MjModel.from_xml_string(scene_to_mjcf(scene))
        data = mujoco.MjData(model)
        data.ctrl[:] = 1e-3
        mujoco.mj_forward(model, data)
        structure = scene.structure
        k, constant = structure.stiffness, structure.curves.constant
        pull = np.where(constant, structure.curves.tensions[:, 0], k * (data.ten_length - structure.rest_lengths))
        expected = np.maximum(pull - np.where(constant, 1.0, k) * 1e-3, 0.0)
        # Differences of terms of k L: a few roundings of these.
        np.testing.assert_allclose(-data.actuator_force, expected, rtol=0, atol=8 * EPS * (k * data.ten_length).max())


@pytest.mark.parametrize("reader", ["menagerie", "warp"])
def test_a_scene_of_another_model_is_not_replaced(reader: str, tmp_path: Path) -> None:
    scene, other = tmj.load_scene("tbar"), tmp_path / "scene.xml"
    other.write_text('<mujoco><include file="robot.xml" /></mujoco>')
    with pytest.raises(
        OptionError, match=r"scene\.xml is there already, and is no scene of tbar\.xml: write into another"
    ):
        save_mjcf_for(scene, tmp_path / "tbar.xml", reader)
    assert other.read_text() == '<mujoco><include file="robot.xml" /></mujoco>'
    assert not (tmp_path / "tbar.xml").exists()
    other.unlink()
    for _ in range(2):  # its own it writes anew
        save_mjcf_for(scene, tmp_path / "tbar.xml", reader)
