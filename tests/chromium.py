"""Headless Chromium for the tests of pages, skipped with a reason where it is missing."""

import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import pytest

CHROMIUM_FLAGS = [
    "--no-sandbox",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
]


@contextmanager
def headless() -> Iterator[Any]:
    """A browser of playwright's."""
    playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed (the extra `checks`)")
    chromium = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    if chromium is None:
        pytest.skip("Chromium is not installed")
    with playwright.sync_playwright() as play:
        started = play.chromium.launch(executable_path=chromium, args=CHROMIUM_FLAGS)
        yield started
        started.close()


@contextmanager
def watched(browser: Any, url: str) -> Iterator[Callable[..., Any]]:
    """Opens pages at a URL, each in a context with the options that are given; in the end, fails on anything that the
    browser complained about or asked a network for."""
    complaints: list[str] = []
    contexts = []

    def opened(**options: Any) -> Any:
        contexts.append(browser.new_context(**options))
        page = contexts[-1].new_page()
        page.on("pageerror", lambda error: complaints.append(str(error)))
        page.on("console", lambda m: complaints.append(m.text) if m.type in ("error", "warning") else None)
        page.on("request", lambda r: complaints.append(r.url) if r.url != url and _outside(r.url) else None)
        page.goto(url)
        return page

    yield opened
    for context in contexts:
        context.close()
    assert [c for c in complaints if "GL Driver Message" not in c and "software WebGL" not in c] == []


def _outside(url: str) -> bool:
    return not url.startswith(("data:", "blob:"))
