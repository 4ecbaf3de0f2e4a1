"""Files of maps into a folder and back: what stacks and converted materials share."""

from __future__ import annotations

import json
import os
from abc import abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeAlias, overload

import numpy as np
from numpy.typing import NDArray

from mipbake.base import disk, memory
from mipbake.base.errors import InputError, OutputError
from mipbake.base.json_text import parsed
from mipbake.base.messages import listed
from mipbake.base.publish import IsOurs, check_room, is_companion, published
from mipbake.base.threads import on_threads
from mipbake.source.images.blocks import StoredLevel
from mipbake.source.layout import COLOUR, FLIPPED, INVERTED, SIGNED, FileChannel, FileLayout, from_file, to_file
from mipbake.source.options import CARRIED
from mipbake.stack.block_weights import BlockWeights
from mipbake.stack.container import Container, Texels

Levels: TypeAlias = list[NDArray[np.float32]]

CONVENTIONS = {
    "images": "top row first; texel (row i, column j) is centred at u = (j + 1/2) / width, v = (i + 1/2) / height",
    "tangent_space": "right-handed: +X along +u, +Y up in the image, +Z out of the surface",
}
"""What a manifest says of every map."""


@dataclass(frozen=True, eq=False)
class MapFile:
    """A file to be written, or one that was: how, what its channels are, and its levels, (H_L, W_L, channels) each,
    finest first. They may be views of a stack, or `GivenBack`. `weights`: what errors count, for containers that
    compress; None: all the same.
    """

    container: Container
    layout: FileLayout
    levels: Sequence[NDArray[np.float32]]
    weights: BlockWeights | None = None

    def __repr__(self) -> str:
        """A description in one line."""
        height, width, channels = self.levels[0].shape
        kind = f"{self.container.name}:{self.container.texels}"
        return f"MapFile({self.layout.name!r}, {kind}, {width} x {height} x {channels}, {len(self.levels)} levels)"


class MadeLevels(Sequence[NDArray[np.float32]]):
    """Levels that are made when they are read, because all of them together would be as large as what was baked."""

    @overload
    def __getitem__(self, index: int) -> NDArray[np.float32]: ...

    @overload
    def __getitem__(self, index: slice) -> list[NDArray[np.float32]]: ...

    def __getitem__(self, index: int | slice) -> NDArray[np.float32] | list[NDArray[np.float32]]:
        """The levels themselves."""
        if isinstance(index, slice):
            return [self._level(i) for i in range(*index.indices(len(self)))]
        return self._level(range(len(self))[index])

    @abstractmethod
    def _level(self, index: int) -> NDArray[np.float32]: ...


class GivenBack(MadeLevels):
    """What a file gives back.

    Args:
        count: of levels.
        texels: what the file stores at a level and an index of its rows and columns.
        squares: sum over all levels of the squared error of what it stores, where that is known.
    """

    def __init__(
        self,
        container: Container,
        layout: FileLayout,
        count: int,
        texels: Callable[[int, Any], NDArray[np.generic]],
        squares: float | None = None,
    ) -> None:
        self._container, self._layout, self._count, self._texels = container, layout, count, texels
        self.squares = squares

    def __len__(self) -> int:
        return self._count

    def _level(self, index: int) -> NDArray[np.float32]:
        texels = self._texels(index, ...)
        out = memory.empty(texels.shape)
        for block, part in zip(row_blocks(out), row_blocks(texels), strict=True):
            block[:] = self._meant(part)
        return out

    def at(self, index: int, rows: NDArray[np.int64], columns: NDArray[np.int64]) -> NDArray[np.float32]:
        """(..., channels) of the texels of a level that lie in (...) rows and columns."""
        return self._meant(self._texels(index, (rows, columns)))

    def _meant(self, texels: NDArray[np.generic]) -> NDArray[np.float32]:
        """What texels (..., channels) stand for."""
        srgb = self._container.srgb(self._layout)
        return from_file(self._container.dequantise(texels), self._layout.encodings, srgb)


def save_maps(
    place: Path, manifest_name: str, manifest: Mapping[str, Any], write: Callable[[Path], object], is_ours: IsOurs
) -> list[Path]:
    """Publishes a folder of maps with the manifest that describes them; gives its files, the manifest first.
    OutputError where it cannot be written, or holds anything else.

    Args:
        place: the folder; it appears when it is complete, in the place of an earlier one that `is_ours`.
        manifest: with `maps` or `outputs` as `described` gives them. write: from `write_files`.
    """
    with published(place, is_ours) as folder:
        write(folder)
        (folder / manifest_name).write_text(json.dumps(manifest, indent=2) + "\n", encoding="utf-8")
    return [place / manifest_name, *(place / name for name in listed_files(manifest))]


def write_files(
    files: Sequence[MapFile], wrap: tuple[str, str], about: str, progress: Callable[[float], None]
) -> Callable[[Path], list[MapFile | None]]:
    """What writes files into a folder, side by side, and reads every level back to compare. `about`: how they were
    made, as JSON, for containers that have a place for it.

    It returns the files as they were read back, in the same order; None for files of containers that are not exact. It
    raises UsageError for a value that a container cannot hold, OutputError for what cannot be written or does not read
    back.
    """

    def write_one(folder: Path, file: MapFile) -> MapFile | None:
        errors: list[float] = []
        quantised = [_quantised(level, file, errors.append) for level in file.levels]
        try:
            file.container.write(folder, file.layout, quantised, wrap, about, file.weights)
            _verify(folder, file, quantised)
        except InputError as error:
            name, first = file.layout.name, file.container.files(file.layout, len(quantised))[0]
            check_room(folder / first, sum(level.nbytes for level in quantised))
            raise OutputError(f"the map {name} did not read back after writing ({error}): check the disk") from error
        return replace(file, levels=_rounded(file, sum(errors))) if file.container.exact else None

    def write(folder: Path) -> list[MapFile | None]:
        # Libraries let go of the interpreter while they encode; more files at once than cores only hold more memory.
        return on_threads(lambda index: write_one(folder, files[index]), len(files), progress, os.cpu_count())

    return write


def read_files(container: Callable[[str], Container], folder: Path, entries: Mapping[str, Any]) -> list[MapFile]:
    """Every file that entries of a manifest describe, by containers of texels of a name. InputError when one is missing
    or broken; KeyError, TypeError or ValueError where an entry is not as `described` makes it."""
    files = []
    for name, entry in entries.items():
        if Path(name).name != name or name in ("", ".", ".."):
            raise ValueError(f"{name!r} is not the name of a file")
        channels = tuple(
            FileChannel(str(c["map"]), int(c["index"]), str(c["kind"]), str(c["meaning"])) for c in entry["channels"]
        )
        for channel in channels:
            if channel.map and not channel.map.isidentifier():
                raise ValueError(f"{channel.map!r} is not the name of a map")
        layout = FileLayout(name, channels, bool(entry["shades"]))
        stored = container(str(entry["texels"]))
        sizes = [(int(size["height"]), int(size["width"])) for size in entry["levels"]]
        files.append(MapFile(stored, layout, given_back(stored, layout, stored.read(folder, layout, sizes))))
    return files


def given_back(
    container: Container, layout: FileLayout, texels: Sequence[NDArray[np.generic] | StoredLevel]
) -> GivenBack:
    """What the texels stand for that were read from a file."""
    return GivenBack(container, layout, len(texels), lambda level, at: texels[level][at])


def _rounded(file: MapFile, squares: float) -> GivenBack:
    """What a file of an exact container was found to hold: its levels, rounded, which are not kept a second time."""
    return GivenBack(
        file.container,
        file.layout,
        len(file.levels),
        lambda level, at: _quantised(file.levels[level][at], file),
        squares,
    )


def described(files: Sequence[MapFile]) -> dict[str, Any]:
    """What a manifest says of files, by name: everything that a reader must know to sample them."""
    entries = {}
    for file in files:
        layout, container = file.layout, file.container
        srgb = container.srgb(layout)
        entries[layout.name] = {
            "files": container.files(layout, len(file.levels)),
            "shades": layout.shades,
            "texels": container.texels,
            "precision": container.precision(layout),
            "colour_space": ("sRGB" if srgb else "linear Rec.709") if layout.is_colour else "data",
            "channels": [
                {
                    "name": name,
                    "map": channel.map,
                    "index": channel.index,
                    "meaning": channel.meaning,
                    "kind": channel.encoding,
                    "encoding": _formula(channel.encoding, srgb),
                }
                for name, channel in zip(layout.channel_names, layout.channels, strict=True)
            ],
            "levels": [{"width": level.shape[1], "height": level.shape[0]} for level in file.levels],
        }
    return entries


def map_files(files: Sequence[MapFile]) -> dict[str, str]:
    """What a manifest says of maps: the file that holds each, or its level 0 where every level is a file."""
    return {
        channel.map: file.container.files(file.layout, len(file.levels))[0]
        for file in files
        for channel in file.layout.channels
        if channel.map and not channel.map.startswith(CARRIED)
    }


def normal_convention(files: Sequence[MapFile]) -> str:
    """What a manifest says of green in normal maps."""
    flipped = any(channel.encoding == FLIPPED for file in files for channel in file.layout.channels)
    return "DirectX" if flipped else "OpenGL"


def listed_files(manifest: Mapping[str, Any]) -> list[str]:
    """Names of the files that a manifest lists, of one output or of several."""
    outputs = manifest.get("outputs", [manifest])
    return [
        name
        for output in outputs
        for name in (*output.get("files", ()), *(n for entry in output["maps"].values() for n in entry["files"]))
    ]


def is_result_folder(path: Path, manifests: Sequence[Path], schema: str) -> bool:
    """Whether a folder holds manifests of that schema, one or more, files that they list, and nothing else but what
    engines and file managers put beside them."""
    try:
        known = {file.name for file in manifests}
        for file in manifests:
            manifest = parsed(disk.read_bytes(file))
            if manifest["schema"] != schema:
                return False
            known.update(listed_files(manifest))
        return bool(manifests) and all((p.name in known or is_companion(p)) and p.is_file() for p in path.iterdir())
    except (InputError, OSError, ValueError, KeyError, TypeError, AttributeError):
        return False


def check_same_sources(manifests: Sequence[Path], what: str, sources: Mapping[str, str]) -> None:
    """OutputError where an earlier result, by its manifests, shares no source file with `what` is to be written in its
    place. `sources`: source file name to SHA-256, empty where the file has not been read yet."""
    names: list[str] = []
    earlier: dict[str, str] = {}
    for file in manifests:
        manifest = parsed(disk.read_bytes(file))
        names.append(str(manifest.get("name")))
        provenance = manifest.get("provenance")
        found = provenance.get("sources") if isinstance(provenance, dict) else None
        earlier |= found if isinstance(found, dict) else {}
    # Somebody who edits one map and starts again means the same place; another set shares no file with this one.
    shared = [n for n in sources if n in earlier and sources[n] in ("", earlier[n])]
    if shared or not earlier or not sources:
        return
    place = manifests[0].parent
    raise OutputError(
        f"cannot write to {place}: it holds the {what} {listed(names)!r} of other source files ({listed(earlier)}) "
        f"than the files to be read now; choose another output folder, or remove it if it is no longer needed"
    )


def _formula(encoding: str, srgb: bool) -> str:
    """What a file holds of a value x."""
    if encoding == COLOUR:
        return "sRGB" if srgb else "linear"
    return {SIGNED: "(x + 1) / 2", FLIPPED: "(1 - x) / 2", INVERTED: "1 - x"}.get(encoding, "linear")


def quantised_levels(file: MapFile) -> list[NDArray[np.generic]]:
    """What a container stores of every level of a file; UsageError for a value that it cannot hold."""
    return [_quantised(level, file) for level in file.levels]


def row_blocks(level: NDArray[Any]) -> Iterator[NDArray[Any]]:
    """Views of some rows each, for what takes float64 on the way: a level of it would be the most that a bake holds."""
    return (level[rows] for rows in memory.some_rows(level))


def _quantised(
    level: NDArray[np.float32], file: MapFile, error: Callable[[float], None] | None = None
) -> NDArray[np.generic]:
    """What a container stores of one level of a file. `error`: gets sums of squared errors, of exact containers."""
    container, layout = file.container, file.layout
    srgb = container.srgb(layout)
    out: NDArray[np.generic] | None = None
    at = 0
    for block in row_blocks(level):
        values = to_file(block, layout.encodings, srgb)
        texels = container.quantise(values, layout)
        if out is None:
            out = memory.empty((len(level), *texels.shape[1:]), texels.dtype)
        out[at : at + len(texels)] = texels
        at += len(texels)
        if error is not None and container.exact:
            apart = np.subtract(values, container.dequantise(texels), out=values).ravel()
            error(float(np.einsum("i,i->", apart, apart)))  # a product of BLAS would start threads
    assert out is not None
    return out


def _verify(folder: Path, file: MapFile, levels: Texels) -> None:
    """Reads a file back and compares: writers are known to report success for files that are incomplete."""
    sizes = [(level.shape[0], level.shape[1]) for level in levels]
    for level, rows, texels in file.container.bands(folder, file.layout, sizes):
        if not np.array_equal(levels[level][rows], texels):
            name = file.layout.name
            raise OutputError(f"level {level} of the map {name} changed while it was written: check the disk")
