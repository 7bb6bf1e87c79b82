"""JSON that proves whole: the last key is the SHA-256 of all the rest."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

_KEY = "checksum"


def dump(data: Mapping[str, Any]) -> bytes:
    """Turn plain data into bytes, keys in the order given.

    Floats come back bit for bit. NumPy scalars and paths are written as what they mean.

    Raises
    ------
    ValueError, TypeError
        It holds NaN, infinity, or something JSON has no word for.
    """
    digest = hashlib.sha256(_text(data)).hexdigest()
    return _text({**data, _KEY: digest})


def load(text: bytes) -> dict[str, Any]:
    """Read back what `dump` made, to the byte.

    Raises
    ------
    ValueError
        It is something else; says what in a few words.
    """
    try:
        data = json.loads(text)
    except RecursionError as error:
        raise ValueError("it is nested too deeply") from error
    if not isinstance(data, dict):
        raise ValueError("it holds no object")
    data.pop(_KEY, None)
    try:
        same = dump(data) == text
    except (ValueError, UnicodeEncodeError):
        same = False
    if not same:
        raise ValueError("its checksum does not match")
    return data


def _text(data: Mapping[str, Any]) -> bytes:
    text = json.dumps(dict(data), indent=2, allow_nan=False, ensure_ascii=False, default=_plain)
    return text.encode() + b"\n"


def _plain(value: Any) -> Any:
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, Path):
        return str(value)
    raise TypeError(f"internal error: {type(value).__name__} in the manifest")
