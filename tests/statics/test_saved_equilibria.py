"""An equilibrium that is saved, loaded and run is the one that was found."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import tensegrity_mj as tmj
from tensegrity_mj.errors import InfeasibleError
from tensegrity_mj.model.text.sources import scene_names
from tensegrity_mj.statics import StaticModel, find_equilibrium

EPS = float(np.finfo(float).eps)

HANGING = """
format = 1
name = "hanging"
[structure]
nodes = {{ f = [0, 0, 1.0], p = [0, 0, 0.0], g = [0, 0, -1.0] }}
fixed_nodes = ["f", "g"]
point_masses = [{{ node = "p", mass = 1.0 }}]
strings = [
  {{ name = "held", nodes = ["f", "p"], {string} }},
  {{ name = "below", nodes = ["p", "g"], stiffness = 50.0, rest_length = 0.5 }},
]
[scene]
gravity = [0, 0, -9.81]
duration = 0.5
"""
KINDS = {
    "linear": "stiffness = 100.0",
    "rope": "stiffness = 100.0, mass = 0.2, segments = 2",
    "curve": "curve = [[0.1, 10.0], [0.5, 60.0]]",
    "curved rope": "curve = [[0.1, 10.0], [0.5, 60.0]], mass = 0.2, segments = 3",
    "yielding": "curve = [[0.1, 10.0], [0.5, 30.0]], yields = true",
}
WAYS = {"tension": "tension = 30.0", "density": "force_density = 30.0", "rest": "rest_length = 0.7", "none": ""}
STRINGS = {f"{kind} by {way}": f"{one}, {by}".strip(", ") for kind, one in KINDS.items() for way, by in WAYS.items()}
STRINGS["constant force"] = "stiffness = 0.0, tension = 30.0"


def saved_and_loaded(scene: tmj.Scene, path: Path) -> tmj.Scene:
    tmj.save_scene(scene, path)
    return tmj.load_scene(path)


@pytest.mark.parametrize("string", STRINGS.values(), ids=STRINGS.keys())
def test_what_was_found_stays_whatever_gives_the_length(tmp_path: Path, string: str) -> None:
    (tmp_path / "given.toml").write_text(HANGING.format(string=string), encoding="utf-8")
    found = find_equilibrium(tmj.load_scene(tmp_path / "given.toml"))
    loaded = saved_and_loaded(found.scene(), tmp_path / "found.toml")
    run = tmj.simulate(loaded, controller=None, engine="dae")
    # The search leaves forces of a part 1e-12 of k times the size (1 m), and a node moves by at most twice a force over
    # the softest stiffness, which is above k/10 here; a rope's rest length is a sum of at most five parts.
    assert np.abs(run.nodes - found.nodes).max() < 1e-10
    assert np.abs(run.tensions - found.tensions).max() < 150 * 1e-10


@pytest.mark.parametrize("name", scene_names())
def test_shipped_scenes_start_in_what_was_found_and_saved(tmp_path: Path, name: str) -> None:
    try:
        found = find_equilibrium(tmj.load_scene(name))
    except InfeasibleError:
        pytest.skip("has no equilibrium by itself")
    loaded = saved_and_loaded(found.scene(), tmp_path / "found.toml")
    model = StaticModel.of(loaded)
    assert np.array_equal(loaded.nodes0, found.nodes)
    # Files have all digits; the rest length of a rope is the sum of its parts, of which each is cut out of it again.
    parts = max((len(rope.parts) for rope in loaded.structure.ropes), default=0)
    left = (parts + 3) * EPS * found.model.rest_lengths
    assert (np.abs(model.rest_lengths - found.model.rest_lengths) <= left).all()
    pulls = model.tensions(model.lengths(loaded.nodes0.ravel()))
    slack = left + 4 * EPS * found.lengths
    assert (np.abs(pulls - found.tensions) <= loaded.structure.stiffness * slack + 4 * EPS * found.tensions).all()
