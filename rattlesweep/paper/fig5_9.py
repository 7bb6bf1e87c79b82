"""Single runs of GH: Fig. 5, first reversals (G1-G3); Fig. 9, long runs (L1-L4)."""

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from numba import vectorize
from scipy.integrate import cumulative_trapezoid
from scipy.ndimage import maximum_filter1d, uniform_filter1d

from rattlesweep.api import is_chaotic, modes, reversal_time_gh, simulate
from rattlesweep.api.style import (
    BLUE,
    THEORY,
    VERMILION,
    add_legend,
    value_text,
)
from rattlesweep.paper.claim import Measured, every
from rattlesweep.paper.workspace import (
    OMEGA_XY0,
    Made,
    Tables,
    Workspace,
    draw_spin,
    follow_run,
    paper_figure,
    records,
    thinned,
)
from rattlesweep.physics import full, reduced
from rattlesweep.physics.body import PARAMETERS, Rattleback
from rattlesweep.physics.vectors import smooth_volume

# Fig. 5(a) and (b): initial spin and duration.  The paper does not state the durations.
SPINS_AND_TIMES = {"unsteady": (0.1, 200.0), "steady": (-0.1, 1500.0)}
# The oscillations in Fig. 5.
COMPONENTS = ("omega_x", "omega_y")

# Fig. 9: bodies, launch and duration.  The paper does not state the duration.
THETAS = (0.6429, 0.82, 0.9)
LONG_LAUNCH: dict[str, Any] = {"n_i": 0.1, "omega_xy0": OMEGA_XY0}
LONG_T_END = 20_000.0
# Initial E_r of the reduced model, whose initial E_p is that of the launch.
E_R0 = 3e-5
# Tolerance of the runs of Fig. 9.  At 1e-9 the reversals of the first run are up to 7 %
# early.  DOP853 at 1e-13, Verner's method at 1e-12 and RK4 with the paper's step agree
# on all of them to 0.1.
LONG_TOL = 1e-13
REDUCED_TOL = 1e-12
# Tolerance of the longer runs, which give the Lyapunov exponents.  At 1e-9 errors of
# the method hide the exponents of the first one.
EXPONENTS_TOL = 1e-11
# A zero of the spin within this many roll periods of the one before is the same
# reversal.
ONE_REVERSAL = 5
# Parts of a run's second half; their scatter gives the error of the mean rate of phase
# volume.
_PARTS = 10
_STATE = ("u_x", "u_y", "u_z", "omega_x", "omega_y", "omega_z")
_CHANNELS = (
    "n",
    "n_reduced",
    "E_p",
    "E_r",
    "energy_drift",
    "F_normal",
    "F_tangential",
    *_STATE,
)
# Columns of the longer runs.
_BEYOND = ("t_end", "lyapunov_late", "kaplan_yorke", "regime")


@vectorize
def volume_rate(ux, uy, uz, a, b, c, ix, iy, iz, cxx, cxy, cyy):  # type: ignore[no-untyped-def]
    """Return the rate of phase volume of a state ``u`` and ``omega = (a, b, c)``.

    The body is a paraboloid with the constants of `physics.full`.
    """
    y = ux, uy, uz, a, b, c
    return smooth_volume(y, (ix, iy, iz), (cxx, cxy, cyy, 0.0), 0.0)


def reversals(_: Workspace) -> Tables:
    """Return the tables ``unsteady`` and ``steady`` (series), and ``runs``."""
    body = Rattleback.gh()
    tables: dict[str, pd.DataFrame] = {}
    rows = []
    for name, (n_i, t_end) in SPINS_AND_TIMES.items():
        run = follow_run(
            body,
            "n",
            "n_gh",
            *COMPONENTS,
            n_i=n_i,
            omega_xy0=OMEGA_XY0,
            t_end=t_end,
            tol=1e-12,
        )
        tables[name] = run.table
        # The relevant mode is the pitch in the unsteady direction, else the roll.
        omega = modes(body).omega_r
        if n_i > 0:
            omega = modes(body).omega_p
        t_rgh = reversal_time_gh(body, n_i, OMEGA_XY0)
        rows.append(
            {
                "run": name,
                "n_i": n_i,
                "t_r": run.zeros[0],
                "zeros": len(run.zeros),
                "t_rgh": t_rgh,
                "period": 2 * np.pi / float(omega),
            }
        )
    return tables | {"runs": pd.DataFrame(rows)}


def reversal(made: Made, *, name: str, printed: int, when: str) -> Measured:
    """Measure a reversal time, and whether Garcia and Hubbard's is earlier or later.

    The paper has the time `printed`, and theirs is `when`: earlier or later.
    """
    run = next(row for row in records(made["fig5"]["runs"]) if row["run"] == name)
    theory = "earlier" if run["t_rgh"] < run["t_r"] else "later"
    return [abs(run["t_r"] - printed) <= 0.5, theory == when], {
        **run,
        "value": run["t_r"],
        "when": theory,
        "gap": abs(run["t_rgh"] / run["t_r"] - 1),
    }


# Claims G1 and G2.
unsteady_claim = partial(reversal, name="unsteady", printed=112, when="earlier")
steady_claim = partial(reversal, name="steady", printed=810, when="later")


def envelope_claim(made: Made) -> Measured:
    """Measure G3: the amplitudes of omega_x and omega_y around the reversals."""
    checks = []
    rows = []
    ratios = []
    for panel, run in zip("ab", records(made["fig5"]["runs"]), strict=True):
        series = made["fig5"][run["run"]]
        t_r = run["t_r"]
        period = run["period"]
        # In (a) omega_x is largest at the reversal and omega_y has a dip; in (b) the
        # two swap their roles.
        main, dipping = COMPONENTS
        if panel == "b":
            dipping, main = COMPONENTS
        big = envelope(series, main, t_r, period)
        dip = envelope(series, dipping, t_r, period)
        late, off = ((t - t_r) / period for t in (big["top_t"], dip["low_t"]))
        deep = dip["low"] / min(dip["left"], dip["right"])
        checks += [abs(late) <= 2, abs(off) <= 2 and deep <= 0.75]
        names = {"part": panel, "main": main, "other": dipping}
        times = {"late": late, "off": off}
        top = {"top": big["top"], "top_t": big["top_t"]}
        rows.append(names | times | dip | top)
        near = series[(series["t"] - t_r).abs() < 10 * period]
        ratios += [frequency(near, name) * period / (2 * np.pi) for name in COMPONENTS]
    checks += [
        rows[1]["top"] > rows[0]["top"],
        max(abs(ratio - 1) for ratio in ratios) <= 0.1,
    ]
    return checks, {
        "value": rows[1]["top"] / rows[0]["top"],
        "shapes": rows,
        "ratios": [{"ratio": ratio} for ratio in ratios],
    }


def envelope(
    run: pd.DataFrame, component: str, t_r: float, period: float
) -> dict[str, float]:
    """Return extremes of the envelope, which is the largest modulus in a period.

    They are the ``top``, the largest values to the ``left`` and to the ``right`` of the
    reversal, and the ``low`` between these two; each has its time, such as ``top_t``.
    """
    t = run["t"].to_numpy()
    size = maximum_filter1d(
        run[component].abs().to_numpy(), round(period / (t[1] - t[0]))
    )
    left = int(np.argmax(np.where(t < t_r, size, -1)))
    right = int(np.argmax(np.where(t >= t_r, size, -1)))
    # The minimum is as wide as the filter: take its middle.
    between = size[left : right + 1]
    low = left + int(np.median(np.flatnonzero(between == between.min())))
    top = int(run[component].abs().argmax())
    places = {"top": top, "left": left, "right": right, "low": low}
    values = {name: float(size[place]) for name, place in places.items()}
    return values | {f"{name}_t": float(t[place]) for name, place in places.items()}


def frequency(run: pd.DataFrame, component: str) -> float:
    """Return the angular frequency of a component, from its zeros."""
    t = run["t"].to_numpy()
    values = run[component].to_numpy()
    at = np.flatnonzero(values[1:] * values[:-1] < 0)
    zeros = t[at] - values[at] * (t[1] - t[0]) / (values[at + 1] - values[at])
    return float(np.pi * (len(zeros) - 1) / (zeros[-1] - zeros[0]))


def draw_reversals(tables: Tables) -> Figure:
    """Draw (a) on the left and (b) on the right, the spin above the oscillations."""
    figure = paper_figure(9.2, 6.0)
    # omega_x and omega_y share their scale, so that (a) and (b) can be compared.
    most = 1.1 * max(
        tables[name][[*COMPONENTS]].abs().to_numpy().max() for name in SPINS_AND_TIMES
    )
    axes = figure.subplots(3, 2, sharex="col")
    for letter, run, column in zip("ab", records(tables["runs"]), axes.T, strict=True):
        series = thinned(tables[run["run"]], "n_gh", n=900, omega_x=900, omega_y=900)
        t = series["t"]
        n_i = run["n_i"]
        t_r = run["t_r"]
        spin = column[0]
        draw_spin(spin, series, linewidth=1.1, label="full dynamics")
        spin.plot(
            t, series["n_gh"], label=r"Garcia and Hubbard, $\overline{n}(t)$", **THEORY
        )
        for axis, name in zip(column[1:], COMPONENTS, strict=True):
            axis.plot(t, series[name], color=BLUE, linewidth=0.5)
            axis.set(
                ylim=(-most, most), ylabel=rf"$\omega_{name[-1]}$ / $\tilde\omega$"
            )
        for k, axis in enumerate(column, start=1):
            axis.axvline(
                t_r,
                color=VERMILION,
                linewidth=0.9,
                linestyle=":",
                label="first reversal",
            )
            axis.set_title(f"({letter}-{k})", loc="left")
        # This place is free, because the spin has the other sign after a reversal.
        direction = "u" if n_i > 0 else "s"
        spin.text(
            t_r + 0.02 * t.iloc[-1],
            0.85 * n_i,
            f"$t_{{r{direction}}} = {t_r:.1f}$",
            color="#A33B00",
            va="center",
        )
        spin.set(
            title=f"GH, {value_text('n_i', n_i)}, {value_text('omega_xy0', OMEGA_XY0)}",
            xlim=(0, t.iloc[-1]),
        )
        column[-1].set_xlabel(spin.get_xlabel())
        spin.set_xlabel("")
    add_legend(figure, axes[0, 0].get_legend_handles_labels()[0])
    return figure


def long_runs(ws: Workspace) -> Tables:
    """Return the tables ``spin`` (thinned) and ``runs``.

    The latter has a row for each body, with the exponents of longer runs.
    """
    bodies = [replace(Rattleback.gh(), theta=theta) for theta in THETAS]
    longer = simulate(
        bodies,
        **LONG_LAUNCH,
        **ws.settings,
        tol=EXPONENTS_TOL,
        t_end=ws.sizes.exponents_t_end,
        record=["lyapunov", "spectrum"],
    )
    spin = []
    rows = []
    for body, beyond in zip(bodies, records(longer), strict=True):
        run = follow_run(
            body, *_CHANNELS, **LONG_LAUNCH, t_end=LONG_T_END, e_r0=E_R0, tol=LONG_TOL
        )
        simple = follow_run(
            body,
            "n",
            "energy_drift",
            "C_I",
            model="reduced",
            dt=1.0,
            **LONG_LAUNCH,
            t_end=LONG_T_END,
            e_r0=E_R0,
            tol=REDUCED_TOL,
        )
        table = run.table
        c_i = simple.table["C_I"]
        period = 2 * np.pi / float(modes(body).omega_r)
        # The first zero of each reversal.
        starts = run.zeros[np.diff(run.zeros, prepend=-np.inf) > ONE_REVERSAL * period]
        # The first interval is the transition from the launch to the motion that
        # follows.
        first, *gaps = np.diff(starts)
        # In the reduced model, every zero of the spin is a reversal.
        whole = np.diff(simple.zeros)
        casimir = averaged_casimir(table, body, period)[table["t"] >= starts[0]]
        ratio = table["F_tangential"] / table["F_normal"]
        most = ratio.argmax()
        least = table["F_normal"].argmin()
        rows.append(
            {
                "theta": body.theta,
                "second": starts[1],
                "first": first,
                "mean": np.mean(gaps),
                "scatter": np.std(gaps, ddof=1) / np.mean(gaps),
                "whole": whole.mean(),
                "uneven": whole.std() / whole.mean(),
                "drift": table["energy_drift"].abs().max(),
                "moves": np.ptp(casimir.dropna()),
                "drift_reduced": simple.table["energy_drift"].abs().max(),
                "moves_reduced": np.ptp(c_i),
                "ratio_max": ratio[most],
                "ratio_t": table["t"][most],
                "normal_min": table["F_normal"][least],
                "normal_t": table["t"][least],
                **volume_numbers(table, body),
                **{name: beyond[name] for name in _BEYOND},
                "exponents": listed(beyond["lyapunov_spectrum_late"]),
                "shrinking": sum(beyond["lyapunov_spectrum_late"]),
                # Logarithm of growth in the second half, for which "late" stands.
                "growth": beyond["lyapunov_late"] * beyond["t_end"] / 2,
                "chaotic": bool(is_chaotic(beyond["lyapunov_late"], beyond["t_end"])),
            }
        )
        spin.append(thinned(table, n=1100, n_reduced=550).assign(theta=body.theta))
    return {"spin": pd.concat(spin, ignore_index=True), "runs": pd.DataFrame(rows)}


def listed(exponents: Sequence[float]) -> str:
    """Return Lyapunov exponents as text."""
    return ", ".join(f"{exponent:.2g}" for exponent in exponents)


def averaged_casimir(table: pd.DataFrame, body: Rattleback, period: float) -> pd.Series:
    """Return C_I (Eq. 51) of the energies averaged over a period of the roll."""
    width = round(period / table["t"][1])
    mode = modes(body)
    pitch, roll = (
        uniform_filter1d(table[name].to_numpy(), width) for name in ("E_p", "E_r")
    )
    values = pd.Series(reduced.casimir(pitch, roll, float(mode.K_p), float(mode.K_r)))
    # The last half period has no complete average.
    return values[: -(width // 2)].reindex(table.index)


def volume_numbers(table: pd.DataFrame, body: Rattleback) -> dict[str, float]:
    """Return extremes and mean rate of the logarithm of a run's phase volume."""
    constants = full.constants(*(getattr(body, name) for name in PARAMETERS))
    t = table["t"].to_numpy()
    state = table[[*_STATE]].to_numpy().T
    volume = cumulative_trapezoid(volume_rate(*state, *constants), t, initial=0)
    half = t[-1] / 2
    rates = (
        np.diff(np.interp(np.linspace(half, t[-1], _PARTS + 1), t, volume))
        * _PARTS
        / half
    )
    return {
        "volume_low": volume.min(),
        "volume_high": volume.max(),
        "volume_late": volume[t >= half].max(),
        "rate": rates.mean(),
        "error": rates.std(ddof=1) / np.sqrt(_PARTS),
    }


def kinds_claim(made: Made) -> Measured:
    """Measure L1: which of the long runs are quasi-periodic and which are chaotic."""
    a, b, c = records(made["fig9"]["runs"])
    checks = [
        b["chaotic"] and max(a["scatter"], c["scatter"]) < 0.05,
        not a["chaotic"],
        abs(a["mean"] / a["whole"] - 1) < 0.05,
        abs(b["second"] / 3000 - 1) < 0.05,
        b["scatter"] > 0.2,
        c["mean"] < 0.5 * c["whole"] and c["first"] > 2 * c["mean"],
        not c["chaotic"],
    ]
    doubling = np.log(2) / c["lyapunov_late"]
    narrow = []
    if c["chaotic"]:
        gaps = doubling / c["mean"]
        narrow = [{"doubling": doubling, "gaps": gaps, "scatter": c["scatter"]}]
    return checks, {
        "value": b["lyapunov_late"],
        "runs": [a, b, c],
        "second": b["second"],
        "t_end": b["t_end"],
        "narrow": narrow,
    }


def invariant_claim(made: Made) -> Measured:
    """Measure L2: what the two models conserve."""
    rows = made["fig9"]["runs"]
    most = rows.max()
    checks = [
        most["uneven"] < 1e-6,
        every(rows["drift_reduced"] < 1e-8),
        every(rows["moves_reduced"] < 1e-5),
        every(rows["drift"] < 1e-8),
        every(rows["moves"] > 1),
    ]
    return checks, {
        "value": rows["moves"].min(),
        "energy": most["drift_reduced"],
        "drift": most["drift"],
        "casimir": most["moves_reduced"],
        "uneven": most["uneven"],
        "moved": records(rows),
    }


def force_claim(made: Made) -> Measured:
    """Measure L3: the ratio of the contact forces."""
    rows = made["fig9"]["runs"]
    value = rows["ratio_max"].max()
    checks = [round(value, 1) == 0.2, every(rows["normal_min"] > 0)]
    return checks, {"value": value, "runs": records(rows)}


def volume_claim(made: Made) -> Measured:
    """Measure L4: the phase volume along the long runs."""
    rows = made["fig9"]["runs"]
    checks = [
        every(rows["volume_high"] - rows["volume_low"] > 1),
        every(rows["volume_late"][1:] < -1),
        every(rows["regime"] == "attractor"),
    ]
    value = rows["rate"][1]
    half = 2 * rows["error"][1]
    return checks, {
        "value": value,
        "low": value - half,
        "high": value + half,
        "runs": records(rows),
        "t_end": rows["t_end"].iloc[0],
    }


def draw_long_runs(tables: Tables) -> Figure:
    """Draw a panel for each run."""
    figure = paper_figure(8.2, 6.4)
    axes = figure.subplots(len(THETAS), 1, sharex=True, sharey=True)
    for axis, letter, theta in zip(axes, "abc", THETAS, strict=True):
        series = tables["spin"].query("theta == @theta")
        draw_spin(axis, series, label="full dynamics")
        look = THEORY | {"color": VERMILION, "label": "reduced model"}
        axis.plot(series["t"], series["n_reduced"], **look)
        axis.set_title(f"({letter}) {value_text('theta', theta)}", loc="left")
        axis.set_xlim(0, LONG_T_END)
        axis.label_outer()
    add_legend(figure, axes[0].get_legend_handles_labels()[0])
    return figure
