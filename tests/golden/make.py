"""Make the golden sweep anew: `python tests/golden/make.py`.

To be done only where numbers are meant to change, with the reason in the changelog;
what is compared is in `tests/sweeps/test_golden.py`. `NUMBA_CPU_NAME=generic python
tests/golden/make.py FILE` makes it for another type of processor.
"""

import json
import sys
from pathlib import Path

import pyarrow.parquet as pq

from rattlesweep.sweeps.config.read import load_config
from rattlesweep.sweeps.plan import make_plan
from rattlesweep.sweeps.provenance import machine, versions
from rattlesweep.sweeps.run import integrate_plan

HERE = Path(__file__).parent


def make(target: Path) -> None:
    """Integrate the sweep, and write its rows with the versions and the machine."""
    table = integrate_plan(make_plan(load_config(HERE / "golden.yaml")))
    origin = {"versions": versions(), "machine": machine()}
    pq.write_table(
        table.replace_schema_metadata({"origin": json.dumps(origin)}), target
    )


if __name__ == "__main__":
    make(Path(sys.argv[1]) if len(sys.argv) > 1 else HERE / "golden.parquet")
