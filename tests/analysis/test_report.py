"""The page of a sweep: it is all there, it is safe, it needs nothing else, a browser
shows it.
"""

from __future__ import annotations

import base64
import re
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from browser import check_page, needs_browser, window
from editing import edited

import rattlesweep as rs
from rattlesweep.analysis.report import config_yaml, make_report
from rattlesweep.config.read import parse_config, physics_hash, read_yaml
from rattlesweep.system.pages import fingerprint

EVIL = "<script>alert(1)&lt;"
STEADY: dict[str, Any] = {
    "name": "steady",
    "bodies": {
        "source": "sd",
        "samples": 10,
        "target": {"K_r": [0.005, 0.02, 0.1], "rel_tol": 0.05},
    },
    "spin": {"n_i": [-0.5, -0.1], "omega_xy0": [0.01, 0.1]},
}
MAP: dict[str, Any] = {
    "name": EVIL,
    "bodies": {
        "source": "grid",
        "base": {"preset": "GH"},
        "axes": {"theta": {"linspace": [0.6, 0.98, 9]}},
    },
    "spin": {"n_i": {"linspace": [-0.6, 0.6, 50]}, "omega_xy0": 0.01},
    "horizon": {"t": 300},
    "integrator": {"max_steps": 800},
}


@pytest.fixture(scope="module")
def sweeps(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("sweeps")
    rs.sweep(STEADY, output=root / "steady", threads=1)
    rs.sweep(MAP, output=root / "map", threads=1)
    return root


@pytest.fixture(scope="module")
def pages(sweeps: Path) -> dict[str, bytes]:
    return {name: make_report(sweeps / name) for name in ("steady", "map")}


class Page(HTMLParser):
    """The tags, the title and the other words of a page."""

    def __init__(self, data: bytes) -> None:
        super().__init__()
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.words: dict[str, str] = {"title": "", "style": "", "": ""}
        self.feed(data.decode())
        self.title, self.text = (" ".join(self.words[k].split()) for k in ("title", ""))

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))

    def handle_data(self, data: str) -> None:
        last = self.tags[-1][0] if self.tags else ""
        self.words[last if last in self.words else ""] += data + " "


def test_all_of_a_sweep_is_there(sweeps, pages):
    page = Page(pages["steady"])
    sweep = rs.load(sweeps / "steady")
    assert page.title == "steady"
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
    alts = [str(picture["alt"]).split(" of ")[0] for picture in pictures]
    assert alts == [
        "Fraction that reverses",
        "Mean time until the first reversal",
        "Mean",
        "Histogram",
    ]
    # Each has another picture for a narrow screen, with letters that one can read.
    narrow = [of for tag, of in page.tags if tag == "source"]
    assert [of["media"] for of in narrow] == 4 * ["(max-width: 40rem)"]
    urls = [picture["src"] for picture in pictures]
    assert not {of["srcset"] for of in narrow} & {*urls}
    # Columns of the summary are named in words, with the names below.
    for words in ("fraction that reverses (type R) fraction_R", "mean reversal time"):
        assert words in page.text
    for picture in pictures:
        head, code = str(picture["src"]).split(",")
        start = b"<?xml" if "svg" in head else b"\x89PNG"
        assert base64.b64decode(code, validate=True).startswith(start)


def test_the_config_makes_the_sweep_again(sweeps):
    config = rs.load(sweeps / "map").manifest["config"]
    again = parse_config(read_yaml(config_yaml(config))[0])
    assert physics_hash(again) == physics_hash(parse_config(config))


def test_failures_are_counted_and_named(sweeps, pages):
    runs = rs.load(sweeps / "map").runs
    bad = runs[runs["status"] != "ok"]
    assert len(bad) > 3
    word = bad["status"].iloc[0]
    first = bad.iloc[0]
    share = f"{100 * len(bad) / len(runs):.3g} %"
    words = f"{word} {len(bad)} {share} case {first['case']}, sample {first['sample']}"
    assert words in Page(pages["map"]).text


def test_the_page_needs_nothing_else_and_runs_nothing(pages):
    assert Page(pages["map"]).title == EVIL
    for data in pages.values():
        assert len(data) < 5e6
        # Its only script is that which sorts the table of cases.
        (script,) = re.findall(r"<script>(.*?)</script>", data.decode(), re.DOTALL)
        assert f"script-src '{fingerprint(script)}'" in data.decode()
        for tag, attrs in Page(data).tags:
            assert tag not in {"iframe", "object", "link"}
            for key in {"src", "href", "srcset", "action"} & attrs.keys():
                assert str(attrs[key]).startswith(("data:", "#")), (tag, attrs)
        assert not re.search(rb"@import|url\(", data)


@pytest.mark.slow
@needs_browser
def test_the_table_of_cases_is_sorted_by_a_click(pages, chromium, tmp_path):
    path = tmp_path / "page.html"
    path.write_bytes(pages["steady"])
    with window(chromium, 1400, 900) as opened:
        opened.page.goto(path.resolve().as_uri())
        head = opened.page.locator("table.sorts th", has_text="t_r_mean").first
        place = head.evaluate("head => head.cellIndex")
        cells = f"[...document.querySelectorAll('.sorts td:nth-child({place + 1})')]"
        orders = []
        for _ in range(2):
            head.locator("button").click()
            texts = opened.run(f"{cells}.map((cell) => cell.textContent)")
            numbers = [float(text.replace(",", "")) for text in texts if text != "–"]
            # What has no value stays at the end.
            assert "–" not in texts[: len(numbers)]
            orders.append(numbers)
        assert orders[0] == sorted(orders[0])
        assert orders[1] == sorted(orders[0], reverse=True)
        assert head.get_attribute("aria-sort") == "descending"
        assert opened.console == []


def test_short_lengths_are_in_um(tmp_path):
    sweep = rs.sweep(
        {
            "name": "levers",
            "model": "reduced",
            "bodies": {
                "source": "shape",
                "length": "12 cm",
                "width": "3 cm",
                "height": "12 mm",
                "skew": "3 deg",
                "mass": "60 g",
            },
            "spin": {"n_i": "-60 rpm", "omega_xy0": "6 rpm"},
            "dissipation": {"rolling": ["0 um", "250 um"]},
            "horizon": {"t": "1 s"},
        },
        output=tmp_path / "out",
        threads=1,
    )
    assert "0.00025" not in Page(make_report(sweep.directory)).text
    assert "250 um" in Page(make_report(sweep.directory)).text


def test_a_sweep_that_is_not_whole(sweeps, tmp_path):
    part = edited(sweeps / "map", tmp_path / "part", lambda rows: rows[:350])
    page = Page(make_report(part, "<b>&"))
    assert page.title == "<b>&"
    assert "not complete: 350 of 450 runs are done" in page.text
    assert "may still change" in page.text


def test_a_sweep_whose_runs_all_failed(tmp_path):
    bodies = {"source": "preset", "name": "GH"}
    spin = {"n_i": [0.1, 0.2], "omega_xy0": 0.01}
    config = {"bodies": bodies, "spin": spin, "integrator": {"max_steps": 20}}
    rs.sweep(config, output=tmp_path, threads=1)
    page = Page(make_report(tmp_path))
    assert "None of them is ok." in page.text
    assert "step_limit 2 100 %" in page.text


def test_what_the_pictures_show_is_said(sweeps, pages):
    alts = [of["alt"] for tag, of in Page(pages["steady"]).tags if tag == "img"]
    runs = rs.load(sweeps / "steady").runs.assign(
        target=np.repeat([0.005, 0.02, 0.1], 40)
    )
    back = (runs["type"] == "R").groupby(runs["target"]).mean()
    ratio = (runs["t_r"] / runs["t_rgh"]).dropna()
    low, high = np.percentile(ratio, (25, 75))
    assert alts[0] == (
        "Fraction that reverses of 120 runs by K_r, omega_xy0, n_i: "
        f"from {back[0.005]:.3g} at K_r = 0.005 to {back[0.1]:.3g} at 0.1"
    )
    assert alts[-1] == (
        f"Histogram of t_r/t_rGH of {len(ratio)} runs, "
        f"half of them between {low:.3g} and {high:.3g}"
    )
    (alt, *_) = [of["alt"] for tag, of in Page(pages["map"]).tags if tag == "img"]
    map_runs = rs.load(sweeps / "map").runs
    words, _, numbers = str(alt).partition(": from ")
    assert words.startswith(
        "Map of types and times; fraction that reverses of 450 runs"
    )
    first = words.split(" by ")[1].split(",")[0]
    ok = map_runs[map_runs["status"] == "ok"]
    share = (ok["type"] == "R").groupby(ok[first]).mean()
    assert numbers.split(" at ")[0] == f"{share.iloc[0]:.3g}"


@pytest.mark.slow
@needs_browser
@pytest.mark.parametrize("name", ["steady", "map"])
def test_a_page_fits_and_can_be_read(name, pages, chromium, tmp_path):
    path = tmp_path / "report.html"
    path.write_bytes(pages[name])
    check_page(chromium, path)


@needs_browser
def test_nothing_is_cut_off_on_a_telephone(pages, chromium, tmp_path):
    path = tmp_path / "report.html"
    path.write_bytes(pages["steady"])
    inner = """[...document.querySelectorAll('*')].filter(
        (e) => e.clientWidth > 0 && e.scrollWidth > e.clientWidth + 1
    ).map((e) => e.tagName + ' ' + e.className)"""
    with window(chromium, 390, 900) as opened:
        opened.page.goto(path.resolve().as_uri())
        assert opened.run(inner) == []
        shown = opened.run("[...document.images].map((image) => image.currentSrc)")
    narrow = [of["srcset"] for tag, of in Page(pages["steady"]).tags if tag == "source"]
    assert {*narrow} <= {*shown}
