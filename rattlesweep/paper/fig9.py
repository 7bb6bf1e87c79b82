"""Fig. 9: three long runs, through many reversals, with the reduced model beside.

Beside the paper's figure: the phase volume along the runs, which Liouville's theorem would keep as
it is, and their Lyapunov exponents.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from numba import vectorize
from scipy.integrate import cumulative_trapezoid
from scipy.ndimage import uniform_filter1d

from rattlesweep.analysis.style import BLUE, VERMILION, new_figure
from rattlesweep.api import modes, simulate
from rattlesweep.api.single import Trajectory
from rattlesweep.arrays import Floats
from rattlesweep.paper.frames import (
    ABOVE,
    DASHES,
    N_AXIS,
    T_AXIS,
    ZERO,
    follow,
    frame,
    launch,
    thinned,
)
from rattlesweep.paper.workspace import Tables, Workspace
from rattlesweep.physics import full, reduced
from rattlesweep.physics.body import PARAMETERS, Rattleback
from rattlesweep.sweeps.types import is_chaotic

THETAS = (0.6429, 0.82, 0.9)
LAUNCH: dict[str, Any] = {"n_i": 0.1, "omega_xy0": 0.01}
# Energy of the roll with which the reduced model begins; its E_p is the launch's.
E_R0 = 3e-5
# Not named in the paper.
T_END = 20_000.0
# At 1e-9 the reversals of the first run come up to 7 % early; 1e-13, Verner's method at 1e-12 and
# RK4 with the paper's step agree to 0.1 on all of them.
TOL, REDUCED_TOL = 1e-13, 1e-12
BINS = 1100
# Zeros of the spin closer to each other than so many periods of the roll are one reversal.
ONE_REVERSAL = 5
# Parts of the second half of a run whose scatter gives the error of its mean rate of volume.
PARTS = 10
STATE = ("u_x", "u_y", "u_z", "omega_x", "omega_y", "omega_z")
CHANNELS = ("n", "n_reduced", "E_p", "E_r", "energy_drift", "F_normal", "F_tangential", *STATE)


def body_of(theta: float) -> Rattleback:
    """Return GH with another curvature."""
    return replace(Rattleback.gh(), theta=theta)


@cache
def long_run(theta: float) -> Trajectory:
    """Integrate a run of the figure; both of its tables are made from the same one."""
    return follow(body_of(theta), *CHANNELS, **LAUNCH, t_end=T_END, e_r0=E_R0, tol=TOL)


def data(_: Workspace) -> Tables:
    """Return the tables of the three runs."""
    spin, reversals, invariants, forces = [], [], [], []
    for theta in THETAS:
        found, body = long_run(theta), body_of(theta)
        simple = follow(body, "n", "energy_drift", "C_I", model="reduced", dt=1.0, **LAUNCH,
                        t_end=T_END, e_r0=E_R0, tol=REDUCED_TOL)  # fmt: skip
        table = found.table
        starts = first_zeros(found.zeros, ONE_REVERSAL * 2 * np.pi / float(modes(body).omega_r))
        casimir = averaged_casimir(table, body)[table["t"] >= starts[0]]
        for model, zeros, series, c_i in (
            ("full", starts, table, casimir),
            ("reduced", simple.zeros, simple.table, simple.table["C_I"]),
        ):
            key = {"theta": theta, "model": model}
            reversals.append(pd.DataFrame(key | {"t": zeros}))
            drift, ends = series["energy_drift"].abs().max(), (np.nanmin(c_i), np.nanmax(c_i))
            invariants.append(
                key | {"energy_drift": drift, "casimir_low": ends[0], "casimir_high": ends[1]}
            )
        ratio = table["F_tangential"] / table["F_normal"]
        most, least = ratio.argmax(), table["F_normal"].argmin()
        forces.append(
            {"theta": theta, "ratio_max": ratio[most], "ratio_t": table["t"][most],
             "normal_min": table["F_normal"][least], "normal_t": table["t"][least]}
        )  # fmt: skip
        spin.append(thinned(table, n=BINS, n_reduced=BINS // 2).assign(theta=theta))
    return {
        "spin": pd.concat(spin, ignore_index=True),
        "reversals": pd.concat(reversals, ignore_index=True),
        "invariants": pd.DataFrame(invariants),
        "forces": pd.DataFrame(forces),
    }


def first_zeros(zeros: Floats, gap: float) -> Floats:
    """Return the first of each group of zeros that are farther than ``gap`` from each other."""
    return zeros[np.diff(zeros, prepend=-np.inf) > gap]


def averaged_casimir(table: pd.DataFrame, body: Rattleback) -> Floats:
    """Return C_I (Eq. (51) [casimir]) of the energies averaged over a period of the roll."""
    found = modes(body)
    width = round(2 * np.pi / float(found.omega_r) / (table["t"][1] - table["t"][0]))
    pitch, roll = (
        uniform_filter1d(table[name].to_numpy(), width, mode="nearest") for name in ("E_p", "E_r")
    )
    values: Floats = reduced.casimir(pitch, roll, float(found.K_p), float(found.K_r))
    # Half a period at the end has no whole average.
    values[-(width // 2) :] = np.nan
    return values


@vectorize
def volume_rate(p, q, a, b, c, ix, iy, iz, cxx, cxy, cyy):  # type: ignore[no-untyped-def]
    """Return the relative rate at which the flow changes phase volume, in ``sqrt(g/a)``.

    At fixed omega u only turns, so it is the divergence of d(omega)/dt in omega (Eq. (11)
    [diff-omega]), which is of second degree: central differences are exact, whatever their step.
    """
    x = full.rhs(p, q, a + 1, b, c, ix, iy, iz, cxx, cxy, cyy)[2]
    x -= full.rhs(p, q, a - 1, b, c, ix, iy, iz, cxx, cxy, cyy)[2]
    y = full.rhs(p, q, a, b + 1, c, ix, iy, iz, cxx, cxy, cyy)[3]
    y -= full.rhs(p, q, a, b - 1, c, ix, iy, iz, cxx, cxy, cyy)[3]
    z = full.rhs(p, q, a, b, c + 1, ix, iy, iz, cxx, cxy, cyy)[4]
    z -= full.rhs(p, q, a, b, c - 1, ix, iy, iz, cxx, cxy, cyy)[4]
    return (x + y + z) / 2


def volumes(_: Workspace) -> Tables:
    """Return ``series``, the logarithm of the phase volume, and ``rates``, one row a run."""
    series, rows = [], []
    for theta in THETAS:
        table = long_run(theta).table
        constants = full.constants(*(getattr(body_of(theta), name) for name in PARAMETERS))
        u_x, u_y, u_z, *omega = (table[name].to_numpy() for name in STATE)
        t, rate = table["t"].to_numpy(), volume_rate(u_x / u_z, u_y / u_z, *omega, *constants)
        volume = cumulative_trapezoid(rate, t, initial=0)
        half = t[-1] / 2
        rates = np.diff(np.interp(np.linspace(half, t[-1], PARTS + 1), t, volume)) * PARTS / half
        rows.append(
            {"theta": theta, "volume_low": volume.min(), "volume_high": volume.max(),
             "volume_late": volume[t >= half].max(), "rate": rates.mean(),
             "error": rates.std(ddof=1) / np.sqrt(PARTS)}
        )  # fmt: skip
        shown = thinned(pd.DataFrame({"t": t, "volume": volume}), volume=BINS)
        series.append(shown.assign(theta=theta))
    return {"series": pd.concat(series, ignore_index=True), "rates": pd.DataFrame(rows)}


def exponents(ws: Workspace) -> Tables:
    """Return the table ``runs``: Lyapunov exponents of the runs, continued to longer times."""
    found = simulate([body_of(theta) for theta in THETAS], **LAUNCH, **ws.settings, tol=TOL,
                     t_end=ws.sizes.exponents_t_end, record=["lyapunov", "reversals"])  # fmt: skip
    names = ["theta", "t_end", "n_turns", "lyapunov", "lyapunov_late"]
    chaotic = is_chaotic(found["lyapunov_late"], found["t_end"])
    growth = found["lyapunov_late"] * found["t_end"] / 2
    return {"runs": found[names].assign(growth=growth, chaotic=chaotic)}


def draw(tables: Tables) -> Figure:
    """Draw a panel for each run."""
    return panels(tables["spin"], N_AXIS, n=("full dynamics", BLUE, "-", 0.8),
                  n_reduced=("reduced model", VERMILION, DASHES, 1.2))  # fmt: skip


def draw_volumes(tables: Tables) -> Figure:
    """Draw the logarithm of the phase volume along each run."""
    return panels(tables["series"], "log volume", volume=("full dynamics", BLUE, "-", 0.8))


def panels(series: pd.DataFrame, label: str, **curves: tuple[str, str, Any, float]) -> Figure:
    """Draw columns of the series of the three runs, each with its words, colour, style, width."""
    figure = new_figure(8.2, 6.4)
    axes = figure.subplots(len(THETAS), 1, sharex=True, sharey=True)
    for axis, (theta, own), letter in zip(axes, series.groupby("theta"), "abc", strict=True):
        for name, (words, colour, style, width) in curves.items():
            axis.plot(own["t"], own[name], color=colour, linewidth=width, linestyle=style,
                      label=words)  # fmt: skip
        axis.axhline(0, **ZERO)
        axis.set_ylabel(label)
        axis.set_xlim(0, own["t"].max())
        frame(axis, f"({letter}) {launch({'theta': theta}, 'theta')}", loc="left")
    axes[-1].set_xlabel(T_AXIS)
    if len(curves) > 1:
        figure.legend(*axes[0].get_legend_handles_labels(), ncols=2, **ABOVE)
    return figure
