"""Every figure and supplement by its name, and how they are made, one after another."""

from __future__ import annotations

import io
import time
from collections.abc import Callable, Sequence

import pyarrow as pa
import pyarrow.parquet as pq

from rattlesweep.analysis.style import encode, styled
from rattlesweep.errors import ConfigError
from rattlesweep.paper.claim import judge, read_table
from rattlesweep.paper.report import Reproduction, write_report
from rattlesweep.paper.workspace import FULL, Part, Workspace
from rattlesweep.sweeps.config import not_one_of
from rattlesweep.sweeps.files import replace_file

# The claims about formulas alone go by this name where parts are chosen.
THEORY = "theory"
KINDS, DPI = ("png", "svg"), 150

PARTS = {name: Part(**row) for name, row in read_table("parts").items()}
"""Figures and supplements by name, as ``parts.yaml`` has them."""


def choose(names: str | None) -> list[str]:
    """Return the parts that were asked for, such as ``fig8,fig7``, in the paper's order, or all."""
    known = [*PARTS, THEORY]
    wanted = known if names is None else [word.strip() for word in names.split(",")]
    if unknown := [word for word in wanted if word not in known]:
        raise ConfigError(f"--only: {not_one_of(unknown[0], known)}")
    return [name for name in known if name in wanted]


def reproduce(
    workspace: Workspace, names: Sequence[str], begin: Callable[[str], None] = lambda title: None
) -> Reproduction:
    """Compute and draw what was asked for, judge the claims that this can settle, and report.

    `names` are keys of :data:`PARTS`, and perhaps ``theory``; `begin` is called with the title of
    each part before it is made.  Raises a ConfigError if the directory holds other sweeps.
    """
    done = Reproduction(workspace, {name: PARTS[name] for name in names if name != THEORY})
    for name, part in done.parts.items():
        begin(part.title)
        start = time.perf_counter()
        tables = done.tables[name] = part.data(workspace)
        for table, rows in tables.items():
            found = pa.Table.from_pandas(rows, preserve_index=False).replace_schema_metadata()
            buffer = io.BytesIO()
            pq.write_table(found, buffer, write_page_checksum=True)
            replace_file(workspace.directory / f"{name}_{table}.parquet", buffer.getvalue())
        if part.draw is not None:
            with styled():
                drawing = part.draw(tables)
                for kind in KINDS:
                    image = encode(drawing, kind, DPI)
                    replace_file(workspace.directory / f"{name}.{kind}", image)
        done.seconds[name] = time.perf_counter() - start
    few = workspace.sizes.samples < FULL.samples
    done.claims = judge(done.tables, theory=THEORY in names, few=few)
    write_report(done)
    return done
