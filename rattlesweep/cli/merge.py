"""`rattlesweep merge`: one directory from those of shards."""

from __future__ import annotations

from pathlib import Path

import click
from click import argument

from rattlesweep.cli.common import Meter, command, options, print_summary, say
from rattlesweep.cli.common.output import DONE, EARLY, SOME_FAILED


@command("Sweeps", "rattlesweep merge out/steady-0 out/steady-1 --output out/steady", resumes=True)
@argument("directories", metavar="DIR...", type=click.Path(path_type=Path), nargs=-1, required=True)
@options.output("The directory to write.", required=True)
@options.quiet
def merge(directories: tuple[Path, ...], output: Path, quiet: bool) -> int:
    """Merge the directories of one sweep's shards into files of sensible size.

    Checks that they belong to one config and agree where they overlap. Runs that the output has
    already are kept. If some are missing after that, says which, and exits with 75: merge other
    shards into the same output, or let `rattlesweep run CONFIG --output DIR` compute the rest.
    """
    from rattlesweep.sweeps.old.merge import merge as join

    with Meter(quiet) as meter:
        merged = join(list(directories), output, report=meter.counting("files"))
    if merged.summary is not None and not quiet:
        print_summary(merged.summary, merged.directory)
    say(f"{merged.runs} runs in {merged.files} files in {output}")
    if merged.missing:
        spans = ", ".join(f"{first} to {stop - 1}" for first, stop in merged.missing[:5])
        more = f" and {len(merged.missing) - 5} more spans" if len(merged.missing) > 5 else ""
        say(
            f"missing: runs {spans}{more}; merge the other shards too, with the same --output, or "
            f"compute them with `rattlesweep run CONFIG --output {output}`"
        )
        return EARLY
    return SOME_FAILED if merged.failed else DONE
