"""Baking what the command line asks for: reads, bakes, writes, checks, and says what happened."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import groupby
from pathlib import Path
from typing import Any

import mipbake
from mipbake import InputError, MipbakeError, OutputError
from mipbake.adjust import Adjustments, adjusted
from mipbake.bake import resolve_target
from mipbake.cli.folders import file_hashes
from mipbake.cli.session import Session, Stages, stages
from mipbake.cli.tables import map_table, remarks, set_report, sources_of
from mipbake.compare.checking import Check
from mipbake.compare.compression import chosen, chosen_all, part_of
from mipbake.compare.costs import Cost
from mipbake.compare.ranges import chosen_ranges
from mipbake.glb import Encoded, check_file, encoded, multiple_of_side, output, save_document
from mipbake.io.gltf.slots import BASE
from mipbake.io.gltf.write import check_images
from mipbake.io.publish import published
from mipbake.jobs import Failure, Job
from mipbake.manifest import check_output, is_stack_folder
from mipbake.output import GLB, GLB_TEXELS, Output, check_outputs
from mipbake.material import MODELS
from mipbake.presets import Preset
from mipbake.stack import MipStack, Provenance
from mipbake.texture_set import TextureSet

DEFECT = 1
"""Exit code where what was written shows a defect of mipbake; any other defect has the same code."""


@dataclass(frozen=True)
class Asked:
    """What is to be baked and written, the same for every set.

    `levels`: how many are written; None for all. `glb`: whether a GLB is. `documents`: whether glTF sources become a
    GLB, and get no files of maps. `finer`: texels that its textures may have in
    place of blocks.
    """

    method: str
    target: str
    pixel_filter: str
    weights: str | None
    budget: str | None
    preset: Preset | None
    outputs: tuple[Output, ...]
    glb: bool
    documents: bool
    adjustments: Adjustments
    levels: int | None
    finer: tuple[str, ...]


def bake_all(session: Session, found: Sequence[Job | Failure], out: Path, asked: Asked) -> list[dict[str, Any]]:
    """Bakes every job; one that fails does not keep others from it. Returns what was done, for JSON."""
    _check_places(found, out, asked)
    results: list[dict[str, Any]] = []
    made: dict[Path, list[tuple[Job, MipStack, Encoded]]] = {}
    found = [*_lost_images(found, asked), *found]
    broken = {job.source for job in found if isinstance(job, Failure)}
    for jobs in _together(found):
        job = jobs[0]
        if isinstance(job, Job) and job.document and job.source in broken and not writes_maps(job, asked):
            made[job.source] = []  # its GLB, all that it is baked for, will not be written
            continue
        try:
            if isinstance(job, Failure):
                raise job.error
            if job.tiled:
                results += _bake_tiles(session, [each for each in jobs if isinstance(each, Job)], out, asked)
            else:
                results += _bake_one(session, job, out / job.place, asked, made)
        except MipbakeError as error:
            session.fail(str(error), error.exit_code)
            results.append({"source": job.source, "ok": False, "exit_code": error.exit_code, "error": str(error)})
    for source, parts in made.items():
        try:
            results.append(_write_document(session, found, source, parts, out, asked))
        except MipbakeError as error:
            session.fail(str(error), error.exit_code)
            results.append({"source": source, "ok": False, "exit_code": error.exit_code, "error": str(error)})
    return results


def _together(found: Sequence[Job | Failure]) -> Iterator[list[Job | Failure]]:
    """What is written together: the groups of tiles of one set; everything else is alone."""
    for (_, tiled), several in groupby(found, lambda job: (_set_of_tiles(job), isinstance(job, Job) and job.tiled)):
        jobs = list(several)
        yield from [jobs] if tiled else ([job] for job in jobs)


def _set_of_tiles(job: Job | Failure) -> tuple[Path, str]:
    """Source and name of a set of tiles, the same for all its groups."""
    if isinstance(job, Failure) or not job.tiled:
        return job.source, ""
    return job.source, next(iter(job.parts.values())).name


def _check_places(found: Sequence[Job | Failure], out: Path, asked: Asked) -> None:
    """OutputError where a GLB cannot lie where it is to be written."""
    documents = {job.source: job for job in found if isinstance(job, Job) and job.document is not None}
    if asked.glb or asked.documents:
        for source, job in documents.items():
            check_file(out / f"{job.place}.{GLB}", source)


def _lost_images(found: Sequence[Job | Failure], asked: Asked) -> list[Failure]:
    """Documents whose GLB would lack an image that is not baked, found before anything is."""
    baked = [job for job in found if isinstance(job, Job) and job.document and wants_glb(job, asked)]
    broken = {job.source for job in found if isinstance(job, Failure)}
    lost = []
    for source in dict.fromkeys(job.source for job in baked if job.source not in broken):
        jobs = [job for job in baked if job.source == source]
        document, bakes = jobs[0].document, [job.bake for job in jobs if job.bake is not None]
        try:
            if document is not None:
                jobs[0].using(partial(check_images, document, bakes))
        except InputError as error:
            lost.append(Failure(source, error))
    return lost


def _bake_tiles(session: Session, jobs: Sequence[Job], out: Path, asked: Asked) -> list[dict[str, Any]]:
    """Bakes all tiles of a set, and writes them into one folder, or nothing where one cannot be baked."""
    target = out / _set_of_tiles(jobs[0])[1]
    found = [each for job in jobs for each in job.found().values()]
    check_output(target, {name: told for each in found for name, told in file_hashes(each).items()})
    with published(target, is_stack_folder) as folder:
        results = [result for job in jobs for result in _bake_one(session, job, folder, asked, {})]
        made = [result["stack"]["provenance"].sources for result in results]
        check_output(target, {name: told for sources in made for name, told in sources.items()})
        for result in results:
            _gather(result, folder, target)
    size = sum(result["bytes"] for result in results)
    count = sum(len(result["files"]) for result in results)
    session.print(f"wrote {target}: {len(results)} tiles, {count} files, {size / 1e6:.2f} MB")
    return results


def _gather(result: dict[str, Any], folder: Path, target: Path) -> None:
    """Moves the files of a tile out of its own folder, into the folder of all tiles, which will be called `target`."""
    for each in result["files"]:
        moved = folder / each["path"].name
        if moved.exists():
            raise OutputError(f"cannot write {target}: two of its tiles have a file {moved.name}, rename the maps")
        each["path"].rename(moved)
        each["path"] = target / moved.name
    result["out"].rmdir()
    result["out"] = result["files"][0]["path"]


def _bake_one(
    session: Session, job: Job, place: Path, asked: Asked, made: dict[Path, list[tuple[Job, MipStack, Encoded]]]
) -> list[dict[str, Any]]:
    """Bakes a set, or tiles that touch, writes every stack, prints what happened, and returns it for JSON.

    `place`: the folder that their folders are written into.
    """
    for found in [] if job.tiled else job.found().values():
        check_output(place / found.name, file_hashes(found))
    with stages(session, job.source.name) as reading:
        reading("read", 0.0)
        read = job.read(multiple_of_side) if wants_glb(job, asked) else job.read()
        reading("read", 1.0)
    for texture_set in read.sets.values():
        check_output(place / texture_set.name, file_hashes(texture_set))
        session.print(
            f"{job.source}: {texture_set.name}, {texture_set.width} x {texture_set.height}",
            map_table(sources_of(texture_set)),
            *remarks(texture_set),
        )
    session.print(*(f"note: {note}" for note in job.notes), *(f"warning: {text}" for text in job.warnings))
    whole = read.texture_set
    model = resolve_target(whole, asked.target)
    check_outputs(asked.outputs, model)
    if whole.anisotropic and not MODELS[model].anisotropic:
        session.print(f"note: the target {model} has no anisotropy: the anisotropy map goes into the roughness alone")
    with stages(session, whole.name) as baking:
        baking.seconds.update(reading.seconds)
        baked = mipbake.bake(whole, asked.method, model, asked.pixel_filter, baking, asked.weights, asked.budget)
        baked = adjusted(baked, whole, asked.adjustments)
        return [
            _write_one(session, job, texture_set, stack, place, asked, baking, made)
            for texture_set, stack in read.stacks(baked)
        ]


def wants_glb(job: Job, asked: Asked) -> bool:
    """Whether a GLB is written."""
    return asked.glb or (asked.documents and job.document is not None)


def writes_maps(job: Job, asked: Asked) -> bool:
    """Whether files of maps are written, not a document alone."""
    return bool(asked.outputs) and not (asked.documents and job.document is not None)


def _write_one(
    session: Session,
    job: Job,
    texture_set: TextureSet,
    stack: MipStack,
    folder: Path,
    asked: Asked,
    baking: Stages,
    made: dict[Path, list[tuple[Job, MipStack, Encoded]]],
) -> dict[str, Any]:
    """Writes the stack of one set, prints what it cost, and returns all of it for JSON."""
    place = folder / texture_set.name
    asked_for = asked.outputs if writes_maps(job, asked) else ()
    with_glb = wants_glb(job, asked)
    check = Check(texture_set, stack, partial(baking, "check"), len(asked_for) + with_glb)
    outputs = chosen_all(check.seen, stack, asked_for, partial(baking, "texels"))
    textures = _textures(job, check.seen, stack, asked, partial(baking, "encode")) if with_glb else None
    if textures is not None and job.document is not None:
        textures = replace(textures, measured=check.glb(textures))
        made.setdefault(job.source, []).append((job, stack, textures))
    beside = textures if job.document is None else None
    files: list[Path] = []
    if outputs or beside:
        files = stack.save(place, outputs, partial(baking, "write"), asked.levels, beside, measured=check)
    costs, left_out = check.costs, () if outputs or textures is None else textures.left_out
    size = sum(file.stat().st_size for file in files)
    provenance = stack.provenance
    learned = f" with {provenance.weights}" if provenance.weights else ""
    blocks = any(each.container.texels in ("bc", "bc1", "uastc") for each in asked.outputs)
    sizes = asked.preset.check(texture_set.width, texture_set.height, blocks) if asked.preset else []
    warnings = [*sizes, *left_out, *(line for each in costs for line in each.warnings(_chose(asked.preset, each)))]
    session.print(
        f"baked by {provenance.method}{learned} to {stack.model}, pixel filter {provenance.pixel_filter}, "
        f"{len(stack.levels)} levels",
        *(f"adjusted: {line}" for line in provenance.adjustments),
        *_promise(provenance),
        *(line for each in costs for line in _cost_lines(each)),
        *(f"warning: {line}" for line in warnings),
        f"time: {baking.summary()}",
        *([f"wrote {place}: {len(files)} files, {size / 1e6:.2f} MB"] if files and not job.tiled else []),
    )
    defects = check.defects
    for line in defects:
        session.fail(f"{place}: {line}", DEFECT)
    return {
        "source": job.source,
        "ok": not defects,
        "exit_code": DEFECT if defects else 0,
        **({"error": " ".join(defects)} if defects else {}),
        "out": place,
        "files": [{"path": file, "bytes": file.stat().st_size} for file in files],
        "bytes": size,
        "costs": costs,
        "warnings": warnings,
        "stack": {"model": stack.model, "levels": len(stack.levels[: asked.levels]), "provenance": provenance},
        "seconds": dict(baking.seconds),
        "set": set_report(texture_set, job),
    }


def _textures(job: Job, seen: TextureSet, stack: MipStack, asked: Asked, progress: Callable[[float], None]) -> Encoded:
    """The textures of a GLB, with the ranges and the texels that cost the least."""
    inside = replace(stack, tile=0)  # textures in a GLB have no file names to carry it
    slots, lobe = (job.bake.slots, job.bake.lobe) if job.bake else (None, BASE)
    best = (GLB_TEXELS[0], *asked.finer)[-1]
    ranges = chosen_ranges(seen, inside, part_of(progress, 0, 3), best)
    texels = chosen(seen, inside, output(asked.finer), part_of(progress, 1, 3), ranges).texels
    return encoded(inside, slots, asked.levels, part_of(progress, 2, 3), lobe, ranges, texels)


def _write_document(
    session: Session,
    found: Sequence[Job | Failure],
    source: Path,
    parts: Sequence[tuple[Job, MipStack, Encoded]],
    out: Path,
    asked: Asked,
) -> dict[str, Any]:
    """Writes the GLB of a document, all of whose materials were baked; returns what was done, for JSON."""
    first = next(job for job in found if isinstance(job, Job) and job.source == source)
    path = out / f"{first.place}.{GLB}"
    if len(parts) < sum(job.source == source for job in found):
        raise InputError(
            f"{path} is not written, because some of its materials could not be read or baked: see the errors about "
            "them"
        )
    if first.document is None:
        raise AssertionError("only documents are collected")
    results = [(job.bake, stack, textures) for job, stack, textures in parts if job.bake is not None]
    first.using(partial(save_document, path, first.document, results, first.plain, asked.levels))
    before, size = first.using(first.document.path.stat).st_size, path.stat().st_size
    session.print(f"wrote {path}: {before / 1e6:.2f} MB in, {size / 1e6:.2f} MB out")
    files = [{"path": path, "bytes": size}]
    measured = {bake.name: textures.measured for bake, _, textures in results}
    about = {"document": True, "files": files, "measured": measured}
    return {"source": source, "ok": True, "exit_code": 0, "out": path, **about}


def _chose(preset: Preset | None, cost: Cost) -> Preset | None:
    """The preset, where it chose the output, not the user."""
    return preset if preset and any(cost.format == output.format for output in preset.outputs) else None


def _cost_lines(cost: Cost) -> list[str]:
    """What files cost, in plain lines."""
    losses = (f"{view} {'0.00' if abs(loss) < 0.005 else f'{loss:+.2f}'} dB" for view, loss in cost.loss.items())
    width = max(map(len, cost.psnr), default=0)
    files = (
        f"  {name:{width}}  {'exact' if psnr == float('inf') else f'{psnr:.1f} dB':>8}  {cost.texels[name]}"
        for name, psnr in cost.psnr.items()
    )
    covered = [f"  {cost.coverage}"] if cost.coverage else []
    return [
        f"{cost.format} costs in SNR of the shaded result: {', '.join(losses)}; PSNR of the files:",
        *files,
        *covered,
    ]


def _promise(provenance: Provenance) -> list[str]:
    """What was measured, in plain lines: one for each pair set."""
    promise = provenance.promise
    if promise is None:
        return []
    lines = [
        f"measured at levels and between levels, compared with the best closed form there, {name}: "
        f"{promise.summary(name)}"
        for name in promise.levels[0].snr
    ]
    if promise.left_out:
        lines.append(f"not measured, because the time ran out: {', '.join(promise.left_out)}")
    return lines
