"""The result of a bake: every level of every map, where it came from, and how it is written and read back.

A stack lies in a folder: `stack.json`, which declares every convention, and the maps beside it. Stacks of UDIM tiles
share a folder, each with a `stack.1001.json` of its own, so that engines find all tiles of a map in one place.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from mipbake.base.errors import InputError, UsageError
from mipbake.material import GLTF_MODELS, MODELS
from mipbake.material.aim import sampler_from
from mipbake.material.pixel_filter import filter_named
from mipbake.source.layout import LAYOUTS, manifest_name
from mipbake.stack.content import Content, Provenance
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
from mipbake.stack.output import GLB, Output, check_outputs, planned
from mipbake.stack.packing import unpacked
from mipbake.stack.presets import preset_named, wanted_outputs
from mipbake.stack.promise import promise_from
from mipbake.stack.sidecars import FORMAT, check_sidecar, sidecar_named


class Measures(Protocol):
    """What measures files as they are written: `mipbake.Check`, which stands on this module."""

    def files(self, output: Output, written: Sequence[MapFile]) -> Mapping[str, Any]:
        """`measured` of an output, plain types for JSON, from its files as they were read back."""

    def glb(self, textures: Encoded) -> Mapping[str, Any]:
        """The same for the textures of a GLB, decoded."""


@dataclass(frozen=True, eq=False)
class MipStack(Content):
    """A complete MIP stack of one material.

    Args:
        name: the texture set's name.
        model: a name in `mipbake.material.MODELS`.
        levels: (H_L, W_L, C) float32 stored channels, finest first; level L measures max(1, W >> L) by max(1, H >> L),
            down to 1 x 1 or fewer.
        extra: levels of the maps that do not shade, by role, in chains of their own size: (H_L, W_L, 1 to 4) float32.
        wrap: addressing along u and v, each "wrap" or "clamp".
        provenance: how it was made.
        source_files: which channels of which maps lay together in the files that the stack was made from; empty where
            they are unknown.
        tile: UDIM tile, which names of files carry; 0 for a stack that is not a tile.

    Raises:
        UsageError: on construction, when model, sizes or channels are not as described, or a value is not finite.
    """

    def __repr__(self) -> str:
        """A description in one line."""
        height, width = self.size
        beside = f", {', '.join(self.extra)} beside" if self.extra else ""
        return (
            f"MipStack({self.name!r}, {self.model}, {width} x {height}, {len(self.levels)} levels, by "
            f"{self.provenance.method}{beside})"
        )

    def save(
        self,
        path: str | Path,
        format: str | Sequence[Output] | None = None,
        progress: Callable[[float], None] = lambda _share: None,
        levels: int | None = None,
        glb: Encoded | None = None,
        preset: str | None = None,
        measured: Measures | None = None,
        known: bool = False,
        sidecar: str | None = None,
    ) -> list[Path]:
        """Writes the stack into the folder `path` and reads every level back to compare.

        The folder appears under its name when it is complete. An earlier stack of the same source files is replaced; a
        folder that holds anything else is left alone. Missing parent folders are made.

        Args:
            path: the folder; its last part need not be the stack's name.
            format: formats by name, separated by commas, each with texels where they are not the default
                ("exr,ktx2:uastc"), as `mipbake bake --format` takes them; "glb" is a square with the material. Their
                files are packed as the files of the source, or as the preset says. Or outputs, which say more. None:
                the formats of the preset, else "exr".
            progress: told the finished share, from 0 to 1.
            levels: how many are written; None for all.
            glb: textures of the GLB that is written, from `mipbake.stack.gltf.glb.encoded`; None for those that suit
                most stacks, where `format` asks for a GLB.
            preset: a name in `mipbake.stack.presets.PRESETS`: an engine, whose formats, packing, normals and names are
                written. The first texels that it names are taken: to choose more precise ones takes the source, see
                `mipbake.stack.compression.chosen_all`. Warns where the engine needs other sides than the stack's, and
                where the stack was made for another sampler than the engine's.
            measured: measures every output as it was read back, before the folder appears: `mipbake.Check` of the
                texture set and this stack. What it finds becomes `measured` of the output in stack.json, and stands in
                the GLB. None measures nothing.
            known: whether the caller knows that an earlier stack there is of the same set. Then it is replaced although
                all its source files have changed.
            sidecar: a name in `mipbake.stack.sidecars.SIDECARS`: a file beside the maps that another program takes. It
                is about the files in PNG.

        Returns:
            The files, stack.json first.

        Raises:
            UsageError: an unknown format or preset, or one that cannot hold this stack.
            OutputError: the folder cannot be written, or holds the stack of other source files.
        """
        place = Path(path)
        outputs, wants_glb = self._wanted(format, preset)
        check_outputs(outputs, self.model)
        check_output(place, None if known else self.provenance.sources)
        if wants_glb and glb is None:
            glb = encoded(replace(self, tile=0), None, levels)
        plans = [(output, self.files(output, levels, len(outputs) > 1)) for output in outputs]
        write_all = write_files([file for _, files in plans for file in files], self.wrap, self.about(), progress)

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
                manifest["outputs"].append(self._write_glb(folder, glb, measured))
            if sidecar is not None:
                manifest["outputs"].append(_write_sidecar(folder, sidecar, plans, self.tile))
            manifest["bytes"] = {name: (folder / name).stat().st_size for name in listed_files(manifest)}

        if sidecar is not None:
            check_sidecar(sidecar)
        manifest = manifest_of(self, plans)
        ours = is_replaceable if known else is_stack_folder
        saved = save_maps(place, manifest_name(self.tile), manifest, write, ours)
        progress(1.0)
        return saved

    def _write_glb(self, folder: Path, glb: Encoded, measured: Measures | None) -> dict[str, Any]:
        """Writes a square with the material, and returns its output for the manifest."""
        told = glb if measured is None else replace(glb, measured=measured.glb(glb))
        name = f"{self.name}.{GLB}"
        (folder / name).write_bytes(square(self, told, self.provenance.alpha_cutoff))
        found = {} if told.measured is None else {"measured": told.measured}
        return {"format": GLB, "files": [name], "maps": {}, **found}

    def _wanted(self, format: str | Sequence[Output] | None, preset: str | None) -> tuple[tuple[Output, ...], bool]:
        """What `save` writes, and whether a GLB is."""
        engine = None if preset is None else preset_named(preset)
        if engine is not None:
            height, width = self.size
            allowed = [m for m in GLTF_MODELS if engine.anisotropic or not MODELS[m].anisotropic]
            if self.model not in allowed:
                raise UsageError(
                    f"the preset {engine.name} takes stacks of {' or '.join(allowed)}, and {self.name!r} is of "
                    f"{self.model}: bake it for the target gltf"
                )
            if not (format is None or isinstance(format, str)):
                raise UsageError("outputs and a preset were both given: expected one of the two")
            outputs, glb, finer = wanted_outputs(engine, format)
            blocks = any(not output.container.exact for output in outputs)
            for sentence in [*engine.check(width, height, blocks), *engine.check_sampler(self.provenance.sampler)]:
                warnings.warn(sentence, stacklevel=3)
        elif format is None or isinstance(format, str):
            outputs, glb, finer = wanted_outputs(None, format)
        else:
            outputs, glb, finer = tuple(format), False, ()
        if finer:
            raise UsageError(
                f"format {GLB}:{finer[0]} chooses texels by what they cost, which takes the source: bake it on the "
                f"command line, or save {GLB}"
            )
        return outputs, glb

    def files(self, output: Output, levels: int | None = None, beside: bool = False) -> list[MapFile]:
        """What `save` writes for an output: every file with its container, its channels and so many levels.

        `beside` other outputs, files that this one's texels cannot hold are left to them.
        """
        return planned(output, self, levels, beside)


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


def open_stack(path: str | Path) -> MipStack:
    """Reads a stack that `MipStack.save` wrote, whatever its format, from its folder or by its `stack.1001.json`.

    The values come from the files, as an engine samples them: vectors are unit only up to the rounding of the format.

    Raises:
        InputError: no stack there, a map that is missing or broken, or a schema of a later version.
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
        "promise": promise_from(content.get("promise")),
        "adjustments": tuple(content.get("adjustments", ())),
        "sampler": None if content.get("sampler") is None else sampler_from(content["sampler"]),
    }
    provenance = Provenance(**{**content, **read})
    filter_named(provenance.pixel_filter)
    return provenance
