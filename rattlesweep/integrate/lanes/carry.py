"""A run that carries a tangent: what is added to how runs begin, are watched and end.

Templates that stand in for those of the same names in :mod:`rattlesweep.integrate.lanes.runs`, do
what these do, and look after the tangent.  Barriers keep the two apart: the state's last bits
are those of a run without tangent.
"""

# mypy: ignore-errors
from __future__ import annotations

from rattlesweep.integrate.lanes import rows as R
from rattlesweep.integrate.lanes.atomics import barrier


def tangent_seed(lane):
    """Give a lane the first tangent."""
    raise NotImplementedError


def tangent_begin(lane):
    """Make it transverse and of norm 1."""
    raise NotImplementedError


def tangent_log(lane):
    """Logarithm of the tangent's growth from the start of the run to the end of the step."""
    raise NotImplementedError


def tangent_stay(lane):
    """Make the tangent at the end of the step that at its start."""
    raise NotImplementedError


def tangent_advance(w):
    """Move the tangents of all lanes to the end of their step."""
    raise NotImplementedError


# What stood there before; bound by kernels.build, like the functions above.
plain_start = plain_finish = plain_pass_marks = plain_stay = plain_advance = None


def start(lane, run, y0, constants, probe, plan, record):
    """Put a run and its tangent into a lane."""
    plain_start(lane, run, y0, constants, probe, plan, record)
    barrier()
    tangent_seed(lane)
    tangent_begin(lane)
    barrier()


def see_tangent(lane, t, run, windows):
    """Write the time and the tangent's growth into the last two columns of the window's row."""
    k = min(int(lane[R.WINDOW_NO]), windows.shape[1] - 1)
    barrier()
    windows[run, k, windows.shape[2] - 2] = t
    windows[run, k, windows.shape[2] - 1] = tangent_log(lane)
    barrier()


def pass_marks(lane, t, run, windows, record):
    """Note the tangent at the end of a window."""
    if t >= lane[R.WINDOW_END]:
        see_tangent(lane, t, run, windows)
    plain_pass_marks(lane, t, run, windows, record)


def finish(lane, status, reversal, t, run, result, counts, windows, record):
    """Write down a run that has ended, and its tangent."""
    see_tangent(lane, t, run, windows)
    plain_finish(lane, status, reversal, t, run, result, counts, windows, record)


def stay(lane):
    """Make the end of the step tried its start, for the tangent too."""
    plain_stay(lane)
    tangent_stay(lane)


def advance(w):
    """Move all lanes and their tangents to the end of their step."""
    plain_advance(w)
    tangent_advance(w)


STAND_INS = (see_tangent, start, pass_marks, finish, stay, advance)
