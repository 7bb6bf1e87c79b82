"""Pages that need nothing but themselves, made of `templates/`; all text in them is escaped."""

from __future__ import annotations

import base64
from functools import cache
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined

# Larger vector pictures are shown as PNG, or a page of seven would pass 5 MB.
MOST_SVG = 400_000


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
    environment.filters |= {"thousands": "{:,}".format, "percent": percent}
    return environment


def percent(part: int, whole: int) -> str:
    """A share in per cent; a few of many do not read as none, nor all but a few as all."""
    value = 100 * part / whole
    if part and value < 0.1:
        return "< 0.1 %"
    if part < whole and value > 99.9:
        return "> 99.9 %"
    return f"{value:.1f} %"


def source(svg: bytes, png: bytes) -> str:
    """A picture as the address of an image; the smaller kind if the vectors are many."""
    kind, data = ("svg+xml", svg) if len(svg) <= MOST_SVG else ("png", png)
    return f"data:image/{kind};base64,{base64.b64encode(data).decode('ascii')}"
