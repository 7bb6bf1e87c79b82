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
from markupsafe import Markup

from rattlesweep.analysis.pages import config_yaml, render, source
from rattlesweep.paper.claim import COLUMNS, UNDECIDED
from rattlesweep.paper.workspace import FULL, Part, Tables, Workspace, records, sweep_config
from rattlesweep.sweeps.files import replace_file
from rattlesweep.sweeps.provenance import PACKAGES, machine, now, package_version

TITLE = "Rattleback dynamics and its reversal time of rotation: recomputed"
VERDICTS = ("agree", "partly", "disagree", UNDECIDED)

# The paper's symbols in plain spelling, such as ``abs(omega_xy0)`` and ``->``, and in HTML.
GREEK = {
    "alpha": "α", "beta": "β", "gamma": "γ", "theta": "θ", "phi": "φ", "xi": "ξ", "sigma": "σ",
    "omega": "ω", "psi": "ψ", "delta": "δ", "epsilon": "ε",
}  # fmt: skip
SIGNS = {
    "-&gt;": "→", "&lt;=": "≤", "&gt;=": "≥", "&lt;~": "≲", "&gt;~": "≳", "&lt;&lt;": "≪",
    "&gt;&gt;": "≫", " ~ ": " ≈ ", " +- ": " ± ", "omega~": "ω̃", "t~": "t̃", "^deg": "°",
    "F_perp": "F_⊥", "F_parallel": "F_∥",
}  # fmt: skip
# The label of an equation in the paper's source, behind its number.
LABEL = re.compile(r"(\(\d+\)) \[[\w-]+\]")
# A file's name is no symbol.
INDEXED = re.compile(
    r"(?<![\w.])(omega|psi|delta|[CEFIJKnut])_(rGH[+-]|[⊥∥]|(?:rGH|I|[a-z]+\d?|\d)\b)(?![.]?\w)"
)
LETTER = re.compile(r"(?<![\w.-])(" + "|".join(GREEK) + r")(?![\w.])")


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
    replace_file(directory / "claims.md", markdown(done).encode())
    replace_file(directory / "report.html", page(done))


def markdown(done: Reproduction) -> str:
    """Return the claims as a page of the documentation."""
    sizes = "the paper's own numbers of samples" if done.workspace.sizes == FULL else "--quick"
    lines = [
        "# The paper's claims and what was measured",
        "",
        "This page is `out/paper/claims.md`, as `rattlesweep paper` writes it, copied:",
        "`rattlesweep paper && cp out/paper/claims.md benchmarks/claims.md`.",
        "[The paper, reproduced](../docs/paper.md) says how each verdict is made.",
        "",
        f"{len(done.claims)} claims: {tally(done.claims)}. Made with {sizes}, by rattlesweep "
        f"{package_version()}.",
        "Text between quotation marks is the paper's own. Units are M = a = g = 1, intervals 95 %.",
        "",
        "| | verdict | the paper says | measured |",
        "|---|---|---|---|",
    ]
    for claim in done.claims:
        verdict = f"{claim['verdict']}, {claim['held']} of {claim['checks']} checks"
        cells = (claim["id"], verdict, f"{claim['words']} ({claim['where']})", claim["measured"])
        lines.append("| " + " | ".join(escape(plain(c), quote=False) for c in cells) + " |")
    return "\n".join(lines) + "\n"


def page(done: Reproduction) -> bytes:
    """Return the report; its pictures are those in the directory."""
    ws, made = done.workspace, done.tables
    drawn = [name for name, part in done.parts.items() if part.draw is not None]
    rk4 = records(made["rk4"]["runs"]) if "rk4" in made else []
    contact = [
        [f"{n_i:g}", f"{size:g}", *map("{:.1%}".format, shares)]
        for n_i, size, *shares in (made["contact"]["shares"].values if "contact" in made else ())
    ]
    shown = {
        "claims": ("Claims", done.claims),
        "figures": ("Figures", drawn),
        "contact": ("Friction that rolling needs", contact),
        "rk4": ("The paper's integrator", rk4),
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
        symbols=symbols,
        figures=[
            (name, done.parts[name], list(made[name]), source(*(
                (ws.directory / f"{name}.{kind}").read_bytes() for kind in ("svg", "png")
            )))
            for name in drawn
        ],
        contact=contact,
        rk4=rk4,
        changed=sum(row["type"] != row["type_rk4"] for row in rk4),
        odd=[odd_row(row) for row in rk4 if isinstance(row["type_reference"], str)],
        failed=ws.failed,
        parts=[(name, f"{seconds:.1f} s") for name, seconds in done.seconds.items()],
        settings=config_yaml(settings),
    )  # fmt: skip


def odd_row(row: dict[str, Any]) -> list[str]:
    """Return the cells of a run on which the sweep and the paper's integrator differ."""
    launch = [f"{row[name]:g}" for name in ("K_r", "n_i", "omega_xy0", "sample")]
    return launch + [
        f"{row[f'type{end}']}" + ("" if pd.isna(row[f"t_r{end}"]) else f", {row[f't_r{end}']:.4f}")
        for end in ("", "_rk4", "_reference")
    ]


def symbols(text: str) -> Markup:
    """Return escaped text with its symbols set as such."""
    text = escape(plain(text), quote=False)
    for spelt, sign in SIGNS.items():
        text = text.replace(spelt, sign)
    text = re.sub(r"\babs\(([^()]*)\)", r"|\1|", text)
    text = re.sub(r"(?<![\w|])omega_xy0\b", "|ω<sub>xy0</sub>|", text)
    text = INDEXED.sub(lambda m: f"<i>{GREEK.get(m[1], m[1])}</i><sub>{m[2]}</sub>", text)
    text = LETTER.sub(lambda m: f"<i>{GREEK[m[1]]}</i>", text)
    return Markup(re.sub(r"\^([+-]?\d+(?:/\d+)?)", r"<sup>\1</sup>", text))
