"""Operations that kernels have and Numba lacks, written as LLVM code.

Each has a Python twin, which runs with ``NUMBA_DISABLE_JIT=1``, so that a debugger can
step through a kernel.

Private interfaces of Numba that are used here (tried with 0.68.1): ``cgutils``,
``to_fixed_tuple``; the option ``_nrt``; ``make_array``, ``make_tuple``,
``get_dummy_value`` and ``call_conv`` of contexts; ``library`` and ``fndesc`` of
overloads.
"""

# mypy: disable-error-code="no-untyped-call, no-untyped-def, misc"

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import wraps
from typing import TYPE_CHECKING, ParamSpec, TypeVar

import numpy as np
from llvmlite import ir
from numba import config, extending, njit, types
from numba.core import cgutils
from numba.np.unsafe.ndarray import to_fixed_tuple

if TYPE_CHECKING:
    from numba.core.dispatcher import Dispatcher
    from numba.core.typing.templates import Signature
    from numpy.typing import NDArray

P = ParamSpec("P")
R = TypeVar("R")
DOUBLE = ir.DoubleType()
# Products may be fused with sums, and a zero has no sign.  With 'nnan' and 'ninf' LLVM
# would remove tests for non-finite states; with 'reassoc' and 'arcp' last bits would
# depend on how often a function is optimised.
FASTMATH = {"contract", "nsz"}
# A function without these takes them over from its caller, and from the first one if
# there are several (Numba 0.68, issue 7168).  Then its last bits would depend on what
# was compiled before in the same process.
UNFUSED: dict[str, object] = {"fastmath": False, "forceinline": False}
# Options of functions that only compiled functions call.  Wrappers for Python and C,
# which would take time to compile, are left out; a call from Python would crash the
# process.
INNER: dict[str, object] = UNFUSED | {"nogil": True, "error_model": "numpy"}
INNER |= {"no_cpython_wrapper": True, "no_cfunc_wrapper": True}
# They own no arrays.  Otherwise Numba counts references to each array at each call,
# which took 3 to 5 % of the time of a kernel.
INNER |= {"_nrt": False}
FUSED: dict[str, object] = INNER | {"fastmath": FASTMATH}
INLINED: dict[str, object] = INNER | {"forceinline": True}
FUSED_INLINED: dict[str, object] = FUSED | {"forceinline": True}


def _first_of(array, length):
    return tuple(array[:length])


# first_of(array, length): the first numbers of an array, as a tuple.
first_of = _first_of if config.DISABLE_JIT else to_fixed_tuple


def intrinsic(
    signature_of: Callable[..., Signature], python: Callable[P, R]
) -> Callable[[Callable[..., ir.Value]], Callable[P, R]]:
    """Make an intrinsic of a function that writes LLVM code, and its Python twin.

    ``signature_of`` returns the signature for the types of the arguments.
    """

    def decorate(codegen: Callable[..., ir.Value]) -> Callable[P, R]:
        @wraps(signature_of)
        def typed(*arguments):
            return signature_of(*arguments), codegen

        typed.__name__ = codegen.__name__
        return python if config.DISABLE_JIT else extending.intrinsic(typed)

    return decorate


def _fetch_add(array, index, value):
    before = int(array[index])
    array[index] += value
    return before


@intrinsic(
    lambda typingctx, array, index, value: types.int64(array, types.intp, types.int64),
    _fetch_add,
)
def fetch_add(context, builder, signature, args):
    """Add to an element (int64) atomically, and return the value before."""
    kind = signature.args[0]
    array = context.make_array(kind)(context, builder, args[0])
    pointer = cgutils.get_item_pointer(
        context, builder, kind, array, [args[1]], wraparound=False
    )
    return builder.atomic_rmw("add", pointer, args[2], "monotonic")


def _copy_numbers(array, place, source, count):
    array[place : place + count] = array[source : source + count]


@intrinsic(
    lambda typingctx, array, place, source, count: types.void(
        array, types.intp, types.intp, types.intp
    ),
    _copy_numbers,
)
def copy_numbers(context, builder, signature, args):
    """Copy numbers of a flat array to another place in it; the two do not overlap.

    A loop of indices, which may be negative in Numba, would not vectorise.
    """
    array, place, source, count = args
    data = context.make_array(signature.args[0])(context, builder, array).data
    target = cgutils.gep(builder, data, place)
    cgutils.raw_memcpy(builder, target, cgutils.gep(builder, data, source), count, 8)
    return context.get_dummy_value()


@intrinsic(lambda typingctx: types.void(), lambda: None)
def barrier(context, builder, signature, args):
    """Keep the compiler from sharing products across this point, at no cost.

    A shared product is not fused with a sum, which would change the last bits.
    """
    builder.fence("seq_cst", "singlethread")
    return context.get_dummy_value()


@intrinsic(lambda typingctx: types.void(), lambda: None)
def widest_vectors(context, builder, signature, args):
    """Let LLVM use the widest vectors of the processor in the calling function.

    By default it uses 256 of the 512 bits of AVX-512 on Intel processors, and aligns
    the stack to 16 bytes: in three processes of four, every vector that is kept there
    would cross a cache line.
    """
    # llvmlite has no attributes with a value, but prints whatever the set contains.
    set.add(builder.function.attributes, '"prefer-vector-width"="512"')
    builder.function.attributes.alignstack = 64
    return context.get_dummy_value()


@intrinsic(lambda typingctx: types.void(), lambda: None)
def apart(context, builder, signature, args):
    """Keep the calling function out of its callers, with which it might share products.

    Then its last bits do not depend on how large they are.
    """
    builder.function.attributes.add("noinline")
    return context.get_dummy_value()


@intrinsic(
    lambda typingctx, bits: types.int64(types.int64),
    lambda bits: (bits & -bits).bit_length() - 1,
)
def lowest_bit(context, builder, signature, args):
    """Return the place of the lowest bit of an integer that is not zero."""
    return builder.cttz(args[0], ir.Constant(ir.IntType(1), 1))


# For a root of 1, where 1023 << 52 is 1.0.
ROOT_OF_ONE = np.uint64((1023 << 52) - (1023 << 46))


@njit(**INNER)
def rough_root(x):
    """Return roughly ``x^(1/64)`` of a positive number, from its bits as a logarithm.

    The result is 0 to 6.2 % too large, as ``1 + m`` replaces ``2^m``, and rises with
    ``x``.
    """
    bits = np.float64(x).view(np.uint64) >> np.uint64(6)
    return np.uint64(bits + ROOT_OF_ONE).view(np.float64)


@intrinsic(
    lambda typingctx, y, f, h: y(y, f, types.float64),
    lambda y, f, h: tuple(a + h * b for a, b in zip(y, f, strict=True)),
)
def moved(context, builder, signature, args):
    """Return the state ``y + h f``."""
    y, f, h = args
    components = []
    for i in range(len(signature.return_type)):
        change = builder.fmul(h, builder.extract_value(f, i))
        components.append(builder.fadd(builder.extract_value(y, i), change))
    return context.make_tuple(builder, signature.return_type, components)


@intrinsic(
    lambda typingctx, condition, yes, no: yes(types.boolean, yes, yes),
    lambda condition, yes, no: yes if condition else no,
)
def chosen(context, builder, signature, args):
    """Return one of two tuples, without a branch."""
    condition, yes, no = args
    components = []
    for i in range(len(signature.return_type)):
        pair = (builder.extract_value(each, i) for each in (yes, no))
        components.append(builder.select(condition, *pair))
    return context.make_tuple(builder, signature.return_type, components)


def addresses_of(
    *compiled: Dispatcher | None,
) -> NDArray[np.int64] | NDArray[np.object_]:
    """Return the addresses of compiled functions, which the caller must keep alive.

    The address of None, for a function that is never called, is 0.
    """
    if config.DISABLE_JIT:
        return np.array(compiled, object)
    addresses = np.zeros(len(compiled), np.int64)
    for place, function in enumerate(compiled):
        if function is not None:
            (result,) = function.overloads.values()
            name = result.fndesc.llvm_func_name
            addresses[place] = result.library.get_pointer_to_function(name)
    return addresses


def _calling(result: types.Type) -> Callable[[int, tuple[object, ...]], object]:
    @intrinsic(
        lambda typingctx, address, arguments: result(types.intp, arguments),
        lambda function, arguments: function(*arguments),
    )
    def call(context, builder, signature, args):
        kinds = signature.args[1].types
        function_type = context.call_conv.get_function_type(result, kinds)
        function = builder.inttoptr(args[0], function_type.as_pointer())
        status, returned = context.call_conv.call_function(
            builder, function, result, kinds, cgutils.unpack_tuple(builder, args[1])
        )
        with cgutils.if_unlikely(builder, status.is_error):
            context.call_conv.return_status_propagate(builder, status)
        return returned

    return call


# Call the compiled function at an address with a tuple of arguments; the second returns
# a pair of integers.
call = _calling(types.none)
call_for_pair = _calling(types.UniTuple(types.intp, 2))


def choice(
    functions: Mapping[float, Callable[..., R]], *, inline: bool = False
) -> Callable[..., R]:
    """Return ``one_of(key, *arguments)``, which calls the function of a key.

    For any other key, it calls the last one.  ``inline`` is for small functions.
    """
    compiled = njit(**INLINED if inline else INNER)
    (first, own), *others = functions.items()
    if not others:

        @compiled
        def last(key, *arguments):
            return own(*arguments)

        return last  # type: ignore[no-any-return]
    rest = choice(dict(others), inline=inline)

    @compiled
    def one_of(key, *arguments):
        if key == first:
            return own(*arguments)
        return rest(key, *arguments)

    return one_of  # type: ignore[no-any-return]
