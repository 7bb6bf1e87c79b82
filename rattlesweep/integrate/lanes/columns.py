"""Columns of the arrays that a kernel reads and writes, one row a run."""

from __future__ import annotations

# ``result``: what was measured, by the names of an Outcome's attributes; behind them the state at
# the end, as many columns as the model has components.
RESULT = ("t_end", "t_r", "n_end", "energy_drift", "amp_growth", "n_departure", "energy_0",
          "energy_drift_max", "contact_ratio_max", "contact_normal_min", "volume_rate")  # fmt: skip
T_END, T_R, GROWTH, DEPARTURE, FIRST_STATE = 0, 1, 4, 5, 11
# ``counts``: status and counters, likewise.
COUNTS = ("status", "n_steps", "near_tangencies", "n_rejected", "n_turns")
STATUS, STEPS = 0, 1
# ``plan``: horizon, fastest swing of the spin, window, bound of its rate, first step, expected
# cost, the depth below which an extremum of the spin is undecided, first comparison of amplitudes;
# the spin from which on it has a side, and 1 for a launch without spin; the oscillation below
# which the run has settled; the share of the launch's energy below which it is dead.
HORIZON, SWING, WINDOW, RATE, FIRST_STEP, COST, FUZZ, FIRST_MARK = 0, 1, 2, 3, 4, 5, 6, 7
FAR, TAPPED, SETTLED, DEAD = 8, 9, 10, 11
# ``options``: 1 / tol^2, fixed step, most steps.
# ``record``: what is asked for beyond the types' needs.
REC_ENERGY, REC_CONTACT, REC_WINDOWS, REC_REVERSALS, REC_VOLUME, N_RECORD = 0, 1, 2, 3, 4, 5
# Reversals of a run that are written down, a row of its windows each.
MOST_REVERSALS = 8
