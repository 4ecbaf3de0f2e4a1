"""Films of a comparison: one reference for all, as noisy as is allowed, and figures that say which method is right."""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mipbake.comparing import cautions, filming
from mipbake.comparing.filming import RESOLVED_SHARE, UNSEEN, FilmSettings, film, films_of
from mipbake.comparing.films import FilmScene
from mipbake.comparing.meshes import shapes
from mipbake.comparing.meshes.film import film_candidate
from mipbake.comparing.pictures import RenderSettings
from mipbake.comparing.result import Filmed
from mipbake.material.aim import Sampler
from mipbake.quality.figures import Figure
from mipbake.quality.metrics import MEASURES, displayed

from .test_compare_renders import LIGHTS, baked, bumpy, constant, filtered

SIZE = (32, 32)


def scenes(side: int = 32, **changes: Any) -> dict[str, FilmScene]:
    given = {"size": SIZE, "lighting": LIGHTS, "last_level": 5, "mesh": None, "motion": "camera", "side": side}
    return {scene.name: short(scene) for scene in films_of(**(given | changes))}


def short(scene: FilmScene, frames: int = 3) -> FilmScene:
    made = scene.film
    few = dataclasses.replace(made, cameras=made.cameras[:frames], lightings=made.lightings[:frames])
    return dataclasses.replace(scene, film=few)


def settings(passes: int = 64, cache: Path | None = None, **changes: Any) -> FilmSettings:
    return FilmSettings(RenderSettings(0, passes, cache=cache), **changes)


def values(figures: tuple[Figure, ...], method: str) -> dict[str, float]:
    return {figure.measure: figure.value for figure in figures if figure.method == method}


@pytest.fixture(autouse=True)
def unjudged(monkeypatch: pytest.MonkeyPatch) -> None:
    """What is tested here does not hang on ColorVideoVDP, which takes its time."""
    monkeypatch.setattr("mipbake.comparing.film_figures.missing_judge", lambda: "not installed")


def test_films_are_no_higher_than_renders_and_keep_their_shape() -> None:
    assert [scene.film.resolution for scene in scenes(32).values()] == [(32, 48)] * 4
    assert {scene.film.resolution for scene in scenes(256).values()} == {(160, 240)}
    assert list(scenes(mesh=shapes.material_ball(8))) == ["mesh"]


def test_a_constant_material_looks_right_in_every_film() -> None:
    level, candidates = constant()
    for scene in scenes().values():
        filmed, figures = film(scene, filtered(level, "gaussian"), candidates, settings(16))
        found = values(figures, "constant")
        assert list(found) == [name for name in MEASURES if name in found]
        assert {f.view for f in figures} == {f"film-{scene.name}"} == {filmed.scene.name}
        off = 0.05 if scene.name == "sphere" else 0.01  # a sphere bends within a pixel, which no stack knows of
        assert found["flip"] < off and found["sparkle"] == 0 and found["snr"] > 20
        assert filmed.reference.shape == filmed.images["constant"].shape == (3, 32, 48, 3)
        assert np.abs(filmed.reference.astype(int) - filmed.images["constant"])[:, 8:-8, 16:-16].max() < 16


def test_samples_are_added_until_the_noise_is_small_or_the_limit_is_reached(tmp_path: Path) -> None:
    stored = bumpy(32)
    scene, candidates = scenes()["floor"], baked(stored, ("linear", "box"), ("lean", "gaussian"))
    shares: list[float] = []
    source = filtered(stored, "gaussian")
    few, _ = film(scene, source, candidates, settings(32, tmp_path), shares.append)
    assert shares == sorted(shares) and shares[-1] == pytest.approx(1)
    many, figures = film(scene, source, candidates, settings(256, tmp_path))
    assert few.scene.passes == 32 and not few.scene.converged
    assert 32 < many.scene.passes <= 256 and many.scene.noise < few.scene.noise
    assert many.scene.converged == (many.scene.noise <= max(RESOLVED_SHARE * many.scene.candidate_error, UNSEEN))
    # What was sampled once is there, and nothing else depends on the cache.
    again, same = film(scene, source, candidates, settings(32, tmp_path))
    assert again.scene == many.scene and same == figures
    fresh, _ = film(scene, source, candidates, settings(256))
    assert np.array_equal(fresh.reference, many.reference) and fresh.scene == many.scene


def test_a_reference_that_needs_a_few_samples_more_takes_a_few_more(monkeypatch: pytest.MonkeyPatch) -> None:
    stored = bumpy(32)
    scene, candidates, source = scenes()["floor"], baked(stored, ("linear", "box")), filtered(stored, "gaussian")
    at_32 = film(scene, source, candidates, settings(32))[0].scene
    monkeypatch.setattr(filming, "RESOLVED_SHARE", at_32.noise / at_32.candidate_error / 1.05)
    monkeypatch.setattr(filming, "LEAST_PASSES", 32)
    assert 32 < film(scene, source, candidates, settings(256))[0].scene.passes < 64


def test_a_film_never_takes_more_samples_than_films_may(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(filming, "MOST_PASSES", 32)
    stored = bumpy(32)
    filmed, _ = film(scenes()["floor"], filtered(stored, "gaussian"), baked(stored, ("lean", "box")), settings(256))
    assert filmed.scene.passes == 32
    (said,) = cautions.not_converged([], [filmed.scene])
    assert "film-floor" in said and "20% of the best candidate's error" in said and "after 32 samples" in said


def test_accumulation_and_samplers_change_what_candidates_show_and_not_the_reference() -> None:
    stored = bumpy(32)
    scene, candidates = scenes()["wall"], baked(stored, ("linear", "box"))
    looks = RenderSettings(0, 16)
    plain, _ = film(scene, filtered(stored, "gaussian"), candidates, FilmSettings(looks))
    for other in (
        FilmSettings(dataclasses.replace(looks, sampler=Sampler(bias=-1.0, frames=8))),
        FilmSettings(dataclasses.replace(looks, sampler="stochastic")),
    ):
        changed, _ = film(scene, filtered(stored, "gaussian"), candidates, other)
        assert np.array_equal(changed.reference, plain.reference)
        assert not np.array_equal(changed.images["linear (box)"], plain.images["linear (box)"])
        assert changed.scene.sampler == str(other.renders.sampler)


def test_the_seed_draws_what_the_stochastic_sampler_shows() -> None:
    stored = bumpy(32)
    scene, candidates, source = scenes()["wall"], baked(stored, ("linear", "box")), filtered(stored, "gaussian")
    for seed in (3, 4):
        looks = RenderSettings(seed, 16, "stochastic")
        filmed, _ = film(scene, source, candidates, FilmSettings(looks))
        made = film_candidate(scene.film, candidates[0].levels, "gltf", source.wrap, "stochastic", seed)
        off = 255 * displayed(made * np.float64(filmed.scene.exposure)) - filmed.images["linear (box)"]
        assert np.abs(off).max() < 0.51


def test_a_film_shows_the_outline_of_a_candidate_as_it_is() -> None:
    """Measures see the reference there, people see steps."""
    level, candidates = constant()
    filmed, _ = film(scenes()["sphere"], filtered(level, "gaussian"), candidates, settings(16))
    black = (filmed.images["constant"] == 0).all(-1)
    grey = (filmed.reference > 64).any(-1)
    assert (black & grey).any()


def test_the_level_of_detail_of_a_film_is_clamped_to_the_stack() -> None:
    level, candidates = constant(2, 2)
    for scene in scenes(size=(2, 2), last_level=1).values():
        filmed, _ = film(scene, filtered(level, "gaussian"), candidates, settings(16))
        assert 0 <= filmed.scene.lod <= 1 and not math.isnan(filmed.scene.lod)


def test_without_its_judge_a_reader_is_told_what_to_type(monkeypatch: pytest.MonkeyPatch) -> None:
    level, candidates = constant()
    filmed: list[Filmed] = [film(scenes()["wall"], filtered(level, "box"), candidates, settings(16))[0]]
    monkeypatch.setattr(cautions, "missing_judge", lambda: "ColorVideoVDP is not installed: type 'pip'")
    assert cautions.unjudged(filmed) == ("ColorVideoVDP is not installed: type 'pip'.",)
    assert cautions.unjudged([]) == ()
    monkeypatch.setattr(cautions, "missing_judge", lambda: "")
    assert cautions.unjudged(filmed) == ()
