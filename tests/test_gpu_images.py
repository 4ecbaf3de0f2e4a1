"""KTX 2, DDS, AVIF and WebP as sources: texels, orientation, swizzle, alpha, colours, what is not one image."""

from __future__ import annotations

import struct
import zlib
from pathlib import Path

import numpy as np
import pytest

import mipbake
from mipbake.base.errors import InputError
from mipbake.source.images import dds, ktx2
from mipbake.source.images.blocks import to_blocks
from mipbake.source.images.gpu_format import GPU_FORMATS, READ_FORMATS, GpuTexture
from mipbake.source.images.read import read_header, read_image

from .input_files import encoded, height_field, plain_set, write_image

alktx2 = pytest.importorskip("alktx2", reason="the library of Basis Universal has no build for this Python")
pillow = pytest.importorskip("PIL.Image")


ONLY_READ = ("BC1_RGBA", "BC2", "BC3", "UASTC_RRRG")
"""Beginnings of formats that nothing here encodes as they are."""


def smooth(height: int = 16, width: int = 20, channels: int = 3) -> np.ndarray:
    """(H, W, C) uint8 that block compression keeps well."""
    v, u = np.meshgrid(np.arange(height) / height, np.arange(width) / width, indexing="ij")
    return np.stack([40 + 150 * u, 60 + 120 * v, 80 + 60 * u * v, 255 - 100 * u], -1)[..., :channels].astype(np.uint8)


def texture(name: str, levels: list[np.ndarray]) -> GpuTexture:
    made = READ_FORMATS[name]
    data = [level.astype(np.float16) / 255 if made.is_float else level for level in levels]
    return GpuTexture(made, levels[0].shape[1], levels[0].shape[0], to_blocks(data, made), {})


def basis(pixels: np.ndarray, codec: str, srgb: bool = True) -> bytes:
    """A KTX 2 file by Basis Universal's own encoder."""
    height, width, channels = pixels.shape
    rgba = np.concatenate([pixels, np.full((height, width, 4 - channels), 255, np.uint8)], -1)
    return alktx2.encode_raw_mips_to_ktx2(
        [(np.ascontiguousarray(rgba).tobytes(), width, height)],
        has_alpha=channels == 4,
        codec=codec,
        quality=100,
        effort=2,
        srgb=srgb,
        linear=not srgb,
        threads=1,
        check_for_alpha=False,
        force_alpha=channels == 4,
    )


@pytest.mark.parametrize("name", [n for n in READ_FORMATS if not n.startswith(ONLY_READ)])
def test_level_0_of_every_format_is_read(name: str, tmp_path: Path) -> None:
    made = READ_FORMATS[name]
    level = smooth(channels=made.channels)
    path = tmp_path / "a.ktx2"
    coarser = np.zeros((8, 10, made.channels), np.uint8)
    path.write_bytes(ktx2.encoded(texture(name, [level, coarser]), "SRGB" in name))
    image = read_image(path)
    header = image.header
    assert (header.width, header.height, header.channels) == (20, 16, made.channels)
    assert header == read_header(path) and header.is_integer != made.is_float
    assert header.alpha == (3 if made.channels == 4 else -1)
    assert header.colour_space == ("sRGB" if made.srgb else "linear Rec.709")
    found = image.pixels.astype(np.float32) * (255 if made.is_float else 1)
    assert np.abs(found - level).max() <= (0.2 if made.side == 1 else 20)
    if made.is_float and made.dxgi:
        (tmp_path / "a.dds").write_bytes(dds.encoded(texture(name, [level])))
        np.testing.assert_array_equal(read_image(tmp_path / "a.dds").pixels, image.pixels)


@pytest.mark.parametrize(("word", "ends"), [(0, 255), (1, 255), (2, 170), (3, 0)])
def test_bc1_with_alpha_and_bc2_are_read(word: int, ends: int, tmp_path: Path) -> None:
    """Blocks by hand: in BC1 whose first end is no greater, 3 is transparent; BC2 has 4 bits of alpha a texel."""
    grey = (16 << 11) | (32 << 5) | 16
    colour = grey.to_bytes(2, "little") * 2
    for name, block, alpha in (
        ("BC1_RGBA_UNORM_BLOCK", colour + bytes([word * 0x55] * 4), 0 if word == 3 else 255),
        ("BC2_UNORM_BLOCK", bytes([ends] * 8) + colour + bytes(4), ends),
    ):
        path = tmp_path / "a.ktx2"
        path.write_bytes(ktx2.encoded(GpuTexture(READ_FORMATS[name], 4, 4, (block,), {}), False))
        found = read_image(path)
        assert found.header.alpha == 3 and (found.pixels[..., 3] == alpha).all()
        assert alpha == 0 or (abs(found.pixels[..., :3].astype(int) - 131) <= 2).all()


@pytest.mark.parametrize("codec", ["uastc", "etc1s"])
@pytest.mark.parametrize("channels", [3, 4])
def test_basis_universal_is_transcoded(codec: str, channels: int, tmp_path: Path) -> None:
    path = tmp_path / "a.ktx2"
    pixels = smooth(channels=channels)
    path.write_bytes(basis(pixels, codec))
    image = read_image(path)
    assert image.pixels.shape == pixels.shape == (16, 20, channels)
    assert np.abs(image.pixels.astype(int) - pixels).mean() < (2 if codec == "uastc" else 8)


@pytest.mark.parametrize("channels", [1, 3, 4])
def test_avif_is_read(channels: int, tmp_path: Path) -> None:
    pixels = smooth(32, 32, channels)
    path = tmp_path / "a.avif"
    pillow.fromarray(pixels.squeeze()).save(path, quality=100, subsampling="4:4:4")
    image = read_image(path)
    kept = image.pixels[..., :channels]
    assert np.abs(kept.astype(int) - pixels).mean() < 2 and image.header.alpha == (3 if channels == 4 else -1)
    for share in (0.3, 0.9):
        path.write_bytes(path.read_bytes()[: int(path.stat().st_size * share)])
        with pytest.raises(InputError, match=r"a\.avif is damaged or cut short"):
            read_image(path)


@pytest.mark.parametrize("codec", ["uastc", "etc1s"])
def test_textures_that_are_cut_short_are_refused(codec: str, tmp_path: Path) -> None:
    data, path = basis(smooth(), codec), tmp_path / "a.ktx2"
    for share in (0.02, 0.1, 0.5, 0.9):
        path.write_bytes(data[: int(len(data) * share)])
        with pytest.raises(InputError, match=r"a\.ktx2") as error:
            read_image(path)
        assert "\n" not in str(error.value)


def test_sets_of_ktx2_and_webp_are_read(tmp_path: Path) -> None:
    normals = height_field(32, 32)
    folder = plain_set(tmp_path / "wood")
    for name in ("base_color", "normal_gl", "roughness"):
        (folder / f"{name}.png").unlink()
    (folder / "wood_basecolor.ktx2").write_bytes(
        ktx2.encoded(texture("BC7_SRGB_BLOCK", [smooth(32, 32), smooth(16, 16)]), True)
    )
    (folder / "wood_normal_gl.ktx2").write_bytes(
        ktx2.encoded(texture("BC5_UNORM_BLOCK", [encoded(normals)[..., :2]]), True)
    )
    write_image(folder / "wood_roughness.webp", np.repeat(smooth(32, 32, 1), 3, -1))
    found = mipbake.load(folder)
    assert "opacity" not in found.maps  # blocks of BC7 have an alpha that says nothing
    assert found.maps["base_color"].source.encoding == "sRGB"
    assert np.abs(found.maps["normal"].pixels - normals).mean() < 0.05
    assert not [text for text in found.warnings if "normals along the surface" not in text]


# ---- what files say of their images

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
