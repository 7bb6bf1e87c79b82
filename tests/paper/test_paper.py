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
from types import SimpleNamespace

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
from rattlesweep.integrate.follow.lyapunov import growth_along
from rattlesweep.paper import report, run, workspace
from rattlesweep.paper.data import chaos, fig7, integrators
from rattlesweep.paper.registry import FIGURES, choose
from rattlesweep.paper.run import reproduce
from rattlesweep.paper.settings import FULL, QUICK, Sizes, sweep_config
from rattlesweep.paper.symbols import symbols
from rattlesweep.paper.workspace import Workspace
from rattlesweep.sweeps.blocks.single import single_run
from rattlesweep.sweeps.config.load import load_config, resolved
from rattlesweep.sweeps.config.schema import Classify, Integrator
from rattlesweep.sweeps.tables.arrow import open_sealed
from rattlesweep.sweeps.tables.chaos import is_chaotic

ROOT = Path(__file__).parents[2]
SWEEPS = ["fig5", "fig6", "fig7"]
SMALL = Sizes(samples=4, rk4=1, rk4_least_K_r=0.05, lyapunov=15, windows=30)
CASES = 8 * 5 * 3


def quiet(share, words):
    assert 0 <= share <= 1 + 1e-12
    assert words


@pytest.fixture(autouse=True)
def handlers():
    """The command sets handlers for the process it thinks is its own."""
    before = {number: signal.getsignal(number) for number in (signal.SIGTERM, signal.SIGINT)}
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """The three figures of the sweeps, small; in the place of RK4 a kernel that is there anyway."""
    directory = tmp_path_factory.mktemp("paper")
    seen = []
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(integrators, "PAPERS", Integrator(method="dop853", tol=1e-6))
        done = reproduce(
            directory, SWEEPS, sizes=SMALL, threads=2, show=lambda *state: seen.append(state)
        )
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
    assert resolved(sweep_config(name, FULL)) == theirs


def test_the_sample_counts_are_the_papers():
    assert (FULL.fig2_bodies, FULL.fig3_bodies, FULL.fig3_density) == (10**6, 10**5, 10**8)
    assert FULL.samples == 1000
    assert len(sweep_config("steady", FULL).bodies.target.values) == 8
    assert integrators.PAPERS.dt == 0.002


def test_quick_is_smaller_and_changes_nothing_else():
    full, quick = sweep_config("steady", FULL), sweep_config("steady", QUICK)
    assert quick.bodies.samples < full.bodies.samples
    assert QUICK.fig3_density < FULL.fig3_density
    assert (quick.bodies.target, quick.spin) == (full.bodies.target, full.spin)


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
    assert (points["runs"] == SMALL.samples).all()
    for name in ("R", "SS", "SW", "unclassified"):
        counts = (runs["type"] == name).groupby(runs["case"]).sum().to_numpy()
        np.testing.assert_array_equal(points[name], counts)
        np.testing.assert_allclose(points[f"fraction_{name}"], counts / SMALL.samples)
        assert (points[f"low_{name}"] <= points[f"fraction_{name}"]).all()
        assert (points[f"high_{name}"] >= points[f"fraction_{name}"]).all()
    past = (runs["n_c1"].abs() < runs["n_i"].abs()).groupby(runs["case"]).sum().to_numpy()
    np.testing.assert_array_equal(points["bondi"], past)
    both = points["bondi"] - points["bondi_only"]
    np.testing.assert_array_equal(both, points["SS"] - points["ss_only"])


def test_the_papers_integrator_is_given_the_same_bodies(made):
    directory, _, _ = made
    rows, runs = read(directory, "fig6_rk4"), runs_of(directory, "steady")
    # Two targets of K_r from 0.05 on.
    first = runs[(runs["sample"] == 0) & (runs["case"] >= CASES * 6 // 8)].reset_index(drop=True)
    assert len(rows) == len(first) == 30
    np.testing.assert_array_equal(rows["t_r"], first["t_r"])
    assert (rows["type"] == first["type"]).all()
    # Another tolerance: close, and not the same numbers.
    off = rows["difference"].dropna().abs()
    assert (off < 1e-2).mean() > 0.9
    assert (off > 0).any()
    odd = (rows["type"] != rows["type_rk4"]) | (rows["difference"].abs() > integrators.SAME)
    np.testing.assert_array_equal(rows["exception"].notna(), odd)
    exact = rows[odd & (rows["type"] == "R")]
    np.testing.assert_allclose(exact["t_r_reference"], exact["t_r"], rtol=1e-3)


def test_a_disagreement_of_integrators_gets_its_cause():
    limits = Classify()
    r = {"type": "R", "t_r": 100.0, "amp_growth": 5.0, "n_departure": 1.0}
    late = r | {"t_r": 101.0}
    later = r | {"t_r": 102.0}
    sw = {"type": "SW", "t_r": math.nan, "amp_growth": 2.0, "n_departure": 0.0501}
    quiet = sw | {"type": "unclassified", "n_departure": 0.0499}
    assert integrators.cause(r, late, late, limits).startswith("the sweep's tolerance")
    assert integrators.cause(r, late, r, limits).startswith("RK4's step")
    assert integrators.cause(r, late, later, limits).startswith("chaotic")
    assert integrators.cause(sw, quiet, sw, limits).startswith("threshold: n_departure")
    assert integrators.cause(sw, r, r, limits).startswith("the sweep's tolerance")
    assert integrators.cause(r, r | {"type": math.nan}, r, limits).startswith("RK4 gave no result")


def test_larger_oscillations_take_ss_away(made):
    directory, _, _ = made
    rows, runs = read(directory, "fig6_basin"), runs_of(directory, "steady")
    own = runs[(runs["n_i"] == integrators.N_I) & (runs["omega_xy0"] == 0.001)]
    assert (rows["runs"] == (own["n_c1"].abs() < 0.3).sum()).all()
    assert rows["runs"].iloc[0] > 0
    np.testing.assert_array_equal(rows[["R", "SS", "SW", "unclassified"]].sum(axis=1), rows["runs"])
    assert rows["SS"].iloc[0] >= rows["SS"].iloc[-1]


def test_lyapunov_exponents_are_those_of_wobbling_runs(made):
    directory, _, _ = made
    rows, runs = read(directory, "fig6_chaos"), runs_of(directory, "steady")
    wobbling = runs[runs["type"] == "SW"]
    # Evenly thinned.
    assert len(rows) == len(wobbling.iloc[:: -(-len(wobbling) // SMALL.lyapunov)]) > 0
    np.testing.assert_array_equal(rows["chaotic"], is_chaotic(rows["lyapunov_late"], rows["t_end"]))
    assert rows.loc[~rows["chaotic"], "growth_longer"].isna().all()
    # The other way to the same number: one run alone, by its own driver.
    calm = rows[~rows["chaotic"]].iloc[0]
    own = wobbling.iloc[np.flatnonzero(~rows["chaotic"])[0] * -(-len(wobbling) // SMALL.lyapunov)]
    _, _, batch = single_run(chaos.launch_of(own))
    alone = growth_along(batch.constants[0], batch.y0[0], [calm["t_end"]], tol=1e-10)[0]
    assert calm["lyapunov"] * calm["t_end"] == pytest.approx(alone, abs=0.5)


def test_examples_are_runs_of_the_sweep(made):
    directory, _, _ = made
    runs = runs_of(directory, "steady")
    rows = read(directory, "fig6_examples")
    assert {"spin_ss", "spin_sw"} & set(rows["example"])
    for row in rows.itertuples():
        same = [np.isclose(runs["K_r"], row.K_r, rtol=2e-3)]
        same += [runs[name] == getattr(row, name) for name in ("n_i", "omega_xy0", "sample")]
        run_ = runs[np.logical_and.reduce(same)].iloc[0]
        # The trace is that run: where it is shown whole it ends where the sweep's does.
        spin = read(directory, f"fig6_{row.example}")
        assert (spin["t"].iloc[0], spin["n"].iloc[0]) == (0, row.n_i)
        if run_["t_end"] <= row.shown:
            assert spin["n"].iloc[-1] == pytest.approx(run_["n_end"], rel=0.02)


def test_the_fast_run_of_gh_swings_at_twice_the_frequency_of_the_pitch(made):
    directory, _, _ = made
    spin = read(directory, "fig5_spin")
    late = spin[spin["t"].between(30, 60)]
    # Once up through the middle each period.
    periods = [(np.diff(np.sign(late[c] - late[c].rolling(100, center=True).mean())) > 0).sum()
               for c in ("n", "omega_x")]  # fmt: skip
    assert periods[0] == pytest.approx(2 * periods[1], abs=2)
    assert read(directory, "fig5_forces")["ratio_max"].iloc[0] > 0.5


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
    assert len(again) <= SMALL.windows
    assert (again["type"] == "SW").sum() == rows["wobbling"].sum()


def test_onset_is_the_middle_of_a_window():
    loss = np.array([0.0, 0.01, 0.3, 0.2, 0.8, 0.1])
    assert fig7.first_above(loss, loss.max() / 2, 2.0) == 9.0
    assert fig7.first_above(loss, 0.05, 2.0) == 5.0
    assert math.isnan(fig7.first_above(loss, 0.9, 2.0))


def test_interval_of_a_median_covers_it_as_often_as_it_says():
    rng = np.random.default_rng(7)
    assert fig7.median_interval(rng.random(5)) == (None, None)
    for n in (6, 15, 40, 101):
        ends = np.array([fig7.median_interval(rng.exponential(size=n)) for _ in range(2000)])
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


def test_what_is_there_is_kept(made, monkeypatch):
    directory, first, _ = made
    assert first.kept == []
    before = {p: p.stat().st_mtime_ns for p in directory.glob("fig*")}

    def forbidden(*_):
        raise AssertionError("computed again")

    for name in SWEEPS:
        monkeypatch.setitem(FIGURES, name, replace(FIGURES[name], data=forbidden, draw=forbidden))
    again = reproduce(directory, SWEEPS, sizes=SMALL, threads=1)
    assert again.kept == SWEEPS
    assert again.claims == first.claims
    assert {p: p.stat().st_mtime_ns for p in directory.glob("fig*")} == before


def test_what_is_damaged_or_lacks_a_picture_is_made_again(made):
    directory, _, _ = made
    path, picture = directory / "fig5_times.parquet", directory / "fig7.svg"
    whole, drawn = path.read_bytes(), picture.read_bytes()
    path.write_bytes(whole[:-40] + bytes([whole[-40] ^ 1]) + whole[-39:])
    picture.unlink()
    again = reproduce(directory, SWEEPS, sizes=SMALL, threads=2)
    assert again.kept == ["fig6", "fig7"]
    assert path.read_bytes() == whole
    assert picture.read_bytes() == drawn


def test_data_are_of_the_code_below_them(monkeypatch, tmp_path):
    """What was edited decides what is made again: runs, tables, or pictures alone."""
    package = tmp_path / "rattlesweep"
    shutil.copytree(workspace.PACKAGE, package, ignore=shutil.ignore_patterns("__pycache__"))
    monkeypatch.setattr(workspace, "PACKAGE", package)

    def keys():
        workspace.code_key.cache_clear()
        parts = (workspace.OF_RUNS, workspace.OF_TABLES, workspace.OF_PICTURES)
        return [workspace.code_key(*part) for part in parts]

    before = keys()
    for file, changed in (
        ("paper/registry.py", [False, False, False]),
        ("paper/claims/theory.py", [False, False, False]),
        ("paper/figures/times.py", [False, False, True]),
        ("study/style.py", [False, False, True]),
        ("paper/data/fig5.py", [False, True, False]),
        ("paper/steady.yaml", [False, True, False]),
        ("physics/theory.py", [True, True, False]),
        ("integrate/lanes/events.py", [True, True, False]),
    ):
        (package / file).write_text((package / file).read_text() + "# Edited.\n")
        now = keys()
        assert [a != b for a, b in zip(before, now, strict=True)] == changed, file
        before = now
    workspace.code_key.cache_clear()


def test_sweeps_of_other_code_are_run_again(tmp_path):
    block = tmp_path / "sweeps" / "unsteady" / "runs" / "block-000000.parquet"
    times = []
    # New, the same code, another one, and runs of a version that did not record it.
    for code in (None, None, "other", "gone"):
        ws = Workspace(tmp_path, Sizes(samples=1), 2)
        if code == "gone":
            ws.record["sweeps"].clear()
        elif code is not None:
            ws.record["sweeps"]["unsteady"] = code
        ws.sweep("unsteady", quiet)
        times.append(block.stat().st_mtime_ns)
    assert times[0] == times[1] < times[2] == times[3]


def test_cases_without_a_good_run_are_points_without_numbers(monkeypatch, tmp_path):
    def hopeless(name, sizes):
        config = sweep_config(name, sizes)
        integrator = config.integrator.model_copy(update={"max_steps": 1})
        return config.model_copy(update={"integrator": integrator})

    monkeypatch.setattr(workspace, "sweep_config", hopeless)
    done = reproduce(tmp_path, ["fig7"], sizes=Sizes(samples=1), threads=2)
    late = read(tmp_path, "fig7_late")
    assert len(late) == CASES
    assert late["reversed"].sum() == read(tmp_path, "fig7_onset")["wobbling"].sum() == 0
    assert late["ratio_std"].isna().all()
    assert done.failed == CASES
    # Failures of a sweep that no chosen figure reads do not count.
    assert reproduce(tmp_path, ["theory"], sizes=Sizes(samples=1), threads=2).failed == 0


def test_pictures_do_not_depend_on_the_users_settings(made, tmp_path):
    directory, _, _ = made
    tables = {"times": pq.read_table(directory / "fig5_times.parquet")}
    pictures = []
    for changed in ({}, {"font.size": 23, "axes.facecolor": "red"}):
        ws = Workspace(tmp_path, SMALL, 1)
        ws.record["figures"]["fig5"] = {}
        with matplotlib.rc_context(changed):
            run._draw(ws, "fig5", tables)
        pictures.append((tmp_path / "fig5.png").read_bytes())
    assert pictures[0] == pictures[1]


def test_a_stop_keeps_whole_figures_and_whole_blocks(tmp_path):
    sizes = Sizes(samples=1, windows=10)

    def stop(share, words, elapsed, left):
        if words.startswith("closer"):
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        reproduce(tmp_path, ["fig5", "fig7"], sizes=sizes, threads=2, show=stop)
    assert (tmp_path / "fig5.svg").exists()
    assert not list(tmp_path.glob("fig7*"))
    assert not (tmp_path / "report.html").exists()
    assert not list(tmp_path.rglob(".*.tmp"))
    block = tmp_path / "sweeps" / "steady" / "runs" / "block-000000.parquet"
    stopped = block.stat().st_mtime_ns
    (tmp_path / ".fig6.svg.0123abcd.tmp").write_text("of a process that was killed")
    done = reproduce(tmp_path, ["fig5", "fig7"], sizes=sizes, threads=2)
    assert done.kept == ["fig5"]
    assert block.stat().st_mtime_ns == stopped
    assert not list(tmp_path.rglob(".*.tmp"))


def test_runs_are_integrated_again_when_others_are_asked_for(made, tmp_path):
    directory, _, _ = made
    runs = runs_of(directory, "steady").iloc[10:16:2]
    ws = Workspace(tmp_path, SMALL, 2)
    same = ws.again("few", runs, ("n_end", "t_r"), quiet)
    pd.testing.assert_frame_equal(same, runs[["n_end", "t_r"]])
    assert len(runs_of(tmp_path, "few")) == 3
    ws.again("few", runs[:2], ("n_end",), quiet)
    assert len(runs_of(tmp_path, "few")) == 2


def test_sweeps_of_other_sizes_are_not_overwritten(made):
    directory, _, _ = made
    before = runs_of(directory, "steady")
    with pytest.raises(ConfigError, match=r"runs of another config .*samples"):
        reproduce(directory, ["fig6"], sizes=replace(SMALL, samples=3), threads=2)
    pd.testing.assert_frame_equal(runs_of(directory, "steady"), before)


def test_progress_rises_to_one(made):
    _, _, seen = made
    shares = [share for share, *_ in seen]
    assert all(b >= a - 1e-12 for a, b in pairwise(shares))
    assert shares[-1] == pytest.approx(1)
    assert all(left is None or left >= 0 for *_, left in seen)


def test_every_claim_of_the_sweeps_is_in_the_table(made):
    directory, done, _ = made
    ids = [claim.id for claim in done.claims]
    # Too few runs of a point to tell of S8.
    assert ids == ["U1", "U2", "S1", "S2", "S3", "S4", "S5", "S6", "S7"]
    table = open_sealed((directory / "claims.parquet").read_bytes()).read()
    assert table.column("id").to_pylist() == ids
    assert set(table.column("verdict").to_pylist()) <= {"agree", "partly", "disagree"}
    for name in ("value", "low", "high"):
        values = [v for v in table.column(name).to_pylist() if v is not None]
        assert np.isfinite(values).all()


# ------------------------------------------------------------------------------- report


TEXTS = ("id", "score", "words", "where", "measured", "evidence")


class Page(HTMLParser):
    """Checks that tags are balanced; gathers text and attributes."""

    VOID = frozenset({"meta", "img", "br"})

    def __init__(self):
        super().__init__()
        self.open, self.attributes, self.text, self.tags = [], [], [], set()

    def handle_starttag(self, tag, attrs):
        self.attributes += [(tag, *pair) for pair in attrs]
        self.tags.add(tag)
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
    assert not {"script", "link", "iframe"} & page.tags
    assert not {"url(", "@import"} & set(re.findall(r"url\(|@import", data.decode()))
    images = [v for t, n, v in page.attributes if t == "img" and n == "src"]
    assert len(images) == len(SWEEPS)
    assert all(v for t, n, v in page.attributes if t == "img" and n == "alt")
    text = "".join(page.text)
    for claim in done.claims:
        assert f"\n{claim.id}" in text or claim.id in text
    assert "Reduced" in text
    for name in ("numpy", "numba", "matplotlib", "fig6", "steady"):
        assert name in text


def page_of(done, **texts):
    """The page of one claim of each verdict, with these texts."""
    claims = [SimpleNamespace(verdict=verdict, **texts) for verdict in report.VERDICTS]
    return parsed(report.page(replace(done, claims=claims), []))


def test_text_is_never_taken_for_markup(made):
    bad = '<script>alert("1")</script>&'
    page = page_of(made[1], **dict.fromkeys(TEXTS, bad))
    assert "script" not in page.tags
    assert "".join(page.text).count(bad) == 3 * len(TEXTS)


def test_verdicts_do_not_rely_on_colour(made):
    text = "".join(page_of(made[1], **dict.fromkeys(TEXTS, "")).text)
    assert all(sign in text for sign in ("✓ agree", "◐ partly", "✗ disagree"))


def test_symbols_are_set_and_names_of_files_are_not():
    text = "abs(n_i) >~ 0.3: t_rGH- -> K_r, omega_p^2 (fig6_rk4.parquet), 2.0e-3 K_p."
    assert symbols(text) == (
        "|<i>n</i><sub>i</sub>| ≳ 0.3: <i>t</i><sub>rGH-</sub> → <i>K</i><sub>r</sub>, "
        "<i>ω</i><sub>p</sub><sup>2</sup> (fig6_rk4.parquet), 2.0e-3 <i>K</i><sub>p</sub>."
    )


# ------------------------------------------------------------------------------ command


@pytest.fixture
def small(monkeypatch):
    monkeypatch.setattr("rattlesweep.paper.settings.QUICK", Sizes(samples=1))


def test_the_command_makes_what_is_asked_for(small, tmp_path):
    done = invoke("--quick", "--only", "fig5", "--output", tmp_path / "out")
    assert done.exit_code == 0
    assert {line.split()[0] for line in done.stdout.splitlines()} <= {"U1", "U2"}
    assert "report.html" in done.stderr
    assert sorted(p.name for p in (tmp_path / "out").iterdir()) == [
        "claims.parquet", "fig5.png", "fig5.svg", "fig5_forces.parquet", "fig5_spin.parquet",
        "fig5_times.parquet", "paper.json", "report.html", "sweeps",
    ]  # fmt: skip
    record = json.loads((tmp_path / "out" / "paper.json").read_text())
    assert record["threads"] == available_threads()
    assert record["settings"]["unsteady"]["bodies"]["samples"] == 1


def test_the_command_refuses_in_one_sentence(tmp_path):
    wrong = invoke("--only", "fgi6", "--output", tmp_path / "o")
    assert wrong.exit_code == 2
    assert wrong.stderr.count("\n") == 1
    assert not (tmp_path / "o").exists()
    file = tmp_path / "file"
    file.write_text("")
    full = invoke("--quick", "--only", "fig5", "--output", file)
    assert full.exit_code == 1
    assert full.stderr.startswith("error: cannot write in")


def test_ctrl_c_ends_the_command_with_130(tmp_path, monkeypatch):
    def interrupted(*args, **kwargs):
        raise KeyboardInterrupt

    monkeypatch.setattr(run, "reproduce", interrupted)
    stopped = invoke("--output", tmp_path)
    assert stopped.exit_code == 130
    assert "completed work is kept" in stopped.stderr


@pytest.mark.slow
def test_the_full_size_says_of_the_paper_what_the_readme_says(tmp_path):
    """Minutes: 240,000 runs, RK4, and Lyapunov exponents of what wobbles."""
    done = reproduce(tmp_path, SWEEPS, threads=available_threads())
    verdicts = {claim.id: claim.verdict for claim in done.claims}
    assert verdicts == {
        "U1": "partly", "U2": "partly", "S1": "agree", "S2": "partly", "S3": "agree",
        "S4": "partly", "S5": "partly", "S6": "partly", "S7": "partly", "S8": "agree",
    }  # fmt: skip
    rk4 = read(tmp_path, "fig6_rk4")
    assert len(rk4) == 1200
    assert (rk4["type"] == rk4["type_rk4"]).all()
    assert done.failed == 0
