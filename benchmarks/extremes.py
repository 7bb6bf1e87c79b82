"""Errors at the ends of the parameter space, for the cases of the test.

    python benchmarks/extremes.py

The cases and the reference, SciPy's DOP853 for the paper's equations, are those of
tests/kernel/test_extremes.py, which checks them at the default tolerance. The table
has the errors of ``t_r``, or of ``n_end`` without a reversal.
"""

from __future__ import annotations

import sys

from machine import ROOT, heading

sys.path[:0] = [str(ROOT / "tests" / "helpers"), str(ROOT / "tests" / "kernel")]

import oracle  # noqa: E402
from test_extremes import SHORT, ask  # noqa: E402

TOLS = (1e-6, 1e-9, 1e-12)


def main() -> None:
    """Print the table."""
    print(heading("scipy"))
    print(
        "| GH but for | n_i | omega_xy0 | horizon | result | "
        + " | ".join(f"error at {tol:g}" for tol in TOLS)
        + " |"
    )
    print("|---" * (5 + len(TOLS)) + "|")
    for change, n_i, omega_xy0, t_end in SHORT:
        body = oracle.GH | change
        runs = [ask(change, n_i, omega_xy0, t_end, tol=tol) for tol in TOLS]
        launch = oracle.launch(body, n_i, omega_xy0, runs[-1].psi)
        t_r, state = oracle.first_zero(body, launch, t_end, samples=16)
        if t_r is None:
            true = oracle.spin(state)
            values = [run.n_end for run in runs]
        else:
            true = t_r
            values = [run.t_r for run in runs]
        errors = " | ".join(f"{abs(value / true - 1):.0e}" for value in values)
        words = ", ".join(f"{name} {value:g}" for name, value in change.items())
        print(
            f"| {words} | {n_i:g} | {omega_xy0:g} | {t_end:g} | {runs[-1].type} "
            f"| {errors} |"
        )


if __name__ == "__main__":
    main()
