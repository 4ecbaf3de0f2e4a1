"""A stack: every level of every map, and how it was made."""

from __future__ import annotations

import json
import operator
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, TypeAlias

import numpy as np
from numpy.typing import NDArray

from mipbake.base.errors import UsageError
from mipbake.base.names import known_name
from mipbake.material import MODELS
from mipbake.material.aim import Sampler, checked_aim
from mipbake.material.pixel_filter import level_sizes
from mipbake.source.layout import LAYOUTS, MapLayout, extra_layout
from mipbake.stack.map_files import Levels, MapFile, row_blocks
from mipbake.stack.packing import PackedFile

if TYPE_CHECKING:
    from mipbake.stack.checking import Check
    from mipbake.stack.gltf.glb import Encoded
    from mipbake.stack.measured import Measured
    from mipbake.stack.output import Output
    from mipbake.stack.verdict import Verdict

Fingerprint: TypeAlias = Mapping[str, str]
"""Hashes of what a result is made from: its "sources" and how they are read, the "options" and the "weights". What
`mipbake bake` finds unchanged it need not bake again."""


@dataclass(frozen=True)
class Provenance:
    """How a stack was made. It holds no times and no machine, so that the same bake gives the same files.

    Args:
        method: a name in `mipbake.baking.methods.METHODS`.
        pixel_filter: the pixel filter that the levels are made for.
        weights, weights_sha256: trained weights and their hash; None for closed forms.
        budget: time that the method was given to optimise, as it was asked for; None where it set its own.
        sampler: that the levels are made for. aim: what the method aimed at, from 0, SNR under single lights, to 1,
            what people see. None for methods that take none, and in files of versions that knew none.
        tool_version: version of mipbake.
        sources: source file name to SHA-256 of its bytes.
        source_hash: one hash of everything that level 0 was made from.
        preset: engine that the stack was baked for, which `MipStack.save` writes for; None where none was named.
        warnings: what a user should know, in sentences.
        promise: how every level measured beside the best closed form, by methods that measure; None for others.
        adjustments: what was changed after the bake, in sentences.
        alpha_cutoff: what opacity is tested against, and keeps its coverage for; None where it is blended.
        recipe: see `Fingerprint`; empty for stacks that were not baked from files.

    Raises:
        UsageError: stacks are made for no such aim.
    """

    method: str
    pixel_filter: str
    weights: str | None = None
    weights_sha256: str | None = None
    budget: str | None = None
    sampler: Sampler | None = None
    aim: float | None = None
    tool_version: str = ""
    sources: Mapping[str, str] = field(default_factory=dict)
    source_hash: str = ""
    preset: str | None = None
    warnings: tuple[str, ...] = ()
    promise: Measured | None = None
    adjustments: tuple[str, ...] = ()
    alpha_cutoff: float | None = None
    recipe: Fingerprint = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Checks what may come from files."""
        if self.aim is not None:
            checked_aim(self.aim)


@dataclass(frozen=True, eq=False)
class MipStack:
    """A complete MIP stack of one material.

        stack.save("baked/wood")  # the files
        print(stack.verdict)      # how it looks beside plain MIP maps
        stack.roughness           # the levels of a map, finest first: (H_L, W_L, 1) float32
        stack[2]["normal"]        # the maps of a level, by name; stack[-1] is the last of len(stack) levels

    Values are those of `maps()`: colours linear Rec.709, normals signed with green up, perceptual roughness.

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

    name: str
    model: str
    levels: Levels
    extra: Mapping[str, Levels]
    wrap: tuple[str, str]
    provenance: Provenance
    source_files: tuple[PackedFile, ...] = ()
    tile: int = 0

    def __post_init__(self) -> None:
        """Checks the shapes."""
        object.__setattr__(self, "model", known_name("material model", self.model, MODELS))
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

    def __len__(self) -> int:
        """How many levels there are."""
        return len(self.levels)

    def __getitem__(self, level: int) -> dict[str, NDArray[np.float32]]:
        """Every map at a level, by name: (H_L, W_L, channels of the map). A map of fewer levels gives its last one."""
        if isinstance(level, str):
            raise TypeError(
                f"{level!r} is no number of a level: stack[0] has the maps of the finest, stack.roughness all"
            )
        if not -len(self) <= operator.index(level) < len(self):
            raise IndexError(f"level {level} of a stack of {len(self)} levels")
        index = level % len(self)
        return {layout.name: chain[min(index, len(chain) - 1)] for layout, chain in self.maps()}

    def __getattr__(self, name: str) -> Levels:
        """The levels of a map, as `maps` has them. AttributeError with the names of the maps where there is none."""
        if "provenance" not in vars(self):  # while a copy is made
            raise AttributeError(name)
        chains = {layout.name: chain for layout, chain in self.maps()}
        if name not in chains:
            raise AttributeError(f"{self!r} has no attribute or map {name!r}: its maps are {', '.join(chains)}")
        return chains[name]

    def __dir__(self) -> list[str]:
        """With the maps, for completion."""
        return [*super().__dir__(), *(layout.name for layout, _ in self.maps())]

    @property
    def verdict(self) -> Verdict | None:
        """How the stack looks beside plain MIP maps, in words; None for methods that measure nothing, such as closed
        forms, and for stacks that were changed after the bake."""
        from mipbake.stack.verdict import verdict

        return None if self.provenance.promise is None else verdict(self.provenance.promise)

    def about(self) -> str:
        """How the stack was made, as JSON for the files themselves."""
        made = self.provenance
        return json.dumps(
            {
                "set": self.name,
                "model": self.model,
                "method": made.method,
                "pixel_filter": made.pixel_filter,
                "weights": made.weights,
                "sampler": None if made.sampler is None else str(made.sampler),
                "aim": made.aim,
                "source_hash": made.source_hash,
                "version": made.tool_version,
                "wrap": list(self.wrap),
            }
        )

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
        measured: Check | None = None,
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
                files are packed as the files of the source, or as the preset says. Or outputs, which say more and know
                no preset. None: the formats of the preset, else "exr".
            progress: told the finished share, from 0 to 1.
            levels: how many are written; None for all.
            glb: textures of the GLB that is written, from `mipbake.stack.gltf.glb.encoded`; None for those that suit
                most stacks, where `format` asks for a GLB.
            preset: a name in `mipbake.stack.presets.PRESETS`: an engine, whose formats, packing, normals and names are
                written. Warns where the engine needs other sides than the stack's, and where the stack was made for
                another sampler than the engine's. None: the engine that the stack was baked for, where one was named.
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
        from mipbake.stack.saving import save

        return save(self, Path(path), format, progress, levels, glb, preset, measured, known, sidecar)

    def files(self, output: Output, levels: int | None = None, beside: bool = False) -> list[MapFile]:
        """What `save` writes for an output: every file with its container, its channels and so many levels.

        `beside` other outputs, files that this one's texels cannot hold are left to them.
        """
        from mipbake.stack.output import planned

        return planned(output, self, levels, beside)


def _check_chain(what: str, chain: Sequence[NDArray[np.float32]], channels: int | None) -> None:
    if not chain or any(level.ndim != 3 or level.dtype != np.float32 or not level.size for level in chain):
        raise UsageError(f"{what} is not a chain of levels: expected float32 arrays (height, width, channels)")
    channels = chain[0].shape[-1] if channels is None else channels
    expected = [(*size, channels) for size in level_sizes(*chain[0].shape[:2])[: len(chain)]]
    if [level.shape for level in chain] != expected or not 1 <= channels <= max(m.channels for m in MODELS.values()):
        raise UsageError(f"{what} has levels of {[level.shape for level in chain]}: expected {expected}")
    for index, level in enumerate(chain):
        bad = not_finite(level)
        if bad:
            raise UsageError(f"{what} has {bad} values that are not finite at level {index}: expected none")


def not_finite(level: NDArray[np.float32]) -> int:
    """How many values of a level are NaN or infinite; row by row, because marks for all are a quarter of a level."""
    return sum(int(rows.size - np.count_nonzero(np.isfinite(rows))) for rows in row_blocks(level))
