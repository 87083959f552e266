"""tensegrity_mj: a MuJoCo testbed for tensegrity structures, checked by an independent DAE reference model.

SI units, radians; the world frame is right-handed with z up. Everything below is imported when first used.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

_HOME = {
    "Actuation": "actuation",
    "OnInfeasible": "actuation",
    "Approach": "clearances",
    "Clearance": "clearances",
    "Event": "clearances",
    "Pairs": "clearances",
    "clearance": "clearances",
    "Comparison": "comparison",
    "compare": "comparison",
    "Contact": "contact",
    "DAE": "engines.dae",
    "Drift": "engines.dae",
    "Solver": "engines.dae",
    "Method": "engines.integration",
    "Integrator": "engines.mujoco",
    "MuJoCo": "engines.mujoco",
    "ODE": "engines.ode",
    "CompiledLaw": "compiled_law",
    "Ensemble": "ensemble",
    "law_in": "ensemble",
    "simulate_many": "ensemble",
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
    "FlowNumbers": "flow_regime",
    "flow_numbers": "flow_regime",
    "Command": "law",
    "Linearization": "linearization",
    "linearize": "linearization",
    "Harmonic": "motion",
    "Motion": "motion",
    "Layout": "rendering",
    "Quality": "rendering",
    "picture": "rendering",
    "render": "rendering",
    "render_frame": "rendering",
    "Bending": "resistance",
    "Drag": "resistance",
    "Resistance": "resistance",
    "Break": "scene",
    "ControlSpec": "scene",
    "Load": "scene",
    "Scene": "scene",
    "Target": "scene",
    "Requirements": "scene_requirements",
    "requirements": "scene_requirements",
    "reproduce": "reproduction.reproduce",
    "Section": "section",
    "simulate": "simulation",
    "StableStep": "stability",
    "stable_step": "stability",
    "Hold": "statics.boundary",
    "find_equilibrium": "statics.equilibrium",
    "Rods": "statics.model",
    "follow": "statics.path",
    "StringLaw": "strings",
    "PointMass": "structure",
    "Rod": "structure",
    "String": "structure",
    "Structure": "structure",
    "Support": "structure",
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
    "Scaled": "studies.parameters",
    "Sweep": "studies.sweep",
    "TradeoffOptions": "studies.tradeoff.options",
    "Tradeoff": "studies.tradeoff.study",
    "tradeoff": "studies.tradeoff.study",
    "Extent": "studies.validation.sections",
    "Validation": "studies.validation.study",
    "validate": "studies.validation.study",
    "Backend": "studies.workers",
    "Workers": "studies.workers",
    "load_scene": "textformat",
    "load_structure": "textformat",
    "save_scene": "textformat",
    "save_structure": "textformat",
    "Status": "trajectory",
    "Trajectory": "trajectory",
    "Water": "water",
    "Weights": "water",
    "AboveLevel": "waves",
    "Sea": "waves",
    "Wave": "waves",
    "winch_power": "winches",
}
_MODULES = ("controllers", "plots", "statics")

__all__ = [*_HOME, *_MODULES]

if TYPE_CHECKING:  # the same names, for type checkers and editors
    from tensegrity_mj import controllers as controllers
    from tensegrity_mj import plots as plots
    from tensegrity_mj import statics as statics
    from tensegrity_mj.actuation import Actuation as Actuation
    from tensegrity_mj.actuation import OnInfeasible as OnInfeasible
    from tensegrity_mj.clearances import Approach as Approach
    from tensegrity_mj.clearances import Clearance as Clearance
    from tensegrity_mj.clearances import Event as Event
    from tensegrity_mj.clearances import Pairs as Pairs
    from tensegrity_mj.clearances import clearance as clearance
    from tensegrity_mj.comparison import Comparison as Comparison
    from tensegrity_mj.comparison import compare as compare
    from tensegrity_mj.compiled_law import CompiledLaw as CompiledLaw
    from tensegrity_mj.contact import Contact as Contact
    from tensegrity_mj.engines.dae import DAE as DAE
    from tensegrity_mj.engines.dae import Drift as Drift
    from tensegrity_mj.engines.dae import Solver as Solver
    from tensegrity_mj.engines.integration import Method as Method
    from tensegrity_mj.engines.mujoco import Integrator as Integrator
    from tensegrity_mj.engines.mujoco import MuJoCo as MuJoCo
    from tensegrity_mj.engines.ode import ODE as ODE
    from tensegrity_mj.ensemble import Ensemble as Ensemble
    from tensegrity_mj.ensemble import law_in as law_in
    from tensegrity_mj.ensemble import simulate_many as simulate_many
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
    from tensegrity_mj.flow_regime import FlowNumbers as FlowNumbers
    from tensegrity_mj.flow_regime import flow_numbers as flow_numbers
    from tensegrity_mj.law import Command as Command
    from tensegrity_mj.linearization import Linearization as Linearization
    from tensegrity_mj.linearization import linearize as linearize
    from tensegrity_mj.motion import Harmonic as Harmonic
    from tensegrity_mj.motion import Motion as Motion
    from tensegrity_mj.rendering import Layout as Layout
    from tensegrity_mj.rendering import Quality as Quality
    from tensegrity_mj.rendering import picture as picture
    from tensegrity_mj.rendering import render as render
    from tensegrity_mj.rendering import render_frame as render_frame
    from tensegrity_mj.reproduction.reproduce import reproduce as reproduce
    from tensegrity_mj.resistance import Bending as Bending
    from tensegrity_mj.resistance import Drag as Drag
    from tensegrity_mj.resistance import Resistance as Resistance
    from tensegrity_mj.scene import Break as Break
    from tensegrity_mj.scene import ControlSpec as ControlSpec
    from tensegrity_mj.scene import Load as Load
    from tensegrity_mj.scene import Scene as Scene
    from tensegrity_mj.scene import Target as Target
    from tensegrity_mj.scene_requirements import Requirements as Requirements
    from tensegrity_mj.scene_requirements import requirements as requirements
    from tensegrity_mj.section import Section as Section
    from tensegrity_mj.simulation import simulate as simulate
    from tensegrity_mj.stability import StableStep as StableStep
    from tensegrity_mj.stability import stable_step as stable_step
    from tensegrity_mj.statics.boundary import Hold as Hold
    from tensegrity_mj.statics.equilibrium import find_equilibrium as find_equilibrium
    from tensegrity_mj.statics.model import Rods as Rods
    from tensegrity_mj.statics.path import follow as follow
    from tensegrity_mj.strings import StringLaw as StringLaw
    from tensegrity_mj.structure import PointMass as PointMass
    from tensegrity_mj.structure import Rod as Rod
    from tensegrity_mj.structure import String as String
    from tensegrity_mj.structure import Structure as Structure
    from tensegrity_mj.structure import Support as Support
    from tensegrity_mj.studies.attempt import WithFiles as WithFiles
    from tensegrity_mj.studies.axes import Choice as Choice
    from tensegrity_mj.studies.axes import Draw as Draw
    from tensegrity_mj.studies.axes import LogUniform as LogUniform
    from tensegrity_mj.studies.axes import Normal as Normal
    from tensegrity_mj.studies.axes import Together as Together
    from tensegrity_mj.studies.axes import Uniform as Uniform
    from tensegrity_mj.studies.axes import Vary as Vary
    from tensegrity_mj.studies.many import Study as Study
    from tensegrity_mj.studies.many import run_many as run_many
    from tensegrity_mj.studies.page import write_sweep_page as write_sweep_page
    from tensegrity_mj.studies.parameters import Scaled as Scaled
    from tensegrity_mj.studies.sweep import Sweep as Sweep
    from tensegrity_mj.studies.tradeoff.options import TradeoffOptions as TradeoffOptions
    from tensegrity_mj.studies.tradeoff.study import Tradeoff as Tradeoff
    from tensegrity_mj.studies.tradeoff.study import tradeoff as tradeoff
    from tensegrity_mj.studies.validation.sections import Extent as Extent
    from tensegrity_mj.studies.validation.study import Validation as Validation
    from tensegrity_mj.studies.validation.study import validate as validate
    from tensegrity_mj.studies.workers import Backend as Backend
    from tensegrity_mj.studies.workers import Workers as Workers
    from tensegrity_mj.textformat import load_scene as load_scene
    from tensegrity_mj.textformat import load_structure as load_structure
    from tensegrity_mj.textformat import save_scene as save_scene
    from tensegrity_mj.textformat import save_structure as save_structure
    from tensegrity_mj.trajectory import Status as Status
    from tensegrity_mj.trajectory import Trajectory as Trajectory
    from tensegrity_mj.water import Water as Water
    from tensegrity_mj.water import Weights as Weights
    from tensegrity_mj.waves import AboveLevel as AboveLevel
    from tensegrity_mj.waves import Sea as Sea
    from tensegrity_mj.waves import Wave as Wave
    from tensegrity_mj.winches import winch_power as winch_power


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
