"""What files that OpenImageIO reads say of their images: see `mipbake.source.images.image`.

The library's own attributes are taken where they repeat the file. It also has attributes of its own for files that say
nothing, of colours above all, and these are not taken.
"""

from __future__ import annotations

import re
import struct
import zlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from mipbake.base import disk
from mipbake.base.errors import InputError
from mipbake.base.messages import listed, told_by
from mipbake.source.images.colours import Colour, coded, named_space, primaries_of
from mipbake.source.images.icc import profile_colour
from mipbake.source.images.image import Declared, Window, orientation
from mipbake.source.images.image_files import tiff_directories
from mipbake.source.images.other_images import dds_said
from mipbake.source.names import interpretations
from mipbake.source.options import PREMULTIPLIED, STRAIGHT
from mipbake.source.sources import spoken

if TYPE_CHECKING:
    import OpenImageIO

    Spec = OpenImageIO.ImageSpec


def said_by(path: Path, image: OpenImageIO.ImageInput) -> Declared:
    """What a file says of the image that its reader stands at."""
    read = _READERS.get(image.format_name(), _other)
    return read(path, image.spec())


def _other(_path: Path, spec: Spec) -> Declared:
    """Formats with Exif and ICC profiles: JPEG, WebP, PSD and others."""
    warnings = ("it holds several frames: only the first is read",) if spec.getattribute("oiio:Movie") else ()
    return Declared(orientation(spec.getattribute("Orientation")), colour=_profile(spec), warnings=warnings)


def _profile(spec: Spec) -> Colour:
    """What an ICC profile says, else code points; nothing where there is neither."""
    profile, codes = spec.getattribute("ICCProfile"), spec.getattribute("CICP")
    if profile is not None:
        return profile_colour(np.asarray(profile, np.uint8).tobytes())
    return coded(int(codes[0]), int(codes[1]), "its code points") if codes is not None else Colour()


def _openexr(path: Path, spec: Spec) -> Declared:
    primaries = primaries_of(spec.getattribute("chromaticities"))
    colour = Colour("linear", primaries, by="its chromaticities") if primaries else Colour()
    for attribute in ("colorInteropID", "oiio:ColorSpace"):
        colour = named_space(spec.getattribute(attribute), attribute, colour)
    # Colours of OpenEXR are multiplied by alpha, but this program writes them as they are.
    alpha = STRAIGHT if spec.getattribute("mipbake") else PREMULTIPLIED
    return _windowed(path, spec, Declared(alpha=alpha, colour=colour))


_MOST = 1 << 31
"""Texels of the largest image that a window may ask for."""


def _windowed(path: Path, spec: Spec, said: Declared) -> Declared:
    """With the display window, where it is not what the file stores; InputError where it lies elsewhere."""
    width, height = spec.width, spec.height
    window = Window(spec.x - spec.full_x, spec.y - spec.full_y, spec.full_width, spec.full_height)
    if window == Window(0, 0, width, height):
        return said
    columns = min(window.width, window.x + width) - max(0, window.x)
    rows = min(window.height, window.y + height) - max(0, window.y)
    if columns < 1 or rows < 1 or window.width * window.height > _MOST:
        raise InputError(
            f"{path} stores {width} x {height} texels at ({window.x}, {window.y}) of an image of {window.width} x "
            f"{window.height}: expected a data window within the display window; export it again"
        )
    about = (
        f"its data window is {width} x {height} at ({window.x}, {window.y}) and its display window is {window.width} x "
        f"{window.height}"
    )
    if (columns, rows) == (window.width, window.height):
        return replace(said, window=window, notes=(*said.notes, f"{about}, to which it is cut"))
    return replace(said, window=window, padded=True, warnings=(*said.warnings, f"{about}: the rest of it is zero"))


def _radiance(path: Path, _spec: Spec) -> Declared:
    with disk.opened(path) as file:
        head = file.read(_HEAD)
    found = _RESOLUTION.search(head)
    head = head[: found.start() + 1] if found else b""
    values = {name.decode(): value.decode("ascii", "replace").strip() for name, value in _LINE.findall(head)}
    turn = _RADIANCE[(found[1] + found[2]).decode()] if found else 1
    listed = values.get("PRIMARIES", "").split()
    try:
        primaries = primaries_of(tuple(float(value) for value in listed))
    except ValueError:
        primaries = "of a kind that is not read"
    colour = Colour("linear", primaries, by="its header") if primaries else Colour()
    ignored = [
        f"its {name} of {values[name]} is ignored" for name in ("EXPOSURE", "GAMMA", "COLORCORR") if name in values
    ]
    return Declared(turn, turn_is_pixels=True, colour=colour, warnings=tuple(ignored))


_RADIANCE = {"-Y+X": 1, "-Y-X": 2, "+Y-X": 3, "+Y+X": 4, "+X-Y": 5, "-X-Y": 6, "-X+Y": 7, "+X+Y": 8}
"""What the last line of a Radiance header says to an orientation: the axis and sign of rows, then of what is in rows.

OpenImageIO exchanges 6 and 8."""

_RESOLUTION = re.compile(rb"\n([+-][XY]) +\d+ +([+-][XY]) +\d+\n")
_LINE = re.compile(rb"\n([A-Z]+) *=([^\n]*)")
_HEAD = 1 << 16
"""Bytes that hold the header of a Radiance file."""


def _png(path: Path, spec: Spec) -> Declared:
    """The first of these chunks that is there counts: cICP, iCCP, sRGB, gAMA and cHRM."""
    chunks = _png_chunks(path)
    colour = Colour()
    if len(chunks.get(b"cICP", b"")) == 4:
        colour = coded(chunks[b"cICP"][0], chunks[b"cICP"][1], "its chunk cICP")
    elif b"iCCP" in chunks:
        packed = chunks[b"iCCP"].partition(b"\0")[2][1:]
        try:
            colour = profile_colour(zlib.decompressobj().decompress(packed, 1 << 24))
        except zlib.error:
            colour = profile_colour(b"")
    elif b"sRGB" in chunks:
        colour = Colour("sRGB", "Rec.709", by="its chunk sRGB")
    elif len(chunks.get(b"gAMA", b"")) == 4:
        primaries = ""
        if len(chunks.get(b"cHRM", b"")) == 32:
            white, *rest = np.frombuffer(chunks[b"cHRM"], ">u4").reshape(4, 2) / 100000
            primaries = primaries_of((*np.concatenate(rest).tolist(), *white.tolist()))
        colour = Colour(_of_gamma(int.from_bytes(chunks[b"gAMA"], "big"), primaries), primaries, by="its chunk gAMA")
    frames = int.from_bytes(chunks.get(b"acTL", b"")[:4], "big")
    warnings = (f"it holds {frames} frames: only the first is read",) if frames > 1 else ()
    return Declared(orientation(spec.getattribute("Orientation")), colour=colour, warnings=warnings)


def _of_gamma(stored: int, primaries: str) -> str:
    """The transfer function of gAMA, in units of 1 / 100000. What encodes sRGB writes 45455 for it."""
    if abs(stored - 100000) <= 500:
        return "linear"
    if abs(stored - 45455) <= 500:
        return "gamma 2.2" if primaries == "Adobe RGB" else "sRGB"
    return f"gamma {100000 / stored:.3g}" if stored else "gamma without a value"


def _png_chunks(path: Path) -> Mapping[bytes, bytes]:
    """The first chunk of each kind, without texels."""
    found: dict[bytes, bytes] = {}
    with disk.opened(path) as file:
        file.seek(8)
        while len(head := file.read(8)) == 8:
            length, kind = struct.unpack(">I4s", head)
            if kind in (b"IDAT", b"IEND") or length > _MOST_CHUNK:
                break
            found.setdefault(kind, file.read(length))
            file.seek(4, 1)
    return found


_MOST_CHUNK = 1 << 24
"""Bytes of the longest chunk that is read for what it says of the image."""


def _tiff(path: Path, spec: Spec) -> Declared:
    named = named_space(spec.getattribute("oiio:ColorSpace"), "colour space", Colour())
    colour = _profile(spec) if spec.getattribute("ICCProfile") is not None else named
    samples = _extra_samples(path)
    colours = spec.nchannels - len(samples)
    multiplied = 0 <= spec.alpha_channel - colours < len(samples) and samples[spec.alpha_channel - colours] == 1
    return Declared(
        orientation(spec.getattribute("Orientation")),
        turn_is_pixels=True,
        alpha=PREMULTIPLIED if multiplied else STRAIGHT,
        colour=colour,
    )


def _extra_samples(path: Path) -> tuple[int, ...]:
    """What the first image of a TIFF file says of each channel beyond its colours; empty where it says nothing.

    OpenImageIO does not tell files that say that colours are multiplied by alpha from files that are silent.
    """
    try:
        with disk.opened(path) as file:
            order = "<" if file.read(2) == b"II" else ">"
            _, found = next(tiff_directories(file, _MOST_SAMPLES), {}).get(_EXTRA_SAMPLES, (0, b""))
            return struct.unpack(f"{order}{len(found) // 2}H", found)
    except (struct.error, OverflowError, ValueError, OSError):  # damage, which reading the texels will show
        return ()


_EXTRA_SAMPLES, _MOST_SAMPLES = 338, 128


def _targa(_path: Path, spec: Spec) -> Declared:
    """Kind 4 of the extension area; OpenImageIO puts the first texel into the top left corner itself."""
    kind = spec.getattribute("targa:alpha_type")
    notes = ("it says that its alpha has no meaning, but it is read",) if kind in (1, 2) else ()
    return Declared(alpha=PREMULTIPLIED if kind == 4 else STRAIGHT, notes=notes)


_READERS: Mapping[str, Callable[[Path, Spec], Declared]] = {
    "openexr": _openexr,
    "hdr": _radiance,
    "png": _png,
    "tiff": _tiff,
    "targa": _targa,
    "jpegxl": lambda _path, spec: Declared(colour=_profile(spec)),  # its decoder turns it
    "dds": dds_said,
}


# ---- layers of OpenEXR files: their channels lie in the order of the alphabet, and are known by their names alone.
# What stands before the last dot of a name is the layer. A file may have several parts, with layers each.

_COLOURS = ("r g b", "red green blue", "x y z", "r g", "x y", "r", "red", "y")
"""Names of the channels of one image, in lower case, the most complete first."""

_ALPHA = ("a", "alpha")
_WHOLE = ("", "rgba", "rgb")
"""Names of layers that are the image itself."""


@dataclass(frozen=True)
class Layer:
    """Channels that make one image.

    Args:
        part: of the file, a number.
        name: of the layer; empty for channels without one.
        channels: their numbers in the part, in the order red, green, blue, alpha.
        alpha: which of these is alpha; -1: none.
        depth: type of the values.
    """

    part: int
    name: str
    channels: tuple[int, ...]
    alpha: int
    depth: str


def taken_layer(path: Path, image: OpenImageIO.ImageInput, role: str | tuple[int, str]) -> tuple[Layer, str]:
    """The layer for a role, or at a place (its part and name), and the names of the others, in a sentence's words.

    The reader stands at the layer's part afterwards. InputError where no layer is the role's, or can be read.
    """
    layers = []
    part = 0
    while image.seek_subimage(part, 0):
        layers += _layers(path, part, image.spec())
        part += 1
    told_by(image.geterror)  # clears what the end of the parts left
    layer = _chosen(path, layers, role)
    image.seek_subimage(layer.part, 0)
    if layer.depth.startswith("uint"):
        raise InputError(f"{path} stores numbers of objects, and no colours or values: choose another file")
    return layer, listed(each.name or "the one without a name" for each in layers if each != layer)


def _layers(path: Path, part: int, spec: OpenImageIO.ImageSpec) -> list[Layer]:
    if spec.deep:
        raise InputError(f"{path} is a deep image: expected one value for each texel, flatten it")
    several = int(spec.getattribute("oiio:subimages") or 1) > 1
    part_name = str(spec.getattribute("name") or "") if several else ""
    groups: dict[str, dict[str, int]] = {}
    for index, name in enumerate(spec.channelnames):
        layer, _, channel = name.rpartition(".")
        groups.setdefault(layer, {})[channel] = index
    found = []
    for layer, channels in groups.items():
        full = layer if layer.startswith(part_name) else f"{part_name}.{layer}".strip(".")
        for name, taken, alpha in _images(path, full, channels):
            types = {str(spec.channelformat(channel)) for channel in taken}
            found.append(Layer(part, name, taken, alpha, types.pop() if len(types) == 1 else "float"))
    return found


def _images(path: Path, layer: str, channels: dict[str, int]) -> list[tuple[str, tuple[int, ...], int]]:
    """The images in a layer, with name, channels and alpha: what its usual channels make, and each other channel."""
    lower = {name.lower(): index for name, index in channels.items()}
    if {"ry", "by"} & lower.keys():
        raise InputError(
            f"{path} stores brightness and differences of colours (Y, RY, BY): expected channels R, G and B; convert it"
        )
    usual = next((names for names in map(str.split, _COLOURS) if set(names) <= lower.keys()), [])
    alpha = [name for name in _ALPHA if name in lower][:1]
    rest = [name for name in channels if name.lower() not in (*usual, *alpha)]
    if not usual and len(rest) == 1:
        usual, rest = [rest[0].lower()], []  # the only channel of a layer may have any name
    found = []
    if usual or alpha:
        taken = tuple(lower[name] for name in (*usual, *alpha))
        found = [(layer, taken, len(usual) if usual and alpha else -1)]
    return found + [(f"{layer}.{name}".lstrip("."), (channels[name],), -1) for name in rest]


def _chosen(path: Path, layers: Sequence[Layer], role: str | tuple[int, str]) -> Layer:
    """The layer at a place; of a role the only layer, the one that is called after it, else the one without a name.

    InputError, which lists the layers, where none of these is there.
    """
    if not isinstance(role, str):
        return next(layer for layer in layers if (layer.part, layer.name) == role)
    if len(layers) == 1:
        return layers[0]
    named = [layer for layer in layers if role and role in _roles(layer.name)]
    whole = [layer for layer in layers if layer.name.lower() in _WHOLE]
    for several in (named, whole):
        if len(several) == 1:
            return several[0]
    found = listed(layer.name or "one without a name" for layer in layers)
    what = f"holds the {spoken(role)}" if role else "is the image"
    raise InputError(
        f"{path} has several layers ({found}), and {'more than one' if named else 'no'} name says that it {what}: "
        "export that layer as a file of its own"
    )


def _roles(name: str) -> set[str]:
    last = name.rpartition(".")[2]
    found = {meaning.role for each in {name, last} for match in interpretations(each) for meaning in match.meanings}
    return found | {name.lower(), last.lower()}
