"""A render as one multi-part OpenEXR file: candidate, reference, signed error, level of detail, texture coordinates.

Everything is float32, compressed without loss (ZIP), so that the file holds the very numbers that measures saw. Half
has a resolution of 66 dB, which a good candidate's error and a reference's standard error lie below, and which repeated
texture coordinates exceed by far.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mipbake.base.errors import InputError, OutputError, UsageError
from mipbake.base.extras import extra
from mipbake.base.publish import check_room, reason, replacing
from mipbake.comparing.meshes.mesh_render import Frame, Reference
from mipbake.source.images.image_files import check_exr

_REC709 = (0.64, 0.33, 0.30, 0.60, 0.15, 0.06, 0.3127, 0.3290)  # red, green, blue, white: x and y (ITU-R BT.709)


def write_render(
    path: Path,
    candidate: Frame,
    reference: Reference,
    *,
    method: str,
    pixel_filter: str,
    source_hash: str,
    attributes: Mapping[str, str] | None = None,
) -> None:
    """Writes a file of five parts, each with the attributes below; an earlier file stands until the new one is whole.

    - `candidate`: R, G, B, linear radiance with Rec.709 primaries; A, 1 where the pixel's centre sees the mesh.
    - `reference`: R, G, B likewise.
    - `error`: R, G, B, candidate minus reference, signed; `interior`, 1 where measures look (see `Reference`).
    - `lod`: lod, the level of detail of the candidate's pixels, as in `Frame`, 0 off the mesh.
    - `uv`: u, v, its texture coordinates, v down, 0 off the mesh.

    Attributes: `mipbake:method`, `mipbake:pixel_filter`, `mipbake:source_hash`, `mipbake:passes` (int),
    `mipbake:standard_error` (float, radiance), `mipbake:converged` (int, 0 or 1), and what `attributes` adds under
    `mipbake:`. Equal renders give equal files. The file is read back before it gets its name.

    Args:
        path: of the file, which should end in .exr; its folder must exist.
        method: name of the candidate's method.
        pixel_filter: of the reference.
        source_hash: of the texture set.

    Raises:
        UsageError: renders of different sizes.
        OutputError: a file that cannot be written, or does not hold what was written.
    """
    if candidate.image.shape != reference.first.shape:
        (h, w), (height, width) = candidate.image.shape[:2], reference.first.shape[:2]
        raise UsageError(f"the candidate is {w} x {h} pixels: expected the reference's {width} x {height}")
    given = {
        "method": method,
        "pixel_filter": pixel_filter,
        "source_hash": source_hash,
        "passes": reference.passes,
        "standard_error": float(np.float32(reference.standard_error)),
        "converged": int(reference.converged),
        **(attributes or {}),
    }
    said = {f"mipbake:{name}": value for name, value in given.items()}
    difference = candidate.image - reference.image
    parts = {
        "candidate": _channels("RGBA", *_split(candidate.image), candidate.coverage),
        "reference": _channels("RGB", *_split(reference.image)),
        "error": _channels(("R", "G", "B", "interior"), *_split(difference), reference.interior),
        "lod": _channels(("lod",), candidate.lod),
        "uv": _channels("uv", *_split(candidate.uv)),
    }
    size = sum(channel.nbytes for channels in parts.values() for channel in channels.values())
    try:
        with replacing(path) as partial:
            try:
                _write(partial, parts, said)
                _verify(partial, parts, said)
            except (RuntimeError, InputError):
                check_room(partial, size)
                raise
    except OSError as error:
        raise OutputError(f"cannot write the render {path}: {reason(error)}") from error
    except (RuntimeError, InputError) as error:
        raise OutputError(f"cannot write the render {path} ({' '.join(str(error).split())}): check the disk") from error


Channels = Mapping[str, NDArray[np.float32]]


def _split(image: NDArray[np.float32]) -> list[NDArray[np.float32]]:
    return [image[..., index] for index in range(image.shape[-1])]


def _channels(names: str | tuple[str, ...], *images: NDArray[Any]) -> Channels:
    """Contiguous: of others the library writes the wrong bytes."""
    return {name: np.ascontiguousarray(image, np.float32) for name, image in zip(names, images, strict=True)}


def _write(path: Path, parts: Mapping[str, Channels], said: Mapping[str, object]) -> None:
    with extra("compare", "a file of renders"):
        import OpenEXR

    made = []
    for name, channels in parts.items():
        # OpenEXR's attribute takes the identifiers of the Color Interop Forum.
        space = {"chromaticities": _REC709, "colorInteropID": "lin_rec709_scene"}
        kind = space if "R" in channels else {"colorInteropID": "data"}
        header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage, **kind, **said}
        made.append(OpenEXR.Part(header, dict(channels), name))
    OpenEXR.File(made).write(str(path))


def _verify(path: Path, parts: Mapping[str, Channels], said: Mapping[str, object]) -> None:
    """OutputError unless the file holds these parts, in this order: the library reports success for broken files."""
    with extra("compare", "a file of renders"):
        import OpenEXR

    check_exr(path)
    with OpenEXR.File(str(path), separate_channels=True) as file:
        right = [part.name() for part in file.parts] == list(parts)
        for part in file.parts if right else ():
            channels = {name: channel.pixels for name, channel in part.channels.items()}
            expected = parts[part.name()]
            right &= all(part.header.get(name) == value for name, value in said.items())
            right &= set(channels) == set(expected)
            right = right and all(np.array_equal(channels[name], expected[name], equal_nan=True) for name in expected)
    if not right:
        raise RuntimeError("what was read back differs from what was written")
