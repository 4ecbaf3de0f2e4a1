"""Splats are drawn as their plain twin draws them, and pixels list what they are made of."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import torch

from mipbake.base.errors import UsageError
from mipbake.raster import reference, splats


def scene(count: int = 60, seed: int = 0, height: int = 21, width: int = 37) -> dict[str, Any]:
    """Splats of many shapes, some outside, some behind the eye, over tiles that are not whole."""
    generator = np.random.default_rng(seed)
    turn, size = generator.uniform(0, np.pi, count), generator.uniform(0.6, 6, (count, 2))
    axes = np.stack([np.stack([np.cos(turn), -np.sin(turn)], -1), np.stack([np.sin(turn), np.cos(turn)], -1)], -2)
    inverse = np.linalg.inv((axes * size[:, None] ** 2) @ axes.transpose(0, 2, 1))
    return {
        "centers": generator.uniform(-5, (width + 5, height + 5), (count, 2)).astype(np.float32),
        "conics": np.stack([inverse[:, 0, 0], inverse[:, 0, 1], inverse[:, 1, 1]], -1).astype(np.float32),
        "paint": generator.uniform(0, 1, (count, 4)).astype(np.float32),
        "depth": generator.uniform(-0.2, 1, count).astype(np.float32),
        "resolution": (height, width),
    }


@pytest.mark.parametrize("most", [0, 3, 16])
def test_the_plain_twin_draws_the_same(most: int) -> None:
    given = scene()
    image, shown = splats(**given, most=most)
    tensors = {name: torch.from_numpy(each) if name != "resolution" else each for name, each in given.items()}
    expected, listed = reference.splats(**tensors, most=most)
    np.testing.assert_allclose(image, expected.numpy(), rtol=0, atol=2e-6)
    assert shown.shape == (21, 37, most)
    assert (shown != listed.numpy()).sum() <= 0.001 * shown.size  # a weight may be rounded across 1/255
    assert most == 0 or (shown[..., 0] >= 0).mean() > 0.5
    for name, each in zip(("image", "shown"), splats(**tensors, most=most), strict=True):
        assert (each.numpy() == {"image": image, "shown": shown}[name]).all()


def test_a_splat_in_front_hides_what_is_behind() -> None:
    centers, conics = np.full((2, 2), 8, np.float32), np.tile(np.float32([0.02, 0, 0.02]), (2, 1))
    paint = np.float32([[1, 0, 0, 1], [0, 1, 0, 1]])
    for depth, front in (([2, 1], 1), ([1, 2], 0), ([1, 1], 0), ([-1, 1], 1), ([float("nan"), 1], 1)):
        image, shown = splats(centers, conics, paint, np.float32(depth), (16, 16))
        assert image[8, 8, front] > 0.97
        assert shown[8, 8, 0] == front


def test_what_is_no_ellipse_or_far_away_is_not_drawn() -> None:
    given = scene(4)
    given["conics"][0], given["conics"][1] = (1, 2, 1), np.nan
    given["centers"][2], given["paint"][3, 3] = 1e30, 1 / 300
    image, shown = splats(**given)
    assert (image == 0).all()
    assert (shown == -1).all()


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"centers": np.zeros((3, 3), np.float32)}, r"centers has shape \(3, 3\): expected \(splats, 2\)"),
        ({"conics": np.zeros((3, 3), np.float32)}, r"conics has shape \(3, 3\): expected \(60, 3\)"),
        ({"paint": np.zeros((60, 4))}, "paint is float64: expected float32"),
        ({"depth": torch.zeros(60)}, "depth is a Tensor: expected a NumPy array, as centers is"),
        ({"resolution": (0, 4)}, r"resolution is \(0, 4\)"),
        ({"most": 65}, "most is 65: expected a whole number from 0 to 64"),
    ],
)
def test_wrong_arguments_get_a_sentence(changes: dict[str, Any], words: str) -> None:
    with pytest.raises(UsageError, match=words):
        splats(**(scene() | changes))
