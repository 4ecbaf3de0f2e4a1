"""Stamps of tiles: a renderer that uploads what they say always has exactly the texels that it is to show."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from mipbake.base.errors import RendererError
from mipbake.fitting import Levels, fit
from mipbake.fitting.renderer import TILE, Stamps, rectangles, tiles_along
from mipbake.material.pixel_filter import level_sizes

from .fitting_small import SIDE, Plain, Spot, start

LARGE = 150
"""Texels a side: three tiles at level 0, of which the last ones are smaller, and two at level 1."""

# ---- rectangles


def covered(changed: NDArray[np.bool_], size: tuple[int, int]) -> NDArray[np.bool_]:
    """(H, W) texels of changed tiles, one by one."""
    rows, columns = np.indices(size) // TILE
    return np.asarray(changed[rows, columns])


@pytest.mark.parametrize("size", [(1, 1), (64, 64), (65, 200), (100, 75), (256, 128), (300, 450)])
def test_rectangles_hold_exactly_the_changed_tiles(size: tuple[int, int]) -> None:
    rng = np.random.default_rng(size)
    for share in (0.0, 0.2, 0.5, 0.8, 1.0):
        changed = rng.random(tiles_along(size)) < share
        counted = np.zeros(size, int)
        for part in rectangles(changed, size):
            assert part.height > 0 and part.width > 0 and part.of(counted).shape == (part.height, part.width)
            part.of(counted)[...] += 1
        assert counted.max() <= 1
        assert np.array_equal(counted > 0, covered(changed, size))


def test_neighbours_are_one_rectangle() -> None:
    size = (300, 260)  # 5 x 5 tiles
    assert rectangles(np.ones((5, 5), bool), size) == [(0, 0, 300, 260)]
    assert rectangles(np.zeros((5, 5), bool), size) == []
    changed = np.zeros((5, 5), bool)
    changed[1:4, 1:3] = changed[1:3, 4] = changed[4, 1:4] = True
    assert rectangles(changed, size) == [(64, 64, 192, 128), (64, 256, 128, 4), (256, 64, 44, 192)]
    apart = np.zeros((5, 5), bool)
    apart[[0, 2], 1] = True  # equal runs, and a row of tiles between them
    assert rectangles(apart, size) == [(0, 64, 64, 64), (128, 64, 64, 64)]


# ---- in fits


@dataclass(eq=False)
class Keeper(Plain):
    """Keeps copies of all texels, as a GPU does, and takes over only what stamps say; it counts the tiles of each call.

    Args:
        fails_at: the call that raises.
    """

    fails_at: int = -1
    counts: list[int] = field(default_factory=list)
    copies: dict[str, list[NDArray[np.float32]]] = field(default_factory=dict)
    known: tuple[NDArray[np.int64], ...] | None = None

    def render(self, levels: Levels, view: Spot) -> Any:
        if len(self.counts) == self.fails_at:
            self.counts.append(0)
            raise RendererError("broken: expected another one")
        if not self.copies:
            self.copies = {name: [np.zeros_like(each) for each in maps] for name, maps in levels.maps.items()}
        before = [np.zeros_like(each) for each in levels.stamps] if self.known is None else self.known
        self.counts.append(sum(int((a != b).sum()) for a, b in zip(levels.stamps, before, strict=True)))
        for index, parts in enumerate(levels.changed(self.known)):
            for name, copies in self.copies.items():
                for part in parts:
                    part.of(copies[index])[...] = part.of(levels.maps[name][index])
        self.known = levels.stamps
        for name, maps in levels.maps.items():
            for index, (copy, level) in enumerate(zip(self.copies[name], maps, strict=True)):
                assert np.array_equal(copy, level), f"{name} of level {index} is stale at call {len(self.counts)}"
        return super().render(levels, view)


def places(levels: Sequence[int] = (0, 1, 2), each: int = 10) -> list[Spot]:
    """Views that show some tiles each, anywhere on the large set."""
    rng = np.random.default_rng(3)
    return [
        Spot(f"place {number} of level {level}", level, offset=tuple(rng.uniform(0, LARGE / 2**level, 2)))
        for level in levels
        for number in range(each)
    ]


def kept(renderer: Any, views: Sequence[Spot] | None = None, **more: Any) -> Any:
    """A fit of the large set to grey."""
    found = places() if views is None else views
    wanted = [np.full((SIDE, SIDE, 3), 0.2)] * len(found)
    return fit(start(LARGE), renderer, found, reference=wanted, **({"steps": 240} | more))


@pytest.mark.long
@pytest.mark.filterwarnings("ignore:no view that is held out")
@pytest.mark.parametrize("more", [{}, {"renders": 3}, {"rate": 30.0, "steps": 480}])
def test_a_renderer_that_follows_the_stamps_has_all_texels(
    more: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    restored: list[int] = []
    tiles = Stamps.level

    def noted(stamps: Stamps, level: int) -> slice:
        restored.append(level)
        return tiles(stamps, level)

    monkeypatch.setattr(Stamps, "level", noted)
    renderer = Keeper()
    kept(renderer, **more)
    assert len(renderer.counts) > 480
    if "rate" in more:
        assert restored  # steps that are far too long make levels worse


@pytest.mark.filterwarnings("ignore:no view that is held out")
def test_stamps_of_other_tiles_stay() -> None:
    """A step stamps what its view shows, and what the view before has shown: at most 9 of 17 tiles and more each."""
    renderer = Keeper()
    views = places((0,))
    kept(renderer, views, steps=16)
    learned = len(views) - 2 - 1  # two are held out, and one is apart, which is prepared in the end
    prepared, probed = len(views) - 1, 6 * learned
    steps = renderer.counts[prepared + probed :][: 2 * learned]
    assert len(steps) == 14
    # An image of 8 x 8 pixels lies in 1, 2 or 4 tiles of level 0. A first step gets all, since nothing is known of it.
    assert all(count <= 4 for count in steps[1::2])
    assert all(count <= 8 for count in steps[2::2])
    total = sum(int(np.prod(tiles_along(size))) for size in level_sizes(LARGE, LARGE))
    assert steps[0] == total > 8
