"""A made-up comparison for the tests of the report: plausible figures and pictures, made quickly."""

from __future__ import annotations

import math
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np

from mipbake.comparing.result import Comparison, Filmed, FilmedScene, Plot, Rendered, Scene
from mipbake.material.filtered_source import FilteredSource
from mipbake.quality.figures import SCALES, Figure, Method

from .viewer_scenes import material, stack_of

NAMES = ("neural", "linear (box)", "linear (gaussian)", "lean (box)", "lean (gaussian)", "unreal (gaussian)", "optimum")

# SNR in dB near the mirror and over the hemisphere: of level 0, and how it changes by level.
QUALITY = {
    "neural": (15.0, 22.0, -0.3),
    "linear (box)": (11.4, 19.0, -0.4),
    "linear (gaussian)": (13.3, 21.5, -0.6),
    "lean (box)": (11.4, 19.2, -0.3),
    "lean (gaussian)": (14.3, 22.1, -0.8),
    "unreal (gaussian)": (14.6, 23.5, -0.8),
    "optimum": (17.0, 25.0, -0.1),
}
MEASURED = {"tonemapped": 0.02, "flip": 0.12, "hdr-flip": 0.3, "delta-e-itp": 12.0, "ssim": 0.9}


def method(name: str) -> Method:
    kind, _, kernel = name.partition(" ")
    return Method(name, kind, kernel.strip("()") or "gaussian", "gltf", 2.5)


def snr(name: str, view: str, lod: float) -> float:
    near, hemisphere, change = QUALITY.get(name, (12.0, 20.0, -0.5))
    return (near if view == "near-mirror" else hemisphere) + change * lod + 0.6 * math.sin(1.7 * lod)


def texture_figures(name: str) -> list[Figure]:
    found = []
    for view in ("near-mirror", "hemisphere"):
        for scale, (first, last) in SCALES.items():
            lod = (first + last) / 2
            value = snr(name, view, lod)
            found.append(Figure(name, "snr", view, scale, lod, value, value - 0.4, value + 0.5))
            found.append(Figure(name, "flicker", view, scale, lod, 1.4 - value / 40, math.nan, math.nan))
    return found


def curve(name: str) -> list[Figure]:
    spread = {"near-mirror": 2.0, "hemisphere": 0.5}
    return [
        Figure(
            name, "snr", view, "", lod, snr(name, view, lod), snr(name, view, lod) - s, snr(name, view, lod) + 1.5 * s
        )
        for view, s in spread.items()
        for lod in np.arange(0, 7.01, 0.25)
    ]


def picture(height: int, width: int, seed: int) -> np.ndarray:
    return np.random.default_rng(seed).random((height, width, 3), np.float32)


def rendered(name: str, title: str, view: str, scale: str, names: Any, size: tuple[int, int], lod: float) -> Rendered:
    reference = picture(*size, 7)
    images, flips = {}, {}
    for index, each in enumerate(names):
        share = np.float32(0.08 * (index + 1))
        images[each] = (1 - share) * reference + share * picture(*size, index)
        flips[each] = np.clip(np.abs(images[each] - reference).mean(-1) * 2, 0, 1)
    scene = Scene(name, title, view, scale, lod, size, "studio", 96, 0.002, 0.04, True)
    return Rendered(scene, reference, images, np.ones(size, bool), flips)


def filmed(name: str, names: Any = NAMES, frames: int = 4, size: tuple[int, int] = (24, 36)) -> Filmed:
    """A film whose frames have one grey each, so that a pixel tells the method and the frame: `film_grey`."""
    scene = FilmedScene(
        f"film-{name}", f"A {name}", "camera", "trilinear", 1.5, size, frames, 30.0, "studio", 0.8, 64, 0.002,
        0.02, True,
    )  # fmt: skip

    def of(index: int) -> np.ndarray:
        greys = [film_grey(index, frame) for frame in range(frames)]
        return np.repeat(np.uint8(greys), size[0] * size[1] * 3).reshape(frames, *size, 3)

    return Filmed(scene, of(-1), {each: of(index) for index, each in enumerate(names)})


def film_grey(index: int, frame: int) -> int:
    """Of a frame, of the method of that index in the comparison; -1 for the reference."""
    return 20 + 24 * (index + 1) + 5 * frame


def film_figures(name: str, jod: dict[str, float], flip: dict[str, float] | None = None) -> list[Figure]:
    """Figures of a film by method."""
    measured = [("jod-37", jod), ("flip", flip or dict.fromkeys(jod, 0.1))]
    return [
        Figure(method, measure, f"film-{name}", "", 1.5, value, math.nan, math.nan)
        for measure, found in measured
        for method, value in found.items()
    ]


def made_up(names: tuple[str, ...] = NAMES, size: int = 48, **changes: Any) -> Comparison:
    """A comparison of the named methods, the first one its subject; pictures of `size` pixels."""
    spheres = [
        rendered(f"sphere-{scale}", f"Sphere, {scale}", "sphere", scale, names, (size, size), sum(lods) / 2)
        for scale, lods in SCALES.items()
    ]
    plane = rendered("plane", "Plane, lod 0 to 6", "plane", "", names, (size, 2 * size), 2.3)
    figures = [figure for name in names for figure in texture_figures(name)]
    places = [*(("sphere", scale) for scale in SCALES), ("plane", "")]
    for index, name in enumerate(names):
        for view, scale in places:
            for measure, first in MEASURED.items():
                value = first * (1 + 0.1 * index) if measure != "ssim" else first - 0.02 * index
                figures.append(Figure(name, measure, view, scale, 1.0, value, math.nan, math.nan))
    keys = "temporal-slice", "half-pixel-shift", "apparent-brdf"
    plots = tuple(Plot(key, key, f"{key} of this material.", spheres[0].reference, spheres[0].images) for key in keys)
    made = Comparison(
        name="bricks",
        subject=names[0],
        model="gltf",
        pixel_filter="gaussian",
        methods=tuple(method(name) for name in names),
        curve=tuple(point for name in names for point in curve(name)),
        figures=tuple(figures),
        rendered=(*spheres, plane),
        plots=plots,
        source={
            "maps": {
                "base_color": {
                    "role": "base_color", "path": Path("in/bricks_Color.png"), "channels": "RGB", "width": 1024,
                    "height": 1024, "depth": "uint8", "encoding": "sRGB", "inverted": False,
                    "reason": "named Color", "constant": None,
                },
                "metallic": {"role": "metallic", "path": None, "reason": "no file: not a metal", "constant": (0.0,)},
            },
            "normal_convention": {"name": "opengl", "decided_by": "pixels", "confidence": 0.97},
            "notes": ["the set has no metallic map: it is taken for no metal."],
            "warnings": ["two files could be the base colour."],
            "ignored": [{"path": Path("in/preview.png"), "reason": "a preview"}],
        },
        notes=("the last level of this set is 6: far is measured there.",),
        settings={"seed": 0, "points": 8192, "samples": 64, "resolution": (48, 48), "kept": False},
        seconds={"bake": 12.3, "texture space": 30.0, "render": 61.5},
    )  # fmt: skip
    return replace(made, **changes)


def with_stacks(comparison: Comparison, size: tuple[int, int] = (32, 64)) -> tuple[Comparison, FilteredSource]:
    """The comparison with a stack of every method, and the source of the interactive view."""
    level = material("gltf", *size)
    stacks = {
        each.name: stack_of((level * (1 - 0.02 * i)).astype(np.float32), "gltf")
        for i, each in enumerate(comparison.methods)
    }
    return replace(comparison, stacks=stacks), FilteredSource(level, "gltf", ("wrap", "wrap"), "gaussian")


_VOID = {"meta", "link", "img", "input", "br", "col"}


class Page(HTMLParser):
    """Elements with their attributes in order, the text outside scripts and styles, and whether all are closed."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.elements: list[tuple[str, dict[str, str | None]]] = []
        self.text: list[str] = []
        self.open: list[str] = []
        self.feed(text)
        self.close()
        assert self.open == []

    def handle_starttag(self, tag: str, attrs: Any) -> None:
        self.elements.append((tag, dict(attrs)))
        if tag not in _VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag: str, attrs: Any) -> None:
        self.elements.append((tag, dict(attrs)))

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        if not {"script", "style"} & set(self.open):
            self.text.append(data)

    def all(self, tag: str, **attributes: str) -> list[dict[str, str | None]]:
        return [
            a for t, a in self.elements if t == tag and all(a.get(k.rstrip("_")) == v for k, v in attributes.items())
        ]
