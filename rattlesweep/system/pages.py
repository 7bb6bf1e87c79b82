"""Self-contained HTML pages made from `templates/`, with their pictures inside."""

import base64
import hashlib
import io
import re
import shlex
from collections.abc import Mapping
from importlib.resources import files
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined
from ruamel.yaml import YAML

# Bytes; larger pictures become PNG, or a page of seven would exceed 5 MB.
MOST_SVG = 400_000
MOST_FITTING = 480.0  # points of width of a picture that is shrunk to a narrow screen


def render(template: str, **values: object) -> bytes:
    """Return a page; `values` are what its template names, among them `title`."""
    loader = PackageLoader("rattlesweep", "templates")
    environment = Environment(
        loader=loader,
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters |= {
        "thousands": "{:,}".format,
        "shell": shlex.join,
        "fingerprint": fingerprint,
    }
    page = environment.get_template(template).render({"script": None} | values)
    return page.encode()


def script(name: str) -> str:
    """Return a script of `templates/` that a page may have."""
    return files("rattlesweep").joinpath("templates", name).read_text("utf-8")


def fingerprint(text: str) -> str:
    """Return the hash by which a page allows a script, and no other one."""
    digest = hashlib.sha256(text.encode()).digest()
    return f"sha256-{base64.b64encode(digest).decode('ascii')}"


def embedded(svg: bytes, png: bytes) -> Mapping[str, object]:
    """Return a picture as a data URL, as PNG if its SVG is too large, and its class.

    A wide picture scrolls on a narrow screen, where its text would be too small to
    read, unless there is a narrow one to take its place.
    """
    width = re.search(rb'<svg[^>]* width="([\d.]+)pt"', svg)
    is_wide = width is not None and float(width[1]) > MOST_FITTING
    return {"url": data_url(svg, png), "wide": is_wide, "narrow": None}


def data_url(svg: bytes, png: bytes) -> str:
    """Return a picture as a data URL, as PNG if its SVG is too large."""
    kind = "svg+xml"
    data = svg
    if len(svg) > MOST_SVG:
        kind = "png"
        data = png
    return f"data:image/{kind};base64,{base64.b64encode(data).decode('ascii')}"


def config_yaml(config: Mapping[str, object]) -> str:
    """Return a resolved config as YAML, with innermost mappings and lists in a line."""
    yaml: Any = YAML(typ="safe", pure=True)
    yaml.default_flow_style = None
    yaml.sort_base_mapping_type_on_output = False
    yaml.width = 96
    buffer = io.StringIO()
    yaml.dump(config, buffer)
    return buffer.getvalue()
