"""The page of a sweep: it is all there, it is safe, it needs nothing else, a browser shows it."""

from __future__ import annotations

import base64
import re
from collections.abc import Iterator
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import pytest
from browser import NO_WEBGL, Browser, browser, find_browser
from editing import edited
from sweeping import invoke

import rattlesweep as rs
from rattlesweep.analysis.pages import config_yaml
from rattlesweep.analysis.report import MOST_CASES, make_report
from rattlesweep.sweeps.config.read import parse_config, physics_hash, read_yaml, resolved

EVIL = "<script>alert(1)&lt;"
STEADY: dict[str, Any] = {
    "name": "steady",
    "bodies": {"source": "sd", "samples": 10, "target": {"K_r": [0.005, 0.02, 0.1],
                                                         "rel_tol": 0.05}},
    "spin": {"n_i": [-0.5, -0.1], "omega_xy0": [0.01, 0.1]},
}  # fmt: skip
MAP: dict[str, Any] = {
    "name": EVIL,
    "bodies": {"source": "grid", "base": {"preset": "GH"},
               "axes": {"theta": {"linspace": [0.6, 0.98, 9]}}},
    "spin": {"n_i": {"linspace": [-0.6, 0.6, 50]}, "omega_xy0": 0.01},
    "horizon": {"t": 300},
    "integrator": {"max_steps": 800},
}  # fmt: skip


@pytest.fixture(scope="module")
def sweeps(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A population, and a grid with failures and an evil name."""
    root = tmp_path_factory.mktemp("sweeps")
    rs.sweep(STEADY, output=root / "steady", threads=1)
    rs.sweep(MAP, output=root / "map", threads=1)
    return root


@pytest.fixture(scope="module")
def pages(sweeps: Path) -> dict[str, bytes]:
    """Their pages."""
    return {name: make_report(sweeps / name) for name in ("steady", "map")}


class Page(HTMLParser):
    """What a page holds."""

    def __init__(self, data: bytes) -> None:
        super().__init__()
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.words: list[str] = []
        self.open: list[str] = []
        self.title = ""
        self.feed(data.decode())

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))
        self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        # Every element is closed in its turn, but for those that have no end.
        while self.open and self.open[-1] in ("meta", "img"):
            self.open.pop()
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        if self.open and self.open[-1] == "title":
            self.title += data
        elif self.open and self.open[-1] != "style":
            self.words.append(data)

    @property
    def text(self) -> str:
        """All words."""
        return " ".join(" ".join(self.words).split())


def test_all_of_a_sweep_is_there(sweeps, pages):
    page = Page(pages["steady"])
    sweep = rs.load(sweeps / "steady")
    assert page.title == "steady"
    headings = [attrs.get("id") for tag, attrs in page.tags if tag == "section"]
    assert headings == [
        "words", "pictures", "cases", "failures", "types", "cost", "config", "provenance",
    ]  # fmt: skip
    assert "A sweep of 120 runs in 12 cases, complete." in page.text
    for name, count in sweep.runs["type"].value_counts().items():
        assert f"{name} {100 * count / 120:.1f} %" in page.text
    for mean in sweep.summary["t_r_mean"].dropna():
        assert f" {mean:.5g} " in page.text
    assert "None: all 120 runs have status ok." in page.text
    assert f"{sweep.runs['n_steps'].sum():,}" in page.text
    assert sweep.manifest["config_hash"] in page.text
    assert f"numba {sweep.manifest['versions']['numba']}" in page.text
    pictures = [attrs for tag, attrs in page.tags if tag == "img"]
    assert [str(p["alt"]).split()[0] for p in pictures] == [
        "fractions", "times", "ratio", "distribution",
    ]  # fmt: skip
    for picture in pictures:
        head, code = str(picture["src"]).split(",")
        start = {"data:image/svg+xml;base64": b"<?xml", "data:image/png;base64": b"\x89PNG"}[head]
        assert base64.b64decode(code, validate=True).startswith(start)


def test_the_config_makes_the_sweep_again(sweeps):
    for name in ("steady", "map"):
        config = rs.load(sweeps / name).manifest["config"]
        text = config_yaml(config)
        again = parse_config(read_yaml(text)[0])
        assert physics_hash(again) == physics_hash(parse_config(config))
        assert resolved(again)["spin"] == config["spin"]
    assert "n_i:\n    linspace: [-0.6, 0.6, 50]" in text
    assert config_yaml({"samples": 30, "least": 0.5}) == "samples: 30\nleast: 0.5\n"


def test_words_of_the_config_are_words(pages):
    page = Page(pages["map"])
    assert b"<script" not in pages["map"]
    assert page.title == EVIL
    assert EVIL in page.text
    assert not {tag for tag, _ in page.tags} & {"script", "iframe", "object", "link"}


def test_failures_are_counted_and_named(sweeps, pages):
    runs = rs.load(sweeps / "map").runs
    bad = runs[runs["status"] != "ok"]
    assert len(bad) > 3
    word, first = bad["status"].iloc[0], bad.iloc[0]
    share = f"{100 * len(bad) / len(runs):.1f} %"
    words = f"{word} {len(bad)} {share} case {first['case']}, sample {first['sample']}"
    assert words in Page(pages["map"]).text


def test_the_page_needs_nothing_else(pages):
    for data in pages.values():
        assert len(data) < 5e6
        for tag, attrs in Page(data).tags:
            for key in {"src", "href", "srcset", "action"} & attrs.keys():
                assert str(attrs[key]).startswith(("data:", "#")), (tag, attrs)
        assert not re.search(rb"@import|url\(", data)


def test_a_sweep_that_is_not_whole(sweeps, tmp_path):
    part = edited(sweeps / "map", tmp_path / "part", lambda rows: rows[:350])
    page = Page(make_report(part, "<b>&"))
    assert page.title == "<b>&"
    assert "not complete: 350 of 450 runs are done" in page.text
    assert "may still change" in page.text


def test_thresholds_of_the_config_and_those_behind_the_types(sweeps, tmp_path):
    again = edited(sweeps / "steady", tmp_path / "again", lambda rows: rows)
    before = Page(make_report(again)).text
    assert "sw_departure 0.05 0.05" in before
    assert "typed again" not in before
    assert invoke("classify", again, "--set", "classify.sw_departure=0.2").exit_code == 0
    page = Page(make_report(again)).text
    assert "sw_departure 0.05 0.2" in page
    command = f"rattlesweep classify {again} --set classify.sw_departure=0.2"
    assert command in page
    # The command that the page shows gives the types that it shows.
    types = rs.load(again).runs["type"]
    fresh = edited(sweeps / "steady", tmp_path / "fresh", lambda rows: rows)
    shown = command.replace(str(again), str(fresh)).split()[1:]
    assert invoke(*shown).exit_code == 0
    assert rs.load(fresh).runs["type"].equals(types)


def test_many_cases_stay_small(tmp_path):
    count = MOST_CASES + 500
    spin = {"n_i": {"linspace": [0.01, 0.5, count]}, "omega_xy0": 0.01}
    rs.sweep({"bodies": {"source": "preset", "name": "GH"}, "model": "gh", "spin": spin},
             output=tmp_path)  # fmt: skip
    data = make_report(tmp_path)
    assert len(data) < 5e6
    assert "The other 500 cases are in summary.parquet." in Page(data).text


@pytest.fixture(scope="module")
def window() -> Iterator[Browser]:
    if find_browser() is None:
        pytest.skip("no Chromium here to open the page with")
    with browser(*NO_WEBGL) as one:
        yield one


@pytest.mark.parametrize("name", ["steady", "map"])
def test_a_narrow_page_does_not_scroll_sideways(pages, window, tmp_path, name):
    target = tmp_path / "page.html"
    target.write_bytes(pages[name])
    window.size(390, 800)
    window.open(target, ready="true")
    page = "document.documentElement"
    wide, inside = window.run(f"[{page}.scrollWidth, {page}.clientWidth]")
    assert 300 < wide <= inside <= 390
