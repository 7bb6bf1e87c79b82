"""The page that moves: what it holds, what is drawn, and that its controls work in a
browser.
"""

from __future__ import annotations

import base64
import io
import json
import math
import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

import matplotlib.image
import numpy as np
import pytest
from browser import SCHEMES, WIDTHS, Browser, needs_browser, window
from scipy.spatial.transform import Rotation
from sweeping import invoke, rows, run

import rattlesweep as rs
from rattlesweep.analysis.onerun import show
from rattlesweep.analysis.onerun.course import PreparedRun
from rattlesweep.design.launch import Launch
from rattlesweep.words.quantities import DRIVES, LOSSES

GH = rs.Rattleback.gh()
T_END = 130.0


@cache
def scene(t_end: float = T_END) -> dict[str, Any]:
    run = Launch(GH, n_i=0.1, omega_xy0=0.01, t_end=t_end)
    return show.make_scene(show.course_of_page(PreparedRun.of(run), None))


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("page") / "gh.html"
    result = invoke("show", "--preset", "GH", "--t-end", T_END, "--output", path)
    assert result.exit_code == 0
    assert result.stdout == f"{path}\n"
    assert re.match(r"0\.\d MB\n1 reversal at 112\.09387", result.stderr)
    return path


def held(text: str) -> Any:
    """The data of a page."""
    return json.loads(
        text.split('<script type="application/json" id="data">')[1].split("</")[0]
    )


# The paraboloid of Eq. 4 in the paper's own form, z = 1 - s.R Theta R^-1.s / 2.
COS = math.cos(GH.xi)
SIN = math.sin(GH.xi)
TURN = np.array([[COS, -SIN], [SIN, COS]])
SURFACE = TURN @ np.diag([GH.theta, GH.phi]) @ TURN.T


def turns(q: Any) -> Any:
    """Rotation matrices of quaternions, scalar first."""
    return Rotation.from_quat(np.asarray(q), scalar_first=True).as_matrix()


def lowest(matrix: Any) -> Any:
    """Lowest point of the paraboloid in the body's frame, where its height has no
    slope.
    """
    s = np.linalg.solve(SURFACE, matrix[2, :2] / matrix[2, 2])
    return np.array([*s, 1 - 0.5 * s @ SURFACE @ s])


def test_the_page_holds_the_columns_and_names_no_address(page):
    text = page.read_text()
    data = held(text)
    columns = scene()["columns"]
    table = np.frombuffer(base64.b64decode(data["table"]), dtype="<f4")
    table = table.reshape(-1, len(data["columns"]))
    for k, name in enumerate(data["columns"]):
        assert np.array_equal(table[:, k], columns[name].astype(np.float32))
    # The name of a language, which is no address.
    assert set(re.findall(r"https?://[^\s\"'`)]+", text)) == {
        "http://www.w3.org/1999/xhtml"
    }
    assert "default-src 'none'" in text
    assert "The MIT License" in text
    # The largest page is below 5 MB.
    many = {
        name: np.resize(column, show.MOST_FRAMES) for name, column in columns.items()
    }
    assert len(show.make_page(scene() | {"columns": many}, "a", "b")) < 5e6


def test_the_facts_of_a_body_of_known_size_are_in_its_units():
    launch = Launch(
        KL := rs.Rattleback.kl(),
        n_i=0.2,
        omega_xy0=0.02,
        losses={"sigma": 1e-3},
        t_end=150.0,
    )
    run = PreparedRun.of(launch)
    facts = dict(show.make_scene(show.course_of_page(run, None))["facts"])
    t_rgh = rs.reversal_time_gh(KL, n_i="0.2 sqrt(g/a)", omega_xy0="0.02 sqrt(g/a)")
    assert facts["t_rGH"] == f"{t_rgh * KL.units.time:.6g} s"
    assert facts["dissipation"].endswith(" N m s")


def test_a_plane_that_shakes_is_no_dissipation():
    losses = {"sigma": 1e-3, "base_frequency": 2.5, "base_acceleration": 0.1}
    launch = Launch(GH, n_i=0.1, omega_xy0=0.01, losses=losses, t_end=9.0)
    run = PreparedRun.of(launch)
    assert run.acting(LOSSES) == "σ 0.001 M a^2 √(g/a)"
    assert run.acting(DRIVES) == "Ω 2.5 √(g/a), ε 0.1"
    assert run.losses == "σ 0.001 M a^2 √(g/a), Ω 2.5 √(g/a), ε 0.1"


def test_words_cannot_become_markup(tmp_path):
    title = "</title><script>alert('1')</script> & @@data@@"
    path = tmp_path / "p.html"
    invoke("show", "--preset", "GH", "--t-end", 5, "--title", title, "--output", path)
    text = path.read_text()
    assert "alert('1')" not in text
    assert "&amp; @@data@@" in text
    evil = scene(t_end=5.0) | {"facts": [("a", "</script><script>")]}
    assert held(show.make_page(evil, "a", "b").decode())["facts"] == [
        ["a", "</script><script>"]
    ]


def test_a_stored_run_is_shown_and_proved(tmp_path):
    output = tmp_path / "out"
    path = tmp_path / "r.html"
    assert run("gh.yaml", output, "spin.n_i=[0.1]").exit_code == 0
    t_r = float(rows(output)["t_r"].iloc[0])
    result = invoke(
        "show", output, "--where", 'type == "R"', "--output", path, "--t-end", 150
    )
    assert result.exit_code == 0
    assert f"case 0, sample 0: t_r {t_r!r} " in result.stderr
    assert held(path.read_text())["reversals"] == [t_r]


@pytest.fixture(scope="module")
def opened(page: Path, chromium: Any) -> Iterator[Browser]:
    """The page, once for the tests that follow: to draw it first takes most of their
    time.
    """
    with window(chromium) as it:
        it.open(page)
        yield it


@pytest.fixture
def still(opened: Browser) -> Iterator[Browser]:
    """The page at rest at its beginning; nothing is complained of."""
    opened.run("show.state.playing && document.querySelector('#play').click()")
    opened.run("show.goTo(0); scrollTo(0, 0)")
    opened.frame()
    yield opened
    assert opened.console == []


def pixels(opened: Browser) -> Any:
    """The window with the drawing at its top, shape (height, width, 4)."""
    return matplotlib.image.imread(io.BytesIO(opened.page.screenshot()))


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
    times = np.union1d(scene()["columns"]["t"][7:500:61], np.linspace(3.01, 128.9, 30))
    step = 1e-3
    asked = np.concatenate([times, times - step, times + step]).tolist()
    poses = still.run(
        f"{json.dumps(asked)}.map((t) => {{ const p = show.pose(t); "
        "return [...p.q, ...p.contact, ...p.centre]; })"
    )
    now, before, after = np.array(poses).reshape(3, len(times), 10)
    exact = rs.trajectory(
        GH,
        n_i=0.1,
        omega_xy0=0.01,
        t_end=T_END,
        times=times,
        channels=["trace_x", "trace_y"],
    ).table.to_numpy()
    assert np.abs(now[:, 4:6] - exact).max() < 1e-4 * np.ptp(exact, axis=0).max()
    slips = []
    speeds = []
    for pose, earlier, later in zip(now, before, after, strict=True):
        attitude = turns(pose[:4])
        low = lowest(attitude)
        # The lowest point of the true surface is on the plane, and where the trace is.
        assert np.abs(pose[7:] + attitude @ low - pose[4:7]).max() < 1e-12
        ends = [p[7:] + turns(p[:4]) @ low for p in (earlier, later)]
        slips.append(np.linalg.norm(ends[1] - ends[0]))
        speeds.append(np.linalg.norm(later[4:7] - earlier[4:7]))
    assert max(slips) < 2e-4 * max(speeds)


@needs_browser
def test_keys_and_buttons_work(still):
    def state(name: str) -> Any:
        return still.run(f"show.state.{name}")

    still.page.keyboard.press("Space")
    still.until("show.state.playing && show.state.t > 0.2")
    still.page.keyboard.press("Space")
    assert state("playing") is False
    still.page.keyboard.press("End")
    assert state("t") == pytest.approx(T_END)
    still.page.click("#play")
    # From the end it begins again.
    still.until("show.state.playing && show.state.t < 100")
    still.page.click("#play")
    still.page.click("#scrub")
    assert state("t") == pytest.approx(T_END / 2, rel=0.05)
    still.frame()
    n = float(still.run("document.querySelector('#n').textContent").replace("−", "-"))
    exact = rs.trajectory(GH, n_i=0.1, omega_xy0=0.01, t_end=T_END, times=[state("t")])
    assert n == pytest.approx(float(exact.table["n"][0]), abs=1e-4)


@pytest.mark.slow
@needs_browser
def test_the_keyboard_plays_steps_and_resets(still):
    """Only keys are pressed, from the top of the page on."""

    def focused() -> str:
        return str(still.run("document.activeElement.id"))

    def tab_to(name: str) -> None:
        for _ in range(12):
            if focused() == name:
                return
            still.page.keyboard.press("Tab")
        raise AssertionError(f"{name} cannot be reached")

    still.run("document.activeElement.blur()")
    tab_to("play")
    outline = "getComputedStyle(document.activeElement).outlineStyle"
    assert still.run(outline) == "solid"
    still.page.keyboard.press("Enter")
    still.until("show.state.playing && show.state.t > 0.2")
    still.page.keyboard.press("Enter")
    assert still.run("show.state.playing") is False
    still.page.keyboard.press("Home")
    still.page.keyboard.press("ArrowRight")
    step = still.run("show.state.t")
    assert step == pytest.approx(still.run("show.state.speed"))
    still.page.keyboard.press("ArrowLeft")
    assert still.run("show.state.t") == 0
    # The camera follows the body, so its place is counted from there.
    scene = "show.scene.camera.position.clone().sub(show.scene.orbit.target)"
    camera = f"{scene}.toArray()"
    before = still.run(camera)
    still.page.keyboard.press("Shift+ArrowLeft")
    still.frame()
    assert still.run(camera) != pytest.approx(before)
    tab_to("reset")
    still.page.keyboard.press("Enter")
    still.frame()
    assert still.run(camera) == pytest.approx(before)


@pytest.mark.slow
@needs_browser
@pytest.mark.parametrize(("width", "scheme"), [*zip(WIDTHS, SCHEMES, strict=True)])
def test_it_fits_and_can_be_read(page, chromium, width, scheme):
    with window(chromium, width, 900, scheme) as it:
        it.open(page)
        assert it.overflow() <= 0
        assert it.barriers() == []
        assert it.console == []
