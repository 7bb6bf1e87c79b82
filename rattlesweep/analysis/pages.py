"""Pages that need nothing but themselves, made of `templates/`; all text in them is escaped."""

from __future__ import annotations

import base64
import io
from collections.abc import Mapping
from contextlib import suppress
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined
from ruamel.yaml import YAML

from rattlesweep.sweeps.config.schema import spaced

# Larger vector pictures are shown as PNG, or a page of seven would pass 5 MB.
MOST_SVG = 400_000
# A list at least this long is written as an axis if it is one to the last bit.
LONG = 8


def render(template: str, **values: Any) -> bytes:
    """Return a page; `values` are the names that its template uses, `title` among them."""
    environment = Environment(
        loader=PackageLoader("rattlesweep.analysis", "templates"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters |= {"thousands": "{:,}".format, "percent": percent}
    return environment.get_template(template).render(values).encode()


def percent(part: int, whole: int) -> str:
    """Return a share in per cent; a few of many do not read as none, nor nearly all as all."""
    value = 100 * part / whole
    if part and value < 0.1:
        return "< 0.1 %"
    return "> 99.9 %" if part < whole and value > 99.9 else f"{value:.1f} %"


def source(svg: bytes, png: bytes) -> str:
    """Return a picture as the address of an image; the smaller kind if the vectors are many."""
    kind, data = ("svg+xml", svg) if len(svg) <= MOST_SVG else ("png", png)
    return f"data:image/{kind};base64,{base64.b64encode(data).decode('ascii')}"


def config_yaml(config: Mapping[str, Any]) -> str:
    """Return the YAML of a resolved config; long lists of evenly spaced numbers become axes."""
    yaml: Any = YAML(typ="safe", pure=True)
    # What holds no other mapping or list stands in one line, but the whole; keys in their order.
    nested = any(isinstance(value, Mapping | list) for value in config.values())
    yaml.default_flow_style = None if nested else False
    yaml.sort_base_mapping_type_on_output = False
    yaml.width = 96
    buffer = io.StringIO()
    yaml.dump(_shaped(config), buffer)
    return buffer.getvalue()


def _shaped(value: Any) -> Any:
    """Return a value as a person would write it: axes as such, whole counts."""
    if isinstance(value, list) and len(value) >= LONG:
        for name in ("linspace", "logspace"):
            with suppress(ValueError, TypeError):  # not even numbers
                if spaced(name, value[0], value[-1], len(value)) == value:
                    return {name: [value[0], value[-1], len(value)]}
    if isinstance(value, Mapping):
        for name in {"linspace", "logspace"} & value.keys():
            low, high, count = value[name]
            return {name: [low, high, int(count)]}
        return {key: _shaped(each) for key, each in value.items()}
    return value
