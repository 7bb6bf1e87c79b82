"""Ways to stop: a time that is up, and Ctrl-C at any moment and twice."""

from __future__ import annotations

import fcntl
import re
import shutil
import signal
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pyarrow.parquet as pq
import pytest
import sweeping
from hardship import (
    Reference,
    blocks_of,
    check_finished,
    check_goes_on,
    check_whole,
    everything_in,
    manifest,
    nursery,
    tiny,
    trace,
    wait_until,
)
from refusal import assert_refused
from syscalls import CHANGES

from rattlesweep.errors import OutputError
from rattlesweep.integrate import task
from rattlesweep.integrate.batch import available_threads
from rattlesweep.sweeps.shards import Shard
from rattlesweep.sweeps.old import local
from rattlesweep.sweeps.old.progress import Progress
from rattlesweep.sweeps.old.merge import merge
from rattlesweep.sweeps.old.retype import retype
from rattlesweep.sweeps.old.status import status_of
from rattlesweep.sweeps.old.verify import verify

GOES_ON = "the same command resumes from there"


@pytest.fixture(scope="module")
def tiny_sweep(tmp_path_factory) -> tuple[Path, Reference]:
    """A config of four blocks, and its sweep."""
    folder = tmp_path_factory.mktemp("sweep")
    config = tiny(folder, block_size=6)
    assert nursery().run("run", config, "--output", folder / "out", "-q").code == 0
    return config, Reference.of(folder / "out")


def test_the_time_is_up(tiny_sweep, tmp_path):
    config, reference = tiny_sweep
    output, kept, code = tmp_path / "out", [0], -1
    while code:
        done = nursery().run("run", config, "--output", output, "--max-time", "0.7s", pace=0.3)
        code = done.code
        kept.append(check_whole(output, reference))
        if code:
            assert (code, done.out) == (75, "")
            assert done.err.splitlines()[-1] == (
                f"stopped: the time is up; {6 * kept[-1]} runs are kept, 0 in flight were lost, "
                f"and {GOES_ON}"
            )
            assert manifest(output)["state"] == "stopped"
            assert kept[-1] > kept[-2]
            assert not [name for name in everything_in(output) if "/." in f"/{name}"]
    assert len(kept) > 2
    check_finished(output, reference)


def test_a_time_too_short_for_one_run_says_so(tiny_sweep, tmp_path):
    config, reference = tiny_sweep
    args = ("run", config, "--output", tmp_path / "out", "--max-time")
    began = time.monotonic()
    done = nursery().run(*args, "0.3s", pace=60, grace=0.3)
    assert time.monotonic() - began < 30  # it does not wait for the block
    assert done.code == 75
    assert done.err.splitlines()[-1] == (
        "stopped: the time was up before one run had ended, give more; 0 runs are kept, 0 in "
        f"flight were lost, and {GOES_ON}"
    )
    assert blocks_of(tmp_path / "out") == {}
    assert nursery().run(*args, "1h").code == 0
    check_finished(tmp_path / "out", reference)
    # What is done needs no time.
    done = nursery().run(*args, "0.001s", "-q")
    assert (done.code, done.err) == (0, "")


@pytest.mark.parametrize("text", ["2", "s", "-1s", "0s", "1 fortnight", "", "nan s"])
def test_what_is_no_time(text, tiny_sweep, tmp_path):
    given = ("--output", tmp_path / "out", f"--max-time={text}")
    result = sweeping.invoke("run", tiny_sweep[0], *given)
    assert_refused(result, 2, f"error: --max-time {text}".rstrip() + ": is ")
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("number", "code", "word", "stride"),
    [
        (signal.SIGINT, 130, "interrupted", 7),
        (signal.SIGTERM, 143, "terminated", 17),
        pytest.param(signal.SIGINT, 130, "interrupted", 1, marks=pytest.mark.slow),
        pytest.param(signal.SIGTERM, 143, "terminated", 1, marks=pytest.mark.slow),
    ],
)
def test_stopped_at_every_call(number, code, word, stride, tiny_sweep, tmp_path):
    config, reference = tiny_sweep
    output = tmp_path / "out"
    args = ("run", config, "--output", output, "-q")
    calls = trace(output, tmp_path / "log", *args, kinds=CHANGES)
    assert len(calls) > 60
    for at in range(0, len(calls), stride):
        shutil.rmtree(output)
        harm = {"root": output, "kinds": CHANGES, "at": at, "sent": number}
        done = nursery().run(*args, calls=harm)
        where = f"call {at}: {calls[at]}: {done}"
        assert done.code == code, where
        kept = re.fullmatch(
            rf"{word}; (completed work is|(\d+) runs are) kept(, 0 in flight were lost)?, "
            rf"and {GOES_ON}\n",
            done.err,
        )
        assert kept, f"{where} {done.err}"
        assert int(kept[2] or 0) <= 6 * check_whole(output, reference), where
        check_goes_on(config, output, reference)


def test_a_second_ctrl_c_is_obeyed_at_once(tiny_sweep, tmp_path):
    """The first one waits for the manifest, which another process does not let go of."""
    config, reference = tiny_sweep
    output = tmp_path / "out"
    child = nursery().start("run", config, "--output", output, "-q", pace=0.2)
    wait_until(lambda: child.ended() or blocks_of(output))
    with open(output / ".locks/manifest", "ab") as handle:
        fcntl.flock(handle, fcntl.LOCK_EX)
        child.kill(signal.SIGINT)
        time.sleep(1)
        assert not child.ended()
        sent = time.monotonic()
        child.kill(signal.SIGINT)
        done = child.wait()
        assert time.monotonic() - sent < 10
    assert done.code in (130, -signal.SIGINT)
    assert "Traceback" not in done.err
    check_whole(output, reference)
    check_goes_on(config, output, reference)


# -- inside a block ----------------------------------------------------------------------------

RUNS, FEW = 600, 120
ONE: dict[str, Any] = {
    "name": "one block",
    "bodies": {"source": "sd", "samples": RUNS // 2},
    "spin": {"n_i": [-0.1, 0.2], "omega_xy0": 0.01},
    "block_size": RUNS,
}
SMALL = ONE | {"bodies": {"source": "sd", "samples": FEW // 2}}


def sweep(output: Path, config: dict[str, Any] = ONE, **options: Any) -> Any:
    return sweeping.sweep(output, config, **options)


@pytest.fixture(scope="module")
def whole(tmp_path_factory) -> dict[int, Reference]:
    """Both sweeps, never stopped."""
    folder = tmp_path_factory.mktemp("whole")
    sweep(folder / "one")
    sweep(folder / "small", SMALL)
    return {RUNS: Reference.of(folder / "one"), FEW: Reference.of(folder / "small")}


@pytest.fixture
def often(monkeypatch):
    """Looks at the kernel so often that it can be stopped where a test wants it."""
    monkeypatch.setattr(task, "POLL", 0.01)


def stop_after(more: int) -> Callable[[Progress], None]:
    """Ctrl-C when so many runs have ended."""
    first: list[int] = []

    def report(progress: Progress) -> None:
        first.append(progress.runs)
        if progress.runs >= first[0] + more:
            raise KeyboardInterrupt

    return report


def test_the_runs_of_a_stopped_block_are_kept(whole, often, tmp_path):
    output, kept = tmp_path / "out", [0]
    for more in (1, 150):
        with pytest.raises(KeyboardInterrupt) as stopped:
            sweep(output, report=stop_after(more))
        assert list(blocks_of(output)) == ["block-000000.parquet"]
        kept.append(pq.read_metadata(output / "runs" / "block-000000.parquet").num_rows)
        assert kept[-2] + more <= kept[-1] < RUNS
        (said,) = stopped.value.__notes__
        lost = re.fullmatch(rf"{kept[-1]:,} runs are kept, (\d+) in flight were lost", said)
        assert lost
        assert 0 < int(lost[1]) <= 32 * available_threads()
        # Every reader knows it for what it is.
        found = status_of(output)
        assert (found.runs_begun, found.runs_done, found.blocks_done) == (kept[-1], 0, 0)
        assert (found.state, found.damaged) == ("stopped", [])
        verdict = verify(output)
        assert (verdict.problems, verdict.begun, verdict.missing) == ([], kept[-1], [(0, 1)])
        assert (verdict.blocks, verdict.runs) == (0, 0)
        assert manifest(output)["receipts"] == {}
        merged = merge([output], tmp_path / f"merged-{more}")
        assert (merged.runs, merged.missing) == (0, [(0, RUNS)])
    # Other types, which are put back when the block is completed.
    summary = retype(output, ["classify.sw_departure=1e-6"]).summary
    assert summary.column("runs").to_pylist() == [0, 0]
    assert manifest(output)["receipts"] == {}
    done = sweep(output)
    assert (done.resumed_runs, done.done, done.runs) == (kept[-1], RUNS - kept[-1], RUNS)
    check_finished(output, whole[RUNS])


@pytest.mark.parametrize("retry", [False, True])
def test_any_time_however_short_makes_progress(retry, whole, often, tmp_path):
    """The same command with hardly any time, until it is through."""
    failed, reports = 0, []
    if retry:
        limited = SMALL | {"integrator": {"max_steps": 400}}
        failed = sweep(tmp_path, limited).failed["step_limit"]
        assert failed > 20
    while not reports or reports[-1].stopped:
        reports.append(sweep(tmp_path, SMALL, threads=1, max_time=1e-9, retry_failed=retry))
        # The last one may find that all runs have ended, and only has to say so.
        assert reports[-1].done > 0 or not reports[-1].stopped
        assert len(reports) <= FEW
    assert len(reports) > 1
    assert reports[0].stopped == "the time is up"
    assert sum(report.done for report in reports) == (failed if retry else FEW)
    assert sum(report.retried for report in reports) == failed
    assert not retry or {report.runs for report in reports} == {FEW}
    check_finished(tmp_path, whole[FEW])


def test_blocks_that_vanish_are_no_success(tmp_path):
    def vanishing(session: Any) -> None:
        local.work_off(session)
        session.store.block_path(1).unlink()

    config = SMALL | {"model": "gh", "block_size": 80}
    with pytest.raises(OutputError, match=r"block-000001.parquet was in place and has vanished"):
        sweep(tmp_path, config, engine=vanishing)
    assert manifest(tmp_path)["state"] == "stopped"
    assert sweep(tmp_path, config).summary is not None
    assert verify(tmp_path).problems == []


@pytest.mark.parametrize("harm", [Path.unlink, lambda path: path.write_bytes(b"{")])
def test_a_manifest_that_is_harmed_meanwhile_is_made_anew(harm, tmp_path):
    def harming(session: Any) -> None:
        harm(session.store.manifest_path)
        local.work_off(session)

    config = SMALL | {"model": "gh", "block_size": 80}
    assert sweep(tmp_path, config, engine=harming).summary is not None
    said = manifest(tmp_path)
    assert (said["state"], len(said["receipts"]), len(said["sessions"])) == ("complete", 2, 1)
    assert verify(tmp_path).problems == []


def test_what_the_tests_leave_lying_is_in_pytests_own_directory(tmp_path_factory):
    assert nursery().folder.is_relative_to(tmp_path_factory.getbasetemp())
    assert nursery().folder.is_dir()


def test_sessions_of_one_process_are_told_apart_however_soon_they_follow(tmp_path):
    config = SMALL | {"model": "gh"}
    for shard in (Shard(0, 2), None, None):
        sweep(tmp_path, config, shard=shard)
    assert [entry.get("shard") for entry in manifest(tmp_path)["sessions"]] == ["0/2", None, None]
