"""What a result was made from, as hashes that stand in it: whoever would bake it again sees that nothing has changed.

The hashes lie in the result itself, in `stack.json` or in the GLB. So they are true wherever the result is copied to,
and no list beside it can be wrong about it.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from mipbake.baking.methods import OPTIONS
from mipbake.baking.options import BakeOptions, BakePlan
from mipbake.base import disk
from mipbake.base.errors import InputError
from mipbake.base.version import __version__
from mipbake.models.registry import WeightsInfo, find_weights, list_weights
from mipbake.source.gltf.document import Document
from mipbake.source.gltf.images import stored_image
from mipbake.source.jobs import Job
from mipbake.source.layout import manifest_name
from mipbake.source.options import LoadOptions
from mipbake.source.sources import Found, MapSource
from mipbake.source.texture_set import TextureSet
from mipbake.stack.gltf.glb import made_from
from mipbake.stack.manifest import read_manifest
from mipbake.stack.map_files import listed_files
from mipbake.stack.stack import Fingerprint

NEW = "there is no result yet"
_CHUNK = 1 << 20  # bytes that are hashed at a time


@dataclass(frozen=True)
class Ingredients:
    """What jobs of one run are made from.

    Args:
        options, weights: hashes, the same for all jobs.
    """

    options: str
    weights: str

    @classmethod
    def of(cls, plan: BakePlan) -> Ingredients:
        """Those of a plan."""
        options = {name: _number(value) for name, value in asdict(plan.options).items()}
        return cls(_hash(options), _hash([info.sha256 for info in weights_of(plan.options)]))

    def recipe(self, job: Job, found: Mapping[int, Found], read: Iterable[TextureSet] = ()) -> Fingerprint:
        """The recipe of a set, or of tiles that touch.

        Args:
            found: what would be read, by tile. read: the same, read: their files are not hashed again.

        Raises:
            InputError: a file cannot be read.
        """
        known = {s.path: s.sha256 for each in read for s in each.found.maps.values() if s.path and s.sha256}
        parts = job.using(
            lambda: [[tile, *_read_as(each, job.parts[tile].options, known)] for tile, each in found.items()]
        )
        return {"sources": _hash([job.warnings, parts]), "options": self.options, "weights": self.weights}

    def document(self, jobs: Sequence[Job]) -> Fingerprint:
        """The recipe of the GLB of a document, from the jobs of all its materials.

        Raises:
            InputError: a file cannot be read.
        """
        document = jobs[0].document
        if document is None:
            raise AssertionError("only documents have such a recipe")
        parts = [self.recipe(job, job.found())["sources"] for job in jobs]
        content = [
            document.json,
            [None if data is None else hashlib.sha256(data).hexdigest() for data in document.buffers],
            [hashlib.sha256(data).hexdigest() for _, data in document.chunks],
            jobs[0].using(lambda: [_image(document, index) for index in range(len(document.all("images")))]),
            parts,
        ]
        return {"sources": _hash(content), "options": self.options, "weights": self.weights}


def _image(document: Document, index: int) -> str:
    try:
        return hashlib.sha256(stored_image(document, index)[0]).hexdigest()
    except InputError:  # who needs it says so, with a path that another run may not have
        return ""


def stopped(recipe: Fingerprint) -> Fingerprint:
    """The recipe of a result whose search was stopped: whoever bakes what has changed bakes it again."""
    return {**recipe, "stopped": "yes"}


def set_changed(folder: Path, tiles: Iterable[int], recipe: Fingerprint) -> str:
    """Why the stacks in a folder are not what a recipe makes, in a sentence without its end; "" where they are.

    Args:
        folder: it may be missing. tiles: whose stacks it holds; 0 for the only one.
    """
    for tile in tiles:
        file = folder / manifest_name(tile)
        try:
            manifest = read_manifest(file)
            sizes = {name: manifest["bytes"][name] for name in listed_files(manifest)}
            provenance = manifest["provenance"]
            found, version = provenance.get("recipe"), provenance.get("tool_version")
        except (InputError, KeyError, TypeError, AttributeError):
            return NEW
        for name, size in sizes.items():
            if not disk.is_file(folder / name):
                return f"its file {name} is missing"
            if (folder / name).stat().st_size != size:
                return f"its file {name} has another size than when it was written"
        if why := _difference(found, version, recipe):
            return why
    return ""


def document_changed(path: Path, recipe: Fingerprint) -> str:
    """The same of the GLB of a document."""
    found = made_from(path)
    return NEW if found is None else _difference(found.get("recipe"), found.get("version"), recipe)


def _difference(found: object, version: object, wanted: Fingerprint) -> str:
    if not isinstance(found, dict) or not found:
        return "its result does not say what it was made from"
    if version != __version__:
        return f"it was baked by mipbake {version}"
    if found.get("stopped"):
        return "its search was stopped before it was done"
    words = {"sources": "its sources changed", "options": "the options changed", "weights": "the weights changed"}
    return next((words[part] for part in words if found.get(part) != wanted[part]), "")


def _read_as(found: Found, read: LoadOptions, known: Mapping[Path, str]) -> list[Any]:
    """What decides a texture set, as plain types without the folders that files lie in."""
    options = (
        *(read.colour_space, read.normal_convention, read.roughness_is_gloss, read.wrap),
        *(sorted(read.factors.items()), read.alpha_cutoff, read.alpha),
    )
    sources = [[role, *_source(source, known)] for role, source in found.maps.items()]
    return [found.name, found.normal_convention.name, found.warnings, options, sources]


def _source(source: MapSource, known: Mapping[Path, str]) -> list[Any]:
    if source.path is None:
        return [source.constant]
    read_as = [source.channels, source.encoding, source.inverted, source.converted, *source.applied]
    return [source.path.name, known.get(source.path) or _file_hash(source.path), *read_as]


def weights_of(options: BakeOptions) -> list[WeightsInfo]:
    """All trained weights that a bake may take; UsageError where there are none of that name."""
    if options.method not in OPTIONS["weights"]:
        return []
    if options.weights is not None:
        return [find_weights(options.weights)]
    return [info for info in list_weights() if info.default]


def _file_hash(path: Path) -> str:
    """SHA-256 of a file in hexadecimal; InputError where it cannot be read."""
    with disk.opened(path) as file:
        made = hashlib.sha256()
        while chunk := file.read(_CHUNK):
            made.update(chunk)
    return made.hexdigest()


def _number(value: object) -> object:
    """The same for 1 and for 1.0."""
    return float(value) if isinstance(value, int) and not isinstance(value, bool) else value


def _hash(content: object) -> str:
    return hashlib.sha256(json.dumps(content, sort_keys=True, default=str).encode()).hexdigest()
