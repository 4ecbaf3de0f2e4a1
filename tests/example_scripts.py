"""Scripts of the examples, imported as they import each other, and the picture and the figures that they leave."""

from __future__ import annotations

import importlib
import json
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import OpenImageIO
import torch

EXAMPLES = Path(__file__).parents[1] / "examples"
NAMES = {path.stem for kind in ("fitting", "stochastic") for path in (EXAMPLES / kind).glob("*.py")}


@contextmanager
def scripts(folder: Path) -> Iterator[Callable[[str], Any]]:
    """Imports scripts from a folder, on one thread, as they run. All are forgotten afterwards."""
    threads, path = torch.get_num_threads(), list(sys.path)
    others = {name: sys.modules.pop(name) for name in NAMES & sys.modules.keys()}
    sys.path.insert(0, str(folder))
    torch.set_num_threads(1)
    try:
        yield importlib.import_module
    finally:
        torch.set_num_threads(threads)
        sys.path[:] = path
        for name in NAMES & sys.modules.keys():
            del sys.modules[name]
        sys.modules.update(others)


def figures(folder: Path, name: str) -> Any:
    picture = OpenImageIO.ImageBuf(str(folder / f"{name}.png")).get_pixels("uint8")
    assert picture.shape[2] == 3 and picture.std() > 10  # it shows something
    content = json.loads((folder / f"{name}.json").read_text())
    assert content["seconds"] > 0 and content["machine"]
    return content["figures"]
