"""Families of scenes: builders with parameters, of which the shipped scenes are members."""

from typing import TYPE_CHECKING

from tensegrity_mj.basics.faces import face

if TYPE_CHECKING:
    from tensegrity_mj.library.named import family_names as family_names
    from tensegrity_mj.library.named import family_scene as family_scene
    from tensegrity_mj.library.named import load_scene as load_scene
    from tensegrity_mj.library.named import load_structure as load_structure
    from tensegrity_mj.model.text.sources import scene_names as scene_names
else:
    __getattr__, __dir__ = face(__name__)
