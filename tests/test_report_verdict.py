"""What a report says of figures: the verdict in films and decibels, tables, curves, and the colours of error maps."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from mipbake.comparing.page.charts import curves
from mipbake.comparing.page.names import called
from mipbake.comparing.page.pictures import displayed_bytes, heat, ramp
from mipbake.comparing.page.scenes import flip_top
from mipbake.comparing.page.tables import measure_tables, number, seen_table
from mipbake.comparing.page.verdict import VISIBLE_JOD, best_in_renders, difference, verdict
from mipbake.comparing.result import Comparison
from mipbake.quality.figures import SNR_GAIN, Figure

from .report_cases import NAMES, Page, film_figures, filmed, made_up, method

FEW = ("neural", "linear (box)", "lean (gaussian)")


def snr(name: str, view: str, scale: str, value: float, spread: float = 0.2) -> Figure:
    return Figure(name, "snr", view, scale, 0.0, value, value - spread, value + spread)


def compared(figures: Sequence[Figure], names: Sequence[str] = FEW) -> Comparison:
    return Comparison("s", names[0], "gltf", "gaussian", tuple(method(n) for n in names), (), tuple(figures))


# ---- decibels


def test_the_verdict_says_who_wins_where_and_by_how_much() -> None:
    values = {  # near the mirror at near and far, over the hemisphere at near and far
        "neural": (15.0, 12.0, 20.0, 22.0),
        "linear (box)": (11.0, 8.0, 20.1, 18.0),
        "lean (gaussian)": (14.0, 7.0, 23.0, 19.5),
    }
    places = [("near-mirror", "near"), ("near-mirror", "far"), ("hemisphere", "near"), ("hemisphere", "far")]
    figures = [snr(name, *place, v) for name, row in values.items() for place, v in zip(places, row, strict=True)]
    found = verdict(compared(figures))
    assert found.details == (
        "neural beats the best closed form of each scale near the mirror at every scale (by 1.0 to 4.0 dB) and over "
        "the hemisphere at far (by 2.5 dB) and loses to it over the hemisphere at near (by 3.0 dB); it beats linear "
        "(box) near the mirror at every scale (by 4.0 dB) and over the hemisphere at far (by 4.0 dB) and shows no "
        "difference elsewhere."
    )
    assert not found.paired


def test_intervals_that_overlap_show_no_difference() -> None:
    names = FEW[:2]
    figures = [snr("neural", "near-mirror", "near", 15, 2), snr("linear (box)", "near-mirror", "near", 12, 1.5)]
    assert verdict(compared(figures, names)).details == "neural shows no difference from linear (box) at any scale."
    worse = snr("lean (gaussian)", "near-mirror", "near", 1, 0.1)
    said = "neural shows no difference from linear (box), the best closed form, at any scale."
    assert verdict(compared([*figures, worse])).details == said
    without = [replace(f, low=math.nan, high=math.nan) for f in figures]
    for changed, outcome in (
        ([figures[0], snr("linear (box)", "near-mirror", "near", 12, 0.9)], 1),
        (without, 1),
        ([without[0], replace(without[1], value=15.03)], 0),
    ):
        one = difference(compared(changed, names), "linear (box)", "snr", "near-mirror", "near")
        assert one is not None and one.outcome == outcome


@pytest.mark.parametrize(("low", "high", "outcome"), [(0.4, 5.0, 1), (-0.1, 5.0, 0), (-5.0, -0.2, -1)])
def test_paired_intervals_decide_where_they_are(low: float, high: float, outcome: int) -> None:
    gain = (low + high) / 2
    figures = [
        snr("neural", "hemisphere", "near", 15 + gain, 9),
        snr("linear (box)", "hemisphere", "near", 15, 9),
        Figure("linear (box)", SNR_GAIN, "hemisphere", "near", 0, gain, low, high),
    ]
    found = compared(figures, FEW[:2])
    one = difference(found, "linear (box)", "snr", "hemisphere", "near")
    assert one is not None and (one.gain, one.outcome) == (gain, outcome)
    assert verdict(found).paired


def test_the_optimum_is_a_limit_and_no_rival() -> None:
    names = ("neural", "linear (box)", "optimum")
    values = {"neural": (15.0, 9.0, 12.0), "linear (box)": (12.0, 10.0, 11.0), "optimum": (18.0, 14.0, 11.0)}
    figures = [
        snr(name, "near-mirror", scale, value)
        for name, row in values.items()
        for scale, value in zip(("near", "middle", "far"), row, strict=True)
    ]
    assert verdict(compared(figures, names)).details == (
        "neural beats linear (box) near the mirror at near and far (by 1.0 to 3.0 dB) and loses to it near the mirror "
        "at middle (by 1.0 dB)."
    )
    tables = measure_tables(compared(figures, names))
    best = re.findall(r'<th[^>]*class="method[^>]*>([^<]*)</th>((?:<td.*?</td>)+)', tables)
    assert {name for name, cells in best if 'class="best"' in cells} == {"neural", "linear (box)"}


def test_renders_have_a_say() -> None:
    comparison = made_up(FEW, 16)
    assert best_in_renders(comparison) == (
        "In renders, FLIP is the lowest with neural on the sphere at near, 1:1, middle and far and on the plane."
    )
    changed = [
        replace(f, value=0.01) if (f.method, f.measure, f.scale) == ("linear (box)", "flip", "near") else f
        for f in comparison.figures
    ]
    assert "with linear (box) on the sphere at near and with neural on the sphere at 1:1, middle and far" in (
        best_in_renders(replace(comparison, figures=tuple(changed)))
    )
    assert best_in_renders(replace(comparison, figures=())) == ""


def test_a_verdict_without_figures() -> None:
    assert verdict(compared([])).details == "Nothing was measured that neural could be compared by."
    only = verdict(compared([snr("neural", "hemisphere", "near", 20)], FEW[:1]))
    assert only.details == "Nothing was measured that neural could be compared by."
    nan = [snr("neural", "hemisphere", "near", math.nan), snr("linear (box)", "hemisphere", "near", 3)]
    assert verdict(compared(nan)).details == "Nothing was measured that neural could be compared by."


# ---- in words


def seen(near: float, middle: float, far: float, name: str = "neural", measure: str = "jod-37") -> list[Figure]:
    """Figures of a wall, a sphere and a floor, by how far they are ahead of plain MIP maps with 9 JOD."""
    films = {"wall": (0.25, near), "sphere": (1.0, middle), "floor": (3.7, far)}
    return [
        Figure(method, measure, f"film-{film}", "", lod, 9 + own, math.nan, math.nan)
        for film, (lod, ahead) in films.items()
        for method, own in ((name, ahead), ("linear (box)", 0.0))
    ]


@pytest.mark.parametrize(
    ("ahead", "sentence"),
    [
        (
            (0.05, 0.2, 0.9),
            "Calmer and truer to the source from middle distance on; no visible gain near. Recommended.",
        ),
        (
            (0.0, -0.09, 0.09),
            "No visible gain at any distance. Plain MIP maps look the same on this set: --method linear --filter box "
            "writes them.",
        ),
        (
            (-0.2, 0.0, 0.2),
            "Calmer and truer to the source far away; no visible gain at middle distance; worse than plain MIP maps "
            "near. Recommended with --keep-level0, which leaves the finest level as it is.",
        ),
    ],
)
def test_the_verdict_says_in_words_what_films_show(ahead: tuple[float, float, float], sentence: str) -> None:
    found = verdict(compared(seen(*ahead)))
    assert found.sentence == sentence
    assert not re.search(r"[0-9]\.[0-9]|JOD|dB|neural|SNR|FLIP", found.sentence)


def test_the_verdict_says_what_looks_better() -> None:
    lean = seen(0.0, 0.3, 0.3, "lean (gaussian)")
    for ahead, said in (((0.0, 0.0, -0.4), "Try "), ((0.0, 0.0, 0.0), "Plain MIP maps look the same")):
        sentence = verdict(compared([*seen(*ahead), *lean])).sentence
        assert said in sentence and "--method lean --filter gaussian" in sentence
    assert verdict(compared([*seen(0.2, 0.2, 0.2), *lean])).sentence.endswith("Recommended.")


def test_renders_speak_where_there_are_no_films() -> None:
    flip = {"neural": 0.08, "linear (box)": 0.107, "lean (gaussian)": 0.082}
    comparison = made_up(FEW, 16)
    changed = [replace(f, value=flip[f.method]) if f.measure == "flip" else f for f in comparison.figures]
    changed = [replace(f, lod=dict(near=0.0, middle=3.0, far=7.0).get(f.scale, 0.5)) for f in changed]
    found = verdict(replace(comparison, figures=tuple(changed)))
    assert found.sentence == "Calmer and truer to the source at every distance. Recommended."
    assert "was not measured" in verdict(compared([])).sentence
    assert "These are plain MIP maps" in verdict(compared([], ("linear (box)",))).sentence


# ---- films


def jods(**films: tuple[float, ...]) -> list[Figure]:
    return [f for name, row in films.items() for f in film_figures(name, dict(zip(FEW, row, strict=True)))]


def with_films(figures: list[Figure], names: tuple[str, ...] = FEW, **changes: Any) -> Comparison:
    made = made_up(names, 16)
    return replace(made, figures=(*made.figures, *figures), **changes)


def test_the_verdict_says_first_what_films_show() -> None:
    found = verdict(with_films(jods(floor=(9.0, 8.58, 8.2), wall=(9.7, 9.75, 9.4), sphere=(8.0, 8.05, 8.25))))
    first, second = found.details.split(". ", 1)
    assert first == (
        "In films, as ColorVideoVDP judges them, neural looks better than linear (box) on the floor (by 0.42 JOD) and "
        "shows no visible difference on the wall and the sphere; it looks better than the best closed form of each "
        "film on the floor (by 0.42 JOD), looks worse than it on the sphere (by 0.25 JOD) and shows no visible "
        "difference on the wall"
    )
    assert second.startswith("In decibels of SNR under single lights, neural beats")


@pytest.mark.parametrize(("ahead", "outcome"), [(VISIBLE_JOD + 0.01, 1), (0.09, 0), (-0.11, -1)])
def test_a_tenth_of_a_jod_is_visible(ahead: float, outcome: int) -> None:
    found = verdict(with_films(jods(wall=(9.0 + ahead, 9.0, 8.0))))
    words = {1: "looks better than linear (box) on the wall", -1: "looks worse than linear (box) on the wall"}
    assert f"neural {words.get(outcome, 'shows no visible difference from linear (box) on the wall.')}" in (
        found.details
    )
    assert found.details.count("linear (box) on the wall") == 1  # the best closed form is not told twice


def test_films_without_a_difference_a_judge_or_a_rival() -> None:
    sentence = verdict(with_films(jods(floor=(9, 9, 8.95), wall=(9, 8.97, 9)))).details
    assert "neural shows no visible difference from linear (box) in any film; it shows no visible" in sentence
    flip = {"neural": 0.08, "linear (box)": 0.107, "lean (gaussian)": 0.082}
    found = verdict(with_films(film_figures("floor", {}, flip)))
    assert found.details.startswith(
        "In films, as FLIP judges them, neural looks better than linear (box) on the floor (0.080 instead of 0.107); "
        "it shows no visible difference from lean (gaussian), the best closed form of every film, on the floor. "
    )
    assert verdict(made_up(FEW, 16)).details.startswith("neural beats")
    alone = verdict(with_films(film_figures("wall", {"neural": 9.0}), FEW[:1]))
    assert alone.details == (
        "neural was compared with no closed form. Its films have 9.00 on the wall, in JOD of ColorVideoVDP: 10 is no "
        "visible difference from the reference."
    )
    for names, value in ((FEW[:1], math.nan), (FEW[:2], 9.0)):  # nobody's figure, and a closed form without one
        nothing = with_films(film_figures("wall", {"neural": value}), names, rendered=())
        assert "compared with no closed form" not in verdict(nothing).details
    only = replace(made_up(FEW, 16), curve=(), figures=tuple(jods(wall=(9, 8, 7))))
    assert verdict(only).details.startswith("In films") and verdict(only).details.endswith("(by 1.00 JOD).")


# ---- tables and curves


def test_the_first_table_has_what_films_show_and_the_better_is_marked() -> None:
    flicker = [
        Figure(name, "flicker", "film-wall", "", 0.2, value, math.nan, math.nan)
        for name, value in zip(FEW, (1.1, 1.6, 3.0), strict=True)
    ]
    films = [filmed(name) for name in ("floor", "wall")]
    films[1] = replace(films[1], scene=replace(films[1].scene, lod=0.2))
    found = with_films([*jods(floor=(9.0, 9.05, 8.2), wall=(9.7, 9.95, 9.4)), *flicker], FEW, films=tuple(films))
    rows = [row.split("</td>") for row in seen_table(found).split("<tr>")[3:]]
    cells = [[(re.sub("<[^>]*>", " ", cell).split(), "win" in cell) for cell in row[:4]] for row in rows]
    assert cells == [
        [(["Near", "A", "wall", "9.95"], True), (["9.70"], False), (["1.60"], False), (["1.10"], True)],
        [(["Middle", "distance", "A", "floor", "9.05"], True), (["9.00"], True), (["\N{EN DASH}"], False),
         (["\N{EN DASH}"], False)],
    ]  # fmt: skip
    renders = Page(seen_table(made_up(FEW, 16)))
    assert [word for word in renders.text if word in ("Near", "Middle distance", "Far")] == [
        "Near",
        "Middle distance",
        "Far",
    ]
    assert seen_table(compared([])) == ""


@pytest.mark.parametrize(
    ("subject", "kind", "said"),
    [("neural", "neural", "mipbake"), ("baked", "refine", "mipbake"), ("lean (box)", "lean", "lean (box)")],
)
def test_what_methods_are_called(subject: str, kind: str, said: str) -> None:
    made = compared([], (subject, "linear (box)", "neural"))
    made = replace(made, methods=(replace(made.methods[0], method=kind), *made.methods[1:]))
    names = [called(made, name) for name in (subject, "linear (box)", "vmf (box)")]
    assert names == [said, "plain MIP maps", "vmf (box)"]


def test_the_best_of_each_column_is_marked_by_what_its_measure_means() -> None:
    rows = {"neural": (1.3, 0.10), "linear (box)": (0.9, 0.30), "lean (gaussian)": (math.nan, 0.2)}
    figures = [
        Figure(name, measure, "sphere", "near", 0, value, math.nan, math.nan)
        for name, values in rows.items()
        for measure, value in zip(("flicker", "flip"), values, strict=True)
    ]
    tables = measure_tables(compared(figures))
    flicker, flip = (next(t for t in tables.split("<table")[1:] if f"<b>{name}" in t) for name in ("Flicker", "FLIP"))
    assert re.search(r"linear \(box\)</th><td class=\"best\"", flicker)
    assert re.search(r"neural</th><td class=\"best\"", flip)
    assert flicker.count('class="best"') == flip.count('class="best"') == 1
    assert ">\N{EN DASH}</td>" in flicker
    text = measure_tables(compared([Figure("neural", "snr", "hemisphere", "near", 0, 15.04, -1.21, 20.96)]))
    bounds = "\N{MINUS SIGN}1.2\N{NO-BREAK SPACE}to 21.0"
    assert "15.0" in text and f"<small>{bounds}</small>" in text and f'title="95 % interval {bounds}"' in text


def test_numbers() -> None:
    assert number(12.345, "snr") == "12.3" and number(-3, "snr") == "\N{MINUS SIGN}3.0"
    assert number(1.26, SNR_GAIN) == "+1.3" and number(math.inf, "snr") == "∞"
    assert number(math.nan, "flip") == "\N{EN DASH}"
    assert [number(v, "flip") for v in (0.12345, 0.0123, 123.4)] == ["0.123", "0.0123", "123"]
    assert number(0.0123, "flip", 0.5) == "0.012" and number(1.0, "flicker", 30.0) == "1.00"
    assert number(9.876, "jod-37") == "9.88"


def test_every_curve_is_drawn_and_a_gap_breaks_it() -> None:
    comparison = made_up(NAMES, 16)
    page = Page(curves(comparison))
    lines = [a for a in page.all("path") if str(a["class"]).startswith("line ")]
    assert {a["data-method"] for a in lines} == set(NAMES) and len(lines) == 2 * len(NAMES)
    on = {a["data-method"] for a in lines if " on" in str(a["class"])}
    assert on == {"neural", "linear (box)", "unreal (gaussian)", "optimum"}
    assert {a["data-method"] for a in page.all("input") if "checked" in a} == on
    colours = {a["data-method"]: str(a["class"]).split()[1] for a in lines}
    assert colours["linear (box)"] == colours["linear (gaussian)"] and len(set(colours.values())) == 5
    dashed = {a["data-method"] for a in lines if "dashed" in str(a["class"])}
    assert dashed == {"linear (box)", "lean (box)"}
    broken = [replace(p, value=math.nan) if p.lod == 3 and p.method == "neural" else p for p in comparison.curve]
    page = Page(curves(replace(comparison, curve=tuple(broken))))
    lines = [a for a in page.all("path") if str(a["class"]).startswith("line ")]
    assert {str(a["d"]).count("M") for a in lines if a["data-method"] == "neural"} == {2}
    assert not any(re.search("nan|inf", str(a["d"])) for a in page.all("path"))


# ---- colours


def test_the_ramp_is_even_and_rises() -> None:
    linear = np.asarray(ramp(), np.float64) / 255
    linear = np.where(linear <= 0.04045, linear / 12.92, ((linear + 0.055) / 1.055) ** 2.4)
    # Forwards, by the published matrices: from linear sRGB to Oklab's lightness.
    cones = linear @ np.array(
        [[0.4122214708, 0.2119034982, 0.0883024619], [0.5363325363, 0.6806995451, 0.2817188376],
         [0.0514459929, 0.1073969566, 0.6299787005]]
    )  # fmt: skip
    lightness = np.cbrt(cones) @ [0.2104542553, 0.7936177850, -0.0040720468]
    assert (np.diff(lightness[8:]) > 0).all()  # the darkest are as few bytes
    np.testing.assert_allclose(np.diff(lightness[16::24]), 0.88 * 24 / 255, atol=0.012)


def test_pictures_and_error_maps_as_bytes() -> None:
    values = np.linspace(-1, 2, 3000, dtype=np.float32).reshape(30, 100)
    pixels = heat(values, 0.5)
    assert (pixels[0, 0] == ramp()[0]).all() and (pixels[-1, -1] == ramp()[-1]).all()
    assert len(np.unique(pixels.reshape(-1, 3), axis=0)) <= 64
    assert (heat(np.array([[np.nan, np.inf]]), 1.0)[0, 0] == ramp()[0]).all()
    pixels = displayed_bytes(np.array([[[np.nan, -1.0, np.inf], [1.0, 0.0, 3.0]]], np.float32))
    assert pixels.tolist() == [[[0, 0, 255], [188, 0, 225]]]
    comparison = made_up(FEW, 16)
    for size, top in ((0.0, 0.1), (0.15, 0.2), (0.3, 0.3), (1.0, 1.0)):
        rendered = [replace(r, flip={n: np.full_like(f, size) for n, f in r.flip.items()}) for r in comparison.rendered]
        assert flip_top(replace(comparison, rendered=tuple(rendered))) == pytest.approx(top)
