"""The main job through the command line: run, classify, body, schema, and what they leave."""

from __future__ import annotations

import fcntl
import json
import os
import pty
import re
import shutil
import signal
import struct
import subprocess
import sys
import termios
import time
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from click.testing import CliRunner
from hardship import wait_until
from refusal import assert_refused

import rattlesweep as rs
from rattlesweep import cli
from rattlesweep.cli.common import progress
from rattlesweep.sweeps.config.load import parse_config
from rattlesweep.sweeps.engines.progress import Progress
from rattlesweep.sweeps.inspect.content_hash import content_hash
from rattlesweep.sweeps.tables.columns import runs_schema, summary_schema

ROOT = Path(__file__).parents[2]
CONFIGS = ROOT / "configs"
PROGRAM = Path(sys.executable).with_name("rattlesweep")

# The contract, apart from what the package says of itself.
KEYS = {"case": pa.int32(), "sample": pa.int64()}
FLOATS = (
    "alpha beta gamma theta phi xi f_sd n_i omega_xy0 psi omega_p omega_r K_p K_r n_c1 n_0 t_rgh "
    "t_end t_r n_end energy_drift"
)
NEVER_NULL = "case sample alpha beta gamma theta phi xi n_i omega_xy0 t_end status n_steps"
ORDER = (
    "case sample alpha beta gamma theta phi xi f_sd n_i omega_xy0 psi omega_p omega_r K_p K_r n_c1 "
    "n_0 t_rgh t_end t_r type status n_end n_steps energy_drift"
)
SUMMARY_ORDER = (
    "case K_p K_r n_i omega_xy0 runs fraction_R fraction_SS fraction_SW fraction_unclassified "
    "fraction_bondi t_r_mean t_r_std t_rgh_mean t_r_over_t_rgh_mean t_r_over_t_rgh_sem failed"
)

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


def invoke(*args: Any) -> Any:
    """One command in this process; whatever it raises is not the way it may end."""
    result = CliRunner().invoke(cli.main, [str(a) for a in args])
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    assert "Traceback" not in result.output
    return result


def run(config: str | Path, output: Path, *sets: str, options: tuple[Any, ...] = ()) -> Any:
    """Run a shipped config, or one at a path."""
    chosen = [part for text in sets for part in ("--set", text)]
    return invoke("run", CONFIGS / config, "--output", output, *chosen, *options)


def rows(output: Path) -> pd.DataFrame:
    return pd.concat([pd.read_parquet(p) for p in sorted((output / "runs").glob("*.parquet"))])


def manifest(output: Path) -> dict[str, Any]:
    return json.loads((output / "manifest.json").read_text())


def tree(directory: Path) -> dict[str, bytes]:
    return {
        str(p.relative_to(directory)): p.read_bytes() if p.is_file() else b""
        for p in sorted(directory.rglob("*"))
    }


def start(*args: Any, **kwargs: Any) -> subprocess.Popen[str]:
    """The program in a process of its own, without a terminal."""
    kwargs = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "stdin": subprocess.DEVNULL,
              "text": True, **kwargs}  # fmt: skip
    return subprocess.Popen([PROGRAM, *map(str, args)], **kwargs)


@pytest.fixture(scope="module")
def mixed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A sweep with runs of every type, in several blocks."""
    output = tmp_path_factory.mktemp("mixed") / "out"
    result = run("quickstart.yaml", output, *MIXED, "block_size=50")
    assert result.exit_code == 0
    return output


# -- what a run leaves -------------------------------------------------------------------------


@pytest.mark.parametrize("name", SMALL)
def test_shipped_configs_run_and_leave_what_the_contract_says(name, tmp_path):
    output = tmp_path / "out"
    result = run(name, output, *SMALL[name])
    assert result.exit_code == 0
    assert sorted(p.name for p in output.iterdir() if p.name != ".locks") == [
        "manifest.json", "runs", "summary.parquet",
    ]  # fmt: skip
    said = manifest(output)
    blocks = sorted((output / "runs").iterdir())
    assert [p.name for p in blocks] == [f"block-{k:06d}.parquet" for k in range(said["blocks"])]
    table = pa.concat_tables([pq.read_table(p) for p in blocks])
    schema = pq.read_schema(blocks[0])
    assert [n for n in schema.names if n in ORDER.split()] == ORDER.split()
    for field in schema:
        assert field.metadata[b"unit"]
        assert len(field.metadata[b"description"]) > 5
        wanted = KEYS.get(field.name, pa.float64() if field.name in FLOATS.split() else None)
        assert wanted is None or field.type == wanted
        assert not (field.name in NEVER_NULL.split() and field.nullable)
    assert schema.field("n_steps").type == pa.int64()
    assert schema.field("type").type == pa.string()
    for column in table.column_names:
        values = table.column(column)
        if column in NEVER_NULL.split():
            assert values.null_count == 0
        if pa.types.is_floating(values.type):
            assert np.isfinite(values.drop_null().to_numpy()).all(), column
    assert said["runs"] == table.num_rows == said["samples"] * len(said["cases"])
    frame = table.to_pandas()
    assert frame.equals(frame.sort_values(["case", "sample"], kind="stable"))
    assert frame["sample"].tolist() == [*range(said["samples"])] * len(said["cases"])
    assert (frame.status == "ok").all()
    # At the configs' tolerance of 1e-9; the longest runs drift most.
    assert (frame.energy_drift.abs() < (1e-9 if name == "gh.yaml" else 1e-6)).all()
    reversed_ = frame.t_r.notna()
    assert ((frame.type == "R") == reversed_).all()
    # Runs that count reversals go on behind the first.
    goes_on = "n_reversals" in frame
    ends = frame[reversed_]
    assert (ends.t_r < ends.t_end if goes_on else ends.t_r == ends.t_end).all()
    summary = pq.read_table(output / "summary.parquet")
    assert " ".join(summary.column_names).startswith(SUMMARY_ORDER)
    assert summary.num_rows == len(said["cases"])
    assert summary.column("runs").to_pylist() == [said["samples"]] * summary.num_rows
    head, *lines = result.stdout.splitlines()
    assert head.split()[:4] == ["case", "target", "n_i", "omega_xy0"]
    assert len(lines) == min(20, len(said["cases"]))


def test_the_two_schemas_are_those_that_the_package_declares(mixed):
    schema = pq.read_schema(mixed / "runs" / "block-000000.parquet")
    assert schema.equals(runs_schema(), check_metadata=False)
    assert pq.read_schema(mixed / "summary.parquet").equals(summary_schema(), check_metadata=False)


def test_the_manifest_is_enough_to_run_it_again(mixed, tmp_path):
    said = manifest(mixed)
    assert said["state"] == "complete"
    for key in ("config", "config_hash", "versions", "machine", "started", "finished", "seconds"):
        assert said[key], key
    assert said["versions"]["rattlesweep"] == rs.__version__
    assert said["versions"]["numpy"] == np.__version__
    assert {"cpu", "processors", "system"} <= said["machine"].keys()
    again = rs.sweep(parse_config(said["config"]).model_dump(exclude_none=True),
                     output=tmp_path / "again")  # fmt: skip
    assert content_hash(again.directory) == content_hash(mixed)
    assert again.manifest["config_hash"] == said["config_hash"]
    assert again.manifest["config"] == said["config"] | {"output": said["config"]["output"]}


def test_the_summary_is_what_pandas_makes_of_the_runs(mixed):
    frame, summary = rows(mixed), pd.read_parquet(mixed / "summary.parquet")
    assert set(frame.type) == {"R", "SS", "SW", "unclassified"}
    groups = frame.groupby("case")
    for kind in ("R", "SS", "SW", "unclassified"):
        share = groups.type.apply(lambda t, kind=kind: (t == kind).mean())
        np.testing.assert_allclose(summary[f"fraction_{kind}"], share, rtol=1e-15)
    bondi = (frame.n_c1.abs() < frame.n_i.abs()).groupby(frame.case).mean()
    np.testing.assert_allclose(summary.fraction_bondi, bondi, rtol=1e-15)
    of_r = frame[frame.type == "R"].groupby("case").t_r
    np.testing.assert_allclose(summary.t_r_mean, of_r.mean(), rtol=1e-13)
    np.testing.assert_allclose(summary.t_r_std, of_r.std(), rtol=1e-12)
    np.testing.assert_allclose(summary.t_rgh_mean, groups.t_rgh.mean(), rtol=1e-13)
    ratio = (frame.t_r / frame.t_rgh)[frame.type == "R"].groupby(frame.case[frame.type == "R"])
    np.testing.assert_allclose(summary.t_r_over_t_rgh_mean, ratio.mean(), rtol=1e-13)
    np.testing.assert_allclose(summary.t_r_over_t_rgh_sem, ratio.sem(), rtol=1e-12)
    assert (summary.failed == 0).all()
    assert (summary.runs == 40).all()
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
    assert ((frame.contact_ratio_max > 0) & (frame.contact_ratio_max < 1)).all()
    assert ((frame.contact_normal_min > 0.5) & (frame.contact_normal_min < 1)).all()


@pytest.mark.parametrize("name", ["quickstart.yaml", "unsteady.yaml"])
def test_along_one_mode_the_reduced_model_is_the_closed_form(name, tmp_path):
    sets = ("bodies.samples=3", "bodies.target.rel_tol=0.1", "model=reduced")
    assert run(name, tmp_path / "r", *sets, "integrator.tol=1e-11").exit_code == 0
    frame = rows(tmp_path / "r")
    assert frame.t_r.notna().all()
    assert (frame.t_r / frame.t_rgh - 1).abs().max() < 1e-8
    assert run(name, tmp_path / "g", *sets[:2], "model=gh").exit_code == 0
    closed = rows(tmp_path / "g")
    assert (closed.t_r == closed.t_rgh).all()
    assert (closed.t_rgh == frame.t_rgh).all()
    assert (closed.type == "R").all()
    assert (closed.n_steps == 0).all()


def test_horizons(tmp_path):
    for name, horizon in (
        ("both-t", "{t: 100, t_rgh: 5}"), ("t", "{t: 100}"), ("both-gh", "{t: 1e9, t_rgh: 0.1}"),
    ):  # fmt: skip
        assert run("gh.yaml", tmp_path / name, f"horizon={horizon}").exit_code == 0
        frame = rows(tmp_path / name)
        expected = np.full(2, 100.0) if name != "both-gh" else 0.1 * frame.t_rgh.to_numpy()
        assert frame.t_end.tolist() == expected.tolist()
        assert frame.t_r.isna().all()
        assert (frame.type != "R").all()


def test_windows_are_recorded_when_asked_for(tmp_path):
    sets = ("bodies.samples=5", "bodies.target={K_r: 0.03, rel_tol: 0.1}", "record=[windows]")
    assert run("quickstart.yaml", tmp_path / "out", *sets).exit_code == 0
    frame = rows(tmp_path / "out")
    assert "energy_0" not in frame
    for row in frame.itertuples():
        lists = [row.window_amplitude, row.window_n_min, row.window_n_max]
        assert len({len(x) for x in lists}) == 1
        assert 1 <= len(lists[0]) <= 64
        assert len(lists[0]) * row.window_t <= row.t_end * (1 + 1e-9) + row.window_t
        assert (lists[1] <= lists[2]).all()
        assert np.isfinite(np.concatenate(lists)).all()
        assert (lists[0] > 0).all()
        # The columns that types are made of, from the windows.
        departure = max(1 - min(abs(lists[1]).min(), abs(lists[2]).min()) / abs(row.n_i), 0)
        if row.type != "R":
            assert row.n_departure == pytest.approx(departure, rel=1e-6, abs=1e-9)


def test_directions_of_the_launch(tmp_path):
    frames = {}
    for psi in ("relevant", "pitch", "roll", "30"):
        output = tmp_path / psi
        assert run("gh.yaml", output, f"spin.psi={psi}", "horizon={t: 1}").exit_code == 0
        frames[psi] = rows(output)
    modes = rs.modes(rs.Rattleback.gh())
    assert frames["relevant"].psi.tolist() == [modes.psi_p, modes.psi_r]
    assert frames["pitch"].psi.tolist() == [modes.psi_p] * 2
    assert frames["roll"].psi.tolist() == [modes.psi_r] * 2
    assert frames["30"].psi.tolist() == [np.radians(30.0)] * 2


# -- failures ----------------------------------------------------------------------------------


def test_runs_that_fail_are_rows_with_a_status_and_the_exit_code_says_so(tmp_path):
    sets = ("bodies.samples=3", "bodies.target.rel_tol=0.1", "integrator={method: rk4, dt: 3}")
    result = run("quickstart.yaml", tmp_path / "out", *sets, "record=[energy, contact, windows]")
    assert result.exit_code == 3
    frame = rows(tmp_path / "out")
    failed = frame.status != "ok"
    assert failed.all()
    assert set(frame.status) <= {"nonfinite", "energy"}
    assert frame.type.isna().all()
    summary = pd.read_parquet(tmp_path / "out" / "summary.parquet")
    assert (summary.failed == 3).all()
    assert summary.fraction_R.isna().all()
    assert f"{len(frame)} runs are not ok:" in result.stderr
    for name in frame:
        if frame[name].dtype == float:
            assert not np.isinf(frame[name]).any()
    said = manifest(tmp_path / "out")
    assert sum(said["failed"].values()) == len(frame)
    # The same command again finds everything there, and says the same.
    again = run("quickstart.yaml", tmp_path / "out", *sets, "record=[energy, contact, windows]")
    assert again.exit_code == 3
    assert again.stdout == result.stdout


def test_the_step_limit_is_a_status(tmp_path):
    result = run("gh.yaml", tmp_path / "out", "integrator.max_steps=50")
    assert result.exit_code == 3
    assert rows(tmp_path / "out").status.tolist() == ["step_limit"] * 2
    assert "2 step_limit" in result.stderr


# -- the same directory again ------------------------------------------------------------------


def test_a_finished_sweep_is_not_run_again(tmp_path):
    output = tmp_path / "out"
    first = run("gh.yaml", output)
    before = tree(output / "runs")
    again = run("gh.yaml", output)
    assert again.stdout == first.stdout
    assert "2 of them from before" in again.stderr
    assert tree(output / "runs") == before


def test_a_damaged_or_missing_block_is_run_again(tmp_path):
    output = tmp_path / "out"
    sets = ("bodies.samples=4", "bodies.target.rel_tol=0.1", "block_size=7")
    run("quickstart.yaml", output, *sets)
    before = tree(output / "runs")
    blocks = sorted((output / "runs").iterdir())
    blocks[1].unlink()
    data = bytearray(blocks[3].read_bytes())
    data[len(data) // 2] ^= 1
    blocks[3].write_bytes(data)
    (output / "runs" / ".block-000005.parquet.0123abcd.tmp").write_bytes(b"half")
    result = run("quickstart.yaml", output, *sets)
    assert "46 of them from before" in result.stderr
    assert tree(output / "runs") == before


def test_another_config_is_kept_out_of_a_directory(tmp_path):
    output = tmp_path / "out"
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
            assert_refused(
                result, 2, f"error: {output}: it holds the runs of another config", words
            )
    assert tree(output) == before


def test_a_changed_table_is_another_config(tmp_path):
    path, output = tmp_path / "b.csv", tmp_path / "out"
    head = "alpha,beta,gamma,theta,phi,xi\n"
    path.write_text(head + "13.04,1.522,12.28,0.6429,0.036,-0.03\n")
    sets = (f"bodies={{source: table, path: {path}}}", "horizon={t: 5}")
    assert run("gh.yaml", output, *sets).exit_code == 0
    path.write_text(head + "13.04,1.522,12.28,0.65,0.036,-0.03\n")
    result = run("gh.yaml", output, *sets)
    assert result.exit_code == 2
    assert "the table of bodies has changed" in result.stderr


def test_runs_whose_manifest_is_lost_know_their_config(tmp_path):
    output = tmp_path / "out"
    sets = ("bodies.samples=4", "bodies.target.rel_tol=0.1")
    run("quickstart.yaml", output, *sets, "block_size=7")
    before = tree(output / "runs")
    for damage in (Path.unlink, lambda path: path.write_bytes(path.read_bytes()[:-40])):
        damage(output / "manifest.json")
        result = run("quickstart.yaml", output, *sets, "seed=1")
        assert_refused(result, 2, "it holds runs but no intact manifest.json")
        assert tree(output / "runs") == before
        result = run("quickstart.yaml", output, *sets)
        assert result.exit_code == 0
        assert "60 of them from before" in result.stderr
        assert tree(output / "runs") == before
        assert manifest(output)["config"]["block_size"] == 7
        assert manifest(output)["state"] == "complete"


def test_blocks_stay_as_the_directory_was_begun(tmp_path):
    output = tmp_path / "out"
    sets = ("bodies.samples=4", "bodies.target.rel_tol=0.1")
    run("quickstart.yaml", output, *sets, "block_size=7")
    before = tree(output / "runs")
    (output / "runs" / "block-000003.parquet").unlink()
    result = run("quickstart.yaml", output, *sets, "block_size=50")
    assert "was begun in blocks of 7 runs, and keeps that size" in result.stderr
    assert "53 of them from before" in result.stderr
    assert tree(output / "runs") == before


def test_name_output_thresholds_and_threads_may_differ(tmp_path):
    output = tmp_path / "out"
    sets = ("bodies.samples=15", "bodies.target={K_r: 0.01, rel_tol: 0.1}")
    run("quickstart.yaml", output, *sets)
    before = rows(output)
    changed = ("name=other", "output=elsewhere", "classify={sw_departure: 0.5, ss_growth: 1e-9}")
    result = run("quickstart.yaml", output, *sets, *changed, options=("--threads", 1))
    assert result.exit_code == 0
    assert "75 of them from before" in result.stderr
    after = rows(output)
    assert by_rule(after, 1e-9, 0.5).equals(after.type)
    assert not after.type.equals(before.type)
    pd.testing.assert_frame_equal(
        after.drop(columns="type"), before.drop(columns="type"), check_exact=True
    )
    thresholds = {"ss_growth": 1e-9, "sw_departure": 0.5}
    assert manifest(output)["config"]["classify"] == thresholds | {
        "early": False,
        "dead_energy": 0.01,
    }
    summary = pd.read_parquet(output / "summary.parquet")
    share = (after.type == "SW").groupby(after.case).mean()
    np.testing.assert_allclose(summary.fraction_SW, share)


def test_a_dry_run_writes_nothing(tmp_path):
    result = run("steady.yaml", tmp_path / "a" / "b", options=("--dry-run",))
    assert result.exit_code == 0
    words = {line[:12].strip(): line[12:] for line in result.stdout.splitlines()}
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
    types[frame.status != "ok"] = None
    return types.rename("type")


def test_types_follow_their_thresholds_and_come_back(mixed, tmp_path):
    output = shutil.copytree(mixed, tmp_path / "out")
    original, hash_ = tree(output), content_hash(output)
    before = rows(output)
    assert by_rule(before, 1e-3, 0.05).equals(before.type)
    seen = []
    for ss, sw in ((1e-3, 0.9), (1e3, 0.05), (1e-12, 1e-6), (0.05, 0.3)):
        result = invoke("classify", output, "--set", f"classify.ss_growth={ss}",
                        "--set", f"classify.sw_departure={sw}")  # fmt: skip
        assert result.exit_code == 0
        after = rows(output)
        assert by_rule(after, ss, sw).equals(after.type)
        pd.testing.assert_frame_equal(
            after.drop(columns="type"), before.drop(columns="type"), check_exact=True
        )
        summary = pd.read_parquet(output / "summary.parquet")
        for kind in ("R", "SS", "SW", "unclassified"):
            share = (after.type == kind).groupby(after.case).mean()
            np.testing.assert_allclose(summary[f"fraction_{kind}"], share)
        thresholds = {"ss_growth": ss, "sw_departure": sw}
        assert manifest(output)["config"]["classify"] == thresholds | {
            "early": False,
            "dead_energy": 0.01,
        }
        last = seen[-1] if seen else before.type
        changes = int((after.type != last).sum())
        assert f"{changes} runs have changed their type" in result.stderr
        seen.append(after.type)
        assert content_hash(output) != hash_
    result = invoke("classify", output, "--set", "classify={}")
    assert result.exit_code == 2
    result = invoke("classify", output, "--set", "classify.ss_growth=0.001",
                    "--set", "classify.sw_departure=0.05")  # fmt: skip
    assert result.exit_code == 0
    assert content_hash(output) == hash_
    assert tree(output / "runs") == tree(mixed / "runs")
    assert tree(output)["summary.parquet"] == original["summary.parquet"]
    assert manifest(output) == manifest(mixed)
    # Without a change nothing changes, and a run goes on as if nothing had been.
    assert "0 runs have changed" in invoke("classify", output).stderr
    assert run("quickstart.yaml", output, *MIXED, "block_size=50").exit_code == 0


def test_thresholds_of_classify_are_not_put_back_in_silence(tmp_path):
    output = tmp_path / "out"
    sets = ("model=gh", "bodies.samples=4", "bodies.target.rel_tol=0.1")
    run("quickstart.yaml", output, *sets)
    own = manifest(output)["config"]["classify"]
    assert "classified" not in manifest(output)
    again = invoke("classify", output)
    assert "`rattlesweep run` would put back" not in again.stderr
    result = invoke("classify", output, "--set", "classify.sw_departure=0.25")
    assert f"written: 1 blocks, summary.parquet and manifest.json in {output}" in result.stderr
    assert (
        "types by ss_growth 0.001, sw_departure 0.25, dead_energy 0.01; before by ss_growth"
        in result.stderr
    )
    assert "`rattlesweep run` would put back those of the config" in result.stderr
    said = manifest(output)
    assert said["config"]["classify"] == own | {"sw_departure": 0.25}
    thresholds = {key: value for key, value in own.items() if key != "early"}
    assert said["classified"]["config"] == thresholds
    assert said["classified"]["now"] == thresholds | {"sw_departure": 0.25}
    # Once more: the config's are those of the config, and not those of the time before.
    invoke("classify", output, "--set", "classify.sw_departure=0.5")
    assert manifest(output)["classified"]["config"] == thresholds
    result = run("quickstart.yaml", output, *sets)
    assert "had types by the thresholds of `rattlesweep classify`" in result.stderr
    assert "classify.sw_departure: 0.5 against 0.05" in result.stderr
    assert "classified" not in manifest(output)
    assert manifest(output)["config"]["classify"] == own
    # An edited config says so, too.
    result = run("quickstart.yaml", output, *sets, "classify.sw_departure=0.25")
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
        ("classify.early=true", "early: it decides when runs end, which takes their integration"),
        ("classify.early=1", "1 is given here; write true or false"),
        ("classify.ss_growth=big", '"big" (text) is given here; write a number'),
    ],
)
def test_classify_refuses_other_keys_and_values(text, words, mixed):
    before = tree(mixed)
    assert_refused(invoke("classify", mixed, "--set", text), 2, words)
    assert tree(mixed) == before


def test_classify_wants_a_whole_output_directory(mixed, tmp_path):
    result = invoke("classify", tmp_path)
    assert_refused(result, 2, "is not an output directory: it has no manifest.json")
    output = tmp_path / "out"
    run("gh.yaml", output)
    block = output / "runs" / "block-000000.parquet"
    block.write_bytes(block.read_bytes()[:-30])
    assert_refused(invoke("classify", output), 1, f"error: {block} is damaged")


# -- what is said, and where -------------------------------------------------------------------


def test_quiet_says_nothing_and_the_table_goes_to_standard_output(tmp_path):
    quiet = run("gh.yaml", tmp_path / "q", options=("-q",))
    assert (quiet.exit_code, quiet.stdout, quiet.stderr) == (0, "", "")
    loud = run("gh.yaml", tmp_path / "l")
    assert re.search(r"^ *1 +- +-0.1 +0.01 +1 +1.000", loud.stdout, re.MULTILINE)
    assert "112.09" in loud.stdout
    assert "809.86" in loud.stdout
    assert len(loud.stdout.splitlines()) == 3
    assert re.fullmatch(
        r"2 runs in \S+, 0 of them from before; .* runs a second\n"
        r"see them: rattlesweep plot \S+, rattlesweep report \S+\n",
        loud.stderr,
    )
    verbose = run("gh.yaml", tmp_path / "v", options=("-v",))
    assert verbose.stdout == loud.stdout
    assert re.search(r"^kernel .*[0-9.]+ s$", verbose.stderr, re.MULTILINE)


def test_without_a_terminal_there_is_at_most_one_line_a_minute(monkeypatch, capfd):
    clock = [0.0]
    monkeypatch.setattr(progress.time, "monotonic", lambda: clock[0])
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


def test_a_terminal_gets_a_bar_with_the_time_left(tmp_path):
    master, slave = pty.openpty()
    fcntl.ioctl(slave, termios.TIOCSWINSZ, struct.pack("HHHH", 25, 100, 0, 0))
    sets = ("bodies.samples=200", "bodies.target={K_r: 0.01, rel_tol: 0.1}")
    args = [part for text in sets for part in ("--set", text)]
    child = start("run", CONFIGS / "quickstart.yaml", "--output", tmp_path / "out", *args,
                  stderr=slave)  # fmt: skip
    os.close(slave)
    shown = b""
    while True:
        try:
            data = os.read(master, 4096)
        except OSError:  # how Linux says that the other end is closed
            break
        if not data:
            break
        shown += data
    os.close(master)
    table, _ = child.communicate(timeout=60)
    assert child.returncode == 0
    text = shown.decode()
    assert re.search(r"\d+%\|.*\| \d+/1000 runs, 0:0\d", text)
    assert "100%|" in text
    assert re.search(r"0:\d\d left", text)
    assert len(table.splitlines()) == 6
    assert "%" not in table


def test_a_reader_that_goes_away_is_no_crash(tmp_path):
    child = start("schema", stdout=subprocess.PIPE)
    assert child.stdout is not None
    child.stdout.close()
    assert child.stderr is not None
    with child.stderr:
        said = child.stderr.read()
    assert child.wait(30) in (0, 1)
    assert "Traceback" not in said


# -- interrupted -------------------------------------------------------------------------------

LONG = (
    "bodies.samples=1500",
    "bodies.target={K_r: [0.02, 0.1], rel_tol: 0.1}",
    "spin.n_i=[-0.3, -0.5]",
    "block_size=500",
)


@pytest.fixture(scope="module")
def long_hash(tmp_path_factory: pytest.TempPathFactory) -> str:
    output = tmp_path_factory.mktemp("long") / "out"
    assert run("quickstart.yaml", output, *LONG, options=("-q",)).exit_code == 0
    return content_hash(output)


def begin(output: Path, *sets: str) -> subprocess.Popen[str]:
    args = [part for text in (*LONG, *sets) for part in ("--set", text)]
    return start("run", CONFIGS / "quickstart.yaml", "--output", output, *args)


def test_a_stopped_run_goes_on_to_the_same_rows(long_hash, tmp_path):
    output = tmp_path / "out"
    resumed = 0
    for blocks in (1, 5):
        child = begin(output)
        wait_until(lambda n=blocks: len([*output.glob("runs/*.parquet")]) >= n, process=child)
        child.send_signal(signal.SIGINT)
        table, said = child.communicate(timeout=60)
        assert child.returncode == 130
        assert table == ""
        kept = [pq.ParquetFile(p).metadata.num_rows for p in output.glob("runs/*.parquet")]
        assert re.fullmatch(
            f"interrupted; {sum(kept):,} runs are kept, [0-9]+ in flight were lost, and the same "
            "command resumes from there\n",
            said,
        )
        assert [path.name for path in output.rglob(".*")] == [".locks"]
        # One block at most was under way.
        assert sum(rows < 500 for rows in kept) <= 1
        assert blocks <= len(kept) <= 12
        assert sum(kept) < 6000
        assert manifest(output)["state"] == "stopped"
        resumed = sum(kept)
    result = run("quickstart.yaml", output, *LONG)
    assert result.exit_code == 0
    assert f"{resumed} of them from before" in result.stderr
    assert manifest(output)["state"] == "complete"
    assert content_hash(output) == long_hash


def test_ctrl_c_is_heard_within_a_block_and_while_bodies_are_drawn(tmp_path):
    # One block of several seconds, then hours of drawing before anything is written.
    long_block = ("block_size=100000", "bodies.samples=6000")
    hard = ("bodies.target={K_r: 0.1, rel_tol: 1e-9, max_draws: 4000000000000}",)
    children = [begin(tmp_path / str(k), *sets) for k, sets in enumerate((long_block, hard))]
    wait_until((tmp_path / "0" / "manifest.json").exists, process=children[0])
    time.sleep(1.5)
    for child in children:
        child.send_signal(signal.SIGINT)
    for child in children:
        # The block, let alone the drawing, would take longer.
        _, said = child.communicate(timeout=20)
        assert child.returncode == 130
        assert said.startswith("interrupted;")
    assert not (tmp_path / "1").exists()


def test_bodies_can_be_drawn_while_a_kernel_runs():
    """Numba's workqueue aborts the process if two threads use it at once.

    It is the pool that Numba falls back to where there is neither OpenMP nor TBB.
    """
    code = f"""
import sys, threading, time, numpy as np
from rattlesweep.integrate.batch import Control
from rattlesweep.sweeps.blocks.block import finish_block, prepare_block
from rattlesweep.sweeps.config.load import load_config
from rattlesweep.sweeps.cases.plan import make_plan

config = load_config({str(CONFIGS / "quickstart.yaml")!r}, ["bodies.target.rel_tol=0.1"])
plan = make_plan(config)
control = Control()
block = prepare_block(plan, plan.block(0))
task = threading.Thread(
    target=lambda: finish_block(config, *block, control=control), daemon=True
)
task.start()
while not control.runs_done:
    time.sleep(0.001)
free = make_plan(load_config({str(CONFIGS / "quickstart.yaml")!r}, ["bodies.target="]))
for k in range(20):
    plan.source.bodies(1, np.arange(100) + 100 * (k % 4))
    free.source.bodies(0, np.arange(10_000))
assert task.is_alive()
sys.stdout.write("drawn")
sys.stdout.flush()
control.stop()
"""
    environment = {**os.environ, "NUMBA_THREADING_LAYER": "workqueue"}
    done = subprocess.run(
        [sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=False
    )
    assert (done.returncode, done.stdout) == (0, "drawn"), done.stderr


@pytest.mark.slow
@pytest.mark.parametrize("wait", [1.0, 2.5, 5.0])
def test_ctrl_c_is_heard_while_kernels_compile(wait, tmp_path):
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path / "cache")}
    args = ["run", CONFIGS / "quickstart.yaml", "--output", tmp_path / "out"]
    child = start(*args, "--set", "bodies.target=", env=environment)
    time.sleep(wait)
    child.send_signal(signal.SIGINT)
    _, said = child.communicate(timeout=10)
    assert child.returncode == 130
    assert said.splitlines()[-1].startswith("interrupted;")


# -- many --------------------------------------------------------------------------------------


@pytest.mark.slow
def test_ten_million_bodies_of_the_closed_form_in_bounded_memory(tmp_path, capsys):
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
    began = time.perf_counter()
    done = subprocess.run(
        [sys.executable, "-c", code, *command], capture_output=True, text=True, check=False
    )
    seconds = time.perf_counter() - began
    assert done.returncode == 0, done.stderr
    peak = int(done.stderr.split()[-1]) * (1 if sys.platform == "darwin" else 1024)
    with capsys.disabled():
        print(f"\n{count} bodies, model gh: {seconds:.1f} s, peak {peak / 1e9:.2f} GB")
    assert peak < 1.5e9
    summary = pd.read_parquet(tmp_path / "out" / "summary.parquet")
    assert summary.runs.tolist() == [count]
    assert summary.fraction_R.tolist() == [1.0]
    assert manifest(tmp_path / "out")["failed"] == {}
    shutil.rmtree(tmp_path / "out")  # over a gigabyte
