"""The main job: one scene in both engines under the thesis' law; video, plots, files and a one-page report."""

from __future__ import annotations

import argparse
import itertools
import math
import os
import sys
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import tensegrity_mj.library as library
from tensegrity_mj import engines, runs
from tensegrity_mj.basics.files import write_text
from tensegrity_mj.basics.jsontext import to_json
from tensegrity_mj.basics.texts import file_name
from tensegrity_mj.commands.common import Outcome, code_of_status, number, output_folder, table
from tensegrity_mj.errors import InfeasibleError, MissingLibraryError, OptionError, printable


def execute(options: argparse.Namespace) -> Outcome:
    """Run it and say where the files are."""

    demo = run_demo(options.out, options.scene)
    worst = max((demo.run, demo.reference), key=lambda run: code_of_status(run.status))
    files = {what: path.absolute() for what, path in demo.files.items()}
    data = {
        "status": worst.status,
        "message": worst.message,
        **demo.comparison.to_dict(),
        "agreement": demo.agreement_data(),
        "files": files,
        "no_video": demo.no_video,
    }
    rows = [("MuJoCo's time step", "largest node error against the DAE, and observed order")]
    for (step, largest, _), order in zip(demo.agreement, observed_orders(demo.agreement), strict=True):
        rows.append((number(step, "s"), number(largest, "m") + ("" if order is None else f"   ({order:.2f})")))
    places = table([(what, str(path)) for what, path in files.items()])
    lines = [table(rows), "", *([demo.no_video, ""] if demo.no_video else []), "Written:", places]
    return Outcome(data, "\n".join(lines), code_of_status(worst.status))


TIMESTEP = 1e-3  # s, of the run that is filmed


TIMESTEPS = (5e-3, 2e-3, 1e-3, 5e-4)  # s, of the table of agreement


RTOL, ATOL = 1e-12, 1e-12  # of the reference: well below the error of MuJoCo's RK4 at the smallest step


# What is plotted, by the ends of the files' names, and the captions in the report.
PLOTS = {
    "runs": "Errors, controls and multipliers over time: MuJoCo above, the DAE below.",
    "paths": "Paths of the nodes; rods at the end in black; the DAE dashed.",
    "differences": "Differences of the two runs over time.",
}


@dataclass(frozen=True)
class Demo:
    """What the main job made.

    Attributes:
        run, reference: the scene in MuJoCo and in the DAE.
        comparison: of the two.
        agreement: (time step [s], largest node error [m], RMS node error [m]) for each step of MuJoCo.
        files: what was written, by what it is; without "video" where there is no OpenGL.
        no_video: why there is none, and what it needs; else empty.
    """

    run: runs.Trajectory
    reference: runs.Trajectory
    comparison: runs.Comparison
    agreement: list[tuple[float, float, float]]
    files: dict[str, Path] = field(default_factory=dict)
    no_video: str = ""

    def agreement_data(self) -> list[dict[str, float]]:
        """The agreement for JSON."""
        names = ("timestep", "max_node_error", "rms_node_error")
        return [dict(zip(names, row, strict=True)) for row in self.agreement]


def run_demo(out: str | os.PathLike[str] = "results", scene: str = "prism", *, progress: bool = True) -> Demo:
    """Run the main job and write its files into a folder, which is made if it is absent.

    Args:
        out: the folder.
        scene: a scene with a continuous control law: a shipped one, or a path.
        progress: say on stderr what is being done.

    Raises:
        OptionError: if the folder cannot be made or written in, or the scene has no control law.
        InfeasibleError, DivergenceError: if a simulation ends before its time.
    """
    from tensegrity_mj.controllers.scenes import from_scene
    from tensegrity_mj.simulation import simulate

    experiment = library.load_scene(scene)
    if experiment.control is None:
        raise OptionError(
            f"scene '{experiment.name}' has no control law; choose one that has, such as prism or pinned_rod"
        )
    law, name = from_scene(experiment), file_name(experiment.name)
    folder = output_folder(out, (f"{name}.json", "report.html"))

    def report(text: str) -> None:
        if progress:
            print(text, file=sys.stderr)

    report(f"1/4 Simulating {printable(experiment.name)} in both engines")
    reference = simulate(experiment, law, engines.DAE(rtol=RTOL, atol=ATOL), progress=progress)
    found = {
        step: simulate(experiment, law, engines.MuJoCo(step, engines.Integrator.RK4), progress=progress)
        for step in TIMESTEPS
    }
    for trajectory in (reference, *found.values()):
        if trajectory.status is not runs.Status.COMPLETED:
            raise InfeasibleError(
                f"{trajectory.engine}: {trajectory.message}; choose a scene whose law can be followed"
            )
    run, comparisons = found[TIMESTEP], {step: runs.compare(one, reference) for step, one in found.items()}
    agreement = [(step, one.max_node_error, one.rms_node_error) for step, one in comparisons.items()]
    files = {"MuJoCo's run": folder / f"{name}-mujoco.nc", "the DAE's run": folder / f"{name}-dae.nc"}
    for path, trajectory in zip(files.values(), (run, reference), strict=True):
        trajectory.save(path)

    report("2/4 Plotting")
    import mediapy  # noqa: F401  (brings IPython, which matplotlib looks at: not in two threads at once)

    from tensegrity_mj.pictures import plots

    pictures = {what: folder / f"{name}-{what}.png" for what in PLOTS}
    files |= {f"plot of the {what}": path for what, path in pictures.items()}

    def plot() -> None:
        plots.plot_run([run, reference], pictures["runs"])
        plots.plot_paths([run, reference], pictures["paths"])
        plots.plot_comparison(comparisons[TIMESTEP], pictures["differences"], runs=[run, reference])

    # Beside the film, most of whose time passes in OpenGL and in ffmpeg.
    with ThreadPoolExecutor(1) as beside:
        plotted = beside.submit(plot)
        report("3/4 Filming")
        video, no_video = folder / f"{name}.mp4", ""
        try:
            from tensegrity_mj.pictures.video import render

            files["video"] = render(run, video, other=reference, progress=progress)
        except MissingLibraryError as error:
            no_video = f"No video: {error}"
            report(no_video)
            video.unlink(missing_ok=True)  # of an earlier run, which it would not belong to
        plotted.result()

    report("4/4 Writing the report")
    demo = Demo(run, reference, comparisons[TIMESTEP], agreement, files, no_video)
    files["numbers"] = folder / f"{name}.json"
    _write_numbers(demo, files["numbers"])
    files["report"] = folder / "report.html"
    _write_report(demo, files["report"])
    return demo


def _write_report(demo: Demo, path: Path) -> None:
    from tensegrity_mj.pictures.page import Picture, Table, write_report

    write_report(
        path,
        [demo.run, demo.reference],
        introduction=(
            "One structure under one control law, in two independent formulations: MuJoCo with RK4, and the thesis' "
            "differential-algebraic equations with an error-controlled method."
        ),
        comparison=demo.comparison,
        pictures=[Picture(demo.files[f"plot of the {what}"], caption) for what, caption in PLOTS.items()],
        video=demo.files.get("video"),
        video_note=demo.no_video or "MuJoCo solid, the DAE translucent over it, the target as a ghost.",
        tables=[
            Table(
                "Agreement against MuJoCo's time step",
                ("time step [s]", "largest node error [m]", "RMS node error [m]", "observed order"),
                [(*row, order) for row, order in zip(demo.agreement, observed_orders(demo.agreement), strict=True)],
                "RK4 is of fourth order where the law is smooth. Here strings go slack and taut again (u >= 0 has "
                "kinks), and the step that a kink falls into decides the error, so that it falls unevenly.",
            )
        ],
    )


def observed_orders(agreement: Sequence[tuple[float, float, float]]) -> list[float | None]:
    """Order of convergence between each time step and the one before: log ratio of errors over that of steps."""
    orders: list[float | None] = [None]
    for (coarse, large, _), (fine, small, _) in itertools.pairwise(agreement):
        orders.append(math.log(large / small) / math.log(coarse / fine) if large > 0 and small > 0 else None)
    return orders


def _write_numbers(demo: Demo, path: Path) -> None:
    def of(run: runs.Trajectory) -> dict[str, Any]:
        return {"engine": run.engine, "status": run.status.value, "cost": run.cost, "reports": run.reports}

    data = {
        "scene": demo.run.scene.name,
        "mujoco": of(demo.run),
        "dae": of(demo.reference),
        "comparison": demo.comparison.to_dict(),
        "agreement": demo.agreement_data(),
    }
    write_text(path, to_json(data, indent=2) + "\n")
