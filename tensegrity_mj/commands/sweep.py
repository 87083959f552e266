"""Simulate a scene many times: over values of any parameter, or random draws. Goes on where it was stopped."""

from __future__ import annotations

import argparse
import json
import math
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tensegrity_mj.commands.common import Outcome, add_scene, add_workers, table
from tensegrity_mj.errors import OptionError

if TYPE_CHECKING:
    from tensegrity_mj.studies.axes import Draw, Vary
    from tensegrity_mj.studies.table import Row
    from tensegrity_mj.studies.workers import Workers

HELP = "simulate over values of any parameter, or random draws"
EXAMPLES = """\
examples:
  tensegrity-mj sweep prism --vary law.decay_rate=0.5,1,2 --vary engine.timestep=log:1e-3:1e-2:3 --out study/
  tensegrity-mj sweep pinned_rod --vary engine=mujoco,dae --set scene.duration=5
  tensegrity-mj sweep prism --draw plant.rods[*].mass=*uniform:0.8:1.2 --samples 20 --seed 1 --out study/
  tensegrity-mj sweep prism --set actuation=hold-rest-length --vary actuation.period=0.001,0.01 --out study/
  tensegrity-mj sweep "tower_in_waves(stages=8)" --vary family.stiffness=1e4,2e4 --measures late_deformation
  tensegrity-mj sweep prism --zip structure.rods.mass=1,2 structure.strings.stiffness=*1,*2 --measures min_margin

parameters, by their paths:
  family.stages family.stiffness   arguments of the family's call that the scene is given by
  scene.gravity scene.gravity.z scene.duration scene.initial_nodes[NODE] scene.initial_velocities[NODE].x
  scene.target[NODE].x scene.loads.force.z scene.breaks[STRING].time scene.contact.friction
  structure.rods.mass structure.rods[rod1].mass structure.strings[s1,s2].stiffness structure.nodes[NODE].z
  plant. ...                   as structure and scene, for what is simulated only: the law knows the nominal one
  law law.decay_rate law.norm  a law by name, or none; the law's options
  engine engine.timestep       mujoco, dae or ode; the engine's options: integrator, method, rtol, atol, ...
  actuation actuation.period   continuous, hold-force-density, hold-rest-length; time between samples [s]
  on_infeasible output_interval

values: numbers, words, or JSON ([0,0,-9.81]); *0.8 is 0.8 times the scene's value. In place of a list,
  linear:FROM:TO:COUNT and log:FROM:TO:COUNT, with * before them for factors.
draws: uniform:LOW:HIGH, loguniform:LOW:HIGH, normal:MEAN:DEVIATION, choice:A,B,C, with * before them for factors;
  [*] draws for each member by itself.

With --out the study is kept in a folder: every point that is finished is saved at once, and the same command goes on
with what is missing, whatever stopped it. Points that fail are part of the result: the exit code is 0 when all
points have been tried. docs/studies.md says more.
"""

MOST_LINES = 40
BACKENDS = ("processes", "this-process")


def configure(parser: argparse.ArgumentParser) -> None:
    """The options of `sweep`."""
    add_scene(parser)
    what = parser.add_argument_group("what varies")
    repeated: dict[str, Any] = {"action": "append", "default": []}
    what.add_argument("--vary", metavar="PATH=VALUES", help="a parameter and its values, with all others'", **repeated)
    what.add_argument(
        "--zip", metavar="PATH=VALUES", nargs="+", help="parameters that go through their values together", **repeated
    )
    what.add_argument("--draw", metavar="PATH=DISTRIBUTION", help="a parameter that is drawn at random", **repeated)
    what.add_argument("--set", metavar="PATH=VALUE", help="a parameter with one value", **repeated)
    what.add_argument("--samples", type=int, metavar="N", help="draws at every combination of values (1)")
    what.add_argument("--seed", type=int, metavar="N", help="of the draws; the same seed draws the same")
    who = parser.add_argument_group("who computes")
    add_workers(who, "points")
    who.add_argument("--backend", choices=BACKENDS, help="worker processes, or this process, to debug (processes)")
    who.add_argument("--cluster", metavar="ADDRESS", help="of the scheduler of a Dask cluster, such as tcp://host:8786")
    output = parser.add_argument_group("output")
    output.add_argument("--out", metavar="FOLDER", help="keep the study there, or go on with it")
    output.add_argument("--measures", metavar="NAMES", help="what to list and to plot, with commas between")
    output.add_argument("--keep-trajectories", action="store_true", help="keep each run as a .nc file in FOLDER/files")


def execute(options: argparse.Namespace) -> Outcome:
    """Run the sweep, or go on with it, and report what came out."""
    vary, zipped = (
        [_vary(text, "--vary") for text in options.vary],
        [[_vary(text, "--zip") for text in group] for group in options.zip],
    )
    draws, fixed = [_draw(text) for text in options.draw], dict(_set(text) for text in options.set)
    if len(fixed) < len(options.set):
        raise OptionError("--set: a parameter is given twice; give each parameter once")
    workers = _workers(options)
    if options.keep_trajectories and options.out is None:
        raise OptionError("--keep-trajectories needs --out FOLDER to keep them in")

    from tensegrity_mj.studies.axes import Together
    from tensegrity_mj.studies.measures import USUAL
    from tensegrity_mj.studies.sweep import Sweep
    from tensegrity_mj.studies.table import check_measures, rows_of

    measures = check_measures(options.measures.split(",") if options.measures is not None else USUAL)
    sweep = Sweep(
        options.scene,
        axes=[*vary, *(Together(group) for group in zipped)],
        draws=draws,
        samples=1 if options.samples is None else options.samples,
        seed=options.seed,
        fixed=fixed,
        keep_trajectories=options.keep_trajectories,
    )
    try:
        study = sweep.run(options.out, workers=workers, progress=True)
    except KeyboardInterrupt as interrupt:
        print(f"tensegrity-mj: {interrupt}", file=sys.stderr)
        raise
    page = None
    if options.out is not None:
        from tensegrity_mj.studies.page import write_sweep_page

        page = write_sweep_page(Path(options.out) / "index.html", sweep, study, measures)
    rows = rows_of(study)
    from tensegrity_mj.studies.table import counts

    data = {
        "status": "completed",
        "scene": sweep.scene.name,  # type: ignore[union-attr]
        "points": len(rows),
        "computed": study.computed,
        "ended": counts(rows),
        "folder": options.out,
        "result": None if options.out is None else Path(options.out) / "result.json",
        "page": page,
        "outcomes": study.to_dict()["points"],
    }
    return Outcome(data, describe(data, rows, sweep.parameters, measures))


def describe(data: dict[str, Any], rows: Sequence[Row], parameters: Sequence[str], measures: Sequence[str]) -> str:
    """The sweep for people."""
    from tensegrity_mj.studies.table import parameter_label, shown

    heads = ["", *map(parameter_label, parameters), "status", *(name.replace("_", " ") for name in measures)]
    lines = [heads]
    for number, row in enumerate(rows[:MOST_LINES]):
        cells = [shown(row.values.get(name)) if row.values else "-" for name in measures]
        lines.append([str(number), *(shown(row.parameters[name]) for name in parameters), row.status, *cells])
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
    text = ["  ".join(f"{cell:<{width}}" for cell, width in zip(line, widths, strict=True)).rstrip() for line in lines]
    if len(rows) > MOST_LINES:
        text.append(f"... and {len(rows) - MOST_LINES} more points")
    reasons = dict.fromkeys(row.reason for row in rows if row.reason)
    text += [f"why not completed: {reason}" for reason in list(reasons)[:5]]
    facts = [("points", ", ".join(f"{count} {status}" for status, count in data["ended"].items()))]
    facts.append(("computed now", str(data["computed"])))
    facts += [(name, str(data[name])) for name in ("result", "page") if data[name]]
    return "\n".join([*text, "", table(facts)])


def _workers(options: argparse.Namespace) -> Workers:
    from tensegrity_mj.studies.workers import Backend, Workers

    if options.cluster is not None:
        if options.backend is not None:
            raise OptionError("--backend and --cluster: give one of them")
        return Workers(options.workers, Backend.CLUSTER, options.cluster)
    return Workers(options.workers, Backend((options.backend or "processes").replace("-", " ")))


# Values --------------------------------------------------------------------------------------------------------


def _assignment(text: str, option: str) -> tuple[str, str]:
    path, sign, value = text.partition("=")
    if not sign or not path.strip() or not value.strip():
        raise OptionError(f"{option} {text}: write PATH=VALUE, for example law.decay_rate=0.5")
    return path.strip(), value.strip()


def _set(text: str) -> tuple[str, Any]:
    path, value = _assignment(text, "--set")
    return path, value_of(value)


def _vary(text: str, option: str) -> Vary:
    from tensegrity_mj.studies.axes import Vary

    path, values = _assignment(text, option)
    return Vary(path, values_of(values, f"{option} {text}"))


def _draw(text: str) -> Draw:
    from tensegrity_mj.studies.axes import Choice, Draw, LogUniform, Normal, Uniform

    path, given = _assignment(text, "--draw")
    scaled = given.startswith("*")
    name, _, rest = given.removeprefix("*").partition(":")
    two: dict[str, Any] = {"uniform": Uniform, "loguniform": LogUniform, "normal": Normal}
    if name == "choice" and rest:
        return Draw(path, Choice([value_of(item) for item in split(rest)]), scaled)
    numbers = rest.split(":")
    if name not in two or len(numbers) != 2:
        raise OptionError(
            f"--draw {text}: allowed after = are uniform:LOW:HIGH, loguniform:LOW:HIGH, normal:MEAN:DEVIATION and "
            "choice:A,B,C, with * before them for factors"
        )
    first, second = (_float(number, f"--draw {text}") for number in numbers)
    return Draw(path, two[name](first, second), scaled)


def values_of(text: str, what: str) -> list[Any]:
    """The values of --vary: a list with commas, or a range.

    Raises:
        OptionError: for a range that is none.
    """
    scaled = text.startswith("*")
    kind, _, rest = text.removeprefix("*").partition(":")
    if kind not in ("linear", "log"):
        return [value_of(item) for item in split(text)]
    parts = rest.split(":")
    if len(parts) != 3 or not parts[2].isdigit() or int(parts[2]) < 2:
        raise OptionError(f"{what}: write {kind}:FROM:TO:COUNT with a count of at least 2")
    first, last, count = _float(parts[0], what), _float(parts[1], what), int(parts[2])
    if kind == "log" and not (first > 0 and last > 0):
        raise OptionError(f"{what}: both ends of a logarithmic range must be > 0")
    steps = [number / (count - 1) for number in range(count)]
    if kind == "linear":
        found = [first + (last - first) * step for step in steps]
    else:
        found = [first * (last / first) ** step for step in steps]
    found[-1] = last
    return [value_of(f"*{value!r}") for value in found] if scaled else found


def value_of(text: str) -> Any:
    """One value: *factor, a number, JSON, or a word."""
    from tensegrity_mj.studies.parameter_values import decoded

    text = text.strip()
    if text.startswith("*"):
        return decoded(text)
    try:
        value = json.loads(text, parse_constant=str)
    except ValueError:
        value = text
    if isinstance(value, str):
        try:
            number = float(text)
        except ValueError:
            return value
        return number if math.isfinite(number) else text
    return value


def split(text: str) -> list[str]:
    """The parts between commas that stand outside brackets and quotes."""
    parts, depth, quoted = [""], 0, False
    for letter in text:
        quoted ^= letter == '"'
        depth += (letter in "[{") - (letter in "]}") if not quoted else 0
        if letter == "," and depth == 0 and not quoted:
            parts.append("")
        else:
            parts[-1] += letter
    return parts


def _float(text: str, what: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise OptionError(f"{what}: {text!r} is no finite number")
    return value
