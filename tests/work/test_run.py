"""`run` from the command line: what it prints, and the files that it leaves."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pytest
import sweeping
from refusal import assert_refused
from sweeping import (
    PROGRAM,
    content_hash,
    manifest,
    plan_of,
    proved,
    rows,
    run,
    sweep,
    tree,
)

import rattlesweep as rs
from rattlesweep.config.read import parse_config
from rattlesweep.rows.arrow import same_schema
from rattlesweep.rows.columns import runs_schema
from rattlesweep.store.summary import SCHEMA

SMALL = {
    "gh.yaml": (),
    "map_theta_spin.yaml": ("bodies.axes={theta: [0.7, 0.9]}", "spin.n_i=[-0.3, 0.3]"),
    "million.yaml": ("bodies.samples=1", "bodies.target.rel_tol=0.05"),
    "quickstart.yaml": ("bodies.samples=4",),
    "reversals.yaml": (
        "bodies.axes={minus_xi_deg: [1, 2]}",
        "spin.n_i=[-0.3, 0.3]",
        "horizon.t=99",
    ),
    "steady.yaml": ("bodies.samples=1", "bodies.target.rel_tol=0.05"),
    "unsteady.yaml": ("bodies.samples=2", "bodies.target.rel_tol=0.05"),
}
MIXED = (
    "bodies.samples=40",
    "bodies.target={K_r: [0.01, 0.1], rel_tol: 0.1}",
    "spin.n_i=[-0.1, -0.3, -0.5]",
)


@pytest.fixture(scope="module")
def mixed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    output = tmp_path_factory.mktemp("mixed") / "out"
    assert run("quickstart.yaml", output, *MIXED).exit_code == 0
    return output


# The others differ from these in ranges.
QUICK = {"gh.yaml", "quickstart.yaml", "reversals.yaml"}


@pytest.mark.parametrize("name", [p.name for p in sweeping.CONFIGS.glob("*.yaml")])
def test_shipped_configs_can_be_planned(name):
    plan = plan_of(name)
    assert plan.cases
    if name in SMALL:
        assert len(plan_of(name, *SMALL[name]).cases) <= len(plan.cases)


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=[] if name in QUICK else [pytest.mark.slow])
        for name in SMALL
    ],
)
def test_shipped_configs_run_and_leave_what_the_contract_says(name, tmp_path):
    output = tmp_path / "out"
    result = run(name, output, *SMALL[name])
    assert result.exit_code == 0
    left = {p.name for p in output.iterdir()} - {".locks"}
    assert left == {"manifest.json", "runs", "sessions", "summary.parquet"}
    proved(output, recompute=3)
    said = manifest(output)
    frame = rows(output)
    files = sorted(path.name for path in (output / "runs").iterdir())
    assert files[0].startswith("case00000-sample000000000-")
    schema = runs_schema(plan_of(name).config.parts)
    assert same_schema(pq.read_schema(output / "runs" / files[0]), schema)
    assert same_schema(pq.read_schema(output / "summary.parquet"), SCHEMA)
    assert len(frame) == said["samples"] * len(said["cases"])
    assert frame["sample"].tolist() == [*range(said["samples"])] * len(said["cases"])
    assert frame.case.is_monotonic_increasing
    assert (frame.status == "ok").all()
    assert (frame.energy_drift.abs() < 1e-6).all()
    ends = frame[frame.t_r.notna()]
    assert ends.index.equals(frame.index[frame.type == "R"])
    # Runs that count reversals go on after the first.
    goes_on = "n_turns" in frame
    assert (ends.t_r < ends.t_end if goes_on else ends.t_r == ends.t_end).all()
    head, *lines = result.stdout.splitlines()
    assert head.split()[:4] == ["case", "target", "n_i", "omega_xy0"]
    assert len(lines) == min(60, len(said["cases"]))


def test_the_manifest_is_enough_to_run_it_again(mixed, tmp_path):
    said = manifest(mixed)
    assert said["started"]
    assert said["command"]
    assert said["versions"].items() >= {
        ("rattlesweep", rs.__version__),
        ("numpy", np.__version__),
    }
    assert {"cpu", "processors", "system"} <= said["machine"].keys()
    config = parse_config(said["config"]).model_dump(exclude_none=True)
    again = tmp_path / "again"
    sweep(again, config)
    assert content_hash(again) == content_hash(mixed)
    for key in ("config", "config_hash", "cases", "samples", "columns"):
        assert manifest(again)[key] == said[key]
    # Each target is combined with every launch.
    summary = pd.read_parquet(mixed / "summary.parquet")
    assert summary.K_r.tolist() == [0.01] * 3 + [0.1] * 3
    assert summary.n_i.tolist() == [-0.1, -0.3, -0.5] * 2


def test_runs_that_fail_are_rows_with_a_status_and_the_exit_code_says_so(tmp_path):
    output = tmp_path / "out"
    sets = (
        "bodies.samples=3",
        "bodies.target.rel_tol=0.1",
        "integrator={method: rk4, dt: 3}",
        "record=[energy, contact, windows]",
    )
    result = run("quickstart.yaml", output, *sets)
    assert result.exit_code == 3
    frame = rows(output)
    summary = pd.read_parquet(output / "summary.parquet")
    assert set(frame.status) <= {"nonfinite", "energy", "coarse_step"}
    assert frame.type.isna().all()
    assert (summary.failed == 3).all()
    assert summary.fraction_R.isna().all()
    assert f"{len(frame)} runs failed:" in result.stderr
    assert not np.isinf(frame.select_dtypes(float)).any(axis=None)
    again = run("quickstart.yaml", output, *sets)  # says the same
    assert (again.exit_code, again.stdout) == (3, result.stdout)
    assert ", 0 of them done now" in again.stderr


def test_another_config_is_kept_out_of_a_directory(tmp_path):
    output = tmp_path / "out"
    run("gh.yaml", output)
    before = tree(output)
    for options in ((), ("--dry-run",)):
        result = run("gh.yaml", output, "record=[]", options=options)
        assert_refused(result, 2, f"{output}: ", "record: ")
    assert tree(output) == before


@pytest.mark.slow
def test_bodies_can_be_drawn_while_a_kernel_runs():
    """Numba's workqueue aborts the process if two threads use it at once.

    It is the pool that Numba falls back to where there is neither OpenMP nor TBB.
    """
    code = """
import time, numpy as np
from sweeping import plan_of
from rattlesweep.kernel.task import Task
from rattlesweep.work.block import compute, prepare_runs

plan = plan_of("quickstart.yaml", "bodies.target.rel_tol=0.1")
free = plan_of("quickstart.yaml", "bodies.target=null")
block = prepare_runs(plan, np.zeros(400, int), np.arange(400))
task = Task(lambda control: compute(plan.config, plan.schema, block, control=control))
while not task.control.runs_done:
    time.sleep(0.001)
for k in range(20):
    plan.source.bodies(plan.cases[-1].target, np.arange(100) + 100 * (k % 4))
    free.source.bodies(np.nan, np.arange(10_000))
assert task.is_alive()
print("drawn", end="", flush=True)
task.control.stop()
"""
    changes = {
        "NUMBA_THREADING_LAYER": "workqueue",
        "PYTHONPATH": os.pathsep.join(sys.path),
    }
    done = subprocess.run(
        [sys.executable, "-c", code],
        env=os.environ | changes,
        capture_output=True,
        text=True,
        check=False,
        timeout=600,
    )
    assert (done.returncode, done.stdout) == (0, "drawn"), done.stderr


@pytest.mark.slow
@pytest.mark.parametrize("wait", [1.0, 2.5, 5.0])
def test_ctrl_c_is_heard_while_kernels_compile(wait, tmp_path):
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path / "cache")}
    command = [
        PROGRAM,
        "run",
        sweeping.CONFIGS / "quickstart.yaml",
        "-o",
        tmp_path / "out",
    ]
    child = subprocess.Popen(
        command, env=environment, text=True, stderr=subprocess.PIPE
    )
    time.sleep(wait)
    child.send_signal(signal.SIGINT)
    _, said = child.communicate(timeout=60)
    assert child.returncode == 130
    assert said.splitlines()[-1].startswith("interrupted")


@pytest.mark.slow
def test_ten_million_bodies_of_the_closed_form_in_bounded_memory(tmp_path):
    count = 10_000_000
    (tmp_path / "c.yaml").write_text(
        f"bodies: {{source: sd, samples: {count}}}\n"
        "spin: {n_i: -0.1, omega_xy0: 0.01}\n"
        "model: gh\n"
    )
    # A process in between, whose only child is measured.
    code = (
        "import resource, subprocess, sys; subprocess.run(sys.argv[1:], check=True);"
        "print(resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss)"
    )
    command = [PROGRAM, "run", tmp_path / "c.yaml", "--output", tmp_path / "out", "-q"]
    kilobytes = int(
        subprocess.check_output([sys.executable, "-c", code, *command], timeout=1200)
    )
    assert kilobytes * (1 if sys.platform == "darwin" else 1024) < 1.5e9
    summary = pd.read_parquet(tmp_path / "out" / "summary.parquet")
    assert (summary.runs.tolist(), summary.fraction_R.tolist()) == ([count], [1.0])
    shutil.rmtree(tmp_path / "out")  # over a gigabyte
