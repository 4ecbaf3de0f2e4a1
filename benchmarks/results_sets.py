"""What is measured: texture sets of a folder, the same in another material model, generated ones, and parts of sets."""

from __future__ import annotations

import dataclasses
import hashlib
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import mipbake
from mipbake import TextureSet, material
from mipbake.training.augmentation import boost
from mipbake.training.captured import MODEL as CAPTURED
from mipbake.training.captured import captured_set
from mipbake.training.procedural import procedural_set
from mipbake.training.reliefs import noise

Image = NDArray[np.float32]

Sets = Mapping[str, Callable[[], TextureSet]]
"""Name of a set to what reads or makes it."""

WINDOW = 32
"""Texels a side in which the direction of bumps is looked for: a pixel at level 5."""

DIRECTIONAL = 0.5
"""Directionality from which bumps count as directional: slopes vary three times as much across as along."""

_FIRST_SEED = 2_000_000  # of generated sets: training and its validation use smaller ones


@dataclass(frozen=True)
class InModel(TextureSet):
    """A set whose source is given in any material model: references of it are shaded in that model.

    Args:
        model: a name in `mipbake.material.MODELS`.
        stored: (H, W, C) float32 stored channels of level 0.
    """

    model: str = "gltf"
    stored: Image = dataclasses.field(default_factory=lambda: np.zeros((1, 1, 8), np.float32), compare=False)

    @property
    def source_model(self) -> str:
        return self.model

    def material(self, model: str) -> Image:
        return np.ascontiguousarray(material.convert(self.stored, self.model, model), np.float32)


def in_model(texture_set: TextureSet, model: str) -> InModel:
    """A set converted texel by texel, as `mipbake convert` does, and then the source itself."""
    return _source(texture_set.name, texture_set.material(model), model, texture_set.wrap)


def _source(name: str, stored: Image, model: str, wrap: tuple[str, str] = ("wrap", "wrap")) -> InModel:
    convention = mipbake.source.texture_set.NormalConvention("opengl", "option", 1.0)
    digest = hashlib.sha256(model.encode() + stored.tobytes()).hexdigest()
    height, width = stored.shape[:2]
    return InModel(name, {}, width, height, wrap, convention, digest, model=model, stored=stored)


def boosted(texture_set: InModel) -> InModel:
    """The set, a little glossier and bumpier (section 4 of Kemppinen et al. 2023), as trainings of `paper-*` see it."""
    stored = boost(texture_set.stored[None], texture_set.model)[0]
    return _source(texture_set.name, stored, texture_set.model, texture_set.wrap)


def captured(seed: int, size: int) -> InModel:
    """A set of the generator of Beckmann lobes, which no training has seen."""
    return _source(f"captured-{seed}", captured_set(_FIRST_SEED + seed, size).astype(np.float32), CAPTURED)


def middle(texture_set: TextureSet, side: int) -> InModel:
    """The middle `side` x `side` texels, addressed with clamping."""
    stored = texture_set.material(texture_set.source_model)
    top, left = ((length - min(side, length)) // 2 for length in stored.shape[:2])
    part = np.ascontiguousarray(stored[top : top + side, left : left + side])
    return _source(texture_set.name, part, texture_set.source_model, ("clamp", "clamp"))


def folder_sets(folder: Path, holding: str = "") -> Sets:
    """Every sub-folder is a set; with `holding`, only a sub-folder that has a file of this name."""
    if not folder.is_dir():
        raise SystemExit(f"{folder}: expected a folder of texture sets")
    paths = [path for path in sorted(folder.iterdir()) if path.is_dir() and (path / holding).exists()]
    return {path.name: lambda path=path: mipbake.load(path) for path in paths}  # type: ignore[misc]


def directionality(normal: NDArray[np.floating]) -> float:
    """How far bumps run in one direction, from 0 to 1, of (H, W, 3) normals.

    (high - low) / (high + low) of the eigenvalues of the covariance of slopes in windows of WINDOW x WINDOW texels,
    each window counted with its variance. 0 where there are no bumps.
    """
    slopes = (normal[..., :2] / np.maximum(normal[..., 2:], 0.02)).astype(np.float64)
    side = min(WINDOW, *slopes.shape[:2])
    rows, columns = (length // side for length in slopes.shape[:2])
    windows = slopes[: rows * side, : columns * side].reshape(rows, side, columns, side, 2)
    windows = windows - windows.mean((1, 3), keepdims=True)
    x, y = windows[..., 0], windows[..., 1]
    xx, yy, xy = ((a * b).mean((1, 3)) for a, b in ((x, x), (y, y), (x, y)))
    total = float((xx + yy).sum())
    return float(np.hypot(xx - yy, 2 * xy).sum()) / total if total > 1e-9 else 0.0


def bumps(texture_set: TextureSet) -> dict[str, float]:
    """Directionality, and the root mean square of slopes, of a set."""
    normal = texture_set.maps["normal"].pixels
    slopes = normal[..., :2] / np.maximum(normal[..., 2:], 0.02)
    return {"directionality": directionality(normal), "slope": float(np.sqrt(np.square(slopes).sum(-1).mean()))}


def procedural(seed: int, size: int) -> TextureSet:
    """A set of the project's generator."""
    stored = procedural_set(seed, size)
    return TextureSet.from_arrays(
        f"procedural-{seed}",
        base_color=stored[..., :3],
        metallic=stored[..., 3],
        roughness=stored[..., 4],
        normal=stored[..., 5:8],
    )


def directional(sets: Sets, count: int, size: int) -> Iterator[tuple[str, TextureSet]]:
    """The sets among `sets` with an anisotropy map or directional bumps, then `count` generated ones with such bumps,
    of `size` x `size` texels."""
    for name, load in sets.items():
        texture_set = load()
        if texture_set.anisotropic or bumps(texture_set)["directionality"] >= DIRECTIONAL:
            yield name, texture_set
    found, seed = 0, _FIRST_SEED
    while found < count:
        texture_set = procedural(seed, size)
        if bumps(texture_set)["directionality"] >= DIRECTIONAL:
            found += 1
            yield texture_set.name, texture_set
        seed += 1


_LOBES = {False: ((0.12, 0.35), 0.9), True: ((0.03, 0.1), 2.0)}
"""Whether lobes are sharp, to their least and largest mean alpha and the largest logarithm of alpha_x / alpha_y."""


def correlated(seed: int, size: int, together: bool, sharp: bool = False) -> InModel:
    """A `ggx` material whose albedo, F0 and anisotropic roughness follow its normals (figure 11 of Kemppinen et al.).

    Slopes that face one way are coloured, glossy and brushed along the slope; those that face the other way are pale,
    rough and brushed across it.

    Args:
        seed, size: of the set, and its side in texels.
        together: False moves the normals by half a period along both axes: every channel holds the same values, and
            which of them meet is chance.
        sharp: lobes are sharp and strongly anisotropic, as on brushed metal.
    """
    rng = np.random.default_rng([seed, 0xC0])
    height = noise(rng, size, 0.12)
    slope = np.stack([np.roll(height, -1, 1) - np.roll(height, 1, 1), np.roll(height, 1, 0) - np.roll(height, -1, 0)])
    slope *= 0.35 / np.sqrt(np.square(slope).sum(0).mean())
    angle = rng.uniform(0, 2 * np.pi)
    facing = (np.cos(angle) * slope[0] + np.sin(angle) * slope[1]) / 0.25
    share = (1 / (1 + np.exp(-4 * facing)))[..., None]  # 1 where a slope faces along the angle
    colours, gloss = rng.uniform(0.02, 0.7, (2, 3)), rng.uniform(0.04, 0.5, 3)
    albedo = colours[0] + (colours[1] - colours[0]) * share
    specular = 0.04 + (gloss - 0.04) * share
    (least, largest), strongest = _LOBES[sharp]
    log_alpha2 = 2 * np.log(largest) + 2 * np.log(least / largest) * share[..., 0]
    along = 2 * np.arctan2(slope[1], slope[0])
    stretch = strongest * (2 * share[..., 0] - 1)
    tensor = [log_alpha2 + stretch * np.cos(along), log_alpha2 - stretch * np.cos(along), stretch * np.sin(along)]
    normal = np.stack([-slope[0], -slope[1], np.ones_like(height)], -1)
    normal = (normal / np.linalg.norm(normal, axis=-1, keepdims=True))[..., :2]
    if not together:
        normal = np.roll(normal, (size // 2, size // 2), (0, 1))
    stored = np.concatenate([albedo, specular, normal, np.stack(tensor, -1)], -1).astype(np.float32)
    return _source(f"{'correlated' if together else 'independent'}-{seed}", stored, "ggx")


def correlated_sets(count: int, size: int) -> Sets:
    """Pairs of sets, with and without correlation."""
    made: dict[str, Callable[[], TextureSet]] = {}
    for seed in range(count):
        for together in (True, False):
            name = f"{'correlated' if together else 'independent'}-{seed}"
            made[name] = lambda seed=seed, together=together: correlated(seed, size, together)  # type: ignore[misc]
    return made
