"""The trade of speed against accuracy: what is measured, written and said."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import pairwise

import matplotlib as mpl
import numpy as np
import oracle
import pyarrow.parquet as pq
import pytest
from matplotlib.image import imread
from refusal import assert_refused
from sweeping import ROOT, invoke

from rattlesweep.analysis import tradeoff
from rattlesweep.analysis.tradeoff import (
    DEFAULT,
    FULL,
    REFERENCES,
    SCHEMA,
    draw_runs,
    make_reference,
    measure,
)
from rattlesweep.sweeps.config.read import load_config, parse_config, physics_hash

SMALL = """\
name: small
seed: 4
bodies: {source: sd, ranges: {theta: [0.6, 0.7]}}
spin: {n_i: [0.1, -0.2, 0.3], omega_xy0: [0.01, 0.1]}
horizon: {t_rgh: 5, t: 1000}
model: gh
integrator: {method: rk4, dt: 0.1}
record: []
"""
SMALL_SCOPE = replace(FULL, least=24, rounds=1, horizon=50.0, stages=1e8)
# One kernel, the yardstick and the closed form; the slow suite has all, and two reference methods.
FEW = (tradeoff.PLAIN, *tradeoff.settings(["dop853"]), tradeoff.CLOSED_FORM)
DOP853 = REFERENCES[1]
FEW_SCOPE = replace(SMALL_SCOPE, settings=FEW, references=(DOP853, DOP853))


def small(tmp_path, text=SMALL):
    path = tmp_path / "c.yaml"
    path.write_text(text)
    return path


@pytest.fixture(scope="module", params=["few", pytest.param("all", marks=pytest.mark.slow)])
def study(request, tmp_path_factory):
    """Few settings or all, on a few runs."""
    config = load_config(small(tmp_path_factory.mktemp("study")))
    scope = FEW_SCOPE if request.param == "few" else SMALL_SCOPE
    return measure(config, samples=8, scope=scope, threads=1)


@pytest.fixture
def few(monkeypatch):
    """The command with --quick measures few settings."""
    monkeypatch.setattr(tradeoff, "QUICK", FEW_SCOPE)


def rows(study, method, model="full"):
    chosen = (study.rows.model == model) & (study.rows.method == method)
    return list(study.rows[chosen].itertuples())


def tradeoff_command(config, *options):
    return invoke("tradeoff", config, "--quick", "--threads", 1, *options)


@pytest.mark.usefixtures("few")
def test_the_command_writes_a_table_and_a_figure(tmp_path):
    out = tmp_path / "out"
    options = ("--output", out, "--samples", 2, "--set", "horizon.t=200")
    result = tradeoff_command(small(tmp_path), *options)
    assert result.exit_code == 0, result.stderr
    assert "12 runs" in result.stdout
    for row in ("plain rk4 dt 0.002", "dop853 tol 1e-9", "gh"):
        assert any(line.startswith(row) for line in result.stdout.splitlines()), row
    advice = result.stdout[result.stdout.index("cheapest setting") :].splitlines()
    assert [line.split()[0] for line in advice[2:]] == ["0.001", "1e-6", "1e-9", "1e-12"]
    assert {p.name for p in out.iterdir()} == {f"tradeoff.{k}" for k in ("parquet", "svg", "png")}
    table = pq.read_table(out / "tradeoff.parquet")
    assert table.schema.equals(SCHEMA)
    for field in table.schema:
        assert field.metadata[b"unit"]
        assert len(field.metadata[b"description"]) > 5
    columns = table.to_pydict()
    used = zip(columns["model"], columns["method"], strict=True)
    assert [*used] == [(setting.model, setting.method) for setting in FEW]
    assert min(min(columns[name]) for name in ("us_per_unit", "speedup")) > 0
    picture = imread(out / "tradeoff.png")
    assert picture.shape[0] > 500
    assert picture[..., :3].std() > 0.01


@pytest.mark.usefixtures("few")
def test_what_cannot_be_measured_is_one_sentence(tmp_path):
    steady = SMALL.replace("t_rgh: 5, t: 1000", "t: 1")
    for path, words in ((small(tmp_path, steady), "no run of this config reverses"),
                        (tmp_path / "none.yaml", "none.yaml")):  # fmt: skip
        assert_refused(tradeoff_command(path, "--output", tmp_path / "o", "--samples", 1), 2, words)
    assert not list((tmp_path / "o").glob("*"))


def test_the_shipped_config_is_the_default():
    shipped = load_config(ROOT / "configs" / "tradeoff.yaml")
    assert physics_hash(shipped) == physics_hash(parse_config(DEFAULT))
    assert shipped.name == DEFAULT["name"]
    runs = draw_runs(shipped, None, samples=None, least=2000)
    assert len(runs) >= 2000
    n_i, omega = runs.launches.n_i, runs.launches.omega_xy0
    assert {*zip(np.sign(n_i), omega, strict=True)} == {
        (sign, size) for sign in (-1, 1) for size in (0.001, 0.01, 0.1)
    }


def test_bodies_are_drawn_from_any_source(tmp_path):
    grid = (
        "bodies: {source: grid, base: {preset: GH}, axes: {theta: {linspace: [0.6, 0.7, 50]}}}\n"
        "spin: {n_i: [0.1, 0.2], omega_xy0: 0.01}\n"
    )
    runs = draw_runs(load_config(small(tmp_path, grid)), None, samples=3, least=9)
    np.testing.assert_allclose(runs.launches.bodies.theta, [0.6, 0.65, 0.7] * 2, atol=2e-3)
    assert runs.launches.sample.tolist() == [0, 24, 49] * 2
    assert len(draw_runs(load_config(small(tmp_path, grid)), None, samples=90, least=9)) == 100
    sd = load_config(small(tmp_path))
    few, more = (draw_runs(sd, None, samples=k, least=9).launches for k in (2, 3))
    assert few.bodies.theta[:2].tolist() == more.bodies.theta[:2].tolist()


def test_the_error_falls_with_the_tolerance(study):
    for method in ("dopri5", "dop853", "verner98"):
        own = rows(study, method)
        assert [row.value for row in own] == sorted((r.value for r in own), reverse=True)
        for loose, tight in pairwise(own):
            assert tight.error_median < 0.5 * loose.error_median
            assert tight.energy_drift_median < loose.energy_drift_median
    standard = next(row for row in rows(study, "dop853") if row.value == 1e-9)
    assert standard.error_p99 < 1e-6
    assert standard.type_flips == 0


@pytest.mark.parametrize("study", [pytest.param("all", marks=pytest.mark.slow)], indirect=True)
def test_rk4_is_of_fourth_order_and_models_without_the_dynamics_are_wrong(study):
    own = {row.value: row for row in rows(study, "rk4")}
    # All runs are in both, so the same ones are compared.
    for coarse, fine in ((0.05, 0.02), (0.02, 0.01), (0.01, 0.005)):
        assert own[coarse].runs == own[fine].runs
        order = math.log(own[coarse].error_median / own[fine].error_median, coarse / fine)
        assert 3.5 < order < 5.5
    drifts = [own[dt].energy_drift_median for dt in (0.02, 0.01)]
    assert 3.5 < math.log2(drifts[0] / drifts[1]) < 5.5
    (reduced,), (gh,) = rows(study, "dop853", "reduced"), rows(study, "none", "gh")
    assert gh.us_per_unit < reduced.us_per_unit
    assert min(reduced.error_median, gh.error_median) > 1e-3
    # One mode alone is the closed form.
    assert gh.error_median == pytest.approx(reduced.error_median, rel=1e-4)


def test_references_agree_with_each_other_and_with_an_oracle(study):
    facts = study.facts
    assert facts["compared"] == facts["reversing_in_both"] - (facts["dropped"] or 0)
    assert facts["references_differ_p99"] < 1e-8
    # Equations of motion written apart, in vectors.
    config = parse_config({**DEFAULT, "bodies": {"source": "preset", "name": "GH"},
                           "spin": {"n_i": [0.1], "omega_xy0": [0.01]}})  # fmt: skip
    runs = draw_runs(config, None, samples=1, least=1)
    found = make_reference(runs, FEW_SCOPE.references, 1)
    psi = oracle.relevant_psi(oracle.GH, 0.1)
    t_r, _ = oracle.first_reversal(oracle.GH, 0.1, 0.01, psi, 200.0)
    assert found.solution.t_r[0] == pytest.approx(t_r, rel=1e-9)


@pytest.mark.slow
def test_chaos_is_left_out():
    # Tumbles for 1e5 units: whether it reverses depends on rounding (types R and SW).
    config = parse_config({**DEFAULT, "spin": {"n_i": [-0.4], "omega_xy0": [0.01]}})
    runs = draw_runs(config, None, samples=67, least=1)
    found = make_reference(runs, REFERENCES, 1)
    chaotic = 59
    assert not found.both[chaotic]
    assert not found.neither[chaotic]
    assert 1 <= (~found.both & ~found.neither).sum() < 5


def test_equal_figures_have_equal_bytes(study, tmp_path, monkeypatch):
    monkeypatch.setattr(tradeoff, "DPI", 40)
    tradeoff.save(study, tmp_path / "one")
    # Whatever the user's matplotlibrc says.
    with mpl.rc_context({"font.size": 20, "savefig.bbox": "tight", "axes.facecolor": "red"}):
        tradeoff.save(study, tmp_path / "two")
    for kind in ("svg", "png"):
        one, two = (tmp_path / name / f"tradeoff.{kind}" for name in ("one", "two"))
        assert one.read_bytes() == two.read_bytes()
