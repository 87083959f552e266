"""Strings that are not linear: what they may be, their curves in Python, in files, in sweeps and in other formats."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import quad

import tensegrity_mj as tmj
from tensegrity_mj.errors import OptionError, SceneError, StructureError
from tensegrity_mj.model import strings as law
from tensegrity_mj.model.text.reading import scene_from_toml
from tensegrity_mj.model.text.writing import scene_to_toml
from tensegrity_mj.studies.parameter_values import Scaled
from tensegrity_mj.studies.scene_parameters import changed_scene

POINTS = ((0.1, 10.0), (0.2, 40.0), (0.3, 40.0), (0.5, 60.0))
YIELDS = ((0.1, 20.0), (0.4, 26.0))


def string(**given):
    return tmj.String("s", ("a", "b"), **given)


def three(**scene) -> tmj.Scene:
    """Three masses below three nodes: on a curve, on one that yields, and on a constant force."""
    nodes = {f"{end}{n}": (float(n), 0.0, 0.0 if end == "h" else -1.25) for n in range(3) for end in "hm"}
    strings = (
        tmj.String("curve", ("h0", "m0"), curve=POINTS, rest_length=1.0, group="ropes"),
        tmj.String(
            "yields", ("h1", "m1"), curve=YIELDS, yields=True, tension=21.0, string_law="unclipped", damping=0.5
        ),
        tmj.String("constant", ("h2", "m2"), 0.0, tension=15.0),
    )
    masses = tuple(tmj.PointMass(f"m{n}", 2.0) for n in range(3))
    structure = tmj.Structure("three", nodes, strings=strings, fixed_nodes=("h0", "h1", "h2"), point_masses=masses)
    return tmj.Scene(structure, gravity=(0.0, 0.0, -9.81), **scene)


WRONG = {
    "no stiffness": ({}, "'stiffness' is missing"),
    "no tension": (
        {"stiffness": 0.0},
        "stiffness = 0.0; it must be > 0 N/m, or for a constant force 0 with a tension > 0",
    ),
    "a limit": ({"stiffness": 0.0, "tension": 3.0, "winch_speed": 1.0}, "no winch_speed"),
    "falls": (
        {"curve": ((0.1, 10.0), (0.2, 9.0))},
        "curve[1]: its tension of 9 N must be above zero and not below 10 N",
    ),
    "no tension at first": ({"curve": ((0.1, 0.0), (0.2, 9.0))}, "curve[0]: its tension of 0 N must be above zero"),
    "back": ({"curve": ((0.1, 10.0), (0.1, 12.0))}, "curve[1]: its stretch of 0.1 m must be above 0.1 m"),
    "from zero": ({"curve": ((0.0, 10.0), (0.1, 12.0))}, "curve[0]: its stretch of 0 m must be above 0 m"),
    "another slope": ({"stiffness": 99.0, "curve": POINTS}, "stiffness = 99 N/m, but its curve begins with 100 N/m"),
    "yields and stiffens": ({"curve": POINTS, "yields": True}, "nowhere rises faster than at first"),
    "yields nowhere": ({"stiffness": 9.0, "yields": True}, "yields needs a curve of two points or more"),
    "least length": ({"curve": POINTS, "min_rest_length": 0.1}, "min_rest_length is for linear strings"),
    "three numbers": ({"curve": ((0.1, 2.0, 3.0),)}, "curve = "),
    "no law": ({"stiffness": 9.0, "string_law": "cliped"}, "did you mean 'clipped'?"),
}


@pytest.mark.parametrize(("given", "words"), WRONG.values(), ids=WRONG)
def test_what_cannot_be_is_refused(given, words) -> None:
    with pytest.raises(StructureError) as caught:
        string(**given)
    assert str(caught.value).startswith("string 's'")
    assert words in str(caught.value)


def test_a_prestress_must_leave_a_rest_length() -> None:
    """59 N are at a stretch of 0.49 m, 159 N at one of 1.49 m, of 1.25 m there are."""
    structure = three().structure
    with pytest.raises(StructureError, match=r"its curve leaves it a rest length of -0\.24 m"):
        replace(structure, strings=(replace(structure.strings[0], rest_length=None, tension=159.0),))
    assert replace(structure, strings=(replace(structure.strings[0], rest_length=None, tension=59.0),)).rest_lengths[
        0
    ] == pytest.approx(1.25 - 0.49, abs=1e-15)


def test_curves_are_polygons_and_their_integrals() -> None:
    """Tension by interpolation, energy by quadrature, and the inverse: the least stretch with a tension."""
    curves = three().structure.curves
    s = np.linspace(-0.1, 0.8, 91)
    each = np.stack([s, s, s], axis=1)
    first = np.interp(s, [-1, 0, 0.1, 0.2, 0.3, 0.5, 1.5], [0, 0, 10, 40, 40, 60, 160])
    second = np.interp(s, [-1, 0, 0.1, 1.1], [0, 0, 20, 40])
    tension = curves.tension(each)
    np.testing.assert_allclose(tension, np.stack([first, second, np.full_like(s, 15.0)], axis=1), atol=1e-13)
    np.testing.assert_allclose(law.elastic_tension(curves, each + 1.0, 1.0), tension, atol=1e-12)
    for m, function in enumerate([lambda x: np.interp(x, [0, 0.1, 0.2, 0.3, 0.5, 1.5], [0, 10, 40, 40, 60, 160])]):
        work = [quad(function, 0, max(0.0, x), points=[0.1, 0.2, 0.3, 0.5])[0] for x in s]
        np.testing.assert_allclose(curves.energy(each)[:, m], work, atol=1e-10)
    found = curves.stretch(tension[s > 0.02])
    # On the level part, its beginning; of a constant force 0.
    level = np.where((s > 0.2) & (s <= 0.3), 0.2, s)[s > 0.02]
    np.testing.assert_allclose(found, np.stack([level, s[s > 0.02], np.zeros(len(level))], axis=1), atol=1e-14)
    slopes = curves.slope(np.array([[0.15, 0.3, 1.0], [0.25, 0.05, 1.0], [-0.1, -0.1, 1.0]]))
    np.testing.assert_allclose(slopes, [[300.0, 200.0, 0.0], [0.0, 200.0, 0.0], [0.0, 0.0, 0.0]], atol=1e-10)
    np.testing.assert_allclose(curves.slope(np.full(3, 0.3), loading=True)[1], 20.0, rtol=1e-12)
    # Unloaded from 0.4 m, 26 N: p = 0.4 - 26/200.
    unloading = curves.tension(np.full(3, 0.3), permanent=0.27)
    assert unloading[1] == pytest.approx(200 * 0.03)
    with pytest.raises(OptionError, match="pulls with a constant force"):
        tmj.simulate(three(), lambda t, n, v: [1.0, 1.0, 1.0], tmj.MuJoCo(1e-3), duration=0.01)


def test_the_python_law_is_that_of_the_engines() -> None:
    """Recorded tensions of a run against the same curves in NumPy; those of the damped string with its damper."""
    down = np.zeros((6, 3))
    down[[1, 3, 5], 2] = -1.0
    run = tmj.simulate(
        three(duration=0.6, initial_velocities=down), None, tmj.MuJoCo(1e-3, locate_slack=True), output_interval=0.01
    )
    structure = run.scene.structure
    lengths, rates = structure.string_lengths(run.nodes), structure.string_rates(run.nodes, run.velocities)
    before = np.concatenate([np.zeros((1, 3)), run.permanent_stretch[:-1]])
    elastic = structure.curves.tension(lengths - run.rest_lengths, run.permanent_stretch)
    np.testing.assert_allclose(run.force_densities * lengths, elastic, atol=1e-7)
    assert (run.permanent_stretch >= before).all()
    assert run.permanent_stretch[-1, 1] > 0.05
    total = elastic + structure.damping * rates
    np.testing.assert_allclose(run.tensions[:, [0, 2]], np.maximum(total, 0.0)[:, [0, 2]], atol=1e-7)
    assert run.energy_residual < 1e-6


def test_files_hold_them() -> None:
    scene = three()
    text = scene_to_toml(scene)
    again = scene_from_toml(text, "three.toml")
    assert again.structure == scene.structure
    assert "yields = true" in text
    assert 'string_law = "unclipped"' in text
    linear = scene_to_toml(tmj.load_scene("prism"))
    assert not any(key in linear for key in ("curve", "yields", "string_law"))


def test_defaults_and_groups_may_have_a_curve() -> None:
    text = """
    format = 1
    name = "two"
    nodes = { a = [0, 0, 0], b = [1, 0, 0], c = [2, 0, 0] }
    fixed_nodes = ["a", "c"]
    point_masses = [{ node = "b", mass = 1.0 }]
    strings = [{ name = "s", nodes = ["a", "b"] }, { name = "t", nodes = ["b", "c"], group = "ties" }]
    [defaults.strings]
    curve = [[0.1, 1.0], [0.2, 3.0]]
    [groups.ties]
    curve = [[0.1, 2.0]]
    """
    lines = text.replace("    ", "").replace("[defaults", "[structure.defaults").replace("[groups", "[structure.groups")
    for key in ("nodes", "fixed_nodes", "point_masses", "strings"):
        lines = lines.replace(f"\n{key} =", f"\nstructure.{key} =")
    structure = scene_from_toml(lines, "two.toml").structure
    assert structure.stiffness.tolist() == [10.0, 20.0]
    assert structure.strings[1].is_linear


def test_stiffness_scales_a_curve() -> None:
    structure = three().structure
    twice = structure.with_strings(stiffness=[200.0, 400.0, 0.0])
    assert twice.strings[0].curve == tuple((s, 2 * T) for s, T in POINTS)
    scene = three()
    for path, value in (("strings[curve].stiffness", 200.0), ("strings[ropes].curve", Scaled(2.0))):
        changed = changed_scene(scene, "structure", path, f"structure.{path}", value)
        assert changed.structure.strings[0].curve == twice.strings[0].curve
    own = changed_scene(scene, "structure", "strings[curve].string_law", "structure.strings", "unclipped")
    assert own.structure.clipped.tolist() == [False, False, True]
    with pytest.raises(OptionError):
        changed_scene(scene, "structure", "strings[curve].curve", "structure.strings[curve].curve", 3.0)


def test_copies_keep_them() -> None:
    structure = three().structure
    assert structure.moved([0, 0, 0.3], (1, 2, 3)).strings == structure.strings
    assert structure.mirrored((1, 0, 0)).strings == structure.strings
    both = structure.merged(structure.moved(translation=(0, 5, 0)), prefix="b_")
    assert [one.curve for one in both.strings[3:]] == [one.curve for one in structure.strings]


def test_mjcf_has_first_slopes_and_constant_forces(tmp_path) -> None:
    from tensegrity_mj.engines.mujoco.mjcf import scene_to_mjcf
    from tensegrity_mj.exchange.importing import import_scene

    path, text = tmp_path / "three.xml", scene_to_mjcf(three(), 1e-3)
    path.write_text(text)
    assert "Tension curves of strings are not in this file: it has their first slopes." in text
    assert "ctrl of a string of constant force is what is taken off it [N]." in text
    assert "first slopes" not in scene_to_mjcf(tmj.load_scene("prism"), 1e-3)
    strings = {one.name: one for one in import_scene(path).scene.structure.strings}
    assert strings["curve"].stiffness == pytest.approx(100.0)
    assert (strings["constant"].stiffness, strings["constant"].tension) == (0.0, pytest.approx(15.0))


def test_tables_say_what_they_leave_out(tmp_path) -> None:
    from tensegrity_mj.exchange.tables import left_out

    notes = "; ".join(left_out(three(), ()))
    for words in ("curves of strings 'curve', 'yields'", "laws of strings 'yields'"):
        assert words in notes


def test_constant_forces_are_in_tables_and_refused_where_strings_need_a_stiffness(tmp_path) -> None:
    from tensegrity_mj.exchange import import_scene, save_mat
    from tensegrity_mj.exchange.tables import save_csv

    files, _ = save_csv(three(), tmp_path / "nodes.csv")
    strings = {one.name: one for one in import_scene(files[0]).scene.structure.strings}
    assert (strings["constant"].stiffness, strings["constant"].tension) == (0.0, 15.0)
    with pytest.raises(
        StructureError, match=r"string 'constant' pulls with a constant force: .*save the scene as MJCF"
    ):
        save_mat(three(), tmp_path / "three.mat")


def test_uses_that_have_no_memory_or_are_linear_refuse_them() -> None:
    from tensegrity_mj.engines.requirements import require

    structure = three().structure
    scene = three().with_(structure=structure.with_strings(damping=0.0))
    for use, words in (("law_in", "string 'yields' yields"), ("dm_control models", "'curve' has a curve")):
        with pytest.raises((OptionError, SceneError), match=words):
            require(None, scene, use)
