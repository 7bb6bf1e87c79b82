"""Regimes of motion, from the Lyapunov exponents of the second half of a run.

On its surface of constant energy a motion has four exponents, one of which is that of
the flow.  An exponent is positive or negative if differences grow or decay by more than
``e^10`` in the second half, and otherwise counts as zero, so that a regime is one
within the time of the run.

=================  ===========================================================
steady             all negative: a steady spin
periodic           one zero, the others negative: a cycle that attracts
quasi-periodic     several zero, none positive: a torus
attractor          one positive, and the volume shrinks: a strange attractor
conservative       one positive, and the volume hardly changes
=================  ===========================================================
"""

import numpy as np

from rattlesweep.arrays import Floats, Integers
from rattlesweep.names import REGIMES
from rattlesweep.sweeps.types import LEAST_GROWTH

STEADY, PERIODIC, QUASIPERIODIC, ATTRACTOR, CONSERVATIVE = range(len(REGIMES))
# Largest ratio of the sum of the exponents to the largest one in chaos of conservative
# kind.
MOST_SHRINKING = 0.1


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


def regime_codes(level: Floats) -> Integers:
    """Return indices into :data:`rattlesweep.names.REGIMES`, -1 where unknown.

    `level` has the :func:`significant` exponents at constant energy, shape (runs, 4).
    """
    zeros = (level == 0).sum(axis=1)
    largest = level.max(axis=1)
    total = level.sum(axis=1)
    code = np.full(len(level), STEADY)
    code[zeros == 1] = PERIODIC
    code[zeros > 1] = QUASIPERIODIC
    is_chaotic = largest > 0
    shrinks = total < -MOST_SHRINKING * largest
    code[is_chaotic & shrinks] = ATTRACTOR
    code[is_chaotic & ~shrinks] = CONSERVATIVE
    code[np.isnan(level).any(axis=1)] = -1
    return code
