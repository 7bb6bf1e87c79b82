"""Fig. 2: cumulative distributions of the pitch and the roll frequencies of the set SD."""

from __future__ import annotations

import numpy as np
import pyarrow as pa
from scipy.stats import ks_2samp

from rattlesweep.paper.data.columns import count, number, schema
from rattlesweep.paper.data.progress import Progress
from rattlesweep.paper.data.sd import BOUND, cumulative, draw_modes
from rattlesweep.physics import theory
from rattlesweep.physics.body import shell_dumbbell
from rattlesweep.sweeps.config.bodies import SdRanges
from rattlesweep.sweeps.tables.columns import RATE

CUMULATIVE = schema(
    "probability",
    number("omega_p", "pitch frequency (Eq. (24) [def-omega_pr])", RATE),
    number("omega_r", "roll frequency (Eq. (24) [def-omega_pr])", RATE),
    number("omega_p0", "pitch frequency at zero skew angle (Eq. (28) [omega_p0])", RATE),
    number("omega_r0", "roll frequency at zero skew angle (Eq. (29) [omega_r0])", RATE),
    number("ratio", "omega_p / omega_r"),
)
SUMMARY = schema(
    "",
    count("samples", "bodies"),
    count("below", f"bodies with omega_p / omega_r at or below {BOUND}"),
    number("ratio_bound", "infimum of omega_p / omega_r over the ranges"),
    *(
        column
        for mode, word in (("p", "pitch"), ("r", "roll"))
        for column in (
            number(f"distance_{mode}", f"largest difference of the {word} distributions"),
            number(f"off_median_{mode}", f"median of abs(omega_{mode}0/omega_{mode} - 1)"),
            number(f"off_p99_{mode}", f"99th percentile of abs(omega_{mode}0/omega_{mode} - 1)"),
        )
    ),
)


def data(bodies: int, progress: Progress, ranges: SdRanges | None = None) -> dict[str, pa.Table]:
    """Data of the figure.

    Returns
    -------
    dict
        ``cumulative``: values at equally spaced probabilities; ``summary``: one row.
    """
    ranges = ranges or SdRanges()
    names = ("omega_p", "omega_r", "omega_p0", "omega_r0")
    found = draw_modes(names, bodies, ranges, progress, share=0.8)
    found["ratio"] = found["omega_p"] / found["omega_r"]
    row: dict[str, float] = {
        "samples": bodies,
        "below": int(np.count_nonzero(found["ratio"] <= BOUND)),
        "ratio_bound": ratio_bound(ranges),
    }
    progress(0.9, "comparing the distributions")
    for mode in ("p", "r"):
        exact, zeroth = found[f"omega_{mode}"], found[f"omega_{mode}0"]
        off = np.abs(zeroth / exact - 1)
        row[f"distance_{mode}"] = float(ks_2samp(exact, zeroth, method="asymp").statistic)
        row[f"off_median_{mode}"], row[f"off_p99_{mode}"] = np.quantile(off, (0.5, 0.99)).tolist()
    progress(1.0, f"{bodies:,} bodies")
    return {
        "cumulative": pa.table(cumulative(found), schema=CUMULATIVE),
        "summary": pa.Table.from_pylist([row], schema=SUMMARY),
    }


def ratio_bound(ranges: SdRanges) -> float:
    """Infimum of ``omega_p / omega_r`` over ranges of bodies whose pitch is the faster mode.

    The product of the squares, ``det H``, does not depend on xi and their sum grows with ``sin^2
    xi``, so the ratio is least at the least skew angle.  There it depends on ``beta/alpha`` and
    ``(1/phi - 1)/(1/theta - 1)`` alone, monotonically in both, and the four pairs of their ends
    decide.  Where pitch and roll can change places this is 1, the bound of any ratio.
    """
    alpha, beta = shell_dumbbell(
        np.array([ranges.gamma[1], ranges.gamma[0]]), np.array([ranges.f_sd[0], ranges.f_sd[1]])
    )
    theta, phi = np.array(ranges.theta), np.array(ranges.phi[::-1])
    xi = -np.radians(ranges.minus_xi_deg[0])
    found = theory.modes(alpha[:, None], beta[:, None], theta, phi, xi)
    if np.any(found.omega_p0 <= found.omega_r0):
        return 1.0
    return float(np.min(found.omega_p / found.omega_r))
