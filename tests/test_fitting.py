"""Fits through any renderer: what they gain, what they leave alone, and that their gradients are the kernels' own."""

from __future__ import annotations

import dataclasses
import itertools
import re
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mipbake import stochastic
from mipbake.base.errors import UsageError
from mipbake.fitting import Frame, Levels, Progress, fit, standard_views
from mipbake.fitting.frames import looked
from mipbake.fitting.kernels import TorchRenderer
from mipbake.fitting.parameters import Parameters
from mipbake.fitting.prepared import Prepared
from mipbake.fitting.protocol import JsonView
from mipbake.fitting.references import Supersampled
from mipbake.material import MODELS
from mipbake.stack.stack import MipStack

from .fitting_small import (
    KERNEL,
    REPEATS,
    SIDE,
    Plain,
    Spot,
    error,
    fitted,
    levels_of,
    same,
    source_levels,
    spots,
    start,
    supersampled,
    texture_set,
)
from .viewer_scenes import material, stack_of

# ---- where a fit starts


def spoilt(*levels: int) -> MipStack:
    """The start, with these levels in grey."""
    stack = start()
    return replace(stack, levels=[np.full_like(a, 0.5) if n in levels else a for n, a in enumerate(stack.levels)])


def test_each_level_starts_from_the_stack_that_shows_it_best() -> None:
    result = fitted(stack=spoilt(1, 2), others=[spoilt(0, 3)], steps=1, rate=1e-6)
    assert same(result, start())
    assert "level 1, 2 from linear" in result.provenance.adjustments[-1]


def test_a_stack_that_is_no_better_changes_nothing() -> None:
    assert same(fitted(others=[spoilt(0, 1, 2, 3), start()], steps=12), fitted(steps=12))


def test_others_of_another_size_or_model() -> None:
    with pytest.raises(UsageError, match="others hold 3 levels of gltf from 4 x 4: expected stacks of one"):
        fitted(others=[start(4)])
    with pytest.raises(UsageError, match="of ggx from 8 x 8"):
        fitted(others=[stack_of(material("ggx", SIDE, SIDE), "ggx")])


# ---- what a fit gains


@pytest.mark.long
def test_views_that_nothing_has_seen_gain_at_every_scale() -> None:
    texture, stack, renderer = texture_set(16), start(16), TorchRenderer()
    views = standard_views((16, 16), each=3, lods=(0, 1, 2, 3, 4))
    result = fit(stack, renderer, views, source=texture, steps=240, passes=32)
    gains: dict[str, list[float]] = {}
    for view in standard_views((16, 16), each=2, seed=5, lods=(0, 2, 4)):
        wanted = supersampled(renderer, source_levels(texture), view, 256, 9)
        before, after = (error(each, renderer, view, wanted) for each in (stack, result))
        gains.setdefault(view.scale, []).append(before / after)
    assert set(gains) == {"near", "middle"} and all(np.mean(each) > 1.05 for each in gains.values()), gains


@pytest.mark.long
@pytest.mark.parametrize("model", ["gltf-anisotropic", "ggx", "beckmann"])
def test_other_material_models(model: str) -> None:
    level = material(model, 16, 16)
    stack, renderer = stack_of(level, model), TorchRenderer()
    wanted = stack_of(np.roll(level, 3, axis=1), model)  # another stack of the same model
    views = standard_views((16, 16), each=5, lods=(0, 1, 3))
    told: list[Progress] = []
    result = fit(
        stack, renderer, views, reference=lambda v: renderer.render(levels_of(wanted), v).image, steps=60,
        progress=told.append,
    )  # fmt: skip
    assert result.model == model and not same(result, stack)
    gains = np.subtract(told[-1].gains[:4], told[0].gains[:4])
    assert (gains >= 0).all() and (gains > 0).any()
    described = MODELS[model]
    for each in described.stored:
        own = result.levels[1][..., described.maps[each.name]]
        if each.facts.unit_axis is not None:
            assert np.allclose(np.linalg.norm(own, axis=-1), 1, atol=1e-5)


def test_what_is_kept_gains_in_both_parts() -> None:
    """In the mean over views that are apart; a fit that looks at displays alone may lose in linear light."""
    told = fitted(steps=160).provenance.adjustments[-1]
    found = re.findall(r"level \d( \(linear\))? (-?[\d.]+) to (-?[\d.]+) dB", told)
    assert len(found) == 4
    for part in ("", " (linear)"):
        gains = [float(after) - float(before) for name, before, after in found if name == part]
        assert sum(gains) / len(gains) > 0.05


# ---- what a fit leaves alone


def test_levels_that_no_view_shows_stay_bit_for_bit() -> None:
    stack, result = start(), fitted(views=spots(6, (1,)))
    changed = [a.tobytes() != b.tobytes() for a, b in zip(stack.levels, result.levels, strict=True)]
    assert changed == [False, True, False, False]


def test_a_stack_that_is_right_already_stays_bit_for_bit() -> None:
    stack, renderer = start(), Plain()
    shown = levels_of(stack)
    result = fitted(renderer, reference=lambda view: renderer.render(shown, view).image)
    assert same(result, stack)


def test_pixels_that_show_no_map_do_not_count() -> None:
    def half(frame: Frame, _count: int) -> Frame:
        image, number = np.array(frame.image), np.ones(frame.image.shape[:2], np.int32)
        uv, number[:, :4] = np.array(frame.uv), 0
        image[:, :4], uv[:, :4] = _count, np.nan  # what lies there is anything, and changes
        return dataclasses.replace(frame, image=image, uv=uv, id=number)

    black_left = [np.where(np.arange(SIDE)[:, None] < 4, 0, 0.2) * np.ones((SIDE, SIDE, 3)) for _ in spots()]
    results = [fitted(Plain(half), reference=[image + left for image in black_left]) for left in (0.0, 0.0)]
    assert same(*results) and not same(results[0], start())


# ---- references, and views to check with


def test_references_by_function_and_by_images_are_the_same() -> None:
    renderer, views = Plain(), spots()
    source = source_levels(texture_set())

    def reference(view: Spot) -> np.ndarray:
        return supersampled(renderer, source, view, 16)

    by_function = fitted(renderer, reference=reference)
    assert same(fitted(renderer, reference=[reference(view) for view in views]), by_function)


@pytest.mark.parametrize("passes", [8, 16])
def test_noise_of_a_reference_is_no_error(passes: int) -> None:
    """In the mean over references of few renders a view has the error that it has beside one of many; what the noise
    adds is several times as much."""
    renderer, source, stack = Plain(), source_levels(texture_set()), start()
    view = spots()[12]
    parameters = Parameters.of("gltf", SIDE, SIDE, 4)
    seen = looked(renderer.render(levels_of(stack), view), view.name)

    def prepared(seed: int, count: int) -> Prepared:
        found = Supersampled(renderer, source, view, KERNEL, seed)
        found.refine(count)
        return Prepared.of(view, seen, found.halves(), parameters, REPEATS)

    right = prepared(0, 4096).started
    few = [prepared(seed, passes) for seed in range(60)]
    mean, noise = (np.mean([getattr(each, name) for each in few], 0) for name in ("started", "noise"))
    assert (noise > 0.05 * right).all()
    assert np.abs(mean - right) == pytest.approx(0, abs=0.3 * float(noise.max()))


def test_views_that_are_held_out() -> None:
    renderer, views, extra = Plain(), spots(2, (0, 1)), spots(1, (0, 1))
    images = [np.full((SIDE, SIDE, 3), 0.2)] * 6
    given = [replace(view, name=f"held out {index}") for index, view in enumerate(extra)]
    told: list[Progress] = []
    fitted(renderer, views, held_out=given, reference=images, steps=8, progress=told.append)
    counts = {name: renderer.log.count(name) for name in renderer.log}
    rounds = len(told)
    assert rounds == 3
    # One to prepare, one a check; then one with all levels that are kept, and one without each of them that it shows.
    assert all(2 + rounds <= counts[view.name] <= 2 + rounds + 2 for view in given)
    # One to prepare, six to probe, and two a step. One view is apart: it is prepared, and judges the result.
    assert sorted(counts[view.name] for view in views)[0] == 2
    assert sum(counts[view.name] for view in views) == 2 + 3 * (1 + 6) + 2 * 8


def test_frames_with_derivatives_in_place_of_a_level() -> None:
    def derivatives(frame: Frame, _count: int) -> Frame:
        step = 2.0 ** np.asarray(frame.lod) / SIDE
        uv_da = np.stack([step, 0 * step, 0 * step, step], -1)
        return dataclasses.replace(frame, lod=None, uv_da=uv_da)

    assert not same(fitted(Plain(derivatives), spots(5, (1,)), passes=None), start())


# ---- progress


def test_progress_is_told_after_every_check() -> None:
    told: list[Progress] = []
    shares: list[float] = []
    fitted(steps=42, progress=told.append, working=lambda share, left: shares.append(share))
    assert [now.step for now in told] == [14, 28, 42]
    assert all(before.share < after.share for before, after in itertools.pairwise(told))
    names = {f"level {n}{part}" for n in range(4) for part in ("", " (linear)")}
    assert all(set(now.scores) == names and len(now.gains) == 4 for now in told)
    assert shares == sorted(shares) and shares[0] == 0 and 0.8 < shares[-1] <= 1
    assert same(told[-1].stack(), told[-1].stack()) and not same(told[-1].stack(), start())
    for before, after in itertools.pairwise(told):
        assert all(a >= b for a, b in zip(after.gains, before.gains, strict=True))
        assert after.seconds >= before.seconds


# ---- settings that make no sense


@pytest.mark.parametrize(
    ("settings", "told"),
    [
        ({"views": []}, "0 views are given: expected 3 or more"),
        ({"held_out": []}, "held_out is empty: expected views"),
        ({"apart": []}, "apart is empty: expected views"),
        ({"steps": -1}, "steps is -1: expected 0 or more"),
        ({"rounds": -1}, "rounds is -1: expected 0 or more"),
        ({"renders": 0}, "renders is 0: expected 1 to 4096"),
        ({"passes": 0}, "passes is 0: expected 1 or more"),
        ({"budget": 0.0}, "budget is 0.0: expected seconds"),
        ({"budget": "5s"}, "budget is '5s': expected seconds as a number"),
        ({"rate": 0.0}, "rate is 0.0: expected more than 0"),
        ({"seed": -1}, "is -1: expected 0 to"),
        ({"reference": [np.ones((SIDE, SIDE, 3))]}, "reference has 1 images: expected 20, one for each view"),
        ({"reference": None}, "neither source nor reference is given: expected"),
        ({"reference": [np.ones((4, 4, 3))] * 20}, r"reference of spot 0 of level 0 has shape \(4, 4, 3\): expected"),
        ({"reference": [np.full((SIDE, SIDE, 3), np.nan)] * 20}, "of spot 0 of level 0 .* finite"),
    ],
)  # fmt: skip
def test_settings_that_make_no_sense(settings: dict[str, Any], told: str) -> None:
    renderer = Plain()
    with pytest.raises(UsageError, match=told):
        fitted(renderer, **settings)


def test_a_renderer_that_does_not_render() -> None:
    with pytest.raises(UsageError, match=r"the renderer is a int: expected an object with render\(levels, view\)"):
        fitted(3)  # type: ignore[arg-type]


def test_a_renderer_cannot_change_the_maps() -> None:
    class Writing(Plain):
        def render(self, levels: Levels, view: Any) -> Frame:
            levels.maps["base_color"][0][...] = 0
            return super().render(levels, view)

    with pytest.raises(ValueError, match="read-only"):
        fitted(Writing())


def test_a_view_that_cannot_be_moved() -> None:
    @dataclass(frozen=True, eq=False)
    class Fixed:
        level: int = 0
        side: int = SIDE
        offset: tuple[float, float] = (0.0, 0.0)
        name: str = "fixed"

    with pytest.raises(
        UsageError, match=r"views of the type Fixed have no method moved\(right, up\).*: expected it, or"
    ):
        fitted(views=[Fixed()] * 3)
    assert fitted(views=[Fixed()] * 3, reference=[np.full((SIDE, SIDE, 3), 0.2)] * 3).model == "gltf"


# ---- gradients


def test_the_mean_of_many_estimates_is_the_exact_gradient() -> None:
    """Equation 8 beside much smaller steps of single channels."""
    stack, renderer = start(), TorchRenderer()
    parameters = Parameters.of("gltf", SIDE, SIDE, len(stack.levels))
    values, channels = parameters.values(list(stack.levels)), parameters.channels
    values = np.clip(values, 0.1, 0.9)  # so that no perturbation meets a limit
    [view] = standard_views((SIDE, SIDE), each=1, seed=2, lods=(0.5,))
    view = replace(view, size=(14, 14))
    moved = np.clip(values + np.random.default_rng(0).uniform(-0.1, 0.1, values.shape).astype(np.float32), 0.05, 0.95)

    def shown(texels: np.ndarray) -> Frame:
        return renderer.render(parameters.levels(texels, REPEATS), view)

    frame, wanted = shown(values), np.asarray(shown(moved).image, np.float32)
    count, seen = wanted.shape[0] * wanted.shape[1], np.asarray(frame.id).reshape(-1).astype(np.uint8)
    uv, lod = np.asarray(frame.uv, np.float32).reshape(count, 2), np.asarray(frame.lod, np.float32).reshape(count)
    made_of = stochastic.contributions(stochastic.touched_texels(parameters.sizes, uv, lod, None, seen))
    still, exact = replace(channels, magnitude=(0.0,) * values.shape[1]), np.zeros(values.shape)
    for texel, channel in itertools.product(range(len(values)), np.flatnonzero(channels.magnitude)):
        for by in (1e-3, -1e-3):
            other = values.copy()
            other[texel, channel] += by
            image = shown(stochastic.perturb(other, still, 0)[0]).image  # normals of unit length
            error = np.square(np.asarray(image - wanted, np.float64)).reshape(count, 3)[seen > 0].sum()
            exact[texel, channel] += error / (2 * by)
    estimates = []
    for step in range(250):
        sides = stochastic.perturb(values, channels, step)
        images = [np.asarray(shown(side).image, np.float32).reshape(count, 3) for side in sides]
        differences = stochastic.pixel_differences(*images, wanted.reshape(count, 3), seen.astype(np.float32))
        gradient = np.zeros_like(values)
        stochastic.add_gradient(gradient, differences, made_of, channels, step)
        estimates.append(gradient)
    moves = np.asarray(channels.magnitude) > 0
    mean, spread = np.mean(estimates, 0)[:, moves], np.std(estimates, 0)[:, moves] / np.sqrt(len(estimates))
    exact = exact[:, moves]
    assert np.count_nonzero(spread) > 200
    assert np.array_equal(spread > 0, np.broadcast_to((spread > 0).any(1, keepdims=True), spread.shape))
    assert np.all(np.abs(mean - exact) <= 5 * spread + 0.02 * np.abs(exact).max())  # shading is no parabola
    agreement = float((mean * exact).sum() / np.sqrt(np.square(mean).sum() * np.square(exact).sum()))
    assert agreement > 0.95


# ---- the page


def test_the_renderer_of_the_page_can_be_fitted() -> None:
    page = (Path(__file__).resolve().parent.parent / "docs" / "fit.md").read_text(encoding="utf-8")
    [code] = [block for block in re.findall(r"```python\n(.*?)```", page, re.DOTALL) if "class Lamp" in block]
    names: dict[str, Any] = {}
    exec(code, names)
    views = [JsonView({"lod": lod, "top": 3 * index, "left": 5 * index}) for lod in (0, 1) for index in range(5)]
    told: list[Progress] = []
    result = fit(start(16), names["Lamp"](), views, source=texture_set(16), steps=64, progress=told.append)
    assert not same(result, start(16)) and told[-1].scores["other"] > told[0].scores["other"]
