"""What makes a structure or a scene valid. Every message: the item, its value, what is allowed, the remedy.

values          numbers, vectors, texts, sequences
geometry        lengths and directions, and what they are compared with
members         a rod, a string
structures      a structure
configurations  node positions and velocities
targets, contacts, resistances, waters, scenes
"""

from tensegrity_mj.validation.configurations import check_configuration as check_configuration
from tensegrity_mj.validation.scenes import check_scene as check_scene
from tensegrity_mj.validation.structures import check_structure as check_structure
from tensegrity_mj.validation.targets import check_target as check_target
from tensegrity_mj.validation.values import array_of_shape as array_of_shape
from tensegrity_mj.validation.values import check_number as check_number
from tensegrity_mj.validation.values import check_vector as check_vector
from tensegrity_mj.validation.values import index_pairs as index_pairs
from tensegrity_mj.validation.values import sequence_of as sequence_of
