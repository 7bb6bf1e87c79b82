"""Fig. 8: three long runs, through many reversals, with the reduced model beside."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pyarrow as pa
from matplotlib.figure import Figure as Drawing
from scipy.ndimage import uniform_filter1d

from rattlesweep.analysis.onerun.course import Course, Trajectory
from rattlesweep.analysis.style import BLUE, VERMILION, new_figure
from rattlesweep.arrays import Floats
from rattlesweep.paper.columns import count, number, schema, table
from rattlesweep.paper.figures.follow import FORCE_CHANNELS, FORCES, follow, forces, thinned
from rattlesweep.paper.figures.style import ABOVE, DASHES, N_AXIS, T_AXIS, ZERO, frame, launch
from rattlesweep.paper.workspace import Progress, Tables, between
from rattlesweep.physics import reduced
from rattlesweep.physics.body import Rattleback
from rattlesweep.sweeps.columns import RATE, TIME
from rattlesweep.sweeps.single import Launch

BODIES = [replace(Rattleback.gh(), theta=theta) for theta in (0.6429, 0.82, 0.9)]
LETTERS = "abc"
N_I, OMEGA_XY0 = 0.1, 0.01
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

REVERSALS = schema(
    "theta model",
    number("t", "first zero of the spin of a reversal", TIME),
    number("t_last", "its last zero before the spin stays on its side", TIME),
    count("zeros", "zeros of the spin in all"),
    number("casimir", "C_I of the energies averaged over a period of the roll, then"),
)
INVARIANTS = schema(
    "theta model",
    number("energy_drift", "largest change of the total energy, relative"),
    number("casimir_low", "least C_I from the first reversal on; of averaged energies in the full "
           "model"),
    number("casimir_high", "largest C_I from the first reversal on"),
)  # fmt: skip
SPIN = schema("theta t n", number("n_reduced", "spin of the reduced model", RATE))


def long_runs(progress: Progress, *, t_end: float = T_END, tol: float = TOL) -> Tables:
    """Tables of the three runs.

    ``spin``: the series as drawn; ``reversals``: one row a reversal of either model;
    ``invariants``: what is conserved, one row a run and model; ``forces``.
    """
    rows: list[dict[str, Any]] = []
    invariants, presses, spins = [], [], []
    channels = ("t", "n", "n_reduced", "E_p", "E_r", "energy_drift", *FORCE_CHANNELS)
    for k, body in enumerate(BODIES):
        part = between(progress, k / len(BODIES), (k + 1) / len(BODIES))
        words = f"GH with theta = {body.theta:g}"
        run = Launch(
            body, N_I, OMEGA_XY0, t_end, integrator={"method": "dop853", "tol": tol}, e_r0=E_R0
        )
        found, course = follow(run, channels, words, between(part, 0.0, 0.9))
        alone = replace(run, model="reduced", integrator={"method": "dop853", "tol": REDUCED_TOL})
        simple, _ = follow(
            alone, ("t", "n", "energy_drift", "C_I"), words, between(part, 0.9, 1.0), dt=1.0
        )
        of_full, casimir = full_model(found, course)
        c_i = simple.table["C_I"].to_numpy()
        of_reduced = [
            {"t": t, "t_last": t, "zeros": 1, "casimir": np.interp(t, simple.table["t"], c_i)}
            for t in simple.zeros
        ]
        for model, reversals_, series, values in (
            ("full", of_full, found.table, casimir),
            ("reduced", of_reduced, simple.table, c_i),
        ):
            key = {"theta": body.theta, "model": model}
            rows += [key | row for row in reversals_]
            invariants.append(
                key | {"energy_drift": series["energy_drift"].abs().max(),
                       "casimir_low": values.min(), "casimir_high": values.max()}
            )  # fmt: skip
        presses.append(forces(f"Fig. 8, theta = {body.theta:g}", found.table))
        drawn = found.table.assign(theta=body.theta)
        spins.append(thinned(drawn, SPIN, {"n": BINS, "n_reduced": BINS // 2}))
    return {
        "spin": pa.concat_tables(spins),
        "reversals": table(rows, REVERSALS),
        "invariants": table(invariants, INVARIANTS),
        "forces": table(presses, FORCES),
    }


def full_model(found: Trajectory, course: Course) -> tuple[list[dict[str, Any]], Floats]:
    """Reversals of the full model, and its C_I from the first one on."""
    modes = course.launches.modes
    period = 2 * np.pi / float(modes.omega_r[0])
    t = found.table["t"].to_numpy()
    casimir = averaged_casimir(found, float(modes.K_p[0]), float(modes.K_r[0]), period)
    groups = reversals(found.zeros, ONE_REVERSAL * period)
    rows = [
        {"t": zeros[0], "t_last": zeros[-1], "zeros": len(zeros),
         "casimir": np.interp(zeros[0], t, casimir)}
        for zeros in groups
    ]  # fmt: skip
    # Half a period at the end has no whole average.
    inside = (t >= (groups[0][0] if groups else 0.0)) & (t <= t[-1] - period / 2)
    return rows, casimir[inside]


def averaged_casimir(found: Trajectory, K_p: float, K_r: float, period: float) -> Floats:
    """C_I (Eq. (51) [casimir]) of the energies averaged over a period of the roll."""
    t = found.table["t"].to_numpy()
    width = max(1, round(period / (t[1] - t[0])))
    pitch, roll = (
        uniform_filter1d(found.table[name].to_numpy(), width, mode="nearest")
        for name in ("E_p", "E_r")
    )
    values: Floats = reduced.casimir(pitch, roll, K_p, K_r)
    return values


def reversals(zeros: Sequence[float] | Floats, gap: float) -> list[Floats]:
    """Zeros of the spin in groups that are farther than ``gap`` from each other."""
    times = np.asarray(zeros, dtype=float)
    if not times.size:
        return []
    return list(np.split(times, 1 + np.flatnonzero(np.diff(times) > gap)))


def draw(tables: Tables) -> Drawing:
    """One panel a run."""
    runs = list(tables["spin"].to_pandas().groupby("theta"))
    figure = new_figure(8.2, 1.9 * len(runs) + 0.7)
    axes = figure.subplots(len(runs), 1, sharex=True, sharey=True, squeeze=False)[:, 0]
    for axis, (theta, own), letter in zip(axes, runs, LETTERS, strict=True):
        axis.plot(own["t"], own["n"], color=BLUE, linewidth=0.8, label="full dynamics")
        axis.plot(own["t"], own["n_reduced"], color=VERMILION, linewidth=1.2, linestyle=DASHES,
                  label="reduced model")  # fmt: skip
        axis.axhline(0, **ZERO)
        axis.set_ylabel(N_AXIS)
        axis.set_xlim(0, own["t"].max())
        frame(axis, f"({letter}) {launch({'theta': theta}, 'theta')}", loc="left")
    axes[-1].set_xlabel(T_AXIS)
    figure.legend(*axes[0].get_legend_handles_labels(), ncols=2, **ABOVE)
    return figure
