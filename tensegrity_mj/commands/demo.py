"""The main job: one scene in both engines under the thesis' law; video, plots, files and a one-page report."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import tensegrity_mj.library as library
from tensegrity_mj import controllers, engines, model, pictures, runs, simulation
from tensegrity_mj.basics.files import write_text
from tensegrity_mj.basics.jsontext import to_json
from tensegrity_mj.basics.texts import file_name
from tensegrity_mj.commands.common import Outcome, code_of_status, number, output_folder, table
from tensegrity_mj.errors import InfeasibleError, MissingLibraryError, OptionError, printable

TIMESTEP = 1e-3  # s, of the run that is filmed
TIMESTEPS = (5e-3, 2e-3, 1e-3, 5e-4)  # s, of the table of agreement
RTOL, ATOL = 1e-12, 1e-12  # of the reference: well below the error of MuJoCo's RK4 at the smallest step

# What is plotted, by the ends of the files' names, and the captions in the report.
PLOTS = {
    "runs": "Errors, controls and multipliers over time: MuJoCo above, the DAE below.",
    "paths": "Paths of the nodes; rods at the end in black; the DAE dashed.",
    "differences": "Differences of the two runs over time.",
}
# What is compiled in a second process where it is not kept: what is needed last, the largest first.
COMPILED_BESIDE = (
    "tensegrity_mj.engines.mujoco.install:single_run",
    "tensegrity_mj.engines.mujoco.install:finish",
    "tensegrity_mj.dynamics.native.law_at_states:evaluate_at_states",
    "tensegrity_mj.engines.reference.dop853:dop853_step",
    "tensegrity_mj.pictures.shrink:_average",
    "tensegrity_mj.dynamics.target:_target_nodes",
)
Agreement = list[dict[str, float]]  # a row for each time step of MuJoCo: [s], and node errors [m]


def execute(options: argparse.Namespace) -> Outcome:
    """Simulate, draw, write everything into a folder, which is made if it is absent, and say where the files are.

    Raises:
        OptionError: if the folder cannot be made or written in, or the scene has no control law.
        InfeasibleError, DivergenceError: if a simulation ends before its time.
    """
    from tensegrity_mj.dynamics.native.beside import second_process  # numpy, which help and parsing need not load

    with second_process(COMPILED_BESIDE):
        return _outcome(options)


def _outcome(options: argparse.Namespace) -> Outcome:
    scene = library.load_scene(options.scene)
    if scene.control is None:
        raise OptionError(f"scene '{scene.name}' has no control law; choose one that has, such as prism or pinned_rod")
    name = file_name(scene.name)
    folder = output_folder(options.out, (f"{name}.json", "report.html"))

    _report(f"1/4 Simulating {printable(scene.name)} in both engines")
    reference, found = _simulated(scene)
    run, comparisons = found[TIMESTEP], {step: runs.compare(one, reference) for step, one in found.items()}
    comparison = comparisons[TIMESTEP]
    agreement = [
        {"timestep": step, "max_node_error": one.max_node_error, "rms_node_error": one.rms_node_error}
        for step, one in comparisons.items()
    ]
    files = {"MuJoCo's run": folder / f"{name}-mujoco.nc", "the DAE's run": folder / f"{name}-dae.nc"}
    for path, trajectory in zip(files.values(), (run, reference), strict=True):
        trajectory.save(path)
    drawn, no_video = _drawn([run, reference], comparison, folder, name)
    files |= drawn

    _report("4/4 Writing the report")
    numbers: dict[str, Any] = {"scene": scene.name, "mujoco": _numbers(run), "dae": _numbers(reference)}
    numbers |= {"comparison": comparison.to_dict(), "agreement": agreement}
    files["numbers"] = write_text(folder / f"{name}.json", to_json(numbers, indent=2) + "\n")
    files["report"] = _write_report(folder / "report.html", [run, reference], comparison, agreement, files, no_video)

    worst = max((run, reference), key=lambda run: code_of_status(run.status))
    places = {what: path.absolute() for what, path in files.items()}
    data = {"status": worst.status, "message": worst.message, **comparison.to_dict(), "agreement": agreement}
    rows = [("MuJoCo's time step", "largest node error against the DAE, and observed order")]
    for row, order in zip(agreement, observed_orders(agreement), strict=True):
        error = number(row["max_node_error"], "m") + ("" if order is None else f"   ({order:.2f})")
        rows.append((number(row["timestep"], "s"), error))
    written = table([(what, str(path)) for what, path in places.items()])
    lines = [table(rows), "", *([no_video, ""] if no_video else []), "Written:", written]
    data |= {"files": places, "no_video": no_video}
    from tensegrity_mj.pictures.page import judgement_of_runs

    judgement = judgement_of_runs([run, reference], comparison)
    return Outcome(data, "\n".join(lines), code_of_status(worst.status), judgement=judgement)


def _report(text: str) -> None:
    print(text, file=sys.stderr)


def _simulated(scene: model.Scene) -> tuple[runs.Trajectory, dict[float, runs.Trajectory]]:
    """The run of the DAE, and those of MuJoCo by their time steps [s]."""
    law = controllers.from_scene(scene)
    reference = simulation.simulate(scene, law, engines.DAE(rtol=RTOL, atol=ATOL), progress=True)
    found = {
        step: simulation.simulate(scene, law, engines.MuJoCo(step, engines.Integrator.RK4), progress=True)
        for step in TIMESTEPS
    }
    for run in (reference, *found.values()):
        if run.status is not runs.Status.COMPLETED:
            raise InfeasibleError(f"{run.engine}: {run.message}; choose a scene whose law can be followed")
    return reference, found


def _drawn(
    both: list[runs.Trajectory], comparison: runs.Comparison, folder: Path, name: str
) -> tuple[dict[str, Path], str]:
    """Plots and the film of two runs, by what they are; and why there is no film, and what it needs, else ""."""
    _report("2/4 Plotting")
    import mediapy  # noqa: F401  (brings IPython, which matplotlib looks at: not in two threads at once)

    plots = {what: folder / f"{name}-{what}.png" for what in PLOTS}
    files = {f"plot of the {what}": path for what, path in plots.items()}

    def plot() -> None:
        pictures.plots.plot_run(both, plots["runs"])
        pictures.plots.plot_paths(both, plots["paths"])
        pictures.plots.plot_comparison(comparison, plots["differences"], runs=both)

    # In parallel with the film, most of whose time passes in OpenGL and in ffmpeg.
    with ThreadPoolExecutor(1) as pool:
        plotted = pool.submit(plot)
        _report("3/4 Filming")
        video, no_video = folder / f"{name}.mp4", ""
        try:
            files["video"] = pictures.render(both[0], video, other=both[1], progress=True)
        except MissingLibraryError as error:
            no_video = f"No video: {error}"
            _report(no_video)
            video.unlink(missing_ok=True)  # of an earlier run, which it would not belong to
        plotted.result()
    return files, no_video


def _numbers(run: runs.Trajectory) -> dict[str, Any]:
    return {"engine": run.engine, "status": run.status.value, "cost": run.cost, "reports": run.reports}


def _write_report(
    path: Path,
    both: list[runs.Trajectory],
    comparison: runs.Comparison,
    agreement: Agreement,
    files: Mapping[str, Path],
    no_video: str,
) -> Path:
    from tensegrity_mj.pictures.page import Picture, Table, write_report

    return write_report(
        path,
        both,
        introduction=(
            "One structure under one control law, in two independent formulations: MuJoCo with RK4, and the thesis' "
            "differential-algebraic equations with an error-controlled method."
        ),
        comparison=comparison,
        pictures=[Picture(files[f"plot of the {what}"], caption) for what, caption in PLOTS.items()],
        video=files.get("video"),
        video_note=no_video or "MuJoCo solid, the DAE translucent over it, the target as a ghost.",
        tables=[
            Table(
                "Agreement against MuJoCo's time step",
                ("time step [s]", "largest node error [m]", "RMS node error [m]", "observed order"),
                [(*row.values(), order) for row, order in zip(agreement, observed_orders(agreement), strict=True)],
                "RK4 is of fourth order where the law is smooth. Here strings go slack and taut again (u >= 0 has "
                "kinks), and the step that a kink falls into decides the error, so that it falls unevenly.",
            )
        ],
    )


def observed_orders(agreement: Sequence[Mapping[str, float]]) -> list[float | None]:
    """Order of convergence between each time step and the one before."""
    steps, errors = ([row[key] for row in agreement] for key in ("timestep", "max_node_error"))
    return [None, *runs.orders_between(steps, errors)]
