"""Commands about one body or one run."""

from __future__ import annotations

import sys
import warnings
from collections.abc import Collection
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
from click import option

from rattlesweep.cli import options
from rattlesweep.cli.options import (
    DONE,
    SOME_FAILED,
    Given,
    command,
    pick,
    probe_files,
    say,
    tell,
    to_json,
)
from rattlesweep.errors import ConfigError, ConfigWarning, one_line
from rattlesweep.quantities import LOSSES
from rattlesweep.text import Bar, align, counted

if TYPE_CHECKING:
    import pandas as pd

    from rattlesweep.analysis.derived import DerivedQuantity
    from rattlesweep.analysis.fit.joint import JointFit
    from rattlesweep.analysis.fit.result import Fit
    from rattlesweep.analysis.onerun.course import Course, PreparedRun
    from rattlesweep.physics.body import Rattleback

LEAST_FINENESS = 24  # below it the foot is a facet
MOST_FINENESS = 400  # 1.3 million triangles
MOST_TIMES = 8  # of a list of reversals, the others are not printed


@command(
    "One run",
    "rattlesweep body --gamma 10 --f-sd 0.1 --theta 0.8 --phi 0.05 --xi-deg -3",
    "rattlesweep body --half-ellipsoid 12cm,3cm,12mm --mass 60g --skew 3deg "
    "--n-i 60rpm",
    "rattlesweep body --mass 85g --height 1cm --inertia '60,900,920,-20 g cm^2' "
    "--radii '50,1.5 cm' --n-i 60rpm",
    "rattlesweep body --mesh stone.stl --unit mm --mass 60g --n-i 60rpm",
)
@options.body_options
@options.spin_options
@options.dissipation
@options.file(
    "--figure",
    *options.PICTURES,
    help="Also draw the mesh at rest and the part of its bottom that was fitted.",
)
@options.as_json
def body(as_json: bool, figure: Path | None, **given: Any) -> None:
    """Print the derived quantities of a body: modes, thresholds, reversal times.

    Spin and oscillation matter for the reversal times only. A body in SI units gets all
    quantities in both systems, with g = 9.81 m/s^2.
    """
    from rattlesweep.analysis.derived import (
        COMMON_FRICTION,
        SLIPS_AT_REVERSAL,
        derived,
    )
    from rattlesweep.api.arrays import one_number, require_units

    probe_files(figure)
    of_mesh = {name: given[name] for name in options.BODY if given[name] is not None}
    if figure is not None and "mesh" not in of_mesh:
        raise ConfigError("--figure shows a mesh; add --mesh, or leave it out")
    described = _body_of(given)
    launch = pick(given, *given)
    require_units(launch, described.units, _flag)
    launch = options.SPIN_DEFAULTS | launch
    numbers: Given = {
        name: one_number(name, value, described.units) for name, value in launch.items()
    }
    values = derived(described, **numbers)
    friction = {quantity.name: quantity.value for quantity in values}["friction"]
    # Sliding friction changes none of these quantities.
    mu = launch.get("mu", COMMON_FRICTION)
    if friction is not None and friction > mu:
        say(f"warning: {SLIPS_AT_REVERSAL.format(friction)}")
    if figure is not None:
        from rattlesweep.analysis.onerun.meshes import save_figure_of_mesh

        save_figure_of_mesh(figure, of_mesh, {each.name: each for each in values})
    if as_json:
        click.echo(to_json(_as_data(described, values)))
    else:
        click.echo(_as_table(described, values))


def _as_data(body: Rattleback, values: list[DerivedQuantity]) -> dict[str, object]:
    """Return derived quantities by name, and in SI units if the size is known."""
    data: dict[str, object] = {quantity.name: quantity.value for quantity in values}
    if body.units is not None:
        data["units"] = asdict(body.units)
        data["si"] = {
            quantity.name: {"value": quantity.in_si[0], "unit": quantity.in_si[1]}
            for quantity in values
            if quantity.in_si is not None
        }
    return data


def _as_table(body: Rattleback, values: list[DerivedQuantity]) -> str:
    """Return derived quantities as a text, with SI columns if the size is known."""
    lines = []
    for quantity in values:
        value = "none"
        if quantity.value is not None:
            value = f"{quantity.value:.10g}"
        line = [quantity.name, value, quantity.unit]
        if body.units is not None:
            si = ["", ""]
            if quantity.in_si is not None:
                si = [f"{quantity.in_si[0]:.5g}", quantity.in_si[1]]
            line += si
        lines.append([*line, quantity.description])
    return align(lines, "<><" if body.units is None else "<><><")


def _list_materials(
    context: click.Context, _: click.Parameter, materials: tuple[object, ...]
) -> tuple[object, ...]:
    """Print all materials and stop if ``list`` is requested."""
    if materials == ("list",):
        from rattlesweep.physics.materials import MATERIALS

        lines = [["", "E, GPa", "nu", ""]]
        for name, each in MATERIALS.items():
            lines.append([name, f"{each.E / 1e9:g}", f"{each.nu:g}", each.source])
        click.echo(align(lines, "<>><"))
        context.exit()
    return materials


@command(
    "One run",
    "rattlesweep contact --half-ellipsoid 12cm,3cm,12mm --mass 60g --skew 3deg "
    "--materials PLA,glass --facet 0.4mm",
    "rattlesweep contact configs/fit/stone.yaml --materials 'E=3.1GPa nu=0.36,wood'",
)
@options.path("stone", required=False)
@option(
    "--materials",
    type=options.MATERIAL_PAIR,
    required=True,
    callback=_list_materials,
    help="Materials of body and plane, as in PLA,glass; each a name or as in "
    "'E=3.5GPa nu=0.36'.  'list' prints all names.",
)
@option("--mu", type=float, default=0.3, help="Coefficient of friction.")
@option(
    "--n-i",
    type=options.SPIN_VALUE,
    default="60rpm",
    help="Vertical spin whose end is told, as in 60rpm.",
)
@option(
    "--facet",
    type=options.HEIGHT,
    help="Width of the flat facets of a printed bottom, to compare with the patch.",
)
@options.body_options
@options.as_json
def contact(stone: Path | None, as_json: bool, **given: Any) -> None:
    """Print the patch of contact under a stone at rest, and the lever of pivoting.

    While a stone spins, this patch rubs on the plane and ends the spin: with a torque
    of the weight times a lever, which dissipation.pivot takes in a config. The patch is
    Hertz's ellipse, of smooth elastic solids: without roughness, creep, wear, yielding
    or the grain of wood. STONE is a file as for `fit`, of which only the body counts;
    or options describe the body.
    """
    from rattlesweep.api import contact_patch
    from rattlesweep.api.arrays import require_units

    arguments = pick(given, "materials", "mu", "n_i", "facet")
    if stone is None:
        described = _body_of(given)
    else:
        for name in pick(given, *given):
            raise ConfigError(f"{_flag(name)}: STONE has its own body; leave it out")
        described = _read_stone(stone)["body"].body
    require_units(arguments, described.units, _flag)
    try:
        patch = contact_patch(described, **arguments)
    except ConfigError as error:
        raise ConfigError(
            [_of_option(message, arguments) for message in error.messages]
        ) from None
    values = patch.quantities()
    if as_json:
        data = _as_data(described, values)
        data["materials"] = [asdict(each) for each in patch.materials]
        data["remarks"] = patch.remarks
        click.echo(to_json(data))
    else:
        click.echo(_as_table(described, values))
    for remark in patch.remarks:
        say(remark)


@command(
    "One run",
    "rattlesweep stl --half-ellipsoid 12cm,3cm,12mm --skew 5deg --output stone.stl",
    "rattlesweep stl --half-ellipsoid 12cm,4cm,15mm --at 40mm,-7mm --pocket 10mm,4mm "
    "--output stone.stl",
)
@options.some_of_body("half-ellipsoid", "skew", "at")
@option(
    "--pocket",
    type=options.POCKET_SIZE,
    help="Diameter and depth of a round hole for a weight, around --at; another lies "
    "opposite.",
)
@option(
    "--fineness",
    type=options.COUNT,
    default=96,
    help="Rings of triangles from the lowest point to the edge.",
)
@options.file(
    "--output",
    *(".stl", ".obj", ".ply", ".3mf"),
    required=True,
    help="File to write, whose unit is mm.",
)
@options.quiet
def stl(output: Path, fineness: int, quiet: bool, **given: Any) -> None:
    """Write a half ellipsoid as a closed mesh for a 3D printer, and read it back.

    A skew turns the base against the flat side: the half ellipsoid is twisted about the
    vertical.  Pockets are left empty in what is read back.
    """
    from math import degrees

    from rattlesweep.physics import si
    from rattlesweep.physics.mesh.printing import write
    from rattlesweep.physics.mesh.shapes import half_ellipsoid, pockets_at, twist_of

    probe_files(output)
    if given["half_ellipsoid"] is None:
        raise ConfigError("--half-ellipsoid is missing; add it, as in 12cm,3cm,12mm")
    if (given["at"] is None) != (given["pocket"] is None):
        raise ConfigError("--at and --pocket belong together; give both or none")
    if not LEAST_FINENESS <= fineness <= MOST_FINENESS:
        raise ConfigError(
            f"--fineness: {fineness} is out of range; from {LEAST_FINENESS} to "
            f"{MOST_FINENESS} is allowed"
        )
    names = ("length", "width", "height")
    length, width, height = (
        si.size(text, "length", name)
        for name, text in zip(names, given["half_ellipsoid"], strict=True)
    )
    skew = si.number(given["skew"] or 0.0, "angle", "skew")
    pockets = []
    if given["pocket"] is not None:
        pockets = pockets_at(
            si.two_lengths(given["at"], "at"), si.two_lengths(given["pocket"], "pocket")
        )
    solid = half_ellipsoid(length, width, height, fineness, skew, pockets)
    standing = write(solid, output)
    tell(output)
    if quiet:
        return
    say(
        f"{len(solid.faces):,} triangles, closed, {solid.volume * 1e6:.5g} cm^3, unit "
        f"mm; the base is turned by {degrees(twist_of(skew, length / width)):.4g} deg "
        "against the flat side"
    )
    smaller, larger = standing.surface.radii * 1e3
    found = -degrees(standing.parameters["xi"])
    say(
        f"read back: skew {found:.4g} deg, radii {smaller:.5g} and {larger:.5g} mm, "
        f"centre of mass {standing.height * 1e3:.5g} mm high"
    )


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
@options.launch
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
    run = _prepared(given)
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
    from rattlesweep.api.single import prepare_stored

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
@options.launch
@options.integrator
@option("--points", type=int, help="Number of rows.  [default: 20 per pitch period]")
@options.from_time
@options.title
@options.file("--output", ".html", required=True, help="An .html file.")
@options.quiet
def show(
    directory: Path | None, title: str | None, output: Path, quiet: bool, **given: Any
) -> int:
    """Write an HTML page on which the body of one run rolls on the plane.

    The run is a launch of a body, or a stored run of DIRECTORY, chosen as in `replay`.
    The page needs a browser but no network.
    """
    from rattlesweep.api.single import page_of, prepare_stored

    probe_files(output)
    which = pick(given, "case", "sample", "where")
    rows = pick(given, "points", "from_time")
    proof = ""
    if directory is not None:
        t_end = given.pop("t_end")
        for name in pick(given, *given):
            raise ConfigError(f"{_flag(name)}: a stored run has its own; leave it out")
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
        run = _prepared(given)
    page, course = page_of(run, title, path=output, **rows)
    tell(output)
    if not quiet:
        say(f"{len(page.content) / 1e6:.1f} MB")
    return _say_outcome(course, quiet, proof)


@command(
    "One run",
    "rattlesweep export --mass 0.5kg --height 3cm --inertia '15.3,4.5,18 kg cm^2' "
    "--radii '12,48 cm' --axes-angle 20deg --c 3cm --n-i '-5 rad/s' "
    "--omega-xy0 '2 rad/s' --psi 110 --t-end 3s --output demo.xml",
    "rattlesweep export --preset GH --length 1cm --format json --output gh.json",
    "rattlesweep export --cases engines",
)
@options.body_options
@options.launch
@option(
    "--length",
    type=options.HEIGHT,
    help="Height of the centre of mass, for a body without a size.",
)
@option(
    "--format",
    type=options.FORMATS,
    default=None,
    help="A model of MuJoCo, or a document with poses and a schema.  "
    "[default: that of the file, or mjcf]",
)
@option("--name", metavar="TEXT", help="Name of the case.  [default: rattleback]")
@options.file(
    "--output",
    ".xml",
    ".json",
    help="An .xml file of a model or a .json file, instead of standard output.",
)
@option(
    "--cases",
    type=options.Kind("dir", Path),
    help="Instead of all these, write the reference cases to a directory.",
)
@options.quiet
def export(
    format: str | None,
    name: str | None,
    length: float | None,
    output: Path | None,
    cases: Path | None,
    quiet: bool,
    **given: Any,
) -> None:
    """Write a run as a file that a physics engine can repeat.

    The file has the body, the launch and what to expect: the first reversal with its
    error, the direction and the friction that rolling needs. docs/engines.md says how
    well engines do.
    """
    from rattlesweep.api.exports import ENDINGS, export_run, write_cases

    if cases is not None:
        others = {"format": format, "name": name, "length": length, "output": output}
        for option_of in pick({**given, **others}, *given, *others):
            raise ConfigError(
                f"{_flag(option_of)}: the reference cases have their own; leave it out"
            )
        tell(*write_cases(cases))
        return
    probe_files(output)
    if format is None:
        format = "json" if output and output.suffix.lower() == ".json" else "mjcf"
    if output is not None and output.suffix.lower() != ENDINGS[format]:
        raise ConfigError(
            f"--output {output}: a file of the format {format} ends in "
            f"{ENDINGS[format]}"
        )
    if name is None:
        name = given["preset"] or "rattleback"
    text, case = export_run(_prepared(given), format, length, name, output)
    if output is None:
        click.echo(text, nl=False)
    else:
        tell(output)
    if quiet:
        return
    reversal = case.expected.first_reversal
    if reversal is None:
        say(f"no reversal by {case.expected.until:g} s")
    else:
        say(f"first reversal at {reversal.time:.12g} s, +- {reversal.error:.1g} s")
    if case.plane.friction is None:
        needed = case.expected.contact.friction
        say(f"rolling needs a friction of {needed:.2g} up to then")
    elif case.expected.slides:
        say(f"slides up to then: {len(case.expected.slides)}")


def _flag(name: str) -> str:
    """Return the flag of an argument."""
    if name == "shape":
        return "--half-ellipsoid"
    return f"--{name.replace('_', '-')}"


def _flag_of_body(name: str) -> str:
    """Return the option of a quantity of a body; --points are those of a trajectory."""
    return _flag("mass_points" if name == "points" else name)


def _body_of(given: Given) -> Rattleback:
    """Return the body that the options of a command describe."""
    from rattlesweep.design.bodies.making import body_from
    from rattlesweep.units import require_unit

    values = pick(given, *options.BODY)
    if "half_ellipsoid" in values:
        values["shape"] = "half_ellipsoid"
        lengths = values.pop("half_ellipsoid")
        values["length"], values["width"], values["height"] = lengths
    if "mass_points" in values:
        values["points"] = values.pop("mass_points")
    semi_axis = values.get("c")
    if values.keys() & {"shape", "mesh", "mass"}:
        require_unit("--c", semi_axis, "length")
    elif isinstance(semi_axis, str):
        raise ConfigError(
            "--c has a unit, but the body has no size; give a number in a"
        )
    # The types of the options have refused numbers without a unit, and read the others.
    with warnings.catch_warnings(record=True) as doubts:
        warnings.simplefilter("always", ConfigWarning)
        described = body_from(values, _flag_of_body, in_si=True)
    for doubt in doubts:
        say(f"warning: {doubt.message}")
    return described


def _prepared(given: Given) -> PreparedRun:
    """Return the run of a body and a launch that options describe."""
    from rattlesweep.api.arrays import require_units
    from rattlesweep.api.single import LAUNCH_ARGUMENTS, prepare_launch

    described = _body_of(given)
    launch = pick(given, *LAUNCH_ARGUMENTS, "e_p0", "e_r0")
    times = {name: given.get(name) for name in ("dt", "from_time")}
    require_units(launch | times, described.units, _flag)
    if "omega" not in launch and "u" not in launch:
        launch = options.SPIN_DEFAULTS | launch
    try:
        return prepare_launch(described, **launch)
    except ConfigError as error:
        raise ConfigError(
            [_of_option(message, LAUNCH_ARGUMENTS) for message in error.messages]
        ) from None


def _of_option(message: str, arguments: Collection[str]) -> str:
    """Return a message about an argument of a call as one about its option."""
    name, colon, sentence = message.partition(": ")
    if name not in arguments:
        return message
    sentence = sentence.replace(f"leave {name} out", f"leave {_flag(name)} out")
    return f"{_flag(name)}{colon}{sentence}"


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
    from rattlesweep.api.single import rows_of

    rows = rows_of(run.units, **given)
    if section is not None:
        rows["section"] = Section.parse(section, run.model, run.units, needs_unit=True)
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
            say(f"warning: {course.warning}")
    if follower.status.label != "ok":
        say(f"the run failed: {follower.status.label}, {follower.status.meaning}")
        return SOME_FAILED
    return DONE


def _times(times: list[float], event: str) -> str:
    """Return how many events there are, with the first of their times."""
    if not times:
        return f"no {event}s"
    shown = ", ".join(f"{time:.10g}" for time in times[:MOST_TIMES])
    if len(times) > MOST_TIMES:
        shown += ", ..."
    return f"{counted(len(times), event)} at {shown}"


@command(
    "One run",
    "rattlesweep fit configs/fit/stone.yaml configs/fit/data.csv --figure fit.svg",
)
@options.path("stone")
@options.path("data", nargs=-1)
@option("--error", help="Standard error of the data, as in '0.5 deg'.")
@option(
    "--profile",
    metavar="NAME",
    help="Also fit at fixed values of this parameter; --figure then draws chi squared "
    "along it, not the data.",
)
@option(
    "--plan",
    metavar="TIME",
    help="Print the intervals to expect of a film of this length, as in '3 s', with "
    "the values and the error of STONE, by default 0.5 deg; without DATA.",
)
@option("--fps", type=float, default=120.0, help="Frames a second of --plan.")
@option("--robust", is_flag=True, help="Leave out rows that are far off all others.")
@options.figure
@options.as_json
@options.quiet
def fit(
    stone: Path,
    data: tuple[Path, ...],
    error: str | None,
    profile: str | None,
    plan: str | None,
    fps: float,
    figure: Path | None,
    robust: bool,
    as_json: bool,
    quiet: bool,
) -> int:
    """Fit parameters of a stone to an angle or spin from a video, or to reversal times.

    STONE is a YAML file with the keys body, launch, dissipation, free and error, in
    which measured values may have a standard error, as in 60 +- 1 g. DATA is a CSV or
    Parquet table with t_s and angle_deg or spin_rpm, or with reversal_s. Prints each
    free parameter with its 95 % interval, and correlations above 0.1. Exports of
    Tracker and phyphox are read as they are. Exits with 3 if the run does not follow
    the data. docs/fit.md explains both files.
    """
    from rattlesweep.analysis.fit.result import summary_of
    from rattlesweep.api.single import fit_films, fit_with_progress, plan_of_fit

    _check_films(data, plan, profile or figure)
    probe_files(figure)
    arguments = _read_stone(stone)
    if error is not None:
        arguments["error"] = error
    try:
        if plan is not None:
            planned = plan_of_fit(seconds=plan, fps=fps, **arguments)
            click.echo(_fit_report(planned, None))
            return DONE
        if len(data) > 1:
            with Bar.of_command(quiet) as bar:
                joint = fit_films(bar, data=data, robust=robust, **arguments)
            return _tell_of_films(joint, as_json, quiet)
        with Bar.of_command(quiet) as bar:
            best = fit_with_progress(bar, data=data[0], robust=robust, **arguments)
            table = None
            if profile is not None:
                table = best.profile(profile)
    except ConfigError as failure:
        raise ConfigError(
            [_placed(message, stone, data, error) for message in failure.messages]
        ) from None
    if as_json:
        click.echo(to_json(_fit_as_json(best, table)))
    else:
        click.echo(_fit_report(best, table))
    if figure is not None:
        if table is not None:
            best.plot_profile(table, figure)
        else:
            best.plot(figure)
    if not quiet:
        say(summary_of(best))
        for remark in best.remarks:
            say(f"warning: {remark}")
    if not best.means_something:
        return SOME_FAILED
    return DONE


def _check_films(
    data: tuple[Path, ...], plan: str | None, of_one: str | Path | None
) -> None:
    """Raise a ConfigError if there are too few or too many films."""
    if plan is None and not data:
        raise ConfigError("DATA is missing; give a table, or --plan '3 s'")
    if plan is not None and data:
        raise ConfigError("--plan needs no DATA; leave one out")
    if of_one is not None and len(data) != 1:
        raise ConfigError("--profile and --figure take one film; leave them out")


def _tell_of_films(joint: JointFit, as_json: bool, quiet: bool) -> int:
    """Print a fit of several films, and return the exit code."""
    if as_json:
        names = ["values", "intervals", "rows", "dof", "remarks"]
        data = {name: getattr(joint, name) for name in names}
        click.echo(to_json({**data, "covariance": joint.covariance.to_dict()}))
    else:
        click.echo(joint.table_as_text)
    if not quiet:
        for line in joint.lines_below:
            say(line)
    if not joint.means_something:
        return SOME_FAILED
    return DONE


def _placed(
    message: str, stone: Path, data: tuple[Path, ...], error: str | None
) -> str:
    """Return a message with the file or the option that it is about."""
    # Messages about the data begin with their path.
    if message.startswith(tuple(map(str, data))):
        return message
    option_of = message.partition(":")[0]
    if option_of == "profile" or (option_of == "error" and error is not None):
        return f"--{message}"
    return f"{stone}: {message}"


def _fit_report(best: Fit, profile: pd.DataFrame | None) -> str:
    from rattlesweep.analysis.fit.result import report_of

    report = report_of(best)
    if profile is not None:
        name = str(profile.columns[0])
        size, unit = best.unit_of(name)
        low, high = (size * end for end in profile.attrs["interval"])
        report += f"\nprofile of {name}: 95 % from {low:.5g} to {high:.5g} {unit}"
    return report


def _fit_as_json(best: Fit, profile: pd.DataFrame | None) -> dict[str, Any]:
    """Return a fit and a profile of it as JSON data."""
    names = [
        *("values", "intervals", "in_si", "noise", "noise_unit", "rows", "remarks"),
        *("dof", "chi_squared", "reduced_chi_squared"),
    ]
    data = {name: getattr(best, name) for name in names}
    for name in ("covariance", "correlations"):
        data[name] = getattr(best, name).to_dict()
    if profile is not None:
        data["profile"] = {**profile.to_dict("list"), **profile.attrs}
    return data


@command(
    "One run",
    "rattlesweep film STONE.yaml --fps 120 --noise '0.5 deg' --time '3 s' > film.csv",
)
@options.path("stone")
@option("--fps", type=float, default=120.0, help="Frames a second.")
@option("--noise", default="0.5 deg", help="Standard deviation of the angle.")
@option("--time", "seconds", default="3 s", help="Length of the film.")
@option("--seed", type=int, default=0, help="Seed of the noise.")
def film(stone: Path, fps: float, noise: str, seconds: str, seed: int) -> None:
    """Print a synthetic film of a stone: the angle of its long axis from above, as CSV.

    STONE is a stone file as for fit, with the values of launch and dissipation. Fit the
    film, or see fit --plan, to learn how well a real one would tell the friction.
    """
    from rattlesweep.api.single import film_of

    arguments = pick(_read_stone(stone), "body", "launch", *LOSSES)
    try:
        table = film_of(seconds=seconds, fps=fps, noise=noise, seed=seed, **arguments)
    except ConfigError as failure:
        raise ConfigError(
            [_placed(message, stone, (), None) for message in failure.messages]
        ) from None
    click.echo(table.to_csv(index=False), nl=False)


def _read_stone(path: Path) -> dict[str, Any]:
    """Return the arguments of :func:`rattlesweep.fit` in a YAML file."""
    from rattlesweep.analysis.fit.measured import measured_body, separate
    from rattlesweep.api.arrays import require_units
    from rattlesweep.design.config.read import checked, read_file
    from rattlesweep.design.config.schema import Stone

    data, places, problems = read_file(path)
    stone = checked(Stone, data, places, problems)
    losses = vars(stone.dissipation)
    section = "body"
    try:
        body = measured_body(stone.body, in_si=False)
        section = "launch"
        require_units(separate(stone.launch)[0], body.body.units)
        section = "dissipation"
        require_units(separate(losses)[0], body.body.units)
    except ConfigError as error:
        message = one_line(str(error), 300)
        raise ConfigError(places.line((section,), message)) from None
    return {
        "body": body,
        "free": stone.free,
        "launch": stone.launch,
        # As a text, whose number needs the unit of the data.
        "error": None if stone.error is None else str(stone.error),
        **losses,
    }
