"""What became of the entries of a library, and who hears of it meanwhile."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path, PurePath

from mipbake.baking.results import BakedDocument, BakedSet, NotBaked, Planned, Result, Unchanged
from mipbake.base.errors import MipbakeError
from mipbake.library.listing import Entry
from mipbake.library.state import Record
from mipbake.source.layout import is_manifest
from mipbake.stack.output import GLB


class WorkerError(MipbakeError):
    """A process of a batch that ended before its work, or found a defect."""

    exit_code = 1


@dataclass(frozen=True)
class EntryResult:
    """What became of an entry.

    Args:
        entry: of the library.
        results: of its sets and documents; of those that a list says have not changed, what is wrong with their files.
        unchanged: how many results that list knows, where nothing has changed.
        seconds: that it took.
        record: the files that it was made from and lies in; None where it failed, or was not to be baked.
    """

    entry: Entry
    results: tuple[Result, ...] = ()
    unchanged: int = 0
    seconds: float = 0.0
    record: Record | None = None

    @property
    def failures(self) -> list[NotBaked]:
        """What could not be baked."""
        return [each for each in self.results if isinstance(each, NotBaked)]

    @property
    def exit_code(self) -> int:
        """That of `mipbake bake` for the entry."""
        codes = [each.error.exit_code for each in self.failures]
        codes += [each.exit_code for each in self.results if isinstance(each, BakedSet)]
        return max(codes, default=0)


@dataclass(frozen=True)
class Progress:
    """How far a batch has come.

    Args:
        done, count: entries that are done, and all of them.
        seconds_left: an estimate from the sizes of the files that are done and of those that are not; None before the
            first entry is baked.
    """

    done: int
    count: int
    seconds_left: float | None = None


@dataclass(frozen=True)
class Summary:
    """What a batch came to.

    Args:
        entries: what became of each, in the order of the library.
    """

    entries: tuple[EntryResult, ...] = field(default=())

    def __repr__(self) -> str:
        """A description in one line."""
        counts = f"baked={self.baked}, documents={self.documents}, planned={self.planned}, unchanged={self.unchanged}"
        return f"Summary({counts}, failures={self.failures})"

    def _count(self, kind: type[Result]) -> int:
        return sum(isinstance(each, kind) for entry in self.entries for each in entry.results)

    @property
    def baked(self) -> int:
        """How many texture sets were baked."""
        return self._count(BakedSet)

    @property
    def documents(self) -> int:
        """How many GLB files were written of documents."""
        return self._count(BakedDocument)

    @property
    def planned(self) -> int:
        """How many sets and documents would be baked."""
        return self._count(Planned)

    @property
    def unchanged(self) -> int:
        """How many sets and documents were left as they are."""
        return self._count(Unchanged) + sum(entry.unchanged for entry in self.entries)

    @property
    def failures(self) -> list[NotBaked]:
        """What could not be baked, and why."""
        return [each for entry in self.entries for each in entry.failures]

    @property
    def exit_code(self) -> int:
        """The highest of all entries."""
        return max((entry.exit_code for entry in self.entries), default=0)


class BatchListener:
    """Hears what happens while a library is baked. This one does nothing with it: overwrite what you want to hear."""

    def found(self, entries: Sequence[Entry], notes: Sequence[str], jobs: int) -> None:
        """What is there is known; `notes`: what was left out; `jobs`: how many processes there will be, 0 where
        nothing is to be baked."""

    def left(self, result: EntryResult) -> None:
        """An entry has not changed since the last time, and nothing of it is read."""

    def done(self, result: EntryResult, progress: Progress) -> None:
        """An entry is done."""


def declares(file: PurePath) -> bool:
    """Whether a file of a result stands for all of it: a stack's `stack.json`, or a GLB."""
    return is_manifest(file.name) or file.suffix == f".{GLB}"


def result_files(results: Sequence[Result]) -> list[Path]:
    """The files that results of an entry lie in."""
    places: dict[Path, None] = {}
    for each in results:
        if not isinstance(each, NotBaked):
            tile = is_manifest(each.out.name) and each.out.is_file()  # a tile shares its folder with others
            places[each.out.parent if tile else each.out] = None
    return [file for place in places for file in (sorted(place.iterdir()) if place.is_dir() else [place])]
