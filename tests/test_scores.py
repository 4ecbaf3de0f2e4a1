"""What `auto` measures by: references, what chance does to them, and pixels as a screen has them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mipbake.judging.judge import Asked
from mipbake.judging.lit_renders import lit_error, lit_reference, placed, room
from mipbake.judging.probes import ProbeEffort
from mipbake.judging.scores import Score, Scores, certainty
from mipbake.pixel_filter import slanted_axes
from mipbake.reference.problem import Problem
from mipbake.render.environment import studio

from .test_auto import TINY, WRAP


def test_what_chance_decides_counts_little() -> None:
    rows = np.stack([np.full(9, -2.0), np.full(9, -2.0) + np.tile([-1.05, 0, 1.05], 3), 20.0 * np.arange(9)])
    known, unsure, chance = certainty(rows)
    assert known == 1 and 0.3 < unsure < 0.7 and chance < 0.01
    asked = Asked.of(Score(np.zeros((2, 4)), rows, 0.0))
    assert asked.sure.tolist() == [1, 1, known, unsure, chance, 1]  # the last under the lights


def test_noisy_references_take_more_samples() -> None:
    """Few texels of gloss in a rough, level surface: a handful of samples a pixel miss the highlights."""
    stored = np.zeros((32, 32, 8), np.float32)
    stored[..., 3], stored[..., 4], stored[..., 7] = 1, 0.8, 1
    stored[..., :3] = 0.5
    stored[::5, ::7, 4] = 0.3
    task = Problem(stored, "gltf", "gltf", "gaussian", WRAP)
    effort = ProbeEffort(groups=16, points=16, samples=2, lit_points=8, lit_samples=2)

    def noise(doublings: int) -> float:
        (probe,) = Scores(task, replace(effort, doublings=doublings), 0, [3.0]).probes
        noise, signal = (probe.energies(each)[0, : probe.groups].sum() for each in (probe.noise, probe.signal))
        return float(noise / signal)

    more, less = noise(3), noise(0)
    assert more < 0.5 * less, (more, less)


def test_slanted_pixels_are_narrow_across_the_view() -> None:
    face_on, leaning, grazing = slanted_axes(np.array([[0, 0, 1], [0.8, 0, 0.6], [0, 1, 0]], np.float32))
    np.testing.assert_allclose(face_on, [[1, 0], [0, 1]])
    np.testing.assert_allclose(leaning, [[1, 0], [0, 0.6]], atol=1e-6)
    np.testing.assert_allclose(grazing, [[0, -1], [0.1, 0]], atol=1e-6)  # never a line
    assert face_on.dtype == np.float32
    (diagonal,) = slanted_axes(np.array([[0.48, 0.64, 0.6]], np.float32))
    # The view leans along +y, which is up in the image: v runs down.
    np.testing.assert_allclose(diagonal, [[0.6, -0.8], [0.48, 0.36]], atol=1e-6)


def test_pixels_under_the_studio_are_slanted() -> None:
    """Fine stripes along u, seen from the side: the reference blurs them where the view runs along u, and shows them
    where it runs along the stripes."""
    stored = np.zeros((64, 64, 8), np.float32)
    stored[..., 4], stored[..., 7] = 1, 1
    stored[:, ::2, :3] = 1
    task = Problem(stored, "gltf", "gltf", "gaussian", WRAP)
    rng = np.random.default_rng(0)
    uv = np.stack([(np.arange(256) % 2 + 0.5 + 2 * np.arange(256) // 4) / 64 % 1, np.full(256, 0.5)], -1)
    frame = np.broadcast_to(np.eye(3, dtype=np.float32), (256, 3, 3)).copy()
    spread = {}
    for axis in (0, 1):
        view = np.zeros((256, 3), np.float32)
        view[:, axis], view[:, 2] = 0.98, np.sqrt(1 - 0.98**2)
        shown = lit_reference(task, room(studio(), frame, view), uv, 0.7, 64, rng)
        spread[axis] = float(shown.std() / shown.mean())
    assert spread[1] > 2 * spread[0]


@pytest.mark.parametrize("kernel", ["gaussian", "mitchell"])
def test_scores_of_the_source_itself_are_right_where_it_is_constant(kernel: str) -> None:
    stored = np.broadcast_to(np.array([0.2, 0.4, 0.6, 0.5, 0.4, 0, 0, 1], np.float32), (8, 8, 8)).copy()
    scores = Scores(Problem(stored, "gltf", "gltf", kernel, WRAP), TINY, 0, [0.0, 1.5])
    for index in range(2):
        score = scores.of(scores.looked_up(stored, index), index)
        assert (score.decibels > 60).all()
        assert score.lit < -8


def displayed_pixels(count: int) -> tuple[np.ndarray, ...]:
    """What is shown, what is off, and cosines of views."""
    rng = np.random.default_rng(4)
    frame, view = placed(rng, count)
    shown = rng.uniform(0.1, 0.9, (count, 3)).astype(np.float32)
    off = (0.05 * rng.normal(size=(count, 3))).astype(np.float32)
    return shown, off, np.einsum("nj,nj->n", frame[:, 2], view)


def test_noise_of_what_is_right_is_no_error() -> None:
    shown, off, cosine = displayed_pixels(512)
    square = float(np.square(off).mean())
    assert lit_error(off, shown, cosine, 0.75 * square).square == pytest.approx(square / 4, rel=1e-4)
    assert lit_error(off, shown, cosine, 2 * square).square == pytest.approx(0.2 * square, rel=1e-4)


def test_what_is_darker_as_a_whole_counts_more_than_what_is_off_here_and_there() -> None:
    shown, off, cosine = displayed_pixels(512)
    scattered = lit_error(off - off.mean(), shown, cosine)
    darker = lit_error(np.full_like(off, -off.std()), shown, cosine)
    assert darker.square == pytest.approx(scattered.square, rel=1e-3)
    assert darker.logarithm > scattered.logarithm + 0.5
    assert (darker.brightness < 0).all()
    ends = cosine[darker.groups]
    assert (ends[:-1].max(1) <= ends[1:].min(1)).all()  # groups by the angle of view


@pytest.mark.parametrize("count", [1, 5, 100])
def test_slopes_and_curvature_of_what_pixels_are_off_by(count: int) -> None:
    shown, off, cosine = displayed_pixels(count)
    error = lit_error(off, shown, cosine)
    rng = np.random.default_rng(5)
    along = rng.normal(size=off.shape).astype(np.float32)
    step = 1e-3
    ahead, behind = (lit_error(off + turn * step * along, shown, cosine).logarithm for turn in (1, -1))
    assert float((error.slopes(off) * along).sum()) == pytest.approx((ahead - behind) / (2 * step), rel=2e-2)
    rows = np.einsum("nc->n", along)[:, None]
    brightness = np.square(along[error.groups].mean((1, 2)))
    expected = float((brightness / (np.square(error.brightness) + error.scale)).mean())
    assert float(error.curvature(rows)[0, 0]) == pytest.approx(expected, rel=1e-4)
