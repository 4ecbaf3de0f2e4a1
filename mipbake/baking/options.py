"""How sources are baked and written: the options, and what they mean for every source."""

from __future__ import annotations

from dataclasses import dataclass, replace

from mipbake.baking.adjust import Adjustments
from mipbake.baking.pipeline import AUTO_TARGET, Recipe
from mipbake.base.errors import UsageError
from mipbake.base.options import one_of, option
from mipbake.material import GLTF_MODELS
from mipbake.source.jobs import Job
from mipbake.source.options import NORMAL_CONVENTIONS
from mipbake.source.texture_set import source_model
from mipbake.stack.containers import DEFAULT_FORMAT, FORMATS
from mipbake.stack.costs import LIMIT
from mipbake.stack.output import BLOCK, GLB, GLB_TEXELS, Output, check_outputs
from mipbake.stack.packing import PACKINGS, SEPARATE, SOURCE
from mipbake.stack.presets import Preset, preset_named, wanted_outputs
from mipbake.stack.sidecars import FORMAT, SIDECARS, check_sidecar

_FILES, _LOOK = "Files", "Look"
_FORMATS = "; ".join(
    f"{name}: {next(iter(kinds.values())).summary} (texels {', '.join(kinds)})" for name, kinds in FORMATS.items()
)


@dataclass(frozen=True)
class BakeOptions(Recipe):
    """How sources are baked and written, the same for all, as `mipbake bake` takes it.

    Args:
        sidecar: files in PNG are written for it, each map in a file of its own, where no others are.
    """

    format: str | None = option(
        None,
        f"Files that are written: {', '.join((*FORMATS, GLB))}; with :TEXELS for how precise they are, as in "
        f"dds:rgba8.\n\n{_FORMATS}; {GLB}: the glTF source with KTX 2 textures in place of its own, or a square that "
        f"shows the material (texels {', '.join(GLB_TEXELS)}; with rgba8, textures are not compressed; the "
        "glTF standard does not allow these, but three.js and Babylon.js load them). The first texels named are the "
        f"default; files of ktx2 and dds whose sides are no multiples of {BLOCK} are rgba8. A warning says where files "
        f"cost more than {LIMIT:g} dB, and which texels cost less.",
        metavar="FORMAT[:TEXELS],...",
        otherwise=f"{GLB} for glTF sources, {DEFAULT_FORMAT} for others",
    )
    packing: str | None = option(
        None,
        "Which channels share a file: as in the source, none, or as engines expect it.",
        group=_FILES,
        metavar=one_of(PACKINGS),
        otherwise=SOURCE,
    )
    write_normals: str | None = option(
        None,
        "Whether green points up (opengl) or down (directx) in what is written.",
        group=_FILES,
        metavar=one_of((SOURCE, *NORMAL_CONVENTIONS)),
        otherwise=f"{SOURCE}: as in the set",
    )
    max_level: int | None = option(
        None,
        "The last level that is written; exr files hold all levels.",
        group=_FILES,
        metavar="LEVEL",
        otherwise="down to 1 x 1",
    )
    strength: float = option(
        1.0, "1 is the full bake, 0 plain MIP maps, and a number between them a mixture.", metavar="0..1"
    )
    keep_level0: bool = option(False, "Leave the full resolution as it came; only smaller levels change.")
    min_roughness: float = option(
        0.0, "The least perceptual roughness that a texel may have.", group=_LOOK, metavar="0..1"
    )
    sidecar: str | None = option(
        None,
        "A file beside the maps that another program takes: ntc lists PNG files of all levels for NVIDIA's neural "
        "texture compression.",
        group=_FILES,
        metavar=one_of(SIDECARS),
    )

    def plan(self) -> BakePlan:
        """What that means for every source. UsageError for what no source can be baked with."""
        options = self.resolved()
        target = options.target or AUTO_TARGET
        preset = preset_named(self.preset) if self.preset else None
        outputs, glb, texels = wanted_outputs(preset, self.format, self.packing, self.write_normals)
        # What was baked is found by its options, however they are spelt.
        format, packing, normals = map(_plainly, (self.format, self.packing, self.write_normals))
        options = replace(options, format=format, packing=packing, write_normals=normals)
        if self.sidecar is not None:
            options = replace(options, sidecar=check_sidecar(self.sidecar))
            if all(output.container.name != FORMAT for output in outputs):
                outputs = (*outputs, Output(FORMAT, SEPARATE))
        if self.max_level is not None and self.max_level < 0:
            raise UsageError(f"max_level is {self.max_level}: expected 0 or more")
        adjustments = Adjustments.of(self)
        for_gltf = target in (AUTO_TARGET, *GLTF_MODELS)
        # A glTF source becomes a GLB unless an option chooses what only files of maps can be.
        as_maps = self.sidecar or self.format or self.packing or self.write_normals or not for_gltf
        documents = not as_maps and (preset is None or preset.documents)
        check_outputs(outputs, source_model(anisotropic=False) if target == AUTO_TARGET else target)
        if not for_gltf and (glb or adjustments != Adjustments()):
            what = f"format {GLB}" if glb else "--keep-level0, --strength and --min-roughness"
            raise UsageError(f"the target {target} does not go with {what}: expected {' or '.join(GLTF_MODELS)}")
        return BakePlan(options, target, preset, outputs, glb, documents, adjustments, texels)


def _plainly(names: str | None) -> str | None:
    return None if names is None else ",".join(name.strip().lower() for name in names.split(","))


@dataclass(frozen=True)
class BakePlan:
    """What is to be baked and written, the same for every set.

    Args:
        options: what it comes from, with the target and the sampler that they mean. target, preset, outputs,
            adjustments: what they mean.
        glb: whether a GLB is written. documents: whether glTF sources become a GLB, and get no files of maps.
        glb_texels: of the textures of a GLB.
    """

    options: BakeOptions
    target: str
    preset: Preset | None
    outputs: tuple[Output, ...]
    glb: bool
    documents: bool
    adjustments: Adjustments
    glb_texels: str

    @property
    def level_count(self) -> int | None:
        """How many levels are written; None for all."""
        return None if self.options.max_level is None else self.options.max_level + 1

    def wants_glb(self, job: Job) -> bool:
        """Whether a GLB is written of a source."""
        return self.glb or (self.documents and job.document is not None)

    def writes_maps(self, job: Job) -> bool:
        """Whether files of maps are written of a source, not a document alone."""
        return bool(self.outputs) and not (self.documents and job.document is not None)
