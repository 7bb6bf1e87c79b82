"""The paper's claims about the sweeps of Figs. 5 to 7 (U1, U2, S1 to S4, S6 to S8).

To agree with the formula means in all of them that the mean is within a tenth of a decade of the
line (a factor of 1.26), the size of a symbol on the paper's logarithmic axes; the headline asks it
of nine points in ten, and a further check of all.  Fractions come with Wilson's interval, means
with the normal one, both 95 %.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from rattlesweep.paper.claims.checks import EDGE, SYMBOL, covers, ends, of, rises
from rattlesweep.paper.claims.claim import Claim
from rattlesweep.paper.claims.steady import steady_claims

if TYPE_CHECKING:
    from collections.abc import Mapping

    import pandas as pd
    import pyarrow as pa

    Tables = Mapping[str, pa.Table]

# Fewest runs of a kind for a median.
FEW = 5
# Share of the points that "most" are.
MOST = 0.9


def claims(figures: Mapping[str, Tables]) -> list[Claim]:
    """Rows of the claims table that the figures made can settle.

    A sweep whose points are not those that the claims speak of settles none.

    Parameters
    ----------
    figures : mapping
        Tables of the figures that were made, by name.
    """
    rows: list[Claim] = []
    if "fig5" in figures:
        frame = figures["fig5"]["times"].to_pandas()
        if covers(frame):
            rows += [u1(frame), u2(frame, figures["fig5"].get("spin"))]
    if "fig6" in figures:
        rows += steady_claims(figures["fig6"])
    if "fig7" in figures:
        tables = {name: table.to_pandas() for name, table in figures["fig7"].items()}
        if covers(tables["times"]):
            rows += [s6(tables["times"]), *s7(tables["late"]), s8(tables["onset"])]
    return rows


def slow_and_small(frame: pd.DataFrame) -> pd.DataFrame:
    """Points with abs(n_i) <= 0.2 and omega_xy0 <= 0.01, where the formula should hold."""
    return frame[(frame["n_i"].abs() <= 0.2 + EDGE) & (frame["omega_xy0"] <= 0.01 + EDGE)]


def beside_line(frame: pd.DataFrame) -> pd.DataFrame:
    """Add ``ratio``, mean over line, with its interval, and ``scatter``, deviation over mean."""
    line = frame["t_rgh_line"]
    return frame.assign(
        ratio=frame["t_r_mean"] / line,
        ratio_low=frame["t_r_low"] / line,
        ratio_high=frame["t_r_high"] / line,
        scatter=frame["t_r_std"] / frame["t_r_mean"],
    ).dropna(subset=["ratio"])


def slopes(frame: pd.DataFrame, coefficient: str) -> np.ndarray[Any, Any]:
    """Slope of log mean time against log coefficient, one a spin and oscillation."""
    return np.array(
        [
            np.polyfit(np.log(own[coefficient]), np.log(own["t_r_mean"]), 1)[0]
            for _, own in frame.groupby(["n_i", "omega_xy0"])
            if len(own) > 1
        ]
    )


def extreme(frame: pd.DataFrame, coefficient: str) -> str:
    """The ratio farthest from 1 with its interval, and where it is."""
    row = frame.loc[np.log(frame["ratio"]).abs().idxmax()]
    return (
        f"{row['ratio']:.3f} [{row['ratio_low']:.3f}, {row['ratio_high']:.3f}] at {coefficient} = "
        f"{row[coefficient]:.3g}, n_i = {row['n_i']:g}, omega_xy0 = {row['omega_xy0']:g}"
    )


def u1(times: pd.DataFrame) -> Claim:
    """Small spin and oscillation: the formula holds."""
    points = beside_line(slow_and_small(times))
    near = np.abs(np.log(points["ratio"])) < np.log(SYMBOL)
    ten = np.abs(points["ratio"] - 1) < 0.1
    slope = slopes(points, "K_p")
    steep = float(np.max(np.abs(slope + 1)))
    odd = points[~near]
    named = ", ".join(
        f"K_p = {r.K_p:g} at n_i = {r.n_i:g}, omega_xy0 = {r.omega_xy0:g} ({r.ratio:.2f})"
        for r in odd.itertuples()
    )
    row = points.loc[np.log(points["ratio"]).abs().idxmax()]
    return Claim(
        id="U1",
        where="Fig. 5(a)",
        words="n_i <~ 0.2 with omega_xy0 = 0.001, 0.01: “t_ru is in good agreement with the "
        "Garcia-Hubbard formula t_rGH+”, “i.e., almost inversely proportional to K_p with small "
        "scatter around the average”",
        measured=(
            f"mean t_ru over t_rGH+: {points['ratio'].min():.3f} to {points['ratio'].max():.3f} "
            f"(farthest: {extreme(points, 'K_p')}); {ten.sum()} of {len(ten)} points within 10 %; "
            f"slopes {slope.min():.3f} to {slope.max():.3f}; scatter {points['scatter'].min():.1%} "
            f"to {points['scatter'].max():.1%} of the mean"
        ),
        value=float(row["ratio"]),
        low=float(row["ratio_low"]),
        high=float(row["ratio_high"]),
        checks=[
            (
                f"most means within a factor {SYMBOL:.2f} of the formula ({near.sum()} of "
                f"{len(near)})",
                bool(near.mean() >= MOST),
            ),
            ("strictly: all of them", bool(near.all())),
            ("slopes of log t_ru against log K_p within 0.1 of -1", steep < 0.1),
            (
                "scatter below a tenth of the mean at every point",
                bool((points["scatter"] < 0.1).all()),
            ),
        ],
        notes=f"Outside: {named}." if named else "",
    )


def u2(times: pd.DataFrame, spin: pa.Table | None) -> Claim:
    """Large spin or oscillation: later than the formula, with larger deviations."""
    points = beside_line(times)
    up = rises(points, "ratio", "omega_xy0", ("n_i", "K_p"))
    up_spin = rises(points, "ratio", "n_i", ("omega_xy0", "K_p"))
    wide = rises(ends(points, "omega_xy0"), "scatter", "omega_xy0", ("n_i", "K_p"))
    widening = rises(points, "scatter", "omega_xy0", ("n_i", "K_p"))
    fast = points[points["n_i"] >= 0.4 - EDGE]
    longer = rises(fast, "t_r_mean", "n_i", ("omega_xy0", "K_p"))
    broader = rises(fast, "t_r_std", "n_i", ("omega_xy0", "K_p"))
    off = (fast["ratio"] > SYMBOL).to_numpy()
    above = points["ratio_low"] > 1
    checks = [
        (f"the formula underestimates most means ({above.sum()} of {len(above)})",
         bool(above.mean() >= MOST)),
        ("strictly: all of them", bool(above.all())),
        (f"mean over formula rises with omega_xy0 ({of(up)} curves)", up[0] == up[1]),
        (f"mean over formula rises with n_i ({of(up_spin)})", up_spin[0] == up_spin[1]),
        (f"relative scatter at the largest omega_xy0 above that at the smallest ({of(wide)} "
         "curves)", wide[0] == wide[1]),
        (f"strictly: it rises from each omega_xy0 to the next ({of(widening)})",
         widening[0] == widening[1]),
        (f"n_i >= 0.4: most means off by more than a factor {SYMBOL:.2f} ({off.sum()} of "
         f"{len(off)})", len(off) > 0 and off.mean() >= MOST),
        (f"n_i >= 0.4: mean and deviation rise with n_i ({of(longer)}, {of(broader)})",
         longer[0] == longer[1] and broader[0] == broader[1]),
    ]  # fmt: skip
    swing = "" if spin is None else _swing(spin, checks)
    calm = ", ".join(
        f"n_i = {n:g}, K_p = {k:g}"
        for (n, k), own in ends(points, "omega_xy0").groupby(["n_i", "K_p"])
        if not own.sort_values("omega_xy0")["scatter"].is_monotonic_increasing
    )
    low = fast["ratio"].min() if len(fast) else np.nan
    high = fast["ratio"].max() if len(fast) else np.nan
    return Claim(
        id="U2",
        where="Fig. 5(a), (b)",
        words="as omega_xy0 becomes large, “the standard deviations of t_ru become large, and the "
        "average of t_ru deviates upward from the Garcia-Hubbard formula t_rGH+”; “For larger n_i, "
        "t_rGH+ also underestimates t_ru”; n_i >~ 0.4: “the Garcia-Hubbard formula is no longer "
        "valid”, “The spin oscillates widely at the pitch frequency”",
        measured=(
            f"mean t_ru over t_rGH+: {points['ratio'].min():.3f} to {points['ratio'].max():.2f} "
            f"overall, {low:.2f} to {high:.2f} for n_i >= 0.4 (farthest: {extreme(points, 'K_p')})"
            + swing
        ),
        value=float(points["ratio"].max()),
        checks=checks,
        notes=f"The scatter does not increase at {calm}." if calm else "",
    )


def _swing(spin: pa.Table, checks: list[tuple[str, bool]]) -> str:
    """At what frequency the spin of Fig. 5(b) oscillates until it reverses; adds the checks."""
    from rattlesweep.physics import theory
    from rattlesweep.physics.body import Rattleback

    body = Rattleback.gh()
    pitch = float(theory.modes(body.alpha, body.beta, body.theta, body.phi, body.xi).omega_p)
    t, n, omega_x = (spin[name].to_numpy() for name in ("t", "n", "omega_x"))
    until = int(np.argmax(n < 0)) if np.any(n < 0) else len(n)
    found = swing_frequency(t[:until], n[:until])
    own = swing_frequency(t[:until], omega_x[:until])
    checks += [
        ("(b): the spin oscillates at the run's pitch frequency, or twice that, within 10 %",
         min(abs(found / own - k) / k for k in (1, 2)) < 0.1),
        ("strictly: at the pitch frequency itself", abs(found / own - 1) < 0.1),
    ]  # fmt: skip
    return (
        f"; (b): before it reverses, the spin oscillates at {found:.2f} over a range of "
        f"{np.ptp(n[:until]):.2f}, {found / own:.2f} times the frequency of omega_x, which is "
        f"{own / pitch:.2f} omega_p at this spin"
    )


def swing_frequency(t: np.ndarray[Any, Any], n: np.ndarray[Any, Any]) -> float:
    """Angular frequency of the strongest line above 0.5 in the spectrum of evenly spaced values."""
    values = (n - n.mean()) * np.hanning(len(n))
    power = np.abs(np.fft.rfft(values)) ** 2
    omega = 2 * np.pi * np.fft.rfftfreq(len(n), (t[-1] - t[0]) / (len(t) - 1))
    # The slow change of the spin itself lies below.
    fast = omega > 0.5
    return float(omega[fast][np.argmax(power[fast])])


def s6(times: pd.DataFrame) -> Claim:
    """Small spin and oscillation in the steady direction: the formula holds."""
    points = beside_line(slow_and_small(times))
    near = np.abs(np.log(points["ratio"])) < np.log(SYMBOL)
    slope = slopes(points, "K_r")
    slow = beside_line(times[times["n_i"].abs() <= 0.2 + EDGE])
    wide = rises(ends(slow, "omega_xy0"), "scatter", "omega_xy0", ("n_i", "K_r"))
    widening = rises(slow, "scatter", "omega_xy0", ("n_i", "K_r"))
    down = rises(slow.assign(down=-slow["ratio"]), "down", "omega_xy0", ("n_i", "K_r"))
    large = slow[slow["omega_xy0"] > 0.01 + EDGE]
    below = (large["ratio_high"] < 1).to_numpy()
    row = points.loc[np.log(points["ratio"]).abs().idxmax()]
    return Claim(
        id="S6",
        where="Fig. 7",
        words="abs(n_i) <~ 0.2 with omega_xy0 = 0.01, 0.001: “t_rs is in good agreement with "
        "Garcia-Hubbard formula t_rGH-”, “almost inversely proportional to K_r”; “the standard "
        "deviations of t_rs become large, and the average t_rs deviates downward from t_rGH- as "
        "initial oscillation amplitude omega_xy0 becomes large”",
        measured=(
            f"mean t_rs over t_rGH-: {points['ratio'].min():.3f} to {points['ratio'].max():.3f} "
            f"(farthest: {extreme(points, 'K_r')}); slopes {slope.min():.3f} to {slope.max():.3f}; "
            f"with the largest omega_xy0 {large['ratio'].min():.2f} to {large['ratio'].max():.2f}"
        ),
        value=float(row["ratio"]),
        low=float(row["ratio_low"]),
        high=float(row["ratio_high"]),
        checks=[
            (
                f"abs(n_i) <= 0.2, omega_xy0 <= 0.01: most means within a factor {SYMBOL:.2f} of "
                f"the formula ({near.sum()} of {len(near)})",
                bool(near.mean() >= MOST),
            ),
            ("strictly: all of them", bool(near.all())),
            (
                "slopes of log t_rs against log K_r within 0.1 of -1",
                bool(np.max(np.abs(slope + 1)) < 0.1),
            ),
            (
                f"abs(n_i) <= 0.2: mean over formula falls as omega_xy0 grows ({of(down)} curves)",
                down[0] == down[1],
            ),
            (
                f"omega_xy0 > 0.01: every mean below the formula ({below.sum()} of {len(below)})",
                bool(below.all()),
            ),
            (
                f"relative scatter at the largest omega_xy0 above that at the smallest ({of(wide)} "
                "curves)",
                wide[0] == wide[1],
            ),
            (
                f"strictly: it rises from each omega_xy0 to the next ({of(widening)})",
                widening[0] == widening[1],
            ),
        ],
    )


def s7(late: pd.DataFrame) -> list[Claim]:
    """Fast spins, small K_r: some reverse several t_rGH late, and abruptly.

    Nothing if none of the points has a small or none a large K_r, or nothing reverses late.
    """
    fast = late[late["n_i"].abs() >= 0.3 - EDGE].dropna(subset=["ratio_std"])
    small = fast[fast["K_r"] < 0.03]
    large = fast[fast["K_r"] > 0.06]
    # Where late reversals are more than a few.
    many = small[small["late"] >= 0.03 * small["reversed"]]
    if small.empty or large.empty or many.empty:
        return []
    spread, calm = small["ratio_std"].median(), large["ratio_std"].median()
    without = many["ratio_std_prompt"] / many["ratio_std"]
    slower = many["growth_late"] / many["growth_prompt"]
    kept = many[many["followed"] > 0]["plateau"].dropna()
    claim = Claim(
        id="S7",
        where="Fig. 7",
        words="abs(n_i) >~ 0.3: “the standard deviations are large for K_r << 0.1”; “some samples "
        "appear to spin stably for quite a long time, i.e., several times of t_rGH-, and then "
        "abruptly starts to reverse its sign”; “the rolling grows much more slowly than it should "
        "as predicted by the theory”",
        measured=(
            f"standard deviation of t_rs/t_rGH, median of the points: {spread:.2f} at K_r < 0.03, "
            f"{calm:.3f} at K_r > 0.06; late reversals: {small['late'].sum():.0f} of "
            f"{small['reversed'].sum():.0f} and {large['late'].sum():.0f} of "
            f"{large['reversed'].sum():.0f}; growth rate of the roll at n_i over the theory's "
            f"abs(n_i) K_r/2: {many['growth_late'].median():.2f} for late ones, "
            f"{many['growth_prompt'].median():.2f} for others; late ones lose 10 % of their spin "
            f"at {kept.median():.0%} of t_rs"
        ),
        value=float(spread / calm),
        checks=[
            (
                "scatter at K_r < 0.03 at least twice that at K_r > 0.06 (medians of the points)",
                bool(spread > 2 * calm),
            ),
            (
                "strictly: every point there scatters more than every one at K_r > 0.06",
                bool(small["ratio_std"].min() > large["ratio_std"].max()),
            ),
            (
                "without the late reversals the scatter is less than half "
                f"({without.median():.2f} of it, median of the points with 3 % late)",
                bool(without.median() < 0.5),
            ),
            (
                f"strictly: at every one (at {int((without < 0.5).sum())} of {len(without)})",
                bool((without < 0.5).all()),
            ),
            (
                "the roll of the late ones grows at less than half the others' rate, everywhere",
                bool((slower < 0.5).all()),
            ),
            (
                "the late ones keep 90 % of their spin for 90 % of the time, at half of the points",
                len(kept) > 0 and bool(kept.median() > 0.9),
            ),
            (
                f"strictly: at every one (at {int((kept > 0.9).sum())} of {len(kept)})",
                len(kept) > 0 and bool((kept > 0.9).all()),
            ),
        ],
        notes="The growth rate is the exact one of linear theory at the spin n_i (an eigenvalue), "
        "which falls to zero at Bondi's threshold, while the formula contains only its limit for "
        "small spins: the late ones are close to that threshold.",
    )
    return [claim]


def s8(onset: pd.DataFrame) -> Claim:
    """Wobbling begins about when the others reverse."""
    points = onset[(onset["wobbling"] >= FEW) & (onset["reversed"] >= FEW)]
    ratio = points["onset_median"] / points["t_r_median"]
    near = (ratio > 0.5) & (ratio < 2)
    small = onset[(onset["K_r"] < 0.03) & (onset["n_i"].abs() >= 0.3 - EDGE)]
    share = small["onset_late"].sum() / max(1, small["wobbling"].sum())
    fine = np.abs(np.log(ratio)) < np.log(SYMBOL)
    sizes = ", ".join(
        f"{own.median():.2f} at {size:g}" for size, own in ratio.groupby(points["omega_xy0"])
    )
    middle = float(ratio.median()) if len(ratio) else None
    return Claim(
        id="S8",
        where="end of Results",
        words="“The time when the spin starts to wobble roughly corresponds with t_rs of Type R”; "
        "“there are some samples which start to wobble after several times of t_rGH- where "
        "K_r << 0.1”",
        measured=(
            f"median onset over median t_rs: {ratio.min():.2f} to {ratio.max():.2f}, median "
            f"{ratio.median():.2f}, over {len(ratio)} points; within a factor {SYMBOL:.2f} at "
            f"{fine.sum()} of them; {share:.1%} of the onsets at K_r < 0.03, abs(n_i) >= 0.3 are "
            "late"
        ),
        value=middle,
        low=float(ratio.min()) if len(ratio) else None,
        high=float(ratio.max()) if len(ratio) else None,
        checks=[
            (
                f"median onset within a factor of 2 of the median t_rs at 95 % of the points with "
                f"{FEW} runs of each ({near.sum()} of {len(near)})",
                len(near) > 0 and bool(near.mean() >= 0.95),
            ),
            ("some begin late at K_r < 0.03, abs(n_i) >= 0.3", bool(share > 0)),
        ],
        notes="Onset: middle of the first of 64 windows in which the spin has lost half of its "
        f"largest loss. Medians by omega_xy0: {sizes}.",
    )
