"""Statistics of runs: an oscillator's in closed form, the cycles of the standard's own example, and a sea's."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

import tensegrity_mj as tmj
from tensegrity_mj.cli import main
from tensegrity_mj.errors import OptionError
from tensegrity_mj.model.text.writing import scene_to_toml
from tensegrity_mj.runs.statistics import Statistics

M, K, G, A = 1.5, 60.0, 9.81, 0.05
OMEGA = np.sqrt(K / M)


def swinging(turns: int = 9) -> tmj.Trajectory:
    """A mass on a string, let go A below its rest: tension m g + k A cos ω t; from t = 0, a whole number of turns."""
    length = 1 + M * G / K + A
    structure = tmj.Structure(
        "hung",
        {"hook": (0.0, 0.0, 0.0), "m": (0.0, 0.0, -length)},
        strings=(tmj.String("s", ("hook", "m"), K, rest_length=1.0),),
        fixed_nodes=("hook",),
        point_masses=(tmj.PointMass("m", M),),
    )
    scene = tmj.Scene(structure, gravity=(0.0, 0.0, -G))
    period = 2 * np.pi / OMEGA
    options = {"duration": turns * period, "output_interval": period / 200}
    return tmj.simulate(scene, None, tmj.DAE(rtol=1e-11, atol=1e-12), **options)


def test_an_oscillator_has_the_statistics_of_a_sine() -> None:
    """With 200 samples a turn the trapezoid is exact for whole turns, and extremes are met at samples.

    Crossings by straight lines are off by round-off, as the sine is odd there, but for what the mean's error moves it.
    The run itself is within 1e-9 m of the motion.
    """
    run = swinging()
    found = run.statistics("tension")
    assert found.names == ("s",)
    close = {"abs": 1e-8 * K}
    assert found.mean[0] == pytest.approx(M * G, **close)
    assert found.deviation[0] == pytest.approx(K * A / np.sqrt(2), **close)
    assert found.greatest[0] == pytest.approx(M * G + K * A, **close)
    assert found.least[0] == pytest.approx(M * G - K * A, **close)
    assert found.significant[0] == pytest.approx(2 * K * A, **close)
    assert found.period[0] == pytest.approx(2 * np.pi / OMEGA, rel=1e-6)
    # Rainflow: from the top, a half cycle down and one up, turn by turn, all of the range 2 k A.
    cycles = found.cycles("s")
    assert cycles[:, 2].sum() == pytest.approx(9.0)
    np.testing.assert_allclose(cycles[:, 0], 2 * K * A, atol=1e-8 * K)
    assert found.equivalent_range("s", 3.0, 9.0) == pytest.approx(2 * K * A, **close)
    assert found.equivalent_range("s", 3.0) == pytest.approx(9 ** (1 / 3) * 2 * K * A, **close)


def test_positions_and_velocities_have_names_with_axes_and_a_start() -> None:
    run = swinging(4)
    places = run.statistics("position", after=run.time[200])
    assert places.names[-1] == "m.z"
    assert places.time[0] == run.time[200]
    assert places.significant[-1] == pytest.approx(2 * A, abs=1e-8)
    assert np.isnan(places.significant[0])  # the hook stands still
    speeds = run.statistics("velocity")
    assert speeds.deviation[-1] == pytest.approx(A * OMEGA / np.sqrt(2), abs=1e-8)
    assert run.statistics("rod_force").names == ()


def test_cycles_are_those_of_the_standards_example() -> None:
    """ASTM E1049-85, figure 6: ranges and their counts."""
    series = np.array([-2.0, 1, -3, 5, -1, 3, -4, 4, -2])
    found = Statistics.of("tension", "N", ("s",), np.arange(9.0), series[:, None])
    counts: dict[float, float] = {}
    for size, _, count in found.cycles("s"):
        counts[size] = counts.get(size, 0.0) + count
    assert counts == {3.0: 0.5, 4.0: 1.5, 6.0: 0.5, 8.0: 1.0, 9.0: 0.5}


def test_a_sea_has_the_significant_height_that_it_was_made_with() -> None:
    """Waves counted in a Gaussian sea: of a narrow spectrum H_1/3 = 4 σ (Longuet-Higgins).

    In seas of JONSWAP's width it is observed 4 to 6 % lower (Forristall 1978). 0.9 to 1.0 of 4 σ holds both, with the
    scatter of some 1500 waves, 2 %.
    """
    sea = tmj.model.IrregularSea("jonswap", 2.0, 8.0, seed=1, components=300)
    time = np.arange(0.0, 10800.0, 0.25)
    elevation = tmj.model.Sea.of(sea.waves).elevation(time, 0.0, 0.0)
    found = Statistics.of("position", "m", ("z",), time, elevation[:, None])
    assert 0.9 < found.significant[0] / (4 * found.deviation[0]) < 1.0
    # Mean period between zero crossings of the components: √(m0/m2), as the module states it for them.
    expected = 2 * np.pi / np.sqrt(np.mean(sea.frequencies**2))
    assert found.period[0] == pytest.approx(expected, rel=0.02)


def test_the_command_states_them(capsys: pytest.CaptureFixture[str]) -> None:
    words = ["run", "prism", "--duration", "0.2", "--statistics", "0.05"]
    assert main([*words, "--json"]) == 0
    data = json.loads(capsys.readouterr().out)["statistics"]
    assert set(data) == {"after", "tension", "rod_force"}
    assert {"mean", "deviation", "greatest", "significant", "cycles"} <= set(next(iter(data["tension"].values())))
    assert main(words) == 0
    assert "significant" in capsys.readouterr().out


def test_what_cannot_be_counted_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    run = swinging(1)
    with pytest.raises(OptionError, match=r"no quantity 'tensions' .did you mean 'tension'"):
        run.statistics("tensions")
    with pytest.raises(OptionError, match=r"no quantity '..tension..'"):
        run.statistics(["tension"])  # type: ignore[arg-type]
    for after in ("x", None, np.array([1.0, 2.0]), np.nan):
        with pytest.raises(OptionError, match=r"after = .*; it must be a finite number"):
            run.statistics(after=after)  # type: ignore[arg-type]
    for wrong in (0, -1, np.nan, "x"):
        for name, exponent, count in (("exponent", wrong, 1.0), ("count", 3.0, wrong)):
            with pytest.raises(OptionError, match=f"{name} = .*; it must be a finite number > 0"):
                run.statistics().equivalent_range("s", exponent, count)  # type: ignore[arg-type]
    with pytest.raises(OptionError, match=r"after = 99.0 s leaves 0 samples"):
        run.statistics(after=99.0)
    with pytest.raises(OptionError, match="signal 't'"):
        run.statistics().cycles("t")
    assert main(["run", "prism", "--duration", "0.2", "--statistics", "1"]) == 2
    assert "--statistics" in capsys.readouterr().err


def test_damage_of_a_high_exponent_is_that_of_the_largest_range() -> None:
    """(½ rᵐ + ½ rᵐ)^(1/m) = r of two half cycles, though r^m is beyond what a float holds."""
    found = Statistics.of("tension", "N", ("s",), np.arange(3.0), np.array([[0.0], [100.0], [0.0]]))
    assert found.equivalent_range("s", 400.0) == pytest.approx(100.0, rel=1e-13)
    still = Statistics.of("tension", "N", ("s",), np.arange(3.0), np.ones((3, 1)))
    assert still.equivalent_range("s", 3.0) == 0.0


def test_a_run_that_ends_early_keeps_its_code_and_numbers(capsys: pytest.CaptureFixture[str]) -> None:
    """The motion of `prism` diverges within 15 s by steps of half a second."""
    words = ["run", "prism", "--timestep", "0.5", "--duration", "20", "--json"]
    code = main(words)
    alone = json.loads(capsys.readouterr().out)
    assert alone["status"] == "diverged"
    assert main([*words, "--statistics", "15"]) == code != 2
    found = capsys.readouterr()
    assert json.loads(found.out)["statistics"] is None
    assert "--statistics 15: the run ended at" in found.err


def test_the_command_leaves_out_what_a_scene_has_none_of(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "swinging.toml"
    file.write_text(scene_to_toml(swinging(1).scene.with_(duration=0.2)), encoding="utf-8")
    assert main(["run", str(file), "--statistics", "0"]) == 0
    said = capsys.readouterr().out
    assert "tension of 1" in said
    assert "rod_force" not in said


def test_of_a_replay_the_time_is_held_against_the_recording(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "short.nc"
    assert main(["run", "pinned_rod", "--duration", "0.5", "--out", str(file)]) == 0
    capsys.readouterr()
    assert main(["run", "pinned_rod", "--replay", str(file), "--statistics", "1"]) == 2
    assert "--statistics 1: the run ends before" in capsys.readouterr().err


def test_a_string_with_mass_has_statistics_as_a_whole(capsys: pytest.CaptureFixture[str]) -> None:
    scene = tmj.load_scene("massive_string")
    run = tmj.simulate(scene, engine=tmj.MuJoCo(1e-3), duration=0.6)
    found = run.statistics("tension", after=0.2)
    assert found.names == ("line", *(f"line.{number}" for number in range(1, 22)))
    kept = run.time >= 0.2
    np.testing.assert_allclose(found.values[:, 0], run.tension("line")[kept], rtol=1e-13)
    np.testing.assert_array_equal(found.values[:, 21], run.tension("line.21")[kept])
    assert found.cycles("line").shape[1] == 3
    assert found.lines()[0][0] == "line"
    assert repr(found).startswith("tension of 1 and 21 parts, ")
    assert found.report()["line"]["mean"] == pytest.approx(run.tension("line")[kept].mean(), rel=1e-2)
    assert main(["run", "massive_string", "--duration", "0.6", "--statistics", "0.2"]) == 0
    assert "\nline: mean " in capsys.readouterr().out
