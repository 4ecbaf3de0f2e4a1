"""Writes image files and texture sets for the tests of everything that reads them."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from mipbake.source.intake import jobs
from mipbake.source.jobs import Failure
from mipbake.source.options import LoadOptions
from mipbake.source.sources import Found


def write_image(path: Path, pixels: Any, depth: str | None = None, **attributes: Any) -> Path:
    """Writes (H, W) or (H, W, C) through OpenImageIO in the type `depth` (default: the array's); alpha as it is."""
    import OpenImageIO as oiio  # noqa: N813

    array = np.asarray(pixels)
    array = array[..., None] if array.ndim == 2 else array
    spec = oiio.ImageSpec(array.shape[1], array.shape[0], array.shape[2], depth or str(array.dtype))
    spec.attribute("oiio:UnassociatedAlpha", 1)
    for name, value in attributes.items():
        spec.attribute(name.replace("__", ":"), value)
    output = oiio.ImageOutput.create(str(path))
    assert output is not None, path
    assert output.open(str(path), spec), output.geterror()
    assert output.write_image(np.ascontiguousarray(array)), output.geterror()
    output.close()
    return path


def bytes_of(values: Any, top: int = 255) -> np.ndarray:
    """[0, 1] to rounded integers up to `top`."""
    return np.rint(np.clip(values, 0, 1) * top).astype(np.uint8 if top == 255 else np.uint16)


def height_field(height: int, width: int, seed: int = 0, steepness: float = 0.5) -> np.ndarray:
    """(H, W, 3) unit normals, green up, of a smooth random height field that wraps; slopes of about `steepness`."""
    rng = np.random.default_rng(seed)
    fy, fx = np.fft.fftfreq(height)[:, None], np.fft.fftfreq(width)[None]
    spectrum = np.fft.fft2(rng.standard_normal((height, width))) * np.exp(-60 * (fx**2 + fy**2))
    slope_x = np.fft.ifft2(2j * np.pi * fx * spectrum).real
    slope_up = -np.fft.ifft2(2j * np.pi * fy * spectrum).real
    scale = steepness / max(np.hypot(slope_x, slope_up).std(), 1e-12)
    normals = np.stack([-scale * slope_x, -scale * slope_up, np.ones_like(slope_x)], -1)
    return normals / np.linalg.norm(normals, axis=-1, keepdims=True)


def encoded(normals: np.ndarray, directx: bool = False) -> np.ndarray:
    """Unit normals to 8 bit, (n + 1) / 2."""
    flip = np.array([1, -1 if directx else 1, 1])
    return bytes_of((normals * flip + 1) / 2)


def pixels_for(role: str, size: int = 32) -> np.ndarray:
    """(size, size, C) uint8 that is plausible for a role: base_color, normal, normal_alpha, packed, packed_alpha or any
    grey map."""
    rng = np.random.default_rng(len(role))
    if role == "normal":
        return encoded(height_field(size, size))
    if role == "normal_alpha":
        return np.concatenate([encoded(height_field(size, size)), pixels_for("roughness", size)], -1)
    channels = {"base_color": 3, "emissive": 3, "packed": 3, "packed_alpha": 4, "anisotropy": 3}.get(role, 1)
    return rng.integers(20, 235, (size, size, channels)).astype(np.uint8)


def write_set(folder: Path, files: Mapping[str, str | np.ndarray]) -> Path:
    """Writes a folder of images: file name to pixels, or to what `pixels_for` takes."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, what in files.items():
        write_image(folder / name, pixels_for(what) if isinstance(what, str) else what)
    return folder


def plain_set(folder: Path, **others: str | np.ndarray) -> Path:
    """A complete set in plain words; `others` adds or replaces maps by file stem."""
    stems = {"base_color": "base_color", "normal_gl": "normal", "roughness": "roughness"} | others
    return write_set(folder, {f"{stem}.png": what for stem, what in stems.items()})


def find(source: Path, **options: Any) -> Found:
    """What is found of the only set of a source, its headers alone."""
    (job,) = jobs([str(source)], LoadOptions(**options), Path("scratch"))
    if isinstance(job, Failure):
        raise job.error
    return job.found()[0]
