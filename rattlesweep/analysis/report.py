"""Write a sweep on one self-contained page."""

from __future__ import annotations

import math
import shlex
from collections import Counter
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
CASE_COLUMNS = {
    "case": "case",
    "K_p": "K_p",
    "K_r": "K_r",
    "n_i": f"n_i ({RATE})",
    "omega_xy0": f"ω_xy0 ({RATE})",
    "sigma": "σ (M a² √(g/a))",
    "rolling": "rolling (a)",
    "runs": "runs",
    "fraction_R": "R",
    "fraction_SS": "SS",
    "fraction_SW": "SW",
    "fraction_unclassified": "unclassified",
    "fraction_D": "D",
    "fraction_bondi": "Bondi",
    "t_r_mean": f"mean t_r ({TIME})",
    "t_r_std": f"standard deviation of t_r ({TIME})",
    "t_r_mean_error": f"mean error of t_r ({TIME})",
    "t_rgh_mean": f"mean t_rGH ({TIME})",
    "t_r_over_t_rgh_mean": "mean t_r/t_rGH",
    "t_r_over_t_rgh_sem": "± error of the mean",
    "sensitive": "sensitive",
    "unsure": "type not sure",
    "share_friction_above_0_3": "needs friction above 0.3",
    "share_friction_above_0_6": "needs friction above 0.6",
    "share_lift_off": "lifts off",
    "failed": "failed",
}
"""Columns of `summary` that are shown, with their headings."""


def make_report(directory: Path, title: str | None = None) -> bytes:
    """Return the page of a sweep, whole or still running: HTML that needs nothing else."""
    layout = read_layout(directory)
    stored = layout.stored
    words: Counter[str] = Counter()
    first: dict[str, tuple[int, int]] = {}  # case and sample of the first run of a status
    runs = steps = 0
    integrated = 0.0
    for rows in stored.batches(["case", "sample", "status", "t_end", "n_steps"]):
        runs += rows.num_rows
        integrated += pc.sum(rows.column("t_end"), min_count=0).as_py()
        steps += pc.sum(rows.column("n_steps"), min_count=0).as_py()
        for entry in pc.value_counts(rows.column("status")).to_pylist():
            words[entry["values"]] += entry["counts"]
        for word in words.keys() - first.keys():
            place = pc.index(rows.column("status"), word).as_py()
            first[word] = rows["case"][place].as_py(), rows["sample"][place].as_py()
    counts = count_cases(stored)
    table = summary_table(stored.cases, counts)
    absent = {"K_p", "K_r"}.difference(layout.targets) | absent_columns(table)
    absent |= set() if counts.has_errors else {"t_r_mean_error"}
    columns = [name for name in CASE_COLUMNS if name not in absent]
    sessions = read_sessions(directory)
    manifest = stored.manifest
    kernel = sum(session.get("kernel_seconds") or 0.0 for session in sessions)
    size = sum(path.stat().st_size for path in stored.files())
    cost = [
        ("time of all sessions", _seconds(sum(s.get("seconds") or 0.0 for s in sessions))),
        ("of it, integration", _seconds(kernel)),
        ("accepted steps", f"{steps:,}"),
        ("time integrated", f"{integrated:.4g} {TIME}"),
        ("size of the runs", f"{size / 1e6:,.1f} MB, {size / max(runs, 1):.0f} bytes a run"),
    ]
    # The times of sessions that were killed are unknown; a rate would come out too high.
    if kernel > 0 and all(session.get("how") == "complete" for session in sessions):
        cost.append(("of integration", f"{steps / kernel:.3g} steps a second"))
    return render(
        "sweep.html.j2",
        title=title or manifest["name"],
        state=_state(directory),
        runs=runs,
        ok=words["ok"],
        counts=counts,
        horizon=layout.config.horizon,
        pictures=[_shown(layout, kind) for kind in _kinds(layout)],
        case_head=[CASE_COLUMNS[name] for name in columns],
        cases=[[_cell(row, name) for name in columns] for row in table.to_pylist()],
        open_cases=OPEN_CASES,
        most_cases=MOST_CASES,
        failures=[
            (word, f"{count:,}", percent(count, runs),
             "case {}, sample {}".format(*first[word]))
            for word, count in words.most_common() if word != "ok"
        ],
        thresholds=_thresholds(stored),
        cost=cost,
        config=config_yaml(resolved(layout.config)),
        provenance=[
            ("started", manifest.get("started")),
            ("command", " ".join(map(shlex.quote, manifest.get("command", [])))),
            ("machine", _listed(manifest["machine"])),
            ("versions", _listed(manifest["versions"])),
            ("hash of the config", stored.hash),
        ],
        sessions=[
            [str(s.get("started"))[:19], s.get("how"), s.get("shard"), s.get("host"),
             s.get("threads"), s.get("runs"), s.get("seconds")]
            for s in sessions[-MOST_SESSIONS:]
        ],
    )  # fmt: skip


def _state(directory: Path) -> str:
    """Return how far a sweep is, in words."""
    found = status(directory)
    done, wanted = found.data["runs"], found.data["wanted"]
    left_out = f" ({found.decides} leaves out the others)" if found.decides else ""
    if found.done:
        return f"complete{left_out}"
    how = "running" if found.data["at_work"] else "not complete"
    return f"{how}: {done:,} of {wanted:,} runs are done"


def _thresholds(stored: Stored) -> dict[str, Any]:
    """Return the thresholds of the config and those behind the types on disk."""
    config, now = stored.config.classify.thresholds, stored.thresholds.thresholds
    changed = {key: value for key, value in now.items() if value != config[key]}
    sets = "".join(f" --set classify.{key}={value!r}" for key, value in changed.items())
    return {
        "rows": [(key, f"{config[key]:g}", f"{now[key]:g}") for key in now],
        "changed": bool(changed),
        "command": f"rattlesweep classify {shlex.quote(str(stored.directory))}{sets}",
    }


def _kinds(layout: Layout) -> list[str]:
    """Return the pictures that suit a sweep."""
    first = default_kind(layout)
    varies = any(count > 1 for count in layout.lengths.values())
    extra = ("times", "ratio") if first not in ("map", "reversals") and varies else ()
    return list(dict.fromkeys((first, *extra, "distribution")))


def _shown(layout: Layout, kind: str) -> Mapping[str, Any]:
    """Return a picture for the page, or why there is none."""
    try:
        with styled():
            picture = choose_picture(layout, kind)
            figure = picture.figure()
            svg = encode(figure, "svg", DPI)
            png = encode(figure, "png", DPI) if len(svg) > MOST_SVG else b""
    except (ConfigError, OutputError) as error:
        # More panels than a page can show; the others still say what there is.
        return {"kind": kind, "error": error}
    varies = ", ".join(axis.name for axis in picture.axes) or "all runs"
    return {"kind": kind, "error": None, "source": source(svg, png), "varies": varies,
            "caption": picture.caption}  # fmt: skip


def _cell(row: Mapping[str, Any], name: str) -> str | None:
    """Return a cell of the table of cases, with no digits beyond the error of a mean."""
    value = row[name]
    if value is None or isinstance(value, int):
        return None if value is None else f"{value:,}"
    if name.startswith("fraction"):
        return f"{value:.3f}"
    reversing = round((row["fraction_R"] or 0) * (row["runs"] - row["failed"]))
    errors = {"t_r_over_t_rgh_mean": row["t_r_over_t_rgh_sem"]}
    if reversing > 1 and row["t_r_std"]:
        errors["t_r_mean"] = row["t_r_std"] / math.sqrt(reversing)
    if error := errors.get(name):
        return f"{value:.{max(0, min(9, 1 - math.floor(math.log10(error))))}f}"
    return f"{value:.3g}" if name.endswith(("_std", "_sem", "_error")) else f"{value:.5g}"


def _listed(part: Mapping[str, Any]) -> str:
    return ", ".join(f"{key} {value}" for key, value in part.items())


def _seconds(value: float) -> str:
    whole = round(value)
    return f"{value:.1f} s" if value < 600 else f"{whole // 3600} h {whole % 3600 // 60} min"
