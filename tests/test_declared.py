"""What files say of themselves: orientation, windows, layers, alpha, colours, further images."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import mipbake
from mipbake.io.read import read_header, read_image

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


@pytest.mark.parametrize("orientation", range(1, 9))
@pytest.mark.parametrize("suffix", ["tif", "png", "jpg", "webp", "avif", "hdr"])
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


@pytest.mark.parametrize("directx", [False, True])
@pytest.mark.parametrize("orientation", range(1, 9))
def test_vectors_turn_with_their_texels(orientation: int, directx: bool, tmp_path: Path) -> None:
    """What is stored is what a program would make of the stored height field."""
    field, normals = bumps()
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
