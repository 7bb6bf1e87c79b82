"""Systems that refuse threads, memory, renames or syncs; paths as shells have them."""

from __future__ import annotations

import errno
import os
import pickle
import subprocess
import sys
from pathlib import Path
from typing import Any

import pyarrow as pa
import pytest
import sweeping
from sweeping import CONFIGS

import rattlesweep as rs
from rattlesweep.compiling import loading
from rattlesweep.store import parquet
from rattlesweep.store import rows as stores
from rattlesweep.store.rows import open_stored
from rattlesweep.system import files
from rattlesweep.system.processors import processor_time
from rattlesweep.words.errors import ConfigError, DamagedError, OutputError
from rattlesweep.work import slurm

CONFIG: dict[str, Any] = {
    "name": "hostile",
    "model": "gh",
    "bodies": {"source": "sd", "samples": 3},
    "spin": {"n_i": [-0.1, -0.3], "omega_xy0": 0.01},
}


@pytest.fixture
def output(tmp_path):
    sweeping.sweep(tmp_path / "out", CONFIG)
    return tmp_path / "out"


@pytest.mark.parametrize(
    "error",
    [
        pa.ArrowException("Failed to launch worker thread: Resource temporarily ..."),
        OSError("ZSTD decompression failed: Allocation error : not enough memory"),
    ],
)
def test_an_error_of_the_system_is_no_damage(error, output, monkeypatch):
    def fail(*args: Any, **kwargs: Any) -> None:
        raise error

    before = sweeping.tree(output / "runs")
    monkeypatch.setattr(parquet.pq, "ParquetFile", fail)
    with pytest.raises(OutputError, match="cannot read") as raised:
        sweeping.sweep(output, CONFIG)
    assert not isinstance(raised.value, DamagedError)
    assert sweeping.tree(output / "runs") == before
    assert not (output / "damaged").exists()


def test_a_file_is_read_once_more_before_it_is_moved(output, monkeypatch):
    honest = stores.read_parquet
    fails = [True]

    def once(path: Path, *args: Any, **options: Any) -> pa.Table:
        if fails:
            fails.pop()
            raise DamagedError(f"{path} is damaged")
        return honest(path, *args, **options)

    monkeypatch.setattr(stores, "read_parquet", once)
    stored = open_stored(output)
    damaged = stored.find().damaged
    assert len(damaged) == 1
    with pytest.raises(OutputError, match="is not damaged; run the same"):
        stored.set_aside(damaged)
    assert not (output / "damaged").exists()


def test_files_are_read_without_threads(output):
    code = (
        "import sys, threading; from pathlib import Path; import pyarrow as pa; "
        "from rattlesweep.store.parquet import read_parquet; "
        "before = len(list(Path('/proc/self/task').iterdir())); "
        "read_parquet(Path(sys.argv[1])); "
        "assert len(list(Path('/proc/self/task').iterdir())) == before"
    )
    (path,) = (output / "runs").iterdir()
    subprocess.run([sys.executable, "-c", code, str(path)], check=True)


def test_runs_on_another_file_system_without_sync(tmp_path, monkeypatch):
    honest = os.replace

    def across(source: Any, target: Any) -> None:
        if Path(source).parent != Path(target).parent:
            raise OSError(errno.EXDEV, "Invalid cross-device link", str(source))
        honest(source, target)

    def no_sync(handle: int) -> None:
        raise OSError(errno.EINVAL, "Invalid argument")

    monkeypatch.setattr(os, "replace", across)
    monkeypatch.setattr(os, "fsync", no_sync)
    sweeping.sweep(tmp_path / "out", CONFIG)
    (path,) = (tmp_path / "out" / "runs").iterdir()
    path.write_bytes(path.read_bytes()[:-100])
    sweeping.sweep(tmp_path / "out", CONFIG)
    assert len(list((tmp_path / "out" / "damaged").iterdir())) == 1
    sweeping.proved(tmp_path / "out")
    assert not [*(tmp_path / "out").rglob("*.tmp")]


def test_a_disk_that_fails_at_a_sync_is_no_disk_without_sync(tmp_path, monkeypatch):
    def broken(handle: int) -> None:
        raise OSError(errno.EIO, "Input/output error")

    monkeypatch.setattr(os, "fsync", broken)
    with pytest.raises(OutputError, match="Input/output error"):
        files.replace_file(tmp_path / "a", b"data")


def test_home_and_variables_stand_for_folders(tmp_path, monkeypatch):
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    monkeypatch.setenv("SCRATCH", str(tmp_path / "scratch"))
    monkeypatch.delenv("NOWHERE", raising=False)
    work = tmp_path / "work"
    work.mkdir()
    monkeypatch.chdir(work)
    assert rs.sweep(CONFIG | {"output": "~/a"}).directory == tmp_path / "home" / "a"
    rs.sweep(CONFIG, output="$SCRATCH/b")
    config = work / "s.yaml"
    config.write_text(
        "model: gh\nbodies: {source: table, path: $SCRATCH/b/runs}\n"
        "spin: {n_i: 0.1, omega_xy0: 0.01}\n"
    )
    done = sweeping.invoke("run", config, "--output", "${SCRATCH}/c", "-q")
    assert done.exit_code == 0, done.output
    assert len(rs.load("$SCRATCH/c").runs) == 6
    assert sorted(path.name for path in work.iterdir()) == ["s.yaml"]
    done = sweeping.invoke("run", config, "--output", "$NOWHERE/c", "-q")
    assert (done.exit_code, "$NOWHERE is not set" in done.output) == (2, True)
    with pytest.raises(ConfigError, match=r"output: \$NOWHERE/a: .* is not set"):
        rs.sweep(CONFIG | {"output": "$NOWHERE/a"})


def test_a_sweep_stays_open_when_the_working_directory_changes(output, monkeypatch):
    monkeypatch.chdir(output.parent)
    sweep = rs.load("out")
    monkeypatch.chdir("/")
    assert len(sweep.runs) == 6


def test_a_run_with_nothing_to_do_leaves_the_summary(output):
    path = output / "summary.parquet"
    os.utime(path, (1, 1))
    assert sweeping.sweep(output, CONFIG).summary is not None
    assert path.stat().st_mtime == 1
    path.write_bytes(b"damaged")
    sweeping.sweep(output, CONFIG)
    sweeping.proved(output)


V2 = "30 23 0:26 / {} rw - cgroup2 cgroup2 rw\n"
V1 = "31 23 0:28 /docker/a {} rw shared:1 - cgroup cgroup rw,cpu,cpuacct\n"


@pytest.mark.parametrize(
    ("group", "mount", "quotas", "allowed"),
    [
        ("0::/", V2, {"cpu.max": "150000 100000"}, 1.5),
        ("0::/a/b", V2, {"a/cpu.max": "200000 100000", "a/b/cpu.max": "max 1"}, 2.0),
        ("0::/a/b", V2, {"cpu.max": "max 100000"}, 0.0),
        (
            "4:cpu,cpuacct:/docker/a/b\n0::/",
            V1,
            {"cpu.cfs_quota_us": "50000", "cpu.cfs_period_us": "100000"},
            0.5,
        ),
        (
            "4:cpuacct,cpu:/docker/a",
            V1,
            {"cpu.cfs_quota_us": "-1", "cpu.cfs_period_us": "100000"},
            0.0,
        ),
    ],
)
def test_quotas_of_containers_are_read(group, mount, quotas, allowed, tmp_path):
    place = tmp_path / "groups"
    for name, text in quotas.items():
        (place / name).parent.mkdir(parents=True, exist_ok=True)
        (place / name).write_text(text + "\n")
    (tmp_path / "cgroup").write_text(group + "\n")
    (tmp_path / "mountinfo").write_text(mount.format(place))
    assert processor_time(tmp_path) == allowed


def test_settings_of_numba_that_change_code_have_other_kernels(monkeypatch):
    from numba import config

    usual = loading.source_hash.__wrapped__()
    for name in ("LOOP_VECTORIZE", "OPT", "BOUNDSCHECK", "SLP_VECTORIZE"):
        with monkeypatch.context() as patch:
            patch.setattr(config, name, "another")
            assert loading.source_hash.__wrapped__() != usual
    assert loading.source_hash.__wrapped__() == usual


@pytest.mark.parametrize(
    ("program", "is_python"),
    [
        (None, False),
        ("", False),
        ("/opt/tool/gui", False),
        ("/usr/bin/pythonic-editor", False),
        ("/usr/bin/python3.13t", True),
        ("/usr/bin/pypy3", True),
        ("C:/Python/python_d.exe", True),
    ],
)
def test_only_python_is_started_to_compile(program, is_python, monkeypatch):
    monkeypatch.setattr(sys, "executable", program)
    monkeypatch.delenv(loading.IS_CHILD, raising=False)
    assert loading._can_start() == is_python
    monkeypatch.setenv(loading.IS_CHILD, "1")
    assert not loading._can_start()


def test_a_script_names_the_program_that_is_there(tmp_path, monkeypatch):
    monkeypatch.setattr(sys, "executable", str(tmp_path / "python3"))
    user = tmp_path / "user"
    user.mkdir()
    monkeypatch.setattr(slurm.sysconfig, "get_path", lambda *args: str(user))
    assert slurm.program()[1:] == ["-P", "-m", "rattlesweep"]
    installed = user / "rattlesweep"
    installed.touch(mode=0o755)
    assert slurm.program() == [str(installed)]


def test_a_trajectory_can_be_sent_to_another_process():
    settings = {"n_i": 0.1, "omega_xy0": 0.01, "t_end": 20}
    channels = ["t", "n", "u_x"]
    for more in ({"channels": channels}, {"section": "u_x=0"}):
        sent = rs.trajectory("GH", **settings, **more)
        got = pickle.loads(pickle.dumps(sent))
        assert got.table.equals(sent.table)
        assert (got.t_end, got.status, got.units) == (20, "ok", sent.units)
        got.plot()
    assert got.section.equals(sent.section)


def test_figures_are_drawn_with_settings_that_do_not_fit(output, tmp_path):
    (tmp_path / "matplotlibrc").write_text(
        "text.usetex: True\nimage.cmap: nosuch\nsavefig.format: nosuch\n"
    )
    environment = os.environ | {
        "MPLBACKEND": "module://no_such_backend",
        "MATPLOTLIBRC": str(tmp_path / "matplotlibrc"),
        "PATH": "/nowhere",
    }
    figure = tmp_path / "a.png"
    command = [sweeping.PROGRAM, "plot", output, "--output", figure]
    done = subprocess.run(command, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert figure.stat().st_size > 5000


def test_no_threads_and_no_memory_are_sentences(tmp_path, monkeypatch):
    import threading

    def fail(*args: Any) -> None:
        raise RuntimeError("can't start new thread")

    args = ("run", CONFIGS / "quickstart.yaml", "--output", tmp_path / "out", "-q")
    with monkeypatch.context() as patch:
        patch.setattr(threading.Thread, "start", fail)
        done = sweeping.invoke(*args)
    assert (done.exit_code, done.stderr.count("\n")) == (1, 1)
    assert "can't start new thread; the system's limit of threads" in done.stderr

    def full(*args: Any, **kwargs: Any) -> None:
        raise MemoryError

    monkeypatch.setattr("rattlesweep.work.run.run_sweep", full)
    done = sweeping.invoke(*args)
    assert (done.exit_code, done.stderr.count("\n")) == (1, 1)
    assert "not enough memory" in done.stderr
