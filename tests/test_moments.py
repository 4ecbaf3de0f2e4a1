"""Moments of texels, and what statistics of their averages say."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import torch

from mipbake.baking.rules.lean import Lean
from mipbake.material import MODELS, Kind, MaterialModel, convert, model_named
from mipbake.material.pixel_filter import filtered_levels
from mipbake.models.channels import count, parts
from mipbake.models.corrections import Outputs
from mipbake.models.moment_statistics import Statistics, feature_count
from mipbake.models.moments import Moments, moment_count, moment_places
from mipbake.models.moments import moments as moments_of

from .moment_cases import SMALL, TORUS, bumpy, of_model

GLTF, GGX = MODELS["gltf"], MODELS["ggx"]


def moments(stored: torch.Tensor) -> torch.Tensor:
    return moments_of(stored, GLTF)


def statistics(means: torch.Tensor) -> Statistics:
    return Statistics(means, GLTF)


def test_statistics_are_those_of_closed_forms() -> None:
    """`lean` and `unreal` follow from the same averages."""
    stored = bumpy(16, 16, 4)
    stored[..., 5:7] *= 0.5
    stored[..., 7] = np.sqrt(1 - np.square(stored[..., 5:7]).sum(-1))
    means = filtered_levels(moments(torch.from_numpy(stored)).numpy(), "gaussian", TORUS)
    lean = Lean()(stored, "gltf", "gltf", "gaussian", TORUS, lambda _: None).levels
    for level, mean in enumerate(means):
        found = statistics(torch.from_numpy(mean))
        roughness = (found.log_roughness + found.to_lean).exp().numpy()[..., 0]
        np.testing.assert_allclose(roughness, lean[level][..., 4], rtol=2e-4)
        normal = (found.normal + found.lean_normal).numpy()
        np.testing.assert_allclose(normal, lean[level][..., 5:7], atol=1e-5)
        alpha2, v = np.exp(4 * found.log_roughness.numpy()), 1 / np.sqrt(1 - found.spread.numpy()) - 1
        widened = (alpha2 + 2 * v * (1 - alpha2)) / (1 + 2 * v)  # what the released weights were trained with
        np.testing.assert_allclose(np.exp(4 * (found.log_roughness + found.to_widened).numpy()), widened, rtol=1e-4)
        assert found.features().shape[-1] == feature_count(GLTF)
        assert found.freedom.min() >= 0 and found.freedom.max() < 1


def test_statistics_of_stretched_lobes_are_those_of_lean() -> None:
    stored = of_model("ggx", 16, 16, 4)
    stored[..., 6:8] *= 0.5
    means = filtered_levels(moments_of(torch.from_numpy(stored), GGX).numpy(), "gaussian", TORUS)
    lean = Lean()(stored, "ggx", "ggx", "gaussian", TORUS, lambda _: None).levels
    for level, mean in enumerate(means):
        found = Statistics(torch.from_numpy(mean), GGX)
        stretch = (found.stretch + found.lean_stretch).numpy()
        middle = 4 * (found.log_roughness + found.to_lean).numpy()
        tensor = np.concatenate([middle + stretch[..., :1], middle - stretch[..., :1], stretch[..., 1:]], -1)
        np.testing.assert_allclose(tensor, lean[level][..., 8:11], atol=2e-3)
        np.testing.assert_allclose((found.normal + found.lean_normal).numpy(), lean[level][..., 6:8], atol=1e-5)


def test_round_lobes_have_the_moments_of_gltf() -> None:
    """A tensor without a stretch is no other surface."""
    given = bumpy(8, 8, 2)
    stored = np.asarray(convert(given, "gltf", "ggx"))
    found: Moments[torch.Tensor] = parts(moment_places(GGX), moments_of(torch.from_numpy(stored), GGX))
    expected: Moments[torch.Tensor] = parts(moment_places(GLTF), moments(torch.from_numpy(given)))
    for name, values in vars(expected).items():
        if values.shape[-1] and "metallic" not in name and name != "base":
            torch.testing.assert_close(getattr(found, name), values, rtol=2e-4, atol=1e-6)
    assert not found.stretch.any() and not found.tensor[..., 1:].any()


def test_bright_texels_have_their_reflectance() -> None:
    """Glossy gold in dull plastic: the highlight is golden."""
    stored = np.zeros((16, 16, 11), np.float32)
    stored[..., 3:6], stored[..., 8:10] = 0.04, -1.0
    stored[:8, :, 3:6], stored[:8, :, 8:10] = (1.0, 0.8, 0.3), -8.0
    found = Statistics(moments_of(torch.from_numpy(stored), GGX).mean((0, 1)), GGX)
    for change in (found.tall_specular, found.upward_specular):
        torch.testing.assert_close(found.specular + change, torch.tensor([1.0, 0.8, 0.3]), atol=1e-2, rtol=0)


def test_moments_of_glossy_normals_do_not_cancel() -> None:
    """The spread of normals a thousandth of a degree apart is seen in float32."""
    tilt = 2e-5
    stored = np.zeros((2, 8), np.float32)
    stored[:, 4], stored[:, 5], stored[:, 7] = 0.1, (tilt, -tilt), 1
    found = statistics(moments(torch.from_numpy(stored)).mean(0))
    assert float(found.spread) == pytest.approx(tilt**2, rel=1e-3)
    assert float(found.slopes) == pytest.approx(tilt**2, rel=1e-3)


@pytest.mark.parametrize("model", MODELS.values(), ids=list(MODELS))
def test_every_model_has_the_moments_and_outputs_of_its_maps(model: MaterialModel) -> None:
    read = model_named(*dataclasses.replace(SMALL, decoders=(model.name,)).encoders)
    places = moment_places(read)
    assert moments_of(torch.zeros(1, read.channels), read).shape[-1] == moment_count(read)
    colours = places.base, places.metallic, places.diffuse, places.specular
    assert sum(each.stop - each.start for each in colours) == sum(
        each.facts.channels for each in read.stored if each.kind in (Kind.REFLECTANCE, Kind.SHARE)
    )
    assert (places.stretch.stop > places.stretch.start) == bool(read.of(Kind.LOG_TENSOR))
    assert (places.log_gamma.stop > places.log_gamma.start) == bool(read.of(Kind.LOG_GAMMA))
    assert count(Outputs, read) == count(Outputs, model)


def test_bright_texels_know_the_highlight_between_steep_joints() -> None:
    """Flat gloss with one-sided steep joints: the mean normal is off by more than the highlight is wide."""
    stored = bumpy(32, 32, 7)
    stored[..., 4], stored[..., 5:8] = 0.12, (0.0, 0.0, 1.0)
    stored[:, :6, 5:8] = (0.6, 0.0, 0.8)
    for joints in (0.12, 0.9):
        stored[:, :6, 4] = joints
        found = statistics(moments(torch.from_numpy(stored)).mean((0, 1)))
        alpha = 0.12**2
        assert float(found.normal[0]) > 5 * alpha
        assert abs(float(found.normal[0] + found.upward_normal[0])) < 0.1 * alpha
        np.testing.assert_allclose(float((found.log_roughness + found.to_upward).exp()), 0.12, rtol=0.05)
        assert float((found.log_roughness + found.to_lean).exp()) > 0.4
        if joints > 0.5:  # dull joints are not tall, whatever their normal
            assert abs(float(found.normal[0] + found.tall_normal[0])) < 0.1 * alpha
        assert float(found.to_narrowest) <= 0


def test_kernels_with_negative_lobes_cannot_make_bright_texels_run_away() -> None:
    stored = torch.from_numpy(bumpy(8, 8, 8))
    stored[..., 4] = 0.6
    stored[3, 3, 4] = 0.045  # so much brighter than the rest that a negative weight turns the sum
    weight = torch.full((8, 8, 1), 1.1 / 63)
    weight[3, 3] = -0.1
    found = statistics((moments(stored) * weight).sum((0, 1)))
    assert all(torch.isfinite(value).all() for value in vars(found).values())
    for normal in (found.tall_normal, found.upward_normal):
        assert float(normal.norm()) <= 3.1 * float(found.slopes.sqrt())
    assert float(found.axes.norm()) <= 1.001
