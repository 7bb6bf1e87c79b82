"""The Python interface: a few calls over the rooms below, which they import when they are made."""

from rattlesweep.api.closed import modes, reversal_time_gh
from rattlesweep.api.single import Run, replay, simulate, trajectory
from rattlesweep.api.sweeps import Sweep, load, sweep
from rattlesweep.errors import ConfigError, OutputError
from rattlesweep.physics.body import Rattleback
from rattlesweep.physics.theory import Modes

__all__ = ["ConfigError", "Modes", "OutputError", "Rattleback", "Run", "Sweep", "load", "modes",
           "replay", "reversal_time_gh", "simulate", "sweep", "trajectory"]  # fmt: skip
