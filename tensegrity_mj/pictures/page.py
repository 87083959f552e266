"""One HTML page about some runs: what was run, how well it agrees, plots and video, all in the one file.

The page loads nothing from elsewhere (its content policy forbids it), reads on a phone, and can be mailed.
"""

from __future__ import annotations

import base64
import importlib.resources
import io
import math
import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import KW_ONLY, dataclass, replace
from html import escape
from pathlib import Path
from string import Template
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from tensegrity_mj.basics.files import checked, replacing
from tensegrity_mj.basics.functions import function_of
from tensegrity_mj.errors import OptionError
from tensegrity_mj.runs.trajectory import Trajectory

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["Picture", "Section", "Table", "write_page", "write_report", "write_sections"]

PathLike = str | os.PathLike[str]
IMAGE_TYPES = {".png": "image/png", ".jpg": "image/jpeg", ".jpeg": "image/jpeg"}

# Numbers of `Comparison.to_dict`, with words and units; others that it may hold are shown under their own names.
AGREEMENT = {
    "max_node_error": ("largest node error", "m"),
    "rms_node_error": ("RMS node error", "m"),
    "max_velocity_error": ("largest velocity error", "m/s"),
    "max_tension_error": ("largest tension error", "N"),
    "max_rod_force_error": ("largest rod force error", "N"),
    "max_force_density_error": ("largest force density (u) error", "N/m"),
    "max_rest_length_error": ("largest rest length error", "m"),
    "max_energy_error": ("largest energy error", "J"),
    "tolerance": ("tolerance", "in the unit of each"),
    "from": ("compared from", "s"),
    "to": ("compared to", "s"),
}


class ComparisonLike(Protocol):
    """What a report reads of a `Comparison`."""

    def to_dict(self) -> dict[str, Any]:
        """Names and numbers."""


@dataclass(frozen=True)
class Picture:
    """A figure with its caption: a matplotlib Figure, or a PNG or JPEG file."""

    figure: Figure | PathLike
    caption: str = ""


@dataclass(frozen=True)
class Table:
    """A table of its own: a title, column heads, rows of cells (numbers are formatted, all else becomes text).

    In a `Section`, a folded one shows its title alone until it is opened.
    """

    title: str
    columns: Sequence[str]
    rows: Sequence[Sequence[object]]
    note: str = ""
    folded: bool = False


@dataclass(frozen=True)
class Section:
    """A part of a page: its title, paragraphs of plain text, then pictures, tables and HTML as they come."""

    title: str
    text: Sequence[str] = ()
    parts: Sequence[Picture | Table | str] = ()


@dataclass(frozen=True, eq=False)
class Report:
    """Write the page; returns its path. It appears whole or not at all.

    Attributes:
        path: ends in .html.
        runs: what was simulated, at least one.
        title: by default the scene's name and where its numbers come from.
        introduction: one paragraph of plain text.
        comparison: of the first two runs.
        pictures: plots and pictures, in order.
        video: an mp4 file to embed, or None.
        video_note: what to say about the video, or in its place (why there is none).
        tables: further tables.

    Raises:
        OptionError: no runs, a file that is missing or of another kind, a path that cannot be written.
    """

    path: PathLike
    runs: Sequence[Trajectory]
    _: KW_ONLY
    title: str | None = None
    introduction: str = ""
    comparison: ComparisonLike | None = None
    pictures: Iterable[Picture] = ()
    video: PathLike | None = None
    video_note: str = ""
    tables: Iterable[Table] = ()

    def __call__(self) -> Path:
        if not self.runs:
            raise OptionError("a report needs at least one run; none was given")
        scene = self.runs[0].scene
        heading = self.title or (f"{scene.name}: {scene.source}" if scene.source else scene.name)
        sections = [] if self.comparison is None else [Section("Agreement", parts=[_agreement(self.comparison)])]
        if self.video is not None or self.video_note:
            sections.append(Section("Video", parts=[_video(self.video, self.video_note)]))
        sections.append(Section("Runs", parts=[_runs(self.runs)]))
        sections += _pictures_and_tables(self.pictures, self.tables)
        sections.append(Section("How it was run", parts=[_details(run) for run in self.runs]))
        return write_sections(self.path, heading, self.introduction, sections, "report")


write_report = function_of(Report)


def write_page(
    path: PathLike,
    title: str,
    *,
    introduction: str = "",
    pictures: Iterable[Picture] = (),
    tables: Iterable[Table] = (),
) -> Path:
    """Write a page of pictures and tables in the same style, about many runs or none; returns its path.

    Raises:
        OptionError: a picture that is missing or of another kind, a path that cannot be written.
    """
    return write_sections(path, title, introduction, _pictures_and_tables(pictures, tables))


def write_sections(
    path: PathLike, title: str, introduction: str, sections: Iterable[Section], what: str = "page"
) -> Path:
    """Write a page of sections in the same style; returns its path. `what` it is stands in messages.

    Raises:
        OptionError: a picture that is missing or of another kind, a path that cannot be written.
    """
    destination = checked(path, (".html", ".htm"), what)
    parts = [f"<h1>{escape(title)}</h1>"] + ([f"<p>{escape(introduction)}</p>"] if introduction else [])
    for section in sections:
        parts.append(f"<h2>{escape(section.title)}</h2>")
        parts += [f"<p>{escape(text)}</p>" for text in section.text]
        parts += [_part(part) for part in section.parts]
    with replacing(destination) as part:
        part.write_text(page_of(title, parts), encoding="utf-8")
    return destination


def _part(part: Picture | Table | str) -> str:
    if isinstance(part, str):
        return part
    if isinstance(part, Picture):
        return _picture(part)
    body = table_of(part.columns, part.rows) + (f"<p>{escape(part.note)}</p>" if part.note else "")
    if part.folded:
        return f"<details><summary>{escape(part.title)}</summary>{body}</details>"
    return (f"<h3>{escape(part.title)}</h3>" if part.title else "") + body


def _pictures_and_tables(pictures: Iterable[Picture], tables: Iterable[Table]) -> list[Section]:
    """The pictures in one section, and each table in one of its own."""
    shown = list(pictures)
    plots = [Section("Plots", parts=shown)] if shown else []
    return plots + [Section(table.title, parts=[replace(table, title="")]) for table in tables]


def page_of(heading: str, parts: Sequence[str], style: str = "") -> str:
    """A page's whole text: its parts, in HTML, in the common frame `page.html`; `style` adds to the common one."""
    frame = importlib.resources.files("tensegrity_mj.pictures").joinpath("page.html").read_text(encoding="utf-8")
    return Template(frame).substitute(title=escape(heading), style=style, body="\n".join(parts))


# ------------------------------------------------------------------------------------------------------ sections


def _agreement(comparison: ComparisonLike) -> str:
    data = comparison.to_dict()
    exceeded = data.get("first_exceeded")
    exceeded = exceeded if isinstance(exceeded, Mapping) else {}
    rows: list[tuple[object, ...]] = []
    for key, value in data.items():
        if isinstance(value, Mapping) or value is None or isinstance(value, (list, tuple)):
            continue
        words, unit = AGREEMENT.get(key, (key.replace("_", " "), ""))
        rows.append((words, value, unit))
    html = table_of(("quantity", "value", "unit"), rows)
    times = [(str(name).replace("_", " "), when) for name, when in exceeded.items() if when is not None]
    if times:
        html += "<p>First beyond the tolerance:</p>" + table_of(("quantity", "time [s]"), times)
    elif exceeded:
        html += "<p>No quantity exceeded its tolerance.</p>"
    return html


def _runs(runs: Sequence[Trajectory]) -> str:
    """One column a run."""
    rows: list[tuple[object, ...]] = [
        ("status", *(run.status.value + (f": {run.message}" if run.message else "") for run in runs)),
        ("simulated time [s]", *(run.time[-1] - run.time[0] if len(run.time) else math.nan for run in runs)),
        ("samples", *(len(run.time) for run in runs)),
        ("distance to the target at the end [m]", *(_final_error(run) for run in runs)),
        ("largest force density u [N/m]", *(run.max_force_density for run in runs)),
        ("smallest feasibility margin", *(run.min_feasibility_margin for run in runs)),
        ("energy residual [J]", *(run.energy_residual for run in runs)),
    ]
    for source in ("reports", "cost"):
        names = dict.fromkeys(name for run in runs for name in getattr(run, source))
        for name in names:
            cells = [getattr(run, source).get(name) for run in runs]
            rows.append((name.replace("_", " "), *cells))
    heads = [run.engine or f"run {number}" for number, run in enumerate(runs, 1)]
    return table_of(("", *heads), rows)


def _final_error(run: Trajectory) -> float:
    if run.scene.target is None or not len(run.time):
        return math.nan
    return float(run.target_error()[-1])


def _details(run: Trajectory) -> str:
    """Everything that is needed to run it again, folded away."""
    rows = [(name.replace("_", " "), value) for name, value in run.provenance.items()]
    body = table_of(("", ""), rows) if rows else "<p>Nothing was recorded.</p>"
    return f"<details><summary>{escape(run.engine or run.scene.name)}</summary>{body}</details>"


def _picture(picture: Picture) -> str:
    if isinstance(picture.figure, (str, os.PathLike)):
        source = Path(picture.figure)
        kind = IMAGE_TYPES.get(source.suffix.lower())
        if kind is None:
            raise OptionError(f"picture {source}: a report holds {', '.join(IMAGE_TYPES)} files or figures")
        data = _read(source, "picture")
    else:
        buffer = io.BytesIO()
        picture.figure.savefig(buffer, format="png", dpi=120)
        kind, data = "image/png", buffer.getvalue()
    caption = f"<figcaption>{escape(picture.caption)}</figcaption>" if picture.caption else ""
    return f'<figure><img alt="{escape(picture.caption)}" src="{data_url(kind, data)}">{caption}</figure>'


def _video(video: PathLike | None, note: str) -> str:
    text = f"<p>{escape(note)}</p>" if note else ""
    if video is None:
        return text
    source = Path(video)
    if source.suffix.lower() != ".mp4":
        raise OptionError(f"video {source}: a report holds .mp4 files")
    url = data_url("video/mp4", _read(source, "video"))
    return f'<video controls loop muted playsinline src="{url}"></video>{text}'


def _read(path: Path, what: str) -> bytes:
    try:
        return path.read_bytes()
    except OSError as error:
        raise OptionError(f"{what} {path}: it cannot be read ({error.strerror}); name a file that exists") from error


def data_url(kind: str, data: bytes) -> str:
    """Of data that stands in the page itself."""
    return f"data:{kind};base64,{base64.b64encode(data).decode('ascii')}"


# -------------------------------------------------------------------------------------------------------- tables


def table_of(columns: Sequence[str], rows: Sequence[Sequence[object]]) -> str:
    """A table in HTML."""
    head = "".join(f"<th>{escape(column)}</th>" for column in columns) if any(columns) else ""
    lines = [f"<thead><tr>{head}</tr></thead>"] if head else []
    for row in rows:
        first, *others = row
        cells = "".join(f"<td{_align(cell)}>{_cell(cell)}</td>" for cell in others)
        lines.append(f"<tr><th>{_cell(first)}</th>{cells}</tr>")
    return f'<div class="table"><table>{"".join(lines)}</table></div>'


def _align(value: object) -> str:
    return ' class="n"' if isinstance(value, (int, float, np.number)) and not isinstance(value, bool) else ""


def _cell(value: object) -> str:
    """A value as HTML: numbers with four digits, nothing as a dash, groups of values one a line."""
    if value is None:
        return "–"
    if isinstance(value, (bool, np.bool_)):
        return "yes" if value else "no"
    if isinstance(value, (int, np.integer)):
        return str(value)
    if isinstance(value, (float, np.floating)):
        return "–" if math.isnan(value) else escape(f"{value:.4g}")
    if isinstance(value, Mapping):
        return "<br>".join(f"{escape(str(key))}: {_cell(item)}" for key, item in value.items()) or "–"
    if isinstance(value, (list, tuple)):
        return ", ".join(_cell(item) for item in value) or "–"
    return escape(str(value))
