"""A page in Debian's Chromium without a window, driven by Playwright."""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Literal

import pytest
from axe_playwright_python.base import AXE_SCRIPT
from playwright.sync_api import Browser as Chromium
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
WIDTHS = (1400, 390)  # of a screen and of a telephone
SCHEMES: tuple[Literal["light", "dark"], ...] = ("light", "dark")
# What axe-core checks: WCAG 2.1 up to level AA, with the contrast of texts.
RULES = ("wcag2a", "wcag2aa", "wcag21a", "wcag21aa")


def find_browser() -> str | None:
    """Return the path of an installed Chromium, None if there is none.

    With RATTLESWEEP_TESTS_BROWSER there has to be one.
    """
    if named := os.environ.get("RATTLESWEEP_TESTS_BROWSER"):
        return shutil.which(named) or named
    for name in NAMES:
        path = shutil.which(name)
        if path is not None:
            return path
    return None


needs_browser = pytest.mark.skipif(
    find_browser() is None, reason="no Chromium is installed"
)


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

    def overflow(self) -> int:
        """Return by how many pixels the page is wider than the window."""
        width: int = self.run("document.scrollingElement.scrollWidth - innerWidth")
        return width

    def barriers(self) -> list[str]:
        """Return what axe-core finds on the page that keeps people out."""
        self.run(AXE_SCRIPT)
        options = {"runOnly": list(RULES), "resultTypes": ["violations"]}
        found = []
        for rule in self.run(f"axe.run({json.dumps(options)})")["violations"]:
            for node in rule["nodes"]:
                found.append(f"{rule['id']}: {node['html']}: {node['failureSummary']}")
        return found


@contextmanager
def launched() -> Iterator[Chromium]:
    """Start Chromium, and quit it."""
    with sync_playwright() as playwright:
        chromium = playwright.chromium.launch(
            executable_path=find_browser(), args=FLAGS, timeout=PATIENCE
        )
        yield chromium
        chromium.close()


@contextmanager
def window(
    chromium: Chromium,
    width: int = 340,
    height: int = 460,
    scheme: Literal["light", "dark"] = "light",
) -> Iterator[Browser]:
    """Open an empty page that prefers reduced motion, and close it."""
    page = chromium.new_page(
        viewport={"width": width, "height": height},
        reduced_motion="reduce",
        color_scheme=scheme,
    )
    yield Browser(page)
    page.close()


def check_page(chromium: Chromium, path: Path) -> None:
    """Check that a page without scripts fits, is readable, and complains of nothing."""
    for width, scheme in zip(WIDTHS, SCHEMES, strict=True):
        with window(chromium, width, 900, scheme) as opened:
            opened.page.goto(path.resolve().as_uri())
            assert opened.overflow() <= 0
            assert opened.barriers() == []
            assert opened.console == []
