"""Texture sets from Python: whatever the commands take, as one texture set or one after the other."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeAlias

from mipbake.base.errors import InputError, UsageError
from mipbake.base.messages import listed
from mipbake.base.publish import temporary_folder
from mipbake.source.discover import find
from mipbake.source.intake import jobs
from mipbake.source.jobs import Failure, Job
from mipbake.source.options import LoadOptions, with_overrides
from mipbake.source.texture_set import TextureSet, read

PathLike: TypeAlias = "str | os.PathLike[str]"


def as_texture_set(source: TextureSet | PathLike | Sequence[PathLike]) -> TextureSet:
    """What `load` reads of a source; a texture set as it is."""
    return source if isinstance(source, TextureSet) else load(source)


def load(source: PathLike | Iterable[PathLike], options: LoadOptions | None = None, **overrides: Any) -> TextureSet:
    """Reads a texture set.

    Args:
        source: a folder, a .gltf, .glb or .mtlx document of one material, a .zip archive that holds one of these, a
            glob or `@LIST` that stands for one of them; or the files of one set, several paths.
        options: how to read it. Documents say that themselves.
        overrides: single fields of `LoadOptions`, on top of `options`: `load(folder, colour_space="ACEScg")`.

    Images that lie within an archive or a document are unpacked into a temporary folder, which is gone when this
    returns: their paths in the result only tell where they came from.

    Raises:
        InputError: the source or a file cannot be used, or it holds several sets, which `load_all` reads; the sentence
            says which and what to do.
        UsageError: an option does not exist or has a value it cannot have, or the source is neither path nor paths.
        OutputError: there is no room for temporary files.
    """
    asked = with_overrides(options or LoadOptions(), overrides)
    if not isinstance(source, (str, os.PathLike)):
        files: list[Any] = [*source] if isinstance(source, Iterable) and not isinstance(source, Mapping) else [None]
        if not all(isinstance(file, (str, os.PathLike)) for file in files):
            raise UsageError(
                f"the source is a {type(source).__name__}: expected a path, the paths of one set's files, or a "
                "TextureSet; TextureSet.from_arrays makes one of arrays"
            )
        return read(find([*dict.fromkeys(map(Path, files))], asked), asked)
    with temporary_folder() as scratch:
        found = jobs([os.fspath(source)], asked, scratch)
        several = [name for job in found if isinstance(job, Job) for name in job.names.values()]
        several += [str(job.source) for job in found if isinstance(job, Failure)]
        if len(several) > 1:
            raise InputError(
                f"{source} holds {len(several)} texture sets, {listed(several)}: read them with mipbake.load_all, or "
                "pass the files of one of them"
            )
        return next(_sets(found))


def load_all(
    sources: PathLike | Sequence[PathLike], options: LoadOptions | None = None, **overrides: Any
) -> Iterator[TextureSet]:
    """Reads the texture sets that sources hold, one after the other, as the commands do.

    Args:
        sources: one or more of what `load` takes, and folders of several sets or of UDIM tiles, which come one by one,
            clamped. Sets have distinct names.
        options, overrides: as for `load`, for all of them.

    Raises:
        InputError, UsageError, OutputError: as for `load`, when the turn of what is wrong comes.
    """
    asked = with_overrides(options or LoadOptions(), overrides)
    given = [sources] if isinstance(sources, (str, os.PathLike)) else sources
    with temporary_folder() as scratch:
        yield from _sets(jobs([os.fspath(each) for each in given], asked, scratch))


def _sets(found: Iterable[Job | Failure]) -> Iterator[TextureSet]:
    for job in found:
        if isinstance(job, Failure):
            raise job.error
        for each in job.sets():
            yield replace(each, notes=(*job.notes, *each.notes), warnings=(*job.warnings, *each.warnings))
