"""The page of a comparison without a browser: what is written, what it holds, and that names cannot break it."""

from __future__ import annotations

import base64
import io
import json
import re
from dataclasses import replace
from html import unescape
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from mipbake.base.errors import OutputError
from mipbake.comparing.page import check_report, texels, write_report
from mipbake.comparing.page.markup import Html, element, joined, listed
from mipbake.comparing.page.pictures import heat
from mipbake.comparing.page.scenes import flip_top
from mipbake.comparing.page.texels import view
from mipbake.comparing.result import Comparison
from mipbake.material import MODELS
from mipbake.material.pixel_filter import level_sizes
from mipbake.quality.figures import Figure, Method

from .report_cases import NAMES, Page, film_figures, film_grey, filmed, made_up, with_stacks
from .viewer_scenes import material, scene_of, stack_of

FEW = ("neural", "linear (box)", "lean (gaussian)")


@pytest.fixture(scope="module")
def report(tmp_path_factory: pytest.TempPathFactory) -> tuple[Comparison, list[Path], Page]:
    made = made_up(FEW, 24, films=tuple(filmed(name, FEW) for name in ("floor", "wall")))
    films = [f for film in ("floor", "wall") for f in film_figures(film, dict.fromkeys(FEW, 9.25))]
    comparison, source = with_stacks(replace(made, figures=(*made.figures, *films)), (16, 32))
    files = write_report(comparison, source, tmp_path_factory.mktemp("reports") / "new" / "report")
    return comparison, files, Page(files[0].read_text(encoding="utf-8"))


# ---- what is written


def test_a_report_holds_what_it_names_and_nothing_else(report: Any) -> None:
    _, files, _ = report
    folder = files[0].parent
    assert [f.name for f in files] == ["index.html", "results.json", "whole.js"]
    assert sorted(files) == sorted(path for path in folder.rglob("*") if path.is_file())
    assert list(folder.parent.iterdir()) == [folder]


def test_nothing_is_loaded_from_elsewhere_and_all_is_described(report: Any) -> None:
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
    assert len(page.all("img")) > 50 and all(picture["alt"] for picture in page.all("img"))
    ids = [a["id"] for _, a in page.elements if "id" in a]
    assert len(ids) == len(set(ids))
    assert all(a["aria-labelledby"] in ids for _, a in page.elements if "aria-labelledby" in a)
    assert all(a.get("aria-label") for _, a in page.elements if a.get("role") == "region")
    assert [t for t, _ in page.elements if t == "h1"] == ["h1"]
    assert [a.get("id") for a in page.all("section")][:3] == ["view", "films", "table"]


def test_figures_as_json(report: Any) -> None:
    comparison, files, _ = report
    text = files[1].read_text(encoding="utf-8")
    assert "NaN" not in text
    results = json.loads(text)
    assert (results["schema"], results["schema_version"]) == ("mipbake-comparison", 1)
    assert list(results)[3:] == list(comparison.to_dict())
    flicker = next(f for f in results["figures"] if f["measure"] == "flicker")
    place = (flicker["method"], "flicker", flicker["view"], flicker["scale"])
    assert flicker["low"] is None and flicker["value"] == pytest.approx(comparison.figure(*place).value)
    assert results["source"]["maps"]["base_color"]["path"] == str(Path("in/bricks_Color.png"))


def pixels(page: Page, alt: str) -> np.ndarray:
    """The picture that is described by `alt`."""
    (uri,) = (str(a["src"]) for a in page.all("img") if a["alt"] == alt)
    return np.asarray(Image.open(io.BytesIO(base64.b64decode(uri.partition(",")[2]))).convert("RGB"))


def test_pictures_hold_what_is_displayed(report: Any) -> None:
    comparison, _, page = report
    rendered = comparison.rendered[0]
    shown = rendered.images["neural"] / (1 + rendered.images["neural"])
    encoded = np.where(shown <= 0.0031308, 12.92 * shown, 1.055 * np.maximum(shown, 0.0031308) ** (1 / 2.4) - 0.055)
    alt = f"{rendered.scene.title}, neural"
    np.testing.assert_allclose(pixels(page, alt), 255 * encoded, atol=0.51)  # pictures of 24 pixels have no loss
    flip = pixels(page, f"FLIP map: {alt}")
    np.testing.assert_array_equal(flip, heat(rendered.flip["neural"], flip_top(comparison)))


def test_a_film_is_one_picture_for_each_method(report: Any) -> None:
    _, _, page = report
    for film in ("floor", "wall"):
        for index, name in enumerate(("truth", "mipbake", "plain MIP maps", "lean (gaussian)")):
            sheet = pixels(page, f"A {film}, {name}")
            assert sheet.shape == (4 * 24, 36, 3)
            for frame in range(4):
                assert np.abs(sheet[24 * frame : 24 * (frame + 1)].astype(int) - film_grey(index - 1, frame)).max() <= 2
    shown = page.all("figure", class_="film")
    assert [(each["data-frames"], each["data-fps"]) for each in shown] == 4 * [("4", "30")]
    assert {each["style"] for each in page.all("div", class_="frame")} == {"--natural: 36px; aspect-ratio: 36 / 24"}
    assert "Every measure in the film of the floor" in " ".join(page.text)


def test_the_same_comparison_gives_the_same_bytes_in_place_of_an_earlier_report(tmp_path: Path) -> None:
    comparison, source = with_stacks(made_up(FEW[:2], 16), (8, 8))
    told: list[float] = []
    write_report(made_up(FEW, 16), None, tmp_path / "a")
    check_report(tmp_path / "a")
    first = write_report(comparison, source, tmp_path / "a", lambda phase, share: told.append(share))
    second = write_report(comparison, source, tmp_path / "b")
    assert [f.read_bytes() for f in first] == [f.read_bytes() for f in second]
    assert sorted(first) == sorted(path for path in (tmp_path / "a").rglob("*") if path.is_file())
    assert told == sorted(told) and told[-1] == 1 and told[-2] < 1 and len(told) > 8


def test_a_first_page_has_the_view_and_waits_for_the_whole_one(tmp_path: Path) -> None:
    comparison, source = with_stacks(made_up(FEW, 16, rendered=(), plots=(), figures=(), curve=()), (8, 8))
    files = write_report(comparison, source, tmp_path / "r", begun=True)
    page = Page(files[0].read_text(encoding="utf-8"))
    assert [f.name for f in files] == ["index.html", "results.json"] and page.all("p", id="begun")
    assert [a["id"] for a in page.all("section") if "id" in a] == ["view", "notes", "made"]
    whole = write_report(comparison, source, tmp_path / "r")
    assert whole[-1].name == "whole.js" and not Page(whole[0].read_text(encoding="utf-8")).all("p", id="begun")


@pytest.mark.parametrize("foreign", ["mine.txt", "images/mine.txt", "other/x.png"])
def test_a_folder_that_holds_anything_else_is_left_alone(tmp_path: Path, foreign: str) -> None:
    write_report(made_up(FEW[:2], 16, rendered=()), None, tmp_path / "r")
    other = tmp_path / "r" / foreign
    other.parent.mkdir(exist_ok=True)
    other.write_text("keep me")
    for attempt in (check_report, lambda folder: write_report(made_up(FEW, 16), None, folder)):
        with pytest.raises(OutputError, match="holds files that are not mipbake's"):
            attempt(tmp_path / "r")
    assert other.read_text() == "keep me"
    assert "lean" not in (tmp_path / "r" / "index.html").read_text(encoding="utf-8")


def test_a_failure_leaves_nothing(tmp_path: Path) -> None:
    def fail(phase: str, share: float) -> None:
        if share > 0.5:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write_report(made_up(FEW, 16), None, tmp_path / "a" / "r", fail)
    assert list(tmp_path.iterdir()) == []


def test_a_page_of_figures_alone(tmp_path: Path) -> None:
    """Parts that were not measured are left out."""
    figures = [Figure(name, "snr", "hemisphere", "near", 0.0, 20.0, 19.0, 21.0) for name in FEW]
    whole = made_up(FEW, 16)
    bare = Comparison("s", "neural", "gltf", "gaussian", whole.methods, (), tuple(figures))
    page = Page(write_report(bare, None, tmp_path / "a")[0].read_text(encoding="utf-8"))
    assert [a["id"] for a in page.all("section")] == ["decibels", "figures", "made"] and page.all("p", id="verdict")
    assert not page.all("div", class_="clock js")
    opened = replace(bare, methods=(Method("baked", "neural", "gaussian", "gltf", None, tmp_path),), figures=())
    text = write_report(opened, None, tmp_path / "b")[0].read_text(encoding="utf-8")
    assert f"opened from {tmp_path}" in text and "Nothing is known about the source" in text


# ---- names

NASTY = "<mark-x onclick=\"alert('1')\">&amp; $body ${style} \\u003c</script></style>]]>"


def test_names_cannot_break_the_page(tmp_path: Path, report: Any) -> None:
    names = (f"neural {NASTY}", "linear (box)", f"lean {NASTY}")
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
    page = Page(write_report(comparison, None, tmp_path / "nasty")[0].read_text(encoding="utf-8"))
    assert "mark-x" not in {tag for tag, _ in page.elements}
    assert {name for _, a in page.elements for name in a if name.startswith("on")} == set()
    assert {tag for tag, _ in page.elements} <= {tag for tag, _ in report[2].elements} | {"aside"}
    text = "".join(page.text)
    assert text.count(NASTY) > 20


def test_names_that_are_no_utf_8(tmp_path: Path) -> None:
    ignored = {"ignored": [{"path": "a\udcff.png", "reason": "no map"}]}
    files = write_report(made_up(FEW, 16, source=ignored), None, tmp_path / "r")
    assert json.loads(files[1].read_text(encoding="utf-8"))["source"]["ignored"][0]["path"] == "a\udcff.png"
    assert "no map" in files[0].read_text(encoding="utf-8")


def test_markup_is_escaped_by_construction() -> None:
    made = element("p", "a < b", Html("<b>c</b>"), [1, None, ["&"]], title='"x"', hidden=True, id=None, class_="k")
    assert made == '<p title="&quot;x&quot;" hidden class="k">a &lt; b<b>c</b>1&amp;</p>'
    assert element("img", alt="") == '<img alt="">' and element("line", x1=0) == '<line x1="0"/>'
    assert joined(["a", "<"]) == "a&lt;"
    assert [listed(words) for words in ((), ("a",), ("a", "b"), ("a", "b", "c"))] == ["", "a", "a and b", "a, b and c"]


# ---- stacks


def test_the_view_holds_before_after_and_the_truth_and_says_what_is_left_out(monkeypatch: pytest.MonkeyPatch) -> None:
    comparison, source = with_stacks(made_up(NAMES, 16), (32, 64))
    live = view(comparison, source)
    assert [s["name"] for s in scene_of(live)["images"]] == ["truth", "plain MIP maps", "mipbake"]
    assert scene_of(live)["images"][0]["sizes"] == [[32, 64]] and "from its upper" not in live
    assert view(replace(comparison, stacks={}), source) == ""
    for name, value in (("WINDOW_SIDE", 16), ("WINDOW_BYTES", 16 * 32 * (2 * 8 * 4 // 3 + 8))):
        monkeypatch.undo()
        monkeypatch.setattr(texels, name, value)
        live = view(comparison, source)
        source_sizes, sizes = (scene_of(live)["images"][index]["sizes"] for index in (0, 1))
        assert sizes[0] == source_sizes[0] == [16, 16]
        assert "16 \N{MULTIPLICATION SIGN} 16 of the set's 64 \N{MULTIPLICATION SIGN} 32 texels" in unescape(live)
        assert [tuple(size) for size in sizes] == level_sizes(16, 16)


@pytest.mark.parametrize("model", MODELS)
def test_every_map_is_shown_level_by_level(tmp_path: Path, model: str) -> None:
    chain = [np.full((*size, 1), 0.5, np.float32) for size in level_sizes(4, 4)]
    stack = replace(stack_of(material(model, 8, 256), model), extra={"occlusion": chain})
    stacks = {"neural": stack, "linear (box)": stack}
    comparison = made_up(tuple(stacks), 16, model=model, stacks=stacks, rendered=())
    page = Page(write_report(comparison, None, tmp_path / "r")[0].read_text(encoding="utf-8"))
    maps = [str(a["alt"]) for a in page.all("img", class_="texels")]
    shading = len(stack.maps()) - 1
    assert len(maps) == 2 * shading * 6 + 3  # the map that does not shade is the same in both: once, of three levels
    normals = [pixels(page, alt) for alt in maps if alt.startswith("Normal, neural")]
    assert [each.shape[:2] for each in normals] == [(4, 128), (4, 128), (2, 64), (1, 32), (1, 16), (1, 8)]
    assert (pixels(page, "Occlusion, neural, level 0") == 128).all()
    assert normals[0][..., 2].mean() > 200  # blue is up, in the model that stores no z too
