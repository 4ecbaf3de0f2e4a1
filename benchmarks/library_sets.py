"""A library of many small texture sets of every kind, some of them broken, for benchmarks of batches."""

from __future__ import annotations

import json
import shutil
import tempfile
import zipfile
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

Maps = dict[str, NDArray[np.uint8]]

SIZES = (32, 64, 128, 256)
"""Texels a side; each size is as frequent as the next."""


def maps_of(rng: np.random.Generator, size: int) -> Maps:
    """Maps of a bumpy material of 8 bits: waves of random directions, which repeat at the borders."""
    v, u = np.meshgrid(*[(np.arange(size) + 0.5) * (2 * np.pi / size)] * 2, indexing="ij")
    slopes = np.zeros((2, size, size))
    for _ in range(6):
        f = rng.integers(-size // 8, size // 8 + 1, 2)
        wave = rng.uniform(0.1, 0.4) * np.cos(f[0] * u + f[1] * v + rng.uniform(0, 6.28))
        slopes += wave * np.array([1.0, -1.0])[:, None, None]
    normal = np.stack([-slopes[0], -slopes[1], np.ones_like(u)], -1)
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    noise = rng.uniform(0, 1, (size, size))
    return {
        "base_color": np.rint(255 * np.stack([noise, 0.5 * noise + 0.25, 1 - noise], -1)).astype(np.uint8),
        "normal": np.rint(127.5 * (normal + 1)).astype(np.uint8),
        "roughness": np.rint(255 * (0.2 + 0.5 * noise)).astype(np.uint8),
        "metallic": np.full((size, size), 255 * int(rng.integers(2)), np.uint8),
    }


def write(folder: Path, maps: Maps, pattern: str = "{}.png") -> None:
    """The maps as files of a folder."""
    from PIL import Image

    folder.mkdir(parents=True, exist_ok=True)
    for name, pixels in maps.items():
        Image.fromarray(pixels).save(folder / pattern.format(name))


def write_gltf(path: Path, maps: Maps) -> None:
    """A glTF document of one material, with its images beside it."""
    packed = np.stack([np.full_like(maps["roughness"], 255), maps["roughness"], maps["metallic"]], -1)
    folder = path.with_suffix("")
    write(folder, {"color": maps["base_color"], "bumps": maps["normal"], "packed": packed}, "{}_of_it.png")
    names = ("color", "bumps", "packed")
    material = {
        "name": path.stem,
        "normalTexture": {"index": 1},
        "pbrMetallicRoughness": {"baseColorTexture": {"index": 0}, "metallicRoughnessTexture": {"index": 2}},
    }
    document = {
        "asset": {"version": "2.0"},
        "images": [{"uri": f"{folder.name}/{name}_of_it.png"} for name in names],
        "textures": [{"source": index} for index in range(len(names))],
        "materials": [material],
    }
    path.write_text(json.dumps(document), encoding="utf-8")


def write_archive(path: Path, maps: Maps) -> None:
    """The maps as files of a .zip archive."""
    with tempfile.TemporaryDirectory() as scratch, zipfile.ZipFile(path, "w") as made:
        write(Path(scratch), maps, f"{path.stem}_{{}}.png")
        for file in sorted(Path(scratch).iterdir()):
            made.write(file, file.name)


KINDS = ("folder", "folder", "archive", "folder", "document", "folder", "tiles", "folder")
"""Kinds of sources in turn: most are folders."""


def add(kind: str, place: Path, maps: Maps, rng: np.random.Generator) -> None:
    """A source of one of KINDS; `tiles` are two UDIM tiles."""
    place.parent.mkdir(parents=True, exist_ok=True)
    if kind == "folder":
        write(place, maps)
    elif kind == "archive":
        write_archive(place.with_suffix(".zip"), maps)
    elif kind == "document":
        write_gltf(place.with_suffix(".gltf"), maps)
    else:
        write(place, maps, f"{place.name}_{{}}.1001.png")
        write(place, maps_of(rng, len(maps["normal"])), f"{place.name}_{{}}.1002.png")


def damaged(place: Path, maps: Maps, index: int) -> None:
    """One of several kinds of broken sources."""
    kind = index % 4
    if kind == 0:  # a map that was cut short
        write(place, maps)
        file = place / "normal.png"
        file.write_bytes(file.read_bytes()[: file.stat().st_size // 2])
    elif kind == 1:  # no roughness
        write(place, {name: maps[name] for name in ("base_color", "normal")})
    elif kind == 2:  # an archive that is none
        place.parent.mkdir(parents=True, exist_ok=True)
        place.with_suffix(".zip").write_bytes(b"PK no archive")
    else:  # a document whose images are gone
        write_gltf(place.with_suffix(".gltf"), maps)
        shutil.rmtree(place)


def make_library(root: Path, count: int, broken: int, doubles: int, seed: int = 1) -> None:
    """A library.

    Args:
        count: sources in all. broken: that cannot be baked.
        doubles: of those that can, how many have the name of another one: in another folder, or beside it as an
            archive.
    """
    rng = np.random.default_rng(seed)
    whole = count - broken - doubles
    for index in range(whole):
        maps = maps_of(rng, SIZES[index % len(SIZES)])
        add(KINDS[index % len(KINDS)], root / f"shelf{index % 7}" / f"set{index:03}", maps, rng)
    for index in range(doubles):
        maps = maps_of(rng, SIZES[index % len(SIZES)])
        of = len(KINDS) * index  # a folder
        if index % 2:
            write_archive(root / f"shelf{of % 7}" / f"set{of:03}.zip", maps)
        else:
            write(root / "doubles" / f"set{of:03}", maps)
    for index in range(broken):
        damaged(root / f"shelf{index % 7}" / f"broken{index:02}", maps_of(rng, 32), index)
