"""Make the figures and supplements, judge the claims, and write the report."""

import time
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import asdict
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from textwrap import shorten
from typing import Any

import matplotlib as mpl
import pandas as pd
from matplotlib.figure import Figure

from rattlesweep.api import machine, versions
from rattlesweep.api.style import (
    FAINT,
    check_panels,
    chosen_size,
    local_numbers,
    save_figure,
    save_table,
    separate_ticks,
    sized,
    styled,
    with_room,
)
from rattlesweep.paper.claim import UNDECIDED, judge, read_rows_of
from rattlesweep.paper.workspace import FULL_SIZES, Tables, Workspace
from rattlesweep.system.files import replace_file
from rattlesweep.system.pages import config_yaml, embedded, render
from rattlesweep.words.errors import check_names

# The name that selects the claims about formulas alone.
_THEORY = "theory"
FILE_KINDS = ("svg", "png")
# Matplotlib's settings: ticks inward, as in the paper, and titles at a fixed height,
# since placing them automatically takes a sixth of the drawing time.
LOOK: Any = {
    "xtick.direction": "in",
    "ytick.direction": "in",
    "xtick.top": True,
    "ytick.right": True,
    "axes.titlesize": 10,
    "axes.titlepad": 4,
    "axes.titley": 1.0,
    "grid.color": FAINT,
    "grid.linewidth": 0.6,
}
VERDICTS = ("agree", "partly", "disagree", UNDECIDED)


def choose_figures(names: str | None) -> list[str]:
    """Return the requested parts, such as ``fig8,fig7``, in the paper's order."""
    known = [*read_rows_of("parts"), _THEORY]
    if names is None:
        return known
    wanted = [name.strip() for name in names.split(",")]
    check_names("--only", wanted, known)
    return [name for name in known if name in wanted]


def reproduce(
    workspace: Workspace,
    names: Sequence[str],
    begin: Callable[[str], None] = lambda title: None,
    *,
    style: str | None = None,
    size: tuple[float, float] | None = None,
) -> list[dict[str, Any]]:
    """Compute and draw parts, write the report, and return the judged claims.

    `style` is a style of Matplotlib, and `size` that of each figure in inches.
    """
    figures = {
        name: row for name, row in read_rows_of("parts").items() if name in names
    }
    directory = workspace.directory
    sizes = workspace.sizes
    tables: dict[str, Tables] = {}
    seconds = {}
    embedded_figures = []
    for name, figure in figures.items():
        begin(figure["title"])
        start = time.perf_counter()
        tables[name] = figure["data"](workspace)
        for table, rows in tables[name].items():
            save_table(rows, directory / f"{name}_{table}.parquet")
        paths = [directory / f"{name}.{kind}" for kind in FILE_KINDS]
        with styled(style), mpl.rc_context(_look(style, size)), local_numbers():
            _save(figure["draw"], tables[name], paths)
        picture = embedded(*(path.read_bytes() for path in paths))
        embedded_figures.append((name, figure, list(tables[name]), picture))
        seconds[name] = f"{time.perf_counter() - start:.1f} s"
    claims = judge(
        tables, theory=_THEORY in names, few=sizes.samples < FULL_SIZES.samples
    )
    save_table(pd.DataFrame(claims), directory / "claims.parquet")
    verdicts = {
        "claims": claims,
        "tally": tally(claims),
        "quick": sizes != FULL_SIZES,
        "overrides": workspace.overrides,
    }
    page = render("claims.md.j2", version=version("rattlesweep"), **verdicts)
    replace_file(directory / "claims.md", page)
    sections = {}
    if figures:
        sections["figures"] = "Figures"
    sections |= {"claims": "Claims", "run": "How it was made", "settings": "Settings"}
    sweeps = [path.name for path in sorted(directory.glob("sweeps/*"))]
    configs = {name: workspace.config(name) for name in sweeps}
    page = render(
        "paper.html.j2",
        title="Rattleback dynamics and its reversal time of rotation: recomputed",
        sections=[*sections.items()],
        finished=datetime.now(UTC).isoformat(timespec="seconds"),
        versions=versions() | {"matplotlib": version("matplotlib")},
        machine=machine(),
        figures=embedded_figures,
        failed=workspace.failed,
        parts=[*seconds.items()],
        settings=config_yaml(asdict(sizes) | configs),
        **verdicts,
    )
    replace_file(directory / "report.html", page)
    return claims


def _look(style: str | None, size: tuple[float, float] | None) -> dict[Any, Any]:
    """Return the settings of the figures: ours, but for those of a style."""
    look = dict(LOOK)
    if style is not None:
        look = {}
    if size is not None:
        look["figure.figsize"] = size
    return look


def _save(draw: Callable[[Tables], Figure], tables: Tables, paths: list[Path]) -> None:
    """Draw a figure in the size that is chosen, if any, and save it."""
    size = chosen_size()
    if size is None:
        save_figure(draw(tables), paths)
        return

    def drawn(size: tuple[float, float]) -> Figure:
        with mpl.rc_context({"figure.figsize": size}), sized(size):
            figure = draw(tables)
            separate_ticks(figure)
        check_panels(figure, size)
        return figure

    save_figure(with_room(drawn, size), paths)


def tally(claims: Sequence[dict[str, Any]]) -> str:
    """Return the number of claims by verdict, as text."""
    counts = Counter(claim["verdict"] for claim in claims)
    return ", ".join(
        f"{counts[verdict]} {verdict}" for verdict in VERDICTS if counts[verdict]
    )


def verdict_table(claims: Sequence[dict[str, Any]]) -> str:
    """Return the claims and the measurements as text for a terminal."""
    lines = []
    for claim in claims:
        verdict = (
            f"{claim['verdict']} ({claim['held']} of {claim['checks']}): "
            f"{claim['words']}"
        )
        measured = f"found: {claim['measured']}"
        for key, text in ((claim["id"], verdict), ("", measured)):
            lines.append(f"{key:<4} {shorten(text, 105, placeholder=' ...')}")
    return "\n".join(lines)
