"""`rattlesweep merge`: one directory from those of shards."""

from __future__ import annotations

from pathlib import Path

import click
from click import argument

from rattlesweep.cli.common import command, options, print_summary, say
from rattlesweep.cli.common.output import DONE, EARLY, SOME_FAILED


@command("Sweeps", "rattlesweep merge out/steady-0 out/steady-1 --output out/steady", resumes=True)
@argument("directories", metavar="DIR...", type=click.Path(path_type=Path), nargs=-1, required=True)
@options.output("The directory to write.", required=True)
@options.quiet
def merge(directories: tuple[Path, ...], output: Path, quiet: bool) -> int:
    """Merge the directories of one sweep's shares.

    Checks that they hold the same sweep and that no run stands in two of them. If some runs are missing after that, exits with
    75: merge other shares into the same output, or let `rattlesweep run CONFIG --output DIR` compute the rest.
    """
    from rattlesweep.sweeps.merge import merge as join

    merged = join(list(directories), output)
    if merged.summary is not None and not quiet:
        print_summary(merged.summary, output)
    say(f"{merged.runs} runs in {merged.files} files in {output}")
    if merged.missing:
        say(
            f"{merged.missing} runs are missing; merge the other shares too, with the same --output, or "
            f"compute them with `rattlesweep run CONFIG --output {output}`"
        )
        return EARLY
    return SOME_FAILED if merged.failed else DONE
