"""Compiled :func:`follow.march` and :func:`follow.aside` of all methods and models."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from rattlesweep.integrate.cache import cached, keep, specialise
from rattlesweep.integrate.follow import march as follow
from rattlesweep.integrate.lanes import columns as C
from rattlesweep.integrate.lanes import kernel as lanes
from rattlesweep.integrate.lanes import runs
from rattlesweep.integrate.lanes.build import (
    attempt,
    bind,
    mark,
    names,
    parts,
    settle,
    workspace,
)
from rattlesweep.integrate.lanes.step import Layout, compile_attempt, compile_lane_functions
from rattlesweep.integrate.loading import together
from rattlesweep.integrate.model import FULL, MODELS, Model
from rattlesweep.integrate.tableau import DOP853, METHODS
from rattlesweep.physics import attitude, full

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from rattlesweep.integrate.tableau import Tableau

# In the order in which they call each other.
TEMPLATES = (
    runs.see_contact,
    runs.start,
    runs.idle,
    runs.stay,
    lanes.decide,
    lanes.commit,
)


@full.scalar
def _spin(p, q, a, b, c, heading, x, y):  # type: ignore[no-untyped-def]
    return full.spin(p, q, a, b, c)


@full.scalar
def _spin_rate(p, q, a, b, c, heading, x, y, dp, dq, da, db, dc, dh, dx, dy):  # type: ignore[no-untyped-def]
    return full.spin_rate(p, q, da, db, dc)


@full.scalar
def _nothing(p, q, a, b, c, heading, x, y):  # type: ignore[no-untyped-def]
    return 0.0


@full.scalar
def _no_error(ep, eq, ea, eb, ec, eh, ex, ey, p, q, a, b, c, h, x, y, ix, iy, iz, cxx, cxy, cyy):  # type: ignore[no-untyped-def]
    return 0.0, 1.0


ATTITUDE = Model(
    name="attitude",
    n_state=full.N_STATE + attitude.N_EXTRA,
    n_constants=full.N_CONSTANTS,
    n_probe=0,
    rhs=attitude.rhs,
    spin=_spin,
    spin_rate=_spin_rate,
    amplitude=_nothing,
    error=_no_error,
    energy=full.energy,
    contact=full.contact_force,
)
"""The full model with heading and track; its steps go from the full model's, never far."""


def _model(name: str) -> tuple[Model, int]:
    """Model, and how many of its components an accepted step has."""
    return (ATTITUDE, FULL.n_state) if name == ATTITUDE.name else (MODELS[name], 99)


def build_march(adaptive: bool, model: Model) -> Callable[..., None]:
    """Compile :func:`follow.march` of a model when it is first called."""
    bindings = names(adaptive, model)
    suffix = f"_{model.name}{mark(adaptive)}"
    bind(TEMPLATES, bindings, "_march" + suffix)
    compiled: Callable[..., None] = cached(
        specialise(follow.march, "march" + suffix, **bindings), nogil=True, error_model="numpy"
    )
    return compiled


def build_aside(name: str) -> Callable[..., None]:
    """Compile :func:`follow.aside` of a model when it is first called."""
    model, given = _model(name)
    at = Layout.of(model)
    bindings: dict[str, Any] = {
        "N_STATE": model.n_state,
        "N_CONSTANTS": model.n_constants,
        "N_GIVEN": min(given, model.n_state),
        "Y": at.y,
        "F": at.f,
        "Y1": at.y1,
        "Q": at.constants,
        "lane_rhs": compile_lane_functions(model)["lane_rhs"],
    }
    compiled: Callable[..., None] = cached(
        specialise(follow.aside, f"aside_{name}", **bindings), nogil=True, error_model="numpy"
    )
    return compiled


def aside_workspace(tableau: Tableau, name: str) -> NDArray[np.float64]:
    """``w``, the first argument of aside."""
    w: NDArray[np.float64] = workspace(tableau, _model(name)[0], 1)[0]
    return w


def march_example(model_name: str, adaptive: bool) -> tuple[Any, tuple[Any, ...]]:
    """March, not yet compiled, and arguments to call it with."""
    model = MODELS[model_name]
    return build_march(adaptive, model), (
        parts(),
        workspace(DOP853, model, 1)[0],
        np.zeros((1, model.n_state)),
        np.zeros((1, model.n_constants)),
        np.zeros((1, model.n_probe)),
        np.zeros((1, C.N_PLAN)),
        np.zeros(C.N_OPTIONS),
        np.zeros(C.N_RECORD, dtype=np.bool_),
        np.zeros((0, follow.STATE + 2 * model.n_state)),
        np.zeros(0),
        np.zeros(follow.N_COUNTS, dtype=np.int64),
    )


def aside_example(model_name: str) -> tuple[Any, tuple[Any, ...]]:
    """Aside, not yet compiled, and arguments to call it with."""
    model, given = _model(model_name)
    return build_aside(model_name), (
        parts(),
        aside_workspace(DOP853, model_name),
        np.zeros((1, follow.STATE + 2 * min(given, model.n_state))),
        np.zeros(0, dtype=np.int64),
        np.zeros(0),
        np.zeros(model.n_constants),
        np.zeros((0, model.n_state)),
    )


def attitude_attempt(tableau_name: str) -> tuple[Any, tuple[Any, ...]]:
    """The step of a method with heading and track, not yet compiled, and arguments for it."""
    tableau = METHODS[tableau_name]
    return keep(compile_attempt(tableau, ATTITUDE)), (workspace(tableau, ATTITUDE, 1)[0], 1.0)


def _of_march(tableau_name: str, model_name: str) -> list[tuple[Any, ...]]:
    adaptive = METHODS[tableau_name].adaptive
    step = (attempt, tableau_name, model_name)
    return [(march_example, model_name, adaptive), step, (settle, adaptive)]


def _of_aside(tableau_name: str, model_name: str) -> list[tuple[Any, ...]]:
    step: tuple[Any, ...] = (attempt, tableau_name, model_name)
    if model_name == ATTITUDE.name:
        step = (attitude_attempt, tableau_name)
    return [(aside_example, model_name), step]


def march_kernel(tableau_name: str, model_name: str) -> Callable[..., None]:
    """March by names; the first call on a machine takes the time of its compilation."""
    march, *others = together(*_of_march(tableau_name, model_name))
    return partial(march, parts(*others))


def aside_kernel(tableau_name: str, model_name: str) -> Callable[..., None]:
    """Aside by names, ``attitude`` among them; likewise."""
    aside, *others = together(*_of_aside(tableau_name, model_name))
    return partial(aside, parts(*others))


def load_all(tableau_name: str, model_name: str, attitude: bool) -> None:
    """Load march and aside of a model, and aside of the attitude, at the same time."""
    wanted = _of_march(tableau_name, model_name) + _of_aside(tableau_name, model_name)
    if attitude:
        wanted += _of_aside(tableau_name, ATTITUDE.name)
    together(*dict.fromkeys(wanted))
