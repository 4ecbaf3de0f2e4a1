"""Renders of a mesh in one call of plain arguments, for tests."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mipbake.comparing.meshes import mesh_render
from mipbake.comparing.meshes.camera import Camera
from mipbake.comparing.meshes.mesh import Mesh
from mipbake.comparing.meshes.mesh_render import Frame, Reference, Shot
from mipbake.material.filtered_source import FilteredSource
from mipbake.material.pixel_filter import Wrap
from mipbake.quality.environment import Lighting

Image = NDArray[np.float32]


def candidate(
    mesh: Mesh,
    camera: Camera,
    lighting: Lighting,
    levels: Sequence[Image],
    model: str,
    wrap: Wrap,
    resolution: tuple[int, int],
    **more: Any,
) -> Frame:
    return mesh_render.candidate(Shot(mesh, camera, lighting, resolution), levels, model, wrap, **more)


def reference(
    mesh: Mesh,
    camera: Camera,
    lighting: Lighting,
    stored: Image,
    model: str,
    wrap: Wrap,
    resolution: tuple[int, int],
    pixel_filter: str,
    seed: int,
    candidates: Sequence[Frame],
    min_passes: int = 32,
    max_passes: int = 4096,
    **more: Any,
) -> Reference:
    shot, source = Shot(mesh, camera, lighting, resolution), FilteredSource(stored, model, wrap, pixel_filter)
    return mesh_render.reference(shot, source, seed, candidates, least=min_passes, most=max_passes, **more)
