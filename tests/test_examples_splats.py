"""The examples of splats and of a volume at a tiny size improve, print a table, and leave picture and figures."""

import numpy as np
import pytest
import torch

from .example_scripts import EXAMPLES, figures, scripts


@pytest.fixture
def load():
    with scripts(EXAMPLES / "stochastic") as imported:
        yield imported


def test_splats(load, tmp_path):
    splats = load("splats")
    sizes = {"splats": 400, "first_splats": 200, "side": 64, "first_side": 32, "views": 16, "stages": 4, "steps": 60}
    options = [word for name, value in sizes.items() for word in (f"--{name.replace('_', '-')}", str(value))]
    splats.main(["--output", str(tmp_path), *options])
    found = figures(tmp_path, "splats")
    counts, sides, _, psnr = zip(*found["hierarchy"], strict=True)
    assert counts == (200, 283, 400, 400) and sides == (32, 32, 64, 64)
    fit = splats.Fit(splats.Settings(**sizes))
    assert psnr[-1] > fit.psnr(splats.start(200, np.random.default_rng(0))) + 1
    assert len(found["flat"]) == 4 and found["flat"][-1][:2] == [400, 64]
    assert len(found["table"]) == 5


def test_divided_splats_keep_what_matters(load):
    splats = load("splats")
    generator = np.random.default_rng(0)
    values = splats.start(50, generator)
    values[:, 13], values[:10, 13], values[20, 3] = 0.5, 0.01, np.log(0.3)
    credit = np.full(50, 1e-3, np.float32)
    credit[20], credit[30:35] = 1000, 0
    found = splats.divided(values, credit, 60, generator)
    assert len(found) == 60
    assert not (found[:, None, 13] == values[:10, 13]).any()  # faint ones are gone
    parts = found[np.isclose(found[:, 11], values[20, 11]) & np.isclose(found[:, 12], values[20, 12])]
    assert len(parts) > 20  # nearly all new ones are parts of the one that pictures need
    assert np.allclose(parts[:, 0:3].mean(0), values[20, 0:3], atol=1e-5)
    assert np.ptp(parts[:, 0]) > 0.3 and (parts[:, 3] < values[20, 3] - 2).all()  # in a row along its longest axis


def test_a_splat_lands_where_the_camera_projects_it(load):
    """The distribution of points of a Gaussian in space, projected, has the mean and covariance that are drawn."""
    splats = load("splats")
    values = splats.start(1, np.random.default_rng(0))
    values[0] = [0.2, -0.3, 0.1, *np.log([0.05, 0.02, 0.03]), 0.9, 0.2, -0.3, 0.1, 1, 1, 1, 0.6]
    view = splats.rotations(np.float32([[0.5, -0.1, 0.7, 0.4]]))[0]
    side = 96
    image = splats.render(values, view, side, 0)[0].reshape(side, side, 3)[..., 0].astype(np.float64)
    normal = np.random.default_rng(1).normal(size=(200_000, 3))
    axes = splats.rotations(values[:, 6:10])[0] * np.exp(values[0, 3:6])
    eye = (values[0, :3] + normal @ axes.T) @ view.T
    points = side / (2 * splats.SLOPE) * eye[:, :2] / (splats.DISTANCE - eye[:, 2:]) + side / 2
    y, x = np.mgrid[:side, :side] + 0.5
    mean = [(image * each).sum() / image.sum() for each in (x, y)]
    assert np.allclose(mean, points.mean(0), atol=0.05)
    offsets = (x - mean[0], y - mean[1])
    spread = [(image * offsets[i] * offsets[j]).sum() / image.sum() for i, j in ((0, 0), (0, 1), (1, 1))]
    covariance = np.cov(points.T) + splats.BLUR * np.eye(2)
    assert np.allclose(spread, covariance[[0, 0, 1], [0, 1, 1]], rtol=0.06, atol=0.05)


def test_volume(load, tmp_path):
    sizes = ["--voxels", "10", "--side", "16", "--views", "6", "--steps", "40", "--measured", "2"]
    load("volume").main(["--output", str(tmp_path), *sizes])
    found = figures(tmp_path, "volume")
    for way in ("stochastic", "exact"):
        assert found[way][-1][2] > found[way][0][2] + 1, way
    assert found["stochastic"][-1][0] == 40


def test_rays_list_the_voxels_that_they_show(load):
    """A voxel that a pixel does not list, and that is not beside one, does not change the pixel."""
    volume = load("volume")
    voxels, side = 8, 12
    generator = torch.Generator().manual_seed(0)
    view = load("shared").camera.rotation_matrix(torch.tensor([0.9, 0.3, -0.2, 0.1]))
    values = torch.rand(voxels**3, 4, generator=generator)
    image, listed = volume.render(values, view, voxels, side, list_voxels=True)
    shown = torch.zeros(side * side, voxels**3, dtype=torch.bool)
    for pixel, numbers in enumerate(listed):
        shown[pixel, numbers[numbers >= 0].long()] = True
    assert shown.any(1).float().mean() > 0.5
    blocks = shown.float().reshape(-1, 1, voxels, voxels, voxels)
    near = torch.nn.functional.max_pool3d(blocks, 3, 1, 1).reshape(side * side, -1) > 0
    for voxel in range(0, voxels**3, 37):
        changed = values.clone()
        changed[voxel] = 1 - changed[voxel]
        moved = (volume.render(changed, view, voxels, side)[0] - image).abs().amax(1)
        assert (moved[~near[:, voxel]] < 2 * volume.LEAST_SEEN).all()
        assert (moved[shown[:, voxel]] > 0).float().mean() > 0.3 or not shown[:, voxel].any()
