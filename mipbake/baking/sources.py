"""All that a user names: texture sets, tiles and documents, baked and written into one folder."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from itertools import groupby
from pathlib import Path
from typing import Any

from mipbake.baking.options import BakeOptions, BakePlan
from mipbake.baking.recipe import document_changed, set_changed
from mipbake.baking.results import (
    BakedDocument,
    BakedSet,
    Listener,
    NotBaked,
    Planned,
    Result,
    Unchanged,
    WrittenFile,
)
from mipbake.baking.sets import BakedMaterial, Run, bake_job
from mipbake.base.allocator import give_back_freed_memory
from mipbake.base.errors import InputError, MipbakeError, OutputError
from mipbake.base.leftovers import tidy
from mipbake.base.publish import TRIAL, published, temporary_folder
from mipbake.source.intake import jobs
from mipbake.source.jobs import Failure, Job
from mipbake.source.layout import tiles_in
from mipbake.source.loading import PathLike
from mipbake.source.options import LoadOptions, with_overrides
from mipbake.stack.gltf.glb import check_file, save_document
from mipbake.stack.gltf.write import check_images
from mipbake.stack.output import GLB


def bake_all(
    sources: PathLike | Sequence[PathLike],
    out: PathLike,
    options: BakeOptions | None = None,
    load: LoadOptions | None = None,
    listener: Listener = Listener(),  # noqa: B008
    **overrides: Any,
) -> list[BakedSet | BakedDocument]:
    """Bakes all that sources hold into a folder, as `mipbake bake` does: texture sets, tiles, and glTF documents, whose
    materials all become one GLB.

        for each in mipbake.bake_all("scene.glb", "baked", method="linear"):
            print(each.source, [file.path for file in each.files])

    Every file is measured as it was read back, and gets texels that cost little where the format leaves that open.

    Args:
        sources: one or more of what `mipbake.load_all` takes.
        out: the folder of all results: OUT/<set>/ for each set, OUT/<file>.glb for each document.
        options: how they are baked and written. load: how they are read. None for the defaults.
        listener: hears what happens meanwhile, and has progress.
        overrides: single fields of `BakeOptions`, on top of `options`.

    Returns:
        What was baked, in the order of the sources; the GLBs of documents come after their materials.

    Raises:
        UsageError: an option does not exist or has a value that it cannot have; nothing is baked then.
        InputError, OutputError: a source cannot be read, or its result cannot be written. What can be baked is baked
            all the same before the first of these is raised; `bake_sources` returns all of them.
    """
    made = bake_sources(sources, out, with_overrides(options or BakeOptions(), overrides), load, listener)
    for each in made:
        if isinstance(each, NotBaked):
            raise each.error
    return [each for each in made if isinstance(each, (BakedSet, BakedDocument))]


def bake_sources(
    sources: PathLike | Sequence[PathLike],
    out: PathLike,
    options: BakeOptions | None = None,
    load: LoadOptions | None = None,
    listener: Listener = Listener(),  # noqa: B008
) -> list[Result]:
    """The same, with what could not be baked among the results.

    Raises:
        UsageError: as `bake_all`. InputError: none of the sources is there. OutputError: a GLB cannot lie where it is
            to be written, or there is no room for temporary files.
    """
    plan = (options or BakeOptions()).plan()
    given = [sources] if isinstance(sources, (str, os.PathLike)) else sources
    with temporary_folder() as scratch:
        found = jobs([os.fspath(each) for each in given], load or LoadOptions(), scratch)
        listener.found(plan, found)
        return bake_jobs(Run(plan, listener, keeps=True), found, Path(out))


def bake_jobs(run: Run, found: Sequence[Job | Failure], out: Path) -> list[Result]:
    """Bakes every job that the run is for; one that fails does not keep others from it.

    Raises:
        OutputError: a GLB cannot lie where it is to be written.
    """
    results: list[Result] = []

    def failed(source: Path, error: MipbakeError) -> None:
        results.append(NotBaked(source, error))
        run.listener.failed(NotBaked(source, error))

    documents = {job.source: job for job in found if isinstance(job, Job) and job.document is not None}
    for document in documents.values() if run.plan.glb or run.plan.documents else ():
        check_file(out / f"{document.place}.{GLB}", *documents)
    if run.which != "all":
        found = list(_to_bake(run, found, out, results, failed))
    found = [*_lost_images(found, run.plan), *found]
    broken = {job.source for job in found if isinstance(job, Failure)}
    cut_off = False
    for together in _together(found):
        job = together[0]
        cut_off = run.listener.ends() and job.source not in run.documents
        if cut_off:  # the user has stopped a search, whose result is written: what is not begun is abandoned
            break
        if isinstance(job, Job) and job.document and job.source in broken and not run.plan.writes_maps(job):
            run.documents[job.source] = []  # its GLB, all that it is baked for, will not be written
            continue
        try:
            if isinstance(job, Failure):
                raise job.error
            with job.naming():
                if job.tiled:
                    results += _bake_tiles(run, [each for each in together if isinstance(each, Job)], out)
                else:
                    results += bake_job(run, job, out / job.place, out)
        except MipbakeError as error:
            failed(job.source, error)
        give_back_freed_memory()
    for source, parts in run.documents.items():
        try:
            results.append(_write_document(run, found, source, parts, out))
        except MipbakeError as error:
            failed(source, error)
    if cut_off:
        raise KeyboardInterrupt
    return results


def _tiles_of(job: Job | Failure) -> tuple[Path, str]:
    """Source and name of a set of tiles, the same for all its groups; no name for anything else."""
    if isinstance(job, Failure) or not job.tiled:
        return job.source, ""
    return job.source, job.name


def _to_bake(
    run: Run,
    found: Sequence[Job | Failure],
    out: Path,
    results: list[Result],
    failed: Callable[[Path, MipbakeError], None],
) -> Iterator[Job | Failure]:
    """What is to be baked; what is said of everything else goes to `results`.

    Where it cannot be said whether something has changed, because a file cannot be read, a bake says what is wrong.
    """
    broken = {each.source for each in found if isinstance(each, Failure)}
    yield from (job for job in found if isinstance(job, Failure))
    units: dict[object, list[Job]] = {}  # tiles of a set, all materials of a document that becomes a GLB, or a set
    for index, job in enumerate(found):
        if isinstance(job, Job):
            whole = job.document is not None and run.plan.wants_glb(job)
            units.setdefault(job.source if whole else _tiles_of(job) if job.tiled else index, []).append(job)
    for unit in units.values():
        try:
            left = _left(run, unit, out, unit[0].source not in broken)
        except MipbakeError as error:
            if run.which == "none":
                failed(unit[0].source, error)
            else:
                yield from unit
            continue
        if left is None:
            yield from unit
        else:
            results.append(left)
            run.listener.left(left)


def _left(run: Run, jobs: Sequence[Job], out: Path, whole: bool) -> Unchanged | Planned | None:
    """What is said of jobs that are not baked; None where they are to be baked. `whole`: they are all of their source,
    so that a tile that is none of theirs is gone."""
    first, why, place = jobs[0], "", out
    folders: dict[Path, dict[str, str]] = {}  # each with the files that its stack is of, and their hashes
    if first.document is not None and run.plan.wants_glb(first):
        place = out / f"{first.place}.{GLB}"
        _tidy(run, place)
        why = document_changed(place, run.ingredients.document(jobs))
    if run.plan.writes_maps(first) or first.document is None:
        for job in jobs:
            found = job.found()
            folder = out / job.place / (_tiles_of(job)[1] or next(iter(found.values())).name)
            place = place if place != out else folder
            _tidy(run, folder)
            why = why or set_changed(folder, job.parts, run.ingredients.recipe(job, found))
            for each in found.values():
                folders.setdefault(folder, {}).update(each.hashes)
        if first.tiled and not why and whole:
            gone = tiles_in(place) - {tile for job in jobs for tile in job.parts}
            why = f"the source of its tile {min(gone)} is gone" if gone else ""
    if not why:
        return Unchanged(first.source, place)
    for folder, hashes in folders.items() if run.which == "none" else ():
        run.check_output(folder, hashes)  # a plan that cannot be carried out is none
    return Planned(first.source, place, why) if run.which == "none" else None


def _tidy(run: Run, place: Path) -> None:
    """What a killed process left beside a place goes, or gets its name back, before anybody looks what lies there."""
    if run.which != "none":
        tidy(*(Path(os.path.realpath(place)).with_name(name) for name in (place.name, TRIAL)))


def _together(found: Sequence[Job | Failure]) -> Iterator[list[Job | Failure]]:
    """What is written together: the groups of tiles of one set; everything else is alone."""
    for (_, tiled), several in groupby(found, lambda job: (_tiles_of(job), isinstance(job, Job) and job.tiled)):
        together = list(several)
        yield from [together] if tiled else ([job] for job in together)


def _lost_images(found: Sequence[Job | Failure], plan: BakePlan) -> list[Failure]:
    """Documents whose GLB would lack an image that is not baked, found before anything is."""
    baked = [job for job in found if isinstance(job, Job) and job.document and plan.wants_glb(job)]
    broken = {job.source for job in found if isinstance(job, Failure)}
    lost = []
    for source in dict.fromkeys(job.source for job in baked if job.source not in broken):
        materials = [job for job in baked if job.source == source]
        document, bakes = materials[0].document, [job.bake for job in materials if job.bake is not None]
        try:
            if document is not None:
                materials[0].using(partial(check_images, document, bakes))
        except InputError as error:
            lost.append(Failure(source, error))
    return lost


def _bake_tiles(run: Run, groups: Sequence[Job], out: Path) -> list[BakedSet]:
    """Bakes all tiles of a set, and writes them into one folder, or nothing where one cannot be baked."""
    place = out / _tiles_of(groups[0])[1]
    found = [each for job in groups for each in job.found().values()]
    run.check_output(place, {name: sha256 for each in found for name, sha256 in each.hashes.items()})
    with published(place, run.ours) as folder:
        made = [tile for job in groups for tile in bake_job(run, job, folder, out)]
        run.check_output(place, {name: sha256 for tile in made for name, sha256 in tile.provenance.sources.items()})
        tiles = [_gathered(tile, folder, place) for tile in made]
    run.listener.gathered(place, tiles)
    return tiles


def _gathered(tile: BakedSet, folder: Path, place: Path) -> BakedSet:
    """Moves the files of a tile out of its own folder, into the folder of all tiles, which will be called `place`."""
    files = []
    for each in tile.files:
        moved = folder / each.path.name
        if moved.exists():
            raise OutputError(f"cannot write {place}: two of its tiles have a file {moved.name}, rename the maps")
        each.path.rename(moved)
        files.append(WrittenFile(place / moved.name, each.bytes))
    tile.out.rmdir()
    return replace(tile, out=files[0].path, files=tuple(files))


def _write_document(
    run: Run, found: Sequence[Job | Failure], source: Path, parts: Sequence[BakedMaterial], out: Path
) -> BakedDocument:
    """Writes the GLB of a document, all of whose materials were baked."""
    first = next(job for job in found if isinstance(job, Job) and job.source == source)
    path = out / f"{first.place}.{GLB}"
    if len(parts) < sum(job.source == source for job in found):
        raise InputError(
            f"{path} is not written, because some of its materials could not be read or baked: see the errors about "
            "them"
        )
    if first.document is None:
        raise AssertionError("only documents are collected")
    results = [(part.job.bake, part.stack, part.textures) for part in parts if part.job.bake is not None]
    recipe = run.ingredients.document([job for job in found if isinstance(job, Job) and job.source == source])
    save = partial(save_document, path, first.document, results, first.plain, run.plan.level_count, recipe)
    plain = first.using(save)
    before, size = first.using(first.document.path.stat).st_size, path.stat().st_size
    measured = {bake.name: textures.measured for bake, _, textures in results}
    made = BakedDocument(source, path, (WrittenFile(path, size),), measured, plain)
    run.listener.document(made, before)
    return made
