"""Views of a comparison, their renders and measures, and the paper's plots, on tiny sets and closed forms."""

from __future__ import annotations

import dataclasses
import math
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mipbake import shading
from mipbake.baking.methods import METHODS
from mipbake.base.errors import InputError
from mipbake.comparing import pictures
from mipbake.comparing.meshes import shapes
from mipbake.comparing.meshes.mesh import Mesh
from mipbake.comparing.pictures import SHIFT, RenderedView, RenderSettings, render_view
from mipbake.comparing.plots import Turning, apparent_brdf, temporal_slice
from mipbake.comparing.scenes import EXPOSURE, View, median_lod, mesh_views, standard_views
from mipbake.material.aim import ANISOTROPIC, TRILINEAR
from mipbake.material.filtered_source import FilteredSource
from mipbake.material.pixel_filter import level_sizes
from mipbake.quality.environment import directional
from mipbake.quality.figures import Candidate, Method
from mipbake.quality.metrics import MEASURES
from mipbake.quality.samplers import render_sampler

from .mesh_renders import candidate, reference

WRAP = ("wrap", "wrap")
LIGHTS = directional("two", [[0.3, 0.8, 0.6], [-0.5, 0.6, 0.4]], [[2.0, 1.8, 1.5], [0.3, 0.5, 0.9]])
PICTURED = [name for name, measure in MEASURES.items() if measure.needs != "film"]
TEXEL = np.array([0.8, 0.4, 0.2, 0.25, 0.7, 0.2, -0.1, 0.97], np.float32)


def bumpy(size: int = 64) -> Any:
    """(size, size, 8): glossy, of one colour, with bumps of a few texels, down to little more than two."""
    rng = np.random.default_rng(0)
    y, x = np.meshgrid(*[2 * np.pi * np.arange(size) / size] * 2, indexing="ij")
    slopes = np.zeros((2, size, size))
    for _ in range(24):
        a, b = rng.integers(-size * 2 // 5, size * 2 // 5, 2)
        slopes += rng.normal(0, 0.06, (2, 1, 1)) * np.sin(a * x + b * y + rng.uniform(0, 2 * np.pi))
    n = np.stack([*slopes, np.ones((size, size))], -1)
    out = np.broadcast_to(np.float32([0.5, 0.5, 0.5, 0, 0.3, 0, 0, 1]), (size, size, 8)).copy()
    out[..., 5:] = n / np.linalg.norm(n, axis=-1, keepdims=True)
    return out


def baked(stored: Any, *forms: tuple[str, str]) -> list[Candidate]:
    def levels(method: str, kernel: str) -> Any:
        return METHODS[method](stored, "gltf", "gltf", kernel, WRAP, lambda _: None).levels

    return [Candidate(Method(f"{m} ({k})", m, k, "gltf", 0.0), levels(m, k)) for m, k in forms]


def constant(height: int = 32, width: int = 32) -> tuple[Any, list[Candidate]]:
    levels = [np.broadcast_to(TEXEL, (*size, 8)).copy() for size in level_sizes(height, width)]
    return levels[0], [Candidate(Method("constant", "linear", "box", "gltf", 0.0), levels)]


def filtered(stored: Any, pixel_filter: str) -> FilteredSource:
    return FilteredSource(stored, "gltf", WRAP, pixel_filter)


def views(size: tuple[int, int] = (64, 64), **resolutions: tuple[int, int]) -> dict[str, View]:
    given = {"resolution": (48, 48), "plane_resolution": (32, 48)} | resolutions
    last = len(level_sizes(*size)) - 1
    return {view.name: view for view in standard_views(size, LIGHTS, last, **given)}


def values(result: RenderedView, method: str) -> dict[str, float]:
    return {figure.measure: figure.value for figure in result.figures if figure.method == method}


@pytest.mark.parametrize("size", [(1024, 1024), (256, 1024)])
def test_spheres_have_the_median_lod_of_their_scale_and_square_texels(size: tuple[int, int]) -> None:
    found = views(size)
    assert list(found) == ["sphere-near", "sphere-1-1", "sphere-middle", "sphere-far", "plane"]
    assert [view.scale for view in found.values()] == ["near", "1:1", "middle", "far", ""]
    levels = [np.zeros((*s, 8), np.float32) for s in level_sizes(*size)]
    for view, lod in zip(found.values(), (0.0, 0.5, 3.0, 7.0), strict=False):
        assert abs(median_lod(view.mesh, view.camera, view.resolution, size) - lod) < 0.1
        frame = candidate(view.mesh, view.camera, LIGHTS, levels, "gltf", WRAP, view.resolution)
        assert abs(np.median(frame.lod[frame.coverage]) - lod) < 0.1
        # From a pixel in the middle to its neighbours: as many texels to the right as downwards.
        right, down = (frame.uv[24, 26] - frame.uv[24, 22])[0], (frame.uv[26, 24] - frame.uv[22, 24])[1]
        assert abs(right * size[1] / (down * size[0]) - 1) < 0.1


def test_a_texture_of_few_levels_is_far_at_its_last_one() -> None:
    for name, lod in (("sphere-far", 4.0), ("sphere-middle", 3.0)):
        view = views((16, 16))[name]
        assert abs(median_lod(view.mesh, view.camera, view.resolution, (16, 16)) - lod) < 0.1


def test_the_plane_recedes_from_one_texel_a_pixel_to_the_last_level() -> None:
    size = (64, 1024)
    view = views(size, plane_resolution=(128, 160))["plane"]
    levels = [np.zeros((*s, 8), np.float32) for s in level_sizes(*size)]
    frame = candidate(view.mesh, view.camera, LIGHTS, levels, "gltf", WRAP, view.resolution)
    assert frame.coverage.all()
    last = len(levels) - 1
    assert frame.lod[-1].max() < 0.15 and last - 1.2 < frame.lod[0].min() <= last
    assert (np.diff(frame.lod[:, 80]) <= 1e-3).all()
    lower = frame.uv[-1, 81] - frame.uv[-1, 79]  # along u: the plane is seen from above there, foreshortened in v
    assert 0.5 < lower[0] / 2 * size[1] < 1.05


def test_a_mesh_is_fitted_and_keeps_its_texture_coordinates() -> None:
    ball = shapes.sphere(8)
    moved = dataclasses.replace(ball, positions=ball.positions * 7 + [100, 20, 3])
    found = mesh_views(moved, (256, 256), LIGHTS, (64, 64))
    assert [view.scale for view in found] == ["near", "middle", "far"]
    lods = [median_lod(view.mesh, view.camera, view.resolution, (256, 256)) for view in found]
    assert np.allclose(np.diff(lods), np.log2([3, 8 / 3]), atol=0.35)
    for view, lod in zip(found, lods, strict=True):
        assert np.allclose(view.lighting.radiance, EXPOSURE * LIGHTS.radiance) and view.lighting.name == "two"
        assert view.mesh is moved and f"{lod:.1f}" in view.title
        clip = view.camera.to_clip(moved.positions, view.resolution)
        assert (np.abs(clip[:, :3]) <= clip[:, 3:]).all()
    near = np.abs(clip := found[0].camera.to_clip(moved.positions, (64, 64)))[:, :2] / clip[:, 3:]
    assert near.max() > 0.5

    flat = dataclasses.replace(ball, positions=ball.positions * 0)
    with pytest.raises(InputError, match="no extent"):
        mesh_views(flat, (256, 256), LIGHTS, (64, 64))


def test_a_shifted_camera_shows_what_an_offset_does() -> None:
    view, levels = views()["sphere-1-1"], constant()[1][0].levels
    rest = (LIGHTS, [np.random.default_rng(0).random(each.shape, np.float32) for each in levels], "gltf", WRAP)
    moved = candidate(view.mesh, dataclasses.replace(view.camera, shift=SHIFT), *rest, view.resolution)
    expected = candidate(view.mesh, view.camera, *rest, view.resolution, offset=SHIFT)
    assert (moved.image == expected.image).all()
    assert np.abs(moved.image - candidate(view.mesh, view.camera, *rest, view.resolution).image).max() > 0.01


def test_a_constant_material_has_no_error_and_flickers_as_its_reference() -> None:
    stored, candidates = constant()
    flat = render_view(views((32, 32))["plane"], filtered(stored, "gaussian"), candidates, RenderSettings(0, 64))
    found = values(flat, "constant")
    # What is left is the change of lights and view over a pixel, which the filter sees and the candidate does not.
    assert found["snr"] > 60 and found["flip"] < 1e-3 and found["hdr-flip"] < 2e-3 and found["ssim"] > 0.9999
    assert found["tonemapped"] < 1e-3 and found["delta-e-itp"] < 0.1

    view = views((32, 32))["sphere-near"]
    result = render_view(view, filtered(stored, "gaussian"), candidates, RenderSettings(0, 64))
    assert [figure.measure for figure in result.figures] == PICTURED
    found = values(result, "constant")
    assert found["snr"] > 40 and abs(found["flicker"] - 1) < 0.1 and found["flicker-snr"] > 12
    assert all(figure.view == "sphere" and figure.scale == "near" for figure in result.figures)
    assert abs(result.rendered.scene.lod) < 0.1
    rendered = result.rendered
    assert (rendered.flip["constant"][~rendered.interior] == 0).all()
    # The edge itself is wrong: it has no antialiasing in a candidate. Figures are of the interior alone.
    edge = (np.abs(rendered.images["constant"] - rendered.reference).max(-1) > 0.05) & ~rendered.interior
    assert edge.any()

    plot = result.change
    assert plot is not None
    assert (plot.reference[~rendered.interior] == 0).all() and (plot.reference >= 0).all()
    ratio = plot.images["constant"] / np.maximum(plot.reference, 1e-6)
    inside = plot.reference.min(-1) > 0.2
    assert inside.any() and np.median(np.abs(ratio[inside] - 1)) < 0.1
    still = render_view(view, filtered(stored, "gaussian"), candidates, RenderSettings(0, 64), flicker=False)
    assert still.change is None and "flicker" not in values(still, "constant")


def test_pixel_filtered_methods_win_on_bumpy_gloss_and_renders_repeat(tmp_path: Path) -> None:
    stored = bumpy()
    candidates = baked(stored, ("linear", "box"), ("lean", "gaussian"))
    view, source, settings = views()["sphere-1-1"], filtered(stored, "gaussian"), RenderSettings(0, 64, cache=tmp_path)
    shares: list[float] = []
    result = render_view(view, source, candidates, settings, shares.append)
    box, lean = (values(result, name) for name in ("linear (box)", "lean (gaussian)"))
    for name in ("snr", "ssim", "flicker", "flicker-snr"):  # not FLIP, which averages fine shimmer away
        assert MEASURES[name].loss(lean[name]) < MEASURES[name].loss(box[name]), name
    assert box["flicker"] > 1.5
    scene = result.rendered.scene
    assert scene.name == "sphere-1-1" and scene.passes <= 64 and scene.candidate_error > 0
    assert shares == sorted(shares) and shares[-1] == 1
    again = render_view(view, source, candidates, settings)  # the shifted picture has another file in the cache
    assert again.figures == result.figures
    assert (again.rendered.reference == result.rendered.reference).all()


def test_of_methods_that_nobody_named_those_that_look_best_are_measured() -> None:
    stored = bumpy()
    forms = [("linear", "box"), ("linear", "gaussian"), ("lean", "box"), ("lean", "gaussian"), ("vmf", "gaussian")]
    candidates, settings = baked(stored, *forms), RenderSettings(max_passes=32)
    view, source = views()["sphere-near"], filtered(stored, "gaussian")
    whole, some = (
        render_view(view, source, candidates, settings, named=named, flicker=True) for named in (None, ["linear (box)"])
    )
    flip = {f.method: f.value for f in whole.figures if f.measure == "flip"}
    best = sorted(flip.keys() - {"linear (box)"}, key=flip.__getitem__)[: pictures.LOOKED_AT]
    assert set(some.rendered.images) == {"linear (box)", *best} == set(some.change.images if some.change else ())
    assert list(whole.rendered.images) == [each.name for each in candidates]
    for figure in some.figures:
        if figure.measure == "flip":
            assert figure.value == flip[figure.method]


def test_the_stochastic_sampler_draws_a_shifted_picture_anew(monkeypatch: pytest.MonkeyPatch) -> None:
    """Else its noise would be the same in both, and no part of the flicker."""
    monkeypatch.setattr(pictures, "SHIFT", (0.0, 0.0))
    stored = bumpy(32)
    candidates, view = baked(stored, ("linear", "box")), views((32, 32))["sphere-1-1"]
    for sampler, changes in (("trilinear", False), ("stochastic", True)):
        settings = RenderSettings(0, 32, render_sampler(sampler))
        change = render_view(view, filtered(stored, "box"), candidates, settings).change
        assert change is not None and (change.images["linear (box)"] != 0).any() == changes


def test_filters_with_negative_lobes_and_views_without_interior_are_measured() -> None:
    stored = bumpy(32)
    candidates = baked(stored, ("linear", "mitchell"))
    view = views((32, 32))["plane"]
    result = render_view(view, filtered(stored, "mitchell"), candidates, RenderSettings(0, 32))
    found = values(result, "linear (mitchell)")
    assert result.change is None and set(found) == {name for name in PICTURED if MEASURES[name].needs != "frames"}
    assert all(math.isfinite(value) for value in found.values())

    away = dataclasses.replace(view.camera, looks_at=(0.0, 5.0, 0.1))
    view, settings = dataclasses.replace(view, camera=away), RenderSettings(0, 32)
    nothing = render_view(view, filtered(stored, "mitchell"), candidates, settings, flicker=True)
    assert not nothing.rendered.interior.any()
    assert [figure.measure for figure in nothing.figures] == PICTURED
    assert all(math.isnan(figure.value) for figure in nothing.figures)


def test_anisotropic_lookups_keep_more_of_the_plane() -> None:
    stored = bumpy()
    candidates = baked(stored, ("lean", "gaussian"))
    view = views()["plane"]
    plain, sharp = (
        render_view(view, filtered(stored, "gaussian"), candidates, RenderSettings(0, 64, sampler))
        for sampler in (TRILINEAR, ANISOTROPIC)
    )
    assert (plain.rendered.images["lean (gaussian)"] != sharp.rendered.images["lean (gaussian)"]).any()
    assert values(sharp, "lean (gaussian)")["snr"] > values(plain, "lean (gaussian)")["snr"]


def test_the_column_of_a_temporal_slice_is_that_of_a_full_render() -> None:
    frame = 17
    stored = bumpy()
    (one,) = baked(stored, ("lean", "gaussian"))
    turning = Turning(LIGHTS, (64, 64), 20, 32)
    column = turning.candidate(one.levels, "gltf", WRAP)[:, frame]

    angle = turning.angles[frame]
    turn = np.array([[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]])
    plane = shapes.plane(40, 40)
    uv = plane.positions[:, [0, 2]] / turning.texel / 64
    tangents = np.concatenate([plane.tangents[:, :3] @ turn.T, plane.tangents[:, 3:]], -1)
    mesh = Mesh("turned", plane.positions @ turn.T, plane.normals, uv, tangents, plane.triangles)
    full = candidate(mesh, turning.camera, LIGHTS, one.levels, "gltf", WRAP, turning.resolution)
    assert np.abs(full.image[:, turning.column] - column).max() < 1e-4 * column.max()
    sharp = candidate(mesh, turning.camera, LIGHTS, one.levels, "gltf", WRAP, turning.resolution, sampler=ANISOTROPIC)
    ripped = turning.candidate(one.levels, "gltf", WRAP, ANISOTROPIC)[:, frame]
    assert np.abs(sharp.image[:, turning.column] - ripped).max() < 1e-3 * ripped.max()
    lod = full.lod[:, turning.column]
    assert abs(lod[-1]) < 1e-3 and 0.85 < lod[0] <= 1.01

    first, second = turning.reference(filtered(stored, "gaussian"), 128, np.random.default_rng(0))
    noise = np.sqrt(np.mean((first - second)[:, frame] ** 2)) / 2
    expected = reference(mesh, turning.camera, LIGHTS, stored, "gltf", WRAP, turning.resolution,
                                     "gaussian", 5, [full], max_passes=128)  # fmt: skip
    distance = np.sqrt(np.mean(((first + second)[:, frame] / 2 - expected.image[:, turning.column]) ** 2))
    assert distance < 3 * np.hypot(noise, expected.standard_error)
    assert distance < 0.1 * expected.image.mean()


def test_a_temporal_slice_shows_shimmer_and_measures_it() -> None:
    stored = bumpy()
    candidates = baked(stored, ("linear", "box"), ("lean", "gaussian"))
    plot, figures = temporal_slice(filtered(stored, "gaussian"), candidates, LIGHTS, RenderSettings(0), (32, 24), 96)
    assert plot.name == "temporal-slice" and plot.reference.shape == (32, 24, 3)
    found = {(figure.method, figure.measure): figure.value for figure in figures}
    assert len(found) == 4 and all(f.view == "rotation" and f.scale == "1:1" and f.lod == 0.5 for f in figures)
    for measure in ("flicker", "flicker-snr"):
        loss = MEASURES[measure].loss
        assert loss(found["lean (gaussian)", measure]) < loss(found["linear (box)", measure])
    assert found["linear (box)", "flicker"] > 1.2
    again = temporal_slice(filtered(stored, "gaussian"), candidates, LIGHTS, RenderSettings(0), (32, 24), 96)
    assert (again[0].reference == plot.reference).all() and again[1] == figures

    stored, candidates = constant()
    plot, figures = temporal_slice(filtered(stored, "mitchell"), candidates, LIGHTS, RenderSettings(0), (16, 6), 32)
    assert np.abs(plot.images["constant"] - plot.reference).max() < 2e-3 * plot.reference.max()


def test_the_apparent_brdf_of_a_constant_material_is_its_brdf() -> None:
    stored, candidates = constant()
    plot = apparent_brdf(filtered(stored, "mitchell"), candidates, 0, size=24, samples=64)
    assert plot.reference.shape == (24, 24, 3) and (plot.reference[0, 0] == 0).all()
    assert np.abs(plot.images["constant"] - plot.reference).max() < 1e-4 * plot.reference.max()
    row, column = np.argwhere(plot.reference.max(-1) > 0.3 * plot.reference.max())[0]
    x, y = (2 * column + 1) / 24 - 1, 1 - (2 * row + 1) / 24
    for i, j, light in ((row, column, (x, y)), (12, 12, (1 / 24, -1 / 24)), (3, 12, (1 / 24, 17 / 24))):
        direction = np.array([[*light, np.sqrt(1 - light[0] ** 2 - light[1] ** 2)]])
        f = shading.shade("gltf", TEXEL[None].astype(np.float64), direction, np.array([[0.0, 0, 1]]))[0, 0]
        scale = plot.reference[i, j] / f
        assert np.ptp(scale) < 1e-3 * scale.max()
        assert f"times {scale.mean():.2g}." in plot.caption


def test_the_apparent_brdf_is_picked_where_the_subject_errs_most_and_shows_several_lobes() -> None:
    size = 64
    stored = np.broadcast_to(TEXEL, (size, size, 8)).copy()
    stored[..., 3:5], stored[..., 5:] = (1, 0.3), (0, 0, 1)
    # One corner of facets that face to the left and to the right by turns: two lobes, which no texel has.
    tilt = np.where(np.arange(16) // 4 % 2, 0.35, -0.35)
    stored[40:56, 40:56, 5], stored[40:56, 40:56, 7] = tilt, np.sqrt(1 - tilt**2)
    candidates = baked(stored, ("linear", "gaussian"))
    plot = apparent_brdf(filtered(stored, "gaussian"), candidates, 0, lod=3, size=33, samples=512)
    place = re.search(r"column (\d+), row (\d+)", plot.caption)
    assert place is not None
    column, row = (int(number) for number in place.groups())
    assert 38 <= column <= 58 and 38 <= row <= 58
    middle = plot.reference[16].max(-1)
    left, right = middle[:14].max(), middle[19:].max()
    assert min(left, right) > 2 * middle[16]
    given = apparent_brdf(filtered(stored, "gaussian"), candidates, 0, 2, 33, 64, at=(0.1, 0.2))
    assert np.argmax(given.reference[16].max(-1)) == 16 and "column 6, row 12" in given.caption
