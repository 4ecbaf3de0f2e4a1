"""One texture set, or tiles that touch: read, baked, written and measured."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from pathlib import Path
from typing import Literal, TypeAlias

from mipbake.baking.adjust import adjusted
from mipbake.baking.methods import METHODS, LongRun, discard, size_of
from mipbake.baking.options import BakePlan
from mipbake.baking.pipeline import STOPPED, bake_stoppable
from mipbake.baking.recipe import Ingredients, stopped
from mipbake.baking.results import BakedSet, Listener, WrittenFile
from mipbake.base import memory
from mipbake.base.publish import IsOurs
from mipbake.base.timings import Timings
from mipbake.material import MODELS
from mipbake.source.gltf.slots import BASE
from mipbake.source.jobs import Job
from mipbake.source.sources import Found
from mipbake.source.texture_set import TextureSet
from mipbake.source.tiles import FIRST
from mipbake.source.udim import Mosaic
from mipbake.stack.checking import Check
from mipbake.stack.costs import Cost
from mipbake.stack.gltf.glb import Encoded, encoded, multiple_of_side
from mipbake.stack.manifest import check_output, is_replaceable, is_stack_folder
from mipbake.stack.output import block_warnings, check_outputs
from mipbake.stack.presets import Preset
from mipbake.stack.sidecars import FORMAT, sidecar_named
from mipbake.stack.split_tiles import stacks_of
from mipbake.stack.stack import Fingerprint, MipStack

_OWN_MEMORY = 160 << 20
"""Bytes that a bake takes whatever the size of the set. Measured, and a guess for other machines."""

_COLUMN_MEMORY = 24 << 10
"""Bytes for each texel of a row: bands of rows that are read, filtered, decoded and written. Measured as the above."""


@dataclass(frozen=True, eq=False)
class BakedMaterial:
    """A material of a document that was baked, with its textures."""

    job: Job
    stack: MipStack
    textures: Encoded


SEARCH = ".search"
"""What the name of a folder ends with that a search is kept in, beside its result."""

Which: TypeAlias = Literal["all", "changed", "none"]


@dataclass(frozen=True, eq=False)
class Run:
    """One run over all sources.

    Args:
        plan: what is to be made of them.
        listener: who hears of it.
        which: "all" bakes what is found; "changed" leaves out what is already what it would be baked to; "none" bakes
            nothing, and says what "changed" would bake.
        known: whether earlier results that lie where results go are known to be of the same sources. Else a stack none
            of whose source files is among the new ones is not replaced.
        by_name: whether files of the same names are enough for that, whatever is in them.
        keeps: whether searches are kept beside their results, so that they can go on where they were interrupted.
        documents: document to its materials that have been baked so far, which its GLB is written of in the end.
    """

    plan: BakePlan
    listener: Listener
    which: Which = "all"
    known: bool = False
    by_name: bool = False
    keeps: bool = False
    documents: dict[Path, list[BakedMaterial]] = field(default_factory=dict)

    @cached_property
    def ingredients(self) -> Ingredients:
        """What all results are made from, besides their sources."""
        return Ingredients.of(self.plan)

    @property
    def ours(self) -> IsOurs:
        """Whether what lies where a result goes may be replaced."""
        return is_replaceable if self.known else is_stack_folder

    def check_output(self, place: Path, sources: Mapping[str, str]) -> None:
        """OutputError where results cannot be written to a folder: see `mipbake.stack.manifest.check_output`."""
        check_output(place, None if self.known else dict.fromkeys(sources, "") if self.by_name else sources)


def bake_job(run: Run, job: Job, place: Path, out: Path) -> list[BakedSet]:
    """Bakes a set, or tiles that touch, and writes every stack into a folder in `place`; `out`: of all results."""
    plan, listener = run.plan, run.listener
    sources = job.found()
    for found in [] if job.tiled else sources.values():
        run.check_output(place / found.name, found.hashes)
    _check_memory(plan.options.method, sources)
    with listener.timings(job.source.name) as reading:
        reading("read", 0.0)
        reads = job.read(multiple_of_side) if plan.wants_glb(job) else job.read()
        reading("read", 1.0)
    sets = [each for read in reads for each in read.sets.values()]
    for texture_set in sets:
        run.check_output(place / texture_set.name, texture_set.found.hashes)
    listener.read(job, sets)
    recipe = run.ingredients.recipe(job, sources, sets)
    return [baked for read in reads for baked in _bake(run, job, read, recipe, reading, place, out)]


def _bake(
    run: Run, job: Job, read: Mosaic, recipe: Fingerprint, reading: Timings, place: Path, out: Path
) -> list[BakedSet]:
    """Bakes what is baked at once, and writes its stacks."""
    plan, listener = run.plan, run.listener
    whole = read.texture_set
    model = plan.options.model(whole)
    check_outputs(plan.outputs, model)
    if whole.anisotropic and not MODELS[model].anisotropic:
        listener.note(f"the target {model} has no anisotropy: the anisotropy map goes into the roughness alone")
    with listener.timings(whole.name) as baking:
        baking.seconds.update(reading.seconds)
        checkpoint = checkpoint_of(job, read, out) if run.keeps else None
        long_run = LongRun(checkpoint, listener.descending, listener.note)
        baked, was_stopped = bake_stoppable(whole, plan.options, baking, long_run)
        baked = adjusted(baked, whole, plan.adjustments)
        recipe = stopped(recipe) if was_stopped else recipe
        baked = replace(baked, provenance=replace(baked.provenance, recipe=recipe))
        notes = [_left_over(checkpoint)] if was_stopped else []
        made = [
            _write(run, job, texture_set, stack, place / texture_set.name, baking, notes)
            for texture_set, stack in stacks_of(read, baked)
        ]
    if checkpoint is not None and not was_stopped:
        discard(checkpoint)
    return made


def checkpoint_of(job: Job, read: Mosaic, out: Path) -> Path:
    """The folder that a search of a job is kept in, beside its result."""
    return out / f".{'.'.join(filter(None, (job.place, job.names[next(iter(read.sets))])))}{SEARCH}"


def _left_over(checkpoint: Path | None) -> str:
    """A sentence for a search that was stopped: what is left to do, and how."""
    size = size_of(checkpoint) if checkpoint is not None else 0
    if not size:
        return f"{STOPPED}: the result is the best so far, and another bake begins anew"
    return (
        f"{STOPPED}: the result is the best so far, and the same command goes on from {checkpoint} "
        f"({memory.told(size)})"
    )


def _check_memory(method: str, sources: Mapping[int, Found]) -> None:
    """UsageError where the limit of memory does not let a method bake sets of these sizes, by tile."""
    across = len({(tile - FIRST) % 10 for tile in sources})
    width, height = (max(getattr(found, side) for found in sources.values()) for side in ("width", "height"))
    needed = _OWN_MEMORY + _COLUMN_MEMORY * width * across + METHODS[method].own_memory
    memory.check(needed, f"a bake of {width} x {height} texels by {method}")


def _write(
    run: Run,
    job: Job,
    texture_set: TextureSet,
    stack: MipStack,
    place: Path,
    baking: Timings,
    notes: Sequence[str],
) -> BakedSet:
    """Writes the stack of one set, and measures what was written; `notes`: what else a user should know."""
    plan = run.plan
    outputs = plan.outputs if plan.writes_maps(job) else ()
    with_glb = plan.wants_glb(job)
    check = Check(texture_set, stack, partial(baking, "check"), len(outputs) + with_glb)
    textures = _textures(job, stack, plan, partial(baking, "encode")) if with_glb else None
    if textures is not None and job.document is not None:
        textures = replace(textures, measured=check.glb(textures))
        run.documents.setdefault(job.source, []).append(BakedMaterial(job, stack, textures))
    beside = textures if job.document is None else None
    files: list[Path] = []
    if outputs or beside:
        known = run.known or run.by_name  # which has been checked before
        files = stack.save(
            place,
            outputs,
            partial(baking, "write"),
            plan.level_count,
            beside,
            measured=check,
            known=known,
            sidecar=plan.options.sidecar,
        )
    costs, left_out = check.costs, () if outputs or textures is None else textures.left_out
    if files and plan.options.sidecar is not None:
        listed = next(output for output in outputs if output.container.name == FORMAT)
        listing = stack.files(listed, plan.level_count)
        left_out = sidecar_named(plan.options.sidecar, listing, stack.tile).left_out
    blocks = any(not each.container.exact for each in plan.outputs)
    engine = block_warnings(outputs, stack, names_texels=plan.preset is None)  # of which a preset speaks itself
    if plan.preset:
        engine += plan.preset.check(texture_set.width, texture_set.height, blocks)
        engine += plan.preset.check_sampler(stack.provenance.sampler)
    result = BakedSet(
        source=job.source,
        out=place,
        files=tuple(WrittenFile(file, file.stat().st_size) for file in files),
        costs=tuple(costs),
        defects=tuple(check.defects),
        warnings=(
            *job.warnings,
            *notes,
            *engine,
            *left_out,
            *(line for each in costs for line in each.warnings(_chose(plan.preset, each))),
        ),
        model=stack.model,
        levels=len(stack.levels[: plan.level_count]),
        provenance=stack.provenance,
        seconds=dict(baking.seconds),
        set=job.named(texture_set.found),
    )
    run.listener.baked(job, stack, result, baking)
    return result


def _textures(job: Job, stack: MipStack, plan: BakePlan, progress: Callable[[float], None]) -> Encoded:
    """The textures of a GLB."""
    inside = replace(stack, tile=0)  # textures in a GLB have no file names to carry it
    slots, lobe = (job.bake.slots, job.bake.lobe) if job.bake else (None, BASE)
    return encoded(inside, slots, plan.level_count, progress, lobe, texels=plan.glb_texels)


def _chose(preset: Preset | None, cost: Cost) -> Preset | None:
    """The preset, where it chose the output, not the user."""
    return preset if preset and any(cost.format == output.format for output in preset.outputs) else None
