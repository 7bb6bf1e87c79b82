"""Commands that follow one run: as a time series, as a page, stored ones again."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
from click import option

from rattlesweep.cli import options
from rattlesweep.cli.given import prepared_run, run_of_stone
from rattlesweep.cli.options import (
    DONE,
    SOME_FAILED,
    command,
    pick,
    probe_files,
    refuse,
    say,
    tell,
    warn,
)
from rattlesweep.system.console import align, counted, shortened
from rattlesweep.words.defaults import FRAMES_A_PERIOD
from rattlesweep.words.errors import ConfigError

if TYPE_CHECKING:
    from rattlesweep.analysis.onerun.course import Course, PreparedRun


MOST_TIMES = 8  # of a list of reversals, the others are not printed


def _list_channels(
    context: click.Context, _: click.Parameter, names: tuple[str, ...] | None
) -> tuple[str, ...] | None:
    """Print all channels and stop if ``list`` is requested."""
    if names == ("list",):
        from rattlesweep.analysis.onerun.channels import CHANNELS

        lines = [
            (channel.name, channel.unit, channel.description)
            for channel in CHANNELS.values()
        ]
        click.echo(align(lines, "<"))
        context.exit()
    if names == ():
        raise ConfigError("--channels: give at least one name")
    return names


series = options.stack(
    options.rows,
    option(
        "--channels",
        type=options.NAME_LIST,
        callback=_list_channels,
        help="Columns, and panels of the figure; 'list' prints all of them.  "
        "[default: t,n; of a section, the variables of the state]",
    ),
    option(
        "--section",
        metavar="CHANNEL=VALUE",
        help="Instead of rows in time, one row for each time that a channel crosses a "
        "value, as in omega_y=0; omega_y=0+ takes only rising crossings, omega_y=0- "
        "falling ones.  The figure shows the first two other channels.",
    ),
    options.file(
        "--output",
        ".parquet",
        ".csv",
        help="A .parquet or .csv file instead of CSV on standard output.",
    ),
    options.figure,
    options.quiet,
)


@command(
    "One run",
    "rattlesweep trajectory --preset GH --theta 0.82 --t-end 2e4 --dt 0.5 "
    "--channels t,n,E_p,E_r --output run.parquet --figure run.svg",
    "rattlesweep trajectory --preset GH --omega 0.02,0,-0.3 --u 0.01,0,-1 --t-end 500",
    "rattlesweep trajectory --preset GH --n-i -0.3 --omega-xy0 0.1 --t-end 1e5 "
    "--section omega_y=0+ --channels n,omega_x --output section.csv "
    "--figure section.png",
)
@options.body_options
@options.launch_options
@options.integrator
@option(
    "--model", type=options.MODEL_CHOICE, default="full", help="Equations of motion."
)
@option(
    "--e-p0",
    type=options.ENERGY_VALUE,
    help="Initial energy of the pitch in the reduced model, in M g a, or as in 0.5mJ.",
)
@option("--e-r0", type=options.ENERGY_VALUE, help="Energy of the roll, likewise.")
@series
def trajectory(**given: Any) -> int:
    """Integrate one launch, past its reversals, as a time series.

    Prints CSV unless a file or a figure is requested, and the reversal times on
    standard error. A reversal takes the spin from beyond a quarter of its initial value
    (of n_0 for a tap) to beyond a quarter on the other side.
    """
    probe_files(given["output"], given["figure"])
    run = prepared_run(given)
    return _follow(run, **given)


@command(
    "One run",
    "rattlesweep replay out/quickstart --where 'type == \"SW\" and K_r < 0.005' "
    "--output sw.csv",
)
@options.directory
@options.which
@options.t_end
@series
def replay(directory: Path, **given: Any) -> int:
    """Integrate a stored run again as a time series, past its reversals.

    Exits with 1 if its result is not the stored one, bit for bit.
    """
    from rattlesweep.api.trajectories import prepare_stored

    probe_files(given["output"], given["figure"])
    which = pick(given, "case", "sample", "where", "t_end")
    run, prepared = prepare_stored(directory, **which)
    return _follow(prepared, run.proof, **given)


@command(
    "One run",
    "rattlesweep show --preset GH --n-i -0.1 --output spin.html",
    "rattlesweep show out/quickstart --where 'type == \"SW\"' -o wobble.html",
)
@options.path("directory", required=False)
@options.which
@options.body_options
@options.launch_options
@options.integrator
@option(
    "--points",
    type=int,
    help=f"Number of rows.  [default: {FRAMES_A_PERIOD} per pitch period]",
)
@options.from_time
@options.title
@options.file("--output", ".html", required=True, help="An .html file.")
@options.quiet
def show(
    directory: Path | None, title: str | None, output: Path, quiet: bool, **given: Any
) -> int:
    """Write an HTML page on which the body of one run rolls on the plane.

    The run is a launch of a body, or a stored run of DIRECTORY, chosen as in `replay`.
    A stone file in place of DIRECTORY has body, launch, dissipation and base, of which
    options replace the launch. The body of a mesh is drawn as the mesh. The page needs
    a browser but no network.
    """
    from rattlesweep.api.trajectories import page_of, prepare_stored

    probe_files(output)
    which = pick(given, "case", "sample", "where")
    rows = pick(given, "points", "from_time")
    proof = ""
    if directory is not None and directory.is_file():
        refuse(which, "a stone file has no stored runs; leave it out")
        title = title or directory.stem
        run = run_of_stone(directory, given)
    elif directory is not None:
        t_end = given.pop("t_end")
        refuse(given, "a stored run has its own; leave it out")
        stored, run = prepare_stored(directory, t_end, **which)
        proof = stored.proof
        title = title or stored.title
    elif which:
        raise ConfigError(
            "--case, --sample and --where choose a run of a DIRECTORY; give it"
        )
    else:
        if title is None and given["preset"]:
            title = f"Rattleback {given['preset']}"
        run = prepared_run(given)
    page, course = page_of(run, title, path=output, **rows)
    tell(output)
    if not quiet:
        say(f"{len(page.content) / 1e6:.1f} MB")
    return _say_outcome(course, quiet, proof)


def _follow(
    run: PreparedRun,
    proof: str = "",
    *,
    channels: tuple[str, ...] | None,
    section: str | None,
    output: Path | None,
    figure: Path | None,
    quiet: bool,
    **given: Any,
) -> int:
    """Integrate a run, and write its files or print CSV; a figure has its own rows."""
    from rattlesweep.analysis.onerun.course import Course, save_course, write_csv
    from rattlesweep.analysis.onerun.section import Section
    from rattlesweep.api.trajectories import rows_of

    rows = rows_of(run.units, **given)
    if section is not None:
        rows["section"] = Section.parse(section, run.model, run.units)
    if section is not None or output is not None or figure is None:
        course = Course(run, channels, **rows)
        if section is not None and figure is not None:
            from rattlesweep.analysis.onerun.figure import draw_section

            draw_section(course, path=figure)
        if output is not None:
            save_course(course, output)
        elif figure is None:
            write_csv(course, sys.stdout.buffer)
    if section is None and figure is not None:
        from rattlesweep.analysis.onerun.figure import course_of_figure, draw

        course = course_of_figure(run, channels, rows["from_time"])
        draw(course.columns(), course, figure)
    return _say_outcome(course, quiet, proof)


def _say_outcome(course: Course, quiet: bool, proof: str) -> int:
    """Print the reversals of a run, also in seconds if it has a size."""
    follower = course.follower
    units = course.run.units
    if not quiet:
        if proof:
            say(proof)
        text = _times(course.reversals, "reversal")
        if units is not None and course.reversals:
            first = course.reversals[:MOST_TIMES]
            text += f" ({', '.join(f'{t * units.time:.4g} s' for t in first)})"
        if follower.zeros != course.reversals:
            text += f" ({_times(follower.zeros, 'zero crossing')})"
        if course.section is not None:
            crossings = counted(course.n_crossings, "crossing")
            text += f"; {crossings} of {course.section.text}"
        text += f"; {follower.n_steps} steps to t = {follower.t:g}"
        if units is not None:
            text += f" ({follower.t * units.time:.4g} s)"
        if course.slides:
            text += f"; {course.slides_in_words}"
        say(text)
        if course.warning:
            warn(course.warning)
    if follower.status.label != "ok":
        say(f"the run failed: {follower.status.label}, {follower.status.meaning}")
        return SOME_FAILED
    return DONE


def _times(times: list[float], event: str) -> str:
    """Return how many events there are, with the first of their times."""
    if not times:
        return f"no {event}s"
    shown = shortened([f"{time:.10g}" for time in times], MOST_TIMES)
    return f"{counted(len(times), event)} at {shown}"
