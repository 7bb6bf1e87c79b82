"""The main job through the command line: run and classify, what they say, and what they leave."""

from __future__ import annotations

import os
import re
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
from refusal import assert_refused
from sweeping import (
    PROGRAM,
    begin,
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
import rattlesweep.text
from rattlesweep.sweeps.columns import runs_schema, same_schema, summary_schema
from rattlesweep.sweeps.config.read import parse_config
from rattlesweep.sweeps.run import Progress

SMALL = {
    "gh.yaml": (),
    "map_theta_spin.yaml": ("bodies.axes={theta: [0.7, 0.9]}", "spin.n_i=[-0.3, 0.3]"),
    "million.yaml": ("bodies.samples=1", "bodies.target.rel_tol=0.05"),
    "quickstart.yaml": ("bodies.samples=4",),
    "reversals.yaml": (
        "bodies.axes={minus_xi_deg: [1, 2]}", "spin.n_i=[-0.3, 0.3]", "horizon.t=99",
    ),
    "steady.yaml": ("bodies.samples=1", "bodies.target.rel_tol=0.05"),
    "unsteady.yaml": ("bodies.samples=2", "bodies.target.rel_tol=0.05"),
}  # fmt: skip
MIXED = (
    "bodies.samples=40", "bodies.target={K_r: [0.01, 0.1], rel_tol: 0.1}",
    "spin.n_i=[-0.1, -0.3, -0.5]",
)  # fmt: skip


@pytest.fixture(scope="module")
def mixed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A sweep with runs of every type."""
    output = tmp_path_factory.mktemp("mixed") / "out"
    assert run("quickstart.yaml", output, *MIXED).exit_code == 0
    return output


# -- what a run leaves -------------------------------------------------------------------------


@pytest.mark.parametrize("name", SMALL)
def test_shipped_configs_run_and_leave_what_the_contract_says(name, tmp_path):
    output = tmp_path / "out"
    result = run(name, output, *SMALL[name])
    assert result.exit_code == 0
    left = {p.name for p in output.iterdir()} - {".locks"}
    assert left == {"manifest.json", "runs", "sessions", "summary.parquet"}
    proved(output, recompute=3)
    said, frame = manifest(output), rows(output)
    files = sorted(path.name for path in (output / "runs").iterdir())
    assert files[0] == "case00000-sample000000000.parquet"
    schema = runs_schema(plan_of(name).config.parts)
    assert same_schema(pq.read_schema(output / "runs" / files[0]), schema)
    assert same_schema(pq.read_schema(output / "summary.parquet"), summary_schema())
    assert len(frame) == said["samples"] * len(said["cases"])
    assert frame["sample"].tolist() == [*range(said["samples"])] * len(said["cases"])
    assert frame.case.is_monotonic_increasing
    assert (frame.status == "ok").all()
    assert (frame.energy_drift.abs() < 1e-6).all()
    ends = frame[frame.t_r.notna()]
    assert ends.index.equals(frame.index[frame.type == "R"])
    # Runs that count reversals go on behind the first.
    goes_on = "n_turns" in frame
    assert (ends.t_r < ends.t_end if goes_on else ends.t_r == ends.t_end).all()
    head, *lines = result.stdout.splitlines()
    assert head.split()[:4] == ["case", "target", "n_i", "omega_xy0"]
    assert len(lines) == min(20, len(said["cases"]))


def test_the_manifest_is_enough_to_run_it_again(mixed, tmp_path):
    said = manifest(mixed)
    for key in ("config", "config_hash", "versions", "machine", "started", "command"):
        assert said[key], key
    assert said["versions"]["rattlesweep"] == rs.__version__
    assert said["versions"]["numpy"] == np.__version__
    assert {"cpu", "processors", "system"} <= said["machine"].keys()
    config = parse_config(said["config"]).model_dump(exclude_none=True)
    again = sweep(tmp_path / "again", config).directory
    assert content_hash(again) == content_hash(mixed)
    for key in ("config", "config_hash", "cases", "samples", "columns"):
        assert manifest(again)[key] == said[key]
    # Cases are the targets with every launch each.
    summary = pd.read_parquet(mixed / "summary.parquet")
    assert summary.K_r.tolist() == [0.01] * 3 + [0.1] * 3
    assert summary.n_i.tolist() == [-0.1, -0.3, -0.5] * 2


# -- numbers -----------------------------------------------------------------------------------


def test_the_reversal_times_of_garcia_and_hubbards_body(tmp_path):
    assert run("gh.yaml", tmp_path / "out").exit_code == 0
    frame = rows(tmp_path / "out")
    assert frame.n_i.tolist() == [0.1, -0.1]
    assert frame.t_r.tolist() == pytest.approx([112.0939, 809.857], rel=1e-6)
    assert frame.K_p.tolist() == pytest.approx([0.553] * 2, abs=5e-4)
    assert frame.K_r.tolist() == pytest.approx([0.0967] * 2, abs=1e-4)
    # record: [energy, contact] of the config
    assert (frame.energy_0 > 0).all()
    assert (frame.energy_drift_max >= frame.energy_drift.abs()).all()
    assert (frame.energy_drift_max < 1e-9).all()
    assert frame.contact_ratio_max.between(0, 1, inclusive="neither").all()
    assert frame.contact_normal_min.between(0.5, 1, inclusive="neither").all()


def test_windows_are_recorded_when_asked_for(tmp_path):
    sets = ("bodies.samples=5", "bodies.target={K_r: 0.03, rel_tol: 0.1}", "record=[windows]")
    assert run("quickstart.yaml", tmp_path / "out", *sets).exit_code == 0
    for row in rows(tmp_path / "out").itertuples():
        amplitude, least, most = row.window_amplitude, row.window_n_min, row.window_n_max
        assert 1 <= len(amplitude) == len(least) == len(most) <= 64
        assert len(amplitude) * row.window_t <= row.t_end * (1 + 1e-9) + row.window_t
        assert (least <= most).all()
        assert (amplitude > 0).all()
        # The column that types are made of, from the windows.
        if row.type != "R":
            departure = max(1 - min(abs(least).min(), abs(most).min()) / abs(row.n_i), 0)
            assert row.n_departure == pytest.approx(departure, rel=1e-6, abs=1e-9)


def test_t_r_is_kept_and_the_type_is_not_where_a_run_fails_later(tmp_path):
    config = {
        "bodies": {"source": "sd", "samples": 8},
        "spin": {"n_i": 0.5, "omega_xy0": 0.1},
        "horizon": {"t": 600},
        "integrator": {"max_steps": 2000},
    }
    plain = rs.sweep(config, output=tmp_path / "plain").runs
    swept = rs.sweep(config | {"record": ["reversals"]}, output=tmp_path / "turns")
    runs = swept.runs
    late = (runs.status != "ok") & (plain.type == "R")
    assert late.sum() >= 3
    assert (runs[late].t_r == plain[late].t_r).all()
    assert runs[late][["type", "n_turns"]].isna().all(axis=None)
    # No share and no mean counts them.
    assert swept.summary.failed[0] == (runs.status != "ok").sum()
    assert np.isnan(swept.summary.t_r_mean[0])
    proved(tmp_path / "turns")


def test_runs_that_fail_are_rows_with_a_status_and_the_exit_code_says_so(tmp_path):
    output = tmp_path / "out"
    sets = ("bodies.samples=3", "bodies.target.rel_tol=0.1", "integrator={method: rk4, dt: 3}",
            "record=[energy, contact, windows]")  # fmt: skip
    result = run("quickstart.yaml", output, *sets)
    assert result.exit_code == 3
    frame, summary = rows(output), pd.read_parquet(output / "summary.parquet")
    assert set(frame.status) <= {"nonfinite", "energy", "coarse_step"}
    assert frame.type.isna().all()
    assert (summary.failed == 3).all()
    assert summary.fraction_R.isna().all()
    assert f"{len(frame)} runs failed:" in result.stderr
    assert not np.isinf(frame.select_dtypes(float)).any(axis=None)
    # The same command again finds everything there, and says the same.
    again = run("quickstart.yaml", output, *sets)
    assert again.exit_code == 3
    assert again.stdout == result.stdout
    assert ", 0 of them done now" in again.stderr


# -- the same directory again ------------------------------------------------------------------


def test_another_config_is_kept_out_of_a_directory(tmp_path):
    output, table = tmp_path / "out", tmp_path / "b.csv"
    run("gh.yaml", output)
    before = tree(output)
    for text, words in (
        ("spin.omega_xy0=0.02", "holds runs with n_i 0.1, omega_xy0 0.01, which the config"),
        ("integrator.tol=1e-8", "integrator.tol: 1e-09 against 1e-08"),
        ("seed=1", "seed: 0 against 1"),
        ("record=[]", "record: "),
    ):
        for options in ((), ("--dry-run",)):
            result = run("gh.yaml", output, text, options=options)
            assert_refused(result, 2, f"{output}: ", words)
    assert tree(output) == before
    sets = (f"bodies={{source: table, path: {table}}}", "model=gh", "record=[]")
    for theta in (0.6429, 0.65):
        table.write_text(f"alpha,beta,gamma,theta,phi,xi\n13.04,1.522,12.28,{theta},0.036,-0.03\n")
        result = run("gh.yaml", tmp_path / "table", *sets)
    assert_refused(result, 2, "the table of bodies has changed")


# -- what is said, and where -------------------------------------------------------------------


def test_quiet_says_nothing_and_the_table_goes_to_standard_output(tmp_path):
    quiet = run("gh.yaml", tmp_path / "q", options=("-q",))
    assert (quiet.exit_code, quiet.stdout, quiet.stderr) == (0, "", "")
    loud = run("gh.yaml", tmp_path / "l", options=("-v",))
    assert re.search(r"^ *1 +- +-0.1 +0.01 +1 +1.000", loud.stdout, re.MULTILINE)
    assert len(loud.stdout.splitlines()) == 3
    assert re.match(r"2 runs in \S+, 2 of them done now in .* s\n", loud.stderr)
    assert re.search(r"of integration", loud.stderr, re.MULTILINE)


def test_without_a_terminal_there_is_at_most_one_line_a_minute(monkeypatch, capfd):
    now = [0.0]
    monkeypatch.setattr(rattlesweep.text.time, "monotonic", lambda: now[0])
    with rattlesweep.text.Bar.of_command() as meter:
        for tick in range(6001):
            now[0] = tick / 10
            meter(Progress(tick / 6000, tick, 6000, now[0], 600 - now[0]))
    lines = capfd.readouterr().err.splitlines()
    assert len(lines) == 10
    assert lines[0] == "10.0 %, 600 of 6,000 runs, 1:00, 9:00 left"


def test_bodies_can_be_drawn_while_a_kernel_runs():
    """Numba's workqueue aborts the process if two threads use it at once.

    It is the pool that Numba falls back to where there is neither OpenMP nor TBB.
    """
    code = """
import time, numpy as np
from sweeping import plan_of
from rattlesweep.integrate.task import Task
from rattlesweep.sweeps.block import compute, prepare_runs

plan = plan_of("quickstart.yaml", "bodies.target.rel_tol=0.1")
free = plan_of("quickstart.yaml", "bodies.target=")
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
    own = {"NUMBA_THREADING_LAYER": "workqueue", "PYTHONPATH": os.pathsep.join(sys.path)}
    done = subprocess.run(
        [sys.executable, "-c", code], env=os.environ | own, capture_output=True, text=True,
        check=False, timeout=600,
    )  # fmt: skip
    assert (done.returncode, done.stdout) == (0, "drawn"), done.stderr


@pytest.mark.slow
@pytest.mark.parametrize("wait", [1.0, 2.5, 5.0])
def test_ctrl_c_is_heard_while_kernels_compile(wait, tmp_path):
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path / "cache")}
    child = begin(tmp_path / "out", "bodies.target=", env=environment)
    time.sleep(wait)
    child.send_signal(signal.SIGINT)
    _, said = child.communicate(timeout=60)
    assert child.returncode == 130
    assert said.splitlines()[-1].startswith("interrupted;")


@pytest.mark.slow
def test_ten_million_bodies_of_the_closed_form_in_bounded_memory(tmp_path):
    count = 10_000_000
    (tmp_path / "c.yaml").write_text(
        f"bodies: {{source: sd, samples: {count}}}\nspin: {{n_i: -0.1, omega_xy0: 0.01}}\n"
        "model: gh\n"
    )
    # A process between, whose only child is the one that is measured.
    code = (
        "import resource, subprocess, sys; subprocess.run(sys.argv[1:], check=True);"
        "print(resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss)"
    )
    command = [PROGRAM, "run", tmp_path / "c.yaml", "--output", tmp_path / "out", "-q"]
    kilobytes = int(subprocess.check_output([sys.executable, "-c", code, *command], timeout=1200))
    assert kilobytes * (1 if sys.platform == "darwin" else 1024) < 1.5e9
    summary = pd.read_parquet(tmp_path / "out" / "summary.parquet")
    assert (summary.runs.tolist(), summary.fraction_R.tolist()) == ([count], [1.0])
    shutil.rmtree(tmp_path / "out")  # over a gigabyte
