"""Exports: MJCF after Menagerie's conventions is the same physics, MATLAB data come back, and shapes are closed."""

from __future__ import annotations

import json
import re
import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
from scipy.io import loadmat

import tensegrity_mj as tmj
from tensegrity_mj.cli import main
from tensegrity_mj.engines.mujoco.mjcf import scene_to_mjcf
from tensegrity_mj.exchange import import_scene, save_mat, save_menagerie, save_stl
from tensegrity_mj.exchange.solids import CORNERS, shape
from tensegrity_mj.model.text.sources import scene_names

EPS = np.finfo(float).eps


def after(model: mujoco.MjModel, key: bool) -> np.ndarray:
    data = mujoco.MjData(model)
    if key:
        mujoco.mj_resetDataKeyframe(model, data, 0)
    for _ in range(20):
        mujoco.mj_step(model, data)
    return np.array(data.qpos)


@pytest.mark.parametrize("name", scene_names())
def test_a_menagerie_model_moves_to_the_last_bit_as_the_plain_one(name: str, tmp_path: Path) -> None:
    scene = tmj.load_scene(name)
    files, _ = save_menagerie(scene, tmp_path / f"{name}.xml")
    plain = mujoco.MjModel.from_xml_string(scene_to_mjcf(scene))
    expected = after(plain, plain.nkey > 0)
    for path in files:  # the model alone, and the scene, which differ in floor and light
        model = mujoco.MjModel.from_xml_path(str(path))
        assert [model.key(row).name for row in range(model.nkey)] == ["home"]
        if path == files[1] or scene.contact is None:
            np.testing.assert_array_equal(after(model, True), expected)
        names = re.findall(rb"[^\0]+", bytes(model.names))
        assert not [one for one in names if re.search(rb"[^\w-]", one)]
        assert (model.nu, model.nsensor) == (len(scene.structure.strings), 3 * len(scene.structure.strings))
        if model.nu:
            rest = scene.structure.rest_lengths
            constant = [string.is_constant for string in scene.structure.strings]  # there is no rest length to command
            np.testing.assert_array_equal(model.actuator_ctrllimited, np.logical_not(constant))
            np.testing.assert_array_equal(model.actuator_ctrlrange[:, 1], rest)
            least = np.maximum(scene.structure.limits("min_rest_length"), 0.0)
            np.testing.assert_array_equal(model.actuator_ctrlrange[:, 0], np.minimum(least - rest, 0.0))
    root, outer = (ET.parse(path).getroot() for path in files)
    assert {one.get("class") for one in root.iter("default")} <= {None, root.get("model"), "rod", "node", "string"}
    assert root.find("worldbody/light") is None
    assert next(one.tag for one in outer) == "include"
    # Its picture is as wide as high or wider, and the start is in it: no node is further off the axis than the edge.
    camera = model.camera("side")
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    mujoco.mj_forward(model, data)
    seen = (scene.nodes0 - data.camera("side").xpos) @ data.camera("side").xmat.reshape(3, 3)
    assert np.all(np.abs(seen[:, :2]) < -seen[:, 2:] * np.tan(0.5 * np.radians(camera.fovy)))
    assert -seen[:, 2].min() < 5 * np.ptp(scene.nodes0, axis=0).max()  # and it is no speck
    assert outer.find("asset/texture").get("type") == "skybox"  # type: ignore[union-attr]
    assert (outer.find("worldbody/geom") is not None) == (scene.contact is not None and scene.contact.floor is not None)


@pytest.mark.parametrize("name", ["prism", "dbar", "prism_drop"])
def test_what_warp_refuses_is_left_out_and_said(name: str, tmp_path: Path) -> None:
    files, notes = save_menagerie(tmj.load_scene(name), tmp_path / "model.xml", warp=True)
    flags = {key for flag in ET.parse(files[0]).getroot().iter("flag") for key in flag.attrib}
    # put_model of mujoco-warp 4.0.0 refuses a model with the first of these flags, and knows none of the others.
    assert not flags & {"autoreset", "diagexact", "midphase", "nativeccd", "island"}
    assert any(note.startswith("the flag autoreset is left out, which MuJoCo Warp does not know: ") for note in notes)
    model = mujoco.MjModel.from_xml_path(str(files[1]))
    bits = mujoco.mjtDisableBit
    assert not model.opt.disableflags & (bits.mjDSBL_AUTORESET | bits.mjDSBL_MIDPHASE)
    assert model.opt.enableflags == 0


@pytest.mark.slow
def test_the_guide_to_mjx_runs_as_printed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("mujoco.mjx", reason="the extra mjx is not installed")
    monkeypatch.chdir(tmp_path)
    page = Path(__file__).parents[2] / "docs" / "exchange.md"
    (block,) = re.findall(r"```py\n(.*?)```", page.read_text(encoding="utf-8"), re.DOTALL)
    names: dict[str, Any] = {}
    exec(compile(block, "docs/exchange.md", "exec"), names)
    model, data = names["model"], names["data"]
    for _ in range(300):
        mujoco.mj_step(model, data)
    assert data.ncon > 0  # on the floor
    # Single precision: each of 300 steps rounds coordinates of 1 m at most and velocities of 4 m/s at most to 6e-8 of
    # themselves, which moves all by as much for the 0.3 s that are left.
    np.testing.assert_allclose(names["state"].qpos, data.qpos, atol=300 * 6e-8 * (1 + 4 * 0.3))


def test_names_without_spaces_stay_different(tmp_path: Path) -> None:
    rods = [tmj.Rod("a b", ("n 1", "n 2"), 1.0), tmj.Rod("a_b", ("n_1", "n-2"), 1.0)]
    nodes = {"n 1": (0, 0, 0), "n 2": (1, 0, 0), "n_1": (0, 1, 0), "n-2": (1, 1, 0)}
    strings = [tmj.String("ä ß", ("n 1", "n_1"), 10.0), tmj.String("s/1", ("n 2", "n-2"), 10.0)]
    structure = tmj.Structure("two words", nodes, rods, strings)  # type: ignore[arg-type]
    files, _ = save_menagerie(tmj.Scene(structure), tmp_path / "two.xml")
    model = mujoco.MjModel.from_xml_path(str(files[1]))
    assert [model.site(row).name for row in range(4)] == ["n_1", "n_2", "n_1_2", "n_2_2"]
    assert [model.geom(row).name for row in range(2)] == ["a_b", "a_b_2"]
    assert [model.tendon(row).name for row in range(2)] == ["ä_ß", "s_1"]


# Strings through more than two nodes, bodies and constant forces have no place there: `test_pulley_exchange` has the
# refusal of the first.
@pytest.mark.parametrize("name", [name for name in scene_names() if name not in ("pulley", "spine", "arrester")])
def test_matlab_data_of_every_scene_come_back(name: str, tmp_path: Path) -> None:
    scene = tmj.load_scene(name)
    path, notes = save_mat(scene, tmp_path / f"{name}.mat")
    back = import_scene(path).scene
    ours, theirs = scene.structure, back.structure
    np.testing.assert_array_equal(theirs.rod_nodes, ours.rod_nodes)
    np.testing.assert_array_equal(theirs.string_nodes, ours.string_nodes)
    np.testing.assert_array_equal(theirs.stiffness, ours.stiffness)
    np.testing.assert_array_equal(theirs.rest_lengths, ours.rest_lengths)
    np.testing.assert_array_equal(theirs.rod_masses, ours.rod_masses)
    assert [point.mass for point in theirs.point_masses] == [point.mass for point in ours.point_masses]
    assert (back.gravity, back.duration) == (scene.gravity, scene.duration)
    np.testing.assert_array_equal(back.nodes0, ours.positions if scene.motions else scene.nodes0)
    for loads in (scene.loads,):
        np.testing.assert_array_equal(back.nodal_forces(0.0), scene.nodal_forces(0.0) if loads else 0.0)
    # As STEDY computes them: K = E π r² / Lk, Lk = rLP L, m = ρ π r² ℓ.
    data = loadmat(path, simplify_cells=True)
    lengths = ours.string_lengths(back.nodes0)
    rest = np.atleast_1d(data["strings"]["rLP"]) * lengths
    stiffness = np.atleast_1d(data["strings"]["E"]) * np.pi * np.atleast_1d(data["strings"]["r"]) ** 2 / rest
    np.testing.assert_allclose(rest, ours.rest_lengths, rtol=4 * EPS)
    np.testing.assert_allclose(stiffness, ours.stiffness, rtol=8 * EPS)
    bars = data["bars"]
    masses = np.atleast_1d(bars["rho"]) * np.pi * np.atleast_1d(bars["r"]) ** 2 * ours.rod_lengths
    np.testing.assert_allclose(masses, ours.rod_masses, rtol=8 * EPS)
    assert list(np.atleast_1d(data["node_names"])) == list(ours.node_names)
    assert any("water" in note for note in notes) == (scene.water is not None)


def read_stl(path: Path) -> np.ndarray:
    content = path.read_bytes()
    count = int(np.frombuffer(content, "<u4", 1, 80)[0])
    row = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
    assert len(content) == 84 + count * row.itemsize
    assert row.itemsize == 50
    return np.frombuffer(content, row, count, 84)["corners"]


def test_a_printed_shape_is_closed_and_as_large_as_its_members(tmp_path: Path) -> None:
    scene = tmj.load_scene("prism")
    triangles = shape(scene)
    volume = np.einsum("ni,ni->", triangles[:, 0], np.cross(triangles[:, 1], triangles[:, 2])) / 6
    # Capsules of π r² ℓ + 4/3 π r³, by prisms of 24 corners: less by sin(2π/24) / (2π/24), and caps by more.
    structure, thin = scene.structure, 0.25 * 0.02
    lengths = structure.string_lengths(scene.nodes0).sum()
    whole = 3 * (np.pi * 0.02**2 + 4 / 3 * np.pi * 0.02**3)
    whole += np.pi * thin**2 * lengths + 12 * 4 / 3 * np.pi * thin**3
    part = np.sin(2 * np.pi / CORNERS) / (2 * np.pi / CORNERS)
    assert part**3 * whole < volume < part * whole
    # Every edge is run through once in each direction: closed, and turned outwards.
    corners = np.round(triangles, 12)
    edges = np.concatenate([corners[:, [k, (k + 1) % 3]].reshape(-1, 6) for k in range(3)])
    there = {tuple(edge) for edge in edges.tolist()}
    assert all((*edge[3:], *edge[:3]) in there for edge in there)
    path = save_stl(scene, tmp_path / "prism.stl", scale=0.5)
    np.testing.assert_allclose(read_stl(path), 500 * triangles, rtol=1e-6, atol=1e-4)  # mm in single precision
    with pytest.raises(tmj.TensegrityError, match="scale = 0"):
        save_stl(scene, path, scale=0)


def test_the_command_writes_all_of_them(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    plain = tmp_path / "plain.xml"
    assert main(["export", "prism", "--out", str(plain)]) == 0
    assert capsys.readouterr().out == f"{plain}\n"
    assert plain.read_text() == scene_to_mjcf(tmj.load_scene("prism"))
    for words, files in (
        (["--out", "m.xml", "--for", "menagerie"], ["m.xml", "scene.xml"]),
        (["--out", "p_members.csv"], ["p_nodes.csv", "p_members.csv"]),
        (["--out", "p.mat"], ["p.mat"]),
        (["--out", "p.stl", "--scale", "2"], ["p.stl"]),
        (["--out", "p.toml"], ["p.toml"]),
    ):
        words[1] = str(tmp_path / words[1])
        assert main(["export", "prism", *words]) == 0
        said = capsys.readouterr()
        assert said.out == "".join(f"{tmp_path / file}\n" for file in files)
        assert all((tmp_path / file).is_file() for file in files)
        lost = words[1].endswith((".csv", ".mat"))
        assert ("note: the scene's target is left out" in said.err) == lost
    assert main(["export", "prism", "--out", str(tmp_path / "q.mat"), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["notes"] == [
        "the scene's target is left out",
        "the scene's control is left out",
    ]
    for words, message in (
        (["--out", "p.obj"], "--out p.obj: the name must end in .xml or .toml or .csv or .mat or .stl"),
        (["--out", str(tmp_path / "p.toml"), "--for", "warp"], "--for is for MJCF (.xml)"),
        (["--out", str(tmp_path / "p.xml"), "--scale", "2"], "--scale is for shapes (.stl)"),
        (["--out", str(tmp_path / "p.csv")], "must end in nodes.csv"),
    ):
        assert main(["export", "prism", *words]) == 2
        assert message in capsys.readouterr().err
