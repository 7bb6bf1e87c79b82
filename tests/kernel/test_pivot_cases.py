"""Runs with pivoting friction against those of an independent program."""

import json
import math
from pathlib import Path

import contact_mechanics
import hertz_patch
import numpy as np
import pytest

import rattlesweep as rs

TESTS = Path(__file__).parents[1]
CASES = json.loads((TESTS / "physics" / "pivot_cases.json").read_text())
NUMBERS = ("t_held", "held_time", "pivot_work", "energy_left")


def model_of(case):
    """Return the surface and the law of a case, which have a kernel together."""
    surface = "paraboloid" if case["body"]["c"] is None else "ellipsoid"
    if case["dissipation"]["mu"]:
        return surface, "sliding"
    return surface, "rolling" if case["dissipation"]["rolling"] else "pivoting"


def simulate(case, **integrator):
    body = {k: v for k, v in case["body"].items() if v is not None}
    losses = {k: v for k, v in case["dissipation"].items() if v}
    launch = dict(case["launch"])
    psi = math.degrees(launch.pop("psi"))
    return rs.simulate(
        rs.Rattleback(**body),
        **launch,
        psi=psi,
        t_end=case["t_end"],
        **losses,
        **integrator,
    )


@pytest.mark.parametrize(
    "model",
    [
        ("paraboloid", "pivoting"),
        pytest.param(("paraboloid", "rolling"), marks=pytest.mark.slow),
        pytest.param(("paraboloid", "sliding"), marks=pytest.mark.slow),
        pytest.param(("ellipsoid", "pivoting"), marks=pytest.mark.slow),
        pytest.param(("ellipsoid", "rolling"), marks=pytest.mark.slow),
    ],
)
def test_runs_are_those_of_the_oracle(model):
    """The worst differences at the default tolerance are 4e-9; 2e-8 with slides."""
    cases = [x for x in CASES if model_of(x) == model]
    assert cases
    for case in cases:
        result = case["result"]
        # A run ends at its reversal.
        wanted = result["at_reversal"] or result["at_end"]
        run = simulate(case)
        assert run.status == "ok"
        expected = {"t_r": result["t_r"]} | {name: wanted[name] for name in NUMBERS}
        for name, value in expected.items():
            if value is None:
                assert run[name] is None, name
            else:
                assert run[name] == pytest.approx(value, rel=1e-7, abs=1e-7), name


@pytest.mark.parametrize("tol", [1e-8, 1e-10, 1e-12])
def test_short_rests_at_any_tolerance(tol):
    """A body that rocks is held and released again and again."""
    for number in (9, 11):
        case = CASES[number]
        assert case["result"]["n_holds"] > 1
        run = simulate(case, tol=tol)
        assert run.status == "ok"
        wanted = case["result"]["at_end"]["held_time"]
        assert run.held_time == pytest.approx(wanted, abs=1e-7)


def needed_torque(row, body, lever, mu=math.inf):
    """Return the torque of the reference program at a row of a trajectory."""
    stone = contact_mechanics.stone_of(body, mu, pivot=lever)
    u = row.u_x, row.u_y, row.u_z
    omega = row.omega_x, row.omega_y, row.omega_z
    if row.held:
        return contact_mechanics.holding_torque(stone, u, omega).torque
    if not row.sliding:
        side = -lever * math.copysign(1.0, row.n)
        return contact_mechanics.rolling_forces(stone, u, omega, side).torque
    first = np.array([1.0, 0.0, 0.0]) - row.u_x * np.array(u)
    first /= np.linalg.norm(first)
    angle = row.slip_angle
    towards = math.cos(angle) * first + math.sin(angle) * np.cross(u, first)
    side = -lever * hertz_patch.rubbing_of(stone.patch * row.n / row.v_slip)
    contact = contact_mechanics.contact_of(stone, u, omega)
    # The foot moves, which the contact of a body that rolls leaves out.
    forces, _, _ = contact_mechanics.sliding_forces(
        stone, contact, u, omega, tuple(towards), side
    )
    return forces.torque


@pytest.mark.slow
@pytest.mark.parametrize("mu", [None, 0.15], ids=["rolls", "slides"])
def test_channel_of_the_torque(mu):
    """It is the torque that the motion needs, and its power is the work."""
    body = rs.Rattleback.gh()
    lever = 0.006
    names = ["t", "n", "held", "sliding", "pivot_torque", "F_normal", "work"]
    names += ["u_x", "u_y", "u_z", "omega_x", "omega_y", "omega_z"]
    names += ["v_slip", "slip_angle"]
    losses = {"pivot": lever} if mu is None else {"pivot": lever, "mu": mu}
    launch = {"n_i": 0.0, "omega_xy0": 0.3, "psi": "roll"}
    if mu is not None:
        launch = {"n_i": 0.2, "omega_xy0": 0.3}
    run = rs.trajectory(
        body, **launch, t_end=20, points=20001, channels=names, **losses
    )
    table = run.table
    assert run.units["pivot_torque"] == "M g a"
    assert table["sliding" if mu else "held"].sum() > 100
    for row in table[::97].itertuples():
        wanted = needed_torque(row, body, lever, mu or math.inf)
        assert row.pivot_torque == pytest.approx(wanted, rel=1e-6, abs=1e-12)
    most = lever * table.F_normal
    assert (abs(table.pivot_torque) <= most * (1 + 1e-9)).all()
    spins = (table.held == 0) & (table.sliding == 0) & (table.n != 0)
    full = -np.sign(table.n) * most
    np.testing.assert_allclose(table.pivot_torque[spins], full[spins], rtol=1e-9)
    if mu is None:
        power = table.pivot_torque * table.n
        assert np.trapezoid(power, table.t) == pytest.approx(
            table.work.iloc[-1], rel=1e-4
        )
