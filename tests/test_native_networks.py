"""Networks in the native core bake what torch bakes, whatever the model, the size, the threads and the processor."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import torch

from mipbake import _native
from mipbake.material import MODELS, convert
from mipbake.material.aim import SAMPLERS, Sampler
from mipbake.material.pixel_filter import FILTERS, Wrap, level_sizes
from mipbake.models.latent_baker import LatentBaker
from mipbake.models.latent_config import LatentConfig
from mipbake.models.latent_inference import bake_levels as latent_levels
from mipbake.models.latent_network import LatentNetwork
from mipbake.models.level_filter import Lookup
from mipbake.models.moment_baker import MomentBaker
from mipbake.models.moment_config import MADE, MomentConfig
from mipbake.models.moment_inference import bake_levels as moment_levels
from mipbake.models.moment_network import MomentNetwork
from mipbake.models.registry import list_weights, load_baker, load_network

from .baked_levels import off
from .moment_cases import ANISOTROPIC, TORUS, bumpy, config_of, of_model, trained_like

MOMENTS, LATENT = (
    [info for info in list_weights() if isinstance(info.network, config)] for config in (MomentConfig, LatentConfig)
)


def moments_of(network: MomentNetwork) -> MomentBaker:
    return MomentBaker(network.config, (), {name: each.numpy() for name, each in network.state_dict().items()})


def latent_of(network: LatentNetwork) -> LatentBaker:
    return LatentBaker(network.config, (), {name: each.numpy() for name, each in network.state_dict().items()})


@pytest.mark.long
@pytest.mark.parametrize("made", MADE)
@pytest.mark.parametrize(
    ("height", "width", "wrap"),
    [(40, 25, ("clamp", "wrap")), (16, 1, TORUS), (33, 130, ("wrap", "clamp")), (1, 1, TORUS)],
)
@pytest.mark.parametrize("pixel_filter", ["gaussian", "box", "mitchell"])
def test_torch_says_the_same(made: str, height: int, width: int, wrap: Wrap, pixel_filter: str) -> None:
    network = trained_like(config_of(made))
    stored = of_model(network.config.encoders[0], height, width)
    ours = moments_of(network).bake(stored, network.config.encoders[0], made, pixel_filter, wrap)
    theirs = moment_levels(network, stored, Lookup(pixel_filter), wrap)
    assert [level.shape[:2] for level in ours] == level_sizes(height, width)
    difference = off(made, ours, theirs)
    # White noise in float32, through a network whose weights are drawn at random: rounding is amplified. Where lobes
    # are lines, a texel beside a cut may be taken for another side of it.
    assert np.quantile(difference, 0.999) < 3e-3
    assert np.quantile(difference, 0.99) < 1e-4


@pytest.mark.long
@pytest.mark.parametrize("info", MOMENTS, ids=lambda info: info.name)
@pytest.mark.parametrize("pixel_filter", FILTERS)
def test_released_weights_of_moments_bake_what_torch_bakes(info, pixel_filter: str) -> None:
    sampler = [*SAMPLERS.values(), Sampler(4, -1.0, 8)][list(FILTERS).index(pixel_filter) % 4]
    (read,), (made,) = info.network.encoders, info.network.decoders
    stored = of_model(read, 48, 40) if read != "gltf" else bumpy(48, 40)
    lookup = Lookup(pixel_filter, info.network.taken(sampler))
    theirs = moment_levels(load_network(info), stored, lookup, ("clamp", "wrap"))
    baker = load_baker(info)
    assert isinstance(baker, MomentBaker)
    difference = off(made, baker.levels(stored, read, made, lookup, ("clamp", "wrap")), theirs)
    assert difference.max() < 3e-3
    assert np.quantile(difference, 0.99) < 1e-4


@pytest.mark.parametrize("config", [config_of("gltf"), ANISOTROPIC], ids=["round", "anisotropic"])
def test_threads_do_not_show(config: MomentConfig) -> None:
    baker, stored, (made,) = moments_of(trained_like(config)), bumpy(70, 300), config.decoders
    before, found = _native.num_threads(), []
    try:
        for threads in (1, 2, 5):
            _native.set_num_threads(threads)
            found.append(baker.bake(stored, "gltf", made, "gaussian", ("clamp", "wrap")))
    finally:
        _native.set_num_threads(before)
    for others in found[1:]:
        for level, other in zip(found[0], others, strict=True):
            np.testing.assert_array_equal(level, other)


SCRIPT = """
import sys
import numpy as np
sys.modules["torch"] = None  # importing it fails
from mipbake import _native
from mipbake.models.registry import find_weights, load_baker
stored = np.load(sys.argv[1])
levels = load_baker(find_weights("mipbake-3")).bake(stored, "gltf", "gltf", "gaussian", ("wrap", "clamp"))
np.savez(sys.argv[2], *levels)
print(_native.isa())
"""


@pytest.mark.parametrize("isa", ["baseline", "avx2", "avx512"])
def test_every_instruction_set_bakes_alike_and_without_torch(isa: str, tmp_path: Path) -> None:
    stored = bumpy(37, 101)
    np.save(tmp_path / "stored.npy", stored)
    run = subprocess.run(
        [sys.executable, "-c", SCRIPT, tmp_path / "stored.npy", tmp_path / "levels.npz"],
        env={**os.environ, "MIPBAKE_ISA": isa},
        capture_output=True,
        text=True,
        check=False,
    )
    assert run.returncode == 0, run.stderr
    if run.stdout.strip() != isa:
        pytest.skip(f"this processor or build has no {isa}")
    (info,) = (info for info in MOMENTS if info.name == "mipbake-3")
    here = moment_levels(load_network(info), stored, Lookup("gaussian", Sampler()), ("wrap", "clamp"))
    with np.load(tmp_path / "levels.npz") as found:
        difference = off("gltf", [found[name] for name in found.files], here)
    assert difference.max() < 3e-3
    assert np.quantile(difference, 0.99) < 1e-4


EVERY = tuple(MODELS)

SMALL = LatentConfig(EVERY, EVERY, latent_channels=40, encoder_layers=2, decoder_layers=2, growth=5)


def latent_like(config: LatentConfig = SMALL) -> LatentNetwork:
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


def stored_of(model: str, height: int, width: int) -> np.ndarray:
    """Stretched lobes of a model that stores directions come from one that stores tensors."""
    if MODELS[model].lines is None:
        return of_model(model, height, width)
    return convert(of_model("ggx", height, width), "ggx", model).astype(np.float32)


@pytest.mark.parametrize("read", EVERY)
@pytest.mark.parametrize("made", EVERY)
def test_torch_says_the_same_of_every_model(read: str, made: str) -> None:
    network, stored = latent_like(), stored_of(read, 21, 34)
    theirs = latent_levels(network, stored, ("clamp", "wrap"), source=read, target=made)
    difference = off(made, latent_of(network).levels(stored, read, made, Lookup("gaussian"), ("clamp", "wrap")), theirs)
    assert np.quantile(difference, 0.999) < 2e-3
    assert np.quantile(difference, 0.99) < 5e-5


@pytest.mark.parametrize("info", LATENT, ids=lambda info: info.name)
def test_released_weights_bake_what_torch_bakes(info) -> None:
    baker, network = load_baker(info), load_network(info)
    assert isinstance(baker, LatentBaker)
    for read in info.network.encoders:
        for made in info.network.decoders:
            stored = of_model(read, 48, 40)
            theirs = latent_levels(network, stored, TORUS, source=read, target=made)
            difference = off(made, baker.levels(stored, read, made, Lookup("gaussian"), TORUS), theirs)
            assert np.quantile(difference, 0.999) < 1e-4
            assert np.quantile(difference, 0.99) < 2e-5


def test_tensors_that_do_not_fit_are_found_before_a_bake() -> None:
    baker = latent_of(latent_like())
    tensors = dict(baker.tensors)
    tensors["encoders.ggx.layers.1.weight"] = tensors["encoders.ggx.layers.1.weight"][:, :-1]
    with pytest.raises(ValueError, match="do not fit"):
        LatentBaker(SMALL, (), tensors)
