"""KTX 2, AVIF and WebP as sources, alone and in glTF documents."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import mipbake
from mipbake.base.errors import InputError
from mipbake.cli.main import main
from mipbake.source.images import dds, ktx2
from mipbake.source.images.blocks import to_blocks
from mipbake.source.images.gpu_format import GPU_FORMATS, READ_FORMATS, GpuTexture
from mipbake.source.images.read import read_header, read_image

from .gltf_files import GltfFile, check_structure
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


@pytest.mark.parametrize("supercompress", [False, True])
@pytest.mark.parametrize("name", [n for n in READ_FORMATS if not n.startswith(ONLY_READ)])
def test_level_0_of_every_format_is_read(name: str, supercompress: bool, tmp_path: Path) -> None:
    made = READ_FORMATS[name]
    level = smooth(channels=made.channels)
    path = tmp_path / "a.ktx2"
    coarser = np.zeros((8, 10, made.channels), np.uint8)
    path.write_bytes(ktx2.encoded(texture(name, [level, coarser]), supercompress))
    image = read_image(path)
    header = image.header
    assert (header.width, header.height, header.channels) == (20, 16, made.channels)
    assert header == read_header(path) and header.is_integer != made.is_float
    assert header.alpha == (3 if made.channels == 4 else -1)
    assert header.colour_space == ("sRGB" if made.srgb else "linear Rec.709")
    found = image.pixels.astype(np.float32) * (255 if made.is_float else 1)
    assert np.abs(found - level).max() <= (0.2 if made.side == 1 else 20)


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


@pytest.mark.parametrize("name", ["BC3_UNORM_BLOCK", "BC3_SRGB_BLOCK"])
def test_bc3_is_read(name: str, tmp_path: Path) -> None:
    """A block of it is one of BC4, for alpha, and one of BC1."""
    level = smooth(channels=4)
    alpha, colour = (
        np.frombuffer(to_blocks([part], GPU_FORMATS[f"{kind}_BLOCK"])[0], np.uint8).reshape(-1, 8)
        for kind, part in (("BC4_UNORM", level[..., 3:]), ("BC1_RGB_UNORM", level[..., :3]))
    )
    blocks = np.concatenate([alpha, colour], 1).tobytes()
    path = tmp_path / "a.ktx2"
    path.write_bytes(ktx2.encoded(GpuTexture(READ_FORMATS[name], 20, 16, (blocks,), {}), False))
    assert np.abs(read_image(path).pixels.astype(int) - level).max() <= 20


@pytest.mark.parametrize("codec", ["uastc", "etc1s"])
@pytest.mark.parametrize("channels", [3, 4])
def test_basis_universal_is_transcoded(codec: str, channels: int, tmp_path: Path) -> None:
    path = tmp_path / "a.ktx2"
    pixels = smooth(channels=channels)
    path.write_bytes(basis(pixels, codec))
    image = read_image(path)
    assert image.pixels.shape == pixels.shape == (16, 20, channels)
    assert np.abs(image.pixels.astype(int) - pixels).mean() < (2 if codec == "uastc" else 8)


def test_dds_of_half_floats_are_read(tmp_path: Path) -> None:
    name = next(n for n, made in GPU_FORMATS.items() if made.is_float and made.channels == 4)
    path = tmp_path / "a.dds"
    path.write_bytes(dds.encoded(texture(name, [smooth(channels=4)])))
    assert np.abs(read_image(path).pixels.astype(np.float32) * 255 - smooth(channels=4)).max() < 0.2


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


def test_uastc_with_broken_blocks_is_read_or_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "a.ktx2"
    path.write_bytes(basis(smooth(), "uastc"))

    def fails(*_arguments: object, **_options: object) -> None:
        raise RuntimeError("transcode_image_level() failed")

    monkeypatch.setattr(alktx2, "decode_ktx2_to_bytes", fails)
    with pytest.raises(InputError, match=r"a\.ktx2 cannot be decoded: transcode_image_level"):
        read_image(path)


@pytest.mark.parametrize("data", [basis(smooth(), "etc1s"), basis(smooth(), "uastc")], ids=["etc1s", "uastc"])
@pytest.mark.parametrize("share", [0.02, 0.1, 0.5, 0.9])
def test_textures_that_are_cut_short_are_refused(data: bytes, share: float, tmp_path: Path) -> None:
    path = tmp_path / "a.ktx2"
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


def test_what_a_texture_says_of_its_colours_gives_way_to_its_name_and_to_options(tmp_path: Path) -> None:
    folder = plain_set(tmp_path)
    (folder / "base_color.png").unlink()
    path = folder / "base_color.ktx2"
    path.write_bytes(ktx2.encoded(texture("R8G8B8A8_UNORM", [smooth()]), False))
    assert mipbake.load(folder).maps["base_color"].source.encoding == "linear Rec.709"
    assert mipbake.load(folder, colour_space="sRGB").maps["base_color"].source.encoding == "sRGB"
    path.rename(folder / "base_color_srgb.ktx2")
    assert mipbake.load(folder).maps["base_color"].source.encoding == "sRGB"


@pytest.mark.long
@pytest.mark.parametrize("codec", ["uastc", "etc1s"])
def test_documents_of_compressed_textures_bake(codec: str, tmp_path: Path) -> None:
    made = GltfFile()
    maps = {"base": smooth(32, 32), "normal": encoded(height_field(32, 32)), "mr": smooth(32, 32)}
    for name, pixels in maps.items():
        image = made.image(basis(pixels, codec, name == "base"), name, "image/ktx2")
        made.json["textures"].append({"extensions": {"KHR_texture_basisu": {"source": image}}})
    made.json["extensionsUsed"] = made.json["extensionsRequired"] = ["KHR_texture_basisu"]
    made.material(
        "wood",
        normalTexture={"index": 1},
        pbrMetallicRoughness={"baseColorTexture": {"index": 0}, "metallicRoughnessTexture": {"index": 2}},
    )
    found = mipbake.load(made.write(tmp_path / "wood"))
    assert found.maps["base_color"].source.encoding == "sRGB"
    error = np.abs(found.maps["roughness"].pixels[..., 0] * 255 - maps["mr"][..., 1])
    assert error.mean() < (2 if codec == "uastc" else 8)
    given = ["bake", str(tmp_path / "wood.glb"), "-o", str(tmp_path / "out"), "--method", "linear", "--format", "glb"]
    assert main([*given, "-q"]) == 0
    written, _ = check_structure((tmp_path / "out" / "wood.glb").read_bytes())
    assert written["materials"][0]["name"] == "wood" and len(written["images"]) == 3
