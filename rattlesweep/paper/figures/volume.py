"""Phase volume along the runs of Fig. 9, which Liouville's theorem would keep as it is."""

from __future__ import annotations

import numpy as np
import pandas as pd
from matplotlib.figure import Figure as Drawing
from numba import vectorize
from scipy.integrate import cumulative_trapezoid

from rattlesweep.analysis.style import BLUE
from rattlesweep.arrays import Floats
from rattlesweep.paper.figures.fig9 import BINS, BODIES, N_I, OMEGA_XY0, T_END, TOL, panels
from rattlesweep.paper.figures.single import follow, thinned
from rattlesweep.paper.workspace import Report, Tables
from rattlesweep.physics import full
from rattlesweep.physics.body import PARAMETERS, Rattleback
from rattlesweep.physics.full import rhs

STATE = ("u_x", "u_y", "u_z", "omega_x", "omega_y", "omega_z")
# Parts of a run whose scatter gives the error of its mean rate.
PARTS = 10


@vectorize
def volume_rate(p, q, a, b, c, ix, iy, iz, cxx, cxy, cyy):  # type: ignore[no-untyped-def]
    """Return the relative rate at which the flow changes phase volume, in ``sqrt(g/a)``.

    The volume is that of the sphere of directions u times that of omega.  At fixed omega u only
    turns, so the rate is the divergence of d(omega)/dt in omega (Eq. (11) [diff-omega]), which is
    of second degree in omega: central differences are exact, whatever their step.

    Parameters
    ----------
    p, q, a, b, c, ix, iy, iz, cxx, cxy, cyy : array_like
        State and constants of :mod:`rattlesweep.physics.full`; they broadcast.
    """
    x = rhs(p, q, a + 1, b, c, ix, iy, iz, cxx, cxy, cyy)[2]
    x -= rhs(p, q, a - 1, b, c, ix, iy, iz, cxx, cxy, cyy)[2]
    y = rhs(p, q, a, b + 1, c, ix, iy, iz, cxx, cxy, cyy)[3]
    y -= rhs(p, q, a, b - 1, c, ix, iy, iz, cxx, cxy, cyy)[3]
    z = rhs(p, q, a, b, c + 1, ix, iy, iz, cxx, cxy, cyy)[4]
    z -= rhs(p, q, a, b, c - 1, ix, iy, iz, cxx, cxy, cyy)[4]
    return (x + y + z) / 2


def accumulated(table: pd.DataFrame, body: Rattleback) -> Floats:
    """Return the logarithm of the phase volume along a run, 0 at its launch."""
    constants = full.constants(*(getattr(body, name) for name in PARAMETERS))
    u_x, u_y, u_z, *omega = (table[name].to_numpy() for name in STATE)
    rate = volume_rate(u_x / u_z, u_y / u_z, *omega, *constants)
    values: Floats = cumulative_trapezoid(rate, table["t"].to_numpy(), initial=0)
    return values


def data(report: Report, *, t_end: float = T_END) -> Tables:
    """Return the tables ``series``, as drawn, and ``rates``: the mean rate, one row a run.

    The rate is that of the second half, its error that of the mean of ten parts of this time;
    ``volume_late`` is the largest volume there.
    """
    series, rows = [], []
    for k, body in enumerate(BODIES):
        found = follow(body, f"GH with theta = {body.theta:g}", "n", *STATE, n_i=N_I,
                       omega_xy0=OMEGA_XY0, t_end=t_end, tol=TOL)  # fmt: skip
        t, volume = found.table["t"].to_numpy(), accumulated(found.table, body)
        parts = np.interp(np.linspace(t_end / 2, t_end, PARTS + 1), t, volume)
        rates = np.diff(parts) / (t_end / 2 / PARTS)
        rows.append(
            {"theta": body.theta, "volume_low": volume.min(), "volume_high": volume.max(),
             "volume_late": volume[t >= t_end / 2].max(), "rate": rates.mean(),
             "error": rates.std(ddof=1) / np.sqrt(PARTS)}
        )  # fmt: skip
        shown = thinned(found.table.assign(volume=volume), volume=BINS)
        series.append(shown.assign(theta=body.theta))
        report((k + 1) / len(BODIES))
    return {"series": pd.concat(series, ignore_index=True), "rates": pd.DataFrame(rows)}


def draw(tables: Tables) -> Drawing:
    """Draw a panel for each run."""
    return panels(tables["series"], "log volume", volume=("full dynamics", BLUE, "-", 0.8))
