"""Levels of a stack as what engines sample: plain texels, half floats, KTX 2 with RGBA8, BC7 and UASTC."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mipbake import MipStack
from mipbake.base.srgb import linear_to_srgb
from mipbake.material.pixel_filter import level_sizes
from mipbake.source.images import ktx2
from mipbake.source.images.blocks import to_blocks
from mipbake.source.images.gpu_format import GPU_FORMATS, GpuTexture

Image = NDArray[np.float32]
Bytes = NDArray[np.uint8]


@dataclass(frozen=True, eq=False)
class EngineMap:
    """A texture as glTF's material has it.

    Args:
        name: `base_color`, `normal` or `orm`.
        levels: (H_L, W_L, 4) float32 from 0 to 1, colours linear, finest first; top row first.
        colour: whether 8-bit files store it sRGB-encoded.
    """

    name: str
    levels: Sequence[Image]
    colour: bool


def engine_maps(levels: Sequence[Image]) -> list[EngineMap]:
    """The three textures of (H_L, W_L, 8) stored channels of the model `gltf`: roughness in G, metallic in B."""
    ones = [np.ones_like(level[..., 4]) for level in levels]
    orm = [np.stack([one, level[..., 4], level[..., 3]], -1) for one, level in zip(ones, levels, strict=True)]
    return [
        EngineMap("base_color", [_rgba(level[..., 0:3]) for level in levels], True),
        EngineMap("normal", [_rgba((level[..., 5:8] + 1) / 2) for level in levels], False),
        EngineMap("orm", [_rgba(each) for each in orm], False),
    ]


def stack_maps(stack: MipStack) -> list[EngineMap]:
    """The three textures of a stack of the model `gltf`."""
    if stack.model != "gltf":
        raise ValueError(f"the stack is in the model {stack.model}: expected gltf")
    return engine_maps(stack.levels)


def level_colours(count: int) -> NDArray[np.uint8]:
    """(count, 4) opaque colours that tell levels apart, also where two neighbours are mixed: 0 or 255 a channel."""
    cycle = [(255, 0, 0), (0, 255, 0), (0, 0, 255), (255, 255, 0), (0, 255, 255), (255, 0, 255), (255, 255, 255)]
    return np.array([(*cycle[level % len(cycle)], 255) for level in range(count)], np.uint8)


def level_coloured(side: int, colour: bool = False) -> EngineMap:
    """A square texture whose every level has one colour, `level_colours`; `colour` as in EngineMap."""
    sizes = level_sizes(side, side)
    colours = level_colours(len(sizes)).astype(np.float32) / 255
    return EngineMap(
        "levels", [np.broadcast_to(c, (*size, 4)).copy() for c, size in zip(colours, sizes, strict=True)], colour
    )


def write_map(given: EngineMap, kind: str, folder: Path) -> dict[str, Any]:
    """Writes a texture as one of KINDS into a folder; what the page must know to load it."""
    folder.mkdir(parents=True, exist_ok=True)
    container = kind.startswith("ktx2")
    path = folder / f"{given.name}-{kind}.{'ktx2' if container else 'bin'}"
    path.write_bytes(KINDS[kind](given))
    height, width = given.levels[0].shape[:2]
    srgb = given.colour and kind not in ("float", "half", "ktx2-rgba16f")
    sizes = {"width": width, "height": height, "levels": 1 if kind == "float" else len(given.levels)}
    return {"file": path.name, "kind": "ktx2" if container else kind, "srgb": srgb, **sizes}


def _rgba(level: Image) -> Image:
    return np.concatenate([np.clip(level, 0, 1), np.ones_like(level[..., :1])], -1).astype(np.float32)


def eight_bit(given: EngineMap) -> list[Bytes]:
    """(H_L, W_L, 4) uint8 texels, colours sRGB-encoded."""
    levels = [level.astype(np.float64) for level in given.levels]
    for level in levels if given.colour else ():
        level[..., :3] = linear_to_srgb(level[..., :3])
    return [np.floor(level * 255 + 0.5).astype(np.uint8) for level in levels]


def _float(given: EngineMap) -> bytes:
    return np.ascontiguousarray(given.levels[0], np.float32).tobytes()


def _half(given: EngineMap) -> bytes:
    return b"".join(np.ascontiguousarray(level, np.float16).tobytes() for level in given.levels)


def _container(given: EngineMap, name: str, levels: Sequence[bytes], compressed: bool) -> bytes:
    height, width = given.levels[0].shape[:2]
    texture = GpuTexture(GPU_FORMATS[name], width, height, tuple(levels), {"KTXorientation": b"rd\0"})
    return ktx2.encoded(texture, compressed)


def _ktx2_half(given: EngineMap) -> bytes:
    levels = [np.ascontiguousarray(level, np.float16).tobytes() for level in given.levels]
    return _container(given, "R16G16B16A16_SFLOAT", levels, True)


def _rgba8(given: EngineMap) -> bytes:
    return b"".join(level.tobytes() for level in eight_bit(given))


def _ktx2(given: EngineMap, name: str, compressed: bool = False) -> bytes:
    name = name.format("SRGB" if given.colour else "UNORM")
    return _container(given, name, to_blocks(eight_bit(given), GPU_FORMATS[name]), compressed)


def uastc(given: EngineMap) -> bytes:
    """A KTX 2 file of UASTC blocks with Zstandard, as KHR_texture_basisu takes it."""
    return _ktx2(given, "UASTC_RGB_{}_BLOCK", True)


KINDS: Mapping[str, Callable[[EngineMap], bytes]] = {
    "float": _float,
    "half": _half,
    "rgba8": _rgba8,
    "ktx2-rgba8": partial(_ktx2, name="R8G8B8A8_{}"),
    "ktx2-rgba16f": _ktx2_half,
    "ktx2-bc7": partial(_ktx2, name="BC7_{}_BLOCK"),
    "ktx2-uastc": uastc,
}
"""How a texture reaches the engine: level 0 in float32 (the reference), arrays, and KTX 2 files."""
