"""tensegrity_mj: a MuJoCo testbed for tensegrity structures, checked by an independent DAE reference model.

SI units, radians; the world frame is right-handed with z up. Everything below is imported when first used.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

_HOME = {
    "Actuation": "actuation",
    "OnInfeasible": "actuation",
    "Comparison": "comparison",
    "compare": "comparison",
    "DAE": "engines.dae",
    "Drift": "engines.dae",
    "Method": "engines.dae",
    "Integrator": "engines.mujoco",
    "MuJoCo": "engines.mujoco",
    "ControllerError": "errors",
    "DivergenceError": "errors",
    "FormatError": "errors",
    "InfeasibleError": "errors",
    "MissingLibraryError": "errors",
    "OptionError": "errors",
    "SceneError": "errors",
    "StructureError": "errors",
    "TensegrityError": "errors",
    "Command": "law",
    "Layout": "rendering",
    "Quality": "rendering",
    "picture": "rendering",
    "render": "rendering",
    "render_frame": "rendering",
    "ControlSpec": "scene",
    "Load": "scene",
    "Scene": "scene",
    "Target": "scene",
    "simulate": "simulation",
    "StringLaw": "strings",
    "PointMass": "structure",
    "Rod": "structure",
    "String": "structure",
    "Structure": "structure",
    "Support": "structure",
    "load_scene": "textformat",
    "load_structure": "textformat",
    "save_scene": "textformat",
    "save_structure": "textformat",
    "Status": "trajectory",
    "Trajectory": "trajectory",
}
_MODULES = ("controllers", "plots")

__all__ = [*_HOME, *_MODULES]

if TYPE_CHECKING:  # the same names, for type checkers and editors
    # ruff: noqa: F401
    from tensegrity_mj import controllers, plots
    from tensegrity_mj.actuation import Actuation, OnInfeasible
    from tensegrity_mj.comparison import Comparison, compare
    from tensegrity_mj.engines.dae import DAE, Drift, Method
    from tensegrity_mj.engines.mujoco import Integrator, MuJoCo
    from tensegrity_mj.errors import (
        ControllerError,
        DivergenceError,
        FormatError,
        InfeasibleError,
        MissingLibraryError,
        OptionError,
        SceneError,
        StructureError,
        TensegrityError,
    )
    from tensegrity_mj.law import Command
    from tensegrity_mj.rendering import Layout, Quality, picture, render, render_frame
    from tensegrity_mj.scene import ControlSpec, Load, Scene, Target
    from tensegrity_mj.simulation import simulate
    from tensegrity_mj.strings import StringLaw
    from tensegrity_mj.structure import PointMass, Rod, String, Structure, Support
    from tensegrity_mj.textformat import load_scene, load_structure, save_scene, save_structure
    from tensegrity_mj.trajectory import Status, Trajectory


def __getattr__(name: str) -> Any:
    if name in _MODULES:
        return import_module(f"{__name__}.{name}")
    if name not in _HOME:
        raise AttributeError(f"module '{__name__}' has no attribute '{name}'; it has {', '.join(sorted(__all__))}")
    value = getattr(import_module(f"{__name__}.{_HOME[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(__all__)
