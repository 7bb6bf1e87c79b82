"""Systems that lack what Linux has: it is asked for, and not assumed."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from sweeping import CONFIGS, proved, run

from rattlesweep.system import files
from rattlesweep.work import dask as daskexecutor

# As on Windows, but for file names and locks, which are those of this system.
CODE = """if True:
    import builtins, multiprocessing.resource_tracker, os, signal, sys
    import platformdirs, rattlesweep.system.lockfile  # of this system

    for module, names in (
        (os, "fork forkpty register_at_fork sched_getaffinity geteuid getuid"),
        (signal, "pthread_sigmask SIGUSR1 SIGUSR2 SIGHUP setitimer"),
    ):
        for name in names.split():
            delattr(module, name)
    honest_open, honest_os_open = builtins.open, os.open

    def opened(path, *args, **kwargs):
        if str(path).startswith("/proc"):
            raise FileNotFoundError(2, "No such file or directory", str(path))
        return honest_open(path, *args, **kwargs)

    def os_opened(path, *args, **kwargs):
        if os.path.isdir(path):
            raise PermissionError(13, "Permission denied", path)
        return honest_os_open(path, *args, **kwargs)

    builtins.open, os.open = opened, os_opened
    from rattlesweep import cli

    config, *sets = sys.argv[1:]
    for line in (
        ["run", config, "--output", "out", "-q", *sets],
        ["run", config, "--output", "out", "-q", *sets],
        ["classify", "out", "--set", "classify.sw_departure=0.2"],
        ["classify", "out"],
        ["status", "out"],
        ["merge", "out", "--output", "merged"],
        ["verify", "merged", "--recompute", "3"],
        ["plot", "merged"],
        ["report", "merged"],
    ):
        try:
            cli.main(line)
        except SystemExit as end:
            assert end.code == 0, line
"""


def test_a_sweep_on_a_system_that_lacks_much(tmp_path: Path) -> None:
    config = CONFIGS / "quickstart.yaml"
    sets = ["bodies.samples=4", "bodies.target.rel_tol=0.05"]
    command = [sys.executable, "-c", CODE, str(config)]
    for text in sets:
        command += ["--set", text]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    run("quickstart.yaml", tmp_path / "plain", *sets)
    assert proved(tmp_path / "merged") == proved(tmp_path / "plain")


def test_a_folder_that_cannot_be_opened_is_not_synced(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    honest = os.open

    def refused(path: str, *args: int) -> int:
        if os.path.isdir(path):
            raise PermissionError(13, "Permission denied", path)
        return honest(path, *args)

    monkeypatch.setattr(os, "open", refused)
    files.replace_file(tmp_path / "a", b"whole")
    assert (tmp_path / "a").read_bytes() == b"whole"


def test_workers_start_where_signals_cannot_be_blocked(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.delattr(signal, "pthread_sigmask")
    entered = False
    with daskexecutor._interrupts_blocked():
        entered = True
    assert entered
