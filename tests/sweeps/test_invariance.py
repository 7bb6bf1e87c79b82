"""One content, however a sweep is cut, shared, ordered, stopped or mended; under the full model."""

from __future__ import annotations

import random
import shutil
from functools import partial
from pathlib import Path

import pytest
import sweeping
from stopping import Stop, after
from sweeping import proved

from rattlesweep.integrate.batch import most_threads
from rattlesweep.sweeps.shards import Shard
from rattlesweep.sweeps.old import local
from rattlesweep.sweeps.old.session import Session
from rattlesweep.sweeps.old.merge import merge

SETS = (
    "bodies.samples=8",
    "bodies.target={K_r: [0.02, 0.1], rel_tol: 0.1}",
    "spin.n_i=[-0.1, -0.3, -0.5]",
)
RUNS = 48


def sweep(output, *sets, **options):
    return sweeping.sweep(output, "quickstart.yaml", *SETS, *sets, **options)


def contents(output: Path) -> tuple[str, bytes]:
    """All rows as one number, and the summary, of a directory that proves whole."""
    return proved(output), (output / "summary.parquet").read_bytes()


@pytest.fixture(scope="module")
def expected(tmp_path_factory) -> tuple[str, bytes]:
    output = tmp_path_factory.mktemp("expected") / "out"
    report = sweep(output, "block_size=7", threads=1)
    assert report.runs == RUNS
    assert not report.failed
    return contents(output)


@pytest.mark.parametrize(("size", "threads"), [(1, 2), (16, 1), (47, 2), (1000, 1)])
def test_blocks_and_threads_and_the_order_of_blocks(size, threads, expected, tmp_path):
    order = []

    def shuffled(session: Session) -> None:
        random.Random(1).shuffle(session.pending)
        order.extend(block.index for block in session.pending)
        local.work_off(session)

    sweep(tmp_path, f"block_size={size}", threads=min(threads, most_threads()), engine=shuffled)
    assert contents(tmp_path) == expected
    assert (order != sorted(order)) == (size < RUNS)


def test_shards_in_one_directory_and_in_their_own(expected, tmp_path):
    shared, count = tmp_path / "shared", 5
    parts = [tmp_path / str(index) for index in range(count)]
    reports = []
    for index in random.Random(count).sample(range(count), count):
        share = partial(sweep, shard=Shard(index, count))
        reports.append(share(shared, "block_size=3"))
        share(parts[index], "block_size=3")
    assert contents(shared) == expected
    assert sum(report.runs for report in reports) == RUNS
    assert [report.summary is not None for report in reports] == [False] * (count - 1) + [True]
    merge(parts, tmp_path / "merged")
    assert contents(tmp_path / "merged") == expected


def test_shares_of_different_deals_leave_nothing_out(expected, tmp_path):
    """Who forgets how many shares there were gets the rest by running everything."""
    sweep(tmp_path, "block_size=3", shard=Shard(1, 2))
    sweep(tmp_path, "block_size=3", shard=Shard(0, 7))
    assert 0 < sweep(tmp_path, "block_size=3").resumed_runs < RUNS
    assert contents(tmp_path) == expected


def test_resumed_again_and_again_and_moved_in_between(expected, tmp_path):
    output = tmp_path / "0"
    for done in range(0, 8, 2):
        with pytest.raises(Stop):
            sweep(output, "block_size=5", engine=after(2), threads=1 + done // 2 % 2)
        assert len(list(output.glob("runs/*.parquet"))) == done + 2
        output = Path(shutil.move(output, tmp_path / str(done + 2)))
    assert sweep(output, "block_size=5").resumed_runs == 40
    assert contents(output) == expected


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
    failed = [RUNS]
    for steps in (1000, 4000):
        limit = f"integrator.max_steps={steps}"
        report = sweep(tmp_path, "block_size=5", limit, retry_failed=len(failed) > 1)
        assert report.retried == (failed[-1] if len(failed) > 1 else 0)
        failed.append(report.failed["step_limit"])
    assert RUNS > failed[1] > failed[2] > 0
    proved(tmp_path)
    report = sweep(tmp_path, "block_size=5", retry_failed=True)
    assert report.retried == failed[2]
    assert not report.failed
    assert contents(tmp_path) == expected
