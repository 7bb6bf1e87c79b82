"""The claims as a table and the report: one page with figures, claims, settings and timings."""

from __future__ import annotations

import json
import math
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pyarrow as pa
import pyarrow.parquet as pq

from rattlesweep.paper.registry import FIGURES
from rattlesweep.paper.symbols import symbols
from rattlesweep.study.html import (
    Html,
    code,
    join,
    key,
    mark,
    markup,
    number,
    page,
    paragraph,
    picture,
    table,
)
from rattlesweep.sweeps.store.atomic import replace_file
from rattlesweep.sweeps.tables.arrow import encode

if TYPE_CHECKING:
    from collections.abc import Sequence

    from rattlesweep.paper.claims.claim import Judgement

TITLE = "Rattleback dynamics and its reversal time of rotation: recomputed"
VERDICTS = ("agree", "partly", "disagree")
_DESCRIPTIONS = {
    "id": "T: theory, G: the body GH, U: unsteady direction, S: steady, L: long runs",
    "where": "place in the paper",
    "words": "what the paper says; word for word between quotation marks",
    "measured": "what was found",
    "value": "the figure that decides, where there is one",
    "low": "lower end of its 95 % confidence interval, or of its range",
    "high": "upper end of the same",
    "verdict": "agree: all checks hold; disagree: the headline fails; partly: another one does, or "
    "the headline at one in ten at most where the paper's words leave room",
    "held": "number of checks that hold",
    "checks": "number of checks",
    "headline": "the check without which nothing is left of the claim",
    "evidence": "all checks, and how they were made",
}
_TYPES = {"value": pa.float64(), "low": pa.float64(), "high": pa.float64(),
          "held": pa.int64(), "checks": pa.int64()}  # fmt: skip


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
    schema = pa.schema(
        [
            pa.field(
                name,
                kind := _TYPES.get(name, pa.string()),
                nullable=pa.types.is_floating(kind),
                metadata={"unit": "", "description": words},
            )
            for name, words in _DESCRIPTIONS.items()
        ]
    )
    rows = [{name: _plain(getattr(claim, name)) for name in _DESCRIPTIONS} for claim in claims]
    return pa.Table.from_pylist(rows, schema=schema)


def _plain(value: Any) -> Any:
    return None if isinstance(value, float) and not math.isfinite(value) else value


def tally(claims: Sequence[Judgement]) -> str:
    """How many claims of each verdict there are."""
    counts: Counter[str] = Counter(claim.verdict for claim in claims)
    return ", ".join(f"{counts[word]} {word}" for word in VERDICTS if counts[word])


def closing_table(claims: Sequence[Judgement]) -> str:
    """The claims as text for a terminal: id, verdict, checks that hold, the measured figure."""
    lines = []
    for claim in claims:
        measured = claim.measured
        short = measured if len(measured) <= 68 else measured[:65].rsplit(" ", 1)[0] + " ..."
        lines.append(f"{claim.id:<3}  {claim.verdict:<8}  {claim.score:<7}  {short}")
    return "\n".join(lines)


def write_report(outcome: Reproduction, figures: Sequence[str]) -> None:
    """Write ``claims.parquet`` and ``report.html``, each in one step.

    Raises
    ------
    OutputError
        If a file cannot be written.
    """
    directory = outcome.directory
    replace_file(directory / "claims.parquet", encode(claims_table(outcome.claims)))
    replace_file(directory / "report.html", report(outcome, figures))


def report(outcome: Reproduction, figures: Sequence[str]) -> bytes:
    """The page; its pictures are those in the directory."""
    sections = []
    if outcome.claims:
        sections.append(("claims", "Claims", _claims(outcome.claims)))
    if figures:
        shown = join(_picture(outcome, name) for name in figures)
        sections.append(("figures", "Figures", shown))
    if "fig6" in figures:
        sections.append(("rk4", "The paper's integrator", _rk4(outcome)))
    sections.append(("run", "How it was made", _facts(outcome)))
    sections.append(("settings", "Settings", _settings(outcome.record)))
    return page(TITLE, _head(outcome), sections)


def _head(outcome: Reproduction) -> list[Html]:
    record = outcome.record
    reduced = " Reduced sample counts (--quick): intervals are wide." if record["quick"] else ""
    return [
        paragraph(
            "Every figure and every claim of Y. Kondo and H. Nakanishi, ",
            Html("<em>Rattleback dynamics and its reversal time of rotation</em>"),
            ", Phys. Rev. E 95, 062207 (2017), recomputed. Units are M = a = g = 1: times in "
            "√(a/g), spins in √(g/a). A positive spin is the unsteady direction.",
        ),
        paragraph(
            f"{len(outcome.claims)} claims: {tally(outcome.claims)}.{reduced} rattlesweep "
            f"{record['versions']['rattlesweep']}, {record['finished']}.",
            kind="soft small",
        ),
    ]


def _claims(claims: Sequence[Judgement]) -> Html:
    rows = [
        (
            Html(
                f'<td class="key">{markup(claim.id)}<br>{mark(claim.verdict).text}<br>'
                f'<span class="soft small">{claim.score} checks</span></td>'
            ),
            Html(
                f"{symbols(claim.words).text}<br>"
                f'<span class="soft small">{markup(claim.where)}</span>'
            ),
            Html(
                f"{symbols(claim.measured).text}"
                f'<p class="soft small">{symbols(claim.evidence).text}</p>'
            ),
        )
        for claim in claims
    ]
    return join(
        [
            paragraph(
                "Each verdict follows from the checks in small print, the first of which is the "
                "headline of the claim. Agree: all checks hold; disagree: the headline fails; "
                "partly: the headline holds, but not every check, or it fails for one point or run "
                "in ten at most where the paper's own words leave room (“almost”, “roughly”). What "
                "stands between quotation marks is the paper's own wording; equations have their "
                "printed numbers and, in brackets, their labels in its source. Intervals are 95 %."
            ),
            table(("", "The paper says", "Measured"), rows, stack=True),
        ]
    )


def _picture(outcome: Reproduction, name: str) -> Html:
    figure = FIGURES[name]
    svg = (outcome.directory / f"{name}.svg").read_bytes()
    png = (outcome.directory / f"{name}.png").read_bytes()
    entry = outcome.record["figures"][name]["tables"]
    files = ", ".join(f"{name}_{each}.parquet" for each in entry)
    caption = Html(
        f"<b>{markup(figure.title)}.</b> {symbols(figure.caption).text} "
        f'<span class="small">Data: {markup(files)}.</span>'
    )
    return picture(svg, png, figure.title, caption)


def _rk4(outcome: Reproduction) -> Html:
    """The runs of Fig. 6 whose outcome differs with RK4, one by one."""
    rows = pq.read_table(outcome.directory / "fig6_rk4.parquet").to_pylist()
    changed = sum(row["type"] != row["type_rk4"] for row in rows)
    odd = [row for row in rows if row["exception"]]
    names = ("K_r", "n_i", "omega_xy0", "sample", "t_r", "with RK4", "at tol 1e-12", "cause")
    text = paragraph(
        f"{len(rows)} runs of Fig. 6 were repeated with fourth-order Runge-Kutta and the paper's "
        f"time step: {changed} change type; in {len(odd)} the type or the time of reversal differs "
        "(the latter by more than 1e-6). Those were integrated a third time, at a tolerance of "
        "1e-12: where this agrees with RK4, the sweep's tolerance is the cause; where it agrees "
        "with the sweep, RK4's step is; where it agrees with neither, the run is chaotic and "
        "rounding decides."
    )
    if not odd:
        return text
    cells = [
        [
            *(number(f"{row[name]:g}") for name in ("K_r", "n_i", "omega_xy0", "sample")),
            number(_type_or_time(row["type"], row["t_r"])),
            number(_type_or_time(row["type_rk4"], row["t_r_rk4"])),
            number(f"{row['t_r_reference']:.4f}" if row["t_r_reference"] is not None else ""),
            row["exception"].partition(":")[0],
        ]
        for row in odd
    ]
    return join([text, table(names, cells)])


def _type_or_time(kind: str | None, t_r: float | None) -> str:
    return f"{t_r:.4f}" if t_r is not None else (kind or "failed")


def _facts(outcome: Reproduction) -> Html:
    record = outcome.record
    here = record["machine"]
    kept = set(outcome.kept)
    rows = [
        (key(name), number(f"{seconds:.1f} s"), "kept from an earlier call" if name in kept else "")
        for name, seconds in outcome.seconds.items()
    ]
    total = sum(outcome.seconds.values())
    versions = ", ".join(f"{name} {text}" for name, text in record["versions"].items())
    return join(
        [
            paragraph(
                f"{here['cpu']}, {here['processors']} processors, {here['system']}; "
                f"{record['threads']} threads. {versions}."
            ),
            paragraph(
                f"{outcome.failed} runs of the sweeps have a status other than ok."
                if outcome.failed
                else "Every run of the sweeps has the status ok."
            ),
            table(("part", "time", ""), [*rows, (key("total"), number(f"{total:.1f} s"), "")]),
        ]
    )


def _settings(record: dict[str, Any]) -> Html:
    return code(_indented(record["settings"]))


def _indented(value: Any) -> str:
    """JSON with lists of numbers on one line."""
    text = json.dumps(value, indent=2, ensure_ascii=False)
    out: list[str] = []
    depth = 0
    for line in text.split("\n"):
        bare = line.strip()
        if depth:
            out[-1] += bare if bare.startswith("]") else bare + (" " if bare.endswith(",") else "")
            depth -= bare.startswith("]")
        else:
            out.append(line)
            depth += bare.endswith("[")
    return "\n".join(out)
