"""The extremes: agreement with an independent reference, or a status that says why not."""

import extremes
import numpy as np
import oracle
import pytest
import reference
from extremes import GH, Case, ask, errors, refer
from mpmath import mp

# --- the reference itself -------------------------------------------------------------------------


def test_the_reference_has_the_equations_of_the_oracle():
    rng = np.random.default_rng(8)
    for _ in range(20):
        y = np.concatenate([rng.uniform(-0.2, 0.2, 2), [-1.0], rng.normal(0, 1, 3)])
        y[:3] /= np.linalg.norm(y[:3])
        q = reference.constants([[GH[name] for name in reference.PARAMETERS]])
        found = reference.rhs(y.astype(np.longdouble)[:, None], q)[:, 0]
        assert found.astype(float) == pytest.approx(oracle.rhs(0.0, y, GH), abs=1e-12)


def test_forty_digits_confirm_the_reference_and_the_product():
    case = Case("omega_xy0 3", GH, -0.5, 3.0, 1.0)
    answer = ask([case], {"tol": 1e-12})
    found = refer([case], answer, 0.5)
    with mp.workdps(40):
        exact = refer([case], answer, 1.0, exact=True)
    assert found.y_end.astype(float) == pytest.approx(exact.y_end.astype(float), abs=1e-14)
    assert max(errors(case, answer[0], exact, 0)) < 1e-11


# --- agreement ------------------------------------------------------------------------------------


def check_reference(rows, scale=1.0):
    for case, answers, t_r, own, off in rows:
        assert own < 1e-9, case
        for answer, error, wanted in zip(answers, off, case.error, strict=True):
            assert answer.status == "ok", case
            assert max(error) < scale * wanted, (case, error)
            assert (answer.type == "R") == np.isfinite(t_r), case


def test_short_extremes_agree_with_the_reference():
    names = {"n_i 1e-6", "n_i -1e-6", "omega_xy0 3"}
    check_reference(extremes.against_reference([c for c in extremes.REFERENCE if c.name in names]))


def test_a_roll_that_decays_by_many_orders_is_ss():
    for case in (Case("", GH, -2.0, 0.01, 1e4), Case("", extremes.SD, -3.0, 1e-12, 2e4)):
        answer = ask([case])[0]
        assert (answer.status, answer.type) == ("ok", "SS")
    [(_, answers, exponent, off)] = extremes.against_growth([extremes.LINEAR[-1]])
    assert exponent < -100
    assert [a.type for a in answers] == ["SS", "SS"]
    assert max(off[0]) < 1e-5
    assert max(off[1]) < 1e-8


@pytest.mark.slow
def test_extremes_agree_with_the_reference():
    check_reference(extremes.against_reference(extremes.REFERENCE))


@pytest.mark.slow
def test_long_horizons_have_the_exact_growth():
    rows = extremes.against_growth(extremes.LINEAR)
    for case, answers, exponent, off in rows:
        for answer, tol, error in zip(answers, extremes.TOLS, off, strict=True):
            assert answer.status == "ok"
            assert answer.t_end == case.t_end
            # Far below the sum of what every step may err, plus what doubles lose.
            assert np.abs(error).max() < 0.1 * answer.n_steps * tol + 1e-9, (case, tol, error)
            assert (answer.type == "SS") == (exponent < 1e-3), case
            assert abs(answer.energy_drift) < 1e-10


# --- decay ----------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("case", extremes.DECAY, ids=lambda c: c.name)
@pytest.mark.parametrize("tol", extremes.TOLS)
def test_decaying_rolls_are_ss_down_to_the_noise(case, tol):
    [answer] = ask([case], {"tol": tol})
    assert (answer.status, answer.type) == ("ok", "SS")
    start = abs(answer.probe[2:] @ [np.cos(answer.psi), np.sin(answer.psi)]) * case.omega_xy0
    assert abs(answer.probe @ answer.y_end[:4]) < 1e-8 * start


@pytest.mark.parametrize("case", extremes.OVERDAMPED_ROLL, ids=lambda c: c.name)
def test_an_overdamped_roll_is_ss(case):
    assert all(oracle.linear_growth(case.body, case.n_i).real < 0)
    [answer] = ask([case])
    assert answer.type == "SS"


@pytest.mark.parametrize("case", extremes.SATURATED[:2], ids=lambda c: c.name)
def test_a_spin_that_wobbles_is_sw_at_any_horizon(case):
    [answer] = ask([case])
    assert answer.n_departure > 0.1
    assert answer.type == "SW"


# --- steps too long, and no end -------------------------------------------------------------------


COARSE = [
    pytest.param(case, kind, dt, id=f"{case.name}, dt {dt}")
    for case, kind, steps in extremes.COARSE
    for dt in steps
]


@pytest.mark.parametrize(("case", "kind", "dt"), COARSE)
def test_rk4_with_a_long_step_agrees_or_says_so(case, kind, dt):
    _, verdict = extremes.against_fine(case, kind, dt)
    assert verdict != "wrong"


# --- close pairs of zeros -------------------------------------------------------------------------


@pytest.mark.parametrize(("place", "touch", "tol"), [(0, 0, 1e-11), (0, 1, 1e-12), (3, 1, 1e-10)])
def test_all_near_touches_are_counted(place, touch, tol):
    _, body, omega, direction = extremes.GRAZING[place]
    n = extremes.touches(body, omega, direction)[touch]
    away = np.logspace(-14.5, np.log10(10 * tol), 400)
    cases = [Case("", body, n * (1 + s * a), omega, 20.0) for s in (1, -1) for a in away]
    assert all(answer.near_tangencies for answer in ask(cases, {"tol": tol}))
