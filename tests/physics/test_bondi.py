"""A run with small oscillations is SS exactly if its spin exceeds Bondi's threshold."""

import pytest

import rattlesweep as rs


# Bodies with skew angles near zero have horizons of up to a million units of time.
@pytest.mark.parametrize(
    ("bodies", "runs"),
    [({"samples": 100, "target": {"K_r": [0.01, 0.03, 0.1]}}, 900)]
    + [
        pytest.param(*case, marks=pytest.mark.slow)
        for case in (
            ({"samples": 560, "target": {"K_r": [0.01, 0.03, 0.1]}}, 5040),
            ({"samples": 400}, 1200),
        )
    ],
    ids=str,
)
def test_every_run_of_small_oscillations_agrees_with_the_threshold(
    bodies, runs, tmp_path
):
    config = {
        "seed": 2017,
        "bodies": {"source": "sd", **bodies},
        "spin": {"n_i": [-0.3, -0.4, -0.5], "omega_xy0": 0.001},
        "horizon": {"t_rgh": 5},
    }
    done = rs.sweep(config, output=tmp_path / "out")
    decided = done.runs
    assert len(decided) == runs
    assert (decided.status == "ok").all()
    assert (decided.type == "SS").sum() > runs / 60
    threshold = decided.n_c1.abs() < decided.n_i.abs()  # false if there is no threshold
    differ = decided[(decided.type == "SS") != threshold]
    assert differ.empty, differ[["case", "sample", "n_i", "n_c1", "type"]].to_string()
    if "target" in bodies:
        assert (done.summary.fraction_SS == done.summary.fraction_bondi).all()
