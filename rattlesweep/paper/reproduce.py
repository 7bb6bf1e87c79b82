"""Make the figures and supplements, judge the claims, and write the report."""

import time
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import asdict
from importlib.metadata import version
from textwrap import shorten
from typing import Any

import matplotlib as mpl
import pandas as pd

from rattlesweep.analysis.report import config_yaml, embedded, render
from rattlesweep.analysis.style import FAINT, save, save_table, styled
from rattlesweep.api.arrays import check_names
from rattlesweep.paper.claim import UNDECIDED, judge, read_table
from rattlesweep.paper.workspace import FULL, Tables, Workspace, sweep_config
from rattlesweep.sweeps.files import replace_file
from rattlesweep.sweeps.provenance import machine, now, versions

# The name that selects the claims about formulas alone.
THEORY = "theory"
KINDS = ("svg", "png")
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


def choose(names: str | None) -> list[str]:
    """Return parts, such as ``fig8,fig7``, in the paper's order; None selects all."""
    known = [*read_table("parts"), THEORY]
    if names is None:
        return known
    wanted = [name.strip() for name in names.split(",")]
    check_names("--only", wanted, known)
    return [name for name in known if name in wanted]


def reproduce(
    workspace: Workspace,
    names: Sequence[str],
    begin: Callable[[str], None] = lambda title: None,
) -> list[dict[str, Any]]:
    """Compute and draw parts, write the report, and return the judged claims."""
    chosen = {name: part for name, part in read_table("parts").items() if name in names}
    directory = workspace.directory
    sizes = workspace.sizes
    tables: dict[str, Tables] = {}
    seconds = []
    figures = []
    for name, part in chosen.items():
        begin(part["title"])
        start = time.perf_counter()
        tables[name] = part["data"](workspace)
        for table, rows in tables[name].items():
            save_table(rows, directory / f"{name}_{table}.parquet")
        paths = [directory / f"{name}.{kind}" for kind in KINDS]
        with styled(), mpl.rc_context(LOOK):
            save(part["draw"](tables[name]), paths)
        seconds.append((name, f"{time.perf_counter() - start:.1f} s"))
        picture = embedded(*(path.read_bytes() for path in paths))
        figures.append((name, part, list(tables[name]), picture))

    claims = judge(tables, theory=THEORY in names, few=sizes.samples < FULL.samples)
    save_table(pd.DataFrame(claims), directory / "claims.parquet")
    verdicts = {"claims": claims, "tally": tally(claims), "quick": sizes != FULL}
    page = render("claims.md.j2", version=version("rattlesweep"), **verdicts)
    replace_file(directory / "claims.md", page)

    sections = [("claims", "Claims")]
    if figures:
        sections.append(("figures", "Figures"))
    sections += [("run", "How it was made"), ("settings", "Settings")]
    settings = asdict(sizes)
    for path in sorted(directory.glob("sweeps/*")):
        settings[path.name] = sweep_config(path.name, sizes)
    page = render(
        "paper.html.j2",
        title="Rattleback dynamics and its reversal time of rotation: recomputed",
        sections=sections,
        finished=now(),
        versions=versions() | {"matplotlib": version("matplotlib")},
        machine=machine(),
        figures=figures,
        failed=workspace.failed,
        parts=seconds,
        settings=config_yaml(settings),
        **verdicts,
    )
    replace_file(directory / "report.html", page)
    return claims


def tally(claims: Sequence[dict[str, Any]]) -> str:
    """Return the number of claims by verdict, as text."""
    counts = Counter(claim["verdict"] for claim in claims)
    return ", ".join(
        f"{counts[verdict]} {verdict}" for verdict in VERDICTS if counts[verdict]
    )


def closing_table(claims: Sequence[dict[str, Any]]) -> str:
    """Return the claims and the measurements as text for a terminal."""
    lines = []
    for claim in claims:
        verdict = f"{claim['verdict']} ({claim['held']} of {claim['checks']})"
        says = shorten(f"{verdict}: {claim['words']}", 105, placeholder=" ...")
        measured = shorten(f"found: {claim['measured']}", 105, placeholder=" ...")
        lines += [f"{claim['id']:<4} {says}", f"     {measured}"]
    return "\n".join(lines)
