"""What is wrong with measured data, or doubtful in a fit of them, in sentences.

A sentence says what is seen and what to try.  A mistake that is certain is a
ConfigError before the search; a doubt is a remark of the fit.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from rattlesweep.analysis.fit.film import BARE, FAST, Film
from rattlesweep.arrays import Floats, Places
from rattlesweep.words.errors import ConfigError

if TYPE_CHECKING:
    from rattlesweep.analysis.fit.problem import FitProblem
    from rattlesweep.physics.si import Units

# Residuals above which a model does not follow the data: in angle, and in any other
# quantity as a share of the largest value measured.
LARGE_ANGLE = math.radians(20)
LARGE_SHARE = 0.3
# Residuals over the noise from frame to frame, above which another valley may be lower.
MUCH_NOISE = 1.4
LONGEST_GAP = 0.5  # seconds without an angle; in a longer gap half a turn may get lost
# Most by which the ratio of two spins may miss the factor of a wrong unit, as a factor.
CLEAR = 1.5
# Most by which two times of a first reversal may differ, as a factor.
_AROUND = 3.0
SLOWEST_DECAY = math.radians(
    20
)  # spin of a film in 1/s, below which nobody films a stone
# A spin against the launch is noise up to this share of the launch's spin.
TURNING = 0.2
# Kolmogorov's limit, which one in 1000 sets of independent residuals exceeds.
SLOW = 1.86
# Times that are met worse than by so many units of their last digit are doubtful.
COARSE = 10.0
MOST_DIGITS = 6  # of times, in their unit
INEXACT = 1e-5  # error of the integration as a share of the largest time, at most
ALIKE = 0.99  # correlation of two estimates above which the data cannot separate them
# A value is hardly known if its interval's half width is above this share of it.
VAGUE = 0.5
# A measured value that the data move by more than so many standard errors is doubtful.
_FAR = 3.0
UNLIKELY = 1e-3  # probability of chi squared below which the errors are doubtful
MEANINGLESS = "the values mean nothing"
# A row is far off if its residual is so many times that of most rows.  Rows that are
# more than a share of all are no outliers.
OUTLYING = 6.0
MOST_PULLED = 3.0  # residuals of the others over the noise from row to row
FEW = 0.05
_FEWEST_ROWS = 20  # in which a row can be far off
_MOST_NAMED = 10
# Singular values of a Jacobian below this are errors of its finite differences.
SINGULAR = 1e-6


class Mistake(NamedTuple):
    """A column in another unit than its name says, and how that shows."""

    factor: float  # first spin of the data, as read, over that of the launch
    column: str  # the column of the wrong unit, "t" or "value"
    unit: str  # the unit in the column's name
    true_unit: str


MISTAKES = (
    Mistake(math.pi / 180, "value", "deg", "rad"),
    Mistake(180 / math.pi, "value", "rad", "deg"),
    Mistake(math.pi / 30, "value", "rpm", "rad_s"),
    Mistake(1e-3, "t", "s", "ms"),
    Mistake(1e3, "t", "ms", "s"),
)


def check_film(film: Film, n_i: float | None, units: Units | None) -> None:
    """Raise a ConfigError if the data have a wrong unit or a wrong direction.

    `n_i` is the spin of the launch in units of the body, None if it is not known.
    """
    if film.kind == "reversal":
        return
    _check_folded_radians(film)
    _check_spacing(film, units)
    # A launch without spin gives nothing to compare with.
    if n_i:
        _check_first_spin(film, n_i, units)


def _check_folded_radians(film: Film) -> None:
    """Raise if "degrees" jump by about pi or 2 pi, as radians do after a turn."""
    if film.kind != "angle" or film.value_column.unit.name != "deg":
        return
    # In degrees again, as in the column.
    degrees = np.degrees(film.value[film.known])
    steps = np.diff(degrees)
    if len(steps) == 0 or np.ptp(degrees) > 1.01 * math.tau:
        return
    # The stone's own step is part of the difference, which may so be less than pi.
    is_jump = np.abs(steps) > 0.8 * math.pi
    is_smooth_elsewhere = np.abs(np.median(steps)) < 0.5
    if is_jump.any() and is_smooth_elsewhere:
        name = film.value_column.name
        raise ConfigError(
            f"{film.source}: {name} stays between {degrees.min():.3g} and "
            f"{degrees.max():.3g} and jumps by {np.abs(steps).max():.3g}, as angles in "
            f"radians do; if they are, name the column angle_rad"
        )


def _check_spacing(film: Film, units: Units | None) -> None:
    """Raise if most angles are so far apart that half turns get lost between them."""
    if film.kind != "angle" or units is None:
        return
    spacing = float(np.median(np.diff(film.t))) * units.time
    if spacing > LONGEST_GAP:
        column = film.t_column
        raise ConfigError(
            f"{film.source}: by {column.name} the rows are {spacing:.3g} s apart, and "
            f"half a turn may get lost between angles {LONGEST_GAP} s apart; if the "
            f"times are in ms, name the column t_ms"
        )


def _check_first_spin(film: Film, n_i: float, units: Units | None) -> None:
    """Raise if the data begin with a spin that a wrong unit or direction explains."""
    first_spin = _typical_spin(film)
    measured = spin_text(first_spin, units)
    launched = spin_text(n_i, units)
    name = film.value_column.name
    for mistake in MISTAKES:
        column = film.t_column if mistake.column == "t" else film.value_column
        # The direction may be wrong as well, so only the size is compared.
        misfit = abs(first_spin / n_i / mistake.factor)
        if column.unit.name == mistake.unit and 1 / CLEAR < misfit < CLEAR:
            quantity = column.name.partition("_")[0]
            raise ConfigError(
                f"{film.source}: {name} begins with a spin of {measured}, and n_i is "
                f"{launched}; if {column.name} is in {mistake.true_unit}, name it "
                f"{quantity}_{mistake.true_unit}"
            )
    if first_spin * n_i < 0 and abs(first_spin) > TURNING * abs(n_i):
        raise ConfigError(
            f"{film.source}: {name} begins with a spin of {measured}, and n_i is "
            f"{launched}, the other way; angles are counterclockwise seen from above, "
            "so change their sign (rows of an image count downward, which turns them) "
            "or that of n_i"
        )


def _typical_spin(film: Film) -> float:
    """Return the spin of the first rows, whether or not their angles jump."""
    if film.kind != "angle":
        return film.first_spin
    rows = film.first_rows
    # The median ignores a few jumps, which would tilt a fitted line.
    return float(np.median(np.diff(film.value[rows]) / np.diff(film.t[rows])))


def spin_text(spin: float, units: Units | None) -> str:
    """Return a spin in rpm, or in units of a body without a size."""
    if units is None:
        return f"{spin:.3g} {BARE['n']}"
    return f"{30 / math.pi * spin / units.time:.3g} rpm"


def check_first_reversal(problem: FitProblem, start: Floats) -> None:
    """Raise if a run reverses about a thousand times sooner than the data.

    The times of the data are then likely to be in ms. `start` are the first values of
    the parameters, with which the run is made.
    """
    film = problem.film
    unit = film.value_column.unit
    if unit.name == "ms":
        return
    # The run ends soon after the first time read as ms: if the data are in ms, a run to
    # that many seconds would be very long.
    launch = replace(problem.launch, t_end=_AROUND * float(film.t[0]) / 1000)
    short = replace(problem, launch=launch, film=replace(film, t=film.t[:1]))
    if not short.succeeds(start):
        return
    first = float(short.expected(start)[0])
    reverses = first < (launch.t_end or 0.0)  # a run without a reversal gives its end
    if reverses and first > film.t[0] / 1000 / _AROUND:
        raise ConfigError(
            f"{film.source}: {film.value_column.name} begins with "
            f"{film.t[0] / unit.size:.4g} {unit.name}, and a run with the first values "
            f"reverses after {first / unit.size:.3g} {unit.name}; if the times are in "
            "ms, name the column reversal_ms"
        )


def doubts_of_data(
    film: Film, units: Units | None, n_i: float | None = None
) -> list[str]:
    """Return remarks on what may be wrong with data, whatever the fit is.

    `n_i` is the spin that is given of the launch, None if it is not.
    """
    remarks = [*film.notes]
    if film.kind == "angle" and film.turn_a_row > FAST:
        remarks.append(_of_fast_turns(film, units, n_i))
    if film.kind == "angle" and film.value_column.unit.name == "deg":
        span = float(np.ptp(np.degrees(film.value[film.known])))
        is_slow = units is not None and film.largest_spin / units.time < SLOWEST_DECAY
        if span < math.tau:
            remarks.append(
                f"all angles are within {span:.3g} degrees; if they are in radians, "
                "name the column angle_rad"
            )
        elif is_slow and not n_i:
            largest = spin_text(film.largest_spin, units)
            remarks.append(
                f"the stone never turns faster than {largest}; if the angles are in "
                "radians, name the column angle_rad"
            )
    if film.kind == "angle" and units is not None:
        seconds = film.t[film.known] * units.time
        gaps = np.diff(seconds)
        if gaps.max() > LONGEST_GAP:
            widest = int(gaps.argmax())
            before = seconds[widest]
            after = seconds[widest + 1]
            remarks.append(
                f"there is no angle between {before:.4g} and {after:.4g} s, and half a "
                f"turn may get lost in {gaps[widest]:.3g} s; fill in angles so that "
                f"gaps are below {LONGEST_GAP} s, or fit the rows on one side"
            )
    return remarks


def _of_fast_turns(film: Film, units: Units | None, n_i: float | None) -> str:
    """Return the remark on an axis that nearly turns by half a turn between rows."""
    turned = math.degrees(film.turn_a_row)
    half_turn = spin_text(math.pi / float(np.median(np.diff(film.t))), units)
    origin = f"n_i tells the spin of {spin_text(film.first_spin, units)}"
    if n_i is None:
        origin = "give n_i, which tells the right one"
    return (
        f"the axis turns by {turned:.3g} degrees from row to row, and spins that "
        f"differ by {half_turn} look alike in such a film: {origin}; film at more "
        "frames a second"
    )


def doubts_of_residuals(film: Film, residuals: Floats, noise: float) -> list[str]:
    """Return remarks on large or correlated residuals; `noise` is their usual size."""
    unit = film.value_column.unit
    largest_noise = LARGE_ANGLE
    if film.kind != "angle":
        largest_noise = LARGE_SHARE * float(np.nanmax(np.abs(film.value)))
    if noise > largest_noise:
        return [
            f"the residuals are {noise / unit.size:.3g} {unit.name}: the model does "
            "not follow the data, or the search has ended in a worse valley of chi "
            f"squared, and {MEANINGLESS}; look at the figure, and "
            "try the other sign of the angles or of the skew, a launch nearer to the "
            "data, and the data up to the first reversal"
        ]
    if film.kind == "reversal" or is_noise(residuals):
        return []
    if noise > film.rough_noise:
        return [
            f"the residuals are {noise / unit.size:.3g} {unit.name}, and the noise "
            f"from row to row is {film.rough_noise / unit.size:.2g} {unit.name}: the "
            "search has ended in a worse valley of chi squared, or the model does not "
            "describe the data; give a launch nearer to the data, or free fewer "
            "parameters"
        ]
    return [
        "neighbouring residuals are correlated: the model does not describe the data "
        "within their noise, or they were smoothed, and the intervals are too narrow"
    ]


def outliers_of(film: Film, residuals: Floats) -> Places:
    """Return the places of residuals that are far off all others.

    There are none where most residuals are larger than the noise from row to row, as
    those of a worse valley are.  Residuals are in units of the film.
    """
    none = np.zeros(0, int)
    if film.kind == "reversal" or len(residuals) < _FEWEST_ROWS:
        return none
    # In a short film one row moves the first direction, and so all residuals.
    residuals = residuals - np.median(residuals)
    # The median of |x| of a normal variable.
    usual = float(np.median(np.abs(residuals))) / 0.6745
    if usual > MOST_PULLED * film.rough_noise:
        return none
    least = OUTLYING * max(usual, film.rough_noise)
    places = np.flatnonzero(np.abs(residuals) > least)
    if len(places) > max(1.0, FEW * len(residuals)):
        return none
    return places


def doubts_of_outliers(
    film: Film, residuals: Floats, places: Places, are_left_out: bool
) -> list[str]:
    """Return the remark on rows that are far off; residuals are those of `places`."""
    if not len(places):
        return []
    size = film.value_column.unit.size
    numbers = (np.flatnonzero(film.known)[places] + 1).tolist()
    worst = int(np.argmax(np.abs(residuals)))
    off = f"{abs(residuals[worst]) / size:.3g} {film.value_column.unit.name}"
    listed = ", ".join(map(str, numbers[:_MOST_NAMED]))
    if len(numbers) > _MOST_NAMED:
        listed += ", ..."
    rows = f"row {listed} is"
    if len(numbers) > 1:
        rows = f"rows {listed} are"
    if are_left_out:
        return [f"{rows} off by up to {off} and left out"]
    return [
        f"{rows} off by up to {off}, far more than all others, and the noise is too "
        "large: correct the cells or empty them, or leave the rows out (--robust)"
    ]


def is_noise(residuals: Floats) -> bool:
    """Return whether residuals have no more slow changes than independent ones.

    The share of their power up to a frequency grows like a straight line (Bartlett's
    test), also where single neighbours are hardly correlated.
    """
    power = np.abs(np.fft.rfft(residuals - residuals.mean())[1:]) ** 2
    total = float(power.sum())
    if total == 0.0:
        return True
    even = np.arange(1, len(power) + 1) / len(power)
    excess = float((np.cumsum(power) / total - even).max())
    return excess * math.sqrt(len(power)) < SLOW


def doubts_of_exact_times(film: Film, noise: float) -> list[str]:
    """Return the remark on times that are met far worse than they are written."""
    if film.error is not None or noise < INEXACT * film.size:
        return []
    unit = film.value_column.unit
    times = film.value / unit.size
    digits = next(
        (
            digits
            for digits in range(MOST_DIGITS)
            if np.allclose(times, times.round(digits), rtol=0, atol=10.0**-MOST_DIGITS)
        ),
        MOST_DIGITS,
    )
    written = 10.0**-digits
    if noise / unit.size < COARSE * written:
        return []
    return [
        f"the times are written to {written:.1g} {unit.name} and met within "
        f"{noise / unit.size:.2g} {unit.name}: this may be a worse valley than the "
        "true one; give a launch nearer to the data, or the error of the times if they "
        "are less exact"
    ]


def doubts_of_priors(problem: FitProblem, pulls: Floats) -> list[str]:
    """Return remarks on measured values that the data contradict.

    `pulls` are the residuals of the priors, in standard errors.
    """
    return [
        f"the data move {name} by {abs(pull):.2g} standard errors from the measured "
        "value: measure it again, or the model does not describe the data"
        for name, pull in zip(problem.priors, pulls, strict=True)
        if abs(pull) > _FAR
    ]


def doubts_of_errors(chi_squared: float, freedom: int) -> list[str]:
    """Return remarks on standard errors that the residuals contradict."""
    from scipy.special import chdtr, chdtrc

    if freedom < 1:
        return []
    as_small = chdtr(freedom, chi_squared)
    as_large = chdtrc(freedom, chi_squared)
    if min(as_small, as_large) > UNLIKELY:
        return []
    if chi_squared > freedom:
        reason = "the errors are too small, or the model does not describe the data"
    else:
        reason = "the errors are too large"
    return [
        f"chi squared per degree of freedom is {chi_squared / freedom:.3g}: {reason}"
    ]


def doubts_of_parameters(
    problem: FitProblem,
    x: Floats,
    half_width: Floats,
    jacobian: Floats,
    push: str | None = None,
) -> list[str]:
    """Return the remark on the parameters that the data hardly determine, if any.

    The arguments are those of :func:`untold`, and a `push` that is advised.
    """
    alike, vague = untold(problem, x, half_width, jacobian)
    told = []
    if alike:
        told.append(f"cannot tell {_listed(alike)} apart")
    if vague:
        told.append(f"hardly tell {_listed(vague)}")
    if not told:
        return []
    if "omega_xy0" in (*alike, *vague) and "omega_xy0" not in problem.priors:
        # Without a push that shows, nothing else of the stone does.
        return [
            f"the data hardly show an oscillation, and {', and '.join(told)}: give "
            f"the push with an error, as in omega_xy0: {push or '8 +- 2 rpm'}, or film "
            "longer"
        ]
    return [
        f"the data {', and '.join(told)}: measure what you can otherwise and give it "
        "with its error, as in 60 +- 1 g, since a value without an error makes the "
        "other intervals too narrow"
    ]


def untold(
    problem: FitProblem, x: Floats, half_width: Floats, jacobian: Floats
) -> tuple[list[str], list[str]]:
    """Return the parameters that are not told apart, and others that are hardly told.

    `x` are their values, and `half_width` those of the intervals. The columns of
    `jacobian` have length 1.
    """
    names = list(problem.scales)
    spread, weakest, smallest = directions_of(jacobian)
    lengths = np.linalg.norm(spread, axis=1)
    # The absolute error of a logarithm is the relative error of its number.
    logarithmic = np.array([name == "omega_xy0" for name in names])
    sizes = np.where(logarithmic, 1.0, np.abs(x))
    # Written as a negation, since a half width of NaN is vague as well.
    vague = ~(half_width <= VAGUE * sizes)
    if smallest < SINGULAR:
        vague |= np.abs(weakest) > 0.1
    # What was measured may be as vague as it was measured.
    vague &= [name not in problem.priors for name in names]
    alike = np.abs(spread @ spread.T) > ALIKE * np.outer(lengths, lengths)
    # Two estimates that go together are harmless as long as both are well known.
    is_pair = alike & (vague | vague[:, None])
    np.fill_diagonal(is_pair, False)
    paired = is_pair.any(axis=1)
    return (
        [names[i] for i in np.flatnonzero(paired)],
        [names[i] for i in np.flatnonzero(vague & ~paired)],
    )


def _listed(names: list[str]) -> str:
    """Return names with commas and a last "and"."""
    *first, last = names
    if not first:
        return last
    return f"{', '.join(first)} and {last}"


def directions_of(jacobian: Floats) -> tuple[Floats, Floats, float]:
    """Return a root of the covariance, the weakest direction and its singular value.

    The root R, for noise of size 1, is such that R R^T is the covariance of the
    parameters. The weakest direction is the one that changes the residuals least.
    """
    _, singular, directions = np.linalg.svd(jacobian, full_matrices=False)
    # Nothing is divided by zero where the residuals do not depend on a direction.
    spread = directions.T / np.maximum(singular, 1e-12)
    return spread, directions[-1], float(singular[-1])
