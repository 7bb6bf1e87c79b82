"""Reversal times in double-double arithmetic (32 digits), for the worst runs.

Rounding alone moves the reversal time of a sensitive run (docs/accuracy.md).  Here the
right-hand side of :mod:`rattlesweep.physics.full` is compiled again with every number a
pair of doubles, and integrated by the extrapolated midpoint rule of Gragg, Bulirsch and
Stoer with a fixed number of columns.  There is no error control: the error is below the
change that another ``angle`` makes.
"""

from __future__ import annotations

import ast
import inspect
import textwrap
from typing import TYPE_CHECKING, Any

import numpy as np
from numba import njit

from rattlesweep.physics import full

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from rattlesweep.kernel.outcome import Batch

    Floats = NDArray[np.float64]

# Midpoint rules of 2, 4, ... substeps: order 2 * COLUMNS.
COLUMNS = 10
# Points at which the spin is evaluated in a step that may contain a zero.
POINTS = 16


@njit(inline="always")
def two_sum(a, b):  # type: ignore[no-untyped-def]
    """Sum and its rounding error (Knuth)."""
    s = a + b
    t = s - a
    return s, (a - (s - t)) + (b - t)


@njit(inline="always")
def two_product(a, b):  # type: ignore[no-untyped-def]
    """Product and its rounding error (Dekker)."""
    p = a * b
    c = 134217729.0 * a
    ah = c - (c - a)
    al = a - ah
    c = 134217729.0 * b
    bh = c - (c - b)
    bl = b - bh
    return p, ((ah * bh - p) + ah * bl + al * bh) + al * bl


@njit
def add(a, b):  # type: ignore[no-untyped-def]
    """``a + b``."""
    s, e = two_sum(a[0], b[0])
    t, f = two_sum(a[1], b[1])
    s, e = two_sum(s, e + t)
    return two_sum(s, e + f)


@njit
def sub(a, b):  # type: ignore[no-untyped-def]
    """``a - b``."""
    return add(a, (-b[0], -b[1]))


@njit
def mul(a, b):  # type: ignore[no-untyped-def]
    """``a * b``."""
    p, e = two_product(a[0], b[0])
    return two_sum(p, e + (a[0] * b[1] + a[1] * b[0]))


@njit
def div(a, b):  # type: ignore[no-untyped-def]
    """``a / b``, by two corrections."""
    q = a[0] / b[0]
    r = sub(a, mul((q, 0.0), b))
    q1 = r[0] / b[0]
    r = sub(r, mul((q1, 0.0), b))
    return add((q, 0.0), add((q1, 0.0), (r[0] / b[0], 0.0)))


@njit
def root(a):  # type: ignore[no-untyped-def]
    """Square root of a positive number, by one step of Newton's method."""
    x = (np.sqrt(a[0]), 0.0)
    return mul(add(x, div(a, x)), (0.5, 0.0))


class Pairs(ast.NodeTransformer):
    """Replace operators by calls of the functions above."""

    names = {ast.Add: "add", ast.Sub: "sub", ast.Mult: "mul", ast.Div: "div"}  # noqa: RUF012

    def visit_BinOp(self, node: ast.BinOp) -> ast.AST:
        """Replace an operator by a call, except where it joins tuples."""
        if isinstance(node.left, ast.Tuple):
            return ast.BinOp(self.visit(node.left), node.op, self.visit(node.right))
        name = ast.Name(self.names[type(node.op)], ast.Load())
        return ast.Call(name, [self.visit(node.left), self.visit(node.right)], [])

    def visit_UnaryOp(self, node: ast.UnaryOp) -> ast.AST:
        """Replace a minus sign, the only unary operator there is."""
        zero = ast.Tuple([ast.Constant(0.0), ast.Constant(0.0)], ast.Load())
        return ast.Call(
            ast.Name("sub", ast.Load()), [zero, self.visit(node.operand)], []
        )

    def visit_Constant(self, node: ast.Constant) -> ast.AST:
        """Replace a number by a pair; numbers in the source are exact."""
        if not isinstance(node.value, int | float):
            return node
        return ast.Tuple(
            [ast.Constant(float(node.value)), ast.Constant(0.0)], ast.Load()
        )


def in_pairs(function: Any) -> Any:
    """Compile a scalar function of `rattlesweep.physics.full` for pairs of doubles."""
    tree = ast.parse(textwrap.dedent(inspect.getsource(function.py_func)))
    written = tree.body[0]
    assert isinstance(written, ast.FunctionDef)
    written.decorator_list = []
    names = {"add": add, "sub": sub, "mul": mul, "div": div, "sqrt": root}
    globals_ = function.py_func.__globals__
    for name in function.py_func.__code__.co_names:
        if hasattr(globals_.get(name), "py_func"):
            names[name] = in_pairs(globals_[name])
    with_calls = ast.fix_missing_locations(Pairs().visit(tree))
    exec(compile(with_calls, "<pairs>", "exec"), names)
    return njit(names[written.name])


rhs = in_pairs(full.rhs)
spin = in_pairs(full.spin)


@njit(inline="always")
def pair(y, c):  # type: ignore[no-untyped-def]
    """Component ``c`` of a state, an array of shape (5, 2)."""
    return y[c, 0], y[c, 1]


@njit
def slope(y, q, f):  # type: ignore[no-untyped-def]
    """Derivative ``f`` of the state ``y``; arrays of pairs, shape (5, 2)."""
    d = rhs(
        pair(y, 0),
        pair(y, 1),
        pair(y, 2),
        pair(y, 3),
        pair(y, 4),
        (q[0], 0.0),
        (q[1], 0.0),
        (q[2], 0.0),
        (q[3], 0.0),
        (q[4], 0.0),
        (q[5], 0.0),
    )
    for c in range(5):
        f[c, 0], f[c, 1] = d[c]


@njit
def step(y, h, q, table, work):  # type: ignore[no-untyped-def]
    """State a step ``h`` (a double, taken as exact) after ``y``."""
    before = work[0]
    now = work[1]
    after = work[2]
    f = work[3]
    f0 = work[4]
    slope(y, q, f0)
    for j in range(COLUMNS):
        n = 2 * (j + 1)
        sub_h = div((h, 0.0), (float(n), 0.0))
        twice = (2 * sub_h[0], 2 * sub_h[1])
        before[:] = y
        for c in range(5):
            now[c] = add(pair(y, c), mul(sub_h, pair(f0, c)))
        for _ in range(n - 1):
            slope(now, q, f)
            for c in range(5):
                after[c] = add(pair(before, c), mul(twice, pair(f, c)))
            before[:] = now
            now[:] = after
        # Aitken and Neville in the square of the substep; row j over row j - 1, in
        # place.
        for c in range(5):
            carried = pair(now, c)
            for i in range(j):
                old = pair(table[i], c)
                table[i, c] = carried
                longer = float((j - i) * (j - i))
                shorter = float((j + 1) * (j + 1))
                weight = div((longer, 0.0), (shorter - longer, 0.0))
                carried = add(carried, mul(sub(carried, old), weight))
            table[j, c] = carried
    return table[COLUMNS - 1].copy()


@njit
def spin_of(y):  # type: ignore[no-untyped-def]
    """Spin of a state."""
    return spin(
        pair(y, 0),
        pair(y, 1),
        pair(y, 2),
        pair(y, 3),
        pair(y, 4),
    )[0]


@njit(nogil=True)
def first_zero(y0, q, t_end, h):  # type: ignore[no-untyped-def]
    """First zero of the spin; NaN without one by ``t_end``."""
    table = np.zeros((COLUMNS, 5, 2))
    work = np.zeros((5, 5, 2))
    y = np.zeros((5, 2))
    y[:, 0] = y0
    n_0 = abs(spin_of(y))
    sign = 1.0 if spin_of(y) > 0 else -1.0
    steps = int(np.ceil(t_end / h))
    for k in range(steps):
        new = step(y, h, q, table, work)
        # With more than 0.3 n_0 at both ends, the spin does not reach zero within the
        # step.
        if min(sign * spin_of(y), sign * spin_of(new)) < 0.3 * n_0:
            for i in range(1, POINTS + 1):
                if sign * spin_of(step(y, h * i / POINTS, q, table, work)) <= 0:
                    low = h * (i - 1) / POINTS
                    high = h * i / POINTS
                    for _ in range(60):
                        middle = 0.5 * (low + high)
                        if sign * spin_of(step(y, middle, q, table, work)) > 0:
                            low = middle
                        else:
                            high = middle
                    return k * h + high
        y = new
    return np.nan


def reversal_times(batch: Batch, horizon: Floats, angle: float = 0.8) -> Floats:
    """First zeros of the spin of the runs of a batch (full model), NaN without one.

    Steps are shortened until two lengths agree to 1e-10.

    Parameters
    ----------
    batch : Batch
    horizon : ndarray
        Time limit of each run, in ``sqrt(a/g)``.
    angle : float
        Length of the first steps times the frequency of the spin's swing.
    """
    t_r = np.full(len(batch), np.nan)
    for k in range(len(batch)):
        length = angle / float(batch.swing[k])
        before = np.inf
        for _ in range(4):
            t_r[k] = first_zero(batch.y0[k], batch.constants[k], horizon[k], length)
            if abs(t_r[k] - before) <= 1e-10 * t_r[k]:
                break
            length *= 0.65
            before = t_r[k]
    return t_r
