"""Meshes that users name: OBJ and glTF 2.0 files."""

from __future__ import annotations

from pathlib import Path

from mipbake.base.errors import InputError
from mipbake.comparing.meshes.mesh import Mesh
from mipbake.comparing.meshes.mesh_gltf import read_gltf
from mipbake.comparing.meshes.mesh_obj import read_obj

_READERS = {".obj": read_obj, ".gltf": read_gltf, ".glb": read_gltf}


def read_mesh(path: Path) -> Mesh:
    """All triangles of a file, as one mesh in the file's own units; what carries no texture coordinates is refused.

    Of an OBJ file every object and group; of a glTF file every mesh of the default scene, where its nodes put it. See
    `read_obj` and `read_gltf` for what becomes of normals and tangents.

    Raises:
        InputError: no such file, another kind than .obj, .gltf and .glb, or contents that are broken, compressed,
            without triangles, without texture coordinates, or not finite.
    """
    reader = _READERS.get(path.suffix.lower())
    if reader is None:
        raise InputError(
            f"the mesh {path} is of a kind that is not read: expected a file that ends in {', '.join(_READERS)}, so "
            "convert it to glTF"
        )
    return reader(path)
