"""One content, however a sweep is cut, shared, ordered, stopped or mended; under the full model."""

from __future__ import annotations

import random
import shutil
from pathlib import Path
from typing import Any

import pytest
from stopping import Stop, after

from rattlesweep.integrate.batch import most_threads
from rattlesweep.sweeps.cases.plan import make_plan
from rattlesweep.sweeps.cases.shards import Shard
from rattlesweep.sweeps.config.load import load_config
from rattlesweep.sweeps.engines import local
from rattlesweep.sweeps.engines.run import run_sweep
from rattlesweep.sweeps.engines.session import Session
from rattlesweep.sweeps.inspect.content_hash import content_hash
from rattlesweep.sweeps.inspect.merge import merge
from rattlesweep.sweeps.inspect.verify import verify

CONFIG = Path(__file__).parents[2] / "configs" / "quickstart.yaml"
SETS = (
    "bodies.samples=8",
    "bodies.target={K_r: [0.02, 0.1], rel_tol: 0.1}",
    "spin.n_i=[-0.1, -0.3, -0.5]",
)
RUNS = 48


def sweep(output: Path, *sets: str, **options: Any) -> Any:
    """Run the sweep with some more settings."""
    return run_sweep(make_plan(load_config(CONFIG, [*SETS, *sets])), output, **options)


def contents(output: Path) -> tuple[str, bytes]:
    """All rows as one number, and the summary, of a directory that proves whole."""
    assert verify(output).problems == []
    return content_hash(output), (output / "summary.parquet").read_bytes()


@pytest.fixture(scope="module")
def expected(tmp_path_factory: pytest.TempPathFactory) -> tuple[str, bytes]:
    output = tmp_path_factory.mktemp("expected") / "out"
    report = sweep(output, "block_size=7", threads=1)
    assert report.runs == RUNS
    assert not report.failed
    return contents(output)


@pytest.mark.parametrize(
    ("size", "threads"), [(1, 2), (5, 1), (16, 2), (47, 1), (48, 2), (1000, 1)]
)
def test_blocks_and_threads(size, threads, expected, tmp_path):
    if threads > most_threads():
        pytest.skip("there is one processor")
    sweep(tmp_path, f"block_size={size}", threads=threads)
    assert contents(tmp_path) == expected


def test_the_order_of_blocks(expected, tmp_path):
    order = []

    def shuffled(session: Session) -> None:
        random.Random(1).shuffle(session.pending)
        order.extend(block.index for block in session.pending)
        local.work_off(session)

    sweep(tmp_path, "block_size=5", engine=shuffled)
    assert order != sorted(order)
    assert contents(tmp_path) == expected


@pytest.mark.parametrize("count", [1, 7])
def test_shards_in_one_directory(count, expected, tmp_path):
    reports = []
    for index in random.Random(count).sample(range(count), count):
        reports.append(sweep(tmp_path, "block_size=3", shard=Shard(index, count)))
    assert contents(tmp_path) == expected
    assert sum(report.runs for report in reports) == RUNS
    assert [report.summary is not None for report in reports] == [False] * (count - 1) + [True]


def test_shards_in_directories_of_their_own(expected, tmp_path):
    parts = [tmp_path / str(index) for index in range(3)]
    for index, part in enumerate(parts):
        sweep(part, "block_size=3", shard=Shard(index, 3))
    merge(parts, tmp_path / "merged")
    assert contents(tmp_path / "merged") == expected


def test_shares_of_different_deals_leave_nothing_out(expected, tmp_path):
    """Who forgets how many shares there were gets the rest by running everything."""
    sweep(tmp_path, "block_size=3", shard=Shard(1, 2))
    sweep(tmp_path, "block_size=3", shard=Shard(0, 7))
    report = sweep(tmp_path, "block_size=3")
    assert 0 < report.resumed_runs < RUNS
    assert contents(tmp_path) == expected


def test_resumed_again_and_again(expected, tmp_path):
    for done in range(0, 8, 2):
        with pytest.raises(Stop):
            sweep(tmp_path, "block_size=5", engine=after(2), threads=1 + done // 2 % 2)
        assert len(list(tmp_path.glob("runs/*.parquet"))) == done + 2
    report = sweep(tmp_path, "block_size=5")
    assert report.resumed_runs == 40
    assert contents(tmp_path) == expected


def test_blocks_that_were_lost_are_the_same_again(expected, tmp_path):
    sweep(tmp_path, "block_size=5")
    for seed in range(2):
        rng = random.Random(seed)
        for path in rng.sample(sorted(tmp_path.glob("runs/*.parquet")), 4):
            path.unlink()
        if seed % 2:
            (tmp_path / "manifest.json").unlink()
        sweep(tmp_path, "block_size=5", threads=rng.choice([1, min(2, most_threads())]))
        assert contents(tmp_path) == expected


def test_runs_that_failed_and_were_done_again(expected, tmp_path):
    limits = ("integrator.max_steps=1000", "integrator.max_steps=4000")
    failed = [sweep(tmp_path, "block_size=5", limits[0]).failed["step_limit"]]
    report = sweep(tmp_path, "block_size=5", limits[1], retry_failed=True)
    assert report.retried == failed[0]
    failed.append(report.failed["step_limit"])
    assert RUNS > failed[0] > failed[1] > 0
    assert verify(tmp_path).problems == []
    report = sweep(tmp_path, "block_size=5", retry_failed=True)
    assert report.retried == failed[1]
    assert not report.failed
    assert contents(tmp_path) == expected


def test_types_that_were_changed_and_changed_back(expected, tmp_path):
    sweep(tmp_path, "block_size=5", "classify.sw_departure=0.9")
    assert contents(tmp_path)[0] != expected[0]
    sweep(tmp_path, "block_size=5")
    assert contents(tmp_path) == expected


def test_a_sweep_that_was_moved(expected, tmp_path):
    with pytest.raises(Stop):
        sweep(tmp_path / "here", "block_size=5", engine=after(3))
    shutil.move(tmp_path / "here", tmp_path / "there")
    assert sweep(tmp_path / "there", "block_size=5").resumed_runs == 15
    assert contents(tmp_path / "there") == expected
