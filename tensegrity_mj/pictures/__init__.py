"""How runs are seen: videos, pictures, plots, reports; motion between samples, camera, off-screen OpenGL, text."""

from typing import TYPE_CHECKING

from tensegrity_mj.basics.faces import face

if TYPE_CHECKING:
    from tensegrity_mj.pictures import plots as plots
    from tensegrity_mj.pictures.stage import Layout as Layout
    from tensegrity_mj.pictures.stage import Quality as Quality
    from tensegrity_mj.pictures.video import picture as picture
    from tensegrity_mj.pictures.video import render as render
    from tensegrity_mj.pictures.video import render_frame as render_frame
else:
    __getattr__, __dir__ = face(__name__)
