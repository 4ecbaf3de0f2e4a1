"""Stacks for the tests of the interactive view, and what a page holds of them."""

from __future__ import annotations

import base64
import json
import re
import zlib
from typing import Any

import numpy as np

from mipbake.material import convert
from mipbake.material.pixel_filter import level_sizes
from mipbake.stack.stack import MipStack, Provenance

from .input_files import height_field

PROVENANCE = Provenance("linear", "gaussian")


def averaged(level: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """The next level of a stack: means over the texels that fall into each."""
    for axis in (0, 1):
        edges = np.arange(size[axis]) * level.shape[axis] // size[axis]
        counts = np.diff([*edges, level.shape[axis]]).reshape([-1, 1, 1] if axis == 0 else [1, -1, 1])
        level = np.add.reduceat(level, edges, axis) / counts
    return level.astype(np.float32)


def material(model: str, height: int = 48, width: int = 64) -> np.ndarray:
    """(H, W, C) float32: a bumpy surface of random colours, metals among them; anisotropic where the model is."""
    rng = np.random.default_rng(5)
    colour = rng.uniform(0.1, 0.9, (height, width, 3))
    metallic, roughness = rng.integers(0, 2, (height, width, 1)), rng.uniform(0.3, 0.7, (height, width, 1))
    stored = np.concatenate([colour, metallic, roughness, height_field(height, width, steepness=0.08)], -1)
    angle = 0.7 + 0.3 * rng.random((height, width))
    strength = rng.uniform(0.3, 0.7, (height, width, 1))
    stored = np.concatenate([stored, np.cos(angle)[..., None], np.sin(angle)[..., None], strength], -1)
    return (stored[..., :8] if model == "gltf" else convert(stored, "gltf-anisotropic", model)).astype(np.float32)


def stack_of(level: np.ndarray, model: str, wrap: tuple[str, str] = ("wrap", "wrap")) -> MipStack:
    levels = [level]
    for size in level_sizes(*level.shape[:2])[1:]:
        levels.append(averaged(levels[-1], size))
    return MipStack("test", model, levels, {}, wrap, PROVENANCE)


# ---- pages, without a browser


def scene_of(fragment: str) -> Any:
    found = re.search(r'<script type="application/json">(.*?)</script>', fragment, re.DOTALL)
    assert found
    return json.loads(found.group(1))


def texels_of(scene: Any) -> list[list[list[np.ndarray]]]:
    """The numbers of every image of a scene, by level and texture: unpacked a byte at a time, by the book."""
    left = iter(zlib.decompress(base64.b64decode(scene["texels"]["data"])))
    weights = iter(scene["texels"]["weights"])
    made: list[tuple[Any, list[list[dict[int, np.ndarray]]]]] = []
    for image in scene["images"]:
        levels: list[list[dict[int, np.ndarray]]] = []
        other = made[-1] if made and all(made[-1][0][key] == image[key] for key in ("model", "half")) else None
        for level, (height, width) in enumerate(image["sizes"]):
            levels.append([{} for _ in image["srgb"]])
            for texture, planes in enumerate(levels[level]):
                for byte in (1, 0, *range(2, 8 if image["half"] else 4)):
                    sources = [(planes[1], ((0, 0), (0, -1), (-1, 0)))] if byte != 1 else []
                    if other and other[0]["sizes"][level : level + 1] == [[height, width]]:
                        cross = ((0, 0), (0, -1), (0, 1), (-1, 0), (1, 0))
                        sources.append((other[1][level][texture][byte], cross))
                    if level and image["sizes"][level - 1] == [2 * height, 2 * width]:
                        four = levels[level - 1][texture][byte][1:-1, 1:-1].reshape(height, 2, width, 2)
                        sources.append((np.pad((four.sum((1, 3)) + 2) // 4, 1), ((0, 0),)))
                    plane = np.zeros((height + 2, width + 2), int)
                    sources.insert(0, (plane, ((0, -1), (-1, 0), (-1, -1), (-1, 1))))
                    chosen = next(weights)
                    for y in range(1, height + 1):
                        for x in range(1, width + 1):
                            seen = [int(of[y + down, x + right]) for of, places in sources for down, right in places]
                            total = sum(w * value for w, value in zip(chosen, seen, strict=True))
                            plane[y, x] = (min(max((total + 2048) // 4096, 0), 255) + next(left)) % 256
                    planes[byte] = plane
        made.append((image, levels))
    assert next(left, None) is None and next(weights, None) is None
    return [[[_numbers(planes, image["half"]) for planes in textures] for textures in levels] for image, levels in made]


def _numbers(planes: dict[int, np.ndarray], half: bool) -> np.ndarray:
    whole = np.stack([planes[byte][1:-1, 1:-1] for byte in sorted(planes)], -1).astype(np.uint8)
    return whole.view(np.float16).astype(np.float32) if half else whole / 255
