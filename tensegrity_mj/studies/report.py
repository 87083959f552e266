"""A finished study: its data as plain values, and the folder that holds them with a page."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from pkgutil import resolve_name
from typing import Any, ClassVar, Self

from tensegrity_mj.basics.files import write_text
from tensegrity_mj.basics.jsontext import to_json


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
    PAGE: ClassVar[str]  # module:function that writes the page of data, imported when there is one to write

    def save_page(self, path: str | os.PathLike[str]) -> Path:
        """Write the page (.html); returns its path."""
        written: Path = resolve_name(self.PAGE)(path, self.data)
        return written

    def kept(self) -> Self:
        """The report, written into its folder where it has one: data as .json, and the page."""
        if self.folder is not None:
            write_text(self.folder / f"{self.NAME}.json", to_json(self.data, indent=1) + "\n")
            self.save_page(self.folder / f"{self.NAME}.html")
        return self
