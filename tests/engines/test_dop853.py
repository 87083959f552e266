"""The compiled DOP853 against its own theory, and against SciPy's DOP853 on the same equations."""

from __future__ import annotations

import os
import subprocess
import sys
from typing import Any

import numpy as np
import pytest
from scipy.integrate import DOP853, solve_ivp

import tensegrity_mj as tmj
from tensegrity_mj.engines.reference import controlled, dop853
from tensegrity_mj.engines.reference.adaptive import ErrorControlled
from tensegrity_mj.engines.reference.equations import place, rates
from tensegrity_mj.engines.request import request_for
from tensegrity_mj.model.actuation import OnInfeasible

# A sum of 16 products of weights, none above 388, each rounded to half of 2.2e-16, and each partial sum likewise.
WEIGHT_ROUND_OFF = 16 * 388 * 2.2e-16
DURATION = 1.0  # s, of the prism under its law: no string begins or ceases to pull, so that the motion is smooth
EPS = np.finfo(float).eps


def prepared(engine: Any) -> Any:
    scene = tmj.load_scene("prism")
    law = tmj.controllers.from_scene(scene)
    return engine.prepared(request_for(scene, law, DURATION, None, OnInfeasible.STOP, 0.1, False))


def test_the_weights_fulfil_conditions_of_their_order() -> None:
    """Σ a = c in each stage; Σ b cᵏ = 1/(k+1), as quadrature of order 8 has it; errors of a constant rate are none."""
    c, stages = dop853.NODES, dop853.STAGES
    for stage in (*range(1, stages), *range(stages + 1, dop853.STAGES_IN_ALL)):
        assert dop853.WEIGHTS[stage].sum() == pytest.approx(c[stage], abs=WEIGHT_ROUND_OFF)
    for k in range(8):
        assert dop853.WEIGHTS[dop853.NEW] @ c**k == pytest.approx(1 / (k + 1), abs=WEIGHT_ROUND_OFF)
    for row in (dop853.ERROR_3, dop853.ERROR_5):
        assert dop853.WEIGHTS[row].sum() == pytest.approx(0, abs=WEIGHT_ROUND_OFF)
    # With a constant rate the dense output is a straight line, and its powers from the third on are none.
    for row in range(dop853.DENSE, len(dop853.WEIGHTS)):
        assert dop853.WEIGHTS[row].sum() == pytest.approx(0, abs=WEIGHT_ROUND_OFF)


def test_the_weights_are_scipys() -> None:
    """Both took the digits of Hairer, Nørsett and Wanner."""
    n, rows = dop853.STAGES, dop853.WEIGHTS
    known = np.zeros((n + 1, n + 1))
    known[1:n, :n] = DOP853.A[1:]
    known[n, :n] = DOP853.B
    assert np.array_equal(rows[: n + 1, : n + 1], known)
    assert np.array_equal(rows[n + 1 : dop853.STAGES_IN_ALL], DOP853.A_EXTRA)
    errors = np.stack([DOP853.E3, DOP853.E5])
    assert np.array_equal(rows[dop853.ERROR_3 : dop853.DENSE, : n + 1], errors)
    assert np.array_equal(rows[dop853.DENSE :], DOP853.D)
    assert np.allclose(dop853.NODES, [*DOP853.C, 1, *DOP853.C_EXTRA], rtol=EPS, atol=0)


def right_side_of(run: Any) -> Any:
    def right_side(t: float, y: Any) -> Any:
        out = np.empty(len(y))
        assert rates(t, np.ascontiguousarray(y), out, run.table) == 0
        return out

    return right_side


def nodes_of(run: Any, state: Any) -> Any:
    place(np.ascontiguousarray(state), run.table)
    return run.plant["nodes"].copy()


def growth(engine: Any) -> float:
    """The largest move of a node by errors of one unit in each number of an earlier state: 4.6 (DAE) and 4.0 (ODE).

    A start and one aside in each coordinate and speed are followed to the end: that is a column of the matrix which
    takes errors of a state to those of later nodes; absolute values of a row add up to what errors of any sign do.
    It is measured from starts along the run, for errors arise in each step.
    """
    run = prepared(engine(rtol=1e-9, atol=1e-11))
    count, aside = 2 * run.plant["coordinates"], 1e-6  # curvature and the tolerance change the columns by some 1e-3
    times = np.linspace(0.0, DURATION, 5)

    def follow(state: Any, at: Any) -> Any:
        found = solve_ivp(right_side_of(run), at[[0, -1]], state, "DOP853", at, rtol=1e-10, atol=1e-12)
        return found.y.T

    path, most = follow(run.y.copy(), times), 0.0
    for number in range(len(times) - 1):
        at, start = times[number:], path[number]
        straight = [nodes_of(run, state) for state in follow(start, at)]
        moves = []
        for column in range(count):
            beside = start + aside * (np.arange(len(start)) == column)
            moves.append([nodes_of(run, state) for state in follow(beside, at)] - np.array(straight))
        most = max(most, float(np.abs(moves).sum(axis=0).max()) / aside)
    return most


@pytest.mark.parametrize("engine", [tmj.DAE, tmj.ODE])
def test_steps_and_states_are_scipys(engine: Any) -> None:
    """The same accepted steps, and the same nodes to round-off: where both end, and at times between."""
    grown = growth(engine)
    for rtol in (1e-6, 1e-9, 1e-12):
        _compare(engine(rtol=rtol, atol=1e-2 * rtol), grown)


def _compare(options: Any, grown: float) -> None:
    run, other = prepared(options), prepared(options)
    scipys = DOP853(right_side_of(other), 0.0, other.y.copy(), DURATION, rtol=options.rtol, atol=options.atol)
    ours, ends, states, fastest = ErrorControlled(run), [], [other.y.copy()], 0.0
    outputs = np.arange(1, 10) * 0.1
    while scipys.status == "running":
        scipys.step()
        came_to = controlled.advance(ours.own.address, 1)
        ends.append((float(scipys.t), ours.own["end"]))
        inside = outputs[(scipys.t_old < outputs) & (outputs <= scipys.t)]
        states += [*scipys.dense_output()(inside).T]
        fastest = max(fastest, float(np.abs(scipys.f).max()))
    states.append(scipys.y)
    assert scipys.status == "finished"
    assert came_to == dop853.ENDED
    assert ours.own["steps"] == len(ends)
    # Errors are differences of sums, known to a few digits where tolerances are near to ε, and so are the steps.
    scipys_ends, our_ends = np.array(ends).T
    lengths = np.diff(scipys_ends, prepend=0.0)
    moved = float(np.max(np.abs(our_ends - scipys_ends) / lengths))
    assert moved < 1e-2
    # A step of order 8 that is longer by a part δ errs by a part 9 δ more, of at most rtol in the root mean square of n
    # numbers, so √n in one. Each step rounds a state once as it adds the change, h Σ b f, and that sum once a stage; so
    # do the sums of the dense output, whose powers x² (1 - x)² and higher are at most 1/16.
    size, change = np.abs(states).max(), lengths.max() * fastest
    b, dense = np.abs(dop853.WEIGHTS[dop853.NEW]), np.abs(dop853.WEIGHTS[dop853.DENSE :])
    rounded = size + dop853.STAGES * b.sum() * change
    each = 9 * moved * options.rtol * np.sqrt(len(run.y)) * size + EPS * rounded
    within = EPS * dop853.STAGES_IN_ALL * dense.sum(axis=1).max() / 16 * change
    allowed = grown * (each * len(ends) + within)
    for row, state in zip(ours.rows, states, strict=False):
        nodes = nodes_of(run, state)
        assert np.abs(row[: nodes.size].reshape(-1, 3) - nodes).max() <= allowed


SAME_BITS = """
import hashlib, sys
import tensegrity_mj as tmj
scene = tmj.load_scene("prism")
run = tmj.simulate(scene, tmj.controllers.from_scene(scene), tmj.DAE(), duration=2.0)
print(hashlib.sha256(run.nodes.tobytes() + run.winch_work.tobytes()).hexdigest())
print("numba" in sys.modules, "scipy" in sys.modules)
"""


def test_bits_do_not_depend_on_the_processors_linear_algebra() -> None:
    """OpenBLAS has kernels of its own for each processor, whose sums differ; and neither it nor numba is needed."""
    controlled.advance.address, dop853.dop853_step.address  # noqa: B018 - compiled, if it was not kept
    said = set()
    for kind in ("Haswell", "Nehalem"):
        environment = {**os.environ, "OPENBLAS_CORETYPE": kind}
        done = subprocess.run(
            [sys.executable, "-c", SAME_BITS], env=environment, capture_output=True, text=True, check=True
        )
        said.add(done.stdout)
    assert len(said) == 1
    assert said.pop().split()[1:] == ["False", "False"]
