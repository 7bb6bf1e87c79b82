"""The Python interface: a few calls, which import the rooms below when they are made.

An argument that is wrong raises a ``ConfigError``, which is a ``ValueError``; what the disk or the
data refuse raises an ``OutputError``.  Each says in a sentence what is wrong and what would be
right.
"""

from rattlesweep.api.closed import (
    GrowthRates,
    bondi_threshold,
    growth_rates,
    modes,
    reversal_time_gh,
)
from rattlesweep.api.single import Page, Run, fit, replay, show, simulate, trajectory
from rattlesweep.api.sweeps import Sweep, load, sweep
from rattlesweep.errors import ConfigError, OutputError
from rattlesweep.physics.body import Rattleback
from rattlesweep.physics.theory import Modes

__all__ = ["ConfigError", "GrowthRates", "Modes", "OutputError", "Page", "Rattleback", "Run",
           "Sweep", "bondi_threshold", "fit", "growth_rates", "load", "modes", "replay",
           "reversal_time_gh", "show", "simulate", "sweep", "trajectory"]  # fmt: skip
