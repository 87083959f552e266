"""Find the equilibrium of a scene: its prestress, stiffness, modes and members, loads up to buckling, least mass."""

from __future__ import annotations

import argparse
from functools import partial
from pathlib import Path

import tensegrity_mj.library as library
from tensegrity_mj import model, pictures, runs, statics
from tensegrity_mj.basics.files import checked
from tensegrity_mj.commands import experiment
from tensegrity_mj.commands.common import ExitCode, Outcome, distinct, finite, positive, table, whole
from tensegrity_mj.engines.table import engine_class
from tensegrity_mj.errors import OptionError

MATERIALS = ("aluminium", "steel", "uhmwpe")  # names of statics.materials, in small letters
count = partial(whole, most=10_000)
Vector = tuple[float, float, float]
AXES = {"x": (1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0), "z": (0.0, 0.0, 1.0)}
SECONDS = 2.0  # of a mode's video a period


def execute(options: argparse.Namespace) -> Outcome:
    """Find it, and write what the options name."""
    folder, saved, sized = options.out, options.save_scene, options.save_sized
    mode, video = _video(options)
    distinct({"--save-scene": saved, "--save-sized": sized})
    if video is not None:
        experiment.require_off_screen_opengl()

    scene = library.load_scene(options.scene)
    if options.no_gravity:
        scene = scene.with_(gravity=(0.0, 0.0, 0.0))
    factor = 1.0 if options.load_factor is None else options.load_factor
    loads: dict[str, tuple[float, ...]] = {}
    for node, force in options.load or ():
        before = loads.get(node, (0.0, 0.0, 0.0))
        loads[node] = tuple(old + factor * new for old, new in zip(before, force, strict=True))
    study = statics.analyse(
        scene,
        rods=statics.Rods(options.rods),
        search=statics.Search(options.method),
        loads=loads or None,
        holds=[statics.Hold(*one) for one in options.hold or ()],
        broken=options.broken or (),
        rest_lengths=dict(options.rest_length) if options.rest_length else None,
        path=options.path,
        points=options.points or 100,
        modes=options.modes,
        engine=engine_class(options.check_engine)() if options.check_engine else None,
        materials=_sizes(options),
        run=None if options.run is None else runs.Trajectory.load(options.run),
        progress=True,
    )
    modes = 0 if study.modes is None else len(study.modes.squares)
    if video is not None and study.modes is not None and not mode <= modes:
        raise OptionError(f"--mode-video {mode}: there are {modes} modes here; a larger --modes finds more")
    if folder is not None:
        study.save(folder)
    if saved is not None and study.state is not None:
        model.save_scene(study.scene(), saved)
    if sized is not None and study.sizing is not None:
        sized_scene = scene.with_(structure=study.sizing.structure, initial_nodes=None, initial_velocities=None)
        model.save_scene(sized_scene, sized)
    if video is not None and study.modes is not None:
        motion = statics.mode_trajectory(study.modes, mode - 1)
        speed = float(motion.time[-1]) / 2 / SECONDS
        pictures.render(motion, video, speed=speed, traces=False, target=False, progress=True)
    written = [path for path in (folder, saved, sized, video) if path is not None and path.exists()]
    lines = table([("written", str(path)) for path in written])
    files = {"out": folder, "saved_scene": saved, "saved_sized": sized, "mode_video": video}
    data = {"status": study.status, **study.to_dict(), **files}
    code = ExitCode.SUCCESS if study.state is not None else ExitCode.INFEASIBLE
    return Outcome(data, lines, code, judgement=study.judgement)


def _video(options: argparse.Namespace) -> tuple[int, Path | None]:
    """The number of a mode, from 1, and its file."""
    if options.mode_video is None:
        return 0, None
    number, name = options.mode_video
    if not number.isascii() or not number.isdigit() or not 1 <= int(number) <= options.modes:
        raise OptionError(
            f"--mode-video {number}: it takes a mode's number, from 1 to the {options.modes} of --modes, and a file"
        )
    return int(number), checked(name, (".mp4",), "--mode-video")


def _sizes(options: argparse.Namespace) -> statics.Materials | None:
    if options.size is None:
        return None
    rods, strings = (getattr(statics, name.upper()) for name in options.size)
    return statics.Materials(rods, strings, options.least_radius or 0.0)


# ------------------------------------------------------------------------------------------------- argparse types


def _three(text: str, example: str) -> Vector:
    parts = text.split(",")
    if len(parts) != 3:
        raise argparse.ArgumentTypeError(f"{text!r}: write three numbers, for example {example}")
    x, y, z = (finite(part) for part in parts)
    return x, y, z


def vector(text: str) -> tuple[str, Vector]:
    """argparse type: a node and a force on it."""
    name, equals, value = text.partition("=")
    if not equals or not name:
        raise argparse.ArgumentTypeError(f"{text!r}: write NODE=X,Y,Z, for example t4=0,0,-20")
    return name, _three(value, "t4=0,0,-20")


def length(text: str) -> tuple[str, float]:
    """argparse type: a string and its rest length."""
    name, equals, value = text.partition("=")
    if not equals or not name:
        raise argparse.ArgumentTypeError(f"{text!r}: write STRING=M, for example s1=0.4")
    return name, positive(value)


def hold(text: str) -> tuple[tuple[str, ...], tuple[Vector, ...] | None, Vector]:
    """argparse type: nodes, the directions in which they are held (None: all), and how far they are moved."""
    where, equals, value = text.partition("=")
    names, _, letters = where.partition(":")
    nodes = tuple(names.split(","))
    good = not letters if ":" not in where else 0 < len(letters) == len(set(letters) & set("xyz"))
    if not all(nodes) or not good:
        raise argparse.ArgumentTypeError(
            f"{text!r}: write NODES[:DIRECTIONS][=X,Y,Z], for example t1,t2:xy or t1,t2:z=0,0,-0.1"
        )
    directions = tuple(AXES[letter] for letter in letters)
    return nodes, directions or None, _three(value, "t1:z=0,0,-0.1") if equals else (0.0, 0.0, 0.0)


def materials(text: str) -> tuple[str, str]:
    """argparse type: names of the materials of rods and of strings."""
    names = text.lower().split(",")
    if len(names) > 2 or not set(names) <= set(MATERIALS):
        raise argparse.ArgumentTypeError(f"{text!r}: write RODS or RODS,STRINGS, each of {', '.join(MATERIALS)}")
    return names[0], names[-1]
