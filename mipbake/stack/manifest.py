"""The file that declares a stack, `stack.json`, and the folder that it makes one of: written, found and read."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from mipbake.base import disk
from mipbake.base.errors import InputError, OutputError
from mipbake.base.json_text import parsed
from mipbake.base.publish import check_place, is_companion
from mipbake.material import MODELS
from mipbake.material.aim import DEFAULT_SAMPLER, LOOKUPS, Sampler
from mipbake.source.layout import MANIFEST, SCHEMA, manifests
from mipbake.stack.containers import FORMATS
from mipbake.stack.map_files import (
    CONVENTIONS,
    MapFile,
    check_same_sources,
    described,
    is_result_folder,
    map_files,
    normal_convention,
    read_files,
)
from mipbake.stack.output import Output
from mipbake.stack.stack import MipStack

SCHEMA_VERSION = 2


def check_output(path: str | Path, sources: Mapping[str, str] | None = None) -> None:
    """Raises OutputError when a stack cannot be saved to the folder `path`; leaves nothing there.

    Args:
        path: the folder that `MipStack.save` would be given.
        sources: source file name to SHA-256, empty where the file has not been read yet: a stack that shares no source
            file with them is in the way. None where the caller knows that what lies there may be replaced, be it a
            stack or a folder of stacks.
    """
    place = Path(path)
    if sources is None:
        check_place(place, is_replaceable)
        return
    if holds_stacks(place):
        raise OutputError(f"cannot write to {place}: it holds other results, remove them or choose another folder")
    check_place(place, is_stack_folder)
    if not is_stack_folder(place):
        return
    check_same_sources(manifests(place), "stack", sources)


def is_stack_folder(path: Path) -> bool:
    """Whether a folder holds a stack, or the stacks of tiles, and nothing else."""
    return is_result_folder(path, manifests(path), SCHEMA)


def holds_stacks(path: Path) -> bool:
    """Whether a folder holds folders of stacks, at any depth, and nothing else but what file managers put there."""
    try:
        inside = [each for each in path.iterdir() if not is_companion(each)]
    except OSError:
        return False
    return bool(inside) and all(each.is_dir() and is_replaceable(each) for each in inside)


def is_replaceable(path: Path) -> bool:
    """Whether a folder holds nothing but stacks, its own or in folders."""
    return is_stack_folder(path) or holds_stacks(path)


def manifest_path(path: str | Path) -> Path:
    """The file that declares a stack: `path` itself, or the only one of that folder. InputError where there is none."""
    folder = Path(path)
    if disk.is_file(folder):
        return folder
    if not disk.is_dir(folder):
        raise InputError(f"no such folder: {folder}, expected a folder that holds {MANIFEST}")
    found = manifests(folder)
    if not found:
        nested = sorted(p.parent for p in folder.glob(f"*/{MANIFEST}"))
        hint = f"; did you mean {nested[0]}?" if nested else ", expected what `mipbake bake` wrote"
        raise InputError(f"{folder} holds no {MANIFEST}{hint}")
    if len(found) > 1:
        raise InputError(f"{folder} holds the stacks of {len(found)} tiles: name one of them, such as {found[0]}")
    return found[0]


def read_manifest(path: Path) -> dict[str, Any]:
    """What a stack's file declares, from `manifest_path`; InputError where it is broken or of another version."""
    return declared(path, "stack", "bake", SCHEMA, SCHEMA_VERSION)


def declared(path: Path, what: str, command: str, schema: str, version: int) -> dict[str, Any]:
    """What a JSON file of ours declares, of a schema and a version of it; InputError where it is missing, broken, or of
    another. `what` it describes, and the `command` of mipbake that writes it, are for sentences."""
    try:
        found = parsed(disk.read_bytes(path, f"what `mipbake {command}` wrote"))
    except ValueError as error:
        raise InputError(f"cannot read {path} ({error}): {command} the {what} again") from error
    if not isinstance(found, dict) or found.get("schema") != schema:
        raise InputError(f"{path} is not the description of a {what}: its schema is not {schema}")
    if found.get("schema_version") != version:
        raise InputError(
            f"{path} has schema version {found.get('schema_version')}, expected {version}: "
            f"open it with the version of mipbake that wrote it, or {command} it again"
        )
    return found


def read_back(folder: Path, output: Mapping[str, Any]) -> list[MapFile]:
    """The files of an output of a manifest."""
    return read_files(FORMATS[output["format"]].__getitem__, folder, output["maps"])


def best_output(manifest: Mapping[str, Any]) -> Mapping[str, Any]:
    """The output of a manifest that is the closest to what was baked: floating-point numbers before integers before
    compressed texels. KeyError or TypeError where there is none.
    """
    ranks = ("float", "half", "rgba16f", "16", "8", "rgba8")

    def rank(output: Mapping[str, Any]) -> int:
        texels = [entry["texels"] for entry in output["maps"].values()]
        return max((ranks.index(t) if t in ranks else len(ranks)) for t in texels)

    outputs: list[Mapping[str, Any]] = [output for output in manifest["outputs"] if output["maps"]]
    if not outputs:
        raise ValueError("it holds no files of maps, only a whole document: bake it in another format as well")
    return min(outputs, key=rank)


def _sampling(sampler: Sampler) -> str:
    """How a stack is looked up, in words."""
    most = f", with at most {sampler.lookups} lookups" if 1 < sampler.lookups < LOOKUPS[-1] else ""
    how = "trilinearly" + (f" and anisotropically{most}" if sampler.lookups > 1 else "")
    bias = f"a MIP bias of {sampler.bias:g}" if sampler.bias else "no MIP bias"
    frames = f"; average {sampler.frames} frames that show other points of the pixel" if sampler.frames > 1 else ""
    return (
        f"filter {how} in the stored channels (colours decoded to linear first), renormalise vectors, shade once per "
        f"pixel{frames}; do not filter or sharpen the levels again, and use {bias}"
    )


def manifest_of(stack: MipStack, plans: Sequence[tuple[Output, Sequence[MapFile]]]) -> dict[str, Any]:
    """Everything a reader must know to sample the maps."""
    height, width = stack.size
    return {
        "schema": SCHEMA,
        "schema_version": SCHEMA_VERSION,
        "name": stack.name,
        **({"tile": stack.tile} if stack.tile else {}),
        "model": stack.model,
        "parametrisation": MODELS[stack.model].formula,
        "width": width,
        "height": height,
        "wrap": {"u": stack.wrap[0], "v": stack.wrap[1]},
        "conventions": {
            **CONVENTIONS,
            "levels": "level L measures max(1, width >> L) x max(1, height >> L)",
            "sampling": _sampling(stack.provenance.sampler or DEFAULT_SAMPLER),
        },
        "provenance": {
            **asdict(stack.provenance),
            "sources": dict(stack.provenance.sources),
            "recipe": dict(stack.provenance.recipe),
        },
        "outputs": [
            {
                "format": output.container.name,
                "packing": output.packing,
                "normal_convention": normal_convention(files),
                "map_files": map_files(files),
                "maps": described(files),
            }
            for output, files in plans
        ],
    }
