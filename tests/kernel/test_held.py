"""Spins that the plane holds: how rests begin and end, in steps of any length."""

import math

import contact_mechanics
import friction_oracle
import pytest

import rattlesweep as rs

DOWN = 0.0, 0.0, -1.0
GH = rs.Rattleback.gh()
STONE = rs.Rattleback(
    alpha=7.502909658448571,
    beta=1.920865893137635,
    gamma=7.423775551586206,
    theta=0.7109635488449236,
    phi=0.0809643199144343,
    xi=-0.026299155367744326,
)
# A rest of this body ends between two steps at 1e-6, and would be missed at their ends.
LETTING_GO = rs.Rattleback(
    alpha=8.119972536053487,
    beta=1.5811627381630893,
    gamma=7.7011352742165755,
    theta=0.87204999358994,
    phi=0.07683334643218086,
    xi=-0.03791414693481098,
)


def test_the_end_of_a_rest_between_two_steps_is_found():
    psi = 1.5308550677218775
    omega = 0.1 * math.cos(psi), 0.1 * math.sin(psi), 0.1
    wanted = friction_oracle.run(LETTING_GO, DOWN, omega, 186.0, 0.004, rtol=1e-10)
    for tol, near in ((1e-5, 1e-3), (1e-6, 1e-4), (1e-7, 1e-5), (1e-9, 1e-6)):
        run = rs.simulate(
            LETTING_GO, omega=omega, u=DOWN, pivot=0.004, t_end=250.0, tol=tol
        )
        assert run.t_r == pytest.approx(wanted.t_r, abs=near)


def tap(body, omega, lever, t_end, **options):
    return rs.simulate(body, omega=omega, u=DOWN, pivot=lever, t_end=t_end, **options)


def critical_lever(body, omega):
    """Return the least lever that holds the spin of a tap from the launch on."""
    stone = contact_mechanics.stone_of(body, pivot=1.0)
    forces = contact_mechanics.holding_torque(stone, DOWN, omega)
    return abs(forces.torque) / forces.normal


@pytest.mark.parametrize("share", [0.97, 0.99, 0.999])
@pytest.mark.parametrize("direction", [0.4, 2.1])
@pytest.mark.parametrize("body", [GH, STONE])
def test_a_tap_that_is_back_at_zero_in_its_first_step_is_held(body, direction, share):
    omega = 0.1 * math.cos(direction), 0.1 * math.sin(direction), 0.0
    lever = share * critical_lever(body, omega)
    run = tap(body, omega, lever, 2.0)
    wanted = friction_oracle.run(body, DOWN, omega, run.t_end, lever, rtol=1e-10)
    assert run.status == "ok"
    assert wanted.holds
    assert run.t_held == pytest.approx(wanted.holds[0][0], abs=1e-7)
    held = math.fsum(
        (run.t_end if math.isnan(end) else end) - begin for begin, end in wanted.holds
    )
    assert run.held_time == pytest.approx(held, abs=1e-7)


@pytest.mark.parametrize("less", [1e-9, 1e-12, 1e-15])
@pytest.mark.parametrize("body", [GH, STONE])
def test_a_tap_that_hardly_leaves_zero_is_held_as_one_that_does_not(body, less):
    """The way out and back is below the rounding errors of the spin."""
    omega = 0.1 * math.cos(2.1), 0.1 * math.sin(2.1), 0.0
    lever = critical_lever(body, omega)
    run = tap(body, omega, (1.0 - less) * lever, 2.0)
    wanted = tap(body, omega, (1.0 + less) * lever, 2.0)
    assert run.status == "ok"
    assert wanted.t_held == 0.0
    assert run.t_held == pytest.approx(0.0, abs=1e-4)
    assert run.held_time == pytest.approx(wanted.held_time, abs=1e-4)


@pytest.mark.parametrize("t_end", [0.13, 0.2, 2.0])
@pytest.mark.parametrize("tol", [1e-6, 1e-9, 1e-12])
def test_a_horizon_within_the_first_step_of_a_tap_hides_no_rest(t_end, tol):
    omega = 0.10038945120860497, -0.011559754857384056, 0.0
    run = tap(STONE, omega, 0.005639605275417535, t_end, tol=tol)
    assert run.status == "ok"
    assert run.t_held == pytest.approx(0.1239122897, abs=1e-8)
