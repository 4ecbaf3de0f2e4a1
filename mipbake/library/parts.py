"""Several texture sets in one folder: each is an entry of its own, with options of its own, baked beside the others."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path, PurePath

from mipbake.base import disk
from mipbake.base.errors import InputError, UsageError
from mipbake.source.intake import files_of_set, jobs
from mipbake.source.jobs import Failure, Job
from mipbake.source.options import LoadOptions


@dataclass(frozen=True)
class Group:
    """What is baked at once of a set: all of it, or tiles that touch.

    Args:
        files: tile number to files, relative to the folder; 0 for sets that are not tiles.
        notes, warnings: what was found, in sentences.
    """

    files: Mapping[int, tuple[PurePath, ...]]
    notes: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()


@dataclass(frozen=True)
class Part:
    """One of several sets in a folder.

    Args:
        name: of the set, which no other set in the folder has.
    """

    name: str
    groups: tuple[Group, ...]

    @property
    def files(self) -> list[PurePath]:
        """All its files, relative to the folder."""
        return [file for group in self.groups for several in group.files.values() for file in several]

    def jobs(self, folder: Path, load: LoadOptions) -> list[Job | Failure]:
        """What is to be baked of it, read with these options, which may be others than those that told the sets."""
        try:
            return [self._job(group, folder, load) for group in self.groups]
        except (InputError, UsageError) as error:
            return [Failure(folder, error)]

    def _job(self, group: Group, folder: Path, load: LoadOptions) -> Job:
        own = replace(load, name=load.name or self.name)
        read = {
            tile: files_of_set(tuple(folder / name for name in names), own, self.name, tile)
            for tile, names in group.files.items()
        }
        return Job(folder, read, group.notes, group.warnings)


def parts_of(folder: Path, load: LoadOptions) -> list[Part]:
    """The sets in a folder, as names tell them; none where it holds a single set, or something is wrong with it, which
    its own turn will say.

    Args:
        load: how it is read; patterns in its maps tell sets apart, too.
    """
    if not disk.is_dir(folder):
        return []
    groups: dict[str, list[Group]] = {}
    for job in jobs([str(folder)], load, folder):  # a folder of maps takes no room for temporary files
        if isinstance(job, Failure):
            return []
        files = {tile: part.files for tile, part in job.parts.items()}
        listed = {t: tuple(f.relative_to(folder) for f in each) for t, each in files.items() if isinstance(each, tuple)}
        if listed.keys() != files.keys():
            return []
        name = next(iter(job.parts.values())).name
        groups.setdefault(name, []).append(Group(listed, job.notes, job.warnings))
    return [Part(name, tuple(several)) for name, several in groups.items()] if len(groups) > 1 else []
