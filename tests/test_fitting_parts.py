"""The parameters of a fit, the views that come with mipbake, and references that a renderer adds up itself."""

from __future__ import annotations

import math

import numpy as np
import pytest

from mipbake.comparing.meshes.visible import Surface
from mipbake.fitting import SCALES, View, standard_views
from mipbake.fitting.kernels import TorchRenderer
from mipbake.fitting.parameters import Parameters
from mipbake.material import MODELS
from mipbake.material.pixel_filter import level_sizes

from .viewer_scenes import material, stack_of

REPEATS = ("wrap", "wrap")

# ---- parameters


@pytest.mark.parametrize("model", MODELS)
def test_values_are_what_files_hold_and_lead_back(model: str) -> None:
    levels = list(stack_of(material(model, 12, 20), model).levels)
    parameters = Parameters.of(model, 12, 20, len(levels))
    assert parameters.sizes == tuple(level_sizes(12, 20)) and parameters.starts[-1] == sum(
        h * w for h, w in parameters.sizes
    )
    values, channels = parameters.values(levels), parameters.channels
    assert values.shape == (parameters.starts[-1], MODELS[model].channels) and values.dtype == np.float32
    assert (values >= np.float32(channels.low) - 1e-6).all() and (values <= np.float32(channels.high) + 1e-6).all()
    again = parameters.values(parameters.stored(values))  # vectors have unit length from now on
    unit = parameters.stored(again)
    for first, second in zip(parameters.stored(values), unit, strict=True):
        assert np.abs(first - second).max() < 2e-6
    colours = MODELS[model].maps[MODELS[model].stored[0].name]
    assert np.allclose(unit[0][..., colours], levels[0][..., colours], atol=2e-6)
    seen = parameters.levels(values, REPEATS)
    assert seen.sizes == list(parameters.sizes) and all(np.shares_memory(m[0], values) for m in seen.maps.values())


def test_a_perturbation_is_the_step_of_a_file_of_8_bits() -> None:
    """Section 4.3: of the format's quantisation; a normal's z follows from x and y."""
    channels = Parameters.of("gltf", 4, 4, 1).channels
    assert channels.magnitude == (*(1 / 255 for _ in range(7)), 0.0)
    assert channels.lifted == 5 and set(channels.low) == {0.0} and set(channels.high) == {1.0}
    assert all(0 < number < math.inf for number in Parameters.of("ggx", 4, 4, 1).channels.magnitude)


# ---- views


def middle_lod(view: View, size: tuple[int, int]) -> float:
    points = Surface(view.mesh, view.camera, view.size).seen(view.offset)
    scaled = points.uv_da.reshape(-1, 2, 2) * np.array([[size[1]], [size[0]]])
    longer = np.linalg.svd(scaled, compute_uv=False)[:, 0]
    height, width = view.size
    return float(np.log2(longer[np.argmin(np.abs(points.index - (height // 2 * width + width // 2)))]))


@pytest.mark.parametrize("size", [(64, 64), (32, 128)])
def test_views_have_the_level_of_detail_that_they_are_named_after(size: tuple[int, int]) -> None:
    lods = (0.0, 1.0, 2.5, 4.0)
    views = standard_views(size, each=3, lods=lods)
    assert len({view.name for view in views}) == len(views) == 12
    for view, lod in zip(views, np.repeat(lods, 3), strict=True):
        assert view.name.endswith(f"at level of detail {lod:g}") and view.scale in SCALES
        assert middle_lod(view, size) == pytest.approx(lod, abs=0.15)


@pytest.mark.parametrize("wrap", [REPEATS, ("clamp", "clamp"), ("wrap", "clamp")])
def test_views_show_the_maps(wrap: tuple[str, str]) -> None:
    stack, renderer = stack_of(material("gltf", 32, 32), "gltf"), TorchRenderer()
    parameters = Parameters.of("gltf", 32, 32, len(stack.levels))
    levels = parameters.levels(parameters.values(list(stack.levels)), wrap)
    for view in standard_views((32, 32), wrap, each=2, lods=(0, 1, 2)):
        frame = renderer.render(levels, view)
        seen = np.asarray(frame.id) > 0
        assert seen.mean() > (0.999 if wrap == REPEATS else 0.1), view.name
        for values in (frame.image, frame.uv[seen], frame.lod[seen]):
            assert np.isfinite(values).all()
        assert np.asarray(frame.image)[seen].mean() > 1e-3
        if wrap != REPEATS:
            assert frame.uv[seen].min() >= 0 and frame.uv[seen].max() <= 1


def test_views_depend_on_their_seed_alone() -> None:
    first, again, other = (standard_views((16, 16), each=1, seed=seed) for seed in (1, 1, 2))
    assert len(first) == 2 * 4 + 1  # from 0 to the last level in steps of one half
    for a, b, c in zip(first, again, other, strict=True):
        assert np.array_equal(a.matrix(), b.matrix()) and not np.array_equal(a.matrix(), c.matrix())
        assert np.array_equal(a.lighting.radiance, b.lighting.radiance)
    assert not np.array_equal(first[0].matrix(), first[0].moved(0.5, 0).matrix())
