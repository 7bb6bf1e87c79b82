"""Dissipation that varies from run to run: by case, and row by row of a table."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from refusal import assert_refused
from test_run import invoke

import rattlesweep as rs
from rattlesweep.errors import ConfigError
from rattlesweep.physics import full, steady
from rattlesweep.physics.body import PARAMETERS
from rattlesweep.physics.theory import bondi_threshold
from rattlesweep.sweeps.blocks.block import prepare_block
from rattlesweep.sweeps.cases.launches import model_of
from rattlesweep.sweeps.cases.plan import make_plan
from rattlesweep.sweeps.config.load import parse_config, physics_hash
from rattlesweep.sweeps.engines.run import run_sweep
from rattlesweep.sweeps.inspect.content_hash import content_hash
from rattlesweep.sweeps.inspect.verify import verify
from rattlesweep.sweeps.store import sealed

SIGMA, ROLLING = [0.0, 0.05, 0.2], [0.0, 1e-3]
# The kernel that knows all of it, as in test_stones.
CONFIG: dict[str, Any] = {
    "bodies": {"source": "grid", "base": {"preset": "GH"}, "c": 3,
               "axes": {"minus_xi_deg": [1, 2, 4], "theta": [0.64, 0.8]}},
    "spin": {"n_i": [0.3, -0.3], "omega_xy0": 0.05},
    "dissipation": {"sigma": SIGMA, "rolling": ROLLING},
    "horizon": {"t": 300},
    "record": ["reversals"],
}  # fmt: skip
GH = {"source": "preset", "name": "GH"}
SPIN = {"n_i": 0.2, "omega_xy0": 0.05}
HEAD = ",".join(PARAMETERS)
ROW = "13.04,1.522,12.28,0.6429,0.036,-0.03"


@pytest.fixture(scope="module")
def swept(tmp_path_factory: pytest.TempPathFactory) -> Any:
    return rs.sweep(CONFIG, output=tmp_path_factory.mktemp("dissipation") / "out")


def alone(output: Path, **changes: Any) -> pd.DataFrame:
    return rs.sweep(CONFIG | changes, output=output).runs


# -- cases -----------------------------------------------------------------------------------------


def test_every_value_is_combined_with_every_launch():
    plan = make_plan(parse_config(CONFIG))
    found = [(case.n_i, case.sigma, case.rolling) for case in plan.cases]
    assert found == [(n, s, r) for n in (0.3, -0.3) for s in SIGMA for r in ROLLING]
    spaced = {"sigma": {"logspace": [1e-3, 0.1, 3]}}
    cases = make_plan(parse_config(CONFIG | {"dissipation": spaced})).cases
    assert [case.sigma for case in cases] == pytest.approx([1e-3, 1e-2, 0.1] * 2)
    assert {case.rolling for case in cases} == {0.0}


def test_kernels_are_by_what_some_run_has():
    def name(**losses: Any) -> str:
        return model_of(parse_config(CONFIG | {"dissipation": losses})).name

    assert name(sigma=[0, 0.1]) == "ellipsoid_viscous"
    assert name(sigma=[0, 0.1], rolling=[0, 0.1]) == "ellipsoid_rolling"
    assert name(sigma=[0]) == name() == "ellipsoid"


def test_hashes_tell_values_and_not_how_they_are_written():
    def hashed(**losses: Any) -> str:
        return physics_hash(parse_config(CONFIG | {"dissipation": losses}))

    assert hashed(sigma=0.1) == hashed(sigma=[0.1]) == hashed(sigma={"linspace": [0.1, 0.1, 1]})
    assert hashed(sigma=[0.1, 0.2]) == hashed(sigma={"linspace": [0.1, 0.2, 2]})
    assert len({hashed(sigma=s) for s in (0, 0.1, [0.1, 0.2], [0, 0.1])}) == 4


def test_columns_are_those_of_each_run(swept):
    runs = swept.runs
    assert runs.status.eq("ok").all()
    assert sorted(set(zip(runs.sigma, runs["rolling"], strict=True))) == [
        (s, r) for s in SIGMA for r in ROLLING
    ]
    free = (runs.sigma == 0) & (runs["rolling"] == 0)
    assert (runs.energy_left[free] == 1).all()
    assert (runs.energy_left[~free] < 1).all()
    assert (runs.energy_drift.abs() < 1e-7).all()
    # Growth by linear theory is known without a lever, the threshold without any loss.
    assert (runs.growth.notna() == (runs["rolling"] == 0)).all()
    assert (runs.n_growth.notna() == (runs["rolling"] == 0)).all()
    b = rs.Rattleback.gh()
    n_c1 = bondi_threshold(b.alpha, b.beta, b.gamma, runs.theta, b.phi)
    np.testing.assert_array_equal(runs.n_c1, np.where(free, n_c1, np.nan))
    assert free.sum() == runs.n_c1.notna().sum() > 0
    for run in runs[runs["rolling"] == 0].itertuples():
        constants = full.constants(b.alpha, b.beta, b.gamma, run.theta, b.phi, run.xi)
        pitch, roll = steady.growth(np.array(constants), run.n_i, run.sigma)
        assert run.growth == (pitch if run.n_i > 0 else roll)
    assert not (runs[free].type == "D").any()
    assert (runs[runs.sigma == 0.2].type == "D").any()
    # The more it loses, the less often it turns.
    most = runs[runs["rolling"] == 0].groupby("sigma").n_reversals.sum()
    assert most.is_monotonic_decreasing
    assert most.iloc[0] > most.iloc[-1]


def test_a_run_is_what_it_is_alone(swept, tmp_path):
    """The same kernel gives the same bits; that of less dissipation the same to rounding."""
    runs = swept.runs
    one = alone(tmp_path / "one", dissipation={"sigma": 0.2, "rolling": 1e-3})
    same = runs[(runs.sigma == 0.2) & (runs["rolling"] == 1e-3)].reset_index(drop=True)
    names = [name for name in runs.columns if name != "case"]
    pd.testing.assert_frame_equal(one[names], same[names], check_exact=True)


def test_without_losses_it_is_that_of_a_sweep_without(tmp_path):
    table = tmp_path / "b.csv"
    rows = [f"13.04,1.522,12.28,{t},0.036,-0.03,{n},0.05,,{s},1e-3"
            for s in (0, 0.1) for t in (0.64, 0.7, 0.8) for n in (0.1, 0.3, -0.3)]  # fmt: skip
    head = f"{HEAD},n_i,omega_xy0,c,sigma,rolling"
    table.write_text("\n".join([head, *rows]).replace(",0,1e-3", ",0,0") + "\n")
    bodies = {"source": "table", "path": str(table), "surface": "ellipsoid", "c": None}
    rest = {"horizon": {"t": 300}}
    table.write_text(table.read_text() + f"{ROW},0.1,0.05,3,0,0\n")
    found = rs.sweep({"bodies": bodies, **rest}, output=tmp_path / "out").runs
    free = found[(found.sigma == 0) & found.c.isna()]
    plain = pd.DataFrame({n: free[n] for n in (*PARAMETERS, "n_i", "omega_xy0")})
    without = rs.sweep(plain, output=tmp_path / "plain", **rest).runs
    assert len(without) == len(free) == 9
    assert without.type.tolist() == free.type.tolist()
    np.testing.assert_allclose(free.t_r, without.t_r, rtol=1e-9)
    np.testing.assert_allclose(free.n_end, without.n_end, rtol=0, atol=1e-9)
    assert without.n_c1.equals(free.n_c1.reset_index(drop=True))


def test_what_the_lever_stops_long_before_the_spin_takes_no_steps(tmp_path):
    """Oscillations of 1e-20: errors of rounding in the spin that falls are far larger."""
    kl = {"source": "preset", "name": "KL"}
    losses, horizon = {"sigma": 0.032, "rolling": 2e-3}, {"t": 250}
    run = alone(tmp_path / "out", bodies=kl, spin={"n_i": -0.2, "omega_xy0": 0.02},
                dissipation=losses, horizon=horizon,
                integrator={"max_steps": 20_000}).iloc[0]  # fmt: skip
    assert (run.status, run.n_reversals) == ("ok", 0)
    assert run.n_steps < 5000
    assert abs(run.energy_drift) < 1e-9
    # What is left is a spin that falls at the rate sigma/gamma.
    assert run.n_end == pytest.approx(-0.2 * np.exp(-0.032 * 250 / 17), rel=5e-3)


# -- what is made of them --------------------------------------------------------------------------


def test_summary_by_case(swept, tmp_path):
    summary = swept.summary
    assert summary.sigma.tolist() == [s for _ in (1, 2) for s in SIGMA for _ in ROLLING]
    assert summary["rolling"].tolist() == ROLLING * 6
    free = (summary.sigma == 0) & (summary["rolling"] == 0)
    # Bondi's share has a meaning in the steady direction, and where nothing is lost.
    assert (summary.fraction_bondi.notna() == (free & (summary.n_i < 0))).all()
    text = invoke("run", write(tmp_path, CONFIG), "--output", swept.directory).stdout
    head = text.splitlines()[0].split()
    assert head[:6] == ["case", "target", "n_i", "omega_xy0", "sigma", "rolling"]


def write(folder: Path, config: Any) -> Path:
    path = folder / "c.yaml"
    path.write_text(json.dumps(config))
    return path


@pytest.mark.slow  # what follows one run compiles kernels of its own
def test_runs_are_replayed_and_shown(swept, tmp_path):
    one = (swept.directory, "--case", 5, "--sample", 1)
    replayed = invoke("replay", *one, "--points", 3)
    assert replayed.exit_code == 0, replayed.output
    assert "bit for bit" in replayed.stderr
    page = invoke("show", "--from", *one, "--t-end", 20, "--output", tmp_path / "p.html")
    assert page.exit_code == 0, page.output
    assert "rolling 0.001" in (tmp_path / "p.html").read_text()


def test_directories_are_proved_typed_and_reported(swept, tmp_path):
    directory = swept.directory
    assert verify(directory, recompute=20, seed=2).problems == []
    typed = invoke("classify", directory, "--set", "classify.dead_energy=1e-9")
    assert typed.exit_code == 0, typed.output
    assert verify(directory).problems == []
    invoke("classify", directory, "--set", "classify.dead_energy=0.01")
    report = invoke("report", directory, "--output", tmp_path / "r.html")
    assert report.exit_code == 0, report.output
    assert 'class="number">σ</th>' in (tmp_path / "r.html").read_text()


def test_it_is_an_axis_of_pictures_and_arrays(swept, tmp_path):
    directory = swept.directory
    for kind in ("reversals", "map", "times", "ratio", "fractions"):
        data = tmp_path / f"{kind}.csv"
        made = invoke("plot", directory, "--kind", kind, "--x", "sigma", "--select", "theta=0.64",
                      "--select", "n_i=0.3", "--select", "rolling=0", "--data", data,
                      "--output", tmp_path / f"{kind}.svg")  # fmt: skip
        if kind == "fractions":
            assert_refused(made, 2, "--kind fractions: does not fit this sweep")
            continue
        assert made.exit_code == 0, made.output
        shown = pd.read_csv(data)
        assert sorted(set(shown.sigma)) == SIGMA
        if kind == "reversals":
            runs = swept.runs
            own = runs[(runs.theta == 0.64) & (runs.n_i == 0.3) & (runs["rolling"] == 0)]
            wanted = own.set_index(["sigma", np.round(-np.degrees(own.xi))]).n_reversals
            got = shown.set_index(["sigma", "minus_xi_deg"]).n_reversals_mean
            assert got.sort_index().tolist() == wanted.sort_index().tolist()
    found = swept.to_xarray(["n_reversals", "growth"])
    launch, body = ("n_i", "omega_xy0", "sigma", "rolling"), ("theta", "minus_xi_deg")
    assert found.growth.dims == (*launch, *body)
    assert found.sigma.attrs["units"] == "M a^2 sqrt(g/a)"
    assert found.growth.isel(rolling=1).isnull().all()


def test_grows_by_more_values(swept, tmp_path):
    few = CONFIG | {"dissipation": {"sigma": 0.2, "rolling": ROLLING}}
    run_sweep(make_plan(parse_config(few)), tmp_path / "out")
    result = run_sweep(make_plan(parse_config(CONFIG)), tmp_path / "out")
    assert result.resumed_runs == 24
    assert content_hash(tmp_path / "out") == content_hash(swept.directory)
    # Not where all runs would have another kernel.
    other = CONFIG | {"dissipation": {"sigma": 0.2}}
    with pytest.raises(ConfigError, match="holds the runs of another config"):
        run_sweep(make_plan(parse_config(other)), tmp_path / "out")


def test_manifests_that_do_not_tell_cases_apart(tmp_path):
    """As written before there could be several values."""
    few = CONFIG | {"dissipation": {"sigma": 0.2, "rolling": 1e-3}, "horizon": {"t": 20}}
    directory = tmp_path / "out"
    alone(directory, **few)
    path = directory / "manifest.json"
    manifest = sealed.load(path.read_bytes())
    for case in manifest["cases"]:
        assert (case.pop("sigma"), case.pop("rolling")) == (0.2, 1e-3)
    path.write_bytes(sealed.dump(manifest))
    (directory / "summary.parquet").unlink()
    assert rs.load(directory).summary.sigma.tolist() == [0.2, 0.2]
    assert run_sweep(make_plan(parse_config(few)), directory).resumed_runs == 12
    assert verify(directory).problems == []


def test_refines_over_it(tmp_path):
    bodies = CONFIG["bodies"] | {"axes": {"minus_xi_deg": {"linspace": [0.5, 4, 9]}},
                                 "refine": {"levels": 2}}  # fmt: skip
    losses = {"sigma": {"linspace": [0, 0.3, 9]}, "rolling": 1e-3}
    whole = CONFIG | {"bodies": {k: v for k, v in bodies.items() if k != "refine"},
                      "dissipation": losses, "spin": {"n_i": 0.3, "omega_xy0": 0.05}}  # fmt: skip
    every = alone(tmp_path / "whole", **whole)
    some = alone(tmp_path / "some", **whole | {"bodies": bodies})
    assert 9 < len(some) < len(every) == 81
    both = some.merge(every, on=["case", "sample"], suffixes=("", "_whole"))
    assert len(both) == len(some)
    assert both.t_r.equals(both.t_r_whole)


def test_plans_and_forecasts(tmp_path):
    path = write(tmp_path, CONFIG)
    for command in (["plan", path, "--budget", "0.3s"], ["validate", path],
                    ["run", path, "--dry-run"]):  # fmt: skip
        done = invoke(*command)
        assert done.exit_code == 0, done.output
        assert "72 runs" in done.output or "72" in done.output
    assert not (tmp_path / "out").exists()


# -- horizons --------------------------------------------------------------------------------------


def test_a_horizon_in_units_of_the_decay():
    def ends(**rest: Any) -> list[float]:
        plan = make_plan(parse_config({"bodies": GH, "spin": SPIN, **rest}))
        launches, _ = prepare_block(plan, plan.block(0))
        return launches.t_end.tolist()

    gamma = rs.Rattleback.gh().gamma
    sigma = {"sigma": [0.01, 0.1]}
    assert ends(dissipation=sigma, horizon={"t_decay": 5}) == pytest.approx(
        [5 * gamma / 0.01, 5 * gamma / 0.1]
    )
    assert ends(dissipation=sigma, horizon={"t_decay": 5, "t": 1000}) == pytest.approx(
        [1000, 50 * gamma]
    )
    assert ends(dissipation={"sigma": [0, 1]}, horizon={"t_decay": 1, "t": 99}) == pytest.approx(
        [99, gamma]
    )


# -- tables ----------------------------------------------------------------------------------------


def test_a_table_says_it_row_by_row(tmp_path, swept):
    """The runs of a sweep are such a table, and come out the same."""
    source = {"source": "table", "path": str(swept.directory / "runs"), "surface": "ellipsoid"}
    config = {"bodies": source, "horizon": {"t": 300}, "record": ["reversals"]}
    plan = make_plan(parse_config(config))
    assert plan.config.dissipation.sigma == plan.config.dissipation.rolling == "table"
    again = rs.sweep(config, output=tmp_path / "out")
    before, after = swept.runs, again.runs
    for name in ("sigma", "rolling", "t_r", "n_reversals", "growth", "type", "energy_left"):
        pd.testing.assert_series_equal(before[name], after[name], check_exact=True)
    assert again.summary.sigma.isna().all()
    assert invoke("verify", again.directory, "--recompute", 5).exit_code == 0


@pytest.mark.slow  # without c it is another kernel
def test_a_frame_says_it_row_by_row(tmp_path, swept):
    before = swept.runs
    frame = before[[*PARAMETERS, "c", "n_i", "omega_xy0", "sigma", "rolling"]].iloc[::9]
    kept = rs.sweep(frame.drop(columns="c"), output=tmp_path / "frame", horizon={"t": 1}).runs
    assert kept.sigma.tolist() == frame.sigma.tolist()


def plan_of(text: str, folder: Path, **rest: Any) -> Any:
    path = folder / "b.csv"
    path.write_text(text)
    bodies = {"source": "table", "path": str(path)} | rest.pop("bodies", {})
    return make_plan(parse_config({"bodies": bodies, "spin": SPIN, **rest}))


def test_what_all_rows_share_is_that_of_the_config(tmp_path):
    same = plan_of(f"{HEAD},sigma,rolling\n{ROW},0.1,0\n{ROW},0.1,0\n", tmp_path)
    assert (same.config.dissipation.sigma, same.config.dissipation.rolling) == (0.1, 0)
    assert model_of(same.config).name == "full_viscous"
    # A column counts in the place of the config's number, and another key with it.
    both = plan_of(f"{HEAD},sigma\n{ROW},0.1\n{ROW},0.2\n", tmp_path,
                   dissipation={"sigma": 7, "rolling": [0, 0.01]})  # fmt: skip
    launches, _ = prepare_block(both, both.block(0))
    assert launches.sigma.tolist() == [0.1, 0.2, 0.1, 0.2]
    assert launches.rolling.tolist() == [0, 0, 0.01, 0.01]
    none = plan_of(f"{HEAD},sigma\n{ROW},0\n", tmp_path)
    assert not none.config.dissipation
    assert model_of(none.config).name == "full"


def test_tables_in_si_units(tmp_path):
    body = "1,0.01,2e-4,16e-4,17e-4,-0.2e-4,2.0,0.045"
    head = "mass_kg,height_m,ixx_kg_m2,iyy_kg_m2,izz_kg_m2,ixy_kg_m2,r1_m,r2_m"
    plan = plan_of(f"{head},c_m,sigma_N_m_s,rolling_m\n{body},0.02,1e-4,5e-5\n{body},,0,0\n",
                   tmp_path, bodies={"surface": "ellipsoid"})  # fmt: skip
    launches, _ = prepare_block(plan, plan.block(0))
    kl = rs.Rattleback.kl()
    assert launches.bodies.c[0] == pytest.approx(kl.c, rel=1e-15)
    assert np.isnan(launches.bodies.c[1])
    assert launches.bodies.xi[0] == pytest.approx(kl.xi, rel=1e-12)
    # Kane and Levinson's sigma: 1e-4 N m s over M a^2 sqrt(g/a).
    assert launches.sigma.tolist() == pytest.approx([1e-4 / (1e-4 * (9.81 / 0.01) ** 0.5), 0])
    assert launches.rolling.tolist() == pytest.approx([0.005, 0])
    plain = plan_of(f"{HEAD},height_m,rolling_m\n{ROW},0.01,1e-5\n", tmp_path)
    assert plain.config.dissipation.rolling == pytest.approx(1e-3)


REFUSED_TABLES = {
    "negative": ("sigma", "-0.1", {}, "row 1: sigma is -0.1; it must be at least 0"),
    "long lever": ("rolling", "2", {}, "row 1: rolling is 2; at most 1 is allowed"),
    "empty": ("sigma", "", {}, "row 1: sigma is empty; a finite number is needed"),
    "a word": ("sigma", "much", {}, "row 1: sigma is 'much'; a finite number is needed"),
    "several too": ("sigma", "0.1", {"dissipation": {"sigma": [0, 1]}},
                    "dissipation.sigma: there are several values, and the table has a column "),
    "no column": ("rolling", "0.1", {"dissipation": {"sigma": "table"}},
                  "dissipation.sigma: the table has no column sigma; add it, or give a number"),
    "reduced": ("sigma", "0.1", {"model": "reduced"},
                "model: reduced conserves energy, and the table has a column sigma; take model"),
    "exponents": ("sigma", "0.1", {"record": ["lyapunov"]},
                  "bodies.path: the table has dissipation, and record: [lyapunov] and classify"),
    "no mass": ("sigma_N_m_s", "0.1", {},
                "the column mass_kg is missing; sigma_N_m_s needs it"),
    "no height": ("rolling_m", "0.1", {}, "the column height_m is missing; rolling_m needs it"),
    "no height for c": ("c_m", "0.1", {}, "the column height_m is missing; c_m needs it"),
    "no decay": ("sigma", "0", {"horizon": {"t_decay": 1}},
                 "horizon.t_decay: t_decay times gamma/sigma is not a finite time in the only run"),
}  # fmt: skip


@pytest.mark.parametrize(("name", "cell", "rest", "words"), REFUSED_TABLES.values(),
                         ids=REFUSED_TABLES)  # fmt: skip
def test_tables_are_refused_in_a_sentence(tmp_path, name, cell, rest, words):
    (tmp_path / "b.csv").write_text(f"{HEAD},{name}\n{ROW},{cell}\n")
    bodies = {"source": "table", "path": str(tmp_path / "b.csv")}
    path = write(tmp_path, {"bodies": bodies, "spin": SPIN} | rest)
    assert_refused(invoke("run", path, "--output", tmp_path / "out"), 2, words)
    assert not (tmp_path / "out").exists()


def test_two_columns_of_one_loss(tmp_path):
    with pytest.raises(ConfigError, match=r"row 1: sigma is 0\.1, and sigma_N_m_s comes to "):
        plan_of(f"{HEAD},mass_kg,height_m,sigma,sigma_N_m_s\n{ROW},1,0.01,0.1,0.1\n", tmp_path)


# -- bad input -------------------------------------------------------------------------------------

REFUSED = {
    "negative": ({"sigma": [0, -0.1]}, "dissipation.sigma[1]: -0.1 is out of range; it must be at"),
    "long": ({"rolling": [0, 2]}, "dissipation.rolling[1]: 2 is out of range; it must be at most"),
    "twice": ({"sigma": [0.1, 0.1]}, "dissipation.sigma: 0.1 is repeated; give each value once"),
    "none": ({"sigma": []}, "dissipation.sigma: the list has 0 values; give at least 1"),
    "word": ({"sigma": "tabel"}, 'dissipation.sigma: "tabel" is not one of table; did you mean'),
    "no table": ({"sigma": "table"}, "dissipation: sigma is that of a table, and the bodies are of "
                 "source preset; give a number, or several"),
    "no ratio": ({"sigma": {"logspace": [0, 1, 5]}},
                 "dissipation.sigma: no constant ratio leads from 0 to 1"),
    "too many": ({"sigma": {"linspace": [0, 1, 100_001]}}, "dissipation: 100001 cases (targets x "
                 "n_i x omega_xy0 x sigma x rolling); at most 100000 are possible"),
}  # fmt: skip


@pytest.mark.parametrize(("losses", "words"), REFUSED.values(), ids=REFUSED)
def test_configs_are_refused_in_a_sentence(tmp_path, losses, words):
    path = write(tmp_path, {"bodies": GH, "spin": SPIN, "dissipation": losses})
    assert_refused(invoke("run", path, "--output", tmp_path / "out"), 2, words)
    assert not (tmp_path / "out").exists()


def test_a_horizon_of_a_decay_that_is_none(tmp_path):
    config = {"bodies": GH, "spin": SPIN, "horizon": {"t_decay": 3}}
    words = "dissipation: horizon.t_decay is in units of gamma/sigma, and sigma is 0; give sigma"
    assert_refused(invoke("validate", write(tmp_path, config)), 2, words)
    some = config | {"dissipation": {"sigma": [0, 0.1]}}
    warned = invoke("validate", write(tmp_path, some))
    assert warned.exit_code == 0
    assert "horizon.t_decay: t_decay times gamma/sigma is not a finite time in 1 of the 2 runs" in (
        warned.stderr
    )
