"""What a block knows of its runs when they have ended: records, and what follows.

The columns of `runs` are functions of :class:`Results`, so that a column names its
source where it is declared.  How results are computed is the work of
:mod:`rattlesweep.work.block`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol, TypeAlias

import pyarrow as pa
from numpy.typing import NDArray

from rattlesweep.arrays import Floats, Integers
from rattlesweep.design.prepared import Launches

if TYPE_CHECKING:
    # Commands that read stored runs need no Numba.
    from rattlesweep.integrate.batch import Outcome

# Codes with their words, where -1 is null.
Words: TypeAlias = "tuple[NDArray[Any], Sequence[str]]"
# A column before it is written.
Values: TypeAlias = "NDArray[Any] | pa.Array | Words"


@dataclass(frozen=True)
class ClosedForm:
    """What Garcia and Hubbard's theory says of runs, by the names of an `Outcome`."""

    t_end: Floats
    t_r: Floats
    n_end: Floats
    energy_drift: Floats
    amp_growth: Floats
    n_departure: Floats
    status: Integers
    n_steps: Integers
    near_tangencies: Integers


class InitialStates(NamedTuple):
    """Components of full initial states along the bodies' axes."""

    omega_x: Floats
    omega_y: Floats
    omega_z: Floats
    u_x: Floats
    u_y: Floats
    u_z: Floats


class Results(Protocol):
    """Runs with their results, and what follows from these, as columns over runs."""

    @property
    def launches(self) -> Launches:
        """Bodies, launches and theory of the runs."""

    @property
    def outcome(self) -> Outcome | ClosedForm:
        """What an integration or the closed form says of the runs."""

    @property
    def window(self) -> Floats:
        """Length of one window."""

    @property
    def integrated(self) -> Outcome:
        """The outcome of an integration, for columns that the closed form lacks."""

    @property
    def t_r_error(self) -> Floats:
        """Errors of reversal times."""

    @property
    def amp_growth_error(self) -> Floats:
        """Errors of the growth of amplitudes."""

    @property
    def n_departure_error(self) -> Floats:
        """Errors of the loss of spin."""

    @property
    def tol(self) -> Floats:
        """Tolerances at which runs were integrated."""

    @property
    def status(self) -> Words:
        """Index of the status of each run, and the words."""

    @property
    def type(self) -> Words:
        """Index of the type of each run, and the words."""

    @property
    def type_sure(self) -> pa.Array:
        """Whether the type is the same within the errors."""

    @property
    def n_end(self) -> Floats:
        """Spin at the end; where a run has settled, the spin with all of its energy."""

    @property
    def energy_left(self) -> Floats:
        """Fraction of the initial energy that is left."""

    @property
    def growth(self) -> Floats:
        """Growth rate of the relevant mode, where friction is linear."""

    @property
    def n_growth(self) -> Floats:
        """Spin at which the growth of the relevant mode balances its damping."""

    @property
    def state(self) -> InitialStates:
        """Full initial states."""

    @property
    def n_i_rpm(self) -> Floats:
        """Initial spin in turns a minute."""

    @property
    def t_r_s(self) -> Floats:
        """Reversal time in seconds."""

    @property
    def lyapunov(self) -> Floats:
        """Largest Lyapunov exponent of the whole run."""

    @property
    def lyapunov_late(self) -> Floats:
        """Largest Lyapunov exponent of the second half."""

    @property
    def chaotic(self) -> pa.Array:
        """Whether differences grew by more than `chaos.LEAST_GROWTH` in that half."""

    @property
    def lyapunov_spectrum(self) -> pa.Array:
        """Lyapunov exponents of the whole run, in descending order."""

    @property
    def lyapunov_spectrum_late(self) -> pa.Array:
        """Lyapunov exponents of the second half, in descending order."""

    @property
    def kaplan_yorke(self) -> Floats:
        """Dimension of Kaplan and Yorke."""

    @property
    def regime(self) -> Words:
        """Index of the regime of each run, and the words."""

    @property
    def window_amplitude(self) -> pa.Array:
        """Largest amplitude in each window."""

    @property
    def window_n_min(self) -> pa.Array:
        """Smallest spin in each window."""

    @property
    def window_n_max(self) -> pa.Array:
        """Largest spin in each window."""

    @property
    def n_turns(self) -> pa.Array:
        """Number of turns, null for a run that failed."""

    @property
    def turn_times(self) -> pa.Array:
        """Times of the first turns."""

    @property
    def spin_after_turn(self) -> pa.Array:
        """Largest absolute spins after the first turns."""

    @property
    def reversals_sure(self) -> pa.Array:
        """Number of first turns with a small error."""

    @property
    def reversal_times_error(self) -> pa.Array:
        """Errors of the times of the first turns."""
