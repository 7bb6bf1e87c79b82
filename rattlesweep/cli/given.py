"""Bodies, stones and launches that options and files describe."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rattlesweep.cli import options
from rattlesweep.cli.options import Given, flag, pick, refuse, warn
from rattlesweep.words.errors import ConfigError, ConfigWarning, one_line

if TYPE_CHECKING:
    from rattlesweep.analysis.onerun.course import PreparedRun
    from rattlesweep.physics.body import Rattleback


def flag_of_body(name: str) -> str:
    """Return the option of a quantity of a body; --points are those of a trajectory."""
    return flag("mass_points" if name == "points" else name)


def body_of(given: Given) -> Rattleback:
    """Return the body that the options of a command describe."""
    from rattlesweep.design.bodies.making import body_from
    from rattlesweep.words.units import require_unit

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
    with doubts_said():
        return body_from(values, flag_of_body)


@contextmanager
def doubts_said() -> Iterator[None]:
    """Print warnings about a body as warnings of the command."""
    with warnings.catch_warnings(record=True) as doubts:
        warnings.simplefilter("always", ConfigWarning)
        yield
    for doubt in doubts:
        warn(str(doubt.message))


def prepared_run(given: Given) -> PreparedRun:
    """Return the run of a body and a launch that options describe."""
    from rattlesweep.api.arguments import require_units
    from rattlesweep.api.single import LAUNCH_ARGUMENTS, prepare_launch

    described = body_of(given)
    launch = pick(given, *LAUNCH_ARGUMENTS, "e_p0", "e_r0")
    times = {name: given.get(name) for name in ("dt", "from_time")}
    require_units(launch | times, described.units, flag)
    if "omega" not in launch and "u" not in launch:
        launch = options.SPIN_DEFAULTS | launch
    with names_of_options(LAUNCH_ARGUMENTS):
        return prepare_launch(described, **launch)


def run_of_stone(path: Path, given: Given) -> PreparedRun:
    """Return the run of a stone file, with the launch that options replace."""
    from rattlesweep.api.arguments import require_units
    from rattlesweep.api.single import LAUNCH_ARGUMENTS

    for name in pick(given, *options.BODY):
        raise ConfigError(
            f"{flag_of_body(name)}: a stone file has its own; leave it out"
        )
    stone = read_stone(path)
    launch = pick(given, *LAUNCH_ARGUMENTS)
    require_units(launch, stone["body"].body.units, flag)
    with messages_placed(path):
        return prepare_stone(stone, options.SPIN_DEFAULTS, launch)


def prepare_stone(
    stone: Mapping[str, Any], defaults: Mapping[str, Any], launch: Mapping[str, Any]
) -> PreparedRun:
    """Return the run of a stone file, as :func:`read_stone` has it, with its values.

    Standard errors are left out.  What is in `launch` replaces the values of the file,
    and `defaults` stand for a spin or an oscillation that neither has.
    """
    from rattlesweep.analysis.fit.measured import separate
    from rattlesweep.api.single import LAUNCH_ARGUMENTS, prepare_launch
    from rattlesweep.words.quantities import LOSSES

    losses = {name: stone[name] for name in LOSSES if stone.get(name) is not None}
    values, _ = separate({**stone["launch"], **losses})
    values = {name: values[name] for name in values if name in LAUNCH_ARGUMENTS}
    values["base"] = stone.get("base")
    values |= launch
    if "omega" not in values:
        values = {**defaults, **values}
    return prepare_launch(stone["body"].body, **values)


@contextmanager
def messages_as(changed: Callable[[str], str]) -> Iterator[None]:
    """Change the messages of a ConfigError."""
    try:
        yield
    except ConfigError as error:
        raise ConfigError(map(changed, error.messages)) from None


def names_of_options(arguments: Collection[str]) -> AbstractContextManager[None]:
    """Let messages about arguments of a call be about their options."""

    def of_option(message: str) -> str:
        name, colon, sentence = message.partition(": ")
        if name not in arguments:
            return message
        sentence = sentence.replace(f"leave {name} out", f"leave {flag(name)} out")
        return f"{flag(name)}{colon}{sentence}"

    return messages_as(of_option)


def messages_placed(
    stone: Path, data: Sequence[Path] = (), error: str | None = None
) -> AbstractContextManager[None]:
    """Put the file or the option in front of messages that they are about."""

    def placed(message: str) -> str:
        # Messages about the data begin with their path.
        if message.startswith(tuple(map(str, data))):
            return message
        option_of = message.partition(":")[0]
        if option_of == "profile" or (option_of == "error" and error is not None):
            return f"--{message}"
        return f"{stone}: {message}"

    return messages_as(placed)


def stone_or_options(path: Path | None, given: Given) -> dict[str, Any]:
    """Return what a stone file says, or the body that options describe instead."""
    from rattlesweep.analysis.fit.measured import MeasuredBody

    if path is None:
        return {"body": MeasuredBody(body_of(given))}
    refuse(given, "STONE has its own body; leave it out")
    return read_stone(path)


def read_stone(path: Path) -> dict[str, Any]:
    """Return the arguments of :func:`rattlesweep.fit` in a YAML file."""
    from rattlesweep.analysis.fit.measured import measured_body, separate
    from rattlesweep.api.arguments import columns_of_base, require_units
    from rattlesweep.config.read import checked, read_file
    from rattlesweep.config.schema import Stone

    data, places, problems = read_file(path)
    if "bodies" in data and "body" not in data:
        raise ConfigError(
            f"{path}: is the config of a sweep, which run takes; a stone file has body "
            "and launch (docs/fit.md)"
        )
    stone = checked(Stone, data, places, problems)
    # What is not given may have another default than none (creep).
    losses = stone.dissipation.model_dump(exclude_unset=True)  # type: ignore[attr-defined]
    section = "body"
    try:
        with doubts_said():
            body = measured_body(stone.body)
        section = "launch"
        require_units(separate(stone.launch)[0], body.body.units)
        section = "dissipation"
        require_units(separate(losses)[0], body.body.units)
        section = "base"
        if stone.base is not None:
            columns_of_base(stone.base, body.body.units)
    except ConfigError as error:
        message = one_line(str(error), 300)
        raise ConfigError(places.line((section,), message)) from None
    return {
        "body": body,
        "free": stone.free,
        "launch": stone.launch,
        "base": stone.base,
        # As a text, whose number needs the unit of the data.
        "error": None if stone.error is None else str(stone.error),
        **losses,
    }
