"""Write docs/config.md and docs/columns.md from the schema and the tables of columns.

    python docs/make_reference.py [--check]

With ``--check`` nothing is written, and the exit code is 1 if a page is not current; a test does
that.  What a key, a column or a status means is said where it is defined, so a new one appears here
by itself; one whose example is dull gets a line in ``EXAMPLES``.
"""

# ruff: noqa: E501 - lines of Markdown
from __future__ import annotations

import json
import math
import re
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pyarrow as pa

from rattlesweep.integrate.status import Status
from rattlesweep.sweeps.config.read import config_json_schema
from rattlesweep.sweeps.config.schema import Config
from rattlesweep.sweeps import columns

DOCS = Path(__file__).parent
TOP = "the top level"
EXAMPLES = {
    "name": "steady-kr-quick",
    "seed": 2017,
    "samples": 400,
    "psi": "pitch",
    "output": "out/steady-kr-quick",
    "record": ["energy", "contact"],
    "path": "bodies.csv",
    "n_i": [-0.1, -0.3, -0.5],
    "omega_xy0": {"logspace": [0.001, 0.1, 3]},
    "omega": [0.0, 0.01, -0.1],
    "t_rgh": 5,
    "t": 3.0e4,
    "t_decay": 5,
    "method": "verner98",
    "tol": 1.0e-9,
    "dt": 0.002,
    "accuracy": "standard",
    "t_r": 0.02,
    "integrator.accuracy.t_r": 1.0e-6,
    "bodies.refine.tol": 0.1,
    "K_r": [0.01, 0.03, 0.1],
    "K_p": 0.5,
    "alpha": 13.04,
    "beta": 1.522,
    "gamma": 12.28,
    "f_sd": 0.1,
    "theta": 0.6429,
    "phi": 0.036,
    "xi": -0.03,
    "xi_deg": -1.72,
    "minus_xi_deg": 1.72,
    "surface": "paraboloid",
    "c": 2.0,
    "sigma": 0.003,
    "rolling": 0.001,
    # Of whole sections.
    "dissipation": {"sigma": 0.003},
    "stop": {"fraction": 0.01},
    "fraction": 0.01,
    "by": "type",
    "levels": 4,
    "refine": {"levels": 4, "by": "type"},
    "bodies": {"source": "preset", "name": "GH"},
    "launch": {"omega": [0.0, 0.01, -0.1]},
    "spin": {"n_i": -0.3, "omega_xy0": 0.01},
    "horizon": {"t_rgh": 5},
    "integrator": {"accuracy": "standard"},
    "classify": {"sw_departure": 0.1},
    "ranges": {"theta": [0.7, 0.9]},
    "target": {"K_r": 0.03},
    "overrides": {"theta": 0.82},
    "base": {"preset": "GH"},
    "axes": {"theta": {"linspace": [0.6, 0.99, 200]}},
}
"""Examples of keys that have no default, or a dull one."""

CONFIG_HEAD = """# The config, key by key

A config is a YAML 1.2 file. An unknown or repeated key is an error that names its line; `rattlesweep plan CONFIG --check` says what is wrong
and what the config comes to, `rattlesweep init` writes one to begin with, and `rattlesweep schema` prints the JSON Schema that editors
take. `--set KEY=VALUE` overrides a key by its dotted name, such as `--set bodies.samples=100`. In Python a config is a mapping with the same keys.

Mass `M`, height of the centre of mass at rest `a` and gravity `g` are 1, so times are in `sqrt(a/g)`, spins and rates in `sqrt(g/a)`.
Numbers that may be several are a number, a list, or spaced values: `{linspace: [low, high, n]}` or `{logspace: [low, high, n]}`, of
which both ends are values.

```yaml
name: steady-kr-quick
seed: 2017
bodies: {source: sd, samples: 1000, target: {K_r: [0.01, 0.03, 0.1]}}
spin: {n_i: [-0.1, -0.3, -0.5], omega_xy0: [0.001, 0.01, 0.1]}
horizon: {t_rgh: 5}
record: [error]
```
"""

TABLES = """## A table as a source

`bodies: {source: table, path: bodies.csv}` reads CSV (with a header) or Parquet, or a directory of Parquet files; a relative path is looked
for in the working directory, then beside the config. Each row is one body, in the columns `alpha beta gamma theta phi xi` (radians). Other
columns, if there are any, replace parts of the config row by row; what no column says stands in the config:

| columns | instead of | unit |
|---|---|---|
| `n_i` and `omega_xy0` | `spin` | `sqrt(g/a)` |
| `psi`, beside these | `spin.psi` | radians |
| `omega_x omega_y omega_z u_x u_y u_z` | `spin`: a full state | `sqrt(g/a)`; 1 |
| `t_end` (empty: the config's) | `horizon` | `sqrt(a/g)` |
| `c` (empty: the config's), with `bodies.surface` | `bodies.c` | `a` |
| `sigma`, in all rows | `dissipation.sigma` | `M a^2 sqrt(g/a)` |
| `rolling`, in all rows | `dissipation.rolling` | `a` |
| `xi_deg` | `xi` | degrees |

In SI units a body is `mass_kg height_m ixx_kg_m2 iyy_kg_m2 izz_kg_m2 r1_m r2_m`, and perhaps `ixy_kg_m2 axes_angle_deg gravity_m_s2`, as
`rs.Rattleback.from_si` takes them ([stones.md](stones.md)); a launch is `n_i_rpm omega_xy0_rpm`, and `t_end_s` a horizon; the vertical semi-axis is
`c_m`, dissipation `sigma_N_m_s` (newton metre seconds, with `mass_kg`) and `rolling_m`. Where there is a
`height_m`, be the body in SI units or not, the runs have `t_r_s` and `n_i_rpm` too. Columns of any other name are carried through to the runs:
words, whole numbers and numbers, such as the name of a stone. A name that is that of a result is refused.

```csv
alpha,beta,gamma,theta,phi,xi,n_i,omega_xy0,t_end
13.04,1.522,12.28,0.6429,0.036,-0.03,0.1,0.01,200
13.04,1.522,12.28,0.7,0.05,-0.05,-0.2,0.1,
```

The runs of another sweep are such a table: `path: out/quickstart/runs` takes its bodies with the launches they had, and their horizons,
but for runs that reversed, whose `t_end` is the time of that. With another model or another tolerance this compares the two run by run.
In Python, `rs.sweep(frame, output="out/mine", spin=...)` takes a DataFrame of these columns.
"""

COLUMNS_HEAD = """# Columns of the tables

`runs/*.parquet` has one row a run, `summary.parquet` one row a case. Every column carries its unit and its meaning in the metadata of its
field (`attrs` of the DataFrames of the Python interface). Absent values are null; NaN and infinity never occur. `M`, `a` and `g` are 1.
"""

PARTS = {
    "keys": "Which run",
    "body": "Body",
    "launch": "Launch",
    "theory": "Theory",
    "result": "Result",
    "observation": "What the types are told by",
    "STATE": "Launches from a full state",
    "MEASURED": "Bodies of a known size",
}

ELSEWHERE = {
    "tol": "`integrator: {accuracy: {t_r: ...}}`",
    "surface": "`bodies: {surface: ellipsoid}`",
    "dissipation": "`dissipation`",
}
"""Parts that another key than `record` asks for."""

TYPES_TABLE = """## Types

| word | meaning |
|---|---|
| `R` | reversed: the spin reached zero by the horizon |
| `SS` | steady spinning: the relevant oscillation decayed monotonically |
| `SW` | the spin visibly left its plateau and wobbles |
| `unclassified` | the oscillation grew, yet the spin had not visibly changed by the horizon |
| `D` | dead: with dissipation, no reversal, and hardly any energy left |

The thresholds behind "monotonically" and "visibly" are keys of [classify](config.md#classify); [types.md](types.md) has the evidence.
"""


# ---------------------------------------------------------------- config


def config_page() -> str:
    """The page of the config."""
    schema = config_json_schema()
    parts = [CONFIG_HEAD]
    for path, model in sections(schema, schema["$defs"]):
        title = "## Keys of the top level" if path == TOP else f"## {path}"
        words = "" if path == TOP else model.get("description", "")
        rows = [
            ("key", "default", "values", "unit", "meaning", "example"),
            *(
                row_of(path, name, key, name in model.get("required", ()))
                for name, key in model["properties"].items()
            ),
        ]
        parts.append("\n\n".join(filter(None, [title, words, table(rows)])) + "\n")
    return "\n".join([*parts, TABLES])


def sections(schema: dict[str, Any], known: dict[str, Any]) -> Iterator[tuple[str, dict[str, Any]]]:
    """The top level, then every section by its path, with what tells alternatives apart."""

    def walk(path: str, model: dict[str, Any]) -> Iterator[tuple[str, dict[str, Any]]]:
        yield path or TOP, model
        for name, key in model["properties"].items():
            found = [n for n in references(key) if n not in ("Linspace", "Logspace")]
            for inner in found:
                own = f"{path.split(',')[0]}.{name}".removeprefix(".")
                label = own if len(found) == 1 else f"{own}, {told_apart(known[inner])}"
                yield from walk(label, known[inner])

    return walk("", schema)


def references(key: Any) -> list[str]:
    """Names of the models that a value may be."""
    if "$ref" in key:
        return [key["$ref"].rsplit("/", 1)[1]]
    return [
        name for way in ("anyOf", "oneOf") for each in key.get(way, ()) for name in references(each)
    ]


def told_apart(model: dict[str, Any]) -> str:
    """What tells a model from its alternatives: a key's word, or its own keys."""
    constants = [
        f"{name}: {key['const']}" for name, key in model["properties"].items() if "const" in key
    ]
    return constants[0] if constants else "with " + " ".join(model["required"])


def row_of(path: str, name: str, key: dict[str, Any], required: bool) -> tuple[str, ...]:
    """One line of a table of keys."""
    words = key["description"].removesuffix(".")
    default = "required" if required else "–"
    if not required and (value := default_of(path, name, key)) is not None:
        default = code(value)
    example = code(example_of(path, name, key))
    # What is no code would be taken for a tag.
    return f"`{name}`", default, kind_of(key), unit_of(words), words.replace("<", "&lt;"), example


def default_of(path: str, name: str, key: dict[str, Any]) -> Any:
    """The default of a key; of a section that has none of its own, None."""
    if path == TOP and "default" not in key:
        value = Config.model_fields[name].get_default(call_default_factory=True)
        return value if isinstance(value, list) else value.model_dump(exclude_defaults=True) or None
    return key.get("default")


def example_of(path: str, name: str, key: dict[str, Any]) -> Any:
    """A value that the key may have; in a range or along an axis, several."""
    if "const" in key:
        return key["const"]
    if path.endswith("axes"):
        return {"linspace": [float(f"{0.9 * EXAMPLES[name]:.3g}"), EXAMPLES[name], 20]}
    if key.get("type") == "array" and "default" in key:
        return key["default"]
    chosen = EXAMPLES.get(f"{path.split(',')[0]}.{name}", EXAMPLES.get(name))
    if chosen is not None and chosen in key.get("enum", [chosen]):
        return chosen
    if "enum" in key:
        return key["enum"][-1]
    if key.get("default") is not None:
        return key["default"]
    if inner := references(key):
        model = config_json_schema()["$defs"][inner[0]]
        names = model.get("required") or list(model["properties"])[:1]
        return {n: example_of(inner[0], n, model["properties"][n]) for n in names}
    if found := [each for way in ("anyOf", "oneOf") for each in key.get(way, ())]:
        return example_of(path, name, found[0])
    low = key.get("minimum", key.get("exclusiveMinimum"))
    if low is None:
        raise SystemExit(f"{path}: {name} needs an example: add one to EXAMPLES in {__file__}")
    return (low + key.get("maximum", key.get("exclusiveMaximum", low + 2))) / 2


def kind_of(key: dict[str, Any]) -> str:
    """What a value may be, in words."""
    if "const" in key or "enum" in key:
        return ", ".join(f"`{word}`" for word in key.get("enum", [key.get("const")]))
    if "Linspace" in references(key):
        first = key
        while ways := first.get("anyOf") or first.get("oneOf"):
            first = ways[0]
        spaced = "list of numbers, or spaced ones"
        return spaced if first["type"] == "array" else f"{kind_of(first)}; or several"
    if references(key):
        return "a section"
    for way in ("anyOf", "oneOf"):
        if way in key:
            kinds = [kind_of(each) for each in key[way] if each.get("type") != "null"]
            return " or ".join(dict.fromkeys(kinds))
    if key.get("type") == "array":
        inner = kind_of(key.get("items", {}))
        if key.get("minItems", 0) != key.get("maxItems", 1):
            return f"list of {inner}"
        return (
            "[low, high]"
            if key["minItems"] == 2
            else inner.replace("number", f"{key['minItems']} numbers")
        )
    if key.get("type") in ("integer", "number"):
        return f"{'whole number' if key['type'] == 'integer' else 'number'}{limits(key)}"
    return {"string": "text", "boolean": "`true`, `false`"}[key["type"]]


def limits(key: dict[str, Any]) -> str:
    """The range of a number."""
    found = [
        f"{sign} {short(key[name])}"
        for name, sign in (("minimum", "≥"), ("exclusiveMinimum", ">"), ("maximum", "≤"),
                           ("exclusiveMaximum", "<"))
        if name in key
    ]  # fmt: skip
    return "".join(f", {limit}" for limit in found)


def short(value: float) -> str:
    """A limit as people write it."""
    if value and abs(abs(value) - math.pi / 2) < 1e-12:
        return "-pi/2" if value < 0 else "pi/2"
    if isinstance(value, int) and value > 1e15:
        power = value.bit_length()
        return f"2^{power - 1}" if value == 2 ** (power - 1) else f"2^{power} - 1"
    return f"{value:g}"


UNITS = (
    (r"\bno unit\b", "1"), (r"\bin radians\b", "rad"), (r"\bin degrees\b", "degree"),
    (r"\bM a\^2 sqrt\(g/a\)", "`M a^2 sqrt(g/a)`"), (r"sqrt\(a/g\)", "`sqrt(a/g)`"),
    (r"sqrt\(g/a\)", "`sqrt(g/a)`"), (r"units of t_rGH", "t_rGH"),
    (r"units of gamma/sigma", "gamma/sigma"), (r"[Uu]nit vector|fraction", "1"),
)  # fmt: skip


def unit_of(words: str) -> str:
    """The unit that a description names."""
    return next((unit for pattern, unit in UNITS if re.search(pattern, words)), "")


# --------------------------------------------------------------- columns


def columns_page() -> str:
    """The page of the columns."""
    parts = [COLUMNS_HEAD, "## `runs`\n"]
    asked = {name: fields for name, fields in columns.RUNS.items() if name in columns.RECORD_PARTS}
    always = {name: fields for name, fields in columns.RUNS.items() if name not in asked}
    extras = {
        name: value
        for name, value in vars(columns).items()
        if isinstance(value, tuple)
        and value
        and isinstance(value[0], pa.Field)
        and name != "SUMMARY"
    }
    for name, fields in (*always.items(), *extras.items()):
        words = PARTS.get(name, f"`{name.lower()}`: sweeps that ask for it")
        parts.append(f"### {words}\n\n{fields_table(fields)}\n")
    for name, fields in asked.items():
        models = columns.RECORD_PARTS[name]
        note = f"Not with `model: {'` or `'.join(models)}`.\n\n" if models else ""
        words = ELSEWHERE.get(name, f"`record: [{name}]`")
        parts.append(f"### {words}\n\n{note}{fields_table(fields)}\n")
    parts.append(f"## `summary`\n\n{fields_table(columns.SUMMARY)}\n")
    words = [(f"`{status.label}`", status.meaning) for status in Status]
    parts.append(TYPES_TABLE)
    parts.append(f"## Status words\n\n{table([('word', 'meaning'), *words])}")
    return "\n".join(parts)


def fields_table(fields: tuple[pa.Field, ...]) -> str:
    """Columns as lines of a table."""
    rows = [
        (f"`{f.name}`", str(f.type).replace("list<element: double>", "list of double"),
         f"`{f.metadata[b'unit'].decode()}`", "yes" if f.nullable else "",
         f.metadata[b"description"].decode().replace("<", "&lt;"))
        for f in fields
    ]  # fmt: skip
    return table([("column", "type", "unit", "may be null", "meaning"), *rows])


# ------------------------------------------------------------------ both


def code(value: Any) -> str:
    """A value as YAML in one line."""
    return f"`{yaml(value)}`"


def yaml(value: Any) -> str:
    """A value as YAML has it between brackets."""
    if isinstance(value, dict):
        return "{" + ", ".join(f"{name}: {yaml(inner)}" for name, inner in value.items()) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(map(yaml, value)) + "]"
    if isinstance(value, bool) or value is None:
        return json.dumps(value)
    return f"{value:g}" if isinstance(value, float) else str(value)


def table(rows: list[tuple[str, ...]]) -> str:
    """Lines of Markdown."""
    head, *body = [" | ".join(cell.replace("|", "\\|") for cell in row) for row in rows]
    ruler = "|".join(["---"] * len(rows[0]))
    return "\n".join([f"| {head} |", f"|{ruler}|", *(f"| {line} |" for line in body)])


PAGES = {"config.md": config_page, "columns.md": columns_page}


def main() -> int:
    """Write or compare the pages."""
    old = []
    for name, page in PAGES.items():
        path, text = DOCS / name, page().rstrip() + "\n"
        if "--check" not in sys.argv:
            path.write_text(text)
        elif not path.exists() or path.read_text() != text:
            old.append(name)
    if old:
        print(f"not current: {', '.join(old)}; run python docs/make_reference.py", file=sys.stderr)
    return int(bool(old))


if __name__ == "__main__":
    raise SystemExit(main())
