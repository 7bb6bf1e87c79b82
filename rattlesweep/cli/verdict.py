"""The command that tells whether a stone turns back."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from click import option

from rattlesweep.cli import options
from rattlesweep.cli.given import names_of_options, stone_or_options
from rattlesweep.cli.options import (
    DONE,
    SOME_FAILED,
    command,
    pick,
    print_result,
    probe_files,
    warn,
)
from rattlesweep.words.defaults import (
    VERDICT_PUSH,
    VERDICT_SPINS,
    VERDICT_STONES,
    VERDICT_TIME,
)
from rattlesweep.words.errors import ConfigError
from rattlesweep.words.quantities import LOSSES


@command(
    "One run",
    "rattlesweep verdict configs/fit/stone.yaml --pivot 54um --figure verdict.png",
    "rattlesweep verdict --half-ellipsoid 12cm,3cm,12mm --mass 60g --skew 3deg",
    "rattlesweep verdict --mesh stone.stl --mass 60g --spin 60rpm --spin 90rpm",
    "rattlesweep verdict --preset GH --length 1cm",
)
@options.path("stone", required=False)
@option(
    "--spin",
    type=options.TURNS_A_TIME,
    multiple=True,
    default=VERDICT_SPINS,
    help="Spin of a launch in both directions; may be repeated.",
)
@option(
    "--push",
    type=options.TURNS_A_TIME,
    default=VERDICT_PUSH,
    help="Initial oscillation, which a hand always gives: 6 rpm tilt a stone of 12 cm "
    "by about 1 degree.",
)
@option(
    "--t-end",
    type=options.SECONDS,
    default=VERDICT_TIME,
    help="How long the stone is watched.",
)
@option(
    "--samples",
    type=options.NUMBER,
    default=VERDICT_STONES,
    help="Stones drawn from the errors of what was measured.",
)
@option(
    "--no-advice",
    "advice",
    flag_value=False,
    default=True,
    show_default=False,
    help="Do not look for what would make it turn back.",
)
@options.body_options
@option(
    "--length",
    type=options.HEIGHT,
    help="Height of the centre of mass, for a body without a size.",
)
@options.dissipation
@options.figure
@options.as_json
@options.quiet
def verdict(
    stone: Path | None,
    spin: tuple[str, ...],
    push: str,
    t_end: str,
    samples: int,
    length: float | None,
    advice: bool,
    figure: Path | None,
    as_json: bool,
    quiet: bool,  # which `warn` reads
    **given: Any,
) -> int:
    """Tell whether a stone turns back in both directions, when, and how sure that is.

    STONE is a file as for `fit`, of which body and dissipation count; or options
    describe the body. Each launch runs without friction, and once more with the
    friction of STONE or of the options.  It turns back if the spin on the other side
    exceeds a quarter of the launch.  Where STONE has errors, as in 60 +- 1 g, stones
    drawn from them tell how sure the verdict is. A second table says what would make it
    turn back; each of its rows is a run. docs/verdict.md explains the tables.
    Exits with 3 if a run ends with a status other than ok, as where a stone rolls past
    its rim.
    """
    from rattlesweep.api.verdicts import verdict_on

    probe_files(figure)
    losses = pick(given, *LOSSES)
    known = stone_or_options(stone, given)
    if known.get("base") is not None:
        raise ConfigError(
            f"{stone}: base: a verdict is about a plane at rest; leave base out"
        )
    body = known["body"]
    # Those of the options replace those of STONE.
    losses = pick(known, *LOSSES) | losses
    with names_of_options(("spin", "push", "t_end", "samples", "length", *LOSSES)):
        found = verdict_on(
            body,
            spin,
            push,
            t_end,
            samples=samples,
            length=length,
            advice=advice,
            **losses,
        )
    print_result(as_json, found.to_dict(), str(found))
    if figure is not None:
        found.plot(figure)
    for remark in found.remarks:
        warn(remark)
    if (found.table["status"] != "ok").any():
        return SOME_FAILED
    return DONE
