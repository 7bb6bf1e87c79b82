"""Claims about the types in the steady direction (S1 to S4), from Fig. 6's tables."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from rattlesweep.paper.claims.checks import at_spin, fast, share, share_words, slow, small
from rattlesweep.paper.claims.claim import Count, every

if TYPE_CHECKING:
    import pandas as pd

    from rattlesweep.paper.claims.claim import Measured, Tables

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
    slowest = slow(frame, frame["n_i"].abs().min())
    beyond = fast(frame, 0.3)
    by_spin = pooled(frame, "SS").unstack("omega_xy0").sort_index(key=np.abs)
    values = by_spin.to_numpy()
    split = halves(beyond, "SS")
    each = small(beyond).groupby(["n_i", "omega_xy0"])["SS"].sum()
    top = frame.sort_values("fraction_SS").iloc[-1]
    reversing = int(slowest["R"].sum()), int(slowest["runs"].sum())
    checks = [
        bool(slow(frame, 0.2)["SS"].sum() == 0 and every(each > 0)),
        reversing[0] >= 0.99 * reversing[1],
        bool(np.all((np.diff(values, axis=0) > 0) | (values[1:] == 0))),
        bool(np.all(np.diff(values, axis=1) <= 0)),
        every(split["small"] >= split["large"]),
    ]
    return checks, {
        "value": float(top["fraction_SS"]), "low": float(top["low_SS"]),
        "high": float(top["high_SS"]), "K_r": top["K_r"], "n_i": top["n_i"],
        "slowest": slowest["n_i"].iloc[0], "reversing": share_words(*reversing),
        "by_spin": ", ".join(
            f"{n:g}: {most:.1%}" for n, most in zip(by_spin.index, values.max(axis=1), strict=True)
        ),
    }  # fmt: skip


def wobbling(tables: Tables) -> Measured:
    """S2: from which spin on there is SW, and how much."""
    frame = tables["fig6"]["fractions"].to_pandas()
    beyond = fast(frame, 0.4)
    split_slow, split_fast = halves(slow(frame, 0.3), "SW"), halves(beyond, "SW")
    around = pooled(beyond, "SW")
    both = around + pooled(beyond, "unclassified")
    total = int(beyond["SW"].sum()), int(beyond["runs"].sum())
    single = beyond["fraction_SW"]
    checks = [
        int(slow(frame, 0.1)["SW"].sum()) > 0,
        every(split_slow["small"] > split_slow["large"]),
        every(split_fast["small"] > split_fast["large"]),
        every(around.between(0.15, 0.25)),
    ]
    return checks, {
        **share(*total), "share": share_words(*total), "single": (single.min(), single.max()),
        "both": (both.min(), both.max()), "both_mean": both.mean(), "mean": around.mean(),
        "by_spin": ", ".join(
            f"{n:g}: {own.min():.1%} to {own.max():.1%}"
            for n, own in pooled(frame, "SW").groupby(level="n_i", sort=False)
        ),
    }  # fmt: skip


def threshold(tables: Tables) -> Measured:
    """S3: at the smallest oscillation SS is Bondi's threshold, body by body."""
    frame = tables["fig6"]["fractions"].to_pandas()
    own = small(frame, 0.001)
    wrong, runs = int(own[["ss_only", "bondi_only"]].sum().sum()), int(own["runs"].sum())
    return [Count(runs - wrong, runs)], {
        **share(wrong, runs), "wrong": wrong, "runs": runs, "SS": int(own["SS"].sum()),
    }  # fmt: skip


def large_oscillation(tables: Tables) -> Measured:
    """S4: at a large oscillation some bodies past the threshold are not SS."""
    frame = tables["fig6"]["fractions"].to_pandas()
    readings, basin = (tables["fig6"][name].to_pandas() for name in ("definitions", "basin"))
    size = frame["omega_xy0"].max()
    large = frame[frame["omega_xy0"] == size]
    least = frame[frame["omega_xy0"] == frame["omega_xy0"].min()]
    at = at_spin(large, -0.3)
    hits, runs = int(at["SS"].sum()), int(at["runs"].sum())
    more, fewer = (pooled(fast(points, 0.4), "SS").to_numpy() for points in (least, large))
    own = at_spin(readings[readings["omega_xy0"] == size], -0.3)
    others = own[~own["definition"].str.startswith(DEFAULT_READING)]
    decided = share(hits, runs)
    past = int(large["bondi_only"].sum())
    checks = [past > 0, SEVERAL[0] <= 8000 * decided["value"] <= SEVERAL[1], every(fewer < more)]
    return checks, {
        **decided, "bondi_only": past, "bondi": int(large["bondi"].sum()), "omega_xy0": size,
        "hits": hits, "runs": runs, "most": decided["high"] * runs,
        "readings": "; ".join(
            f"{name}: {count}"
            for name, count in zip(others["definition"], others["count"], strict=True)
        ),
        "past": basin["runs"].max(), "bears": ", ".join(
            f"{row.SS} at {row.omega_xy0:g}" for row in basin.itertuples()
        ),
    }  # fmt: skip
