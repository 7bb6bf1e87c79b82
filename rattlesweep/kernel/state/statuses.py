"""Statuses of runs as numbers, which compiled functions return."""

from rattlesweep.kernel.state.status import Status

OK = int(Status.OK)
NONFINITE = int(Status.NONFINITE)
STEP_LIMIT = int(Status.STEP_LIMIT)
STEP_TOO_SMALL = int(Status.STEP_TOO_SMALL)
ENERGY_OFF = int(Status.ENERGY)
AT_LIMIT = int(Status.LIMIT)
LIFTS_OFF = int(Status.LIFTS_OFF)
JAMMED = int(Status.JAMMED)
RIM = int(Status.RIM)
