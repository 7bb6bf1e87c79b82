"""The tables of a sweep open in pandas, DuckDB and Polars, alike."""

import duckdb
import pandas as pd
import polars as pl
import pyarrow as pa
import pyarrow.parquet as pq
from sweeping import run


def test_three_readers_see_the_same_rows(tmp_path):
    output = tmp_path / "out"
    sets = (
        "bodies.target={K_r: [0.01, 0.1], rel_tol: 0.1}",
        "spin.n_i=[-0.3, -0.5]",
        "record=[energy, contact, windows]",
        "integrator.max_steps=20000",
    )
    # Runs of every type, some that fail, and files of two sessions.
    for samples in (20, 30):
        assert (
            run("quickstart.yaml", output, f"bodies.samples={samples}", *sets).exit_code
            == 3
        )
    glob = str(output / "runs" / "*.parquet")
    whole = pd.read_parquet(output / "runs").sort_values(
        ["case", "sample"], ignore_index=True
    )
    assert {"R", "SS"} <= set(whole.type.dropna())
    assert {"ok", "step_limit"} == set(whole.status)
    with duckdb.connect() as connection:
        query = f"SELECT * FROM read_parquet('{glob}') ORDER BY \"case\", sample"
        duck = connection.sql(query).to_arrow_table()
    polars = pl.read_parquet(glob).sort("case", "sample").to_arrow()
    assert len(whole) == 120
    assert list(whole) == duck.column_names == polars.column_names
    values = pa.Table.from_pandas(
        whole, schema=pq.read_schema(next(output.glob("runs/*")))
    )
    assert values.to_pylist() == duck.to_pylist() == polars.to_pylist()
