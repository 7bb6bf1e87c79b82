"""JSON that proves whole: the last key is the SHA-256 of all the rest."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from typing import Any

from rattlesweep.errors import DamagedError

_KEY = "checksum"


def dump(data: Mapping[str, Any]) -> bytes:
    """Turn plain data into bytes, keys in the order given; floats come back bit for bit.

    NaN, infinity and what JSON has no word for are mistakes of the calling code: a ValueError or
    TypeError.
    """
    digest = hashlib.sha256(_text(data)).hexdigest()
    return _text({**data, _KEY: digest})


def load(text: bytes) -> dict[str, Any]:
    """Read back what `dump` made, to the byte; anything else is a DamagedError."""
    try:
        data = json.loads(text)
        if not isinstance(data, dict):
            raise DamagedError("it holds no object")
        data.pop(_KEY, None)
        if dump(data) == text:
            return data
    except RecursionError:
        raise DamagedError("it is nested too deeply") from None
    except ValueError as error:
        raise DamagedError(str(error)) from None
    raise DamagedError("its checksum does not match")


def _text(data: Mapping[str, Any]) -> bytes:
    text = json.dumps(dict(data), indent=2, allow_nan=False, ensure_ascii=False)
    return text.encode() + b"\n"
