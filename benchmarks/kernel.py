"""Speed of the lane kernel: tried steps, and their share of the processor's peak.

    python benchmarks/kernel.py [--quick]

The runs are the mix of ``peer_work.py``. Products and fused multiply-adds, which use
the same units, are counted in the machine code of the step for one lane. The peak is
measured with a loop of fused multiply-adds.
"""

from __future__ import annotations

import re
import time
from functools import partial
from typing import Any

import click
import numba
import numpy as np
import peer_work
from machine import heading, in_turns
from numba import float64, int64, njit, typeof

from rattlesweep.compiling.intrinsics import widest_vectors
from rattlesweep.kernel.batch import integrate
from rattlesweep.kernel.method.tableau import METHODS, Tableau
from rattlesweep.kernel.recipes import problem_of
from rattlesweep.kernel.step.explicit import OPTIONS, write_attempt
from rattlesweep.motion.model import FULL
from rattlesweep.physics import full

# Products in machine code, fused or not, and their vector width.
PRODUCT = re.compile(r"^\s+v?(?:mul|fn?m(?:add|sub)\d*)([sp])d\s.*%([xyz])mm", re.M)
DOUBLES = {"x": 2, "y": 4, "z": 8}
# Short chains, because in a long one the units wait for the sum.
CHAIN = 8
CELLS = 64
SETTINGS = (
    ("dop853", 1e-6),
    ("dop853", 1e-9),
    ("dop853", 1e-12),
    ("verner98", 1e-9),
    ("dopri5", 1e-9),
)


def products(tableau: Tableau) -> int:
    """Return the products of one step for one lane; 0 if the code is not x86's."""
    step = njit(**OPTIONS)(write_attempt(tableau, problem_of(FULL, 1)))
    step.compile((typeof(problem_of(FULL, 1)), float64[::1], float64, int64))
    (code,) = step.inspect_asm().values()
    count = 0
    for packed, register in PRODUCT.findall(code):
        count += DOUBLES[register] if packed == "p" else 1
    return count


def multiply_adds() -> Any:
    """Return a loop of fused multiply-adds over whole vectors."""
    chain = "\n".join(["            s = s * x + y"] * CHAIN)
    source = f"""
def many(w, calls, x, y):
    widest_vectors()
    for _ in range(calls):
        for l in range({CELLS}):
            s = w[l]
{chain}
            w[l] = s
"""
    names: dict[str, Any] = {"widest_vectors": widest_vectors}
    exec(source, names)
    return njit(fastmath=full.FASTMATH, nogil=True)(names["many"])


def peak(rounds: int) -> float:
    """Return the fused multiply-adds a second that one thread can do."""
    calls = 1_000_000
    loop = partial(multiply_adds(), np.ones(CELLS), calls, 0.5, 0.5)
    seconds = in_turns({"loop": loop}, rounds)["loop"]
    return CHAIN * CELLS * calls / seconds


@click.command()
@click.option("--quick", is_flag=True, help="Fewer runs and repeats.")
def main(quick: bool) -> None:
    """Print the table of README.md."""
    rounds = 3 if quick else 7
    runs = peer_work.draw(2 if quick else 60)
    top = peak(rounds)
    click.echo(f"{heading()}\n{len(runs)} runs, medians of {rounds}; one thread can do")
    click.echo(f"{top / 1e9:.1f}e9 fused multiply-adds a second\n")
    click.echo(
        "| method, `tol` | tried, million/s | rejected | products a step "
        "| of the FMA peak | 2 threads over 1 |\n|---|---|---|---|---|---|"
    )
    for method, tol in SETTINGS:
        tableau = METHODS[method]
        run = partial(integrate, runs, tableau, FULL, tol=tol)
        seconds = in_turns({"run": partial(run, threads=1)}, rounds)["run"]
        gain = ""
        if numba.config.NUMBA_NUM_THREADS > 1:
            threads = {"1": partial(run, threads=1), "2": partial(run, threads=2)}
            wall = in_turns(threads, rounds, time.perf_counter)
            gain = f"{wall['1'] / wall['2']:.2f}"
        outcome = run(threads=1)
        rejected = outcome.n_rejected.sum()
        tried = outcome.n_steps.sum() + rejected
        count = products(tableau)
        click.echo(
            f"| `{method}`, {tol:.0e} | {tried / seconds / 1e6:.1f} "
            f"| {rejected / tried:.1%} | {count} "
            f"| {count * tried / seconds / top:.0%} | {gain} |"
        )


if __name__ == "__main__":
    main()
