"""Films in a report, without a browser: what the verdict says of them, and what the page holds."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from mipbake.comparing.page import write_report
from mipbake.comparing.page.films import film_names
from mipbake.comparing.page.seen import VISIBLE_JOD, seen
from mipbake.comparing.page.tables import films_table, number
from mipbake.comparing.page.verdict import verdict
from mipbake.comparing.result import Comparison
from mipbake.quality.figures import Figure

from .report_cases import NAMES, Page, film_figures, film_grey, filmed, made_up

FEW = ("neural", "linear (box)", "lean (gaussian)")


def compared(figures: list[Figure], names: tuple[str, ...] = FEW, **changes: Any) -> Comparison:
    made = made_up(names, 16)
    return replace(made, figures=(*made.figures, *figures), **changes)


def jods(**films: tuple[float, ...]) -> list[Figure]:
    return [f for name, row in films.items() for f in film_figures(name, dict(zip(FEW, row, strict=True)))]


def test_the_verdict_says_first_what_films_show() -> None:
    figures = jods(floor=(9.0, 8.58, 8.2), wall=(9.7, 9.75, 9.4), sphere=(8.0, 8.05, 8.25))
    found = verdict(compared(figures))
    first, second = found.sentence.split(". ", 1)
    assert first == (
        "In films, as ColorVideoVDP judges them, neural looks better than linear (box) on the floor (by 0.42 JOD) and "
        "shows no visible difference on the wall and the sphere; it looks better than the best closed form of each "
        "film on the floor (by 0.42 JOD), looks worse than it on the sphere (by 0.25 JOD) and shows no visible "
        "difference on the wall"
    )
    assert second.startswith("In decibels of SNR under single lights, neural beats")
    assert [(s.film, s.rival, s.outcome) for s in found.seen_closed] == [
        ("film-floor", "linear (box)", 1), ("film-wall", "linear (box)", 0), ("film-sphere", "lean (gaussian)", -1),
    ]  # fmt: skip
    cells = Page(films_table(found)).all("td")
    assert [c.get("class") for c in cells[1:]] == ["win", "tie", "loss", "win", "tie", "tie"]
    assert cells[1]["title"] == "9.00 and 8.58 JOD"


@pytest.mark.parametrize(("ahead", "outcome"), [(VISIBLE_JOD + 0.01, 1), (0.09, 0), (-0.09, 0), (-0.11, -1)])
def test_a_tenth_of_a_jod_is_visible(ahead: float, outcome: int) -> None:
    found = verdict(compared(jods(wall=(9.0 + ahead, 9.0, 8.0))))
    assert [s.outcome for s in (*found.seen_closed, *found.seen_linear)] == [outcome] * 2
    words = {1: "looks better than linear (box) on the wall", -1: "looks worse than linear (box) on the wall"}
    said = words.get(outcome, "shows no visible difference from linear (box) on the wall.")
    assert f"neural {said}" in found.sentence
    assert found.sentence.count("linear (box) on the wall") == 1  # the best closed form is not told twice


def test_films_that_show_no_difference_are_told_in_a_clause() -> None:
    sentence = verdict(compared(jods(floor=(9, 9, 8.95), wall=(9, 8.97, 9)))).sentence
    assert "neural shows no visible difference from linear (box) in any film; it shows no visible" in sentence


def test_flip_decides_where_nobody_judged() -> None:
    figures = film_figures("floor", {}, {"neural": 0.08, "linear (box)": 0.107, "lean (gaussian)": 0.082})
    found = verdict(compared(figures))
    assert found.sentence.startswith(
        "In films, as FLIP judges them, neural looks better than linear (box) on the floor (0.080 instead of 0.107); "
        "it shows no visible difference from lean (gaussian), the best closed form of every film, on the floor. "
    )
    assert Page(films_table(found)).all("td", class_="win")[0]["title"] == "0.080 and 0.107"


def test_a_comparison_without_films_or_rivals_says_nothing_of_them() -> None:
    assert seen(made_up(FEW, 16)) == ((), ())
    assert verdict(made_up(FEW, 16)).sentence.startswith("neural beats")
    alone = compared(film_figures("wall", {"neural": 9.0}), FEW[:1])
    assert seen(alone) == ((), ()) and films_table(verdict(alone)) == ""
    assert verdict(alone).sentence == (
        "neural was compared with no closed form. Its films have 9.00 on the wall, in JOD of ColorVideoVDP: 10 is no "
        "visible difference from the reference."
    )
    for missing in (FEW[:1], FEW[:2]):  # without a closed form, and with one whose figure is not there
        nothing = compared(film_figures("wall", {"neural": 9.0 if missing[1:] else math.nan}), missing, rendered=())
        assert "compared with no closed form" not in verdict(nothing).sentence
    unknown = film_figures("wall", {"neural": math.nan, "linear (box)": 9.0})
    assert seen(compared(unknown)) == ((), ())
    only = Comparison("s", "neural", "gltf", "gaussian", made_up(FEW, 16).methods, (), tuple(jods(wall=(9, 8, 7))))
    assert verdict(only).sentence.startswith("In films") and verdict(only).sentence.endswith("(by 1.00 JOD).")


def test_jod_has_two_decimals() -> None:
    assert number(9.876, "jod-37") == "9.88" and number(-1.2, "jod-75") == "\N{MINUS SIGN}1.20"


# ---- the page


@pytest.fixture(scope="module")
def report(tmp_path_factory: pytest.TempPathFactory) -> tuple[Comparison, list[Path], Page]:
    figures = [f for film in ("floor", "wall") for f in film_figures(film, dict.fromkeys(FEW, 9.25))]
    films = tuple(filmed(name, FEW) for name in ("floor", "wall"))
    comparison = compared(figures, films=films)
    files = write_report(comparison, {}, None, tmp_path_factory.mktemp("reports") / "report")
    return comparison, files, Page(files[0].read_text(encoding="utf-8"))


def test_a_film_is_one_picture_for_each_method(report: Any) -> None:
    _, files, page = report
    for film in ("film-floor", "film-wall"):
        for index, name in enumerate(("reference", "neural", "linear-box", "lean-gaussian")):
            sheet = np.asarray(Image.open(files[0].parent / "images" / f"{film}--{name}.png").convert("RGB"))
            assert sheet.shape == (4 * 24, 36, 3)
            for frame in range(4):
                assert (sheet[24 * frame : 24 * (frame + 1)] == film_grey(index - 1, frame)).all()
    shown = page.all("figure", class_="scene film")
    assert [(each["data-scene"], each["data-frames"], each["data-fps"]) for each in shown] == [
        ("film-floor", "4", "30"), ("film-wall", "4", "30"),
    ]  # fmt: skip
    frames = page.all("div", class_="frame")
    assert len(frames) == 8 and {each["style"] for each in frames} == {"aspect-ratio: 36 / 24"}


def test_films_come_first_and_have_figures(report: Any) -> None:
    _, _, page = report
    assert [a["id"] for a in page.all("section")][:2] == ["films", "pictures"]
    text = " ".join(page.text)
    assert "In films, ColorVideoVDP at 37 pixels per degree, ahead of" in text
    assert "Every measure in the film of the floor" in text
    assert "9.25 JOD" in text
    figures = [a["data-figures"] for a in page.all("figure", **{"data-method": "neural"}) if a.get("data-figures")]
    assert '"ColorVideoVDP at 37 pixels per degree": "9.25 JOD"' in str(figures[0])


def test_the_page_shows_films_of_what_stands_out_and_of_what_is_best() -> None:
    films = (filmed("floor"), filmed("wall"))
    jod = dict.fromkeys(NAMES, 8.0) | {"lean (box)": 9.0}
    names = film_names(compared(film_figures("floor", jod), NAMES, films=films))
    assert names == ["neural", "unreal (gaussian)", "linear (box)", "optimum", "lean (box)"]
    assert film_names(compared([], NAMES)) == []
