"""ZIP archives as sites hand out texture sets and scenes: checked, and unpacked into a temporary folder while they are
read.
"""

from __future__ import annotations

import errno
import lzma
import os
import shutil
import stat
import unicodedata
import zipfile
import zlib
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path, PurePosixPath, PureWindowsPath
from typing import TypeVar

from mipbake.base import disk
from mipbake.base.errors import InputError, MipbakeError, OutputError
from mipbake.base.safe_names import safe_name
from mipbake.source.images.read import IMAGE_SUFFIXES

SUFFIX = ".zip"

_T = TypeVar("_T")

GLTF, MATERIALX = (".gltf", ".glb"), ".mtlx"
"""Suffixes of documents, which are read with what lies beside them."""

MOST_FILES = 10_000
MOST_UNPACKED = 64 << 30
"""Bytes that an archive may have when it is unpacked."""

SURELY_FINE, RATIO = 1 << 30, 100
"""An archive that unpacks to more than `SURELY_FINE` bytes and to more than `RATIO` times its own is a bomb: images are
compressed already, and whole sets of constant maps are smaller."""

_CHUNK = 1 << 20  # bytes that are unpacked at a time, so that they stay in the cache

_DAMAGE = (
    *(zipfile.BadZipFile, zlib.error, lzma.LZMAError, EOFError, NotImplementedError, RuntimeError, ValueError),
    OSError,  # places before the beginning
)
"""What reading a damaged archive raises."""


@dataclass(eq=False)
class Shelf:
    """The archives of one run, below a folder. One of them at a time is unpacked, the one that was used last."""

    folder: Path
    unpacked: Path | None = None

    def archive(self, path: Path, place: str) -> Archive:
        """An archive that is unpacked, when it is used, into the folder `place`, which names its set as its file does.
        InputError as `_checked_members` has it."""
        members = tuple(_checked_members(path))
        return Archive(path, self.folder / place / safe_name(path.stem, "archive"), members, self)


@dataclass(frozen=True, eq=False)
class Archive:
    """An archive, where it is unpacked, and what of it is read."""

    path: Path
    folder: Path
    members: tuple[zipfile.ZipInfo, ...]
    shelf: Shelf

    def using(self, read: Callable[[], _T]) -> _T:
        """What is read while the archive is unpacked, in the place of the one before; errors name the archive in place
        of the folder."""
        shelf = self.shelf
        if shelf.unpacked != self.folder:
            if shelf.unpacked is not None:
                shutil.rmtree(shelf.unpacked, ignore_errors=True)
            shelf.unpacked = None
            _unpack(self.path, self.members, self.folder)
            shelf.unpacked = self.folder
        with self.naming():
            return read()

    @contextmanager
    def naming(self) -> Iterator[None]:
        """Errors of the block name the archive in place of the folder; those about a source name it in any case."""
        try:
            yield
        except MipbakeError as error:
            text = self.about(error)
            if text == error.full:
                raise
            raise type(error)(text) from error
        except OSError as error:
            if error.filename is None or (text := self.renamed(file := os.fsdecode(error.filename))) == file:
                raise
            raise disk.refused(Path(text), error) from error

    def about(self, error: MipbakeError) -> str:
        """The message of an error, as `naming` changes it."""
        text = self.renamed(error.full)
        return text if str(self.path) in text or not isinstance(error, InputError) else f"{self.path}: {text}"

    def renamed(self, text: str) -> str:
        """A text with the archive in place of the folder that it is unpacked to."""
        return text.replace(str(self.folder.resolve()), str(self.path)).replace(str(self.folder), str(self.path))


def _checked_members(path: Path) -> list[zipfile.ZipInfo]:
    """What of an archive is read; nothing is unpacked. InputError where it is not a ZIP archive, is encrypted, holds
    nothing to read or too much, or has a member that would lie elsewhere or is a link."""
    try:
        with zipfile.ZipFile(path) as opened:
            every = opened.infolist()
        size = path.stat().st_size
    except (zipfile.BadZipFile, EOFError, ValueError, NotImplementedError) as error:
        raise InputError(f"{path} is not a ZIP archive, or is damaged ({error}): download it again") from error
    except OSError as error:
        raise InputError(f"{path} cannot be read ({error.strerror}): check the file and its permissions") from error
    if len(every) > MOST_FILES:
        raise InputError(f"{path} holds {len(every)} files: expected a texture set, {MOST_FILES} files at most")
    for member in every:
        _check_place(path, member)
    found = _read_of(every)
    _check_apart(path, found)
    if not found:
        raise InputError(
            f"{path} holds neither an image nor a document: expected the maps of texture sets, or .gltf, .glb or .mtlx "
            "files with their textures"
        )
    if any(member.flag_bits & 1 for member in found):
        raise InputError(f"{path} is encrypted: unpack it and give the folder")
    unpacked = sum(member.file_size for member in found)
    if unpacked > MOST_UNPACKED or unpacked > max(SURELY_FINE, RATIO * size):
        raise InputError(
            f"{path} would grow from {size / 1e6:.1f} MB to {unpacked / 1e9:.1f} GB: no texture set grows so much, so "
            "it is not unpacked; if it is a texture set, unpack it yourself and give the folder"
        )
    return found


def _check_place(path: Path, member: zipfile.ZipInfo) -> None:
    """InputError where a member would lie elsewhere, by either of its names, or is a link.

    Newer versions of Python take `filename` from an extra field of the member, so that the name in its header tells
    nothing of it.
    """
    for given in dict.fromkeys((member.orig_filename, member.filename)):
        name = given.replace("\\", "/")
        parts = name.split("/")
        if name.startswith("/") or ".." in parts or "\0" in name or any(PureWindowsPath(part).drive for part in parts):
            raise InputError(f"{path} holds {given!r}, which would lie outside its folder: do not trust it")
    if stat.S_ISLNK(member.external_attr >> 16):
        raise InputError(f"{path} holds {member.filename!r}, which is a link: unpack it yourself and give the folder")


def _check_apart(path: Path, members: Sequence[zipfile.ZipInfo]) -> None:
    """InputError where two members would lie at one place, or one in another, on some file system.

    Some of them do not tell letters apart that differ in case, or in how Unicode composes them.
    """
    places = [PurePosixPath(unicodedata.normalize("NFC", str(_place(each)).casefold())) for each in members]
    taken = {folder for place in places for folder in place.parents}
    for member, place in zip(members, places, strict=True):
        if place in taken:
            raise InputError(f"{path} holds {member.filename!r} twice: unpack it yourself and give the folder")
        taken.add(place)


def _read_of(every: Sequence[zipfile.ZipInfo]) -> list[zipfile.ZipInfo]:
    """Images and documents; beside glTF documents all files, because their buffers and images have any name."""
    files = [member for member in every if not member.is_dir() and "__MACOSX" not in _place(member).parts]
    shown = [member for member in files if not any(part.startswith(".") for part in _place(member).parts)]
    if any(_place(member).suffix.lower() in GLTF for member in shown):
        return shown
    return [member for member in shown if _place(member).suffix.lower() in (*IMAGE_SUFFIXES, MATERIALX)]


def _place(member: zipfile.ZipInfo) -> PurePosixPath:
    """The place of a member in its archive; old programs of Windows wrote backslashes."""
    return PurePosixPath(member.filename.replace("\\", "/"))


def _unpack(path: Path, members: Sequence[zipfile.ZipInfo], folder: Path) -> None:
    """Writes members of an archive below a folder. InputError where one is damaged, or larger than the archive says;
    OutputError where there is no room."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        free = shutil.disk_usage(folder).free
        needed = sum(member.file_size for member in members)
        if needed > free:
            raise OutputError(
                f"{path} needs {needed / 1e9:.2f} GB of temporary space and {folder.parent} has {free / 1e9:.2f}: make "
                "room, or set the environment variable TMPDIR to a folder with enough space"
            )
        with zipfile.ZipFile(path) as opened:
            for member in members:
                _unpack_one(path, opened, member, folder)
    except BaseException:
        shutil.rmtree(folder, ignore_errors=True)
        raise


def _unpack_one(path: Path, opened: zipfile.ZipFile, member: zipfile.ZipInfo, folder: Path) -> None:
    place = folder.joinpath(*_place(member).parts)
    try:
        if not place.resolve().is_relative_to(folder.resolve()):  # whatever the system makes of its name
            raise InputError(f"{path} holds {member.filename!r}, which would lie outside its folder: do not trust it")
        place.parent.mkdir(parents=True, exist_ok=True)
        with place.open("xb") as file:
            file.writelines(_chunks(path, opened, member))
    except OSError as error:
        if error.errno == errno.ENAMETOOLONG:
            raise InputError(
                f"{path} holds {member.filename!r}, whose name is too long: unpack it yourself and give the folder"
            ) from error
        raise OutputError(
            f"{path}: {member.filename} cannot be unpacked to {folder.parent} ({error.strerror}): make room there, or "
            "set the environment variable TMPDIR to another folder"
        ) from error


def _chunks(path: Path, opened: zipfile.ZipFile, member: zipfile.ZipInfo) -> Iterator[bytes]:
    """The bytes of a member. InputError where it is damaged, or larger than the archive says."""
    left = member.file_size
    try:
        with opened.open(member) as packed:
            while chunk := packed.read(_CHUNK):
                left -= len(chunk)
                if left < 0:
                    raise InputError(f"{path}: {member.filename} is larger than it says: do not trust the archive")
                yield chunk
    except _DAMAGE as error:
        raise InputError(
            f"{path}: {member.filename} cannot be unpacked ({error}): download the archive again"
        ) from error
