"""The interactive view of a report: stacks on a lit plane, sphere or ball, one beside another or their difference.

A page holds everything it needs, shaders and texels included, and opens from disk. The levels are uploaded as they
were baked, none is made in the browser. Each side looks up its stack once per pixel, trilinearly, and shades once
(docs/conventions.md); the reference supersamples level 0 of the source with the pixel filter.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib.resources import files
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mipbake.comparing.viewer.packing import Texels, packed
from mipbake.material import MODELS, Kind, model_named
from mipbake.material.filtered_source import FilteredSource
from mipbake.material.pixel_filter import filter_named
from mipbake.quality.environment import Lighting
from mipbake.source.layout import LAYOUTS, to_file
from mipbake.stack.stack import MipStack

__all__ = ["LIGHTS", "TRUTH", "scene", "texel_bytes", "viewer_fragment", "viewer_module", "viewer_style"]

TRUTH = "truth"
"""What the view calls the reference."""

_SCRIPTS = ("shaders.js", "shapes.js", "unpacking.js", "renderer.js", "viewer.js")

_FILTER_BINS = 1024


_HALF_WIDTH = 0.22  # of soft boxes, at distance 1


@dataclass(frozen=True, eq=False)
class LightSet(Lighting):
    """Directional lights, the same for every side; a viewer is in front, at +z. K is 64 at most: what every device with
    WebGL 2 has uniforms for.

    Args:
        height: degrees by which the viewer lifts +z of the set at first; 0 leaves the set as it is.
    """

    height: float = 0.0


def _soft_box(towards: ArrayLike, strength: float, colour: ArrayLike) -> tuple[Any, Any]:
    """9 lights over a square around a direction; `strength` is the sum of their radiance."""
    centre = np.asarray(towards, np.float64) / np.linalg.norm(towards)
    right = np.cross([0.0, 1.0, 0.0], centre)
    right /= np.linalg.norm(right)
    places = [centre + _HALF_WIDTH * (x * right + y * np.cross(centre, right)) for y in (-1, 0, 1) for x in (-1, 0, 1)]
    directions = np.stack([p / np.linalg.norm(p) for p in places])
    return directions, np.broadcast_to(np.asarray(colour, np.float64) * strength / 9, (9, 3))


def _light_sets() -> tuple[LightSet, ...]:
    one = np.array([[0.0, 0.0, 1.0]])
    three = np.array([[-0.5, 0.62, 0.6], [0.85, 0.4, 0.35], [0.0, 0.45, -0.9]])
    boxes = (
        _soft_box([-0.6, 0.7, 0.6], 2.2 * math.pi, [1.0, 0.97, 0.92]),
        _soft_box([0.9, 0.45, 0.3], 1.0 * math.pi, [0.86, 0.93, 1.0]),
        _soft_box([0.0, 0.5, -0.9], 1.2 * math.pi, [1.0, 1.0, 1.0]),
    )
    return (
        LightSet(
            "Three lights",
            three / np.linalg.norm(three, axis=-1, keepdims=True),
            math.pi * np.array([[2.0, 1.95, 1.85], [0.7, 0.76, 0.82], [0.9, 0.9, 0.9]]),
        ),
        LightSet("One light", one, np.full((1, 3), 2.5 * math.pi), height=40.0),
        LightSet("Soft boxes", np.concatenate([b[0] for b in boxes]), np.concatenate([b[1] for b in boxes])),
    )


LIGHTS: tuple[LightSet, ...] = _light_sets()
"""Three separate lights, one light, and three soft boxes of nine lights each; the first one at first. A floor mirrors
one of them in the middle of its picture."""


def viewer_fragment(stacks: Mapping[str, MipStack], source: FilteredSource | None = None, half: bool = False) -> str:
    """The viewer as a piece of HTML for the body of a page; it needs no network and a browser with WebGL 2.

    Its style rules begin with `mv-` or `mipbake-viewer`, and its script leaves no global name. A page may hold several.

    Args:
        stacks: the name that the viewer shows, to the stack; the first and the last one are compared at first.
        source: what the reference, TRUTH, supersamples; without it there is none. With it, B is the reference at first
            where there is one stack.
        half: texels in half floats, twice as large, instead of 8 bits (colours sRGB-encoded) as most engines store
            them. Stacks of models that store logarithms are in half floats always.

    Raises:
        UsageError: a source with an unknown filter or model.
    """
    shown = json.dumps(scene(stacks, source, half), separators=(",", ":"))
    shown = shown.replace("</", "<\\/")  # would end the script element
    return (
        f"<style>\n{viewer_style()}</style>\n"
        '<div class="mipbake-viewer"><noscript>The interactive view needs JavaScript.</noscript>\n'
        f'<script type="application/json">{shown}</script></div>\n'
        f"<script>\n(() => {{\n'use strict';\n{_script()}}})();\n</script>"
    )


def viewer_module() -> str:
    """The viewer as a module of JavaScript, for pages that make scenes while they run.

    It exports `Viewer`, which takes an element and a scene as `scene` makes it, or one whose texels are arrays already;
    `SETTING`, the lights and the filter of a scene; and what pictures without a viewer need.
    """
    setting = json.dumps(_setting("gaussian"), separators=(",", ":"))
    return f"{_script()}export const SETTING = {setting};\nexport {{ AWAY, Viewer, posed }};\n"


def viewer_style() -> str:
    """The style sheet of the view."""
    return _text("viewer.css")


def _script() -> str:
    surfaces = json.dumps({name: model.view.surface for name, model in MODELS.items()})  # of shaders.js, in GLSL
    return "\n".join([f"const SURFACE_OF_MODEL = {surfaces};", *(_text(name) for name in _SCRIPTS)])


def _text(name: str) -> str:
    return files(__name__).joinpath(name).read_text(encoding="utf-8")


def scene(stacks: Mapping[str, MipStack], source: FilteredSource | None = None, half: bool = False) -> dict[str, Any]:
    """What the script reads, in types that JSON has: stacks, source, filter table and lights. Arguments and errors are
    those of `viewer_fragment`."""
    shown = [(TRUTH, source.model, [source.stored], source.wrap)] if source else []
    shown += [(name, stack.model, stack.levels, stack.wrap) for name, stack in stacks.items()]
    described: list[dict[str, Any]] = []
    texels = []
    for name, model, levels, wrap in shown:
        layout, halves = model_named(model), half or model_named(model).logarithms
        colours = [group.start for group in layout.of(Kind.REFLECTANCE)]
        described.append(
            {
                "name": name,
                "model": model,
                "wrap": list(wrap),
                "half": halves,
                "sizes": [level.shape[:2] for level in levels],
                "srgb": [channels[0] in colours for channels in layout.view.textures],
            }
        )
        texels.append(_texels(model, levels, halves))
    return {
        "images": described,
        "source": source is not None,
        "texels": packed(texels),
        **_setting(source.pixel_filter if source else "box"),  # without a source nothing looks at the filter
    }


def _setting(pixel_filter: str) -> dict[str, Any]:
    """Filter table and lights."""
    offsets, weights = filter_named(pixel_filter).offsets((np.arange(_FILTER_BINS) + 0.5) / _FILTER_BINS)
    return {
        "filter": {"offsets": np.round(offsets, 6).tolist(), "weights": np.round(weights, 6).tolist()},
        "lights": [
            {
                "name": light.name,
                "directions": np.round(light.direction, 7).tolist(),
                "radiance": light.radiance.tolist(),
                "height": light.height,
            }
            for light in LIGHTS
        ],
    }


def texel_bytes(model: str) -> int:
    """Bytes of a texel in the view's textures."""
    layout = model_named(model)
    return len(layout.view.textures) * 4 * (2 if layout.logarithms else 1)


def _texels(model: str, levels: Sequence[NDArray[np.float32]], half: bool) -> Texels:
    """The levels as textures of four channels: bytes, or half floats, two bytes each."""
    made = []
    for level in levels:
        stored: NDArray[np.floating] = np.asarray(level, np.float32)
        if not half:  # the numbers from 0 to 1 that an 8-bit file holds, colours sRGB-encoded
            parts = [to_file(level[..., layout.channels], layout.encodings, srgb=True) for layout in LAYOUTS[model]]
            stored = np.clip(np.concatenate(parts, -1), 0, 1)
        textures = []
        for channels in model_named(model).view.textures:
            texels = np.zeros((*level.shape[:2], 4), np.float16 if half else np.uint8)
            texels[..., : len(channels)] = stored[..., channels] if half else np.rint(255 * stored[..., channels])
            textures.append(texels.view(np.uint8))
        made.append(textures)
    return Texels(f"{model}, {half}", made)
