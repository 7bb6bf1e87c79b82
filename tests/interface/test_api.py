"""The Python interface that the contract names: runs, one or many, theory, and bad
arguments.
"""

import doctest
import shutil
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

import rattlesweep as rs
from rattlesweep import api
from rattlesweep.api import contact, single, sweeps, verdicts
from rattlesweep.physics import body as bodies_module
from rattlesweep.physics.body import PARAMETERS

GH = rs.Rattleback.gh()
BODIES = [
    GH,
    GH.mirrored(),
    rs.Rattleback.shell_dumbbell(gamma=10, f_sd=0.1, theta=0.8, phi=0.05, xi=-0.05),
]
FRAME = pd.DataFrame([vars(body) for body in BODIES], ["gh", "mirror", "sd"])[
    list(PARAMETERS)
]
LAUNCH: dict[str, Any] = {"n_i": 0.1, "omega_xy0": 0.01}


def test_the_examples_in_the_package_are_true(tmp_path, monkeypatch):
    shutil.copytree(Path(__file__).parents[2] / "configs", tmp_path / "configs")
    monkeypatch.chdir(tmp_path)
    rs.sweep("configs/gh.yaml", threads=1)
    for module in (rs, bodies_module, api, contact, single, sweeps, verdicts):
        failed, tried = doctest.testmod(module, extraglobs={"rs": rs})
        assert failed == 0 < tried


def test_every_name_is_there():
    contract = {
        "Rattleback",
        "modes",
        "reversal_time_gh",
        "bondi_threshold",
        "growth_rates",
        "contact_patch",
        "simulate",
        "trajectory",
        "sweep",
        "load",
        "replay",
        "show",
        "fit",
        "ConfigError",
        "OutputError",
    }
    assert contract <= set(dir(rs)) == set(rs.__all__) == {*api.__all__, "__version__"}


def test_simulate_one_run():
    run = rs.simulate(GH, **LAUNCH, record=["energy", "error"])
    assert run.t_r == run["t_r"] == pytest.approx(112.0939, rel=1e-6)
    assert (run.type, run.status, run.t_end) == ("R", "ok", run.t_r)
    assert abs(run.energy_drift) < 1e-9
    assert run.t_r_error < 1e-5
    assert (run.K_r, run.units["t_r"]) == (rs.modes(GH).K_r, "sqrt(a/g)")
    assert {"theta", "t_r", "energy_drift_max"} <= set(run.to_dict()) <= set(dir(run))
    assert rs.simulate("GH", **LAUNCH, record=["energy", "error"]) == run
    # A spin that is opposite only by rounding has not reversed.
    assert rs.simulate(GH, omega=(1e-3, 0, 0), u=(1e-17, 0, -1), t_end=50.0).t_r is None
    steady = rs.simulate(GH, n_i=-0.1, omega_xy0=0.01, t_end=100.0)
    assert (steady.t_r, steady.t_end) == (None, 100.0)
    assert steady.type in ("SS", "SW", "unclassified")


def test_a_table_of_runs_has_the_bits_of_single_runs():
    n_i = np.array([0.3, -0.2])
    omega = np.array([0.02, 0.1, 0.3])
    launches = {"n_i": n_i[:, None, None], "omega_xy0": omega[:, None], "t_end": 60.0}
    runs = rs.simulate(BODIES, **launches)
    assert (runs.attrs["shape"], len(runs)) == ((2, 3, 3), 18)
    for place, (i, j, k) in enumerate(np.ndindex(2, 3, 3)):
        row = runs.iloc[place]
        assert (row.n_i, row.omega_xy0, row.theta) == (
            n_i[i],
            omega[j],
            BODIES[k].theta,
        )
        one = rs.simulate(BODIES[k], n_i=n_i[i], omega_xy0=omega[j], t_end=60.0)
        for name, value in one.to_dict().items():
            assert row[name] == value or (pd.isna(row[name]) and value is None), (
                place,
                name,
            )
    pd.testing.assert_frame_equal(rs.simulate(BODIES, **launches, threads=2), runs)
    assert (runs.attrs["units"]["t_end"], runs.attrs["units"]["xi"]) == (
        "sqrt(a/g)",
        "rad",
    )
    assert "unsteady" in runs.attrs["descriptions"]["n_i"]
    none = rs.simulate(GH, n_i=[], omega_xy0=0.1)
    assert (list(none), len(none), none.attrs["shape"]) == (list(runs), 0, (0,))


def test_tables_of_bodies():
    runs = rs.simulate(FRAME, n_i=0.2, omega_xy0=0.1, t_end=30)
    assert list(runs.index) == ["gh", "mirror", "sd"]
    for bodies in (BODIES, FRAME.to_dict("list")):
        same = rs.simulate(bodies, n_i=0.2, omega_xy0=0.1, t_end=30)
        pd.testing.assert_frame_equal(same, runs.reset_index(drop=True))
    # Runs are a table of bodies with their launches; horizons of those that reversed
    # are unknown.
    again = rs.simulate(runs)
    still = runs.t_r.isna()
    pd.testing.assert_frame_equal(again[still], runs[still])
    assert np.array_equal(again.t_r[~still], runs.t_r[~still])
    # Other launches are not along the old directions, nor do they end with the old
    # runs.
    other = rs.simulate(runs, n_i=-0.2, omega_xy0=0.1)
    assert np.array_equal(other.psi, rs.simulate(BODIES, n_i=-0.2, omega_xy0=0.1).psi)
    assert (other.t_end > 30).any()
    assert np.array_equal(rs.simulate(runs, psi="pitch").psi, rs.modes(FRAME).psi_p)


def test_texts_with_units():
    second = rs.Rattleback.kl().units.time
    runs = rs.simulate(
        "KL", n_i=["-60 rpm", "0.2 sqrt(g/a)"], omega_xy0="5 rpm", t_end="2 s"
    )
    assert runs.n_i.tolist() == pytest.approx([-2 * np.pi * second, 0.2])
    assert runs.t_end.tolist() == pytest.approx([2 / second] * 2)


def title_of(body, **launch):
    return rs.trajectory(body, **launch).plot().get_suptitle()


def test_a_trajectory_is_used_like_a_table(tmp_path):
    path = rs.trajectory("GH", **LAUNCH, t_end=150, channels=["t", "n", "E_p"])
    assert path["n"].equals(path.table.n)
    figure = path.plot(tmp_path / "path.svg")
    assert len(figure.axes) == 2
    assert (tmp_path / "path.svg").read_text().startswith("<?xml")
    assert "&lt;Trajectory of t, n, E_p: 1 reversal" in path._repr_html_()
    looks = {"from_time": 140, "points": 30}
    shown = path.show(title="Rattleback GH", **looks)
    assert shown == rs.show("GH", **LAUNCH, t_end=150, **looks)
    lossy = {
        "n_i": "60 rpm",
        "omega_xy0": "6 rpm",
        "sigma": "1e-6 N m s",
        "t_end": "1 s",
    }
    assert "n_i 60 rpm, ω_xy0 6 rpm, σ 1e−06 N m s" in title_of("KL", **lossy)
    reduced = title_of("GH", **LAUNCH, model="reduced", e_p0=1e-6, e_r0=2e-7, t_end=9)
    assert reduced.endswith("n_i 0.1 √(g/a), E_p0 1e−06, E_r0 2e−07")
    page = rs.show("GH", **LAUNCH, t_end=20, from_time=4, title="Mine & yours")
    assert page._repr_html_().startswith('<iframe sandbox="allow-scripts"')
    assert "Mine &amp;amp; yours" in page._repr_html_()
    saved = page.save(tmp_path / "roll.html")
    assert saved.path.read_bytes() == page.content
    assert b'"start": 4.0' in page.content


def test_theory_takes_arrays():
    array = np.array(BODIES, dtype=object)[:, None]
    for bodies, shape in ((BODIES, (3,)), (FRAME, (3,)), (array, (3, 1))):
        for name, values in vars(rs.modes(bodies)).items():
            assert values.shape == shape
            assert values.ravel().tolist() == [
                getattr(rs.modes(body), name) for body in BODIES
            ]
        assert rs.bondi_threshold(bodies).shape == shape
    n_i = np.array([0.1, -0.1, 0.3, -2.0])
    times = rs.reversal_time_gh(array, n_i, 0.01)
    rates = rs.growth_rates(array, n_i)
    for (k, i), time in np.ndenumerate(times):
        assert time == rs.reversal_time_gh(BODIES[k], n_i[i], 0.01)
        assert rates.pitch[k, i] == n_i[i] * rs.modes(BODIES[k]).K_p / 2
        assert rates.roll[k, i] == -n_i[i] * rs.modes(BODIES[k]).K_r / 2


BAD: list[tuple[Any, str]] = [
    (lambda: GH.replace(theta="0.6"), r"theta: 0.6 \(str\) is not a number"),
    (lambda: rs.trajectory(3, **LAUNCH), r"body: 3 \(int\) is not a body"),
    (
        lambda: rs.trajectory("GH", n_i=[0.1], omega_xy0=1),
        r"n_i: one number .* of shape \(1,\)",
    ),
    (
        lambda: rs.trajectory("GH", points=2.5, **LAUNCH),
        r"points: 2.5 .*; a whole number of at least 2 is needed",
    ),
    (
        lambda: rs.trajectory("GH", **LAUNCH, tend=1),
        'arguments: "tend" .* did you mean "t_end"',
    ),
    (
        lambda: rs.trajectory("GH", **LAUNCH, t_end=1).plot("a.gif"),
        "path a.gif: the name must end",
    ),
    (
        lambda: rs.reversal_time_gh(GH, [0.1, 0], 0.1),
        "n_i: a launch without spin, n_i = 0, has",
    ),
    (lambda: rs.sweep(3), "give a dict"),
    (
        lambda: rs.fit("GH", {"t": [0], "n": [1]}, free=3, launch=LAUNCH),
        "free: 3 .* not a name",
    ),
    (
        lambda: rs.growth_rates("GH", [0.1, 0.2], pivot=1e-3, viscous=[0, 9.0]),
        "^viscous: pivoting is that of a foot that",
    ),
    (lambda: rs.replay("x", 1.5, 0), r"case: 1.5 .*; a whole number of at least 0"),
]


STATE: dict[str, Any] = {"n_i": None, "omega_xy0": None, "omega": (0, 0, 1)}
BAD_RUNS: list[tuple[dict[str, Any], str]] = [
    ({"n_i": [0.1, 0], "t_end": None}, "without spin .* has no t_rGH"),
    ({"omega": (0, 0, 1)}, "n_i and omega_xy0 given with a full state"),
    (STATE | {"omega": (0, 0, 0)}, "^launch: the body stands upright and at rest;"),
    (STATE | {"u": (0, 0.5, -1)}, "^launch: u must be a vector of length 1"),
    (STATE | {"omega": [(0, 0, 1), (0, 0, 0)]}, "^launch: row 2: the body stands"),
    ({"viscous": 99.0, "pivot": 1e-3}, "^viscous: pivoting is that of a foot that"),
    ({"viscous": 99.0, "method": "rk4"}, "^method: rk4 .* or leave viscous out"),
    ({"n_i": "60 rpm"}, "n_i: 60 rpm has a unit, but the body has no size"),
    ({"n_i": True}, r"n_i: True \(bool\) is not a number"),
    (
        {"n_i": [[1], [1, 2]]},
        r"n_i: \[\[1\], \[1, 2\]\] \(list\) is not a number or an array",
    ),
    ({"n_i": "60"}, r"n_i: '60' \(str\) has no unit; a spin is needed, such as 60 rpm"),
    ({"methd": "rk4"}, 'arguments: "methd" is not one of .* did you mean "method"'),
    ({"record": 3}, r"record: 3 \(int\) is not a name or a list of names"),
    ({"n_i": ["60 rpm", "1"]}, r"n_i: '1' \(str\) has no unit"),
    ({"n_i": [1, 2], "omega_xy0": [1] * 3}, r"n_i \(2,\), omega_xy0 \(3,\)"),
    ({"omega_xy0": None}, "omega_xy0 missing; give both, or omega"),
    ({"psi": "yaw"}, '"yaw" is not one of relevant, pitch, roll'),
    ({"method": "rk4", "tol": 1e-9}, "tol: rk4 takes dt alone"),
    ({"body": [GH, "HG"]}, r"bodies\[1\]: 'HG' \(str\) is not a body"),
    ({"body": FRAME.assign(psi=0, psi_deg=0)}, "psi and psi_deg are one quantity"),
    ({"body": FRAME.drop(columns="phi")}, "bodies: the column phi is missing"),
    ({"body": FRAME.assign(theta=[0.7, 2, 0.7])}, "bodies: row 2: theta is 2"),
]
BAD_TRAJECTORIES: list[tuple[dict[str, Any], str]] = [
    ({"channels": ["t", "omga_x"]}, "did you mean .omega_x"),
    (
        {"channels": ["u_x"], "model": "reduced"},
        "of the model reduced: .u_x. is not one of",
    ),
    ({"points": 5, "dt": 0.1}, "more than one is given"),
    ({"dt": np.nan}, "must be finite"),
    ({"dt": 1e-9}, "more than 100,000,000 rows"),
    ({"times": [0, 2, 1]}, "must be a list of increasing"),
    ({"model": "gh"}, "gh has no trajectory"),
    ({"e_r0": -1.0, "model": "reduced"}, "from 0 to"),
]
BAD += [
    (partial(rs.trajectory, GH, **(LAUNCH | {"t_end": 10.0} | wrong)), words)
    for wrong, words in BAD_TRAJECTORIES
]


@pytest.mark.parametrize(
    ("wrong", "words"), BAD + BAD_RUNS, ids=lambda case: str(case)[:20]
)
def test_bad_arguments_get_a_sentence(wrong, words):
    good = {"body": GH, "n_i": 0.1, "omega_xy0": 0.1, "t_end": 1.0}
    with pytest.raises(ValueError, match=words) as told:
        wrong() if callable(wrong) else rs.simulate(**{**good, **wrong})
    assert "\n" not in str(told.value)
