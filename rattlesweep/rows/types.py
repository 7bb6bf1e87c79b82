"""Types of runs: R, SS, SW, unclassified (as in the paper), and D.

A run is R if the spin reaches zero by the horizon, else D if hardly any energy is left
or friction holds the spin at zero, else SS if the amplitude of the relevant oscillation
decays monotonically, else SW if the spin leaves its plateau.  With friction, the
plateau falls as the spin of a body that does not oscillate.  Types follow from stored
numbers, so stored runs can be typed again.
"""

from collections.abc import Mapping, Sequence

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import NDArray

from rattlesweep.arrays import Flags, Floats, Integers
from rattlesweep.config.schema import Classify
from rattlesweep.rows.arrow import floats

TYPES = ("R", "SS", "SW", "unclassified", "D")
CODE_R, CODE_SS, CODE_SW, CODE_UNCLASSIFIED, CODE_DEAD = range(5)


def classify(
    ok: Flags,
    t_r: Floats,
    amp_growth: Floats,
    n_departure: Floats,
    thresholds: Classify,
    energy_left: Floats | None = None,
    is_held: Flags | None = None,
    slowed: Floats | None = None,
) -> NDArray[np.int8]:
    """Return the indices of types in :data:`TYPES`, -1 for runs that are not ok.

    NaN stands for null.  `slowed` is the part of the departure that friction takes from
    any spin, see :func:`slowed_by_friction`.
    """
    own_departure = n_departure
    if slowed is not None:
        own_departure = n_departure - slowed
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
        CODE_SW: own_departure > thresholds.sw_departure,
    }
    codes = np.select([*cases.values()], [*cases], CODE_UNCLASSIFIED)
    return codes.astype(np.int8)


def is_held_at_end(t_held: Floats, n_end: Floats) -> Flags:
    """Return whether pivoting friction holds the spin at the end of a run.

    The spin is then stored as exactly zero.
    """
    return np.isfinite(t_held) & (n_end == 0.0)


def living(energy_left: Floats, base_acceleration: Floats | None) -> Floats:
    """Return the fraction of energy that is left, infinite where the plane shakes.

    It can wake a body that has none.
    """
    if base_acceleration is None:
        return energy_left
    return np.where(base_acceleration > 0, np.inf, energy_left)


def slowed_by_friction(
    t_end: Floats, n_i: Floats, gamma: Floats, losses: Mapping[str, Floats]
) -> Floats:
    """Return the part of a spin without oscillation that friction takes by the end.

    The torques are -sigma n and, against the spin, that of the lever of pivoting.
    """
    nothing = np.zeros(t_end.shape)
    with np.errstate(divide="ignore", invalid="ignore"):
        by_sigma = losses.get("sigma", nothing) * t_end / gamma
        by_pivot = losses.get("pivot", nothing) * t_end / (gamma * np.abs(n_i))
        falling = np.where(by_sigma > 0, -np.expm1(-by_sigma) / by_sigma, 1.0)
        slowed = np.minimum((by_sigma + by_pivot) * falling, 1.0)
    # A tap has no spin to lose.
    return np.nan_to_num(slowed)


def sure_types(
    codes: NDArray[np.int8],
    reversal_sure: Flags,
    observed: tuple[Floats, Floats],
    errors: tuple[Floats, Floats],
    thresholds: Classify,
    slowed: Floats | None = None,
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
    own_departure = departure
    if slowed is not None:
        own_departure = departure - slowed
    departure_sure = np.abs(own_departure - thresholds.sw_departure) > departure_error
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
        if "base_acceleration" in names:
            shaken = floats(rows.column("base_acceleration"))
            energy_left = living(energy_left, shaken)
    is_held = None
    if "t_held" in names:
        t_held = floats(rows.column("t_held"))
        is_held = is_held_at_end(t_held, floats(rows.column("n_end")))
    losses = {
        name: floats(rows.column(name)) for name in ("sigma", "pivot") if name in names
    }
    slowed = None
    if losses:
        slowed = slowed_by_friction(
            floats(rows.column("t_end")),
            floats(rows.column("n_i")),
            floats(rows.column("gamma")),
            losses,
        )
    is_ok = pc.equal(rows.column("status"), "ok").to_numpy()
    codes = classify(
        is_ok, t_r, amp_growth, n_departure, thresholds, energy_left, is_held, slowed
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
        slowed,
    )
    return _with_column(rows, "type_sure", pa.array(is_sure, mask=codes < 0))


def _with_column(rows: pa.Table, name: str, values: pa.Array) -> pa.Table:
    place = rows.schema.get_field_index(name)
    return rows.set_column(place, rows.schema.field(place), values)


def codes(column: pa.Array, words: Sequence[str] = TYPES) -> Integers:
    """Return the index in `words` of each entry, -1 for other words and null."""
    indices = pc.fill_null(pc.index_in(column, pa.array(words)), -1)
    return indices.to_numpy(zero_copy_only=False).astype(np.int64)
