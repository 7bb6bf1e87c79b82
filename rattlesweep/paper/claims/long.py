"""The paper's claims about the long runs of Fig. 8 (L1 to L3)."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from rattlesweep.paper.claims.claim import Claim
from rattlesweep.sweeps.tables.chaos import LEAST_GROWTH

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
    checks = [
        ("chaotic in (b) and not in (a)", bool(chaotic[0.82]) and not chaotic[0.6429]),
        ("(a) intervals between reversals scatter by less than 5 % and agree with the reduced "
         "model's within 5 %", scatter[0.6429] < 0.05 and abs(close - 1) < 0.05),
        (f"(b) second reversal within {NEAR:.0%} of t = 3000", abs(second / 3000 - 1) < NEAR),
        ("(b) intervals scatter by more than 20 %", scatter[0.82] > 0.2),
        ("(c) after the first, intervals scatter by less than 5 % and are shorter than half the "
         "reduced model's", scatter[0.9] < 0.05 and short < 0.5 and
         gaps[0.9][0] > 2 * later[0.9].mean()),
        ("(c) strictly quasi-periodic: not chaotic", not chaotic[0.9]),
    ]  # fmt: skip
    named = "; ".join(
        f"theta = {theta:g}: first interval between reversals {gaps[theta][0]:.0f}, then "
        f"{later[theta].mean():.0f} +- {scatter[theta]:.1%}, reduced model "
        f"{whole[theta].mean():.0f}; Lyapunov exponent {best['exponent'][theta]:.2g} +- "
        f"{best['error'][theta]:.1g}, growth e^{best['growth'][theta]:.0f}"
        for theta in gaps
    )
    narrow = ""
    if chaotic[0.9]:
        doubling = float(np.log(2) / best["exponent"][0.9])
        narrow = (
            " The motion of (c) is chaotic, but looks quasi-periodic because the chaos is confined "
            f"to a narrow band: small differences double in {doubling:.0f}, or "
            f"{doubling / later[0.9].mean():.1f} intervals between reversals, yet these intervals "
            f"differ by only {scatter[0.9]:.1%}."
        )
    calm = ""
    if not chaotic[0.6429]:
        calm = (
            f" In (a) it is {coarse['exponent'][0.6429]:.1g} at tol {coarse['tol'][0.6429]:g} and "
            f"{best['exponent'][0.6429]:.1g} at {best['tol'][0.6429]:g}, which is what the errors "
            "of the integrator leave of zero."
        )
    return Claim(
        id="L1",
        where="Fig. 8",
        words="(a) theta = 0.6429: “only quasi-periodic with fluctuating periodicity”; (b) 0.82: "
        "“after the time of the second spin reversal around t/t~ ~ 3000, it turns into chaotic, "
        "deviating from the simplified dynamics”; (c) 0.9: “quasi-periodic behavior after the "
        "initial round of spin reversals, and its periodicity is much shorter than that by the "
        "simplified dynamics”",
        measured=f"{named}; second reversal in (b) at {second:.1f}",
        value=float(best["exponent"][0.82]),
        low=float(best["exponent"][0.82] - 2 * best["error"][0.82]),
        high=float(best["exponent"][0.82] + 2 * best["error"][0.82]),
        checks=checks,
        notes=f"Largest Lyapunov exponents over the second half of t = "
        f"{best['t_end'].iloc[0]:,.0f} at tol {best['tol'].iloc[0]:g}, errors from ten parts of "
        f"it; chaotic means that a difference grows there by more than e^{LEAST_GROWTH:g}."
        + calm
        + narrow,
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
    moved = ", ".join(
        f"{moves:.3g} (at the reversals alone {at[theta]:.3g}) at theta = {theta:g}"
        for theta, moves in zip(full["theta"], full["moves"], strict=True)
    )
    return Claim(
        id="L2",
        where="Discussion, Eq. (51) [casimir]",
        words="“our simplified dynamics” “repeats itself and shows periodic behavior” “because the "
        "system with only three variables has two conservatives, i.e., the total energy and the "
        "Casimir invariant”; this one “actually varies and the original system shows aperiodic "
        "behaviors”",
        measured=(
            f"reduced model conserves E_tot to {simple['energy_drift'].max():.1g}, C_I to "
            f"{simple['moves'].max():.1g}, intervals between reversals to "
            f"{uneven:.1g}; full dynamics: energy to {full['energy_drift'].max():.1g}, C_I "
            f"varies by {moved}"
        ),
        value=float(full["moves"].min()),
        checks=[
            ("reduced: intervals between reversals equal to 1e-6", uneven < 1e-6),
            ("reduced: E_tot constant to 1e-8", bool((simple["energy_drift"] < 1e-8).all())),
            ("reduced: C_I constant to 1e-5", bool((simple["moves"] < 1e-5).all())),
            ("full: energy constant to 1e-8", bool((full["energy_drift"] < 1e-8).all())),
            ("full: C_I varies by more than 1", bool((full["moves"] > 1).all())),
        ],
        notes="C_I of the full dynamics is that of the energies of pitch and roll averaged over "
        "one period of the roll, from the first reversal on. Away from the reversals part of its "
        "change is due to the spin: the modes are those without spin, and with spin each contains "
        "some of the other.",
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
    each = "; ".join(
        f"{row.run}: {row.ratio_max:.3f} at t = {row.ratio_t:.1f}, F_parallel at least "
        f"{row.normal_min:.3f} at t = {row.normal_t:.1f}"
        for row in runs.itertuples()
    )
    beyond = "; ".join(map(in_words, others))
    return Claim(
        id="L3",
        where="Discussion, footnote",
        words="F_perp/F_parallel in the cases of Fig. 8: “its largest value is around 0.2”",
        measured=f"{each} (in M g)",
        value=float(top["ratio_max"]),
        checks=[
            ("the largest ratio rounds to 0.2", round(float(top["ratio_max"]), 1) == 0.2),
            (
                "F_parallel is positive throughout, so contact is never lost",
                bool((runs["normal_min"] > 0).all()),
            ),
        ],
        notes=f"With a friction coefficient below {top['ratio_max']:.2f} the body would slip in "
        f"{top['run']} at t = {top['ratio_t']:.1f}; the normal force is smallest in "
        f"{light['run']}, {light['normal_min']:.2f} of the weight. Forces are sampled every 0.05."
        + (f" Largest ratios in the other figures: {beyond}." if beyond else ""),
    )


def in_words(row: Mapping[str, Any]) -> str:
    """Largest ratio of a run, and whether it needs friction above 1 or loses contact."""
    text = f"{row['run']}: {row['ratio_max']:.2f} at t = {row['ratio_t']:.1f}"
    if row["open_t"] is not None:
        text = f"{row['run']}: unbounded, as contact would be lost at t = {row['open_t']:.1f}"
    if row["slip_t"] is not None:
        text += f" (above 1 first at t = {row['slip_t']:.1f})"
    return text
