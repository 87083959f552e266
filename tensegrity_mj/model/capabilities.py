"""What a part of the package cannot do yet, refused in words before it would compute nonsense."""

from __future__ import annotations

from tensegrity_mj.errors import OptionError, SceneError, StructureError
from tensegrity_mj.model.scene import Scene
from tensegrity_mj.model.structure import Structure


def require_class_1(structure: Structure, who: str) -> None:
    """Raise StructureError where rods share nodes; `who` begins the sentence, as "the ODE is"."""
    if structure.class_number > 1:
        name = next(name for name, rows in structure.rods_at.items() if len(rows) > 1)
        rods = " and ".join(f"'{structure.rods[row].name}'" for row in structure.rods_at[name][:2])
        raise StructureError(
            f"{who} for structures of class 1, whose rods share no node; here rods {rods} share node '{name}'"
        )


def require_no_resistance(scene: Scene, who: str) -> None:
    """Raise SceneError where something resists motion; `who` begins the sentence, as "dm_control models are"."""
    if scene.resistance is not None:
        raise SceneError(
            f"{who} for scenes without resistance; use simulate, or leave it out with scene.with_(resistance=None)"
        )


def require_still_supports(scene: Scene, who: str) -> None:
    """Raise SceneError where supports move; `who` begins the sentence, as "the ODE is"."""
    if scene.motions:
        raise SceneError(
            f"{who} for supports that stand still; here '{scene.motions[0].support}' moves (scene.motions)"
        )


def require_dry(scene: Scene, who: str) -> None:
    """Raise SceneError where there is water; `who` begins the sentence, as "the ODE is"."""
    if scene.water is not None:
        raise SceneError(
            f"{who} for scenes without water; use simulate with the DAE or MuJoCo, or leave it out with "
            "scene.with_(water=None)"
        )


def require_wet_rods(scene: Scene, who: str, solver_fits: bool = True) -> None:
    """Raise where an engine cannot find the accelerations of rods in water; `who` is its name, as "MuJoCo".

    Raises:
        StructureError: where rods share nodes.
        SceneError: where supports move, or rods touch.
        OptionError: where the solver does not fit.
    """
    if scene.water is None:
        return
    require_class_1(scene.structure, f"{who} in water is")
    require_still_supports(scene, f"{who} in water is")
    if scene.contact is not None:
        raise SceneError(
            f"{who} in water is for scenes without contact, whose forces are not known when the added mass is found; "
            "leave one of the two out with scene.with_(contact=None) or scene.with_(water=None)"
        )
    if not solver_fits:
        raise OptionError(f"{who}: in water, accelerations are found by Solver.JOINTS alone: leave solver out")
