"""The Dask engine on clusters that are real, and that come to harm."""

from __future__ import annotations

import gc
import json
import os
import pickle
import re
import signal
import socket
import subprocess
import sys
import tempfile
import time
import urllib.error
import urllib.request
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest
from hardship import wait_until
from refusal import assert_refused
from test_run import invoke

from rattlesweep.errors import ConfigError, OutputError
from rattlesweep.sweeps.cases.plan import Plan, make_plan
from rattlesweep.sweeps.cases.shards import Shard
from rattlesweep.sweeps.config.load import parse_config
from rattlesweep.sweeps.engines import dask_cluster as daskcluster
from rattlesweep.sweeps.engines import dask_driver as daskengine
from rattlesweep.sweeps.engines import dask_worker as daskworker
from rattlesweep.sweeps.engines.dask_driver import make_engine
from rattlesweep.sweeps.engines.progress import Progress
from rattlesweep.sweeps.engines.run import run_sweep
from rattlesweep.sweeps.inspect.content_hash import content_hash
from rattlesweep.sweeps.inspect.verify import verify
from rattlesweep.sweeps.store.store import Store

PROGRAM = Path(sys.executable).with_name("rattlesweep")
DASK = Path(sys.executable).with_name("dask")
CONFIG = {
    "name": "spread",
    "seed": 11,
    "bodies": {"source": "sd", "samples": 30, "target": {"K_r": [0.03, 0.1], "rel_tol": 0.1}},
    "spin": {"n_i": [-0.1, -0.5, 0.2], "omega_xy0": [0.01, 0.1]},
    "block_size": 32,
}
# Eight blocks; a `gate` lets the first one through, so that harm comes in the middle of the others.
HELD = {
    "name": "held",
    "seed": 3,
    "bodies": {"source": "sd", "samples": 40},
    "spin": {"n_i": [-0.1, 0.2], "omega_xy0": 0.01},
    "horizon": {"t": 1000},
    "block_size": 10,
}
# Seconds after which what a test waits for will never come, on however busy a machine.
NEVER = 600


def plan_of(config: dict[str, Any] = CONFIG, **changes: Any) -> Plan:
    return make_plan(parse_config(config | changes))


def wait_for(condition: Callable[[], Any], process: subprocess.Popen[str] | None = None) -> None:
    wait_until(condition, NEVER, process)


def spread(
    plan: Plan, output: Path, cluster: Cluster, threads: int | None = None, **how: Any
) -> Any:
    """Run a sweep on a cluster."""
    return run_sweep(plan, output, engine=make_engine(cluster.address, threads=threads), **how)


def check(output: Path, content: str) -> None:
    """The directory is whole and has these rows."""
    assert verify(output).problems == []
    assert content_hash(output) == content


class Cluster:
    """A scheduler and workers, each a process of its own, on the loopback address."""

    def __init__(self, place: Path, workers: int, *, ttl: str = "5 minutes") -> None:
        self.place = place
        self.processes: list[subprocess.Popen[bytes]] = []
        self._environment = {
            "DASK_DISTRIBUTED__SCHEDULER__WORKER_TTL": ttl,
            "DASK_TEMPORARY_DIRECTORY": str(place),
        }
        file = place / "scheduler.json"
        self.scheduler = self._start(
            "scheduler", "--host", "127.0.0.1", "--port", "0", "--dashboard-address",
            "127.0.0.1:0", "--scheduler-file", str(file),
        )  # fmt: skip
        # Dask does not write it in one step.
        wait_for(lambda: file.exists() and file.read_text().endswith("}"))
        self.address = json.loads(file.read_text())["address"]
        self.workers = [self.worker() for _ in range(workers)]

    def worker(self, *options: str) -> subprocess.Popen[bytes]:
        return self._start("worker", self.address, "--host", "127.0.0.1", "--nthreads", "2",
                           "--no-nanny", "--no-dashboard", *options)  # fmt: skip

    def _start(self, *command: str) -> subprocess.Popen[bytes]:
        log = open(self.place / f"{len(self.processes)}.log", "wb")  # noqa: SIM115
        process = subprocess.Popen(
            [DASK, *command], env=os.environ | self._environment, stdin=subprocess.DEVNULL,
            stdout=log, stderr=log, start_new_session=True,
        )  # fmt: skip
        log.close()
        self.processes.append(process)
        return process

    def stop(self) -> None:
        for process in self.processes:
            process.kill()
            process.wait()


@pytest.fixture(scope="module")
def cluster(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Cluster]:
    it = Cluster(tmp_path_factory.mktemp("cluster"), 2)
    yield it
    it.stop()


@pytest.fixture
def own_cluster(tmp_path: Path) -> Iterator[Callable[..., Cluster]]:
    """One to be harmed."""
    begun: list[Cluster] = []

    def begin(workers: int, **options: Any) -> Cluster:
        place = tmp_path / "cluster"
        place.mkdir()
        begun.append(Cluster(place, workers, **options))
        return begun[0]

    yield begin
    for it in begun:
        it.stop()


@pytest.fixture(scope="module")
def plain(tmp_path_factory: pytest.TempPathFactory) -> str:
    """Content of the sweep done at once, by one thread."""
    directory = tmp_path_factory.mktemp("plain") / "out"
    run_sweep(plan_of(), directory, threads=1)
    return content_hash(directory)


@pytest.fixture(scope="module")
def held_plain(tmp_path_factory: pytest.TempPathFactory) -> str:
    directory = tmp_path_factory.mktemp("held") / "out"
    run_sweep(plan_of(HELD), directory)
    return content_hash(directory)


@pytest.fixture
def held_config(tmp_path: Path) -> Path:
    path = tmp_path / "held.yaml"
    path.write_text(json.dumps(HELD))
    return path


@pytest.fixture
def gate(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """What holds the blocks of workers begun from now on, but one; `open` in it lets all go on."""
    place = tmp_path / "gate"
    place.mkdir()
    (place / "ticket").touch()
    monkeypatch.setenv("RATTLESWEEP_TESTS_GATE", str(place))
    preload = json.dumps([str(Path(__file__).parents[1] / "helpers" / "gate.py")])
    monkeypatch.setenv("DASK_DISTRIBUTED__WORKER__PRELOAD", preload)
    return place / "open"


def begin(config: Path, output: Path, *options: str) -> subprocess.Popen[str]:
    """The program, in a group of its own as a terminal has it."""
    return subprocess.Popen(
        [PROGRAM, "run", config, "--output", output, "--engine", "dask", *options],
        stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        start_new_session=True,
    )  # fmt: skip


def begin_held(config: Path, output: Path, *options: str) -> subprocess.Popen[str]:
    """The same, with the one block in place that the `gate` lets through."""
    process = begin(config, output, *options)
    wait_for(lambda: in_place(output) >= 1, process)
    return process


def in_place(output: Path) -> int:
    return len(list((output / "runs").glob("block-*.parquet"))) if output.exists() else 0


def children(pid: int) -> list[int]:
    found = []
    for path in Path(f"/proc/{pid}/task").glob("*/children"):
        with suppress(OSError):  # the thread has just ended
            for child in map(int, path.read_text().split()):
                found += [child, *children(child)]
    return found


def dask_workers(pid: int) -> list[int]:
    """Workers of an embedded cluster, told from Python's own helpers."""
    found = []
    for child in children(pid):
        try:
            words = Path(f"/proc/{child}/cmdline").read_bytes()
        except OSError:
            continue
        if b"multiprocessing.spawn" in words:
            found.append(child)
    return found


def alive(pid: int) -> bool:
    """Whether a process runs; one that has ended and is not waited for has no command."""
    try:
        return Path(f"/proc/{pid}/cmdline").read_bytes() != b""
    except OSError:
        return False


# -- the same table ------------------------------------------------------------------------------


@pytest.mark.parametrize(("count", "threads"), [(1, 2), (7, 1)])
def test_workers_come_to_the_same_table_for_any_threads_and_shares(
    count, threads, cluster, plain, tmp_path
):
    output = tmp_path / "out"
    shards = [None] if count == 1 else [Shard(i, count) for i in range(count)]
    reports = [spread(plan_of(), output, cluster, threads, shard=shard) for shard in shards]
    assert sum(report.blocks for report in reports) == 12
    assert reports[-1].summary is not None
    check(output, plain)
    # Nothing but the sweep is left.
    assert sorted(p.name for p in output.iterdir() if p.name != ".locks") == [
        "manifest.json", "runs", "summary.parquet",
    ]  # fmt: skip
    said = json.loads((output / "manifest.json").read_text())
    assert len(said["receipts"]) == 12
    assert all(receipt["seconds"] > 0 for receipt in said["receipts"].values())


@pytest.mark.slow
def test_embedded_cluster_comes_to_the_same_table(plain, tmp_path):
    config = tmp_path / "sweep.yaml"
    config.write_text(json.dumps(CONFIG))
    process = begin(config, tmp_path / "out", "--workers", "2")
    printed, said = process.communicate(timeout=NEVER)
    assert process.returncode == 0, said
    # Beside a line of progress a minute.
    lines = [line for line in said.splitlines() if "%" not in line]
    assert [line.split()[0] for line in lines] == ["360", "see"]
    assert printed.count("\n") >= 12  # a row for each case
    check(tmp_path / "out", plain)


def test_blocks_in_place_are_not_done_again(cluster, plain, tmp_path):
    output = tmp_path / "out"
    run_sweep(plan_of(), output, shard=Shard(0, 2))
    there = {p.name: p.stat().st_mtime_ns for p in (output / "runs").iterdir()}
    report = spread(plan_of(), output, cluster)
    assert report.blocks == 12 - len(there)
    assert all((output / "runs" / n).stat().st_mtime_ns == t for n, t in there.items())
    assert content_hash(output) == plain


def test_progress_is_told_and_what_flies_and_travels_is_bounded(cluster, tmp_path, monkeypatch):
    ever = 0
    honest = daskengine._Driver._hand_out

    def hand_out(self: Any) -> None:
        nonlocal ever
        honest(self)
        ever = max(ever, len(self._flying))

    answers: list[int] = []
    keep = daskengine._Driver._keep

    def weigh(self: Any, block: Any, done: Any) -> None:
        answers.append(len(pickle.dumps(done)))
        keep(self, block, done)

    monkeypatch.setattr(daskengine._Driver, "_hand_out", hand_out)
    monkeypatch.setattr(daskengine._Driver, "_keep", weigh)
    seen: list[Any] = []
    spread(plan_of(block_size=10), tmp_path / "out", cluster, report=seen.append)
    fractions = [progress.fraction for progress in seen]
    assert fractions == sorted(fractions)
    assert fractions[-1] == pytest.approx(1.0)
    assert seen[-1].runs == seen[-1].total == 360
    assert len(set(fractions)) > 3
    assert 2 <= ever <= 2 * 2
    assert len(answers) == 36
    assert max(answers) < 500


def test_time_that_is_up_stops_the_driver_and_the_workers(cluster, tmp_path):
    output = tmp_path / "out"
    # Spins that never reverse, and would be watched for hours.
    spin = {"n_i": -0.9, "omega_xy0": 1e-3}
    plan = plan_of(HELD, block_size=40, spin=spin, horizon={"t": 1e10})
    report = spread(plan, output, cluster, max_time=1)
    # A few of the bodies do reverse, and are kept.
    assert report.stopped is not None
    assert report.stopped.startswith("the time")
    # The workers hear it: they are free for something else at once.
    small = spread(plan_of(), tmp_path / "small", cluster)
    assert small.summary is not None
    assert not any(Store(output).is_complete(index) for index in Store(output).block_indices())
    assert list(output.glob(".order*")) == []


@pytest.mark.slow
def test_stopped_workers_hand_in_what_has_ended(cluster, held_plain, tmp_path):
    plan = plan_of(HELD, block_size=80)
    reports = []
    while not reports or reports[-1].stopped:
        reports.append(spread(plan, tmp_path, cluster, threads=1, max_time=1e-9))
        assert len(reports) < 30
        assert verify(tmp_path).problems == []
    assert sum(report.done for report in reports) == 80
    assert content_hash(tmp_path) == held_plain


# -- harm ------------------------------------------------------------------------------------------


def test_killed_worker_costs_nothing_but_time(cluster, gate, held_plain, tmp_path):
    """It holds its blocks until it is killed; the others do theirs, and then those."""
    from distributed import Client

    gate.with_name("ticket").unlink()
    mortal = cluster.worker()
    with Client(cluster.address, set_as_default=False) as client:
        client.wait_for_workers(3)
    output = tmp_path / "out"

    def kill_in_the_middle(progress: Progress) -> None:
        if in_place(output) >= 4:
            mortal.kill()

    spread(plan_of(HELD), output, cluster, report=kill_in_the_middle)
    assert mortal.wait() == -signal.SIGKILL
    check(output, held_plain)


def test_a_scheduler_without_workers_and_one_that_is_lost_are_one_sentence(
    gate, own_cluster, held_plain, tmp_path, monkeypatch
):
    monkeypatch.setattr(daskengine, "RETURN", 1.0)
    it = own_cluster(0)
    with monkeypatch.context() as patch:
        patch.setattr(daskengine, "WORKERLESS", 1.0)
        with pytest.raises(OutputError) as caught:
            spread(plan_of(), tmp_path / "none", it)
    assert f"the scheduler at {it.address} has had no worker for 1 s" in str(caught.value)
    assert f"`dask worker {it.address}`" in str(caught.value)
    output = tmp_path / "out"
    it.worker()

    def kill_in_the_middle(progress: Progress) -> None:
        if in_place(output) == 1:
            it.scheduler.kill()

    with pytest.raises(OutputError) as caught:
        spread(plan_of(HELD), output, it, report=kill_in_the_middle)
    assert str(caught.value) == (
        f"the scheduler at {it.address} is lost; completed work is kept, and with a new one "
        "the same command resumes from there"
    )
    assert list(output.glob(".order*")) == []
    assert in_place(output) == 1
    report = run_sweep(plan_of(HELD), output)
    assert report.resumed_runs == 10
    check(output, held_plain)


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_signal_to_the_whole_group_ends_it_quietly(number, gate, held_config, held_plain, tmp_path):
    output = tmp_path / "out"
    process = begin_held(held_config, output, "--workers", "2")
    wait_for(lambda: len(dask_workers(process.pid)) == 2, process)
    workers = dask_workers(process.pid)
    os.killpg(process.pid, number)
    said = process.communicate(timeout=NEVER)[1]
    assert process.returncode == 128 + number
    word = "interrupted" if number == signal.SIGINT else "terminated"
    assert re.fullmatch(
        rf"{word}; \d+ runs are kept, \d+ in flight were lost, and the same command resumes from "
        "there\n",
        said,
    )
    wait_for(lambda: not any(map(alive, workers)))
    assert list(output.glob(".order*")) == []
    run_sweep(plan_of(HELD), output)
    assert content_hash(output) == held_plain


@pytest.mark.slow
def test_killed_and_paused_workers_of_an_embedded_cluster_are_replaced(
    gate, held_config, held_plain, tmp_path
):
    output = tmp_path / "out"
    process = begin_held(held_config, output, "--workers", "2")
    wait_for(lambda: len(dask_workers(process.pid)) == 2, process)
    first, second = dask_workers(process.pid)
    os.kill(first, signal.SIGKILL)
    os.kill(second, signal.SIGSTOP)
    gate.touch()
    said = process.communicate(timeout=NEVER)[1]
    assert process.returncode == 0, said
    check(output, held_plain)


@pytest.mark.slow
def test_paused_worker_is_given_up_and_may_come_back(
    gate, own_cluster, held_config, held_plain, tmp_path
):
    it = own_cluster(2, ttl="6s")
    output = tmp_path / "out"
    process = begin_held(held_config, output, "--scheduler", it.address, "--threads", "1")
    os.kill(it.workers[0].pid, signal.SIGSTOP)
    gate.touch()
    said = process.communicate(timeout=NEVER)[1]
    assert process.returncode == 0, said
    assert content_hash(output) == held_plain
    os.kill(it.workers[0].pid, signal.SIGCONT)
    time.sleep(3)
    # It finds the order gone, or writes what is there already.
    check(output, held_plain)


@pytest.mark.slow
def test_worker_killed_and_worker_paused_and_scheduler_lost(
    gate, own_cluster, held_config, held_plain, tmp_path
):
    it = own_cluster(3, ttl="6s")
    output = tmp_path / "out"
    process = begin_held(held_config, output, "--scheduler", it.address, "--threads", "1")
    it.workers[0].kill()
    os.kill(it.workers[1].pid, signal.SIGSTOP)
    for more in (2, 3):
        gate.with_name("ticket").touch()
        wait_for(lambda more=more: in_place(output) >= more, process)
    it.scheduler.kill()
    said = process.communicate(timeout=NEVER)[1]
    assert process.returncode == 1
    assert len(said.strip().splitlines()) == 1
    assert "is lost; completed work is kept" in said
    assert run_sweep(plan_of(HELD), output).summary is not None
    assert content_hash(output) == held_plain


@pytest.mark.slow
def test_killed_driver_leaves_workers_that_stop_and_a_directory_that_goes_on(
    gate, own_cluster, held_config, held_plain, tmp_path
):
    it = own_cluster(2)
    output = tmp_path / "out"
    process = begin_held(held_config, output, "--scheduler", it.address, "--threads", "1")
    process.kill()
    process.communicate()
    gate.touch()
    report = spread(plan_of(HELD), output, it)
    assert report.summary is not None
    assert list(output.glob(".order*")) == []
    check(output, held_plain)


def test_block_that_takes_its_workers_along_is_given_up(cluster, tmp_path, monkeypatch):
    def do_block(order: str, index: int, begun: bool) -> None:
        from distributed import KilledWorker

        worker = type("Worker", (), {"address": "tcp://127.0.0.1:5"})()
        raise KilledWorker("x", worker, 3)

    monkeypatch.setattr(daskengine, "do_block", do_block)
    with pytest.raises(OutputError, match=r"block \d+ is given up: workers .*tcp://127.0.0.1:5"):
        spread(plan_of(), tmp_path / "out", cluster)


def test_embedded_cluster_is_closed_to_others_and_has_a_directory_of_its_own(tmp_path, monkeypatch):
    from distributed import Client

    # A place that somebody else has prepared.
    planted = tmp_path / "dask-scratch-space"
    planted.mkdir(mode=0o777)
    (planted / "planted.py").write_text("")
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    monkeypatch.setenv("TMPDIR", str(tmp_path))

    def look(dask_worker: Any) -> tuple[list[str], str]:
        return sys.path, dask_worker.local_directory

    with daskcluster.embedded(1, 1) as client, daskcluster.quiet():
        ((path, scratch),) = client.run(look).values()
        (private,) = tmp_path.glob("rattlesweep-dask-*")
        assert private.stat().st_mode & 0o777 == 0o700
        assert Path(scratch).is_relative_to(private)
        for place in (*path, *sys.path):
            assert "dask-scratch-space" not in place
        # No dashboard, and nothing to read where Dask opens a port all the same.
        at = client.run_on_scheduler(lambda dask_scheduler: dask_scheduler.http_server.port)
        for page in ("status", "info/main/workers.html", "metrics", "json/counts.json"):
            with pytest.raises(urllib.error.HTTPError, match="404"):
                urllib.request.urlopen(f"http://127.0.0.1:{at}/{page}", timeout=20)
        address = client.scheduler.address
        assert address.startswith("tls://127.0.0.1:")
        for other in (address, address.replace("tls", "tcp")):
            with pytest.raises((OSError, TypeError)):
                Client(other, timeout=1, set_as_default=False)
            # Now: collected while another begins, it waits for a lock that this one holds.
            gc.collect()
    assert not private.exists()
    assert [p.name for p in planted.iterdir()] == ["planted.py"]


# -- workers that do not fit -----------------------------------------------------------------------


def test_worker_without_the_directory_is_named(cluster, tmp_path, monkeypatch):
    honest = daskengine.place_order

    def elsewhere(*args: Any) -> Path:
        order = honest(*args)
        order.unlink()  # as on a machine with another file system
        return order

    monkeypatch.setattr(daskengine, "place_order", elsewhere)
    with pytest.raises(OutputError, match=r"the worker at tcp://127\S+ on \S+ does not see /"):
        spread(plan_of(), tmp_path / "out", cluster)
    assert in_place(tmp_path / "out") == 0


def test_worker_of_another_version_is_named(cluster, tmp_path, monkeypatch):
    ours = daskworker.essentials()
    monkeypatch.setattr(daskworker, "essentials", lambda: {**ours, "numba": "0.1"})
    with pytest.raises(OutputError) as caught:
        spread(plan_of(), tmp_path / "out", cluster)
    assert re.search(
        r"^the worker at tcp://127\S+ on \S+ would compute other bits: "
        rf"numba {ours['numba']} there, 0.1 here; give all workers the environment of the driver$",
        str(caught.value),
    )


def test_worker_without_the_package_is_named(cluster, tmp_path, monkeypatch):
    def do_block(order: str, index: int, begun: bool) -> None:
        raise ModuleNotFoundError("No module named 'rattlesweep'")

    monkeypatch.setattr(daskengine, "do_block", do_block)
    with pytest.raises(OutputError, match="a worker cannot import rattlesweep"):
        spread(plan_of(), tmp_path / "out", cluster)


def test_file_that_cannot_be_written_is_told_by_the_worker(cluster, tmp_path):
    output = tmp_path / "out"
    run_sweep(plan_of(), output, shard=Shard(0, 2))
    absent = next(i for i in range(12) if not (output / f"runs/block-{i:06d}.parquet").exists())
    (output / f"runs/block-{absent:06d}.parquet").mkdir()
    with pytest.raises(OutputError, match=rf"cannot write .*block-{absent:06d}"):
        spread(plan_of(), output, cluster)


def test_address_where_nobody_is_is_told(tmp_path, monkeypatch):
    monkeypatch.setattr(daskcluster, "REACH", 1.0)
    # Nor does it wait for the kernel, nor for a port where something else is silent.
    monkeypatch.setattr(daskengine, "load_kernel", None)
    other = socket.socket()
    other.bind(("127.0.0.1", 0))
    other.listen()
    silent = f"tcp://127.0.0.1:{other.getsockname()[1]}"
    config = tmp_path / "sweep.yaml"
    config.write_text(json.dumps(CONFIG))
    for address in ("tcp://127.0.0.1:9", "nonsense", silent):
        result = invoke(
            "run", config, "--output", tmp_path / "out", "--engine", "dask", "--scheduler", address
        )
        assert_refused(result, 1, f"--scheduler {address}: no Dask scheduler answers there")
    other.close()


# -- options, and living without it ----------------------------------------------------------------


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        (("--scheduler", "tcp://127.0.0.1:1"), "--scheduler: is for --engine dask"),
        (("--workers", "2"), "--workers: is for --engine dask"),
        (
            ("--engine", "dask", "--scheduler", "tcp://127.0.0.1:1", "--workers", "2"),
            "--workers: the workers of --scheduler are those that it has",
        ),
    ],
)
def test_options_that_contradict_each_other_are_told(options, sentence, held_config, tmp_path):
    assert_refused(invoke("run", held_config, "--output", tmp_path / "out", *options), 2, sentence)
    assert not (tmp_path / "out").exists()


def test_missing_dask_is_told(held_config, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "distributed", None)
    result = invoke("run", held_config, "--output", tmp_path / "out", "--engine", "dask")
    assert_refused(result, 2, "pip install 'rattlesweep[dask]'")
    with pytest.raises(ConfigError):
        make_engine()


def test_nothing_else_needs_dask(tmp_path):
    script = f"""
import sys
sys.modules["dask"] = sys.modules["distributed"] = None
import rattlesweep
from rattlesweep.cli import COMMANDS, main
from click.testing import CliRunner
for command in COMMANDS:
    assert CliRunner().invoke(main, [command, "--help"]).exit_code == 0, command
rattlesweep.sweep({ {**CONFIG, "model": "gh", "output": str(tmp_path / "out")}!r})
"""
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True,
                          check=False)  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert in_place(tmp_path / "out") == 12
