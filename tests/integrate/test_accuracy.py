"""Accuracy over the paper's runs: both directions, all its spins and oscillations."""

from pathlib import Path

import numpy as np
import pytest

from rattlesweep.integrate.batch import integrate
from rattlesweep.integrate.model import FULL
from rattlesweep.integrate.tableau import METHODS
from rattlesweep.sweeps.block import prepare_runs, run_batch
from rattlesweep.sweeps.config.read import load_config
from rattlesweep.sweeps.plan import make_plan

CONFIGS = Path(__file__).parents[2] / "configs"
slow = pytest.mark.slow


def prepared(name, *changes):
    """A shipped config with changes, and its runs."""
    config = load_config(CONFIGS / f"{name}.yaml", changes)
    plan = make_plan(config)
    return config, prepare_runs(plan, *np.divmod(np.arange(plan.runs), plan.samples))[1]


def drifts(name, integrator):
    outcome = run_batch(
        *prepared(
            name, "bodies.samples=2", "bodies.target.rel_tol=0.01", f"integrator={integrator}"
        )
    )
    assert (outcome.status == 0).all()
    return np.abs(outcome.energy_drift)


@pytest.mark.parametrize("name", ["steady", pytest.param("unsteady", marks=slow)])
def test_energy_is_conserved(name):
    found = drifts(name, "{method: dop853, tol: 1e-12}")
    assert len(found) == 240
    assert found.max() < 1e-9
    # It falls with the tolerance: the drift is the step errors', nothing else's.
    assert np.median(drifts(name, "{method: dop853, tol: 1e-9}")) > 100 * np.median(found)


@slow
def test_the_default_setting_against_two_references():
    config, batch = prepared("tradeoff", "bodies.samples=70")
    assert (config.integrator.method, config.integrator.tol) == ("dop853", 1e-9)
    assert len(batch) == 2100

    def times(method, tol):
        return integrate(batch, METHODS[method], FULL, tol=tol).t_r

    one, other = times("dop853", 1e-13), times("verner98", 1e-13)
    sure = np.abs(one / other - 1) < 1e-8
    assert sure.sum() > 1700
    default = times("dop853", 1e-9)
    # No first zero is missed, and none is found that is not there.
    assert np.isfinite(default[sure]).all()
    never = np.isnan(one) & np.isnan(other)
    assert np.isnan(default[never]).mean() > 0.99
    error = np.abs(default / other - 1)[sure]
    assert (error < 1e-6).mean() >= 0.995
    assert np.median(error) < 1e-9
    # The exceptions are runs that multiply the error of every step: it falls with the tolerance,
    # as everywhere, but from a higher level; a missed zero would not.
    finer = np.abs(times("dop853", 1e-11) / other - 1)[sure]
    assert (finer[error > 1e-6] < 0.1 * error[error > 1e-6]).all()
