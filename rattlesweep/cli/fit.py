"""The command that fits a stone to measurements."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
from click import argument

from rattlesweep.cli import options
from rattlesweep.cli.command import command, probe, say, to_json
from rattlesweep.errors import ConfigError, one_line
from rattlesweep.text import align

if TYPE_CHECKING:
    from rattlesweep.analysis.fit import Fit
    from rattlesweep.physics.body import Rattleback
    from rattlesweep.sweeps.config.messages import Places

SECTIONS, LOSSES = ("body", "launch", "dissipation", "free"), ("sigma", "rolling")


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
    arguments, places = read_stone(stone)
    try:
        found = fit_run(data=data, **arguments)
    except ConfigError as error:
        name, _, sentence = str(error).partition(": ")
        key = ("dissipation", name) if name in LOSSES else tuple(name.split("."))
        if key[0] not in SECTIONS:
            raise
        raise ConfigError(places.line(key, sentence)) from None
    if as_json:
        intervals = {name: list(ends) for name, ends in found.intervals.items()}
        click.echo(to_json({"values": found.values, "intervals": intervals, "noise": found.noise,
                            "noise_unit": found.noise_unit, "rows": found.rows,
                            "remarks": found.remarks}))  # fmt: skip
    else:
        click.echo(_table(found))
    if figure is not None:
        found.plot(figure)
    if not quiet:
        say(f"{found.rows} rows, noise {found.noise:.3g} {found.noise_unit}")
        for remark in found.remarks:
            say(f"warning: {remark}")


def _table(found: Fit) -> str:
    """Return values and intervals, in SI units too where the body has some."""
    from rattlesweep.analysis.fit import PARAMETERS

    sizes = {} if found.body.units is None else found.body.units.sizes
    lines = [("", "value", "low", "high", "unit", "", "low", "high", "unit", "")]
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


def read_stone(path: Path) -> tuple[dict[str, Any], Places]:
    """Return the arguments of :func:`rattlesweep.fit` in a YAML file, and the lines of its keys."""
    from rattlesweep.sweeps.config.messages import Places, not_one_of
    from rattlesweep.sweeps.config.read import read_yaml

    file = one_line(str(path), 200)
    try:
        stone, lines, problems = read_yaml(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or "is not UTF-8 text"
        raise ConfigError(f"{file}: {reason}; give the YAML file of a stone") from None
    if problems:
        raise ConfigError(f"{file}:{problems[0][0]}: {problems[0][2]}")
    places = Places(file, {(): 1, **lines})
    if not isinstance(stone, dict) or not {"body", "free"} <= stone.keys():
        raise ConfigError(f"{file}:1: the keys body and free are needed, and perhaps launch and "
                          "dissipation")  # fmt: skip
    for name, value in stone.items():
        if name not in SECTIONS:
            raise ConfigError(places.line((name,), not_one_of(name, SECTIONS)))
        if not isinstance(value, dict) and (name != "free" or not isinstance(value, list)):
            raise ConfigError(places.line((name,), "lines of key: value are needed"))
    losses = stone.get("dissipation", {})
    for name in losses.keys() - set(LOSSES):
        raise ConfigError(places.line(("dissipation", name), not_one_of(name, LOSSES)))
    try:
        body = _body(dict(stone["body"]))
    except (ValueError, TypeError) as error:
        raise ConfigError(places.line(("body",), str(error))) from None
    return {"body": body, "free": stone["free"], "launch": stone.get("launch")} | losses, places


def _body(given: dict[str, Any]) -> Rattleback:
    """Return a body from the keys of a file."""
    from rattlesweep.physics.body import PRESETS, Rattleback
    from rattlesweep.sweeps.config.messages import not_one_of

    if "xi_deg" in given:
        given["xi"] = math.radians(given.pop("xi_deg"))
    for key, choices in (("preset", [*PRESETS]), ("shape", ["half_ellipsoid"])):
        if key in given and given[key] not in choices:
            raise ValueError(f"{key}: {not_one_of(given[key], choices)}")
    if "preset" in given:
        return PRESETS[given.pop("preset")]().replace(**given)
    if given.pop("shape", None):
        return Rattleback.half_ellipsoid(**given)
    if "mass" in given:
        return Rattleback.from_si(**given)
    return Rattleback.shell_dumbbell(**given) if "f_sd" in given else Rattleback(**given)
