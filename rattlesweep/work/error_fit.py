"""Constants of the estimate of errors; ``benchmarks/errors.py`` fits them."""

from typing import NamedTuple

from rattlesweep.config.schema import Config
from rattlesweep.system.console import joined
from rattlesweep.words.errors import ConfigError
from rattlesweep.words.quantities import law_of

TIGHTEST = 1e-14  # tolerance below which rounding dominates the error of a step


class ErrorFit(NamedTuple):
    """Constants of the estimate."""

    floor: float = 0.5
    near: float = 10.0
    slope: float = 10.5
    share: float = 0.0007
    power: float = 1.0
    looser: float = 2e3  # ratio of the companion's tolerance to the run's
    tightest: float = TIGHTEST  # tolerance below which the floor does not fall
    slides: float = 0.0  # added for runs that slide, at any tolerance
    swings: float = 1.0  # of the spin, by which a zero may move that it only touches
    swinging: float = 1.0  # factor for launches that mostly swing


FITS = {
    "dop853": ErrorFit(),
    "dopri5": ErrorFit(),
    "verner98": ErrorFit(floor=0.2),
    "rk4": ErrorFit(floor=0.0, share=0.003),
}
"""Constants by method; a method without them has no estimate."""
# Kinks lower the order of all methods, so a companion must be nearly as accurate as the
# run.
_ROLLING = ErrorFit(floor=5.0, slope=20.0, share=0.0015, power=0.3, looser=30.0)
# Slides split the motion into smooth parts, but runs part at slides that only one has.
_SLIDING = ErrorFit(
    floor=0.3,
    near=5.0,
    slope=6.0,
    share=0.0015,
    power=0.9,
    looser=300.0,
    swinging=3.0,
)
# The patch of contact turns while it slides: the torque has kinks, and errors have any
# sign.
_PIVOTING_SLIDING = ErrorFit(
    floor=0.8,
    near=0.0,
    slope=8.0,
    share=0.0015,
    power=0.95,
    looser=30.0,
    slides=3.5e-12,
    swings=2.0,
    swinging=3.0,
)
_ROLLING_PIVOTING = ErrorFit(
    floor=5.0,
    near=0.0,
    slope=6.0,
    share=0.0015,
    power=0.8,
    looser=30.0,
    swings=2.0,
)
# Losses in proportion to what is lost, in the reduced model.
EXPONENTIAL = frozenset(["sigma", "viscous"])
MOTION_FITS: dict[tuple[str, str], ErrorFit | None] = {
    ("paraboloid", ""): None,
    # Its large swings are harder to integrate.
    ("ellipsoid", ""): ErrorFit(slope=20.0, share=0.002),
    ("paraboloid", "rolling"): _ROLLING,
    ("ellipsoid", "rolling"): _ROLLING,
    # Zeros and rests of the spin, and slides, split the motion into smooth parts, but a
    # zero that only one of two runs has changes what follows.
    ("paraboloid", "pivoting"): ErrorFit(slope=6.0, power=0.8, looser=100.0),
    ("ellipsoid", "pivoting"): ErrorFit(slope=8.0, looser=300.0),
    ("paraboloid", "sliding"): _SLIDING,
    ("ellipsoid", "sliding"): _SLIDING,
    ("paraboloid", "pivoting and sliding"): _PIVOTING_SLIDING,
    ("ellipsoid", "pivoting and sliding"): _PIVOTING_SLIDING._replace(
        floor=2.0, slope=14.0, slides=1.2e-11
    ),
    ("paraboloid", "rolling_pivoting"): _ROLLING_PIVOTING,
    ("ellipsoid", "rolling_pivoting"): _ROLLING_PIVOTING._replace(
        floor=6.0, slope=12.0, power=1.0
    ),
    ("reduced", "damped"): None,
}
"""Constants by surface and friction, None for those of the method.

A viscous couple changes nothing.  Others have no estimate: steps of slides do not see
the kinks of rolling resistance, and an estimate that covers the errors is too large.
"""


def fit_of(config: Config) -> ErrorFit:
    """Return the constants of a sweep; ConfigError where there are none."""
    method = config.integrator.method
    if method not in FITS:
        raise ConfigError(
            f"integrator.method: errors are not calibrated for {method}; leave out "
            f"record: [error] and accuracy, or use {' or '.join(FITS)}"
        )
    motion = fitted_motion(config)
    if motion not in MOTION_FITS:
        raise ConfigError(_refusal(config))
    return MOTION_FITS[motion] or FITS[method]


def fitted_motion(config: Config, without: str = "") -> tuple[str, str]:
    """Return the surface and the friction of a sweep, a key of `MOTION_FITS`.

    A constant of friction can be left out.  The reduced model has no surface.
    """
    names = [name for name in config.acting.present if name != without]
    if without == "base":
        names = config.dissipation.present
    if config.model == "reduced" and names:
        return "reduced", "damped" if EXPONENTIAL.issuperset(names) else law_of(names)
    law = law_of(names)
    parts = [law] if law not in ("", "viscous") else []
    if "mu" in names:
        parts.append("sliding")
    return config.bodies.bottom, " and ".join(parts)


def _refusal(config: Config) -> str:
    """Say that there are no constants for the surface and the friction of a sweep."""
    names = [name for name in config.dissipation.present if name != "sigma"]
    if config.acting.is_shaken:
        names.append("base")
    if config.model == "reduced":
        names = config.dissipation.present
    key = "record"
    asked = "error"
    if config.integrator.goal is not None:
        key = "integrator.accuracy"
        asked = "accuracy"
    what = config.bodies.bottom
    if config.model == "reduced":
        what = "the reduced model"
    if names:
        what += f" with {joined(names)}"
    removable = [asked]
    for name in names:
        if fitted_motion(config, without=name) in MOTION_FITS:
            removable.append(name)
    return (
        f"{key}: errors are not calibrated for {what}; leave out "
        f"{joined(removable, 'or')}"
    )
