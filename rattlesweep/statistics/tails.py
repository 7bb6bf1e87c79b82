"""Reversal times whose mean does not exist, and their median, which does.

``t_r`` goes as 1/xi.  Where skews come arbitrarily close to zero, the share of times
above t falls as 1/t: the mean is infinite, and the average of any number of runs is
that of the few longest.  The tail index alpha is the exponent of such a fall,
``t^-alpha``.  The variance is finite for alpha > 2, the mean for alpha > 1.
"""

import math

import numpy as np

from rattlesweep.arrays import Floats

LEAST_INDEX = 2.0  # below it the standard error of a mean means nothing
_FEWEST = 100  # values that an estimate of the tail needs


def tail_index(values: Floats) -> float:
    """Return Hill's estimate of the tail index; NaN for fewer than 100 values.

    It looks at the ``1.5 sqrt(n)`` largest of n values.  Its standard error is the
    index over the root of this number.  B. M. Hill, Ann. Stat. 3, 1163 (1975).
    """
    count = len(values)
    if count < _FEWEST:
        return math.nan
    largest = round(1.5 * math.sqrt(count))
    tail = np.partition(values, count - largest - 1)[-largest - 1 :]
    threshold = tail[0]
    excess = float(np.log(tail[1:] / threshold).mean())
    if excess == 0:
        return math.inf
    return 1 / excess


def median_error(values: Floats, z: float) -> float:
    """Return half the width of the confidence interval of the median, relative to it.

    The ends are order statistics, so no tail spoils them.  Infinite for few values.
    """
    count = len(values)
    ranks = count / 2 + np.array([-1, 1]) * z * math.sqrt(count) / 2
    low = math.floor(ranks[0]) - 1
    high = math.ceil(ranks[1])
    if low < 0 or high >= count:
        return math.inf
    ends = np.partition(values, [low, high])[[low, high]]
    return float((ends[1] - ends[0]) / 2 / np.median(values))
