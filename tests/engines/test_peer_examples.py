"""Examples of STEDY and MOTES as scene files: as they publish them to move, and as a coding by their nodes says.

Those that needed masses on strings, N P = D, nodes held in two coordinates, or soft bars. `tests/data/peers/README.md`
has their sources.
"""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np
import peer_examples
import pytest

import tensegrity_mj as tmj

FOLDER = Path(__file__).resolve().parents[1] / "data" / "peers"


class Case(NamedTuple):
    """How an example is met.

    Attributes:
        duration: [s].
        step: of RK4 in MuJoCo, where strings that go slack are located [s].
        omega, size: the fastest oscillation [rad/s], and its amplitude [m], for the error of RK4.
    """

    duration: float
    step: float
    omega: float
    size: float


CASES = {
    "motes_double_pendulum": Case(2.0, 2e-3, 10.0, 1.0),  # turns at up to 10 rad/s
    "motes_string_only": Case(2.0, 2e-3, 20.0, 0.5),  # √(4 k/m)
    "motes_dbar_constraint": Case(0.6, 2e-3, 25.0, 1.0),  # √(4 · 50/(1/3)); at 0.66 s the square is flat
    "motes_pendulum": Case(2.0, 2e-3, 15.0, 1.0),  # √(3 · 10 N/(1 kg m) + (10 /s)²) at most
    "motes_x": Case(0.5, 1e-3, 200.0, 0.1),  # √(4 k/10 g), of which 10 m/s make 0.1 m
    "motes_prism": Case(0.5, 5e-4, 90.0, 0.05),  # √(4 k/50 g)
    "stedy_tbar_soft": Case(0.5, 2e-4, 707.0, 7e-5),  # √(12 k/m), and how far its bars are compressed
    "stedy_tbar_flex": Case(0.02, 4e-5, 13900.0, 8e-7),
    "stedy_strut3": Case(0.125, 5e-5, 1600.0, 5e-4),
    "stedy_ball_soft": Case(0.025, 5e-5, 3500.0, 2.5e-4),
    "stedy_plate": Case(0.04, 2e-5, 13900.0, 1e-5),
}


def load(name: str) -> tmj.Scene:
    return tmj.load_scene(FOLDER / f"{name}.toml")


@pytest.mark.slow
@pytest.mark.parametrize("name", CASES)
def test_engines_move_them_as_a_coding_by_nodes_does(name: str) -> None:
    """The DAE integrates to 1e-12 of 1 m in each of some thousand steps: 1e-9 m, and a factor for growth of 2.

    A step within which a string goes slack errs by more than DOP853's estimate of order 5, whose weights cancel for
    some places of the kink. Near these the estimate is linear in the place, so that a step errs by R times it in a part
    1/R of such steps: of some fifty, a run rarely has one of 1e3. That times a growth of 20 is 2e-8 m.

    RK4 is off by A ω t (ω h)⁴/120 of an oscillator, and by no more than 2 A. Ten times as much for what else moves, and
    an eighth at most of that at half the step: order 3, or half where a damper begins at once (`tbar_soft`).
    """
    case, scene = CASES[name], load(name)
    times = np.linspace(0.0, case.duration, 11)
    example = getattr(peer_examples, name)()
    truth = example.motion(times, 1e-13 if example.bar_stiffness is None else 1e-11)
    assert np.abs(truth - truth[0]).max() > 1e-3
    N = truth.shape[1]  # behind them, those of bars that N P = D joins to them
    assert scene.structure.node_names[:N] == tuple(f"n{i + 1}" for i in range(N))

    def error(engine: tmj.DAE | tmj.MuJoCo) -> float:
        run = tmj.simulate(scene, None, engine, duration=case.duration, output_interval=case.duration / 10)
        return float(np.abs(run.nodes[:, :N] - truth).max())

    exact = error(tmj.DAE(rtol=1e-12, atol=1e-13))
    assert exact < 2e-8
    coarse, fine = (error(tmj.MuJoCo(step, locate_slack=True)) for step in (case.step, case.step / 2))
    print(f"{name}: DAE {exact:.1e} m, MuJoCo {coarse:.1e} m, {fine:.1e} m")
    growth = case.omega * case.duration * (case.omega * case.step) ** 4 / 120
    assert coarse < 10 * case.size * min(2.0, growth) + 1e-9
    assert fine < coarse / (2 if name == "stedy_tbar_soft" else 8) + exact


# Node (counted from 1) and its x and y at times [s]: of the files History that MOTES publishes beside its examples, by
# ode4 with steps of 1 ms (50 ms for 03), and of the analytical solution of 00.
PUBLISHED = {
    "motes_double_pendulum": {
        1.0: (4, -1.2990630125562799, -1.5076485749103214),
        2.0: (4, 0.8360162309091402, -1.7730198709721083),
        5.0: (4, 1.3403149308133377, -1.479351901526843),
    },
    "motes_string_only": {
        1.0: (1, 0.10929899399225394, 0.6522910762613822),
        2.0: (1, 0.39269855691687267, 0.8063412546598163),
        5.0: (1, 0.8424695094426975, 0.9018062099185219),
    },
    "motes_dbar_constraint": {0.1: (3, 0.8987818502211685, 0.8987818502211659)},
    "motes_pendulum": {
        1.0: (2, -0.8989115481375243, 0.4381301503275722),
        2.0: (2, 0.9100154558164454, 0.4145743240651982),
        5.0: (2, -0.8980930005386061, -0.43980559613053494),
    },
    "motes_x": {0.1: (5, 6.0, 1.313835585626473)},
}
# [m] per second of motion.
PUBLISHED_ERROR = {
    # ode45 and the DAE at 1e-12 of each; two pendulums part by a factor of 100 or less in 5 s.
    "motes_double_pendulum": 1e-9,
    # A string that slackens or tightens at 0.7 m/s is off by k v h = 0.07 N for a step, which stages of Runge-Kutta
    # average but for some 10 %: 7e-6 m/s each.
    "motes_string_only": 7e-6,
    # 50 ms: ω (ω h)⁴/120 = 25 /s · 2 % of the 0.1 m that it has moved.
    "motes_dbar_constraint": 0.05,
    # ω (ω h)⁴/120 of 1 m = 6e-9 m/s, and as much for the bar, whose length is corrected.
    "motes_pendulum": 1.3e-8,
    # It starts at 10 m/s where strings begin to pull: k v h = 1 N each of two strings on 10 g, 10 % of it for a step as
    # above, make 0.02 m/s, which oscillates with √(2 k/m) = 140 /s or less: 1.7e-4 m, after 0.1 s.
    "motes_x": 1.7e-3,
}


@pytest.mark.parametrize("name", PUBLISHED)
def test_they_move_as_motes_publishes(name: str) -> None:
    for time, (node, *place) in PUBLISHED[name].items():
        # A run to each time: outputs at these times, whatever they have in common.
        run = tmj.simulate(load(name), None, tmj.DAE(rtol=1e-12, atol=1e-13), duration=time, output_interval=time)
        np.testing.assert_allclose(run.position(f"n{node}")[-1, :2], place, atol=PUBLISHED_ERROR[name] * time, rtol=0)


def test_strings_with_mass_move_the_prism_as_masses_by_hand_do() -> None:
    """9 strings of 0.1 kg each, in two segments: points at 1/4 and 3/4 of a string where MOTES has them at 1/3 and 2/3.

    Mass, stiffness and rest length are the same, so that only the inertia of 2 · 50 g is elsewhere, by 1/12 of the
    string: of 3.9 kg that move by 0.27 m, 0.9 kg at places that differ by a twelfth of their relative motion: 2 %.
    """
    by_hand = load("motes_prism")
    example = peer_examples.motes_prism()
    whole = [(1, 2), (2, 3), (3, 1), (4, 5), (5, 6), (6, 4), (1, 4), (2, 5), (3, 6)]
    strings = tuple(
        tmj.String(
            f"s{k}",
            (f"n{i}", f"n{j}"),
            100 / 3,
            10 / 3,
            rest_length=0.95 * float(np.linalg.norm(example.nodes[i - 1] - example.nodes[j - 1])),
            mass=0.1,
            segments=2,
        )
        for k, (i, j) in enumerate(whole)
    )
    nodes = {name: by_hand.structure.nodes[name] for name in list(by_hand.structure.nodes)[:6]}
    scene = tmj.Scene(tmj.Structure("prism with mass", nodes, by_hand.structure.rods, strings), duration=1.0)
    first, second = (
        tmj.simulate(one, None, tmj.DAE(), duration=1.0, output_interval=0.1).nodes[:, :6] for one in (by_hand, scene)
    )
    moved = np.abs(first - first[0]).max()
    assert moved > 0.2
    assert np.abs(first - second).max() < 0.02 * moved
