"""The Python interface that the contract names."""

import doctest
import shutil
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow as pa
import pytest

import rattlesweep as rs
from rattlesweep.api import closed, single, stored, sweeps
from rattlesweep.errors import ConfigError, ConfigWarning
from rattlesweep.analysis.report import make_report
from rattlesweep.sweeps.old.verify import verify
from rattlesweep.sweeps.old.store import Store

GH = rs.Rattleback.gh()
CONFIG = {
    "bodies": {"source": "sd", "samples": 5, "target": {"K_r": [0.03, 0.1], "rel_tol": 0.1}},
    "spin": {"n_i": [-0.3], "omega_xy0": 0.01},
    "horizon": {"t": 50},
}


def test_the_examples_in_the_package_are_true(tmp_path, monkeypatch):
    root = Path(__file__).parents[2]
    shutil.copytree(root / "configs", tmp_path / "configs")
    monkeypatch.chdir(tmp_path)
    rs.sweep("configs/gh.yaml", threads=1)
    silent = []
    for module in (closed, single, stored, sweeps):
        result = doctest.testmod(module)
        assert result.failed == 0
        for item in vars(module).values():
            if getattr(item, "__module__", "") == module.__name__:
                inside = (
                    [getattr(item, n) for n in vars(item)] if isinstance(item, type) else [item]
                )
                public = (m for m in inside if callable(m) and not m.__name__.startswith("_"))
                silent += [m.__qualname__ for m in public if ">>>" not in (m.__doc__ or "")]
    assert silent == []
    assert doctest.testmod(rs) == (0, 3)


def test_every_name_is_there():
    assert all(getattr(rs, name) is not None for name in rs.__all__)
    contract = {"Rattleback", "modes", "reversal_time_gh", "bondi_threshold", "growth_rates",
                "simulate", "trajectory", "sweep", "load", "replay", "ConfigError",
                "OutputError"}  # fmt: skip
    assert contract <= set(rs.__all__)
    with pytest.raises(AttributeError, match="no attribute 'nonsense'"):
        _ = rs.nonsense
    assert rs.__version__.count(".") == 2


def test_simulate_one_run():
    run = rs.simulate(GH, n_i=0.1, omega_xy0=0.01)
    assert run.t_r == pytest.approx(112.0939, rel=1e-6)
    assert (run.type, run.status, run.t_end) == ("R", "ok", run.t_r)
    assert abs(run.energy_drift) < 1e-9
    assert run.n_steps > 100
    steady = rs.simulate(GH, n_i=-0.1, omega_xy0=0.01, t_end=100.0)
    assert (steady.t_r, steady.t_end) == (None, 100.0)
    assert steady.type in ("SS", "SW", "unclassified")
    assert rs.simulate(GH, n_i=-0.1, omega_xy0=0.01).t_r == pytest.approx(809.857, rel=1e-6)
    assert rs.simulate(GH, n_i=0.1, omega_xy0=0.01, psi=np.degrees(rs.modes(GH).psi_p)).t_r == (
        pytest.approx(run.t_r, rel=1e-9)
    )
    # The mirror image.
    other = rs.simulate(GH.mirrored(), n_i=-0.1, omega_xy0=0.01)
    assert other.t_r == pytest.approx(run.t_r, rel=1e-9)
    assert other.n_end == pytest.approx(-run.n_end, abs=1e-9)


@pytest.mark.slow  # compiles their kernels
def test_simulate_takes_models_and_methods():
    reduced = rs.simulate(GH, n_i=0.1, omega_xy0=0.01, model="reduced", tol=1e-11)
    assert reduced.t_r == pytest.approx(rs.reversal_time_gh(GH, 0.1, 0.01), rel=1e-8)
    paper = rs.simulate(GH, n_i=0.1, omega_xy0=0.01, method="rk4", dt_step=0.002)
    assert paper.t_r == pytest.approx(112.0939, rel=1e-6)
    failed = rs.simulate(GH, n_i=0.1, omega_xy0=0.01, method="rk4", dt_step=3.0)
    assert failed.type is None
    assert failed.status in ("nonfinite", "energy")
    launch = {"n_i": 0.1, "omega_xy0": 0.01, "t_end": 1.0, "method": "rk4"}
    run = rs.simulate(GH, dt_step=0.01, **launch)
    assert run.n_steps == rs.trajectory(GH, dt_step=0.01, dt=0.5, **launch).n_steps
    assert 100 <= run.n_steps <= 110


def test_step_has_one_name_and_its_old_one_still_works():
    launch = {"n_i": 0.1, "omega_xy0": 0.01}
    for call in (rs.simulate, rs.trajectory):
        with pytest.raises(ConfigError, match="rk4 has steps of one size and takes no tol"):
            call(GH, method="rk4", tol=1e-9, **launch)
        with pytest.raises(ConfigError, match="dop853 chooses its own steps and takes no dt"):
            call(GH, dt_step=0.1, **launch)
    with (
        pytest.warns(DeprecationWarning, match="dt of simulate is called dt_step now"),
        pytest.raises(ConfigError, match="dop853 chooses its own steps and takes no dt"),
    ):
        rs.simulate(GH, dt=0.1, **launch)
    with pytest.raises(ConfigError, match="dt and dt_step are both given"):
        rs.simulate(GH, dt=0.01, dt_step=0.01, **launch)


def test_summary_of_an_earlier_version_is_read_and_made_anew(tmp_path):
    output = tmp_path / "out"
    new = rs.sweep(CONFIG, output=output, threads=1).summary
    store = Store(output)
    old = store.read_summary().drop_columns(["t_r_over_t_rgh_mean", "t_r_over_t_rgh_sem"])
    place = old.schema.get_field_index("fraction_bondi")
    store.write_summary(old.set_column(place, old.schema.field(place), pa.array([0.5, 0.5])))
    assert rs.load(output).summary.fraction_bondi.tolist() == [0.5, 0.5]
    assert verify(output).problems == []
    assert b"t_r/t_rGH" in make_report(output)
    pd.testing.assert_frame_equal(rs.sweep(CONFIG, output=output).summary, new)


def test_sweep_warns_of_what_makes_little_sense(tmp_path):
    short = {**CONFIG, "horizon": {"t": 0.01}}
    with pytest.warns(ConfigWarning, match="is shorter than one pitch oscillation") as told:
        rs.sweep(short, output=tmp_path / "out")
    assert told[0].filename == __file__


def test_sweep_and_load(tmp_path):
    output = tmp_path / "out"
    done = rs.sweep(CONFIG, output=output, threads=1)
    assert done.directory == output
    assert len(done.runs) == 10
    assert done.summary.runs.tolist() == [5, 5]
    assert done.manifest["state"] == "complete"
    assert repr(done) == f"<Sweep {output}: 10 runs, complete>"
    again = rs.load(str(output))
    pd.testing.assert_frame_equal(again.runs, done.runs)
    pd.testing.assert_frame_equal(again.summary, done.summary)
    assert again.manifest == done.manifest
    # One row is one call of simulate.
    row = done.runs.iloc[3]
    body = rs.Rattleback(*(float(row[n]) for n in ("alpha", "beta", "gamma", "theta", "phi", "xi")))
    run = rs.simulate(body, n_i=-0.3, omega_xy0=0.01, t_end=50.0)
    assert (run.n_end, run.type, run.n_steps) == (row.n_end, row.type, row.n_steps)
    assert run.amp_growth is None
    assert np.isnan(row.amp_growth)
    assert row.psi == rs.modes(body).psi_r
    with pytest.raises(ConfigError, match="another config"):
        rs.sweep({**CONFIG, "seed": 1}, output=output)
    # Before the first block there are columns all the same.
    for block in (output / "runs").iterdir():
        block.unlink()
    none = rs.load(output).runs
    assert (len(none), list(none)) == (0, list(done.runs))


def test_sweep_and_load_refuse(tmp_path):
    with pytest.raises(ConfigError, match="unknown key"):
        rs.sweep({**CONFIG, "sede": 1}, output=tmp_path / "out")
    with pytest.raises(ConfigError, match="no such file"):
        rs.sweep(tmp_path / "no.yaml")
    with pytest.raises(ConfigError, match="is not an output directory"):
        rs.load(tmp_path)
    assert list(tmp_path.iterdir()) == []
