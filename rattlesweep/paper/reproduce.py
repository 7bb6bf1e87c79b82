"""Make figures and supplements one after another, judge the claims, write the report."""

from __future__ import annotations

import io
import time
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from importlib.metadata import version
from textwrap import shorten
from typing import Any

import matplotlib as mpl
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

from rattlesweep.analysis.report import config_yaml, render, source
from rattlesweep.analysis.style import encode, styled
from rattlesweep.errors import ConfigError
from rattlesweep.paper.claim import COLUMNS, UNDECIDED, judge, read_table
from rattlesweep.paper.workspace import FULL, LOOK, Tables, Workspace, sweep_config
from rattlesweep.sweeps.config.messages import not_one_of
from rattlesweep.sweeps.files import replace_file
from rattlesweep.sweeps.provenance import machine, now, package_version, versions

# The claims about formulas alone go by this name where parts are chosen.
THEORY = "theory"
KINDS, DPI = ("svg", "png"), 150
VERDICTS = ("agree", "partly", "disagree", UNDECIDED)


def choose(names: str | None) -> list[str]:
    """Return the parts that were asked for, such as ``fig8,fig7``, in the paper's order, or all."""
    known = [*read_table("parts"), THEORY]
    wanted = known if names is None else [word.strip() for word in names.split(",")]
    if unknown := [word for word in wanted if word not in known]:
        raise ConfigError(f"--only: {not_one_of(unknown[0], known)}")
    return [name for name in known if name in wanted]


def reproduce(
    workspace: Workspace, names: Sequence[str], begin: Callable[[str], None] = lambda title: None
) -> list[dict[str, Any]]:
    """Compute and draw what was asked for, report, and return the claims that this can settle.

    `names` are those of ``parts.yaml``, and perhaps ``theory``; `begin` is called with the title of
    each part before it is made.  Raises a ConfigError if the directory holds other sweeps.
    """
    parts = {name: part for name, part in read_table("parts").items() if name in names}
    made: dict[str, Tables] = {}
    seconds: dict[str, float] = {}
    for name, part in parts.items():
        begin(part["title"])
        start = time.perf_counter()
        tables = made[name] = part["data"](workspace)
        for table, rows in tables.items():
            found = pa.Table.from_pandas(rows, preserve_index=False).replace_schema_metadata()
            buffer = io.BytesIO()
            pq.write_table(found, buffer, write_page_checksum=True)
            replace_file(workspace.directory / f"{name}_{table}.parquet", buffer.getvalue())
        if "draw" in part:
            with styled(), mpl.rc_context(LOOK):
                drawing = part["draw"](tables)
                for kind in KINDS:
                    image = encode(drawing, kind, DPI)
                    replace_file(workspace.directory / f"{name}.{kind}", image)
        seconds[name] = time.perf_counter() - start
    few = workspace.sizes.samples < FULL.samples
    claims = judge(made, theory=THEORY in names, few=few)
    write_report(workspace, parts, made, claims, seconds)
    return claims


def write_report(
    workspace: Workspace, parts: Mapping[str, Any], made: Mapping[str, Tables],
    claims: list[dict[str, Any]], seconds: Mapping[str, float],
) -> None:  # fmt: skip
    """Write ``claims.parquet``, ``claims.md`` and ``report.html``, each in one step."""
    directory, sizes = workspace.directory, workspace.sizes
    words = {"claims": claims, "tally": tally(claims), "quick": sizes != FULL}
    table = pd.DataFrame(claims, columns=COLUMNS).to_parquet(index=False)
    replace_file(directory / "claims.parquet", table)
    page = render("claims.md.j2", version=package_version(), **words)
    replace_file(directory / "claims.md", page)
    figures = [
        (name, part, list(made[name]),
         source(*((directory / f"{name}.{kind}").read_bytes() for kind in KINDS)))
        for name, part in parts.items() if "draw" in part
    ]  # fmt: skip
    sections = {"claims": "Claims"} if claims else {}
    sections |= {"figures": "Figures"} if figures else {}
    sections |= {"run": "How it was made", "settings": "Settings"}
    sweeps = [name for name in ("unsteady", "steady") if (directory / "sweeps" / name).exists()]
    page = render(
        "paper.html.j2",
        title="Rattleback dynamics and its reversal time of rotation: recomputed",
        sections=[*sections.items()],
        finished=now(),
        versions=versions() | {"matplotlib": version("matplotlib")},
        machine=machine(),
        figures=figures,
        failed=workspace.failed,
        parts=[(name, f"{time:.1f} s") for name, time in seconds.items()],
        settings=config_yaml(asdict(sizes) | {name: sweep_config(name, sizes) for name in sweeps}),
        **words,
    )
    replace_file(directory / "report.html", page)


def tally(claims: Sequence[Mapping[str, Any]]) -> str:
    """Return how many claims of each verdict there are."""
    counts = Counter(claim["verdict"] for claim in claims)
    return ", ".join(f"{counts[verdict]} {verdict}" for verdict in VERDICTS if counts[verdict])


def closing_table(claims: Sequence[Mapping[str, Any]]) -> str:
    """Return the claims as text for a terminal, with what is claimed and what was measured."""
    lines = []
    for claim in claims:
        says = f"{claim['verdict']} ({claim['held']} of {claim['checks']}): {claim['words']}"
        lines.append(f"{claim['id']:<4} {shorten(says, 105, placeholder=' ...')}")
        found = shorten(f"found: {claim['measured']}", 105, placeholder=" ...")
        lines.append(f"     {found}")
    return "\n".join(lines)
