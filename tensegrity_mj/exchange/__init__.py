"""Others' models in, ours out: files of NTRT, STEDY, MOTES, TsgFEM, tables and MJCF (docs/exchange.md)."""

from typing import TYPE_CHECKING

from tensegrity_mj.basics.faces import face

if TYPE_CHECKING:
    from tensegrity_mj.exchange.importing import FORMATS as FORMATS
    from tensegrity_mj.exchange.importing import Imported as Imported
    from tensegrity_mj.exchange.importing import ImportOptions as ImportOptions
    from tensegrity_mj.exchange.importing import import_scene as import_scene
    from tensegrity_mj.exchange.matlab_file import save_mat as save_mat
    from tensegrity_mj.exchange.menagerie import save_menagerie as save_menagerie
    from tensegrity_mj.exchange.menagerie import save_mjcf_for as save_mjcf_for
    from tensegrity_mj.exchange.pack import save_pack as save_pack
    from tensegrity_mj.exchange.solids import save_stl as save_stl
    from tensegrity_mj.exchange.tables import save_csv as save_csv
else:
    __getattr__, __dir__ = face(__name__)
