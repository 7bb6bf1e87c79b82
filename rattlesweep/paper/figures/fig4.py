"""Fig. 4: the body GH in the unsteady and in the steady direction, up to its first reversals."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
from matplotlib.figure import Figure as Drawing

from rattlesweep.analysis.style import BLUE, INK, VERMILION, new_figure
from rattlesweep.arrays import Floats
from rattlesweep.paper.columns import count, number, schema, table, word
from rattlesweep.paper.figures.follow import FORCE_CHANNELS, FORCES, follow, forces, thinned
from rattlesweep.paper.figures.style import ABOVE, DASHES, N_AXIS, T_AXIS, ZERO, frame, launch
from rattlesweep.paper.workspace import Progress, Tables, between
from rattlesweep.physics.body import Rattleback
from rattlesweep.sweeps.columns import RATE, TIME
from rattlesweep.sweeps.single import Launch

OMEGA_XY0 = 0.01
# Spin, and length, which the paper does not name, of (a) and of (b).
ENDS = {"unsteady": (0.1, 200.0), "steady": (-0.1, 1500.0)}
INTEGRATOR = {"method": "dop853", "tol": 1e-12}
BINS = 900
COMPONENTS = ("omega_x", "omega_y")

RUN = word("run", "unsteady (a) or steady (b)")
RUNS = schema(
    "",
    RUN,
    *schema("n_i omega_xy0"),
    number("t_r", "first zero of the spin", TIME),
    count("zeros", "zeros of the spin in all"),
    number("t_rgh", "zero of Garcia and Hubbard's solution", TIME),
    number("period", "of the relevant mode without spin", TIME),
    number("frequency_x", "of omega_x about the reversal, from its extrema", RATE),
    number("frequency_y", "of omega_y about the reversal", RATE),
    number("frequency_free", "of that mode alone, without spin, when it is as large as at the "
           "reversal", RATE),
    number("omega_relevant", "frequency of the relevant mode without spin", RATE),
)  # fmt: skip
SERIES = schema(
    "t n", number("n_gh", "spin of Garcia and Hubbard's solution", RATE), more="omega_x omega_y"
)
EXTREMA = schema(
    "",
    RUN,
    word("component", "omega_x or omega_y"),
    number("t", "time", TIME),
    number("amplitude", "local maximum of the absolute value", RATE),
)


def first_reversals(progress: Progress) -> Tables:
    """Tables ``unsteady`` and ``steady`` (series), ``runs``, ``extrema`` and ``forces``."""
    tables: dict[str, pa.Table] = {}
    rows, presses, extrema = [], [], []
    for k, (name, (n_i, t_end)) in enumerate(ENDS.items()):
        gh = Launch(Rattleback.gh(), n_i, OMEGA_XY0, t_end, integrator=INTEGRATOR)
        channels, part = ("t", "n", "n_gh", *COMPONENTS, *FORCE_CHANNELS), (k / 2, (k + 1) / 2)
        found, course = follow(gh, channels, f"GH at n_i = {n_i:g}", between(progress, *part))
        modes = course.launches.modes
        relevant = float((modes.omega_p if n_i > 0 else modes.omega_r)[0])
        period = 2 * np.pi / relevant
        t_r = float(found.zeros[0]) if len(found.zeros) else None
        row: dict[str, Any] = {
            "run": name, "n_i": n_i, "omega_xy0": OMEGA_XY0, "t_r": t_r,
            "zeros": len(found.zeros), "t_rgh": float(course.launches.gh.t_rgh[0]),
            "period": period, "omega_relevant": relevant,
        }  # fmt: skip
        for component in COMPONENTS:
            t, size = maxima(found.table["t"].to_numpy(), found.table[component].to_numpy())
            own = {"run": name, "component": component, "t": t, "amplitude": size}
            extrema.append(table(own, EXTREMA))
            row[f"frequency_{component[-1]}"] = frequency(t, t_r, 10 * period)
        main = COMPONENTS[0 if n_i > 0 else 1]
        largest = float(found.table[main].abs().max())
        row["frequency_free"] = free_frequency(largest, main, 20 * period)
        rows.append(row)
        presses.append(forces(f"Fig. 4, n_i = {n_i:g}", found.table))
        tables[name] = thinned(found.table, SERIES, dict.fromkeys(("n", *COMPONENTS), BINS))
    return tables | {
        "runs": table(rows, RUNS),
        "extrema": pa.concat_tables(extrema),
        "forces": table(presses, FORCES),
    }


def maxima(t: Floats, values: Floats) -> tuple[Floats, Floats]:
    """Times and heights of the local maxima of a curve's modulus, by a parabola through three."""
    size = np.abs(values)
    k = 1 + np.flatnonzero((size[1:-1] >= size[:-2]) & (size[1:-1] > size[2:]))
    before, here, after = size[k - 1], size[k], size[k + 1]
    bend = before - 2 * here + after
    shift = 0.5 * (before - after) / bend
    return t[k] + shift * (t[1] - t[0]), here - 0.25 * (before - after) * shift


def frequency(extrema: Floats, middle: float | None, width: float) -> float | None:
    """Angular frequency from the mean distance of the extrema within ``width`` of a time."""
    if middle is None:
        return None
    near = extrema[np.abs(extrema - middle) < width]
    return float(np.pi * (len(near) - 1) / (near[-1] - near[0])) if len(near) > 1 else None


def free_frequency(size: float, main: str, length: float) -> float | None:
    """Frequency of a mode of GH alone, launched with this rate and nearly no spin."""
    mode = "pitch" if main == "omega_x" else "roll"
    alone = Launch(Rattleback.gh(), 1e-6, size, length, psi=mode, integrator=INTEGRATOR)
    found, _ = follow(alone, ("t", main), "a mode alone", lambda share, words: None, dt=0.01)
    t, _ = maxima(found.table["t"].to_numpy(), found.table[main].to_numpy())
    # Its first periods: it drives the spin, and that it.
    return frequency(t, length / 8, length / 8)


def draw(tables: Tables) -> Drawing:
    """(a) to the left, (b) to the right, spin above the oscillations."""
    figure = new_figure(9.2, 6.0)
    axes = figure.subplots(3, 2, sharex="col")
    runs = {row["run"]: row for row in tables["runs"].to_pylist()}
    for column, letter, name in zip(axes.T, "ab", ("unsteady", "steady"), strict=True):
        _column(column, letter, runs[name], tables[name].to_pandas())
    # omega_x and omega_y share their scale, so that (a) and (b) can be compared.
    most = max(max(map(abs, axis.get_ylim())) for axis in axes[1:].ravel())
    for axis in axes[1:].ravel():
        axis.set_ylim(-most, most)
    figure.legend(*axes[0, 0].get_legend_handles_labels(), ncols=3, **ABOVE)
    return figure


def _column(axes: Any, letter: str, run: dict[str, Any], series: pd.DataFrame) -> None:
    t, t_r = series["t"], run["t_r"]
    spin, *oscillations = axes
    spin.plot(t, series["n"], color=BLUE, linewidth=1.1, label="full dynamics")
    spin.plot(t, series["n_gh"], color=INK, linewidth=1.1, linestyle=DASHES,
              label=r"Garcia and Hubbard, $\overline{n}(t)$")  # fmt: skip
    spin.axhline(0, **ZERO)
    spin.set_ylabel(N_AXIS)
    for axis, name in zip(oscillations, COMPONENTS, strict=True):
        axis.plot(t, series[name], color=BLUE, linewidth=0.5)
        axis.set_ylabel(rf"$\omega_{name[-1]}$ / $\tilde\omega$")
    for k, axis in enumerate(axes, start=1):
        if t_r is not None:
            axis.axvline(t_r, color=VERMILION, linewidth=0.9, linestyle=":",
                         label="first reversal" if k == 1 else None)  # fmt: skip
        axis.set_xlim(0, t.iloc[-1])
        frame(axis, f"({letter}-{k})", loc="left")
    if t_r is not None:
        # Where the spin is not: after a reversal it is of the other sign.
        symbol = f"t_{{r{'u' if run['n_i'] > 0 else 's'}}}"
        spin.text(t_r + 0.02 * t.iloc[-1], 0.85 * run["n_i"], f"${symbol} = {t_r:.1f}$",
                  color="#A33B00", fontsize=9.5, va="center")  # fmt: skip
    frame(spin, f"GH, {launch(run, 'n_i', 'omega_xy0')}")
    axes[-1].set_xlabel(T_AXIS)
