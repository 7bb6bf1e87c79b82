"""Random bodies and launches thrown at the kernel: a sane row or a status, and always the same."""

import kernels
import numpy as np
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from rattlesweep.integrate.batch import integrate
from rattlesweep.integrate.model import FULL
from rattlesweep.integrate.status import Status
from rattlesweep.physics.body import PARAMETERS, violations


def logs(low, high):
    return st.floats(np.log10(low), np.log10(high)).map(lambda x: 10.0**x)


@st.composite
def bodies(draw):
    """Any body that can be: flat or round, barely or wholly skewed, mirrored or not."""
    phi = draw(logs(1e-3, 0.5))
    theta = 1 - draw(logs(1e-9, 1.0)) * (1 - phi) * 0.999
    i_yy = draw(logs(0.05, 10))
    i_xx = i_yy * (1 + draw(logs(1e-6, 20)))
    low, high = i_xx - i_yy, i_xx + i_yy
    gamma = low + (high - low) * draw(st.floats(0.01, 1))
    xi = np.radians(draw(logs(1e-6, 89))) * draw(st.sampled_from([-1, 1]))
    body = dict(zip(PARAMETERS, (1 + i_xx, 1 + i_yy, gamma, theta, phi, xi), strict=True))
    return body if not list(violations(**body)) else None


launches = st.tuples(
    logs(1e-4, 3), st.sampled_from([-1, 1]), logs(1e-9, 1), st.floats(-1.6, 1.6), logs(1e-6, 30)
)


@kernels.methods("dop853", "rk4")
@settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.filter_too_much])
@given(body=bodies().filter(lambda body: body is not None), launch=launches)
def test_a_sane_row_or_a_status(method, body, launch):
    spin, sign, omega, psi, t_end = launch
    batch = kernels.full_batch(body, sign * spin, omega, psi, t_end)
    one = integrate(batch, method, FULL, max_steps=200_000)
    status = Status(int(one.status[0]))
    assert status != Status.STOPPED
    assert 0 <= one.t_end[0] <= t_end
    if status == Status.OK:
        assert abs(one.energy_drift[0]) <= 0.01
        assert np.isfinite(one.n_end[0])
        assert np.isfinite(one.y_end).all()
        if np.isnan(one.t_r[0]):
            # No reversal: the horizon to the bit, and a spin that still has its sign.
            assert one.t_end[0] == t_end
            assert sign * one.n_end[0] > 0
            assert one.n_departure[0] < 1
        else:
            assert one.t_r[0] == one.t_end[0]
            assert abs(one.n_end[0]) < 1e-9 * (spin + omega) * max(
                1, np.abs(one.y_end[0, :2]).max()
            )
    else:
        assert np.isnan(one.t_r[0])
    # Alone or three times over, on one thread or two: the same bits.
    again = integrate(kernels.join(batch, batch, batch), method, FULL, max_steps=200_000, threads=2)
    for name in ("t_end", "t_r", "n_end", "n_steps", "status", "amp_growth"):
        np.testing.assert_array_equal(getattr(again, name), np.repeat(getattr(one, name), 3))
