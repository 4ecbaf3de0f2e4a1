"""Materials in memory, and the patches of one step."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mipbake import material
from mipbake.base.errors import InputError, MipbakeError, UsageError
from mipbake.training.augmentation import augment, mix, permute_colours, reorient
from mipbake.training.captured import MODEL as CAPTURED
from mipbake.training.captured import captured_set
from mipbake.training.config import DataConfig, TrainingConfig
from mipbake.training.procedural import MODEL, procedural_set

Crops = NDArray[np.float32]  # (B, size, size, C) stored channels

_STRIDES = (2, 4, 8)  # texels of a set from one texel of a patch to the next
_VALIDATION_SEEDS = 1_000_000  # generated sets from here on are for validation; a seed
_GENERATED = 8  # sets for validation, of each generator


@dataclass(frozen=True)
class Materials:
    """Level 0 of texture sets.

    Args:
        images: (H, W, C) stored channels each, float16: half the memory, and finer than 8-bit sources.
        model: material model of the images.
        captured: sets in a model of their own, which are read in that model alone, beside the others; None for none.
    """

    images: Sequence[NDArray[np.float16]]
    model: str
    captured: Materials | None = None

    def __len__(self) -> int:
        return len(self.images) + (len(self.captured) if self.captured else 0)

    def of(self, model: str) -> list[tuple[NDArray[np.float16], str]]:
        """What a model is read from: images, and the model of each."""
        own = [(image, self.model) for image in self.images]
        return own + (self.captured.of(model) if self.captured and self.captured.model == model else [])

    def crops(self, count: int, size: int, model: str, rng: np.random.Generator, strided: float = 0.0) -> Crops:
        """`count` patches in a model, of random sets at random places; a share of every 2nd, 4th or 8th texel."""
        patches, sets = [], self.of(model)
        for index in rng.integers(len(sets), size=count):
            (image, stored_as), stride = sets[index], 1
            if strided and rng.random() < strided:
                stride = int(rng.choice(_STRIDES))
                while (size - 1) * stride + 1 > min(image.shape[:2]):
                    stride //= 2
            extent = (size - 1) * stride + 1
            top, left = (int(rng.integers(n - extent + 1)) for n in image.shape[:2])
            patch = image[top : top + extent : stride, left : left + extent : stride].astype(np.float32)
            patches.append(material.convert(patch, stored_as, model))
        return np.stack(patches)


def load_materials(config: TrainingConfig) -> tuple[Materials, Materials]:
    """Training and validation materials, in that order.

    Raises:
        UsageError: the configuration names no data. InputError: the folder holds no set, or one that cannot be used.
    """
    data = config.data
    # One copy serves several encoders, in the model that any two models are converted through.
    model = config.network.encoders[0] if len(config.network.encoders) == 1 else material.COMMON
    if not data.folder and not data.procedural_sets:
        raise UsageError("no training data: set data.folder, or data.procedural_sets to at least 1")
    train, held_out = _folder(data, model, config.loss.crop_size) if data.folder else ([], [])
    train += [_procedural(seed, data, model) for seed in range(data.procedural_sets)]
    validation_seeds = range(_VALIDATION_SEEDS, _VALIDATION_SEEDS + _GENERATED)
    held_out = held_out or [_procedural(seed, data, model) for seed in validation_seeds]
    beside: list[Materials | None] = [None, None]
    if data.captured_sets:
        beside = [
            Materials([captured_set(seed, data.procedural_size).astype(np.float16) for seed in seeds], CAPTURED)
            for seeds in (range(data.captured_sets), validation_seeds)
        ]
    return Materials(train, model, beside[0]), Materials(held_out, model, beside[1])


_Images = list[NDArray[np.float16]]


def _folder(data: DataConfig, model: str, crop_size: int) -> tuple[_Images, _Images]:
    import mipbake

    folder = Path(data.folder)
    if not folder.is_dir():
        raise InputError(f"{folder}: no such folder of texture sets; set data.folder or pass --data")
    train: _Images = []
    held_out: _Images = []
    for index, path in enumerate(sorted(p for p in folder.iterdir() if p.is_dir())):
        try:
            stored = mipbake.load(path).material(model)
        except MipbakeError as error:
            raise InputError(f"{error} (while reading the training data)") from error
        if min(stored.shape[:2]) < crop_size:
            raise InputError(f"{path}: {stored.shape[1]} x {stored.shape[0]} texels, expected at least {crop_size}")
        kept = data.held_out and index % data.held_out == data.held_out - 1
        (held_out if kept else train).append(stored.astype(np.float16))
    if not train:
        raise InputError(f"{folder}: no texture sets found, expected one in each subfolder")
    return train, held_out


def _procedural(seed: int, data: DataConfig, model: str) -> NDArray[np.float16]:
    return material.convert(procedural_set(seed, data.procedural_size), MODEL, model).astype(np.float16)


def draw_crops(
    materials: Materials, count: int, size: int, model: str, rng: np.random.Generator, data: DataConfig | None = None
) -> Crops:
    """`count` augmented patches of a model: each two patches, differently augmented, mixed by a Perlin-noise mask.

    As `data.mixed` has it, the two are patches of any two materials, or one and the same patch. A share of `data.plain`
    is one material with nothing changed but its orientation and the order of colours.
    """
    data = data or DataConfig()
    itself = data.mixed == "itself"
    crops = materials.crops(count if itself else 2 * count, size, model, rng, data.strided)
    patches = augment(np.concatenate([crops, crops]) if itself else crops, model, rng, data.turned, data.boosted)
    patches = mix(patches[:count], patches[count:], rng, always=itself)
    if not data.plain:
        return patches
    plain = permute_colours(crops[:count], model, rng)
    if data.turned:
        plain = reorient(plain, model, rng)
    return np.where((rng.random(count) < data.plain)[:, None, None, None], plain, patches)


def step_generator(seed: int, step: int, rank: int = 0) -> np.random.Generator:
    """The random numbers of one step: a pure function of seed and step, so that a resumed run draws the same; and of
    the process, where several draw for one step."""
    return np.random.default_rng([seed, step, rank] if rank else [seed, step])
