"""Pictures of runs: videos, plots, reports; motion between samples, camera, off-screen OpenGL, text."""

from typing import TYPE_CHECKING

from tensegrity_mj.basics.faces import face

if TYPE_CHECKING:
    from tensegrity_mj.pictures import plots as plots
    from tensegrity_mj.pictures.video import picture as picture
    from tensegrity_mj.pictures.video import render as render
    from tensegrity_mj.pictures.video import render_frame as render_frame
    from tensegrity_mj.pictures.video import still as still
    from tensegrity_mj.pictures.view import Layout as Layout
    from tensegrity_mj.pictures.view import Quality as Quality
    from tensegrity_mj.pictures.viewer import play as play
    from tensegrity_mj.pictures.web import WebPage as WebPage
    from tensegrity_mj.pictures.web import make_web_page as make_web_page
else:
    __getattr__, __dir__ = face(__name__)
