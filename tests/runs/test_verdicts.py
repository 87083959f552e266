"""Sentences about runs: what they say, and when they change their mind."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from analytic_runs import cone_run, planar_scene, run_of

import tensegrity_mj as tmj
from tensegrity_mj.errors import OptionError
from tensegrity_mj.runs.judgement import size_of, verdict
from tensegrity_mj.runs.trajectory import Status


def pair(shift: float):
    run = cone_run(engine="MuJoCo RK4")
    return run, replace(run, nodes=run.nodes + np.array([shift, 0.0, 0.0]), engine="DAE DOP853")


@pytest.mark.parametrize(
    ("shift", "text"),
    [
        (0.0, "MuJoCo and the DAE agree exactly over 2 s; "),
        (2e-6, "MuJoCo and the DAE agree to 2 µm over 2 s (allowed 29 mm); "),
        (0.2, "MuJoCo and the DAE differ by up to 0.2 m over 2 s (allowed 29 mm); "),
        (np.nan, "MuJoCo and the DAE cannot be compared where positions are not finite; "),
    ],
)
def test_two_runs_agree_or_differ(shift, text):
    runs = pair(shift)
    assert verdict(runs, tmj.compare(*runs)).startswith(text)


def test_runs_of_one_engine_are_told_apart():
    first, second = pair(1e-9)
    second = replace(second, engine="MuJoCo RK4, h = 0.002 s")
    text = verdict([first, second], tmj.compare(first, second))
    assert text.startswith("MuJoCo RK4 and MuJoCo RK4, h = 0.002 s agree")
    same = replace(second, engine=first.engine)
    assert verdict([first, same], tmj.compare(first, same)).startswith("The first run and the second run agree")


def test_a_target_is_met_within_a_hundredth_of_the_size():
    run = cone_run()
    assert verdict([run]) == "The target is missed by 0.59 m (allowed 30 mm, at the start 0.59 m)."  # 5 % of it
    nodes = run.nodes.copy()
    nodes[-1, 1] = [0.009 * size_of(run), 0.0, 1.0]  # the target has the rod upright, its tip at (0, 0, 1)
    assert "the target is met to" in verdict([replace(run, nodes=nodes)]).lower()
    nodes[-1, 1] = [0.06 * size_of(run), 0.0, 1.0]
    assert "missed" in verdict([replace(run, nodes=nodes)])


def test_without_a_target_the_energy_is_what_is_judged_and_an_early_end_is_named():
    scene, times = planar_scene((0, 0, 1)), np.linspace(0.0, 1.0, 5)
    nodes = np.repeat(scene.structure.positions[None], 5, axis=0)
    run = run_of(scene, times, nodes, np.zeros_like(nodes), np.zeros((5, 4)), "MuJoCo RK4")
    assert verdict([run]) == "MuJoCo ran for 1 s; its energy is balanced to 841 pJ of 0.1 J exchanged."  # 1e-9 sin 1
    ended = replace(run, status=Status.DIVERGED)
    assert verdict([ended]).startswith("MuJoCo ended early: diverged at t = 1 s")
    assert "balanced" not in verdict([ended])


def test_runs_that_warn_grow_or_end_early_confirm_nothing():
    """Two engines may be wrong alike: that they agree shows nothing then."""
    first, second = pair(2e-6)
    warned = replace(second, reports={"warnings": ["the energy balance is off by 3 J of 4 J exchanged"]})
    text = verdict([first, warned], tmj.compare(first, warned))
    assert text.startswith("MuJoCo and the DAE are 2 µm apart at most over 2 s, which confirms neither; ")
    assert text.endswith("the DAE is in doubt: the energy balance is off by 3 J of 4 J exchanged.")
    ended = [replace(run, status=Status.DIVERGED) for run in (first, second)]
    text = verdict(ended, tmj.compare(*ended))
    assert "which confirms neither" in text
    assert "agree" not in text
    assert "the target is 0.59 m away where it ended" in text
    grown = replace(first, force_densities=first.force_densities * np.exp(3 * first.time)[:, None])
    assert "is in doubt: the largest force density grows" in verdict([grown, second], tmj.compare(grown, second))


def test_a_run_is_not_compared_with_itself():
    first, second = pair(0.0)
    for other in (first, replace(first)):
        assert verdict([first, other], tmj.compare(first, other)).startswith(
            "One run is compared with itself, which shows nothing; "
        )
    again = replace(first, cost={**first.cost, "wall_time": 9.0})
    assert "the engine repeats, which does not show that it is right" in verdict(
        [first, again], tmj.compare(first, again)
    )
    assert "agree exactly" in verdict([first, second], tmj.compare(first, second))


def test_tolerances_are_given_by_units():
    runs = pair(2e-6)
    found = tmj.compare(*runs, tolerances={"m": 1e-3})
    assert found.first_exceeded["node_error"] is None
    assert found.tolerance_of("rest_length_error") == 1e-3
    assert np.isnan(found.tolerance_of("energy_error"))
    assert set(found.first_exceeded) == {"node_error", "rest_length_error"}
    with pytest.raises(OptionError, match="allowed: m, m/s"):
        tmj.compare(*runs, tolerances={"kN/m": 1.0})
    with pytest.raises(OptionError, match="> 0"):
        tmj.compare(*runs, tolerances={"N": -1.0})


def test_a_comparison_shows_itself_in_six_lines():
    first, second = pair(2e-6)
    second = replace(second, tensions=second.tensions + np.array([0.0, 0.0, 0.5]))
    found = tmj.compare(first, second, tolerances={"m": 1e-3, "N": 1e-6})
    lines = repr(found).splitlines()
    assert lines[:3] == [
        "between MuJoCo RK4 and DAE DOP853",
        "time    0 to 2 s, 21 common times",
        "motion  node 2 µm, velocity 0 m/s",
    ]
    assert lines[3].startswith("forces  tension 0.5 N, rod force 0 N, force density (u) ")
    assert [line.split()[0] for line in lines[4:]] == ["others", "beyond"]
    assert lines[5].startswith("beyond  tension error from 0 s")
    assert repr(tmj.compare(first, first, 1e-6)).splitlines()[5] == "beyond  no tolerance"
    assert "beyond" not in repr(tmj.compare(first, first))


def test_a_comparison_with_a_table_shows_what_the_table_has():
    run = cone_run(engine="MuJoCo RK4")
    tip = run.nodes[:, [run.scene.structure.node_index["tip"]]]
    table = tmj.runs.Table(run.time, ("tip",), tip, name="motion.csv")
    lines = repr(tmj.compare(run, table)).splitlines()
    assert [line.split()[0] for line in lines] == ["between", "time", "motion"]
    assert lines[0] == "between MuJoCo RK4 and motion.csv"
