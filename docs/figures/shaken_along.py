"""Draw the figure of docs/shaken.md for drives along the plane, and print its tables.

rattlesweep run configs/shaken_along.yaml
python docs/figures/shaken_along.py out/shaken_along docs/shaken_along.png
"""

import sys

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from shaken import GH, OMEGA, PSI, SIGMA, J, K, write_above

import rattlesweep as rs
from rattlesweep.physics.driven import growth_of_push, spin_of_push

COLOURS = {0.005: "#9bb7d4", 0.02: "#1f5f8b", 0.05: "#c0392b"}
TAP = {"n_i": 0, "omega_xy0": 1e-3, "psi": 45}
# At this spin the roll begins to grow.
LIMIT = SIGMA / J["roll"] / K["roll"]


def along(frequency: object, acceleration: object, azimuth: object = 45) -> dict:
    """Return the keys of a plane that shakes along itself."""
    return {
        "frequency": frequency,
        "acceleration": acceleration,
        "direction": "horizontal",
        "azimuth_deg": azimuth,
    }


def predicted(frequency: object, acceleration: object, sigma: object = SIGMA) -> object:
    """Return the spin to which a drive near the frequency of the pitch leads."""
    damping = np.asarray(sigma) / 2 / J["pitch"]
    of_mode = J["pitch"], damping, K["pitch"]
    return spin_of_push(OMEGA["pitch"], frequency, acceleration, *of_mode)


def draw_spins(axis: Axes, runs: pd.DataFrame, lowest: float, highest: float) -> None:
    """Draw the mean spin over some drives, with what the spin varies by."""
    some = runs[runs["base_frequency"].between(lowest, highest)]
    for acceleration, each in some.groupby("base_acceleration"):
        colour = COLOURS[acceleration]
        x = each["base_frequency"]
        mean = each["n_late_mean"]
        spread = each["n_late_std"]
        axis.fill_between(
            x, mean - spread, mean + spread, color=colour, alpha=0.2, lw=0
        )
        label = f"$\\varepsilon$ = {acceleration:g}"
        axis.plot(x, mean, color=colour, lw=1, label=label)
    for mode, omega in OMEGA.items():
        if lowest < omega < highest:
            axis.axvline(omega, color="0.6", lw=0.8, zorder=0)
            write_above(axis, omega, f"$\\omega_{mode[0]}$")
    axis.set_xlim(lowest, highest)
    axis.set_xlabel(r"drive $\Omega$, $\sqrt{g/a}$")


def draw_closed_form(axis: Axes, lowest: float, highest: float) -> None:
    """Draw the spins of the closed form, up to that at which the roll grows."""
    frequency = np.linspace(lowest, highest, 801)
    for acceleration, colour in COLOURS.items():
        spin = np.array(predicted(frequency, acceleration))
        spin[spin < LIMIT] = np.nan
        axis.plot(frequency, spin, color=colour, lw=1.1, ls="--")
    axis.axhline(LIMIT, color="0.6", lw=0.8, ls=":")


def draw_courses(axis: Axes) -> None:
    """Draw the spin over the time under a drive of each mode."""
    for mode, acceleration, colour in (
        ("pitch", 0.02, "#1f5f8b"),
        ("roll", 0.005, "#d08b2c"),
    ):
        # With the kernel of the study; a trajectory would compile one more.
        runs = rs.simulate(
            GH,
            t_end=np.linspace(10.0, 4000.0, 400),
            base=along(OMEGA[mode], acceleration),
            sigma=SIGMA,
            record="late",
            **TAP,
        )
        label = f"$\\Omega = \\omega_{mode[0]}$, $\\varepsilon$ = {acceleration:g}"
        axis.plot(runs.t_end, runs.n_end, lw=0.8, color=colour, label=label)
    axis.set(xlabel=r"time, $\sqrt{a/g}$", ylabel="spin")
    axis.set_ylim(-0.105, 0.055)
    axis.legend(frameon=False, fontsize=7, loc="lower right")


def tell(runs: pd.DataFrame) -> None:
    """Print what the page says about the runs of the config."""
    print(runs["status"].value_counts().to_string())
    print("largest energy drift", runs["energy_drift"].abs().max())
    for acceleration, some in runs.groupby("base_acceleration"):
        steady = some[some["n_late_mean"] < -0.002]
        found = steady["base_frequency"]
        deepest = some.loc[some["n_late_mean"].idxmin()]
        print(
            f"eps {acceleration:g}: mean below -0.002 from {found.min():.2f} to "
            f"{found.max():.2f}, {len(found)} drives; lowest "
            f"{deepest.n_late_mean:.4f} at {deepest.base_frequency:.2f}"
        )
        far = some[some["base_frequency"] > 2]
        print(f"  above 2: largest mean {far['n_late_mean'].abs().max():.1e}")


def tell_growth() -> None:
    """Print the growth of each mode from rest at its own frequency."""
    for mode, omega in OMEGA.items():
        # Whole periods, after which the oscillation has the same phase.
        ends = np.round(np.array([100.0, 200.0]) * omega / 2 / np.pi)
        ends = ends * 2 * np.pi / omega
        for angle in (90, 30):
            azimuth = angle - np.degrees(PSI[mode])
            run = rs.simulate(
                GH,
                n_i=0,
                omega_xy0=1e-9,
                psi=0,
                t_end=ends,
                base=along(omega, 1e-5, azimuth),
                record="late",
            )
            at_launch = 0.5 * GH.alpha * 1e-18
            rates = np.sqrt(2 * run.base_work * at_launch / J[mode])
            seen = (rates[1] - rates[0]) / (ends[1] - ends[0]) / 1e-5
            formula = float(growth_of_push(J[mode], np.radians(angle), 1.0))
            print(f"{mode} {angle} deg: growth / eps {seen:.5f}, formula {formula:.5f}")


def tell_spins() -> None:
    """Print the spins to which drives near the frequency of the pitch lead."""
    drives = (
        *((each, 0.01, 0.0) for each in (1e-3, 5e-3, 0.02, 0.03, 0.05, 0.1)),
        *((0.02, 0.03, each) for each in (0.0, -0.04, 0.04, 0.08)),
    )
    acceleration, sigma, detuning = np.transpose(drives)
    frequency = OMEGA["pitch"] + detuning
    runs = rs.simulate(
        GH,
        t_end=12_000.0,
        sigma=sigma,
        base=along(frequency, acceleration),
        record="late",
        **TAP,
    )
    table = {
        "eps": acceleration,
        "sigma": sigma,
        "detuning": detuning,
        "closed form": predicted(frequency, acceleration, sigma),
        "limit": sigma / J["roll"] / K["roll"],
        "mean": runs.n_late_mean,
        "deviation": runs.n_late_std,
    }
    print(pd.DataFrame(table).to_string(index=False, float_format="%.5f"))


def main(directory: str, target: str) -> None:
    """Draw the figure and print the tables."""
    runs = rs.load(directory).runs
    figure = plt.figure(figsize=(9.0, 6.0), layout="constrained")
    above, below = figure.subfigures(2, 1, height_ratios=[1, 1.1])
    axis = above.subplots()
    draw_spins(axis, runs, 0.3, 5.8)
    axis.set_ylabel("spin, last quarter")
    axis.legend(frameon=False, fontsize=8, loc="lower right")
    axes = below.subplots(1, 3)
    draw_spins(axes[0], runs, 1.2, 1.65)
    draw_closed_form(axes[0], 1.2, 1.65)
    axes[0].set_ylim(-0.135, 0.01)
    axes[0].set_ylabel("spin, last quarter")
    draw_spins(axes[1], runs, 0.4, 0.8)
    draw_courses(axes[2])
    figure.savefig(target, dpi=150)
    tell(runs)
    tell_growth()
    tell_spins()


if __name__ == "__main__":
    main(*sys.argv[1:])
