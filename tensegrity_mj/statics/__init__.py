"""Statics of tensegrity structures: equilibria, their stiffness and modes, loads up to buckling, members' strength."""

from typing import TYPE_CHECKING

from tensegrity_mj.basics.faces import face

if TYPE_CHECKING:
    from tensegrity_mj.statics.boundary import Hold as Hold
    from tensegrity_mj.statics.engines import EngineCheck as EngineCheck
    from tensegrity_mj.statics.engines import EngineEquilibrium as EngineEquilibrium
    from tensegrity_mj.statics.engines import check_engine as check_engine
    from tensegrity_mj.statics.engines import engine_equilibrium as engine_equilibrium
    from tensegrity_mj.statics.equilibrium import find_equilibrium as find_equilibrium
    from tensegrity_mj.statics.equilibrium import relax as relax
    from tensegrity_mj.statics.lightest import ALUMINIUM as ALUMINIUM
    from tensegrity_mj.statics.lightest import STEEL as STEEL
    from tensegrity_mj.statics.lightest import UHMWPE as UHMWPE
    from tensegrity_mj.statics.lightest import Governs as Governs
    from tensegrity_mj.statics.lightest import Material as Material
    from tensegrity_mj.statics.lightest import Sizing as Sizing
    from tensegrity_mj.statics.lightest import minimal_mass as minimal_mass
    from tensegrity_mj.statics.model import Rods as Rods
    from tensegrity_mj.statics.model import StaticModel as StaticModel
    from tensegrity_mj.statics.modes import Modes as Modes
    from tensegrity_mj.statics.modes import mode_trajectory as mode_trajectory
    from tensegrity_mj.statics.modes import natural_modes as natural_modes
    from tensegrity_mj.statics.path import Curve as Curve
    from tensegrity_mj.statics.path import End as End
    from tensegrity_mj.statics.path import Path as Path
    from tensegrity_mj.statics.path import Response as Response
    from tensegrity_mj.statics.path import SlackEvent as SlackEvent
    from tensegrity_mj.statics.path import follow as follow
    from tensegrity_mj.statics.path_steps import Critical as Critical
    from tensegrity_mj.statics.path_steps import Kind as Kind
    from tensegrity_mj.statics.prestress import Prestressability as Prestressability
    from tensegrity_mj.statics.prestress import prestressability as prestressability
    from tensegrity_mj.statics.standing import stand as stand
    from tensegrity_mj.statics.standing import tipping as tipping
    from tensegrity_mj.statics.state import StaticState as StaticState
    from tensegrity_mj.statics.state import standalone_scene as standalone_scene
    from tensegrity_mj.statics.stiffening import Verdict as Verdict
    from tensegrity_mj.statics.strength import Criterion as Criterion
    from tensegrity_mj.statics.strength import MemberCheck as MemberCheck
    from tensegrity_mj.statics.strength import SlackInterval as SlackInterval
    from tensegrity_mj.statics.strength import TrajectoryCheck as TrajectoryCheck
    from tensegrity_mj.statics.strength import Use as Use
    from tensegrity_mj.statics.strength import check_members as check_members
    from tensegrity_mj.statics.strength import check_state as check_state
    from tensegrity_mj.statics.strength import check_trajectory as check_trajectory
    from tensegrity_mj.statics.study import Materials as Materials
    from tensegrity_mj.statics.study import Search as Search
    from tensegrity_mj.statics.study import StaticStudy as StaticStudy
    from tensegrity_mj.statics.study import analyse as analyse
else:
    __getattr__, __dir__ = face(__name__)
