# SPDX-License-Identifier: Apache-2.0
"""The documentation site in a browser: formulas, links, both colour schemes, and accessibility.

The tests need Chromium, and the packages that `make docs` installs.
"""

from __future__ import annotations

import html
import re
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from importlib.util import find_spec
from pathlib import Path
from threading import Thread

import pytest
from fontTools.ttLib import TTFont
from playwright.sync_api import Browser, Page

from support.browser import needs_chromium, open_browser, violations

ROOT = Path(__file__).parents[2]
FORMULAS = ("index", "model", "lag", "response", "arrange")
PAGES = ("index", "model", "response", "python", "architecture")
WIDE, NARROW = (1280, 900), (390, 844)

SETTLED = """async () => {
  const frame = () => new Promise((done) => requestAnimationFrame(done));
  await frame();
  await frame();
  const scrolls = (code) => code.scrollWidth > code.clientWidth;
  const reached = (code) => !scrolls(code) || code.tabIndex === 0;
  return document.querySelector('html.js') &&
    [...document.querySelectorAll('pre > code')].every(reached);
}"""
"""Whether the script of the theme has run, and let the keyboard reach all code that scrolls.

On a busy machine, this is later than the last request.
"""

pytestmark = [
    needs_chromium,
    pytest.mark.skipif(find_spec("mkdocs") is None, reason="there is no MkDocs: make docs"),
]


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The directory of the site, built strictly."""
    directory = tmp_path_factory.mktemp("site")
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(directory)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return directory


class Quiet(SimpleHTTPRequestHandler):
    """A handler that does not log."""

    def log_message(self, *_: object) -> None:
        pass


@pytest.fixture(scope="module")
def address(site: Path) -> Iterator[str]:
    """The address at which the site is served, on the loopback device."""
    handler = partial(Quiet, directory=str(site))
    with ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
        thread = Thread(target=server.serve_forever)
        thread.start()
        yield f"http://127.0.0.1:{server.server_port}/"
        server.shutdown()
        thread.join()


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    with open_browser() as opened:
        yield opened


@contextmanager
def opening(browser: Browser, url: str, size: tuple[int, int], scheme: str) -> Iterator[Page]:
    """Open a page. It must log nothing and request nothing from other servers."""
    context = browser.new_context(
        viewport={"width": size[0], "height": size[1]},
        color_scheme="dark" if scheme == "dark" else "light",
    )
    page, logged, requested = context.new_page(), [], []
    page.on("console", lambda message: logged.append(message.text))
    page.on("pageerror", lambda error: logged.append(str(error)))
    page.on("request", lambda request: requested.append(request.url))
    page.goto(url, wait_until="networkidle")
    page.wait_for_function(SETTLED)
    try:
        yield page
        assert logged == []
        server = url.rpartition("/")[0]
        assert [each for each in requested if not each.startswith(server)] == []
    finally:
        context.close()


@pytest.mark.slow
@pytest.mark.parametrize("name", PAGES)
def test_a_page_needs_no_other_server_and_links_the_pages_beside_it(
    browser: Browser, address: str, name: str
) -> None:
    with opening(browser, f"{address}{name}.html", WIDE, "light") as page:
        links = {
            side: page.locator(f".md-footer__link--{side}").get_attribute("href")
            for side in ("prev", "next")
            if page.locator(f".md-footer__link--{side}").count()
        }
        assert links.keys() == ({"next"} if name == "index" else {"prev", "next"})
        page.locator(".md-footer__link--next").click()
        page.wait_for_url(f"{address}{links['next']}")


@pytest.mark.slow
@pytest.mark.parametrize("name", FORMULAS)
def test_formulas_are_drawn(browser: Browser, address: str, name: str) -> None:
    with opening(browser, f"{address}{name}.html", WIDE, "light") as page:
        boxes = page.locator("math").evaluate_all(
            "all => all.map((one) => [one.getBoundingClientRect().width,"
            " one.getBoundingClientRect().height])"
        )
        assert boxes
        assert min(width for width, _ in boxes) > 3
        assert min(height for _, height in boxes) > 3
        assert page.evaluate("document.fonts.check('16px \"Flock Math\"')")
        words = page.evaluate(
            "() => { const copy = document.querySelector('article').cloneNode(true);"
            " copy.querySelectorAll('code').forEach((code) => code.remove());"
            " return copy.textContent; }"
        )
        assert not re.findall(r"\$|\\[a-z]+", words)


def test_the_font_has_all_characters_of_formulas(site: Path) -> None:
    pages = "".join(page.read_text(encoding="utf-8") for page in site.glob("*.html"))
    texts = re.findall(r">([^<]+)<", "".join(re.findall(r"<math.*?</math>", pages, re.DOTALL)))
    used = {ord(character) for text in texts for character in html.unescape(text)}
    drawn = TTFont(site / "assets" / "math.woff").getBestCmap().keys()
    invisible = {0x20, 0x2061, 0x2063}  # function application and separator
    assert used - drawn - invisible == set()
    assert {ord("√"), ord("𝑥"), ord("𝜆")} <= drawn  # what browsers draw for <msqrt> and variables


@pytest.mark.slow
@pytest.mark.parametrize(("size", "scheme"), [(WIDE, "light"), (NARROW, "dark")])
@pytest.mark.parametrize("name", PAGES)
def test_axe_finds_nothing_amiss_and_nothing_is_wider_than_the_screen(
    browser: Browser, address: str, name: str, size: tuple[int, int], scheme: str
) -> None:
    with opening(browser, f"{address}{name}.html", size, scheme) as page:
        assert page.evaluate("document.documentElement.scrollWidth") <= size[0]
        assert violations(page) == []


@pytest.mark.slow
def test_figures_are_on_a_light_card_in_the_dark_scheme(browser: Browser, address: str) -> None:
    with opening(browser, f"{address}response.html", WIDE, "dark") as page:
        colour = "(one) => getComputedStyle(one).backgroundColor"
        assert page.locator("article img").first.evaluate(colour) == "rgb(255, 255, 255)"
        body = page.locator("body").evaluate(colour)
        assert sum(map(int, re.findall(r"\d+", body)[:3])) < 150
