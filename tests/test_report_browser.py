"""The page of a comparison in headless Chromium: dividers, films, tables and curves, on paper, without scripts."""

from __future__ import annotations

import io
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

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


def shown(value: float) -> int:
    """The byte that a display is sent for a radiance."""
    x = value / (1 + value)
    return round(255 * (1.055 * x ** (1 / 2.4) - 0.055))


def colours(page: Any, selector: str, *places: tuple[float, float]) -> list[int]:
    """Red at places of an element, each a share of its width and height."""
    picture = np.asarray(Image.open(io.BytesIO(page.locator(selector).first.screenshot())).convert("RGB"))
    height, width = picture.shape[:2]
    return [int(picture[int(y * height), int(x * width), 0]) for x, y in places]


STAGE = "#pictures .scene .stage"
NEURAL, LINEAR, REFERENCE = shown(0.1), shown(0.2), shown(1.0)


def test_a_divider_parts_the_two_chosen_pictures(opened: Any) -> None:
    page = opened()
    section, divider = page.locator("#pictures"), page.locator("#pictures .divider").first
    assert colours(page, STAGE, (0.3, 0.5), (0.7, 0.5)) == [LINEAR, NEURAL]  # the subject to the right
    section.get_by_label("Left, A").select_option("reference")
    assert colours(page, STAGE, (0.3, 0.5), (0.7, 0.5)) == [REFERENCE, NEURAL]
    box = page.locator(STAGE).first.bounding_box()
    page.mouse.move(box["x"] + box["width"] / 2, box["y"] + box["height"] / 4)
    page.mouse.down()
    page.mouse.move(box["x"] + 0.8 * box["width"], box["y"] + box["height"] / 4)
    page.mouse.up()
    assert colours(page, STAGE, (0.7, 0.5), (0.9, 0.5)) == [REFERENCE, NEURAL]
    assert divider.get_attribute("aria-valuenow") == "80"
    strip = section.locator(".scene").first.locator(".strip > figure")
    strip.filter(has_text="optimum").locator(".render").click()
    strip.filter(has_text="lean (box)").locator(".render").click(modifiers=["Shift"])
    assert section.get_by_label("Left, A").input_value() == "optimum"
    assert section.get_by_label("Right, B").input_value() == "lean (box)"
    assert colours(page, STAGE, (0.7, 0.5), (0.9, 0.5)) == [shown(0.7), shown(0.4)]
    assert strip.filter(has_text="optimum").get_attribute("data-at") == "A"
    assert (divider.get_attribute("role"), divider.get_attribute("tabindex")) == ("slider", "0")
    assert "Sphere, near" in str(divider.get_attribute("aria-label"))
    for key, at in (("End", 100), ("ArrowLeft", 98), ("PageDown", 88), ("ArrowUp", 90), ("Home", 0)):
        divider.press(key)
        assert divider.get_attribute("aria-valuenow") == str(at)
        assert f"{at} %" in str(divider.get_attribute("aria-valuetext"))
    # By keys alone: Tab leads from the last field to the first divider.
    section.get_by_label("Zoom").focus()
    page.keyboard.press("Tab")
    assert page.evaluate("() => document.activeElement === document.querySelector('#pictures .divider')")


def test_flip_maps_figures_zoom_and_pan(opened: Any) -> None:
    page = opened()
    section = page.locator("#pictures")
    scene = section.locator(".scene").first
    assert scene.locator(".measured th[scope=col]").all_inner_texts() == ["linear (box)", "neural"]
    rows = dict(row.split("\t", 1) for row in scene.locator(".measured tbody").inner_text().splitlines())
    assert rows["FLIP"].split() == ["0.132", "0.120"] and "SSIM" in rows
    section.locator(".bar select[name=show]").select_option("flip")
    sources, maps = page.evaluate(
        "() => [[...document.querySelectorAll('#pictures .side img')].slice(0, 2).map((image) => image.src), "
        "['linear (box)', 'neural'].map((name) => "
        'document.querySelector(`#pictures [data-method="${name}"] .flip`).src)]'
    )
    assert sources == maps
    section.get_by_label("Left, A").select_option("reference")
    assert "no FLIP map" in scene.locator(".tag.left").inner_text()
    transform = "() => document.querySelector('#pictures .side.a img').style.transform"
    section.get_by_label("Zoom").select_option("4")
    before = page.evaluate(transform)
    assert "scale(4)" in before
    stage = page.locator(STAGE).first
    assert stage.get_attribute("tabindex") == "0" and "enlarged" in str(stage.get_attribute("aria-label"))
    stage.press("ArrowRight")
    after = page.evaluate(transform)
    assert after != before
    box = stage.bounding_box()
    page.mouse.move(box["x"] + 0.2 * box["width"], box["y"] + 0.6 * box["height"])
    page.mouse.down()
    page.mouse.move(box["x"] + 0.3 * box["width"], box["y"] + 0.6 * box["height"])
    page.mouse.up()
    assert page.evaluate(transform) != after
    for _ in range(40):
        stage.press("ArrowLeft")
    assert page.evaluate(transform).startswith("translate(0px")  # not past the edge


@pytest.mark.parametrize(("size", "ratio"), [(PHONE, 3), (DESKTOP, 1)])
def test_a_pixel_covers_whole_pixels_of_the_screen(opened: Any, ratio: int, size: dict[str, int]) -> None:
    page = opened(size, device_scale_factor=ratio)
    for width, natural, crisp in page.evaluate(
        "() => [...document.querySelectorAll('#pictures .stage')].map((stage) => [stage.getBoundingClientRect().width, "
        "stage.querySelector('img').naturalWidth, stage.classList.contains('crisp')])"
    ):
        assert crisp and (width * ratio / natural) == pytest.approx(round(width * ratio / natural), abs=1e-3)


def test_a_phone_in_the_dark_shows_it_without_scrolling_sideways(opened: Any) -> None:
    page = opened(PHONE, device_scale_factor=2, is_mobile=True, has_touch=True, color_scheme="dark")
    assert page.evaluate("() => [document.documentElement.scrollWidth, innerWidth]") == [390, 390]
    ink, ground = page.evaluate(
        "() => [getComputedStyle(document.body).color, getComputedStyle(document.body).backgroundColor]"
        ".map((c) => c.match(/[0-9]+/g).slice(0, 3).reduce((sum, x) => sum + Number(x), 0))"
    )
    assert ink > ground + 400
    # The names at the ends of the curves lie within the drawing.
    assert page.evaluate(
        "() => [...document.querySelectorAll('.label.on')].every((label) => label.getBoundingClientRect().right <= "
        "label.ownerSVGElement.getBoundingClientRect().right)"
    )
    page.locator("main details summary").first.click()
    assert page.evaluate("() => document.documentElement.scrollWidth") == 390
    stage = page.locator(STAGE).first
    stage.scroll_into_view_if_needed()
    box = stage.bounding_box()
    page.touchscreen.tap(box["x"] + 10, box["y"] + 10)  # a tap scrolls and moves nothing
    assert page.locator("#pictures .divider").first.get_attribute("aria-valuenow") == "50"


def test_fields_are_named_and_tab_stops_at_what_scrolls_only(opened: Any) -> None:
    page = opened()
    assert page.evaluate(
        "() => [...document.querySelectorAll('main select, main input, main button')].filter((field) => "
        "!(field.labels?.length || field.textContent.trim() || field.getAttribute('aria-label'))).length"
    ) == 0  # fmt: skip
    page.evaluate("() => document.querySelectorAll('main details').forEach((part) => { part.open = true; })")
    page.wait_for_function("() => document.querySelector('.strip:not([tabindex])')")
    wrong = page.evaluate(
        "() => [...document.querySelectorAll('.scroll, .strip')].filter((part) => "
        "!part.closest('details:not([open])') && "
        "part.hasAttribute('tabindex') !== part.scrollWidth > part.clientWidth + 1).length"
    )
    assert wrong == 0 and page.locator(".strip[tabindex='0']").count() > 3
    names = page.evaluate("() => document.querySelector('.mipbake-viewer').viewer.choices.map((choice) => choice.name)")
    assert names == ["before: linear (box)", "after: neural"]


def test_curves_stand_out_and_are_read_by_a_pointer(opened: Any) -> None:
    page = opened()
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
    page.locator("#figures summary").click()
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


def test_paper_shows_both_pictures_side_by_side(opened: Any) -> None:
    page = opened()
    page.locator("#pictures").get_by_label("Zoom").select_option("4")
    page.emulate_media(media="print")
    page.evaluate("() => dispatchEvent(new Event('beforeprint'))")
    assert not page.locator(".divider").first.is_visible() and not page.locator(".bar").first.is_visible()
    assert colours(page, STAGE, (0.25, 0.5), (0.75, 0.5)) == [LINEAR, NEURAL]
    folded = "() => document.querySelectorAll('main details:not([open], .mv-keys)').length"
    assert page.evaluate(folded) == 0
    page.evaluate("() => dispatchEvent(new Event('afterprint'))")
    assert page.evaluate(folded) >= 3


def test_a_first_page_becomes_the_whole_one_and_keeps_what_was_chosen(browser: Any, tmp_path: Path) -> None:
    made, source = with_stacks(made_up(FILMED, 16), (8, 8))
    first = write_report(replace(made, rendered=(), plots=(), figures=(), curve=()), source, tmp_path / "r", begun=True)
    context = browser.new_context(viewport=DESKTOP)
    page = context.new_page()
    page.goto(first[0].as_uri())
    viewer = "document.querySelector('.mipbake-viewer').viewer"
    assert page.locator("#begun").is_visible() and page.locator("#figures").count() == 0
    assert page.evaluate(f"() => {viewer}.choices.map((choice) => choice.name)") == [
        "before: linear (box)", "after: neural", "truth",
    ]  # fmt: skip
    page.evaluate(f"() => {viewer}.set({{ shape: 'sphere', divider: 0.25 }})")
    write_report(made, source, tmp_path / "r")
    page.wait_for_selector("#figures", state="attached")
    page.wait_for_function(f"() => {viewer}")
    assert page.evaluate(f"() => [{viewer}.view.shape, {viewer}.view.divider]") == ["sphere", 0.25]
    assert page.locator("#begun").count() == 0
    context.close()


def test_without_scripts_everything_is_there(opened: Any) -> None:
    page = opened(java_script_enabled=False)
    pictures = page.locator("#pictures .strip img.render")
    assert pictures.count() == 5 * (len(NAMES) + 1) and pictures.first.is_visible()
    assert page.locator("#pictures .strip img.flip").count() == 5 * len(NAMES)
    assert page.locator(".panel .line").count() == 2 * len(NAMES)
    page.locator("#figures summary").click()
    assert page.locator("#figures table.figures").first.is_visible()
    assert not page.locator(".bar").first.is_visible() and not page.get_by_role("checkbox").count()
    frames = page.locator(".film .frame")
    assert frames.count() == 2 * (1 + len(FILMED))
    box = frames.first.bounding_box()
    assert box["width"] / box["height"] == pytest.approx(36 / 24, rel=0.02)


# ---- films


GREYS = """(selector) => [...document.querySelectorAll(selector)].map((canvas) => {
    const one = new OffscreenCanvas(1, 1).getContext('2d', { willReadFrequently: true });
    one.drawImage(canvas, canvas.width / 2, canvas.height / 2, 1, 1, 0, 0, 1, 1);
    return one.getImageData(0, 0, 1, 1).data[0];
})"""


def greys(page: Any, selector: str = ".film canvas") -> list[int]:
    """The grey of every canvas."""
    known = np.array([film_grey(index, frame) for index in range(-1, len(FILMED)) for frame in range(FRAMES)])
    found = np.array(page.evaluate(GREYS, selector))
    nearest = known[np.abs(found[:, None] - known).argmin(1)]
    assert np.abs(nearest - found).max() <= 2  # films are encoded with loss
    return [int(grey) for grey in nearest]


def at(frame: int) -> list[int]:
    """What both films show at a frame: A, B, then the strip: the reference and all methods."""
    return 2 * [film_grey(index, frame) for index in (1, 0, -1, 0, 1, 2)]


def filming(opened: Any, motion: str = "reduce") -> Any:
    """A page whose films are all to be seen, and loaded."""
    page = opened({"width": 1280, "height": 2400}, motion)
    page.wait_for_function(f"() => ({GREYS})('.film canvas').every((grey) => grey > 0)")
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
    page.locator(".film .divider").first.focus()
    for key, frame in ((".", 0), (",", 1), (",", 2), (",", 3), (",", 2)):
        page.keyboard.press(key)
        assert greys(page) == at(frame)
    films = page.locator("#films")
    films.locator(".strip > figure").filter(has_text="lean (gaussian)").first.click()
    assert films.get_by_label("Left, A").input_value() == "lean (gaussian)"
    assert page.locator("#pictures").get_by_label("Left, A").input_value() == "linear (box)"
    assert greys(page, ".film .side canvas") == 2 * [film_grey(2, 2), film_grey(0, 2)]
    assert "9.25 JOD" in films.locator(".measured").first.inner_text()


def test_the_space_bar_runs_all_films_in_step_and_stops_them(opened: Any) -> None:
    page = filming(opened, "no-preference")
    assert page.get_by_role("button", name="Stop").is_visible()  # films run from the start
    frames = [at(frame) for frame in range(FRAMES)]
    assert all(greys(page) in frames for _ in range(5))
    page.wait_for_function(f"() => (window.kept ??= new Set()).add(({GREYS})('.film canvas')[0]).size === {FRAMES}")
    page.locator(".film .divider").first.focus()
    page.keyboard.press(" ")
    assert page.get_by_role("button", name="Play").is_visible()
    stopped = greys(page)
    page.wait_for_timeout(200)
    assert greys(page) == stopped and stopped in frames
