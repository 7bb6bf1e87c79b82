"""Print the numbers about the resonance in docs/sampling.md: where SW occurs, and its
frequencies.

rattlesweep run configs/map_theta_spin.yaml
rattlesweep run configs/steady.yaml
python docs/figures/map_lock.py out/map-theta-spin out/steady
"""

import sys

import numba as nb
import numpy as np
from scipy.optimize import brentq

from rattlesweep.api import load
from rattlesweep.physics import full, steady, theory
from rattlesweep.physics.body import PARAMETERS, Rattleback

GH = {name: getattr(Rattleback.gh(), name) for name in PARAMETERS}
STEP = 0.01
EVERY = 5
rhs = full.rhs
spin = full.spin


@nb.njit
def path(state, body, t_end):
    """Return omega_x, omega_y and the spin by plain RK4, every `EVERY` steps."""
    seen = np.empty((int(t_end / STEP) // EVERY, 3))
    y = state.copy()
    for row in range(len(seen)):
        seen[row] = y[2], y[3], spin((y[0], y[1], y[2], y[3], y[4]))
        if seen[row, 2] * seen[0, 2] <= 0:
            return seen[:row]
        for _ in range(EVERY):
            ks = np.zeros((5, 5))
            for stage in range(4):
                at = y + (0.0, 0.5, 0.5, 1.0)[stage] * STEP * ks[stage]
                ks[stage + 1] = rhs(
                    (at[0], at[1], at[2], at[3], at[4]),
                    (body[0], body[1], body[2], body[3], body[4], body[5]),
                )
            y += STEP / 6 * (ks[1] + 2 * ks[2] + 2 * ks[3] + ks[4])
    return seen


def modes(body):
    """Frequencies and directions of a body without spin."""
    return theory.modes(
        *(body[name] for name in ("alpha", "beta", "theta", "phi", "xi"))
    )


def run(n_i, omega_xy0, t_end, **changes):
    """Path of a body like GH."""
    body = GH | changes
    state = theory.full_state(
        n_i, omega_xy0, theory.direction(modes(body), n_i, "relevant")
    )
    return path(state.ravel(), np.asarray(full.constants(**body), float).ravel(), t_end)


def lines(signal):
    """Frequencies of the three strongest lines of a spectrum, the strongest first."""
    window = np.hanning(len(signal)) * (signal - signal.mean())
    power = np.abs(np.fft.rfft(window, 8 * len(signal)))
    frequency = 2 * np.pi * np.fft.rfftfreq(8 * len(signal), STEP * EVERY)
    inner = power[1:-1]
    peaks = np.flatnonzero((inner > power[2:]) & (inner > power[:-2])) + 1
    found = []
    for peak in peaks[np.argsort(-power[peaks])]:
        if all(abs(frequency[peak] - other) > 0.05 for other in found):
            found.append(frequency[peak])
        if len(found) == 3:
            return found
    return found


def ratio(theta, n, **changes):
    """Linear pitch frequency over roll frequency at a steady spin."""
    found = steady.steady_modes(full.constants(**(GH | changes | {"theta": theta})), n)
    return float(found.pitch.imag / found.roll.imag)


def shares(part, name):
    """Return, as text, how many runs have each value of a column."""
    return ", ".join(
        f"{key} {count}" for key, count in part[name].value_counts().items()
    )


def island_of_gh(runs) -> None:
    """Print where SW occurs for the body of Garcia and Hubbard, and the frequencies of
    its runs.
    """
    rng = np.random.default_rng(1)
    for size, part in runs.groupby("omega_xy0"):
        down = part[part["n_i"] < 0]
        stable = down["n_c1"].abs() < down["n_i"].abs()
        print(f"omega_xy0 = {size:g}: {shares(part, 'type')}")
        print(
            f"  past Bondi's threshold {int(stable.sum())}: "
            f"{shares(down[stable], 'type')}; before it SS "
            f"{int((down[~stable]['type'] == 'SS').sum())}"
        )
        island = down[
            (down["type"] == "SW")
            & (down["theta"] > 0.85)
            & (down["n_i"] > -0.4)
            & (down["n_i"] < -0.05)
        ]
        print(
            f"  island: {len(island)} cells, theta from "
            f"{island['theta'].min():.4f}, n_i from {island['n_i'].max():.4f}"
        )
        grey = down[
            (down["type"] == "unclassified")
            & (down["theta"].between(0.872, 0.93))
            & (down["n_i"].between(-0.43, -0.33))
        ]
        if len(grey) > 24:
            caught = 0
            for _, row in grey.iloc[rng.choice(len(grey), 24, False)].iterrows():
                seen = run(
                    row["n_i"], size, min(row["t_end"], 30000.0), theta=row["theta"]
                )
                low, high = sorted(lines(seen[int(0.8 * len(seen)) :, 1])[:2])
                caught += abs(high / low - 3) < 3e-3
            print(
                f"  grey: {len(grey)} cells, {caught} of 24 drawn are locked, "
                f"loss of spin from {grey['n_departure'].min():.4f}"
            )
        locked = 0
        fall = []
        over = []
        for _, row in island.iloc[
            np.sort(rng.choice(len(island), 24, False))
        ].iterrows():
            seen = run(row["n_i"], size, min(row["t_end"], 30000.0), theta=row["theta"])
            late = seen[int(0.8 * len(seen)) :]
            low, high = sorted(lines(late[:, 1])[:2])
            if abs(high / low - 3) < 2e-3:
                locked += 1
                fall.append(row["n_i"] ** 2 - late[:, 2].mean() ** 2)
                over.append(high / row["omega_p"])
        print(
            f"  {locked} of 24 drawn from it have lines at 1 : 3; "
            f""
            f"the third harmonic is {np.min(over):.3f} to {np.max(over):.3f} omega_p, "
            f"n_i^2 - mean n^2 {np.min(fall):.4f} to {np.max(fall):.4f}"
        )
    print("theta = 0.9, n_i = -0.2, omega_xy0 = 0.01")
    for phi in (0.030, 0.033, 0.036, 0.039):
        late = run(-0.2, 0.01, 12000.0, theta=0.9, phi=phi)[-40000:]
        low, high = sorted(lines(late[:, 1])[:2])
        omega_p = float(modes(GH | {"theta": 0.9, "phi": phi}).omega_p)
        print(
            f"  phi {phi:g}: omega_p {omega_p:.4f}, lines {low:.4f} {high:.4f}, 1 : "
            f"{high / low:.4f}, high / omega_p {high / omega_p:.4f}"
        )
    edge = brentq(lambda theta: ratio(theta, -0.25, xi=-1e-6) - 3, 0.65, 0.9)
    print(f"  linear pitch = 3 linear roll at n = -0.25: theta {edge:.3f}")


def random_bodies(runs) -> None:
    """Print frequencies of random bodies of type SW that have clearly left their
    plateau.
    """
    rng = np.random.default_rng(5)
    for n_i in (-0.3, -0.4, -0.5):
        some = runs[
            (runs["type"] == "SW")
            & (runs["n_i"] == n_i)
            & (runs["omega_xy0"] == 0.01)
            & (runs["n_departure"] > 0.1)
        ]
        over = []
        linear = []
        for _, row in some.iloc[rng.choice(len(some), 50, False)].iterrows():
            body = {name: row[name] for name in PARAMETERS}
            state = theory.full_state(n_i, 0.01, row["psi"]).ravel()
            seen = path(
                state,
                np.asarray(full.constants(**body), float).ravel(),
                min(row["t_end"], 30000.0),
            )
            strong = lines(seen[int(0.8 * len(seen)) :, 1])
            over.append(max(strong[:2]) / row["omega_p"])
            linear.append(row["omega_p"] / row["omega_r"])
        near = np.abs(np.array(over) - 1.05) < 0.1
        print(
            f"random bodies, SW at n_i = {n_i:g}: of 50, {near.sum()} have "
            f"their second line at 0.95 to 1.15 omega_p; "
            f"omega_p/omega_r is {np.min(linear):.1f} to {np.max(linear):.1f}"
        )


def main(grid: str, steady_sweep: str) -> None:
    """Print the numbers."""
    island_of_gh(load(grid).runs)
    random_bodies(load(steady_sweep).runs)


if __name__ == "__main__":
    main(*sys.argv[1:])
