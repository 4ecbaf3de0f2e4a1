"""Which file fills which role of a texture set, and why: names, options and headers, without reading pixels."""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from mipbake.errors import InputError, UsageError
from mipbake.io.colour import canonical_colour_space, default_colour_space
from mipbake.io.names import Meaning, NameMatch, asset_words, classify
from mipbake.io.normal import DECIDED_CONFIDENCE, Integrability, Vectors, decode_normals, integrability
from mipbake.io.options import COLOUR_ROLES, ROLES, SCALAR_ROLES, SHADING_ROLES, LoadOptions
from mipbake.io.read import IMAGE_SUFFIXES, Header, Image, read_header, read_image

PathLike: TypeAlias = "str | os.PathLike[str]"

DATA = "data"
"""Encoding of maps whose values are no colours: stored linearly."""

_CONSTANTS: Mapping[str, tuple[float, ...]] = {
    "base_color": (0.5, 0.5, 0.5),
    "normal": (0.0, 0.0, 1.0),
    "metallic": (0.0,),
}


@dataclass(frozen=True)
class MapSource:
    """Where the values of one role come from.

    Args:
        role: see `mipbake.io.options.ROLES`.
        path: the file; None for a constant or for an array given from Python.
        channels: letters of the file's channels that are taken ("RGB", "G", "Y" for grey); empty without a file.
        width, height: size of the source in texels; 1 x 1 for a constant.
        depth: stored type of the file ("uint8", "uint16", "half", "float"); "float" without a file.
        encoding: colour space of the source for colours, "data" for everything else.
        inverted: the source stores one minus the value.
        reason: why this source fills the role.
        constant: the value, in linear units, where there is no file.
        convention: "opengl" or "directx" where a normal map's name says so.
        sha256: of the file, in hexadecimal; empty until it has been read.
        notes: what was found while reading, in sentences.
    """

    role: str
    path: Path | None
    channels: str
    width: int
    height: int
    depth: str
    encoding: str
    inverted: bool
    reason: str
    constant: tuple[float, ...] | None = None
    convention: str | None = None
    sha256: str = ""
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class NormalConvention:
    """Convention of the source's normal map: "opengl" (green up) or "directx" (green down).

    `decided_by` is "option", "name", "pixels" (the integrability test), "assumed" (the test could not tell) or "flat"
    (there is nothing to tell); `confidence` is that of the test, and 1 where no test was needed.
    """

    name: str
    decided_by: str
    confidence: float


@dataclass(frozen=True)
class IgnoredFile:
    """A file that fills no role, and why."""

    path: Path
    reason: str


@dataclass(frozen=True)
class Discovery:
    """What a texture set is made of.

    Args:
        name: of the set, safe as a folder name.
        sources: role to source, in the order of `ROLES`; always holds base_color, normal, roughness and metallic.
        width, height: common size of the maps that shade.
        convention: of the normal map.
        ignored: files that fill no role.
        notes: what was found and assumed, in sentences.
        warnings: what the user should look at, in sentences.
        options: the choices it was made with.
    """

    name: str
    sources: Mapping[str, MapSource]
    width: int
    height: int
    convention: NormalConvention
    ignored: tuple[IgnoredFile, ...]
    notes: tuple[str, ...]
    warnings: tuple[str, ...]
    options: LoadOptions

    @property
    def anisotropic(self) -> bool:
        """Whether there is an anisotropy map."""
        return "anisotropy" in self.sources


@dataclass(frozen=True)
class _Candidate:
    header: Header
    meaning: Meaning
    reason: str


def discover(path: PathLike | Iterable[PathLike], options: LoadOptions | None = None) -> Discovery:
    """What `load` would read, from names and headers; the normal map's pixels only where its name is silent.

    Args:
        path: a folder, or the files of one set.
        options: choices that override what names say.

    Raises:
        InputError: there is no usable set. UsageError: an option names what does not exist.
    """
    found = find(path, options or LoadOptions())
    source = found.sources["normal"]
    if source.path is None or found.convention.decided_by in ("option", "name"):
        return found
    stored = taken(source, read_image(source.path))
    return settle_convention(found, decode_normals(stored, source.path).vectors)


def settle_convention(found: Discovery, vectors: Vectors) -> Discovery:
    """The discovery with its normal convention checked against, or decided by, unit normals (H, W, 3) as stored."""
    source, convention = found.sources["normal"], found.convention
    if source.path is None:
        return found
    test: Integrability = integrability(vectors)
    label = source.path.name
    if convention.decided_by in ("option", "name"):
        if test.decided and test.convention != convention.name:
            origin = "its name says" if convention.decided_by == "name" else "the option says"
            warning = (
                f"{label}: {origin} {_spoken(convention.name)}, but the curl of its slopes looks like "
                f"{_spoken(test.convention)} (confidence {test.confidence:.2f})"
            )
            return replace(found, warnings=(*found.warnings, warning))
        return found
    if test.decided:
        note = f"{label}: {_spoken(test.convention)} by the curl of its slopes (confidence {test.confidence:.2f})"
        settled = NormalConvention(test.convention, "pixels", test.confidence)
        return replace(found, convention=settled, notes=(*found.notes, note))
    warning = (
        f"{label}: neither its name nor the curl of its slopes (confidence {test.confidence:.2f}, {DECIDED_CONFIDENCE} "
        "needed) tells OpenGL from DirectX; OpenGL is assumed, set the normal convention if that is wrong"
    )
    settled = NormalConvention("opengl", "assumed", test.confidence)
    return replace(found, convention=settled, warnings=(*found.warnings, warning))


def find(path: PathLike | Iterable[PathLike], options: LoadOptions) -> Discovery:
    """`discover` without looking at pixels: a convention that no name tells stays assumed, with confidence 0."""
    name, folder, files = _list(path)
    candidates, ignored = _classified(files)
    log = _Log([], [])
    chosen = _chosen(candidates, folder, options, log)
    _take_alpha_as_opacity(chosen, options, log)
    colour_space = None if options.colour_space is None else canonical_colour_space(options.colour_space)
    sources = {role: _source(c, colour_space, options, log) for role, c in chosen.items()}
    sources |= {r: _constant(r, (float(v),)) for r, v in options.maps.items() if isinstance(v, (int, float))}
    _check_complete(sources, options, folder, candidates, ignored)
    for role, value in _CONSTANTS.items():
        if role not in sources:
            sources[role] = _constant(role, value)
            spoken = ", ".join(f"{v:g}" for v in value)
            log.notes.append(f"no {_spoken(role)} map: the constant {spoken} is used")
    used = {s.path for s in sources.values()}
    ignored += [IgnoredFile(p, "another file fills its roles") for p in _files_of(candidates) if p not in used]
    width, height = _common_size([s for r, s in sources.items() if r in SHADING_ROLES], log)
    return Discovery(
        name,
        {r: sources[r] for r in ROLES if r in sources},
        width,
        height,
        _named_convention(sources["normal"], options, log),
        tuple(sorted(ignored, key=lambda i: i.path.name)),
        tuple(log.notes),
        tuple(log.warnings),
        options,
    )


def taken(source: MapSource, image: Image) -> NDArray[np.generic]:
    """The channels of a file's image that a source takes, (H, W, len(channels)), as stored."""
    index = [image.header.alpha if c == "A" else 0 if c == "Y" else "RGB".index(c) for c in source.channels]
    first, count = index[0], len(index)
    contiguous = index == list(range(first, first + count))
    return image.pixels[..., first : first + count] if contiguous else image.pixels[..., index]


@dataclass(frozen=True)
class _Log:
    notes: list[str]
    warnings: list[str]


def _spoken(word: str) -> str:
    return {"opengl": "OpenGL", "directx": "DirectX", "base_color": "base colour"}.get(word, word)


def _safe_name(folder: Path) -> str:
    return re.sub(r"[^A-Za-z0-9._-]+", "_", folder.resolve().name).strip("._-") or "texture_set"


def _list(path: PathLike | Iterable[PathLike]) -> tuple[str, Path, list[Path]]:
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


def _classified(files: Sequence[Path]) -> tuple[dict[str, list[_Candidate]], list[IgnoredFile]]:
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
    candidates: dict[str, list[_Candidate]] = {}
    for file, match in matches.items():
        if any(asset_words(file.stem) == m.asset for f, m in matches.items() if f != file):
            ignored.append(IgnoredFile(file, "it has the name of the set itself: taken for a preview"))
            continue
        header = read_header(file)
        for meaning in match.meanings:
            if _has_channels(header, meaning):
                candidates.setdefault(meaning.role, []).append(_Candidate(header, meaning, f"named {match.word}"))
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


def _files_of(candidates: Mapping[str, Sequence[_Candidate]]) -> list[Path]:
    return list(dict.fromkeys(c.header.path for several in candidates.values() for c in several))


def _chosen(
    candidates: Mapping[str, Sequence[_Candidate]], folder: Path, options: LoadOptions, log: _Log
) -> dict[str, _Candidate]:
    chosen = {}
    for role in ROLES:
        if role in options.maps:
            choice = options.maps[role]
            if isinstance(choice, (str, os.PathLike)):
                chosen[role] = _explicit(role, choice, folder)
        elif role in candidates:
            chosen[role] = _preferred(role, candidates[role], options, log)
    return chosen


def _explicit(role: str, choice: str | os.PathLike[str], folder: Path) -> _Candidate:
    text = os.fspath(choice)
    file, channels = _existing(text, folder), ""
    if file is None and (match := re.fullmatch(r"(.+):([RGBA]{1,4})", text, re.IGNORECASE)):
        file, channels = _existing(match[1], folder), match[2].upper()
    if file is None:
        raise InputError(f"map {role} is {text!r}: no such file, neither in {folder} nor in the working directory")
    header = read_header(file)
    if channels:
        _check_channels(role, channels, header)
        return _Candidate(header, Meaning(role, channels), "chosen by option")
    named = classify(file.stem)
    meanings = () if named is None else named.meanings
    meaning = next((m for m in meanings if m.role == role and _has_channels(header, m)), Meaning(role))
    return _Candidate(header, meaning, "chosen by option")


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


def _preferred(role: str, several: Sequence[_Candidate], options: LoadOptions, log: _Log) -> _Candidate:
    """The one candidate of the best rank; of a NormalGL and NormalDX pair the OpenGL one, or what the option says."""
    best = min(c.meaning.rank for c in several)
    first = [c for c in several if c.meaning.rank == best]
    if role == "normal" and len(first) == 2 and {c.meaning.convention for c in first} == {"opengl", "directx"}:
        wanted = options.normal_convention or "opengl"
        first = [c for c in first if c.meaning.convention == wanted]
        log.notes.append(f"both normal conventions are there: {_spoken(wanted)} ({first[0].header.path.name}) is taken")
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


def _take_alpha_as_opacity(chosen: dict[str, _Candidate], options: LoadOptions, log: _Log) -> None:
    base = chosen.get("base_color")
    if base is None or "opacity" in chosen or "opacity" in options.maps or base.header.alpha < 0:
        return
    chosen["opacity"] = _Candidate(base.header, Meaning("opacity", "A"), "alpha of the base colour")
    log.notes.append(f"opacity is the alpha channel of {base.header.path.name}")


def _source(c: _Candidate, colour_space: str | None, options: LoadOptions, log: _Log) -> MapSource:
    role, header = c.meaning.role, c.header
    channels = c.meaning.channels if len(c.meaning.channels) != 3 else ""
    channels = channels or _natural_channels(role, header)
    if c.reason == "chosen by option" and c.meaning.channels:
        channels = c.meaning.channels
    if len(channels) == 1 and channels == "R" and header.channels - (header.alpha >= 0) == 1:
        channels = "Y"
    encoding = DATA
    if role in COLOUR_ROLES:
        encoding = colour_space or default_colour_space(header.is_integer)
        if colour_space is None and header.depth not in ("uint8", "half", "float"):
            log.notes.append(f"{header.path.name}: its {header.depth} values are taken as {encoding}")
    inverted = c.meaning.inverted
    if role == "roughness" and options.roughness_is_gloss is not None:
        inverted = options.roughness_is_gloss
    if inverted:
        log.notes.append(f"{header.path.name}: gloss, inverted to roughness")
    if header.subimages > 1:
        log.warnings.append(f"{header.path.name} holds {header.subimages} images: only the first is read")
    return MapSource(
        role,
        header.path,
        channels,
        header.width,
        header.height,
        header.depth,
        encoding,
        inverted,
        c.reason,
        convention=c.meaning.convention,
    )


def _natural_channels(role: str, header: Header) -> str:
    colours = header.channels - (header.alpha >= 0)
    if role == "normal":
        return "RGB" if colours >= 3 else "RG" if header.channels == 2 else "Y"
    if role in SCALAR_ROLES:
        return "Y" if colours == 1 else "R"
    return "RGB" if colours >= 3 else "Y"


def _constant(role: str, value: tuple[float, ...]) -> MapSource:
    if role == "base_color" and len(value) == 1:
        value = value * 3
    encoding = "linear Rec.709" if role in COLOUR_ROLES else DATA
    return MapSource(role, None, "", 1, 1, "float", encoding, False, "constant", constant=value)


def _check_complete(
    sources: Mapping[str, MapSource],
    options: LoadOptions,
    folder: Path,
    candidates: Mapping[str, Sequence[_Candidate]],
    ignored: Sequence[IgnoredFile],
) -> None:
    left_out = [r for r, v in options.maps.items() if v is None]
    missing = [r for r in ("normal", "roughness") if r not in sources and r not in left_out]
    if not missing:
        return
    found = [f"{c.header.path.name} ({_spoken(r)})" for r, several in candidates.items() for c in several]
    found += [f"{i.path.name} ({i.reason})" for i in ignored]
    listed = ", ".join(found[:12]) + (f" and {len(found) - 12} more" if len(found) > 12 else "")
    remedy = {"normal": "normal=FILE, or normal=none for a flat one", "roughness": "roughness=FILE or a number"}
    raise InputError(
        f"{folder} has no {' and no '.join(missing)} map that its file names tell; found: {listed}; name one with the "
        f"option maps ({', '.join(remedy[m] for m in missing)})"
    )


def _named_convention(source: MapSource, options: LoadOptions, log: _Log) -> NormalConvention:
    if source.path is None:
        return NormalConvention("opengl", "flat", 1.0)
    if options.normal_convention is not None:
        if source.convention not in (None, options.normal_convention):
            log.warnings.append(
                f"{source.path.name}: its name says {_spoken(source.convention)}, the option says "
                f"{_spoken(options.normal_convention)} and is followed"
            )
        return NormalConvention(options.normal_convention, "option", 1.0)
    if source.convention is not None:
        return NormalConvention(source.convention, "name", 1.0)
    return NormalConvention("opengl", "assumed", 0.0)


def _common_size(sources: Sequence[MapSource], log: _Log) -> tuple[int, int]:
    """Width and height of the largest map; the others must have its shape, to within one texel, or be 1 x 1."""
    largest = max(sources, key=lambda s: s.width * s.height)
    width, height = largest.width, largest.height
    for s in sources:
        if (s.width, s.height) in ((width, height), (1, 1)) or s.path is None:
            continue
        if abs(s.width * height - s.height * width) > max(width, height) or s.width > width or s.height > height:
            other = largest.path.name if largest.path else "another map"
            raise InputError(
                f"{s.path.name} is {s.width} x {s.height} and {other} is {width} x {height}: expected one shape for "
                "all maps that shade; crop or scale one of them"
            )
        log.notes.append(f"{s.path.name}: resampled from {s.width} x {s.height} to {width} x {height}")
    return width, height
