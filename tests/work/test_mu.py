"""Runs with `dissipation.mu`; every way to ask for them is in `test_losses`."""

import json

import numpy as np
import pytest
from click.testing import CliRunner

import rattlesweep as rs
from rattlesweep.cli import main

LAUNCH = {"n_i": 0.3, "omega_xy0": 0.1}
CONFIG = {
    "bodies": {"source": "preset", "name": "GH"},
    "spin": LAUNCH,
    "dissipation": {"mu": [0.2, 0.3, 1e3]},
    "horizon": {"t": 60},
    "record": ["contact", "energy", "reversals", "windows"],
}
# Reversal of GH from an independent program, to its ten digits.
T_R = 41.292205835


@pytest.fixture(scope="module")
def sweep(tmp_path_factory):
    return rs.sweep(CONFIG | {"output": str(tmp_path_factory.mktemp("mu") / "out")})


def test_a_sweep_over_mu(sweep):
    runs = sweep.read()
    assert (runs.status == "ok").all()
    assert runs.turn_times[1][0] == pytest.approx(T_R, rel=1e-8)
    # The plane holds the last one, as if there were no mu.
    rolling = rs.simulate("GH", **LAUNCH, t_end=60, record=["reversals"])
    assert runs.t_r[2] == pytest.approx(rolling.t_r, rel=1e-7)
    assert runs.t_slide.isna().tolist() == [False, False, True]
    assert runs.n_slides[2] == runs.slide_time[2] == runs.slide_work[2] == 0
    assert (runs.n_slides[:2] > 0).all()
    assert runs.slide_work.is_monotonic_decreasing
    np.testing.assert_allclose(runs.energy_left, 1 - runs.slide_work, rtol=1e-15)
    assert abs(runs.energy_drift).max() < 1e-8
    assert runs.contact_ratio_max[1] == pytest.approx(0.3, abs=1e-6)
    # Theory knows no sliding.
    for name in ("n_c1", "t_rgh", "growth"):
        assert runs[name].nunique() == 1
    assert runs.n_c1[0] == pytest.approx(rolling.n_c1)
    assert sweep.summary.mu.tolist() == [0.2, 0.3, 1e3]
    assert sweep.summary.share_slid.tolist() == [1, 1, 0]
    above = sweep.summary[[f"share_friction_above_0_{k}" for k in (1, 2, 3, 5)]]
    assert above.iloc[2].tolist() == [1, 1, 1, 1]
    assert above.iloc[0, [0, 2, 3]].tolist() == [1, 0, 0]


def test_one_run_as_a_time_series(sweep):
    names = ["t", "n", "energy", "work", "v_slip", "slip_angle", "friction_ratio"]
    run = rs.replay(
        sweep.directory, 1, 0, channels=[*names, "sliding", "energy_drift"], steps=True
    )
    table = run.table
    assert run.reversals[0] == pytest.approx(T_R, rel=1e-8)
    assert run.warning == ""
    sliding = table.sliding == 1
    assert (table.v_slip[sliding] > 0).all()
    assert (table.v_slip[~sliding] == 0).all()
    assert table.slip_angle[~sliding].isna().all()
    assert table.friction_ratio[sliding].to_numpy() == pytest.approx(0.3)
    assert table.friction_ratio.max() < 0.3 + 1e-6
    assert abs(table.energy_drift).max() < 1e-8
    stored = sweep.read().iloc[1]
    assert len(run.slides) == stored.n_slides
    assert run.slides[0, 0] == pytest.approx(stored.t_slide, rel=1e-12)
    assert np.diff(run.slides).sum() == pytest.approx(stored.slide_time, rel=1e-9)
    energy = table.energy / table.energy[0]
    assert 1 - energy.iloc[-1] == pytest.approx(stored.slide_work, abs=1e-8)


@pytest.mark.slow
def test_commands(tmp_path):
    launch = ["--preset", "GH", "--n-i", "0.3", "--omega-xy0", "0.1", "--t-end", "60"]
    page = tmp_path / "run.html"
    result = CliRunner().invoke(main, ["show", *launch, "--mu", "0.3", "-o", str(page)])
    assert result.exit_code == 0, result.output
    assert "slides of " in result.output
    assert "of the energy" in result.output
    text = page.read_text()
    data = json.loads(text.partition('id="data">')[2].partition("</script>")[0])
    assert len(data["slides"]) == 11
    assert "11 slides" in dict(data["facts"])["slides"]
    line = ["trajectory", *launch, "--mu", "0.3", "--figure", str(tmp_path / "run.png")]
    assert CliRunner().invoke(main, line).exit_code == 0
