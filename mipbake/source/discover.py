"""Which file fills which role of a texture set, and why: names, options and headers, without reading pixels."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from mipbake.base import disk
from mipbake.base.colour import LINEAR, SRGB, canonical_colour_space, default_colour_space, is_linear
from mipbake.base.errors import InputError
from mipbake.base.messages import listed
from mipbake.source.images.colours import RAW
from mipbake.source.images.image import Header
from mipbake.source.matches import NO_ROLE, OUTVOTED, PREVIEW, Match, choose, classified, name_of
from mipbake.source.names import colour_space_of
from mipbake.source.options import CARRIED, COLOUR_ROLES, ROLES, SCALAR_ROLES, SHADING_ROLES, STRAIGHT, LoadOptions
from mipbake.source.sources import DATA, Found, IgnoredFile, Log, MapSource, NormalConvention, source_model, spoken
from mipbake.source.specular import take_specular

_CONSTANTS: Mapping[str, tuple[float, ...]] = {
    "base_color": (0.5, 0.5, 0.5),
    "normal": (0.0, 0.0, 1.0),
    "metallic": (0.0,),
}


def find(files: Sequence[Path], options: LoadOptions) -> Found:
    """What the files of one set are, from names and headers; `mipbake.source.texture_set.read` reads it. A normal
    convention that no name says stays assumed, with confidence 0. InputError where there is no usable set, UsageError
    where an option names what does not exist."""
    if not files:
        raise InputError("no files were given: expected the maps of one texture set")
    for file in files:
        if not disk.is_file(file):
            raise InputError(f"{file} is not a file: expected the maps of one texture set")
    folder = files[0].parent
    matches, ignored = classified(files, options)
    log = Log()
    chosen = choose(matches, folder, options, log)
    specular = take_specular(chosen, ignored, folder, options)
    colour_space = None if options.colour_space is None else canonical_colour_space(options.colour_space)
    sources = {role: _source(c, colour_space, options, log) for role, c in chosen.items()}
    sources |= {r: _constant(r, (float(v),)) for r, v in options.maps.items() if isinstance(v, (int, float))}
    if specular is not None:
        sources |= {"metallic": specular, "base_color": replace(sources["base_color"], converted=True)}
    missing = [r for r in ("normal", "roughness") if r not in sources and options.maps.get(r, "") is not None]
    if missing:
        raise _incomplete(folder, missing, matches, ignored)
    unread = [i for i in ignored if i.reason in (NO_ROLE, PREVIEW) and i.path not in {s.path for s in sources.values()}]
    _check_colour(sources, options, folder, unread)
    for role, value in _CONSTANTS.items():
        if role not in sources:
            sources[role] = _constant(role, value)
            _log_constant(role, value, options, unread, log)
    carried = _carried(sources, {c.header.path: c.header for c in chosen.values()}, log)
    used = {s.path for s in sources.values()}
    ignored += [IgnoredFile(p, OUTVOTED) for p in dict.fromkeys(c.header.path for m in matches.values() for c in m)]
    width, height = _common_size([s for r, s in sources.items() if r in SHADING_ROLES], log)
    convention = _named_convention(sources["normal"], options, log)
    return Found(
        options.name or name_of(folder),
        width,
        height,
        source_model("anisotropy" in sources),
        {r: sources[r] for r in ROLES if r in sources} | carried,
        convention,
        tuple(log.notes),
        tuple(log.warnings),
        tuple(sorted((i for i in ignored if i.path not in used), key=lambda i: i.path.name)),
    )


def _source(match: Match, colour_space: str | None, options: LoadOptions, log: Log) -> MapSource:
    role, header, channels = match.meaning.role, match.header, match.meaning.channels
    if not channels or (len(channels) == 3 and role not in options.maps):
        channels = _natural_channels(role, header)
    if channels == "R" and header.colours == 1:
        channels = "Y"
    encoding = _encoding(role, header, colour_space, options, log)
    inverted = match.meaning.inverted
    if role == "roughness" and options.roughness_is_gloss is not None:
        inverted = options.roughness_is_gloss
    if inverted:
        log.notes.append(f"{header.path.name}: it holds gloss, which is inverted to roughness")
    said = header.declared
    if said.padded and role in ("normal", "anisotropy"):
        raise InputError(
            f"{header.path} stores a part of its display window, and the rest would be no {spoken(role)}: expected "
            "texels in all of it; export it without a border"
        )
    # Once for all roles that take the file.
    turn = [f"it is turned, as its orientation {said.orientation} says"] if said.orientation != 1 else []
    for some, into in (([*turn, *said.notes], log.notes), (said.warnings, log.warnings)):
        into += [line for each in some if (line := f"{header.path.name}: {each}") not in into]
    # Only colours are multiplied by alpha: beside values that are data it is one more of them.
    multiplied = role in COLOUR_ROLES and header.alpha >= 0
    return MapSource.of_file(
        *(role, header, channels, encoding, inverted, match.reason),
        channels_named=bool(match.meaning.channels),
        convention=match.meaning.convention,
        orientation=1 if said.texels_alone else said.orientation,
        alpha=options.alpha or said.alpha if multiplied else STRAIGHT,
        metadata=options.metadata,
    )


def _encoding(role: str, header: Header, wanted: str | None, options: LoadOptions, log: Log) -> str:
    """The colour space of a file's colours: what is wanted, else what its name says, else what its type means."""
    name, colour = header.path.name, header.declared.colour
    word = colour_space_of(header.path.stem) if options.origin == "option" else None
    named = None if word is None else LINEAR if word == RAW else canonical_colour_space(word)
    if role not in COLOUR_ROLES:
        if named is not None and not is_linear(named):
            log.warnings.append(
                f"{name}: its name says {named}, but {spoken(role)} is no colour: its values are taken as they are "
                "stored; export it as raw values if that is wrong"
            )
        elif colour.space not in (None, SRGB) and not is_linear(str(colour.space)):
            log.notes.append(
                f"{name}: {colour.by} says {colour.space}, but {spoken(role)} is no colour: its values are taken as "
                "they are stored"
            )
        return DATA
    if wanted is not None:
        if named not in (None, wanted):
            log.warnings.append(f"{name}: its name says {word}, the {options.origin} says {wanted}, which is followed")
        return wanted
    if named is not None:
        log.notes.append(f"{name}: its name says {f'{word}, taken as {named}' if word == RAW else named}")
        return named
    encoding = default_colour_space(header.is_integer)
    said = None if colour.space is None else canonical_colour_space(colour.space)
    if said is not None and (said != encoding or colour.named):
        log.notes.append(f"{name}: {colour.by} says {said}")
    elif header.depth not in ("uint8", "half", "float"):
        log.notes.append(f"{name}: its {header.depth} values are taken as {encoding}")
    if colour.unknown:
        log.warnings.append(
            f"{name}: {colour.by} says colours that are not known here ({colour.unknown}), which are taken as "
            f"{encoding}: convert them, or say what they are (--colour-space, colour_space in Python)"
        )
    return said or encoding


def _carried(sources: Mapping[str, MapSource], headers: Mapping[Path, Header], log: Log) -> dict[str, MapSource]:
    """Channels that no role takes, beside channels that are taken: in packed files, and the alpha of normal maps."""
    carried: dict[str, MapSource] = {}
    for path, header in headers.items():
        if sources["metallic"].converted and path == sources["metallic"].path:
            continue  # its colours have a role
        here = [s for s in sources.values() if s.path == path]
        packed = header.colours >= 3 and all(s.channels_named for s in here)
        if not (packed or any(s.role == "normal" for s in here)):
            continue
        for letter in ("RGB" if packed else "") + ("A" if header.alpha >= 0 and header.colours >= 3 else ""):
            if any(letter in s.channels for s in here):
                continue
            name = f"{CARRIED}{len(carried) + 1}"
            carried[name] = replace(
                here[0], role=name, channels=letter, encoding=DATA, inverted=False, reason="beside other channels"
            )
            log.notes.append(
                f"{path.name}: channel {letter} has no role, it is kept as {name} where files are packed as these are"
            )
    return carried


def _natural_channels(role: str, header: Header) -> str:
    if role == "normal" and header.channels == 2:
        return "RG"
    if role in SCALAR_ROLES:
        return "Y" if header.colours == 1 else "R"
    return "RGB" if header.colours >= 3 else "Y"


def _constant(role: str, value: tuple[float, ...]) -> MapSource:
    channels = value * 3 if role == "base_color" and len(value) == 1 else value
    return replace(MapSource.made(role, 1, 1, "constant"), constant=channels)


def _incomplete(
    folder: Path, missing: Sequence[str], matches: Mapping[str, Sequence[Match]], ignored: Sequence[IgnoredFile]
) -> InputError:
    """What is said of a set that lacks maps which every set must have."""
    found = [f"{c.header.path.name} ({spoken(r)})" for r, several in matches.items() for c in several]
    found += [f"{i.path.name} ({i.reason})" for i in ignored]
    remedy = {"normal": "normal=FILE|none", "roughness": "roughness=FILE|NUMBER"}
    return InputError(
        f"{folder} has no {' and no '.join(missing)} map by its file names; found: {listed(found)}; use --map "
        f"{', '.join(remedy[m] for m in missing)} (maps in Python)"
    )


def _check_colour(
    sources: Mapping[str, MapSource], options: LoadOptions, folder: Path, unread: Sequence[IgnoredFile]
) -> None:
    """InputError for a set without a base colour that holds images without a role: one of them may be the base
    colour."""
    if "base_color" in (*sources, *options.maps) or options.origin == "document" or not unread:
        return
    first = unread[0].path.name
    raise InputError(
        f"{folder} has no base colour map that its file names tell, but images without a role: "
        f"{listed(i.path.name for i in unread)}; choose one with --map base_color={first}, or say --map "
        "base_color=none where there is no colour and grey will do (maps in Python)"
    )


def _log_constant(
    role: str, value: Sequence[float], options: LoadOptions, unread: Sequence[IgnoredFile], log: Log
) -> None:
    """Says what stands for a map that is not there, as a warning where nobody has said that it is meant."""
    line = f"no {spoken(role)} map: the constant {', '.join(f'{v:g}' for v in value)} is used"
    nameless = [i.path.name for i in unread if i.reason == NO_ROLE]
    meant = role in options.maps or options.origin == "document"
    if role == "base_color" and not meant:
        log.warnings.append(
            f"{line}, so that what is baked is grey; choose a map with --map base_color=FILE, or say --map "
            "base_color=none where grey is meant (maps in Python)"
        )
    elif nameless and not meant:
        log.warnings.append(
            f"{line}, and {listed(nameless)} {'have' if len(nameless) > 1 else 'has'} no role; choose it with --map "
            f"{role}={nameless[0]} if it is one (maps in Python)"
        )
    else:
        log.notes.append(line)


def _named_convention(source: MapSource, options: LoadOptions, log: Log) -> NormalConvention:
    if source.path is None:
        return NormalConvention("opengl", "flat", 1.0)
    if options.normal_convention is not None:
        if source.convention not in (None, options.normal_convention):
            log.warnings.append(
                f"{source.path.name}: its name says {spoken(source.convention)}, the {options.origin} says "
                f"{spoken(options.normal_convention)}, which is followed"
            )
        return NormalConvention(options.normal_convention, options.origin, 1.0)
    if source.convention is not None:
        return NormalConvention(source.convention, "name", 1.0)
    return NormalConvention("opengl", "assumed", 0.0)


def _common_size(sources: Sequence[MapSource], log: Log) -> tuple[int, int]:
    """The greatest width and the greatest height of any map, so that resampling to it loses no detail.

    A map whose shape differs by more than a texel is stretched over the same unit square, which is worth a warning.
    """
    width, height = max(s.width for s in sources), max(s.height for s in sources)
    largest = max(sources, key=lambda s: s.width * s.height)
    for s in sources:
        if (s.width, s.height) in ((width, height), (1, 1)) or s.path is None:
            continue
        resampled = f"{s.path.name}: resampled from {s.width} x {s.height} to {width} x {height}"
        if abs(s.width * height - s.height * width) <= max(width, height):
            log.notes.append(resampled)
        elif s is largest or largest.path is None:
            log.warnings.append(f"{resampled}, another shape")
        else:
            other = f"{largest.path.name} is {largest.width} x {largest.height}"
            log.warnings.append(f"{resampled}, another shape ({other}): its texels are stretched; check that they fit")
    return width, height
