"""Fig. 4: the body GH in the unsteady and in the steady direction, up to its first reversals."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import pyarrow as pa
from pydantic import Field

from rattlesweep.paper.follow import (
    F64,
    FORCE_CHANNELS,
    FORCES,
    I64,
    TEXT,
    column,
    follow,
    forces,
    thin,
)
from rattlesweep.paper.style import frame, new_figure
from rattlesweep.paper.sweeps import part
from rattlesweep.physics.body import Rattleback
from rattlesweep.study.style import BLUE, VERMILION
from rattlesweep.sweeps.config.fields import Base
from rattlesweep.sweeps.tables.columns import RATE, TIME

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import NDArray

    from rattlesweep.paper.sweeps import Place, Report

    Floats = NDArray[np.float64]

BINS = 900
COMPONENTS = ("omega_x", "omega_y")


class Fig4Settings(Base):
    """The two runs of Fig. 4."""

    n_i: float = Field(gt=0, description="Size of the initial spin, in sqrt(g/a).")
    omega_xy0: float = Field(gt=0, description="Initial oscillation, in sqrt(g/a).")
    t_unsteady: float = Field(gt=0, description="Length of part (a), in sqrt(a/g).")
    t_steady: float = Field(gt=0, description="Length of part (b), in sqrt(a/g).")
    tol: float = Field(gt=0, le=1e-4, description="Tolerance of DOP853.")


RUNS = pa.schema(
    [
        column("run", TEXT, "unsteady (a) or steady (b)"),
        column("n_i", F64, "initial spin", RATE),
        column("omega_xy0", F64, "initial rate of the oscillation", RATE),
        column("t_r", F64, "first zero of the spin", TIME),
        column("zeros", I64, "zeros of the spin in all"),
        column("t_rgh", F64, "zero of Garcia and Hubbard's solution", TIME),
        column("period", F64, "of the relevant mode without spin", TIME),
        column("frequency_x", F64, "of omega_x about the reversal, from its extrema", RATE),
        column("frequency_y", F64, "of omega_y about the reversal", RATE),
        column("frequency_free", F64, "of that mode alone, without spin, when it is as large as at "
               "the reversal", RATE),
        column("omega_relevant", F64, "frequency of the relevant mode without spin", RATE),
    ]
)  # fmt: skip
SERIES = pa.schema(
    [
        column("t", F64, "time", TIME),
        column("n", F64, "spin u . omega", RATE),
        column("n_gh", F64, "spin of Garcia and Hubbard's solution", RATE),
        *(column(name, F64, f"angular velocity, body's {name[-1]}", RATE) for name in COMPONENTS),
    ]
)
EXTREMA = pa.schema(
    [
        column("run", TEXT, "unsteady (a) or steady (b)"),
        column("component", TEXT, "omega_x or omega_y"),
        column("t", F64, "time", TIME),
        column("amplitude", F64, "local maximum of the absolute value", RATE),
    ]
)


def compute(place: Place, report: Report) -> dict[str, pa.Table]:
    """Data of the figure.

    Returns
    -------
    dict
        ``unsteady``, ``steady``: the series as drawn; ``runs``: one row a run; ``extrema``: all
        local maxima of the moduli of omega_x and omega_y; ``forces``.
    """
    s = place.paper.fig4
    tables: dict[str, pa.Table] = {}
    rows, presses, extrema = [], [], []
    channels = ("t", "n", "n_gh", *COMPONENTS, *FORCE_CHANNELS)
    ends = {"unsteady": (s.n_i, s.t_unsteady), "steady": (-s.n_i, s.t_steady)}
    for k, (name, (n_i, t_end)) in enumerate(ends.items()):
        found, course = follow(
            Rattleback.gh(), n_i=n_i, omega_xy0=s.omega_xy0, t_end=t_end, channels=channels,
            integrator={"method": "dop853", "tol": s.tol}, words=f"GH at n_i = {n_i:g}",
            report=part(report, k / 2, (k + 1) / 2),
        )  # fmt: skip
        data = found.table
        modes = course.launches.modes
        relevant = float((modes.omega_p if n_i > 0 else modes.omega_r)[0])
        period = 2 * np.pi / relevant
        t_r = float(found.zeros[0]) if len(found.zeros) else None
        row = {
            "run": name, "n_i": n_i, "omega_xy0": s.omega_xy0, "t_r": t_r,
            "zeros": len(found.zeros), "t_rgh": float(course.launches.gh.t_rgh[0]),
            "period": period, "omega_relevant": relevant,
        }  # fmt: skip
        for component in COMPONENTS:
            t, size = maxima(data["t"].to_numpy(), data[component].to_numpy())
            extrema.append(
                pa.table(
                    {"run": [name] * len(t), "component": [component] * len(t), "t": t,
                     "amplitude": size},
                    schema=EXTREMA,
                )
            )  # fmt: skip
            row[f"frequency_{component[-1]}"] = frequency(t, t_r, 10 * period)
        main = COMPONENTS[0 if n_i > 0 else 1]
        row["frequency_free"] = free_frequency(
            float(data[main].abs().max()), main, 20 * period, s.tol
        )
        rows.append(row)
        presses.append(forces(f"Fig. 4, n_i = {n_i:g}", data))
        chosen = np.unique(
            np.concatenate([thin(data[c].to_numpy(), BINS) for c in ("n", *COMPONENTS)])
        )
        tables[name] = pa.Table.from_pandas(
            data.iloc[chosen][SERIES.names], schema=SERIES, preserve_index=False
        )
    return tables | {
        "runs": pa.Table.from_pylist(rows, schema=RUNS),
        "extrema": pa.concat_tables(extrema),
        "forces": pa.Table.from_pylist(presses, schema=FORCES),
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


def free_frequency(size: float, main: str, length: float, tol: float) -> float | None:
    """Frequency of a mode of GH alone, launched with this rate and nearly no spin."""
    found, _ = follow(
        Rattleback.gh(), n_i=1e-6, omega_xy0=size, t_end=length, channels=("t", main), dt=0.01,
        psi="pitch" if main == "omega_x" else "roll", words="a mode alone",
        integrator={"method": "dop853", "tol": tol}, report=lambda fraction, words: None,
    )  # fmt: skip
    t, _ = maxima(found.table["t"].to_numpy(), found.table[main].to_numpy())
    # Its first periods: it drives the spin, and that it.
    return frequency(t, length / 8, length / 8)


# ---------------------------------------------------------------------------- the picture


def draw(tables: Mapping[str, pa.Table]) -> Any:
    """Draw the figure: (a) to the left, (b) to the right, spin above the oscillations."""
    figure = new_figure(9.2, 6.0)
    axes = figure.subplots(3, 2, sharex="col")
    runs = {row["run"]: row for row in tables["runs"].to_pylist()}
    for column_, (letter, name) in zip(axes.T, (("a", "unsteady"), ("b", "steady")), strict=True):
        _column(column_, letter, runs[name], tables[name])
    # omega_x and omega_y share their scale, so that (a) and (b) can be compared.
    most = max(max(map(abs, axis.get_ylim())) for axis in axes[1:].ravel())
    for axis in axes[1:].ravel():
        axis.set_ylim(-most, most)
    handles, labels = axes[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=3, frameon=False,
                  fontsize=9.5)  # fmt: skip
    return figure


def _column(axes: Any, letter: str, run: dict[str, Any], table: pa.Table) -> None:
    t = table["t"].to_numpy()
    spin, *oscillations = axes
    spin.plot(t, table["n"].to_numpy(), color=BLUE, linewidth=1.1, label="full dynamics")
    spin.plot(t, table["n_gh"].to_numpy(), color="#222222", linewidth=1.1, linestyle=(0, (4, 2)),
              label=r"Garcia and Hubbard, $\overline{n}(t)$")  # fmt: skip
    spin.axhline(0, color="#777777", linewidth=0.6, zorder=1)
    spin.set_ylabel(r"$n$ / $\tilde\omega$")
    for axis, name in zip(oscillations, COMPONENTS, strict=True):
        axis.plot(t, table[name].to_numpy(), color=BLUE, linewidth=0.5)
        axis.set_ylabel(rf"$\omega_{name[-1]}$ / $\tilde\omega$")
    for k, axis in enumerate(axes, start=1):
        if run["t_r"] is not None:
            axis.axvline(run["t_r"], color=VERMILION, linewidth=0.9, linestyle=":",
                         label="first reversal" if k == 1 else None)  # fmt: skip
        axis.set_title(f"({letter}-{k})", loc="left", fontsize=10, pad=4)
        axis.set_xlim(0, t[-1])
        frame(axis)
    if run["t_r"] is not None:
        sign = "u" if run["n_i"] > 0 else "s"
        # Where the spin is not: after a reversal it is of the other sign.
        spin.text(run["t_r"] + 0.02 * t[-1], 0.85 * run["n_i"], rf"$t_{{r{sign}}} = "
                  rf"{run['t_r']:.1f}$", color="#A33B00", fontsize=9.5, va="center")  # fmt: skip
    spin.set_title(rf"GH, $n_i = {run['n_i']:g}$, $|\omega_{{xy0}}| = {run['omega_xy0']:g}$",
                   fontsize=10, pad=4)  # fmt: skip
    axes[-1].set_xlabel(r"$t$ / $\tilde t$")
