"""mkdocs: pages from outside docs/, pages made by site_pages.py, and links between them as the code host has them."""

from __future__ import annotations

import posixpath
import re
import shutil
from typing import Any

import site_pages
from mkdocs.structure.files import File, Files

ROOT = site_pages.ROOT
PACKAGE = ROOT / "build" / "site" / "package" / "tensegrity_mj"
# In a docstring, "first, second: what both are", which griffe would take for one name of a type.
SHARED = re.compile(r"^( +)((?!self,|cls,)[a-z_]\w*(?:, [a-z_]\w*)+): (.*(?:\n\1    .*)*)$", re.MULTILINE)
LINK = re.compile(r"(!?)\[((?:[^\[\]]|\[[^\[\]]*\])*)\]\(([^()\s]+)\)")


def places() -> dict[str, str]:
    """Files of the checkout outside docs/ that are pages of the site, and their names there."""
    found = {"CONTRIBUTING.md": "contributing.md", "CHANGELOG.md": "changelog.md", "README.md": "index.md"}
    for name in site_pages.scenes():
        found[f"models/{name}/README.md"] = f"scenes/{name}.md"
        found[f"models/{name}/scene.png"] = f"scenes/{name}.png"
    evidence = ROOT / "evidence"
    for path in [evidence / "README.md", *sorted((evidence / "docs").rglob("*.*"))]:
        place = path.relative_to(ROOT).as_posix()
        found[place] = place.replace("evidence/docs/", "evidence/")
    return found


def on_startup(command: str, dirty: bool) -> None:
    """Lay the package out as a wheel has it, for mkdocstrings, which looks for the folder before `on_config`."""
    shutil.rmtree(PACKAGE, ignore_errors=True)
    only_code = shutil.ignore_patterns("__pycache__", "shipped", "tables")
    shutil.copytree(ROOT / "tensegrity_mj", PACKAGE, ignore=only_code)
    shutil.copytree(ROOT / "controllers", PACKAGE / "controllers", ignore=only_code)
    for path in PACKAGE.rglob("*.py"):
        text = path.read_text(encoding="utf-8")
        path.write_text(SHARED.sub(_each_by_itself, text), encoding="utf-8")


def on_config(config: Any) -> Any:
    """List the scenes and the rooms of the package in the navigation."""
    entries = {title: value for section in config.nav for title, value in section.items()}
    entries["Gallery"] += [{site_pages.title(name): f"scenes/{name}.md"} for name in site_pages.scenes()]
    reference = next(one for one in entries["Reference"] if "API" in one)
    reference["API"] += [{room: f"api/{room}.md"} for room in site_pages.ROOMS]
    return config


def _each_by_itself(found: re.Match[str]) -> str:
    indent, names, text = found.groups()
    return "\n".join(f"{indent}{name}: {text}" for name in names.split(", "))


def on_files(files: Files, config: Any) -> Files:
    """Add the pages that are not in docs/."""
    for source, name in places().items():
        if name != "index.md":
            files.append(File.generated(config, name, abs_src_path=str(ROOT / source)))
    made = {"gallery.md": site_pages.gallery(), "commands.md": site_pages.commands()}
    made |= {f"api/{name}": text for name, text in site_pages.api().items()}
    for path in sorted((ROOT / "docs" / "notebooks").glob("*.ipynb")):
        made[f"notebooks/{path.stem}.md"] = site_pages.notebook(path)
    for name, text in made.items():
        files.append(File.generated(config, name, content=text))
    files.append(File.generated(config, "schema.json", content=site_pages.schema()))
    for film in sorted(site_pages.FILMS.glob("*.mp4")):
        files.append(File.generated(config, f"films/{film.name}", abs_src_path=str(film)))
    return files


def on_page_markdown(markdown: str, page: Any, config: Any, files: Files) -> str:
    """Turn links of the checkout into links of the site; what is no page of it leads to the code host, or nowhere."""
    known = places()
    source = next((path for path, name in known.items() if name == page.file.src_uri), f"docs/{page.file.src_uri}")

    def turned(link: re.Match[str]) -> str:
        image, text, target = link.groups()
        path, sign, anchor = target.partition("#")
        if not path or ":" in path:
            return link[0]
        wanted = posixpath.normpath(posixpath.join(posixpath.dirname(source), path))
        place = known.get(wanted) or (wanted.removeprefix("docs/") if wanted.startswith("docs/") else "")
        if wanted == "README.md" and anchor:  # the home page has none of its sections
            place = ""
        if place and files.get_file_from_path(place):
            there = posixpath.relpath(place, posixpath.dirname(page.file.src_uri) or ".")
            return f"{image}[{text}]({there}{sign}{anchor})"
        if not (ROOT / wanted).exists():
            return link[0]  # mkdocs reports it
        return f"[{text}]({config.repo_url}/blob/main/{wanted})" if config.repo_url else text

    pieces = re.split(r"(^```.*?^```$)", markdown, flags=re.MULTILINE | re.DOTALL)
    return "".join(piece if piece.startswith("```") else LINK.sub(turned, piece) for piece in pieces)
