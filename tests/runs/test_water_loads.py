"""Loads of water on rods along a run: by Newton's law in closed form, and by the momentum that they leave."""

from __future__ import annotations

import numpy as np
import pytest

import tensegrity_mj as tmj
from tensegrity_mj.errors import OptionError
from tensegrity_mj.model.elements.water import water_forces

G, RHO, D, LENGTH = 9.81, 1025.0, 0.1, 2.0
DISPLACED = RHO * np.pi * D**2 / 4 * LENGTH


def rod(mass: float, z: float = -6.0, **water: object) -> tmj.Scene:
    nodes = {"a": (0.0, 0.0, z), "b": (LENGTH, 0.0, z)}
    structure = tmj.Structure("rod", nodes, (tmj.Rod("r", ("a", "b"), mass, D / 2),))
    return tmj.Scene(structure, gravity=(0, 0, -G), water=tmj.Water(**water), duration=0.5)


@pytest.mark.parametrize("engine", [tmj.DAE(rtol=1e-11, atol=1e-12), tmj.MuJoCo(1e-3)], ids=["DAE", "MuJoCo"])
def test_a_rod_that_rises_has_the_load_that_lifts_it(engine: object) -> None:
    """Without drag, a level rod rises with a = (m_w - m) g / (m + C_a m_w), so that the water bears m (g + a).

    Its velocity is linear in time, which the spline has to round-off of ε v / h = 1e-13 m/s², and to what the engine
    leaves in v, 1e-11 m/s, over h = 0.01 s: 2e-8 N of C_a m_w = 16 kg.
    """
    mass = 5.0
    run = tmj.simulate(rod(mass, drag=0.0), None, engine, output_interval=0.01)
    a = (DISPLACED - mass) * G / (mass + DISPLACED)
    loads = run.water_loads()
    assert loads.shape == (len(run.time), 1, 3)
    np.testing.assert_allclose(loads[:, 0], np.outer(np.ones(len(run.time)), [0, 0, mass * (G + a)]), atol=1e-7)


def test_in_waves_the_load_leaves_the_momentum_that_the_rod_has() -> None:
    """m v of a free rod's centre is ∫ (F - m g) dt, here by Simpson's rule over samples 5 ms apart.

    Of motions of 1 m/s and forces of 300 N at 5 rad/s: the spline's slopes are off by h³/24 · 5⁴ m/s² = 3e-6 m/s²,
    which 16 kg make 1e-4 N s of in 2 s, did they not cancel; Simpson's rule by h⁴/180 · 5⁴ · 300 N · 2 s = 1.3e-6 N s.
    """
    waves = (tmj.model.Wave(0.5, 12.0, direction=0.6), tmj.model.Wave(0.2, 6.0, direction=2.0, phase=1.0))
    scene = rod(8.0, -4.0, waves=waves, current=(0.4, -0.2, 0.0), tangential_drag=0.1, segments=8)
    run = tmj.simulate(scene, None, tmj.DAE(rtol=1e-11, atol=1e-12), duration=2.0, output_interval=5e-3)
    force = run.water_loads()[:, 0] + 8.0 * np.array(scene.gravity)
    momentum = 8.0 * run.velocities.mean(axis=1)
    simpson = 5e-3 / 3 * np.cumsum(force[:-2:2] + 4 * force[1:-1:2] + force[2::2], axis=0)

    assert np.abs(momentum[2::2] - simpson).max() < 1e-4
    assert np.abs(momentum).max() > 5.0
    # What nodes get in all is what rods get, but for what answers accelerations.
    nodal, alpha = water_forces(scene, run.time, run.nodes, run.velocities)
    assert alpha.shape == (len(run.time), 1, 2, 2)
    assert np.abs(nodal.sum(axis=1) - run.water_loads()[:, 0]).max() > 1.0


def test_tables_and_statistics_have_them_where_they_are_wanted() -> None:
    sea = tmj.model.IrregularSea("jonswap", 0.5, 3.0, components=10)
    run = tmj.simulate(rod(5.0, sea=sea), None, tmj.DAE(), output_interval=0.05)
    loads = run.water_loads()
    data = pytest.importorskip("xarray") and run.to_xarray(water_loads=True)
    np.testing.assert_array_equal(data.water_loads.sel(rod="r", axis="z"), loads[:, 0, 2])
    assert data.water_loads.units == "N"
    assert "water_loads" not in run.to_xarray()
    frame = run.to_dataframe(water_loads=True)
    np.testing.assert_array_equal(frame["r.water_z"], loads[:, 0, 2])
    assert len(frame.columns) == len(run.to_dataframe().columns) + 3
    assert run.statistics("water_load").greatest[2] == loads[:, 0, 2].max()
    with pytest.raises(OptionError, match="water_loads: scene 'rod' has no water"):
        tmj.simulate(rod(5.0).with_(water=None), None, tmj.DAE(), duration=0.1).water_loads()
