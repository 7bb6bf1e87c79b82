"""The paper's claims about the runs of Fig. 4 (G1 to G3) and about wobbling ones (S5)."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from rattlesweep.paper.claims.checks import EDGE
from rattlesweep.paper.claims.claim import Claim, wilson
from rattlesweep.paper.data.chaos import LONGER, SLOW
from rattlesweep.sweeps.tables.chaos import LEAST_GROWTH

if TYPE_CHECKING:
    from collections.abc import Mapping

    import pandas as pd
    import pyarrow as pa

    Tables = Mapping[str, pa.Table]


def claims(figures: Mapping[str, Tables]) -> list[Claim]:
    """Rows of the claims table that the figures made can settle."""
    rows: list[Claim] = []
    if "fig4" in figures:
        rows += gh_claims(figures["fig4"])
    if "fig6" in figures and figures["fig6"]["chaos"].num_rows:
        rows += s5(figures["fig6"]["chaos"].to_pandas())
    return rows


# ------------------------------------------------------------------------------- Fig. 4


def gh_claims(tables: Tables) -> list[Claim]:
    """G1 to G3; none if the runs are not the paper's, or do not reverse."""
    runs = {row["run"]: row for row in tables["runs"].to_pylist()}
    for row in runs.values():
        if abs(abs(row["n_i"]) - 0.1) > EDGE or abs(row["omega_xy0"] - 0.01) > EDGE:
            return []
        if row["t_r"] is None:
            return []
    extrema = tables["extrema"].to_pandas()
    return [
        g1(runs["unsteady"], 112, "G1", "earlier"),
        g1(runs["steady"], 810, "G2", "later"),
        g3(runs, extrema),
    ]


def g1(run: dict[str, Any], said: int, name: str, when: str) -> Claim:
    """The time of reversal and on which side of it Garcia and Hubbard's solution crosses."""
    t_r, t_rgh = run["t_r"], run["t_rgh"]
    sign, part = ("u", "a") if run["n_i"] > 0 else ("s", "b")
    # Three digits, or two where the last is a zero.
    half = 0.5 if said % 10 else 5.0
    word = "earlier" if t_rgh < t_r else "later"
    direction = "positive to negative" if run["n_i"] > 0 else "negative to positive"
    return Claim(
        id=name,
        where=f"Fig. 4({part})",
        words=f"GH, n_i = {run['n_i']:g}, omega_xy0 = 0.01: “the spin n changes its sign from "
        f"{direction} at t_r{sign} ~ {said} t~”; Garcia and Hubbard's solutions “are in good "
        f"agreement with the numerical simulations”; here theirs crosses zero {when}",
        measured=f"t_r{sign} = {t_r:.4f} (zeros of the spin: {run['zeros']}); Garcia and Hubbard's "
        f"solution crosses zero at {t_rgh:.2f}, {abs(t_rgh / t_r - 1):.1%} {word}",
        value=t_r,
        checks=[
            (
                f"t_r{sign} rounds to the paper's digits, {said - half:g} to {said + half:g}",
                abs(t_r - said) <= half,
            ),
            (f"Garcia and Hubbard's solution crosses zero {when}", word == when),
        ],
    )


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
    before, after = t < t_r, t >= t_r
    left = int(np.argmax(np.where(before, height, -1)))
    right = int(np.argmax(np.where(after, height, -1)))
    first, last = sorted((left, right))
    low = first + int(np.argmin(height[first : last + 1]))
    top = int(np.argmax(height))
    return {
        "top": float(height[top]), "top_t": float(t[top]), "left": float(height[left]),
        "left_t": float(t[left]), "right": float(height[right]), "right_t": float(t[right]),
        "low": float(height[low]), "low_t": float(t[low]),
    }  # fmt: skip


def g3(runs: Mapping[str, dict[str, Any]], extrema: pd.DataFrame) -> Claim:
    """Amplitudes about the reversals."""
    checks: list[tuple[str, bool]] = []
    words = []
    tops = {}
    for name, main, other in (
        ("unsteady", "omega_x", "omega_y"),
        ("steady", "omega_y", "omega_x"),
    ):
        run = runs[name]
        own = {
            c: shape(extrema[(extrema["run"] == name) & (extrema["component"] == c)], run["t_r"])
            for c in (main, other)
        }
        big, dip = own[main], own[other]
        tops[name] = big["top"]
        late = (big["top_t"] - run["t_r"]) / run["period"]
        off = (dip["low_t"] - run["t_r"]) / run["period"]
        at = "a" if name == "unsteady" else "b"
        deep = dip["low"] / min(dip["left"], dip["right"])
        checks += [
            (f"({at}) the envelope of {main} peaks within two periods of the reversal",
             abs(late) <= 2),
            (f"({at}) that of {other} has a minimum within two periods of it, at most 3/4 of "
             "either neighbouring maximum", abs(off) <= 2 and deep <= 0.75),
        ]  # fmt: skip
        words.append(
            f"({at}) {main} largest {big['top']:.4f} at {big['top_t']:.1f} ({late:+.1f} periods); "
            f"{other} {dip['low']:.4f} at {dip['low_t']:.1f} ({off:+.1f} periods), between "
            f"{dip['left']:.4f} at {dip['left_t']:.1f} and {dip['right']:.4f} at "
            f"{dip['right_t']:.1f}"
        )
    checks.append(("omega_y in (b) becomes larger than omega_x in (a)",
                   tops["steady"] > tops["unsteady"]))  # fmt: skip
    ratios = [run[f"frequency_{c}"] / run["omega_relevant"] for run in runs.values() for c in "xy"]
    free = [run["frequency_free"] / run["omega_relevant"] for run in runs.values()]
    checks.append(
        ("both oscillate within 10 % of the relevant frequency, ten periods about the reversal",
         max(abs(r - 1) for r in ratios) <= 0.1)
    )  # fmt: skip
    return Claim(
        id="G3",
        where="Fig. 4",
        words="(a) “the amplitude of omega_x becomes large and reaches its maximum around t_ru”, "
        "that of omega_y “shows the local minimum at t_ru”, both “oscillate at the pitch frequency "
        "omega_p”; (b) “the amplitude of omega_y reaches its maximum around t_rs”, and both "
        "“oscillate at the roll frequency omega_r”; “the maximum value of omega_y” in (b) “is "
        "larger than that of omega_x” in (a)",
        measured="; ".join(words)
        + "; frequencies in units of the relevant one: "
        + ", ".join(f"{r:.3f}" for r in ratios),
        value=tops["steady"] / tops["unsteady"],
        checks=checks,
        notes="Envelope: the larger of two neighbouring extrema, which are half a period apart. "
        "A period is that of the relevant mode without spin. The frequencies differ from those of "
        "small oscillations because the amplitudes are large: released alone with that amplitude, "
        f"the modes oscillate at {free[0]:.3f} (pitch) and {free[1]:.3f} (roll) times their "
        "small-amplitude frequencies.",
    )


# ------------------------------------------------------------------------------- Fig. 6(b)


def s5(runs: pd.DataFrame) -> list[Claim]:
    """Which wobbling runs are chaotic; nothing without slow ones and without fast ones."""
    slow = runs[runs["n_i"].abs() <= SLOW + EDGE]
    fast = runs[(runs["n_i"] + 0.5).abs() < EDGE]
    if slow.empty or fast.empty:
        return []
    hits = int(slow["chaotic"].sum())
    low, high = wilson(hits, len(slow))
    kept = slow["growth_longer"].dropna()
    for_good = int((kept > LEAST_GROWTH).sum())
    middle = float(np.sqrt(runs["K_r"].min() * runs["K_r"].max()))
    small = fast[fast["K_r"] < middle]
    large = fast[fast["K_r"] >= middle]
    few, many = int(large["chaotic"].sum()), int(small["chaotic"].sum())
    least = fast[fast["K_r"] == fast["K_r"].min()]
    claim = Claim(
        id="S5",
        where="Fig. 6(b)",
        words="“When abs(n_i) <~ 0.4 omega~, the spin of Type SW sample oscillates almost "
        "periodically”; “when n_i = -0.5 omega~ and K_r << 0.1, we find some samples that show "
        '"chaotic" oscillations”',
        measured=(
            f"chaotic at abs(n_i) <= 0.4: {hits} of {len(slow)} runs of type SW, "
            f"{hits / len(slow):.2%} [{low:.2%}, {high:.2%}]; at n_i = -0.5: {many} of "
            f"{len(small)} at K_r < {middle:.2g} and {few} of {len(large)} above; at "
            f"K_r = {least['K_r'].iloc[0]:g} "
            f"{_share(int(least['chaotic'].sum()), len(least))}"
        ),
        value=hits / len(slow),
        low=low,
        high=high,
        checks=[
            ("abs(n_i) <= 0.4: fewer than one in a hundred are chaotic", hits < 0.01 * len(slow)),
            ("the same for the upper end of the interval", high < 0.01),
            ("strictly: none is", hits == 0),
            ("n_i = -0.5: some are at the smaller half of the K_r", many > 0),
            ("and a larger share than at the larger half", many * len(large) > few * len(small)),
        ],
        notes="Chaotic means, by the Lyapunov exponent, that a small difference grows by more than "
        f"a factor of e^{LEAST_GROWTH:g} in the second half of the run."
        + (
            f" The {len(kept)} chaotic ones at abs(n_i) <= 0.4 were followed to {LONGER} horizons: "
            f"{for_good} are still chaotic in the second half of that time."
            if len(kept)
            else ""
        ),
    )
    return [claim]


def _share(hits: int, runs: int) -> str:
    low, high = wilson(hits, runs)
    return f"{hits} of {runs}, {hits / runs:.0%} [{low:.0%}, {high:.0%}]"
