"""Which steps a contact can stand: the predicted limits against runs of MuJoCo, and the warnings."""

from __future__ import annotations

import math
import warnings
from dataclasses import replace

import mujoco
import numpy as np
import pytest

import tensegrity_mj as tmj
from tensegrity_mj.engines.mujoco.mjcf import scene_to_mjcf
from tensegrity_mj.errors import StabilityWarning
from tensegrity_mj.model.elements.contact import Contact
from tensegrity_mj.vibration.contact_steps import (
    check_contact,
    contact_limit,
    contact_rate,
    impedance,
    resolving_step,
    small_motion,
)
from tensegrity_mj.vibration.stepping import Scheme

DEFAULT = Contact(floor=0.0, friction=0.0)
BOUNCY = replace(DEFAULT, damping=80.0)
SKEW = replace(DEFAULT, impedance=(0.1, 0.9, 1e-3, 0.3, 3.0))


def push_of(contact: Contact, depth: float) -> float:
    """g [m/s²] under which a point rests at a depth: (1 - d) g = stiffness d² / d₁² r."""
    d = float(impedance(contact, np.array(depth))[0])
    return contact.stiffness * (d / contact.spring.impedance[1]) ** 2 * depth / (1 - d)


class Resting:
    """A point mass that has come to rest on the floor, in MuJoCo alone."""

    def __init__(self, contact: Contact, depth: float, integrator: str, step: float) -> None:
        structure = tmj.Structure("point", {"m": (0, 0, 0)}, point_masses=(tmj.PointMass("m", 1.0),))
        scene = tmj.Scene(structure, gravity=(0, 0, -push_of(contact, depth)), contact=contact)
        self.model = mujoco.MjModel.from_xml_string(scene_to_mjcf(scene, step, integrator))
        self.data = mujoco.MjData(self.model)
        self.data.qpos[2] = -depth
        for _ in range(3000):
            mujoco.mj_step(self.model, self.data)
        self.place = float(self.data.qpos[2])

    def grows(self, step: float) -> bool:
        """Whether a disturbance of 1e-7 of the depth grows a hundredfold within 400 steps."""
        self.model.opt.timestep = step
        self.data.qvel[:], self.data.qpos[2] = 0.0, self.place * (1 + 1e-7)
        largest = 0.0
        for _ in range(400):
            mujoco.mj_step(self.model, self.data)
            largest = max(largest, abs(float(self.data.qpos[2]) - self.place))
        return largest > 1e-5 * abs(self.place)


@pytest.mark.parametrize("share", [0.3, 0.6, 0.8, 1.01])
@pytest.mark.parametrize("contact", [DEFAULT, BOUNCY, SKEW], ids=["default", "bouncy", "skew"])
def test_the_limit_of_a_resting_contact_is_where_its_run_begins_to_grow(contact: Contact, share: float) -> None:
    """3 % beyond it, a disturbance grows by some 1.1 a step at z = -1, 1e5 within 400; 3 % below it falls."""
    depth = share * contact.spring.impedance[2]
    for integrator, scheme in (("Euler", Scheme.SEMI_IMPLICIT), ("RK4", Scheme.RUNGE_KUTTA)):
        limit = contact_limit(contact, scheme, depth)
        resting = Resting(contact, depth, integrator, limit / 30)
        assert not resting.grows(0.97 * limit)
        assert resting.grows(1.03 * limit)


@pytest.mark.parametrize("contact", [DEFAULT, SKEW])
def test_the_small_motion_is_the_derivative_of_the_law(contact: Contact) -> None:
    """K and D against differences of a(r, v) as docs/contact.md has it, and d' against those of d."""
    d1, width = contact.spring.impedance[1], contact.spring.impedance[2]

    def acceleration(depth: float, speed: float, push: float) -> float:
        d = float(impedance(contact, np.array(depth))[0])
        return -(1 - d) * push + d * (-contact.spring.damping / d1 * speed + contact.stiffness * d / d1**2 * depth)

    for depth in np.array([0.1, 0.45, 0.7, 0.95, 1.4]) * width:
        push, e = push_of(contact, depth), 1e-6 * width
        K, D = (float(part) for part in small_motion(contact, np.array(depth)))
        assert abs(acceleration(depth, 0.0, push)) < 1e-9 * push
        slope = (acceleration(depth + e, 0.0, push) - acceleration(depth - e, 0.0, push)) / (2 * e)
        assert slope == pytest.approx(K, rel=1e-6)
        assert acceleration(depth, 0.0, push) - acceleration(depth, 1.0, push) == pytest.approx(D, rel=1e-9)
        rise = np.diff(impedance(contact, np.array([depth - e, depth + e]))[0])[0] / (2 * e)
        assert float(impedance(contact, np.array(depth))[1]) == pytest.approx(rise, rel=1e-5, abs=1e-9)


def test_closed_forms() -> None:
    # Deeper than the width d = d1: K = stiffness, D = damping. Euler: 4e4 h² + 400 h = 1. Runge-Kutta: a double
    # root at -400/s, whose R(z) is 1 at z = -2.785293563.
    assert contact_limit(DEFAULT, Scheme.SEMI_IMPLICIT, 3e-3) == pytest.approx((math.sqrt(2) - 1) / 200)
    assert contact_limit(DEFAULT, Scheme.RUNGE_KUTTA, 3e-3) == pytest.approx(2.785293563 / 400, rel=1e-7)
    assert contact_rate(DEFAULT) == pytest.approx(400.0)
    assert resolving_step(DEFAULT, Scheme.RUNGE_KUTTA) == pytest.approx(2.5e-4)
    # Friction is a damper of damping / d1, which a soft contact leaves to set the limit: 2 / D.
    sticky = Contact(floor=0.0, friction=0.5, stiffness=1.0, damping=100.0)
    assert contact_limit(sticky, Scheme.SEMI_IMPLICIT) == pytest.approx(2 * 0.95 / 100, rel=1e-3)
    # The worst of all depths is no better than any.
    assert contact_limit(DEFAULT, Scheme.SEMI_IMPLICIT) <= contact_limit(DEFAULT, Scheme.SEMI_IMPLICIT, 4e-4)


@pytest.mark.parametrize(
    ("integrator", "step", "says"),
    [
        (tmj.Integrator.RK4, 2.5e-4, ""),
        (tmj.Integrator.RK4, 5e-4, "too coarse"),
        (tmj.Integrator.EULER, 2.5e-5, ""),
        (tmj.Integrator.EULER, 5e-4, "of the first order"),
        (tmj.Integrator.DISCRETE, 1e-3, "too coarse"),
        (tmj.Integrator.DISCRETE, 2e-3, "may chatter"),
    ],
)
def test_a_run_says_before_it_starts_what_its_contact_requires_of_the_step(
    integrator: tmj.Integrator, step: float, says: str
) -> None:
    scene = tmj.load_scene("prism_drop")
    with warnings.catch_warnings(record=True) as heard:
        warnings.simplefilter("always")
        run = tmj.simulate(scene, None, tmj.MuJoCo(step, integrator), duration=4 * step)
    words = [str(one.message) for one in heard if issubclass(one.category, StabilityWarning)]
    found = run.reports["stability"]["contact"]
    assert (found["resolved"], found["exceeded"]) == (not says, says == "may chatter")
    assert [says in word for word in words] == ([True] if says else [])
    assert not says or "accuracy=" in words[0]


def test_without_contact_nothing_is_said_of_it() -> None:
    scene = tmj.load_scene("prism_drop").with_(contact=None)
    run = tmj.simulate(scene, None, tmj.MuJoCo(1e-3), duration=4e-3)
    assert "contact" not in run.reports["stability"]
    report, text = check_contact(DEFAULT, Scheme.RUNGE_KUTTA, 1e-4)
    assert text == ""
    assert report["resolved"]
