"""Claims about the runs of Fig. 4 (G1 to G3) and about the wobbling ones of Fig. 6 (S5)."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from rattlesweep.paper.claims.checks import at_spin, share, share_words, slow
from rattlesweep.paper.claims.claim import Count
from rattlesweep.paper.figures.chaos import LONGER, SLOW
from rattlesweep.sweeps.tables.chaos import LEAST_GROWTH

if TYPE_CHECKING:
    import pandas as pd

    from rattlesweep.paper.claims.claim import Measured, Tables


# --- Fig. 4 -------------------------------------------------------------------------------------


def runs_of_gh(tables: Tables) -> dict[str, dict[str, Any]]:
    """The two runs by name."""
    return {row["run"]: row for row in tables["fig4"]["runs"].to_pylist()}


def unsteady_reversal(tables: Tables) -> Measured:
    """G1: reversal in the unsteady direction."""
    return reversal(runs_of_gh(tables)["unsteady"], 112, "earlier")


def steady_reversal(tables: Tables) -> Measured:
    """G2: reversal in the steady direction."""
    return reversal(runs_of_gh(tables)["steady"], 810, "later")


def reversal(run: dict[str, Any], printed: int, when: str) -> Measured:
    """The time of reversal and on which side of it Garcia and Hubbard's solution crosses zero."""
    t_r, t_rgh = run["t_r"], run["t_rgh"]
    found = "earlier" if t_rgh < t_r else "later"
    return [abs(t_r - printed) <= 0.5, found == when], {
        "value": t_r, "zeros": run["zeros"], "t_rgh": t_rgh, "gap": abs(t_rgh / t_r - 1),
        "when": found,
    }  # fmt: skip


def shape(own: pd.DataFrame, t_r: float) -> dict[str, float]:
    """Envelope about a reversal, from the extrema in groups of one period (two extrema).

    Returns
    -------
    dict
        ``top``: largest amplitude, ``top_t``: when; ``left``, ``right``: largest before and after
        the reversal, ``low``: least between those two, ``low_t``: when.
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


def envelopes(tables: Tables) -> Measured:
    """G3: amplitudes about the reversals."""
    runs = runs_of_gh(tables)
    extrema = tables["fig4"]["extrema"].to_pandas()
    checks, words, tops = [], [], []
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
        words.append(
            f"({part}) {main} largest {big['top']:.4f} at {big['top_t']:.1f} ({late:+.1f} "
            f"periods); {other} {dip['low']:.4f} at {dip['low_t']:.1f} ({off:+.1f} periods), "
            f"between {dip['left']:.4f} at {dip['left_t']:.1f} and {dip['right']:.4f} at "
            f"{dip['right_t']:.1f}"
        )
    ratios = [run[f"frequency_{c}"] / run["omega_relevant"] for run in runs.values() for c in "xy"]
    checks += [tops[1] > tops[0], max(abs(ratio - 1) for ratio in ratios) <= 0.1]
    return checks, {
        "value": tops[1] / tops[0], "shapes": "; ".join(words),
        "ratios": ", ".join(f"{ratio:.3f}" for ratio in ratios),
        "free": [run["frequency_free"] / run["omega_relevant"] for run in runs.values()],
    }  # fmt: skip


# --- Fig. 6(b) ----------------------------------------------------------------------------------


def wobbling_chaos(tables: Tables) -> Measured | None:
    """S5: which wobbling runs are chaotic; None without slow ones and without fast ones."""
    runs = tables["fig6"]["chaos"].to_pandas()
    calm, fast = slow(runs, SLOW), at_spin(runs, -0.5)
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
    longer = (
        f" The {len(kept)} chaotic ones at abs(n_i) <= 0.4 were followed to {LONGER} horizons: "
        f"{(kept > LEAST_GROWTH).sum()} are still chaotic in the second half of that time."
        if len(kept)
        else ""
    )
    checks = [Count(total - hits, total), many > 0, many * large > few * small]
    return checks, {
        **share(hits, total), "hits": hits, "runs": total, "share": share_words(hits, total),
        "middle": middle, "small": f"{many} of {small}", "large": f"{few} of {large}",
        "K_r": least, "least": "{} of {}, {}".format(*lowest, share_words(*lowest)),
        "longer": longer,
    }  # fmt: skip
