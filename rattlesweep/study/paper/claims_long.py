"""The paper's claims about the long runs of Fig. 8 (L1 to L3)."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from rattlesweep.study.paper.checks import verdict
from rattlesweep.study.paper.claim import Claim
from rattlesweep.sweep.chaos import LEAST_GROWTH

if TYPE_CHECKING:
    from collections.abc import Mapping

    import pandas as pd
    import pyarrow as pa

    Tables = Mapping[str, pa.Table]

# "around" in the paper's own figures of one or two digits.
NEAR = 0.05
# Curvatures of Fig. 8.
PAPERS = (0.6429, 0.82, 0.9)


def claims(figures: Mapping[str, Tables]) -> list[Claim]:
    """Rows of the claims table that the figures made can settle."""
    if "fig8" not in figures:
        return []
    rows: list[Claim] = []
    tables = {name: table.to_pandas() for name, table in figures["fig8"].items()}
    if set(tables["invariants"]["theta"]) != set(PAPERS):
        return rows
    counts = tables["reversals"].groupby(["theta", "model"]).size()
    # Intervals after the first: three reversals and more.
    if len(counts) < 2 * len(PAPERS) or counts.min() < 3:
        return rows
    if "fig8_lyapunov" in figures:
        rows.append(l1(tables, figures["fig8_lyapunov"]["exponents"].to_pandas()))
    return [*rows, l2(tables), l3(tables["forces"], other_forces(figures))]


def intervals(reversals: pd.DataFrame, theta: float, model: str) -> np.ndarray[Any, Any]:
    """Times between successive reversals of a run."""
    own = reversals[(reversals["theta"] == theta) & (reversals["model"] == model)]
    return np.diff(own["t"].to_numpy())


def l1(tables: Mapping[str, pd.DataFrame], exponents: pd.DataFrame) -> Claim:
    """Quasi-periodic, chaotic, quasi-periodic with a shorter period."""
    reversals = tables["reversals"]
    full = reversals[reversals["model"] == "full"]
    second = float(full[full["theta"] == 0.82]["t"].iloc[1])
    gaps = {theta: intervals(reversals, theta, "full") for theta in PAPERS}
    whole = {theta: intervals(reversals, theta, "reduced") for theta in gaps}
    # The first interval leads from the launch to the motion that follows.
    later = {theta: gap[1:] for theta, gap in gaps.items()}
    scatter = {theta: float(g.std(ddof=1) / g.mean()) for theta, g in later.items()}
    best = exponents[exponents["tol"] == exponents["tol"].iloc[-1]].set_index("theta")
    coarse = exponents[exponents["tol"] == exponents["tol"].iloc[0]].set_index("theta")
    chaotic = best["growth"] > LEAST_GROWTH
    close = float(later[0.6429].mean() / whole[0.6429].mean())
    short = float(later[0.9].mean() / whole[0.9].mean())
    word, said = verdict(
        [
            ("(a) intervals between reversals scatter by less than 5 % and are within 5 % of the "
             "reduced model's", scatter[0.6429] < 0.05 and abs(close - 1) < 0.05),
            ("(a) no chaos", not chaotic[0.6429]),
            (f"(b) second reversal within {NEAR:.0%} of t = 3000", abs(second / 3000 - 1) < NEAR),
            ("(b) chaotic", bool(chaotic[0.82])),
            ("(b) intervals scatter by more than 20 %", scatter[0.82] > 0.2),
            ("(c) intervals scatter by less than 5 %, after the first and below half of the "
             "reduced model's", scatter[0.9] < 0.05 and short < 0.5 and gaps[0.9][0] > 2 *
             later[0.9].mean()),
            ("(c) strictly quasi-periodic: no chaos", not chaotic[0.9]),
        ]
    )  # fmt: skip
    named = "; ".join(
        f"theta = {theta:g}: intervals {later[theta].mean():.0f} +- {scatter[theta]:.1%} after the "
        f"first of {gaps[theta][0]:.0f}, reduced model {whole[theta].mean():.0f}; exponent "
        f"{best['exponent'][theta]:.2g} +- {best['error'][theta]:.1g}, growth e^"
        f"{best['growth'][theta]:.0f}"
        for theta in gaps
    )
    narrow = ""
    if chaotic[0.9]:
        doubling = float(np.log(2) / best["exponent"][0.9])
        narrow = (
            f" The motion of (c) is chaotic, and looks quasi-periodic because the chaos is narrow: "
            f"a difference doubles in {doubling:.0f}, {doubling / later[0.9].mean():.1f} intervals "
            f"between reversals, yet these intervals differ by only {scatter[0.9]:.1%}."
        )
    calm = ""
    if not chaotic[0.6429]:
        calm = (
            f" In (a) it is {coarse['exponent'][0.6429]:.1g} at tol {coarse['tol'][0.6429]:g} and "
            f"{best['exponent'][0.6429]:.1g} at {best['tol'][0.6429]:g}: what there is of it "
            "is the integrator's."
        )
    return Claim(
        id="L1",
        where="Fig. 8",
        words="(a) theta = 0.6429: quasi-periodic with fluctuating periodicity; (b) 0.82: after "
        "the second reversal around t = 3000 it turns chaotic; (c) 0.9: quasi-periodic with a "
        "period much shorter than by the simplified dynamics",
        measured=f"{named}; (b) reverses a second time at {second:.1f}",
        value=float(best["exponent"][0.82]),
        low=float(best["exponent"][0.82] - 2 * best["error"][0.82]),
        high=float(best["exponent"][0.82] + 2 * best["error"][0.82]),
        verdict=word,
        evidence=said + f" Largest Lyapunov exponents over the second half of t = "
        f"{best['t_end'].iloc[0]:,.0f} at tol {best['tol'].iloc[0]:g}, errors from ten parts of "
        f"it; chaotic means a growth above e^{LEAST_GROWTH:g} there." + calm + narrow,
    )


def l2(tables: Mapping[str, pd.DataFrame]) -> Claim:
    """What the two models conserve."""
    rows = tables["invariants"]
    rows = rows.assign(moves=rows["casimir_high"] - rows["casimir_low"])
    simple, full = rows[rows["model"] == "reduced"], rows[rows["model"] == "full"]
    gaps = [intervals(tables["reversals"], theta, "reduced") for theta in PAPERS]
    uneven = max(float(gap.std() / gap.mean()) for gap in gaps)
    own = tables["reversals"]
    at = {
        theta: float(np.ptp(own["casimir"][(own["theta"] == theta) & (own["model"] == "full")]))
        for theta in own["theta"].unique()
    }
    word, said = verdict(
        [
            ("reduced: E_tot constant to 1e-8", bool((simple["energy_drift"] < 1e-8).all())),
            ("reduced: C_I constant to 1e-5", bool((simple["moves"] < 1e-5).all())),
            ("reduced: intervals between reversals equal to 1e-6", uneven < 1e-6),
            ("full: energy constant to 1e-8", bool((full["energy_drift"] < 1e-8).all())),
            ("full: C_I moves by more than 1", bool((full["moves"] > 1).all())),
        ]
    )  # fmt: skip
    moved = ", ".join(
        f"{moves:.3g} (at the reversals alone {at[theta]:.3g}) at theta = {theta:g}"
        for theta, moves in zip(full["theta"], full["moves"], strict=True)
    )
    return Claim(
        id="L2",
        where="Discussion, Eq. casimir",
        words="the simplified dynamics conserves the total energy and C_I and is periodic; in the "
        "original dynamics C_I varies and the motion is aperiodic",
        measured=(
            f"reduced model: E_tot to {simple['energy_drift'].max():.1g}, C_I to "
            f"{simple['moves'].max():.1g}, intervals between reversals to "
            f"{uneven:.1g}; full: energy to {full['energy_drift'].max():.1g}, C_I "
            f"moves by {moved}"
        ),
        value=float(full["moves"].min()),
        verdict=word,
        evidence=said + " C_I of the full motion: of the energies of pitch and roll averaged over "
        "one period of the roll, from the first reversal on. Away from the reversals part of it is "
        "the spin's: the modes are those without spin, and each has some of the other then.",
    )


def other_forces(figures: Mapping[str, Tables]) -> list[dict[str, Any]]:
    """Forces of the runs of the other figures."""
    return [
        row
        for name in ("fig4", "fig5", "fig6")
        if name in figures and "forces" in figures[name]
        for row in figures[name]["forces"].to_pylist()
    ]


def l3(runs: pd.DataFrame, others: list[dict[str, Any]]) -> Claim:
    """Forces at the contact."""
    top = runs.iloc[int(runs["ratio_max"].argmax())]
    light = runs.iloc[int(runs["normal_min"].argmin())]
    word, said = verdict(
        [
            ("the largest ratio rounds to 0.2", round(float(top["ratio_max"]), 1) == 0.2),
            ("F_parallel is positive throughout: the contact never opens",
             bool((runs["normal_min"] > 0).all())),
        ]
    )  # fmt: skip
    each = "; ".join(
        f"{row.run}: {row.ratio_max:.3f} at t = {row.ratio_t:.1f}, F_parallel at least "
        f"{row.normal_min:.3f} at t = {row.normal_t:.1f}"
        for row in runs.itertuples()
    )
    beyond = "; ".join(map(in_words, others))
    return Claim(
        id="L3",
        where="Discussion, footnote",
        words="in the cases of Fig. 8 the largest value of F_perp/F_parallel is around 0.2",
        measured=f"{each} (in M g)",
        value=float(top["ratio_max"]),
        verdict=word,
        evidence=said + f" A friction coefficient below {top['ratio_max']:.2f} would let the body "
        f"slip in {top['run']} at t = {top['ratio_t']:.1f}; it is lightest on the plane in "
        f"{light['run']}, with {light['normal_min']:.2f} of its weight. Forces every 0.05."
        + (f" In the other figures the largest ratios are: {beyond}." if beyond else ""),
    )


def in_words(row: Mapping[str, Any]) -> str:
    """Where a run would slip on any plane, or leave it."""
    text = f"{row['run']}: {row['ratio_max']:.2f} at t = {row['ratio_t']:.1f}"
    if row["open_t"] is not None:
        text = f"{row['run']}: without bound, as the contact would open at t = {row['open_t']:.1f}"
    if row["slip_t"] is not None:
        text += f" (above 1 first at t = {row['slip_t']:.1f})"
    return text
