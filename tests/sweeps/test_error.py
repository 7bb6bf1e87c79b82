"""`record: [error]`, `accuracy: {t_r}`: reversal times with their errors, types that are sure."""

from __future__ import annotations

from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pytest
from test_run import invoke

from rattlesweep.integrate.batch import Batch, Control, Outcome, integrate
from rattlesweep.integrate.model import FULL, MODELS
from rattlesweep.integrate.status import Status
from rattlesweep.integrate.tableau import DOP853, METHODS
from rattlesweep.physics import full
from rattlesweep.study.onerun.course import Course
from rattlesweep.study.onerun.replay import Replay, cause_of
from rattlesweep.study.plots.fractions import UNSURE
from rattlesweep.study.plots.layout import read_layout
from rattlesweep.study.plots.registry import read_picture
from rattlesweep.study.style import styled
from rattlesweep.sweeps.blocks import block as blocks
from rattlesweep.sweeps.blocks import error
from rattlesweep.sweeps.blocks.block import Interrupted, finish_block, prepare_block, prepare_runs
from rattlesweep.sweeps.cases.plan import Plan, make_plan
from rattlesweep.sweeps.cases.shards import Shard
from rattlesweep.sweeps.config.load import load_config
from rattlesweep.sweeps.engines.run import run_sweep
from rattlesweep.sweeps.forecast.pilot import Pilot
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
GOAL = "integrator={accuracy: {t_r: 1.0e-7}}"
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


@pytest.fixture(scope="module")
def kept(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A sweep whose reversal times are asked to be accurate."""
    output = tmp_path_factory.mktemp("kept") / "out"
    sweep(output, GOAL, "record=[]", "block_size=7", threads=1)
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


def estimate(companion: Outcome, t_r: float = 100.0, before: float = 0.0) -> float:
    values: dict[str, Any] = {part.name: np.ones(1) for part in fields(Batch)}
    batch = Batch(**values | {"constants": np.array([BODY], float)})
    runs = outcome(t_r, STATE)
    fit = error.Fit(1.9, 100.0, 5.0, 0.01)
    apart = error.how_far_apart(batch, FULL, runs, companion)
    found = error.relative_error(
        batch, runs, companion, apart, DOP853, (1e-9, 1e-6), np.array([before]), fit
    )
    return float(found[0])


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


def test_a_companion_that_had_parted_from_its_own_tells_less() -> None:
    near = outcome(100.0 * (1 + 1e-4), STATE)
    assert estimate(near, before=0.04) == pytest.approx(2e-9 + 5 * 0.1 * 0.04 * 1e-4, rel=1e-9)
    assert estimate(near, before=1.0) == pytest.approx(2e-9 + 5 * 0.1 * 1e-4, rel=1e-9)
    assert estimate(near, before=0.001) == estimate(near)


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


@pytest.mark.parametrize(("goal", "after"), [("", 0), ("", 1), (GOAL, 0), (GOAL, 1), (GOAL, 2)])
def test_a_stop_leaves_whole_rows(
    goal: str, after: int, whole: Path, kept: Path, monkeypatch: Any
) -> None:
    """Asked for before the companions are integrated, the runs, or those that are done again."""
    plan, control = plan_of("block_size=24", *([goal] if goal else [])), Control()
    real, calls = error.integrate, []

    def stopping(*args: Any, **kwargs: Any) -> Outcome:
        if len(calls) == after:
            control.stop()
        calls.append(len(args[0]))
        found: Outcome = real(*args, **kwargs)
        return found

    monkeypatch.setattr(error, "integrate", stopping)
    with pytest.raises(Interrupted) as stop:
        finish_block(plan.config, *prepare_block(plan, plan.block(0)), threads=1, control=control)
    assert stop.value.lost > 0
    if after == 2:
        # Those that need not be done again are there.
        assert stop.value.columns is not None
        assert stop.value.lost <= calls[2] < calls[1]
        assert control.runs_done >= 24 - calls[2]
    if stop.value.columns is not None:
        some = build_table(stop.value.columns, runs_schema(plan.config.parts))
        rows = rows_of(kept if goal else whole)
        place = pc.add(pc.multiply(pc.cast(some["case"], pa.int64()), 8), some["sample"])
        assert some.equals(rows.take(place))


def test_a_run_whose_companion_was_cut_does_not_count() -> None:
    plan = plan_of()
    _, batch = prepare_runs(plan, np.array([2]), np.array([0]))
    assert batch is not None
    found = blocks.run_batch(plan.config.model_copy(update={"record": []}), batch)
    cut = replace(found, status=np.array([Status.STOPPED]), stopped=True)
    both = error.with_errors(plan.config, batch, found, cut, (1e-9, 2e-6))
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


def test_types_that_are_not_sure_are_hatched(marked: Path, whole: Path) -> None:
    pale: dict[Path, list[float]] = {}
    for directory in (marked, whole):
        with styled():
            figure = read_picture(read_layout(directory), "fractions").figure()
        patches = [patch for axes in figure.axes for patch in axes.patches]
        pale[directory] = [p.get_height() for p in patches if p.get_hatch() == UNSURE["hatch"]]
    rows = rows_of(marked).to_pandas()
    cells = rows[rows["status"] == "ok"].groupby(["case", "type"])
    expected = cells["type_sure"].apply(lambda sure: (sure == False).sum())  # noqa: E712
    ok = rows[rows["status"] == "ok"].groupby("case").size()
    shares = sorted(expected[expected > 0] / ok[expected[expected > 0].index.get_level_values(0)])
    assert sorted(h for h in pale[marked] if h > 0) == pytest.approx(shares)
    assert len(shares) > 0
    assert not any(pale[whole])


@pytest.mark.parametrize(
    ("changes", "n_i", "words"),
    [
        ({"grazes": 1, "t_r_error": 6.0}, -0.5, "it grazes zero: an extremum of its spin so near"),
        ({"grazes": 3, "t_r_error": 6.0}, 0.5, "it grazes zero: 3 extrema of its spin so near"),
        # A zero that is a swing off does not explain more than that.
        ({"grazes": 1, "t_r_error": 900.0, "apart": 1.5}, -0.5, "a delayed loss of stability: "),
        ({"companion_t_r": np.nan}, -0.5, "it may not reverse: at tol 2e-06 it does not"),
        (
            {"apart": 1.2, "t_r_error": 90.0}, -0.5,
            "a delayed loss of stability: at tol 2e-06 it reverses at 95 instead of 100, with "
            "states that are 1.2 of the oscillation apart, 6e+05 times that tol",
        ),
        ({"apart": 1.2, "t_r_error": 90.0}, 0.5, "chaos: at tol 2e-06 it reverses at 95 instead"),
        (
            {"apart": 1.2, "t_r_error": 90.0, "companion_tol": np.nan}, 0.5,
            "chaos: in steps twice as long it reverses at 95 instead of 100, with states that are "
            "1.2 of the oscillation apart",
        ),
        ({"apart": 0.01}, -0.5, "errors that a tighter tolerance makes smaller: at tol 2e-06"),
    ],
)  # fmt: skip
def test_causes_in_words(changes: dict[str, float], n_i: float, words: str) -> None:
    told = {"t_r_error": 1.0, "companion_t_r": 95.0, "companion_tol": 2e-6, "apart": 0.0,
            "grazes": 0, **changes}  # fmt: skip
    base = outcome(100.0, STATE)
    rest: dict[str, Any] = {part.name: np.array([np.nan]) for part in fields(error.Estimated)}
    rest |= {part.name: getattr(base, part.name) for part in fields(Outcome)}
    found = error.Estimated(**rest | {name: np.array([value]) for name, value in told.items()})
    said = cause_of(found, 4.0, n_i)
    assert said.startswith(words)
    assert "nan" not in said


def test_the_command_line_says_the_cause(marked: Path, whole: Path, tmp_path: Path) -> None:
    where = ["--where", "t_r_error > 0.01 * t_r and type_sure = true"]
    (run,) = Replay(marked).select(where=where[1])
    cause = Replay(marked).cause(run)
    assert f"{run.name}: " in cause
    shown = invoke("replay", marked, *where, "--output", tmp_path / "a.csv", "--points", 9)
    assert cause in shown.stderr
    page = tmp_path / "a.html"
    shown = invoke("show", "--from", marked, *where, "--output", page, "--points", 300)
    assert cause in shown.stderr
    assert '["sensitive", "' in page.read_text()
    (quiet,) = Replay(whole).select(where="t_r_error < 0.000001 * t_r")
    assert Replay(whole).cause(quiet) == ""


# ----------------------------------------------------------------------------- an error asked for


@pytest.mark.parametrize(
    ("goal", "expected"),
    [
        (1e-6, [1e-4, 3e-7, 3e-9, 3e-11]),
        (1e-9, [6e-7, 3e-10, 3e-12, 3e-14]),
        (1e-3, [1e-4, 1e-6, 1e-8, 1e-10]),
        (1e-12, [6e-10, 3e-13, 1e-14]),
    ],
)
def test_tolerances_for_an_error(goal: float, expected: list[float]) -> None:
    settings = plan_of(f"integrator={{accuracy: {{t_r: {goal}}}}}").config.integrator
    assert error.ladder(settings) == pytest.approx(expected, rel=1e-12)
    assert len(error.prices(settings)) == len(expected)


def test_runs_have_the_error_that_is_asked_for(kept: Path, whole: Path) -> None:
    rows, plain = rows_of(kept).to_pandas(), rows_of(whole).to_pandas()
    assert list(rows) == runs_schema(["error", "tol"]).names == [*plain, "tol"]
    reversing = rows[rows["type"] == "R"]
    assert (reversing["t_r_error"] <= 1e-7 * reversing["t_r"]).all()
    # Each with a tolerance of its own, and fewer the tighter.
    levels = rows["tol"].value_counts()
    assert levels.index.tolist() == pytest.approx([3e-8, 3e-10, 3e-12])
    # Against runs whose own error is a tenth of what is asked for.
    better = plain["t_r_error"] < 1e-8 * plain["t_r"]
    off = (rows["t_r"] / plain["t_r"] - 1).abs()[better]
    assert len(off) >= 5
    assert off.max() <= 1.1e-7
    assert (rows["type"] == plain["type"]).all()


def test_one_content_with_an_error_asked_for(kept: Path, tmp_path: Path) -> None:
    expected = content_hash(kept)
    for index in (1, 0):
        sweep(tmp_path / "shards", GOAL, "block_size=3", shard=Shard(index, 2), threads=2 - index)
    for limit in (300, 600, 100_000_000):
        goal = f"integrator={{accuracy: {{t_r: 1e-7}}, max_steps: {limit}}}"
        sweep(tmp_path / "limits", "block_size=24", goal, retry_failed=True)
    for name in ("shards", "limits"):
        assert content_hash(tmp_path / name) == expected
        assert verify(tmp_path / name, recompute=24, seed=1).problems == []


def test_replay_takes_the_tolerance_of_the_run(kept: Path) -> None:
    replay = Replay(kept)
    for level in ("tol > 1e-9", "tol < 1e-9"):
        (run,) = replay.select(where=f"type = 'R' and {level}")
        replay.prove(run)
        course = Course(replay.prepare(run))
        course.columns()
        assert course.integrator["tol"] == run.tol
        assert course.zeros[0] == run.t_r
        run.check(course)


def test_a_sensitive_run_is_done_again_and_marked() -> None:
    goal = "integrator={accuracy: {t_r: 1e-6}}"
    plan = make_plan(load_config(CONFIG, [goal]))
    columns = finish_block(plan.config, *prepare_runs(plan, np.array([0, 4]), np.array([1, 99])))
    t_r, told = columns["t_r"], columns["t_r_error"]
    assert columns["tol"] == pytest.approx([3e-9, 3e-11])
    assert abs(t_r[1] - 2467.883536) <= told[1]
    assert told[1] > 1e-6 * t_r[1]
    assert told[0] <= 1e-6 * t_r[0]


def test_a_run_that_fails_or_reverses_in_one_only_is_done_again() -> None:
    plan = plan_of(GOAL)
    _, batch = prepare_runs(plan, np.array([2]), np.array([0]))
    assert batch is not None
    told = blocks.run_batch(plan.config, batch)
    assert isinstance(told, error.Estimated)
    nothing, one = np.array([np.nan]), np.array([1.0])
    for changes, again in (
        ({"t_r": one, "t_r_error": one * 1e-8}, False),
        ({"t_r": one, "t_r_error": one * 1e-6}, True),
        ({"t_r": nothing, "t_r_error": nothing, "companion_t_r": one}, True),
        ({"t_r": nothing, "t_r_error": nothing, "companion_t_r": nothing}, False),
        ({"status": np.array([Status.ENERGY])}, True),
        ({"status": np.array([Status.STEP_LIMIT])}, False),
        ({"status": np.array([Status.STOPPED])}, False),
    ):
        assert error._to_be_done_again(replace(told, **changes), 1e-7).tolist() == [again]


def test_progress_of_kernels_in_turn() -> None:
    """Companions move it on, but begin and end no run; redone runs end late."""
    control, seen, runs = Control(), [], []

    def kernel(share: float, ended: int, begun: int = 0) -> None:
        control.total = control._cost = 10.0
        control._runs, control._shared[0] = 8, begun
        control._progress = np.array([[10 * share, 0.0, ended]])
        seen.append(control.done / control.total)
        runs.append((control.runs_begun, control.runs_done))

    control.stage(0.0, 0.2)
    kernel(0.5, 3, 5)
    kernel(1.0, 8, 9)
    control.stage(0.2, 0.7, begins=True)
    seen.append(control.done / control.total)
    kernel(0.5, 3, 5)
    kernel(1.0, 8, 9)
    control.settle(6)
    control.stage(0.7, 1.0)
    kernel(1.0, 2, 2)
    control.settle(2)
    assert seen == pytest.approx([0.1, 0.2, 0.2, 0.45, 0.7, 1.0])
    assert runs == [(0, 0), (0, 0), (5, 0), (8, 0), (8, 6)]
    assert (control.runs_begun, control.runs_done) == (8, 8)


def test_a_forecast_knows_what_an_error_costs() -> None:
    prices = []
    for sets in (["integrator={tol: 3.0e-8}", "record=[]"], [GOAL]):
        pilot = Pilot(plan_of(*sets), threads=1)
        pilot.run(0.5)
        prices.append(pilot._price)
    assert prices[0] == 1.0
    assert 1.3 < prices[1] < 4.0


@pytest.mark.slow
def test_quickstart_keeps_its_promise() -> None:
    """No run that is not marked is off by more: against order 9 at 1e-14."""
    plan = make_plan(load_config(CONFIG, ["integrator={accuracy: {t_r: 1e-6}}"]))
    numbers = np.divmod(np.arange(plan.runs), plan.samples)
    _, batch = prepare_runs(plan, *numbers)
    assert batch is not None
    found = blocks.run_batch(plan.config, batch)
    assert isinstance(found, error.Estimated)
    true = integrate(batch, METHODS["verner98"], FULL, tol=1e-14).t_r
    off = np.abs(found.t_r / true - 1)
    marked = found.t_r_error > 1e-6 * found.t_r
    known = np.isfinite(found.t_r)
    assert known.sum() > 4800
    assert marked.sum() < 100
    assert not (known & ~marked & ~(off <= 1e-6)).any()
    # One without a reversal that should have one does not say that it is sure.
    sure = build_table(
        blocks.columns_of(plan.config, prepare_runs(plan, *numbers)[0], batch, found),
        runs_schema(plan.config.parts),
    )["type_sure"].to_numpy()
    assert not (np.isfinite(true) & ~known & sure).any()
