"""Marks: times at which a function of the spin first falls to zero."""

import kernels
import numpy as np
import oracle
import pytest
from scipy.integrate import solve_ivp

from rattlesweep.kernel.batch import integrate
from rattlesweep.kernel.look.extremes import PLACES_OF_EXTREMES
from rattlesweep.kernel.look.marks import MARKS
from rattlesweep.kernel.method.tableau import METHODS
from rattlesweep.motion.model import FULL
from rattlesweep.rows.columns import COLUMNS
from rattlesweep.words.names import RECORDABLE
from rattlesweep.words.watched import EXTREME_QUANTITIES, MARK_QUANTITIES

GH = oracle.GH
DOP853 = METHODS["dop853"]
T_HALF = frozenset(["t_half"])


@pytest.mark.parametrize(
    ("n_i", "push"),
    [
        (0.1, 0.01),
        pytest.param(-0.2, 0.1, marks=pytest.mark.slow),
        pytest.param(0.3, 0.1, marks=pytest.mark.slow),
        pytest.param(-0.3, 0.1, marks=pytest.mark.slow),
        pytest.param(0.2, 0.15, marks=pytest.mark.slow),
    ],
)
def test_the_time_of_half_the_spin_is_that_of_scipy(n_i, push):
    runs = kernels.full_batch(GH, n_i, push, t_end=300.0)
    (got,) = integrate(runs, DOP853, FULL, tol=1e-11, record=T_HALF).mark("t_half")
    y0 = oracle.launch(GH, n_i, push, oracle.relevant_psi(GH, n_i))
    solved = solve_ivp(
        oracle.rhs,
        (0, 300.0),
        y0,
        "DOP853",
        args=(GH,),
        events=lambda t, y, body: abs(oracle.spin(y)) - 0.5 * abs(n_i),
        rtol=1e-11,
        atol=1e-14,
        max_step=0.1,
    )
    assert got == pytest.approx(solved.t_events[0][0], rel=1e-8)


def test_a_mark_is_null_without_spin_and_where_it_is_not_reached():
    horizons = [30.0, 30.0, 300.0]
    runs = kernels.full_batch(GH, [0.0, 0.1, 0.1], [0.1, 1e-4, 0.01], t_end=horizons)
    out = integrate(runs, DOP853, FULL, record=T_HALF)
    assert np.isnan(out.mark("t_half")).tolist() == [True, True, False]


def test_what_is_watched_has_a_word_and_a_column_with_its_unit_and_meaning():
    """Each is computed in one file of the kernel, and explained in one of words."""
    assert {mark.name for mark in MARKS} == {each.name for each in MARK_QUANTITIES}
    assert PLACES_OF_EXTREMES.keys() == {each.name for each in EXTREME_QUANTITIES}
    words = {mark.name for mark in MARK_QUANTITIES}
    words |= {extreme.word for extreme in EXTREME_QUANTITIES}
    assert words < {*RECORDABLE}
    for quantity in (*MARK_QUANTITIES, *EXTREME_QUANTITIES):
        metadata = COLUMNS[quantity.name].field.metadata
        assert metadata[b"unit"].decode() == quantity.unit
        assert metadata[b"description"].decode().startswith(quantity.meaning)


def test_half_the_spin_comes_before_the_reversal():
    n_i = np.linspace(0.05, 0.5, 60)
    runs = kernels.full_batch(GH, n_i, 0.1, t_end=400.0)
    out = integrate(runs, DOP853, FULL, record=T_HALF | {"reversals", "contact"})
    plain = integrate(runs, DOP853, FULL, record=T_HALF)
    reverses = np.isfinite(plain.t_r)
    assert reverses.sum() > 40
    assert (plain.mark("t_half")[reverses] < plain.t_r[reverses]).all()
    np.testing.assert_array_equal(
        out.mark("t_half")[reverses], plain.mark("t_half")[reverses]
    )
