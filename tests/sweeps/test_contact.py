"""Shares of runs that no table could make roll: too little friction, and lift-off."""

import pytest

import rattlesweep as rs
from rattlesweep.sweeps.stored import open_stored
from rattlesweep.sweeps.summary import closing_table, summarise
from rattlesweep.sweeps.verify import verify

CONFIG = {
    "bodies": {"source": "sd", "samples": 12},
    "spin": {"n_i": [0.2, 1.0], "omega_xy0": [0.01, 0.5]},
    "horizon": {"t": 60},
}
SHARES = ["share_friction_above_0_3", "share_friction_above_0_6", "share_lift_off"]
HEADINGS = ["friction > 0.3", "friction > 0.6", "lift-off"]


def test_shares_are_those_of_the_rows(tmp_path):
    sweep = rs.sweep(CONFIG | {"record": ["contact"]}, output=tmp_path)
    runs = sweep.runs[sweep.runs.status == "ok"]
    ratio, normal = (runs[f"contact_{name}"] for name in ("ratio_max", "normal_min"))
    shares = sweep.summary.set_index("case")[SHARES]
    for name, true in zip(SHARES, (ratio > 0.3, ratio > 0.6, normal < 0), strict=True):
        assert shares[name].tolist() == pytest.approx(true.groupby(runs.case).mean().tolist())
        assert shares[name].nunique() > 1
    head = closing_table(summarise(open_stored(tmp_path))).splitlines()[0]
    assert all(heading in head for heading in HEADINGS)
    assert not list(verify(tmp_path).problems)
