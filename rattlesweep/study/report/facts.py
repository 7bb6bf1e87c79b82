"""What a report tells of the runs besides their summary and pictures."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

import pyarrow as pa
import pyarrow.compute as pc


class Facts:
    """Of all runs in complete blocks.

    Attributes
    ----------
    runs : int
    status : Counter
        Runs by status.
    first : dict
        Case and sample of the first run of each status.
    time : float
        Time integrated, in ``sqrt(a/g)``.
    steps : int
        Accepted steps.
    """

    columns: Sequence[str] = ("case", "sample", "status", "t_end", "n_steps")

    def __init__(self) -> None:
        self.runs, self.steps, self.time = 0, 0, 0.0
        self.status: Counter[str] = Counter()
        self.first: dict[str, tuple[int, int]] = {}

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
