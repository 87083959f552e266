"""Sweeps: parameters by name, draws, what is kept of each run, the page, and the command."""

from __future__ import annotations

import dataclasses
import functools
import hashlib
import json
import math
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import study_tasks
from killed_studies import kill_and_resume, records, result

import tensegrity_mj as tmj
from tensegrity_mj import controllers
from tensegrity_mj.cli import main
from tensegrity_mj.commands.sweep import split, value_of, values_of
from tensegrity_mj.engines.table import engine_settings
from tensegrity_mj.errors import OptionError
from tensegrity_mj.studies import store
from tensegrity_mj.studies.many import run_many
from tensegrity_mj.studies.page import judgement_of
from tensegrity_mj.studies.parameter_values import (
    Choice,
    Draw,
    LogUniform,
    Normal,
    Scaled,
    Together,
    Uniform,
    Vary,
    decoded,
    encoded,
)
from tensegrity_mj.studies.parameters import Draft, NominalWinches
from tensegrity_mj.studies.plain import canonical
from tensegrity_mj.studies.sweep import MEASURES, Sweep, counts, drafted, rows_of
from tensegrity_mj.studies.workers import Backend, Workers

HERE = Workers(backend=Backend.THIS_PROCESS)
SHORT = {"scene.duration": 0.2}


@functools.cache
def loaded() -> tmj.Scene:
    """The pinned rod with a load, gravity and damped strings, so that there is something of everything to change."""
    scene = tmj.load_scene("pinned_rod")
    structure = scene.structure.with_strings(damping=0.1)
    return scene.with_(
        structure=structure, gravity=(0.0, 0.5, -1.0), loads=(tmj.model.Load("n1", (0.1, 0.0, 0.0), 2.0, 0.5),)
    )


def draft_of(scene: tmj.Scene, **settings: Any) -> Any:
    return drafted(Sweep(scene).common()).apply({path: encoded(value) for path, value in settings.items()})


def string(scene: tmj.Scene, name: str) -> tmj.String:
    return next(one for one in scene.structure.strings if one.name == name)


# Every kind of parameter: path, value, what must come of it; with `Scaled` where that means something.
CHANGES: list[tuple[str, Any, Callable[[Any], Any], Any]] = [
    ("scene.gravity", [0, 0, -9.81], lambda d: d.scene.gravity, (0.0, 0.0, -9.81)),
    ("scene.gravity", Scaled(2), lambda d: d.scene.gravity, (0.0, 1.0, -2.0)),
    ("scene.gravity.z", -9.81, lambda d: d.scene.gravity, (0.0, 0.5, -9.81)),
    ("scene.gravity.y", Scaled(3), lambda d: d.scene.gravity, (0.0, 1.5, -1.0)),
    ("scene.duration", 3, lambda d: d.scene.duration, 3.0),
    ("scene.duration", Scaled(0.5), lambda d: d.scene.duration, 30.0),
    ("scene.initial_nodes[n1]", [0, 0.6, 0.8], lambda d: d.scene.nodes0[1].tolist(), [0, 0.6, 0.8]),
    ("scene.initial_velocities[n1].x", 0.0, lambda d: d.scene.velocities0[1].tolist(), [0, 0, 0]),
    ("scene.loads.force", [1, 2, 3], lambda d: d.scene.loads[0].force, (1.0, 2.0, 3.0)),
    ("scene.loads[n1].force.x", Scaled(10), lambda d: d.scene.loads[0].force, (1.0, 0.0, 0.0)),
    ("scene.loads.angular_frequency", Scaled(2), lambda d: d.scene.loads[0].angular_frequency, 4.0),
    ("scene.loads.phase", 0.1, lambda d: d.scene.loads[0].phase, 0.1),
    ("structure.rods.mass", 2, lambda d: d.scene.structure.rods[0].mass, 2.0),
    ("structure.rods[rod].mass", Scaled(0.8), lambda d: d.scene.structure.rods[0].mass, 0.8),
    ("structure.rods.radius", 0.03, lambda d: d.scene.structure.rods[0].radius, 0.03),
    ("structure.strings.stiffness", Scaled(1.2), lambda d: d.scene.structure.stiffness.tolist(), [1.2] * 3),
    ("structure.strings[s2].stiffness", 5, lambda d: d.scene.structure.stiffness.tolist(), [1, 5, 1]),
    ("structure.strings[s1,s3].stiffness", 5, lambda d: d.scene.structure.stiffness.tolist(), [5, 1, 5]),
    ("structure.strings[s1].damping", Scaled(3), lambda d: string(d.scene, "s1").damping, pytest.approx(0.3)),
    ("structure.strings[s1].max_force_density", 4, lambda d: string(d.scene, "s1").max_force_density, 4.0),
    ("structure.string_law", "unclipped", lambda d: d.scene.structure.string_law, tmj.model.StringLaw.UNCLIPPED),
    ("structure.nodes[n2].x", 1.3, lambda d: d.scene.structure.nodes["n2"], (1.3, 0.0, 0.0)),
    ("structure.nodes[n2].x", 1.3, lambda d: d.scene.target.nodes[0, 2].tolist(), [1.3, 0.0, 0.0]),
    ("scene.target[n1]", [0, 0.6, 0.8], lambda d: d.scene.target.nodes[0, 1].tolist(), [0, 0.6, 0.8]),
    ("scene.breaks[s2].time", 1.5, lambda d: d.scene.breaks, (tmj.model.Break("s2", 1.5),)),
    ("law", "none", lambda d: d.make_law(), None),
    ("law.decay_rate", 0.7, lambda d: d.make_law().decay_rate, 0.7),
    ("law.decay_rate", Scaled(2), lambda d: d.make_law().decay_rate, 0.3),
    ("law.norm", "inf", lambda d: d.make_law().norm, math.inf),
    ("law.rotation", {"X": 2, "Y": 1, "Z": 3}, lambda d: d.make_law().rotation, controllers.Gains(2, 1, 3)),
    ("engine", "dae", lambda d: d.make_engine(), tmj.DAE()),
    ("engine.timestep", 2e-3, lambda d: d.make_engine(), tmj.MuJoCo(timestep=2e-3)),
    ("engine.timestep", Scaled(2), lambda d: d.make_engine(), tmj.MuJoCo(timestep=2e-3)),
    (
        "engine.integrator",
        "implicitfast",
        lambda d: d.make_engine(),
        tmj.MuJoCo(integrator=tmj.Integrator.IMPLICITFAST),
    ),
    ("on_infeasible", "passive", lambda d: d.on_infeasible, tmj.OnInfeasible.PASSIVE),
    ("output_interval", 0.05, lambda d: d.output_interval, 0.05),
]


@pytest.mark.parametrize(("path", "value", "read", "expected"), CHANGES, ids=[f"{c[0]}={c[1]}" for c in CHANGES])
def test_a_parameter_changes_what_it_names(path: str, value: Any, read: Any, expected: Any) -> None:
    before = draft_of(loaded())
    draft = draft_of(loaded(), **{path: value})
    assert read(draft) == expected
    if path != "scene.initial_velocities[n1].x":  # which was 0
        assert read(before) != expected


@pytest.mark.parametrize(("path", "value"), [(c[0], c[1]) for c in CHANGES if c[0].startswith(("structure", "scene"))])
def test_plant_changes_what_is_simulated_and_not_what_the_law_knows(path: str, value: Any) -> None:
    draft = draft_of(loaded(), **{f"plant.{path.partition('.')[2]}": value})
    changed = draft_of(loaded(), **{path: value})
    assert draft.scene == loaded()
    assert draft.plant == changed.scene


def test_rows_of_numbers_of_members_are_changed_too() -> None:
    wall, vertebra = "structure.constraints[wall].direction", "structure.bodies[vertebra2].inertia"
    for scene, path, value, expected in (
        ("ladder", wall, [2, 0, 0], (2.0, 0.0, 0.0)),
        ("ladder", f"{wall}.x", Scaled(3), (3.0, 0.0, 0.0)),
        ("spine", vertebra, [1e-3, 2e-3, 2e-3], (1e-3, 2e-3, 2e-3)),
        ("spine", "structure.bodies.inertia", Scaled(2), pytest.approx((7.65e-4, 7.65e-4, 5.1e-4))),
        ("spine", f"{vertebra}.z", 4e-4, pytest.approx((3.825e-4, 3.825e-4, 4e-4))),
        ("spine", "structure.bodies[vertebra2].center", [0, 0, 0.21], (0.0, 0.0, 0.21)),
    ):
        structure = Draft(tmj.load_scene(scene)).apply({path: value}).scene.structure
        member = {one.name: one for one in (*structure.constraints, *structure.bodies)}
        assert getattr(member["wall" if scene == "ladder" else "vertebra2"], path.split(".")[2]) == expected
    for path, value, words in (
        (vertebra, [1.0, 2.0], "a list of three numbers"),
        (f"{vertebra}.w", 1.0, "no component 'w'"),
        ("structure.bodies[vertebra2].center.z", 0.1, "it has no value of which this could be a part; give all of it"),
        ("structure.bodies[vertebra2].center", Scaled(2), "it has no value of which"),
    ):
        with pytest.raises(OptionError, match=words):
            Draft(tmj.load_scene("spine")).apply({path: value})


def test_together_they_apply_in_a_fixed_order() -> None:
    settings = {"plant.rods.mass": Scaled(3), "engine.rtol": 1e-8, "structure.rods.mass": 2, "engine": "dae"}
    settings |= {"actuation.period": 0.01, "actuation": "hold-rest-length"}
    for order in (settings, dict(reversed(settings.items()))):
        draft = draft_of(loaded(), **order)
        assert draft.scene.structure.rods[0].mass == 2
        assert draft.plant.structure.rods[0].mass == 6
        assert draft.make_engine() == tmj.DAE(rtol=1e-8)
        assert tmj.Actuation(draft.actuation, draft.period) == tmj.Actuation.hold_rest_length(0.01)


def test_names_of_members_may_hold_dots_commas_and_brackets() -> None:
    prism = tmj.load_scene("prism").structure
    first, second, *others = prism.strings
    named = dataclasses.replace(first, name="s.1,a[x]"), dataclasses.replace(second, name="s 2")
    scene = tmj.Scene(dataclasses.replace(prism, strings=(*named, *others)))
    changed = draft_of(scene, **{"plant.strings[s.1,a[x]].stiffness": 7.0, "structure.strings[s 2, s3].stiffness": 6.0})
    assert [string.stiffness for string in changed.plant.structure.strings[:4]] == [7.0, 6.0, 6.0, first.stiffness]


def test_what_is_set_of_a_part_wins_over_what_is_set_of_the_whole() -> None:
    prism = tmj.load_scene("prism")
    settings = {"scene.gravity.z": -3.0, "scene.gravity": [1, 2, 0], "structure.strings[s1].stiffness": 7.0}
    settings |= {"structure.strings[s1,s2].stiffness": 6.0, "structure.strings.stiffness": 5.0}
    for order in (settings, dict(reversed(settings.items()))):
        scene = draft_of(prism, **order).scene
        assert scene.gravity == (1.0, 2.0, -3.0)
        assert [string.stiffness for string in scene.structure.strings[:4]] == [7.0, 6.0, 5.0, 5.0]


def test_equal_settings_give_equal_experiments_in_any_order() -> None:
    # A scaled tension depends on the stiffness of a string that has a rest length; the point's key does not have the
    # order of its settings, so the result must not depend on it.
    settings = {"structure.strings.tension": Scaled(1.5), "structure.strings.stiffness": Scaled(2.0)}
    settings["structure.strings.rest_length"] = Scaled(0.9)
    made = [draft_of(loaded(), **order).scene for order in (settings, dict(reversed(settings.items())))]
    assert made[0] == made[1]


def test_scaling_tension_rest_length_and_force_density_of_a_string() -> None:
    # s1 of the prism has u = 0.05 N/m and k = 2 N/m, so T = u L and L0 = L (1 - u/k).
    scene = tmj.load_scene("prism")
    length = float(scene.structure.string_lengths(scene.structure.positions)[0])
    for name, now in (("force_density", 0.05), ("tension", 0.05 * length), ("rest_length", length * (1 - 0.025))):
        one = string(draft_of(scene, **{f"structure.strings[s1].{name}": Scaled(0.9)}).scene, "s1")
        assert getattr(one, name) == pytest.approx(0.9 * now, rel=1e-14)
        assert [getattr(one, other) for other in ("force_density", "tension", "rest_length")].count(None) == 2


@pytest.mark.parametrize(
    ("path", "value", "said"),
    [
        ("foo", 1, "no kind of parameter 'foo'; allowed: family, structure, scene"),
        ("structur.rods.mass", 1, "did you mean 'structure'"),
        ("structure", 1, "name a part of it, such as structure.rods.mass"),
        ("structure.rod.mass", 1, "did you mean 'rods'"),
        ("structure.rods[rood].mass", 1, r"no rod 'rood' \(did you mean 'rod'\?\); allowed: rod"),
        ("structure.rods[rod].masss", 1, "no number of a rod 'masss'.*allowed: mass, radius"),
        ("structure.rods", 1, "no number of a rod ''"),
        ("structure.rods[rod", 1, "it is no parameter"),
        ("structure..mass", 1, "it is no parameter"),
        ("structure.point_masses.mass", 1, "has no point mass"),
        ("structure.rods.mass", "heavy", "'heavy'; it must be a finite number"),
        ("structure.strings.max_force_density", Scaled(2), "it has no value that could be scaled"),
        ("structure.string_law", "elastic", "allowed: clipped, unclipped"),
        ("structure.string_law.x", "clipped", "it has no parts 'x'"),
        ("structure.nodes.x", 1, "name a node in brackets: O, n1"),
        ("structure.nodes[n9].x", 1, "no node 'n9'"),
        ("structure.nodes[n1].w", 1, "no component 'w'.*allowed: x, y, z"),
        ("scene.gravty", 1, "did you mean 'gravity'"),
        ("scene.gravity", 9, "a list of three numbers, or add .x, .y or .z"),
        ("scene.gravity", [1, 2], "a list of three numbers"),
        ("scene.duration.x", 1, "it has no parts 'x'"),
        ("scene.loads[n2].force", [1, 0, 0], "no member of loads 'n2'; allowed: n1"),
        ("scene.breaks.time", 1, r"write breaks\[STRING\].time, with a string of s1"),
        ("scene.breaks[s7].time", 1, "no string 's7'"),
        ("scene.breaks[s1].time", Scaled(2), "no value that could be scaled"),
        ("scene.target.x", 1, "name a node in brackets"),
        (
            "scene.loads.strength",
            1,
            "no part of a member of loads 'strength'; allowed: force, angular_frequency, phase",
        ),
        ("plant", 1, "such as plant.rods.mass"),
        ("plant.rods.masss", 1, "no number of a rod 'masss'"),
        ("law", "lyapunow", "did you mean 'lyapunov'"),
        ("law.decayrate", 1, "no option of a law 'decayrate' .did you mean 'decay_rate'"),
        ("engine", "mujocco", "did you mean 'mujoco'"),
        ("engine.tolerance", 1, "no option of an engine 'tolerance'"),
        ("engine.rtol", 1e-8, "no option of engine mujoco 'rtol'"),
        ("engine.integrator", "rk5", "allowed: euler"),
        ("engine.timestep", -1, "timestep = -1"),
        ("actuation", "hold", "allowed: continuous, hold force density, hold rest length"),
        ("actuation", "hold-rest-length", "control period = None"),
        ("actuation.phase", 1, "no part of actuation 'phase'"),
        ("actuation.period", 0.1, "the continuous mode has none"),
        ("on_infeasible", "go on", "allowed: stop, passive"),
        ("on_infeasible.x", 1, "has no parts"),
        ("output_interval", Scaled(2), "no value that could be scaled"),
        ("structure.rods.mass", "*heavy", "after . there must be a number"),
    ],
)
def test_what_names_nothing_is_refused_before_anything_runs(path: str, value: Any, said: str) -> None:
    with pytest.raises(OptionError, match=said):
        Sweep(loaded(), [Vary(path, [value])])
    with pytest.raises(OptionError, match=said):
        Sweep(loaded(), fixed={path: value})


def test_scenes_without_loads_have_no_loads_to_change() -> None:
    with pytest.raises(OptionError, match="has no loads"):
        Sweep("pinned_rod", [Vary("scene.loads.force.x", [1])])


# The grid and the draws -----------------------------------------------------------------------------------------


def test_the_grid_is_every_combination_the_last_axis_fastest() -> None:
    a, b, c, d = "scene.duration", "law.decay_rate", "structure.rods.mass", "law.respect_limits"
    axes = [Vary(a, [1, 2]), Together([Vary(b, [3, 4]), Vary(c, [Scaled(0.5), 0.7])])]
    assert list(Sweep("pinned_rod", axes, fixed={d: True}).points()) == [
        {d: True, a: 1, b: 3, c: "*0.5"},
        {d: True, a: 1, b: 4, c: 0.7},
        {d: True, a: 2, b: 3, c: "*0.5"},
        {d: True, a: 2, b: 4, c: 0.7},
    ]


DRAWS = (
    Draw("law.decay_rate", Uniform(1, 2)),
    Draw("structure.rods.mass", Normal(0, 1), scaled=True),
    Draw("law.norm", Choice(["inf", 1])),
)


def test_a_draw_depends_on_the_seed_and_its_number_alone() -> None:
    v, drawn = "scene.duration", [draw.parameter for draw in DRAWS]
    points = list(Sweep("pinned_rod", [Vary(v, [1, 2])], DRAWS, samples=5, seed=7).points())
    assert [{**point, v: 0} for point in points[:5]] == [{**point, v: 0} for point in points[5:]]
    longer = list(Sweep("pinned_rod", draws=DRAWS, samples=9, seed=7).points())
    assert longer[:5] == [{key: point[key] for key in drawn} for point in points[:5]]
    assert len({json.dumps(point) for point in longer}) == 9
    assert next(Sweep("pinned_rod", draws=DRAWS, samples=9, seed=8).points()) != longer[0]
    # Drawn once, here, with numpy's documented generator: the numbers stay what they were.
    assert longer[0]["law.decay_rate"] == 1 + np.random.default_rng([7, 0]).uniform()


@pytest.mark.parametrize(
    ("distribution", "mean", "deviation", "bounds"),
    [
        (Uniform(2, 5), 3.5, 3 / math.sqrt(12), (2, 5)),
        (Normal(1, 0.5), 1, 0.5, (-math.inf, math.inf)),
        # of the logarithm
        (LogUniform(0.01, 1), math.log(0.1), math.log(100) / math.sqrt(12), (0.01, 1)),
        (Choice([0.0, 1.0]), 0.5, 0.5, (0, 1)),
    ],
)
def test_distributions(distribution: Any, mean: float, deviation: float, bounds: tuple[float, float]) -> None:
    generator = np.random.default_rng(5)
    values = np.array([distribution.sample(generator) for _ in range(2000)])
    assert bounds[0] <= values.min()
    assert values.max() <= bounds[1]
    values = np.log(values) if isinstance(distribution, LogUniform) else values
    # Five standard errors of the mean; of the deviation, whose standard error is at most σ √(kurtosis/4n) < σ/50.
    assert abs(values.mean() - mean) < 5 * deviation / math.sqrt(2000)
    assert abs(values.std() / deviation - 1) < 0.1


def test_a_star_in_brackets_draws_for_each_member() -> None:
    sweep = Sweep("prism", draws=[Draw("plant.rods[*].mass", Uniform(0.8, 1.2), scaled=True)], samples=2, seed=1)
    assert sweep.parameters == [f"plant.rods[rod{n}].mass" for n in (1, 2, 3)]
    point = next(iter(sweep.points()))
    assert len(set(point.values())) == 3
    assert all(0.8 <= decoded(value).factor <= 1.2 for value in point.values())


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"axes": [Vary("law.decay_rate", [1]), Vary("law.decay_rate", [2])]}, "given twice"),
        ({"axes": [Vary("law.decay_rate", [1])], "fixed": {"law.decay_rate": 1}}, "given twice"),
        ({"axes": ["law.decay_rate"]}, "use Vary"),
        ({"axes": [Vary("structure.rods[*].mass", [1])]}, r"\[\*\] is for draws"),
        ({"draws": [Vary("law.decay_rate", [1])], "seed": 1}, "use Draw"),
        ({"draws": [Draw("law.decay_rate", Uniform(1, 2))]}, "needs a seed"),
        ({"draws": [Draw("law[*]", Uniform(1, 2))], "seed": 1}, "there is none"),
        ({"samples": 3}, "nothing is drawn"),
        ({"samples": 0}, "samples = 0"),
        ({"seed": -1}, "seed = -1"),
        ({"engine": tmj.MuJoCo}, "use one of MuJoCo, DAE, ODE, JAX, an object"),
        ({"law": lambda scene: None}, "at the top of its module"),
    ],
)
def test_sweeps_that_cannot_be_are_refused(options: dict[str, Any], said: str) -> None:
    with pytest.raises(OptionError, match=said):
        Sweep("pinned_rod", **options)


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (lambda: Vary("a", []), "at least one value"),
        (lambda: Vary("a", 1), "give a list"),
        (lambda: Vary("a", "text"), "give a list"),
        (lambda: Vary("", [1]), "it must be a text"),
        (lambda: Vary("a", [object()]), "plain value"),
        (lambda: Together([]), "give a list of Vary"),
        (lambda: Together([Vary("a", [1]), Vary("b", [1, 2])]), "as many values each .a: 1, b: 2"),
        (lambda: Uniform(2, 1), "low = 2 is above high = 1"),
        (lambda: LogUniform(0, 1), "low = 0.*must be > 0"),
        (lambda: Normal(0, 0), "deviation = 0"),
        (lambda: Choice([]), "at least one value"),
        (lambda: Draw("a", "uniform"), "use Uniform"),  # type: ignore[arg-type]
        (lambda: Scaled("2"), "factor = '2'"),  # type: ignore[arg-type]
        (lambda: Scaled(math.nan), "factor = nan"),
    ],
)
def test_axes_that_cannot_be_are_refused(make: Any, said: str) -> None:
    with pytest.raises(OptionError, match=said):
        make()


def test_engines_as_settings_and_back() -> None:
    for engine in (tmj.MuJoCo(), tmj.DAE(rtol=1e-9), tmj.DAE(method=tmj.Method.RK4, timestep=1e-3), tmj.ODE()):
        name, options = engine_settings(engine)
        draft = drafted({**Sweep("pinned_rod").common(), "engine": {"name": name, "options": options}})
        assert draft.make_engine() == engine


# What is simulated and kept -------------------------------------------------------------------------------------


def test_a_point_is_the_run_that_it_says(tmp_path: Path) -> None:
    sweep = Sweep(
        "prism",
        [Vary("law.decay_rate", [0.5, 2.0]), Vary("engine", ["mujoco", "dae"])],
        fixed={"scene.duration": 0.5, "structure.rods.mass": Scaled(1.5), "plant.gravity.z": -0.1},
        keep_trajectories=True,
    )
    study = sweep.run(tmp_path, workers=HERE)
    scene = tmj.load_scene("prism")
    from dataclasses import replace

    structure = replace(scene.structure, rods=tuple(replace(rod, mass=1.5) for rod in scene.structure.rods))
    known = scene.with_(structure=structure, duration=0.5)
    for number, (rate, engine) in enumerate(
        [(0.5, tmj.MuJoCo()), (0.5, tmj.DAE()), (2.0, tmj.MuJoCo()), (2.0, tmj.DAE())]
    ):
        law = controllers.from_scene(known, decay_rate=rate)
        run = tmj.simulate(known.with_(gravity=(0.0, 0.0, -0.1)), law, engine)
        path = study.file(number, "trajectory.nc")
        assert path is not None
        kept, values = tmj.Trajectory.load(path), study.outcomes[number]["values"]
        assert np.array_equal(kept.nodes, run.nodes)  # the very same run, to the last bit
        assert np.array_equal(kept.force_densities, run.force_densities)
        # The measures again, from the arrays of the file.
        error = np.linalg.norm(kept.nodes[-1] - scene.target.nodes[-1], axis=1).max()  # type: ignore[union-attr]
        assert values["final_error"] == pytest.approx(error, rel=1e-12)
        assert values["max_force_density"] == kept.force_densities.max()
        assert values["max_tension"] == kept.tensions.max()
        assert values["max_compression"] == -kept.rod_force_densities.min()
        assert values["min_margin"] == kept.feasibility_margin.min()
        assert kept.feasibility_margin[kept.time == values["min_margin_time"]] == values["min_margin"]
        assert values["energy_residual"] == np.abs(kept.energy_balance).max()
        assert values["final_lyapunov"] == kept.lyapunov[-1]
        assert values["end_time"] == 0.5
        assert values["steps"] == kept.cost["steps"]
        assert values["status"] == "completed"
        assert "gravity" in values["warnings"][0]
        assert set(values) == set(MEASURES)


def test_winches_that_believe_in_another_stiffness() -> None:
    """The plant's strings get the rest lengths L (1 - u/k̂) that the nominal stiffness k̂ gives, in every mode."""
    scene = tmj.load_scene("prism").with_(duration=0.3)
    factors = np.linspace(0.8, 1.2, 12)
    plant = scene.with_(structure=scene.structure.with_strings(stiffness=scene.structure.stiffness * factors))
    law = controllers.from_scene(scene)
    nominal = scene.structure

    class AsRestLengths:
        """The same by another way: a law that commands rest lengths."""

        command = tmj.Command.REST_LENGTH

        def __call__(self, time: float, nodes: Any, velocities: Any) -> Any:
            u = law(time, nodes, velocities)
            return nominal.string_lengths(nodes) * (1 - u / nominal.stiffness)

    wrapped = NominalWinches.between(law, nominal, plant.structure)
    for actuation in (
        tmj.Actuation.continuous(),
        tmj.Actuation.hold_force_density(0.01),
        tmj.Actuation.hold_rest_length(0.01),
    ):
        engine = tmj.MuJoCo(timestep=5e-3)
        run = tmj.simulate(plant, wrapped, engine, actuation=actuation)
        other = tmj.simulate(plant, AsRestLengths(), engine, actuation=actuation)
        # The two differ by round-off in u, about 1e-16 relative; 60 steps let it grow little.
        assert np.abs(run.nodes - other.nodes).max() < 1e-13
        assert np.isfinite(run.feasibility_margin).all()  # what the law reports still gets through
    # It makes a difference: without it, 20 % of stiffness would change nothing in the continuous mode.
    blind = tmj.simulate(plant, law, tmj.MuJoCo(timestep=5e-3))
    believing = tmj.simulate(plant, wrapped, tmj.MuJoCo(timestep=5e-3))
    assert np.abs(blind.nodes - believing.nodes).max() > 1e-5
    assert NominalWinches.between(law, nominal, nominal) is law
    u = law(0.0, scene.nodes0, scene.velocities0)
    assert np.allclose(wrapped(0.0, scene.nodes0, scene.velocities0), u * factors, rtol=1e-15, atol=0)
    assert wrapped.describe()["nominal_stiffness"] == nominal.stiffness.tolist()


def constant_law(scene: tmj.Scene, level: float = 0.1) -> Any:
    """A law of one's own."""
    return Constant(np.full(len(scene.structure.strings), level))


class Constant:
    """Constant force densities."""

    def __init__(self, u: Any) -> None:
        self.u = u

    def __call__(self, time: float, nodes: Any, velocities: Any) -> Any:
        return self.u


def test_a_law_of_ones_own_and_its_options() -> None:
    study = Sweep("pinned_rod", [Vary("law.level", [0.1, 0.3])], law=constant_law, fixed=SHORT).run(workers=HERE)
    assert study.values("max_force_density") == pytest.approx([0.1, 0.3], rel=1e-12)
    law = study.common["law"]
    assert (law["kind"], law["module"], law["name"]) == ("module", "test_sweep", "constant_law")
    assert law["sha256"] == hashlib.sha256(Path(__file__).read_bytes()).hexdigest()


def test_what_the_law_or_the_structure_refuses_is_data() -> None:
    axes = [Vary("law.decay_rate", [0.15, -1]), Vary("structure.rods.mass", [1, -1])]
    study = Sweep("pinned_rod", axes, fixed=SHORT).run(workers=HERE)
    reasons = [outcome.get("reason", "") for outcome in study.outcomes]
    assert study.failed == [1, 2, 3]
    assert "mass" in reasons[1]
    assert "decay_rate = -1" in reasons[2]
    assert not any("traceback" in outcome for outcome in study.outcomes)


def test_runs_that_diverge_or_stop_are_measured() -> None:
    # 0.2 s steps are beyond the stability limit of strings of 1e4 N/m on 1 kg.
    fixed = {"structure.strings.stiffness": 1e4, "law": "none", "engine.timestep": 0.2, "scene.duration": 40}
    fixed["structure.strings[s1].rest_length"] = 0.5
    study = Sweep("pinned_rod", fixed=fixed).run(workers=HERE)
    (row,) = rows_of(study)
    assert row.status == "diverged"
    assert row.reason
    assert row.values["end_time"] < 40
    # A rod in the plane of its strings' anchors cannot be lifted out of it (§5.4).
    fixed = {"scene.initial_nodes[n1]": [0, -1, 0], "scene.target[n1]": [0, 0, 1], "scene.duration": 2}
    (row,) = rows_of(Sweep("pinned_rod", fixed=fixed).run(workers=HERE))
    assert row.status == "infeasible"
    assert row.values["min_margin"] <= 0
    assert "margin" in row.reason


def test_trajectories_need_a_folder() -> None:
    with pytest.raises(OptionError, match="needs a folder"):
        Sweep("pinned_rod", keep_trajectories=True).run(workers=HERE)


def test_a_sweep_goes_on_only_with_the_same_sweep(tmp_path: Path) -> None:
    axes = [Vary("law.decay_rate", [0.1, 0.2])]
    first = Sweep("pinned_rod", axes, fixed=SHORT).run(tmp_path, workers=HERE)
    assert Sweep("pinned_rod", axes, fixed=SHORT).run(tmp_path, workers=HERE).computed == 0
    for other in (
        Sweep("pinned_rod", axes, fixed={"scene.duration": 0.3}),
        Sweep("pinned_rod", axes, fixed=SHORT, engine=tmj.DAE()),
        Sweep("prism", axes, fixed=SHORT),
    ):
        with pytest.raises(OptionError, match="another study"):
            other.run(tmp_path, workers=HERE)
    assert first.identity["versions"]["numpy"] == np.__version__


SIMULATIONS = """
from tensegrity_mj.studies.sweep import Sweep
from tensegrity_mj.studies.parameter_values import Vary
sweep = Sweep('pinned_rod', [Vary('law.decay_rate', list(range(1, 31)))], fixed={'scene.duration': 5})
points = [{'parameters': settings} for settings in sweep.points()]
run_many(study_tasks.simulated, points, folder, common=sweep.common(), workers=Workers(2))
"""


@pytest.mark.slow
@pytest.mark.study  # tests/studies/test_many.py kills a study of cheap points
def test_kill_9_of_simulations(tmp_path: Path) -> None:
    # The decay rate of a finished point, by its outcome: what the log calls it.
    sweep = Sweep("pinned_rod", [Vary("law.decay_rate", list(range(1, 31)))], fixed={"scene.duration": 5})
    points = [{"parameters": settings} for settings in sweep.points()]
    whole = run_many(study_tasks.simulated, points, tmp_path / "whole", common=sweep.common(), workers=HERE)
    names = {
        canonical(outcome): str(point["parameters"]["law.decay_rate"])
        for point, outcome in zip(whole.points, whole.outcomes, strict=True)
    }
    assert len(names) == 30
    folder = tmp_path / "study"
    hits = kill_and_resume(SIMULATIONS, folder, tmp_path, kills=1, seed=2, pause=0.1, name_of=names.__getitem__)
    assert hits >= 1
    assert result(folder) == result(tmp_path / "whole")
    assert set(Counter(key for key, _ in records(folder)).values()) == {1}


@pytest.mark.slow
@pytest.mark.study  # tests/studies/test_many.py has cheap points on a cluster
def test_simulations_on_a_cluster_give_the_same_result(tmp_path: Path) -> None:
    distributed = pytest.importorskip("distributed")
    sweep = Sweep(
        "prism",
        [Vary("engine", ["mujoco", "dae"]), Vary("law.decay_rate", [0.5, -1])],
        [Draw("plant.rods[*].mass", Uniform(0.8, 1.2), scaled=True)],
        seed=3,
        fixed={"scene.duration": 0.1},
    )
    sweep.run(tmp_path / "here", workers=HERE)
    with (
        distributed.LocalCluster(n_workers=1, threads_per_worker=2, dashboard_address=None) as cluster,
        distributed.Client(cluster) as client,
    ):
        sweep.run(tmp_path / "cluster", workers=Workers(backend=Backend.CLUSTER, client=client))
    assert result(tmp_path / "here") == result(tmp_path / "cluster")


# The page -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("axes", "draws", "pictures"),
    [
        ([Vary("law.decay_rate", [0.1, 0.2, 0.4])], [], 2),
        ([Vary("law.decay_rate", [0.1, 0.2]), Vary("structure.rods.mass", [Scaled(1), Scaled(500)])], [], 2),
        ([Vary("engine", ["mujoco", "dae"]), Vary("law.decay_rate", [0.1, 0.2])], [], 2),
        ([Vary("engine", ["mujoco", "dae"])], [], 0),
        ([], [Draw("plant.rods[*].mass", Uniform(0.8, 1.2), scaled=True)], 2),
        ([Vary("law.decay_rate", [0.1, -1])], [Draw("plant.gravity.z", Normal(0, 0.1))], 2),
    ],
    ids=["line", "map", "lines", "words", "dots", "samples"],
)
def test_the_page_holds_plots_and_every_point(axes: Any, draws: Any, pictures: int, tmp_path: Path) -> None:
    sweep = Sweep("pinned_rod", axes, draws, samples=3 if draws else 1, seed=1 if draws else None, fixed=SHORT)
    study = sweep.run(workers=HERE)
    page = tmj.studies.write_sweep_page(
        tmp_path / "page.html", sweep, study, ["final_error", "max_tension", "holding_ratio"]
    )
    text = page.read_text(encoding="utf-8")
    assert text.count("data:image/png;base64,") == pictures
    assert sum(text.count(f"<td>{one}</td>") for one in ("completed", "in doubt", "failed")) == len(study.points)
    assert "http://" not in text
    assert "https://" not in text
    assert "largest tension of a string" in text
    assert "No point has a value of: holding ratio" in text
    assert "<th>holding ratio" not in text
    assert "thesis" in text.lower() or "Tensegrity" in text
    with pytest.raises(OptionError, match="no measure 'speed'; allowed: status"):
        tmj.studies.write_sweep_page(tmp_path / "page.html", sweep, study, ["speed"])


# The command ----------------------------------------------------------------------------------------------------


def ask(capsys: pytest.CaptureFixture[str], *arguments: object) -> tuple[int, dict[str, Any], str]:
    code = main(["sweep", *map(str, arguments), "--json"])
    captured = capsys.readouterr()
    return code, json.loads(captured.out), captured.err


ALONE = ("--backend", "this-process", "--set", "scene.duration=0.2")


def test_the_command_writes_a_study_and_goes_on_with_it(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    arguments = ["pinned_rod", "--vary", "law.decay_rate=0.15,-1", "--zip", "structure.rods.mass=1,2"]
    arguments += ["structure.strings.stiffness=*1,*2", "--out", tmp_path / "out", *ALONE]
    code, answer, _ = ask(capsys, *arguments)
    assert code == 0  # every point was tried; that two failed is a result
    assert answer["ended"] == {"completed": 2, "failed": 2}
    assert answer["computed"] == 4
    assert answer["outcomes"] == json.loads((tmp_path / "out" / store.RESULT).read_text())["points"]
    assert "data:image/png" in (tmp_path / "out" / "index.html").read_text()
    before = result(tmp_path / "out")
    (tmp_path / "out" / store.RESULT).unlink()
    assert ask(capsys, *arguments)[1]["computed"] == 0
    assert result(tmp_path / "out") == before
    code, answer, _ = ask(capsys, *arguments, "--seed", 1, "--draw", "plant.gravity.z=uniform:0:1")
    assert code == 2
    assert "another study" in answer["error"]


def test_the_command_prints_a_table(capsys: pytest.CaptureFixture[str]) -> None:
    arguments = ["sweep", "pinned_rod", "--vary", "law.decay_rate=0.1,-1", *ALONE, "--measures", "end_time"]
    assert main(arguments) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines.pop(0) == "1 of 2 points of pinned_rod completed without a doubt; 1 failed."
    lines = lines[lines.index("") + 1 :]
    assert lines[0].split() == ["law.decay_rate", "status", "end", "time"]
    assert lines[1].split() == ["0", "0.1", "completed", "0.2"]
    assert lines[2].split() == ["1", "-1", "failed", "-"]
    assert "why not completed, or in doubt: OptionError: scene 'pinned_rod': decay_rate = -1" in lines[3]
    assert "1 completed, 1 failed" in "\n".join(lines)


def test_runs_that_warned_are_in_doubt() -> None:
    # Of a thousandth of the stiffness, commands are beyond it: rest lengths below zero, which a run warns of.
    sweep = Sweep("pinned_rod", [Vary("structure.strings.stiffness", [Scaled(1), Scaled(1e-3)])], fixed=SHORT)
    study = sweep.run(workers=HERE)
    sound, doubtful = rows_of(study)
    assert (sound.status, sound.values["doubts"]) == ("completed", [])
    assert doubtful.status == "in doubt"
    assert doubtful.values["status"] == "completed"
    assert "rest length of zero or less" in doubtful.reason
    assert counts([sound, doubtful]) == {"completed": 1, "in doubt": 1}
    found = judgement_of(sweep, study)
    assert found.verdict == "1 of 2 points of pinned_rod completed without a doubt; 1 in doubt."
    # How large a number is over a sweep is no judgement of it.
    assert found.findings[0].mark.value == "limited"
    assert {one.mark.value for one in found.findings[1:]} == {"not judged"}


def test_draws_of_the_command(capsys: pytest.CaptureFixture[str]) -> None:
    arguments = ["pinned_rod", "--draw", "plant.rods[*].mass=*uniform:0.8:1.2", "--draw", "law.norm=choice:2"]
    arguments += ["--draw", "law.decay_rate=loguniform:0.1:0.2", "--draw", "plant.gravity.z=normal:0:0.1"]
    _, answer, _ = ask(capsys, *arguments, "--samples", 3, "--seed", 5, *ALONE)
    points = [entry["point"]["parameters"] for entry in answer["outcomes"]]
    expected = Sweep(
        "pinned_rod",
        draws=[
            Draw("plant.rods[rod].mass", Uniform(0.8, 1.2), scaled=True),
            Draw("law.norm", Choice([2])),
            Draw("law.decay_rate", LogUniform(0.1, 0.2)),
            Draw("plant.gravity.z", Normal(0, 0.1)),
        ],
        samples=3,
        seed=5,
        fixed={"scene.duration": 0.2},
    )
    assert points == list(expected.points())
    assert answer["ended"] == {"completed": 3}


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ("--vary law.decayrate=1", "did you mean 'decay_rate'"),
        ("--vary law.decay_rate", "write PATH=VALUE"),
        ("--vary =1", "write PATH=VALUE"),
        ("--vary law.decay_rate=linear:1:2", "linear:FROM:TO:COUNT"),
        ("--vary law.decay_rate=linear:1:2:1", "count of at least 2"),
        ("--vary law.decay_rate=log:0:2:3", "must be > 0"),
        ("--vary law.decay_rate=log:a:2:3", "end = 'a'; it must be a finite number"),
        ("--draw law.decay_rate=gamma:1:2 --seed 1", "allowed after = are uniform"),
        ("--draw law.decay_rate=uniform:1 --seed 1", "allowed after = are uniform"),
        ("--draw law.decay_rate=uniform:1:x --seed 1", "number = 'x'; it must be a finite number"),
        ("--draw law.decay_rate=uniform:1:2", "needs a seed"),
        ("--set law.norm=2 --set law.norm=1", "given twice"),
        ("--set structure.rods.mass=*x", "there must be a number"),
        ("--measures speed", "no measure 'speed'"),
        ("--keep-trajectories", "needs --out"),
        ("--workers 0", "count = 0"),
        ("--cluster tcp://a:1 --backend processes", "give one of them"),
        ("--backend this-process --workers 2", "one point at a time"),
    ],
)
def test_bad_input_is_refused(arguments: str, said: str, capsys: pytest.CaptureFixture[str]) -> None:
    code, answer, _ = ask(capsys, "pinned_rod", *arguments.split())
    assert code == 2
    assert said in answer["error"]


def test_an_interrupt_says_how_to_go_on(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    import tensegrity_mj.studies.sweep as module

    def interrupted(point: dict[str, Any]) -> Any:
        raise KeyboardInterrupt

    interrupted.__module__, interrupted.__qualname__ = module.__name__, "simulate_point"
    monkeypatch.setattr(module, "simulate_point", interrupted)
    code, answer, err = ask(capsys, "pinned_rod", "--out", tmp_path / "out", *ALONE)
    assert code == 130
    assert answer["status"] == "interrupted"
    assert "0 of 1 points are finished and kept in" in err
    assert "run the same again" in err


def test_values_as_text() -> None:
    assert [value_of(text) for text in ("1", "1.5", "1e-3", ".5", "true", "rk4", "inf", '"1"', "[1,2]", "*0.8")] == [
        1,
        1.5,
        1e-3,
        0.5,
        True,
        "rk4",
        "inf",
        "1",
        [1, 2],
        Scaled(0.8),
    ]
    assert split('1,[2,3],{"a":4,"b":[5,6]},"x,y",z') == ["1", "[2,3]", '{"a":4,"b":[5,6]}', '"x,y"', "z"]
    assert values_of("linear:0:1:5", "") == [0.0, 0.25, 0.5, 0.75, 1.0]
    assert values_of("log:1e-4:1e-2:3", "") == pytest.approx([1e-4, 1e-3, 1e-2], rel=1e-14)
    assert values_of("*linear:0.8:1.2:3", "") == [Scaled(0.8), Scaled(1.0), Scaled(1.2)]
    assert values_of("[0,0,-1],[0,0,-2]", "") == [[0, 0, -1], [0, 0, -2]]


def test_every_measure_is_documented() -> None:
    text = (Path(__file__).resolve().parents[2] / "docs" / "studies.md").read_text(encoding="utf-8")
    missing = [name for name, one in MEASURES.items() if f"| `{name}` | {one.unit} | {one.meaning} |" not in text]
    assert not missing
