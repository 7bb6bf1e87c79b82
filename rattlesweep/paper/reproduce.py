"""The parts of the paper, one after another: data, pictures, claims, report."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from pathlib import Path

from rattlesweep.analysis.style import encode, styled
from rattlesweep.paper.claims.claim import judge
from rattlesweep.paper.parts import PARTS, THEORY
from rattlesweep.paper.report import Reproduction, write_report
from rattlesweep.paper.workspace import FULL, Sizes, Workspace, write_table
from rattlesweep.progress import Bar
from rattlesweep.sweeps.files import replace_file

KINDS, DPI = ("png", "svg"), 150


def reproduce(
    directory: Path,
    names: Sequence[str],
    *,
    sizes: Sizes = FULL,
    threads: int | None = None,
    bar: Bar | None = None,
    begin: Callable[[str], None] = lambda name: None,
) -> Reproduction:
    """Compute and draw what was asked for, judge the claims that this can settle, and report.

    Parameters
    ----------
    directory : Path
        Output directory; its sweeps resume.
    names : sequence of str
        Keys of :data:`PARTS`, and perhaps ``theory``.
    sizes : Sizes
    threads : int, optional
        By default one for each processor.
    bar : Bar, optional
        Shows how far the part under way is.
    begin : callable
        Called with the name of each part before it is made.

    Raises
    ------
    ConfigError
        If the directory holds other sweeps.
    """
    done = Reproduction(Workspace(directory, sizes, threads, bar))
    for name in names:
        if name == THEORY:
            continue
        begin(name)
        start, part = time.perf_counter(), PARTS[name]
        tables = done.tables[name] = part.data(done.workspace)
        for table, rows in tables.items():
            write_table(directory / f"{name}_{table}.parquet", rows)
        if part.draw is not None:
            with styled():
                drawing = part.draw(tables)
                for kind in KINDS:
                    replace_file(directory / f"{name}.{kind}", encode(drawing, kind, DPI))
        done.seconds[name] = time.perf_counter() - start
    few = sizes.samples < FULL.samples
    done.claims = judge(done.tables, theory=THEORY in names, few=few)
    write_report(done)
    return done
