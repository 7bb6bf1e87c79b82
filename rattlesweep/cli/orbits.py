"""Commands for motions that return: single orbits, and their families."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from click import Choice, option

from rattlesweep.cli import options
from rattlesweep.cli.given import body_of, names_of_options, prepared_run
from rattlesweep.cli.options import command, flag, pick, probe_files, refuse, say, tell
from rattlesweep.words.defaults import (
    BRANCH_STEPS,
    MOST_SEARCHED,
    PERIODIC,
    SEARCH_SECTION,
)
from rattlesweep.words.errors import ConfigError
from rattlesweep.words.names import BRANCH_PARAMETERS

if TYPE_CHECKING:
    import pandas as pd

    from rattlesweep.analysis.orbits.orbit import Orbit

_START = ("omega", "u", "period", "energy", "symmetric")
_BODY_A = (
    "--alpha 7 --beta 3 --gamma 7 --theta 0.25 --phi 0.111111111 --xi -0.485 "
    "--omega 1.02,1.19,-0.28 --u -0.2898,-0.1618,-0.9433 --period 7.9 --energy 6.52"
)
_SHOWN = ["energy", "period", "n_mean", "kind", "modulus_1", "modulus_2", "modulus_3"]

period = options.group(
    (
        "--period",
        options.DURATION,
        "Period near the state of --omega and --u, roughly, in sqrt(a/g) or as in 2s.",
    ),
    (
        "--energy",
        options.ENERGY_VALUE,
        "Energy of the orbit, zero upright at rest, in M g a, or as in 0.5mJ.  "
        "[default: that of the state]",
    ),
)
rows_file = options.file(
    "--output", ".parquet", ".csv", help="Write a row for each orbit, .parquet or .csv."
)


@command(
    "One run",
    f"rattlesweep orbit {_BODY_A} --figure orbit.png",
    "rattlesweep orbit --preset GH --n-i -0.3 --omega-xy0 0.1 --t-end 2e4 --search",
    "rattlesweep orbit out/chart --search --output orbits.csv",
)
@options.path("directory", required=False)
@options.which
@options.body_options
@options.launch_options
@period
@option(
    "--symmetric",
    is_flag=True,
    default=None,
    help="Search an orbit that is at rest twice, half of --period apart, from --u.",
)
@option(
    "--search",
    is_flag=True,
    help="Search orbits near the end of a run instead: of the launch, or of runs of "
    "DIRECTORY.",
)
@option(
    "--section",
    metavar="CHANNEL=VALUE",
    default=SEARCH_SECTION,
    help="Section whose rows are compared by --search.",
)
@options.from_time
@option(
    "--most",
    type=options.COUNT,
    default=MOST_SEARCHED,
    help="Largest number of runs of DIRECTORY that are searched.",
)
@rows_file
@options.figure
@options.quiet
def orbit(
    directory: Path | None,
    search: bool,
    section: str,
    from_time: float | str | None,
    most: int,
    output: Path | None,
    figure: Path | None,
    quiet: bool,
    **given: Any,
) -> int:
    """Find a periodic orbit near a state, or the orbits near the end of runs.

    Prints the orbit with its multipliers, which tell whether it is stable. With
    --search, states that nearly return are the starts, of a launch or of the runs of
    DIRECTORY whose regime is periodic (`record: [spectrum]`; or --where). A motion that
    returns turned about the vertical is periodic, too. docs/orbits.md explains it.
    """
    from rattlesweep.analysis.orbits.tabulated import save_orbits, table_of_orbits

    probe_files(output, figure)
    which = pick(given, "case", "sample", "where")
    if search:
        found_by_search = pick(given, "period", "energy", "symmetric")
        refuse(found_by_search, "--search finds it; leave one of them out")
        table, orbits = _searched(directory, which, section, from_time, most, given)
        tell(*_lines(table))
    elif directory is not None or which or from_time is not None:
        raise ConfigError(
            "DIRECTORY, --where and --from-time belong to --search; add it"
        )
    else:
        orbits = [_orbit_of(given)]
        table = table_of_orbits(orbits)
        tell(*str(orbits[0]).splitlines())
    if output is not None:
        save_orbits(table, output)
    if figure is not None:
        if len(orbits) != 1:
            raise ConfigError(
                f"--figure: one orbit can be drawn, not {len(table)}; leave it out"
            )
        orbits[0].plot(figure)
    if search and not quiet:
        say(f"{len(table)} orbits; the state of each is in --output")
    return options.DONE


def _searched(
    directory: Path | None,
    which: dict[str, Any],
    section: str,
    from_time: float | str | None,
    most: int,
    given: dict[str, Any],
) -> tuple[pd.DataFrame, list[Orbit]]:
    """Return the orbits near a launch or near runs of a directory, as a table."""
    from rattlesweep.analysis.orbits.near_returns import orbits_near
    from rattlesweep.analysis.orbits.tabulated import table_of_orbits
    from rattlesweep.api.arguments import one_number
    from rattlesweep.api.sweeps import load

    if directory is None:
        if which:
            raise ConfigError("--case, --sample and --where choose runs of a DIRECTORY")
        given["from_time"] = from_time
        run = prepared_run(given)
        start = one_number("from_time", from_time, run.units)
        orbits = orbits_near(run, section, start)
        return table_of_orbits(orbits), orbits
    t_end = given.pop("t_end")
    refuse(given, "a stored run has its own; leave it out")
    where = which.get("where")
    if "case" in which or "sample" in which:
        keys = [
            f"{name} == {which[name]}" for name in ("case", "sample") if name in which
        ]
        where = " and ".join([*keys, *([f"({where})"] if where else [])])
    found = load(directory).find_orbits(
        where or PERIODIC, most=most, section=section, t_end=t_end
    )
    return found, []


def _orbit_of(given: dict[str, Any]) -> Orbit:
    """Return the orbit near the state that options give."""
    from rattlesweep.api.arguments import require_units
    from rattlesweep.api.orbits import orbit as find

    body = body_of(given)
    start = pick(given, *_START)
    require_units(start, body.units, flag)
    refuse(
        given,
        "an orbit begins at --omega, --u and --period, without friction; leave it out, "
        "or add --search",
    )
    with names_of_options(_START):
        return find(body, **start)


def _lines(table: pd.DataFrame) -> list[str]:
    """Return the lines of a table of orbits."""
    names = [name for name in ("case", "sample", *_SHOWN) if name in table]
    shown = table[names].head(options.PRINTED_ROWS)
    return shown.to_string(index=False, float_format="{:.8g}".format).splitlines()


@command(
    "One run",
    f"rattlesweep branch {_BODY_A} --to 6.3 --figure family.png --output family.csv",
)
@options.body_options
@options.group(
    ("--omega", options.VECTOR, "Angular velocity of a state near the orbit."),
    ("--u", options.VECTOR, "Its vertical unit vector."),
)
@period
@option(
    "--along",
    type=Choice(BRANCH_PARAMETERS),
    default="energy",
    help="What changes: the energy, or a parameter of the body at one energy.",
)
@option(
    "--to",
    type=options.ENERGY_VALUE,
    required=True,
    help="Value at which the branch ends; an energy of a body with a size has a unit.",
)
@option(
    "--steps", type=options.COUNT, default=BRANCH_STEPS, help="Largest number of steps."
)
@option(
    "--doubled",
    is_flag=True,
    help="Follow the orbit of twice the period from the first doubling instead, "
    "towards the same value.",
)
@option(
    "--y",
    metavar="COLUMN",
    default="period",
    help="Ordinate of the figure, such as n_mean.",
)
@rows_file
@options.figure
@options.quiet
def branch(
    along: str,
    to: float | str,
    steps: int,
    doubled: bool,
    y: str,
    output: Path | None,
    figure: Path | None,
    quiet: bool,
    **given: Any,
) -> int:
    """Follow the family of a periodic orbit along the energy or a parameter.

    The first orbit is near a state, as for `orbit`. The family is followed through
    folds, to a value or for some steps. Prints its special points: fold, doubling,
    torus, branching. docs/orbits.md explains them.
    """
    from rattlesweep.api.orbits import branch as follow

    probe_files(output, figure)
    first = _orbit_of(given)
    found = follow(first, along, to=to, steps=steps)
    if doubled:
        if not quiet:
            for line in str(found).splitlines():
                say(line)
        found = follow(found.doubled(), along, to=to, steps=steps)
    tell(*str(found).splitlines())
    if output is not None:
        found.save(output)
    if figure is not None:
        found.plot(figure, y=y)
    return options.DONE
