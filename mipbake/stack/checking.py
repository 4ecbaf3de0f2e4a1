"""Measuring what is written of a stack, while it is written: what `mipbake bake` does, for Python."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from mipbake.source.opacity import shown
from mipbake.source.texture_set import TextureSet
from mipbake.stack.compression import cost, part_of
from mipbake.stack.costs import Cost
from mipbake.stack.gltf.glb import Encoded, output
from mipbake.stack.map_files import MapFile
from mipbake.stack.output import GLB, GLB_TEXELS, Output
from mipbake.stack.stack import MipStack


@dataclass(eq=False)
class Check:
    """Measures the files of a stack as `MipStack.save` writes them and reads them back. `mipbake bake` does the same.

        check = mipbake.Check(texture_set, stack)
        stack.save("baked/wood", "ktx2,glb", measured=check)
        print(check.defects, [cost.loss for cost in check.costs])

    The figures become `measured` of every output in stack.json, and of the provenance in a GLB.

    Args:
        texture_set: that the stack was baked from.
        stack: that is saved.
        progress: told the finished share, from 0 to 1.
        outputs: how many will be measured, for `progress`.

    Attributes:
        costs: what each output costs and gives back, in the order in which they were written. `Cost.loss` is in dB for
            each pair set, `Cost.written.snr` in dB at every level and halfway between levels, `Cost.warnings()` says
            where the loss is too great.
        seen: the texture set with what opacity hides filled; this is what is measured against.
    """

    texture_set: TextureSet
    stack: MipStack
    progress: Callable[[float], None] = lambda _share: None
    outputs: int = 1
    costs: list[Cost] = field(default_factory=list, init=False)
    seen: TextureSet = field(init=False)

    def __post_init__(self) -> None:
        """Fills what is hidden."""
        self.seen = shown(self.texture_set)

    @property
    def defects(self) -> list[str]:
        """A sentence for every output whose levels do not fit together, which is a defect of mipbake."""
        return [cost.defect for cost in self.costs if cost.defect]

    def files(self, output: Output, written: Sequence[MapFile]) -> dict[str, Any]:
        """Measures the files of an output, as they were read back; returns `measured` of the output, plain types."""
        return self._measured(cost(self.seen, self.stack, output, written, progress=self._share()))

    def glb(self, textures: Encoded) -> dict[str, Any]:
        """The same for the textures of a GLB, decoded."""
        texels = textures.texels
        spoken = GLB if texels == GLB_TEXELS[0] else f"{GLB}:{texels}"
        inside = replace(self.stack, tile=0)  # textures in a GLB have no file names to carry it
        found = cost(self.seen, inside, output(texels), textures.files, spoken, self._share(), textures.ranges)
        return self._measured(found)

    def _share(self) -> Callable[[float], None]:
        """Progress of the next output."""
        return part_of(self.progress, len(self.costs), max(self.outputs, len(self.costs) + 1))

    def _measured(self, found: Cost) -> dict[str, Any]:
        self.costs.append(found)
        return found.written.to_dict() if found.written else {}
