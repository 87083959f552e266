"""Uneven ground: its heights against closed forms, how far balls are above it, files, and what is refused."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import tensegrity_mj as tmj
from tensegrity_mj.errors import FormatError, OptionError, SceneError
from tensegrity_mj.model import Contact, Heights, Ramp, Rough, Stairs, save_scene
from tensegrity_mj.model.elements.terrain import Terrain
from tensegrity_mj.studies.parameters import Draft


def heights(terrain: Terrain, *places: tuple[float, float]) -> Any:
    return terrain.height(np.array(places))


def test_a_ramp_and_stairs_have_the_heights_of_their_formulas() -> None:
    """All places are on the grid or on planes between its points: exact but for round-off of numbers below 1."""
    ramp = Ramp(angle=0.2, size=(4.0, 2.0), base=0.3)
    got = heights(ramp, (-1.0, 0.5), (0.0, 0.0), (0.333, -0.7), (1.99, 0.99), (2.01, 0.0), (0.0, -1.01))
    slope = np.tan(0.2)
    np.testing.assert_allclose(got, [0, 0, 0.333 * slope, 1.99 * slope, -0.3, -0.3], rtol=0, atol=1e-14)
    down = Stairs(rise=-0.1, tread=0.5, size=(2.0, 1.0), spacing=0.05, base=0.2)
    got = heights(
        down, (-0.5, 0.1), (-0.025, 0.0), (0.0, 0.0), (0.44, 0.3), (0.475, 0.0), (0.5, 0.0), (0.99, 0.0), (1.1, 0.0)
    )
    np.testing.assert_allclose(got, [0, -0.05, -0.1, -0.1, -0.15, -0.2, -0.28, -0.5], rtol=0, atol=1e-14)


def test_own_heights_are_rows_along_x_about_the_origin() -> None:
    terrain = Heights(heights=[[0.0, 1.0, 2.0], [10.0, 11.0, 12.0]], spacing=0.5)
    got = heights(terrain, (-0.5, -0.25), (0.5, -0.25), (-0.5, 0.25), (0.25, 0.0), (0.6, 0.0))
    np.testing.assert_allclose(got, [0.0, 2.0, 10.0, 6.5, -0.5], rtol=0, atol=1e-14)


def test_a_rough_surface_has_its_deviation_and_its_correlation() -> None:
    """Of 400 surfaces at 9 places a correlation length or more apart, seen as independent: 3600 samples.

    Their mean square is off by √(2/3600) = 2.4 % at one standard deviation, a correlation by less than 1.7 %.
    """
    places = [(x, y) for x in (-3.0, 0.0, 3.0) for y in (-3.0, 0.0, 3.0)]
    near = [(x + 0.5, y) for x, y in places]
    some = [Rough(roughness=0.04, length=1.0, seed=seed, size=(8.0, 7.0), spacing=0.5) for seed in range(400)]
    first, second = (np.array([heights(one, *of) for one in some]) for of in (places, near))
    assert np.mean(first**2) == pytest.approx(0.04**2, rel=0.1)
    assert np.mean(first * second) == pytest.approx(0.04**2 * np.exp(-0.25), rel=0.1)
    assert np.mean(first[:, 0] * first[:, 8]) == pytest.approx(0.0, abs=4 * 0.04**2 / 20)


def test_a_rough_surface_is_the_same_at_every_size_and_spacing_and_level_where_asked() -> None:
    coarse = Rough(roughness=0.04, length=0.5, seed=3, size=(2.0, 2.0), spacing=0.1, level=0.3)
    fine = Rough(roughness=0.04, length=0.5, seed=3, size=(4.0, 3.0), spacing=0.05, level=0.3)
    x, y, z = coarse.points
    np.testing.assert_allclose(fine.height(np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1)), z, rtol=0, atol=1e-13)
    away = np.hypot(*np.meshgrid(x, y, indexing="ij"))
    assert np.all(z[away < 0.3] == 0.0)
    open_one = Rough(roughness=0.04, length=0.5, seed=3, size=(2.0, 2.0), spacing=0.1)
    np.testing.assert_array_equal(z[away >= 0.6], open_one.points[2][away >= 0.6])
    assert np.any(
        open_one.points[2] != Rough(roughness=0.04, length=0.5, seed=4, size=(2.0, 2.0), spacing=0.1).points[2]
    )


def test_how_far_a_ball_is_above_a_slope() -> None:
    """z - r / cos α. Between rings of places 0.35 r apart the underside of a ball is off by r/2 · 0.175² / cos³ α."""
    ramp = Ramp(angle=0.4)
    centres = np.array([[1.0, 0.2, 1.0], [2.0, 0.0, 1.0]])
    radii = np.array([0.1, 0.05])
    exact = centres[:, 2] - np.tan(0.4) * centres[:, 0] - radii / np.cos(0.4)
    error = ramp.clearance(centres, radii) - exact
    assert np.all(error >= -1e-14)
    assert np.all(error <= radii * 0.5 * 0.175**2 / np.cos(0.4) ** 3)


def test_a_rod_between_whose_nodes_is_a_ridge_is_refused() -> None:
    ridge = Heights(heights=np.where(np.abs(np.arange(-20, 21)) == 0, 0.2, 0.0) * np.ones((41, 1)), spacing=0.1)
    rod = tmj.Rod("rod", ("a", "b"), 0.7, 0.02)
    structure = tmj.Structure("rod", nodes={"a": (-0.5, 0, 0.1), "b": (0.5, 0, 0.1)}, rods=(rod,), strings=())
    with pytest.raises(
        SceneError, match=r"at the start rod 'rod' is 0\.1\d* m inside the floor between its nodes: start"
    ):
        tmj.Scene(structure, contact=Contact(floor=0.0, terrain=ridge))
    tmj.Scene(structure, contact=Contact(floor=-0.15, terrain=ridge))


@pytest.mark.parametrize("reach", [10.0, 1e5, 1e12])
def test_a_rod_far_longer_than_the_ground_is_checked_where_the_ground_is(reach: float) -> None:
    ridge = Heights(heights=np.where(np.abs(np.arange(-20, 21)) == 0, 0.2, 0.0) * np.ones((41, 1)), spacing=0.1)
    rod = tmj.Rod("rod", ("a", "b"), 0.7, 1e-3)
    for y, inside in ((0.0, True), (3.0, False)):  # across it, and past its edge at y = 2 m
        nodes = {"a": (-reach, y, 0.1), "b": (2 * reach, y, 0.1)}
        structure = tmj.Structure("rod", nodes=nodes, rods=(rod,), strings=())
        if inside:
            with pytest.raises(SceneError, match=r"rod 'rod' is 0\.\d* m inside the floor between its nodes"):
                tmj.Scene(structure, contact=Contact(floor=0.0, terrain=ridge))
        else:
            tmj.Scene(structure, contact=Contact(floor=0.0, terrain=ridge))


@pytest.mark.parametrize(
    "terrain",
    [
        Ramp(angle=0.1, size=(5.0, 4.0)),
        Stairs(rise=0.05, tread=0.4, spacing=0.1),
        Rough(roughness=0.02, length=0.4, seed=7, level=0.5, base=1.0),
        Heights(heights=[[0.0, 0.1], [0.2, -0.3]], spacing=2.0),
    ],
    ids=lambda one: type(one).__name__,
)
def test_a_file_holds_it(terrain: Terrain, tmp_path: Path) -> None:
    scene = tmj.load_scene("six_bar_drop").with_(
        contact=Contact(floor=-1.0, terrain=terrain, torsion=0.01, rolling=0.001)
    )
    path = tmp_path / "scene.toml"
    save_scene(scene, path)
    assert tmj.load_scene(path) == scene


def test_a_file_with_an_unknown_kind(tmp_path: Path) -> None:
    path = tmp_path / "scene.toml"
    save_scene(tmj.load_scene("six_bar_drop").with_(contact=Contact(floor=-1.0, terrain=Ramp(angle=0.1))), path)
    path.write_text(path.read_text().replace('"ramp"', '"rampe"'))
    with pytest.raises(FormatError, match=r"rampe.*ramp"):
        tmj.load_scene(path)


def test_a_sweep_sets_a_part_of_it() -> None:
    scene = tmj.load_scene("six_bar_drop")
    rough = scene.with_(contact=Contact(floor=-1.0, terrain=Rough(roughness=0.02, length=0.4)))
    changed = Draft(rough).apply({"scene.contact.terrain.roughness": 0.01}).scene
    assert changed.contact is not None
    assert changed.contact.terrain == Rough(roughness=0.01, length=0.4)
    with pytest.raises(OptionError, match="contact has no terrain"):
        Draft(scene).apply({"scene.contact.terrain.roughness": 0.01})


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Ramp(angle=1.6), r"ramp: angle = 1\.6; it must be within \[-1\.5, 1\.5\]"),
        (lambda: Ramp(angle=0.1, size=(1e9, 1e9)), r"ramp: size = .* has more than 250,000 points: make it smaller"),
        (
            lambda: Ramp(angle=0.1, size=(0.05, 1.0)),
            r"ramp: size = \[0\.05, 1\.0\] m: its shorter side = 0\.05 m; it must be at least two spacings, 0\.1 m",
        ),
        (lambda: Stairs(rise=0.1, tread=0.05), r"stairs: tread = 0\.05 m; it must be at least two spacings, 0\.1 m"),
        (lambda: Rough(roughness=0.1, length=0.05), r"rough: length = 0\.05 m; it must be at least two spacings"),
        (lambda: Rough(roughness=-0.1, length=0.5), r"rough: roughness = -0\.1; it must be >= 0"),
        (lambda: Heights(heights=[[0.0, 1.0]], spacing=1.0), r"heights: 1 rows of 2 numbers; give two rows or more"),
        (lambda: Heights(heights=[[0.0, np.nan]] * 2, spacing=1.0), r"heights\[0\].*finite numbers"),
        (lambda: Contact(floor=0.0, normal=(0, 1, 1), terrain=Ramp(angle=0.1)), r"terrain: with .* no other normal"),
        (lambda: Contact(rods=True, terrain=Ramp(angle=0.1)), r"terrain: with floor = None"),
        (lambda: Contact(floor=0.0, terrain=0.1), r"contact: terrain = 0\.1; use Ramp, Stairs, Rough or Heights"),
        (lambda: Contact(floor=0.0, friction=0.0, rolling=0.1), r"rolling = 0\.1 m, but friction = 0"),
    ],
)
def test_what_is_refused(make: Any, message: str) -> None:
    with pytest.raises(SceneError, match=message):
        make()
