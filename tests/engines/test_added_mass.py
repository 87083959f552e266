"""Rods in water that share nodes, close loops, hang on moved supports: the engines agree, and ledgers close.

Each engine finds the accelerations of rods with added mass by equations of its own: the DAE rod by rod with forces of
joints, or with one matrix (3.17); the ODE in minimal coordinates; MuJoCo from its own degrees of freedom.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import tensegrity_mj as tmj
from tensegrity_mj.engines import Solver
from tensegrity_mj.library.fish_farm import fish_net

FINE = {"rtol": 1e-11, "atol": 1e-13}
JOINTS, FULL = tmj.DAE(**FINE), tmj.DAE(solver=Solver.FULL, **FINE)
ODE, MUJOCO = tmj.ODE(**FINE), tmj.MuJoCo(5e-4)
WATER = tmj.Water(waves=(tmj.model.Wave(0.1, 3.0), tmj.model.Wave(0.05, 1.0, direction=1.0)), current=(0.2, 0.0, 0.0))
DOWN = (0.0, 0.0, -9.81)
MOTION = (tmj.model.Motion("r0", (tmj.model.Harmonic((0.1, 0.05, 0.08), 6.0, 0.0),)),)


def chain(weights: Any = tmj.model.Weights.RIGID, **scene: Any) -> tmj.Scene:
    """Three rods that hang from a pin above the waves, partly in them, and a string to a fixed node."""
    nodes = {
        "p": (0.0, 0.0, 0.3),
        "a": (0.6, 0.1, -0.2),
        "b": (1.2, -0.1, -0.3),
        "c": (1.5, 0.3, -0.9),
        "f": (2.0, 0, 0),
    }
    rods = (
        tmj.Rod("r0", ("p", "a"), 8.0, radius=0.05, support=tmj.Support.pinned(0.0)),
        tmj.Rod("r1", ("a", "b"), 6.0, radius=0.05),
        tmj.Rod("r2", ("c", "b"), 9.0, radius=0.06),
    )
    string = tmj.String("s", ("c", "f"), 200.0, 1.0, 0.8)
    structure = tmj.Structure("wet chain", nodes, rods, (string,), ("f",))
    water = tmj.Water(waves=WATER.waves, current=WATER.current, weights=weights)
    return tmj.Scene(structure, gravity=DOWN, water=water, **scene)


def loop(**scene: Any) -> tmj.Scene:
    """A triangle of rods that hangs from a pin."""
    nodes = {"p": (0.0, 0.0, 0.2), "a": (0.6, 0.1, -0.4), "b": (-0.5, 0.3, -0.6)}
    rods = (
        tmj.Rod("r0", ("p", "a"), 8.0, radius=0.05, support=tmj.Support.pinned(0.0)),
        tmj.Rod("r1", ("a", "b"), 6.0, radius=0.05),
        tmj.Rod("r2", ("b", "p"), 9.0, radius=0.06),
    )
    return tmj.Scene(tmj.Structure("wet loop", nodes, rods), gravity=DOWN, water=WATER, **scene)


def single(**scene: Any) -> tmj.Scene:
    """One rod on a pin, away from the pole of the ODE's angles."""
    nodes = {"a": (0.0, 0.0, 0.3), "b": (0.8, 0.3, -0.5)}
    rod = tmj.Rod("r0", ("a", "b"), 8.0, radius=0.05, support=tmj.Support.pinned(0.0))
    return tmj.Scene(tmj.Structure("wet rod", nodes, (rod,)), gravity=DOWN, water=WATER, **scene)


SCENES = {
    "chain": (chain(), (JOINTS, FULL, MUJOCO)),
    "moved chain": (chain(motions=MOTION), (JOINTS, FULL, MUJOCO)),
    "chain by the thesis' weights": (chain(tmj.model.Weights.HERMITE), (FULL, MUJOCO)),
    "loop": (loop(), (JOINTS, FULL)),
    "moved loop": (loop(motions=MOTION), (JOINTS, FULL)),
    "rod": (single(), (JOINTS, FULL, ODE, MUJOCO)),
    "moved rod": (single(motions=MOTION), (JOINTS, FULL, ODE, MUJOCO)),
}


@pytest.mark.parametrize("name", SCENES)
def test_engines_agree_about_rods_with_added_mass(name: str) -> None:
    scene, engines = SCENES[name]
    reference, *others = [tmj.simulate(scene, engine=engine, duration=0.5) for engine in engines]
    dry = tmj.simulate(scene.with_(water=None), engine=engines[0], duration=0.5)
    assert tmj.compare(reference, dry).max_node_error > 1e-2
    heaviest = max(float(np.abs(run.external_work).max()) for run in (reference, *others))
    for run in (reference, *others):
        # The surface of waves crosses segments: kinks in the second derivative of forces, which an error-controlled
        # method meets to its tolerance; RK4 of rates r < 40 /s at 0.5 ms to (r h)^3 of a part of 1e-2 of the motion.
        assert run.energy_residual < 1e-6 * max(heaviest, 1.0)
        assert tmj.compare(reference, run).max_node_error < 1e-7
        scale = np.abs(reference.multipliers).max()
        assert np.abs(run.multipliers - reference.multipliers).max() < 1e-5 * scale


@pytest.mark.parametrize("name", SCENES)
def test_accelerations_at_one_state_agree_to_round_off(name: str) -> None:
    scene, engines = SCENES[name]
    found = [accelerations(scene, engine) for engine in engines]
    for one in found:
        # Equations of at most 30 unknowns, of numbers within 1e3 of one another; of supports driven by 1e12 kg less.
        assert np.abs(one - found[0]).max() < 1e-9 * np.abs(found[0]).max()


def accelerations(scene: tmj.Scene, engine: Any) -> Any:
    from tensegrity_mj.dynamics.native.law import native_law
    from tensegrity_mj.engines.request import Request

    law = native_law(None, scene.structure)
    requested = Request(scene, law, tmj.Actuation.continuous(), tmj.OnInfeasible.STOP, 1.0, None, progress=False)
    return engine.accelerations(requested)(0.0, scene.nodes0, scene.velocities0)[1]


def test_what_cannot_be_says_why() -> None:
    with pytest.raises(
        tmj.errors.StructureError, match=r"water adds mass .* close a loop .* loops are known; use DAE, or"
    ):
        tmj.simulate(loop(), engine=MUJOCO)
    with pytest.raises(tmj.errors.OptionError, match=r"JOINTS: the mass that water adds is not symmetric.*\.FULL"):
        tmj.simulate(chain(tmj.model.Weights.HERMITE), engine=JOINTS)


def unladen(scene: tmj.Scene) -> tmj.Scene:
    """The same in water whose added_mass is 0."""
    assert scene.water is not None
    return scene.with_(water=replace(scene.water, added_mass=0.0))


FREE_OF_MASS = {
    "closed loop": (unladen(loop()), MUJOCO),
    "Hermite's weights": (unladen(chain(tmj.model.Weights.HERMITE)), JOINTS),
}


@pytest.mark.parametrize("name", FREE_OF_MASS)
def test_what_added_mass_alone_excludes_runs_without_it(name: str) -> None:
    scene, engine = FREE_OF_MASS[name]
    assert not scene.adding_mass
    reference, run = (tmj.simulate(scene, engine=one, duration=0.5) for one in (FULL, engine))
    # MuJoCo's gaps of joints are closed by order 2: 1.1e-9 m at 0.5 ms; the tolerances leave 3e-10 m.
    assert tmj.compare(reference, run).max_node_error < 1e-8


@pytest.mark.parametrize("integrator", [one for one in tmj.Integrator if one is not tmj.Integrator.RK4])
@pytest.mark.parametrize("scene", [unladen(chain()), fish_net(rows=1, columns=2)], ids=["rods", "strings"])
def test_without_added_mass_every_integrator_of_order_1_has_that_order(scene: tmj.Scene, integrator: Any) -> None:
    """The error falls by 2 with the step, but for what its second order adds: a hundredth of it at these steps."""
    reference = tmj.simulate(scene, engine=FULL, duration=0.2, output_interval=0.02)
    errors = []
    for step in (5e-4, 2.5e-4):
        run = tmj.simulate(scene, engine=tmj.MuJoCo(step, integrator), duration=0.2, output_interval=0.02)
        errors.append(tmj.compare(reference, run).max_node_error)
    assert 1.9 < errors[0] / errors[1] < 2.1


def test_a_rod_lands_under_water_as_in_a_fluid_that_drags_under_less_gravity() -> None:
    """A level rod in still water: buoyancy takes ρ π d²/4 ℓ/m of its weight, and drag is the same on each segment."""
    rod = tmj.Rod("r", ("a", "b"), 80.0, radius=0.05)
    structure = tmj.Structure("sinks", {"a": (0.0, 0.0, -1.9), "b": (1.0, 0.0, -1.9)}, (rod,))
    rest = {"contact": tmj.model.Contact(floor=-2.0), "duration": 0.5}
    water = tmj.Water(drag=1.1, added_mass=0.0)
    less = 9.81 * (1 - water.density * np.pi * 0.05**2 / 80.0)
    drag = tmj.model.Drag(normal=1.1, density=water.density)
    wet = tmj.Scene(structure, gravity=DOWN, water=water, **rest)
    dragged = tmj.Scene(structure, gravity=(0.0, 0.0, -less), resistance=tmj.Resistance(drag=drag), **rest)
    runs = [tmj.simulate(scene, engine=tmj.MuJoCo(2.5e-4)) for scene in (wet, dragged)]
    assert runs[0].nodes[-1, :, 2].max() < -1.945  # landed
    assert np.abs(runs[0].nodes - runs[1].nodes).max() < 1e-11  # 2000 steps of a few roundings of 2 m


@pytest.mark.parametrize("engine", [JOINTS, FULL, tmj.DAE(solver=Solver.GENERAL, **FINE)], ids=str)
def test_an_elastic_rod_is_elastic_in_water_too(engine: Any) -> None:
    """Without added mass, which elastic rods do not have; h of RK4 is 1/30 of the rod's own 1/ω."""
    rod = tmj.Rod("r", ("a", "b"), 80.0, radius=0.05, stiffness=1e4, damping=10.0)
    string = tmj.String("s", ("b", "f"), 1000.0, rest_length=1.5)
    nodes = {"a": (0.0, 0.0, -1.5), "b": (1.0, 0.0, 0.1), "f": (3.0, 0.0, 0.0)}
    structure = tmj.Structure("soft", nodes, (rod,), (string,), ("f",))
    scene = unladen(tmj.Scene(structure, gravity=DOWN, water=WATER))
    reference, run = (tmj.simulate(scene, engine=one, duration=0.3) for one in (MUJOCO, engine))
    stretch = np.linalg.norm(run.nodes[:, 1] - run.nodes[:, 0], axis=1)
    assert np.ptp(stretch) > 1e-3
    assert tmj.compare(reference, run).max_node_error < 1e-8
    with pytest.raises(tmj.errors.SceneError, match="water adds mass to rods: added mass is that of rods of"):
        tmj.simulate(scene.with_(water=WATER), engine=engine)
