"""Claims about the sweeps: times of reversal (U1, U2, S6 to S8), types (S1 to S4), chaos (S5).

To agree with the formula means in all of them that the mean is within a tenth of a decade of the
line (a factor of 1.26), the size of a symbol on the paper's logarithmic axes.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd
import pyarrow as pa

from rattlesweep.arrays import Floats
from rattlesweep.paper.claims.claim import Count, Measured, Tables, every, share, share_words
from rattlesweep.paper.figures.chaos import LONGER, SLOW
from rattlesweep.physics import theory
from rattlesweep.physics.body import Rattleback
from rattlesweep.sweeps.types import LEAST_GROWTH

# A tenth of a decade: the size of a symbol on the paper's logarithmic axes.
SYMBOL = 10**0.1


def rises(frame: pd.DataFrame, value: str, by: str, within: Sequence[str]) -> Count:
    """In how many groups ``within`` the value rises strictly with abs(``by``)."""
    groups = [g.sort_values(by, key=np.abs)[value] for _, g in frame.groupby(list(within))]
    return every([bool(np.all(np.diff(g) > 0)) for g in groups if len(g) > 1])


def beside_line(frame: pd.DataFrame) -> pd.DataFrame:
    """Add ``ratio``, mean over line, with its interval, and ``scatter``, deviation over mean."""
    line = frame["t_rgh_line"]
    return frame.assign(
        ratio=frame["t_r_mean"] / line,
        ratio_low=frame["t_r_low"] / line,
        ratio_high=frame["t_r_high"] / line,
        scatter=frame["t_r_std"] / frame["t_r_mean"],
    ).dropna(subset=["ratio"])


def near(ratio: pd.Series[float]) -> pd.Series[bool]:
    """Whether each is within the size of a symbol of 1."""
    inside: pd.Series[bool] = np.abs(np.log(ratio)) < np.log(SYMBOL)
    return inside


def slopes(frame: pd.DataFrame, coefficient: str) -> list[float]:
    """Slope of log mean time against log coefficient, one a spin and oscillation."""
    return [
        float(np.polyfit(np.log(own[coefficient]), np.log(own["t_r_mean"]), 1)[0])
        for _, own in frame.groupby(["n_i", "omega_xy0"])
        if len(own) > 1
    ]


def farthest(frame: pd.DataFrame, coefficient: str) -> dict[str, float | str]:
    """The ratio farthest from 1 with its interval, and where it is, among the range of all."""
    row = frame.loc[np.log(frame["ratio"]).abs().idxmax()]
    value, low, high = (float(row[name]) for name in ("ratio", "ratio_low", "ratio_high"))
    return {
        "value": value, "low": low, "high": high,
        "least": frame["ratio"].min(), "largest": frame["ratio"].max(),
        "farthest": f"{value:.3f} [{low:.3f}, {high:.3f}] at {coefficient} = "
        f"{row[coefficient]:.3g}, n_i = {row['n_i']:g}, omega_xy0 = {row['omega_xy0']:g}",
    }  # fmt: skip


# --- times of reversal ---------------------------------------------------------------------------

# Fewest runs of a kind for a median.
FEW = 5


def span(values: Sequence[float] | pd.Series[float]) -> tuple[float, float]:
    """The least and the largest."""
    return min(values), max(values)


def unsteady_formula(tables: Tables) -> Measured:
    """U1: at small spin and oscillation the formula holds."""
    times = tables["fig5"]["times"].to_pandas()
    points = beside_line(times.query("abs(n_i) <= 0.2 and omega_xy0 <= 0.01"))
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
    beyond = points.query("abs(n_i) >= 0.4")
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
    every_size = beside_line(tables["fig7"]["times"].to_pandas().query("abs(n_i) <= 0.2"))
    points, large = every_size.query("omega_xy0 <= 0.01"), every_size.query("omega_xy0 > 0.01")
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
    beyond = tables["fig7"]["late"].to_pandas().query("abs(n_i) >= 0.3")
    beyond = beyond.dropna(subset=["ratio_std"])
    low, high = beyond.query("K_r < 0.03"), beyond.query("K_r > 0.06")
    # Where late reversals are more than a few.
    many = low.query("late >= 0.03 * reversed")
    if low.empty or high.empty or many.empty:
        return None
    panel = ["n_i", "omega_xy0"]
    spread, calm = low["ratio_std"].median(), high["ratio_std"].median()
    without = many["ratio_std_prompt"] / many["ratio_std"]
    kept = many.query("followed > 0")["plateau"].dropna()
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
    points = onset.query(f"wobbling >= {FEW} and reversed >= {FEW}")
    if points.empty:
        return None
    ratio = points["onset_median"] / points["t_r_median"]
    sizes = ratio.rename("ratio").groupby(points["omega_xy0"])
    low = onset.query("K_r < 0.03 and abs(n_i) >= 0.3")
    late = low["onset_late"].sum() / max(1, low["wobbling"].sum())
    return [every((ratio > 0.5) & (ratio < 2)), bool(late > 0)], {
        "value": float(ratio.median()), "low": float(ratio.min()), "high": float(ratio.max()),
        "points": len(ratio), "fine": int(near(ratio).sum()), "late": late,
        "sizes": sizes.median().reset_index().to_dict("records"),
    }  # fmt: skip


# --- types --------------------------------------------------------------------------------------

# "only several Type SS samples out of 8000 samples".
SEVERAL = (1, 20)
DEFAULT_READING = "type SS"


def pooled(frame: pd.DataFrame, name: str) -> pd.Series[float]:
    """Share of a type over all K_r, by spin and oscillation."""
    sums = frame.groupby(["n_i", "omega_xy0"])[[name, "runs"]].sum()
    return sums[name] / sums["runs"]


def halves(frame: pd.DataFrame, name: str) -> pd.DataFrame:
    """Share of a type at the smaller and at the larger half of the K_r, by spin and oscillation."""
    middle = float(np.sqrt(frame["K_r"].min() * frame["K_r"].max()))
    return frame.assign(half=np.where(frame["K_r"] < middle, "small", "large")).pivot_table(
        index=["n_i", "omega_xy0"], columns="half", values=f"fraction_{name}", aggfunc="mean"
    )


def steady_spin(tables: Tables) -> Measured:
    """S1: small spins reverse; SS beyond."""
    frame = tables["fig6"]["fractions"].to_pandas()
    slowest = frame[frame["n_i"].abs() == frame["n_i"].abs().min()]
    beyond = frame.query("abs(n_i) >= 0.3")
    by_spin = pooled(frame, "SS").unstack("omega_xy0").sort_index(key=np.abs)
    values = by_spin.to_numpy()
    split = halves(beyond, "SS")
    each = beyond.query("omega_xy0 <= 0.01").groupby(["n_i", "omega_xy0"])["SS"].sum()
    top = frame.sort_values("fraction_SS").iloc[-1]
    reversing = int(slowest["R"].sum()), int(slowest["runs"].sum())
    checks = [
        bool(frame.query("abs(n_i) <= 0.2")["SS"].sum() == 0 and every(each > 0)),
        reversing[0] >= 0.99 * reversing[1],
        bool(np.all((np.diff(values, axis=0) > 0) | (values[1:] == 0))),
        bool(np.all(np.diff(values, axis=1) <= 0)),
        every(split["small"] >= split["large"]),
    ]
    return checks, {
        "value": float(top["fraction_SS"]), "low": float(top["low_SS"]),
        "high": float(top["high_SS"]), "K_r": top["K_r"], "n_i": top["n_i"],
        "slowest": slowest["n_i"].iloc[0], "reversing": share_words(*reversing),
        "by_spin": by_spin.max(axis=1).rename("most").reset_index().to_dict("records"),
    }  # fmt: skip


def wobbling(tables: Tables) -> Measured:
    """S2: from which spin on there is SW, and how much."""
    frame = tables["fig6"]["fractions"].to_pandas()
    beyond = frame.query("abs(n_i) >= 0.4")
    split_slow, split_fast = halves(frame.query("abs(n_i) <= 0.3"), "SW"), halves(beyond, "SW")
    around = pooled(beyond, "SW")
    both = around + pooled(beyond, "unclassified")
    total = int(beyond["SW"].sum()), int(beyond["runs"].sum())
    single, by_spin = beyond["fraction_SW"], pooled(frame, "SW").groupby(level="n_i", sort=False)
    checks = [
        int(frame.query("abs(n_i) <= 0.1")["SW"].sum()) > 0,
        every(split_slow["small"] > split_slow["large"]),
        every(split_fast["small"] > split_fast["large"]),
        every(around.between(0.15, 0.25)),
    ]
    return checks, {
        **share(*total), "share": share_words(*total), "single": (single.min(), single.max()),
        "both": (both.min(), both.max()), "both_mean": both.mean(), "mean": around.mean(),
        "by_spin": by_spin.agg(["min", "max"]).reset_index().to_dict("records"),
    }  # fmt: skip


def threshold(tables: Tables) -> Measured:
    """S3: at the smallest oscillation SS is Bondi's threshold, body by body."""
    frame = tables["fig6"]["fractions"].to_pandas()
    own = frame.query("omega_xy0 <= 0.001")
    wrong, runs = int(own[["ss_only", "bondi_only"]].sum().sum()), int(own["runs"].sum())
    return [Count(runs - wrong, runs)], {
        **share(wrong, runs), "wrong": wrong, "runs": runs, "SS": int(own["SS"].sum()),
    }  # fmt: skip


def large_oscillation(tables: Tables) -> Measured:
    """S4: at a large oscillation some bodies past the threshold are not SS."""
    frame = tables["fig6"]["fractions"].to_pandas()
    readings, basin = (tables["fig6"][name].to_pandas() for name in ("definitions", "basin"))
    size = frame["omega_xy0"].max()
    large, least = frame.query("omega_xy0 == @size"), frame.query("omega_xy0 == omega_xy0.min()")
    at = large.query("n_i == -0.3")
    hits, runs = int(at["SS"].sum()), int(at["runs"].sum())
    more, fewer = (pooled(f.query("abs(n_i) >= 0.4"), "SS").to_numpy() for f in (least, large))
    own = readings.query("omega_xy0 == @size and n_i == -0.3")
    others = own[~own["definition"].str.startswith(DEFAULT_READING)]
    decided = share(hits, runs)
    past = int(large["bondi_only"].sum())
    checks = [past > 0, SEVERAL[0] <= 8000 * decided["value"] <= SEVERAL[1], every(fewer < more)]
    return checks, {
        **decided, "bondi_only": past, "bondi": int(large["bondi"].sum()), "omega_xy0": size,
        "hits": hits, "runs": runs, "most": decided["high"] * runs,
        "readings": others.to_dict("records"), "past": basin["runs"].max(),
        "bears": basin.to_dict("records"),
    }  # fmt: skip


def wobbling_chaos(tables: Tables) -> Measured | None:
    """S5: which wobbling runs are chaotic; None without slow ones and without fast ones."""
    runs = tables["fig6"]["chaos"].to_pandas()
    calm, fast = runs.query(f"abs(n_i) <= {SLOW}"), runs.query("n_i == -0.5")
    if calm.empty or fast.empty:
        return None
    middle = float(np.sqrt(runs["K_r"].min() * runs["K_r"].max()))
    least = fast["K_r"].min()
    parts = (
        calm,
        fast[fast["K_r"] < middle],
        fast[fast["K_r"] >= middle],
        fast[fast["K_r"] == least],
    )
    (hits, total), (many, small), (few, large), lowest = (
        (int(part["chaotic"].sum()), len(part)) for part in parts
    )
    kept = calm["growth_longer"].dropna()
    longer = {"followed": len(kept), "horizons": LONGER, "still": (kept > LEAST_GROWTH).sum()}
    checks = [Count(total - hits, total), many > 0, many * large > few * small]
    return checks, {
        **share(hits, total), "hits": hits, "runs": total, "share": share_words(hits, total),
        "middle": middle, "small": f"{many} of {small}", "large": f"{few} of {large}",
        "K_r": least, "least": "{} of {}, {}".format(*lowest, share_words(*lowest)),
        "longer": [longer] if len(kept) else [],
    }  # fmt: skip
