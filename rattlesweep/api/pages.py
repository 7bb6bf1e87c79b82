"""Pages that a notebook shows."""

from __future__ import annotations

import html
from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class Page:
    """A self-contained HTML file.

    Attributes
    ----------
    path : Path
    """

    path: Path

    def __fspath__(self) -> str:
        """The path, for `open` and the like."""
        return str(self.path)

    def _repr_html_(self) -> str:
        """The page in a frame of its own, whose scripts see nothing of the notebook."""
        text = html.escape(self.path.read_text(encoding="utf-8"))
        style = "width: 100%; height: 720px; border: 0"
        return f'<iframe sandbox="allow-scripts" style="{style}" srcdoc="{text}"></iframe>'
