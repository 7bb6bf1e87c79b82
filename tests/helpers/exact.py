"""Compiled scalar formulas as plain Python, for mpmath or complex numbers."""

from types import CellType, FunctionType, ModuleType, SimpleNamespace

import numpy as np
from mpmath import mp


def exactly(function, sqrt=mp.sqrt, **others):
    """Return a formula, and all that it calls, with other globals."""
    formula = function.py_func
    names = formula.__code__.co_names
    known = formula.__globals__

    def plain(value):
        if isinstance(value, ModuleType):
            attributes = vars(value)
            return SimpleNamespace(
                **{
                    name: plain(attributes[name])
                    for name in names
                    if name in attributes
                }
            )
        return exactly(value, sqrt, **others) if hasattr(value, "py_func") else value

    called = {name: plain(known[name]) for name in names if name in known}
    closure = tuple(
        CellType(plain(cell.cell_contents)) for cell in formula.__closure__ or ()
    )
    variables = known | called | {"sqrt": sqrt} | others
    return FunctionType(
        formula.__code__,
        variables,
        argdefs=formula.__defaults__,
        closure=closure or None,
    )


def followed(rhs, state, constants, h, steps):
    """Return the state after steps of the classical Runge-Kutta method."""
    for _ in range(steps):
        one = np.array(rhs(tuple(state), constants))
        two = np.array(rhs(tuple(state + 0.5 * h * one), constants))
        three = np.array(rhs(tuple(state + 0.5 * h * two), constants))
        four = np.array(rhs(tuple(state + h * three), constants))
        state = state + h / 6 * (one + 2 * two + 2 * three + four)
    return state
