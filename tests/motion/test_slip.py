"""Viscous slip: the foot slips against a force in proportion to its velocity."""

from dataclasses import replace

import numpy as np
import oracle
import pytest
import slip_oracle
from numpy.testing import assert_allclose
from sweeping import invoke

import rattlesweep as rs
from rattlesweep.physics.body import PARAMETERS
from rattlesweep.physics.theory import slip_thresholds

GH = rs.Rattleback.gh()
SKEWED = replace(GH, xi=np.radians(-5.0))
LAUNCH = {"n_i": 0.1, "omega_xy0": 0.01}
# From small friction, with which the foot slides far, to a foot that hardly slips.
FRICTION = np.array([1.0, 10.0, 50.0, 200.0, 1e3, 1e4, 1e5, 1e6])


@pytest.fixture(scope="module")
def slipping():
    """Return runs of a skewed GH, one for each of `FRICTION`."""
    return rs.simulate(SKEWED, **LAUNCH, viscous=FRICTION, t_end=60.0)


def of(runs, name):
    return runs[name].to_numpy()


def test_the_first_zero_is_that_of_the_nine_variables(slipping):
    """The number is of a program in vectors that steps as short as ``1/k`` asks."""
    assert_allclose(of(slipping, "t_r")[FRICTION == 50.0], 44.041004, atol=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize(("c", "k"), [(None, 7.0), (None, 300.0), (2.0, 50.0)])
def test_zeros_are_those_of_an_independent_program(c, k):
    body = {name: getattr(SKEWED, name) for name in PARAMETERS} | {"c": c}
    psi = oracle.relevant_psi(body, 0.1)
    found = slip_oracle.follow(body, k, slip_oracle.launch(body, 0.1, 0.05, psi), 40.0)
    run = rs.simulate(
        replace(SKEWED, c=c), n_i=0.1, omega_xy0=0.05, viscous=k, t_end=40.0
    )
    assert_allclose(run.t_r, found.t_events[0][0], rtol=1e-7)


@pytest.mark.slow
def test_a_body_that_rolls_over_slips_as_well():
    """Beyond slopes, steps continue in variables of any position."""
    body = {name: getattr(SKEWED, name) for name in PARAMETERS} | {"c": 2.0}
    omega = np.array([3.0, 1.0, 0.5])
    start = slip_oracle.launch(body, 0.0, 0.0, 0.0)
    start[3:6] = omega
    r = np.array([0.0, 0.0, 1.0])
    start[6:9] = np.cross(r, omega)
    found = slip_oracle.follow(body, 20.0, start, 3.0)
    assert found.y[2].max() > 0.5  # upside down
    run = rs.simulate(
        replace(SKEWED, c=2.0),
        omega=omega,
        u=(0.0, 0.0, -1.0),
        viscous=20.0,
        t_end=3.0,
    )
    end = found.y[:, -1]
    assert_allclose(run.n_end, end[:3] @ end[3:6], rtol=1e-6)


def test_steps_do_not_shorten_with_the_friction(slipping):
    assert set(slipping.status) == {"ok"}
    steps = of(slipping, "n_steps") / of(slipping, "t_end")
    assert steps[2:].max() < 1.5 * steps[-1]
    assert steps.max() < 2.5 * steps[-1]


def test_energy_less_work_is_conserved(slipping):
    assert np.abs(of(slipping, "energy_drift")).max() < 1e-9
    assert of(slipping, "slip_work").min() > 0
    left = of(slipping, "energy_left")
    assert_allclose(of(slipping, "slip_work"), 1 - left, atol=1e-9)


def test_a_mirrored_body_does_the_same(slipping):
    psi = rs.modes(SKEWED).psi_p
    same = rs.simulate(
        replace(SKEWED, xi=-SKEWED.xi),
        omega=(0.01 * np.cos(psi), -0.01 * np.sin(psi), 0.1),
        u=(0.0, 0.0, -1.0),
        viscous=FRICTION,
        t_end=60.0,
    )
    turned = ~np.isnan(of(slipping, "t_r"))
    assert turned.sum() >= 6
    assert_allclose(of(same, "t_r")[turned], of(slipping, "t_r")[turned], rtol=1e-8)
    assert_allclose(of(same, "n_p"), -of(slipping, "n_p"))


def test_slip_vanishes_at_order_one_as_the_friction_grows(slipping):
    rolling = rs.simulate(SKEWED, **LAUNCH, t_end=60.0)
    none = rs.simulate(SKEWED, **LAUNCH, viscous=0.0, t_end=60.0)
    assert none.t_r == rolling.t_r
    later = (of(slipping, "t_r") - rolling.t_r) * FRICTION
    _, _, _, _, at_1e3, at_1e4, at_1e5, _ = later
    assert at_1e4 > 0
    assert_allclose(at_1e3, at_1e4, rtol=1e-2)
    assert_allclose(at_1e5, at_1e4, rtol=1e-2)


@pytest.mark.parametrize(
    ("psi", "rate"), [("pitch", 8.58643e-4), ("roll", 1.177923e-3)]
)
def test_upright_modes_decay(psi, rate):
    """The rates are eigenvalues of the nine-variable system."""
    modes = rs.modes(GH)
    half = np.pi / (modes.omega_p if psi == "pitch" else modes.omega_r)
    runs = rs.simulate(
        GH,
        n_i=0.0,
        omega_xy0=1e-5,
        psi=psi,
        viscous=200.0,
        t_end=half * np.array([20, 220]),
    )
    early, late = np.log(of(runs, "energy_left"))
    assert_allclose((early - late) / (200 * half), rate, rtol=6e-6)


def test_spins_between_the_thresholds_last():
    """Pitch and roll grow beyond them, by the linear equations about a spin."""
    body = {name: getattr(SKEWED, name) for name in PARAMETERS}
    modes = rs.modes(SKEWED)
    n_p, n_r = slip_thresholds(GH.alpha, GH.beta, modes, 200.0)
    for n in (n_p, -n_r):
        assert slip_oracle.growth_rates(body, 200.0, 1.05 * n).max() > 0
        assert slip_oracle.growth_rates(body, 200.0, 0.95 * n).max() < 0
    unknown = slip_thresholds(GH.alpha, GH.beta, modes, 0.0)
    assert np.isnan(unknown).all()


@pytest.mark.parametrize(
    ("more", "message"),
    [
        ({"mu": 0.3}, r"viscous.*leave out viscous or mu"),
        ({"pivot": 0.002}, r"viscous.*leave out viscous or pivot"),
        ({"method": "rk4"}, r"method: rk4 cannot follow viscous slip"),
        ({"record": "error"}, "errors are not calibrated for paraboloid with viscous"),
        ({"record": "volume"}, "phase volume is not known with viscous; leave"),
        ({"record": "lyapunov"}, "needs paraboloids without dissipation"),
    ],
)
def test_what_is_not_defined_with_slip_is_refused(more, message):
    with pytest.raises(rs.ConfigError, match=message):
        rs.simulate(SKEWED, **LAUNCH, viscous=50.0, t_end=1.0, **more)


@pytest.mark.slow
def test_friction_of_a_stone_has_a_unit():
    stone = rs.Rattleback.half_ellipsoid(
        length="12 cm", width="3 cm", height="1.2 cm", mass="60 g", skew="8 deg"
    )
    launch = {"n_i": "60 rpm", "omega_xy0": "6 rpm", "t_end": "0.5 s"}
    run = rs.simulate(stone, viscous="2 N s/m", **launch)
    same = rs.simulate(stone, viscous="2 kg/s", **launch)
    units = stone.units
    natural = 2.0 / (units.mass / units.time)
    assert_allclose(run.viscous, natural)
    assert run.n_end == same.n_end
    with pytest.raises(rs.ConfigError, match="unit"):
        rs.simulate(stone, viscous=2.0, **launch)


def test_no_friction_is_asked_of_a_foot_that_slips():
    launch = ("--preset", "GH", "--n-i", "-0.5", "--omega-xy0", "0.1")
    assert "needs a coefficient of friction" in invoke("body", *launch).stderr
    slipping = invoke("body", *launch, "--viscous", "30")
    assert (slipping.exit_code, slipping.stderr) == (0, "")


@pytest.mark.slow
def test_the_path_of_a_foot_that_slips():
    body = {name: getattr(SKEWED, name) for name in PARAMETERS} | {"c": None}
    psi = oracle.relevant_psi(body, 0.1)
    times = np.linspace(0.0, 6.0, 601)
    found = slip_oracle.follow(body, 5.0, slip_oracle.launch(body, 0.1, 0.2, psi), 6.0)
    run = rs.trajectory(
        SKEWED,
        n_i=0.1,
        omega_xy0=0.2,
        viscous=5.0,
        t_end=6.0,
        dt=0.01,
        channels=["trace_x", "trace_y", "v_slip"],
    ).table
    slip = [
        np.linalg.norm(slip_oracle.contact_velocity(y, body))
        for y in found.sol(times).T
    ]
    assert_allclose(run["v_slip"], slip, atol=1e-7)
    # The place of contact moves on the plane as it does in the body, and slips.
    steps = np.hypot(np.diff(run["trace_x"]), np.diff(run["trace_y"])) / 0.01
    between = found.sol(times[:-1] + 0.005).T
    expected = [np.linalg.norm(slip_oracle.foot_velocity(y, body)) for y in between]
    assert_allclose(steps, expected, atol=2e-4 * max(expected))
