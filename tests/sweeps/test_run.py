"""The main job through the command line: run and classify, what they say, and what they leave."""

from __future__ import annotations

import os
import pty
import re
import select
import shutil
import signal
import subprocess
import sys
import termios
import time
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pytest
from hardship import wait_until
from refusal import assert_refused
from sweeping import (
    PROGRAM,
    begin,
    content_hash,
    invoke,
    manifest,
    plan_of,
    proved,
    rows,
    run,
    start,
    tree,
)

import rattlesweep as rs
from rattlesweep.cli.common import progress
from rattlesweep.sweeps.block import prepare_block
from rattlesweep.sweeps.config.read import parse_config
from rattlesweep.sweeps.old.progress import Progress, Tracker
from rattlesweep.sweeps.arrow import same_schema
from rattlesweep.sweeps.columns import runs_schema, summary_schema

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
    "spin.n_i=[-0.1, -0.3, -0.5]", "block_size=50",
)  # fmt: skip
FORMULA = ("model=gh", "bodies.samples=4", "bodies.target.rel_tol=0.1")


@pytest.fixture(scope="module")
def mixed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A sweep with runs of every type, in several blocks."""
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
    assert left == {"manifest.json", "runs", "summary.parquet"}
    proved(output, recompute=3)
    said, frame = manifest(output), rows(output)
    blocks = sorted(path.name for path in (output / "runs").iterdir())
    assert blocks == [f"block-{k:06d}.parquet" for k in range(said["blocks"])]
    schema = runs_schema(plan_of(name).config.parts)
    assert same_schema(pq.read_schema(output / "runs" / blocks[0]), schema)
    assert same_schema(pq.read_schema(output / "summary.parquet"), summary_schema())
    assert said["runs"] == len(frame) == said["samples"] * len(said["cases"])
    assert frame["sample"].tolist() == [*range(said["samples"])] * len(said["cases"])
    assert frame.case.is_monotonic_increasing
    assert (frame.status == "ok").all()
    # At the configs' tolerance of 1e-9; the longest runs drift most.
    assert (frame.energy_drift.abs() < (1e-9 if name == "gh.yaml" else 1e-6)).all()
    ends = frame[frame.t_r.notna()]
    assert ends.index.equals(frame.index[frame.type == "R"])
    # Runs that count reversals go on behind the first.
    goes_on = "n_reversals" in frame
    assert (ends.t_r < ends.t_end if goes_on else ends.t_r == ends.t_end).all()
    head, *lines = result.stdout.splitlines()
    assert head.split()[:4] == ["case", "target", "n_i", "omega_xy0"]
    assert len(lines) == min(20, len(said["cases"]))


def test_the_manifest_is_enough_to_run_it_again(mixed, tmp_path):
    said = manifest(mixed)
    assert said["state"] == "complete"
    for key in ("config", "config_hash", "versions", "machine", "started", "finished", "seconds"):
        assert said[key], key
    assert said["versions"]["rattlesweep"] == rs.__version__
    assert said["versions"]["numpy"] == np.__version__
    assert {"cpu", "processors", "system"} <= said["machine"].keys()
    config = parse_config(said["config"]).model_dump(exclude_none=True)
    again = rs.sweep(config, output=tmp_path / "again")
    assert content_hash(again.directory) == content_hash(mixed)
    assert again.manifest["config_hash"] == said["config_hash"]
    assert again.manifest["config"] == said["config"]
    # Cases are the targets with every launch each.
    summary = pd.read_parquet(mixed / "summary.parquet")
    assert summary.K_r.tolist() == [0.01] * 3 + [0.1] * 3
    assert summary.K_p.isna().all()
    assert summary.n_i.tolist() == [-0.1, -0.3, -0.5] * 2
    assert (summary.omega_xy0 == 0.01).all()


# -- numbers -----------------------------------------------------------------------------------


def test_the_reversal_times_of_garcia_and_hubbards_body(tmp_path):
    assert run("gh.yaml", tmp_path / "out").exit_code == 0
    frame = rows(tmp_path / "out")
    assert frame.n_i.tolist() == [0.1, -0.1]
    assert frame.t_r.tolist() == pytest.approx([112.0939, 809.857], rel=1e-6)
    assert frame.K_p.tolist() == pytest.approx([0.553] * 2, abs=5e-4)
    assert frame.K_r.tolist() == pytest.approx([0.0967] * 2, abs=1e-4)
    assert frame.f_sd.isna().all()
    # record: [energy, contact] of the config
    assert (frame.energy_0 > 0).all()
    assert (frame.energy_drift_max >= frame.energy_drift.abs()).all()
    assert (frame.energy_drift_max < 1e-9).all()
    assert frame.contact_ratio_max.between(0, 1, inclusive="neither").all()
    assert frame.contact_normal_min.between(0.5, 1, inclusive="neither").all()


@pytest.mark.parametrize("name", ["quickstart.yaml", "unsteady.yaml"])
def test_along_one_mode_the_reduced_model_is_the_closed_form(name, tmp_path):
    sets = ("bodies.samples=3", "bodies.target.rel_tol=0.1")
    run(name, tmp_path / "reduced", *sets, "model=reduced", "integrator.tol=1e-11")
    run(name, tmp_path / "closed", *sets, "model=gh")
    frame, closed = rows(tmp_path / "reduced"), rows(tmp_path / "closed")
    assert (frame.t_r / frame.t_rgh - 1).abs().max() < 1e-8
    assert frame.t_r.notna().all()
    assert (closed.t_r == closed.t_rgh).all()
    assert (closed.t_rgh == frame.t_rgh).all()
    assert (closed.type == "R").all()
    assert (closed.n_steps == 0).all()


def test_horizons_and_directions_of_the_launch():
    def launches(*sets: str) -> Any:
        plan = plan_of("gh.yaml", *sets)
        return prepare_block(plan, plan.block(0))[0]

    t_rgh = launches().gh.t_rgh
    for horizon, expected in (
        ("{t: 100}", [100, 100]), ("{t: 100, t_rgh: 5}", [100, 100]),
        ("{t: 1e9, t_rgh: 0.1}", (0.1 * t_rgh).tolist()),
    ):  # fmt: skip
        assert launches(f"horizon={horizon}").t_end.tolist() == expected
    modes = rs.modes(rs.Rattleback.gh())
    for psi, expected in (
        ("relevant", [modes.psi_p, modes.psi_r]), ("pitch", [modes.psi_p] * 2),
        ("roll", [modes.psi_r] * 2), ("30", [np.radians(30.0)] * 2),
    ):  # fmt: skip
        assert launches(f"spin.psi={psi}").psi.tolist() == expected


def test_windows_are_recorded_when_asked_for(tmp_path):
    sets = ("bodies.samples=5", "bodies.target={K_r: 0.03, rel_tol: 0.1}", "record=[windows]")
    assert run("quickstart.yaml", tmp_path / "out", *sets).exit_code == 0
    frame = rows(tmp_path / "out")
    assert "energy_0" not in frame
    for row in frame.itertuples():
        amplitude, least, most = row.window_amplitude, row.window_n_min, row.window_n_max
        assert 1 <= len(amplitude) == len(least) == len(most) <= 64
        assert len(amplitude) * row.window_t <= row.t_end * (1 + 1e-9) + row.window_t
        assert (least <= most).all()
        assert np.isfinite([amplitude, least, most]).all()
        assert (amplitude > 0).all()
        # The columns that types are made of, from the windows.
        if row.type != "R":
            departure = max(1 - min(abs(least).min(), abs(most).min()) / abs(row.n_i), 0)
            assert row.n_departure == pytest.approx(departure, rel=1e-6, abs=1e-9)


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
    assert f"{len(frame)} runs are not ok:" in result.stderr
    assert not np.isinf(frame.select_dtypes(float)).any(axis=None)
    assert sum(manifest(output)["failed"].values()) == len(frame)
    # The same command again finds everything there, and says the same.
    again = run("quickstart.yaml", output, *sets)
    assert again.exit_code == 3
    assert again.stdout == result.stdout
    assert f"{len(frame)} of them from before" in again.stderr


# -- the same directory again ------------------------------------------------------------------


def test_another_config_is_kept_out_of_a_directory(tmp_path):
    output, table = tmp_path / "out", tmp_path / "b.csv"
    run("gh.yaml", output)
    before = tree(output)
    for text, words in (
        ("spin.omega_xy0=0.02", "spin.omega_xy0: [0.01] against [0.02]"),
        ("integrator.tol=1e-8", "integrator.tol: 1e-09 against 1e-08"),
        ("seed=1", "seed: 0 against 1"),
        ("record=[]", 'record: ["energy", "contact"] against []'),
    ):
        for options in ((), ("--dry-run",)):
            result = run("gh.yaml", output, text, options=options)
            assert_refused(result, 2, f"{output}: it holds the runs of another config", words)
    assert tree(output) == before
    sets = (f"bodies={{source: table, path: {table}}}", "model=gh", "record=[]")
    for theta in (0.6429, 0.65):
        table.write_text(f"alpha,beta,gamma,theta,phi,xi\n13.04,1.522,12.28,{theta},0.036,-0.03\n")
        result = run("gh.yaml", tmp_path / "table", *sets)
    assert_refused(result, 2, "the table of bodies has changed")


def test_runs_whose_manifest_is_lost_know_their_config(tmp_path):
    output = tmp_path / "out"
    run("quickstart.yaml", output, *FORMULA, "block_size=7")
    before = tree(output / "runs")
    for damage in (Path.unlink, lambda path: path.write_bytes(path.read_bytes()[:-40])):
        damage(output / "manifest.json")
        result = run("quickstart.yaml", output, *FORMULA, "seed=1")
        assert_refused(result, 2, "it holds runs but no intact manifest.json")
        result = run("quickstart.yaml", output, *FORMULA)
        assert result.exit_code == 0
        assert "60 of them from before" in result.stderr
        assert tree(output / "runs") == before
        assert manifest(output)["config"]["block_size"] == 7
        assert manifest(output)["state"] == "complete"


def test_blocks_stay_as_the_directory_was_begun(tmp_path):
    output = tmp_path / "out"
    run("quickstart.yaml", output, *FORMULA, "block_size=7")
    before = tree(output / "runs")
    (output / "runs" / "block-000003.parquet").unlink()
    other = ("name=other", "output=elsewhere", "block_size=50")
    result = run("quickstart.yaml", output, *FORMULA, *other, options=("--threads", 1))
    assert "was begun in blocks of 7 runs, and keeps that size" in result.stderr
    assert "53 of them from before" in result.stderr
    assert tree(output / "runs") == before


def test_a_dry_run_writes_nothing(tmp_path):
    result = run(
        "steady.yaml", tmp_path / "a" / "b", "model=gh", "record=[]", options=("--dry-run",)
    )
    assert result.exit_code == 0
    words = dict(re.split(r"  +", line, maxsplit=1) for line in result.stdout.splitlines())
    assert words["runs"] == "120,000 in 120 cases"
    assert words["blocks"] == "30 of 4,000 runs"
    assert {"time", "done at", "disk", "memory"} <= set(words)
    assert list(tmp_path.iterdir()) == []


# -- types again -------------------------------------------------------------------------------


def by_rule(frame: pd.DataFrame, ss_growth: float, sw_departure: float) -> pd.Series:
    """The paper's types, straight from the columns."""
    types = pd.Series("unclassified", index=frame.index, dtype=frame.type.dtype)
    types[frame.n_departure > sw_departure] = "SW"
    types[frame.amp_growth <= ss_growth] = "SS"
    types[frame.t_r.notna()] = "R"
    return types.rename("type")


@pytest.mark.parametrize("command", ["classify", "run"])
def test_types_follow_their_thresholds_and_come_back(command, mixed, tmp_path):
    output = shutil.copytree(mixed, tmp_path / "out")
    last = before = rows(output)
    assert set(before.type) == {"R", "SS", "SW", "unclassified"}
    assert by_rule(before, 1e-3, 0.05).equals(before.type)
    for ss, sw in ((1e-3, 0.9), (1e3, 0.05), (1e-12, 1e-6), (1e-3, 0.05)):
        thresholds = (f"classify.ss_growth={ss}", f"classify.sw_departure={sw}")
        if command == "classify":
            result = invoke(
                "classify", output, *(w for text in thresholds for w in ("--set", text))
            )
        else:
            result = run("quickstart.yaml", output, *MIXED, *thresholds)
        assert result.exit_code == 0
        after = rows(output)
        assert by_rule(after, ss, sw).equals(after.type)
        assert after.drop(columns="type").equals(before.drop(columns="type"))
        proved(output)  # the summary too
        assert manifest(output)["config"]["classify"] == {
            "ss_growth": ss, "sw_departure": sw, "early": False, "dead_energy": 0.01,
        }  # fmt: skip
        if command == "classify":
            changed = (after.type != last.type).sum()
            assert f"{changed} runs have changed their type" in result.stderr
            assert (content_hash(output) != content_hash(mixed)) == (sw != 0.05 or ss != 1e-3)
        else:
            assert f"{len(after)} of them from before" in result.stderr
        last = after
    assert tree(output / "runs") == tree(mixed / "runs")
    assert (output / "summary.parquet").read_bytes() == (mixed / "summary.parquet").read_bytes()
    if command == "classify":
        assert manifest(output) == manifest(mixed)
        assert "0 runs have changed" in invoke("classify", output).stderr


def test_thresholds_of_classify_are_not_put_back_in_silence(tmp_path):
    output = tmp_path / "out"
    run("quickstart.yaml", output, *FORMULA)
    own = manifest(output)["config"]["classify"]
    assert "classified" not in manifest(output)
    assert "`rattlesweep run` would put back" not in invoke("classify", output).stderr
    result = invoke("classify", output, "--set", "classify.sw_departure=0.25")
    for words in (
        f"written: 1 blocks, summary.parquet and manifest.json in {output}",
        "types by ss_growth 0.001, sw_departure 0.25, dead_energy 0.01; before by ss_growth",
        "`rattlesweep run` would put back those of the config",
    ):
        assert words in result.stderr
    # Once more: the config's are those of the config, and not those of the time before.
    invoke("classify", output, "--set", "classify.sw_departure=0.5")
    said = manifest(output)
    thresholds = {key: value for key, value in own.items() if key != "early"}
    assert said["config"]["classify"] == own | {"sw_departure": 0.5}
    assert said["classified"]["config"] == thresholds
    assert said["classified"]["now"] == thresholds | {"sw_departure": 0.5}
    result = run("quickstart.yaml", output, *FORMULA)
    assert "had types by the thresholds of `rattlesweep classify`" in result.stderr
    assert "classify.sw_departure: 0.5 against 0.05" in result.stderr
    assert "classified" not in manifest(output)
    assert manifest(output)["config"]["classify"] == own
    # An edited config says so, too.
    result = run("quickstart.yaml", output, *FORMULA, "classify.sw_departure=0.25")
    assert "had types by the thresholds of an earlier config" in result.stderr


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("horizon.t=3", "only keys of classify can change without integrating"),
        ("bodies.samples=3", "only keys of classify can change without integrating"),
        ("classify.sw_depature=0.1", 'did you mean "sw_departure"?'),
        ("classify.sw_departure=2", "2 is out of range; it must be below 1"),
        ("classify.ss_growth=0", "0 is out of range; it must be above 0"),
        ("classify.ss_growth", "is not KEY=VALUE"),
        ("classify={}", "classify"),
        ("classify.early=true", "early: it decides when runs end, which takes their integration"),
        ("classify.early=1", "1 is given here; write true or false"),
        ("classify.ss_growth=big", '"big" (text) is given here; write a number'),
    ],
)
def test_classify_refuses_other_keys_and_values(text, words, mixed):
    before = tree(mixed)
    assert_refused(invoke("classify", mixed, "--set", text), 2, words)
    assert tree(mixed) == before


# -- what is said, and where -------------------------------------------------------------------


def test_quiet_says_nothing_and_the_table_goes_to_standard_output(tmp_path):
    quiet = run("gh.yaml", tmp_path / "q", options=("-q",))
    assert (quiet.exit_code, quiet.stdout, quiet.stderr) == (0, "", "")
    loud = run("gh.yaml", tmp_path / "l")
    assert re.search(r"^ *1 +- +-0.1 +0.01 +1 +1.000", loud.stdout, re.MULTILINE)
    assert "112.09" in loud.stdout
    assert len(loud.stdout.splitlines()) == 3
    assert re.fullmatch(
        r"2 runs in \S+, 0 of them from before; .* runs a second\n"
        r"see them: rattlesweep plot \S+, rattlesweep report \S+\n",
        loud.stderr,
    )
    verbose = run("gh.yaml", tmp_path / "v", options=("-v",))
    assert verbose.stdout == loud.stdout
    assert re.search(r"^kernel .*[0-9.]+ s$", verbose.stderr, re.MULTILINE)


@pytest.fixture
def clock(monkeypatch):
    """The time that progress is told in, in a list to be changed."""
    now = [0.0]
    monkeypatch.setattr(progress.time, "monotonic", lambda: now[0])
    return now


def test_without_a_terminal_there_is_at_most_one_line_a_minute(clock, capfd):
    with progress.Meter(quiet=False) as meter:
        for tick in range(6001):
            clock[0] = tick / 10
            meter(Progress(tick / 6000, tick, 6000, clock[0], 600 - clock[0]))
    lines = capfd.readouterr().err.splitlines()
    assert len(lines) == 10
    assert lines[0] == "10.0 %, 600/6000 runs, 1:00, 9:00 left"
    with progress.Meter(quiet=True) as meter:
        clock[0] = 1e6
        meter(Progress(0.5, 1, 2, 1e6, None))
    assert capfd.readouterr().err == ""


def test_a_terminal_gets_a_bar_with_the_time_left(monkeypatch):
    master, slave = pty.openpty()
    termios.tcsetwinsize(slave, (25, 100))
    with os.fdopen(slave, "w") as terminal, os.fdopen(master, "rb", buffering=0) as screen:
        monkeypatch.setattr(sys, "stderr", terminal)
        with progress.Meter() as meter:
            meter(Progress(0.25, 250, 1000, 3.0, 9.0))
            time.sleep(0.2)  # a bar that is drawn too often is not
            meter(Progress(1.0, 1000, 1000, 12.0, 0.0))
        drawn = b""
        while b"1000/1000" not in drawn and select.select([screen], [], [], 60)[0]:
            drawn += screen.read(65536)
    shown = drawn.decode(errors="ignore")
    assert re.search(r" 25%\|.*\| 250/1000 runs, 0:03, 0:09 left", shown)
    assert re.search(r"100%\|.*\| 1000/1000 runs, 0:12", shown)


def test_the_time_left_never_falls_below_zero():
    """Costs add up to a last bit more in another order, here 1e-15."""
    blocks: Any = [SimpleNamespace(index=i, rows=5) for i in range(10)]
    cost = [0.7, 0.7, 0.1, 0.3, 0.6, 0.7, 0.7, 0.3, 0.7, 0.3]
    costs: Any = SimpleNamespace(of=lambda block: cost[block.index])
    seen: list[Progress] = []
    tracker = Tracker(costs, blocks, dict.fromkeys(range(10), 5), seen.append)
    tracker.begin()
    for block in reversed(blocks):
        tracker.finish(block)
        tracker.tick()
    assert all(p.left is not None and p.left >= 0 for p in seen)
    assert [p.fraction for p in seen] == sorted(p.fraction for p in seen)
    assert (seen[-1].fraction, seen[-1].runs) == (1.0, 50)


def test_a_reader_that_goes_away_is_no_crash():
    child = start("schema")
    assert child.stdout is not None
    assert child.stderr is not None
    child.stdout.close()
    with child.stderr:
        assert "Traceback" not in child.stderr.read()
    assert child.wait(30) in (0, 1)


# -- interrupted -------------------------------------------------------------------------------


def test_ctrl_c_is_heard_within_a_block_and_while_bodies_are_drawn(tmp_path):
    # One block of several seconds, and hours of drawing before anything is written.
    block = ("block_size=100000", "bodies.samples=6000")
    hard = ("bodies.target={K_r: 0.1, rel_tol: 1e-9, max_draws: 4000000000000}",)
    integrating, drawing = (begin(tmp_path / str(k), *sets) for k, sets in enumerate((block, hard)))
    wait_until((tmp_path / "0" / "manifest.json").exists, process=integrating)
    time.sleep(1)
    for child in (integrating, drawing):
        child.send_signal(signal.SIGINT)
    # The block, let alone the drawing, would take longer.
    table, said = integrating.communicate(timeout=20)
    assert (integrating.returncode, table) == (130, "")
    found = re.fullmatch(
        r"interrupted; ([0-9,]+) runs are kept, [0-9]+ in flight were lost, and the same command "
        "resumes from there\n",
        said,
    )
    assert found, said
    kept = sum(pq.read_metadata(p).num_rows for p in tmp_path.glob("0/runs/*"))
    assert kept == int(found[1].replace(",", "")) < 24_000
    assert [path.name for path in (tmp_path / "0").rglob(".*")] == [".locks"]
    assert manifest(tmp_path / "0")["state"] == "stopped"
    _, said = drawing.communicate(timeout=20)
    assert drawing.returncode == 130
    assert said.startswith("interrupted;")
    assert not (tmp_path / "1").exists()


def test_bodies_can_be_drawn_while_a_kernel_runs():
    """Numba's workqueue aborts the process if two threads use it at once.

    It is the pool that Numba falls back to where there is neither OpenMP nor TBB.
    """
    code = """
import time, numpy as np
from sweeping import plan_of
from rattlesweep.integrate.task import Task
from rattlesweep.sweeps.block import finish_block, prepare_block

plan = plan_of("quickstart.yaml", "bodies.target.rel_tol=0.1")
free = plan_of("quickstart.yaml", "bodies.target=")
block = prepare_block(plan, plan.block(0))
task = Task(lambda control: finish_block(plan.config, *block, control=control))
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
        check=False,
    )  # fmt: skip
    assert (done.returncode, done.stdout) == (0, "drawn"), done.stderr


@pytest.mark.slow
@pytest.mark.parametrize("wait", [1.0, 2.5, 5.0])
def test_ctrl_c_is_heard_while_kernels_compile(wait, tmp_path):
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path / "cache")}
    child = begin(tmp_path / "out", "bodies.target=", env=environment)
    time.sleep(wait)
    child.send_signal(signal.SIGINT)
    _, said = child.communicate(timeout=10)
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
        "import resource, subprocess, sys;"
        "code = subprocess.run(sys.argv[1:]).returncode;"
        "print(resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss, file=sys.stderr);"
        "sys.exit(code)"
    )
    command = [PROGRAM, "run", tmp_path / "c.yaml", "--output", tmp_path / "out", "-q"]
    done = subprocess.run(
        [sys.executable, "-c", code, *command], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    assert int(done.stderr.split()[-1]) * (1 if sys.platform == "darwin" else 1024) < 1.5e9
    summary = pd.read_parquet(tmp_path / "out" / "summary.parquet")
    assert summary.runs.tolist() == [count]
    assert summary.fraction_R.tolist() == [1.0]
    assert manifest(tmp_path / "out")["failed"] == {}
    shutil.rmtree(tmp_path / "out")  # over a gigabyte
