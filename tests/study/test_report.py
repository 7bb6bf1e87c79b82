"""The page of a sweep: it is all there, it is safe, it needs nothing else, a browser shows it."""

from __future__ import annotations

import base64
import re
import shutil
import subprocess
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import matplotlib.image
import numpy as np
import pytest
from matplotlib.colors import to_rgb
from refusal import assert_refused
from sweeping import invoke, tree

import rattlesweep as rs
from rattlesweep.study.pages import config_yaml
from rattlesweep.study.report import MOST_CASES, make_report
from rattlesweep.study.style import TYPE_STYLE
from rattlesweep.sweeps.config import yamlfile
from rattlesweep.sweeps.config.load import parse_config, physics_hash, resolved
from rattlesweep.sweeps.inspect.content_hash import content_hash
from rattlesweep.sweeps.store import store as store_module
from rattlesweep.sweeps.store.manifest import Expected, Manifest
from rattlesweep.sweeps.store.store import Store

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
    "block_size": 100,
}  # fmt: skip


@pytest.fixture(scope="module")
def sweeps(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A population, and a grid with failures and an evil name."""
    root = tmp_path_factory.mktemp("sweeps")
    rs.sweep(STEADY, output=root / "steady", threads=1)
    rs.sweep(MAP, output=root / "map", threads=1)
    return root


Made = tuple[dict[str, bytes], list[str]]


@pytest.fixture(scope="module")
def made(sweeps: Path) -> Made:
    """Their pages, and the names of the files that were read for them."""
    read: list[str] = []
    file, whole = store_module.pq.ParquetFile, Path.read_bytes

    def parquet_file(source: Any, *args: Any, **options: Any) -> Any:
        read.append(str(source))
        return file(source, *args, **options)

    def read_bytes(path: Path) -> bytes:
        read.append(str(path))
        return whole(path)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(store_module.pq, "ParquetFile", parquet_file)
        patch.setattr(Path, "read_bytes", read_bytes)
        return {name: make_report(sweeps / name) for name in ("steady", "map")}, read


@pytest.fixture(scope="module")
def pages(made: Made) -> dict[str, bytes]:
    """Their pages."""
    return made[0]


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


def test_all_of_a_sweep_is_there(sweeps: Path, pages: dict[str, bytes]) -> None:
    page = Page(pages["steady"])
    sweep = rs.load(sweeps / "steady")
    assert page.title == "steady"
    headings = [attrs.get("id") for tag, attrs in page.tags if tag == "section"]
    assert headings == ["pictures", "cases", "failures", "cost", "config", "provenance", "notes"]
    assert "A sweep of 120 runs in 12 cases, complete." in page.text
    for name, count in sweep.runs["type"].value_counts().items():
        assert f"{name} {100 * count / 120:.1f} %" in page.text
    for _, row in sweep.summary.iterrows():
        assert f"{row['t_r_mean']:.5g}" in page.text
    assert "None: all 120 runs have status ok." in page.text
    assert f"{sweep.runs['n_steps'].sum():,}" in page.text
    assert sweep.manifest["config_hash"] in page.text
    assert content_hash(sweeps / "steady") in page.text
    assert f"numba {sweep.manifest['versions']['numba']}" in page.text
    pictures = [attrs for tag, attrs in page.tags if tag == "img"]
    assert [str(p["alt"]).split()[0] for p in pictures] == [
        "fractions", "times", "ratio", "distribution",
    ]  # fmt: skip
    for picture in pictures:
        head, code = str(picture["src"]).split(",")
        start = {"data:image/svg+xml;base64": b"<?xml", "data:image/png;base64": b"\x89PNG"}[head]
        assert base64.b64decode(code, validate=True).startswith(start)


def test_the_config_makes_the_sweep_again(sweeps: Path) -> None:
    for name in ("steady", "map"):
        config = rs.load(sweeps / name).manifest["config"]
        text = config_yaml(config)
        again = parse_config(yamlfile.parse(text).data)
        assert physics_hash(again) == physics_hash(parse_config(config))
        assert resolved(again)["spin"] == config["spin"]
    assert "n_i:\n    linspace: [-0.6, 0.6, 50]" in text


def test_words_of_the_config_are_words(pages: dict[str, bytes]) -> None:
    page = Page(pages["map"])
    assert b"<script" not in pages["map"]
    assert page.title == EVIL
    assert EVIL in page.text
    assert not {tag for tag, _ in page.tags} & {"script", "iframe", "object", "link"}


def test_failures_are_counted_and_named(sweeps: Path, pages: dict[str, bytes]) -> None:
    runs = rs.load(sweeps / "map").runs
    bad = runs[runs["status"] != "ok"]
    assert len(bad) > 3
    text = Page(pages["map"]).text
    word, count = bad["status"].iloc[0], len(bad)
    first = bad.iloc[0]
    share = f"{100 * count / len(runs):.1f} %"
    assert f"{word} {count} {share} case {first['case']}, sample {first['sample']}" in text


def test_the_page_needs_nothing_else(pages: dict[str, bytes]) -> None:
    for data in pages.values():
        assert len(data) < 5e6
        for tag, attrs in Page(data).tags:
            for key in ("src", "href", "srcset", "action"):
                if attrs.get(key) is not None:
                    assert str(attrs[key]).startswith(("data:", "#")), (tag, attrs)
        assert not re.search(rb"@import|url\(", data)


def test_a_sweep_that_is_not_whole(sweeps: Path, tmp_path: Path) -> None:
    part = tmp_path / "part"
    shutil.copytree(sweeps / "map", part)
    (part / "runs" / "block-000002.parquet").unlink()
    store = Store(part)

    def stopped(manifest: Manifest) -> None:
        manifest.state = "stopped"
        manifest.expected = Expected(seconds=12.0, low=10.0, high=15.0, pilot_runs=5)
        del manifest.receipts[2]

    store.update_manifest(stopped)
    page = Page(make_report(part, "<b>&"))
    assert page.title == "<b>&"
    text = page.text
    assert "stopped: 350 of 450 runs are done" in text
    assert "time expected 12.0 s (10.0 s to 15.0 s)" in text
    assert "runs per second" not in text


def test_the_directory_is_read_once(sweeps: Path, made: Made) -> None:
    blocks = [name for name in made[1] if name.endswith(".parquet")]
    assert sorted(blocks) == sorted(map(str, sweeps.glob("*/runs/*.parquet")))


def test_many_cases_stay_small(tmp_path: Path) -> None:
    count = MOST_CASES + 500
    rs.sweep(
        {"bodies": {"source": "preset", "name": "GH"}, "model": "gh",
         "spin": {"n_i": {"linspace": [0.01, 0.5, count]}, "omega_xy0": 0.01}},
        output=tmp_path,
    )  # fmt: skip
    data = make_report(tmp_path)
    assert len(data) < 5e6
    assert "The other 500 cases are in summary.parquet." in Page(data).text


WRONG = {
    "no directory": (["nowhere"], 2, "nowhere: there is no such directory"),
    "no sweep": (["."], 2, "is not an output directory: it has no manifest.json"),
    "ending": (["one", "--output", "p.pdf"], 2, "the name must end in .html"),
    "no folder": (["one", "--output", "no/p.html"], 1, "cannot write no/p.html: No such file"),
    "read-only": (["one", "--output", "/proc/p.html"], 1, "cannot write /proc/p.html"),
    "damaged": (["broken"], 1, "broken/runs/block-000000.parquet is damaged"),
}


@pytest.fixture(scope="module")
def damaged(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A directory with a sweep of one run, and one that is damaged."""
    root = tmp_path_factory.mktemp("damaged")
    config = {"bodies": {"source": "preset", "name": "GH"}, "model": "gh",
              "spin": {"n_i": 0.1, "omega_xy0": 0.01}}  # fmt: skip
    for name in ("one", "broken"):
        rs.sweep(config, output=root / name)
    block = root / "broken" / "runs" / "block-000000.parquet"
    block.write_bytes(block.read_bytes()[:-200])
    return root


@pytest.mark.parametrize("case", WRONG)
def test_what_is_wrong_is_one_sentence(
    damaged: Path, monkeypatch: pytest.MonkeyPatch, case: str
) -> None:
    monkeypatch.chdir(damaged)
    before = tree(damaged)
    arguments, code, words = WRONG[case]
    assert_refused(invoke("report", *arguments), code, words)
    assert tree(damaged) == before


CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))),
                None)  # fmt: skip


def browse(page: Path, profile: Path, *options: str) -> subprocess.CompletedProcess[str]:
    """Open a page in a browser without a window."""
    assert CHROMIUM is not None
    return subprocess.run(
        [CHROMIUM, "--headless", "--no-sandbox", "--disable-gpu", "--no-first-run",
         "--disable-background-networking", "--disable-component-update", "--disable-sync",
         "--disable-quic", "--hide-scrollbars", "--enable-logging=stderr",
         f"--user-data-dir={profile}", *options, page.as_uri()],
        capture_output=True, text=True, check=True,
    )  # fmt: skip


@pytest.mark.skipif(CHROMIUM is None, reason="no Chromium here to open the page with")
def test_a_browser_shows_it(sweeps: Path, tmp_path: Path) -> None:
    target = tmp_path / "page.html"
    done = invoke("report", sweeps / "map", "--output", target)
    assert done.exit_code == 0, done.stderr
    assert done.stdout == f"{target}\n"
    control = tmp_path / "control.html"
    control.write_bytes(target.read_bytes().replace(b"</body>", b"<script>1</script></body>"))
    # What the page forbids is reported, so that silence says something.
    assert "CONSOLE" in browse(control, tmp_path / "profile", "--dump-dom").stderr
    seen = browse(target, tmp_path / "profile", "--dump-dom")
    assert "CONSOLE" not in seen.stderr
    page = Page(seen.stdout.encode())
    assert page.title == EVIL
    assert sum(tag == "img" for tag, _ in page.tags) == 2
    shot = tmp_path / "shot.png"
    seen = browse(target, tmp_path / "profile", "--window-size=1100,1300", f"--screenshot={shot}")
    assert "CONSOLE" not in seen.stderr
    pixels = matplotlib.image.imread(shot)[..., :3]
    present = set(rs.load(sweeps / "map").runs["type"].dropna())
    assert present == set(TYPE_STYLE) - {"D"}
    for name in present:
        near = np.abs(pixels - to_rgb(TYPE_STYLE[name][0])).max(axis=-1) < 0.02
        assert near.sum() > 100, name


@pytest.mark.skipif(CHROMIUM is None, reason="no Chromium here to open the page with")
@pytest.mark.parametrize("name", ["steady", "map"])
def test_a_narrow_page_does_not_scroll_sideways(
    pages: dict[str, bytes], tmp_path: Path, name: str
) -> None:
    """In a frame of 390 px, as a window of a headless browser is never narrower than 500."""
    target = tmp_path / "page.html"
    target.write_bytes(pages[name])
    frame = tmp_path / "frame.html"
    frame.write_text(
        f'<iframe id="f" width="390" height="800" src="{target.name}"></iframe><script>onload = '
        "() => { const d = document.getElementById('f').contentDocument; document.title = "
        "d.documentElement.clientWidth + ' ' + d.documentElement.scrollWidth; }</script>"
    )
    seen = browse(frame, tmp_path / "profile", "--allow-file-access-from-files", "--dump-dom")
    found = re.search(r"<title>(\d+) (\d+)</title>", seen.stdout)
    assert found is not None, seen.stdout[:500]
    assert int(found[2]) <= int(found[1])
    assert 300 < int(found[1]) <= 390


@pytest.mark.parametrize("title", ["a\x07b", "two\nlines", "\udcff"])
def test_titles_that_cannot_be_shown(sweeps: Path, tmp_path: Path, title: str) -> None:
    for command, target in (
        (["report", sweeps / "steady"], tmp_path / "p.html"),
        (["plot", sweeps / "steady"], tmp_path / "p.svg"),
        (["show", "--preset", "GH"], tmp_path / "p.html"),
    ):
        done = invoke(*command, "--title", title, "--output", target)
        assert done.exit_code == 2
        assert re.fullmatch(r"error: --title .*: \S+ in it is .*; leave it out\n", done.stderr)
    assert not list(tmp_path.iterdir())
