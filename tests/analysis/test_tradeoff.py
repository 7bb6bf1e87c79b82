"""The trade of speed against accuracy: what is measured, written and said."""

from __future__ import annotations

import math
from itertools import pairwise

import matplotlib as mpl
import oracle
import pandas as pd
import pytest
from sweeping import ROOT, invoke

from rattlesweep.analysis import tradeoff
from rattlesweep.analysis.tradeoff import DEFAULT, REFERENCES, draw_runs
from rattlesweep.config.read import load_config, parse_config, physics_hash

SMALL = """\
name: small
seed: 4
bodies: {source: sd, ranges: {theta: [0.6, 0.7]}}
spin: {n_i: [0.1, -0.2, 0.3], omega_xy0: [0.01, 0.1]}
horizon: {t_rgh: 5, t: 1000}
model: gh
integrator: {method: rk4, dt: 0.1}
"""
# One kernel and the closed form; the slow suite has all, and two reference methods.
FEW = [
    setting
    for setting in tradeoff.QUICK_SETTINGS
    if setting.method in ("dop853", "none")
]


def small(tmp_path, text=SMALL):
    path = tmp_path / "c.yaml"
    path.write_text(text)
    return path


@pytest.fixture
def few(monkeypatch):
    """The command with --quick measures few settings, against one method."""
    monkeypatch.setattr(tradeoff, "QUICK_SETTINGS", FEW)
    monkeypatch.setattr(tradeoff, "REFERENCES", REFERENCES[1:] * 2)


@pytest.fixture(
    scope="module", params=["few", pytest.param("all", marks=pytest.mark.slow)]
)
def study(request, tmp_path_factory):
    """Few settings or all, on a few runs."""
    config = load_config(small(tmp_path_factory.mktemp("study")))
    with pytest.MonkeyPatch.context() as patch:
        if request.param == "few":
            patch.setattr(tradeoff, "REFERENCES", REFERENCES[1:] * 2)
        return tradeoff.measure(
            config,
            samples=8,
            settings=FEW if request.param == "few" else tradeoff.FULL_SETTINGS,
        )


def rows(study, method, model="full"):
    chosen = (study.rows.model == model) & (study.rows.method == method)
    return list(study.rows[chosen].itertuples())


def tradeoff_command(config, *options):
    return invoke("tradeoff", config, "--quick", "--threads", 1, *options)


@pytest.mark.usefixtures("few")
def test_the_command_writes_a_table_and_equal_figures(tmp_path):
    for name in ("one", "two"):
        # Whatever the user's matplotlibrc says.
        with mpl.rc_context(
            {"font.size": 20, "axes.facecolor": "red"} if name == "two" else {}
        ):
            options = (
                "--output",
                tmp_path / name,
                "--samples",
                2,
                "--set",
                "horizon.t=200",
            )
            result = tradeoff_command(small(tmp_path), *options)
        assert result.exit_code == 0, result.stderr
    assert "12 runs" in result.stdout
    table = pd.read_parquet(tmp_path / "two" / "tradeoff.parquet")
    assert table.name.tolist() == [setting.name for setting in FEW]
    assert all(name in result.stdout for name in table.name)
    assert (tmp_path / "two" / "tradeoff.png").read_bytes().startswith(b"\x89PNG")
    assert b"<svg" in (tmp_path / "two" / "tradeoff.svg").read_bytes()


@pytest.mark.usefixtures("few")
def test_what_cannot_be_measured_is_one_sentence(tmp_path):
    steady = SMALL.replace("t_rgh: 5, t: 1000", "t: 1")
    for path, words in (
        (small(tmp_path, steady), "no run of this config reverses"),
        (tmp_path / "none.yaml", "none.yaml"),
    ):
        result = tradeoff_command(path, "--output", tmp_path / "o", "--samples", 1)
        last = result.stderr.splitlines()[-1]  # behind the stages
        assert (result.exit_code, last[:7], words in last) == (2, "error: ", True)
    assert not list((tmp_path / "o").glob("*"))


def test_the_shipped_config_is_the_default():
    shipped = load_config(ROOT / "configs" / "tradeoff.yaml")
    assert physics_hash(shipped) == physics_hash(parse_config(DEFAULT))
    assert len(draw_runs(shipped, None, None, 2000)[1].n_i) >= 2000


def test_the_error_falls_with_the_tolerance(study):
    for method in ("dopri5", "dop853", "verner98"):
        for loose, tight in pairwise(rows(study, method)):
            assert loose.value > tight.value
            assert tight.error_median < 0.5 * loose.error_median
            assert tight.energy_drift_median < loose.energy_drift_median
    standard = next(row for row in rows(study, "dop853") if row.value == 1e-9)
    assert standard.error_p99 < 1e-6
    assert standard.type_flips == 0


@pytest.mark.parametrize(
    "study", [pytest.param("all", marks=pytest.mark.slow)], indirect=True
)
def test_rk4_is_of_fourth_order_and_models_without_the_dynamics_are_wrong(study):
    own = {row.value: row for row in rows(study, "rk4")}
    # All runs are in both, so the same ones are compared.
    order = math.log(own[0.05].error_median / own[0.02].error_median, 0.05 / 0.02)
    assert 3.5 < order < 5.5
    (reduced,) = rows(study, "dop853", "reduced")
    (gh,) = rows(study, "none", "gh")
    assert min(reduced.error_median, gh.error_median) > 1e-3
    # One mode alone is the closed form.
    assert gh.error_median == pytest.approx(reduced.error_median, rel=1e-4)


@pytest.mark.slow
def test_references_agree_with_an_oracle_and_leave_out_chaos():
    # Equations of motion written apart, in vectors.
    config, runs = draw_runs(
        parse_config(
            {
                **DEFAULT,
                "bodies": {"source": "preset", "name": "GH"},
                "spin": {"n_i": [0.1], "omega_xy0": [0.01]},
            }
        ),
        None,
        1,
        1,
    )
    found = tradeoff.make_reference(config, runs)
    psi = oracle.relevant_psi(oracle.GH, 0.1)
    t_r, _ = oracle.first_reversal(oracle.GH, 0.1, 0.01, psi, 200.0)
    assert found.t_r[0] == pytest.approx(t_r, rel=1e-9)
    # Tumbles for 1e5 units: whether it reverses depends on rounding (types R and SW).
    spin = {"n_i": [-0.4], "omega_xy0": [0.01]}
    found = tradeoff.make_reference(
        *draw_runs(parse_config({**DEFAULT, "spin": spin}), None, 67, 1)
    )
    unsure = ~found.both & ~found.neither
    assert unsure[59]
    assert 1 <= unsure.sum() < 5
