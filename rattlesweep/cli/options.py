"""Options that several commands have, each written once."""

from __future__ import annotations

import unicodedata
from collections.abc import Callable
from typing import Any, TypeVar

import click

C = TypeVar("C", bound=Callable[..., Any])


def _all(*options: Callable[[Any], Any]) -> Callable[[C], C]:
    """Several options as one decorator, in the order of `--help`."""

    def decorate(command: C) -> C:
        for option in reversed(options):
            command = option(command)
        return command

    return decorate


body_options = _all(
    click.option("--preset", metavar="NAME", help="A named body: GH (Garcia and Hubbard 1988)."),
    click.option("--alpha", type=float, help="I_xx + 1, in M a^2."),
    click.option("--beta", type=float, help="I_yy + 1, in M a^2."),
    click.option("--gamma", type=float, help="I_zz, in M a^2."),
    click.option(
        "--f-sd", type=float, help="I_yy/I_zz of a shell-dumbbell body; replaces alpha, beta."
    ),
    click.option("--theta", type=float, help="Larger principal curvature, in 1/a."),
    click.option("--phi", type=float, help="Smaller principal curvature, in 1/a."),
    click.option("--xi", type=float, help="Skew angle in radians."),
    click.option("--xi-deg", type=float, help="Skew angle in degrees."),
)
BODY = ("preset", "alpha", "beta", "gamma", "f_sd", "theta", "phi", "xi", "xi_deg")

spin_options = _all(
    click.option(
        "--n-i", type=float, default=0.1, show_default=True, help="Initial spin, in sqrt(g/a)."
    ),
    click.option(
        "--omega-xy0",
        type=float,
        default=0.01,
        show_default=True,
        help="Initial oscillation, in sqrt(g/a).",
    ),
)

psi_option = click.option(
    "--psi",
    default="relevant",
    show_default=True,
    metavar="DIRECTION",
    help="Direction of the oscillation: relevant, pitch, roll, or degrees.",
)

integrator_options = _all(
    click.option("--method", help="Integration method. [default: dop853]"),
    click.option("--tol", type=float, help="Tolerance of an adaptive method. [default: 1e-9]"),
    click.option("--dt-step", type=float, help="Step of a fixed-step method. [default: 0.002]"),
    click.option(
        "--accuracy",
        type=click.Choice(["draft", "standard", "reference"]),
        help="A named accuracy instead of a method and its tolerance.",
    ),
)

rows_options = _all(
    click.option(
        "--points",
        type=int,
        help="Number of rows, evenly spaced from 0 to the horizon. [default: 2001, or 20 per pitch "
        "period if that is more]",
    ),
    click.option("--dt", type=float, help="Spacing of the rows in time."),
    click.option("--steps", is_flag=True, help="One row per accepted step."),
    click.option(
        "--channels",
        default="t,n",
        show_default=True,
        metavar="A,B,...",
        help="Columns, and panels of the figure if given; 'list' prints all of them.",
    ),
)

which_options = _all(
    click.option("--case", type=int, help="Case of the run."),
    click.option("--sample", type=int, help="Sample of the run."),
    click.option(
        "--where",
        metavar="CONDITION",
        help="Select runs by their columns: = != < <= > >=, in (...), is null, and, or, not.",
    ),
)

title_option = click.option("--title", metavar="TEXT", help="Of the page or the picture.")


def check_title(title: str | None, *, formulas: bool = False) -> None:
    """Refuse a title that cannot be shown; ``formulas`` where Matplotlib reads it.

    Raises
    ------
    ConfigError
        It holds control characters or bytes that are no text, or a formula that cannot be read.
    """
    from rattlesweep.errors import ConfigError

    if title is None:
        return
    bad = next((c for c in title if unicodedata.category(c) in ("Cc", "Cs")), None)
    if bad is not None:
        what = "a control character" if unicodedata.category(bad) == "Cc" else "no text"
        raise ConfigError(f"--title: {ascii(bad)[1:-1]} in it is {what}; leave it out")
    if formulas:
        from rattlesweep.study.style import formula_error

        if (error := formula_error(title)) is not None:
            raise ConfigError(
                f"--title {title}: what stands between dollar signs cannot be read as a formula "
                f"({error}); write \\$ for a dollar sign"
            )


quiet_option = click.option(
    "-q", "--quiet", is_flag=True, help="No progress, closing line or warning."
)


def integrator_of(given: dict[str, Any]) -> dict[str, Any]:
    """Take the options of the integrator out of ``given``: the keys of a config's."""
    names = {"method": "method", "tol": "tol", "dt_step": "dt", "accuracy": "accuracy"}
    chosen = {key: given.pop(option) for option, key in names.items()}
    return {key: value for key, value in chosen.items() if value is not None}


def psi_of(text: str) -> str | float:
    """A direction by name, or in degrees."""
    try:
        return float(text)
    except ValueError:
        return text
