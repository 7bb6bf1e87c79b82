"""The command `paper`: settings, one small run of the sweeps' figures, report."""

from __future__ import annotations

import re
from html import unescape
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pytest
from browser import check_page, needs_browser
from refusal import assert_refused
from sweeping import ROOT, invoke

from rattlesweep.analysis.style import save_figure
from rattlesweep.config.read import load_config, parse_config, resolved
from rattlesweep.paper import reproduce as command
from rattlesweep.paper.reproduce import choose_figures, reproduce
from rattlesweep.paper.workspace import (
    FULL_SIZES,
    QUICK_SIZES,
    Sizes,
    Workspace,
    sweep_config,
)

SMALL = Sizes(samples=4, lyapunov=15, windows=30)


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    directory = tmp_path_factory.mktemp("paper")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(
            command, "save_figure", lambda figure, paths: draw(figure, *paths)
        )
        claims = reproduce(
            Workspace(directory, SMALL, threads=2), ["fig6", "fig7", "fig8"]
        )
    return SimpleNamespace(
        directory=directory,
        claims=claims,
        **{name: runs_of(directory, name) for name in ("steady", "unsteady")},
        table=lambda name: pq.read_table(directory / f"{name}.parquet").to_pandas(),
    )


def draw(figure, svg, png):
    """Save one of the two pictures; `test_the_command_makes_what_is_asked_for` has
    both.
    """
    save_figure(figure, [svg])
    png.touch()


def runs_of(directory, sweep):
    files = sorted((directory / "sweeps" / sweep / "runs").glob("*.parquet"))
    runs = pd.concat([pd.read_parquet(file) for file in files], ignore_index=True)
    return runs.sort_values(["case", "sample"], ignore_index=True)


@pytest.mark.parametrize("name", ["unsteady", "steady"])
def test_the_sweeps_are_those_of_the_shipped_configs(name):
    theirs = resolved(load_config(ROOT / "configs" / f"{name}.yaml"))
    assert resolved(parse_config(sweep_config(name, FULL_SIZES))) == theirs
    quick = resolved(parse_config(sweep_config(name, QUICK_SIZES)))
    assert quick | {"bodies": 0} == theirs | {"bodies": 0}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("figure", "sweep", "name"),
    [("fig6", "unsteady", "K_p"), ("fig8", "steady", "K_r")],
)
def test_points_of_figs_6_and_8_are_means_of_the_stored_runs(made, figure, sweep, name):
    runs = getattr(made, sweep)
    points = made.table(f"{figure}_times")
    cases = runs.groupby("case")
    assert len(points) == cases.ngroups
    # NaN where the run does not reverse, and so in the mean of none and the deviation
    # of one.
    back = runs["t_r"].where(runs["type"] == "R").groupby(runs["case"])
    np.testing.assert_array_equal(points["reversed"], back.count())
    np.testing.assert_allclose(points["t_r_mean"], back.mean(), rtol=1e-13)
    np.testing.assert_allclose(points["t_r_std"], back.std(), rtol=1e-10)
    # The paper's own form of its formula (Eqs. 56 and 58), with the mean n_0.
    n_0 = cases["n_0"].mean().to_numpy()
    n = points["n_i"].abs().to_numpy()
    line = np.log((n_0 + n) / (n_0 - n)) / (n_0 * points[name].to_numpy())
    np.testing.assert_allclose(points["t_rgh_line"], line, rtol=1e-9)


@pytest.mark.slow
def test_fractions_of_fig_7_are_counts_of_the_stored_runs(made):
    runs = made.steady
    points = made.table("fig7_fractions")
    cases = runs["case"]
    assert (points["runs"] == SMALL.samples).all()
    for name in ("R", "SS", "SW", "unclassified"):
        np.testing.assert_array_equal(
            points[name], (runs["type"] == name).groupby(cases).sum()
        )
        share = points[f"fraction_{name}"]
        np.testing.assert_allclose(share, points[name] / SMALL.samples)
        assert share.between(
            points[f"fraction_{name}_low"], points[f"fraction_{name}_high"]
        ).all()
    past = (runs["n_c1"].abs() < runs["n_i"].abs()).groupby(cases).sum()
    np.testing.assert_array_equal(points["bondi"], past)
    both = points["bondi"] - points["bondi_only"]
    np.testing.assert_array_equal(both, points["SS"] - points["ss_only"])


@pytest.mark.slow
def test_every_claim_of_the_sweeps_is_in_the_tables(made):
    ids = [claim["id"] for claim in made.claims]
    assert ids == ["U1", "U2", "S1", "S2", "S3", "S4", "S5", "S6", "S7", "S8", "S9b"]
    table = pq.read_table(made.directory / "claims.parquet")
    assert table.column("id").to_pylist() == ids
    # Four samples of a point are too few.
    assert "too few samples to tell" in table.column("verdict").to_pylist()
    rows = [
        line
        for line in (made.directory / "claims.md").read_text().splitlines()
        if line.startswith("| ") and not line.startswith("| |")
    ]
    assert [row.split("|")[1].strip() for row in rows] == ids
    assert {row.count("|") for row in rows} == {5}


def words_of(html):
    return unescape(re.sub(r"<[^>]*>", "", html))


@pytest.mark.slow
def test_the_report_is_one_file_that_asks_for_nothing(made):
    html = (made.directory / "report.html").read_text()
    assert len(html) < 5_000_000
    for address in re.findall(r'\b(?:src|href)="([^"]*)"', html):
        assert address.startswith(("data:image/", "#"))
    assert not re.findall(r"<script|<link|<iframe|url\(|@import", html)
    assert len(re.findall(r'<img[^>]* alt="[^"]', html)) == 3
    ids = [claim["id"] for claim in made.claims]
    for text in (*ids, "Reduced", "numpy", "numba", "matplotlib", "fig7", "steady"):
        assert text in words_of(html)


@pytest.mark.slow
@needs_browser
def test_the_report_fits_and_can_be_read(made, chromium):
    check_page(chromium, made.directory / "report.html")


def test_text_is_never_taken_for_markup(tmp_path, monkeypatch):
    bad = '<script>alert("1")</script>&'
    names = ("id", "held", "checks", "words", "where", "measured", "evidence")
    verdicts = ("agree", "partly", "disagree", "too few samples to tell")
    claims = [{"verdict": verdict, **dict.fromkeys(names, bad)} for verdict in verdicts]
    monkeypatch.setattr(command, "judge", lambda *_, **__: claims)
    reproduce(Workspace(tmp_path), ["theory"])
    html = (tmp_path / "report.html").read_text()
    text = words_of(html)
    assert "<script" not in html
    assert text.count(bad) == 4 * len(names)
    # Verdicts do not rely on colour.
    signs = ("✓ agree", "◐ partly", "✗ disagree", "? too few samples to tell")
    assert all(sign in text for sign in signs)


def test_the_command_makes_what_is_asked_for(tmp_path):
    out = tmp_path / "out"
    done = invoke("paper", "--quick", "--only", "fig5,theory", "--output", out)
    assert done.exit_code == 0
    assert "G2   agree (2 of 2): GH, n_i = -0.1" in done.stdout
    assert "report.html" in done.stderr
    assert {p.name for p in out.iterdir()} == {
        "claims.md",
        "claims.parquet",
        "report.html",
        "fig5.png",
        "fig5.svg",
        *(f"fig5_{table}.parquet" for table in ("runs", "steady", "unsteady")),
    }


def test_the_command_refuses_in_one_sentence(tmp_path):
    wrong = invoke("paper", "--set", "spin.n_i=0.1", "--output", tmp_path / "o")
    assert_refused(wrong, 2, "--set spin.n_i=0.1: the figures have the launches of the")
    wrong = invoke("paper", "--only", "fgi7", "--output", tmp_path / "o")
    assert_refused(wrong, 2, '"fgi7" is not one of', 'did you mean "fig7"')
    assert not (tmp_path / "o").exists()
    file = tmp_path / "file"
    file.write_text("")
    wrong = invoke("paper", "--quick", "--only", "fig6", "--output", file)
    assert_refused(wrong, 1, "cannot write in")


@pytest.mark.slow
def test_the_full_size_says_of_the_paper_what_the_docs_say(tmp_path):
    """Minutes: 240,000 runs, and Lyapunov exponents of what wobbles."""
    workspace = Workspace(tmp_path)
    claims = reproduce(workspace, choose_figures(None))
    rows = re.findall(
        r"^\| (\w+) \| (agree|partly|disagree),",
        (ROOT / "benchmarks" / "claims.md").read_text(),
        re.MULTILINE,
    )
    assert {claim["id"]: claim["verdict"] for claim in claims} == dict(rows)
    assert workspace.failed == 0
