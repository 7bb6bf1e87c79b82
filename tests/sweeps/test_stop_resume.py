"""Stops that keep what is done, locks that die with their process, progress that never falls."""

from __future__ import annotations

import re
import shutil
import signal
import threading
import time
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pyarrow as pa
import pytest
import sweeping
from hardship import check_equal, check_whole, nursery, one_sentence, tiny, wait_until
from sweeping import begin, plan_of

from rattlesweep.errors import ConfigError, OutputError
from rattlesweep.integrate import task
from rattlesweep.sweeps import run as runner
from rattlesweep.sweeps.provenance import hold, read_sessions
from rattlesweep.sweeps.run import Job, Progress, Result, Shard
from rattlesweep.sweeps.stored import Found, files_of, open_stored
from rattlesweep.sweeps.verify import status

GOES_ON = "the same command resumes from there"
FEW = 120
CONFIG: dict[str, Any] = {
    "name": "stops",
    "bodies": {"source": "sd", "samples": FEW // 2},
    "spin": {"n_i": [-0.1, 0.2], "omega_xy0": 0.01},
}


@pytest.fixture(scope="module")
def tiny_sweep(tmp_path_factory) -> tuple[Path, Path]:
    """A config of four blocks, and its sweep."""
    folder = tmp_path_factory.mktemp("tiny")
    config = tiny(folder)
    assert nursery().run("run", config, "--output", folder / "out", "-q").code == 0
    return config, folder / "out"


@pytest.fixture(scope="module")
def whole(tmp_path_factory) -> Path:
    """The sweep under the full model, never stopped."""
    output = tmp_path_factory.mktemp("whole") / "out"
    sweeping.sweep(output, CONFIG)
    return output


# -- commands --------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("number", "code", "word", "how"),
    [
        (signal.SIGINT, 130, "interrupted", "interrupted"),
        (signal.SIGTERM, 143, "terminated", "interrupted"),
        (None, 75, "stopped: the time is up", "stopped"),
    ],
)
def test_what_is_done_is_kept(number, code, word, how, tiny_sweep, tmp_path):
    config, expected = tiny_sweep
    args = ("run", config, "--output", tmp_path, "-q")
    if number is None:
        done = nursery().run(*args, "--max-time", "0.4s", hold=2)
    else:
        child = nursery().start(*args, hold=2)
        wait_until(lambda: child.ended() or len(files_of(tmp_path)) == 2)
        child.kill(number)
        done = child.wait()
    assert (done.code, done.out) == (code, "")
    assert done.err == f"{word}; 12 runs are kept, 0 in flight were lost, and {GOES_ON}\n"
    assert check_whole(tmp_path, expected) == 12
    assert [session["how"] for session in read_sessions(tmp_path)] == [how]
    assert nursery().run(*args).code == 0
    check_equal(tmp_path, expected)


def test_a_time_too_short_for_one_run_says_so(tiny_sweep, tmp_path):
    config, expected = tiny_sweep
    args = ("run", config, "--output", tmp_path / "out", "--max-time")
    done = nursery().run(*args, "0.3s", hold=0, grace=0.3)
    assert (done.code, files_of(tmp_path / "out")) == (75, [])
    assert "stopped: the time was up before one run had ended, give more; 0 runs" in done.err
    assert nursery().run(*args, "1h").code == 0
    check_equal(tmp_path / "out", expected)
    done = nursery().run(*args, "0.001s", "-q")  # what is done needs no time
    assert (done.code, done.err) == (0, "")


def test_one_writer_a_shard(tiny_sweep, tmp_path):
    """Who would get in the way is refused at once, and a lock goes with its process."""
    config, expected = tiny_sweep
    args = ("run", config, "--output", tmp_path, "-q", "--shard")
    first = nursery().start(*args, "0/3", hold=0)
    wait_until(lambda: first.ended() or at_work(tmp_path, first.pid))
    for other in (
        (*args, "0/3"), (*args, "3/4"), args[:-1], ("classify", tmp_path),
        ("merge", tmp_path, "--output", tmp_path / "merged"),
    ):  # fmt: skip
        done = nursery().run(*other)
        assert (done.code, done.out, one_sentence(done.err)) == (1, "", True)
        assert f"{tmp_path}: shard-0-of-3 is in use by `rattlesweep run" in done.err
        assert f"(process {first.pid} on " in done.err
    # Other shards of as many go on, and see what is missing.
    for index in (1, 2):
        assert nursery().run(*args, f"{index}/3").code == 0
    assert open_stored(tmp_path).count() == 16
    first.kill()
    assert first.wait().code == -signal.SIGKILL
    assert not status(tmp_path).data["at_work"]
    whole = nursery().start(*args[:-1], hold=0)
    wait_until(lambda: at_work(tmp_path, whole.pid))
    done = nursery().run(*args, "0/3")
    assert (done.code, one_sentence(done.err)) == (1, True)
    assert f"error: {tmp_path} is in use by `" in done.err
    whole.kill(signal.SIGUSR1)
    assert whole.wait().code == 0
    check_equal(tmp_path, expected)


def at_work(directory: Path, pid: int) -> bool:
    if not (directory / "manifest.json").exists():
        return False
    return [session["pid"] for session in status(directory).data["at_work"]] == [pid]


def test_three_shards_at_once_in_one_directory(tiny_sweep, tmp_path):
    config, expected = tiny_sweep
    args = ("run", config, "--output", tmp_path, "-q", "--shard")
    for trial in range(3):
        shutil.rmtree(tmp_path)
        shards = [nursery().start(*args, f"{k}/3", rows=1) for k in range(3)]
        assert [shard.wait().code for shard in shards] == [0, 0, 0], trial
        check_equal(tmp_path, expected)


def test_other_thresholds_are_no_business_of_a_shard(tiny_sweep, tmp_path):
    config, expected = tiny_sweep
    shutil.copytree(expected, tmp_path, dirs_exist_ok=True)
    args = ("run", config, "--output", tmp_path, "-q", "--shard", "0/2")
    done = nursery().run(*args, "--set", "classify.sw_departure=0.5")
    assert (done.code, one_sentence(done.err)) == (2, True)
    assert "run `rattlesweep classify` there" in done.err
    check_equal(tmp_path, expected)


def test_ctrl_c_is_heard_within_a_block_and_while_bodies_are_drawn(tmp_path):
    hard = ("bodies.target={K_r: 0.1, rel_tol: 1e-9, max_draws: 4000000000000}",)
    integrating, drawing = (begin(tmp_path / str(k), *sets) for k, sets in enumerate(((), hard)))
    wait_until(lambda: integrating.poll() is not None or files_of(tmp_path / "0"))
    for child in (integrating, drawing):
        child.send_signal(signal.SIGINT)
    table, said = integrating.communicate(timeout=60)
    assert (integrating.returncode, table) == (130, "")
    found = re.search(rf"interrupted; ([0-9,]+) runs are kept, \d+ in .*, and {GOES_ON}\n", said)
    assert found, said
    kept = open_stored(tmp_path / "0").count()
    assert kept == int(found[1].replace(",", "")) < 6000
    assert {path.name for path in (tmp_path / "0").rglob(".*")} == {".locks"}
    _, said = drawing.communicate(timeout=60)
    assert drawing.returncode == 130
    assert said.strip().startswith("interrupted")


# -- in this process -------------------------------------------------------------------------------


@pytest.fixture
def often(monkeypatch):
    """Looks at the kernel so often that it can be stopped where a test wants it."""
    monkeypatch.setattr(task, "POLL", 0.001)


def stop_after(more: int) -> Callable[[Progress], None]:
    """Ctrl-C when so many runs have ended."""
    first: list[int] = []

    def report(progress: Progress) -> None:
        first.append(progress.runs)
        if progress.runs >= first[0] + more:
            raise KeyboardInterrupt

    return report


def test_the_runs_of_a_stopped_block_are_kept(whole, often, tmp_path):
    kept = [0]
    for more in (1, 20):
        with pytest.raises(KeyboardInterrupt) as stopped:
            sweeping.sweep(tmp_path, CONFIG, report=stop_after(more), threads=1)
        kept.append(open_stored(tmp_path).count())
        assert kept[-2] + more <= kept[-1]
        (said,) = stopped.value.__notes__
        assert re.fullmatch(rf"{kept[-1]} runs are kept, \d+ in flight were lost", said)
        assert status(tmp_path).data["runs"] == kept[-1]
    done = sweeping.sweep(tmp_path, CONFIG)
    assert (done.done, done.runs) == (FEW - kept[-1], FEW)
    check_equal(tmp_path, whole)


def test_any_time_however_short_makes_progress(whole, often, tmp_path):
    results: list[Any] = []
    while not results or results[-1].stopped:
        results.append(sweeping.sweep(tmp_path, CONFIG, threads=1, max_time=1e-9))
        assert results[-1].done > 0
        assert len(results) <= FEW
    assert sum(result.done for result in results) == FEW
    check_equal(tmp_path, whole)


def test_beside_the_main_thread(whole, tmp_path):
    """As in a notebook's or a server's thread, where no signals are heard."""
    thread = threading.Thread(target=sweeping.sweep, args=(tmp_path, CONFIG))
    thread.start()
    thread.join(300)
    check_equal(tmp_path, whole)


@pytest.mark.parametrize(
    ("name", "text", "options", "words"),
    [
        ("notes.txt", "x", {}, "holds other files, such as notes.txt"),
        ("manifest.json", '{"format": 2}', {}, "manifest.json is damaged or of another version"),
        ("runs/mine.parquet", "x", {}, "such as runs"),
    ],
)
def test_what_is_refused_changes_nothing(name, text, options, words, tmp_path):
    (tmp_path / name).parent.mkdir(exist_ok=True)
    (tmp_path / name).write_text(text)
    before = sweeping.tree(tmp_path)
    with pytest.raises((ConfigError, OutputError), match=words):
        sweeping.sweep(tmp_path, CONFIG, **options)
    assert sweeping.tree(tmp_path) == before


# -- blocks and progress ---------------------------------------------------------------------------


def new_job(
    monkeypatch: Any, cost: Any, samples: int, report: Any = lambda p: None, **more: Any
) -> Job:
    monkeypatch.setattr(runner, "case_costs", lambda plan: np.array(cost, float))
    spin = {"n_i": np.linspace(-0.5, -0.1, len(cost)).tolist(), "omega_xy0": 0.01}
    plan = plan_of(CONFIG, bodies={"source": "sd", "samples": samples}, spin=spin)
    stored: Any = SimpleNamespace(append=lambda *args: None)
    found = Found(np.zeros((len(plan.cases), plan.samples), bool))
    return Job(plan, stored, found, Result(Path()), 2, report, **more)


@pytest.mark.parametrize("seed", range(3))
def test_blocks_are_each_run_once_in_order_and_alike_in_cost(seed, monkeypatch):
    monkeypatch.setattr(runner, "MOST_ROWS", 3000)
    monkeypatch.setattr(runner, "AT_ONCE", 7000)
    dice = np.random.default_rng(seed)
    work = new_job(monkeypatch, 10 ** dice.uniform(2, 5, 40), 500)
    work.found.done[:] = dice.random((40, 500)) < 0.4
    blocks = []
    for keys in work.blocks(np.ones((40, 500), bool)):
        blocks.append(keys)
        work.worked(keys, float(work._cost[keys[0]].sum()) / 1e7)  # as many costs a second
    case, sample = (np.concatenate(part) for part in zip(*blocks, strict=True))
    assert np.array_equal(np.stack([case, sample]), np.nonzero(~work.found.done))
    cost = np.array([work._cost[block[0]].sum() for block in blocks])
    sizes = np.array([len(block[0]) for block in blocks])
    assert sizes.max() <= 3000
    # But for the first, which learns, and the last, which is what is left.
    least = runner.ROUNDS * runner.LANES * 2
    assert (cost[1:-1][sizes[1:-1] > least] <= 3.0e7).all()
    assert (sizes[1:-1] >= least).all()


@pytest.mark.parametrize(
    ("seconds", "rows"), [(1e-4, 3000), (0.01, 300), (0.05, 256), (0.2, 150), (30.0, 64)]
)
def test_a_block_of_long_runs_is_small(seconds, rows, monkeypatch):
    """Time that a run takes, and rows of a block of two threads with 32 lanes each."""
    monkeypatch.setattr(runner, "MOST_ROWS", 3000)
    monkeypatch.setattr(runner, "LANES", 32)
    work = new_job(monkeypatch, [1.0], 10_000)
    blocks = work.blocks(np.ones((1, 10_000), bool))
    first = next(blocks)
    work.worked(first, seconds * len(first[0]))
    assert len(next(blocks)[0]) == pytest.approx(rows, abs=1)


@pytest.mark.parametrize("waves", [1, 3])
def test_progress_never_falls_and_ends_at_one(waves, monkeypatch):
    seen: list[Progress] = []
    dice = np.random.default_rng(5)
    work = new_job(monkeypatch, 10 ** dice.uniform(0, 4, 20), 50, seen.append)
    wanted = np.zeros((20, 50), bool)
    for wave in range(waves):
        wanted[:, : 50 * (wave + 1) // waves] = True
        for case, sample in work.blocks(wanted):
            work.begun = work.begun or time.monotonic()
            work.tick()
            types, status = ["R"] * len(case), ["ok"] * len(case)
            work.write(pa.table({
                "case": case, "sample": sample, "type": types, "status": status
            }))  # fmt: skip
            work.tick()
    fractions = [progress.fraction for progress in seen]
    assert fractions == sorted(fractions)
    assert fractions[-1] == 1.0
    assert all(p.left is None or (np.isfinite(p.left) and p.left >= 0) for p in seen)
    assert [p.runs for p in seen] == sorted(p.runs for p in seen)
    assert seen[-1].runs == seen[-1].total == wanted.sum()


def test_shards_are_read_as_words():
    assert Shard.parse(" 1/3 ") == Shard(1, 3)
    for text in ("3/3", "1", "a/b", "-1/3", "0/0"):
        with pytest.raises(ValueError, match=r"is not I/N"):
            Shard.parse(text)


def test_a_sweep_grows_when_no_other_shard_is_at_work(tiny_sweep, tmp_path):
    """Shards of the larger sweep that begin at once grow it once."""
    config, _ = tiny_sweep
    args = ("run", config, "--output", tmp_path / "out", "-q", "--set")
    assert sweeping.invoke(*args, "bodies.samples=2", "--shard", "0/2").exit_code == 0
    with hold(tmp_path / "out", "shard-1-of-2"):
        done = sweeping.invoke(*args, "bodies.samples=4", "--shard", "0/2")
        assert done.exit_code == 1
        assert "shard-1-of-2 is at work; the sweep can grow when it has ended" in done.stderr
    assert sweeping.invoke(*args, "bodies.samples=4", "--shard", "0/2").exit_code == 0
    assert sweeping.invoke(*args, "bodies.samples=4", "--shard", "1/2").exit_code == 0
