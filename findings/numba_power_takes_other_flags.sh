#!/usr/bin/env bash
# Numba 0.68.1: `x**2` in a function with fastmath={"contract"}, compiled as the first
# function of a process, and after another function that has `x**2` without fastmath.
#
# Expected: the bits of a function follow from its source, its options and the types of
# its arguments. That functions it calls take flags over from the first caller is known
# (issue 7168). A power by a constant integer is an operation, not a call.
# Seen (2026-11-30): it is compiled as an inner function that Numba keeps for the whole
# process, with the flags of the function that needed it first. After the exact function,
# the product of the fast one is not fused with its sum. So x**2 - y, with y = x*x rounded,
# is 0 instead of the rounding error of y. x*x - y is the same in both orders.
#
# For a sweep: reversal times of runs with two kinds of friction differed in their last
# bits (4e-13) by which kernel a process had compiled first.
# It fails if that changes. It needs Python 3.11 or later, a processor that fuses products
# with sums (FMA), and writes to a folder that it removes.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet numba==0.68.1 numpy==2.4.6
cat > "$folder/order.py" <<'PYTHON'
import sys

import numba
from numba import njit

FAST = {"contract"}


@njit
def exact(x, y):
    return x**2 - y


@njit(fastmath=FAST)
def fast(x, y):
    return x**2 - y


@njit(fastmath=FAST)
def product(x, y):
    return x * x - y


x = 1.1
y = x * x  # rounded
if sys.argv[1] == "after the exact one":
    exact(x, y)
print(f"numba {numba.__version__} | {sys.argv[1]} | {fast(x, y)!r} | {product(x, y)!r}")
assert product(x, y) != 0.0, "this processor, or this build, does not fuse products"
assert (fast(x, y) == 0.0) == (sys.argv[1] == "after the exact one")
assert fast(x, y) in (0.0, product(x, y))
PYTHON
echo "versions | the fast function is compiled | x**2 - y | x*x - y"
for order in "first" "after the exact one"; do
  NUMBA_CACHE_DIR="$folder" "$folder/venv/bin/python" "$folder/order.py" "$order"
done
