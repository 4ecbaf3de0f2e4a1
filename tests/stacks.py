"""Stacks for the tests of what is written."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from mipbake.material import convert
from mipbake.material.pixel_filter import level_sizes
from mipbake.stack.manifest import manifest_path, read_back, read_manifest
from mipbake.stack.map_files import MapFile
from mipbake.stack.stack import MipStack, Provenance


def read_output(folder: Path, index: int) -> list[MapFile]:
    """The files of one output of a saved stack, as they are in the folder."""
    return read_back(folder, read_manifest(manifest_path(folder))["outputs"][index])


def smooth(shape: tuple[int, int], channels: int, seed: int = 0) -> np.ndarray:
    """(H, W, channels) float32 within 0.05 and 0.95: slow waves and a little noise."""
    rng = np.random.default_rng([seed, *shape])
    y, x = np.mgrid[0 : shape[0], 0 : shape[1]]
    waves = np.stack([np.sin(x / 5 + i + seed) * np.cos(y / 6 - i) for i in range(channels)], -1)
    return np.clip(0.5 + 0.4 * waves + rng.normal(0, 0.01, waves.shape), 0.05, 0.95).astype(np.float32)


def unit(vectors: np.ndarray) -> np.ndarray:
    return (vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)).astype(np.float32)


def gltf_level(shape: tuple[int, int], seed: int = 0, anisotropic: bool = False) -> np.ndarray:
    """A level of the model gltf, or of gltf-anisotropic."""
    slopes = smooth(shape, 2, seed + 1) - 0.5
    parts = [smooth(shape, 5, seed), unit(np.concatenate([slopes, np.ones((*shape, 1), np.float32)], -1))]
    if anisotropic:
        parts += [unit(smooth(shape, 2, seed + 2)), smooth(shape, 1, seed + 3)]
    return np.concatenate(parts, -1)


def constant(shape: tuple[int, ...], model: str) -> np.ndarray:
    """(*shape, C) float32 texels of any model, all the same: a tilted anisotropic metal."""
    texel = np.array([0.2, 0.4, 0.6, 0.9, 0.35, 0, -0.6, 0.8, 0.6, 0.8, 0.7])
    stored = convert(texel, "gltf-anisotropic", model).astype(np.float32)
    return np.broadcast_to(stored, (*shape, len(stored))).copy()


def made_stack(
    size: tuple[int, int],
    model: str = "gltf",
    wrap: tuple[str, str] = ("wrap", "clamp"),
    seed: int = 0,
) -> MipStack:
    """A stack whose levels have nothing to do with each other, with an occlusion map of half the height."""
    half = (max(1, size[0] // 2), size[1])
    return MipStack(
        name="sample",
        model=model,
        levels=[gltf_level(s, seed + i, model != "gltf") for i, s in enumerate(level_sizes(*size))],
        extra={"occlusion": [smooth(s, 1, seed + i) for i, s in enumerate(level_sizes(*half))]},
        wrap=wrap,
        provenance=Provenance("linear", "gaussian", tool_version="0", sources={"a.png": "ab"}, source_hash="cd"),
    )
