"""Compare two runs: two engines on one scene, or two files; or tables of other programs with a scene's reference."""

from __future__ import annotations

import argparse
import functools
import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import tensegrity_mj.library as library
from tensegrity_mj import pictures, runs
from tensegrity_mj.basics.files import checked
from tensegrity_mj.basics.texts import closest
from tensegrity_mj.basics.units import quantity
from tensegrity_mj.commands import common, experiment
from tensegrity_mj.engines.table import ENGINES
from tensegrity_mj.errors import OptionError

if TYPE_CHECKING:
    Run = runs.Trajectory | runs.Table

OF_SIMULATIONS = (
    *("engine", "reference", "duration", "output-interval", *experiment.ENGINE_OPTIONS),
    *("law", *experiment.LAW_OPTIONS, *experiment.ACTUATION_OPTIONS),
)


@functools.cache
def words_of_differences() -> dict[str, tuple[str, str]]:
    """Return the texts of a comparison's numbers, with units."""
    from tensegrity_mj.runs.comparison import DIFFERENCES

    found = {f"max_{name}": (f"largest {words}", unit) for name, (words, _, unit) in DIFFERENCES.items()}
    return {**found, "rms_node_error": ("RMS node error", "m")}


def tolerance(text: str) -> tuple[str, float]:
    """argparse type: a number, or UNIT=NUMBER; the unit, or "" for all, and the number."""
    from tensegrity_mj.runs.comparison import UNITS

    unit, equals, number_ = text.rpartition("=")
    if equals and unit not in UNITS:
        raise argparse.ArgumentTypeError(f"{text!r}: write UNIT=NUMBER, with a unit among {', '.join(UNITS)}")
    return unit, common.positive(number_)


def execute(options: argparse.Namespace) -> common.Outcome:
    """Simulate twice, or read two files, and compare; or score tables."""
    if options.score:
        return _scored(options)
    plot = options.plot
    if all(name.lower().endswith((".nc", ".csv")) for name in options.inputs):
        first, second = _read(options)
        if not (isinstance(first, runs.Trajectory) and isinstance(second, runs.Trajectory)):
            return _with_table(first, second, options, plot)
        files: dict[str, Path] = {}
        code = common.ExitCode.SUCCESS
    elif len(options.inputs) == 1:
        names = _engines(options)
        files = _outputs(options.out, names)
        first, second = _simulate(options, names)
        code = max(common.code_of_status(first.status), common.code_of_status(second.status))
    else:
        raise OptionError(f"compare {' '.join(options.inputs)}: give one scene, or two .nc or .csv files")

    from tensegrity_mj.pictures.page import judgement_of_runs

    for run in (first, second):
        if "accuracy" in run.reports and not run.reports["accuracy"]["met"]:
            common.warn(f"{run.engine}: {run.reports['accuracy'].get('reason', 'its accuracy was not met')}")
    for path, run in zip(files.values(), (first, second), strict=False):
        run.save(path)
    if code and min(len(first.time), len(second.time)) < 2:
        # Stopped where it began: there is nothing to compare.
        numbers: dict[str, Any] = {**dict.fromkeys(words_of_differences()), "first_exceeded": {}, "tolerances": {}}
        judgement = judgement_of_runs([first, second])
        plot = None
    else:
        comparison = _compared(first, second, options)
        numbers = comparison.to_dict()
        numbers["tolerances"] = {name: comparison.tolerance_of(name) for name in comparison.NAMES}
        judgement = judgement_of_runs([first, second], comparison)
        if plot:
            with common.for_paper(options.paper):
                pictures.plots.plot_comparison(comparison, plot, runs=[first, second])
    common.warn_of_findings(judgement, simulated=len(options.inputs) == 1)
    # Comparing two files succeeds even if their runs ended early: first_status and second_status say how they ended.
    worst = max((first, second), key=lambda run: common.code_of_status(run.status))
    data = {
        "status": worst.status if code else runs.Status.COMPLETED,
        "message": worst.message,
        "scene": first.scene.name,
        "first": first.engine,
        "second": second.engine,
        "first_status": first.status,
        "second_status": second.status,
        **numbers,
        "first_error_estimate": first.error_estimate,
        "second_error_estimate": second.error_estimate,
        "first_wall_time": first.cost.get("wall_time"),
        "second_wall_time": second.cost.get("wall_time"),
        "out": files,
        "plot": plot,
    }
    return common.Outcome(data, describe(data), code, judgement=judgement, warned=True)


def describe(data: dict[str, Any]) -> str:
    rows = [
        ("status", data["status"].value + (f": {data['message']}" if data["message"] else "")),
        ("first", data["first"]),
        ("second", data["second"]),
    ]
    rows += [_difference(data, name) for name in words_of_differences() if data[name] is not None]
    rows += [
        (f"node error of the {name}, estimated", common.number(error, "m"))
        for name in ("first", "second")
        if not math.isnan(error := data[f"{name}_error_estimate"])
    ]
    rows += [("written", str(path)) for path in [*data["out"].values(), data["plot"]] if path]
    return common.table(rows)


def _difference(data: dict[str, Any], name: str) -> tuple[str, str]:
    """Text of one of these numbers."""
    label, unit = words_of_differences()[name]
    return label, quantity(data[name], unit, 4)


def _compared(first: Run, second: Run, options: argparse.Namespace) -> runs.Comparison:
    given = dict(options.tolerance or ())
    general = {"tolerance": given.pop("")} if "" in given else {}
    return runs.compare(first, second, **general, tolerances=given)


def _with_table(first: Run, second: Run, options: argparse.Namespace, plot: Path | None) -> common.Outcome:
    """Compare a run with a table of another program."""
    from tensegrity_mj.pictures.findings import Judgement
    from tensegrity_mj.pictures.page import within

    found = _compared(first, second, options)
    if plot:
        with common.for_paper(options.paper):
            pictures.plots.plot_comparison(found, plot)
    if found.missing_nodes:
        common.warn(f"nodes of the run that the table does not have: {', '.join(found.missing_nodes)}")
    for node in found.unknown_nodes:
        common.warn(
            f"the table's '{node}' is no node of the run{closest(node, [*found.by_node, *found.missing_nodes])}"
        )
    if found.times_outside:
        common.warn(f"{found.times_outside} times of the table are not within the run")
    numbers = found.to_dict() | {"tolerances": {name: found.tolerance_of(name) for name in found.compared}}
    data = {"status": "ok", "message": "", "first": found.first, "second": found.second, **numbers, "plot": plot}
    rows = [("first", found.first), ("second", found.second)]
    rows.append(("times", f"{len(found.time)}, from {found.time[0]:.6g} to {found.time[-1]:.6g} s, those of the table"))
    for name in ("rms_node_error", *(f"max_{one}" for one in found.compared)):
        error = found.resampling_error[name.removeprefix("max_").removeprefix("rms_")]
        rows.append(_difference(numbers, name))
        rows.append(("  of it by interpolation, estimated", quantity(error, words_of_differences()[name][1], 4)))
    rows += [(f"largest at {node}", quantity(error, "m", 4)) for node, error in found.by_node.items()]
    rows += [("written", str(plot))] if plot else []
    return common.Outcome(data, common.table(rows), judgement=Judgement("", within(found)), warned=True)


def _scored(options: argparse.Namespace) -> common.Outcome:
    """Score tables against the reference of a scene, the largest step first."""
    common.refuse(options, (*OF_SIMULATIONS, "tolerance", "out", "plot", "paper"), "means nothing with --score")
    scene, *paths = options.inputs
    given = options.steps or [None] * len(paths)
    if not paths or len(given) != len(paths):
        raise OptionError(
            f"compare {' '.join(options.inputs)}: --score takes a scene, tables, and as many --steps or none"
        )
    if len(set(given)) < len(options.steps or ()):
        raise OptionError(f"--steps {' '.join(f'{step:g}' for step in given)}: each table has a step of its own")
    reference = runs.reference_of(scene)
    found = [runs.score(reference, runs.read_table(path), step) for path, step in zip(paths, given, strict=True)]
    found.sort(key=lambda one: -(one.step or 0.0))
    rows = [("error bar", quantity(found[0].error_bar, "m")), ("motion", quantity(found[0].motion, "m"))]
    tables = []
    for one, order in zip(found, [None, *runs.observed_orders(found)], strict=True):
        known = {key: value for key, value in vars(one).items() if key != "gaps"}
        tables.append({**known, "judged": one.judged, "verdict": one.verdict, "order": order})
        step = "" if one.step is None else f", step {quantity(one.step, 's')}"
        fall = "" if order is None else f", order {order:.2f}"
        rows.append((one.table, f"{quantity(one.error, 'm')} at {one.node}, {quantity(one.time, 's')}{step}{fall}"))
    limit = runs.limit(found)
    judged = [one.judged for one in found if limit is None or one.step is None] + ([limit.judged] if limit else [])
    sentences = [one.verdict for one in found] + ([limit.verdict] if limit else [])
    data = {"status": "ok", "scene": scene, "reference": reference.header, "tables": tables, "limit": None}
    if limit:
        data["limit"] = {"order": limit.order, "error": limit.error, "judged": limit.judged, "verdict": limit.verdict}
    bad = {"wrong", "undecided"} & set(judged)
    text = "\n\n".join(["\n".join(sentences), common.table(rows)])
    return common.Outcome(data, text, common.ExitCode.WRONG if bad else common.ExitCode.SUCCESS)


def _engines(options: argparse.Namespace) -> tuple[str, str]:
    first = options.engine or "mujoco"
    second = options.reference or ("ode" if first == "dae" else "dae")
    if first == second:
        raise OptionError(f"--engine {first} --reference {second}: name two different engines")
    experiment.refuse_options_of_other_engines(options, (first, second))
    return first, second


def _simulate(options: argparse.Namespace, names: tuple[str, str]) -> tuple[runs.Trajectory, runs.Trajectory]:
    from tensegrity_mj.engines.requirements import engines_for, only_one

    experiment.check_control(options)
    scene = library.load_scene(options.inputs[0])
    if len(engines_for(scene)) == 1:
        raise OptionError(
            f"{only_one(scene)}: there is no second engine to compare with. "
            "Compare two of its runs, at two steps for instance: run --out a.nc, run --out b.nc, compare a.nc b.nc"
        )
    # The step is that of the engine that has fixed steps by default; others take it where their method is such a one.
    alone = all(ENGINES[name].fixed_step for name in names)
    duration, fixed = options.duration or scene.duration, alone or options.method == "rk4"
    engines = [experiment.engine_of(name, options, duration, with_timestep=fixed) for name in names]
    law, actuation = experiment.law_of(options, scene), experiment.actuation_of(options)

    def run(engine: Any, duration: float | None, interval: float | None) -> runs.Trajectory:
        return experiment.simulated(options, scene, law, engine, actuation, duration, interval)

    first = run(engines[0], options.duration, options.output_interval)
    # Where a fixed step does not divide 0.01 s, its samples lie elsewhere: the reference is sampled there too.
    # (The last sample of a run that stopped lies anywhere.)
    regular = len(first.time) > (1 if first.status is runs.Status.COMPLETED else 2)
    spacing = float(first.time[1] - first.time[0]) if regular else options.output_interval
    return first, run(engines[1], first.provenance["duration"], spacing)


def _read(options: argparse.Namespace) -> tuple[Run, Run]:
    """Read the two files."""
    from tensegrity_mj.runs.stored import is_table

    if len(options.inputs) != 2:
        raise OptionError(f"compare {' '.join(options.inputs)}: give two files, not {len(options.inputs)}")
    if len({Path(path).resolve() for path in options.inputs}) == 1:
        raise OptionError(f"compare {' '.join(options.inputs)}: a run compared with itself shows nothing; give two")
    common.refuse(options, OF_SIMULATIONS, "belongs to a simulation; two files are only read")
    common.refuse(options, ("out",), "writes simulated runs; two files are only read")
    first, second = (runs.read_table(path) if is_table(path) else runs.Trajectory.load(path) for path in options.inputs)
    return first, second


def _outputs(out: str | None, engines: Sequence[str]) -> dict[str, Path]:
    """Files of the two runs by --out: in a folder that exists, or next to each other with a common prefix."""
    if out is None:
        return {}
    is_folder = out.endswith(("/", "\\")) or Path(out).is_dir()
    start = f"{out.rstrip('/')}/" if is_folder else f"{out.removesuffix('.nc')}-"
    return {name: checked(f"{start}{name}.nc", (".nc",), "--out") for name in engines}
