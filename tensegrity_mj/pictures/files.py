"""The output files of `tensegrity_mj.files`, under the name that the pictures import them by."""

from tensegrity_mj.files import checked, replacing

__all__ = ["checked", "replacing"]
