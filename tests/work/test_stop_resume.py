"""Stops keep what is done, locks end with their process, and progress never falls."""

from __future__ import annotations

import signal
import threading
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pyarrow as pa
import pytest
import sweeping
from hardship import (
    Child,
    Ended,
    check_equal,
    check_whole,
    command,
    files_of,
    tiny,
    wait_until,
)
from sweeping import plan_of

from rattlesweep.kernel import task
from rattlesweep.store import merging
from rattlesweep.store import rows as stores
from rattlesweep.store.locks import hold
from rattlesweep.store.progress import status
from rattlesweep.store.rows import Found, open_stored
from rattlesweep.store.sessions import read_sessions
from rattlesweep.words.errors import ConfigError, OutputError
from rattlesweep.work import job as jobs
from rattlesweep.work.job import Job, Progress

GOES_ON = "the same command resumes from there"
FEW = 40
CONFIG: dict[str, Any] = {
    "name": "stops",
    "bodies": {"source": "sd", "samples": FEW // 2},
    "spin": {"n_i": [-0.1, 0.2], "omega_xy0": 0.01},
}


@pytest.fixture(scope="module")
def tiny_sweep(tmp_path_factory) -> tuple[Path, Path]:
    folder = tmp_path_factory.mktemp("tiny")
    config = tiny(folder)
    assert command("run", config, "--output", folder / "out", "-q").code == 0
    return config, folder / "out"


@pytest.fixture(scope="module")
def whole(tmp_path_factory) -> Path:
    output = tmp_path_factory.mktemp("whole") / "out"
    sweeping.sweep(output, CONFIG)
    return output


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
        done = command(*args, "--max-time", "0.4s", hold=2)
    else:
        child = Child(*args, hold=2)
        wait_until(lambda: child.ended() or len(files_of(tmp_path)) == 2)
        child.kill(number)
        done = child.wait()
    assert (done.code, done.out) == (code, "")
    assert done.err == f"{word}; 12 runs are kept, and {GOES_ON}\n"
    assert check_whole(tmp_path, expected) == 12
    assert [session["how"] for session in read_sessions(tmp_path)] == [how]
    assert command(*args) == Ended(0, "", "")
    check_equal(tmp_path, expected)


@pytest.mark.slow
@pytest.mark.parametrize(
    "law",
    [
        "dissipation: {pivot: [0.001, 0.005]}",
        "dissipation: {pivot: 0.005, mu: 0.3}",
        "dissipation: {pivot: 0.005, creep: [0.2, 0.4]}",
        "dissipation: {viscous: [50, 500]}",
        "base: {frequency: 2.9, acceleration: [0.02, 0.1]}",
        "model: reduced\ndissipation: {sigma: 0.001, pivot: 0.001, creep: [0.3, 0.5]}",
    ],
)
def test_a_killed_sweep_and_shards_of_any_law_have_equal_rows(law, tmp_path):
    config = tiny(tmp_path)
    text = config.read_text().replace("model: gh\n", "")
    config.write_text(f"{text}{law}\n")
    expected = tmp_path / "expected"
    assert command("run", config, "--output", expected, "-q").code == 0
    output = tmp_path / "out"
    args = ("run", config, "--output", output, "-q")
    child = Child(*args, hold=2)
    wait_until(lambda: child.ended() or len(files_of(output)) == 2)
    child.kill()
    assert child.wait().code == -signal.SIGKILL
    assert check_whole(output, expected) == 12
    assert command(*args) == Ended(0, "", "")
    check_equal(output, expected)
    parts = tmp_path / "parts"
    for index in range(3):
        share = ("run", config, "--output", parts, "-q", "--shard", f"{index}/3")
        assert command(*share).code == 0
    check_equal(parts, expected)


def test_one_writer_a_shard(tiny_sweep, tmp_path):
    """A second writer is refused at once, and a lock ends with its process."""
    config, expected = tiny_sweep
    args = ("run", config, "--output", tmp_path, "-q", "--shard")
    first = Child(*args, "0/3", hold=0)
    wait_until(lambda: first.ended() or at_work(tmp_path, first.pid))
    for second in (
        (*args, "0/3"),
        (*args, "3/4"),
        args[:-1],
        ("classify", tmp_path),
        ("merge", tmp_path, "--output", tmp_path / "merged"),
    ):
        done = command(*second)
        assert (done.code, done.out, done.sentence) == (1, "", True)
        assert f"{tmp_path}: shard-0-of-3 is in use by `rattlesweep run" in done.err
        assert f"(process {first.pid} on " in done.err
    # Other shards of the same number may work at the same time.
    rest = [Child(*args, f"{index}/3", rows=1) for index in (1, 2)]
    assert [child.wait().code for child in rest] == [0, 0]
    assert open_stored(tmp_path).count() == 16
    first.kill()
    assert first.wait().code == -signal.SIGKILL
    assert not status(tmp_path).data["at_work"]
    whole = Child(*args[:-1], hold=0)
    wait_until(lambda: at_work(tmp_path, whole.pid))
    done = command(*args, "0/3")
    assert (done.code, done.sentence) == (1, True)
    assert f"error: {tmp_path} is in use by `" in done.err
    whole.kill(signal.SIGUSR1)
    assert whole.wait().code == 0
    check_equal(tmp_path, expected)


def at_work(directory: Path, pid: int) -> bool:
    if not (directory / "manifest.json").exists():
        return False
    return [session["pid"] for session in status(directory).data["at_work"]] == [pid]


def test_ctrl_c_is_heard_within_a_block_and_while_bodies_are_drawn(tmp_path):
    easy = "K_r: [0.02, 0.1], rel_tol: 0.1"
    hard = f"K_r: 0.1, rel_tol: 1e-9, max_draws: {4 * 10**12}"
    integrating, drawing = (
        Child(
            "run",
            sweeping.CONFIGS / "quickstart.yaml",
            "--output",
            tmp_path / str(k),
            "--set",
            f"bodies={{source: sd, samples: 6000, target: {{{target}}}}}",
            "--set",
            "spin.n_i=[-0.3, -0.5]",
            rows=jobs.MAX_BLOCK_RUNS,
        )
        for k, target in enumerate((easy, hard))
    )
    wait_until(lambda: integrating.ended() or files_of(tmp_path / "0"))
    for child in (integrating, drawing):
        child.kill(signal.SIGINT)
    done = integrating.wait()
    rows = open_stored(tmp_path / "0").count()
    assert 0 < rows < 24_000
    assert f"interrupted; {rows:,} runs are kept, and {GOES_ON}\n" in done.err
    assert {path.name for path in (tmp_path / "0").rglob(".*")} == {".locks"}
    assert done.code == 130
    done = drawing.wait()
    assert "interrupted" in done.err
    assert done.code == 130


@pytest.fixture
def often(monkeypatch):
    """Check the kernel so often that a test can stop it at any run."""
    monkeypatch.setattr(task, "POLL", 0.001)


def test_the_runs_of_a_stopped_block_are_kept(often, tmp_path):
    # At this tolerance the block lasts long enough to be stopped, even on a busy
    # machine.
    config = CONFIG | {
        "bodies": {"source": "sd", "samples": 60},
        "integrator": {"tol": 1e-13},
    }
    output = tmp_path / "out"
    runs = 0
    for more in (1, 20):

        def stop(progress: Progress, least: int = runs + more) -> None:
            if progress.runs >= least:
                raise KeyboardInterrupt

        with pytest.raises(KeyboardInterrupt) as stopped:
            sweeping.sweep(output, config, report=stop, threads=1)
        now = status(output).data["runs"]
        assert now >= runs + more
        assert stopped.value.__notes__ == [f"{now} runs are kept"]
        runs = now
    assert sweeping.sweep(output, config).done == 120 - runs
    sweeping.sweep(tmp_path / "whole", config)
    check_equal(output, tmp_path / "whole")


def test_any_time_however_short_makes_progress(whole, often, tmp_path):
    results: list[Any] = []
    while not results or results[-1].stopped:
        results.append(sweeping.sweep(tmp_path, CONFIG, threads=1, max_time=1e-9))
        assert results[-1].done > 0
    assert sum(result.done for result in results) == FEW
    check_equal(tmp_path, whole)


def test_beside_the_main_thread(whole, tmp_path):
    """As in a thread of a notebook or server, which receives no signals."""
    thread = threading.Thread(target=sweeping.sweep, args=(tmp_path, CONFIG))
    thread.start()
    thread.join(300)
    check_equal(tmp_path, whole)


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("notes.txt", "holds other files, such as notes.txt"),
        ("manifest.json", "manifest.json is damaged or of another version"),
    ],
)
def test_what_is_refused_changes_nothing(name, words, tmp_path):
    (tmp_path / name).write_text('{"format": 2}')
    before = sweeping.tree(tmp_path)
    with pytest.raises((ConfigError, OutputError), match=words):
        sweeping.sweep(tmp_path, CONFIG)
    assert sweeping.tree(tmp_path) == before


def test_a_sweep_grows_when_no_other_shard_is_at_work(tiny_sweep, tmp_path):
    config, _ = tiny_sweep
    args = (
        "run",
        config,
        "--output",
        tmp_path / "out",
        "-q",
        "--shard",
        "0/2",
        "--set",
    )
    assert sweeping.invoke(*args, "bodies.samples=2").exit_code == 0
    with hold(tmp_path / "out", "shard-1-of-2"):
        done = sweeping.invoke(*args, "bodies.samples=4")
        assert done.exit_code == 1
        assert (
            "shard-1-of-2 is at work; the sweep can grow when it has ended"
            in done.stderr
        )
    assert sweeping.invoke(*args, "bodies.samples=4").exit_code == 0


def new_job(
    monkeypatch: Any, cost: Any, samples: int, report: Any = lambda p: None, **more: Any
) -> Job:
    monkeypatch.setattr(jobs, "case_costs", lambda plan: np.array(cost, float))
    spin = {"n_i": np.linspace(-0.5, -0.1, len(cost)).tolist(), "omega_xy0": 0.01}
    plan = plan_of(CONFIG, bodies={"source": "sd", "samples": samples}, spin=spin)
    stored: Any = SimpleNamespace(append=lambda *args: None)
    return Job(plan, stored, Found((len(cost), samples)), 2, report, **more)


def rows_of(case: Any, sample: Any, n_steps: Any) -> pa.Table:
    columns = {"case": case, "sample": sample, "n_steps": n_steps}
    labels = {"type": ["R"] * len(case), "status": ["ok"] * len(case)}
    return pa.table(columns | labels)


@pytest.mark.parametrize("spread", [False, True])
@pytest.mark.parametrize(
    "shape", [(1, 1), (1, 5000), (7, 300), (300, 7), (3, 64), (3, 65)]
)
def test_the_first_samples_of_every_case_come_first(shape, spread, monkeypatch):
    monkeypatch.setattr(jobs, "SCANNED_RUNS", 1000)
    todo = np.random.default_rng(1).random(shape) < 0.7
    pieces = list(jobs.todo_in_order(todo, spread))
    case, sample = (np.concatenate(x) for x in zip(*pieces, strict=True))
    assert sorted(zip(case, sample, strict=True)) == [
        *zip(*np.nonzero(todo), strict=True)
    ]
    # Stopped anywhere, no case has more than about GROWTH times as many as another.
    for stop in range(0, len(case), 97):
        done = np.bincount(case[:stop], minlength=shape[0])
        most = jobs.BLOCK_GROWTH * done.min() + jobs.FIRST_PASS
        assert done.max() <= most * 1.3 + 10
    # Each pass is in the order of the keys, and there are few of them.
    order = case * shape[1] + sample
    assert (np.diff(order) < 0).sum() <= 6


def test_reading_what_passes_wrote_holds_few_files(monkeypatch, tmp_path):
    monkeypatch.setattr(jobs, "MAX_BLOCK_RUNS", 100)
    monkeypatch.setattr(merging, "FILE_BYTES", 1)
    monkeypatch.setattr(stores, "BATCH_ROWS", 1)
    config = CONFIG | {"bodies": {"source": "sd", "samples": 1000}, "model": "gh"}
    spin = {"n_i": np.linspace(0.1, 0.5, 4).tolist(), "omega_xy0": 0.01}
    sweeping.sweep(tmp_path, config | {"spin": spin, "horizon": {"t": 1000}})
    held: list[int] = []
    honest = pa.concat_tables

    def counting(tables: list[pa.Table]) -> pa.Table:
        held.append(sum(map(len, tables)))
        return honest(tables)

    monkeypatch.setattr(stores.pa, "concat_tables", counting)
    rows = open_stored(tmp_path).read()
    assert (len(files_of(tmp_path)), len(rows)) == (40, 4000)
    assert rows["sample"].to_pylist() == [*range(1000)] * 4
    assert max(held) < 1500


@pytest.mark.parametrize("seed", range(4))
def test_the_time_left_is_right_within_a_third_after_a_minute(seed, monkeypatch):
    """Cases cost up to ten times more or less than expected, and runs vary too."""
    dice = np.random.default_rng(seed)
    expected = 10 ** dice.uniform(3, 5, 24)
    actual = expected * 10 ** dice.uniform(-0.7, 1.0, 24)
    seen: list[tuple[float, float]] = []
    clock = [0.0]
    monkeypatch.setattr(jobs.time, "monotonic", lambda: clock[0])

    def note(progress: Progress) -> None:
        if progress.left is not None:
            seen.append((clock[0], progress.left))

    samples = int(600 * 1e7 / actual.sum())  # ten minutes in all
    work = new_job(monkeypatch, expected, samples, note)
    work.tally.begun = 0.0
    for case, sample in work.blocks(np.ones((24, samples), bool)):
        steps = actual[case] * dice.exponential(1.0, len(case))
        seconds = steps.sum() / 1e7 * dice.uniform(0.8, 1.2)
        clock[0] += seconds
        work.write(rows_of(case, sample, steps), seconds)
        work.tick()
    end = clock[0]
    later = [(now, left) for now, left in seen if 60 <= now <= 0.97 * end]
    assert len(later) > 50
    assert all(abs(left / (end - now) - 1) < 0.3 for now, left in later)


@pytest.mark.parametrize("seed", range(3))
def test_blocks_are_each_run_once_in_order(seed, monkeypatch):
    monkeypatch.setattr(jobs, "MAX_BLOCK_RUNS", 3000)
    monkeypatch.setattr(jobs, "SCANNED_RUNS", 7000)
    dice = np.random.default_rng(seed)
    cost = 10 ** dice.uniform(2, 5, 40)
    work = new_job(monkeypatch, cost, 500)
    work.found.done[:] = dice.random((40, 500)) < 0.4
    todo = ~work.found.done
    blocks = []
    for case, sample in work.blocks(np.ones((40, 500), bool)):
        blocks.append((case, sample))
        order = case * 500 + sample
        assert (np.diff(order) > 0).all()  # as the rows of a file are
        steps = cost[case]
        work.write(rows_of(case, sample, steps), steps.sum() / 1e7)  # 1e7 a second
    every = np.concatenate([np.stack(block) for block in blocks], axis=1)
    assert len(every.T) == len(np.unique(every, axis=1).T) == todo.sum()
    assert todo[tuple(every)].all()
    sizes = [len(case) for case, _ in blocks]
    assert min(sizes[:-1]) >= jobs.RUNS_PER_LANE * jobs.LANES * 2
    assert max(sizes) <= 3000


@pytest.mark.parametrize("waves", [1, 3])
def test_progress_never_falls_and_ends_at_one(waves, monkeypatch):
    seen: list[Progress] = []
    costs = 10 ** np.random.default_rng(5).uniform(0, 4, 20)
    work = new_job(monkeypatch, costs, 50, seen.append)
    work.tally.begun = 0.0
    wanted = np.zeros((20, 50), bool)
    for wave in range(waves):
        wanted[:, : 50 * (wave + 1) // waves] = True
        for case, sample in work.blocks(wanted):
            work.tick()
            work.write(rows_of(case, sample, costs[case]))
            work.tick()
    fractions = [progress.fraction for progress in seen]
    assert fractions == sorted(fractions)
    assert fractions[-1] == 1.0
    assert all(p.left is None or (np.isfinite(p.left) and p.left >= 0) for p in seen)
    assert [p.runs for p in seen] == sorted(p.runs for p in seen)
    assert seen[-1].runs == wanted.sum()
