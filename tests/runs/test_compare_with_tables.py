"""Runs beside tables of other programs: read in their forms or refused with the line, compared at their own times."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest
import xarray

import tensegrity_mj as tmj
from tensegrity_mj.cli import main
from tensegrity_mj.errors import FormatError, OptionError
from tensegrity_mj.runs import Table, read_table
from tensegrity_mj.runs.comparison import resampled
from tensegrity_mj.runs.recorded import VARIABLES

OMEGA = np.sqrt(50.0)  # rad/s: 1 kg on a spring of 50 N/m


@pytest.fixture(scope="module")
def run() -> tmj.Trajectory:
    """Mass m on a string of no rest length to the pin o: x = cos ωt, exactly; another at rest, h."""
    return oscillation(np.arange(101) * 0.01)


def oscillation(time: np.ndarray) -> tmj.Trajectory:
    nodes = {"o": (0.0, 0.0, 0.0), "m": (1.0, 0.0, 0.0), "h": (0.0, 0.0, 1.0)}
    spring = tmj.String("s1", ("o", "m"), 50.0, rest_length=1e-9)
    masses = [tmj.PointMass("m", 1.0)]
    structure = tmj.Structure("spring", nodes, strings=[spring], fixed_nodes=("o", "h"), point_masses=masses)
    short = tmj.simulate(tmj.Scene(structure), None, tmj.DAE(), duration=0.01)
    count = len(time)
    known = {name: np.zeros((count, *getattr(short, name).shape[1:])) for name in VARIABLES}
    known["time"] = time
    known["nodes"][:] = structure.positions
    known["nodes"][:, 1, 0] = np.cos(OMEGA * time)
    known["velocities"][:, 1, 0] = -OMEGA * np.sin(OMEGA * time)
    known["tensions"][:, 0] = 50.0 * np.abs(np.cos(OMEGA * time))
    return replace(short, **known)


def written(path: Path, text: str) -> Path:
    path.write_text(text)
    return path


def test_the_two_forms_of_csv_hold_the_same(tmp_path: Path) -> None:
    lines = ["time, m.x,m.y,m.z,h.x,h.y,h.z", "0,1,2,3,,,", "0.5,4,5,6,7,8,9", "", "1.5,0,0,0,0,0,1"]
    wide = read_table(written(tmp_path / "wide.csv", "\n".join(lines)))
    rows = ["time,node,x,y,z", "0,m,1,2,3", "0.5,m,4,5,6", "0.5,h,7,8,9", "1.5,m,0,0,0", "1.5,h,0,0,1"]
    long = read_table(written(tmp_path / "long.csv", "\ufeff" + "\r\n".join(rows)))
    by_node = [rows[0], *(row for node in "hm" for row in rows if f",{node}," in row)]
    other = read_table(written(tmp_path / "by_node.csv", "\n".join(by_node)))
    for table in (wide, long):
        assert table.nodes == ("m", "h")
        assert np.array_equal(table.time, [0.0, 0.5, 1.5])
        assert np.array_equal(table.positions[1], [[4, 5, 6], [7, 8, 9]])
        assert np.isnan(table.positions[0, 1]).all()
        assert table.velocities is None
    assert other.nodes == ("h", "m")
    assert np.array_equal(other.positions[:, ::-1], wide.positions, equal_nan=True)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("time,m.x,m.y,m.z\n0,1,2,3\n0.1,nan,2,3\n", "line 3: m.x is 'nan'; it must be a finite number; leave empty"),
        ("time,m.x,m.y,m.z\n0,1,2,3\n0.1,1e999,2,3\n", "line 3: m.x is '1e999'"),
        ("time,m.x,m.y,m.z\n0,1,2,3\n0.1,a,2,3\n", "line 3: m.x is 'a'"),
        (
            "time,m.x,m.y,m.z\n0,1,2,3\n\n0.2,1,2,3\n0.1,1,2,3\n",
            r"line 5: m: time is 0\.1 s after 0\.2 s; times must rise",
        ),
        ("time,m.x,m.y,m.z\n0,1,2,3\n0,1,2,3\n", "line 3: m: time is 0 s after 0 s"),
        ("time,m.x,m.y,m.z\n,1,2,3\n", "line 2: no time, or 4 cells below 4 columns"),
        ("time,m.x,m.y,m.z\nnan,1,2,3\n", "line 2: time is 'nan'"),
        ("time,m.x,m.y,m.z\n0,1,2\n", "line 2: no time, or 3 cells below 4 columns"),
        ("time,m.x,m.y\n0,1,2\n", r"there is no column 'm\.z'; the first line names the columns: time, n1\.x"),
        ("time,m.x,m.y,m.z,m.vx\n0,1,2,3,4\n", r"there is no column 'm\.vy'"),
        ("t,m.x,m.y,m.z\n0,1,2,3\n", "no column 'time'"),
        ("time,m.x,m.y,m.z,m.x\n0,1,2,3,4\n", "or one twice"),
        ("time,a,b\n0,1,2\n", r"no column 'n1\.x'"),
        ("", "no column 'time'"),
        (
            "time,node,x,y,z\n0,m,1,2,3\n0.1,m,1,2,3\n0.1,h,1,2,3\n0.05,m,1,2,3\n",
            r"line 5: m: time is 0\.05 s after",
        ),
        ("time,node,x,y\n0,m,1,2\n", "no column 'z'"),
    ],
)
def test_what_is_no_table_is_refused_with_the_line(text: str, message: str, tmp_path: Path) -> None:
    with pytest.raises(FormatError, match=rf"x\.csv.*{message}"):
        read_table(written(tmp_path / "x.csv", text))


def test_a_table_of_strings_alone_has_no_nodes(tmp_path: Path) -> None:
    table = read_table(written(tmp_path / "x.csv", "time,s1.length,s1.tension,s1.rest_length\n0,1,2,3\n0.5,,4,5\n"))
    assert table.nodes == ()
    assert np.array_equal(table.lengths["s1"], [1.0, np.nan], equal_nan=True)
    assert np.array_equal(table.tensions["s1"], [2.0, 4.0])
    assert table.lengths.keys() == table.tensions.keys() == {"s1"}


def test_what_is_no_path_is_refused() -> None:
    for path in (3, None):
        with pytest.raises(FormatError, match=f"{path}: that is no path; give the name of a table's .csv or .nc file"):
            read_table(path)  # type: ignore[arg-type]


def test_a_netcdf_table_is_read_as_xarray_and_others_write_it(tmp_path: Path) -> None:
    time, places = np.arange(5) * 0.1, np.random.default_rng(1).normal(size=(5, 2, 3))
    places[3, 1] = np.nan
    coordinates = {"time": time, "node": ["m", "h"], "string": ["s1"]}
    data = xarray.Dataset(
        {
            "nodes": (("time", "node", "axis"), places),
            "tensions": (("time", "string"), np.ones((5, 1))),
            "lengths": (("time", "string"), np.full((5, 1), 2.0)),
        },
        coordinates,
    )
    data.to_netcdf(tmp_path / "a.nc", engine="h5netcdf")  # with NaN for what is missing, as xarray does it
    table = read_table(tmp_path / "a.nc")
    assert table.nodes == ("m", "h")
    assert np.array_equal(table.positions, places, equal_nan=True)
    assert np.array_equal(table.tensions["s1"], np.ones(5))
    assert np.array_equal(table.lengths["s1"], np.full(5, 2.0))
    del coordinates["string"]
    characters = xarray.Dataset({"nodes": (("time", "node", "axis"), places)}, coordinates)
    characters["node"] = ("node", np.array([b"m", b"hh"], "S2"))  # rows of characters, as MATLAB writes them
    characters.to_netcdf(tmp_path / "b.nc", engine="h5netcdf")
    assert read_table(tmp_path / "b.nc").nodes == ("m", "hh")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda file: file["nodes"].attrs.__setitem__("units", "mm"), "nodes has dimensions .* and is in mm; .* in m$"),
        (lambda file: file["nodes"].__setitem__((1, 1, 2), np.inf), "nodes is not finite at time 1, node 1, axis 2"),
        (lambda file: file["time"].__setitem__(2, 0.05), r"row 3: time is 0\.05 s after 0\.1 s; times must rise"),
        (lambda file: file["time"].__setitem__(2, np.nan), "time"),
        (lambda file: file.__delitem__("node"), "there is no variable 'node'"),
    ],
    ids=range(5),
)
def test_a_netcdf_table_that_is_none_is_refused(change, message: str, tmp_path: Path) -> None:
    path = tmp_path / "x.nc"
    data = xarray.Dataset({"nodes": (("time", "node", "axis"), np.zeros((4, 2, 3)))})
    data.assign_coords(time=np.arange(4) * 0.1, node=["m", "h"]).to_netcdf(path, engine="h5netcdf")
    with h5py.File(path, "a") as file:
        change(file)
    with pytest.raises(FormatError, match=rf"x\.nc.*{message}"):
        read_table(path)


def test_a_table_of_the_run_itself_differs_by_nothing(run: tmj.Trajectory, tmp_path: Path) -> None:
    """By no bit: its times are samples of the run, which are taken as they are, and CSV holds every number exactly."""
    found = tmj.compare(run, read_table(run.save(tmp_path / "run.csv")))
    assert found.max_node_error == found.max_velocity_error == found.max_tension_error == 0
    assert found.compared == ("node_error", "velocity_error", "tension_error")
    assert set(found.resampling_error.values()) == {0.0}
    assert found.missing_nodes == found.unknown_nodes == ()
    turned = tmj.compare(read_table(run.save(tmp_path / "run.csv")), run)
    assert (turned.first, turned.second) == (found.second, found.first)


def test_a_difference_is_found_where_it_is(run: tmj.Trajectory) -> None:
    places = run.nodes.copy()
    places[40:, 1] += (0.0, 3e-3, 4e-3)
    found = tmj.compare(run, Table(run.time, ("o", "m", "h"), places), tolerance=1e-3)
    assert found.max_node_error == pytest.approx(5e-3, rel=1e-12)  # round-off of 1 in differences of 5e-3, thousandfold
    assert found.first_exceeded == {"node_error": 0.4}
    assert found.by_node == {"o": 0.0, "m": found.max_node_error, "h": 0.0}
    assert found.rms_node_error == pytest.approx(5e-3 * np.sqrt(61 / 101 / 3), rel=1e-12)


@pytest.mark.parametrize("spacing", [0.01, 0.02, 0.04])
def test_positions_at_other_times_are_cubic_hermite_and_the_estimate_is_their_error(spacing: float) -> None:
    """cos ωt: h⁴/384 ω⁴ at the middle of an interval; a spline's velocities h⁴/384 ω⁵; lines h²/8 of 50 ω²."""
    run = oscillation(np.arange(0.0, 2.0, spacing))
    times = run.time[4:-4] + spacing / 2
    exact = oscillation(times)
    found = tmj.compare(run, Table(times, ("m",), exact.nodes[:, 1:2], exact.velocities[:, 1:2]))
    bound = spacing**4 / 384 * OMEGA**4
    # The middle of some interval is within h/2 of a largest |cos|, which is then 1 - (h ω)²/8 or more; the next term of
    # the error is (h ω)²/40 of it, 0.002.
    assert 0.99 * bound * (1 - (spacing * OMEGA) ** 2 / 8) < found.max_node_error <= bound
    # Twice and four times the spacing are not yet all in the order of 4 (h ω up to 1.1): within half as much again.
    assert found.max_node_error / 1.5 < found.resampling_error["node_error"] < 1.5 * found.max_node_error
    # A spline errs more at its ends, of which a coarse one has more: at least half the error, whatever it is.
    assert found.resampling_error["velocity_error"] > found.max_velocity_error / 2


def test_the_error_at_a_time_is_that_of_the_worst_node(run: tmj.Trajectory) -> None:
    """m is off by more and more, h by as much as ever; sums and differences of numbers up to 10: 1e-14."""
    rows = np.arange(0, 101, 20)
    off = np.zeros((6, 2, 3))
    off[:, 0, 1], off[:, 1, 2] = 0.1 * np.arange(6), 0.25
    of = run.nodes[rows][:, 1:] + off, run.velocities[rows][:, 1:] - 2 * off
    tensions = {"s1": run.tensions[rows, 0] + 3 * off[:, 0, 1]}
    found = tmj.compare(run, Table(run.time[rows], ("m", "h"), *of, tensions=tensions))
    worst = np.array([0.25, 0.25, 0.25, 0.3, 0.4, 0.5])
    np.testing.assert_allclose(found.node_error, worst, rtol=0, atol=1e-14)
    np.testing.assert_allclose(found.velocity_error, 2 * worst, rtol=0, atol=1e-14)
    np.testing.assert_allclose(found.tension_error, 0.3 * np.arange(6), rtol=0, atol=1e-13)
    assert found.by_node == pytest.approx({"m": 0.5, "h": 0.25}, rel=1e-12)


def test_the_estimate_sees_a_jump_of_the_velocity() -> None:
    """A mass that bounces: at its impact the polynomials err by a part of v h, and so do twice as coarse ones."""
    time = np.arange(0.0, 1.0, 0.01)
    run = oscillation(time)
    nodes, velocities = np.zeros_like(run.nodes), np.zeros_like(run.velocities)
    nodes[:, 1, 0], velocities[:, 1, 0] = np.abs(time - 0.503), np.sign(time - 0.503)
    at = np.linspace(0.0, 0.99, 2000)
    true = np.zeros((2000, 1, 3))
    true[:, 0, 0] = np.abs(at - 0.503)
    found = tmj.compare(replace(run, nodes=nodes, velocities=velocities), Table(at, ("m",), true))
    assert found.max_node_error > 1e-3
    assert found.max_node_error / 4 < found.resampling_error["node_error"] < 4 * found.max_node_error


def test_only_what_overlaps_is_compared_and_the_rest_is_reported(run: tmj.Trajectory) -> None:
    time = np.arange(-0.5, 2.0, 0.1)
    places = np.zeros((25, 2, 3))
    places[:, 0, 0] = np.cos(OMEGA * time)
    places[7, 0] = np.nan  # not seen at 0.2 s, nor is any other node
    found = tmj.compare(run, Table(time, ("m", "hh"), places))
    assert np.allclose(found.time, [0.0, 0.1, *np.arange(3, 11) / 10], rtol=0, atol=1e-12)
    assert (found.missing_nodes, found.unknown_nodes, found.times_outside) == (("o", "h"), ("hh",), 14)
    # The times are sums of steps of .1 s: within 1e-15 s of samples, at up to ω m/s.
    assert found.max_node_error < 1e-14 * OMEGA
    with pytest.raises(OptionError, match=r"table has 0 of its 2 times within the run, from 0 to 1 s"):
        tmj.compare(run, Table(np.array([5.0, 6.0]), ("m",), np.zeros((2, 1, 3))))
    with pytest.raises(OptionError, match=r"table has no node of the run of 'spring': a, b are none of o, m, h"):
        tmj.compare(run, Table(time, ("a", "b"), places))


def test_too_few_samples_say_nothing_of_the_error(run: tmj.Trajectory) -> None:
    short = resampled(run.until(5), np.array([0.005, 0.015]))
    assert all(np.isnan(error) for error in short.errors.values())


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"positions": np.zeros((2, 2, 3))}, r"positions has shape \(2, 2, 3\); it must be \(2, 1, 3\)"),
        ({"velocities": np.zeros((2, 3))}, "velocities has shape"),
        ({"tensions": {"s1": np.zeros(3)}}, r"s1 has shape \(3,\); it must be \(2,\)"),
        ({"time": np.array([1.0, 0.0])}, "row 2: time is 0 s after 1 s"),
        ({"nodes": ("m", "m"), "positions": np.zeros((2, 2, 3))}, "each may be there once"),
    ],
    ids=range(5),
)
def test_a_table_that_does_not_fit_itself_is_refused(fields, message: str) -> None:
    good = {"time": np.array([0.0, 1.0]), "nodes": ("m",), "positions": np.zeros((2, 1, 3))}
    with pytest.raises(OptionError, match=message):
        Table(**(good | fields))


def test_one_of_two_is_a_run(run: tmj.Trajectory) -> None:
    table = Table(run.time, ("m",), run.nodes[:, 1:2])
    with pytest.raises(OptionError, match=r"must be a Trajectory; one of the two is a run"):
        tmj.compare(table, table)


def test_the_command_compares_and_names_what_is_not(
    run: tmj.Trajectory, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = str(run.save(tmp_path / "run.nc"))
    lines = [
        "time,m.x,m.y,m.z,hh.x,hh.y,hh.z",
        *(f"{t},{np.cos(OMEGA * t) + 1e-3},0,0,0,0,1" for t in (0.105, 0.2, 3.0)),
    ]
    table = str(written(tmp_path / "camera.csv", "\n".join(lines)))
    plot = tmp_path / "difference.png"
    assert main(["compare", file, table, "--tolerance", "1e-4", "--plot", str(plot)]) == 0
    out, err = capsys.readouterr()
    assert re.search(r"bad +the largest node error is 1 mm \(allowed 100 µm, exceeded from 0.105 s on\)\n", out)
    assert "tension" not in out
    assert "nodes of the run that the table does not have: o, h" in err
    assert "the table's 'hh' is no node of the run (did you mean 'h'?)" in err
    assert "1 times of the table are not within the run" in err
    assert plot.stat().st_size > 1000
    assert main(["compare", table, file, "--json"]) == 0
    data = json.loads(capsys.readouterr().out)
    assert data["max_node_error"] == pytest.approx(1e-3, abs=1e-6)
    assert data["max_tension_error"] is None
    assert data["unknown_nodes"] == ["hh"]
    assert 0 < data["resampling_error"]["node_error"] < 1e-6
    assert main(["compare", table, table]) == 2
    assert main(["compare", file, table, "--engine", "dae"]) == 2
    bad = str(written(tmp_path / "bad.csv", "time,m.x,m.y,m.z\n0,1,2,nan\n"))
    capsys.readouterr()
    assert main(["compare", file, bad]) == 2
    assert "bad.csv, line 2: m.z is 'nan'" in capsys.readouterr().err
