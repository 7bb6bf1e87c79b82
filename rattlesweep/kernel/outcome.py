"""What is integrated and what comes of it: batches and outcomes."""

from dataclasses import dataclass, field

import numpy as np

from rattlesweep.arrays import Flags, Floats, Integers
from rattlesweep.kernel.collected import Recorded
from rattlesweep.kernel.mode.modes import ModeResults
from rattlesweep.kernel.runs import RunResults
from rattlesweep.kernel.state.status import Status


@dataclass(frozen=True)
class Batch:
    """Runs to integrate, in units of ``a`` and ``g``; arrays have one row a run."""

    y0: Floats  # initial states
    constants: Floats  # of the bodies
    probe: Floats  # coefficients of the relevant amplitude
    t_end: Floats  # horizon
    swing: Floats  # fastest angular frequency of the spin
    relevant: Floats  # angular frequency of the relevant oscillation, or 0
    rate: Floats  # bound of the spin's rate in the first steps
    window: Floats  # length of the windows whose amplitudes are compared
    # Time of the first comparison of amplitudes; in the first window, the next ones are
    # at twice, four times, ... this time.
    first_comparison: Floats
    # modulus of the spin at launch, or of the spin that would hold all the energy
    scale: Floats
    # launched without spin: zeros count once |n| has exceeded PLATEAU_SHARE of scale
    tapped: Flags
    # Square of the oscillation (as in Model.error) below which it only decays: a run
    # ends if it is below after two windows without growth.  0 means that no run ends
    # so.
    settled: Floats = field(default_factory=lambda: np.zeros(0))
    # Share of the energy at launch below which a zero of the spin, with friction, is no
    # reversal.
    dead: Floats = field(default_factory=lambda: np.zeros(0))
    # Height of the body's rim over its lowest point, NaN without one.
    rim: Floats = field(default_factory=lambda: np.zeros(0))

    def __len__(self) -> int:
        """Return the number of runs."""
        return len(self.t_end)


@dataclass(frozen=True)
class Outcome(RunResults, ModeResults, Recorded):
    """Results of a :class:`Batch`: arrays over runs, NaN where a run has no value."""

    y_end: Floats  # states at t_end, shape (runs, n_state)
    stopped: bool  # whether the kernel was stopped before all runs had ended


def has_settled(batch: Batch, outcome: Outcome) -> Flags:
    """Return which runs ended before their horizon because they had settled."""
    ended = (outcome.t_end < batch.t_end) & np.isnan(outcome.t_r)
    # Where no run could settle, one that ended early was dead at a zero of its spin.
    settled: Flags = ended & (outcome.status == Status.OK) & (len(batch.settled) > 0)
    return settled


@dataclass(frozen=True)
class Estimated(Outcome):
    """Outcome of runs, with errors from their companions; NaN where there are none."""

    t_r_error: Floats
    amp_growth_error: Floats
    n_departure_error: Floats
    # Whether it is sure that a run reverses by its horizon, or does not.
    reversal_sure: Flags
    tol: Floats  # NaN with a fixed step
    companion_t_r: Floats
    apart: Floats  # distance of the two states at their reversals
    grazes: Integers  # undecided extrema of the spin in both
    turn_errors: Floats  # errors of the times in `reversals`, shape (runs, 8) or (0, 8)
    turns_sure: Integers  # number of turns, from the first on, that are sure
