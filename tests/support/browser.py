# SPDX-License-Identifier: Apache-2.0
"""A browser, and what axe-core says of the accessibility of a page in it.

Chromium is that of the machine (`apt-get install chromium`).
"""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import axe_playwright_python
from playwright.sync_api import Browser, Page, sync_playwright

CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser"))), None)

AXE = Path(axe_playwright_python.__file__).with_name("axe.min.js")


@contextmanager
def open_browser() -> Iterator[Browser]:
    """Give a Chromium, which is closed at the end."""
    with sync_playwright() as playwright:
        # Chromium's sandbox does not work for root.
        arguments = ["--no-sandbox"] if os.geteuid() == 0 else []
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=arguments)
        yield browser
        browser.close()


def violations(page: Page) -> list[tuple[str, list[str]]]:
    """Return the rules of accessibility that a page violates, each with the elements."""
    found = page.evaluate(f"{AXE.read_text(encoding='utf-8')}\n;axe.run()")
    assert len(found["passes"]) > 20
    return [(each["id"], [at["html"] for at in each["nodes"]]) for each in found["violations"]]
