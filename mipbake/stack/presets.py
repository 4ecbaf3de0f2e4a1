"""What engines load: a preset chooses target, sampler, containers, texels, packing, normals and names. Why stands in
docs/engines."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

from mipbake.base.errors import UsageError
from mipbake.base.names import known_name
from mipbake.material.aim import ANISOTROPIC, DEFAULT_SAMPLER, Sampler
from mipbake.source.options import NORMAL_CONVENTIONS
from mipbake.stack.containers import DEFAULT_FORMAT, FORMATS, format_named
from mipbake.stack.output import GLB, GLB_TEXELS, Output
from mipbake.stack.packing import PACKINGS, SEPARATE, SOURCE, Normals

OPENGL = Normals("opengl")
OPENGL_XY = Normals("opengl", 2)
DIRECTX = Normals("directx")

_GLTF_NAMES = {"base_color": "baseColor", "orm": "occlusionRoughnessMetallic"}
_UNREAL_NAMES = {"base_color": "BC", "normal": "N", "orm": "ORM", "emissive": "E", "height": "H"}
_UNITY_NAMES = {
    "base_color": "BaseMap",
    "normal": "Normal",
    "mask_map": "MaskMap",
    "emissive": "Emission",
    "height": "Height",
}
_GODOT_NAMES = {"base_color": "albedo", "emissive": "emission"}
_SET_FILE = "{set}_{file}"


@dataclass(frozen=True)
class Preset:
    """What an engine loads.

    Args:
        engine: in words. outputs: files that are written.
        anisotropic: whether its standard material reads `gltf-anisotropic`; sets with an anisotropy map are baked for
            `gltf` where it does not.
        documents: whether glTF sources become a GLB, and get no files of maps.
        sides: what the sides of a texture must be: "", "multiples of 4" or "powers of two".
        notes: what the user should do or know, in sentences.
        no_finer: why texels that are more precise than its outputs have are not advised; "": the engine takes some.
        sampler: that the engine looks textures up with unless it is told otherwise; its page in docs/engines says where
            that comes from.
    """

    name: str
    engine: str
    outputs: tuple[Output, ...]
    anisotropic: bool = False
    documents: bool = False
    sides: str = ""
    notes: tuple[str, ...] = field(default=())
    no_finer: str = ""
    sampler: Sampler = DEFAULT_SAMPLER

    @property
    def target(self) -> str:
        """The target that the preset chooses, a name in `mipbake.baking.pipeline.TARGETS`."""
        return "auto" if self.anisotropic else "gltf"

    def check(self, width: int, height: int, blocks: bool = True) -> list[str]:
        """What is wrong with a size, in sentences. `blocks`: whether any texels are; others need no multiples of 4."""
        sides = (width, height)
        fine = {
            "": True,
            "multiples of 4": not blocks or all(side % 4 == 0 for side in sides),
            "powers of two": all(side & (side - 1) == 0 for side in sides),
        }[self.sides]
        if fine:
            return []
        return [f"{self.engine} needs sides that are {self.sides}, this set is {width} x {height}: resize its maps"]

    def check_sampler(self, made_for: Sampler | None) -> list[str]:
        """What is wrong with the sampler that a stack was made for, in sentences; None, for no one sampler, is fine."""
        if made_for in (None, self.sampler):
            return []
        return [
            f"{self.engine} looks textures up with the sampler {self.sampler}, this stack was made for {made_for}: "
            f'bake it with sampler="{self.sampler}", unless your engine is set up otherwise'
        ]


_ALL = (
    Preset(
        "three",
        "three.js",
        (Output("ktx2:uastc", "orm", OPENGL, _SET_FILE, _GLTF_NAMES),),
        anisotropic=True,
        documents=True,
        sides="multiples of 4",
        notes=("load with KTX2Loader and leave minFilter at LinearMipmapLinearFilter",),
    ),
    Preset(
        "babylon",
        "Babylon.js",
        (Output("ktx2:uastc", "orm", OPENGL, _SET_FILE, _GLTF_NAMES),),
        anisotropic=True,
        documents=True,
        sides="multiples of 4",
        notes=("switch enableSpecularAntiAliasing off: its glTF loader switches it on",),
        no_finer="Babylon.js before August 2026 takes no other texels",
        sampler=Sampler(lookups=4),
    ),
    Preset(
        "filament",
        "Filament",
        (Output("ktx2:uastc", "orm", OPENGL, _SET_FILE, _GLTF_NAMES),),
        documents=True,
        sides="multiples of 4",
        notes=("gltfio needs nothing; set specularAntiAliasing to false in materials of your own",),
        no_finer="Filament takes no other texels",
    ),
    Preset(
        "unreal",
        "Unreal Engine",
        (Output("dds:rgba8", "orm", DIRECTX, "T_" + _SET_FILE, _UNREAL_NAMES),),
        sides="powers of two",
        notes=("keep Mip Gen Settings at Leave Existing Mips and Composite Texture Mode off",),
        no_finer="Unreal Engine is not known to take other texels",
        sampler=replace(ANISOTROPIC, bias=-0.3, frames=8),
    ),
    Preset(
        "unity",
        "Unity",
        (Output("dds:bc", "mask-map", OPENGL_XY, _SET_FILE, _UNITY_NAMES),),
        sides="multiples of 4",
        notes=("set the filter mode to Trilinear; leave Geometric Specular AA off",),
        no_finer="Unity is not known to take other texels",
        sampler=ANISOTROPIC,
    ),
    Preset(
        "godot",
        "Godot",
        (Output("dds:bc", "orm", OPENGL_XY, _SET_FILE, _GODOT_NAMES),),
        sides="powers of two",
        notes=("switch the screen-space roughness limiter off: it counts bumps twice",),
    ),
    Preset(
        "bevy",
        "Bevy",
        (Output("ktx2:bc", "orm", OPENGL_XY, _SET_FILE, _GLTF_NAMES),),
        sides="multiples of 4",
        notes=("set metallic and perceptual_roughness to 1, and the address modes of the sampler to Repeat",),
    ),
    Preset(
        "arnold",
        "Arnold",
        (Output("tx:half", SEPARATE, OPENGL, _SET_FILE),),
        notes=("switch auto-tx off; colours are linear Rec.709, convert them first where the scene is ACEScg",),
        sampler=ANISOTROPIC,
    ),
    Preset(
        "renderman",
        "RenderMan",
        (Output("exr:half", SEPARATE, OPENGL, _SET_FILE), Output("png:16", SEPARATE, OPENGL, _SET_FILE)),
        notes=("levels that txmake takes lie beside the EXR files as PNG files",),
        sampler=ANISOTROPIC,
    ),
    Preset(
        "blender",
        "Blender (Cycles)",
        (Output("exr:half", SEPARATE, OPENGL, _SET_FILE),),
        notes=("switch the texture cache on (5.2 and newer); older versions and EEVEE show level 0 alone",),
        sampler=ANISOTROPIC,
    ),
)

PRESETS: Mapping[str, Preset] = {preset.name: preset for preset in _ALL}
"""Preset by name."""


def preset_named(name: str) -> Preset:
    """The preset of that name; UsageError with the list when there is none."""
    return PRESETS[known_name("preset", name, PRESETS)]


def wanted_outputs(
    preset: Preset | None = None,
    format: str | None = None,
    packing: str | None = None,
    write_normals: str | None = None,
) -> tuple[tuple[Output, ...], bool, str]:
    """The outputs of a preset with what the user wants otherwise, or the outputs for formats; whether a GLB is wanted;
    and the texels of its textures. UsageError where a name is unknown, or the choices contradict each other.

    Args:
        format: formats by name, separated by commas, each with texels where they are not the default; `GLB` is one.
        packing: a name in `mipbake.stack.packing.PACKINGS`. write_normals: "source", "opengl" or "directx".
    """
    if packing is not None:
        packing = known_name("packing", packing, PACKINGS)
    if write_normals is not None:
        write_normals = known_name("normal convention", write_normals, (SOURCE, *NORMAL_CONVENTIONS))
    outputs = preset.outputs if preset else ()
    names = [name.strip().lower() for name in (DEFAULT_FORMAT if format is None else format).split(",")]
    if not all(names):
        raise UsageError(f"the formats {format!r} have an empty place: expected names separated by commas")
    kinds = [name.partition(":")[0] for name in names]
    for kind in kinds:
        known_name("format", kind, (*FORMATS, GLB))
        if kinds.count(kind) > 1:
            raise UsageError(f"format {kind} is asked for twice: its files would have the same names")
    others = [name for name, kind in zip(names, kinds, strict=True) if kind != GLB]
    for name in others:
        format_named(name)
    glb = GLB in kinds
    _, named, texels = names[kinds.index(GLB)].partition(":") if glb else ("", "", "")
    if named:
        known_name("format", f"{GLB}:{texels}", [f"{GLB}:{each}" for each in GLB_TEXELS])
    if not others and (packing or write_normals):
        raise UsageError(f"format {GLB} has a packing and normals of its own: leave --packing and --write-normals out")
    if format is not None or not outputs:
        model = outputs[0] if outputs else Output()
        outputs = tuple(replace(model, format=name) for name in others)
    if packing is not None:
        outputs = tuple(replace(each, packing=packing) for each in outputs)
    if write_normals is not None:
        outputs = tuple(replace(each, normals=replace(each.normals, convention=write_normals)) for each in outputs)
    return outputs, glb, texels or GLB_TEXELS[0]
