"""A round of a descent: what it is fitted to, the curvature where the texels are, and the steps (texel_descent.py)."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mipbake import sampling
from mipbake.baking.search.gauss_newton import System, signs
from mipbake.baking.search.pair_weights import PairWeights
from mipbake.baking.search.picture_samples import PictureChunk, picture_slopes
from mipbake.baking.search.pixel_samples import Chunk, in_every_frame
from mipbake.baking.search.regions import Crop
from mipbake.baking.search.texel_coordinates import limits, per_coordinate, units, without_heights
from mipbake.quality.reference.problem import Image
from mipbake.quality.samplers import in_frames, mean_of_frames
from mipbake.sampling.adjoint import scatter_linear
from mipbake.shading import shade
from mipbake.shading.adjoint import shade_adjoint

_MEMORY, _MOST_MEMORY = 0.5, 30.0  # rounds of curvature that hold texels: grows by so many a round
_RECENT = 3.0  # in the average over rounds, the last round counts (_RECENT + 1) / (_RECENT + rounds)
_DAMPING = 0.02  # in units of a texel's own curvature
_STRIDE = 2  # one in so many pairs takes part in curvature after the first round


class Lookups:
    """Where the pixels of chunks lie in the crops of levels: what they see of them, and the way back to their texels.

    A round looks the same pixels up several times, so this is worked out once, and a level is read in one call.

    Args:
        crops: of every level that they look up.
    """

    def __init__(self, crops: Mapping[int, Crop], chunks: Sequence[Chunk | PictureChunk]) -> None:
        self._crops, self._sizes = crops, [len(chunk.uv) for chunk in chunks]
        self._parts: dict[int, list[tuple[int, NDArray[np.float32] | None]]] = {}
        uv: dict[int, list[Image]] = {}
        for index, chunk in enumerate(chunks):
            for level, share in chunk.seen:
                each = None if share is None else share[:, None]
                self._parts.setdefault(level, []).append((index, each))
                uv.setdefault(level, []).append(crops[level].local(chunk.uv))
        self._uv = {level: np.concatenate(each) for level, each in uv.items()}

    def texels(self) -> list[Image]:
        """(P, C) of each chunk: what its pixels see of the levels as they are now."""
        out: list[Image | None] = [None] * len(self._sizes)
        for level, parts in self._parts.items():
            crop, begin = self._crops[level], 0
            seen = sampling.texture(
                crop.now[None], self._uv[level][None, None], filter_mode="linear", boundary_mode=crop.boundary
            )[0, 0]
            for index, share in parts:
                each = seen[begin : begin + self._sizes[index]]
                begin += len(each)
                if share is not None:
                    each *= share
                before = out[index]
                if before is None:
                    out[index] = each
                else:
                    before += each
        return [each for each in out if each is not None]

    def scattered(self, level: int, rows: Sequence[Image]) -> Image | None:
        """(h', w', D): what (P, D) rows of each chunk's pixels pass back to the texels of a crop, in proportion.

        None where no pixel sees the level.
        """
        if level not in self._parts:
            return None
        crop = self._crops[level]
        values = [rows[index] if share is None else rows[index] * share for index, share in self._parts[level]]
        height, width = crop.now.shape[:2]
        return scatter_linear((height, width), self._uv[level], np.concatenate(values), crop.boundary)


@dataclass(frozen=True)
class Drawn:
    """What a round is fitted to.

    Args:
        renders: chunks, (K, P, 3) estimates of the reference, and (K, P) what the squared error of each render counts.
        pictures: chunks of small pictures. visible_counts: by level, (V,) what the visible error of each kind
            counts.
        lookups: of all pixels, renders first.
    """

    renders: list[tuple[Chunk, Image, Image]]
    pictures: list[PictureChunk]
    visible_counts: dict[int, NDArray[np.float64]]
    lookups: Lookups

    @classmethod
    def of(
        cls,
        crops: dict[int, Crop],
        renders: Sequence[tuple[Chunk, Image]],
        weights: PairWeights,
        pictures: list[PictureChunk],
    ) -> Drawn:
        weighed = [(chunk, estimate, weights.of(chunk) / np.float32(chunk.pixels)) for chunk, estimate in renders]
        counts = {chunk.level: weights.visible(chunk.level) for chunk in pictures}
        return cls(weighed, pictures, counts, Lookups(crops, [*(chunk for chunk, _ in renders), *pictures]))


Pause = Callable[[], None]
"""Is called many times in a round. It raises an exception where the round is to be abandoned."""


def work(
    free: dict[int, Crop],
    drawn: Drawn,
    steps: int,
    trust: float,
    turn: int,
    rng: np.random.Generator,
    pause: Pause,
) -> None:
    """One round on its chunks: curvature where the texels are, then steps.

    Args:
        free: crops whose texels move.
        steps, trust: as a descent has them. turn: how many rounds there were before.
    """
    model = next(iter(free.values())).model
    texels = drawn.lookups.texels()
    curvature = _curvature(model, free, drawn, texels, turn, rng, pause)
    systems = {}
    for i, crop in free.items():
        if crop.held is None and trust:
            crop.held, crop.mean = _MEMORY * trust * curvature[i], crop.coordinates
        start, before = _flat(crop.coordinates), None if crop.held is None else _flat(crop.held)
        unit, ends = units(start, model), limits(start, model)
        systems[i] = System(start, _flat(curvature[i]), before, unit, ends, _DAMPING)
    for step in range(steps):
        rows = gradients_of(model, drawn, drawn.lookups.texels() if step else texels, pause)
        for i, crop in free.items():
            pause()
            by_texel = drawn.lookups.scattered(i, rows)
            if by_texel is not None:
                here, slope = (_flat(each) for each in (crop.coordinates, crop.gradient(by_texel)))
                crop.move(systems[i].stepped(here, slope).reshape(crop.coordinates.shape))
    age = turn + trust
    memory = 1 - 1 / min(1 + _MEMORY * age, _MOST_MEMORY)
    weight = (_RECENT + 1) / (_RECENT + age + 1)
    for i, crop in free.items():
        here = crop.coordinates
        crop.held = memory * (curvature[i] if crop.held is None else crop.held + curvature[i])
        crop.mean = here if crop.mean is None else crop.mean + weight * (here - crop.mean)


def gradients_of(model: str, drawn: Drawn, texels: Sequence[Image], pause: Pause) -> list[NDArray[np.float32]]:
    """(P, C) of each chunk: half the gradients of what is minimised by what its pixels see."""
    rows = []
    for (chunk, estimate, weight), seen in zip(drawn.renders, texels, strict=False):
        pause()
        light, view = (in_every_frame(each, chunk.frames)[None] for each in (chunk.light, chunk.view))
        off = mean_of_frames(shade(model, seen[None], light, view), chunk.frames)
        off -= estimate
        off *= weight[..., None]
        rows.append(shade_adjoint(model, seen[None], light, view, in_frames(off, chunk.frames))[0])
    others = texels[len(drawn.renders) :]
    found = picture_slopes(drawn.pictures, others, model, drawn.visible_counts)
    for picture, seen, slopes in zip(drawn.pictures, others, found, strict=True):
        rows.append(picture.adjoint(model, seen, slopes.by_radiance))
    return rows


def _curvature(
    model: str,
    free: dict[int, Crop],
    drawn: Drawn,
    texels: Sequence[Image],
    turn: int,
    rng: np.random.Generator,
    pause: Pause,
) -> dict[int, Image]:
    """(h, w, P, P) of each level: sum over pixels of share times J^T w J, with J the derivative by its coordinates.

    Of the three colour channels of a render a combination with random signs is differentiated: over many renders, the
    mean of (J^T s)(J^T s)^T is J^T J.
    """
    stride = _STRIDE if turn else 1
    some = slice(turn % stride, None, stride)
    packed = []
    for (chunk, _, weight), seen in zip(drawn.renders, texels, strict=False):
        pause()
        turned = signs((len(weight[some]), *weight.shape[1:], 3), rng)
        turned *= np.sqrt(stride * weight[some])[..., None]
        light, view = (in_every_frame(d[some], chunk.frames)[:, None] for d in (chunk.light, chunk.view))
        # The frames of a pixel have equal shares in it, which sum to 1.
        turned = in_frames(turned, chunk.frames)
        if chunk.frames > 1:
            turned *= np.float32(np.sqrt(chunk.frames))
        by_pair = shade_adjoint(model, np.broadcast_to(seen, (len(turned), *seen.shape)), light, view, turned)
        packed.append(_packed(without_heights(by_pair, seen, model)))
    others = texels[len(drawn.renders) :]
    found = picture_slopes(drawn.pictures, others, model, drawn.visible_counts)
    for picture, seen, slopes in zip(drawn.pictures, others, found, strict=True):
        # The lookups of a pixel have equal shares in it, which sum to 1.
        by_lookup = picture.adjoint(model, seen, slopes.combinations(rng)) * np.float32(np.sqrt(picture.parts))
        packed.append(_packed(without_heights(by_lookup, seen, model)[None]))
    out = {}
    for i, crop in free.items():
        pause()
        scale = per_coordinate(crop.coordinates, model)
        size = scale.shape[-1]
        full = np.zeros((*scale.shape, size), np.float32)
        summed = drawn.lookups.scattered(i, packed)
        if summed is not None:
            inside = summed[crop.rows.inside, crop.columns.inside]
            upper = np.triu_indices(size)
            full[..., upper[0], upper[1]] = inside
            full[..., upper[1], upper[0]] = inside
        full *= scale[..., :, None]
        full *= scale[..., None, :]
        out[i] = full
    return out


def _packed(rows: Image) -> Image:
    """(P, D (D + 1) / 2): the upper halves of the sums over K of the squares v v^T of (K, P, D) vectors v."""
    turned = np.ascontiguousarray(np.moveaxis(rows, -1, 0))
    first, second = np.triu_indices(len(turned))
    out = np.empty((rows.shape[1], len(first)), np.float32)
    for index, (i, j) in enumerate(zip(first.tolist(), second.tolist(), strict=True)):
        out[:, index] = np.einsum("kp,kp->p", turned[i], turned[j])
    return out


def _flat(values: Image) -> Image:
    """(h w, ...) of (h, w, ...)."""
    return values.reshape(-1, *values.shape[2:])
