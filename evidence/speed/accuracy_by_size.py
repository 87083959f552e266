"""Accuracy against size: how far MuJoCo and the DAE, both by Runge-Kutta, are from the DAE with error control.

Hanging chains (3 to 49 rods that share nodes) whose top is shaken, and free towers of prisms (3 to 45 rods, 9 to 219
strings) that are pushed at one node; two seconds each, at steps of 1 ms and 0.5 ms.
`python -m evidence.speed.accuracy_by_size FIGURE.png` draws the figure of paper.md; some minutes.
"""

from __future__ import annotations

import sys
from typing import Any

import tensegrity_mj as tmj
from tensegrity_mj.pictures.figure import frame, new_figure, save_figure
from tensegrity_mj.pictures.palette import color_of

STEPS = (1e-3, 5e-4)  # s
DURATION = 2.0  # s
PUSH = (0.0, 0.0, 20.0)  # N
CHAINS = (3, 7, 13, 25, 49)  # rods
TOWERS = (1, 2, 4, 8, 15)  # prisms of three rods


def measured(scene: tmj.Scene) -> list[dict[str, Any]]:
    """Largest node errors [m] of both engines at both steps, and what the reference itself may be off."""
    tight, looser = (
        tmj.simulate(scene, None, tmj.DAE(rtol=rtol, atol=0.1 * rtol), duration=DURATION) for rtol in (1e-12, 1e-10)
    )
    known = tmj.compare(looser, tight).max_node_error
    rows = []
    for engine, made in (("MuJoCo", tmj.MuJoCo), ("DAE", lambda step: tmj.DAE(method=tmj.Method.RK4, timestep=step))):
        for step in STEPS:
            run = tmj.simulate(scene, None, made(step), duration=DURATION)
            error = tmj.compare(run, tight).max_node_error
            rods, strings = len(scene.structure.rods), len(scene.structure.strings)
            row = {"rods": rods, "strings": strings, "engine": engine, "step": step, "error": error, "known": known}
            rows.append(row)
            print(
                "{rods:4d} rods {strings:4d} strings  {engine:7s} {step:g} s  {error:.2e} m ({known:.1e})".format(**row)
            )
    return rows


def main(path: str) -> None:
    """Measure, print and draw."""
    towers = [tmj.load_scene(f"tower(stages={count})") for count in TOWERS]
    families = {
        "hanging chains": [tmj.load_scene(f"cable(elements={count})") for count in CHAINS],
        "free towers": [scene.with_(loads=(tmj.model.Load("b1_1", PUSH),)) for scene in towers],
    }
    figure = new_figure(9.0, 3.8)
    panels = figure.subplots(1, 2, sharey=True)
    for panel, (family, scenes) in zip(panels, families.items(), strict=True):
        rows = [row for scene in scenes for row in measured(scene)]
        for number, step in enumerate(STEPS):
            look: dict[str, Any] = {"color": color_of(number), "markersize": 9, "fillstyle": "none"}
            for engine, line in (("MuJoCo", "o-"), ("DAE", "x")):
                shown = [row for row in rows if row["engine"] == engine and row["step"] == step]
                sizes, errors = ([row[name] for row in shown] for name in ("rods", "error"))
                panel.loglog(sizes, errors, line, label=f"{engine}, {1e3 * step:g} ms", **look)
        panel.loglog(sizes, [row["known"] for row in shown], ":", color="0.5", label="reference, at most")
        panel.set_xticks(sizes, [str(size) for size in sizes])
        panel.minorticks_off()
        frame(panel, family, "rods", "largest node error [m]" if panel is panels[0] else "")
    save_figure(figure, path)


if __name__ == "__main__":
    main(sys.argv[1])
