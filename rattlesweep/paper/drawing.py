"""The pictures, drawn by a process of their own while this one computes the next figure.

Matplotlib takes as long as the data with ``--quick`` and holds the interpreter meanwhile.
"""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable, Sequence
from importlib import import_module
from pathlib import Path
from typing import Any, Self

from matplotlib.figure import Figure as Drawing

from rattlesweep import child
from rattlesweep.analysis.style import encode, styled
from rattlesweep.errors import OutputError
from rattlesweep.integrate.task import POLL
from rattlesweep.paper.workspace import KINDS, Figure, Tables, read_table, tidy
from rattlesweep.sweeps.files import replace_file

DPI = 150


def pictures(draw: Callable[[Tables], Drawing], tables: Tables) -> dict[str, bytes]:
    """A figure's pictures by kind, whatever the user's settings of Matplotlib are."""
    with styled():
        drawing = draw(tables)
        # Once for all kinds: it takes a third of the time.
        drawing.set_dpi(DPI)
        layout = drawing.get_layout_engine()
        assert layout is not None
        layout.execute(drawing)
        drawing.set_layout_engine("none")
        return {kind: encode(drawing, kind, DPI) for kind in KINDS}


def draw_here(directory: str, name: str, tables: Sequence[str], module: str, function: str) -> None:
    """Write the pictures of a figure, whose tables are in a directory."""
    place = Path(directory)
    found = {table: read_table(place, name, table) for table in tables}
    for kind, data in pictures(getattr(import_module(module), function), found).items():
        replace_file(place / f"{name}.{kind}", data)


def serve() -> None:
    """In the other process: draw what standard input names, one line each, until it ends."""
    try:
        for line in sys.stdin:
            draw_here(*json.loads(line))
    except OutputError as error:
        # For a user, unlike a traceback.
        print(error)
        sys.exit(1)


class Artist:
    """Has the pictures of a directory drawn; leaving it without :meth:`finish` gives them up."""

    def __init__(self, directory: Path, wanted: bool) -> None:
        self._directory = directory
        # Its imports take as long as the first two figures, so it begins with them.
        self._process = child.start(__name__, "SIG_IGN") if wanted else None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: Any) -> None:
        if self._process is not None:
            self._process.kill()
            self._process.communicate()
            tidy(self._directory)

    def draw(self, name: str, figure: Figure, tables: Tables) -> None:
        """Have the pictures of a figure drawn whose tables are in the directory."""
        asked = [str(self._directory), name, [*tables]]
        asked += [figure.draw.__module__, figure.draw.__qualname__]
        self._process = self._process or child.start(__name__, "SIG_IGN")
        assert self._process.stdin is not None
        try:
            # Shorter than any pipe: this does not wait.
            self._process.stdin.write(json.dumps(asked).encode() + b"\n")
            self._process.stdin.flush()
        except BrokenPipeError:
            self.finish()

    def finish(self, tick: Callable[[], None] = lambda: None) -> None:
        """Wait for what is still being drawn; ``tick`` is called a few times a second.

        Raises
        ------
        OutputError
            If a picture could not be written.
        """
        while self._process is not None:
            try:
                refusal, trace = self._process.communicate(timeout=POLL)
            except subprocess.TimeoutExpired:
                tick()
                continue
            code, self._process = self._process.returncode, None
            if refusal:
                raise OutputError(refusal.decode(errors="replace").strip())
            if code:
                said = trace.decode(errors="replace")
                raise RuntimeError(f"the process that draws ended with {code}\n{said}")
