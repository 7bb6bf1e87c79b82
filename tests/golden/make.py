"""Make the golden sweep anew: `NUMBA_CPU_NAME=znver3 python tests/golden/make.py`.

To be done only where numbers are meant to change, with the reason in the changelog;
what is compared is in `tests/work/test_golden.py`. The file is made with code for
processors with AVX2, which those with AVX-512 run too; the features of that type are
taken with `NUMBA_CPU_FEATURES=`, empty, and NumPy's functions for AVX-512 are switched
off, as `.ci/run` does. `NUMBA_CPU_NAME=generic python tests/golden/make.py FILE` makes
it for another type of processor. `--compare` makes no file, and says which bits come
out here.
"""

import json
import platform
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from rattlesweep.compiling.loading import processor
from rattlesweep.config.read import load_config
from rattlesweep.design.plan import make_plan
from rattlesweep.store.provenance import machine, versions
from rattlesweep.work.run import integrate_plan

HERE = Path(__file__).parent
GOLDEN = HERE / "golden.parquet"


def code() -> dict[str, Any]:
    """Return what the last bits depend on: the code that computes the numbers.

    It is that of the kernels, of NumPy's functions, which differ between processors,
    and of the C library.
    """
    numbers = versions()
    kinds = {}
    if hasattr(np.lib, "introspect"):  # not in old versions
        functions = np.lib.introspect.opt_func_info(signature="float64")
        for name, forms in functions.items():
            kinds[name] = [form["current"] for form in forms.values()]
    return {
        "versions": [numbers[name] for name in ("numpy", "numba", "llvmlite")],
        "kernels": processor(),
        "functions": kinds,
        "library": list(platform.libc_ver()),
    }


def integrate() -> pa.Table:
    return integrate_plan(make_plan(load_config(HERE / "golden.yaml")))


def make(target: Path) -> None:
    """Integrate the sweep, and write its rows with the versions and the machine."""
    table = integrate()
    origin = {"versions": versions(), "machine": machine(), "code": code()}
    pq.write_table(
        table.replace_schema_metadata({"origin": json.dumps(origin)}), target
    )


def compare() -> None:
    """Print the versions, and the columns whose bits are not those of the file.

    If its code is the same as here, they must be.
    """
    table = integrate()
    golden = pq.read_table(GOLDEN)
    then = json.loads(golden.schema.metadata[b"origin"])["code"]
    differing = [name for name, value in code().items() if value != then[name]]
    others = []
    for name in golden.column_names:
        if not table[name].equals(golden[name]):
            rows = pc.not_equal(table[name], golden[name])
            others.append(f"{name} ({pc.sum(rows)} of {len(golden)} rows)")
    print(json.dumps(versions() | machine()))
    print("golden sweep: made with other", ", ".join(differing) or "nothing")
    print("golden sweep: other bits in", ", ".join(others) or "no column")


if __name__ == "__main__":
    if sys.argv[1:] == ["--compare"]:
        compare()
    else:
        make(Path(sys.argv[1]) if len(sys.argv) > 1 else GOLDEN)
