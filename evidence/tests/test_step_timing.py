"""The time of a step: its parts, variants of a scene's model, and further steps of a run, by a clock of the test's."""

from __future__ import annotations

import json
import time
from dataclasses import replace

import mujoco
import numpy as np
import pytest

import tensegrity_mj as tmj
from evidence.speed import step_timing
from evidence.speed.step_timing import CONTACT, PARTS, REST, measure, variants
from tensegrity_mj.cli import main
from tensegrity_mj.engines.mujoco.mjcf import scene_to_mjcf
from tensegrity_mj.engines.mujoco.run import MuJoCoRun


def test_what_would_be_more_is_more() -> None:
    """Each variant has what its name says, the rest is as it was, and it starts where the scene does."""

    def counts(model: mujoco.MjModel) -> dict[str, int]:
        names = ("nv", "nsensor", "neq", "nu", "ntendon")
        return {name: int(getattr(model, name)) for name in names} | {
            "touching": int(np.sum(model.geom_conaffinity > 0)),
            "energy": int(model.opt.enableflags & mujoco.mjtEnableBit.mjENBL_ENERGY > 0),
        }

    for name, expected in (
        (
            "tbar",
            {
                "contact with a floor, without a touch": {"touching": 2},
                "ball and free joints in the plane": {"nv": 6},
                "a sensor a string": {"nsensor": 4},
                "pins as constraint rows": {"nv": 12, "neq": 2},
                "gravity": {},
                "MuJoCo's energy": {"energy": 1},
            },
        ),
        ("prism_drop", {CONTACT: {}, "a sensor a string": {"nsensor": 12}, "MuJoCo's energy": {"energy": 1}}),
        ("cross", {"ball and free joints in the plane": {"nv": 7}}),
        ("prism", {"contact between rods, without a touch": {"touching": 3}}),
    ):
        scene = tmj.load_scene(name)
        plain = mujoco.MjModel.from_xml_string(scene_to_mjcf(scene))
        found = variants(scene)
        assert set(expected) <= set(found)
        assert name in ("cross", "prism") or set(found) == set(expected)
        for what, changes in expected.items():
            model = found[what]
            assert counts(model) == counts(plain) | changes, what
            data = mujoco.MjData(model)
            mujoco.mj_step(model, data, 20)
            assert data.ncon == 0
            assert not data.warning[mujoco.mjtWarning.mjWARN_BADQACC].number
            mujoco.mj_resetData(model, data)
            mujoco.mj_kinematics(model, data)
            for node, position in zip(scene.structure.node_names, scene.nodes0, strict=True):
                np.testing.assert_allclose(data.site(node).xpos, position, rtol=0, atol=1e-12)
    drop = tmj.load_scene("prism_drop")
    without = variants(drop)[CONTACT]
    assert without.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_CONTACT


def test_timing_says_what_it_must() -> None:
    for name in ("pinned_rod", "prism_drop"):
        scene = tmj.load_scene(name)
        timing = measure(scene, rounds=2)
        assert set(timing.shares) == {*PARTS, REST}
        assert sum(timing.shares.values()) == pytest.approx(1.0, abs=1e-12)
        assert min(timing.shares[part] for part in PARTS) > 0
        assert 0 < timing.step < 1
        assert (timing.closed_loop is None) is (scene.control is None)
        assert {extra.what for extra in timing.extras} == set(variants(scene))
        assert [extra.what for extra in timing.extras if extra.needed] == ([CONTACT] if scene.contact else [])
    assert mujoco.get_mjcb_time() is None


def test_a_further_step_is_what_a_longer_run_takes_more(monkeypatch: pytest.MonkeyPatch) -> None:
    """By a clock that only the steps of runs advance: what is done but once, or by others, is not of a step."""
    now, passive, closed, once, others = [0.0], 20e-6, 30e-6, 0.05, 0.025
    advance, pieces = MuJoCoRun._advance, [0]

    def advanced(run: MuJoCoRun, first: int, count: int) -> None:
        advance(run, first, count)
        pieces[0] += 1
        now[0] += count * (passive if run.request.law.address == 0 else closed)
        now[0] += once if first == 0 else 0.0
        now[0] += others if pieces[0] % 5 == 0 else 0.0  # another process had its turn

    monkeypatch.setattr(MuJoCoRun, "_advance", advanced)
    monkeypatch.setattr(step_timing, "_race", lambda models, rounds: (dict.fromkeys(models, passive), 10))
    monkeypatch.setattr(time, "perf_counter", lambda: now[0])
    timing = measure(tmj.load_scene("pinned_rod"), rounds=2)
    assert timing.passive_run == pytest.approx(passive, rel=1e-9)  # a clock of seconds has digits for 1e-11 of a step
    assert timing.closed_loop == pytest.approx(closed, rel=1e-9)
    assert 0 < timing.run_time <= tmj.load_scene("pinned_rod").duration
    assert timing.timestep == pytest.approx(1e-3)


def test_a_scene_that_no_run_of_the_usual_step_survives_is_measured_all_the_same(tmp_path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    prism, drop = tmj.load_scene("prism"), tmj.load_scene("prism_drop").with_(contact=None)
    assert prism.control is not None
    strings = [replace(string, stiffness=1e5 * string.stiffness) for string in drop.structure.strings]
    stiff = drop.with_(structure=replace(drop.structure, strings=strings))
    assert measure(stiff, rounds=2).passive_run
    for changes, closes in (({"norm": 1}, True), ({"maximum_force_density": 1e-9}, False)):
        scene = prism.with_(control=replace(prism.control, options={**prism.control.options, **changes}))
        assert (measure(scene, rounds=2).closed_loop is not None) is closes
    assert not list(tmp_path.iterdir())  # MuJoCo writes its warnings into the current folder


def test_the_command_prints_the_parts(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["audit", "step", "prism_drop", "--json"]) == 0
    timing = json.loads(capsys.readouterr().out)["timing"]
    assert timing["step"] > 0
    assert sum(timing["shares"].values()) == pytest.approx(1.0, abs=1e-12)
    assert main(["audit", "step", "prism_drop"]) == 0
    text = capsys.readouterr().out
    for part in ("a step of the bare model", "it is here", "µs without a law; ledger and rec"):
        assert part in text
