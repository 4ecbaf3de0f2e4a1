"""Compares every method on every texture set of a folder, a JSON file a set: what docs/make_results_page.py tabulates.

    python benchmarks/results.py SETS_FOLDER RESULTS_FOLDER [--passes 256] [--crop 64]

Every sub-folder of SETS_FOLDER is one texture set. `whole/SET.json` is `mipbake compare` of it with neural, auto and
all closed forms. `crop/SET.json` is the SNR on the middle of the set, with the per-material optimum beside them:
optimising every texel of whole sets would take hours. Sets that have their file are left alone, so a run that was
stopped goes on.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import mipbake
from mipbake import TextureSet
from mipbake.bake import DEFAULT_FILTER
from mipbake.compare import texture_space
from mipbake.compare.candidates import bake_all, closed_forms, default_names, label
from mipbake.compare.comparing import Settings, compare
from mipbake.compare.result import Comparison
from mipbake.validate import DEFAULT_LODS

MEASURED = ("neural", "auto")
"""Methods that are no closed forms and are quick enough for whole sets."""


def whole(texture_set: TextureSet, settings: Settings) -> dict[str, Any]:
    """Everything but the images of a comparison."""
    forms = (label(*each) for each in closed_forms(DEFAULT_FILTER))
    methods = (*MEASURED, *forms)
    return compare(texture_set, methods=methods, target="gltf", settings=settings).comparison.to_dict()


def crop(texture_set: TextureSet, side: int) -> dict[str, Any]:
    """SNR by level of detail of the middle of a set, addressed with clamping, the optimum among the methods."""
    stored = texture_set.material("gltf")
    top, left = ((length - min(side, length)) // 2 for length in stored.shape[:2])
    part = stored[top : top + side, left : left + side]
    middle = TextureSet.from_arrays(
        texture_set.name,
        base_color=part[..., :3],
        metallic=part[..., 3],
        roughness=part[..., 4],
        normal=part[..., 5:8],
        wrap=("clamp", "clamp"),
    )
    names, notes = default_names("gltf", DEFAULT_FILTER)
    with bake_all(middle, "gltf", DEFAULT_FILTER, ("optimum", *names)) as candidates:
        found = texture_space.measure(middle, candidates, DEFAULT_FILTER, DEFAULT_LODS, scales=())
        methods = tuple(each.method for each in candidates)
    return Comparison(
        texture_set.name, "neural", "gltf", DEFAULT_FILTER, methods, found.curve, found.figures, notes=notes,
        settings={"crop": side},
    ).to_dict()  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("sets", type=Path)
    parser.add_argument("results", type=Path)
    parser.add_argument("--passes", type=int, default=Settings().max_passes, help="of references of renders, at most")
    parser.add_argument(
        "--crop", type=int, default=64, help="texels a side where the optimum is measured; 0 for nowhere"
    )
    options = parser.parse_args()
    settings = Settings(max_passes=options.passes)
    kinds: Mapping[str, Callable[[TextureSet], dict[str, Any]]] = {"whole": lambda s: whole(s, settings)}
    if options.crop:
        kinds = {**kinds, "crop": lambda s: crop(s, options.crop)}
    for kind, measure in kinds.items():
        (options.results / kind).mkdir(parents=True, exist_ok=True)
        for folder in sorted(path for path in options.sets.iterdir() if path.is_dir()):
            file = options.results / kind / f"{folder.name}.json"
            if file.exists():
                continue
            start = time.perf_counter()
            found = measure(mipbake.load(folder))
            partial = file.with_suffix(".part")
            partial.write_text(json.dumps(found, indent=1, default=str))
            partial.rename(file)
            print(f"{kind} {folder.name}: {time.perf_counter() - start:.0f} s", flush=True)


if __name__ == "__main__":
    main()
