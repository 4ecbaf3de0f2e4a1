"""Stacks for the tests of the interactive view, and what a page holds of them."""

from __future__ import annotations

import base64
import json
import re
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


def texels_of(packed: dict[str, Any], index: int) -> list[np.ndarray]:
    """The numbers in each level of one packed map, undone by the book: inflate, sum along rows, interleave."""
    import zlib

    data = np.frombuffer(zlib.decompress(base64.b64decode(packed["maps"][index]["data"])), np.uint8)
    per_texel, start, levels = 8 if packed["half"] else 4, 0, []
    for height, width in packed["sizes"]:
        planes = data[start : start + per_texel * height * width].reshape(per_texel, height, width)
        start += planes.size
        texels = np.ascontiguousarray(np.cumsum(planes, 2, dtype=np.uint8).transpose(1, 2, 0))
        levels.append(texels.view(np.float16).astype(np.float32) if packed["half"] else texels / 255)
    assert start == data.size
    return levels
