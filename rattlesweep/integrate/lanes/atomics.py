"""Atomic counter and flag shared by kernel threads, a barrier, a call by address.

Numba has none of these for the CPU.  Every thread takes the next run from one counter, so that long
and short runs even out (``prange`` alone splits the runs before it knows their lengths), and reads
a flag that Python sets to stop.
"""

# mypy: disable-error-code="no-untyped-call"
from __future__ import annotations

from typing import Any

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic


def _element(context, builder, signature, args):  # type: ignore[no-untyped-def]
    array_type = signature.args[0]
    array = context.make_array(array_type)(context, builder, args[0])
    return cgutils.get_item_pointer(
        context, builder, array_type, array, [args[1]], wraparound=False
    )


@intrinsic
def fetch_add(typingctx, array, index, value):  # type: ignore[no-untyped-def]
    """Add ``value`` to ``array[index]`` (int64) and return what was there before."""

    def codegen(context, builder, signature, args):  # type: ignore[no-untyped-def]
        pointer = _element(context, builder, signature, args)
        return builder.atomic_rmw("add", pointer, args[2], "monotonic")

    return types.int64(array, types.intp, types.int64), codegen


@intrinsic
def load(typingctx, array, index):  # type: ignore[no-untyped-def]
    """Read ``array[index]`` (int64) afresh; the compiler may not keep an older value."""

    def codegen(context, builder, signature, args):  # type: ignore[no-untyped-def]
        pointer = _element(context, builder, signature, args)
        # An or with nothing: llvmlite's atomic load has changed its arguments over the versions.
        return builder.atomic_rmw("or", pointer, ir.Constant(ir.IntType(64), 0), "monotonic")

    return types.int64(array, types.intp), codegen


@intrinsic
def barrier(typingctx):  # type: ignore[no-untyped-def]
    """Keep the compiler from joining arithmetic before with arithmetic behind; costs nothing.

    What is behind reads its numbers afresh from arrays, and so shares no product with what is
    before.  A shared product is not fused with a sum, and the last bits change.
    """

    def codegen(context, builder, signature, args):  # type: ignore[no-untyped-def]
        builder.fence("seq_cst", "singlethread")
        return context.get_dummy_value()

    return types.void(), codegen


@intrinsic
def widest_vectors(typingctx):  # type: ignore[no-untyped-def]
    """Let LLVM vectorise the calling function with all that the processor has; costs nothing.

    By itself it uses 256 of the 512 bits that Intel's processors with AVX-512 have, as rare wide
    instructions would slow down the code around them.  The step is nothing but such instructions.
    """

    def codegen(context, builder, signature, args):  # type: ignore[no-untyped-def]
        # llvmlite knows no attribute with a value, but writes what is in the set.
        set.add(builder.function.attributes, '"prefer-vector-width"="512"')
        return context.get_dummy_value()

    return types.void(), codegen


def address_of(compiled: Any) -> int:
    """Where the machine code of a compiled function of one signature is; it must not be dropped."""
    (result,) = compiled.overloads.values()
    address: int = result.library.get_pointer_to_function(result.fndesc.llvm_func_name)
    return address


def _calling(result: Any) -> Any:
    def call(typingctx, address, arguments):  # type: ignore[no-untyped-def]
        def codegen(context, builder, signature, args):  # type: ignore[no-untyped-def]
            given = signature.args[1].types
            function_type = context.call_conv.get_function_type(result, given)
            function = builder.inttoptr(args[0], function_type.as_pointer())
            status, returned = context.call_conv.call_function(
                builder, function, result, given, cgutils.unpack_tuple(builder, args[1])
            )
            with cgutils.if_unlikely(builder, status.is_error):
                context.call_conv.return_status_propagate(builder, status)
            return returned

        return result(types.intp, arguments), codegen

    return intrinsic(call)


# Call the compiled function at an address with a tuple of arguments: what it returns is nothing, or
# two whole numbers.
call = _calling(types.none)
call_for_two = _calling(types.UniTuple(types.intp, 2))
