"""A finished study: its data as plain values, the folder that holds them, and its page."""

from __future__ import annotations

import os
from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar, Self

from tensegrity_mj.basics.files import made_folder, write_text
from tensegrity_mj.basics.jsontext import to_json
from tensegrity_mj.pictures.findings import Judgement
from tensegrity_mj.pictures.page import Section, write_sections

RUNS = "runs"  # in the folder of a study: its finished runs


def runs_in(folder: str | os.PathLike[str] | None) -> Path | None:
    """Make the folder in which a study keeps its finished runs, and return its path; None without a folder."""
    return None if folder is None else made_folder(folder) / RUNS


@dataclass(frozen=True)
class Page:
    """The page of a study: its judgement, and in sections all of it."""

    title: str
    introduction: str
    judgement: Judgement
    sections: Iterable[Section]

    def write(self, path: str | os.PathLike[str]) -> Path:
        """Write it as one self-contained file (.html); returns its path.

        Raises:
            OptionError: for a path that cannot be written.
        """
        return write_sections(path, self.title, self.introduction, self.sections, opening=self.judgement.html())


@dataclass(frozen=True, eq=False)
class Report:
    """A finished study.

    Attributes:
        data: everything, as plain values, the same each time but for what is timed.
        folder: where it is kept, or None.
        seconds: how long it took, where that is measured; not part of the data.
    """

    data: dict[str, Any]
    folder: Path | None = None
    seconds: float = 0.0

    NAME: ClassVar[str]  # of the files in the folder

    def page(self) -> Page:
        """The page, made of the data alone; its sections are made as it is written."""
        raise NotImplementedError

    @property
    def judgement(self) -> Judgement:
        """The verdict and the findings, made of the data alone."""
        return self.page().judgement

    @property
    def answer(self) -> dict[str, Any]:
        """The data and the judgement, as plain values."""
        return {**self.data, **self.judgement.to_dict()}

    def save_page(self, path: str | os.PathLike[str]) -> Path:
        """Write the page (.html); returns its path."""
        return self.page().write(path)

    def kept(self, folder: str | os.PathLike[str] | None) -> Self:
        """The report, written into a folder where one is given: data as .json, and the page."""
        if folder is None:
            return self
        own = replace(self, folder=Path(folder))
        write_text(Path(folder) / f"{self.NAME}.json", to_json(self.answer, indent=1) + "\n")
        self.save_page(Path(folder) / f"{self.NAME}.html")
        return own
