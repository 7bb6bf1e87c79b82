"""`rattlesweep verify`: whether everything is intact."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path

import click
from click import option

from rattlesweep.cli.common import Meter, command, options, say, to_json
from rattlesweep.cli.common.output import DONE, FAILED
from rattlesweep.errors import printable


@command("Sweeps", "rattlesweep verify out/quickstart --recompute 100")
@options.directory
@option("--recompute", type=click.IntRange(0), metavar="N", default=0,
        help="Integrate N random runs again and compare them bit for bit.")  # fmt: skip
@option("--seed", type=click.IntRange(0),
        help="Seed for choosing these runs; by default a new one each time.")  # fmt: skip
@options.threads
@options.as_json
def verify(
    directory: Path, recompute: int, seed: int | None, threads: int | None, as_json: bool
) -> int:
    """Verify an output directory, every bit of it.

    Checks checksums, schema, missing and duplicate runs, unexpected nulls, types and summary.
    Prints one line per problem and exits with 1 if there is any. `rattlesweep run` repairs what
    it finds by computing those blocks again.
    """
    from rattlesweep.sweeps.old.verify import verify as check

    with Meter() as meter:
        report = meter.counting("blocks")
        verdict = check(directory, recompute=recompute, seed=seed, threads=threads, report=report)
    if as_json:
        click.echo(to_json(asdict(verdict)))
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
