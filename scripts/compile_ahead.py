"""Compile what engines and laws call, so that nobody waits for it later. What is kept already takes no time.

    python scripts/compile_ahead.py  # for this processor; scripts/setup.sh runs it
    python scripts/compile_ahead.py --ship  # for a wheel: for any processor of this architecture, into the package

After the second, `python -m pip wheel --no-deps .` makes a wheel that holds the machine code: an installation of it
compiles nothing at its first run. The code is for this Python version; run it with each that the wheel is for. Without
it a wheel works too, and compiles what a run needs when it is first run.
"""

from __future__ import annotations

import argparse
import importlib
import os
import sys
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]


def modules() -> list[str]:
    """Those that define C functions."""
    names = []
    for folder in ("tensegrity_mj", "controllers"):
        for path in sorted((ROOT / folder).rglob("*.py")):
            if "@c_function(" in path.read_text(encoding="utf-8"):
                name = ".".join(path.relative_to(ROOT).with_suffix("").parts)
                names.append(name if folder == "tensegrity_mj" else f"tensegrity_mj.{name}")
    return names


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--ship", action="store_true", help="compile for any processor, into the package")
    parser.add_argument("--alone", action="store_true", help="in one process (default: two, with more CPU time)")
    options = parser.parse_args()
    ship = options.ship
    if ship:
        os.environ["NUMBA_CPU_NAME"], os.environ["NUMBA_CPU_FEATURES"] = "generic", ""
    from tensegrity_mj.dynamics.native import beside, compiling, kept, notices

    for name in modules():
        importlib.import_module(name)
    if ship and kept.SHIPPED.is_dir():
        for old in kept.SHIPPED.glob(f"*.{sys.implementation.cache_tag}.*.nbc"):
            old.unlink()
    todo = [one for one in compiling.c_functions if not one.is_kept]
    begun = time.monotonic()
    if todo:
        print(f"Compiling {len(todo)} functions", file=sys.stderr)
    # From both ends of the list: what stands side by side in it shares much that is compiled once a process.
    names = [] if options.alone else [f"{one.__module__}:{one.__qualname__}" for one in reversed(todo)]
    with beside.second_process(names, heard=True) as second:
        beside.compile_in_turn(todo)
        with notices.silent():
            if todo and not ship:
                _run_engines()
        if second is not None and second.wait():
            print(f"\nThe second process failed ({second.returncode}); this one compiles what is left", file=sys.stderr)
    with notices.silent():
        for function in compiling.c_functions if ship else todo:
            function.ship(kept.SHIPPED) if ship else function.address
    if todo:
        text = f"Compiled {len(todo)} functions in {time.monotonic() - begun:.0f} s"
        print(f"\r{text:<80}" if sys.stderr.isatty() else text, file=sys.stderr)


def _run_engines() -> None:
    """Short runs of what calls numba's functions from Python, so that they are kept, too."""
    import tensegrity_mj as tmj

    scene = tmj.load_scene("prism")
    law = tmj.controllers.from_scene(scene)
    for engine in (tmj.ODE(), tmj.DAE(method="rk4", timestep=1e-3), tmj.MuJoCo(1e-3, locate_slack=True)):
        tmj.simulate(scene, law, engine, duration=0.01)
    scene = tmj.load_scene("planar_beam")  # its law solves quadratic programs
    law = tmj.controllers.from_scene(scene)
    tmj.clearance(tmj.simulate(scene, law, tmj.DAE(method="rk4", timestep=1e-3), duration=0.01))


if __name__ == "__main__":
    main()
