"""Reading files: every stored type comes back as it was written, every damage is refused in one sentence."""

from __future__ import annotations

import hashlib
import os
import struct
import sys
import zlib
from pathlib import Path

import numpy as np
import pytest

from mipbake.base.errors import InputError
from mipbake.source.images.read import read_header, read_image

from .input_files import write_image

INTEGERS = {"uint8": 255, "uint16": 65535}


@pytest.mark.parametrize(
    ("suffix", "depth", "channels"),
    [
        *(("png", "uint8", c) for c in (1, 2, 3, 4)),
        *(("png", "uint16", 3), ("tif", "uint8", 4), ("tif", "uint16", 1), ("tif", "float", 3), ("tga", "uint8", 4)),
        *(("exr", "half", 4), ("exr", "float", 1), ("bmp", "uint8", 3)),
    ],
)
def test_values_come_back_as_stored(suffix: str, depth: str, channels: int, tmp_path: Path) -> None:
    rng = np.random.default_rng(channels)
    shape = (5, 7, channels)
    if depth in INTEGERS:
        pixels = rng.integers(0, INTEGERS[depth], shape, endpoint=True).astype(depth)
    else:
        pixels = rng.normal(size=shape).astype(np.float16 if depth == "half" else np.float32)
    path = write_image(tmp_path / f"a.{suffix}", pixels, depth)
    image = read_image(path)
    np.testing.assert_array_equal(image.pixels, pixels)
    assert image.pixels.dtype == pixels.dtype
    header = read_header(path)
    assert header == image.header
    assert (header.width, header.height, header.channels, header.depth) == (7, 5, channels, depth)
    assert header.is_integer == (depth in INTEGERS)
    assert header.alpha == (channels - 1 if channels in (2, 4) else -1)
    assert image.sha256 == hashlib.sha256(path.read_bytes()).hexdigest()


def test_radiance_files_are_floats(tmp_path: Path) -> None:
    pixels = np.random.default_rng(0).random((8, 8, 3), np.float32) * 10
    image = read_image(write_image(tmp_path / "a.hdr", pixels, "float"))
    assert not image.header.is_integer
    np.testing.assert_allclose(image.pixels, pixels, atol=10 / 128)


def noise_file(folder: Path, suffix: str) -> Path:
    """An image of noise, so that no compressor makes it small."""
    pixels = np.random.default_rng(0).random((64, 64, 3)).astype(np.float32)
    is_float = suffix in ("exr", "hdr")
    return write_image(folder / f"a.{suffix}", pixels if is_float else (pixels * 255).astype(np.uint8))


@pytest.mark.parametrize("suffix", ["png", "jpg", "tif", "exr", "hdr", "webp", "tga", "bmp"])
def test_broken_files_are_refused(suffix: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    path = noise_file(tmp_path, suffix)
    whole = path.read_bytes()
    broken = [whole[: int(len(whole) * share)] for share in (0.3, 0.6, 0.9)] + [b"", b"roughness = 0.5\n" * 50]
    if suffix == "png":
        half = len(whole) // 2
        broken.append(whole[:half] + bytes([whole[half] ^ 1]) + whole[half + 1 :])
    for data in broken:
        path.write_bytes(data)
        what = r"(damaged or )?cut short|not a readable|empty|damaged \(checksum of IDAT"
        with pytest.raises(InputError, match=rf"a\.{suffix} is ({what})") as error:
            read_image(path)
        assert "\n" not in str(error.value)
    assert capfd.readouterr() == ("", "")


def png(width: int, height: int) -> bytes:
    """A grey 8-bit PNG of zeros, of any size that its header can state."""

    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    header = struct.pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0)
    rows = zlib.compress(bytes(height * (width + 1)))
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", rows) + chunk(b"IEND", b"")


def test_images_without_texels_are_refused(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "a.png"
    path.write_bytes(png(4, 4))
    assert read_header(path).width == 4
    for width, height in ((0, 4), (4, 0)):
        path.write_bytes(png(width, height))
        with pytest.raises(InputError, match=rf"a\.png is {width} x {height} texels"):
            read_header(path)
    assert capfd.readouterr() == ("", "")


def test_nan_and_infinity_are_counted_and_located(tmp_path: Path) -> None:
    pixels = np.zeros((6, 8, 3), np.float32)
    pixels[2, 5, 1] = np.nan
    pixels[4, 0, 0] = np.inf
    pixels[5, 7, 2] = -np.inf
    path = write_image(tmp_path / "a.exr", pixels, "half")
    with pytest.raises(InputError, match=r"a\.exr holds 3 NaN or infinite values.* row 2, column 5, channel 1"):
        read_image(path)
    pixels[4:] = 0
    with pytest.raises(InputError, match=r"holds 1 NaN or infinite value,"):
        read_image(write_image(tmp_path / "a.exr", pixels, "half"))


@pytest.mark.skipif(sys.platform != "linux", reason="other systems have no such names")
def test_a_name_that_is_not_utf8_is_refused(tmp_path: Path) -> None:
    path = write_image(tmp_path / "a.png", np.zeros((2, 2, 3), np.uint8))
    path = path.rename(tmp_path / os.fsdecode(b"caf\xe9.png"))
    for read in (read_header, read_image):
        with pytest.raises(InputError, match=r"caf\\xe9\.png is not UTF-8: rename"):
            read(path)


def test_a_file_that_is_gone_is_refused(tmp_path: Path) -> None:
    for read in (read_header, read_image):
        with pytest.raises(InputError, match=r"a\.png cannot be read"):
            read(tmp_path / "a.png")


@pytest.mark.parametrize(
    ("suffix", "depth", "tile"),
    [("png", "uint16", 0), ("jpg", "uint8", 0), ("tif", "uint8", 0), ("tif", "uint8", 16), ("exr", "half", 16)],
)
def test_an_image_is_the_same_in_bands_of_rows(tmp_path, monkeypatch, suffix, depth, tile) -> None:
    """Tiled too, and where the texels of an EXR file do not begin at its origin."""
    import OpenImageIO as oiio  # noqa: N813

    path, values = tmp_path / f"a.{suffix}", np.random.default_rng(0).random((53, 37, 3), np.float32)
    spec = oiio.ImageSpec(37, 53, 3, depth)
    spec.tile_width = spec.tile_height = tile
    if suffix == "exr":
        spec.x, spec.y, spec.full_x, spec.full_y, spec.full_width, spec.full_height = 5, 7, 5, 7, 37, 53
    out = oiio.ImageOutput.create(str(path))
    assert out.open(str(path), spec) and out.write_image(values) and out.close(), out.geterror()
    whole = read_image(path).pixels
    assert whole.shape == (53, 37, 3) and np.ptp(whole.astype(float)) > 0.5
    monkeypatch.setattr("mipbake.source.images.read.AT_ONCE", 1)
    np.testing.assert_array_equal(read_image(path).pixels, whole)
