"""Write scenes of evidence/docs/tradeoff.md anew: a picture each, and sentences and a table between two marks.

    tensegrity-mj tradeoff prism cross --out tradeoff/
    .venv/bin/python -m evidence.pages.tradeoff tradeoff/*/tradeoff.json

What stands there of other scenes stays.
"""

from __future__ import annotations

import io
import json
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from evidence.pages import table_lines
from tensegrity_mj.basics.files import made_folder, replacing, write_text
from tensegrity_mj.basics.texts import file_name
from tensegrity_mj.errors import FormatError
from tensegrity_mj.studies.tradeoff import advising
from tensegrity_mj.studies.tradeoff.experiments import BUDGET
from tensegrity_mj.studies.tradeoff.page import Cost, diagram, has_diagram

Data = Mapping[str, Any]

DOCS = Path(__file__).resolve().parents[1] / "docs"
TEXT, PICTURES = "tradeoff.md", "tradeoff"
BEGIN, END = "<!-- scene {name}: made by evidence/pages/tradeoff.py -->", "<!-- end of scene {name} -->"
DPI = 90
COLORS = 128  # of a picture in the documentation, to keep it small


def write_docs(folder: Path, studies: Sequence[Data]) -> list[Path]:
    """Write the pictures and the parts of tradeoff.md of some scenes.

    Raises:
        FormatError: a file whose marks are damaged.
    """
    made_folder(folder / PICTURES)
    text_path = folder / TEXT
    text = text_path.read_text(encoding="utf-8")
    written = []
    for data in studies:
        name = file_name(data["scene"]["name"])
        picture = None
        if has_diagram(data):
            picture = folder / PICTURES / f"{name}.png"
            _write_picture(picture, data)
            written.append(picture)
        text = replaced(text, name, part(data, picture is not None), str(text_path))
    return [*written, write_text(text_path, text)]


def replaced(text: str, name: str, own: str, where: str) -> str:
    """A text with a scene's part in place of what stood between its marks, or at the end where there was none.

    Raises:
        FormatError: where one of the two marks is missing.
    """
    begin, end = BEGIN.format(name=name), END.format(name=name)
    block = f"{begin}\n{own}\n{end}"
    if text.count(begin) == 0 and text.count(end) == 0:
        return f"{text.rstrip()}\n\n{block}\n"
    head, found, rest = text.partition(begin)
    _, also, tail = rest.partition(end)
    if not found or not also or begin in rest:
        raise FormatError(f"{where}: the marks of scene '{name}' are damaged; delete both and run this again")
    return head + block + tail


def part(data: Data, has_picture: bool) -> str:
    """A scene's heading, picture, sentences and table."""
    name = file_name(data["scene"]["name"])
    lines = [f"## {name}", ""]
    if has_picture:
        lines += [f"![Error against wall time of scene {name}]({PICTURES}/{name}.png)", ""]
    budget = data["options"]["budget"]
    if budget != BUDGET:
        lines += [f"With `--budget {budget:.0e}`.".replace("e+0", "e"), ""]
    held, references = [], []
    for experiment, timing in advising.with_timing(data):
        title = experiment["title"]
        references.append(f"- {title} ({experiment['duration']:g} s): {advising.reference_sentence(experiment)}.")
        if experiment["note"]:
            references[-1] += f" {experiment['note']}"
        if timing["floor"] is not None:
            held.append(f"- {timing['floor']}.")
            continue
        if not timing["advice"]:
            continue
        table = table_lines(advising.ADVICE, advising.advice_rows(experiment, timing))
        lines += [f"{title[:1].upper()}{title[1:]}:", "", *table, ""]
    if held:
        lines += ["What is held between control samples:", "", *held, ""]
    return "\n".join([*lines, "References:", "", *references])


def _write_picture(path: Path, data: Data) -> None:
    from PIL import Image

    buffer = io.BytesIO()
    diagram(data, Cost.WALL_TIME).savefig(buffer, format="png", dpi=DPI)
    with Image.open(buffer) as image:
        small = image.convert("RGB").quantize(COLORS, dither=Image.Dither.NONE)
    with replacing(path) as new:
        small.save(new, format="PNG", optimize=True)


if __name__ == "__main__":
    for path in write_docs(DOCS, [json.loads(Path(name).read_text(encoding="utf-8")) for name in sys.argv[1:]]):
        print(f"wrote {path}")
