"""Launches without spin and from full states: results and messages."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import oracle
import pandas as pd
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import brentq
from sweeping import HEAD, invoke, proved

import rattlesweep as rs
from rattlesweep.kernel.batch import PLATEAU_SHARE

BODY = oracle.GH | {"theta": 0.82}
STATE = ["omega_x", "omega_y", "omega_z", "u_x", "u_y", "u_z"]
T_END = 60.0
T_TAP = {"pitch": 20.0, 45.0: 90.0}
GRID = {"source": "grid", "base": {"preset": "GH"}, "axes": {"theta": [0.7, 0.82]}}


def sweep(output: Path, **config: Any) -> pd.DataFrame:
    return rs.sweep({"bodies": GRID} | config, output=output).runs


def test_an_upright_state_is_the_launch_with_its_spin(tmp_path):
    """Results are equal bit by bit; direction and energy, from theory, to rounding."""
    n = -0.3
    w = 0.1
    psi = 50.0
    horizon = {"t_rgh": 3}
    spin = {"n_i": n, "omega_xy0": w, "psi": psi}
    one = sweep(tmp_path / "spin", spin=spin, horizon=horizon)
    omega = [w * math.cos(math.radians(psi)), w * math.sin(math.radians(psi)), -n]
    other = sweep(tmp_path / "state", launch={"omega": omega}, horizon=horizon)
    near = ["omega_xy0", "psi", "n_0", "t_rgh", "t_end", "amp_growth", "n_i"]
    assert set(one.type) == {"R"}
    same = [name for name in one.columns if name not in near]
    pd.testing.assert_frame_equal(one[same], other[same], check_exact=True)
    pd.testing.assert_frame_equal(one[near], other[near], rtol=1e-13)
    assert (other[STATE].to_numpy() == [*omega, 0, 0, -1]).all()


@pytest.fixture(scope="module")
def tilted(tmp_path_factory) -> tuple[Path, pd.DataFrame, np.ndarray]:
    """A sweep of random states from a table: directory, runs, and states for the
    oracle.
    """
    random = np.random.default_rng(3)
    rows = []
    for n in (0.3, -0.3, 0.2, -0.2, 0.4, 0.1, 0.05):
        u = np.array([*random.uniform(-1, 1, 2) * [0.05, 0.005], -1.0])
        u /= np.linalg.norm(u)
        omega = n * u + (n > 0.05 or n < 0) * random.uniform(-0.1, 0.1, 3)
        rows.append([*BODY.values(), *omega, *u, T_END])
    folder = tmp_path_factory.mktemp("tilted")
    columns = [*HEAD.split(","), *STATE, "t_end"]
    pd.DataFrame(rows, columns=columns).to_csv(folder / "states.csv", index=False)
    config = {"bodies": {"source": "table", "path": str(folder / "states.csv")}}
    runs = rs.sweep(config, output=folder / "out").runs
    return folder / "out", runs, runs[STATE[3:] + STATE[:3]].to_numpy()


def test_tilted_states_reverse_when_the_oracle_does(tilted):
    _, runs, states = tilted
    assert runs.t_r.notna().sum() >= 3
    for k in (0, 5):
        t_r, _ = oracle.first_zero(BODY, states[k], T_END, samples=12)
        assert runs.t_r[k] == pytest.approx(
            np.nan if t_r is None else t_r, rel=1e-8, nan_ok=True
        )
        assert runs.n_i[k] == pytest.approx(oracle.spin(states[k]), rel=1e-14)
    # The energy includes that of the tilt.
    rest = oracle.energy(np.array([0, 0, -1.0, 0, 0, 0]), BODY)
    found = [oracle.energy(y, BODY) - rest for y in states]
    np.testing.assert_allclose(0.5 * BODY["gamma"] * runs.n_0**2, found, rtol=1e-10)
    # The last one turns about the vertical: its oscillation is the tilt alone.
    assert runs.omega_xy0.iloc[-1] < 1e-15


@pytest.mark.parametrize("body", [{"overrides": {"phi": 0.01}}, {"c": 2.0}])
def test_n_0_is_the_spin_with_all_the_energy_of_a_state(body, tmp_path):
    """The energy includes the translation: a body of small curvature swings far out."""
    bodies = {"source": "preset", "name": "GH"} | body
    tilt = [0.0, 0.1, -math.sqrt(0.99)]
    for u, omega in (
        (tilt, [0, 0, -0.3]),
        ([0, 0, -1], [0.02, 0.1, 0.2]),
        (tilt, [0.1, 0.2, 0]),
    ):
        launch = {"omega": omega, "u": u}
        config = {"launch": launch, "horizon": {"t": 1}, "record": ["energy"]}
        run = rs.sweep(
            {"bodies": bodies, **config}, output=tmp_path / str(omega)
        ).runs.iloc[0]
        assert run.n_0 == pytest.approx(
            math.sqrt(2 * run.energy_0 / run.gamma), rel=1e-14
        )


def test_a_sweep_of_states_can_be_repeated(tilted, tmp_path):
    directory, runs, _ = tilted
    source = {"source": "table", "path": str(directory / "runs")}
    again = rs.sweep(
        {"bodies": source, "horizon": {"t": T_END}}, output=tmp_path / "again"
    ).runs
    pd.testing.assert_frame_equal(again, runs, check_exact=True)
    proved(directory, recompute=7)
    replay = "replay", directory, "--where", "u_x > -1 and omega_z < 1", "--points", 2
    assert invoke(*replay).exit_code == 0


def tapped_oracle(omega_xy0: float, psi: float, t_end: float) -> tuple[float, float]:
    """Return when a tapped body's spin first leaves zero, and its first zero after
    that.
    """
    y0 = oracle.launch(BODY, 0.0, omega_xy0, psi)
    inertia = BODY["alpha"] * math.cos(psi) ** 2 + BODY["beta"] * math.sin(psi) ** 2
    far = PLATEAU_SHARE * omega_xy0 * math.sqrt(inertia / BODY["gamma"])
    path = solve_ivp(
        oracle.rhs,
        (0, t_end),
        y0,
        args=(BODY,),
        method="DOP853",
        rtol=1e-12,
        atol=1e-15,
        dense_output=True,
    )
    times = np.arange(0.0, t_end, 0.01)
    y = path.sol(times)
    n = np.sum(y[:3] * y[3:], axis=0)
    begin = int(np.argmax(np.abs(n) > far))
    turn = begin + int(np.argmax(n[begin:] * n[begin] <= 0))
    zero = brentq(
        lambda t: oracle.spin(path.sol(t)), times[turn - 1], times[turn], xtol=1e-13
    )
    return times[begin], zero


@pytest.mark.parametrize("psi", ["pitch", pytest.param(45.0, marks=pytest.mark.slow)])
def test_a_tapped_body_reverses_once_it_has_spun(psi):
    body = rs.Rattleback(**BODY)
    angle = {"pitch": rs.modes(body).psi_p}.get(psi, math.radians(45.0))
    tap = {"n_i": 0, "omega_xy0": 0.4, "psi": psi, "t_end": T_TAP[psi]}
    run = rs.simulate(body, **tap)
    path = rs.trajectory(body, **tap, dt=0.05)
    begin, t_r = tapped_oracle(0.4, angle, T_TAP[psi])
    assert run.type == "R"
    assert run.t_r == pytest.approx(t_r, rel=1e-8)
    assert run.amp_growth is run.n_departure is None
    # Before that it wobbles about zero, which is not a reversal.
    assert path.zeros[path.zeros > begin][0] == run.t_r
    early = path.table.n[path.table.t.between(0, begin, inclusive="neither")]
    crossings = np.count_nonzero(np.diff(np.sign(early)))
    assert crossings == np.count_nonzero(path.zeros < begin)
    assert crossings > 0 or psi != 45.0
