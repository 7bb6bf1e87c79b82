"""Regimes of motion, from the Lyapunov exponents of the second half of a run.

On its surface of constant energy a motion has four exponents, one of which is that of
the flow.  What counts is the logarithm of growth in the second half.  An exponent is
positive or negative if this is beyond 10 and larger than its change from the third
quarter of the run to the last one.  It is zero if it is at most 2 and its change at
most 10, as differences on a torus grow in proportion to the time, and so by the
logarithm of 2.  In between, the run is too short to tell a slow decay from none.

=================  ===========================================================
steady             all negative: a steady spin
periodic           one zero, the others negative: a cycle that attracts
quasi-periodic     all zero: a torus
attractor          one positive, and the volume shrinks: a strange attractor
conservative       one positive, and the volume hardly changes
undecided          the run is too short to tell
=================  ===========================================================

Two zeros beside two negative exponents would be a torus that attracts, but nearly all
such runs are on their way to something else (docs/dynamics.md).
"""

import numpy as np

from rattlesweep.arrays import Flags, Floats, Integers
from rattlesweep.physics.chaos import LEAST_GROWTH
from rattlesweep.words.names import REGIMES

_STEADY, PERIODIC, QUASIPERIODIC, ATTRACTOR, CONSERVATIVE, _UNDECIDED = range(
    len(REGIMES)
)
# Largest ratio of the sum of the exponents to the largest one in chaos of conservative
# kind.
MOST_SHRINKING = 0.1
MOST_OF_ZERO = 2.0  # logarithm of the growth that a zero exponent may have
# The same for all exponents of a torus together.  Single ones wander, as the tangents
# turn into each other, but a slow mode keeps the sense of their sum.
MOST_OF_ZEROS = 1.0


def significant(late: Floats, t_end: Floats) -> Floats:
    """Return exponents with those that count as zero set to zero; NaN stays NaN."""
    grown = late * t_end[:, None] / 2
    return np.where(np.abs(grown) <= LEAST_GROWTH, 0.0, late)


def kaplan_yorke(level: Floats) -> Floats:
    """Return the dimension of Kaplan and Yorke of exponents, shape (runs, exponents).

    It is ``j + (the sum of the j largest) / |the next one|`` with the largest ``j`` for
    which the sum is not negative (Kaplan and Yorke 1979).
    """
    descending = -np.sort(-level, axis=1)
    count = level.shape[1]
    sums = np.concatenate(
        [np.zeros((len(level), 1)), np.cumsum(descending, axis=1)], axis=1
    )
    # The first sum, of no exponent, is zero; later ones rise, then fall.
    j = count - np.argmax(sums[:, ::-1] >= 0, axis=1)
    run = np.arange(len(level))
    following = np.append(descending, np.full((len(level), 1), -np.inf), axis=1)[run, j]
    dimension: Floats = j + sums[run, j] / np.abs(following)
    dimension[np.isnan(level).any(axis=1)] = np.nan
    return dimension


def regime_codes(third: Floats, last: Floats) -> Integers:
    """Return indices into :data:`rattlesweep.words.names.REGIMES`, -1 where unknown.

    The arguments are the logarithms of growth in the third and in the last quarter of
    the runs, of the exponents at constant energy, shape (runs, 4).
    """
    grown = third + last
    is_beyond = np.abs(grown) > LEAST_GROWTH
    # The change is smaller if both quarters have one sign.
    is_apart = is_beyond & (third * last > 0)
    stays = np.abs(last - third) <= LEAST_GROWTH
    is_zero = (np.abs(grown) <= MOST_OF_ZERO) & stays
    is_known = (is_apart | is_zero).all(axis=1)
    zeros = is_zero.sum(axis=1)
    may_be_chaotic = (is_beyond & (grown > 0)).any(axis=1)
    is_chaotic = (is_apart & (grown > 0)).any(axis=1)
    keeps_all = np.abs(grown.sum(axis=1)) <= MOST_OF_ZEROS
    shrinks, keeps = _volume(third, last)
    # The first condition that holds decides.
    cases = {
        -1: np.isnan(grown).any(axis=1),
        ATTRACTOR: is_chaotic & shrinks,
        CONSERVATIVE: is_chaotic & keeps,
        _UNDECIDED: may_be_chaotic | ~is_known,
        _STEADY: zeros == 0,
        PERIODIC: zeros == 1,
        QUASIPERIODIC: (zeros == third.shape[1]) & keeps_all,
    }
    return np.select([*cases.values()], [*cases], _UNDECIDED)


def _volume(third: Floats, last: Floats) -> tuple[Flags, Flags]:
    """Return in which chaotic runs the volume shrinks, and in which it stays.

    In others it grows, which it cannot for ever, or its rate is not known well enough.
    """
    grown = third + last
    total = grown.sum(axis=1)
    change = np.abs((last - third).sum(axis=1))
    border = MOST_SHRINKING * grown.max(axis=1)
    shrinks = total < -border - change
    keeps = (total > -border + change) & (total < border)
    return shrinks, keeps
