"""Claims about distributions (T4, T5), the runs of Fig. 5 (G1 to G3), the long runs (L1 to L4)."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd

from rattlesweep.paper.claim import Measured, every
from rattlesweep.paper.fig3_4 import BOUND, DECADES
from rattlesweep.paper.fig9 import THETAS
from rattlesweep.paper.workspace import Made, records

# Distributions this close cannot be told apart in print; "much larger" is so many times.
CLOSE, MUCH = 0.02, 10.0


def frequencies(made: Made) -> Measured:
    """Measure T4: the ratio of the frequencies, and their zeroth order."""
    row = records(made["fig3"]["summary"])[0]
    checks = [row["below"] == 0, row["ratio_bound"] >= BOUND,
              max(row["distance_p"], row["distance_r"]) < CLOSE]  # fmt: skip
    least = float(made["fig3"]["cumulative"]["ratio"].iloc[0])
    return checks, {**row, "value": least, "low": row["ratio_bound"]}


def coefficients(made: Made) -> Measured:
    """Measure T5: the distributions of the torque coefficients."""
    own = made["fig4"]
    row, data = records(own["summary"])[0], own["cumulative"]
    level = data["probability"].to_numpy()
    # Order statistics: the median's place is binomial.
    half = 0.98 / np.sqrt(row["samples"])
    low, median, high = np.interp([0.5 - half, 0.5, 0.5 + half], level, data["ratio"]).tolist()
    decades = np.log10(own["density"]["relative_frequency"].agg(["min", "max"])).to_list()
    checks = [
        median >= MUCH,
        bool(data["ratio"][0] > 1),
        -DECADES <= decades[0] <= decades[1] <= 0,
    ]
    return checks, {
        "value": median, "low": low, "high": high, "samples": row["samples"],
        "total": row["density_samples"], "least": data["ratio"][0], "decades": decades,
        **{name: np.interp(0.5, level, data[name]) for name in ("K_p", "K_r")},
    }  # fmt: skip


# --- Fig. 5 -------------------------------------------------------------------------------------


def unsteady_reversal(made: Made) -> Measured:
    """Measure G1: reversal in the unsteady direction."""
    return reversal(made, "unsteady", 112, "earlier")


def steady_reversal(made: Made) -> Measured:
    """Measure G2: reversal in the steady direction."""
    return reversal(made, "steady", 810, "later")


def reversal(made: Made, name: str, printed: int, when: str) -> Measured:
    """Measure the time of reversal, and on which side of it Garcia and Hubbard's spin is zero."""
    run = next(row for row in records(made["fig5"]["runs"]) if row["run"] == name)
    found = "earlier" if run["t_rgh"] < run["t_r"] else "later"
    return [abs(run["t_r"] - printed) <= 0.5, found == when], {
        "value": run["t_r"], "zeros": run["zeros"], "t_rgh": run["t_rgh"], "when": found,
        "gap": abs(run["t_rgh"] / run["t_r"] - 1),
    }  # fmt: skip


def envelopes(made: Made) -> Measured:
    """Measure G3: amplitudes about the reversals."""
    runs = {row["run"]: row for row in records(made["fig5"]["runs"])}
    shapes = {(row["run"], row["component"]): row for row in records(made["fig5"]["envelopes"])}
    checks, rows = [], []
    for part, name, main, other in (
        ("a", "unsteady", "omega_x", "omega_y"),
        ("b", "steady", "omega_y", "omega_x"),
    ):
        run, big, dip = runs[name], shapes[name, main], shapes[name, other]
        late, off = ((t - run["t_r"]) / run["period"] for t in (big["top_t"], dip["low_t"]))
        deep = dip["low"] / min(dip["left"], dip["right"])
        checks += [abs(late) <= 2, abs(off) <= 2 and deep <= 0.75]
        names = {"part": part, "main": main, "other": other, "late": late, "off": off}
        rows.append(names | dip | {"top": big["top"], "top_t": big["top_t"]})
    ratios = [run[f"frequency_{component}"] for run in runs.values() for component in "xy"]
    checks += [rows[1]["top"] > rows[0]["top"], max(abs(ratio - 1) for ratio in ratios) <= 0.1]
    return checks, {
        "value": rows[1]["top"] / rows[0]["top"], "shapes": rows,
        "ratios": [{"ratio": ratio} for ratio in ratios],
    }  # fmt: skip


# --- Fig. 9 -------------------------------------------------------------------------------------


def intervals(reversals: pd.DataFrame, model: str) -> dict[float, np.ndarray[Any, Any]]:
    """Return times between successive reversals of the runs with a model."""
    own = reversals[reversals["model"] == model]
    return {theta: np.diff(own[own["theta"] == theta]["t"]) for theta in THETAS}


def three_kinds(made: Made) -> Measured:
    """Measure L1: quasi-periodic, chaotic, quasi-periodic with a shorter period."""
    exponents = made["fig9_lyapunov"]["runs"].set_index("theta")
    reversals, (a, b, c) = made["fig9"]["reversals"], THETAS
    gaps = intervals(reversals, "full")
    whole = {theta: gap.mean() for theta, gap in intervals(reversals, "reduced").items()}
    # The first interval leads from the launch to the motion that follows.
    mean = {theta: float(gap[1:].mean()) for theta, gap in gaps.items()}
    scatter = {theta: float(gap[1:].std(ddof=1)) / mean[theta] for theta, gap in gaps.items()}
    second = reversals.query("model == 'full' and theta == @b")["t"].iloc[1]
    chaotic = exponents["chaotic"]
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
         "whole": whole[theta], **exponents.loc[theta]}
        for theta in THETAS
    ]  # fmt: skip
    doubling = float(np.log(2) / exponents["lyapunov_late"][c])
    narrow = {"doubling": doubling, "gaps": doubling / mean[c], "scatter": scatter[c]}
    return checks, {
        "value": exponents["lyapunov_late"][b], "runs": runs, "second": second,
        "t_end": exponents["t_end"][b], "narrow": [narrow] if chaotic[c] else [],
    }  # fmt: skip


def invariants(made: Made) -> Measured:
    """Measure L2: what the two models conserve."""
    rows, reversals = (made["fig9"][name] for name in ("invariants", "reversals"))
    rows = rows.assign(moves=rows["casimir_high"] - rows["casimir_low"])
    simple, full = rows[rows["model"] == "reduced"], rows[rows["model"] == "full"]
    uneven = max(gap.std() / gap.mean() for gap in intervals(reversals, "reduced").values())
    checks = [
        uneven < 1e-6,
        every(simple["energy_drift"] < 1e-8),
        every(simple["moves"] < 1e-5),
        every(full["energy_drift"] < 1e-8),
        every(full["moves"] > 1),
    ]
    return checks, {
        "value": float(full["moves"].min()), "energy": simple["energy_drift"].max(),
        "casimir": simple["moves"].max(), "uneven": uneven, "drift": full["energy_drift"].max(),
        "moved": records(full),
    }  # fmt: skip


def forces(made: Made) -> Measured:
    """Measure L3: forces at the contact."""
    runs = made["fig9"]["forces"]
    value = float(runs["ratio_max"].max())
    checks = [round(value, 1) == 0.2, every(runs["normal_min"] > 0)]
    return checks, {"value": value, "runs": records(runs)}


def volumes(made: Made) -> Measured:
    """Measure L4: the phase volume along the long runs."""
    rows = made["fig9_volume"]["rates"]
    checks = [
        every(rows["volume_high"] - rows["volume_low"] > 1),
        every(rows["volume_late"][1:] < -1),
        every(rows["rate"] < -2 * rows["error"]),
    ]
    value, error = (float(rows[name][THETAS.index(0.82)]) for name in ("rate", "error"))
    low, high = value - 2 * error, value + 2 * error
    return checks, {"value": value, "low": low, "high": high, "runs": records(rows)}
