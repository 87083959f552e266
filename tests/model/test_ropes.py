"""Strings with mass: what a structure makes of them, and how they come out of it again."""

from __future__ import annotations

import itertools
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rope_scenes import G, catenary, mast, rope, weighted

import tensegrity_mj as tmj
from tensegrity_mj.errors import FormatError, SceneError, StructureError
from tensegrity_mj.linearization import linearize
from tensegrity_mj.model import Break, Motion, RopeStart, save_scene
from tensegrity_mj.statics import find_equilibrium, natural_modes
from tensegrity_mj.studies.parameter_values import Scaled
from tensegrity_mj.studies.parameters import Draft

ENGINES = {"mujoco": tmj.MuJoCo(), "dae": tmj.DAE(), "ode": tmj.ODE()}


def string_of(scene: tmj.Scene) -> tmj.String:
    return next(string for string in scene.structure.given.strings if string.mass is not None)


def closed_form(segments: int) -> np.ndarray:
    """Angular frequencies [rad/s] of `rope` under 50 N, of its points at the middles of equal pieces.

    Across it an end at half a spacing stands still as if the next point beyond mirrored the last: x_i =
    sin(jπ(i - ½)/n), whence ω = 2 √(T/(m_b a)) sin(jπ/2n) with m_b = m/n and a = L/n, twice; along it T/a is n k.
    """
    T, m, L, k, n = 50.0, 0.4, 2.0, 1e4, segments
    shapes = np.sin(np.arange(1, n + 1) * np.pi / (2 * n))
    across, along = 2 * n * np.sqrt(T / (m * L)) * shapes, 2 * n * np.sqrt(k / m) * shapes
    return np.sort(np.concatenate([across, across, along]))


@pytest.mark.parametrize("segments", [1, 3, 8, 40])
def test_natural_modes_of_a_taut_rope_are_those_of_its_points(segments: int) -> None:
    """To round-off: some n eps of the largest of squares that differ by (2 n/π)² k L/T = 2.6e5 for 40 segments."""
    modes = natural_modes(find_equilibrium(rope(segments, tension=50.0)))
    np.testing.assert_allclose(2 * np.pi * np.sort(modes.frequencies), closed_form(segments), rtol=1e-9)


@pytest.mark.parametrize("engine", ENGINES)
def test_linear_models_have_the_same_frequencies(engine: str) -> None:
    eigenvalues = linearize(rope(8, tension=50.0), ENGINES[engine]).eigenvalues
    np.testing.assert_allclose(np.sort(np.abs(eigenvalues.imag))[::2], closed_form(8), rtol=1e-9)
    assert np.abs(eigenvalues.real).max() < 1e-6 * np.abs(eigenvalues).max()


def test_frequencies_converge_to_those_of_a_vibrating_string_with_the_square_of_segments() -> None:
    """f_j = (j/2L) √(T/μ) less the part z²/6 - z⁴/120 of sin z / z, z = jπ/2n: the last is z²/20 of the first."""
    for segments in (10, 20, 40):
        frequencies = np.sort(natural_modes(find_equilibrium(rope(segments, tension=50.0))).frequencies)[::2][:2]
        j = np.array([1, 2])
        exact = j / (2 * 2.0) * np.sqrt(50.0 / (0.4 / 2.0))
        z = j * np.pi / (2 * segments)
        np.testing.assert_allclose(1 - frequencies / exact, z**2 / 6, rtol=(z**2 / 20 * 1.1).max())


def test_a_rope_hangs_as_a_catenary_with_the_square_of_segments() -> None:
    """Found from the straight line, where it is slack. Errors fall by 4, but for their next order, some 1/n of them."""
    H, shape = catenary(2.0, 2.5, 1.0, 2000.0)
    places, pulls = [], []
    for segments in (10, 20, 40):
        scene = rope(segments, mass=1.0, stiffness=2000.0, rest_length=2.5).with_(gravity=(0.0, 0.0, -G))
        found = find_equilibrium(scene)
        x, z = shape((np.arange(segments) + 0.5) / segments * 2.5)
        places.append(float(np.hypot(found.nodes[2:, 0] - x, found.nodes[2:, 2] - z).max()))
        # The end carries half the weight, whatever the number of segments.
        slope = found.nodes[2] - found.nodes[0]
        pull = found.tensions[0] * slope / np.linalg.norm(slope)
        assert pull[2] == pytest.approx(-G / 2, rel=1e-9)
        pulls.append(abs(float(pull[0]) - H))
    for errors in (places, pulls):
        assert errors[0] < 0.02
        for one, other in itertools.pairwise(errors):
            assert 3.7 < one / other < 4.3


def test_a_damped_rope_comes_to_rest_in_its_equilibrium() -> None:
    """Its slowest mode falls as e^(-t/1.6 s): 4e-6 of half a metre after 20 s."""
    scene = rope(6, mass=1.0, stiffness=500.0, damping=40.0, rest_length=2.02).with_(gravity=(0.0, 0.0, -G))
    run = tmj.simulate(scene, None, tmj.DAE(method=tmj.Method.RK4, timestep=2e-4), duration=20.0)
    assert np.abs(run.nodes[-1] - find_equilibrium(scene).nodes).max() < 2e-6


def test_what_stands_for_a_rope_has_its_numbers() -> None:
    given = {"damping": 3.0, "strength": 90.0, "max_force_density": 70.0, "min_rest_length": 0.5, "winch_speed": 0.2}
    structure = rope(4, tension=50.0, **given, group="lines").structure  # type: ignore[arg-type]
    assert structure.node_names == ("a", "b", "s1.1", "s1.2", "s1.3", "s1.4")
    assert [string.name for string in structure.strings] == ["s1.1", "s1.2", "s1.3", "s1.4", "s1.5"]
    assert [string.nodes for string in structure.strings][0::4] == [("a", "s1.1"), ("s1.4", "b")]
    np.testing.assert_allclose(structure.positions[2:, 0], [0.25, 0.75, 1.25, 1.75], rtol=1e-15)
    parts = np.array([0.125, 0.25, 0.25, 0.25, 0.125])
    np.testing.assert_allclose(structure.rest_lengths, parts * (2.0 - 50.0 / 1e4), rtol=1e-15)
    np.testing.assert_allclose(1 / structure.stiffness, parts / 1e4, rtol=1e-15)
    np.testing.assert_allclose(1 / structure.damping, parts / 3.0, rtol=1e-15)
    np.testing.assert_allclose(structure.limits("max_force_density"), 70.0 / parts, rtol=1e-15)
    np.testing.assert_allclose(structure.limits("min_rest_length"), 0.5 * parts, rtol=1e-15)
    np.testing.assert_allclose(structure.limits("winch_speed"), 0.2 * parts, rtol=1e-15)
    assert {(string.strength, string.group) for string in structure.strings} == {(90.0, "lines")}
    assert [point.mass for point in structure.point_masses] == [0.1] * 4
    taut = structure.stiffness * (structure.string_lengths(structure.positions) - structure.rest_lengths)
    np.testing.assert_allclose(taut, 50.0, rtol=1e-10)
    assert string_of(rope(4)).segments == 4
    assert len(replace(structure, strings=(replace(string_of(rope(4)), segments=None),)).ropes[0].points) == 10


@pytest.mark.parametrize("plane", [(0.0, 1.0, 0.0), None])
def test_a_rope_among_what_moves_in_a_plane_stays_there(plane: tuple[float, float, float] | None) -> None:
    rod = tmj.Rod("rod", ("o", "p"), 1.0, support=tmj.Support.pinned(plane=plane))
    nodes = {"o": (0.0, 0.0, 0.0), "p": (1.0, 0.0, 0.0), "q": (1.0, 0.0, 1.0)}
    line = tmj.String("s", ("p", "q"), 100.0, mass=0.1, segments=2)
    found = tmj.Structure("boom", nodes, (rod,), (line,), ("q",))
    assert [point.plane for point in found.point_masses] == [plane] * 2


def test_files_have_the_rope_and_not_what_stands_for_it(tmp_path) -> None:  # type: ignore[no-untyped-def]
    scene = mast()
    moved = np.array(scene.nodes0)
    moved[scene.structure.node_index["s1.2"]] += (0.0, 0.1, 0.0)
    for one in (scene, scene.with_(initial_nodes=moved), weighted()):
        path = save_scene(one, tmp_path / "scene.toml")
        again = tmj.load_scene(path)
        assert again == one
        assert again.structure == one.structure
        assert [again.nodes0.tobytes(), again.velocities0.tobytes()] == [
            one.nodes0.tobytes(),
            one.velocities0.tobytes(),
        ]
    text = save_scene(scene, tmp_path / "scene.toml").read_text()
    assert "s1." not in text
    assert "mass = 0.2, segments = 4 }" in text
    text = save_scene(scene.with_(initial_nodes=moved), tmp_path / "scene.toml").read_text()
    assert re.findall(r"s1\.\d", text) == ["s1.2"]


def test_a_start_that_leaves_points_out_has_them_between_the_ends(tmp_path) -> None:  # type: ignore[no-untyped-def]
    scene = mast()
    head = save_scene(scene, tmp_path / "scene.toml").read_text()
    (tmp_path / "scene.toml").write_text(head + "[scene.initial_velocities]\ntip = [0.0, 0.8, 0.0]\n")
    found = tmj.load_scene(tmp_path / "scene.toml")
    np.testing.assert_allclose(found.velocities0[5:, 1], [0.7, 0.5, 0.3, 0.1], rtol=1e-15)
    assert found == scene.with_(initial_velocities=[[0, 0, 0], [0, 0.8, 0], [0, 0, 0], [0, 0, 0], [0, 0, 0]])
    (tmp_path / "scene.toml").write_text(
        head + "[scene.initial_velocities]\ntip = [0.0, 0.8, 0.0]\n's1.4' = [0, 0, 1]\n"
    )
    np.testing.assert_allclose(tmj.load_scene(tmp_path / "scene.toml").velocities0[-1], [0, 0, 1])
    (tmp_path / "scene.toml").write_text(head + "[scene.initial_velocities]\n's1.5' = [0, 0, 1]\n")
    with pytest.raises(FormatError, match=re.escape("unknown node 's1.5'")):
        tmj.load_scene(tmp_path / "scene.toml")


def test_points_are_given_all_or_none() -> None:
    structure = rope(3, tension=50.0).structure
    given = structure.given
    for names in (["s1.1"], ["s1.3"], ["s1.1", "s1.2"]):
        nodes = {**given.nodes, **dict.fromkeys(names, (1.0, 0.0, 0.5))}
        with pytest.raises(
            StructureError, match=rf"node '{names[0]}' has the name of a point of the string with mass 's1'"
        ):
            replace(structure, nodes=nodes, strings=given.strings, point_masses=given.point_masses, ropes=())
    # One point that stands elsewhere brings the others along into a file.
    nodes = {**structure.nodes, "s1.2": (1.0, 0.0, 0.5)}
    moved = replace(structure, nodes=nodes)
    assert set(moved.given.nodes) == set(structure.nodes)
    assert moved.nodes == nodes


def test_structures_that_are_made_of_others_have_their_ropes() -> None:
    structure = rope(3, tension=50.0).structure
    given = string_of(rope(3, tension=50.0))
    for other in (
        replace(structure, name="other"),
        structure.moved([0.1, 0.2, 0.3], [1.0, 2.0, 3.0]),
        structure.mirrored([1.0, 2.0, 0.0]),
    ):
        assert other.given.strings == (given,)
        assert list(other.given.nodes) == ["a", "b"]
        assert len(other.strings) == 4
    by_length = structure.with_strings(rest_length=structure.rest_lengths).given.strings
    assert by_length == (replace(given, tension=None, rest_length=by_length[0].rest_length),)
    assert by_length[0].rest_length == pytest.approx(2.0 - 50.0 / 1e4, rel=4 * np.finfo(float).eps)
    both = structure.merged(
        structure.mirrored([0.0, 1.0, 0.0]).moved(translation=[2.0, 0.0, 0.0]), {"a": "b"}, "other_"
    )
    assert [rope.string.name for rope in both.ropes] == ["s1", "other_s1"]
    assert both.node_names[3:] == (*(f"s1.{n}" for n in (1, 2, 3)), *(f"other_s1.{n}" for n in (1, 2, 3)))
    assert len(structure.merged(structure.mirrored([0.0, 1.0, 0.0]), True).ropes) == 1
    moved = replace(structure, nodes={**structure.nodes, "b": (4.0, 0.0, 0.0)})
    np.testing.assert_allclose(moved.positions[2:, 0], np.array([1, 3, 5]) * 4 / 6, rtol=1e-15)
    assert moved.rest_lengths.sum() == pytest.approx(4.0 - 50.0 / 1e4)
    assert replace(structure, strings=(replace(given, segments=5),)).node_names[-1] == "s1.5"
    light = replace(
        structure,
        strings=(replace(given, mass=None, segments=None),),
        point_masses=(tmj.PointMass("b", 1.0),),
        fixed_nodes=("a",),
    )
    assert (light.node_names, light.ropes) == (("a", "b"), ())
    sums = tmj.Structure.from_arrays(
        [[0, 0, 0], [1, 0, 0], [2, 0, 0]],
        np.zeros((0, 2), int),
        [[0, 1], [1, 2]],
        rod_mass=[],
        stiffness=10.0,
        string_mass=[0.0, 0.3],
        segments=2,
        fixed_nodes=[0, 2],
        point_masses={1: 1.0},
    )
    assert [string.mass for string in sums.given.strings] == [None, 0.3]
    assert sums.node_names == ("n1", "n2", "n3", "s2.1", "s2.2")


def test_numbers_of_strings_are_those_of_ropes_or_of_their_parts() -> None:
    structure = mast().structure
    assert string_of(tmj.Scene(structure.with_strings(damping=0.0))) == replace(string_of(mast()), damping=0.0)
    changed = structure.with_strings(stiffness=[100.0, 800.0, 300.0])
    assert string_of(tmj.Scene(changed)).stiffness == 800.0
    np.testing.assert_allclose(changed.stiffness, [100.0, 6400.0, 3200.0, 3200.0, 3200.0, 6400.0, 300.0], rtol=1e-15)
    same = structure.with_strings(damping=2 * structure.damping, rest_length=structure.rest_lengths / 2)
    assert string_of(tmj.Scene(same)).damping == pytest.approx(1.0, rel=1e-12)
    assert string_of(tmj.Scene(same)).rest_length == pytest.approx(0.475, rel=1e-12)
    # What was changed of parts one by one is a rope no more.
    parts = structure.with_strings(damping=np.arange(7.0))
    assert (parts.ropes, parts.given.strings) == ((), parts.strings)
    assert len(parts.point_masses) == 4
    with pytest.raises(StructureError, match=r"damping = .* of shape \(2,\)"):
        structure.with_strings(damping=[1.0, 2.0])


def test_a_rope_that_is_tied_elsewhere_is_straight_there() -> None:
    """A shape of its own is kept where it hangs, and no longer where it has other ends or another number of points."""
    structure = rope(3).structure
    bent = {f"s1.{n}": (n / 2, 0.1, -0.2 * n) for n in (1, 2, 3)}
    hanging = replace(structure, nodes={**structure.nodes, **bent, "c": (0.0, 3.0, 0.0)}, fixed_nodes=("a", "b", "c"))
    assert {name: hanging.nodes[name] for name in bent} == bent
    assert replace(hanging, name="other").nodes == hanging.nodes
    given = hanging.given.strings[0]
    stiffer = replace(hanging, strings=(replace(given, stiffness=2e4),))
    assert {name: stiffer.nodes[name] for name in bent} == bent
    tied = replace(hanging, strings=(replace(given, nodes=("a", "c")),))
    np.testing.assert_allclose([tied.nodes[name] for name in bent], [(0, y, 0) for y in (0.5, 1.5, 2.5)], atol=1e-15)
    shorter = replace(hanging, strings=(replace(given, segments=2),))
    np.testing.assert_allclose([shorter.nodes[f"s1.{n}"] for n in (1, 2)], [(0.5, 0, 0), (1.5, 0, 0)], atol=1e-15)


def test_the_mass_of_a_rope_is_that_of_its_points() -> None:
    """Changed alike it is the rope's; a point that has another mass is no part of a rope."""
    structure = rope(4, mass=0.4).structure

    def weighed(*masses: float) -> tmj.Structure:
        points = zip(structure.point_masses, masses, strict=True)
        return replace(structure, point_masses=tuple(replace(point, mass=mass) for point, mass in points))

    heavy = weighed(*[0.2] * 4)
    assert heavy.given.strings[0].mass == pytest.approx(0.8, rel=1e-15)
    assert [point.mass for point in replace(heavy, name="other").point_masses] == [0.2] * 4
    assert weighed(*[0.1] * 4).given.strings[0].mass == 0.4
    loose = weighed(0.1, 0.1, 0.1, 0.2)
    assert (loose.ropes, [point.mass for point in loose.point_masses]) == ((), [0.1, 0.1, 0.1, 0.2])


def test_an_equilibrium_is_kept_where_it_hangs(tmp_path) -> None:  # type: ignore[no-untyped-def]
    scene = rope(5, mass=1.0, rest_length=2.5).with_(gravity=(0.0, 0.0, -G))
    found = find_equilibrium(scene).scene("hanging")
    assert len(found.structure.ropes) == 1
    assert tmj.load_scene(save_scene(found, tmp_path / "scene.toml")).nodes0.tobytes() == found.nodes0.tobytes()
    turned = found.structure.moved([0.0, 0.0, np.pi / 2])
    np.testing.assert_allclose(turned.positions[2:, 1], found.structure.positions[2:, 0], atol=1e-15)
    assert turned.positions[4, 2] == found.structure.positions[4, 2] < -0.5


def test_laws_see_massless_strings() -> None:
    structure = mast().structure
    light = structure.massless
    assert light.node_names == structure.node_names[:5]
    assert [string.name for string in light.strings] == ["s0", "s1", "s2"]
    assert light.massless is light
    assert light.rest_lengths[1] == 0.95
    assert rope(3).structure.massless.node_names == ("a", "b")
    hanging = (tmj.String("s3", ("s1.2", "a"), 10.0), *structure.given.strings)
    with pytest.raises(StructureError, match=re.escape("string 's3' is tied to 's1.2', a point of a string with mass")):
        _ = replace(structure, strings=hanging).massless


def test_a_scene_whose_string_hangs_on_a_rope_is_read_as_saved(tmp_path) -> None:  # type: ignore[no-untyped-def]
    """No law sees it as a massless string; without one the scene is as valid in a file as in Python."""
    scene = mast()
    tied = replace(scene.structure, strings=(tmj.String("s3", ("s1.2", "a"), 10.0), *scene.structure.given.strings))
    made = tmj.Scene(tied, gravity=scene.gravity, initial_velocities=0 * tied.positions)
    assert tmj.load_scene(save_scene(made, tmp_path / "scene.toml")) == made


def test_supports_that_move_at_the_start_take_ropes_with_them() -> None:
    rows = ([0.05, 0.0, 0.0], [0.0, 0.2, 0.1])
    rates, none = ([1.0, 2.0, 3.0], [0.0, 0.0, 0.0]), ([0.0, 0.0, 0.0],) * 2
    scene = mast().with_(motions=(Motion.data("a", [0.0, 1.0], rows, rates, none),), rope_start="interpolated")
    points = [scene.structure.node_index[name] for name in ("s1.1", "s1.4")]
    for found, base, away in (
        (scene.nodes0, scene.structure.positions[points], rows[0]),
        (scene.velocities0, 0.0, [1, 2, 3]),
    ):
        np.testing.assert_allclose(found[points] - base, np.outer([0.125, 0.875], away), atol=1e-15)


def test_a_rope_breaks_at_its_first_part_or_where_it_is_said() -> None:
    assert mast().with_(breaks=(Break("s1", 0.2),)).breaks == (Break("s1.1", 0.2),)
    assert mast().with_(breaks=(Break("s1.3", 0.2),)).breaks == (Break("s1.3", 0.2),)
    with pytest.raises(SceneError, match="breaks twice"):
        mast().with_(breaks=(Break("s1", 0.2), Break("s1.1", 0.3)))


def test_a_tension_curve_is_shared_by_stretches() -> None:
    """Of each part φ the stretches φ s at the same tensions, so that the parts together stretch by s."""
    curve = ((0.1, 10.0), (0.3, 50.0))
    string = tmj.String("s1", ("a", "b"), None, tension=30.0, mass=0.4, segments=2, curve=curve, yields=False)
    structure = replace(rope(2).structure, strings=(string,))
    assert structure.given.strings == (string,)
    np.testing.assert_allclose(structure.rest_lengths, np.array([0.25, 0.5, 0.25]) * (2.0 - 0.2), rtol=1e-14)
    stretch = structure.string_lengths(structure.positions) - structure.rest_lengths
    np.testing.assert_allclose(structure.curves.tension(stretch), 30.0, rtol=1e-12)
    assert structure.with_strings(stiffness=200.0).given.strings[0].curve == ((0.1, 20.0), (0.3, 100.0))
    with pytest.raises(StructureError, match="string 's1': mass = 1 kg with a constant force"):
        tmj.String("s1", ("a", "b"), 0.0, tension=3.0, mass=1.0)


def test_what_does_not_fit_is_refused() -> None:
    with pytest.raises(StructureError, match=re.escape("string 's': mass = 0.1 kg on a path of 3 nodes")):
        tmj.String("s", ("a", "b", "c"), 1.0, mass=0.1)
    with pytest.raises(StructureError, match="string 's': segments = 3 without mass"):
        tmj.String("s", ("a", "b"), 1.0, segments=3)
    for segments in (0, 10_001, 2.5):
        with pytest.raises(StructureError, match="string 's': segments"):
            tmj.String("s", ("a", "b"), 1.0, mass=0.1, segments=segments)  # type: ignore[arg-type]
    line = tmj.String("s", ("a", "b"), 1.0, mass=0.1, segments=2)
    nodes = {"a": (0.0, 0.0, 0.0), "b": (1.0, 0.0, 0.0)}
    with pytest.raises(StructureError, match="string 's': unknown node 'b'"):
        tmj.Structure("x", {"a": (0, 0, 0)}, strings=(line,), fixed_nodes=("a",))
    with pytest.raises(StructureError, match="string 's' has length 0"):
        tmj.Structure("x", {"a": (0, 0, 0), "b": (0, 0, 0)}, strings=(line,), fixed_nodes=("a", "b"))
    with pytest.raises(StructureError, match=re.escape("string 's': tension = 1 N leaves it a rest length of 0 m")):
        tmj.Structure("x", nodes, strings=(replace(line, tension=1.0),), fixed_nodes=("a", "b"))
    with pytest.raises(StructureError, match=re.escape("node 's.2' is of the string with mass 's'")):
        tmj.Structure("x", {**nodes, "s.2": (0, 1, 0)}, strings=(line,), fixed_nodes=("a", "b", "s.2"))
    other = tmj.String("s.1", ("a", "b"), 1.0)
    with pytest.raises(StructureError, match=re.escape("string 's.1' is defined twice")):
        tmj.Structure("x", nodes, strings=(line, other), fixed_nodes=("a", "b"))


def test_sweeps_know_ropes_by_their_names() -> None:
    draft = Draft(mast()).apply({"structure.strings[s1].segments": 7, "structure.strings[s1].mass": Scaled(2.0)})
    assert string_of(draft.scene) == replace(string_of(mast()), mass=0.4, segments=7)
    draft = Draft(mast()).apply({"structure.strings.stiffness": 500.0, "scene.breaks[s1].time": 0.3})
    assert [string.stiffness for string in draft.scene.structure.given.strings] == [500.0] * 3
    assert draft.scene.breaks == (Break("s1.1", 0.3),)
    # Where a start is given, points of another number of segments stand between the ends.
    started = mast().with_(initial_velocities=np.eye(9)[:, :1] * [0.0, 0.0, 0.0])
    assert len(Draft(started).apply({"structure.strings[s1].segments": 2}).scene.velocities0) == 7
    # A plant of heavier strings, of which the law knows nothing.
    draft = Draft(tmj.load_scene("prism")).apply({"plant.strings.mass": 0.01, "plant.strings.segments": 2})
    assert draft.plant is not None
    run = tmj.simulate(draft.plant, draft.make_law(), tmj.MuJoCo(timestep=1e-3), duration=0.02)
    assert run.tensions.shape[1] == 36


def shaken(**how: Any) -> tmj.Scene:
    """`mast` with both ends of its rope in motion: its pinned foot, so that the tip goes along, and the fixed node."""
    motions = (Motion.in_line("mast", 0.02, 1.5, (0.0, 1.0, 0.0)), Motion.in_line("a", 0.05, 0.8, (0.0, 0.0, 1.0)))
    return mast().with_(motions=motions, **how)


def test_points_start_at_rest_or_between_the_moving_ends() -> None:
    """Ends move with A ω: round-off of a product each, and of the shares of a rope of four."""
    rest, between = shaken(), shaken(rope_start="interpolated")
    assert rest.rope_start is RopeStart.REST
    assert between.rope_start is RopeStart.INTERPOLATED
    own = [rest.structure.node_index[f"s1.{k + 1}"] for k in range(4)]
    others = [row for row in range(len(rest.structure.nodes)) if row not in own]
    tip, hook = np.array([0, 0.02 * 2 * np.pi * 1.5, 0]), np.array([0, 0, 0.05 * 2 * np.pi * 0.8])
    np.testing.assert_array_equal(rest.velocities0[own], 0)
    for scene in (rest, between):
        np.testing.assert_allclose(scene.velocities0[scene.structure.node_index["tip"]], tip, rtol=0, atol=1e-15)
        np.testing.assert_array_equal(scene.velocities0[others], rest.velocities0[others])
    shares = np.array([[1], [3], [5], [7]]) / 8
    np.testing.assert_allclose(between.velocities0[own], (1 - shares) * tip + shares * hook, rtol=0, atol=1e-15)
    # What a scene gives is the nodes' own, and points that it leaves out are between the ends.
    given = rest.with_(initial_velocities=rest.velocities0[: len(others)])
    np.testing.assert_array_equal(given.velocities0, between.velocities0)
    with pytest.raises(SceneError, match=r"rope_start = 'still'.*rest.*interpolated"):
        shaken(rope_start="still")


def test_the_start_of_ropes_is_kept_in_files_and_swept(tmp_path: Path) -> None:
    for number, start in enumerate(RopeStart):
        scene = shaken(rope_start=start)
        text = save_scene(scene, tmp_path / f"{number}.toml").read_text()
        assert ("rope_start" in text) is (start is RopeStart.INTERPOLATED)
        again = tmj.load_scene(tmp_path / f"{number}.toml")
        assert again == scene
        np.testing.assert_array_equal(again.velocities0, scene.velocities0)
        swept = Draft(shaken()).apply({"scene.rope_start": start.value}).scene
        np.testing.assert_array_equal(swept.velocities0, scene.velocities0)


def test_every_engine_starts_ropes_as_the_scene_says() -> None:
    """And they agree on what follows.

    Waves along the rope are of 2 n √(k/m) = 358 rad/s at most: RK4 errs by (358 h)⁵/120 = 5e-10 of them a step of
    h = 1e-4 s, which is 2e-10 m of the ends' 2 mm after 200 steps.
    """
    for start in RopeStart:
        scene = shaken(rope_start=start)
        runs = [
            tmj.simulate(scene, None, one, duration=0.02)
            for one in (tmj.MuJoCo(1e-4), tmj.DAE(rtol=1e-12, atol=1e-13), tmj.ODE(rtol=1e-12))
        ]
        runs += tmj.simulate_many([shaken(), scene], None, tmj.MuJoCo(1e-4), duration=0.02)[1:]
        for run in runs:
            np.testing.assert_allclose(run.velocities[0], scene.velocities0, rtol=0, atol=1e-14)
            np.testing.assert_allclose(run.nodes, runs[0].nodes, rtol=0, atol=1e-9)
