"""Figure after figure, each kept as soon as it is complete.

The data of a figure are Parquet files with checksums; ``paper.json`` records the settings and the
code that they depend on.  Data of the same settings and code are not computed again, so that a
command that was stopped resumes; a picture is drawn again if only its drawing has changed.
"""

from __future__ import annotations

import hashlib
import json
import platform
import re
import time
from dataclasses import dataclass, field
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rattlesweep.errors import OutputError
from rattlesweep.paper.claims.table import judge
from rattlesweep.paper.figures.registry import FIGURES, THEORY, sweep_cost
from rattlesweep.paper.sources import code_key
from rattlesweep.paper.sweeps import Place
from rattlesweep.study.style import encode as encode_figure
from rattlesweep.study.style import styled
from rattlesweep.study.tradeoff.figure import DPI
from rattlesweep.sweeps.store.atomic import probe_directory, reason, replace_file
from rattlesweep.sweeps.store.provenance import PACKAGES, machine, now, package_version
from rattlesweep.sweeps.tables.arrow import DamagedError, encode, open_sealed

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    import pyarrow as pa

    from rattlesweep.paper.claims.claim import Judgement
    from rattlesweep.paper.settings import Paper

    Tables = Mapping[str, pa.Table]

RECORD = "paper.json"
# What a killed process may leave of the files written here.
_TEMPORARY = re.compile(
    r"\.(fig\w+\.(parquet|svg|png)|claims\.parquet|report\.html|paper\.json)\.[0-9a-f]{8}\.tmp"
)


@dataclass(frozen=True)
class Progress:
    """How far the command is.

    Attributes
    ----------
    fraction : float
        Of the expected cost.
    text : str
        What is being done.
    elapsed : float
        Seconds since the start.
    left : float or None
        Estimated seconds left; None as long as there is nothing to judge by.
    """

    fraction: float
    text: str
    elapsed: float
    left: float | None


@dataclass
class Outcome:
    """What the command came to."""

    directory: Path
    claims: list[Judgement]
    seconds: dict[str, float]
    kept: list[str]
    failed: int
    record: dict[str, Any] = field(default_factory=dict)


class _Meter:
    """Progress over steps of known expected cost."""

    def __init__(self, costs: Mapping[str, float], report: Callable[[Progress], None]) -> None:
        self._costs = dict(costs)
        self._report = report
        self._start = time.perf_counter()
        self._done = 0.0
        self._saved = 0.0

    def step(self, name: str) -> Callable[[float, str], None]:
        """What the step calls with its own fraction."""

        def say(fraction: float, text: str) -> None:
            self._tell(self._done + self._costs[name] * min(1.0, fraction), text)

        return say

    def finish(self, name: str, *, kept: bool = False) -> None:
        """Count a step; one whose data were there took no time and tells nothing of the rest."""
        self._done += self._costs[name]
        self._saved += self._costs[name] if kept else 0.0
        self._tell(self._done, name)

    def _tell(self, done: float, text: str) -> None:
        elapsed = time.perf_counter() - self._start
        total = sum(self._costs.values())
        worked = done - self._saved
        # Before the first second, compilation and reading would pass for speed.
        left = (total - done) * elapsed / worked if worked > 0 and elapsed > 1 else None
        self._report(Progress(done / total, text, elapsed, left))


def make_paper(
    paper: Paper,
    directory: Path,
    names: Sequence[str],
    *,
    quick: bool = False,
    threads: int,
    report: Callable[[Progress], None] = lambda progress: None,
) -> Outcome:
    """Compute, draw and judge what was asked for, and write the report.

    Parameters
    ----------
    paper : Paper
    directory : Path
        Output directory; what is whole there and of the same settings is kept.
    names : sequence of str
        Of :func:`rattlesweep.paper.figures.registry.choose`.
    quick : bool
        Said in the report; the settings are cut down by the caller.
    threads : int
    report : callable
        Called a few times a second with a :class:`Progress`.

    Raises
    ------
    ConfigError, OutputError
        If the directory holds other sweeps, or cannot be written.
    KeyboardInterrupt
        On Ctrl-C; whole figures and complete blocks of the sweeps are kept.
    """
    from rattlesweep.paper.report import write_report

    probe_directory(directory)
    _remove_stale(directory)
    record = _read_record(directory)
    place = Place(
        paper, directory, threads, record.setdefault("sweeps", {}),
        lambda: _write_record(directory, record),
    )  # fmt: skip
    chosen = [name for name in names if name in FIGURES]
    costs = _costs(paper, chosen)
    meter = _Meter({**costs, "report": 2.0}, report)
    figures: dict[str, Tables] = {}
    seconds: dict[str, float] = {}
    kept = []
    for name in chosen:
        start = time.perf_counter()
        key = figure_key(paper, name)
        tables: Tables | None = _stored(directory, record, name, key)
        if tables is None:
            if (sweep := FIGURES[name].sweep) is not None and sweep in costs:
                place.sweep(sweep, meter.step(sweep))
                seconds[sweep] = time.perf_counter() - start
                _finish_once(meter, costs, sweep)
                start = time.perf_counter()
            tables = FIGURES[name].compute(place, meter.step(name))
            _store(directory, record, name, key, tables)
            meter.finish(name)
        else:
            kept.append(name)
            if (sweep := FIGURES[name].sweep) is not None:
                _finish_once(meter, costs, sweep, kept=True)
            meter.finish(name, kept=True)
        figures[name] = tables
        seconds[name] = time.perf_counter() - start
    start = time.perf_counter()
    meter.step("report")(0.1, "claims")
    claims = judge(figures, theory=THEORY in names)
    seconds["claims"] = time.perf_counter() - start
    record |= {
        "quick": quick,
        "settings": paper.model_dump(mode="json", exclude_none=True),
        "versions": {
            "rattlesweep": package_version(),
            "python": platform.python_version(),
            **{name: version(name) for name in (*PACKAGES, "matplotlib")},
        },
        "machine": machine(),
        "threads": threads,
        "finished": now(),
    }
    sweeps = {FIGURES[name].sweep for name in chosen} - {None}
    failed = sum(_failed(directory / "sweeps" / str(sweep)) for sweep in sweeps)
    outcome = Outcome(directory, claims, seconds, kept, failed, record)
    meter.step("report")(0.5, "report")
    write_report(outcome, chosen)
    seconds["report"] = time.perf_counter() - start - seconds["claims"]
    record["seconds"] = {name: round(value, 3) for name, value in seconds.items()}
    _write_record(directory, record)
    meter.finish("report")
    return outcome


def _costs(paper: Paper, chosen: Sequence[str]) -> dict[str, float]:
    costs: dict[str, float] = {}
    for name in chosen:
        figure = FIGURES[name]
        if figure.sweep is not None and figure.sweep not in costs:
            costs[figure.sweep] = sweep_cost(paper, figure.sweep)
        costs[name] = figure.cost(paper)
    return costs


def _finish_once(meter: _Meter, costs: dict[str, float], sweep: str, *, kept: bool = False) -> None:
    if costs.pop(sweep, None) is not None:
        meter.finish(sweep, kept=kept)


def figure_key(paper: Paper, name: str) -> str:
    """Hash of all that the data of a figure depend on: its settings and the code it reaches."""
    settings = {s: getattr(paper, s).model_dump(mode="json") for s in FIGURES[name].sections}
    digest = hashlib.sha256(json.dumps(settings, sort_keys=True).encode())
    digest.update(code_key(name).encode())
    return digest.hexdigest()


def table_path(directory: Path, figure: str, table: str) -> Path:
    """Where a table of a figure has its place."""
    return directory / f"{figure}_{table}.parquet"


def _store(directory: Path, record: dict[str, Any], name: str, key: str, tables: Tables) -> None:
    """Write data and pictures; the record comes last, and names only what is there."""
    for table, data in tables.items():
        replace_file(table_path(directory, name, table), encode(data))
    entry = {"key": key, "tables": list(tables)}
    record.setdefault("figures", {})[name] = entry
    _draw(directory, record, name, tables)


def _draw(directory: Path, record: dict[str, Any], name: str, tables: Tables) -> None:
    with styled():
        figure = FIGURES[name].draw(tables)
        for kind in ("svg", "png"):
            replace_file(directory / f"{name}.{kind}", encode_figure(figure, kind, DPI))
            # The layout is known now; computing it again would take half of the time.
            figure.set_layout_engine("none")
    record["figures"][name]["drawn"] = code_key(name, pictures=True)
    _write_record(directory, record)


def _stored(
    directory: Path, record: dict[str, Any], name: str, key: str
) -> dict[str, pa.Table] | None:
    """Tables of a figure that are complete on disk and of this key; draws it if need be."""
    entry = record.get("figures", {}).get(name, {})
    if entry.get("key") != key:
        return None
    found: dict[str, pa.Table] = {}
    for table in entry["tables"]:
        try:
            data = table_path(directory, name, table).read_bytes()
            found[table] = open_sealed(data).read().replace_schema_metadata(None)
        except (OSError, DamagedError):
            return None
    drawn = all((directory / f"{name}.{kind}").exists() for kind in ("svg", "png"))
    if not drawn or entry.get("drawn") != code_key(name, pictures=True):
        _draw(directory, record, name, found)
    return found


def _remove_stale(directory: Path) -> None:
    for path in directory.glob(".*.tmp"):
        if _TEMPORARY.fullmatch(path.name):
            path.unlink(missing_ok=True)


def _read_record(directory: Path) -> dict[str, Any]:
    path = directory / RECORD
    try:
        record = json.loads(path.read_bytes())
    except FileNotFoundError:
        return {"format": 1, "figures": {}}
    except OSError as error:
        raise OutputError(f"cannot read {path}: {reason(error)}") from error
    except ValueError:
        # It vouches for the data; without it they are made again.
        return {"format": 1, "figures": {}}
    return record if isinstance(record, dict) else {"format": 1, "figures": {}}


def _write_record(directory: Path, record: Mapping[str, Any]) -> None:
    text = json.dumps(record, indent=2, allow_nan=False, ensure_ascii=False)
    replace_file(directory / RECORD, text.encode() + b"\n")


def _failed(sweep: Path) -> int:
    """Runs of a sweep whose status is not ok."""
    path = sweep / "manifest.json"
    if not path.exists():
        return 0
    return sum(json.loads(path.read_bytes()).get("failed", {}).values())
