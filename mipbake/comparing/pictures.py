"""Renders of a view for all candidates at once: their images, the reference, and every measure that applies to renders.

All measures are taken over the interior, the pixels that lie wholly on the mesh: elsewhere a pixel shows an edge, which
no texture is to blame for. Measures that look at whole pictures see the reference itself outside the interior, even in
the candidate, so that edges and the background show no difference there; their maps are then averaged over the interior
only. Within some ten pixels of an edge FLIP and SSIM therefore see less of an error than in the open.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mipbake.base.timings import Progress
from mipbake.comparing.meshes import mesh_render
from mipbake.comparing.meshes.mesh_render import Frame, Reference
from mipbake.comparing.meshes.visible import Shot
from mipbake.comparing.result import Image, Plot, Rendered, Scene
from mipbake.comparing.scenes import View
from mipbake.material.aim import DEFAULT_SAMPLER
from mipbake.material.filtered_source import FilteredSource
from mipbake.quality.figures import Candidate, Figure
from mipbake.quality.metrics import MEASURES, Measured, hdr_flip_exposures, ldr_flip
from mipbake.quality.metrics.images import displayed
from mipbake.quality.samplers import RenderSampler

MAX_PASSES = 768
"""Most samples for each pixel of a reference, by default."""

SHIFT = (0.5, 0.0)
"""Pixels, to the right and upwards, between the two renders that flicker is measured of. Not tuned: flicker is
defined by half a pixel (docs/validation.md)."""

SHIFTED_SCALES = ("near", "1:1")
"""Scales whose views are rendered a second time for flicker: coarser levels show no more than texture space does."""

RESOLVED_SHARE = 0.2
"""Noise of a reference that is small enough, as a share of the closest candidate's error: it makes that error 2 %
larger."""

LOOKED_AT = 2
"""Of the methods that nobody named, how many have every measure in a view or a film: those that look best, by FLIP or
by a few frames."""

_MARGIN = 16  # pixels kept around the interior: beyond the reach of FLIP's filters and SSIM's window; not tuned
_BRIGHT = 0.6  # linear value after x / (1 + x) that bright parts of a plot are scaled to


@dataclass(frozen=True)
class RenderSettings:
    """How views and films are rendered, the same for all.

    Args:
        seed: of the reference's samples.
        max_passes: samples a pixel of the reference at most, an even number from 32 on.
        sampler: how stacks are looked up.
        cache: folder where references are kept for the next time; None for nowhere.
    """

    seed: int = 0
    max_passes: int = MAX_PASSES
    sampler: RenderSampler = DEFAULT_SAMPLER
    cache: Path | None = None


class RenderedView(NamedTuple):
    """What `render_view` gives: the images, the figures in the order of candidates and MEASURES, the change under SHIFT
    where it was rendered, and the renders that all of it is made from: each measured candidate's, by method name, and
    the reference."""

    rendered: Rendered
    figures: tuple[Figure, ...]
    change: Plot | None
    frames: Mapping[str, Frame]
    reference: Reference


def render_view(
    view: View,
    source: FilteredSource,
    candidates: Sequence[Candidate],
    settings: RenderSettings = RenderSettings(),
    progress: Progress = lambda _share: None,
    flicker: bool | None = None,
    named: Collection[str] | None = None,
) -> RenderedView:
    """Renders a view once per pixel for every candidate, and its reference once for all, and measures.

    SNR and flicker take the reference's halves apart, so that its noise biases neither; the other measures take their
    mean, whose standard error the scene tells beside the error of the best candidate.

    Args:
        candidates: of any model, their levels starting at the source's size; different names.
        flicker: whether to render the view a second time, half a pixel on; by default at SHIFTED_SCALES.
        named: methods that are measured in any case, as `looked_at` takes them.

    Returns:
        No figures but nan where no pixel lies wholly on the mesh.
    """
    moving = view.scale in SHIFTED_SCALES if flicker is None else flicker
    part = 0.35 if moving else 0.7  # share of the time that a reference takes
    still = _render(view, source, candidates, settings, 0, lambda share: progress(part * share))
    measures = _Measures(still.reference)
    measured = looked_at(list(still.frames), lambda name: measures.flip(still.frames[name]), named)
    still = still._replace(frames={name: still.frames[name] for name in measured})
    moved = None
    if moving:
        shot = replace(view, camera=replace(view.camera, shift=SHIFT))
        again = [each for each in candidates if each.name in measured]
        moved = _render(shot, source, again, settings, 1, lambda share: progress(part * (1 + share)))
    covered, reference = next(iter(still.frames.values())), still.reference
    scene = Scene(
        name=view.name,
        title=view.title,
        view=view.view,
        scale=view.scale,
        lod=float(np.median(covered.lod[covered.coverage])) if covered.coverage.any() else math.nan,
        resolution=view.resolution,
        lighting=view.lighting.name,
        passes=reference.passes,
        standard_error=reference.standard_error,
        candidate_error=reference.candidate_error,
        converged=reference.converged,
    )
    figures: list[Figure] = []
    maps: dict[str, NDArray[np.float32]] = {}
    for index, (name, frame) in enumerate(still.frames.items()):
        values, maps[name] = measures.of(frame)
        if moved is not None:
            values |= _flicker(still, moved, name)
        figures += [
            Figure(name, measure, view.view, view.scale, scene.lod, values[measure])
            for measure in MEASURES
            if measure in values
        ]
        progress(0.7 + 0.3 * (index + 1) / len(still.frames))
    images = {name: frame.image for name, frame in still.frames.items()}
    rendered = Rendered(scene, reference.image, images, reference.interior, maps)
    change = None if moved is None else _half_pixel_shift(scene, still, moved)
    return RenderedView(rendered, tuple(figures), change, still.frames, reference)


def looked_at(
    names: Sequence[str],
    loss: Callable[[str], float],
    named: Collection[str] | None,
) -> list[str]:
    """Which methods are measured: those that are `named`, and LOOKED_AT others; all of them where that is None.

    Args:
        names: of all. loss: a number for each of the others, the smallest the best.
    """
    if named is None:
        return list(names)
    best = sorted((name for name in names if name not in named), key=loss)[:LOOKED_AT]
    return [name for name in names if name in named or name in best]


class _Renders(NamedTuple):
    frames: Mapping[str, Frame]
    reference: Reference


def _render(
    shot: Shot,
    source: FilteredSource,
    candidates: Sequence[Candidate],
    settings: RenderSettings,
    frame: int,
    progress: Progress,
) -> _Renders:
    """A picture, the frame of that number in a motion: the stochastic sampler draws every frame anew."""
    frames = {}
    for each in candidates:
        rng = np.random.default_rng((settings.seed, frame))
        frames[each.name] = mesh_render.candidate(
            shot, each.levels, each.method.model, source.wrap, settings.sampler, rng=rng
        )
    reference = mesh_render.reference(
        shot, source, settings.seed, list(frames.values()), RESOLVED_SHARE,
        most=settings.max_passes, progress=progress, cache=settings.cache,
    )  # fmt: skip
    return _Renders(frames, reference)


class _Measures:
    """Measures against a reference, which is cut to where its interior is."""

    def __init__(self, reference: Reference) -> None:
        self._reference = reference
        if not reference.interior.any():
            return
        self._box = tuple(_reach(np.asarray(reference.interior.any(1 - axis))) for axis in (0, 1))
        self._inside = reference.interior[self._box]
        self._linear = np.maximum(reference.image[self._box], 0)  # signed filters undershoot
        self._display = displayed(self._linear.astype(np.float64))
        lit = self._linear[self._inside]
        self._exposures = hdr_flip_exposures(lit) if lit.any() else None

    def of(self, frame: Frame) -> tuple[dict[str, float], NDArray[np.float32]]:
        """Values of all measures of one picture, and the FLIP map of the whole picture, 0 off the interior."""
        interior = self._reference.interior
        flip = np.zeros(interior.shape, np.float32)
        wanted = {name: each for name, each in MEASURES.items() if each.needs not in ("frames", "film")}
        if not interior.any():
            return dict.fromkeys(wanted, math.nan), flip
        inside, real = self._inside, self._linear
        linear, display = self._shown(frame)
        values: dict[str, float] = {}
        for name, measure in wanted.items():
            if measure.needs == "estimates":
                halves = self._reference.first[interior], self._reference.second[interior]
                values[name] = _mean(measure.function(frame.image[interior], *halves), None)
            elif name == "hdr-flip":
                values[name] = math.nan
                if self._exposures is not None:
                    values[name] = _mean(measure.function(linear, real, exposures=self._exposures), inside)
            elif measure.needs == "linear":  # pixel by pixel
                values[name] = _mean(measure.function(linear[inside], real[inside]), None)
            else:
                found = measure.function(display, self._display)
                values[name] = _mean(found, inside)
                if name == "flip" and isinstance(found, Measured):
                    flip[self._box] = np.where(inside, found.per_pixel, 0)
        return values, flip

    def flip(self, frame: Frame) -> float:
        """FLIP alone, over the interior; infinite where there is none."""
        if not self._reference.interior.any():
            return math.inf
        return ldr_flip(self._shown(frame)[1], self._display).mean_over(self._inside)

    def _shown(self, frame: Frame) -> tuple[NDArray[np.floating], NDArray[np.floating]]:
        """A picture within the reference outside of the interior, linear and displayed."""
        inside = self._inside[..., None]
        linear = np.where(inside, frame.image[self._box], self._linear)
        return linear, np.where(inside, displayed(linear.astype(np.float64)), self._display)


def _reach(used: NDArray[np.bool_]) -> slice:
    """From the first to the last used row or column, with a margin on both sides as far as there is one."""
    index = np.flatnonzero(used)
    return slice(max(0, int(index[0]) - _MARGIN), int(index[-1]) + 1 + _MARGIN)


def _mean(found: float | Measured, mask: NDArray[np.bool_] | None) -> float:
    if isinstance(found, Measured):
        return found.mean if mask is None else found.mean_over(mask)
    return found


def _flicker(still: _Renders, moved: _Renders, name: str) -> dict[str, float]:
    inside = still.reference.interior & moved.reference.interior
    measures = {name: measure for name, measure in MEASURES.items() if measure.needs == "frames"}
    if not inside.any():
        return dict.fromkeys(measures, math.nan)
    both = still, moved
    p = np.stack([each.frames[name].image[inside] for each in both])
    first, second = (np.stack([getattr(each.reference, half)[inside] for each in both]) for half in ("first", "second"))
    return {measure: _mean(each.function(p, first, second), None) for measure, each in measures.items()}


def _half_pixel_shift(scene: Scene, still: _Renders, moved: _Renders) -> Plot:
    """How much every pixel changes when the picture moves by SHIFT (figure 6 of Kemppinen et al. 2023): the absolute
    change, black where there is none, amplified for all images by one factor that the caption tells. A pixel off the
    interior of either render is black.
    """
    inside = still.reference.interior & moved.reference.interior
    expected = np.abs(moved.reference.image - still.reference.image)
    factor = brightening(expected[inside])
    caption = (
        f"Absolute change of linear radiance when the picture moves by half a pixel, times {factor:g} in all images; "
        "black is no change. Where an image is brighter than the reference, it shimmers; where it is darker, it is "
        f"blurred. {scene.title}."
    )

    def shown(change: Image) -> Image:
        return np.asarray(np.where(inside[..., None], change * factor, 0), np.float32)

    images = {name: shown(np.abs(moved.frames[name].image - frame.image)) for name, frame in still.frames.items()}
    return Plot("half-pixel-shift", "Change under a shift by half a pixel", caption, shown(expected), images)


def brightening(values: NDArray[np.floating]) -> float:
    """The factor, to two digits, that scales bright (..., 3) values (the 99.5th percentile of their brightest channel)
    to _BRIGHT of what a display shows."""
    bright = float(np.percentile(values.max(-1), 99.5)) if values.size else 0.0
    return float(f"{_BRIGHT / (1 - _BRIGHT) / bright:.2g}") if bright > 0 else 1.0
