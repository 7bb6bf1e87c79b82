"""Directories of the same runs differ as pandas finds, and those of others are
refused.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
import pytest
from editing import edited, replaced
from refusal import assert_refused
from sweeping import invoke

import rattlesweep as rs

CONFIG: dict[str, Any] = {
    "seed": 3,
    "bodies": {
        "source": "sd",
        "samples": 8,
        "target": {"K_r": [0.02, 0.1], "rel_tol": 0.05},
    },
    "spin": {"n_i": [-0.3, 0.4], "omega_xy0": [0.02, 0.1]},
    "horizon": {"t_rgh": 3, "t": 1500},
}
PARTS: dict[str, dict[str, Any]] = {
    "a": {"integrator": {"tol": 1e-9}},
    "b": {"integrator": {"tol": 1e-7, "max_steps": 1500}},
    "ea": {"integrator": {"tol": 1e-9}, "record": ["error"]},
    "eb": {"integrator": {"tol": 1e-7}, "record": ["error"]},
}


@pytest.fixture(scope="module")
def sweeps(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The same 64 runs at two tolerances, and with a limit that some of them reach."""
    root = tmp_path_factory.mktemp("compare")
    for name, part in PARTS.items():
        rs.sweep(CONFIG | part, output=root / name, threads=1)
    return root


def joined(a: Path, b: Path) -> pd.DataFrame:
    one, other = (pd.read_parquet(directory / "runs") for directory in (a, b))
    return one.merge(other, on=["case", "sample"], suffixes=("_a", "_b"))


def told(*args: Any, code: int = 0) -> dict[str, Any]:
    done = invoke("compare", *args, "--json")
    assert done.exit_code == code, done.stderr
    return json.loads(done.stdout)  # type: ignore[no-any-return]


def test_the_table_and_the_data_are_what_pandas_finds(sweeps, tmp_path):
    a = sweeps / "a"
    b = sweeps / "b"
    rows = joined(a, b)
    ok = (rows.status_a == "ok") & (rows.status_b == "ok")
    rows["relative"] = (
        (rows.t_r_b - rows.t_r_a).abs() / (rows.t_r_a + rows.t_r_b) * 2
    ).where(ok)
    rows["differs"] = ok & (rows.type_a != rows.type_b)
    data = tmp_path / "data.csv"
    found = told(a, b, "--data", data)
    assert found["missing"] == [0, 0]
    assert any(
        words.startswith("integrator.tol: 1e-09 against 1e-07")
        for words in found["differ"]
    )
    parts = [(case, rows[rows.case == case["case"]]) for case in found["cases"]]
    assert len(parts) == rows.case.nunique()
    for row, own in [*parts, (found["total"], rows)]:
        relative = own.relative.dropna()
        assert (row["runs"], row["reversing"]) == (len(own), len(relative))
        assert (row["equal"], row["types"]) == (
            (relative == 0).sum(),
            own.differs.sum(),
        )
        assert row["failed"] == len(own) - ok[own.index].sum()
        assert row["beyond"] is row["types_sure"] is None
        for name, share in (("median", 0.5), ("p99", 0.99), ("worst", 1.0)):
            exact = (
                [np.quantile(relative, share, method="inverted_cdf")]
                if len(relative)
                else []
            )
            assert [row[name]] == (exact or [None])
    assert found["total"]["reversing"] > 30
    assert found["total"]["failed"] > 0
    written = pd.read_csv(data)
    for name in ("case", "sample", "t_r_a", "t_r_b", "type_a", "type_b"):
        pd.testing.assert_series_equal(written[name], rows[name], check_dtype=False)
    assert written[["t_r_error_a", "over_errors", "type_sure_b"]].isna().all(axis=None)
    # The order of the two does not matter.
    back = told(b, a)
    assert (back["total"], back["cases"]) == (found["total"], found["cases"])


def with_errors(source: Path, target: Path, error: float, sure: bool = True) -> Path:
    """Copy a directory whose runs then have these errors relative to their t_r."""

    def change(rows: pa.Table) -> pa.Table:
        t_r = rows.column("t_r").to_numpy()
        rows = replaced(
            rows, "t_r_error", list(pa.array(error * t_r, from_pandas=True))
        )
        return replaced(rows, "type_sure", [sure] * len(rows))

    return edited(source, target, change)


def test_runs_beyond_both_errors_are_counted_and_listed_first(sweeps, tmp_path):
    a = with_errors(sweeps / "ea", tmp_path / "$a", 3e-8)
    b = with_errors(sweeps / "eb", tmp_path / "b$", 4e-8)
    rows = joined(a, b)
    over = (rows.t_r_b - rows.t_r_a).abs() / np.hypot(
        rows.t_r_error_a, rows.t_r_error_b
    )
    beyond = int((over > 1).sum())
    share = beyond / over.notna().sum()
    assert 0.005 < share < 1
    found = told(a, b, code=1)
    assert found["total"]["beyond"] == beyond
    first = found["differing"][0]
    worst = rows.loc[over.idxmax()]
    assert (first["case"], first["sample"]) == (worst["case"], worst["sample"])
    assert first["over_errors"] == pytest.approx(over.max())
    figure = tmp_path / "figure.svg"
    assert (
        invoke("compare", a, b, "--allow", share * 1.01, "--figure", figure).exit_code
        == 0
    )
    assert figure.exists()
    assert invoke("compare", a, b, "--allow", share * 0.99).exit_code == 1
    # Without errors on both sides nothing is beyond them.
    assert "add record: [error]" in invoke("compare", a, sweeps / "b").stdout


@pytest.mark.parametrize("sure", [True, False])
def test_types_that_are_sure_must_not_differ(sweeps, tmp_path, sure):
    a = with_errors(sweeps / "ea", tmp_path / "a", 1.0)
    b = with_errors(sweeps / "ea", tmp_path / "b", 1.0, sure)

    def change(rows: pa.Table) -> pa.Table:
        types = rows["type"].to_pylist()
        return replaced(rows, "type", ["SW" if types[0] != "SW" else "SS", *types[1:]])

    found = told(a, edited(b, tmp_path / "changed", change), code=int(sure))
    # Each file of rows has one.
    assert found["total"]["types"] == len(list((b / "runs").iterdir()))
    assert found["total"]["types_sure"] == sure * found["total"]["types"]
    assert found["differing"][0]["type_a"] != found["differing"][0]["type_b"]


def test_of_partial_directories_what_both_have_is_compared(sweeps, tmp_path):
    a = edited(sweeps / "a", tmp_path / "a", lambda rows: rows[28:])
    found = told(a, sweeps / "b")
    assert found["missing"] == [28, 0]
    assert found["total"]["runs"] == len(joined(a, sweeps / "b"))


def test_a_sweep_that_has_grown_is_compared_by_the_runs_of_both(sweeps, tmp_path):
    more = CONFIG | PARTS["b"] | {"spin": {"n_i": [-0.3, 0.2, 0.4], "omega_xy0": 0.02}}
    more["bodies"] = CONFIG["bodies"] | {"samples": 11}
    rs.sweep(more, output=tmp_path / "grown", threads=1)
    for pair in (
        (sweeps / "a", tmp_path / "grown"),
        (tmp_path / "grown", sweeps / "a"),
    ):
        found = told(*pair)
        # Two targets, two spins, one push, eight samples.
        assert found["total"]["runs"] == 32
        assert found["missing"] == [0, 0]
    whole = told(sweeps / "a", sweeps / "b")
    common = [row["worst"] for row in whole["cases"] if row["omega_xy0"] == 0.02]
    assert found["total"]["worst"] == max(common)
    text = invoke("compare", sweeps / "a", tmp_path / "grown")
    assert "all 64 runs, of which 32 are in both" in text.stdout
    rs.sweep(
        more | {"spin": {"n_i": 0.1, "omega_xy0": 0.3}},
        output=tmp_path / "x",
        threads=1,
    )
    done = invoke("compare", sweeps / "a", tmp_path / "x")
    assert_refused(done, 2, "no case is in both")


def test_directories_of_other_runs_are_refused(sweeps, tmp_path):
    for key, part in (("seed", {"seed": 7}), ("horizon.t", {"horizon": {"t": 30.0}})):
        rs.sweep(CONFIG | part, output=tmp_path / key, threads=1)
        done = invoke(
            "compare", sweeps / "a", tmp_path / key, "--data", tmp_path / "x.csv"
        )
        assert_refused(done, 2, f"{key}: ")
        assert not (tmp_path / "x.csv").exists()


def test_tables_are_told_apart_by_their_rows(tmp_path):
    table = pd.DataFrame(
        {
            "alpha": 13.04,
            "beta": 1.522,
            "gamma": 12.28,
            "theta": [0.82, 0.8],
            "phi": 0.036,
            "xi": -0.03,
            "n_i": 0.1,
            "omega_xy0": 0.01,
            "t_end": 20.0,
        }
    )
    for name, theta in (("one", 0.8), ("moved", 0.8), ("other", 0.81)):
        path = tmp_path / f"{name}.csv"
        table.assign(theta=[0.82, theta]).to_csv(path)
        rs.sweep(
            {"bodies": {"source": "table", "path": str(path)}}, output=tmp_path / name
        )
    assert told(tmp_path / "one", tmp_path / "moved")["total"]["runs"] == 2
    done = invoke("compare", tmp_path / "one", tmp_path / "other")
    assert_refused(done, 2, "case 0, sample 1: theta: 0.8 against 0.81")


def test_models_are_compared_as_models(sweeps, tmp_path):
    """Types against types, and ratios of the times; no errors are spoken of."""
    other = tmp_path / "gh"
    rs.sweep(CONFIG | {"model": "gh"}, output=other, threads=1)
    rows = joined(sweeps / "ea", other)
    figure = tmp_path / "figure.png"
    found = told(sweeps / "ea", other, "--figure", figure)
    assert figure.stat().st_size > 1000
    assert found["of_models"]
    assert 'model: "full" against "gh"' in found["differ"]
    total = found["total"]
    assert total["beyond"] is total["types_sure"] is None
    table = pd.crosstab(rows.type_a, rows.type_b)
    for first, counts in found["types"].items():
        for second, count in counts.items():
            expected = 0
            if first in table.index and second in table.columns:
                expected = table.loc[first, second]
            assert count == expected
    assert sum(map(sum, (row.values() for row in found["types"].values()))) == 64
    ratio = (rows.t_r_b / rows.t_r_a).dropna()
    names = ("ratio_p5", "ratio_median", "ratio_p95")
    expected = np.percentile(ratio, [5, 50, 95]).tolist()
    assert [total[name] for name in names] == pytest.approx(expected)
    text = invoke("compare", sweeps / "ea", other)
    assert (text.exit_code, text.stderr) == (0, "")
    assert "of the models, not errors" in text.stdout


def test_each_friction_is_compared_with_none(sweeps, tmp_path):
    with_friction = CONFIG | {"dissipation": {"sigma": [1e-4, 1e-2]}}
    rs.sweep(with_friction, output=tmp_path / "damped", threads=1)
    found = told(sweeps / "a", tmp_path / "damped", "--data", tmp_path / "d.parquet")
    runs = pd.read_parquet(tmp_path / "d.parquet")
    assert len(runs) == found["total"]["runs"] == 128
    plain = rs.load(sweeps / "a").runs.set_index(["case", "sample"])
    damped = rs.load(tmp_path / "damped").runs.set_index(["case", "sample"])
    assert [case["sigma"] for case in found["cases"]] == 8 * [1e-4, 1e-2]
    for run in runs.itertuples():
        # The same body after the same launch.
        first = plain.loc[run.case, run.sample]
        second = damped.loc[run.case_b, run.sample]
        launch = ["alpha", "beta", "gamma", "theta", "phi", "xi", "n_i", "omega_xy0"]
        assert first[launch].tolist() == second[launch].tolist()
        known = first["t_r"] == run.t_r_a or (
            pd.isna(run.t_r_a) and pd.isna(first["t_r"])
        )
        assert known
    # Each friction with itself, at another tolerance.
    looser = with_friction | {"integrator": {"tol": 1e-8}}
    rs.sweep(looser, output=tmp_path / "looser", threads=1)
    alike = told(tmp_path / "damped", tmp_path / "looser")
    assert not alike["of_models"]
    assert alike["total"]["worst"] < 1e-5
    assert [case["sigma"] for case in alike["cases"]] == 8 * [1e-4, 1e-2]
    back = invoke("compare", tmp_path / "damped", sweeps / "a")
    assert_refused(back, 2, "each launch of the second needs one case in the first")
