"""The report of a sweep, as a self-contained page."""

import gc
import re
from collections import Counter
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from matplotlib.figure import Figure

from rattlesweep.analysis.layout import SweepLayout, read_layout
from rattlesweep.analysis.plots import MAPS, choose_picture, default_kind
from rattlesweep.analysis.style import encode_figure, styled
from rattlesweep.config.read import resolved
from rattlesweep.rows.arrow import floats
from rattlesweep.store.progress import status
from rattlesweep.store.rows import Stored
from rattlesweep.store.sessions import read_sessions
from rattlesweep.store.summary import (
    PRINTED,
    absent_columns,
    count_cases,
    summary_table,
)
from rattlesweep.system.pages import (
    MOST_SVG,
    config_yaml,
    data_url,
    embedded,
    render,
    script,
)
from rattlesweep.words.errors import ConfigError, OutputError
from rattlesweep.words.units import readable_unit

_DPI = 120
MOST_SESSIONS = 200
# Pictures for telephones: inches of their width, of a row of panels, and of the rest.
NARROW = 3.4
NARROW_PANEL = 1.3
NARROW_MARGIN = 1.4
NARROW_FONT = 7.0


def make_report(directory: Path, title: str | None = None) -> bytes:
    """Return the report of a sweep, finished or not, as a self-contained page."""
    layout = read_layout(directory)
    stored = layout.stored
    state = status(directory)
    sessions = read_sessions(directory)
    steps, failures = _work(stored)
    counts = count_cases(stored)
    table = summary_table(stored.cases, counts)
    hidden = {"K_p", "K_r"}.difference(layout.axes) | absent_columns(table)
    hidden.add("near_tangencies")
    if "sensitive" not in counts:
        hidden.add("t_r_mean_error")
    # What is not printed either is of use only where it is known.
    known = {column.name for column in PRINTED}
    for name in set(table.column_names) - known:
        if table.column(name).null_count == len(table):
            hidden.add(name)
    table = table.drop_columns([name for name in table.column_names if name in hidden])
    first = default_kind(layout)
    kinds = [first]
    if first not in ("map", *MAPS) and layout.several:
        kinds += ["times", "ratio"]
    if np.isfinite(counts.ratio.means()).any():
        # Taps, for example, have no time of theory.
        kinds.append("distribution")
    thresholds = [
        (key, value, stored.thresholds.thresholds[key])
        for key, value in stored.config.classify.thresholds.items()
    ]
    return render(
        "sweep.html.j2",
        title=title or stored.manifest["name"],
        stored=stored,
        done=state.data["runs"] >= state.data["wanted"],
        state=state.data,
        counts=counts,
        steps=steps,
        pictures=[_shown(layout, kind) for kind in dict.fromkeys(kinds)],
        case_head=[_heading(column) for column in table.schema],
        cases=list(zip(*map(_cells, table.schema, table.columns), strict=True)),
        script=script("sort.js"),
        failures=failures,
        thresholds=thresholds,
        config=config_yaml(resolved(stored.config)),
        seconds=sum(session.get("seconds") or 0.0 for session in sessions),
        sessions=[_session_cells(session) for session in sessions[-MOST_SESSIONS:]],
    )


def _heading(column: pa.Field) -> tuple[str, str]:
    """Return the heading of a column of the summary in words, and its name."""
    words = column.metadata[b"description"].decode()
    return re.split("[;,]", words)[0], column.name


def _cells(column: pa.Field, values: pa.ChunkedArray) -> list[object]:
    """Return the values of a column; a short length is a text and its size."""
    cells: list[object] = values.to_pylist()
    if column.metadata.get(b"unit") != b"m":
        return cells
    for place, value in enumerate(cells):
        if isinstance(value, float):
            factor, unit = readable_unit(value, "m")
            cells[place] = (f"{factor * value:.5g} {unit}", value)
    return cells


def _work(stored: Stored) -> tuple[int, list[tuple[str, int, str, str]]]:
    """Return the number of steps, and the failures.

    These are, for each status but ok, its number of runs, their share, and the first.
    """
    steps = 0
    runs = 0
    failed: Counter[str] = Counter()
    first: dict[str, str] = {}
    for rows in stored.batches(["case", "sample", "status", "n_steps"]):
        steps += int(floats(rows["n_steps"]).sum())
        runs += len(rows)
        statuses = rows["status"]
        for row in rows.filter(pc.not_equal(statuses, "ok")).to_pylist():
            failed[row["status"]] += 1
            place = f"case {row['case']}, sample {row['sample']}"
            first.setdefault(row["status"], place)
    failures = []
    for word in sorted(failed):
        share = f"{100 * failed[word] / runs:.3g} %"
        failures.append((word, failed[word], share, first[word]))
    return steps, failures


def _session_cells(session: Mapping[str, object]) -> list[object]:
    """Return the cells of a session in the table of sessions."""
    names = ("how", "shard", "host", "threads", "runs", "seconds")
    return [str(session.get("started"))[:19], *(session.get(name) for name in names)]


def _encoded(figure: Figure) -> tuple[bytes, bytes]:
    """Return a figure as SVG, and as PNG if that is too large."""
    svg = encode_figure(figure, "svg", _DPI)
    png = encode_figure(figure, "png", _DPI) if len(svg) > MOST_SVG else b""
    return svg, png


def _shown(layout: SweepLayout, kind: str) -> Mapping[str, object]:
    """Return a picture for the page, or why there is none, such as too many panels."""
    try:
        with styled():
            picture = choose_picture(layout, kind)
            image = {**embedded(*_encoded(picture.figure(caption=False)))}
        # The parts of a figure refer to each other, so that it would stay.
        gc.collect()
        with styled({"font.size": NARROW_FONT}):
            height = NARROW_MARGIN + NARROW_PANEL * len(picture.down)
            # Without it the page shows the other one, which scrolls if it is wide.
            with suppress(ConfigError):
                narrow = picture.figure(caption=False, size=(NARROW, height))
                image["narrow"] = data_url(*_encoded(narrow))
    except (ConfigError, OutputError) as error:
        return {"kind": kind, "error": error}
    finally:
        gc.collect()
    return {
        "kind": kind,
        "error": None,
        "image": image,
        "alt": picture.alt(),
        "caption": " ".join(picture.notes),
    }
