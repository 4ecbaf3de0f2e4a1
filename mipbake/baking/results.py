"""What was baked, written and measured, and who hears of it meanwhile."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mipbake.baking.methods import Stop
from mipbake.base.errors import MipbakeError
from mipbake.base.timings import Timings
from mipbake.source.jobs import Failure, Job
from mipbake.source.sources import Found
from mipbake.source.texture_set import TextureSet
from mipbake.stack.costs import Cost
from mipbake.stack.gltf.glb_plain import PlainCost
from mipbake.stack.stack import MipStack, Provenance

if TYPE_CHECKING:
    from mipbake.baking.options import BakePlan

DEFECT = 1
"""Exit code where what was written shows a defect of mipbake; any other defect has the same code."""


@dataclass(frozen=True)
class WrittenFile:
    """A file that was written, and its size."""

    path: Path
    bytes: int


@dataclass(frozen=True)
class BakedSet:
    """A texture set that was baked.

    Args:
        source: what it comes from, as the user named it.
        out: its folder; of a tile, which shares one with other tiles, the file that declares its stack.
        files: what was written; empty where all is in the GLB of a document.
        costs: what every output costs and gives back. defects: a sentence for each that shows a defect of mipbake.
        warnings: what a user should know, in sentences.
        model: the material model. levels: how many were written. provenance: how they were made.
        seconds: phase to its time.
        set: the facts about the texture set.
    """

    source: Path
    out: Path
    files: tuple[WrittenFile, ...]
    costs: tuple[Cost, ...]
    defects: tuple[str, ...]
    warnings: tuple[str, ...]
    model: str
    levels: int
    provenance: Provenance
    seconds: Mapping[str, float]
    set: Found

    def __repr__(self) -> str:
        """A description in one line."""
        made = f"{self.model}, {self.levels} levels, by {self.provenance.method}"
        return f"BakedSet({str(self.out)!r}, {made}, {len(self.files)} files)"

    @property
    def bytes(self) -> int:
        """Size of all files."""
        return sum(file.bytes for file in self.files)

    @property
    def exit_code(self) -> int:
        """That of `mipbake bake` for the set."""
        return DEFECT if self.defects else 0


@dataclass(frozen=True)
class BakedDocument:
    """A GLB that was written of a glTF document, all of whose materials were baked.

    Args:
        source: the document. out: the GLB. files: the same, with its size.
        measured: material to what its textures give back, as `mipbake.Check.glb` tells it.
        plain: what blocks cost textures that are averaged.
    """

    source: Path
    out: Path
    files: tuple[WrittenFile, ...]
    measured: Mapping[str, Mapping[str, Any] | None]
    plain: tuple[PlainCost, ...] = ()

    def __repr__(self) -> str:
        """A description in one line."""
        return f"BakedDocument({str(self.out)!r}, {len(self.measured)} materials)"

    @property
    def bytes(self) -> int:
        """Size of the GLB."""
        return sum(file.bytes for file in self.files)


@dataclass(frozen=True)
class NotBaked:
    """A source, or a part of one, that could not be read, baked or written, and why."""

    source: Path
    error: MipbakeError


@dataclass(frozen=True)
class Unchanged:
    """A texture set, tiles of one set, or a document, whose result is what it would be baked to again.

    Args:
        source: as the user named it. out: the result: a folder, or a GLB.
    """

    source: Path
    out: Path


@dataclass(frozen=True)
class Planned:
    """What would have been baked; `why`: what it lacks, in a sentence without its end."""

    source: Path
    out: Path
    why: str


Result = BakedSet | BakedDocument | NotBaked | Unchanged | Planned


class Listener:
    """Hears what happens while sources are baked. This one does nothing with it: overwrite what you want to hear."""

    @contextmanager
    def timings(self, label: str) -> Iterator[Timings]:
        """Progress of one piece of work; `label`: what it is about."""
        del label
        yield Timings()

    def found(self, plan: BakePlan, jobs: Sequence[Job | Failure]) -> None:
        """What is going to be baked is known; nothing is read."""

    def read(self, job: Job, sets: Sequence[TextureSet]) -> None:
        """A texture set, or tiles that touch, has been read."""

    @contextmanager
    def descending(self) -> Iterator[Stop]:
        """A search optimises texels while the block runs. It asks often whether it shall end with the best so far."""
        yield lambda: False

    def ends(self) -> bool:
        """Whether nothing more is to be begun, because the user has stopped what is at work."""
        return False

    def note(self, sentence: str) -> None:
        """Something that a user should know, about what was read last."""

    def baked(self, job: Job, stack: MipStack, result: BakedSet, timings: Timings) -> None:
        """A set has been baked, and its files have been written. Tiles are moved into their folder after that."""

    def gathered(self, folder: Path, tiles: Sequence[BakedSet]) -> None:
        """All tiles of a set have been written into their folder."""

    def document(self, result: BakedDocument, bytes_before: int) -> None:
        """A GLB has been written; `bytes_before`: size of its source."""

    def left(self, result: Unchanged | Planned) -> None:
        """Something is not baked, because nothing has changed or because it was not to be."""

    def failed(self, failure: NotBaked) -> None:
        """Something could not be baked. The rest is baked all the same."""
