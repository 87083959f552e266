"""Tables and MJCF: round trips of every shipped scene, files of others, and what is refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import tensegrity_mj as tmj
from tensegrity_mj.engines.mujoco.mjcf import save_mjcf
from tensegrity_mj.errors import FormatError
from tensegrity_mj.exchange import FORMATS, ImportOptions, import_scene, save_mat
from tensegrity_mj.exchange.tables import save_csv
from tensegrity_mj.model import rods
from tensegrity_mj.model.text.sources import scene_names

DATA = Path(__file__).resolve().parents[1] / "data" / "exchange"
EPS = np.finfo(float).eps


def same_supports(first: tmj.Structure, second: tmj.Structure) -> None:
    """Supports hold the same points of the same rods in the same directions."""
    rods = {rod.name: rod for rod in second.rods}
    for rod in first.rods:
        other = rods[rod.name].support
        assert (rod.support.plane is None) == (other.plane is None)
        assert len(rod.support.constraint_rows) == len(other.constraint_rows)
        if len(rod.support.directions):
            assert other.sigma == pytest.approx(rod.support.sigma, abs=4 * EPS)
            projected = rod.support.translation_basis.T @ other.constraint_rows.T
            np.testing.assert_allclose(projected, 0, rtol=0, atol=8 * EPS)


def test_bodies_do_not_come_back_from_mjcf(tmp_path: Path) -> None:
    file = save_mjcf(tmj.load_scene("spine"), tmp_path / "scene.xml")
    with pytest.raises(FormatError, match=r"body 'vertebra1': 6 capsules or cylinders; a rigid body of several rods"):
        import_scene(file)


@pytest.mark.parametrize("name", [name for name in scene_names() if name != "spine"])
def test_mjcf_of_every_scene_comes_back(name: str, tmp_path: Path) -> None:
    scene = tmj.load_scene(name)
    found = import_scene(save_mjcf(scene, tmp_path / "scene.xml"))
    ours, back = scene.structure, found.scene.structure
    rows = [back.node_index[node] for node in ours.node_names]
    # Frames by quaternions, and frames within frames: a few roundings of the size for each body up to the root.
    size = float(np.abs(scene.nodes0).max()) + 1.0
    np.testing.assert_allclose(found.scene.nodes0[rows], scene.nodes0, rtol=0, atol=64 * EPS * size)
    assert {rod.name: (rod.nodes, rod.mass, rod.radius) for rod in back.rods} == {
        rod.name: (rod.nodes, rod.mass, rod.radius) for rod in ours.rods
    }
    assert [string.nodes for string in back.strings] == [string.nodes for string in ours.strings]
    np.testing.assert_array_equal(back.stiffness, ours.stiffness)
    np.testing.assert_array_equal(back.damping, ours.damping)
    np.testing.assert_allclose(back.rest_lengths, ours.rest_lengths, rtol=2 * EPS)  # k L0 divided by k
    same_supports(ours, back)
    assert {point.node: point.mass for point in back.point_masses} == {p.node: p.mass for p in ours.point_masses}
    assert (set(back.fixed_nodes), back.string_law) == (set(ours.fixed_nodes), ours.string_law)
    assert (found.scene.gravity, found.scene.contact) == (scene.gravity, scene.contact)
    notes = " ".join(found.notes)
    if scene.motions:
        assert "what drives" in notes
    else:
        np.testing.assert_allclose(found.scene.velocities0[rows], scene.velocities0, rtol=0, atol=64 * EPS * size)
    for held, word in ((scene.water, "water"), (scene.loads, "external loads"), (scene.motions, "motions")):
        assert (word in notes) == bool(held)


# Strings through more than two nodes have no place there: `test_pulley_exchange` has the refusal.
@pytest.mark.parametrize("name", [name for name in scene_names() if name not in ("pulley", "spine")])
def test_tables_of_every_scene_come_back(name: str, tmp_path: Path) -> None:
    scene = tmj.load_scene(name)
    paths, notes = save_csv(scene, tmp_path / f"{name}_nodes.csv")
    assert [path.name for path in paths] == [f"{name}_nodes.csv", f"{name}_members.csv"]
    for path in paths:
        back = import_scene(path).scene
        assert back.name == name
        np.testing.assert_array_equal(back.nodes0, scene.nodes0 if not scene.motions else scene.structure.positions)
        if not scene.motions:
            np.testing.assert_array_equal(back.velocities0, scene.velocities0)
        same_supports(scene.structure, back.structure)
        np.testing.assert_array_equal(back.structure.stiffness, scene.structure.stiffness)
        np.testing.assert_allclose(back.structure.rest_lengths, scene.structure.rest_lengths, rtol=4 * EPS)
        assert [(rod.name, rod.nodes, rod.mass, rod.radius, rod.section) for rod in back.structure.rods] == [
            (rod.name, rod.nodes, rod.mass, rod.radius, rod.section) for rod in scene.structure.rods
        ]
        assert back.structure.point_masses == scene.structure.point_masses
        assert back.structure.fixed_nodes == scene.structure.fixed_nodes
    for key in ("gravity", "water", "contact", "target", "control", "motions", "loads"):
        default = (0, 0, 0) if key == "gravity" else ()
        held = getattr(scene, key) not in (None, default)
        assert any(f"scene's {key}" in note for note in notes) == held


@pytest.mark.parametrize("way", ["rest_length", "tension", "force_density"])
def test_two_members_between_the_same_nodes_are_one_string_with_what_both_have(way: str, tmp_path: Path) -> None:
    """Stiffness, damping, tension and mass add up, whichever of them is first; strings are 2 m long."""
    nodes = "name,x,y,z,fixed\na,0,0,0,xyz\nb,2,0,0,xyz\n"
    numbers = {"rest_length": (1.9, 1.8), "tension": (10.0, 60.0), "force_density": (5.0, 30.0)}[way]
    rows = [f"s,string,a,b,100,1,{numbers[0]},", f"t,string,b,a,300,2,{numbers[1]},0.5"]
    for order in (rows, rows[::-1]):
        members = "\n".join([f"name,kind,i,j,stiffness,damping,{way},mass", *order])
        (tmp_path / "own_nodes.csv").write_text(nodes, encoding="utf-8")
        (tmp_path / "own_members.csv").write_text(members, encoding="utf-8")
        found = import_scene(tmp_path / "own_nodes.csv", options=ImportOptions())
        (string,) = found.scene.structure.given.strings
        assert (string.stiffness, string.damping, string.mass) == (400.0, 3.0, 0.5)
        assert string.rest_length is not None
        assert string.stiffness * (2.0 - string.rest_length) == pytest.approx(70.0, rel=1e-12)


def test_velocities_come_back_from_every_format(tmp_path: Path) -> None:
    scene = tmj.load_scene("prism_drop")
    turn = np.cross([0.3, -0.2, 0.5], scene.nodes0 - scene.nodes0.mean(axis=0))
    scene = scene.with_(initial_velocities=turn + np.array([1.0, 2.0, 3.0]))
    save_csv(scene, tmp_path / "a_nodes.csv")
    save_mjcf(scene, tmp_path / "a.xml")
    save_mat(scene, tmp_path / "a.mat")
    for name, size in (("a_nodes.csv", 0.0), ("a.mat", 0.0), ("a.xml", 64 * EPS * 4)):  # quaternions, and 4 m/s
        back = import_scene(tmp_path / name).scene
        rows = [back.structure.node_index[node] for node in scene.structure.node_names] if size else slice(None)
        np.testing.assert_allclose(back.velocities0[rows], scene.velocities0, rtol=0, atol=size)


NODES = "name,x,y,z,fixed,mass\na,0,0,0,xyz,\nb,1,0,0,,\nc,1,0,1,xyz,\nd,2,0,0,,0.5\n"
MEMBERS = "name,kind,i,j,mass,stiffness,group\nr,rod,a,b,2,,\ns,string,b,c,,100,side\nt,string,b,d,,,side\n"


def tables(folder: Path, nodes: str = NODES, members: str = MEMBERS) -> Path:
    (folder / "my_nodes.csv").write_text(nodes, encoding="utf-8")
    (folder / "my_members.csv").write_text(members, encoding="utf-8")
    return folder / "my_nodes.csv"


def test_tables_of_ones_own_are_read(tmp_path: Path) -> None:
    found = import_scene(tables(tmp_path), options=ImportOptions(stiffness=7.0, rod_radius=0.02))
    structure = found.scene.structure
    assert structure.fixed_nodes == ("c",)
    assert structure.rods[0].support == tmj.Support.pinned(0.0)
    assert structure.rods[0].radius == 0.02
    assert [string.stiffness for string in structure.strings] == [100.0, 7.0]
    assert structure.point_masses[0].mass == 0.5
    assert found.notes == ()
    assert [string.group for string in structure.strings] == ["side", "side"]
    save_csv(found.scene, tmp_path / "again_nodes.csv")
    assert import_scene(tmp_path / "again_nodes.csv").scene.structure.strings == structure.strings
    # Semicolons, a mark of the byte order, comments, empty lines and cells in quotes, as spreadsheets write them.
    other = "\ufeff# mine\n" + NODES.replace(",", ";").replace("a;", '"a";') + "\n\n"
    again = import_scene(tables(tmp_path, other), options=ImportOptions(stiffness=7.0, rod_radius=0.02))
    assert again.scene == found.scene


WRONG_TABLES = {
    ("nodes", "name,x,y,z,fixed,mass", ""): "line 2: 'x' is missing; it must be a number",
    ("nodes", "fixed", "fixd"): "column 'fixd' is unknown (did you mean 'fixed'?); allowed: name, x, y, z, fixed",
    ("nodes", "b,1,0", 'b,"1,5",0'): "line 3: x = '1,5' (a text); it must be a number",
    ("nodes", "b,1,0,0", "b,1,0"): "line 3: 5 cells; the first line has 6",
    ("nodes", "b,1", "a,1"): "line 3: name = 'a' (a text); it must be a name of its own: a node above has it",
    ("nodes", "xyz", "xq"): "line 2: fixed = 'xq' (a text); it must be the axes in which the node is held",
    ("nodes", "name,", "x,"): "column 'x' stands twice",
    ("members", "rod,a", "rode,a"): 'line 2: kind = \'rode\' (a text); it must be "rod" or "string"',
    (
        "members",
        "rod,a,b",
        "rod,a,bb",
    ): "line 2: j = 'bb' (a text); it must be the name of a node (did you mean 'b'?): 'a'",
    ("members", "a,b,2", "a,b,"): "line 2: 'mass' is missing",
    ("members", "c,,100", "c,,"): "line 3: 'stiffness' is missing",
    ("members", "c,,100", "c,,-1"): "my_nodes.csv: line 3: stiffness = -1.0",
    ("members", "b,d,,,side", 'b,d,,"7,side'): "line 4: unexpected end of data",
}


@pytest.mark.parametrize("case", WRONG_TABLES, ids=lambda case: "-".join(case)[:50])
def test_what_is_wrong_in_tables_is_named_by_line(case: tuple[str, str, str], tmp_path: Path) -> None:
    which, old, new = case
    members = MEMBERS.replace("d,,,side", "d,,3,side") if old != "b,d,,,side" else MEMBERS
    texts = {"nodes": NODES, "members": members}
    assert old in texts[which]
    texts[which] = (
        texts[which].replace(old + ("\n" if not new else ""), new, 1) if new else texts[which].replace(old, "name,y")
    )
    if not new:
        texts[which] = "name,y,z\na,0,0\n"
    path = tables(tmp_path, **texts)
    with pytest.raises(tmj.TensegrityError) as error:
        import_scene(path)
    assert WRONG_TABLES[case] in str(error.value).replace("my_members.csv: ", "my_nodes.csv: ")
    assert "\n" not in str(error.value)


def test_mjcf_of_others_is_read_by_what_it_means() -> None:
    found = import_scene(DATA / "robot.xml")
    structure, scene = found.scene.structure, found.scene
    assert scene.gravity == (0, 0, -9.8)
    assert scene.contact is not None
    # MuJoCo's default: a time of 0.02 s, a ratio of 1 and d₁ = 0.95 are k = 1/(0.95 * 0.02)², b = 2/(0.95 * 0.02).
    assert (scene.contact.floor, scene.contact.rods) == (0.0, True)
    assert scene.contact.stiffness == pytest.approx(1 / 0.019**2, rel=1e-12)
    assert scene.contact.damping == pytest.approx(2 / 0.019, rel=1e-12)
    assert scene.contact.friction == 1.0
    upper, lower = structure.rods
    np.testing.assert_allclose(structure.nodes["a"], (-0.5, 0, 2), rtol=0, atol=1e-15)  # 90 degrees about y
    assert upper.support == tmj.Support.free()
    assert lower.support == tmj.Support.pinned(0.0)
    assert lower.nodes[1] in ("c", "eye")
    capsule = 1000 * np.pi * (0.02**2 * 0.8 + 4 / 3 * 0.02**3)
    assert structure.rod_masses[1] == pytest.approx(capsule, rel=1e-12)
    # Of its shaft as a solid cylinder, and of both halves of a ball at its ends, about their own centres.
    ball, shaft = 1000 * np.pi * 4 / 3 * 0.02**3, 1000 * np.pi * 0.02**2 * 0.8
    moment = shaft * (0.8**2 / 12 + 0.02**2 / 4) + ball * (2 / 5 * 0.02**2 + 0.4**2 + 0.4 * 0.75 * 0.02)
    _, J = rods.inertia_of_rods(structure)
    assert J[1] == pytest.approx(moment + capsule * 0.4**2, rel=1e-9)  # about its pin
    strings = {string.name: string for string in structure.strings}
    assert set(strings) == {"t1", "t2", "t3", "t4", "t5"}
    assert len(strings["t3"].nodes) == 3
    assert (strings["t1"].stiffness, strings["t1"].damping, strings["t1"].rest_length) == (200, 3, 0.9)
    assert (strings["t2"].stiffness, strings["t2"].damping) == (100, 2)
    assert strings["t2"].rest_length == pytest.approx(0.8, rel=1e-15)  # the control of keyframe "home"
    assert structure.fixed_nodes == ("hook",)
    assert structure.point_masses == (tmj.PointMass("d", 0.3),)
    notes = " ".join(found.notes)
    for part in (
        "is a mesh, whose file is not read",
        "actuator 'm1' is no spring along a tendon",
        "tendon 't1' pushes where it is shorter than 0.9 m",
        "tendon 't2' ends 0.02 m from node 'b'",
    ):
        assert part in notes
    assert "pushes where it is shorter than 0" not in notes.replace("0.9 m", "")


def test_what_has_no_name_in_mjcf_gets_one_by_its_number(tmp_path: Path) -> None:
    path = tmp_path / "plain.xml"
    pair = (
        '<geom type="capsule" fromto="0 0 0 0 0 1" size="0.1"/><site/><site name="{0}" pos="0 0 1"/><site pos="0 0 1"/>'
    )
    bodies = "".join(
        f'<body pos="{x} 0 0"><freejoint/>{pair.format(name)}</body>' for x, name in ((0, "top"), (2, "up"))
    )
    path.write_text(f"<mujoco><worldbody>{bodies}</worldbody></mujoco>", encoding="utf-8")
    structure = import_scene(path).scene.structure
    assert [rod.name for rod in structure.rods] == ["rod1", "rod2"]
    assert [rod.nodes for rod in structure.rods] == [("node1", "top"), ("node3", "up")]
    np.testing.assert_array_equal([structure.nodes[name][0] for name in ("node1", "top", "node3", "up")], [0, 0, 2, 2])


BODY = """<mujoco><worldbody><body name="one" pos="0 0 1">{}
<geom type="capsule" fromto="0 0 0 0 0 1" size="0.1"/><site name="p"/>{}</body></worldbody></mujoco>"""
TWO = BODY.format("<freejoint/>", '<body name="two"><freejoint/><geom size="1"/></body>')
MANY = '<mujoco><worldbody><replicate count="999999999"><geom size="1"/></replicate></worldbody></mujoco>'
WRONG_MODELS = {
    "<mujoco>": "not valid XML",
    "<robot/>": "its first element is <robot>; that of MJCF is <mujoco>",
    '<!DOCTYPE x [<!ENTITY a "b">]><mujoco/>': "a document type or an entity",
    '<mujoco><include file="/etc/passwd"/></mujoco>': "<include>: it names another file",
    MANY: "<replicate>: it stands for many copies",
    '<mujoco><extension><plugin plugin="a.b"/></extension></mujoco>': "<extension>: it is code",
    '<mujoco><asset><model file="a.xml"/></asset></mujoco>': "<model>: it names another file",
    "<mujoco><worldbody><geom/></worldbody></mujoco>": "MuJoCo does not compile it",
    "<mujoco/>": "has no nodes",
    TWO: "MuJoCo does not compile it",
    BODY.format("<freejoint/>", '<geom type="cylinder" size="1 1"/>'): "body 'one': 2 capsules or cylinders",
    BODY.format('<joint type="slide"/>', ""): "body 'one': it slides without turning",
    BODY.format('<joint type="ball" pos="0.5 0 0"/>', ""): "body 'one': its joint is off its axis",
    BODY.format(
        "<freejoint/>",
        '<body name="hung" pos="0 0 0.5"><joint type="ball"/>'
        '<geom type="capsule" fromto="0 0 0 1 0 0" size="0.1"/></body>',
    ): "body 'one': a joint is 0.5 m from its nearer end",
}


@pytest.mark.parametrize("text", WRONG_MODELS, ids=lambda text: WRONG_MODELS[text])
def test_what_is_wrong_in_mjcf_is_named_in_one_line(text: str, tmp_path: Path) -> None:
    path = tmp_path / "one.xml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(tmj.TensegrityError) as error:
        import_scene(path)
    assert WRONG_MODELS[text] in str(error.value)
    assert str(error.value).startswith(str(path))
    assert "\n" not in str(error.value)


def test_formats_and_options_are_checked(tmp_path: Path) -> None:
    path = tables(tmp_path)
    for given, message in (
        ({"path": tmp_path / "x.step"}, r"x\.step: no format has such a name: \.yaml/\.yml \(ntrt\)"),
        ({"path": tmp_path / "x.toml"}, "a .toml file is a scene of this package already"),
        ({"path": path, "format": "cvs"}, r"format = 'cvs' \(did you mean 'csv'\?\); allowed: ntrt, mat"),
        ({"path": path, "options": ImportOptions(unit=0.1)}, "only NTRT's files count in a unit of their own"),
        ({"path": tmp_path / "x.csv"}, "must end in nodes.csv"),
        ({"path": tmp_path / "no_nodes.csv"}, "no_nodes.csv: no such file"),
    ):
        with pytest.raises(tmj.TensegrityError, match=message):
            import_scene(**given)  # type: ignore[arg-type]
    with pytest.raises(tmj.TensegrityError, match="import options: rod_mass = -1"):
        ImportOptions(rod_mass=-1.0)
    assert set(FORMATS) == {"ntrt", "mat", "matlab", "csv", "mjcf"}


def test_supports_of_nodes_find_rods_or_are_noted(tmp_path: Path) -> None:
    nodes = "name,x,y,z,fixed\na,0,0,0,xyz\nb,1,0,0,xz\nc,1,1,0,xyz\nd,0,1,0,xyz\ne,5,5,5,\n"
    members = "name,kind,i,j,mass,stiffness\nr1,rod,a,b,1,\nr2,rod,c,d,1,\n"
    members += "s1,string,b,c,,10\ns2,string,c,b,,10\ns3,string,a,b,,10\n"
    found = import_scene(tables(tmp_path, nodes, members))
    structure = found.scene.structure
    assert [rod.name for rod in structure.rods] == ["r1"]
    assert structure.fixed_nodes == ("c",)
    assert [string.stiffness for string in structure.strings] == [20.0]
    notes = " ".join(found.notes)
    for part in (
        "rods held at both ends cannot move, and are left out: 'r2'",
        "string 's2' joins the nodes of 's1': one string stands for both",
        "string 's3' runs along rod 'r1'",
        "nodes of no member are left out: 'd', 'e'",
    ):
        assert part in notes
    # Its rod is held at 'a', and has one support.
    assert [(one.name, dict(one.nodes), one.direction) for one in structure.constraints] == [
        ("b x", {"b": 1.0}, (1, 0, 0))
    ]
