"""`record: [reversals]`: every reversal up to the horizon, as a trajectory counts
them.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from refusal import assert_refused
from sweeping import invoke, proved

import rattlesweep as rs

CONFIG: dict[str, Any] = {
    "bodies": {
        "source": "grid",
        "base": {"preset": "GH"},
        "axes": {"theta": [0.64, 0.8, 0.9]},
    },
    "spin": {"n_i": [0.2, -0.2, 0, 0.5], "omega_xy0": 0.1, "psi": "pitch"},
    "horizon": {"t": 900},
}
NEW = ["n_turns", "turn_times", "spin_after_turn"]


@pytest.fixture(scope="module")
def sweep(tmp_path_factory) -> Path:
    directory = tmp_path_factory.mktemp("reversals") / "out"
    rs.sweep(CONFIG | {"record": ["reversals", "windows"]}, output=directory)
    return directory


def top_of(values: np.ndarray) -> float:
    """Return the maximum of a parabola through the largest of values and neighbours."""
    place = int(values.argmax())
    if place in (0, len(values) - 1):
        return values[place]
    before, top, after = values[place - 1 : place + 2]
    return top + (before - after) ** 2 / (8 * (2 * top - before - after))


# Bodies and launches whose spin is far between two steps of the default tolerance only,
# and the zero that counts, from SciPy's DOP853 with the equations of the oracle.
FAR_BETWEEN_STEPS: dict[str, Any] = {
    "tap": (
        {
            "alpha": 11.868874468384282,
            "beta": 1.6177893190530255,
            "gamma": 11.486663787437308,
            "theta": 0.68349290100372,
            "phi": 0.027815483381647896,
            "xi": -0.030293513616017936,
        },
        {"n_i": 0, "omega_xy0": 0.7563800067435384, "psi": 102.48632167262316},
        2.68009287,
    ),
    "spin": (
        {
            "alpha": 14.413419337048799,
            "beta": 2.2130708799034036,
            "gamma": 14.626490216952202,
            "theta": 0.7016448069548542,
            "phi": 0.06322620981639017,
            "xi": -0.07796111836106463,
        },
        {"n_i": -0.050032290318757805, "omega_xy0": 0.2702831548167209},
        53.15436174,
    ),
}


@pytest.mark.parametrize("tol", [1e-6, 1e-8, 1e-9, 1e-11])
@pytest.mark.parametrize("name", FAR_BETWEEN_STEPS)
def test_a_peak_between_two_steps_counts(name, tol):
    parameters, launch, first = FAR_BETWEEN_STEPS[name]
    body = rs.Rattleback(**parameters)
    at = {"t_end": 80, "tol": tol}
    run = rs.simulate(body, **launch, **at, record=["reversals"])
    path = rs.trajectory(body, **launch, **at)
    close = max(1e-8, 100 * tol)
    if name == "tap":
        assert run.t_r == pytest.approx(first, rel=close)
        assert run.t_r == rs.simulate(body, **launch, **at).t_r
        # It crosses zero once before, which does not count.
        assert path.zeros[1] == run.t_r
        assert path.zeros[0] == pytest.approx(1.11696541, rel=close)
    else:
        assert run.turn_times[0] == pytest.approx(first, rel=close)
        assert run.t_r == pytest.approx(47.78924429, rel=close)
    assert path.reversals[:8].tolist() == list(run.turn_times)


def test_they_are_those_of_the_trajectory(sweep):
    """Every run, bit for bit; the largest spin of all states in between."""
    runs = rs.load(sweep).runs
    assert runs.n_turns.max() > 8
    assert (runs.n_turns == 0).any()
    assert runs.turn_times.map(len).max() == runs.spin_after_turn.map(len).max() == 8
    for run in runs.itertuples():
        path = rs.replay(sweep, int(run.case), int(run.sample), steps=True)
        assert run.n_turns == len(path.reversals)
        assert run.turn_times.tolist() == path.reversals[:8].tolist()
        ends = [*path.reversals, np.inf]
        dense = rs.replay(sweep, int(run.case), int(run.sample), dt=0.01)
        times = dense.table.t.to_numpy()
        size = dense.table.n.abs().to_numpy()
        for k, largest in enumerate(run.spin_after_turn):
            between = (times > ends[k]) & (times < ends[k + 1])
            assert largest == pytest.approx(top_of(size[between]), rel=2e-5)
        if run.n_turns:
            assert run.t_r <= run.turn_times[0]
        assert run.t_end == 900


def test_the_first_one_and_the_type_are_as_without(sweep, tmp_path):
    runs = rs.load(sweep).runs
    plain = rs.sweep(CONFIG, output=tmp_path).runs
    pd.testing.assert_frame_equal(
        runs[["t_r", "type"]], plain[["t_r", "type"]], check_exact=True
    )
    assert not set(NEW) & set(plain)
    # What does not reverse is the same to the last bit.
    still = plain.t_r.isna()
    assert still.any()
    pd.testing.assert_frame_equal(
        runs[plain.columns][still], plain[still], check_exact=True
    )


def test_commands_know_the_columns(sweep):
    proved(sweep, recompute=12)
    lists = invoke("replay", sweep, "--where", "spin_after_turn > 8", "--points", "2")
    assert_refused(lists, 2, "spin_after_turn")


def test_failed_runs_have_no_count_and_keep_their_first_zero(tmp_path):
    config = CONFIG | {"record": ["reversals"], "integrator": {"max_steps": 500}}
    runs = rs.sweep(config, output=tmp_path).runs
    failed = runs.status != "ok"
    assert failed.any()
    assert runs[[*NEW, "type"]][failed].isna().all(axis=None)
    assert (runs.t_r <= runs.t_end)[failed & runs.t_r.notna()].all()


def test_turns_are_sure_as_far_as_a_looser_integration_confirms_them(sweep, tmp_path):
    """The second turn of this body comes at another time at every tolerance."""
    config = {
        "bodies": {
            "source": "grid",
            "base": {"preset": "GH"},
            "axes": {"xi_deg": [-1.96304065]},
        },
        "spin": {"n_i": -0.2, "omega_xy0": 0.01},
        "dissipation": {"sigma": 0.003},
        "horizon": {"t_decay": 5},
        "record": ["reversals", "error"],
    }
    (run,) = rs.sweep(config, output=tmp_path / "one").runs.itertuples()
    assert run.n_turns > run.reversals_sure == 1
    assert run.reversal_times_error[0] == run.t_r_error < 1e-6
    assert (run.reversal_times_error[1:] > 1e-3 * run.turn_times[1:]).all()
    # What is recorded without errors stays as it is, and tighter turns lie within their
    # errors.
    both = {"record": ["reversals", "windows", "error"]}
    runs = rs.sweep(CONFIG | both, output=tmp_path / "many").runs
    plain = rs.load(sweep).runs
    pd.testing.assert_frame_equal(runs[list(plain)], plain, check_exact=True)
    tight = CONFIG | {"record": ["reversals"], "integrator": {"tol": 1e-12}}
    better = rs.sweep(tight, output=tmp_path / "tight").runs
    for one, true in zip(runs.itertuples(), better.turn_times, strict=True):
        k = int(one.reversals_sure)
        assert (
            np.abs(one.turn_times[:k] - true[:k]) <= one.reversal_times_error[:k]
        ).all()
