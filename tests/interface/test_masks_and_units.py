"""Masked arrays and quantities of Pint, by every function that takes numbers."""

from __future__ import annotations

import warnings
from functools import partial
from typing import Any

import numpy as np
import pint
import pytest

import rattlesweep as rs
from rattlesweep.physics.body import PARAMETERS
from rattlesweep.words.errors import ConfigError

quantity: Any = pint.UnitRegistry().Quantity
GH = rs.Rattleback.gh()
KL = rs.Rattleback.kl()
MASKED = np.ma.masked_array([0.1, 0.3], mask=[True, False])
SPIN: dict[str, Any] = {"n_i": 0.1, "omega_xy0": 0.01}
SHELL: dict[str, Any] = {"f_sd": 0.1, "theta": 0.8, "phi": 0.05, "xi": -0.05}
RPM = quantity([60.0, 70.0], "rpm")
in_rpm = {"omega_xy0": "6 rpm", "model": "gh"}


@pytest.fixture(autouse=True)
def _no_unit_is_stripped():
    with warnings.catch_warnings(action="error", category=pint.UnitStrippedWarning):
        yield


@pytest.mark.parametrize(
    ("call", "name"),
    [
        (partial(rs.simulate, GH, n_i=MASKED, omega_xy0=0.01), "n_i[0]"),
        (partial(rs.simulate, GH, n_i=[0.1, np.ma.masked], omega_xy0=0.01), "n_i"),
        (partial(rs.simulate, GH, n_i=0.1, omega_xy0=MASKED), "omega_xy0[0]"),
        (partial(rs.simulate, GH, **SPIN, t_end=MASKED), "t_end[0]"),
        (partial(rs.simulate, GH, **SPIN, psi=MASKED), "psi[0]"),
        (partial(rs.simulate, GH, **SPIN, sigma=MASKED), "sigma[0]"),
        (partial(rs.simulate, GH, **SPIN, mu=MASKED), "mu[0]"),
        (
            partial(rs.simulate, GH, omega=np.ma.masked_less([0.1, 0, -1], 0)),
            "omega[2]",
        ),
        (partial(rs.trajectory, GH, **SPIN, t_end=1, times=MASKED), "times[0]"),
        (partial(rs.reversal_time_gh, GH, MASKED, 0.01), "n_i[0]"),
        (partial(rs.growth_rates, GH, MASKED), "n[0]"),
        (partial(rs.Rattleback.shell_dumbbell, gamma=10 * MASKED, **SHELL), "gamma[0]"),
        (
            partial(
                rs.sweep,
                {
                    "bodies": {"source": "preset", "name": "GH"},
                    "spin": SPIN | {"n_i": MASKED},
                },
            ),
            "spin.n_i[0]",
        ),
        (partial(rs.simulate, KL, n_i=quantity(MASKED, "rpm"), **in_rpm), "n_i[0]"),
    ],
)
def test_a_masked_number_is_refused_where_it_stands(call, name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(ConfigError) as caught:
        call()
    assert str(caught.value).startswith(f"{name} is masked; give a number there")
    assert not list(tmp_path.iterdir())


def test_an_array_without_masked_numbers_is_taken():
    plain = np.array([0.1, 0.3])
    clear = np.ma.masked_array(plain, mask=False)
    for call in (
        lambda n: rs.simulate(GH, n_i=n, omega_xy0=0.01, model="gh").t_r.to_numpy(),
        lambda n: rs.reversal_time_gh(GH, n, 0.01),
        lambda n: rs.growth_rates(GH, n).pitch,
    ):
        np.testing.assert_array_equal(call(clear), call(plain))


def test_a_masked_cell_of_a_table_is_an_empty_cell():
    columns = {name: [getattr(GH, name)] * 2 for name in PARAMETERS}
    rows = columns | {"theta": np.ma.masked_array(columns["theta"], [False, True])}
    with pytest.raises(ConfigError, match="row 2: theta is empty"):
        rs.modes(rows)


@pytest.mark.parametrize("spins", [RPM, list(RPM), ["60 rpm", quantity(70, "rpm")]])
def test_spins_of_pint_are_spins_as_texts_are(spins):
    texts = rs.simulate(KL, n_i=["60 rpm", "70 rpm"], **in_rpm)
    given = rs.simulate(KL, n_i=spins, **in_rpm | {"omega_xy0": quantity(6, "rpm")})
    assert given.t_r.tolist() == texts.t_r.tolist()
    times = rs.reversal_time_gh(KL, n_i=spins, omega_xy0="6 rpm")
    np.testing.assert_array_equal(times, texts.t_rgh)
    seen = rs.growth_rates(KL, spins).pitch / texts.n_i
    np.testing.assert_allclose(
        seen, rs.growth_rates(KL, "1 sqrt(g/a)").pitch, rtol=1e-14
    )


def test_times_losses_and_directions_of_pint():
    one = rs.simulate(
        KL,
        n_i="60 rpm",
        omega_xy0="6 rpm",
        t_end=quantity(100, "ms"),
        sigma=quantity(1e-7, "N m s/rad"),
        psi=quantity(np.pi / 6, "rad"),
    )
    other = rs.simulate(
        KL, n_i="60 rpm", omega_xy0="6 rpm", t_end="0.1 s", sigma="1e-7 N m s", psi=30
    )  # fmt: skip
    assert one.t_end == pytest.approx(other.t_end, rel=1e-14)
    assert one.sigma == other.sigma
    # The argument is in degrees, the column in radians.
    assert one.psi == pytest.approx(other.psi) == pytest.approx(np.radians(30))
    path = rs.trajectory(
        KL,
        n_i=quantity(60, "rpm"),
        omega_xy0=quantity(6, "rpm"),
        t_end=quantity(0.5, "s"),
        times=quantity([100, 200], "ms"),
    )
    np.testing.assert_allclose(path["t_s"], [0.1, 0.2], rtol=1e-12)


def test_bodies_of_pint_are_those_of_texts():
    from_si = rs.Rattleback.from_si
    quantities = from_si(
        mass=quantity(85, "g"),
        height=quantity(1, "cm"),
        radii=quantity([50, 1.5], "cm"),
        axes_angle=quantity(2, "deg"),
        inertia=quantity([60, 900, 920, -20], "g cm^2"),
    )
    texts = from_si(
        mass="85 g",
        height="1 cm",
        radii="50, 1.5 cm",
        axes_angle="2 deg",
        inertia="60, 900, 920, -20 g cm^2",
    )
    for name in PARAMETERS:
        assert getattr(quantities, name) == pytest.approx(getattr(texts, name), 1e-13)
    with pytest.raises(
        ValueError, match="mass: 85 meter is a length; a mass is needed"
    ):
        from_si(mass=quantity(85, "m"), height=1, radii=(1, 2), inertia=(1, 2, 3))
    shells = rs.Rattleback.shell_dumbbell(
        gamma=10, **SHELL | {"xi": quantity([-3, -4], "deg")}
    )
    assert [body.xi for body in shells] == pytest.approx(np.radians([-3, -4]))


def test_a_config_may_have_quantities_of_pint(tmp_path):
    config = {"bodies": {"source": "preset", "name": "KL"}, "model": "gh"}
    config["spin"] = {"n_i": RPM, "omega_xy0": quantity(6, "rpm")}
    runs = rs.sweep(config, output=tmp_path / "o").runs
    np.testing.assert_allclose(runs.n_i_rpm, [60, 70], rtol=1e-14)
    config["spin"]["n_i"] = quantity([300.0], "K")
    with pytest.raises(
        ConfigError, match=r"spin\.n_i: has the unit kelvin, which no quantity here has"
    ):
        rs.sweep(config, output=tmp_path / "p")


class Foreign(np.ndarray):
    """Like the arrays of other libraries, whose units NumPy drops."""

    unit = "rpm"


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (partial(rs.simulate, GH, n_i=RPM, omega_xy0=0.01), "but the body has no size"),
        (
            partial(rs.simulate, KL, n_i=quantity([1.0], "m"), **in_rpm),
            "is a length; a spin is needed",
        ),
        (
            partial(rs.simulate, KL, n_i=np.ones(2).view(Foreign), **in_rpm),
            "n_i: an array in rpm (Foreign) is not understood",
        ),
        (
            partial(rs.simulate, GH, **SPIN, mu=quantity(0.5, "m")),
            "has the unit meter; a pure number is needed",
        ),
        (
            partial(rs.modes, {"theta": quantity([0.5], "1/m")}),
            "column theta is in 1 /",
        ),
        (
            partial(
                rs.fit,
                KL,
                {"t_s": quantity([0.0, 1.0], "s"), "angle_deg": [1.0, 2.0]},
                free=["n_i"],
            ),
            "data: the column t_s is in second; give numbers",
        ),
    ],
)
def test_units_that_do_not_fit_are_refused(call, words):
    with pytest.raises(ConfigError) as caught:
        call()
    assert words in str(caught.value)
