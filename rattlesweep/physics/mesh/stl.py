"""STL files, as most meshes for printers are.

A binary file has a header of 80 bytes and the number of triangles, then 50 bytes for
each: its normal, three corners, and two bytes without a meaning.  A text has a line for
each corner.  Read by NumPy alone, 200,000 triangles of a binary file take a tenth of a
second; the library for meshes takes as long to import as all the rest of the command.
"""

from __future__ import annotations

import re

import numpy as np

from rattlesweep.arrays import Floats, Integers

_HEADER = 84
_TRIANGLE = np.dtype(
    [("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")]
)
# A line begins after any line end, which is CR alone in files of old programs.
_CORNER = re.compile(rb"^[ \t]*vertex[ \t]+([^\r\n]*)", re.IGNORECASE | re.MULTILINE)
_FACET = re.compile(rb"^[ \t]*facet\b", re.IGNORECASE | re.MULTILINE)
_END = re.compile(rb"^[ \t]*endsolid\b", re.IGNORECASE | re.MULTILINE)


def read_stl(content: bytes) -> tuple[Floats, Integers, tuple[str, ...]]:
    """Return vertices, shape (n, 3), triangles, and remarks on what is odd."""
    if _is_text(content):
        vertices = _corners_of_text(content)
        remarks: tuple[str, ...] = ()
    else:
        vertices, remarks = _corners_of_records(content)
    return vertices, np.arange(len(vertices)).reshape(-1, 3), remarks


def _is_text(content: bytes) -> bool:
    """Whether a file is a text; binary ones may also begin with ``solid``."""
    start = content[:1024].removeprefix(b"\xef\xbb\xbf").lstrip()
    return start[:5].lower() == b"solid" and b"\0" not in start


def _corners_of_text(content: bytes) -> Floats:
    text = content.replace(b"\r\n", b"\n").replace(b"\r", b"\n")
    n_facets = len(_FACET.findall(text))
    lines = _CORNER.findall(text)
    if not n_facets:
        raise ValueError(
            "the STL has no triangles: it is a text without 'facet'; export the stone "
            "again"
        )
    if not _END.search(text) or len(lines) != 3 * n_facets:
        raise ValueError(
            f"the STL is cut short: it has {n_facets:,} facets with {len(lines):,} "
            "corners, where each has three, and ends with 'endsolid'; export it again"
        )
    try:
        corners = np.array(b" ".join(lines).split(), dtype=float).reshape(-1, 3)
    except ValueError:
        raise ValueError(
            "a line 'vertex' of the STL has no three numbers, with a point for "
            "decimals; export it again"
        ) from None
    if len(corners) != len(lines):
        raise ValueError(
            "a line 'vertex' of the STL has no three numbers; export it again"
        )
    return corners


def _corners_of_records(content: bytes) -> tuple[Floats, tuple[str, ...]]:
    size = _TRIANGLE.itemsize
    if len(content) < _HEADER:
        raise ValueError(
            f"cannot be read as STL: it has {len(content)} bytes, and the head alone "
            f"takes {_HEADER}"
        )
    count = int.from_bytes(content[80:_HEADER], "little")
    length = len(content) - _HEADER
    remarks: tuple[str, ...] = ()
    if not count and not length:
        raise ValueError("the STL has no triangles; export the stone again")
    if not count and length % size == 0:
        # Programs that write as they go leave it so; the mesh must be closed anyway.
        count = length // size
        remarks = (
            f"the STL says that it has 0 triangles, and has {count:,}, which are read",
        )
    found = length // size
    if not count:
        raise ValueError(
            "the STL says that it has 0 triangles, and its bytes are no whole number "
            "of them; export it again"
        )
    if found < count:
        if not _is_plausible(content[_HEADER : _HEADER + size * min(found, 100)]):
            raise ValueError(
                "cannot be read as STL: it is neither a text that begins with 'solid' "
                "nor a binary one"
            )
        raise ValueError(
            f"the STL is cut short: it says that it has {count:,} triangles, and has "
            f"{found:,}; copy or export it again"
        )
    extra = length - count * size
    if extra:
        remarks = (
            f"{extra:,} bytes after the last of the {count:,} triangles of the STL are "
            "not read",
        )
    triangles = np.frombuffer(content, _TRIANGLE, count, _HEADER)
    return triangles["corners"].reshape(-1, 3).astype(float), remarks


def _is_plausible(records: bytes) -> bool:
    """Whether bytes are triangles: there are some, of numbers of a usual size."""
    corners = np.frombuffer(records, _TRIANGLE)["corners"]
    with np.errstate(invalid="ignore"):
        sizes = np.abs(corners)
        return bool(corners.size and np.isfinite(corners).all() and sizes.max() < 1e9)
