"""Constants of the estimate of errors; ``benchmarks/errors.py`` fits them."""

from typing import NamedTuple

from rattlesweep.design.config.schema import Config
from rattlesweep.errors import ConfigError

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


FITS = {
    "dop853": ErrorFit(),
    "dopri5": ErrorFit(),
    "verner98": ErrorFit(floor=0.2),
    "rk4": ErrorFit(floor=0.0, share=0.003),
}
"""Constants by method; a method without them has no estimate."""
# Constants by surface and by law of friction, None for those of the method; those of a
# law count before those of a surface.  Others have no estimate.
SURFACE_FITS: dict[str, ErrorFit | None] = {
    "paraboloid": None,
    # Its large swings are harder to integrate.
    "ellipsoid": ErrorFit(slope=20.0, share=0.002),
}
LAW_FITS: dict[str, ErrorFit | None] = {
    "viscous": None,
    # Kinks lower the order of all methods, so a companion must be nearly as accurate as
    # the run.
    "rolling": ErrorFit(floor=5.0, slope=20.0, share=0.0015, power=0.3, looser=30.0),
    # Zeros and rests of the spin split the motion into smooth parts, but a zero that
    # only one of two runs has changes what follows.
    "pivoting": ErrorFit(slope=6.0, power=0.8, looser=100.0),
}
# Constants for a foot that slides, without a law or with a viscous couple.  The begin
# of a slide is known to a few 1e-12 at any tolerance.
SLIDING_FIT = ErrorFit(slope=8.0, looser=300.0, tightest=3.5e-12)


def fit_of(config: Config) -> ErrorFit:
    """Return the constants of a sweep; ConfigError for a method that has none."""
    method = config.integrator.method
    if method not in FITS:
        raise ConfigError(
            f"integrator.method: errors are not calibrated for {method}; leave out "
            f"record: [error] and accuracy, or use {' or '.join(FITS)}"
        )
    surface = config.bodies.bottom
    law = config.dissipation.law
    for name, known in ((surface, SURFACE_FITS), (law, LAW_FITS)):
        if name is not None and name not in known:
            raise _uncalibrated(name)
    rubs = config.dissipation.slides or law == "pivoting"
    if rubs and SURFACE_FITS[surface] is not None:
        raise _uncalibrated(f"{surface} with mu or pivot")
    if config.dissipation.slides and law not in (None, "viscous"):
        raise _uncalibrated(f"mu with the law {law}")
    of_law = None if law is None else LAW_FITS[law]
    if config.dissipation.slides:
        of_law = of_law or SLIDING_FIT
    return of_law or SURFACE_FITS[surface] or FITS[method]


def _uncalibrated(what: str) -> ConfigError:
    return ConfigError(
        f"record: errors are not calibrated for {what}; leave out error and accuracy"
    )
