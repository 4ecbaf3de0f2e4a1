"""How sources are baked and written: what a user asks for, and what that means for every source."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

from mipbake.baking.adjust import Adjustments
from mipbake.baking.bake import AUTO_TARGET, DEFAULT_FILTER, DEFAULT_METHOD, TARGETS
from mipbake.baking.methods import OPTIONS, method_named
from mipbake.base.errors import UsageError
from mipbake.material import GLTF_MODELS
from mipbake.material.aim import Sampler, sampler_of
from mipbake.material.pixel_filter import filter_named
from mipbake.source.images.uastc import check_encoder
from mipbake.source.jobs import Failure, Job
from mipbake.source.texture_set import source_model
from mipbake.stack.output import GLB, GLB_TEXELS, Output, check_outputs
from mipbake.stack.packing import SEPARATE
from mipbake.stack.presets import Preset, preset_named, wanted_outputs
from mipbake.stack.sidecars import FORMAT, check_sidecar


@dataclass(frozen=True)
class BakeOptions:
    """How sources are baked and written, the same for all, as `mipbake bake` takes it.

    Args:
        method, pixel_filter, weights, budget, aim, device: as `mipbake.bake` takes them.
        target: a material model, or "auto"; None: what the preset chooses, else "auto".
        sampler: as `mipbake.bake` takes it; None: what the preset chooses, for methods that take one.
        lod_bias: MIP bias of the sampler; None: what the sampler has.
        preset: a name in `mipbake.stack.presets.PRESETS`: an engine, which chooses what is None here.
        format: formats separated by commas, each with texels where they are not the default: "exr,ktx2:uastc,glb".
            None: a GLB for glTF sources, "exr" for others. `ktx2` and `dds` without texels get the smallest that cost
            little.
        packing: a name in `mipbake.stack.packing.PACKINGS`. write_normals: "source", "opengl" or "directx".
        max_level: the last level that is written; None for all.
        keep_level0, strength, min_roughness: see `mipbake.baking.adjust.Adjustments`.
        sidecar: a name in `mipbake.stack.sidecars.SIDECARS`: a list of PNG files for another program. They are written,
            each map in a file of its own, where no others are.
    """

    method: str = DEFAULT_METHOD
    target: str | None = None
    pixel_filter: str = DEFAULT_FILTER
    preset: str | None = None
    format: str | None = None
    packing: str | None = None
    write_normals: str | None = None
    max_level: int | None = None
    keep_level0: bool = False
    strength: float = 1.0
    min_roughness: float = 0.0
    weights: str | None = None
    budget: str | None = None
    sampler: Sampler | str | None = None
    lod_bias: float | None = None
    aim: float | None = None
    device: str | None = None
    sidecar: str | None = None

    def asked(self) -> Asked:
        """What that means for every source. UsageError for what no source can be baked with."""
        preset = preset_named(self.preset) if self.preset else None
        sampler = sampler_of(self.sampler)
        # Methods that take none are not asked for what nobody asked for.
        if sampler is None and preset and (self.method in OPTIONS["sampler"] or self.lod_bias is not None):
            sampler = preset.sampler
        sampler = sampler_of(sampler, self.lod_bias)
        method_named(self.method, self.weights, self.budget, sampler, self.aim, self.device)
        filter_named(self.pixel_filter)
        target = self.target
        if target is None:
            target = preset.target if preset else AUTO_TARGET
        if target not in TARGETS:
            raise UsageError(f"unknown target {target!r}: expected one of {', '.join(TARGETS)}")
        outputs, glb, finer = wanted_outputs(preset, self.format, self.packing, self.write_normals)
        if self.sidecar is not None:
            check_sidecar(self.sidecar)
            if all(output.container.name != FORMAT for output in outputs):
                outputs = (*outputs, Output(FORMAT, SEPARATE))
        if self.max_level is not None and self.max_level < 0:
            raise UsageError(f"max_level is {self.max_level}: expected 0 or more")
        adjustments = Adjustments(self.keep_level0, self.strength, self.min_roughness)
        for_gltf = target in (AUTO_TARGET, *GLTF_MODELS)
        # A glTF source becomes a GLB unless something is asked for that only files of maps can be.
        as_maps = self.sidecar or self.format or self.packing or self.write_normals or not for_gltf
        documents = not as_maps and (preset is None or preset.documents)
        check_outputs(outputs, source_model(anisotropic=False) if target == AUTO_TARGET else target)
        if not for_gltf and (glb or adjustments.any):
            what = f"format {GLB}" if glb else "--keep-level0, --strength and --min-roughness"
            raise UsageError(f"the target {target} does not go with {what}: expected {' or '.join(GLTF_MODELS)}")
        if glb or any(output.container.texels == GLB_TEXELS[0] for output in outputs):
            check_encoder()
        return Asked(
            replace(self, target=target, sampler=sampler, lod_bias=None),
            target,
            preset,
            outputs,
            glb,
            documents,
            adjustments,
            finer,
        )


@dataclass(frozen=True)
class Asked:
    """What is to be baked and written, the same for every set.

    Args:
        options: what it comes from, with the target and the sampler that they mean. target, preset, outputs,
            adjustments: what they mean.
        glb: whether a GLB is written. documents: whether glTF sources become a GLB, and get no files of maps.
        finer: texels that the textures of a GLB may have in place of blocks.
    """

    options: BakeOptions
    target: str
    preset: Preset | None
    outputs: tuple[Output, ...]
    glb: bool
    documents: bool
    adjustments: Adjustments
    finer: tuple[str, ...]

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

    def check_encoder(self, found: Iterable[Job | Failure]) -> None:
        """UsageError where a source becomes a GLB and the encoder of its textures is not installed."""
        if any(isinstance(job, Job) and self.wants_glb(job) for job in found):
            check_encoder()
