"""Conditions on runs mean what SQL means, and are refused in one sentence."""

from __future__ import annotations

import duckdb
import numpy as np
import pyarrow as pa
import pytest

from rattlesweep.analysis.layout import parse_where
from rattlesweep.errors import ConfigError

N = 400
SCHEMA = pa.schema(
    [
        ("case", pa.int32()),
        ("sample", pa.int64()),
        ("K_r", pa.float64()),
        ("t_r", pa.float64()),
        ("t_rgh", pa.float64()),
        ("n_i", pa.float64()),
        ("type", pa.string()),
        ("sure", pa.bool_()),
        ("window_n_min", pa.list_(pa.float64())),
    ]
)


@pytest.fixture(scope="module")
def runs() -> pa.RecordBatch:
    """Rows with nulls and repeated values."""
    random = np.random.default_rng(1)
    t_r = np.where(random.random(N) < 0.4, np.nan, 100 * random.random(N))
    columns = [
        np.repeat(np.arange(4), N // 4),
        np.tile(np.arange(N // 4), 4),
        np.resize([-0.5, -0.1, 0.1, np.nan], N),
        t_r,
        100 * random.random(N),
        np.resize([-0.3, 0.1, -0.1], N),
        np.resize(["R", "SS", "SW", None], N),
        np.resize([True, False, None], N),
        [[0.0]] * N,
    ]
    arrays = [
        pa.array(values, field.type, from_pandas=True)
        for values, field in zip(columns, SCHEMA, strict=True)
    ]
    return pa.RecordBatch.from_arrays(arrays, schema=SCHEMA)


SAME = """
type == "R" or type == "SS"                | type = 'R' or type = 'SS'
t_r > 10 and not K_r < 0.05                | t_r > 10 and (not K_r < 0.05 or K_r is null)
t_r.notna() and sample in [1, 3, 5]        | t_r is not null and sample in (1, 3, 5)
abs(n_i) < 0.2 and K_r ** 2 < 0.011        | abs(n_i) < 0.2 and K_r ** 2 < 0.011
n_i / 0 > 1                                | n_i > 0
sure == True and t_r < 2 * t_rgh           | sure and t_r < 2 * t_rgh
"""


@pytest.mark.parametrize("line", SAME.strip().splitlines())
def test_conditions_mean_what_sql_means(runs: pa.RecordBatch, line: str) -> None:
    text, sql = line.split(" | ")
    rows = pa.Table.from_batches([runs])  # noqa: F841 - for duckdb
    wanted = duckdb.sql(f'select "case", sample from rows where {sql}').to_arrow_table()
    where = parse_where(text, SCHEMA)
    found = where.filter(runs)
    assert 0 < len(found) < N
    for name in ("case", "sample"):
        assert found[name].to_pylist() == wanted[name].to_pylist()
    # No more is read than it names.
    assert {*where.columns} == {
        name for name in SCHEMA.names if name in text.split('"')[0]
    }


WRONG = """
 | empty
typ == "R" | did you mean "type"?
type = "R" | is no condition on columns
K_r < | invalid syntax
K_r.to_csv('x').isna() | .to_csv is none of .isna
__import__('os').system('true') == 0 | .system is none of
"""


@pytest.mark.parametrize("line", WRONG.strip("\n").splitlines())
def test_wrong_conditions_say_so_in_one_sentence(
    runs: pa.RecordBatch, line: str
) -> None:
    text, words = line.split(" | ") if line[0] != " " else ("", "empty")
    with pytest.raises(ConfigError) as refused:
        parse_where(text, SCHEMA).filter(runs)
    (message,) = refused.value.messages
    assert message.startswith("where")
    assert words in message
    assert "\n" not in message
