"""The main job: the prism in both engines under the thesis' law; video, plots, files and a one-page report."""

from __future__ import annotations

import argparse

from tensegrity_mj.commands.common import Outcome, code_of_status

HELP = "run the main job: the prism in both engines, compared and filmed"
EXAMPLES = """\
example:
  tensegrity-mj demo --out results
"""


def configure(parser: argparse.ArgumentParser) -> None:
    """The options of `demo`."""
    parser.add_argument(
        "--out", metavar="FOLDER", default="results", help="where the files go; made if absent (results)"
    )
    parser.add_argument("--scene", metavar="SCENE", default="prism", help="another scene with a control law (prism)")


def execute(options: argparse.Namespace) -> Outcome:
    """Run it and say where the files are."""
    from tensegrity_mj.demo import run_demo
