"""The result of a bake: every level of every map, where it came from, and how it is written and read back.

A stack lies in a folder: `stack.json`, which declares every convention, and the maps beside it.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mipbake.errors import InputError, UsageError
from mipbake.io.containers import DEFAULT_FORMAT, Container, format_named
from mipbake.io.layout import LAYOUTS, MANIFEST, SCHEMA, MapLayout, extra_layout
from mipbake.io.map_files import (
    Levels,
    check_same_sources,
    described,
    is_result_folder,
    read_map,
    save_maps,
    write_maps,
)
from mipbake.io.publish import check_target
from mipbake.material import MODELS
from mipbake.prefilter.pixel_filter import filter_named, level_sizes
from mipbake.prefilter.promise import Promise, promise_from

SCHEMA_VERSION = 1


@dataclass(frozen=True)
class Provenance:
    """How a stack was made. It holds no times and no machine, so that the same bake gives the same files.

    Args:
        method: a name in `mipbake.prefilter.METHODS`.
        pixel_filter: the pixel filter that the levels are made for.
        weights, weights_sha256: trained weights and their hash; None for closed forms.
        budget: time that the method was given to optimise, as it was asked for; None where it set its own.
        tool_version: version of mipbake.
        sources: source file name to SHA-256 of its bytes.
        source_hash: one hash of everything that level 0 was made from.
        warnings: what a user should know, in sentences.
        promise: how every level measured beside the best closed form, by methods that measure; None for others.
    """

    method: str
    pixel_filter: str
    weights: str | None = None
    weights_sha256: str | None = None
    budget: str | None = None
    tool_version: str = ""
    sources: Mapping[str, str] = field(default_factory=dict)
    source_hash: str = ""
    warnings: tuple[str, ...] = ()
    promise: Promise | None = None


@dataclass(frozen=True, eq=False)
class MipStack:
    """A complete MIP stack of one material.

    Args:
        name: the texture set's name.
        model: a name in `mipbake.material.MODELS`.
        levels: (H_L, W_L, C) float32 stored channels, finest first; level L measures max(1, W >> L) by max(1, H >> L),
            down to 1 x 1.
        extra: levels of the maps that do not shade, by role, in chains of their own size: (H_L, W_L, 1 to 4) float32.
        wrap: addressing along u and v, each "wrap" or "clamp".
        provenance: how it was made.

    Raises:
        UsageError: on construction, when model, sizes or channels are not as described, or a value is not finite.
    """

    name: str
    model: str
    levels: Levels
    extra: Mapping[str, Levels]
    wrap: tuple[str, str]
    provenance: Provenance

    def __post_init__(self) -> None:
        """Checks the shapes."""
        if self.model not in MODELS:
            raise UsageError(f"unknown material model {self.model!r}: expected one of {', '.join(MODELS)}")
        _check_chain("the material", self.levels, MODELS[self.model].channels)
        for role, chain in self.extra.items():
            if any(layout.name == role for layout in LAYOUTS[self.model]):
                raise UsageError(f"the map {role} belongs to the model {self.model}: pass it in levels, not in extra")
            _check_chain(f"the map {role}", chain, None)

    @property
    def size(self) -> tuple[int, int]:
        """(height, width) of level 0."""
        height, width = self.levels[0].shape[:2]
        return height, width

    def maps(self) -> list[tuple[MapLayout, Levels]]:
        """Every map that is written, with its levels: (H_L, W_L, channels of the map), views where possible."""
        shading = [(m, [level[..., m.channels] for level in self.levels]) for m in LAYOUTS[self.model]]
        plain = [(extra_layout(role, chain[0].shape[-1]), list(chain)) for role, chain in self.extra.items()]
        return shading + plain

    def save(
        self,
        path: str | Path,
        format: str = DEFAULT_FORMAT,
        progress: Callable[[float], None] = lambda _share: None,
    ) -> list[Path]:
        """Writes the stack into the folder `path` and reads every level back to compare.

        The folder appears under its name when it is complete. An earlier stack of the same source files is replaced; a
        folder that holds anything else is left alone. Missing parent folders are made.

        Args:
            path: the folder; its last part need not be the stack's name.
            format: a name in `mipbake.io.containers.FORMATS`. Values are rounded to what it stores.
            progress: told the finished share, from 0 to 1.

        Returns:
            The files, stack.json first.

        Raises:
            UsageError: an unknown format, or one that cannot hold this stack.
            OutputError: the folder cannot be written, or holds the stack of other source files.
        """
        target, container = Path(path), container_for(self.model, format)
        check_output(target, self.provenance.sources)
        write = write_maps(self.maps(), container, self.wrap, progress)
        files = save_maps(target, MANIFEST, _manifest(self, container), write, is_stack_folder)
        progress(1.0)
        return files


def check_output(path: str | Path, sources: Mapping[str, str] | None = None) -> None:
    """Raises OutputError when a stack cannot be saved to the folder `path`; leaves nothing there.

    Args:
        path: the folder that `MipStack.save` would be given.
        sources: source file name to SHA-256, empty where the file has not been read yet: a stack that shares no source
            file with them is in the way. None leaves that to `MipStack.save`.
    """
    target = Path(path)
    check_target(target, is_stack_folder)
    if sources is None or not is_stack_folder(target):
        return
    check_same_sources(target / MANIFEST, "stack", sources)


def container_for(model: str, format: str) -> Container:
    """The container of that name; UsageError when there is none, or when it cannot hold stacks of the model."""
    container = format_named(format)
    for layout in LAYOUTS[model]:
        if not container.encodings.issuperset(layout.encodings):
            raise UsageError(
                f"format {format} cannot hold the map {layout.name} of the model {model}: its logarithms do not fit in "
                f"{container.precision}, use format {DEFAULT_FORMAT} or another target"
            )
    return container


def is_stack_folder(path: Path) -> bool:
    """Whether a folder holds a stack and nothing else."""
    return is_result_folder(path, MANIFEST, SCHEMA)


def open_stack(path: str | Path) -> MipStack:
    """Reads a stack that `MipStack.save` wrote, whatever its format.

    The values are those of the files, what an engine samples: vectors are unit only up to the rounding of the format.

    Raises:
        InputError: no stack there, a map that is missing or broken, or a schema of a later version.
    """
    folder = Path(path)
    manifest = _read_manifest(folder)
    try:
        container = format_named(manifest["format"])
        model = manifest["model"]
        if model not in MODELS:
            raise InputError(f"{folder / MANIFEST} names the model {model!r}: expected one of {', '.join(MODELS)}")
        wrap = (str(manifest["wrap"]["u"]), str(manifest["wrap"]["v"]))
        layouts = {layout.name: layout for layout in LAYOUTS[model]}
        chains: dict[str, Levels] = {}
        for name, entry in manifest["maps"].items():
            if not name.isidentifier():  # a role becomes a file name: it must not lead elsewhere
                raise ValueError(f"{name!r} is no name of a map")
            layout = layouts.get(name) or extra_layout(name, len(entry["channels"]))
            chains[name] = read_map(container, folder, layout, entry)
        provenance = manifest["provenance"]
        read = {"warnings": tuple(provenance["warnings"]), "promise": promise_from(provenance.get("promise"))}
        provenance = Provenance(**{**provenance, **read})
        filter_named(provenance.pixel_filter)
        levels = [np.concatenate(parts, -1) for parts in zip(*(chains[n] for n in layouts), strict=True)]
        extra = {name: chain for name, chain in chains.items() if name not in layouts}
        return MipStack(str(manifest["name"]), model, levels, extra, wrap, provenance)
    except (KeyError, TypeError, ValueError, AttributeError, UsageError) as error:
        raise InputError(f"{folder / MANIFEST} does not describe a stack ({error}): bake it again") from error


def _read_manifest(folder: Path) -> dict[str, Any]:
    path = folder / MANIFEST
    if not folder.is_dir():
        raise InputError(f"no such folder: {folder}, expected a folder that holds {MANIFEST}")
    try:
        manifest = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        nested = sorted(p.parent for p in folder.glob(f"*/{MANIFEST}"))
        hint = f"; did you mean {nested[0]}?" if nested else ", expected what `mipbake bake` wrote"
        raise InputError(f"{folder} holds no {MANIFEST}{hint}") from None
    except (OSError, ValueError) as error:
        raise InputError(f"cannot read {path} ({error}): bake the stack again") from error
    if not isinstance(manifest, dict) or manifest.get("schema") != SCHEMA:
        raise InputError(f"{path} is not the description of a stack: its schema is not {SCHEMA}")
    if manifest.get("schema_version") != SCHEMA_VERSION:
        raise InputError(
            f"{path} has schema version {manifest.get('schema_version')}, expected {SCHEMA_VERSION}: "
            "open it with the version of mipbake that wrote it, or bake it again"
        )
    return manifest


def _check_chain(what: str, chain: Sequence[NDArray[np.float32]], channels: int | None) -> None:
    if not chain or any(level.ndim != 3 or level.dtype != np.float32 or not level.size for level in chain):
        raise UsageError(f"{what} is not a chain of levels: expected float32 arrays (height, width, channels)")
    channels = chain[0].shape[-1] if channels is None else channels
    expected = [(*size, channels) for size in level_sizes(*chain[0].shape[:2])]
    if [level.shape for level in chain] != expected or not 1 <= channels <= max(m.channels for m in MODELS.values()):
        raise UsageError(f"{what} has levels of {[level.shape for level in chain]}: expected {expected}")
    for index, level in enumerate(chain):
        bad = int(level.size - np.isfinite(level).sum())
        if bad:
            raise UsageError(f"{what} has {bad} values that are not finite at level {index}: expected none")


def _manifest(stack: MipStack, container: Container) -> dict[str, Any]:
    """Everything a reader must know to sample the maps."""
    height, width = stack.size
    maps = described(stack.model, stack.maps(), container)
    return {
        "schema": SCHEMA,
        "schema_version": SCHEMA_VERSION,
        "name": stack.name,
        "model": stack.model,
        "parametrisation": maps["parametrisation"],
        "format": maps["format"],
        "precision": maps["precision"],
        "width": width,
        "height": height,
        "wrap": {"u": stack.wrap[0], "v": stack.wrap[1]},
        "conventions": {
            **maps["conventions"],
            "levels": "level L measures max(1, width >> L) x max(1, height >> L), complete to 1 x 1",
            "sampling": "filter trilinearly in the stored channels (colours decoded to linear first), renormalise "
            "vectors, shade once per pixel; do not filter or sharpen the levels again, and use no MIP bias",
        },
        "provenance": {**asdict(stack.provenance), "sources": dict(stack.provenance.sources)},
        "maps": maps["maps"],
    }
