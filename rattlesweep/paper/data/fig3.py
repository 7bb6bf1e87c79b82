"""Fig. 3: distributions of the torque coefficients K_p and K_r of the set SD."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from rattlesweep.paper.data.columns import count, number, schema
from rattlesweep.paper.data.density import Grid, count_bodies
from rattlesweep.paper.data.progress import Progress
from rattlesweep.paper.data.sd import BOUND, cumulative, draw_modes, ranges_array
from rattlesweep.sweeps.config.bodies import SdRanges

# The paper's colour code: nine decades.
DECADES = 9
# Not named in the paper, which has a logarithmic scale for the colours only; no body of Table I
# lies outside.
GRID = Grid(K_p=(0.0, 7.0), K_r=(0.0, 0.4), bins=200)

CUMULATIVE = schema(
    "probability",
    number("K_p", "torque coefficient of the pitch (Eq. (39) [Kp])"),
    number("K_r", "torque coefficient of the roll (Eq. (40) [Kr])"),
    number("ratio", "K_p / K_r"),
)
DENSITY = schema(
    "",
    count("i", "number of the bin of K_p"),
    count("j", "number of the bin of K_r"),
    number("K_p_low", "lower edge of the bin"),
    number("K_p_high", "upper edge of the bin"),
    number("K_r_low", "lower edge of the bin"),
    number("K_r_high", "upper edge of the bin"),
    count("count", "bodies in the bin; bins without any have no row"),
    number("relative_frequency", "count / samples: the paper's P(K_p, K_r)"),
)
SUMMARY = schema(
    "",
    count("samples", "bodies of the cumulative distributions"),
    count("density_samples", "bodies of the density"),
    count("outside", "of these, outside the bins"),
    number("ratio_min", "of these, the least omega_p / omega_r"),
    count("below", f"of these, with omega_p / omega_r below {BOUND}"),
    count("bins", "bins on each axis"),
    *(
        number(f"{name}_{end}", f"{word} end of the binned axis of {name}")
        for name in ("K_p", "K_r")
        for end, word in (("low", "lower"), ("high", "upper"))
    ),
)


def data(
    bodies: int,
    total: int,
    progress: Progress,
    *,
    ranges: SdRanges | None = None,
    grid: Grid = GRID,
    threads: int | None = None,
) -> dict[str, pa.Table]:
    """Data of the figure, the same for any number of threads.

    Parameters
    ----------
    bodies, total : int
        Bodies of (a) and of (b).

    Returns
    -------
    dict
        ``cumulative``: values at equally spaced probabilities; ``density``: bins that hold
        bodies; ``summary``: one row.
    """
    ranges = ranges or SdRanges()
    # A body of part (a) takes ten times as long as one of part (b).
    early = 10 * bodies / (10 * bodies + total)
    found = draw_modes(("K_p", "K_r"), bodies, ranges, progress, share=early)
    found["ratio"] = found["K_p"] / found["K_r"]
    spread = count_bodies(
        total, ranges_array(ranges), grid, limit=BOUND, threads=threads,
        progress=lambda done: progress(
            early + (1 - early) * done, f"{round(done * total):,} of {total:,} bodies"
        ),
    )  # fmt: skip
    i, j = np.nonzero(spread.counts)
    p, r = grid.edges("K_p"), grid.edges("K_r")
    inside = spread.counts[i, j]
    density = [i, j, p[i], p[i + 1], r[j], r[j + 1], inside, inside / total]
    row = [bodies, total, spread.outside, spread.least_ratio, spread.below, grid.bins,
           *grid.K_p, *grid.K_r]  # fmt: skip
    return {
        "cumulative": pa.table(cumulative(found), schema=CUMULATIVE),
        "density": pa.table(density, schema=DENSITY),
        "summary": pa.table([[value] for value in row], schema=SUMMARY),
    }


def grid_of(tables: Mapping[str, pa.Table]) -> Grid:
    """Bins of the density of the figure's tables."""
    row = tables["summary"].to_pylist()[0]
    ends = {name: (row[f"{name}_low"], row[f"{name}_high"]) for name in ("K_p", "K_r")}
    return Grid(**ends, bins=row["bins"])


def counts_of(tables: Mapping[str, pa.Table]) -> NDArray[np.int64]:
    """Bodies in all bins of the figure's tables, shape (bins, bins), by ``K_p`` and ``K_r``."""
    bins = tables["summary"]["bins"][0].as_py()
    counts = np.zeros((bins, bins), dtype=np.int64)
    data = tables["density"]
    counts[data["i"].to_numpy(), data["j"].to_numpy()] = data["count"].to_numpy()
    return counts
