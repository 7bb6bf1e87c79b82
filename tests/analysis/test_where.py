"""Conditions mean what SQL means, run no code, and are refused in one sentence."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import duckdb
import numpy as np
import pyarrow as pa
import pytest

from rattlesweep.analysis.where import parse_where
from rattlesweep.words.errors import ConfigError

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


SAME = [
    ("type == 'R' or type == \"SS\"", "type = 'R' or type = 'SS'"),
    ("t_r > 10 and not K_r < 0.05", "t_r > 10 and (not K_r < 0.05 or K_r is null)"),
    ("t_r.notna() and sample in [1, 3]", "t_r is not null and sample in (1, 3)"),
    ("abs(n_i) < 0.2 and K_r ** 2 < 0.011", "abs(n_i) < 0.2 and K_r ** 2 < 0.011"),
    ("n_i / 0 > 1", "n_i > 0"),
    ("sure == True and t_r < 2 * t_rgh", "sure and t_r < 2 * t_rgh"),
    ("`t_r` > 10 & `n_i` < 0 | sample == 0", "t_r > 10 and n_i < 0 or sample = 0"),
    ("~t_r.isna() & (type == 'R' | sure)", "t_r is not null and (type = 'R' or sure)"),
    ("10 < t_r <= 50 < t_rgh", "10 < t_r and t_r <= 50 and 50 < t_rgh"),
    (
        "sample not in (1, 3) and type.isin(['R'])",
        "sample not in (1, 3) and type = 'R'",
    ),
    ("type == ['R', 'SS']", "type in ('R', 'SS')"),
    ("type != ['R', 'SS'] and type.notna()", "type = 'SW'"),
    ("(t_r / t_rgh).between(0.5, 2)", "t_r / t_rgh between 0.5 and 2"),
    ("t_r.between(left=10, right=t_rgh)", "t_r between 10 and t_rgh"),
    ("sqrt(t_r) + log(t_rgh) < 2 * exp(1)", "sqrt(t_r) + ln(t_rgh) < 2 * exp(1)"),
    (
        "sample % 2 == 1 and sample // 50 == case",
        'sample % 2 = 1 and sample // 50 = "case"',
    ),
    ("t_r > 10\n  and -t_r > -50", "t_r > 10 and -t_r > -50"),
    (
        "type == 'a & b' or type != '`R` | \\''",
        "type != 'R' or type = 'R' or type is null",
    ),
]


@pytest.mark.parametrize(("text", "sql"), SAME)
def test_conditions_mean_what_sql_means(
    runs: pa.RecordBatch, text: str, sql: str
) -> None:
    rows = pa.Table.from_batches([runs])  # noqa: F841 - for duckdb
    wanted = duckdb.sql(f'select "case", sample from rows where {sql}').to_arrow_table()
    chosen = parse_where(text, SCHEMA).filter(runs)
    assert 0 < len(chosen) <= N
    for name in ("case", "sample"):
        assert chosen[name].to_pylist() == wanted[name].to_pylist()


def test_a_condition_names_the_columns_that_it_reads() -> None:
    where = parse_where("t_r > 1 and type == 'K_r sure' or `n_i` > 0", SCHEMA)
    assert where.columns == ("t_r", "n_i", "type")


WRONG = [
    ("", "empty"),
    ("typ == 'R'", 'did you mean "type"?'),
    ("type = 'R'", "compare with =="),
    ("K_r <", "invalid syntax"),
    ("K_r.to_csv('x').isna()", ".to_csv is none of .isna"),
    ("__import__('os').system('true') == 0", ".system is none of"),
    ("eval('1') == 1", "eval is none of the functions abs"),
    ("K_r", "no condition on columns"),
    ("1 < 2", "no condition on columns"),
    ("K_r < 'x'", "compares a number with a text"),
    ("type + 1 > 0", "+ needs numbers"),
    ("'x' * 9999999999 == type", "* needs numbers"),
    ("[0] * 9999999999 == case", "it may hold columns, numbers"),
    ("t_r and K_r > 1", "and needs conditions"),
    ("not t_r", "not needs a condition"),
    ("t_r in K_r", "in needs a list"),
    ("t_r in [K_r]", "a list holds numbers or texts"),
    ("window_n_min > 1", "window_n_min holds a list for each run"),
    ("t_r > (1 if sure else 2)", "it may hold columns, numbers"),
    ("[t_r for t_r in K_r] == t_r", "it may hold columns, numbers"),
    ("(t_r := K_r) > 1", "it may hold columns, numbers"),
    ("t_r > f'{K_r}'", "it may hold columns, numbers"),
    ("t_r.values > 1", "it may hold columns, numbers"),
    ("t_r > 1j", "it may hold columns, numbers"),
    ("t_r > None", "it may hold columns, numbers"),
    ("1 / 0 < t_r", "division by zero"),
    ("t_r.between(1)", "between"),
    ("t_r.between(*K_r)", "it may hold columns, numbers"),
    ("t_r.between(**K_r)", "unexpected keyword"),
    ("type.isin('R')", "list-like"),
    ("(1).isna()", "a method of columns only"),
    ("1 in [1, 2]", "only a column may be in a list"),
    ("t_r < [1]", "a list goes with in"),
    ("t_r is K_r", "it may hold columns, numbers"),
    ("t_r @ K_r > 1", "it may hold columns, numbers"),
    ("t_r.between(1, 2, 'none')", "Inclusive"),
    ("abs(t_r, K_r) > 1", "abs takes one"),
    ("t_r ** 101 > 1", "exponents are numbers from -100 to 100"),
    ("2 ** t_r > 1", "exponents are numbers from -100 to 100"),
    ("t_r < " + "-" * 50_000 + "1", "nested too deeply"),
    ("t_r < " + "9" * 5_000, "digits"),
    ("t_r < 1\0", "null"),
]


@pytest.mark.parametrize(("text", "words"), WRONG, ids=lambda case: case[:30])
def test_wrong_conditions_say_so_in_one_sentence(text: str, words: str) -> None:
    with pytest.raises(ConfigError) as refused:
        parse_where(text, SCHEMA)
    (message,) = refused.value.messages
    assert message.startswith("where")
    assert words in message
    assert "\n" not in message


# What an escaped quote or a full-width letter hides must be seen, and not be called.
ATTACKS = [
    r"type == '\'' or t_r.to_csv({path!r}) == '\'' or t_r > 0",
    r"type == '\'' or t_r.__init__.__globals__['sys'].stdout.write('ran') == '\''",
    "t_r.ｔo_csv({path!r}) == 0",
    "t_r.to_csv\N{FULLWIDTH LEFT PARENTHESIS}{path!r}) == 0",
    "`t_r`.to_csv({path!r}) == 0",
    "t_r.isna.__func__.__globals__['sys'].exit() == 0",
    "(t_r.isna)().to_csv({path!r}) == 0",
    "sample.isin([t_r.to_csv({path!r})])",
    "@t_r.to_csv({path!r}) == 0",
]


@pytest.mark.parametrize("attack", ATTACKS)
def test_a_condition_runs_no_code(
    runs: pa.RecordBatch,
    attack: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    path = tmp_path / "written"
    with pytest.raises(ConfigError):
        parse_where(attack.replace("{path!r}", repr(str(path))), SCHEMA).filter(runs)
    assert not path.exists()
    assert capsys.readouterr().out == ""


def test_a_power_cannot_hang() -> None:
    powers = ["2" + "**2" * 5, "9**9**9**9", "(10**99)**99**99"]
    # In another process, as Python cannot be interrupted within one operation.
    code = f"""if True:
        import sys, pyarrow as pa
        from {parse_where.__module__} import parse_where
        for power in sys.argv[1:]:
            try:
                parse_where("t_r < " + power, pa.schema([("t_r", pa.float64())]))
            except ValueError as error:
                print(error)
    """
    command = [sys.executable, "-c", code, *powers]
    done = subprocess.run(command, capture_output=True, text=True, timeout=20)
    assert done.stdout.count("exponents are numbers") == len(powers), done.stderr
