"""Films: what is filmed, once per pixel and supersampled, and what is measured of it, by hand and without bias."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from mipbake.comparing import cautions, filming
from mipbake.comparing.filming import RESOLVED_SHARE, UNSEEN, FilmReference, film, film_figures, film_measures
from mipbake.comparing.films import FRAMES_PER_SECOND, Film, films_of
from mipbake.comparing.meshes import shapes
from mipbake.comparing.meshes.mesh_render import candidate, film_candidate
from mipbake.comparing.meshes.supersampling import Supersampling
from mipbake.comparing.pictures import LOOKED_AT, RenderSettings
from mipbake.material.aim import Sampler
from mipbake.quality.environment import directional
from mipbake.quality.metrics import MEASURES, color_video_vdp, displayed, film_exposure, ldr_flip
from mipbake.quality.samplers import jitter

from .test_compare_renders import LIGHTS, WRAP, baked, bumpy, constant, filtered
from .test_metrics_films import needs_cvvdp

SIZE = (32, 32)
STORED = bumpy(32)
CANDIDATES = baked(STORED, ("linear", "box"), ("lean", "gaussian"))


def films(motion: Any = "camera", frames: int = 3, height: int = 32, size: Any = SIZE) -> dict[str, Film]:
    last = int(math.log2(max(size)))
    return {
        each.name.removeprefix("film-"): each for each in films_of(size, LIGHTS, last, None, motion, height, frames)
    }


def settings(passes: int = 64, cache: Path | None = None, **changes: Any) -> RenderSettings:
    return RenderSettings(**{"seed": 0, "max_passes": passes, "cache": cache} | changes)


def frame_of(scene: Film, index: int = 0) -> Any:
    return candidate(scene.shots[index], CANDIDATES[0].levels, "gltf", WRAP)


@pytest.fixture
def unjudged(monkeypatch: pytest.MonkeyPatch) -> None:
    """What is tested here does not hang on ColorVideoVDP, which takes its time."""
    monkeypatch.setattr(filming, "missing_judge", lambda: "ColorVideoVDP is not installed")


# ---- what is filmed


GROUNDS = {  # height of the eye, degrees down, field, texels to the unit, step: by hand
    "floor": (1.0, 28, 50, 700, (0.0009, 0.0019)),
    "low-floor": (0.5, 14, 50, 700, (0.0006, 0.0021)),
    "wall": (1.0, 78, 40, 371, (0.0017, 0.0006)),
}


@pytest.mark.parametrize(("name", "size"), [("floor", (64, 64)), ("low-floor", (16, 32)), ("wall", (16, 32))])
def test_grounds_are_seen_as_a_pinhole_camera_sees_them_with_texels_as_large_for_any_size(name, size):
    eye, down, field, per_unit, (right, ahead) = GROUNDS[name]
    scene = films(size=size, height=80, frames=12)[name]
    focal = 60 / math.tan(math.radians(field / 2))
    row, column = np.indices((80, 120)) + 0.5
    x, y = (column - 60) / focal, (40 - row) / focal
    falls = math.sin(math.radians(down)) - y * math.cos(math.radians(down))  # of rays, for a unit along the view
    seen = falls > 0.01
    to = eye / np.where(seen, falls, 1)
    forth = to * (math.cos(math.radians(down)) + y * math.sin(math.radians(down))) - eye / math.tan(math.radians(down))
    for index in (0, 11):
        frame = frame_of(scene, index)
        assert frame.coverage[seen].all() and not frame.coverage[falls < 0].any()
        at = np.stack([to * x + index * right, -forth - index * ahead], -1) * per_unit / 2  # half as high, half as many
        np.testing.assert_allclose((frame.uv[seen] - 0.5) * size[::-1], at[seen], rtol=1e-4, atol=0.01)


def test_the_light_of_a_ground_comes_from_ahead() -> None:
    behind = directional("behind", [[0.3, 0.8, 0.6], [0.1, 0.6, 0.4]], [[2.0, 1.8, 1.5], [0.3, 0.5, 0.9]])
    for scene in films_of(SIZE, behind, 4)[:3]:
        lit = scene.shots[0].lighting
        x, _, z = lit.radiance.sum(-1) @ lit.direction
        assert x == pytest.approx(0, abs=1e-9) and z < 0
        np.testing.assert_allclose(lit.direction @ lit.direction.T, behind.direction @ behind.direction.T)
        np.testing.assert_array_equal(lit.direction[:, 1], behind.direction[:, 1])


def test_the_sphere_turns_in_place_under_lights_that_stay() -> None:
    scene = films(frames=9, height=48)["sphere"]
    first, last = frame_of(scene), frame_of(scene, 8)
    assert abs(np.median(first.lod[first.coverage]) - 1) < 0.1
    assert np.mean(first.coverage != last.coverage) < 0.005  # a ball covers what it covered, but for its facets
    turned = (last.uv - first.uv)[24, 36, 0] % 1
    around = np.ptp(scene.shots[0].mesh.uv[:, 0])
    assert min(turned, 1 - turned) == pytest.approx(around * 8 * 0.25 / 360 % 1, rel=0.02)
    # Seen from the camera, lights and outline are where they were.
    pictures = film_candidate(scene.shots, constant()[1][0].levels, "gltf", WRAP)
    both = first.coverage & last.coverage
    np.testing.assert_allclose(pictures[0][both], pictures[8][both], rtol=0.02, atol=2e-3)


@pytest.mark.parametrize("name", ["floor", "sphere"])
def test_lights_turn_about_the_vertical_while_the_camera_stays(name: str) -> None:
    scene = films("light")[name]
    assert len({shot.camera for shot in scene.shots}) == 1 and scene.motion == "light"
    x, y, z = scene.shots[0].lighting.direction.T
    for index, shot in enumerate(scene.shots):
        turned = np.arctan2(*shot.lighting.direction.T[[0, 2]]) - np.arctan2(x, z)
        np.testing.assert_allclose(turned, math.radians(0.25 * index), atol=1e-9)
        np.testing.assert_allclose(shot.lighting.direction[:, 1], y)


def test_a_mesh_of_the_users_turns() -> None:
    (scene,) = films_of(SIZE, LIGHTS, 5, shapes.sphere(8), frames=2, height=32)
    assert scene.name == "film-mesh" and len(scene.shots) == 2
    first, second = (frame_of(scene, index) for index in (0, 1))
    assert first.coverage.mean() > 0.1 and not np.array_equal(first.uv, second.uv)


def test_a_film_of_an_engine_that_accumulates_is_the_mean_of_jittered_frames() -> None:
    shots, levels = films(height=24)["wall"].shots[:1], CANDIDATES[0].levels
    for sampler in (Sampler(), Sampler(16, -1.0)):
        (shown,) = film_candidate(shots, levels, "gltf", WRAP, replace(sampler, frames=8))
        frames = [candidate(shots[0], levels, "gltf", WRAP, sampler, (float(x), float(y))).image for x, y in jitter(8)]
        np.testing.assert_allclose(shown, np.mean(frames, 0), rtol=1e-5, atol=1e-6)


def test_the_stochastic_sampler_draws_every_frame_anew_and_repeats_with_its_seed() -> None:
    shots, levels = films(height=24)["wall"].shots[:1] * 2, CANDIDATES[0].levels
    first, again, other = (film_candidate(shots, levels, "gltf", WRAP, "stochastic", seed) for seed in (0, 0, 1))
    assert not np.array_equal(*first) and np.array_equal(first, again) and not np.array_equal(first, other)


# ---- the reference


def test_the_reference_is_unbiased_and_its_noise_falls(tmp_path: Path) -> None:
    shots, source = films(frames=2)["floor"].shots, filtered(STORED, "gaussian")
    sampling, shares = Supersampling(shots, source, cache=tmp_path), []
    noise = []
    for passes in (8, 64, 16):
        sampling.advance(passes, shares.append)
        first, second, interior = sampling.halves()
        noise.append(float(np.sqrt(np.mean((first - second) ** 2))) / 2)
    assert sampling.passes == 64 and noise[1] < noise[0] / 2 and interior.all()
    assert len(shares) == 2 * (4 + 28) and shares[7] == shares[-1] == 1
    exact = Supersampling(shots, source, seed=1)
    exact.advance(256)
    off = (first + second) / 2 - np.mean(exact.halves()[:2], 0)
    assert 0.3 < float(np.sqrt(np.mean(off**2))) / noise[1] < 3
    # In steps, at once or from a cache it is the same.
    at_once = Supersampling(shots, source)
    at_once.advance(64)
    kept = Supersampling(shots, source, cache=tmp_path)
    assert kept.passes == 64
    for other in (at_once, kept):
        assert all(np.array_equal(a, b) for a, b in zip(sampling.halves(), other.halves(), strict=True))
    assert Supersampling(shots[:1] * 2, source, cache=tmp_path).passes == 0


def test_samples_are_added_until_the_noise_is_small_or_the_limit_is_reached(tmp_path, monkeypatch, unjudged):
    scene, source = films()["floor"], filtered(STORED, "gaussian")
    shares: list[float] = []
    few, _ = film(scene, source, CANDIDATES, settings(32, tmp_path), shares.append)
    assert shares == sorted(shares) and shares[-1] == pytest.approx(1)
    many, figures = film(scene, source, CANDIDATES, settings(256, tmp_path))
    assert few.scene.passes == 32 and not few.scene.converged
    assert 32 < many.scene.passes <= 256 and many.scene.noise < few.scene.noise
    assert many.scene.converged == (many.scene.noise <= max(RESOLVED_SHARE * many.scene.candidate_error, UNSEEN))
    again, same = film(scene, source, CANDIDATES, settings(32, tmp_path))  # what was sampled once is there
    assert again.scene == many.scene and same == figures
    (said,) = cautions.not_converged([], [few.scene])
    assert "film-floor" in said and "20% of the best candidate's error" in said and "after 32 samples" in said
    # A reference that needs a few samples more takes a few more, and none more than films may.
    monkeypatch.setattr(filming, "RESOLVED_SHARE", few.scene.noise / few.scene.candidate_error / 1.05)
    monkeypatch.setattr(filming, "LEAST_PASSES", 32)
    assert 32 < film(scene, source, CANDIDATES, settings(256))[0].scene.passes < 64
    monkeypatch.setattr(filming, "MOST_PASSES", 32)
    assert film(scene, source, CANDIDATES, settings(256))[0].scene.passes == 32


def test_a_constant_material_looks_right_in_every_film(unjudged: None) -> None:
    level, candidates = constant()
    for name, scene in films().items():
        filmed, figures = film(scene, filtered(level, "gaussian"), candidates, settings(16))
        found = {figure.measure: figure.value for figure in figures}
        assert tuple(found) == film_measures() and {f.view for f in figures} == {scene.name} == {filmed.scene.name}
        off = 0.05 if name == "sphere" else 0.01  # a sphere bends within a pixel, which no stack knows of
        assert found["flip"] < off and found["sparkle"] == 0 and found["snr"] > 20
        assert filmed.reference.shape == filmed.images["constant"].shape == (3, 32, 48, 3)
        assert np.abs(filmed.reference.astype(int) - filmed.images["constant"])[:, 8:-8, 16:-16].max() < 16
    # The last is the sphere: measures see the reference at its outline, people see steps.
    assert ((filmed.images["constant"] == 0).all(-1) & (filmed.reference > 64).any(-1)).any()
    tiny, stacks = constant(2, 2)
    assert film(films(size=(2, 2))["wall"], filtered(tiny, "box"), stacks, settings(16))[0].scene.lod <= 1


def test_of_methods_that_nobody_named_those_whose_first_frames_look_best_are_filmed(unjudged: None) -> None:
    scene, source = films()["floor"], filtered(STORED, "gaussian")
    candidates = baked(STORED, ("linear", "box"), ("linear", "gaussian"), ("lean", "gaussian"), ("vmf", "gaussian"))
    whole, every = film(scene, source, candidates, settings(32))
    some, figures = film(scene, source, candidates, settings(32), named=["linear (gaussian)"])
    flip = {f.method: f.value for f in every if f.measure == "flip"}
    best = sorted(flip.keys() - {"linear (gaussian)"}, key=flip.__getitem__)[:LOOKED_AT]
    assert set(some.images) == {f.method for f in figures} == {"linear (gaussian)", *best}
    assert list(whole.images) == [each.name for each in candidates]


def test_samplers_change_what_candidates_show_and_not_the_reference(unjudged: None) -> None:
    scene, source = films()["wall"], filtered(STORED, "gaussian")
    plain, _ = film(scene, source, CANDIDATES[:1], settings(16))
    for sampler in (Sampler(bias=-1.0, frames=8), "stochastic"):
        changed, _ = film(scene, source, CANDIDATES[:1], settings(16, sampler=sampler))
        assert np.array_equal(changed.reference, plain.reference) and changed.scene.sampler == str(sampler)
        assert not np.array_equal(changed.images["linear (box)"], plain.images["linear (box)"])


# ---- figures


Frames = NDArray[np.float32]
SHAPE = (4, 24, 32, 3)


def exact() -> Frames:
    """Waves that move by a third of a pixel a frame."""
    t, y, x, c = np.ogrid[: SHAPE[0], : SHAPE[1], : SHAPE[2], :3]
    return (0.8 + 0.5 * np.sin(0.9 * (x + t / 3) + 0.3 * y + c)).astype(np.float32)


def reference(noise: float = 0.0, margin: int = 4) -> FilmReference:
    inside = np.zeros(SHAPE[:3], bool)
    inside[:, margin:-margin, margin:-margin] = True
    rng = np.random.default_rng(0)
    first, second = (exact() * (1 + noise * rng.standard_normal(SHAPE)).astype(np.float32) for _ in range(2))
    return FilmReference((first, second), inside)


def test_a_film_is_shown_at_the_exposure_of_its_reference() -> None:
    shown = reference(0.01)
    inside, mean = shown.interior, (shown.linear[0] + shown.linear[1]) / 2
    assert shown.exposure == film_exposure(mean, inside)
    assert np.median(mean[inside]) * shown.exposure == pytest.approx(0.6)
    for own, linear in zip((shown.first, shown.second, shown.mean), (*shown.linear, mean), strict=True):
        np.testing.assert_allclose(own, displayed(linear * np.float64(shown.exposure)), atol=1e-6)
    black = shown.shown(mean * 0)
    assert (black[inside] == 0).all() and np.array_equal(black[~inside], shown.mean[~inside])


def test_noise_and_errors_are_estimated_of_what_is_displayed() -> None:
    shown, right = reference(0.02), reference()
    inside = shown.interior
    off = (shown.mean - displayed(exact() * np.float64(shown.exposure)))[inside]
    assert shown.noise == pytest.approx(np.sqrt(np.mean(off**2)), rel=0.05)
    assert right.noise == 0 == right.error(exact())
    # The noise of the halves is no error of the candidate.
    assert shown.error(exact()) < 0.3 * shown.noise
    wrong = exact() * np.float32(1.1)
    assert shown.error(wrong) == pytest.approx(right.error(wrong), rel=0.02)
    difference = (right.shown(wrong) - right.mean)[inside].astype(np.float64)
    assert right.error(wrong) == pytest.approx(np.sqrt(np.mean(difference**2)), rel=1e-6)


def test_figures_by_hand() -> None:
    """One bright dot in one frame, and anything outside of the interior."""
    shown = reference()
    dotted = np.where(shown.interior[..., None], exact(), np.float32(50))
    dotted[3, 10, 12] = 40
    found = film_figures(dotted, shown, ())
    seen, inside = shown.shown(dotted), shown.interior
    assert tuple(found) == tuple(name for name in MEASURES if name in found)
    dot = np.mean(seen[3, 10, 12] - shown.mean[3, 10, 12] - 0.1) / int(inside.sum())
    assert found["sparkle"] == pytest.approx(dot, rel=1e-4)
    maps = np.stack([ldr_flip(p, r).per_pixel for p, r in zip(seen[::3], shown.mean[::3], strict=True)])
    assert found["flip"] == pytest.approx(float(maps[inside[::3]].mean()), rel=1e-5)
    signal = np.sum(exact()[inside].astype(float) ** 2)
    error = np.sum((dotted - exact())[inside].astype(float) ** 2)
    assert found["snr"] == pytest.approx(10 * math.log10(signal / error), abs=1e-3)
    change, should = (np.diff(each.astype(float), axis=0)[:, inside[0]] for each in (seen, shown.mean))
    assert found["flicker"] == pytest.approx(np.sum(change**2) / np.sum(should**2), rel=1e-5)
    lost = 10 * math.log10(np.sum(should**2) / np.sum((change - should) ** 2))
    assert found["flicker-snr"] == pytest.approx(lost, abs=1e-3)
    # A pixel that leaves the interior shows the reference from then on, and this change is nobody's.
    shown.interior[2:, :, :12] = False
    left = exact()
    left[:2, :, :12] = 40
    found = film_figures(left, shown, ())
    assert found["flicker"] == pytest.approx(1) and found["snr"] < 0 and found["flip"] > 0.1


def test_noise_biases_neither_snr_nor_flicker() -> None:
    wrong = (exact() + 0.1 * np.roll(exact(), 5, 2)).astype(np.float32)
    noisy, right = (film_figures(wrong, reference(noise), ()) for noise in (0.05, 0.0))
    assert noisy["snr"] == pytest.approx(right["snr"], abs=0.1)
    assert noisy["flicker"] == pytest.approx(right["flicker"], rel=0.05)
    assert noisy["flip"] > right["flip"]  # the other measures count it


@needs_cvvdp
def test_quality_is_of_the_displayed_films_at_their_frame_rate() -> None:
    shown = reference()
    wrong = (exact() + 0.2 * np.roll(exact(), 5, 2)).astype(np.float32)
    found = film_figures(wrong, shown, (37, 75))
    assert tuple(found) == (*film_measures(), "jod-75")
    for ppd in (37, 75):
        assert found[f"jod-{ppd}"] == color_video_vdp(shown.shown(wrong), shown.mean, ppd, FRAMES_PER_SECOND) < 10


def test_a_film_without_its_judge_interior_or_light_raises_nothing(unjudged: None) -> None:
    nothing = film_figures(exact(), reference(margin=12))
    assert tuple(nothing) == film_measures() == ("snr", "flip", "sparkle", "flicker", "flicker-snr")
    assert all(math.isnan(value) for value in nothing.values())
    black = FilmReference((np.zeros_like(exact()), np.zeros_like(exact())), reference().interior)
    found = film_figures(np.zeros_like(exact()), black)
    assert black.exposure == 1 and found["flip"] == 0 and math.isnan(found["snr"]) and math.isnan(found["flicker"])
