"""How levels reach a program and frames come back: raw numbers that both sides map into memory, or EXR files."""

from __future__ import annotations

import math
import mmap
import os
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from mipbake.base.errors import OutputError, RendererError
from mipbake.base.messages import told_by
from mipbake.base.publish import reason
from mipbake.fitting.renderer import Array, Frame, Levels, Rectangle
from mipbake.source.images.image_files import write_image

_ALIGNED = 64
"""Bytes that every array begins at a multiple of: a line of a processor's cache."""

_AXES = {"image": 3, "uv": 2, "lod": 1, "uv_da": 4, "id": 1}
"""Arrays of a frame, with the numbers of each pixel."""

_EXR_NAMES = {
    "image": ("R", "G", "B"),
    "uv": ("u", "v"),
    "lod": ("lod",),
    "uv_da": ("du.dX", "du.dY", "dv.dX", "dv.dY"),
    "id": ("id",),
}

_PRECISE = {channel for name, each in _EXR_NAMES.items() if name != "image" for channel in each}

_LETTERS = "RGBA"


class Exchange(Protocol):
    """One of both exchanges, at work in a folder that is there.

    What is written raises OutputError where there is no room. What is read raises RendererError.
    """

    def give(self, levels: Levels) -> dict[str, Any]:
        """Writes the levels that the program has not got, and returns what it is told of all of them."""

    def frame_file(self, number: int) -> Path:
        """The file that the program is to make for a frame, which is not there."""

    def take(self, answer: Mapping[str, Any], file: Path) -> Frame:
        """The frame that an answer tells of; its file is removed."""

    def close(self) -> None:
        """Lets go of the files, and leaves their removal to others. Twice is once."""


class _Given:
    """Which texels a program has got."""

    def __init__(self) -> None:
        self.number = 0
        self._layout: object = None
        self._stamps: tuple[NDArray[np.int64], ...] | None = None

    def changed(self, levels: Levels) -> list[list[Rectangle]]:
        """Texels of each level that are others than before. `number` grows where the maps or their sizes are others."""
        shapes = {name: [level.shape for level in each] for name, each in levels.maps.items()}
        layout = (levels.model, tuple(levels.wrap), shapes)
        if layout != self._layout:
            self._layout, self._stamps, self.number = layout, None, self.number + 1
        changed, self._stamps = levels.changed(self._stamps), levels.stamps
        return changed


class MemoryExchange:
    """Arrays of little-endian float32, rows from the top, one after the other in a file.

    Args:
        folder: where the files lie; best in memory.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._given = _Given()
        self._file: Path | None = None
        self._map: mmap.mmap | None = None

    def give(self, levels: Levels) -> dict[str, Any]:
        """See Exchange."""
        before = self._given.number
        changed = self._given.changed(levels)
        places, size = _places(levels)
        if self._given.number != before:
            self.close()
            self._file = self._folder / f"maps-{self._given.number}.f32"
            self._map = _mapped(self._file, size)
        assert self._file is not None and self._map is not None
        for index, parts in enumerate(changed):
            for name, maps in levels.maps.items() if parts else ():
                values = maps[index]
                out = np.frombuffer(self._map, "<f4", values.size, places[index][name]).reshape(values.shape)
                for part in parts:
                    np.copyto(part.of(out), part.of(values), casting="same_kind")
                del out  # else the file could not be let go of
        told = [
            {name: {"offset": at, "shape": list(levels.maps[name][index].shape)} for name, at in each.items()}
            for index, each in enumerate(places)
        ]
        about = [{"maps": each} for each in told]
        return _told(levels, changed, about) | {"file": str(self._file)}

    def frame_file(self, number: int) -> Path:
        """See Exchange."""
        return self._folder / f"frame-{number}.f32"

    def take(self, answer: Mapping[str, Any], file: Path) -> Frame:
        """See Exchange."""
        arrays = answer.get("arrays")
        if not isinstance(arrays, dict):
            raise RendererError('the renderer did not say what its frame holds: expected an object "arrays"')
        _check_shown(arrays, file)
        try:
            with file.open("rb") as opened:
                size = os.fstat(opened.fileno()).st_size
                found = {
                    name: _array(name, arrays[name], opened, size) for name in _AXES if arrays.get(name) is not None
                }
        except OSError as error:
            raise _missing(file, error) from error
        finally:
            with suppress(OSError):
                file.unlink()
        return _frame(found)

    def close(self) -> None:
        """See Exchange."""
        if self._map is not None:
            with suppress(BufferError):  # an error still holds what it was about to write; it goes with that
                self._map.close()
            self._map = None
        if self._file is not None:
            with suppress(OSError):  # a program may still hold it, where systems mind that
                self._file.unlink()
            self._file = None


class ExrExchange:
    """EXR files of one part: a level each with channels of 32 bits, and a frame.

    Args:
        folder: where the files lie.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._given = _Given()

    def give(self, levels: Levels) -> dict[str, Any]:
        """See Exchange."""
        changed = self._given.changed(levels)
        names = {name: [f"{name}.{_LETTERS[i]}" for i in range(maps[0].shape[2])] for name, maps in levels.maps.items()}
        channels = [channel for each in names.values() for channel in each]
        about = []
        for index, parts in enumerate(changed):
            file = self._folder / f"level-{index}.exr"
            if parts:
                texels = np.concatenate([maps[index] for maps in levels.maps.values()], -1, dtype=np.float32)
                _write_exr(file, texels, channels)
            about.append({"file": str(file), "maps": names})
        return _told(levels, changed, about)

    def frame_file(self, number: int) -> Path:
        """See Exchange."""
        return self._folder / f"frame-{number}.exr"

    def take(self, answer: Mapping[str, Any], file: Path) -> Frame:
        """See Exchange."""
        del answer
        try:
            found = _read_exr(file)
        finally:
            with suppress(OSError):
                file.unlink()
        return _frame(found)

    def close(self) -> None:
        """See Exchange."""


EXCHANGES: Mapping[str, Callable[[Path], Exchange]] = {"memory": MemoryExchange, "exr": ExrExchange}
"""Exchanges by name; each takes a folder."""


def bytes_of(levels: Levels) -> int:
    """Bytes that the levels take as 32-bit numbers."""
    return _places(levels)[1]


def _places(levels: Levels) -> tuple[list[dict[str, int]], int]:
    """The byte at which each map of each level begins, and the bytes of all together."""
    at, places = 0, list[dict[str, int]]()
    for index in range(len(levels.stamps)):
        places.append({})
        for name, maps in levels.maps.items():
            places[-1][name] = at
            at += -(-4 * maps[index].size // _ALIGNED) * _ALIGNED
    return places, at


def _told(levels: Levels, changed: list[list[Rectangle]], about: list[dict[str, Any]]) -> dict[str, Any]:
    """What both exchanges tell of levels, with what one of them tells of each level."""
    stack = [
        {
            "size": [int(height), int(width)],
            "stamp": int(stamps.max()),  # stamps only grow, so the largest one is another where any one is
            "changed": bool(parts),
            "changed_texels": [list(part) for part in parts],
            **each,
        }
        for (height, width), stamps, parts, each in zip(levels.sizes, levels.stamps, changed, about, strict=True)
    ]
    return {"model": levels.model, "wrap": list(levels.wrap), "stack": stack}


def _mapped(file: Path, size: int) -> mmap.mmap:
    """A new file of zeros, mapped into memory, which takes its room on the disk at once: a page that finds none later
    would end the process."""
    try:
        with file.open("w+b") as opened:
            if hasattr(os, "posix_fallocate"):
                os.posix_fallocate(opened.fileno(), 0, size)
            else:
                opened.write(bytes(size))
                opened.flush()
            return mmap.mmap(opened.fileno(), size)
    except OSError as error:
        raise OutputError(f"cannot hand levels to the renderer in {file}: {reason(error)}") from error


def _array(name: str, about: Any, opened: Any, size: int) -> Array:
    """An array of a frame, from an open file of so many bytes."""
    shape, at = (about.get("shape"), about.get("offset")) if isinstance(about, dict) else (None, None)
    if not isinstance(shape, list) or not shape or not isinstance(at, int) or not _are_counts([*shape, at]):
        raise RendererError(
            f"the renderer gave the array {name} of its frame as {about!r}: expected an offset in bytes and a shape"
        )
    count = math.prod(shape)
    if at + 4 * count > size:
        raise RendererError(
            f"the frame that the renderer wrote is cut short: expected {4 * count} bytes of {name} from byte {at} on, "
            f"found a file of {size} bytes"
        )
    opened.seek(at)
    values = np.fromfile(opened, "<f4", count).astype(np.float32, copy=False)
    if values.size != count:
        raise RendererError(
            f"the frame that the renderer wrote was cut short while {name} was read: expected the whole file"
        )
    if len(shape) == 3 and shape[2] == 1 and _AXES[name] == 1:
        shape = shape[:2]
    return values.reshape(shape)


def _are_counts(numbers: list[Any]) -> bool:
    return all(type(number) is int and number >= 0 for number in numbers)


def _write_exr(file: Path, texels: Array, channels: list[str]) -> None:
    import OpenImageIO

    spec = OpenImageIO.ImageSpec(texels.shape[1], texels.shape[0], texels.shape[2], "float")
    spec.channelnames = channels
    spec.alpha_channel = -1
    spec.attribute("compression", "none")  # a file is read once
    try:
        write_image(file, [(spec, texels)])
    except OSError as error:
        raise OutputError(f"cannot hand levels to the renderer in {file}: {reason(error)}") from error


def _read_exr(file: Path) -> dict[str, Array]:
    import OpenImageIO

    try:
        file.stat()
    except OSError as error:
        raise _missing(file, error) from error
    image = OpenImageIO.ImageInput.open(str(file))
    if image is None:
        why = told_by(OpenImageIO.geterror)
        raise RendererError(f"the frame {file.name} cannot be read ({why}): expected a whole EXR file")
    try:
        spec = image.spec()
        names = list(spec.channelnames)
        _check_shown([name for name, each in _EXR_NAMES.items() if set(each) <= set(names)], file)
        types = [str(spec.channelformat(index)) for index in range(len(names))]
        for channel, kind in zip(names, types, strict=True):
            if channel in _PRECISE and kind == "half":
                raise RendererError(
                    f"the channel {channel} of the renderer's frame has 16 bits, which are too coarse for it: expected "
                    "32 bits (float)"
                )
        columns = {}
        # Channels of one type at once. Integers as what they are: as others they would become numbers from 0 to 1.
        for kind in ("uint", "float"):
            alike = [index for index, each in enumerate(types) if (each == "uint") == (kind == "uint")]
            for first, last in _runs(alike):
                values = image.read_image(0, 0, first, last + 1, kind)
                if values is None or image.has_error:
                    why = told_by(image.geterror)
                    raise RendererError(
                        f"the frame {file.name} is damaged or cut short ({why}): expected a whole EXR file"
                    )
                texels = np.asarray(values).reshape(spec.height, spec.width, -1).astype(np.float32, copy=False)
                columns.update({names[index]: texels[..., index - first] for index in range(first, last + 1)})
    finally:
        image.close()
    found = {}
    for name, channels in _EXR_NAMES.items():
        if all(channel in columns for channel in channels):
            stacked = np.stack([columns[channel] for channel in channels], -1)
            found[name] = stacked[..., 0] if _AXES[name] == 1 else stacked
    return found


def _runs(indices: list[int]) -> list[tuple[int, int]]:
    """First and last of each run of neighbours."""
    firsts = [index for index in indices if index - 1 not in indices]
    lasts = [index for index in indices if index + 1 not in indices]
    return list(zip(firsts, lasts, strict=True))


def _check_shown(names: Iterable[str], file: Path) -> None:
    """What else a frame lacks is for others to say, because a part of a fit needs the image alone."""
    if "image" not in names:
        wanted = "channels R, G and B" if file.suffix == ".exr" else "array image"
        raise RendererError(f"the frame {file.name} of the renderer shows nothing: expected the {wanted}")


def _missing(file: Path, error: OSError) -> RendererError:
    return RendererError(
        f"the frame of the renderer cannot be read ({error.strerror or error}): expected the file {file}, complete "
        "before the answer"
    )


def _frame(found: Mapping[str, Array]) -> Frame:
    number: NDArray[Any] | None = found.get("id")
    if number is not None:
        rounded = np.rint(number)
        if not (np.isfinite(number).all() and (rounded == number).all()):
            raise RendererError(
                "the frame of the renderer has an id that is no integer: expected whole numbers, so render ids without "
                "anti-aliasing"
            )
        number = rounded.astype(np.int32)
    return Frame(found["image"], found.get("uv"), found.get("lod"), found.get("uv_da"), number)
