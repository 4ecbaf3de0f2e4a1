"""Mesh renders: the candidate against closed forms, the reference against the one in texture space, and its error."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import torch

from mipbake.comparing.meshes import shapes, visible
from mipbake.comparing.meshes.camera import Camera, orbit
from mipbake.comparing.meshes.mesh import Mesh
from mipbake.comparing.meshes.mesh_render import Frame
from mipbake.comparing.meshes.tangents import with_tangents
from mipbake.comparing.meshes.visible import Surface
from mipbake.material.filtered_source import FilteredSource
from mipbake.quality import round_lookups as texture_space
from mipbake.quality.environment import directional
from mipbake.quality.metrics.pairs import LightViewPairs
from mipbake.quality.reference.estimate import reference as filtered
from mipbake.shading import reference as shading_reference

from .mesh_renders import candidate, reference

WRAP = ("wrap", "wrap")
LIGHTS = directional("two", [[0.3, 1, 0.2], [-0.5, 0.6, 0.4]], [[2.0, 1.8, 1.5], [0.3, 0.5, 0.9]])


def gltf(size: int, seed: int = 0, bump: float = 0.3) -> Any:
    """(size, size, 8) float32: a random material of the model `gltf`, smooth over a few texels."""
    rng = np.random.default_rng(seed)
    out = np.empty((size, size, 8), np.float32)
    out[..., :3] = rng.uniform(0.1, 0.9, (size, size, 3))
    out[..., 3] = rng.random((size, size)) < 0.3
    out[..., 4] = rng.uniform(0.25, 0.8, (size, size))
    out[..., 5:7] = rng.uniform(-bump, bump, (size, size, 2))
    out[..., 7] = np.sqrt(1 - (out[..., 5:7] ** 2).sum(-1))
    return out


def chain(level: Any) -> list[Any]:
    """A MIP chain of plain 2 x 2 averages."""
    levels = [level]
    while levels[-1].shape[0] > 1:
        a = levels[-1]
        levels.append((a[::2, ::2] + a[1::2, ::2] + a[::2, 1::2] + a[1::2, 1::2]) / np.float32(4))
    return levels


def constant(size: int = 4) -> list[Any]:
    texel = np.array([0.8, 0.4, 0.2, 0.25, 0.35, 0.2, -0.1, 0.97], np.float32)
    return chain(np.broadcast_to(texel, (size, size, 8)).copy())


def test_a_constant_material_on_a_plane_equals_the_closed_form() -> None:
    camera, height, width = Camera((0.4, 1.5, 2.2), (0.1, 0, -0.3), field_of_view=35), 24, 40
    mesh, levels = shapes.plane(40, 40, (20, 20)), constant()
    frame = candidate(mesh, camera, LIGHTS, levels, "gltf", WRAP, (height, width))

    # Rays through the pixels' centres, worked out from the camera's definition alone.
    back = np.array([0.3, 1.5, 2.5]) / np.linalg.norm([0.3, 1.5, 2.5])
    right = np.cross([0, 1, 0], back) / np.linalg.norm(np.cross([0, 1, 0], back))
    x = ((np.arange(width) + 0.5) / width * 2 - 1) * np.tan(np.radians(17.5)) * width / height
    y = (1 - (np.arange(height) + 0.5) / height * 2) * np.tan(np.radians(17.5))
    ray = x[None, :, None] * right + y[:, None, None] * np.cross(back, right) - back
    hit = np.array([0.4, 1.5, 2.2]) - 1.5 / ray[..., 1:2] * ray
    assert frame.coverage.all() and (np.abs(hit[..., [0, 2]]) < 20).all()
    assert np.allclose(frame.uv, hit[..., [0, 2]] / 2 + 10, atol=1e-5)
    view = -ray / np.linalg.norm(ray, axis=-1, keepdims=True)

    def local(w: Any) -> Any:  # t = +x, b = -z, n = +y
        return torch.from_numpy(np.stack([w[..., 0], -w[..., 2], w[..., 1]], -1))

    texels = torch.from_numpy(np.broadcast_to(levels[0][0, 0], (1, height * width, 8)).astype(np.float64))
    views = local(view).reshape(1, 1, -1, 3).expand(1, 2, -1, 3)
    f = shading_reference.shade("gltf", texels, local(LIGHTS.direction)[None], views)[0].numpy()
    expected = np.einsum("kpc,kc->pc", f, LIGHTS.radiance).reshape(height, width, 3)
    assert np.abs(frame.image - expected).max() < 2e-5 * expected.max()

    again = reference(mesh, camera, LIGHTS, levels[0], "gltf", WRAP, (height, width), "gaussian",
                      0, [frame])  # fmt: skip
    assert again.interior.all()
    # The filter's mean of a smooth function: off by its curvature over a pixel alone.
    assert np.abs(again.image - expected).max() < 2e-3 * expected.max()


def head_on(size: int, texels: int, lod: int, height: float = 4000.0) -> tuple[Mesh, Camera]:
    """A plane seen from far above, where a pixel covers 2^lod texels; the view is 1 / height off at most."""
    pixels_of_texture = texels / 2**lod
    mesh = shapes.plane(4, 4, (4 * size / pixels_of_texture / 2, 4 * size / pixels_of_texture / 2))
    angle = 2 * np.degrees(np.arctan(1 / height))  # 2 units, half of the plane, fill the image
    return mesh, Camera((0, height, 0), up=(0, 0, -1), field_of_view=angle, near=1, far=2 * height)


@pytest.mark.parametrize("pixel_filter", ["gaussian", "mitchell"])
def test_a_plane_seen_head_on_equals_the_renders_in_texture_space(pixel_filter: str) -> None:
    size, lod = 12, 2
    level = gltf(32)
    mesh, camera = head_on(size, 32, lod)
    light = directional("slanted", [[0.5, 0.8, -0.3]], [[1, 1, 1]])
    local = np.array([[light.direction[0, 0], -light.direction[0, 2], light.direction[0, 1]]], np.float32)
    pairs = LightViewPairs(light=local, view=np.array([[0, 0, 1]], np.float32))

    frame = candidate(mesh, camera, light, chain(level), "gltf", WRAP, (size, size))
    assert np.abs(frame.lod - lod).max() < 1e-3
    uv = frame.uv.reshape(-1, 2).astype(np.float64)
    column, row = np.meshgrid(np.arange(size), np.arange(size))
    step = 2**lod / 32
    corner = np.stack([column - size, row - size], -1) * step + step / 2 + 2 * size * step
    assert np.abs((frame.uv - corner + size * step / 2 + 0.5) % 1 - 0.5).max() < 1e-4
    expected = texture_space.candidate(chain(level), "gltf", WRAP, uv, lod, pairs)
    assert np.abs(frame.image.reshape(1, -1, 3) - expected).max() < 2e-3 * expected.max()

    got = reference(mesh, camera, light, level, "gltf", WRAP, (size, size), pixel_filter, 1,
                    [frame], max_passes=2048)  # fmt: skip
    source = FilteredSource(level, "gltf", WRAP, pixel_filter)
    truth = filtered(source, uv, lod, pairs, 16384, np.random.default_rng(2)).reshape(size, size, 3)
    distance = np.sqrt(np.mean((got.image - truth) ** 2))
    assert distance < 3 * got.standard_error + 2e-3 * truth.mean()
    assert got.converged and got.standard_error < 0.11 * np.sqrt(np.mean((frame.image - truth) ** 2))


def test_mirrored_texture_coordinates_show_the_mirrored_material() -> None:
    mesh, levels = shapes.plane(2, 2), chain(gltf(16))
    camera = orbit(3, 25, 50)
    plain = candidate(mesh, camera, LIGHTS, levels, "gltf", WRAP, (48, 48))
    for axis in (0, 1):
        mirrored = mesh.uv.copy()
        mirrored[:, axis] = 1 - mirrored[:, axis]
        other = with_tangents("mirrored", mesh.positions, mesh.normals, mirrored, mesh.triangles)
        assert (other.tangents[:, 3] == -1).all()
        sign = np.ones(8, np.float32)
        sign[5 + axis] = -1
        flipped = [np.flip(level, 1 - axis) * sign for level in levels]
        got = candidate(other, camera, LIGHTS, flipped, "gltf", WRAP, (48, 48))
        assert np.array_equal(got.coverage, plain.coverage)
        assert np.abs(got.image - plain.image).max() < 1e-4 * plain.image.max()
        wrong = Mesh("wrong", other.positions, other.normals, other.uv, np.abs(other.tangents), other.triangles)
        assert np.abs(candidate(wrong, camera, LIGHTS, flipped, "gltf", WRAP, (48, 48)).image - plain.image).max() > 0.1


def scene() -> tuple[Any, ...]:
    return shapes.sphere(24), orbit(2.6, 30, 20), LIGHTS, gltf(64, bump=0.5), "gltf", WRAP, (40, 40)


def baseline(*arguments: Any) -> Frame:
    mesh, camera, lighting, level, *rest = arguments
    return candidate(mesh, camera, lighting, chain(level), *rest)


@pytest.mark.long
def test_the_error_estimate_is_honest_against_a_long_run() -> None:
    arguments = scene()
    frame = baseline(*arguments)
    long = reference(*arguments, "gaussian", 9, [frame], min_passes=2048, max_passes=2048)
    true_error = np.sqrt(np.mean((frame.image - long.image)[long.interior] ** 2))
    for seed in range(3):
        got = reference(*arguments, "gaussian", seed, [frame], min_passes=64, max_passes=64)
        both = got.interior & long.interior
        noise = np.sqrt(np.mean((got.image - long.image)[both] ** 2))
        assert 0.6 < got.standard_error / noise < 1.7
        assert got.candidate_error == pytest.approx(true_error, rel=0.1)
    assert long.standard_error < 0.25 * noise


def test_passes_go_on_until_the_target_is_met_or_the_cap() -> None:
    arguments = scene()
    frame = baseline(*arguments)
    shares: list[float] = []
    got = reference(*arguments, "gaussian", 0, [frame], min_passes=4, progress=shares.append)
    assert got.converged and got.standard_error <= 0.1 * got.candidate_error and got.passes > 4
    assert shares == sorted(shares) and 0 < shares[0] < 0.1 and shares[-1] == 1
    capped = reference(*arguments, "gaussian", 0, [frame], resolved_share=1e-4, min_passes=4, max_passes=8)
    assert not capped.converged and capped.passes == 8
    same = reference(*arguments, "gaussian", 0, [frame], min_passes=4)
    assert np.array_equal(got.first, same.first) and np.array_equal(got.second, same.second)
    assert not np.array_equal(got.first, got.second)
    # Every sample of the interior lies on the mesh: of its outline even a whole ring does not.
    edge = frame.coverage & ~got.interior
    assert edge.sum() > 40 and not (got.interior & ~frame.coverage).any()


def test_bands_of_rows_are_parts_of_what_all_rows_see(monkeypatch: pytest.MonkeyPatch) -> None:
    mesh, camera, *_, resolution = scene()
    surface, offset = Surface(mesh, camera, resolution), (0.3, -0.4)
    (whole,) = surface.bands(offset)
    for band, count in ((1, 40), (130, 14), (799, 3)):
        monkeypatch.setattr(visible, "BAND", band)
        parts = list(surface.bands(offset))
        assert len(parts) == count
        for name in ("index", "uv", "frame", "view"):
            joined = np.concatenate([getattr(part, name) for part in parts])
            assert np.array_equal(joined, getattr(whole, name)), (band, name)


def test_nothing_in_view_is_a_black_image() -> None:
    mesh = shapes.plane()
    camera = Camera((0, 1, 10), (0, 1, 20))
    frame = candidate(mesh, camera, LIGHTS, constant(), "gltf", WRAP, (8, 8))
    assert not frame.coverage.any() and not frame.image.any()
    got = reference(mesh, camera, LIGHTS, constant()[0], "gltf", WRAP, (8, 8), "box", 0, [frame])
    assert got.converged and not got.image.any() and not got.interior.any()
