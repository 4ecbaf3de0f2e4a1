"""What files say of their colours: PNG chunks, ICC profiles, code points, names and chromaticities."""

from __future__ import annotations

import struct
import zlib
from functools import cache
from pathlib import Path

import numpy as np
import pytest

import mipbake
from mipbake.base.colour import LINEAR
from mipbake.base.colour_science import colour_science

pillow = pytest.importorskip("PIL.Image")

TEXELS = np.random.default_rng(0).integers(100, 140, (8, 8, 3)).astype(np.uint8)
P3, ADOBE, REC2020 = "Display P3", "Adobe RGB (1998)", "ITU-R BT.2020"


def chunk(kind: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


def with_chunks(path: Path, texels: np.ndarray, chunks: bytes) -> Path:
    """A PNG with these chunks after its header, and none of what the writer says of colours."""
    pillow.fromarray(texels).save(path)
    data = path.read_bytes()
    path.write_bytes(data[:33] + chunks + data[33:])
    return path


def gamma(value: int) -> bytes:
    return chunk(b"gAMA", struct.pack(">I", value))


def chromaticities(*values: float) -> bytes:
    """White, red, green, blue."""
    return chunk(b"cHRM", struct.pack(">8I", *(round(value * 100000) for value in values)))


CICP_P3 = chunk(b"cICP", bytes([12, 13, 0, 1]))
CHRM_ADOBE = chromaticities(0.3127, 0.329, 0.64, 0.33, 0.21, 0.71, 0.15, 0.06)
CHRM_P3 = chromaticities(0.3127, 0.329, 0.68, 0.32, 0.265, 0.69, 0.15, 0.06)
SRGB = chunk(b"sRGB", b"\0")


@cache
def profile(space: str, curve: bytes, broken: bool = False) -> bytes:
    """A profile of three curves and the primaries of a space, as colour-science has them."""
    library = colour_science("a test")
    found = library.RGB_COLOURSPACES[space]
    d50 = np.array([0.9642, 1, 0.8249])
    white = library.xy_to_XYZ(found.whitepoint)
    adapted = library.adaptation.matrix_chromatic_adaptation_VonKries(white, d50, "Bradford") @ found.matrix_RGB_to_XYZ
    tags = {b"desc": b"desc\0\0\0\0" + struct.pack(">I", 4) + b"own\0"}
    for index, name in enumerate(b"rgb"):
        tags[bytes([name]) + b"XYZ"] = b"XYZ \0\0\0\0" + struct.pack(
            ">3i", *np.rint(adapted[:, index] * 65536).astype(int)
        )
        tags[bytes([name]) + b"TRC"] = curve
    at, table, body = 132 + 12 * len(tags), b"", b""
    for name, data in tags.items():
        padded = data + bytes(-len(data) % 4)
        table += struct.pack(">4sII", name, at + len(body), len(data))
        body += padded
    head = bytearray(128)
    head[:4] = struct.pack(">I", at + len(body))
    head[8:24] = b"\2\x10\0\0mntrRGB XYZ "
    head[36:40] = b"acsp"
    head[68:80] = struct.pack(">3i", *(round(v * 65536) for v in d50))
    whole = bytes(head) + struct.pack(">I", len(tags)) + table + body
    return whole[:200] if broken else whole


def power(exponent: float) -> bytes:
    return b"curv\0\0\0\0" + struct.pack(">IH", 1, round(exponent * 256)) + b"\0\0"


S = b"para\0\0\0\0\0\3\0\0" + struct.pack(
    ">5i", *(round(v * 65536) for v in (2.4, 1 / 1.055, 0.055 / 1.055, 1 / 12.92, 0.04045))
)
STRAIGHT = b"curv\0\0\0\0\0\0\0\0"
ADOBE_CURVE = power(563 / 256)
TABLE_2020 = b"curv\0\0\0\0" + struct.pack(
    ">I1024H",
    1024,
    *(
        round(65535 * (x / 4.5 if x < 0.0812 else ((x + 0.0993) / 1.0993) ** (1 / 0.45)))
        for x in np.linspace(0, 1, 1024)
    ),
)


def iccp(data: bytes) -> bytes:
    return chunk(b"iCCP", b"own\0\0" + zlib.compress(data))


def load(path: Path, **options: object) -> mipbake.TextureSet:
    return mipbake.load([path], maps={"roughness": 0.5, "normal": None}, **options)


@pytest.mark.parametrize(
    ("chunks", "encoding"),
    [
        (b"", "sRGB"),
        (SRGB, "sRGB"),
        (SRGB + gamma(100000), "sRGB"),
        (gamma(45455), "sRGB"),
        (gamma(100000), LINEAR),
        (gamma(100000) + CHRM_P3, "linear Display P3"),
        (gamma(45455) + CHRM_P3, P3),
        (gamma(45455) + CHRM_ADOBE, ADOBE),
        (CHRM_ADOBE, "sRGB"),
        (CICP_P3, P3),
        (CICP_P3 + SRGB + gamma(100000), P3),
        (chunk(b"cICP", bytes([9, 8, 0, 1])), "linear ITU-R BT.2020"),
        (chunk(b"cICP", bytes([9, 14, 0, 1])), REC2020),
        (chunk(b"cICP", bytes([2, 2, 0, 1])), "sRGB"),
        (iccp(profile(ADOBE, ADOBE_CURVE)), ADOBE),
        (iccp(profile(P3, S)) + gamma(100000), P3),
        (iccp(profile("sRGB", S)), "sRGB"),
        (iccp(profile("sRGB", STRAIGHT)), LINEAR),
        (iccp(profile("ACEScg", STRAIGHT)), "ACEScg"),
        (iccp(profile(REC2020, TABLE_2020)), REC2020),
    ],
)
def test_chunks_of_png_in_their_order(chunks: bytes, encoding: str, tmp_path: Path) -> None:
    alpha = np.full((8, 8, 1), 128, np.uint8)
    for texels in (TEXELS, TEXELS[..., 0], np.concatenate([TEXELS, alpha], -1)):
        path = with_chunks(tmp_path / "a_color.png", texels, chunks)
        found = load(path)
        assert found.maps["base_color"].source.encoding == encoding and not found.warnings
        assert any(f"says {encoding}" in note for note in found.notes) == (encoding != "sRGB")
    assert load(path, colour_space="ACEScg").maps["base_color"].source.encoding == "ACEScg"


@pytest.mark.parametrize(
    ("chunks", "words"),
    [
        (gamma(55556), "its chunk gAMA says colours that are not known here (transfer: gamma 1.8)"),
        (chunk(b"cICP", bytes([9, 16, 0, 1])), "its chunk cICP says colours .*transfer: PQ, primaries: Rec.2020"),
        (iccp(profile("ProPhoto RGB", power(1.8))), "its ICC profile (own) says colours"),
        (iccp(profile(P3, S, True)), "its ICC profile says colours"),
        (iccp(profile("sRGB", power(1.8))), "its ICC profile (own) says colours"),
    ],
)
def test_unknown_colours_are_warned_of_unless_the_user_says_what_they_are(chunks, words, tmp_path):
    path = with_chunks(tmp_path / "a_color.png", TEXELS, chunks)
    found = load(path)
    assert found.maps["base_color"].source.encoding == "sRGB"
    assert all(part in found.warnings[0] for part in words.split(".*")), found.warnings
    assert not load(path, colour_space="sRGB").warnings


@pytest.mark.parametrize("suffix", ["jpg", "tif", "webp", "avif", "png"])
def test_profiles_are_followed_in_every_format(suffix: str, tmp_path: Path) -> None:
    path = tmp_path / f"a_color.{suffix}"
    pillow.fromarray(TEXELS).save(path, icc_profile=profile(ADOBE, ADOBE_CURVE))
    found = load(path)
    assert found.maps["base_color"].source.encoding == ADOBE
    assert f"a_color.{suffix}: its ICC profile (own) says {ADOBE}" in found.notes


@pytest.mark.parametrize(("codes", "encoding"), [((12, 13), P3), ((9, 8), "linear ITU-R BT.2020"), ((2, 2), "sRGB")])
def test_code_points_of_avif(codes: tuple[int, int], encoding: str, tmp_path: Path) -> None:
    path = tmp_path / "a_color.avif"
    pillow.fromarray(TEXELS).save(path)
    data = bytearray(path.read_bytes())
    at = data.index(b"colrnclx") + 8
    data[at : at + 4] = struct.pack(">HH", *codes)
    path.write_bytes(data)
    assert load(path).maps["base_color"].source.encoding == encoding


@pytest.mark.parametrize(
    ("attribute", "value", "encoding"),
    [
        ("colorInteropID", "lin_ap1_scene", "ACEScg"),
        ("colorInteropID", "srgb_p3d65_scene", P3),
        ("oiio:ColorSpace", "lin_rec2020_scene", "linear ITU-R BT.2020"),
        ("oiio:ColorSpace", "unknown", LINEAR),
        ("chromaticities", (0.713, 0.293, 0.165, 0.83, 0.128, 0.044, 0.32168, 0.33767), "ACEScg"),
        ("chromaticities", (0.64, 0.33, 0.3, 0.6, 0.15, 0.06, 0.3127, 0.329), LINEAR),
        ("chromaticities", (0.6, 0.3, 0.3, 0.6, 0.2, 0.1, 0.3, 0.3), LINEAR),
    ],
)
def test_what_exr_files_say_of_colours(attribute, value, encoding, tmp_path):
    """Under another suffix, too: OpenImageIO's own tool calls textures .tx, whatever is in them."""
    import OpenImageIO as oiio  # noqa: N813

    spec = oiio.ImageSpec(8, 8, 3, "half")
    spec.attribute(attribute, oiio.TypeDesc("string" if isinstance(value, str) else "float[8]"), value)
    path = tmp_path / "a_color.exr"
    output = oiio.ImageOutput.create(str(path))
    assert output.open(str(path), spec) and output.write_image(TEXELS.astype(np.float32) / 255)
    output.close()
    for each in (path, path.with_suffix(".tx")):
        path = path.rename(each)
        assert load(path).maps["base_color"].source.encoding == encoding


def test_primaries_of_radiance_files(tmp_path: Path) -> None:
    path = tmp_path / "a_color.hdr"
    primaries = "0.713 0.293 0.165 0.83 0.128 0.044 0.32168 0.33767"
    head = f"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\nPRIMARIES= {primaries}\nEXPOSURE=2\n\n-Y 4 +X 4\n"
    path.write_bytes(head.encode() + bytes([100, 80, 60, 128]) * 16)
    found = load(path)
    assert found.maps["base_color"].source.encoding == "ACEScg"
    assert found.warnings == ("a_color.hdr: its EXPOSURE of 2 is ignored",)


@pytest.mark.parametrize(("chunks", "told"), [(SRGB, False), (iccp(profile(ADOBE, ADOBE_CURVE)), True)])
def test_data_are_not_transformed(chunks: bytes, told: bool, tmp_path: Path) -> None:
    path = with_chunks(tmp_path / "a_roughness.png", TEXELS[..., 0], chunks)
    found = mipbake.load([path], maps={"base_color": None, "normal": None})
    np.testing.assert_allclose(found.maps["roughness"].pixels[..., 0], TEXELS[..., 0] / 255, atol=1e-6)
    assert any("its values are taken as they are stored" in note for note in found.notes) == told
    assert not found.warnings


def test_further_images_of_a_file_are_told(tmp_path: Path) -> None:
    first, second = pillow.fromarray(TEXELS), pillow.fromarray(255 - TEXELS)
    for suffix in ("tif", "webp", "png", "avif"):
        path = tmp_path / f"a_color.{suffix}"
        first.save(path, save_all=True, append_images=[second])
        found = load(path)
        assert any("only the first is read" in warning for warning in found.warnings), suffix
        path.unlink()
