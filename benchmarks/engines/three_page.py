"""The page of three.js: materials and views that are given to it, and what it renders."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from browser import HERE, numbers, opened
from engine_textures import EngineMap, write_map
from numpy.typing import NDArray


@dataclass(frozen=True)
class ThreePage:
    """The page.

    Args:
        page: of playwright.
        folder: for the files that it loads.
    """

    page: Any
    folder: Path

    def add_material(self, name: str, maps: Sequence[EngineMap], container: str) -> None:
        """Adds a material with these maps, of which `float` is level 0 alone."""
        written = {each.name: write_map(each, container, self.folder / name) for each in maps}
        files = {role: {**each, "file": f"{name}/{each['file']}"} for role, each in written.items()}
        levels = "finest" if container == "float" else "levels"
        self.page.evaluate("([name, maps, filter]) => proof.addMaterial(name, maps, filter)", [name, files, levels])

    def add_view(self, name: str, view: Mapping[str, Any]) -> None:
        """Adds a view, as `engine_views.described` has it, or replaces one."""
        (self.folder / "view.json").write_text(json.dumps(view))
        self.page.evaluate("([name, file]) => proof.addView(name, file)", [name, "view.json"])

    def rendered(
        self, view: str, material: str, resolution: tuple[int, int], offsets: Sequence[float] = (0, 0)
    ) -> NDArray[np.float64]:
        """The sum of the renders at sub-pixel offsets, (H, W, 4), top row first; resolution: (height, width)."""
        call = "([view, material, offsets]) => proof.render(view, material, offsets)"
        return numbers(self.page.evaluate(call, [view, material, list(offsets)]), (*resolution, 4))[::-1]


@contextmanager
def opened_three(folder: Path) -> Iterator[ThreePage]:
    """The page, with a folder for its files."""
    with opened(HERE / "three/page.html", folder) as page:
        yield ThreePage(page, folder)
