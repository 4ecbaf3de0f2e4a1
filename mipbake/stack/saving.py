"""How a stack is written and read back.

A stack lies in a folder: `stack.json`, which declares every convention, and the maps beside it. Stacks of UDIM tiles
share a folder, each with a `stack.1001.json` of its own, so that engines find all tiles of a map in one place.
"""

from __future__ import annotations

import os
import warnings
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from mipbake.base.errors import InputError, UsageError
from mipbake.material import GLTF_MODELS, MODELS
from mipbake.material.aim import sampler_from
from mipbake.material.pixel_filter import filter_named
from mipbake.source.layout import LAYOUTS, manifest_name
from mipbake.stack.gltf.glb import Encoded, encoded, square
from mipbake.stack.manifest import (
    best_output,
    check_output,
    is_replaceable,
    is_stack_folder,
    manifest_of,
    manifest_path,
    read_back,
    read_manifest,
)
from mipbake.stack.map_files import MapFile, listed_files, save_maps, write_files
from mipbake.stack.measured import measured_from
from mipbake.stack.output import GLB, Output, check_outputs, planned
from mipbake.stack.packing import unpacked
from mipbake.stack.presets import PRESETS, preset_named, wanted_outputs
from mipbake.stack.sidecars import FORMAT, check_sidecar, sidecar_named
from mipbake.stack.stack import MipStack, Provenance

if TYPE_CHECKING:
    from mipbake.stack.checking import Check


def save(
    stack: MipStack,
    place: Path,
    format: str | Sequence[Output] | None,
    progress: Callable[[float], None],
    levels: int | None,
    glb: Encoded | None,
    preset: str | None,
    measured: Check | None,
    known: bool,
    sidecar: str | None,
) -> list[Path]:
    """What `MipStack.save` does, which says what the arguments are."""
    outputs, texels = _wanted(stack, format, preset)
    if levels is not None and levels < 1:
        raise UsageError(f"{levels} levels were asked for: expected 1 or more, or None for all")
    check_outputs(outputs, stack.model)
    check_output(place, None if known else stack.provenance.sources)
    if texels is not None and glb is None:
        glb = encoded(replace(stack, tile=0), None, levels, texels=texels)
    plans = [(output, planned(output, stack, levels, len(outputs) > 1)) for output in outputs]
    write_all = write_files([file for _, files in plans for file in files], stack.wrap, stack.about(), progress)

    def write(folder: Path) -> None:
        written = iter(write_all(folder))
        progress(1.0)
        if measured is not None:
            for (output, files), entry in zip(plans, manifest["outputs"], strict=True):
                back = [next(written) for _ in files]
                known = [file for file in back if file is not None]
                found = known if len(known) == len(back) else read_back(folder, entry)
                entry["measured"] = measured.files(output, found)
        if glb is not None:
            manifest["outputs"].append(_write_glb(stack, folder, glb, measured))
        if sidecar is not None:
            manifest["outputs"].append(_write_sidecar(folder, sidecar, plans, stack.tile))
        manifest["bytes"] = {name: (folder / name).stat().st_size for name in listed_files(manifest)}

    if sidecar is not None:
        check_sidecar(sidecar)
    manifest = manifest_of(stack, plans)
    ours = is_replaceable if known else is_stack_folder
    saved = save_maps(place, manifest_name(stack.tile), manifest, write, ours)
    progress(1.0)
    return saved


def _write_glb(stack: MipStack, folder: Path, glb: Encoded, measured: Check | None) -> dict[str, Any]:
    """Writes a square with the material, and returns its output for the manifest."""
    told = glb if measured is None else replace(glb, measured=measured.glb(glb))
    name = f"{stack.name}.{GLB}"
    (folder / name).write_bytes(square(stack, told, stack.provenance.alpha_cutoff))
    found = {} if told.measured is None else {"measured": told.measured}
    return {"format": GLB, "files": [name], "maps": {}, **found}


def _wanted(
    stack: MipStack, format: str | Sequence[Output] | None, preset: str | None
) -> tuple[tuple[Output, ...], str | None]:
    """What `save` writes, and the texels of a GLB; None where none is written."""
    if not (format is None or isinstance(format, str)):
        if preset is not None:
            raise UsageError("outputs and a preset were both given: expected one of the two")
        outputs = tuple(format) if isinstance(format, Iterable) else ()
        if not isinstance(format, Iterable) or not all(isinstance(each, Output) for each in outputs):
            raise UsageError(
                f"the format is {format!r}: expected names separated by commas, such as 'exr,png', or outputs"
            )
        return outputs, None
    remembered = stack.provenance.preset
    name = preset if preset is not None else remembered if remembered in PRESETS else None  # later versions have others
    engine = None if name is None else preset_named(name)
    outputs, glb, texels = wanted_outputs(engine, format)
    if engine is not None:
        height, width = stack.size
        allowed = [m for m in GLTF_MODELS if engine.anisotropic or not MODELS[m].anisotropic]
        if preset is not None and stack.model not in allowed:  # who named a target beside the preset of a bake knows
            raise UsageError(
                f"the preset {engine.name} takes stacks of {' or '.join(allowed)}, and {stack.name!r} is of "
                f"{stack.model}: bake it for the target gltf"
            )
        blocks = any(not output.container.exact for output in outputs)
        # Who named a sampler beside the preset of a bake knows, too.
        sampler = None if preset is None else stack.provenance.sampler
        for sentence in [*engine.check(width, height, blocks), *engine.check_sampler(sampler)]:
            warnings.warn(sentence, stacklevel=4)
    return outputs, texels if glb else None


def _write_sidecar(
    folder: Path, name: str, plans: Sequence[tuple[Output, Sequence[MapFile]]], tile: int
) -> dict[str, Any]:
    """Writes a sidecar, and returns its output for the manifest."""
    made = sidecar_named(name, sidecar_files(plans), tile)
    (folder / made.name).write_text(made.content, encoding="utf-8")
    return {"format": name, "files": [made.name], "maps": {}}


def sidecar_files(plans: Sequence[tuple[Output, Sequence[MapFile]]]) -> list[MapFile]:
    """The files that a sidecar is about. UsageError where no output has such."""
    found = [list(files) for output, files in plans if output.container.name == FORMAT]
    if not found:
        raise UsageError(f"a sidecar is about files of the format {FORMAT}, which is not asked for: add it")
    return found[0]


def as_stack(stack: MipStack | str | os.PathLike[str]) -> MipStack:
    """A stack as it is, or as `open_stack` reads it."""
    if isinstance(stack, MipStack):
        return stack
    if not isinstance(stack, (str, os.PathLike)):
        raise UsageError(f"the stack is of type {type(stack).__name__}: expected a MipStack, or the folder of one")
    return open_stack(Path(stack))


def open_stack(path: str | Path) -> MipStack:
    """Reads a stack that `MipStack.save` wrote, whatever its format, from its folder or by its `stack.1001.json`.
    InputError where none is there, a map is missing or broken, or the schema is of a later version.

    The values come from the files, as an engine samples them: vectors are unit only up to the rounding of the format.
    """
    file = manifest_path(path)
    folder, manifest = file.parent, read_manifest(file)
    try:
        model = manifest["model"]
        if model not in MODELS:
            raise InputError(f"{file} names the model {model!r}: expected one of {', '.join(MODELS)}")
        wrap = (str(manifest["wrap"]["u"]), str(manifest["wrap"]["v"]))
        output = best_output(manifest)
        found = read_back(folder, output)
        chains = unpacked([(file.layout, file.levels) for file in found], model)
        names = [layout.name for layout in LAYOUTS[model]]
        provenance = _read_provenance(manifest["provenance"])
        levels = [np.concatenate(parts, -1) for parts in zip(*(chains.pop(name) for name in names), strict=True)]
        tile = int(manifest.get("tile", 0))
        return MipStack(str(manifest["name"]), model, levels, chains, wrap, provenance, tile=tile)
    except (KeyError, TypeError, ValueError, AttributeError, UsageError) as error:
        raise InputError(f"{file} does not describe a stack ({error}): bake it again") from error


def _read_provenance(content: Mapping[str, Any]) -> Provenance:
    read = {
        "warnings": tuple(content["warnings"]),
        "preset": None if content.get("preset") is None else str(content["preset"]),
        "promise": measured_from(content.get("promise")),
        "adjustments": tuple(content.get("adjustments", ())),
        "sampler": None if content.get("sampler") is None else sampler_from(content["sampler"]),
    }
    provenance = Provenance(**{**content, **read})
    filter_named(provenance.pixel_filter)
    return provenance
