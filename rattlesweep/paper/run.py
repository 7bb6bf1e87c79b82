"""Figure after figure, each kept as soon as it is complete; then the claims and the report."""

from __future__ import annotations

import platform
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict
from functools import partial
from importlib.metadata import version
from pathlib import Path

import pyarrow as pa

from rattlesweep.paper.claims.table import judge
from rattlesweep.paper.data.progress import Progress
from rattlesweep.paper.registry import FIGURES, SWEEPS, THEORY
from rattlesweep.paper.report import Reproduction, write_report
from rattlesweep.paper.settings import FULL, Sizes, sweep_config
from rattlesweep.paper.workspace import Workspace
from rattlesweep.study.style import encode, styled
from rattlesweep.sweeps.config.load import resolved
from rattlesweep.sweeps.store.provenance import PACKAGES, machine, now, package_version

DPI = 150
# Of the whole, seconds elapsed, and seconds left or None as long as there is nothing to judge by.
Show = Callable[[float, str, float, float | None], None]


class Parts:
    """The parts of the work: what each is expected to take, and what it took."""

    def __init__(self, expected: Mapping[str, float], show: Show) -> None:
        self.seconds: dict[str, float] = {}
        self._expected, self._show, self._done = dict(expected), show, 0.0
        self._start = time.perf_counter()

    @contextmanager
    def part(self, name: str) -> Iterator[Progress]:
        """Time a part, which tells how far it is."""
        start, cost = time.perf_counter(), self._expected.get(name, 0.0)
        yield lambda share, words: self._tell(self._done + cost * min(1.0, share), words)
        self._done += cost
        self.seconds[name] = time.perf_counter() - start
        self._tell(self._done, name)

    def _tell(self, done: float, words: str) -> None:
        elapsed, total = time.perf_counter() - self._start, sum(self._expected.values())
        # Before the first second, compilation and reading would pass for speed.
        left = (total - done) * elapsed / done if done > 0 and elapsed > 1 else None
        self._show(done / total, words, elapsed, left)


def reproduce(
    directory: Path,
    names: Sequence[str],
    *,
    sizes: Sizes = FULL,
    threads: int,
    show: Show = lambda share, words, elapsed, left: None,
) -> Reproduction:
    """Compute, draw and judge what was asked for, and write the report.

    Parameters
    ----------
    directory : Path
        Output directory; what is whole there and of the same sizes and code is kept.
    names : sequence of str
        Of :func:`rattlesweep.paper.registry.choose`.
    sizes : Sizes
    threads : int
    show : callable
        Called a few times a second.

    Raises
    ------
    ConfigError, OutputError
        If the directory holds other sweeps, or cannot be written.
    KeyboardInterrupt
        On Ctrl-C; whole figures and complete blocks of the sweeps are kept.
    """
    ws = Workspace(directory, sizes, threads)
    chosen = [name for name in names if name in FIGURES]
    kept = [name for name in chosen if ws.load(name) is not None]
    sweeps = list(dict.fromkeys(s for n in chosen if (s := FIGURES[n].sweep) is not None))
    column = 0 if sizes == FULL else 1
    expected = {name: FIGURES[name].seconds[column] for name in chosen if name not in kept}
    needed = {FIGURES[name].sweep for name in expected}
    expected |= {name: SWEEPS[name][column] for name in sweeps if name in needed}
    parts = Parts(expected | {"report": 2.0}, show)
    tables: dict[str, Mapping[str, pa.Table]] = {}
    for name in chosen:
        figure = FIGURES[name]
        sweep = figure.sweep if name in expected else None
        if sweep is not None and sweep not in parts.seconds:
            with parts.part(sweep) as progress:
                ws.sweep(sweep, progress)
        with parts.part(name) as progress:
            tables[name] = ws.load_or_make(name, partial(figure.data, ws, progress))
            _draw(ws, name, tables[name])
    with parts.part("claims"):
        claims = judge(tables, theory=THEORY in names)
    ws.record |= {
        "quick": sizes != FULL,
        "settings": asdict(sizes) | {n: resolved(sweep_config(n, sizes)) for n in sweeps},
        "versions": {
            "rattlesweep": package_version(),
            "python": platform.python_version(),
            **{name: version(name) for name in (*PACKAGES, "matplotlib")},
        },
        "machine": machine(),
        "threads": threads,
        "finished": now(),
    }
    done = Reproduction(directory, claims, parts.seconds, kept, ws.failed(sweeps), ws.record)
    with parts.part("report"):
        write_report(done, chosen)
    ws.record["seconds"] = {name: round(value, 3) for name, value in parts.seconds.items()}
    ws.save()
    return done


def _draw(ws: Workspace, name: str, tables: Mapping[str, pa.Table]) -> None:
    def pictures() -> dict[str, bytes]:
        with styled():
            figure = FIGURES[name].draw(tables)
            svg = encode(figure, "svg", DPI)
            # The layout is known now; computing it again would take half of the time.
            figure.set_layout_engine("none")
            return {"svg": svg, "png": encode(figure, "png", DPI)}

    ws.draw_if_needed(name, pictures)
