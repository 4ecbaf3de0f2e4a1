"""Networks that bake on another device than the processor. Most of it is tested without one, on torch's `meta`."""

from __future__ import annotations

import dataclasses
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch
from numpy.typing import NDArray

import mipbake
from mipbake.baking import neural
from mipbake.baking.neural import Neural
from mipbake.base.device import checked_device
from mipbake.base.errors import UsageError
from mipbake.material import convert, model_named
from mipbake.material.pixel_filter import level_sizes
from mipbake.models import tiles
from mipbake.models.base import Network
from mipbake.models.latent_config import LatentConfig
from mipbake.models.level_filter import FROM_TOP
from mipbake.models.registry import list_weights, load_baker, load_network
from mipbake.models.workers import baking_on

from .baked_levels import off
from .command_line import fails, write_set
from .moment_cases import ANISOTROPIC, SMALL, TORUS, bumpy, trained_like
from .other_device import META, Watched, moved

ROOT = Path(__file__).resolve().parent.parent
NO_CARD = pytest.mark.skipif(torch.cuda.is_available(), reason="there is a graphics card")
ON_GPU = pytest.mark.skipif(not torch.cuda.is_available(), reason="no graphics card that torch reaches")

NETWORKS: dict[str, Callable[[], Network]] = {
    "round": lambda: trained_like(SMALL),
    "anisotropic": lambda: trained_like(ANISOTROPIC),
    "samplers": lambda: trained_like(dataclasses.replace(SMALL, samplers=("trilinear", "anisotropic"))),
    "latent": lambda: LatentConfig(growth=4, encoder_layers=2, decoder_layers=2).build().eval(),
    "latent of two": lambda: LatentConfig(("gltf",), ("gltf-anisotropic", "gltf"), growth=4).build().eval(),
}


def leather() -> NDArray[np.float32]:
    """(96, 80, 8) of a real surface: no rounding is amplified as on white noise."""
    return mipbake.load(ROOT / "examples" / "lacquered_leather").material("gltf")[:96, :80]


# What cannot be used


def test_without_torch_names_are_checked_and_a_sentence_says_what_to_type(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "torch", None)
    for name in ("gpu", "CUDA", "cuda:-1", "cuda:01", "cpu:0"):
        with pytest.raises(UsageError, match=f"unknown device '{name}': expected cpu, cuda, or cuda:1"):
            checked_device(name)
    assert checked_device("cpu") == "cpu"
    with pytest.raises(UsageError, match=r"the device cuda needs torch, .* python -m pip install \"mipbake\[train\]\""):
        checked_device("cuda")


@pytest.mark.parametrize(
    ("built", "cards", "name", "sentence"),
    [
        (None, 0, "cuda", r"the device cuda cannot be used \(.*was built without CUDA\).* to train on the processor"),
        ("12.8", 0, "cuda:1", r"the device cuda:1 cannot be used \(torch finds no graphics card\)"),
        ("12.8", 1, "cuda:3", "there is no device cuda:3: expected cuda$"),
        ("12.8", 3, "cuda:3", "there is no device cuda:3: expected cuda:0 to cuda:2"),
        ("12.8", 1, "cuda:0", r"cannot be used \(CUDA error: no kernel image is available\): expected"),
    ],
)
def test_a_card_that_cannot_be_used_is_a_sentence(built, cards, name, sentence, monkeypatch):
    def ones(*_: object, device: str) -> None:
        raise RuntimeError("CUDA error: no kernel image is available\nCompile with ...")

    monkeypatch.setattr(torch.version, "cuda", built)
    monkeypatch.setattr(torch.cuda, "is_available", lambda: cards > 0)
    monkeypatch.setattr(torch.cuda, "device_count", lambda: cards)
    monkeypatch.setattr(torch, "ones", ones)
    with pytest.raises(UsageError, match=sentence):
        checked_device(name, "train")


def test_a_card_with_too_little_memory_is_a_sentence() -> None:
    sentence = r"the memory of the device meta is too small .* leave the device out"
    with pytest.raises(UsageError, match=sentence), baking_on(META):
        raise torch.OutOfMemoryError("CUDA out of memory")


@NO_CARD
def test_commands_say_it_before_anything_is_made(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder, out = write_set(tmp_path / "metal"), tmp_path / "out"
    for command in (
        ("bake", folder, "-o", out),
        ("bake", folder, "-o", out, "--method", "neural"),
        ("convert", folder, "-o", out, "--to", "beckmann", "--weights", "paper-cross"),
    ):
        assert "the device cuda cannot be used" in fails(capsys, 2, *command, "--device", "cuda")
        assert "unknown device 'gpu'" in fails(capsys, 2, *command, "--device", "gpu")
    assert "takes no device" in fails(capsys, 2, "bake", folder, "-o", out, "--method", "lean", "--device", "cuda")
    assert "without weights takes no device" in fails(
        capsys, 2, "convert", folder, "-o", out, "--to", "ggx", "--device", "cpu"
    )
    assert not out.exists()


# Another device


@pytest.mark.long
@pytest.mark.parametrize("name", NETWORKS)
@pytest.mark.parametrize("size", [(80, 50), (1, 1), (7, 1)])
def test_a_bake_mixes_no_devices_and_copies_each_tile_once(name, size, monkeypatch):
    """Tensors of the device `meta` have shapes and no values: what reads them, or mixes them with others, raises."""
    monkeypatch.setattr(tiles, "CARD_TILE", 32)
    network = NETWORKS[name]()
    there, (target, *_) = moved(network), network.config.decoders
    with Watched() as watched:
        levels = there.bake(bumpy(*size), "gltf", target, "gaussian", ("wrap", "clamp"))
    channels, sizes = model_named(target).channels, level_sizes(*size)
    assert [level.shape for level in levels] == [(*each, channels) for each in sizes]
    # Images go up once a tile; all else that goes up are the filters of whole axes, which are matrices.
    assert sum(len(shape) == 3 for shape in watched.sent) == -(-size[0] // 32) * -(-size[1] // 32)
    # What comes back is texels of levels, each once, and nothing else.
    assert sum(int(np.prod(shape)) for shape in watched.fetched) == channels * sum(h * w for h, w in sizes)
    assert len(watched.fetched) <= sum(-(-h // 32) * -(-w // 32) + 1 for h, w in sizes)


def test_large_tiles_and_one_thread_show_in_rounding_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    """What a graphics card would be asked to calculate, by the processor."""
    for name, make in NETWORKS.items():
        network, stored = make(), bumpy(70, 90)
        target = network.config.decoders[0]
        baked = network.bake(stored, "gltf", target, "gaussian", TORUS)
        with monkeypatch.context() as patched:
            for module in ("moment_inference", "latent_inference"):
                patched.setattr(f"mipbake.models.{module}.tile_for", lambda _: 37)
            other = network.bake(stored, "gltf", target, "gaussian", TORUS)
        assert len(baked) > 1 + FROM_TOP
        assert np.quantile(off(target, baked, other), 0.99) < 1e-4, name


@pytest.fixture
def any_device(monkeypatch: pytest.MonkeyPatch) -> None:
    """Takes any name for a device."""
    monkeypatch.setattr(neural, "checked_device", lambda name: name)


@pytest.mark.long
@pytest.mark.usefixtures("any_device")
@pytest.mark.parametrize("weights", [None, "mipbake-3-anisotropic"])
def test_the_method_bakes_where_it_is_told_to(weights: str | None) -> None:
    method = Neural(weights, device="meta")
    target = method.weights("gltf-anisotropic" if weights else "gltf", "gaussian").targets[0]
    for fetched in (1, 2):  # the second time, the weights lie there already
        with Watched() as watched:
            result = method(bumpy(40, 24), "gltf", target, "gaussian", TORUS, lambda _: None)
        assert [level.shape[:2] for level in result.levels] == level_sizes(40, 24)
        assert not any(level[..., 0].any() for level in result.levels), "zeros, which came from meta"
        parameters = [shape for shape in watched.sent if len(shape) == 4]
        assert bool(parameters) == (fetched == 1) and watched.fetched


# A graphics card


@ON_GPU
@pytest.mark.parametrize("info", list_weights(), ids=lambda info: info.name)
def test_a_graphics_card_bakes_what_the_processor_bakes(info) -> None:
    """In torch, and in the native core where it was compiled with CUDA."""
    (read, *_), target = info.network.encoders, info.network.decoders[0]
    asked = convert(leather(), "gltf", read), read, target, info.pixel_filters[0], ("wrap", "clamp")
    on_card = load_baker(info, checked_device("cuda")), load_network(info).to("cuda")
    low, high = np.array(model_named(target).limits, np.float32).T
    for here in (load_network(info).bake(*asked), load_baker(info).bake(*asked)):
        for baker in on_card:
            assert (off(target, baker.bake(*asked), here) / (high - low)).max() < 1e-4
