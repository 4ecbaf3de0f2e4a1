"""The page of a comparison without a browser: what is written, what it holds, and that names cannot break it."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from mipbake.base.errors import OutputError
from mipbake.comparing.page import check_report, write_report
from mipbake.comparing.page.markup import Html, element, joined, listed
from mipbake.comparing.page.pictures import heat
from mipbake.comparing.page.scenes import flip_top
from mipbake.comparing.page.texels import WINDOW, Window, cropped, view, view_names, window_side
from mipbake.comparing.result import Comparison
from mipbake.comparing.viewer import Source
from mipbake.material import MODELS
from mipbake.material.pixel_filter import level_sizes

from .report_cases import NAMES, Page, made_up, made_up_stacks
from .viewer_scenes import material, scene_of, stack_of

FEW = ("neural", "linear (box)", "lean (gaussian)")


@pytest.fixture(scope="module")
def report(tmp_path_factory: pytest.TempPathFactory) -> tuple[Comparison, list[Path], Page]:
    comparison = made_up(FEW, 24)
    stacks, source = made_up_stacks(comparison, (16, 32))
    files = write_report(comparison, stacks, source, tmp_path_factory.mktemp("reports") / "new" / "report")
    return comparison, files, Page(files[0].read_text(encoding="utf-8"))


# ---- what is written


def test_a_report_holds_what_it_names_and_nothing_else(report: Any) -> None:
    _, files, _ = report
    folder = files[0].parent
    assert [f.name for f in files[:2]] == ["index.html", "results.json"]
    assert sorted(files) == sorted(path for path in folder.rglob("*") if path.is_file())
    scenes = {"sphere-near", "sphere-1-1", "sphere-middle", "sphere-far", "plane"}
    names = {path.stem for path in files}
    for scene in scenes:
        assert {f"{scene}--reference", f"{scene}--neural", f"{scene}--neural--flip"} <= names
        assert {f"{scene}--linear-box", f"{scene}--linear-box--flip"} <= names
    assert {f"{plot}--lean-gaussian" for plot in ("temporal-slice", "half-pixel-shift", "apparent-brdf")} <= names
    assert list(folder.parent.iterdir()) == [folder]


def test_nothing_is_loaded_from_elsewhere(report: Any) -> None:
    _, files, page = report
    for tag, attributes in page.elements:
        if "src" in attributes:
            assert str(attributes["src"]).startswith("data:image/webp;base64,"), tag
        if "href" in attributes:
            href = str(attributes["href"])
            inside = href.startswith("#") and page.all(href and "section", id=href[1:])
            assert inside or href == "data:," or (files[0].parent / href).is_file(), href
    styles = files[0].read_text(encoding="utf-8")
    assert "@import" not in styles and not re.search(r"url\((?!#)", styles)


def test_pictures_are_described_and_parts_are_named(report: Any) -> None:
    _, _, page = report
    pictures = page.all("img")
    assert len(pictures) > 60
    assert all(picture["alt"] for picture in pictures)
    ids = [a["id"] for _, a in page.elements if "id" in a]
    assert len(ids) == len(set(ids))
    assert all(a["aria-labelledby"] in ids for _, a in page.elements if "aria-labelledby" in a)
    assert all(a.get("aria-label") for _, a in page.elements if a.get("role") == "region")
    assert [t for t, _ in page.elements if t == "h1"] == ["h1"]
    assert page.all("html", lang="en")


def test_figures_as_json(report: Any) -> None:
    comparison, files, _ = report
    text = files[1].read_text(encoding="utf-8")
    assert "NaN" not in text
    results = json.loads(text)
    assert (results["schema"], results["schema_version"]) == ("mipbake-comparison", 1)
    assert list(results)[3:] == list(comparison.to_dict())
    flicker = next(f for f in results["figures"] if f["measure"] == "flicker")
    assert flicker["low"] is None and flicker["value"] == pytest.approx(comparison.figure(
        flicker["method"], "flicker", flicker["view"], flicker["scale"]).value)  # fmt: skip
    assert results["source"]["maps"]["base_color"]["path"] == str(Path("in/bricks_Color.png"))


def test_the_same_comparison_gives_the_same_bytes(tmp_path: Path) -> None:
    comparison = made_up(FEW[:2], 16)
    stacks, source = made_up_stacks(comparison, (8, 8))
    first, second = (write_report(comparison, stacks, source, tmp_path / name) for name in ("a", "b"))
    assert [f.read_bytes() for f in first] == [f.read_bytes() for f in second]


def test_files_hold_what_is_displayed(tmp_path: Path) -> None:
    comparison = made_up(FEW, 16)
    files = write_report(comparison, {}, None, tmp_path / "r")
    rendered = comparison.rendered[0]
    pixels = np.asarray(Image.open(next(f for f in files if f.name == "sphere-near--neural.png")))
    shown = rendered.images["neural"] / (1 + rendered.images["neural"])
    encoded = np.where(shown <= 0.0031308, 12.92 * shown, 1.055 * np.maximum(shown, 0.0031308) ** (1 / 2.4) - 0.055)
    np.testing.assert_allclose(pixels, 255 * encoded, atol=0.51)
    flip = np.asarray(Image.open(next(f for f in files if f.name == "sphere-near--neural--flip.png")))
    np.testing.assert_array_equal(flip, heat(rendered.flip["neural"], flip_top(comparison)))


def test_the_page_shows_the_pixels_of_the_files(report: Any, tmp_path: Path) -> None:
    import base64
    import io

    _, files, page = report
    uri = next(str(a["src"]) for a in page.all("img", class_="render"))
    embedded = Image.open(io.BytesIO(base64.b64decode(uri.partition(",")[2])))
    reference = Image.open(files[0].parent / "images" / "sphere-near--reference.png")
    np.testing.assert_array_equal(np.asarray(embedded.convert("RGB")), np.asarray(reference))


def test_progress_rises_to_one(tmp_path: Path) -> None:
    told: list[float] = []
    comparison = made_up(FEW, 16)
    stacks, source = made_up_stacks(comparison, (8, 8))
    write_report(comparison, stacks, source, tmp_path / "r", lambda phase, share: told.append(share))
    assert told == sorted(told) and told[-1] == 1 and told[-2] < 1 and len(set(told)) > 40


def test_an_earlier_report_is_replaced(tmp_path: Path) -> None:
    write_report(made_up(FEW, 16), {}, None, tmp_path / "r")
    check_report(tmp_path / "r")
    files = write_report(made_up(FEW[:2], 16, name="other"), {}, None, tmp_path / "r")
    assert not list((tmp_path / "r").rglob("*lean*"))
    assert "other" in files[0].read_text(encoding="utf-8")


@pytest.mark.parametrize("foreign", ["mine.txt", "images/mine.txt", "renders/mine.png", "other/x.png"])
def test_a_folder_that_holds_anything_else_is_left_alone(tmp_path: Path, foreign: str) -> None:
    write_report(made_up(FEW[:2], 16), {}, None, tmp_path / "r")
    other = tmp_path / "r" / foreign
    other.parent.mkdir(exist_ok=True)
    other.write_text("keep me")
    for attempt in (check_report, lambda folder: write_report(made_up(FEW, 16), {}, None, folder)):
        with pytest.raises(OutputError, match="holds files that are not mipbake's"):
            attempt(tmp_path / "r")
    assert other.read_text() == "keep me"
    assert "lean" not in (tmp_path / "r" / "index.html").read_text(encoding="utf-8")


def test_a_failure_leaves_nothing(tmp_path: Path) -> None:
    def fail(phase: str, share: float) -> None:
        if share > 0.5:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write_report(made_up(FEW, 16), {}, None, tmp_path / "a" / "r", fail)
    assert list(tmp_path.iterdir()) == []


def test_kept_renders_come_along(tmp_path: Path) -> None:
    (tmp_path / "kept").mkdir()
    (tmp_path / "kept" / "plane--neural.exr").write_bytes(b"exr")
    files = write_report(made_up(FEW[:2], 16), {}, None, tmp_path / "r", renders=tmp_path / "kept")
    assert (tmp_path / "r" / "renders" / "plane--neural.exr").read_bytes() == b"exr"
    assert tmp_path / "r" / "renders" / "plane--neural.exr" in files
    check_report(tmp_path / "r")  # may be replaced


# ---- names

NASTY = "<mark-x onclick=\"alert('1')\">&amp; $body ${style} \\u003c</script></style>]]>"


def test_names_cannot_break_the_page(tmp_path: Path) -> None:
    names = (f"neural {NASTY}", "linear (box)", f"lean {NASTY}")
    plain_page = Page(write_report(made_up(FEW, 16), {}, None, tmp_path / "plain")[0].read_text(encoding="utf-8"))
    made = made_up(names, 16)
    rendered = [replace(each, scene=replace(each.scene, title=NASTY, lighting=NASTY)) for each in made.rendered]
    source: dict[str, Any] = {
        "maps": {NASTY: {"path": Path(NASTY), "reason": NASTY, "width": 1, "height": 1, "encoding": NASTY}},
        "notes": [NASTY],
        "warnings": [NASTY],
        "ignored": [{"path": NASTY, "reason": NASTY}],
        "normal_convention": {"name": NASTY, "decided_by": NASTY, "confidence": 1.0},
    }
    comparison = replace(
        made,
        name=NASTY,
        model=NASTY,
        rendered=tuple(rendered),
        plots=tuple(replace(plot, title=NASTY, caption=NASTY) for plot in made.plots),
        source=source,
        notes=(NASTY,),
        warnings=(NASTY,),
        settings={NASTY: NASTY},
        seconds={NASTY: 1.0},
    )
    page = Page(write_report(comparison, {}, None, tmp_path / "nasty")[0].read_text(encoding="utf-8"))
    assert "mark-x" not in {tag for tag, _ in page.elements}
    assert {name for _, a in page.elements for name in a if name.startswith("on")} == set()
    assert {tag for tag, _ in page.elements} <= {tag for tag, _ in plain_page.elements} | {"aside"}
    text = "".join(page.text)
    assert text.count(NASTY) > 20
    options = page.all("option", value=names[0])
    assert len(options) == 2


def test_names_that_make_the_same_file_name_keep_their_files(tmp_path: Path) -> None:
    comparison = made_up(("linear (box)", "linear box", "LINEAR-BOX"), 16)
    files = write_report(comparison, {}, None, tmp_path / "r")
    near = sorted(f.name for f in files if f.name.startswith("sphere-near--linear-box"))
    assert len(near) == 6 and len({(tmp_path / "r" / "images" / name).read_bytes() for name in near}) == 6


def test_names_that_are_no_utf_8(tmp_path: Path) -> None:
    comparison = made_up(FEW[:2], 16, source={"ignored": [{"path": "a\udcff.png", "reason": "no map"}]})
    files = write_report(comparison, {}, None, tmp_path / "r")
    assert json.loads(files[1].read_text(encoding="utf-8"))["source"]["ignored"][0]["path"] == "a\udcff.png"
    assert "no map" in files[0].read_text(encoding="utf-8")


def test_markup_is_escaped_by_construction() -> None:
    made = element("p", "a < b", Html("<b>c</b>"), [1, None, ["&"]], title='"x"', hidden=True, id=None, class_="k")
    assert made == '<p title="&quot;x&quot;" hidden class="k">a &lt; b<b>c</b>1&amp;</p>'
    assert element("img", alt="") == '<img alt="">' and element("line", x1=0) == '<line x1="0"/>'
    assert joined(["a", "<"], " & ") == "a &amp; &lt;"
    assert [listed(words) for words in ((), ("a",), ("a", "b"), ("a", "b", "c"))] == ["", "a", "a and b", "a, b and c"]


# ---- stacks


@pytest.mark.parametrize(("height", "width"), [(64, 64), (64, 16), (16, 64), (48, 40)])
def test_a_cropped_stack_is_the_window_of_every_level(height: int, width: int) -> None:
    stack = stack_of(material("gltf", height, width), "gltf")
    small = cropped(stack, 32)
    assert [level.shape[:2] for level in small.levels] == level_sizes(min(height, 32), min(width, 32))
    for level, whole in zip(small.levels, stack.levels, strict=False):
        np.testing.assert_array_equal(level, whole[: level.shape[0], : level.shape[1]])


def test_the_window_fits_into_the_page() -> None:
    stack = stack_of(material("gltf", 4, 4), "gltf")
    source = Source(stack.levels[0], "gltf")
    assert window_side([stack], None) == window_side([stack] * 3, source) == WINDOW.side
    other = stack_of(material("ggx", 4, 4), "ggx")
    assert window_side([other] * 3, source) == 512


def test_the_view_holds_three_stacks_and_says_what_is_left_out() -> None:
    comparison = made_up(NAMES, 16)
    stacks, source = made_up_stacks(comparison, (32, 64))
    assert view_names(comparison, stacks) == ["neural", "unreal (gaussian)", "linear (box)"]
    live, note = view(comparison, stacks, source)
    assert [s["name"] for s in scene_of(live)["stacks"]] == ["neural", "unreal (gaussian)", "linear (box)"]
    assert scene_of(live)["source"]["sizes"] == [[32, 64]] and note == ""
    live, note = view(comparison, stacks, source, Window(side=16))
    assert scene_of(live)["stacks"][0]["sizes"][0] == scene_of(live)["source"]["sizes"][0] == [16, 16]
    assert "16 \N{MULTIPLICATION SIGN} 16 of the set's 64 \N{MULTIPLICATION SIGN} 32 texels" in note
    assert view(comparison, {}, source) == ("", "")


@pytest.mark.parametrize("model", MODELS)
def test_every_map_is_shown_level_by_level(tmp_path: Path, model: str) -> None:
    comparison = made_up(("neural", "linear (box)"), 16, model=model)
    chain = [np.full((*size, 1), 0.5, np.float32) for size in level_sizes(4, 4)]
    stack = replace(stack_of(material(model, 8, 256), model), extra={"occlusion": chain})
    files = write_report(comparison, {"neural": stack, "linear (box)": stack}, None, tmp_path / "r")
    maps = [f for f in files if f.name.startswith("map--")]
    shading = len(stack.maps()) - 1
    assert len(maps) == 2 * shading * 6 + 3  # the map that does not shade is the same in both: once, of three levels
    sizes = [Image.open(f).size for f in maps if "normal--neural" in f.name]
    assert sizes == [(128, 4), (128, 4), (64, 2), (32, 1), (16, 1), (8, 1)]
    occlusion = np.asarray(Image.open(next(f for f in maps if "occlusion" in f.name)))
    assert (occlusion == 128).all()
    normal = np.asarray(Image.open(next(f for f in maps if "normal--neural--level-0" in f.name)))
    assert normal[..., 2].mean() > 200  # blue is up, in the model that stores no z too
