"""The tables of a sweep open in other programs, alike, and damage does not show."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import duckdb
import pandas as pd
import polars as pl
import pyarrow as pa
import pyarrow.dataset as ds
import pyarrow.parquet as pq
import pytest
from hardship import command, files_of, tiny
from sweeping import invoke, run

KEYS = ["case", "sample"]
FOLDER_READERS: dict[str, Callable[[Path], pd.DataFrame]] = {
    "pandas": pd.read_parquet,
    "pyarrow.dataset": lambda folder: ds.dataset(folder).to_table().to_pandas(),
    "pyarrow.parquet": lambda folder: pq.read_table(folder).to_pandas(),
    "duckdb": lambda folder: duckdb.sql(
        f"select * from read_parquet('{folder}/*')"
    ).df(),
    "polars": lambda folder: pl.read_parquet(folder).to_pandas(),
}


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
        result = run("quickstart.yaml", output, f"bodies.samples={samples}", *sets)
        assert result.exit_code == 3
    glob = str(output / "runs" / "*.parquet")
    whole = pd.read_parquet(output / "runs").sort_values(KEYS, ignore_index=True)
    assert {"R", "SS"} <= set(whole.type.dropna())
    assert {"ok", "step_limit"} == set(whole.status)
    with duckdb.connect() as connection:
        query = f"SELECT * FROM read_parquet('{glob}') ORDER BY \"case\", sample"
        duck = connection.sql(query).to_arrow_table()
    polars = pl.read_parquet(glob).sort("case", "sample").to_arrow()
    assert len(whole) == 120
    assert list(whole) == duck.column_names == polars.column_names
    schema = pq.read_schema(next(output.glob("runs/*")))
    values = pa.Table.from_pandas(whole, schema=schema)
    assert values.to_pylist() == duck.to_pylist() == polars.to_pylist()


@pytest.fixture(scope="module")
def mended(tmp_path_factory) -> Path:
    """A sweep whose second file was damaged and has been replaced."""
    folder = tmp_path_factory.mktemp("mended")
    config = tiny(folder)
    output = folder / "out"
    assert command("run", config, "--output", output, "-q").code == 0
    path = files_of(output)[1]
    path.write_bytes(path.read_bytes()[:-1] + b"?")  # all of its rows can be read
    done = command("run", config, "--output", output, "-q")
    assert done.code == 0
    moved = output / "damaged" / f"{path.name}.damaged"
    assert f"note: a file was damaged and is now {moved}" in done.err
    assert moved.exists()
    return output


@pytest.mark.parametrize("reader", FOLDER_READERS)
def test_no_reader_takes_a_damaged_file_for_rows(reader, mended):
    frame = FOLDER_READERS[reader](mended / "runs")
    assert len(frame) == len(frame[KEYS].drop_duplicates()) == 24


@pytest.mark.parametrize("reader", FOLDER_READERS)
def test_no_reader_takes_a_file_being_written_for_rows(reader, tmp_path):
    config = tiny(tmp_path)
    output = tmp_path / "out"
    log = tmp_path / "log"
    calls = {"root": output, "kinds": ("write",), "log": log}
    assert command("run", config, "--output", output, "-q", calls=calls).code == 0
    lines = [x for x in log.read_text().splitlines() if x.startswith("write")]
    # Killed while it writes the last file of rows, half of which is there.
    rows = [place for place, line in enumerate(lines) if "case" in line]
    later = tmp_path / "later"
    calls = {"root": later, "kinds": ("write",), "at": rows[-1]}
    assert command("run", config, "--output", later, "-q", calls=calls).code == -9
    assert len(FOLDER_READERS[reader](later / "runs")) == 18


def test_status_and_verify_name_the_folder_of_damaged_files(mended):
    folder = mended / "damaged"
    assert f"damaged: 1 file in {folder}, replaced" in invoke("status", mended).stdout
    verified = invoke("verify", mended)
    assert verified.exit_code == 0
    assert f"1 file in {folder}" in verified.stdout
    assert "no problem found" in verified.stdout
