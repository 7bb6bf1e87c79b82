"""Extreme parameters: agreement with an independent integrator, or a status that says
why not.

benchmarks/extremes.md has many more, at 1e-12.
"""

import math

import oracle
import pytest
from oracle import GH

import rattlesweep as rs

FLAT = {"theta": 1 - 1e-9}
LONG_ROLL = {"phi": 1e-3}
OVERDAMPED = {"xi": -math.pi / 4}
SD = {"alpha": 10.0, "beta": 2.0, "gamma": 10.0, "theta": 0.8, "phi": 0.05, "xi": -0.05}


def ask(change, n_i, omega_xy0, t_end, **integrator):
    """Return the outcome of a run of GH with some parameters changed."""
    body = rs.Rattleback(**(GH | change))
    return rs.simulate(
        body, n_i=n_i, omega_xy0=omega_xy0, t_end=t_end, threads=1, **integrator
    )


# Change of GH, spin, oscillation and horizon; benchmarks/extremes.py prints the errors.
SHORT: list[tuple[dict[str, float], float, float, float]] = [
    ({}, 0.5, 3.0, 10.0),
    ({}, 1e-6, 0.01, 10.0),
    ({}, 5.0, 0.01, 6.0),
    (SD, -0.1, 0.5, 60.0),
    (FLAT, 0.1, 0.01, 150.0),
    (LONG_ROLL, 0.1, 0.01, 12.0),
    (OVERDAMPED, -0.1, 0.3, 60.0),
    ({"beta": 13.04 - 1e-9}, 0.1, 0.1, 60.0),
    ({"xi": -1e-5}, 0.1, 0.1, 60.0),
]


def quick_first(cases, quick):
    """Mark all but some cases as slow: the oracle takes seconds for each."""
    return [
        case if k < quick else pytest.param(*case, marks=pytest.mark.slow)
        for k, case in enumerate(cases)
    ]


@pytest.mark.parametrize(("change", "n_i", "omega_xy0", "t_end"), quick_first(SHORT, 4))
def test_extremes_agree_with_the_oracle(change, n_i, omega_xy0, t_end):
    found = ask(change, n_i, omega_xy0, t_end)
    y0 = oracle.launch(GH | change, n_i, omega_xy0, found.psi)
    t_r, y = oracle.first_zero(GH | change, y0, t_end, samples=16)
    assert found.status == "ok"
    assert (found.type == "R") == (t_r is not None)
    if t_r is not None:
        assert found.t_r == pytest.approx(t_r, rel=1e-6)
    else:
        assert found.n_end == pytest.approx(oracle.spin(y), rel=1e-6)


@pytest.mark.parametrize(
    ("change", "n_i", "omega_xy0", "t_end", "kind"),
    [
        ({}, -2.0, 0.01, 1e4, "SS"),
        ({}, -3.0, 1e-12, 1e4, "SS"),
        (SD, -3.0, 1e-12, 2e4, "SS"),
        ({"xi": 0.03}, 2.0, 0.01, 1e4, "SS"),
        (FLAT, -1.0, 0.01, 1e4, "SS"),
        (OVERDAMPED, -1.7, 1e-12, 2e3, "SS"),
        (OVERDAMPED, -10.0, 1e-6, 2e3, "SS"),
        ({}, -1.0, 0.01, 1e3, "SW"),
        ({}, -1.0, 0.01, 1e4, "SW"),
    ],
)
def test_types_of_long_runs(change, n_i, omega_xy0, t_end, kind):
    """Rolls that decay by many orders of magnitude or are overdamped; a spin that
    wobbles.
    """
    found = ask(change, n_i, omega_xy0, t_end)
    assert (found.status, found.type) == ("ok", kind)


# Launches of GH: spin, oscillation, horizon and type.
LAUNCHES = {
    "unsteady": (0.1, 0.01, 130.0, "R"),
    "steady": (-0.1, 0.01, 1e3, "R"),
    "stable": (-2.0, 0.01, 1e3, "SS"),
}
# The status of each launch at a step of RK4: only short ones are good enough.
STATUS = {
    0.1: ("ok", "ok", "ok"),
    0.5: ("energy", "ok", "coarse_step"),
    1.0: ("energy", "energy", "coarse_step"),
    1.9: ("energy", "coarse_step", "nonfinite"),
    2.5: ("nonfinite", "nonfinite", "nonfinite"),
    20.0: ("nonfinite", "nonfinite", "nonfinite"),
}


@pytest.mark.parametrize("dt", STATUS)
def test_rk4_with_a_long_step_says_what_went_wrong(dt):
    for launch, status in zip(LAUNCHES.values(), STATUS[dt], strict=True):
        n_i, omega_xy0, t_end, kind = launch
        run = ask({}, n_i, omega_xy0, t_end, method="rk4", dt_step=dt)
        assert run.status == status, launch
        assert run.type == (kind if status == "ok" else None), launch


@pytest.mark.parametrize(
    ("dt", "name"), [(0.1, "unsteady"), (0.1, "steady"), (0.5, "steady")]
)
def test_rk4_with_a_step_that_is_good_enough_agrees(dt, name):
    n_i, omega_xy0, t_end, _ = LAUNCHES[name]
    run = ask({}, n_i, omega_xy0, t_end, method="rk4", dt_step=dt)
    adaptive = ask({}, n_i, omega_xy0, t_end)
    assert run.t_r == pytest.approx(adaptive.t_r, rel=0.01)
