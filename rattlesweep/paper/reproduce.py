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
    """Return the requested parts, such as ``fig8,fig7``, in the paper's order; None
    selects all.
    """
    known = [*read_table("parts"), THEORY]
    wanted = known if names is None else [word.strip() for word in names.split(",")]
    check_names("--only", wanted, known)
    return [name for name in known if name in wanted]


def reproduce(
    workspace: Workspace,
    names: Sequence[str],
    begin: Callable[[str], None] = lambda title: None,
) -> list[dict[str, Any]]:
    """Compute and draw parts, write the report, and return the claims that were
    judged.
    """
    parts = {name: part for name, part in read_table("parts").items() if name in names}
    directory, sizes = workspace.directory, workspace.sizes
    made: dict[str, Tables] = {}
    seconds = {}
    for name, part in parts.items():
        begin(part["title"])
        start = time.perf_counter()
        made[name] = part["data"](workspace)
        for table, rows in made[name].items():
            save_table(rows, directory / f"{name}_{table}.parquet")
        with styled(), mpl.rc_context(LOOK):
            save(
                part["draw"](made[name]),
                [directory / f"{name}.{kind}" for kind in KINDS],
            )
        seconds[name] = f"{time.perf_counter() - start:.1f} s"
    claims = judge(made, theory=THEORY in names, few=sizes.samples < FULL.samples)
    save_table(pd.DataFrame(claims), directory / "claims.parquet")
    words = {"claims": claims, "tally": tally(claims), "quick": sizes != FULL}
    page = render("claims.md.j2", version=version("rattlesweep"), **words)
    replace_file(directory / "claims.md", page)
    figures = [
        (
            name,
            part,
            list(made[name]),
            embedded(*((directory / f"{name}.{kind}").read_bytes() for kind in KINDS)),
        )
        for name, part in parts.items()
    ]
    middle = {"figures": "Figures"} if figures else {}
    sections = {
        "claims": "Claims",
        **middle,
        "run": "How it was made",
        "settings": "Settings",
    }
    sweeps = [path.name for path in sorted(directory.glob("sweeps/*"))]
    page = render(
        "paper.html.j2",
        title="Rattleback dynamics and its reversal time of rotation: recomputed",
        sections=[*sections.items()],
        finished=now(),
        versions=versions() | {"matplotlib": version("matplotlib")},
        machine=machine(),
        figures=figures,
        failed=workspace.failed,
        parts=[*seconds.items()],
        settings=config_yaml(
            asdict(sizes) | {name: sweep_config(name, sizes) for name in sweeps}
        ),
        **words,
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
        says = f"{claim['verdict']} ({claim['held']} of {claim['checks']}): {claim['words']}"
        for key, text in ((claim["id"], says), ("", f"found: {claim['measured']}")):
            lines.append(f"{key:<4} {shorten(text, 105, placeholder=' ...')}")
    return "\n".join(lines)
