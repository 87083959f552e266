"""The elements of the package as array functions: what acts on nodes beside strings, gravity and water.

Formulas are those of `model.elements`, derived again from the words there: what has a potential states it, and its
forces come by differentiation.
"""

from __future__ import annotations

from tensegrity_mj.engines.jax.arrays import ArrayEffect
from tensegrity_mj.errors import ElementError
from tensegrity_mj.model.elements.element import Element, named_function
from tensegrity_mj.model.scene import Scene


def array_effects(scene: Scene) -> list[ArrayEffect]:
    """All that acts on the nodes of a scene (`Scene.effects`), in that order.

    Raises:
        ElementError: for an element without an array function, or whose function is none.
    """
    return [array_effect(element, scene) for element in scene.effects]


def array_effect(element: Element, scene: Scene) -> ArrayEffect:
    """One element of a scene, by the function that its `arrays` names.

    Raises:
        ElementError: see `array_effects`.
    """
    if not element.arrays:
        raise ElementError(
            f"element {element.label} has no array function: name one in its attribute `arrays` (docs/elements.md), or "
            "take another engine"
        )
    effect = named_function(element, "arrays")(element, scene)
    if not isinstance(effect, ArrayEffect):
        raise ElementError(
            f"element {element.label}: {element.arrays} returned {effect!r}; it must return an ArrayEffect"
        )
    return effect
