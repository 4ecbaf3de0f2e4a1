"""Films of a report in headless Chromium: in step, by keys and buttons, still where a reader wants less motion."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from mipbake.comparing.page import write_report

from .chromium import watched
from .report_cases import film_figures, film_grey, filmed, made_up

FEW = ("neural", "linear (box)", "lean (gaussian)")
FRAMES = 4


@pytest.fixture(scope="module")
def report(tmp_path_factory: pytest.TempPathFactory) -> Path:
    films = tuple(filmed(name, FEW, FRAMES) for name in ("floor", "wall"))
    jod = dict(zip(FEW, (9.25, 9.0, 9.5), strict=True))
    made = made_up(FEW, 16, films=films, figures=tuple(film_figures("floor", jod)), plots=())
    return write_report(made, {}, None, tmp_path_factory.mktemp("reports") / "report")[0]


@pytest.fixture
def opened(browser: Any, report: Path) -> Iterator[Any]:
    """Opens the report from disk (chromium.watched)."""
    with watched(browser, report.as_uri()) as page:

        def open_page(motion: str = "reduce", width: int = 1280, **options: Any) -> Any:
            return page(viewport={"width": width, "height": 2400}, reduced_motion=motion, **options)

        yield open_page


GREYS = """(selector) => [...document.querySelectorAll(selector)].map((canvas) => {
    const one = new OffscreenCanvas(1, 1).getContext('2d', { willReadFrequently: true });
    one.drawImage(canvas, canvas.width / 2, canvas.height / 2, 1, 1, 0, 0, 1, 1);
    return one.getImageData(0, 0, 1, 1).data[0];
})"""


def greys(page: Any, selector: str = ".film canvas") -> list[int]:
    """The grey of every canvas."""
    found: list[int] = page.evaluate(GREYS, selector)
    return found


def settled(page: Any) -> None:
    """Waits until every canvas shows a frame."""
    page.wait_for_function(f"() => ({GREYS})('.film canvas').every((grey) => grey > 0)")


def at(frame: int) -> list[int]:
    """What a film shows at a frame: A, B, then the strip: the reference and all methods."""
    return [film_grey(index, frame) for index in (1, 0, -1, 0, 1, 2)]


def test_films_stand_still_where_less_motion_is_wanted_and_all_show_one_frame(opened: Any) -> None:
    page = opened()
    settled(page)
    assert greys(page) == 2 * at(0)
    page.wait_for_timeout(200)
    assert greys(page) == 2 * at(0)
    assert page.locator(".clock output").inner_text() == "frame 1 of 4"
    assert page.get_by_role("button", name="Play").is_visible()


def test_buttons_and_keys_show_single_frames_forwards_and_backwards(opened: Any) -> None:
    page = opened()
    settled(page)
    shown = []
    for _ in range(5):
        page.get_by_role("button", name="The frame after").click()
        shown.append(page.locator(".clock output").inner_text())
        frame = int(shown[-1].split()[1]) - 1
        assert greys(page) == 2 * at(frame)
    assert shown == [f"frame {number} of 4" for number in (2, 3, 4, 3, 2)]
    for key, frame in ((".", 0), (",", 1)):  # the button that was clicked has the focus
        page.keyboard.press(key)
        assert greys(page) == 2 * at(frame)
    page.locator(".film .divider").first.focus()
    for key, frame in ((",", 2), (",", 3), (",", 2), (".", 3)):
        page.keyboard.press(key)
        assert greys(page) == 2 * at(frame)


def test_the_space_bar_runs_all_films_in_step_and_stops_them(opened: Any) -> None:
    page = opened("no-preference")
    settled(page)
    assert page.get_by_role("button", name="Stop").is_visible()  # films run from the start
    frames = [2 * at(frame) for frame in range(FRAMES)]
    found = [greys(page) for _ in range(40)]
    assert all(each in frames for each in found)
    page.wait_for_function(f"() => (window.kept ??= new Set()).add(({GREYS})('.film canvas')[0]).size === {FRAMES}")
    page.locator(".film .divider").first.focus()
    page.keyboard.press(" ")
    assert page.get_by_role("button", name="Play").is_visible()
    stopped = greys(page)
    page.wait_for_timeout(200)
    assert greys(page) == stopped and stopped in frames
    page.keyboard.press(" ")
    assert page.get_by_role("button", name="Stop").is_visible()


def test_films_have_a_bar_and_a_divider_of_their_own(opened: Any) -> None:
    page = opened()
    settled(page)
    films = page.locator("#films")
    films.get_by_label("Left, A").select_option("reference")
    assert greys(page, ".film .side canvas") == 2 * [film_grey(-1, 0), film_grey(0, 0)]
    assert page.locator("#pictures").get_by_label("Left, A").input_value() == "linear (box)"
    divider = films.locator(".divider").first
    divider.press("ArrowRight")
    assert divider.get_attribute("aria-valuenow") == "52"
    films.locator(".strip > figure").filter(has_text="lean (gaussian)").first.click()
    assert films.get_by_label("Left, A").input_value() == "lean (gaussian)"
    assert greys(page, ".film .side canvas") == 2 * [film_grey(2, 0), film_grey(0, 0)]
    assert "9.25 JOD" in films.locator(".measured").first.inner_text()
    films.get_by_label("Zoom").select_option("4")
    assert "scale(4)" in str(films.locator(".side canvas").first.get_attribute("style"))


def test_a_phone_shows_films_without_scrolling_sideways(opened: Any) -> None:
    page = opened(width=390)
    settled(page)
    assert page.evaluate("() => document.documentElement.scrollWidth") <= 390
    assert page.locator(".clock output").bounding_box()["x"] + 60 < 390


def test_without_scripts_the_first_frame_of_every_film_is_seen(opened: Any) -> None:
    page = opened(java_script_enabled=False)
    frames = page.locator(".film .frame")
    assert frames.count() == 8
    box = frames.first.bounding_box()
    assert box["width"] / box["height"] == pytest.approx(36 / 24, rel=0.02)
    assert not page.locator("#films .bar").is_visible()
