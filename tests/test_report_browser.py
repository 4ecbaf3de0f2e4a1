"""The page of a comparison in headless Chromium: films, tables and curves, on paper, without scripts."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mipbake.comparing.page import write_report

from .chromium import watched
from .report_cases import NAMES, film_figures, film_grey, filmed, made_up, with_stacks

PHONE = {"width": 390, "height": 844}
DESKTOP = {"width": 1280, "height": 900}


FILMED = ("neural", "linear (box)", "lean (gaussian)")
FRAMES = 4


@pytest.fixture(scope="module")
def report(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Pictures of one colour each, so that a pixel tells which picture it is of."""
    films = tuple(filmed(name, FILMED, FRAMES) for name in ("floor", "wall"))
    made = made_up(NAMES, 48, films=films)
    rendered = [
        replace(
            each,
            reference=np.full_like(each.reference, 1.0),
            images={name: np.full_like(each.reference, 0.1 * (i + 1)) for i, name in enumerate(NAMES)},
        )
        for each in made.rendered
    ]
    jod = film_figures("floor", dict(zip(FILMED, (9.25, 9.0, 9.5), strict=True)))
    made, _ = with_stacks(replace(made, rendered=tuple(rendered), figures=(*made.figures, *jod)), (8, 8))
    return write_report(made, None, tmp_path_factory.mktemp("reports") / "report")[0]


@pytest.fixture
def opened(browser: Any, report: Path) -> Iterator[Any]:
    """Opens the report from disk (chromium.watched)."""
    with watched(browser, report.as_uri()) as page:

        def open_page(size: dict[str, int] = DESKTOP, motion: str = "reduce", **options: Any) -> Any:
            # Nothing scrolls smoothly then, so that places are where they were measured.
            return page(viewport=size, reduced_motion=motion, **options)

        yield open_page


def unfold(page: Any) -> None:
    page.evaluate("() => document.querySelectorAll('main details').forEach((part) => { part.open = true; })")


@pytest.mark.parametrize("size", [DESKTOP, {"width": 390, "height": 800}])
def test_the_view_and_the_verdict_are_seen_at_once_and_few_words(opened: Any, size: dict[str, int]) -> None:
    page = opened(size)
    view, verdict = page.locator("#view").bounding_box(), page.locator("#verdict").bounding_box()
    assert view["y"] + view["height"] <= size["height"] and verdict["y"] < size["height"]
    stage = page.locator(".mv-stage").bounding_box()
    assert stage["width"] > 0.94 * size["width"] and stage["height"] > 0.45 * size["height"]
    shown = page.locator("body").inner_text()
    assert len(shown.split()) < 1500
    assert not {"dB", "SNR", "FLIP", "lod"} & set(page.locator("#films, #table, #view").all_inner_texts())


@pytest.mark.parametrize(("size", "ratio"), [(PHONE, 3), (DESKTOP, 1)])
def test_a_pixel_covers_whole_pixels_of_the_screen(opened: Any, ratio: int, size: dict[str, int]) -> None:
    page = opened(size, device_scale_factor=ratio)
    unfold(page)
    for width, natural in page.evaluate(
        "() => [...document.querySelectorAll('#pictures .strip img, .films canvas')].map((picture) => "
        "[picture.getBoundingClientRect().width, picture.naturalWidth ?? picture.width])"
    ):
        assert width * ratio / natural == pytest.approx(ratio, abs=1e-3)


def test_a_phone_in_the_dark_shows_it_without_scrolling_sideways(opened: Any) -> None:
    page = opened(PHONE, device_scale_factor=2, is_mobile=True, has_touch=True, color_scheme="dark")
    assert page.evaluate("() => [document.documentElement.scrollWidth, innerWidth]") == [390, 390]
    ink, ground = page.evaluate(
        "() => [getComputedStyle(document.body).color, getComputedStyle(document.body).backgroundColor]"
        ".map((c) => c.match(/[0-9]+/g).slice(0, 3).reduce((sum, x) => sum + Number(x), 0))"
    )
    assert ink > ground + 400
    unfold(page)
    # The names at the ends of the curves lie within the drawing.
    assert page.evaluate(
        "() => [...document.querySelectorAll('.label.on')].every((label) => label.getBoundingClientRect().right <= "
        "label.ownerSVGElement.getBoundingClientRect().right)"
    )
    assert page.evaluate("() => document.documentElement.scrollWidth") == 390


def test_fields_are_named_and_tab_stops_at_what_scrolls_only(opened: Any) -> None:
    page = opened()
    assert page.evaluate(
        "() => [...document.querySelectorAll('main select, main input, main button')].filter((field) => "
        "!(field.labels?.length || field.textContent.trim() || field.getAttribute('aria-label'))).length"
    ) == 0  # fmt: skip
    unfold(page)
    page.wait_for_function(
        "() => [...document.querySelectorAll('.scroll, .strip[role]')].every((part) => "
        "part.hasAttribute('tabindex') === part.scrollWidth > part.clientWidth + 1)"
    )
    assert page.locator(".strip[tabindex='0']").count() >= 3
    names = page.evaluate("() => document.querySelector('.mipbake-viewer').viewer.choices.map((choice) => choice.name)")
    assert names == ["plain MIP maps", "mipbake"]


def test_curves_stand_out_and_are_read_by_a_pointer(opened: Any) -> None:
    page = opened()
    unfold(page)
    line = page.locator(".panel .line[data-method='lean (box)']").first
    label = page.locator(".panel .label[data-method='lean (box)']").first
    assert not label.is_visible() and "on" not in str(line.get_attribute("class")).split()
    page.get_by_role("checkbox", name="lean (box)").check()
    assert label.is_visible() and "on" in str(line.get_attribute("class")).split()
    heights = page.evaluate(
        "() => [...document.querySelectorAll('.panel:first-child .label.on')].map((l) => Number(l.getAttribute('y')))"
    )
    assert np.diff(sorted(heights)).min() >= 13.9 and len(heights) == 5
    drawing = page.locator(".plot svg").first
    drawing.scroll_into_view_if_needed()
    box = drawing.bounding_box()
    page.mouse.move(box["x"] + box["width"] * 0.45, box["y"] + box["height"] / 2)
    text = page.locator(".readout").first.inner_text()
    assert text.startswith("level of detail") and "neural" in text and "lean (box)" in text
    page.mouse.move(0, 0)
    assert not page.locator(".readout").first.is_visible()


def test_columns_sort_best_first_then_worst_then_as_they_were(opened: Any) -> None:
    page = opened()
    page.locator("#details > summary").click()
    table = page.locator("#figures table.figures").first
    names = lambda: table.locator("tbody th").all_inner_texts()  # noqa: E731
    assert names() == list(NAMES)
    far = table.get_by_role("button", name="far")
    far.click()
    best = names()
    assert best[:2] == ["optimum", "neural"]
    assert table.locator("th[aria-sort]").get_attribute("aria-sort") == "descending"
    far.press("Enter")
    assert names() == best[::-1]
    assert table.locator("th[aria-sort]").get_attribute("aria-sort") == "ascending"
    table.get_by_role("button", name="Method").click()
    assert names() == list(NAMES) and table.locator("th[aria-sort]").count() == 0


def test_paper_shows_what_is_folded_away(opened: Any) -> None:
    page = opened()
    page.emulate_media(media="print")
    page.evaluate("() => dispatchEvent(new Event('beforeprint'))")
    assert not page.locator(".clock").is_visible() and page.locator("#pictures img").first.is_visible()
    folded = "() => document.querySelectorAll('main details:not([open])').length"
    assert page.evaluate(folded) == 0
    page.evaluate("() => dispatchEvent(new Event('afterprint'))")
    assert page.evaluate(folded) >= 1


def test_a_first_page_becomes_the_whole_one_and_keeps_what_was_chosen(browser: Any, tmp_path: Path) -> None:
    made, source = with_stacks(made_up(FILMED, 16), (8, 8))
    first = write_report(replace(made, rendered=(), plots=(), figures=(), curve=()), source, tmp_path / "r", begun=True)
    context = browser.new_context(viewport=DESKTOP)
    page = context.new_page()
    page.goto(first[0].as_uri())
    viewer = "document.querySelector('.mipbake-viewer').viewer"
    assert page.locator("#begun").is_visible() and page.locator("#figures").count() == 0
    assert page.evaluate(f"() => {viewer}.choices.map((choice) => choice.name)") == [
        "plain MIP maps", "mipbake", "truth",
    ]  # fmt: skip
    page.evaluate(f"() => {viewer}.set({{ shape: 'sphere', dividers: [0.25, 0.5] }})")
    write_report(made, source, tmp_path / "r")
    page.wait_for_selector("#figures", state="attached")
    page.wait_for_function(f"() => {viewer}")
    assert page.evaluate(f"() => [{viewer}.view.shape, {viewer}.view.dividers]") == ["sphere", [0.25, 0.5]]
    assert page.locator("#begun").count() == 0
    context.close()


def test_without_scripts_everything_is_there(opened: Any) -> None:
    page = opened(java_script_enabled=False)
    frames = page.locator("#films .frame")
    assert frames.count() == 2 * 3 and frames.first.is_visible()
    box = frames.first.bounding_box()
    assert box["width"] / box["height"] == pytest.approx(36 / 24, rel=0.02)
    assert page.locator("table.seen").is_visible() and not page.locator(".clock").is_visible()
    page.locator("#details > summary").click()
    pictures = page.locator("#pictures .strip img")
    assert pictures.count() == 5 * (2 * len(NAMES) + 1) and pictures.first.is_visible()
    assert page.locator(".panel .line").count() == 2 * len(NAMES)
    assert page.locator("#figures table.figures").first.is_visible() and not page.get_by_role("checkbox").count()


# ---- films


GREYS = """(selector) => [...document.querySelectorAll(selector)].map((canvas) => {
    const one = new OffscreenCanvas(1, 1).getContext('2d', { willReadFrequently: true });
    one.drawImage(canvas, canvas.width / 2, canvas.height / 2, 1, 1, 0, 0, 1, 1);
    return one.getImageData(0, 0, 1, 1).data[0];
})"""


def greys(page: Any, selector: str = "#films canvas") -> list[int]:
    """The grey of every canvas."""
    known = np.array([film_grey(index, frame) for index in range(-1, len(FILMED)) for frame in range(FRAMES)])
    found = np.array(page.evaluate(GREYS, selector))
    nearest = known[np.abs(found[:, None] - known).argmin(1)]
    assert np.abs(nearest - found).max() <= 2  # films are encoded with loss
    return [int(grey) for grey in nearest]


def at(frame: int) -> list[int]:
    """What both films show at a frame: plain MIP maps, the subject, the truth."""
    return 2 * [film_grey(index, frame) for index in (1, 0, -1)]


def filming(opened: Any, motion: str = "reduce") -> Any:
    """A page whose films are all to be seen, and loaded."""
    page = opened({"width": 1280, "height": 4000}, motion)
    page.wait_for_function(f"() => ({GREYS})('#films canvas').every((grey) => grey > 0)")
    return page


def test_buttons_and_keys_show_single_frames_forwards_and_backwards(opened: Any) -> None:
    page = filming(opened)  # where less motion is wanted, films stand still
    assert greys(page) == at(0) and page.get_by_role("button", name="Play").is_visible()
    told = []
    for _ in range(5):
        page.get_by_role("button", name="The frame after").click()
        told.append(page.locator(".clock output").inner_text())
        assert greys(page) == at(int(told[-1].split()[1]) - 1)
    assert told == [f"frame {number} of 4" for number in (2, 3, 4, 3, 2)]
    page.get_by_role("button", name="The frame before").focus()
    for key, frame in ((".", 0), (",", 1), (",", 2), (",", 3), (",", 2)):
        page.keyboard.press(key)
        assert greys(page) == at(frame)
    unfold(page)
    page.wait_for_function(f"() => ({GREYS})('#others canvas').every((grey) => grey > 0)")
    assert greys(page, "#others canvas") == 2 * [film_grey(2, 2)]  # all other methods, in step with these


def test_the_space_bar_runs_all_films_in_step_and_stops_them(opened: Any) -> None:
    page = filming(opened, "no-preference")
    assert page.get_by_role("button", name="Stop").is_visible()  # films run from the start
    frames = [at(frame) for frame in range(FRAMES)]
    assert all(greys(page) in frames for _ in range(5))
    page.wait_for_function(f"() => (window.kept ??= new Set()).add(({GREYS})('#films canvas')[0]).size === {FRAMES}")
    page.locator("#films").focus()
    page.keyboard.press(" ")
    assert page.get_by_role("button", name="Play").is_visible()
    stopped = greys(page)
    page.wait_for_timeout(200)
    assert greys(page) == stopped and stopped in frames
