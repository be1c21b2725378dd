# SPDX-License-Identifier: Apache-2.0
"""The report in a real browser: animated, without network requests, and accessible.

axe-core checks the accessibility.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from itertools import islice
from pathlib import Path

import numpy as np
import pytest
from playwright.sync_api import Browser, Page, expect

from flock_sim.configuration.flock_configuration import FlockConfiguration
from flock_sim.physics.scaling import Scales
from flock_sim.recording import flight_bag
from flock_sim.reference.integrator import Reference
from flock_tools.commands.report import tool
from flock_tools.runs.dataset import load
from support.browser import needs_chromium, open_browser, violations
from support.flights import record

HOSTILE = "<script>document.title = 'taken'</script><img src=x onerror=alert(1)>"
WIDE, NARROW = (1280, 900), (390, 844)
LARGEST = 3_000_000
THIRTEEN = FlockConfiguration(t_max=300.0, record_every=1)
PARTED = FlockConfiguration(birds=7, t_max=4000.0, record_every=1, span_ratios=("4=0.7",))
CHARTS = (
    *("speed", "spacing", "drag_reduction", "speed_std", "mean_drag_reduction"),
    *("profile", "residual", "eigenvalues"),
)
PARTS = ("flight", "theory", "configuration", "provenance")

pytestmark = needs_chromium

Opener = Callable[..., Page]


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    with open_browser() as opened:
        yield opened


@pytest.fixture(scope="module")
def parted(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A long flight whose leader, which is too small, is left behind."""
    return record(tmp_path_factory.mktemp("parted") / "run", PARTED)


@pytest.fixture(scope="module")
def pages(tmp_path_factory: pytest.TempPathFactory, parted: Path) -> dict[str, Path]:
    """Reports on one flight, on runs compared, on many members, on a long one, and on markup."""
    directory = tmp_path_factory.mktemp("reports")
    one = record(directory / "one", THIRTEEN)
    start = record(directory / "start", THIRTEEN, states=islice(Reference(THIRTEEN).fly(), 1))
    alone = record(directory / "alone", FlockConfiguration(birds=1, t_max=20.0))
    all_to_all = record(directory / "all", FlockConfiguration(t_max=200.0, coupling="all"))
    many = record(
        directory / "members", FlockConfiguration(t_max=100.0, span_ratios=("4=0.9,1.0,1.1",))
    )
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(flight_bag, "__version__", HOSTILE)
        markup = record(directory / "<script>x", FlockConfiguration(birds=3, t_max=20.0))
    runs = {
        "one": [one],
        "long": [parted],
        "compared": [one, all_to_all, many],
        "members": [many],
        "markup": [markup],
        "start": [start],
        "alone": [alone],
    }
    made = {name: directory / f"{name}.html" for name in runs}
    for name, paths in runs.items():
        assert tool([*map(str, paths), "--output", str(made[name])]) == 0
    return made


@contextmanager
def opening(browser: Browser, path: Path, size: tuple[int, int], scheme: str) -> Iterator[Page]:
    """Give an opened page; it may complain of nothing, and ask for nothing but itself."""
    context = browser.new_context(
        viewport={"width": size[0], "height": size[1]},
        color_scheme="dark" if scheme == "dark" else "light",
    )
    page, said, asked = context.new_page(), [], []
    page.on("console", lambda message: said.append(message.text))
    page.on("pageerror", lambda error: said.append(str(error)))
    page.on("dialog", lambda dialog: (said.append(dialog.message), dialog.dismiss()))
    page.on("request", lambda request: asked.append(request.url))
    page.goto(path.as_uri())
    try:
        yield page
        assert said == []
        assert [url for url in asked if not url.startswith("data:")] == [path.as_uri()]
    finally:
        context.close()


@pytest.fixture
def opened(browser: Browser, pages: dict[str, Path]) -> Iterator[Opener]:
    """Open one page after the other, in a window of a size and a colour scheme."""
    with ExitStack() as stack:

        def opener(name: str, size: tuple[int, int] = WIDE, scheme: str = "light") -> Page:
            return stack.enter_context(opening(browser, pages[name], size, scheme))

        yield opener


def picture(page: Page, name: str) -> str:
    """Return the pixels of a canvas."""
    return str(page.evaluate(f"document.getElementById('{name}').toDataURL()"))


def open_table(page: Page, name: str) -> None:
    """Open the table beside a picture."""
    page.locator(f"#{name}-table").evaluate("table => { table.closest('details').open = true; }")
    expect(page.locator(f"#{name}-table thead")).to_be_visible()


def positions(page: Page) -> list[str]:
    """Return where the table beside the formation says that each bird is along the flight."""
    open_table(page, "formation")
    cells = page.locator("#formation-table tbody td:nth-child(3)")
    return [text.strip() for text in cells.all_text_contents()]


@pytest.mark.slow
def test_the_slider_moves_the_birds_and_the_cursor_of_the_curves(opened: Opener) -> None:
    page = opened("one")
    before, drawn = positions(page), picture(page, "formation")
    assert len(before) == 13
    cursor = page.locator("#speed ~ .cursor")
    end = cursor.bounding_box()
    page.locator("#time").fill("0")
    assert page.locator("#now").text_content() == "t = 0"
    start = cursor.bounding_box()
    assert start
    assert end
    assert start["x"] < end["x"]
    assert picture(page, "formation") != drawn
    moved = positions(page)
    assert moved != before
    # They start in a V of 45 degrees behind the leader: see docs/model.md.
    across = page.locator("#formation-table tbody td:nth-child(2)").all_text_contents()
    for aside, along in zip(across, moved, strict=True):
        assert float(along) == pytest.approx(-abs(float(aside)), rel=1e-4, abs=1e-4)
    page.locator("#time").focus()
    page.keyboard.press("ArrowRight")
    assert positions(page) != moved


def cells(page: Page, table: str, row: int) -> list[str]:
    """Return the cells of a row, from 0, of the table beside a picture."""
    open_table(page, table)
    texts = page.locator(f"#{table}-table tbody tr").nth(row).locator("td").all_text_contents()
    return [text.strip() for text in texts]


def test_tables_tell_of_the_time_that_is_shown_however_long_the_run(
    opened: Opener, parted: Path
) -> None:
    page, bag = opened("long"), load(parted)
    scales = Scales.of(PARTED)
    page.locator("#time").evaluate("slider => { slider.value = 30; }")
    for event in ("input", "change"):
        page.locator("#time").dispatch_event(event)
    open_table(page, "speed")
    head = page.locator("#speed-table thead th").all_text_contents()
    time = float(head[2].removeprefix("at t = "))
    at, start = (bag.sel(time=t, method="nearest").isel(member=0) for t in (time, 0.0))
    assert float(at.time) == time
    for bird in range(7):  # six digits are told
        speeds = [float(text) for text in cells(page, "speed", bird)]
        assert speeds[0] == pytest.approx(float(start.speed[bird]), rel=5e-6)
        assert speeds[1] == pytest.approx(float(at.speed[bird]), rel=5e-6)
        of_all = bag.speed[:, bird, 0]
        assert speeds[2:] == pytest.approx([float(of_all.min()), float(of_all.max())], rel=5e-6)
        saved = [float(text) for text in cells(page, "drag_reduction", bird)]
        drag = [float(row.interaction_drag[bird]) / scales.cruise_drag for row in (start, at)]
        assert saved[:2] == pytest.approx([-100.0 * value for value in drag], rel=5e-6)


def test_the_bird_from_which_positions_are_measured_is_named(opened: Opener, parted: Path) -> None:
    page, bag = opened("long"), load(parted)
    end = bag.position.isel(time=-1, member=0).to_numpy()
    middle = int(np.argsort(end)[3])
    words = str(page.locator("#away").text_content())
    assert "The leader, bird 4, is far from the others" in words
    assert f"positions are from bird {middle + 1}." in words
    told = [float(text) for text in positions(page)]
    assert told == pytest.approx((end - end[middle]).tolist(), rel=1e-4, abs=1e-3)
    page.locator("#time").fill("0")
    assert "The leader" not in str(page.locator("#away").text_content())


def test_the_flight_is_played_to_its_end(opened: Opener) -> None:
    page = opened("one")
    ended = page.locator("#now").text_content()
    page.locator("#time").evaluate("slider => { slider.value = slider.max - 2; }")
    page.locator("#time").dispatch_event("input")
    assert page.locator("#now").text_content() != ended
    page.locator("#play").click()
    expect(page.locator("#now")).to_have_text(str(ended))
    expect(page.locator("#play")).to_have_text("Play")


def test_a_click_in_a_curve_goes_to_its_time(opened: Opener) -> None:
    page = opened("one")
    page.locator("#speed").click(position={"x": 73, "y": 60})
    assert page.locator("#now").text_content() in ("t = 0", "t = 1")


def test_tabs_are_walked_by_keyboard_and_show_their_part(opened: Opener) -> None:
    page = opened("one")
    panels = page.locator("[role=tabpanel]")
    assert panels.count() == len(PARTS)
    page.locator("#tab-flight").focus()
    for key, part in [
        ("ArrowRight", "theory"),
        ("ArrowRight", "configuration"),
        ("End", "provenance"),
        ("ArrowRight", "flight"),
        ("ArrowLeft", "provenance"),
        ("Home", "flight"),
    ]:
        page.keyboard.press(key)
        assert page.evaluate("document.activeElement.id") == f"tab-{part}"
        assert [each for each in PARTS if page.locator(f"#{each}").is_visible()] == [part]
        assert page.locator(f"#tab-{part}").get_attribute("aria-selected") == "true"
    assert "stable" in str(page.locator(".cards").text_content())
    page.locator("#tab-theory").click()
    assert "b from the exact steady state" in str(page.locator("#profile-words").text_content())
    open_table(page, "eigenvalues")
    assert page.locator("#eigenvalues-table tbody tr").count() == 25


def test_everything_that_is_operated_is_reached_by_the_tab_key(opened: Opener) -> None:
    page = opened("compared")
    reached = set()
    for _ in range(80):
        page.keyboard.press("Tab")
        reached.add(page.evaluate("document.activeElement.id || document.activeElement.className"))
    assert {"pick", "run", "bird", "from", "tab-flight", "play", "time", *CHARTS[:5]} <= reached


def test_members_and_runs_are_browsed(opened: Opener) -> None:
    page = opened("members")
    seen = {picture(page, "spacing")}
    for _ in range(2):
        page.locator("#after").click()
        seen.add(picture(page, "spacing"))
    assert len(seen) == 3
    assert page.locator("#member").input_value() == "2"
    page.get_by_role("button", name="member 2").click()
    assert page.locator("#member").input_value() == "1"
    assert page.locator("tr[aria-current=true]").count() == 1
    page = opened("compared")
    drawn = picture(page, "speed")
    page.locator("#run").select_option("1")
    assert picture(page, "speed") != drawn
    assert page.locator("#legend li").count() == 3


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("size", [WIDE, NARROW])
@pytest.mark.parametrize("name", ["one", "compared"])
@pytest.mark.slow
def test_axe_finds_nothing_amiss(
    opened: Opener, name: str, size: tuple[int, int], scheme: str
) -> None:
    page = opened(name, size, scheme)
    # All at once, as on paper: each look of axe at the page costs seconds.
    page.evaluate("window.dispatchEvent(new Event('beforeprint'))")
    page.evaluate("document.querySelectorAll('details').forEach((each) => { each.open = true; })")
    assert [each for each in PARTS if page.locator(f"#{each}").is_visible()] == list(PARTS)
    assert page.evaluate("document.documentElement.scrollWidth") <= size[0]
    assert violations(page) == []


@pytest.mark.parametrize("size", [WIDE, NARROW])
@pytest.mark.parametrize("name", ["one", "compared", "members", "start", "markup"])
def test_nothing_is_wider_than_the_screen_or_cropped(
    opened: Opener, name: str, size: tuple[int, int]
) -> None:
    page = opened(name, size)
    for part in PARTS:
        page.locator(f"#tab-{part}").click()
        assert page.evaluate("document.scrollingElement.scrollWidth <= innerWidth"), part
        cropped = page.evaluate(
            """[...document.querySelectorAll(".stack, .cards, .cards dd, .choice, .facts dd")]
            .filter((each) => each.scrollWidth > each.clientWidth
                || each.getBoundingClientRect().right > innerWidth)
            .map((each) => each.outerHTML.slice(0, 200))"""
        )
        assert cropped == [], part


def hover(page: Page, name: str, part: float, height: float = 0.5) -> list[str]:
    """Point at a part of the width and height of a chart; return the lines of its tip."""
    canvas = page.locator(f"#{name}")
    canvas.scroll_into_view_if_needed()
    box = canvas.bounding_box()
    assert box
    page.mouse.move(box["x"] + part * box["width"], box["y"] + height * box["height"])
    tip = page.locator(f"#{name} ~ .tip")
    return tip.locator("b, span").all_text_contents() if tip.is_visible() else []


def number(text: str) -> float:
    """Return a number that the page shows: 1.2 × 10⁻⁵ or −0.5."""
    factor, _, power = text.replace("−", "-").strip().partition(" × 10")
    superscripts = str.maketrans("⁻⁰¹²³⁴⁵⁶⁷⁸⁹", "-0123456789")
    return float(factor) * 10.0 ** int(power.translate(superscripts) or 0)


@pytest.mark.parametrize(
    ("chart", "unit", "factor"), [("speed", "Umin", 1.0), ("drag_reduction", "%", 100.0)]
)
def test_the_pointer_shows_the_values_of_the_bag(
    opened: Opener, pages: dict[str, Path], chart: str, unit: str, factor: float
) -> None:
    page, bag = opened("one"), load(pages["one"].with_suffix(""))
    title, *rows = hover(page, chart, 0.3)
    at = bag.sel(time=float(title.removeprefix("t = "))).isel(member=0)
    assert 50.0 < float(at.time) < 120.0  # of 300; the frame begins right of the numbers
    values = (
        at.speed if chart == "speed" else -at.interaction_drag / Scales.of(THIRTEEN).cruise_drag
    )
    assert rows[-1] == "and 6 more"
    assert len(rows) == 8
    for row in rows[:-1]:
        name, _, text = row.partition(": ")
        value = float(values.sel(bird=int(name.removeprefix("bird "))))
        assert text.endswith(f" {unit}")
        assert number(text.removesuffix(unit)) == pytest.approx(factor * value, rel=2e-6)


def test_the_pointer_shows_least_and_largest_of_rows_that_are_drawn_together(
    opened: Opener, parted: Path
) -> None:
    page, bag = opened("long"), load(parted)
    title, *rows = hover(page, "speed", 0.12, 0.2)
    first, last = (float(time) for time in title.removeprefix("t = ").split(" to "))
    assert last > first
    near = page.locator("#speed ~ .tip .near").text_content()
    assert near in rows
    name, _, text = str(near).partition(": ")
    shown = [number(part) for part in text.removesuffix(" Umin").split(" to ")]
    speeds = bag.speed.sel(time=slice(first, last), bird=int(name.removeprefix("bird ")))
    assert shown[0] == pytest.approx(float(speeds.min()), rel=2e-6)
    assert shown[-1] == pytest.approx(float(speeds.max()), rel=2e-6)


def test_runs_are_read_together_until_each_ends(opened: Opener) -> None:
    page = opened("compared")
    names = [["one", "all", "members"], ["one", "all"], ["one"]]
    for part, those in zip((0.3, 0.5, 0.85), names, strict=True):
        for chart in ("speed_std", "mean_drag_reduction"):
            rows = hover(page, chart, part)[1:]
            assert sorted(row.partition(":")[0] for row in rows) == sorted(those)
    # The same bird in each run, whichever is the nearest.
    *rows, rest = hover(page, "speed", 0.3)[1:]
    assert rest == "and 36 more"
    bird = rows[0].partition(":")[0].partition(", ")[2]
    those = [f"{run}, {bird}" for run in ("all", "members", "one")]
    assert sorted(row.partition(":")[0] for row in rows) == those
    page.locator("#bird").select_option("3")
    rows = hover(page, "speed", 0.3)[1:]
    those = [f"{run}, bird 3" for run in ("all", "members", "one")]
    assert sorted(row.partition(":")[0] for row in rows) == those


def test_a_drag_zooms_all_charts_of_time_and_the_zoom_is_reset(opened: Opener) -> None:
    page = opened("one")
    field_from, field_to = page.locator("#from"), page.locator("#to")
    whole = {name: picture(page, name) for name in CHARTS[:5]}
    assert (field_from.input_value(), field_to.input_value()) == ("0", "300")
    hover(page, "speed", 0.4)
    page.mouse.down()
    hover(page, "speed", 0.6)
    page.mouse.up()
    start, end = float(field_from.input_value()), float(field_to.input_value())
    assert 80.0 < start < end < 200.0
    assert all(picture(page, name) != whole[name] for name in whole)
    for part in (0.2, 0.9):
        assert start <= float(hover(page, "spacing", part)[0].removeprefix("t = ")) <= end
    # A drag is not a click: the formation stays at the end.
    assert page.locator("#now").text_content() == "t = 300"
    page.locator("section:has(#spacing) .reset").click()
    assert {name: picture(page, name) for name in whole} == whole
    field_to.fill("100")
    field_to.press("Enter")
    assert picture(page, "speed") != whole["speed"]
    page.locator("#speed").dblclick()
    assert picture(page, "speed") == whole["speed"]
    page.locator("#speed").press("+")
    assert float(field_to.input_value()) - float(field_from.input_value()) == pytest.approx(150.0)
    page.locator("#speed").press("Escape")
    assert (field_from.input_value(), field_to.input_value()) == ("0", "300")


def test_charts_of_theory_are_read_and_zoomed_by_keyboard(opened: Opener) -> None:
    page = opened("one")
    page.locator("#tab-theory").click()
    for name, said in (("profile", "gap "), ("residual", "gap ")):
        whole = picture(page, name)
        page.locator(f"#{name}").focus()
        page.keyboard.press("ArrowRight")
        assert said in str(page.locator("#spoken").text_content())
        assert page.locator(f"#{name} ~ .tip").is_visible()
        page.keyboard.press("+")
        assert picture(page, name) != whole
        page.keyboard.press("Escape")
        assert picture(page, name) == whole


def test_the_legend_hides_curves(opened: Opener) -> None:
    page = opened("one")
    button = page.get_by_role("button", name="bird 3", exact=True)
    page.locator("#bird").select_option("3")
    assert [row.partition(":")[0] for row in hover(page, "speed", 0.5)[1:]] == ["bird 3"]
    drawn = {name: picture(page, name) for name in ("speed", "spacing")}
    button.click()
    assert button.get_attribute("aria-pressed") == "false"
    assert hover(page, "speed", 0.5) == []
    for name in drawn:
        assert picture(page, name) != drawn[name]
        assert "legend" in page.locator(f"#{name} ~ .empty").inner_text()
    button.click()
    assert {name: picture(page, name) for name in drawn} == drawn
    page = opened("compared")
    page.locator("#legend button").nth(1).click()
    assert [row.partition(":")[0] for row in hover(page, "mean_drag_reduction", 0.5)[1:]] == ["one"]


def test_a_chart_without_curves_says_why(opened: Opener) -> None:
    page = opened("start")
    assert "only the start" in page.locator("#speed_std ~ .empty").inner_text()
    assert page.locator("#speed ~ .empty").is_hidden()
    assert hover(page, "speed", 0.14)[0] == "t = 0"
    page = opened("alone")
    assert page.locator("#spacing ~ .empty").inner_text() == "A single bird has no spacings."
    assert "single bird" in page.locator("#speed_std ~ .empty").inner_text()
    page = opened("long")  # no formation of these birds has a steady state
    page.locator("#tab-theory").click()
    for name in ("residual", "eigenvalues"):
        assert "no steady state" in page.locator(f"#{name} ~ .empty").inner_text()


def test_configurations_that_differ_come_first(opened: Opener) -> None:
    page = opened("compared")
    rows = page.locator("section[aria-labelledby=differences] tbody tr")
    differing = ["coupling (differs)", "t_max (differs)", "record_every (differs)"]
    differing.append("span_ratios (differs)")
    assert rows.locator("th").all_text_contents() == differing
    assert all(row.is_visible() for row in rows.all())
    page.locator("#tab-configuration").click()
    keys = page.locator("#configuration tbody th")
    assert keys.all_text_contents()[:5] == [*differing, "birds"]


def test_dark_mode_is_dark(opened: Opener) -> None:
    shades = {}
    for scheme in ("light", "dark"):
        page = opened("one", WIDE, scheme)
        shades[scheme] = [
            sum(map(int, page.evaluate(f"getComputedStyle(document.body).{what}")[4:-1].split(",")))
            for what in ("backgroundColor", "color")
        ]
    assert shades["light"][0] > 600 > 300 > shades["light"][1]
    assert shades["dark"][0] < 150 < 600 < shades["dark"][1]


def test_markup_in_what_was_recorded_is_shown_as_text(opened: Opener) -> None:
    page = opened("markup")
    assert "<script>x" in str(page.locator("h1").text_content())
    page.locator("#tab-provenance").click()
    assert HOSTILE in page.locator("#provenance").inner_text()
    assert page.locator("img").count() == 0
    assert page.locator("script").count() == 2
    assert page.title().startswith("Flock report: ")


@pytest.mark.slow
def test_long_runs_fit_in_one_file(
    browser: Browser, pages: dict[str, Path], tmp_path: Path
) -> None:
    long = record(tmp_path / "long", FlockConfiguration(t_max=1e5))
    one = pages["one"].with_suffix("")
    for name, runs in {"long": [long], "both": [long, one, long, one]}.items():
        page = tmp_path / f"{name}.html"
        assert tool([*map(str, runs), "--output", str(page)]) == 0
        assert page.stat().st_size < LARGEST
        with opening(browser, page, WIDE, "light") as shown:
            assert positions(shown)
