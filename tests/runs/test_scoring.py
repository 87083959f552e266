"""Scores of tables: references that second formulations find again, orders, verdicts, and tables that are refused."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import truth

import tensegrity_mj as tmj
from evidence.pages import references
from tensegrity_mj.cli import main
from tensegrity_mj.errors import OptionError
from tensegrity_mj.model.text.sources import pack_names
from tensegrity_mj.runs import Table, limit, observed_orders, read_table, reference_of, score

ROOT = Path(__file__).resolve().parents[2]
NAMES = [name.removeprefix("pack/") for name in pack_names()]
every_scene = pytest.mark.parametrize("name", NAMES)


def table_of(name: str, nodes: np.ndarray, step: float | None = None) -> Table:
    names = tuple(tmj.load_scene(f"pack/{name}").structure.node_names)
    return Table(reference_of(name).time, names, nodes, name="mine", header={} if step is None else {"step": step})


def test_there_are_the_nine() -> None:
    assert set(NAMES) == {"free", "pinned", "class_k", "slack", "damped", "closed_loop", "contact", "water", "bounce"}


@every_scene
def test_references_begin_at_the_scenes_start_and_the_page_has_their_error_bars(name: str) -> None:
    reference, scene = reference_of(name), tmj.load_scene(f"pack/{name}")
    np.testing.assert_allclose(reference.time, np.linspace(0, scene.duration, 51), rtol=1e-15)
    np.testing.assert_allclose(reference.positions[0], scene.nodes0, rtol=0, atol=1e-15)
    page = (ROOT / "docs" / "benchmark.md").read_text(encoding="utf-8")
    row = re.search(rf"^\| `{name}` \|.*\| {scene.duration:g} s \|.*\| ([-\de.]+) m \|$", page, re.MULTILINE)
    assert row is not None
    assert float(row[1]) == reference.header["error"]


@pytest.mark.slow
@every_scene
def test_a_second_formulation_finds_the_reference_within_its_error_bar(name: str) -> None:
    """Those that the bars were made of: the ODE, the DAE's full equations, the equations of the page, a closed form."""
    found = score(reference_of(name), table_of(name, references.second(name)[1]))
    assert found.judged == "exact", found.verdict


def test_stedy_finds_the_free_prism() -> None:
    """Another group's program, to its own error: its distance from itself at a hundredth of the accuracy."""
    data, reference = truth.load("stedy_prism_free_undamped"), reference_of("free")
    names = tuple(f"n{number}" for number in range(1, 7))
    found = score(reference, Table(data["t"], names, data["pos"]))
    assert found.error <= data["selfconv_maxdpos"] + reference.header["error"]


def test_two_engines_find_the_contact() -> None:
    """The DAE by error control, the equations of the page, and MuJoCo by the steps of the DAE's RK4.

    Both of these err in the first order of the step, by where in it the tip touches, and alike: a twentieth of the step
    leaves a fifth or less. They differ by RK4's truncation in other coordinates: with a contact's rate s = 100 /s,
    (h s)⁴/120 of the 3 m/s with which the tip lands, for a second, and by a rounding of a metre a step.
    """
    reference = reference_of("contact")
    by_error_control = references.simulated("contact", tmj.DAE(rtol=1e-12, atol=1e-13))
    for nodes in (by_error_control, references.by_own_equations("contact")):
        assert score(reference, table_of("contact", nodes)).judged == "exact"
    errors = []
    for step in (2e-4, 1e-5):
        ours, theirs = (
            references.simulated("contact", engine)
            for engine in (tmj.DAE(method="rk4", timestep=step), tmj.MuJoCo(step))
        )
        errors.append(score(reference, table_of("contact", theirs)).error)
        assert np.abs(ours - theirs).max() < 3 * (100 * step) ** 4 / 120 + 2 / step * np.finfo(float).eps
    assert errors[1] < errors[0] / 5


@pytest.mark.slow
@every_scene
def test_one_percent_more_mass_is_beyond_the_bound(name: str) -> None:
    """At tolerances of which the error, below 1e-6 m, is nothing beside that."""
    if name in references.OWN:
        nodes = references.by_own_equations(name, 1e-9, mass=1.01)
    else:
        scene = tmj.load_scene(f"pack/{name}")
        rods = [replace(rod, mass=1.01 * rod.mass) for rod in scene.structure.rods]
        heavier = scene.with_(structure=replace(scene.structure, rods=rods))
        nodes = tmj.simulate(heavier, None, tmj.DAE(rtol=1e-9), output_interval=scene.duration / 50).nodes
    found = score(reference_of(name), table_of(name, nodes))
    assert found.judged == "undecided", found.verdict
    assert f"is {found.error * 1e3:.3g} mm off" in found.verdict
    assert "not converged or another model" in found.verdict


def test_the_command_scores_runs_and_tables_of_three_steps(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """RK4 has the order 4; a quarter is left for the terms of higher order."""
    monkeypatch.chdir(tmp_path)
    scene = tmj.load_scene("pack/pinned")
    for step, suffix in ((1e-3, "nc"), (2e-3, "csv"), (4e-3, "csv")):
        run = tmj.simulate(scene, None, tmj.MuJoCo(step), output_interval=0.06)
        run.save(f"{step:g}.{suffix}")
    assert main("compare pinned 0.001.nc --score".split()) == 0
    assert "0.001.nc is right to" in capsys.readouterr().out
    line = "compare pack/pinned 0.001.nc 0.002.csv 0.004.csv --score"
    assert main(f"{line} --steps 1e-3 2e-3 4e-3 --json".split()) == 0
    found = json.loads(capsys.readouterr().out)
    coarse, middle, fine = found["tables"]
    assert [one["table"] for one in found["tables"]] == ["0.004.csv", "0.002.csv", "0.001.nc"]
    assert coarse["error"] > middle["error"] > fine["error"] > found["reference"]["error"]
    assert coarse["order"] is None
    assert [middle["order"], fine["order"]] == pytest.approx([4, 4], abs=0.25)
    assert (fine["judged"], fine["times"], fine["step"]) == ("close", [51, 51], 1e-3)
    # Of the two tables without a step in them nothing is known but their errors.
    assert main(f"{line} --json".split()) == 0
    assert {one["order"] for one in json.loads(capsys.readouterr().out)["tables"]} == {None}


def test_a_table_says_its_step_and_may_have_other_times_and_fewer_nodes(tmp_path: Path) -> None:
    reference = reference_of("slack")
    tip = reference.positions[:, reference.nodes.index("tip")] + [0.0, 1e-6, 0.0]
    rows = [
        f"{time!r},{','.join(map(repr, at))}" for time, at in zip(reference.time.tolist(), tip.tolist(), strict=True)
    ]
    rows.insert(1, "0.01,9,9,9")  # between two times of the reference
    (tmp_path / "mine.csv").write_text(
        "# step = 5e-4\n# by hand = ?\n\ntime,tip.x,tip.y,tip.z\n" + "\n".join(rows[:12])
    )
    found = score(reference, read_table(tmp_path / "mine.csv"))
    assert found.error == pytest.approx(1e-6, rel=1e-6)  # 1 of the table, 1e-16 of positions of 1 m
    assert (found.step, found.times, found.span, found.read_as) == (5e-4, (11, 51), (0.0, 0.4), "")
    assert found.judged == "close"
    assert "over 0 to 0.4 s (11 of 51 times)." in found.verdict


@pytest.mark.parametrize(("off", "recognised"), [(0.5, True), (2.0, False)])
def test_axes_are_recognised_by_six_digits_of_the_first_row(off: float, recognised: bool) -> None:
    """Millimetres with y up; a first row that is further off than 1e-6 of the largest coordinate is of other axes."""
    reference = reference_of("pinned")
    turned = 1e3 * reference.positions[..., [0, 2, 1]] * [1, 1, -1]
    turned[0, 0, 0] += off * 1e-6 * 1e3 * np.abs(reference.positions[0]).max()
    found = score(reference, Table(reference.time, reference.nodes, turned))
    assert bool(found.read_as) == recognised
    assert (found.error < 2e-6) == recognised


def test_orders_are_those_of_errors_above_the_error_bar() -> None:
    reference = reference_of("pinned")
    bar = reference.header["error"]
    tables = [
        table_of("pinned", reference.positions + error * np.array([1.0, 0.0, 0.0]), step)
        for step, error in ((4e-3, 9e-3), (2e-3, 1e-3), (1e-3, 2 * bar), (5e-4, bar / 2), (5e-4, bar / 2))
    ]
    scores = [score(reference, one) for one in tables]
    assert [one.judged for one in scores] == ["undecided", "close", "close", "exact", "exact"]
    assert "within the error bar" in scores[3].verdict
    assert observed_orders(scores) == [
        pytest.approx(np.log2(9), rel=1e-6),
        pytest.approx(np.log2(1e-3 / (2 * bar)), rel=1e-4),
        None,
        None,
    ]


GOOD = "time,tip.x,tip.y,tip.z\n0,0.6,0,0.8\n0.06,0.6,0,0.8\n0.12,0.6,0,0.8\n"
BAD = {
    "tipp.x": ("tip.", "tipp.", "mine.csv: there is no node 'tipp' (did you mean 'tip'?)"),
    "no z": (",tip.z", ",tip.w", "there is no column 'tip.z'"),
    "no time": ("time", "t", "there is no column 'time'"),
    "a node that moves": ("tip.", "foot.", "mine.csv: there is no node 'tip', which moves in the reference"),
    "nan": ("0.06,0.6", "0.06,nan", "line 3: tip.x is 'nan'; it must be a finite number"),
    "gaps": (
        "0,0.6,0,0.8\n0.06,0.6",
        "0,,0,0.8\n0.06,",
        "mine.csv: it has 'tip' at 1 of the reference's times, two",
    ),
    "beyond": ("0.12", "3.06", "mine.csv: t = 3.06 s is beyond the end; the reference has 51 times, from 0 to 3 s"),
    "one time": ("0.06,0.6,0,0.8\n0.12", "0.13", "mine.csv: it has 1 of the reference's times, two are needed"),
    "a bad step": ("time", '# step = "small"\ntime', "mine.csv: step = 'small'; it must be a finite number > 0"),
}


@pytest.mark.parametrize("what", BAD)
def test_bad_tables_are_refused_in_a_line(
    what: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    old, new, message = BAD[what]
    assert old in GOOD
    Path("mine.csv").write_text(GOOD.replace(old, new))
    assert main("compare pinned mine.csv --score".split()) == 2
    said = capsys.readouterr().err
    assert message in said
    assert said.count("\n") == 1


@pytest.mark.parametrize(
    ("line", "message"),
    [
        (
            "compare prism mine.csv --score",
            "scene 'prism': there is no reference.csv next to it; scenes that have one: ",
        ),
        ("compare pack/fre mine.csv --score", "(did you mean 'pack/free'?)"),
        ("compare pinned mine.csv mine.csv --score --steps 1e-3 0.001", "--steps 0.001 0.001: each"),
        ("compare fre mine.csv --score", "unknown scene 'fre'"),
        ("compare pinned --score", "--score takes a scene, tables, and as many --steps or none"),
        ("compare pinned mine.csv --score --steps 1e-3 1e-4", "as many --steps or none"),
        ("compare pinned mine.csv --score --steps 0", "--steps: 0: it must be > 0"),
        ("compare pinned mine.csv --score --duration 1", "--duration means nothing with --score"),
        ("compare pinned --steps 1e-3", "--steps needs --score"),
        ("compare pinned none.csv --score", "none.csv: no such file"),
    ],
)
def test_bad_lines_are_refused(
    line: str, message: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("mine.csv").write_text(GOOD)
    assert main(line.split()) == 2
    said = capsys.readouterr().err
    assert message in said
    assert said.count("\n") == 1


def test_a_scene_of_ones_own_may_have_a_reference(tmp_path: Path) -> None:
    scene = tmp_path / "scene.toml"
    tmj.save_scene(tmj.load_scene("pack/pinned"), scene)
    table = tmp_path / "reference.csv"
    for bad in ("", "# error = 0.0\n", '# error = "small"\n', "# error = nan\n"):
        table.write_text(bad + GOOD)
        with pytest.raises(OptionError, match=r"reference\.csv: error = .* must be a finite number > 0"):
            reference_of(scene)
    table.write_text("# error = 1e-3\n" + GOOD)
    with pytest.raises(OptionError, match=r"reference\.csv: nothing moves in the reference"):
        score(reference_of(scene), read_table(table))
    table.write_text("# error = 1e-3\n" + GOOD.replace("0.12,0.6", "0.12,0.5"))
    assert score(reference_of(scene), read_table(table)).judged == "exact"
    with pytest.raises(OptionError, match="step = -1"):
        score(reference_of(scene), read_table(table), -1)


def test_comments_that_no_program_reads_say_nothing(tmp_path: Path) -> None:
    deep = "# x = " + "[" * 3000 + "\n# y = " + "9" * 5000 + "\n# step = 0.5\n"
    (tmp_path / "mine.csv").write_text(deep + "time,tip.x,tip.y,tip.z\n0,1,2,3\n1,1,2,3\n", encoding="utf-8")
    assert read_table(tmp_path / "mine.csv").header == {"step": 0.5}


def test_what_another_program_calls_provenance_is_its_own(tmp_path: Path) -> None:
    import h5netcdf

    with h5netcdf.File(tmp_path / "mine.nc", "w") as file:
        file.attrs["provenance"] = "computed by my program, 2024"
        file.dimensions = {"time": 2, "node": 1, "axis": 3}
        file.create_variable("time", ("time",), float, data=[0.0, 1.0])
        file.create_variable("node", ("node",), np.dtype("S3"), data=np.array([b"tip"]))
        file.create_variable("nodes", ("time", "node", "axis"), float, data=np.ones((2, 1, 3)))
    assert read_table(tmp_path / "mine.nc").header["step"] is None


def stepped(order: int, model: float, names: str = "pinned") -> list[Table]:
    """Tables of four steps with an error of an order, off by so much of the motion as the step falls to zero."""
    reference = reference_of(names)
    motion = reference.positions - reference.positions[0]
    wave = motion * np.sin(3 * reference.time)[:, None, None]
    tables = []
    for step in (8e-3, 4e-3, 2e-3, 1e-3):
        nodes = reference.positions + 20.0**order * step**order * wave + model * motion
        tables.append(Table(reference.time, reference.nodes, nodes, name=f"{step:g}", header={"step": step}))
    return tables


@pytest.mark.parametrize("order", [1, 2, 4])
def test_two_steps_tell_a_large_step_from_another_model(order: int) -> None:
    """By Richardson's extrapolation, exact of an error that is one power of the step."""
    reference = reference_of("pinned")
    right = [score(reference, one) for one in stepped(order, 0.0)]
    assert limit(right[:1]) is None
    found = limit(right[:2])
    assert found is not None
    assert found.order == order
    # Of positions and steps' powers that are rounded to ε, twice the reference's size; extrapolated by at most 2.
    assert found.error < 16 * np.finfo(float).eps * np.abs(reference.positions).max()
    assert found.judged == ("converges" if right[1].judged == "undecided" else right[1].judged)
    wrong = limit([score(reference, one) for one in stepped(order, 0.01)])
    assert wrong is not None
    # The finest step's error may still be the larger part of it: of order 1 it is 0.02 for the 0.01 of the model.
    assert wrong.judged == ("undecided" if order == 1 else "wrong"), wrong.verdict
    finer = stepped(order, 0.2)
    other = limit([score(reference, one) for one in finer])
    assert other is not None
    assert other.judged == "wrong"
    assert "another model" in other.verdict


def saved(table: Table, path: Path) -> None:
    head = [f"# step = {table.header['step']}"] if table.header else []
    columns = ["time", *(f"{node}.{axis}" for node in table.nodes for axis in "xyz")]
    rows = [
        ",".join("" if np.isnan(value) else repr(value) for value in [time, *row.ravel().tolist()])
        for time, row in zip(table.time.tolist(), table.positions, strict=True)
    ]
    path.write_text("\n".join([*head, ",".join(columns), *rows]) + "\n")


@pytest.mark.parametrize(
    ("order", "model", "tables", "code", "judged"),
    [(1, 0.0, 1, 7, None), (1, 0.0, 2, 0, "converges"), (4, 0.0, 4, 0, "close"), (2, 0.2, 4, 7, "wrong")],
)
def test_a_table_that_is_wrong_has_an_exit_code_of_its_own(
    order: int,
    model: float,
    tables: int,
    code: int,
    judged: str | None,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    for table in stepped(order, model)[:tables]:
        saved(table, tmp_path / f"{table.name}.csv")
    files = [str(path) for path in sorted(tmp_path.iterdir())]
    assert main(["compare", "pinned", *files, "--score", "--json"]) == code
    found = json.loads(capsys.readouterr().out)["limit"]
    assert (None if found is None else found["judged"]) == judged


@pytest.mark.parametrize(
    ("factor", "turn", "words"),
    [
        (1.0, np.eye(3), ""),
        (1e3, np.eye(3), "mm, with (x, y, z) as (x, y, z)"),
        (1.0, np.array([[1, 0, 0], [0, 0, -1], [0, 1, 0]]), "m, with (x, y, z) as (x, -z, y)"),
        (100.0, np.array([[1, 0, 0], [0, 0, -1], [0, 1, 0]]), "cm, with (x, y, z) as (x, -z, y)"),
        (1.0, np.array([[0, 0, 1], [1, 0, 0], [0, 1, 0]]), "m, with (x, y, z) as (z, x, y)"),
        (1e3 / 25.4, np.diag([1, -1, 1]), "inches, with (x, y, z) as (x, -y, z)"),
        (1.1, np.eye(3), ""),  # no unit: it is another start
    ],
)
@pytest.mark.parametrize("name", ["free", "damped", "water"])
def test_units_and_axes_are_read_off_the_first_row_and_said(
    name: str, factor: float, turn: np.ndarray, words: str
) -> None:
    reference = reference_of(name)
    found = score(reference, Table(reference.time, reference.nodes, factor * reference.positions @ turn, name="mine"))
    assert found.read_as == words
    assert (f"mine (read as {words}) is right" in found.verdict) == bool(words)
    if factor != 1.1:
        # There and back, two roundings of the largest coordinate.
        assert found.error <= 4 * np.finfo(float).eps * np.abs(reference.positions).max()
    else:
        assert found.judged == "undecided"


def test_a_table_may_have_gaps(tmp_path: Path) -> None:
    """Of the contact, say, which another model of it cannot follow: before the first touch, and at rest."""
    reference = reference_of("contact")
    known = (reference.time <= 0.28) | (reference.time >= 1.4)
    places = reference.positions.copy()
    places[~known] += 1.0
    rows = np.flatnonzero(known)
    table = Table(reference.time[rows], reference.nodes, places[rows], name="mine")
    places[~known] = np.nan
    for one in (table, Table(reference.time, reference.nodes, places, name="mine")):
        saved(one, tmp_path / "mine.csv")
        found = score(reference, read_table(tmp_path / "mine.csv"))
        assert (found.judged, found.times, found.span) == ("exact", (int(known.sum()), 51), (0.0, 2.0))
        assert f"({known.sum()} of 51 times)" in found.verdict


def test_what_tables_do_not_show_is_not_right(tmp_path: Path) -> None:
    """A node that moves is needed at two times, a limit where the finer table is furthest off; each table counts."""
    reference, (coarse, fine) = reference_of("pinned"), stepped(1, 0.0)[:2]
    row = int(np.linalg.norm(reference.positions - reference.positions[0], axis=2).max(axis=0).argmax())
    places = reference.positions.copy()
    places[5:9, row] = np.nan
    count = len(reference.time)
    assert score(reference, replace(fine, positions=places)).times == (count - 4, count)
    places[1:, row] = np.nan
    with pytest.raises(OptionError, match=f"it has '{reference.nodes[row]}' at 1 of the reference's times"):
        score(reference, replace(fine, positions=places))
    both = [score(reference, one) for one in (coarse, fine)]
    assert limit(both) is not None
    few = replace(coarse, time=coarse.time[[0, 1]], positions=coarse.positions[[0, 1]])
    assert both[1].time > few.time[-1]
    assert limit([score(reference, few), both[1]]) is None
    for name, table in (("a", coarse), ("b", fine), ("c", replace(stepped(1, 0.2)[0], header={}))):
        saved(table, tmp_path / f"{name}.csv")
    files = [str(tmp_path / f"{name}.csv") for name in "abc"]
    assert main(["compare", "pinned", *files[:2], "--score"]) == 0
    assert main(["compare", "pinned", *files, "--score"]) == 7


def test_the_water_of_many_segments_is_the_reference() -> None:
    """By Gauss-Legendre points, without any segment: its bar holds them apart, and 128 segments are right."""
    reference = reference_of("water")
    own = references.by_own_equations("water", 1e-11)
    assert score(reference, table_of("water", own)).judged == "exact"
    scene = tmj.load_scene("pack/water")
    assert scene.water is not None
    run = tmj.simulate(scene, None, tmj.DAE(rtol=1e-9), output_interval=scene.duration / 50)
    found = score(reference, table_of("water", run.nodes))
    assert found.judged == "close", found.verdict
    # Midpoints err by the square of the segments' length: 64 segments by four times as much, up to terms of its square.
    coarse = scene.with_(water=replace(scene.water, segments=64))
    run = tmj.simulate(coarse, None, tmj.DAE(rtol=1e-9), output_interval=scene.duration / 50)
    assert score(reference, table_of("water", run.nodes)).error == pytest.approx(4 * found.error, rel=0.05)


def test_a_damper_that_pushes_is_seen_in_the_bounce() -> None:
    """The closed form is the reference; without the clipping of the damper it is another motion, whatever the step."""
    reference = reference_of("bounce")
    found = score(reference, table_of("bounce", references.by_own_equations("bounce")))
    assert found.judged == "exact", found.verdict
    scene = tmj.load_scene("pack/bounce")
    pushing = scene.with_(structure=replace(scene.structure, string_law=tmj.model.StringLaw.UNCLIPPED))
    tables = []
    for step in (1e-3, 5e-4):
        run = tmj.simulate(pushing, None, tmj.MuJoCo(step), output_interval=0.06)
        tables.append(score(reference, table_of("bounce", run.nodes), step))
    found_limit = limit(tables)
    assert found_limit is not None
    assert found_limit.judged == "wrong", found_limit.verdict
