"""Make docs/show.webp: the page of `rattlesweep show --preset GH`, as it moves.

Needs Chromium and Playwright, as the tests of the page do.
"""

import io
import tempfile
from pathlib import Path

from PIL import Image
from playwright.sync_api import sync_playwright

import rattlesweep as rs

FRAMES = 80
MILLISECONDS = 90  # of a frame
LAST = 220.0  # sqrt(a/g), of 250
WINDOW = {"width": 1180, "height": 720}
SIZE = (760, 464)
TARGET = Path(__file__).parents[1] / "show.webp"
FLAGS = ["--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader"]

with tempfile.TemporaryDirectory() as folder, sync_playwright() as playwright:
    page = Path(folder) / "rattleback.html"
    rs.show("GH", n_i=0.1, omega_xy0=0.01, t_end=250, path=page)
    chromium = playwright.chromium.launch(
        executable_path="/usr/bin/chromium",
        args=[*FLAGS, "--enable-unsafe-swiftshader"],
    )
    window = chromium.new_page(viewport=WINDOW, reduced_motion="reduce")
    window.goto(page.as_uri())
    window.wait_for_function("globalThis.show !== undefined")
    window.evaluate("show.state.playing && document.querySelector('#play').click()")
    frames = []
    for frame in range(FRAMES):
        window.evaluate(f"show.goTo({LAST * frame / FRAMES})")
        window.evaluate(
            "new Promise((f) => requestAnimationFrame(() => requestAnimationFrame(f)))"
        )
        shot = Image.open(io.BytesIO(window.screenshot()))
        frames.append(shot.convert("RGB").resize(SIZE, Image.Resampling.LANCZOS))
    chromium.close()

frames[0].save(
    TARGET,
    save_all=True,
    append_images=frames[1:],
    duration=MILLISECONDS,
    loop=0,
    quality=60,
    method=6,
)
