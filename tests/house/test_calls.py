"""The calls at the top of the package take texts, and give what they give for the objects."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import tensegrity_mj as tmj
from tensegrity_mj import calls, simulation
from tensegrity_mj.errors import FormatError, OptionError
from tensegrity_mj.linearization import linearizing
from tensegrity_mj.simulation import ensemble
from tensegrity_mj.studies.identification import result
from tensegrity_mj.vibration import stable_step

INSIDE: dict[str, Any] = {
    "simulate": simulation.simulate,
    "linearize": linearizing.linearize,
    "stable_step": stable_step.stable_step,
    "simulate_many": ensemble.simulate_many,
    "law_in": ensemble.law_in,
    "identify": result.identify,
}


@pytest.mark.parametrize("name", INSIDE)
def test_signatures_and_docs_are_those_of_the_functions_inside(name: str) -> None:
    ours, inside = (dict(inspect.signature(one).parameters) for one in (getattr(tmj, name), INSIDE[name]))
    options = ours.pop("engine_options")
    assert options.kind is options.VAR_KEYWORD
    assert list(ours) == list(inside)
    for own, other in zip(ours.values(), inside.values(), strict=True):
        assert (own.kind, own.default) == (other.kind, other.default)
    assert getattr(tmj, name) is getattr(calls, name)
    said = str(inspect.getdoc(getattr(tmj, name)))
    # What is imported when it is called says where its own text is.
    assert said.startswith(str(inspect.getdoc(INSIDE[name]))) or f"see `tensegrity_mj.studies.{name}`" in said


def test_texts_give_what_objects_give(pinned_rod: Any, tmp_path: Path) -> None:
    text = tmj.simulate("pinned_rod", "lyapunov", "dae", duration=0.05, on_infeasible="passive", actuation="continuous")
    objects = simulation.simulate(
        pinned_rod,
        tmj.controllers.from_scene(pinned_rod),
        tmj.DAE(),
        duration=0.05,
        on_infeasible=tmj.OnInfeasible.PASSIVE,
    )
    assert np.array_equal(text.nodes, objects.nodes)
    assert text.provenance["on_infeasible"] == "passive"
    assert text.provenance["controller"] == objects.provenance["controller"]
    path = tmj.save_scene(pinned_rod, tmp_path / "scene.toml")
    inside = simulation.simulate(pinned_rod, None, tmj.ODE(), duration=0.01)
    assert np.array_equal(tmj.simulate(path, None, engine="ode", duration=0.01).nodes, inside.nodes)
    model = tmj.linearize("pinned_rod", "ode", law="lyapunov", inputs="force-density")
    law, inputs = tmj.controllers.from_scene(pinned_rod), tmj.Command.FORCE_DENSITY
    assert np.array_equal(model.A, linearizing.linearize(pinned_rod, tmj.ODE(), law=law, inputs=inputs).A)
    assert tmj.stable_step("pinned_rod", "mujoco").limit == stable_step.stable_step(pinned_rod, tmj.MuJoCo()).limit
    many = tmj.simulate_many(["pinned_rod", pinned_rod], ["lyapunov", None], "mujoco", duration=0.02)
    alone = tmj.simulate(pinned_rod, "lyapunov", duration=0.02)
    assert np.array_equal(many[0].nodes, alone.nodes)
    assert many[1].provenance["controller"] is None
    both = tmj.simulate_many(["pinned_rod", pinned_rod], "lyapunov", duration=0.02)
    assert np.array_equal(both[1].nodes, alone.nodes)
    with tmj.law_in("pinned_rod", "lyapunov", "mujoco", on_infeasible="stop") as model:
        assert model.opt.timestep == tmj.MuJoCo().timestep


@pytest.mark.parametrize("engine", ["mujoco", "dae", "ode", None])
def test_an_engine_of_a_name_takes_options_and_one_spelling_of_its_integrator(engine: str | None, prism: Any) -> None:
    text = tmj.simulate("prism", None, engine, duration=0.02, integrator="rk4", timestep=1e-3)
    kinds: dict[str | None, Any] = {"dae": tmj.DAE, "ode": tmj.ODE}
    made = kinds[engine](method="rk4", timestep=1e-3) if engine in kinds else tmj.MuJoCo(1e-3, "rk4")
    assert np.array_equal(text.nodes, simulation.simulate(prism, None, made, duration=0.02).nodes)
    assert text.provenance["engine"]["timestep"] == 1e-3


def test_options_of_engines_reach_every_call(pinned_rod: Any) -> None:
    euler = tmj.MuJoCo(2e-3, tmj.Integrator.EULER)
    many = tmj.simulate_many(["pinned_rod"], None, integrator=tmj.Integrator.EULER, timestep=2e-3, duration=0.02)
    assert np.array_equal(many[0].nodes, simulation.simulate(pinned_rod, None, euler, duration=0.02).nodes)
    assert tmj.stable_step("pinned_rod", "mujoco", integrator="euler").scheme is euler.stepping.scheme
    assert "Euler" in tmj.linearize("pinned_rod", integrator="euler").engine
    with tmj.law_in("pinned_rod", "lyapunov", timestep=2e-3) as model:
        assert model.opt.timestep == 2e-3


def test_options_of_engines_take_texts() -> None:
    assert tmj.MuJoCo(integrator="euler") == tmj.MuJoCo(integrator=tmj.Integrator.EULER)
    assert tmj.DAE(method="radau", drift="normalize").method is tmj.Method.RADAU
    assert tmj.ODE(method="rk4", timestep=1e-3).method is tmj.Method.RK4
    assert tmj.Actuation("hold-rest-length", 0.01) == tmj.Actuation.hold_rest_length(0.01)
    assert tmj.studies.Workers(backend="this process").backend is tmj.studies.Backend.THIS_PROCESS


@pytest.mark.parametrize(
    ("call", "error", "message"),
    [
        (lambda: tmj.simulate("prsm"), FormatError, r"unknown scene 'prsm' \(did you mean 'prism'\?\)"),
        (lambda: tmj.simulate("prism", "lyapunof"), OptionError, r"'lyapunof' \(did you mean 'lyapunov'\?\)"),
        (lambda: tmj.simulate("prism", engine="dea"), OptionError, r"no engine 'dea' \(did you mean 'dae'\?\)"),
        (lambda: tmj.simulate("prism", on_infeasible="pasive"), OptionError, r"'pasive' \(did you mean 'passive'\?\)"),
        (lambda: tmj.simulate("prism", actuation="hold-rest-lenght"), OptionError, r"mean 'hold rest length'\?\)"),
        (
            lambda: tmj.simulate("prism", actuation="hold-rest-length"),
            OptionError,
            r"needs the time between samples: use tmj.Actuation.hold_rest_length\(period\)",
        ),
        (
            lambda: tmj.linearize("prism", inputs="force"),
            OptionError,
            r"inputs = 'force' .*'force density'",
        ),
        (lambda: tmj.MuJoCo(integrator="rk5"), OptionError, r"MuJoCo: integrator = 'rk5' \(did you mean 'rk4'\?\); it"),
        (
            lambda: tmj.DAE(method="rado"),
            OptionError,
            r"'rado'.*it must be one of Method.DOP853, Method.RADAU",
        ),
        (
            lambda: tmj.simulate("prism", duraton=1.0),
            TypeError,
            r"no argument of simulate, nor option of engine mujoco, 'duraton' \(did you mean 'duration'\?\)",
        ),
        (
            lambda: tmj.simulate("prism", engine="dae", timstep=1.0),
            TypeError,
            r"dae, 'timstep' \(did you mean 'timestep'",
        ),
        (
            lambda: tmj.simulate("prism", engine="mujoco", method="rk4"),
            TypeError,
            r"mujoco, 'method'; allowed: .*integrator",
        ),
        (lambda: tmj.simulate("prism", engine="", timestep=1e-3), OptionError, r"there is no engine ''"),
        (lambda: tmj.simulate("prism", integrator="rk5"), OptionError, r"'rk5' \(did you mean 'rk4'\?\)"),
        (
            lambda: tmj.simulate("prism", engine="dae", integrator="rk4"),
            OptionError,
            "DAE: timestep = None: Method.RK4",
        ),
        (
            lambda: tmj.simulate("prism", engine="dae", integrator="rk4", method="rk4"),
            OptionError,
            "integrator and method are one option of engine dae",
        ),
        (
            lambda: tmj.simulate("prism", engine=tmj.DAE(), integrator="rk4"),
            OptionError,
            'by its name, as engine="dae"',
        ),
        (lambda: tmj.simulate(), TypeError, r"missing 1 required positional argument: 'scene'"),
        # Inside there are objects alone.
        (lambda: INSIDE["simulate"]("prism"), OptionError, "use a Scene"),
        (lambda: INSIDE["simulate"](tmj.load_scene("prism"), on_infeasible="stop"), OptionError, "one of OnInfeasible"),
    ],
)
def test_texts_are_checked_with_what_was_probably_meant(
    call: Callable[[], Any], error: type[Exception], message: str
) -> None:
    with pytest.raises(error, match=message):
        call()
