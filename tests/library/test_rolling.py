"""The six-bar robot rolls: tipping by statics against MuJoCo, the triangles that it lands on, its way."""

from __future__ import annotations

import numpy as np
import pytest

import tensegrity_mj as tmj
from tensegrity_mj.controllers import Program
from tensegrity_mj.library.rolling import rolls, six_bar_roll
from tensegrity_mj.library.six_bar import icosahedron
from tensegrity_mj.model.elements.contact import Contact, floor_gaps
from tensegrity_mj.runs.standing import standing
from tensegrity_mj.statics.standing import margins, stand, tipping

BASE = ("r1a", "r4a", "r6b")


def shortened(scene: tmj.Scene, string: str, fraction: float) -> np.ndarray:
    lengths = np.array(scene.structure.rest_lengths)
    lengths[[one.name for one in scene.structure.strings].index(string)] *= fraction
    return lengths


def test_where_the_centre_of_mass_is_above_an_edge_the_floor_carries_nothing_at_the_third_corner() -> None:
    """Two conditions, by geometry and by the balance of forces: they hold at the same fraction, found to 1e-6.

    The margin falls by .2 m a unit of the fraction, so that it is within 1e-6 · .2 m of zero, and the third corner's
    share of the weight of 11.8 N, which is the margin over the .3 m from the edge to it, within 1e-6 of it.
    """
    scene = icosahedron()
    found = tipping(scene, BASE, 2, ["r1a_r4a"])
    assert found is not None
    left = margins(found.state, BASE)
    assert abs(left[2]) < 1e-6 * 0.3
    assert left[:2].min() > 0.1
    shares = found.state.reactions[[scene.structure.node_index[name] for name in BASE], 2]
    assert abs(shares[1]) < 1e-6 * 11.8
    assert shares.sum() == pytest.approx(6 * 0.2 * 9.81, rel=1e-9)


def test_the_strings_of_the_gait_are_those_that_tip_it_with_the_least_shortening() -> None:
    """Of all strings that touch the base, on one edge; on the others it does so, too, by symmetry.

    At .35 the robot cannot stay on the open triangle, and on the closed one, where it then lands, it stands.
    """
    scene = icosahedron()
    near = [one.name for one in scene.structure.strings if set(one.nodes) & set(BASE)]
    for heading in np.radians([30.0, 150.0, 270.0]):
        (step,) = rolls(scene.structure, BASE, heading, 1)
        edge = {frozenset(pair): k for k, pair in enumerate(zip(BASE, (*BASE[1:], BASE[0]), strict=True))}[
            frozenset(step.base) & frozenset(step.through)
        ]
        found = tipping(scene, BASE, edge, near if heading < 1 else [step.string])
        assert found is not None
        assert found.string == step.string
        assert 0.45 < found.fraction < 0.55
    opened = icosahedron(base=step.through)
    held = [
        margins(stand(opened, step.through, shortened(opened, step.string, f)), step.through) for f in (1, 0.42, 0.35)
    ]
    assert min(held[0].min(), held[1].min()) > 0 > held[2].min()
    closed = icosahedron(base=step.lands)
    assert margins(stand(closed, step.lands, shortened(closed, step.string, 0.35)), step.lands).min() > 0.05


def test_statics_knows_when_mujoco_tips() -> None:
    """Slowly, and without friction, the third corner leaves the floor at the fraction that statics finds.

    The floor is hard from touch on, so that what it carries ends where the gap is zero.
    Over 20 s, the fraction falls by at most 1.5 · .58/20 s = .044 a second: by 4.4e-4 from one recorded time to the
    next, of which the lift is seen one late, and the force is zero up to one before.
    """
    floor = Contact(floor=0.0, friction=0.0, impedance=(0.95, 0.95, 1e-3, 0.5, 2.0))
    scene = icosahedron(friction=0.0).with_(contact=floor)
    found = tipping(scene, BASE, 2, ["r1a_r4a"])
    assert found is not None
    law = Program(scene.structure, moves=[[found.string, 0.5, 20.5, 0.42]])
    run = tmj.simulate(scene, law, tmj.MuJoCo(1e-3), duration=17.0, output_interval=0.01)
    corner = scene.structure.node_index["r4a"]
    assert scene.contact is not None
    gaps = np.array([floor_gaps(scene.structure, scene.contact, nodes)[corner] for nodes in run.nodes])
    lifted = int(np.argmax((gaps > 0) & (run.time > 1.0)))
    string = [one.name for one in scene.structure.strings].index(found.string)
    fraction = run.rest_lengths[lifted, string] / scene.structure.rest_lengths[string]
    assert fraction == pytest.approx(found.fraction, abs=2 * 4.4e-4)


@pytest.mark.parametrize("heading", [1.15, -2.5])
def test_it_lands_on_the_triangles_of_the_plan_and_goes_its_way(heading: float) -> None:
    """As a rigid body it would go the sum of the steps. It is shorter while its base is pulled in, by up to a third."""
    scene = six_bar_roll(steps=4, heading=heading)
    plan = rolls(scene.structure, BASE, heading, 4)
    run = tmj.simulate(scene, tmj.controllers.from_scene(scene), tmj.MuJoCo(5e-4), output_interval=0.01)
    found = standing(run)
    assert [base for _, base in found.landings()] == [plan[0].base, *(step.lands for step in plan)]
    gone = (found.path[-1] - found.path[0])[:2]
    rigid = np.sum([step.travel for step in plan], axis=0)
    assert gone @ rigid / np.linalg.norm(gone) / np.linalg.norm(rigid) > np.cos(np.radians(20))
    assert 0.67 < np.linalg.norm(gone) / np.linalg.norm(rigid) < 1


def test_a_rigid_body_comes_back_to_the_triangle_it_began_on() -> None:
    """Six steps straight ahead are one turn, and each is as long as the first."""
    steps = rolls(icosahedron().structure, BASE, 1.15, 12)
    assert steps[6].base == BASE
    assert len({step.base for step in steps}) == 6
    lengths = [np.hypot(*step.travel) for step in steps]
    np.testing.assert_allclose(lengths, lengths[0], rtol=1e-12)
    assert all(
        len(set(step.base) & set(step.through)) == len(set(step.through) & set(step.lands)) == 2 for step in steps
    )
    assert all(set(step.string.split("_")) <= set(step.base) for step in steps)
