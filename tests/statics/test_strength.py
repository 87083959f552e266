"""Checks of members against closed forms, in one state and over runs, and what they say of what they cannot check."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from analytic_runs import cone_run
from scipy.integrate import quad

import tensegrity_mj as tmj
from tensegrity_mj.basics.jsontext import to_json
from tensegrity_mj.errors import OptionError
from tensegrity_mj.model.events import Break
from tensegrity_mj.model.members import Rod, String, Support
from tensegrity_mj.model.rigidity import static_forces
from tensegrity_mj.model.scene import Scene
from tensegrity_mj.model.section import Section
from tensegrity_mj.model.structure import Structure
from tensegrity_mj.runs.trajectory import Trajectory
from tensegrity_mj.statics.equilibrium import find_equilibrium
from tensegrity_mj.statics.self_stress import prestress
from tensegrity_mj.statics.strength import (
    Criterion,
    MemberLoads,
    SlackInterval,
    check_members,
    check_state,
    check_trajectory,
)

PIPE = Section.tube(0.05, 0.01095, 210e9, 200e6)  # Table C.1 of the thesis
AREA = math.pi * (0.05**2 - 0.03905**2)
SECOND = math.pi / 4 * (0.05**4 - 0.03905**4)
NODES = {"a": (0.0, 0.0, 0.0), "b": (1.0, 0.0, 1.0), "c": (0.0, 2.0, 0.0), "d": (2.0, 2.0, 0.0)}


def pair(sections: tuple[Section | None, Section | None] = (PIPE, PIPE), strengths: Any = (100.0, 50.0)) -> Structure:
    rods = (Rod("short", ("a", "b"), 1.0, section=sections[0]), Rod("long", ("c", "d"), 1.0, section=sections[1]))
    cords = (String("s", ("a", "c"), 10.0, strength=strengths[0]), String("t", ("b", "d"), 10.0, strength=strengths[1]))
    return Structure("pair", NODES, rods, cords)


def checked(rod_forces: Any, tensions: Any, structure: Structure | None = None, **options: Any) -> Any:
    structure = pair() if structure is None else structure
    return check_members(structure, structure.positions, rod_forces, tensions, **options)


# One state ------------------------------------------------------------------------------------------------


def test_every_number_of_two_pipes() -> None:
    """Stress N/A, yield load σ_y A, Euler load π² E I / ℓ² at ℓ = √2 m and 2 m, and the ratios."""
    check = checked([-3e5, 4e5], [30.0, 0.0])
    loads = check.loads
    euler = math.pi**2 * 210e9 * SECOND / np.array([2.0, 4.0])
    # The areas and second moments here come from differences of powers, which cancel some digits: 1e-12 is left.
    assert loads.stresses[0] == pytest.approx(np.array([-3e5, 4e5]) / AREA, rel=1e-12)
    assert loads.yield_loads == pytest.approx([200e6 * AREA] * 2, rel=1e-12)
    assert loads.euler_loads[0] == pytest.approx(euler, rel=1e-12)
    assert loads.euler_loads[0, 0] == pytest.approx(3189e3, rel=2e-3)  # Table C.1
    assert loads.yielding[0] == pytest.approx(np.array([3e5, 4e5]) / (200e6 * AREA), rel=1e-12)
    assert loads.buckling[0] == pytest.approx([3e5 / euler[0], math.nan], rel=1e-12, nan_ok=True)
    assert loads.breaking[0] == pytest.approx([0.3, 0.0], rel=1e-15)
    assert check.slack == ("t",)
    assert check.ok
    assert (check.worst.member, check.worst.criterion) == ("long", Criterion.YIELD)
    assert check.worst.utilisation == pytest.approx(4e5 / (200e6 * AREA), rel=1e-12)
    assert [use.utilisation for use in check.uses] == sorted((use.utilisation for use in check.uses), reverse=True)
    # Two criteria of the rod in compression, one of that in tension and of each string.
    assert sorted((use.member, use.criterion.value) for use in check.uses) == [
        ("long", "yield"),
        ("s", "strength"),
        ("short", "buckling"),
        ("short", "yield"),
        ("t", "strength"),
    ]


def test_rods_are_as_long_as_they_are() -> None:
    structure = pair()
    twice = check_members(structure, 2 * structure.positions, [-1.0, -1.0], [1.0, 1.0])
    assert twice.loads.euler_loads == pytest.approx(checked([-1.0, -1.0], [1.0, 1.0]).loads.euler_loads / 4, rel=1e-14)


@pytest.mark.parametrize(
    ("rods", "tensions", "member", "criterion"),
    [
        ([-1.01 * 200e6 * AREA, 0.0], [0.0, 0.0], "short", Criterion.YIELD),
        ([0.0, 1.01 * 200e6 * AREA], [0.0, 0.0], "long", Criterion.YIELD),
        ([0.0, 0.0], [0.0, 50.5], "t", Criterion.STRENGTH),
    ],
)
def test_who_is_beyond_a_limit(rods: Any, tensions: Any, member: str, criterion: Criterion) -> None:
    check = checked(rods, tensions)
    assert not check.ok
    assert [(use.member, use.criterion) for use in check.violations] == [(member, criterion)]
    assert check.worst.utilisation == pytest.approx(1.01, rel=1e-12)
    lines = check.describe()
    assert lines[0] == "not ok: 1 member is beyond a limit"
    assert f"'{member}' is at 101 % of its {criterion.value} limit" in lines[1]


def test_a_slender_rod_buckles_before_it_yields() -> None:
    """A solid bar of radius r yields at σ π r² and buckles at π³ E r⁴ / (4 ℓ²): here at 0.11 of that."""
    bar = Section.solid(0.005, 210e9, 200e6)
    limit = math.pi**3 * 210e9 * 0.005**4 / (4 * 2.0**2)
    assert limit < 0.2 * 200e6 * math.pi * 0.005**2
    check = checked([0.0, -1.02 * limit], [1.0, 1.0], pair((bar, bar)))
    assert [(use.member, use.criterion) for use in check.violations] == [("long", Criterion.BUCKLING)]
    assert check.worst.limit == pytest.approx(limit, rel=1e-14)
    assert checked([0.0, 1.02 * limit], [1.0, 1.0], pair((bar, bar))).ok  # tension buckles nothing


@pytest.mark.parametrize(
    ("sections", "strengths", "unchecked"),
    [
        ((None, PIPE), (1.0, 1.0), ("rod 'short' (yield, buckling)",)),
        ((PIPE, replace(PIPE, yield_stress=None)), (1.0, 1.0), ("rod 'long' (yield)",)),
        ((PIPE, PIPE), (None, 1.0), ("string 's' (strength)",)),
        ((None, None), (None, None), ("short", "long", "'s'", "'t'")),
    ],
)
def test_what_has_no_limit_is_unchecked_and_not_ok(sections: Any, strengths: Any, unchecked: tuple[str, ...]) -> None:
    check = checked([-1.0, -1.0], [0.1, 0.1], pair(sections, strengths))
    assert len(check.unchecked) == len(unchecked)
    for words, line in zip(unchecked, check.unchecked, strict=True):
        assert words in line
        assert line in "\n".join(check.describe())
    assert not check.violations
    assert not check.ok
    nothing = strengths == (None, None)
    assert (check.worst is None) == nothing
    head = "no limit is exceeded, as far as limits are known"
    if nothing:
        head = "nothing can be checked: no rod has a section, and no string a strength"
    assert check.describe()[0] == head


def test_slack_below_a_tension() -> None:
    assert checked([0.0, 0.0], [1e-9, 1.0]).slack == ()
    assert checked([0.0, 0.0], [1e-9, 1.0], slack_below=1e-8).slack == ("s",)
    assert "1 slack: 's'" in checked([0.0, 0.0], [1e-9, 1.0], slack_below=1e-8).describe()


def test_a_rod_in_tension_does_not_buckle() -> None:
    """Whatever its force: Euler's load is no limit of it, and nothing says that some part of it is used."""
    slender = Section(1e-4, 1e-9, 210e9)  # no yield stress
    limit = math.pi**2 * 210e9 * 1e-9 / 2.0
    structure = pair((slender, slender), (None, None))
    pulled = checked([35478.0, 0.5 * limit], [0.0, 0.0], structure)
    assert pulled.uses == ()
    assert pulled.worst is None
    assert not pulled.ok
    assert (
        pulled.describe()[0] == "no rod with a section is in compression, so that none buckles; no other limit is known"
    )
    assert not any("%" in line for line in pulled.describe())
    assert pulled.to_dict()["rods"]["short"]["buckling"] is None
    pushed = checked([35478.0, -0.25 * limit], [0.0, 0.0], structure)
    (use,) = pushed.uses
    assert (use.member, use.criterion, use.utilisation) == ("long", Criterion.BUCKLING, pytest.approx(0.5, rel=1e-12))
    # Both over time: in compression once, it counts as far as it was.
    both = MemberLoads(
        structure, np.array([[-0.1 * limit, 1.0], [35478.0, 2.0]]), np.full((2, 2), math.sqrt(2)), np.zeros((2, 2))
    )
    assert [(one.member, one.utilisation) for one in both.largest()] == [("short", pytest.approx(0.1, rel=1e-12))]


def test_plain_values() -> None:
    plain = checked([-1e5, 2.0], [3.0, 4.0], pair((PIPE, None), (None, 5.0))).to_dict()
    assert to_json(plain)
    assert plain["rods"]["long"] == {
        "force": 2.0,
        "determined": True,
        "stress": None,
        "yield_load": None,
        "euler_load": None,
        "yielding": None,
        "buckling": None,
    }
    assert plain["strings"]["t"] == {"tension": 4.0, "strength": 5.0, "breaking": 0.8}
    assert plain["worst"]["member"] == "t"
    assert plain["worst"]["criterion"] == "strength"
    assert plain["ok"] is False


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (([0.0], [0.0, 0.0]), "rod_forces"),
        (([0.0, math.nan], [0.0, 0.0]), "rod_forces"),
        (([0.0, 0.0], [0.0, 0.0, 0.0]), "tensions"),
        (([0.0, 0.0], None), "tensions"),
    ],
)
def test_wrong_arrays_are_refused(arguments: Any, words: str) -> None:
    with pytest.raises(OptionError, match=words):
        checked(*arguments)


def test_other_wrong_arguments_are_refused() -> None:
    structure = pair()
    with pytest.raises(OptionError, match="ends of rod 'short' coincide"):
        check_members(structure, np.zeros((4, 3)) + np.arange(4)[:, None] // 2, [0.0, 0.0], [0.0, 0.0])
    with pytest.raises(OptionError, match="structure"):
        check_members(None, np.zeros((4, 3)), [0.0, 0.0], [0.0, 0.0])  # type: ignore[arg-type]
    with pytest.raises(OptionError, match="must be a Trajectory"):
        check_trajectory(structure)  # type: ignore[arg-type]


def test_a_state_of_equilibrium() -> None:
    """A prestressed prism: its members' forces by Newton's method are those of the linear equations of prestress."""
    height, radius = 0.8, 0.6 / (2 * math.sin(math.radians(75)))
    angles = np.radians([0, 120, 240])
    nodes = [[radius * math.cos(a), radius * math.sin(a), 0.0] for a in angles]
    nodes += [[radius * math.cos(a + math.pi / 6), radius * math.sin(a + math.pi / 6), height] for a in angles]
    cords = [(0, 1), (1, 2), (2, 0), (3, 4), (4, 5), (5, 3), (0, 3), (1, 4), (2, 5)]
    prism = Structure.from_arrays(nodes, [(0, 4), (1, 5), (2, 3)], cords, rod_mass=1.0, stiffness=100.0)
    prism = prism.with_strings(force_density=prestress(prism, 2.0), strength=1.9)
    prism = prism.with_sections(Section.solid(0.001, 7e10, 1e8))
    check = check_state(find_equilibrium(Scene(prism)))
    u = prism.stiffness * (1 - prism.rest_lengths / prism.string_lengths(prism.positions))
    # Newton stops at forces of round-off, some 1e-13 N of the 2 N here over the softest stiffness of the prism.
    assert check.loads.tensions[0] == pytest.approx(u * prism.string_lengths(prism.positions), rel=1e-8)
    forces = static_forces(prism, u).rod_force_densities * prism.rod_lengths
    assert check.loads.rod_forces[0] == pytest.approx(forces, rel=1e-8)
    euler = math.pi**3 * 7e10 * 0.001**4 / 4 / prism.rod_lengths**2
    assert check.loads.buckling[0] == pytest.approx(-forces / euler, rel=1e-8)


# Runs -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("engine", [tmj.DAE(), tmj.MuJoCo(1e-3)], ids=["dae", "mujoco"])
def test_the_force_of_a_spinning_rod_is_its_mean(engine: Any) -> None:
    """Pinned at an end, N(x) = m ω² (ℓ² - x²) / (2ℓ): its mean over the rod, m ω² ℓ / 3, is what engines record."""
    mass, rate, length = 2.0, 5.0, 1.5
    mean = quad(lambda x: mass * rate**2 * (length**2 - x**2) / (2 * length), 0, length)[0] / length
    rod = Rod("rod", ("o", "tip"), mass, support=Support.pinned(), section=Section.solid(1e-3, 7e10, 4 * mean / 1e-6))
    structure = Structure("spin", {"o": (0.0, 0.0, 0.0), "tip": (length, 0.0, 0.0)}, (rod,))
    start = np.array([[0.0, 0.0, 0.0], [0.0, rate * length, 0.0]])
    run = tmj.simulate(Scene(structure, duration=0.2, initial_velocities=start), engine=engine)
    check = check_trajectory(run)
    # Both engines keep a free spin to 1e-8 over a third of a turn.
    assert check.loads.rod_forces == pytest.approx(np.full((len(run.time), 1), mean), rel=1e-6)
    assert check.worst is not None
    assert check.worst.utilisation == pytest.approx(mean / (4 * mean * math.pi), rel=1e-6)  # σ_y A, A = π 1e-6
    assert check.ok


def made_run() -> Trajectory:
    """A run of 11 samples, 0.1 s apart, of a rod of 1 m and three strings, with forces of our own."""
    run = cone_run().until(11)
    structure = run.scene.structure.with_sections(Section.solid(0.01, 1e9, 1e6)).with_strings(strength=[2.0, 3.0, 4.0])
    time = np.arange(11) / 10
    tensions = np.ones((11, 3))
    tensions[:4, 0] = 0.0
    tensions[6:8, 0] = -0.1
    tensions[9:, 1] = 0.0
    tensions[5, 2], tensions[7, 2], tensions[8, 1] = 4.4, 4.8, 3.9
    forces = np.zeros((11, 1))
    forces[6] = -9.0
    return replace(
        run,
        scene=run.scene.with_(structure=structure, breaks=(Break("s1", 1.0),)),
        time=time,
        tensions=tensions,
        rod_force_densities=forces,
        nodes=run.nodes[:11],
    )


def test_who_and_when() -> None:
    check = check_trajectory(made_run())
    assert check.worst is not None
    assert check.first_violation is not None
    assert (check.worst.member, check.worst.time, check.worst.force) == ("s1", 0.8, 3.9)  # 130 %
    assert check.worst.utilisation == pytest.approx(1.3, rel=1e-14)
    assert (check.first_violation.member, check.first_violation.time) == ("s2", 0.5)
    assert check.first_violation.utilisation == pytest.approx(1.1, rel=1e-14)
    assert [(use.member, use.time) for use in check.violations] == [("s1", 0.8), ("s2", 0.7)]
    # The break of s1 at 1.0 s ends what counts as slack of it.
    assert check.slack == (
        SlackInterval("s0", 0.0, 0.3),
        SlackInterval("s0", 0.6, 0.7),
        SlackInterval("s1", 0.9, 0.9),
    )
    buckling = next(use for use in check.uses if use.criterion is Criterion.BUCKLING)
    assert buckling.time == 0.6
    assert buckling.force == pytest.approx(-9.0, rel=1e-12)  # -9 N/m over 1 m, to the round-off of the motion's nodes
    assert buckling.limit == pytest.approx(math.pi**3 * 1e9 * 0.01**4 / 4, rel=1e-12)
    text = "\n".join(check.describe())
    assert "the first beyond its limit: string 's2' is at 110 % of its strength limit at t = 0.5 s" in text
    assert "2 slack at some time: 's0', 's1'; first 's0' from 0 s to 0.3 s" in text
    assert not check.ok
    assert to_json(check.to_dict())


def test_a_run_that_bears_everything() -> None:
    run = made_run()
    strong = run.scene.structure.with_strings(strength=10.0)
    check = check_trajectory(replace(run, scene=run.scene.with_(structure=strong)))
    assert check.ok
    assert check.first_violation is None
    assert check.describe()[0] == "ok: every member was checked, and none is beyond a limit"
    bare = check_trajectory(replace(run, scene=run.scene.with_(structure=strong.with_sections(None))))
    assert not bare.ok
    assert bare.unchecked == ("rod 'rod' (yield, buckling)",)


def test_a_diverged_run_is_checked_as_far_as_it_is_finite() -> None:
    run = made_run()
    tensions = run.tensions.copy()
    tensions[6:] = np.nan
    check = check_trajectory(replace(run, tensions=tensions))
    assert len(check.loads.rod_forces) == 6
    assert check.worst is not None
    assert (check.worst.member, check.worst.time) == ("s2", 0.5)
    with pytest.raises(OptionError, match="no finite samples"):
        check_trajectory(replace(run, tensions=np.full_like(tensions, np.nan)))
