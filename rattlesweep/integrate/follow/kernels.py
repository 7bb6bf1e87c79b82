"""Compiled :func:`follow.march` and :func:`follow.aside` of all methods and models."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from rattlesweep.integrate.compile import Kernel, load_kernels
from rattlesweep.integrate.follow import march as follow
from rattlesweep.integrate.lanes import columns as C
from rattlesweep.integrate.lanes.build import (
    attempt,
    mark,
    names,
    parts,
    settle,
    workspace,
)
from rattlesweep.integrate.lanes.step import OPTIONS, write_attempt
from rattlesweep.integrate.model import ELLIPSOID, FRICTION, FULL, MODELS, Model
from rattlesweep.integrate.specialise import specialise
from rattlesweep.integrate.tableau import DOP853, METHODS
from rattlesweep.physics import attitude, full, stone

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from rattlesweep.integrate.tableau import Tableau


# With the names of components and constants; what is looked at elsewhere is not looked at here.
ATTITUDE_SOURCE = """\
def rhs({state}, heading, x, y, {constants}):
    f = own_rhs({state}, {constants})
    m = p * b - q * a
    return f + track(p, q, a, b, c, heading, *touch(p, q, a, b, c, f[0], f[1], m, {shape}))

def spin({state}, heading, x, y):
    return own_spin({state})

def spin_rate({state}, heading, x, y, {rates}, dheading, dx, dy):
    return own_spin_rate({state}, {rates})

def nothing({state}, heading, x, y):
    return 0.0

def no_error(*v):
    return 0.0, 1.0
"""


def _with_attitude(model: Model, name: str) -> Model:
    """A full model with heading and track; its steps go from the model's own, never far."""
    state, constants = stone.STATE[: model.n_state], stone.CONSTANTS[: model.n_constants]
    namespace: dict[str, Any] = {
        "own_rhs": model.rhs,
        "own_spin": model.spin,
        "own_spin_rate": model.spin_rate,
        "touch": model.touch,
        "track": attitude.track,
    }
    source = ATTITUDE_SOURCE.format(
        state=", ".join(state),
        rates=", ".join(f"d{component}" for component in state),
        constants=", ".join(constants),
        # Constants of the surface stand behind those of inertia.
        shape=", ".join(constants[3:7]),
    )
    exec(source, namespace)
    compiled = {}
    for function in ("rhs", "spin", "spin_rate", "nothing", "no_error"):
        made = namespace[function]
        made.__name__ = made.__qualname__ = f"{function}_{name}"
        compiled[function] = full.scalar(made)
    return replace(
        model,
        name=name,
        n_state=model.n_state + attitude.N_EXTRA,
        n_probe=0,
        rhs=compiled["rhs"],
        spin=compiled["spin"],
        spin_rate=compiled["spin_rate"],
        amplitude=compiled["nothing"],
        error=compiled["no_error"],
        carried=None,
    )


ATTITUDES: dict[str, Model] = {
    model.name: _with_attitude(model, "attitude" if model is FULL else f"{model.name}_attitude")
    for model in (FULL, ELLIPSOID, *FRICTION.values())
}
"""Models with heading and track, by the names of those without."""


def _model(name: str) -> tuple[Model, int]:
    """Model, and how many of its components an accepted step has."""
    for plain, model in ATTITUDES.items():
        if model.name == name:
            return model, MODELS[plain].n_state
    return MODELS[name], 99


def aside_workspace(tableau: Tableau, name: str) -> NDArray[np.float64]:
    """``w``, the first argument of aside."""
    w: NDArray[np.float64] = workspace(tableau, _model(name)[0], 1)[0]
    return w


def march_example(model_name: str, adaptive: bool) -> Kernel:
    """:func:`follow.march` of a model, not yet compiled, and arguments to call it with."""
    model = MODELS[model_name]
    name = f"march_{model_name}{mark(adaptive)}"
    march = specialise(follow.march, name, **names(adaptive, model))
    arguments = (
        parts(),
        workspace(DOP853, model, 1)[0],
        np.zeros((1, model.n_state)),
        np.zeros((1, model.n_constants)),
        np.zeros((1, model.n_probe)),
        np.zeros((1, C.N_PLAN)),
        np.zeros(C.N_OPTIONS),
        np.zeros(C.N_RECORD, dtype=np.bool_),
        np.zeros((1, follow.STATE + 2 * model.n_state)),
        np.zeros(0),
        np.zeros(follow.N_COUNTS, dtype=np.int64),
        np.zeros(2),
    )
    return Kernel(march, arguments, {"nogil": True, "error_model": "numpy"})


def aside_example(model_name: str) -> Kernel:
    """:func:`follow.aside` of a model, not yet compiled, and arguments to call it with."""
    model, given = _model(model_name)
    given = min(given, model.n_state)
    bindings = {"N_GIVEN": given, "OTHERS": (0.0,) * (model.n_state - given)}
    aside = specialise(follow.aside, f"aside_{model_name}", **names(True, model), **bindings)
    arguments = (
        parts(),
        aside_workspace(DOP853, model_name),
        np.zeros((1, follow.STATE + 2 * given)),
        np.zeros(0, dtype=np.int64),
        np.zeros(0),
        np.zeros(model.n_constants),
        np.zeros((0, model.n_state)),
    )
    return Kernel(aside, arguments, {"nogil": True, "error_model": "numpy"})


def attitude_attempt(tableau_name: str, name: str) -> Kernel:
    """The step of a method with heading and track, not yet compiled, and arguments for it."""
    tableau, (model, _) = METHODS[tableau_name], _model(name)
    return Kernel(write_attempt(tableau, model), (workspace(tableau, model, 1)[0], 1.0), OPTIONS)


def _of_march(tableau_name: str, model_name: str) -> list[tuple[Any, ...]]:
    adaptive = METHODS[tableau_name].adaptive
    step = (attempt, tableau_name, model_name)
    return [(march_example, model_name, adaptive), step, (settle, adaptive)]


def _of_aside(tableau_name: str, model_name: str) -> list[tuple[Any, ...]]:
    step: tuple[Any, ...] = (attempt, tableau_name, model_name)
    if model_name not in MODELS:
        step = (attitude_attempt, tableau_name, model_name)
    return [(aside_example, model_name), step]


def march_kernel(tableau_name: str, model_name: str) -> Callable[..., None]:
    """March by names; the first call on a machine takes the time of its compilation."""
    march, *others = load_kernels(*_of_march(tableau_name, model_name))
    return partial(march, parts(*others))


def aside_kernel(tableau_name: str, model_name: str) -> Callable[..., None]:
    """Aside by names, those of :data:`ATTITUDES` among them; likewise."""
    aside, *others = load_kernels(*_of_aside(tableau_name, model_name))
    return partial(aside, parts(*others))


def load_all(tableau_name: str, model_name: str, attitude: bool) -> None:
    """Load march and aside of a model, and aside of the attitude, at the same time."""
    wanted = _of_march(tableau_name, model_name) + _of_aside(tableau_name, model_name)
    if attitude:
        wanted += _of_aside(tableau_name, ATTITUDES[model_name].name)
    load_kernels(*dict.fromkeys(wanted))
