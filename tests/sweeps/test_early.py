"""`classify.early`: runs end once they are certain to be SS, and nothing else changes."""

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
from rattlesweep.integrate.batch import most_threads
from rattlesweep.physics import theory
from rattlesweep.study.onerun.course import Course
from rattlesweep.study.onerun.replay import Replay
from rattlesweep.sweeps.cases.plan import make_plan
from rattlesweep.sweeps.cases.shards import Shard
from rattlesweep.sweeps.config.load import load_config
from rattlesweep.sweeps.engines.run import run_sweep
from rattlesweep.sweeps.inspect.content_hash import content_hash
from rattlesweep.sweeps.inspect.merge import merge
from rattlesweep.sweeps.inspect.verify import verify

STEADY = Path(__file__).parents[2] / "configs" / "steady.yaml"
SETS = (
    "bodies.samples=12",
    "bodies.target={K_r: [0.0041, 0.02], rel_tol: 0.1}",
    "spin.n_i=[-0.2, -0.5, 0.4]",
)
EARLY = "classify.early=true"


def sweep(output: Path, *sets: str, **options: Any) -> Any:
    """Run the sweep with some more settings."""
    return run_sweep(make_plan(load_config(STEADY, [*SETS, *sets])), output, **options)


def rows(directory: Path) -> pd.DataFrame:
    return pd.read_parquet(directory / "runs").sort_values(["case", "sample"], ignore_index=True)


def ended(early: pd.DataFrame, full: pd.DataFrame) -> pd.Series:
    """Which runs did not wait for their horizon."""
    return (early.t_end < full.t_end) & early.t_r.isna()


@pytest.fixture(scope="module")
def both(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The same runs to their horizons and ended early."""
    root = tmp_path_factory.mktemp("early")
    sweep(root / "full", "block_size=50", "record=[energy, windows]")
    sweep(root / "early", "block_size=50", "record=[energy, windows]", EARLY)
    return root


def test_no_type_changes_and_steady_runs_take_a_fraction_of_their_steps(both: Path) -> None:
    full, early = rows(both / "full"), rows(both / "early")
    assert early.type.equals(full.type)
    assert set(full.type) == {"R", "SS", "SW", "unclassified"}
    some, steady = ended(early, full), full.type == "SS"
    assert steady[some].all()
    assert 10 < 0.8 * steady.sum() < some.sum()
    assert early.n_steps[steady].sum() < 0.3 * full.n_steps[steady].sum()
    pd.testing.assert_frame_equal(early[~some], full[~some], check_exact=True)
    summary = [pd.read_parquet(both / name / "summary.parquet") for name in ("early", "full")]
    pd.testing.assert_frame_equal(*summary, check_exact=True)


def test_what_a_run_that_has_ended_early_says_of_itself(both: Path) -> None:
    full, early = rows(both / "full"), rows(both / "early")
    some = ended(early, full)
    early, full = early[some], full[some]
    assert (early.status == "ok").all()
    assert (early.amp_growth <= 0).all()
    assert (full.amp_growth <= 0).all()
    # It would have settled at the spin that its energy leaves it.
    np.testing.assert_allclose(early.n_end, -early.n_0, rtol=1e-14)
    np.testing.assert_allclose(early.n_end, full.n_end, rtol=1e-3)
    np.testing.assert_allclose(early.n_departure, full.n_departure, atol=1e-12)
    assert (early.energy_drift.abs() < 1e-6).all()
    assert (early.energy_drift_max <= full.energy_drift_max).all()
    for one, whole, window, t_end in zip(
        early.window_amplitude, full.window_amplitude, early.window_t, early.t_end, strict=True
    ):
        # Those that were over.
        assert len(one) == t_end // window
        np.testing.assert_array_equal(one, whole[: len(one)])


def test_other_thresholds_give_the_types_of_runs_to_the_horizon(both: Path, tmp_path: Path) -> None:
    """An end is certain for any ss_growth, so that no threshold trusts it more than it may."""
    for k, sets in enumerate((["classify.ss_growth=1e-12"], ["classify.sw_departure=1e-6"])):
        for name in ("full", "early"):
            copy = tmp_path / f"{name}{k}"
            merge([both / name], copy)
            done = invoke("classify", copy, *(word for one in sets for word in ("--set", one)))
            assert done.exit_code == 0, done.stderr
        assert rows(tmp_path / f"early{k}").type.equals(rows(tmp_path / f"full{k}").type)
        assert verify(tmp_path / f"early{k}").problems == []


def test_it_is_no_threshold_and_another_sweep(both: Path) -> None:
    done = invoke("classify", both / "full", "--set", EARLY)
    assert_refused(done, 2, "early: it decides when runs end, which takes their integration")
    done = invoke("classify", both / "early", "--set", "classify.early=false")
    assert_refused(done, 2, "run the config again with it, into another directory")
    sets = [word for one in (*SETS, EARLY) for word in ("--set", one)]
    done = invoke("run", STEADY, *sets, "--set", "record=[energy, windows]", "-q",
                  "--output", both / "full")  # fmt: skip
    assert_refused(done, 2, "holds the runs of another config (classify.early: not set against tr")
    done = invoke("merge", both / "full", both / "early", "--output", both / "merged")
    assert_refused(done, 2, "classify.early: false against true")


def test_compare_takes_it_as_another_way_to_integrate(both: Path) -> None:
    done = invoke("compare", both / "full", both / "early", "--json")
    assert done.exit_code == 0, done.stderr
    said = json.loads(done.stdout)
    assert any(words.startswith("classify.early: false against true") for words in said["differ"])
    assert said["total"]["types"] == 0
    assert said["total"]["equal"] == said["total"]["reversing"] > 20


def test_the_same_content_however_it_is_run(both: Path, tmp_path: Path) -> None:
    sets = ("record=[energy, windows]", EARLY)
    expected = content_hash(both / "early")
    assert expected != content_hash(both / "full")
    sweep(tmp_path / "blocks", *sets, "block_size=17", threads=most_threads())
    for index in range(2):
        sweep(tmp_path / "shards", *sets, "block_size=9", shard=Shard(index, 2), threads=1)
    for name in ("blocks", "shards"):
        assert content_hash(tmp_path / name) == expected
        assert verify(tmp_path / name, recompute=10).problems == []


def test_a_replay_goes_on_to_the_horizon(both: Path) -> None:
    source, full = Replay(both / "early"), rows(both / "full")
    early = rows(both / "early")
    row = early[ended(early, full)].iloc[-1]
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
    assert part.n_steps == one.n_steps


def test_errors_of_types_are_told_of_runs_that_end_early(tmp_path: Path) -> None:
    sets = ("record=[error]", "spin.n_i=[-0.5]")
    for name, more in (("full", ()), ("early", (EARLY,))):
        sweep(tmp_path / name, *sets, *more)
    full, early = rows(tmp_path / "full"), rows(tmp_path / "early")
    some = ended(early, full)
    assert some.sum() > 5
    assert early.type_sure[some].all()
    assert early.type.equals(full.type)
    pd.testing.assert_frame_equal(early[~some], full[~some], check_exact=True)


def test_from_python(tmp_path: Path) -> None:
    bodies = {"source": "preset", "name": "GH", "overrides": {"theta": 0.95}}
    config = {
        "bodies": bodies,
        "spin": {"n_i": [-0.5], "omega_xy0": 0.001},
        "horizon": {"t": 2000.0},
    }
    full = rs.sweep(config, output=tmp_path / "full").runs.iloc[0]
    early = rs.sweep(config | {"classify": {"early": True}}, output=tmp_path / "early").runs.iloc[0]
    assert (full.type, full.t_end) == ("SS", 2000)
    assert (early.type, early.t_end < 1000) == ("SS", True)
    # The mirror image is stable in the other direction.
    table = tmp_path / "mirrored.csv"
    pd.DataFrame([early[["alpha", "beta", "gamma", "theta", "phi"]]]).assign(xi=-early.xi).to_csv(
        table, index=False
    )
    mirrored = config | {"bodies": {"source": "table", "path": str(table)}}
    mirrored |= {"spin": {"n_i": 0.5, "omega_xy0": 0.001}, "classify": {"early": True}}
    found = rs.sweep(mirrored, output=tmp_path / "mirrored").runs.iloc[0]
    assert found.type == "SS"
    assert found.t_end == pytest.approx(early.t_end, rel=1e-2)
    assert found.n_end == pytest.approx(-early.n_end, rel=1e-12)


@pytest.mark.slow
def test_many_runs(tmp_path: Path) -> None:
    """A share of what benchmarks/early.py does on all of ``configs/steady.yaml``, another draw."""
    sets = ["bodies.samples=100", "seed=11"]
    for name, more in (("full", []), ("early", [EARLY])):
        run_sweep(make_plan(load_config(STEADY, [*sets, *more])), tmp_path / name)
    full, early = rows(tmp_path / "full"), rows(tmp_path / "early")
    assert len(full) == 12_000
    assert early.type.equals(full.type)
    assert (full.amp_growth[ended(early, full)] <= 0).all()
    assert early.n_steps.sum() < 0.9 * full.n_steps.sum()


@pytest.mark.slow
def test_bodies_of_any_kind(tmp_path: Path) -> None:
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
    table = pd.DataFrame(columns)[n_c1 > -3]
    table.to_csv(tmp_path / "bodies.csv", index=False)
    bodies = {"source": "table", "path": str(tmp_path / "bodies.csv")}
    config = {"bodies": bodies, "horizon": {"t_rgh": 5, "t": 50_000.0}}
    full = rs.sweep(config, output=tmp_path / "full").runs
    early = rs.sweep(config | {"classify": {"early": True}}, output=tmp_path / "early").runs
    some = ended(early, full)
    assert len(full) > 9_000
    assert some.sum() > 0.3 * len(full)
    assert early.type.equals(full.type)
    assert (full.amp_growth[some] <= 0).all()
