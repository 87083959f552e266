"""What a scene has that a format of other programs cannot hold."""

from __future__ import annotations

from collections.abc import Sequence

from tensegrity_mj.basics.fields import item_of
from tensegrity_mj.model.scene import Scene
from tensegrity_mj.model.strings import StringLaw
from tensegrity_mj.model.structure_checks import names_of

WORDS = {"name": "", "source": "", "structure": "", "duration": ""}


def left_out(scene: Scene, kept: Sequence[str]) -> list[str]:
    """A sentence for each field of a scene that is not at its default, and not among those kept."""
    notes = []
    if scene.structure.string_law is not StringLaw.CLIPPED:
        notes.append(f"the string law '{scene.structure.string_law.value}' is left out")
    strings = scene.structure.strings
    curved, own = [len(one.curve) > 1 for one in strings], [one.string_law is not None for one in strings]
    for words, having in (
        ("the tension curves of strings {} are left out, but for their first slopes", curved),
        ("the string laws of strings {} are left out", own),
    ):
        if names := [string.name for string, has in zip(strings, having, strict=True) if has]:
            notes.append(words.format(names_of(names)))
    structure = scene.structure
    if any(point.damping for point in structure.point_masses):
        notes.append("the damping of point masses is left out")
    if any(rod.masses for rod in structure.rods):
        notes.append("the masses that rods carry are left out")
    if structure.constraints and "constraints" not in kept:
        notes.append("the linear constraints are left out")
    for key, one in item_of(Scene).keys.items():
        value = getattr(scene, one.name)
        if key in WORDS or key in kept or value is None or value is one.default or value == one.default:
            continue
        notes.append(f"the scene's {key.replace('_', ' ')} is left out")
    return notes
