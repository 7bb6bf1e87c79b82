"""Conditions on runs mean what SQL means, gain arithmetic, and are refused in one sentence."""

from __future__ import annotations

import duckdb
import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pytest
from test_rows import SCHEMA, random_columns

from rattlesweep.analysis.where import parse_condition
from rattlesweep.errors import ConfigError
from rattlesweep.sweeps.arrow import build_table


@pytest.fixture(scope="module")
def runs() -> pa.Table:
    """Rows with nulls and repeated values."""
    columns = random_columns(np.repeat(np.arange(4), 100), np.tile(np.arange(100), 4))
    few = np.resize([-0.5, -0.1, 0.1, np.nan], 400)
    return build_table(columns | {"n_i": np.nan_to_num(few, nan=-0.3), "K_r": few}, SCHEMA)


@pytest.mark.parametrize(
    "text",
    [
        "type = 'R' or type = 'SS'",
        "t_r > 0 and not K_r < 0.05",
        "not (t_r > 0) or sample = 2",
        "t_r is null or n_end <> n_i",
        "t_r IS NOT NULL AND sample IN (1, 3, 5)",
        "sample not in (0, 2) and \"case\" = 1",
        "not (t_r not in (1, 2)) or sample = 5",
        "K_r not in (-0.5, 0.1)",
        "n_i < -.3 and (sample >= 6\n or sample <= 1)",
        "t_end <> t_r",
        "t_r < t_rgh or n_c1 is null",
        "sample != 3 and sample != 4.0",
        "K_r > 4.9e-2 and 0.1 = n_i",
        "type in ('R') and status = 'ok'",
        "type != 'it''s'",
        "n_steps * t_end / 2 - 1 > 10 * (t_r + 1)",
        "sample / 2 = 1.5 or -sample + 3 = +1",
        "abs(n_i) < 0.2 and K_r ** 2 < 0.011",
        "sample in (" + ", ".join(map(str, range(0, 5000, 3))) + ")",
        " or ".join(f"sample = {k}" for k in range(0, 5000, 3)),
    ],
    ids=lambda text: text[:20],
)  # fmt: skip
def test_conditions_mean_what_sql_means(runs: pa.Table, text: str) -> None:
    wanted = duckdb.sql(f"select * from runs where {text}").to_arrow_table()
    # What duckdb would take for a column is a word here, and its case needs no quotes.
    found = runs.filter(parse_condition(text.replace('"', ""), SCHEMA).expression)
    assert 0 < len(found) < len(runs)
    for name in ("case", "sample"):
        assert found[name].to_pylist() == wanted[name].to_pylist()


def test_python_is_read_too(runs: pa.Table) -> None:
    for one, other in (
        ('type == "R"', "type='R'"),
        ("2 <= sample < 5", "sample >= 2 and sample < 5"),
        ("t_r is None", "t_r is null"),
    ):
        assert runs.filter(parse_condition(one, SCHEMA).expression).equals(
            runs.filter(parse_condition(other, SCHEMA).expression)
        )


def test_the_columns_that_are_read_are_those_asked_for() -> None:
    found = parse_condition("K_r<1 and (type='R' or K_r>2)", SCHEMA)
    assert found.columns == ("K_r", "type")
    assert str(found.expression) == str(
        (pc.field("K_r") < 1) & ((pc.field("type") == "R") | (pc.field("K_r") > 2))
    )


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "is empty"),
        ("typ = 'R'", "typ is no column; did you mean type?"),
        ("k_R < 1", "did you mean K_r?"),
        ("type > 'R'", "words are = or !=, not < or >"),
        ("type = 3", "3 is a number and type a word"),
        ("K_r < 'R'", "K_r is a number and 'R' a word"),
        ("K_r in (1, 'R')", "cannot be compared"),
        ("K_r + 'R' > 1", "'R' is a word; there is no arithmetic"),
        ("K_r <", "ends too early"),
        ("K_r", "K_r is no condition; compare it"),
        ("K_r + 1", "K_r + 1 is no condition"),
        ("K_r < 1 and 2", "2 is no condition"),
        ("(K_r < 1", "cannot read '(K_r < 1'"),
        ("K_r < 1)", "cannot read ')'"),
        ("K_r < 1 K_p > 2", "cannot read"),
        ("K_r < 0.1x", "cannot read"),
        ("type = 'R", "cannot read"),
        ("K_r < 1 # or not", "cannot read '# or not'"),
        ("K_r < 1; 2", "cannot read '; 2'"),
        ("K_r in ()", "a list after in is empty"),
        ("t_r is 3", "null is needed after is, not 3"),
        ("t_r not null", "cannot read"),
        ("and", "cannot read 'and'"),
        ("K_r < True", "True is a flag and K_r a number"),
        ("K_r < null", "is needed, not null"),
        ("K_r < 1j", "is needed, not 1j"),
        ("len(type) > 1", "is needed, not len(type)"),
        ("window_n_min > 0", "several numbers a run"),
        ("__import__ = 'os'", "__import__ is no column"),
        ("__import__('os').system('true') = 0", "is needed, not __import__('os')"),
        ("(" * 2000 + "K_r < 1" + ")" * 2000, "cannot read"),
        ("not " * 5000 + "K_r < 1", "nested too deep"),
        ("-" * 5000 + "K_r < 1", "nested too deep"),
        ("K_r" + " + 1" * 5000 + " < 1", "nested too deep"),
    ],
    ids=lambda text: text[:20],
)
def test_wrong_conditions_say_so_in_one_sentence(text: str, words: str) -> None:
    with pytest.raises(ConfigError) as refused:
        parse_condition(text, SCHEMA)
    (message,) = refused.value.messages
    assert message.startswith("--where")
    assert words in message
    assert "\n" not in message
