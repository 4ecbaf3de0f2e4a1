"""Stacks into GLB files: KTX 2 textures with every level, in the document that a set came from or in a document of its
own."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from mipbake.base import json_text
from mipbake.base.errors import InputError, OutputError, UsageError
from mipbake.base.publish import check_place, replaced_file
from mipbake.base.threads import on_threads
from mipbake.base.version import __version__
from mipbake.material import GLTF_MODELS
from mipbake.source.decode import resized
from mipbake.source.gltf.container import unpacked
from mipbake.source.gltf.document import Document
from mipbake.source.gltf.materials import GltfBake
from mipbake.source.gltf.plain import SIDE, PlainTexture
from mipbake.source.gltf.slots import ANISOTROPIC, BASE, BASE_COLOUR, EMISSIVE, Lobe
from mipbake.source.images import ktx2
from mipbake.source.images.blocks import levels_of
from mipbake.source.options import CARRIED, SHADING_ROLES
from mipbake.source.texture_set import TextureSet
from mipbake.stack.gltf.glb_plain import PlainCost, averaged_files
from mipbake.stack.gltf.quad import standalone
from mipbake.stack.gltf.ranges import Ranges, ranges_of
from mipbake.stack.gltf.write import GltfResult, rewritten
from mipbake.stack.gpu_files import Ktx2File
from mipbake.stack.map_files import MapFile, given_back, quantised_levels
from mipbake.stack.output import GLB, GLB_TEXELS, Output, planned
from mipbake.stack.packing import Normals
from mipbake.stack.stack import Fingerprint, MipStack


@dataclass(frozen=True, eq=False)
class Encoded:
    """The textures of a stack for a glTF material.

    Args:
        maps: slot to a KTX 2 file.
        files: the same decoded, as they will be sampled, before factors of the material multiply them.
        left_out: which maps of the stack are in no texture, in sentences.
        ranges: those factors.
        texels: one of `GLB_TEXELS`.
        measured: what the files give back, as `mipbake.Check.glb` returns it; None where that was not measured.
    """

    maps: Mapping[str, bytes]
    files: tuple[MapFile, ...]
    left_out: tuple[str, ...]
    ranges: Ranges = field(default_factory=Ranges)
    texels: str = GLB_TEXELS[0]
    measured: Mapping[str, Any] | None = None


def encoded(
    stack: MipStack,
    slots: Sequence[str] | None = None,
    levels: int | None = None,
    progress: Callable[[float], None] = lambda _share: None,
    lobe: Lobe = BASE,
    ranges: Ranges | None = None,
    texels: str = GLB_TEXELS[0],
) -> Encoded:
    """The textures of a stack of `gltf` or `gltf-anisotropic`; UsageError for another model, or sides that are no
    multiples of `SIDE`.

    Args:
        slots: that may be filled; None for all. levels: how many of each texture; None for all.
        lobe: of the material, whose slots are filled.
        ranges: of the values in them; None for those of `ranges_of`. texels: one of `GLB_TEXELS`.
    """
    if stack.model not in GLTF_MODELS:
        raise UsageError(f"format {GLB} cannot hold the model {stack.model}: expected {' or '.join(GLTF_MODELS)}")
    if ranges is None:
        ranges = ranges_of(stack.levels, stack.model)

    container = Ktx2File(texels)

    def encode(file: MapFile) -> tuple[bytes, MapFile]:
        texture = container.texture(file.layout, quantised_levels(file), stack.about(), file.weights)
        data = ktx2.encoded(texture, supercompress=True)
        found = levels_of(texture, len(file.layout.channels))
        return data, replace(file, levels=given_back(container, file.layout, found))

    slot_named = {"base_color": BASE_COLOUR, "orm": lobe.roughness, "normal": lobe.normal}
    slot_named |= {"anisotropy": ANISOTROPIC, "emissive": EMISSIVE}
    wanted = {
        slot: ranges.stored(file)
        for file in planned(output(texels), stack, levels)
        if (slot := slot_named.get(file.layout.name)) is not None
        and (slots is None or slot in slots)
        and file.container.texels == texels
    }
    for file in wanted.values():
        height, width = file.levels[0].shape[:2]
        if width % SIDE or height % SIDE:
            raise UsageError(
                f"the map {file.layout.name} of {stack.name} is {width} x {height} texels: KHR_texture_basisu takes "
                f"multiples of {SIDE}, resample it first"
            )
    each = list(wanted.values())
    made = on_threads(lambda index: encode(each[index]), len(each), progress, os.cpu_count())
    progress(1.0)
    files = tuple(file for _, file in made)
    maps = {slot: data for slot, (data, _) in zip(wanted, made, strict=True)}
    return Encoded(maps, files, _left_out(stack, files), ranges, texels)


def _left_out(stack: MipStack, files: Sequence[MapFile]) -> tuple[str, ...]:
    """What is said of maps that no texture holds. Carried channels are named when they are read."""
    held = {channel.map for file in files for channel in file.layout.channels}
    reasons = {"emissive": "it has values above 1, which its textures of 8 bits do not hold"}
    return tuple(
        f"the map {role} is not in the GLB: {reasons.get(role, 'glTF has no texture for it')}; write it beside, with "
        f"--format {GLB},exr"
        for role in stack.extra
        if role not in held and not role.startswith(CARRIED)
    )


def output(texels: str = GLB_TEXELS[0]) -> Output:
    """How maps lie in the textures of a GLB."""
    return Output(f"{Ktx2File.name}:{texels}", "orm", Normals("opengl"))


def square(stack: MipStack, made: Encoded, cutoff: float | None) -> bytes:
    """A GLB of one square with the material of a stack. `cutoff`: what opacity is tested against; None: blended."""
    alpha: dict[str, Any] | None = None
    if "opacity" in stack.extra:
        alpha = {"alphaMode": "BLEND"} if cutoff is None else {"alphaMode": "MASK", "alphaCutoff": cutoff}
    about, occlusion = _about(stack, made), "occlusion" in stack.extra
    return standalone(stack.name, made.maps, about, stack.wrap, occlusion, alpha, made.ranges)


def _about(stack: MipStack, made: Encoded) -> dict[str, Any]:
    """How textures were made, and what they give back, for `asset.extras.mipbake`."""
    about: dict[str, Any] = json.loads(stack.about())
    return about if made.measured is None else {**about, "measured": made.measured}


def save_document(
    path: Path,
    document: Document,
    results: Sequence[tuple[GltfBake, MipStack, Encoded]],
    plain: Sequence[PlainTexture] = (),
    levels: int | None = None,
    recipe: Fingerprint | None = None,
) -> tuple[PlainCost, ...]:
    """Writes a GLB of a document with baked textures, over an earlier one of mipbake's alone, and says what blocks cost
    the averaged ones. OutputError where the file is somebody else's, or cannot be written.

    Args:
        plain: textures that are averaged, unless blocks cost them too much. levels: how many they get; None for all.
        recipe: hashes of what it is made from, which `made_from` gives back.
    """
    check_file(path, document.path)
    averaged = averaged_files(document, plain, levels)
    costs = tuple(cost for *_, cost in averaged)
    about = {
        "version": __version__,
        "materials": {bake.name: _about(stack, made) for bake, stack, made in results},
        **({"plain": [str(cost) for cost in costs]} if costs else {}),
        **({"recipe": dict(recipe)} if recipe else {}),
    }
    baked = [GltfResult(bake, made.maps, made.ranges) for bake, _, made in results]
    shown = [(texture, data) for texture, data, cost in averaged if not cost.stays]
    replaced_file(path, rewritten(document, baked, about, shown))
    return costs


def check_file(path: Path, *sources: Path) -> None:
    """OutputError where a GLB cannot be written to a path: its folder does not let it, it is a source, or a file that
    mipbake did not make. Where it is a link, all of that is about what it leads to, which is what is written."""
    if not path.exists():
        check_place(path, lambda _: False)
        return
    for source in sources:
        if source.exists() and path.samefile(source):
            raise OutputError(f"cannot write {path}: it is the source {source}, choose another output folder")
    if not path.is_file() or made_from(path) is None:
        raise OutputError(f"cannot write {path}: it was not made by mipbake, move it or choose another output folder")


def made_from(path: Path) -> Mapping[str, Any] | None:
    """What a GLB of a document says of how it was made; None for a file that mipbake did not make, or for none."""
    try:
        text, *_ = unpacked(path.read_bytes(), str(path))
        content: Any = json_text.parsed(text)
        about = content["asset"]["extras"]["mipbake"]
    except (InputError, OSError, ValueError, KeyError, TypeError):
        return None
    return about if isinstance(about, dict) else {}


def multiple_of_side(texture_set: TextureSet) -> TextureSet:
    """A texture set whose sides are multiples of `SIDE`, resampled upwards and noted where they were not.

    Emission, which does not share the texels, is enlarged by whole factors: every texel keeps its value.
    """
    width, height = (-(-side // SIDE) * SIDE for side in (texture_set.width, texture_set.height))
    maps = dict(texture_set.maps)
    for role, each in texture_set.maps.items():
        if role in SHADING_ROLES:
            maps[role] = resized(each, width, height, texture_set.wrap)
        elif role == "emissive":
            rows, columns = (SIDE // math.gcd(SIDE, side) for side in each.pixels.shape[:2])
            maps[role] = replace(each, pixels=each.pixels.repeat(rows, 0).repeat(columns, 1))
    if (width, height) == (texture_set.width, texture_set.height):
        return replace(texture_set, maps=maps)
    note = (
        f"resampled from {texture_set.width} x {texture_set.height} to {width} x {height}: textures of a GLB have "
        f"sides that are multiples of {SIDE}"
    )
    return replace(texture_set, maps=maps, width=width, height=height, notes=(*texture_set.notes, note))
