"""What a descent moves texels by: the same as torch's own twin, in value and in gradient, and at every edge."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
import torch

from mipbake.baking.search import texel_coordinates as here
from mipbake.material import FACTS, LEAST_STRENGTH, MIN_ROUGHNESS, MODELS, Facts, Kind, MaterialModel
from mipbake.models import parameters

from .stacks import constant

COUNT = 512


def twin_to_coordinates(stored: torch.Tensor, model: MaterialModel) -> torch.Tensor:
    return torch.cat([parameters.to_coordinates(stored[..., p.channels], p.kind) for p in model.parts], -1)


def twin_to_stored(coordinates: torch.Tensor, model: MaterialModel) -> torch.Tensor:
    parts = [(coordinates[..., p.coordinates], p.kind) for p in model.parts]
    return torch.cat([parameters.of_coordinates(*part, model.least_alpha2) for part in parts], -1)


def agree(coordinates: np.ndarray, model: MaterialModel, seed: int = 0) -> None:
    """Values and gradients of the twin, for random gradients by stored channels."""
    leaf = torch.from_numpy(coordinates).requires_grad_()
    stored = twin_to_stored(leaf, model)
    np.testing.assert_allclose(here.to_stored(coordinates, model.name), stored.detach().numpy(), rtol=0, atol=1e-10)
    gradient = np.random.default_rng(seed).standard_normal(stored.shape)
    (wanted,) = torch.autograd.grad(stored, leaf, torch.from_numpy(gradient))
    found = here.stored_adjoint(coordinates, gradient, model.name)
    assert found.dtype == coordinates.dtype
    np.testing.assert_allclose(found, wanted.numpy(), rtol=1e-10, atol=1e-10)


def random_coordinates(model: MaterialModel, scale: float) -> np.ndarray:
    """(COUNT, P) around the coordinates of a usual material."""
    usual = here.to_coordinates(constant((1,), model.name).astype(float), model.name)
    return usual + scale * np.random.default_rng(1).standard_normal((COUNT, usual.shape[-1]))


def ends_of(facts: Facts) -> list[float]:
    """Numbers at the ends of what a coordinate of some kind may be, and a little beyond on both sides."""
    ends = [end for end in facts.range if np.isfinite(end)] or [-1.0, 0.0, 1.0]
    return [end + beside for end in ends for beside in (-1e-3, 0.0, 1e-3)]


@pytest.mark.parametrize("model", MODELS.values(), ids=MODELS)
@pytest.mark.parametrize("scale", [0.01, 0.3, 3.0, 50.0])
def test_random_coordinates_agree_with_the_twin(model: MaterialModel, scale: float) -> None:
    agree(random_coordinates(model, scale), model)


@pytest.mark.parametrize("model", MODELS.values(), ids=MODELS)
def test_coordinates_at_their_limits_agree_with_the_twin(model: MaterialModel) -> None:
    """One map at a time, with every combination of ends of its own coordinates, and gradients of both signs."""
    usual = here.to_coordinates(constant((1,), model.name).astype(float), model.name)
    for part in model.parts:
        size = part.coordinates.stop - part.coordinates.start
        ends = [list(each) for each in itertools.product(ends_of(FACTS[part.kind]), repeat=min(size, 3))]
        cases = np.tile(usual, (len(ends), 1))
        cases[:, part.coordinates.start : part.coordinates.start + len(ends[0])] = ends
        if part.kind is Kind.DIRECTION:
            cases = cases[np.abs(cases[:, part.coordinates]).max(-1) > 0]  # the twin has no gradient without a length
        for seed in range(3):
            agree(cases, model, seed)


@pytest.mark.parametrize("model", MODELS.values(), ids=MODELS)
def test_normals_at_the_horizon_agree_with_the_twin(model: MaterialModel) -> None:
    (part,) = [each for each in model.parts if each.kind in (Kind.NORMAL, Kind.NORMAL_XY)]
    turns = np.linspace(0, 2 * np.pi, 9)[:-1]
    lengths = np.array([0, 1e-9, 0.9, 0.9999, 1 - 1e-9, 1 + 1e-9, 1.0001, 1.5, 40])
    xy = lengths[:, None, None] * np.stack([np.cos(turns), np.sin(turns)], -1)
    cases = np.repeat(random_coordinates(model, 0.0)[:1], xy[..., 0].size, 0)
    cases[:, part.coordinates] = xy.reshape(-1, 2)
    agree(cases, model)


@pytest.mark.parametrize("model", [each for each in MODELS.values() if each.of(Kind.LOG_TENSOR)], ids=lambda m: m.name)
def test_round_lobes_of_tensors_agree_with_the_twin(model: MaterialModel) -> None:
    """Where both eigenvalues are the same, in the middle and at both ends."""
    (part,) = [each for each in model.parts if each.kind is Kind.LOG_TENSOR]
    least = np.log(model.least_alpha2)
    tensors = [
        (mean + d, mean - d, c) for mean in (least - 1, least, -3.0, 2.0, 3.0) for d in (0, 1e-7, 1) for c in (0, 1e-5)
    ]
    cases = np.repeat(random_coordinates(model, 0.0)[:1], len(tensors), 0)
    cases[:, part.coordinates] = tensors
    agree(cases, model)


@pytest.mark.parametrize("model", MODELS.values(), ids=MODELS)
def test_coordinates_of_stored_channels_agree_with_the_twin(model: MaterialModel) -> None:
    """Rough and smooth to the limits, with and without anisotropy."""
    stored = here.to_stored(random_coordinates(model, 3.0), model.name)
    for kind, values in ((Kind.ROUGHNESS, (0, MIN_ROUGHNESS, 1)), (Kind.STRENGTH, (0, LEAST_STRENGTH, 1))):
        for channels in model.of(kind):
            stored[:3, channels] = np.array(values)[:, None]
    found, wanted = here.to_coordinates(stored, model.name), twin_to_coordinates(torch.from_numpy(stored), model)
    np.testing.assert_allclose(found, wanted.numpy(), rtol=0, atol=1e-10)
    np.testing.assert_allclose(here.to_coordinates(here.to_stored(found, model.name), model.name), found, atol=1e-10)


def test_a_direction_without_a_length_has_a_finite_gradient() -> None:
    coordinates = random_coordinates(MODELS["gltf-anisotropic"], 0.0)[:1]
    (part,) = [each for each in MODELS["gltf-anisotropic"].parts if each.kind is Kind.DIRECTION]
    coordinates[:, part.coordinates] = 0
    gradient = here.stored_adjoint(coordinates, np.ones((1, MODELS["gltf-anisotropic"].channels)), "gltf-anisotropic")
    assert np.isfinite(gradient).all()
