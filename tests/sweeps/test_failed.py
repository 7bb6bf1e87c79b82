"""What is known of a run that fails behind its first reversal."""

import pytest

import rattlesweep as rs
from rattlesweep.sweeps.verify import verify

CONFIG = {
    "bodies": {"source": "sd", "samples": 8, "surface": "ellipsoid", "c": 2.0},
    "spin": {"n_i": 0.5, "omega_xy0": 0.1},
    "horizon": {"t": 600},
}


def test_t_r_is_kept_and_the_type_is_not(tmp_path):
    """These ellipsoids roll onto their sides sooner or later, where their variables end."""
    plain = rs.sweep(CONFIG, output=tmp_path / "plain").runs
    sweep = rs.sweep(CONFIG | {"record": ["reversals"]}, output=tmp_path / "turns")
    runs = sweep.runs
    late = (runs.status != "ok") & (plain.type == "R")
    assert late.sum() >= 3
    assert (runs[late].t_r == plain[late].t_r).all()
    assert runs[late][["type", "n_turns"]].isna().all(axis=None)
    # No share and no mean counts them.
    assert sweep.summary.failed[0] == (runs.status != "ok").sum()
    kept = runs[runs.type == "R"].t_r
    assert sweep.summary.t_r_mean[0] == pytest.approx(kept.mean(), rel=1e-12)
    assert not list(verify(sweep.directory).problems)
