"""Structures and scenes as TOML that a person can write; read and saved without loss. See docs/format.md.

Numbers are written with the fewest digits that read back to the same float. The reader says what is wrong
(`FormatError`: what no file of this format may hold; `StructureError`, `SceneError`: what is well written but
not valid), always with the file first.

keys               what each table may hold, and how much a file may
codec              tables, whose keys have types, into values and back
sources, reading   texts and files in, members of what tables hold
writing            texts and files out
schema             the format as a JSON Schema, for editors
"""

from tensegrity_mj.model.text.reading import scene_from_toml as scene_from_toml
from tensegrity_mj.model.text.reading import structure_from_toml as structure_from_toml
from tensegrity_mj.model.text.sources import scene_names as scene_names
from tensegrity_mj.model.text.writing import save_scene as save_scene
from tensegrity_mj.model.text.writing import save_structure as save_structure
from tensegrity_mj.model.text.writing import scene_to_toml as scene_to_toml
from tensegrity_mj.model.text.writing import structure_to_toml as structure_to_toml
