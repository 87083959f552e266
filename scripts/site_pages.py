"""Pages of the site that are made of what they describe, so that they cannot go stale.

    gallery()       every scene: its picture, what it is, where it is from, the command that films it
    commands()      every command and option, from the parser's own tables
    api()           one page a room of the package: the names of its face, whose docstrings mkdocstrings shows
    notebook(path)  the cells of a notebook, run
    schema()        the JSON Schema of scene files

`python scripts/site_pages.py --films` films every scene whose film is missing or old, into build/films/.
"""

from __future__ import annotations

import argparse
import ast
import html
import json
import os
import re
import shlex
import subprocess
import sys
import tempfile
from collections.abc import Iterable, Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
MODELS = ROOT / "models"
FILMS = ROOT / "build" / "films"
ROOMS = (
    "model",
    "controllers",
    "engines",
    "exchange",
    "runs",
    "pictures",
    "statics",
    "studies",
    "studies.tradeoff",
    "learning.tasks",
    "learning.gymnasium",
    "simulation",
    "linearization",
    "library",
    "errors",
)


def scenes() -> list[str]:
    """The names of the scenes that come with the package."""
    return sorted(path.parent.name for path in MODELS.glob("*/scene.toml"))


def schema() -> str:
    """The JSON Schema of scene files, which editors may take from the site."""
    from tensegrity_mj.model import format_schema

    return json.dumps(format_schema(), indent=1, ensure_ascii=False)


# The gallery


def gallery() -> str:
    """Every shipped scene as a card, in the groups of `tensegrity-mj scenes`."""
    from tensegrity_mj.commands.scenes import OTHER, shipped

    groups = {heading: list(names) for heading, names in shipped().items()}
    listed = {name for names in groups.values() for name in names}
    groups[OTHER[0]] = [name for name in scenes() if name not in listed]
    lines = [
        "# Gallery",
        "",
        "Every scene that comes with the package. `tensegrity-mj scenes NAME` lists its nodes, rods and strings; the",
        "title leads to where each of its numbers comes from. Families of scenes, which come in sizes, are in",
        "[the format](format/running.md#families).",
    ]
    for heading, names in groups.items():
        if names:
            lines += ["", f"## {heading}", "", '<div class="grid cards" markdown>', ""]
            for name in names:
                lines += [f"{'    ' if k else '-   '}{line}".rstrip() for k, line in enumerate(_card(name))]
                lines.append("")
            lines.append("</div>")
    return "\n".join([*lines, ""])


def _card(name: str) -> Iterator[str]:
    from tensegrity_mj.commands.scenes import counts_of, counts_text
    from tensegrity_mj.library.named import load_scene

    scene = load_scene(name)
    size = counts_text(counts_of(scene.structure))
    film = FILMS / f"{name}.mp4"
    yield f"**[{title(name)}](scenes/{name}.md)**"
    yield ""
    if film.exists():
        yield f'<video controls muted loop preload="none" poster="scenes/{name}.png" src="films/{name}.mp4"></video>'
    else:
        yield f"![{title(name)}](scenes/{name}.png)"
    yield ""
    yield f"{summary(name)}; {size}, {scene.duration:g} s."
    yield ""
    yield f"*{html.escape(scene.source, quote=False)}*"
    yield ""
    yield "```bash"
    yield film_command(name)
    yield "```"


def _readme(name: str) -> str:
    return (MODELS / name / "README.md").read_text(encoding="utf-8")


def title(name: str) -> str:
    """The heading of a scene's README."""
    return _readme(name).partition("\n")[0].removeprefix("# ")


def summary(name: str) -> str:
    """What `tensegrity-mj scenes` says of a scene."""
    from tensegrity_mj.commands.scenes import OTHER, shipped

    found = next((lines[name] for lines in shipped().values() if name in lines), OTHER[1])
    return found[:1].upper() + found[1:]


def film_command(name: str) -> str:
    """The command of a scene's README that films it."""
    found = re.search(r"^tensegrity-mj run .*--video .*$", _readme(name), re.MULTILINE)
    if found is None:
        raise ValueError(f"models/{name}/README.md shows no command with --video")
    return found[0]


def make_films() -> None:
    """Film every scene whose film is missing or older than its scene."""
    FILMS.mkdir(parents=True, exist_ok=True)
    for name in scenes():
        film = FILMS / f"{name}.mp4"
        if film.exists() and film.stat().st_mtime > (MODELS / name / "scene.toml").stat().st_mtime:
            continue
        words = shlex.split(film_command(name))[1:]
        words[words.index("--video") + 1] = str(film)
        subprocess.run([sys.executable, "-m", "tensegrity_mj", *words], check=True)


# The commands


def commands() -> str:
    """Every command with its options, by the groups of `tensegrity-mj --help`."""
    from tensegrity_mj.cli import build_parser
    from tensegrity_mj.commands.common import EXIT_CODES

    parser = build_parser()
    lines = [
        "# Commands",
        "",
        "What `tensegrity-mj COMMAND --help` prints, of this version. Every command takes `--json`, which prints one",
        "JSON object on stdout and leaves everything else to stderr. SI units and radians everywhere.",
        "",
    ]
    for heading, names in parser.groups.items():
        lines += [f"## {heading.capitalize()}", ""]
        for name in names:
            lines += _command(parser.commands[name])
    return "\n".join([*lines, "## Exit codes", "", "```text", EXIT_CODES.strip(), "```", ""])


def _command(command: argparse.ArgumentParser) -> Iterator[str]:
    inner = getattr(command, "commands", {})
    words = command.prog.partition(" ")[2]
    yield from (f"### {words}", "", _paragraphs(command.description), "")
    examples = re.findall(r"^ +(tensegrity-mj .*)$", command.epilog or "", re.MULTILINE)
    if examples:
        yield from ("```bash", *examples, "```", "")
    if inner:
        for one in inner.values():
            yield from (line.replace("### ", "#### ", 1) for line in _command(one))
        return
    for group in command._action_groups:
        actions = [one for one in group._group_actions if "--help" not in one.option_strings and one.dest != "json"]
        if not actions:
            continue
        heading = {"positional arguments": "argument", "options": "option"}.get(group.title or "", group.title or "")
        yield from (f"| {heading} | |", "|---|---|")
        for action in actions:
            text = (action.help or "") % {"default": action.default, "prog": command.prog}
            yield f"| {_written(action)} | {_cell(text)} |"
        yield ""


def _written(action: argparse.Action) -> str:
    """An argument as it is typed: `--rtol RTOL`."""
    if action.choices is not None and action.metavar is None:
        value = "\u200b|".join(map(str, action.choices))
    else:
        metavar = action.metavar or action.dest.upper()
        value = metavar if isinstance(metavar, str) else " ".join(metavar)
    if action.nargs == 0:
        value = ""
    several = " ..." if action.nargs in ("+", "*") else ""
    typed = f"{', '.join(action.option_strings)} {value}".strip() + several
    return f"<code>{_cell(typed)}</code>"


def _cell(text: str) -> str:
    """Text of a cell of a table."""
    for character in "|*_[]`":
        text = text.replace(character, f"&#{ord(character)};")
    return text.replace("<", "&lt;").replace("\n", " ")


def _paragraphs(text: str | None) -> str:
    return (text or "").strip().replace("<", "&lt;").replace("*", r"\*")


# The API


def api() -> dict[str, str]:
    """The pages of the API by file name: each name once, in its room."""
    homes: dict[str, str] = {}
    pages: dict[str, str] = {}
    for room in ROOMS:
        names = {path: name for name, path in _face(_source(room)).items() if path not in homes}
        homes |= names
        pages[f"{room}.md"] = _api_page(f"tensegrity_mj.{room}", _docstring(_source(room)), names)
    top = ROOT / "tensegrity_mj" / "__init__.py"
    own = _face(top)
    rows = [f"| [`tmj.{name}`][{path}] |" for name, path in own.items() if not _is_room(path)]
    rest = {path: name for name, path in own.items() if path not in homes and not _is_room(path)}
    listed = "\n".join(["| name at the top |", "|---|", *rows])
    rooms = ", ".join(f"[`{room}`]({room}.md)" for room in ROOMS)
    text = f"{_docstring(top).partition(':')[2].strip()}\n\nRooms: {rooms}.\n\n{listed}"
    pages["index.md"] = _api_page("tensegrity_mj", text, rest)
    return pages


def _source(room: str) -> Path:
    """The file of a room, which is read and never imported: the site is built without the package's extras."""
    place = ROOT.joinpath(*([] if room == "controllers" else ["tensegrity_mj"]), *room.split("."))
    return place / "__init__.py" if place.is_dir() else place.with_suffix(".py")


def _docstring(source: Path) -> str:
    return ast.get_docstring(ast.parse(source.read_text(encoding="utf-8"))) or ""


def _face(source: Path) -> dict[str, str]:
    """The names of a face and the paths of what they stand for; of a module without imports of names, its classes."""
    text = source.read_text(encoding="utf-8")
    found = re.findall(r"^    from (\S+) import (\w+) as (\w+)$", text, re.MULTILINE)
    if found:
        return {name: f"{home}.{original}" for home, original, name in found}
    room = ".".join(source.relative_to(ROOT).with_suffix("").parts)
    return {name: f"{room}.{name}" for name in re.findall(r"^(?:class|def) ([A-Za-z]\w*)", text, re.MULTILINE)}


def _is_room(path: str) -> bool:
    return path.removeprefix("tensegrity_mj.") in ROOMS


def _api_page(name: str, text: str | None, members: Iterable[str]) -> str:
    blocks = "\n\n".join(f"::: {path}" for path in members)
    return f"# {name}\n\n{(text or '').strip()}\n\n{blocks}\n"


# Notebooks


# Runs cells, whose sources come as JSON, and answers with what each prints, and its figures as PNG in base64.
RUN = """
import ast, base64, contextlib, io, json, sys
import matplotlib.pyplot as plt

names, answers = {"__name__": "__main__"}, []
for source in json.load(sys.stdin):
    printed, drawn, body = io.StringIO(), [], ast.parse(source)
    shown = None if source.rstrip().endswith(";") or not isinstance(body.body[-1], ast.Expr) else body.body.pop()
    with contextlib.redirect_stdout(printed):
        exec(compile(body, "cell", "exec"), names)
        value = eval(compile(ast.Expression(shown.value), "cell", "eval"), names) if shown else None
    if hasattr(value, "_repr_png_"):
        drawn.append(value._repr_png_())
    elif value is not None:
        print(repr(value), file=printed)
    for number in plt.get_fignums():
        file = io.BytesIO()
        plt.figure(number).savefig(file, format="png", dpi=110)
        drawn.append(file.getvalue())
    plt.close("all")
    answers.append((printed.getvalue(), [base64.b64encode(one).decode() for one in drawn]))
print(json.dumps(answers))
"""


def notebook(path: Path) -> str:
    """The cells of a notebook as a page, with what they print and draw when they are run, and a link to the file."""
    cells = json.loads(path.read_text(encoding="utf-8"))["cells"]
    sources = ["".join(cell["source"]) for cell in cells]
    codes = [source for source, cell in zip(sources, cells, strict=True) if cell["cell_type"] == "code"]
    with tempfile.TemporaryDirectory() as folder:
        environment, out = {**os.environ, "MPLBACKEND": "agg"}, subprocess.PIPE
        command, given = [sys.executable, "-c", RUN], json.dumps(codes)
        done = subprocess.run(command, input=given, cwd=folder, env=environment, text=True, stdout=out)
    if done.returncode:
        raise RuntimeError(f"{path}: a cell fails: see above")
    outputs = iter(json.loads(done.stdout))
    pieces = []
    for source, cell in zip(sources, cells, strict=True):
        if cell["cell_type"] == "markdown":
            pieces.append(source)
            continue
        printed, drawn = next(outputs)
        pieces.append(f"```python\n{source}\n```")
        pieces += [f"```text\n{printed.rstrip()}\n```"] if printed else []
        pieces += [f'<img alt="The figure that this cell draws" src="data:image/png;base64,{one}">' for one in drawn]
    pieces.insert(1, f"[The notebook]({path.name}); what its cells print and draw is of the build of this page.")
    return "\n\n".join(pieces) + "\n"


if __name__ == "__main__":
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("--films", action="store_true", required=True, help="film every scene into build/films/")
    options.parse_args()
    make_films()
