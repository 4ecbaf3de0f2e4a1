"""What KTX 2 and DDS files say of their images: orientation, swizzle, alpha, colours, what is not one image."""

from __future__ import annotations

import struct
import zlib
from pathlib import Path

import numpy as np
import pytest

import mipbake
from mipbake.cli.main import main
from mipbake.source.images import dds, ktx2
from mipbake.source.images.blocks import to_blocks
from mipbake.source.images.gpu_format import GPU_FORMATS, READ_FORMATS, GpuTexture
from mipbake.source.images.read import read_header, read_image

from .input_files import encoded, height_field, plain_set
from .test_other_images import basis, smooth

RGBA = smooth(8, 12, 4)
MODEL, PRIMARIES, TRANSFER, FLAGS, CHANNEL = 12, 13, 14, 15, 31
"""Bytes after the beginning of a descriptor."""


def ktx2_of(pixels: np.ndarray, name: str = "R8G8B8A8_UNORM", **values: bytes) -> bytes:
    made = READ_FORMATS[name]
    blocks = to_blocks([pixels], made)
    return ktx2.encoded(GpuTexture(made, pixels.shape[1], pixels.shape[0], blocks, values), False)


def dds_of(pixels: np.ndarray, alpha: int) -> bytes:
    made = GPU_FORMATS["R8G8B8A8_UNORM"]
    data = dds.encoded(GpuTexture(made, pixels.shape[1], pixels.shape[0], to_blocks([pixels], made), {}))
    return data[:144] + struct.pack("<I", alpha) + data[148:]


def dxt4_of(pixels: np.ndarray) -> bytes:
    """An older header; blocks of BC3 are one of BC4 for alpha and one of BC1."""
    alpha, colour = (
        np.frombuffer(to_blocks([part], GPU_FORMATS[f"{kind}_BLOCK"])[0], np.uint8).reshape(-1, 8)
        for kind, part in (("BC4_UNORM", pixels[..., 3:]), ("BC1_RGB_UNORM", pixels[..., :3]))
    )
    head = dds_of(pixels, 0)[:128]
    return head[:84] + b"DXT4" + head[88:] + np.concatenate([alpha, colour], 1).tobytes()


def patched(data: bytes, **bytes_of_descriptor: int) -> bytes:
    out = bytearray(data)
    (at,) = struct.unpack_from("<I", data, 48)
    for name, value in bytes_of_descriptor.items():
        out[at + globals()[name]] = value
    return bytes(out)


def with_colour(folder: Path, data: bytes, suffix: str) -> mipbake.TextureSet:
    """A set with a base colour of these bytes, and nothing else that speaks of colours."""
    plain_set(folder)
    (folder / "base_color.png").unlink()
    (folder / f"base_color.{suffix}").write_bytes(data)
    return mipbake.load(folder)


@pytest.mark.parametrize(
    ("told", "rows", "columns"), [("rd", 1, 1), ("ld", 1, -1), ("lu", -1, -1), ("ru", -1, 1), ("S=r,T=d", 1, 1)]
)
def test_orientations_turn_texels_alone(told: str, rows: int, columns: int, tmp_path: Path) -> None:
    normals = encoded(height_field(32, 32))
    stored = np.concatenate([normals, normals[..., :1]], -1)[::rows, ::columns]
    plain_set(tmp_path)
    (tmp_path / "normal_gl.png").unlink()
    (tmp_path / "normal_gl.ktx2").write_bytes(ktx2_of(stored, KTXorientation=told.encode() + b"\0"))
    found = mipbake.load(tmp_path)
    np.testing.assert_allclose(found.maps["normal"].pixels, height_field(32, 32), atol=0.02)
    np.testing.assert_array_equal(read_image(tmp_path / "normal_gl.ktx2").pixels[..., :3], normals)
    assert any("KTXorientation" in warning for warning in found.warnings) == (told == "S=r,T=d")


@pytest.mark.parametrize(
    ("name", "told", "wanted", "alpha"),
    [
        ("R8G8B8A8_UNORM", "bgra", (2, 1, 0, 3), 3),
        ("R8G8B8A8_UNORM", "rgb1", (0, 1, 2), -1),
        ("R8G8B8A8_UNORM", "rgba", (0, 1, 2, 3), 3),
        ("R8G8B8A8_UNORM", "ga01", (1, 3), -1),
        ("R8G8B8A8_UNORM", "rrrg", (0, 1), 1),
        ("R8G8B8A8_UNORM", "aaa1", (3,), -1),
        ("R8G8B8A8_UNORM", "xyz", (0, 1, 2, 3), 3),
        ("R8G8_UNORM", "rrrg", (0, 1), 1),
        ("R8G8_UNORM", "gr01", (1, 0), -1),
        ("R8_UNORM", "rrr1", (0,), -1),
    ],
)
def test_swizzles(name: str, told: str, wanted: tuple[int, ...], alpha: int, tmp_path: Path) -> None:
    path = tmp_path / "a.ktx2"
    path.write_bytes(ktx2_of(RGBA[..., : READ_FORMATS[name].channels], name, KTXswizzle=told.encode() + b"\0"))
    image = read_image(path)
    np.testing.assert_array_equal(image.pixels, RGBA[..., wanted])
    assert (image.header.channels, image.header.alpha) == (len(wanted), alpha) and image.header == read_header(path)
    assert bool(image.header.declared.warnings) == (told == "xyz")


@pytest.mark.parametrize(
    ("suffix", "data", "opacity", "colour"),
    [
        ("ktx2", lambda seen: patched(ktx2_of(seen), FLAGS=1, TRANSFER=2), True, "divided"),
        ("ktx2", lambda seen: patched(ktx2_of(seen), TRANSFER=2), True, "stored"),
        ("dds", lambda seen: dds_of(seen, 0), True, "stored"),
        ("dds", lambda seen: dds_of(seen, 1), True, "stored"),
        ("dds", lambda seen: dds_of(seen, 2), True, "divided"),
        ("dds", lambda seen: dds_of(seen, 3), False, "stored"),
        ("dds", lambda seen: dds_of(seen, 4), False, "stored"),
        ("dds", dxt4_of, True, "divided"),
    ],
)
def test_alpha(suffix: str, data: object, opacity: bool, colour: str, tmp_path: Path) -> None:
    seen = RGBA.copy()
    seen[..., :3] = RGBA[..., :3] * (RGBA[..., 3:] / 255.0)
    found = with_colour(tmp_path, data(seen), suffix)
    assert ("opacity" in found.maps) == opacity
    values = found.maps["base_color"].pixels.mean()
    wanted = mipbake.load(plain_set(tmp_path / "png", base_color=RGBA if colour == "divided" else seen[..., :3]))
    assert values == pytest.approx(wanted.maps["base_color"].pixels.mean(), abs=0.01)
    assert any("divided" in note for note in found.notes) == (colour == "divided")


@pytest.mark.parametrize(
    ("primaries", "transfer", "wanted"),
    [
        (1, 2, "sRGB"),
        (1, 1, "linear Rec.709"),
        (0, 1, "linear Rec.709"),
        (0, 0, "sRGB"),
        (1, 0, "sRGB"),
        (10, 2, "Display P3"),
        (11, 18, "Adobe RGB (1998)"),
        (4, 1, "linear ITU-R BT.2020"),
        (7, 1, "ACEScg"),
        (4, 10, "transfer: PQ, primaries: Rec.2020"),
        (10, 0, "primaries: P3"),
        (1, 99, "transfer: code 99"),
    ],
)
def test_colours(primaries: int, transfer: int, wanted: str, tmp_path: Path) -> None:
    found = with_colour(tmp_path, patched(ktx2_of(RGBA), PRIMARIES=primaries, TRANSFER=transfer), "ktx2")
    told = [text for text in found.warnings if "its data format descriptor says colours that are not known" in text]
    assert found.maps["base_color"].source.encoding == ("sRGB" if told else wanted)
    assert all(wanted in text for text in told) and bool(told) == (":" in wanted)


@pytest.mark.parametrize("codec", ["uastc", "etc1s"])
def test_red_thrice_and_green_in_alpha_are_two_channels(codec: str, tmp_path: Path) -> None:
    normals = height_field(32, 32, steepness=0.2)
    rg = encoded(normals)[..., :2]
    data = bytearray(basis(rg[..., [0, 0, 0, 1]], codec, srgb=False))
    (at,) = struct.unpack_from("<I", data, 48)
    for sample, channel in enumerate((5,) if codec == "uastc" else (3, 4)):
        data[at + CHANNEL + 16 * sample] = channel
    plain_set(tmp_path)
    (tmp_path / "normal_gl.png").unlink()
    (tmp_path / "normal_gl.ktx2").write_bytes(data)
    found = mipbake.load(tmp_path)
    assert found.maps["normal"].source.channels == "RG"
    assert np.abs(found.maps["normal"].pixels - normals).mean() < (0.04 if codec == "uastc" else 0.06)


def test_levels_of_zlib(tmp_path: Path) -> None:
    data = ktx2_of(RGBA)
    at, length, _ = struct.unpack_from("<3Q", data, 80)
    stream = zlib.compress(data[at : at + length])
    packed = data[:44] + struct.pack("<I", 3) + data[48:80] + struct.pack("<3Q", at, len(stream), length)
    (tmp_path / "a.ktx2").write_bytes(packed + data[104:at] + stream)
    np.testing.assert_array_equal(read_image(tmp_path / "a.ktx2").pixels, RGBA)


@pytest.mark.parametrize(
    ("suffix", "place", "value", "told"),
    [
        ("ktx2", 36, 6, "holds a cube map of 6 faces: extract one face"),
        ("ktx2", 32, 4, "holds an array of 4 layers"),
        ("ktx2", 28, 3, "holds a 3D texture of 3 slices"),
        ("ktx2", 12, 91, "has texels of Vulkan format 91, which are not decoded here"),
        ("dds", 112, 0xFE00, "holds a cube map: extract one face"),
        ("dds", 140, 2, "holds an array of 2 layers"),
    ],
)
def test_what_is_not_one_image_is_refused_by_its_name(
    suffix: str, place: int, value: int, told: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    data = ktx2_of(RGBA) if suffix == "ktx2" else dds_of(RGBA, 0)
    plain_set(tmp_path / "wood")
    (tmp_path / "wood" / "base_color.png").unlink()
    path = tmp_path / "wood" / f"base_color.{suffix}"
    path.write_bytes(data[:place] + struct.pack("<I", value) + data[place + 4 :])
    assert main(["inspect", str(tmp_path / "wood")]) == 3
    (line,) = capsys.readouterr().err.strip().splitlines()
    assert told in line and path.name in line
