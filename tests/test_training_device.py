"""Training on another device than the processor."""

from __future__ import annotations

import copy

import pytest
import torch
from torch.utils._python_dispatch import TorchDispatchMode
from torch.utils._pytree import tree_leaves

from mipbake import _native
from mipbake.base.errors import UsageError
from mipbake.shading import ops
from mipbake.training import loop, loss
from mipbake.training.batches import draw_batch
from mipbake.training.data import load_materials
from mipbake.training.loop import LAST, device_named, fit_whitening, load_state, new_state
from mipbake.training.recorded import RecordedSteps

from .small_training import tiny, tiny_balanced, train

CONFIGS = {
    "single lights": tiny,
    "balanced": tiny_balanced,
    "pictures": lambda: tiny_balanced(loss={"rooms": 2, "pictures": 1, "picture_weight": 0.5}),
}
DIRECTED = {
    "single lights, directions": lambda: tiny(network={"decoders": ["ggx", "gltf-anisotropic"]}),
    "balanced, directions": lambda: tiny_balanced(network={"decoders": ["gltf-anisotropic"]}),
}
ON_GPU = pytest.mark.skipif(
    not (torch.cuda.is_available() and _native.cuda_available()), reason="no graphics card that torch and mipbake reach"
)


def test_a_card_without_kernels_of_mipbake_is_a_sentence(monkeypatch) -> None:
    monkeypatch.setattr(loop, "checked_device", lambda name, work: name)
    monkeypatch.setattr(loop, "cuda_available", lambda: False)
    with pytest.raises(UsageError, match=r"cuda cannot be used \(mipbake, which shades there, .* to train on the proc"):
        device_named("cuda")


@pytest.mark.skipif(torch.cuda.is_available(), reason="there is a graphics card")
def test_no_graphics_card_is_a_sentence_before_anything_is_made(tmp_path) -> None:
    with pytest.raises(UsageError, match="leave the device out to train on the processor"):
        train(tiny(), tmp_path / "out", False, device="cuda")
    assert not (tmp_path / "out").exists()


@pytest.mark.long
@pytest.mark.parametrize("name", CONFIGS)
def test_a_step_mixes_no_devices_and_waits_for_none(name, monkeypatch) -> None:
    """Tensors of the device `meta` have shapes and no values: what mixes them with others, or reads them, raises."""
    monkeypatch.setattr(loss, "_forward", ops)  # which says what shapes come out
    config = CONFIGS[name]()
    materials, _ = load_materials(config)
    state, meta = new_state(config), torch.device("meta")
    fit_whitening(state.network, materials, config)
    for index in range(4):  # kinds of batches take turns
        batch = draw_batch(materials, config, index)
        assert batch.to(torch.device("cpu")) is batch
        there, moved = copy.deepcopy(state.network).to(meta), batch.to(meta)
        assert type(moved) is type(batch) and moved.patches.device == meta
        value = config.loss.value(there, moved)
        value.backward()
        assert value.device == meta and value.shape == ()
        assert all(each.grad is not None and each.grad.device == meta for each in there.parameters())


class Copies(TorchDispatchMode):
    """Counts what puts numbers of the processor to `meta`."""

    def __init__(self) -> None:
        super().__init__()
        self.found: list[str] = []

    def __torch_dispatch__(self, function, types, args=(), kwargs=None):
        out = function(*args, **(kwargs or {}))
        given = [each for each in tree_leaves((args, kwargs)) if isinstance(each, torch.Tensor)]
        made = [each for each in tree_leaves(out) if isinstance(each, torch.Tensor)]
        copied = "copy" in str(function)  # other calls take a single number as an argument of theirs
        sent = any(each.device.type == "cpu" and (each.ndim or copied) for each in given)
        if sent and any(each.is_meta for each in made):
            self.found.append(str(function))
        return out


@pytest.mark.parametrize("name", ["balanced"])
def test_what_is_recorded_copies_nothing_from_the_processor(name) -> None:
    """A recorded copy would copy memory that is long gone."""
    config = CONFIGS[name]()
    materials, _ = load_materials(config)
    state, meta = new_state(config), torch.device("meta")
    fit_whitening(state.network, materials, config)
    state.network.to(meta)
    batch = draw_batch(materials, config, 0).to(meta)
    config.loss.value(state.network, batch)  # constants go there
    with Copies() as again:
        config.loss.value(state.network, batch).backward()
    assert not again.found, again.found
    batch = draw_batch(materials, config, 0)
    with Copies() as sent:
        batch.to(meta)
    assert sent.found, "copies are seen"


@pytest.mark.long
@pytest.mark.parametrize("name", [*CONFIGS, *DIRECTED])
def test_recorded_steps_are_the_steps(name) -> None:
    config = (CONFIGS | DIRECTED)[name]()
    materials, _ = load_materials(config)
    state, other = new_state(config), new_state(config)
    for each in (state, other):
        fit_whitening(each.network, materials, config)
    other.recorded = RecordedSteps(other.network, config.loss, other.optimiser.zero_grad, record=lambda work: work)
    for index in range(6):
        batch = draw_batch(materials, config, index)
        torch.testing.assert_close(other.advance(batch), state.advance(batch), rtol=1e-5, atol=1e-6)
    for one, two in zip(state.network.parameters(), other.network.parameters(), strict=True):
        torch.testing.assert_close(two, one, rtol=1e-4, atol=1e-6)


@ON_GPU
@pytest.mark.parametrize("name", [*CONFIGS, *DIRECTED])
def test_a_training_on_a_graphics_card_is_one_on_the_processor(tmp_path, name) -> None:
    config = (CONFIGS | DIRECTED)[name]()
    there = train(config, tmp_path / "there", False, device="cuda")
    here = train(config, tmp_path / "here", False)
    assert there.device.type == "cuda" and here.device.type == "cpu"
    for one, other in zip(there.network.state_dict().values(), here.network.state_dict().values(), strict=True):
        torch.testing.assert_close(one.cpu(), other, rtol=1e-3, atol=1e-4)
    assert load_state(tmp_path / "there" / LAST).step == config.run.steps
