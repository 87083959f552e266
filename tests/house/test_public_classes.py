"""Every public class takes wrong values as an error of the package, or takes them and works."""

from __future__ import annotations

import enum
import inspect
import math
import warnings
from collections.abc import Callable
from dataclasses import replace
from importlib import import_module
from typing import Any

import numpy as np
import pytest

import tensegrity_mj as tmj
from tensegrity_mj import model, statics, studies
from tensegrity_mj.basics.dependencies import missing_for_dm_control
from tensegrity_mj.dynamics.native.compiling import njit
from tensegrity_mj.errors import MissingLibraryError, TensegrityError
from tensegrity_mj.learning import tasks
from tensegrity_mj.model import text as model_text

ROOMS = (
    "|controllers|engines|exchange|library|linearization|model|pictures|runs|statics|studies|studies.tradeoff|"
    "learning.tasks|learning.gymnasium|learning.dm_control"
).split("|")
NAN, INF = math.nan, math.inf
WRONG: list[Any] = [
    *(None, True, NAN, INF, -INF, -1.0, 0, -3, 2.5, 1e99, 1e300, 10**400, 1j, "", "x", "\ud800", b"x", object(), str),
    *([], [NAN], [None], ["x"], [1.0], (1, 2), (INF, 0, 0), [[1.0, 2.0], [3.0]], {}, {"x": NAN}, {1: 2}, {"x"}),
    *(np.zeros(0), np.full(3, NAN), np.zeros((2, 3)), np.array("x"), np.array(None), range(3), lambda: None, iter(())),
]

# What calls return, and what nobody makes by hand: their arguments are right by construction.
RESULTS = set(
    "Trajectory Imported Linearization WebPage Approach Clearance Comparison Event FlowNumbers Score Statistics Table "
    "Critical Curve EngineCheck EngineEquilibrium MemberCheck Modes Path Prestressability Response Sizing SlackEvent "
    "SlackInterval StaticModel StaticState StaticStudy TrajectoryCheck Use Ensemble Identification Requirements Study "
    "Validation Tradeoff State Limit Reproduction ScenePhysics TensegrityTask Sea Gains Element".split()
)
PINNED = tmj.load_scene("pinned_rod")
PRISM = tmj.load_scene("prism")
STRUCTURE, TARGET = PRISM.structure, PRISM.target


def rise(task: Any, before: Any, after: Any) -> dict[str, Any]:
    return {"height": after.nodes[:, :, 2].max(axis=1)}


def damp(time: float, nodes: Any, velocities: Any) -> Any:
    return np.zeros(12)


@njit
def compiled_damp(time, nodes, velocities, string_nodes, parameters, command):  # type: ignore[no-untyped-def]
    command[:] = 0.0
    return True


TASK = tasks.Task(PRISM, rise, 0.3, 0.9, ("nodes",))  # type: ignore[arg-type]

# What is right: the arguments that are needed, and others that have values of their own kind.
RIGHT: dict[str, dict[str, Any]] = {
    **{
        key: {}
        for key in "Actuation DAE JAX MuJoCo ODE Resistance Water Support Bending Contact Drag Allocation".split()
    },
    **{key: {} for key in "ImportOptions FitOptions Workers TradeoffOptions RandomStart Extent".split()},
    "PointMass": {"node": "a", "mass": 1.0},
    "Rod": {"name": "r", "nodes": ("a", "b"), "mass": 1.0},
    "Scene": {"structure": STRUCTURE},
    "String": {"name": "s", "nodes": ("a", "b"), "stiffness": 1.0},
    "Structure": {"name": "n", "nodes": STRUCTURE.nodes, "rods": STRUCTURE.rods, "strings": STRUCTURE.strings},
    "Target": {"times": (0.0,), "nodes": [PRISM.nodes0]},
    "CompiledLaw": {"function": compiled_damp, "structure": STRUCTURE},
    "Delayed": {"law": damp, "samples": 1, "period": 0.1},
    "Noisy": {"law": damp, "position_std": 0.1, "velocity_std": 0.1, "seed": 0, "period": 0.1},
    **{key: {"structure": STRUCTURE, "target": TARGET} for key in ["FeedbackLinearization", "Lyapunov"]},
    "Projection": {"structure": STRUCTURE, "target": TARGET},
    "Program": {"structure": STRUCTURE, "target": TARGET},
    "Replay": {"times": [0.0, 1.0], "values": np.ones((2, 12))},
    "Sum": {"minimum": 1.0},
    "ArrayPolicy": {"function": damp, "parameters": {}},
    "Body": {"name": "b", "nodes": ("a", "b", "c", "d"), "mass": 1.0, "inertia": (1.0, 1.0, 1.0)},
    "Break": {"string": "s", "time": 1.0},
    "Constraint": {"name": "c", "nodes": {"a": 1.0}, "direction": (1.0, 0.0, 0.0)},
    "ControlSpec": {"law": "lyapunov"},
    "Ground": {"times": (0.0, 1.0, 2.0), "accelerations": ((0.0, 0.0, 0.0),) * 3},
    "Harmonic": {"amplitude": (1.0, 0.0, 0.0)},
    "Heights": {"heights": ((0.0, 1.0), (0.0, 1.0)), "spacing": 1.0},
    "IrregularSea": {"spectrum": "jonswap", "significant_height": 1.0, "peak_period": 8.0},
    "Load": {"node": "a", "force": (0.0, 0.0, 1.0)},
    "Motion": {"support": "a", "harmonics": (model.Harmonic((1.0, 0.0, 0.0)),)},
    "Ramp": {"angle": 0.1},
    "RodMass": {"at": 0.5, "mass": 1.0},
    "Rough": {"roughness": 0.1, "length": 1.0},
    "Section": {"area": 1.0, "second_moment": 1.0, "elasticity_modulus": 1.0},
    "Stairs": {"rise": 0.1, "tread": 1.0},
    "Wave": {"amplitude": 1.0, "wavelength": 10.0},
    "Hold": {"nodes": "a"},
    "Material": {"density": 1.0, "elasticity_modulus": 1.0, "yield_stress": 1.0},
    "Materials": {"rods": statics.STEEL, "strings": statics.STEEL},
    "Choice": {"values": [1, 2]},
    "Draw": {"parameter": "structure.rods[*].mass", "distribution": studies.Uniform(0.5, 1.5)},
    **{key: {"low": 0.5, "high": 1.5} for key in ["LogUniform", "Uniform"]},
    "Normal": {"mean": 1.0, "deviation": 0.1},
    "Parameter": {"path": "structure.rods[*].mass", "low": 0.5, "high": 1.5},
    "Scaled": {"factor": 2.0},
    "Sweep": {"scene": PRISM, "axes": (studies.Vary("structure.rods.mass", (1.0, 2.0)),)},
    "Together": {"axes": (studies.Vary("structure.rods.mass", (1.0, 2.0)),)},
    "Vary": {"parameter": "structure.rods[*].mass", "values": (1.0, 2.0)},
    "WithFiles": {"values": {"x": 1}},
    "Goal": {"nodes": ("a",), "reach": (0.0, 0.0, 0.0)},
    "Task": {key: getattr(TASK, key) for key in ("scene", "terms", "low", "high", "observed")},
    "World": {"task": "PrismReach"},
    "TensegrityEnv": {"task": "PrismReach"},
    "TensegrityVectorEnv": {"num_envs": 1, "task": "PrismReach"},
    "TensegrityEntity": {"scene": PRISM},
}


def short_run(engine: Any) -> None:
    """Two rows of a rod on a pin."""
    tmj.simulate(PINNED, None, engine, duration=0.002, output_interval=0.001)


def one_command(law: Any) -> None:
    u = law(0.0, PRISM.nodes0, np.zeros_like(PRISM.nodes0))
    assert np.isfinite(np.asarray(u, float)).all()


def play(task: Any) -> None:
    world, one = tasks.World(task), np.zeros(1, int)
    world.start(one, [np.random.default_rng(0)])
    found = world.step(one, np.zeros((1, len(task.low))))
    assert np.isfinite(found.observation).all()
    assert np.isfinite(found.reward).all()


def placed(water: Any) -> None:
    """What acts on a scene stands in its file."""
    scene = PRISM.with_(contact=None, **{type(water).__name__.lower(): water})
    assert model_text.scene_from_toml(model_text.scene_to_toml(scene)) == scene


# How what was taken is seen to work; the others are shown.
WORKS: dict[str, Callable[[Any], Any]] = {
    "Task": play,
    "RandomStart": lambda start: play(replace(TASK, start=start)),
    "Goal": lambda goal: play(replace(TASK, goal=goal, observed=("goal",))),
    **dict.fromkeys(["DAE", "MuJoCo", "ODE"], short_run),
    **dict.fromkeys(["Lyapunov", "Projection", "Program", "Replay"], one_command),
    **dict.fromkeys(["Water", "Resistance"], placed),
    "Draw": lambda draw: draw.sample(np.random.default_rng(0)),
}


def public() -> dict[str, Any]:
    """The classes of all rooms, less enums and errors, by name."""
    found = {}
    for name in ROOMS:
        if name == "dm_control" and missing_for_dm_control():
            continue
        room = import_module(f"tensegrity_mj.{name}".rstrip("."))
        for word in room.__all__:
            try:
                one = getattr(room, word)
            except MissingLibraryError:
                continue
            if isinstance(one, type) and not issubclass(one, (enum.Enum, BaseException)):
                found[word] = one
    return found


CLASSES = public()


def test_every_public_class_is_known_here() -> None:
    assert set(CLASSES) - RESULTS - {"StableBaselinesVecEnv"} == set(RIGHT) & set(CLASSES)


def arguments(made: Any) -> list[str]:
    kinds = (inspect.Parameter.VAR_KEYWORD, inspect.Parameter.VAR_POSITIONAL)
    return [one.name for one in inspect.signature(made).parameters.values() if one.kind not in kinds]


@pytest.mark.parametrize("name", sorted(set(RIGHT) & set(CLASSES)))
def test_wrong_values_are_refused_or_work(name: str) -> None:
    """Each argument in turn; a foreign exception, or a value that was taken and cannot be shown, is a fault."""
    made, right = CLASSES[name], RIGHT[name]
    repr(made(**right))
    faults = []
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for key in arguments(made):
            for number, wrong in enumerate(WRONG):
                if callable(wrong) and key in ("terms", "law", "function", "loads"):
                    continue  # whatever a function of the caller's raises is its own
                try:
                    one = made(**right | {key: wrong})
                    repr(one)
                    WORKS.get(name, repr)(one)
                except TensegrityError:
                    pass
                except Exception as error:
                    faults.append(f"{key} = WRONG[{number}]: {type(error).__name__}: {error}"[:200])
    assert not faults, "\n".join(faults)
