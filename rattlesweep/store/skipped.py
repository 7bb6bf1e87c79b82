"""Estimates at the points of a grid that a refined sweep skips.

A skipped point has the type of the nearest run.  A number is interpolated between the
runs around it: from the coarse grid to the full one, each halving of a stride puts the
points between two known or estimated ones on a curve through up to four of them.
"""

from __future__ import annotations

import numpy as np

from rattlesweep.arrays import Floats, Integers
from rattlesweep.store.decide import Array, Refining, ticks_of
from rattlesweep.store.rows import Stored


def estimate(stored: Stored, values: Floats, nearest: Integers) -> Floats:
    """Return positive numbers at all points of a refined sweep.

    Parameters
    ----------
    values : ndarray, shape (runs,)
        A column of the stored runs in the order of their keys; NaN where a run is not
        to be interpolated from.
    nearest : ndarray, shape (cases, samples)
        Row of the run nearest to each point, -1 for none.  Where no run around a point
        has a number, the estimate is the number of this run.

    Returns
    -------
    ndarray, shape (cases, samples)
    """
    refining = Refining(stored)
    is_stored = stored.find().done
    at_runs = np.full(is_stored.shape, np.nan)
    at_runs[is_stored] = values
    # Reversal times range over decades, and their logarithms are nearly linear.
    with np.errstate(divide="ignore", invalid="ignore"):
        logarithms = np.log(refining.grid(at_runs))
    filled = interpolate(logarithms, refining.grid(is_stored), refining.strides)
    estimates: Floats = np.exp(refining.runs(filled))
    # The bits of a run are its own.
    estimates[is_stored] = values
    of_nearest = np.where(nearest < 0, np.nan, values[nearest])
    return np.where(np.isfinite(estimates), estimates, of_nearest)


def interpolate(values: Floats, is_known: Array, strides: list[int]) -> Floats:
    """Return values on a whole grid from those on a grid that is refined in places.

    Known points are kept, even where they are NaN.  `strides` are those of the coarse
    grid, whose points are all known.
    """
    values = values.copy()
    stride = list(strides)
    while max(stride) > 1:
        longest = max(stride)
        # The longest strides are halved one after another, so that the points which
        # one axis has gained are known when the next one is halved.
        for axis in range(values.ndim):
            if stride[axis] < longest:
                continue
            # Along each axis, the places of the points that have a value by now.
            lattice = [
                ticks_of(*pair) for pair in zip(values.shape, stride, strict=True)
            ]
            before = lattice[axis]
            stride[axis] = longest // 2
            new = np.setdiff1d(ticks_of(values.shape[axis], stride[axis]), before)
            along_axis = np.moveaxis(values[np.ix_(*lattice)], axis, -1)
            between = np.moveaxis(_between(before, along_axis, new), -1, axis)
            lattice[axis] = new
            place = np.ix_(*lattice)
            # A run that refinement has added there has a value of its own.
            values[place] = np.where(is_known[place], values[place], between)
    return values


def _between(x: Integers, values: Floats, new: Integers) -> Floats:
    """Return values at `new` places between the places `x` along the last axis."""
    right = np.searchsorted(x, new)
    left = right - 1
    low = values[..., left]
    high = values[..., right]
    share = (new - x[left]) / (x[right] - x[left])
    line = low + share * (high - low)
    # The curvature of a parabola through three neighbouring points, at the middle one.
    slope = np.diff(values) / np.diff(x)
    curvature = np.full(values.shape, np.nan)
    curvature[..., 1:-1] = np.diff(slope) / (x[2:] - x[:-2])
    # The parabola through both ends, with the mean of the curvatures there.  In the
    # middle of equal steps it is the cubic through four points.
    at_ends = np.stack([curvature[..., left], curvature[..., right]])
    is_curved = np.isfinite(at_ends)
    bend = np.where(is_curved, at_ends, 0.0).sum(axis=0)
    bend = bend / np.maximum(is_curved.sum(axis=0), 1)
    curve = line + bend * (new - x[left]) * (new - x[right])
    # Beside a run without a number, the other neighbour's number is taken.
    one_sided = np.where(np.isfinite(low), low, high)
    return np.where(np.isfinite(curve), curve, one_sided)
