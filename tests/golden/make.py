"""Make the golden sweep anew: `python tests/golden/make.py`.

To be done only where numbers are meant to change, with the reason in the changelog;
what is compared is in `tests/work/test_golden.py`. `NUMBA_CPU_NAME=generic python
tests/golden/make.py FILE` makes it for another type of processor. `--compare` makes no
file, and says which bits come out here.
"""

import json
import sys
from pathlib import Path

import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from rattlesweep.design.config.read import load_config
from rattlesweep.design.plan import make_plan
from rattlesweep.store.provenance import machine, versions
from rattlesweep.work.run import integrate_plan

HERE = Path(__file__).parent


GOLDEN = HERE / "golden.parquet"


def integrate() -> pa.Table:
    return integrate_plan(make_plan(load_config(HERE / "golden.yaml")))


def make(target: Path) -> None:
    """Integrate the sweep, and write its rows with the versions and the machine."""
    table = integrate()
    origin = {"versions": versions(), "machine": machine()}
    pq.write_table(
        table.replace_schema_metadata({"origin": json.dumps(origin)}), target
    )


def compare() -> None:
    """Print the versions, and the columns whose bits are not those of the file."""
    table = integrate()
    golden = pq.read_table(GOLDEN)
    others = []
    for name in golden.column_names:
        if not table[name].equals(golden[name]):
            rows = pc.not_equal(table[name], golden[name])
            others.append(f"{name} ({pc.sum(rows)} of {len(golden)} rows)")
    print(json.dumps(versions() | machine()))
    print("golden sweep: other bits in", ", ".join(others) or "no column")


if __name__ == "__main__":
    if sys.argv[1:] == ["--compare"]:
        compare()
    else:
        make(Path(sys.argv[1]) if len(sys.argv) > 1 else GOLDEN)
