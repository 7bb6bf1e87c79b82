"""Compiled scalar formulas as plain Python: for mpmath's numbers, or for complex ones."""

from types import FunctionType

from mpmath import mp


def exactly(function, sqrt=mp.sqrt, **others):
    """The same formulas with another square root, those that they call too, by their names."""
    formula = function.py_func
    known = formula.__globals__
    called = {
        name: exactly(known[name], sqrt, **others)
        for name in formula.__code__.co_names
        if hasattr(known.get(name), "py_func") and name not in others
    }
    return FunctionType(formula.__code__, known | {"sqrt": sqrt} | called | others)
