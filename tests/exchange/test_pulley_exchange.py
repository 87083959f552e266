"""Strings through more than two nodes in files of other programs: MJCF has them, others say that they have no room."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest
from pulley_scenes import atwood, ringed

import tensegrity_mj as tmj
from tensegrity_mj import errors, exchange
from tensegrity_mj.engines.mujoco.mjcf import save_mjcf
from tensegrity_mj.exchange.importing import import_scene


@pytest.mark.parametrize(
    "scene", [atwood, ringed, lambda: tmj.load_scene("pulley")], ids=["atwood", "ringed", "pulley"]
)
def test_mjcf_has_one_tendon_through_all_sites_and_comes_back(scene, tmp_path: Path) -> None:  # type: ignore[no-untyped-def]
    ours = scene()
    path = tmp_path / "scene.xml"
    save_mjcf(ours, path)
    model = mujoco.MjModel.from_xml_path(str(path))
    assert model.ntendon == len(ours.structure.strings)
    assert model.tendon_num.tolist() == [len(string.nodes) for string in ours.structure.strings]
    theirs = import_scene(path).scene
    assert [s.nodes for s in theirs.structure.strings] == [s.nodes for s in ours.structure.strings]
    np.testing.assert_allclose(theirs.structure.rest_lengths, ours.structure.rest_lengths, rtol=1e-14)
    one, other = (tmj.simulate(s, None, tmj.MuJoCo(1e-3), duration=0.2, output_interval=0.1) for s in (ours, theirs))
    # Numbers of 17 digits, and 200 steps that round; nodes in another order.
    order = [theirs.structure.node_index[name] for name in ours.structure.node_names]
    np.testing.assert_allclose(other.nodes[-1, order], one.nodes[-1], atol=1e-11)


def test_tables_and_matlab_data_are_refused_with_the_reason(tmp_path: Path) -> None:
    with pytest.raises(errors.StructureError, match=r"string 's' runs through 4 nodes: tables of members"):
        exchange.save_csv(atwood(), tmp_path / "a_nodes.csv")
    with pytest.raises(errors.StructureError, match=r"string 's' runs through 4 nodes: MATLAB data .* two nodes"):
        exchange.save_mat(atwood(), tmp_path / "a.mat")
    assert not list(tmp_path.iterdir())


def test_solids_have_every_segment(tmp_path: Path) -> None:
    from tensegrity_mj.exchange.solids import shape

    whole = shape(ringed()).reshape(-1, 3)
    parts = shape(ringed(rings=False)).reshape(-1, 3)
    np.testing.assert_allclose(whole, parts, atol=1e-15)
    assert exchange.save_stl(atwood(), tmp_path / "a.stl", 1.0).exists()
