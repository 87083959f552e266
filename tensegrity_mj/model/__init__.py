"""Models to simulate: structures, scenes, effects on them, targets and moved supports, and their text format."""

from typing import TYPE_CHECKING

from tensegrity_mj.basics.faces import face

if TYPE_CHECKING:
    from tensegrity_mj.basics.fields import register as register
    from tensegrity_mj.model.actuation import Actuation as Actuation
    from tensegrity_mj.model.actuation import OnInfeasible as OnInfeasible
    from tensegrity_mj.model.bodies import Body as Body
    from tensegrity_mj.model.constraints import Constraint as Constraint
    from tensegrity_mj.model.elements.contact import Contact as Contact
    from tensegrity_mj.model.elements.element import Element as Element
    from tensegrity_mj.model.elements.element import Work as Work
    from tensegrity_mj.model.elements.resistance import Bending as Bending
    from tensegrity_mj.model.elements.resistance import Drag as Drag
    from tensegrity_mj.model.elements.resistance import Resistance as Resistance
    from tensegrity_mj.model.elements.terrain import Heights as Heights
    from tensegrity_mj.model.elements.terrain import Ramp as Ramp
    from tensegrity_mj.model.elements.terrain import Rough as Rough
    from tensegrity_mj.model.elements.terrain import Stairs as Stairs
    from tensegrity_mj.model.elements.water import Water as Water
    from tensegrity_mj.model.elements.water import Weights as Weights
    from tensegrity_mj.model.elements.waves import AboveLevel as AboveLevel
    from tensegrity_mj.model.elements.waves import IrregularSea as IrregularSea
    from tensegrity_mj.model.elements.waves import Sea as Sea
    from tensegrity_mj.model.elements.waves import Wave as Wave
    from tensegrity_mj.model.events import Break as Break
    from tensegrity_mj.model.events import ControlSpec as ControlSpec
    from tensegrity_mj.model.events import Load as Load
    from tensegrity_mj.model.ground import Ground as Ground
    from tensegrity_mj.model.members import PointMass as PointMass
    from tensegrity_mj.model.members import Rod as Rod
    from tensegrity_mj.model.members import RodMass as RodMass
    from tensegrity_mj.model.members import String as String
    from tensegrity_mj.model.members import Support as Support
    from tensegrity_mj.model.motion import Harmonic as Harmonic
    from tensegrity_mj.model.motion import Motion as Motion
    from tensegrity_mj.model.ropes import RopeStart as RopeStart
    from tensegrity_mj.model.scene import Scene as Scene
    from tensegrity_mj.model.section import Section as Section
    from tensegrity_mj.model.strings import StringLaw as StringLaw
    from tensegrity_mj.model.structure import Structure as Structure
    from tensegrity_mj.model.target import Target as Target
    from tensegrity_mj.model.text.reading import load_ground as load_ground
    from tensegrity_mj.model.text.schema import format_schema as format_schema
    from tensegrity_mj.model.text.writing import save_scene as save_scene
    from tensegrity_mj.model.text.writing import save_structure as save_structure
else:
    __getattr__, __dir__ = face(__name__)
