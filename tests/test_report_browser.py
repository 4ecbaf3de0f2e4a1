"""The page of a comparison in headless Chromium: its divider, keys, tables and curves, on paper and without scripts."""

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
from .report_cases import NAMES, made_up, made_up_stacks

PHONE = {"width": 390, "height": 844}
DESKTOP = {"width": 1280, "height": 900}


@pytest.fixture(scope="module")
def report(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Pictures of one colour each, so that a pixel tells which picture it is of."""
    made = made_up(NAMES, 48)
    rendered = [
        replace(
            each,
            reference=np.full_like(each.reference, 1.0),
            images={name: np.full_like(each.reference, 0.1 * (i + 1)) for i, name in enumerate(NAMES)},
        )
        for each in made.rendered
    ]
    stacks, source = made_up_stacks(made, (8, 8))
    folder = tmp_path_factory.mktemp("reports") / "report"
    return write_report(replace(made, rendered=tuple(rendered)), stacks, source, folder)[0]


@pytest.fixture
def opened(browser: Any, report: Path) -> Iterator[Any]:
    """Opens the report from disk (chromium.watched)."""
    with watched(browser, report.as_uri()) as page:

        def open_page(size: dict[str, int] = DESKTOP, **options: Any) -> Any:
            # Nothing scrolls smoothly then, so that places are where they were measured.
            return page(viewport=size, reduced_motion="reduce", **options)

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


def dividers(page: Any) -> Any:
    return page.locator(".scene").first.locator(".divider")


NEURAL, LINEAR, REFERENCE = shown(0.1), shown(0.2), shown(1.0)
STAGE = ".scene .stage"


def test_a_divider_parts_the_two_chosen_pictures(opened: Any) -> None:
    page = opened()
    assert colours(page, STAGE, (0.3, 0.5), (0.7, 0.5)) == [LINEAR, NEURAL]  # the subject to the right
    page.get_by_label("Left, A").select_option("reference")
    assert colours(page, STAGE, (0.3, 0.5), (0.7, 0.5)) == [REFERENCE, NEURAL]
    box = page.locator(STAGE).first.bounding_box()
    page.mouse.move(box["x"] + box["width"] / 2, box["y"] + box["height"] / 4)
    page.mouse.down()
    page.mouse.move(box["x"] + 0.8 * box["width"], box["y"] + box["height"] / 4)
    page.mouse.up()
    assert colours(page, STAGE, (0.7, 0.5), (0.9, 0.5)) == [REFERENCE, NEURAL]
    assert dividers(page).get_attribute("aria-valuenow") == "80"
    strip = page.locator(".scene").first.locator(".strip > figure")
    strip.filter(has_text="optimum").locator(".render").click()
    strip.filter(has_text="lean (box)").locator(".render").click(modifiers=["Shift"])
    assert page.get_by_label("Left, A").input_value() == "optimum"
    assert page.get_by_label("Right, B").input_value() == "lean (box)"
    assert colours(page, STAGE, (0.7, 0.5), (0.9, 0.5)) == [shown(0.7), shown(0.4)]
    assert strip.filter(has_text="optimum").get_attribute("data-at") == "A"


def test_keys_move_the_divider(opened: Any) -> None:
    page = opened()
    divider = dividers(page)
    assert (divider.get_attribute("role"), divider.get_attribute("tabindex")) == ("slider", "0")
    assert "Sphere, near" in str(divider.get_attribute("aria-label"))
    for key, at in (("ArrowRight", 52), ("ArrowUp", 54), ("ArrowLeft", 52), ("PageUp", 62), ("End", 100), ("Home", 0)):
        divider.press(key)
        assert divider.get_attribute("aria-valuenow") == str(at)
        assert f"{at} %" in str(divider.get_attribute("aria-valuetext"))
    assert colours(page, STAGE, (0.2, 0.3)) == [NEURAL]
    # By keys alone: Tab leads from the last field to the first divider.
    page.get_by_label("Zoom").focus()
    page.keyboard.press("Tab")
    assert page.evaluate("() => document.activeElement === document.querySelector('.divider')")


def test_flip_maps_and_figures_of_both_sides(opened: Any) -> None:
    page = opened()
    scene = page.locator(".scene").first
    assert scene.locator(".measured th[scope=col]").all_inner_texts() == ["linear (box)", "neural"]
    rows = dict(row.split("\t", 1) for row in scene.locator(".measured tbody").inner_text().splitlines())
    assert rows["FLIP"].split() == ["0.132", "0.120"] and "SSIM" in rows
    page.locator(".bar select[name=show]").select_option("flip")
    sources = page.evaluate(
        "() => [...document.querySelectorAll('.scene .side img')].slice(0, 2).map((image) => image.src)"
    )
    maps = page.evaluate(
        "() => ['linear (box)', 'neural'].map((name) => "
        'document.querySelector(`.scene [data-method="${name}"] .flip`).src)'
    )
    assert sources == maps
    page.get_by_label("Left, A").select_option("reference")
    assert "no FLIP map" in scene.locator(".tag.left").inner_text()


def test_zoom_and_pan(opened: Any) -> None:
    page = opened()
    transform = "() => document.querySelector('.scene .side.a img').style.transform"
    assert "scale(1)" in page.evaluate(transform)
    page.get_by_label("Zoom").select_option("4")
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
    assert dividers(page).get_attribute("aria-valuenow") == "50"
    for _ in range(40):
        stage.press("ArrowLeft")
    assert page.evaluate(transform).startswith("translate(0px")  # not past the edge
    assert page.evaluate("() => getComputedStyle(document.querySelector('.side img')).imageRendering") == "pixelated"


@pytest.mark.parametrize("ratio", [1, 2, 3])
@pytest.mark.parametrize("size", [PHONE, DESKTOP])
def test_a_pixel_covers_whole_pixels_of_the_screen(opened: Any, ratio: int, size: dict[str, int]) -> None:
    page = opened(size, device_scale_factor=ratio)
    for width, natural, crisp in page.evaluate(
        "() => [...document.querySelectorAll('.stage')].map((stage) => [stage.getBoundingClientRect().width, "
        "stage.querySelector('img').naturalWidth, stage.classList.contains('crisp')])"
    ):
        assert crisp and (width * ratio / natural) == pytest.approx(round(width * ratio / natural), abs=1e-3)


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_a_phone_shows_it_without_scrolling_sideways(opened: Any, scheme: str) -> None:
    page = opened(PHONE, device_scale_factor=2, is_mobile=True, has_touch=True, color_scheme=scheme)
    assert page.evaluate("() => [document.documentElement.scrollWidth, innerWidth]") == [390, 390]
    ink, ground = page.evaluate(
        "() => [getComputedStyle(document.body).color, getComputedStyle(document.body).backgroundColor]"
        ".map((c) => c.match(/[0-9]+/g).slice(0, 3).reduce((sum, x) => sum + Number(x), 0))"
    )
    assert (ink > ground + 400) if scheme == "dark" else (ground > ink + 400)
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
    assert dividers(page).get_attribute("aria-valuenow") == "50"


def test_every_field_is_named(opened: Any) -> None:
    page = opened()
    assert page.evaluate(
        "() => [...document.querySelectorAll('main select, main input, main button')].filter((field) => "
        "!(field.labels?.length || field.textContent.trim() || field.getAttribute('aria-label'))).length"
    ) == 0  # fmt: skip


def test_tab_stops_at_what_scrolls_only(opened: Any) -> None:
    page = opened()
    page.wait_for_function("() => document.querySelector('.strip:not([tabindex])')")
    wrong = page.evaluate(
        "() => [...document.querySelectorAll('.scroll, .strip')].filter((part) => "
        "!part.closest('details:not([open])') && "
        "part.hasAttribute('tabindex') !== part.scrollWidth > part.clientWidth + 1).length"
    )
    assert wrong == 0
    assert page.locator(".strip[tabindex='0']").count() > 3


def test_methods_can_be_made_to_stand_out(opened: Any) -> None:
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
    page.get_by_role("checkbox", name="lean (box)").uncheck()
    assert not label.is_visible()


def test_a_pointer_reads_the_curves(opened: Any) -> None:
    page = opened()
    drawing = page.locator(".plot svg").first
    drawing.scroll_into_view_if_needed()
    box = drawing.bounding_box()
    page.mouse.move(box["x"] + box["width"] * 0.45, box["y"] + box["height"] / 2)
    text = page.locator(".readout").first.inner_text()
    assert text.startswith("level of detail") and "neural" in text and "optimum" in text
    page.mouse.move(0, 0)
    assert not page.locator(".readout").first.is_visible()


def test_columns_sort_best_first_then_worst_then_as_they_were(opened: Any) -> None:
    page = opened()
    table = page.locator("#figures table.figures").first
    names = lambda: table.locator("tbody th").all_inner_texts()  # noqa: E731
    first = names()
    assert first == list(NAMES)
    far = table.get_by_role("button", name="far")
    far.click()
    best = names()
    assert best[0] == "optimum" and best[1] == "neural"
    assert table.locator("th[aria-sort]").get_attribute("aria-sort") == "descending"
    far.press("Enter")
    assert names() == best[::-1]
    assert table.locator("th[aria-sort]").get_attribute("aria-sort") == "ascending"
    table.get_by_role("button", name="Method").click()
    assert names() == first and table.locator("th[aria-sort]").count() == 0


def test_paper_shows_both_pictures_side_by_side(opened: Any) -> None:
    page = opened()
    page.get_by_label("Zoom").select_option("4")
    page.emulate_media(media="print")
    page.evaluate("() => dispatchEvent(new Event('beforeprint'))")
    assert not page.locator(".divider").first.is_visible() and not page.locator(".bar").is_visible()
    assert colours(page, STAGE, (0.25, 0.5), (0.75, 0.5)) == [LINEAR, NEURAL]
    folded = "() => document.querySelectorAll('main details:not([open], .mv-keys)').length"
    assert page.evaluate(folded) == 0
    page.evaluate("() => dispatchEvent(new Event('afterprint'))")
    assert page.evaluate(folded) >= 3
    assert len(page.pdf()) > 10000


def test_without_scripts_everything_is_there(opened: Any) -> None:
    page = opened(java_script_enabled=False)
    pictures = page.locator(".scene .strip img.render")
    assert pictures.count() == 5 * (len(NAMES) + 1) and pictures.first.is_visible()
    assert page.locator(".scene .strip img.flip").count() == 5 * len(NAMES)
    assert page.locator(".panel .line").count() == 2 * len(NAMES)
    assert page.locator("#figures table.figures").first.is_visible()
    assert not page.locator(".bar").is_visible() and not page.get_by_role("checkbox").count()
    page.locator("main details summary").last.click()
    assert page.locator(".files a").first.is_visible()


def test_the_interactive_view_is_in_the_page(opened: Any) -> None:
    page = opened()
    names = page.evaluate("() => document.querySelector('.mipbake-viewer').viewer.choices.map((choice) => choice.name)")
    assert names == ["neural", "unreal (gaussian)", "linear (box)", "reference"]
