"""The main job: one scene in both engines under the thesis' law; video, plots, files and a one-page report."""

from __future__ import annotations

import argparse

from tensegrity_mj.commands.common import Outcome, code_of_status, number, table

HELP = "run the main job: the prism in both engines, compared and filmed"
EXAMPLES = """\
examples:
  tensegrity-mj demo
  tensegrity-mj demo --scene pinned_rod --out /tmp/pinned
"""


def configure(parser: argparse.ArgumentParser) -> None:
    """The options of `demo`."""
    parser.add_argument("--out", metavar="FOLDER", default="results", help="for the files; made if absent (results)")
    parser.add_argument("--scene", metavar="SCENE", default="prism", help="a scene with a control law (prism)")


def execute(options: argparse.Namespace) -> Outcome:
    """Run it and say where the files are."""
    from tensegrity_mj.demo import observed_orders, run_demo

    demo = run_demo(options.out, options.scene)
    worst = max((demo.run, demo.reference), key=lambda run: code_of_status(run.status))
    files = {what: path.absolute() for what, path in demo.files.items()}
    data = {
        "status": worst.status,
        "message": worst.message,
        **demo.comparison.to_dict(),
        "agreement": [
            {"timestep": step, "max_node_error": largest, "rms_node_error": rms}
            for step, largest, rms in demo.agreement
        ],
        "files": files,
        "no_video": demo.no_video,
    }
    rows = [("MuJoCo's time step", "largest node error against the DAE, and observed order")]
    for (step, largest, _), order in zip(demo.agreement, observed_orders(demo.agreement), strict=True):
        rows.append((number(step, "s"), number(largest, "m") + ("" if order is None else f"   ({order:.2f})")))
    places = table([(what, str(path)) for what, path in files.items()])
    lines = [table(rows), "", *([demo.no_video, ""] if demo.no_video else []), "Written:", places]
    return Outcome(data, "\n".join(lines), code_of_status(worst.status))
