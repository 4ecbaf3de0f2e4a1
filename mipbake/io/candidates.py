"""Which file of a folder fills which role: candidates by name, preferences among them, and the user's choices."""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TypeAlias

from mipbake.errors import InputError, UsageError
from mipbake.io.names import Meaning, NameMatch, asset_words, classify
from mipbake.io.options import ROLES, SCALAR_ROLES, LoadOptions
from mipbake.io.read import IMAGE_SUFFIXES, Header, read_header
from mipbake.io.sources import IgnoredFile, Log, spoken

PathLike: TypeAlias = "str | os.PathLike[str]"


@dataclass(frozen=True)
class Candidate:
    """A file that could fill a role, what its name means for it, and why it is considered."""

    header: Header
    meaning: Meaning
    reason: str


def _safe_name(folder: Path) -> str:
    return re.sub(r"[^A-Za-z0-9._-]+", "_", folder.resolve().name).strip("._-") or "texture_set"


def list_files(path: PathLike | Iterable[PathLike]) -> tuple[str, Path, list[Path]]:
    """Name, folder and files of a set; the files of a `textures` folder inside where the folder itself has none."""
    if not isinstance(path, (str, os.PathLike)):
        files = list(dict.fromkeys(Path(p) for p in path))
        if not files:
            raise InputError("no files were given: expected the maps of one texture set")
        for file in files:
            if not file.is_file():
                raise InputError(f"{file} is not a file: expected the maps of one texture set")
        return _safe_name(files[0].parent), files[0].parent, files
    folder = Path(path)
    if not folder.exists():
        raise InputError(f"{folder} does not exist: expected a folder with the maps of one texture set")
    if not folder.is_dir():
        raise InputError(f"{folder} is a file: expected a folder with the maps of one texture set")
    files = _visible(folder)
    if not any(_is_map(f) for f in files):
        inner = [d for d in folder.iterdir() if d.is_dir() and d.name.lower() == "textures"]
        if inner:
            return _safe_name(folder), inner[0], _visible(inner[0])
    if not files:
        raise InputError(f"{folder} is empty: expected the maps of one texture set")
    return _safe_name(folder), folder, files


def _visible(folder: Path) -> list[Path]:
    try:
        return sorted(f for f in folder.iterdir() if f.is_file() and not f.name.startswith("."))
    except OSError as error:
        raise InputError(f"{folder} cannot be listed ({error.strerror}): check its permissions") from error


def _is_map(file: Path) -> bool:
    match = classify(file.stem)
    return file.suffix.lower() in IMAGE_SUFFIXES and match is not None and bool(match.meanings)


def classified(files: Sequence[Path]) -> tuple[dict[str, list[Candidate]], list[IgnoredFile]]:
    matches: dict[Path, NameMatch] = {}
    ignored = []
    for file in files:
        match = classify(file.stem)
        if file.suffix.lower() not in IMAGE_SUFFIXES:
            ignored.append(IgnoredFile(file, "not an image"))
        elif match is None:
            ignored.append(IgnoredFile(file, "its name says no role"))
        elif not match.meanings:
            ignored.append(IgnoredFile(file, f"{match.word} maps are not used"))
        else:
            matches[file] = match
    candidates: dict[str, list[Candidate]] = {}
    for file, match in matches.items():
        if any(asset_words(file.stem) == m.asset for f, m in matches.items() if f != file):
            ignored.append(IgnoredFile(file, "it has the name of the set itself: taken for a preview"))
            continue
        header = read_header(file)
        for meaning in match.meanings:
            if _has_channels(header, meaning):
                candidates.setdefault(meaning.role, []).append(Candidate(header, meaning, f"named {match.word}"))
    return candidates, ignored


def _has_channels(header: Header, meaning: Meaning) -> bool:
    """Whether a packed file has the channel; InputError when a file that must be packed is grey."""
    if meaning.channels == "A":
        return header.alpha >= 0
    if meaning.channels == "RGB":
        return True
    if meaning.channels and header.channels < 3 and meaning.channels != "R":
        raise InputError(
            f"{header.path} has {header.channels} channel{'s' if header.channels > 1 else ''}: its name says that "
            f"{meaning.role} is packed into channel {meaning.channels}; rename it or choose the maps by option"
        )
    return True


def files_of(candidates: Mapping[str, Sequence[Candidate]]) -> list[Path]:
    return list(dict.fromkeys(c.header.path for several in candidates.values() for c in several))


def choose(
    candidates: Mapping[str, Sequence[Candidate]], folder: Path, options: LoadOptions, log: Log
) -> dict[str, Candidate]:
    chosen = {}
    for role in ROLES:
        if role in options.maps:
            choice = options.maps[role]
            if isinstance(choice, (str, os.PathLike)):
                chosen[role] = _explicit(role, choice, folder)
        elif role in candidates:
            chosen[role] = _preferred(role, candidates[role], options, log)
    return chosen


def _explicit(role: str, choice: str | os.PathLike[str], folder: Path) -> Candidate:
    text = os.fspath(choice)
    file, channels = _existing(text, folder), ""
    if file is None and (match := re.fullmatch(r"(.+):([RGBA]{1,4})", text, re.IGNORECASE)):
        file, channels = _existing(match[1], folder), match[2].upper()
    if file is None:
        raise InputError(f"map {role} is {text!r}: no such file, neither in {folder} nor in the working directory")
    header = read_header(file)
    if channels:
        _check_channels(role, channels, header)
        return Candidate(header, Meaning(role, channels), "chosen by option")
    named = classify(file.stem)
    meanings = () if named is None else named.meanings
    meaning = next((m for m in meanings if m.role == role and _has_channels(header, m)), Meaning(role))
    return Candidate(header, meaning, "chosen by option")


def _existing(text: str, folder: Path) -> Path | None:
    return next((p for p in (folder / text, Path(text)) if p.is_file()), None)


def _check_channels(role: str, channels: str, header: Header) -> None:
    counts = (1,) if role in SCALAR_ROLES else (2, 3) if role == "normal" else (1, 3)
    if len(channels) not in counts:
        expected = " or ".join(str(c) for c in counts)
        raise UsageError(f"map {role} takes channels {channels}: expected {expected} of R, G, B and A")
    for c in channels:
        if (header.alpha < 0) if c == "A" else "RGB".index(c) >= header.channels:
            raise InputError(f"{header.path} has no channel {c}, which map {role} asks for")


def _preferred(role: str, several: Sequence[Candidate], options: LoadOptions, log: Log) -> Candidate:
    """The one candidate of the best rank; of a NormalGL and NormalDX pair the OpenGL one, or what the option says."""
    best = min(c.meaning.rank for c in several)
    first = [c for c in several if c.meaning.rank == best]
    if role == "normal" and len(first) == 2 and {c.meaning.convention for c in first} == {"opengl", "directx"}:
        wanted = options.normal_convention or "opengl"
        first = [c for c in first if c.meaning.convention == wanted]
        log.notes.append(f"both normal conventions are there: {spoken(wanted)} ({first[0].header.path.name}) is taken")
    elif len(first) == 1 and len(several) > 1:
        others = ", ".join(c.header.path.name for c in several if c is not first[0])
        log.notes.append(f"{role}: {first[0].header.path.name} is preferred to {others}")
    if len(first) > 1:
        names = " and ".join(c.header.path.name for c in first)
        raise InputError(
            f"{names} are both candidates for {role}: choose one with the option maps ({role}=FILE), or give each set "
            "its own folder"
        )
    return first[0]


def take_alpha_as_opacity(chosen: dict[str, Candidate], options: LoadOptions, log: Log) -> None:
    base = chosen.get("base_color")
    if base is None or "opacity" in chosen or "opacity" in options.maps or base.header.alpha < 0:
        return
    chosen["opacity"] = Candidate(base.header, Meaning("opacity", "A"), "alpha of the base colour")
    log.notes.append(f"opacity is the alpha channel of {base.header.path.name}")
