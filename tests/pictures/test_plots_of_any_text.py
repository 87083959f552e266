"""Names from files stay text in every figure: no $ of theirs begins a formula, no backslash a command of TeX."""

from __future__ import annotations

import io
import re
from dataclasses import replace

import numpy as np
import pytest
from analytic_runs import cone_run, two_masses
from matplotlib.figure import Figure
from matplotlib.text import Text

import tensegrity_mj as tmj
from tensegrity_mj import statics
from tensegrity_mj.basics.texts import figure_text
from tensegrity_mj.model.events import Load
from tensegrity_mj.model.scene import Scene
from tensegrity_mj.pictures import plots
from tensegrity_mj.runs.comparison import compare
from tensegrity_mj.runs.trajectory import Trajectory
from tensegrity_mj.statics import page as static_page
from tensegrity_mj.studies.page import figures as sweep_figures
from tensegrity_mj.studies.sweep import Row

# An unclosed fraction, which TeX cannot read; two dollars, which would make a formula; a label that would be hidden.
NAMES = ["Q$\\frac{$Q", "Q$x^2$Q", "_Q\\alpha $Q", "Q\\$Q", "Q%&~^{}#Q\\"]


def named(scene: Scene, evil: str) -> Scene:
    """The scene with a name before every name in it."""

    def name(given: str) -> str:
        return f"{evil}{given}"

    old = scene.structure
    structure = replace(
        old,
        name=name(old.name),
        nodes={name(key): place for key, place in old.nodes.items()},
        rods=tuple(replace(r, name=name(r.name), nodes=(name(r.nodes[0]), name(r.nodes[1]))) for r in old.rods),
        strings=tuple(replace(s, name=name(s.name), nodes=(name(s.nodes[0]), name(s.nodes[1]))) for s in old.strings),
        fixed_nodes=tuple(map(name, old.fixed_nodes)),
        point_masses=tuple(replace(p, node=name(p.node)) for p in old.point_masses),
    )
    loads = tuple(replace(load, node=name(load.node)) for load in scene.loads if isinstance(load, Load))
    return replace(scene, name=name(scene.name), structure=structure, loads=loads)


def evil_run(evil: str, run: Trajectory) -> Trajectory:
    law = {"law": evil, "onto": evil, "decay_rate": evil}
    size = len(run.time)
    terms = {key: np.linspace(1.0, 0.5, size) for key in ("lyapunov", "lyapunov_error", "lyapunov_velocity")}
    return replace(run, scene=named(run.scene, evil), engine=evil, provenance={"controller": law}, **terms)


def check(figure: Figure | None, expected: bool = True) -> None:
    """Every text with a name of a file has its dollars escaped, and the figure can be drawn."""
    assert figure is not None
    figure.set_layout_engine("none")  # which would draw all texts twice more, to see how large they are
    figure.savefig(io.BytesIO(), format="svg")
    texts = [text.get_text() for text in figure.findobj(Text) if "Q" in text.get_text()]
    assert bool(texts) == expected
    for text in texts:
        for part in re.findall(r"Q[^Q]*Q", text):
            assert not re.search(r"(?<!\\)\$", part), text


@pytest.mark.parametrize("evil", [NAMES[0], NAMES[2]])
def test_runs_and_comparisons(evil: str) -> None:
    run, other = evil_run(evil, cone_run()), evil_run(evil, cone_run(engine="two"))
    check(plots.plot_run([run, other]))
    check(plots.plot_errors(run))
    check(plots.plot_paths([run, other]))
    check(plots.plot_comparison(compare(run, other), runs=[run, other]))
    check(plots.plot_lyapunov(run))


def test_a_rod_among_several_and_point_masses() -> None:
    evil = NAMES[0]
    run = tmj.simulate(named(two_masses(), evil), None, tmj.DAE(), duration=0.02)
    check(plots.plot_errors(run))
    both = named(tmj.load_scene("cross"), evil).with_(target=None, control=None)
    run = tmj.simulate(both, None, tmj.DAE(), duration=0.02)
    check(plots.plot_coordinates(run, rod=run.scene.structure.rods[0].name))
    check(plots.plot_clearance(tmj.clearance(run, over_time=True)))


@pytest.mark.parametrize("evil", NAMES[:2])
def test_statics(evil: str) -> None:
    scene = named(tmj.load_scene("truss_arm(cells=2)"), evil)
    study = statics.analyse(scene, loads={f"{evil}t2": (0.0, 0.0, -20.0)}, path=True, points=5, modes=2)
    check(static_page.members_figure(study.state))
    check(static_page.response_figure(study.response))
    check(static_page.modes_figure(study.modes), expected=False)


@pytest.mark.parametrize("evil", [NAMES[0], NAMES[2]])
def test_sweeps(evil: str) -> None:
    names = [f"strings.{evil}.stiffness", "control"]
    rows = [
        Row({names[0]: value, names[1]: f"{evil}{word}"}, "completed", "", {"final_error": value})
        for value in (1.0, 2.0, 3.0)
        for word in ("a", "b")
    ]
    for picture in sweep_figures(rows, names, [], ["final_error"]):
        check(picture.figure)


def test_text_is_drawn_letter_for_letter() -> None:
    """What matplotlib makes of the text, taken from the figure in its other form, is the name itself."""
    for evil in NAMES:
        figure = Figure()
        text = figure.text(0.5, 0.5, figure_text(evil))
        shown, is_math = text._preprocess_math(text.get_text())  # type: ignore[attr-defined]
        if not is_math:
            assert shown == evil
        else:  # the underscore that would hide a label is the one formula of ours
            assert evil.startswith("_")
            assert shown == "$\\_$" + figure_text(evil[1:])
