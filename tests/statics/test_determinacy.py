"""Forces that equilibrium determines, and those that are a choice: which, by which rule, and everywhere they appear."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import tensegrity_mj as tmj
from tensegrity_mj.model.section import Section
from tensegrity_mj.runs.trajectory import Trajectory
from tensegrity_mj.statics import Rods, StaticModel, check_state, find_equilibrium
from tensegrity_mj.statics.findings import reactions
from tensegrity_mj.statics.page import _tables as tables
from tensegrity_mj.statics.page import members_figure
from tensegrity_mj.statics.state import Determinacy, StaticState, determinacy

BRACED = ("lower1", "upper1", "post1", "rising1", "falling1")  # the cell of the arm that has rods for both diagonals


def stiffened(scene: tmj.Scene, stiffness: dict[str, float]) -> StaticState:
    """In equilibrium with rods of these stiffnesses [N/m]."""
    rods = tuple(replace(rod, stiffness=stiffness[rod.name]) for rod in scene.structure.rods)
    return find_equilibrium(scene.with_(structure=replace(scene.structure, rods=rods)))


@pytest.fixture(scope="module")
def arm() -> tmj.Scene:
    return tmj.load_scene("truss_arm")


@pytest.fixture(scope="module")
def state(arm: tmj.Scene) -> StaticState:
    return find_equilibrium(arm)


def test_the_braced_cell_of_the_arm_is_a_choice_and_the_rest_is_not(state: StaticState) -> None:
    found = state.determinacy
    # Two nodes with two coordinates each, five rods: one state of self-stress. The wall carries its chords' part.
    assert found == Determinacy(1, BRACED, ("b0", "t0"), True)
    # That state added, nothing else moves: the residual stays what it was but for round-off of ten forces of 1e3 N.
    C = state.model.rod_slopes(state.x).toarray() @ state.model.boundary.Z.toarray()
    own = np.linalg.svd(C)[0][:, -1]
    other = replace(state, bar_forces=state.bar_forces + 1e3 * own)
    assert other.residual < state.residual + 10 * 2.3e-16 * 1e3 * 10
    assert sorted(np.array([rod.name for rod in state.model.structure.rods])[np.abs(own) > 1e-9]) == sorted(BRACED)


def test_the_rule_is_that_of_stiff_rods_of_one_stiffness(arm: tmj.Scene, state: StaticState) -> None:
    names = [rod.name for rod in arm.structure.rods]
    lengths = dict(zip(names, arm.structure.rod_lengths.tolist(), strict=True))
    k = 1e9
    same = stiffened(arm, dict.fromkeys(names, k))
    # Forces of up to 15 N strain rods of .25 m or more by 15/(k .25). Nodes move by that over the least singular value,
    # which `statics truss_arm` prints as 3.5e-2, and forces change in that proportion; three of these, as bends add up.
    bound = 3 / 0.035 * 15.0 * 15.0 / (k * 0.25)
    assert np.abs(same.rod_forces - state.rod_forces).max() < bound
    # Of one EA, the diagonals are softer: other forces in the braced cell, and nowhere else.
    tubes = stiffened(arm, {name: 0.25 * k / lengths[name] for name in names})
    differ = np.abs(tubes.rod_forces - state.rod_forces)
    assert {name for name, one in zip(names, differ, strict=True) if one > bound} == set(BRACED)
    assert differ[names.index("rising1")] > 0.1
    assert tubes.determinacy == Determinacy()


def test_it_is_said_in_the_text_json_and_members(arm: tmj.Scene) -> None:
    strong = arm.structure.with_sections(Section.tube(5e-3, 1e-3, 70e9, 2e8)).with_strings(strength=100.0)
    study = tmj.statics.analyse(arm.with_(structure=strong))
    (line,) = [one for one in study.judgement.findings if "are a choice" in one.text]
    assert line.mark is not None
    assert line.mark.value == "limited"
    assert "'rising1'" in line.text
    assert "least sum of squares" in line.text
    data = study.to_dict()
    rods = data["equilibrium"]["rods"]
    assert {name for name, rod in rods.items() if not rod["determined"]} == set(BRACED)
    assert {name for name, rod in data["members"]["rods"].items() if not rod["determined"]} == set(BRACED)
    assert study.state is not None
    table = next(one for one in tables(study, study.state) if one.title == "rods")
    assert {row[0] for row in table.rows if row[list(table.columns).index("determined")] != "yes"} == set(BRACED)
    check = study.members
    assert check is not None
    assert not check.ok
    assert check.unchecked == tuple(f"rod '{name}' (its force is a choice)" for name in BRACED)
    assert {use.member for use in check.uses if use.chosen} == set(BRACED)
    # Elastic rods determine all of them, and every member is checked.
    assert check_state(find_equilibrium(StaticModel.of(arm.with_(structure=strong), rods=Rods.ELASTIC))).ok


def test_the_picture_hatches_them_and_supports_alone_have_reactions(state: StaticState) -> None:
    *_, rods = members_figure(state).axes
    assert sum(bar.get_hatch() is not None for bar in rods.patches) == len(BRACED)
    pushed = [name for name, one in zip(state.model.structure.node_names, reactions(state), strict=True) if any(one)]
    assert pushed == ["b0", "t0"]  # the plane holds the others with nothing but round-off


def test_members_over_a_run_say_it_too(arm: tmj.Scene) -> None:
    strong = arm.structure.with_sections(Section.tube(5e-3, 1e-3, 70e9, 2e8)).with_strings(strength=100.0)
    run: Trajectory = tmj.simulate(arm.with_(structure=strong), engine="dae", duration=0.02)
    found = tmj.statics.check_trajectory(run)
    assert {use.member for use in found.uses if use.chosen} == set(BRACED)
    assert not found.ok


def test_members_along_a_path_say_it_too(arm: tmj.Scene) -> None:
    strong = arm.structure.with_sections(Section.tube(5e-3, 1e-3, 70e9, 2e8)).with_strings(strength=100.0)
    study = tmj.statics.analyse(arm.with_(structure=strong), loads={"t4": (0.0, 0.0, -1.0)}, path=True)
    assert study.response is not None
    assert study.response.members.chosen == BRACED


def test_rods_that_are_too_many_are_not_judged(state: StaticState, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tensegrity_mj.statics.state.MOST_RODS", 13)  # the arm has 14
    found = determinacy(state.model, state.x)
    assert found == Determinacy(None)
    assert found.describe().startswith("not checked whether forces are determined: more than 13 rigid rods")


@pytest.mark.parametrize(("height", "clear"), [(0.1, True), (1e-4, True), (1e-8, False), (1e-10, False)])
def test_what_hangs_on_digits_that_nodes_do_not_have_is_undecided(height: float, clear: bool) -> None:
    """Two rods to one node, nearly in a line: their least singular value is about √2 times its height over 1 m."""
    plane = tmj.Support.pinned(0.0, plane=(0.0, 1.0, 0.0))
    structure = tmj.Structure(
        "flat",
        {"a": (-1.0, 0.0, 0.0), "m": (0.0, 0.0, height), "b": (1.0, 0.0, 0.0)},
        (tmj.Rod("left", ("a", "m"), 1.0, support=plane), tmj.Rod("right", ("b", "m"), 1.0, support=plane)),
        (),
    )
    model = StaticModel.of(structure)
    found = determinacy(model, model.start.ravel())
    assert found.is_clear is clear
    assert ("undecided" in found.describe()) is not clear
