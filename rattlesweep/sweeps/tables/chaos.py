"""Almost periodic or chaotic, told by how far a small difference grows."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

# Between the growth that no chaos is needed for and that of chaos; evidence in docs/lyapunov.md.
LEAST_GROWTH = 10.0


def is_chaotic(
    lyapunov_late: ArrayLike, t_end: ArrayLike, least_growth: float = LEAST_GROWTH
) -> NDArray[np.bool_]:
    """Whether differences grow exponentially in the second half of a run.

    An almost periodic run doubles them there at most, or shrinks them; the instability by which
    wobbling sets in multiplies them by no more than the oscillation grows, some hundreds.

    Parameters
    ----------
    lyapunov_late, t_end : array_like
        The columns of ``runs`` of these names.
    least_growth : float
        Natural logarithm of the growth from which on a run counts as chaotic.

    Returns
    -------
    ndarray of bool
        False where ``lyapunov_late`` is not known.
    """
    growth = np.asarray(lyapunov_late, dtype=float) * np.asarray(t_end, dtype=float) / 2
    return np.asarray(growth > least_growth)
