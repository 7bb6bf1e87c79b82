"""Sections of a run: every crossing, none twice, each as accurate as the method."""

import io
import json

import matplotlib as mpl
import numpy as np
import oracle
import pandas as pd
import pyarrow.csv as pcsv
import pyarrow.parquet as pq
import pytest
from refusal import assert_refused
from scipy.integrate import solve_ivp
from sweeping import invoke, run

import rattlesweep as rs

GH = rs.Rattleback.gh()
SMALL = {"n_i": 0.1, "omega_xy0": 0.01, "t_end": 60.0}
WILD = {"n_i": -0.3, "omega_xy0": 0.1, "t_end": 700.0}
STATE = ["u_x", "u_y", "u_z", "omega_x", "omega_y", "omega_z"]
POINTS = 200_001


def crossings(section, channels=("n",), body=GH, **launch):
    """Return the table of a section."""
    return rs.trajectory(body, section=section, channels=channels, **launch).section


def between_rows(table, name, value):
    """Return the last row before each crossing of a finely sampled run, and its
    direction.
    """
    height = table[name].to_numpy() - value
    rows = np.flatnonzero(height[:-1] * height[1:] < 0)
    return table["t"].to_numpy()[rows], height[rows + 1] > 0


def assert_found(section, table, name, value):
    """Check that crossings are those of a finely sampled run."""
    begin, rising = between_rows(table, name, value)
    spacing = table["t"][1]
    assert len(section) == len(begin)
    assert (section["rising"] == rising).all()
    assert np.abs(section["t"] - begin - spacing / 2).max() <= 0.51 * spacing


def test_scipy_with_another_program_finds_the_same_crossings():
    value = 0.004

    def height(t, y):
        return y[4] - value

    start = oracle.launch(oracle.GH, 0.1, 0.01, oracle.relevant_psi(oracle.GH, 0.1))
    reference = solve_ivp(
        lambda t, y: oracle.rhs(t, y, oracle.GH),
        (0, SMALL["t_end"]),
        start,
        method="DOP853",
        rtol=1e-12,
        atol=1e-14,
        events=height,
        dense_output=True,
    )
    found = crossings(f"omega_y={value}", STATE, tol=1e-12, **SMALL)
    times = reference.t_events[0]
    assert len(found) == len(times) > 20
    assert found["t"].to_numpy() == pytest.approx(times, abs=1e-8)
    assert found[STATE].to_numpy() == pytest.approx(reference.y_events[0], abs=1e-8)
    rates = [
        oracle.rhs(t, y, oracle.GH)[4]
        for t, y in zip(times, found[STATE].to_numpy(), strict=True)
    ]
    assert found["rising"].tolist() == (np.array(rates) > 0).tolist()


@pytest.mark.parametrize(
    ("launch", "names"),
    [
        (WILD, ["n", "omega_y", "u_x", "F_normal", "E_p", "q0"]),
        (SMALL | {"method": "rk4"}, ["omega_x", "n"]),
        pytest.param(
            WILD | {"model": "reduced", "t_end": 3000.0},
            ["n", "E_r"],
            marks=pytest.mark.slow,
        ),
        pytest.param(
            {"n_i": 0.3, "omega_xy0": 0.1, "t_end": 60.0, "mu": 0.1},
            ["omega_y", "v_slip"],
            marks=pytest.mark.slow,
        ),
        pytest.param(
            SMALL | {"rolling": 1e-3}, ["omega_y", "energy"], marks=pytest.mark.slow
        ),
    ],
    ids=["full", "rk4", "reduced", "sliding", "rolling"],
)
def test_crossings_are_those_of_a_fine_sample(launch, names):
    table = rs.trajectory(GH, channels=["t", *names], points=POINTS, **launch).table
    for name in names:
        low = table[name].min()
        for share in (0.1, 0.5, 0.8):
            value = low + share * (table[name].max() - low)
            section = crossings(f"{name}={value}", [name], **launch)
            assert np.abs(section[name] - value).max() < 1e-14
            assert_found(section, table, name, value)


@pytest.mark.parametrize("name", ["omega_x", "omega_y", "n", "F_normal"])
def test_both_crossings_within_one_step_are_found(name):
    """The value lies just below a maximum, and then just above it."""
    table = rs.trajectory(GH, channels=["t", name], points=POINTS, **SMALL).table
    steps = rs.trajectory(GH, steps=True, **SMALL)["t"].to_numpy()
    values = table[name].to_numpy()
    peaks = 1 + np.flatnonzero(
        (values[1:-1] > values[:-2]) & (values[1:-1] > values[2:])
    )
    for row in peaks[[1, len(peaks) // 2, -1]]:
        top = values[row]
        # A parabola through the highest rows is right to 1e-15 there.
        rise, fall = np.diff(values[row - 1 : row + 2])
        top += (rise + fall) ** 2 / (8 * (rise - fall))
        bend = (rise - fall) / table["t"][1] ** 2
        for depth, count in ((1e-8, 2), (1e-11, 2), (-1e-11, 0)):
            apart = np.sqrt(2 * abs(depth) / bend)
            near = table["t"][row] + (2 * apart + table["t"][1]) * np.array([-1, 1])
            section = crossings(f"{name}={top - depth}", [name], **SMALL)
            pair = section[section["t"].between(*near)]
            assert pair["rising"].tolist() == [True, False][:count]
            assert np.diff(pair["t"]) == pytest.approx(2 * apart, rel=0.01)
            assert np.unique(np.searchsorted(steps, pair["t"])).size <= 1


def test_directions_and_times():
    both = crossings("omega_y=0.01", **WILD)
    rising = crossings("omega_y=0.01+", **WILD)
    falling = crossings("omega_y = 1e-2 -", **WILD)
    joined = pd.concat([rising, falling]).sort_values("t", ignore_index=True)
    pd.testing.assert_frame_equal(both, joined)
    assert rising["rising"].all()
    assert both["rising"].dtype == bool
    assert not falling["rising"].any()
    # The heading is integrated for its section, though it is no column.
    turned = rs.trajectory(GH, channels=["t", "yaw"], times=[*both["t"]], **WILD)["yaw"]
    yaw = (turned.iloc[1] + turned.iloc[2]) / 2
    first = crossings(f"yaw={yaw}", **WILD)["t"][0]
    assert both["t"][1] < first < both["t"][2]
    late = crossings("omega_y=0.01", from_time=350, **WILD)
    assert late["t"].tolist() == both["t"][both["t"] >= 350].tolist()


def test_zeros_of_the_spin_are_a_section():
    run = rs.trajectory(GH, section="n", **WILD)
    assert len(run.zeros) > 10
    assert run.section["t"].to_numpy() == pytest.approx(run.zeros, rel=1e-15, abs=1e-12)
    assert np.abs(run.section["n"]).max() < 1e-16


def test_energy_at_the_crossings_is_that_of_the_launch():
    section = crossings("omega_y", ["energy", "energy_drift", "omega_y"], **WILD)
    assert np.abs(section["energy_drift"]).max() < 1e-7
    assert section["energy"].to_numpy() == pytest.approx(section["energy"][0], rel=1e-7)


def test_a_value_that_is_met_at_an_accepted_step_is_crossed_once():
    """The last of these steps ends a piece of the table of 2048 steps."""
    steps = rs.trajectory(GH, channels=["t", "omega_y"], steps=True, **WILD).table
    for row in (1, 1000, 2047, 2048, 2049):
        value = steps["omega_y"][row]
        section = crossings(f"omega_y={value}", ["omega_y"], **WILD)
        nearest = np.abs(section["t"] - steps["t"][row])
        assert (nearest < 1e-9).sum() == 1
        # A little above there are as many, but where the motion turns.
        beside = crossings(f"omega_y={value + 1e-9}", ["omega_y"], **WILD)
        assert len(beside) == len(section)


@pytest.mark.parametrize("psi", ["pitch", 90.0, 0.0])
def test_the_launch_is_no_crossing(psi):
    launch = WILD | {"psi": psi}
    start = rs.trajectory(GH, channels=STATE, points=2, **launch).table.loc[0]
    for name in STATE:
        section = crossings(f"{name}={start[name]}", **launch)
        assert (section["t"] > 1e-3).all()


@pytest.mark.slow
def test_a_jump_over_the_value_is_no_crossing():
    """Where a slide ends, the force in the plane falls from mu times the normal one."""
    launch = WILD | {"mu": 0.3, "t_end": 200.0}
    channels = ["t", "friction_ratio"]
    run = rs.trajectory(GH, section="friction_ratio=0.299", channels=channels, **launch)
    ends = run.slides[:, 1]
    rising = run.section[run.section["rising"]]
    assert len(ends) > 3
    assert len(rising) >= len(ends)
    assert np.abs(run.section["friction_ratio"] - 0.299).max() < 1e-12
    apart = np.abs(run.section["t"].to_numpy()[:, None] - ends)
    assert apart.min() > 1e-6


def test_a_body_that_rolls_over_and_one_in_si_units():
    kl = rs.Rattleback.kl()
    launch = {"n_i": "60 rpm", "omega_xy0": "60 rpm", "t_end": "10 s"}
    section = crossings("omega_x=5 rpm+", ["omega_x"], kl, **launch)
    names = ["t", "omega_x", "t_s", "omega_x_rad_s", "rising"]
    assert list(section) == names
    assert section["omega_x_rad_s"].to_numpy() == pytest.approx(5 * np.pi / 30)
    natural = 5 * np.pi / 30 * kl.units.time
    same = crossings(f"omega_x={natural} sqrt(g/a)+", ["omega_x"], kl, **launch)
    assert same["t"].to_numpy() == pytest.approx(section["t"].to_numpy(), abs=1e-11)


def test_the_table_is_there_beside_the_section():
    run = rs.trajectory(GH, section="omega_y=0", points=7, **SMALL)
    assert run.table["t"].tolist() == np.linspace(0, 60, 7).tolist()
    assert list(run.table) == ["t", "n"]
    assert list(run.section) == ["t", "n", *STATE[3:], *STATE[:3], "rising"]
    assert "crossings" in repr(run)
    plain = rs.trajectory(GH, points=7, **SMALL)
    assert plain.section is None
    pd.testing.assert_frame_equal(plain.table, run.table)
    with pytest.raises(rs.ConfigError, match="none is asked for"):
        plain.plot_section()


def test_a_picture_has_the_size_of_the_settings_or_axes_of_the_caller(tmp_path):
    run = rs.trajectory(GH, section="omega_y", **SMALL)
    with mpl.rc_context({"figure.figsize": (3.4, 3.0)}):
        figure = run.plot_section(path=tmp_path / "section.pdf")
    assert figure.get_size_inches().tolist() == [3.4, 3.0]
    axes = figure.axes[0]
    assert axes.get_xlabel().startswith("spin $n$")
    points = sorted(len(line.get_xdata()) for line in axes.lines)
    assert sum(points) == len(run.section)
    assert (tmp_path / "section.pdf").stat().st_size > 5000
    whole = mpl.figure.Figure()
    axes = whole.subplots()
    assert run.plot_section("u_x", "omega_z", ax=axes) is whole
    assert axes.get_ylabel().startswith(r"$\omega_{z}$")
    with pytest.raises(
        rs.ConfigError,
        match="a figure of this section needs two of its channels, t, n, ",
    ):
        run.plot_section("F_normal")


COMMAND = ("trajectory", "--preset", "GH", "--t-end", 60, "--section", "omega_y=0.004-")


def test_the_command_prints_crossings_and_files_hold_them(tmp_path):
    expected = crossings("omega_y=0.004-", ["t", "n"], **SMALL)
    printed = invoke(*COMMAND, "--channels", "n")
    table = pcsv.read_csv(io.BytesIO(printed.stdout.encode())).to_pandas()
    pd.testing.assert_frame_equal(table, expected)
    assert f"{len(expected)} crossings of omega_y=0.004-" in printed.stderr
    path = tmp_path / "section.parquet"
    figure = tmp_path / "section.svg"
    invoke(*COMMAND, "--channels", "n,u_x", "--output", path, "--figure", figure)
    stored = pq.read_table(path)
    assert stored["t"].to_pylist() == expected["t"].tolist()
    assert stored.schema.field("rising").metadata[b"description"]
    about = json.loads(stored.schema.metadata[b"rattlesweep.run"])
    assert about["section"] == "omega_y=0.004-"
    assert figure.read_text().startswith("<?xml")


def test_a_stored_run_has_sections_too(tmp_path):
    output = tmp_path / "out"
    assert run("quickstart.yaml", output, "bodies.samples=1").exit_code == 0
    options = ("--case", 0, "--sample", 0, "--t-end", 50, "--section", "omega_x")
    replayed = invoke("replay", output, *options)
    path = rs.replay(output, 0, 0, t_end=50, section="omega_x")
    lines = replayed.stdout.splitlines()
    assert len(lines) == 1 + len(path.section) > 4


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--section", "foo"], '"foo" is not one of t, n, u_x'),
        (["--section", "t=3"], "t has none: it only grows"),
        (["--section", "sliding"], "sliding has none: it jumps"),
        (["--section", "energy=0.1"], "energy has none: it is constant in this run"),
        (["--section", "C_I=1", "--model", "reduced"], "C_I has none: it is constant"),
        (["--section", "omega_y="], "'omega_y=' is none; give a channel and a value"),
        (["--section", "omega_y=x"], "x is not a number"),
        (["--section", "omega_y=nan"], "nan is not finite"),
        (["--section", "omega_y=3 rpm"], "a body with a size may have a unit"),
        (["--section", "n", "--dt", "1"], "more than one is given"),
        (["--section", "n", "--model", "reduced", "--channels", "u_x"], "u_x"),
        (
            ["--section", "n", "--channels", "n", "--figure", "x.png"],
            "needs two of its channels, t, n, by default not t and n;",
        ),
    ],
    ids=str,
)
def test_what_is_no_section_is_refused_in_a_sentence(options, words):
    assert_refused(invoke("trajectory", "--preset", "GH", *options), 2, words)
    numbers = ["--preset", "KL", "--n-i", "60rpm", "--section", "omega_y=1"]
    assert_refused(invoke("trajectory", *numbers), 2, "section: 1 has no unit")
