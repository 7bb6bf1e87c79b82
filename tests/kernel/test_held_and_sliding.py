"""Bodies with a large lever that are held and slide at once.

The torque of a patch that slides depends on the ratio of spin and speed.  So a spin
that is held leaves zero together with the foot, and may return to it with the foot.
"""

import math

import friction_oracle
import numpy as np
import pytest

import rattlesweep as rs
from rattlesweep.physics.friction import pivoting

BODY = rs.Rattleback(
    alpha=7.032959214283076,
    beta=2.061580982064128,
    gamma=7.094540196347204,
    theta=0.7931834235746278,
    phi=0.05492976488020539,
    xi=-0.04975001820680393,
)
OMEGA = 0.011079715265522722, 0.016463305211887564, 0.03075921352314072
U = 0.1517789950570693, -0.07382635466979626, -0.985653491859911


@pytest.mark.parametrize("x", [0.1, 0.9, 1.1, 3.0, 29.0, 31.0, 100.0])
def test_slope_of_the_torque_of_a_sliding_patch(x):
    step = 1e-5
    lower = pivoting.share_of_lever(x / (1.0 - step))
    upper = pivoting.share_of_lever(x / (1.0 + step))
    wanted = (upper - lower) / (2.0 * step / x)
    assert pivoting.slope_of_share(x) == pytest.approx(wanted, rel=1e-4)


@pytest.mark.parametrize("n", [0.01, -0.3, 1e-6])
def test_slope_of_the_torque_in_the_spin(n):
    lever, creep, least = 0.2, 0.003, 1e-13

    def torque(spin):
        return pivoting.sliding_drag((0.0, 0.0, 1.0), spin, lever, creep, least)[2]

    step = 1e-5 * abs(n)
    wanted = (torque(n + step) - torque(n - step)) / (2.0 * step)
    slope = pivoting.slope_of_torque(n, lever, creep, least)
    assert slope == pytest.approx(wanted, rel=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("tol", [1e-6, 1e-8, 1e-9, 1e-10, 1e-12])
def test_a_slide_from_a_held_spin_does_not_reverse_at_its_begin(tol):
    run = rs.simulate(
        BODY, omega=OMEGA, u=U, pivot=0.2, mu=0.09582877104451726, t_end=6.0, tol=tol
    )
    assert run.status == "ok"
    assert run.t_held == pytest.approx(1.409318936, abs=1e-5)
    assert run.t_r == pytest.approx(2.9794278, abs=1e-5 if tol > 1e-7 else 1e-7)


def held_and_sliding(seed):
    """Return a random body, and a launch with a large lever and little friction."""
    rng = np.random.default_rng(seed)
    alpha = rng.uniform(6.0, 14.0)
    beta = rng.uniform(1.4, 2.5)
    body = rs.Rattleback(
        alpha=alpha,
        beta=beta,
        gamma=alpha + beta - 2.05,
        theta=rng.uniform(0.5, 0.9),
        phi=rng.uniform(0.03, 0.4),
        xi=rng.uniform(-0.15, 0.15),
    )
    direction, slope_direction = rng.uniform(0.0, 2.0 * math.pi, 2)
    push = math.exp(rng.uniform(math.log(0.08), math.log(0.5)))
    slope = rng.uniform(0.05, 0.3)
    u = slope * math.cos(slope_direction), slope * math.sin(slope_direction), -1.0
    u = tuple(np.array(u) / math.hypot(*u))
    omega = np.array([push * math.cos(direction), push * math.sin(direction), 0.0])
    spin = (0.0, 1e-3, -0.03, 0.1)[seed % 4]
    omega += (spin - omega @ u) * np.array(u)
    losses = {"pivot": rng.uniform(0.05, 0.4), "mu": rng.uniform(0.05, 0.3)}
    return body, {"omega": tuple(omega), "u": u, **losses}


@pytest.mark.slow
def test_random_launches_end_alike_at_all_tolerances():
    near = {1e-6: 1e-3, 1e-8: 1e-5, 1e-9: 1e-6, 1e-10: 0.0}
    slid_and_held = 0
    for seed in range(60):
        body, launch = held_and_sliding(seed)
        runs = {tol: rs.simulate(body, **launch, t_end=12.0, tol=tol) for tol in near}
        best = runs[1e-10]
        slid_and_held += best.n_slides > 0 and best.t_held is not None
        for tol, run in runs.items():
            assert run.status == "ok", (seed, tol)
            if best.t_r is None:
                assert run.t_r is None, (seed, tol)
            else:
                assert run.t_r == pytest.approx(best.t_r, abs=near[tol]), (seed, tol)
            held = pytest.approx(best.held_time, abs=near[tol])
            assert run.held_time == held, (seed, tol)
    assert slid_and_held > 15


@pytest.mark.slow
@pytest.mark.parametrize(("seed", "n"), [(28, 3.407675e-5), (92, None)])
def test_a_launch_from_rest_that_slides_at_once(seed, n):
    """Spin and speed leave zero in the ratio of their rates, not as they were held.

    The value is from 20 steps that begin as held and find the ratio by themselves.
    """
    body, launch = held_and_sliding(seed)
    settings = launch | {"t_end": 0.01}
    rough, run = (rs.simulate(body, **settings, tol=tol) for tol in (1e-9, 1e-12))
    assert rough.status == run.status == "ok"
    assert rough.n_end == pytest.approx(run.n_end, abs=1e-9)
    if n is not None:
        assert run.n_end == pytest.approx(n, rel=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2, 3, 5, 6, 7])
def test_random_launches_are_those_of_the_oracle(seed):
    body, launch = held_and_sliding(seed)
    wanted = friction_oracle.run(
        body,
        launch["u"],
        launch["omega"],
        2.0,
        launch["pivot"],
        launch["mu"],
        rtol=1e-9,
    )
    run = rs.simulate(body, **launch, t_end=2.0)
    assert run.status == wanted.status == "ok"
    # A run ends at its reversal.
    end = wanted.at_reversal or wanted.at_end
    if wanted.t_r is None:
        assert run.t_r is None
    else:
        assert run.t_r == pytest.approx(wanted.t_r, abs=1e-7)
    assert run.held_time == pytest.approx(end.held_time, abs=1e-6)
    assert run.slide_time == pytest.approx(end.slide_time, abs=1e-6)
    assert run.n_end == pytest.approx(end.n, abs=1e-7)
