"""Claims about single runs: those of Fig. 5 (G1 to G3), the long ones of Fig. 9 (L1 to L4)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd

from rattlesweep.paper.claims.claim import Made, Measured, every
from rattlesweep.paper.workspace import records
from rattlesweep.sweeps.types import LEAST_GROWTH


def runs_of_gh(made: Made) -> dict[str, dict[str, Any]]:
    """Return the two runs by name."""
    return {row["run"]: row for row in records(made["fig5"]["runs"])}


def unsteady_reversal(made: Made) -> Measured:
    """Measure G1: reversal in the unsteady direction."""
    return reversal(runs_of_gh(made)["unsteady"], 112, "earlier")


def steady_reversal(made: Made) -> Measured:
    """Measure G2: reversal in the steady direction."""
    return reversal(runs_of_gh(made)["steady"], 810, "later")


def reversal(run: dict[str, Any], printed: int, when: str) -> Measured:
    """Measure the time of reversal, and on which side of it Garcia and Hubbard's spin is zero."""
    t_r, t_rgh = run["t_r"], run["t_rgh"]
    found = "earlier" if t_rgh < t_r else "later"
    return [abs(t_r - printed) <= 0.5, found == when], {
        "value": t_r, "zeros": run["zeros"], "t_rgh": t_rgh, "gap": abs(t_rgh / t_r - 1),
        "when": found,
    }  # fmt: skip


def shape(own: pd.DataFrame, t_r: float) -> dict[str, float]:
    """Return the envelope about a reversal, from extrema in groups of one period (two extrema).

    ``top``: largest amplitude; ``left``, ``right``: largest before and after the reversal; ``low``:
    least between those two; ``top_t`` and so on: when.
    """
    t, size = own["t"].to_numpy(), own["amplitude"].to_numpy()
    # The larger of neighbours: maxima and minima of the rate need not be of one size.
    height = np.maximum(size[:-1], size[1:])
    t = (t[:-1] + t[1:]) / 2
    left = int(np.argmax(np.where(t < t_r, height, -1)))
    right = int(np.argmax(np.where(t >= t_r, height, -1)))
    first, last = sorted((left, right))
    low = first + int(np.argmin(height[first : last + 1]))
    places = {"top": int(np.argmax(height)), "left": left, "right": right, "low": low}
    sizes = {name: float(height[place]) for name, place in places.items()}
    return sizes | {f"{name}_t": float(t[place]) for name, place in places.items()}


def envelopes(made: Made) -> Measured:
    """Measure G3: amplitudes about the reversals."""
    runs = runs_of_gh(made)
    extrema = made["fig5"]["extrema"]
    checks, shapes, tops = [], [], []
    for part, name, main, other in (
        ("a", "unsteady", "omega_x", "omega_y"),
        ("b", "steady", "omega_y", "omega_x"),
    ):
        run, own = runs[name], extrema[extrema["run"] == name]
        big, dip = (shape(own[own["component"] == c], run["t_r"]) for c in (main, other))
        late, off = ((t - run["t_r"]) / run["period"] for t in (big["top_t"], dip["low_t"]))
        deep = dip["low"] / min(dip["left"], dip["right"])
        checks += [abs(late) <= 2, abs(off) <= 2 and deep <= 0.75]
        tops.append(big["top"])
        names = {"part": part, "main": main, "other": other, "late": late, "off": off}
        shapes.append(names | dip | {"top": big["top"], "top_t": big["top_t"]})
    ratios = [run[f"frequency_{c}"] / run["omega_relevant"] for run in runs.values() for c in "xy"]
    checks += [tops[1] > tops[0], max(abs(ratio - 1) for ratio in ratios) <= 0.1]
    return checks, {
        "value": tops[1] / tops[0], "shapes": shapes,
        "ratios": [{"ratio": ratio} for ratio in ratios],
        "free": [run["frequency_free"] / run["omega_relevant"] for run in runs.values()],
    }  # fmt: skip


# --- Fig. 9 -------------------------------------------------------------------------------------

# Curvatures of Fig. 9.
PAPERS = (0.6429, 0.82, 0.9)


def intervals(reversals: pd.DataFrame, model: str) -> dict[float, np.ndarray[Any, Any]]:
    """Return times between successive reversals of the runs with a model."""
    own = reversals[reversals["model"] == model]
    return {theta: np.diff(own[own["theta"] == theta]["t"]) for theta in PAPERS}


def three_kinds(made: Made) -> Measured:
    """Measure L1: quasi-periodic, chaotic, quasi-periodic with a shorter period."""
    exponents = made["fig9_lyapunov"]["exponents"]
    reversals, (a, b, c) = made["fig9"]["reversals"], PAPERS
    gaps = intervals(reversals, "full")
    whole = {theta: gap.mean() for theta, gap in intervals(reversals, "reduced").items()}
    # The first interval leads from the launch to the motion that follows.
    mean = {theta: float(gap[1:].mean()) for theta, gap in gaps.items()}
    scatter = {theta: float(gap[1:].std(ddof=1)) / mean[theta] for theta, gap in gaps.items()}
    full = reversals[reversals["model"] == "full"]
    second = float(full[full["theta"] == b]["t"].iloc[1])
    best = exponents[exponents["tol"] == exponents["tol"].iloc[-1]].set_index("theta")
    chaotic = best["growth"] > LEAST_GROWTH
    checks = [
        bool(chaotic[b] and max(scatter[a], scatter[c]) < 0.05),
        not chaotic[a],
        abs(mean[a] / whole[a] - 1) < 0.05,
        abs(second / 3000 - 1) < 0.05,
        scatter[b] > 0.2,
        mean[c] < 0.5 * whole[c] and gaps[c][0] > 2 * mean[c],
        not chaotic[c],
    ]
    runs = [
        {"theta": theta, "first": gaps[theta][0], "mean": mean[theta], "scatter": scatter[theta],
         "whole": whole[theta], **best.loc[theta]}
        for theta in PAPERS
    ]  # fmt: skip
    doubling = float(np.log(2) / best["exponent"][c])
    narrow = {"doubling": doubling, "gaps": doubling / mean[c], "scatter": scatter[c]}
    value, error = float(best["exponent"][b]), float(best["error"][b])
    return checks, {
        "value": value, "low": value - 2 * error, "high": value + 2 * error, "runs": runs,
        "second": second, "t_end": best["t_end"].iloc[0], "tol": best["tol"].iloc[0],
        "narrow": [narrow] if chaotic[c] else [],
    }  # fmt: skip


def invariants(made: Made) -> Measured:
    """Measure L2: what the two models conserve."""
    rows, reversals = (made["fig9"][name] for name in ("invariants", "reversals"))
    rows = rows.assign(moves=lambda r: r["casimir_high"] - r["casimir_low"])
    simple, full = rows[rows["model"] == "reduced"], rows[rows["model"] == "full"]
    gaps = intervals(reversals, "reduced").values()
    uneven = max(float(gap.std() / gap.mean()) for gap in gaps)
    at = reversals.query("model == 'full'").groupby("theta")["casimir"].agg(np.ptp)
    checks = [
        uneven < 1e-6,
        bool((simple["energy_drift"] < 1e-8).all()),
        bool((simple["moves"] < 1e-5).all()),
        bool((full["energy_drift"] < 1e-8).all()),
        bool((full["moves"] > 1).all()),
    ]
    return checks, {
        "value": float(full["moves"].min()), "energy": simple["energy_drift"].max(),
        "casimir": simple["moves"].max(), "uneven": uneven, "drift": full["energy_drift"].max(),
        "moved": records(full.assign(reversals=full["theta"].map(at))),
    }  # fmt: skip


def volumes(made: Made) -> Measured:
    """Measure L4: the phase volume along the long runs."""
    rows = made["fig9_volume"]["rates"]
    span = rows["volume_high"] - rows["volume_low"]
    checks = [
        every(span > 1),
        every(rows["volume_late"][1:] < -1),
        every(rows["rate"] < -2 * rows["error"]),
    ]
    chaotic = rows.iloc[PAPERS.index(0.82)]
    value, error = float(chaotic["rate"]), float(chaotic["error"])
    return checks, {
        "value": value, "low": value - 2 * error, "high": value + 2 * error,
        "runs": records(rows),
    }  # fmt: skip


def forces(made: Made) -> Measured:
    """Measure L3: forces at the contact, beside those of the other figures."""
    runs = made["fig9"]["forces"]
    top = runs.iloc[int(runs["ratio_max"].argmax())]
    light = runs.iloc[int(runs["normal_min"].argmin())]
    others = "; ".join(
        force_words(row)
        for name in ("fig5", "fig6", "fig7")
        if name in made
        for row in records(made[name]["forces"])
    )
    value = float(top["ratio_max"])
    return [round(value, 1) == 0.2, bool((runs["normal_min"] > 0).all())], {
        "value": value, "run": top["run"], "t": top["ratio_t"], "light": light["run"],
        "normal": light["normal_min"],
        "runs": records(runs),
        "others": f" Largest ratios in the other figures: {others}." if others else "",
    }  # fmt: skip


def force_words(row: Mapping[str, Any]) -> str:
    """Say the largest ratio of a run, and whether it needs friction above 1 or loses contact."""
    text = f"{row['run']}: {row['ratio_max']:.2f} at t = {row['ratio_t']:.1f}"
    if not np.isnan(row["open_t"]):
        text = f"{row['run']}: unbounded, as contact would be lost at t = {row['open_t']:.1f}"
    if not np.isnan(row["slip_t"]):
        text += f" (above 1 first at t = {row['slip_t']:.1f})"
    return text
