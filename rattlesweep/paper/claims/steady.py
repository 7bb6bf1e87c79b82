"""The paper's claims about the types in the steady direction (S1 to S4), from Fig. 6's tables."""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING

import numpy as np

from rattlesweep.paper.claims.checks import EDGE, covers
from rattlesweep.paper.claims.claim import Claim, wilson

if TYPE_CHECKING:
    from collections.abc import Mapping

    import pandas as pd
    import pyarrow as pa

# "only several samples out of 8000".
SEVERAL = (1, 20)
DEFAULT_READING = "type SS"
STILL = "falls by more than 2%"


def steady_claims(tables: Mapping[str, pa.Table]) -> list[Claim]:
    """S1 to S4, as far as the points of the sweep are those that they speak of."""
    frame = tables["fractions"].to_pandas()
    if not covers(frame):
        return []
    rk4 = rk4_words(tables["rk4"].to_pandas())
    return [
        s1(frame, rk4),
        s2(frame),
        s3(frame),
        s4(frame, tables["definitions"].to_pandas(), tables["basin"].to_pandas()),
    ]


def rk4_words(rows: pd.DataFrame) -> str:
    """How the runs fared that RK4 integrated as well."""
    if rows.empty:
        return ""
    changed = int((rows["type"] != rows["type_rk4"]).sum())
    odd = rows[rows["exception"].notna()]
    low, high = wilson(changed, len(rows))
    causes = Counter(text.split(":")[0] for text in odd["exception"])
    named = ", ".join(f"{count} {word}" for word, count in causes.most_common())
    return (
        f" With the paper's integrator {len(rows) - changed} of {len(rows)} runs have the same "
        f"type ({changed} changed, {low:.2%} to {high:.2%}); type or t_r (by more than 1e-6) "
        f"differs in {len(odd)} runs" + (f" ({named})" if named else "") + "; see fig6_rk4.parquet."
    )


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


def interval(hits: int, runs: int) -> str:
    """Share with Wilson's interval, in words."""
    low, high = wilson(hits, runs)
    return f"{hits / runs:.2%} [{low:.2%}, {high:.2%}]"


def s1(frame: pd.DataFrame, rk4: str) -> Claim:
    """Small spins reverse; SS beyond."""
    slowest = frame[frame["n_i"].abs() <= frame["n_i"].abs().min() + EDGE]
    below = frame[frame["n_i"].abs() <= 0.2 + EDGE]
    beyond = frame[frame["n_i"].abs() >= 0.3 - EDGE]
    shares = pooled(frame, "SS")
    by_spin = shares.unstack("omega_xy0").sort_index(key=np.abs)
    values = by_spin.to_numpy()
    grows = bool(np.all((np.diff(values, axis=0) > 0) | (values[1:] == 0)))
    smaller = bool(np.all(np.diff(values, axis=1) <= 0))
    split = halves(beyond, "SS")
    more = split["small"] >= split["large"]
    small_sizes = beyond[beyond["omega_xy0"] <= 0.01 + EDGE].groupby(["n_i", "omega_xy0"])["SS"]
    top = frame.sort_values("fraction_SS").iloc[-1]
    words = ", ".join(
        f"{n:g}: {most:.1%}" for n, most in zip(by_spin.index, values.max(axis=1), strict=True)
    )
    return Claim(
        id="S1",
        where="Fig. 6(a)",
        words="“When the initial spin abs(n_i) is small enough, the spin simply reverses”; “Type "
        "SS appears for abs(n_i) >~ 0.3 omega~ and its fraction increases as abs(n_i) increases. "
        "The fraction is larger for smaller K_r and smaller” omega_xy0",
        measured=(
            f"type R at n_i = {slowest['n_i'].iloc[0]:g}: "
            f"{interval(int(slowest['R'].sum()), int(slowest['runs'].sum()))}; largest pooled "
            f"share of SS by n_i: {words}; largest at a single point {top['fraction_SS']:.1%} "
            f"[{top['low_SS']:.1%}, {top['high_SS']:.1%}] at K_r = {top['K_r']:g}, "
            f"n_i = {top['n_i']:g}"
        ),
        value=float(top["fraction_SS"]),
        low=float(top["low_SS"]),
        high=float(top["high_SS"]),
        checks=[
            (
                "99 % of the slowest runs are of type R",
                bool(slowest["R"].sum() >= 0.99 * slowest["runs"].sum()),
            ),
            ("no SS at abs(n_i) <= 0.2", below["SS"].sum() == 0),
            ("SS at every abs(n_i) >= 0.3, omega_xy0 <= 0.01", bool((small_sizes.sum() > 0).all())),
            ("share of SS, pooled over K_r, grows with abs(n_i)", grows),
            ("and does not grow with omega_xy0", smaller),
            (
                f"more SS at the smaller half of the K_r ({more.sum()} of {len(more)} panels)",
                bool(more.all()),
            ),
        ],
        notes=rk4,
    )


def s2(frame: pd.DataFrame) -> Claim:
    """SW: from which spin on, and how many."""
    shares = pooled(frame, "SW")
    slowest = frame[frame["n_i"].abs() <= 0.1 + EDGE]
    slow = frame[frame["n_i"].abs() <= 0.3 + EDGE]
    fast = frame[frame["n_i"].abs() >= 0.4 - EDGE]
    split_slow, split_fast = halves(slow, "SW"), halves(fast, "SW")
    held = (split_slow["small"] > split_slow["large"], split_fast["small"] > split_fast["large"])
    around = pooled(fast, "SW")
    both = around + pooled(fast, "unclassified")
    hits, runs = int(fast["SW"].sum()), int(fast["runs"].sum())
    low, high = wilson(hits, runs)
    words = ", ".join(
        f"{n:g}: {own.min():.1%} to {own.max():.1%}"
        for n, own in shares.groupby(level="n_i", sort=False)
    )
    return Claim(
        id="S2",
        where="Fig. 6(a)",
        words="“Type SW appears for abs(n_i) >~ 0.1 omega~ and its fraction is also larger for "
        "smaller K_r, but stays around 0.2 for abs(n_i) >~ 0.4 omega~”",
        measured=(
            f"share of SW pooled over K_r, by n_i: {words}; at all abs(n_i) >= 0.4 "
            f"{interval(hits, runs)}, single points {fast['fraction_SW'].min():.1%} to "
            f"{fast['fraction_SW'].max():.1%}; together with unclassified {both.min():.1%} to "
            f"{both.max():.1%}"
        ),
        value=hits / runs,
        low=low,
        high=high,
        checks=[
            ("SW already at abs(n_i) = 0.1", int(slowest["SW"].sum()) > 0),
            (
                f"abs(n_i) <= 0.3: more SW at the smaller half of the K_r ({held[0].sum()} of "
                f"{len(held[0])} panels)",
                bool(held[0].all()),
            ),
            (
                f"abs(n_i) >= 0.4: the same ({held[1].sum()} of {len(held[1])} panels)",
                bool(held[1].all()),
            ),
            (
                "abs(n_i) >= 0.4: share pooled over K_r between 0.15 and 0.25 at every n_i and "
                "omega_xy0",
                bool(around.between(0.15, 0.25).all()),
            ),
        ],
        notes="Beyond 0.3 the bodies of small K_r become SS, so that SW is most frequent at "
        "intermediate K_r. Its share depends on what counts as a visible wobble (here 5 % of the "
        f"spin): with the unclassified runs the mean of the pooled shares would be "
        f"{both.mean():.1%} instead of {around.mean():.1%}.",
    )


def s3(frame: pd.DataFrame) -> Claim:
    """At the smallest oscillation SS is Bondi's threshold, body by body."""
    small = frame[frame["omega_xy0"] <= 0.001 + EDGE]
    if small.empty:
        small = frame[frame["omega_xy0"] <= frame["omega_xy0"].min()]
    wrong, runs = int(small["ss_only"].sum() + small["bondi_only"].sum()), int(small["runs"].sum())
    low, high = wilson(wrong, runs)
    return Claim(
        id="S3",
        where="Fig. 6(a), Eq. (73) [def-nc1]",
        words="omega_xy0 = 0.001: “all samples whose abs(n_c1) is smaller than abs(n_i) actually "
        "show Type SS behaviors and vice versa”",
        measured=(
            f"{wrong} of {runs} runs at omega_xy0 = {small['omega_xy0'].iloc[0]:g} on the wrong "
            f"side [{low:.2g}, {high:.2g}]; {int(small['SS'].sum())} are SS"
        ),
        value=wrong / runs,
        low=low,
        high=high,
        checks=[
            ("SS and abs(n_c1) < abs(n_i) coincide in 99 % of the runs", wrong <= 0.01 * runs),
            ("no SS without abs(n_c1) < abs(n_i)", int(small["ss_only"].sum()) == 0),
            ("no other type with abs(n_c1) < abs(n_i)", int(small["bondi_only"].sum()) == 0),
        ],
        notes="Run by run: the type comes from the motion, the threshold from Eq. (73) [def-nc1].",
    )


def s4(frame: pd.DataFrame, readings: pd.DataFrame, basin: pd.DataFrame) -> Claim:
    """At a large oscillation some bodies past the threshold are not SS."""
    size = frame["omega_xy0"].max()
    large = frame[frame["omega_xy0"] == size]
    small = frame[frame["omega_xy0"] == frame["omega_xy0"].min()]
    at = large[np.abs(large["n_i"] + 0.3) < EDGE]
    hits, runs = int(at["SS"].sum()), int(at["runs"].sum())
    low, high = wilson(hits, runs) if runs else (0.0, 1.0)
    fewer = (pooled(large, "SS").droplevel(1) < pooled(small, "SS").droplevel(1))[
        lambda s: s.index <= -0.4 + EDGE
    ]
    own = readings[(np.abs(readings["n_i"] + 0.3) < EDGE) & (readings["omega_xy0"] == size)]
    others = "; ".join(
        f"{row.definition}: {row.count_}"
        for row in own.rename(columns={"count": "count_"}).itertuples()
        if not row.definition.startswith(DEFAULT_READING)
    )
    return Claim(
        id="S4",
        where="Fig. 6(a)",
        words="omega_xy0 = 0.1: “there are some samples whose abs(n_c1) is smaller than abs(n_i) "
        "yet do not show Type SS behavior; for n_i = -0.3 omega~, there are only several Type SS "
        "samples out of 8000 samples”; for abs(n_i) >~ 0.4 the fractions “are smaller than those "
        "for” omega_xy0 = 0.001",
        measured=(
            f"{int(large['bondi_only'].sum())} of {int(large['bondi'].sum())} bodies past the "
            f"threshold are not SS at omega_xy0 = {size:g}; n_i = -0.3: {hits} SS of {runs} "
            f"(95 %: at most {high * runs:.0f}). With other definitions of SS: {others}"
        ),
        value=hits / runs if runs else None,
        low=low,
        high=high,
        checks=[
            ("some bodies past the threshold are not SS", int(large["bondi_only"].sum()) > 0),
            (
                f"n_i = -0.3: between {SEVERAL[0]} and {SEVERAL[1]} SS in 8000",
                runs > 0 and SEVERAL[0] <= hits * 8000 / runs <= SEVERAL[1],
            ),
            ("abs(n_i) >= 0.4: fewer SS than at the smallest oscillation", bool(fewer.all())),
        ],
        notes=_why_none(hits, own, basin),
    )


def _why_none(hits: int, readings: pd.DataFrame, basin: pd.DataFrame) -> str:
    """What smaller initial oscillations, and other definitions of SS, tell about S4."""
    if basin.empty:
        return ""
    bears = ", ".join(f"{r.SS} at {r.omega_xy0:g}" for r in basin.itertuples())
    text = (
        f"Of the {basin['runs'].iloc[0]} bodies past the threshold at n_i = "
        f"{basin['n_i'].iloc[0]:g}, SS by initial omega_xy0: {bears}."
    )
    if hits == 0 and basin["SS"].iloc[-1] == 0:
        text += " The last SS disappears before this oscillation is reached."
    still = readings[readings["definition"].str.contains(STILL, regex=False)]["count"].sum()
    if hits < SEVERAL[0] <= still <= SEVERAL[1]:
        text += (
            f" In {still} more, the oscillation grows at first and then keeps its size, while the "
            "spin falls by less than 2 %: steady to the eye, and perhaps the paper's several."
        )
    return text
