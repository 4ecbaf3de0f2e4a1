"""Networks: parametrisation, whitening, what an untrained network is, tiling, released weights."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest
import torch
from numpy.typing import NDArray

from mipbake.base.errors import InputError, UsageError
from mipbake.material import MODELS, convert
from mipbake.material.pixel_filter import level_sizes
from mipbake.models import registry
from mipbake.models.latent_config import PARAMETERS, LatentConfig
from mipbake.models.latent_inference import bake_levels
from mipbake.models.latent_network import LatentNetwork, Whitening, downsample
from mipbake.models.moment_config import MomentConfig
from mipbake.models.parameters import clamp, to_parameters, to_stored

from .moment_cases import of_model

MODEL_NAMES = tuple(PARAMETERS)
ANISOTROPIC = "gltf-anisotropic"


def material_of(model: str, height: int, width: int, seed: int = 0) -> NDArray[np.float32]:
    """Valid stored channels, with colours that are exactly 0 and 1 among them."""
    if model == ANISOTROPIC:
        return convert(of_model("ggx", height, width, seed), "ggx", model)
    return of_model(model, height, width, seed)


def combed(level: NDArray[np.float32], model: str) -> NDArray[np.float32]:
    """A level whose directions all lie within 45 degrees of +x: no signs break, and nothing is eased."""
    out = level.copy()
    if model == ANISOTROPIC:
        out[..., 8:10] = np.stack([1 + np.abs(level[..., 8]), level[..., 9]], -1)
        out[..., 8:10] /= np.linalg.norm(out[..., 8:10], axis=-1, keepdims=True)
    return out


def signed(level: NDArray[np.float32], model: str) -> NDArray[np.float32]:
    """A level with its directions in one half plane: directions from a decoder have either sign."""
    if model != ANISOTROPIC:
        return level
    out = level.copy()
    out[..., 8:10] *= np.where(level[..., 8:9] < 0, -1, 1)
    return out


def untrained(model: str = "gltf", **changes: object) -> LatentNetwork:
    torch.manual_seed(1)
    network = LatentConfig((model,), (model,), **changes).build()
    network.fit(lambda source: material_of(source, 16, 16, 9)[None])
    return network.requires_grad_(False)


def perturbed(model: str, **changes: object) -> LatentNetwork:
    """Makes the network like a trained one: every unit has its say, and outputs stay ordinary materials."""
    network = untrained(model, **changes)
    generator = torch.Generator().manual_seed(2)
    for decoder in network.decoders.values():
        decoder.output.weight += 0.02 * torch.randn(decoder.output.weight.shape, generator=generator)
    return network


@pytest.mark.parametrize("model", MODEL_NAMES)
def test_parameters_round_trip(model: str) -> None:
    stored = torch.from_numpy(material_of(model, 8, 8))
    parameters = to_parameters(stored, model)
    assert parameters.shape[-1] == PARAMETERS[model]
    assert torch.allclose(to_stored(parameters, model), stored, atol=2e-6)


@pytest.mark.parametrize("model", MODEL_NAMES)
def test_any_parameters_give_valid_materials(model: str) -> None:
    generator = torch.Generator().manual_seed(0)
    parameters = 8 * torch.randn(4096, PARAMETERS[model], generator=generator)
    parameters[0] = 0  # a flat material, whose normal has no direction
    parameters.requires_grad_()
    stored = to_stored(parameters, model)
    low, high = torch.tensor(MODELS[model].limits).T
    assert (stored >= low).all()
    assert (stored <= high).all()
    for group in MODELS[model].unit_vectors:
        assert torch.allclose(stored[:, group].norm(dim=-1), torch.ones(len(stored)), atol=1e-4)
    assert (stored[:, :3] == 0).any()
    assert (stored[:, :3] == 1).any()
    stored.sum().backward()
    assert parameters.grad.isfinite().all()


def test_clamp_passes_gradients_that_point_back_inside() -> None:
    x = torch.tensor([-1.0, -1.0, 0.5, 2.0, 2.0], requires_grad=True)
    grad = torch.tensor([1.0, -1.0, 3.0, 1.0, -1.0])
    y = clamp(x, 0, 1)
    y.backward(grad)
    assert y.tolist() == [0, 0, 0.5, 1, 1]
    # A descent step moves against the gradient: below the range only a negative one leads back.
    assert x.grad.tolist() == [0, -1, 3, 1, 0]


def test_whitening_statistics() -> None:
    generator = torch.Generator().manual_seed(0)
    mixing = torch.randn(7, 7, generator=generator)
    samples = torch.randn(5000, 7, generator=generator) @ mixing + 3
    samples[:, 3] = 0.25
    whitening = Whitening(7)
    whitening.fit(samples)
    whitened = whitening(samples).double()
    varying = [0, 1, 2, 4, 5, 6]
    assert whitened.mean(0).abs().max() < 1e-3
    assert whitened.isfinite().all()
    assert torch.allclose(torch.cov(whitened[:, varying].T), torch.eye(6, dtype=torch.float64), atol=0.05)
    assert torch.allclose(whitening.inverse(whitening(samples)), samples, atol=1e-4)


@pytest.mark.parametrize("latent_filter", ["gaussian", "box"])
@pytest.mark.parametrize("model", MODEL_NAMES)
def test_untrained_network_reproduces_a_constant_material_at_every_level(model: str, latent_filter: str) -> None:
    texel = material_of(model, 1, 1, 3)
    levels = bake_levels(untrained(model, latent_filter=latent_filter), np.tile(texel, (12, 21, 1)), ("wrap", "clamp"))
    assert [level.shape[:2] for level in levels] == level_sizes(12, 21)
    for level in levels:
        np.testing.assert_allclose(signed(level, model), np.broadcast_to(signed(texel, model), level.shape), atol=2e-5)


@pytest.mark.parametrize("model", MODEL_NAMES)
def test_untrained_network_is_linear_prefiltering(model: str) -> None:
    stored = combed(material_of(model, 16, 16), model)
    levels = bake_levels(untrained(model, latent_filter="box"), stored, ("wrap", "wrap"))
    np.testing.assert_allclose(signed(levels[0], model), signed(stored, model), atol=2e-5)
    parameters = to_parameters(torch.from_numpy(stored), model).reshape(8, 2, 8, 2, -1).mean((1, 3))
    expected = to_stored(parameters, model).numpy()
    np.testing.assert_allclose(signed(levels[1], model), signed(expected, model), atol=2e-5)


@pytest.mark.parametrize("wrap", ["wrap", "clamp"])
def test_gaussian_latents_have_the_pixel_filters_variance(wrap: str) -> None:
    """An impulse downsampled level by level spreads over 0.25 4^L texels^2, plus 1/12 a step for the box of a texel."""
    size = 128
    image = torch.zeros(1, 1, size, size)
    image[0, 0, 0] = torch.arange(size)
    ramp = torch.stack([torch.arange(size) + 0.5, (torch.arange(size) + 0.5).square()], -1)[None, None].double()
    moments = ramp
    for level in range(1, 4):
        moments = downsample(moments, (1, size >> level), "gaussian", ("clamp", wrap), level == 1)
        middle = moments[0, 0, (size >> level) // 2]
        variance = float(middle[1] - middle[0] ** 2)
        boxes = sum(4**step for step in range(level)) / 12
        # Cut at two sigma-pixels, the Gaussian has 0.9992... of its full variance.
        assert variance == pytest.approx(0.25 * 4**level + boxes, rel=0.01)


@pytest.mark.long
@pytest.mark.parametrize("model", MODEL_NAMES)
@pytest.mark.parametrize("wrap", [("wrap", "wrap"), ("clamp", "clamp"), ("clamp", "wrap")])
@pytest.mark.parametrize("size", [(37, 23), (1, 9), (64, 40)])
def test_tiled_equals_untiled(model: str, wrap: tuple[str, str], size: tuple[int, int]) -> None:
    network, stored = perturbed(model), material_of(model, *size)
    whole = network.stacks(torch.from_numpy(stored)[None], wrap, model)[model]
    tiled = bake_levels(network, stored, wrap, tile=11)
    assert [level.shape for level in tiled] == [tuple(level.shape[1:]) for level in whole]
    for left, right in zip(tiled, whole, strict=True):
        # The direction of a texel that is nearly isotropic is made of small differences.
        np.testing.assert_allclose(left, right[0], atol=1e-4 if model == ANISOTROPIC else 1e-5)


@pytest.mark.parametrize(
    ("change", "word"),
    [({"encoders": ("phong",)}, "phong"), ({"decoders": ()}, "decoders"), ({"decoders": ("gltf", "gltf")}, "decoders"),
     ({"latent_filter": "sinc"}, "sinc"),
     ({"growth": 0}, "growth"), ({"latent_channels": 3}, "latent_channels")],
)  # fmt: skip
def test_impossible_architectures(change: dict[str, object], word: str) -> None:
    with pytest.raises(UsageError, match=word):
        LatentConfig(**change)


@pytest.fixture
def released(tmp_path: Path) -> registry.WeightsInfo:
    from hashlib import sha256

    from safetensors.torch import save

    content = save({k: v.contiguous() for k, v in perturbed("gltf").state_dict().items()})
    info = registry.WeightsInfo(
        name="tiny", network=LatentConfig(), pixel_filters=("gaussian",), default=True, steps=1, commit="c",
        data="d", data_licence="CC0-1.0", licence="CC0-1.0", sha256=sha256(content).hexdigest(), folder=tmp_path,
    )  # fmt: skip
    info.tensors.write_bytes(content)
    (tmp_path / "tiny.json").write_text(info.to_json())
    return info


def test_released_weights_load(released: registry.WeightsInfo) -> None:
    folder = released.folder
    assert registry.list_weights(folder) == [released]
    assert registry.default_weights("gltf", folder=folder) == registry.find_weights("tiny", folder) == released
    network, stored = registry.load_network(released), material_of("gltf", 9, 9)
    for left, right in zip(
        bake_levels(network, stored, ("wrap", "wrap")),
        bake_levels(perturbed("gltf"), stored, ("wrap", "wrap")),
        strict=True,
    ):
        np.testing.assert_allclose(left, right, atol=1e-6)


def test_unknown_weights_name_what_there_is(released: registry.WeightsInfo) -> None:
    with pytest.raises(UsageError, match=r"'huge'.*tiny"):
        registry.find_weights("huge", released.folder)
    with pytest.raises(UsageError, match=r"'ggx'.*gltf with gaussian"):
        registry.default_weights("ggx", folder=released.folder)
    with pytest.raises(UsageError, match="box"):
        registry.default_weights("gltf", "box", released.folder)


def test_weights_see_all_of_their_source(released: registry.WeightsInfo) -> None:
    """A decoder of the target's own is worth less than an encoder that sees anisotropic sources."""
    for name, network in (
        ("blind", MomentConfig(decoders=("gltf-anisotropic",))),
        ("seeing", LatentConfig(encoders=("ggx",), decoders=("ggx",))),
    ):
        info = dataclasses.replace(released, name=name, network=network)
        (released.folder / f"{name}.json").write_text(info.to_json())
    chosen = {
        source: registry.default_weights("gltf-anisotropic", folder=released.folder, source=source).name
        for source in ("gltf", "gltf-anisotropic", "ggx")
    }
    assert chosen == {"gltf": "blind", "gltf-anisotropic": "seeing", "ggx": "seeing"}
    (released.folder / "seeing.json").unlink()
    with pytest.raises(UsageError, match="no trained weights"):
        registry.default_weights("gltf-anisotropic", folder=released.folder, source="gltf-anisotropic")


def test_there_is_one_default_for_a_bake(released: registry.WeightsInfo) -> None:
    rival = dataclasses.replace(released, name="another")
    (released.folder / "another.json").write_text(rival.to_json())
    with pytest.raises(InputError, match=r"several default weights for material model 'gltf'.*another, tiny"):
        registry.default_weights("gltf", folder=released.folder)
    with pytest.raises(UsageError, match=r"tiny are the default weights for .*tiny\.json first"):
        registry.check_sole_default(rival)
    (released.folder / "another.json").write_text(dataclasses.replace(rival, default=False).to_json())
    assert registry.default_weights("gltf", folder=released.folder) == released
    for apart in ({"pixel_filters": ("box",)}, {"network": LatentConfig(decoders=("ggx",), encoders=("ggx",))}):
        registry.check_sole_default(dataclasses.replace(rival, **apart))


def test_released_weights_leave_no_doubt() -> None:
    for info in registry.list_weights():
        if info.default:
            registry.check_sole_default(info)


def test_damaged_weights_are_refused(released: registry.WeightsInfo) -> None:
    content = bytearray(released.tensors.read_bytes())
    content[-1] ^= 1
    released.tensors.write_bytes(content)
    with pytest.raises(InputError, match="damaged or altered"):
        registry.load_network(released)
    released.tensors.unlink()
    with pytest.raises(InputError, match="cannot be read"):
        registry.load_network(released)


def test_weights_of_another_architecture_are_refused(released: registry.WeightsInfo) -> None:
    other = dataclasses.replace(released, network=LatentConfig(growth=8))
    with pytest.raises(InputError, match="do not fit the architecture"):
        registry.load_network(other)


@pytest.mark.parametrize("damage", ["truncate", "unknown field", "wrong type", "renamed"])
def test_damaged_descriptions_are_refused(released: registry.WeightsInfo, damage: str) -> None:
    path = released.folder / "tiny.json"
    content = json.loads(path.read_text())
    if damage == "unknown field":
        content["surprise"] = 1
    elif damage == "wrong type":
        content["steps"] = "many"
    elif damage == "renamed":
        content["name"] = "other"
    text = json.dumps(content)
    path.write_text(text[:40] if damage == "truncate" else text)
    with pytest.raises(InputError, match=r"tiny\.json"):
        registry.list_weights(released.folder)


def test_decoder_is_densely_connected() -> None:
    """The grouped products equal the definition: every layer reads the latents and all maps before it."""
    network = perturbed("gltf")
    latent = torch.randn(5, 64, generator=torch.Generator().manual_seed(4))
    maps, decoder = latent, network.decoders["gltf"]
    for layer in decoder.layers:
        maps = torch.cat([maps, torch.nn.functional.leaky_relu(layer(maps), 0.1)], -1)
    expected = to_stored(network.whitening["gltf"].inverse(decoder.output(maps)), "gltf")
    assert torch.allclose(network.decode(latent), expected, atol=1e-5)
