"""Make the golden sweep anew: `python tests/golden/make.py`.

To be done only where numbers are meant to change, with the reason in the changelog; what is
compared is in `tests/sweeps/test_golden.py`.
`NUMBA_CPU_NAME=generic python tests/golden/make.py FILE` makes it for another type of processor.
"""

import json
import sys
import tempfile
from pathlib import Path

import pyarrow.parquet as pq
from rattlesweep.sweeps.old.content_hash import content_hash

import rattlesweep as rs

HERE = Path(__file__).parent


def make(target: Path) -> None:
    """Run the sweep and keep its rows, with the machine and the hash of all bits."""
    with tempfile.TemporaryDirectory() as folder:
        sweep = rs.sweep(HERE / "golden.yaml", output=folder)
        table = pq.read_table(Path(folder) / "runs")
        origin = {key: sweep.manifest[key] for key in ("versions", "machine")}
        origin["content_hash"] = content_hash(folder)
    pq.write_table(table.replace_schema_metadata({"origin": json.dumps(origin)}), target)


if __name__ == "__main__":
    make(Path(sys.argv[1]) if len(sys.argv) > 1 else HERE / "golden.parquet")
