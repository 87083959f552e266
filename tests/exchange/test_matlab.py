"""STEDY, MOTES and TsgFEM: published structures against what these programs computed, and what is refused."""

from __future__ import annotations

import struct
import zlib
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import truth
from scipy.io import savemat
from scipy.sparse import csc_matrix

import tensegrity_mj as tmj
from tensegrity_mj.exchange import Imported, ImportOptions, import_scene
from tensegrity_mj.exchange.matlab_script import data_of, evaluate

DATA = Path(__file__).resolve().parents[1] / "data" / "exchange"
SQUARE = np.array([[-1.0, 0, 1, 0], [0, -1, 0, 1], [0, 0, 0, 0]])
SIDES = np.array([[-1, 1, 0, 0], [0, -1, 1, 0], [0, 0, -1, 1], [1, 0, 0, -1]])
DIAGONALS = np.array([[-1, 0, 1, 0], [0, -1, 0, 1]])


def saved(folder: Path, **values: Any) -> Path:
    path = folder / "data.mat"
    savemat(path, values)
    return path


def at(found: Imported, times: list[float]) -> np.ndarray:
    """Node positions (len(times), N, 3) of the scene under the DAE."""
    run = tmj.simulate(found.scene, None, tmj.DAE(), duration=times[-1], output_interval=0.1)
    return np.array([run.nodes[int(np.argmin(np.abs(run.time - time)))] for time in times])


@pytest.mark.parametrize(
    ("script", "data", "bound"),
    # STEDY's own bounds of these files (tests/data/truth/README.md): 6.9e-14 m against itself and 5.6e-14 m against a
    # second code, and 1.0e-8 m and 1.0e-10 m. The first bound is that of tests/engines/test_truth.py.
    [("stedy_tbar.m", "stedy_tbar_undamped", 1e-10), ("stedy_dbar.m", "stedy_dbar", 2e-8)],
)
def test_structures_of_stedy_are_its_own_and_move_as_it_computes(script: str, data: str, bound: float) -> None:
    found, own = import_scene(DATA / script), truth.load(data)
    structure = found.scene.structure
    np.testing.assert_array_equal(structure.positions, own["N0"].T)
    for ours, theirs in (("stiffness", "k"), ("rest_lengths", "L0"), ("rod_masses", "bar_mass"), ("damping", "c")):
        # The same products of the same numbers; their order may differ.
        np.testing.assert_allclose(getattr(structure, ours), own[theirs], rtol=4e-16, atol=0)
    run = tmj.simulate(found.scene, None, tmj.DAE(rtol=1e-12, atol=1e-13), output_interval=float(own["t"][1]))
    assert np.abs(run.nodes - own["pos"]).max() < bound


def test_the_cross_bar_of_motes_moves_as_it_computes(tmp_path: Path) -> None:
    """07_Example_Class_1_Cross_Bar_Dynamics: History.Nhist at 1, 2 and 5 s, of ode4 with steps of 1 ms."""
    rest = np.sqrt(2) * np.array([0.7, 0.5, 0.7, 0.5])
    cross = {"N": SQUARE, "C_b": DIAGONALS, "C_s": SIDES, "s_0": rest, "tf": 5.0, "dt": 0.001, "video": 0}
    found = import_scene(saved(tmp_path, Cross_bar=cross, segments=1.0))
    published = {
        1.0: (-0.9782701128874587, 0.20733446062861158),
        2.0: (-0.9531794074508773, 0.302405336273429),
        5.0: (-0.9473761123219098, 0.32012234441816595),
    }
    # Classical Runge-Kutta is off by A ω t (ω h)⁴ / 120 of an oscillator. The bars turn with moments of inertia of
    # 1 kg (2 m)² / 12 against strings of 100 N/m at arms of 1 m / √2: ω² is at most 4 * 50 / (1/3), ω = 25 rad/s. With
    # A = 0.35 m, t = 5 s: 0.35 * 125 * 0.025⁴ / 120 = 1.4e-7 m; times two for the four stages' nonlinear terms.
    places = at(found, list(published))
    for place, numbers in zip(places, published.values(), strict=True):
        np.testing.assert_allclose(place[0, :2], numbers, rtol=0, atol=2.8e-7)
    assert "variables that are not used: Cross_bar.dt, Cross_bar.video, segments" in found.notes


MOTES_BAR = {0.5: (-0.7979797060005158, -1.3997098988048933), 1.0: (-0.07555541575989475, -1.0702346521530488)}


def class_k(folder: Path) -> Path:
    """The same as MOTES has it for its solver: each bar with nodes of its own, joined and pinned by N P = D."""
    C_b = np.zeros((4, 8))
    for row, (i, j) in enumerate([(8, 1), (5, 2), (6, 3), (7, 4)]):
        C_b[row, [i - 1, j - 1]] = -1, 1
    C_s = np.zeros((2, 8))
    C_s[0, [1, 3]], C_s[1, [0, 2]] = (-1, 1), (-1, 1)
    P, D = np.vstack([np.eye(4), -np.eye(4)]), np.zeros((3, 4))
    P, D = np.column_stack([P, np.eye(8)[0]]), np.column_stack([D, SQUARE[:, 0]])
    test = {"N": np.hstack([SQUARE, SQUARE]), "C_b": C_b, "C_s": C_s, "P": P, "D": D, "s_0": [1, 0.5], "tf": 5.0}
    # Beside it stands what other calls used: the structure that the solver was given holds.
    return saved(folder, classK_test=test, s_0=np.array([1.4, 1.4]), N_simple=SQUARE, C_b=SIDES)


@pytest.mark.parametrize("source", ["script", "matrices"])
def test_the_d_bar_of_motes_moves_as_it_computes(source: str, tmp_path: Path) -> None:
    """02_Example_Class_K_Dbar_Dynamics: node 2 of History.Nhist at 0.5 and 1 s; joined by P and D, or by numbers."""
    found = import_scene(DATA / "motes_dbar.m" if source == "script" else class_k(tmp_path))
    structure = found.scene.structure
    assert (len(structure.nodes), len(structure.rods), len(structure.strings), structure.class_number) == (4, 4, 2, 2)
    # Strings slacken. A step in which one does is off by a force k v h for a time h: by k v h² / m in velocity, 100 N/m
    # 6 m/s (1 ms)² / 1 kg = 6e-4 m/s, of which stages of Runge-Kutta average all but some percent; 1 % for 1 s.
    places = at(found, list(MOTES_BAR))
    for place, numbers in zip(places, MOTES_BAR.values(), strict=True):
        np.testing.assert_allclose(place[1, :2], numbers, rtol=0, atol=6e-6)


def residual(structure: tmj.Structure, bars: np.ndarray) -> float:
    """The largest force [N] at a node from strings and bars of these force densities (positive in tension)."""
    nodes = structure.positions
    u = structure.stiffness * (1 - structure.rest_lengths / structure.string_lengths(nodes))
    force = np.zeros_like(nodes)
    for pairs, densities in ((structure.string_nodes, u), (structure.rod_nodes, bars)):
        for (i, j), q in zip(pairs, densities, strict=True):
            force[i] += q * (nodes[j] - nodes[i])
            force[j] -= q * (nodes[j] - nodes[i])
    return float(np.abs(force).max())


def test_the_lander_of_tsgfem_is_in_its_published_equilibrium(tmp_path: Path) -> None:
    """Statics example 03_lander: q is -1e5 N/m in bars, 66666.6667 N/m in strings; E, A, l0, mass of its .mat file."""
    h, c, s = 0.5, 2 / np.sqrt(5), -1 / np.sqrt(5)  # of th1 = -atan(1/2)
    flat = [[h / 2, 0, 0], [h / 2, 0, 1], [-h / 2, 0, 0], [-h / 2, 0, 1], [0, -h, 0.75], [0, h, 0.75], [0, -h, 0.25]]
    flat += [[0, h, 0.25], [h, -h / 2, h], [-h, -h / 2, h], [h, h / 2, h], [-h, h / 2, h]]
    N = np.array([[1, 0, 0], [0, c, -s], [0, s, c]]) @ np.array(flat).T + np.array([[0.0], [0], [2]])
    bars = np.array([[1, 2], [3, 4], [5, 6], [7, 8], [9, 10], [11, 12]])
    strings = np.array(
        [[2, 5], [2, 6], [2, 9], [2, 11], [4, 5], [4, 6], [4, 10], [4, 12], [1, 7], [1, 8], [1, 9], [1, 11]]  # noqa: RUF005
        + [[3, 7], [3, 8], [3, 10], [3, 12], [5, 9], [5, 10], [7, 9], [7, 10], [6, 11], [6, 12], [8, 11], [8, 12]]
    )
    E = np.repeat([206043956043.95602, 75998509224.17542], [6, 24])
    A, l0 = np.repeat([0.002485851, 0.000333672], [6, 24]), np.repeat([1.000195276, 0.611388162], [6, 24])
    q = np.repeat([-1e5, 66666.666666667], [6, 24])
    common = {"N": N, "C_b_in": bars, "C_s_in": strings, "E": E, "A": A, "sigmas": 1223.5e6, "sigmab": 300e6}
    common |= {"mass": np.repeat([978.373442205, 1.605506835], [6, 24]), "rho_s": 7870.0, "pinned_X": np.zeros((0, 0))}
    # Printed with ten digits: u = E A (L - l0) / (l0 L) of l0 loses 5e-10 / (L - l0), 5e-7 of it at L - l0 = 1e-3 m.
    for more, tolerance in (({"l0": l0}, 2e-6), ({"q": q}, 1e-12)):
        found = import_scene(saved(tmp_path, **common, **more))
        structure = found.scene.structure
        assert (len(structure.nodes), len(structure.rods), len(structure.strings)) == (12, 6, 24)
        u = structure.stiffness * (1 - structure.rest_lengths / structure.string_lengths(structure.positions))
        np.testing.assert_allclose(u, 66666.666666667, rtol=tolerance)
        # Four strings and a bar meet at each node.
        assert residual(structure, q[:6]) < 5 * tolerance * 1e5 + 1e-8
        np.testing.assert_allclose(structure.rod_masses, 978.373442205, rtol=1e-12)
        assert structure.rods[0].section is not None
        assert structure.rods[0].section.yield_stress == 300e6
        assert structure.strings[0].strength == pytest.approx(1223.5e6 * 0.000333672)
        notes = " ".join(found.notes)
        assert "strings have no mass here: theirs (38.53 kg in all) is left out" in notes  # 24 * 1.605506835
        assert "bars are elastic in the program" in notes


def test_the_half_t_bar_of_tsgfem_is_in_its_published_equilibrium(tmp_path: Path) -> None:
    """Statics example 06_half_Tbar: forces -50 N in the bar and 35.355339059 N in both strings."""
    values = {
        "N": np.array([[-1, 0, 1, 0], [0, 0, 0, 0], [0, 0, 0, 1]]),
        "C": np.array([[0, -1, 0, 1], [-1, 0, 0, 1], [0, 0, -1, 1]]),
        "index_b": np.array([[1]]),
        "q": np.array([-50.0, 25, 25]),
        "E": np.full(3, 206043956043.95602),
        "A": np.array([5.5585e-05, 1.179e-06, 1.179e-06]),
        "mass": np.array([0.43745839, 0.013114757, 0.013114757]),
        "pinned_X": np.array([[1], [2], [3]]),
        "pinned_Y": np.array([[1], [2], [3], [4]]),
        "pinned_Z": np.array([[1], [2], [3]]),
    }
    structure = import_scene(saved(tmp_path, **values)).scene.structure
    tension = structure.stiffness * (structure.string_lengths(structure.positions) - structure.rest_lengths)
    # A difference of lengths of 1.4 m that is 2e-4 of E A's strain: round-off of 1e-16 * 1.4 m times 1.7e5 N/m.
    np.testing.assert_allclose(tension, 35.355339059, rtol=0, atol=1e-9)
    assert structure.fixed_nodes == ("n1", "n3")
    assert structure.rods[0].support == tmj.Support.pinned(0.0, plane=(0, 1, 0))
    assert "n4" in structure.nodes


def test_forces_of_motes_stand_with_the_strings_first(tmp_path: Path) -> None:
    """00_Software_Verification_D_bar_Statics: Force_den of two strings, then four bars, under W = ±10,000 N."""
    bars = np.array([[1, 2], [2, 3], [3, 4], [4, 1]])
    W = np.zeros((3, 4))
    W[0, 0], W[0, 2] = 10000, -10000
    force = np.array([0.00015155262799071076, 5000.000151552628, *[5000.000151552628] * 4])
    values = {"N": SQUARE, "C_b_in": bars, "C_s_in": np.array([[1, 3], [2, 4]]), "W": W, "Force_den": force}
    options = ImportOptions(rod_mass=2.091778532528808, stiffness=1e6)  # Mass_bar of the same file
    found = import_scene(saved(tmp_path, **values), options=options)
    structure, scene = found.scene.structure, found.scene
    u = structure.stiffness * (1 - structure.rest_lengths / structure.string_lengths(structure.positions))
    # L0 = L (1 - u/k) keeps 1e-16 of L, which is 1e-16 of k in u.
    np.testing.assert_allclose(u, force[:2], rtol=0, atol=4e-10)
    assert {load.node: load.force[0] for load in scene.loads} == {"n1": 10000.0, "n3": -10000.0}
    pull = np.zeros((4, 3))
    for pairs, densities in ((structure.string_nodes, u), (structure.rod_nodes, -force[2:])):
        for (i, j), q in zip(pairs, densities, strict=True):
            pull[i] += q * (structure.positions[j] - structure.positions[i])
            pull[j] -= q * (structure.positions[j] - structure.positions[i])
    assert np.abs(pull + scene.nodal_forces(0.0)).max() < 1e-7  # of 10,000 N and 1e-12 of its digits, and of u
    assert "the import's options" in " ".join(found.notes)


def test_all_forms_of_numbers_are_read(tmp_path: Path) -> None:
    values = {
        "N": SQUARE.astype(np.int16),
        "C_b": csc_matrix(DIAGONALS.astype(float)),
        "C_s": SIDES.astype(np.int8),
        "k": np.float32(50),
        "m": np.uint8(2),
        "c": 0.5,
        "g": np.array([0, 0, -9.8]),
        "Nd0": np.zeros((3, 4)),
        "ms": np.zeros((0, 0)),
        "words": "text",
        "cells": np.array([1, "two"], dtype=object),
        "deep": {"inner": {"number": 3.0}},
        "turned": 1 + 2j,
    }
    found = import_scene(saved(tmp_path, **values))
    structure = found.scene.structure
    assert [rod.nodes for rod in structure.rods] == [("n1", "n3"), ("n2", "n4")]
    assert set(structure.stiffness) == {50.0}
    assert set(structure.damping) == {0.5}
    assert found.scene.gravity == (0, 0, -9.8)
    notes = " ".join(found.notes)
    assert "not read, as they are no numbers: words, cells, turned" in notes
    assert "variables that are not used: ms, deep" in notes
    assert "0.01 m; it changes pictures and contact only" in notes


@pytest.mark.parametrize("given", ["force density", "rest length"])
def test_the_stiffness_of_a_string_is_that_of_its_rest_length(given: str, tmp_path: Path) -> None:
    """k = E A / L0, with L0 = L (1 - q/k) of a force density q: E A / L + q; the tension is q L."""
    E, area, q = 1e5, 2e-3, np.array([30.0, 40.0, 50.0, 60.0])
    length = np.full(4, np.sqrt(2))
    rest = length * (1 - q / (E * area / length + q))
    own = {"q": q} if given == "force density" else {"s_0": rest}
    data = {"N": SQUARE, "C_b": DIAGONALS, "C_s": SIDES, "m": 1.0, "Es": E, "A_s": area, "r_s": 0.5} | own
    found = import_scene(saved(tmp_path, **data)).scene.structure  # a radius beside the area is not used
    # Some operations on numbers of that size.
    np.testing.assert_allclose(found.stiffness, E * area / length + q, rtol=1e-14)
    np.testing.assert_allclose(found.rest_lengths, rest, rtol=1e-14)
    np.testing.assert_allclose(found.stiffness * (length - found.rest_lengths), q * length, rtol=1e-12)


GOOD: dict[str, Any] = {"N": SQUARE, "C_b": DIAGONALS, "C_s": SIDES, "m": 1.0, "k": 10.0}


@pytest.mark.parametrize(
    "given",
    [
        {"Pinned_nodes": np.array([[1.0, 1, 1, 1], [3, 0, 0, 1]])},
        {"fixedNodes": np.array([[1.0, 0, 0, 0], [1, 0, 0, 0], [1, 0, 1, 0]])},
        {"pinned_X": 1.0, "pinned_Y": 1.0, "pinned_Z": np.array([1.0, 3])},
        {"pinned_nodes": 1.0, "pinned_Z": 3.0},
    ],
    ids=["rows", "matrix", "axes", "nodes"],
)
def test_supports_are_the_same_in_every_form(given: dict[str, Any], tmp_path: Path) -> None:
    """Node 1 is held in all axes and node 3, the bar's other end, in z: the bar is pinned, and turns in its plane."""
    structure = import_scene(saved(tmp_path, **GOOD, **given)).scene.structure
    first, second = structure.rods
    assert first.nodes == ("n1", "n3")
    assert first.support == replace(tmj.Support.pinned(0.0), plane=(0.0, 0.0, 1.0))
    assert second.support == tmj.Support()


WRONG: dict[str, tuple[dict[str, Any], str]] = {
    "no nodes": ({"N": None}, "there is no variable N (3, n) of nodes; read were: C_b, C_s, m, k"),
    "nodes of a wrong shape": ({"N": np.ones((2, 4))}, "N: its shape is (2, 4); it must be (3, n), a column a node"),
    "a node that is no number": ({"N": SQUARE * np.nan}, "N: every number must be finite"),
    "no members": ({"C_b": None, "C_s": None}, "there is no connectivity"),
    "bars that are not said": ({"C_b": None, "C_s": None, "C": SIDES}, "C: which of its rows are bars: give nBar"),
    "more bars than rows": ({"C_b": None, "C_s": None, "C": SIDES, "nBar": 9}, "and it has 4 rows"),
    "rows without ends": ({"C_s": np.abs(SIDES)}, "C_s: each row must have one -1"),
    "ends that are no signs": ({"C_s": 2 * SIDES}, "C_s: its shape is (4, 4); it must be (m, 4) of -1, 0 and 1"),
    "connectivity of a wrong shape": ({"C_s": np.ones((4, 3))}, "C_s: its shape is (4, 3); it must be (m, 4)"),
    "nodes that are not there": ({"C_s": np.array([[1, 5]])}, "C_s: node numbers from 1 to 5; they must be 1 to 4"),
    "no masses": ({"m": None}, "it gives no masses of bars (m, mass, or bars.rho with bars.r); add --rod-mass"),
    "no stiffness": ({"k": None}, "it gives no stiffness of strings (k, or E with r or A); add --stiffness"),
    "a value too few": ({"k": np.ones(3)}, "k: 3 values; it must have one, or 4: one a string"),
    "a pushing string": ({"sigma": -1.0}, "string s1: force density -1 N/m; strings only pull"),
    "a support elsewhere": ({"pinned_nodes": 7}, "pinned_nodes: node 7; it must be one of 1 to 4"),
    "supports of a wrong shape": ({"fixedNodes": np.ones((3, 3))}, "fixedNodes: its shape is (3, 3)"),
    "rows of supports": ({"Pinned_nodes": np.ones((2, 3))}, "Pinned_nodes: its shape is (2, 3); it must be (m, 4)"),
    "gravity in a plane": ({"g": np.ones(2)}, "g: 2 values; gravity must be three numbers"),
    "forces of a wrong shape": ({"W": np.ones((3, 3))}, "W: its shape is (3, 3); forces of nodes must be (3, 4), as N"),
    "a mass of nothing": ({"m": 0.0}, "rod 'b1': mass = 0.0; it must be > 0 kg"),
    "a string too short": ({"s_0": -1.0}, "string 's1': rest_length = -1.0"),
    "a free node without mass": ({"C_b": DIAGONALS[:1]}, "it gives no point masses (Mp, ms); add --node-mass"),
}


@pytest.mark.parametrize("case", WRONG)
def test_what_is_wrong_in_data_is_named_in_one_line(case: str, tmp_path: Path) -> None:
    changes, message = WRONG[case]
    values = {key: value for key, value in (GOOD | changes).items() if value is not None}
    path = saved(tmp_path, **values)
    with pytest.raises(tmj.TensegrityError) as error:
        import_scene(path)
    assert message in str(error.value)
    assert str(error.value).startswith(str(path))
    assert "\n" not in str(error.value)


def test_packed_data_as_matlab_saves_them_are_the_same(tmp_path: Path) -> None:
    plain, packed = tmp_path / "plain.mat", tmp_path / "packed.mat"
    for path in (plain, packed):
        savemat(path, GOOD, do_compression=path == packed)
    assert packed.read_bytes()[128] == 15  # packed elements
    ours, theirs = (import_scene(path).scene.structure for path in (packed, plain))
    assert (ours.nodes, ours.rods, ours.strings) == (theirs.nodes, theirs.rods, theirs.strings)
    assert ours.fixed_nodes == theirs.fixed_nodes


def test_broken_and_hostile_data_are_refused(tmp_path: Path) -> None:
    whole = saved(tmp_path, **GOOD).read_bytes()
    header = whole[:128]

    def matrix(kind: int, shape: list[int], name: bytes, inside: bytes = b"") -> bytes:
        parts = struct.pack("<IIII", 6, 8, kind, 0)
        parts += struct.pack("<II", 5, 4 * len(shape)) + struct.pack(f"<{len(shape)}i", *shape)
        parts += b"\0" * (-len(parts) % 8) + struct.pack("<II", 1, len(name)) + name + b"\0" * (-len(name) % 8)
        parts += inside
        return struct.pack("<II", 14, len(parts)) + parts

    bomb = zlib.compress(b"\0" * 110_000_000)
    huge = struct.pack("<II", 9, 8) + struct.pack("<d", 1.0)
    cases = {
        b"": "no MATLAB file of level 5",
        b"MATLAB 7.3 MAT-file" + header[19:]: "version 7.3",
        b"\x89HDF\r\n\x1a\n": "version 7.3",
        header: "there is no variable N",
        header + whole[128:-20]: "it ends within an element",
        header + struct.pack("<II", 15, len(bomb)) + bomb: "more than 100 MB when unpacked",
        header + struct.pack("<II", 15, 8) + b"no zlib!": "a broken MATLAB file",
        header + matrix(6, [40000, 40000], b"N", huge): "1 numbers for a shape of [40000, 40000]",
        header + matrix(1, [40000, 40000], b"N"): "there is no variable N",  # cells are not made
        header + matrix(2, [40000, 40000], b"N"): "there is no variable N",
        header + matrix(6, [-1, -1], b"N", huge): "a broken MATLAB file",
    }
    for content, message in cases.items():
        path = tmp_path / "hostile.mat"
        path.write_bytes(content)
        with pytest.raises(tmj.TensegrityError, match=message.replace("[", r"\[")):
            import_scene(path)
    generator = np.random.default_rng(7)
    for _ in range(300):  # whatever is changed in a good file: a scene, or a clear refusal
        content = bytearray(whole)
        for place in generator.integers(128, len(whole), 4):
            content[place] = generator.integers(256)
        path.write_bytes(bytes(content))
        try:
            import_scene(path)
        except tmj.TensegrityError as error:
            assert "\n" not in str(error)  # noqa: PT017


EXPRESSIONS: dict[str, Any] = {
    "[1 2; 3 4]": [[1, 2], [3, 4]],
    "[1 -2]": [[1, -2]],
    "[1 - 2]": [[-1]],
    "[1, -2\n 3 4]'": [[1, 3], [-2, 4]],
    "-2^2": [[-4]],
    "2^-1 + 1d1/4": [[3]],
    "2:4": [[2, 3, 4]],
    "0:0.5:1.5": [[0, 0.5, 1, 1.5]],
    "3:-1:1": [[3, 2, 1]],
    "[a' a']": [[1, 3, 1, 3], [2, 4, 2, 4]],
    "a'*a": [[10, 14], [14, 20]],
    "a.*a": [[1, 4], [9, 16]],
    "2*a./a": [[2, 2], [2, 2]],
    "12./a": [[12, 6], [4, 3]],
    "a(2,:)": [[3, 4]],
    "a(:,1)": [[1], [3]],
    "a(3)": [[2]],
    "[-eye(2) zeros(2,1)]": [[-1, 0, 0], [0, -1, 0]],
    "ones(size(a))": [[1, 1], [1, 1]],
    "size(a,1)": [[2]],
    "[]": np.zeros((0, 0)),
    "sqrt(4)*cos(0) + abs(-3)": [[5]],
    "2*pi - s.r(1)": [[2 * np.pi - 7]],
}


@pytest.mark.parametrize("text", EXPRESSIONS)
def test_expressions_have_matlabs_values(text: str) -> None:
    values = {"a": np.array([[1.0, 2], [3, 4]]), "s.r": np.array([[7.0]])}
    np.testing.assert_array_equal(evaluate(text, values), np.array(EXPRESSIONS[text], float))


@pytest.mark.parametrize(
    "text",
    [
        "system('touch /tmp/x')",
        "__import__('os')",
        "a.__class__",
        "ones(1e9)",
        "ones(1,2,3)",
        "1:1e12",
        "a^2",
        "a/a",
        "a*[1 2 3]",
        "a(9,1)",
        "a(0)",
        "eval(a)",
        "lambda x: x",
        "(" * 400 + "1" + ")" * 400,
        "1 if 1 else 2",
        "a{1}",
        "@(x) x",
        "M(1)",
        "unknown",
        "a b",
    ],
)
def test_what_is_no_data_is_not_evaluated(text: str) -> None:
    values, unread = data_of(f"a = [1 2; 3 4]; b = {text};")
    assert set(values) == {"a"}
    assert unread[0].startswith("line 1: b = ")


def test_a_variable_that_is_changed_by_code_is_not_known_any_more() -> None:
    text = """
N = [0 1; 0 0; 0 0]; k = 3; c = 1; s.m = 2; t.m = 4; w = 1;
for i = 1:3, N(1,1) = i; end
if k > 2
  c = 7;
end
[s, q] = solve(k);
t = load('x.mat');
w = kron(N, N);
A = zeros(2,2); A(1,2) = 5; A(:,1) = [8 9]; % columns take rows of their size
"""
    values, unread = data_of(text)
    assert set(values) == {"k", "A"}
    np.testing.assert_array_equal(values["A"], [[8, 5], [9, 0]])
    assert any("line 3: for i = 1:3" in line for line in unread)
    assert any("line 9: w = kron(N, N)" in line for line in unread)


def test_matrices_are_limited_before_they_are_made() -> None:
    many = "; ".join(f"a{number} = ones(1000,1500)" for number in range(40))
    values, unread = data_of(many + "; b = [" + "ones(1000,1500) " * 2_000 + "];")
    # 1.5 million numbers each: seven fit into ten million, and one more is kept before the sum is above.
    assert len(values) == 7
    assert "more numbers than are kept" in unread[0]
    assert "a matrix that is too large" in unread[-1]


def test_scripts_list_what_is_not_read_and_say_it_in_errors(tmp_path: Path) -> None:
    notes = " ".join(import_scene(DATA / "stedy_tbar.m").notes)
    for part in (
        "line 9: tData = tensegConstruct",
        "line 17: disp('...')",
        "line 18: if tEnd > 5",
        "line 19: note = 1",
    ):
        assert part in notes
    path = tmp_path / "made.m"
    path.write_text("N = make_nodes(3);\n")
    with pytest.raises(
        tmj.TensegrityError, match=r"made\.m: there is no variable N .*not read as data: line 1: N = make"
    ):
        import_scene(path)


def test_a_ladder_of_stedy_is_held_at_both_ends(tmp_path: Path) -> None:
    """Its foot's z and its head's x are fixed: cos φ falls as energy has it, φ̇² = 3 g (cos φ₀ - cos φ)/ℓ."""
    phi, length, g = 0.4, 2.0, 9.81
    nodes = length * np.array([[np.sin(phi), 0], [0, 0], [0, np.cos(phi)]])
    fixed = np.array([[0.0, 1], [1, 1], [1, 0]])
    path = saved(tmp_path, N=nodes, C_b=[[-1.0, 1]], fixedNodes=fixed, m=3.0, g=[0, 0, -g], tf=0.6)
    found = import_scene(path)
    assert [one.name for one in found.scene.structure.constraints] in (["n1 z"], ["n2 x"])
    for engine in (tmj.MuJoCo(timestep=1e-3), tmj.DAE(rtol=1e-11, atol=1e-12)):
        run = tmj.simulate(found.scene, None, engine, output_interval=0.1)
        cosine, rate = run.nodes[:, 1, 2] / length, run.velocities[:, 0, 0] / run.nodes[:, 1, 2]
        assert np.abs(run.nodes[:, 0, 2]).max() < 1e-10
        assert np.abs(run.nodes[:, 1, 0]).max() < 1e-10
        # An error of RK4 of 1e-11 m, by rates of 3 /s and an angle of 0.4 rad.
        np.testing.assert_allclose(rate**2, 3 * g * (np.cos(phi) - cosine) / length, atol=1e-8)


def test_weighted_nodes_of_motes_keep_their_place(tmp_path: Path) -> None:
    """N P = D of a bar's middle is what a support at its middle says."""
    nodes = np.array([[0.0, 1], [0, 0.3], [0, 0.2]])
    motes = {"C_b": [[-1.0, 1]], "m": 1.0, "Nd0": [[0.0, 0], [0.8, -0.8], [-1.2, 1.2]], "tf": 0.5, "N": nodes}
    P = np.array([[0.5], [0.5]])
    found = import_scene(saved(tmp_path, **motes, P=P, D=nodes @ P, g=[0, 0, -9.81]))
    structure = found.scene.structure
    assert [one.name for one in structure.constraints] == ["P1 x", "P1 y", "P1 z"]
    rod = replace(structure.rods[0], support=tmj.Support.pinned(0.5))
    held = found.scene.with_(structure=replace(structure, rods=(rod,), constraints=()))
    engine = tmj.DAE(rtol=1e-11, atol=1e-12)
    one, other = (tmj.simulate(scene, None, engine, output_interval=0.1) for scene in (found.scene, held))
    assert np.abs(one.nodes - other.nodes).max() < 1e-9
    mujoco = tmj.simulate(found.scene, None, tmj.MuJoCo(timestep=1e-3), output_interval=0.1)
    assert np.abs(mujoco.nodes - other.nodes).max() < 1e-9
    # The middle carries the weight; in x and y nothing pulls.
    np.testing.assert_allclose(one.constraint_forces, np.tile([0, 0, 9.81], (len(one.time), 1)), atol=1e-8)
