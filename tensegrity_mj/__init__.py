"""tensegrity_mj: a MuJoCo testbed for tensegrity structures, checked by an independent DAE reference model.

SI units, radians; the world frame is right-handed with z up. Everything below is imported when first used.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

_HOME = {
    "Actuation": "model.actuation",
    "OnInfeasible": "model.actuation",
    "Approach": "runs.approaches",
    "Clearance": "runs.approaches",
    "Event": "runs.approaches",
    "Pairs": "runs.approaches",
    "clearance": "runs.clearances",
    "Comparison": "runs.comparison",
    "compare": "runs.comparison",
    "Contact": "model.elements.contact",
    "DAE": "engines.reference.dae",
    "Drift": "engines.reference.dae",
    "Solver": "engines.reference.dae",
    "Method": "engines.reference.method",
    "Integrator": "engines.mujoco.settings",
    "MuJoCo": "engines.mujoco.engine",
    "ODE": "engines.reference.ode",
    "CompiledLaw": "dynamics.native.compiled_law",
    "Ensemble": "studies.ensemble",
    "law_in": "studies.ensemble",
    "simulate_many": "studies.ensemble",
    "ClusterError": "errors",
    "ControllerError": "errors",
    "DivergenceError": "errors",
    "FormatError": "errors",
    "InfeasibleError": "errors",
    "MissingLibraryError": "errors",
    "OptionError": "errors",
    "SceneError": "errors",
    "StabilityWarning": "errors",
    "StructureError": "errors",
    "TensegrityError": "errors",
    "FlowNumbers": "runs.flow_regime",
    "flow_numbers": "runs.flow_regime",
    "Command": "dynamics.native.law",
    "Linearization": "linearization.model",
    "linearize": "linearization.linearizing",
    "Harmonic": "model.motion",
    "Motion": "model.motion",
    "Layout": "pictures.stage",
    "Quality": "pictures.stage",
    "picture": "pictures.video",
    "render": "pictures.video",
    "render_frame": "pictures.video",
    "Bending": "model.elements.resistance",
    "Drag": "model.elements.resistance",
    "Resistance": "model.elements.resistance",
    "Break": "model.events",
    "ControlSpec": "model.events",
    "Load": "model.events",
    "Scene": "model.scene",
    "Target": "model.target",
    "Requirements": "studies.speed.requirements",
    "requirements": "studies.speed.requirements",
    "reproduce": "thesis.reproduce",
    "Section": "model.section",
    "simulate": "simulation",
    "StableStep": "vibration.stable_step",
    "stable_step": "vibration.stable_step",
    "Hold": "statics.boundary",
    "find_equilibrium": "statics.equilibrium",
    "Rods": "statics.model",
    "follow": "statics.path",
    "StringLaw": "model.strings",
    "PointMass": "model.members",
    "Rod": "model.members",
    "String": "model.members",
    "Structure": "model.structure",
    "Support": "model.members",
    "WithFiles": "studies.attempt",
    "Choice": "studies.axes",
    "Draw": "studies.axes",
    "LogUniform": "studies.axes",
    "Normal": "studies.axes",
    "Together": "studies.axes",
    "Uniform": "studies.axes",
    "Vary": "studies.axes",
    "Study": "studies.many",
    "run_many": "studies.many",
    "write_sweep_page": "studies.page",
    "Scaled": "studies.parameter_values",
    "Sweep": "studies.sweep",
    "TradeoffOptions": "studies.tradeoff.options",
    "Tradeoff": "studies.tradeoff.study",
    "tradeoff": "studies.tradeoff.study",
    "Extent": "studies.validation.sections",
    "Validation": "studies.validation.study",
    "validate": "studies.validation.study",
    "Backend": "studies.workers",
    "Workers": "studies.workers",
    "load_scene": "library.load",
    "load_structure": "library.load",
    "save_scene": "model.text.writing",
    "save_structure": "model.text.writing",
    "Status": "runs.trajectory",
    "Trajectory": "runs.trajectory",
    "Water": "model.elements.water",
    "Weights": "model.elements.water",
    "AboveLevel": "model.elements.waves",
    "Sea": "model.elements.waves",
    "Wave": "model.elements.waves",
    "winch_power": "runs.winches",
}
_MODULES = {"controllers": "controllers", "plots": "pictures.plots", "statics": "statics"}

__all__ = [*_HOME, *_MODULES]

if TYPE_CHECKING:  # the same names, for type checkers and editors
    from tensegrity_mj import controllers as controllers
    from tensegrity_mj import statics as statics
    from tensegrity_mj.dynamics.native.compiled_law import CompiledLaw as CompiledLaw
    from tensegrity_mj.dynamics.native.law import Command as Command
    from tensegrity_mj.engines.mujoco.engine import MuJoCo as MuJoCo
    from tensegrity_mj.engines.mujoco.settings import Integrator as Integrator
    from tensegrity_mj.engines.reference.dae import DAE as DAE
    from tensegrity_mj.engines.reference.dae import Drift as Drift
    from tensegrity_mj.engines.reference.dae import Solver as Solver
    from tensegrity_mj.engines.reference.method import Method as Method
    from tensegrity_mj.engines.reference.ode import ODE as ODE
    from tensegrity_mj.errors import ClusterError as ClusterError
    from tensegrity_mj.errors import ControllerError as ControllerError
    from tensegrity_mj.errors import DivergenceError as DivergenceError
    from tensegrity_mj.errors import FormatError as FormatError
    from tensegrity_mj.errors import InfeasibleError as InfeasibleError
    from tensegrity_mj.errors import MissingLibraryError as MissingLibraryError
    from tensegrity_mj.errors import OptionError as OptionError
    from tensegrity_mj.errors import SceneError as SceneError
    from tensegrity_mj.errors import StabilityWarning as StabilityWarning
    from tensegrity_mj.errors import StructureError as StructureError
    from tensegrity_mj.errors import TensegrityError as TensegrityError
    from tensegrity_mj.library.load import load_scene as load_scene
    from tensegrity_mj.library.load import load_structure as load_structure
    from tensegrity_mj.linearization.linearizing import linearize as linearize
    from tensegrity_mj.linearization.model import Linearization as Linearization
    from tensegrity_mj.model.actuation import Actuation as Actuation
    from tensegrity_mj.model.actuation import OnInfeasible as OnInfeasible
    from tensegrity_mj.model.elements.contact import Contact as Contact
    from tensegrity_mj.model.elements.resistance import Bending as Bending
    from tensegrity_mj.model.elements.resistance import Drag as Drag
    from tensegrity_mj.model.elements.resistance import Resistance as Resistance
    from tensegrity_mj.model.elements.water import Water as Water
    from tensegrity_mj.model.elements.water import Weights as Weights
    from tensegrity_mj.model.elements.waves import AboveLevel as AboveLevel
    from tensegrity_mj.model.elements.waves import Sea as Sea
    from tensegrity_mj.model.elements.waves import Wave as Wave
    from tensegrity_mj.model.events import Break as Break
    from tensegrity_mj.model.events import ControlSpec as ControlSpec
    from tensegrity_mj.model.events import Load as Load
    from tensegrity_mj.model.members import PointMass as PointMass
    from tensegrity_mj.model.members import Rod as Rod
    from tensegrity_mj.model.members import String as String
    from tensegrity_mj.model.members import Support as Support
    from tensegrity_mj.model.motion import Harmonic as Harmonic
    from tensegrity_mj.model.motion import Motion as Motion
    from tensegrity_mj.model.scene import Scene as Scene
    from tensegrity_mj.model.section import Section as Section
    from tensegrity_mj.model.strings import StringLaw as StringLaw
    from tensegrity_mj.model.structure import Structure as Structure
    from tensegrity_mj.model.target import Target as Target
    from tensegrity_mj.model.text.writing import save_scene as save_scene
    from tensegrity_mj.model.text.writing import save_structure as save_structure
    from tensegrity_mj.pictures import plots as plots
    from tensegrity_mj.pictures.stage import Layout as Layout
    from tensegrity_mj.pictures.stage import Quality as Quality
    from tensegrity_mj.pictures.video import picture as picture
    from tensegrity_mj.pictures.video import render as render
    from tensegrity_mj.pictures.video import render_frame as render_frame
    from tensegrity_mj.runs.approaches import Approach as Approach
    from tensegrity_mj.runs.approaches import Clearance as Clearance
    from tensegrity_mj.runs.approaches import Event as Event
    from tensegrity_mj.runs.approaches import Pairs as Pairs
    from tensegrity_mj.runs.clearances import clearance as clearance
    from tensegrity_mj.runs.comparison import Comparison as Comparison
    from tensegrity_mj.runs.comparison import compare as compare
    from tensegrity_mj.runs.flow_regime import FlowNumbers as FlowNumbers
    from tensegrity_mj.runs.flow_regime import flow_numbers as flow_numbers
    from tensegrity_mj.runs.trajectory import Status as Status
    from tensegrity_mj.runs.trajectory import Trajectory as Trajectory
    from tensegrity_mj.runs.winches import winch_power as winch_power
    from tensegrity_mj.simulation import simulate as simulate
    from tensegrity_mj.statics.boundary import Hold as Hold
    from tensegrity_mj.statics.equilibrium import find_equilibrium as find_equilibrium
    from tensegrity_mj.statics.model import Rods as Rods
    from tensegrity_mj.statics.path import follow as follow
    from tensegrity_mj.studies.attempt import WithFiles as WithFiles
    from tensegrity_mj.studies.axes import Choice as Choice
    from tensegrity_mj.studies.axes import Draw as Draw
    from tensegrity_mj.studies.axes import LogUniform as LogUniform
    from tensegrity_mj.studies.axes import Normal as Normal
    from tensegrity_mj.studies.axes import Together as Together
    from tensegrity_mj.studies.axes import Uniform as Uniform
    from tensegrity_mj.studies.axes import Vary as Vary
    from tensegrity_mj.studies.ensemble import Ensemble as Ensemble
    from tensegrity_mj.studies.ensemble import law_in as law_in
    from tensegrity_mj.studies.ensemble import simulate_many as simulate_many
    from tensegrity_mj.studies.many import Study as Study
    from tensegrity_mj.studies.many import run_many as run_many
    from tensegrity_mj.studies.page import write_sweep_page as write_sweep_page
    from tensegrity_mj.studies.parameter_values import Scaled as Scaled
    from tensegrity_mj.studies.speed.requirements import Requirements as Requirements
    from tensegrity_mj.studies.speed.requirements import requirements as requirements
    from tensegrity_mj.studies.sweep import Sweep as Sweep
    from tensegrity_mj.studies.tradeoff.options import TradeoffOptions as TradeoffOptions
    from tensegrity_mj.studies.tradeoff.study import Tradeoff as Tradeoff
    from tensegrity_mj.studies.tradeoff.study import tradeoff as tradeoff
    from tensegrity_mj.studies.validation.sections import Extent as Extent
    from tensegrity_mj.studies.validation.study import Validation as Validation
    from tensegrity_mj.studies.validation.study import validate as validate
    from tensegrity_mj.studies.workers import Backend as Backend
    from tensegrity_mj.studies.workers import Workers as Workers
    from tensegrity_mj.thesis.reproduce import reproduce as reproduce
    from tensegrity_mj.vibration.stable_step import StableStep as StableStep
    from tensegrity_mj.vibration.stable_step import stable_step as stable_step


def __getattr__(name: str) -> Any:
    if name in _MODULES:
        return import_module(f"{__name__}.{_MODULES[name]}")
    if name not in _HOME:
        raise AttributeError(f"module '{__name__}' has no attribute '{name}'; it has {', '.join(sorted(__all__))}")
    value = getattr(import_module(f"{__name__}.{_HOME[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(__all__)
