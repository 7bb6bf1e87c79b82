"""What a run leaves opens in pandas, DuckDB and Polars, alike, at any moment."""

import json
import time
from pathlib import Path

import duckdb
import numpy as np
import pandas as pd
import polars as pl
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from sweeping import begin, run

ORDERED = 'ORDER BY "case", sample'


@pytest.fixture(scope="module")
def output(tmp_path_factory: pytest.TempPathFactory) -> Path:
    directory = tmp_path_factory.mktemp("readers") / "out"
    sets = ("bodies.samples=30", "bodies.target={K_r: [0.01, 0.1], rel_tol: 0.1}", "block_size=70",
            "record=[energy, contact, windows]", "spin.n_i=[-0.3, -0.5]",
            "integrator.max_steps=20000")  # fmt: skip
    # Runs of every type, and some that fail.
    assert run("quickstart.yaml", directory, *sets, options=("-q",)).exit_code == 3
    return directory


def test_three_readers_see_the_same_rows_at_any_cut(output):
    glob = str(output / "runs" / "*.parquet")
    assert len(list((output / "runs").iterdir())) == 2
    pandas = pd.concat([pd.read_parquet(p) for p in sorted((output / "runs").glob("*.parquet"))])
    whole = pd.read_parquet(output / "runs")
    pd.testing.assert_frame_equal(whole, pandas.reset_index(drop=True), check_exact=True)
    assert {"R", "SS"} <= set(pandas.type.dropna())
    assert {"ok", "step_limit"} == set(pandas.status)
    with duckdb.connect() as connection:
        duck = connection.sql(f"SELECT * FROM read_parquet('{glob}') {ORDERED}").to_arrow_table()
    polars = pl.read_parquet(glob).sort("case", "sample").to_arrow()
    assert len(whole) == 120
    assert list(whole) == duck.column_names == polars.column_names
    values = pa.Table.from_pandas(whole, schema=pq.read_schema(next(output.glob("runs/*"))))
    assert values.to_pylist() == duck.to_pylist()
    assert values.to_pylist() == polars.to_pylist()


def test_queries_need_no_help(output):
    """Counts as a user would ask for them, and the summary says the same."""
    glob = str(output / "runs" / "*.parquet")
    summary = pd.read_parquet(output / "summary.parquet")
    question = (
        f"SELECT \"case\", count(*) FILTER (WHERE type = 'R') / count(type) AS r, avg(t_r) AS t "
        f'FROM \'{glob}\' GROUP BY "case" ORDER BY "case"'
    )
    with duckdb.connect() as connection:
        duck = connection.sql(question).fetchall()
        same_rows = connection.sql(f"SELECT * FROM '{output / 'summary.parquet'}'").fetchall()
    reverses = (pl.col("type") == "R").sum() / pl.col("type").count()
    lazy = pl.scan_parquet(glob).group_by("case").agg(reverses, pl.col("t_r").mean()).sort("case")
    for found in (duck, lazy.collect().rows()):
        case, fraction, mean = (
            np.array(column, dtype=float) for column in zip(*found, strict=True)
        )
        assert case.tolist() == summary["case"].tolist()
        np.testing.assert_allclose(fraction, summary.fraction_R, rtol=1e-15)
        np.testing.assert_allclose(mean, summary.t_r_mean, rtol=1e-13)
    assert pl.read_parquet(output / "summary.parquet").rows() == same_rows


# Every kill and fault of tests/store leaves a state that pandas and DuckDB read.
@pytest.mark.slow
def test_readable_while_it_runs(tmp_path):
    output = tmp_path / "out"
    glob = str(output / "runs" / "*.parquet")
    child = begin(output, "bodies.samples=500", "block_size=100")
    seen = []
    states = set()
    try:
        with duckdb.connect() as connection:
            while child.poll() is None:
                if (output / "manifest.json").exists():
                    states.add(json.loads((output / "manifest.json").read_text())["state"])
                files = sorted(output.glob("runs/*.parquet"))
                if not files:
                    continue
                question = f"SELECT count(*), count(status) FROM '{glob}'"
                count = connection.execute(question).fetchall()[0]
                assert count[0] == count[1]
                assert count[0] % 100 == 0
                lazy = pl.scan_parquet(glob).select(pl.col("t_end").is_finite().sum()).collect()
                assert lazy.item() >= count[0]
                frame = pd.read_parquet(files[-1])
                assert len(frame) == 100
                assert frame.n_steps.min() > 0
                seen.append(count[0])
                time.sleep(0.05)
    finally:
        child.kill()
        _, said = child.communicate()
    assert child.returncode == 0, said
    assert "running" in states
    assert seen == sorted(seen)
    assert len(set(seen)) > 3
    assert json.loads((output / "manifest.json").read_text())["state"] == "complete"
