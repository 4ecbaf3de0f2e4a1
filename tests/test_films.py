"""Films: what is filmed, once per pixel, supersampled, and accumulated over frames."""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.ndimage import binary_erosion

from mipbake.compare.films import FLOOR_LAST, FilmScene, Motion, mesh_films, standard_films
from mipbake.errors import UsageError
from mipbake.pixel_filter import level_sizes
from mipbake.reference.source import FilteredSource
from mipbake.render import accumulation, shapes
from mipbake.render.accumulation import JITTERS, film_accumulated, jitter
from mipbake.render.camera import Camera
from mipbake.render.environment import directional
from mipbake.render.film import Film, FilmReference, FilmSampling, film_candidate, film_reference
from mipbake.render.mesh import Mesh, joined
from mipbake.render.mesh_render import Cache, Shot, candidate

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


def test_the_floor_runs_from_level_0_to_level_4_and_the_wall_lies_around_a_quarter() -> None:
    made = films(resolution=(64, 96))
    for scene in made.values():
        assert len(scene.film.shots) == 3
    lods = {name: frame_of(scene).lod[:, 48] for name, scene in made.items()}
    assert lods["floor"][-1] < 0.15 and abs(lods["floor"][0] - FLOOR_LAST) < 0.15
    assert (np.diff(lods["floor"]) < 1e-3).all()
    wall = frame_of(made["wall"]).lod
    assert abs(np.median(wall) - 0.25) < 0.05 and 0 <= wall.min() < wall.max() < 0.6
    ball = frame_of(made["sphere"])
    assert abs(np.median(ball.lod[ball.coverage]) - 1) < 0.1


def frame_of(scene: FilmScene, index: int = 0) -> Any:
    return candidate(scene.film.shots[index], stack(), "gltf", WRAP)


def test_a_texture_of_few_levels_has_a_floor_of_as_many() -> None:
    floor = standard_films((4, 4), LIGHTS, 2, frames=2, resolution=(64, 96))[0]
    assert floor.title == "Floor, lod 0 to 2"
    levels = [np.zeros((*size, 8), np.float32) for size in level_sizes(4, 4)]
    lod = candidate(floor.film.shots[0], levels, "gltf", WRAP).lod
    assert abs(lod[0].max() - 2) < 0.15


@pytest.mark.parametrize(("name", "off"), [("floor", 1e-3), ("wall", 0.08)])  # the wall is turned from the camera
def test_floor_and_wall_go_by_a_part_of_a_texel_a_frame(name: str, off: float) -> None:
    scene = films()[name]
    first, second = (frame_of(scene, index).uv for index in (0, 1))
    moved = (second - first) * SIZE
    # What a fixed pixel sees moves by what the camera does: 0.61 texels along u, 0.37 along v.
    np.testing.assert_allclose(np.abs(moved), np.broadcast_to([0.61, 0.37], moved.shape), rtol=0, atol=off)


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


@pytest.mark.parametrize("name", ["floor", "wall", "sphere"])
def test_lights_turn_about_the_vertical_while_the_camera_stays(name: str) -> None:
    film = films("light")[name].film
    assert len(set(film.cameras)) == 1
    for index, lighting in enumerate(film.lightings):
        x, y, z = LIGHTS.direction.T
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


# ---- temporal accumulation


def test_the_jitter_stays_within_half_a_pixel_and_is_even() -> None:
    offsets = jitter(JITTERS)
    assert offsets.shape == (JITTERS, 2) and (np.abs(offsets) < 0.5).all()
    assert len({tuple(offset) for offset in offsets}) == JITTERS
    for axis, base in ((0, 2), (1, 3)):
        # A Halton sequence puts a point into every interval of a width of 1 / base.
        assert set(np.floor((offsets[:, axis] + 0.5) * base)) == set(range(base))
    np.testing.assert_allclose(offsets[:3, 0], [0.0, -0.25, 0.25])


def test_a_still_film_tends_to_the_mean_of_its_jittered_frames(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where the history is not held to the new frame, which is what keeps it from the mean."""
    film, levels = still(), stack()
    last = film_accumulated(film, levels, "gltf", WRAP)[-1]
    offsets = [(float(x), float(y)) for x, y in jitter(JITTERS)]
    mean = np.mean([candidate(film.shots[0], levels, "gltf", WRAP, offset=each).image for each in offsets], 0)
    once = candidate(film.shots[0], levels, "gltf", WRAP).image
    monkeypatch.setattr(accumulation, "held", lambda history, _new: history)
    free = film_accumulated(film, levels, "gltf", WRAP)[-1]
    # Exponential weights of a tenth leave sqrt(0.1 / 1.9) = 0.23 of what independent frames are off by.
    assert error(free, mean) < 0.23 * error(once, mean)
    assert error(last, mean) < 0.5 * error(once, mean)


def error(image: Any, expected: Any) -> float:
    return float(np.sqrt(np.mean((image - expected) ** 2)))


def test_the_first_frame_has_stood_still_before() -> None:
    film, levels = still(), stack()
    shown = film_accumulated(film, levels, "gltf", WRAP)
    assert error(shown[0], shown[-1]) < 0.3 * error(candidate(film.shots[0], levels, "gltf", WRAP).image, shown[-1])


def test_the_history_lands_where_the_surface_was() -> None:
    """A smooth picture that is carried along the motion of a wall is the picture that the moved wall shows."""
    film = films(frames=2, resolution=(48, 72))["wall"].film
    before, after = film.shots

    def painted(shot: Shot) -> Any:
        u, v = np.moveaxis(candidate(shot, stack(), "gltf", WRAP).uv.astype(np.float64) * SIZE, -1, 0)
        return 0.5 + 0.2 * np.stack([np.sin(0.3 * u), np.cos(0.2 * v), np.sin(0.2 * (u + v))], -1)

    new = np.full((48, 72, 3), 9.0)
    moved = accumulation.moved(painted(before), after, film.cameras[0], new)
    inside = np.s_[4:-4, 4:-4]  # at the border a history has no neighbours to interpolate between
    assert np.abs(moved - painted(after))[inside].max() < 2e-3
    assert np.abs(painted(before) - painted(after)).max() > 0.02


def test_accumulation_takes_shimmer_away_and_keeps_what_is_constant() -> None:
    film, levels = films(frames=8)["wall"].film, stack()
    plain, accumulated = film_candidate(film, levels, "gltf", WRAP), film_accumulated(film, levels, "gltf", WRAP)
    change = [float(np.mean(np.diff(frames, axis=0) ** 2)) for frames in (plain, accumulated)]
    assert change[1] < 0.7 * change[0]
    flat = [np.broadcast_to(np.float32([0.5, 0.4, 0.3, 0, 0.9, 0, 0, 1]), level.shape).copy() for level in levels]
    np.testing.assert_allclose(
        film_accumulated(film, flat, "gltf", WRAP), film_candidate(film, flat, "gltf", WRAP), rtol=2e-3
    )


def test_a_surface_that_came_from_outside_of_the_picture_shows_the_new_frame() -> None:
    film = still(2)
    aside = dataclasses.replace(film.cameras[0], position=(9.0, 0.0, 9.0), looks_at=(18.0, 0.0, 9.0))
    assert isinstance(aside, Camera)
    new = np.random.default_rng(0).random((24, 32, 3))
    assert np.array_equal(accumulation.moved(np.zeros_like(new), film.shots[1], aside, new), new)


def upright(side: float, x: float, z: float) -> Mesh:
    """A square that faces +z."""
    ground = shapes.plane(side, side)
    return dataclasses.replace(ground, positions=ground.positions[:, [0, 2, 1]] * [1, -1, 1] + [x, 0, z])


def test_a_surface_that_lay_behind_another_one_shows_the_new_frame() -> None:
    """A card hangs before a wall: a camera that goes to the left sees more of the wall on the left of the card."""
    mesh, size = joined("card and wall", [upright(9, 0, 0), upright(0.8, 0, 2)]), (96, 128)
    here, there = (Camera((x, 0.0, 5.0), looks_at=(x, 0.0, 0.0), field_of_view=40, far=9) for x in (0.0, -0.5))
    shown = accumulation.moved(np.zeros((*size, 3)), Shot(mesh, there, LIGHTS, size), here, np.ones((*size, 3)))[..., 0]

    row, column = np.indices(size) + 0.5
    y, x = (np.tan(np.radians(20)) * each for each in (1 - row / 48, (column - 64) / 48))
    card = np.maximum(abs(3 * x - 0.5), abs(3 * y)) < 0.4
    wall_x, wall_y = 5 * x - 0.5, 5 * y
    hidden = ~card & (np.maximum(abs(wall_x * 3 / 5), abs(wall_y * 3 / 5)) < 0.4)
    certain = binary_erosion(hidden, iterations=2)
    assert certain.sum() > 100
    assert (shown[certain] == 1).all()
    seen = binary_erosion(~hidden, iterations=2) & (wall_x > -1.7)  # farther to the left lies what was outside
    assert (shown[seen] == 0).all()


def test_a_history_is_held_to_the_colours_around_each_pixel_of_the_new_frame() -> None:
    rng = np.random.default_rng(0)
    history, new = 3 * rng.random((2, 6, 7, 3)) - 1
    expected = np.empty_like(history)
    for row, column, channel in np.ndindex(history.shape):
        around = new[max(row - 1, 0) : row + 2, max(column - 1, 0) : column + 2, channel]
        expected[row, column, channel] = min(max(history[row, column, channel], around.min()), around.max())
    assert np.array_equal(accumulation.held(history, new), expected)


def test_a_new_frame_is_a_tenth_of_what_is_shown_in_tonemapped_radiance(monkeypatch: pytest.MonkeyPatch) -> None:
    """A grey that stood still, then a chequered frame, black and bright."""
    chequered = np.float32(9) * (np.indices((24, 32)).sum(0) % 2)[..., None] * np.ones(3, np.float32)
    grey = np.ones_like(chequered)
    rendered = iter([grey] * (JITTERS + 1) + [chequered])
    monkeypatch.setattr(accumulation, "candidate", lambda *_: SimpleNamespace(image=next(rendered)))
    shown = film_accumulated(still(2), stack(), "gltf", WRAP)
    np.testing.assert_allclose(shown[0], 1, rtol=1e-6)
    mixed = 0.9 * 0.5 + 0.1 * np.array([0.0, 0.9])  # 1 is 0.5 tonemapped, and 9 is 0.9
    expected = np.where(chequered > 0, *(mixed / (1 - mixed))[::-1])
    np.testing.assert_allclose(shown[1], expected, rtol=1e-5)
