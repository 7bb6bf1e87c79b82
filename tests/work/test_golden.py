"""A committed sweep: the numbers of today are those of the day it was made.

Exact to the last bit with the code that `tests/golden/make.py` ran with, which is for
processors with AVX2. Elsewhere, within tolerances that were measured by
compiling the kernels for a processor without fused multiply-add: reversal times
differed by 6e-8 at most, and by 1e-15 in the median.
"""

from __future__ import annotations

import json
import os
import runpy
import subprocess
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pytest

import rattlesweep as rs
from rattlesweep.store.rows import open_stored, same_bits

HERE = Path(__file__).parents[1] / "golden"
GOLDEN = HERE / "golden.parquet"
MAKING = runpy.run_path(str(HERE / "make.py"))

# Of what was measured times ten or more: relative and absolute. End states and drifts
# are rounding itself, and compared on their own scale.
CLOSE = {
    "t_r": (1e-6, 0),
    "t_end": (1e-6, 0),
    "n_end": (0, 1e-6),
    "n_departure": (1e-4, 1e-7),
    "n_steps": (1e-2, 0),
    "energy_drift": (0, 1e-7),
    "contact_ratio_max": (1e-2, 0),
    "contact_normal_min": (0, 1e-3),
}
THEORY = (
    "alpha",
    "beta",
    "gamma",
    "theta",
    "phi",
    "xi",
    "f_sd",
    "n_i",
    "omega_xy0",
    "psi",
    "omega_p",
    "omega_r",
    "K_p",
    "K_r",
    "n_c1",
    "n_0",
    "t_rgh",
    "energy_0",
)


def assert_close(now: pd.DataFrame, then: pd.DataFrame) -> None:
    """Compare all numbers, and those of sensitive runs (docs/accuracy.md) within their
    errors.
    """
    assert list(now.columns) == list(then.columns)
    for name in ("case", "sample", "type", "status", "near_tangencies"):
        assert now[name].equals(then[name]), name
    for name in THEORY:
        np.testing.assert_allclose(now[name], then[name], rtol=1e-12, err_msg=name)
    kept = ~(then.t_r_error > 1e-6 * then.t_r)
    assert kept.sum() > 0.9 * len(then)
    apart = (now.t_r - then.t_r).abs()
    errors = now.t_r_error + then.t_r_error
    assert (apart[~kept] <= errors[~kept]).all()
    now = now[kept]
    then = then[kept]
    for name, (rtol, atol) in CLOSE.items():
        np.testing.assert_allclose(now[name], then[name], rtol, atol, err_msg=name)
    assert (now.t_r / then.t_r - 1).abs().median() < 1e-12


def test_the_golden_sweep_comes_out_again(tmp_path):
    now = open_stored(
        rs.sweep(HERE / "golden.yaml", output=tmp_path / "out").directory
    ).read()
    golden = pq.read_table(GOLDEN)
    origin = json.loads(golden.schema.metadata[b"origin"])
    if origin["code"] == MAKING["code"]():
        assert same_bits(now, golden)
    then = golden.to_pandas()
    assert_close(now.to_pandas(), then)
    assert set(then.type) == {"R", "SS", "SW", "unclassified"}
    assert then.n_i.min() < 0 < then.n_i.max()


@pytest.mark.slow
def test_on_another_type_of_processor(tmp_path):
    """Compiled without fused multiply-add, which no machine of today is without."""
    target = tmp_path / "generic.parquet"
    environment = {**os.environ, "NUMBA_CPU_NAME": "generic"}
    subprocess.run(
        [sys.executable, HERE / "make.py", target],
        env=environment,
        check=True,
        timeout=900,
    )
    now = pd.read_parquet(target)
    then = pd.read_parquet(GOLDEN)
    assert not now.equals(then)
    assert_close(now, then)
