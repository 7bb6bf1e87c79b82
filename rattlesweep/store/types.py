"""Types of runs: R, SS, SW, unclassified (as in the paper), and D.

A run is R if the spin reaches zero by the horizon, else D if hardly any energy is left
or friction holds the spin at zero, else SS if the amplitude of the relevant oscillation
decays monotonically, else SW if the spin leaves its plateau.  Types follow from stored
numbers, so stored runs can be typed again.
"""

from collections.abc import Sequence

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import ArrayLike, NDArray

from rattlesweep.arrays import Flags, Floats, Integers
from rattlesweep.design.columns import floats
from rattlesweep.design.config.schema import Classify

TYPES = ("R", "SS", "SW", "unclassified", "D")
CODE_R, CODE_SS, CODE_SW, CODE_UNCLASSIFIED, CODE_DEAD = range(5)
LEAST_GROWTH = 10.0  # logarithm of the growth that chaos exceeds; see docs/dynamics.md
Z95 = 1.959963984540054  # quantile of the normal distribution for two-sided 95 %


def classify(
    ok: Flags,
    t_r: Floats,
    amp_growth: Floats,
    n_departure: Floats,
    thresholds: Classify,
    energy_left: Floats | None = None,
    is_held: Flags | None = None,
) -> NDArray[np.int8]:
    """Return the indices of types in :data:`TYPES`, -1 for runs that are not ok.

    NaN stands for null.
    """
    is_dead = np.zeros(ok.shape, bool)
    if energy_left is not None:
        is_dead |= energy_left < thresholds.dead_energy
    if is_held is not None:
        is_dead |= is_held
    # The first condition that holds decides.
    cases = {
        -1: ~ok,
        CODE_R: np.isfinite(t_r),
        CODE_DEAD: is_dead,
        CODE_SS: amp_growth <= thresholds.ss_growth,
        CODE_SW: n_departure > thresholds.sw_departure,
    }
    codes = np.select([*cases.values()], [*cases], CODE_UNCLASSIFIED)
    return codes.astype(np.int8)


def is_held_at_end(t_held: Floats, n_end: Floats) -> Flags:
    """Return whether pivoting friction holds the spin at the end of a run.

    The spin is then stored as exactly zero.
    """
    return np.asarray(np.isfinite(t_held) & (n_end == 0.0))


def sure_types(
    codes: NDArray[np.int8],
    reversal_sure: Flags,
    observed: tuple[Floats, Floats],
    errors: tuple[Floats, Floats],
    thresholds: Classify,
) -> Flags:
    """Return whether types cannot change within the errors of growth and departure.

    For R and D this is `reversal_sure`.
    """
    growth, departure = observed
    growth_error, departure_error = errors
    distance = np.abs(growth - thresholds.ss_growth)
    # A tenfold growth is a growth, whatever its error, if the looser run has grown too.
    is_beyond_error = distance > np.minimum(growth_error, 10.0)
    is_far_beyond = distance > growth_error / 10.0
    # A run too short to have a growth is not SS at any tolerance.
    growth_sure = (is_beyond_error & is_far_beyond) | np.isnan(growth)
    departure_sure = np.abs(departure - thresholds.sw_departure) > departure_error
    # A spin that comes within its error of zero may cross it.
    stays_off_zero = 1.0 - departure > departure_error
    spins_on = stays_off_zero & growth_sure & ((codes == CODE_SS) | departure_sure)
    # D is sure if its reversal is: the energy that is left hardly depends on errors of
    # the phase.
    by_reversal = (codes == CODE_R) | (codes == CODE_DEAD)
    return np.where(by_reversal, reversal_sure, spins_on) & (codes >= 0)


def with_types(rows: pa.Table, thresholds: Classify) -> pa.Table:
    """Return stored runs with `type` and `type_sure` for other thresholds."""
    names = rows.schema.names
    t_r = floats(rows.column("t_r"))
    amp_growth = floats(rows.column("amp_growth"))
    n_departure = floats(rows.column("n_departure"))
    energy_left = None
    if "energy_left" in names:
        energy_left = floats(rows.column("energy_left"))
    is_held = None
    if "t_held" in names:
        t_held = floats(rows.column("t_held"))
        is_held = is_held_at_end(t_held, floats(rows.column("n_end")))
    is_ok = pc.equal(rows.column("status"), "ok").to_numpy()
    codes = classify(
        is_ok, t_r, amp_growth, n_departure, thresholds, energy_left, is_held
    )
    indices = pa.array(codes, mask=codes < 0)
    types = pa.DictionaryArray.from_arrays(indices, pa.array(TYPES)).cast(pa.string())
    rows = _with_column(rows, "type", types)
    if "type_sure" not in names:
        return rows
    # The thresholds do not affect whether a reversal is sure.
    reversal_sure = pc.fill_null(rows.column("type_sure"), False).to_numpy()
    is_sure = sure_types(
        codes,
        reversal_sure,
        (amp_growth, n_departure),
        (
            floats(rows.column("amp_growth_error")),
            floats(rows.column("n_departure_error")),
        ),
        thresholds,
    )
    return _with_column(rows, "type_sure", pa.array(is_sure, mask=codes < 0))


def _with_column(rows: pa.Table, name: str, values: pa.Array) -> pa.Table:
    place = rows.schema.get_field_index(name)
    return rows.set_column(place, rows.schema.field(place), values)


def is_chaotic(lyapunov_late: ArrayLike, t_end: ArrayLike) -> Flags:
    """Return whether differences grow by more than e^10 in the second half of a run."""
    growth = np.asarray(lyapunov_late, dtype=float) * np.asarray(t_end, dtype=float) / 2
    return np.asarray(growth > LEAST_GROWTH)


def codes(column: pa.Array, words: Sequence[str] = TYPES) -> Integers:
    """Return the index in `words` of each entry, -1 for other words and null."""
    indices = pc.fill_null(pc.index_in(column, pa.array(words)), -1)
    return np.asarray(indices.to_numpy(zero_copy_only=False).astype(np.int64))


def share(count: ArrayLike, whole: ArrayLike) -> Floats:
    """Return ``count / whole``, NaN where `whole` is zero."""
    count = np.asarray(count, float)
    whole = np.asarray(whole, float)
    result = np.full(count.shape, np.nan)
    with np.errstate(over="ignore"):
        np.divide(count, whole, out=result, where=whole > 0)
    return result


def wilson(count: ArrayLike, whole: ArrayLike, z: float = Z95) -> tuple[Floats, Floats]:
    """Return the ends of the confidence interval of a share.

    By Wilson, J. Am. Stat. Assoc. 22, 209 (1927).
    """
    p = share(count, whole)
    weight = share(np.full(p.shape, z * z), whole)
    centre = (p + weight / 2) / (1 + weight)
    half = np.sqrt(weight * (p * (1 - p) + weight / 4)) / (1 + weight)
    # Shares of 0 and 1 have exact ends, which rounding could move out of the interval.
    low = np.where(p == 0, 0.0, centre - half)
    high = np.where(p == 1, 1.0, centre + half)
    return low, high
