"""The Dask executor, on a cluster of threads if that is enough, otherwise of
processes.
"""

from __future__ import annotations

import json
import os
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.csv
import pytest
from hardship import rows_of, wait_until
from sweeping import CONFIGS, sweep

from rattlesweep.store.rows import Stored
from rattlesweep.words.errors import ConfigError, OutputError
from rattlesweep.work import dask as daskexecutor
from rattlesweep.work import job as jobs
from rattlesweep.work.dask import make_executor
from rattlesweep.work.job import Progress

GATE = Path(__file__).parents[1] / "helpers" / "gate.py"
# Eight blocks of ten runs, of which each takes a moment.
SWEEP: dict[str, Any] = {
    "name": "spread",
    "seed": 3,
    "bodies": {"source": "sd", "samples": 40},
    "spin": {"n_i": [-0.1, 0.2], "omega_xy0": 0.01},
    "horizon": {"t": 1000},
}
AXES = {"theta": {"linspace": [0.6, 0.95, 33]}}
REFINED = SWEEP | {
    "bodies": {
        "source": "grid",
        "base": {"preset": "GH"},
        "axes": AXES,
        "refine": {"levels": 3},
    },
    "spin": {"n_i": {"linspace": [-0.5, -0.1, 9]}, "omega_xy0": 0.01},
}
ENDLESS = SWEEP | {"horizon": {"t": 1e10}, "spin": {"n_i": -0.9, "omega_xy0": 1e-3}}
# What acts, by the name of a test.
ACTIONS: dict[str, dict[str, Any]] = {
    "pivot": {"dissipation": {"pivot": [1e-3, 5e-3]}},
    "both": {"dissipation": {"pivot": 5e-3, "mu": [0.1, 0.3]}},
    "creep": {"dissipation": {"pivot": 5e-3, "creep": [0.2, 0.4]}},
    "viscous": {"dissipation": {"viscous": [50, 500]}},
    "shaken": {"base": {"frequency": [2.5, 3.0], "acceleration": 0.05}},
    "reduced": {
        "model": "reduced",
        "dissipation": {"sigma": 1e-3, "pivot": 1e-3, "creep": [0.3, 0.5]},
    },
}
NEVER = 300  # seconds after which a test gives up waiting


@pytest.fixture(autouse=True)
def small_blocks(monkeypatch):
    monkeypatch.setattr(jobs, "MAX_BLOCK_RUNS", 10)


@pytest.fixture(scope="module")
def plain(tmp_path_factory) -> pa.Table:
    directory = tmp_path_factory.mktemp("plain") / "out"
    sweep(directory, SWEEP, threads=1)
    return rows_of(directory)


@pytest.fixture(scope="module")
def cluster() -> Iterator[str]:
    """Address of a scheduler with two workers, all in threads of this process."""
    from distributed import LocalCluster

    path = sys.path[:]
    with LocalCluster(
        n_workers=2,
        threads_per_worker=2,
        processes=False,
        protocol="tcp",
        host="127.0.0.1",
        dashboard_address="127.0.0.1:0",
        memory_limit=0,
    ) as it:
        sys.path[:] = path  # without the scratch directories of workers
        yield it.scheduler_address


class Cluster:
    """A scheduler and workers in separate processes, which a test may kill."""

    def __init__(self, place: Path, gate: Path) -> None:
        self.place = place
        self.processes = []
        self._environment = os.environ | {
            "DASK_TEMPORARY_DIRECTORY": str(place),
            "DASK_DISTRIBUTED__WORKER__PRELOAD": json.dumps([str(GATE)]),
            "RATTLESWEEP_TESTS_GATE": str(gate),
        }
        file = place / "scheduler.json"
        self.scheduler = self._start(
            "scheduler",
            "--host",
            "127.0.0.1",
            "--port",
            "0",
            "--dashboard-address",
            "127.0.0.1:0",
            "--scheduler-file",
            str(file),
        )
        # Dask does not write it in one step.
        wait_until(lambda: file.exists() and file.read_text().endswith("}"))
        self.address = json.loads(file.read_text())["address"]

    def worker(self, **environment: Any) -> subprocess.Popen[bytes]:
        """Start a worker, and wait until it has registered."""
        from distributed import Client

        process = self._start(
            "worker",
            self.address,
            "--host",
            "127.0.0.1",
            "--nthreads",
            "2",
            "--no-nanny",
            "--no-dashboard",
            **environment,
        )
        with Client(self.address, timeout=NEVER, set_as_default=False) as client:
            client.wait_for_workers(len(self.processes) - 1, timeout=NEVER)
        return process

    def _start(self, *command: str, **environment: Any) -> subprocess.Popen[bytes]:
        variables = {name: str(value) for name, value in environment.items()}
        with open(self.place / f"{len(self.processes)}.log", "wb") as log:
            process = subprocess.Popen(
                [Path(sys.executable).with_name("dask"), *command],
                env=self._environment | variables,
                cwd=self.place,
                start_new_session=True,
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=log,
            )
        self.processes.append(process)
        return process


@pytest.fixture
def gate(tmp_path) -> Path:
    """Directory of a gate that one block passes, or all if it has a file `open`."""
    place = tmp_path / "gate"
    place.mkdir()
    (place / "ticket").touch()
    return place


@pytest.fixture
def own_cluster(tmp_path, gate) -> Iterator[Cluster]:
    """A scheduler without workers; its future workers wait at the gate."""
    (tmp_path / "cluster").mkdir()
    it = Cluster(tmp_path / "cluster", gate)
    yield it
    for process in it.processes:
        process.kill()
        process.wait(NEVER)


@pytest.mark.parametrize(
    "name",
    [
        pytest.param("quickstart", marks=pytest.mark.slow),
        "refine",
        *(pytest.param(name, marks=pytest.mark.slow) for name in ACTIONS),
    ],
)
def test_rows_are_those_of_the_local_executor(name, cluster, tmp_path):
    config = REFINED
    sets = []
    if name in ACTIONS:
        config = SWEEP | ACTIONS[name]
    if name == "quickstart":
        config = CONFIGS / "quickstart.yaml"
        sets = ["bodies.samples=6", "bodies.target.rel_tol=0.1"]
    sweep(tmp_path / "local", config, *sets)
    result = sweep(tmp_path / "dask", config, *sets, executor=make_executor(cluster))
    assert result.summary is not None
    assert result.runs == result.done == len(rows_of(tmp_path / "dask"))
    assert rows_of(tmp_path / "dask").equals(rows_of(tmp_path / "local"))


@pytest.mark.slow
def test_losses_of_workers_and_of_the_scheduler(
    own_cluster, gate, tmp_path, plain, monkeypatch
):
    """Workers need no disk in common; a killed one costs nothing; the other cases are
    sentences.
    """
    it = own_cluster
    output = tmp_path / "out"
    closed = tmp_path / "closed"
    with monkeypatch.context() as patch:
        patch.setattr(daskexecutor, "WORKER_TIMEOUT", 1.0)
        with pytest.raises(
            OutputError, match=f"{it.address} has had no worker for 1 s"
        ):
            sweep(output, SWEEP, executor=make_executor(it.address))
    (gate / "open").touch()
    closed.mkdir()
    (tmp_path / "shut").mkdir()
    it.worker(RATTLESWEEP_TESTS_CLOSED=closed)
    mortal = it.worker(RATTLESWEEP_TESTS_GATE=tmp_path / "shut")
    # Bodies and launches of the sweep, from a table.
    names = ["alpha", "beta", "gamma", "theta", "phi", "xi", "n_i", "omega_xy0"]
    pyarrow.csv.write_csv(plain.select(names), closed / "bodies.csv")
    config = {key: value for key, value in SWEEP.items() if key != "spin"}
    config |= {"bodies": {"source": "table", "path": str(closed / "bodies.csv")}}

    def kill(progress: Progress) -> None:
        if (
            progress.runs >= 40
        ):  # it holds blocks; the other does its own, and then those
            mortal.kill()

    result = sweep(
        closed / "out", config, executor=make_executor(it.address), report=kill
    )
    assert mortal.wait(NEVER) == -signal.SIGKILL
    assert result.done == 80
    names = ["n_i", "alpha", "t_end", "n_end", "energy_drift", "status"]
    here, there = (
        t.select(names).sort_by("n_end") for t in (rows_of(closed / "out"), plain)
    )
    assert here.equals(there)
    (gate / "open").unlink()

    def behead(progress: Progress) -> None:
        if progress.runs == 10:  # the gate holds the other blocks
            it.scheduler.kill()

    with pytest.raises(
        OutputError, match=f"the scheduler at {it.address} is lost; completed"
    ):
        sweep(output, SWEEP, executor=make_executor(it.address), report=behead)
    assert sweep(output, SWEEP).done == 70
    assert rows_of(output).equals(plain)


def test_without_a_scheduler_workers_of_its_own_do_it(plain, tmp_path):
    assert sweep(tmp_path, SWEEP, executor=make_executor(None)).done == 80
    assert rows_of(tmp_path).equals(plain)


@pytest.mark.parametrize(
    "how", [pytest.param("time", marks=pytest.mark.slow), "interrupt", "full disk"]
)
def test_a_stop_keeps_the_blocks_that_are_done_and_frees_the_workers(
    how, cluster, plain, tmp_path, monkeypatch
):
    output = tmp_path / "out"
    endless = tmp_path / "endless"

    def stop(progress: Progress) -> None:
        if progress.runs >= 10:
            raise KeyboardInterrupt

    def full(*args: Any) -> None:
        raise OutputError("the disk is full")

    executor = make_executor(cluster, threads=1)
    if how == "time":
        assert (
            sweep(output, SWEEP, executor=executor, max_time=1e-9).stopped
            == "the time is up"
        )
        # Of blocks that would take hours, too.
        assert (
            sweep(endless, ENDLESS, executor=executor, max_time=1e-9).stopped
            is not None
        )
    elif how == "interrupt":
        with pytest.raises(KeyboardInterrupt) as caught:
            sweep(output, SWEEP, executor=executor, report=stop)
        assert caught.value.__notes__ == [f"{len(rows_of(output))} runs are kept"]
    else:
        with monkeypatch.context() as patch:
            patch.setattr(Stored, "append", full)
            with pytest.raises(OutputError, match="the disk is full"):
                sweep(output, SWEEP, executor=executor)
    assert len(rows_of(output)) < 80
    assert sweep(output, SWEEP, executor=make_executor(cluster)).runs == 80
    assert rows_of(output).equals(plain)


def test_worker_of_another_version_is_refused(cluster, tmp_path, monkeypatch):
    ours = daskexecutor.versions()
    answers = iter(
        [ours | {"numba": "0.1"}]
    )  # the driver's; workers are threads of this process
    monkeypatch.setattr(
        daskexecutor, "versions", lambda: next(answers, ours | {"numba": "0.2"})
    )
    worker = r"^the worker at tcp://127\S+ on \S+"
    sentence = rf"{worker}: its results would differ .*: numba 0.2 there"
    with pytest.raises(OutputError, match=sentence):
        sweep(tmp_path, SWEEP, executor=make_executor(cluster))
    assert not list(tmp_path.glob("runs/*"))


def test_worker_with_other_sources_is_refused(cluster, tmp_path, monkeypatch):
    hashes = iter(["0123456789abcdef"])  # of the driver
    program_hash = daskexecutor.program_hash
    monkeypatch.setattr(
        daskexecutor, "program_hash", lambda: next(hashes, program_hash())
    )
    worker = r"^the worker at tcp://127\S+ on \S+"
    sentence = rf"{worker}: its results would differ .* has other sources there"
    with pytest.raises(OutputError, match=sentence):
        sweep(tmp_path, SWEEP, executor=make_executor(cluster))
    assert not list(tmp_path.glob("runs/*"))


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("start_block", r"^the worker at tcp://127\S+ on \S+: MemoryError: no room$"),
        ("do_block", r"^the block that begins with case 0, sample \d+ cannot be done"),
    ],
)
def test_blocks_that_cannot_be_done_are_one_sentence(
    name, words, cluster, tmp_path, monkeypatch
):
    def fails(*args: Any) -> None:
        raise MemoryError("no room")

    monkeypatch.setattr(daskexecutor, name, fails)
    # Of several cases, any block may be the first to fail.
    one_case = SWEEP | {"spin": {"n_i": 0.2, "omega_xy0": 0.01}}
    with pytest.raises(OutputError, match=words):
        sweep(tmp_path, one_case, executor=make_executor(cluster))


def test_address_where_nobody_is_is_told(tmp_path, monkeypatch):
    monkeypatch.setattr(daskexecutor, "CONNECT_TIMEOUT", 1.0)
    with socket.socket() as silent:
        silent.bind(("127.0.0.1", 0))
        silent.listen()
        port = silent.getsockname()[1]
        for address in ("nonsense", f"tcp://127.0.0.1:{port}"):
            with pytest.raises(
                OutputError, match=f"^--scheduler {address}: no Dask scheduler"
            ):
                sweep(tmp_path, SWEEP, executor=make_executor(address))
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(ConfigError, match=r"pip install 'rattlesweep\[dask\]'"):
        make_executor("tcp://127.0.0.1:8786")
