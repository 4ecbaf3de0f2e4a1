"""The work of one process of a batch: one source, read, baked and written."""

from __future__ import annotations

import os
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from mipbake.baking.options import BakeOptions
from mipbake.baking.results import DEFECT, BakedSet, Listener, NotBaked, Result, Unchanged
from mipbake.baking.sets import Run, Which
from mipbake.baking.sources import bake_jobs
from mipbake.base import disk, json_text, memory
from mipbake.base.errors import InputError, MipbakeError, UsageError
from mipbake.base.publish import temporary_folder
from mipbake.library.listing import Entry
from mipbake.library.results import EntryResult, WorkerError, declares, result_files
from mipbake.library.state import FileState, Record, absolute, state_of, states
from mipbake.source.archives import GLTF, MATERIALX
from mipbake.source.gltf.document import Document
from mipbake.source.gltf.images import image_files
from mipbake.source.gltf.uris import file_of, spellings
from mipbake.source.jobs import Failure, Job
from mipbake.source.options import LoadOptions
from mipbake.source.sources import Found


@dataclass(frozen=True)
class Task:
    """What a process is asked to do.

    Args:
        entry: the source, and where its results lie.
        out: folder of all results.
        options, load: how it is baked and read. recipe: see `Record`.
        which, known, by_name: see `mipbake.baking.sets.Run`.
        touch: whether a result that has not changed gets a new time, so that a build system sees that it was looked at.
    """

    entry: Entry
    out: Path
    options: BakeOptions
    load: LoadOptions
    recipe: str
    which: Which
    known: bool
    by_name: bool = False
    touch: bool = False


def work(task: Task) -> EntryResult:
    """Does a task. Errors are among the results."""
    begun = time.monotonic()
    results: list[Result]
    files: Sequence[FileState] = ()  # that decide it, as they were before they were read
    try:
        results, files = _baked(task)
    except MipbakeError as error:
        results = [NotBaked(task.entry.source, error)]
    except Exception as error:
        results = [NotBaked(task.entry.source, unforeseen(error))]
    if task.touch:
        for file in result_files([each for each in results if isinstance(each, Unchanged)]):
            if declares(file):
                os.utime(file)
    record = None
    failures = [each for each in results if isinstance(each, NotBaked)]
    # Another try would say the same of the same files; not of a full disk, nor where it is not known which files count.
    of_files = all(isinstance(each.error, (InputError, UsageError)) for each in failures)
    if task.which != "none" and of_files and files and not (failures and task.entry.source.suffix == MATERIALX):
        written = tuple(state_of(file, task.out, ours=True) for file in result_files(results))
        faults = [(each.error.full, each.error.exit_code) for each in failures]
        faults += [("; ".join(each.defects), DEFECT) for each in results if isinstance(each, BakedSet) and each.defects]
        about = (task.entry.label, absolute(task.entry.source), task.recipe)
        record = Record(*about, tuple(files), written, len(results) - len(faults), tuple(faults))
    return EntryResult(task.entry, tuple(results), seconds=time.monotonic() - begun, record=record)


def _baked(task: Task) -> tuple[list[Result], Sequence[FileState]]:
    """What became of a source, and the files that decide it, as they were before they were read."""
    source = task.entry.source
    before = states(task.entry)
    with temporary_folder() as scratch:
        found = task.entry.jobs(task.load, scratch)
        others = [path for path in _files(source, found) if not disk.lies_in(path, scratch)]
        # What lay there before it was read counts, should it change meanwhile.
        files = tuple({file.path: file for file in (*states(task.entry, others), *before)}.values())
        run = Run(task.options.plan(), Listener(), task.which, task.known, task.by_name, keeps=True)
        return bake_jobs(run, found, task.out / task.entry.place), files


def _files(source: Path, found: Sequence[Job | Failure]) -> Iterator[Path]:
    """Files that jobs read, or would read if they were there, beside the source itself."""
    documents: set[Path] = set()
    if source.suffix.lower() in GLTF and any(isinstance(job, Failure) for job in found):
        yield from _named(source)
    for job in found:
        if isinstance(job, Failure) or job.archive is not None:
            continue
        for found_set in _found(job):
            yield from (each.path for each in found_set.maps.values() if each.path is not None)
        if job.document is not None and job.source not in documents:
            documents.add(job.source)
            yield from _buffers(job.document)
            yield from image_files(job.document, Path(job.source.anchor or "/"))


def _named(document: Path) -> Iterator[Path]:
    """The files that a glTF document names, as far as it can be read; they may be missing."""
    try:
        content = json_text.parsed(document.read_bytes())
        uris = [each["uri"] for kind in ("images", "buffers") for each in content.get(kind, ()) if "uri" in each]
    except (OSError, ValueError, TypeError, AttributeError, KeyError):  # a GLB, or one that is broken itself
        return
    named = (uri for uri in uris if isinstance(uri, str) and ":" not in uri)
    yield from (document.parent / text for uri in named for text in spellings(uri))


def _found(job: Job) -> list[Found]:
    try:
        return list(job.found().values())
    except InputError:  # the bake will say so
        return []


def _buffers(document: Document) -> Iterator[Path]:
    for index, buffer in enumerate(document.all("buffers")):
        file = file_of(buffer.get("uri"), document.path, document.path.parent, f"buffer {index}")
        if file is not None:
            yield file


def unforeseen(error: Exception) -> WorkerError:
    """What a user is told of an error that no code expects."""
    if memory.lacks(error):
        return WorkerError(
            "there is not enough memory for it: bake fewer at a time (--jobs), or hold them to less (--memory)"
        )
    return WorkerError(
        f"sorry, this is a defect ({type(error).__name__}: {error}); please report it with the output of "
        "`mipbake --version` and of `mipbake --debug bake` for this source alone"
    )
