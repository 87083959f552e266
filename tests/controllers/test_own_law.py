"""A new law is a file of its own in `controllers/`: scene files, commands and sweeps have it by the file's name."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import tensegrity_mj as tmj
from tensegrity_mj import controllers
from tensegrity_mj.cli import main
from tensegrity_mj.controllers import LAWS, table

LAW = '''
"""Damping by winches: u = gain dL/dt / L where a string lengthens, else none, so that u·L·dL/dt >= 0 is taken away."""

from dataclasses import dataclass

import numpy as np

from tensegrity_mj.basics.checks import positive
from tensegrity_mj.controllers.table import NamedLaw


@dataclass(frozen=True, eq=False)
class Brake:
    structure: object
    target: object
    gain: float = 1.0  # [N s/m]
    gravity: tuple = (0.0, 0.0, 0.0)
    known: tuple = ()

    def __post_init__(self):
        object.__setattr__(self, "gain", positive("gain", self.gain, "N s/m"))

    def __call__(self, time, nodes, velocities):
        lengths = self.structure.string_lengths(nodes)
        return self.gain * np.maximum(0.0, self.structure.string_rates(nodes, velocities)) / lengths

    def describe(self):
        return {"law": "brake", "gain": self.gain}


LAW = NamedLaw(Brake)
'''


@pytest.fixture
def brake(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Iterator[None]:
    """The file, in a second folder of the package `controllers`."""
    (tmp_path / "brake.py").write_text(LAW, encoding="utf-8")
    monkeypatch.setattr(controllers, "__path__", [*controllers.__path__, str(tmp_path)])
    table.built_in.cache_clear()
    yield
    table.built_in.cache_clear()
    sys.modules.pop("tensegrity_mj.controllers.brake", None)


@pytest.mark.usefixtures("brake")
def test_commands_and_scene_files_have_it(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert list(LAWS) == ["brake", "feedback_linearization", "lyapunov", "program", "projection"]
    scene = tmj.load_scene("pinned_rod")
    spinning = np.zeros((len(scene.structure.nodes), 3))
    tip = scene.structure.node_index["n1"]  # of the rod whose foot is pinned at the origin
    spinning[tip] = 0.3 * np.cross([0.0, 0.0, 1.0], scene.nodes0[tip])
    control = tmj.model.ControlSpec("brake", {"gain": 0.5})
    tmj.save_scene(scene.with_(control=control, initial_velocities=spinning), tmp_path / "scene.toml")
    words = ["run", str(tmp_path / "scene.toml"), "--duration", "2", "--json"]
    found = []
    for number, more in enumerate((["--timestep", "1e-3"], ["--engine", "dae"], ["--law-option", "gain=2.0"])):
        out = tmp_path / f"{number}.nc"
        assert main([*words, *more, "--out", str(out)]) == 0
        assert json.loads(capsys.readouterr().out)["status"] == "completed"
        found.append(tmj.Trajectory.load(out))
    for run, gain in zip(found, (0.5, 0.5, 2.0), strict=True):
        assert run.provenance["controller"] == {"law": "brake", "gain": gain}
        # A winch that keeps u takes T dL/dt = u L dL/dt, which is never negative: what moves, only slows.
        assert np.all(np.diff(run.kinetic_energy) < 0)
    assert tmj.compare(found[0], found[1]).max_node_error < 1e-6
    assert found[2].kinetic_energy[-1] < found[0].kinetic_energy[-1]


@pytest.mark.usefixtures("brake")
def test_what_it_has_not_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    for words, message in {
        "run pinned_rod --law brak": "unknown law 'brak' (did you mean 'brake'?); allowed: brake, ",
        "run pinned_rod --law brake --law-option gan=1": "has no option 'gan' (did you mean 'gain'?); allowed: gain",
        "run pinned_rod --law brake --law-option gain=-1.0": "gain = -1.0; it must be a finite number > 0 N s/m",
    }.items():
        assert main(words.split()) == 2
        assert message in capsys.readouterr().err


def test_a_file_without_a_law_has_no_name() -> None:
    everything: Any = [path.stem for path in Path(controllers.__path__[0]).glob("*.py")]
    assert {"quadratic_terms", "quadratic_law", "table"} <= set(everything) - set(LAWS)
    with pytest.raises(KeyError):
        LAWS["quadratic_terms"]
