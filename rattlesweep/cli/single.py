"""Commands about one body or one run."""

from __future__ import annotations

import math
import sys
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import click
from click import option

from rattlesweep.cli import options
from rattlesweep.cli.options import DONE, SOME_FAILED, command, pick, probe, say, to_json
from rattlesweep.errors import ConfigError, one_line
from rattlesweep.text import Bar, align, counted

if TYPE_CHECKING:
    from rattlesweep.analysis.fit import Fit
    from rattlesweep.analysis.onerun.course import Course, PreparedRun
    from rattlesweep.analysis.onerun.replay import StoredRun
    from rattlesweep.physics.body import Rattleback
    from rattlesweep.sweeps.bodies import Scale


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


# -- time series -----------------------------------------------------------------------------------


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
    from rattlesweep.api.single import rows_of

    probe(output, figure)
    chosen = pick(given, *options.ROWS)
    run, scale = _prepared(given)
    course = _write_course(run, channels, rows_of(scale, **chosen), output, figure, quiet)
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
    from rattlesweep.analysis.onerun.replay import find_runs
    from rattlesweep.api.arrays import number
    from rattlesweep.api.single import rows_of

    chosen = pick(given, *options.ROWS)
    runs = find_runs(directory, **pick(given, "case", "sample", "where", "first"))
    if output is None and figure is None and len(runs) > 1:
        raise ConfigError(f"{len(runs)} runs do not go into one table; give --output with {{case}} "
                          "and {sample} in its name")  # fmt: skip
    outputs, figures = (_files_of(runs, path) for path in (output, figure))
    probe(*outputs, *figures)
    codes = []
    for run, table, picture in zip(runs, outputs, figures, strict=True):
        prepared = run.prepare(number("t_end", t_end, run.scale))
        rows = rows_of(run.scale, **chosen)
        run.prove()
        course = _write_course(prepared, channels, rows, table, picture, quiet)
        if not quiet:
            say(run.proof)
        codes.append(_say_outcome(course, quiet, run.scale))
    return max(codes)


def _files_of(runs: Sequence[StoredRun], path: Path | None) -> list[Path | None]:
    """Return a file for each run: the path with ``{case}`` and ``{sample}`` filled in."""
    if path is None:
        return [None] * len(runs)
    names = []
    for run in runs:
        name = str(path).replace("{case}", str(run.values["case"]))
        names.append(name.replace("{sample}", str(run.values["sample"])))
    if len(set(names)) < len(names):
        raise ConfigError(f"{path}: {len(names)} runs would be written there; name files by run, "
                          "such as run-{case}-{sample}")  # fmt: skip
    return [Path(name) for name in names]


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
    from rattlesweep.api.single import page_of, stored_page

    probe(output)
    which = pick(given, "case", "sample", "where")
    rows = pick(given, "points", "from_time")
    proof, scale = "", None
    with Bar.of_command(quiet) as bar:
        rows["watch"] = bar.counting("integrating")
        if directory is not None:
            rows |= pick(given, "t_end")
            for name in pick(given, *given):
                raise ConfigError(f"--{name.replace('_', '-')}: the sweep in {directory} says what "
                                  "the run was; leave this out")  # fmt: skip
            page, course, proof = stored_page(directory, which, title=title, path=output, **rows)
        elif which:
            raise ConfigError("--case, --sample and --where choose a run of a DIRECTORY; give it")
        else:
            title = title or f"Rattleback {given['preset'] or ''}".rstrip()
            run, scale = _prepared(given)
            page, course = page_of(run, scale, title, path=output, **rows)
    click.echo(output)
    for note in () if quiet else (proof, f"{len(page.content) / 1e6:.1f} MB"):
        if note:
            say(note)
    return _say_outcome(course, quiet, scale)


def _prepared(given: dict[str, Any]) -> tuple[PreparedRun, Scale | None]:
    """Return the run that options ask for, and the units of its body."""
    from rattlesweep.analysis.derived import make_body
    from rattlesweep.analysis.onerun.course import PreparedRun
    from rattlesweep.api.arrays import scale_of
    from rattlesweep.api.single import launch_of

    made = make_body(pick(given, *options.BODY))
    rest = pick(given, *given)
    defaults = {} if {"omega", "u"} & rest.keys() else options.SPIN_DEFAULTS
    return PreparedRun.of(launch_of(made, **{**defaults, **rest})), scale_of(made.units)


def _write_course(
    run: PreparedRun, channels: tuple[str, ...] | None, rows: dict[str, Any],
    output: Path | None, figure: Path | None, quiet: bool,
) -> Course:  # fmt: skip
    """Integrate a run, and write what is asked for (a figure has own rows), or print CSV."""
    from rattlesweep.analysis.onerun.course import Course, save, write_csv

    # A bar and a table would stand on one terminal.
    on_one = output is None and figure is None and sys.stdout.isatty()
    with Bar.of_command(quiet or on_one) as bar:
        watch = bar.counting("integrating")
        if output is not None or figure is None:
            course = Course(run, channels or ("t", "n"), **rows, watch=watch)
            if output is not None:
                save(course, output)
            else:
                write_csv(course, sys.stdout.buffer)
                sys.stdout.flush()
        if figure is not None:
            # Matplotlib is loaded for figures alone.
            from rattlesweep.analysis.onerun.figure import course_of, draw

            course = course_of(run, channels, rows["from_time"], watch)
            draw(course.columns(), course, figure)
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


# -- fit -------------------------------------------------------------------------------------------


@command(
    "One run",
    "rattlesweep fit configs/fit/stone.yaml configs/fit/data.csv --figure fit.svg",
)
@options.path("stone")
@options.path("data")
@options.figure
@options.as_json
@options.quiet
def fit(stone: Path, data: Path, figure: Path | None, as_json: bool, quiet: bool) -> None:
    """Fit parameters of a stone to an angle or a spin of a video, or to reversal times.

    STONE is a YAML file with the keys body, launch, dissipation and free. DATA is a CSV or Parquet
    table with t_s and angle_deg or spin_rpm, or with reversal_s. Prints each free parameter with
    its 95 % interval. docs/fit.md explains both files.
    """
    from rattlesweep.api.single import fit

    probe(figure)
    arguments = _read_stone(stone)
    try:
        found = fit(data=data, **arguments)
    except ConfigError as error:
        of_data = str(error).startswith(one_line(str(data), 200))
        raise ConfigError(str(error) if of_data else f"{stone}: {error}") from None
    if as_json:
        names = ("values", "intervals", "noise", "noise_unit", "rows", "remarks")
        click.echo(to_json({name: getattr(found, name) for name in names}))
    else:
        click.echo(_fit_table(found))
    if figure is not None:
        found.plot(figure)
    if not quiet:
        say(f"{found.rows} rows, noise {found.noise:.3g} {found.noise_unit}")
        for remark in found.remarks:
            say(f"warning: {remark}")


def _fit_table(found: Fit) -> str:
    """Return values and intervals, in SI units too where the body has a size."""
    from rattlesweep.analysis.fit import PARAMETERS

    sizes = {"rad": (180 / math.pi, "deg")}
    if found.body.units is not None:
        sizes |= found.body.units.sizes
        sizes["sqrt(g/a)"] = sizes["sqrt(g/a)"][0] * 30 / math.pi, "rpm"
    lines = [["", "value", "low", "high", "unit", "", "low", "high", "unit", ""]]
    for name, value in found.values.items():
        known, numbers = PARAMETERS[name], (value, *found.intervals[name])
        size, unit = sizes.get(known.unit, (math.nan, ""))
        si = [f"{size * number:.5g}" if unit else "" for number in numbers]
        plain = [f"{number:.6g}" for number in numbers]
        lines.append([name, *plain, known.unit, *si, unit, known.description])
    return align(lines, "<>>><>>><<")


def _read_stone(path: Path) -> dict[str, Any]:
    """Return the arguments of :func:`rattlesweep.fit` in a YAML file."""
    from pydantic import BaseModel, ValidationError
    from ruamel.yaml import YAML
    from ruamel.yaml.error import YAMLError

    class Stone(BaseModel, extra="forbid"):
        body: dict[str, Any]
        free: list[str]
        launch: dict[str, Any] = {}
        dissipation: dict[Literal["sigma", "rolling"], float | str] = {}

    try:
        text = path.read_text(encoding="utf-8")
        given = Stone.model_validate(YAML(typ="safe", pure=True).load(text))
        body = _stone(given.body)
    except ValidationError as error:
        first = error.errors()[0]
        reason = f"{'.'.join(map(str, first['loc']))}: {first['msg']}"
    except (YAMLError, OSError, ValueError, TypeError) as error:
        reason = getattr(error, "strerror", None) or " ".join(str(error).split())
    else:
        losses = {str(name): value for name, value in given.dissipation.items()}
        return {"body": body, "free": given.free, "launch": given.launch, **losses}
    raise ConfigError(f"{path}: {one_line(reason, 300)}")


def _stone(given: dict[str, Any]) -> Rattleback:
    from rattlesweep.api.arrays import one_body
    from rattlesweep.physics.body import Rattleback

    if "xi_deg" in given:
        given["xi"] = math.radians(given.pop("xi_deg"))
    if "preset" in given:
        return one_body(given.pop("preset")).replace(**given)
    if given.pop("shape", "") == "half_ellipsoid":
        return Rattleback.half_ellipsoid(**given)
    if "mass" in given:
        return Rattleback.from_si(**given)
    return Rattleback.shell_dumbbell(**given) if "f_sd" in given else Rattleback(**given)
