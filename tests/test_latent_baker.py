"""Baking with latent networks in the native core: what torch says, for every model that is read and made."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from mipbake.base.errors import UsageError
from mipbake.material import MODELS, convert
from mipbake.material.aim import DEFAULT_SAMPLER
from mipbake.material.pixel_filter import Wrap, level_sizes
from mipbake.models.latent_baker import LatentBaker
from mipbake.models.latent_config import LATENT_FILTERS, LatentConfig
from mipbake.models.latent_inference import bake_levels
from mipbake.models.latent_network import LatentNetwork
from mipbake.models.registry import list_weights, load_baker, load_network

from .baked_levels import off
from .moment_cases import TORUS, bumpy, of_model

torch.set_num_threads(1)

EVERY = tuple(MODELS)
SMALL = LatentConfig(EVERY, EVERY, latent_channels=40, encoder_layers=2, decoder_layers=2, growth=5)
RELEASED = [info for info in list_weights() if isinstance(info.network, LatentConfig)]


def trained_like(config: LatentConfig = SMALL) -> LatentNetwork:
    """Every unit has its say, and whitening changes its input."""
    torch.manual_seed(5)
    network = LatentNetwork(config)
    rng = np.random.default_rng(5)
    with torch.no_grad():
        for model in config.models:
            whitening = network.whitening_of(model)
            samples = rng.normal(0.3, 0.5, (500, len(whitening.mean))) @ rng.normal(size=(len(whitening.mean),) * 2)
            whitening.fit(torch.from_numpy(samples))
        for model in config.decoders:
            network.decoder_of(model).output.weight.normal_(0, 0.3)
    return network.eval().requires_grad_(False)


def baker_of(network: LatentNetwork) -> LatentBaker:
    return LatentBaker.of(network.config, (), {name: each.numpy() for name, each in network.state_dict().items()})


def stored_of(model: str, height: int, width: int) -> np.ndarray:
    """Stretched lobes of a model that stores directions come from one that stores tensors."""
    if MODELS[model].lines is None:
        return of_model(model, height, width)
    return convert(of_model("ggx", height, width), "ggx", model).astype(np.float32)


@pytest.mark.parametrize("read", EVERY)
@pytest.mark.parametrize("made", EVERY)
def test_torch_says_the_same_of_every_model(read: str, made: str) -> None:
    network, stored = trained_like(), stored_of(read, 21, 34)
    theirs = bake_levels(network, stored, ("clamp", "wrap"), source=read, target=made)
    difference = off(made, baker_of(network).levels(stored, read, made, ("clamp", "wrap")), theirs)
    assert np.quantile(difference, 0.999) < 2e-3
    assert np.quantile(difference, 0.99) < 5e-5


@pytest.mark.parametrize("latent_filter", LATENT_FILTERS)
@pytest.mark.parametrize(
    ("height", "width", "wrap"), [(1, 1, TORUS), (17, 1, ("clamp", "clamp")), (5, 150, ("wrap", "clamp"))]
)
def test_torch_says_the_same_of_every_size(height: int, width: int, wrap: Wrap, latent_filter: str) -> None:
    network = trained_like(LatentConfig(("ggx",), ("ggx",), latent_filter, 16, 3, 1, 4))
    stored = of_model("ggx", height, width)
    ours = baker_of(network).levels(stored, "ggx", "ggx", wrap)
    assert [level.shape[:2] for level in ours] == level_sizes(height, width)
    assert off("ggx", ours, bake_levels(network, stored, wrap)).max() < 5e-4


@pytest.mark.parametrize("info", RELEASED, ids=lambda info: info.name)
def test_released_weights_bake_what_torch_bakes(info) -> None:  # type: ignore[no-untyped-def]
    baker, network = load_baker(info), load_network(info)
    assert isinstance(baker, LatentBaker)
    for read in info.network.encoders:
        for made in info.network.decoders:
            stored = of_model(read, 48, 40)
            theirs = bake_levels(network, stored, TORUS, source=read, target=made)
            difference = off(made, baker.levels(stored, read, made, TORUS), theirs)
            assert np.quantile(difference, 0.999) < 1e-4
            assert np.quantile(difference, 0.99) < 2e-5


def test_another_pixel_filter_is_refused() -> None:
    (info,) = (info for info in RELEASED if info.name == "paper-ggx")
    with pytest.raises(UsageError, match="trained for the pixel filter gaussian"):
        load_baker(info).bake(bumpy(4, 4), "gltf", "ggx", "box", TORUS, lambda _: None, DEFAULT_SAMPLER)


def test_tensors_that_do_not_fit_are_found_before_a_bake() -> None:
    baker = baker_of(trained_like())
    tensors = dict(baker.tensors)
    tensors["encoders.ggx.layers.1.weight"] = tensors["encoders.ggx.layers.1.weight"][:, :-1]
    with pytest.raises(ValueError, match="do not fit"):
        LatentBaker.of(SMALL, (), tensors)
