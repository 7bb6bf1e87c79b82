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

from rattlesweep.analysis.report import config_yaml, render, source
from rattlesweep.paper.claim import COLUMNS, UNDECIDED
from rattlesweep.paper.workspace import FULL, Part, Tables, Workspace, sweep_config
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
    rk4 = made["rk4"]["runs"] if "rk4" in made else pd.DataFrame()
    contact = [
        [f"{n_i:g}", f"{size:g}", *map("{:.1%}".format, shares)]
        for n_i, size, *shares in (made["contact"]["shares"].values if "contact" in made else ())
    ]
    shown = {
        "claims": ("Claims", done.claims),
        "figures": ("Figures", drawn),
        "contact": ("Friction that rolling needs", contact),
        "rk4": ("The paper's integrator", len(rk4)),
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
        rk4=rk4_words(rk4) if len(rk4) else "",
        failed=ws.failed,
        parts=[(name, f"{seconds:.1f} s") for name, seconds in done.seconds.items()],
        settings=config_yaml(settings),
    )  # fmt: skip


def rk4_words(runs: pd.DataFrame) -> str:
    """Return how many runs differ with the paper's integrator, and by how much."""
    changed = (runs["type"] != runs["type_rk4"]).sum()
    off = runs["difference"].abs().quantile([0.5, 0.99])
    return (
        f"{len(runs)} runs of Fig. 7 were repeated with fourth-order Runge-Kutta and the paper's "
        f"time step: {changed} change type; the times of reversal differ by {off[0.5]:.1g} "
        f"(median) and by less than {off[0.99]:.1g} for 99 %, relatively."
    )


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
