"""The Dask engine, on a cluster of threads where that is enough, else on processes."""

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
from contextlib import closing, suppress
from pathlib import Path
from typing import Any

import pytest
import sweeping
from hardship import wait_until
from refusal import assert_refused
from sweeping import PROGRAM, content_hash, invoke, manifest, plan_of, proved

from rattlesweep.errors import ConfigError, OutputError
from rattlesweep.sweeps.shards import Shard
from rattlesweep.sweeps.old import dask_cluster as daskcluster
from rattlesweep.sweeps.old import dask_driver as daskengine
from rattlesweep.sweeps.old import dask_worker as daskworker
from rattlesweep.sweeps.old import session
from rattlesweep.sweeps.old.dask_driver import make_engine
from rattlesweep.sweeps.old.progress import Progress
from rattlesweep.sweeps.old.run import run_sweep
from rattlesweep.sweeps.old.store import Store

CONFIG: dict[str, Any] = {
    "name": "spread",
    "seed": 11,
    "bodies": {"source": "sd", "samples": 30, "target": {"K_r": [0.03, 0.1], "rel_tol": 0.1}},
    "spin": {"n_i": [-0.1, -0.5, 0.2], "omega_xy0": [0.01, 0.1]},
    "block_size": 32,
}
# Eight blocks; a `gate` lets the first one through, so that harm comes in the middle of the others.
HELD: dict[str, Any] = {
    "name": "held",
    "seed": 3,
    "bodies": {"source": "sd", "samples": 40},
    "spin": {"n_i": [-0.1, 0.2], "omega_xy0": 0.01},
    "horizon": {"t": 1000},
    "block_size": 10,
}
# Seconds after which what a test waits for will never come, on however busy a machine.
NEVER = 600


def wait_for(condition: Callable[[], Any], process: subprocess.Popen[str] | None = None) -> None:
    wait_until(condition, NEVER, process)


def spread(
    output: Path, address: str, config: dict[str, Any] = CONFIG, threads: int | None = None,
    changes: dict[str, Any] | None = None, **how: Any,
) -> Any:  # fmt: skip
    """Run a sweep on a cluster."""
    plan = plan_of(config, **(changes or {}))
    return run_sweep(plan, output, engine=make_engine(address, threads=threads), **how)


def in_place(output: Path) -> int:
    return len(list(output.glob("runs/block-*.parquet")))


def orders(output: Path) -> list[Path]:
    return list(output.glob(".order*"))


@pytest.fixture(scope="module")
def cluster() -> Iterator[str]:
    """Address of a scheduler with two workers, all of them threads of this process."""
    from distributed import LocalCluster

    path = sys.path[:]
    with daskcluster.quiet(), LocalCluster(
        n_workers=2, threads_per_worker=2, processes=False, protocol="tcp", host="127.0.0.1",
        dashboard_address="127.0.0.1:0", memory_limit=0,
    ) as it:  # fmt: skip
        sys.path[:] = path  # without the scratch directories of workers
        yield it.scheduler_address


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

    def worker(self, **environment: str) -> subprocess.Popen[bytes]:
        """One more, with more variables."""
        return self._start("worker", self.address, "--host", "127.0.0.1", "--nthreads", "2",
                           "--no-nanny", "--no-dashboard", **environment)  # fmt: skip

    def _start(self, *command: str, **environment: str) -> subprocess.Popen[bytes]:
        with open(self.place / f"{len(self.processes)}.log", "wb") as log:
            process = subprocess.Popen(
                [PROGRAM.with_name("dask"), *command],
                env=os.environ | self._environment | environment,
                stdin=subprocess.DEVNULL, stdout=log, stderr=log, start_new_session=True,
            )  # fmt: skip
        self.processes.append(process)
        return process

    def stop(self) -> None:
        for process in self.processes:
            process.kill()
            process.wait()


@pytest.fixture
def own_cluster(tmp_path) -> Iterator[Callable[..., Cluster]]:
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
def plain(tmp_path_factory) -> str:
    """Content of the sweep done at once, by one thread."""
    directory = tmp_path_factory.mktemp("plain") / "out"
    sweeping.sweep(directory, CONFIG, threads=1)
    return content_hash(directory)


@pytest.fixture(scope="module")
def held_plain(tmp_path_factory) -> str:
    directory = tmp_path_factory.mktemp("held") / "out"
    sweeping.sweep(directory, HELD)
    return content_hash(directory)


@pytest.fixture
def gate(tmp_path, monkeypatch) -> Path:
    """What holds the blocks of workers begun from now on, but one; `open` in it lets all go on."""
    place = tmp_path / "gate"
    place.mkdir()
    (place / "ticket").touch()
    monkeypatch.setenv("RATTLESWEEP_TESTS_GATE", str(place))
    preload = json.dumps([str(Path(__file__).parents[1] / "helpers" / "gate.py")])
    monkeypatch.setenv("DASK_DISTRIBUTED__WORKER__PRELOAD", preload)
    return place / "open"


@pytest.fixture
def begin(tmp_path) -> Callable[..., subprocess.Popen[str]]:
    """The program, in a group of its own as a terminal has it; its output is ``out``."""

    def started(config: dict[str, Any], *options: Any) -> subprocess.Popen[str]:
        (tmp_path / "sweep.yaml").write_text(json.dumps(config))
        args = ("run", tmp_path / "sweep.yaml", "--output", tmp_path / "out", "--engine", "dask")
        process = sweeping.start(*args, *options, start_new_session=True)
        if config is HELD:  # with the one block in place that the `gate` lets through
            wait_for(lambda: in_place(tmp_path / "out") >= 1, process)
        return process

    return started


# -- the same table ----------------------------------------------------------------------------


@pytest.mark.parametrize(("count", "threads"), [(1, 2), (7, 1)])
def test_workers_come_to_the_same_table_for_any_threads_and_shares(
    count, threads, cluster, plain, tmp_path
):
    shards = [None] if count == 1 else [Shard(i, count) for i in range(count)]
    reports = [spread(tmp_path, cluster, threads=threads, shard=shard) for shard in shards]
    assert sum(report.blocks for report in reports) == 12
    assert reports[-1].summary is not None
    assert proved(tmp_path) == plain
    # Nothing but the sweep is left.
    left = {p.name for p in tmp_path.iterdir()} - {".locks"}
    assert left == {"manifest.json", "runs", "summary.parquet"}
    receipts = manifest(tmp_path)["receipts"].values()
    assert len(receipts) == 12
    assert all(receipt["seconds"] > 0 for receipt in receipts)


@pytest.mark.slow
def test_embedded_cluster_comes_to_the_same_table(begin, plain, tmp_path):
    process = begin(CONFIG, "--workers", "2")
    printed, said = process.communicate(timeout=NEVER)
    assert process.returncode == 0, said
    # Beside a line of progress a minute.
    lines = [line for line in said.splitlines() if "%" not in line]
    assert [line.split()[0] for line in lines] == ["360", "see"]
    assert printed.count("\n") >= 12  # a row for each case
    assert proved(tmp_path / "out") == plain


def test_blocks_in_place_are_not_done_again(cluster, plain, tmp_path):
    sweeping.sweep(tmp_path, CONFIG, shard=Shard(0, 2))
    there = {path: path.stat().st_mtime_ns for path in (tmp_path / "runs").iterdir()}
    report = spread(tmp_path, cluster)
    assert report.blocks == 12 - len(there)
    assert {path: path.stat().st_mtime_ns for path in there} == there
    assert content_hash(tmp_path) == plain


SIZES: list[int] = []


def weighed(order: str, index: int, begun: bool) -> Any:
    """A block, with the bytes of the answer noted: workers are threads of this process."""
    answer = daskworker.do_block(order, index, begun)
    SIZES.append(len(pickle.dumps(answer)))
    return answer


def test_progress_is_told_and_what_flies_and_travels_is_bounded(cluster, tmp_path, monkeypatch):
    from distributed import Client

    flying, ever, honest = [], [], Client.submit

    def submit(self: Any, *args: Any, **kwargs: Any) -> Any:
        flying.append(honest(self, *args, **kwargs))
        ever.append(sum(not future.done() for future in flying))
        return flying[-1]

    monkeypatch.setattr(Client, "submit", submit)
    monkeypatch.setattr(daskengine, "do_block", weighed)
    seen: list[Progress] = []
    spread(tmp_path, cluster, changes={"block_size": 10}, report=seen.append)
    fractions = [progress.fraction for progress in seen]
    assert fractions == sorted(fractions)
    assert fractions[-1] == pytest.approx(1.0)
    assert seen[-1].runs == seen[-1].total == 360
    assert len(set(fractions)) > 3
    assert 2 <= max(ever) <= 2 * 2
    assert len(SIZES) == 36
    assert max(SIZES) < 500


def test_time_that_is_up_stops_the_driver_and_the_workers(cluster, tmp_path, monkeypatch):
    monkeypatch.setattr(daskworker, "LOOK_EVERY", 0.1)
    monkeypatch.setattr(session, "GRACE", 0.5)
    output = tmp_path / "out"
    # Spins that never reverse, and would be watched for hours; a few do, and are kept.
    never = {"block_size": 40, "horizon": {"t": 1e10}, "spin": {"n_i": -0.9, "omega_xy0": 1e-3}}
    report = spread(output, cluster, HELD, changes=never, max_time=0.5)
    assert report.stopped is not None
    assert report.stopped.startswith("the time")
    assert not any(Store(output).is_complete(index) for index in Store(output).block_indices())
    assert orders(output) == []
    # The workers hear it: they are free for something else at once.
    assert spread(tmp_path / "small", cluster).summary is not None


@pytest.mark.slow
def test_stopped_workers_hand_in_what_has_ended(cluster, held_plain, tmp_path):
    reports = []
    while not reports or reports[-1].stopped:
        how = {"changes": {"block_size": 80}, "threads": 1, "max_time": 1e-9}
        reports.append(spread(tmp_path, cluster, HELD, **how))
        assert len(reports) < 30
        proved(tmp_path)
    assert sum(report.done for report in reports) == 80
    assert content_hash(tmp_path) == held_plain


# -- harm --------------------------------------------------------------------------------------


def test_lost_workers_cost_nothing_but_time_and_a_lost_scheduler_is_one_sentence(
    gate, own_cluster, held_plain, tmp_path, monkeypatch
):
    from distributed import Client

    monkeypatch.setattr(daskengine, "RETURN", 1.0)
    it, output = own_cluster(0), tmp_path / "killed"
    with monkeypatch.context() as patch:
        patch.setattr(daskengine, "WORKERLESS", 1.0)
        with pytest.raises(OutputError) as caught:
            spread(tmp_path / "none", it.address)
    assert f"the scheduler at {it.address} has had no worker for 1 s" in str(caught.value)
    assert f"`dask worker {it.address}`" in str(caught.value)
    gate.touch()
    (tmp_path / "shut").mkdir()
    it.worker()
    mortal = it.worker(RATTLESWEEP_TESTS_GATE=str(tmp_path / "shut"))
    with Client(it.address, set_as_default=False) as client:
        client.wait_for_workers(2)

    def kill_worker(progress: Progress) -> None:
        if in_place(output) >= 4:  # it holds its blocks; the other does its own, and then those
            mortal.kill()

    spread(output, it.address, HELD, report=kill_worker)
    assert mortal.wait() == -signal.SIGKILL
    assert proved(output) == held_plain
    gate.unlink()
    lost = tmp_path / "lost"

    def kill_scheduler(progress: Progress) -> None:
        if in_place(lost) == 1:
            it.scheduler.kill()

    with pytest.raises(OutputError) as caught:
        spread(lost, it.address, HELD, report=kill_scheduler)
    assert str(caught.value) == (
        f"the scheduler at {it.address} is lost; completed work is kept, and with a new one "
        "the same command resumes from there"
    )
    assert (orders(lost), in_place(lost)) == ([], 1)
    assert sweeping.sweep(lost, HELD).resumed_runs == 10
    assert proved(lost) == held_plain


def children(pid: int) -> list[int]:
    """Processes that come from one, in any generation."""
    found = []
    for path in Path(f"/proc/{pid}/task").glob("*/children"):
        with suppress(OSError):  # the thread has just ended
            for child in map(int, path.read_text().split()):
                found += [child, *children(child)]
    return found


def command_of(pid: int) -> bytes:
    """Its words; none of one that has ended."""
    with suppress(OSError):
        return Path(f"/proc/{pid}/cmdline").read_bytes()
    return b""


def workers_of(process: subprocess.Popen[str]) -> list[int]:
    """The two workers of an embedded cluster, told from Python's own helpers."""
    found: list[int] = []

    def look() -> bool:
        found[:] = [c for c in children(process.pid) if b"multiprocessing.spawn" in command_of(c)]
        return len(found) == 2

    wait_for(look, process)
    return found


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_signal_to_the_whole_group_ends_it_quietly(number, gate, begin, held_plain, tmp_path):
    process = begin(HELD, "--workers", "2")
    workers = workers_of(process)
    os.killpg(process.pid, number)
    said = process.communicate(timeout=NEVER)[1]
    assert process.returncode == 128 + number
    word = "interrupted" if number == signal.SIGINT else "terminated"
    assert re.fullmatch(
        rf"{word}; \d+ runs are kept, \d+ in flight were lost, and the same command resumes from "
        "there\n",
        said,
    )
    wait_for(lambda: not any(map(command_of, workers)))
    assert orders(tmp_path / "out") == []
    sweeping.sweep(tmp_path / "out", HELD)
    assert content_hash(tmp_path / "out") == held_plain


@pytest.mark.slow
def test_killed_and_paused_workers_of_an_embedded_cluster_are_replaced(
    gate, begin, held_plain, tmp_path
):
    process = begin(HELD, "--workers", "2")
    first, second = workers_of(process)
    os.kill(first, signal.SIGKILL)
    os.kill(second, signal.SIGSTOP)
    gate.touch()
    said = process.communicate(timeout=NEVER)[1]
    assert process.returncode == 0, said
    assert content_hash(tmp_path / "out") == held_plain
    # What a killed worker was at may lie there, and the next run takes it away.
    assert sweeping.sweep(tmp_path / "out", HELD).resumed_runs == 80
    assert proved(tmp_path / "out") == held_plain


@pytest.mark.slow
def test_paused_worker_is_given_up_and_may_come_back(
    gate, own_cluster, begin, held_plain, tmp_path
):
    it = own_cluster(2, ttl="6s")
    process = begin(HELD, "--scheduler", it.address, "--threads", "1")
    os.kill(it.workers[0].pid, signal.SIGSTOP)
    gate.touch()
    said = process.communicate(timeout=NEVER)[1]
    assert process.returncode == 0, said
    assert content_hash(tmp_path / "out") == held_plain
    os.kill(it.workers[0].pid, signal.SIGCONT)
    time.sleep(3)
    # It finds the order gone, or writes what is there already.
    assert proved(tmp_path / "out") == held_plain


@pytest.mark.slow
def test_killed_driver_leaves_workers_that_stop_and_a_directory_that_goes_on(
    gate, own_cluster, begin, held_plain, tmp_path
):
    it = own_cluster(2)
    process = begin(HELD, "--scheduler", it.address, "--threads", "1")
    process.kill()
    process.communicate()
    gate.touch()
    assert spread(tmp_path / "out", it.address, HELD).summary is not None
    assert orders(tmp_path / "out") == []
    assert proved(tmp_path / "out") == held_plain


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

    # Where clusters open a page unless told otherwise.
    taken = socket.socket()
    with suppress(OSError):
        taken.bind(("127.0.0.1", 8787))
        taken.listen()
    with closing(taken), daskcluster.embedded(1, 1) as client, daskcluster.quiet():
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


# -- workers that do not fit -------------------------------------------------------------------


def lose_worker(order: str, index: int, begun: bool) -> None:
    from distributed import KilledWorker

    raise KilledWorker("x", type("Worker", (), {"address": "tcp://127.0.0.1:5"})(), 3)


def lack_package(order: str, index: int, begun: bool) -> None:
    raise ModuleNotFoundError("No module named 'rattlesweep'")


@pytest.mark.parametrize(
    ("block", "words"),
    [
        (lose_worker, r"block \d+ is given up: workers .*tcp://127.0.0.1:5"),
        (lack_package, "a worker cannot import rattlesweep"),
    ],
)
def test_blocks_that_no_worker_can_do_are_given_up(block, words, cluster, tmp_path, monkeypatch):
    monkeypatch.setattr(daskengine, "do_block", block)
    with pytest.raises(OutputError, match=words):
        spread(tmp_path, cluster)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        # As on a machine with another file system.
        (None, r"the worker at tcp://127\S+ on \S+ does not see /"),
        ({"essentials": {"numba": "0.1"}},
         r"^the worker at tcp://127\S+ on \S+ would compute other bits: numba \S+ there, 0.1 here; "
         "give all workers the environment of the driver$"),
        ({"hash": "0"}, "sees another table of bodies than the driver on "),
    ],
)  # fmt: skip
def test_workers_that_do_not_fit_are_named(change, words, cluster, tmp_path, monkeypatch):
    honest = daskengine.place_order

    def place(*args: Any) -> Path:
        order = honest(*args)
        if change is None:
            order.unlink()
        else:
            order.write_text(json.dumps(json.loads(order.read_text()) | change))
        return order

    monkeypatch.setattr(daskengine, "place_order", place)
    with pytest.raises(OutputError, match=words):
        spread(tmp_path, cluster)
    assert in_place(tmp_path) == 0


def test_file_that_cannot_be_written_is_told_by_the_worker(cluster, tmp_path):
    sweeping.sweep(tmp_path, CONFIG, shard=Shard(0, 2))
    files = (tmp_path / f"runs/block-{index:06d}.parquet" for index in range(12))
    absent = next(file for file in files if not file.exists())
    absent.mkdir()
    with pytest.raises(OutputError, match=rf"cannot write .*{absent.stem}"):
        spread(tmp_path, cluster)


# -- options, and living without it ------------------------------------------------------------


@pytest.fixture
def command(tmp_path) -> Callable[..., Any]:
    """``run`` with some options."""
    (tmp_path / "sweep.yaml").write_text(json.dumps(CONFIG))
    place = ("run", tmp_path / "sweep.yaml", "--output", tmp_path / "out")
    return lambda *options: invoke(*place, *options)


def test_address_where_nobody_is_is_told(command, monkeypatch):
    monkeypatch.setattr(daskcluster, "REACH", 1.0)
    # Nor does it wait for the kernel, nor for a port where something else is silent.
    monkeypatch.setattr(daskengine, "load_kernel", None)
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        silent = f"tcp://127.0.0.1:{other.getsockname()[1]}"
        for address in ("tcp://127.0.0.1:9", "nonsense", silent):
            result = command("--engine", "dask", "--scheduler", address)
            assert_refused(result, 1, f"--scheduler {address}: no Dask scheduler answers there")


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        (("--scheduler", "tcp://127.0.0.1:1"), "--scheduler: is for --engine dask"),
        (("--workers", "2"), "--workers: is for --engine dask"),
        (("--engine", "dask", "--scheduler", "tcp://127.0.0.1:1", "--workers", "2"),
         "--workers: the workers of --scheduler are those that it has"),
        (("--engine", "dask"), "pip install 'rattlesweep[dask]'"),
    ],
)  # fmt: skip
def test_options_that_contradict_each_other_and_a_missing_dask_are_told(
    options, sentence, command, tmp_path, monkeypatch
):
    if len(options) == 2 and "dask" in options:
        monkeypatch.setitem(sys.modules, "distributed", None)
        with pytest.raises(ConfigError):
            make_engine()
    assert_refused(command(*options), 2, sentence)
    assert not (tmp_path / "out").exists()


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
