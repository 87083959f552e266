"""What the README of the scene `arrester` states."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import tensegrity_mj as tmj


def test_the_load_is_caught_by_a_rope_that_yields() -> None:
    """Engines that split their steps agree; what the rope took is the area of its curve, by trapezoids."""
    scene = tmj.load_scene("arrester")
    engines = (
        tmj.DAE(rtol=1e-11, atol=1e-12),
        tmj.MuJoCo(1e-3, locate_slack=True),
        tmj.DAE(method=tmj.Method.RK4, timestep=1e-3, locate_slack=True),
    )
    runs = [tmj.simulate(scene, None, engine, output_interval=0.01) for engine in engines]
    for run in runs:
        # RK4 between events, at ω <= 110 /s of the stay's steepest piece on a boom of 5 m: (ω h)⁴ ω T / 120 of 1 cm.
        assert np.abs(run.nodes - runs[0].nodes).max() < (0.11**4) * 110 * 3 / 120 * 0.01
        kept = run.permanent_stretch[-1, 2]
        assert kept == pytest.approx(0.377, abs=5e-4)
        assert 3150 < run.tensions[:, 2].max() < 3200
        np.testing.assert_array_equal(run.tensions[:, 1], 100.0)
        # s* - f(s*)/k = p on the second piece, f = 3000 + 600/1.97 (s - 0.03).
        slope = 600 / 1.97
        longest = (kept + (3000 - slope * 0.03) / 1e5) / (1 - slope / 1e5)
        top = 3000 + slope * (longest - 0.03)
        spent = 0.5 * 0.03 * 3000 + 0.5 * (3000 + top) * (longest - 0.03) - 0.5 * top**2 / 1e5
        assert spent == pytest.approx(1151, abs=1)
        assert run.dissipation[-1] == pytest.approx(1290, abs=1)
        # Dampers that let go of a string leave h² (evidence/docs/accuracy.md), and of nothing else.
        assert run.energy_residual < 1e-3
    strings = scene.structure.strings
    straight = (*strings[:2], replace(strings[2], curve=strings[2].curve[:1], yields=False))
    linear = tmj.simulate(scene.with_(structure=replace(scene.structure, strings=straight)), None, engines[1])
    assert linear.tensions[:, 2].max() == pytest.approx(11600, rel=0.02)
