"""`rattlesweep body`: what theory says of one body."""

from __future__ import annotations

import json
from typing import Any

import click

from rattlesweep.cli.common import DONE, guarded


@click.command(
    epilog="\b\nExamples:\n  rattlesweep body --preset GH\n  rattlesweep body --gamma 10 --f-sd "
    "0.1 --theta 0.8 --phi 0.05 --xi-deg -3 --json"
)
@click.option("--preset", metavar="NAME", help="A named body: GH (Garcia and Hubbard 1988).")
@click.option("--alpha", type=float, help="I_xx + 1, in M a^2.")
@click.option("--beta", type=float, help="I_yy + 1, in M a^2.")
@click.option("--gamma", type=float, help="I_zz, in M a^2.")
@click.option(
    "--f-sd", type=float, help="I_yy/I_zz of a shell-dumbbell body; replaces alpha, beta."
)
@click.option("--theta", type=float, help="Larger principal curvature, in 1/a.")
@click.option("--phi", type=float, help="Smaller principal curvature, in 1/a.")
@click.option("--xi", type=float, help="Skew angle in radians.")
@click.option("--xi-deg", type=float, help="Skew angle in degrees.")
@click.option("--n-i", type=float, default=0.1, show_default=True, help="Initial spin.")
@click.option("--omega-xy0", type=float, default=0.01, show_default=True, help="Oscillation.")
@click.option("--json", "as_json", is_flag=True, help="Print JSON instead of a table.")
@guarded
def body(as_json: bool, n_i: float, omega_xy0: float, **given: Any) -> int:
    """Derived quantities of one body: modes, torque coefficients, thresholds, reversal times.

    Spin and oscillation, in sqrt(g/a), are needed for the reversal times only.
    """
    from rattlesweep.sweep.derived import derived, make_body

    values = derived(make_body(given), n_i, omega_xy0)
    if as_json:
        click.echo(json.dumps({q.name: q.value for q in values}, indent=2, allow_nan=False))
        return DONE
    width = max(len(q.name) for q in values)
    for q in values:
        shown = "none" if q.value is None else f"{q.value:.10g}"
        click.echo(f"{q.name:<{width}}  {shown:>15}  {q.unit:<9}  {q.description}".rstrip())
    return DONE
