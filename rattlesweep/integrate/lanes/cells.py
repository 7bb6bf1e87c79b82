"""Cells of a lane in the flat workspace, read, summed and written many at a time.

What these make of one call would be hundreds of indexed reads, products and sums in Python, and
typing and lowering them one by one was most of the time that a kernel takes to compile.  They
write the same LLVM instructions in the same order; the flags for fast mathematics are those of the
function that calls them.
"""

# mypy: disable-error-code="no-untyped-call"
from __future__ import annotations

from dataclasses import dataclass
from functools import reduce
from typing import TYPE_CHECKING, Any

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

DOUBLE = ir.DoubleType()
# Options of functions that only other compiled functions call.  What Python and C would call is not
# made, and takes no time to compile; a call from Python ends the process.
INNER: dict[str, Any] = {
    "nogil": True,
    "error_model": "numpy",
    "no_cpython_wrapper": True,
    "no_cfunc_wrapper": True,
}


@dataclass(frozen=True)
class Sum:
    """A cell and a multiple of a sum: ``w[row] + share * w[factor] * (a * w[i] + b * w[j] + ...)``.

    Attributes
    ----------
    row : int, optional
        Row of the cell; without one the value is the sum alone.
    terms : tuple
        Of each product the number and the row.
    factor : int, optional
        Row of the factor; without one it is 1.
    share : float
        What the factor is multiplied by.
    """

    row: int | None
    terms: tuple[tuple[float, int], ...] = ()
    factor: int | None = None
    share: float = 1.0


def cells(first: int, count: int) -> list[Sum]:
    """Rows one after another, as they are."""
    return [Sum(first + c) for c in range(count)]


class Cells:
    """Reads and writes the cells of one lane, of so many in a row, from what is known to LLVM."""

    def __init__(self, builder: Any, data: Any, lane: Any, lanes: int) -> None:
        self.builder, self.data, self.lane, self.lanes = builder, data, lane, lanes

    @classmethod
    def of(cls, context: Any, builder: Any, array_type: Any, args: Any, lanes: int) -> Cells:
        """Cells of a lane, the second of some arguments, in an array, the first of them."""
        array = context.make_array(array_type)(context, builder, args[0])
        return cls(builder, array.data, args[1], lanes)

    def place(self, row: int) -> Any:
        """Pointer to the cell in a row."""
        index = self.builder.add(self.lane.type(row * self.lanes), self.lane)
        return cgutils.gep(self.builder, self.data, index)

    def read(self, row: int) -> Any:
        """What the cell holds."""
        return self.builder.load(self.place(row))

    def write(self, row: int, value: Any) -> None:
        """Put a value there."""
        self.builder.store(value, self.place(row))

    def product(self, number: float, row: int) -> Any:
        """A number times what the cell holds."""
        value = self.read(row)
        return value if number == 1.0 else self.builder.fmul(DOUBLE(number), value)

    def value(self, wanted: Sum) -> Any:
        """What a sum comes to."""
        if not wanted.terms:
            return self.read(wanted.row)  # type: ignore[arg-type]
        products = [self.product(*term) for term in wanted.terms]
        # Two chains: half as long to wait for.
        chains = [products[i::2] for i in range(min(2, len(products)))]
        total = reduce(self.builder.fadd, (reduce(self.builder.fadd, chain) for chain in chains))
        if wanted.factor is not None:
            total = self.builder.fmul(self.product(wanted.share, wanted.factor), total)
        return total if wanted.row is None else self.builder.fadd(self.read(wanted.row), total)


def gather(values: Sequence[Sum], lanes: int, behind: Sequence[Sum] = ()) -> Callable[..., Any]:
    """``gather(w, l)``: the values in lane ``l``, and those ``behind`` them, a tuple.

    What comes behind is read first, and single cells before sums.  Which of two products LLVM fuses
    with their sum depends on such an order, and with it the last bits.
    """
    wanted = [*values, *behind]
    order = sorted(range(len(wanted)), key=lambda i: (i < len(values), bool(wanted[i].terms)))

    def read(typingctx, w, l):  # type: ignore[no-untyped-def]
        def codegen(context, builder, signature, args):  # type: ignore[no-untyped-def]
            lane = Cells.of(context, builder, signature.args[0], args, lanes)
            found = {i: lane.value(wanted[i]) for i in order}
            parts = [found[i] for i in range(len(wanted))]
            return context.make_tuple(builder, signature.return_type, parts)

        return types.UniTuple(types.float64, len(wanted))(w, types.intp), codegen

    compiled: Callable[..., Any] = intrinsic(read)
    return compiled


def scatter(rows: Sequence[int], lanes: int) -> Callable[..., Any]:
    """``scatter(w, l, values)``: write a tuple to the rows in lane ``l``."""

    def write(typingctx, w, l, values):  # type: ignore[no-untyped-def]
        def codegen(context, builder, signature, args):  # type: ignore[no-untyped-def]
            lane = Cells.of(context, builder, signature.args[0], args, lanes)
            for i, row in enumerate(rows):
                lane.write(row, builder.extract_value(args[2], i))
            return context.get_dummy_value()

        return types.void(w, types.intp, types.UniTuple(types.float64, len(rows))), codegen

    compiled: Callable[..., Any] = intrinsic(write)
    return compiled


def each(operation: str) -> Callable[..., Any]:
    """``each("fmul")(values, x)``: LLVM's operation on each of a tuple and the same number."""

    def apply(typingctx, values, x):  # type: ignore[no-untyped-def]
        def codegen(context, builder, signature, args):  # type: ignore[no-untyped-def]
            one_by_one = (builder.extract_value(args[0], i) for i in range(len(values)))
            found = [getattr(builder, operation)(value, args[1]) for value in one_by_one]
            return context.make_tuple(builder, signature.return_type, found)

        return values(values, types.float64), codegen

    compiled: Callable[..., Any] = intrinsic(apply)
    return compiled
