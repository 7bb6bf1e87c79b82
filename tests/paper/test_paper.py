"""The command `paper`: settings, the sweeps' figures, claims, report, stops."""

from __future__ import annotations

import json
import math
import re
import shutil
import signal
from dataclasses import replace
from html.parser import HTMLParser
from itertools import pairwise
from pathlib import Path

import matplotlib
import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from click.testing import CliRunner
from matplotlib.image import imread

from rattlesweep import cli
from rattlesweep.errors import ConfigError
from rattlesweep.integrate.batch import available_threads
from rattlesweep.paper import run, sources
from rattlesweep.paper.figures import onset
from rattlesweep.paper.figures.registry import FIGURES, choose
from rattlesweep.paper.figures.steady_checks import cause
from rattlesweep.paper.run import make_paper
from rattlesweep.paper.settings import load_paper, shipped
from rattlesweep.paper.sweeps import Place
from rattlesweep.paper.symbols import symbols
from rattlesweep.study import html
from rattlesweep.sweeps.config.load import load_config, resolved
from rattlesweep.sweeps.config.schema import Classify
from rattlesweep.sweeps.tables.arrow import open_sealed

ROOT = Path(__file__).parents[2]
SWEEPS = ["fig5", "fig6", "fig7"]
SMALL = """\
unsteady:
  seed: 5
  bodies: {source: sd, samples: 12, target: {K_p: [0.26, 0.78, 1.35], rel_tol: 1e-2}}
  spin: {n_i: [0.1, 0.2, 0.3, 0.5], omega_xy0: [0.01, 0.1]}
  horizon: {t_rgh: 50}
steady:
  seed: 5
  bodies: {source: sd, samples: 12, target: {K_r: [0.02, 0.05, 0.1], rel_tol: 1e-2}}
  spin: {n_i: [-0.1, -0.3, -0.5], omega_xy0: [0.001, 0.1]}
  horizon: {t_rgh: 5}
fig6:
  rk4: {samples: 1, dt: 0.01, least_K_r: 0.04}
  basin: {n_i: -0.5, omega_xy0: [0.01, 0.1]}
  examples:
    ss: {n_i: -0.5, omega_xy0: 0.001}
    sw: {n_i: -0.3, omega_xy0: 0.1}
    chaotic: {K_r: 0.02, n_i: -0.5}
    t_end: 500
  lyapunov: 50
fig7: {late: 2, closer: 50}
"""


@pytest.fixture(autouse=True)
def handlers():
    """The command sets handlers for the process it thinks is its own."""
    before = {number: signal.getsignal(number) for number in (signal.SIGTERM, signal.SIGINT)}
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


@pytest.fixture(scope="module")
def config(tmp_path_factory):
    path = tmp_path_factory.mktemp("config") / "paper.yaml"
    path.write_text(SMALL)
    return path


@pytest.fixture(scope="module")
def made(config, tmp_path_factory):
    """The three figures of the sweeps, small."""
    directory = tmp_path_factory.mktemp("paper")
    seen = []
    done = make_paper(load_paper(config), directory, SWEEPS, threads=2, report=seen.append)
    return directory, done, seen


def invoke(*args):
    result = CliRunner().invoke(cli.main, ["paper", *map(str, args)])
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    assert "Traceback" not in result.output
    return result


def read(directory, name):
    return pq.read_table(directory / f"{name}.parquet").to_pandas()


def runs_of(directory, sweep):
    files = sorted((directory / "sweeps" / sweep / "runs").glob("*.parquet"))
    return pd.concat([pd.read_parquet(file) for file in files], ignore_index=True)


# ------------------------------------------------------------------------------- settings


@pytest.mark.parametrize("name", ["unsteady", "steady"])
def test_the_sweeps_are_those_of_the_shipped_configs(name):
    theirs = resolved(load_config(ROOT / "configs" / f"{name}.yaml"))
    ours = resolved(getattr(load_paper(), name))
    assert ours == theirs


def test_the_sample_counts_are_the_papers():
    paper = load_paper()
    assert paper.fig2.samples == 10**6
    assert paper.fig3.samples == 10**5
    assert paper.fig3.density_samples == 10**8
    assert paper.unsteady.bodies.samples == paper.steady.bodies.samples == 1000
    assert len(paper.steady.bodies.target.values) == 8
    assert paper.fig6.rk4.dt == 0.002


def test_quick_is_smaller_and_changes_nothing_else():
    full, quick = load_paper(), load_paper().quick()
    assert quick.steady.bodies.samples < full.steady.bodies.samples
    assert quick.fig3.density_samples < full.fig3.density_samples
    assert quick.steady.bodies.target == full.steady.bodies.target
    assert quick.steady.spin == full.steady.spin
    assert full == load_paper()


def test_a_file_replaces_the_sections_that_it_has(tmp_path):
    path = tmp_path / "p.yaml"
    path.write_text("fig7: {late: 3, closer: 10}\n")
    changed = load_paper(path)
    assert changed.fig7.late == 3
    assert changed.model_copy(update={"fig7": load_paper().fig7}) == load_paper()


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("fig7: {late: 3, closr: 10}\n", r"p.yaml:1:17: fig7.closr: .*did you mean \"closer\""),
        ("fig7:\n  late: -1\n  closer: 1\n", r"p.yaml:2:3: fig7.late: .*above 0"),
        ("fgi7: {}\n", r"p.yaml:1:1: fgi7: .*did you mean \"fig7\""),
        ("", r"p.yaml:1:1: the file is empty"),
        ("- 1\n", r"p.yaml:1:1: a list found where a mapping is needed"),
        ("fig7: {late: 1, late: 2}\n", r"p.yaml:1:17: fig7.late: the key is repeated"),
        (
            "steady:\n  bodies: {source: sd, samples: 1}\n  spin: {n_i: -0.1, omega_xy0: 0.1}\n",
            r"p.yaml:1:1: steady: bodies must be of source sd and have a target K_r",
        ),
        (SMALL.replace("n_i: [-0.1, -0.3", "n_i: [0.1, -0.3"),
         r"p.yaml:6:1: steady: every spin.n_i must be negative"),
        (SMALL.replace("samples: 12, target: {K_p", "samples: x, target: {K_p"),
         r"p.yaml:3:\d+: unsteady.bodies.samples: .*whole number"),
    ],
)  # fmt: skip
def test_what_is_wrong_in_a_file_is_named(text, said, tmp_path):
    path = tmp_path / "p.yaml"
    path.write_text(text)
    with pytest.raises(ConfigError) as caught:
        load_paper(path)
    assert re.search(said, str(caught.value)), str(caught.value)


def test_names_are_chosen_in_the_papers_order():
    assert choose("fig7, fig5") == ["fig5", "fig7"]
    assert choose(None)[-1] == "theory"
    with pytest.raises(ConfigError, match=r'"fgi6" is not one of .*did you mean "fig6"'):
        choose("fgi6")
    with pytest.raises(ConfigError, match="--only"):
        choose(" ,")


# ---------------------------------------------------------------------------- the figures


def test_points_of_figs_5_and_7_are_means_of_the_stored_runs(made):
    directory, _, _ = made
    for figure, sweep, name in (("fig5", "unsteady", "K_p"), ("fig7", "steady", "K_r")):
        runs = runs_of(directory, sweep)
        points = read(directory, f"{figure}_times")
        cases = runs.groupby("case")
        assert len(points) == cases.ngroups
        back = runs[runs["type"] == "R"].groupby("case")["t_r"]
        np.testing.assert_array_equal(points["reversed"], back.size())
        np.testing.assert_allclose(points["t_r_mean"], back.mean(), rtol=1e-13)
        np.testing.assert_allclose(points["t_r_std"], back.std(), rtol=1e-10)
        # The paper's own form of its formula (Eqs. (56), (58)), with the mean n_0.
        n_0, n = cases["n_0"].mean().to_numpy(), points["n_i"].abs().to_numpy()
        line = np.log((n_0 + n) / (n_0 - n)) / (n_0 * points[name].to_numpy())
        np.testing.assert_allclose(points["t_rgh_line"], line, rtol=1e-9)
        # The line is beside the mean of the runs' own times.
        np.testing.assert_allclose(line, cases["t_rgh"].mean(), rtol=0.02)


def test_fractions_of_fig_6_are_counts_of_the_stored_runs(made):
    directory, _, _ = made
    runs = runs_of(directory, "steady")
    points = read(directory, "fig6_fractions")
    assert (points["runs"] == 12).all()
    for name in ("R", "SS", "SW", "unclassified"):
        counts = (runs["type"] == name).groupby(runs["case"]).sum().to_numpy()
        np.testing.assert_array_equal(points[name], counts)
        np.testing.assert_allclose(points[f"fraction_{name}"], counts / 12)
        assert (points[f"low_{name}"] <= points[f"fraction_{name}"]).all()
        assert (points[f"high_{name}"] >= points[f"fraction_{name}"]).all()
    past = (runs["n_c1"].abs() < runs["n_i"].abs()).groupby(runs["case"]).sum().to_numpy()
    np.testing.assert_array_equal(points["bondi"], past)
    both = points["bondi"] - points["bondi_only"]
    np.testing.assert_array_equal(both, points["SS"] - points["ss_only"])


def test_rk4_integrates_the_same_bodies(made):
    directory, _, _ = made
    rows, runs = read(directory, "fig6_rk4"), runs_of(directory, "steady")
    # Two K_r from 0.04 on, six launches each.
    assert len(rows) == 2 * 6
    first = runs[(runs["sample"] == 0) & (runs["case"] >= 6)].reset_index(drop=True)
    np.testing.assert_array_equal(rows["t_r"], first["t_r"])
    assert (rows["type"] == first["type"]).all()
    assert (rows["type"] == rows["type_rk4"]).all()
    # Another method with another step: close, and not the same numbers.
    off = rows["difference"].dropna().abs()
    assert len(off) == first["t_r"].notna().sum()
    assert (off < 1e-4).all()
    assert (off > 0).any()


def test_a_disagreement_of_integrators_gets_its_cause():
    limits = Classify()
    r = {"type": "R", "t_r": 100.0, "amp_growth": 5.0, "n_departure": 1.0}
    late = r | {"t_r": 101.0}
    later = r | {"t_r": 102.0}
    sw = {"type": "SW", "t_r": math.nan, "amp_growth": 2.0, "n_departure": 0.0501}
    quiet = sw | {"type": "unclassified", "n_departure": 0.0499}
    assert cause(r, late, late, limits).startswith("the sweep's tolerance")
    assert cause(r, late, r, limits).startswith("RK4's step")
    assert cause(r, late, later, limits).startswith("chaotic")
    assert cause(sw, quiet, sw, limits).startswith("threshold: n_departure")
    assert cause(sw, r, r, limits).startswith("the sweep's tolerance")
    assert cause(r, r | {"type": math.nan}, r, limits).startswith("RK4 gave no result")


def test_larger_oscillations_take_ss_away(made):
    directory, _, _ = made
    rows = read(directory, "fig6_basin")
    runs = runs_of(directory, "steady")
    own = runs[(runs["n_i"] == -0.5) & (runs["omega_xy0"] == 0.001)]
    assert (rows["runs"] == (own["n_c1"].abs() < 0.5).sum()).all()
    assert rows["runs"].iloc[0] > 0
    np.testing.assert_array_equal(rows[["R", "SS", "SW", "unclassified"]].sum(axis=1), rows["runs"])
    assert rows["SS"].iloc[0] >= rows["SS"].iloc[1]


def test_readings_of_ss_contain_each_other(made):
    directory, _, _ = made
    rows = read(directory, "fig6_definitions")
    runs = runs_of(directory, "steady")
    for (n_i, size), own in rows.groupby(["n_i", "omega_xy0"]):
        counts = own["count"].to_numpy()
        # Growth at most the threshold, 1 %, 10 %, 30 %; then departures 1 %, 2 %, 5 %.
        assert (np.diff(counts[:4]) >= 0).all()
        assert (np.diff(counts[4:7]) >= 0).all()
        chosen = runs[(runs["n_i"] == n_i) & (runs["omega_xy0"] == size)]
        assert counts[0] == (chosen["type"] == "SS").sum()
        assert (own["runs"] == len(chosen)).all()


def test_onsets_lie_between_launch_and_horizon(made):
    directory, _, _ = made
    rows, runs = read(directory, "fig7_onset"), runs_of(directory, "steady")
    wobbling = (runs["type"] == "SW").groupby(runs["case"]).sum().to_numpy()
    assert (rows["wobbling"] <= wobbling).all()
    assert rows["wobbling"].sum() > 0
    found = rows.dropna(subset=["onset_median"])
    assert (found["onset_median"] > 0).all()
    assert (found["onset_median"] < 5 * found["t_rgh_median"] * 1.5).all()
    # The same bodies integrated again are the same: as many SW in all, thinned alike.
    again = runs_of(directory, "closer")
    assert len(again) <= 50
    assert (again["type"] == "SW").sum() == rows["wobbling"].sum()


def test_onset_is_the_middle_of_a_window():
    loss = np.array([0.0, 0.01, 0.3, 0.2, 0.8, 0.1])
    assert onset.first_above(loss, loss.max() / 2, 2.0) == 9.0
    assert onset.first_above(loss, 0.05, 2.0) == 5.0
    assert math.isnan(onset.first_above(loss, 0.9, 2.0))


def test_interval_of_a_median_covers_it_as_often_as_it_says():
    rng = np.random.default_rng(7)
    assert onset.median_interval(rng.random(5)) == (None, None)
    for n in (6, 15, 40, 101):
        ends = np.array([onset.median_interval(rng.exponential(size=n)) for _ in range(2000)])
        covered = np.mean((ends[:, 0] < math.log(2)) & (ends[:, 1] > math.log(2)))
        # 2000 trials: a standard error of half a percent.
        assert 0.93 < covered < 0.995


def test_pictures_are_pictures(made):
    directory, _, _ = made
    for name in SWEEPS:
        image = imread(directory / f"{name}.png")
        assert image.shape[0] > 500
        assert 0.5 < image[..., :3].mean() < 0.999
        svg = (directory / f"{name}.svg").read_text()
        assert svg.count("<g id=") > 50
        assert 'href="http' not in svg


def test_example_spins_are_drawn_where_they_are_given(made):
    """Parts (b) of Figs. 5 and 6 are tables of t and n; the figures grow by them."""
    directory, _, _ = made
    t = np.linspace(0, 50, 400)
    spin = pa.table({"t": t, "n": np.cos(t)})
    five = {"times": pq.read_table(directory / "fig5_times.parquet")}
    plain, more = FIGURES["fig5"].draw(five), FIGURES["fig5"].draw({**five, "spin": spin})
    assert sum(a.axison for a in more.axes) == sum(a.axison for a in plain.axes) + 1
    six = {"fractions": pq.read_table(directory / "fig6_fractions.parquet")}
    names = ("spin_ss", "spin_sw", "spin_chaotic")
    plain = FIGURES["fig6"].draw(six)
    more = FIGURES["fig6"].draw({**six, **dict.fromkeys(names, spin)})
    assert len(more.axes) == len(plain.axes) + 3


# ----------------------------------------------------------------------- stops, resumption


def test_what_is_there_is_kept(made, config, monkeypatch):
    directory, first, _ = made
    assert first.kept == []
    before = {p: p.stat().st_mtime_ns for p in directory.glob("fig*")}

    def forbidden(place, report):
        raise AssertionError("computed again")

    with monkeypatch.context() as patch:
        for name in SWEEPS:
            patch.setitem(run.FIGURES, name, replace(FIGURES[name], compute=forbidden))
        again = make_paper(load_paper(config), directory, SWEEPS, threads=1)
    assert again.kept == SWEEPS
    assert again.claims == first.claims
    assert {p: p.stat().st_mtime_ns for p in directory.glob("fig*")} == before


def test_what_is_damaged_or_of_other_settings_is_made_again(made, config, tmp_path):
    directory, _, _ = made
    paper = load_paper(config)
    path = directory / "fig5_times.parquet"
    whole = path.read_bytes()
    path.write_bytes(whole[:-40] + bytes([whole[-40] ^ 1]) + whole[-39:])
    again = make_paper(paper, directory, SWEEPS, threads=2)
    assert again.kept == ["fig6", "fig7"]
    assert path.read_bytes() == whole
    assert run.figure_key(paper, "fig5") == run.figure_key(paper, "fig5")
    other = paper.model_copy(update={"fig7": paper.fig7.model_copy(update={"late": 3.0})})
    changed = [n for n in SWEEPS if run.figure_key(paper, n) != run.figure_key(other, n)]
    assert changed == ["fig7"]


def test_sentences_and_pictures_do_not_cost_data_but_formulas_do(monkeypatch, tmp_path):
    """The key of a figure follows the code below it, edited here in a copy of the package."""
    package = tmp_path / "rattlesweep"
    shutil.copytree(sources.PACKAGE, package, ignore=shutil.ignore_patterns("__pycache__"))
    monkeypatch.setattr(sources, "PACKAGE", package)

    def keys(name="fig5"):
        sources._bare.cache_clear()
        return tuple(sources.code_key.__wrapped__(name, pictures=p) for p in (False, True))

    def edit(file, old, new):
        text = (package / file).read_text()
        assert old in text
        (package / file).write_text(text.replace(old, new, 1))

    data, picture = keys()
    edit("paper/claims/table.py", "within a factor 1.26 of", "near")
    edit("paper/figures/registry.py", "Mean over", "The mean over")
    edit("physics/theory.py", '"""', '"""Edited. ')
    edit("paper/figures/times.py", "    ", "    # Edited.\n    ")
    assert keys() == (data, picture)
    edit("paper/style.py", "labelsize=9", "labelsize=8")
    assert keys()[0] == data
    assert keys()[1] != picture
    edit("physics/theory.py", "    return ", "    return 1 * ")
    assert keys()[0] != data
    sweeps = keys("sweeps")
    edit("integrate/lanes/events.py", "    return ", "    return 1 * ")
    assert keys("sweeps") != sweeps
    sources._bare.cache_clear()


def test_sweeps_of_other_code_are_run_again(config, tmp_path):
    paper = load_paper(config)
    few = paper.unsteady.model_copy(
        update={"bodies": paper.unsteady.bodies.model_copy(update={"samples": 2})}
    )
    paper = paper.model_copy(update={"unsteady": few})
    block = tmp_path / "sweeps" / "unsteady" / "runs" / "block-000000.parquet"
    codes, times = {}, []
    # New, the same code, another one, and runs of a version that did not record it.
    for code in (None, None, "other", "gone"):
        if code == "gone":
            codes.clear()
        elif code is not None:
            codes["unsteady"] = code
        Place(paper, tmp_path, 2, codes).sweep("unsteady", lambda fraction, text: None)
        times.append(block.stat().st_mtime_ns)
    assert times[0] == times[1] < times[2] == times[3]
    assert codes == {}


def test_cases_without_a_good_run_are_points_without_numbers(config, tmp_path):
    paper = load_paper(config)
    hopeless = paper.steady.model_copy(
        update={"integrator": paper.steady.integrator.model_copy(update={"max_steps": 1})}
    )
    settings = paper.model_copy(update={"steady": hopeless})
    done = make_paper(settings, tmp_path, ["fig7"], threads=2)
    late = read(tmp_path, "fig7_late")
    assert len(late) == 18
    assert late["reversed"].sum() == read(tmp_path, "fig7_onset")["wobbling"].sum() == 0
    assert late["ratio_std"].isna().all()
    assert done.failed == 18 * 12
    # Failures of a sweep that no chosen figure reads do not count.
    assert make_paper(settings, tmp_path, ["theory"], threads=2).failed == 0


def test_pictures_do_not_depend_on_the_users_settings(made):
    directory, _, _ = made
    tables = {"times": pq.read_table(directory / "fig5_times.parquet")}
    record = {"figures": {"fig5": {}}}
    pictures = []
    for size in (10, 23):
        with matplotlib.rc_context(
            {"font.size": size, "axes.facecolor": "red"} if size > 10 else {}
        ):
            run._draw(directory.parent, record, "fig5", tables)
        pictures.append((directory.parent / "fig5.png").read_bytes())
    assert pictures[0] == pictures[1]


def test_a_stop_keeps_whole_figures_and_whole_blocks(config, tmp_path):
    paper = load_paper(config)

    def stop_in_rk4(progress):
        if progress.text.startswith("rk4"):
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        make_paper(paper, tmp_path, SWEEPS, threads=2, report=stop_in_rk4)
    assert (tmp_path / "fig5.svg").exists()
    assert not list(tmp_path.glob("fig6*"))
    assert not (tmp_path / "report.html").exists()
    assert not list(tmp_path.rglob(".*"))
    stopped = (tmp_path / "sweeps" / "steady" / "runs" / "block-000000.parquet").stat()
    (tmp_path / ".fig6.svg.0123abcd.tmp").write_text("of a process that was killed")
    done = make_paper(paper, tmp_path, SWEEPS, threads=2)
    assert done.kept == ["fig5"]
    now = (tmp_path / "sweeps" / "steady" / "runs" / "block-000000.parquet").stat()
    assert now.st_mtime_ns == stopped.st_mtime_ns
    assert not list(tmp_path.rglob(".*"))


def test_derived_sweeps_give_way_when_their_bodies_change(config, tmp_path):
    paper = load_paper(config)
    fewer = paper.model_copy(update={"fig7": paper.fig7.model_copy(update={"closer": 5})})
    counts = []
    for settings in (paper, fewer):
        FIGURES["fig7"].compute(Place(settings, tmp_path, 2), lambda fraction, text: None)
        counts.append(len(runs_of(tmp_path, "closer")))
    assert counts[1] <= 5 < counts[0]


def test_sweeps_of_other_settings_are_not_overwritten(config, made):
    directory, _, _ = made
    paper = load_paper(config)
    other = paper.model_copy(update={"steady": paper.steady.model_copy(update={"seed": 6})})
    before = runs_of(directory, "steady")
    with pytest.raises(ConfigError, match=r"runs of another config .*seed"):
        make_paper(other, directory, ["fig6"], threads=2)
    pd.testing.assert_frame_equal(runs_of(directory, "steady"), before)


def test_progress_rises_to_one(made):
    _, _, seen = made
    fractions = [p.fraction for p in seen]
    assert all(b >= a - 1e-12 for a, b in pairwise(fractions))
    assert fractions[-1] == pytest.approx(1)
    assert all(p.left is None or p.left >= 0 for p in seen)


# ------------------------------------------------------------------------------- claims


def test_every_claim_of_the_sweeps_is_in_the_table(made):
    directory, done, _ = made
    ids = [claim.id for claim in done.claims]
    assert ids == ["U1", "U2", "S1", "S2", "S3", "S4", "S5", "S6", "S7", "S8"]
    table = open_sealed((directory / "claims.parquet").read_bytes()).read()
    assert table.column("id").to_pylist() == ids
    assert set(table.column("verdict").to_pylist()) <= {"agree", "partly", "disagree"}
    for name in ("value", "low", "high"):
        values = [v for v in table.column(name).to_pylist() if v is not None]
        assert np.isfinite(values).all()


# ------------------------------------------------------------------------------- report


class Page(HTMLParser):
    """Checks that tags are balanced; gathers text and attributes."""

    VOID = frozenset({"meta", "img", "br"})

    def __init__(self):
        super().__init__()
        self.open, self.attributes, self.text = [], [], []

    def handle_starttag(self, tag, attrs):
        self.attributes += [(tag, *pair) for pair in attrs]
        if tag not in self.VOID:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.text.append(data)


def parsed(data):
    page = Page()
    page.feed(data.decode())
    page.close()
    assert page.open == []
    return page


def test_the_report_is_one_file_that_asks_for_nothing(made):
    directory, done, _ = made
    data = (directory / "report.html").read_bytes()
    assert len(data) < 5_000_000
    page = parsed(data)
    for _, name, value in page.attributes:
        if name in ("src", "href"):
            assert value.startswith(("data:image/", "#"))
    assert not {"script", "link", "iframe"} & {tag for tag, _, _ in page.attributes}
    assert "url(" not in html.STYLE
    assert "@import" not in html.STYLE
    images = [v for t, n, v in page.attributes if t == "img" and n == "src"]
    assert len(images) == len(SWEEPS)
    assert all(v for t, n, v in page.attributes if t == "img" and n == "alt")
    text = "".join(page.text)
    for claim in done.claims:
        assert f"\n{claim.id}" in text or claim.id in text
    assert "Reduced" not in text
    for name in ("numpy", "numba", "matplotlib", "fig6", "steady"):
        assert name in text


def test_text_is_never_taken_for_markup():
    bad = '<script>alert("1")</script>&'
    data = html.page(
        bad,
        [html.paragraph(bad)],
        [("a", bad, html.table([bad], [[bad], [html.key(bad)], [html.number(bad)]]))],
    )
    page = parsed(data)
    assert "<script" not in data.decode()
    assert "".join(page.text).count(bad) == 9
    assert bad in "".join(parsed(symbols(bad).text.encode()).text)


def test_verdicts_do_not_rely_on_colour():
    marks = {word: html.mark(word).text for word in ("agree", "partly", "disagree")}
    signs = {re.sub("<[^>]*>", "", text) for text in marks.values()}
    assert signs == {"✓ agree", "◐ partly", "✗ disagree"}


def test_symbols_are_set_and_names_of_files_are_not():
    text = "abs(n_i) >~ 0.3: t_rGH- -> K_r, omega_p^2 (fig6_rk4.parquet), 2.0e-3 K_p."
    assert symbols(text).text == (
        "|<i>n</i><sub>i</sub>| ≳ 0.3: <i>t</i><sub>rGH-</sub> → <i>K</i><sub>r</sub>, "
        "<i>ω</i><sub>p</sub><sup>2</sup> (fig6_rk4.parquet), 2.0e-3 <i>K</i><sub>p</sub>."
    )


# ------------------------------------------------------------------------------ command


def test_the_command_makes_what_is_asked_for(config, tmp_path):
    done = invoke("--config", config, "--only", "fig5", "--output", tmp_path / "out")
    assert done.exit_code == 0
    assert [line.split()[0] for line in done.stdout.splitlines()] == ["U1", "U2"]
    assert "report.html" in done.stderr
    assert sorted(p.name for p in (tmp_path / "out").iterdir()) == [
        "claims.parquet", "fig5.png", "fig5.svg", "fig5_forces.parquet", "fig5_spin.parquet",
        "fig5_times.parquet", "paper.json", "report.html", "sweeps",
    ]  # fmt: skip
    record = json.loads((tmp_path / "out" / "paper.json").read_text())
    assert record["threads"] == available_threads()
    assert record["settings"]["unsteady"]["bodies"]["samples"] == 12


def test_the_command_refuses_in_one_sentence(config, tmp_path):
    wrong = invoke("--only", "fgi6", "--output", tmp_path / "o")
    assert wrong.exit_code == 2
    assert wrong.stderr.count("\n") == 1
    assert not (tmp_path / "o").exists()
    file = tmp_path / "file"
    file.write_text("")
    full = invoke("--config", config, "--only", "fig5", "--output", file)
    assert full.exit_code == 1
    assert full.stderr.startswith("error: cannot write in")
    assert invoke("--config", tmp_path / "none.yaml").exit_code == 2


def test_ctrl_c_ends_the_command_with_130(config, tmp_path, monkeypatch):
    def interrupted(*args, **kwargs):
        raise KeyboardInterrupt

    monkeypatch.setattr(run, "make_paper", interrupted)
    stopped = invoke("--config", config, "--output", tmp_path)
    assert stopped.exit_code == 130
    assert "completed work is kept" in stopped.stderr


def test_the_shipped_settings_are_printed(tmp_path):
    done = invoke("--print-config")
    assert done.exit_code == 0
    assert done.stdout == shipped()
    (tmp_path / "p.yaml").write_text(done.stdout)
    assert load_paper(tmp_path / "p.yaml") == load_paper()


@pytest.mark.slow
def test_the_full_size_says_of_the_paper_what_the_readme_says(tmp_path):
    """Minutes: 240,000 runs, RK4, and Lyapunov exponents of what wobbles."""
    done = make_paper(load_paper(), tmp_path, SWEEPS, threads=available_threads())
    verdicts = {claim.id: claim.verdict for claim in done.claims}
    assert verdicts == {
        "U1": "partly", "U2": "partly", "S1": "agree", "S2": "partly", "S3": "agree",
        "S4": "partly", "S5": "partly", "S6": "partly", "S7": "partly", "S8": "agree",
    }  # fmt: skip
    rk4 = read(tmp_path, "fig6_rk4")
    assert len(rk4) == 1200
    assert (rk4["type"] == rk4["type_rk4"]).all()
    assert done.failed == 0
