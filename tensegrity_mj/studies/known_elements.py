"""Scenes in the processes of a study, which have seen no call that has registered the classes of their elements."""

from __future__ import annotations

import functools
from collections.abc import Mapping
from importlib import import_module
from typing import Any

from tensegrity_mj.basics.fields import kind_of, register, registered
from tensegrity_mj.errors import OptionError
from tensegrity_mj.model.elements.element import Element
from tensegrity_mj.model.scene import Scene
from tensegrity_mj.model.text.reading import scene_from_toml


def elements_of(scene: Scene) -> dict[str, Any]:
    """Return where a process of a study finds the classes of a scene's elements that a call has registered here."""
    kinds = {kind_of(type(element)): type(element) for element in scene.elements}
    places = {kind: f"{cls.__module__}:{cls.__qualname__}" for kind, cls in kinds.items() if kind}
    return {"elements": places} if places else {}


def know_elements(places: Mapping[str, str]) -> None:
    """Register what `elements_of` found, in a process that does not know it yet.

    Raises:
        OptionError: for a class that another process cannot import.
    """
    known = registered(Element)
    for kind, place in places.items():
        if kind in known:
            continue
        module, _, name = place.partition(":")
        try:
            register(kind, getattr(import_module(module), name))
        except (ImportError, AttributeError) as error:
            raise OptionError(
                f"elements: kind '{kind}' is the class {name} of {module}, which another process cannot import: define "
                "it in a module, or run the study in this process"
            ) from error


@functools.lru_cache(maxsize=16)
def scene_of(text: str) -> Scene:
    """The scene of a text, which many points of a study share."""
    return scene_from_toml(text, where="the scene of the study")
