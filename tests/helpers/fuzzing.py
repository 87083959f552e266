"""Cases for the fuzz test, each made from its number alone, and the process that tries them.

python tests/helpers/fuzzing.py NUMBER ...     tries some and prints what came of each
python tests/helpers/fuzzing.py --serve        numbers on stdin, a line of JSON each on stdout (for test_fuzz.py)

A case is a scene file, a trajectory file or a command line that was valid and then was broken, or perhaps was not.
It is right where it is refused by a `TensegrityError` (a command: exit code 2 to 6) whose message can be shown, or
where it is accepted and what comes of it is sound: numbers are finite, the file that is written is read back equal.
"""

from __future__ import annotations

import contextlib
import io
import json
import os
import random
import resource
import shutil
import signal
import sys
import tempfile
import traceback
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

from fuzz_cases import MODELS, base_run, break_file, command_line, kind_of, scene_bytes, text_bytes

CPU_SECONDS = 10  # of a case; counted in the processor's time, so that a busy machine ends none
MEMORY = 6 * 2**30  # bytes of data of the process: a case that fills memory fails here


class Failure(Exception):
    """What a case must not do."""


# Trying them ---------------------------------------------------------------------------------------------------------


def check_message(text: str) -> None:
    """Raise Failure unless a message can be shown to a person, and says something."""
    from tensegrity_mj.errors import MOST_LETTERS

    if not text or not text.isprintable() or len(text) > MOST_LETTERS or "Traceback" in text:
        raise Failure(f"a message that cannot be shown: {text!r:.300}")


def refused_or(work: Callable[[], Any]) -> Any:
    """What the work returns; None where it is refused."""
    from tensegrity_mj.errors import TensegrityError

    try:
        return work()
    except TensegrityError as error:
        check_message(str(error))
        return None


def check_scene(scene: Any) -> None:
    """Raise Failure unless a scene that was accepted is sound."""
    import numpy as np

    from tensegrity_mj.model.text.reading import scene_from_toml
    from tensegrity_mj.model.text.writing import scene_to_toml

    structure = scene.structure
    arrays = (scene.nodes0, scene.velocities0, structure.positions, structure.rest_lengths, structure.rod_lengths)
    if not all(np.all(np.isfinite(array)) for array in arrays):
        raise Failure("an accepted scene has numbers that are not finite")
    if scene_from_toml(scene_to_toml(scene)) != scene:
        raise Failure("an accepted scene is not read back equal")


def check_run(rng: random.Random, scene: Any) -> None:
    """Raise Failure unless a short run ends, and completed ones have finite numbers."""
    import numpy as np

    import tensegrity_mj as tmj

    engine: Any = rng.choice([tmj.MuJoCo(), tmj.MuJoCo(1e-2), tmj.DAE(max_steps=300), tmj.ODE(max_steps=300)])
    law = None
    if rng.random() < 0.5 and scene.control is not None:
        law = refused_or(lambda: tmj.controllers.from_scene(scene))
    run = refused_or(lambda: tmj.simulate(scene, law, engine, duration=0.02))
    if run is not None and run.status is tmj.Status.COMPLETED and not np.all(np.isfinite(run.nodes)):
        raise Failure(f"a completed run of {run.engine} has nodes that are not finite")
    if run is not None:
        for text in run.reports.get("warnings", []):
            check_message(str(text)[:500])


def try_scene(rng: random.Random, folder: Path, content: bytes) -> str:
    from tensegrity_mj.library.named import load_scene

    path = folder / "hostile.toml"
    path.write_bytes(content)
    scene = refused_or(lambda: load_scene(path))
    if scene is None:
        return "refused"
    check_scene(scene)
    if rng.random() < 0.3 and len(scene.structure.rods) < 30:
        check_run(rng, scene)
    return "accepted"


def try_trajectory(rng: random.Random, folder: Path) -> str:
    import numpy as np

    from tensegrity_mj import Trajectory

    path = folder / "hostile.nc"
    shutil.copy(base_run(folder.parents[2]), path)
    if rng.random() < 0.2:
        content = bytearray(path.read_bytes())
        del content[rng.randrange(len(content)) :]
        path.write_bytes(content)
    else:
        break_file(rng, path)
    run = refused_or(lambda: Trajectory.load(path))
    if run is None:
        return "refused"
    check_scene(run.scene)
    if not np.all(np.isfinite(run.nodes)) and run.status.value == "completed":
        raise Failure("an accepted trajectory that completed has nodes that are not finite")
    uses = [
        ["compare", str(path), str(base_run(folder.parents[2])), *rng.choice([[], ["--plot", "plot.svg"]])],
        ["clearance", str(path)],
        ["run", "pinned_rod", "--replay", str(path), "--control-period", "0.01", "--duration", "0.02"],
        ["statics", "pinned_rod", "--run", str(path)],
    ]
    try_command([*rng.choice(uses), *rng.choice([[], ["--json"]])])
    return "accepted"


def try_command(arguments: list[str]) -> str:
    """A command line; its exit code must be one of those with a meaning."""
    from tensegrity_mj.cli import main

    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        try:
            code = main(arguments)
        except SystemExit as stop:  # of --help
            code = int(stop.code or 0)
    if code not in (0, 2, 3, 4, 5, 6):
        raise Failure(f"{arguments!r:.300}: exit code {code}; {err.getvalue()[-300:]!r}")
    for text in (out.getvalue(), err.getvalue()):
        bad = {letter for letter in text if not letter.isprintable()} - {"\n", "\r", "\t"}
        if bad or "Traceback" in text:
            raise Failure(f"{arguments!r:.300}: what it printed has {sorted(bad)!r}: {text[:300]!r}")
    if code and not err.getvalue() and not out.getvalue():
        raise Failure(f"{arguments!r:.300}: exit code {code} without a word")
    return "accepted" if code == 0 else "refused"


def attempt(number: int, root: Path) -> tuple[str, str]:
    """What came of a case: "accepted", "refused" or "failed", and why it failed."""
    rng = random.Random(f"fuzz {number}")
    kind = kind_of(number)
    folder = root / "cases" / "case" / "work"
    shutil.rmtree(root / "cases", ignore_errors=True)
    folder.mkdir(parents=True)
    there, wanted = os.getcwd(), {folder.parent, base_run(root)}
    os.chdir(folder)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            if kind == "scene":
                outcome = try_scene(rng, folder, scene_bytes(rng))
            elif kind == "text":
                outcome = try_scene(rng, folder, text_bytes(rng))
            elif kind == "trajectory":
                outcome = try_trajectory(rng, folder)
            else:
                outcome = try_command(command_line(rng, folder))
        found = {*(root / "cases").iterdir(), *root.iterdir()} - {root / "cases"}
        stray = [*(found - wanted), *(one for one in folder.parent.iterdir() if one != folder)]
        if stray:
            raise Failure(f"it wrote {stray[0]} outside its folder")
        if left := list(folder.rglob(".new-*")):
            raise Failure(f"it left {left[0].name}")
    except BaseException as error:
        if isinstance(error, KeyboardInterrupt):
            raise
        reported = str(error) if isinstance(error, Failure) else "".join(traceback.format_exception(error))[-3000:]
        return "failed", reported
    finally:
        os.chdir(there)
    return outcome, ""


def warm() -> None:
    """Compile and import what is so once, which is no case's time."""
    import tensegrity_mj as tmj

    wet = tmj.load_scene("prism").with_(gravity=(0.0, 0.0, -9.81), water=tmj.Water())
    scenes = [*map(tmj.load_scene, MODELS), tmj.load_scene("net"), wet]
    for scene in scenes:
        law = tmj.controllers.from_scene(scene) if scene.control is not None else None
        for engine in (tmj.MuJoCo(), tmj.DAE(), tmj.ODE(), tmj.DAE(method=tmj.Method.RK4, timestep=1e-3)):
            for own in (None, law):
                with warnings.catch_warnings(), contextlib.suppress(tmj.TensegrityError):
                    warnings.simplefilter("ignore")
                    tmj.simulate(scene, own, engine, duration=0.002)


def serve(numbers: Any, answer: Callable[[str], object]) -> None:
    """Try cases by their numbers, and answer each with a line of JSON. One that takes too long ends the process."""
    resource.setrlimit(resource.RLIMIT_DATA, (MEMORY, MEMORY))
    with tempfile.TemporaryDirectory() as place:
        warm()
        attempt(0, Path(place))
        for line in numbers:
            number = int(line)
            signal.setitimer(signal.ITIMER_PROF, CPU_SECONDS)  # SIGPROF ends the process, in compiled code too
            outcome, why = attempt(number, Path(place))
            signal.setitimer(signal.ITIMER_PROF, 0)
            answer(json.dumps({"number": number, "kind": kind_of(number), "outcome": outcome, "why": why}))


if __name__ == "__main__":
    sys.setrecursionlimit(1000)
    if sys.argv[1:] == ["--serve"]:
        # Answers have a pipe of their own: what commands print goes to their test.
        pipe = os.fdopen(os.dup(1), "w", buffering=1)
        null = os.open(os.devnull, os.O_WRONLY)
        os.dup2(null, 1)
        os.dup2(null, 2)
        serve(sys.stdin, lambda text: print(text, file=pipe))
    else:
        with tempfile.TemporaryDirectory() as place:
            for text in sys.argv[1:]:
                print(text, kind_of(int(text)), *attempt(int(text), Path(place)))
