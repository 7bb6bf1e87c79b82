"""A committed sweep: the numbers of today are those of the day it was made.

Exact to the last bit on the type of machine and the versions that `tests/golden/make.py` ran
with. Elsewhere, within tolerances that were measured by compiling the kernels for a processor
without fused multiply-add: reversal times differed by 6e-8 at most, and by 1e-15 in the median.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pytest

import rattlesweep as rs
from rattlesweep.sweeps.inspect.content_hash import content_hash

HERE = Path(__file__).parents[1] / "golden"
GOLDEN = HERE / "golden.parquet"

# Relative, of what was measured times ten or more. What is not named is an end state or a drift,
# which is rounding itself, and compared on its own scale below.
THEORY = ("alpha", "beta", "gamma", "theta", "phi", "xi", "f_sd", "n_i", "omega_xy0", "psi",
          "omega_p", "omega_r", "K_p", "K_r", "n_c1", "n_0", "t_rgh", "energy_0")  # fmt: skip


@pytest.fixture(scope="module")
def today(tmp_path_factory: pytest.TempPathFactory) -> rs.Sweep:
    return rs.sweep(HERE / "golden.yaml", output=tmp_path_factory.mktemp("golden") / "out")


def origin_of(path: Path) -> dict[str, Any]:
    return json.loads(pq.read_schema(path).metadata[b"origin"])


def ordinary(rows: pd.DataFrame) -> pd.Series:
    """Which runs are not sensitive."""
    return ~(rows.t_r_error > 1e-6 * rows.t_r)


def assert_close(now: pd.DataFrame, then: pd.DataFrame) -> None:
    """Compare all numbers, and those of sensitive runs (docs/sensitive.md) within their errors."""
    assert list(now.columns) == list(then.columns)
    for name in ("case", "sample", "type", "status", "near_tangencies"):
        assert now[name].equals(then[name]), name
    for name in THEORY:
        np.testing.assert_allclose(now[name], then[name], rtol=1e-12, err_msg=name)
    kept = ordinary(then)
    assert kept.sum() > 0.9 * len(then)
    apart, errors = (now.t_r - then.t_r).abs(), now.t_r_error + then.t_r_error
    assert (apart[~kept] <= errors[~kept]).all()
    now, then = now[kept], then[kept]
    for name in ("t_r", "t_end"):
        np.testing.assert_allclose(now[name], then[name], rtol=1e-6, err_msg=name)
    change = (now.t_r / then.t_r - 1).abs().median()
    assert change < 1e-12
    np.testing.assert_allclose(now.n_end, then.n_end, atol=1e-6)
    np.testing.assert_allclose(now.n_departure, then.n_departure, rtol=1e-4, atol=1e-7)
    np.testing.assert_allclose(now.n_steps, then.n_steps, rtol=1e-2)
    np.testing.assert_allclose(now.energy_drift, then.energy_drift, atol=1e-7)
    np.testing.assert_allclose(now.contact_ratio_max, then.contact_ratio_max, rtol=1e-2)
    np.testing.assert_allclose(now.contact_normal_min, then.contact_normal_min, atol=1e-3)


def test_the_golden_sweep_comes_out_again(today):
    origin, manifest = origin_of(GOLDEN), today.manifest
    same = all(
        origin["versions"][name] == manifest["versions"][name]
        for name in ("numpy", "numba", "llvmlite")
    )
    if same and origin["machine"]["cpu"] == manifest["machine"]["cpu"]:
        assert content_hash(today.directory) == origin["content_hash"]
    assert_close(today.runs, pd.read_parquet(GOLDEN))


def test_it_holds_something_of_everything():
    then = pd.read_parquet(GOLDEN)
    assert set(then.type) == {"R", "SS", "SW", "unclassified"}
    assert then.n_i.min() < 0 < then.n_i.max()
    assert then.n_steps.max() > 20 * then.n_steps.min()


@pytest.mark.parametrize(
    ("name", "change"), [("t_r", 1e-5), ("n_0", 1e-11), ("n_end", 1e-5), ("energy_drift", 1e-6)]
)
def test_the_tolerances_notice_a_change(name, change):
    then = pd.read_parquet(GOLDEN)
    now = then.copy()
    row = now[name][ordinary(now)].first_valid_index()
    now.loc[row, name] = now.loc[row, name] * (1 + change) + (change if name[0] in "ne" else 0)
    with pytest.raises(AssertionError):
        assert_close(now, then)


@pytest.mark.slow
def test_on_another_type_of_processor(tmp_path):
    """Compiled without fused multiply-add, which no machine of today is without."""
    target = tmp_path / "generic.parquet"
    environment = {**os.environ, "NUMBA_CPU_NAME": "generic"}
    subprocess.run([sys.executable, HERE / "make.py", target], env=environment, check=True)
    now, then = pd.read_parquet(target), pd.read_parquet(GOLDEN)
    assert not now.equals(then)
    assert_close(now, then)
