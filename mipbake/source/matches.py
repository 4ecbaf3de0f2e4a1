"""Which file of a folder fills which role: matches by name, preferences among them, and the user's choices."""

from __future__ import annotations

import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mipbake.base import disk
from mipbake.base.errors import InputError, UsageError
from mipbake.base.json_text import parsed
from mipbake.base.safe_names import safe_name
from mipbake.material import GLTF_MODELS
from mipbake.source.images.image import Header
from mipbake.source.images.read import IMAGE_SUFFIXES, read_header
from mipbake.source.layout import MATERIAL_MANIFEST, MATERIAL_SCHEMA, SCHEMA, manifests
from mipbake.source.names import Meaning, asset_words, classify, interpretations
from mipbake.source.options import CUSTOM, ROLES, SCALAR_ROLES, LoadOptions
from mipbake.source.sources import IgnoredFile, Log, spoken

OUTVOTED = "another file fills its roles"
NO_ROLE = "its name says no role"
PREVIEW = "it has the name of the set itself: taken for a preview"
BASE_ALPHA = "alpha of the base colour"
_REASONS = {"option": "chosen by option", "document": "the document says so"}


@dataclass(frozen=True)
class Match:
    """A file that may fill a role, what its name means for it, and why it is considered."""

    header: Header
    meaning: Meaning
    reason: str


def name_of(folder: Path) -> str:
    """The name of a set: the name of its folder, or of the folder around a `textures` folder; nothing is read."""
    resolved = disk.resolved(folder)
    name = resolved.parent.name if is_textures(resolved) else ""
    return safe_name(name or resolved.name, "texture_set")


def files_of_folder(folder: Path) -> list[Path]:
    """The files of a folder, or of the `textures` folder inside where there is no map in the folder itself."""
    files = disk.files_in(folder)
    if any(is_map(file) for file in files):
        return files
    inner = next((each for each in disk.folders_in(folder) if is_textures(each)), None)
    return files if inner is None else files_of_folder(inner)


def refuse_baked(folder: Path) -> None:
    """InputError for a stack, whose maps are filtered already, and for a material in a model that sets are not in."""
    if any(_manifest(file, SCHEMA) is not None for file in manifests(folder)):
        raise InputError(f"{folder} is a baked stack: expected a texture set, give its source")
    converted = _manifest(folder / MATERIAL_MANIFEST, MATERIAL_SCHEMA)
    if converted is not None and converted.get("model") not in GLTF_MODELS:
        raise InputError(
            f"{folder} is a material converted to {converted.get('model')}: expected a texture set, give its source "
            "or convert it to gltf first"
        )


def _manifest(file: Path, schema: str) -> dict[str, Any] | None:
    """A manifest of that schema; None where the file is not one."""
    try:
        manifest = parsed(disk.read_bytes(file))
    except (InputError, ValueError):
        return None
    return manifest if isinstance(manifest, dict) and manifest.get("schema") == schema else None


def is_map(file: Path) -> bool:
    """Whether a file is an image whose name tells a role that is read."""
    return file.suffix.lower() in IMAGE_SUFFIXES and any(m.meanings for m in interpretations(file.stem))


def is_textures(folder: Path) -> bool:
    """Whether the name of a folder says that its maps belong to the folder around it."""
    return folder.name.lower() == "textures"


def classified(files: Sequence[Path], options: LoadOptions) -> tuple[dict[str, list[Match]], list[IgnoredFile]]:
    """Matches for every role except the roles that options decide, and the files that match no role."""
    matches: dict[str, list[Match]] = {}
    images = [f for f in files if f.suffix.lower() in IMAGE_SUFFIXES]
    names = dict(zip(images, classify([f.stem for f in images]), strict=True))
    assets = {name.asset for name in names.values() if name and name.meanings and name.asset}
    ignored = []
    for file in files:
        name = names.get(file)
        meanings = [] if name is None else [m for m in name.meanings if m.role not in options.maps]
        if file not in names:
            ignored.append(IgnoredFile(file, "not an image"))
        elif name is None:
            own = asset_words(file.stem)
            preview = bool(own) and any(asset.startswith(own) for asset in assets)
            ignored.append(IgnoredFile(file, PREVIEW if preview else NO_ROLE))
        elif not name.meanings:
            ignored.append(IgnoredFile(file, f"{name.word} maps are not used"))
        elif any(m and m.meanings and m.asset == asset_words(file.stem) for f, m in names.items() if f != file):
            ignored.append(IgnoredFile(file, PREVIEW))
        elif not meanings:
            ignored.append(IgnoredFile(file, OUTVOTED))
        else:
            for meaning in meanings:
                header = read_header(file, meaning.role, options.metadata)
                match = Match(header, meaning, f"named {name.word}")
                if _has_channels(header, meaning):
                    matches.setdefault(meaning.role, []).append(match)
                elif meaning.channels != "A":
                    raise InputError(
                        f"{file} is grey, but its name ({name.word}) says that channel {meaning.channels} holds "
                        f"{meaning.role}: rename it or choose the maps by option"
                    )
    return matches, ignored


def _has_channels(header: Header, meaning: Meaning) -> bool:
    """Whether a file has the channel that a packed map's name promises."""
    if meaning.channels == "A":
        return header.alpha >= 0
    return meaning.channels in ("", "R", "RGB") or header.channels >= 3


def choose(matches: Mapping[str, Sequence[Match]], folder: Path, options: LoadOptions, log: Log) -> dict[str, Match]:
    """Role to the file that fills it: the user's choice, else the best match; opacity may be the alpha of the base
    colour."""
    chosen: dict[str, Match] = {}
    for role in ROLES:
        if role in options.maps:
            choice = options.maps[role]
            if isinstance(choice, (str, os.PathLike)):
                chosen[role] = explicit(role, choice, folder, options)
        elif role in matches:
            chosen[role] = _preferred(role, matches[role], options, log)
    base = chosen.get("base_color")
    has_opacity = base is not None and base.header.alpha >= 0 and base.header.declared.alpha != CUSTOM
    if base is not None and has_opacity and "opacity" not in (*chosen, *options.maps):
        chosen["opacity"] = Match(base.header, Meaning("opacity", "A"), BASE_ALPHA)
        log.notes.append(alpha_note(base.header.path))
    return chosen


def explicit(role: str, choice: str | os.PathLike[str], folder: Path, options: LoadOptions) -> Match:
    """The file that a user or a document chose for a role."""
    reason = _REASONS[options.origin]
    text = os.fspath(choice)
    file, channels = _existing(text, folder), ""
    if file is None and (match := re.fullmatch(r"(.+):([RGBA]{1,4})", text, re.IGNORECASE)):
        file, channels = _existing(match[1], folder), match[2].upper()
    if file is None:
        raise InputError(f"map {role} is {text!r}: no such file, neither in {folder} nor in the working directory")
    header = read_header(file, role, options.metadata)
    if channels:
        _check_channels(role, channels, header)
        return Match(header, Meaning(role, channels), reason)
    meanings = [m for name in interpretations(file.stem) for m in name.meanings]
    meaning = next((m for m in meanings if m.role == role and _has_channels(header, m)), Meaning(role))
    return Match(header, meaning, reason)


def _existing(text: str, folder: Path) -> Path | None:
    return next((p for p in (folder / text, Path(text)) if disk.is_file(p)), None)


def _check_channels(role: str, channels: str, header: Header) -> None:
    counts = (1,) if role in SCALAR_ROLES else (2, 3) if role == "normal" else (1, 3)
    if len(channels) not in counts:
        expected = " or ".join(str(c) for c in counts)
        raise UsageError(f"map {role} takes channels {channels}: expected {expected} of R, G, B and A")
    if role == "normal" and channels == "RG" and header.channels == 2:
        return  # PNG calls any second channel alpha
    for c in channels:
        index = header.alpha if c == "A" else "RGB".index(c)
        if not 0 <= index < header.channels or (c != "A" and index == header.alpha):
            there = "R and A" if (header.channels, header.alpha) == (2, 1) else "RGBA"[: header.channels]
            raise InputError(f"{header.path} has no channel {c}, which map {role} asks for: expected one of {there}")


def _preferred(role: str, several: Sequence[Match], options: LoadOptions, log: Log) -> Match:
    """The one match of the best rank; of NormalGL and NormalDX the OpenGL map, or what the option says; of variants the
    first."""
    best = min(c.meaning.rank for c in several)
    first = [c for c in several if c.meaning.rank == best]
    paired = role == "normal" and len(first) == 2 and {c.meaning.convention for c in first} == {"opengl", "directx"}
    if paired:
        wanted = options.normal_convention or "opengl"
        first = [c for c in first if c.meaning.convention == wanted]
        log.notes.append(f"both normal conventions are there: {spoken(wanted)} ({first[0].header.path.name}) is taken")
    variants = [c.meaning.variant for c in first]
    if len(first) > 1 and len(set(variants)) > 1:
        first = [c for c in first if c.meaning.variant == min(variants)]
    if len(first) == 1 and len(several) > 1 and not paired:
        others = ", ".join(c.header.path.name for c in several if c is not first[0])
        log.notes.append(f"{role}: {first[0].header.path.name} is preferred to {others}")
    if len(first) > 1:
        names = " and ".join(c.header.path.name for c in first)
        raise InputError(
            f"{names} all match {role}: choose one with --map {role}=FILE (maps in Python), or give each set its own "
            "folder"
        )
    return first[0]


def alpha_note(path: Path) -> str:
    """What is said of opacity that is the alpha of the base colour, until it is known that it hides something."""
    return f"opacity is the alpha channel of {path.name}"
