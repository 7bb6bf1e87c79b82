"""Write docs/config.md and docs/columns.md from the schema and the tables of columns.

    python docs/make_reference.py [--check]

``--check`` writes nothing and exits with 1 if a page is out of date; a test runs it.
Meanings of keys, columns and statuses come from their definitions in the package.
"""

# ruff: noqa: E501 - lines of Markdown
from __future__ import annotations

import argparse
import itertools
import math
import re
import sys
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import pyarrow as pa

from rattlesweep.config.read import config_json_schema
from rattlesweep.config.schema import Config
from rattlesweep.design.bodies.table import about
from rattlesweep.kernel.state.status import Status
from rattlesweep.rows import arrow, columns
from rattlesweep.store import summary
from rattlesweep.words.names import MODEL_NAMES
from rattlesweep.words.quantities import ACTING, DRIVES, LOSSES, SURFACE_CONSTANTS

Schema = dict[str, Any]  # a JSON Schema, or a part of one
DOCS = Path(__file__).parent
PARAMETERS = ("overrides", "base", "axes")
"""Sections of `bodies` with parameters of a body; they share one table."""

CONFIG_HEAD = """# The config, key by key

A config says which bodies are launched, how, and what is recorded. It is a YAML 1.2 file, or in Python a mapping with the same keys:

```yaml
name: steady-kr-quick
seed: 2017
bodies: {source: sd, samples: 1000, target: {K_r: [0.01, 0.03, 0.1]}}
spin: {n_i: [-0.1, -0.3, -0.5], omega_xy0: [0.001, 0.01, 0.1]}
horizon: {t_rgh: 5}
record: [error]
```

This one is of 3 x 3 x 3 cases, one for each combination of `K_r`, `n_i` and `omega_xy0`, with 1,000 bodies each.

- `rattlesweep init` writes a config to start from.
- `rattlesweep plan CONFIG --check` reports each mistake with its line.
- `rattlesweep run CONFIG --set bodies.samples=100` overrides a key. `--set seed=null` takes the default. A `--set` without a value is
  refused, because it often comes from a variable of the shell that is not set.
- `rattlesweep schema` prints the JSON Schema, with which editors complete and check keys.

## Values

**Units.** `M`, `a` and `g` are 1: times are in `sqrt(a/g)`, spins and rates in `sqrt(g/a)`. Some bodies have a size: those of
`source: shape` or `mesh`, of the preset KL, and of a table with `height_m`. Their spins, times and dissipation need a unit, as in
`n_i: 60 rpm`, `t: 20 s` or `sigma: 1e-5 N m s`. Units of the body are possible, too, as in `n_i: 0.2 sqrt(g/a)`. Zero needs no unit.
Bodies without a size take plain numbers. If the sizes differ between bodies, a key with a unit takes one value.

**Several values.** In the tables below, "or several" means one number, a list, or a range with both ends:
`{linspace: [low, high, n]}` has `n` values at equal distances, and `{logspace: [low, high, n]}` at equal ratios. The values of a range are
rounded to the decimals that you would write: -0.1 to -0.5 in 5 steps has exactly -0.3, and -0.9 to 0.9 in 7 steps has exactly 0.

**Draws.** `[low, high]` is a range from which each body draws its own value.

**Sections.** "A section" is a mapping with keys of its own, which have a table below.
"""

EXAMPLES = {
    "bodies": [
        "bodies: {source: sd, samples: 400, target: {K_r: 0.03}}",
        "bodies: {source: preset, name: GH, overrides: {theta: 0.82}}",
        "bodies: {source: table, path: bodies.csv}",
        "bodies: {source: shape, shape: half_ellipsoid, length: 12 cm, width: 3 cm, height: [11 mm, 13 mm], mass: 85 g, skew: 3 deg, samples: 200}",
    ],
    "bodies.ranges": [
        "bodies: {source: sd, ranges: {theta: [0.7, 0.9], phi: [0.03, 0.03]}}"
    ],
    "bodies.target": [
        "bodies: {source: sd, target: {K_p: [0.1, 0.5], rel_tol: 1.0e-2}}"
    ],
    "bodies.overrides, bodies.base, bodies.axes": [
        "bodies: {source: grid, base: {gamma: 10, f_sd: 0.1, theta: 0.8, phi: 0.05, xi_deg: -3}, axes: {phi: [0.02, 0.05], f_sd: {linspace: [0.05, 0.15, 11]}}}",
    ],
    "bodies.refine": [
        "bodies: {source: grid, base: {preset: GH}, axes: {theta: {linspace: [0.6, 0.99, 401]}}, refine: {levels: 4, by: type}}"
    ],
    "stop": ["stop: {fraction: 0.01}"],
    "launch": ["launch: {omega: [0, 0.01, -0.1], u: [0.01, 0, -1]}"],
    "spin": [
        "spin: {n_i: [-0.1, -0.3], omega_xy0: {logspace: [0.001, 0.1, 3]}, psi: pitch}"
    ],
    "horizon": ["horizon: {t_rgh: 5, t: 1.0e+5}"],
    "dissipation": [
        "dissipation: {sigma: [0.001, 0.003], rolling: 0.001}",
        "dissipation: {pivot: [0.0005, 0.002], mu: 0.3}",
    ],
    "base": [
        "base: {frequency: {linspace: [0.5, 5, 451]}, acceleration: [0.02, 0.05]}",
        "base: {frequency: 2.88, amplitude: [0.005, 0.01], phase_deg: 90}",
        "base: {frequency: 1.44, acceleration: 0.02, direction: horizontal, azimuth_deg: [0, 45]}",
    ],
    "integrator": [
        "integrator: {method: verner98, tol: 1.0e-11}",
        "integrator: {accuracy: draft}",
    ],
    "integrator.accuracy": ["integrator: {accuracy: {t_r: 1.0e-6}}"],
    "classify": ["classify: {sw_departure: 0.1}"],
}

SHARED = {
    "bodies": "Where the bodies come from. Lengths and masses of shapes and meshes need units. A skew without one is in rad.",
    "bodies.overrides, bodies.base, bodies.axes": "`base` is a preset, six parameters, or a shell-dumbbell body. "
    "Each key of `axes` takes several values; the first axis varies slowest.",
}

TABLES = """## A table as a source

`bodies: {source: table, path: bodies.csv}` reads one body from each row. The file is one of these:

- CSV with a header. The columns are separated by commas, semicolons or tabs; with the latter two, numbers may have decimal commas.
  The encoding is UTF-8, UTF-16 with a byte order mark, or that of Windows (cp1252).
- Parquet.
- A directory of Parquet files, which has the columns of all its files. A column that may be empty, and one that is only copied, is
  empty for the rows of files without it. Any other column must be in all files or in none.

A relative path is looked up in the working directory, then beside the config.

A body has the columns `alpha beta gamma theta phi xi` (radians), or `gamma f_sd theta phi xi` for a shell-dumbbell body. Optional
columns replace a part of the config, row by row:

| columns | replace | unit |
|---|---|---|
| `n_i` and `omega_xy0` | `spin` | `sqrt(g/a)` |
| `psi` or `psi_deg` | `spin.psi` | radians, degrees |
| `omega_x omega_y omega_z u_x u_y u_z` | `spin`, by a full state | `sqrt(g/a)`; 1 |
| `t_end`, may be empty | `horizon` | `sqrt(a/g)` |
@@constants@@
| `xi_deg` or `minus_xi_deg` | `xi` | degrees |
| `rim`, may be empty | | `a`; height of the edge of the surface above its lowest point, at which a run ends |

A body in SI units has the columns `mass_kg height_m ixx_kg_m2 iyy_kg_m2 izz_kg_m2 r1_m r2_m`. It may also have `ixy_kg_m2
axes_angle_deg gravity_m_s2 c_m`. Its launch is `n_i_rpm omega_xy0_rpm`, its horizon `t_end_s`, its dissipation and its
plane @@losses@@.

Two columns for one quantity must agree, such as `n_i` and `n_i_rpm`, or `xi_deg` and the angle that follows from the tensor and the
radii. A table in which they contradict each other is refused.

Columns of other names are copied to the runs as they are. In a CSV file such a column holds numbers if each cell is written as a
number prints (`7`, `0.5`, `1e-07`), and texts otherwise (`007`, `1.10`, `1E5`, `NA`). Copied dates, decimals and infinities become
texts. A column with the name of a result, such as `t_r`, is an error, unless the table is one of runs.

```csv
alpha,beta,gamma,theta,phi,xi,n_i,omega_xy0,t_end
13.04,1.522,12.28,0.6429,0.036,-0.03,0.1,0.01,200
13.04,1.522,12.28,0.7,0.05,-0.05,-0.2,0.1,
```

The runs of a sweep are such a table: `path: out/quickstart/runs` repeats its launches up to their `t_end`, which is the reversal time
for a run that has reversed. `rs.sweep(frame, ...)` takes a DataFrame of pandas or Polars, or an Arrow table.
"""

COLUMNS_HEAD = """# Columns of the tables

`runs/*.parquet` has one row for each run, `summary.parquet` one for each case. Units and meanings are also in the metadata of the files and in
the `attrs` of DataFrames. `M`, `a` and `g` are 1. A `?` marks columns that may be null. NaN and infinity never occur.
`model: gh` has no columns of `record`.
"""

SUMMARY_HEAD = """Fractions are those of runs whose status is ok. What differs between the rows of a case is null.
"""

TYPES_LINK = """## Types

[Types of runs](types.md) defines the words of the column `type`.
"""


# ---------------------------------------------------------------- config


def config_page() -> str:
    """Return the page of the config, with a table for each section."""
    schema = config_json_schema()
    lines = [CONFIG_HEAD, "## Top level\n", table(rows_of({"": schema})), ""]
    for path, models in sections(schema):
        description = next(iter(models.values()))["description"].replace("\n", " ")
        lines += [f"## {path}\n", SHARED.get(path, description), ""]
        lines += ["```yaml", *EXAMPLES[path], "```", "", table(rows_of(models)), ""]
    return "\n".join([*lines, tables_text()])


def tables_text() -> str:
    """Return the section about tables, with the constants that have columns."""
    rows = [
        f"| `{name}`, may be empty | `bodies.{name}` | `{constant.unit}` |"
        for name, constant in SURFACE_CONSTANTS.items()
    ]
    names = ", ".join(f"`{name}`" for name in LOSSES)
    units = ", ".join(
        loss.unit if loss.unit == "1" else f"`{loss.unit}`" for loss in LOSSES.values()
    )
    rows.append(f"| {names}, in all rows | `dissipation` | {units} |")
    names = ", ".join(f"`{name}`" for name in DRIVES)
    units = ", ".join(
        drive.unit if drive.unit == "1" else f"`{drive.unit}`"
        for drive in DRIVES.values()
    )
    rows.append(f"| {names}, in all rows | `base` | {units} |")
    measures = [loss.measure for loss in ACTING.values() if loss.measure is not None]
    in_si = f"`{' '.join(measure.name for measure in measures)}`"
    text = TABLES.replace("@@constants@@", "\n".join(rows))
    return text.replace("@@losses@@", in_si)


def sections(schema: Schema) -> list[tuple[str, Schema]]:
    """Return the sections in order: path -> name of an alternative -> its schema."""
    models = schema["$defs"]
    by_path: dict[str, Schema] = {}

    def walk(path: str, model: Schema) -> None:
        for name, key in model["properties"].items():
            inner_path = f"{path}.{name}".removeprefix(".")
            for reference in references(key):
                inner = models[reference]
                title = inner_path
                label = inner_path
                if path == "bodies" and name in PARAMETERS:
                    title = ", ".join(f"bodies.{section}" for section in PARAMETERS)
                    label = name
                elif inner_path == "bodies":
                    label = inner["properties"]["source"]["const"]
                by_path.setdefault(title, {})[label] = inner
                walk(inner_path, inner)

    walk("", schema)
    # The bodies come first, the rest as in the schema.
    return sorted(by_path.items(), key=lambda section: section[0] != "bodies")


def rows_of(models: dict[str, Schema]) -> list[tuple[str, ...]]:
    """Return the table of keys of a section.

    If the section has alternatives, a column says which of them have the key.
    """
    has_alternatives = len(models) > 1
    head = ("key", "default", "values", "meaning")
    if has_alternatives:
        head = ("key", "where", *head[1:])
    rows: list[tuple[str, ...]] = [head]
    names = dict.fromkeys(
        name for model in models.values() for name in model["properties"]
    )
    for name in names:
        having = {label: m for label, m in models.items() if name in m["properties"]}
        keys = {label: model["properties"][name] for label, model in having.items()}
        row = [f"`{name}`"]
        if has_alternatives:
            row.append("all" if len(having) == len(models) else ", ".join(having))
        row.append(default_cell(name, having))
        row.append(together({label: kind_of(key) for label, key in keys.items()}))
        row.append(together({label: meaning_of(key) for label, key in keys.items()}))
        rows.append(tuple(row))
    # A section without defaults needs no column for them.
    filled = [place for place in range(len(head)) if any(r[place] for r in rows[1:])]
    return [tuple(row[place] for place in filled) for row in rows]


def default_cell(name: str, models: dict[str, Schema]) -> str:
    """Return the default of a key in all models that have it."""
    if all(name in model.get("required", ()) for model in models.values()):
        return "required"
    defaults = {
        label: default_of(name, model["properties"][name])
        for label, model in models.items()
    }
    shown = {label: text for label, text in defaults.items() if text}
    return together(shown) if shown else ""


def together(values: dict[str, str]) -> str:
    """Join the cells of alternatives: one cell if they agree, else each with its name."""
    by_value: dict[str, list[str]] = {}
    for label, value in values.items():
        by_value.setdefault(value, []).append(label)
    if len(by_value) == 1:
        return next(iter(by_value))
    shortest = min(by_value, key=len)
    if "axes" in values and f"{shortest}; or several" in by_value:
        # The head of the page explains lists of values.
        return shortest
    if all(value.endswith(shortest) for value in by_value):
        # Some add words before those that all share.
        cells = [shortest]
        for value, labels in by_value.items():
            extra = value.removesuffix(shortest).strip(" .")
            if extra:
                cells.append(f"{', '.join(labels)}: {extra}")
        return "; ".join(cells)
    if all(value == f"`{label}`" for label, value in values.items()):
        return ", ".join(by_value)
    return "; ".join(
        f"{', '.join(labels)}: {value}" for value, labels in by_value.items()
    )


def meaning_of(key: Schema) -> str:
    """Return the description of a key; a bare `<` would begin an HTML tag."""
    description: str = key["description"]
    return description.removesuffix(".").replace("<", "&lt;")


def references(key: Schema) -> list[str]:
    """Return the names of the models that a value refers to."""
    if "$ref" in key:
        return [key["$ref"].rsplit("/", 1)[1]]
    names: list[str] = []
    for keyword in ("anyOf", "oneOf"):
        for choice in key.get(keyword, ()):
            names += references(choice)
    return names


def default_of(name: str, key: Schema) -> str:
    """Return the default of a key as code, or an empty string."""
    value = key.get("default")
    if value is None and name in Config.model_fields and "default" not in key:
        value = Config.model_fields[name].get_default(call_default_factory=True)
        if hasattr(value, "model_dump"):
            value = value.model_dump(exclude_defaults=True) or None
    if value is None or "const" in key:
        return ""
    return f"`{yaml(value)}`"


def kind_of(key: Schema) -> str:
    """Return the values that a key accepts, in words."""
    if "const" in key:
        return f"`{key['const']}`"
    if "enum" in key:
        return ", ".join(f"`{word}`" for word in key["enum"])
    if "linspace" in str(key):
        first = key
        while "anyOf" in first or "oneOf" in first:
            first = (first.get("anyOf") or first["oneOf"])[0]
        return f"{kind_of(first)}; or several"
    if references(key):
        return "a section"
    for keyword in ("anyOf", "oneOf"):
        if keyword in key:
            choices = [each for each in key[keyword] if each.get("type") != "null"]
            return " or ".join(dict.fromkeys(map(kind_of, choices)))
    if key["type"] == "array":
        return list_of(key)
    if key["type"] == "integer":
        return f"whole number{limits(key)}"
    if key["type"] == "number":
        return f"number{limits(key)}"
    if "examples" in key:
        return f"`{key['examples'][0]}`"
    return {"string": "text", "boolean": "`true`, `false`"}[key["type"]]


def list_of(key: Schema) -> str:
    """Return the lists that a key accepts, in words."""
    item = kind_of(key.get("items", {"type": "string"}))
    length = key.get("minItems", 0)
    if length != key.get("maxItems", 1):
        return f"list of {item}"
    if length == 2:
        return "[low, high]"
    return item.replace("number", f"{length} numbers")


def limits(key: Schema) -> str:
    """Return the range of a number, without huge upper limits."""
    signs = {
        "minimum": "≥",
        "exclusiveMinimum": ">",
        "maximum": "≤",
        "exclusiveMaximum": "&lt;",
    }
    bounds = [
        f"{sign} {short(key[name])}"
        for name, sign in signs.items()
        if name in key and (key[name] <= 1e5 or name == "exclusiveMinimum")
    ]
    return f" {', '.join(bounds)}" if bounds else ""


def short(value: float) -> str:
    """Return a limit in its shortest form."""
    if abs(abs(value) - math.pi / 2) < 1e-12:
        return "-pi/2" if value < 0 else "pi/2"
    if isinstance(value, int) and value > 1e15:
        power = value.bit_length()
        if value == 1 << (power - 1):
            return f"2^{power - 1}"
        return f"2^{power} - 1"
    return f"{value:g}"


# --------------------------------------------------------------- columns


def columns_page() -> str:
    """Return the page of the columns."""
    always = [group for group in columns.GROUPS if not group.optional]
    optional = [group for group in columns.GROUPS if group.optional]
    tables: dict[str, list[pa.Field]] = {}
    for group in (*always, columns.STATE_GROUP, columns.SIZE_GROUP):
        fields = tables.setdefault(group.heading, [])
        fields += [column.field for column in group.columns]
    lines = [COLUMNS_HEAD, "## `runs`\n"]
    for heading, fields in tables.items():
        lines.append(f"### {heading}\n\n{fields_table(fields)}\n")
    for group in optional:
        note = ""
        models = [name for name in MODEL_NAMES if name not in group.not_with]
        if len(models) == 1:
            note = f"With `model: {models[0]}`.\n\n"
        fields = [column.field for column in group.columns]
        lines.append(f"### {group.heading}\n\n{note}{fields_table(fields)}\n")
    rim = arrow.field("rim", arrow.F64, *about("rim"))
    lines.append(f"### Bodies with a rim\n\n{fields_table([rim])}\n")
    lines.append(f"## `summary`\n\n{SUMMARY_HEAD}\n{fields_table(summary.SCHEMA)}\n")
    statuses = [(f"`{status.label}`", status.meaning) for status in Status]
    lines.append(TYPES_LINK)
    lines.append(f"## Status words\n\n{table([('word', 'meaning'), *statuses])}")
    return "\n".join(lines)


def fields_table(fields: Iterable[pa.Field]) -> str:
    """Return columns as a table.

    Columns in a row that differ by a letter or a number, such as components of a
    vector, share a row of the table.
    """
    rows = [("column", "type, unit", "meaning")]
    for alike, group in itertools.groupby(fields, _pattern):
        members = list(group)
        names = ", ".join(f"`{field.name}`" for field in members)
        meaning = _meaning(members[0])
        if len(members) > 1:
            varying = [re.findall(VARYING, _meaning(field)) for field in members]
            values = zip(*varying, strict=True)
            first, *rest = re.split(VARYING, meaning)
            meaning = first
            for each, words in zip(values, rest, strict=True):
                meaning += ", ".join(each) + words
        rows.append((names, alike[0], meaning))
    return table(rows)


VARYING = r"\b[xyz]\b|\b0\.\d\b"  # components, and thresholds of friction


def _meaning(field: pa.Field) -> str:
    return field.metadata[b"description"].decode().replace("<", "&lt;")


def _pattern(field: pa.Field) -> tuple[str, str]:
    """Return the type and unit of a column, and its meaning without what varies."""
    kind = str(field.type).replace("list<element: double>", "list of double")
    if field.nullable:
        kind += "?"
    unit = field.metadata[b"unit"].decode()
    if unit != "1":
        kind += f", `{unit}`"
    meaning = re.sub(VARYING, "_", _meaning(field))
    # Equal meanings without anything that varies are those of different columns.
    return kind, meaning if "_" in meaning.split() else field.name


# ------------------------------------------------------------------ both


def yaml(value: Any) -> str:
    """Return a value as YAML in flow style."""
    if isinstance(value, dict):
        entries = (f"{name}: {yaml(inner)}" for name, inner in value.items())
        return f"{{{', '.join(entries)}}}"
    if isinstance(value, list):
        return f"[{', '.join(map(yaml, value))}]"
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, float):
        return f"{value:g}"
    return str(value)


def table(rows: Sequence[tuple[str, ...]]) -> str:
    """Return rows as a Markdown table; the first row is the head."""
    lines: list[str] = []
    for row in rows:
        cells = [cell.replace("|", "\\|") for cell in row]
        lines.append(f"| {' | '.join(cells)} |")
    ruler = "|".join(["---"] * len(rows[0]))
    lines.insert(1, f"|{ruler}|")
    return "\n".join(lines)


PAGES = {"config.md": config_page, "columns.md": columns_page}


def main() -> int:
    """Write or compare the pages."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--check", action="store_true", help="write nothing; exit with 1 if out of date"
    )
    only_checks = parser.parse_args().check
    outdated: list[str] = []
    for name, page in PAGES.items():
        path = DOCS / name
        text = page().rstrip() + "\n"
        if not only_checks:
            path.write_text(text)
        elif not path.exists() or path.read_text() != text:
            outdated.append(name)
    if outdated:
        pages = ", ".join(outdated)
        print(
            f"out of date: {pages}; run python docs/make_reference.py", file=sys.stderr
        )
        return 1
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
