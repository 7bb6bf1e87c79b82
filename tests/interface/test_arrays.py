"""The Python interface takes arrays: one call for many runs, with the bits of single ones."""

import math
from typing import Any

import numpy as np
import pandas as pd
import pytest

import rattlesweep as rs
from rattlesweep.physics import theory
from rattlesweep.physics.body import PARAMETERS

GH = rs.Rattleback.gh()
BODIES = [
    GH,
    GH.mirrored(),
    rs.Rattleback.shell_dumbbell(gamma=10, f_sd=0.1, theta=0.8, phi=0.05, xi=-0.05),
]
FRAME = pd.DataFrame([vars(body) for body in BODIES], ["gh", "mirror", "sd"])[list(PARAMETERS)]


def row_of(run: rs.Run) -> dict[str, Any]:
    return {name: np.nan if value is None else value for name, value in run.to_dict().items()}


def test_a_table_of_runs_has_the_bits_of_single_runs():
    n_i, omega = np.array([0.3, -0.2]), np.array([0.02, 0.1, 0.3])
    runs = rs.simulate(BODIES, n_i=n_i[:, None, None], omega_xy0=omega[:, None], t_end=60.0)
    assert runs.attrs["shape"] == (2, 3, 3)
    assert len(runs) == 18
    places = list(np.ndindex(2, 3, 3))
    for place, (i, j, k) in enumerate(places):
        row = runs.iloc[place]
        assert (row.n_i, row.omega_xy0, row.theta) == (n_i[i], omega[j], BODIES[k].theta)
        one = rs.simulate(BODIES[k], n_i=n_i[i], omega_xy0=omega[j], t_end=60.0)
        for name, value in row_of(one).items():
            assert row[name] == value or (pd.isna(row[name]) and pd.isna(value)), (place, name)
    # By any number of threads.
    again = rs.simulate(
        BODIES, n_i=n_i[:, None, None], omega_xy0=omega[:, None], t_end=60.0, threads=2
    )
    pd.testing.assert_frame_equal(again, runs)


def test_tables_of_bodies():
    runs = rs.simulate(FRAME, n_i=0.2, omega_xy0=0.1, t_end=30)
    assert list(runs.index) == ["gh", "mirror", "sd"]
    pd.testing.assert_frame_equal(
        runs.reset_index(drop=True), rs.simulate(BODIES, n_i=0.2, omega_xy0=0.1, t_end=30)
    )
    same = rs.simulate(FRAME.to_dict("list"), n_i=0.2, omega_xy0=0.1, t_end=30)
    pd.testing.assert_frame_equal(same, runs.reset_index(drop=True))
    # Runs are a table of bodies with their launches; horizons of those that reversed are unknown.
    assert runs.t_r.isna().any()
    again = rs.simulate(runs)
    still = runs.t_r.isna()
    pd.testing.assert_frame_equal(again[still], runs[still])
    assert np.array_equal(again.t_r[~still], runs.t_r[~still])
    # Other launches are not along the old directions, nor do they end with the old runs.
    other = rs.simulate(runs, n_i=-0.2, omega_xy0=0.1)
    assert np.array_equal(other.psi, rs.simulate(BODIES, n_i=-0.2, omega_xy0=0.1).psi)
    assert (other.t_end > 30).any()
    turned = rs.simulate(runs, psi=[10, 20, 30])
    assert np.array_equal(turned.psi, np.radians([10, 20, 30]))
    assert np.array_equal(rs.simulate(runs, psi="pitch").psi, rs.modes(FRAME).psi_p)


def test_units_are_attached_and_nothing_is_a_table_too():
    runs = rs.simulate([GH], n_i=0.2, omega_xy0=0.1, t_end=1)
    assert runs.attrs["units"]["t_end"] == "sqrt(a/g)"
    assert runs.attrs["units"]["xi"] == "rad"
    assert "unsteady" in runs.attrs["descriptions"]["n_i"]
    assert set(runs.attrs["units"]) == set(runs)
    assert set(runs) & {"case", "sample"} == set()
    none = rs.simulate(GH, n_i=[], omega_xy0=0.1)
    assert list(none) == list(runs)
    assert len(none) == 0
    assert none.attrs["shape"] == (0,)
    closed = rs.simulate(GH, n_i=[0.1], omega_xy0=0.01, model="gh")
    assert closed.t_r[0] == pytest.approx(rs.reversal_time_gh(GH, 0.1, 0.01), rel=1e-14)


def test_a_bar_is_shown_if_it_is_asked_for(capfd):
    rs.simulate(GH, n_i=[0.1, 0.2], omega_xy0=0.01, t_end=1)
    assert capfd.readouterr().err == ""
    from rattlesweep import progress

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(progress, "DELAY", 0.0)
        rs.simulate(GH, n_i=[0.1, 0.2], omega_xy0=0.01, t_end=1, progress=True)
    assert "100%" in capfd.readouterr().err


BAD: dict[str, tuple[dict[str, Any], str]] = {
    "no horizon": ({"n_i": [0.1, 0], "t_end": None}, r"without spin \(2 of 2\) has"),
    "spin and state": ({"omega": (0, 0, 1)}, "n_i and omega_xy0 given with a full state"),
    "plane": ({"n_i": None, "omega_xy0": None, "omega": [0, 1]}, r"its shape is \(2,\)"),
    "no number": ({"n_i": [[0.1, None]]}, r"n_i\[0, 1\] nan: the initial spin"),
    "word": ({"n_i": "fast"}, r"n_i: 'fast' \(str\) is no number or array of numbers"),
    "flag": ({"n_i": True}, r"n_i: True \(bool\) is no number"),
    "oscillation": ({"omega_xy0": [0.1, -1]}, r"omega_xy0\[1\] -1: the oscillation must be finite"),
    "too fast": ({"n_i": 1e7}, r"n_i 1e\+07: from -1000 to 1000 sqrt"),
    "horizon": ({"t_end": [1, np.inf]}, r"t_end\[1\] inf: the horizon must be finite and positive"),
    "shapes": (
        {"n_i": [0.1, 0.2], "omega_xy0": [0.1] * 3},
        r"shapes do not go together: bodies \(\), n_i \(2,\), omega_xy0 \(3,\)",
    ),
    "no oscillation": ({"omega_xy0": None}, "omega_xy0 missing; give n_i and omega_xy0"),
    "angle": ({"psi": [0, 400]}, r"psi\[1\] 400: an angle from -360 to 360 degrees is needed"),
    "direction": ({"psi": "yaw"}, '"yaw" is not one of relevant, pitch, roll'),
    "past": ({"t_end": -1}, "t_end -1: the horizon must be finite and positive"),
    "model": ({"model": "gh "}, '"gh " is not one of full, reduced, gh'),
    "method": ({"method": "euler"}, '"euler" is not one of dop853'),
    "tolerance": ({"tol": 1.0}, "integrator.tol: 1.0 is out of range; it must be at most 0.01"),
    "threads": ({"threads": 0}, r"threads: 0 \(int\) is no count; give a whole number from 1 on"),
    "body": ({"body": 3}, r"bodies: 3 \(int\) is no body; give a Rattleback, a sequence"),
    "one of them": ({"body": [GH, "HG"]}, r"bodies\[1\]: 'HG' \(str\) is no body"),
    "column": ({"body": FRAME.drop(columns="phi")}, "bodies: the column phi is missing"),
    "columns": ({"body": FRAME.iloc[:, [0, 0, *range(1, 6)]]}, "Duplicate column names found"),
    "value": ({"body": FRAME.assign(theta=[0.7, 2, 0.7])}, "bodies: row 2: theta is 2; 0 < phi"),
    "empty": ({"body": FRAME.assign(xi=[-0.1, np.nan, -0.1])}, "row 2: xi is empty; a finite"),
    "kind": ({"body": FRAME.assign(phi=True)}, "row 1: phi is .True.; a finite number"),
    "ragged": ({"body": {"alpha": [1, 2], "beta": [1]}}, "bodies: cannot be read as a table"),
}


@pytest.mark.parametrize("given", BAD)
def test_bad_arguments_get_a_sentence(given):
    wrong, words = BAD[given]
    arguments: dict[str, Any] = {"body": GH, "n_i": 0.1, "omega_xy0": 0.1, "t_end": 1.0, **wrong}
    with pytest.raises(rs.ConfigError, match=words) as told:
        rs.simulate(arguments.pop("body"), **arguments)
    assert len(told.value.messages) == 1


def test_theory_takes_arrays():
    array = np.array(BODIES, dtype=object)[:, None]
    for bodies, shape in ((BODIES, (3,)), (FRAME, (3,)), (array, (3, 1))):
        found = rs.modes(bodies)
        for name, values in vars(found).items():
            alone = [getattr(rs.modes(body), name) for body in BODIES]
            assert values.shape == shape
            assert values.ravel().tolist() == alone
        assert rs.bondi_threshold(bodies).shape == shape
    assert all(type(value) is float for value in vars(rs.modes(GH)).values())
    assert type(rs.reversal_time_gh(GH, -0.1, 0.01)) is float
    n_i = np.array([0.1, -0.1, 0.3, -2.0])
    times = rs.reversal_time_gh(array, n_i, 0.01)
    rates, exact = rs.growth_rates(array, n_i), rs.growth_rates(array, n_i, exact=True)
    for (k, i), time in np.ndenumerate(times):
        body, n = BODIES[k], float(n_i[i])
        assert time == rs.reversal_time_gh(body, n, 0.01)
        assert rates.pitch[k, i] == n * rs.modes(body).K_p / 2
        assert rates.roll[k, i] == -n * rs.modes(body).K_r / 2
        one = rs.growth_rates(body, n, exact=True)
        assert type(one.pitch) is float
        assert (exact.pitch[k, i], exact.roll[k, i]) == pytest.approx(one, rel=1e-9)


def test_bondi_threshold_is_where_the_roll_stops_growing():
    for body in BODIES[:2]:
        edge = rs.bondi_threshold(body)
        assert type(edge) is float
        assert np.sign(edge) == np.sign(body.xi)
        inside, outside = rs.growth_rates(body, [0.999 * edge, 1.001 * edge], exact=True).roll
        assert inside > 0 > outside
    parameters = {name: getattr(GH, name) for name in PARAMETERS if name != "xi"}
    assert rs.bondi_threshold(GH) == theory.bondi_threshold(**parameters)
    # At a small spin the exact rates are the paper's.
    small, exact = rs.growth_rates(GH, 1e-3), rs.growth_rates(GH, 1e-3, exact=True)
    assert small == pytest.approx(exact, rel=1e-2)
    # Every spin of a nearly spherical body is unstable.
    assert math.isnan(rs.bondi_threshold(rs.Rattleback(4, 2, 3, 0.2, 0.1, -0.1)))


@pytest.mark.parametrize(
    ("call", "words"),
    [(lambda: rs.modes("HG"), r"bodies: 'HG' \(str\) is no body"),
     (lambda: rs.growth_rates(GH, math.inf), "n inf: it must be finite"),
     (lambda: rs.growth_rates([GH, GH], [1, 2, 3]), r"bodies \(2,\), n \(3,\)"),
     (lambda: rs.reversal_time_gh(GH, [0.1, 0], 0.1), "n_i: a launch without spin, n_i = 0, has"),
     (lambda: rs.reversal_time_gh(GH, math.inf, 0.01), "n_i inf: the initial spin must be finite"),
     (lambda: rs.reversal_time_gh(GH, 0.1, 0.0), "omega_xy0 0: the oscillation must be finite and"),
     (lambda: rs.reversal_time_gh(GH, 0.1, math.nan), "omega_xy0 nan: the oscillation must be fin"),
     (lambda: rs.bondi_threshold({"theta": [0.7]}), "the column alpha is missing")],
)  # fmt: skip
def test_theory_refuses(call, words):
    with pytest.raises(rs.ConfigError, match=words):
        call()
