"""Coefficients of the methods against order conditions, and their damping."""

import math
from dataclasses import replace
from functools import cache
from itertools import combinations_with_replacement

import numpy as np
import pytest

from rattlesweep.kernel.method.tableau import METHODS

# A rooted tree is the sorted tuple of the trees that hang from its root; () is a lone
# root.


@cache
def size(tree):
    return 1 + sum(size(branch) for branch in tree)


@cache
def density(tree):
    return size(tree) * math.prod(density(branch) for branch in tree)


@cache
def trees(order):
    """Every rooted tree with ``order`` nodes."""
    return tuple(forests(order - 1, order - 1))


def forests(nodes, largest):
    """Every multiset of trees with ``nodes`` nodes, none larger than ``largest``."""
    if nodes == 0:
        yield ()
        return
    for biggest in range(min(nodes, largest), 0, -1):
        for count in range(1, nodes // biggest + 1):
            for some in combinations_with_replacement(trees(biggest), count):
                for rest in forests(nodes - count * biggest, biggest - 1):
                    yield some + rest


def matrix(tableau):
    """``a`` and ``b`` as arrays; the last stage is the derivative at the step's end."""
    a = np.stack([weights(row, tableau) for row in (*tableau.a, tableau.b)])
    return a, a[-1]


def weights(row, tableau):
    out = np.zeros(tableau.stages + 1)
    for j, value in row.items():
        out[j] = value
    return out


def defects(a, b, order):
    """Return the defects of the conditions of an order, times the trees' densities."""

    def stage(tree):
        return math.prod((a @ stage(branch) for branch in tree), start=np.ones(len(a)))

    return np.array([abs(b @ stage(tree) * density(tree) - 1) for tree in trees(order)])


def order_of(a, b):
    """Return the order up to which every condition holds."""
    order = 0
    while order < 9 and defects(a, b, order + 1).max() < 1e-11:
        order += 1
    return order


@pytest.mark.parametrize("tableau", METHODS.values(), ids=METHODS)
def test_every_order_condition_holds_up_to_the_order_and_no_further(tableau):
    a, b = matrix(tableau)
    assert order_of(a, b) == tableau.order


@pytest.mark.parametrize(
    ("name", "orders"), [("rk4", []), ("dopri5", [4]), ("dop853", [5, 3])]
)
def test_embedded_solutions_have_their_orders(name, orders):
    a, b = matrix(METHODS[name])
    errors = METHODS[name].errors
    assert [order_of(a, b - weights(row, METHODS[name])) for row in errors] == orders


def test_damping_of_an_oscillation():
    z = np.array([0.1, 0.2, 0.4])
    exact = -0.5 * np.log1p(-(z**6) / 72 + z**8 / 576)
    np.testing.assert_allclose(METHODS["rk4"].damping(z), exact, rtol=1e-6)
    assert (
        METHODS["rk4"].damping(np.array(2.83))
        < 0
        < METHODS["rk4"].damping(np.array(2.82))
    )
    for tableau in METHODS.values():
        assert abs(tableau.damping(np.array(0.1))) < 0.1 ** (tableau.order + 2)


@pytest.mark.parametrize(
    ("field", "wrong", "said"),
    [
        ("c", (0.0, 0.5, 1.0), "3 nodes, 4 stages"),
        ("a", ({}, {0: 0.5}, {1: 0.4}, {2: 1.0}), "row 2 of a: the sum is not 0.5"),
        (
            "a",
            ({}, {1: 0.5}, {1: 0.5}, {2: 1.0}),
            "row 1 of a: an index is not below 1",
        ),
        ("b", {0: 0.5, 3: 0.4}, "b: the sum is not 1"),
        ("errors", ({0: 1.0, 4: 1.0},), "row 0 of errors: the sum is not 0"),
    ],
)
def test_a_tableau_refuses_wrong_coefficients(field, wrong, said):
    with pytest.raises(ValueError, match=said):
        replace(METHODS["rk4"], **{field: wrong})
