"""Fig. 8: three long runs, through many reversals, with the reduced model beside."""

from __future__ import annotations

import math
from dataclasses import replace
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
from rattlesweep.physics import reduced
from rattlesweep.physics.body import Rattleback
from rattlesweep.study.style import BLUE, VERMILION
from rattlesweep.sweeps.config.fields import Base, PositiveNumbers
from rattlesweep.sweeps.tables.columns import RATE, TIME

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import NDArray

    from rattlesweep.paper.sweeps import Place, Report
    from rattlesweep.study.onerun.course import Course, Trajectory

    Floats = NDArray[np.float64]

BINS = 1100
# Zeros of the spin closer to each other than so many periods of the roll are one reversal.
ONE_REVERSAL = 5
BESIDE_TOL = 1e-12


class Fig8Settings(Base):
    """The three runs of Fig. 8."""

    theta: PositiveNumbers = Field(description="Curvature of each body, GH otherwise.")
    n_i: float = Field(gt=0, description="Initial spin, in sqrt(g/a).")
    omega_xy0: float = Field(gt=0, description="Initial oscillation, in sqrt(g/a).")
    e_r0: float = Field(gt=0, description="Energy of the roll the reduced model begins with.")
    t_end: float = Field(gt=0, description="Length, in sqrt(a/g).")
    tol: float = Field(gt=0, le=1e-4, description="Tolerance of DOP853.")

    def bodies(self) -> list[Rattleback]:
        """The bodies, in the order of the panels."""
        return [replace(Rattleback.gh(), theta=theta) for theta in self.theta]


REVERSALS = pa.schema(
    [
        column("theta", F64, "curvature of the body"),
        column("model", TEXT, "full or reduced"),
        column("t", F64, "first zero of the spin of a reversal", TIME),
        column("t_last", F64, "its last zero before the spin stays on its side", TIME),
        column("zeros", I64, "zeros of the spin in all"),
        column("casimir", F64, "C_I of the energies averaged over a period of the roll, then"),
    ]
)
INVARIANTS = pa.schema(
    [
        column("theta", F64, "curvature of the body"),
        column("model", TEXT, "full or reduced"),
        column("energy_drift", F64, "largest change of the total energy, relative"),
        column("casimir_low", F64, "least C_I from the first reversal on; of averaged energies in "
               "the full model"),
        column("casimir_high", F64, "largest C_I from the first reversal on"),
    ]
)  # fmt: skip
SPIN = pa.schema(
    [
        column("theta", F64, "curvature of the body"),
        column("t", F64, "time", TIME),
        column("n", F64, "spin u . omega", RATE),
        column("n_reduced", F64, "spin of the reduced model", RATE),
    ]
)


def compute(place: Place, report: Report) -> dict[str, pa.Table]:
    """Data of the figure.

    Returns
    -------
    dict
        ``spin``: the series as drawn; ``reversals``: one row a reversal of either model;
        ``invariants``: what is conserved, one row a run and model; ``forces``.
    """
    s = place.paper.fig8
    tables: dict[str, list[Any]] = {"spin": [], "reversals": [], "invariants": [], "forces": []}
    for k, body in enumerate(s.bodies()):
        begin, end = k / len(s.theta), (k + 1) / len(s.theta)
        words = f"GH with theta = {body.theta:g}"
        launch = {"n_i": s.n_i, "omega_xy0": s.omega_xy0, "t_end": s.t_end, "e_r0": s.e_r0}
        found, course = follow(
            body, **launch, channels=("t", "n", "n_reduced", "E_p", "E_r", "energy_drift",
                                      *FORCE_CHANNELS),
            integrator={"method": "dop853", "tol": s.tol}, words=words,
            report=part(report, begin, begin + 0.9 * (end - begin)),
        )  # fmt: skip
        simple, _ = follow(
            body, **launch, model="reduced", channels=("t", "n", "energy_drift", "C_I"),
            integrator={"method": "dop853", "tol": BESIDE_TOL}, words=words, dt=1.0,
            report=part(report, begin + 0.9 * (end - begin), end),
        )  # fmt: skip
        full_rows, casimir = _full(body.theta, found, course)
        own = simple.table
        tables["reversals"] += full_rows
        tables["reversals"] += [
            {"theta": body.theta, "model": "reduced", "t": t, "t_last": t, "zeros": 1,
             "casimir": float(np.interp(t, own["t"], own["C_I"]))}
            for t in simple.zeros
        ]  # fmt: skip
        for model, drift, values in (
            ("full", found.table["energy_drift"], casimir),
            ("reduced", own["energy_drift"], own["C_I"].to_numpy()),
        ):
            tables["invariants"].append(
                {"theta": body.theta, "model": model, "energy_drift": float(drift.abs().max()),
                 "casimir_low": float(values.min()), "casimir_high": float(values.max())}
            )  # fmt: skip
        tables["forces"].append(forces(f"Fig. 8, theta = {body.theta:g}", found.table))
        n, beside = found.table["n"].to_numpy(), found.table["n_reduced"].to_numpy()
        chosen = np.unique(np.concatenate([thin(n, BINS), thin(beside, BINS // 2)]))
        rows = found.table.iloc[chosen].assign(theta=body.theta)[SPIN.names]
        tables["spin"].append(pa.Table.from_pandas(rows, schema=SPIN, preserve_index=False))
    return {
        "spin": pa.concat_tables(tables["spin"]),
        "reversals": pa.Table.from_pylist(tables["reversals"], schema=REVERSALS),
        "invariants": pa.Table.from_pylist(tables["invariants"], schema=INVARIANTS),
        "forces": pa.Table.from_pylist(tables["forces"], schema=FORCES),
    }


def _full(theta: float, found: Trajectory, course: Course) -> tuple[list[dict[str, Any]], Floats]:
    """Reversals of the full model, and its C_I from the first one on."""
    modes = course.launches.modes
    period = 2 * math.pi / float(modes.omega_r[0])
    t = found.table["t"].to_numpy()
    casimir = averaged_casimir(found, float(modes.K_p[0]), float(modes.K_r[0]), period)
    groups = reversals(found.zeros, ONE_REVERSAL * period)
    rows = [
        {"theta": theta, "model": "full", "t": float(zeros[0]), "t_last": float(zeros[-1]),
         "zeros": len(zeros), "casimir": float(np.interp(zeros[0], t, casimir))}
        for zeros in groups
    ]  # fmt: skip
    # Half a period at the end has no whole average.
    inside = (t >= (groups[0][0] if groups else 0.0)) & (t <= t[-1] - period / 2)
    return rows, casimir[inside]


def averaged_casimir(found: Trajectory, K_p: float, K_r: float, period: float) -> Floats:
    """C_I (Eq. (51) [casimir]) of the energies averaged over a period of the roll."""
    from scipy.ndimage import uniform_filter1d

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


# ---------------------------------------------------------------------------- the picture


def draw(tables: Mapping[str, pa.Table]) -> Any:
    """Draw the figure: one panel a run."""
    data = tables["spin"].to_pandas()
    thetas = list(dict.fromkeys(data["theta"]))
    figure = new_figure(8.2, 1.9 * len(thetas) + 0.7)
    axes = figure.subplots(len(thetas), 1, sharex=True, sharey=True, squeeze=False)[:, 0]
    for axis, theta, letter in zip(axes, thetas, "abcdefghijklmnopqrstuvwxyz", strict=False):
        own = data[data["theta"] == theta]
        axis.plot(own["t"], own["n"], color=BLUE, linewidth=0.8, label="full dynamics")
        axis.plot(own["t"], own["n_reduced"], color=VERMILION, linewidth=1.2,
                  linestyle=(0, (4, 2)), label="reduced model")  # fmt: skip
        axis.axhline(0, color="#777777", linewidth=0.6, zorder=1)
        axis.set_title(rf"({letter}) $\theta = {theta:g}$", loc="left", fontsize=10, pad=4)
        axis.set_ylabel(r"$n$ / $\tilde\omega$")
        axis.set_xlim(0, own["t"].max())
        frame(axis)
    axes[-1].set_xlabel(r"$t$ / $\tilde t$")
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside upper center", ncols=2,
                  frameon=False, fontsize=9.5)  # fmt: skip
    return figure
