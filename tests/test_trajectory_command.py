"""The command `trajectory`: CSV, files, figures, and what it says when something is wrong."""

from __future__ import annotations

import errno
import io
import json
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow.csv as pcsv
import pyarrow.parquet as pq
import pytest
from test_run import handlers, invoke

import rattlesweep as rs
from rattlesweep.study import trajectory_figure, trajectory_file
from rattlesweep.study.channels import CHANNELS
from rattlesweep.study.trajectory import Course
from rattlesweep.sweep.errors import OutputError
from rattlesweep.sweep.files import streamed_file

__all__ = ["handlers"]
GH = rs.Rattleback.gh()


def read_csv(text: str) -> pd.DataFrame:
    """Every digit of it."""
    table: pd.DataFrame = pcsv.read_csv(io.BytesIO(text.encode())).to_pandas()
    return table


def command(*args: Any) -> Any:
    return invoke("trajectory", "--preset", "GH", "--t-end", 130, *args)


def test_prints_csv_that_gives_the_same_numbers_back():
    result = command("--points", 14, "--channels", "t,n,C_I,u_x")
    assert result.exit_code == 0
    table = read_csv(result.stdout)
    run = rs.trajectory(GH, n_i=0.1, omega_xy0=0.01, t_end=130, points=14,
                        channels=["t", "n", "C_I", "u_x"])  # fmt: skip
    pd.testing.assert_frame_equal(table, run.table, check_exact=True, check_dtype=False)
    assert "1 reversal at 112.09387" in result.stderr
    assert command("--points", 14, "-q").stderr == ""


@pytest.mark.parametrize(
    ("options", "wanted"),
    [
        (["--dt", 10], {"dt": 10.0}),
        (["--steps"], {"steps": True}),
        (["--psi", "30", "--points", 5], {"psi": 30.0, "points": 5}),
        (["--accuracy", "draft"], {"tol": 1e-6}),
        (["--method", "rk4", "--dt-step", 0.05], {"method": "rk4", "dt_step": 0.05}),
        (["--model", "reduced", "--e-r0", 1e-4], {"model": "reduced", "e_r0": 1e-4}),
        (["--model", "gh"], {"model": "gh"}),
    ],
    ids=str,
)
def test_options_mean_what_they_say(options, wanted):
    printed = read_csv(command(*options).stdout)
    run = rs.trajectory(GH, **({"n_i": 0.1, "omega_xy0": 0.01, "t_end": 130} | wanted))
    assert np.array_equal(printed.to_numpy(), run.table.to_numpy())


def test_files_hold_the_table_and_say_which_run_it_is(tmp_path: Path):
    target = tmp_path / "new" / "run.parquet"
    names = "t,n,energy_drift,E_r,C_I,n_reduced"
    result = command("--output", target, "--channels", names)
    assert (result.exit_code, result.stdout) == (0, "")
    table = pq.read_table(target)
    run = rs.trajectory(GH, n_i=0.1, omega_xy0=0.01, t_end=130, channels=names.split(","))
    assert np.array_equal(table.to_pandas().to_numpy(), run.table.to_numpy(), equal_nan=True)
    about = json.loads(table.schema.metadata[b"rattlesweep.run"])
    assert (about["theta"], about["t_end"], about["integrator"]["tol"]) == (0.6429, 130.0, 1e-9)
    assert table.schema.field("C_I").metadata[b"unit"] == b"1"
    footer = pq.read_metadata(target).metadata
    assert json.loads(footer[b"rattlesweep.reversals"]) == run.reversals.tolist()
    command("--output", tmp_path / "run.csv", "--channels", names)
    again = read_csv((tmp_path / "run.csv").read_text())
    assert np.array_equal(again.to_numpy(), run.table.to_numpy(), equal_nan=True)
    assert sorted(p.name for p in tmp_path.rglob("*")) == ["new", "run.csv", "run.parquet"]


def test_infinity_and_nan_become_null(tmp_path: Path):
    result = command("--model", "reduced", "--points", 2, "--channels", "C_I")
    assert result.stdout == "C_I\n\n\n"
    command(
        "--model", "reduced", "--points", 2, "--channels", "C_I", "--output", tmp_path / "c.parquet"
    )
    assert pq.read_table(tmp_path / "c.parquet")["C_I"].null_count == 2


def test_list_of_channels():
    printed = command("--channels", "list").stdout
    assert [line.split()[0] for line in printed.splitlines()] == list(CHANNELS)


@pytest.mark.parametrize("kind", ["svg", "png", "pdf"])
def test_figures(tmp_path: Path, kind: str):
    for name in ("one", "two"):
        assert command("--figure", tmp_path / f"{name}.{kind}").exit_code == 0
    data = (tmp_path / f"one.{kind}").read_bytes()
    assert data.startswith({"svg": b"<?xml", "png": b"\x89PNG", "pdf": b"%PDF"}[kind])
    assert data == (tmp_path / f"two.{kind}").read_bytes()


@pytest.mark.parametrize("model", ["full", "reduced", "gh"])
def test_what_a_figure_shows(model: str):
    launch = {"n_i": -0.1, "omega_xy0": 0.01, "t_end": 2000.0, "model": model}
    if model != "gh":
        launch["e_r0"] = 1e-4
    course = trajectory_figure.course_for(GH, launch)
    chunks = list(course)
    columns = {k: np.concatenate([c[k] for c in chunks]) for k in chunks[0]}
    axes = trajectory_figure.draw(columns, course, "a caption").axes
    labels = [text.get_text() for text in axes[0].get_legend().get_texts()]
    assert len(axes) == {"full": 3, "reduced": 2, "gh": 1}[model]
    assert ("reduced model" in labels) == (model != "gh")
    assert any("reversal" in label for label in labels)
    assert axes[-1].get_xlim() == (0, 2000)
    if model == "full":
        height = trajectory_figure.envelope(columns["omega_y"], 300)
        assert np.all(height >= np.abs(columns["omega_y"]) * (1 - 1e-12))
        # Fig. 4: where the spin reverses omega_y is largest, omega_x has a local minimum.
        assert abs(columns["t"][np.argmax(height)] - course.reversals[0]) < 20
        other = trajectory_figure.envelope(columns["omega_x"], 300)
        t = columns["t"]
        middle = other[np.searchsorted(t, course.reversals[0])]
        assert middle < 0.7 * other[t < 800].max()
        assert middle < 0.7 * other[t > 820].max()


@pytest.mark.parametrize(
    ("args", "words", "code"),
    [
        (["--channels", "t,omga_x"], "'omga_x' is not one; omega_x is the nearest", 2),
        (["--channels", ""], "none is named", 2),
        (["--points", 5, "--steps"], "points and steps are both given", 2),
        (["--output", "run.xlsx"], ".parquet or .csv is needed", 2),
        (["--figure", "run.jpg"], ".svg, .png or .pdf is needed", 2),
        (["--output", "/proc/nowhere/run.csv"], "cannot write in /proc/nowhere", 1),
        (["--accuracy", "draft", "--tol", 1e-7], "integrator.accuracy", 2),
        (["--method", "rk4", "--tol", 1e-7], "tol", 2),
        (["--theta", 1.5], "theta", 2),
        (["--n-i", 0], "the spin 0 has no direction", 2),
        (["--e-r0", "nan", "--model", "reduced"], "must be finite", 2),
    ],
    ids=str,
)
def test_wrong_commands_say_so_in_one_line(tmp_path: Path, monkeypatch, args, words, code):
    monkeypatch.chdir(tmp_path)
    result = command(*args)
    assert result.exit_code == code
    assert result.stdout == ""
    assert words in result.stderr
    assert result.stderr.startswith("error: ")
    assert result.stderr.count("\n") == 1
    assert not list(tmp_path.iterdir())


def test_a_run_that_fails_keeps_its_rows_and_says_so(tmp_path: Path):
    target = tmp_path / "run.csv"
    result = command("--method", "rk4", "--dt-step", 1.0, "--n-i", -0.1, "--t-end", 600,
                     "--output", target)  # fmt: skip
    assert result.exit_code == 3
    assert "the run is not ok: energy, " in result.stderr
    assert len(target.read_text().splitlines()) == 2002


def test_a_file_that_breaks_off_leaves_the_old_one(tmp_path: Path):
    target = tmp_path / "run.parquet"
    target.write_bytes(b"old")

    def stop(share: float) -> None:
        if share > 0.1:
            raise KeyboardInterrupt

    course = Course(GH, n_i=0.1, omega_xy0=0.01, t_end=1e5, points=100_000, watch=stop)
    with pytest.raises(KeyboardInterrupt):
        trajectory_file.save(course, target)
    assert [p.name for p in tmp_path.iterdir()] == ["run.parquet"]
    assert target.read_bytes() == b"old"


def test_a_disk_that_is_full_is_said_in_one_sentence(tmp_path: Path):
    def fill() -> None:
        with streamed_file(tmp_path / "run.csv") as file:
            file.write(b"half")
            raise OSError(errno.ENOSPC, "No space left on device")

    with pytest.raises(OutputError, match=r"cannot write .*run\.csv: No space left"):
        fill()
    assert not list(tmp_path.iterdir())
