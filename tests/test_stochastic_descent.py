"""Several groups of parameters descend together, each credited by the pixels that show it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest
import torch
from numpy.typing import NDArray

from mipbake.base.errors import UsageError
from mipbake.stochastic import Channels, Descent, Group, Shown

PIXELS, TILES = 64, 16

TILE_OF = np.repeat(np.arange(TILES, dtype=np.int32), PIXELS // TILES)[:, None]
UNIT = Channels((0.02, 0.02), (0.0, 0.0), (1.0, 1.0))


def rendered(values: Mapping[str, Any]) -> Shown:
    """Tiles with two channels each, lit by a lamp that all pixels show."""
    tiles, lamp = values["tiles"], values["lamp"]
    index = TILE_OF if isinstance(tiles, np.ndarray) else torch.from_numpy(TILE_OF)
    return Shown(tiles[index[:, 0]] * (0.5 + lamp), {"tiles": index})


def scene() -> tuple[dict[str, NDArray[np.float64]], NDArray[np.float64]]:
    """What to begin with, and what is wanted."""
    generator = np.random.default_rng(3)
    solution = {"tiles": generator.uniform(0.3, 0.7, (TILES, 2)), "lamp": np.array([[0.8, 0.3]])}
    start = {"tiles": np.full((TILES, 2), 0.5), "lamp": np.array([[0.5, 0.5]])}
    return start, np.asarray(rendered(solution).image)


def descended(as_tensors: bool, steps: int = 300, seed: int = 0) -> tuple[list[float], Descent]:
    start, wanted = scene()
    kind = torch.from_numpy if as_tensors else np.asarray
    descent = Descent({name: Group(kind(each), UNIT) for name, each in start.items()}, seed)
    views = [(rendered, kind(wanted))] * 2
    return [descent.step(views, 1 - step / steps) for step in range(steps)], descent


@pytest.mark.parametrize("as_tensors", [False, True])
def test_a_lamp_and_what_it_lights_are_found_together(as_tensors: bool) -> None:
    errors, descent = descended(as_tensors)
    start, wanted = scene()
    before = float(np.square(np.asarray(rendered(start).image) - wanted).mean())
    after = float(np.square(np.asarray(rendered(descent.values).image) - wanted).mean())
    assert after < before / 1000
    assert errors[-1] < errors[0] / 10
    assert descent.estimates == 600


def test_a_descent_repeats_from_its_seed_and_arrays_and_tensors_agree() -> None:
    values = [descended(*each, steps=20)[1].values for each in ((False,), (False,), (True,))]
    for name, first in values[0].items():
        assert (first == values[1][name]).all()
        np.testing.assert_allclose(first, values[2][name].numpy(), rtol=0, atol=1e-9)


def test_groups_have_signs_of_their_own() -> None:
    """With equal signs the two sides of equal groups would differ alike, and their product would hold no cross term."""
    seen: list[tuple[Any, Any]] = []

    def render(values: Mapping[str, Any]) -> Shown:
        seen.append((values["a"].copy(), values["b"].copy()))
        return Shown(values["a"][:, :1] + values["b"][:, :1])

    groups = {name: Group(np.full((500, 1), 0.5), Channels((0.1,), (0.0,), (1.0,))) for name in "ab"}
    Descent(groups).step([(render, np.zeros((500, 1)))])
    (a, b), _ = seen
    assert abs(np.corrcoef(a[:, 0], b[:, 0])[0, 1]) < 0.2


def test_what_no_pixel_shows_stays() -> None:
    start, wanted = scene()
    hidden = np.concatenate([start["tiles"], [[0.1, 0.9]]])
    descent = Descent({"tiles": Group(hidden, UNIT), "lamp": Group(start["lamp"], UNIT, rate=0)})
    descent.step([(rendered, wanted)])
    assert hidden[-1].tolist() == [0.1, 0.9]
    assert (hidden[:-1] != start["tiles"]).all()
    assert start["lamp"].tolist() == [[0.5, 0.5]]


def test_a_step_takes_the_mean_of_its_estimates() -> None:
    """By sums, moments would weigh a step of four views four times. Each pixel shows one number, so that all signs give
    the same estimate."""
    own, found = np.arange(PIXELS, dtype=np.int32)[:, None], []
    for counts in ((1, 1), (1, 4), (3, 1)):
        values = np.full((PIXELS, 1), 0.5)
        descent = Descent({"pixels": Group(values, Channels((0.01,), (0.0,), (1.0,)))})
        for count in counts:
            descent.step([(lambda given: Shown(given["pixels"] * 1, {"pixels": own}), np.zeros((PIXELS, 1)))] * count)
        found.append(values)
    np.testing.assert_allclose(found[1:], found[:1] * 2, atol=1e-12)


def test_a_renderer_that_fails_leaves_nothing_of_its_step() -> None:
    _, wanted = scene()
    descents = []
    for faulty in (False, True):
        start, _ = scene()
        descent = Descent({name: Group(each, UNIT) for name, each in start.items()})
        descent.estimates = 1 - faulty
        if faulty:
            with pytest.raises(ZeroDivisionError):
                descent.step([(rendered, wanted + 9), (lambda _: Shown(wanted / (1 // 0)), wanted)])
        descent.step([(rendered, wanted)])
        descents.append(descent.values)
    for name, each in descents[0].items():
        assert (each == descents[1][name]).all()


TILES_OF = np.zeros((TILES, 2))


@pytest.mark.parametrize(
    ("groups", "words"),
    [
        ({}, "groups is empty"),
        (
            {"tiles": np.zeros((16, 3))},
            r"group 'tiles' has shape \(16, 3\): expected \(N, 2\), a number for each channel",
        ),
        ({"tiles": [[0, 0]]}, "group 'tiles' is a list"),
        (
            {"tiles": TILES_OF, "lamp": torch.zeros(1, 2)},
            "'lamp' is a Tensor: expected a NumPy array, as group",
        ),
        ({"tiles": TILES_OF, "lamp": np.float32([[0, 0]])}, "'lamp' is float32: expected float64, as group 'tiles' is"),
        ({"tiles": np.asfortranarray(TILES_OF)}, "group 'tiles' is not contiguous"),
    ],
)
def test_wrong_groups_get_a_sentence(groups: dict[str, Any], words: str) -> None:
    with pytest.raises(UsageError, match=words):
        Descent({name: Group(each, UNIT) for name, each in groups.items()})


@pytest.mark.parametrize(
    ("image", "touched", "words"),
    [
        (np.zeros((PIXELS, 2), np.float32), None, "the image is float32: expected float64, as group 'tiles' is"),
        (np.zeros((1, PIXELS, 2)), None, r"the image has shape \(1, 64, 2\): expected \(P, C\)"),
        (np.zeros((1, 2)), None, r"what should be shown has shape \(64, 2\): expected \(1, 2\)"),
        (np.full((PIXELS, 2), np.nan), None, "error of an image is nan: expected finite numbers"),
        (np.zeros((PIXELS, 2)), TILE_OF[:-1], r"touched\['tiles'\] has shape \(63, 1\): expected \(64, K\)"),
        (np.zeros((PIXELS, 2)), TILE_OF.astype(np.int64), r"touched\['tiles'\] is int64: expected int32$"),
    ],
)
def test_wrong_pictures_get_a_sentence_and_change_nothing(image: Any, touched: Any, words: str) -> None:
    start, wanted = scene()
    descent = Descent({name: Group(each, UNIT) for name, each in start.items()})
    with pytest.raises(UsageError, match=words):
        descent.step([(lambda _: Shown(image, {"tiles": touched}), wanted)])
    assert (start["tiles"] == 0.5).all()


def test_no_views_and_a_seed_that_is_no_number_get_a_sentence() -> None:
    start, _ = scene()
    groups = {name: Group(each, UNIT) for name, each in start.items()}
    with pytest.raises(UsageError, match="views is empty"):
        Descent(groups).step([])
    with pytest.raises(UsageError, match=r"seed is 1.5: expected a whole number"):
        Descent(groups, 1.5)  # type: ignore[arg-type]
