"""What is not baked: results that are already what they would be baked to, or all of them where a run only plans."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from pathlib import Path

from mipbake.baking.recipe import document_changed, set_changed
from mipbake.baking.results import NotBaked, Planned, Result, Unchanged
from mipbake.baking.sets import Run
from mipbake.base.errors import MipbakeError
from mipbake.base.leftovers import tidy
from mipbake.base.publish import TRIAL
from mipbake.source.jobs import Failure, Job
from mipbake.source.layout import tiles_in
from mipbake.stack.output import GLB


def together_at(job: Job | Failure) -> tuple[Path, str]:
    """Source and name of a set of tiles, the same for all its groups; no name for anything else."""
    if isinstance(job, Failure) or not job.tiled:
        return job.source, ""
    return job.source, job.name


def without_left(run: Run, found: Sequence[Job | Failure], out: Path) -> tuple[list[Job | Failure], list[Result]]:
    """What is to be baked, and what is said of everything else.

    Where it cannot be said whether something has changed, because a file cannot be read, a bake says what is wrong.
    """
    kept: list[Job | Failure] = []
    results: list[Result] = []
    broken = {each.source for each in found if isinstance(each, Failure)}
    for jobs in _units(run, found):
        if isinstance(jobs, Failure):
            kept.append(jobs)
            continue
        try:
            left = _left(run, jobs, out, jobs[0].source not in broken)
        except MipbakeError as error:
            if run.which != "none":
                kept += jobs
                continue
            results.append(NotBaked(jobs[0].source, error))
            run.listener.failed(NotBaked(jobs[0].source, error))
            continue
        if left is None:
            kept += jobs
            continue
        results.append(left)
        run.listener.left(left)
    return kept, results


def _units(run: Run, found: Sequence[Job | Failure]) -> Iterator[list[Job] | Failure]:
    """What is baked or left together: tiles of a set, all materials of a document that becomes a GLB, or a set."""
    units: dict[object, list[Job]] = {}
    for index, job in enumerate(found):
        if isinstance(job, Failure):
            yield job
        elif job.document is not None and run.asked.wants_glb(job):
            units.setdefault(job.source, []).append(job)
        else:
            units.setdefault(together_at(job) if job.tiled else index, []).append(job)
    yield from units.values()


def _left(run: Run, jobs: Sequence[Job], out: Path, whole: bool) -> Unchanged | Planned | None:
    """What is said of jobs that are not baked; None where they are to be baked. `whole`: they are all of their source,
    so that a tile that is none of theirs is gone."""
    first, why, place = jobs[0], "", out
    folders: dict[Path, dict[str, str]] = {}  # each with the files that its stack is of, and their hashes
    if first.document is not None and run.asked.wants_glb(first):
        place = out / f"{first.place}.{GLB}"
        _tidy(run, place)
        why = document_changed(place, run.ingredients.document(jobs))
    if run.asked.writes_maps(first) or first.document is None:
        for job in jobs:
            found = job.found()
            folder = out / job.place / (together_at(job)[1] or next(iter(found.values())).name)
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
