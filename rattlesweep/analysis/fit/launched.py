"""The part of measured data that a run describes: without rest before, and unclipped.

A phone records before the push, and its gyroscope has a largest rate that it can tell.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import groupby

import numpy as np

from rattlesweep.analysis.fit.film import Film
from rattlesweep.arrays import Flags, Floats, Places
from rattlesweep.words.errors import ConfigError

# A stone is at rest below this share of its largest spin, and launched above the other.
RESTING = 0.05
LAUNCHED = 0.5
FEWEST_AT_REST = 5  # rows
# The launch ends where the spin no longer grows by this share of its largest in a row.
GROWING = 0.05
# Rest before a launch takes so many times as long as the launch.  A tap, whose spin
# grows from zero in some periods of its oscillation, does not.
LONGER_REST = 2
SPAN = 5  # rows over which an angle tells a spin
NOISY = 4.0  # standard deviations within which an angle is at rest
# A plateau has so many equal values one after the other, and so many times more than
# any other value has.
LIMIT_PLATEAU = 4
FLATTER = 3
BESIDE = 2  # rows on each side of a clipped one
MOST_CLIPPED = 0.5  # share of the rows


def from_the_launch(film: Film, n_i: float | None) -> Film:
    """Return a film of a launch without the rows before it, and without clipped ones.

    `n_i` is the spin of the launch, None if it is not known; that of a tap is zero.
    Notes of the film name the rows that are left out.
    """
    if film.kind == "reversal":
        return film
    film = _without_plateau(film)
    if n_i == 0:
        return film
    return _without_rest(film, n_i)


def _without_plateau(film: Film) -> Film:
    """Return a film without the rows at the limit of a gyroscope."""
    if film.kind == "angle":
        return film
    size = np.abs(film.value)
    runs = [(value, len(list(rows))) for value, rows in groupby(size[film.known])]
    largest = film.size
    flat = max((count for value, count in runs if value == largest), default=0)
    # Rest may be written as zeros.
    others = max((count for value, count in runs if 0 < value < largest), default=0)
    if flat < LIMIT_PLATEAU or flat < FLATTER * others:
        return film
    is_clipped = size == largest
    count = int(is_clipped.sum())
    unit = film.value_column.unit
    limit = f"{largest / unit.size:.4g} {unit.name}"
    if count > MOST_CLIPPED * len(size):
        raise ConfigError(
            f"{film.source}: {count} of {len(size)} rows of {film.value_column.name} "
            f"are at the limit of the sensor, {limit}; spin the stone more slowly, or "
            "film it"
        )
    note = (
        f"{count} rows, from row {int(is_clipped.argmax()) + 1} on, are at the limit "
        f"of the sensor, {limit}, and left out with the rows beside them"
    )
    # Of the rows beside them, noise has clipped the larger ones only.
    is_beside = np.convolve(is_clipped, np.ones(2 * BESIDE + 1), "same") > 0
    value = np.where(is_beside, np.nan, film.value)
    return replace(film, value=value, notes=(*film.notes, note))


def _without_rest(film: Film, n_i: float | None) -> Film:
    """Return a film that begins with its launch.

    A launch from rest takes a few rows, in which the spin becomes half of its largest.
    """
    rows = np.flatnonzero(film.known)
    if len(rows) < 2 * FEWEST_AT_REST:
        return film
    rate, is_at_rest = _rates(film, rows)
    resting = int(is_at_rest.argmin())  # rows at rest before the first that is not
    if resting < FEWEST_AT_REST:
        return film
    largest = film.largest_spin
    fast = np.flatnonzero(np.abs(rate[resting:]) >= LAUNCHED * largest)
    if not len(fast):
        return film
    launch = resting + int(fast[0])
    while (
        launch + 1 < len(rows)
        and abs(rate[launch + 1]) > abs(rate[launch]) + GROWING * largest
    ):
        launch += 1
    if resting < LONGER_REST * (launch - resting):
        is_far = n_i is not None and abs(film.first_spin) < LAUNCHED * abs(n_i)
        if is_far and resting >= LONGER_REST * FEWEST_AT_REST:
            raise ConfigError(
                f"{film.source}: the stone is at rest up to row {rows[resting - 1] + 1}"
                " and the launch is not seen; cut the rows before it"
            )
        return film
    first = int(rows[launch])
    t_column = film.t_column
    after = f"{film.t[first] / t_column.unit.size:.4g} {t_column.unit.name}"
    note = (
        f"the stone is launched at row {first + 1}, {after} after the first row; the "
        "rows before it are left out"
    )
    error = film.error
    if error is not None:
        error = error[first:]
    return replace(
        film,
        t=film.t[first:] - film.t[first],
        value=film.value[first:],
        error=error,
        notes=(*film.notes, note),
    )


def _rates(film: Film, rows: Places) -> tuple[Floats, Flags]:
    """Return the spin of the known rows, and which of them are at rest."""
    value = film.value[rows]
    if film.kind != "angle":
        return value, np.abs(value) < RESTING * film.largest_spin
    # A row has the rate over the next rows, so that noise counts less.
    t = film.t[rows]
    ahead = np.minimum(np.arange(len(rows)) + SPAN, len(rows) - 1)
    here = ahead - SPAN
    rate = (value[ahead] - value[here]) / (t[ahead] - t[here])
    # The noise of single rates is large, so rest is told by the angle itself.
    about = float(np.median(value[:FEWEST_AT_REST]))
    is_off = np.abs(value - about) > NOISY * film.rough_noise
    # The last row at rest is that of the launch.
    return rate, ~np.append(is_off[1:], is_off[-1])
