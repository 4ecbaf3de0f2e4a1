"""Measures of images: tonemapped error, FLIP, HDR-FLIP, Delta E ITP, SSIM, false sparkle, and the list of measures."""

from __future__ import annotations

import importlib.util
import subprocess
import sys

import numpy as np
import pytest
from numpy.typing import NDArray

from mipbake.base.errors import UsageError
from mipbake.quality.metrics import MEASURES
from mipbake.quality.metrics.flip import PIXELS_PER_DEGREE, Exposures, hdr_flip, hdr_flip_exposures, ldr_flip
from mipbake.quality.metrics.images import (
    NITS_PER_UNIT,
    Measured,
    delta_e_itp,
    displayed,
    false_sparkle,
    srgb_encode,
    structural_similarity,
    tonemap_slope,
    tonemapped,
    tonemapped_error,
)

from .flip_of_the_paper import flip_of_the_paper

LINEAR = (tonemapped_error, hdr_flip, delta_e_itp)
DISPLAY = (ldr_flip, structural_similarity, false_sparkle)


def picture(seed: int = 0, top: float = 1.0) -> NDArray[np.float32]:
    """Smooth random colours (24, 40, 3) from 0.1 to 0.9 times `top`."""
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[:24, :40] / 40
    waves = [np.sin(2 * np.pi * (f * x + g * y) + h) for f, g, h in rng.uniform(1, 5, (3, 3))]
    return (top * (0.5 + 0.4 * np.stack(waves, -1))).astype(np.float32)


def flat(*colour: float) -> NDArray[np.float64]:
    return np.full((16, 20, 3), colour, np.float64)


def aces(x: NDArray[np.float64]) -> NDArray[np.float64]:
    """Narkowicz's fit, at the 0.6 times exposure that HDR-FLIP uses."""
    x = 0.6 * x
    return x * (2.51 * x + 0.03) / (x * (2.43 * x + 0.59) + 0.14)


@pytest.mark.parametrize("measure", [*LINEAR, *DISPLAY])
def test_identical_images_are_perfect(measure) -> None:
    image = picture()
    measured = measure(image, image.copy())
    perfect = 1 if measure is structural_similarity else 0
    assert measured.mean == pytest.approx(perfect, abs=1e-7)
    assert measured.per_pixel == pytest.approx(np.full((24, 40), perfect), abs=1e-6)
    assert measured.per_pixel.dtype == np.float32


def test_srgb_encoding_at_its_ends_and_its_joint() -> None:
    linear = np.array([-1, 0, 0.0031308, 0.18, 1, 7])
    assert srgb_encode(linear) == pytest.approx([0, 0, 0.0404499, 0.4613561, 1, 1], abs=1e-6)


def test_displays_encode_what_is_tonemapped_and_its_slope_is_a_derivative() -> None:
    radiance = np.geomspace(1e-5, 1e3, 96)
    step = 1e-5 * radiance
    differences = (tonemapped(radiance + step) - tonemapped(radiance - step)) / (2 * step)
    assert tonemap_slope(radiance) == pytest.approx(differences, rel=1e-5)
    assert tonemap_slope(np.array([-1.0, 0.0])) == pytest.approx(1)
    assert displayed(radiance) == pytest.approx(srgb_encode(tonemapped(radiance)))
    for function in (tonemapped, tonemap_slope):
        assert function(radiance.astype(np.float32)).dtype == np.float32


def test_tonemapped_error_by_hand() -> None:
    """1 and 3 tonemap to 1/2 and 3/4, which encode to 0.735357 and 0.880825."""
    candidate, reference = np.ones((2, 3)), np.array([[3.0, 1.0, 1.0], [1.0, 1.0, 1.0]])
    measured = tonemapped_error(candidate, reference)
    assert measured.per_pixel == pytest.approx([0.145468 / 3, 0], abs=1e-6)
    assert measured.mean == pytest.approx(0.145468 / 6, abs=1e-6)


@pytest.mark.parametrize("ppd", [15.0, 30.0, PIXELS_PER_DEGREE])
def test_flip_of_pictures_follows_the_paper(ppd: float) -> None:
    """Every pixel, on waves and on noise: colours, edges and points, at several viewing distances."""
    rng = np.random.default_rng(8)
    for first, second in ((picture(0), picture(1)), tuple(rng.random((2, 24, 40, 3)).astype(np.float32))):
        expected = flip_of_the_paper(first.astype(np.float64), second.astype(np.float64), ppd)
        assert ldr_flip(first, second, ppd).per_pixel == pytest.approx(expected, abs=5e-4)


def test_hdr_flip_is_the_worst_of_flip_over_the_exposures() -> None:
    first, second = (picture(seed, 3).astype(np.float64) for seed in (0, 1))
    maps = [ldr_flip(*(srgb_encode(aces(image * 2**stop)) for image in (first, second))) for stop in (-2, 0, 2)]
    worst = np.maximum.reduce([m.per_pixel for m in maps])
    measured = hdr_flip(first, second, exposures=Exposures(-2, 2, 3))
    assert measured.per_pixel == pytest.approx(worst, abs=2e-4)
    assert len({int(m.per_pixel.argmax()) for m in maps}) > 1 and measured.mean > max(m.mean for m in maps)


@pytest.mark.parametrize("top", [0.01, 1.0, 50.0])
def test_exposures_are_the_ones_that_the_package_finds(top: float) -> None:
    import flip_evaluator

    image = picture(2, top) ** 3
    _, _, found = flip_evaluator.evaluate(image, image, "HDR", applyMagma=False)
    ours = hdr_flip_exposures(image)
    assert (ours.start, ours.stop) == pytest.approx((found["startExposure"], found["stopExposure"]), abs=1e-4)
    assert ours.count == found["numExposures"]


def test_a_black_background_moves_no_exposure() -> None:
    image = picture(4, 5)
    padded = np.concatenate([np.zeros((30, 40, 3), np.float32), image])
    assert hdr_flip_exposures(padded) == hdr_flip_exposures(image)
    assert hdr_flip(padded * np.float32(1.2), padded).mean > 0


def test_what_makes_no_sense_is_said() -> None:
    for wrong in (0, -1, np.nan, np.inf):
        with pytest.raises(UsageError, match="pixels_per_degree"):
            ldr_flip(picture(), picture(), pixels_per_degree=wrong)
    for measure in (hdr_flip, ldr_flip, structural_similarity):
        with pytest.raises(UsageError, match=r"expected \(H, W, 3\)"):
            measure(picture().reshape(-1, 3), picture().reshape(-1, 3))
    with pytest.raises(UsageError, match="at least 11 pixels a side"):
        structural_similarity(picture()[:10], picture()[:10])


def test_a_black_reference_needs_exposures() -> None:
    black, grey = flat(0, 0, 0), flat(0.5, 0.5, 0.5)
    with pytest.raises(UsageError, match=r"black everywhere.*exposures="):
        hdr_flip(grey, black)
    assert hdr_flip(grey, black, exposures=Exposures(0, 1, 2)).mean > 0.5


def test_delta_e_itp_of_the_published_example() -> None:
    """colour-science documents 1.42657228 for these two colours in ICtCp."""
    import colour

    ictcp = np.array([[0.4885468072, -0.04739350675, 0.07475401302], [0.4899203231, -0.04567508203, 0.07361341775]])
    bt2020 = colour.ICtCp_to_RGB(ictcp, method="ITU-R BT.2100-2 PQ")
    spaces = colour.RGB_COLOURSPACES
    bt709 = bt2020 @ colour.matrix_RGB_to_RGB(spaces["ITU-R BT.2020"], spaces["ITU-R BT.709"]).T / NITS_PER_UNIT
    assert bt709.min() > 0
    assert delta_e_itp(bt709[:1], bt709[1:]).mean == pytest.approx(1.42657228, abs=1e-4)


def pq(nits: float) -> float:
    """SMPTE ST 2084's inverse EOTF."""
    y = (nits / 10_000) ** (1305 / 8192)
    return float(((107 / 128 + 2413 / 128 * y) / (1 + 2392 / 128 * y)) ** (2523 / 32))


@pytest.mark.parametrize(("first", "second", "scale"), [(1.0, 1.02, 203.0), (1.0, 1.02, 1000.0), (0.01, 0.5, 80.0)])
def test_delta_e_itp_of_greys_is_that_of_pq(first: float, second: float, scale: float) -> None:
    measured = delta_e_itp(*(flat(*[grey * scale / NITS_PER_UNIT] * 3) for grey in (first, second)))
    assert measured.mean == pytest.approx(720 * (pq(second * scale) - pq(first * scale)), rel=1e-3)
    assert measured.per_pixel.shape == (16, 20)


def test_delta_e_itp_ends_where_pq_ends() -> None:
    assert delta_e_itp(flat(50, 50, 50), flat(5e6, 5e6, 5e6)).mean == pytest.approx(0, abs=1e-2)


def test_ssim_is_scikit_images() -> None:
    from skimage.metrics import structural_similarity as theirs

    first, second = picture(0).astype(np.float64), picture(1).astype(np.float64)
    expected = theirs(
        first, second, data_range=1, channel_axis=-1, gaussian_weights=True, sigma=1.5, use_sample_covariance=False
    )
    measured = structural_similarity(second, first)
    assert measured.mean == pytest.approx(expected, abs=1e-9)
    assert measured.per_pixel[5:-5, 5:-5].mean() == pytest.approx(expected, abs=1e-5)
    assert structural_similarity(first, second).mean == pytest.approx(expected, abs=1e-9)


def test_a_mask_keeps_the_background_out_of_the_mean() -> None:
    candidate, reference = np.zeros((2, 3, 3)), np.zeros((2, 3, 3))
    candidate[0, 0] = 1
    measured = tonemapped_error(candidate, reference)
    mask = np.zeros((2, 3), bool)
    mask[0, :2] = True
    assert measured.mean_over(mask) == pytest.approx(3 * measured.mean, rel=1e-6)


@pytest.mark.parametrize("measure", [*LINEAR, *DISPLAY])
def test_images_that_do_not_fit(measure) -> None:
    image = picture()
    with pytest.raises(UsageError, match=r"candidate has shape \(24, 39, 3\) and reference \(24, 40, 3\)"):
        measure(image[:, 1:], image)
    with pytest.raises(UsageError, match=r"candidate has shape \(24, 40, 2\): expected \(..., 3\) colours"):
        measure(image[..., :2], image[..., :2])
    with pytest.raises(UsageError, match="candidate is uint8: expected a floating-point array"):
        measure((image * 255).astype(np.uint8), image)


@pytest.mark.parametrize("measure", [*LINEAR, *DISPLAY])
def test_values_that_are_not_finite(measure) -> None:
    image, broken = picture(), picture()
    broken[3, 5, 1] = np.nan
    with pytest.raises(
        UsageError, match=r"reference has 1 value that is not finite, the first .* at index \(3, 5, 1\)"
    ):
        measure(image, broken)


@pytest.mark.parametrize("measure", LINEAR)
def test_negative_radiance(measure) -> None:
    image, broken = picture(), picture()
    broken[2, :2, 0] = -0.25
    with pytest.raises(
        UsageError, match=r"candidate has 2 values that are negative, the first -0.25 at index \(2, 0, 0\)"
    ):
        measure(broken, image)


@pytest.mark.parametrize("measure", DISPLAY)
def test_display_values_beyond_white(measure) -> None:
    with pytest.raises(UsageError, match=r"candidate has .* outside \[0, 1\].*srgb_encode"):
        measure(picture(top=2), picture())


def test_read_only_and_strided_images_give_the_same() -> None:
    first, second = picture(0), picture(1)
    for image in (first, second):
        image.flags.writeable = False
    for measure in (*LINEAR, *DISPLAY):
        figure = measure(first, second)
        assert measure(first[:, ::-1][:, ::-1], np.asfortranarray(second)).mean == pytest.approx(figure.mean, abs=1e-6)


@pytest.mark.parametrize("name", MEASURES)
def test_the_list_of_measures_calls_each_as_it_says(name: str) -> None:
    measure = MEASURES[name]
    if measure.needs == "film" and importlib.util.find_spec("pycvvdp") is None:
        pytest.skip("cvvdp is not installed (the extra `films`)")
    reference = picture(0)
    if measure.needs in ("estimates", "frames", "film"):
        reference = np.stack([reference, picture(1)])
    right = reference.copy()
    wrong = 1 - 0.5 * reference  # too bright where the reference is dark, and its change is half as large
    given = [reference, reference] if measure.needs in ("estimates", "frames") else [reference]
    figures = []
    for candidate in (right, wrong):
        figure = measure.function(candidate, *given, *([30.0] if measure.needs == "film" else []))
        figures.append(figure.mean if isinstance(figure, Measured) else figure)
    assert measure.loss(figures[0]) < measure.loss(figures[1]) < measure.loss(float("nan"))
    assert measure.name == name and measure.title
    if measure.direction == "one":  # too much and too little are as bad
        assert measure.loss(2.0) == pytest.approx(measure.loss(0.5)) and measure.loss(1.0) == 0 < measure.loss(1.1)


@pytest.mark.long
def test_colour_science_leaves_in_silence() -> None:
    lines = (
        "import OpenImageIO, torch",
        "from mipbake.base.colour_science import colour_science",
        'colour_science("a test")',
    )
    done = subprocess.run([sys.executable, "-c", "; ".join(lines)], capture_output=True, text=True, check=True)
    assert done.stdout == done.stderr == ""


def test_false_sparkle_by_hand() -> None:
    """What is 0.1 above the reference or less counts nothing, and nothing darker does; channels count by themselves."""
    reference = np.full((1, 2, 2, 3), 0.3)
    candidate = reference.copy()
    candidate[0, 0, 0] = [0.9, 0.35, 0.1]  # 0.5 too much, forgiven, darker
    candidate[0, 1, 1] = [0.4, 0.5, 0.0]  # just forgiven, 0.1 too much, darker
    measured = false_sparkle(candidate, reference)
    assert measured.per_pixel == pytest.approx(np.array([[[0.5 / 3, 0], [0, 0.1 / 3]]]), abs=1e-7)
    assert measured.mean == pytest.approx(0.6 / 12)
    assert false_sparkle(reference, candidate).mean == pytest.approx((0.1 + 0.2) / 12)
