"""`rattlesweep body`: what theory says of one body."""

from __future__ import annotations

from typing import Any

import click

from rattlesweep.cli.common import command, options, to_json
from rattlesweep.text import align


@command(
    "One run",
    "rattlesweep body --preset GH",
    "rattlesweep body --gamma 10 --f-sd 0.1 --theta 0.8 --phi 0.05 --xi-deg -3 --json",
)
@options.body
@options.spin
@options.as_json
def body(body: dict[str, Any], spin: dict[str, Any], as_json: bool) -> None:
    """Print derived quantities of one body: modes, torque coefficients, thresholds, reversal times.

    The spin and the oscillation, in sqrt(g/a), matter for the reversal times only.
    """
    from rattlesweep.study.derived import derived, make_body

    values = derived(make_body(body), **spin)
    if as_json:
        click.echo(to_json({q.name: q.value for q in values}))
        return
    numbers = ["none" if q.value is None else f"{q.value:.10g}" for q in values]
    lines = [(q.name, n, q.unit, q.description) for q, n in zip(values, numbers, strict=True)]
    click.echo(align(lines, "<><"))
