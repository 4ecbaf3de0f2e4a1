"""Training: configurations, data, augmentation, the loss."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from mipbake.base.errors import InputError, UsageError
from mipbake.material import GGX_LOBE, MIN_ROUGHNESS, MODELS, Kind, convert, tensor_exp
from mipbake.material.filtered_source import FilteredSource
from mipbake.models.latent_config import LatentConfig
from mipbake.quality.metrics import pair_set
from mipbake.quality.reference.estimate import reference
from mipbake.shading import shade
from mipbake.training import augmentation, data, loss
from mipbake.training.batches import draw_batch
from mipbake.training.config import AUGMENTED, OptimiserConfig, TrainingConfig, config_from, plain, read_config
from mipbake.training.loss import SingleLightsLossConfig
from mipbake.training.optimiser import FlatAdam
from mipbake.training.procedural import procedural_set

from .small_training import tiny

CONFIGS = Path(__file__).resolve().parent.parent / "training" / "configs"
MODEL_NAMES = AUGMENTED


def patches_of(model: str, count: int = 6, size: int = 32) -> np.ndarray[Any, np.dtype[np.float32]]:
    return np.stack([convert(procedural_set(seed, size), "gltf", model) for seed in range(count)]).astype(np.float32)


def assert_valid(stored: np.ndarray[Any, Any], model: str) -> None:
    low, high = np.array(MODELS[model].limits, np.float32).T
    assert np.isfinite(stored).all()
    assert (stored >= low - 1e-6).all()
    assert (stored <= high + 1e-6).all()
    layout = MODELS[model]
    for group in layout.of(Kind.NORMAL):
        np.testing.assert_allclose(np.linalg.norm(stored[..., group], axis=-1), 1, atol=2e-3)
        assert (stored[..., group][..., 2] > 0).all()
    for group in layout.of(Kind.NORMAL_XY):
        assert (np.linalg.norm(stored[..., group], axis=-1) < 1).all()
    for group in layout.of(Kind.ROUGHNESS):
        assert (stored[..., group] >= MIN_ROUGHNESS - 1e-6).all()
    for group in layout.of(Kind.LOG_TENSOR):
        tensor = tensor_exp(stored[..., group].astype(np.float64))
        determinant = tensor[..., 0] * tensor[..., 1] - tensor[..., 2] ** 2
        assert (determinant > 0).all()
        assert (tensor[..., :2].sum(-1) <= (2 + 1e-4 if layout.lobe is GGX_LOBE else 2.6)).all()


# Configurations


@pytest.mark.parametrize("path", sorted(CONFIGS.glob("*.toml")), ids=lambda p: p.stem)
def test_shipped_configurations_are_valid(path: Path) -> None:
    config = read_config(path)
    assert config_from(plain(config)) == config


@pytest.mark.parametrize("model", ["ggx", "beckmann"])
def test_paper_configurations_are_the_defaults_and_list_every_field(model: str) -> None:
    config = read_config(CONFIGS / f"paper-{model}.toml")
    assert config.loss == SingleLightsLossConfig()
    assert config.optimiser == OptimiserConfig()
    assert config.run == TrainingConfig().run
    assert config.network.encoders == config.network.decoders == (model,)
    text = (CONFIGS / f"paper-{model}.toml").read_text()
    for name, section in plain(config).items():
        assert f"[{name}]" in text
        for field in section:
            assert f"\n{field} = " in text


@pytest.mark.parametrize("path", sorted(CONFIGS.glob("paper-*.toml")), ids=lambda p: p.stem)
def test_paper_configurations_are_those_of_its_section_3_4(path: Path) -> None:
    """Kemppinen et al. 2023: Adam with rate 5e-5, betas (0.95, 0.95) and epsilon 1e-6; 310k iterations of 64 lights,
    crops of 32 x 32 and 5 levels; the rate ramped up over 100 iterations and halved every 50 thousand; one sample a
    pixel; no weight decay or other additions."""
    config = read_config(path)
    optimiser, made, run = config.optimiser, config.loss, config.run
    assert (optimiser.learning_rate, optimiser.beta1, optimiser.beta2, optimiser.epsilon) == (5e-5, 0.95, 0.95, 1e-6)
    assert (optimiser.ramp, optimiser.halve_every, run.steps) == (100, 50_000, 310_000)
    assert (optimiser.clip, optimiser.ema_decay, optimiser.fall_until, run.uses) == (0, 0, 0, 1)
    assert (made.pairs, made.crop_size, made.crops, made.lods) == (64, 32, 1, 5)
    assert (made.target_samples, made.near_mirror_fraction) == (1, 0)
    assert (config.data.mixed, config.data.turned, config.data.boosted) == ("itself", False, True)
    assert (config.data.strided, config.data.plain) == (0, 0)
    (adam,) = FlatAdam(LatentConfig().build(), None, optimiser)._adam.param_groups  # noqa: SLF001
    assert (adam["betas"], adam["eps"], adam["weight_decay"]) == ((0.95, 0.95), 1e-6, 0)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ({"optimizer": {}}, r"section 'optimizer'.*optimiser"),
        ({"loss": {"pears": 3}}, r"field of \[loss\] 'pears'.*pairs"),
        ({"loss": {"weighting": "error"}}, r"unknown field of \[loss\] 'weighting': expected one of crops"),
        ({"loss": {"pairs": "many"}}, r"loss\.pairs must be a whole number, got 'many'"),
        ({"loss": {"pairs": 2.5}}, r"loss\.pairs must be a whole number"),
        ({"loss": {"crop_size": 33}}, r"loss\.crop_size must be a power of two"),
        ({"loss": {"pairs": 6, "target_samples": 4}}, r"loss\.target_samples must be a divisor"),
        ({"loss": {"pixel_filter": "sinc"}}, r"sinc.*gaussian"),
        ({"loss": {"near_mirror_fraction": 2}}, r"loss\.near_mirror_fraction"),
        ({"data": {"mixed": "both"}}, r"data\.mixed must be one of another, itself, got 'both'"),
        ({"optimiser": {"beta1": 1.0}}, r"optimiser\.beta1"),
        ({"run": {"steps": True}}, r"run\.steps"),
        ({"network": 3}, r"\[network\]"),
        ({"network": {"architecture": "moments"}}, r"loss\.kind must be"),
        ({"loss": {"kind": "balanced", "near_mirror": 5}}, "multiple of 6"),
        ({"data": {"plain": -1.0}}, r"data\.plain"),
        ({"optimiser": {"fall_from": 5, "fall_until": 2}}, "fall_until"),
        ({"data": {"captured_sets": 1}}, r"network\.encoders.*beckmann where data\.captured_sets is not 0"),
        ({"network": {"encoders": ["gltf-anisotropic"]}}, r"network\.encoders must be of"),
        (
            {"data": {"procedural_sets": 1, "procedural_size": 32}, "loss": {"crop_size": 64}},
            r"data\.procedural_size must be at least loss\.crop_size, which is 64, got 32",
        ),
        ({"network": {"encoders": ["ggx", 1]}}, r"network\.encoders must be a list of strings"),
        ({"network": {"architecture": []}}, r"network\.architecture must be one of latent, moments, got \[\]"),
        (
            {"network": {"architecture": "moments"}, "loss": {"kind": "balanced", "grazing": 1.0}},
            r"loss\.grazing.*below 1",
        ),
    ],
)
def test_wrong_fields_are_named(content: dict[str, Any], message: str) -> None:
    with pytest.raises(UsageError, match=message):
        config_from(content)


def test_unreadable_configurations(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="cannot be read"):
        read_config(tmp_path / "none.toml")
    (tmp_path / "bad.toml").write_text("[loss\n")
    with pytest.raises(UsageError, match="not a TOML file"):
        read_config(tmp_path / "bad.toml")


def test_learning_rate_ramps_and_halves() -> None:
    schedule = OptimiserConfig(learning_rate=1.0, ramp=10, halve_every=100)
    assert [schedule.rate(s) for s in (0, 4, 9, 50, 99)] == pytest.approx([0.1, 0.5, 1, 1, 1])
    assert [schedule.rate(s) for s in (100, 199, 200)] == pytest.approx([0.5, 0.5, 0.25])


# Data and augmentation


@pytest.mark.parametrize("seed", range(8))
def test_procedural_sets_are_valid_periodic_and_reproducible(seed: int) -> None:
    stored = procedural_set(seed, 64)
    assert stored.shape == (64, 64, 8)
    assert_valid(stored, "gltf")
    np.testing.assert_array_equal(stored, procedural_set(seed, 64))


@pytest.mark.parametrize("model", MODEL_NAMES)
@pytest.mark.parametrize(
    "augment",
    [
        augmentation.permute_colours,
        augmentation.reorient,
        augmentation.change_roughness,
        augmentation.change_normals,
        augmentation.augment,
    ],
)
def test_augmentations_keep_materials_valid_and_change_them(augment: Any, model: str) -> None:
    patches = patches_of(model)
    assert_valid(patches, model)
    changed = augment(patches, model, np.random.default_rng(1))
    assert changed.dtype == np.float32
    assert changed.shape == patches.shape
    assert_valid(changed, model)
    assert not np.allclose(changed, patches)


def test_dirty_metals_keep_a_little_diffuse_light_and_darken() -> None:
    metals = np.ones((64, 2, 2, 8), np.float32)
    dirty = augmentation.dirty_metals(metals, "gltf", np.random.default_rng(12))
    chosen = dirty[:, 0, 0, 3] < 1
    assert 2 < chosen.sum() < 25
    np.testing.assert_array_equal(dirty[~chosen], metals[~chosen])
    np.testing.assert_array_equal(dirty[..., 4:], metals[..., 4:])
    assert (dirty[chosen][..., :3] < 0.7).all() and (dirty[chosen][..., 3] > 0.3).all()


def test_colours_are_permuted_alike_in_albedo_and_specular() -> None:
    patches = patches_of("ggx")
    changed = augmentation.permute_colours(patches, "ggx", np.random.default_rng(0))
    for before, after in zip(patches, changed, strict=True):
        orders = [o for o in np.ndindex(3, 3, 3) if len(set(o)) == 3 and (before[..., list(o)] == after[..., :3]).all()]
        assert any((before[..., 3:6][..., list(o)] == after[..., 3:6]).all() for o in orders)


@pytest.mark.parametrize("model", MODEL_NAMES)
@pytest.mark.parametrize("mirror", [False, True])
@pytest.mark.parametrize("quarter_turns", range(4))
def test_turned_patches_look_the_same_under_turned_light(model: str, quarter_turns: int, mirror: bool) -> None:
    """Shading a turned patch under turned light and view gives the turned picture, anisotropy included."""
    size = 8
    patch = patches_of(model, 1, size)[0]
    for group in MODELS[model].of(Kind.LOG_TENSOR):
        patch[..., group] = augmentation.change_roughness(patch[None], model, np.random.default_rng(3))[0, ..., group]
        patch[..., group.start] += 1.0
    pairs = pair_set("near-mirror", 0, 8)
    turned = augmentation.turn(patch, quarter_turns, mirror, model)
    angle = quarter_turns * np.pi / 2
    rotation = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
    rotation = np.diag([-1.0 if mirror else 1.0, 1, 1]) @ rotation
    light, view = ((d @ rotation.T).astype(np.float32) for d in (pairs.light, pairs.view))
    picture = shade(model, patch.reshape(-1, patch.shape[-1]), pairs.light, pairs.view).reshape(-1, size, size, 3)
    expected = np.rot90(picture, quarter_turns, (1, 2))
    expected = expected[:, :, ::-1] if mirror else expected
    got = shade(model, turned.reshape(-1, patch.shape[-1]), light, view).reshape(-1, size, size, 3)
    np.testing.assert_allclose(got, expected, rtol=2e-3, atol=1e-4)


def test_perlin_noise_is_periodic_and_smooth() -> None:
    noise = augmentation.perlin(4, 32, np.random.default_rng(0))
    inner = np.abs(np.diff(noise, axis=2)).mean()
    seam = np.abs(noise[:, :, 0] - noise[:, :, -1]).mean()
    assert seam < 2 * inner < noise.std()


def test_mixes_take_each_texel_from_one_of_the_two() -> None:
    first, second = np.zeros((64, 16, 16, 3), np.float32), np.ones((64, 16, 16, 3), np.float32)
    mixed = augmentation.mix(first, second, np.random.default_rng(0))
    assert set(np.unique(mixed)) == {0, 1}
    share = mixed.mean((1, 2, 3))
    assert 0.25 < (share == 0).mean() < 0.75
    assert share.max() > 0.7


def ramps(sets: int = 6) -> data.Materials:
    """Sets that a patch can be told from, however it is augmented: their albedos have no two colours in common."""
    images = []
    for index in range(sets):
        image = np.zeros((48, 48, 11), np.float32)
        image[..., :3] = np.array([0.1, 0.4, 0.7]) + 0.02 * index  # permuted, it stays the same three numbers
        image[..., 3:6] = 0.04 + 0.01 * np.arange(48)[:, None]  # rises from left to right
        image[..., 8:10] = -4.0
        images.append(image.astype(np.float16))
    return data.Materials(images, "ggx")


@pytest.mark.parametrize("name", ["paper-ggx", "mipbake-1"])
def test_the_paper_mixes_a_material_with_itself(name: str) -> None:
    """Section 3.4: two differently augmented instances of the material of a step, and a binary mask."""
    settings = read_config(CONFIGS / f"{name}.toml").data
    settings = dataclasses.replace(settings, strided=0.0, plain=0.0)
    patches = data.draw_crops(ramps(), 64, 32, "ggx", np.random.default_rng(0), settings)
    sources = [len(np.unique(np.sort(p[..., :3], -1).reshape(-1, 3).round(3), axis=0)) for p in patches]
    instances = [len(np.unique(p[..., 8:11].reshape(-1, 3).round(3), axis=0)) for p in patches]
    if name == "paper-ggx":
        assert max(sources) == 1
        assert (
            np.mean(np.array(instances) == 2) > 0.85
        )  # now and then both keep their roughness, or one fills the patch
    else:
        assert max(sources) == 2
        assert 0.3 < np.mean(np.array(instances) == 1) < 0.7


def test_boosted_patches_are_glossier_and_steeper() -> None:
    """Section 4: sharpness and normals are boosted slightly, and of every material."""
    count = 4000
    patches = np.zeros((count, 1, 1, 11), np.float32)
    patches[..., 6], patches[..., 8:10] = 0.1, -4.0
    found = {}
    for boosted in (False, True):
        rng = np.random.default_rng(0)
        tensor = augmentation.change_roughness(patches, "ggx", rng, boosted)[:, 0, 0, 8:10].mean(-1) + 4
        slope = np.linalg.norm(augmentation.change_normals(patches, "ggx", rng, boosted)[:, 0, 0, 6:8], axis=-1)
        found[boosted] = np.log(np.median(slope) / 0.1), tensor
    assert np.mean(abs(found[False][1]) < 1e-5) == pytest.approx(0.25, abs=0.03)  # these stay as they are
    assert np.median(found[True][1]) == pytest.approx(-0.5, abs=0.05)
    assert np.mean(abs(found[True][1] + 0.5) < 1e-5) == pytest.approx(0.25, abs=0.03)
    assert found[True][0] > 0.05


def test_draws_are_functions_of_seed_and_step() -> None:
    config = tiny()
    materials, _ = data.load_materials(config)
    first, again, other = (draw_batch(materials, config, step) for step in (3, 3, 4))
    assert torch.equal(first.noisy_reference, again.noisy_reference)
    assert torch.equal(first.patches, again.patches)
    assert not torch.equal(first.patches, other.patches)


def test_missing_data_is_named(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=r"data\.folder"):
        data.load_materials(tiny(data={"procedural_sets": 0}))
    with pytest.raises(InputError, match="no such folder"):
        data.load_materials(tiny(data={"folder": str(tmp_path / "none")}))
    with pytest.raises(InputError, match="no texture sets found"):
        data.load_materials(tiny(data={"folder": str(tmp_path)}))


# The loss


@pytest.mark.long
@pytest.mark.parametrize("model", MODEL_NAMES)
@pytest.mark.parametrize(("samples", "pixel_filter"), [(1, "gaussian"), (4, "gaussian"), (2, "mitchell")])
def test_noisy_targets_average_to_the_reference(model: str, samples: int, pixel_filter: str) -> None:
    config = SingleLightsLossConfig(
        crops=1, crop_size=8, pairs=4, lods=2, target_samples=samples, pixel_filter=pixel_filter
    )
    patch = patches_of(model, 1, 8)
    rng = np.random.default_rng(5)
    views = loss.draw_views(config, rng)
    references = torch.stack(
        [
            loss.draw_noisy_reference(torch.from_numpy(patch), views, model, pixel_filter, samples, rng)[0]
            for _ in range(600)
        ]
    ).double()
    mean, spread = references.mean(0), references.std(0) / np.sqrt(len(references))
    pairs = pair_set("hemisphere", 0, 4)
    pairs = dataclasses.replace(pairs, light=views.light[0].numpy(), view=views.view[0].numpy())
    expected = []
    for slot in range(2):
        uv, lod = views.uv[0, slot].double().numpy(), float(views.lod[0, slot])
        source = FilteredSource(patch[0], model, loss.TORUS, pixel_filter)
        expected.append(reference(source, uv, lod, pairs, 2048, np.random.default_rng(0)))
    error = (mean - torch.from_numpy(np.stack(expected)).double()) / (spread + 1e-5)
    assert error.abs().quantile(0.99) < 4
    assert error.mean().abs() < 0.2


def test_views_follow_their_distributions() -> None:
    config = SingleLightsLossConfig(crops=64, crop_size=4, pairs=16, lods=8, near_mirror_fraction=0.25)
    views = loss.draw_views(config, np.random.default_rng(0))
    for directions in (views.light, views.view):
        assert torch.allclose(directions.norm(dim=-1), torch.ones(64, 16), atol=1e-5)
        assert (directions[..., 2] > 0).all()
    # The mean of cos under the density cos / pi is 2/3.
    assert float(views.view[..., 2].mean()) == pytest.approx(2 / 3, abs=0.03)
    mirror = views.view * torch.tensor([-1.0, -1.0, 1.0])
    angle = (mirror * views.light).sum(-1).clamp(-1, 1).acos()
    assert float(angle[:, :4].mean()) < 0.25
    assert float(angle[:, 4:].mean()) > 0.5
    lod = views.lod
    assert lod.shape == (64, 8)
    assert float(lod.min()) == 0
    assert float(lod.max()) == 2
    # Uniform on [-0.5, 2.5], then clamped: a sixth at each end.
    assert float((lod == 0).double().mean()) == pytest.approx(1 / 6, abs=0.06)
    texel = (views.uv * 4).reshape(64, 8, 4, 4, 2)
    column = torch.arange(4.0)[None, None, None, :]
    assert ((texel[..., 0] >= column) & (texel[..., 0] <= column + 1)).all()


def loss_case(model: str = "ggx") -> tuple[torch.Tensor, loss.Views, torch.Tensor]:
    """Texels (B, S, N, C) with a gradient, views of 6 pairs, and references unlike what the texels give."""
    config = SingleLightsLossConfig(crops=2, crop_size=4, pairs=6, lods=3)
    views = loss.draw_views(config, np.random.default_rng(0))
    texels = torch.from_numpy(patches_of(model, 6, 4)).reshape(2, 3, 16, -1)
    apart = torch.empty(2, 3, 6, 16, 3).uniform_(0.5, 2, generator=torch.Generator().manual_seed(0))
    return texels.clone().requires_grad_(), views, renders(texels, views, model) * apart


def renders(texels: torch.Tensor, views: loss.Views, model: str = "ggx") -> torch.Tensor:
    return torch.stack([shade(model, texels[:, s], views.light, views.view) for s in range(texels.shape[1])], 1)


def test_loss_is_equation_5() -> None:
    texels, views, target = loss_case()
    value = loss.render_loss(texels, "ggx", views, target)
    (gradient,) = torch.autograd.grad(3 * value, texels)
    prediction = renders(texels, views)
    norm = prediction.detach().square().sum((3, 4)) + loss.EPSILON * 48
    expected = ((prediction - target).square().sum((3, 4)) / norm).mean()
    assert value.item() == pytest.approx(expected.item(), rel=1e-5)
    (by_hand,) = torch.autograd.grad(3 * expected, texels)
    assert torch.allclose(gradient, by_hand, rtol=1e-3, atol=1e-5 * float(by_hand.abs().max()))
    with torch.no_grad():
        assert float(loss.render_loss(texels, "ggx", views, target)) == value.item()
