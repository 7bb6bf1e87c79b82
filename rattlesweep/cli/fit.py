"""The command that fits a stone to measurements."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
from click import argument

from rattlesweep.cli import options
from rattlesweep.cli.options import command, probe, say, to_json
from rattlesweep.errors import ConfigError, one_line
from rattlesweep.text import align

if TYPE_CHECKING:
    from rattlesweep.analysis.fit import Fit
    from rattlesweep.physics.body import Rattleback

SECTIONS = {"body": dict, "free": list, "launch": dict, "dissipation": dict}


@command(
    "One run",
    "rattlesweep fit configs/fit/stone.yaml configs/fit/data.csv --figure fit.svg",
)
@argument("stone", type=click.Path(path_type=Path))
@argument("data", type=click.Path(path_type=Path))
@options.figure
@options.as_json
@options.quiet
def fit(stone: Path, data: Path, figure: Path | None, as_json: bool, quiet: bool) -> None:
    """Fit parameters of a stone to an angle or a spin of a video, or to reversal times.

    STONE is a YAML file with the keys body, launch, dissipation and free. DATA is a CSV or Parquet
    table with t_s and angle_deg or spin_rpm, or with reversal_s. Prints each free parameter with
    its 95 % interval. docs/fit.md explains both files.
    """
    from rattlesweep.api.fit import fit as fit_run

    probe(figure)
    arguments = read_stone(stone)
    try:
        found = fit_run(data=data, **arguments)
    except ConfigError as error:
        of_data = str(error).startswith(one_line(str(data), 200))
        raise ConfigError(str(error) if of_data else f"{stone}: {error}") from None
    if as_json:
        names = ("values", "intervals", "noise", "noise_unit", "rows", "remarks")
        click.echo(to_json({name: getattr(found, name) for name in names}))
    else:
        click.echo(_table(found))
    if figure is not None:
        found.plot(figure)
    if not quiet:
        say(f"{found.rows} rows, noise {found.noise:.3g} {found.noise_unit}")
        for remark in found.remarks:
            say(f"warning: {remark}")


def _table(found: Fit) -> str:
    """Return values and intervals, in SI units too where the body has a size."""
    from rattlesweep.analysis.fit import PARAMETERS

    sizes = {} if found.body.units is None else found.body.units.sizes
    lines: list[tuple[str, ...]] = [("", "value", "low", "high", "unit", "", "low", "high",
                                     "unit", "")]  # fmt: skip
    for name, value in found.values.items():
        known, numbers = PARAMETERS[name], (value, *found.intervals[name])
        size, unit = sizes.get(known.unit, (math.nan, ""))
        if known.unit == "sqrt(g/a)" and unit:
            size, unit = size * 30 / math.pi, "rpm"
        if known.unit == "rad":
            size, unit = 180 / math.pi, "deg"
        si = [f"{size * number:.5g}" if unit else "" for number in numbers]
        lines.append((name, *(f"{number:.6g}" for number in numbers), known.unit, *si, unit,
                      known.description))  # fmt: skip
    return align(lines, "<>>><>>><<")


def read_stone(path: Path) -> dict[str, Any]:
    """Return the arguments of :func:`rattlesweep.fit` in a YAML file."""
    from ruamel.yaml import YAML
    from ruamel.yaml.error import YAMLError

    file = one_line(str(path), 200)
    try:
        given = YAML(typ="safe", pure=True).load(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, YAMLError) as error:
        mark = getattr(error, "problem_mark", None)
        reason = getattr(error, "strerror", None) or getattr(error, "problem", None) or str(error)
        line = f":{mark.line + 1}" if mark else ""
        raise ConfigError(f"{file}{line}: {one_line(reason, 200)}") from None
    if not isinstance(given, dict) or not {"body", "free"} <= given.keys() <= SECTIONS.keys():
        raise ConfigError(f"{file}: the keys body and free are needed, and perhaps launch and "
                          "dissipation")  # fmt: skip
    for name, value in given.items():
        if not isinstance(value, SECTIONS[name]):
            wanted = "a list of names" if name == "free" else "lines of name: value"
            raise ConfigError(f"{file}: {name}: {wanted} is needed")
    losses = given.get("dissipation", {})
    if wrong := [str(name) for name in losses if name not in ("sigma", "rolling")]:
        raise ConfigError(f"{file}: dissipation: has sigma and rolling, and no {wrong[0]}")
    try:
        body = _body(given["body"])
    except (ValueError, TypeError, KeyError) as error:
        raise ConfigError(f"{file}: body: {error}") from None
    return {"body": body, "free": given["free"], "launch": given.get("launch"), **losses}


def _body(given: dict[str, Any]) -> Rattleback:
    from rattlesweep.physics.body import PRESETS, Rattleback

    if "xi_deg" in given:
        given["xi"] = math.radians(given.pop("xi_deg"))
    if "preset" in given:
        return PRESETS[given.pop("preset")]().replace(**given)
    if given.pop("shape", "") == "half_ellipsoid":
        return Rattleback.half_ellipsoid(**given)
    if "mass" in given:
        return Rattleback.from_si(**given)
    return Rattleback.shell_dumbbell(**given) if "f_sd" in given else Rattleback(**given)
