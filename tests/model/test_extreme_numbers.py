"""Numbers that engines cannot compute with end runs and checks with an error that says so."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from extreme_scenes import extreme

from tensegrity_mj import DAE, ODE, Actuation, Integrator, MuJoCo, controllers, simulate, stable_step
from tensegrity_mj.basics import kinds
from tensegrity_mj.basics.arrays import bisect
from tensegrity_mj.dynamics.native.law import native_law
from tensegrity_mj.engines.reference.adaptive import SWITCH_TOLERANCE
from tensegrity_mj.engines.reference.method import Method
from tensegrity_mj.errors import DivergenceError, OptionError, SceneError
from tensegrity_mj.library.named import load_scene
from tensegrity_mj.simulation import Engine
from tensegrity_mj.vibration import step_warnings
from tensegrity_mj.vibration.step_warnings import before_run


@pytest.mark.parametrize("method", [Method.DOP853, Method.RADAU])
@pytest.mark.parametrize("kind", [DAE, ODE])
def test_accelerations_beyond_floats_end_the_run(
    kind: Callable[..., Engine], method: Method, monkeypatch: pytest.MonkeyPatch
) -> None:
    """SciPy's first step is NaN there, which no step size is below: its solver would try for ever."""
    monkeypatch.setattr(kinds, "LARGEST", math.inf)  # no file may hold such a force; laws and functions may give it
    scene = extreme(mass=1e-4, force=1e306)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)
        with pytest.raises(DivergenceError, match=r"beyond double precision.*; give masses, .* nearer to 1"):
            simulate(scene, None, kind(method=method, max_steps=50))


@pytest.mark.parametrize("kind", [DAE, ODE])
def test_derivatives_beyond_floats_end_the_run(kind: Callable[..., Engine]) -> None:
    """Accelerations of 1e200 m/s² are numbers, and those of Radau's matrices are none."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)
        with pytest.raises(DivergenceError, match="beyond double precision"):
            simulate(extreme(mass=1e-100, force=1e100), None, kind(method=Method.RADAU))


@pytest.mark.parametrize("law", sorted(controllers.LAWS))
def test_laws_of_structures_without_strings_are_refused(law: str) -> None:
    """One had crashed on them; the others were infeasible in one engine, and never computed in another."""
    scene = load_scene("pinned_rod")
    bare = scene.with_(structure=replace(scene.structure, strings=()), control=None)
    with pytest.raises(OptionError, match=f"law '{law}' commands strings, and its structure 'pinned_rod' has none"):
        controllers.from_scene(bare, law)


@pytest.mark.parametrize("start", [0.0, 1e7, 1e15])
def test_instants_are_found_where_times_are_coarser_than_the_tolerance(start: float) -> None:
    """At 1e7 s neighbouring floats are 2e-9 s apart: no two times are as near as 1e-10 s."""
    last = start + 1.0
    before, after = bisect(lambda t: t < start + 0.25, start, last, SWITCH_TOLERANCE)
    assert before < start + 0.25 <= after
    assert after - before <= max(SWITCH_TOLERANCE, math.ulp(last))


def test_samples_of_a_law_are_counted_before_they_are_laid_out() -> None:
    scene = load_scene("pinned_rod")
    law = controllers.from_scene(scene)
    held = Actuation.hold_force_density(1e-9)
    with pytest.raises(OptionError, match=r"samples the law 1e\+12 times; at most 10000000"):
        simulate(scene, law, DAE(), duration=1000.0, actuation=held, output_interval=1000.0)


def test_eigenvalues_that_cannot_be_found_are_an_error_and_before_a_run_a_warning() -> None:
    scene = extreme(size=1e-100, stiffness=1e-100, damping=1e100)
    engine = MuJoCo(integrator=Integrator.IMPLICITFAST)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)
        with pytest.raises(SceneError, match=r"eigenvalues of its small motions cannot be found .* too far apart"):
            stable_step(scene, engine)


def test_a_check_that_fails_warns(monkeypatch: pytest.MonkeyPatch) -> None:
    def fails(*given: object) -> None:
        raise np.linalg.LinAlgError("Eigenvalues did not converge")

    monkeypatch.setattr(step_warnings, "_checked", fails)
    report, text = before_run(
        load_scene("prism"), MuJoCo(), native_law(None, load_scene("prism").structure), Actuation.continuous()
    )
    assert report is not None
    assert not report["checked"]
    assert text.startswith("the step was not checked: scene 'prism': the eigenvalues")
