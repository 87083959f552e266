"""What acts on nodes in dm_control: wind, viscous forces and elements of one's own, against runs of `simulate`."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
import pytest
from ground_spring import GroundSpring
from ground_spring import tethered as tethered_rod
from numpy.typing import NDArray

import tensegrity_mj as tmj
from tensegrity_mj import Integrator
from tensegrity_mj.errors import ElementError
from tensegrity_mj.library.fish_farm import fish_net
from tensegrity_mj.model import Element

pytest.importorskip("tensegrity_mj.learning.dm_control", exc_type=tmj.errors.MissingPackageError)
from dm_control import mjcf

from tensegrity_mj.learning.dm_control import TensegrityEntity, adopt_options, physics

Array = NDArray[np.float64]
DURATION = 0.4


@dataclass(frozen=True)
class Failing(Element):
    """One that fails some time after the start."""

    until: float

    def act(self, scene: Any, time: float, nodes: Any, velocities: Any) -> Any:
        return np.zeros((len(nodes) if time < self.until else 1, 3))


WIND = tmj.Resistance(0.4, None, tmj.model.Drag(1.2, 0.05, density=20.0), (1.0, 0.5, 0.0))
SPRINGS = (GroundSpring("a", 30.0, (0.1, -0.4, 0.3)), GroundSpring("b", 20.0, (0.9, 0.5, 0.0)))
tethered = partial(tethered_rod, gravity=(0.0, 0.0, -2.0))


def error(scene: tmj.Scene, integrator: Integrator, step: float) -> float:
    """[m] how far the nodes are from those of `simulate` with the same steps, at the end."""
    held, count = physics(scene, step, integrator), round(DURATION / step)
    for _ in range(count):
        held.step()
    run = tmj.simulate(scene, None, tmj.MuJoCo(step, integrator), duration=DURATION)
    return float(np.abs(held.nodes() - run.nodes[-1]).max())


def everything() -> tmj.Scene:
    loads = (tmj.model.Load("b", (0.5, 0.0, 1.0), 4.0),)
    return tethered(resistance=WIND, elements=SPRINGS, loads=loads)


@pytest.mark.parametrize("integrator", [Integrator.EULER, Integrator.IMPLICITFAST])
def test_one_stage_integrators_have_the_engines_forces(integrator: Integrator) -> None:
    # Both hold the forces of a step's beginning: what is left is round-off, at most 400 steps of some 100 roundings of
    # 2.2e-16 of 1 m, which the motion (rates below 15 /s over 0.4 s) carries on by less than 10 times.
    assert error(everything(), integrator, 1e-3) < 400 * 100 * 2.2e-16 * 10
    without = tmj.simulate(tethered(), None, tmj.MuJoCo(1e-3, integrator), duration=DURATION)
    run = tmj.simulate(everything(), None, tmj.MuJoCo(1e-3, integrator), duration=DURATION)
    assert tmj.compare(run, without).max_node_error > 1e-2


@pytest.mark.parametrize(("what", "order"), [("springs", 2), ("wind", 1)])
def test_with_runge_kutta_held_forces_converge_at_their_order(what: str, order: int) -> None:
    # A force held at the value of the middle of its step, predicted by x + h v / 2, differs from its mean over the step
    # by h² terms; held velocities are h / 2 old. Two halvings: 16 and 4 times less, within a quarter for further terms.
    scene = tethered(elements=SPRINGS) if what == "springs" else tethered(resistance=WIND)
    errors = [error(scene, Integrator.RK4, step) for step in (4e-3, 1e-3)]
    assert errors[1] > 1e-9
    assert errors[0] / errors[1] == pytest.approx(4.0**order, rel=0.25)


def test_attached_copies_have_their_forces_in_their_own_frame() -> None:
    scene, step = everything(), 1e-3
    c, s = np.cos(0.7), np.sin(0.7)
    turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]) @ np.array([[1, 0, 0], [0, c, -s], [0, s, c]])
    root = mjcf.RootElement(model="arena")
    adopt_options(root, scene, step, Integrator.RK4, turn)
    robot = TensegrityEntity(scene)
    root.worldbody.add("site", pos=[0.3, -0.2, 1.0], xyaxes=[*turn[:, 0], *turn[:, 1]]).attach(robot.mjcf_model)
    model = mjcf.Physics.from_mjcf_model(root)
    robot.after_compile(model)
    robot.initialize_episode(model)
    model.forward()
    alone = physics(scene, step)
    for _ in range(200):
        robot.before_substep(model)
        model.step()
        alone.step()
    # The same model in turned coordinates, and PyMJCF writes numbers with 15 digits: 200 steps of 100 roundings of 1 m.
    assert np.abs(robot.nodes(model) - alone.nodes()).max() < 200 * 100 * 1e-15 * 10


def test_an_element_that_fails_later_names_itself_and_the_time() -> None:
    held = physics(tethered(elements=(Failing(0.01),)), 2e-3)
    with pytest.raises(ElementError, match=r"element Failing failed near t = 0.011 s.* shape \(1, 3\)"):
        held.step(20)


def test_water_that_adds_no_mass_is_held_as_other_forces_are() -> None:
    """Drag depends on velocities, which are those of the step's beginning: order 1 with RK4 (`HeldForces`)."""
    scene = fish_net(rows=1, columns=2)
    end = tmj.simulate(scene, engine=tmj.DAE(rtol=1e-11, atol=1e-13), duration=DURATION).nodes[-1]
    errors = []
    for step in (1e-3, 5e-4):
        model = physics(scene, step)
        for _ in range(round(DURATION / step)):
            model.step()
        errors.append(np.abs(model.nodes() - end).max())
    assert errors[0] < 1e-3
    assert 1.9 < errors[0] / errors[1] < 2.1
