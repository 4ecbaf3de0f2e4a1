"""The re-implemented MIPNet: what it makes before training, exactly; that it trains, resumes and is not released."""

from __future__ import annotations

import importlib.util
import json
import math
import shutil
import sys
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
import torch

from mipbake import material
from mipbake.base.errors import InputError, UsageError
from mipbake.material.pixel_filter import FILTERS
from mipbake.models.architectures import ARCHITECTURES
from mipbake.models.registry import find_weights, load_network
from mipbake.training import batches, loop
from mipbake.training.balanced_loss import BalancedBatch, rendered
from mipbake.training.config import TrainingConfig, config_from, plain, read_config
from mipbake.training.data import Materials
from mipbake.training.export import export_weights

from .moment_cases import bumpy
from .small_training import train

torch.set_num_threads(1)

BENCHMARKS = Path(__file__).parents[1] / "benchmarks"
TARGETS = ("gltf", "gltf-anisotropic", "ggx", "beckmann")
GLTF, TENSORS = TARGETS[:2], TARGETS[2:]
AXIS = np.array([1, 0, 0], np.float32)


def module(name: str) -> ModuleType:
    if name not in sys.modules:
        spec = importlib.util.spec_from_file_location(name, BENCHMARKS / f"{name}.py")
        assert spec is not None and spec.loader is not None
        sys.modules[name] = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(sys.modules[name])
    return sys.modules[name]


mipnet_network = module("mipnet_network")
mipnet = module("mipnet")


@pytest.fixture(autouse=True)
def known(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Configurations may name it, in these tests alone."""
    for kind in mipnet_network.KINDS.values():
        monkeypatch.setitem(ARCHITECTURES, kind.architecture, kind)
    yield


def small(target: str = "gltf") -> mipnet_network.MipnetConfig:
    return mipnet_network.MipnetConfig(target, single_layers=2, single_width=12, multi_layers=2, multi_width=16)


def tiny(target: str = "gltf", **run: int) -> TrainingConfig:
    return config_from(
        {
            "network": {
                "architecture": "mipnet", "target": target,
                "single_layers": 2, "single_width": 12, "multi_layers": 2, "multi_width": 16,
            },
            "data": {"held_out": 0, "procedural_sets": 2, "procedural_size": 64, "plain": 0.5, "strided": 0.5},
            "loss": {"kind": "balanced", "crops": 2, "crop_size": 16, "any_filter": 0.0},
            "optimiser": {"learning_rate": 2e-3, "ramp": 2, "ema_decay": 0.9, "clip": 5.0},
            "run": {"steps": 6, "log_every": 2, "validate_every": 4, "checkpoint_every": 3, "uses": 2} | run,
        }
    )  # fmt: skip


def trained_like(target: str, seed: int = 0) -> mipnet_network.MipnetNetwork:
    """Last layers that are not zero."""
    torch.manual_seed(seed)
    network = small(target).build()
    for part in (network.single, network.multi):
        torch.nn.init.normal_(part.output.weight, std=0.05)
    return network


def boxed(image: np.ndarray) -> np.ndarray:
    """Averages of 2 x 2, or of what there is along an axis of one texel."""
    rows = image if image.shape[0] == 1 else (image[::2] + image[1::2]) / 2
    return rows if rows.shape[1] == 1 else (rows[:, ::2] + rows[:, 1::2]) / 2


def tensors(height: int, width: int, seed: int, model: str) -> np.ndarray:
    """Valid stored channels of `ggx` or `beckmann` with turned lobes from sharp to wide."""
    rng = np.random.default_rng(seed)
    stored = material.convert(bumpy(height, width, seed), "gltf", model)
    mean, (d, c) = rng.uniform(-8, -1, (height, width)), rng.uniform(-1, 1, (2, height, width))
    stored[..., 8:11] = np.stack([mean + d, mean - d, c], -1)
    if model == "beckmann":
        stored[..., 11] = rng.uniform(-1, 1, (height, width))
    return material.regularise(stored, model)


def source(target: str) -> np.ndarray:
    """(16, 16, C) what a network for the target reads."""
    return bumpy(16, 16, 1) if target in GLTF else tensors(16, 16, 1, target)


def rooted(stored: np.ndarray) -> np.ndarray:
    """(H, W, 2, 2) roots of the tensors of `ggx` or `beckmann`: exp(L / 2), by eigenvectors."""
    a, b, c = np.moveaxis(stored[..., 8:11].astype(float), -1, 0)
    values, vectors = np.linalg.eigh(np.stack([np.stack([a, c], -1), np.stack([c, b], -1)], -2) / 2)
    return np.asarray((vectors * np.exp(values)[..., None, :]) @ np.swapaxes(vectors, -1, -2))


def lobes(level: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(..., 2) alpha along and across, and the direction of the first, of `gltf-anisotropic`."""
    across = np.square(level[..., 4])
    return np.stack([across + (1 - across) * np.square(level[..., 10]), across], -1), level[..., 8:10]


@pytest.mark.parametrize("size", [(16, 16), (8, 32), (16, 2), (1, 8)])
@pytest.mark.parametrize("target", GLTF)
def test_untrained_it_makes_box_averages(target: str, size: tuple[int, int]) -> None:
    stored = bumpy(*size, 3)
    levels = small(target).build().bake(stored, "gltf", target)
    kept = np.concatenate([stored, np.broadcast_to(AXIS, (*size, 3))], -1) if len(target) > 4 else stored
    np.testing.assert_array_equal(levels[0][..., :5], kept[..., :5])
    np.testing.assert_allclose(levels[0][..., 5:], kept[..., 5:], atol=1e-6)
    colours, xy = stored[..., :4].astype(float), stored[..., 5:7].astype(float)
    alpha = np.square(np.maximum(stored[..., 4:5].astype(float), material.MIN_ROUGHNESS))
    assert levels[-1].shape[:2] == (1, 1)
    for level in levels[1:]:
        colours, xy, alpha = boxed(colours), boxed(xy), boxed(alpha)
        np.testing.assert_allclose(level[..., :4], colours, atol=1e-6)
        np.testing.assert_allclose(level[..., 4:5], np.sqrt(alpha), rtol=1e-5 if target == "gltf" else 1e-3)
        np.testing.assert_allclose(level[..., 5:7], xy, atol=1e-5)
        np.testing.assert_allclose(np.square(level[..., 5:8]).sum(-1), 1, atol=1e-5)
        if target == "gltf-anisotropic":
            axes, direction = lobes(level)
            np.testing.assert_allclose(axes[..., 0] / axes[..., 1], 1, atol=3e-3)
            np.testing.assert_allclose(direction, np.broadcast_to(AXIS[:2], direction.shape), atol=1e-4)


@pytest.mark.parametrize("target", TENSORS)
def test_untrained_it_averages_roots_of_tensors(target: str) -> None:
    """Albedo, F0, normals and the exponent are averaged as they are, and the tensor S by its root."""
    stored = tensors(8, 16, 7, target)
    levels = small(target).build().bake(stored, target, target)
    np.testing.assert_array_equal(levels[0], stored)
    plain, roots = np.delete(stored, range(8, 11), -1).astype(float), rooted(stored)
    for level in levels[1:]:
        plain, roots = boxed(plain), boxed(roots)
        np.testing.assert_allclose(np.delete(level, range(8, 11), -1), plain, atol=1e-5)
        np.testing.assert_allclose(rooted(level), roots, rtol=1e-4, atol=1e-6)


@pytest.mark.parametrize("target", GLTF)
def test_a_constant_material_stays_as_it_is(target: str) -> None:
    """Black and white, 0 and 1, included; where lobes have two axes, roughness to a thousandth."""
    for texel in ([0.0, 0.5, 1.0, 1.0, 0.045], [0.2, 0.3, 0.4, 0.0, 1.0], [0.2, 0.3, 0.4, 0.25, 0.31]):
        normal = np.array([0.3, -0.2, 0.0])
        normal[2] = np.sqrt(1 - np.square(normal).sum())
        stored = np.tile(np.array([*texel, *normal], np.float32), (8, 8, 1))
        for level in small(target).build().bake(stored, "gltf", target):
            expected = stored[: len(level), : len(level)]
            np.testing.assert_array_equal(level[..., :4], expected[..., :4])
            np.testing.assert_allclose(level[..., 4], expected[..., 4], rtol=1e-5 if target == "gltf" else 1e-3)
            np.testing.assert_allclose(level[..., 5:8], expected[..., 5:8], atol=2e-6)


def test_only_sides_that_halve_to_one_texel_are_taken() -> None:
    network = small().build()
    for size in ((12, 16), (16, 7), (3, 3)):
        with pytest.raises(UsageError, match=f"powers of two, got {size[1]} x {size[0]}"):
            network.bake(bumpy(*size, 0), "gltf", "gltf")


def test_settings_that_make_no_network_are_refused() -> None:
    with pytest.raises(UsageError, match=r"network\.target must be one of gltf, gltf-anisotropic, ggx, beckmann"):
        mipnet_network.MipnetConfig("phong")
    with pytest.raises(UsageError, match=r"network\.multi_width must be at least 1"):
        mipnet_network.MipnetConfig(multi_width=0)


@pytest.mark.parametrize("target", TARGETS)
def test_what_it_makes_is_valid(target: str) -> None:
    """With any weights, ranges are kept, vectors are unit and widths are shaded."""
    network = trained_like(target)
    torch.nn.init.normal_(network.multi.output.bias, std=2.0)
    for level in network(torch.from_numpy(source(target))[None])[target][1:]:
        one = level[0].detach().numpy()
        np.testing.assert_allclose(material.regularise(one, target), one, atol=2e-6 if target in GLTF else 2e-4)
        if target in GLTF:
            assert (one[..., 4] >= material.MIN_ROUGHNESS - 1e-6).all()


def test_the_isotropic_target_is_the_geometric_mean_of_the_anisotropic_one() -> None:
    """What mipbake.material.convert makes of it."""
    stored = bumpy(16, 16, 2)
    networks = [trained_like(target) for target in GLTF]
    networks[1].load_state_dict(networks[0].state_dict())
    isotropic, anisotropic = (network.bake(stored, "gltf", network.target) for network in networks)
    stretched = 0.0
    for one, other in zip(isotropic[1:], anisotropic[1:], strict=True):
        axes, _ = lobes(other)
        np.testing.assert_allclose(np.square(one[..., 4]), np.sqrt(axes.prod(-1)), rtol=0.02)
        np.testing.assert_allclose(one[..., 4], material.convert(other, "gltf-anisotropic", "gltf")[..., 4], rtol=0.02)
        stretched = max(stretched, float((axes[..., 0] / axes[..., 1]).max()))
    assert stretched > 1.5  # or nothing was compared


def test_the_root_of_the_tensor_becomes_its_lobe() -> None:
    """A root with known axes, turned, comes back as roughness, strength and direction."""
    angle, wide, narrow = 0.7, 0.36, 0.09
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    root = turn @ np.diag([wide, narrow]) @ turn.T
    state = torch.tensor([[0.1, 0.2, root[0, 0], root[1, 1], root[0, 1]]])
    made = mipnet_network.anisotropic_texels(
        torch.zeros(1, 4), mipnet_network.valid_state(state, mipnet_network.alphas_of("gltf"))
    ).numpy()[0]
    axes, direction = lobes(made)
    np.testing.assert_allclose(axes, [wide, narrow], rtol=0.01)
    np.testing.assert_allclose(np.abs(direction @ turn[:, 0]), 1, atol=1e-5)


def test_lobes_leave_isotropy_in_every_direction() -> None:
    """Where strength has no derivative and direction no value, the tensor S = R^2 has one: dS = 2 alpha dR."""
    alpha = 0.2
    state = torch.tensor([[0.0, 0.0, alpha, alpha, 0.0]], requires_grad=True)
    made = mipnet_network.anisotropic_texels(
        torch.zeros(1, 4), mipnet_network.valid_state(state, mipnet_network.alphas_of("gltf"))
    )[0]
    across = made[4].square()
    along = across + (1 - across) * made[10].square()
    difference = along.square() - across.square()
    for part, expected in (
        (difference * made[8] * made[9], [0, 0, 2 * alpha]),
        (difference * (made[8].square() - made[9].square()), [2 * alpha, -2 * alpha, 0]),
    ):
        (gradient,) = torch.autograd.grad(part, state, retain_graph=True)
        np.testing.assert_allclose(gradient[0, 2:].numpy(), expected, atol=0.02 * alpha)


@pytest.mark.parametrize("target", TARGETS)
def test_gradients_are_those_of_differences(target: str) -> None:
    """Gradients of every level by every parameter are checked, through the cascade, in double precision."""
    network = trained_like(target).double()
    stored = torch.from_numpy(source(target)[:8, :8])[None].double()
    torch.manual_seed(1)
    weights = [torch.randn(level.shape, dtype=torch.float64) for level in network(stored)[target]]

    def value() -> torch.Tensor:
        made = network(stored)[target]
        return torch.stack([(w * level).sum() for w, level in zip(weights, made, strict=True)]).sum()

    value().backward()
    for name, parameter in network.named_parameters():
        assert parameter.grad is not None and float(parameter.grad.abs().max()) > 0, name
        direction = torch.randn_like(parameter)
        step, ends = 1e-6, []
        for sign in (1, -1):
            with torch.no_grad():
                parameter.add_(sign * step * direction)
                ends.append(float(value()))
                parameter.sub_(sign * step * direction)
        found = float((parameter.grad * direction).sum())
        assert found == pytest.approx((ends[0] - ends[1]) / (2 * step), rel=1e-3, abs=1e-6), name


def ridges() -> Materials:
    """Bumps that tilt along u alone."""
    stored = bumpy(32, 32, 5)
    stored[..., 6] = 0
    return Materials([material.regularise(stored, "gltf").astype(np.float16)], ["ridges"], "gltf")


@pytest.mark.long
@pytest.mark.parametrize("target", TARGETS)
def test_training_moves_every_parameter(target: str) -> None:
    config = tiny(target, steps=30)
    state = loop.new_state(config)
    start = [p.detach().clone() for p in state.network.parameters()]
    losses = [float(state.advance(batch)) for batch in batches.batches(ridges(), config, 0)]
    assert np.isfinite(losses).all()
    assert all(not torch.equal(a, b) for a, b in zip(start, state.network.parameters(), strict=True))


@pytest.mark.long
@pytest.mark.parametrize("target", GLTF)
def test_descent_lowers_the_error_of_a_batch(target: str) -> None:
    """The error is the error of levels that the network makes; lobes become as wide across ridges as the ridges
    scatter."""
    batch = batches.draw_batch(ridges(), tiny(target), 2)  # other batches hold a highlight that outweighs all else
    assert isinstance(batch, BalancedBatch)
    torch.manual_seed(0)
    network = small(target).build()
    optimiser = torch.optim.Adam(network.parameters(), 3e-3)

    def error() -> torch.Tensor:
        levels = network(batch.patches)[target]
        shaded = [rendered(levels, seen, batch.pairs.light, batch.pairs.view, target) for seen in batch.seen[1:]]
        return torch.stack(
            [(a - b.noisy_reference).square().mean() for a, b in zip(shaded, batch.seen[1:], strict=True)]
        ).sum()

    before = float(error().detach())
    for _ in range(60):
        optimiser.zero_grad()
        error().backward()
        optimiser.step()
    assert float(error().detach()) < 0.7 * before  # 0.5 for both targets
    if target == "gltf-anisotropic":
        axes, _ = lobes(network(batch.patches)[target][2].detach().numpy())
        assert np.median(axes[..., 0] / axes[..., 1]) > 1.02  # untrained: 1.002


def test_a_training_resumes_to_the_same_bits(tmp_path: Path) -> None:
    whole = train(tiny(), tmp_path / "whole", False)
    train(tiny(steps=3), tmp_path / "parts", False)
    parts = train(tiny(), tmp_path / "parts", True)
    for a, b in zip(whole.average.state_dict().values(), parts.average.state_dict().values(), strict=True):
        assert torch.equal(a, b)
    network = mipnet.network_of(tmp_path / "parts" / loop.LAST)
    assert isinstance(network, mipnet_network.MipnetNetwork) and network.target == "gltf"


def test_exported_weights_make_what_the_checkpoint_makes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """To 16 bits, for every pixel filter, and never by default."""
    train(tiny("beckmann"), tmp_path / "run", False)
    arguments = ["mipnet.py", "export", str(tmp_path / "run" / loop.LAST), "mine", "--out", str(tmp_path / "weights")]
    monkeypatch.setattr("sys.argv", arguments)
    assert mipnet.main() == 0
    info = find_weights("mine", tmp_path / "weights")
    assert not info.default and info.pixel_filters == tuple(FILTERS) and info.targets == ("beckmann",)
    stored = source("beckmann")
    theirs = mipnet.network_of(tmp_path / "run" / loop.LAST).bake(stored, "beckmann", "beckmann")
    for level, other in zip(load_network(info).bake(stored, "beckmann", "beckmann"), theirs, strict=True):
        np.testing.assert_allclose(level, other, atol=0.01)


def test_it_is_not_released(tmp_path: Path) -> None:
    train(tiny(), tmp_path, False)
    with pytest.raises(UsageError, match="a baseline, which is compared with and not released"):
        export_weights(tmp_path / loop.LAST, "mine", tmp_path / "weights", False)
    assert not (tmp_path / "weights").exists()


def test_only_a_process_that_has_it_knows_it(tmp_path: Path) -> None:
    train(tiny(steps=1), tmp_path, False)
    del ARCHITECTURES["mipnet"]
    with pytest.raises(InputError, match="one of latent, moments"):
        loop.load_state(tmp_path / loop.LAST)


def test_it_is_trained_as_mipbake_1_is() -> None:
    """Data, loss and length are equal, except for the filters that it does not know of; no other loss is taken."""
    ours = read_config(mipnet.CONFIGS / "mipbake-1.toml")
    config = mipnet.configured(ours, "gltf-anisotropic", None)
    assert config.network == mipnet_network.MipnetConfig("gltf-anisotropic")
    found, expected = plain(config), plain(ours)
    assert found["data"] == expected["data"] and found["loss"] == expected["loss"] | {"any_filter": 0.0}
    assert all(found["run"][name] == expected["run"][name] for name in ("steps", "uses", "seed"))
    assert config_from(found) == config
    assert mipnet.configured(ours, "gltf", 40).optimiser.rate(39) < 0.02 * 3e-4
    paper = mipnet.configured(read_config(mipnet.CONFIGS / "paper-ggx.toml"), "ggx", 100)
    assert paper.network == mipnet_network.SingleLightsConfig("ggx") and paper.loss.kind == "single-lights"


@pytest.mark.long
def test_the_command_resumes_with_the_configuration_it_started_with(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """However the one of mipbake-1 has changed since."""
    config = tiny(steps=3)
    monkeypatch.setattr(mipnet, "configured", lambda *_: config)
    for name in ("hammered_copper", "knurled_plate"):
        shutil.copytree(Path(__file__).parents[1] / "examples" / name, tmp_path / "sets" / name)
    out = tmp_path / "run"
    arguments = ["mipnet.py", "train", "--data", str(tmp_path / "sets"), "--out", str(out)]
    monkeypatch.setattr("sys.argv", arguments)
    assert mipnet.main() == 0
    assert mipnet.main() == 2 and "holds a training already" in capsys.readouterr().err
    monkeypatch.delattr(mipnet, "configured")
    results = tmp_path / "results.json"
    monkeypatch.setattr("sys.argv", [*arguments, "--resume", "--results", str(results)])
    assert mipnet.main() == 0
    assert loop.load_state(out / loop.LAST).config.run.steps == 3
    found = json.loads(results.read_text())
    assert found["steps"] == 3 and found["not finite"] == 0
    first, *_, last = found["validations"]
    assert (first["step"], last["step"]) == (0, 3) and first["linear hemisphere"] == last["linear hemisphere"]
    assert math.isnan(first["loss"]) and last["loss"] > 0
