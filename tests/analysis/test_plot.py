"""Pictures show what the runs say, fit the sweep they are of, and can be read."""

from __future__ import annotations

import re
import shutil
from itertools import pairwise
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
from sweeping import invoke
from theory_mp import n_c1_squared

import rattlesweep as rs
from rattlesweep.analysis.grids import fill
from rattlesweep.analysis.plots import runs as plot_runs
from rattlesweep.analysis.plots.kinds import choose_picture
from rattlesweep.analysis.plots.layout import read_layout
from rattlesweep.analysis.plots.map import BONDI_LABEL, CODES
from rattlesweep.analysis.plots.picture import Picture
from rattlesweep.analysis.style import FAILED, MISSING, NO_REVERSAL, TYPE_STYLE, styled
from rattlesweep.errors import ConfigError

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
    "steady": {"bodies": bodies(K_r=[0.005, 0.02, 0.05, 0.1]),
               "spin": spin([-0.5, -0.1], [0.01, 0.1])},
    "unsteady": {"bodies": bodies(K_p=[0.1, 0.3, 1.0]), "spin": spin([0.1, 0.4])},
    "map": {"bodies": grid(theta=NINE), "spin": spin({"linspace": [-0.6, 0.6, 10]}),
            "horizon": {"t": 300}},
    "plane": {"bodies": grid(phi={"logspace": [0.01, 0.1, 8]}, theta=NINE),
              "spin": spin([-0.3, -0.5]), "horizon": {"t": 100}},
    "one": {"bodies": {"source": "preset", "name": "GH"}, "spin": spin(0.1)},
    "stuck": {"bodies": grid(theta=NINE), "spin": spin({"linspace": [0.1, 0.8, 8]}),
              "integrator": {"max_steps": 400}},
}  # fmt: skip
DEFAULT = {"steady": "fractions", "unsteady": "times", "one": "distribution"}


@pytest.fixture(scope="module")
def sweeps(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A directory of small sweeps of every shape."""
    root = tmp_path_factory.mktemp("sweeps")
    for name, config in SWEEPS.items():
        rs.sweep({"name": name, "seed": 5, **config}, output=root / name, threads=1)
    return root


def picture(directory: Path, kind: str | None = None, **choice: Any) -> Picture:
    """A picture of all runs."""
    return choose_picture(read_layout(directory), kind, **choice)


def drawn(shown: Picture, **options: Any) -> Any:
    """A picture's figure, laid out."""
    with styled():
        figure = shown.figure(**options)
        figure.canvas.draw()
    return figure


def legend_words(figure: Any) -> list[str]:
    """What the legend says."""
    return [text.get_text() for text in figure.legends[0].get_texts()]


# -- numbers ---------------------------------------------------------------------------------------


def test_counts_and_moments_against_pandas(sweeps):
    table = picture(sweeps / "steady").table().to_pandas()
    runs, summary = rs.load(sweeps / "steady").runs, rs.load(sweeps / "steady").summary
    runs = runs.merge(summary[["case", "K_r"]], on="case", suffixes=("_body", ""))
    groups = runs.groupby(["n_i", "omega_xy0", "K_r"])
    assert len(table) == groups.ngroups == 16
    for _, row in table.iterrows():
        cell = groups.get_group((row["n_i"], row["omega_xy0"], row["K_r"]))
        reversed_ = cell[cell["type"] == "R"]
        ratio = reversed_["t_r"] / reversed_["t_rgh"]
        assert row["runs"] == len(cell) == 12
        for name in PLAIN:
            assert row[f"fraction_{name}"] == pytest.approx((cell["type"] == name).mean())
        assert row["fraction_bondi"] == (cell["n_c1"].abs() < cell["n_i"].abs()).mean()
        for name, values in (("t_r", reversed_["t_r"]), ("ratio", ratio)):
            found = row[[f"{name}_mean", f"{name}_std", f"{name}_sem"]].tolist()
            moments = [values.mean(), values.std(), values.sem()]
            assert found == pytest.approx(moments, rel=1e-10, nan_ok=True)
        assert row["t_rgh_mean"] == pytest.approx(cell["t_rgh"].mean(), rel=1e-12)
    assert table["fraction_SS"].max() > 0.2
    assert table["fraction_SW"].max() > 0
    ratio = (runs["t_r"] / runs["t_rgh"])[runs["type"] == "R"]
    found = picture(sweeps / "steady", "distribution").table().to_pandas()
    inside = ratio.to_numpy()[:, None] >= found["ratio_low"].to_numpy()
    assert found["runs"].sum() == len(ratio)
    assert found["runs"][::-1].cumsum()[::-1].tolist() == inside.sum(axis=0).tolist()
    # Bondi's threshold is one of the steady direction.
    unsteady = picture(sweeps / "unsteady").table()
    assert unsteady["fraction_bondi"].null_count == len(unsteady) > 0


# -- pictures --------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", SWEEPS)
def test_the_right_picture_by_default(sweeps, name):
    assert choose_picture(read_layout(sweeps / name)).name == DEFAULT.get(name, "map")


@pytest.mark.parametrize("x", ["K_r", "n_i", "omega_xy0"])
@pytest.mark.parametrize("kind", ["fractions", "times", "ratio", "map"])
def test_nothing_that_varies_is_mixed(sweeps, kind, x):
    layout = read_layout(sweeps / "steady")
    for select in ([], ["n_i=-0.5"], ["omega_xy0=0.01"]):
        left = {"K_r", "n_i", "omega_xy0"} - {text.split("=")[0] for text in select}
        if kind == "map" and x not in left:
            with pytest.raises(ConfigError, match=f"only one value of {x} is left"):
                choose_picture(layout, kind, x=x, select=select)
            continue
        axes = [axis.name for axis in choose_picture(layout, kind, x=x, select=select).axes]
        assert left <= set(axes)
        assert axes[0] == x


def test_areas_are_the_shares(sweeps):
    shown = picture(sweeps / "steady", "fractions", select=["n_i=-0.5", "omega_xy0=0.01"])
    (axes,) = drawn(shown).axes
    table = shown.table().to_pandas().sort_values("K_r")
    below = np.zeros(4)
    areas = {area.get_label(): area for area in axes.patches if area.get_label()}
    for name, (colour, _, hatch, text) in PLAIN.items():
        top = below + table[f"fraction_{name}"].to_numpy()
        drawn_as = areas[text].get_data()
        assert (drawn_as.baseline.tolist(), drawn_as.values.tolist()) == (
            pytest.approx(below), pytest.approx(top)
        )  # fmt: skip
        assert to_rgb(areas[text].get_facecolor()) == to_rgb(colour)
        assert (areas[text].get_hatch() or "") == hatch
        below = top
    (bondi,) = [line for line in axes.lines if "Bondi" in str(line.get_label())]
    assert bondi.get_ydata() == pytest.approx(1 - table["fraction_bondi"].to_numpy())


def test_times_are_the_means_and_the_theory_is_dashed(sweeps):
    shown = picture(sweeps / "unsteady", "times", select=["n_i=0.1"])
    (axes,) = drawn(shown).axes
    table = shown.table().to_pandas().sort_values("K_p")
    for style, name in (("-", "t_r_mean"), ("--", "t_rgh_mean")):
        first = next(line for line in axes.lines if line.get_linestyle() == style)
        assert first.get_ydata() == pytest.approx(table[name].to_numpy())
    # The paper: at small spin and oscillation they agree.
    assert table["t_r_mean"].to_numpy() == pytest.approx(table["t_rgh_mean"].to_numpy(), rel=0.2)
    assert axes.get_xscale() == axes.get_yscale() == "log"


def test_a_curve_does_not_join_the_two_directions(sweeps):
    figure = drawn(picture(sweeps / "map", "ratio", x="n_i", select=["theta=0.6"]))
    for line in figure.axes[0].lines:
        x = np.asarray(line.get_xdata(), float)
        if line.get_linestyle() == "-" and line.get_marker() == "None" and len(x) > 1:
            assert not (x.min() < 0 < x.max())


def contours(axes: Any) -> list[Any]:
    """Points of the lines that are drawn over a map."""
    found = [c for c in axes.collections if hasattr(c, "levels")]
    return [np.concatenate([path.vertices for path in c.get_paths()]) for c in found]


def threshold(theta: float, phi: float) -> float:
    """Bondi's n_c1 of GH with other curvatures, from the paper."""
    gh = oracle.GH
    return -(float(n_c1_squared(gh["alpha"], gh["beta"], gh["gamma"], theta, phi)) ** 0.5)


def test_a_map_shows_the_runs_and_bondis_line_between_them(sweeps):
    shown = picture(sweeps / "map")
    figure = drawn(shown)
    assert re.fullmatch(r"90 runs(; basin entropy [^;]*; uncertainty exponent .*)?", shown.words())
    types, ratio = figure.axes[:2]
    order = {name: code for code, name in enumerate(TYPE_STYLE)}
    runs = rs.load(sweeps / "map").runs
    runs = runs.assign(code=runs["type"].map(order), ratio=runs["t_r"] / runs["t_rgh"])
    cells = runs.pivot(index="n_i", columns="theta", values=["code", "ratio"])
    assert cells.index.tolist() == pytest.approx(np.linspace(-0.6, 0.6, 10))
    code, value = cells["code"].to_numpy(), cells["ratio"].to_numpy()
    np.testing.assert_array_equal(types.collections[0].get_array(), code)
    colours = ratio.collections[1].get_array()
    np.testing.assert_array_equal(np.ma.getmaskarray(colours), np.isnan(value))
    np.testing.assert_allclose(colours.compressed(), value[~np.isnan(value)])
    assert len(np.unique(code)) > 2
    for axes in (types, ratio):
        lines = contours(axes)
        assert len(lines) == 2
        for line in lines:
            on = line[np.isin(line[:, 0].round(9), cells.columns.levels[1].to_numpy().round(9))]
            assert len(on) > 3
            for theta, n_i in on:
                assert n_i == pytest.approx(threshold(theta, 0.036), rel=1e-5)
    assert BONDI_LABEL in legend_words(figure)


def test_failed_and_missing_cells_are_seen(sweeps, tmp_path):
    part = edited(sweeps / "map", tmp_path / "part", lambda rows: rows[:60])
    stuck = (rs.load(sweeps / "stuck").runs["status"] != "ok").sum()
    assert stuck > 0
    for directory, word, name, colour, count in (
        (sweeps / "stuck", "failed", "failed", FAILED, stuck),
        (part, "not run yet", "missing", MISSING, 30),
    ):
        figure = picture(directory).figure()
        assert word in legend_words(figure)
        code = figure.axes[0].collections[0]
        assert (code.get_array() == CODES[name]).sum() == count
        assert code.cmap(code.norm(CODES[name]))[:3] == to_rgb(colour)


LONG = "A title that is longer than a small picture is wide, as titles in papers tend to be"
SMALL = (3.4, 2.6)


@pytest.mark.parametrize(
    ("kind", "size"),
    [*((kind, None) for kind in ("fractions", "ratio", "map", "distribution")),
     ("times", SMALL), ("fractions", SMALL)],
)  # fmt: skip
def test_nothing_lies_over_anything(sweeps, kind, size):
    select = [] if kind == "map" else ["omega_xy0=0.01"]
    title = LONG if size else "A title"
    figure = drawn(picture(sweeps / "steady", kind, select=select), title=title, size=size)
    words = [legend.get_title().get_text() for legend in figure.legends] or [figure.get_suptitle()]
    lines = words[0].splitlines()
    assert " ".join(lines).startswith(title)
    assert "" not in lines
    assert ("omega" in words[0]) == bool(select)
    for legend in figure.legends:
        box = legend.get_window_extent()
        assert figure.bbox.x0 - 1 <= box.x0
        assert box.x1 <= figure.bbox.x1 + 1
        assert box.y1 <= figure.bbox.y1 + 1
        for axes in figure.axes:
            assert not box.overlaps(axes.get_window_extent())
            assert not (axes.get_title() and box.overlaps(axes.title.get_window_extent()))
    panels = [axes for axes in figure.axes if axes.get_label() != "<colorbar>"]
    assert min(axes.get_window_extent().height for axes in panels) > 0.15 * figure.bbox.height
    for axis in (axis for axes in figure.axes if not size for axis in (axes.xaxis, axes.yaxis)):
        low, high = sorted(axis.get_view_interval())
        # Ticks outside of the view are not drawn.
        boxes = [
            tick.label1.get_window_extent()
            for tick in axis.get_major_ticks()
            if low <= tick.get_loc() <= high and tick.label1.get_visible()
        ]
        for one, other in pairwise(box for box in boxes if box.width > 1):
            assert not one.overlaps(other)


# Machado, Oliveira and Fernandes (2009), severity 1, for linear RGB.
BLIND = {
    "protan": [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216],
               [-0.003882, -0.048116, 1.051998]],
    "deutan": [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413],
               [-0.011820, 0.042940, 0.968881]],
    "tritan": [[1.255528, -0.076749, -0.178779], [-0.078411, 0.930809, 0.147602],
               [0.004733, 0.691367, 0.303900]],
}  # fmt: skip


@pytest.mark.parametrize("kind", BLIND)
def test_types_are_told_apart_by_the_colour_blind(kind):
    def lab(colour: str) -> np.ndarray:
        rgb = np.asarray(to_rgb(colour))
        linear = np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)
        seen = np.clip(np.asarray(BLIND[kind]) @ linear, 0, 1)
        xyz = np.array([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722],
                        [0.0193, 0.1192, 0.9505]]) @ seen / [0.9505, 1.0, 1.089]  # fmt: skip
        f = np.where(xyz > 0.008856, np.cbrt(xyz), 7.787 * xyz + 16 / 116)
        return np.array([116 * f[1] - 16, 500 * (f[0] - f[1]), 200 * (f[1] - f[2])])

    colours = [style[0] for style in TYPE_STYLE.values()] + [FAILED, MISSING, NO_REVERSAL]
    for k, one in enumerate(colours):
        for other in colours[:k]:
            # 2.3 is the least that anyone sees.
            assert np.linalg.norm(lab(one) - lab(other)) > 15, (one, other)
    for place in (1, 2):  # shapes and hatches
        assert len({style[place] for style in TYPE_STYLE.values()}) == len(TYPE_STYLE)


@pytest.mark.parametrize("kind", ["times", "ratio", "map"])
def test_limits_are_those_of_every_panel(sweeps, kind):
    shown = picture(sweeps / "steady", kind, x="K_r")
    figure = shown.figure(xlim=(0.01, 0.06), ylim=(0.2, 0.8), log=False)
    panels = [axes for axes in figure.axes if axes.get_label() != "<colorbar>"]
    assert len(panels) > 1
    for axes in panels:
        assert (axes.get_xlim(), axes.get_ylim()) == ((0.01, 0.06), (0.2, 0.8))
        assert axes.get_yscale() == "linear"


# -- command line ----------------------------------------------------------------------------------


def test_data_style_title_size_and_defaults(sweeps, tmp_path):
    copy = Path(shutil.copytree(sweeps / "steady", tmp_path / "steady"))
    style = tmp_path / "loud.mplstyle"
    style.write_text("font.size: 14\naxes.facecolor: yellow\n")
    before = dict(mpl.rcParams)
    for ending, more in (("csv", ()), ("parquet", ("--output", tmp_path / "p.pdf"))):
        done = invoke(
            "plot", copy, "--kind", "ratio", "--select", "K_r=0.005:0.02", "--select", "n_i=-0.5",
            "--style", style, "--title", "Steady", "--size", "5,3", "--dpi", "100",
            "--data", tmp_path / f"d.{ending}", *more,
        )  # fmt: skip
        assert done.exit_code == 0, done.stderr
    assert dict(mpl.rcParams) == before
    # Equal pictures are equal files (of SVG and PNG: test_tradeoff.py).
    assert b"CreationDate" not in (tmp_path / "p.pdf").read_bytes()
    assert matplotlib.image.imread(copy / "ratio.png").shape[:2] == (300, 500)
    svg = (copy / "ratio.svg").read_text()
    assert "yellow" in svg or "#ffff00" in svg
    # Matplotlib notes beside each text, drawn as paths, what it says.
    assert "<!-- Steady -->" in svg
    csv, parquet = pd.read_csv(tmp_path / "d.csv"), pd.read_parquet(tmp_path / "d.parquet")
    pd.testing.assert_frame_equal(csv, parquet)
    assert (set(csv["K_r"]), set(csv["n_i"])) == ({0.005, 0.02}, {-0.5})


def test_a_scatter_shows_each_reversal_once(sweeps, tmp_path, monkeypatch):
    target = tmp_path / "p.png", tmp_path / "d.parquet"
    done = invoke("plot", sweeps / "steady", "--x", "K_p", "--select", "n_i=-0.5",
                  "--output", target[0], "--data", target[1], "--dpi", 40)  # fmt: skip
    assert done.exit_code == 0, done.stderr
    assert done.stdout == f"{target[0]}\n{target[1]}\n"
    assert matplotlib.image.imread(target[0])[..., :3].std() > 0.01
    runs = rs.load(sweeps / "steady").runs
    wanted = runs[(runs["n_i"] == -0.5) & runs["t_r"].notna()][["K_p", "t_r", "omega_xy0"]]
    assert done.stderr == f"scatter: {len(wanted)} of {len(wanted)} runs that reverse\n"
    pd.testing.assert_frame_equal(pd.read_parquet(target[1]), wanted.reset_index(drop=True))
    (axes,) = picture(sweeps / "steady", "scatter").figure().axes
    *points, theory = axes.lines
    shown = np.concatenate([line.get_ydata() for line in points])
    t_r = runs["t_r"].dropna().to_numpy()
    assert sorted(shown) == sorted(t_r)
    assert theory.get_xdata().tolist() == theory.get_ydata().tolist()
    assert len(theory.get_xdata()) > 100
    # One that is large is thinned evenly.
    monkeypatch.setattr(plot_runs, "MOST_POINTS", 20)
    few: Any = picture(sweeps / "steady", "scatter", x="K_r")
    assert few.points[1] == len(t_r) > 40
    stride = 1 << (-(-len(t_r) // 20) - 1).bit_length()
    assert few.table()["t_r"].to_pylist() == t_r[::stride].tolist()


# -- any column, refined maps ----------------------------------------------------------------------


def test_a_map_of_any_column_has_its_means_and_its_unit(sweeps):
    shown = picture(sweeps / "map", "map", quantity="t_end")
    figure = drawn(shown)
    runs = rs.load(sweeps / "map").runs
    values = runs.pivot(index="n_i", columns="theta", values="t_end").to_numpy()
    np.testing.assert_allclose(figure.axes[0].collections[1].get_array(), values)
    (bar,) = [axes for axes in figure.axes if axes.get_label() == "<colorbar>"]
    assert bar.get_ylabel() == r"t_end ($\sqrt{a/g}$)"


def test_a_histogram_of_any_column_has_every_run_once(sweeps):
    runs = rs.load(sweeps / "steady").runs
    for name in ("K_p", "n_steps", "near_tangencies"):
        table = picture(sweeps / "steady", "distribution", quantity=name).table().to_pandas()
        assert table.runs.sum() == runs[name].notna().sum()
        edges = [*table[f"{name}_low"], table[f"{name}_high"].iloc[-1]]
        assert table.runs.tolist() == np.histogram(runs[name].dropna(), edges)[0].tolist()
        assert (table.runs > 0).sum() > (5 if name != "near_tangencies" else 0)
    # Counts have bins around whole numbers.
    assert table["near_tangencies_low"].iloc[0] % 1 == 0.5


def test_filled_points_are_those_of_the_nearest_run_and_between_runs():
    x, y = np.meshgrid(np.arange(9.0), np.arange(9.0), indexing="ij")
    plane, known = 2 * x + 3 * y, (x % 4 == 0) & (y % 4 == 0)
    np.testing.assert_allclose(fill(np.where(known, plane, np.nan), known), plane)
    kind = np.where(x < 4, "R", "SS")
    filled = fill(np.where(known, kind, ""), known)
    assert set(filled[:2].ravel()) == {"R"}
    assert set(filled[7:].ravel()) == {"SS"}
    # Where the nearest run has no value there is none; planes are filled apart.
    holes = fill(np.where(known & (x < 4), plane, np.nan), known)
    assert np.isnan(holes[6:]).all()
    assert np.isfinite(holes[:2]).all()
    stack = np.stack([np.where(known, plane, np.nan), np.full((9, 9), np.nan)])
    apart = fill(stack, np.stack([known, np.zeros((9, 9), bool)]))
    np.testing.assert_allclose(apart[0], plane)
    assert np.isnan(apart[1]).all()


def test_a_refined_map_is_whole_and_so_is_the_dataset(tmp_path):
    theta = {"linspace": [0.6, 0.98, 17]}
    config = {"bodies": grid(theta=theta) | {"refine": {"levels": 2}}, "model": "gh",
              "spin": spin({"linspace": [-0.6, 0.6, 18]}), "horizon": {"t": 300}}  # fmt: skip
    sweep = rs.sweep(config, output=tmp_path, threads=1)
    shown = picture(tmp_path)
    code, *_ = shown.shown()
    assert len(shown) < code.size
    assert CODES["missing"] not in code
    runs = sweep.runs
    for row in runs.itertuples():
        place = [np.argmin(np.abs(axis.values - getattr(row, axis.name))) for axis in shown.axes]
        assert code[tuple(place)] == CODES[row.type]
    whole, part = (sweep.to_xarray(["type", "t_r"], fill=fill).squeeze() for fill in (True, False))
    assert (part.type == "").sum() == code.size - len(runs)
    assert (whole.type != "").all()
    # A condition leaves out the points that are filled from runs that it does not choose.
    some, *_ = picture(tmp_path, where="n_i > 0").shown()
    assert (some == CODES["missing"]).any()
    np.testing.assert_array_equal(some[some != CODES["missing"]], code[some != CODES["missing"]])
