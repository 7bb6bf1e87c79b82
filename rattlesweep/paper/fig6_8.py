"""Figs. 6 and 8: times of reversal in the unsteady and in the steady direction, and
the claims U1, U2 and S6 to S8 on them.

A point is what the figures show as one symbol: the runs with one torque coefficient,
spin and push.  In all claims, a mean agrees with the formula if it is within a tenth of
a decade of the line (a factor of 1.26), which is the size of a symbol on the paper's
logarithmic axes.

Runs of type SW and runs that reverse late are integrated again to record the extremes
of the spin in 64 windows of time.  The onset of wobbling, or of a reversal, is the
middle of the first window in which the loss of spin, 1 - n/n_i, exceeds half of the
largest loss in the run.
"""

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from rattlesweep.api import growth_rates, modes
from rattlesweep.api.style import GREY, SERIES, add_legend, value_text
from rattlesweep.arrays import Floats
from rattlesweep.paper.claim import Measured, every, extremes, rises
from rattlesweep.paper.workspace import (
    OMEGA_XY0,
    Made,
    Tables,
    Workspace,
    draw_spin,
    follow_run,
    paper_figure,
    records,
)
from rattlesweep.physics.body import PARAMETERS, Rattleback
from rattlesweep.statistics.intervals import Z95

# The size of a symbol, as a factor.
SYMBOL = 10**0.1
# Fewest runs for a median.  A statement about fewer than twice as many late runs, or
# four times as many runs that wobble or reverse, may fail by chance.
_FEW = 5
# Fig. 6(b): launch and duration.  The paper does not state the duration.
N_I = 0.5
_T_END = 150.0
# "Several times" t_rGH: a reversal after this multiple of t_rGH is late.
LATE_FROM = 2.0
# The spin has left its plateau when it has lost this fraction.
PLATEAU = 0.1


def runs_from_unsteady(ws: Workspace) -> Tables:
    """Return the tables ``times`` of Fig. 6(a) and ``spin`` of (b)."""
    run = follow_run(
        Rattleback.gh(), "n", "omega_x", n_i=N_I, omega_xy0=OMEGA_XY0, t_end=_T_END
    )
    return {"times": times(ws.sweep("unsteady"), "K_p"), "spin": run.table}


def steady(ws: Workspace) -> Tables:
    """Return the tables ``times`` of Fig. 8 and ``windows``, with a row a point."""
    runs = ws.sweep("steady")
    reverses = runs["type"] == "R"
    t_r = runs["t_r"].where(reverses)
    ratio = t_r / runs["t_rgh"]
    late = ratio > LATE_FROM
    # The growth rate of the roll at the launch, over that of the theory.
    roll = growth_rates(runs[[*PARAMETERS]], runs["n_i"].to_numpy(), exact=True).roll
    growth = roll / (runs["n_i"].abs() * runs["K_r_body"] / 2)
    # What happens within a run is looked at in those that wobble and in the late ones.
    chosen = runs[(runs["type"] == "SW") | late]
    seen = in_windows(ws.again(chosen, ws.sizes.windows, "windows")).reindex(runs.index)
    onset = seen["onset"].where(~reverses)
    centre = (seen["centre"] / runs["n_i"]).where(~reverses)
    # Each quantity is null in the runs that have none, so that they do not count below.
    points = runs.assign(
        late=late,
        t_reversed=t_r,
        ratio=ratio,
        ratio_prompt=ratio.where(~late),
        growth_late=growth.where(late),
        growth_prompt=growth.where(reverses & ~late),
        plateau=seen["plateau_end"] / t_r,
        onset=onset,
        onset_late=onset > LATE_FROM * runs["t_rgh"],
        centre=centre,
        centre_between=centre.between(0, 1, inclusive="neither"),
    ).groupby("case")
    windows = points.agg(
        **{name: (name, "first") for name in ("K_r", "n_i", "omega_xy0")},
        reversed=("t_reversed", "count"),
        t_r_median=("t_reversed", "median"),
        late=("late", "sum"),
        ratio_std=("ratio", "std"),
        ratio_std_prompt=("ratio_prompt", "std"),
        growth_late=("growth_late", "median"),
        growth_prompt=("growth_prompt", "median"),
        followed=("plateau", "count"),
        plateau=("plateau", "median"),
        wobbling=("onset", "count"),
        onset_median=("onset", "median"),
        onset_late=("onset_late", "sum"),
        centre_between=("centre_between", "sum"),
        centre_median=("centre", "median"),
        centre_low=("centre", "min"),
        centre_high=("centre", "max"),
    )
    return {"times": times(runs, "K_r"), "windows": windows}


def times(runs: pd.DataFrame, target: str) -> pd.DataFrame:
    """Return, for each point, reversal times and the theory's line at the mean n_0."""
    rows = (
        runs.assign(t_reversed=runs["t_r"].where(runs["type"] == "R"))
        .groupby("case")
        .agg(
            **{name: (name, "first") for name in (target, "n_i", "omega_xy0")},
            runs=("n_0", "size"),
            reversed=("t_reversed", "count"),
            t_r_mean=("t_reversed", "mean"),
            t_r_std=("t_reversed", "std"),
            t_r_sem=("t_reversed", "sem"),
            n_0_mean=("n_0", "mean"),
        )
    )
    n_0 = rows["n_0_mean"]
    mean = rows["t_r_mean"]
    std = rows["t_r_std"]
    # Garcia and Hubbard's time (Eqs. 56 and 58), with the coefficient of the point.
    line = 2 * np.arctanh(rows["n_i"].abs() / n_0) / (n_0 * rows[target])
    rows["t_rgh_line"] = line
    error_of_mean = Z95 * rows.pop("t_r_sem")
    error_of_std = _error_of_std(std, rows["reversed"])
    for name, value, error in (
        ("t_r_mean", mean, error_of_mean),
        ("t_r_std", std, error_of_std),
        ("ratio", mean / line, error_of_mean / line),
        ("scatter", std / mean, error_of_std / mean),
    ):
        rows[name] = value
        rows[f"{name}_low"] = value - error
        rows[f"{name}_high"] = value + error
    return rows


def _error_of_std(std: pd.Series, count: pd.Series) -> pd.Series:
    """Return half of the 95 % interval of standard deviations of normal samples."""
    return Z95 * std / np.sqrt(2 * (count - 1).clip(lower=1))


def in_windows(runs: pd.DataFrame) -> pd.DataFrame:
    """Return onset, end of the plateau and mean spin from the onset on; NaN: none."""
    columns = ["onset", "plateau_end", "centre"]
    seen = pd.DataFrame(np.nan, index=runs.index, columns=columns)
    names = ["n_i", "window_t", "window_n_min", "window_n_max"]
    for place, n_i, step, least, most in (
        runs.reindex(columns=names).dropna().itertuples()
    ):
        # The loss at the extreme nearest to zero, or beyond zero.
        nearest = least
        if n_i < 0:
            nearest = most
        loss = 1 - nearest / n_i
        plateau_end = first_above(loss, PLATEAU, step)
        if np.isnan(plateau_end):
            # The loss came after the last whole window, in the one in which the run
            # ended.  The plateau lasts until that one begins.
            plateau_end = len(loss) * step
        half_of_loss = loss.max() / 2
        onset = first_above(loss, half_of_loss, step)
        from_onset = np.argmax(loss > half_of_loss)
        centre = ((least + most) / 2)[from_onset:].mean()
        seen.loc[place] = (onset, plateau_end, centre)
    return seen


def first_above(loss: Floats, level: float, step: float) -> float:
    """Return the middle of the first window with a loss above a level, or NaN."""
    above = np.flatnonzero(loss > level)
    if not above.size:
        return np.nan
    return (float(above[0]) + 0.5) * step


def close(ratio: pd.Series) -> pd.Series:
    """Return which ratios are 1 within the size of a symbol."""
    return ratio.between(1 / SYMBOL, SYMBOL)


def beside_formula(points: pd.DataFrame, coefficient: str) -> Measured:
    """Measure whether means are near the formula, and go as 1 over the coefficient."""
    # Within sampling error, a mean may be close that is not.
    may_be_close = (points["ratio_low"] < SYMBOL) & (points["ratio_high"] > 1 / SYMBOL)
    # A curve has one spin and one push; on logarithmic axes its slope should be -1.
    slopes = [
        float(np.polyfit(np.log(curve[coefficient]), np.log(curve["t_r_mean"]), 1)[0])
        for _, curve in points.groupby(["n_i", "omega_xy0"])
        if len(curve) > 1
    ]
    by_distance = points.sort_values("ratio", key=lambda ratio: np.abs(np.log(ratio)))
    farthest = records(by_distance)[-1]
    value = farthest["ratio"]
    low = farthest["ratio_low"]
    high = farthest["ratio_high"]
    checks = [
        every(close(points["ratio"]), may_be_close),
        max(abs(slope + 1) for slope in slopes) < 0.1,
    ]
    return checks, {
        "value": value,
        "low": low,
        "high": high,
        "slopes": extremes(slopes),
        "least": points["ratio"].min(),
        "largest": points["ratio"].max(),
        "farthest": f"{value:.3f} [{low:.3f}, {high:.3f}] at "
        f"{coefficient} = {farthest[coefficient]:.3g}, "
        f"n_i = {farthest['n_i']:g}, omega_xy0 = {farthest['omega_xy0']:g}",
    }


def unsteady_formula(made: Made) -> Measured:
    """Measure U1: at small spin and oscillation the formula holds."""
    points = made["fig6"]["times"].query("abs(n_i) <= 0.2 and omega_xy0 <= 0.01")
    points = points.dropna(subset=["ratio"])
    checks, numbers = beside_formula(points, "K_p")
    outside = ", ".join(
        f"K_p = {point.K_p:g} at n_i = {point.n_i:g}, "
        f"omega_xy0 = {point.omega_xy0:g} ({point.ratio:.2f})"
        for point in points[~close(points["ratio"])].itertuples()
    )
    return [*checks, every(points["scatter"] < 0.1, points["scatter_low"] < 0.1)], {
        **numbers,
        "ten": every((points["ratio"] - 1).abs() < 0.1),
        "scatter": extremes(points["scatter"]),
        "outside": outside or "none",
    }


def large_spin(made: Made) -> Measured:
    """Measure U2: at large spin or oscillation reversals are later and scatter more."""
    points = made["fig6"]["times"].dropna(subset=["ratio"])
    fast = points.query("abs(n_i) >= 0.4")
    # The run of Fig. 6(b), before it reverses.
    series = made["fig6"]["spin"]
    until = series[: int(np.argmax(series["n"] < 0))]
    spin = swing_frequency(until["t"], until["n"])
    swing = swing_frequency(until["t"], until["omega_x"])
    by_push = ("n_i", "K_p")  # what the groups share in which the push rises
    by_spin = ("omega_xy0", "K_p")
    checks = [
        every(points["ratio_low"] > 1, points["ratio_high"] > 1),
        rises(points, "ratio", "omega_xy0", by_push),
        rises(points, "ratio", "n_i", by_spin),
        rises(points, "scatter", "omega_xy0", by_push),
        every(fast["ratio"] > SYMBOL, fast["ratio_high"] > SYMBOL),
        rises(fast, "t_r_mean", "n_i", by_spin)
        + rises(fast, "t_r_std", "n_i", by_spin),
        abs(spin / swing - 1) < 0.1,
    ]
    return checks, beside_formula(points, "K_p")[1] | {
        "value": points["ratio"].max(),
        "low": None,
        "high": None,
        "fast": extremes(fast["ratio"]),
        "spin": spin,
        "span": np.ptp(until["n"]),
        "multiple": spin / swing,
        "pitch": swing / float(modes(Rattleback.gh()).omega_p),
    }


def swing_frequency(t: pd.Series, values: pd.Series) -> float:
    """Return the angular frequency above 0.5 where the spectrum is strongest."""
    power = np.abs(np.fft.rfft((values - values.mean()) * np.hanning(len(values))))
    omega = 2 * np.pi * np.fft.rfftfreq(len(values), t.iloc[1] - t.iloc[0])
    # Frequencies below 0.5 belong to the slow change of the spin itself.
    return float(omega[np.argmax(power * (omega > 0.5))])


def steady_formula(made: Made) -> Measured:
    """Measure S6: in the steady direction the formula holds for slow small launches."""
    sizes = made["fig8"]["times"].dropna(subset=["ratio"]).query("abs(n_i) <= 0.2")
    large = sizes.query("omega_xy0 > 0.01")
    curves = ("n_i", "K_r")
    checks, numbers = beside_formula(sizes.query("omega_xy0 <= 0.01"), "K_r")
    return [
        *checks,
        rises(sizes, "ratio", "omega_xy0", curves, sign=-1),
        every(large["ratio_high"] < 1, large["ratio_low"] < 1),
        rises(sizes, "scatter", "omega_xy0", curves),
    ], numbers | {"large": extremes(large["ratio"])}


def late_reversals(made: Made) -> Measured | None:
    """Measure S7: at fast spins and small K_r some runs reverse late and abruptly."""
    points = made["fig8"]["windows"].query("abs(n_i) >= 0.3")
    points = points.dropna(subset=["ratio_std"])
    low = points.query("K_r < 0.03")
    high = points.query("K_r > 0.06")
    # Points with more than a few late reversals.
    many = low.query("late >= 0.03 * reversed")
    if low.empty or high.empty or many.empty:
        return None
    spread = low["ratio_std"].median()
    calm = high["ratio_std"].median()
    # For each spin and push: the smallest scatter at small K_r, as measured and at the
    # upper end of its interval, and the largest scatter at large K_r.
    upper_end = low["ratio_std"] + _error_of_std(low["ratio_std"], low["reversed"])
    scatter = low.assign(upper_end=upper_end).groupby(["n_i", "omega_xy0"])
    largest = high.groupby(["n_i", "omega_xy0"])["ratio_std"].max()
    # The scatter without the late runs, over that with them.
    without = many["ratio_std_prompt"] / many["ratio_std"]
    followed = many.query("followed > 0").dropna(subset=["plateau"])
    rare = many["late"] < 2 * _FEW
    checks = [
        bool(spread > 2 * calm),
        every(
            scatter["ratio_std"].min() > largest, scatter["upper_end"].min() > largest
        ),
        every(without < 0.5, rare),
        every(many["growth_late"] < 0.5, rare),
        every(followed["plateau"] > 0.9, followed["followed"] < 2 * _FEW),
    ]
    return checks, {
        "value": float(spread / calm),
        "spread": spread,
        "calm": calm,
        "kept": followed["plateau"].median(),
        "late": [
            f"{points['late'].sum():.0f} of {points['reversed'].sum():.0f}"
            for points in (low, high)
        ],
        "growth": [many[f"growth_{name}"].median() for name in ("late", "prompt")],
    }


def onset_of_wobbling(made: Made) -> Measured | None:
    """Measure S8: wobbling begins when other runs reverse; None: too few runs."""
    windows = made["fig8"]["windows"]
    points = windows.query(f"wobbling >= {_FEW} and reversed >= {_FEW}")
    if points.empty:
        return None
    ratio = (points["onset_median"] / points["t_r_median"]).rename("ratio")
    few = points[["wobbling", "reversed"]].min(axis=1) < 4 * _FEW
    weak = windows.query("K_r < 0.03 and abs(n_i) >= 0.3")
    late = weak["onset_late"].sum() / max(1, weak["wobbling"].sum())
    return [every(ratio.between(0.5, 2), few), every([late > 0], True)], {
        "value": ratio.median(),
        "low": ratio.min(),
        "high": ratio.max(),
        "points": len(ratio),
        "fine": int(close(ratio).sum()),
        "late": late,
        "sizes": records(ratio.groupby(points["omega_xy0"]).median().reset_index()),
    }


def draw_times(tables: Tables) -> Figure:
    """Draw a panel for each of five spins and, for Fig. 6, the run of (b)."""
    values = tables["times"]
    # Only Fig. 6, of the unsteady direction, has a single run.
    spin = tables.get("spin")
    if spin is not None:
        coefficient = "K_p"
        direction = "u"
        sign = "+"
    else:
        coefficient = "K_r"
        direction = "s"
        sign = "-"
    figure = paper_figure(9.2, 6.15)
    axes = list(figure.subplots(2, 3).ravel())
    # All panels have one vertical range.
    means = values[["t_r_mean", "t_rgh_line"]].to_numpy()
    for axis, n_i in zip(axes, sorted(values["n_i"].unique(), key=abs), strict=False):
        points = values[values["n_i"] == n_i].sort_values(coefficient)
        # The legend shows the formula once, in grey.
        axis.plot(
            [],
            [],
            color=GREY,
            linewidth=1.1,
            label=f"$t_{{rGH{sign}}}$ at the mean $n_0$",
        )
        for (size, rows), (colour, marker) in zip(
            points.groupby("omega_xy0"), SERIES, strict=False
        ):
            x = rows[coefficient]
            mean = rows["t_r_mean"]
            std = rows["t_r_std"]
            axis.plot(x, rows["t_rgh_line"], color=colour, linewidth=1.1, zorder=2)
            # On a logarithmic axis a bar that reaches zero has no lower end.
            bars = np.array([np.minimum(std, 0.999 * mean), std])
            axis.errorbar(
                x,
                mean,
                yerr=bars,
                color=colour,
                marker=marker,
                markersize=5,
                linestyle="none",
                markerfacecolor="white",
                markeredgewidth=1.2,
                elinewidth=0.9,
                capsize=2.2,
                zorder=3,
                label=value_text("omega_xy0", size),
            )
        axis.set(
            xscale="log",
            yscale="log",
            xlabel=f"${coefficient}$",
            xlim=(points[coefficient].min() / 1.35, points[coefficient].max() * 1.35),
            ylim=(np.nanmin(means) / 2.5, np.nanmax(means) * 2.5),
            title=value_text("n_i", n_i),
        )
        # On a short logarithmic axis the labels between decades overlap.
        axis.tick_params(axis="x", which="minor", labelbottom=False)
        axis.grid(visible=True)
    for axis in axes[::3]:
        axis.set_ylabel(rf"$t_{{r{direction}}}$ / $\tilde t$")
    handles = axes[0].get_legend_handles_labels()[0]
    if spin is None:
        # The legend stands in the place that is left.
        axes[-1].axis("off")
        axes[-1].legend(handles=handles, loc="center")
    else:
        add_legend(figure, handles)
        draw_spin(axes[-1], spin)
        axes[-1].set_title(f"(b) GH, {value_text('n_i', N_I)}")
        axes[0].set_title("(a)", loc="left")
    return figure
