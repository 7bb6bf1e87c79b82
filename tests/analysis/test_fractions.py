"""Fractions of the types over bins of any columns, as tables and as pictures."""

import numpy as np
import pandas as pd
import pytest
from refusal import assert_refused
from scipy.stats import binomtest
from sweeping import invoke

import rattlesweep as rs

TYPES = ("R", "SS", "SW", "unclassified")


@pytest.fixture(scope="module")
def drawn(tmp_path_factory: pytest.TempPathFactory) -> rs.Sweep:
    """Random bodies after two launches."""
    bodies = {"source": "sd", "samples": 90}
    spin = {"n_i": [-0.5, -0.3], "omega_xy0": 0.1}
    config = {"name": "drawn", "seed": 3, "bodies": bodies, "spin": spin}
    horizon = {"t_rgh": 2, "t": 2000}
    output = tmp_path_factory.mktemp("drawn")
    return rs.sweep({**config, "horizon": horizon}, output=output)


@pytest.fixture(scope="module")
def refined(tmp_path_factory: pytest.TempPathFactory) -> rs.Sweep:
    """A grid of which only some points are run."""
    axes = {"theta": {"linspace": [0.6, 0.98, 17]}}
    refine = {"levels": 2, "by": "type"}
    bodies = {
        "source": "grid",
        "base": {"preset": "GH"},
        "axes": axes,
        "refine": refine,
    }
    spin = {"n_i": {"linspace": [-0.6, -0.1, 16]}, "omega_xy0": 0.01}
    config = {"name": "refined", "bodies": bodies, "spin": spin, "horizon": {"t": 900}}
    return rs.sweep(config, output=tmp_path_factory.mktemp("refined"))


def test_bins_hold_equal_counts_with_the_intervals_of_scipy(drawn):
    table = drawn.fractions("xi", bins=4)
    runs = drawn.runs.sort_values("xi")
    # The bodies of the two launches are the same, so a bin has an even number of runs.
    assert table["runs"].tolist() == table["runs_effective"].tolist()
    assert table["runs"].sum() == 180
    assert table["runs"].between(44, 46).all()
    for row in table.to_dict("records"):
        inside = runs[runs["xi"].between(row["xi_low"], row["xi_high"], "left")]
        if row["xi_high"] == runs["xi"].max():
            inside = runs[runs["xi"] >= row["xi_low"]]
        assert len(inside) == row["runs"]
        assert inside["xi"].median() == row["xi"]
        for name in TYPES:
            count = int((inside["type"] == name).sum())
            known = binomtest(count, len(inside)).proportion_ci(method="wilson")
            expected = [count / len(inside), known.low, known.high]
            names = [f"fraction_{name}{end}" for end in ("", "_low", "_high")]
            assert [row[n] for n in names] == pytest.approx(expected, abs=1e-12)


def test_several_columns_make_a_grid_and_conditions_choose(drawn):
    table = drawn.fractions(["n_i", "theta"], bins=3, where="phi > 0.05")
    assert table["n_i"].unique().tolist() == [-0.5, -0.3]
    assert len(table) == 6
    chosen = drawn.read(where="phi > 0.05")
    assert table["runs"].sum() == len(chosen)
    by_spin = table.groupby("n_i").apply(
        lambda cells: np.average(cells["fraction_R"], weights=cells["runs"]),
        include_groups=False,
    )
    expected = chosen.assign(is_r=chosen["type"] == "R").groupby("n_i")["is_r"].mean()
    np.testing.assert_allclose(by_spin.to_numpy(), expected.to_numpy())


def test_a_column_that_some_runs_lack(drawn):
    table = drawn.fractions("t_r", bins=2)
    assert table["runs"].sum() == drawn.runs["t_r"].notna().sum()
    assert (table["fraction_R"] == 1).all()


def test_points_that_were_skipped_count_as_the_nearest_run(refined):
    whole = refined.to_xarray(["type"], fill=True)["type"].squeeze()
    assert len(refined.runs) < whole.size
    table = refined.fractions("theta")
    assert table["theta"].to_numpy() == pytest.approx(whole["theta"].to_numpy())
    for name in TYPES:
        expected = (whole == name).mean("n_i").to_numpy()
        np.testing.assert_allclose(table[f"fraction_{name}"], expected, atol=1e-12)
    # A run that counts for many points is still one run.
    assert (table["runs_effective"] <= table["runs"] + 1e-9).all()
    assert (table["runs"] < whole.sizes["n_i"]).any()
    narrow = 16 / table["runs_effective"]
    assert (narrow >= 1 - 1e-9).all()


def test_the_picture_shows_the_table(drawn, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    options = ("--kind", "fractions", "--x", "xi", "--select", "n_i=-0.5")
    files = ("--output", "xi.svg", "--data", "xi.csv")
    assert invoke("plot", drawn.directory, *options, *files).exit_code == 0
    table = pd.read_csv("xi.csv")
    assert table["runs"].sum() == 90
    figure = drawn.plot("fractions", x="xi", select={"n_i": -0.5})
    (axes,) = figure.axes
    bars = [bar for bar in axes.patches if bar.get_height() > 0]
    heights = table[[f"fraction_{name}" for name in TYPES]].to_numpy()
    assert sorted(bar.get_height() for bar in bars) == pytest.approx(
        sorted(heights[heights > 0])
    )
    edges = sorted({bar.get_x() for bar in bars})
    assert edges == pytest.approx(sorted(table["xi_low"]))
    assert axes.get_xlabel() == r"$\xi$ (rad)"
    assert len(drawn.plot("fractions", x="theta").axes) == 2


def test_a_scatter_of_two_columns_in_the_colours_of_a_third(drawn, tmp_path):
    choice = {"x": "theta", "quantity": "n_departure", "colour": "xi"}
    figure = drawn.plot("scatter", **choice)
    axes, bar = figure.axes
    (points,) = axes.collections
    runs = drawn.runs[["theta", "n_departure", "xi"]].to_numpy()
    drawn_points = np.column_stack([points.get_offsets(), points.get_array()])
    np.testing.assert_array_equal(drawn_points, runs)
    assert bar.get_ylabel() == r"$\xi$ (rad)"
    flags = [text for name, value in choice.items() for text in (f"--{name}", value)]
    data = tmp_path / "points.parquet"
    flags += ["--output", tmp_path / "p.png", "--data", data]
    assert invoke("plot", drawn.directory, *flags).exit_code == 0
    np.testing.assert_array_equal(pd.read_parquet(data).to_numpy(), runs)


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        (("--kind", "fractions", "--x", "xii"), '"xii" is not one of'),
        (("--kind", "fractions", "--x", "type"), 'x: "type" is not one of'),
        (("--kind", "times", "--colour", "xi"), "colour: goes with kind scatter"),
        (("--kind", "scatter", "--colour", "xii"), 'colour: "xii" is not one of'),
        (
            ("--kind", "fractions", "--x", "xi", "--quantity", "t_r"),
            "quantity: kind fractions counts types",
        ),
        (("--kind", "scatter", "--x", "xi", "--quantity", "xi"), "x xi: it is the"),
    ],
)
def test_what_is_wrong_is_one_sentence(drawn, options, sentence):
    assert_refused(invoke("plot", drawn.directory, *options), 2, sentence)


def test_wrong_arguments_of_python(drawn):
    for by, bins, sentence in (
        ("xii", 3, 'by: "xii" is not one of'),
        ("xi", 0, "bins: 0 is given; a whole number of at least 1 is needed"),
        ("xi", 2.5, "bins: 2.5"),
    ):
        with pytest.raises(rs.ConfigError, match=sentence):
            drawn.fractions(by, bins=bins)
    with pytest.raises(rs.OutputError, match="holds no run that has values of f_sd"):
        drawn.fractions("f_sd", where="theta > 2")
