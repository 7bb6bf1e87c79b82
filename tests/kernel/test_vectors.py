"""Ellipsoids that roll onto their side, and beyond: the variables of
`physics.vectors`.
"""

from math import sqrt

import kernels
import numpy as np
import pytest
import stone_oracle
from exact import exactly
from stones import constants_of, random_bodies
from sweeping import plan_of, prepared

from rattlesweep.kernel.batch import integrate
from rattlesweep.kernel.method.tableau import METHODS
from rattlesweep.kernel.state.status import Status
from rattlesweep.motion.model import FULL_ELLIPSOID, find_model
from rattlesweep.physics import full
from rattlesweep.physics.body import PARAMETERS
from rattlesweep.work.block import run_batch

DOP853 = METHODS["dop853"]
VECTORS = find_model("vectors")


def rollers(samples, **others):
    """Return a sweep of low ellipsoids, most of which roll onto their side, and its
    batch.
    """
    plan = plan_of(
        {
            "seed": 2017,
            "bodies": {
                "source": "sd",
                "samples": samples,
                "surface": "ellipsoid",
                "c": 2,
            },
            "spin": {"n_i": -0.5, "omega_xy0": 0.01},
            "horizon": {"t_rgh": 5, "t": 20000},
            **others,
        }
    )
    launches, batch = prepared(plan)
    return plan.config, launches, batch


def test_equations_are_those_of_mechanics_in_any_position():
    rhs = exactly(VECTORS.rhs, sqrt)
    energy = exactly(VECTORS.energy, sqrt)
    contact = exactly(VECTORS.contact, sqrt)
    rng = np.random.default_rng(5)
    for k, (body, _, omega, sigma, rolling) in enumerate(random_bodies(100, 1)):
        if body["c"] is None:
            continue
        v = rng.normal(size=3)
        sigma = sigma * (k % 3 > 0)
        rolling = rolling * (k % 3 > 1)
        q = constants_of(VECTORS, body, sigma, rolling)
        y = np.concatenate([v / np.linalg.norm(v), omega, [0.0]])
        wanted, force, power = stone_oracle.forces(y, body, sigma, rolling)
        got = rhs((*v, *omega, 0.3), tuple(q))
        scale = 1 + np.abs(wanted).max()
        np.testing.assert_allclose(got[:3], np.cross(v, omega), atol=1e-14)
        np.testing.assert_allclose(got[3:6], wanted, rtol=0, atol=1e-11 * scale)
        assert got[6] == pytest.approx(power, rel=1e-10, abs=1e-12)
        total = stone_oracle.energy(y, body)
        assert energy((*v, *omega, 0.3), tuple(q)) == pytest.approx(
            total - 0.3, abs=1e-11
        )
        normal, tangential = contact((*v, *omega, 0.3), tuple(q))
        assert normal == pytest.approx(force @ y[:3], abs=1e-10 * scale)
        across = np.linalg.norm(force - (force @ y[:3]) * y[:3])
        assert tangential == pytest.approx(across, abs=1e-10 * scale)


def test_runs_go_on_past_the_side_as_the_oracle_says():
    """The roll grows until the body lies on its side; later the spin reverses."""
    config, launches, batch = rollers(200)
    rows = np.array([177, 6])
    out = run_batch(config, kernels.take(batch, rows))
    assert (out.status == Status.OK).all()
    assert abs(out.energy_drift).max() < 1e-6
    k = int(np.argmin(out.t_r))
    columns = vars(launches.bodies) | launches.bodies.further
    body = {name: columns[name][rows[k]] for name in (*PARAMETERS, "c")}
    u, omega = full.to_vectors(batch.y0[rows[k]])
    found = stone_oracle.follow(body, u, omega, 1.01 * out.t_r[k], tol=1e-11)
    assert found.y[2].max() > 0
    zero = stone_oracle.first_zero(found, lambda y: np.sum(y[:3] * y[3:6], axis=0))
    assert out.t_r[k] == pytest.approx(zero, rel=1e-8)
    # A row is the same in any batch, and with reversals recorded.
    kernels.assert_same(
        run_batch(config, kernels.take(batch, rows[[1]])), kernels.pick(out, [1])
    )
    both = integrate(
        kernels.take(batch, rows),
        DOP853,
        FULL_ELLIPSOID,
        record=frozenset(["reversals"]),
    )
    np.testing.assert_array_equal(both.t_r, out.t_r)
