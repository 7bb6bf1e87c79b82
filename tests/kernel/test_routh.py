"""A loaded sphere through the ellipsoid's kernel: Jellett's integral."""

import numpy as np
import pytest

import rattlesweep as rs


@pytest.mark.parametrize("c", [1.6, 3.0])
def test_jelletts_integral_of_a_routh_sphere(c):
    """The angular momentum about the centre of mass times the contact vector is
    conserved.

    A body needs ``phi < theta`` and ``beta < alpha``, which here differ in the last
    place only.
    """
    sphere = rs.Rattleback(
        alpha=2.2,
        beta=np.nextafter(2.2, 0),
        gamma=1.0,
        theta=1 / c,
        phi=np.nextafter(1 / c, 0),
        xi=-0.1,
        c=c,
    )
    run = rs.trajectory(
        sphere,
        omega=(0.3, -0.2, 0.8),
        u=(0.3, 0.2, -np.sqrt(0.87)),
        t_end=200,
        tol=1e-13,
        channels=["omega_x", "omega_y", "omega_z", "u_x", "u_y", "u_z"],
    ).table
    momentum = run[["omega_x", "omega_y", "omega_z"]].to_numpy() * [1.2, 1.2, 1.0]
    up = run[["u_x", "u_y", "u_z"]].to_numpy()
    contact = [0, 0, 1 - c] - c * up
    jellett = (momentum * contact).sum(axis=1)
    assert np.ptp(up[:, 2]) > 0.1
    assert np.ptp(jellett) < 1e-12 * abs(jellett[0])
