"""A reported error of a reversal time is never below the true one."""

import numpy as np
import pandas as pd
import problems
import pytest
import samples
import sweeping
from sweeping import prepared

from rattlesweep.design.models import model_of
from rattlesweep.kernel import outcome
from rattlesweep.kernel.batch import integrate
from rattlesweep.kernel.method.tableau import METHODS
from rattlesweep.work.block import run_batch


@pytest.mark.parametrize(
    ("problem", "tol"),
    [
        pytest.param(
            problem,
            tol,
            id=f"{problem.name}-{tol:g}",
            marks=pytest.mark.slow if {"mu", "pivot"} <= {*problem.launch} else [],
        )
        for problem in problems.PROBLEMS
        for tol in problem.tols
    ],
)
def test_errors_are_honest(problem, tol):
    problems.assert_honest(problem, tol)


def wide_plan(folder, losses, size, seed, tol):
    """Plan launches of any legal body in any position, with errors."""
    table = samples.wide_launches(size, seed, losses)
    table["t_end"] = np.full(size, 200.0)
    path = folder / "wide.csv"
    pd.DataFrame(table).to_csv(path, index=False)
    return sweeping.plan_of(
        {
            "bodies": {"source": "table", "path": str(path)},
            "integrator": {"tol": tol},
            "record": ["error"],
        }
    )


@pytest.mark.slow
@pytest.mark.parametrize("tol", [1e-6, 1e-9, 1e-12])
def test_errors_of_wide_bodies_with_pivoting(tol, tmp_path):
    """Where the plane would have to pull, 85 % of the errors were covered at 1e-9."""
    plan = wide_plan(tmp_path, ("sigma", "pivot"), 2000, 5, tol)
    batch = prepared(plan)[1]
    model = model_of(plan.config)
    true = integrate(batch, METHODS["verner98"], model, tol=1e-14).t_r
    other = integrate(batch, METHODS["dop853"], model, tol=1e-13).t_r
    estimated = run_batch(plan.config, batch)
    assert isinstance(estimated, outcome.Estimated)
    off = np.abs(estimated.t_r - true)
    doubt = np.abs(other - true)
    is_known = doubt <= np.maximum(1e-9 * true, 0.1 * off)
    is_covered = off <= estimated.t_r_error
    is_pulled = is_known & (estimated.pulled > 0)
    assert is_known.sum() > 1200
    assert is_pulled.sum() > 30
    assert is_covered[is_known].mean() >= 0.996
    assert is_covered[is_pulled].mean() >= 0.97
    over = estimated.t_r_error[is_known] / np.maximum(off[is_known], 1e-16)
    assert np.median(over) < 100


@pytest.mark.slow  # compiles the extremes of the contact
def test_a_body_that_is_pulled_says_so(tmp_path):
    """Only the run that rocks so hard has a kink in its torque."""
    plan = wide_plan(tmp_path, ("sigma", "pivot"), 60, 1, 1e-9)
    batch = prepared(plan)[1]
    estimated = run_batch(plan.config, batch)
    model = model_of(plan.config)
    record = frozenset({"contact"})
    forces = integrate(batch, METHODS["dop853"], model, tol=1e-9, record=record)
    # Between the ends of steps the force may fall further.
    is_pulled = estimated.pulled > 0
    assert (forces.contact_normal_min[is_pulled] < 0).all()
    assert not is_pulled[forces.contact_normal_min > 0].any()
    assert is_pulled.sum() >= 1
