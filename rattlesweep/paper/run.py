"""Figure after figure, each kept as soon as its data are complete; the claims and the report."""

from __future__ import annotations

import platform
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict
from importlib.metadata import version
from pathlib import Path

from rattlesweep.paper.claims.claim import judge
from rattlesweep.paper.drawing import Artist
from rattlesweep.paper.registry import FIGURES, SWEEPS, THEORY, compile_ahead
from rattlesweep.paper.report import Reproduction, write_report
from rattlesweep.paper.workspace import FULL, Progress, Sizes, Tables, Workspace, sweep_config
from rattlesweep.sweeps.config.read import resolved
from rattlesweep.sweeps.provenance import PACKAGES, machine, now, package_version

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

    What is whole in the directory and of the same sizes and code is kept, after a Ctrl-C as well:
    whole figures and complete blocks of the sweeps.  ``show`` is called a few times a second.

    Raises
    ------
    ConfigError
        If the directory holds other sweeps.
    """
    ws = Workspace(directory, sizes, threads)
    chosen = {name: FIGURES[name] for name in names if name in FIGURES}
    kept = [name for name in chosen if ws.load(name) is not None]
    sweeps = list(dict.fromkeys(figure.sweep for figure in chosen.values() if figure.sweep))
    column = 0 if sizes == FULL else 1
    expected = {name: f.seconds[column] for name, f in chosen.items() if name not in kept}
    needed = {chosen[name].sweep for name in expected}
    expected |= {name: SWEEPS[name][column] for name in sweeps if name in needed}
    compile_ahead(expected)
    parts = Parts(expected | {"pictures": 1.0, "report": 1.0}, show)
    tables: dict[str, Tables] = {}
    undrawn = any(name in expected or not ws.has_pictures(name) for name in chosen)
    with Artist(directory, undrawn) as artist:
        for name, figure in chosen.items():
            if name in expected and figure.sweep and figure.sweep not in parts.seconds:
                with parts.part(figure.sweep) as progress:
                    ws.sweep(figure.sweep, progress)
            with parts.part(name) as progress:
                tables[name] = ws.load_or_make(name, figure, progress)
            if not ws.has_pictures(name):
                artist.draw(name, figure, tables[name])
        with parts.part("claims"):
            claims = judge(tables, theory=THEORY in names)
        with parts.part("pictures") as progress:
            artist.finish(lambda: progress(0.0, "drawing"))
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
        write_report(done, list(chosen))
    ws.record["seconds"] = {name: round(value, 3) for name, value in parts.seconds.items()}
    ws.save()
    return done
