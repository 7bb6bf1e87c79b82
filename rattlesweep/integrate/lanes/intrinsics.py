"""Operations that Numba does not have for the CPU, as intrinsics.

Private interfaces of Numba are used here and in :mod:`rattlesweep.integrate.lanes.lane` alone:
``numba.core.cgutils``, the context's ``make_array``, ``make_tuple`` and ``call_conv``,
``to_fixed_tuple`` of ``numba.np.unsafe``, ``library`` and ``fndesc`` of a compiled overload.
Tried with Numba 0.68.1.
"""

# mypy: disable-error-code="no-untyped-call, no-untyped-def"
from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from typing import Any

import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic
from numba.np.unsafe.ndarray import to_fixed_tuple

# Options of functions that only other compiled functions call.  What Python and C would call is not
# made, and takes no time to compile; a call from Python ends the process.
INNER: dict[str, Any] = {"nogil": True, "error_model": "numpy"}
INNER |= {"no_cpython_wrapper": True, "no_cfunc_wrapper": True}
ONE = 1023 << 52  # the bits of 1.0


def emitting(signature_of: Callable[..., Any]) -> Callable[..., Any]:
    """Decorate a function that writes LLVM code as an intrinsic, typed by its arguments' types."""

    def decorate(codegen: Callable[..., Any]) -> Any:
        @wraps(signature_of)
        def typed(*given):
            return signature_of(*given), codegen

        typed.__name__ = codegen.__name__
        return intrinsic(typed)

    return decorate


def _element(context, builder, signature, args):
    array_type = signature.args[0]
    array = context.make_array(array_type)(context, builder, args[0])
    index = [args[1]]
    return cgutils.get_item_pointer(context, builder, array_type, array, index, wraparound=False)


@emitting(lambda typingctx, array, index, value: types.int64(array, types.intp, types.int64))
def fetch_add(context, builder, signature, args):
    """Add ``value`` to ``array[index]`` (int64) and return what was there before.

    All threads take the next run from one counter, so that long and short runs even out: ``prange``
    alone splits the runs before it knows their lengths.
    """
    pointer = _element(context, builder, signature, args)
    return builder.atomic_rmw("add", pointer, args[2], "monotonic")


@emitting(lambda typingctx, array, index: types.int64(array, types.intp))
def load(context, builder, signature, args):
    """Read ``array[index]`` (int64) afresh; the compiler may not keep an older value."""
    pointer = _element(context, builder, signature, args)
    # An or with nothing: llvmlite's atomic load has changed its arguments over the versions.
    return builder.atomic_rmw("or", pointer, ir.Constant(ir.IntType(64), 0), "monotonic")


@emitting(lambda typingctx: types.void())
def barrier(context, builder, signature, args):
    """Keep the compiler from joining arithmetic before with arithmetic behind; costs nothing.

    What is behind reads its numbers afresh from arrays, and so shares no product with what is
    before.  A shared product is not fused with a sum, and the last bits change.
    """
    builder.fence("seq_cst", "singlethread")
    return context.get_dummy_value()


@emitting(lambda typingctx: types.void())
def widest_vectors(context, builder, signature, args):
    """Let LLVM vectorise the calling function with all that the processor has; costs nothing.

    By itself it uses 256 of the 512 bits of AVX-512 on Intel, as rare wide instructions slow down
    the code around them.  The step is nothing but such instructions.
    """
    # llvmlite knows no attribute with a value, but writes what is in the set.
    set.add(builder.function.attributes, '"prefer-vector-width"="512"')
    return context.get_dummy_value()


@emitting(lambda typingctx, x: types.float64(types.float64))
def rough_root(context, builder, signature, args):
    """Return about ``x^(1/64)`` of a positive number, by dividing the bits of its logarithm.

    Up to 6 % off, always by the same bits, rises with ``x``, and costs two instructions on integers
    where six square roots would be a twentieth of the time of a step.
    """
    whole = ir.IntType(64)
    bits = builder.lshr(builder.bitcast(args[0], whole), whole(6))
    return builder.bitcast(builder.add(bits, whole(ONE - (ONE >> 6))), ir.DoubleType())


def _on_each(operation: str) -> Any:
    @emitting(lambda typingctx, values, x: values(values, types.float64))
    def apply(context, builder, signature, args):
        one_by_one = (builder.extract_value(args[0], i) for i in range(len(signature.args[0])))
        found = [getattr(builder, operation)(value, args[1]) for value in one_by_one]
        return context.make_tuple(builder, signature.return_type, found)

    return apply


# Products and quotients of each of a tuple and the same number.
times, over = _on_each("fmul"), _on_each("fdiv")


# ``first_of(array, length)``: the first numbers of an array as a tuple.
first_of = to_fixed_tuple


# -- calls by address ------------------------------------------------------------------------------


def address_of(compiled: Any) -> Any:
    """Return where the machine code of a compiled function of one signature is.

    The function must not be dropped as long as the address is used.
    """
    (result,) = compiled.overloads.values()
    return result.library.get_pointer_to_function(result.fndesc.llvm_func_name)


def addresses_of(*compiled: Any) -> Any:
    """Return the addresses of functions as an array."""
    return np.array([address_of(each) for each in compiled])


def _calling(result: Any) -> Any:
    @emitting(lambda typingctx, address, arguments: result(types.intp, arguments))
    def call(context, builder, signature, args):
        given = signature.args[1].types
        function_type = context.call_conv.get_function_type(result, given)
        function = builder.inttoptr(args[0], function_type.as_pointer())
        status, returned = context.call_conv.call_function(
            builder, function, result, given, cgutils.unpack_tuple(builder, args[1])
        )
        with cgutils.if_unlikely(builder, status.is_error):
            context.call_conv.return_status_propagate(builder, status)
        return returned

    return call


# Call the compiled function at an address with a tuple of arguments; the second returns two whole
# numbers.
call, call_for_two = _calling(types.none), _calling(types.UniTuple(types.intp, 2))
