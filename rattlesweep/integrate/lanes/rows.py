"""Names for the first rows of the workspace: what the lane kernel keeps of every run.

A row holds one number per lane.  The rows of the model and the method come behind these
(:class:`rattlesweep.integrate.lanes.step.Layout`), in the same flat array: with two arrays LLVM
would have to prove that they do not overlap, and leaves the loops scalar instead.
"""

from __future__ import annotations

# Time, with the low part that compensated summation keeps, and where it ends.
T, T_LOW, T_END = 0, 1, 2
# Spin and its rate at the start of the step; largest recent rate; sign of the initial spin.
N0, RATE0, RATE_MAX, SIGN = 3, 4, 5, 6
# Fastest frequency at which the spin swings; 1 while the step after a rejection.
SWING, HELD = 7, 8
# 1 if the step ends at T_END; accepted and rejected steps.
LAST, STEPS, REJECTED = 9, 10, 11
# Amplitude: largest in the window, smallest and growth over windows before; the window's end.
A_MAX, A_MIN, GROWTH, WINDOW, WINDOW_END, WINDOW_NO = 12, 13, 14, 15, 16, 17
# Smallest SIGN * n since the start, and extremes of n in the window.
N_LEAST, W_N_MIN, W_N_MAX = 18, 19, 20
# Energy at the start, largest drift of it; contact force ratio and normal force, extremes.
ENERGY0, DRIFT_MAX, RATIO_MAX, NORMAL_MIN = 21, 22, 23, 24
# Decision on the step tried: 1 to accept it; the next step size.
ACCEPT, H_NEXT = 25, 26
# Search for the first zero within a held step (events.py).
MODE, PIECE, PIECES, TRIES, NEAR = 27, 28, 29, 30, 31
FULL_H, FULL_N, FULL_R, FULL_NEXT = 32, 33, 34, 35
LO_H, LO_N, LO_R = 36, 37, 38
HI_H, HI_N, HI_R = 39, 40, 41
END_H, END_N, END_R = 42, 43, 44
# Spin at the start of the run.
N_START = 45
# Depth of an extremum of the spin, relative to its swing, that the method cannot decide.
FUZZ = 46
# 1 where a lane needs a closer look.
DUE = 47
# Next time at which amplitudes are compared; marks that double until the first window ends; how
# often they were compared; the least amplitude that counts; the largest in the window.
NEXT, MARK, COMPARED, A_FLOOR, W_A_MAX = 48, 49, 50, 51, 52
# Number of the lane's run, -1 for none.
RUN = 53
# What was behind a zero, when its search began.
BEYOND_H, BEYOND_N, BEYOND_R = 54, 55, 56
# Root of the error of the step tried, and of the one before it (controller.py).
ROOT, ROOT0 = 57, 58
# The spin from which on it has a side; the same while a run launched without spin has not reached
# it, then 0; the bound of its rate from there on.
FAR, ARM, ARM_RATE = 59, 60, 61
# Where reversals are recorded: the first zero of all, the first since the spin was last far (each
# -1 for none), the side it was on, how often it has changed, the largest spin since.
T_ZERO, T_PENDING, SIDE, REVERSALS, N_AFTER = 62, 63, 64, 65, 66
STATE_ROWS = 67
# Of the step tried: its size, its squared error in units of the tolerance, and at its end the spin,
# its rate and the squared amplitude.
H, ERROR, N1, RATE1, AMPLITUDE = 67, 68, 69, 70, 71
ROWS = 72
