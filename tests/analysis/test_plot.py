"""Pictures show what the runs say, fit the sweep they are of, and can be read."""

from __future__ import annotations

import itertools
import shlex
import shutil
import sys
import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Any

import matplotlib as mpl
import matplotlib.image
import numpy as np
import oracle
import pandas as pd
import pytest
from editing import edited
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from refusal import assert_refused
from sweeping import invoke, tree
from theory_mp import n_c1_squared

import rattlesweep as rs
from rattlesweep.analysis.layout import fill, read_layout
from rattlesweep.analysis.onerun import figure as onerun
from rattlesweep.analysis.plots import Picture, choose_picture
from rattlesweep.analysis.style import (
    BONDI,
    GREY,
    TYPE_STYLE,
    column_envelope,
    curve,
    encode_figure,
    new_figure,
    styled,
)
from rattlesweep.api.single import prepare_launch

CODES = {name: code for code, name in enumerate([*TYPE_STYLE, "failed", "missing"])}

# Of sweeps without dissipation.
PLAIN = {name: mark for name, mark in TYPE_STYLE.items() if name != "D"}


def grid(**axes: Any) -> dict[str, Any]:
    return {"source": "grid", "base": {"preset": "GH"}, "axes": axes}


def bodies(**target: list[float]) -> dict[str, Any]:
    return {"source": "sd", "samples": 12, "target": {**target, "rel_tol": 0.1}}


def spin(n_i: Any, omega_xy0: Any = 0.01) -> dict[str, Any]:
    return {"n_i": n_i, "omega_xy0": omega_xy0}


NINE = {"linspace": [0.6, 0.98, 9]}
SWEEPS: dict[str, dict[str, Any]] = {
    "steady": {
        "bodies": bodies(K_r=[0.005, 0.02, 0.05, 0.1]),
        "spin": spin([-0.5, -0.1], [0.01, 0.1]),
    },
    "unsteady": {"bodies": bodies(K_p=[0.1, 0.3, 1.0]), "spin": spin([0.1, 0.4])},
    "map": {
        "bodies": grid(theta=NINE),
        "spin": spin({"linspace": [-0.6, 0.6, 10]}),
        "horizon": {"t": 300},
    },
    "one": {"bodies": {"source": "preset", "name": "GH"}, "spin": spin(0.1)},
    "stuck": {
        "bodies": grid(theta=NINE),
        "spin": spin({"linspace": [0.1, 0.8, 8]}),
        "integrator": {"max_steps": 400},
    },
    "turns": {
        "bodies": grid(theta=NINE),
        "spin": spin({"linspace": [-0.6, 0.6, 10]}),
        "horizon": {"t": 300},
        "record": ["reversals", "error"],
    },
}


@pytest.fixture(scope="module")
def sweeps(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("sweeps")
    for name, config in SWEEPS.items():
        rs.sweep({"name": name, "seed": 5, **config}, output=root / name, threads=1)
    return root


def picture(directory: Path, kind: str | None = None, **choice: Any) -> Picture:
    return choose_picture(read_layout(directory), kind, **choice)


def drawn(shown: Picture, **options: Any) -> Any:
    with styled():
        figure = shown.figure(**options)
        figure.canvas.draw()
    return figure


def legend_words(figure: Any) -> list[str]:
    return [text.get_text() for text in figure.legends[0].get_texts()]


def test_counts_and_moments_against_pandas(sweeps):
    table = picture(sweeps / "steady").table()
    sweep = rs.load(sweeps / "steady")
    summary = sweep.summary
    runs = sweep.runs.merge(summary[["case", "K_r"]], on="case", suffixes=("_body", ""))
    groups = runs.groupby(["n_i", "omega_xy0", "K_r"])
    assert len(table) == groups.ngroups == 16
    for _, row in table.iterrows():
        cell = groups.get_group((row["n_i"], row["omega_xy0"], row["K_r"]))
        reversed_ = cell[cell["type"] == "R"]
        ratio = reversed_["t_r"] / reversed_["t_rgh"]
        assert row["runs"] == len(cell) == 12
        for name in PLAIN:
            assert row[f"fraction_{name}"] == pytest.approx(
                (cell["type"] == name).mean()
            )
        assert row["fraction_bondi"] == (cell["n_c1"].abs() < cell["n_i"].abs()).mean()
        for name, values in (("t_r", reversed_["t_r"]), ("ratio", ratio)):
            drawn_moments = row[[f"{name}_mean", f"{name}_std", f"{name}_sem"]].tolist()
            moments = [values.mean(), values.std(), values.sem()]
            assert drawn_moments == pytest.approx(moments, rel=1e-10, nan_ok=True)
        assert row["t_rgh_mean"] == pytest.approx(cell["t_rgh"].mean(), rel=1e-12)
    # Bondi's threshold is one of the steady direction.
    assert picture(sweeps / "unsteady").table()["fraction_bondi"].isna().all()


def test_the_right_picture_by_default(sweeps):
    kinds = {
        "map": "map",
        "steady": "fractions",
        "unsteady": "times",
        "one": "distribution",
    }
    assert {name: picture(sweeps / name).name for name in kinds} == kinds


@pytest.mark.parametrize("x", ["K_r", "n_i", "omega_xy0"])
@pytest.mark.parametrize("kind", ["fractions", "times", "ratio", "map"])
def test_nothing_that_varies_is_mixed(sweeps, kind, x):
    axes = [axis.name for axis in picture(sweeps / "steady", kind, x=x).axes]
    assert axes[0] == x
    assert {*axes} == {"K_r", "n_i", "omega_xy0"}


def test_areas_are_the_shares(sweeps):
    shown = picture(
        sweeps / "steady", "fractions", select=["n_i=-0.5", "omega_xy0=0.01"]
    )
    (axes,) = drawn(shown).axes
    table = shown.table().sort_values("K_r")
    below = np.zeros(4)
    areas = {area.get_label(): area for area in axes.patches if area.get_label()}
    # Steady spinning is at the bottom, where the triangles of theory are compared.
    names = ["SS", *(name for name in PLAIN if name != "SS")]
    assert len(areas) == (table[[f"fraction_{name}" for name in names]] > 0).any().sum()
    for name in names:
        colour, _, hatch, text = PLAIN[name]
        if text not in areas:
            assert not table[f"fraction_{name}"].any()
            continue
        top = below + table[f"fraction_{name}"].to_numpy()
        assert areas[text].get_data().baseline == pytest.approx(below)
        assert areas[text].get_data().values == pytest.approx(top)
        assert to_rgb(areas[text].get_facecolor()) == to_rgb(colour)
        assert (areas[text].get_hatch() or "") == hatch
        below = top


def test_triangles_are_at_the_share_of_theory_and_legends_list_what_occurs(sweeps):
    shown = picture(sweeps / "steady", "fractions", select=["n_i=-0.1"])
    whole = drawn(shown)
    table = shown.table()
    theory = [
        line.get_ydata()
        for axes in whole.axes
        for line in axes.lines
        if line.get_marker() == "^"
    ]
    # No steady spin is stable here, so the triangles are at zero.
    assert len(theory) == 2
    assert np.array_equal(np.ravel(theory), np.zeros(8))
    assert not table["fraction_bondi"].any()
    words = legend_words(whole)
    for name, mark in PLAIN.items():
        assert (mark.label in words) == table[f"fraction_{name}"].any()
    assert len(words) < len(PLAIN)


def test_times_are_the_means_and_the_theory_is_dashed(sweeps):
    shown = picture(sweeps / "unsteady", "times", select=["n_i=0.1"])
    (axes,) = drawn(shown).axes
    table = shown.table().sort_values("K_p")
    for style, name in (("-", "t_r_mean"), ("--", "t_rgh_mean")):
        first = next(line for line in axes.lines if line.get_linestyle() == style)
        assert first.get_ydata() == pytest.approx(table[name].to_numpy())
    assert axes.get_xscale() == axes.get_yscale() == "log"


def test_a_single_abscissa_has_a_mark_for_the_theory(sweeps):
    (axes,) = drawn(picture(sweeps / "one", "times")).axes
    (run,) = rs.load(sweeps / "one").runs.itertuples()
    # Ends of error bars are such marks too, but small ones.
    marks = [line for line in axes.lines if line.get_marker() == "_"]
    assert [m.get_ydata() for m in marks if m.get_markersize() > 10] == [[run.t_rgh]]
    (shown,) = axes.figure.legends[0].get_lines()
    assert (shown.get_marker(), shown.get_linestyle()) == ("_", "None")


def test_rounding_errors_are_no_oscillations():
    axes = new_figure(3, 2).subplots()
    t = np.linspace(0, 40, 40_001)
    curve(axes, t, np.tanh(t - 9) + 1e-16 * np.sin(1e5 * t))
    assert not axes.collections
    curve(axes, t, np.sin(100 * t))
    assert len(axes.collections) == 1


def test_no_turn_is_no_value_and_one_value_makes_no_scale(sweeps):
    cells = (
        drawn(picture(sweeps / "turns", "reversals")).axes[0].collections[1].get_array()
    )
    table = rs.load(sweeps / "turns").runs.pivot(index="n_i", columns="theta")
    np.testing.assert_array_equal(
        np.ma.getmaskarray(cells), table["reversals_sure"] == 0
    )
    assert 0 < np.ma.count(cells) < cells.size
    *_, bar = drawn(picture(sweeps / "turns", "map", quantity="omega_xy0")).axes
    assert bar.get_yticks().tolist() == [0.01]


def test_a_map_shows_the_runs_and_bondis_line_between_them(sweeps):
    figure = drawn(picture(sweeps / "map"))
    order = {name: code for code, name in enumerate(TYPE_STYLE)}
    runs = rs.load(sweeps / "map").runs
    runs = runs.assign(code=runs["type"].map(order), ratio=runs["t_r"] / runs["t_rgh"])
    cells = runs.pivot(index="n_i", columns="theta", values=["code", "ratio"])
    code = cells["code"].to_numpy()
    value = cells["ratio"].to_numpy()
    assert len(np.unique(code)) > 2
    types, ratio = figure.axes[:2]
    np.testing.assert_array_equal(types.collections[0].get_array(), code)
    colours = ratio.collections[1].get_array()
    np.testing.assert_array_equal(np.ma.getmaskarray(colours), np.isnan(value))
    np.testing.assert_allclose(colours.compressed(), value[~np.isnan(value)])
    assert BONDI in legend_words(figure)
    for axes in (types, ratio):
        (line, *_) = (
            c.get_paths()[0].vertices for c in axes.collections if hasattr(c, "levels")
        )
        on = line[np.isin(line[:, 0].round(9), np.linspace(0.6, 0.98, 9).round(9))]
        assert len(on) > 3
        for theta, n_i in on:
            exact = n_c1_squared(
                *(oracle.GH[k] for k in ("alpha", "beta", "gamma")), theta, 0.036
            )
            assert n_i == pytest.approx(-(float(exact) ** 0.5), rel=1e-5)


def test_failed_and_missing_cells_are_seen(sweeps, tmp_path):
    part = edited(sweeps / "map", tmp_path / "part", lambda rows: rows[:60])
    stuck = (rs.load(sweeps / "stuck").runs["status"] != "ok").sum()
    assert stuck > 0
    for directory, word, name, count in (
        (sweeps / "stuck", "failed", "failed", stuck),
        (part, "not run yet", "missing", 30),
    ):
        figure = picture(directory).figure()
        assert word in legend_words(figure)
        assert (figure.axes[0].collections[0].get_array() == CODES[name]).sum() == count


def test_settings_of_the_caller_are_respected(sweeps):
    sweep = rs.load(sweeps / "unsteady")
    loud = {"font.size": 14, "font.family": "serif"}
    with mpl.rc_context(loud):
        outside = sweep.plot("times", select={"n_i": 0.1}, caption=False)
        above = sweep.plot("times", style={"font.size": 11})
    plain = sweep.plot("times", style="ggplot")
    expected = ((outside, 14, "dejavuserif"), (above, 11, "dejavuserif"))
    for figure, size, math in (*expected, (plain, 12, "dejavusans")):
        label = figure.axes[0].xaxis.label
        assert label.get_fontsize() == pytest.approx(size)
        assert label.get_math_fontfamily() == math
    assert to_rgb(plain.axes[0].get_facecolor()) == to_rgb("#E5E5E5")
    words = [[text.get_text() for text in f.texts] for f in (outside, above)]
    assert ["Mean of" in " ".join(texts) for texts in words] == [False, True]
    with pytest.raises(rs.ConfigError, match="ggplott"):
        sweep.plot(style="ggplott")


def test_a_picture_on_axes_of_the_caller(sweeps, tmp_path):
    sweep = rs.load(sweeps / "unsteady")
    one = {"select": {"n_i": 0.1}}
    figure = new_figure(3, 2)
    left, right = figure.subplots(1, 2)
    assert sweep.plot("times", ax=left, title="here", **one) is figure
    whole = sweep.plot("times", **one).axes[0]
    for mine, other in zip(left.lines, whole.lines, strict=True):
        np.testing.assert_array_equal(mine.get_xydata(), other.get_xydata())
    assert left.get_title() == "here"
    assert [text.get_text() for text in left.get_legend().get_texts()] == ["theory"]
    rs.load(sweeps / "map").plot(quantity="n_steps", ax=right, path=tmp_path / "m.png")
    assert right.collections
    assert matplotlib.image.imread(tmp_path / "m.png").shape[:2] == (300, 450)
    for name, wrong, sentence in (
        ("steady", {"kind": "fractions"}, "ax: there are 4 panels"),
        ("map", {"kind": "map"}, "quantity for a map"),
        ("unsteady", {"size": (3, 2), **one}, "size: the figure of ax is the caller"),
    ):
        with pytest.raises(rs.ConfigError, match=sentence):
            rs.load(sweeps / name).plot(ax=left, **wrong)


@pytest.mark.parametrize("width", [3.4, pytest.param(7.0, marks=pytest.mark.slow)])
@pytest.mark.parametrize(
    "shown",
    [
        "steady fractions",
        "steady times",
        "steady ratio",
        "steady scatter",
        "steady distribution",
        "map map",
        "turns reversals",
    ],
)
def test_a_figure_of_a_column_of_a_journal_can_be_read(sweeps, shown, width):
    """No labels of ticks touch, and the caption takes no quarter of the height."""
    name, kind = shown.split()
    choice = {}
    if name == "steady":
        choice = {"select": {"omega_xy0": 0.01}}
    with mpl.rc_context({"font.family": "serif", "font.size": 7}):
        figure = rs.load(sweeps / name).plot(kind, size=(width, 0.7 * width), **choice)
    figure.canvas.draw()
    for which in ("xaxis", "yaxis"):
        boxes = []
        for axes in figure.axes:
            axis = getattr(axes, which)
            low, high = sorted(axis.get_view_interval())
            for tick in axis.get_major_ticks():
                for text in (tick.label1, tick.label2):
                    if (
                        text.get_visible()
                        and text.get_text()
                        and low <= tick.get_loc() <= high
                    ):
                        boxes.append(text.get_window_extent())
        assert len(boxes) >= 2
        pairs = itertools.combinations(boxes, 2)
        assert not any(one.overlaps(other) for one, other in pairs), which
    height = figure.bbox.height
    captions = [text for text in figure.texts if text.get_color() == GREY]
    assert all(text.get_window_extent().height < height / 4 for text in captions)
    panels = sum(axes.get_window_extent().height for axes in figure.axes[:1])
    assert panels > 0.25 * height


def test_data_style_title_size_and_defaults(sweeps, tmp_path):
    copy = Path(shutil.copytree(sweeps / "steady", tmp_path / "steady"))
    style = tmp_path / "loud.mplstyle"
    style.write_text("font.size: 14\naxes.facecolor: yellow\n")
    before = dict(mpl.rcParams)
    for ending, more in (("csv", ()), ("parquet", ("--output", tmp_path / "p.pdf"))):
        done = invoke(
            "plot",
            copy,
            "--kind",
            "ratio",
            "--select",
            "K_r=0.005:0.02",
            "--select",
            "n_i=-0.5",
            "--style",
            style,
            "--title",
            "Steady",
            "--size",
            "5,3",
            "--dpi",
            "100",
            "--data",
            tmp_path / f"d.{ending}",
            *more,
        )
        assert done.exit_code == 0, done.stderr
    assert dict(mpl.rcParams) == before
    # Equal pictures are equal files.
    assert b"CreationDate" not in (tmp_path / "p.pdf").read_bytes()
    assert matplotlib.image.imread(copy / "ratio.png").shape[:2] == (300, 500)
    svg = (copy / "ratio.svg").read_text()
    assert "#ffff00" in svg
    assert "<!-- Steady -->" in svg
    csv = pd.read_csv(tmp_path / "d.csv")
    parquet = pd.read_parquet(tmp_path / "d.parquet")
    pd.testing.assert_frame_equal(csv, parquet)
    assert (set(csv["K_r"]), set(csv["n_i"])) == ({0.005, 0.02}, {-0.5})


def test_a_long_condition_is_wrapped(sweeps):
    where = " and ".join(["K_r > 0.001"] * 20)
    figure = drawn(picture(sweeps / "steady", "times", where=where))
    assert figure.legends[0].get_title().get_text().split() == where.split()
    assert figure.legends[0].get_window_extent().width <= figure.bbox.width


def test_a_scatter_shows_each_reversal_once(sweeps, tmp_path):
    target = tmp_path / "p.png", tmp_path / "d.parquet"
    done = invoke(
        "plot",
        sweeps / "steady",
        "--x",
        "K_p",
        "--select",
        "n_i=-0.5",
        "--output",
        target[0],
        "--data",
        target[1],
        "--dpi",
        40,
    )
    assert done.exit_code == 0, done.stderr
    assert done.stdout == f"{target[0]}\n{target[1]}\n"
    runs = rs.load(sweeps / "steady").runs
    wanted = runs[(runs["n_i"] == -0.5) & runs["t_r"].notna()][["K_p", "t_r"]]
    pd.testing.assert_frame_equal(
        pd.read_parquet(target[1]), wanted.reset_index(drop=True)
    )
    (axes,) = picture(sweeps / "steady", "scatter").figure().axes
    points, theory = axes.lines
    assert sorted(points.get_ydata()) == sorted(runs["t_r"].dropna())
    assert theory.get_xdata().tolist() == theory.get_ydata().tolist()


def test_a_histogram_of_any_column_has_every_run_once(sweeps):
    runs = rs.load(sweeps / "steady").runs
    for name in ("ratio", "K_p", "n_steps", "near_tangencies"):
        quantity = None if name == "ratio" else name
        table = picture(sweeps / "steady", "distribution", quantity=quantity).table()
        values = (runs.t_r / runs.t_rgh if name == "ratio" else runs[name]).dropna()
        edges = [*table[f"{name}_low"], table[f"{name}_high"].iloc[-1]]
        assert table.runs.sum() == len(values)
        assert table.runs.tolist() == np.histogram(values, edges)[0].tolist()
    # Counts have bins around whole numbers.
    assert table["near_tangencies_low"].iloc[0] % 1 == 0.5
    # A few values have a bar each, and so has a single one.
    for directory, values in (("steady", [0.01, 0.1]), ("unsteady", [0.01])):
        table = picture(
            sweeps / directory, "distribution", quantity="omega_xy0"
        ).table()
        bars = table[table.runs > 0]
        middles = (bars["omega_xy0_low"] + bars["omega_xy0_high"]) / 2
        assert middles.tolist() == pytest.approx(values)


def test_bodies_of_a_known_size_are_shown_in_seconds_and_rpm(tmp_path):
    sizes = {"length": "12 cm", "width": "3 cm", "height": "12 mm", "mass": "60 g"}
    shape = {"source": "shape", "shape": "half_ellipsoid", **sizes, "skew": "4 deg"}
    n_i = ["-30 rpm", "30 rpm", "60 rpm"]
    sweep = rs.sweep(
        {
            "bodies": shape,
            "spin": {"n_i": n_i, "omega_xy0": ["6 rpm", "9 rpm"]},
            "horizon": {"t": "20 s"},
        },
        output=tmp_path,
    )
    runs = sweep.runs[sweep.runs.omega_xy0 < sweep.runs.omega_xy0.mean()]
    selected = [f"omega_xy0={runs.omega_xy0.iloc[0]}", "n_i_rpm=0:90"]
    shown = picture(tmp_path, "times", select=selected)
    assert [axis.values.tolist() for axis in shown.layout.axes.values()] == [
        [30, 60],
        [6],
    ]
    figure = drawn(shown)
    (axes,) = figure.axes
    assert (axes.get_xlabel(), axes.get_ylabel()) == (
        "$n_{i}$ (rpm)",
        "$t_{r}$ (s)",
    )
    assert {x for line in axes.lines for x in line.get_xdata()} == {30, 60}
    means = runs[runs.n_i > 0].groupby("n_i_rpm").t_r_s.mean()
    assert shown.table()["t_r_s_mean"].tolist() == pytest.approx(means.tolist())
    second = (runs.t_r_s / runs.t_r).mean()
    points = picture(tmp_path, "scatter", select=selected[:1]).table()
    assert points["t_rgh_s"].tolist() == pytest.approx((runs.t_rgh * second).tolist())
    figure = drawn(picture(tmp_path, "distribution", quantity="t_end"))
    assert figure.axes[0].get_xlabel() == "$t_{end}$ (s)"


def test_filled_points_are_those_of_the_nearest_run_and_between_runs():
    x, y = np.meshgrid(np.arange(9.0), np.arange(9.0), indexing="ij")
    plane = 2 * x + 3 * y
    known = (x % 4 == 0) & (y % 4 == 0)
    np.testing.assert_allclose(fill(np.where(known, plane, np.nan), known), plane)
    filled = fill(np.where(known, np.where(x < 4, "R", "SS"), ""), known)
    assert ({*filled[:2].flat}, {*filled[7:].flat}) == ({"R"}, {"SS"})
    # Where the nearest run has no value there is none.
    holes = fill(np.where(known & (x < 4), plane, np.nan), known)
    assert np.isnan(holes[6:]).all()
    assert np.isfinite(holes[:2]).all()


def test_a_refined_map_is_whole_and_so_is_the_dataset(tmp_path):
    theta = {"linspace": [0.6, 0.98, 17]}
    config = {
        "bodies": grid(theta=theta) | {"refine": {"levels": 2}},
        "model": "gh",
        "spin": spin({"linspace": [-0.6, 0.6, 18]}),
        "horizon": {"t": 300},
    }
    sweep = rs.sweep(config, output=tmp_path, threads=1)
    shown = picture(tmp_path)
    code, *_ = shown.shown()
    assert len(shown) < code.size
    assert CODES["missing"] not in code
    runs = sweep.runs
    for row in runs.itertuples():
        place = [
            np.argmin(np.abs(axis.values - getattr(row, axis.name)))
            for axis in shown.axes
        ]
        assert code[tuple(place)] == CODES[row.type]
    whole, part = (
        sweep.to_xarray(["type", "t_r"], fill=fill).squeeze() for fill in (True, False)
    )
    assert (part.type == "").sum() == code.size - len(runs)
    assert (whole.type != "").all()
    # A condition leaves out the points that are filled from runs that it does not
    # choose.
    some, *_ = picture(tmp_path, where="n_i > 0").shown()
    assert (some == CODES["missing"]).any()
    np.testing.assert_array_equal(
        some[some != CODES["missing"]], code[some != CODES["missing"]]
    )


def test_a_dataset_without_xarray_names_the_extra(sweeps, monkeypatch):
    monkeypatch.setitem(sys.modules, "xarray", None)
    with pytest.raises(rs.OutputError, match=r"pip install 'rattlesweep\[xarray\]'"):
        rs.load(sweeps / "map").to_xarray()


# With exit code 2, or 1 where it is said.
REFUSED = r"""
plot steady --style none.mplstyle | --style none.mplstyle: No such file or directory
plot nowhere | nowhere is not an output directory: there is no such
plot steady --title '$\notacommand$' | Unknown symbol
plot steady --kind times --ylim 0,9 | ylim: a logarithmic axis is positive
plot map --kind reversals | it needs record: [reversals]
plot map --x f_sd | 1: holds no run that has values of f_sd
plot one --kind map | kind map: does not fit this sweep
plot map --quantity n_step | quantity: "n_step" is not one of
plot map --kind ratio --quantity n_steps | quantity: goes with kind map
plot steady --x K_s | "K_s" is not one of K_r, n_i, omega_xy0
plot steady --kind map --x K_r --select K_r=0.02 | only one value of K_r is left
plot steady --select n_i=-0.2 | no value -0.2; there are -0.5, -0.1
plot steady --select n_i=a | is not NAME=VALUES
plot steady --where 't_R < 3' | did you mean "t_r"?
plot steady --where 't_r < 0' | 1: holds no run of those selected
plot steady --style bad.mplstyle | font.size
plot one --size 60,60 --dpi 1200 | give 2 numbers from 1 to 24
plot map --log | has values that are not positive
plot one --output /proc/no/p.svg | 1: cannot write in /proc/no: there is no such folder
plot broken | 1: is damaged
report damaged | 1: damaged/runs/
show --preset GH --output a.htm | the name must end in .html
show --preset GH --case 1 --output a.html | choose a run of a DIRECTORY
show one --case 0 --sample 0 --theta 0.7 --output a.html | a stored run has its own
replay one --case 9 --sample 0 | has the cases 0 to 0
replay one --case 0 | which run?
replay one --case 0 --sample 0 --where K_r<1 | which run?
replay one --case 0 --sample 0 --channels t,omga_x | did you mean "omega_x"?
replay one --case 0 --sample 0 --output a.xlsx | .parquet or .csv
"""


@pytest.fixture(scope="module")
def place(sweeps: Path) -> Path:
    """The same with broken ones, and a style file that is none."""
    for name in ("broken", "damaged"):
        shutil.copytree(sweeps / "one", sweeps / name)
    (sweeps / "broken" / "manifest.json").write_text("{}")
    (block,) = (sweeps / "damaged" / "runs").iterdir()
    block.write_bytes(block.read_bytes()[:-200])
    (sweeps / "bad.mplstyle").write_text("font.size: [x\n")
    return sweeps


@pytest.mark.parametrize("line", REFUSED.strip().splitlines())
def test_what_is_wrong_is_one_sentence(place, monkeypatch, line):
    monkeypatch.chdir(place)
    before = tree(place)
    command, sentence = line.split(" | ")
    code = 2
    if sentence.startswith("1: "):
        code = 1
    result = invoke(*shlex.split(command))
    assert_refused(result, code, sentence.removeprefix("1: "))
    assert tree(place) == before


def test_a_formula_may_be_nested_too_deeply(sweeps, tmp_path):
    title = "$" + r"\sqrt{" * 500 + "2" + "}" * 500 + "$"
    command = ("plot", sweeps / "steady", "--title", title)
    result = invoke(*command, "--output", tmp_path / "p.svg")
    assert_refused(result, 2, "a text in the picture: a formula is nested too deeply")
    assert not list(tmp_path.iterdir())


def test_titles_of_narrow_panels_stay_apart(tmp_path):
    config = {
        "bodies": {
            "source": "sd",
            "samples": 5,
            "target": {"K_r": [0.01, 0.03, 0.1], "rel_tol": 0.1},
        },
        "spin": {"n_i": [-0.1, -0.2, -0.3, -0.4, -0.5], "omega_xy0": 0.01},
        "model": "gh",
    }
    sweep = rs.sweep(config, output=tmp_path / "five", progress=False)
    figure = sweep.plot("fractions", size=(3.4, 2.8), caption=False)
    figure.draw_without_rendering()
    boxes = [axes.title.get_window_extent() for axes in figure.axes]
    assert len(boxes) == 5
    # They may stand in several lines.
    for box, other in itertools.combinations(boxes, 2):
        assert not box.overlaps(other)


def test_nothing_is_drawn_outside_the_panels(sweeps):
    figure = drawn(picture(sweeps / "steady", "fractions"), xlim=(0.01, 0.06))
    lines = [line for axes in figure.axes for line in axes.lines]
    markers = [line for line in lines if not line.get_clip_on()]
    marked = np.concatenate([line.get_xdata() for line in markers])
    assert set(marked) == {0.02, 0.05}


@pytest.mark.parametrize("xlim", ["0.06,0.01", "0.2,0.3"])
def test_limits_that_show_nothing_are_refused(sweeps, tmp_path, xlim):
    target = tmp_path / "f.svg"
    done = invoke("plot", sweeps / "steady", "--xlim", xlim, "--output", target)
    assert_refused(done, 2, "xlim: ")
    assert not target.exists()


def test_bars_stand_on_their_markers(sweeps):
    figure = drawn(picture(sweeps / "steady", "ratio", x="n_i"))
    for axes in figure.axes:
        containers = [c for c in axes.containers if c.has_yerr]
        places = {
            tuple(np.round(line.get_xdata(), 12))
            for line in axes.lines
            if line.get_marker() in ("o", "s", "^", "D")
        }
        assert containers
        for container in containers:
            (bars,) = container.lines[2]
            x = tuple(np.round([segment[0, 0] for segment in bars.get_segments()], 12))
            assert x in places


def test_no_fraction_is_drawn_between_the_directions_of_spin(tmp_path):
    config = {"bodies": bodies(K_r=[0.05]), "spin": spin([-0.3, -0.2, 0.2, 0.3])}
    rs.sweep(config | {"model": "gh"}, output=tmp_path / "out", threads=1)
    figure = drawn(picture(tmp_path / "out", "fractions"))
    edges = [patch.get_data().edges for patch in figure.axes[0].patches]
    assert all(not (each[0] < 0 < each[-1]) for each in edges)
    assert sorted({float(np.round(e, 12)) for each in edges for e in each}) == [
        -0.35, -0.25, -0.15, 0.15, 0.25, 0.35,
    ]  # fmt: skip


def test_a_tap_has_no_formula_that_stays_at_zero(tmp_path):
    path = rs.trajectory("GH", n_i=0, omega_xy0=0.1, t_end=20)
    words = [line.get_label() for line in path.plot().axes[0].lines]
    assert "Garcia and Hubbard" not in words


def test_an_envelope_keeps_every_extreme_and_the_turn():
    t = np.linspace(0, 1000, 60_001)
    turn = np.where(np.abs(t - 503) < 4, -1.0, 1.0)  # shorter than two oscillations
    figure = new_figure(4, 3)
    axis = figure.subplots()
    curve(axis, t, turn + 0.1 * np.sin(2 * t))
    low, high = (line.get_ydata() for line in axis.lines)
    places = axis.lines[0].get_xdata()
    assert low.min() == pytest.approx(-1.1, abs=1e-3)
    inside = np.abs(places - 503) < 1
    # The band is narrow within the turn: it shows that the curve went there and back.
    assert high[inside].max() < -0.85
    assert high.max() == pytest.approx(1.1, abs=1e-3)


# A run that wobbles: its oscillation grows without a beat up to t = 14,200.
WOBBLING = rs.Rattleback(5.821, 1.668, 5.489, 0.7594, 0.06514, np.radians(-0.4693))
WOBBLE = {"n_i": -0.2, "omega_xy0": 0.001}


def test_the_envelope_of_a_wobble_has_no_beats():
    run = prepare_launch(WOBBLING, **WOBBLE, t_end=14_000)
    course = onerun.course_of_figure(run, ["omega_x"], None)
    low, high = onerun.draw(course.columns(), course).axes[0].lines[:2]
    # After a twentieth of the time nothing is left of the other mode.
    grown = high.get_ydata()[high.get_xdata() > 700]
    assert np.all(np.diff(grown) > -2e-3 * grown[1:])
    steps = rs.trajectory(
        WOBBLING, **WOBBLE, t_end=14_000, channels=["t", "omega_x"], steps=True
    ).table
    for time in (1_000, 4_000, 7_000, 10_000, 13_900):
        (largest,) = np.interp([time], *high.get_data())
        seen = steps.omega_x[(steps.t - time).abs() < 60].abs().max()
        assert largest == pytest.approx(seen, rel=0.03)
        assert np.interp(time, *low.get_data()) == pytest.approx(-largest, rel=0.02)


@pytest.mark.parametrize("periods", [40, 200, 330, 637, 900, 1010, 6711])
def test_an_envelope_neither_beats_nor_aliases(periods):
    t = np.linspace(0, 1, 24 * max(periods, 1000) + 1)
    found = column_envelope(t, np.exp(t) * np.sin(2 * np.pi * periods * t))
    if periods == 40:
        assert found is None
    else:
        assert found.high == pytest.approx(np.exp(found.t), rel=0.03)
        assert found.low == pytest.approx(-np.exp(found.t), rel=0.03)


def test_rows_of_a_very_long_run_do_not_beat_with_it(monkeypatch):
    monkeypatch.setattr(onerun, "_MOST", 2001)
    run = prepare_launch("GH", n_i=0.1, omega_xy0=0.01, t_end=1e5)
    times = onerun.course_of_figure(run, None, 1e4).times
    assert (times[0], times[-1], len(times)) == (1e4, 1e5, 2001)
    assert (np.diff(times) > 0).all()
    # An oscillation of the mean distance of rows.
    assert np.ptp(np.sin(2 * np.pi * times / np.diff(times).mean())[:100]) > 1.9


def test_what_is_conserved_is_not_magnified():
    launch = {"n_i": "60 rpm", "omega_xy0": "6 rpm", "t_end": "3 s"}
    run = rs.trajectory("KL", **launch, channels=["t", "energy", "energy_drift"])
    energy, drift = run.plot().axes
    low, high = energy.get_ylim()
    value = run["energy_J"].mean()
    assert high - low == pytest.approx(1.2e-6 * value)
    assert low < value < high
    ticks = [tick.get_text() for tick in energy.get_yticklabels()]
    assert ticks == ["−5e−7 of it", f"{value:.6g}", "+5e−7 of it"]
    spread = np.ptp(run["energy_J"]) / value
    part = float(energy.get_ylabel().split()[-3].replace("−", "-"))
    assert "varies by" in energy.get_ylabel()
    assert part == pytest.approx(spread, rel=0.5)
    # The error itself is shown as it is.
    assert np.ptp(drift.get_ylim()) < 3 * np.ptp(run["energy_drift"])
    # A range above the least one is shown, too.
    lossy = rs.trajectory("KL", **launch, sigma="1e-6 N m s", channels=["t", "energy"])
    assert np.ptp(lossy.plot().axes[0].get_ylim()) < 2 * np.ptp(lossy["energy_J"])


@pytest.mark.slow
def test_very_many_panels_are_reduced_and_this_is_said(tmp_path):
    config = {
        "bodies": bodies(K_r=[0.02, 0.05, 0.1]),
        "spin": spin(
            [-0.1, -0.2, -0.3, -0.4, -0.5, 0.1, 0.2, 0.3, 0.4, 0.5], [0.01, 0.1]
        ),
        "dissipation": {"sigma": [0.0, 1e-4, 1e-3, 1e-2]},
        "horizon": {"t": 1.0},
    }
    config["bodies"]["samples"] = 1
    rs.sweep(config, output=tmp_path / "out", threads=1)
    shown = picture(tmp_path / "out", "scatter", x="minus_xi_deg", quantity="n_end")
    runs = rs.load(tmp_path / "out").runs
    assert sorted(shown.table()["minus_xi_deg"]) == pytest.approx(
        sorted(-np.degrees(runs.xi))
    )
    shown = picture(tmp_path / "out", "times")
    figure = drawn(shown)
    assert len(figure.axes) <= 40
    assert len(runs) == 240


@pytest.mark.parametrize(
    "title", ["bell\a", "a--b", "x\x1b[0m", "a]]>b", "\udc80\ufffe"]
)
def test_any_title_leaves_a_picture_that_is_xml(title):
    figure = Figure()
    figure.suptitle(f"{title}\nbelow")
    assert ET.fromstring(encode_figure(figure, "svg")).tag.endswith("svg")
