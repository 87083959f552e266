"""What a part of the package cannot do yet, refused in words before it would compute nonsense."""

from __future__ import annotations

from tensegrity_mj.errors import SceneError, StructureError
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


def require_still_supports(scene: Scene, who: str) -> None:
    """Raise SceneError where supports move; `who` begins the sentence, as "the ODE is"."""
    if scene.motions:
        raise SceneError(
            f"{who} for supports that stand still; here '{scene.motions[0].support}' moves (scene.motions)"
        )


def require_loads_alone(scene: Scene, who: str) -> None:
    """Raise SceneError where more than loads acts on nodes; `who` begins the sentence, as "dm_control models are"."""
    for element in scene.effects:
        if element.label != "loads":
            raise SceneError(
                f"{who} for scenes without {element.label}: a MuJoCo model by itself has no such forces, a callback "
                "finds them; use simulate or law_in, or leave it out with "
                f"scene.with_({element.label if element.label in ('resistance', 'water') else 'elements'}=...)"
            )
