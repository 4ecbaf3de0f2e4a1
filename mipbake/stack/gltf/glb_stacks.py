"""What the textures of a baked GLB hold, read back as stacks: level by level, as an engine samples them."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mipbake.base.errors import InputError, UsageError
from mipbake.base.srgb import srgb_to_linear
from mipbake.material.aim import sampler_from
from mipbake.material.pixel_filter import filter_named
from mipbake.source.gltf import slots as gltf
from mipbake.source.gltf.document import Document, Json, member, number, read_document
from mipbake.source.gltf.images import KTX2, stored_image
from mipbake.source.images import ktx2
from mipbake.source.images.blocks import from_blocks
from mipbake.source.images.quantise import dequantised
from mipbake.source.jobs import Job
from mipbake.source.texture_set import TextureSet, source_model
from mipbake.stack.stack import MipStack, Provenance

Levels = list[NDArray[np.float32]]


def stack_in_glb(path: Path, job: Job, texture_set: TextureSet) -> MipStack:
    """The stack of a texture set that a GLB which was baked from its source really holds. InputError where the GLB is
    broken, was not made by mipbake, or was made of another source.

    Textures are decoded level by level, and factors of the material are applied: what comes is what an engine samples
    and shades with. The square of a texture set that came from no glTF is read too.

    Args:
        texture_set: of the job, with sides as `mipbake.stack.gltf.glb.multiple_of_side` makes them.
    """
    made = read_document(path)
    about = made.about
    if about is None:
        raise InputError(f"{path} was not made by mipbake: expected the GLB that `mipbake bake` wrote")
    if job.bake is None or job.document is None:
        if "materials" in about:
            raise InputError(f"{path} was baked from a glTF file: expected that as its source, not {job.source}")
        return _Reader(made, 0, gltf.BASE, None, {}).stack(texture_set, about)
    index = job.bake.materials[0]
    if job.bake.name not in about.get("materials", {}) or index >= len(made.all("materials")):
        raise InputError(
            f"{path} holds nothing that was baked for {job.bake.name} of {job.source}: expected what `mipbake bake` "
            "made of it"
        )
    reader = _Reader(made, index, job.bake.lobe, job.bake.slots, job.document.all("materials")[index])
    return reader.stack(texture_set, about["materials"][job.bake.name])


@dataclass(frozen=True, eq=False)
class _Reader:
    """Reads a lobe of a material.

    Args:
        made: the baked document. index: of the material in it.
        slots: those that were baked; None for all.
        before: the material in the source, whose tint is in no texture set.
    """

    made: Document
    index: int
    lobe: gltf.Lobe
    slots: tuple[str, ...] | None
    before: Json

    @property
    def material(self) -> Json:
        return self.made.one("materials", self.index, "the source")

    @property
    def where(self) -> str:
        return gltf.label_of(self.index, self.material)

    def stack(self, texture_set: TextureSet, about: Json) -> MipStack:
        """The stack; what no texture holds is as in the texture set."""
        normal, packed = self.levels(self.lobe.normal), self.levels(self.lobe.roughness)
        base = self.levels(gltf.BASE_COLOUR) if self.lobe is gltf.BASE else None
        directions = self.levels(gltf.ANISOTROPIC) if self.lobe is gltf.BASE and texture_set.anisotropic else None
        chains = [chain for chain in (base, packed, normal, directions) if chain is not None]
        if not chains:
            raise InputError(f"{self.made.path}: {self.where} has no texture with levels: expected a baked one")
        sizes = [level.shape[:2] for level in max(chains, key=lambda chain: chain[0].size)]
        count = min(map(len, chains))
        if any([level.shape[:2] for level in chain[:count]] != sizes[:count] for chain in chains):
            raise InputError(
                f"{self.made.path}: the textures of {self.where} have different sizes: expected what `mipbake bake` "
                "wrote"
            )
        holder = gltf.holder_of(self.material, self.lobe.roughness, self.where, self.made)
        factors = [self.number(holder, name, default) for name, default in self.lobe.factors]
        roughness, metallic = (*factors, 0.0)[:2]  # a clearcoat has no metallic
        mean = texture_set.maps["base_color"].pixels.mean((0, 1), np.float64).astype(np.float32)
        levels = []
        for at, size in enumerate(sizes[:count]):
            alone = np.ones((*size, 3), np.float32)
            parts = [
                np.broadcast_to(mean, (*size, len(mean))) if base is None else base[at] * self.tint(),
                (alone if packed is None else packed[at])[..., 2:3] * np.float32(metallic),
                (alone if packed is None else packed[at])[..., 1:2] * np.float32(roughness),
                self.normals(normal[at]) if normal is not None else alone * np.array([0, 0, 1], np.float32),
            ]
            if directions is not None:
                parts.append(self.directions(directions[at]))
            levels.append(np.ascontiguousarray(np.concatenate(parts, -1), np.float32))
        model = source_model(directions is not None)
        return MipStack(texture_set.name, model, levels, {}, texture_set.wrap, self.provenance(about))

    def levels(self, slot: str) -> Levels | None:
        """(H_L, W_L, 3) in [0, 1], colours linear; None where there is no texture, or one that was not baked."""
        known = gltf.info_of(self.material, slot) is not None and (self.slots is None or slot in self.slots)
        found = gltf.slot_of(self.made, self.material, slot, self.where) if known else None
        if found is None:
            return None
        data, kind = stored_image(self.made, found.image, f"{slot} of {self.where}")
        what = f"{slot} of {self.where} of {self.made.path}"
        if kind is not KTX2:
            raise InputError(f"{what} is not a KTX 2 texture: expected levels that `mipbake bake` wrote")
        texture = ktx2.decoded(data, what)
        if texture.format.srgb != (gltf.PLACES[slot].holds == gltf.COLOUR) or texture.format.channels < 3:
            raise InputError(f"{what} is {texture.format.name}: expected what `mipbake bake` wrote")
        texels = (np.asarray(dequantised(level[..., :3]), np.float32) for level in from_blocks(texture))
        return [np.asarray(srgb_to_linear(each) if texture.format.srgb else each, np.float32) for each in texels]

    def number(self, holder: Json, name: str, default: float, most: float = 1e6) -> float:
        return number(holder.get(name, default), f"{name} of {self.where}", self.made.path, -most, most)

    def tint(self) -> NDArray[np.float32]:
        """(3,) factor of the base colour, relative to the factor of the source."""
        found = [
            np.array(each.get("pbrMetallicRoughness", {}).get("baseColorFactor", [1, 1, 1, 1])[:3], np.float32)
            for each in (self.material, self.before)
        ]
        return np.where(found[1] > 0, found[0] / np.maximum(found[1], 1e-6), np.float32(1)).astype(np.float32)

    def normals(self, level: NDArray[np.float32]) -> NDArray[np.float32]:
        scale = self.number(gltf.info_of(self.material, self.lobe.normal) or {}, "scale", 1.0)
        return np.asarray((level * 2 - 1) * np.array([scale, scale, 1], np.float32))

    def directions(self, level: NDArray[np.float32]) -> NDArray[np.float32]:
        """Direction and strength, turned and scaled as KHR_materials_anisotropy says."""
        extensions = member(self.material, "extensions", self.where, self.made.path)
        held = member(extensions, gltf.ANISOTROPY, self.where, self.made.path)
        angle = self.number(held, "anisotropyRotation", 0.0)
        c, s = math.cos(angle), math.sin(angle)
        x, y = (level[..., i : i + 1] * 2 - 1 for i in (0, 1))
        strength = level[..., 2:3] * self.number(held, "anisotropyStrength", 0.0)
        return np.concatenate([c * x - s * y, s * x + c * y, strength], -1)

    def provenance(self, about: Json) -> Provenance:
        try:
            filter_named(about["pixel_filter"])
            return Provenance(
                method=str(about["method"]),
                pixel_filter=str(about["pixel_filter"]),
                weights=about.get("weights"),
                sampler=None if about.get("sampler") is None else sampler_from(about["sampler"]),
                aim=about.get("aim"),
                tool_version=str(about.get("version", "")),
                source_hash=str(about.get("source_hash", "")),
            )
        except (KeyError, TypeError, ValueError, UsageError) as error:
            raise InputError(
                f"{self.made.path} does not say how its textures were made ({error}): bake it again"
            ) from error
