"""Commands about one body or one run."""

from __future__ import annotations

import sys
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
from click import option

from rattlesweep.cli import options
from rattlesweep.cli.options import DONE, SOME_FAILED, command, pick, probe, say, to_json
from rattlesweep.errors import ConfigError
from rattlesweep.text import Bar, align, counted

if TYPE_CHECKING:
    from rattlesweep.analysis.onerun.course import Course
    from rattlesweep.sweeps.bodies.protocol import Scale
    from rattlesweep.sweeps.single import Launch


@command(
    "One run",
    "rattlesweep body --mass 85g --height 1cm --inertia '60,900,920,-20 g cm^2' "
    "--radii '50,1.5 cm' --n-i 60rpm",
    "rattlesweep body --half-ellipsoid 12cm,3cm,12mm --mass 60g --skew 3deg --n-i 60rpm",
    "rattlesweep body --gamma 10 --f-sd 0.1 --theta 0.8 --phi 0.05 --xi-deg -3 --json",
)
@options.body
@options.spin
@options.dissipation
@options.as_json
def body(as_json: bool, **given: Any) -> None:
    """Print the derived quantities of a body: modes, thresholds, reversal times.

    The spin and the oscillation matter for the reversal times only. A body that was given in SI
    units has all quantities in both systems, with g = 9.81 m/s^2.
    """
    from rattlesweep.analysis.derived import derived, make_body
    from rattlesweep.api.arrays import number, scale_of

    made = make_body(pick(given, *options.BODY))
    scale = scale_of(made.units)
    launch = options.SPIN_DEFAULTS | pick(given, *given)
    numbers: dict[str, Any] = {name: number(name, x, scale) for name, x in launch.items()}
    values = derived(made, **numbers)
    if as_json:
        si = {q.name: dict(zip(("value", "unit"), q.in_si, strict=True)) for q in values if q.in_si}
        units = {} if made.units is None else {"units": asdict(made.units), "si": si}
        click.echo(to_json({q.name: q.value for q in values} | units))
        return
    lines = []
    for q in values:
        value = "none" if q.value is None else f"{q.value:.10g}"
        shown = ("", "") if q.in_si is None else (f"{q.in_si[0]:.5g}", q.in_si[1])
        lines.append((q.name, value, q.unit, *(shown if made.units else ()), q.description))
    click.echo(align(lines, "<><><" if made.units else "<><"))


def _list_channels(context: click.Context, _: click.Parameter, names: Any) -> Any:
    """Print every channel with its unit and meaning, if the word is ``list``."""
    if names == ("list",):
        from rattlesweep.analysis.onerun.channels import CHANNELS

        click.echo(align([(c.name, c.unit, c.description) for c in CHANNELS.values()], "<"))
        context.exit()
    return names


series = options.stack(
    options.rows,
    option("--channels", type=options.Kind("a,b,...", options.names), callback=_list_channels,
           help="Columns, and panels of the figure if given; 'list' prints all of them.  "
                "[default: t,n]"),
    options.file("--output", ".parquet", ".csv", help="A .parquet or .csv file, instead of CSV on "
                 "standard output; of a replay, {case} and {sample} are substituted."),
    options.file("--figure", *options.PICTURES,
                 help="Also draw a figure, an .svg, .png or .pdf file; likewise."),
    options.quiet,
)  # fmt: skip
"""Options of a time series."""


@command(
    "One run",
    "rattlesweep trajectory --preset GH --theta 0.82 --t-end 2e4 --dt 0.5 "
    "--channels t,n,E_p,E_r --output run.parquet --figure run.svg",
    "rattlesweep trajectory --preset GH --omega 0.02,0,-0.3 --u 0.01,0,-1 --t-end 500",
)
@options.body
@options.launch
@option("--model", type=options.MODELS, default="full", help="Equations of motion.")
@option("--e-p0", type=options.ENERGY, help="Energy of the pitch at the start of the reduced "
        "model, in M g a, or as in 0.5mJ.")  # fmt: skip
@option("--e-r0", type=options.ENERGY, help="Energy of the roll, likewise.")
@series
def trajectory(
    channels: tuple[str, ...] | None, output: Path | None, figure: Path | None, quiet: bool,
    **given: Any,
) -> int:  # fmt: skip
    """Integrate one launch, past its reversals, as a time series.

    Prints CSV unless a file or a figure is requested; the reversal times go to standard error. A
    reversal is counted once the spin has gone from beyond a quarter of its initial value (without
    one, of n_0) to beyond a quarter of it on the other side.
    """
    from rattlesweep.api.arrays import scale_of
    from rattlesweep.api.single import rows_of

    probe(output, figure)
    chosen = pick(given, *options.ROWS)
    launch = _launch(given)
    scale = scale_of(launch.body.units)
    course = _write_course(launch, channels, rows_of(scale, **chosen), output, figure, quiet)
    return _say_outcome(course, quiet, scale)


@command(
    "One run",
    "rattlesweep replay out/quickstart --where 'type == \"SW\" and K_r < 0.005' --first 3 "
    "--output run-{case}-{sample}.parquet",
)
@options.directory
@options.which
@option("--first", type=options.COUNT, help="Number of runs to take from --where.  [default: 1]")
@options.t_end
@series
def replay(
    directory: Path, t_end: float | None, channels: tuple[str, ...] | None, output: Path | None,
    figure: Path | None, quiet: bool, **given: Any,
) -> int:  # fmt: skip
    """Integrate stored runs again as time series.

    They go on past their reversals. Each run is first integrated as in the sweep, and compared with
    the stored row, bit for bit. Exits with 1 if any differs.
    """
    from rattlesweep.analysis.onerun.replay import Replay, targets
    from rattlesweep.api.arrays import number
    from rattlesweep.api.single import rows_of, stored_scale

    chosen = pick(given, *options.ROWS)
    source = Replay(directory)
    runs = source.select(**pick(given, "case", "sample", "where", "first"))
    outputs = targets(output, runs, "--output", printed=figure is None)
    drawings = targets(figure, runs, "--figure")
    probe(*outputs, *drawings)
    codes = []
    for run, out, drawing in zip(runs, outputs, drawings, strict=True):
        scale = stored_scale(source, run)
        prepared, rows = (
            source.prepare(run, number("t_end", t_end, scale)),
            rows_of(scale, **chosen),
        )
        source.prove(run)
        course = _write_course(prepared, channels, rows, out, drawing, quiet)
        run.check(course)
        for line in (run.proof, source.cause(run)):
            if line and not quiet:
                say(line)
        codes.append(_say_outcome(course, quiet, scale))
    return max(codes)


@command(
    "One run",
    "rattlesweep show --preset GH --n-i -0.1 --output spin.html",
    "rattlesweep show out/quickstart --where 'type == \"SW\"' --output wobble.html",
)
@options.path("directory", required=False)
@options.which
@options.body
@options.launch
@option("--points", type=int, help="Number of rows.  [default: 20 per pitch period]")
@options.from_time
@options.title
@options.file("--output", ".html", required=True, help="An .html file.")
@options.quiet
def show(directory: Path | None, title: str | None, output: Path, quiet: bool, **given: Any) -> int:
    """Write an HTML page on which the body of one run rolls on the plane.

    The run is a launch of a body, or a stored run of DIRECTORY, as `replay` takes it. The page
    needs a browser but no network.
    """
    from rattlesweep.api.arrays import scale_of
    from rattlesweep.api.single import page_of, stored_page

    probe(output)
    which = pick(given, "case", "sample", "where")
    rows = pick(given, "points", "from_time")
    notes: list[str] = []
    scale = None
    with Bar.of_command(quiet) as bar:
        rows["watch"] = bar.counting("integrating")
        if directory is not None:
            rows |= pick(given, "t_end")
            for name in pick(given, *given):
                raise ConfigError(f"--{name.replace('_', '-')}: the sweep in {directory} says what "
                                  "the run was; leave this out")  # fmt: skip
            page, course, notes = stored_page(directory, which, title=title, **rows)
        else:
            if which:
                raise ConfigError("--case, --sample and --where choose a run of a DIRECTORY; give "
                                  "it too")  # fmt: skip
            title = title or f"Rattleback {given['preset'] or ''}".rstrip()
            launch = _launch(given)
            scale = scale_of(launch.body.units)
            page, course = page_of(launch, scale, title=title, **rows)
    page.save(output)
    click.echo(output)
    for note in () if quiet else (*notes, f"{len(page.content) / 1e6:.1f} MB"):
        say(note)
    return _say_outcome(course, quiet, scale)


def _launch(given: dict[str, Any]) -> Launch:
    """Return the run that options ask for, in the units of its body."""
    from rattlesweep.analysis.derived import make_body
    from rattlesweep.api.single import launch_of

    made = make_body(pick(given, *options.BODY))
    rest = pick(given, *given)
    defaults = {} if {"omega", "u"} & rest.keys() else options.SPIN_DEFAULTS
    return launch_of(made, **{**defaults, **rest})


def _write_course(
    run: Any, channels: Any, rows: Any, output: Path | None, figure: Path | None, quiet: bool
) -> Course:
    """Integrate a run, and write what is asked for (a figure has own rows), or print CSV."""
    from rattlesweep.analysis.onerun import files
    from rattlesweep.analysis.onerun.course import Course

    # A bar and a table would stand on one terminal.
    on_one = output is None and figure is None and sys.stdout.isatty()
    with Bar.of_command(quiet or on_one) as bar:
        watch = bar.counting("integrating")
        if output is not None or figure is None:
            course = Course(run, channels=channels or ("t", "n"), rows=rows, watch=watch)
            if output is not None:
                files.save(course, output)
            else:
                files.write_csv(course, sys.stdout.buffer.write)
                sys.stdout.flush()
        if figure is not None:
            # Matplotlib is loaded for figures alone.
            from rattlesweep.analysis.onerun import figure as figures

            course = figures.course_of(run, channels, watch, rows.from_time)
            figures.save(course, figure)
    return course


def _say_outcome(course: Course, quiet: bool, scale: Scale | None) -> int:
    """Tell what became of a run, in seconds too where the body has a size; return the exit code."""
    if not quiet:
        text = _times(course.reversals, "reversal")
        if scale is not None and course.reversals:
            text += f" ({', '.join(f'{t * scale.second:.4g} s' for t in course.reversals[:8])})"
        if course.zeros != course.reversals:
            text += f" ({_times(course.zeros, 'zero crossing')})"
        say(f"{text}; {course.n_steps} steps to t = {course.t:g}")
        if course.observer.warning:
            say(f"warning: {course.observer.warning}")
    if course.status.label != "ok":
        say(f"the run failed: {course.status.label}, {course.status.meaning}")
        return SOME_FAILED
    return DONE


def _times(times: list[float], word: str) -> str:
    """Return such as ``2 reversals at 112.1, 387.5``."""
    shown = ", ".join(f"{time:.10g}" for time in times[:8])
    more = f" and {len(times) - 8} more" if len(times) > 8 else ""
    return f"{counted(len(times), word)} at {shown}{more}" if times else f"no {word}s"
