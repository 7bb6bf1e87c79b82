"""Write a sweep on one self-contained page."""

from __future__ import annotations

import shlex
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pyarrow.compute as pc

from rattlesweep.analysis.pages import MOST_SVG, config_yaml, percent, render, source
from rattlesweep.analysis.plots.kinds import choose_picture, default_kind
from rattlesweep.analysis.plots.layout import Layout, read_layout
from rattlesweep.analysis.style import encode, styled
from rattlesweep.errors import ConfigError, OutputError
from rattlesweep.sweeps.config.read import resolved
from rattlesweep.sweeps.provenance import read_sessions
from rattlesweep.sweeps.status import status
from rattlesweep.sweeps.stored import Stored
from rattlesweep.sweeps.summary import absent_columns, count_cases, summary_table

DPI = 120
# Cases shown at once, and at all: each takes some 400 bytes.
OPEN_CASES, MOST_CASES, MOST_SESSIONS = 40, 2000, 200
RATE, TIME = "√(g/a)", "√(a/g)"
# Columns of `summary` that are shown, with their headings and formats.
CASE_COLUMNS = {
    "case": ("case", ",d"),
    "K_p": ("K_p", ".5g"),
    "K_r": ("K_r", ".5g"),
    "n_i": (f"n_i ({RATE})", ".5g"),
    "omega_xy0": (f"ω_xy0 ({RATE})", ".5g"),
    "sigma": ("σ (M a² √(g/a))", ".5g"),
    "rolling": ("rolling (a)", ".5g"),
    "runs": ("runs", ",d"),
    "fraction_R": ("R", ".3f"),
    "fraction_SS": ("SS", ".3f"),
    "fraction_SW": ("SW", ".3f"),
    "fraction_unclassified": ("unclassified", ".3f"),
    "fraction_D": ("D", ".3f"),
    "fraction_bondi": ("Bondi", ".3f"),
    "t_r_mean": (f"mean t_r ({TIME})", ".5g"),
    "t_r_std": (f"standard deviation of t_r ({TIME})", ".3g"),
    "t_r_mean_error": (f"mean error of t_r ({TIME})", ".3g"),
    "t_rgh_mean": (f"mean t_rGH ({TIME})", ".5g"),
    "t_r_over_t_rgh_mean": ("mean t_r/t_rGH", ".4f"),
    "t_r_over_t_rgh_sem": ("± error of the mean", ".2g"),
    "sensitive": ("sensitive", ",d"),
    "unsure": ("type not sure", ",d"),
    "share_friction_above_0_3": ("needs friction above 0.3", ".3g"),
    "share_friction_above_0_6": ("needs friction above 0.6", ".3g"),
    "share_lift_off": ("lifts off", ".3g"),
    "failed": ("failed", ",d"),
}


def make_report(directory: Path, title: str | None = None) -> bytes:
    """Return the page of a sweep, whole or still running: HTML that needs nothing else."""
    layout = read_layout(directory)
    stored, manifest, state = layout.stored, layout.stored.manifest, status(directory)
    runs = state.data["runs"]
    rows = stored.read(["case", "sample", "status", "n_steps"])
    steps = pc.sum(rows["n_steps"], min_count=0).as_py()
    failed = rows.filter(pc.not_equal(rows["status"], "ok")).to_pandas().groupby("status")
    counts = count_cases(stored)
    table = summary_table(stored.cases, counts)
    absent = {"K_p", "K_r"}.difference(layout.axes) | absent_columns(table)
    absent |= set() if counts.has_errors else {"t_r_mean_error"}
    columns = {name: how for name, how in CASE_COLUMNS.items() if name not in absent}
    sessions = read_sessions(directory)
    seconds, kernel = (
        sum(s.get(name) or 0.0 for s in sessions) for name in ("seconds", "kernel_seconds")
    )
    size = state.data["bytes"]
    return render(
        "sweep.html.j2",
        title=title or manifest["name"],
        complete=state.done,
        state=_how_far(state.data) if not state.done else "complete" + (
            f" ({state.decides} leaves out the others)" if state.decides else ""
        ),
        runs=runs,
        ok=state.data["status"].get("ok", 0),
        counts=counts,
        horizon=layout.config.horizon,
        pictures=[_shown(layout, kind) for kind in _kinds(layout)],
        case_head=[heading for heading, _ in columns.values()],
        cases=[
            [None if row[name] is None else format(row[name], form)
             for name, (_, form) in columns.items()]
            for row in table.to_pylist()
        ],
        open_cases=OPEN_CASES,
        most_cases=MOST_CASES,
        failures=[
            (word, f"{len(own):,}", percent(len(own), runs),
             f"case {own['case'].iloc[0]}, sample {own['sample'].iloc[0]}")
            for word, own in failed
        ],
        thresholds=_thresholds(stored),
        cost=[
            ("time of all sessions", f"{seconds:,.1f} s"),
            ("of it, integration", f"{kernel:,.1f} s"),
            ("accepted steps", f"{steps:,}"),
            ("size of the runs", f"{size / 1e6:,.1f} MB, {size / max(runs, 1):.0f} bytes a run"),
        ],
        config=config_yaml(resolved(layout.config)),
        provenance=[
            ("started", manifest.get("started")),
            ("command", shlex.join(manifest.get("command", []))),
            ("machine", _listed(manifest["machine"])),
            ("versions", _listed(manifest["versions"])),
            ("hash of the config", stored.hash),
        ],
        sessions=[
            [str(s.get("started"))[:19],
             *(s.get(name) for name in ("how", "shard", "host", "threads", "runs", "seconds"))]
            for s in sessions[-MOST_SESSIONS:]
        ],
    )  # fmt: skip


def _how_far(data: Mapping[str, Any]) -> str:
    how = "running" if data["at_work"] else "not complete"
    return f"{how}: {data['runs']:,} of {data['wanted']:,} runs are done"


def _thresholds(stored: Stored) -> dict[str, Any]:
    """Return the thresholds of the config and those behind the types on disk."""
    config, now = stored.config.classify.thresholds, stored.thresholds.thresholds
    sets = [f"--set classify.{key}={value!r}" for key, value in now.items() if value != config[key]]
    return {
        "rows": [(key, f"{config[key]:g}", f"{now[key]:g}") for key in now],
        "changed": bool(sets),
        "command": f"rattlesweep classify {shlex.quote(str(stored.directory))} {' '.join(sets)}",
    }


def _kinds(layout: Layout) -> list[str]:
    """Return the pictures that suit a sweep."""
    first = default_kind(layout)
    extra = ("times", "ratio") if first not in ("map", "reversals") and layout.several else ()
    return list(dict.fromkeys((first, *extra, "distribution")))


def _shown(layout: Layout, kind: str) -> Mapping[str, Any]:
    """Return a picture for the page, or why there is none."""
    try:
        with styled():
            picture = choose_picture(layout, kind)
            figure = picture.figure(captioned=False)
            svg = encode(figure, "svg", DPI)
            png = encode(figure, "png", DPI) if len(svg) > MOST_SVG else b""
    except (ConfigError, OutputError) as error:
        # More panels than a page can show; the others still say what there is.
        return {"kind": kind, "error": error}
    varies = ", ".join(axis.name for axis in picture.axes) or "all runs"
    return {"kind": kind, "error": None, "source": source(svg, png), "varies": varies,
            "caption": " ".join(picture.notes)}  # fmt: skip


def _listed(part: Mapping[str, Any]) -> str:
    return ", ".join(f"{key} {value}" for key, value in part.items())
