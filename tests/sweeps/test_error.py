"""`record: [error]`: reversal times with their errors, types that are sure, and the same bits."""

from __future__ import annotations

from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pytest

from rattlesweep.integrate.batch import Batch, Control, Outcome
from rattlesweep.integrate.model import FULL, MODELS
from rattlesweep.integrate.status import Status
from rattlesweep.physics import full
from rattlesweep.study.onerun.replay import Replay
from rattlesweep.sweeps.blocks import block as blocks
from rattlesweep.sweeps.blocks import error
from rattlesweep.sweeps.blocks.block import Interrupted, finish_block, prepare_block, prepare_runs
from rattlesweep.sweeps.cases.plan import Plan, make_plan
from rattlesweep.sweeps.cases.shards import Shard
from rattlesweep.sweeps.config.load import load_config
from rattlesweep.sweeps.engines.run import run_sweep
from rattlesweep.sweeps.inspect.content_hash import content_hash
from rattlesweep.sweeps.inspect.retype import retype
from rattlesweep.sweeps.inspect.status import describe, status_of
from rattlesweep.sweeps.inspect.summary import closing_table
from rattlesweep.sweeps.inspect.verify import verify
from rattlesweep.sweeps.store.store import Store
from rattlesweep.sweeps.tables.arrow import build_table
from rattlesweep.sweeps.tables.columns import RUNS, runs_schema
from rattlesweep.sweeps.tables.types import SS, SW, UNCLASSIFIED, R, sure_types

CONFIG = Path(__file__).parents[2] / "configs" / "quickstart.yaml"
SETS = (
    "bodies.samples=8",
    "bodies.target={K_r: [0.02], rel_tol: 0.1}",
    "spin.n_i=[-0.1, -0.5, 0.2]",
    "horizon={t_rgh: 5, t: 3000}",
)
COLUMNS = [column.name for column in RUNS["error"]]


def plan_of(*sets: str) -> Plan:
    return make_plan(load_config(CONFIG, ["record=[error]", *SETS, *sets]))


def sweep(output: Path, *sets: str, **options: Any) -> Any:
    return run_sweep(plan_of(*sets), output, **options)


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    output = tmp_path_factory.mktemp("whole") / "out"
    sweep(output, "block_size=7", threads=1)
    return output


def rows_of(directory: Path) -> pa.Table:
    store = Store(directory)
    return pa.Table.from_batches(store.iter_batches())


# ----------------------------------------------------------------------------- the formula

BODY = full.constants(13.04, 1.522, 12.28, 0.82, 0.036, -0.03)


def outcome(t_r: float, y: Any, near: int = 0) -> Outcome:
    """What became of one run."""
    values: dict[str, Any] = {part.name: np.array([np.nan]) for part in fields(Outcome)}
    counts = {"status": Status.OK, "n_steps": 4000, "near_tangencies": near, "n_rejected": 0}
    values |= {name: np.array([value]) for name, value in counts.items()}
    values |= {"t_r": np.array([t_r]), "y_end": np.array([y], float), "stopped": False}
    return Outcome(**values)


def estimate(companion: Outcome, t_r: float = 100.0) -> float:
    values: dict[str, Any] = {part.name: np.ones(1) for part in fields(Batch)}
    batch = Batch(**values | {"constants": np.array([BODY], float)})
    runs = outcome(t_r, STATE)
    fit = error.Fit(1.9, 100.0, 5.0, 0.01)
    return float(error.relative_error(batch, FULL, runs, companion, 1e-3, 1e-9, fit)[0])


STATE = [0.3, 0.1, 0.2, 0.4, 0.0]
FAR = [2.0 * value for value in STATE]  # as far from it as it is from rest


@pytest.mark.parametrize(
    ("companion", "expected"),
    [
        (outcome(100.0, STATE), 2e-9),
        # Together: in proportion to the tolerances.
        (outcome(100.0 * (1 + 1e-4), STATE), 2e-9 + 5 * 1e-3 * 1e-4),
        # Parted: the difference itself, and more where it is small by chance.
        (outcome(101.0, FAR), 2e-9 + 5 * (0.01 + 0.01 / 2)),
        (outcome(100.0, FAR), 2e-9 + 5 * 0.01 / 2),
        (outcome(900.0, FAR), 1.0),
        (outcome(np.nan, STATE), 1.0),
        (outcome(100.0, STATE, near=1), 2e-9 + 2 * np.pi / 100),
    ],
)
def test_the_estimate(companion: Outcome, expected: float) -> None:
    assert estimate(companion) == pytest.approx(expected, rel=1e-9)


def test_no_reversal_has_no_error() -> None:
    assert np.isnan(estimate(outcome(100.0, STATE), t_r=np.nan))


@pytest.mark.parametrize("name", ["full", "reduced"])
def test_distances_are_those_of_the_step_control(name: str) -> None:
    model = MODELS[name]
    rng = np.random.default_rng(5)
    y = rng.uniform(0.1, 1.0, (3, model.n_state))
    other = y + rng.normal(size=y.shape) / 100
    q = rng.uniform(1.0, 2.0, (3, model.n_constants))
    if name == "full":
        other[:, 4] = y[:, 4]
    found = error.distance(model, y, other, q)
    formula: Any = model.error
    for k in range(3):
        moved, size = formula(*(y - other)[k], *y[k], *q[k])
        assert found[k] ** 2 == pytest.approx(moved / size, rel=1e-12)


@pytest.mark.parametrize(
    ("setting", "companion"), [(1e-9, 2e-6), (1e-12, 2e-9), (1e-7, 1e-5), (1e-4, 1e-3)]
)
def test_settings_of_companions(setting: float, companion: float) -> None:
    assert error.companion_setting("dop853", setting) == pytest.approx(companion, rel=1e-12)
    assert error.companion_setting("rk4", setting) == 2 * setting


@pytest.mark.parametrize(
    ("code", "reversal", "growth", "departure", "errors", "sure"),
    [
        (R, True, 50.0, 1.0, (90.0, 0.0), True),
        (R, False, 50.0, 1.0, (0.0, 0.0), False),
        (SS, False, 1e-5, 1e-6, (1e-6, 1e-8), True),
        (SS, False, 1e-5, 1e-6, (2e-3, 1e-8), False),
        (SW, False, 300.0, 0.4, (90.0, 0.01), True),
        (SW, False, 300.0, 0.4, (4e3, 0.01), False),  # its companion may not have grown at all
        (SW, False, 300.0, 0.4, (90.0, 0.36), False),
        (SW, False, 300.0, 0.99, (90.0, 0.02), False),  # may cross zero
        (SW, False, 300.0, 0.4, (90.0, np.nan), False),  # its companion failed
        (UNCLASSIFIED, False, 0.1, 0.01, (0.01, 0.001), True),
        (UNCLASSIFIED, False, np.nan, 0.01, (np.nan, 0.001), True),
        (UNCLASSIFIED, False, 0.1, 0.04, (0.01, 0.02), False),
        (-1, True, 0.1, 0.01, (0.0, 0.0), False),
    ],
)
def test_sure_types(
    code: int, reversal: bool, growth: float, departure: float, errors: Any, sure: bool
) -> None:
    found = sure_types(
        np.array([code], np.int8),
        np.array([reversal]),
        (np.array([growth]), np.array([departure])),
        (np.array([errors[0]]), np.array([errors[1]])),
        plan_of().config.classify,
    )
    assert found.tolist() == [sure]


# ----------------------------------------------------------------------------- known runs


def test_a_sensitive_run_says_so_and_an_ordinary_one_does_not() -> None:
    plan = make_plan(load_config(CONFIG, ["record=[error]"]))
    columns = finish_block(plan.config, *prepare_runs(plan, np.array([0, 4]), np.array([1, 99])))
    t_r, told = columns["t_r"], columns["t_r_error"]
    # In 32 digits (benchmarks/double_double.py); docs/sensitive.md has its story.
    assert 1.0 < abs(t_r[1] - 2467.883536) <= told[1] < 0.5 * t_r[1]
    assert 0 < told[0] < 1e-6 * t_r[0]


# ----------------------------------------------------------------------------- a sweep


def test_columns_and_nulls(whole: Path, tmp_path: Path) -> None:
    rows = rows_of(whole)
    assert rows.schema.names == runs_schema(["error"]).names
    assert set(rows["type"].to_pylist()) > {"R", "SS"}
    assert rows["t_r_error"].is_null().equals(rows["t_r"].is_null())
    for name in ("amp_growth", "n_departure"):
        assert rows[f"{name}_error"].is_null().equals(rows[name].is_null())
    assert rows["type_sure"].null_count == 0
    share = pc.divide(rows["t_r_error"], rows["t_r"]).drop_null().to_numpy()
    assert ((share > 5e-10) & (share <= 1)).all()
    # What is there without it has the same bits.
    sweep(tmp_path, "record=[]", "block_size=7")
    assert rows_of(tmp_path).equals(rows.drop_columns(COLUMNS))


def test_one_content_however_it_is_cut_and_mended(whole: Path, tmp_path: Path) -> None:
    expected = content_hash(whole)
    for index in (1, 0):
        sweep(tmp_path / "shards", "block_size=3", shard=Shard(index, 2), threads=2 - index)
    # A limit that stops runs, but none of their companions; then the others again.
    limits = [f"integrator.max_steps={count}" for count in (300, 600, 100_000_000)]
    for limit in limits:
        report = sweep(tmp_path / "limits", "block_size=24", limit, retry_failed=True)
        failed = pc.not_equal(rows_of(tmp_path / "limits")["status"], "ok")
        for name in ("t_r_error", "type_sure", "n_departure_error", "amp_growth_error"):
            some = rows_of(tmp_path / "limits")[name].filter(failed)
            assert some.null_count == len(some) == report.failed["step_limit"]
    for name in ("shards", "limits"):
        assert content_hash(tmp_path / name) == expected
        assert verify(tmp_path / name, recompute=5, seed=1).problems == []
        summary = (tmp_path / name / "summary.parquet").read_bytes()
        assert summary == (whole / "summary.parquet").read_bytes()


@pytest.mark.parametrize("after", [0, 1])
def test_a_stop_leaves_whole_rows(after: int, whole: Path, monkeypatch: Any) -> None:
    """Asked for before the companions are integrated, or after it and before the runs are."""
    plan, control = plan_of("block_size=24"), Control()

    def stopping(module: Any) -> None:
        integrate = module.integrate

        def stopped(*args: Any, **kwargs: Any) -> Outcome:
            control.stop()
            found: Outcome = integrate(*args, **kwargs)
            return found

        monkeypatch.setattr(module, "integrate", stopped)

    stopping(blocks if after else error)
    with pytest.raises(Interrupted) as stop:
        finish_block(plan.config, *prepare_block(plan, plan.block(0)), threads=1, control=control)
    assert stop.value.lost > 0
    schema = runs_schema(["error"])
    if stop.value.columns is not None:
        some = build_table(stop.value.columns, schema)
        rows = rows_of(whole)
        place = pc.add(pc.multiply(pc.cast(some["case"], pa.int64()), 8), some["sample"])
        assert some.equals(rows.take(place))


def test_a_run_whose_companion_was_cut_does_not_count() -> None:
    plan = plan_of()
    _, batch = prepare_runs(plan, np.array([2]), np.array([0]))
    assert batch is not None
    found = blocks.run_batch(plan.config.model_copy(update={"record": []}), batch)
    cut = replace(found, status=np.array([Status.STOPPED]), stopped=True)
    both = error.with_errors(plan.config, batch, found, cut)
    assert both.status.tolist() == [Status.STOPPED]
    assert both.stopped


def test_classify_tells_again_which_types_are_sure(whole: Path, tmp_path: Path) -> None:
    rows = rows_of(whole).to_pandas()
    near = rows[rows["type"].isin(["SW", "unclassified"])].iloc[0]
    assert near["type_sure"]
    # So near its value that its companion may be on the other side.
    sw_departure = float(near["n_departure"] + near["n_departure_error"] / 2)
    sets = (f"classify.sw_departure={sw_departure!r}", "classify.ss_growth=1e-8")
    sweep(tmp_path / "fresh", *sets, "block_size=7")
    sweep(tmp_path / "again", "block_size=7")
    assert content_hash(tmp_path / "again") == content_hash(whole)
    assert retype(tmp_path / "again", sets).changed > 0
    assert content_hash(tmp_path / "again") == content_hash(tmp_path / "fresh")
    assert not rows_of(tmp_path / "again")["type_sure"][near.name].as_py()
    assert verify(tmp_path / "again").problems == []


# ----------------------------------------------------------------------------- what is told


@pytest.fixture(scope="module")
def marked(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A sweep at a tolerance so loose that some runs are sensitive."""
    output = tmp_path_factory.mktemp("marked") / "out"
    sweep(output, "integrator.tol=1e-4")
    return output


def test_counts_in_summary_status_and_closing_table(marked: Path, whole: Path) -> None:
    rows, summary = rows_of(marked).to_pandas(), Store(marked).read_summary()
    reversing = rows[rows["type"] == "R"]
    large = reversing[reversing["t_r_error"] > 1e-6 * reversing["t_r"]]
    unsure = rows[rows["type_sure"] == False]  # noqa: E712
    assert len(large) > 0
    by_case = [(large["case"] == k).sum() for k in range(len(summary))]
    assert summary["sensitive"].to_pylist() == by_case
    assert sum(summary["unsure"].to_pylist()) == len(unsure)
    means = reversing.groupby("case")["t_r_error"].mean()
    found = summary["t_r_mean_error"].drop_null().to_numpy()
    assert found == pytest.approx(means.to_numpy(), rel=1e-12)
    status = status_of(marked)
    assert (status.sensitive, status.unsure) == (len(large), len(unsure))
    assert f"errors   {len(large)} sensitive" in describe(status)
    assert closing_table(summary).split("\n")[0].split()[-3:] == ["sens.", "unsure", "fail"]


def test_without_it_nothing_is_said(tmp_path: Path) -> None:
    sweep(tmp_path, "record=[]", "spin.n_i=[0.2]")
    summary, status = Store(tmp_path).read_summary(), status_of(tmp_path)
    for name in ("sensitive", "unsure", "t_r_mean_error"):
        assert summary[name].null_count == len(summary)
    assert status.sensitive is status.unsure is None
    assert "sensitive" not in describe(status)
    assert "sens." not in closing_table(summary)


def test_replay_says_it_of_a_run(marked: Path) -> None:
    found = Replay(marked).select(where="t_r_error > 1e-6 * t_r and type_sure = true", first=2)
    for run in found:
        assert f"t_r {run.t_r!r} +- {run.t_r_error:.2g} (sensitive) and type R as" in run.proof
    Replay(marked).prove(found[0])
