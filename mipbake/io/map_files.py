"""Maps into a folder and back: what stacks and converted materials share."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mipbake.errors import InputError, OutputError
from mipbake.io.containers import Container
from mipbake.io.layout import COLOUR, PARAMETRISATIONS, SIGNED, MapLayout, from_file, to_file
from mipbake.io.publish import IsOurs, published

_BLOCK = 1 << 18  # texels encoded at a time

Levels = list[NDArray[np.float32]]
Maps = Sequence[tuple[MapLayout, Levels]]
"""Maps with their levels, (H_L, W_L, channels of the map) each."""


def save_maps(
    target: Path,
    manifest_name: str,
    manifest: Mapping[str, Any],
    write: Callable[[Path], None],
    is_ours: IsOurs,
) -> list[Path]:
    """Publishes a folder of maps with the manifest that describes them; gives its files, the manifest first.

    Args:
        target: the folder; it appears when it is complete, in the place of an earlier one that `is_ours`.
        manifest: with `maps` as `described` gives it.
        write: from `write_maps`.

    Raises:
        OutputError: the folder cannot be written, or holds anything else.
    """
    with published(target, is_ours) as folder:
        write(folder)
        (folder / manifest_name).write_text(json.dumps(manifest, indent=2) + "\n", encoding="utf-8")
    return [target / manifest_name, *(target / name for entry in manifest["maps"].values() for name in entry["files"])]


def write_maps(
    maps: Maps,
    container: Container,
    wrap: tuple[str, str],
    progress: Callable[[float], None],
) -> Callable[[Path], None]:
    """Quantises maps, and gives what writes them into a folder and reads every level back to compare.

    Raises:
        UsageError: at once, for a value that the container cannot hold.
        OutputError: when called, for what cannot be written or does not read back.
    """
    quantised = [(layout, [_quantised(level, layout, container) for level in chain]) for layout, chain in maps]

    def write(folder: Path) -> None:
        for index, (layout, chain) in enumerate(quantised):
            container.write(folder, layout, chain, wrap)
            _verify(container, folder, layout, chain)
            progress((index + 1) / (len(quantised) + 1))

    return write


def read_map(container: Container, folder: Path, layout: MapLayout, entry: Mapping[str, Any]) -> Levels:
    """The levels of a map that a manifest's `entry` describes. InputError when a file is missing or broken."""
    sizes = [(int(size["height"]), int(size["width"])) for size in entry["levels"]]
    texels = container.read(folder, layout, sizes)
    return [from_file(container.dequantise(t), layout, container.srgb) for t in texels]


def described(model: str, maps: Maps, container: Container) -> dict[str, Any]:
    """What a manifest says of the maps of a material model: everything that a reader must know to sample them."""
    entries = {}
    for layout, chain in maps:
        entries[layout.name] = {
            "files": container.files(layout, len(chain)),
            "shades": layout.shades,
            "colour_space": ("sRGB" if container.srgb else "linear Rec.709") if layout.is_colour else "data",
            "channels": [
                {"name": name, "meaning": meaning, "encoding": _encoding(encoding, container)}
                for name, meaning, encoding in zip(layout.channel_names, layout.meanings, layout.encodings, strict=True)
            ],
            "levels": [{"width": level.shape[1], "height": level.shape[0]} for level in chain],
        }
    return {
        "parametrisation": PARAMETRISATIONS[model],
        "format": container.name,
        "precision": container.precision,
        "conventions": {
            "images": "top row first; texel (row i, column j) is centred at u = (j + 1/2) / width, "
            "v = (i + 1/2) / height",
            "normal_convention": "OpenGL",
            "tangent_space": "right-handed: +X along +u, +Y up in the image, +Z out of the surface",
        },
        "maps": entries,
    }


def is_result_folder(path: Path, manifest_name: str, schema: str) -> bool:
    """Whether a folder holds a manifest of that schema, files that it lists, and nothing else."""
    try:
        manifest = json.loads((path / manifest_name).read_text(encoding="utf-8"))
        if manifest["schema"] != schema:
            return False
        known = {manifest_name, *(name for entry in manifest["maps"].values() for name in entry["files"])}
        return all(p.name in known and p.is_file() for p in path.iterdir())
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        return False


def check_same_sources(manifest_path: Path, what: str, sources: Mapping[str, str]) -> None:
    """OutputError where an earlier result shares no source file with the one to be written in its place.

    Args:
        manifest_path: of the earlier result.
        what: it is, in a word.
        sources: source file name to SHA-256, empty where the file has not been read yet.
    """
    manifest = json.loads(manifest_path.read_text(encoding="utf-8"))
    provenance = manifest.get("provenance")
    earlier = provenance.get("sources") if isinstance(provenance, dict) else None
    earlier = earlier if isinstance(earlier, dict) else {}
    # Somebody who edits one map and starts again means the same place; another set shares no file with this one.
    shared = [n for n in sources if n in earlier and sources[n] in ("", earlier[n])]
    if shared or not earlier or not sources:
        return
    target = manifest_path.parent
    raise OutputError(
        f"cannot write to {target}: it holds the {what} {manifest.get('name')!r} of other source files "
        f"({_listed(earlier)}) than those to be read now; choose another output folder, or "
        f"remove {target} if it is no longer needed"
    )


def _listed(names: Iterable[str]) -> str:
    names = list(names)
    return ", ".join(names[:4]) + (f" and {len(names) - 4} more" if len(names) > 4 else "")


def _encoding(encoding: str, container: Container) -> str:
    if encoding == COLOUR:
        return "sRGB" if container.srgb else "linear"
    return "(x + 1) / 2" if encoding == SIGNED else "linear"


def _quantised(level: NDArray[np.float32], layout: MapLayout, container: Container) -> NDArray[np.generic]:
    """What a container stores of one level of a map; in blocks of rows, because the way there takes float64."""
    rows = max(1, _BLOCK // level.shape[1])
    blocks = (level[start : start + rows] for start in range(0, len(level), rows))
    return np.concatenate([container.quantise(to_file(block, layout, container.srgb), layout) for block in blocks])


def _verify(container: Container, folder: Path, layout: MapLayout, chain: Sequence[NDArray[np.generic]]) -> None:
    """Reads a map back and compares: writers are known to report success for files that are incomplete."""
    try:
        found = container.read(folder, layout, [(level.shape[0], level.shape[1]) for level in chain])
    except InputError as error:
        raise OutputError(f"the map {layout.name} did not read back after writing ({error}): check the disk") from error
    for index, (level, back) in enumerate(zip(chain, found, strict=True)):
        if not np.array_equal(level, back):
            raise OutputError(f"level {index} of the map {layout.name} changed while it was written: check the disk")
