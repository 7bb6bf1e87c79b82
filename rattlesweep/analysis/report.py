"""Self-contained HTML pages made from `templates/`, and the report of a sweep."""

import base64
import io
import re
import shlex
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined
from ruamel.yaml import YAML

from rattlesweep.analysis.layout import Layout, read_layout
from rattlesweep.analysis.plots import choose_picture, default_kind
from rattlesweep.analysis.style import encode, styled
from rattlesweep.errors import ConfigError, OutputError
from rattlesweep.sweeps.config.read import resolved
from rattlesweep.sweeps.sessions import read_sessions
from rattlesweep.sweeps.status import status
from rattlesweep.sweeps.summary import absent_columns, count_cases, summary_table

DPI = 120
MOST_SVG = (
    400_000  # bytes; larger pictures become PNG, or a page of seven would exceed 5 MB
)
MOST_FITTING = 480.0  # points of width of a picture that is shrunk to a narrow screen
MOST_SESSIONS = 200


def render(template: str, **values: Any) -> bytes:
    """Return a page; `values` holds the names that its template uses, among them
    `title`.
    """
    loader = PackageLoader("rattlesweep.analysis", "templates")
    environment = Environment(
        loader=loader,
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters |= {"thousands": "{:,}".format, "shell": shlex.join}
    return environment.get_template(template).render(values).encode()


def embedded(svg: bytes, png: bytes) -> Mapping[str, Any]:
    """Return a picture as a data URL: the SVG, or the PNG if the SVG is too large; and
    its class.

    A wide picture scrolls on a narrow screen, where its text would be too small to
    read.
    """
    kind, data = ("svg+xml", svg) if len(svg) <= MOST_SVG else ("png", png)
    url = f"data:image/{kind};base64,{base64.b64encode(data).decode('ascii')}"
    width = re.search(rb'<svg[^>]* width="([\d.]+)pt"', svg)
    return {"url": url, "wide": width is not None and float(width[1]) > MOST_FITTING}


def config_yaml(config: Mapping[str, Any]) -> str:
    """Return a resolved config as YAML, with its innermost mappings and lists in one
    line.
    """
    yaml: Any = YAML(typ="safe", pure=True)
    yaml.default_flow_style = None
    yaml.sort_base_mapping_type_on_output = False
    yaml.width = 96
    buffer = io.StringIO()
    yaml.dump(config, buffer)
    return buffer.getvalue()


def make_report(directory: Path, title: str | None = None) -> bytes:
    """Return the report of a sweep, finished or still running, as a self-contained
    page.
    """
    layout = read_layout(directory)
    stored, state, sessions = layout.stored, status(directory), read_sessions(directory)
    rows = stored.read(["case", "sample", "status", "n_steps"]).to_pandas()
    counts = count_cases(stored)
    table = summary_table(stored.cases, counts)
    absent = {"K_p", "K_r"}.difference(layout.axes) | absent_columns(table)
    absent |= set() if "sensitive" in counts else {"t_r_mean_error"}
    table = table.drop_columns([*absent & {*table.column_names}, "near_tangencies"])
    first = default_kind(layout)
    curves = (
        ("times", "ratio")
        if first not in ("map", "reversals") and layout.several
        else ()
    )
    return render(
        "sweep.html.j2",
        title=title or stored.manifest["name"],
        stored=stored,
        done=state.data["runs"] >= state.data["wanted"],
        state=state.data,
        counts=counts,
        steps=rows["n_steps"].sum(),
        pictures=[
            _shown(layout, kind)
            for kind in dict.fromkeys((first, *curves, "distribution"))
        ],
        case_head=table.column_names,
        cases=[*zip(*table.to_pydict().values(), strict=True)],
        failures=[
            (
                word,
                len(own),
                f"{100 * len(own) / len(rows):.3g} %",
                f"case {own['case'].iloc[0]}, sample {own['sample'].iloc[0]}",
            )
            for word, own in rows[rows["status"] != "ok"].groupby("status")
        ],
        thresholds=[
            (key, value, stored.thresholds.thresholds[key])
            for key, value in stored.config.classify.thresholds.items()
        ],
        config=config_yaml(resolved(stored.config)),
        seconds=sum(s.get("seconds") or 0.0 for s in sessions),
        sessions=[
            [
                str(s.get("started"))[:19],
                *map(s.get, ("how", "shard", "host", "threads", "runs", "seconds")),
            ]
            for s in sessions[-MOST_SESSIONS:]
        ],
    )


def _shown(layout: Layout, kind: str) -> Mapping[str, Any]:
    """Return a picture for the page, or the error if it has too many panels or no
    runs.
    """
    try:
        with styled():
            picture = choose_picture(layout, kind)
            figure = picture.figure(captioned=False)
            svg = encode(figure, "svg", DPI)
            png = encode(figure, "png", DPI) if len(svg) > MOST_SVG else b""
    except (ConfigError, OutputError) as error:
        return {"kind": kind, "error": error}
    varies = ", ".join(axis.name for axis in picture.axes) or "all runs"
    return {
        "kind": kind,
        "error": None,
        "image": embedded(svg, png),
        "varies": varies,
        "caption": " ".join(picture.notes),
    }
