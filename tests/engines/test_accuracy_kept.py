"""Five runs that `accuracy=` once called accurate and that were not, and what a request may cost.

Four had steps too long for the fastest motion, the fifth one that ended early: two runs agreed on what both had wrong.
The truth is the DAE by DOP853 at rtol 1e-11 in MuJoCo's cases; in the DAE's, a coding of the same motion
by nodes and multipliers (`multipliers`), which shares neither equations nor integrator.
"""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
import pytest
from multipliers import nodes_of

import tensegrity_mj as tmj
from tensegrity_mj.engines.accuracy.ladder import CERTIFIER
from tensegrity_mj.runs.convergence import node_difference


def overdamped() -> tmj.Scene:
    """Dampers stop the structure within 4 ms, when a string slackens: three steps did not resolve that."""
    structure = tmj.Structure(
        "overdamped",
        {
            "n1": (-0.40111463915923146, 1.3542618181114783, 0.608526051823024),
            "n2": (0.15023059706430547, 0.6601640257883701, 1.134344654177651),
            "n3": (1.2822891629750723, 0.2939775696422309, -1.0952458370948266),
            "n4": (0.3597020757040137, 0.602763199848155, -0.05423866004069777),
        },
        rods=(
            tmj.Rod("r1", ("n1", "n2"), 1.3577120656593409, 0.01),
            tmj.Rod("r2", ("n3", "n4"), 0.6724947976020339, 0.01),
        ),
        strings=tuple(
            tmj.String(f"{i}{j}", (i, j), stiffness, 468.41622559101864, rest_length=rest)
            for i, j, stiffness, rest in (
                ("n1", "n3", 992.1471439622255, 2.6988287606867254),
                ("n1", "n4", 916.8632617951856, 1.0155487163455796),
                ("n2", "n3", 1157.1449216174065, 2.295942990482795),
                ("n2", "n4", 916.7204958234273, 1.1029472115515857),
            )
        ),
    )
    return tmj.Scene(structure, duration=0.05)


def short_rod() -> tmj.Scene:
    """A rod of 34 µm between strings, which turns at 700 rad/s; 20 steps in .64 s damped that away."""
    structure = tmj.Structure(
        "short rod",
        {
            "n1": (0.050405601196929835, 1.2296331847642283, -0.8545753980425589),
            "n2": (0.05038835594009496, 1.2296454971570216, -0.8546012263012136),
            "n3": (0.5475160626714172, -0.023842562619719815, 1.1191975685359008),
            "n4": (1.215601587129572, -0.46898518561207636, 0.5169839612446424),
            "n5": (0.5353005908959872, -0.5975494409834454, 1.2443806328711229),
            "n6": (0.2512746536666709, -0.7682836262422588, 0.29827195415058205),
        },
        rods=(
            tmj.Rod("r1", ("n1", "n2"), 1.7453709700229019, 0.01, tmj.Support.pinned(1.0)),
            tmj.Rod("r2", ("n3", "n4"), 1.8161498579224302, 0.01),
            tmj.Rod("r3", ("n5", "n6"), 0.6230457538816908, 0.01),
        ),
        strings=tuple(
            tmj.String(f"{i}{j}", (i, j), stiffness, rest_length=rest)
            for i, j, stiffness, rest in (
                ("n1", "n3", 20.300610989687502, 2.074588647089),
                ("n1", "n4", 7.540337706395678, 2.4721072101564947),
                ("n1", "n5", 8.104109536761099, 2.8787986407234882),
                ("n1", "n6", 17.403260825539093, 2.0524509207560206),
                ("n2", "n3", 18.099404490013946, 2.3297693345014645),
                ("n2", "n4", 22.443458463117697, 2.5781520845515784),
                ("n2", "n5", 13.225667684003925, 2.5392223260429057),
                ("n2", "n6", 12.59622808225764, 2.150800092961883),
                ("n4", "n5", 18.229598707799774, 0.8322544009530941),
            )
        ),
    )
    return tmj.Scene(structure, duration=0.6413028845259832)


def spinning() -> tmj.Scene:
    """A free rod that turns at 75 rad/s between two strings: 3.75 rad in the coarsest step, 1.25 in the last."""
    nodes = {"a": (0.0, 0.0, 0.0), "b": (1.0, 0.0, 0.0), "f": (0.3, 1.2, 0.9), "g": (-0.8, -0.7, 0.4)}
    structure = tmj.Structure(
        "spinning",
        nodes,
        rods=(tmj.Rod("rod", ("a", "b"), 1.0, 0.01, tmj.Support.free(0.5)),),
        strings=(
            tmj.String("s", ("b", "f"), 10.0, rest_length=0.5),
            tmj.String("t", ("a", "g"), 10.0, rest_length=0.6),
        ),
        fixed_nodes=("f", "g"),
    )
    tip = 75.0 * np.cross([0.0, 0.6, 0.8], [0.5, 0.0, 0.0])
    return tmj.Scene(structure, duration=1.0, initial_velocities=np.array([-tip, tip, 0 * tip, 0 * tip]))


def stiff() -> tmj.Scene:
    """Strings of 1e8 N/m: the coarsest steps were 2 and 4 vibrations' radians, and agreed to 2.6e-6 m by chance."""
    nodes = {
        "a1": (0.3020827948383591, -0.45967927992879176, 1.1650404033007806),
        "b1": (0.7151106928156892, -0.9322758011507183, 1.2947577882995693),
        "f1": (-0.4647525139483996, -0.3709639443586305, 0.42058109184521325),
        "f2": (-0.36527734582372867, -1.6354256238340747, 1.1187338698135427),
    }
    structure = tmj.Structure(
        "stiff",
        nodes,
        rods=(tmj.Rod("rod", ("a1", "b1"), 1.3187007918520977, 0.01),),
        strings=(
            tmj.String("s1", ("b1", "f1"), 138346360.4083742, rest_length=1.572044651123271),
            tmj.String("s2", ("f2", "b1"), 137608782.3987613, rest_length=1.3010159053258872),
            tmj.String("s3", ("f1", "a1"), 149339826.07600692, rest_length=1.0724394071590846),
        ),
        fixed_nodes=("f1", "f2"),
    )
    return tmj.Scene(structure, duration=0.0418)


def released() -> tmj.Scene:
    """A string slackens within the first step of any two runs, which take the same part of it; then the rod is free."""
    nodes = {"a": (0.0, 0.0, 0.0), "b": (1.0, 0.0, 0.0), "f": (1.0, 1.0, 0.0)}
    structure = tmj.Structure(
        "released",
        nodes,
        rods=(tmj.Rod("rod", ("a", "b"), 1.0, 0.01),),
        strings=(tmj.String("s", ("b", "f"), 1e6, rest_length=1.0 - 3.5e-4),),
        fixed_nodes=("f",),
    )
    velocities = np.array([(0.0, -2.0, 0.0), (0.0, 4.0, 0.0), (0.0, 0.0, 0.0)])
    return tmj.Scene(structure, duration=8e-3, initial_velocities=velocities)


CASES: dict[str, tuple[Any, Any, float]] = {
    "overdamped": (overdamped, tmj.DAE, 1.03e-5),
    "short rod": (short_rod, tmj.MuJoCo, 1.32e-5),
    "spinning": (spinning, tmj.MuJoCo, 2e-3),
    "stiff": (stiff, tmj.DAE, 4.2e-6),
    "released": (released, tmj.MuJoCo, 1e-9),
}


@pytest.mark.parametrize("name", CASES)
def test_what_is_reported_as_met_is_met(name: str) -> None:
    make, engine, accuracy = CASES[name]
    scene = make()
    run = tmj.simulate(scene, None, engine(accuracy=accuracy))
    if engine is tmj.DAE:
        error = float(np.max(np.linalg.norm(run.nodes - nodes_of(scene, run.time)[0], axis=-1)))
    else:
        tight = tmj.DAE(rtol=1e-11, atol=1e-13)
        error = node_difference(run, tmj.simulate(scene, None, tight, output_interval=float(run.time[1])))
    report = run.reports["accuracy"]
    # The references are good to 1e-9 m here, a thousandth of the least request: two tolerances of each differ by less.
    assert report["met"]
    assert error <= report["error_estimate"] <= accuracy


SCENES: dict[str, Any] = {
    "prism": lambda: tmj.load_scene("prism").with_(duration=2.0),
    "overdamped": overdamped,
    "spinning": lambda: spinning().with_(duration=0.3),
}


@pytest.mark.parametrize("engine", [tmj.MuJoCo, tmj.DAE])
@pytest.mark.parametrize("name", SCENES)
def test_a_looser_request_never_costs_more(name: str, engine: Any) -> None:
    """Its runs are the first of those of a tighter one, so that there is no slack to allow for.

    MuJoCo's are those of the DAE that certifies one of its runs.
    """
    scene = SCENES[name]()
    law = None if scene.control is None else tmj.controllers.from_scene(scene)
    costs, tried = [], []
    for decade in range(2, 7):
        report = tmj.simulate(scene, law, engine(accuracy=10.0**-decade)).reports["accuracy"]
        assert report["met"]
        costs.append(report["total_cost"]["evaluations"])
        rows = [one for one in report["tried"] if engine is tmj.DAE or one["method"] == CERTIFIER]
        tried.append([{k: v for k, v in one.items() if k != "difference"} for one in rows])
    assert costs == sorted(costs)
    assert costs[0] < costs[-1]  # or nothing was tried
    for looser, tighter in itertools.pairwise(tried):
        assert tighter[: len(looser)] == looser
