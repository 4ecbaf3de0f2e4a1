"""What the page of `mipbake gui` works on: files that it was given, the sets in them, and what was baked last."""

from __future__ import annotations

import shutil
import zipfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from io import BufferedIOBase
from pathlib import Path, PurePosixPath
from typing import Any

from mipbake.baking import BakedDocument, BakedSet, BakeOptions, Listener
from mipbake.baking.bake import bake
from mipbake.baking.options import BakePlan
from mipbake.baking.pipeline import DEFAULT_FILTER, DEFAULT_METHOD
from mipbake.baking.results import NotBaked
from mipbake.baking.sets import Run
from mipbake.baking.sources import bake_jobs
from mipbake.base import disk
from mipbake.base.errors import InputError, OutputError
from mipbake.base.timings import Timings
from mipbake.comparing.viewer import scene
from mipbake.library.listing import found_library
from mipbake.material.pixel_filter import filter_named
from mipbake.source.jobs import Failure, Job
from mipbake.source.options import LoadOptions
from mipbake.source.texture_set import TextureSet
from mipbake.stack.presets import Preset
from mipbake.stack.stack import MipStack

MOST_BYTES = 4 << 30
"""Of all files that a page sends; what is larger is baked by the command line, from where it lies."""

_CHUNK = 1 << 20

PLAIN = ("linear", "box")
"""Method and pixel filter of plain MIP maps."""

_BAKED = (DEFAULT_METHOD, DEFAULT_FILTER)

Tell = Callable[[str, float], None]


@dataclass(frozen=True)
class Result:
    """What a bake made: the file that is downloaded, and what is in it, in words."""

    file: Path
    about: str


@dataclass
class Bench:
    """The files, the sets and the results. All but `add` is for one thread.

    Args:
        folder: a temporary one. given: what the command line named, which stays as it is; None for nothing.
        results: of the latest bake, by "baked" and "plain".
    """

    folder: Path
    given: Path | None = None
    results: dict[str, Result] = field(default_factory=dict)
    _own: bool = False  # whether the page has sent files
    _received: int = 0
    _found: list[Job] = field(default_factory=list)

    @property
    def _uploads(self) -> Path:
        return self.folder / "uploads"

    def clear(self) -> None:
        """Forgets what the page sent, and what was baked of it."""
        self._own, self._received, self._found = True, 0, []
        self.results.clear()
        for each in self.folder.iterdir():
            shutil.rmtree(each, ignore_errors=True) if each.is_dir() else each.unlink()

    def add(self, name: str, content: BufferedIOBase, size: int) -> None:
        """Keeps a file that the page sends.

        Args:
            name: with its folders, parted by slashes. content: is read to the end of so many bytes.

        Raises:
            InputError: a name that would lie elsewhere, or too many bytes. OutputError: there is no room.
        """
        parts = PurePosixPath(name.replace("\\", "/")).parts
        if not parts or any(part in ("..", "/") or "\0" in part or ":" in part for part in parts):
            raise InputError(f"a file is called {name!r}: expected a name, with folders perhaps; rename it")
        self._received += size
        if self._received > MOST_BYTES:
            raise InputError(
                f"the files are larger than {MOST_BYTES >> 30} GB together: name their folder on the command line, as "
                "in mipbake gui textures/wood"
            )
        place = self._uploads.joinpath(*parts)
        try:
            place.parent.mkdir(parents=True, exist_ok=True)
            with place.open("wb") as file:
                while size > 0 and (chunk := content.read(min(size, _CHUNK))):
                    size -= file.write(chunk)
        except OSError as error:
            raise OutputError(f"{name} cannot be kept in {self.folder} ({error.strerror}): make room there") from error
        if size:
            raise InputError(f"{name} did not arrive whole: drop it again")

    def sets(self) -> list[dict[str, Any]]:
        """The texture sets by name, each with the images that may fill its roles; none where a document says that.

        Raises:
            InputError: there is none, or none can be read.
        """
        self._found = self._jobs(LoadOptions(), "scratch")
        return [
            {
                "name": job.name,
                "files": [] if job.document else sorted({f.name for each in job.parts.values() for f in each.files}),
            }
            for job in self._found
        ]

    def _jobs(self, load: LoadOptions, scratch_name: str) -> list[Job]:
        """What is to be baked of everything; what lies in archives is unpacked into a folder of that name."""
        source = self._uploads if self._own else self.given
        if source is None:
            raise InputError("there are no files: drop the maps of a material")
        scratch = self.folder / scratch_name
        shutil.rmtree(scratch, ignore_errors=True)
        found: list[Job | Failure] = []
        for index, entry in enumerate(found_library(source, self.folder / "out", lambda _: load).entries):
            place = scratch / str(index)
            place.mkdir(parents=True)
            found += entry.jobs(load, place)
        jobs = [job for job in found if isinstance(job, Job)]
        if not jobs:
            raise next(each.error for each in found if isinstance(each, Failure))
        return jobs

    def bake(self, index: int, wanted: Mapping[str, Any], tell: Tell) -> dict[str, Any]:
        """Bakes a set, or the document that it is of, for an engine; returns what the page shows.

        Args:
            index: of `sets`. wanted: maps (role to file, or None), convention and preset, "" for none of the two.
            tell: hears phases and finished shares; what it raises ends the bake.

        Raises:
            MipbakeError: as `mipbake.bake_all`.
        """
        chosen = self._chosen(index)
        heard, plan, written = self._written(chosen, wanted, "baked", tell, *_BAKED)
        texture_set, stack = heard.made[chosen.name]
        plain = bake(texture_set, PLAIN[0], stack.model, PLAIN[1], lambda _, share: tell("comparison", share))
        found, source = stack.verdict, texture_set.filtered(filter_named(stack.provenance.pixel_filter).name)
        return {
            "scene": scene({"plain": plain, "mipbake": stack}, source),
            "verdict": found and {"outcome": found.outcome, "sentence": found.sentence},
            "notes": _notes(written, plan.preset),
            **self._download("baked"),
        }

    def plain(self, index: int, wanted: Mapping[str, Any], tell: Tell) -> dict[str, Any]:
        """Writes plain MIP maps of the same for the same engine. Arguments and errors are those of `bake`."""
        self._written(self._chosen(index), wanted, "plain", tell, *PLAIN)
        return self._download("plain")

    def _download(self, kind: str) -> dict[str, Any]:
        return {"file": self.results[kind].file.name, "about": self.results[kind].about}

    def _chosen(self, index: int) -> Job:
        if not 0 <= index < len(self._found):
            raise InputError("that material is not there any more: drop it again")
        return self._found[index]

    def _written(
        self, chosen: Job, wanted: Mapping[str, Any], kind: str, tell: Tell, method: str, pixel_filter: str
    ) -> tuple[_Hears, BakePlan, list[BakedSet | BakedDocument]]:
        """Bakes, writes, and packs the result under the name `kind`."""
        preset = wanted["preset"] or None
        form = "png" if preset is None and chosen.document is None else None
        plan = BakeOptions(method=method, pixel_filter=pixel_filter, preset=preset, format=form).plan()
        whole = plan.wants_glb(chosen)
        jobs = [each for each in self._found if each.source == chosen.source] if whole else [self._with(chosen, wanted)]
        out = self.folder / kind
        shutil.rmtree(out, ignore_errors=True)
        heard = _Hears(tell)
        made = bake_jobs(Run(plan, heard, known=True), jobs, out)
        for each in made:
            if isinstance(each, NotBaked):
                raise each.error
        written = [each for each in made if isinstance(each, (BakedSet, BakedDocument))]
        self.results[kind] = self._packed(f"{chosen.name}{'' if kind == 'baked' else f'_{kind}'}", written)
        return heard, plan, written

    def _with(self, chosen: Job, wanted: Mapping[str, Any]) -> Job:
        """The job of a set, read as the user wants it; of a document, which says that itself, as it is."""
        load = LoadOptions(maps=wanted["maps"], normal_convention=wanted["convention"] or None)
        if chosen.document is not None or load == LoadOptions():
            return chosen
        same = [job for job in self._jobs(load, "chosen") if (job.source, job.name) == (chosen.source, chosen.name)]
        if not same:
            raise InputError(f"{chosen.name} cannot be read with these maps: choose others")
        return same[0]

    def _packed(self, name: str, written: Sequence[BakedSet | BakedDocument]) -> Result:
        """What is downloaded: the GLB of a document, or an archive of all files."""
        documents = [each.out for each in written if isinstance(each, BakedDocument)]
        if documents:
            size = documents[0].stat().st_size
            return Result(documents[0], f"{size / 1e6:.1f} MB")
        files = [file for each in written for file in each.files]
        place = self.folder / f"{name}.zip"
        with disk.reading(place), zipfile.ZipFile(place, "w", zipfile.ZIP_STORED) as archive:
            for file in files:
                archive.write(file.path, f"{name}/{file.path.name}")
        count = f"{len(files)} files, " if len(files) > 1 else ""
        return Result(place, f"{count}{sum(file.bytes for file in files) / 1e6:.1f} MB")


def _notes(written: Sequence[BakedSet | BakedDocument], engine: Preset | None) -> list[str]:
    """What a user of the page should know. What names options of the command line helps nobody there."""
    warnings = [line for each in written if isinstance(each, BakedSet) for line in each.warnings if "--" not in line]
    told = [f"In {engine.engine}: {note}" for note in engine.notes] if engine else []
    return [f"{line[:1].upper()}{line[1:]}." for line in dict.fromkeys([*warnings, *told])]


class _Hears(Listener):
    """Keeps the sets and their stacks, and tells the page what goes on."""

    def __init__(self, tell: Tell) -> None:
        self._tell = tell
        self._sets: dict[str, TextureSet] = {}
        self.made: dict[str, tuple[TextureSet, MipStack]] = {}

    @contextmanager
    def timings(self, label: str) -> Iterator[Timings]:
        """See Listener."""
        del label
        yield Timings(self._tell)

    def read(self, job: Job, sets: Sequence[TextureSet]) -> None:
        """See Listener."""
        self._sets[job.name] = sets[0]

    def baked(self, job: Job, stack: MipStack, result: BakedSet, timings: Timings) -> None:
        """See Listener."""
        del result, timings
        self.made[job.name] = (self._sets[job.name], stack)
