"""`report`: a sweep on one self-contained page, made from one pass over its rows."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from datetime import datetime
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.compute as pc

from rattlesweep.errors import ConfigError, OutputError
from rattlesweep.analysis.pages import MOST_SVG, config_yaml, percent, render, source
from rattlesweep.analysis.plots.layout import Layout, read_layout, read_rows
from rattlesweep.analysis.plots.picture import Picture
from rattlesweep.analysis.plots.registry import choose_picture, default_kind
from rattlesweep.analysis.style import encode, styled
from rattlesweep.sweeps.config.read import resolved
from rattlesweep.sweeps.old.content_hash import RowsHash
from rattlesweep.sweeps.old.status import status_of
from rattlesweep.sweeps.summary import Summary, absent_columns
from rattlesweep.sweeps.counts import columns_for

DPI = 120
# Cases shown at once, and at all: each takes some 400 bytes.
OPEN_CASES, MOST_CASES = 40, 2000
# Rows whose hash is worked out for the page: a second or two.
MOST_HASHED = 3_000_000
MOST_SESSIONS = 200
CASE_COLUMNS = {
    "case": "case",
    "K_p": "K_p",
    "K_r": "K_r",
    "n_i": "n_i",
    "omega_xy0": "ω_xy0",
    "sigma": "σ",
    "rolling": "rolling",
    "runs": "runs",
    "fraction_R": "R",
    "fraction_SS": "SS",
    "fraction_SW": "SW",
    "fraction_unclassified": "unclassified",
    "fraction_D": "D",
    "fraction_bondi": "Bondi",
    "t_r_mean": "mean t_r",
    "t_r_std": "± std",
    "t_r_mean_error": "known to ±",
    "t_rgh_mean": "mean t_rGH",
    "t_r_over_t_rgh_mean": "mean t_r/t_rGH",
    "t_r_over_t_rgh_sem": "± error",
    "sensitive": "sensitive",
    "unsure": "type not sure",
    "failed": "failed",
}
"""Columns of `summary` that are shown, with their headings."""
SESSION_COLUMNS = ("started", "state", "shard", "host", "threads", "blocks", "seconds")


class Facts:
    """What a report tells of all runs in complete blocks besides their summary and pictures."""

    columns: Sequence[str] = ("case", "sample", "status", "t_end", "n_steps")

    def __init__(self) -> None:
        self.runs = 0
        self.steps = 0  # accepted
        self.time = 0.0  # integrated, in sqrt(a/g)
        self.status: Counter[str] = Counter()
        self.first: dict[str, tuple[int, int]] = {}  # case and sample of the first of a status

    def add(self, rows: pa.RecordBatch) -> None:
        """Take more rows."""
        self.runs += rows.num_rows
        self.time += pc.sum(rows.column("t_end"), min_count=0).as_py()
        self.steps += pc.sum(rows.column("n_steps"), min_count=0).as_py()
        for entry in pc.value_counts(rows.column("status")).to_pylist():
            self.status[entry["values"]] += entry["counts"]
        for word in self.status.keys() - self.first.keys():
            place = pc.index(rows.column("status"), word).as_py()
            self.first[word] = (rows.column("case")[place].as_py(),
                                rows.column("sample")[place].as_py())  # fmt: skip


def make_report(directory: Path, title: str | None = None) -> bytes:
    """The page of a sweep, whole or still running: HTML that needs nothing else, under 5 MB."""
    layout = read_layout(directory)
    manifest, store = layout.manifest, layout.store
    status = status_of(directory)
    summary = Summary(manifest.cases, store.runs, columns_for(manifest.config))
    facts = Facts()
    pictures: list[Picture] = []
    missing: list[Mapping[str, Any]] = []
    for kind in _kinds(layout):
        try:
            pictures.append(choose_picture(layout, kind))
        except ConfigError as error:
            missing.append({"kind": kind, "error": error})
    digest = (
        RowsHash(store.runs, bool(manifest.stages)) if status.runs_done <= MOST_HASHED else None
    )
    read_rows(layout, facts, summary, *([] if digest is None else [digest]), *pictures)
    table = summary.table()
    absent = {"K_p", "K_r"}.difference(layout.targets) | absent_columns(table)
    if not summary.cells.has_errors:
        absent |= {"t_r_mean_error"}
    columns = [name for name in CASE_COLUMNS if name not in absent]
    sessions = manifest.sessions[-MOST_SESSIONS:]
    return render(
        "sweep.html.j2",
        title=title or manifest.name,
        manifest=manifest,
        status=status,
        facts=facts,
        cells=summary.cells,
        horizon=layout.config.horizon,
        size=sum(store.block_path(index).stat().st_size for index in store.block_indices()),
        pictures=[*map(_shown, pictures), *missing],
        case_head=[CASE_COLUMNS[name] for name in columns],
        cases=[[_shorten(row[n], n) for n in columns] for row in table.to_pylist()],
        open_cases=OPEN_CASES,
        most_cases=MOST_CASES,
        failures=_failures(facts),
        config=config_yaml(resolved(layout.config)),
        digest=None if digest is None else digest.hexdigest(),
        session_head=SESSION_COLUMNS,
        sessions=[
            [_to_the_second(s.started), *(getattr(s, name) for name in SESSION_COLUMNS[1:])]
            for s in sessions
        ],
    )


def _to_the_second(time: str) -> str:
    """A time of the manifest, to the second."""
    return datetime.fromisoformat(time).isoformat(timespec="seconds")


def _kinds(layout: Layout) -> list[str]:
    """The pictures that suit a sweep."""
    first = default_kind(layout)
    varies = any(count > 1 for count in layout.lengths.values())
    extra = ("times", "ratio") if first != "map" and varies else ()
    return list(dict.fromkeys((first, *extra, "distribution")))


def _shown(picture: Picture) -> Mapping[str, Any]:
    """A picture for the page, or why there is none."""
    try:
        with styled():
            figure = picture.figure()
            svg = encode(figure, "svg", DPI)
            png = encode(figure, "png", DPI) if len(svg) > MOST_SVG else b""
    except (ConfigError, OutputError) as error:
        # More panels than a page can show; the others still say what there is.
        return {"kind": picture.name, "error": error}
    varies = ", ".join(axis.name for axis in picture.axes) or "all runs"
    return {"kind": picture.name, "error": None, "source": source(svg, png), "varies": varies,
            "caption": picture.caption}  # fmt: skip


def _shorten(value: float | int | None, name: str) -> str | None:
    if value is None:
        return None
    if name.startswith("fraction"):
        return f"{value:.3f}"
    return f"{value:.5g}" if isinstance(value, float) else f"{value:,}"


def _failures(facts: Facts) -> list[tuple[str, ...]]:
    """Statuses other than ok, the most frequent first."""
    return [
        (word, f"{count:,}", percent(count, facts.runs),
         "case {}, sample {}".format(*facts.first[word]))
        for word, count in facts.status.most_common()
        if word != "ok"
    ]  # fmt: skip
