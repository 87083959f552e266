"""Trajectories: the run that every engine returns, saves, loads and analyses. Nodes in the world frame, SI units."""

from __future__ import annotations

import base64
import os
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from tensegrity_mj.basics import files, notebook_pictures, texts
from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.errors import printable
from tensegrity_mj.runs.recorded import RecordedRun
from tensegrity_mj.runs.recorded import Status as Status

if TYPE_CHECKING:
    import pandas
    import xarray

    from tensegrity_mj.runs.statistics import Statistics

MOST_LETTERS = 100  # of a line of the summary
SUFFIXES = (".nc", ".csv", ".mat")  # of the files that a run is saved as


class Trajectory(RecordedRun):
    """One simulated run: arrays over time as in `VARIABLES`, and where they come from.

    It has no samples where a run diverged at its very start.

    Attributes:
        scene: what was simulated (loads given as a Python function are not kept in files).
        status, message: how it ended, and in words when not completed.
        engine: one line that names engine, integrator and step or tolerance.
        cost: `wall_time` [s], `steps`, `evaluations` of the right-hand side, and what else the engine counts.
        reports: numbers about the run: constraint drift, largest holding ratio, times with L0 <= 0, ...
        provenance: versions, options and seeds, as text or numbers.
        element_states: (T, S) of the elements that have one, as `element_state_names` calls them.
        constraint_forces: (T, C) [N] of the linear constraints; times a node's weight is what acts on that node.
    """

    def __repr__(self) -> str:
        return texts.at_a_glance(_rows_of(self))

    def _repr_html_(self) -> str:
        """Summary as a table, and below it a plot of the tensions, or of heights where nothing pulls."""
        cells = "".join(f"<tr><th>{name}</th><td>{escape(text)}</td></tr>" for name, text in _rows_of(self))
        plot = notebook_pictures.draw(self)
        shown = "" if plot is None else f'<img src="data:image/png;base64,{base64.b64encode(plot).decode()}">'
        return f"<table>{cells}</table>{shown}"

    def water_loads(self, of: str = "rod") -> Array:
        """The force of the water on each "rod" (T, R, 3), or "string" (T, M, 3) [N]; see `flow_regime.water_loads`."""
        from tensegrity_mj.runs.flow_regime import water_loads

        return water_loads(self, of)

    def water_load(self, member: str, of: str = "rod") -> Array:
        """Force (T, 3) [N] of the water on a rod or a string by its name; OptionError where there is none."""
        rows = self.parts_of(member)[0] if of == "string" else [self._number("rod", member)]
        return np.asarray(self.water_loads(of)[:, rows].sum(axis=1))

    def statistics(self, quantity: str = "tension", after: float = 0.0) -> Statistics:
        """Means, deviations, extremes, significant responses and cycles, from a time on: see `runs.statistics`."""
        from tensegrity_mj.runs.statistics import statistics

        return statistics(self, quantity, after)

    def to_xarray(self, water_loads: bool = False) -> xarray.Dataset:
        """The run as `xarray.open_dataset` reads its file: `run.to_xarray().tensions.sel(string="s1")`.

        With `water_loads`, it has those, too.

        Raises:
            MissingPackageError: where xarray is not installed.
        """
        from tensegrity_mj.runs.stored import to_xarray

        return to_xarray(self, water_loads)

    def to_dataframe(self, water_loads: bool = False) -> pandas.DataFrame:
        """A row for each time [s], the index, and a column for each number: "n1.x", "s1.tension", "kinetic_energy".

        With `water_loads`, there are "rod1.water_x", "s1.drag_x" and so on, too.

        Raises:
            MissingPackageError: where pandas is not installed.
        """
        from tensegrity_mj.runs.stored import to_dataframe

        return to_dataframe(self, water_loads)

    def save(self, path: str | os.PathLike[str], water_loads: bool = False) -> Path:
        """Write NetCDF-4 (.nc), which `load` reads, or a table: .csv, or .mat for MATLAB; returns the path.

        The file appears whole: a crash leaves the old one or none. With `water_loads`, it has those, too.

        Raises:
            OptionError: for another suffix, or a place where no file can be written; as `water_loads`.
            FormatError: if writing fails.
        """
        destination = files.checked(path, SUFFIXES, "trajectory")
        match destination.suffix.lower():
            case ".csv":
                from tensegrity_mj.runs.stored import write_csv as write
            case ".mat":
                from tensegrity_mj.runs.stored import write_mat as write
            case _:
                from tensegrity_mj.runs.stored import write_run as write
        with files.replacing(destination) as part:
            write(self, part, water_loads)
        return destination

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Trajectory:
        """Read what `save` wrote, exactly.

        Raises:
            FormatError: if the file is absent, damaged, or no trajectory, or where its times do not rise or its values
                are not finite (what a law reports may be NaN), or its members stand in another order; it says which.
        """
        from tensegrity_mj.runs.stored import read_run

        return cls(**read_run(path))


def _rows_of(run: RecordedRun) -> list[tuple[str, str]]:
    """Rows (name, line) of a run's summary: scene, engine, time, status and errors."""
    structure = run.scene.structure
    size = f"{len(structure.nodes)} nodes, {len(structure.rods)} rods, {len(structure.strings)} strings"
    span = f"{run.time[0]:g} to {run.time[-1]:g} s, " if len(run.time) else ""
    warnings = run.reports.get("warnings", [])
    error = f"energy off by {run.energy_residual:.2g} J"
    if warnings:
        error += f"; {len(warnings)} warning{'s' * (len(warnings) > 1)}: {warnings[0]}"
    rows = [
        ("run of", f"{run.scene.name}: {size}"),
        ("engine", run.engine),
        ("time", f"{span}{len(run.time)} samples"),
        ("status", run.status.value + (f": {run.message}" if run.message else "")),
        ("errors", error),
    ]
    return [(name, texts.shortened(printable(text), MOST_LETTERS)) for name, text in rows]
