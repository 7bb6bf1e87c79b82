"""Draw the Casimir invariant of the full dynamics, along runs and over theta.

python docs/figures/casimir.py docs/casimir.png     # a minute; also prints the table
"""

import sys

import matplotlib as mpl
import matplotlib.pyplot as plt
import numpy as np
import pandas as pd

import rattlesweep as rs

PAPER = {0.6429: "#0072b2", 0.82: "#d55e00", 0.9: "#009e73"}  # bodies of Fig. 9
T_END = 10_000.0
LAUNCH = {"n_i": 0.1, "omega_xy0": 0.01}
GH = rs.Rattleback.gh()


def course_of(theta: float) -> tuple[np.ndarray, np.ndarray]:
    """Return times and the invariant of energies averaged over periods of the roll."""
    body = GH.replace(theta=theta)
    modes = rs.modes(body)
    channels = ["t", "E_p", "E_r"]
    table = rs.trajectory(body, **LAUNCH, t_end=T_END, channels=channels).table
    period = 2 * np.pi / modes.omega_r
    means = table.groupby((table.t // period).astype(int)).mean()
    value = np.log(means.E_p) / modes.K_p + np.log(means.E_r) / modes.K_r
    return means.t.to_numpy(), value.to_numpy()


def over_theta(thetas: np.ndarray) -> pd.DataFrame:
    """Return runs of bodies that differ from GH in theta."""
    names = ("alpha", "beta", "gamma", "phi", "xi")
    rows = pd.DataFrame(
        {name: np.full(len(thetas), getattr(GH, name)) for name in names}
    )
    rows["theta"] = thetas
    record = ["casimir", "reversals"]
    return rs.simulate(rows, **LAUNCH, t_end=T_END, record=record)


def main(target: str) -> None:
    """Draw the figure, and print the numbers of the paper's bodies."""
    mpl.use("Agg")
    plt.rcParams.update({"font.size": 9, "axes.linewidth": 0.6})
    figure, (left, right) = plt.subplots(1, 2, figsize=(9, 3.6), layout="constrained")
    for theta, colour in PAPER.items():
        t, value = course_of(theta)
        left.plot(t, value, color=colour, lw=0.8, label=f"$\\theta$ = {theta:g}")
    left.set(xlabel="$t$", ylabel="$C_I$", xlim=(0, T_END))
    left.legend(frameon=False)
    runs = over_theta(np.linspace(0.4, 0.97, 115))
    right.fill_between(
        runs.theta, runs.casimir_min, runs.casimir_max, color="0.85", lw=0
    )
    for theta, colour in PAPER.items():
        right.axvline(theta, color=colour, lw=1)
    right.set(xlabel="$\\theta$", ylabel="$C_I$, least to largest", xlim=(0.4, 0.97))
    right.set_yscale("symlog", linthresh=10)
    right.set_ylim(-3000, -10)
    figure.savefig(target, dpi=150)
    paper = over_theta(np.array(list(PAPER)))
    for _, run in paper.iterrows():
        jumps = " ".join(f"{jump:.1f}" for jump in run.casimir_jumps)
        print(f"{run.theta} {run.casimir_min:.1f} {run.casimir_max:.1f} {jumps}")


if __name__ == "__main__":
    main(sys.argv[1])
