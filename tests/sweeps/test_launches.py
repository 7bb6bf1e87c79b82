"""Launches without spin and from a full state: what they come to, and how they are refused."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import oracle
import pandas as pd
import pytest
from refusal import assert_refused
from scipy.integrate import solve_ivp
from scipy.optimize import brentq
from test_run import invoke

import rattlesweep as rs
from rattlesweep.integrate.batch import PLATEAU_SHARE

BODY = oracle.GH | {"theta": 0.82}
HEAD = "alpha,beta,gamma,theta,phi,xi"
T_END = 60.0
T_TAP = {"pitch": 20.0, "roll": 300.0, 45.0: 90.0}
GRID = {"source": "grid", "base": {"preset": "GH"}, "axes": {"theta": [0.7, 0.82]}}


def sweep(tmp_path: Path, **config: Any) -> pd.DataFrame:
    return rs.sweep({"bodies": GRID} | config, output=tmp_path / "out").runs


def upright(n_i: float, omega_xy0: float, psi: float) -> list[float]:
    return [omega_xy0 * math.cos(psi), omega_xy0 * math.sin(psi), -n_i]


# ----------------------------------------------------------------------------- full states


def test_an_upright_state_is_the_launch_with_its_spin(tmp_path: Path):
    """The same bits, but for what theory says of the direction and the energy, to rounding."""
    psi = 50.0
    spin = {"n_i": -0.3, "omega_xy0": 0.1, "psi": psi}
    one = sweep(tmp_path / "spin", spin=spin, horizon={"t_rgh": 3})
    state = {"omega": upright(-0.3, 0.1, math.radians(psi))}
    other = sweep(tmp_path / "state", launch=state, horizon={"t_rgh": 3})
    near = ["omega_xy0", "psi", "n_0", "t_rgh", "t_end", "amp_growth"]
    assert set(one.type) == {"R"}
    pd.testing.assert_frame_equal(
        one.drop(columns=[*near, "n_i"]),
        other[one.columns].drop(columns=[*near, "n_i"]),
        check_exact=True,
    )
    pd.testing.assert_frame_equal(one[near], other[near], rtol=1e-13)
    assert (other[["omega_x", "omega_y", "omega_z"]].to_numpy() == state["omega"]).all()
    assert (other[["u_x", "u_y", "u_z"]].to_numpy() == [0, 0, -1]).all()


@pytest.fixture(scope="module")
def tilted(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, pd.DataFrame]:
    """A sweep of random states, from a table."""
    random = np.random.default_rng(3)
    rows = []
    for n in (0.3, -0.3, 0.2, -0.2, 0.4, 0.1, 0.05):
        u = np.array([*random.uniform(-1, 1, 2) * [0.05, 0.005], -1.0])
        u /= np.linalg.norm(u)
        omega = n * u + random.uniform(-0.1, 0.1, 3)
        if n == 0.05:
            u = np.array([0.01, 0.02, -math.sqrt(1 - 5e-4)])
            omega = n * u
        rows.append([*BODY.values(), *omega, *u, T_END])
    folder = tmp_path_factory.mktemp("tilted")
    names = [*HEAD.split(","), *STATE, "t_end"]
    pd.DataFrame(rows, columns=names).to_csv(folder / "states.csv", index=False)
    config = {"bodies": {"source": "table", "path": str(folder / "states.csv")}}
    return folder / "out", rs.sweep(config, output=folder / "out").runs


STATE = ["omega_x", "omega_y", "omega_z", "u_x", "u_y", "u_z"]


def test_tilted_states_reverse_when_mechanics_says(tilted):
    _, runs = tilted
    assert runs.t_r.notna().sum() >= 3
    for run in runs.iloc[[0, 5]].itertuples():
        y0 = np.array([run.u_x, run.u_y, run.u_z, run.omega_x, run.omega_y, run.omega_z])
        t_r, _ = oracle.first_zero(BODY, y0, T_END, samples=12)
        if t_r is None:
            assert np.isnan(run.t_r)
        else:
            assert run.t_r == pytest.approx(t_r, rel=1e-8)
        assert run.n_i == pytest.approx(oracle.spin(y0), rel=1e-14)


def test_theory_counts_the_energy_of_the_tilt(tilted):
    """To second order in the oscillation, ``E = gamma n_0^2 / 2``."""
    _, runs = tilted
    for run in runs.itertuples():
        y = np.array([run.u_x, run.u_y, run.u_z, run.omega_x, run.omega_y, run.omega_z])
        found = oracle.energy(y, BODY) - oracle.energy(np.array([0, 0, -1.0, 0, 0, 0]), BODY)
        assert 0.5 * BODY["gamma"] * run.n_0**2 == pytest.approx(found, rel=0.03)
    # The last turns about the vertical, so that all of its oscillation is the tilt.
    assert runs.n_0.iloc[-1] > 1.1 * runs.n_i.iloc[-1]
    assert runs.omega_xy0.iloc[-1] < 1e-15
    assert (runs.t_rgh > 0).all()


def test_an_output_table_says_its_launches_itself(tilted, tmp_path: Path):
    directory, runs = tilted
    config = {
        "bodies": {"source": "table", "path": str(directory / "runs")},
        "horizon": {"t": T_END},
    }
    again = rs.sweep(config, output=tmp_path / "again").runs
    pd.testing.assert_frame_equal(again, runs, check_exact=True)


def test_a_sweep_of_states_can_be_had_again(tilted, tmp_path: Path):
    directory, runs = tilted
    assert invoke("verify", directory, "--recompute", "7").exit_code == 0
    assert invoke("classify", directory).exit_code == 0
    assert invoke("status", directory).exit_code == 0
    page = tmp_path / "page.html"
    shown = ["--case", "0", "--sample", "0"]
    assert invoke("show", "--from", directory, *shown, "--output", page).exit_code == 0
    again = rs.replay(directory, 0, 0, channels=["t", "u_x", "omega_z", "n"], points=3)
    first = again.table.iloc[0]
    assert first[["u_x", "omega_z"]].tolist() == pytest.approx(
        runs.loc[0, ["u_x", "omega_z"]].tolist(), rel=1e-15
    )
    assert again.zeros[0] == runs.t_r[0]
    found = invoke("replay", directory, "--where", "u_x > -1 and omega_z < 1", "--points", "2")
    assert found.exit_code == 0, found.stderr


def test_trajectory_takes_a_state(tmp_path: Path):
    u = np.array([0.01, -0.02, -1.0])
    u /= np.linalg.norm(u)
    omega = (0.02, 0.01, -0.3)
    body = rs.Rattleback(**BODY)
    path = rs.trajectory(body, omega=omega, u=u, t_end=60.0, points=3)
    t_r, _ = oracle.first_zero(BODY, np.array([*u, *omega]), 60.0, samples=12)
    assert path.zeros[0] == pytest.approx(t_r, rel=1e-9)
    assert rs.simulate(body, omega=omega, u=u, t_end=60.0).t_r == path.zeros[0]
    words = ["--theta", "0.82", "--omega", "0.02,0.01,-0.3", "--u", ",".join(map(repr, u.tolist()))]
    result = invoke("trajectory", "--preset", "GH", *words, "--t-end", "60", "--points", "3")
    assert result.exit_code == 0
    assert f"at {path.zeros[0]:.10g}" in result.stderr


# ------------------------------------------------------------------------- without spin


def tapped_oracle(omega_xy0: float, psi: float, t_end: float) -> tuple[float, float]:
    """When a tapped body's spin first has a side, and its first zero after that."""
    y0 = oracle.launch(BODY, 0.0, omega_xy0, psi)
    inertia = BODY["alpha"] * math.cos(psi) ** 2 + BODY["beta"] * math.sin(psi) ** 2
    far = PLATEAU_SHARE * omega_xy0 * math.sqrt(inertia / BODY["gamma"])
    path = solve_ivp(oracle.rhs, (0, t_end), y0, args=(BODY,), method="DOP853", rtol=1e-12,
                     atol=1e-15, dense_output=True)  # fmt: skip
    times = np.arange(0.0, t_end, 0.01)
    y = path.sol(times)
    n = np.sum(y[:3] * y[3:], axis=0)
    begin = int(np.argmax(np.abs(n) > far))
    turn = begin + int(np.argmax(n[begin:] * n[begin] <= 0))
    zero = brentq(lambda t: oracle.spin(path.sol(t)), times[turn - 1], times[turn], xtol=1e-13)
    return times[begin], zero


@pytest.mark.parametrize("psi", ["pitch", pytest.param("roll", marks=pytest.mark.slow), 45.0])
def test_a_tapped_body_reverses_once_it_has_spun(psi):
    body = rs.Rattleback(**BODY)
    modes = rs.modes(body)
    angle = {"pitch": modes.psi_p, "roll": modes.psi_r}.get(psi, math.radians(45.0))
    run = rs.simulate(body, n_i=0, omega_xy0=0.4, psi=psi, t_end=T_TAP[psi])
    begin, t_r = tapped_oracle(0.4, angle, T_TAP[psi])
    assert run.type == "R"
    assert run.t_r == pytest.approx(t_r, rel=1e-8)
    assert run.amp_growth is run.n_departure is None
    path = rs.trajectory(body, n_i=0, omega_xy0=0.4, psi=psi, t_end=T_TAP[psi], dt=0.05)
    assert path.zeros[0] == run.t_r
    # It wobbles about zero before it spins, which is no reversal.
    table = path.table
    early = table[(table.t > 0) & (table.t < begin)].n
    assert (np.diff(np.sign(early)) != 0).any() or psi != 45.0


def test_a_tap_is_on_the_end_and_spins_the_body_steadily(tmp_path: Path):
    spin = {"n_i": [0, 0.1], "omega_xy0": 0.3}
    runs = sweep(tmp_path, spin=spin, horizon={"t_rgh": 2, "t": 200})
    tapped = runs[runs.n_i == 0]
    modes = rs.modes(rs.Rattleback(**BODY))
    assert tapped.psi.iloc[1] == modes.psi_p
    assert (tapped.n_0 > 0.2).all()
    assert tapped[["t_rgh", "n_departure", "amp_growth"]].isna().all().all()
    assert (tapped.t_end[tapped.t_r.isna()] == 200).all()
    assert set(tapped.type) <= {"R", "unclassified"}
    assert runs[runs.n_i == 0.1].t_rgh.notna().all()
    summary = rs.load(tmp_path / "out").summary
    assert summary.t_rgh_mean.isna().tolist() == [True, False]
    assert summary.fraction_unclassified[0] == (tapped.type == "unclassified").mean()
    path = rs.trajectory(rs.Rattleback(**BODY), n_i=0, omega_xy0=0.3, t_end=100)
    # Pitch turns the body in the steady direction.
    assert path.table.n.iloc[-1] < -0.2
    assert invoke("verify", tmp_path / "out", "--recompute", "4").exit_code == 0
    assert invoke("replay", tmp_path / "out", "--case", "0", "--sample", "1").exit_code == 0


def test_the_reduced_model_can_be_tapped():
    run = rs.simulate(rs.Rattleback(**BODY), n_i=0, omega_xy0=0.4, t_end=900, model="reduced")
    full = rs.simulate(rs.Rattleback(**BODY), n_i=0, omega_xy0=0.4, t_end=900)
    # Nothing feeds the roll of a tap on the pitch alone, so the spin stays.
    assert run.t_r is None
    assert run.n_end == pytest.approx(-0.4 * math.sqrt(13.04 / 12.28), rel=0.05)
    assert full.t_r is not None


@pytest.mark.parametrize(
    ("config", "words"),
    [
        ("spin: {n_i: [0.1, 0], omega_xy0: 0.1}", "horizon.t: missing; a launch without spin has"),
        ("spin: {n_i: 0, omega_xy0: 0.1}\nhorizon: {t: 9}\nmodel: gh", "c.yaml:4:1: model: gh beg"),
        ("launch: {omega: [0, 0, 1]}", "t_rgh times t_rGH is not a finite time in the only run"),
        ("launch: {omega: [1, 0, 0]}", "horizon.t: missing; a launch without spin has no t_rGH"),
        ("launch: {omega: [0.1, 0, 1]}\nmodel: reduced", "c.yaml:3:1: model: reduced begins with"),
    ],
)  # fmt: skip
def test_launches_that_cannot_be_are_refused(config, words, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("c.yaml").write_text("bodies: {source: preset, name: GH}\n" + config + "\n")
    assert_refused(invoke("run", "c.yaml"), 2, words)
    assert not Path("out").exists()


def test_a_row_without_spin_needs_a_horizon(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    row = "13.04,1.522,12.28,0.82,0.036,-0.03"
    Path("t.csv").write_text(f"{HEAD},n_i,omega_xy0,t_end\n{row},0,0.1,50\n{row},0,0.1,\n")
    Path("c.yaml").write_text("bodies: {source: table, path: t.csv}\n")
    assert_refused(invoke("run", "c.yaml"), 2, "horizon.t: missing; a launch without spin (row 2")
    assert invoke("run", "c.yaml", "--set", "horizon.t=60", "-q").exit_code == 0
    assert rs.load("out/sweep").runs.t_end.tolist() == [50, 60]


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--omega", "1,2"], "--omega 1,2: is no vector; give three numbers, such as 0,0,-1"),
        (["--u", "0,0,-1"], "omega: missing; a full state has omega and u"),
        (["--omega", "0,0,1", "--n-i", "1"], "n_i given with a full state, which says the spin"),
        (
            ["--omega", "0,0,1", "--t-end", "9", "--channels", "t,n_reduced"],
            "has no run beside one",
        ),
        (["--n-i", "0"], "t_end: missing; a launch without spin has no t_rGH"),
    ],
)
def test_commands_refuse_a_launch_in_one_line(words, said):
    assert_refused(invoke("trajectory", "--preset", "GH", *words), 2, said)
