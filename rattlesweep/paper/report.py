"""The claims as a table and the report: one page with figures, claims, settings and timings."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from textwrap import shorten
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from rattlesweep.paper.claims.claim import Judgement
from rattlesweep.paper.columns import count, number, schema, table, word
from rattlesweep.paper.registry import FIGURES
from rattlesweep.paper.symbols import symbols
from rattlesweep.study.pages import config_yaml, render, source
from rattlesweep.sweeps.store.atomic import replace_file
from rattlesweep.sweeps.tables.arrow import encode

TITLE = "Rattleback dynamics and its reversal time of rotation: recomputed"
VERDICTS = ("agree", "partly", "disagree")
CLAIMS = schema(
    "",
    word("id", "T: theory, G: the body GH, U: unsteady direction, S: steady, L: long runs"),
    word("where", "place in the paper"),
    word("words", "what the paper says; word for word between quotation marks"),
    word("measured", "what was found"),
    number("value", "the figure that decides, where there is one"),
    number("low", "lower end of its 95 % confidence interval, or of its range"),
    number("high", "upper end of the same"),
    word("verdict", "agree: all checks hold; disagree: the headline fails; partly: another one "
         "does, or the headline at one in ten at most where the paper's words leave room"),
    count("held", "number of checks that hold"),
    count("checks", "number of checks"),
    word("headline", "the check without which nothing is left of the claim"),
    word("evidence", "all checks, and how they were made"),
)  # fmt: skip


@dataclass
class Reproduction:
    """What the command came to."""

    directory: Path
    claims: list[Judgement]
    seconds: dict[str, float]
    kept: list[str]
    failed: int
    record: dict[str, Any]


def claims_table(claims: Sequence[Judgement]) -> pa.Table:
    """The claims as they are stored in ``claims.parquet``."""
    rows = [{name: _finite(getattr(claim, name)) for name in CLAIMS.names} for claim in claims]
    return table(rows, CLAIMS)


def _finite(value: Any) -> Any:
    return None if isinstance(value, float) and not math.isfinite(value) else value


def tally(claims: Sequence[Judgement]) -> str:
    """How many claims of each verdict there are."""
    counts: Counter[str] = Counter(claim.verdict for claim in claims)
    return ", ".join(f"{counts[verdict]} {verdict}" for verdict in VERDICTS if counts[verdict])


def closing_table(claims: Sequence[Judgement]) -> str:
    """The claims as text for a terminal: id, verdict, checks that hold, the measured figure."""
    return "\n".join(
        f"{claim.id:<3}  {claim.verdict:<8}  {claim.score:<7}  "
        f"{shorten(claim.measured, 68, placeholder=' ...')}"
        for claim in claims
    )


def write_report(done: Reproduction, figures: Sequence[str]) -> None:
    """Write ``claims.parquet`` and ``report.html``, each in one step."""
    replace_file(done.directory / "claims.parquet", encode(claims_table(done.claims)))
    replace_file(done.directory / "report.html", page(done, figures))


def page(done: Reproduction, figures: Sequence[str]) -> bytes:
    """The page; its pictures are those in the directory."""
    rk4 = []
    if "fig6" in figures:
        rk4 = pq.read_table(done.directory / "fig6_rk4.parquet").to_pylist()
    parts = [
        (name, f"{seconds:.1f} s", "kept from an earlier call" if name in done.kept else "")
        for name, seconds in done.seconds.items()
    ]
    shown = {
        "claims": ("Claims", done.claims),
        "figures": ("Figures", figures),
        "rk4": ("The paper's integrator", "fig6" in figures),
        "run": ("How it was made", True),
        "settings": ("Settings", True),
    }
    return render(
        "paper.html.j2",
        title=TITLE,
        sections=[(name, words) for name, (words, there) in shown.items() if there],
        record=done.record,
        claims=done.claims,
        tally=tally(done.claims),
        symbols=symbols,
        figures=[(name, FIGURES[name], _address(done.directory / name)) for name in figures],
        rk4=rk4,
        changed=sum(row["type"] != row["type_rk4"] for row in rk4),
        odd=[_odd(row) for row in rk4 if row["exception"]],
        failed=done.failed,
        parts=[*parts, ("total", f"{sum(done.seconds.values()):.1f} s", "")],
        settings=config_yaml(done.record["settings"]),
    )


def _address(picture: Path) -> str:
    return source(*(picture.with_suffix(kind).read_bytes() for kind in (".svg", ".png")))


def _odd(row: dict[str, Any]) -> list[str]:
    def outcome(suffix: str) -> str:
        t_r, kind = row[f"t_r{suffix}"], row.get(f"type{suffix}", "")
        return f"{t_r:.4f}" if t_r is not None else (kind or "failed")

    launch = [f"{row[name]:g}" for name in ("K_r", "n_i", "omega_xy0", "sample")]
    reference = "" if row["t_r_reference"] is None else f"{row['t_r_reference']:.4f}"
    cause = row["exception"].partition(":")[0]
    return [*launch, outcome(""), outcome("_rk4"), reference, cause]
