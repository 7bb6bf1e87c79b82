"""The claims as tables, and the report: one page with figures, claims, settings and timings."""

from __future__ import annotations

import platform
import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from html import escape
from importlib.metadata import version
from textwrap import shorten
from typing import Any

import pandas as pd

from rattlesweep.analysis.report import config_yaml, render, source
from rattlesweep.paper.claim import COLUMNS, UNDECIDED
from rattlesweep.paper.workspace import FULL, Part, Tables, Workspace, sweep_config
from rattlesweep.sweeps.files import replace_file
from rattlesweep.sweeps.provenance import PACKAGES, machine, now, package_version

TITLE = "Rattleback dynamics and its reversal time of rotation: recomputed"
VERDICTS = ("agree", "partly", "disagree", UNDECIDED)

# The label of an equation in the paper's source, behind its number.
LABEL = re.compile(r"(\(\d+\)) \[[\w-]+\]")


@dataclass
class Reproduction:
    """Parts that were asked for, their tables and seconds by name, and verdicts on the claims."""

    workspace: Workspace
    parts: dict[str, Part]
    tables: dict[str, Tables] = field(default_factory=dict)
    claims: list[dict[str, Any]] = field(default_factory=list)
    seconds: dict[str, float] = field(default_factory=dict)


def tally(claims: Sequence[dict[str, Any]]) -> str:
    """Return how many claims of each verdict there are."""
    counts = Counter(claim["verdict"] for claim in claims)
    return ", ".join(f"{counts[verdict]} {verdict}" for verdict in VERDICTS if counts[verdict])


def closing_table(claims: Sequence[dict[str, Any]]) -> str:
    """Return the claims as text for a terminal, with what is claimed and what was measured."""
    lines = []
    for claim in claims:
        held = f"{claim['held']} of {claim['checks']}"
        says = f"{claim['verdict']} ({held}): {plain(claim['words'])}"
        lines.append(f"{claim['id']:<4} {shorten(says, 105, placeholder=' ...')}")
        found = shorten(f"found: {plain(claim['measured'])}", 105, placeholder=" ...")
        lines.append(f"     {found}")
    return "\n".join(lines)


def plain(text: str) -> str:
    """Return a text without the labels of equations."""
    return LABEL.sub(r"\1", text)


def write_report(done: Reproduction) -> None:
    """Write ``claims.parquet``, ``claims.md`` and ``report.html``, each in one step."""
    directory = done.workspace.directory
    claims = pd.DataFrame(done.claims, columns=COLUMNS)
    replace_file(directory / "claims.parquet", claims.to_parquet(index=False))
    words = render(
        "claims.md.j2",
        claims=done.claims,
        tally=tally(done.claims),
        quick=done.workspace.sizes != FULL,
        package_version=package_version(),
        plain=lambda text: escape(plain(text), quote=False),
    )
    replace_file(directory / "claims.md", words)
    replace_file(directory / "report.html", page(done))


def page(done: Reproduction) -> bytes:
    """Return the report; its pictures are those in the directory."""
    ws, made = done.workspace, done.tables
    drawn = [name for name, part in done.parts.items() if part.draw is not None]
    shown = {
        "claims": ("Claims", done.claims),
        "figures": ("Figures", drawn),
        "run": ("How it was made", True),
        "settings": ("Settings", True),
    }
    sweeps = [name for name in ("unsteady", "steady") if (ws.directory / "sweeps" / name).exists()]
    settings = asdict(ws.sizes) | {name: sweep_config(name, ws.sizes) for name in sweeps}
    return render(
        "paper.html.j2",
        title=TITLE,
        sections=[(name, words) for name, (words, there) in shown.items() if there],
        quick=ws.sizes != FULL,
        finished=now(),
        versions={
            "rattlesweep": package_version(),
            "python": platform.python_version(),
            **{name: version(name) for name in (*PACKAGES, "matplotlib")},
        },
        machine=machine(),
        claims=done.claims,
        tally=tally(done.claims),
        plain=plain,
        figures=[
            (name, done.parts[name], list(made[name]), source(*(
                (ws.directory / f"{name}.{kind}").read_bytes() for kind in ("svg", "png")
            )))
            for name in drawn
        ],
        failed=ws.failed,
        parts=[(name, f"{seconds:.1f} s") for name, seconds in done.seconds.items()],
        settings=config_yaml(settings),
    )  # fmt: skip
