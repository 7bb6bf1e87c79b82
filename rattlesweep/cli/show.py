"""`rattlesweep show`: one run as a page that moves."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
from click import option

from rattlesweep.cli.common import Meter, command, options, probe, say
from rattlesweep.cli.common.series import say_outcome
from rattlesweep.errors import ConfigError

if TYPE_CHECKING:
    from rattlesweep.analysis.onerun.replay import StoredRun


@command(
    "Pictures and pages",
    "rattlesweep show --preset GH --n-i -0.1 --output spin.html",
    "rattlesweep show --from out/quickstart --where \"type = 'SW'\" --output wobble.html",
)
@option("--from", "directory", metavar="DIR", type=click.Path(path_type=Path),
        help="Replay a run of this sweep.")  # fmt: skip
@options.which_run
@options.body
@options.launch
@options.dissipation
@options.t_end
@option("--points", type=int, help="Number of rows.  [default: 20 per pitch period]")
@options.from_time
@options.integrator
@options.title()
@options.file("--output", ".html", required=True, help="An .html file.")
@options.quiet
def show(
    directory: Path | None,
    which: dict[str, Any],
    points: int | None,
    from_time: float | None,
    title: str | None,
    output: Path,
    quiet: bool,
    t_end: float | None,
    **run: dict[str, Any],
) -> int:
    """Write an HTML page on which the body rolls on the plane, with its trace and its spin.

    It needs a browser but no network. Play, pause, change the speed, drag to look around; the page
    lists its keys.
    """
    from rattlesweep.analysis.derived import in_units_of
    from rattlesweep.analysis.onerun.replay import Replay
    from rattlesweep.analysis.viewer import show as pages

    probe(output)
    stored: StoredRun | None = None
    with Meter(quiet) as meter:
        rows: dict[str, Any] = {"points": points, "from_time": from_time}
        rows["watch"] = meter.counting("integrating")
        if directory is not None:
            for name, given in run.items():
                for flag in getattr(options, name).flags(given):
                    raise ConfigError(
                        f"{flag} does not go with --from: the sweep says what the run was"
                    )
            in_units_of(None, {"t_end": t_end})
            source = Replay(directory)
            stored = source.select(**which)[0]
            course, scene = pages.save_stored(source, stored, output, title, t_end, **rows)
        else:
            if which:
                raise ConfigError("--case, --sample and --where go with --from")
            course = pages.course_of(options.launched(**run, t_end=t_end), **rows)
            scene = pages.make_scene(course)
            preset = run["body"].get("preset", "")
            pages.save(course, scene, output, title or f"Rattleback {preset}".rstrip())
    click.echo(output)
    if not quiet:
        if stored is not None:
            say(stored.proof)
            if cause := dict(scene.about["facts"]).get("sensitive"):
                say(cause)
        say(f"{len(scene.t)} rows, {output.stat().st_size / 1e6:.1f} MB")
    return say_outcome(course, quiet)
