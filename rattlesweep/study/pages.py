"""Pages that need nothing but themselves, made of `templates/`; all text in them is escaped."""

from __future__ import annotations

import base64
import io
from collections.abc import Mapping, Sequence
from functools import cache
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined
from ruamel.yaml import YAML
from ruamel.yaml.comments import CommentedMap, CommentedSeq

from rattlesweep.durations import clock
from rattlesweep.sweeps.config.fields import Linspace, Logspace

# Larger vector pictures are shown as PNG, or a page of seven would pass 5 MB.
MOST_SVG = 400_000
# A list at least this long is written as an axis if it is one to the last bit.
LONG = 8


def render(template: str, **values: Any) -> bytes:
    """A page; `values` are the names that its template uses, `title` among them."""
    return _environment().get_template(template).render(values).encode()


@cache
def _environment() -> Environment:
    environment = Environment(
        loader=PackageLoader("rattlesweep.study", "templates"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters |= {"thousands": "{:,}".format, "percent": percent, "seconds": _seconds}
    return environment


def percent(part: int, whole: int) -> str:
    """A share in per cent; a few of many do not read as none, nor all but a few as all."""
    value = 100 * part / whole
    if part and value < 0.1:
        return "< 0.1 %"
    if part < whole and value > 99.9:
        return "> 99.9 %"
    return f"{value:.1f} %"


def _seconds(value: float) -> str:
    return f"{value:.1f} s" if value < 600 else clock(value)


def source(svg: bytes, png: bytes) -> str:
    """A picture as the address of an image; the smaller kind if the vectors are many."""
    kind, data = ("svg+xml", svg) if len(svg) <= MOST_SVG else ("png", png)
    return f"data:image/{kind};base64,{base64.b64encode(data).decode('ascii')}"


def config_yaml(config: Mapping[str, Any]) -> str:
    """YAML text of a resolved config; long lists of evenly spaced numbers become axes."""
    yaml = YAML()
    yaml.width = 96
    buffer = io.StringIO()
    yaml.dump(_shaped(config, 0), buffer)
    return buffer.getvalue()


def _shaped(value: Any, depth: int) -> Any:
    if isinstance(value, Mapping):
        mapping = CommentedMap((key, _shaped(v, depth + 1)) for key, v in value.items())
        for name in ("linspace", "logspace"):
            if name in mapping:
                low, high, count = mapping[name]
                mapping[name] = _flow([low, high, int(count)])
        if depth and not any(isinstance(v, CommentedMap) for v in mapping.values()):
            mapping.fa.set_flow_style()
        return mapping
    if isinstance(value, list):
        if len(value) >= LONG and (axis := _axis(value)):
            return _shaped(axis, 1)
        return _flow(value)
    return value


def _flow(values: Sequence[Any]) -> CommentedSeq:
    sequence = CommentedSeq(values)
    sequence.fa.set_flow_style()
    return sequence


def _axis(values: Sequence[Any]) -> dict[str, list[float]] | None:
    if not all(isinstance(value, float) for value in values):
        return None
    ends = [values[0], values[-1], float(len(values))]
    for kind, name in ((Linspace, "linspace"), (Logspace, "logspace")):
        try:
            if kind.model_validate({name: ends}).values() == list(values):
                return {name: [ends[0], ends[1], len(values)]}
        except ValueError:
            continue  # no ratio leads from one end to the other
    return None
