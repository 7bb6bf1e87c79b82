"""Types of runs: R, SS, SW, unclassified (the paper, "Steady initial spin direction"),
and D.

A run is R if the spin reaches zero by the horizon, else D if hardly any energy is left,
else SS if the amplitude of the relevant oscillation decays monotonically, else SW if
the spin leaves its plateau.  Types follow from stored numbers, so stored runs can be
typed again.
"""

from collections.abc import Sequence

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import ArrayLike, NDArray

from rattlesweep.arrays import Flags, Floats, Integers
from rattlesweep.sweeps.columns import floats
from rattlesweep.sweeps.config.schema import Classify

TYPES = ("R", "SS", "SW", "unclassified", "D")
R, SS, SW, UNCLASSIFIED, DEAD = range(5)
LEAST_GROWTH = 10.0  # logarithm of the growth that chaos exceeds; see docs/dynamics.md
Z95 = 1.959963984540054  # quantile of the normal distribution for two-sided 95 %


def classify(
    ok: Flags,
    t_r: Floats,
    amp_growth: Floats,
    n_departure: Floats,
    thresholds: Classify,
    energy_left: Floats | None = None,
) -> NDArray[np.int8]:
    """Return the indices of types in :data:`TYPES`, -1 for runs that are not ok; NaN is
    null.
    """
    dead = (
        np.zeros(ok.shape, bool)
        if energy_left is None
        else energy_left < thresholds.dead_energy
    )
    decays, departs = (
        amp_growth <= thresholds.ss_growth,
        n_departure > thresholds.sw_departure,
    )
    conditions = [~ok, np.isfinite(t_r), dead, decays, departs]
    return np.select(conditions, [-1, R, DEAD, SS, SW], UNCLASSIFIED).astype(np.int8)


def sure_types(
    codes: NDArray[np.int8],
    reversal_sure: Flags,
    observed: tuple[Floats, Floats],
    errors: tuple[Floats, Floats],
    thresholds: Classify,
) -> Flags:
    """Return whether types cannot change within `errors`; for R and D this is
    `reversal_sure`.
    """
    (growth, departure), (growth_error, departure_error) = observed, errors
    distance = np.abs(growth - thresholds.ss_growth)
    # A tenfold growth is a growth, whatever its error, if the looser run has grown too.
    growth_sure = (distance > np.minimum(growth_error, 10.0)) & (
        distance > growth_error / 10.0
    )
    # A run too short to have a growth is not SS at any tolerance.
    growth_sure |= np.isnan(growth)
    departure_sure = np.abs(departure - thresholds.sw_departure) > departure_error
    # A spin that comes within its error of zero may cross it.
    no_crossing = 1.0 - departure > departure_error
    # D is sure if its reversal is: the energy that is left hardly depends on errors of
    # the phase.
    others = no_crossing & growth_sure & ((codes == SS) | departure_sure)
    return np.where((codes == R) | (codes == DEAD), reversal_sure, others) & (
        codes >= 0
    )


def with_types(rows: pa.Table, thresholds: Classify) -> pa.Table:
    """Return stored runs with `type` and `type_sure` for other thresholds."""
    names = {"t_r", "amp_growth", "n_departure", "energy_left"}
    names |= {"amp_growth_error", "n_departure_error"}
    x = {name: floats(rows.column(name)) for name in names & set(rows.schema.names)}
    observed = x["amp_growth"], x["n_departure"]
    ok = pc.equal(rows.column("status"), "ok").to_numpy()
    codes = classify(ok, x["t_r"], *observed, thresholds, x.get("energy_left"))
    indices = pa.array(codes, mask=codes < 0)
    changed = {
        "type": pa.DictionaryArray.from_arrays(indices, pa.array(TYPES)).cast(
            pa.string()
        )
    }
    if "type_sure" in rows.schema.names:
        # The thresholds do not affect whether a reversal is sure.
        before = pc.fill_null(rows.column("type_sure"), False).to_numpy()
        errors = x["amp_growth_error"], x["n_departure_error"]
        sure = sure_types(codes, before, observed, errors, thresholds)
        changed["type_sure"] = pa.array(sure, mask=codes < 0)
    for name, values in changed.items():
        place = rows.schema.get_field_index(name)
        rows = rows.set_column(place, rows.schema.field(place), values)
    return rows


def is_chaotic(lyapunov_late: ArrayLike, t_end: ArrayLike) -> Flags:
    """Return whether differences grow by more than e^10 in the second half of a run."""
    growth = np.asarray(lyapunov_late, dtype=float) * np.asarray(t_end, dtype=float) / 2
    return np.asarray(growth > LEAST_GROWTH)


def codes(column: pa.Array, words: Sequence[str] = TYPES) -> Integers:
    """Return the index in `words` of each entry, -1 for other words and null."""
    found = pc.fill_null(pc.index_in(column, pa.array(words)), -1)
    return np.asarray(found.to_numpy(zero_copy_only=False).astype(np.int64))


def share(part: ArrayLike, whole: ArrayLike) -> Floats:
    """Return ``part / whole``, NaN where `whole` is zero."""
    part, whole = np.asarray(part, float), np.asarray(whole, float)
    with np.errstate(over="ignore"):
        result: Floats = np.divide(
            part, whole, out=np.full(part.shape, np.nan), where=whole > 0
        )
    return result


def wilson(part: ArrayLike, whole: ArrayLike, z: float = Z95) -> tuple[Floats, Floats]:
    """Return the confidence interval of a share (Wilson, J. Am. Stat. Assoc. 22, 209,
    1927).
    """
    part, whole = np.asarray(part, float), np.asarray(whole, float)
    p, weight = share(part, whole), share(np.full(part.shape, z * z), whole)
    centre = (p + weight / 2) / (1 + weight)
    half = np.sqrt(weight * (p * (1 - p) + weight / 4)) / (1 + weight)
    # Exact ends for shares of 0 and 1, which rounding could move out of the unit
    # interval.
    return np.where(p == 0, 0.0, centre - half), np.where(p == 1, 1.0, centre + half)
