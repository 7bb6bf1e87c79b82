"""Columns of the arrays that a kernel reads and writes, one row a run."""

from __future__ import annotations

# ``result``: what was measured; the names are those of the attributes of an Outcome.
T_END, T_R, N_END, DRIFT, GROWTH, DEPARTURE = 0, 1, 2, 3, 4, 5
ENERGY_0, DRIFT_MAX, RATIO_MAX, NORMAL_MIN, VOLUME = 6, 7, 8, 9, 10
RESULT = ("t_end", "t_r", "n_end", "energy_drift", "amp_growth", "n_departure", "energy_0",
          "energy_drift_max", "contact_ratio_max", "contact_normal_min", "volume_rate")  # fmt: skip
FIRST_STATE = 11  # the state at the end: as many columns as the model has components
# ``counts``: status and counters, likewise.
STATUS, STEPS, NEAR, REJECTED, REVERSALS = 0, 1, 2, 3, 4
COUNTS = ("status", "n_steps", "near_tangencies", "n_rejected", "n_turns")
N_COUNTS = 5
# ``plan``: horizon, fastest swing of the spin, window, bound of its rate, first step, expected
# cost, the depth below which an extremum of the spin is undecided, first comparison of amplitudes;
# the spin from which on it has a side, and 1 for a launch without spin; the oscillation below
# which the run has settled; the share of the launch's energy below which it is dead.
HORIZON, SWING, WINDOW, RATE, FIRST_STEP, COST, FUZZ, FIRST_MARK = 0, 1, 2, 3, 4, 5, 6, 7
FAR, TAPPED, SETTLED, DEAD = 8, 9, 10, 11
N_PLAN = 12
# ``options``: 1/tol^2, fixed step, most steps.
N_OPTIONS = 3
# ``record``: what is asked for beyond the types' needs.
REC_ENERGY, REC_CONTACT, REC_WINDOWS, REC_REVERSALS, REC_VOLUME = 0, 1, 2, 3, 4
N_RECORD = 5
# Reversals of a run that are written down, a row of its windows each.
MOST_REVERSALS = 8
