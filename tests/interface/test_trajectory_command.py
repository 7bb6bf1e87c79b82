"""The command `trajectory`: CSV, files, figures, and what it says when something is wrong."""

import io
import json
import re
import sys
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
from rattlesweep import cli
from rattlesweep.analysis.onerun import figure as trajectory_figure
from rattlesweep.analysis.onerun import files as trajectory_file
from rattlesweep.analysis.onerun.course import Course
from rattlesweep.analysis.onerun.course import Observer
from rattlesweep.analysis.onerun.rows import Rows
from rattlesweep.sweeps.single import Launch

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
        (["--model", "reduced", "--e-r0", 1e-4], {"model": "reduced", "e_r0": 1e-4}),
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


def test_infinity_and_nan_become_null(tmp_path):
    arguments = ("--model", "reduced", "--points", 2, "--channels", "C_I")
    assert command(*arguments).stdout == "C_I\n\n\n"
    command(*arguments, "--output", tmp_path / "c.parquet")
    assert pq.read_table(tmp_path / "c.parquet")["C_I"].null_count == 2


@pytest.mark.parametrize("model", ["full", "reduced", "gh"])
def test_what_a_figure_shows(model: str):
    e_r0 = None if model == "gh" else 1e-4
    course = trajectory_figure.course_of(Launch(GH, -0.1, 0.01, 2000.0, model=model, e_r0=e_r0))
    columns = course.columns()
    axes = trajectory_figure.draw(columns, course, "a caption").axes
    labels = [text.get_text() for text in axes[0].get_legend().get_texts()]
    assert len(axes) == {"full": 3, "reduced": 2, "gh": 1}[model]
    assert ("reduced model" in labels) == (model != "gh")
    assert any("turn" in label for label in labels)
    assert axes[-1].get_xlim() == (0, 2000)
    if model == "full":
        height = trajectory_figure.envelope(columns["omega_y"], 300)
        assert np.all(height >= np.abs(columns["omega_y"]) * (1 - 1e-12))
        # Fig. 5: where the spin reverses omega_y is largest, omega_x has a local minimum.
        assert abs(columns["t"][np.argmax(height)] - course.reversals[0]) < 20
        other = trajectory_figure.envelope(columns["omega_x"], 300)
        t = columns["t"]
        middle = other[np.searchsorted(t, course.reversals[0])]
        assert middle < 0.7 * other[t < 800].max()
        assert middle < 0.7 * other[t > 820].max()


WRONG = """
--channels t,omga_x: did you mean "omega_x"?
--points 5 --steps: points and steps are both given
--output run.xlsx: the name must end in .parquet or .csv
--figure run.jpg: the name must end in .svg, .png or .pdf
--output /proc/nowhere/run.csv: cannot write in /proc/nowhere
--accuracy draft --tol 1e-7: integrator.accuracy
--method rk4 --tol 1e-7: tol
"""


@pytest.mark.parametrize("line", WRONG.strip().splitlines())
def test_wrong_commands_say_so_in_one_line(tmp_path, monkeypatch, line):
    monkeypatch.chdir(tmp_path)
    args, words = line.split(": ")
    assert_refused(command(*args.split()), 1 if "cannot" in words else 2, words)
    assert not list(tmp_path.iterdir())


@pytest.mark.slow  # compiles rk4
def test_a_run_that_fails_keeps_its_rows_and_says_so(tmp_path):
    target = tmp_path / "run.csv"
    result = command("--method", "rk4", "--dt-step", 1.0, "--n-i", -0.1, "--t-end", 600,
                     "--points", 2001, "--output", target)  # fmt: skip
    assert result.exit_code == 3
    assert "the run is not ok: energy, " in result.stderr
    assert len(target.read_text().splitlines()) == 2002


def test_a_file_that_breaks_off_leaves_the_old_one(tmp_path):
    target = tmp_path / "run.parquet"
    target.write_bytes(b"old")

    def stop(share: float) -> None:
        if share > 0.1:
            raise KeyboardInterrupt

    course = Course(Launch(GH, 0.1, 0.01, 1e5), rows=Rows(100_000), watch=stop)
    with pytest.raises(KeyboardInterrupt):
        trajectory_file.save(course, target)
    assert [p.name for p in tmp_path.iterdir()] == ["run.parquet"]
    assert target.read_bytes() == b"old"


def test_zeros_of_one_swing_are_one_reversal():
    """The spin crosses zero three times about 812 on its way from -0.1 to 0.1."""
    launch = ("--preset", "GH", "--n-i", -0.1, "--t-end", 1500, "--points", 2)
    words = r"1 reversal at 809\.8574\d+ \(3 zero crossings at 809\.8574\d+, 812\.147\d+, 814\.036"
    assert re.search(words, invoke("trajectory", *launch).stderr)
    run = rs.trajectory(GH, n_i=-0.1, omega_xy0=0.01, t_end=6000, channels=["t", "n"])
    # Later ones depend on the last bits, and so on the processor.
    assert run.zeros[:3].tolist() == pytest.approx([809.857418, 812.147438, 814.036451], abs=1e-5)
    assert len(run.zeros) > len(run.reversals) >= 4
    assert run.reversals[0] == run.zeros[0]
    # Between its reversals the spin rests on one side.
    t, n = run.table["t"].to_numpy(), run.table["n"].to_numpy()
    middles = (run.reversals[1:] + run.reversals[:-1]) / 2
    sides = np.sign(np.interp(np.array([0, *middles]), t, n))
    assert sides.tolist() == [(-1) ** (k + 1) for k in range(len(sides))]
    # No reversal yet where the run ends on the way.
    short = rs.trajectory(GH, n_i=-0.1, omega_xy0=0.01, t_end=813)
    assert (len(short.reversals), len(short.zeros)) == (0, 2)


def test_reversals_are_counted_by_the_quarter():
    seen = Observer(plateau=1.0, zeros=[1.4, 2.5, 3.4, 6.5, 7.1])
    t = np.arange(9.0)
    spins = np.array([1, 0.3, -0.2, 0.2, -0.3, -1, -0.2, 0.2, -1])
    for part in (slice(0, 3), slice(3, 4), slice(4, 9)):
        seen.spin(t[part], spins[part])
    assert seen.reversals == [1.4]


def test_contact_that_no_real_body_keeps_is_said():
    lost = invoke("trajectory", "--preset", "GH", "--n-i", 1, "--omega-xy0", 3, "--t-end", 50,
                  "--steps", "--channels", "t,F_normal")  # fmt: skip
    assert lost.exit_code == 0
    table = read_csv(lost.stdout)
    first = table["t"][np.argmax(table["F_normal"] < 0)]
    words = f"warning: contact would be lost at t = {first:.4g}, where the normal force becomes "
    assert words + f"negative (least: {table['F_normal'].min():.2g} M g)" in lost.stderr
    assert len(lost.stderr.splitlines()) == 2
    slips = rs.trajectory(GH, n_i=0.5, omega_xy0=1, t_end=100, steps=True,
                          channels=["t", "F_normal", "F_tangential"])  # fmt: skip
    ratio = slips.table["F_tangential"] / slips.table["F_normal"]
    assert f"from t = {slips.table['t'][np.argmax(ratio > 1)]:.4g} " in slips.warning
    assert f"(largest: {ratio.max():.3g})" in slips.warning


def test_the_look_at_the_contact_is_that_of_a_sweep(tmp_path):
    sweep = rs.sweep(
        {"bodies": {"source": "preset", "name": "GH"}, "record": ["contact"],
         "spin": {"n_i": -0.9, "omega_xy0": 0.05}, "horizon": {"t": 100}},
        output=tmp_path / "sweep", threads=1,
    ).runs.iloc[0]  # fmt: skip
    assert sweep["t_end"] == 100
    course = Course(Launch(GH, -0.9, 0.05, 100))
    list(course)
    seen = course.observer
    assert seen.normal_min == pytest.approx(sweep["contact_normal_min"], rel=1e-12)
    assert seen.friction_max == pytest.approx(sweep["contact_ratio_max"], rel=1e-12)


def test_a_long_table_is_printed_by_its_ends(tmp_path, monkeypatch):
    result = command("--points", 20_000_000_000)
    assert result.exit_code == 0
    lines = result.stdout.splitlines()
    assert len(lines) == 42
    assert lines[21] == "..."
    run = rs.trajectory(GH, n_i=0.1, omega_xy0=0.01, t_end=130, points=2)
    assert lines[-1].split(",")[0] == "130"
    assert float(lines[-1].split(",")[1]) == run.table["n"].to_numpy()[-1]
    assert "only the first and the last 20 rows are printed; for all of them give --output" in (
        result.stderr
    )
    # A file that takes standard output has them all.
    with (tmp_path / "run.csv").open("w") as file:
        monkeypatch.setattr(sys, "stdout", file)
        arguments = ["trajectory", "--preset", "GH", "--t-end", "130", "--points", "10001"]
        cli.main.main(arguments, standalone_mode=False)
    assert len((tmp_path / "run.csv").read_text().splitlines()) == 10_002
    # Accepted steps are not known before they are taken.
    steps = command("--tol", 1e-13, "--t-end", 3000, "--steps")
    whole = rs.trajectory(GH, n_i=0.1, omega_xy0=0.01, t_end=3000, steps=True, tol=1e-13).table
    assert len(whole) > 10_000
    first, last = steps.stdout.split("...\n")
    table = read_csv(first + last)
    ends = pd.concat([whole[:20], whole[-20:]])
    assert np.array_equal(table.to_numpy(), ends.to_numpy())


def test_a_figure_shows_the_channels_that_are_asked_for(tmp_path):
    def labels(*names: str) -> list[str]:
        course = trajectory_figure.course_of(Launch(GH, 0.1, 0.01, 130.0), names or None)
        return [a.get_ylabel() for a in trajectory_figure.draw(course.columns(), course).axes]

    assert len(labels()) == 3
    assert [text.split()[0] for text in labels("t", "F_normal", "E_p", "E_r")] == [
        "F_normal", "energy",
    ]  # fmt: skip


def test_figures_are_files_and_do_not_obey_the_users_matplotlibrc(tmp_path):
    loud = {"font.size": 20, "savefig.facecolor": "yellow", "savefig.bbox": "tight",
            "axes.facecolor": "red", "lines.linewidth": 9, "svg.fonttype": "none"}  # fmt: skip
    arguments = ("--channels", "t,F_normal", "--figure")
    assert command(*arguments, tmp_path / "run.pdf").exit_code == 0
    assert (tmp_path / "run.pdf").read_bytes().startswith(b"%PDF")
    command(*arguments, tmp_path / "plain.svg")
    with mpl.rc_context(loud):
        command(*arguments, tmp_path / "loud.svg")
    plain = (tmp_path / "plain.svg").read_text()
    assert plain == (tmp_path / "loud.svg").read_text()
    assert "F_normal" in plain
