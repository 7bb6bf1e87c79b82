"""Growth of tangents: Lyapunov exponents over a run and over its second half."""

from dataclasses import dataclass
from typing import Self

import numpy as np

from rattlesweep.arrays import Floats, Integers
from rattlesweep.kernel import runs


def leave_out_comparisons(growth: Floats, t_end: Floats) -> None:
    """Leave out growths in the first window, but for motions that died out.

    Their last growths are older than the end of the run.
    """
    if growth.shape[1] > runs.N_WINDOWS:
        ends = np.nan_to_num(growth[:, : runs.N_WINDOWS, 0]).max(axis=1)
        growth[ends >= t_end, runs.N_WINDOWS :] = np.nan


@dataclass(frozen=True)
class _Grown:
    """Logarithms of the growth of tangents over time, interpolated."""

    t: Floats  # shape (runs, rows), increasing from 0, then NaN
    log: Floats  # shape (runs, rows, tangents)
    last: Integers  # the last row of each run that is known

    @classmethod
    def of(cls, growth: Floats) -> Self:
        """Return the growth in the rows of :attr:`Outcome.lyapunov`."""
        # A step that ends several windows fills the row of the first; the empty rows
        # go to the end.
        order = np.argsort(growth[:, :, :1], axis=1, kind="stable")
        rows = np.take_along_axis(growth, order, axis=1)
        # At the launch, time and growth are zero.
        launch = np.zeros((len(growth), 1, growth.shape[2]))
        rows = np.concatenate([launch, rows], axis=1)
        t = rows[:, :, 0]
        return cls(t, rows[:, :, 1:], np.isfinite(t).sum(axis=1) - 1)

    @property
    def end(self) -> Floats:
        """Time up to which the growth is known."""
        ends: Floats = self.t[np.arange(len(self.t)), self.last]
        return ends

    def whole(self) -> Floats:
        """Return the growth up to the end."""
        grown: Floats = self.log[np.arange(len(self.t)), self.last]
        return grown

    def until(self, time: Floats) -> Floats:
        """Return the growth up to a time, NaN where that is before the second row."""
        run = np.arange(len(self.t))
        before = (self.t <= time[:, None]).sum(axis=1) - 1
        after = np.minimum(before + 1, self.last)
        with np.errstate(invalid="ignore", divide="ignore"):
            share = (time - self.t[run, before]) / (
                self.t[run, after] - self.t[run, before]
            )
            between = self.log[run, after] - self.log[run, before]
            grown = self.log[run, before] + share[:, None] * between
        return np.where((before > 0)[:, None], grown, np.nan)


def exponents(growth: Floats) -> tuple[Floats, Floats]:
    """Return finite-time Lyapunov exponents over each run and over its second half.

    They are slopes of :attr:`Outcome.lyapunov`, shape (runs, tangents), in
    ``sqrt(g/a)``, and NaN where it is not finite. The growth up to half time is
    interpolated between the ends of windows.  The second slopes are also NaN where half
    time falls within the first window.
    """
    grown = _Grown.of(growth)
    half = grown.end / 2
    with np.errstate(invalid="ignore", divide="ignore"):
        whole = grown.whole() / grown.end[:, None]
        late = (grown.whole() - grown.until(half)) / half[:, None]
    whole[~np.isfinite(whole)] = np.nan
    late[~np.isfinite(late)] = np.nan
    return whole, late


def late_growths(growth: Floats) -> tuple[Floats, Floats]:
    """Return the logarithms of growth in the third and in the last quarter of each run.

    They have the shape (runs, tangents), and are NaN where :func:`exponents` of the
    second half are.
    """
    grown = _Grown.of(growth)
    until_half = grown.until(grown.end / 2)
    until_last = grown.until(0.75 * grown.end)
    return until_last - until_half, grown.whole() - until_last
