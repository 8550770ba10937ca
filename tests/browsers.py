"""An installed Chromium without a window, for tests that open a page as a person would."""

from __future__ import annotations

import os
import shutil
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest

NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome", "msedge")
MISSING = (
    "no Chromium found that could open the report; install one: `apt-get install chromium` (Debian), "
    "`dnf install chromium` (Fedora), or Google Chrome; on Windows Edge is there already"
)
# WebGL without a graphics card
ARGUMENTS = ("--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--ignore-gpu-blocklist")


@dataclass
class Opened:
    """A page, and what it said and asked for."""

    page: Any
    said: list[str] = field(default_factory=list)
    requested: list[str] = field(default_factory=list)


LONGEST_MS = 300_000.0
"""Longest that anything in a page is waited for: on a machine that is busy a page takes its time."""

_playing: list[Any] = []
_browsers: dict[bool, Any] = {}


def _browser(webgl: bool) -> Any:
    """A browser with or without WebGL, started when it is first asked for; see :func:`close_browsers`."""
    if webgl not in _browsers:
        from playwright.sync_api import sync_playwright

        found = next((there for name in NAMES if (there := shutil.which(name))), None)
        if found is None and sys.platform != "win32":
            if os.environ.get("CI"):
                pytest.fail(MISSING)
            pytest.skip(MISSING)
        where: dict[str, Any] = {"channel": "msedge"} if found is None else {"executable_path": found}
        arguments = ARGUMENTS if webgl else ("--disable-gpu", "--disable-3d-apis")
        if not _playing:
            _playing.append(sync_playwright().start())
        _browsers[webgl] = _playing[0].chromium.launch(
            args=list(arguments), chromium_sandbox=False, timeout=LONGEST_MS, **where
        )
    return _browsers[webgl]


def close_browsers() -> None:
    """End all browsers; for the end of each module, so that the tests of one share them."""
    while _browsers:
        _browsers.popitem()[1].close()
    while _playing:
        _playing.pop().stop()


@contextmanager
def opened(path: Path, *, webgl: bool = True, width: int = 1200, height: int = 900) -> Iterator[Opened]:
    """The page of a file; with the messages of its console and every request that it makes."""
    context = _browser(webgl).new_context(viewport={"width": width, "height": height})
    try:
        context.set_default_timeout(LONGEST_MS)
        seen = Opened(context.new_page())
        seen.page.on("console", lambda message: seen.said.append(f"{message.type}: {message.text}"))
        seen.page.on("pageerror", lambda error: seen.said.append(f"exception: {error}"))
        seen.page.on("request", lambda request: seen.requested.append(request.url))
        seen.page.goto(path.resolve().as_uri())
        yield seen
    finally:
        context.close()
