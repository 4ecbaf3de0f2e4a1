"""Every reader of files, each with a folder of the corpus: one function that reads what a user would give.

A file of that folder is damaged, the others lie beside it as they are.
"""

from __future__ import annotations

import contextlib
import hashlib
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import mipbake
from mipbake.baking.convert import open_material
from mipbake.comparing.meshes.mesh_file import read_mesh
from mipbake.quality.environment import from_file
from mipbake.source.images.read import read_header, read_image
from mipbake.source.inputs import expand
from mipbake.source.intake import jobs
from mipbake.source.jobs import Failure
from mipbake.source.options import LoadOptions
from mipbake.stack.containers import FORMATS
from mipbake.stack.file_info import file_info
from mipbake.stack.gltf.write import check_images, rewritten

Reader = Callable[[Path, Path], None]
"""Reads, given the folder and the file in it that is damaged. A MipbakeError is a right answer."""


def _image(_folder: Path, file: Path) -> None:
    for read in (read_header, read_image, file_info):
        _tried(lambda read=read: read(file))


def _texture_set(folder: Path, _file: Path) -> None:
    mipbake.load(folder)


def _stack(folder: Path, file: Path) -> None:
    _tried(lambda: mipbake.open_stack(folder))
    _tried(lambda: file_info(file))


def _material(folder: Path, _file: Path) -> None:
    open_material(folder)


def _document(folder: Path, _file: Path) -> None:
    """Everything that is baked of the documents in the folder, and what `info` tells of them."""
    for path in sorted(p for p in folder.iterdir() if p.suffix in (".gltf", ".glb", ".mtlx")):
        with TemporaryDirectory() as scratch:
            for job in jobs([str(path)], LoadOptions(), Path(scratch)):
                if isinstance(job, Failure):
                    continue
                _tried(job.found)
                _tried(job.read)
                document, bake = job.document, job.bake
                if document is not None and bake is not None:
                    _tried(lambda document=document, bake=bake: check_images(document, [bake]))
                    _tried(lambda document=document: rewritten(document, [], {}))
        if path.suffix != ".mtlx":
            _tried(lambda path=path: file_info(path))


def _mesh(folder: Path, _file: Path) -> None:
    for path in sorted(p for p in folder.iterdir() if p.suffix in (".gltf", ".glb", ".obj")):
        _tried(lambda path=path: read_mesh(path))


def _environment(_folder: Path, file: Path) -> None:
    from_file(file)


def _list(folder: Path, _file: Path) -> None:
    for path in expand([f"@{folder / 'list.txt'}"]):
        jobs([str(path)], LoadOptions(), folder)


def _weights(folder: Path, file: Path) -> None:
    from mipbake.models.registry import list_weights, load_network

    for info in list_weights(folder):
        # Whoever alters the tensors can alter their hash.
        load_network(replace(info, sha256=hashlib.sha256(info.tensors.read_bytes()).hexdigest()))


STACKS: Mapping[str, str] = {**{f"stack-{name}": name for name in FORMATS}, "stack-uastc": "ktx2:uastc"}
"""By the name of a folder in the corpus, what the stack in it is written as: every container, and UASTC."""

READERS: Mapping[str, Reader] = {
    "images": _image,
    "set": _texture_set,
    **dict.fromkeys(STACKS, _stack),
    "material": _material,
    "gltf": _document,
    "mtlx": _document,
    "mesh": _mesh,
    "environment": _environment,
    "list": _list,
    "weights": _weights,
}
"""By the name of the reader's folder in the corpus."""


def _tried(read: Callable[[], object]) -> None:
    """Reads; a refusal does not keep the next reader from its turn."""
    with contextlib.suppress(mipbake.MipbakeError):
        read()
