"""The summary agrees with pandas, and does not depend on how runs are spread over
files.
"""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
import pytest
import scipy.stats
from random_rows import SCHEMA, random_columns

import rattlesweep as rs
from rattlesweep.design.cases import Case
from rattlesweep.rows.arrow import build_table, same_schema
from rattlesweep.statistics.intervals import wilson
from rattlesweep.store import rows as stored_module
from rattlesweep.store import summary as summary_module
from rattlesweep.store.parquet import read_parquet
from rattlesweep.store.rows import Stored, open_stored
from rattlesweep.store.summary import Moments, closing_table, summarise, write_summary
from rattlesweep.work.verify import verify

CASES = (
    Case(0, "K_r", 0.01, -0.1, 0.01),
    Case(1, "K_p", 0.3, -0.1, 0.01),
    Case(2, None, None, None, None),
)


def fill(
    directory: Path, size: int, rows: int = 1000, seed: int = 1, cases: Any = CASES
) -> Any:
    """Write the same rows to files of `size` rows, and return them as a stored
    sweep.
    """
    case = np.sort(np.random.default_rng(seed).integers(0, 3, rows))
    sample = np.arange(rows) - np.searchsorted(case, case)
    return write(directory, random_columns(case, sample, seed), size, cases)


def write(
    directory: Path, columns: dict[str, Any], size: int = 10**9, cases: Any = CASES
) -> Any:
    table = build_table(columns, SCHEMA)
    config: Any = SimpleNamespace(parts=[], model="full", deciding_key=None)
    samples = int(columns["sample"].max()) + 1
    stored = Stored(config, cases, samples, (), directory, {}, "sweep")
    (directory / "runs").mkdir(parents=True)
    for start in range(0, len(table), size):
        stored.append(table[start : start + size], "{}")
    return stored


def oracle(runs: pd.DataFrame) -> dict[str, float]:
    """Summary of the runs of one case, by pandas."""
    ok = runs[runs["status"] == "ok"]
    reversed_ = ok[ok["type"] == "R"]
    reversals = reversed_["t_r"]
    ratio = (reversals / reversed_["t_rgh"])[reversed_["t_rgh"] > 0]
    steady = runs["omega_p"].notna() & ~(runs["K_p"] * runs["n_i"] > 0)
    bondi = runs["n_c1"].abs() < runs["n_i"].abs()
    return {
        "runs": len(runs),
        **{
            f"fraction_{t}": (ok["type"] == t).mean()
            for t in ("R", "SS", "SW", "unclassified")
        },
        "fraction_bondi": (bondi & steady).sum() / steady.sum(),
        "t_r_mean": reversals.mean(),
        "t_r_std": reversals.std(),
        "t_rgh_mean": runs["t_rgh"].mean(),
        "t_r_over_t_rgh_mean": ratio.mean(),
        "t_r_over_t_rgh_sem": ratio.sem(),
        "failed": (runs["status"] != "ok").sum(),
        "near_tangencies": runs["near_tangencies"].sum(),
    }


@pytest.mark.parametrize(
    ("seed", "size", "rows"), [(1, 300, 2000), (2, 1 << 18, (1 << 17) + 5)]
)
def test_against_pandas(tmp_path, seed, size, rows):
    stored = fill(
        tmp_path, size, rows, seed=seed
    )  # the second case has more than a row group
    summary = summarise(stored)
    assert same_schema(summary.schema, summary_module.SCHEMA)
    runs = pd.read_parquet(tmp_path / "runs")
    for row, (_, group) in zip(summary.to_pylist(), runs.groupby("case"), strict=True):
        for name, value in oracle(group).items():
            assert row[name] == pytest.approx(value, rel=1e-12), name
    assert summary.column("case").to_pylist() == [0, 1, 2]
    assert summary.column("K_r").to_pylist() == [0.01, None, None]
    assert summary.column("n_i").to_pylist() == [-0.1, -0.1, None]
    assert write_summary(stored).equals(summary)
    path = tmp_path / "summary.parquet"
    assert pd.read_parquet(path).equals(summary.to_pandas())
    assert read_parquet(path).schema.field("t_r_mean").metadata[b"unit"] == b"sqrt(a/g)"


def test_how_rows_lie_in_files_does_not_show(tmp_path, monkeypatch):
    monkeypatch.setattr(stored_module, "BATCH_ROWS", 700)
    tables = [summarise(fill(tmp_path / str(n), n, 3000)) for n in (3000, 1024, 100)]
    # Each file has every seventh row, as after a retry of failed runs.
    stored = fill(tmp_path / "cut", 10**9, 3000)
    (path,) = stored.files()
    rows = read_parquet(path)
    path.unlink()
    for part in range(7):
        chosen = np.arange(part, len(rows), 7)
        stored.append(rows.take(pa.array(chosen)), "{}")
    tables.append(summarise(stored))
    assert all(table.equals(tables[0]) for table in tables)


NAN = np.nan


@pytest.mark.parametrize(
    ("n_c1", "n_i", "omega_p", "expected"),
    [
        ([-0.2, -0.4, NAN], [-0.3, -0.3, -0.3], [1, 1, 1], 1 / 3),
        ([-0.2, -0.4, NAN], [-0.3, -0.3, -0.3], [1, 1, NAN], 1 / 2),
        ([-0.2, -0.4, NAN], [-0.3, -0.3, -0.3], [NAN, 1, 1], 0),
        ([NAN, NAN, NAN], [-0.3, -0.3, -0.3], [NAN, NAN, NAN], None),
        # Only runs in the steady direction count.
        ([-0.2, -0.2, -0.2], [0.6, 0.6, 0.6], [1, 1, 1], None),
    ],
)
def test_bondi_share(n_c1, n_i, omega_p, expected, tmp_path):
    for sign in (1, -1):  # mirror images are steady where n is positive
        columns = random_columns(np.zeros(3, int), np.arange(3))
        spins = {"n_c1": sign * np.array(n_c1), "n_i": sign * np.array(n_i)}
        columns |= spins | {
            "omega_p": np.array(omega_p, float),
            "K_p": np.full(3, sign * 0.3),
        }
        summary = summarise(write(tmp_path / str(sign), columns, cases=CASES[:1]))
        assert summary["fraction_bondi"].to_pylist() == [expected]


def test_cases_not_yet_run(tmp_path):
    summary = summarise(write(tmp_path, random_columns(np.ones(3, int), np.arange(3))))
    assert summary["runs"].to_pylist() == [0, 3, 0]
    assert summary["fraction_R"].null_count == 2
    assert "NaN" not in closing_table(summary)


def test_moments_do_not_lose_digits_over_many_pieces():
    rng = np.random.default_rng(3)
    cell = rng.integers(0, 5, 3000)
    values = 1e7 + rng.normal(size=3000)
    moments = Moments(6)
    for start in range(0, 3000, 37):
        moments.add(cell[start : start + 37], values[start : start + 37])
    parts = [values[cell == k] for k in range(5)]
    assert moments.means()[:5] == pytest.approx(
        [part.mean() for part in parts], rel=1e-14
    )
    assert moments.deviations()[:5] == pytest.approx(
        [p.std(ddof=1) for p in parts], rel=1e-12
    )
    assert np.isnan([moments.means()[5], moments.errors()[5]]).all()


def test_wilson_against_scipy():
    part = np.array([0, 7, 1, 245, 1, 0])
    whole = np.array([7, 7, 7, 1000, 1, 0])
    low, high = wilson(part, whole)
    for k in range(5):
        expected = scipy.stats.binomtest(part[k], whole[k]).proportion_ci(
            0.95, method="wilson"
        )
        assert (low[k], high[k]) == pytest.approx(tuple(expected), abs=1e-12)
    assert np.isnan([low[5], high[5]]).all()
    assert (low[0], high[1]) == (0, 1)


def test_shares_are_those_of_the_rows(tmp_path):
    config = {
        "bodies": {"source": "sd", "samples": 12},
        "record": ["contact"],
        "spin": {"n_i": [0.2, 1.0], "omega_xy0": [0.01, 0.5]},
        "horizon": {"t": 60},
    }
    sweep = rs.sweep(config, output=tmp_path)
    runs = sweep.runs[sweep.runs.status == "ok"]
    summary = sweep.summary.set_index("case")
    ratio = runs.contact_ratio_max
    normal = runs.contact_normal_min
    for name, true in (
        ("friction_above_0_3", ratio > 0.3),
        ("friction_above_0_6", ratio > 0.6),
        ("lift_off", normal < 0),
    ):
        share = summary[f"share_{name}"]
        assert share.tolist() == pytest.approx(true.groupby(runs.case).mean().tolist())
        assert share.nunique() > 1
    head = closing_table(summarise(open_stored(tmp_path))).splitlines()[0]
    assert all(words in head for words in ("friction>0.3", "friction>0.6", "lift-off"))
    assert not list(verify(tmp_path).problems)


MAPS: dict[str, Any] = {
    "bodies": {
        "source": "grid",
        "base": {"preset": "GH"},
        "axes": {
            "theta": {"linspace": [0.6, 0.97, 33]},
            "phi": {"linspace": [0.01, 0.1, 17]},
        },
    },
    "spin": {"n_i": [-0.3, 0.2], "omega_xy0": [0.01, 0.1]},
    "model": "gh",
    "horizon": {"t": 2000},
}


@pytest.mark.parametrize(
    ("by", "of_mean", "of_deviation"), [("type", 0.004, 0.02), ("t_r", 0.004, 0.02)]
)
def test_means_of_a_refined_map_are_those_of_the_full_grid(
    by, of_mean, of_deviation, tmp_path
):
    full = rs.sweep(MAPS, output=tmp_path / "full").summary
    bodies = MAPS["bodies"] | {"refine": {"levels": 2, "by": by}}
    sweep = rs.sweep(MAPS | {"bodies": bodies}, output=tmp_path / "refined")
    refined = sweep.summary
    assert refined.runs.sum() < 0.3 * full.runs.sum()
    assert (refined.fraction_R - full.fraction_R).abs().max() < 0.01
    for name in ("t_r_mean", "t_rgh_mean", "t_r_over_t_rgh_mean"):
        assert (refined[name] / full[name] - 1).abs().max() < of_mean, name
    assert (refined.t_r_std / full.t_r_std - 1).abs().max() < of_deviation
