"""Measures of films: ColorVideoVDP and its import, the exposure of a film, flicker of what is displayed."""

from __future__ import annotations

import importlib.machinery
import importlib.util
import logging
import re
import sys
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from numpy.typing import NDArray

from mipbake.base.errors import UsageError
from mipbake.quality.metrics import (
    check_color_video_vdp,
    color_video_vdp,
    displayed,
    film_exposure,
    srgb_encode,
)
from mipbake.quality.metrics import cvvdp_package as door

ROOT = Path(__file__).resolve().parent.parent
Film = NDArray[np.float32]


def needs_cvvdp(test):
    installed = importlib.util.find_spec("pycvvdp") is not None
    reason = "cvvdp is not installed (the extra `films`)"
    return pytest.mark.films(pytest.mark.skipif(not installed, reason=reason)(test))


def moving(frames: int = 8, height: int = 48, width: int = 64) -> Film:
    """(T, H, W, 3) displayed film: waves of three directions that move by a third of a pixel a frame."""
    t, y, x = np.ogrid[:frames, :height, :width]
    x = x + t / 3
    waves = [np.sin(1.1 * x), np.sin(0.8 * y + 0.4 * x), np.sin(0.5 * x - 0.7 * y)]
    return np.stack([0.5 + 0.25 * (waves[i] + 0.5 * waves[i - 1]) for i in range(3)], -1).astype(np.float32)


def blurred(film: Film, share: float) -> Film:
    """Each pixel mixed with the four pixels that lie two pixels beside it."""
    around = sum(np.roll(film, step, axis) for axis in (1, 2) for step in (-2, 2)) / 4
    return ((1 - share) * film + share * around).astype(np.float32)


@needs_cvvdp
@pytest.mark.parametrize("ppd", [37.0, 75.0])
def test_a_film_has_the_quality_that_cvvdp_gives_it(ppd, caplog, capfd, tmp_path, monkeypatch):
    """The package is called as its own page says, on frames in the order that it likes best."""
    package, reference = door.cvvdp_package(), moving()
    candidate = blurred(reference, 0.5)
    metric = package.cvvdp(
        display_name="standard_fhd",
        display_geometry=package.vvdp_display_geometry((3840, 2160), ppd=ppd),
        device=torch.device("cpu"),
        quiet=True,
    )
    frames = [torch.tensor(film).permute(3, 0, 1, 2)[None] for film in (candidate, reference)]
    expected, _ = metric.predict(*frames, dim_order="BCFHW", frames_per_second=30)
    # However it lies in memory, and whatever another model's folder says.
    for name in ("cvvdp_parameters", "display_models", "color_spaces", "csf_lut_weber_fixed_size"):
        (tmp_path / f"{name}.json").write_text("{}")
    monkeypatch.setenv("CVVDP_PATH", str(tmp_path))
    reference.flags.writeable = False
    found = color_video_vdp(np.asfortranarray(candidate), reference, ppd, 30)
    assert found == pytest.approx(float(expected), abs=1e-5)
    assert color_video_vdp(candidate, reference.astype(np.float64), ppd, 30) == found
    # The package warns of dark films, and sets up the root logger of the program for it.
    dark = np.float32(0.02) * moving()
    capfd.readouterr()
    with caplog.at_level(logging.DEBUG):
        color_video_vdp(blurred(dark, 0.5), dark, ppd, 30)
    assert [record for record in caplog.records if record.levelno >= logging.WARNING] == []
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize(
    ("candidate", "reference", "ppd", "fps", "message"),
    [
        (moving(), moving(7), 37, 30, r"candidate has shape \(8, 48, 64, 3\) and reference \(7, 48, 64, 3\)"),
        (moving()[0], moving()[0], 37, 30, r"shape \(48, 64, 3\): expected \(T, H, W, 3\), at least 2 frames"),
        (moving(2, 7), moving(2, 7), 37, 30, r"at least 2 frames of 8 pixels a side"),
        (moving() + 1, moving(), 37, 30, r"candidate has .* outside \[0, 1\]"),
        (moving(), moving() * np.nan, 37, 30, r"reference has .* not finite"),
        ((moving() * 255).astype(np.uint8), moving(), 37, 30, r"candidate is uint8: expected a floating-point array"),
        (moving(), moving(), 0, 30, r"pixels_per_degree is 0: expected a number above 0"),
        (moving(), moving(), 37, float("nan"), r"frames_per_second is nan: expected a number above 0"),
    ],
)
def test_films_that_do_not_fit(candidate: Film, reference: Film, ppd: float, fps: float, message: str) -> None:
    """They are refused before the package is asked for."""
    with pytest.raises(UsageError, match=message):
        color_video_vdp(candidate, reference, ppd, fps)


# The import of cvvdp


@pytest.fixture
def unknown() -> Iterator[None]:
    """The package has not been imported yet, and is forgotten afterwards."""
    importlib.reload(door)
    yield
    importlib.reload(door)


class Missing:
    """A finder for which some packages are not installed."""

    def __init__(self, *names: str) -> None:
        self._names = names

    def find_spec(self, name: str, path: object = None, target: object = None) -> None:
        if name.partition(".")[0] in self._names:
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)


def test_without_cvvdp_a_sentence_says_what_to_type(unknown: None, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "meta_path", [Missing("pycvvdp"), *sys.meta_path])
    typed = r'python -m pip install "mipbake\[films\]" && python -m pip install --no-deps cvvdp==([\d.]+)'
    with pytest.raises(
        UsageError, match=rf"ColorVideoVDP, which is not installed \(.*pycvvdp.*\): type '{typed}'"
    ) as e:
        color_video_vdp(moving(), moving(), 37, 30)
    with pytest.raises(UsageError, match="ColorVideoVDP, which is not installed"):
        check_color_video_vdp()
    pinned = re.search(r"^cvvdp==(.*)$", (ROOT / "constraints.txt").read_text(encoding="utf-8"), re.M)
    version = re.search(typed, str(e.value))
    assert pinned and version and version[1] == pinned[1]


def package_of(folder: Path, **files: str) -> None:
    """A package named pycvvdp that imports what cvvdp imports, in the ways in which it does."""
    package = folder / "pycvvdp"
    package.mkdir(parents=True)
    lines = {
        "__init__": "from pycvvdp.metric import GaussianBlur, MLP, helper",
        "metric": "import os, sys\n"
        "from torchvision.transforms import GaussianBlur\n"
        "from torchvision.ops import MLP\n"
        "import ffmpeg\n"
        "from huggingface_hub import hf_hub_download\n"
        "sys.path.append(os.path.dirname(os.path.abspath(__file__)))\n"
        "from interp import helper\n",
        "interp": "helper = 'its own'",
    }
    for name, text in {**lines, **files}.items():
        (package / f"{name}.py").write_text(text)


@pytest.fixture
def packages(unknown: None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder from which packages are imported first, without torchvision, ffmpeg and huggingface_hub elsewhere."""
    for name in [
        each for each in sys.modules if each.partition(".")[0] in ("torchvision", "ffmpeg", "huggingface_hub")
    ]:
        monkeypatch.delitem(sys.modules, name)
    found = importlib.machinery.PathFinder()

    def find_spec(name: str, path: object = None, target: object = None) -> object:
        if name in ("pycvvdp", "torchvision", "ffmpeg", "huggingface_hub"):
            return found.find_spec(name, [str(tmp_path)]) or Missing(name).find_spec(name)
        return None

    monkeypatch.setattr(sys, "meta_path", [SimpleNamespace(find_spec=find_spec), *sys.meta_path])
    return tmp_path


def test_the_import_leaves_no_trace(packages: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    package_of(packages)
    somebodys = SimpleNamespace(helper="somebody else's")
    monkeypatch.setitem(sys.modules, "interp", somebodys)
    modules, path = dict(sys.modules), list(sys.path)
    package = door.cvvdp_package()
    assert package.GaussianBlur is door.GaussianBlur and package.helper == "its own"
    assert sys.modules == modules and sys.path == path
    assert door.cvvdp_package() is package
    with pytest.raises(NotImplementedError, match="ColorVideoVDP alone"):
        package.MLP(3)


def test_a_real_torchvision_is_put_aside_and_can_be_imported_later(packages: Path) -> None:
    package_of(packages)
    assert door.cvvdp_package().GaussianBlur is door.GaussianBlur
    real = packages / "torchvision"
    real.mkdir()
    (real / "__init__.py").write_text("from torchvision import ops, transforms")
    (real / "transforms.py").write_text("class GaussianBlur: pass")
    (real / "ops.py").write_text("MLP = None")
    importlib.invalidate_caches()
    try:
        torchvision = importlib.import_module("torchvision")
        assert torchvision.transforms.GaussianBlur is not door.GaussianBlur
        importlib.reload(door)
        assert door.cvvdp_package().GaussianBlur is door.GaussianBlur
        assert sys.modules["torchvision"] is torchvision
    finally:
        for name in ("torchvision", "torchvision.transforms", "torchvision.ops"):
            sys.modules.pop(name, None)


def test_what_else_is_missing_is_named_and_leaves_no_trace(packages: Path) -> None:
    package_of(packages, interp="import einops_of_nobody")
    modules, path = dict(sys.modules), list(sys.path)
    with pytest.raises(UsageError, match=r"not installed \(No module named 'einops_of_nobody'\): type"):
        door.cvvdp_package()
    assert sys.modules == modules and sys.path == path


def test_the_blur_follows_the_formula() -> None:
    """A sum over all taps of a two-dimensional Gaussian, with borders mirrored about the edge pixels' centres."""
    image, size, sigma = np.random.default_rng(0).random((2, 20, 17)), 13, 3.0
    offsets = np.arange(size) - size // 2
    weights = np.exp(-(offsets[:, None] ** 2 + offsets[None, :] ** 2) / (2 * sigma**2))
    weights /= weights.sum()
    padded = np.pad(image, [(0, 0), (size // 2,) * 2, (size // 2,) * 2], mode="reflect")
    windows = np.lib.stride_tricks.sliding_window_view(padded, (size, size), (1, 2))
    expected = np.einsum("nijyx,yx->nij", windows, weights)
    blur = door.GaussianBlur(size, sigma)
    assert blur.forward(torch.from_numpy(image)[:, None]).numpy()[:, 0] == pytest.approx(expected, abs=1e-12)
    in_single = blur.forward(torch.from_numpy(image.astype(np.float32))[:, None]).numpy()[:, 0]
    assert in_single == pytest.approx(expected, abs=2e-6)


# The exposure of a film


def test_the_median_of_what_is_covered_and_not_black_is_displayed_at_0_375() -> None:
    rng = np.random.default_rng(0)
    film = np.exp(rng.normal(0, 1.5, (3, 21, 21, 3))).astype(np.float32)  # an odd number of values: one is the median
    exposure = film_exposure(film)
    assert exposure == pytest.approx(0.6 / np.median(film), rel=1e-6)
    assert np.median(displayed(film * exposure)) == pytest.approx(srgb_encode(np.array(0.375)), abs=1e-6)
    few = np.zeros((2, 1, 3, 3))
    few[:, 0, 0], few[:, 0, 1] = [1, 2, 30], [4, 5, 60]
    few[1] *= 10
    mask = np.zeros((2, 1, 3), bool)
    mask[:, :, :2] = True
    # 1 2 4 5 10 20 30 40 50 60 300 600: the median lies between 20 and 30
    assert film_exposure(few, mask) == pytest.approx(0.6 / 25)
    black = np.zeros((1, 4, 4, 3))
    black[0, 0], black[0, 3] = 2, -0.5  # what a filter's lobes undershot
    assert film_exposure(black) == pytest.approx(0.3)


def test_films_that_have_no_exposure() -> None:
    film = np.ones((2, 3, 3, 3))
    with pytest.raises(UsageError, match="reference has no light"):
        film_exposure(0 * film)
    with pytest.raises(UsageError, match="reference has no light"):
        film_exposure(film, np.zeros((2, 3, 3), bool))
    with pytest.raises(UsageError, match=r"reference has .* not finite"):
        film_exposure(film * np.array([1, 1, np.inf]))
