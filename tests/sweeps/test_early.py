"""`classify.early`: runs end once they are certain to be SS, and nothing else changes."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
import sweeping
from refusal import assert_refused
from sweeping import content_hash, invoke, proved, rows

import rattlesweep as rs
from rattlesweep.analysis.onerun.course import Course
from rattlesweep.analysis.onerun.replay import Replay
from rattlesweep.errors import OutputError
from rattlesweep.physics import theory
from rattlesweep.physics.body import PARAMETERS
from rattlesweep.sweeps.run import Shard

SETS = (
    "bodies.samples=12", "bodies.target={K_r: [0.0041, 0.02], rel_tol: 0.1}",
    "spin.n_i=[-0.2, -0.5, 0.4]", "record=[energy, windows]",
)  # fmt: skip
EARLY = "classify.early=true"


def sweep(output: Path, *sets: str, **options: Any) -> Any:
    return sweeping.sweep(output, "steady.yaml", *SETS, *sets, **options)


def ended(early: pd.DataFrame, full: pd.DataFrame) -> pd.Series:
    """Which runs did not wait for their horizon."""
    return (early.t_end < full.t_end) & early.t_r.isna()


@pytest.fixture(scope="module")
def both(tmp_path_factory) -> Path:
    """The same runs to their horizons and ended early."""
    root = tmp_path_factory.mktemp("early")
    sweep(root / "full")
    sweep(root / "early", EARLY)
    return root


@pytest.fixture(scope="module")
def tables(both) -> tuple[pd.DataFrame, pd.DataFrame, pd.Series]:
    """Runs ended early, runs to their horizons, and which did not wait for those."""
    early, full = rows(both / "early"), rows(both / "full")
    return early, full, ended(early, full)


def test_no_type_changes_and_steady_runs_take_a_fraction_of_their_steps(both, tables):
    early, full, some = tables
    assert early.type.equals(full.type)
    assert set(full.type) == {"R", "SS", "SW", "unclassified"}
    steady = full.type == "SS"
    assert steady[some].all()
    assert 10 < 0.8 * steady.sum() < some.sum()
    assert early.n_steps[steady].sum() < 0.3 * full.n_steps[steady].sum()
    pd.testing.assert_frame_equal(early[~some], full[~some], check_exact=True)


def test_what_a_run_that_has_ended_early_says_of_itself(tables):
    early, full = (table[tables[2]] for table in tables[:2])
    assert (early.status == "ok").all()
    assert (early.amp_growth <= 0).all()
    assert (full.amp_growth <= 0).all()
    # It would have settled at the spin that its energy leaves it.
    np.testing.assert_allclose(early.n_end, -early.n_0, rtol=1e-14)
    np.testing.assert_allclose(early.n_end, full.n_end, rtol=1e-3)
    np.testing.assert_allclose(early.n_departure, full.n_departure, atol=1e-12)
    assert (early.energy_drift.abs() < 1e-6).all()
    assert (early.energy_drift_max <= full.energy_drift_max).all()
    for one, whole in zip(early.itertuples(), full.itertuples(), strict=True):
        windows = one.window_amplitude  # those that were over
        assert len(windows) == one.t_end // one.window_t
        np.testing.assert_array_equal(windows, whole.window_amplitude[: len(windows)])


def test_other_thresholds_give_the_types_of_runs_to_the_horizon(both, tmp_path):
    """An end is certain for any ss_growth, so that no threshold trusts it more than it may."""
    for k, sets in enumerate((["classify.ss_growth=1e-12"], ["classify.sw_departure=1e-6"])):
        for name in ("full", "early"):
            copy = tmp_path / f"{name}{k}"
            shutil.copytree(both / name, copy)
            done = invoke("classify", copy, *(word for one in sets for word in ("--set", one)))
            assert done.exit_code == 0, done.stderr
        assert rows(tmp_path / f"early{k}").type.equals(rows(tmp_path / f"full{k}").type)
        proved(tmp_path / f"early{k}")


def test_it_is_no_threshold_and_another_sweep(both):
    full, early = both / "full", both / "early"
    done = invoke("classify", full, "--set", EARLY)
    assert_refused(done, 2, "classify.early: decides more than types")
    done = sweeping.run("steady.yaml", full, *SETS, EARLY, options=("-q",))
    assert_refused(done, 2, "holds another sweep (classify.early: false against true)")
    # A comparison takes it as another way to integrate.
    done = invoke("compare", full, early, "--json")
    assert done.exit_code == 0, done.stderr
    said = json.loads(done.stdout)
    assert any(words.startswith("classify.early: false against true") for words in said["differ"])
    assert said["total"]["types"] == 0
    assert said["total"]["equal"] == said["total"]["reversing"] > 20


def test_the_same_content_however_it_is_run(both, tmp_path):
    for index, threads in enumerate((2, 1)):
        sweep(tmp_path, EARLY, shard=Shard(index, 2), threads=threads)
    assert proved(tmp_path, recompute=5) == content_hash(both / "early")
    assert content_hash(both / "early") != content_hash(both / "full")


def test_a_replay_goes_on_to_the_horizon(both, tables):
    early, full, some = tables
    source, row = Replay(both / "early"), early[some].iloc[-1]
    one = source.find(int(row.case), int(row["sample"]))
    source.prove(one)
    whole = Course(source.prepare(one))
    columns = whole.columns()
    one.check(whole)
    assert whole.t == full.t_end[row.name] > one.t_end
    assert columns["n"][-1] == pytest.approx(full.n_end[row.name], rel=1e-12)
    # As far as the sweep went, it is the sweep's.
    part = Course(source.prepare(one, t_end=one.t_end))
    part.columns()
    one.check(part)
    assert part.n_steps - one.n_steps in (0, 1)
    with pytest.raises(OutputError, match=r"takes \d+ steps when it is followed"):
        replace(one, early=False, n_steps=one.n_steps - 1).check(part)


def test_errors_of_types_are_told_of_runs_that_end_early(tmp_path):
    for name, more in (("full", ()), ("early", (EARLY,))):
        sweep(tmp_path / name, "record=[error]", "spin.n_i=[-0.5]", *more)
    full, early = rows(tmp_path / "full"), rows(tmp_path / "early")
    some = ended(early, full)
    assert some.sum() > 5
    assert early.type_sure[some].all()
    assert early.type.equals(full.type)
    pd.testing.assert_frame_equal(early[~some], full[~some], check_exact=True)


def test_from_python_and_for_the_mirror_image(tmp_path):
    """Which is stable in the other direction."""
    b = rs.Rattleback.gh()
    spin, early = {"n_i": [-0.5], "omega_xy0": 0.001}, {"classify": {"early": True}}
    body = [b.alpha, b.beta, b.gamma, 0.95, b.phi]
    found = []
    for name, sign, settings in (("full", 1, {}), ("early", 1, early), ("mirrored", -1, early)):
        table = pd.DataFrame([[*body, sign * b.xi]], columns=list(PARAMETERS))
        config = {"spin": spin | {"n_i": -0.5 * sign}, "horizon": {"t": 2000.0}, **settings}
        found.append(rs.sweep(table, output=tmp_path / name, **config).runs.iloc[0])
    assert [run.type for run in found] == ["SS"] * 3
    full, early, mirrored = found
    assert full.t_end == 2000
    assert early.t_end < 1000
    assert mirrored.t_end == pytest.approx(early.t_end, rel=1e-2)
    assert mirrored.n_end == pytest.approx(-early.n_end, rel=1e-12)


@pytest.mark.slow
def test_bodies_of_any_kind(tmp_path):
    """Any inertia and surface, near the threshold and far beyond, oscillations of all sizes."""
    rng, count = np.random.default_rng(5), 12_000
    beta = rng.uniform(1.05, 4, count)
    alpha = beta + rng.uniform(0.05, 8, count)
    gamma = rng.uniform(alpha - beta, alpha + beta - 2)
    theta = rng.uniform(0.3, 0.98, count)
    phi = theta * rng.uniform(0.01, 0.9, count)
    n_c1 = theory.bondi_threshold(alpha, beta, gamma, theta, phi)
    columns = {
        **{"alpha": alpha, "beta": beta, "gamma": gamma, "theta": theta, "phi": phi},
        "xi": -rng.uniform(0.01, 0.8, count),
        "n_i": n_c1 * np.exp(rng.uniform(np.log(0.98), np.log(2.5), count)),
        "omega_xy0": 10 ** rng.uniform(-3, -0.3, count),
    }
    table, config = pd.DataFrame(columns)[n_c1 > -3], {"horizon": {"t_rgh": 5, "t": 50_000.0}}
    full = rs.sweep(table, output=tmp_path / "full", **config).runs
    early = rs.sweep(table, output=tmp_path / "early", **config, classify={"early": True}).runs
    some = ended(early, full)
    assert len(full) > 9_000
    assert some.sum() > 0.3 * len(full)
    assert early.type.equals(full.type)
    assert (full.amp_growth[some] <= 0).all()
