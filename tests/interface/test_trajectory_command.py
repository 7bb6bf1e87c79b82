"""The command `trajectory`: CSV, files, figures, and what it says of the run."""

import io
import json
import re
from typing import Any

import matplotlib as mpl
import numpy as np
import pandas as pd
import pyarrow.csv as pcsv
import pyarrow.parquet as pq
import pytest
from refusal import assert_refused
from sweeping import invoke

import rattlesweep as rs

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
    run = rs.trajectory(GH, n_i=0.1, omega_xy0=0.01, t_end=130, points=14,
                        channels=["t", "n", "C_I", "u_x"])  # fmt: skip
    pd.testing.assert_frame_equal(
        read_csv(result.stdout), run.table, check_exact=True, check_dtype=False
    )
    assert "1 reversal at 112.09387" in result.stderr
    assert command("--points", 14, "-q").stderr == ""


@pytest.mark.parametrize(
    ("options", "wanted"),
    [
        (["--dt", 10], {"dt": 10.0}),
        (["--steps"], {"steps": True}),
        (["--psi", "30", "--points", 5], {"psi": 30.0, "points": 5}),
        (["--accuracy", "draft"], {"tol": 1e-6}),
        (["--omega", "0.02,0,-0.3"], {"omega": (0.02, 0, -0.3), "n_i": None, "omega_xy0": None}),
        (["--model", "gh"], {"model": "gh"}),
        pytest.param(["--method", "rk4", "--dt-step", 0.05], {"method": "rk4", "dt_step": 0.05},
                     marks=pytest.mark.slow),
    ],
    ids=str,
)  # fmt: skip
def test_options_mean_what_they_say(options, wanted):
    printed = read_csv(command(*options).stdout)
    run = rs.trajectory(GH, **({"n_i": 0.1, "omega_xy0": 0.01, "t_end": 130} | wanted))
    assert np.array_equal(printed.to_numpy(), run.table.to_numpy())


def test_files_hold_the_table_and_say_which_run_it_is(tmp_path):
    target = tmp_path / "new" / "run.parquet"
    names = "t,n,energy_drift,E_r,C_I"
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


WRONG = """
--channels t,omga_x: did you mean "omega_x"?
--points 5 --steps: points and steps are both given
--output run.xlsx: the name must end in .parquet or .csv
--figure run.jpg: the name must end in .svg or .png or .pdf
--output /proc/nowhere/run.csv: cannot write in /proc/nowhere
--accuracy draft --tol 1e-7: integrator.accuracy
--omega 1,2: --omega 1,2: give numbers from
--omega 0,0,1 --n-i 0.1: n_i given with a full state
"""


@pytest.mark.parametrize("line", WRONG.strip().splitlines())
def test_wrong_commands_say_so_in_one_line(tmp_path, monkeypatch, line):
    monkeypatch.chdir(tmp_path)
    args, words = line.split(": ", 1)
    assert_refused(command(*args.split()), 1 if "cannot" in words else 2, words)
    assert not list(tmp_path.iterdir())


def test_zeros_of_one_swing_are_one_reversal():
    """The spin crosses zero three times about 812 on its way from -0.1 to 0.1."""
    launch = ("--preset", "GH", "--n-i", -0.1, "--t-end", 1500, "--points", 2)
    words = r"1 reversal at 809\.8574\d+ \(3 zero crossings at 809\.8574\d+, 812\.147\d+, 814\.036"
    assert re.search(words, invoke("trajectory", *launch).stderr)
    # Later ones depend on the last bits, and so on the processor.
    run = rs.trajectory(GH, n_i=-0.1, omega_xy0=0.01, t_end=6000)
    assert run.zeros[:3].tolist() == pytest.approx([809.857418, 812.147438, 814.036451], abs=1e-5)
    assert len(run.zeros) > len(run.reversals) >= 4
    # No reversal yet where the run ends on the way.
    short = rs.trajectory(GH, n_i=-0.1, omega_xy0=0.01, t_end=813)
    assert (len(short.reversals), len(short.zeros)) == (0, 2)


def test_contact_that_no_real_body_keeps_is_said():
    lost = invoke("trajectory", "--preset", "GH", "--n-i", 1, "--omega-xy0", 3, "--t-end", 50,
                  "--steps", "--channels", "t,F_normal")  # fmt: skip
    assert lost.exit_code == 0
    table = read_csv(lost.stdout)
    first = table["t"][np.argmax(table["F_normal"] < 0)]
    assert f"warning: contact would be lost at t = {first:.4g}, where the normal" in lost.stderr
    slips = rs.trajectory(GH, n_i=0.5, omega_xy0=1, t_end=100, steps=True,
                          channels=["t", "F_normal", "F_tangential"])  # fmt: skip
    ratio = slips.table["F_tangential"] / slips.table["F_normal"]
    assert f"from t = {slips.table['t'][np.argmax(ratio > 1)]:.4g} " in slips.warning


def test_figures_are_files_and_do_not_obey_the_users_matplotlibrc(tmp_path):
    arguments = ("--channels", "t,F_normal", "--figure")
    assert command(*arguments, tmp_path / "run.pdf").exit_code == 0
    assert (tmp_path / "run.pdf").read_bytes().startswith(b"%PDF")
    command(*arguments, tmp_path / "plain.svg")
    with mpl.rc_context({"font.size": 20, "axes.facecolor": "red", "svg.fonttype": "none"}):
        command(*arguments, tmp_path / "loud.svg")
    assert (tmp_path / "plain.svg").read_text() == (tmp_path / "loud.svg").read_text()
