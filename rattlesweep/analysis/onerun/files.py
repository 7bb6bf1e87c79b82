"""Write a trajectory as it comes: Parquet or CSV, in bounded memory."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any, BinaryIO

import pyarrow as pa
import pyarrow.csv as pcsv
import pyarrow.parquet as pq

from rattlesweep.analysis.onerun.course import Course
from rattlesweep.sweeps.columns import F64, build_table, field
from rattlesweep.sweeps.files import streamed_file
from rattlesweep.sweeps.provenance import package_version


def schema(course: Course) -> pa.Schema:
    """Return the columns with unit and description; the metadata say which run it is."""
    about = course.body | course.launch | {
        "model": course.model, "t_end": course.t_end, "rattlesweep": package_version(),
        "integrator": course.integrator,
    }  # fmt: skip
    return pa.schema(
        [field(c.name, F64, c.unit, c.description) for c in course.channels],
        metadata={"rattlesweep.run": json.dumps(about)},
    )


def write_parquet(course: Course, file: BinaryIO) -> None:
    """Integrate and write row groups; at the end, where pyarrow can, the reversals and zeros."""
    columns = schema(course)
    with pq.ParquetWriter(file, columns, compression="zstd", version="2.6") as writer:
        for chunk in course:
            writer.write_table(build_table(chunk, columns))
        if hasattr(writer, "add_key_value_metadata"):  # younger than pyarrow 16
            writer.add_key_value_metadata(
                {"rattlesweep.reversals": json.dumps(course.reversals),
                 "rattlesweep.zeros": json.dumps(course.zeros),
                 "rattlesweep.status": course.status.label}
            )  # fmt: skip


def write_csv(course: Course, write: Callable[[bytes], Any]) -> None:
    """Integrate and write lines: names first, digits that give the same number back."""
    columns = schema(course)
    write((",".join(columns.names) + "\n").encode())
    for chunk in course:
        sink = pa.BufferOutputStream()
        # In one piece: pyarrow (26) writes what was in memory for an empty chunk before others.
        table = build_table(chunk, columns).combine_chunks()
        pcsv.write_csv(table, sink, pcsv.WriteOptions(include_header=False))
        write(sink.getvalue().to_pybytes())


def save(course: Course, path: Path) -> None:
    """Integrate and write a file, whole or not at all."""
    with streamed_file(path) as file:
        if path.suffix.lower() == ".csv":
            write_csv(course, file.write)
        else:
            write_parquet(course, file)
