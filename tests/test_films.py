"""Films: what is filmed, once per pixel, supersampled, and accumulated over frames."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mipbake.base.errors import UsageError
from mipbake.comparing.films import FilmScene, Motion, mesh_films, standard_films
from mipbake.comparing.meshes import shapes
from mipbake.comparing.meshes.film import Film, FilmReference, FilmSampling, film_candidate, film_reference
from mipbake.comparing.meshes.mesh_render import Cache, candidate
from mipbake.material.aim import Sampler
from mipbake.material.filtered_source import FilteredSource
from mipbake.material.pixel_filter import level_sizes
from mipbake.quality.environment import directional
from mipbake.quality.samplers import jitter

WRAP = ("wrap", "wrap")
LIGHTS = directional("two", [[0.3, 0.8, 0.6], [-0.5, 0.6, 0.4]], [[2.0, 1.8, 1.5], [0.3, 0.5, 0.9]])
SIZE = (64, 64)


def stack(amount: float = 0.4) -> list[Any]:
    """Matte, of a random grey with a little of each colour; averaged levels."""
    rng = np.random.default_rng(0)
    level = np.zeros((*SIZE, 8), np.float32)
    level[..., :3] = 0.5 + amount * (rng.random((*SIZE, 1)) - 0.5) + 0.1 * (rng.random((*SIZE, 3)) - 0.5)
    level[..., 4], level[..., 7] = 0.9, 1
    levels = [level]
    for height, width in level_sizes(*SIZE)[1:]:
        levels.append(levels[-1].reshape(height, 2, width, 2, 8).mean((1, 3)))
    return levels


def source(pixel_filter: str = "gaussian") -> FilteredSource:
    return FilteredSource(stack()[0], "gltf", WRAP, pixel_filter)


def films(motion: Motion = "camera", frames: int = 3, resolution: tuple[int, int] = (32, 48)) -> dict[str, FilmScene]:
    made = standard_films(SIZE, LIGHTS, len(level_sizes(*SIZE)) - 1, motion, frames, resolution)
    return {scene.name: scene for scene in made}


def still(frames: int = 60, resolution: tuple[int, int] = (24, 32)) -> Film:
    """A wall that nothing moves before."""
    film = films(frames=1, resolution=resolution)["wall"].film
    return dataclasses.replace(film, cameras=film.cameras * frames, lightings=film.lightings * frames)


# ---- what is filmed


GROUNDS = {  # height of the eye, degrees down, field, texels to the unit, step: by hand
    "floor": (1.0, 28, 50, 700, (0.0009, 0.0019)),
    "low-floor": (0.5, 14, 50, 700, (0.0006, 0.0021)),
    "wall": (1.0, 78, 40, 371, (0.0017, 0.0006)),
}


@pytest.mark.parametrize("size", [(64, 64), (16, 32)])
@pytest.mark.parametrize("name", GROUNDS)
def test_grounds_are_seen_as_a_pinhole_camera_sees_them_with_texels_as_large_for_any_size(
    name: str, size: tuple[int, int]
) -> None:
    eye, down, field, texels, (right, ahead) = GROUNDS[name]
    (scene,) = (each for each in standard_films(size, LIGHTS, 4, resolution=(80, 120)) if each.name == name)
    assert len(scene.film.shots) == 12
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
        at = np.stack([to * x + index * right, -forth - index * ahead], -1) * texels / 2  # half as high, half as many
        np.testing.assert_allclose((frame.uv[seen] - 0.5) * size[::-1], at[seen], rtol=1e-4, atol=0.01)


def test_the_wall_has_about_one_texel_a_pixel_and_the_sphere_two() -> None:
    made = films(resolution=(64, 96))
    assert frame_of(made["wall"]).lod[32, 48] == pytest.approx(math.log2(1.15), abs=0.05)
    ball = frame_of(made["sphere"])
    assert abs(np.median(ball.lod[ball.coverage]) - 1) < 0.1


@pytest.mark.parametrize("name", GROUNDS)
def test_the_light_of_a_ground_comes_from_ahead(name: str) -> None:
    behind = directional("behind", [[0.3, 0.8, 0.6], [0.1, 0.6, 0.4]], [[2.0, 1.8, 1.5], [0.3, 0.5, 0.9]])
    lit = next(each for each in standard_films(SIZE, behind, 4) if each.name == name).film.lightings[0]
    x, _, z = lit.radiance.sum(-1) @ lit.direction
    assert x == pytest.approx(0, abs=1e-9) and z < 0
    np.testing.assert_allclose(lit.direction @ lit.direction.T, behind.direction @ behind.direction.T)
    np.testing.assert_array_equal(lit.direction[:, 1], behind.direction[:, 1])


def frame_of(scene: FilmScene, index: int = 0) -> Any:
    return candidate(scene.film.shots[index], stack(), "gltf", WRAP)


def test_the_sphere_turns_in_place_under_lights_that_stay() -> None:
    scene = films(frames=9, resolution=(48, 72))["sphere"]
    first, last = frame_of(scene), frame_of(scene, 8)
    assert np.mean(first.coverage != last.coverage) < 0.005  # a ball covers what it covered, but for its facets
    turned = (last.uv - first.uv)[24, 36, 0] % 1
    around = np.ptp(scene.film.mesh.uv[:, 0])
    assert min(turned, 1 - turned) == pytest.approx(around * 8 * 0.25 / 360 % 1, rel=0.02)
    # Seen from the camera, lights and outline are where they were.
    constant = [np.full_like(level, 0.5) for level in stack()]
    for level in constant:
        level[..., 3], level[..., 5:] = 0, (0, 0, 1)
    pictures = film_candidate(scene.film, constant, "gltf", WRAP)
    both = first.coverage & last.coverage
    np.testing.assert_allclose(pictures[0][both], pictures[8][both], rtol=0.02, atol=2e-3)


@pytest.mark.parametrize("name", ["floor", "sphere"])
def test_lights_turn_about_the_vertical_while_the_camera_stays(name: str) -> None:
    film = films("light")[name].film
    assert len(set(film.cameras)) == 1
    x, y, z = film.lightings[0].direction.T
    for index, lighting in enumerate(film.lightings):
        turned = np.arctan2(*lighting.direction.T[[0, 2]]) - np.arctan2(x, z)
        np.testing.assert_allclose(turned, math.radians(0.25 * index), atol=1e-9)
        np.testing.assert_allclose(lighting.direction[:, 1], y)


def test_a_mesh_of_the_users_turns() -> None:
    (scene,) = mesh_films(shapes.material_ball(8), SIZE, LIGHTS, frames=2, resolution=(32, 48))
    assert scene.name == "mesh"
    first, second = (frame_of(scene, index) for index in (0, 1))
    assert first.coverage.mean() > 0.1 and not np.array_equal(first.uv, second.uv)


def test_a_film_has_a_camera_and_a_lighting_for_every_frame() -> None:
    film = still(2)
    for cameras, lightings in (((), ()), (film.cameras, film.lightings[:1])):
        with pytest.raises(UsageError, match="one of each for every frame"):
            dataclasses.replace(film, cameras=cameras, lightings=lightings)


# ---- the reference


def test_the_reference_is_the_mean_of_two_halves_and_its_noise_falls() -> None:
    film = films(frames=2)["floor"].film
    short, long = (film_reference(film, source(), passes) for passes in (8, 64))
    np.testing.assert_allclose(long.frames, (long.first + long.second) / 2)
    assert (short.passes, long.passes) == (8, 64) and noise(long) < noise(short) / 2
    assert short.interior.all()
    exact = film_reference(film, source(), 512, seed=1).frames
    assert 0.3 < error(long.frames, exact) / noise(long) < 3


def error(image: Any, expected: Any) -> float:
    return float(np.sqrt(np.mean((image - expected) ** 2)))


def noise(reference: FilmReference) -> float:
    """What the halves tell of the root mean square error of their mean."""
    return error(reference.first, reference.second) / 2


def test_a_constant_material_has_a_reference_without_noise_that_equals_the_candidate() -> None:
    film = films(frames=2)["wall"].film
    level = np.broadcast_to(np.float32([0.5, 0.4, 0.3, 0, 0.9, 0, 0, 1]), (*SIZE, 8)).copy()
    reference = film_reference(film, FilteredSource(level, "gltf", WRAP, "box"), 16)
    assert noise(reference) < 1e-3
    np.testing.assert_allclose(reference.frames, film_candidate(film, [level], "gltf", WRAP), rtol=2e-3)


def test_a_film_that_is_sampled_in_steps_or_from_a_cache_is_the_same(tmp_path: Path) -> None:
    film = films(frames=2)["sphere"].film
    whole = film_reference(film, source(), 16)
    in_steps = FilmSampling(film, source(), cache=Cache(tmp_path))
    assert in_steps.passes == 0
    shares: list[float] = []
    for passes in (4, 16, 8):
        in_steps.advance(passes, shares.append)
    assert shares == [0.5, 1.0, 0.5, 1.0]
    again = FilmSampling(film, source(), cache=Cache(tmp_path))
    assert again.passes == 16 and len(list(tmp_path.iterdir())) == 1
    for sampling in (in_steps, again):
        found = sampling.reference()
        for a, b in ((found.first, whole.first), (found.second, whole.second), (found.interior, whole.interior)):
            assert np.array_equal(a, b)
    elsewhere = dataclasses.replace(film, cameras=film.cameras[:1] * 2)
    assert FilmSampling(elsewhere, source(), cache=Cache(tmp_path)).passes == 0
    (kept,) = tmp_path.iterdir()
    kept.write_bytes(b"no archive")
    assert FilmSampling(film, source(), cache=Cache(tmp_path)).passes == 0


@pytest.mark.parametrize("passes", [2, 7])
def test_halves_take_as_many_samples(passes: int) -> None:
    with pytest.raises(UsageError, match=f"takes {passes} samples a pixel: expected an even number from 4 on"):
        film_reference(still(1), source(), passes)


def test_the_stochastic_sampler_draws_every_frame_anew_and_repeats_with_its_seed() -> None:
    film = still(2)
    first, second = film_candidate(film, stack(), "gltf", WRAP, "stochastic")
    assert not np.array_equal(first, second)
    again = film_candidate(film, stack(), "gltf", WRAP, "stochastic")
    assert np.array_equal([first, second], again)
    assert not np.array_equal(film_candidate(film, stack(), "gltf", WRAP, "stochastic", seed=1), again)


# ---- frames that are accumulated


def test_a_film_of_an_engine_that_accumulates_is_the_mean_of_jittered_frames() -> None:
    film, levels = still(), stack()
    for sampler in (Sampler(), Sampler(16, -1.0)):
        shown = film_candidate(film, levels, "gltf", WRAP, replace(sampler, frames=8))[-1]
        frames = [
            candidate(film.shots[0], levels, "gltf", WRAP, sampler, (float(x), float(y))).image for x, y in jitter(8)
        ]
        np.testing.assert_allclose(shown, np.mean(frames, 0), rtol=1e-5, atol=1e-6)
        assert np.abs(shown - film_candidate(film, levels, "gltf", WRAP, sampler)[-1]).max() > 0.01


def test_accumulation_takes_shimmer_away_and_keeps_what_is_constant() -> None:
    film, levels = films(frames=8)["wall"].film, stack()
    plain, accumulated = (film_candidate(film, levels, "gltf", WRAP, Sampler(frames=count)) for count in (1, 8))
    change = [float(np.mean(np.diff(frames, axis=0) ** 2)) for frames in (plain, accumulated)]
    assert change[1] < 0.7 * change[0]
    flat = [np.broadcast_to(np.float32([0.5, 0.4, 0.3, 0, 0.9, 0, 0, 1]), level.shape).copy() for level in levels]
    shown = [film_candidate(film, flat, "gltf", WRAP, Sampler(frames=count)) for count in (1, 8)]
    np.testing.assert_allclose(*shown, rtol=2e-3)
