"""The claims as a table and the report: one page with figures, claims, settings and timings."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path
from textwrap import shorten
from typing import Any

import pyarrow.parquet as pq
from markupsafe import Markup

from rattlesweep.analysis.pages import config_yaml, render, source
from rattlesweep.paper.claims.claim import CLAIMS
from rattlesweep.paper.columns import table
from rattlesweep.paper.registry import FIGURES
from rattlesweep.sweeps.arrow import encode
from rattlesweep.sweeps.files import replace_file

TITLE = "Rattleback dynamics and its reversal time of rotation: recomputed"
VERDICTS = ("agree", "partly", "disagree")

# The paper's symbols in plain spelling, such as ``abs(omega_xy0)`` and ``->``, and in HTML.
GREEK = {
    "alpha": "α", "beta": "β", "gamma": "γ", "theta": "θ", "phi": "φ", "xi": "ξ",
    "omega": "ω", "psi": "ψ", "delta": "δ", "epsilon": "ε",
}  # fmt: skip
SIGNS = {
    "-&gt;": "→",
    "&lt;=": "≤",
    "&gt;=": "≥",
    "&lt;~": "≲",
    "&gt;~": "≳",
    "&lt;&lt;": "≪",
    "&gt;&gt;": "≫",
    " ~ ": " ≈ ",
    " +- ": " ± ",
    "omega~": "ω̃",
    "t~": "t̃",
    "^deg": "°",
    "F_perp": "F_⊥",
    "F_parallel": "F_∥",
}
_ABSOLUTE = re.compile(r"\babs\(([^()]*)\)")
# A file's name is no symbol.
_INDEXED = re.compile(
    r"(?<![\w.])(omega|psi|delta|[CEFIJKnut])_(rGH[+-]|[⊥∥]|(?:rGH|I|[a-z]+\d?|\d)\b)(?![.]?\w)"
)
_LETTER = re.compile(r"(?<![\w.-])(" + "|".join(GREEK) + r")(?![\w.])")
_POWER = re.compile(r"\^([+-]?\d+(?:/\d+)?)")
_SIZE = re.compile(r"(?<![\w|])omega_xy0\b")


@dataclass
class Reproduction:
    """What the command came to."""

    directory: Path
    claims: list[dict[str, Any]]
    seconds: dict[str, float]
    kept: list[str]
    failed: int
    record: dict[str, Any]


def tally(claims: Sequence[dict[str, Any]]) -> str:
    """How many claims of each verdict there are."""
    counts = Counter(claim["verdict"] for claim in claims)
    return ", ".join(f"{counts[verdict]} {verdict}" for verdict in VERDICTS if counts[verdict])


def closing_table(claims: Sequence[dict[str, Any]]) -> str:
    """The claims as text for a terminal: id, verdict, checks that hold, the measured figure."""
    return "\n".join(
        f"{claim['id']:<3}  {claim['verdict']:<8}  {claim['held']} of {claim['checks']:<2}  "
        f"{shorten(claim['measured'], 68, placeholder=' ...')}"
        for claim in claims
    )


def write_report(done: Reproduction, figures: Sequence[str]) -> None:
    """Write ``claims.parquet`` and ``report.html``, each in one step."""
    replace_file(done.directory / "claims.parquet", encode(table(done.claims, CLAIMS)))
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


def symbols(text: str) -> Markup:
    """Escaped text with its symbols set as such."""
    text = escape(text, quote=False)
    for plain, sign in SIGNS.items():
        text = text.replace(plain, sign)
    text = _ABSOLUTE.sub(r"|\1|", text)
    text = _SIZE.sub("|ω<sub>xy0</sub>|", text)
    text = _INDEXED.sub(lambda m: f"<i>{GREEK.get(m[1], m[1])}</i><sub>{m[2]}</sub>", text)
    text = _LETTER.sub(lambda m: f"<i>{GREEK[m[1]]}</i>", text)
    return Markup(_POWER.sub(r"<sup>\1</sup>", text))
