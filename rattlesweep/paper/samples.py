"""Claims about the sweeps: times of reversal (U1, U2, S6 to S8), types (S1 to S5, S9b), friction.

To agree with the formula means in all of them that the mean is within a tenth of a decade of the
line (a factor of 1.26), the size of a symbol on the paper's logarithmic axes.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd

from rattlesweep.api import modes
from rattlesweep.arrays import Floats
from rattlesweep.paper.claim import Count, Measured, every, share
from rattlesweep.paper.workspace import Made, records
from rattlesweep.physics.body import Rattleback
from rattlesweep.sweeps.types import Z95, wilson

SYMBOL = 10**0.1
# Fewest runs of a kind for a median, and twice as many for one that tells.
FEW = 5
# "only several Type SS samples out of 8000 samples".
SEVERAL = (1, 20)


def rises(
    frame: pd.DataFrame, value: str, by: str, within: Sequence[str], *, sign: int = 1
) -> Count:
    """Count the groups ``within`` which the value rises with abs(``by``), or with sign -1 falls."""
    rising, possible = [], []
    for _, own in frame.groupby(list(within)):
        ordered = own.sort_values(by, key=np.abs)
        step = sign * np.diff(ordered[value])
        if step.size:
            up = step > 0 if sign > 0 else step >= 0
            lows, highs = (ordered[f"{value}_{end}"].to_numpy() for end in ("low", "high"))
            overlap = highs[1:] > lows[:-1] if sign > 0 else lows[1:] < highs[:-1]
            rising.append(bool(up.all()))
            possible.append(bool((up | overlap).all()))
    return every(rising, possible)


def beside_line(frame: pd.DataFrame) -> pd.DataFrame:
    """Add ``ratio``, mean over line, and ``scatter``, deviation over mean, with their intervals."""
    line, mean, std = frame["t_rgh_line"], frame["t_r_mean"], frame["t_r_std"]
    half = Z95 / np.sqrt(2 * (frame["reversed"] - 1).clip(lower=1))
    return frame.assign(
        ratio=mean / line, ratio_low=frame["t_r_low"] / line, ratio_high=frame["t_r_high"] / line,
        scatter=std / mean, scatter_low=(1 - half) * std / mean,
        scatter_high=(1 + half) * std / mean,
        t_r_mean_low=frame["t_r_low"], t_r_mean_high=frame["t_r_high"],
        t_r_std_low=(1 - half) * std, t_r_std_high=(1 + half) * std,
    ).dropna(subset=["ratio"])  # fmt: skip


def close(ratio: pd.Series) -> pd.Series:
    """Return which are within the size of a symbol of 1."""
    return ratio.between(1 / SYMBOL, SYMBOL)


def near(points: pd.DataFrame) -> Count:
    """Count the points whose ratio is within the size of a symbol of 1."""
    possible = (points["ratio_low"] < SYMBOL) & (points["ratio_high"] > 1 / SYMBOL)
    return every(close(points["ratio"]), possible)


def slopes(frame: pd.DataFrame, coefficient: str) -> list[float]:
    """Return slopes of log mean time against log coefficient, one a spin and oscillation."""
    return [
        float(np.polyfit(np.log(own[coefficient]), np.log(own["t_r_mean"]), 1)[0])
        for _, own in frame.groupby(["n_i", "omega_xy0"])
        if len(own) > 1
    ]


def farthest(frame: pd.DataFrame, coefficient: str) -> dict[str, Any]:
    """Return the ratio farthest from 1 with its interval, where it is, and the range of all."""
    row = records(frame.sort_values("ratio", key=lambda ratio: np.abs(np.log(ratio))))[-1]
    value, low, high = (row[name] for name in ("ratio", "ratio_low", "ratio_high"))
    return {
        "value": value, "low": low, "high": high,
        "least": frame["ratio"].min(), "largest": frame["ratio"].max(),
        "farthest": f"{value:.3f} [{low:.3f}, {high:.3f}] at {coefficient} = "
        f"{row[coefficient]:.3g}, n_i = {row['n_i']:g}, omega_xy0 = {row['omega_xy0']:g}",
    }  # fmt: skip


def span(values: Any) -> tuple[float, float]:
    """Return the least and the largest."""
    return min(values), max(values)


# --- times of reversal ---------------------------------------------------------------------------


def unsteady_formula(made: Made) -> Measured:
    """Measure U1: at small spin and oscillation the formula holds."""
    points = beside_line(made["fig6"]["times"].query("abs(n_i) <= 0.2 and omega_xy0 <= 0.01"))
    slope = slopes(points, "K_p")
    outside = ", ".join(
        f"K_p = {r.K_p:g} at n_i = {r.n_i:g}, omega_xy0 = {r.omega_xy0:g} ({r.ratio:.2f})"
        for r in points[~close(points["ratio"])].itertuples()
    )
    checks = [
        near(points),
        max(abs(s + 1) for s in slope) < 0.1,
        every(points["scatter"] < 0.1, points["scatter_low"] < 0.1),
    ]
    return checks, {
        **farthest(points, "K_p"), "ten": every((points["ratio"] - 1).abs() < 0.1),
        "slopes": span(slope), "scatter": span(points["scatter"]), "outside": outside or "none",
    }  # fmt: skip


def large_spin(made: Made) -> Measured:
    """Measure U2: at large spin or oscillation reversals are later, and scatter more."""
    points = beside_line(made["fig6"]["times"])
    beyond = points.query("abs(n_i) >= 0.4")
    found = swing(made["fig6"]["spin"])
    within_size, within_spin = ("n_i", "K_p"), ("omega_xy0", "K_p")
    checks = [
        every(points["ratio_low"] > 1, points["ratio_high"] > 1),
        rises(points, "ratio", "omega_xy0", within_size),
        rises(points, "ratio", "n_i", within_spin),
        rises(points, "scatter", "omega_xy0", within_size),
        every(beyond["ratio"] > SYMBOL, beyond["ratio_high"] > SYMBOL),
        rises(beyond, "t_r_mean", "n_i", within_spin)
        + rises(beyond, "t_r_std", "n_i", within_spin),
        abs(found["multiple"] - 1) < 0.1,
    ]
    numbers = farthest(points, "K_p") | {"value": points["ratio"].max(), "low": None, "high": None}
    return checks, numbers | found | {"fast": span(beyond["ratio"])}


def swing(series: pd.DataFrame) -> dict[str, float]:
    """Return how the spin of Fig. 6(b) oscillates until it reverses, beside omega_x."""
    until = series[: int(np.argmax(series["n"] < 0))]
    t = until["t"].to_numpy()
    spin, own = (swing_frequency(t, until[name].to_numpy()) for name in ("n", "omega_x"))
    pitch = own / float(modes(Rattleback.gh()).omega_p)
    return {"spin": spin, "span": np.ptp(until["n"]), "multiple": spin / own, "pitch": pitch}


def swing_frequency(t: Floats, n: Floats) -> float:
    """Return the angular frequency of the strongest line above 0.5 of evenly spaced values."""
    power = np.abs(np.fft.rfft((n - n.mean()) * np.hanning(len(n))))
    omega = 2 * np.pi * np.fft.rfftfreq(len(n), t[1] - t[0])
    # The slow change of the spin itself lies below.
    return float(omega[np.argmax(power * (omega > 0.5))])


def steady_formula(made: Made) -> Measured:
    """Measure S6: at small spin and oscillation the formula holds in the steady direction, too."""
    sizes = beside_line(made["fig8"]["times"].query("abs(n_i) <= 0.2"))
    points, large = sizes.query("omega_xy0 <= 0.01"), sizes.query("omega_xy0 > 0.01")
    slope, curves = slopes(points, "K_r"), ("n_i", "K_r")
    checks = [
        near(points),
        max(abs(s + 1) for s in slope) < 0.1,
        rises(sizes, "ratio", "omega_xy0", curves, sign=-1),
        every(large["ratio_high"] < 1, large["ratio_low"] < 1),
        rises(sizes, "scatter", "omega_xy0", curves),
    ]
    return checks, {
        **farthest(points, "K_r"), "slopes": span(slope), "large": span(large["ratio"]),
    }  # fmt: skip


def late_reversals(made: Made) -> Measured | None:
    """Measure S7: at fast spins and small K_r some reverse several t_rGH late, and abruptly."""
    beyond = made["fig8"]["late"].query("abs(n_i) >= 0.3").dropna(subset=["ratio_std"])
    low, high = beyond.query("K_r < 0.03"), beyond.query("K_r > 0.06")
    # Where late reversals are more than a few.
    many = low.query("late >= 0.03 * reversed")
    if low.empty or high.empty or many.empty:
        return None
    spread, calm = low["ratio_std"].median(), high["ratio_std"].median()
    error = Z95 * low["ratio_std"] / np.sqrt(2 * (low["reversed"] - 1).clip(lower=1))
    ends = low.assign(end=low["ratio_std"] + error).groupby(["n_i", "omega_xy0"])
    tops = high.groupby(["n_i", "omega_xy0"])["ratio_std"].max()
    without = many["ratio_std_prompt"] / many["ratio_std"]
    kept = many.query("followed > 0").dropna(subset=["plateau"])
    rare = many["late"] < 2 * FEW
    checks = [
        bool(spread > 2 * calm),
        every(ends["ratio_std"].min() > tops, ends["end"].min() > tops),
        every(without < 0.5, rare),
        every(many["growth_late"] < 0.5, rare),
        every(kept["plateau"] > 0.9, kept["followed"] < 2 * FEW),
    ]
    return checks, {
        "value": float(spread / calm), "spread": spread, "calm": calm,
        "kept": kept["plateau"].median(),
        "late": [f"{own['late'].sum():.0f} of {own['reversed'].sum():.0f}" for own in (low, high)],
        "growth": [many[f"growth_{name}"].median() for name in ("late", "prompt")],
    }  # fmt: skip


def onset_of_wobbling(made: Made) -> Measured | None:
    """Measure S8: wobbling begins about when the others reverse; None with too few of both."""
    onset = made["fig8"]["onset"]
    points = onset.query(f"wobbling >= {FEW} and reversed >= {FEW}")
    if points.empty:
        return None
    ratio = (points["onset_median"] / points["t_r_median"]).rename("ratio")
    few = points[["wobbling", "reversed"]].min(axis=1) < 4 * FEW
    slow = onset.query("K_r < 0.03 and abs(n_i) >= 0.3")
    late = slow["onset_late"].sum() / max(1, slow["wobbling"].sum())
    return [every(ratio.between(0.5, 2), few), every([late > 0], True)], {
        "value": ratio.median(), "low": ratio.min(), "high": ratio.max(), "points": len(ratio),
        "fine": int(close(ratio).sum()), "late": late,
        "sizes": records(ratio.groupby(points["omega_xy0"]).median().reset_index()),
    }  # fmt: skip


# --- types --------------------------------------------------------------------------------------


def pooled(frame: pd.DataFrame, *names: str, by: Sequence[str] = ("n_i", "omega_xy0")) -> Any:
    """Return the ``share`` of some types over all K_r with its interval; ``half`` tells K_r."""
    middle = np.sqrt(frame["K_r"].min() * frame["K_r"].max())
    half = (frame["K_r"] >= middle).astype(int)
    frame = frame.assign(half=half, hits=frame[list(names)].sum(axis=1))
    sums = frame.groupby(list(by))[["hits", "runs"]].sum().reset_index()
    low, high = wilson(sums["hits"], sums["runs"])
    return sums.assign(share=sums["hits"] / sums["runs"], share_low=low, share_high=high)


def steady_spin(made: Made) -> Measured:
    """Measure S1: small spins reverse; SS beyond."""
    frame = made["fig7"]["fractions"]
    slowest = frame[frame["n_i"].abs() == frame["n_i"].abs().min()]
    beyond = frame.query("abs(n_i) >= 0.3")
    by_spin = pooled(frame, "SS")
    halves = pooled(beyond, "SS", by=("n_i", "omega_xy0", "half"))
    each = pooled(beyond.query("omega_xy0 <= 0.01"), "SS")["hits"]
    top = records(frame.nlargest(1, "fraction_SS"))[0]
    most = share(int(slowest["R"].sum()), int(slowest["runs"].sum()))
    checks = [
        every([frame.query("abs(n_i) <= 0.2")["SS"].sum() == 0]) + every(each > 0, True),
        every([most["value"] >= 0.99], most["high"] >= 0.99),
        rises(by_spin[by_spin["hits"] > 0], "share", "n_i", ["omega_xy0"]),
        rises(by_spin, "share", "omega_xy0", ["n_i"], sign=-1),
        rises(halves, "share", "half", ["n_i", "omega_xy0"], sign=-1),
    ]
    return checks, {
        "value": top["fraction_SS"], "low": top["low_SS"], "high": top["high_SS"],
        "K_r": top["K_r"], "n_i": top["n_i"], "slowest": slowest["n_i"].iloc[0],
        "reversing": most["share"],
        "by_spin": records(by_spin.groupby("n_i")["share"].max().rename("most").reset_index()),
    }  # fmt: skip


def wobbling(made: Made) -> Measured:
    """Measure S2: from which spin on there is SW, and how much."""
    frame = made["fig7"]["fractions"]
    slow, beyond = frame.query("abs(n_i) <= 0.3"), frame.query("abs(n_i) >= 0.4")
    halves = [pooled(own, "SW", by=("n_i", "omega_xy0", "half")) for own in (slow, beyond)]
    around, both = pooled(beyond, "SW"), pooled(beyond, "SW", "unclassified")["share"]
    by_spin = pooled(frame, "SW").groupby("n_i")["share"]
    checks = [
        every([frame.query("abs(n_i) <= 0.1")["SW"].sum() > 0], True),
        *(rises(own, "share", "half", ["n_i", "omega_xy0"], sign=-1) for own in halves),
        every(around["share"].between(0.15, 0.25),
              (around["share_high"] >= 0.15) & (around["share_low"] <= 0.25)),
    ]  # fmt: skip
    return checks, {
        **share(int(beyond["SW"].sum()), int(beyond["runs"].sum())),
        "single": span(beyond["fraction_SW"]), "both": span(both), "both_mean": both.mean(),
        "mean": around["share"].mean(),
        "by_spin": records(by_spin.agg(["min", "max"]).reset_index()),
    }  # fmt: skip


def threshold(made: Made) -> Measured:
    """Measure S3: at the smallest oscillation SS is Bondi's threshold, body by body."""
    own = made["fig7"]["fractions"].query("omega_xy0 <= 0.001")
    wrong, runs = int(own[["ss_only", "bondi_only"]].sum().sum()), int(own["runs"].sum())
    numbers = {"wrong": wrong, "runs": runs, "SS": int(own["SS"].sum())}
    return [Count(runs - wrong, runs)], share(wrong, runs) | numbers


def large_oscillation(made: Made) -> Measured:
    """Measure S4: at a large oscillation some bodies past the threshold are not SS."""
    frame = made["fig7"]["fractions"]
    size = frame["omega_xy0"].max()
    large, least = frame.query("omega_xy0 == @size"), frame.query("omega_xy0 == omega_xy0.min()")
    hits, runs = map(int, large.query("n_i == -0.3")[["SS", "runs"]].sum())
    more, fewer = (pooled(own.query("abs(n_i) >= 0.4"), "SS") for own in (least, large))
    decided, past = share(hits, runs), int(large["bondi_only"].sum())
    checks = [
        past > 0,
        every([SEVERAL[0] <= 8000 * decided["value"] <= SEVERAL[1]],
              8000 * decided["low"] <= SEVERAL[1] and 8000 * decided["high"] >= SEVERAL[0]),
        every(fewer["share"] < more["share"], fewer["share_low"] < more["share_high"]),
    ]  # fmt: skip
    return checks, {
        **decided, "bondi_only": past, "bondi": int(large["bondi"].sum()), "omega_xy0": size,
        "hits": hits, "runs": runs, "most": decided["high"] * runs,
    }  # fmt: skip


def wobbling_chaos(made: Made) -> Measured | None:
    """Measure S5: which wobbling runs are chaotic; None without slow ones or without fast ones."""
    runs = made["fig7"]["chaos"]
    calm, fast = runs.query("abs(n_i) <= 0.4"), runs.query("n_i == -0.5")
    if calm.empty or fast.empty:
        return None
    middle = np.sqrt(runs["K_r"].min() * runs["K_r"].max())
    parts = (calm, fast.query("K_r < @middle"), fast.query("K_r >= @middle"),
             fast.query("K_r == K_r.min()"))  # fmt: skip
    (hits, total), (many, small), (few, large), lowest = (
        (int(part["chaotic"].sum()), len(part)) for part in parts
    )
    overlap = wilson(many, small)[1] > wilson(few, large)[0]
    checks = [Count(total - hits, total), every([many > 0], True),
              every([many * large > few * small], overlap)]  # fmt: skip
    return checks, {
        **share(hits, total), "hits": hits, "runs": total,
        "middle": middle, "small": f"{many} of {small}", "large": f"{few} of {large}",
        "K_r": fast["K_r"].min(), "least": f"{lowest[0]} of {lowest[1]}, {share(*lowest)['share']}",
    }  # fmt: skip


def settled_spins(made: Made) -> Measured | None:
    """Measure S9b: where the spins of SS end, and about which spins SW wobbles; None of neither."""
    settled, onset = made["fig7"]["settled"], made["fig8"]["onset"]
    wobbling = onset.query("wobbling > 0")
    if settled.empty or wobbling.empty:
        return None
    faster = Count(int(settled["faster"].sum()), int(settled["SS"].sum()))
    between = Count(int(wobbling["centre_between"].sum()), int(wobbling["wobbling"].sum()))
    converted = every((settled["gain_median"] - 1).abs() < 0.1)
    sizes = settled.groupby("omega_xy0")["beyond_median"].median().reset_index()
    return [faster, converted, between], {
        "near": int(settled["near"].sum()),
        "value": wobbling["centre_median"].median(), "low": wobbling["centre_low"].min(),
        "high": wobbling["centre_high"].max(), "faster": faster, "between": between,
        "beyond": records(sizes), "most": settled["beyond_max"].max(),
        "gain": settled["gain_median"].median(),
    }  # fmt: skip


def one_way(made: Made) -> Measured:
    """Measure C1: which share of bodies reverses in one direction only, against the friction."""
    rows = made["friction"]["shares"]
    top = records(rows.nlargest(1, "fraction_one_way"))[0]
    still = rows[(rows["unsteady"] > rows["runs"] / 2) & (rows["sigma"] >= 0.008)]
    low, high = wilson(still["one_way"], still["unsteady"])
    checks = [
        every([top["low_one_way"] > 0.5], top["high_one_way"] > 0.5),
        every(rows["steady_only"] == 0),
        every(low > 0.5, high > 0.5),
    ]
    return checks, {
        "value": top["fraction_one_way"], "low": top["low_one_way"], "high": top["high_one_way"],
        "rows": records(rows), "runs": int(rows["runs"].max()),
        "twice": records(rows.assign(share=rows["twice"] / rows["runs"])),
    }  # fmt: skip
