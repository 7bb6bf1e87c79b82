"""Directories of the same runs differ as pandas finds, and those of others are refused."""

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
    "bodies": {"source": "sd", "samples": 8, "target": {"K_r": [0.02, 0.1], "rel_tol": 0.05}},
    "spin": {"n_i": [-0.3, 0.4], "omega_xy0": [0.02, 0.1]},
    "horizon": {"t_rgh": 3, "t": 1500},
}
PARTS: dict[str, dict[str, Any]] = {
    "a": {"integrator": {"tol": 1e-9}},
    "b": {"integrator": {"tol": 1e-7}},
    "c": {"integrator": {"tol": 1e-7, "max_steps": 1500}},
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
    """Runs that both directories have."""
    one, other = (pd.read_parquet(directory / "runs") for directory in (a, b))
    return one.merge(other, on=["case", "sample"], suffixes=("_a", "_b"))


def told(*args: Any, code: int = 0) -> dict[str, Any]:
    """What the command says as JSON."""
    done = invoke("compare", *args, "--json")
    assert done.exit_code == code, done.stderr
    return json.loads(done.stdout)  # type: ignore[no-any-return]


@pytest.mark.parametrize("other", ["b", "c"])
def test_the_table_and_the_data_are_what_pandas_finds(sweeps, tmp_path, other):
    a, b = sweeps / "a", sweeps / other
    rows = joined(a, b)
    ok = (rows.status_a == "ok") & (rows.status_b == "ok")
    rows["relative"] = ((rows.t_r_b - rows.t_r_a).abs() / (rows.t_r_a + rows.t_r_b) * 2).where(ok)
    rows["differs"] = ok & (rows.type_a != rows.type_b)
    data = tmp_path / {"b": "data.csv", "c": "data.parquet"}[other]
    found = told(a, b, "--data", data)
    assert found["missing"] == [0, 0]
    assert any(words.startswith("integrator.tol: 1e-09 against 1e-07") for words in found["differ"])
    parts = [(case, rows[rows.case == case["case"]]) for case in found["cases"]]
    assert len(parts) == rows.case.nunique()
    for row, own in [*parts, (found["total"], rows)]:
        relative = own.relative.dropna().sort_values()
        assert row["runs"] == len(own)
        assert row["reversing"] == len(relative)
        assert row["equal"] == (relative == 0).sum()
        assert row["types"] == own.differs.sum()
        assert row["not_ok"] == len(own) - ok[own.index].sum()
        assert row["beyond"] is row["types_sure"] is None
        if not len(relative):
            assert row["median"] is row["p99"] is row["worst"] is None
            continue
        assert row["worst"] == relative.max()
        for name, share in (("median", 0.5), ("p99", 0.99)):
            exact = np.quantile(relative, share, method="inverted_cdf")
            assert row[name] == pytest.approx(exact, rel=1e-12)
    assert found["total"]["reversing"] > 30
    worst = rows.nlargest(10, "relative")[["case", "sample"]]
    listed = [[run["case"], run["sample"]] for run in found["differing_times"]]
    assert listed == worst.to_numpy().tolist()
    assert (found["total"]["not_ok"] > 0) == (other == "c")
    written = pd.read_csv(data) if other == "b" else pd.read_parquet(data)
    for name in ("case", "sample", "t_r_a", "t_r_b", "type_a", "type_b"):
        pd.testing.assert_series_equal(written[name], rows[name], check_dtype=False)
    exact = (rows.t_r_b - rows.t_r_a).where(rows.status_b == "ok")
    np.testing.assert_allclose(written.dt_r, exact, rtol=1e-12)
    assert written[["t_r_error_a", "over_errors", "type_sure_b"]].isna().all(axis=None)
    # The order of the two does not matter.
    back = told(b, a)
    assert (back["total"], back["cases"]) == (found["total"], found["cases"])


def with_errors(source: Path, target: Path, error: float, sure: bool = True) -> Path:
    """Copy a directory whose runs then have these errors relative to their t_r."""

    def change(rows: pa.Table) -> pa.Table:
        t_r = rows.column("t_r").to_numpy()
        rows = replaced(rows, "t_r_error", list(pa.array(error * t_r, from_pandas=True)))
        return replaced(rows, "type_sure", [sure] * len(rows))

    return edited(source, target, change)


def test_runs_beyond_both_errors_are_counted_and_listed_first(sweeps, tmp_path):
    a = with_errors(sweeps / "ea", tmp_path / "$a", 3e-8)
    b = with_errors(sweeps / "eb", tmp_path / "b$", 4e-8)
    rows = joined(a, b)
    over = (rows.t_r_b - rows.t_r_a).abs() / np.hypot(rows.t_r_error_a, rows.t_r_error_b)
    beyond = int((over > 1).sum())
    share = beyond / over.notna().sum()
    assert 0.005 < share < 1
    found = told(a, b, code=1)
    assert found["total"]["beyond"] == beyond
    first, worst = found["beyond_errors"][0], rows.loc[over.idxmax()]
    assert (first["case"], first["sample"]) == (worst["case"], worst["sample"])
    assert first["over_errors"] == pytest.approx(over.max())
    # Each list is sorted by what it says.
    relative = [run["relative"] for run in found["differing_times"]]
    assert relative == sorted(relative, reverse=True)
    assert relative[0] == found["total"]["worst"]
    figure = tmp_path / "figure.svg"
    assert invoke("compare", a, b, "--allow", share * 1.01, "--figure", figure).exit_code == 0
    assert figure.read_bytes().startswith(b"<?xml")
    assert invoke("compare", a, b, "--allow", share * 0.99).exit_code == 1


def test_beyond_errors_of_nothing_is_any_difference(sweeps, tmp_path):
    a, b = (with_errors(sweeps / f"e{name}", tmp_path / name, 0.0) for name in "ab")
    figure = tmp_path / "figure.png"
    assert told(a, a, "--figure", figure)["total"]["beyond"] == 0
    assert figure.read_bytes().startswith(b"\x89PNG")
    found = told(a, b, code=1)
    assert found["total"]["beyond"] == found["total"]["reversing"] - found["total"]["equal"]
    assert len(found["differing_times"]) == 10
    # Where one has no errors, it is said how to have them.
    done = invoke("compare", a, sweeps / "b")
    assert done.exit_code == 0
    assert "\nB: no errors stored; add record: [error]\n" in done.stdout


@pytest.mark.parametrize(("sure", "code"), [(True, 1), (False, 0)])
def test_types_that_are_sure_must_not_differ(sweeps, tmp_path, sure, code):
    a = with_errors(sweeps / "ea", tmp_path / "a", 1.0)
    b = with_errors(sweeps / "ea", tmp_path / "b", 1.0, sure)
    old = pd.read_parquet(sweeps / "a" / "runs").sort_values(["case", "sample"])["type"].iloc[2]
    new = "SW" if old != "SW" else "SS"

    def change(rows: pa.Table) -> pa.Table:
        keys = zip(rows["case"].to_pylist(), rows["sample"].to_pylist(), strict=True)
        types = zip(keys, rows["type"].to_pylist(), strict=True)
        return replaced(rows, "type", [new if key == (0, 2) else was for key, was in types])

    b = edited(b, tmp_path / "changed", change)
    found = told(a, b, code=code)
    assert (found["total"]["types"], found["total"]["types_sure"]) == (1, int(sure))
    (run,) = found["differing_types"]
    assert (run["case"], run["sample"], run["type_a"], run["type_b"]) == (0, 2, old, new)


def test_of_partial_directories_what_both_have_is_compared(sweeps, tmp_path):
    a = edited(sweeps / "a", tmp_path / "a", lambda rows: rows[28:])
    b = edited(sweeps / "b", tmp_path / "b", lambda rows: rows[: len(rows) - 22])
    found = told(a, b)
    assert found["missing"] == [28, 22]
    assert found["total"]["runs"] == len(joined(a, b))
    assert "28 of 64 runs are missing" in invoke("compare", a, b).stdout


GH = {
    "bodies": {"source": "preset", "name": "GH"},
    "spin": {"n_i": [0.1, 0.2], "omega_xy0": 0.01},
    "horizon": {"t": 20.0},
}
OTHERS = {
    "seed": {"seed": 7},
    "bodies.overrides.theta": {"bodies": {**GH["bodies"], "overrides": {"theta": 0.8}}},
    "spin.n_i": {"spin": {**GH["spin"], "n_i": [0.1, 0.3]}},
    "cases": {"spin": {**GH["spin"], "n_i": [0.1]}},
    "horizon.t": {"horizon": {"t": 30.0}},
    "model": {"model": "gh"},
}


def test_directories_of_other_runs_are_refused(tmp_path):
    rs.sweep(GH, output=tmp_path / "one", threads=1)
    for key, change in OTHERS.items():
        rs.sweep(GH | change, output=tmp_path / key, threads=1)
        done = invoke("compare", tmp_path / "one", tmp_path / key, "--data", tmp_path / "x.csv")
        assert_refused(done, 2, f"{key}: ")
        assert not (tmp_path / "x.csv").exists()


def test_tables_are_told_apart_by_their_rows(tmp_path):
    table = pd.DataFrame(
        {"alpha": 13.04, "beta": 1.522, "gamma": 12.28, "theta": [0.82, 0.8], "phi": 0.036,
         "xi": -0.03, "n_i": 0.1, "omega_xy0": 0.01, "t_end": 20.0}
    )  # fmt: skip
    for name, theta in (("one", 0.8), ("moved", 0.8), ("other", 0.81)):
        path = tmp_path / f"{name}.csv"
        table.assign(theta=[0.82, theta]).to_csv(path)
        rs.sweep({"bodies": {"source": "table", "path": str(path)}}, output=tmp_path / name)
    assert told(tmp_path / "one", tmp_path / "moved")["total"]["runs"] == 2
    done = invoke("compare", tmp_path / "one", tmp_path / "other")
    assert_refused(done, 2, "case 0, sample 1: theta: 0.8 against 0.81")


def test_what_is_no_directory_of_runs_is_said(sweeps, tmp_path):
    empty = edited(sweeps / "b", tmp_path / "empty", lambda rows: rows[:0])
    for directory, code, words in (
        (tmp_path, 2, "is not an output directory"),
        (empty, 1, f"error: {empty} holds no runs yet\n"),
    ):
        assert_refused(invoke("compare", sweeps / "a", directory), code, words)
