"""Laws that account for loads, wind and elements: the accelerations that they foresee are the engine's."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest
from compiled_spring import CompiledSpring
from engine_accelerations import mujoco_accelerations_at
from ground_spring import GroundSpring

import tensegrity_mj as tmj
from evidence.random_structures import random_scene, random_structure
from tensegrity_mj.controllers import FeedbackLinearization, Lyapunov, Projection
from tensegrity_mj.errors import ControllerError, OptionError
from tensegrity_mj.model import Element

GRAVITY = (0.0, 0.0, -9.81)


@dataclass(frozen=True)
class Failing(Element):
    """One that fails some time after the start."""

    def act(self, scene: Any, time: float, nodes: Any, velocities: Any) -> Any:
        if time > 0.01:
            raise RuntimeError("the sensor is lost")
        return np.zeros_like(nodes)


def pushed(seed: int) -> tmj.Scene:
    """Rods and a point mass that loads, wind and springs push, one of them compiled."""
    rng = np.random.default_rng(seed)
    structure = random_structure(rng, rods=3, strings=9, point_masses=1)
    names = structure.node_names
    point = structure.point_masses[0].node
    elements = (GroundSpring(names[0], 20.0, (0.1, 0.2, 0.3)), CompiledSpring(point, 30.0, (0.0, 0.4, 0.0)))
    loads = (tmj.model.Load(names[1], (1.0, -2.0, 3.0), 4.0, 0.5), tmj.model.Load(point, (2.0, 0.0, 1.0)))
    wind = tmj.Resistance(0.3, None, tmj.model.Drag(1.2, 0.05, density=20.0), (1.0, 0.5, 0.0))
    made = random_scene(rng, structure, displaced=0.2, moving=0.7)
    return made.with_(gravity=GRAVITY, loads=loads, resistance=wind, elements=elements)


def known(scene: tmj.Scene) -> tuple[Any, ...]:
    return (*scene.loads, scene.resistance, *scene.elements)


@pytest.mark.third_means(
    "elements.known_forces",
    by="V̇ and ë of the law's own equation, by differences of V and ė along accelerations of MuJoCo",
)
@pytest.mark.parametrize("seed", range(4))
def test_the_engine_accelerates_as_the_laws_foresee(seed: int) -> None:
    # Both solve the same equations for the same forces, to round-off. Differences over 2e-5 s: V and ė are smooth, with
    # third derivatives of some 1e4 /s³ of their size at most, so that they err by h²/6 of that, 2e-7, and by 1e-11 / h
    # of round-off, 1e-6; the bound is ten times that.
    scene = pushed(seed)
    nodes, velocities, step = scene.nodes0, scene.velocities0, 1e-5
    u = np.random.default_rng(seed).uniform(0.1, 0.9, len(scene.structure.strings)) * scene.structure.stiffness
    found = mujoco_accelerations_at(scene, nodes, velocities, u)
    moved = [(nodes + h * velocities + h**2 / 2 * found, velocities + h * found) for h in (-step, step)]
    aim = scene.structure.positions
    for law in (
        Lyapunov(scene.structure, aim, gravity=GRAVITY, known=known(scene)),
        Projection(scene.structure, aim, gravity=GRAVITY, known=known(scene), stiffness=0.3),
    ):
        terms = law.terms(0.0, nodes, velocities)
        V = [sum(law.terms(0.0, *there)[:2]) for there in moved]
        foreseen = terms.beta - terms.f @ u
        size = max(1.0, abs(terms.beta), np.abs(terms.f) @ u)
        assert abs((V[1] - V[0]) / (2 * step) - foreseen) < 1e-5 * size
        blind = replace(law, known=()).terms(0.0, nodes, velocities)
        assert abs(blind.beta - blind.f @ u - foreseen) > 1e-3 * size  # it matters
    law = FeedbackLinearization(scene.structure, aim, gravity=GRAVITY, known=known(scene))
    A, d, e = law.equation(0.0, nodes, velocities)
    rates = [law.error(0.0, *there)[1] for there in moved]
    foreseen = A @ u - d - e[0] - 2 * e[1]
    size = np.abs(A) @ u + np.abs(d)
    assert np.all(np.abs((rates[1] - rates[0]) / (2 * step) - foreseen) < 1e-5 * np.maximum(1.0, size))


def test_v_decays_as_promised_under_wind_and_loads() -> None:
    """V follows V(0) e^{-δt} but for the integrator's error: rtol 1e-10 in each step; its steps add."""
    scene = tmj.load_scene("prism")
    wind = tmj.Resistance(0.3, None, None, (2.0, 1.0, 0.0))
    node = scene.structure.node_names[-1]
    scene = scene.with_(resistance=wind, loads=(tmj.model.Load(node, (0.0, 0.3, 0.0), 5.0),))
    law = replace(tmj.controllers.from_scene(scene), known=(*scene.loads, wind))
    engine = tmj.DAE(rtol=1e-10, atol=1e-11)
    run = tmj.simulate(scene, law, engine, duration=0.5)
    np.testing.assert_allclose(run.lyapunov, run.lyapunov[0] * np.exp(-law.decay_rate * run.time), rtol=1e-7)
    assert not any("the law assumes" in text for text in run.reports["warnings"])
    blind = tmj.simulate(scene, tmj.controllers.from_scene(scene), engine, duration=0.5)
    assert np.abs(blind.lyapunov / run.lyapunov - 1).max() > 1e-3
    calm = tmj.simulate(scene.with_(resistance=None), law, engine, duration=0.02)
    assert any("the law assumes Resistance" in text for text in calm.reports["warnings"])


@pytest.mark.parametrize("kind", [Lyapunov, FeedbackLinearization])
def test_an_element_that_fails_ends_the_run_with_its_reason(kind: Any) -> None:
    scene = tmj.load_scene("prism")
    law = kind(scene.structure, scene.target, gravity=scene.gravity, known=(Failing(),))
    with pytest.raises(ControllerError, match="the sensor is lost"):
        tmj.simulate(scene, law, tmj.MuJoCo(1e-3), duration=0.1)
    with pytest.raises(RuntimeError, match="the sensor is lost"):
        law(1.0, scene.nodes0, scene.velocities0)


def test_what_no_law_can_know_of_is_refused() -> None:
    scene = tmj.load_scene("prism")
    for bad, said in ((1.0, "known = 1.0; it must hold"), ((scene.resistance,), r"known = \(None,\)")):
        with pytest.raises(OptionError, match=said):
            Lyapunov(scene.structure, scene.target, known=bad)
