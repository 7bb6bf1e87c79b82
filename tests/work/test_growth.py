"""`amp_growth` is what docs/types.md says it is, from the states of a trajectory."""

from __future__ import annotations

import math

import numpy as np
import pytest

import rattlesweep as rs
from rattlesweep.kernel.runs import N_WINDOWS
from rattlesweep.physics import full
from rattlesweep.physics.steady import steady_modes

COMPONENTS = ("omega_x", "omega_y", "omega_z")
VERTICAL = ("u_x", "u_y", "u_z")


def slower_frequency(body: rs.Rattleback, n_i: float, sigma: float) -> float:
    """Return the frequency of the roll; that without spin if the roll is overdamped."""
    frequency = float(steady_modes(constants_of(body), n_i, sigma).roll.imag)
    return frequency if frequency > 0 else rs.modes(body).omega_r


def constants_of(body: rs.Rattleback) -> np.ndarray:
    parameters = (body.alpha, body.beta, body.gamma, body.theta, body.phi, body.xi)
    return np.array(full.constants(*parameters))


def relevant_amplitude(body: rs.Rattleback, n_i: float, sigma: float, table):
    """Return the amplitude of the relevant mode at the steps of a trajectory."""
    modes = steady_modes(constants_of(body), n_i, sigma)
    probe = modes.pitch_probe if n_i > 0 else modes.roll_probe
    vertical = table[list(VERTICAL)].to_numpy().T
    omega = table[list(COMPONENTS)].to_numpy().T
    p, q, omega_x, omega_y, _ = full.from_vectors(vertical, omega)
    return np.abs(probe @ np.stack([p, q, omega_x, omega_y]))


def comparisons(t_end: float, slower: float) -> list[float]:
    """Return the times at which amplitudes are compared."""
    period = 2 * math.pi / slower
    count = min(max(math.floor(t_end / (2 * period)), 1), N_WINDOWS)
    window = t_end / count
    marks = []
    mark = 8 * period
    while mark < window:
        marks.append(mark)
        mark *= 2
    return [*marks, *(window * np.arange(1, count + 1) * (1 - 1e-12))]


def growth(t: np.ndarray, amplitude: np.ndarray, times: list[float]) -> float:
    """Return the largest ratio of the maximum of an interval to an earlier maximum."""
    borders = np.searchsorted(t, times)
    maxima = []
    first = 1  # the launch itself is in no interval
    for border in borders:
        # The state at a border belongs to both intervals.
        maxima.append(amplitude[first : border + 1].max())
        first = min(border, len(amplitude) - 1)
    maxima = np.maximum(maxima, 1e-9 * maxima[0])
    smallest_before = np.minimum.accumulate(maxima)[:-1]
    return float((maxima[1:] / smallest_before).max()) - 1


@pytest.mark.parametrize(
    ("theta", "n_i", "omega_xy0", "t_end", "sigma", "type_"),
    [
        (0.95, -0.5, 0.1, 500.0, 0.0, "SS"),
        (0.8, -0.4, 0.01, 700.0, 0.0, "unclassified"),
        # The first window is long enough for comparisons at doubling times.
        (0.95, -0.2, 0.1, 16000.0, 0.0, "SW"),
        # The roll is overdamped.
        (0.95, -0.3, 0.05, 200.0, 2.0, "D"),
    ],
)
def test_amp_growth_is_the_largest_ratio_to_an_earlier_maximum(
    theta, n_i, omega_xy0, t_end, sigma, type_
):
    gh = rs.Rattleback.gh()
    body = rs.Rattleback(gh.alpha, gh.beta, gh.gamma, theta, gh.phi, gh.xi)
    launch = {"n_i": n_i, "omega_xy0": omega_xy0, "t_end": t_end, "sigma": sigma}
    run = rs.simulate(body, **launch)
    channels = ["t", *VERTICAL, *COMPONENTS]
    path = rs.trajectory(body, **launch, steps=True, channels=channels).table
    slower = slower_frequency(body, n_i, sigma)
    times = comparisons(t_end, slower)
    amplitude = relevant_amplitude(body, n_i, sigma, path)
    expected = growth(path["t"].to_numpy(), amplitude, times)
    assert run.type == type_
    assert run.amp_growth == pytest.approx(expected, rel=1e-9, abs=1e-12)
