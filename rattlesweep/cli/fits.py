"""Commands that fit a stone to films, and make such films."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
from click import option

from rattlesweep.cli import options
from rattlesweep.cli.given import messages_placed, read_stone
from rattlesweep.cli.options import (
    DONE,
    SOME_FAILED,
    command,
    pick,
    print_result,
    probe_files,
    say,
)
from rattlesweep.system.console import Bar
from rattlesweep.words.defaults import FILM_ERROR, FILM_RATE
from rattlesweep.words.errors import ConfigError
from rattlesweep.words.quantities import LOSSES

if TYPE_CHECKING:
    import pandas as pd

    from rattlesweep.analysis.fit.joint import JointFit
    from rattlesweep.analysis.fit.result import Fit


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
    f"the values and the error of STONE, by default {FILM_ERROR}; without DATA.",
)
@option("--fps", type=float, default=FILM_RATE, help="Frames a second of --plan.")
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

    STONE is a YAML file with the keys body, launch, dissipation, base, free and error,
    in which measured values may have a standard error, as in 60 +- 1 g. DATA is a CSV
    or Parquet table with t_s and angle_deg or spin_rpm, or with reversal_s. Prints each
    free parameter with its 95 % interval, and correlations above 0.1. Exports of
    Tracker, Kinovea, phyphox, Sensor Logger and others are read as they are. Exits with
    3 if the run does not follow the data. docs/fit.md explains both files.
    """
    from rattlesweep.analysis.fit.result import lines_below
    from rattlesweep.api.fits import fit_films, fit_with_progress, plan_of_fit

    _check_films(data, plan, profile, figure)
    probe_files(figure)
    arguments = read_stone(stone)
    if error is not None:
        arguments["error"] = error
    with messages_placed(stone, data, error):
        if plan is not None:
            planned = plan_of_fit(seconds=plan, fps=fps, **arguments)
            click.echo(_fit_report(planned, None))
            return DONE
        if len(data) > 1:
            with Bar.of_command(quiet) as bar:
                joint = fit_films(bar, data=data, robust=robust, **arguments)
            if figure is not None:
                joint.plot(figure)
            return _tell_of_films(joint, as_json, quiet)
        with Bar.of_command(quiet) as bar:
            best = fit_with_progress(bar, data=data[0], robust=robust, **arguments)
            table = None
            if profile is not None:
                table = best.profile(profile)
    print_result(as_json, _fit_as_json(best, table), _fit_report(best, table))
    if figure is not None:
        if table is not None:
            best.plot_profile(table, figure)
        else:
            best.plot(figure)
    if not quiet:
        for line in lines_below(best):
            say(line)
    if not best.means_something:
        return SOME_FAILED
    return DONE


def _check_films(
    data: tuple[Path, ...],
    plan: str | None,
    profile: str | None,
    figure: Path | None,
) -> None:
    """Raise a ConfigError if there are too few or too many films."""
    if plan is None and not data:
        raise ConfigError("DATA is missing; give a table, or --plan '3 s'")
    if plan is not None and data:
        raise ConfigError("--plan needs no DATA; leave one out")
    if profile is not None and len(data) != 1:
        raise ConfigError("--profile takes one film; leave it out, or give one film")
    if figure is not None and not data:
        raise ConfigError("--figure shows films, and a plan has none; leave it out")


def _tell_of_films(joint: JointFit, as_json: bool, quiet: bool) -> int:
    """Print a fit of several films, and return the exit code."""
    names = ["values", "intervals", "rows", "dof", "remarks"]
    data = {name: getattr(joint, name) for name in names}
    data["covariance"] = joint.covariance.to_dict()
    print_result(as_json, data, joint.table_as_text)
    if not quiet:
        for line in joint.lines_below:
            say(line)
    if not joint.means_something:
        return SOME_FAILED
    return DONE


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
    data["advised"] = None
    if best.advised is not None:
        data["advised"] = {
            "omega_xy0": best.push,
            "values": best.advised.values,
            "intervals": best.advised.intervals,
            "in_si": best.advised.in_si,
        }
    if profile is not None:
        data["profile"] = {**profile.to_dict("list"), **profile.attrs}
    return data


@command(
    "One run",
    "rattlesweep film STONE.yaml --fps 120 --error '0.5 deg' --time '3 s' > film.csv",
)
@options.path("stone")
@option("--fps", type=float, default=FILM_RATE, help="Frames a second.")
@option("--error", default=FILM_ERROR, help="Standard error of the angles, as of fit.")
@option("--noise", hidden=True, help="The earlier name of --error.")
@option("--time", "seconds", default="3 s", help="Length of the film.")
@option("--seed", type=int, default=0, help="Seed of the noise.")
def film(
    stone: Path, fps: float, error: str, noise: str | None, seconds: str, seed: int
) -> None:
    """Print a synthetic film of a stone: the angle of its long axis from above, as CSV.

    STONE is a stone file as for fit, with the values of launch, dissipation and base.
    Fit the film, or see fit --plan, to learn how well a real one would tell the
    friction.
    """
    from rattlesweep.api.fits import film_of

    if noise is not None:
        error = noise
    arguments = pick(read_stone(stone), "body", "launch", "base", *LOSSES)
    with messages_placed(stone):
        table = film_of(seconds=seconds, fps=fps, error=error, seed=seed, **arguments)
    click.echo(table.to_csv(index=False), nl=False)
