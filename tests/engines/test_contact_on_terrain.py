"""Contact with uneven ground, and friction that resists turning, in MuJoCo: against closed forms."""

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np
import pytest
from numpy.typing import NDArray

import tensegrity_mj as tmj
from tensegrity_mj.engines.mujoco.mjcf import scene_to_mjcf
from tensegrity_mj.errors import SceneError
from tensegrity_mj.library.six_bar import icosahedron
from tensegrity_mj.model import Contact, Heights, Ramp, Stairs
from tensegrity_mj.model.elements.terrain import Terrain
from tensegrity_mj.model.rods import centre_of_mass
from tensegrity_mj.runs.standing import standing

G = 9.81


@pytest.mark.parametrize(
    "terrain",
    [
        Ramp(angle=-0.3, size=(4.0, 2.0)),
        Stairs(rise=0.07, tread=0.5, size=(4.0, 6.0)),
        Heights(heights=np.add.outer([0.3, 0.0, 0.7], [0.0, 0.2, 0.1, -0.4]), spacing=0.8),
    ],
    ids=lambda one: type(one).__name__,
)
def test_the_ground_of_the_model_is_the_one_of_the_scene(terrain: Terrain) -> None:
    """MuJoCo's rays down to it, at places inside cells without twist, where it has heights in single precision."""
    scene = tmj.load_scene("six_bar_drop").with_(contact=Contact(floor=-2.0, terrain=terrain))
    model = mujoco.MjModel.from_xml_string(scene_to_mjcf(scene))
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    x, y, z = terrain.points
    places = np.random.default_rng(1).uniform([x[0], y[0]], [x[-1], y[-1]], (300, 2))
    ground, down = model.geom("terrain").id, np.array([0.0, 0.0, -1.0])
    found = [8.0 - mujoco.mj_rayHfield(model, data, ground, np.array([*place, 8.0]), down, None) for place in places]
    # Of heights, of places on slopes below 2, and of what the ray adds up from 10 m away.
    atol = 2.0**-24 * (np.ptp(z) + 2 * max(x[-1], y[-1]) + 10)
    np.testing.assert_allclose(found, terrain.height(places) - 2.0, rtol=0, atol=atol)
    assert model.geom("floor").pos[2] == pytest.approx(-2.0 + z.min() - 0.5)


def lying(
    contact: Contact, angle: float, along: bool, length: float, radius: float
) -> tuple[tmj.Scene, NDArray[np.float64]]:
    """A rod on a slope of this angle, along it or across; and the unit vector uphill."""
    uphill, up = np.array([np.cos(angle), 0, np.sin(angle)]), np.array([-np.sin(angle), 0, np.cos(angle)])
    middle = 2.0 * np.array([1.0, 0.0, np.tan(angle)]) + up * (radius + 1e-5)
    half = 0.5 * length * (uphill if along else np.array([0.0, 1.0, 0.0]))
    structure = tmj.Structure(
        "rod",
        nodes={"a": tuple(middle - half), "b": tuple(middle + half)},
        rods=(tmj.Rod("rod", ("a", "b"), 0.7, radius),),
        strings=(),
    )
    return tmj.Scene(structure, contact=contact, gravity=(0, 0, -G)), uphill


def test_a_rod_slides_down_a_ramp_as_coulomb_has_it() -> None:
    """g (sin α - μ cos α). A plane gives it to 1e-9 without friction; a ramp of cells has edges inside, of which the
    contacts' normals are: 1 % is what is left to them, against 65 % that friction takes, or a slope of other angle.
    """
    for friction in (0.0, 0.2):
        contact = Contact(floor=0.0, terrain=Ramp(angle=0.3, size=(8.0, 2.0)), friction=friction)
        scene, uphill = lying(contact, 0.3, along=True, length=0.6, radius=0.02)
        run = tmj.simulate(scene, None, tmj.MuJoCo(5e-4), duration=0.6, output_interval=0.1)
        speed = -run.velocities.mean(axis=1) @ uphill
        found = (speed[-1] - speed[2]) / (run.time[-1] - run.time[2])
        assert found == pytest.approx(G * (np.sin(0.3) - friction * np.cos(0.3)), rel=1e-2)


def test_a_rod_rolls_down_a_slope_and_friction_of_rolling_slows_it() -> None:
    """a = g (sin α - c/ρ cos α) / (1 + I/(m ρ²)), where I = m r²/2 of a cylinder, and ρ is less than its radius.

    A contact is in the middle of the overlap: ρ = r - depth/2. What sticks creeps at a speed that stays: without c the
    law is exact but for the differences of velocities, 1e-6. With it, the cone of friction is one for sliding and
    rolling, and of rolling (F/(μ N))²/2 are left out, 0.7 %; its damper takes as much: 5 % of the torque are left to
    both.
    """
    angle, length, radius = 0.3, 0.6, 0.1
    normal = (-np.sin(angle), 0.0, np.cos(angle))
    for rolling, of_it in ((0.0, 0.0), (1e-3, 0.05)):
        contact = Contact(floor=0.0, normal=normal, friction=2.0, rolling=rolling, spin="free")
        scene, uphill = lying(contact, angle, along=False, length=length, radius=radius)
        run = tmj.simulate(scene, None, tmj.MuJoCo(2e-4), duration=0.8, output_interval=0.1)
        lever = radius - 0.5 * (radius - float(run.nodes[-1].mean(axis=0) @ normal))
        inertia = 1 + radius**2 / 2 / lever**2
        slowed = G * rolling / lever * np.cos(angle) / inertia
        speed = -run.velocities.mean(axis=1) @ uphill
        found = (speed[-1] - speed[-2]) / (run.time[-1] - run.time[-2])
        assert found == pytest.approx(G * np.sin(angle) / inertia - slowed, rel=1e-6, abs=of_it * slowed)


def test_friction_of_turning_holds_a_robot_that_stands_on_a_slope() -> None:
    """Its feet turn about the rods' axes, and roll, ever faster, where nothing resists that (docs/contact.md).

    What is left is the creep of all that sticks.
    """
    angle = np.arctan(0.5 * 0.3)
    ends = []
    for torsion in (0.0, 0.3 * 2 / 3 * 0.012):
        scene = icosahedron(friction=0.3, stiffness=1e4)
        assert scene.contact is not None
        scene = scene.with_(
            contact=replace(scene.contact, torsion=torsion, spin="free"),
            gravity=(G * np.sin(angle), 0, -G * np.cos(angle)),
        )
        run = tmj.simulate(scene, None, tmj.MuJoCo(1e-3), duration=3.0, output_interval=0.5)
        ends.append(float(np.linalg.norm((run.nodes[-1] - run.nodes[1]).mean(axis=0))))
    assert ends[1] < 0.2 * ends[0]


def test_a_robot_stands_on_a_step_where_it_is_put() -> None:
    """Three feet of a six-bar robot on the tread of a stair: as high above it as above a floor, but for what it sinks.

    That is 0.9 mm on one contact a foot, and less on the several of a height field.
    """
    stairs = Stairs(rise=0.2, tread=2.0, size=(6.0, 3.0), spacing=0.1)
    scene = icosahedron()
    contact = Contact(floor=-0.2, terrain=stairs)
    moved = scene.with_(structure=scene.structure.moved(translation=(1.0, 0.0, 0.0)), contact=contact)
    runs = [tmj.simulate(one, None, tmj.MuJoCo(1e-3), duration=1.0) for one in (scene, moved)]
    heights = [centre_of_mass(run.scene.structure, run.nodes[-1:])[0, 2] for run in runs]
    assert heights[1] == pytest.approx(heights[0], abs=1e-3)
    assert standing(runs[1]).bases[-1] == standing(runs[0]).bases[-1]


def test_a_point_mass_on_uneven_ground_is_refused() -> None:
    scene = tmj.load_scene("arrester")
    with pytest.raises(
        SceneError, match=r"terrain: the point mass on node '.*' would touch it, which has no size; rods"
    ):
        scene.with_(contact=Contact(floor=-20.0, terrain=Ramp(angle=0.1)))
