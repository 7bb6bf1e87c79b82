"""The page that moves: what it holds, what is drawn, and that its controls work in a browser."""

from __future__ import annotations

import base64
import hashlib
import io
import json
import math
import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from browser import NO_WEBGL, WEBGL, Browser, browser, find_browser
from scipy.spatial.transform import Rotation
from sweeping import invoke, rows, run

import rattlesweep as rs
from rattlesweep.analysis.onerun import show
from rattlesweep.analysis.onerun.course import PreparedRun
from rattlesweep.sweeps.launches import Launch

GH = rs.Rattleback.gh()
T_END = 130.0
needs_browser = pytest.mark.skipif(find_browser() is None, reason="no Chromium is installed")


@cache
def scene(t_end: float = T_END, points: int | None = None, **launch: Any) -> dict[str, Any]:
    run = Launch(GH, t_end=t_end, **({"n_i": 0.1, "omega_xy0": 0.01} | launch))
    return show.make_scene(show.course_of(PreparedRun.of(run), points))


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("page") / "gh.html"
    result = invoke("show", "--preset", "GH", "--t-end", T_END, "--output", path)
    assert result.exit_code == 0
    assert result.stdout == f"{path}\n"
    assert re.match(r"0\.\d MB\n1 reversal at 112\.09387", result.stderr)
    return path


def held(text: str) -> dict[str, Any]:
    """The data of a page."""
    found = re.search(r'<script type="application/json" id="data">(.*?)</script>', text, re.DOTALL)
    assert found is not None
    data: dict[str, Any] = json.loads(found[1])
    return data


# The paraboloid of Eq. def-z in the paper's own form, z = 1 - s.R Theta R^-1.s / 2.
COS, SIN = math.cos(GH.xi), math.sin(GH.xi)
TURN = np.array([[COS, -SIN], [SIN, COS]])
SURFACE = TURN @ np.diag([GH.theta, GH.phi]) @ TURN.T


def turns(q: Any) -> Any:
    """Rotation matrices of quaternions, scalar first."""
    return Rotation.from_quat(np.asarray(q), scalar_first=True).as_matrix()


def lowest(matrix: Any) -> Any:
    """Lowest point of the paraboloid in the body's frame, where its height has no slope."""
    s = np.linalg.solve(SURFACE, matrix[2, :2] / matrix[2, 2])
    return np.array([*s, 1 - 0.5 * s @ SURFACE @ s])


# -- the data ------------------------------------------------------------------------------------


def test_the_body_rolls_without_slipping():
    """The material point in contact stands still: by differences of the shown columns alone."""
    c = scene(t_end=60.0, points=6001)["columns"]
    step = c["t"][1]
    q = np.stack([c[f"q{k}"] for k in range(4)], axis=1)
    assert np.abs(np.linalg.norm(q, axis=1) - 1).max() < 1e-14
    assert np.abs(np.diff(q, axis=0)).max() < 0.01
    matrix = turns(q)
    touch = np.stack([c["trace_x"], c["trace_y"], np.zeros_like(c["t"])], axis=1)
    weights = np.array([-1, 9, -45, 0, 45, -9, 1]) / (60 * step)
    rolling = []
    for i in range(3, len(c["t"]) - 3, 97):
        m, at = matrix[i - 3 : i + 4], touch[i - 3 : i + 4]
        low = np.stack([lowest(one) for one in m])
        centre = at - np.einsum("tij,tj->ti", m, low)
        assert np.abs(weights @ (centre + m @ low[3])).max() < 1e-9
        rolling.append(np.linalg.norm(weights @ at))
    # The contact itself wanders all the while.
    assert max(rolling) > 1e-3


def test_the_body_is_cut_off_above_every_contact():
    found = scene(t_end=400.0, n_i=0.5, omega_xy0=0.3)
    matrix = turns(np.stack([found["columns"][f"q{k}"] for k in range(4)], axis=1))
    highest = max(1 - lowest(m)[2] for m in matrix)
    assert found["rise"] >= max(1, 1.2 * highest)


def test_the_page_holds_the_columns_and_names_no_address(page):
    text = page.read_text()
    data, found = held(text), scene()
    table = np.frombuffer(base64.b64decode(data["table"]), dtype="<f4")
    table = table.reshape(-1, len(data["columns"]))
    for k, name in enumerate(data["columns"]):
        assert np.array_equal(table[:, k], found["columns"][name].astype(np.float32))
    # The name of a language, which is no address.
    assert set(re.findall(r"https?://[^\s\"'`)]+", text)) == {"http://www.w3.org/1999/xhtml"}
    assert "default-src 'none'" in text
    assert "The MIT License" in text
    assert "@@" not in text
    # The largest page is below 5 MB.
    many = {name: np.resize(column, show.MOST_ROWS) for name, column in found["columns"].items()}
    assert len(show.make_page(found | {"columns": many}, "a", "b")) < 5e6


def test_words_cannot_become_markup(tmp_path):
    title, path = "</title><script>alert('1')</script> & @@data@@", tmp_path / "p.html"
    invoke("show", "--preset", "GH", "--t-end", 5, "--title", title, "--output", path)
    text = path.read_text()
    assert "alert('1')" not in text
    assert text.count("&lt;/title&gt;&lt;script&gt;") == 2
    assert "&amp; @@data@@" in text
    found = scene(t_end=5.0) | {"facts": [("a", "</script><script>")]}
    assert held(show.make_page(found, "a", "b").decode())["facts"] == [["a", "</script><script>"]]


# -- what it is made of --------------------------------------------------------------------------

PAGE = Path(show.__file__).parent / "page"


def test_the_bundle_is_what_is_recorded():
    data = (PAGE / "three.min.js").read_bytes()
    recorded, name = (PAGE / "three.min.js.sha256").read_text().split()
    assert (name, hashlib.sha256(data).hexdigest()) == ("three.min.js", recorded)
    wanted = json.loads((PAGE / "package.json").read_text())["devDependencies"]
    locked = json.loads((PAGE / "package-lock.json").read_text())["packages"]
    assert locked[""]["devDependencies"] == wanted
    assert {name: locked[f"node_modules/{name}"]["version"] for name in wanted} == wanted
    assert data.startswith(f"/*! three.js {wanted['three']}\n".encode())
    # By checksum alone, wherever one has packages from.
    pinned = [package for name, package in locked.items() if name]
    assert all(package["integrity"].startswith("sha512-") for package in pinned)
    assert not any("resolved" in package for package in pinned)


# -- the command ---------------------------------------------------------------------------------


def test_a_stored_run_is_shown_and_proved(tmp_path):
    output, path = tmp_path / "out", tmp_path / "new" / "r.html"
    assert run("gh.yaml", output, "spin.n_i=[0.1]").exit_code == 0
    t_r = float(rows(output)["t_r"].iloc[0])
    result = invoke("show", output, "--where", 'type == "R"', "--output", path,
                    "--t-end", 150)  # fmt: skip
    assert result.exit_code == 0
    assert f"case 0, sample 0: t_r {t_r!r} and type R as stored, bit for bit" in result.stderr
    assert held(path.read_text())["reversals"] == [t_r]


# -- a real browser ------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def window() -> Iterator[Browser]:
    with browser(*WEBGL) as one:
        yield one


def open_page(window: Browser, page: Path) -> Browser:
    """The page anew, in a small window, since software draws slowly."""
    window.console.clear()
    window.requests.clear()
    window.size(340, 460)
    window.open(page)
    window.frame()
    return window


@pytest.fixture(scope="module")
def opened(window: Browser, page: Path) -> Browser:
    """The page, once for the tests that follow: to draw it first takes most of their time."""
    return open_page(window, page)


@pytest.fixture
def still(opened: Browser) -> Iterator[Browser]:
    """The page at rest at its beginning; nothing is complained of."""
    opened.run("show.state.playing && document.querySelector('#play').click()")
    opened.run("show.goTo(0); scrollTo(0, 0)")
    opened.frame()
    yield opened
    assert opened.console == []


def pixels(window: Browser) -> Any:
    """The drawn canvas, shape (height, width, 4)."""
    import matplotlib.image

    x, y, width, height = window.run(
        "(() => { const b = document.querySelector('#view').getBoundingClientRect();"
        "return [b.x, b.y, b.width, b.height]; })()"
    )
    image = matplotlib.image.imread(io.BytesIO(window.screenshot()))
    return image[round(y) : round(y + height), round(x) : round(x + width)]


def time_of(window: Browser) -> float:
    return float(window.run("show.state.t"))


def text_of(window: Browser, element: str) -> str:
    return str(window.run(f"document.querySelector('#{element}').textContent"))


@needs_browser
def test_it_draws_and_asks_nothing_of_anyone(still, page):
    first = pixels(still)
    # A body of some size before a plane, not one colour.
    assert first[..., :3].std() > 0.05
    still.run("show.goTo(100)")
    still.frame()
    assert np.mean(np.abs(pixels(still) - first).max(axis=2) > 0.02) > 0.02
    assert still.console == []
    assert set(still.requests) == {page.resolve().as_uri()}
    # The page forbids itself the network.
    asked = "fetch('http://127.0.0.1:9/').then(() => 'sent', () => 'refused')"
    assert still.run(asked) == "refused"
    assert any("Content Security Policy" in line for line in still.console)
    still.console.clear()


@needs_browser
def test_the_drawn_body_touches_the_plane_and_hardly_slips(still):
    times = np.sort(
        np.concatenate([scene()["columns"]["t"][7:500:61], np.linspace(3.01, 128.9, 30)])
    )
    step = 1e-3
    asked = np.concatenate([times, times - step, times + step]).tolist()
    poses = still.run(
        f"{json.dumps(asked)}.map((t) => {{ const p = show.pose(t); "
        "return [...p.q, ...p.contact, ...p.centre]; })"
    )
    now, before, after = np.array(poses).reshape(3, len(times), 10)
    exact = rs.trajectory(GH, n_i=0.1, omega_xy0=0.01, t_end=T_END, times=times,
                          channels=["trace_x", "trace_y"]).table.to_numpy()  # fmt: skip
    assert np.abs(now[:, 4:6] - exact).max() < 1e-4 * np.ptp(exact, axis=0).max()
    slips, speeds = [], []
    for one, two, three in zip(now, before, after, strict=True):
        m = turns(one[:4])
        low = lowest(m)
        # The lowest point of the true surface is on the plane, and where the trace is.
        assert np.abs(one[7:] + m @ low - one[4:7]).max() < 1e-12
        ends = [p[7:] + turns(p[:4]) @ low for p in (two, three)]
        slips.append(np.linalg.norm(ends[1] - ends[0]))
        speeds.append(np.linalg.norm(three[4:7] - two[4:7]))
    assert max(slips) < 2e-4 * max(speeds)


@needs_browser
def test_keys_and_buttons_work(still):
    still.key(" ", "Space")
    still.until("show.state.playing && show.state.t > 0.2")
    still.key(" ", "Space")
    assert still.run("show.state.playing") is False
    stopped = time_of(still)
    still.frame()
    assert time_of(still) == stopped
    speed = still.run("show.state.speed")
    still.key("Home")
    assert time_of(still) == 0
    for key in ("ArrowRight", "ArrowRight", "ArrowLeft"):
        still.key(key)
    assert time_of(still) == pytest.approx(speed)
    still.key("End")
    assert time_of(still) == pytest.approx(T_END)
    still.key(".")
    assert still.run("show.state.speed") == pytest.approx(1.25 * speed)
    still.key("x")
    assert still.run("document.querySelector('#glass').getAttribute('aria-pressed')") == "true"
    still.click("#play")
    # From the end it begins again.
    still.until("show.state.playing && show.state.t < 100")
    still.click("#play")
    still.mouse(still.centre("#scrub"))
    assert time_of(still) == pytest.approx(T_END / 2, rel=0.05)
    still.run("show.goTo(112)")
    still.frame()
    there = still.centre("#cursor")
    still.key("Home")
    still.mouse(there)
    assert time_of(still) == pytest.approx(112, abs=T_END / 200)
    still.frame()
    assert float(text_of(still, "t")) == pytest.approx(time_of(still), abs=0.06)
    n = float(text_of(still, "n").replace("−", "-"))
    exact = rs.trajectory(GH, n_i=0.1, omega_xy0=0.01, t_end=T_END, times=[time_of(still)])
    assert n == pytest.approx(float(exact.table["n"][0]), abs=1e-4)
    still.click("#follow")
    assert still.run("show.state.follow") is False
    still.click("#follow")


@needs_browser
def test_without_webgl_the_spin_is_there_all_the_same(page):
    with browser(*NO_WEBGL) as window:
        open_page(window, page)
        assert "no WebGL" in text_of(window, "message")
        assert window.run("document.querySelector('#message').hidden") is False
        window.key("ArrowRight")
        window.frame()
        assert float(text_of(window, "t")) > 0
        drawn = window.run(
            "document.querySelector('#curve').getContext('2d').getImageData(0, 0, 300, 200)"
            ".data.some((v) => v > 0)"
        )
        assert drawn is True
        assert window.console == []
