"""Draw the figure of docs/shaken.md and print its tables.

rattlesweep run configs/shaken.yaml
python docs/figures/shaken.py out/shaken docs/shaken.png
"""

import sys

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
from matplotlib.axes import Axes

import rattlesweep as rs
from rattlesweep.physics.driven import driven_spin, growth_of_drive
from rattlesweep.physics.theory import inertia_along

GH = rs.Rattleback.gh()
MODES = rs.modes(GH)
OMEGA = {"pitch": float(MODES.omega_p), "roll": float(MODES.omega_r)}
K = {"pitch": float(MODES.K_p), "roll": -float(MODES.K_r)}
PSI = {"pitch": float(MODES.psi_p), "roll": float(MODES.psi_r)}
J = {mode: float(inertia_along(GH.alpha, GH.beta, psi)) for mode, psi in PSI.items()}
SIGMA = 0.01
COLOURS = {0.01: "#9bb7d4", 0.02: "#5b8db8", 0.05: "#1f5f8b", 0.1: "#c0392b"}
TAP = {"n_i": 0, "omega_xy0": 1e-5, "sigma": SIGMA}


def predicted(mode: str, frequency: np.ndarray, acceleration: float) -> np.ndarray:
    """Return the spin at which the losses and the spin balance the drive."""
    growth = growth_of_drive(OMEGA[mode], frequency, acceleration)
    return driven_spin(growth, SIGMA / 2 / J[mode], K[mode])


def write_above(axis: Axes, x: float, text: str) -> None:
    """Write a name above a panel, clear of its frame."""
    axis.annotate(
        text,
        (x, 1.0),
        xycoords=("data", "axes fraction"),
        xytext=(0, 3),
        textcoords="offset points",
        ha="center",
        va="bottom",
        fontsize=8,
        color="0.35",
    )


def draw_all(axis: Axes, runs: pd.DataFrame) -> None:
    """Draw the mean spin over the drive, with what the spin varies by."""
    for acceleration, some in runs.groupby("base_acceleration"):
        colour = COLOURS[acceleration]
        x = some["base_frequency"]
        mean, spread = some["n_late_mean"], some["n_late_std"]
        axis.fill_between(
            x, mean - spread, mean + spread, color=colour, alpha=0.25, lw=0
        )
        axis.plot(
            x, mean, color=colour, lw=1, label=f"$\\varepsilon$ = {acceleration:g}"
        )
    for mode, omega in OMEGA.items():
        for times in (1, 2, 3, 4):
            if times * omega > x.max():
                continue
            strong = times == 2
            axis.axvline(
                times * omega, color="0.6", lw=0.8, ls="-" if strong else ":", zorder=0
            )
            name = f"$\\omega_{mode[0]}$"
            write_above(axis, times * omega, f"{times if times > 1 else ''}{name}")
    axis.set(xlabel=r"drive $\Omega$, $\sqrt{g/a}$", ylabel="spin, last quarter")
    # Room for the last of the names above.
    axis.set_xlim(x.min(), x.max() + 0.1)
    # Between the names of two drives.
    axis.legend(frameon=False, fontsize=8, loc="lower center", bbox_to_anchor=(0.86, 0))


def draw_peak(axis: Axes, mode: str, accelerations: tuple[float, ...]) -> None:
    """Draw the peak of a mode, with the closed form."""
    omega = OMEGA[mode]
    for acceleration in accelerations:
        half = 1.25 * acceleration * omega / 2
        frequency = 2 * omega + np.linspace(-half, half, 81)
        runs = rs.simulate(
            GH, t_end=6000.0, base=(frequency, acceleration), record="late", **TAP
        )
        colour = COLOURS[acceleration]
        axis.errorbar(
            frequency,
            runs.n_late_mean,
            runs.n_late_std,
            fmt=".",
            ms=3,
            lw=0.6,
            color=colour,
        )
        fine = np.linspace(frequency[0], frequency[-1], 2001)
        spin = predicted(mode, fine, acceleration)
        axis.plot(fine, np.nan_to_num(spin), color=colour, lw=0.9, ls="--")
    axis.axvline(2 * omega, color="0.6", lw=0.8, zorder=0)
    axis.set_title(f"near $2\\omega_{mode[0]}$", fontsize=9)
    axis.set(xlabel=r"drive $\Omega$, $\sqrt{g/a}$")


def draw_course(axis: Axes) -> None:
    """Draw the spin over the time, with and without a loss."""
    for sigma, label in ((0.0, "no loss"), (SIGMA, f"$\\sigma$ = {SIGMA:g}")):
        path = rs.trajectory(
            GH,
            t_end=5000.0,
            base=(2 * OMEGA["pitch"], 0.02),
            points=4001,
            channels=["t", "n"],
            **TAP | {"sigma": sigma},
        )
        axis.plot(path["t"], path["n"], lw=0.9, label=label)
    settled = float(predicted("pitch", np.array(2 * OMEGA["pitch"]), 0.02))
    axis.axhline(settled, color="0.6", lw=0.8, ls="--", zorder=0)
    axis.set_title("spin, drive at $2\\omega_p$, $\\varepsilon$ = 0.02", fontsize=9)
    axis.set(xlabel=r"time, $\sqrt{a/g}$")
    axis.legend(frameon=False, fontsize=8)


def tell(runs: pd.DataFrame) -> None:
    """Print what the tables of the page say."""
    print(runs["status"].value_counts().to_string())
    print("largest energy drift", runs["energy_drift"].abs().max())
    for acceleration, some in runs.groupby("base_acceleration"):
        far = np.ones(len(some), bool)
        for omega in OMEGA.values():
            tongue = acceleration * omega
            far &= np.abs(some["base_frequency"] - 2 * omega) > tongue
        beyond = some[far]
        spins = beyond["n_late_mean"].abs()
        most = beyond.loc[spins.idxmax()]
        print(
            f"eps {acceleration:g}: outside both peaks |n| <= {spins.max():.2g} "
            f"at {most['base_frequency']:.4g}, deviation {most['n_late_std']:.2g}; "
            f"{(spins > 1e-4).sum()} drives above 1e-4"
        )
    tell_settled()
    tell_growth()
    tell_stone()


def tell_settled() -> None:
    """Print the spins to which drives tuned to a mode lead, after a long time."""
    both = {"n_i": 0, "omega_xy0": 1e-3, "psi": 45, "record": "late"}
    along_pitch = {"n_i": 0, "omega_xy0": 1e-4, "record": "late"}
    for mode, launch, t_end, drives in (
        ("pitch", along_pitch, 20_000.0, ((0.02, 0.01), (0.02, 0.03))),
        (
            "pitch",
            both,
            40_000.0,
            ((0.05, 0.01), (0.1, 0.02), (0.06, 0.01), (0.1, 0.01), (0.2, 0.03)),
        ),
        (
            "roll",
            both,
            20_000.0,
            ((0.03, 0.01), (0.05, 0.01), (0.1, 0.01), (0.1, 0.02)),
        ),
    ):
        acceleration, sigma = np.transpose(drives)
        omega = OMEGA[mode]
        runs = rs.simulate(
            GH,
            t_end=t_end,
            sigma=sigma,
            base={"frequency": 2 * omega, "acceleration": acceleration},
            **launch,
        )
        other = "roll" if mode == "pitch" else "pitch"
        growth = growth_of_drive(omega, 2 * omega, acceleration)
        table = {
            "eps": acceleration,
            "sigma": sigma,
            "n*": driven_spin(growth, sigma / 2 / J[mode], K[mode]),
            "limit": sigma / J[other] / abs(K[other]),
            "mean": runs.n_late_mean,
            "deviation": runs.n_late_std,
        }
        print(mode, t_end)
        print(pd.DataFrame(table).to_string(index=False, float_format="%.5f"))


def tell_growth() -> None:
    """Print the growth from rest without skew, and the swing without losses."""
    body = rs.Rattleback(GH.alpha, GH.beta, GH.gamma, GH.theta, GH.phi, -1e-9)
    omega = float(rs.modes(body).omega_p)
    # Whole periods, after which the growing oscillation has the same phase.
    ends = np.round(np.array([300.0, 450.0]) * omega / np.pi) * np.pi / omega
    for acceleration in (0.02, 0.05):
        drive = (2 * omega, acceleration)
        runs = rs.simulate(body, n_i=0, omega_xy0=1e-7, t_end=ends, base=drive)
        first, last = 1 + runs.base_work
        rate = np.log(last / first) / 2 / (ends[1] - ends[0])
        print(f"growth {rate:.6f}, closed form {acceleration * omega / 4:.6f}")
    runs = rs.simulate(
        GH,
        n_i=0,
        omega_xy0=1e-3,
        t_end=np.linspace(2000.0, 5000.0, 151),
        base=(2 * OMEGA["pitch"], 0.01),
        record="late",
    )
    swing = 0.01 * OMEGA["pitch"] / K["pitch"]
    print(f"swing to {runs.n_end.min():.5f}, closed form {-swing:.5f}")


def tell_stone() -> None:
    """Print the spins of a stone on a loudspeaker."""
    stone = rs.Rattleback.half_ellipsoid(
        length="12 cm", width="3 cm", height="12 mm", mass="60 g", skew="3 deg"
    )
    hertz = float(rs.modes(stone).omega_p) / stone.units.time / np.pi
    rpm = 30 / np.pi / stone.units.time
    tuned = [(hertz, each) for each in (0.005, 0.01, 0.02, 0.05, 0.1, 0.2)]
    drives = [*tuned, *((each, 0.05) for each in (19.0, 19.3, 19.6, 20.0))]
    for frequency, millimetres in drives:
        run = rs.simulate(
            stone,
            n_i=0,
            omega_xy0="0.01 rpm",
            t_end="300 s",
            sigma="3e-6 N m s",
            base={"frequency": f"{frequency} Hz", "amplitude": f"{millimetres} mm"},
            record="late",
        )
        print(
            f"{frequency:.2f} Hz, {millimetres} mm, {run.base_acceleration:.3f} g: "
            f"{rpm * run.n_late_mean:.2f} rpm, deviation {rpm * run.n_late_std:.3f}"
        )


def main(directory: str, target: str) -> None:
    """Draw the figure and print the tables."""
    runs = rs.load(directory).runs
    figure = plt.figure(figsize=(9.0, 6.0), layout="constrained")
    above, below = figure.subfigures(2, 1, height_ratios=[1.1, 1])
    draw_all(above.subplots(), runs)
    axes = below.subplots(1, 3)
    draw_peak(axes[0], "pitch", (0.01, 0.02, 0.05))
    draw_peak(axes[1], "roll", (0.05, 0.1))
    draw_course(axes[2])
    axes[0].set_ylabel("spin, last quarter")
    figure.savefig(target, dpi=150)
    tell(runs)


if __name__ == "__main__":
    main(*sys.argv[1:])
