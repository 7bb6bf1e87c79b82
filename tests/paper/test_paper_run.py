"""The command `paper`: settings, one small run of the sweeps' figures, stops, report."""

from __future__ import annotations

import json
import math
import os
import re
import shutil
from dataclasses import replace
from html import unescape
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import sketch
from matplotlib.image import imread
from refusal import assert_refused
from sweeping import invoke
from telling import quiet

from rattlesweep.errors import ConfigError
from rattlesweep.integrate.batch import available_threads
from rattlesweep.integrate.follow.lyapunov import growth_along
from rattlesweep.paper import drawing, report, run, workspace
from rattlesweep.paper.drawing import Artist
from rattlesweep.paper.figures import chaos, fig6, fig7, integrators
from rattlesweep.paper.registry import FIGURES, choose, needed
from rattlesweep.paper.report import symbols
from rattlesweep.paper.run import reproduce
from rattlesweep.paper.workspace import FULL, QUICK, Figure, Sizes, Workspace, sweep_config
from rattlesweep.sweeps.single import single_run
from rattlesweep.sweeps.config.read import load_config, resolved
from rattlesweep.sweeps.config.schema import Classify
from rattlesweep.sweeps.files import replace_file
from rattlesweep.sweeps.arrow import encode, open_sealed
from rattlesweep.sweeps.types import is_chaotic

ROOT = Path(__file__).parents[2]
SWEEPS = ["fig5", "fig6", "fig7"]
SMALL = Sizes(samples=4, rk4=1, rk4_least_K_r=0.05, lyapunov=15, windows=30)
CASES = 8 * 5 * 3


class Here(Artist):
    """Draws in this process: a second less for each command."""

    def __init__(self, directory, wanted):
        super().__init__(directory, wanted=False)

    def draw(self, name, figure, tables):
        function = figure.draw
        drawing.draw_here(self._directory, name, tables, function.__module__, function.__name__)


@pytest.fixture
def here(monkeypatch):
    monkeypatch.setattr(run, "Artist", Here)


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """The three figures of the sweeps, small; in the place of RK4 a kernel that is there anyway."""
    directory = tmp_path_factory.mktemp("paper")
    seen = []
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(integrators, "PAPERS", {"method": "dop853", "tol": 1e-6})
        patch.setattr(run, "Artist", Here)
        patch.setattr(drawing, "DPI", 60)
        done = reproduce(
            directory, SWEEPS, sizes=SMALL, threads=2, show=lambda *state: seen.append(state)
        )
    return SimpleNamespace(
        directory=directory, done=done, seen=seen,
        **{name: runs_of(directory, name) for name in ("steady", "unsteady", "closer")},
        table=lambda name: pq.read_table(directory / f"{name}.parquet").to_pandas(),
    )  # fmt: skip


def runs_of(directory, sweep):
    files = sorted((directory / "sweeps" / sweep / "runs").glob("*.parquet"))
    return pd.concat([pd.read_parquet(file) for file in files], ignore_index=True)


# ------------------------------------------------------------------------------- settings


@pytest.mark.parametrize("name", ["unsteady", "steady"])
def test_the_sweeps_are_those_of_the_shipped_configs(name):
    theirs = resolved(load_config(ROOT / "configs" / f"{name}.yaml"))
    assert resolved(sweep_config(name, FULL)) == theirs
    assert resolved(sweep_config(name, QUICK)) | {"bodies": 0} == theirs | {"bodies": 0}


def test_the_sample_counts_are_the_papers():
    assert (FULL.fig2_bodies, FULL.fig3_bodies, FULL.fig3_density) == (10**6, 10**5, 10**8)
    assert FULL.samples == 1000
    assert len(sweep_config("steady", FULL).bodies.target.values) == 8
    assert integrators.PAPERS == {"method": "rk4", "dt": 0.002}


def test_names_are_chosen_in_the_papers_order():
    assert choose("fig7, fig5") == ["fig5", "fig7"]
    assert choose(None)[-1] == "theory"
    with pytest.raises(ConfigError, match="--only"):
        choose(" ,")


def test_only_the_kernels_of_what_is_asked_for_are_compiled_ahead():
    assert [len(needed(n)) for n in (["fig2", "fig3"], ["fig3", "fig4"], FIGURES)] == [0, 2, 8]


# ---------------------------------------------------------------------------- the figures


@pytest.mark.parametrize(
    ("figure", "sweep", "name"), [("fig5", "unsteady", "K_p"), ("fig7", "steady", "K_r")]
)
def test_points_of_figs_5_and_7_are_means_of_the_stored_runs(made, figure, sweep, name):
    runs, points = getattr(made, sweep), made.table(f"{figure}_times")
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
    runs, points = made.steady, made.table("fig6_fractions")
    cases = runs["case"]
    assert (points["runs"] == SMALL.samples).all()
    for name in ("R", "SS", "SW", "unclassified"):
        np.testing.assert_array_equal(points[name], (runs["type"] == name).groupby(cases).sum())
        share = points[f"fraction_{name}"]
        np.testing.assert_allclose(share, points[name] / SMALL.samples)
        assert share.between(points[f"low_{name}"], points[f"high_{name}"]).all()
    past = (runs["n_c1"].abs() < runs["n_i"].abs()).groupby(cases).sum()
    np.testing.assert_array_equal(points["bondi"], past)
    both = points["bondi"] - points["bondi_only"]
    np.testing.assert_array_equal(both, points["SS"] - points["ss_only"])


def test_the_papers_integrator_is_given_the_same_bodies(made):
    rows, runs = made.table("fig6_rk4"), made.steady
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
    sw = {"type": "SW", "t_r": math.nan, "amp_growth": 2.0, "n_departure": 0.0501}
    unseen = sw | {"type": "unclassified", "n_departure": 0.0499}
    for trio, words in (
        ((r, late, late), "the sweep's tolerance"),
        ((r, late, r), "RK4's step"),
        ((r, late, r | {"t_r": 102.0}), "chaotic"),
        ((sw, unseen, sw), "threshold: n_departure"),
        ((sw, r, r), "the sweep's tolerance"),
        ((r, r | {"type": math.nan}, r), "RK4 gave no result"),
    ):
        assert integrators.cause(*trio, limits).startswith(words)


def test_lyapunov_exponents_are_those_of_wobbling_runs(made):
    rows, wobbling = made.table("fig6_chaos"), made.steady[made.steady["type"] == "SW"]
    # Evenly thinned.
    chosen = wobbling.iloc[:: -(-len(wobbling) // SMALL.lyapunov)]
    assert len(rows) == len(chosen) > 0
    np.testing.assert_array_equal(rows["chaotic"], is_chaotic(rows["lyapunov_late"], rows["t_end"]))
    assert rows.loc[~rows["chaotic"], "growth_longer"].isna().all()
    # The other way to the same number: one run alone, by its own driver.
    place = np.flatnonzero(~rows["chaotic"])[0]
    _, _, batch = single_run(chaos.launch_of(chosen.iloc[place]))
    calm = rows.iloc[place]
    alone = growth_along(batch.constants[0], batch.y0[0], [calm["t_end"]], tol=1e-10)[0]
    assert calm["lyapunov"] * calm["t_end"] == pytest.approx(alone, abs=0.5)


def test_examples_are_runs_of_the_sweep(made):
    runs, rows = made.steady, made.table("fig6_examples")
    assert {"spin_ss", "spin_sw"} & set(rows["example"])
    for row in rows.itertuples():
        same = [np.isclose(runs["K_r"], row.K_r, rtol=2e-3)]
        same += [runs[name] == getattr(row, name) for name in ("n_i", "omega_xy0", "sample")]
        run_ = runs[np.logical_and.reduce(same)].iloc[0]
        # The trace is that run: where it is shown whole it ends where the sweep's does.
        spin = made.table(f"fig6_{row.example}")
        assert (spin["t"].iloc[0], spin["n"].iloc[0]) == (0, row.n_i)
        if run_["t_end"] <= row.shown:
            assert spin["n"].iloc[-1] == pytest.approx(run_["n_end"], rel=0.02)


def test_larger_oscillations_take_ss_away(made):
    rows, runs = made.table("fig6_basin"), made.steady
    own = runs[(runs["n_i"] == fig6.N_I) & (runs["omega_xy0"] == 0.001)]
    assert (rows["runs"] == (own["n_c1"].abs() < 0.3).sum()).all()
    assert rows["runs"].iloc[0] > 0
    np.testing.assert_array_equal(rows[["R", "SS", "SW", "unclassified"]].sum(axis=1), rows["runs"])
    assert rows["SS"].iloc[0] >= rows["SS"].iloc[-1]


def test_readings_of_ss_contain_each_other(made):
    rows, runs = made.table("fig6_definitions"), made.steady
    for (n_i, size), own in rows.groupby(["n_i", "omega_xy0"]):
        counts = own["count"].to_numpy()
        # Growth at most the threshold, 1 %, 10 %, 30 %; then departures 1 %, 2 %, 5 %.
        assert (np.diff(counts[:4]) >= 0).all()
        assert (np.diff(counts[4:7]) >= 0).all()
        chosen = runs[(runs["n_i"] == n_i) & (runs["omega_xy0"] == size)]
        assert counts[0] == (chosen["type"] == "SS").sum()
        assert (own["runs"] == len(chosen)).all()


def test_onsets_lie_between_launch_and_horizon(made):
    rows, runs = made.table("fig7_onset"), made.steady
    wobbling = (runs["type"] == "SW").groupby(runs["case"]).sum().to_numpy()
    assert (rows["wobbling"] <= wobbling).all()
    found = rows.dropna(subset=["onset_median"])
    assert (found["onset_median"] > 0).all()
    assert (found["onset_median"] < 5 * found["t_rgh_median"] * 1.5).all()
    # The same bodies integrated again are the same: as many SW in all, thinned alike.
    assert len(made.closer) <= SMALL.windows
    assert (made.closer["type"] == "SW").sum() == rows["wobbling"].sum() > 0


def test_onset_is_the_middle_of_a_window():
    loss = np.array([0.0, 0.01, 0.3, 0.2, 0.8, 0.1])
    assert fig7.first_above(loss, loss.max() / 2, 2.0) == 9.0
    assert fig7.first_above(loss, 0.05, 2.0) == 5.0
    assert math.isnan(fig7.first_above(loss, 0.9, 2.0))


def test_interval_of_a_median_covers_it_as_often_as_it_says():
    rng = np.random.default_rng(7)
    assert fig7.median_interval(rng.random(5)) == (None, None)
    for n in (6, 40):
        ends = np.array([fig7.median_interval(rng.exponential(size=n)) for _ in range(1000)])
        covered = np.mean((ends[:, 0] < math.log(2)) & (ends[:, 1] > math.log(2)))
        assert 0.93 < covered < 0.995


def test_pictures_are_pictures(made):
    for name in SWEEPS:
        image = imread(made.directory / f"{name}.png")
        assert image.shape[0] > 200
        assert 0.5 < image[..., :3].mean() < 0.999
        svg = (made.directory / f"{name}.svg").read_text()
        assert svg.count("<g id=") > 50
        assert 'href="http' not in svg


def test_every_claim_of_the_sweeps_is_in_the_table(made):
    ids = [claim["id"] for claim in made.done.claims]
    # Too few runs of a point to tell of S8.
    assert ids == ["U1", "U2", "S1", "S2", "S3", "S4", "S5", "S6", "S7"]
    table = open_sealed((made.directory / "claims.parquet").read_bytes()).read()
    assert table.column("id").to_pylist() == ids
    for name in ("value", "low", "high"):
        values = [v for v in table.column(name).to_pylist() if v is not None]
        assert np.isfinite(values).all()


def test_progress_rises_to_one(made):
    shares = [share for share, *_ in made.seen]
    assert all(b >= a - 1e-12 for a, b in pairwise(shares))
    assert shares[-1] == pytest.approx(1)
    assert all(left is None or left >= 0 for *_, left in made.seen)


# ----------------------------------------------------------------------- stops, resumption


@pytest.fixture
def figures(monkeypatch):
    """Two figures that cost nothing in the place of all: a name is set to fail, data are noted."""
    calls, failing = [], set()

    def data(name):
        def one(ws, progress):
            calls.append(name)
            if name in failing:
                raise KeyboardInterrupt
            return {"values": pa.table({"x": [1.0, 2.0, ws.sizes.samples]})}

        return one

    # Where the other process finds `sketch`.
    monkeypatch.setenv("PYTHONPATH", str(Path(sketch.__file__).parent))
    kept = FIGURES.copy()
    FIGURES.clear()
    for name in ("first", "second"):
        FIGURES[name] = Figure(name, name, data(name), sketch.draw, (1.0, 1.0))
    yield SimpleNamespace(calls=calls, failing=failing)
    FIGURES.clear()
    FIGURES.update(kept)  # in their order


PICTURES = {f"{name}.{kind}" for name in ("first", "second") for kind in workspace.KINDS}


def drawn(directory):
    """When each picture was written."""
    return {
        path.name: path.stat().st_mtime_ns
        for path in directory.iterdir() if path.suffix in (".svg", ".png")
    }  # fmt: skip


def again(directory, calls, sizes=SMALL):
    """What is kept, computed and drawn by one more call."""
    calls.clear()
    before = drawn(directory)
    kept = reproduce(directory, ["first", "second"], sizes=sizes, threads=1).kept
    after = drawn(directory)
    assert set(after) == PICTURES
    return kept, calls, {name for name in PICTURES if before.get(name) != after[name]}


def test_a_stop_keeps_whole_data(figures, tmp_path):
    figures.failing.add("second")
    stopped = invoke("paper", "--output", tmp_path)
    assert stopped.exit_code == 130
    assert "completed work is kept" in stopped.stderr
    assert (tmp_path / "first_values.parquet").exists()
    assert not [*tmp_path.glob("second*"), *tmp_path.glob("report.html")]
    # Its pictures were under way, or done.
    missing = PICTURES - set(drawn(tmp_path))
    (tmp_path / ".fig6.svg.0123abcd.tmp").write_text("of a process that was killed")
    figures.failing.clear()
    assert again(tmp_path, figures.calls, FULL) == (["first"], ["second"], missing)
    assert not list(tmp_path.rglob(".*.tmp"))


@pytest.mark.usefixtures("here")
def test_what_is_whole_and_of_these_sizes_is_kept(figures, tmp_path):
    everything = (["first", "second"], PICTURES)
    of_first = {name for name in PICTURES if name.startswith("first")}
    assert again(tmp_path, figures.calls) == ([], *everything)
    assert again(tmp_path, figures.calls) == (["first", "second"], [], set())
    table, picture = tmp_path / "first_values.parquet", tmp_path / "second.svg"
    whole, vector = table.read_bytes(), picture.read_bytes()
    table.write_bytes(whole[:-40] + bytes([whole[-40] ^ 1]) + whole[-39:])
    assert again(tmp_path, figures.calls) == (["second"], ["first"], of_first)
    picture.unlink()
    assert again(tmp_path, figures.calls) == (["first", "second"], [], PICTURES - of_first)
    assert (table.read_bytes(), picture.read_bytes()) == (whole, vector)
    assert again(tmp_path, figures.calls, Sizes(samples=1)) == ([], *everything)
    # The record vouches for the data.
    (tmp_path / "paper.json").write_text("{")
    assert again(tmp_path, figures.calls) == ([], *everything)


def test_pictures_of_other_data_are_never_left(figures, tmp_path, monkeypatch):
    monkeypatch.setattr(run, "Artist", Here)
    again(tmp_path, figures.calls)
    first = replace(FIGURES["first"], draw=sketch.fail)
    FIGURES["first"] = first
    monkeypatch.setattr(run, "Artist", Artist)
    with pytest.raises(RuntimeError, match=r"(?s)draws ended with 1.*a mistake of ours"):
        reproduce(tmp_path, ["first", "second"], sizes=Sizes(samples=2), threads=1)
    assert not {name for name in drawn(tmp_path) if name.startswith("first")}
    # Its data are, and it is drawn from them.
    FIGURES["first"] = replace(first, draw=sketch.draw)
    monkeypatch.setattr(run, "Artist", Here)
    assert "first" in again(tmp_path, figures.calls, Sizes(samples=2))[0]


def test_a_picture_that_cannot_be_written_is_one_sentence(figures, tmp_path):
    FIGURES["first"] = replace(FIGURES["first"], draw=sketch.refuse)
    assert_refused(
        invoke("paper", "--quick", "--output", tmp_path), 1, "cannot write x.svg: no space left"
    )


def test_a_stop_ends_the_process_that_draws(figures, tmp_path):
    begun = tmp_path / "begun"
    values = pa.table({"path": [str(begun)]})
    replace_file(tmp_path / "first_values.parquet", encode(values))

    def stop():
        if begun.exists() and begun.read_text():
            raise KeyboardInterrupt

    def draw_for_ever():
        with Artist(tmp_path, wanted=True) as artist:
            artist.draw("first", replace(FIGURES["first"], draw=sketch.hang), {"values": values})
            artist.finish(stop)

    with pytest.raises(KeyboardInterrupt):
        draw_for_ever()
    with pytest.raises(ProcessLookupError):
        os.kill(int(begun.read_text()), 0)


def test_data_are_of_the_code_below_them(monkeypatch, tmp_path):
    """What was edited decides what is made again: runs, or figures."""
    package = tmp_path / "rattlesweep"
    shutil.copytree(workspace.PACKAGE, package, ignore=shutil.ignore_patterns("__pycache__"))
    monkeypatch.setattr(workspace, "PACKAGE", package)

    def keys():
        workspace.code_key.cache_clear()
        return [workspace.code_key(*part) for part in (workspace.OF_RUNS, workspace.OF_FIGURES)]

    before = keys()
    for file, changed in (
        ("paper/registry.py", [False, False]),
        ("paper/claims/theory.py", [False, False]),
        ("paper/figures/fig5.py", [False, True]),
        ("study/style.py", [False, True]),
        ("paper/steady.yaml", [False, True]),
        ("physics/theory.py", [True, True]),
        ("integrate/lanes/events.py", [True, True]),
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
    ws = Workspace(tmp_path, Sizes(samples=1), 2)
    tables = {name: table.to_pandas() for name, table in fig7.data(ws, quiet).items()}
    assert len(tables["late"]) == CASES
    assert tables["late"]["reversed"].sum() == tables["onset"]["wobbling"].sum() == 0
    assert tables["late"]["ratio_std"].isna().all()
    assert ws.failed(["steady"]) == CASES
    # Failures of a sweep that no chosen figure reads do not count.
    assert ws.failed(["unsteady"]) == 0


def test_runs_are_integrated_again_when_others_are_asked_for(made, tmp_path):
    runs = made.steady.iloc[10:16:2]
    ws = Workspace(tmp_path, SMALL, 2)
    same = ws.again("few", runs, quiet)
    pd.testing.assert_frame_equal(same[["n_end", "t_r"]], runs[["n_end", "t_r"]])
    assert len(runs_of(tmp_path, "few")) == 3
    ws.again("few", runs[:2], quiet)
    assert len(runs_of(tmp_path, "few")) == 2


def test_sweeps_of_other_sizes_are_not_overwritten(made, monkeypatch):
    # A kernel still being compiled would have the next command leave this process at once.
    monkeypatch.setattr(integrators, "PAPERS", {"method": "dop853", "tol": 1e-6})
    with pytest.raises(ConfigError, match=r"runs of another config .*samples"):
        reproduce(made.directory, ["fig6"], sizes=replace(SMALL, samples=3), threads=2)
    pd.testing.assert_frame_equal(runs_of(made.directory, "steady"), made.steady)


# ------------------------------------------------------------------------------- report

TEXTS = ("id", "held", "checks", "words", "where", "measured", "evidence")


def words_of(html):
    return unescape(re.sub(r"<[^>]*>", "", html))


def page_of(done, **texts):
    """The page of one claim of each verdict, with these texts."""
    claims = [{"verdict": verdict, **texts} for verdict in report.VERDICTS]
    return report.page(replace(done, claims=claims), []).decode()


def test_the_report_is_one_file_that_asks_for_nothing(made):
    html = (made.directory / "report.html").read_text()
    assert len(html) < 5_000_000
    for address in re.findall(r'\b(?:src|href)="([^"]*)"', html):
        assert address.startswith(("data:image/", "#"))
    assert not re.findall(r"<script|<link|<iframe|url\(|@import", html)
    images = re.findall(r"<img[^>]*>", html)
    assert len(images) == len(SWEEPS)
    assert all(re.search(r'alt="[^"]', image) for image in images)
    for words in [claim["id"] for claim in made.done.claims] + [
        "Reduced", "numpy", "numba", "matplotlib", "fig6", "steady",
    ]:  # fmt: skip
        assert words in words_of(html)


def test_text_is_never_taken_for_markup(made):
    bad = '<script>alert("1")</script>&'
    html = page_of(made.done, **dict.fromkeys(TEXTS, bad))
    words = words_of(html)
    assert "<script" not in html
    assert words.count(bad) == 3 * len(TEXTS)
    # Verdicts do not rely on colour.
    assert all(sign in words for sign in ("✓ agree", "◐ partly", "✗ disagree"))


def test_symbols_are_set_and_names_of_files_are_not():
    text = "abs(n_i) >~ 0.3: t_rGH- -> K_r, omega_p^2 (fig6_rk4.parquet), 2.0e-3 K_p."
    assert symbols(text) == (
        "|<i>n</i><sub>i</sub>| ≳ 0.3: <i>t</i><sub>rGH-</sub> → <i>K</i><sub>r</sub>, "
        "<i>ω</i><sub>p</sub><sup>2</sup> (fig6_rk4.parquet), 2.0e-3 <i>K</i><sub>p</sub>."
    )


# ------------------------------------------------------------------------------ command


@pytest.mark.usefixtures("figures", "here")
def test_the_command_makes_what_is_asked_for(tmp_path):
    out = tmp_path / "out"
    done = invoke("paper", "--quick", "--only", "first", "--output", out)
    assert (done.exit_code, done.stdout) == (0, "")
    assert "report.html" in done.stderr
    assert {p.name for p in out.iterdir()} == {
        "claims.parquet", "first.png", "first.svg", "first_values.parquet", "paper.json",
        "report.html",
    }  # fmt: skip
    record = json.loads((out / "paper.json").read_text())
    assert record["threads"] == available_threads()
    assert (record["quick"], record["settings"]["samples"]) == (True, QUICK.samples)


def test_the_command_refuses_in_one_sentence(tmp_path):
    wrong = invoke("paper", "--only", "fgi6", "--output", tmp_path / "o")
    assert_refused(wrong, 2, '"fgi6" is not one of', 'did you mean "fig6"')
    assert not (tmp_path / "o").exists()
    file = tmp_path / "file"
    file.write_text("")
    assert_refused(
        invoke("paper", "--quick", "--only", "fig5", "--output", file), 1, "cannot write in"
    )


@pytest.mark.slow
def test_the_full_size_says_of_the_paper_what_the_readme_says(tmp_path):
    """Minutes: 240,000 runs, RK4, and Lyapunov exponents of what wobbles."""
    done = reproduce(tmp_path, SWEEPS, threads=available_threads())
    verdicts = {claim["id"]: claim["verdict"] for claim in done.claims}
    assert verdicts == {
        "U1": "partly", "U2": "partly", "S1": "agree", "S2": "partly", "S3": "agree",
        "S4": "partly", "S5": "partly", "S6": "partly", "S7": "partly", "S8": "agree",
    }  # fmt: skip
    rk4 = pd.read_parquet(tmp_path / "fig6_rk4.parquet")
    assert len(rk4) == 1200
    assert (rk4["type"] == rk4["type_rk4"]).all()
    assert done.failed == 0
