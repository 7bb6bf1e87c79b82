"""Kernels that quick tests may use: what they compile takes a third of their time.

A test that needs another kernel is slow.  A model is added here where a law has no
quick test otherwise, which costs 10 to 40 seconds of processor time.
"""

from __future__ import annotations

from typing import Any

import pytest

from rattlesweep.compiling import loading

# Models, each with all of its parts.
MODELS = {
    "full",
    "full_attitude",
    "full_tangent",
    "full_frame",
    "full_viscous",
    "full_rolling",
    "full_pivoting",
    "full_sliding",
    "full_slip",
    "full_shaken",
    "ellipsoid",
    "ellipsoid_attitude",
    "ellipsoid_viscous",
    "ellipsoid_viscous_attitude",
    "ellipsoid_rolling",
    "ellipsoid_creep_pivoting",
    "ellipsoid_sliding",
    "reduced",
    "reduced_lossy",
    "vectors",
    "vectors_attitude",
}
# Parts of these models that few quick tests would need.
RARE = {
    ("answer_recipe", "full", "rimmed"),
    ("look_recipe", "full_tangent", "reversals"),
    ("look_recipe", "full_pivoting", "reversals"),
    ("look_recipe", "ellipsoid_rolling", "reversals"),
    ("note_recipe", "full_tangent"),
    ("attempt_recipe", "dop853", "full_tangent", "volume"),
    ("attempt_recipe", "dop853", "full_frame", "volume"),
    ("attempt_recipe", "dop853", "ellipsoid", "volume"),
    ("attempt_recipe", "dop853", "vectors", "volume"),
}

_load = loading._load
is_quick = False


def is_kept(recipe: str, *names: str | bool) -> bool:
    """Return whether a quick test may use a kernel."""
    if any((recipe, *names)[: len(rare)] == rare for rare in RARE):
        return False
    if recipe == "drive_recipe":
        return True
    models = [name for name in names if isinstance(name, str)]
    if recipe == "attempt_recipe":
        models = models[1:2]
    return not models or models[0] in MODELS


def load(recipe: Any, *names: str | bool) -> Any:
    """Replace ``loading._load`` while the tests run."""
    is_shipped = recipe.__module__.startswith("rattlesweep.kernel")
    if is_quick and is_shipped and not is_kept(recipe.__name__, *names):
        pytest.fail(
            f"{recipe.__name__} {names} is not in tests/helpers/quick_kernels.py: "
            "mark the test as slow"
        )
    return _load(recipe, *names)
