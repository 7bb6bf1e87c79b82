"""The Python interface: a few calls over the rooms below, which they import when they are made.

What is wrong with an argument is a ``ConfigError``, which is a ``ValueError``; what the disk or the
data refuse is an ``OutputError``.  Each says in a sentence what it is and what would be right.
"""

from rattlesweep.api.closed import (
    GrowthRates,
    bondi_threshold,
    growth_rates,
    modes,
    reversal_time_gh,
)
from rattlesweep.api.pages import Page
from rattlesweep.api.single import Run, replay, simulate, trajectory
from rattlesweep.api.stored import Sweep
from rattlesweep.api.sweeps import load, sweep
from rattlesweep.errors import ConfigError, OutputError
from rattlesweep.physics.body import Rattleback
from rattlesweep.physics.theory import Modes

__all__ = ["ConfigError", "GrowthRates", "Modes", "OutputError", "Page", "Rattleback", "Run",
           "Sweep", "bondi_threshold", "growth_rates", "load", "modes", "replay",
           "reversal_time_gh", "simulate", "sweep", "trajectory"]  # fmt: skip
