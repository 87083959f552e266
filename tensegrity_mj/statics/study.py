"""Analysis of a scene by statics, in one call: `analyse`."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path as FilePath
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.basics.checks import check_known, instance, member, real_array, whole
from tensegrity_mj.basics.files import made_folder, write_text
from tensegrity_mj.basics.jsontext import to_json
from tensegrity_mj.errors import InfeasibleError, OptionError
from tensegrity_mj.model.elements.element import Work, forces_of
from tensegrity_mj.model.scene import Scene
from tensegrity_mj.model.section import warnings_of
from tensegrity_mj.model.structure import Structure
from tensegrity_mj.pictures.findings import Judgement
from tensegrity_mj.runs.recorded import labels_of
from tensegrity_mj.runs.trajectory import Trajectory
from tensegrity_mj.statics import boundary, equilibrium, findings, lightest
from tensegrity_mj.statics.equilibrium import balance, find_equilibrium
from tensegrity_mj.statics.findings import Search as Search
from tensegrity_mj.statics.findings import StaticResult
from tensegrity_mj.statics.lightest import Material, Sizing
from tensegrity_mj.statics.listing import counted
from tensegrity_mj.statics.model import Rods, StaticModel, steady_forces
from tensegrity_mj.statics.modes import natural_modes
from tensegrity_mj.statics.path import Response, follow
from tensegrity_mj.statics.prestress import Prestressability, prestressability
from tensegrity_mj.statics.state import StaticState, require_rigid_and_free
from tensegrity_mj.statics.strength import TrajectoryCheck, check_state, check_trajectory

if TYPE_CHECKING:
    from tensegrity_mj.engines.request import AcceleratingEngine

DATA, PAGE = "statics.json", "statics.html"  # what a folder holds


@dataclass(frozen=True)
class Materials:
    """Materials of the lightest members, and their least radius [m]."""

    rods: Material
    strings: Material
    least_radius: float = 0.0


class StaticStudy(StaticResult):
    """Results of statics for a scene.

    Attributes:
        model: the problem, with further loads at their full size.
        search: how the equilibrium was found.
        start: what neither rods nor supports can balance at the scene's start, without further loads.
        state: the equilibrium under further loads and holds, on a path its last point; None where there is none.
        failure: why there is none.
        other: by dynamic relaxation, where both searches were wanted.
        modes, prestressability, members: about the state.
        response: along the path, where one was wanted.
        engine: the same by an engine, where one was given.
        sizing: the lightest members at the scene's start, where materials were given.
        run: members over a run, where one was given.
        notes: what of the scene statics leaves out, and other things to know.
    """

    @property
    def judgement(self) -> Judgement:
        """The verdict and the findings, a line each: the source of text, page and JSON."""
        return findings.judgement(self)

    def describe(self) -> list[tuple[str, str]]:
        """Return the findings as names and texts, a line each."""
        return [(one.name, one.text) for one in self.judgement.findings]

    def to_dict(self) -> dict[str, Any]:
        """Return plain values; docs/statics.md explains the keys."""
        return findings.to_dict(self)

    def save_page(self, path: str | os.PathLike[str]) -> FilePath:
        """Write the page (.html), which holds its pictures; returns its path."""
        from tensegrity_mj.statics.page import write_statics_page

        return write_statics_page(path, self)

    def save(self, folder: str | os.PathLike[str]) -> FilePath:
        """Write statics.json and statics.html into a folder, which is made; returns it.

        Raises:
            OptionError: where nothing can be written.
        """
        place = made_folder(folder)
        write_text(place / DATA, to_json({"status": self.status, **self.to_dict()}, indent=1) + "\n")
        self.save_page(place / PAGE)
        return place


def analyse(
    scene: Scene | Structure,
    *,
    rods: Rods = Rods.RIGID,
    search: Search = Search.NEWTON,
    loads: Mapping[str, Sequence[float]] | ArrayLike | None = None,
    holds: Sequence[boundary.Hold] = (),
    broken: Sequence[str] = (),
    rest_lengths: Mapping[str, float] | ArrayLike | None = None,
    path: bool = False,
    points: int = 100,
    modes: int = 12,
    engine: AcceleratingEngine | None = None,
    materials: Materials | None = None,
    run: Trajectory | None = None,
    progress: bool = False,
) -> StaticStudy:
    """Find the equilibrium of a scene and analyse it: stability, modes, members, prestress.

    Args:
        scene: a scene or a structure.
        rods: rigid, or elastic by their sections.
        search: how the equilibrium is found; a path is followed by Newton's method alone.
        loads: further ones [N]: (N, 3), or those of some nodes by name.
        holds: further boundary conditions, with what they are moved by.
        broken: names of strings that carry nothing.
        rest_lengths: (M,) [m], or those of some strings by name.
        path: follow the equilibria as loads and displacements grow from zero; else only the last one is looked for.
        points: about how many along a straight path.
        modes: how many natural modes.
        engine: find the same equilibrium and frequencies by this engine too.
        materials: size the members for least mass, at the scene's start and under its loads and the further ones.
        run: a run of this scene, whose members are checked too.
        progress: show bars on stderr.

    Returns:
        The study. Where there is no equilibrium, it raises, or, if there are a sizing or a run's check to return,
        says so in `failure`.

    Raises:
        InfeasibleError: where there is no equilibrium, or no forces for a sizing.
        OptionError: for arguments that do not fit.
        StructureError: where elastic rods lack a section.
    """
    member("search", search, Search)
    count = whole("modes", modes, 1)
    if path and search is not Search.NEWTON:
        raise OptionError(f"search = {search.value}: a path is followed by Newton's method; leave one of the two out")
    scene = Scene(scene) if isinstance(scene, Structure) else scene
    instance("scene", scene, Scene, "use a Scene or a Structure, as load_scene gives")
    structure = scene.structure
    nodes, strings = list(structure.nodes), [string.name for string in structure.strings]
    model = StaticModel.of(
        scene,
        rods=rods,
        rest_lengths=_by_name("rest_lengths", rest_lengths, structure.rest_lengths, strings, "string", "m"),
        loads=_by_name("loads", loads, np.zeros((len(nodes), 3)), nodes, "node", "N"),
        holds=holds,
        broken=broken,
    )
    if engine is not None:
        require_rigid_and_free(model)
    checked = None if run is None else _checked(run, model.scene)
    sizing = None if materials is None else _sized(model, materials)
    start = balance(model)
    try:
        if path:
            response = Response.of(follow(model, points=points, progress=progress))
            states = [response.path.states[-1]]
        else:
            response, states = None, [] if search is Search.RELAXATION else [find_equilibrium(model)]
            states += [] if search is Search.NEWTON else [equilibrium.relax(model, progress=progress)]
    except InfeasibleError as error:
        if checked is None and sizing is None:
            raise
        notes = _notes(model)
        return StaticStudy(model, search, start, None, str(error), sizing=sizing, run=checked, notes=notes)
    state = states[0]
    natural = natural_modes(state, count)
    confirmed = None
    if engine is not None:
        from tensegrity_mj.statics.engines import check_engine  # here: engines take seconds to import

        confirmed = check_engine(state, natural, engine)
    return StaticStudy(
        model=model,
        search=search,
        start=start,
        state=state,
        other=states[1] if len(states) > 1 else None,
        modes=natural,
        prestressability=_prestressability(state),
        members=check_state(state),
        response=response,
        engine=confirmed,
        sizing=sizing,
        run=checked,
        notes=(*_notes(model), *_edge_notes(state)),
    )


def _prestressability(state: StaticState) -> Prestressability | None:
    """Analyse the prestress by the state's own forces; without any, by what could be prestressed there."""
    if state.model.structure.bodies:
        return None
    if np.any(state.settled(state.tensions)) or np.any(state.settled(state.rod_forces)):
        return prestressability(state)
    return prestressability(state.model, nodes=state.nodes)


def _by_name(
    what: str, given: Mapping[str, Any] | ArrayLike | None, start: Array, names: Sequence[str], kind: str, unit: str
) -> ArrayLike | None:
    """Rows of `start` with what is given of some by their names; what is given otherwise is as it is."""
    if not isinstance(given, Mapping):
        return given
    rows = np.array(start)
    for name, row in given.items():
        check_known(what, name, names, kind)
        rows[names.index(name)] = real_array(f"{what} of '{name}'", row, rows.shape[1:], unit, scalar=rows.ndim == 1)
    return rows


def _sized(model: StaticModel, materials: Materials) -> Sizing:
    instance("materials", materials, Materials, "use Materials(rods=STEEL, strings=STEEL)")
    scene, structure = model.scene, model.structure
    if not np.all(model.whole):
        raise OptionError("materials: strings that are to be sized are whole; leave broken ones out of the study")
    return lightest.minimal_mass(
        structure.placed(model.start),
        steady_forces(scene, model.start) + model.element_forces(model.start.ravel()).reshape(-1, 3) + model.loads,
        rods=materials.rods,
        strings=materials.strings,
        holds=model.holds,
        gravity=scene.gravity,
        least_radius=materials.least_radius,
    )


def _checked(run: Trajectory, scene: Scene) -> TrajectoryCheck:
    instance("run", run, Trajectory, "it must be a Trajectory")
    own, structure = run.scene.structure, scene.structure
    theirs, ours = labels_of(run.scene), labels_of(scene)
    for kind in ("node", "rod", "string"):
        if theirs[kind] != ours[kind]:
            raise OptionError(f"run: of scene '{run.scene.name}', whose {kind}s are others than those of this scene")
    # The given scene says what members bear: the run may be older.
    limited: Any = replace(
        own,
        rods=tuple(replace(rod, section=new.section) for rod, new in zip(own.rods, structure.rods, strict=True)),
        strings=tuple(replace(s, strength=new.strength) for s, new in zip(own.strings, structure.strings, strict=True)),
    )
    return check_trajectory(replace(run, scene=run.scene.with_(structure=limited)))


def _edge_notes(state: StaticState) -> list[str]:
    model = state.model
    edge = state.at_edge & model.whole
    if not edge.any():
        return []
    first = model.structure.strings[int(np.argmax(edge))].name
    count = counted(int(edge.sum()), "string")
    return [
        f"at the edge of slackness, as long as their rest length: {count} ('{first}' is one). Round-off "
        "decides whether stiffness and frequencies count them as slack or taut, and an engine may decide otherwise: "
        "add prestress"
    ]


def _notes(model: StaticModel) -> tuple[str, ...]:
    scene, still = model.scene, np.zeros_like(model.start)
    varying = callable(scene.loads) or any(load.angular_frequency for load in scene.loads)
    others = (one for one in scene.effects if one.work is not Work.STORED and one.label != "loads")
    pushing = [
        "wind" if one.label == "resistance" else one.label
        for one in others
        if np.any(forces_of([one], scene, float(scene.start_time), model.start, still))
    ]
    wet = bool(scene.adding_mass)
    notes = {
        "the control law is left out: strings have their own rest lengths": scene.control is not None,
        "contact is left out": scene.contact is not None,
        "supports that move stand where they are at t = 0": bool(scene.motions),
        "loads that vary are those at t = 0": varying,
        f"{' and '.join(pushing)}: applied as constant loads, computed at the start, at rest": bool(pushing),
        "frequencies leave the mass that water adds out": wet,
        "states of self-stress, mechanisms and what stiffens them leave the joints' bending stiffness out": (
            model.bends is not None
        ),
        "strings that are to break later are whole": bool(scene.breaks),
    }
    return (*(note for note, holds in notes.items() if holds), *warnings_of(scene.structure))
