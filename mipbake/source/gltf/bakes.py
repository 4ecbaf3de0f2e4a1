"""One bake of a glTF document, whichever lobe of its materials it is for."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from mipbake.source.gltf.slots import BASE, Lobe, Slot
from mipbake.source.options import LoadOptions


@dataclass(frozen=True)
class GltfBake:
    """One bake of a document: a texture set, and the materials that it is for.

    Args:
        name: safe as a folder name, and no other bake's of the document.
        materials: indices of the materials that show these textures.
        options: how `mipbake.load` reads the set out of `files`. An `occlusion` map in it is the red channel of the
            metallicRoughness image, and has to be the red channel of the baked image as well.
        files: the images, each in its own file.
        slots: the slots that baked maps may fill. baseColorTexture is not among them where the base colour has no
            texture, or one that lies elsewhere on the surface: it is not prefiltered.
        notes: what was found, in sentences.
        warnings: what the user should look at, in sentences.
        lobe: whose normals and roughness these are: the material itself, or its clearcoat.
    """

    name: str
    materials: tuple[int, ...]
    options: LoadOptions
    files: tuple[Path, ...]
    slots: tuple[str, ...]
    notes: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()
    lobe: Lobe = BASE


class SkippedError(Exception):
    """A material is left as it is; the sentence says why, `loud` whether the user should look at it."""

    def __init__(self, sentence: str, loud: bool = False) -> None:
        super().__init__(sentence)
        self.loud = loud


def add_factor(factors: dict[str, float], role: str, value: float) -> None:
    """Sets the factor of a role, unless it changes nothing."""
    if not math.isclose(value, 1.0, abs_tol=1e-9):
        factors[role] = value


def check_shared(where: str, main: Slot, others: Sequence[Slot]) -> None:
    """SkippedError where textures do not lie at the same place of the surface."""
    for slot in others:
        if slot.mapping != main.mapping:
            raise SkippedError(
                f"{where}: its {slot.name} and its {main.name} lie on different texture coordinates or have "
                "different transforms, so that they share no texels to be filtered together; they are left as they are",
                loud=True,
            )


def sampler_warnings(name: str, slots: Sequence[Slot], main: Slot) -> list[str]:
    """What samplers do that a stack is not made for."""
    found = []
    bare = [s.name for s in slots if s.without_levels]
    if bare:
        found.append(
            f"{name}: the samplers of {', '.join(bare)} show level 0 alone (minFilter NEAREST or LINEAR), so that the "
            "other levels will not be seen: set LINEAR_MIPMAP_LINEAR"
        )
    other = [s.name for s in slots if s.wrap != main.wrap]
    if other:
        found.append(
            f"{name}: {', '.join(other)} repeat in another way at the borders than {main.name}: all are "
            f"filtered as {main.name} repeats"
        )
    mirrored = [s.name for s in slots if s.mirrored]
    if mirrored:
        found.append(f"{name}: {', '.join(mirrored)} are mirrored at the borders, and are filtered as if clamped")
    return found


def animation_warning(name: str, member: str, value: float) -> str:
    """What is said where an animation sets what is baked in."""
    return (
        f"{name}: an animation sets {member}, which is baked in as {value:g}, its value at rest: what the animation "
        "sets comes on top of that, so look at it in the result"
    )
