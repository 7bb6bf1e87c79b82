"""A page in Debian's Chromium without a window, driven by Playwright."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from playwright.sync_api import Page, sync_playwright

NAMES = ("chromium", "chromium-browser", "google-chrome", "chrome")
FLAGS = (
    "--no-sandbox",
    # The container's shared memory may be small.
    "--disable-dev-shm-usage",
    "--force-color-profile=srgb",
    # Software rendering draws the same on machines without a graphics card.
    "--use-gl=angle",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
)
PATIENCE = 120_000.0  # milliseconds


def find_browser() -> str | None:
    """Return the path of an installed Chromium, None if there is none."""
    for name in NAMES:
        path = shutil.which(name)
        if path is not None:
            return path
    return None


class Browser:
    """A page whose console and requests are kept; waits are for events."""

    def __init__(self, page: Page) -> None:
        self.page = page
        self.console: list[str] = []
        self.requests: list[str] = []
        page.set_default_timeout(PATIENCE)
        page.on("console", lambda message: self.console.append(message.text))
        page.on("pageerror", lambda error: self.console.append(str(error)))
        page.on("request", lambda request: self.requests.append(request.url))

    def open(self, path: Path) -> None:
        """Load a page made by `show`, and wait for its drawing."""
        self.page.goto(path.resolve().as_uri())
        self.until("globalThis.show !== undefined")
        self.frame()

    def run(self, expression: str) -> Any:
        """Return the value of a JavaScript expression, or of its promise."""
        return self.page.evaluate(expression)

    def until(self, expression: str) -> None:
        """Wait until a JavaScript expression is true."""
        while not self.run(expression):
            self.frame()

    def frame(self) -> None:
        """Wait until the page has drawn its changes."""
        self.run(
            "new Promise((f) => requestAnimationFrame(() => requestAnimationFrame(f)))"
        )


@contextmanager
def browser() -> Iterator[Browser]:
    """Start Chromium with a small page that prefers reduced motion, and quit it."""
    with sync_playwright() as playwright:
        chromium = playwright.chromium.launch(
            executable_path=find_browser(), args=FLAGS, timeout=PATIENCE
        )
        page = chromium.new_page(
            viewport={"width": 340, "height": 460}, reduced_motion="reduce"
        )
        yield Browser(page)
        chromium.close()
