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
    from rattlesweep.study.onerun.replay import StoredRun


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
    body: dict[str, Any],
    launch: dict[str, Any],
    dissipation: dict[str, Any],
    t_end: float | None,
    points: int | None,
    from_time: float | None,
    integrator: dict[str, Any],
    title: str | None,
    output: Path,
    quiet: bool,
) -> int:
    """Write an HTML page on which the body rolls on the plane, with its trace and its spin.

    It needs a browser but no network. Play, pause, change the speed, drag to look around; the page
    lists its keys.
    """
    from rattlesweep.study.derived import in_units_of, make_body
    from rattlesweep.study.onerun.replay import Replay
    from rattlesweep.study.viewer import show as pages
    from rattlesweep.sweeps.blocks.single import Launch

    probe(output)
    stored: StoredRun | None = None
    with Meter(quiet) as meter:
        watch = meter.counting("integrating")
        if directory is not None:
            _refuse(body=body, launch=launch, dissipation=dissipation, integrator=integrator)
            in_units_of(None, {"t_end": t_end})
            source = Replay(directory)
            pages.check_model(source.config.model)
            stored = source.select(**which)[0]
            course, scene, name = pages.course_of_stored(
                source, stored, t_end=t_end, watch=watch, points=points, from_time=from_time
            )
        else:
            if which:
                raise ConfigError("--case, --sample and --where go with --from")
            made = make_body(body)
            given = options.launched(launch) | dissipation | {"t_end": t_end}
            run = Launch(made, integrator=integrator, **in_units_of(made.units, given))
            name = " ".join(["Rattleback", *([body["preset"]] if "preset" in body else [])])
            course = pages.course_of(run, points, watch, from_time=from_time)
            scene = pages.make_scene(course)
    pages.save(scene, output, title or name, pages.describe(course))
    click.echo(output)
    if not quiet:
        if stored is not None:
            say(stored.proof)
            if cause := dict(scene.about["facts"]).get("sensitive"):
                say(cause)
        say(f"{len(scene.t)} rows, {output.stat().st_size / 1e6:.1f} MB")
    return say_outcome(course, quiet)


def _refuse(**given: dict[str, Any]) -> None:
    """Complain of a body or a launch beside `--from`."""
    flags = [
        flag for group, values in given.items() for flag in getattr(options, group).flags(values)
    ]
    if flags:
        raise ConfigError(f"{flags[0]} does not go with --from: the sweep says what the run was")
