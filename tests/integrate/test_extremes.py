"""The extremes: agreement with an independent reference, or a status that says why not."""

import extremes
import numpy as np
import oracle
import pytest
import reference
from extremes import GH, Case, ask, errors, refer
from mpmath import mp


def cases(every, quick):
    """Parametrise ``case``; slow but for the one named ``quick``."""
    marks = [[] if case.name == quick else [pytest.mark.slow] for case in every]
    every = [pytest.param(c, marks=m, id=c.name) for c, m in zip(every, marks, strict=True)]
    return pytest.mark.parametrize("case", every)


# --- the reference itself -------------------------------------------------------------------------


def test_the_reference_has_the_equations_of_the_oracle():
    rng = np.random.default_rng(8)
    for _ in range(20):
        y = np.concatenate([rng.uniform(-0.2, 0.2, 2), [-1.0], rng.normal(0, 1, 3)])
        y[:3] /= np.linalg.norm(y[:3])
        q = reference.constants([[GH[name] for name in reference.PARAMETERS]])
        found = reference.rhs(y.astype(np.longdouble)[:, None], q)[:, 0]
        assert found.astype(float) == pytest.approx(oracle.rhs(0.0, y, GH), abs=1e-12)


def test_the_reference_converges_with_its_order():
    case = Case("", GH, 0.1, 0.01, 10.0)
    answer = ask([case])
    ends = [refer([case], answer, share).y_end.astype(float) for share in (8.0, 4.0, 0.5)]
    off = [np.abs(y - ends[2]).max() for y in ends[:2]]
    assert 2**12 < off[0] / off[1] < 2**20


EXACT = (
    Case("GH", GH, 0.01, 0.3, 3.0),
    Case("phi 1e-4", extremes.LONG_ROLL, 0.01, 0.01, 0.25),
    Case("theta 1 - 1e-9", extremes.FLAT, 0.003, 0.1, 3.0),
    Case("n_i 50", GH, 50.0, 0.001, 0.3),
    Case("omega_xy0 3", GH, -0.5, 3.0, 1.0),
)


@cases(EXACT, quick="omega_xy0 3")
def test_forty_digits_confirm_the_reference_and_the_product(case):
    answer = ask([case], {"tol": 1e-12})
    found = refer([case], answer, 0.5)
    with mp.workdps(40):
        exact = refer([case], answer, 0.5 if case.t_end < 1 else 1.0, exact=True)
    assert found.y_end.astype(float) == pytest.approx(exact.y_end.astype(float), abs=1e-14)
    off = abs(float(found.t_r[0]) / float(exact.t_r[0]) - 1)
    assert off < 1e-15 or np.isnan(off)
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
def test_tolerances_below_double_precision_agree_or_say_so():
    cases = extremes.TOLERANCE_CASES
    rows = extremes.against_reference(cases)
    fine = refer(cases, [answers[0] for _, answers, *_ in rows], 0.5)
    for case, tol in extremes.TOLERANCES:
        [answer] = ask([case], {"tol": tol}, max_steps=10_000_000)
        assert answer.status in ("ok", "step_too_small", "step_limit")
        if answer.status == "ok":
            assert max(errors(case, answer, fine, cases.index(case))) < 1e-9, (case, tol)


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


@cases(extremes.SATURATED, quick=extremes.SATURATED[1].name)
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


def check_pairs(cases):
    answers = [ask(cases, {"tol": tol}) for tol in extremes.TOLS]
    fine = refer(cases, answers[0], 0.5)
    missed = np.zeros(2, dtype=int)
    for k, case in enumerate(cases):
        for i, (found, tol) in enumerate(zip(answers, extremes.TOLS, strict=True)):
            answer = found[k]
            assert answer.status == "ok"
            assert np.isfinite(answer.t_r)
            wrong = errors(case, answer, fine, k)[0]
            if wrong > 1e-3:
                # Another zero: only where the method cannot tell, and then it is counted.
                missed[i] += 1
                away = abs(float(case.name.rsplit(",", 1)[1]))
                assert answer.near_tangencies > 0, case
                assert away < tol, (case, tol)
                continue
            # Near a touch the spin passes zero with a rate like the square root of the distance.
            away = abs(float(case.name.rsplit(",", 1)[1]))
            assert wrong < min(10 * tol / np.sqrt(away), 0.3 * np.sqrt(tol)), (case, tol, wrong)
    assert missed[1] <= missed[0]


@pytest.mark.slow  # quick, around another touch: test_lanes
def test_close_pairs_of_zeros():
    check_pairs(extremes.pairs())


@pytest.mark.parametrize(("place", "touch", "tol"), [(0, 0, 1e-11), (0, 1, 1e-12), (3, 1, 1e-10)])
def test_all_near_touches_are_counted(place, touch, tol):
    _, body, omega, direction = extremes.GRAZING[place]
    n = extremes.touches(body, omega, direction)[touch]
    away = np.logspace(-14.5, np.log10(10 * tol), 400)
    cases = [Case("", body, n * (1 + s * a), omega, 20.0) for s in (1, -1) for a in away]
    assert all(answer.near_tangencies for answer in ask(cases, {"tol": tol}))
