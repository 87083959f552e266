"""Sweeps over what moves supports and what resists motion."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import tensegrity_mj as tmj
from tensegrity_mj.errors import OptionError
from tensegrity_mj.model.elements.resistance import Bending, Drag, Resistance
from tensegrity_mj.model.motion import Harmonic, Motion
from tensegrity_mj.studies.parameter_values import Scaled, Vary, encoded
from tensegrity_mj.studies.parameters import Draft
from tensegrity_mj.studies.scene_parameters import member_names
from tensegrity_mj.studies.sweep import Sweep
from tensegrity_mj.studies.workers import Backend, Workers

HERE = Workers(backend=Backend.THIS_PROCESS)
TURN = 2 * math.pi


@functools.cache
def moved() -> tmj.Scene:
    """A pinned rod whose support goes in a circle, and fixed nodes that move in a line, by data, and by both."""
    line = Harmonic((0.0, 0.3, 0.4), TURN)
    times, rows = (0.0, 1.0, 3.0), ((0.0, 0.0, 0.0), (0.1, 0.2, 0.0), (0.3, 0.0, 0.0))
    rates, bends = (
        ((0.0, 0.0, 0.0), (0.1, 0.0, 0.2), (0.0, 0.0, 0.0)),
        ((0.3, 0.0, 0.0), (0.0, 0.5, 0.0), (0.0, 0.0, 0.7)),
    )
    motions = (
        Motion.circular("rod", 0.05, 2.0),
        Motion("n2", (line,)),
        Motion.data("n3", times, rows),
        Motion("n4", (line, Harmonic((0.1, 0.0, 0.0), 3.0)), times, rows, rates, bends),
    )
    return tmj.load_scene("pinned_rod").with_(motions=motions, control=None, target=None, initial_nodes=None)


def changed(scene: tmj.Scene, **settings: Any) -> tmj.Scene:
    return Draft(scene).apply({path: encoded(value) for path, value in settings.items()}).scene


def at(scene: tmj.Scene, support: str, time: float) -> Any:
    return next(motion for motion in scene.motions if motion.support == support).at(time)


def test_a_factor_of_the_amplitude_is_one_of_all_that_moves() -> None:
    scene = changed(moved(), **{"scene.motions.amplitude": Scaled(-0.5)})
    for motion in moved().motions:
        for time in (0.0, 0.37, 1.8, 5.0):
            np.testing.assert_allclose(at(scene, motion.support, time), -0.5 * motion.at(time), rtol=1e-13, atol=1e-15)


@pytest.mark.parametrize("name", ["frequency", "angular_frequency"])
def test_a_factor_of_the_frequency_is_one_of_the_pace(name: str) -> None:
    scene = changed(moved(), **{f"scene.motions.{name}": Scaled(2.0)})
    pace = np.array([[1.0], [2.0], [4.0]])
    for motion in moved().motions:
        for time in (0.0, 0.37, 1.8, 5.0):
            expected = pace * motion.at(2 * time)
            np.testing.assert_allclose(at(scene, motion.support, time), expected, rtol=1e-12, atol=1e-13)


def test_numbers_are_of_all_harmonics_of_a_motion() -> None:
    settings = {"scene.motions[rod].amplitude": 0.2, "scene.motions[rod].frequency": 0.5}
    circle = Motion.circular("rod", 0.2, 0.5)
    # The scene starts at its reference nodes with the velocity of its support.
    scene = changed(moved(), **settings)
    for time in (0.0, 0.3, 4.0):
        np.testing.assert_allclose(at(scene, "rod", time), circle.at(time), rtol=1e-13, atol=1e-15)
    np.testing.assert_allclose(scene.velocities0[0], circle.at(0.0)[1], rtol=1e-13, atol=1e-15)
    # n2 has 0.5 m along (0, 0.6, 0.8).
    cases: list[tuple[str, Any, Harmonic]] = [
        ("amplitude", 1.0, Harmonic((0.0, 0.6, 0.8), TURN)),
        ("amplitude", [1, 2, 3], Harmonic((1.0, 2.0, 3.0), TURN)),
        ("amplitude.x", 0.7, Harmonic((0.7, 0.3, 0.4), TURN)),
        ("amplitude.y", Scaled(2), Harmonic((0.0, 0.6, 0.4), TURN)),
        ("frequency", 3, Harmonic((0.0, 0.3, 0.4), 3 * TURN)),
        ("angular_frequency", 3, Harmonic((0.0, 0.3, 0.4), 3.0)),
        ("phase", 0.1, Harmonic((0.0, 0.3, 0.4), TURN, 0.1)),
    ]
    for name, value, expected in cases:
        got = changed(moved(), **{f"scene.motions[n2].{name}": value}).motions[1].harmonics[0]
        np.testing.assert_allclose(got.amplitude, expected.amplitude, rtol=1e-15)
        assert (got.angular_frequency, got.phase) == (expected.angular_frequency, expected.phase)


NOTHING: list[tuple[str, Any, Callable[[Any], Any], Any]] = [
    ("viscous", 0.1, lambda r: r, Resistance(viscous=0.1)),
    ("viscous", 0, lambda r: r, None),
    ("bending.stiffness", 0.1, lambda r: r.bending, Bending(0.1, 0.0)),
    ("bending.damping", 0.1, lambda r: r.bending, Bending(0.0, 0.1)),
    ("drag.normal", 2, lambda r: r.drag, Drag(normal=2.0)),
    ("drag.diameter", 0.02, lambda r: r.drag, Drag(diameter=0.02)),
    ("drag.density", Scaled(2), lambda r: r.drag, Drag(density=2.45)),
]


@pytest.mark.parametrize(("path", "value", "read", "expected"), NOTHING)
def test_resistance_starts_from_none(path: str, value: Any, read: Any, expected: Any) -> None:
    scene = tmj.load_scene("cable").with_(resistance=None)
    assert read(changed(scene, **{f"scene.resistance.{path}": value}).resistance) == expected


def test_resistance_is_changed_in_an_order_that_keeps_it_valid() -> None:
    scene = tmj.load_scene("cable").with_(resistance=Resistance(viscous=0.2, wind=(1.0, 2.0, 0.0)))
    settings = {"scene.resistance.wind.z": 5.0, "scene.resistance.wind": [3.0, 0.0, 4.0]}
    settings |= {"scene.resistance.viscous": 0.0, "scene.resistance.drag.normal": 1.0}
    for order in (settings, dict(reversed(settings.items()))):
        assert changed(scene, **order).resistance == Resistance(drag=Drag(1.0), wind=(3.0, 0.0, 5.0))
    # Without drag nothing feels the wind any more.
    assert changed(scene, **{"scene.resistance.viscous": 0.0}).resistance is None
    assert changed(scene, **{"scene.resistance.wind.x": Scaled(3)}).resistance == Resistance(0.2, wind=(3.0, 2.0, 0.0))
    # What is simulated, not what is known.
    draft = Draft(scene).apply({"plant.resistance.viscous": "*2", "plant.resistance.drag.tangential": 0.5})
    assert draft.scene == scene
    assert draft.plant is not None
    assert draft.plant.resistance == Resistance(0.4, drag=Drag(tangential=0.5), wind=(1.0, 2.0, 0.0))


@pytest.mark.parametrize(
    ("path", "value", "said"),
    [
        ("scene.motions[n9].frequency", 1, "no support with a motion 'n9'.*allowed: rod, n2, n3, n4"),
        ("scene.motions.frequenzy", 1, r"did you mean 'frequency'.*allowed: amplitude, frequency, angular_frequency"),
        ("scene.motions", 1, "no part of a motion ''"),
        ("scene.motions.frequency.x", 1, "it has no parts 'x'"),
        ("scene.motions[n2].amplitude.w", 1, "no component 'w'"),
        ("scene.motions[n2].amplitude", "big", "a list of three numbers"),
        ("scene.motions[n2].amplitude", math.inf, "it must be a finite number"),
        ("scene.motions[n2].amplitude", [1, 2], "a list of three numbers"),
        ("scene.motions[rod].phase", 0.1, "of different phases"),
        ("scene.motions[rod].amplitude", [0.1, 0, 0], "of different amplitudes"),
        ("scene.motions[rod].amplitude.x", 0.1, "of different components of amplitudes"),
        ("scene.motions[n3].amplitude", 0.1, "has data; scale"),
        ("scene.motions[n3].frequency", 2, "has data; scale"),
        ("scene.motions[n3].frequency", Scaled(-1), "their pace must be > 0"),
        ("scene.motions[n3].phase", Scaled(2), "has data"),
        ("scene.motions.amplitude", 0.1, "'n3' has data"),
        ("scene.resistance", 1, "no part of resistance ''; allowed: viscous, bending, drag, wind"),
        ("scene.resistance[rod].viscous", 1, "it has no parts 'rod'"),
        ("scene.resistance.viscous.x", 1, "it has no parts 'x'"),
        ("scene.resistance.drag.nomal", 1, "did you mean 'normal'.*allowed: normal, tangential, density, diameter"),
        ("scene.resistance.bending.pairs", 1, "no part of bending 'pairs'"),
        ("scene.resistance.bending", 1, "no part of bending ''; allowed: stiffness, damping"),
        ("scene.resistance.drag.diameter", Scaled(2), "no value that could be scaled"),
        ("scene.resistance.wind", 3, "a list of three numbers"),
    ],
)
def test_what_names_nothing_is_refused_before_anything_runs(path: str, value: Any, said: str) -> None:
    with pytest.raises(OptionError, match=said):
        Sweep(moved(), [Vary(path, [value])])


def test_motions_that_have_no_numbers_are_refused() -> None:
    with pytest.raises(OptionError, match="no motions of supports"):
        changed(tmj.load_scene("pinned_rod"), **{"scene.motions.frequency": 1.0})
    own = moved().with_(motions=(Motion.by_function("n2", lambda time: np.zeros((3, 3))),))
    with pytest.raises(OptionError, match="the motion of 'n2' is a function"):
        changed(own, **{"scene.motions.amplitude": Scaled(2.0)})
    flat = moved().with_(motions=(Motion("n2", (Harmonic((0.0, 0.0, 0.0), 1.0),)),))
    with pytest.raises(OptionError, match="has no direction"):
        changed(flat, **{"scene.motions.amplitude": 1.0})


def test_each_motion_may_be_drawn_by_itself() -> None:
    expected = [f"scene.motions[{name}].amplitude" for name in ("rod", "n2", "n3", "n4")]
    assert member_names(moved(), "scene.motions[*].amplitude") == expected


def test_a_sweep_of_a_moved_cable_in_still_air_and_wind() -> None:
    settings = {"scene.duration": 0.2, "engine": "dae"}
    axes = [Vary("scene.motions.frequency", [0.5, 1.0]), Vary("scene.resistance.viscous", [0.0, -1.0])]
    study = Sweep("cable", axes, fixed=settings).run(workers=HERE)
    ends = [outcome["status"] for outcome in study.outcomes]
    assert ends == ["done", "failed"] * 2
    assert "viscous = -1" in study.outcomes[1]["reason"]
    slow, fast = (study.outcomes[k]["values"]["energy_residual"] for k in (0, 2))
    assert slow != fast


# Water and contact ----------------------------------------------------------------------------------------


def wet() -> tmj.Scene:
    waves = (tmj.model.Wave(1.0, 50.0), tmj.model.Wave(0.5, 20.0, phase=0.5))
    water = tmj.Water(waves=waves, current=(1.0, 2.0, 0.0), segments=9)
    return tmj.load_scene("tower_waves").with_(water=water)


@pytest.mark.parametrize(
    ("path", "value", "change"),
    [
        ("density", 1000, {"density": 1000.0}),
        ("drag", Scaled(2), {"drag": 2.4}),
        ("depth", 70, {"depth": 70.0}),
        ("segments", 7, {"segments": 7}),
        ("weights", "hermite", {"weights": tmj.model.Weights.HERMITE}),
        ("current.y", Scaled(3), {"current": (1.0, 6.0, 0.0)}),
        ("waves.phase", 1, {"waves": (tmj.model.Wave(1.0, 50.0, phase=1.0), tmj.model.Wave(0.5, 20.0, phase=1.0))}),
        ("waves[1].amplitude", Scaled(3), {"waves": (tmj.model.Wave(1.0, 50.0), tmj.model.Wave(1.5, 20.0, phase=0.5))}),
    ],
)
def test_water_by_the_names_of_its_fields(path: str, value: Any, change: dict[str, Any]) -> None:
    assert changed(wet(), **{f"scene.water.{path}": value}).water == replace(wet().water, **change)


@pytest.mark.parametrize(
    ("path", "value", "said"),
    [
        ("scene.water.densty", 1, "no part of water 'densty' .did you mean 'density'"),
        ("scene.water.density.x", 1, "it has no parts 'x'"),
        ("scene.water[a].density", 1, "it has no parts 'a'"),
        ("scene.water.density", "thin", "scene.water.density = 'thin'; it must be a finite number"),
        ("scene.water.segments", 2.5, "scene.water.segments = 2.5; it must be an integer"),
        ("scene.water.inertia", Scaled(2), "it has no value that could be scaled"),
        ("scene.water.weights", "soft", "scene.water.weights = 'soft'; allowed: rigid, hermite"),
        ("scene.water.waves[2].phase", 1, "no member of waves '2'; allowed: 0, 1"),
        ("scene.water.waves.height", 1, "no part of a member of waves 'height'"),
        ("scene.contact.friction", 1, "scene 'tower_waves' has no contact"),
        ("scene.loads.force", [1, 0, 0], "scene 'tower_waves' has no loads"),
    ],
)
def test_what_water_has_not_is_refused(path: str, value: Any, said: str) -> None:
    with pytest.raises(OptionError, match=said):
        changed(wet(), **{path: value})


def test_the_floor_may_be_tilted() -> None:
    scene = changed(tmj.load_scene("prism_drop"), **{"scene.contact.normal.x": 0.01, "scene.contact.friction": 0.3})
    assert scene.contact == tmj.model.Contact(floor=0.0, normal=(0.01, 0.0, 1.0), friction=0.3)
