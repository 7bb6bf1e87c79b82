"""Copies of functions that see other globals."""

from __future__ import annotations

import types
from collections.abc import Callable
from typing import Any


def specialise(template: Callable[..., Any], name: str, **bindings: Any) -> Any:
    """Copy of a function that sees other globals, under a name of its own.

    Numba recompiles at every start what closes over a compiled function, because its cache key
    then holds an identity that changes.  Globals are frozen into the code and are not part of the
    key; the name is, and so each specialisation has its own file and symbols.
    """
    code = types.FunctionType(template.__code__, {**template.__globals__, **bindings}, name)
    code.__qualname__ = name
    code.__module__ = template.__module__
    return code
