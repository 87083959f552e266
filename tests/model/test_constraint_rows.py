"""Linear constraints on nodes: their numbers, what is refused, the text, statics, and structures that are changed."""

from dataclasses import replace

import numpy as np
import pytest
from constraint_scenes import G, incline, ladder, moving_wall, trammel

from tensegrity_mj.errors import SceneError, StructureError
from tensegrity_mj.model import Constraint, Motion, Support
from tensegrity_mj.model.constraints import constraint_values
from tensegrity_mj.model.rigidity import free_motions, static_forces
from tensegrity_mj.model.text.reading import scene_from_toml
from tensegrity_mj.model.text.writing import scene_to_toml


def test_rows_are_of_unit_directions_and_values_those_of_the_nodes() -> None:
    structure = incline(0.5).structure
    rows = [[np.sin(0.5), 0, np.cos(0.5)], [0, 2, 0]]  # weight 2 of a direction of length 3
    np.testing.assert_allclose(structure.constraint_rows, rows, atol=1e-16)
    np.testing.assert_allclose(constraint_values(incline(0.5), 0.0)[0], [0.3 * np.sin(0.5) + np.cos(0.5), 0.4])


def test_a_point_of_a_rod_is_weighted_as_its_support_would_be() -> None:
    rod = trammel().structure.rods[0]
    assert dict(Constraint.along("c", rod, 0.25, (1, 0, 0)).nodes) == {"a": 0.75, "b": 0.25}
    assert dict(Constraint.along("c", rod, 1.0, (1, 0, 0)).nodes) == {"b": 1.0}
    with pytest.raises(StructureError, match=r"constraint 'c': at = 1.5; it must be within \[0, 1\]"):
        Constraint.along("c", rod, 1.5, (1, 0, 0))


@pytest.mark.parametrize("scene", [ladder(), incline(), trammel(), moving_wall()], ids=lambda scene: scene.name)
def test_the_text_holds_them_without_loss(scene) -> None:
    assert scene_from_toml(scene_to_toml(scene)) == scene


def test_the_text_says_what_is_wrong_with_them() -> None:
    text = scene_to_toml(ladder())
    with pytest.raises(StructureError, match=r"constraints\[0\] 'wall': unknown node|unknown node 'haed'"):
        scene_from_toml(text.replace("{ head = 1.0 }", "{ haed = 1.0 }"))
    with pytest.raises(StructureError, match=r"node 'head' = 0.0; it must be a finite number that is not zero"):
        scene_from_toml(text.replace("{ head = 1.0 }", "{ head = 0.0 }"))


@pytest.mark.parametrize(
    ("constraint", "message"),
    [
        (Constraint("wall", {"head": 1.0}, (0, 0, 1)), "constraint 'wall' is defined twice"),
        (Constraint("again", {"head": -3.0}, (-2, 0, 0)), "constraint 'again' repeats what those before it hold"),
        (Constraint("off", {"foot": 1.0}, (0, 0, 2), 0.1), "its nodes give 0 at the reference, but value = 0.1"),
        (Constraint("lost", {"haed": 1.0}, (0, 0, 1)), "constraint 'lost': unknown node 'haed'"),
    ],
)
def test_constraints_that_do_not_fit_are_refused(constraint, message) -> None:
    structure = ladder().structure
    with pytest.raises(StructureError, match=message):
        replace(structure, constraints=(*structure.constraints, constraint))


def test_starts_that_break_them_are_refused() -> None:
    scene = ladder()
    away = scene.nodes0 + np.array([0.1, 0, 0])
    with pytest.raises(SceneError, match=r"initial_nodes: constraint .wall. is off by 0\.1 m"):
        scene.with_(initial_nodes=away)
    with pytest.raises(SceneError, match=r"nodes would leave constraint .wall. at 0\.2 m/s"):
        scene.with_(initial_velocities=np.full((2, 3), [0.2, 0, 0]))
    with pytest.raises(SceneError, match=r"nothing of it is along \[1.0, 0.0, 0.0\]"):
        scene.with_(motions=(Motion.in_line("wall", 0.1, 1.0, (0, 0, 1)),))


def test_a_start_on_a_moving_wall_is_the_blow_that_it_gives() -> None:
    """Kinetic energy m ℓ² φ̇²/6 is least where foot and head share the wall's speed w as momentum has it.

    With the foot at height 0 and the head at x of the wall, only φ̇ is free: ẋ_foot = w + ℓ cos φ φ̇,
    ż_head = -ℓ sin φ φ̇, and T = m/6 (w² + w (w + ℓ cos φ φ̇) + (w + ℓ cos φ φ̇)² + (ℓ sin φ φ̇)²). dT/dφ̇ = 0 gives
    φ̇ = -3 w cos φ/(2 ℓ).
    """
    scene, phi, length, w = moving_wall(0.1, 0.8), 0.4, 2.0, 0.1 * 2 * np.pi * 0.8
    rate = -1.5 * w * np.cos(phi) / length
    expected = [[w + length * np.cos(phi) * rate, 0, 0], [w, 0, -length * np.sin(phi) * rate]]
    np.testing.assert_allclose(scene.velocities0, expected, atol=1e-14)


def test_free_motions_keep_them_and_statics_reports_their_forces() -> None:
    """A ladder whose foot is held by the ground: of its weight the wall takes m g tan φ/2, the ground m g."""
    scene = ladder()
    assert free_motions(scene.structure).shape == (6, 1)
    foot = Constraint("foot", {"foot": 1.0}, (1, 0, 0))
    structure = replace(scene.structure, constraints=(*scene.structure.constraints, foot))
    assert free_motions(structure).shape == (6, 0)
    found, weight = static_forces(structure, [], gravity=(0, 0, -G)), 3.0 * G
    # Forces of magnitude m g are sums of some products: round-off of 1e-13 of it is 400 units in the last place.
    wall = weight * np.tan(0.4) / 2
    np.testing.assert_allclose(found.constraint_forces, [wall, -wall], atol=1e-13 * weight)
    np.testing.assert_allclose(found.support_forces[0], [0, 0, weight], atol=1e-13 * weight)
    # The rod carries its end's half weight and the wall along it: N = -(m g/2 cos φ + m g/2 tan φ sin φ).
    axial = -(weight / 2 * np.cos(0.4) + wall * np.sin(0.4))
    np.testing.assert_allclose(found.rod_force_densities, [axial / 2.0], atol=1e-13 * weight)


def test_what_repeats_a_support_is_reported() -> None:
    scene = ladder()
    level = Constraint("level", {"foot": 1.0}, (0, 0, 1))
    twice = scene.with_(structure=replace(scene.structure, constraints=(*scene.structure.constraints, level)))
    assert twice.redundancy.undetermined == ("level",)
    assert scene.redundancy.undetermined == scene.redundancy.singular == ()
    # Upright, the wall's row cannot be told from the rod's where both ends are held along it.
    rod = replace(scene.structure.rods[0], support=Support.pinned(plane=(0, 1, 0)))
    top = Constraint("top", {"head": 1.0}, (0, 0, 1))
    upright = replace(scene.structure, nodes={"foot": (0, 0, 0), "head": (0, 0, 2)}, rods=(rod,), constraints=(top,))
    assert scene.with_(structure=upright).redundancy.singular == ("ladder", "top")


def test_they_go_with_the_structure() -> None:
    structure = ladder().structure
    turned = structure.moved((0, 0, np.pi / 2), (0.5, 0, 0))
    np.testing.assert_allclose(turned.constraints[0].direction, (0, 1, 0), atol=1e-15)
    two = structure.merged(structure.moved(translation=(0, 1, 0)), prefix="b_")
    assert [one.name for one in two.constraints] == ["wall", "b_wall"]
    assert dict(two.constraints[1].nodes) == {"b_head": 1.0}
    flipped = replace(structure, constraints=(Constraint("other", {"head": 1.0}, (-3, 0, 0)),))
    assert structure.merged(flipped, join=True).constraints == structure.constraints
