"""`rattlesweep body`: what theory says of one body."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

import click

from rattlesweep.cli.common import command, options, to_json
from rattlesweep.text import align


@command(
    "One run",
    "rattlesweep body --preset GH",
    "rattlesweep body --mass 85g --height 1cm --inertia '60,900,920,-20 g cm^2' "
    "--radii '50,1.5 cm' --n-i 60rpm",
    "rattlesweep body --gamma 10 --f-sd 0.1 --theta 0.8 --phi 0.05 --xi-deg -3 --json",
)
@options.body
@options.spin
@options.dissipation
@options.as_json
def body(body: dict[str, Any], spin: dict[str, Any], dissipation: dict[str, Any],
         as_json: bool) -> None:  # fmt: skip
    """Print derived quantities of one body: modes, torque coefficients, thresholds, reversal times.

    The spin and the oscillation, in sqrt(g/a), matter for the reversal times only. Of a body given
    in SI units all is printed in both, with g = 9.81 m/s^2.
    """
    from rattlesweep.analysis.derived import derived, in_units_of, make_body

    made = make_body(body)
    values = derived(made, **in_units_of(made.units, spin | dissipation))
    if as_json:
        si = {q.name: dict(zip(("value", "unit"), q.in_si, strict=True)) for q in values if q.in_si}
        units = {} if made.units is None else {"units": asdict(made.units), "si": si}
        click.echo(to_json({q.name: q.value for q in values} | units))
        return
    lines = []
    for q in values:
        number = "none" if q.value is None else f"{q.value:.10g}"
        shown = ("", "") if q.in_si is None else (f"{q.in_si[0]:.5g}", q.in_si[1])
        sized = () if made.units is None else shown
        lines.append((q.name, number, q.unit, *sized, q.description))
    click.echo(align(lines, "<><" if made.units is None else "<><><"))
