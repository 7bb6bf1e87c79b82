"""What is integrated and what comes of it: batches and outcomes."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from rattlesweep.arrays import Flags, Floats, Integers
from rattlesweep.kernel.look.marks import MARKS
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
class Outcome:
    """Results of a :class:`Batch`: arrays over runs, NaN where a run has no value."""

    t_end: Floats  # time reached
    t_r: Floats  # first reversal
    n_end: Floats  # spin at t_end
    energy_drift: Floats  # at t_end, relative to energy_0
    # Largest growth of the relevant amplitude between comparisons, relative.
    amp_growth: Floats
    n_departure: Floats  # largest loss of spin, relative to the launch
    energy_0: Floats  # energy at launch
    status: Integers  # values of Status
    n_steps: Integers
    near_tangencies: Integers
    n_rejected: Integers
    n_turns: Integers  # 0 if reversals are not recorded
    y_end: Floats  # states at t_end, shape (runs, n_state)
    # The next four have no rows if the model does not slide.
    t_slide: Floats  # begin of the first slide
    n_slides: NDArray[np.int32]
    slide_time: Floats  # time spent sliding
    slide_work: Floats  # energy lost by sliding, relative to energy_0
    # The next four have no rows if the model has no pivoting friction.
    t_held: Floats  # begin of the first rest of the spin
    held_time: Floats  # time for which the spin is held
    pivot_work: Floats  # energy lost by pivoting, relative to energy_0
    # 1 where a step ended at a state in which the plane would have to pull the body.
    pulled: Floats
    # The others have no rows if they were not recorded.
    energy_drift_max: Floats
    contact_ratio_max: Floats
    contact_normal_min: Floats
    volume_rate: Floats
    late: Floats  # mean and deviation of the spin in the last quarter, shape (runs, 2)
    marks: Floats  # times of `look.marks`, shape (runs, marks)
    # Least and largest value, then means between reversals, shape (runs, 10, 2).
    casimir: Floats
    # Amplitude, least and largest spin in each window, shape (runs, 64, 3).
    windows: Floats
    # Time of each reversal and largest modulus of the spin until the next, shape (runs,
    # 8, 2).
    reversals: Floats
    # Time and logarithm of the tangent's growth at the ends of the windows and of the
    # run, shape (runs, 64, 2).  If a step ends several windows, only the row of the
    # first is filled.  For the spectrum there are N_GROWTHS logarithms, and
    # N_COMPARISONS further rows within the first window.
    growth: Floats
    stopped: bool  # whether the kernel was stopped before all runs had ended

    def mark(self, name: str) -> Floats:
        """Return the times of a mark of `look.marks`, NaN where there is none."""
        (place,) = [k for k, mark in enumerate(MARKS) if mark.name == name]
        times: Floats = self.marks[:, place]
        return times


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
