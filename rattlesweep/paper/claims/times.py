"""Claims about times of reversal in the sweeps of Figs. 5 and 7 (U1, U2, S6 to S8).

To agree with the formula means in all of them that the mean is within a tenth of a decade of the
line (a factor of 1.26), the size of a symbol on the paper's logarithmic axes.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from rattlesweep.paper.claims.checks import (
    SYMBOL,
    beside_line,
    farthest,
    fast,
    near,
    rises,
    slopes,
    slow,
    small,
)
from rattlesweep.paper.claims.claim import every
from rattlesweep.physics import theory
from rattlesweep.physics.body import Rattleback

if TYPE_CHECKING:
    from collections.abc import Sequence

    import pandas as pd
    import pyarrow as pa
    from numpy.typing import NDArray

    from rattlesweep.paper.claims.claim import Measured, Tables

    Floats = NDArray[np.float64]

# Fewest runs of a kind for a median.
FEW = 5


def span(values: Sequence[float] | pd.Series[float]) -> tuple[float, float]:
    """The least and the largest."""
    return min(values), max(values)


def unsteady_formula(tables: Tables) -> Measured:
    """U1: at small spin and oscillation the formula holds."""
    points = beside_line(small(slow(tables["fig5"]["times"].to_pandas(), 0.2)))
    inside, slope = near(points["ratio"]), slopes(points, "K_p")
    named = ", ".join(
        f"K_p = {r.K_p:g} at n_i = {r.n_i:g}, omega_xy0 = {r.omega_xy0:g} ({r.ratio:.2f})"
        for r in points[~inside].itertuples()
    )
    checks = [every(inside), max(abs(s + 1) for s in slope) < 0.1,
              every(points["scatter"] < 0.1)]  # fmt: skip
    return checks, {
        **farthest(points, "K_p"), "ten": every(np.abs(points["ratio"] - 1) < 0.1),
        "slopes": span(slope), "scatter": span(points["scatter"]),
        "outside": f"Outside: {named}." if named else "",
    }  # fmt: skip


def large_spin(tables: Tables) -> Measured:
    """U2: at large spin or oscillation reversals are later than the formula, and scatter more."""
    points = beside_line(tables["fig5"]["times"].to_pandas())
    beyond = fast(points, 0.4)
    spin, found = swing(tables["fig5"]["spin"])
    within_size, within_spin = ("n_i", "K_p"), ("omega_xy0", "K_p")
    checks = [
        every(points["ratio_low"] > 1),
        rises(points, "ratio", "omega_xy0", within_size),
        rises(points, "ratio", "n_i", within_spin),
        rises(points, "scatter", "omega_xy0", within_size),
        every(beyond["ratio"] > SYMBOL),
        rises(beyond, "t_r_mean", "n_i", within_spin)
        + rises(beyond, "t_r_std", "n_i", within_spin),
        abs(spin - 1) < 0.1,
    ]
    return checks, {
        **farthest(points, "K_p"), "value": float(points["ratio"].max()), "low": None,
        "high": None, "fast": span(beyond["ratio"]), **found,
    }  # fmt: skip


def swing(series: pa.Table) -> tuple[float, dict[str, float]]:
    """Frequency at which the spin of Fig. 5(b) oscillates until it reverses, over omega_x's."""
    body = Rattleback.gh()
    pitch = float(theory.modes(body.alpha, body.beta, body.theta, body.phi, body.xi).omega_p)
    t, n, omega_x = (series[name].to_numpy() for name in ("t", "n", "omega_x"))
    until = int(np.argmax(n < 0)) if np.any(n < 0) else len(n)
    spin, own = (swing_frequency(t[:until], values[:until]) for values in (n, omega_x))
    return spin / own, {
        "spin": spin, "span": np.ptp(n[:until]), "multiple": spin / own, "pitch": own / pitch,
    }  # fmt: skip


def swing_frequency(t: Floats, n: Floats) -> float:
    """Angular frequency of the strongest line above 0.5 in the spectrum of evenly spaced values."""
    values = (n - n.mean()) * np.hanning(len(n))
    power = np.abs(np.fft.rfft(values)) ** 2
    omega = 2 * np.pi * np.fft.rfftfreq(len(n), (t[-1] - t[0]) / (len(t) - 1))
    # The slow change of the spin itself lies below.
    line = omega > 0.5
    return float(omega[line][np.argmax(power[line])])


def steady_formula(tables: Tables) -> Measured:
    """S6: at small spin and oscillation the formula holds in the steady direction, too."""
    every_size = beside_line(slow(tables["fig7"]["times"].to_pandas(), 0.2))
    points, large = small(every_size), every_size[every_size["omega_xy0"] > 0.01 + 1e-9]
    inside, slope, curves = near(points["ratio"]), slopes(points, "K_r"), ("n_i", "K_r")
    checks = [
        every(inside),
        max(abs(s + 1) for s in slope) < 0.1,
        rises(every_size.assign(down=-every_size["ratio"]), "down", "omega_xy0", curves),
        every(large["ratio_high"] < 1),
        rises(every_size, "scatter", "omega_xy0", curves),
    ]
    return checks, {
        **farthest(points, "K_r"), "slopes": span(slope), "large": span(large["ratio"]),
    }  # fmt: skip


def late_reversals(tables: Tables) -> Measured | None:
    """S7: at fast spins and small K_r some reverse several t_rGH late, and abruptly.

    None if none of the points has a small or none a large K_r, or nothing reverses late.
    """
    beyond = fast(tables["fig7"]["late"].to_pandas(), 0.3).dropna(subset=["ratio_std"])
    low, high = beyond[beyond["K_r"] < 0.03], beyond[beyond["K_r"] > 0.06]
    # Where late reversals are more than a few.
    many = low[low["late"] >= 0.03 * low["reversed"]]
    if low.empty or high.empty or many.empty:
        return None
    panel = ["n_i", "omega_xy0"]
    spread, calm = low["ratio_std"].median(), high["ratio_std"].median()
    without = many["ratio_std_prompt"] / many["ratio_std"]
    kept = many[many["followed"] > 0]["plateau"].dropna()
    checks = [
        bool(spread > 2 * calm),
        every(low.groupby(panel)["ratio_std"].min() > high.groupby(panel)["ratio_std"].max()),
        every(without < 0.5),
        every(many["growth_late"] < 0.5),
        every(kept > 0.9),
    ]
    return checks, {
        "value": float(spread / calm), "spread": spread, "calm": calm, "kept": kept.median(),
        "late": [f"{own['late'].sum():.0f} of {own['reversed'].sum():.0f}" for own in (low, high)],
        "growth": [many[f"growth_{name}"].median() for name in ("late", "prompt")],
    }  # fmt: skip


def onset_of_wobbling(tables: Tables) -> Measured | None:
    """S8: wobbling begins about when the others reverse."""
    onset = tables["fig7"]["onset"].to_pandas()
    points = onset[(onset["wobbling"] >= FEW) & (onset["reversed"] >= FEW)]
    if points.empty:
        return None
    ratio = points["onset_median"] / points["t_r_median"]
    low = fast(onset[onset["K_r"] < 0.03], 0.3)
    late = low["onset_late"].sum() / max(1, low["wobbling"].sum())
    return [every((ratio > 0.5) & (ratio < 2)), bool(late > 0)], {
        "value": float(ratio.median()), "low": float(ratio.min()), "high": float(ratio.max()),
        "points": len(ratio), "fine": int(near(ratio).sum()), "late": late,
        "sizes": ", ".join(
            f"{own.median():.2f} at {size:g}" for size, own in ratio.groupby(points["omega_xy0"])
        ),
    }  # fmt: skip
