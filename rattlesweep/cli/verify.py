"""`rattlesweep verify`: whether everything is intact."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path

import click

from rattlesweep.cli.common import DONE, FAILED, Meter, check_threads, guarded, say


@click.command(epilog="\b\nExample:\n  rattlesweep verify out/quickstart --recompute 100")
@click.argument("directory", type=click.Path())
@click.option(
    "--recompute",
    type=click.IntRange(0),
    metavar="N",
    default=0,
    help="Integrate N random runs again and compare them bit for bit.",
)
@click.option(
    "--seed",
    type=click.IntRange(0),
    help="Seed for choosing these runs; by default a new one each time.",
)
@click.option("--threads", type=click.IntRange(1), help="Number of threads of the kernel.")
@click.option("--json", "as_json", is_flag=True, help="Print JSON instead of text.")
@guarded
def verify(
    directory: str, recompute: int, seed: int | None, threads: int | None, as_json: bool
) -> int:
    """Verify an output directory, every bit of it.

    Checks checksums, schema, missing and duplicate runs, unexpected nulls, types and summary.
    Prints one line per problem and exits with 1 if there is any. `rattlesweep run` repairs what
    it finds by computing those blocks again.
    """
    from rattlesweep.errors import printable
    from rattlesweep.sweeps.inspect.verify import verify as check

    check_threads(threads)
    with Meter() as meter:
        verdict = check(
            Path(directory),
            recompute=recompute,
            seed=seed,
            threads=threads,
            report=meter.counting("blocks"),
        )
    if as_json:
        click.echo(json.dumps(asdict(verdict), indent=2))
    else:
        for problem in verdict.problems:
            click.echo(printable(problem))
    for remark in verdict.remarks:
        say(f"note: {remark}")
    again = f", {verdict.recomputed} integrated again" if recompute else ""
    left = f", {verdict.absent} blocks not in place" if verdict.missing else ""
    if verdict.begun:
        left += f", {verdict.begun} runs of them begun"
    wrong = f"{len(verdict.problems)} problems" if verdict.problems else "no problem"
    say(f"{verdict.blocks} complete blocks, {verdict.runs} runs{again}{left}: {wrong}")
    return FAILED if verdict.problems else DONE
