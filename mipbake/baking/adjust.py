"""Changes of a finished stack: level 0 as it was, less of an effect, a floor for the roughness."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from numbers import Real

import numpy as np
from numpy.typing import NDArray

from mipbake.baking.pipeline import Recipe, bake_stoppable
from mipbake.base.colour import unit_range
from mipbake.base.errors import UsageError
from mipbake.material import GLTF_MODELS
from mipbake.material.directions import facing, led
from mipbake.source.decode import unit_directions
from mipbake.source.images.image import turn_vectors
from mipbake.source.images.read import read_image
from mipbake.source.layout import LAYOUTS, channels_of
from mipbake.source.normal import holes, normalised
from mipbake.source.sources import taken
from mipbake.source.texture_set import TextureSet
from mipbake.stack.stack import MipStack

Level = NDArray[np.float32]

_SAME = 1e-5
"""Difference of unit vectors that is no more than rounding."""


@dataclass(frozen=True)
class Adjustments:
    """Changes of a stack; the defaults change nothing.

    Args:
        keep_level0: level 0 as the source's files have it, not filtered by the pixel filter. Normals and directions are
            not made unit, so that every texel comes out as it came in where format, packing and size are the same;
            where vectors have been changed since they were read (resampled, scaled, tiles), they are unit.
        strength: 1 keeps what was baked, 0 gives plainly averaged maps (`linear` with the box), what lies between a
            mixture.
        min_roughness: perceptual roughness that no texel falls below.
    """

    keep_level0: bool = False
    strength: float = 1.0
    min_roughness: float = 0.0

    def __post_init__(self) -> None:
        """UsageError for what is out of range."""
        for name, value in (("strength", self.strength), ("min_roughness", self.min_roughness)):
            if not isinstance(value, Real) or not 0 <= value <= 1:
                said = f"{value:g}" if isinstance(value, Real) else repr(value)
                raise UsageError(f"{name} is {said}: expected a number from 0 to 1")
        if not isinstance(self.keep_level0, bool):
            raise UsageError(f"keep_level0 is {self.keep_level0!r}: expected True or False")

    @classmethod
    def of(cls, options: object) -> Adjustments:
        """The adjustments among options, an object that has them as attributes."""
        return cls(**{each.name: getattr(options, each.name) for each in fields(cls)})

    def check(self, model: str) -> None:
        """UsageError where stacks of a model cannot be adjusted: their channels cannot be blended."""
        if self != Adjustments() and model not in GLTF_MODELS:
            raise UsageError(f"a stack of the model {model} cannot be adjusted: expected {' or '.join(GLTF_MODELS)}")

    @property
    def sentences(self) -> tuple[str, ...]:
        """What the adjustments do, in sentences for the provenance."""
        lines = []
        if self.strength < 1:
            lines.append(f"blended towards plain averages: strength {self.strength:g}")
        if self.keep_level0:
            lines.append("level 0 is the source's own: the pixel filter is not in it")
        if self.min_roughness:
            lines.append(f"no roughness is below {self.min_roughness:g}")
        return tuple(lines)


@dataclass(frozen=True)
class AdjustedRecipe(Adjustments, Recipe):
    """What `mipbake.bake` takes as options."""


def adjusted(stack: MipStack, texture_set: TextureSet, changes: Adjustments) -> MipStack:
    """A stack with adjustments, and without the promise that was measured before them.

    Args:
        stack: as it was baked from the set, for `gltf` or `gltf-anisotropic`.
        texture_set: the source.
        changes: what is to change.

    Raises:
        UsageError: the stack is of a model whose channels cannot be blended.
    """
    if changes == Adjustments():
        return stack
    changes.check(stack.model)
    levels = list(stack.levels)
    if changes.strength < 1:
        plain, _ = bake_stoppable(texture_set, Recipe("linear", stack.model, "box"))
        pairs = zip(plain.levels[: len(levels)], levels, strict=True)
        levels = [_blend(a, b, changes.strength, stack.model) for a, b in pairs]
    if changes.keep_level0:
        levels[0] = texture_set.material(stack.model)
        for layout in LAYOUTS[stack.model]:
            if layout.name in ("normal", "anisotropy") and layout.name in texture_set.maps:
                levels[0][..., layout.channels] = _as_stored(texture_set, layout.name)
        levels = led(levels, stack.model)
    if changes.min_roughness:
        roughness = channels_of(stack.model, "roughness")
        for index, level in enumerate(levels):
            raised = level.copy()
            raised[..., roughness] = np.maximum(level[..., roughness], np.float32(changes.min_roughness))
            levels[index] = raised
    provenance = replace(stack.provenance, promise=None, adjustments=changes.sentences)
    return replace(stack, levels=levels, provenance=provenance)


def _as_stored(texture_set: TextureSet, role: str) -> Level:
    """Vectors of level 0 as their file stores them, before they were made unit; unit where more than that was done."""
    unit, source = texture_set.maps[role].pixels, texture_set.maps[role].source
    if source.path is None:
        return unit
    stored = unit_range(taken(source, read_image(source.path, source.layer, source.metadata)))
    count = min(stored.shape[2], 3 if role == "normal" else 2)
    if stored.shape[:2] != unit.shape[:2] or count < 2:
        return unit
    vectors, again = unit.copy(), unit.copy()
    vectors[..., :count] = stored[..., :count] * np.float32(2) - np.float32(1)
    if role == "normal":
        if texture_set.convention.name == "directx":
            vectors[..., 1] *= -1
        turn_vectors(vectors, source.orientation)
        again = normalised(vectors)
        # What was not a normal has been filled from around it.
        filled = holes(again, np.linalg.norm(vectors, axis=-1))
        vectors[filled], again[filled] = unit[filled], unit[filled]
    else:
        turn_vectors(vectors, source.orientation)
        again[..., :2] = unit_directions(vectors[..., :2])
    return vectors if np.abs(again - unit).max() < _SAME else unit


def _blend(plain: Level, baked: Level, strength: float, model: str) -> Level:
    """A mixture of stored channels; vectors are unit again."""
    share = np.float32(strength)
    mixed = plain + (baked - plain) * share
    for layout in LAYOUTS[model]:
        if layout.name == "normal":
            mixed[..., layout.channels] = normalised(mixed[..., layout.channels])
        elif layout.name == "anisotropy":
            first = layout.channels.start
            mixed[..., first : first + 2] = _directions(
                plain[..., layout.channels], baked[..., layout.channels], strength
            )
    return np.ascontiguousarray(mixed, np.float32)


def _directions(plain: Level, baked: Level, strength: float) -> Level:
    """Directions (..., 2) between two anisotropies (..., 3): axes have no sign, so doubled angles are mixed, by the
    strength of the anisotropy.
    """

    def doubled(direction: Level) -> NDArray[np.float64]:
        x, y, s = np.moveaxis(direction.astype(np.float64), -1, 0)
        return np.asarray(np.stack([x * x - y * y, 2 * x * y], -1) * np.square(s)[..., None], np.float64)

    mixed = doubled(plain) * (1 - strength) + doubled(baked) * strength
    angle = np.arctan2(mixed[..., 1], mixed[..., 0]) / 2
    direction = np.stack([np.cos(angle), np.sin(angle)], -1)
    # An axis points where the baked one does, so that neighbours do not cancel each other when they are filtered.
    return np.asarray(direction * facing(direction, baked[..., :2])[..., None], np.float32)
