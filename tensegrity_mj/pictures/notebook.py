"""Display of the files of videos and pictures in notebooks."""

from __future__ import annotations

import base64
import contextlib
import mimetypes
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING

MOST_EMBEDDED = 30_000_000  # bytes of a file that a notebook gets into itself

if TYPE_CHECKING:
    _Path = Path
else:
    _Path = type(Path())  # before Python 3.12 only the system's own kind can be inherited from


class ShownFile(_Path):
    """The path of a video or a picture, which a notebook shows."""

    def _repr_html_(self) -> str:
        kind = mimetypes.guess_type(self.name)[0] or ""
        with contextlib.suppress(OSError):  # it is gone
            if kind.startswith(("video/", "image/")) and self.stat().st_size <= MOST_EMBEDDED:
                source = f'src="data:{kind};base64,{base64.b64encode(self.read_bytes()).decode()}"'
                return f"<video controls loop {source}></video>" if kind.startswith("video/") else f"<img {source}>"
        return f"<code>{escape(str(self))}</code>"
