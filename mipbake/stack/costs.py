"""What files cost, as figures and in sentences: what is warned of, and what is advised."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from mipbake.stack.containers import FORMATS, format_named
from mipbake.stack.output import GLB, GLB_TEXELS
from mipbake.stack.presets import Preset
from mipbake.stack.written import Written

LIMIT = 0.5
"""dB of the shaded result's SNR that files may cost before a warning says so, and what prevents it."""

COVERAGE_LIMIT = 0.02
"""Change of the share of texels that pass an alpha test that a warning says."""


@dataclass(frozen=True)
class Coverage:
    """The coverage of an opacity that is tested against a cutoff, at the level where files change it the most.

    Args:
        level: which it is.
        baked, written: shares of its texels that pass the test, before and after.
        texels: the texels that hold the opacity.
        alone: whether the opacity has a file of its own.
    """

    level: int
    baked: float
    written: float
    texels: str
    alone: bool

    @property
    def change(self) -> float:
        """Absolute change of the share."""
        return abs(self.written - self.baked)

    def __str__(self) -> str:
        baked, written = (f"{100 * share:.1f} %" for share in (self.baked, self.written))
        return f"coverage of the opacity at level {self.level}: {baked} as baked, {written} in the files"


@dataclass(frozen=True)
class Cost:
    """What the files of one output cost.

    Args:
        format: of the output.
        psnr: file to peak signal-to-noise ratio over all its levels, in dB, of file values between 0 and 1, in a GLB
            before they are stretched; infinite where nothing changed.
        loss: pair set to how many dB the SNR of the shaded result against the reference falls, in the mean over `LODS`;
            negative where rounding happens to help.
        texels: file to what its texels are stored as.
        gpu_bytes: texels of the format to what all files take, or would take, of a graphics card's memory; empty for
            formats that are not made for one.
        coverage: of the opacity; None where none is tested.
        written: what the files give back, at every level and between them; None where that was not measured.
    """

    format: str
    psnr: Mapping[str, float]
    loss: Mapping[str, float]
    texels: Mapping[str, str]
    gpu_bytes: Mapping[str, int] = field(default_factory=dict)
    coverage: Coverage | None = None
    written: Written | None = None

    @property
    def defect(self) -> str | None:
        """A sentence where levels do not belong together, which is not a fault of the set; None where they do."""
        dips = self.written.dips if self.written else ()
        if not dips:
            return None
        worst = max(dips, key=lambda dip: min(dip.at_levels) - dip.snr)
        others = f", and {len(dips) - 1} more like it" if len(dips) > 1 else ""
        return (
            f"levels of {self.format} do not fit together: lookups between them are worse than lookups at either, "
            f"{worst}{others}; this is a defect of mipbake, not of the set: the files were written, but do not use "
            "them; bake with another --method, and please report it"
        )

    @property
    def worst(self) -> float:
        """The greatest loss of any pair set, in dB."""
        return max(self.loss.values())

    def warnings(self, preset: Preset | None = None) -> list[str]:
        """A sentence each where the loss is above `LIMIT`, and the change of coverage above `COVERAGE_LIMIT`.

        `preset`: the preset that chose the output; its engine must take what is advised.
        """
        return [said for said in (self._of_loss(preset), self._of_coverage(preset)) if said]

    def _of_loss(self, preset: Preset | None) -> str | None:
        format = self.format.partition(":")[0]
        if self.worst <= LIMIT:
            return None
        better: str | None
        if self.format == GLB:
            better = f"{GLB}:{GLB_TEXELS[-1]}"
            advice = "the glTF standard allows no other texels; three.js and Babylon.js load --format "
        elif format == GLB:
            better, advice = "ktx2:rgba16f", "write beside it --format "
        else:
            better, advice = format_named(self.format).finer, "where the engine takes it, use --format "
        if better is None:
            return None
        if preset and preset.no_finer:
            return None  # there is nothing to do
        return f"files of {self.format} lose visibly: {advice}{better}{self._bytes(better)}"

    def _bytes(self, better: str) -> str:
        """What that takes of a graphics card's memory in place of what this takes."""
        now, then = (self.gpu_bytes.get(name.partition(":")[2] or GLB_TEXELS[0]) for name in (self.format, better))
        return "" if now is None or then is None else f" ({then / 1e6:.1f} in place of {now / 1e6:.1f} MB on the card)"

    def _of_coverage(self, preset: Preset | None) -> str | None:
        found = self.coverage
        if found is None or found.change <= COVERAGE_LIMIT:
            return None
        format = self.format.partition(":")[0]
        if format == GLB:
            advice = "a glTF file holds no other texels; files of --format ktx2:rgba8 beside it keep the coverage"
        else:
            container = format_named(f"{format}:{found.texels}")
            plain = next(name for name, each in FORMATS[format].items() if each.exact)
            better = container.finer if container.exact else f"{format}:{plain}"
            if better is None:
                return None
            engine = preset.no_finer if preset else ""
            advice = engine or f"use --format {better} where the engine takes it"
            if not (container.exact or found.alone):
                advice += "; --packing separate gives opacity a file of its own, whose coverage changes less"
        return f"{self.format} changes the {found}, by more than {100 * COVERAGE_LIMIT:g} points: {advice}"
