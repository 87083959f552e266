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
from dataclasses import dataclass, replace
from html import escape
from pathlib import Path
from string import Template
from typing import Any

import numpy as np

from tensegrity_mj.basics.files import checked, write_text
from tensegrity_mj.basics.units import quantity
from tensegrity_mj.errors import OptionError
from tensegrity_mj.pictures.figure import Figure, print_png
from tensegrity_mj.pictures.findings import Finding, Judgement, Mark
from tensegrity_mj.runs.comparison import DIFFERENCES, Comparison
from tensegrity_mj.runs.judgement import doubts, verdict
from tensegrity_mj.runs.trajectory import Trajectory

PathLike = str | os.PathLike[str]
IMAGE_TYPES = {".png": "image/png", ".jpg": "image/jpeg", ".jpeg": "image/jpeg"}

MOST_ITEMS = 6  # of a list in a table


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

    @classmethod
    def of(cls, title: str, columns: Mapping[str, str], records: Iterable[Mapping[str, Any]], **more: Any) -> Table:
        """A row for each record: what it has under the keys of `columns`, whose values are the heads."""
        return cls(title, [*columns.values()], [[one.get(key) for key in columns] for one in records], **more)


@dataclass(frozen=True)
class Section:
    """A part of a page: its title, paragraphs of plain text, then pictures, tables and HTML as they come."""

    title: str
    text: Sequence[str] = ()
    parts: Sequence[Picture | Table | str] = ()


def write_report(
    path: PathLike,
    runs: Sequence[Trajectory],
    *,
    title: str | None = None,
    introduction: str = "",
    comparison: Comparison | None = None,
    pictures: Sequence[Picture] = (),
    video: PathLike | None = None,
    video_note: str = "",
    tables: Iterable[Table] = (),
    web: bool = False,
) -> Path:
    """Write the page; returns its path. It appears whole or not at all.

    Args:
        path: ends in .html.
        runs: what was simulated, at least one.
        title: by default the scene's name.
        introduction: one paragraph of plain text.
        comparison: the comparison of the first two runs.
        pictures: plots and pictures, in order.
        video: an mp4 file to embed, or None.
        video_note: what to say about the video, or in its place (why there is none).
        tables: further tables.
        web: whether the first run is in it in 3-D, too, which makes the page 5 MB larger and needs plotly.

    Raises:
        OptionError: no runs, a file that is missing or of another kind, a path that cannot be written.
    """
    if not runs:
        raise OptionError("a report needs at least one run; none was given")
    scene = runs[0].scene
    shown = _video(video, video_note) if video is not None or video_note else ""
    head = "".join(judgement_of_runs(runs, comparison).html())
    requested = _requested(runs, introduction, titled=title is not None)
    opening = [f'<div class="beside"><div>{head}{requested}</div><div>{shown}</div></div>']
    sections = [Section("Plots", parts=list(pictures))] if pictures else []
    if web:
        from tensegrity_mj.pictures.web import make_web_page

        sections.append(Section("In 3-D", parts=[make_web_page(runs[0]).framed()]))
    if comparison is not None:
        sections.append(Section("How far the two are apart", parts=[_agreement(comparison)]))
    sections.append(Section("Outcome", parts=[_runs(runs)]))
    sections += pictures_and_tables((), tables)
    sections.append(Section("Everything that was recorded", parts=[_details(run) for run in runs]))
    return write_sections(path, title or scene.name, "", sections, "report", opening=opening)


def judgement_of_runs(runs: Sequence[Trajectory], comparison: Comparison | None = None) -> Judgement:
    """Judge runs: their outcome as the verdict; the tolerances of their comparison and all doubts as findings."""
    texts = [(run, text) for run in runs for text in doubts(run)]
    named = [f"{run.engine}: {text}" if len(runs) > 1 else text for run, text in texts]
    found = [Finding(Mark.LIMITED, text) for text in named]
    return Judgement(verdict(runs, comparison), [*found, *([] if comparison is None else within(comparison))])


def within(comparison: Comparison) -> list[Finding]:
    """The differences that have a tolerance: a verdict states that of the node error by the structure's size else."""
    found = []
    for name, when in comparison.first_exceeded.items():
        label, _, unit = DIFFERENCES[name]
        largest, most = (quantity(x, unit) for x in (getattr(comparison, f"max_{name}"), comparison.tolerance_of(name)))
        beyond = "" if when is None else f", exceeded from {quantity(when, 's')} on"
        text = f"the largest {label} is {largest} (allowed {most}{beyond})"
        found.append(Finding(Mark.GOOD if when is None else Mark.BAD, text))
    return found


def write_sections(
    path: PathLike,
    title: str,
    introduction: str,
    sections: Iterable[Section],
    what: str = "page",
    *,
    opening: Sequence[str] = (),
) -> Path:
    """Write a page of sections in the same style; returns its path.

    Args:
        what: it is, in messages.
        opening: HTML under the title, see `Judgement.html`.

    Raises:
        OptionError: a picture that is missing or of another kind, a path that cannot be written.
    """
    from tensegrity_mj.pictures.ticks import one_prefix  # which needs matplotlib

    destination = checked(path, (".html", ".htm"), what)
    sections = list(sections)
    in_units = one_prefix([part for section in sections for part in section.parts])
    parts = [f"<h1>{escape(title)}</h1>", *opening] + ([f"<p>{escape(introduction)}</p>"] if introduction else [])
    for section in sections:
        parts.append(f"<h2>{escape(section.title)}</h2>")
        parts += [f"<p>{escape(text)}</p>" for text in section.text]
        parts += [_part(in_units(part)) for part in section.parts]
    return write_text(destination, page_of(title, parts))


def _part(part: Picture | Table | str) -> str:
    if isinstance(part, str):
        return part
    if isinstance(part, Picture):
        if isinstance(part.figure, (str, os.PathLike)):
            source = Path(part.figure)
            kind = IMAGE_TYPES.get(source.suffix.lower())
            if kind is None:
                raise OptionError(f"picture {source}: a report holds {', '.join(IMAGE_TYPES)} files or figures")
            data = _read(source, "picture")
        else:
            buffer = io.BytesIO()
            print_png(part.figure, buffer, 120)
            kind, data = "image/png", buffer.getvalue()
        caption = f"<figcaption>{escape(part.caption)}</figcaption>" if part.caption else ""
        return f'<figure><img alt="{escape(part.caption)}" src="{data_url(kind, data)}">{caption}</figure>'
    body = table_of(part.columns, part.rows) + (f"<p>{escape(part.note)}</p>" if part.note else "")
    if part.folded:
        return f"<details><summary>{escape(part.title)}</summary>{body}</details>"
    return (f"<h3>{escape(part.title)}</h3>" if part.title else "") + body


def pictures_and_tables(pictures: Iterable[Picture], tables: Iterable[Table]) -> list[Section]:
    """The pictures in one section, and each table in one of its own."""
    shown = list(pictures)
    plots = [Section("Plots", parts=shown)] if shown else []
    return plots + [
        Section(table.title, parts=[replace(table, title=f"{len(table.rows)} rows" if table.folded else "")])
        for table in tables
    ]


def page_of(heading: str, parts: Sequence[str], style: str = "") -> str:
    """A page's whole text: its parts, in HTML, in the common frame `page.html`; `style` adds to the common one."""
    frame = importlib.resources.files("tensegrity_mj.pictures").joinpath("page.html").read_text(encoding="utf-8")
    # Scripts may run where a page in 3-D (`web.WebPage.framed`) is embedded, which inherits this page's policy.
    scripts = "; script-src 'unsafe-inline'" if any("<iframe" in part for part in parts) else ""
    return Template(frame).substitute(title=escape(heading), style=style, scripts=scripts, body="\n".join(parts))


# ------------------------------------------------------------------------------------------------------ sections


def _requested(runs: Sequence[Trajectory], introduction: str, *, titled: bool) -> str:
    """Return a table of what was simulated; with the scene's name where the page has a title of its own."""
    scene, first = runs[0].scene, runs[0].provenance
    structure, law = scene.structure, first.get("controller")
    held = first.get("actuation") or {}
    how = held.get("mode", "").replace("-", " ").replace("_", " ")
    period = f" every {quantity(held['period'], 's')}" if held.get("period") else ""
    rows = [
        ("scene", scene.name if titled else ""),
        ("from", scene.source),
        ("structure", f"{len(structure.rods)} rods, {len(structure.strings)} strings"),
        ("engines" if len(runs) > 1 else "engine", "; ".join(run.engine for run in runs)),
        ("law", _law_text(law) if isinstance(law, Mapping) else "none"),
        ("actuation", f"{how}{period}" if law else ""),
        ("duration", quantity(first["duration"], "s") if "duration" in first else ""),
    ]
    text = f"<p>{escape(introduction)}</p>" if introduction else ""
    return text + table_of(("", ""), [row for row in rows if row[1]])


def _law_text(law: Mapping[str, Any]) -> str:
    """The law with those of its options that are single numbers or words."""
    options = [
        f"{name.replace('_', ' ')} {value:{'g' if isinstance(value, float) else ''}}"
        for name, value in law.items()
        if name != "law" and isinstance(value, (int, float, str)) and not isinstance(value, bool)
    ]
    return ", ".join([str(law.get("law", "a function")).replace("_", " "), *options])


def _agreement(comparison: Comparison) -> str:
    """The differences; bounds are in the findings."""
    rows = [
        (f"largest {words}", quantity(getattr(comparison, f"max_{name}"), unit, 4))
        for name, (words, _, unit) in DIFFERENCES.items()
    ]
    rows.append(("RMS node error", quantity(comparison.rms_node_error, "m", 4)))
    first, last = (quantity(float(comparison.time[k]), "s") for k in (0, -1))
    about = f"<p>At {len(comparison.time)} common times from {first} to {last}.</p>"
    return table_of(("quantity", "difference"), rows) + about


def _runs(runs: Sequence[Trajectory]) -> str:
    """Return a table of the runs, one column each."""

    def column(run: Trajectory) -> dict[str, str]:
        lasted, errors = float(run.time[-1] - run.time[0]) if len(run.time) else math.nan, run.target_error()
        return {
            "status": run.status.value + (f": {run.message}" if run.message else ""),
            "simulated time": quantity(lasted, "s", 4),
            "distance to the target at the end": quantity(float(errors[-1]) if len(errors) else math.nan, "m", 4),
            "largest force density u": quantity(run.max_force_density, "N/m", 4),
            "smallest feasibility margin": quantity(run.min_feasibility_margin, "", 4),
            "energy residual": quantity(run.energy_residual, "J", 4),
            "wall time": quantity(run.cost.get("wall_time", math.nan), "s"),
            "steps": str(run.cost.get("steps", "–")),
            "warnings": "; ".join(map(str, run.reports.get("warnings") or [])) or "none",
        }

    columns = [column(run) for run in runs]
    rows = [(name, *(one[name] for one in columns)) for name in columns[0]]
    shown = [row for row in rows if any(cell != "–" for cell in row[1:])]
    return table_of(("", *(run.engine or f"run {number}" for number, run in enumerate(runs, 1))), shown)


def _details(run: Trajectory) -> str:
    """All reports, costs and options of a run, one a line, folded away."""
    rows = [row for source in ("provenance", "reports", "cost") for row in _flat(getattr(run, source))]
    body = table_of(("", ""), rows) if rows else "<p>Nothing was recorded.</p>"
    return f"<details><summary>{escape(run.engine or run.scene.name)}</summary>{body}</details>"


def _flat(found: Mapping[str, Any], before: str = "") -> list[tuple[object, ...]]:
    """Names and values of groups within groups; what is empty is left out."""
    rows: list[tuple[object, ...]] = []
    for name, value in found.items():
        label = f"{before}{str(name).replace('_', ' ')}"
        if isinstance(value, Mapping):
            rows += _flat(value, f"{label}: ")
        elif value is not None and not (isinstance(value, (list, tuple)) and not len(value)):
            rows.append((label, value))
    return rows


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
    """Return the URL of data that stands in the page itself."""
    return f"data:{kind};base64,{base64.b64encode(data).decode('ascii')}"


# -------------------------------------------------------------------------------------------------------- tables


def table_of(columns: Sequence[str], rows: Sequence[Sequence[object]]) -> str:
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
    """A value as HTML: numbers with four digits, nothing as a dash, of long lists the beginning."""
    if value is None:
        return "–"
    if isinstance(value, (bool, np.bool_)):
        return "yes" if value else "no"
    if isinstance(value, (int, np.integer)):
        return str(value)
    if isinstance(value, (float, np.floating)):
        return "–" if math.isnan(value) else escape(f"{value:.4g}")
    if isinstance(value, Mapping):
        return ", ".join(f"{escape(str(key))} {_cell(item)}" for key, item in value.items()) or "–"
    if isinstance(value, (list, tuple)):
        if len(value) > 1 and all(item == value[0] for item in value):
            return f"{_cell(value[0])} ({len(value)} times)"
        more = f", … ({len(value)} in all)" if len(value) > MOST_ITEMS else ""
        return (", ".join(_cell(item) for item in value[:MOST_ITEMS]) + more) or "–"
    return escape(str(value))
