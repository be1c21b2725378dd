# SPDX-License-Identifier: Apache-2.0
"""A browser, and what axe-core says of the accessibility of a page in it.

Chromium is that of the machine (`apt-get install chromium-headless-shell`, or `chromium`).
"""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import axe_playwright_python
import pytest
from playwright.sync_api import Browser, Page, sync_playwright

NAMES = ("chromium-headless-shell", "chromium", "chromium-browser")
"""The names of Chromium. The first one has no windows of its own to draw, and needs less time."""

CHROMIUM = next(filter(None, map(shutil.which, NAMES)), None)

needs_chromium = pytest.mark.skipif(
    CHROMIUM is None, reason="there is no Chromium: apt-get install chromium-headless-shell"
)

AXE = Path(axe_playwright_python.__file__).with_name("axe.min.js")

RUN_AXE = """
(async () => {
  const told = {resultTypes: ['violations']};
  const all = await axe.run({...told, rules: {'color-contrast': {enabled: false}}});
  const contrast = await axe.run({exclude: ['math']}, {...told, runOnly: ['color-contrast']});
  const found = [...all.violations, ...contrast.violations].map(
    (each) => [each.id, each.nodes.map((at) => at.html)]);
  const style = (one) => [getComputedStyle(one).color, getComputedStyle(one).backgroundColor] + '';
  const coloured = [...document.querySelectorAll('math, math *')].filter((one) => style(one) !=
    [getComputedStyle(one.closest('math').parentElement).color, 'rgba(0, 0, 0, 0)'] + '');
  if (coloured.length) found.push(['formula-colour', coloured.map((one) => one.outerHTML)]);
  return [all.passes.length, found];
})()
"""
"""Runs axe and returns [number of rules passed, [[rule violated, [element, ...]], ...]].

axe takes half a minute for the contrast of the formulas of a long page. They must have the colours
of the text around them instead, whose contrast axe checks. Without `resultTypes`, axe also
describes all elements that pass, which takes longer than the check.
"""


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
    passed, violated = page.evaluate(f"{AXE.read_text(encoding='utf-8')}\n;{RUN_AXE}")
    assert passed > 20
    return [(rule, elements) for rule, elements in violated]
