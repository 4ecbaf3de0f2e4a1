"""What files say of themselves: orientation, windows, layers, alpha, colours, further images."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import mipbake
from mipbake.base.errors import InputError
from mipbake.base.srgb import srgb_to_linear
from mipbake.source.images.read import read_header, read_image

from .gltf_files import GltfFile
from .input_files import bytes_of, encoded, write_image

pillow = pytest.importorskip("PIL.Image")

STORED = {
    1: lambda image: image,
    2: lambda image: image[:, ::-1],
    3: lambda image: image[::-1, ::-1],
    4: lambda image: image[::-1],
    5: lambda image: image.swapaxes(0, 1),
    6: np.rot90,
    7: lambda image: np.rot90(image, 2).swapaxes(0, 1),
    8: lambda image: np.rot90(image, -1),
}
"""What a file stores of an image to be seen under each orientation."""

RADIANCE = ["-Y +X", "-Y -X", "+Y -X", "+Y +X", "+X -Y", "-X -Y", "-X +Y", "+X +Y"]


def write_turned(path: Path, stored: np.ndarray, orientation: int) -> Path:
    """A file of bytes that says how they are to be turned."""
    stored = np.ascontiguousarray(stored)
    if path.suffix == ".hdr":
        ys, xs = RADIANCE[orientation - 1].split()
        sizes = stored.shape[:2]
        texels = np.concatenate([stored, np.full((*sizes, 1), 128, np.uint8)], -1)
        line = f"{ys} {sizes[0]} {xs} {sizes[1]}"
        path.write_bytes(f"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n{line}\n".encode() + texels.tobytes())
        return path
    exif = pillow.Exif()
    exif[0x112] = orientation
    lossy = {"quality": 100, "subsampling": "4:4:4" if path.suffix == ".avif" else 0}
    kind = {".png": {}, ".tif": {}, ".webp": {"lossless": True}}.get(path.suffix, lossy)
    pillow.fromarray(stored).save(path, exif=exif, **kind)
    return path


@pytest.mark.parametrize(
    ("suffix", "orientation"),
    [*((s, o) for s in ("tif", "hdr") for o in range(1, 9)), *((s, 6) for s in ("png", "jpg", "webp", "avif"))],
)
def test_images_are_turned_once(suffix: str, orientation: int, tmp_path: Path) -> None:
    v, u = np.meshgrid(np.linspace(40, 200, 9), np.linspace(60, 240, 14), indexing="ij")
    image = np.stack([v, u, (u + v) / 3 + 90], -1).astype(np.uint8)
    path = write_turned(tmp_path / f"a.{suffix}", STORED[orientation](image), orientation)
    found, header = read_image(path).pixels, read_header(path)
    assert (header.height, header.width) == found.shape[:2] == image.shape[:2]
    scale = 256 if suffix == "hdr" else 1
    assert np.abs(found[..., :3] * scale - image.astype(float)).max() <= (6 if suffix in ("jpg", "avif") else 1)


def bumps(height: int = 24, width: int = 40) -> tuple[np.ndarray, np.ndarray]:
    """A height field without symmetry, wrapping, and its normals with green up."""
    v, u = np.meshgrid(np.arange(height) / height, np.arange(width) / width, indexing="ij")
    waves = 3 * np.sin(2 * np.pi * (u + 2 * v)) + np.cos(2 * np.pi * (3 * u - v) + 1) + np.sin(2 * np.pi * v)
    return waves, normals_of(waves)


def normals_of(field: np.ndarray) -> np.ndarray:
    right = (np.roll(field, -1, 1) - np.roll(field, 1, 1)) / 2
    up = (np.roll(field, 1, 0) - np.roll(field, -1, 0)) / 2
    normals = np.stack([-right, -up, np.ones_like(field)], -1)
    return normals / np.linalg.norm(normals, axis=-1, keepdims=True)


@pytest.mark.parametrize("orientation", range(1, 9))
def test_vectors_turn_with_their_texels(orientation: int, tmp_path: Path) -> None:
    """What is stored is what a program would make of the stored height field."""
    (field, normals), directx = bumps(), orientation in (5, 6)
    stored = normals_of(STORED[orientation](field))
    write_turned(tmp_path / "wood_normal.png", encoded(stored, directx), orientation)
    directions = bytes_of(np.concatenate([(stored[..., :2] + 1) / 2, np.ones_like(stored[..., :1])], -1))
    write_turned(tmp_path / "wood_anisotropy.tif", directions, orientation)
    found = mipbake.load(tmp_path, maps={"roughness": 0.5, "base_color": None})
    assert (found.convention.name, found.convention.decided_by) == ("directx" if directx else "opengl", "pixels")
    assert np.abs(found.maps["normal"].pixels - normals).max() < 0.02
    along = normals[..., :2] / np.linalg.norm(normals[..., :2], axis=-1, keepdims=True)
    agreement = np.einsum("hwc,hwc->hw", along, found.maps["anisotropy"].pixels[..., :2])
    assert np.median(agreement) > 0.999
    assert any("orientation" in note for note in found.notes) == (orientation != 1)


def test_in_gltf_exif_is_ignored_and_that_is_said(tmp_path: Path) -> None:
    _, normals = bumps(16, 16)
    made = GltfFile()
    image = write_turned(tmp_path / "a.png", encoded(normals), 6).read_bytes()
    plain = write_image(tmp_path / "b.png", np.full((16, 16, 3), 90, np.uint8)).read_bytes()
    for data, name in ((image, "normal"), (plain, "mr")):
        made.json["textures"].append({"source": made.image(data, name, "image/png")})
    made.material("wood", normalTexture={"index": 0}, pbrMetallicRoughness={"metallicRoughnessTexture": {"index": 1}})
    found = mipbake.load(made.write(tmp_path / "wood"))
    np.testing.assert_allclose(found.maps["normal"].pixels, normals, atol=0.02)
    assert any("Exif orientation 6 is ignored" in warning for warning in found.warnings)


Channels = dict[str, float]


def write_exr(path: Path, *parts: Channels, names: Sequence[str] = (), window: Any = None, **attributes: Any) -> Path:
    """6 x 4 texels in parts, with constant channels; `window`: x, y, and width and height of the display window."""
    import OpenImageIO as oiio  # noqa: N813

    specs = []
    for index, channels in enumerate(parts):
        spec = oiio.ImageSpec(6, 4, len(channels), "half")
        spec.channelnames = tuple(channels)
        spec.alpha_channel = next((i for i, name in enumerate(channels) if name == "A"), -1)
        if window is not None:
            spec.x, spec.y, spec.full_width, spec.full_height = window
        if names:
            spec.attribute("oiio:subimagename", names[index])
        for name, value in attributes.items():
            kind = "string" if isinstance(value, str) else f"float[{len(value)}]"
            spec.attribute(name.replace("__", ":"), oiio.TypeDesc(kind), value)
        specs.append(spec)
    output = oiio.ImageOutput.create(str(path))
    assert output.open(str(path), specs), output.geterror()
    for index, (spec, channels) in enumerate(zip(specs, parts, strict=True)):
        assert index == 0 or output.open(str(path), spec, "AppendSubimage"), output.geterror()
        assert output.write_image(np.tile(np.array(list(channels.values()), np.float32), (4, 6, 1)))
    output.close()
    return path


RGB = {"R": 0.5, "G": 0.25, "B": 0.125}


def bake_colour(tmp_path: Path, name: str, **options: Any) -> mipbake.TextureSet:
    """The set whose base colour is a file that lies there."""
    return mipbake.load([tmp_path / name], maps={"roughness": 0.5, "normal": None}, **options)


COLOUR, ALPHA = np.array([0.8, 0.4, 0.2]), 0.5


def write_alpha(path: Path, multiplied: bool, top: int = 255, grey: bool = False, extra: int | None = None) -> Path:
    """A colour with alpha, which is 0 in one texel; `extra` is what TIFF says of alpha."""
    colour = COLOUR[:1] if grey else COLOUR
    texels = np.tile([*(colour * (ALPHA if multiplied else 1)), ALPHA], (4, 6, 1))
    texels[0, 0] = 0
    if path.suffix == ".exr":
        names = ("Y", "A") if grey else ("R", "G", "B", "A")
        return write_exr(path, dict(zip(names, texels[1, 1].tolist(), strict=True)))
    texels = bytes_of(texels, top)
    if path.suffix != ".tif":
        return write_image(path, texels)
    return write_tiff(path, texels, extra)


def write_tiff(path: Path, texels: np.ndarray, extra: int | None) -> Path:
    """One strip without compression, big-endian: no library writes every value of ExtraSamples."""
    height, width, channels = texels.shape
    bits = texels.dtype.itemsize * 8
    tags = {256: [width], 257: [height], 258: [bits] * channels, 259: [1], 262: [2 if channels > 2 else 1]}
    tags |= {273: [0], 277: [channels], 278: [height], 279: [texels.nbytes]}
    tags |= {} if extra is None else {338: [extra]}
    start = 8 + 2 + 12 * len(tags) + 4
    tags[273] = [start + 2 * channels]
    body = b"MM\0*" + struct.pack(">IH", 8, len(tags))
    for tag, values in sorted(tags.items()):
        raw = struct.pack(f">{len(values)}H", *values)
        body += struct.pack(">HHI", tag, 3, len(values))
        body += raw.ljust(4, b"\0") if len(raw) <= 4 else struct.pack(">I", start)
    body += bytes(4) + struct.pack(f">{channels}H", *[bits] * channels)
    path.write_bytes(body + texels.astype(texels.dtype.newbyteorder(">")).tobytes())
    return path


@pytest.mark.parametrize(
    ("name", "kind", "multiplied", "asked"),
    [
        ("a_color.png", {}, False, None),
        *(("a_color.tif", {"extra": extra, "top": top}, extra == 1, None) for extra, top in ((1, 255), (2, 65535))),
        ("a_color.tif", {"extra": 1, "grey": True}, True, None),
        ("a_color.tif", {"extra": None}, False, None),
        ("a_color.exr", {}, True, None),
        ("a_color.exr", {"grey": True}, True, None),
        ("a_color.exr", {}, False, None),
        ("a_color.exr", {}, False, "straight"),
        ("a_color.png", {}, True, "premultiplied"),
        ("a_color.tif", {"extra": 1}, False, "straight"),
    ],
)
def test_colours_are_divided_by_alpha_where_the_file_says_so(name, kind, multiplied, asked, tmp_path):
    """Straight colours in an EXR exceed their alpha, which cannot be, so they are taken as they are."""
    write_alpha(tmp_path / name, multiplied, **kind)
    found = bake_colour(tmp_path, name, alpha=asked)
    wanted = COLOUR[:1].repeat(3) if kind.get("grey") else COLOUR
    wanted = wanted if name.endswith("exr") else srgb_to_linear(wanted)
    np.testing.assert_allclose(found.maps["base_color"].pixels[1:], np.broadcast_to(wanted, (3, 6, 3)), atol=0.015)
    np.testing.assert_allclose(found.maps["opacity"].pixels[1:], ALPHA, atol=0.005)
    assert any("are divided by it" in note for note in found.notes) == multiplied
    doubted = name.endswith("exr") and not multiplied and not asked
    assert any("exceed their alpha" in each for each in found.warnings) == doubted


def test_colours_that_this_program_wrote_are_not_divided(tmp_path: Path) -> None:
    """Colours in its EXR files are not multiplied by the alpha beside them."""
    write_image(tmp_path / "a_color.png", np.tile(np.array([30, 20, 10, 200], np.uint8), (4, 4, 1)))
    mipbake.bake(bake_colour(tmp_path, "a_color.png"), method="linear").save(tmp_path / "out")
    (path,) = (each for each in (tmp_path / "out").glob("*color*.exr"))
    (tmp_path / "b_color.exr").write_bytes(path.read_bytes())
    again = bake_colour(tmp_path, "b_color.exr").maps["base_color"].pixels
    np.testing.assert_allclose(again[0, 0], srgb_to_linear(np.array([30, 20, 10]) / 255), rtol=0.01)


@pytest.mark.parametrize(
    ("parts", "role", "values"),
    [
        ([{"A": 1, "AO.x": 0.75, **RGB, "Z": 7}], "base_color", (0.5, 0.25, 0.125, 1)),
        ([{"B": 0.125, "G": 0.25, "R": 0.5}], "base_color", (0.5, 0.25, 0.125)),
        ([{"Y": 0.5, "A": 1}], "base_color", (0.5, 1)),
        ([{"Z": 0.5}], "height", (0.5,)),
        ([{"A": 0.5}], "opacity", (0.5,)),
        ([{"normal.X": 0.5, "normal.Y": 0.25, "normal.Z": 0.125}], "normal", (0.5, 0.25, 0.125)),
        ([{"albedo.R": 0.1, "albedo.G": 0.1, "albedo.B": 0.1, "roughness.R": 0.5}], "roughness", (0.5,)),
        ([{**RGB, "roughness": 0.75}], "roughness", (0.75,)),
        ([{**RGB, "roughness": 0.75}], "base_color", (0.5, 0.25, 0.125)),
        ([RGB, {"Y": 0.75}], "roughness", (0.75,)),
    ],
)
def test_channels_of_exr_are_known_by_their_names(parts, role, values, tmp_path):
    names = ["diffuse", "roughness"] if len(parts) > 1 else []
    path = write_exr(tmp_path / "a.exr", *parts, names=names)
    header = read_header(path, role)
    image = read_image(path, (header.declared.part, header.declared.layer))
    assert image.header == header and header.channels == len(values)
    np.testing.assert_allclose(image.pixels, np.broadcast_to(values, image.pixels.shape), atol=1e-3)


@pytest.mark.parametrize(
    ("parts", "message"),
    [
        ([{"Y": 0.5, "RY": 0.1, "BY": 0.1}], "Y, RY, BY.*expected channels R, G and B"),
        ([{"first.R": 0.5, "second.R": 0.5}], r"has several layers \(first, second\), and no name says"),
        ([{"R": 0.5}, {"R": 0.5}], r"has several layers \(left, right\), and no name says"),
        ([{"foo": 0.5, "bar": 0.5}], r"has several layers \(bar, foo\)"),
    ],
)
def test_layers_that_no_name_tells_apart_are_listed(parts: list[Channels], message: str, tmp_path: Path) -> None:
    names = ["left", "right"] if len(parts) > 1 else []
    path = write_exr(tmp_path / "a.exr", *parts, names=names)
    with pytest.raises(InputError, match=message):
        read_header(path, "roughness")


def test_roles_take_their_layers_of_one_file(tmp_path: Path) -> None:
    write_exr(tmp_path / "set.exr", {"albedo.R": 0.5, "albedo.G": 0.25, "albedo.B": 0.125, "roughness.R": 0.75})
    maps = {"base_color": "set.exr", "roughness": "set.exr", "normal": None}
    found = mipbake.load(tmp_path, maps=maps)
    np.testing.assert_allclose(found.maps["base_color"].pixels[0, 0], (0.5, 0.25, 0.125), atol=1e-3)
    np.testing.assert_allclose(found.maps["roughness"].pixels, 0.75, atol=1e-3)
    assert "set.exr: its layer roughness is taken, and not albedo" in found.notes


def test_channels_that_store_fewer_texels_are_refused(tmp_path: Path) -> None:
    path = write_exr(tmp_path / "a.exr", RGB)
    data = path.read_bytes()
    at = data.index(b"B\0\1\0\0\0") + 10
    path.write_bytes(data[:at] + struct.pack("<ii", 2, 2) + data[at + 8 :])
    with pytest.raises(InputError, match=r"a\.exr is not a readable \.exr image"):
        read_header(path)


@pytest.mark.parametrize(
    ("window", "size", "inside", "told"),
    [
        ((2, 1, 10, 8), (10, 8), (slice(1, 5), slice(2, 8)), "the rest of it is zero"),
        ((-1, -1, 4, 2), (4, 2), (slice(None), slice(None)), "to which it is cut"),
        ((-2, 1, 6, 4), (6, 4), (slice(1, 4), slice(0, 4)), "the rest of it is zero"),
    ],
)
def test_the_display_window_is_the_texture(window, size, inside, told, tmp_path):
    write_exr(tmp_path / "a_color.exr", RGB, window=window)
    found = bake_colour(tmp_path, "a_color.exr")
    pixels = found.maps["base_color"].pixels
    assert pixels.shape[1::-1] == size and any(told in each for each in (*found.notes, *found.warnings))
    wanted = np.zeros(pixels.shape)
    wanted[inside] = tuple(RGB.values())
    np.testing.assert_allclose(pixels, wanted, atol=1e-3)


def test_windows_without_sense_are_refused(tmp_path: Path) -> None:
    for window in ((10, 0, 8, 8), (0, 0, 1 << 20, 1 << 20)):
        path = write_exr(tmp_path / "a.exr", RGB, window=window)
        with pytest.raises(InputError, match=r"a\.exr stores 6 x 4 texels at .* expected a data window within"):
            read_header(path)
    write_exr(tmp_path / "a_normal.exr", {"R": 0.5, "G": 0.5, "B": 1.0}, window=(1, 1, 8, 6))
    with pytest.raises(InputError, match=r"a_normal\.exr stores a part of its display window.* no normal"):
        mipbake.load([tmp_path / "a_normal.exr"], maps={"roughness": 0.5, "base_color": None})


@pytest.mark.parametrize(
    ("corner", "kind", "alpha", "note"),
    [
        *((0, 1, "straight", True), (0x10, 3, "straight", False)),
        *((0x20, 4, "premultiplied", False), (0x30, 4, "premultiplied", False)),
    ],
)
def test_what_targa_says(corner: int, kind: int, alpha: str, note: bool, tmp_path: Path) -> None:
    """The corner that texels begin in, and the kind of alpha."""
    image = np.arange(24, dtype=np.uint8).reshape(2, 3, 4)
    stored = image[:: 1 if corner & 0x20 else -1, :: -1 if corner & 0x10 else 1, [2, 1, 0, 3]]
    head = bytes([0, 0, 2, *bytes(9)]) + struct.pack("<HH", 3, 2) + bytes([32, corner | 8])
    data = head + np.ascontiguousarray(stored).tobytes()
    extension = struct.pack("<H", 495) + bytes(492) + bytes([kind])
    path = tmp_path / "a.tga"
    path.write_bytes(data + extension + struct.pack("<II", len(data), 0) + b"TRUEVISION-XFILE.\0")
    found = read_image(path)
    np.testing.assert_array_equal(found.pixels, image)
    assert (found.header.declared.alpha, bool(found.header.declared.notes)) == (alpha, note)


def test_channels_without_a_meaning_are_told(tmp_path: Path) -> None:
    write_alpha(tmp_path / "a_color.tif", False, extra=0)
    found = bake_colour(tmp_path, "a_color.tif")
    assert "opacity" not in found.maps
    assert "a_color.tif: the file does not say what is in its channels channel3: they are left out" in found.notes
