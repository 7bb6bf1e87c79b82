"""What the kernels are compiled for on this machine."""

from __future__ import annotations

import re

from numba import float64, typeof

from rattlesweep.integrate.lanes.build import problem_of
from rattlesweep.integrate.lanes.kernel import advance
from rattlesweep.integrate.model import FULL

# Registers in assembly, the widest first.
REGISTERS = {"%zmm": 512, "%ymm": 256, "%xmm": 128, r"\bv\d+\.2d": 128}


def vector_bits() -> int:
    """Return the width of the vectors in the machine code of a part, which is compiled for it."""
    signature = typeof(problem_of(FULL, True)), float64[::1]
    advance.compile(signature)
    code = advance.inspect_asm()[signature]
    return next((bits for name, bits in REGISTERS.items() if re.search(name, code)), 64)
