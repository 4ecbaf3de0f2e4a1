"""Small pictures: where they lie, how samplers look them up, and what is right in them."""

from __future__ import annotations

import numpy as np
import pytest

from mipbake import sampling
from mipbake.material.aim import ANISOTROPIC, TRILINEAR, Sampler
from mipbake.material.filtered_source import FilteredSource
from mipbake.material.pixel_filter import FILTERS
from mipbake.quality.environment import Lighting, studio
from mipbake.quality.judging.shown import KINDS_SHOWN, draw_shown
from mipbake.quality.metrics.visible import SIDE, VisibleError, bands
from mipbake.quality.reference.problem import Problem, whole
from mipbake.quality.samplers import look_up
from mipbake.quality.small_pictures import (
    PIXELS,
    SLANTS,
    SmallPictures,
    draw_slants,
    draw_small_pictures,
    exposures,
    reach,
)
from mipbake.shading import shade

from .stacks import gltf_level

WRAP = ("wrap", "wrap")
HEIGHT, WIDTH = 24, 32
KINDS = [TRILINEAR, ANISOTROPIC, Sampler(4, -0.3), Sampler(bias=-1.0, frames=8), Sampler(16, 0.5, 8)]


def drawn(sampler: Sampler, slant: list[float], lod: float = 1.0, lights: int = 4, seed: int = 0) -> SmallPictures:
    count = len(slant)
    rng = np.random.default_rng(seed)
    args = np.full(count, lod), np.array(slant), (WIDTH, HEIGHT), sampler, [studio(lights)], rng.random((count, 2))
    return draw_small_pictures(rng, *args)


def test_slants_are_spread_over_each_kind() -> None:
    each = 50
    found = draw_slants(np.random.default_rng(0), each * len(SLANTS)).reshape(len(SLANTS), each)
    for row, (low, high) in zip(found, SLANTS, strict=True):
        assert (row >= low).all() and (row <= high).all()
        places = np.sort((row - low) / (high - low) * each).astype(int)
        np.testing.assert_array_equal(places, np.arange(each))  # one in every part
        assert (np.diff(row) < 0).any()  # in no order


def test_frames_are_right_handed_and_slants_are_cosines_of_views() -> None:
    """Told from what lights from known directions become: a frame turns them, and changes neither lengths nor hands."""
    world = np.concatenate([np.eye(3), [[0.6, 0.0, 0.8]]])
    rooms = [Lighting("axes", world, np.ones((4, 3)))]
    slant = draw_slants(np.random.default_rng(1), 200)
    rng = np.random.default_rng(2)
    made = draw_small_pictures(rng, np.ones(200), slant, (32, 32), TRILINEAR, rooms, rng.random((200, 2)))
    frame = made.light[:, :3].transpose(0, 2, 1).astype(float)  # rows tangent, bitangent, normal
    np.testing.assert_allclose(frame @ frame.transpose(0, 2, 1), np.broadcast_to(np.eye(3), frame.shape), atol=1e-5)
    np.testing.assert_allclose(np.linalg.det(frame), 1, atol=1e-5)
    np.testing.assert_allclose(made.view[:, 0, 2], slant, atol=1e-5)
    np.testing.assert_allclose(np.linalg.norm(made.view, axis=-1), 1, atol=1e-5)
    np.testing.assert_allclose(made.light[:, 3], 0.6 * made.light[:, 0] + 0.8 * made.light[:, 2], atol=1e-5)
    assert (made.view == made.view[:, :1]).all()  # one view for all lights
    # Turned every way about the vertical, with normals that do not look down, but for walls that cameras look up to.
    assert (np.abs(frame.mean(0)) < 0.25)[:, [0, 2]].all()
    up = frame[:, 2, 1]
    assert up.min() >= -0.2 and up.mean() > 0.4 and (up < 0.1).any()


def test_rooms_take_turns_and_lights_that_a_room_lacks_have_no_power() -> None:
    rooms = [
        Lighting("one", np.array([[0.0, 1.0, 0.0]]), np.full((1, 3), 2.0)),
        Lighting("two", np.array([[0.0, 0.6, 0.8], [0.0, 1.0, 0.0]]), np.ones((2, 3))),
    ]
    rng = np.random.default_rng(0)
    made = draw_small_pictures(rng, np.ones(4), np.full(4, 0.8), (32, 32), TRILINEAR, rooms, rng.random((4, 2)))
    one, two = [[2, 2, 2], [0, 0, 0]], [[1, 1, 1], [1, 1, 1]]
    np.testing.assert_array_equal(made.power, [one, two, one, two])
    np.testing.assert_allclose(made.light[1, 0] @ made.light[1, 1], 0.6, atol=1e-5)


@pytest.mark.parametrize(("slant", "lookups"), [(1.0, 1), (0.51, 2), (0.5, 2), (0.49, 3), (0.26, 4), (0.1, 10)])
def test_anisotropic_lookups_lie_evenly_along_the_longer_side(slant: float, lookups: int) -> None:
    """n = ceil(a / b) at log2(a / n), as conventions.md has it, and trilinear ones at log2(a)."""
    lod = 1.3
    made, plain = (drawn(sampler, [slant], lod) for sampler in (ANISOTROPIC, TRILINEAR))
    assert made.lookups.tolist() == [lookups] and plain.lookups.tolist() == [1]
    size = np.array([WIDTH, HEIGHT])
    for each in (made, plain):
        a, b = np.linalg.norm(each.axes[0], axis=-1) * 2 ** each.longer[0]
        assert b / a == pytest.approx(slant, rel=1e-5)
        assert np.log2(a / each.lookups[0]) == pytest.approx(lod, abs=1e-6) and each.lod[0] == lod
        where = each.looked_up_at(slice(0, 1), int(each.lookups[0]))[0] * size  # (PIXELS, n, 2) texels
        np.testing.assert_allclose(where.mean(1), each.uv[0] * size, atol=1e-5)
        along = np.diff(where, axis=1)
        np.testing.assert_allclose(np.linalg.norm(along, axis=-1), a / each.lookups[0], rtol=1e-4)
        np.testing.assert_allclose(along @ each.axes[0, 1], 0, atol=1e-4)  # nothing across


@pytest.mark.parametrize("slant", [1.0, 0.45, 0.13])
def test_pixels_lie_side_by_side_as_the_screen_has_them(slant: float) -> None:
    made = drawn(TRILINEAR, [slant], 0.7)
    texels = made.uv[0].reshape(SIDE, SIDE, 2) * [WIDTH, HEIGHT]
    rows, columns = texels[1:] - texels[:-1], texels[:, 1:] - texels[:, :-1]
    along, across = made.axes[0] * 2**0.7
    np.testing.assert_allclose(rows, np.broadcast_to(along, rows.shape), atol=1e-5)
    np.testing.assert_allclose(columns, np.broadcast_to(across, columns.shape), atol=1e-5)
    # Rows go along the view: up in tangent space is down in v.
    view = made.view[0, 0, :2] * [1, -1]
    if slant < 1:
        np.testing.assert_allclose(along / np.linalg.norm(along), view / np.linalg.norm(view), atol=1e-4)


@pytest.mark.parametrize("slant", [0.9, 0.3])
def test_lookups_are_those_of_the_sampler(slant: float) -> None:
    """The mean of a pixel's lookups is what `samplers.look_up` finds for its footprint."""
    made = drawn(ANISOTROPIC, [slant], 0.0)
    level = gltf_level((HEIGHT, WIDTH), 0)
    axes = made.axes[0].astype(float) * 2 ** made.longer[0] / [WIDTH, HEIGHT]
    footprint = np.broadcast_to([axes[0, 0], axes[1, 0], axes[0, 1], axes[1, 1]], (PIXELS, 4))
    expected = look_up([level, level[::2, ::2]], made.uv[0], footprint, WRAP, ANISOTROPIC)
    where = made.looked_up_at(slice(0, 1), int(made.lookups[0]))[0].astype(np.float32)
    found = sampling.texture(level[None], where[None], filter_mode="linear", boundary_mode=WRAP)[0].mean(1)
    assert np.abs(found - expected).mean() < 0.02


@pytest.mark.parametrize("sampler", KINDS)
def test_no_lookup_is_beyond_the_reach(sampler: Sampler) -> None:
    slant = np.linspace(0.1, 1, 19).tolist()
    made = drawn(sampler, slant, 2.0)
    farthest = 0.0
    for index, count in enumerate(made.lookups.tolist()):
        off = made.looked_up_at(slice(index, index + 1), count)[0] - made.uv[index].mean(0)
        farthest = max(farthest, float(np.linalg.norm(off * [WIDTH, HEIGHT] / 4, axis=-1).max()))
    assert 0.8 * reach(sampler) < farthest <= reach(sampler)


@pytest.mark.parametrize("sampler", KINDS)
def test_what_is_right_is_the_filtered_sum_over_all_lights(sampler: Sampler) -> None:
    """Against the midpoint rule in a loop over lights and places of pixels."""
    level = gltf_level((HEIGHT, WIDTH), 0)
    level[..., 4] = 0.5 + 0.5 * level[..., 4]
    made = drawn(sampler, [0.8, 0.3], 0.5)
    source = FilteredSource(level, "gltf", WRAP, "gaussian")
    found = made.reference(source, 1024, np.random.default_rng(0))
    assert found.shape == (2, PIXELS, 3)
    kernel = FILTERS["gaussian"]
    grid = ((np.arange(24) + 0.5) / 24 * 2 - 1) * kernel.radius
    x, y = np.meshgrid(grid, grid)
    weight = (kernel.shape(x) * kernel.shape(y)).ravel()
    weight /= weight.sum()
    for picture, pixel in ((0, 0), (0, 133), (1, 77), (1, 255)):
        places = np.stack([x.ravel(), y.ravel()], -1) @ made.axes[picture] * 2 ** made.longer[picture]
        where = (made.uv[picture, pixel] + places / [WIDTH, HEIGHT]).astype(np.float32)
        texels = sampling.texture(level[None], where[None, None], filter_mode="linear", boundary_mode=WRAP)[0, 0]
        expected = np.zeros(3)
        for light, view, power in zip(made.light[picture], made.view[picture], made.power[picture], strict=True):
            expected += weight @ shade("gltf", texels, light[None], view[None])[0] * power
        np.testing.assert_allclose(found[picture, pixel], expected, rtol=0.02, atol=2e-3)


def test_the_adjoint_is_the_derivative_by_texels() -> None:
    rng = np.random.default_rng(3)
    made = drawn(TRILINEAR, [0.9, 0.4])
    texels = gltf_level((2, PIXELS), 1)
    texels[..., 4] = 0.4 + 0.4 * texels[..., 4]
    gradient = rng.normal(size=(2, PIXELS, 3)).astype(np.float32)
    along = (0.1 * rng.normal(size=texels.shape)).astype(np.float32)
    step = 5e-3
    ahead, back = (
        float((made.radiance("gltf", texels + turn * step * along) * gradient).sum(dtype=float)) for turn in (1, -1)
    )
    found = float((made.adjoint("gltf", texels, gradient) * along).sum(dtype=float))
    assert found == pytest.approx((ahead - back) / (2 * step), rel=1e-2)


def test_parts_are_the_same_pictures() -> None:
    made = drawn(ANISOTROPIC, [0.9, 0.4, 0.2])
    texels = gltf_level((3, PIXELS), 2)
    some = np.array([2, 0])
    np.testing.assert_array_equal(made.part(some).radiance("gltf", texels[some]), made.radiance("gltf", texels)[some])


def test_exposures_lie_between_the_median_of_a_picture_and_of_all() -> None:
    radiance = np.repeat(np.array([0.1, 0.4, 1.6], np.float32), PIXELS * 3).reshape(3, PIXELS, 3)
    np.testing.assert_allclose(
        exposures(radiance)[:, 0, 0], 0.6 / np.sqrt([0.1 * 0.4, 0.4 * 0.4, 1.6 * 0.4]), rtol=1e-5
    )
    radiance[0] = 0  # what is black is exposed for a sixteenth of the median
    assert exposures(radiance)[0, 0, 0] == pytest.approx(4 * exposures(radiance)[1, 0, 0])
    assert np.isfinite(exposures(np.zeros((2, PIXELS, 3), np.float32))).all()


@pytest.mark.parametrize("sampler", KINDS)
def test_a_stack_that_is_right_is_only_off_by_noise(sampler: Sampler) -> None:
    """On a material whose reference is its level 0 everywhere, and with a wrong colour it is not."""
    level = np.broadcast_to(np.array([0.5, 0.3, 0.2, 0, 0.5, 0, 0, 1], np.float32), (16, 16, 8)).copy()
    task = Problem(level, "gltf", "gltf", "gaussian", WRAP, sampler)
    shown = draw_shown(task, whole(task), 1.0, 12, 4, np.random.default_rng(0))
    count = len(shown.pictures.lod)
    assert count % KINDS_SHOWN == 0 and 1 <= shown.pictures.lookups.max() <= sampler.lookups
    texels = np.broadcast_to(level[0, 0], (count, shown.pictures.points, 8))
    right = shown.error(shown.pictures.radiance("gltf", texels))
    other = texels.copy()
    other[..., 2] = 0.6
    wrong = shown.error(shown.pictures.radiance("gltf", other))
    assert (right.logarithms < wrong.logarithms - 1).all()
    assert right.roots == pytest.approx(visible_error_of_nothing(), rel=1e-4)


def test_level_0_is_seen_by_pixels_that_are_smaller_than_its_texels() -> None:
    task = Problem(gltf_level((16, 16), 0), "gltf", "gltf", "gaussian", WRAP, ANISOTROPIC)
    for lod, least in ((0.0, -0.7), (0.5, 0.5), (1.0, 1.0)):
        found = draw_shown(task, whole(task), lod, 32, 1, np.random.default_rng(0)).pictures.lod
        assert least <= found.min() and found.max() <= lod
        assert found.std() > 0.1 or lod > 0


def visible_error_of_nothing() -> float:
    """What nobody sees, which is added to every error."""
    return float(VisibleError(np.zeros((1, 3, SIDE, SIDE), np.float32), np.zeros(1), 1).means[0])


def test_the_slope_of_contrasts_is_their_derivative() -> None:
    task = Problem(gltf_level((16, 16), 0), "gltf", "gltf", "gaussian", WRAP)
    shown = draw_shown(task, whole(task), 1.0, 8, 4, np.random.default_rng(0))
    radiance = np.random.default_rng(1).uniform(0.05, 2, (len(shown.exposure), PIXELS, 3)).astype(np.float32)
    step = np.float32(1e-3) * radiance
    ahead, back = (shown.error(radiance + turn * step).off for turn in (1, -1))
    expected = bands((shown.slope(radiance) * 2 * step).reshape(-1, SIDE, SIDE, 3))
    np.testing.assert_allclose(ahead - back, expected, atol=2e-3 * float(np.abs(expected).max()))
