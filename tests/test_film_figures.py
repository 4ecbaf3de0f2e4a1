"""The measures of a film: by hand, in the units that they name, and biased by no noise."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.typing import NDArray

from mipbake.comparing import film_figures as module
from mipbake.comparing.film_figures import FilmFigures, ShownReference, film_figures, film_measures
from mipbake.comparing.films import FRAMES_PER_SECOND
from mipbake.comparing.meshes.film import FilmReference
from mipbake.quality.metrics import MEASURES, color_video_vdp, displayed, film_exposure, ldr_flip

from .test_metrics_films import needs_cvvdp

Frames = NDArray[np.float32]
SHAPE = (4, 24, 32, 3)


def exact() -> Frames:
    """Waves that move by a third of a pixel a frame."""
    t, y, x, c = np.ogrid[: SHAPE[0], : SHAPE[1], : SHAPE[2], :3]
    return (0.8 + 0.5 * np.sin(0.9 * (x + t / 3) + 0.3 * y + c)).astype(np.float32)


def interior(margin: int = 4) -> NDArray[np.bool_]:
    inside = np.zeros(SHAPE[:3], bool)
    inside[:, margin:-margin, margin:-margin] = True
    return inside


def reference(noise: float = 0.0, margin: int = 4) -> FilmReference:
    rng = np.random.default_rng(0)
    halves = (exact() * (1 + noise * rng.standard_normal(SHAPE)).astype(np.float32) for _ in range(2))
    return FilmReference(*halves, interior(margin), 16)


def test_a_film_is_shown_at_the_exposure_of_its_reference() -> None:
    shown = ShownReference.of(reference(0.01))
    inside, mean = shown.interior, shown.linear.frames
    assert shown.exposure == film_exposure(mean, inside)
    assert np.median(mean[inside]) * shown.exposure == pytest.approx(0.6)
    for own, linear in ((shown.first, shown.linear.first), (shown.second, shown.linear.second), (shown.mean, mean)):
        np.testing.assert_allclose(own, displayed(linear * np.float64(shown.exposure)), atol=1e-6)
    film = shown.shown(mean * 0)
    assert (film[inside] == 0).all() and np.array_equal(film[~inside], shown.mean[~inside])


def test_noise_and_errors_are_estimated_of_what_is_displayed() -> None:
    shown, right = ShownReference.of(reference(0.02)), ShownReference.of(reference())
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


def test_every_figure_is_of_the_interior_alone() -> None:
    shown = ShownReference.of(reference())
    outside = np.where(shown.interior[..., None], exact(), np.float32(50))
    found = film_figures(outside, shown)
    assert (found.flip, found.sparkle, found.flicker, found.snr) == (0, 0, 1, 100)
    assert all(value == pytest.approx(10) for value in found.jod.values())


def test_figures_by_hand() -> None:
    """One bright dot in one frame."""
    shown = ShownReference.of(reference())
    film = exact()
    film[2, 10, 12] = 40
    found = film_figures(film, shown, ())
    seen, inside = shown.shown(film), shown.interior
    pixels = int(inside.sum())
    assert found.jod == {}
    assert found.sparkle == pytest.approx(np.mean(seen[2, 10, 12] - shown.mean[2, 10, 12] - 0.1) / pixels, rel=1e-4)
    maps = np.stack([ldr_flip(p, r).per_pixel for p, r in zip(seen, shown.mean, strict=True)])
    assert found.flip == pytest.approx(float(maps[inside].mean()), rel=1e-5)
    signal, error = np.sum(exact()[inside].astype(float) ** 2), np.sum((film - exact()).astype(float) ** 2)
    assert found.snr == pytest.approx(10 * math.log10(signal / error), abs=1e-3)
    change, should = (np.diff(each.astype(float), axis=0)[:, inside[0]] for each in (seen, shown.mean))
    assert found.flicker == pytest.approx(np.sum(change**2) / np.sum(should**2), rel=1e-5)
    lost = 10 * math.log10(np.sum(should**2) / np.sum((change - should) ** 2))
    assert found.flicker_snr == pytest.approx(lost, abs=1e-3)


def test_change_is_of_pixels_that_are_inside_in_all_frames() -> None:
    """A pixel that leaves the interior shows the reference from then on, and this change is nobody's."""
    linear = reference()
    linear.interior[2:, :, :12] = False
    film = exact()
    film[:2, :, :12] = 40
    found = film_figures(film, ShownReference.of(linear), ())
    assert found.flicker == pytest.approx(1) and found.snr < 0 and found.flip > 0.1


def test_noise_biases_neither_snr_nor_flicker() -> None:
    wrong = (exact() + 0.1 * np.roll(exact(), 5, 2)).astype(np.float32)
    noisy, right = (film_figures(wrong, ShownReference.of(reference(noise)), ()) for noise in (0.05, 0.0))
    assert noisy.snr == pytest.approx(right.snr, abs=0.1)
    assert noisy.flicker == pytest.approx(right.flicker, rel=0.05)
    assert noisy.flip > right.flip  # the other measures count it


@needs_cvvdp
def test_quality_is_of_the_displayed_films_at_their_frame_rate() -> None:
    shown = ShownReference.of(reference())
    wrong = (exact() + 0.2 * np.roll(exact(), 5, 2)).astype(np.float32)
    found = film_figures(wrong, shown)
    assert list(found.jod) == [37, 75]
    for ppd, value in found.jod.items():
        assert value == color_video_vdp(shown.shown(wrong), shown.mean, ppd, FRAMES_PER_SECOND) < 10


def test_figures_go_by_the_names_of_the_measures() -> None:
    found = FilmFigures({37: 9.0, 75: 8.0}, 0.1, 0.2, 30.0, 1.5, 3.0).by_measure
    assert found == {
        "snr": 30.0, "flip": 0.1, "sparkle": 0.2, "flicker": 1.5, "flicker-snr": 3.0, "jod-37": 9.0, "jod-75": 8.0,
    }  # fmt: skip
    assert list(found) == [name for name in MEASURES if name in found]


def test_without_its_judge_a_film_has_the_other_figures(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "missing_judge", lambda: "ColorVideoVDP is not installed")
    found = film_figures(exact(), ShownReference.of(reference()))
    assert found.jod == {} and found.flip == 0
    assert film_measures() == ("snr", "flip", "sparkle", "flicker", "flicker-snr")


def test_a_film_without_interior_or_light_has_no_figures_and_raises_nothing() -> None:
    nothing = film_figures(exact(), ShownReference.of(reference(margin=12)))
    assert all(math.isnan(value) for value in nothing.by_measure.values())
    black = FilmReference(np.zeros_like(exact()), np.zeros_like(exact()), interior(), 16)
    shown = ShownReference.of(black)
    found = film_figures(np.zeros_like(exact()), shown)
    assert shown.exposure == 1 and found.flip == 0 and math.isnan(found.snr) and math.isnan(found.flicker)
