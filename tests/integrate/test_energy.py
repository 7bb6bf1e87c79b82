"""Energy over the paper's runs: both directions, all its spins and oscillations."""

from pathlib import Path

import numpy as np
import pytest

from rattlesweep.sweeps.blocks.block import prepare_block, run_batch
from rattlesweep.sweeps.cases.plan import Block, make_plan
from rattlesweep.sweeps.config.load import load_config

CONFIGS = Path(__file__).parents[2] / "configs"


def drifts(name, integrator):
    config = load_config(
        CONFIGS / f"{name}.yaml",
        ["bodies.samples=2", "bodies.target.rel_tol=0.01", f"integrator={integrator}"],
    )
    plan = make_plan(config)
    _, batch = prepare_block(plan, Block(0, 0, plan.runs))
    outcome = run_batch(config, batch)
    assert (outcome.status == 0).all()
    return np.abs(outcome.energy_drift)


@pytest.mark.parametrize("name", ["steady", "unsteady"])
def test_energy_is_conserved(name):
    found = drifts(name, "{method: dop853, tol: 1e-12}")
    assert len(found) == 240
    assert found.max() < 1e-9
    # It falls with the tolerance: the drift is the step errors', nothing else's.
    assert np.median(drifts(name, "{method: dop853, tol: 1e-9}")) > 100 * np.median(found)


@pytest.mark.slow
@pytest.mark.parametrize(("name", "most"), [("steady", 1e-9), ("unsteady", 1e-8)])
def test_energy_with_the_paper_s_integrator(name, most):
    # At n_i = 0.5 and omega_xy0 = 0.1 the flattest bodies swing too fast for 1e-9 at dt = 0.002.
    assert drifts(name, "{method: rk4, dt: 0.002}").max() < most
