"""Pictures and pages that a notebook shows."""

from __future__ import annotations

import html
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rattlesweep.errors import ConfigError

if TYPE_CHECKING:
    from matplotlib.figure import Figure

LOOKS = ("title", "log", "size", "xlim", "ylim")
# Dots per inch of what a notebook shows.
DPI = 110.0


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


def plotted(
    directory: Path,
    kind: str | None,
    x: str | None,
    select: Mapping[str, Any] | Sequence[str],
    where: str | None,
    path: str | Path | None,
    looks: Mapping[str, Any],
) -> Figure:
    """A picture of a sweep, written to a file if there is a path."""
    from rattlesweep.study.plots.layout import read_layout
    from rattlesweep.study.plots.registry import read_picture
    from rattlesweep.study.style import FORMATS, encode, save, styled

    for name in looks:
        if name not in LOOKS:
            raise ConfigError(f"{name}: unknown; the looks of a picture are {', '.join(LOOKS)}")
    endings = [f".{kind}" for kind in FORMATS]
    if path is not None and Path(path).suffix.lower() not in endings:
        raise ConfigError(f"path {path}: the name must end in {', '.join(endings)}")
    if isinstance(select, Mapping):
        select = [f"{name}={_values(value)}" for name, value in select.items()]
    elif isinstance(select, str):
        select = [select]
    with styled():
        picture = read_picture(read_layout(directory), kind, x=x, select=select, where=where)
        figure = picture.figure(**looks)
        if path is not None:
            save(figure, [Path(path)], 150.0)
    # A figure that is none of pyplot's is shown by no notebook unless it says how.
    setattr(figure, "_repr_png_", lambda: encode(figure, "png", DPI))  # noqa: B010
    return figure


def _values(value: Any) -> str:
    """Values as ``--select`` has them: a text as it is, a number, or several."""
    if isinstance(value, str):
        return value
    try:
        return ",".join(repr(float(each)) for each in value)
    except TypeError:
        return repr(value)
